"""Saturated loops assembled by hand, against ``saturation_margin``: matrices instead of a frequency response.

    python -m tests.peers.saturation --count 1000 --seed 0

The closed loop with the saturation replaced by a gain kappa is z' = A(kappa) z, or z_(k+1) = A(kappa) z_k, with
A(kappa) = A_0 + kappa b c'. Matrices that differ by rank one have a common quadratic Lyapunov function if and only if
both are stable and their product has no negative real eigenvalue (R. Shorten, K. S. Narendra, "On common quadratic
Lyapunov functions for pairs of stable LTI systems whose system matrices are in companion form", IEEE TAC 48 (2003);
C. King, M. Nathanson, Linear Algebra Appl. 415 (2006) for any rank-one difference). That is what the circle criterion
decides by frequencies, so k must be exact: with gains from 1.001 k to 1 there is one, from 0.999 k there is none. In
discrete time (A - I)(A + I)^-1 takes the place of A.

Then every sampled loop is attacked. Switching: ten ways of letting the gain jump between 1 and a share of k, greedy
ones that make a quadratic form or the next command as large as can be, periodic ones about the frequency that binds,
random ones. Clipping: flights from ever larger states with an actual saturation. Printed: how many verdicts are wrong,
how many attacks grow, in how many flights the command does not fall although it stayed below 1/k times the limit. Exits
with status 1 if any of them is not 0 at k.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from typing import Literal, NamedTuple

import control as ct
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, solve_discrete_lyapunov

import phyfilter_ctl as pf
from phyfilter_ctl import Loop
from phyfilter_ctl.analysis import SaturationMargin, saturation_margin

Array = NDArray[np.float64]
Told = Literal["saturated", "commanded"]
STEPS = 2400
ATTACKS = 10
SHARES = (1.001, 0.5, 0.2, 0.05)
SIZES = np.geomspace(0.1, 1e4, 16)


class Case(NamedTuple):
    """A loop; h = 0 in continuous time, ``late`` whole steps of delay of the command, lag in s (0: none)."""

    filter: pf.PhyFilter
    kp: float
    kd: float
    mu: float
    lag: float
    h: float
    late: int
    told: Told

    def margin(self) -> SaturationMargin:
        """What the library says."""
        return saturation_margin(
            self.filter.sampled(self.h, "exact") if self.h else self.filter,
            Loop(
                self.kp,
                self.kd,
                actuator=ct.tf(1.0, [self.lag, 1.0]) if self.lag else None,
                delay=self.late * self.h,
                inertia_ratio=self.mu,
            ),
            g=self.told,
        )


@dataclass(frozen=True)
class Matrices:
    """z' = (A + kappa b c') z, command c' z; h = 0: in continuous time."""

    A: Array
    b: Array
    c: Array
    h: float

    def at(self, kappa: float) -> Array:
        """A(kappa)."""
        return self.A + kappa * np.outer(self.b, self.c)

    def common_lyapunov(self, low: float, high: float) -> bool:
        """Whether gains that change from low to high, at will, leave a quadratic function that only falls."""
        pair = [self.at(low), self.at(high)]
        if self.h:
            eye = np.eye(len(self.A))
            if any(np.max(np.abs(np.linalg.eigvals(one))) >= 1.0 for one in pair):
                return False
            pair = [np.linalg.solve((one + eye).T, (one - eye).T).T for one in pair]
        elif any(np.max(np.linalg.eigvals(one).real) >= 0.0 for one in pair):
            return False
        found = np.linalg.eigvals(pair[0] @ pair[1])
        return not np.any((found.real < 0.0) & (np.abs(found.imag) < 1e-7 * np.abs(found.real)))


def continuous(case: Case) -> Matrices:
    """States: position, velocity, the lag's force, the filter in companion form driven by M_hat x' - g."""
    F, lagging = case.filter, case.lag > 0.0
    n, first = F.order, 3 if lagging else 2
    A, b, c = np.zeros((first + n, first + n)), np.zeros(first + n), np.zeros(first + n)
    c[:2], c[first:] = [-case.kp, -case.kd], -F.b
    A[0, 1] = 1.0
    if lagging:
        A[1, 2], A[2, 2], b[2] = case.mu, -1.0 / case.lag, 1.0 / case.lag
        A[-1, 2] = case.mu
    else:
        b[1] = b[-1] = case.mu
    A[first : first + n - 1, first + 1 :] += np.eye(n - 1)
    A[-1, first:] -= F.a
    if case.told == "saturated":
        b[-1] -= 1.0
    else:
        A[-1] -= c
    return Matrices(A, b, c, 0.0)


def sampled(case: Case) -> Matrices:
    """States at the instant k: position, velocity, the lag's force, velocity at k - 1, the filter's w_(k-1), the g it
    was told at k - 1, and what acts of the commands of k - 1 ... k - late."""
    h, n = case.h, case.filter.order
    motion = np.zeros((4, 4))  # position, velocity, force of the lag, command
    motion[0, 1] = 1.0
    if case.lag:
        motion[1, 2], motion[2, 2], motion[2, 3] = case.mu, -1.0 / case.lag, 1.0 / case.lag
    else:
        motion[1, 3] = case.mu
    step = expm(motion * h)
    A_f = np.zeros((n + 1, n + 1))  # companion form and its input, held over the step
    A_f[: n - 1, 1:n], A_f[n - 1, :n], A_f[n - 1, n] = np.eye(n - 1), -case.filter.a, 1.0
    turn = expm(A_f * h)
    size = 3 + 1 + n + 1 + case.late
    unit = np.eye(size)
    w, before, sent = unit[4 : 4 + n], unit[4 + n], unit[5 + n :]
    w_now = turn[:n, :n] @ w + np.outer(turn[:n, n], (unit[1] - unit[3]) / h - before)
    c = -case.kp * unit[0] - case.kd * unit[1] - case.filter.b @ w_now
    A, b = np.zeros((size, size)), np.zeros(size)
    A[:3] = step[:3, :3] @ unit[:3]
    if case.late:
        A[:3] += np.outer(step[:3, 3], sent[-1])
    else:
        b[:3] += step[:3, 3]
    A[3], A[4 : 4 + n] = unit[1], w_now
    if case.told == "saturated":
        b[4 + n] = 1.0
    else:
        A[4 + n] = c
    if case.late:
        b[5 + n] = 1.0
        A[6 + n :] = sent[:-1]
    return Matrices(A, b, c, h)


def matrices(case: Case) -> Matrices:
    """The loop of a case."""
    return sampled(case) if case.h else continuous(case)


def random_cases(count: int, seed: int) -> list[Case]:
    """Loops that are stable while nothing saturates."""
    rng, found = np.random.default_rng(seed), []
    while len(found) < count:
        order, speed = int(rng.integers(1, 4)), float(np.exp(rng.uniform(np.log(2.0), np.log(30.0))))
        poles = -speed * np.exp(rng.uniform(-0.4, 0.4, order)) + 0j
        if order > 1 and rng.random() < 0.5:
            poles[:2] = speed * np.exp(1j * np.pi * np.array([1.0, -1.0]) * rng.uniform(0.55, 0.95))
        type_ = int(rng.integers(1, order + 1))
        kp, kd = float(np.exp(rng.uniform(0.0, 3.0))), float(np.exp(rng.uniform(0.7, 2.5)))
        case = Case(
            pf.place_poles(poles, type=type_),
            kp * (rng.random() < 0.8),
            kd * (rng.random() < 0.9),
            float(np.exp(rng.uniform(-0.7, 0.7))),
            float(rng.choice([0.0, 0.02, 0.08])),
            float(rng.choice([0.0, 0.005, 0.015, 0.03])),
            int(rng.integers(0, 3)),
            ("saturated", "commanded")[int(rng.integers(2))],
        )
        if (case.kp and not case.kd) or case.h * speed * order > 1.0:
            continue
        case = case._replace(late=case.late if case.h else 0)
        loop = matrices(case).at(1.0)[0 if case.kp else 1 :, 0 if case.kp else 1 :]
        roots = np.linalg.eigvals(loop)
        stable = np.all(np.abs(roots) < 1.0 - 1e-6) if case.h else np.all(roots.real < -1e-6)
        if stable and (case.kd or case.kp):
            found.append(case)
    return found


def without_position(case: Case) -> Matrices:
    """The loop, without a position that nothing feeds back."""
    whole = matrices(case)
    kept = slice(0 if case.kp else 1, None)
    return Matrices(whole.A[kept, kept], whole.b[kept], whole.c[kept], whole.h)


def wrong(case: Case) -> bool:
    """Whether k is not the gain at which the common Lyapunov function ends."""
    loop, k = without_position(case), case.margin().least_gain
    if k == 0.0:
        return not loop.common_lyapunov(1e-4, 1.0)
    return not loop.common_lyapunov(1.001 * k, 1.0) or loop.common_lyapunov(0.999 * k, 1.0)


# -- attacks --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Batch:
    """Many sampled loops, padded with zeros to one size: A (L, n, n), b (L, n, 1), c (L, 1, n)."""

    A: Array
    b: Array
    c: Array

    @classmethod
    def of(cls, loops: list[Matrices]) -> Batch:
        n = max(len(one.A) for one in loops)
        gaps = [n - len(one.A) for one in loops]
        A, b, c = (
            np.stack([np.pad(part(one), (0, gap)) for one, gap in zip(loops, gaps, strict=True)])
            for part in (lambda one: one.A, lambda one: one.b, lambda one: one.c)
        )
        return cls(A, b[:, :, None], c[:, None])

    def at(self, kappa: Array) -> Array:
        """A(kappa) for kappa (L,)."""
        return self.A + kappa[:, None, None] * (self.b @ self.c)


def switched(batch: Batch, low: Array, omega_h: Array, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Which attacks (L, ATTACKS), gains from ``low`` (L,) to 1, grow from the second fifth of the time to the last."""
    A, B = batch.at(low), batch.at(np.ones(len(low)))
    form = np.stack([solve_discrete_lyapunov(one.T, np.eye(len(one))) for one in B])
    z = rng.standard_normal((*A.shape[:2], ATTACKS))
    periods = np.array([0.7, 1.0, 1.4, 2.0]) * np.pi / omega_h[:, None]
    scale, early, late = np.zeros((3, len(low), ATTACKS))
    early, late, fifth = early - np.inf, late - np.inf, STEPS // 5
    for k in range(STEPS):
        weak, full = A @ z, B @ z
        here = rng.random(scale.shape) < 0.5
        grown = [np.stack([(y[:, :, 0] ** 2).sum(1), _value(form, y[:, :, 1])], 1) for y in (weak, full)]
        here[:, :2] = (
            grown[0] > grown[1]
        )  # greedy: the larger quadratic form, the larger or smaller next command
        ahead = [np.abs(batch.c @ y[:, :, 2:4])[:, 0] for y in (weak, full)]
        here[:, 2], here[:, 3] = ahead[0][:, 0] > ahead[1][:, 0], ahead[0][:, 1] < ahead[1][:, 1]
        here[:, 4:8] = (k / periods).astype(int) % 2 == 0
        z = np.where(here[:, None], weak, full)
        norm = np.maximum(np.linalg.norm(z, axis=1), 1e-300)
        scale, z = scale + np.log(norm), z / norm[:, None]
        if fifth <= k < 2 * fifth:
            early = np.maximum(early, scale)
        elif k >= STEPS - fifth:
            late = np.maximum(late, scale)
    return late > early


def _value(form: Array, z: Array) -> Array:
    return np.einsum("li,lij,lj->l", z, form, z)


def attacked(cases: list[Case], told: Told) -> tuple[list[Case], Array]:
    """Sampled loops that forget by e^-3 within STEPS at either gain, and their k (at least 0.01)."""
    found, least = [], []
    for case in cases:
        if case.h and case.told == told:
            loop, k = without_position(case), max(case.margin().least_gain, 0.01)
            sizes = [np.max(np.abs(np.linalg.eigvals(loop.at(kappa)))) for kappa in (1.001 * k, 1.0)]
            if max(sizes) ** STEPS < np.exp(-3.0):
                found.append(case)
                least.append(k)
    return found, np.array(least)


def clipped(batch: Batch, rng: np.random.Generator) -> tuple[Array, NDArray[np.bool_]]:
    """Flights (L, SIZES), limit 1, from states of ever larger commands: largest command, and whether it fell."""
    z = rng.standard_normal((*batch.A.shape[:2], len(SIZES)))
    z *= SIZES / np.abs(batch.c @ z)
    peaks = np.zeros((5, len(z), len(SIZES)))  # in each fifth of the time
    for k in range(2 * STEPS):
        v = batch.c @ z
        part = peaks[5 * k // (2 * STEPS)]
        np.maximum(part, np.abs(v[:, 0]), out=part)
        z = batch.A @ z + batch.b * np.clip(v, -1.0, 1.0)
    return peaks.max(axis=0), peaks[4] < np.maximum(1.0, 0.999 * peaks[1])  # a ramp down may take long


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=1000, help="loops")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    cases, rng = random_cases(options.count, options.seed), np.random.default_rng(options.seed)
    mistakes = [case for case in cases if wrong(case)]
    print(f"{len(cases)} loops, {len(mistakes)} where k is not the end of a common Lyapunov function")
    for case in mistakes[:5]:
        print(f"  {case}")
    failed = len(mistakes)
    for told in ("saturated", "commanded"):
        own, least = attacked(cases, told)
        batch = Batch.of([without_position(case) for case in own])
        omega_h = np.array([max(case.margin().frequency * case.h, 0.01) for case in own])
        excess = ", ".join(f"{q:.3g}" for q in np.quantile(1.0 / least, [0.0, 0.5, 1.0]))
        print(f"told what is {told}: {len(own)} sampled loops, 1/k = {excess} (least, median, largest)")
        for share in SHARES:
            grown = switched(batch, share * least, omega_h, rng)
            print(f"  gains from {share:g} k to 1: {grown.sum():5d} of {grown.size} switching attacks grow")
            failed += int(grown.sum()) if share >= 1.0 else 0
        largest, back = clipped(batch, rng)
        inside = largest < 1.0 / least[:, None]
        lost, beyond = int(np.sum(inside & ~back)), int(np.sum(~inside & ~back))
        print(
            f"  clipped: {lost} of {inside.sum()} flights below 1/k do not fall, {beyond} of {(~inside).sum()} beyond"
        )
        failed += lost
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
