"""What a log says of the residual and of the noise, with stated confidence: the numbers that designs start from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import control as ct
import numpy as np
from scipy.optimize import minimize
from scipy.stats import norm

from ..._sections import FloatArray
from ...recording import Recording
from ...results import Interval, Result
from ...values import gauss_markov
from ..learning.residuals import measured_residuals

__all__ = ["Peak", "ResidualStatistics", "residual_statistics"]

# Blocks of independent data are this many correlation times long.
_INDEPENDENT = 4.0


class Peak(NamedTuple):
    """The largest value seen, and the share of blocks of data that stay below it, with the stated confidence.

    Attributes
    ----------
    value, share : float
    """

    value: float
    share: float


@dataclass(frozen=True, repr=False)
class ResidualStatistics(Result):
    """Made by :func:`residual_statistics`.

    Attributes
    ----------
    noise : Interval
        Standard deviation of the noise of a sample of x.
    deviation, time_constant : Interval
        Of the Gauss-Markov process that fits the residual's spectrum: its standard deviation, and seconds.
    magnitude : Peak
        Largest |gamma| (delta_0), averaged over a step.
    slope : Peak
        Largest |gamma'| (delta_1), as the change over ``span``.
    span : float
        Seconds over which a slope is taken: long enough for the noise of x to be a fifth of the change at most.
    block : float
        Seconds of a block of data that counts as independent.
    blocks : int
        Their number, over all logs.
    confidence : float
        Of intervals and shares.
    """

    noise: Interval
    deviation: Interval
    time_constant: Interval
    magnitude: Peak
    slope: Peak
    span: float
    block: float
    blocks: int
    confidence: float

    @property
    def shape(self) -> ct.StateSpace:
        """Shaping filter of the residual, for :func:`least_variance`."""
        return gauss_markov(self.deviation.value, self.time_constant.value)


def residual_statistics(
    logs: Recording | Sequence[Recording],
    *,
    channels: Sequence[int | str] | None = None,
    confidence: float = 0.95,
) -> ResidualStatistics:
    """Estimate the noise of x, a spectrum of the residual, and bounds delta_0 and delta_1 from logs.

    Parameters
    ----------
    logs : Recording or sequence of Recording
        At equal steps, all of one length. No label is needed: the measured residual M x' - g - f_theta is used.
    channels : sequence of int or str, optional
        Channels that take part, by number or name; taken as independent records of one process. None means all.
    confidence : float
        Between 0 and 1.

    Returns
    -------
    ResidualStatistics

    Raises
    ------
    ValueError
        For unequal steps, logs too short, or a confidence out of range.

    Notes
    -----
    Noise and spectrum: the measured residual of a step is the step mean of a Gauss-Markov process, whose spectrum is
    known in closed form, plus the difference of two samples of white noise; its three parameters maximise Whittle's
    likelihood, and their intervals come from its curvature (asymptotically normal in the logarithms).

    Peaks: of n independent blocks the largest maximum lies above the share p = (1 - c)^(1/n) of all block maxima with
    confidence c (Wilks, Ann. Math. Stat. 12, 1941), whatever the distribution. A bound that certainly holds cannot come
    from data.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> gamma = np.zeros(20001)
    >>> for k in range(20000):
    ...     gamma[k + 1] = 0.98 * gamma[k] + 0.2 * rng.standard_normal()
    >>> x = np.cumsum(0.01 * gamma) + 0.002 * rng.standard_normal(20001)
    >>> found = residual_statistics(Recording.from_arrays(x=x[:, None], dt=0.01))
    >>> round(found.noise.value, 3), bool(found.time_constant.low < 0.5 < found.time_constant.high)
    (0.002, True)
    """
    logs = [logs] if isinstance(logs, Recording) else list(logs)
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence: expected a number between 0 and 1, got {confidence}")
    records, h = measured_residuals(logs, channels=channels)
    if sum(len(u) for u in records) < 200:
        raise ValueError("expected 200 samples or more to tell noise from residual; give longer logs")
    deviation, time_constant, noise = _whittle(records, h, confidence)
    tau = time_constant.value
    span = max(1, int(np.ceil(5.0 * np.sqrt(2.0) * noise.value / h / max(deviation.value, 1e-300))))
    block = max(_INDEPENDENT * tau, 2 * span * h)
    length = max(int(np.ceil(block / h)), 2)
    magnitude, slope, blocks = 0.0, 0.0, 0
    for u in records:
        # The mean over a span: its noise is smaller by the span than that of a step.
        sums = np.concatenate([np.zeros((1, u.shape[1])), np.cumsum(u, axis=0)])
        means = (sums[span:] - sums[:-span]) / span
        magnitude = max(magnitude, float(np.linalg.norm(means, axis=1).max(initial=0.0)))
        change = (means[span:] - means[:-span]) / (span * h)
        slope = max(slope, float(np.linalg.norm(change, axis=1).max(initial=0.0)))
        blocks += len(u) // length
    if blocks < 2:
        raise ValueError(
            f"the residual is correlated over {tau:.3g} s, so the logs hold {blocks} independent blocks of "
            f"{block:.3g} s: expected 2 or more; give longer logs"
        )
    share = (1.0 - confidence) ** (1.0 / blocks)
    return ResidualStatistics(
        noise,
        deviation,
        time_constant,
        Peak(magnitude, share),
        Peak(slope, share),
        span * h,
        length * h,
        blocks,
        confidence,
    )


def _whittle(records: list[FloatArray], h: float, confidence: float) -> tuple[Interval, Interval, Interval]:
    """Deviation, time constant and noise."""
    power, angle = [], []
    for u in records:
        spectrum = np.abs(np.fft.rfft(u - u.mean(axis=0), axis=0)[1:-1]) ** 2 / len(u)
        theta = 2.0 * np.pi * np.arange(1, len(spectrum) + 1) / len(u)
        power.append(spectrum.ravel())
        angle.append(np.repeat(theta, u.shape[1]))
    S, theta = np.concatenate(power), np.concatenate(angle)

    def model(logs: FloatArray) -> FloatArray:
        s, tau, sigma = np.exp(logs)
        return s**2 * step_mean_spectrum(theta, h / tau) + 2.0 * (sigma / h) ** 2 * (1.0 - np.cos(theta))

    def loss(logs: FloatArray) -> float:
        M = model(logs)
        return float(np.sum(np.log(M) + S / M))

    total = np.sqrt(np.mean(S))
    tries = [
        np.log([total, tau, share * total * h])
        for tau in np.geomspace(3 * h, 0.05 * h * max(map(len, records)), 4)
        for share in (0.1, 1.0)
    ]
    best = min((minimize(loss, start, method="Nelder-Mead") for start in tries), key=lambda found: found.fun)
    best = minimize(loss, best.x, method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-6})
    # Fisher information of Whittle's likelihood: sum of products of the slopes of log M.
    slopes = np.array(
        [(np.log(model(best.x + d)) - np.log(model(best.x - d))) / 2e-5 for d in 1e-5 * np.eye(3)]
    )
    covariance = np.linalg.pinv(slopes @ slopes.T)
    width = norm.ppf(0.5 + 0.5 * confidence) * np.sqrt(np.diag(covariance))
    values = np.exp(best.x)
    s, tau, sigma = (
        Interval(float(v), float(v * np.exp(-w)), float(v * np.exp(w)))
        for v, w in zip(values, width, strict=True)
    )
    return s, tau, sigma


def step_mean_spectrum(theta: FloatArray, ratio: float) -> FloatArray:
    """Spectrum over theta = omega h of the step means of a Gauss-Markov process of deviation 1; ratio = h / tau.

    Their covariance is 2 (q - 1 + e^-q) / q^2 at lag 0 and ((1 - e^-q) / q)^2 e^(-q (k - 1)) at lag k, q = ratio.
    """
    fall = -np.expm1(-ratio)
    first = 2.0 * (ratio - fall) / ratio**2
    following = (fall / ratio) ** 2 * 2.0 * np.real(np.exp(-1j * theta) / (1.0 - np.exp(-ratio - 1j * theta)))
    return first + following
