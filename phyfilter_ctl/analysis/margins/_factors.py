"""Stable rational functions kept as factors, with bounds on what they do between two frequencies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..._sections import ComplexArray, FloatArray

__all__ = ["Factors", "roots_of", "trimmed"]

# Share of the largest term at the slowest or fastest pole that counts as rounding.
_NOTHING = 1e-13


@dataclass(frozen=True, eq=False)
class Factors:
    """gain * prod (s - zeros) / prod (s - poles), with at least as many poles as zeros, all in Re s < 0 (the poles).

    Kept as factors, zeros at s = 0 stay exact and repeated poles cost nothing.
    """

    gain: float
    zeros: ComplexArray
    poles: ComplexArray

    @classmethod
    def build(cls, gain: float, zeros: ComplexArray, poles: ComplexArray) -> Factors:
        """Zeros and poles of like size side by side, so that no partial product is large."""
        return cls(gain, zeros[np.argsort(np.abs(zeros))], poles[np.argsort(np.abs(poles))])

    def __call__(self, s: ComplexArray) -> ComplexArray:
        value = np.full(np.shape(s), self.gain, dtype=np.complex128)
        paired = len(self.zeros)
        for zero, pole in zip(self.zeros, self.poles[:paired], strict=True):
            value = value * ((s - zero) / (s - pole))
        for pole in self.poles[paired:]:
            value = value / (s - pole)
        return value

    def bounds(self, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Upper bounds of |value| and of |d value / d omega| for omega in [low, high], each (K,).

        (s - z)/(s - p) has the derivative (z - p)/(s - p)^2 and 1/(s - p) has -1/(s - p)^2; each factor is bounded by
        itself, so both bounds close in on the values as the intervals shrink.
        """
        size = np.full(np.shape(low), abs(self.gain))
        slope = np.zeros(np.shape(low))
        paired = len(self.zeros)
        for i, pole in enumerate(self.poles):
            near = _nearest(pole, low, high)
            if i < paired:
                zero = self.zeros[i]
                ratio = np.maximum(np.abs(1j * low - zero), np.abs(1j * high - zero)) / near
                slope = slope + abs(zero - pole) / near**2 / ratio
                size = size * ratio
            else:
                slope = slope + 1.0 / near
                size = size / near
        return size, size * slope

    def beyond(self, omega: float) -> tuple[float, float]:
        """For all frequencies of at least ``omega`` > max |poles|: upper bounds of |value| and of |value/gain - 1|.

        The second is for as many poles as zeros; |(s - z)/(s - p) - 1| = |z - p|/|s - p|.
        """
        far = omega - np.abs(self.poles)
        paired = len(self.zeros)
        excess = float(np.prod(1.0 + np.abs(self.zeros - self.poles[:paired]) / far[:paired]))
        return abs(self.gain) * excess / float(np.prod(far[paired:])), excess - 1.0


def _nearest(pole: complex, low: FloatArray, high: FloatArray) -> FloatArray:
    """Least distance of j omega in [low, high] from the pole."""
    return np.abs(1j * np.clip(pole.imag, low, high) - pole)


def trimmed(ascending: FloatArray, poles: ComplexArray) -> FloatArray:
    """A numerator without the first and last coefficients that rounding left: they act only far below the slowest and
    far above the fastest of the poles, and would put zeros there."""
    kept = np.array(ascending)
    sizes = np.abs(poles)
    for end, scale in ((slice(None), float(sizes.min())), (slice(None, None, -1), float(sizes.max()))):
        size = np.abs(kept * scale ** np.arange(len(kept), dtype=float))[end]
        lost = np.cumsum(size > _NOTHING * np.max(size)) == 0
        kept[end][lost] = 0.0
    return kept


def roots_of(ascending: FloatArray | ComplexArray) -> tuple[float, ComplexArray]:
    """Leading coefficient, real, and roots of a polynomial, roots at s = 0 exact; (0, none) for the zero polynomial."""
    used = np.flatnonzero(ascending)
    if len(used) == 0:
        return 0.0, np.zeros(0, dtype=np.complex128)
    first, last = int(used[0]), int(used[-1])
    core = ascending[first : last + 1]
    # In s / scale first and last coefficient have one size.
    scale = float(abs(core[0] / core[-1])) ** (1.0 / max(len(core) - 1, 1))
    roots = np.roots((core / core[-1] * scale ** (np.arange(len(core)) - (len(core) - 1.0)))[::-1]) * scale
    return float(core[-1].real), np.concatenate([np.zeros(first), roots]).astype(np.complex128)
