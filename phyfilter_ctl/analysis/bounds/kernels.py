"""Impulse responses from what is bounded to the error, and the certified integral of their absolute value.

The largest output that an input bounded by 1 can force is the L1 norm of the impulse response, its peak-to-peak gain;
for vectors in the 2-norm as well, where all channels share the kernel. The integral is enclosed from both sides:

* below: the sum of |integral of K| over any partition;
* above: the same plus what a change of sign may hide in an interval, from the Bernstein coefficients of K's Taylor
  polynomial there, plus what lies behind the last interval.

Rounding widens both: what it may do to states, sums and coefficients is bounded by first-order analysis, with the
constants rounded up, and reported as a part.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ... import _sections
from ..._sections import ComplexArray, FloatArray
from ...filter import PhyFilter
from .walk import ROUNDOFF, Stretch, areas, walk

__all__ = ["Certificate", "Kernel", "error_kernel", "estimate_kernel", "noise_kernel"]

# Width to which a bound is enclosed, relative; the promise is 1e-6.
_GAP = 2e-7
# Of it, what may be left out at the end.
_TAIL = 1e-10
# Most intervals before the enclosure is refused, or left wider than _GAP.
_MOST_POINTS = 1_000_000
# Halvings of an interval with a change of sign: what is hidden there falls by four each.
_MOST_HALVINGS = 24


class Certificate(NamedTuple):
    """What is known of an integral: it lies between ``lower`` and ``upper``."""

    lower: float
    upper: float
    tail: float  # part of ``upper`` that stands for all times after the horizon
    horizon: float  # seconds
    points: int
    rounding: float = (
        0.0  # part of ``upper``, and taken off ``lower``, for the arithmetic of the bound itself
    )

    @property
    def gap(self) -> float:
        """(upper - lower) / upper."""
        return (self.upper - self.lower) / self.upper if self.upper else 0.0


@dataclass(frozen=True, eq=False)
class Kernel:
    """gain * (direct * delta(t) + C e^(A t) B) with t in units of ``unit`` seconds.

    Parameters
    ----------
    A : (n, n) array
        A chain of sections.
    B, C : (n,) arrays
    direct, gain, unit : float
    numerator : (n,) array
        Ascending coefficients of C (s - A)^-1 B over those of the scaled D.
    doubt : float
        What the rounding of A, B and C may change of the integral of |C e^(A t) B|.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    direct: float
    gain: float
    unit: float
    numerator: FloatArray
    doubt: float

    @cached_property
    def _enclosed(self) -> tuple[Certificate, list[Stretch]]:
        stretches, tail, horizon = walk(self.A, self.B, self.C, _TAIL, _MOST_POINTS)
        sizes = [stretch.whole for stretch in stretches]
        total = max(float(sum(area.sum() for area, _ in sizes)), 1e-300)
        points = sum(len(stretch.left) for stretch in stretches)
        enough = 0.1 * _GAP * total / points
        rounding = self.doubt
        for stretch in stretches:
            states = stretch.roundings
            rounding += float(np.abs(stretch.C) @ areas(stretch.A, states))
        rounding += (20.0 + float(np.sqrt(points))) * ROUNDOFF * total  # sums, by numpy in pairs
        final: list[Stretch] = []
        below = above = 0.0
        while stretches:
            stretch = stretches.pop()
            for _ in range(_MOST_HALVINGS):
                area, excess = stretch.whole
                done = excess <= enough
                if done.all() or points > _MOST_POINTS:
                    break
                final.append(stretch.some(done))
                below, above = below + float(area[done].sum()), above + float((area + excess)[done].sum())
                stretch = stretch.some(~done).halved()
                points += len(stretch.left) // 2
            area, excess = stretch.whole
            final.append(stretch)
            below, above = below + float(area.sum()), above + float((area + excess).sum())
        scale, direct = float(abs(self.gain)), float(abs(self.direct))
        rounding = scale * (rounding + 4.0 * ROUNDOFF * (direct + above))
        certificate = Certificate(
            max(
                scale * (direct + below - tail) - rounding, 0.0
            ),  # dropped sections may have had another sign
            scale * (direct + above + tail) + rounding,
            scale * tail,
            float(horizon * self.unit),
            points,
            rounding,
        )
        return certificate, final

    @property
    def l1(self) -> Certificate:
        """Integral of |K| over all times, the direct part included."""
        return self._enclosed[0]

    def at(self, times: FloatArray) -> FloatArray:
        """K without its direct part, shape (N,), at times in seconds."""
        delta = _sections.expm1(self.A, times / self.unit)
        return self.gain / self.unit * (self.B + delta @ self.B) @ self.C

    def running(self, times: FloatArray) -> FloatArray:
        """Bound of the integral of |K| from 0 to each of the times in seconds, the direct part included, (N,)."""
        certificate, stretches = self._enclosed
        starts = np.concatenate([stretch.starts for stretch in stretches])
        group = np.concatenate([np.full(len(s.starts), i) for i, s in enumerate(stretches)])
        inside = np.concatenate([np.arange(len(s.starts), dtype=np.intp) for s in stretches])
        order = np.argsort(starts, kind="stable")
        sums = np.concatenate([np.sum(s.whole, axis=0) for s in stretches])[order]
        before = np.concatenate([[0.0], np.cumsum(sums)])
        when = times / self.unit
        place = np.clip(np.searchsorted(starts[order], when, side="right") - 1, 0, len(order) - 1)
        last = np.zeros(len(when))
        for i, stretch in enumerate(stretches):
            mine = group[order[place]] == i
            if mine.any():
                which = inside[order[place[mine]]]
                share = np.clip((when[mine] - stretch.starts[which]) / stretch.step, 0.0, 1.0)
                last[mine] = np.sum(stretch.some(which).enclosed(share), axis=0)
        total = abs(self.gain) * (abs(self.direct) + before[place] + last)
        return np.minimum(total + certificate.tail + certificate.rounding, certificate.upper)


def _scaled(filter: PhyFilter) -> tuple[float, FloatArray, FloatArray, FloatArray]:
    """Speed w, poles / w, and a, b, c (c_n = 1 included) in powers of s / w."""
    w = float(np.exp(np.mean(np.log(np.abs(filter.poles)))))
    powers = w ** np.arange(filter.order, 0, -1.0)
    return w, filter.a / powers, filter.b / powers, np.append(filter.error_numerator[:-1] / powers, 1.0)


def _kernel(
    filter: PhyFilter, w: float, a: FloatArray, numerator: FloatArray, direct: float, gain: float
) -> Kernel:
    poles = filter.poles / w
    A, equilibrium = _sections.chain(poles)
    padded = np.zeros(filter.order)
    padded[: len(numerator)] = numerator
    B, C = -A @ equilibrium, _sections.chain_output(poles, a, padded)
    doubt = _doubt(poles, a, padded, A, equilibrium, C)
    return Kernel(A, B, C, direct, gain, 1.0 / w, padded, doubt)


def _doubt(
    poles: ComplexArray, a: FloatArray, numerator: FloatArray, A: FloatArray, e: FloatArray, C: FloatArray
) -> float:
    """What the rounding of A, B and C, and a that is not quite the product over the poles, may change of the area."""
    n = len(C)
    of_states = areas(A, np.abs(A @ e))
    columns = _sections.chain_numerator(poles, a, np.eye(n))  # a scaled: a_0 = 1
    back = np.abs(np.linalg.inv(columns))
    of_C = back @ (4.0 * n * ROUNDOFF * (np.abs(columns) @ np.abs(C) + np.abs(numerator))) @ of_states
    of_A = np.abs(C) @ areas(A, 8.0 * ROUNDOFF * np.abs(A) @ of_states)
    of_B = np.abs(C) @ areas(A, 4.0 * ROUNDOFF * np.abs(A) @ np.abs(e))
    product = _sections.polynomial_from_roots(poles)
    of_a = (np.abs(a - product) + 4.0 * n * ROUNDOFF * np.abs(a)) @ (back.T @ of_states)
    return float(of_C + of_A + of_B + of_a * (np.abs(C) @ of_states))


def error_kernel(filter: PhyFilter, derivative: int) -> Kernel:
    """(1 - F) / s^k: from the k-th derivative of the residual to the error."""
    w, a, b, c = _scaled(filter)
    if derivative == 0:
        return _kernel(filter, w, a, -b, 1.0, 1.0)
    return _kernel(filter, w, a, c[derivative:], 0.0, w**-derivative)


def estimate_kernel(filter: PhyFilter) -> Kernel:
    """F: from an error of the residual to the estimate."""
    w, a, b, _ = _scaled(filter)
    return _kernel(filter, w, a, b, 0.0, 1.0)


def noise_kernel(filter: PhyFilter) -> Kernel:
    """s F: from noise of M x to the estimate."""
    w, a, b, _ = _scaled(filter)
    numerator = np.concatenate([[0.0], b[:-1]]) - b[-1] * a
    return _kernel(filter, w, a, numerator, float(b[-1]), w)
