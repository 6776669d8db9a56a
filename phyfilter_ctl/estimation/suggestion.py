"""Which filter: the expected error of f_hat without knowing f, and the filter for which it is least."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.signal import butter, sosfiltfilt, sosfreqz

from .._sections import FloatArray
from ..analysis import error_variance
from ..design import lowpass
from ..design.optimal import Interval
from ..filter import PhyFilter, SampledPhyFilter
from ..results import Result, Status
from .spectrum import BEYOND
from .steps import Steps, filtered, jackknife, least, units_of

__all__ = ["Suggestion", "Unlabelled", "error_of", "suggest"]

_POINTS = 20  # of the scan over rates
_FASTEST = 3.0  # rate times step, beyond which the sampled filter hardly changes
_WORTH = 0.01  # an order more has to lower the error by this share
_NARROWEST = 30.0  # that is at least so many rad over a recording
_PASSED = 4.0  # times its edge, nothing passes L any more
_CELLS = (np.arange(500) + 0.5) / 500  # of integrals over frequency


@dataclass(frozen=True, repr=False)
class Suggestion(Result):
    """The filter of least expected error, found without labels.

    Attributes
    ----------
    filter : PhyFilter
        Butterworth's, low-pass form: at order 2 the steady Kalman filter of a force that is a random walk.
    bandwidth : float
        Of -3 dB, rad/s.
    error : Interval
        Root of the expected mean square of f - f_hat over time and channels, in the unit of f.
    orders : dict of int to (float, float)
        Best bandwidth and error of each order tried. A higher order is taken where it lowers the error by 1 % or more.
    status : Status
        CONVERGED, AT_BOUND, or NOT_IDENTIFIED where no filter is expected to be better than f_theta alone.
    message : str
    """

    filter: PhyFilter
    bandwidth: float
    error: Interval
    orders: dict[int, tuple[float, float]]
    status: Status
    message: str


class Unlabelled:
    """Recordings as a cost of filters: the expected square of f - f_hat, f not known.

    The error of a filter F is (1 - F) gamma - F n, n the noise of u, independent of gamma. So Stein's identity (Ann.
    Statist. 9 (6), 1981)

        E |gamma - F u|^2 = E |u - F u|^2 + 2 sum_j r_n(j) phi_j - r_n(0),    r_n(j) = E n_k n_(k-j)

    holds for a filter of taps phi; it is E |(1 - F) u|^2 - E |(1 - F) n|^2 + E |F n|^2. What is left of n in the first
    two terms is chance, most of it where gamma is not. So both are taken below a frequency beyond which gamma is lost
    in the noise, by the zero-phase filter L: much less chance, and the same expectation as long as gamma passes L. And
    u is the mean over a step, but f_hat is meant for its end: the mean of two steps, A u, stands for gamma there.

    Steps that differ are replaced by equal ones here, each with its mean of u.
    """

    def __init__(self, parts: Sequence[Steps], noise: FloatArray, crossing: float) -> None:
        self.noise: FloatArray = noise
        self.parts: Sequence[Steps] = parts
        longest = max(float(part.times[-1] - part.times[0]) for part in parts)
        self.limit: float = max(BEYOND * crossing, _NARROWEST / longest)
        self.signals: list[FloatArray] = [self.passed(part.on_grid(part.dt), part.dt) for part in parts]
        # Angles up to where nothing passes L, and |L|^2 times the spectrum of n for noise 1 of x there.
        self._angles = [np.pi * min(1.0, _PASSED * self.limit * part.dt / np.pi) * _CELLS for part in parts]
        self._densities = [
            theta[-1] / np.pi * part.noise_density(part.dt, theta) * self._power(part.dt, theta)
            for part, theta in zip(parts, self._angles, strict=True)
        ]

    def passed(self, signal: FloatArray, dt: float) -> FloatArray:
        """L of a signal."""
        sos = self._sos(dt)
        return signal if sos is None else sosfiltfilt(sos, signal, axis=0, padlen=min(len(signal) - 1, 100))

    def _sos(self, dt: float) -> FloatArray | None:
        share = self.limit * dt / np.pi  # of the Nyquist frequency
        return None if share > 0.8 else np.asarray(butter(4, share, output="sos"))

    def _power(self, dt: float, theta: FloatArray) -> FloatArray:
        sos = self._sos(dt)
        return np.ones_like(theta) if sos is None else np.abs(sosfreqz(sos, theta)[1]) ** 4

    def left(self, k: int, filter: SampledPhyFilter | None = None) -> float:
        """E |L (A - F) n|^2 of recording k for noise 1 of x; without a filter E |L n|^2."""
        if filter is None:
            return float(np.mean(self._densities[k]))
        dA, equilibrium, C = filter.transition
        z = np.exp(1j * self._angles[k])
        states = np.linalg.solve((z[:, None, None] - 1.0) * np.eye(len(C)) - dA, -dA @ equilibrium)
        return float(np.mean(self._densities[k] * np.abs(0.5 * (1.0 + z) - z * (states @ C)) ** 2))

    def squares(self, sampled: SampledPhyFilter | None) -> list[FloatArray]:
        """Rows (m, n_x + 1): square of gamma - F u by channel, of gamma for None, times the step; and the step."""
        rows = []
        for k, (part, u) in enumerate(zip(self.parts, self.signals, strict=True)):
            error, power = u, np.full(len(self.noise), -self.left(k))
            if sampled is not None:
                here = replace(sampled, sampling=replace(sampled.sampling, dt=part.dt))
                each = [here.with_filter(filter) for filter in here.filters]
                power = [error_variance(one, noise=1.0).noise - self.left(k, one) for one in each]
                error = 0.5 * (u + np.concatenate([u[1:], u[-1:]])) - filtered(here, u)
            rows.append(part.dt * np.hstack([error**2 + power * self.noise**2, np.ones((len(u), 1))]))
        return rows


def error_of(rows: Sequence[FloatArray], confidence: float) -> Interval:
    """Root of the mean of :meth:`Unlabelled.squares` over time and channels, with an interval."""
    found = jackknife(units_of(rows), _mean, confidence)
    return Interval(*(math.sqrt(max(value, 0.0)) for value in found))


def _mean(total: FloatArray) -> float:
    return float(total[:-1].mean() / total[-1])


def _gain(data: Unlabelled, chosen: Sequence[FloatArray], confidence: float) -> Interval:
    """How far a filter's square of the error lies below that of none, gamma itself, as a share of the square of u.

    The mean of the units' shares: forces come in bursts, and one unit must not decide.
    """
    n = len(data.noise)
    rows = [
        np.hstack([a[:, :n] - b[:, :n], part.dt * u**2])
        for part, u, a, b in zip(data.parts, data.signals, data.squares(None), chosen, strict=True)
    ]
    units = units_of(rows)
    shares = units[:, :n].sum(axis=1) / np.maximum(units[:, n:].sum(axis=1), np.finfo(float).tiny)
    counted = np.stack([shares, np.ones_like(shares)], axis=1)
    return jackknife(counted, lambda total: float(total[0] / total[1]), confidence)


def suggest(
    data: Unlabelled, sampled: SampledPhyFilter, orders: Sequence[int], confidence: float
) -> Suggestion:
    """The pole and the order of least expected error; the options of sampling are those of ``sampled``."""
    parts = data.parts
    low = math.log(2.0 / max(part.times[-1] - part.times[0] for part in parts))
    high = math.log(_FASTEST / min(part.dt for part in parts))

    def rows(order: int, rate: float) -> list[FloatArray]:
        return data.squares(sampled.with_filter(lowpass(order, math.exp(rate), family="butterworth")))

    def cost(order: int, rate: float) -> float:
        return _mean(np.sum([part.sum(axis=0) for part in rows(order, rate)], axis=0))

    grid = np.linspace(low, high, _POINTS)
    found = {order: least(partial(cost, order), grid) for order in sorted(set(orders))}
    found = {order: (rate, max(value, 0.0)) for order, (rate, value) in found.items()}
    best = min(value for _, value in found.values())
    order = min(n for n, (_, value) in found.items() if value <= best * (1.0 + _WORTH) ** 2)
    rate = found[order][0]
    chosen = rows(order, rate)
    gain = _gain(data, chosen, confidence)
    status, message = Status.CONVERGED, "converged"
    if gain.low <= 0.0:
        status = Status.NOT_IDENTIFIED
        message = (
            "no filter is better than none for sure: what the model misses hardly stands out of the noise"
        )
    elif not low + 0.05 < rate < high - 0.05:
        status = Status.AT_BOUND
        side, more = ("slowest", "longer") if rate < 0.5 * (low + high) else ("fastest", "faster sampled")
        message = f"the {side} pole tried is the best; {more} recordings would tell more"
    listed = {n: (math.exp(x), math.sqrt(value)) for n, (x, value) in found.items()}
    filter = lowpass(order, math.exp(rate), family="butterworth")
    return Suggestion(filter, math.exp(rate), error_of(chosen, confidence), listed, status, message)
