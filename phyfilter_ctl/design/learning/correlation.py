"""Flights reduced to correlations, and the moments of a chain from them.

A cost over 10^7 samples need not touch them at every step. Over a stretch of samples a ... b - 1 of a record that
began at rest, s_k = E s_{k-1} + beta u_k gives

    m = sum gamma*_k s_k = sum_l c_l E^l beta,                  c_l = sum gamma*_k u_{k-l},
    G = sum s_k s_k' = E (G + s_{a-1} s_{a-1}' - s_{b-1} s_{b-1}') E' + q beta' + beta q',
                                    q = r_0/2 beta + sum_{l >= 1} r_l E^l beta,   r_l = sum u_k u_{k-l},

exactly, ends included. So one FFT beforehand, and then a pass over as many lags as the filter remembers, for all
flights and channels at once. (The sums are those of the covariance method, Makhoul, Proc. IEEE 63 (1975).)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from scipy import fft

from ..._sections import FloatArray, multiply
from ...filter.recursion import transition
from ...filter.sampling import Method
from .residuals import Flight, each

# Lags kept at most, and the longest piece transformed at once: bounds the memory for any record.
MOST_LAGS = 1 << 20
_BLOCK = 64


def memory(order: int) -> float:
    """Time constants after which 2n equal poles have forgotten to double precision: e^-x x^2n / (2n)! < eps."""
    return 38.0 + 6.0 * order


@dataclass(frozen=True, eq=False)
class Stretch:
    """Samples first ... last - 1 of a flight with one weight."""

    flight: Flight
    first: int
    last: int
    weight: float

    @property
    def samples(self) -> int:
        return (self.last - self.first) * self.flight.width


@dataclass(frozen=True, eq=False)
class Correlations:
    """Stretches with one step, reduced to their correlations.

    Attributes
    ----------
    stretches : tuple of Stretch
    dt : float
    method : {"exact", "matched", "euler", "tustin"}
    sequences : (2, L) array
        r with r_0 halved, and c, weighted and summed over stretches and channels.
    energy, weight : float
        sum w gamma*^2 and sum w.
    rough : bool
        Good enough for trials: flights that are not in memory are taken to have begun where what was kept of their
        ends begins. Otherwise they are read again where the filter remembers more.
    """

    stretches: tuple[Stretch, ...]
    dt: float
    method: Method
    sequences: FloatArray
    energy: float
    weight: float
    rough: bool = False

    @classmethod
    def of(
        cls, stretches: Sequence[Stretch], method: Method, lags: int = MOST_LAGS, *, rough: bool = False
    ) -> Correlations:
        """Correlate stretches whose flights have one step; at most ``lags`` of them."""
        lags = min(lags, max(part.last for part in stretches))
        sequences, energy = np.zeros((2, lags)), 0.0
        for part, (own, squares) in zip(stretches, each(partial(reduced, lags=lags), stretches), strict=True):
            sequences += part.weight * own
            energy += part.weight * squares
        return cls.summed(stretches, method, sequences, energy, rough)

    @classmethod
    def summed(
        cls,
        stretches: Sequence[Stretch],
        method: Method,
        sequences: FloatArray,
        energy: float,
        rough: bool = False,
    ) -> Correlations:
        """Of stretches whose correlations and squares are summed up already."""
        sequences[0, 0] *= 0.5
        samples = sum(part.samples for part in stretches)
        dt = sum(part.flight.dt * part.samples for part in stretches) / samples
        weight = sum(part.weight * part.samples for part in stretches)
        return cls(tuple(stretches), dt, method, sequences, energy, weight, rough)

    @classmethod
    def joined(cls, parts: Sequence[Correlations]) -> Correlations:
        """The stretches of parts with one step, one rule and one number of lags together."""
        return cls(
            tuple(stretch for part in parts for stretch in part.stretches),
            parts[0].dt,
            parts[0].method,
            np.sum([part.sequences for part in parts], axis=0),
            sum(part.energy for part in parts),
            sum(part.weight for part in parts),
            any(part.rough for part in parts),
        )

    def moments(self, doubled: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """See :class:`~phyfilter_ctl.design.learning.sensitivity.Data`."""
        n = len(doubled) // 2
        M = transition(doubled, self.method, self.dt)
        radius = float(np.max(np.abs(1.0 + np.linalg.eigvals(M[:n, :n]))))
        if not radius < 1.0:
            return None
        E, beta = M[:-1, :-1] + np.eye(2 * n), M[:-1, -1]
        remembered = memory(n) / -np.log(max(radius, 1e-300))
        lags = int(min(self.sequences.shape[1], np.ceil(remembered)))
        powers = _Powers(E, beta)
        q, m = powers.total(self.sequences[:, :lags])
        half = np.outer(q, beta)
        drive = half + half.T
        far: list[Stretch] = []
        for part in self._ends:
            past, complete = part.flight.before(part.last)
            if lags <= past.shape[1] or complete or self.rough:
                states = powers.total(past[:, :lags]) @ E.T
                drive += part.weight * (states.T @ states)
            else:
                far.append(part)
        for part, states in zip(far, each(partial(_end_states, E=E, beta=beta, lags=lags), far), strict=True):
            drive += part.weight * (states.T @ states)
        return _accumulated(E, drive, remembered), m

    @cached_property
    def _ends(self) -> list[Stretch]:
        """Where the weight jumps: the flights from their beginning to there, and the jumps as their weights."""
        jumps: dict[tuple[int, int], float] = {}
        flights = {id(part.flight): part.flight for part in self.stretches}
        for part in self.stretches:
            for place, jump in ((part.first, part.weight), (part.last, -part.weight)):
                key = (id(part.flight), place)
                jumps[key] = jumps.get(key, 0.0) + jump
        # At the beginning of a record the state is 0.
        return [
            Stretch(flights[key], 0, place, jump) for (key, place), jump in jumps.items() if jump and place
        ]


def _end_states(part: Stretch, E: FloatArray, beta: FloatArray, lags: int) -> FloatArray:
    """E s (K, 2n) at the end of a stretch that begins with its record."""
    past = part.flight.u[: part.last].T[:, ::-1]
    return _Powers(E, beta).total(past[:, :lags]) @ E.T


class _Powers:
    """Sums over l of v_l E^l beta: a product with the first powers, then blocks joined two by two."""

    def __init__(self, E: FloatArray, beta: FloatArray) -> None:
        vectors, power = beta[None], E
        while len(vectors) < _BLOCK:
            vectors = np.concatenate([vectors, vectors @ power.T])
            power = power @ power
        self.vectors, self.doublings = vectors, [power]

    def total(self, sequences: FloatArray) -> FloatArray:
        """sum_l v[:, l] E^l beta for sequences v (R, L); shape (R, 2n)."""
        count, length = sequences.shape
        blocks = max(1, -(-length // _BLOCK))
        padded = np.zeros((count, blocks * _BLOCK))
        padded[:, :length] = sequences
        sums = multiply(padded.reshape(-1, _BLOCK), self.vectors).reshape(count, blocks, -1)
        level = 0
        while sums.shape[1] > 1:
            if sums.shape[1] % 2:
                sums = np.concatenate([sums, np.zeros_like(sums[:, :1])], axis=1)
            if level == len(self.doublings):
                self.doublings.append(self.doublings[-1] @ self.doublings[-1])
            later = np.ascontiguousarray(sums[:, 1::2])
            moved = multiply(later.reshape(-1, later.shape[2]), self.doublings[level].T)
            sums = sums[:, ::2] + moved.reshape(later.shape)
            level += 1
        return sums[:, 0]


def _accumulated(E: FloatArray, drive: FloatArray, remembered: float) -> FloatArray:
    """G = E G E' + drive by doubling (Smith, SIAM J. Appl. Math. 16 (1968))."""
    G, power, reach = drive, E, 1.0
    while reach < remembered:
        G = G + power @ G @ power.T
        power = power @ power
        reach *= 2.0
    return 0.5 * (G + G.T)


def reduced(part: Stretch, lags: int) -> tuple[FloatArray, float]:
    """Correlations (2, lags) of a stretch, and the sum of gamma*^2; without the weight of the stretch."""
    return correlations(part, lags), float(np.sum(part.flight.target[part.first : part.last] ** 2))


def correlations(part: Stretch, lags: int) -> FloatArray:
    """r and c (2, lags) of a stretch, summed over its channels; u before it counts, u before the record is 0.

    Weights of single samples, if the flight has them, count; the weight of the stretch does not.
    """
    flight = part.flight
    weight = flight.sample_weights
    found = np.zeros((2, lags))
    for first, last, reach in _pieces(part, lags):
        top = min(lags - 1, reach + last - first - 1)
        # Negative lags wrap round to beyond the top one.
        length = int(fft.next_fast_len(last - first + top, real=True) or 0)
        wanted = (np.arange(top + 1) - reach) % length
        # Summed over the channels as spectra: two transforms back, however many channels there are.
        spectra = np.zeros((2, length // 2 + 1), dtype=np.complex128)
        for channel in range(flight.u.shape[1]):
            own = [signal[first:last, channel] for signal in (flight.u, flight.target)]
            if weight is not None:
                own = [signal * weight[first:last, channel] for signal in own]
            u, target = (np.asarray(fft.rfft(signal, length)) for signal in own)
            whole = reach == 0 and weight is None  # then u is its own past
            past = u if whole else np.asarray(fft.rfft(flight.u[first - reach : last, channel], length))
            spectra[0] += u * past.conj()
            spectra[1] += target * past.conj()
        found[:, : top + 1] += np.asarray(fft.irfft(spectra, length))[:, wanted]
    return found


def _pieces(part: Stretch, lags: int) -> Iterator[tuple[int, int, int]]:
    """Pieces of a stretch short enough to transform, and how far back each reaches."""
    for first in range(part.first, part.last, MOST_LAGS):
        yield first, min(first + MOST_LAGS, part.last), min(lags - 1, first)
