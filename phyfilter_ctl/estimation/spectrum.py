"""How strong the measurement noise is, and at which frequencies the model misses something."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.signal import welch
from scipy.signal.windows import tukey
from scipy.stats import chi2, f

from .._sections import FloatArray
from ..results import Result
from .noise import Noise
from .steps import Steps

__all__ = [
    "BEYOND",
    "SHARED",
    "ResidualSpectrum",
    "density",
    "noise_level",
    "periodogram",
    "residual_spectrum",
]

_TAPER = (
    0.5  # share of a stretch that the window lets fade: leakage falls as with Hann's, and more samples count
)
# Its neighbouring bins are correlated: so many of them count as one, m sum w^4 / (sum w^2)^2.
SHARED = (1.0 - _TAPER * 93.0 / 128.0) / (1.0 - _TAPER * 5.0 / 8.0) ** 2
_AROUND = 9  # steps over which the residual is taken as constant where the steps differ
BEYOND = 2.5  # times the crossing the residual is lost in the noise
_COLOURED = 1.25  # ratio of the two quarters of the band beyond which the noise is called coloured
_EDGES = (0.0, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)  # rad/s, of the bands
_KEPT: Any = False  # the mean, which scipy's types do not know can be kept
_PER_DECADE = 10  # points of the smoothed spectra that are compared


def periodogram(values: FloatArray) -> FloatArray:
    """Of rows (m, n_x) at theta = 2 pi k / m, tapered; its mean over all theta is the mean square."""
    window = tukey(len(values) + 2, _TAPER)[1:-1, None]
    return np.abs(np.fft.rfft(window * values, axis=0)) ** 2 / np.sum(window**2)


def noise_level(parts: Sequence[Steps], confidence: float) -> Noise:
    """The noise v of M x: its part of h u is v_k - v_(k-1), of spectrum 2 (1 - cos theta) s^2 over theta = omega h.

    The mean of the periodogram over that shape is the most likely s^2 where v is all there is. Where the steps differ,
    what the residual leaves in h u by their differing is taken out first.
    """
    lower, upper = [], []
    for part in parts:
        power = periodogram(_levelled(part))
        theta = 2.0 * np.pi / len(part.u) * np.arange(len(power))
        level = power / np.maximum(2.0 * (1.0 - np.cos(theta)), 1e-9)[:, None]
        lower.append(level[(theta > 0.5 * np.pi) & (theta <= 0.75 * np.pi)])
        upper.append(level[theta > 0.75 * np.pi])
    low, high = np.concatenate(lower), np.concatenate(upper)
    both = np.concatenate([low, high])
    freedom = 2.0 * len(both) / SHARED
    variance, tail = both.mean(axis=0), 0.5 - 0.5 * confidence
    colour = low.mean(axis=0) / np.maximum(high.mean(axis=0), 1e-300)
    chance = float(f.ppf(1.0 - tail / len(variance), 0.5 * freedom, 0.5 * freedom))  # of any channel
    return Noise(
        np.sqrt(variance),
        np.sqrt(variance * freedom / chi2.ppf(1.0 - tail, freedom)),
        np.sqrt(variance * freedom / chi2.ppf(tail, freedom)),
        variance[None],
        "flight",
        colour,
        bool(np.all(np.abs(np.log(np.maximum(colour, 1e-300))) < np.log(max(_COLOURED, chance)))),
    )


def _levelled(part: Steps) -> FloatArray:
    """h u as if all steps were the median one."""
    moved = part.h * part.u
    if part.uniform:
        return moved
    kernel = np.ones(min(_AROUND, len(moved)))
    around = np.convolve(part.h[:, 0], kernel, "same")
    slope = np.stack([np.convolve(column, kernel, "same") / around for column in moved.T], axis=1)
    return moved - slope * (part.h - part.dt)


@dataclass(frozen=True, eq=False, repr=False)
class ResidualSpectrum(Result):
    """Spectrum of the measured residual u, and how much of it is noise.

    Attributes
    ----------
    omega : (K,) array
        rad/s.
    residual, noise : (K, n_x) arrays
        One-sided densities per rad/s, of u and of the noise in it.
    bands : dict of str to float
        By rad/s, up to four times the crossing: rms of what the model misses there, without the noise.
    crossing : float
        rad/s above which noise is stronger than what the model misses; 0 where it is everywhere, inf where nowhere.
    """

    _figures = ("bands", "crossing")

    omega: FloatArray
    residual: FloatArray
    noise: FloatArray
    bands: dict[str, float]
    crossing: float


def density(covariance: FloatArray, theta: FloatArray) -> FloatArray:
    """Spectrum (K, n_x) over theta of a covariance (J + 1, n_x); its mean is the variance."""
    lags = np.arange(1, len(covariance))
    return np.maximum(covariance[0] + 2.0 * np.cos(np.outer(theta, lags)) @ covariance[1:], 0.0)


def residual_spectrum(parts: Sequence[Steps], covariance: FloatArray) -> ResidualSpectrum:
    """Welch's spectrum over all recordings; ``covariance`` (J + 1, n_x) is that of the noise of M x."""
    dt = max(part.dt for part in parts)
    signals = [u for part in parts if len(u := part.on_grid(dt)) >= 16]
    length = min(4096, max(64, sum(map(len, signals)) // 8), max(map(len, signals)))
    taken = [u for u in signals if len(u) >= length]
    powers = [welch(u, 1.0 / dt, nperseg=length, axis=0, detrend=_KEPT)[1] for u in taken]
    residual = np.average(powers, axis=0, weights=list(map(len, taken))) / (2.0 * np.pi)
    omega = 2.0 * np.pi / (length * dt) * np.arange(length // 2 + 1.0)
    shapes = [part.noise_density(dt, omega * dt) * dt / np.pi for part in parts]
    shape = np.average(shapes, axis=0, weights=[len(part.u) for part in parts])
    expected = shape[:, None] * density(covariance, omega * dt)
    crossing = _crossing(omega, residual, expected)
    return ResidualSpectrum(omega, residual, expected, _bands(omega, residual - expected, crossing), crossing)


def _bands(omega: FloatArray, power: FloatArray, crossing: float) -> dict[str, float]:
    last = min(float(omega[-1]), BEYOND * crossing)
    found = {}
    for low, high in pairwise([*(edge for edge in _EDGES if edge < last), last]):
        inside = (omega >= low) & (omega < high)
        rms = float(np.sqrt(max(power[inside].mean(axis=1).sum() * omega[1], 0.0)))
        found[f"{low:g} to {high:.3g}"] = rms
    return found


def _crossing(omega: FloatArray, residual: FloatArray, noise: FloatArray) -> float:
    """Where the sums over the channels cross, smoothed over a tenth of a decade."""
    count = max(2, int(_PER_DECADE * np.log10(omega[-1] / omega[1])))
    edges = np.geomspace(0.999 * omega[1], omega[-1], count + 1)
    where = np.digitize(omega[1:], edges[1:-1])
    filled = np.unique(where)
    least = 1e-12 * float(residual.max())  # of rounding, where there is no noise or no force
    strong, weak = (np.maximum(power[1:].sum(axis=1), least) for power in (residual, noise))
    centre, ratio = (
        np.array([np.exp(np.mean(np.log(values[where == k]))) for k in filled])
        for values in (omega[1:], strong / weak)
    )
    # Signal above noise: u above twice the noise. Logarithms of periodograms lie low, by the same for both.
    above = ratio > 2.0
    if above.all():
        return float("inf")
    k = int(np.argmin(above))
    if k == 0:
        return 0.0
    share = np.log(ratio[k - 1] / 2.0) / np.log(ratio[k - 1] / ratio[k])
    return float(centre[k - 1] * (centre[k] / centre[k - 1]) ** share)
