"""How the noise of M x and the residual share the spectrum of u, and how sure that is.

Above the frequency at which they cross the residual is taken to fall as a power of the frequency, and the noise to be
white or autoregressive: with u's spectrum

    S_u(theta) = C theta^-p + 2 (1 - cos theta) / h^2 S_v(theta),    S_v = s^2 / |1 - sum_j rho_j e^(-i j theta)|^2

C, p, s and rho are those of largest likelihood (P. Whittle, "Estimation and information in stationary time series",
Arkiv foer Matematik 2, 1953). Leaving out one stretch after the other says how sure they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from .._sections import FloatArray
from ..results import Status
from .likelihood import (
    STEEPNESS,
    Bands,
    Fit,
    Levels,
    bands_of,
    channel,
    column,
    fits_of,
    levels_of,
    points_of,
)
from .noise import Noise
from .spectrum import ResidualSpectrum, density, noise_level, residual_spectrum
from .steps import Steps, Stretch, spread, stretches

__all__ = ["Separated", "separate"]

_COLOURED = (1, 2)  # orders of the autoregression that are tried
_OCTAVES = 5  # below the crossing of white noise
_AROUND = 0.35  # times the crossing, from where on the residual is taken to fall as a power
_LONG = 100.0  # rad at the crossing that a stretch is to have: its error is as good as independent of the next one's
_UNSURE = 1.0  # half width of the interval of the logarithm of the noise's power at the crossing


@dataclass(frozen=True, eq=False)
class Separated:
    """Noise and residual told apart.

    Attributes
    ----------
    units : list
        Independent stretches of the recordings.
    noise : Noise
    spectrum : ResidualSpectrum
    levels : Levels
    without : list of Levels
        Without each of the units.
    ends : list of Levels
        At both ends of the interval of a noise that comes from elsewhere; none of one from the flight itself.
    rough : Levels
        Those of the roughest residual that the stretches allow: p at the lower end of its interval.
    fit : Fit
    """

    units: list[list[Stretch]]
    noise: Noise
    spectrum: ResidualSpectrum
    levels: Levels
    without: list[Levels]
    ends: list[Levels]
    rough: Levels
    fit: Fit


def separate(
    parts: Sequence[Steps],
    given: Noise | None,
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
    points = points_of(bands, 0, force, known)
    fits = fits_of(bands, points, 0, known)
    if given is None and force:
        fits = fits and first.is_white
    levels, without = _jackknifed(bands, points, 0, force, known)
    rough = _roughest(bands, levels, without, points, known, confidence)
    if given is not None:
        noise = replace(given, colour=first.colour, is_white=first.is_white)
        if not fits:
            noise = replace(noise, message="the noise given is not that of the flight above the crossing")
        ends = [_scaled(levels, (end / given.value) ** 2) for end in (given.low, given.high)]
        ends = ends if np.any(given.high > given.low) else []
        return [Separated(units, noise, spectrum, levels, without, ends, rough, Fit(bands, points, known))]
    noise = _level(first, levels, without, confidence)
    reason = _shared(levels, without, spectrum.crossing * bands.dt, confidence, fits=fits)
    if reason:
        noise = replace(noise, status=Status.NOT_IDENTIFIED, message=reason)
    found = [Separated(units, noise, spectrum, levels, without, [], rough, Fit(bands, points, None))]
    if fits or not force:
        return found
    units = stretches(lengths)
    # Of a coloured noise the crossing is lower than of a white one: from the lowest frequency that it fits from.
    for octave, order in product(range(_OCTAVES, -1, -1), _COLOURED):
        bands = bands_of(parts, units, lowest * 0.5**octave)
        points = points_of(bands, order, force, None)
        if not fits_of(bands, points, order, None):
            continue
        # What is taken for the power law starts, as of white noise, where the crossing of this colour says.
        crossing = residual_spectrum(parts, levels_of(points, bands.dt, None).covariance).crossing
        if 0.0 < crossing < np.inf:
            nearer = bands_of(parts, units, _AROUND * crossing)
            again = points_of(nearer, order, force, None)
            if len(nearer.theta) < len(bands.theta) and fits_of(nearer, again, order, None):
                bands, points = nearer, again
        levels, without = _jackknifed(bands, points, order, force, None)
        spectrum = residual_spectrum(parts, levels.covariance)
        seen = spectrum.crossing > 0.0  # a colour that leaves no residual took it for noise
        if seen and not _shared(levels, without, spectrum.crossing * bands.dt, confidence, fits=True):
            noise = _level(first, levels, without, confidence)
            rough = _roughest(bands, levels, without, points, None, confidence)
            fit = Fit(bands, points, None)
            found.insert(0, Separated(units, noise, spectrum, levels, without, [], rough, fit))
        break
    return found


def _level(first: Noise, levels: Levels, without: Sequence[Levels], confidence: float) -> Noise:
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


def _jackknifed(
    bands: Bands, points: Sequence[FloatArray], order: int, force: bool, known: FloatArray | None
) -> tuple[Levels, list[Levels]]:
    """Levels of all stretches, and of all but each one."""
    total, count, without = bands.sums.sum(axis=0), bands.counts.sum(axis=0), []
    for sums, counts in zip(bands.sums, bands.counts, strict=True):
        left = np.maximum(count - counts, 0.0)
        means = np.where(left[:, None] > 0.0, (total - sums) / np.maximum(left, 1.0)[:, None], 1.0).T
        near = [
            channel(bands, mean, left, order, force, column(known, i), points[i])
            for i, mean in enumerate(means)
        ]
        without.append(levels_of(near, bands.dt, known))
    return levels_of(points, bands.dt, known), without


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
    width = [spread(values, confidence) for values in np.array([each.steepness for each in without]).T]
    low = np.maximum(levels.steepness - width, STEEPNESS[0])
    force = bool(np.isfinite(points[0][0]))
    found = [
        channel(bands, mean, count, order, force, column(known, i), points[i], (low[i], low[i]))
        for i, mean in enumerate(means)
    ]
    return levels_of(found, bands.dt, known)
