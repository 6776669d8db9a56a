"""Noise and residual as a model of the spectrum of u, and the largest likelihood of its parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from .._sections import FloatArray
from .noise import covariance_of
from .spectrum import SHARED, density, periodogram
from .steps import Steps, Stretch

__all__ = [
    "STEEPNESS",
    "Bands",
    "Fit",
    "Levels",
    "bands_of",
    "channel",
    "column",
    "fits_of",
    "levels_of",
    "model_of",
    "points_of",
]

_RATIO = 1.15  # of the edges of a band
STEEPNESS = (5.0 / 3.0, 12.0)  # of p; no force is rougher than turbulence, of 5/3
_ITERATIONS, _STEP, _ENOUGH = 60, 1e-6, 1e-10  # of the search for the largest likelihood
_REFLECTIONS = ((1.5, 0.0), (1.0, -0.7), (0.0, -0.7))  # inverse hyperbolic tangents to search from, beside 0
_SLOPE = 1e-4  # of differences
_LAGS = 1024  # at which the covariance of an autoregression is looked at
_DOUBT, _MISFIT = 0.01, 0.1  # a model of the noise is wrong where less likely, and off by more, than this


@dataclass(frozen=True, eq=False)
class Bands:
    """Periodograms of u, summed over bands of theta = omega h.

    Attributes
    ----------
    theta, shape : (K,) arrays
        Centres, and the spectrum there of the noise of u for white noise 1 of M x.
    sums, counts : (units, K, n_x) and (units, K) arrays
        By independent stretch.
    dt : float
        Of the common grid.
    """

    theta: FloatArray
    shape: FloatArray
    sums: FloatArray
    counts: FloatArray
    dt: float


@dataclass(frozen=True, eq=False)
class Levels:
    """What is taken from the spectrum of u.

    Attributes
    ----------
    covariance : (J + 1, n_x) array
        Of the noise of M x at lags of 0 to J steps.
    power, steepness : (n_x,) arrays
        C and p of the residual above the crossing; C is 0 where there is none.
    dt : float
        Step that theta belongs to.
    """

    covariance: FloatArray
    power: FloatArray
    steepness: FloatArray
    dt: float

    def residual(self, omega: FloatArray, dt: float) -> FloatArray:
        """Spectrum (K, n_x) over omega dt of what the residual leaves above the crossing."""
        return self.power * (omega[:, None] * self.dt) ** -self.steepness * self.dt / dt

    def residual_beyond(self, dt: float) -> FloatArray:
        """Its power (n_x,) above the Nyquist frequency of these steps."""
        edge = np.array([np.pi / dt])
        return self.residual(edge, dt)[0] / (self.steepness - 1.0)


def bands_of(parts: Sequence[Steps], units: Sequence[Sequence[Stretch]], lowest: float) -> Bands:
    """Bands from ``lowest`` rad/s up to the Nyquist frequency; ``units`` are stretches of the recordings' own grids."""
    dt = max(part.dt for part in parts)
    signals = [part.on_grid(dt) for part in parts]
    share = [part.dt / dt for part in parts]
    units = [[(k, int(a * share[k]), int(b * share[k])) for k, a, b in unit] for unit in units]
    longest = max(b - a for unit in units for _, a, b in unit)
    theta = max(lowest * dt, 6.0 * np.pi / longest)
    edges = np.geomspace(
        min(theta, 0.5 * np.pi), np.pi * (1.0 + 1e-9), 2 + int(np.log(np.pi / theta) / np.log(_RATIO))
    )
    gathered = [_gathered(unit, signals, edges) for unit in units]
    sums, counts = (np.array(each) for each in zip(*gathered, strict=True))
    filled = counts.sum(axis=0) > 0.0
    centres = np.sqrt(edges[1:] * edges[:-1])[filled]
    shapes = [part.noise_density(dt, centres) for part in parts]
    shape = np.average(shapes, axis=0, weights=[len(u) for u in signals])
    return Bands(centres, shape, sums[:, filled], counts[:, filled], dt)


def _gathered(
    unit: Sequence[Stretch], signals: Sequence[FloatArray], edges: FloatArray
) -> tuple[FloatArray, FloatArray]:
    sums, counts = np.zeros((len(edges) - 1, signals[0].shape[1])), np.zeros(len(edges) - 1)
    for k, first, last in unit:
        if last - first < 8:
            continue
        power = periodogram(signals[k][first:last])
        where = np.digitize(2.0 * np.pi / (last - first) * np.arange(len(power)), edges) - 1
        inside = (where >= 0) & (where < len(counts))
        np.add.at(sums, where[inside], power[inside])
        counts += np.bincount(where[inside], minlength=len(counts))
    return sums, counts


@dataclass(frozen=True, eq=False)
class Fit:
    """The model where its likelihood is largest.

    Attributes
    ----------
    bands : Bands
    points : list of arrays
        By channel (log C, p, log s^2, reflections).
    known : (J + 1, n_x) array, optional
        Covariance of a noise that was given.
    """

    bands: Bands
    points: list[FloatArray]
    known: FloatArray | None

    @property
    def _free(self) -> FloatArray:
        """Unit vectors (P, len(point)) of what was fitted."""
        count = len(self.points[0])
        fitted = [bool(np.isfinite(self.points[0][0]))] * 2 + [self.known is None] * (count - 2)
        return np.eye(count)[fitted]

    def moved(self, by: float) -> list[Levels]:
        """Those of the points, and of each of the P parameters moved, in all channels at once."""
        ways = [np.zeros(len(self.points[0])), *self._free]
        return [levels_of([z + by * way for z in self.points], self.bands.dt, self.known) for way in ways]

    def answers(self, i: int) -> tuple[FloatArray, FloatArray]:
        """Spectrum S (K,) of channel i, and (K, P) by how much the parameters follow a band's share of it too much.

        H^-1 J' m for bands of m values, J the slopes of log S and H = J' diag(m) J Fisher's information.
        """
        known, count = column(self.known, i), self.bands.counts.sum(axis=0)[:, None]
        first, *others = (
            np.sum(model_of(self.points[i] + way, self.bands, known), axis=0)
            for way in (np.zeros(len(self.points[i])), *_SLOPE * self._free)
        )
        if not others:
            return first, np.zeros((len(first), 0))
        J = np.log(np.stack(others, axis=1) / first[:, None]) / _SLOPE
        return first, count * J @ np.linalg.pinv(J.T @ (count * J))


def points_of(bands: Bands, order: int, force: bool, known: FloatArray | None) -> list[FloatArray]:
    """By channel (log C, p, log s^2, reflections); no residual where there is no ``force``."""
    count = bands.counts.sum(axis=0)
    means = (bands.sums.sum(axis=0) / count[:, None]).T
    return [channel(bands, mean, count, order, force, column(known, i), None) for i, mean in enumerate(means)]


def column(known: FloatArray | None, i: int) -> FloatArray | None:
    """Of channel i, (J + 1, 1)."""
    return None if known is None else known[:, i : i + 1]


def _noise(point: FloatArray, theta: FloatArray, known: FloatArray | None) -> FloatArray:
    if known is not None:
        return density(known, theta)[:, 0]
    return np.exp(point[2]) * _colour(np.tanh(point[3:]), theta)


def _colour(reflections: FloatArray, theta: FloatArray) -> FloatArray:
    """Spectrum of the stable autoregression with these partial correlations (Levinson's recursion), driven by 1."""
    a = np.array([1.0])
    for k in reflections:
        a = np.append(a, 0.0) - k * np.append(a, 0.0)[::-1]
    return 1.0 / np.abs(np.exp(-1j * np.outer(theta, np.arange(len(a)))) @ a) ** 2


def model_of(point: FloatArray, bands: Bands, known: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Residual and noise."""
    noise = bands.shape * _noise(point, bands.theta, known)
    mean = np.sinc(0.5 * bands.theta / np.pi) ** 2
    return np.exp(point[0]) * bands.theta ** -point[1] * mean, noise


def channel(
    bands: Bands,
    mean: FloatArray,
    count: FloatArray,
    order: int,
    force: bool,
    known: FloatArray | None,
    start: FloatArray | None,
    steepness: tuple[float, float] = STEEPNESS,
) -> FloatArray:
    """(log C, p, log s^2, reflections) of one channel."""
    size = float(np.log(max(float(np.mean(mean)), 1e-300)))
    high = bands.theta > 0.5 * np.pi
    level = float(np.log(max(float(np.mean((mean / bands.shape)[high])), 1e-300)))
    first = float(np.log(max(mean[0], 1e-300)) + 2.0 * np.log(bands.theta[0]))
    begun = np.array([first if force else -np.inf, 2.0, level, *np.zeros(order)]) if start is None else start
    free = np.array([force, force, known is None, *[known is None] * order])
    if not free.any():
        return begun
    begins = [begun]
    if start is None and order:
        begins += [np.array([*begun[:3], *each[:order]]) for each in _REFLECTIONS]
    limits = [(first - 40.0, first + 40.0), steepness, (level - 40.0, level + 8.0), *[(-4.0, 4.0)] * order]
    low, high = (np.array(each)[free] for each in zip(*limits, strict=True))

    def model(values: FloatArray) -> FloatArray:
        point = begun.copy()
        point[free] = np.clip(values, low, high)
        return np.maximum(np.sum(model_of(point, bands, known), axis=0), 1e-12 * np.exp(size))

    def loss(values: FloatArray) -> float:
        found = model(values)
        return float(count @ (np.log(found) - size + mean / found))

    weight = count[:, None]
    ends = [_scored(model, loss, weight, mean, np.clip(each[free], low, high), low, high) for each in begins]
    point = begun.copy()
    point[free] = min(ends, key=loss)
    return point


def _scored(
    model: Callable[[FloatArray], FloatArray],
    loss: Callable[[FloatArray], float],
    weight: FloatArray,
    mean: FloatArray,
    values: FloatArray,
    low: FloatArray,
    high: FloatArray,
) -> FloatArray:
    """Fisher's scoring with a damped step, within bounds."""
    cost, damping = loss(values), 1e-3
    for _ in range(_ITERATIONS):
        now = model(values)
        moved = values + _STEP * np.eye(len(values))
        J = np.stack([np.log(model(each) / now) for each in moved], axis=1) / _STEP
        slope, H = J.T @ (weight[:, 0] * (mean / now - 1.0)), J.T @ (weight * J)
        free = ~(((values <= low) & (slope < 0.0)) | ((values >= high) & (slope > 0.0)))
        while damping < 1e6:
            step = np.zeros_like(values)
            part = H[free][:, free]
            ridge = (damping * np.diag(part).max(initial=0.0) + 1e-12) * np.eye(len(part))
            step[free] = np.linalg.solve(part + ridge, slope[free])
            tried = np.clip(values + step, low, high)
            if (found := loss(tried)) <= cost:
                break
            damping *= 10.0
        else:
            return values
        done = cost - found < _ENOUGH * float(weight.sum())
        values, cost, damping = tried, found, 0.1 * damping
        if done:
            break
    return values


def fits_of(bands: Bands, points: Sequence[FloatArray], order: int, known: FloatArray | None) -> bool:
    """Whether all bands of all channels are as strong as the model says."""
    count = bands.counts.sum(axis=0)
    weight = count / SHARED
    for i, point in enumerate(points):
        model = np.sum(model_of(point, bands, column(known, i)), axis=0)
        off = bands.sums[:, :, i].sum(axis=0) / count / model - 1.0
        spread = float(weight @ off**2)
        freedom = len(off) - 2 - (1 + order if known is None else 0)
        beyond = np.sqrt(max(spread - freedom, 0.0) / float(weight.sum()))
        if freedom < 1 or (chi2.sf(spread, freedom) < _DOUBT / len(points) and beyond > _MISFIT):
            return False
    return True


def levels_of(points: Sequence[FloatArray], dt: float, known: FloatArray | None) -> Levels:
    """Of the points that were found, channel by channel."""
    theta = np.linspace(0.0, np.pi, _LAGS + 1)
    if known is None:
        known = covariance_of(np.stack([_noise(point, theta, None) for point in points], axis=1))
    power = np.array([np.exp(point[0]) for point in points])
    return Levels(known, power, np.array([point[1] for point in points]), dt)
