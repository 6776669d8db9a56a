"""Parts of a log, and the log on another grid of times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import timedelta
from typing import Literal, Self

import numpy as np

from .. import _signals
from . import checks
from .recorded import Recorded
from .resampling import uniform_grid


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Parts(Recorded):
    """A log that is cut by samples and by times, and read on a grid; see :class:`Recording`."""

    def segment(self, start: int, stop: int | None = None) -> Self:
        """Samples ``start`` to ``stop - 1``, at their own times; ``stop=None`` means to the end.

        Raises
        ------
        ValueError
            Unless 0 <= start, start + 2 <= stop <= N.

        Examples
        --------
        >>> from phyfilter_ctl.recording import Recording
        >>> Recording.from_arrays(x=[[0.0], [0.1], [0.4]], dt=0.5).segment(1).times.tolist()
        [0.5, 1.0]
        """
        stop = self.n if stop is None else stop
        if start < 0 or not start + 2 <= stop <= self.n:
            raise ValueError(
                f"segment: expected 0 <= start, start + 2 <= stop <= {self.n}, got start {start} and stop {stop}"
            )
        return self._at(self.times[start:stop], lambda values: values[start:stop])

    def select(self, channels: Sequence[int | str]) -> Self:
        """Some of the channels, in this order.

        Parameters
        ----------
        channels : sequence of int or str
            Numbers from 0, or names.

        Raises
        ------
        TypeError
            If it is no sequence of numbers and names.
        ValueError
            For a channel that is not there or stands twice, or an inertia that couples those kept with others.

        Examples
        --------
        >>> from phyfilter_ctl.recording import Recording
        >>> log = Recording.from_arrays(x=[[0.0, 1.0], [0.1, 1.1]], dt=0.5, channels=["vx", "vy"])
        >>> log.select(["vy"]).x.tolist()
        [[1.0], [1.1]]
        """
        kept = self._columns(channels)
        signals = {key: getattr(self, key) for key in ("g", "f_theta", "label")}
        changed = {key: value[:, kept] for key, value in signals.items() if value is not None}
        if self.inertia is not None:
            M = self.inertia
            left = [k for k in range(self.n_x) if k not in kept]
            if M.ndim > 1 and M.shape[-2:] == (self.n_x, self.n_x):
                if np.any(M[..., kept, :][..., left]):
                    names = ", ".join(self.channels[k] for k in left)
                    raise ValueError(f"channels: the inertia couples those kept with {names}; keep them too")
                changed["inertia"] = M[..., kept, :][..., kept]
            else:
                changed["inertia"] = M[..., kept] if M.ndim else M
        return replace(self, x=self.x[:, kept], channels=tuple(self.channels[k] for k in kept), **changed)

    def _columns(self, channels: Sequence[int | str]) -> list[int]:
        if isinstance(channels, str) or not isinstance(channels, Sequence | np.ndarray) or not len(channels):
            raise TypeError(f"channels: expected a sequence of numbers or names, got {channels!r}")
        kept = []
        for entry in channels:
            known = entry in self.channels if isinstance(entry, str) else 0 <= int(entry) < self.n_x
            if not known:
                there = ", ".join(self.channels)
                raise ValueError(
                    f"channels: there is no {entry!r}; expected some of {there}, or 0 to {self.n_x - 1}"
                )
            kept.append(self.channels.index(entry) if isinstance(entry, str) else int(entry))
        if len(set(kept)) < len(kept):
            raise ValueError(f"channels: {list(channels)!r} names a channel twice")
        return kept

    def __getitem__(self, samples: slice) -> Self:
        """Samples ``log[start:stop:step]`` at their own times, as of a list; forwards, and at least two.

        Raises
        ------
        TypeError
            If it is no slice: one sample is no log.
        ValueError
            If the step is not positive or fewer than two samples are left.
        """
        if not isinstance(samples, slice):
            at = samples if isinstance(samples, int | np.integer) else "k"
            raise TypeError(
                f"log[...]: expected a slice of samples such as log[100:200], got {samples!r}; one sample is "
                f"log.x[{at}], a channel log.x[:, 0], a stretch of time log.between(1.0, 2.0)"
            )
        start, stop, step = samples.indices(self.n)
        kept = len(range(start, stop, step))
        if step < 1 or kept < 2:
            raise ValueError(
                f"log[...]: expected at least 2 of {self.n} samples, forwards, got {kept} from {samples!r}"
            )
        return self._at(self.times[samples], lambda values: values[samples])

    def between(
        self,
        start: float | np.timedelta64 | timedelta | None = None,
        stop: float | np.timedelta64 | timedelta | None = None,
    ) -> Self:
        """Samples from one time to another, both included, at their own times.

        Parameters
        ----------
        start, stop : float, numpy.timedelta64 or datetime.timedelta, optional
            In s, as ``times`` has them; None means from the first sample on, or to the last.

        Raises
        ------
        TypeError, ValueError
            If they are no lengths of time, or fewer than two samples lie between them.

        Examples
        --------
        >>> from phyfilter_ctl.recording import Recording
        >>> log = Recording.from_arrays(x=[0.0, 0.1, 0.4, 0.9], dt=0.5)
        >>> log.between(0.5, 1.0).times.tolist(), log[1:3].times.tolist()
        ([0.5, 1.0], [0.5, 1.0])
        """
        first, last = float(self.times[0]), float(self.times[-1])
        low = first if start is None else _signals.number("start", _signals.interval("start", start), "s")
        high = last if stop is None else _signals.number("stop", _signals.interval("stop", stop), "s")
        a, b = np.searchsorted(self.times, low, "left"), np.searchsorted(self.times, high, "right")
        if b - a < 2:
            raise ValueError(
                f"between: expected at least 2 samples from {low:.9g} s to {high:.9g} s, got {max(b - a, 0)}; the log "
                f"runs from {first:.9g} s to {last:.9g} s"
            )
        return self.segment(int(a), int(b))

    def split(self, fraction: float = 0.5) -> tuple[Self, Self]:
        """The first ``fraction`` of the samples, and the rest.

        Raises
        ------
        ValueError
            If ``fraction`` is not between 0 and 1, or leaves a part fewer than two samples.

        Examples
        --------
        >>> from phyfilter_ctl.recording import Recording
        >>> first, rest = Recording.from_arrays(x=[[0.0]] * 10, dt=0.1).split(0.8)
        >>> first.n, rest.n
        (8, 2)
        """
        cut = round(checks.fraction_of(fraction) * self.n)
        if not 2 <= cut <= self.n - 2:
            raise ValueError(
                f"fraction {fraction} splits {self.n} samples into {cut} and {self.n - cut}, expected at least 2 each"
            )
        return self.segment(0, cut), self.segment(cut)

    def pieces(self, *, shortest: int = 2) -> tuple[Self, ...]:
        """The logs between the gaps, where no signal is NaN; (the log itself,) where there are none.

        A g that is missing in row k spoils the step to the next sample, which begins a new piece.

        Parameters
        ----------
        shortest : int
            Least number of samples of a piece, 2 or more; shorter ones are left out.

        Raises
        ------
        ValueError
            If ``shortest`` is below 2.

        Examples
        --------
        >>> from phyfilter_ctl.recording import Recording
        >>> log = Recording.from_arrays(x=[0.0, 0.1, float("nan"), 0.4, 0.5, 0.6], dt=0.5, nonfinite="keep")
        >>> [piece.times.tolist() for piece in log.pieces()]
        [[0.0, 0.5], [1.5, 2.0, 2.5]]
        """
        if shortest < 2:
            raise ValueError(f"shortest: expected 2 samples or more, got {shortest}")
        edges = np.flatnonzero(np.diff(np.concatenate([[True], self.missing, [True]]).astype(int)))
        pairs = edges.reshape(-1, 2)
        return tuple(
            replace(self.segment(a, b), nonfinite="raise") for a, b in pairs.tolist() if b - a >= shortest
        )

    def decimate(self, k: int) -> Self:
        """Every k-th sample from the first on. Nothing is filtered before: faster content aliases.

        Raises
        ------
        ValueError
            If ``k`` is below 1 or leaves fewer than two samples.

        Examples
        --------
        >>> from phyfilter_ctl.recording import Recording
        >>> Recording.from_arrays(x=[[0.0], [1.0], [2.0], [3.0]], dt=0.5).decimate(2).x.tolist()
        [[0.0], [2.0]]
        """
        if not 1 <= k < self.n:
            raise ValueError(f"k: expected 1 to {self.n - 1} for {self.n} samples, got {k}")
        return self._at(self.times[::k], lambda values: values[::k])

    def resample(self, dt: float, *, g: Literal["hold", "linear"] = "hold") -> Self:
        """A uniform log from the first sample on, by straight lines between the samples.

        Nothing is filtered before: content faster than the new rate aliases. A gap in the times is bridged like any
        other step.

        Parameters
        ----------
        dt : float
            New sampling interval, s.
        g : {"hold", "linear"}
            "hold" takes the sample before, right for a command that an actuator holds; "linear" as the other signals.

        Raises
        ------
        ValueError
            If ``dt`` is not positive or longer than the log.

        Examples
        --------
        >>> from phyfilter_ctl.recording import Recording
        >>> log = Recording.from_arrays(x=[[0.0], [1.0], [4.0]], times=[0.0, 1.0, 3.0], g=[[5.0], [6.0], [7.0]])
        >>> log.resample(1.5).x.ravel().tolist(), log.resample(1.5).g.ravel().tolist()
        ([0.0, 1.75, 4.0], [5.0, 6.0, 7.0])
        """
        dt = _signals.duration("dt", dt)
        if g not in ("hold", "linear"):
            raise ValueError(f"g: expected 'hold' or 'linear', got {g!r}")
        times, linear, hold = uniform_grid(self.times, dt)
        return self._at(times, linear, hold if g == "hold" else linear)
