"""The unknowns that a descent moves: of all denominators of an order, or of those within limits.

Without limits they are the logarithms of the Schwarz form (``parametrisation``). Limits on single poles are no box
there. Within limits the denominator is a product of the given poles, of pairs and of one real pole, each in a box:

    pair: s^2 + 2 y w s + w^2,    x = log w,    y = 1 + q (1 - damping) for q <= 0, 1 + q (cosh v(x) - 1) for q > 0

with v the distance of x to the nearer end of the range, so that both poles of a real pair stay inside. Derivatives go
through the coefficients of D, which both sets of unknowns move smoothly, poles that meet included.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.polynomial import polynomial

from ..._sections import ComplexArray, FloatArray, polynomial_from_roots, sort_poles
from .parametrisation import Chain, chain_of
from .sensitivity import Evaluation

__all__ = ["FASTEST", "Coordinates", "Limited", "Schwarz", "chain_slopes"]

# n equal poles at this over the step lie just within the bounds. As an additional pole of the low-pass form it costs
# 0.5 %, and beyond it the sampled filter hardly changes.
FASTEST = 3.0
# The rates of the Schwarz form may fall this far below the least decay rate.
_SLOWEST = 1e-3
# Poles this near an end of their range, relative, lie at it.
_AT_END = 0.01


class Coordinates(Protocol):
    """Unknowns theta and the chains they stand for."""

    def chain(self, theta: FloatArray) -> Chain:
        """The chain of some unknowns."""
        ...

    def of(self, poles: ComplexArray, *, inside: bool = True) -> FloatArray:
        """The unknowns of these poles, moved inside the limits; without ``inside`` only as far as they must."""
        ...

    def pulled(self, found: Evaluation, chain: Chain, theta: FloatArray) -> Evaluation:
        """The evaluation with derivatives by these unknowns instead of the chain's."""
        ...

    def coefficients(self, chain: Chain, theta: FloatArray) -> FloatArray:
        """d a_j / d theta_i at [i, j]."""
        ...

    def box(self, n: int) -> tuple[FloatArray, FloatArray]:
        """Upper and lower bounds of the unknowns of order n."""
        ...

    def at_end(self, poles: ComplexArray) -> bool:
        """Whether a pole lies at an end of what is allowed."""
        ...


@dataclass(frozen=True)
class Schwarz:
    """All denominators whose poles decay at the floor at least, and by n FASTEST / step together at most.

    Attributes
    ----------
    step : float
        Longest sampling interval in s.
    floor : float
        Least decay rate in rad/s.
    """

    step: float
    floor: float

    def chain(self, theta: FloatArray) -> Chain:
        """See :class:`Coordinates`."""
        return Chain(theta, self.floor)

    def of(self, poles: ComplexArray, *, inside: bool = True) -> FloatArray:
        """See :class:`Coordinates`."""
        theta = chain_of(sort_poles(poles), self.floor).theta
        upper, lower = self.box(len(theta))
        return np.clip(theta, lower, upper) if inside else theta

    def pulled(self, found: Evaluation, chain: Chain, theta: FloatArray) -> Evaluation:
        """See :class:`Coordinates`."""
        return found

    def coefficients(self, chain: Chain, theta: FloatArray) -> FloatArray:
        """See :class:`Coordinates`."""
        return chain.polynomials[2]

    def box(self, n: int) -> tuple[FloatArray, FloatArray]:
        """(s + P)^n has d = n P, and k_1 = P sqrt((n^2 - 1) / 3) largest."""
        upper = np.full(n, np.log(FASTEST / self.step * np.sqrt((n * n - 1.0) / 3.0 or 1.0)))
        upper[0] = np.log(n * FASTEST / self.step)
        return upper, np.full(n, np.log(_SLOWEST * self.floor))

    def at_end(self, poles: ComplexArray) -> bool:
        """See :class:`Coordinates`."""
        return bool(np.any(-poles.real < (1.0 + _AT_END) * self.floor))


@dataclass(frozen=True, eq=False)
class Limited:
    """Denominators with some poles given and the others between limits.

    Attributes
    ----------
    given : (m,) complex array
        Poles that stay.
    low, high : float
        Least and largest magnitude of the others in rad/s.
    damping : float
        Least damping ratio of the others.
    """

    given: ComplexArray
    low: float
    high: float
    damping: float

    def chain(self, theta: FloatArray) -> Chain:
        """See :class:`Coordinates`."""
        parts = [self._pair(*theta[i : i + 2])[0] for i in range(0, len(theta) - 1, 2)]
        roots = [root for c0, c1 in parts for root in _roots(c0, c1)]
        if len(theta) % 2:
            roots.append(complex(-np.exp(theta[-1])))
        return chain_of(sort_poles(np.concatenate([self.given, np.array(roots, dtype=np.complex128)])))

    def of(self, poles: ComplexArray, *, inside: bool = True) -> FloatArray:
        """See :class:`Coordinates`; poles nearest to the given ones make room for them."""
        count = len(poles) - len(self.given)
        pairs = [p for p in poles if p.imag > 0.0]
        reals = sorted((float(-p.real) for p in poles if p.imag == 0.0), reverse=True)
        for p in self.given:
            self._make_room(complex(p), pairs, reals)
        low, high = np.log(self.low), np.log(self.high)
        theta: list[float] = []
        for p in pairs[: count // 2]:
            damping = max(-p.real / abs(p), self.damping)
            q = (damping - 1.0) / (1.0 - self.damping) if self.damping < 1.0 else 0.0
            theta += [float(np.clip(np.log(abs(p)), low, high)), q]
        left = count - len(theta)
        reals = (reals + [np.sqrt(self.low * self.high)] * left)[:left]
        rates = [float(r) for r in np.clip(np.log(np.maximum(reals, 1e-300)), low, high)]
        for one, other in zip(rates[: left - 1 : 2], rates[1::2], strict=False):
            x, v = 0.5 * (one + other), 0.5 * abs(one - other)
            room = np.cosh(min(x - low, high - x)) - 1.0
            theta += [x, min(float((np.cosh(v) - 1.0) / room), 1.0) if room > 0.0 else 0.0]
        return np.array([*theta, *rates[left - left % 2 :]])

    @staticmethod
    def _make_room(p: complex, pairs: list[complex], reals: list[float]) -> None:
        """Take the pole nearest to p out; the other of a pair that loses one becomes real."""
        if p.imag < 0.0:
            return
        if p.imag > 0.0 and pairs:
            pairs.remove(min(pairs, key=lambda other: abs(other - p)))
        elif p.imag > 0.0:
            del reals[:2]
        elif reals:
            reals.remove(min(reals, key=lambda other: abs(other + p)))
        elif pairs:
            reals.append(abs(pairs.pop()))

    def pulled(self, found: Evaluation, chain: Chain, theta: FloatArray) -> Evaluation:
        """See :class:`Coordinates`."""
        moved = chain_slopes(self, chain, theta)
        return found._replace(gradient=moved @ found.gradient, curvature=moved @ found.curvature @ moved.T)

    def coefficients(self, chain: Chain, theta: FloatArray) -> FloatArray:
        """See :class:`Coordinates`."""
        factors: list[FloatArray] = []
        slopes: list[tuple[int, FloatArray]] = []
        for i in range(0, len(theta) - 1, 2):
            (c0, c1), by_x, by_q = self._pair(*theta[i : i + 2])
            slopes += [(len(factors), by_x), (len(factors), by_q)]
            factors.append(np.array([c0, c1, 1.0]))
        if len(theta) % 2:
            rate = float(np.exp(theta[-1]))
            slopes.append((len(factors), np.array([rate])))
            factors.append(np.array([rate, 1.0]))
        n = len(self.given) + len(theta)
        rows = np.zeros((len(theta), n))
        for i, (factor, slope) in enumerate(slopes):
            product = (
                np.append(polynomial_from_roots(self.given), 1.0) if len(self.given) else np.array([1.0])
            )
            for k, other in enumerate(factors):
                product = polynomial.polymul(product, slope if k == factor else other)
            rows[i, : len(product)] = product[:n]
        return rows

    def _pair(self, x: float, q: float) -> tuple[tuple[float, float], FloatArray, FloatArray]:
        """(c0, c1) of s^2 + c1 s + c0, and its derivatives by x and q."""
        w, y, y_x, y_q = float(np.exp(x)), 1.0 + q * (1.0 - self.damping), 0.0, 1.0 - self.damping
        if q > 0.0:
            below, above = x - np.log(self.low), np.log(self.high) - x
            v = max(min(below, above), 0.0)
            y_q = float(np.cosh(v)) - 1.0
            y, y_x = 1.0 + q * y_q, q * float(np.sinh(v)) * (1.0 if below < above else -1.0)
        c1 = 2.0 * w * y
        by_x, by_q = np.array([2.0 * w * w, c1 + 2.0 * w * y_x]), np.array([0.0, 2.0 * w * y_q])
        return (w * w, c1), by_x, by_q

    def box(self, n: int) -> tuple[FloatArray, FloatArray]:
        """See :class:`Coordinates`."""
        count = n - len(self.given)
        upper, lower = np.ones(count), np.full(count, 0.0 if self.damping >= 1.0 else -1.0)
        sizes = [*range(0, count - 1, 2), *([count - 1] if count % 2 else [])]
        upper[sizes], lower[sizes] = np.log(self.high), np.log(self.low)
        return upper, lower

    def at_end(self, poles: ComplexArray) -> bool:
        """See :class:`Coordinates`."""
        free = [p for p in poles if not len(self.given) or np.min(np.abs(self.given - p)) > 1e-9 * abs(p)]
        sizes, dampings = np.abs(free), [-p.real / abs(p) for p in free]
        return bool(
            np.any(sizes < (1.0 + _AT_END) * self.low)
            or np.any(sizes > self.high / (1.0 + _AT_END))
            or any(d < (1.0 + _AT_END) * self.damping for d in dampings if d < 1.0 - 1e-9)
        )


def chain_slopes(coordinates: Coordinates, chain: Chain, theta: FloatArray) -> FloatArray:
    """How the unknowns move those of the chain, at [i, j]: d a = d theta_chain a_slopes, in units of a."""
    a, _, a_slopes, _ = chain.polynomials
    moved = np.linalg.solve((a_slopes / a).T, (coordinates.coefficients(chain, theta) / a).T).T
    return np.asarray(moved, dtype=float)


def _roots(c0: float, c1: float) -> tuple[complex, complex]:
    """Roots of s^2 + c1 s + c0 with c0, c1 > 0, the smaller one without cancellation."""
    left = 0.25 * c1 * c1 - c0
    if left < 0.0:
        root = complex(-0.5 * c1, np.sqrt(-left))
        return root, root.conjugate()
    fast = -(0.5 * c1 + np.sqrt(left))
    return complex(fast), complex(c0 / fast)
