"""A label for recordings that have none: the force from both sides, after the flight, with its deviation."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.signal import lfilter

from .. import _signals
from .._sections import FloatArray
from ..baselines import KalmanDifferentiator
from ..filter import PhyFilter
from ..filter.sampling import Rule
from ..recording import Recording
from ..results import Result
from .spectrum import noise_level
from .steps import Steps, least, steps_of

__all__ = ["SmoothedLabel", "smooth_label"]

_LEAST = 1e-9  # noise over the largest rise
_WIDE = 1e4  # prior deviation of the first force over the largest |u|


@dataclass(frozen=True, eq=False, repr=False)
class SmoothedLabel(Result):
    """A label and how sure it is; made by :func:`smooth_label`.

    Attributes
    ----------
    recording : Recording
        With the label.
    deviation : (N, n_x) array
        Standard deviation of the label at each sample, if f is a random walk.
    noise : (n_x,) array
        Deviation of the noise of M x.
    walk : (n_x,) array
        Rate of the random walk: f changes by walk sqrt(t) in t seconds, unit of f per sqrt(s).
    """

    recording: Recording = field(repr=False)
    deviation: FloatArray
    noise: FloatArray
    walk: FloatArray


def smooth_label(recording: Recording, *, noise: float | None = None, g: Rule = "hold") -> SmoothedLabel:
    """The force f from the samples before and after, as a label for learning and scoring.

    Parameters
    ----------
    recording : Recording
        x, g and the inertia are used; f_theta and a label it has are not.
    noise : float, optional
        Deviation of the white noise of M x, all channels; None takes the most likely one of each.
    g : {"hold", "average"}
        Between samples.

    Returns
    -------
    SmoothedLabel

    Raises
    ------
    TypeError
        If ``recording`` is something else.
    ValueError
        If there are fewer than 100 steps, or the noise is not above 0.

    Notes
    -----
    Each channel: y' = f, f' white noise of density walk^2, z = y + noise with y = M x less the integral of g, sampled
    exactly at any steps; H. E. Rauch, F. Tung, C. T. Striebel, "Maximum likelihood estimates of linear dynamic
    systems", AIAA Journal 3 (8), 1965. Levels: largest likelihood of the innovations of the steady filter at equal
    steps; where the noise is not white, neither they nor the deviation hold, so have a look at ``Estimate.noise``.

    The label comes out of x as f_hat does: it shows what a causal filter loses by its lag, no error that both share.

    Examples
    --------
    >>> t = 0.01 * np.arange(3000)[:, None]
    >>> v = 2.0 * (1.0 - np.cos(t)) + 0.005 * np.random.default_rng(0).standard_normal(t.shape)
    >>> found = smooth_label(Recording.from_arrays(x=v, dt=0.01))
    >>> error = found.recording.label - 2.0 * np.sin(t)
    >>> bool(np.mean(np.abs(error) < 2.0 * found.deviation) > 0.9)
    True
    """
    if not isinstance(recording, Recording):
        raise TypeError(f"recording: expected a Recording, got {type(recording).__name__}")
    bare = recording.with_signals(f_theta=None)
    (part,) = steps_of([bare], PhyFilter([1.0]).sampled(recording.dt, g=g))
    given = None if noise is None else _signals.number("noise", noise, above=0.0)
    # Means over steps that differ are smoother than noise is: there the spectrum knows better.
    known = [given if given or part.uniform else float(s) for s in noise_level([part], 0.95).value]
    force, deviation, s, walk = zip(*[_channel(part, i, s) for i, s in enumerate(known)], strict=True)
    label, wide = (_at_samples(np.stack(each, axis=1), part, recording) for each in (force, deviation))
    return SmoothedLabel(recording.with_signals(label=label), wide, np.array(s), np.array(walk))


def _at_samples(values: FloatArray, part: Steps, log: Recording) -> FloatArray:
    """On straight lines across samples that have none."""
    if len(values) == log.n:
        return values
    return np.stack([np.interp(log.times, part.times, column) for column in values.T], axis=1)


def _channel(part: Steps, i: int, noise: float | None) -> tuple[FloatArray, FloatArray, float, float]:
    """Force, deviation, noise and walk of one channel, computed in units of its largest rise."""
    rise = (part.h * part.u)[:, i]
    size = float(np.max(np.abs(rise)))
    if size == 0.0:
        return np.zeros(len(rise) + 1), np.zeros(len(rise) + 1), 0.0, 0.0
    given = None if noise is None else max(noise / size, _LEAST)
    s, walk = _levels(part.on_grid(part.dt)[:, i] / size, part.dt, given)
    force, deviation = rauch_tung_striebel(part.h[:, 0], rise / size, s, walk)
    return size * force, size * deviation, size * s, size * walk


def _levels(u: FloatArray, h: float, noise: float | None) -> tuple[float, float]:
    """Noise s and walk q^(1/2) of largest likelihood.

    Innovations of the steady filter with L = q h^3 / s^2: e = [1 - 2 z^-1 + z^-2] / [1 + (K1 + K2 h - 2) z^-1 +
    (1 - K1) z^-2] z_k, of variance s^2 / (1 - K1); s is the most likely one for each L unless it is given.
    """

    def loss(log_ratio: float) -> tuple[float, float]:
        K1, K2 = KalmanDifferentiator(q=math.exp(log_ratio), r=h**3).gain(h)
        # dz = h u, so one difference less; its first value is no innovation.
        e = np.asarray(lfilter([1.0, -1.0], [1.0, K1 + K2 * h - 2.0, 1.0 - K1], h * u))[1:]
        grown = 1.0 / (1.0 - K1)
        s2 = max(float(np.mean(e**2)) / grown, _LEAST**2) if noise is None else noise**2
        return math.log(s2 * grown) + float(np.mean(e**2)) / (s2 * grown), math.sqrt(s2)

    best, _ = least(lambda x: loss(x)[0], np.linspace(-35.0, 7.0, 43))
    s = loss(best)[1]
    return s, math.sqrt(math.exp(best) * s**2 / h**3)


def rauch_tung_striebel(
    h: FloatArray, rise: FloatArray, s: float, walk: float
) -> tuple[FloatArray, FloatArray]:
    """Force (m + 1,) and its deviation from the rises of z over the steps (m,); plain floats, which are fast here."""
    q, r, wide = walk**2, s * s, (_WIDE * float(np.max(np.abs(rise / h)) + s / np.min(h) + walk)) ** 2
    y, f, a, b, c = 0.0, 0.0, r, 0.0, wide  # z_0 = 0: y is counted from it; covariance [[a, b], [b, c]]
    before: list[tuple[float, ...]] = []
    after: list[tuple[float, ...]] = [(y, f, a, b, c)]
    z = 0.0
    for step, dz in zip(h.tolist(), rise.tolist(), strict=True):
        y += step * f
        a += step * (2.0 * b + step * c) + q * step**3 / 3.0
        b += step * c + q * step**2 / 2.0
        c += q * step
        before.append((y, f, a, b, c))
        z += dz
        k1, k2 = a / (a + r), b / (a + r)
        e = z - y
        y, f = y + k1 * e, f + k2 * e
        a, b, c = r * k1, r * k2, c - k2 * b
        after.append((y, f, a, b, c))
    forces, variances = [f], [c]
    Y, F, A, B, C = y, f, a, b, c
    for step, predicted, (y, f, a, b, c) in zip(
        h[:0:-1].tolist(), before[:0:-1], after[-2:0:-1], strict=True
    ):
        yp, fp, ap, bp, cp = predicted
        det = ap * cp - bp * bp
        # G = P F' P_predicted^-1, with P F' = [[a + h b, b], [b + h c, c]].
        t, w = a + step * b, b + step * c
        g11, g12 = (t * cp - b * bp) / det, (b * ap - t * bp) / det
        g21, g22 = (w * cp - c * bp) / det, (c * ap - w * bp) / det
        dy, df, da, db, dc = Y - yp, F - fp, A - ap, B - bp, C - cp
        Y, F = y + g11 * dy + g12 * df, f + g21 * dy + g22 * df
        A = a + g11 * (da * g11 + db * g12) + g12 * (db * g11 + dc * g12)
        B = b + g11 * (da * g21 + db * g22) + g12 * (db * g21 + dc * g22)
        C = c + g21 * (da * g21 + db * g22) + g22 * (db * g21 + dc * g22)
        forces.append(F)
        variances.append(C)
    force, variance = _first(float(h[0]), r, q, np.array([Y, F]), np.array([[A, B], [B, C]]))
    forces.append(force)
    variances.append(variance)
    return np.array(forces[::-1]), np.sqrt(np.maximum(variances[::-1], 0.0))


def _first(h: float, r: float, q: float, mean: FloatArray, covariance: FloatArray) -> tuple[float, float]:
    """The same step back to the first sample, where nothing was known of f: in information, which is 0 then."""
    into = np.array([[12.0 / h**3, -6.0 / h**2], [6.0 / h**2, -2.0 / h]]) / q  # F' Q^-1
    own = np.array([[12.0 / h**3, 6.0 / h**2], [6.0 / h**2, 4.0 / h]]) / q + [[1.0 / r, 0.0], [0.0, 0.0]]
    gain = np.linalg.solve(own, into)
    return float((gain @ mean)[1]), float((np.linalg.inv(own) + gain @ covariance @ gain.T)[1, 1])
