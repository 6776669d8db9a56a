"""Recording: recorded signals of one run of a robot.

Many runs (flights, walks) are a sequence of Recordings. They stay apart: joining two would put a jump where one ends.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import EllipsisType

import control as ct
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from .._choices import TimeUnit
from ..results import Result
from . import checks
from .columns import VELOCITIES
from .description import description
from .estimate_comparison import EstimateComparison
from .findings import Finding, findings_of
from .parts import Parts
from .stored import Stored

__all__ = ["Check", "Recording"]


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Recording(Parts, Stored):
    """Recorded signals of one run of a plant M x' = g + f. Arrays are copied and read-only.

    Usually made by :meth:`from_arrays` or :meth:`read`. Signals and times may be frames, series and labelled arrays
    of pandas, polars and xarray; their rows go by position, an index is not looked at. A signal of one channel may have
    shape (N,). ``len(log)`` is N, ``log[100:200]`` the log of those samples. Flights are not joined: several are a
    list of logs, which all that learns takes, since a joint one would jump where a flight ends.

    Parameters
    ----------
    times : array_like, shape (N,)
        Sample times in s, increasing; the steps may differ. timedelta64 has its unit with it; datetime64 and datetime
        objects count from the first sample, with time zones in UTC. Whole numbers a thousand apart and more are
        refused: a clock's ticks, not seconds.
    x : array_like, shape (N, n_x)
        Measured signal, one column a channel.
    g : array_like, shape (N, n_x), optional
        Known part of M x', in the unit of M x'. Where it is held, row k is the g that acts from sample k on.
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
        Names of the channels; None means those of the columns where x is a frame or a series with names, else x[0],
        x[1], ...
    unit : str
        Unit of x.
    nonfinite : {"raise", "keep"}
        What a number does that is NaN, infinite, masked or beyond 1e150: "raise" refuses it, "keep" keeps it as NaN, a
        gap. ``missing`` tells the rows, ``pieces()`` are the logs between them; a filter sampled with
        ``nonfinite="hold"`` runs across them, and learning refuses them.

    Raises
    ------
    TypeError
        If an array is not of real numbers, or times are text, or some have a time zone and some do not.
    ValueError
        If a shape is wrong, a value is not finite, is masked or is beyond 1e150 (unless kept), or a time stands still
        or runs back (the row is named, counted from 0), if there are fewer than two samples, or if ``inertia`` is
        (n_x, n_x) with N == n_x, which could also mean (N, n_x).

    Examples
    --------
    >>> from phyfilter_ctl.recording import Recording
    >>> log = Recording.from_arrays(x=[[0.0], [0.1], [0.4]], dt=0.5, label=[[0.0], [0.4], [0.8]], name="hover")
    >>> log
    Recording('hover': 3 samples of x[0], 1 s, dt 0.5 s; label)
    >>> log.n, log.n_x, log.dt, log.is_uniform
    (3, 1, 0.5, True)
    """

    @classmethod
    def read(
        cls,
        source: str | os.PathLike[str] | object,
        *,
        time: str | None = None,
        time_unit: TimeUnit | None = None,
        dt: float | None = None,
        x: Sequence[str] = VELOCITIES,
        label: Sequence[str] | EllipsisType | None = ...,
        g: Sequence[str] | EllipsisType | None = ...,
        f_theta: Sequence[str] | EllipsisType | None = ...,
        features: Sequence[str] | EllipsisType | None = ...,
        inertia: ArrayLike | EllipsisType | None = ...,
        channels: Sequence[str] | None = None,
        unit: str | None = None,
    ) -> Recording:
        """A recording from a table: CSV of any dialect, Parquet, Arrow, Feather, MAT, HDF5, a pandas or polars frame.

        The columns looked for unless an option names others (the order is free, further columns are ignored):

        ============== ======================================== ===================
        signal         columns                                  unit
        ============== ======================================== ===================
        times          t, time, timestamp, ..., or the only     s, or as it says
                       column of dates
        x              vx, vy, vz                               m/s
        label          ax, ay, az                               m/s^2 (N/kg)
        label, other x label_<x>, one for every name in ``x``   unit of M x'
        g              g_<x>                                    unit of M x'
        f_theta        f_theta_<x>                              unit of M x'
        features       feature_0, feature_1, ...                any
        inertia        inertia_0, ... (diagonal) or             unit of M
                       inertia_0_0, inertia_0_1, ... (matrix)
        ============== ======================================== ===================

        A name may have its unit in brackets, ``vx [m/s]``, ``t [ms]``, and be in another case. Times and x must be
        there; the others are taken where the table has them.

        Parameters
        ----------
        source : path or frame
            Robots' own logs, with topics on clocks of their own, are for :func:`phyfilter_ctl.open_log` and a robot
            file.
        time : str, optional
            Column of the times.
        time_unit : {"s", "ms", "us", "ns"}, optional
            What they count, where neither name, type nor metadata say it. Without any of these they are s, and refused
            where their steps are shorter than 10 us or longer than 1 s.
        dt : float, optional
            Sampling interval in s, for CSV and frames without times.
        x : sequence of str
            Columns of x.
        label, g, f_theta, features : sequence of str, optional
            Columns of the signal; None leaves it out; not given: the ones in the table above, where there are any.
        inertia : array_like of numbers or of column names, optional
            M, constant, as for the class; or the names of its n_x columns (diagonal) or n_x^2 (matrix, row by row).
        channels : sequence of str, optional
            Names of the channels; None means the columns of x, without units.
        unit : str, optional
            Unit of x; None means that in the columns' names, else m/s for the default columns, else none.

        Returns
        -------
        Recording

        Raises
        ------
        OSError
            If the file cannot be read.
        TypeError
            If the source is neither a path nor a frame.
        ValueError
            If it is no table, lacks a column, is of several units, or a value is missing: of CSV with the line and the
            text; for times that can hardly be s.

        Examples
        --------
        >>> import pathlib, tempfile
        >>> from phyfilter_ctl.recording import Recording
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder) / "short.csv"
        ...     _ = path.write_text("Time [ms];v [m/s];label_v\\n0;1,0;0,5\\n10;1,005;0,5\\n")
        ...     Recording.read(path, x=["v"])
        Recording('short': 2 samples of v [m/s], 0.01 s, dt 0.01 s; label)
        """
        # The readers of logs make recordings, and lie above them.
        reader = importlib.import_module("phyfilter_ctl.logfiles")
        return reader.read_recording(
            source,
            time=time,
            time_unit=time_unit,
            dt=dt,
            x=x,
            label=label,
            g=g,
            f_theta=f_theta,
            features=features,
            inertia=inertia,
            channels=channels,
            unit=unit,
        )

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
        >>> from phyfilter_ctl.recording import Recording
        >>> log = Recording.from_arrays(x=[[0.0], [1.0], [2.0]], dt=1.0, label=[[1.0], [1.0], [1.0]])
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
            if (
                value := checks.signal(
                    name, given, self.x.shape, self.channels, finite=self.nonfinite == "raise"
                )
            )
            is not None
        }
        if not checked:
            raise ValueError("estimates: expected at least one estimate, and the log has no f_theta either")
        unit = self._unit_of_f() if unit is None else unit
        return EstimateComparison(self.times, self.label, checked, self.channels, unit)

    def check(self, *, time_unit_known: bool = False) -> Check:
        """What is not plausible about it, with what to do: steps of time, gaps, g, the label, frames and the mass.

        Over windows the momentum that x shows is compared with what g and the label say, M dx/W = mean g + mean f.

        Parameters
        ----------
        time_unit_known : bool
            Whether long or short steps are meant.

        Returns
        -------
        Check

        Examples
        --------
        >>> import numpy as np
        >>> from phyfilter_ctl.recording import Recording
        >>> t = np.arange(2000) * 0.002
        >>> log = Recording(t, np.sin(t), label=1e3 * np.cos(t), channels=["v"])
        >>> [finding.suspicion for finding in log.check()]
        ['label_misfit']
        """
        return Check(self, findings_of(self, time_unit_known=time_unit_known))

    def describe(self) -> str:
        """What the log holds, in words: duration, rate, jitter, gaps, channels and their ranges, signals.

        A gap is a step longer than 1.5 times the median, where a sample is missing at least; jitter is what the other
        steps differ from the median.

        Returns
        -------
        str
            Several lines.

        Examples
        --------
        >>> from phyfilter_ctl.recording import Recording
        >>> t = [0.0, 0.25, 0.5, 0.75, 1.03125, 1.78125]
        >>> log = Recording(t, [0.0, 0.1, 0.3, 0.6, 1.0, 1.0], label=[0.4, 0.8, 1.2, 1.6, 0.0, 0.0], channels=["v"])
        >>> print(log.describe())
        Recording: 6 samples, 1.78125 s, from 0 s to 1.78125 s
          rate      4 Hz (median step 0.25 s), steps differ
          jitter    at most 0.0312 s, rms 0.0156 s
          gaps      1, 2 samples missing; the longest 0.75 s, after 1.03125 s
          channels
            v       0 to 1, mean 0.5
          signals   label
        """
        return description(self)

    def plot(self, *, ax: Sequence[Axes] | None = None) -> ct.ControlPlot:
        """Each channel of x over time and, where the log has them, beneath it its g, f_theta and label.

        Parameters
        ----------
        ax : sequence of Axes, optional
            n_x of them; 2 n_x, two for each channel, where there is a g, f_theta or label. None makes a new figure.

        Returns
        -------
        control.ControlPlot

        Raises
        ------
        ValueError
            If ``ax`` does not hold as many axes.

        Examples
        --------
        >>> import matplotlib
        >>> matplotlib.use("Agg")
        >>> from phyfilter_ctl.recording import Recording
        >>> Recording.from_arrays(x=[[0.0, 1.0], [0.5, 1.5]], dt=0.1).plot().axes.shape
        (2, 1)
        """
        from ..plots.logs import log_plot

        beside = {"g": self.g, "f_theta": self.f_theta, "label": self.label}
        return log_plot(
            self.times,
            self.x,
            {name: values for name, values in beside.items() if values is not None},
            channels=self.channels,
            unit=self.unit,
            force_unit=self._unit_of_f(),
            title=self.name,
            ax=ax,
        )

    def _unit_of_f(self) -> str:
        """As far as it is known."""
        return "m/s^2" if self.unit == "m/s" and self.inertia is None else ""


@dataclass(frozen=True, eq=False, repr=False)
class Check(Result):
    """What is not plausible about a recording; made by :meth:`Recording.check` and :meth:`Robot.check
    <phyfilter_ctl.Robot.check>`. Iterating gives the findings.

    Attributes
    ----------
    recording : Recording
    findings : tuple of Finding
        Empty where nothing is suspicious.
    misfits : dict of str to float
        Of a robot's log: rms of M x' - g - f_theta over windows by convention of the frames, the declared one first,
        then from the best on.
    """

    _figures = ("ok", "findings", "misfits")

    recording: Recording
    findings: tuple[Finding, ...]
    misfits: Mapping[str, float] = field(default_factory=dict)

    @property
    def ok(self) -> bool:
        """Whether nothing is suspicious."""
        return not self.findings

    def __iter__(self) -> Iterator[Finding]:
        return iter(self.findings)

    def __str__(self) -> str:
        return "\n".join(map(str, self.findings)) or "nothing is suspicious"
