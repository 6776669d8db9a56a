"""What every log holds: its signals, checked once so that later steps need not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import EllipsisType
from typing import Any, Literal, Self, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _signals
from .._sections import FloatArray
from . import checks
from .resampling import Pick

# A log is uniform when every step is within this of the median, relative; taking such a step for dt changes x' by
# as little. Rounding of the times themselves (large ones have few digits left for the step) is allowed on top.
_UNIFORM = 1e-6
_ROUNDING = 4.0 * np.finfo(float).eps


NonFinite = Literal["raise", "keep"]


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Recorded:
    """Signals of one flight; see :class:`Recording`, which documents them."""

    times: FloatArray
    x: FloatArray
    g: FloatArray | None
    f_theta: FloatArray | None
    label: FloatArray | None
    inertia: FloatArray | None
    features: FloatArray | None
    name: str
    channels: tuple[str, ...]
    unit: str
    nonfinite: NonFinite

    def __init__(
        self,
        times: ArrayLike,
        x: ArrayLike,
        *,
        g: ArrayLike | None = None,
        f_theta: ArrayLike | None = None,
        label: ArrayLike | None = None,
        inertia: ArrayLike | None = None,
        features: ArrayLike | None = None,
        name: str = "",
        channels: Sequence[str] | None = None,
        unit: str = "",
        nonfinite: NonFinite = "raise",
    ) -> None:
        if nonfinite not in get_args(NonFinite):
            raise ValueError(f"nonfinite: expected 'raise' or 'keep', got {nonfinite!r}")
        finite = nonfinite == "raise"
        channels = _signals.labels(x) if channels is None else channels
        x = checks.measured(x)
        n, n_x = x.shape
        names = _signals.channel_names(channels, n_x)
        times = _signals.sample_times("times", times, n)
        x = checks.usable_or_nan("x", x, names, finite=finite)
        signals = {"g": g, "f_theta": f_theta, "label": label}
        M = None if inertia is None else _signals.inertia("inertia", inertia, n_x, n, finite=finite)
        checked = {
            "times": times,
            "x": x,
            **{
                key: checks.signal(key, value, (n, n_x), names, finite=finite)
                for key, value in signals.items()
            },
            "inertia": M,
            "features": checks.features_of(features, n, finite=finite),
        }
        for key, value in checked.items():
            if value is not None:
                value.flags.writeable = False
            object.__setattr__(self, key, value)
        for key, text in (("name", name), ("channels", names), ("unit", unit), ("nonfinite", nonfinite)):
            object.__setattr__(self, key, text)

    @classmethod
    def from_arrays(
        cls,
        *,
        x: ArrayLike,
        times: ArrayLike | None = None,
        dt: float | None = None,
        g: ArrayLike | None = None,
        f_theta: ArrayLike | None = None,
        label: ArrayLike | None = None,
        inertia: ArrayLike | None = None,
        features: ArrayLike | None = None,
        name: str = "",
        channels: Sequence[str] | None = None,
        unit: str = "",
        nonfinite: NonFinite = "raise",
    ) -> Self:
        """A log from arrays.

        Parameters
        ----------
        x, times, g, f_theta, label, inertia, features, name, channels, unit, nonfinite
            As for the class.
        dt : float, optional
            Sampling interval in s, instead of ``times``; the first sample is then at 0. Exactly one of the two.

        Raises
        ------
        TypeError, ValueError
            As for the class; and if both or neither of ``times`` and ``dt`` are given, or dt is not positive.

        Examples
        --------
        >>> from phyfilter_ctl.recording import Recording
        >>> Recording.from_arrays(x=[[0.0, 1.0], [0.1, 1.0]], dt=0.002).times.tolist()
        [0.0, 0.002]
        """
        channels = _signals.labels(x) if channels is None else channels
        x = checks.measured(x, copy=False)
        return cls(
            _times_or_grid(times, dt, len(x)),
            x,
            g=g,
            f_theta=f_theta,
            label=label,
            inertia=inertia,
            features=features,
            name=name,
            channels=channels,
            unit=unit,
            nonfinite=nonfinite,
        )

    def __len__(self) -> int:
        """Number N of samples."""
        return len(self.x)

    @property
    def n(self) -> int:
        """Number N of samples, len(log)."""
        return len(self.x)

    @property
    def n_x(self) -> int:
        """Number of channels."""
        return self.x.shape[1]

    @property
    def duration(self) -> float:
        """Time from the first sample to the last, s."""
        return float(self.times[-1] - self.times[0])

    @cached_property
    def missing(self) -> NDArray[np.bool_]:
        """Rows (N,) in which a signal or the inertia is NaN; none unless ``nonfinite`` is "keep"."""
        rows = np.zeros(self.n, dtype=bool)
        for key in ("x", "g", "f_theta", "label", "inertia", "features") if self.nonfinite == "keep" else ():
            value = getattr(self, key)
            if value is not None and (key != "inertia" or checks.inertia_varies(value, self.n)):
                rows |= np.isnan(value.reshape(self.n, -1)).any(axis=1)
        return rows

    @cached_property
    def is_uniform(self) -> bool:
        """Whether every step is within 1e-6 of the median, relative, beyond the rounding of the times."""
        steps = np.diff(self.times)
        median = float(np.median(steps))
        rounding = _ROUNDING * float(np.max(np.abs(self.times)))
        return bool(np.max(np.abs(steps - median)) <= _UNIFORM * median + rounding)

    @cached_property
    def dt(self) -> float:
        """Median sampling interval, s; of a uniform log the mean, which is the same with less rounding."""
        if self.is_uniform:
            return self.duration / (self.n - 1)
        return float(np.median(np.diff(self.times)))

    def speed(self, percentile: float = 99.0) -> float:
        """Percentile over the samples of \\|x\\|, the Euclidean norm over the channels, in the unit of x.

        Raises
        ------
        ValueError
            If ``percentile`` is not from 0 to 100.

        Examples
        --------
        >>> from phyfilter_ctl.recording import Recording
        >>> Recording.from_arrays(x=[[3.0, 4.0], [0.0, 1.0]], dt=0.1).speed(100)
        5.0
        """
        if not 0.0 <= percentile <= 100.0:
            raise ValueError(f"percentile: expected 0 to 100, got {percentile!r}")
        return float(np.percentile(np.linalg.norm(self.x, axis=1), percentile))

    def with_signals(
        self,
        *,
        g: ArrayLike | EllipsisType | None = ...,
        f_theta: ArrayLike | EllipsisType | None = ...,
        label: ArrayLike | EllipsisType | None = ...,
        features: ArrayLike | EllipsisType | None = ...,
    ) -> Self:
        """The log with some signals replaced; None takes a signal out, one not given stays.

        Parameters
        ----------
        g, f_theta, label, features : array_like, optional
            As for the class.

        Raises
        ------
        TypeError, ValueError
            As for the class.

        Examples
        --------
        >>> from phyfilter_ctl.recording import Recording
        >>> log = Recording.from_arrays(x=[[0.0], [0.1]], dt=0.5, label=[[1.0], [1.0]])
        >>> log.with_signals(f_theta=[[0.9], [0.9]], label=None)
        Recording(2 samples of x[0], 0.5 s, dt 0.5 s; f_theta)
        """
        given = {"g": g, "f_theta": f_theta, "label": label, "features": features}
        return replace(
            self, **{key: value for key, value in given.items() if not isinstance(value, EllipsisType)}
        )

    def with_model(self, model: Any) -> Self:
        """The log with what a learned model predicts as f_theta: of its features, of x where it has none.

        Parameters
        ----------
        model : LearnedModel
            Fitted; on windows of x a :class:`~phyfilter_ctl.learned.Windowed`.

        Raises
        ------
        TypeError, ValueError
            If it is no model, the log has gaps in what the model takes, or that has another number of columns.

        Examples
        --------
        >>> from phyfilter_ctl.learned import Chebyshev
        >>> from phyfilter_ctl.recording import Recording
        >>> log = Recording.from_arrays(x=[[0.0], [0.1], [0.2], [0.3]], dt=0.5, label=[[0.0], [0.2], [0.4], [0.6]])
        >>> log.with_model(Chebyshev(1, n_d=0, l2=0.0).fit(log.x, log.label).model).f_theta.round(9).ravel().tolist()
        [0.0, 0.2, 0.4, 0.6]
        """
        if isinstance(model, type) or not hasattr(model, "predict"):
            raise TypeError(
                f"model: expected a learned model, got {model!r}; phyfilter_ctl.learned_model(...) makes one"
            )
        return self.with_signals(f_theta=model.predict(self.x if self.features is None else self.features))

    def _at(
        self,
        times: FloatArray,
        pick: Pick,
        pick_g: Pick | None = None,
    ) -> Self:
        """The log at other times, each signal picked by a function of its samples."""
        picks = {"x": pick, "g": pick_g or pick, "f_theta": pick, "label": pick, "features": pick}
        held = {key: value for key in picks if (value := getattr(self, key)) is not None}
        picked = {key: picks[key](value) for key, value in held.items()}
        if self.inertia is not None:
            picked["inertia"] = checks.picked_inertia(self.inertia, self.n, len(times), pick)
        return replace(self, times=times, **picked)

    def __repr__(self) -> str:
        name = f"{self.name!r}: " if self.name else ""
        unit = f" [{self.unit}]" if self.unit else ""
        step = f"dt {self.dt:.6g} s" if self.is_uniform else f"dt about {self.dt:.3g} s"
        held = [
            key for key in ("g", "f_theta", "label", "inertia", "features") if getattr(self, key) is not None
        ]
        signals = f"; {', '.join(held)}" if held else ""
        signals += f"; {gaps} rows with gaps" if (gaps := int(self.missing.sum())) else ""
        channels = ", ".join(self.channels)
        return (
            f"Recording({name}{self.n} samples of {channels}{unit}, {self.duration:.6g} s, {step}{signals})"
        )


def _times_or_grid(times: ArrayLike | None, dt: float | None, n: int) -> ArrayLike:
    if times is not None and dt is None:
        return times
    if dt is not None and times is None:
        return _signals.duration("dt", dt) * np.arange(n)
    raise ValueError(f"expected exactly one of times and dt, got {'neither' if dt is None else 'both'}")
