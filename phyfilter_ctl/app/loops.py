"""The loop of a design, and its margins quick enough to follow a drag: evaluated once on its grid, read off between."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.linalg import LinAlgError
from scipy.interpolate import CubicSpline

from .._sections import ComplexArray, FloatArray
from ..analysis import FilterMargins
from ..analysis.margins import filter_margins
from ..analysis.margins.filter_margins import sampled_delay_margin
from ..analysis.margins.sampled import SampledLoop
from ..filter import SampledPhyFilter
from ..values import Loop
from .designs import Design

__all__ = [
    "UNSEARCHED",
    "AssumedLoop",
    "assumed_loop",
    "loop_note",
    "margin_of",
    "phase_and_delay",
    "read_off",
    "runs_sampled",
]

# Points of the loop's grid that are closer than this, relative, count as one.
_SAME_POINT = 1e-6
# Beyond so many steps of delay the continuous loop, with one step more for hold and average, stands for the sampled.
_FEW_STEPS = 50.0
UNSEARCHED = "the loop could not be searched: its time scales are too far apart"


def runs_sampled(design: Design, sampled: SampledPhyFilter | None) -> bool:
    """Whether the loop is taken as it runs, sampled; else the continuous one stands for it.

    Parameters
    ----------
    design : Design
    sampled : SampledPhyFilter or None
        Its filter as it runs; None where that is unstable.

    Returns
    -------
    bool
    """
    return sampled is not None and design.assume.delay <= _FEW_STEPS * design.dt


def loop_note(exact: bool) -> str:
    """Which loop that is, in words.

    Parameters
    ----------
    exact : bool
        From :func:`runs_sampled`.

    Returns
    -------
    str
    """
    return "sampled loop" if exact else "continuous loop with one step more of delay"


def margin_of(
    design: Design, sampled: SampledPhyFilter | None, *, exact: bool | None = None
) -> FilterMargins:
    """Margins of a design with the lag, delay and inertia ratio that are assumed.

    Parameters
    ----------
    design : Design
    sampled : SampledPhyFilter or None
        Its filter as it runs; None where that is unstable.
    exact : bool, optional
        Take the loop as it runs, however long the delay, or the continuous one; None: see :func:`runs_sampled`.

    Returns
    -------
    FilterMargins

    Raises
    ------
    ValueError
        If the loop cannot be searched.
    """
    assume = design.assume
    exact = runs_sampled(design, sampled) if exact is None else exact
    loop = Loop(
        actuator=assume.lag,
        delay=assume.delay if exact else assume.delay + design.dt,
        inertia_ratio=assume.ratio,
    )
    return filter_margins(sampled if exact and sampled is not None else design.filter, loop)


@dataclass(frozen=True, eq=False)
class _ReadOff:
    """A loop whose values between the points of its grid come from cubic splines over log omega.

    The grid has 150 points a decade, more at resonances and where a delay turns fast, so crossings move by some 1e-6
    of themselves; how many poles are unstable is still counted by the loop itself. One evaluation of a sampled loop
    costs a millisecond whatever the number of points, and a search takes forty.
    """

    exact: FilterMargins

    @property
    def nyquist(self) -> float:
        return self.exact.loop.nyquist

    @cached_property
    def tail(self) -> tuple[float, float]:
        return self.exact.loop.tail

    @cached_property
    def grid(self) -> FloatArray:
        points = self.exact.loop.grid
        apart = np.diff(points) > _SAME_POINT * points[:-1]
        return points[np.append(apart, True)]

    @cached_property
    def at_zero(self) -> tuple[float, float]:
        return self.exact.loop.at_zero

    @cached_property
    def at_nyquist(self) -> tuple[float, float] | None:
        if self.grid[-1] != self.nyquist:
            return self.exact.loop.at_nyquist
        Q, P = self._on_grid
        return float(Q[-1].real), float(P[-1].real)

    @property
    def delay(self) -> float:
        return self.exact.loop.delay

    @cached_property
    def _splines(self) -> CubicSpline:
        return CubicSpline(np.log(self.grid), np.stack(self._on_grid, axis=1))

    def __call__(self, omega: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        if omega is self.grid:
            return self._on_grid
        found = np.asarray(self._splines(np.log(omega)), dtype=np.complex128)
        return found[:, 0], found[:, 1]

    @cached_property
    def _on_grid(self) -> tuple[ComplexArray, ComplexArray]:
        return self.exact.loop(self.grid)

    def roots(self, ratio: complex) -> ComplexArray | None:
        return self.exact.loop.roots(ratio)

    def unstable(self, ratio: complex) -> int | None:
        return self.exact.loop.unstable(ratio)


def read_off(margin: FilterMargins) -> FilterMargins:
    """The same margins, from one evaluation of the loop; its ``delay_margin`` is :func:`phase_and_delay`'s.

    Parameters
    ----------
    margin : FilterMargins
        Of a sampled filter.

    Returns
    -------
    FilterMargins
    """
    return FilterMargins(margin.inertia_ratio, _ReadOff(margin), margin.filter, margin.around)


def phase_and_delay(margin: FilterMargins) -> tuple[float, float]:
    """Phase margin in degrees and delay margin in s from one search; 0 where the loop is unstable.

    Parameters
    ----------
    margin : FilterMargins

    Returns
    -------
    phase, delay : float
        The delay is the phase over the frequency, as of whole steps. What a part of a step changes within the step
        moves it by less than half a step; the search for that takes ten times as long.
    """
    if not margin.is_stable:
        return 0.0, 0.0
    omega = margin.gain_crossings
    Q, P = margin.loop(omega)
    lag = np.angle(-margin.inertia_ratio * P * np.conj(Q)) % (2.0 * np.pi)
    lag[lag == 0.0] = 2.0 * np.pi
    phase = np.min(np.minimum(lag, 2.0 * np.pi - lag), initial=np.inf)
    return float(np.rad2deg(phase)), float(np.min(lag / omega, initial=np.inf))


class AssumedLoop(NamedTuple):
    """The loop with f_hat fed back at the assumed ratio, lag and delay; no margin where it could not be searched."""

    note: str
    margin: FilterMargins | None = None
    phase: float | None = None
    delay: float | None = None
    distance: str = ""


def assumed_loop(design: Design, sampled: SampledPhyFilter | None) -> AssumedLoop:
    """The sampled loop where it is quick, else the continuous one; what is read of it later is computed here.

    Parameters
    ----------
    design : Design
    sampled : SampledPhyFilter or None
        None where it is unstable.

    Returns
    -------
    AssumedLoop
    """
    exact = runs_sampled(design, sampled)
    note = loop_note(exact)
    try:
        as_run = margin_of(design, sampled)
        margin = read_off(as_run) if exact else as_run
        distance = f"; {_distance(margin)}" if margin.is_stable and margin.stable_ratios else ""
        phase, delay = phase_and_delay(margin)
        loop = as_run.loop
        if isinstance(loop, SampledLoop) and margin.is_stable:
            # A promise: what a part of a step changes counts, up to half a step less than a delay as of whole ones.
            delay = sampled_delay_margin(
                loop, as_run.inertia_ratio, lambda later: _ReadOff(replace(as_run, loop=later))
            ).value
        return AssumedLoop(note, margin, phase, delay, distance)
    except (ValueError, LinAlgError, FloatingPointError):
        return AssumedLoop(UNSEARCHED)


def _distance(margin: FilterMargins) -> str:
    """How close the loop comes to -1, in words."""
    low, high = margin.disk.gain_margin
    return (
        f"|1 + L| is {margin.modulus_margin:.3g} or more, least at {margin.modulus_frequency:.4g} rad/s; "
        f"gain and phase together: {low:.3g} to {high:.3g} times with {math.degrees(margin.disk.phase_margin):.3g} deg"
    )
