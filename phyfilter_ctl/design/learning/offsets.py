"""A label offset for every flight and channel, fitted along: what a label loses with its mean.

    min over o of sum_k (gamma*_k - o - c xi_k)^2 = sum_k (gamma*_k - c xi_k)^2 - (sum_k (gamma*_k - c xi_k))^2 / m

The second term is a sum of squares too, of sums over the flight, so it joins the other data as moments of negative
weight. The sums are exact: s_k = E s_{k-1} + beta u_k gives (I - E) sum s = E (s_{a-1} - s_{b-1}) + beta sum u.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..._sections import FloatArray
from ...filter.recursion import transition
from ...filter.sampling import Method
from .correlation import Stretch, memory
from .residuals import Flight

__all__ = ["Offsets"]


@dataclass(frozen=True, eq=False)
class Offsets:
    """What an offset for every group of stretches and channel takes off the moments of the same stretches.

    Attributes
    ----------
    groups : sequence of sequences of Stretch
        Stretches that share offsets: those of a flight. Steps are taken as equal, samples as of equal weight.
    method : {"exact", "matched", "euler", "tustin"}
    rough : bool
        As for correlations.
    """

    groups: Sequence[Sequence[Stretch]]
    method: Method
    rough: bool = False

    @property
    def energy(self) -> float:
        """Minus the squares of the offsets of gamma*."""
        return -sum(weight * float(total @ total) for weight, total in self._totals)

    @property
    def weight(self) -> float:
        """Samples that it adds: none."""
        return 0.0

    @cached_property
    def _totals(self) -> list[tuple[float, FloatArray]]:
        """By group: weight over the number of samples, sum of gamma* (K,)."""
        found = []
        for group in self.groups:
            total = np.sum([part.flight.totals(part.first, part.last)[1] for part in group], axis=0)
            found.append((group[0].weight / sum(part.last - part.first for part in group), total))
        return found

    def moments(self, doubled: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """See :class:`~phyfilter_ctl.design.learning.sensitivity.Data`."""
        size = len(doubled) - 1
        G, m = np.zeros((size, size)), np.zeros(size)
        for group, (weight, total) in zip(self.groups, self._totals, strict=True):
            sums = np.sum([self._sums(doubled, part) for part in group], axis=0)
            G -= weight * sums.T @ sums
            m -= weight * sums.T @ total
        return G, m

    def _sums(self, doubled: FloatArray, part: Stretch) -> FloatArray:
        """Sums (K, 2n) of the states over a stretch."""
        M = transition(doubled, self.method, part.flight.dt)
        increment, beta = M[:-1, :-1], M[:-1, -1]
        n = len(increment) // 2
        slowest = np.max(np.abs(1.0 + np.linalg.eigvals(increment[:n, :n])))
        reach = int(np.ceil(memory(n) / -np.log(max(float(slowest), 1e-300))))
        ends = [
            _state(increment, beta, self._past(part.flight, place, reach))
            for place in (part.first, part.last)
        ]
        driven = np.outer(part.flight.totals(part.first, part.last)[0], beta)
        moved = (ends[0] - ends[1]) @ (increment + np.eye(len(increment))).T
        return np.asarray(np.linalg.solve(-increment, (moved + driven).T).T, dtype=float)

    def _past(self, flight: Flight, place: int, reach: int) -> FloatArray:
        """The last u (l, K) before a place, as many as the chain remembers."""
        if place == 0:
            return np.zeros((0, flight.width))
        past, complete = flight.before(place)
        if past.shape[1] < reach and not complete and not self.rough:
            past = flight.u[:place].T[:, ::-1]
        return past[:, :reach].T[::-1]


def _state(increment: FloatArray, beta: FloatArray, past: FloatArray) -> FloatArray:
    """States (K, 2n) after a record that began at rest, from as much of its end (l, K) as counts."""
    state = np.zeros((past.shape[1], len(beta)))
    block = 64
    E = np.eye(len(beta)) + increment
    powers = [beta]
    while len(powers) < block:
        powers.append(E @ powers[-1])
    over = np.linalg.matrix_power(E, block)
    first = len(past) % block
    if first:
        state = past[:first].T @ np.array(powers[:first])[::-1]
    for start in range(first, len(past), block):
        state = state @ over.T + past[start : start + block].T @ np.array(powers)[::-1]
    return state
