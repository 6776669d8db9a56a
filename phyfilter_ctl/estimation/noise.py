"""The noise of M x: how strong, of which colour, and from where: the flight, the caller or a stretch at rest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter
from scipy.stats import chi2

from .. import _signals
from .._sections import FloatArray
from ..recording import Recording
from ..results import Result, Status

__all__ = ["Noise", "covariance_of", "given_noise"]

_HIGHEST = 20  # order of the autoregression of a stretch at rest
_LAGS = 20  # of the test of what it leaves
_DOUBT = 0.01
_SHORTEST = 50  # samples at rest
_GRID = 1025  # points of a spectrum
_NEGLIGIBLE = 1e-6  # of the variance


@dataclass(frozen=True, eq=False, repr=False)
class Noise(Result):
    """Noise v of M x: how strong, of which colour, and whether it can be told from the residual.

    Attributes
    ----------
    value, low, high : (n_x,) arrays
        Standard deviation of a sample, and the ends of its confidence interval, in the unit of M x.
    covariance : (J + 1, n_x) array
        E v_k v_(k-j) at lags of j = 0 to J steps: one row where the noise is white.
    source : {"flight", "given", "rest"}
        What it is from: the spectrum of u, the caller, a stretch at rest.
    colour : (n_x,) array
        Power of n = v_k - v_(k-1) between half and three quarters of the Nyquist frequency over that above, relative to
        that of white v: 1 for white noise. Above: x comes out of an estimator that smooths it, or the force reaches up
        there.
    is_white : bool
        Whether every channel's colour is within chance or below 1.25 either way.
    status : Status
        CONVERGED, or NOT_IDENTIFIED where the model of the noise does not fit or shares its band with the residual.
    message : str
    """

    value: FloatArray
    low: FloatArray
    high: FloatArray
    covariance: FloatArray = field(repr=False)
    source: str
    colour: FloatArray
    is_white: bool
    status: Status = Status.CONVERGED
    message: str = "converged"

    @staticmethod
    def known(
        deviation: ArrayLike | None = None,
        *,
        covariance: ArrayLike | None = None,
        spectrum: tuple[ArrayLike, ArrayLike] | None = None,
        dt: float | None = None,
    ) -> Noise:
        """Noise of M x that is known: by its deviation, its covariance or its spectrum. Give one of the three.

        Parameters
        ----------
        deviation : array_like, shape () or (n_x,)
            Of white noise, unit of M x.
        covariance : array_like, shape (J + 1,) or (J + 1, n_x)
            E v_k v_(k-j) at lags of j = 0 to J steps of the recordings.
        spectrum : (omega, density)
            omega (m,) in rad/s, rising from 0, and the one-sided density (m,) or (m, n_x) per rad/s, whose integral up
            to the Nyquist frequency is the variance. Between the points on straight lines, beyond them as at the last.
        dt : float
            Step of the recordings in s; needed with ``spectrum`` alone.

        Returns
        -------
        Noise
            With no interval: it is taken as exact.

        Raises
        ------
        ValueError
            If not exactly one of the three is given, it is no covariance or density, or ``dt`` is missing.

        Examples
        --------
        >>> Noise.known(0.005).covariance.tolist()
        [[2.5e-05]]
        >>> white = Noise.known(spectrum=([0.0, 1000.0], [1e-8, 1e-8]), dt=0.002)
        >>> bool(np.isclose(white.value[0], np.sqrt(1e-8 * np.pi / 0.002)))
        True
        """
        if sum(each is not None for each in (deviation, covariance, spectrum)) != 1:
            raise ValueError("Noise.known: expected one of deviation, covariance and spectrum")
        if deviation is not None:
            s = np.atleast_1d(np.asarray(deviation, dtype=float))
            if s.ndim != 1 or not (np.isfinite(s).all() and np.all(s > 0.0)):
                raise ValueError(f"deviation: expected finite numbers > 0, got {deviation!r}")
            found = s[None] ** 2
        elif covariance is not None:
            found = _columns("covariance", covariance)
            theta = np.linspace(0.0, np.pi, 4 * len(found) + 2)
            cosines = 2.0 * np.cos(np.outer(theta, np.arange(1, len(found))))
            least = (found[0] + cosines @ found[1:]).min(axis=0)
            if np.any(found[0] <= 0.0) or np.any(least < -1e-6 * found[0]):
                raise ValueError(
                    "covariance: expected that of a process, with a spectrum >= 0 at every frequency; "
                    f"its least value is {float(np.min(least)):.3g}: let the lags die out, or give more of them"
                )
        else:
            assert spectrum is not None
            h = _signals.duration("dt", math.nan if dt is None else dt)
            omega = _signals.array("omega", spectrum[0], ("m",))
            power = _columns("density", spectrum[1])
            if (
                len(power) != len(omega)
                or np.any(np.diff(omega) <= 0.0)
                or omega[0] < 0.0
                or np.any(power < 0.0)
            ):
                raise ValueError("spectrum: expected rising omega >= 0 and as many densities >= 0")
            grid = np.linspace(0.0, np.pi, _GRID)
            found = covariance_of(
                np.stack([np.interp(grid / h, omega, p) for p in power.T], axis=1) * np.pi / h
            )
        s = np.sqrt(found[0])
        return Noise(s, s, s, found, "given", np.ones_like(s), len(found) == 1)

    @staticmethod
    def at_rest(
        recording: Recording,
        *,
        start: float | None = None,
        end: float | None = None,
        confidence: float = 0.95,
    ) -> Noise:
        """Noise of M x, of any colour, from a stretch in which the robot is at rest.

        M x, less its straight line, is noise there: an autoregression of the order with the least AIC.

        Parameters
        ----------
        recording : Recording
        start, end : float, optional
            Times of the recording in s; None is its own.
        confidence : float
            Of the interval of the deviation.

        Returns
        -------
        Noise
            For ``estimate(..., noise=...)``. NOT_IDENTIFIED where the autoregression leaves what is not white.

        Raises
        ------
        ValueError
            If there are fewer than 50 samples at rest, they are not finite or nothing moves in them, or the inertia is
            a full matrix.

        Notes
        -----
        Yule and Walker's equations, and the test of G. M. Ljung, G. E. P. Box, "On a measure of lack of fit in time
        series models", Biometrika 65 (2), 1978, at 1 %.

        Examples
        --------
        >>> v = 0.01 * np.random.default_rng(0).standard_normal((1000, 1))
        >>> found = Noise.at_rest(Recording.from_arrays(x=v, dt=0.01))
        >>> found.value.round(3).tolist(), str(found.status)
        ([0.01], 'converged')
        """
        first = recording.times[0] if start is None else start
        last = recording.times[-1] if end is None else end
        rows = np.flatnonzero((recording.times >= first) & (recording.times <= last))
        if len(rows) < _SHORTEST:
            raise ValueError(f"start, end: expected at least {_SHORTEST} samples at rest, got {len(rows)}")
        part = recording.segment(int(rows[0]), int(rows[-1]) + 1)
        if part.inertia is not None and part.inertia.ndim == 3:
            raise ValueError("inertia: expected a number or a diagonal, got full matrices")
        M = 1.0 if part.inertia is None else part.inertia
        v = part.x * M
        if not np.isfinite(v).all() or np.any(np.ptp(v, axis=0) == 0.0):
            raise ValueError(
                "the stretch at rest: expected finite samples with noise in them; choose another"
            )
        t = np.linspace(-1.0, 1.0, len(v))
        v = v - v.mean(axis=0) - np.outer(t, t @ v / (t @ t))
        spectra, white = zip(*[_autoregression(column) for column in v.T], strict=True)
        covariance = covariance_of(np.stack(spectra, axis=1))
        s = np.sqrt(covariance[0])
        effective = (
            len(v) * covariance[0] ** 2 / (covariance[0] ** 2 + 2.0 * np.sum(covariance[1:] ** 2, axis=0))
        )
        tail = 0.5 - 0.5 * confidence
        status, message = Status.CONVERGED, "converged"
        if not all(white):
            status = Status.NOT_IDENTIFIED
            message = f"no autoregression up to order {_HIGHEST} leaves white noise: choose a stretch that is at rest"
        return Noise(
            s,
            s * np.sqrt(effective / chi2.ppf(1.0 - tail, effective)),
            s * np.sqrt(effective / chi2.ppf(tail, effective)),
            covariance,
            "rest",
            np.ones_like(s),
            len(covariance) == 1,
            status,
            message,
        )


def given_noise(noise: Noise | ArrayLike | None, logs: Sequence[Recording]) -> Noise | None:
    """As a caller may give it, for the channels of these recordings."""
    if noise is None:
        return None
    found = noise if isinstance(noise, Noise) else Noise.known(noise)
    n_x, given = logs[0].n_x, len(found.value)
    if given not in (1, n_x):
        raise ValueError(f"noise: expected it for 1 or {n_x} channels as in the recordings, got {given}")
    if given == n_x:
        return found
    value, low, high = (np.broadcast_to(each, (n_x,)) for each in (found.value, found.low, found.high))
    covariance = np.broadcast_to(found.covariance, (len(found.covariance), n_x))
    return replace(found, value=value, low=low, high=high, covariance=covariance, colour=np.ones(n_x))


def covariance_of(spectrum: FloatArray) -> FloatArray:
    """Covariance (J + 1, n_x) of a spectrum (m + 1, n_x) over theta from 0 to pi, as far as it matters."""
    found = np.fft.irfft(spectrum, axis=0)[: len(spectrum)]
    there = np.flatnonzero(np.any(np.abs(found) > _NEGLIGIBLE * np.maximum(found[0], 1e-300), axis=1))
    return found[: int(there[-1]) + 1] if len(there) else found[:1]


def _columns(name: str, values: ArrayLike) -> FloatArray:
    found = np.asarray(values, dtype=float)
    found = found[:, None] if found.ndim == 1 else found
    return _signals.array(name, found, ("m", "n_x"))


def _autoregression(v: FloatArray) -> tuple[FloatArray, bool]:
    """Spectrum over theta of the autoregression of least AIC, and whether it leaves white noise."""
    n = len(v)
    r = np.array([np.dot(v[: n - lag], v[lag:]) / n for lag in range(_HIGHEST + 1)])
    theta = np.linspace(0.0, np.pi, _GRID)
    best, power, least = np.zeros(0), float(r[0]), n * math.log(r[0])
    for order in range(1, _HIGHEST + 1):
        a = solve_toeplitz(r[:order], r[1 : order + 1])
        left = max(float(r[0] - a @ r[1 : order + 1]), 1e-12 * float(r[0]))
        if (score := n * math.log(left) + 2.0 * order) < least:
            best, power, least = a, left, score
    e = np.asarray(lfilter([1.0, *-best], [1.0], v))[len(best) :]
    lags = range(1, _LAGS + 1)
    correlation = np.array([np.dot(e[: len(e) - lag], e[lag:]) for lag in lags]) / float(np.dot(e, e))
    statistic = len(e) * (len(e) + 2.0) * float(np.sum(correlation**2 / (len(e) - np.arange(1, _LAGS + 1))))
    answer = 1.0 - np.exp(-1j * np.outer(theta, np.arange(1, len(best) + 1))) @ best
    white = bool(chi2.sf(statistic, max(_LAGS - len(best), 1)) > _DOUBT)
    return power / np.abs(answer) ** 2, white
