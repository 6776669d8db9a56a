"""The complete sampled loop on its disturbances: force, actuator, noise of velocity and position.

    M x' = a + f + d,    a = Act v(t - delay),    v_k = -M_hat (Kp p_k + Kd x_k) - f_hat_k,    p' = x

with p and x the errors of position and velocity, f the residual that the filter is to find, d what the actuator does
beyond its model, v the part of the command that is fed back, held between the samples. The filter is told v
("commanded") or a + d, the force that acts ("applied"). Everything in units of M_hat. With a delay of the measurement x
and p are those that the samples show, a command acts later by as much, and the filter delays v as it does g.

Between two samples f and d act on the plant as they are: a unit impulse tau seconds before a sample changes the state
there by b_0 + tau b_1, so that the kernel to an output c is

    K(j h + tau) = c A^j (b_0 + tau b_1),    0 <= tau < h

and its integral over the past, from tau on, is a polynomial in each step too: that is the kernel for the derivative.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import control as ct
import numpy as np
from scipy.linalg import solve_discrete_lyapunov

from .._sections import FloatArray
from ..filter import SampledPhyFilter
from ..filter.windows import mean_weights
from .bounds.sampled_kernels import _absolute, _lyapunov, _size
from .margins.sampled import SampledLoop
from .options import Told
from .variance import discretised

__all__ = ["Noisy", "Output", "Source", "Told", "TrackingLoop"]

Source = Literal["residual", "actuation"]
Noisy = Literal["velocity", "position"]
Output = Literal["position", "command", "estimate"]

_GAP = 1e-6
_MOST_STEPS = 2_000_000
# What counts as zero beside the integral of the kernel's absolute value, whose own integral it is.
_NOTHING = 1e-9


@dataclass(frozen=True, eq=False)
class TrackingLoop:
    """Matrices of the loop. States: actuator, x and p of a unit mass, w, commands v_k, v_(k-1), ...

    Parameters
    ----------
    sampled : SampledPhyFilter
    loop : SampledLoop
        Plant, actuator, delay and gains.
    ratio : float
        mu = M_hat / M.
    inertia : float
        M_hat.
    told : {"commanded", "applied"}
    """

    sampled: SampledPhyFilter
    loop: SampledLoop
    ratio: float
    inertia: float
    told: Told

    @cached_property
    def _step(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """A; and what a change of (x, p), of u, and of v itself makes of the state at the sample where it shows."""
        transition, newer, older, whole = self.loop.plant
        h, mu = self.sampled.dt, self.ratio
        dA, equilibrium, C = self.sampled.transition
        weights = mean_weights("hold", self.sampled.sampling.delay / h)[1:]  # of v_(k-1), v_(k-2), ...
        m, n, sent = len(transition) - 2, len(dA), max(whole + 2, len(weights))
        size = m + 2 + n + sent
        unit = np.eye(size)
        plant, w, v = slice(0, m + 2), slice(m + 2, m + 2 + n), slice(m + 2 + n, size)
        gains = -mu * (self.loop.kd * unit[m] + self.loop.kp * unit[m + 1])
        gains[w] -= C
        after = np.zeros((size, size))
        after[plant, plant] = np.eye(m + 2) + transition
        after[plant] += np.outer(newer, unit[v][whole]) + np.outer(older, unit[v][whole + 1])
        moved = (after[m] - unit[m]) / h  # what acted, mean over the step
        u = mu * moved - (weights @ unit[v][: len(weights)] if self.told == "commanded" else moved)
        after[w] = (np.eye(n) + dA) @ unit[w] - np.outer(dA @ equilibrium, u)
        after[v][1:] = unit[v][:-1]
        of_v = unit[v][0]
        of_u = np.zeros(size)
        of_u[w] = -dA @ equilibrium
        close = np.eye(size) + np.outer(of_v, gains)  # v_k is made of what the sample shows
        return close @ after, close @ unit[[m, m + 1]].T, close @ of_u, of_v

    @property
    def A(self) -> FloatArray:
        """Transition of the closed loop over a step."""
        return self._step[0]

    def into(self, source: Source) -> FloatArray:
        """b_0 and b_1, (2, size)."""
        _, plant, of_u, _ = self._step
        if source == "actuation" and self.told == "commanded":
            source = "residual"
        known = self.ratio - (source == "actuation")  # of what acts the filter is told 1
        return np.stack([plant[:, 0] + known / self.sampled.dt * of_u, plant[:, 1]])

    def noise(self, of: Noisy) -> FloatArray:
        """What one sample's noise makes of the state at that sample and, beyond A, at the next; (2, size)."""
        _, _, of_u, of_v = self._step
        if of == "position":
            return np.stack([-self.loop.kp * of_v, 0.0 * of_v])
        seen = of_u / self.sampled.dt
        return np.stack([seen - self.loop.kd * of_v, -seen])

    def row(self, output: Output) -> FloatArray:
        """c of the position error, of the fed back command, or of f_hat."""
        m, C = len(self.loop.plant[0]) - 2, self.sampled.transition[2]
        row = np.zeros(len(self.A))
        if output == "position":
            row[m + 1] = self.ratio
        elif output == "command":
            row[m + 2 + len(C)] = 1.0
        else:
            row[m + 2 : m + 2 + len(C)] = C
        return row

    # -- kernels ------------------------------------------------------------------------------------------------

    @cached_property
    def _storage(self) -> tuple[FloatArray, float]:
        """P and the factor by which (z' P z)^(1/2) falls at least in a step."""
        slow = float(np.sqrt(max(float(np.abs(np.linalg.eigvals(self.A)).max()), 1e-2)))
        return _lyapunov(self.A / slow), slow

    def rows(self, c: FloatArray, vectors: FloatArray) -> tuple[FloatArray, float]:
        """c A^j vectors' (J, k), and a bound of the sum over all later j of the sum over k of their sizes."""
        P, slow = self._storage
        rows, count = c[None], 1
        power = self.A
        while True:
            rows = np.concatenate([rows, rows @ power])
            power, count = power @ power, 2 * count
            values = rows @ vectors.T
            # |c A^j b| <= |c A^J|_P* |b|_P slow^(j - J)
            rest = _size(rows[-1], P) * slow / (1.0 - slow)
            rest *= float(sum(np.sqrt(max(b @ P @ b, 0.0)) for b in vectors))
            if rest <= _GAP * np.abs(values).sum() or 2 * count > _MOST_STEPS:
                return values, rest

    def pieces(self, source: Source, derivative: int) -> FloatArray:
        """Coefficients (k, size) of the kernel's polynomials in tau/h, before A^j, for a derivative of the source."""
        h = self.sampled.dt
        found = self.into(source) * np.array([[1.0], [h]])
        later = self.A @ np.linalg.inv(np.eye(len(self.A)) - self.A)
        for _ in range(derivative):
            whole = h * found / np.arange(1.0, len(found) + 1.0)[:, None]
            total = whole.sum(axis=0)
            found = np.vstack([total + later @ total, -whole])
        return found

    def bounds(self, source: Source, derivative: int, output: Output) -> bool:
        """Whether a bound on this derivative alone bounds the output: lower ones leave nothing."""
        c = self.row(output)
        for k in range(1, derivative + 1):
            if abs(c @ self.pieces(source, k)[0]) > _NOTHING * self.gain(source, k - 1, output):
                return False
        return True

    def gain(self, source: Source, derivative: int, output: Output) -> float:
        """Largest output at the samples for a derivative of the source bounded by 1: the L1 norm of the kernel."""
        values, rest = self.rows(self.row(output), self.pieces(source, derivative))
        return self.sampled.dt * (_absolute(values) + rest)

    def running(self, source: Source, derivative: int, count: int) -> FloatArray:
        """The same for the position, of the last j steps, j = 0 ... count - 1."""
        values, _ = self.rows(self.row("position"), self.pieces(source, derivative))
        steps = np.array([_absolute(values[[j]]) for j in range(min(count - 1, len(values)))])
        sums = np.concatenate([[0.0], np.cumsum(steps)]) * self.sampled.dt
        return np.concatenate([sums, np.full(count - len(sums), self.gain(source, derivative, "position"))])

    def powers(self, c: FloatArray, count: int) -> FloatArray:
        """c A^j, (count, size)."""
        rows, power = c[None], self.A
        while len(rows) < count:
            rows, power = np.concatenate([rows, rows @ power]), power @ power
        return rows[:count]

    def released(self, start: Literal["position", "velocity"], count: int) -> FloatArray:
        """|position error| at the samples after a start with this error of 1, (count,)."""
        first = self._step[1][:, int(start == "position")] / self.ratio
        return np.abs(self.powers(self.row("position"), count) @ first)

    def noise_gain(self, of: Noisy, output: Output) -> float:
        """Largest output at the samples for noise bounded by 1."""
        first, then = self.noise(of)
        values, rest = self.rows(self.row(output), (self.A @ first + then)[None])
        return abs(float(self.row(output) @ first)) + float(np.abs(values).sum()) + rest

    # -- variances ----------------------------------------------------------------------------------------------

    def shaped(self, source: Source, shape: ct.StateSpace, rows: FloatArray) -> FloatArray:
        """Variances of the rows' outputs for a source with this shaping filter, exact between the samples."""
        n, size, B = shape.nstates, len(self.A), np.asarray(shape.B)
        # States: the integral of (time to the end of the step) f, that of f, the shaping filter.
        flow, density = np.zeros((2, n + 2, n + 2))
        flow[0, 1], flow[1, 2:], flow[2:, 2:], density[2:, 2:] = 1.0, shape.C[0], shape.A, B @ B.T
        turn, spread = discretised(flow, density, self.sampled.dt)
        b_0, b_1 = self.into(source)
        into = np.zeros((size + n, n + 2))
        into[:size, 0], into[:size, 1], into[size:, 2:] = b_1, b_0, np.eye(n)
        step = np.zeros((size + n, size + n))
        step[:size, :size] = self.A
        step[:, size:] = into @ turn[:, 2:]
        P = solve_discrete_lyapunov(step, into @ spread @ into.T)[:size, :size]
        return np.asarray(np.einsum("ij,jk,ik->i", rows, P, rows))

    def covered(self, source: Source, covariance: FloatArray, c: FloatArray) -> float:
        """Variance of c's output for a source with this autocovariance at the samples."""
        h, (b_0, b_1) = self.sampled.dt, self.into(source)
        # Over a step the source is (1 - tau/h) of its last value and tau/h of the one before.
        last, before = h * (b_0 / 2.0 + h * b_1 / 6.0), h * (b_0 / 2.0 + h * b_1 / 3.0)
        values, _ = self.rows(c, np.stack([last, before]))
        weights = np.append(values[:, 0], 0.0) + np.append(0.0, values[:, 1])
        size = len(weights)
        spectrum = np.abs(np.fft.rfft(weights, 2 * size)) ** 2
        overlap = np.fft.irfft(spectrum, 2 * size)[: min(size, len(covariance))]
        overlap[1:] *= 2.0
        return float(overlap @ covariance[: len(overlap)])
