"""A filter on flights sample by sample: its answer, and moments for steps that differ or samples with own weights."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from ..._sections import FloatArray
from ...filter import PhyFilter, Recursion, Sampling, blocked, record
from ...filter.phyfilter import chain_of
from ...filter.recursion import transition
from ...filter.sampling import Method
from .residuals import Flight, each
from .sensitivity import Data


def response(filter: PhyFilter, flight: Flight, method: Method, last: int | None = None) -> FloatArray:
    """f_hat - f_theta after the first ``last`` steps (m, K) of a flight."""
    u, steps = flight.u[:last], None if flight.steps is None else flight.steps[:last]
    sampling, y = Sampling(flight.dt, method), np.empty_like(u)
    recursion = Recursion((chain_of(filter, sampling),), sampling)
    for rows, part in record.respond(recursion, len(u), u.shape[1], lambda rows: u[rows], steps):
        y[rows] = part
    return y


@dataclass(frozen=True, eq=False)
class Samples:
    """A flight as it is, with its own steps and weights, a chunk at a time.

    Attributes
    ----------
    flight : Flight
    method : {"exact", "matched", "euler", "tustin"}
    offset : bool
        Whether the label of each channel has an offset, fitted along (``offsets``).
    energy, weight : float
        sum w gamma*^2 and sum w.
    """

    flight: Flight
    method: Method
    offset: bool = False
    energy: float = field(init=False)
    weight: float = field(init=False)

    def __post_init__(self) -> None:
        flight = self.flight
        squares, samples = flight.target**2, float(flight.samples)
        if flight.sample_weights is not None:
            squares, samples = flight.sample_weights * squares, float(np.sum(flight.sample_weights))
        energy = float(np.sum(squares))
        if self.offset:
            weights, total = self._totals
            energy -= float(np.sum(total**2 / weights))
        object.__setattr__(self, "energy", flight.weight * energy)
        object.__setattr__(self, "weight", flight.weight * samples)

    @property
    def _totals(self) -> tuple[FloatArray, FloatArray]:
        """Sums (K,) of the weights and of the weighted gamma*, by channel."""
        flight = self.flight
        if flight.sample_weights is None:
            return np.full(flight.u.shape[1], float(len(flight.u))), flight.target.sum(axis=0)
        weights = np.maximum(flight.sample_weights.sum(axis=0), np.finfo(float).tiny)
        return weights, (flight.sample_weights * flight.target).sum(axis=0)

    def moments(self, doubled: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """See :class:`~phyfilter_ctl.design.learning.sensitivity.Data`."""
        flight, size = self.flight, len(doubled) - 1
        if self.method == "euler" and not self._is_stable(doubled):
            return None
        G, cross = np.zeros((size, size)), np.zeros(size)
        sums = np.zeros((flight.u.shape[1], size))
        for rows, s in self.states(doubled):
            for channel in range(flight.u.shape[1]):
                own = s[:, :, channel]
                weights = flight.sample_weights
                weighted = own if weights is None else own * weights[rows, channel]
                G += weighted @ own.T
                cross += weighted @ flight.target[rows, channel]
                if self.offset:
                    sums[channel] += weighted.sum(axis=1)
        if self.offset:
            weights, total = self._totals
            G -= (sums.T / weights) @ sums
            cross -= sums.T @ (total / weights)
        return flight.weight * G, flight.weight * cross

    def states(self, doubled: FloatArray) -> Iterator[tuple[slice, FloatArray]]:
        """States (2n, m, K) of the sampled chain, a chunk of samples at a time."""
        flight, size = self.flight, len(doubled) - 1
        rates = np.linalg.eigvals(doubled[: size // 2, : size // 2])
        m, count = flight.u.shape
        rest = -np.asarray(np.linalg.solve(doubled[:-1, :-1], doubled[:-1, -1]), dtype=float)
        state = np.zeros((count, size))
        shortest = flight.dt if flight.steps is None else float(np.min(flight.steps))
        refine = blocked.needs_refinement(float(np.min(np.abs(rates))), shortest)
        for first in range(0, m, blocked.IRREGULAR_CHUNK):
            rows = slice(first, min(first + blocked.IRREGULAR_CHUNK, m))
            dA = self._increments(doubled[:-1, :-1], rows)
            s, state = blocked.irregular(dA, rest, np.eye(size), flight.u[rows], state, refine=refine)
            yield rows, s

    def _is_stable(self, doubled: FloatArray) -> bool:
        rates = np.linalg.eigvals(doubled[: len(doubled) // 2, : len(doubled) // 2])
        longest = self.flight.dt if self.flight.steps is None else float(np.max(self.flight.steps))
        return bool(np.all(np.abs(1.0 + rates * longest) < 1.0))

    def _increments(self, A: FloatArray, rows: slice) -> FloatArray:
        steps = self.flight.steps
        if steps is None:
            return transition(A, self.method, self.flight.dt)[None]
        # Recorders round their clocks: few steps differ.
        distinct, which = np.unique(steps[rows], return_inverse=True)
        return transition(A, self.method, distinct)[which]


@dataclass(frozen=True, eq=False)
class Pooled:
    """Several sources as one."""

    parts: Sequence[Data]

    @property
    def energy(self) -> float:
        """sum w gamma*^2."""
        return sum(part.energy for part in self.parts)

    @property
    def weight(self) -> float:
        """sum w."""
        return sum(part.weight for part in self.parts)

    def moments(self, doubled: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """See :class:`~phyfilter_ctl.design.learning.sensitivity.Data`."""
        at_hand = [part for part in self.parts if not isinstance(part, Samples)]
        to_read = [part for part in self.parts if isinstance(part, Samples)]
        found = [part.moments(doubled) for part in at_hand]
        found += each(partial(Samples.moments, doubled=doubled), to_read)
        kept = [entry for entry in found if entry is not None]
        if len(kept) < len(found):
            return None
        return np.sum([G for G, _ in kept], axis=0), np.sum([m for _, m in kept], axis=0)
