"""What a learned model is worth beside a filter.

The filter alone leaves (1 - F) f - F n of the force, with the model it leaves (1 - F)(f - f_theta) - F n: noise and
margins are those of F either way. So a model is worth what it explains where |1 - F| is not small, above the filter's
bandwidth; of what is slower the filter needs no model. The alternative to a model is a faster filter, F(s/k), which
pays in noise and margin.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import cast

import control as ct
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from .. import _signals
from .._sections import FloatArray
from ..design.learning.constrained import at_speed
from ..filter import FilterBank, PhyFilter, SampledPhyFilter
from ..filter.sampling import Rule
from ..recording import Recording
from ..results import Interval, Result, Status
from .estimate import checked_logs, sampled_for
from .levels import separate
from .noise import Noise, given_noise
from .spectrum import residual_spectrum
from .steps import filtered, spread, steps_of
from .suggestion import Search, Suggestion, Unlabelled, suggest

__all__ = ["ModelValue", "model_value"]

_SPEEDS = np.geomspace(1.0, 30.0, 16)  # of the other filter, up to what the sampling lets it be
_FASTEST = 2.0  # pole times step
_EDGES = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0)  # rad/s, of the bands
_HORIZON = 0.1  # s, of the prediction that decides where noise and residual share a band


@dataclass(frozen=True, eq=False, repr=False)
class ModelValue(Result):
    """What a learned model is worth; made by :func:`model_value`.

    Attributes
    ----------
    filter : SampledPhyFilter
        The one given, else the best with the model.
    error, error_without : Interval
        Root of the expected mean square of f - f_hat with this filter, with the model and without it.
    ratio : Interval
        Of the two, paired: below 1 the model pays.
    omega : (K,) array
        rad/s, above 0.
    left, left_without : (K, n_x) arrays
        One-sided densities per rad/s of what the filter leaves, (1 - F)(f - f_theta) and (1 - F) f, noise taken out;
        0 where that is lost in the noise. Where the second is small the filter needs no model.
    passed : (K, n_x) array
        Density of the noise that it lets through.
    noise_deviation : (n_x,) array
        Of f_hat, with the model and without it.
    speed : float
        k of F(s/k) that errs as little without the model; inf where none does, 1 where the model does not pay.
    speed_noise : float
        How many times the noise that takes; inf where none does.
    best, best_without : Suggestion
        Butterworth filters of least expected error, each at its own bandwidth.
    best_ratio : Interval
        Error of the first over that of the second, paired.
    noise : Noise
        Of M x; the same for both.
    """

    _figures = (
        "filter",
        "error",
        "error_without",
        "ratio",
        "bands",
        "noise_deviation",
        "speed",
        "speed_noise",
        "best",
        "best_without",
        "best_ratio",
    )

    filter: SampledPhyFilter
    error: Interval
    error_without: Interval
    ratio: Interval
    omega: FloatArray = field(repr=False)
    left: FloatArray = field(repr=False)
    left_without: FloatArray = field(repr=False)
    passed: FloatArray = field(repr=False)
    noise_deviation: FloatArray
    speed: float
    speed_noise: float
    best: Suggestion
    best_without: Suggestion
    best_ratio: Interval
    noise: Noise = field(repr=False)

    @property
    def pays(self) -> bool:
        """Whether the interval of ``ratio`` lies below 1."""
        return self.ratio.high < 1.0

    def through(self, compliance: ct.TransferFunction | ct.StateSpace) -> tuple[float, float]:
        """Rms of what f - f_hat leads to, with the model and without it.

        Parameters
        ----------
        compliance : TransferFunction or StateSpace
            From f - f_hat of a channel to what counts; 1/(M s^2 + Kd s + Kp) to the position error of a mass under PD
            feedback.

        Returns
        -------
        with_model, without : float
            Over the channels, in the unit of the compliance's output.

        Raises
        ------
        TypeError, ValueError
            If it is no stable system of one input and one output.

        Notes
        -----
        From the spectra of these recordings, int |G|^2 (|1 - F|^2 S + |F|^2 S_n) domega: what a loop flown with the
        other estimate makes of the motion, and so of f, is not in it.
        """
        if not isinstance(compliance, ct.TransferFunction | ct.StateSpace):
            raise TypeError(
                f"compliance: expected a system of python-control, got {type(compliance).__name__}"
            )
        if compliance.ninputs != 1 or compliance.noutputs != 1 or np.any(np.real(compliance.poles()) >= 0.0):
            raise ValueError("compliance: expected a stable system of one input and one output")
        G = np.abs(np.atleast_1d(compliance(1j * self.omega))) ** 2
        with_model, without = (self._rms(G @ (left + self.passed)) for left in (self.left, self.left_without))
        return with_model, without

    def plot(self, *, ax: Axes | None = None, Hz: bool | None = None) -> ct.ControlPlot:
        """What the filter leaves with the model and without it, and the noise that it passes, over frequency.

        Parameters
        ----------
        ax : Axes, optional
            None makes a new figure.
        Hz : bool, optional
            Over Hz, densities per Hz; None: python-control's setting ``freqplot.Hz``.

        Returns
        -------
        control.ControlPlot
        """
        from ..plots.missed import density_plot

        densities = {
            "left without the model": self.left_without.sum(axis=1),
            "left with it": self.left.sum(axis=1),
            "noise passed": self.passed.sum(axis=1),
        }
        return density_plot(self.omega, densities, ax=ax, Hz=Hz)

    @property
    def bands(self) -> dict[str, tuple[float, float]]:
        """By rad/s: rms of what the filter leaves there, with the model and without it."""
        found = {}
        for low, high in pairwise((0.0, *_EDGES, math.inf)):
            inside = (self.omega >= low) & (self.omega < high)
            if inside.any():
                with_model, without = (
                    self._rms(left[inside].sum(axis=0)) for left in (self.left, self.left_without)
                )
                found[f"{low:g} to {min(high, float(self.omega[-1])):.3g}"] = with_model, without
        return found

    def _rms(self, sums: FloatArray) -> float:
        return math.sqrt(float(np.mean(sums) * self.omega[0]))


def model_value(
    recordings: Recording | Sequence[Recording],
    filter: PhyFilter | FilterBank | SampledPhyFilter | None = None,
    *,
    orders: Sequence[int] = (1, 2),
    confidence: float = 0.95,
    noise: Noise | ArrayLike | None = None,
    g: Rule = "hold",
    f_theta: Rule = "average",
) -> ModelValue:
    """By how much a learned model lowers the error of an estimate, and how fast a filter would have to be instead.

    Parameters
    ----------
    recordings : Recording or sequence of Recording
        As for :func:`estimate`, with f_theta. No label is needed.
    filter : PhyFilter, FilterBank or SampledPhyFilter, optional
        Judged with and without the model. None takes the best with it.
    orders, confidence, noise, g, f_theta
        As for :func:`estimate`.

    Returns
    -------
    ModelValue

    Raises
    ------
    TypeError, ValueError
        As for :func:`estimate`, and if a recording has no f_theta.

    Notes
    -----
    Both errors are expected ones by Stein's identity, with the noise that stands out clearest: that of the smaller
    residual, with the model.

    Examples
    --------
    A force of which the model knows a half, and velocity with noise of 1 mm/s at 100 Hz:

    >>> from phyfilter_ctl import PhyFilter
    >>> rng = np.random.default_rng(0)
    >>> f = 5.0 * np.sin(0.02 * np.cumsum(rng.standard_normal((6000, 1)), axis=0))
    >>> v = 0.01 * np.cumsum(np.vstack([[[0.0]], 0.5 * (f[1:] + f[:-1])]), axis=0)
    >>> v += 0.001 * rng.standard_normal(v.shape)
    >>> log = Recording.from_arrays(x=v, f_theta=0.5 * f, dt=0.01)
    >>> found = model_value(log, PhyFilter([2.0]))
    >>> found.pays, round(found.ratio.value, 1), round(found.speed), round(found.speed_noise)
    (True, 0.5, 4, 4)
    """
    logs = checked_logs(recordings)
    if missing := [log.name or f"number {i}" for i, log in enumerate(logs) if log.f_theta is None]:
        raise ValueError(f"recordings: expected f_theta in each, got none in {', '.join(missing)}")
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence: expected a number between 0 and 1, got {confidence}")
    orders = [_signals.count("orders", order) for order in orders]
    sampled = sampled_for(filter, logs, g, f_theta)
    shared = sampled.with_filter(sampled.filters[0])
    alone = [log.with_signals(f_theta=None) for log in logs]
    data, best = suggest(
        separate(parts := steps_of(logs, sampled), given_noise(noise, logs), confidence),
        Search(shared, parts, orders, _HORIZON, confidence),
    )
    level = data.separated.noise
    parts_alone = steps_of(alone, sampled)
    alone_data, best_alone = suggest(
        separate(parts_alone, level, confidence, data.separated.units),
        Search(shared, parts_alone, orders, _HORIZON, confidence),
    )
    if filter is None:
        sampled = sampled.with_filter(best.filter)
    sampled.recursion.channels(logs[0].n_x)
    ratio = _paired(data, alone_data, (sampled, sampled), confidence)
    dt = max(part.dt for part in parts)
    noisy = data.noise_deviation(sampled, dt)
    speed, faster = _as_good(sampled, data, alone_data)
    omega, left, passed = _left(data, sampled)
    return ModelValue(
        sampled,
        data.interval(sampled, confidence),
        alone_data.interval(sampled, confidence),
        ratio,
        omega,
        left,
        _left(alone_data, sampled)[1],
        passed,
        noisy,
        speed,
        math.inf if faster is None else _rms(data.noise_deviation(faster, dt)) / _rms(noisy),
        best,
        best_alone,
        _paired(
            data,
            alone_data,
            (shared.with_filter(best.filter), shared.with_filter(best_alone.filter)),
            confidence,
        ),
        level,
    )


def _rms(values: FloatArray) -> float:
    return math.sqrt(float(np.mean(values**2)))


def _paired(
    data: Unlabelled, alone: Unlabelled, filters: tuple[SampledPhyFilter, SampledPhyFilter], confidence: float
) -> Interval:
    """Ratio of two errors over the same stretches, leaving out one after the other."""
    squares = [
        each.without_each(sampled).mean(axis=1) for each, sampled in zip((data, alone), filters, strict=True)
    ]
    tiny = np.finfo(float).tiny
    ratios = np.sqrt(np.maximum(squares[0], 0.0) / np.maximum(squares[1], tiny))
    value, width = float(ratios[0]), spread(ratios[1:], confidence)
    if data.separated.noise.status is Status.NOT_IDENTIFIED:
        return Interval(value, 0.0, math.inf)
    return Interval(value, max(value - width, 0.0), value + width)


def _as_good(
    sampled: SampledPhyFilter, data: Unlabelled, alone: Unlabelled
) -> tuple[float, SampledPhyFilter | None]:
    """The slowest of the faster filters that err as little without the model as this one does with it."""
    aim = float(data.mean(sampled).mean())

    def made(speed: float) -> SampledPhyFilter:
        return sampled.with_filter([at_speed(each, speed) for each in sampled.filters])

    def beyond(speed: float) -> float:
        return float(alone.mean(made(speed)).mean()) - aim

    fastest = max(float(np.abs(each.poles).max()) for each in sampled.filters)
    speeds = [1.0, *(k for k in _SPEEDS[1:] if k * fastest * sampled.dt <= _FASTEST)]
    values = [beyond(k) for k in speeds]
    if values[0] <= 0.0:
        return 1.0, sampled
    for (a, at_a), (b, at_b) in pairwise(zip(speeds, values, strict=True)):
        if at_b <= 0.0 < at_a:
            k = cast(float, brentq(beyond, a, b, xtol=1e-3))
            return k, made(k)
    return math.inf, None


def _left(data: Unlabelled, sampled: SampledPhyFilter) -> tuple[FloatArray, FloatArray, FloatArray]:
    """omega above 0, densities of (1 - F) gamma and of F n.

    The spectrum is that of (1 - F) u in time: a window would leak what F has yet to take out.
    """
    remains = []
    for part in data.parts:
        u = part.on_grid(part.dt)
        times = part.times[0] + part.dt * np.arange(len(u) + 1)
        y = u - filtered(data.here(sampled, part), u)
        remains.append(replace(part, times=times, u=y, uniform=True))
    of_u = data.separated.spectrum
    omega = of_u.omega[1:]
    density = residual_spectrum(remains, np.zeros((1, len(data.separated.noise.value)))).residual[1:]
    F = np.stack([np.atleast_1d(each(1j * omega)) for each in sampled.filters], axis=1)
    noise = of_u.noise[1:]
    density[omega > data.limit] = 0.0
    return omega, np.maximum(density - np.abs(1.0 - F) ** 2 * noise, 0.0), np.abs(F) ** 2 * noise
