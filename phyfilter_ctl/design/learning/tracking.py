"""The closed loop's own cost: mean square tracking error that the flights' residual, noise and a reference leave.

With p and x the errors of position and velocity, X and Y from the command to measured velocity and position of a unit
mass behind hold, actuator and delay, and nothing said of F, the loop of ``LoopGoal`` is

    v = -(kp p + kd x) - F (u + n v + n a),    p = Y v + D gamma + (Y - D) a,    x = X v + I u + (X - I_1) a

u the measured residual of the log (it does not depend on what is commanded), gamma the label's residual, straight
between the samples, a the reference's acceleration, sent as a command; n = (1 - 1/z) X/h - m what the filter sees of a
command beyond what it is told; I = h/(1 - 1/z); I_1 and D one and two integrals of gamma. So

    chi v = -(F + kd I) u - kp D gamma - (F n + kd (X - I_1) + kp (Y - D)) a,    chi = 1 + n F + kd X + kp Y
    dp = -(Y/chi) (u + n v + n a) dF

p is linear-fractional in F, and a step of F is output-error identification again, with the residual that the filter
would meet in the loop as its input: Gauss and Newton's step is as before. Records enter by their spectra alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..._sections import ComplexArray, FloatArray
from ...analysis.margins.slopes import SampledLoop
from ...filter import Sampling
from .objective import Objective, responses
from .parametrisation import Chain
from .residuals import Flight, each

__all__ = ["Tracking", "spectra_of"]

# Samples of a record that are transformed at once, with as many zeros for what the loop remembers.
_LONGEST = 1 << 13
# Lines below this number stand alone; above they are pooled to this many a factor of e.
_ALONE = 384
# Steps agree to this, relative.
_SAME = 1e-6


@dataclass(frozen=True, eq=False)
class Tracking(Objective):
    """Mean square tracking error in a loop: of position, of velocity where kp is 0.

    Attributes
    ----------
    omega : (K,) array
        Lines of the spectra in rad/s, the first 0.
    spectra : (K, 3, 3) complex array
        conj(S_i) S_j summed over flights and channels, S = u, gamma, a; so scaled that the sum is a mean square.
    weights : (K, 3) complex array
        What the tracking error has of S beside -(Y/chi)(...): 0, D and Y - D.
    into : (K, 3) complex array
        kd I, kp D and kd (X - I_1) + kp (Y - D): what the outer loop makes of S.
    seen : (K,) complex array
        n.
    outer : (K,) complex array
        kd X + kp Y.
    path : (K,) complex array
        Y; X for velocity.
    sampling : Sampling
    """

    omega: FloatArray
    spectra: ComplexArray
    weights: ComplexArray
    into: ComplexArray
    seen: ComplexArray
    outer: ComplexArray
    path: ComplexArray
    sampling: Sampling

    @classmethod
    def of(cls, loop: SampledLoop, omega: FloatArray, spectra: ComplexArray, sampling: Sampling) -> Tracking:
        """In the loop around a filter, which plays no part.

        Parameters
        ----------
        loop : SampledLoop
        omega, spectra
            As of :func:`spectra_of`.
        sampling : Sampling
        """
        h, kp, kd = sampling.dt, loop.kp, loop.kd
        moving = omega[1:]
        missing, through, outer = loop.surroundings(moving)
        delta = np.expm1(1j * moving * h)
        z = 1.0 + delta
        X = through * h * z / delta
        late = np.exp(-1j * moving * sampling.delay)
        once = 0.5 * h * (1.0 + z) / delta
        twice = (h * once + h * h * (1.0 / 3.0 + z / 6.0)) / delta
        once, twice = once * late, twice * late
        path, straight = (X, once) if kp == 0.0 else ((outer - kd * X) / kp, twice)
        zero = np.zeros_like(X)
        at_position = kp * (path - twice) if kp else zero
        weights = np.stack([zero, straight, path - straight], axis=1)
        into = np.stack([kd * h * z / delta, kp * twice, kd * (X - once) + at_position], axis=1)
        # What is constant the outer loop meets with its gain: multiplied by 1/s or 1/s^2 all stays finite.
        stiffness = kp or kd
        steady = np.array([0.0, 1.0 / stiffness, 0.0])
        return cls(
            omega,
            spectra,
            np.vstack([steady, weights]).astype(np.complex128),
            np.vstack([np.zeros(3), into]).astype(np.complex128),
            np.append(0.0, through - 1.0 - missing),
            np.append(0.0, outer),
            np.append(1.0 / stiffness, path),
            sampling,
        )

    def cost(self, chain: Chain, c: FloatArray) -> float:
        """See :class:`~.objective.Objective`."""
        error, _ = self._errors(self._states(chain, whole=False) @ c)
        return float(np.einsum("ki,kij,kj->", np.conj(error), self.spectra, error).real)

    def model(self, chain: Chain, c: FloatArray, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :class:`~.objective.Objective`."""
        states = self._states(chain)
        error, moved = self._errors(states[:, : chain.order] @ c)
        of_F = states @ rows.T
        slope = np.einsum("ki,kij,kj->k", np.conj(error), self.spectra, moved)
        strength = np.einsum("ki,kij,kj->k", np.conj(moved), self.spectra, moved).real
        root = np.sqrt(np.maximum(strength, 0.0))[:, None] * of_F
        return 2.0 * (slope @ of_F).real, 2.0 * (root.conj().T @ root).real

    def _states(self, chain: Chain, *, whole: bool = True) -> ComplexArray:
        return responses(chain, self.omega, self.sampling, whole=whole)

    def _errors(self, F: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """What the tracking error has of S (K, 3), and what it has per dF."""
        chi = 1.0 + self.seen * F + self.outer
        sent = self.into.copy()
        sent[:, 0] += F
        sent[:, 2] += F * self.seen
        sent /= -chi[:, None]
        met = self.seen[:, None] * sent
        met[:, 0] += 1.0
        met[:, 2] += self.seen
        # Of a steady residual the label says all: u's own mean is that and the noise of two samples.
        sent[0], met[0] = [0.0, -F[0], 0.0], [0.0, 1.0, 0.0]
        chi[0] = 1.0
        error = self.weights + self.path[:, None] * sent
        return error, -(self.path / chi)[:, None] * met


def spectra_of(
    flights: Sequence[Flight], dt: float, reference: FloatArray | None, *, offset: bool
) -> tuple[FloatArray, ComplexArray]:
    """Lines and spectra of flights and of a reference, as :class:`Tracking` takes them.

    The mean of a flight's residual is a line of its own: the loop has been closed for long when a flight begins.

    Parameters
    ----------
    flights : sequence of Flight
    dt : float
        Their step in s.
    reference : (N,) or (N, K) array, optional
    offset : bool
        Whether labels may be off by a constant, so that their means say nothing.

    Raises
    ------
    ValueError
        If steps differ, or samples have weights of their own.
    """
    if any(not flight.is_plain or abs(flight.dt - dt) > _SAME * dt for flight in flights):
        raise ValueError(
            'cost="tracking": expected flights of equal steps, the same for all, without weights of single samples; '
            "resample them: log.resample(dt)"
        )
    longest = max(flight.length for flight in flights)
    longest = max(longest, 0 if reference is None else len(reference))
    size = 2 * min(longest, _LONGEST)
    total = sum(flight.weight * flight.samples for flight in flights)
    spectra = np.zeros((size // 2 + 1, 3, 3), dtype=np.complex128)
    for flight, own in zip(flights, each(partial(_spectrum, size=size), flights), strict=True):
        spectra[:, :2, :2] += flight.weight / total * own
    if offset:
        spectra[0] = 0.0
    if reference is not None:
        a = reference.reshape(len(reference), -1)
        for part in _parts(a - a.mean(axis=0), size):
            spectra[:, 2, 2] += np.sum(np.abs(part) ** 2, axis=1) / (a.size * size) * _twice(size)
        spectra[0, 2, 2] = 0.0  # one that stands still in acceleration has no end
    return _pooled(np.linspace(0.0, np.pi / dt, len(spectra)), spectra)


def _spectrum(flight: Flight, size: int) -> ComplexArray:
    """Sum over samples and channels of conj(S_i) S_j, line by line (lines, 2, 2)."""
    flight = flight.counted()
    signals = np.stack([flight.u, flight.target])
    means = signals.mean(axis=1, keepdims=True)
    found = np.zeros((size // 2 + 1, 2, 2), dtype=np.complex128)
    for u, target in zip(*(_parts(each_signal, size) for each_signal in signals - means), strict=True):
        S = np.stack([u, target], axis=1)  # (lines, 2, K)
        found += np.conj(S) @ S.transpose(0, 2, 1)
    found *= _twice(size)[:, None, None] / size
    found[0] = flight.length * float(np.sum(means[1] ** 2)) * np.array([[0.0, 0.0], [0.0, 1.0]])
    return found


def _parts(signal: FloatArray, size: int) -> list[ComplexArray]:
    """Transforms (lines, K) of stretches of a signal (N, K), each followed by as many zeros."""
    half = size // 2
    return [np.fft.rfft(signal[k : k + half], size, axis=0) for k in range(0, len(signal), half)]


def _twice(size: int) -> FloatArray:
    """How often a line of a real signal counts."""
    found = np.full(size // 2 + 1, 2.0)
    found[[0, -1]] = 1.0  # the size is even
    return found


def _pooled(omega: FloatArray, spectra: ComplexArray) -> tuple[FloatArray, ComplexArray]:
    """Neighbours together where they are dense."""
    lines = np.arange(len(omega))
    places = np.where(lines < _ALONE, lines, _ALONE * (1.0 + np.log(np.maximum(lines, 1) / _ALONE)))
    first = np.unique(places.astype(int), return_index=True)[1]
    counts = np.diff(np.append(first, len(omega)))
    return np.add.reduceat(omega, first) / counts, np.add.reduceat(spectra, first, axis=0)
