"""A sampled filter in a loop as loops are: time stamps that jitter, samples that are lost, late, doubled, bad or stuck.

A step takes as long as its stamps say; what cannot be used never enters the state. While no good sample comes,
f_hat - f_theta, the estimate of the residual, is kept for the longest gap and then goes the way of the rules:

    f_hat = f_theta + s C w,    s = 1 up to the longest gap T, then e^(-(gap - T) / decay_time), 1 or 0

The first good sample within T closes the gap as one longer step, whose residual is exact where g and f_theta are. After
a longer one the filter goes on from the new sample with the states s w: what happened meanwhile is not guessed. All
other routes do the same with s = 1 and the default longest gap.
"""

from __future__ import annotations

import json
import math
import os
from collections import deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _signals
from .._output import replacing
from ..results import plain
from . import loop, retuning
from .live_rules import MEANING, LiveHealth, LiveRules, completed
from .live_state import parsed_state, written_state
from .loop import FilterState
from .recursion import GAP_ROUNDING, Recursion, output
from .sampled_form import SampledForm

__all__ = ["LiveFilter"]

Array = NDArray[np.floating]
_LATE_IN_A_ROW = 3  # so many late stamps, one after the other and ascending, are a clock that was set back
_ROUNDING = 8 * np.finfo(float).eps  # of a stamp: steps that differ by less from the nominal one are that one
_STRANGE = 100.0  # nominal steps: first stamps all further apart than this are in another unit
_NONE_LATE = (0, -math.inf)  # late stamps in a row, and the last of them


class _Sample(NamedTuple):
    """What a step was given besides x."""

    g: Array
    f_theta: Array
    M: Array | None
    h: float


class LiveFilter:
    """A sampled filter that runs in a loop; made by :meth:`SampledPhyFilter.live`.

    Parameters
    ----------
    sampled : SampledForm
        A :class:`SampledPhyFilter`.
    channels : int
        Number n_x of channels of x.
    rules : LiveRules
        With a longest gap of two nominal steps or more, at which forward Euler does not diverge; else ValueError.

    Attributes
    ----------
    recursion : Recursion
        What it runs on now; another one after ``retune``.
    rules : LiveRules
        With the times that it left open.

    Notes
    -----
    On stamps without faults it gives what ``run`` gives with these ``times``, to rounding. A clock that goes on over
    restarts (not one that starts at boot) lets a restored filter know how long it was away. A jump ahead by less than
    the longest gap cannot be told from lost samples; one back by less shows at the third stamp.

    Examples
    --------
    >>> from phyfilter_ctl import PhyFilter
    >>> live = PhyFilter([20.0]).sampled(0.01).live(1)
    >>> nan = float("nan")
    >>> for time, x in ((0.0, 0.0), (0.01, 0.05), (0.02, nan), (0.03, 0.15), (0.03, 0.15)):
    ...     f_hat = live.step(time, [x])
    >>> live.held, f_hat.round(4).tolist(), live.health.counts["nonfinite"], live.health.counts["duplicate"]
    (True, [2.2559], 1, 1)
    """

    def __init__(self, sampled: SampledForm, channels: int, rules: LiveRules) -> None:
        self.recursion: Recursion = sampled.recursion
        self.rules: LiveRules = completed(rules, self.recursion)
        self._channels = _signals.count("channels", channels)
        zeros = np.zeros(channels, sampled.sampling.precision)
        nothing = loop.start(self.recursion, zeros, f_hat0=None, f_theta0=None, inertia0=None, g0=None)
        self._settle(nothing, LiveHealth())

    def _settle(self, state: FilterState, health: LiveHealth) -> None:
        self._state, self._time, self._accepted = state, health.time, health.accepted
        self._counts, self._last = dict(health.counts), dict(health.last)
        self._worst = health.worst_gap
        self._dt = self.recursion.sampling.dt
        self._usual = 1.5 * self._dt  # a longer step has lost samples in it
        self._longest = (self.rules.longest_gap or 0.0) * GAP_ROUNDING
        self._fresh = not health.accepted or math.isnan(
            health.time
        )  # go on from the next good sample, without a step to it
        self._held = self._stepped = False
        self._kind = "missing"  # of the gap
        self._late = _NONE_LATE
        self._strange = 0
        self._repeats: list[int] = [0] * self._channels
        self._taken: deque[tuple[FilterState, _Sample]] = deque(maxlen=self.rules.stuck_after or 1)
        self._nan = np.full(self._channels, np.nan, state.x.dtype)
        behind = output(state.w, state.carry, self.recursion.nominal.C)
        self._f_hat = self.recursion.limited(state.f_theta + behind)

    # -- what it knows ------------------------------------------------------------------------------------------

    @property
    def f_hat(self) -> Array:
        """Last estimate, (n_f,)."""
        return self._f_hat.copy()

    @property
    def held(self) -> bool:
        """Whether the last sample did not enter the filter."""
        return self._held

    @property
    def state(self) -> FilterState:
        """State, as ``step`` of the sampled filter has it."""
        return self._state

    @property
    def health(self) -> LiveHealth:
        """What it met so far."""
        worst = max(self._worst, self._state.gap)
        return LiveHealth(self._accepted, dict(self._counts), dict(self._last), worst, self._time)

    # -- samples ------------------------------------------------------------------------------------------------

    def step(
        self,
        time: float,
        x: ArrayLike | None,
        g: ArrayLike | None = None,
        f_theta: ArrayLike | None = None,
        *,
        inertia: ArrayLike | None = None,
    ) -> Array:
        """Take what came and give the estimate; of bad values none enters and none comes out.

        Parameters
        ----------
        time : float
            Stamp of the measurement in seconds.
        x : (n_x,) array or None
            The measurement; None: none came.
        g : (n_x,) array, optional
            With ``g="hold"``, ``step``, ``live.step`` and C take the g that acted since the last sample; ``run``,
            blocks and FMUs take the g that acts from this sample on. With ``g="average"`` all take g at this sample.
            None means 0.
        f_theta : (n_f,) array, optional
            Learned model now; None means 0.
        inertia : float, (n_x,) or (n_x, n_x) array, optional
            Inertia now; None keeps the last one.

        Returns
        -------
        (n_f,) array
            f_hat, always finite; ``held`` tells whether the sample was used.

        Raises
        ------
        TypeError, ValueError
            For what is no number or of another shape, and for first stamps that are all more than 100 nominal steps
            apart. Nothing has changed then.
        """
        came, given = x, self._nan if x is None else x
        x, g, f_theta, M, good = loop.checked_sample(self.recursion, self._state, given, g, f_theta, inertia)
        time = time if type(time) is float else _seconds(time)
        h = time - self._time
        if abs(h - self._dt) <= _ROUNDING * abs(time):
            h = self._dt
        if not 0.0 < h < self.rules.clock_jump and (h := self._odd_step(time, h)) < 0.0:
            self._held = True
            return self._f_hat.copy()
        if h > self._usual:
            self._refuse_strange(h)
            self._note("lost", time, round(h / self._dt) - 1)
        if not good:
            self._note("missing" if came is None else "nonfinite", time)
            if self._kind != "stuck" or not self._state.held:
                self._forget_repeats()
        elif self.rules.stuck_after and not self._fresh:
            good = self._moves(time, x)
        self._time, state = time, self._state
        if not good:
            self._hold(_Sample(g, f_theta, M, h))
        elif self._fresh or state.gap + h > self._longest:
            self._resume(x, _Sample(g, f_theta, M, h))
        else:
            if self.rules.stuck_after:
                self._taken.append((state, _Sample(g, f_theta, M, h)))
            if state.gap + h > self._worst:
                self._worst = state.gap + h
            self._state, self._f_hat = loop.take(self.recursion, state, x, g, f_theta, M, h)
            self._accepted += 1
            self._held, self._stepped, self._late = False, True, _NONE_LATE
        return self._f_hat.copy()

    def _odd_step(self, time: float, h: float) -> float:
        """Length to take for a stamp that does not follow the last one; negative: drop the sample."""
        if math.isnan(self._time) and math.isfinite(time):  # the very first
            return 0.0
        if not math.isfinite(time):
            self._note("stamp", self._time)
            return -1.0
        if h == 0.0:
            self._note("duplicate", time)
            return -1.0
        if -self._longest <= h < 0.0:
            run, before = self._late
            self._late = (run + 1 if time > before else 1, time)
            if self._late[0] < _LATE_IN_A_ROW:
                self._note("late", time)
                return -1.0
            self._counts["late"] -= _LATE_IN_A_ROW - 1  # they were none
        self._refuse_strange(h)
        self._note("clock_back" if h < 0.0 else "clock_ahead", time)
        self._rebase()
        if self.rules.clock == "reset":
            self._scale(0.0)
        return 0.0

    def _rebase(self) -> None:
        """The next good sample is where the filter goes on from, without a step to it."""
        self._fresh, self._late = True, _NONE_LATE
        self._state = self._state._replace(gap=0.0, past=())

    def _refuse_strange(self, h: float) -> None:
        self._strange += not self._stepped and h > _STRANGE * self._dt
        if self._strange >= _LATE_IN_A_ROW and not self._stepped:
            raise ValueError(
                f"time: expected stamps in seconds, about {self._dt:g} s apart, got {h:g} between two of the "
                "first; convert them, or sample the filter at the interval that they have"
            )

    def _moves(self, time: float, x: Array) -> bool:
        """Whether no channel of x is stuck; the repetitions of one that is are taken back."""
        equal, before = (x == self._state.x).tolist(), max(self._repeats)
        self._repeats = [n + 1 if same else 0 for n, same in zip(self._repeats, equal, strict=True)]
        n, least = max(self._repeats), (self.rules.stuck_after or 0) - 1
        if n < least:
            self._kind = "missing" if n == 0 else self._kind
            return True
        if before < least:
            self._kind = "stuck"
            entries = [self._taken.pop() for _ in range(min(n - 1, len(self._taken)))][::-1]
            if entries:
                self._state = entries[0][0]
                self._accepted -= len(entries)
                for _, sample in entries:
                    self._wait(sample)
                self._note("stuck", time, len(entries))
        self._note("stuck", time)
        return False

    def _hold(self, sample: _Sample) -> None:
        self._held = True
        self._wait(sample)
        state = self._state
        behind = output(state.w, state.carry, self.recursion.nominal.C)
        self._f_hat = self.recursion.limited(state.f_theta + self.rules.share(self._kind, state.gap) * behind)

    def _wait(self, sample: _Sample) -> None:
        before, (g, f_theta, M, h) = self._state.gap, sample
        self._state = loop.hold(self.recursion, self._state, g, f_theta, M, h)
        if self._state.gap > self._longest >= before:
            self._note("gap", self._time)
        if self._state.gap > self._longest or self._fresh:
            self._state = self._state._replace(past=())  # no step will close that gap

    def _resume(self, x: Array, sample: _Sample) -> None:
        """Go on from this sample, without a step to it."""
        (g, f_theta, M, h), before = sample, self._state.gap
        if before <= self._longest < before + h:
            self._note("gap", self._time)
        self._worst = max(self._worst, before + h)
        self._scale(self.rules.share(self._kind, before + h))
        self._state, self._f_hat = loop.resume(self.recursion, self._state, x, g, f_theta, M)
        self._accepted += 1
        self._fresh, self._held, self._late = False, False, _NONE_LATE
        self._forget_repeats()

    def _forget_repeats(self) -> None:
        self._kind, self._repeats = "missing", [0] * self._channels
        self._taken.clear()

    def _scale(self, share: float) -> None:
        state = self._state
        if share != 1.0:
            w = (share * state.w).astype(state.w.dtype)
            self._state = state._replace(w=w, carry=None if state.carry is None else np.zeros_like(w))

    def _note(self, kind: str, time: float, count: int = 1) -> None:
        self._counts[kind] += count
        if math.isfinite(time):
            self._last[kind] = time

    # -- changes while it runs, and restarts --------------------------------------------------------------------

    def reset(self) -> None:
        """Forget residual and time: f_hat is f_theta, and the filter goes on from the next good sample."""
        self._scale(0.0)
        self._rebase()
        self._time = math.nan
        self._f_hat = self.recursion.limited(self._state.f_theta.copy())

    def retune(self, new_filter: SampledForm) -> None:
        """Go on with other coefficients, without a jump of f_hat; see :meth:`SampledPhyFilter.retune`.

        Parameters
        ----------
        new_filter : SampledForm
            A sampled filter: ``sampled.with_filter(F)``. The rules's times stay as they are.

        Raises
        ------
        ValueError
            If it has another number of channels, or diverges by forward Euler at the longest gap. Nothing has changed
            then.
        """
        new_filter.recursion.check_step(self._longest)
        state = retuning.retune(self.recursion, self._state, new_filter.recursion)
        health, flags = replace(self.health, worst_gap=self._worst), (self._fresh, self._held, self._kind)
        self.recursion = new_filter.recursion
        self._settle(state, health)
        self._fresh, self._held, self._kind = flags

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write state and health to a JSON file, whole or not at all, for :meth:`restore` after a restart.

        It waits for the disk: a fast loop saves seldom. A stuck sensor is recognised anew after a restart.

        Parameters
        ----------
        path : str or path-like

        Raises
        ------
        OSError
            If it cannot be written.
        """
        document = written_state(self.recursion, self._state, self._fresh, plain(self.health))
        with replacing(path) as file:
            file.write(json.dumps(document, indent=1).encode())

    def restore(self, path: str | os.PathLike[str]) -> None:
        """Go on from a saved state: the time since then is a gap like any other.

        Parameters
        ----------
        path : str or path-like

        Raises
        ------
        OSError
            If it cannot be read.
        ValueError
            If it is no such file, of a newer version, has a key too many or too few or a value that cannot be, or was
            saved by a filter with other coefficients, options or channels: file, key and both values are named.
            Nothing has changed then.
        """
        state, fresh, values = parsed_state(path, self.recursion, self._channels)
        if set(values["counts"]) != set(MEANING) or not set(values["last"]) <= set(MEANING):
            raise ValueError(f"{path}: health: expected the counts of {', '.join(MEANING)}")
        if values["time"] is None:
            values["time"] = math.nan
        self._settle(state, LiveHealth(**values))
        self._fresh = self._fresh or fresh
        self._stepped = not self._fresh


def _seconds(time: float) -> float:
    given = np.asarray(time)
    if given.ndim or given.dtype.kind not in "fiu":
        raise TypeError(f"time: expected a stamp in seconds, one number, got {time!r}")
    return float(given)
