"""Whether the signals of a recording agree: the label with M x' - g in size, sign and channel, and g in time.

Both checks work on sums that add up over recordings, so that they can be kept of files that are read once.

Over windows the means of u = M x' - g and of the label differ by noise. With noise in both, the factor c between them,
u = c label, lies between the two regressions (R. Frisch, Statistical Confluence Analysis, 1934)

    S_ul / S_ll <= c <= S_uu / S_ul.

A g that acts late shows in M x' alone. With v = M x' - g - (label or f_theta), as far as they are known, autoregressive
of order p, both sides are whitened by it and correlated at all lags from 0 on (Box and Jenkins, Time Series Analysis,
1970). The past of M x' is in the autoregression, so that a g which reacts to f and to noise of x, in a loop, is not
taken for a late one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import fft
from scipy.linalg import solve_toeplitz

from .._sections import FloatArray

__all__ = [
    "LagSums",
    "Late",
    "WindowSums",
    "label_factor_fault",
    "lag_sums",
    "late_g",
    "late_text",
    "window_sums",
]

_WINDOWS = (200, 800, 3200)  # of a recording
_LEAST_WINDOWS = 20
_SURE = 8.0  # standard errors that a correlation is off 0
_DEVIATIONS = 6.0  # and that a factor may be off
_FACTOR = 2.0  # a label that is off by less is another error than one of its unit
_ALIKE, _UNLIKE = 0.8, 0.5  # correlations of labels that go with another channel, and not with their own

_BLOCK = 0.005  # s: faster samples are averaged
_ORDER, _LAGS = 32, 40  # of the autoregression, and largest lag, in blocks
_KEPT = _ORDER + _LAGS + 2
_MOST = 200_000  # steps to judge by
_LIKELIER = 25.0  # logarithm of the likelihood ratio
_LEAST_LAG = 0.5  # blocks
_LONGEST = 20.0  # steps that a gap counts for
_MOVED = 0.1  # share of f that a late g is taken for
_GAINS = (0.5, 2.0)
_ROUNDS, _RIDGE, _TAPERED = 3, 1e-9, 0.5


# -- the label over windows ---------------------------------------------------------------------------------------


class WindowSums(NamedTuple):
    """Products of window means about their means, for one length of window."""

    windows: int
    uu: FloatArray  # (K,)
    ul: FloatArray  # (K, K)
    ll: FloatArray  # (K,)


def window_sums(u: FloatArray, label: FloatArray, steps: FloatArray | None = None) -> tuple[WindowSums, ...]:
    """Of M x' - g and the label's means over steps, (m, K) each, for every length of window that gives 20 of them."""
    m, K = u.shape
    h = np.ones((m, 1)) if steps is None else steps[:, None]
    found = []
    for most in _WINDOWS:
        length = max(1, m // most)
        count = m // length
        if count < _LEAST_WINDOWS or (found and length == 1 and m // _WINDOWS[0] <= 1):
            continue
        rows = slice(0, count * length)
        weight = h[rows].reshape(count, length, 1).sum(axis=1)
        means = [(h * s)[rows].reshape(count, length, K).sum(axis=1) / weight for s in (u, label)]
        a, b = (mean - mean.mean(axis=0) for mean in means)
        found.append(WindowSums(count, (a * a).sum(axis=0), a.T @ b, (b * b).sum(axis=0)))
    return tuple(found)


def label_factor_fault(
    sums: Sequence[tuple[WindowSums, ...]], j: int, channels: Sequence[str], step: float
) -> str:
    """What the factor between M x' - g and the label of channel j says is wrong, in words; empty where nothing is.

    Parameters
    ----------
    sums : sequence of tuple of WindowSums
        Of recordings, looked at one by one and then together.
    j : int
    channels : sequence of str
    step : float
        Typical step in s.
    """
    several = [own for own in sums if own]
    if not several:
        return ""
    if len(several) > 1:
        faults = [found for own in several if (found := _first_fault(own, j, channels, step))]
        if faults:
            return f"{faults[0]} (in {len(faults)} of {len(several)} flights)"
    fewest = min(len(own) for own in several)
    return _first_fault([_added([own[k] for own in several]) for k in range(fewest)], j, channels, step)


def _first_fault(parts: Sequence[WindowSums], j: int, channels: Sequence[str], step: float) -> str:
    return next(filter(None, (_factor_fault(part, j, channels, step) for part in parts)), "")


def _added(parts: Sequence[WindowSums]) -> WindowSums:
    windows, uu, ul, ll = zip(*parts, strict=True)
    return WindowSums(sum(windows), np.sum(uu, axis=0), np.sum(ul, axis=0), np.sum(ll, axis=0))


def _factor_fault(part: WindowSums, j: int, channels: Sequence[str], step: float) -> str:
    scale = np.sqrt(np.maximum(np.outer(part.uu, part.ll), np.finfo(float).tiny))
    alike = np.clip(part.ul / scale, -1.0, 1.0)  # of u by rows, of labels by columns
    own = float(alike[j, j])
    other = int(np.argmax(np.abs(alike[:, j])))
    if (
        other != j
        and abs(own) < _UNLIKE
        and abs(alike[other, j]) > _ALIKE
        and _is_sure(alike[other, j], part)
    ):
        return (
            f"the label of {channels[j]} goes with M x' - g of {channels[other]} (correlation "
            f"{alike[other, j]:.2f}, its own {own:.2f}): channels or axes seem to be permuted"
        )
    if not _is_sure(own, part):
        return ""
    said = f"over {part.windows} windows (correlation {own:.2f})"
    if own < -_UNLIKE:
        return (
            f"the label of {channels[j]} is of the other sign than M x' - g {said}: check the sign of the label and "
            "of g"
        )
    if own < 0.0:
        return ""
    off = 1.0 - _DEVIATIONS / (_DEVIATIONS + _z(own, part))  # share that the deviations leave
    low, high = part.ul[j, j] / part.ll[j], part.uu[j] / part.ul[j, j]
    if high / off >= 1.0 / _FACTOR and low * off <= _FACTOR:
        return ""
    factor = float(np.sqrt(low * high))
    clock = f", or times in ms, of which steps are {step:.4g} s" if step > 1.0 and factor < 1.0 else ""
    return (
        f"the label of {channels[j]} is M x' - g times {1.0 / factor:.3g} {said}: another unit of x, M, g or the label"
        f"{clock}"
    )


def _z(correlation: float, part: WindowSums) -> float:
    return abs(correlation) * float(np.sqrt(part.windows / max(1.0 - correlation**2, 1e-12)))


def _is_sure(correlation: float, part: WindowSums) -> bool:
    return _z(correlation, part) > _SURE


# -- g in time ----------------------------------------------------------------------------------------------------


class LagSums(NamedTuple):
    """Correlations of one channel at lags up to 73 blocks either way."""

    blocks: int
    block: float  # s
    vv: FloatArray
    vg: FloatArray  # sum v_(k+l) g_k
    gg: FloatArray


class Late(NamedTuple):
    """By how much g acts late.

    Attributes
    ----------
    delay : float
        s.
    gain : float
        Of the late g.
    moved : float
        Rms of what the delay moves from g to f, in the unit of g.
    """

    delay: float
    gain: float
    moved: float


def lag_sums(v: FloatArray, g: FloatArray, h: float, steps: FloatArray | None = None) -> tuple[LagSums, ...]:
    """Of every channel of one recording: v = M x' - g less what else is known, and g, means over steps (m, K)."""
    v, g = v[:_MOST], g[:_MOST]
    if steps is not None:
        v, g = (_even(signal, steps[:_MOST], h) for signal in (v, g))
    length = max(1, round(_BLOCK / h))
    count = len(v) // length
    if count < 4 * _KEPT:
        return ()
    v, g = (s[: count * length].reshape(count, length, -1).mean(axis=1) for s in (v, g))
    taper = np.sin(np.pi * (np.arange(count) + 0.5) / count)[:, None]
    v, g = (taper * (s - s.mean(axis=0)) for s in (v, g))
    size = int(fft.next_fast_len(count + _KEPT, real=True) or 0)
    lags = np.arange(-_KEPT, _KEPT + 1)
    found = []
    for j in range(v.shape[1]):
        V, G = (np.asarray(fft.rfft(s[:, j], size)) for s in (v, g))
        vv, vg, gg = (
            np.asarray(fft.irfft(S, size))[lags] for S in (V * V.conj(), V * G.conj(), G * G.conj())
        )
        found.append(LagSums(count, length * h, vv, vg, gg))
    return tuple(found)


def _even(values: FloatArray, steps: FloatArray, h: float) -> FloatArray:
    """Means over equal steps of what is constant over unequal ones; long gaps are short ones here."""
    steps = np.minimum(steps, _LONGEST * h)
    times = np.concatenate([[0.0], np.cumsum(steps)])
    sums = np.vstack([np.zeros((1, values.shape[1])), np.cumsum(values * steps[:, None], axis=0)])
    grid = np.arange(0.0, times[-1], h)
    at = np.stack([np.interp(grid, times, column) for column in sums.T], axis=1)
    return (at[1:] - at[:-1]) / h


def late_g(sums: Sequence[LagSums], size: float) -> Late | None:
    """Whether g of one channel acts late by half a block (2.5 ms, or half a step) or more, and by how much.

    Parameters
    ----------
    sums : sequence of LagSums
        Of recordings; those with blocks as long as the first one's count.
    size : float
        Rms of f: what the delay moves counts where it is a tenth of that.
    """
    alike = [part for part in sums if abs(part.block - sums[0].block) < 0.01 * sums[0].block]
    if not alike:
        return None
    count = sum(part.blocks for part in alike)
    vv, vg, gg = (np.sum([getattr(part, name) for part in alike], axis=0) for name in ("vv", "vg", "gg"))
    if not gg[_KEPT] > 0.0:
        return None
    yg, yy = vg + gg, vv + vg + vg[::-1] + gg
    lags = np.arange(0.0, _LAGS, 0.25)
    gain, lag, gain_now = 1.0, 0.0, 1.0
    for _ in range(_ROUNDS):
        a = _autoregression(_left(yy, yg, gg, gain, lag))[0]
        own, both = (np.convolve(r, np.convolve(a, a[::-1]), "same") for r in (gg, yg))
        powers = np.array([_delayed(own, lag)[0] for lag in lags])
        products = _at(both, lags)
        drops = np.where(products > 0.0, products**2 / np.maximum(powers, np.finfo(float).tiny), 0.0)
        best = int(np.argmax(drops))
        gain, lag, gain_now = (
            float(products[best] / powers[best]),
            float(lags[best]),
            float(products[0] / powers[0]),
        )
    if lag < _LEAST_LAG or not _GAINS[0] < gain < _GAINS[1]:
        return None
    late = _autoregression(_left(yy, yg, gg, gain, lag))[1]
    now = min(_autoregression(_left(yy, yg, gg, c, 0.0))[1] for c in (1.0, gain_now))
    apart = float(gg[_KEPT] - 2.0 * _at(gg, np.array([lag]))[0] + _delayed(gg, lag)[0])
    moved = gain * float(np.sqrt(max(apart, 0.0) / (_TAPERED * count)))
    likelier = 0.5 * _TAPERED * count * float(np.log(max(now, 1e-300) / max(late, 1e-300)))
    if likelier < _LIKELIER or moved < _MOVED * size:
        return None
    return Late(lag * sums[0].block, gain, moved)


def late_text(late: Late, channel: str) -> str:
    """What to know of a late g."""
    return (
        f"g of {channel} seems late by {1e3 * late.delay:.3g} ms (M x' follows it with the factor {late.gain:.2g}): "
        f"{late.moved:.3g} rms of g is taken for f; log what the actuators do, or shift g by that before"
    )


def _at(r: FloatArray, lags: FloatArray) -> FloatArray:
    """A sequence of lags from -74 to 74 between its entries: what is held is linear between steps."""
    return np.interp(lags, np.arange(-_KEPT, _KEPT + 1), r)


def _delayed(gg: FloatArray, lag: float) -> FloatArray:
    """Autocorrelation at lags 0 ... p of g delayed, which is the mean of two samples where the delay is not whole."""
    a, lags = lag % 1.0, np.arange(_ORDER + 1.0)
    return (1.0 - 2.0 * a * (1.0 - a)) * _at(gg, lags) + a * (1.0 - a) * (
        _at(gg, lags + 1.0) + _at(gg, lags - 1.0)
    )


def _left(yy: FloatArray, yg: FloatArray, gg: FloatArray, gain: float, lag: float) -> FloatArray:
    """Autocorrelation at lags 0 ... p of y less a gain times g delayed."""
    lags = np.arange(_ORDER + 1.0)
    return _at(yy, lags) - gain * (_at(yg, lags + lag) + _at(yg, lag - lags)) + gain**2 * _delayed(gg, lag)


def _autoregression(r: FloatArray) -> tuple[FloatArray, float]:
    """Coefficients 1, a_1 ... a_p that whiten, and the variance that is left, by the equations of Yule and Walker."""
    column = r[:-1].copy()
    column[0] *= 1.0 + _RIDGE
    a = -np.asarray(solve_toeplitz(column, r[1:]), dtype=float)
    return np.concatenate([[1.0], a]), float(r[0] + a @ r[1:])
