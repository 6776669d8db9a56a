"""FlightLog: the recorded signals of one flight, checked once so that later steps need not.

Many flights are a sequence of FlightLogs. They stay apart: joining two would put a jump where one ends.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import EllipsisType
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from . import checks
from .columns import VELOCITIES, default_columns, inertia_option, read_log
from .comparison import EstimateComparison
from .csvfile import write_csv
from .resampling import Pick, uniform_grid

__all__ = ["FlightLog"]

# A log is uniform when every step is within this of the median, relative; taking such a step for dt changes x' by
# as little. Rounding of the times themselves (large ones have few digits left for the step) is allowed on top.
_UNIFORM = 1e-6
_ROUNDING = 4.0 * np.finfo(float).eps


@dataclass(frozen=True, init=False, eq=False, repr=False)
class FlightLog:
    """Recorded signals of one flight of a plant M x' = g + f. Arrays are copied and read-only.

    Usually made by :meth:`from_arrays` or :meth:`from_csv`.

    Parameters
    ----------
    times : array_like, shape (N,)
        Sample times in s, increasing; the steps may differ. timedelta64 has its unit with it; datetime64 counts from
        the first sample. Whole numbers a thousand apart and more are refused: a clock's ticks, not seconds.
    x : array_like, shape (N, n_x)
        Measured signal, one column a channel.
    g : array_like, shape (N, n_x), optional
        Known part of M x', in the unit of M x'.
    f_theta : array_like, shape (N, n_x), optional
        Output of a learned model of f, same unit.
    label : array_like, shape (N, n_x), optional
        The true f, for training and for scoring, same unit.
    inertia : array_like, optional
        M: a scalar, (n_x,) a diagonal, (n_x, n_x), or one a sample: (N, n_x) or (N, n_x, n_x). Entries may have any
        sign.
    features : array_like, shape (N, n_z), optional
        Inputs z of the learned model.
    name : str
        Name of the flight.
    channels : sequence of str, optional
        Names of the channels; None means x[0], x[1], ...
    unit : str
        Unit of x.

    Raises
    ------
    TypeError
        If an array is not of real numbers.
    ValueError
        If a shape is wrong, a value is not finite, is masked or is beyond 1e150, or a time stands still or runs back
        (the row is named, counted from 0), if there are fewer than two samples, or if ``inertia`` is (n_x, n_x) with
        N == n_x, which could also mean (N, n_x).

    Examples
    --------
    >>> from phyfilter_ctl.flightlog import FlightLog
    >>> log = FlightLog.from_arrays(x=[[0.0], [0.1], [0.4]], dt=0.5, label=[[0.0], [0.4], [0.8]], name="hover")
    >>> log
    FlightLog('hover': 3 samples of x[0], 1 s, dt 0.5 s; label)
    >>> log.n, log.n_x, log.dt, log.is_uniform
    (3, 1, 0.5, True)
    """

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
    ) -> None:
        x = checks.measured(x)
        n, n_x = x.shape
        names = checks.channel_names(channels, n_x)
        times = _signals.sample_times("times", times, n)
        _signals.refuse_unusable("x", x, names)
        signals = {"g": g, "f_theta": f_theta, "label": label}
        checked = {
            "times": times,
            "x": x,
            **{key: checks.signal(key, value, (n, n_x), names) for key, value in signals.items()},
            "inertia": None if inertia is None else _signals.inertia("inertia", inertia, n_x, n),
            "features": checks.features_of(features, n),
        }
        for key, value in checked.items():
            if value is not None:
                value.flags.writeable = False
            object.__setattr__(self, key, value)
        for key, text in (("name", name), ("channels", names), ("unit", unit)):
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
    ) -> FlightLog:
        """A log from arrays.

        Parameters
        ----------
        x, times, g, f_theta, label, inertia, features, name, channels, unit
            As for the class.
        dt : float, optional
            Sampling interval in s, instead of ``times``; the first sample is then at 0. Exactly one of the two.

        Raises
        ------
        TypeError, ValueError
            As for the class; and if both or neither of ``times`` and ``dt`` are given, or dt is not positive.

        Examples
        --------
        >>> from phyfilter_ctl.flightlog import FlightLog
        >>> FlightLog.from_arrays(x=[[0.0, 1.0], [0.1, 1.0]], dt=0.002).times.tolist()
        [0.0, 0.002]
        """
        x = checks.measured(x)
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
        )

    @classmethod
    def from_csv(
        cls,
        path: str | os.PathLike[str],
        *,
        time: str | None = "t",
        dt: float | None = None,
        x: Sequence[str] = VELOCITIES,
        label: Sequence[str] | EllipsisType | None = ...,
        g: Sequence[str] | EllipsisType | None = ...,
        f_theta: Sequence[str] | EllipsisType | None = ...,
        features: Sequence[str] | EllipsisType | None = ...,
        inertia: ArrayLike | EllipsisType | None = ...,
        scale: Mapping[str, float] | None = None,
        delimiter: str = ",",
        name: str | None = None,
        channels: Sequence[str] | None = None,
        unit: str | None = None,
    ) -> FlightLog:
        """A log from a CSV file: a header line with the column names, then one row a sample.

        The columns looked for unless an option names others (the order in the file is free, further columns are
        ignored):

        ============== ======================================== ===================
        signal         columns                                  unit
        ============== ======================================== ===================
        time           t                                        s
        x              vx, vy, vz                               m/s
        label          ax, ay, az                               m/s^2 (N/kg)
        label, other x label_<x>, one for every name in ``x``   unit of M x'
        g              g_<x>                                    unit of M x'
        f_theta        f_theta_<x>                              unit of M x'
        features       feature_0, feature_1, ...                any
        inertia        inertia_0, ... (diagonal) or             unit of M
                       inertia_0_0, inertia_0_1, ... (matrix)
        ============== ======================================== ===================

        time and x must be there; the others are taken where the file has them. Lines that begin with ``#`` are
        comments, blank lines are skipped, a byte-order mark is allowed.

        Parameters
        ----------
        path : str or path-like
            UTF-8 text.
        time : str, optional
            Column of the times in s.
        dt : float, optional
            Sampling interval in s, for a file without times: with ``time=None``, and only then.
        x : sequence of str
            Columns of x.
        label, g, f_theta, features : sequence of str, optional
            Columns of the signal; None leaves it out; not given: the ones in the table, where the file has them.
        inertia : array_like of numbers or of column names, optional
            M, constant, as for the class; or the names of its n_x columns (diagonal) or n_x^2 (matrix, row by row).
        scale : mapping of str to float, optional
            Factors that columns are multiplied with to come to the units above, such as ``{"t": 1e-3}`` for ms.
        delimiter : str
            One character.
        name : str, optional
            Name of the flight; None means the file's, without its suffix.
        channels : sequence of str, optional
            Names of the channels; None means the columns of x.
        unit : str, optional
            Unit of x; None means m/s for the default columns, else none.

        Raises
        ------
        OSError
            If the file cannot be read.
        ValueError
            If the file is empty, holds a header only or no UTF-8 text, names a column twice or lacks a column; if a
            row is broken, a value is not finite, or a time stands still or runs back: the number of the line in the
            file (from 1), the column and the text are named.

        Examples
        --------
        >>> import pathlib, tempfile
        >>> from phyfilter_ctl.flightlog import FlightLog
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder) / "short.csv"
        ...     _ = path.write_text("ms,v,a\\n0,1.0,0.5\\n10,1.005,0.5\\n")
        ...     FlightLog.from_csv(path, time="ms", x=["v"], label=["a"], scale={"ms": 1e-3}, unit="m/s")
        FlightLog('short': 2 samples of v [m/s], 0.01 s, dt 0.01 s; label)
        """
        path = Path(path)
        if (time is None) == (dt is None):
            raise ValueError(
                "expected exactly one of time (a column) and dt (with time=None), got "
                + ("neither" if dt is None else f"time={time!r} and dt={dt!r}")
            )
        columns, constant = inertia_option(inertia)
        log = read_log(
            path,
            time=time,
            x=x,
            signals={"label": label, "g": g, "f_theta": f_theta, "features": features, "inertia": columns},
            scale=scale or {},
            delimiter=delimiter,
        )
        values = {"inertia": constant, **log.values}
        times = values.pop("time", None)
        return cls.from_arrays(
            **values,
            times=times,
            dt=dt,
            name=path.stem if name is None else name,
            channels=log.x_names if channels is None else channels,
            unit=("m/s" if log.x_names == VELOCITIES else "") if unit is None else unit,
        )

    def to_csv(self, path: str | os.PathLike[str], *, time: str = "t", delimiter: str = ",") -> None:
        """Write the log so that :meth:`from_csv` with ``x=log.channels`` reads the same numbers, bit for bit.

        The columns are those of the table in :meth:`from_csv`. A constant inertia is written on every row; ``name``
        and ``unit`` are not written.

        Parameters
        ----------
        path : str or path-like
        time : str
            Column of the times.
        delimiter : str
            One character.

        Raises
        ------
        ValueError
            If two columns would have one name.
        OSError
            If the file cannot be written.

        Examples
        --------
        >>> import pathlib, tempfile
        >>> from phyfilter_ctl.flightlog import FlightLog
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder) / "log.csv"
        ...     FlightLog.from_arrays(x=[[0.5], [0.25]], dt=0.1, channels=["v"], g=[[1.0], [2.0]]).to_csv(path)
        ...     print(path.read_text(), end="")
        t,v,g_v
        0.0,0.5,1.0
        0.1,0.25,2.0
        """
        inertia = None if self.inertia is None else checks.inertia_rows(self.inertia, self.n, self.n_x)
        written = {"label": self.label, "g": self.g, "f_theta": self.f_theta, "features": self.features}
        header, blocks = [time, *self.channels], [self.times[:, None], self.x]
        for key, value in (*written.items(), ("inertia", inertia)):
            if value is not None:
                header += default_columns(key, self.channels, value.shape[1])
                blocks.append(value)
        write_csv(Path(path), header, np.hstack(blocks), delimiter)

    @property
    def n(self) -> int:
        """Number N of samples."""
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
        >>> from phyfilter_ctl.flightlog import FlightLog
        >>> FlightLog.from_arrays(x=[[3.0, 4.0], [0.0, 1.0]], dt=0.1).speed(100)
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
    ) -> FlightLog:
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
        >>> from phyfilter_ctl.flightlog import FlightLog
        >>> log = FlightLog.from_arrays(x=[[0.0], [0.1]], dt=0.5, label=[[1.0], [1.0]])
        >>> log.with_signals(f_theta=[[0.9], [0.9]], label=None)
        FlightLog(2 samples of x[0], 0.5 s, dt 0.5 s; f_theta)
        """
        given = {"g": g, "f_theta": f_theta, "label": label, "features": features}
        return replace(
            self, **{key: value for key, value in given.items() if not isinstance(value, EllipsisType)}
        )

    def segment(self, start: int, stop: int | None = None) -> FlightLog:
        """Samples ``start`` to ``stop - 1``, at their own times; ``stop=None`` means to the end.

        Raises
        ------
        ValueError
            Unless 0 <= start, start + 2 <= stop <= N.

        Examples
        --------
        >>> from phyfilter_ctl.flightlog import FlightLog
        >>> FlightLog.from_arrays(x=[[0.0], [0.1], [0.4]], dt=0.5).segment(1).times.tolist()
        [0.5, 1.0]
        """
        stop = self.n if stop is None else stop
        if start < 0 or not start + 2 <= stop <= self.n:
            raise ValueError(
                f"segment: expected 0 <= start, start + 2 <= stop <= {self.n}, got start {start} and stop {stop}"
            )
        return self._at(self.times[start:stop], lambda values: values[start:stop])

    def split(self, fraction: float = 0.5) -> tuple[FlightLog, FlightLog]:
        """The first ``fraction`` of the samples, and the rest.

        Raises
        ------
        ValueError
            If ``fraction`` is not between 0 and 1, or leaves a part fewer than two samples.

        Examples
        --------
        >>> from phyfilter_ctl.flightlog import FlightLog
        >>> first, rest = FlightLog.from_arrays(x=[[0.0]] * 10, dt=0.1).split(0.8)
        >>> first.n, rest.n
        (8, 2)
        """
        cut = round(checks.fraction_of(fraction) * self.n)
        if not 2 <= cut <= self.n - 2:
            raise ValueError(
                f"fraction {fraction} splits {self.n} samples into {cut} and {self.n - cut}, expected at least 2 each"
            )
        return self.segment(0, cut), self.segment(cut)

    def decimate(self, k: int) -> FlightLog:
        """Every k-th sample from the first on. Nothing is filtered before: faster content aliases.

        Raises
        ------
        ValueError
            If ``k`` is below 1 or leaves fewer than two samples.

        Examples
        --------
        >>> from phyfilter_ctl.flightlog import FlightLog
        >>> FlightLog.from_arrays(x=[[0.0], [1.0], [2.0], [3.0]], dt=0.5).decimate(2).x.tolist()
        [[0.0], [2.0]]
        """
        if not 1 <= k < self.n:
            raise ValueError(f"k: expected 1 to {self.n - 1} for {self.n} samples, got {k}")
        return self._at(self.times[::k], lambda values: values[::k])

    def resample(self, dt: float, *, g: Literal["hold", "linear"] = "hold") -> FlightLog:
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
        >>> from phyfilter_ctl.flightlog import FlightLog
        >>> log = FlightLog.from_arrays(x=[[0.0], [1.0], [4.0]], times=[0.0, 1.0, 3.0], g=[[5.0], [6.0], [7.0]])
        >>> log.resample(1.5).x.ravel().tolist(), log.resample(1.5).g.ravel().tolist()
        ([0.0, 1.75, 4.0], [5.0, 6.0, 7.0])
        """
        dt = _signals.duration("dt", dt)
        if g not in ("hold", "linear"):
            raise ValueError(f"g: expected 'hold' or 'linear', got {g!r}")
        times, linear, hold = uniform_grid(self.times, dt)
        return self._at(times, linear, hold if g == "hold" else linear)

    def compare(self, estimates: Mapping[str, ArrayLike], *, unit: str | None = None) -> EstimateComparison:
        """Estimates of f beside the label: errors, RMSE, and ``.plot()``. f_theta comes last where the log has one.

        Parameters
        ----------
        estimates : mapping of str to (N, n_x) array_like
            Estimates f_hat by name.
        unit : str, optional
            Unit of f; None means m/s^2 for x in m/s without an inertia, else not known.

        Returns
        -------
        EstimateComparison

        Raises
        ------
        TypeError
            If an estimate is not an array of real numbers.
        ValueError
            If the log has no label, there is nothing to compare, or an estimate has another shape or is not finite.

        Examples
        --------
        >>> from phyfilter_ctl.flightlog import FlightLog
        >>> log = FlightLog.from_arrays(x=[[0.0], [1.0], [2.0]], dt=1.0, label=[[1.0], [1.0], [1.0]])
        >>> log.compare({"half": [[0.5], [0.5], [0.5]]}).rmse
        {'half': 0.5}
        """
        if self.label is None:
            raise ValueError(
                "compare: the log has no label, the true f to compare with; see with_signals(label=...)"
            )
        checked = {
            name: value
            for name, given in (*estimates.items(), ("f_theta", self.f_theta))
            if (value := checks.signal(name, given, self.x.shape, self.channels)) is not None
        }
        if not checked:
            raise ValueError("estimates: expected at least one estimate, and the log has no f_theta either")
        if unit is None:
            unit = "m/s^2" if self.unit == "m/s" and self.inertia is None else ""
        return EstimateComparison(self.times, self.label, checked, self.channels, unit)

    def _at(
        self,
        times: FloatArray,
        pick: Pick,
        pick_g: Pick | None = None,
    ) -> FlightLog:
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
        channels = ", ".join(self.channels)
        return (
            f"FlightLog({name}{self.n} samples of {channels}{unit}, {self.duration:.6g} s, {step}{signals})"
        )


def _times_or_grid(times: ArrayLike | None, dt: float | None, n: int) -> ArrayLike:
    if times is not None and dt is None:
        return times
    if dt is not None and times is None:
        return _signals.duration("dt", dt) * np.arange(n)
    raise ValueError(f"expected exactly one of times and dt, got {'neither' if dt is None else 'both'}")
