"""How the noise of M x and the residual share the spectrum of u, and how sure that is.

Above the frequency at which they cross the residual is taken to fall as a power of the frequency, and the noise to be
white or autoregressive: with u's spectrum

    S_u(theta) = C theta^-p + 2 (1 - cos theta) / h^2 S_v(theta),    S_v = s^2 / |1 - sum_j rho_j e^(-i j theta)|^2

C, p, s and rho are those of largest likelihood (P. Whittle, "Estimation and information in stationary time series",
Arkiv foer Matematik 2, 1953). Leaving out one stretch after the other says how sure they are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.stats import chi2

from .._sections import FloatArray
from ..results import Status
from .spectrum import (
    SHARED,
    NoiseLevel,
    ResidualSpectrum,
    density,
    noise_level,
    periodogram,
    residual_spectrum,
)
from .steps import Steps, Stretch, spread, stretches

__all__ = ["Levels", "Separated", "covariance_of", "separate"]

_COLOURED = (1, 2)  # orders of the autoregression that are tried
_OCTAVES = 5  # below the crossing of white noise
_AROUND = 0.35  # times the crossing, from where on the residual is taken to fall as a power
_LONG = 100.0  # rad at the crossing that a stretch is to have: its error is as good as independent of the next one's
_RATIO = 1.15  # of the edges of a band
_STEEPNESS = (5.0 / 3.0, 12.0)  # of p; no force is rougher than turbulence, of 5/3
_ITERATIONS, _STEP, _ENOUGH = 60, 1e-6, 1e-10  # of the search for the largest likelihood
_REFLECTIONS = ((1.5, 0.0), (1.0, -0.7), (0.0, -0.7))  # inverse hyperbolic tangents to search from, beside 0
_LAGS = 1024  # at which the covariance of an autoregression is looked at
_NEGLIGIBLE = 1e-6  # of the variance
_DOUBT, _MISFIT = 0.01, 0.1  # a model of the noise is wrong where less likely, and off by more, than this
_UNSURE = 1.0  # half width of the interval of the logarithm of the noise's power at the crossing


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


def covariance_of(spectrum: FloatArray) -> FloatArray:
    """Covariance (J + 1, n_x) of a spectrum (m + 1, n_x) over theta from 0 to pi, as far as it matters."""
    found = np.fft.irfft(spectrum, axis=0)[: len(spectrum)]
    there = np.flatnonzero(np.any(np.abs(found) > _NEGLIGIBLE * np.maximum(found[0], 1e-300), axis=1))
    return found[: int(there[-1]) + 1] if len(there) else found[:1]


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
class Separated:
    """Noise and residual told apart.

    Attributes
    ----------
    units : list
        Independent stretches of the recordings.
    noise : NoiseLevel
    spectrum : ResidualSpectrum
    levels : Levels
    without : list of Levels
        Without each of the units.
    ends : list of Levels
        At both ends of the interval of a noise that comes from elsewhere; none of one from the flight itself.
    rough : Levels
        Those of the roughest residual that the stretches allow: p at the lower end of its interval.
    """

    units: list[list[Stretch]]
    noise: NoiseLevel
    spectrum: ResidualSpectrum
    levels: Levels
    without: list[Levels]
    ends: list[Levels]
    rough: Levels


def separate(
    parts: Sequence[Steps],
    given: NoiseLevel | None,
    confidence: float,
    units: list[list[Stretch]] | None = None,
) -> list[Separated]:
    """Noise and residual told apart: by the noise given; else as white, before it by a colour where white is wrong.

    ``units`` are stretches of another separation of the same steps, to compare with.
    """
    lengths = [len(part.on_grid(part.dt)) for part in parts]
    first = noise_level(parts, confidence)
    known = None if given is None else given.covariance
    spectrum = residual_spectrum(parts, first.covariance if known is None else known)
    force = 0.0 < spectrum.crossing < np.inf
    lowest = _AROUND * spectrum.crossing if force else 0.0
    units = units or stretches(
        lengths, _LONG / (spectrum.crossing * np.median([part.dt for part in parts])) if force else np.inf
    )
    bands = bands_of(parts, units, lowest)
    points = _points(bands, 0, force, known)
    fits = _fits(bands, points, 0, known)
    if given is None and force:
        fits = fits and first.is_white
    levels, without = _jackknifed(bands, points, 0, force, known)
    rough = _roughest(bands, levels, without, points, known, confidence)
    if given is not None:
        noise = replace(given, colour=first.colour, is_white=first.is_white)
        if not fits:
            noise = replace(noise, message="the noise given is not that of the flight above the crossing")
        ends = [_scaled(levels, (end / given.value) ** 2) for end in (given.low, given.high)]
        return [
            Separated(
                units, noise, spectrum, levels, without, ends if np.any(given.high > given.low) else [], rough
            )
        ]
    noise = _level(first, levels, without, confidence)
    reason = _shared(levels, without, spectrum.crossing * bands.dt, confidence, fits=fits)
    if reason:
        noise = replace(noise, status=Status.NOT_IDENTIFIED, message=reason)
    found = [Separated(units, noise, spectrum, levels, without, [], rough)]
    if fits or not force:
        return found
    units = stretches(lengths)
    # Of a coloured noise the crossing is lower than of a white one: from the lowest frequency that it fits from.
    for octave, order in product(range(_OCTAVES, -1, -1), _COLOURED):
        bands = bands_of(parts, units, lowest * 0.5**octave)
        points = _points(bands, order, force, None)
        if not _fits(bands, points, order, None):
            continue
        # What is taken for the power law starts, as of white noise, where the crossing of this colour says.
        crossing = residual_spectrum(parts, _levels(points, bands.dt, None).covariance).crossing
        if 0.0 < crossing < np.inf:
            nearer = bands_of(parts, units, _AROUND * crossing)
            again = _points(nearer, order, force, None)
            if len(nearer.theta) < len(bands.theta) and _fits(nearer, again, order, None):
                bands, points = nearer, again
        levels, without = _jackknifed(bands, points, order, force, None)
        spectrum = residual_spectrum(parts, levels.covariance)
        seen = spectrum.crossing > 0.0  # a colour that leaves no residual took it for noise
        if seen and not _shared(levels, without, spectrum.crossing * bands.dt, confidence, fits=True):
            noise = _level(first, levels, without, confidence)
            rough = _roughest(bands, levels, without, points, None, confidence)
            found.insert(0, Separated(units, noise, spectrum, levels, without, [], rough))
        break
    return found


def _level(first: NoiseLevel, levels: Levels, without: Sequence[Levels], confidence: float) -> NoiseLevel:
    value, *others = (np.sqrt(each.covariance[0]) for each in (levels, *without))
    width = np.array([spread(column, confidence) for column in np.log(np.maximum(others, 1e-300)).T])
    ends = value * np.exp(-width), value * np.exp(width)
    return replace(first, value=value, low=ends[0], high=ends[1], covariance=levels.covariance)


def _scaled(levels: Levels, factor: FloatArray) -> Levels:
    return replace(levels, covariance=factor * levels.covariance)


def _shared(
    levels: Levels, without: Sequence[Levels], crossing: float, confidence: float, *, fits: bool
) -> str:
    """Why noise and residual cannot be told apart; empty where they can."""
    ask = "give the noise (a stretch at rest, a data sheet), or sample faster"
    if crossing >= np.pi:
        return f"what the model misses is stronger than the noise up to the Nyquist frequency: no noise is seen; {ask}"
    if not fits:
        return (
            "above the frequency at which noise and residual cross the spectrum of u is that of no white noise: the "
            f"residual reaches up there, or the noise is coloured and its colour not certain; {ask}"
        )
    at = np.array([crossing])
    several = [np.log(np.maximum(density(each.covariance, at)[0], 1e-300)) for each in without]
    if max(spread(column, confidence) for column in np.array(several).T) > _UNSURE:
        return f"noise and residual share a band, and where they cross the noise may be anything; {ask}"
    return ""


# -- largest likelihood ----------------------------------------------------------------------------------------------


def _points(bands: Bands, order: int, force: bool, known: FloatArray | None) -> list[FloatArray]:
    """By channel (log C, p, log s^2, reflections); no residual where there is no ``force``."""
    count = bands.counts.sum(axis=0)
    means = (bands.sums.sum(axis=0) / count[:, None]).T
    return [
        _channel(bands, mean, count, order, force, _column(known, i), None) for i, mean in enumerate(means)
    ]


def _jackknifed(
    bands: Bands, points: Sequence[FloatArray], order: int, force: bool, known: FloatArray | None
) -> tuple[Levels, list[Levels]]:
    """Levels of all stretches, and of all but each one."""
    total, count, without = bands.sums.sum(axis=0), bands.counts.sum(axis=0), []
    for sums, counts in zip(bands.sums, bands.counts, strict=True):
        left = np.maximum(count - counts, 0.0)
        means = np.where(left[:, None] > 0.0, (total - sums) / np.maximum(left, 1.0)[:, None], 1.0).T
        near = [
            _channel(bands, mean, left, order, force, _column(known, i), points[i])
            for i, mean in enumerate(means)
        ]
        without.append(_levels(near, bands.dt, known))
    return _levels(points, bands.dt, known), without


def _roughest(
    bands: Bands,
    levels: Levels,
    without: Sequence[Levels],
    points: Sequence[FloatArray],
    known: FloatArray | None,
    confidence: float,
) -> Levels:
    count = bands.counts.sum(axis=0)
    means, order = (bands.sums.sum(axis=0) / count[:, None]).T, len(points[0]) - 3
    width = [spread(column, confidence) for column in np.array([each.steepness for each in without]).T]
    low = np.maximum(levels.steepness - width, _STEEPNESS[0])
    force = bool(np.isfinite(points[0][0]))
    found = [
        _channel(bands, mean, count, order, force, _column(known, i), points[i], (low[i], low[i]))
        for i, mean in enumerate(means)
    ]
    return _levels(found, bands.dt, known)


def _column(known: FloatArray | None, i: int) -> FloatArray | None:
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


def _model(point: FloatArray, bands: Bands, known: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Residual and noise."""
    noise = bands.shape * _noise(point, bands.theta, known)
    mean = np.sinc(0.5 * bands.theta / np.pi) ** 2
    return np.exp(point[0]) * bands.theta ** -point[1] * mean, noise


def _channel(
    bands: Bands,
    mean: FloatArray,
    count: FloatArray,
    order: int,
    force: bool,
    known: FloatArray | None,
    start: FloatArray | None,
    steepness: tuple[float, float] = _STEEPNESS,
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
        return np.maximum(np.sum(_model(point, bands, known), axis=0), 1e-12 * np.exp(size))

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


def _fits(bands: Bands, points: Sequence[FloatArray], order: int, known: FloatArray | None) -> bool:
    """Whether all bands of all channels are as strong as the model says."""
    count = bands.counts.sum(axis=0)
    weight = count / SHARED
    for i, point in enumerate(points):
        model = np.sum(_model(point, bands, _column(known, i)), axis=0)
        off = bands.sums[:, :, i].sum(axis=0) / count / model - 1.0
        spread = float(weight @ off**2)
        freedom = len(off) - 2 - (1 + order if known is None else 0)
        beyond = np.sqrt(max(spread - freedom, 0.0) / float(weight.sum()))
        if freedom < 1 or (chi2.sf(spread, freedom) < _DOUBT / len(points) and beyond > _MISFIT):
            return False
    return True


def _levels(points: Sequence[FloatArray], dt: float, known: FloatArray | None) -> Levels:
    theta = np.linspace(0.0, np.pi, _LAGS + 1)
    if known is None:
        known = covariance_of(np.stack([_noise(point, theta, None) for point in points], axis=1))
    power = np.array([np.exp(point[0]) for point in points])
    return Levels(known, power, np.array([point[1] for point in points]), dt)
