"""Which filter: the expected error of f_hat without knowing f, and the filter for which it is least."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt, sosfreqz
from scipy.stats import norm

from .._sections import ComplexArray, FloatArray
from ..design import lowpass
from ..filter import PhyFilter, SampledPhyFilter
from ..results import Interval, Result, SearchResult, Status
from .levels import Separated
from .likelihood import Levels
from .prediction import Prediction, prediction
from .spectrum import BEYOND, SHARED, density
from .steps import Steps, filtered, jackknife, least, spread, units_of

__all__ = ["Search", "Suggestion", "Unlabelled", "suggest"]

_MOVED = 1e-3  # of a parameter of the spectrum, for slopes
_POINTS = 20  # of the scan over rates
_FASTEST = 3.0  # rate times step, beyond which the sampled filter hardly changes
_WORTH = 0.01  # an order more has to lower the error by this share
_WORSE = 0.05  # share by which the prediction may be worse where the noise is in doubt
_NARROWEST = 30.0  # that is at least so many rad over a recording
# Integrals over frequency are sums over cells: narrow where poles may be, even where noise and its colour are.
_EDGES = np.pi * np.concatenate([[0.0], np.geomspace(1e-5, 0.1, 300), np.linspace(0.1, 1.0, 301)[1:]])
_THETA = 0.5 * (_EDGES[1:] + _EDGES[:-1])
_WEIGHTS = np.diff(_EDGES) / np.pi
_SINC = np.sinc(0.5 * _THETA / np.pi)[:, None]  # of a mean over a step


@dataclass(frozen=True, repr=False)
class Suggestion(Result, SearchResult[PhyFilter]):
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

    @property
    def best(self) -> PhyFilter:
        """``filter``: what every search calls what it found."""
        return self.filter


class Unlabelled:
    """Recordings as a cost of filters: the expected square of f - f_hat, f not known.

    The error of a filter F is (1 - F) gamma - F n, n the noise of u, independent of gamma. So Stein's identity (Ann.
    Statist. 9 (6), 1981)

        E |gamma - F u|^2 = E |u - F u|^2 + 2 sum_j r_n(j) phi_j - r_n(0),    r_n(j) = E n_k n_(k-j)

    holds for a filter of taps phi; it is E |(1 - F) u|^2 - E |(1 - F) n|^2 + E |F n|^2. What is left of n in the first
    two terms is chance, most of it where gamma is not. So both are taken below a frequency beyond which gamma is lost
    in the noise, by the zero-phase filter L; beyond, E |(1 - F) gamma|^2 is that of a spectrum that falls on as a power
    of the frequency, as it does around there. And u is the mean over a step, but f_hat is meant for its end, or, with x
    measured late, for later: the line through the means of two steps, A u, stands for gamma there.

    Steps that differ are replaced by equal ones here, each with its mean of u.
    """

    def __init__(self, parts: Sequence[Steps], separated: Separated) -> None:
        self.parts: Sequence[Steps] = parts
        self.separated: Separated = separated
        longest = max(float(part.times[-1] - part.times[0]) for part in parts)
        self.limit: float = max(BEYOND * separated.spectrum.crossing, _NARROWEST / longest)
        self._sections: dict[float, FloatArray | None] = {}
        self.signals: list[FloatArray] = [self.passed(part.on_grid(part.dt), part.dt) for part in parts]
        self._white = [part.noise_density(part.dt, _THETA)[:, None] for part in parts]
        self._passed = [self._power(part.dt, _THETA)[:, None] for part in parts]

    def passed(self, signal: FloatArray, dt: float) -> FloatArray:
        """L of a signal."""
        sos = self._sos(dt)
        if sos is None:
            return signal
        # Reflected, not turned, about the end: the noise of a single u is far stronger than what L leaves of it.
        return sosfiltfilt(sos, signal, axis=0, padtype="even", padlen=min(len(signal) - 1, 100))

    def _sos(self, dt: float) -> FloatArray | None:
        if dt not in self._sections:
            share = self.limit * dt / np.pi  # of the Nyquist frequency
            self._sections[dt] = None if share > 0.8 else np.asarray(butter(4, share, output="sos"))
        return self._sections[dt]

    def _power(self, dt: float, theta: FloatArray) -> FloatArray:
        sos = self._sos(dt)
        return np.ones_like(theta) if sos is None else np.abs(sosfreqz(sos, theta)[1]) ** 4

    def correction(
        self, k: int, sampled: SampledPhyFilter | None, several: Sequence[Levels]
    ) -> list[FloatArray]:
        """E |gamma - F u|^2 less E |L (A - F) u|^2 of recording k, (n_x,) by levels; None is F = 0 and A = 1."""
        part, passed = self.parts[k], self._passed[k]
        F: ComplexArray = np.zeros((len(_THETA), 1), dtype=np.complex128)
        A, instant = np.ones_like(F), np.ones_like(F)
        if sampled is not None:
            F = np.stack([_response(each) for each in _each(self.here(sampled, part))], axis=1)
            A, instant = _references(sampled, part.dt)
        steps = 2.0 * (1.0 - np.cos(_THETA))[:, None] / part.dt**2
        left, through = passed * self._white[k] * np.abs(A - F) ** 2, steps * np.abs(F) ** 2
        unseen = (1.0 - passed) * np.abs(instant - _SINC * F) ** 2
        falling = np.maximum(_THETA / part.dt, self.limit / BEYOND)  # below, L passes it anyway
        found = []
        for levels in several:
            noise = density(levels.covariance, _THETA)
            total = _WEIGHTS @ ((through - left) * noise)
            if self._sos(part.dt) is not None:
                total += _WEIGHTS @ (unseen * levels.residual(falling, part.dt))
                total += levels.residual_beyond(part.dt)
            found.append(total)
        return found

    def here(self, sampled: SampledPhyFilter, part: Steps) -> SampledPhyFilter:
        """The filter at a recording's own step."""
        return replace(sampled, sampling=replace(sampled.sampling, dt=part.dt))

    def squares(self, sampled: SampledPhyFilter | None) -> list[FloatArray]:
        """Rows (m, n_x + 1): square of L (A - F) u by channel, of L u for None, times the step; and the step."""
        rows = []
        for part, u in zip(self.parts, self.signals, strict=True):
            error = u
            if sampled is not None:
                y = filtered(self.here(sampled, part), u)
                j, w = _later(sampled, part.dt)
                count = max(len(u) - j - 1, 1)
                error = (1.0 - w) * u[j:][:count] + w * u[j + 1 :][:count] - y[:count]
            rows.append(part.dt * np.hstack([error**2, np.ones((len(error), 1))]))
        return rows

    def noise_deviation(self, sampled: SampledPhyFilter, dt: float) -> FloatArray:
        """Standard deviation (n_x,) of f_hat that comes from the noise, at equal steps."""
        here = replace(sampled, sampling=replace(sampled.sampling, dt=dt))
        F = np.stack([_response(each) for each in _each(here)], axis=1)
        steps = 2.0 * (1.0 - np.cos(_THETA))[:, None] / dt**2
        return np.sqrt(
            _WEIGHTS @ (np.abs(F) ** 2 * steps * density(self.separated.levels.covariance, _THETA))
        )

    def mean(self, sampled: SampledPhyFilter | None) -> FloatArray:
        """Expected square of gamma - F u by channel (n_x,), of gamma for None."""
        return self._means(sampled, [self.separated.levels], np.zeros(1, dtype=int))[0]

    def _means(
        self, sampled: SampledPhyFilter | None, several: Sequence[Levels], without: NDArray[np.intp]
    ) -> FloatArray:
        """By levels (len, n_x), each without the unit of that number less 1; 0 is none."""
        rows = self.squares(sampled)
        units = units_of(rows, self.separated.units)
        lasts = [float(row[:, -1].sum()) for row in rows]
        corrections = [self.correction(k, sampled, several) for k in range(len(rows))]
        mean = np.average(np.array(corrections), axis=0, weights=lasts)
        total = units.sum(axis=0)
        left = total - np.vstack([np.zeros_like(total), units])[without]
        return left[:, :-1] / left[:, -1:] + mean

    def without_each(self, sampled: SampledPhyFilter) -> FloatArray:
        """As :meth:`mean` (1 + units, n_x), then without each of the stretches, noise and spectrum found anew."""
        found = self.separated
        return self._means(sampled, [found.levels, *found.without], np.arange(1 + len(found.without)))

    def interval(self, sampled: SampledPhyFilter, confidence: float) -> Interval:
        """Root of the expected square of gamma - F u, mean over the channels.

        Student's interval of its logarithm, whose deviation does not grow with it, by the jackknife over the stretches,
        noise and spectrum found anew without each one. What is not known of a noise that was given comes on top. It
        reaches up to the roughest residual that the stretches allow. From 0 to inf where noise and residual cannot be
        told apart. It is no shorter than by :meth:`_deviation`, since few stretches may be alike by chance.
        """
        found, count = self.separated, len(self.separated.units)
        several = [found.levels, *found.without, found.rough, *found.ends]
        numbers = np.array([*range(count + 1), 0, 0, 0][: len(several)])
        squares = self._means(sampled, several, numbers).mean(axis=1)
        square, value = float(squares[0]), math.sqrt(max(float(squares[0]), 0.0))
        if found.noise.status is Status.NOT_IDENTIFIED:
            return Interval(value, 0.0, math.inf)
        if squares[: count + 1].min() <= 0.0:
            high = float(squares.max()) + spread(squares[1 : count + 1], confidence)
            return Interval(value, 0.0, math.sqrt(max(high, 0.0)))
        gaussian = float(norm.ppf(0.5 + 0.5 * confidence)) * self._deviation(sampled, square)
        known = 0.5 * float(squares[-1] - squares[-2]) / square if found.ends else 0.0
        share = math.hypot(max(spread(np.log(squares[1 : count + 1]), confidence), gaussian), known)
        # As exp(share / 2), but for a share so large that nothing is known.
        width = math.sqrt(1.0 + share + 0.5 * share**2)
        high = max(value * width, math.sqrt(max(float(squares[count + 1]), 0.0)))
        return Interval(value, value / width, high)

    def _deviation(self, sampled: SampledPhyFilter, square: float) -> float:
        """Standard deviation, as a share of it, of the mean of :meth:`mean` over the channels, for a Gaussian u.

        A band whose mean of m values of the periodogram is off by the share e, of variance 1 / m (times what the window
        shares between neighbours), changes |L (A - F) u|^2 by |L (A - F)|^2 S e m / M, with M values in all, and the
        correction by its slopes times the parameters' answer to e. The two counteract. Below the bands u is gamma, and
        what it is by chance is in the error that was made as well.
        """
        fit = self.separated.fit
        bands, count = fit.bands, fit.bands.counts.sum(axis=0)
        lengths = [len(part.u) * part.dt for part in self.parts]
        k = int(np.argmin([abs(part.dt - bands.dt) for part in self.parts]))
        several = fit.moved(_MOVED)
        means = np.average(
            [self.correction(k, sampled, several) for k in range(len(self.parts))], axis=0, weights=lengths
        )
        F = np.stack([_response(each) for each in _each(self.here(sampled, self.parts[k]))], axis=1)
        through = self._passed[k] * np.abs(_references(sampled, self.parts[k].dt)[0] - F) ** 2
        variance, n = 0.0, means.shape[1]
        for i, column in enumerate(np.broadcast_to(through, (len(_THETA), n)).T):
            spectrum, answers = fit.answers(i)
            seen = np.interp(bands.theta, _THETA, column) * spectrum * count * 2.0 * bands.dt / sum(lengths)
            change = seen + answers @ (means[1:, i] - means[0, i]) / _MOVED
            variance += SHARED * float(np.sum((change / (n * square)) ** 2 / count))
        return math.sqrt(variance)


def _later(sampled: SampledPhyFilter, dt: float) -> tuple[int, float]:
    """f_hat is meant for (1 - w) u_(k+j) + w u_(k+j+1): half a step after the middle of step k, and the delay of x."""
    place = 0.5 + sampled.sampling.delay / dt
    return int(place), place - int(place)


def _references(sampled: SampledPhyFilter, dt: float) -> tuple[ComplexArray, ComplexArray]:
    """(K, 1): A, and what f_hat is meant for itself, gamma at an instant counted from the middle of step k."""
    j, w = _later(sampled, dt)
    z: ComplexArray = np.exp(1j * _THETA)[:, None]
    return z**j * (1.0 - w + w * z), np.asarray(z ** (j + w), dtype=np.complex128)


def _each(sampled: SampledPhyFilter) -> list[SampledPhyFilter]:
    return [sampled.with_filter(filter) for filter in sampled.filters]


def _response(sampled: SampledPhyFilter) -> ComplexArray:
    dA, equilibrium, C = sampled.transition
    z = np.exp(1j * _THETA)
    states = np.linalg.solve((z[:, None, None] - 1.0) * np.eye(len(C)) - dA, -dA @ equilibrium)
    return np.asarray(z * (states @ C), dtype=np.complex128)


def _gain(data: Unlabelled, sampled: SampledPhyFilter, confidence: float) -> Interval:
    """How far a filter's square of the error lies below that of none, gamma itself, as a share of the square of u.

    The mean of the units' shares: forces come in bursts, and one unit must not decide.
    """
    levels = [data.separated.levels]
    rows = []
    for k, (part, u, a, b) in enumerate(
        zip(data.parts, data.signals, data.squares(None), data.squares(sampled), strict=True)
    ):
        less = data.correction(k, None, levels)[0] - data.correction(k, sampled, levels)[0]
        count = len(b)
        gained = a[:count, :-1] - b[:, :-1] + part.dt * less
        rows.append(np.hstack([gained, part.dt * u[:count] ** 2]))
    units, n = units_of(rows, data.separated.units), rows[0].shape[1] // 2
    shares = units[:, :n].sum(axis=1) / np.maximum(units[:, n:].sum(axis=1), np.finfo(float).tiny)
    counted = np.stack([shares, np.ones_like(shares)], axis=1)
    return jackknife(counted, lambda total: float(total[0] / total[1]), confidence)


@dataclass(frozen=True, eq=False)
class Search:
    """Butterworth filters of some orders, scanned over their bandwidth; the options of sampling are those given."""

    sampled: SampledPhyFilter
    parts: Sequence[Steps]
    orders: Sequence[int]
    horizon: float
    confidence: float

    @property
    def ends(self) -> tuple[float, float]:
        """Logarithms of the slowest and the fastest pole."""
        longest = max(part.times[-1] - part.times[0] for part in self.parts)
        return math.log(2.0 / longest), math.log(_FASTEST / min(part.dt for part in self.parts))

    def made(self, order: int, rate: float) -> SampledPhyFilter:
        """The filter of an order at a bandwidth, its logarithm given."""
        return self.sampled.with_filter(lowpass(order, math.exp(rate), family="butterworth"))

    def least(self, cost: Callable[[SampledPhyFilter], float]) -> dict[int, tuple[float, float]]:
        """By order: the rate and the cost."""
        grid = np.linspace(*self.ends, _POINTS)
        return {n: least(lambda rate, n=n: cost(self.made(n, rate)), grid) for n in sorted(set(self.orders))}

    def ahead(self, sampled: SampledPhyFilter) -> Prediction:
        """How well f_hat of a filter foretells x."""
        return prediction(sampled, self.parts, self.horizon, self.confidence)


def suggest(several: Sequence[Separated], search: Search) -> tuple[Unlabelled, Suggestion]:
    """The filter of least expected error; the recordings as the separation shows them that it rests on.

    Where the noise is not white and a filter of best prediction predicts anything, the suggestion may not predict
    worse: else noise and residual were not told apart, and the filter of best prediction it is.
    """
    data = Unlabelled(search.parts, several[0])
    found = _least_error(data, search)
    if len(several) == 1 and several[0].noise.status is not Status.NOT_IDENTIFIED:
        return data, found
    by_order = search.least(lambda sampled: search.ahead(sampled).filter)
    order = min(by_order, key=lambda n: by_order[n][1])
    best = search.made(order, by_order[order][0])
    foretold = search.ahead(best)
    for separated in several:
        data = Unlabelled(search.parts, separated)
        found = _least_error(data, search)
        rms = search.ahead(search.made(found.filter.order, math.log(found.bandwidth))).filter
        if rms <= (1.0 + _WORSE) * foretold.filter:
            return data, found
    if not foretold.improves:
        return data, found
    listed = {
        n: (math.exp(rate), math.sqrt(max(float(data.mean(search.made(n, rate)).mean()), 0.0)))
        for n, (rate, _) in by_order.items()
    }
    error = data.interval(best, search.confidence)
    message = f"it predicts x {search.horizon:g} s ahead best; its expected error is not known"
    return data, Suggestion(best.filters[0], listed[order][0], error, listed, Status.CONVERGED, message)


def _least_error(data: Unlabelled, search: Search) -> Suggestion:
    low, high = search.ends
    found = search.least(lambda sampled: float(data.mean(sampled).mean()))
    found = {order: (rate, max(value, 0.0)) for order, (rate, value) in found.items()}
    best = min(value for _, value in found.values())
    order = min(n for n, (_, value) in found.items() if value <= best * (1.0 + _WORTH) ** 2)
    rate = found[order][0]
    chosen = search.made(order, rate)
    gain = _gain(data, chosen, search.confidence)
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
    error = data.interval(chosen, search.confidence)
    return Suggestion(chosen.filters[0], math.exp(rate), error, listed, status, message)
