"""Attacks on every bound: how many errors exceed what was promised, and how far the promises are from what is reached.

    python benchmarks/attacks.py --count 10000     about a minute
    python benchmarks/attacks.py --quick           300 attacks

Each attack is one course of all signals through a filter as it runs: residual, g, f_theta and inertia on switching
slopes, square waves, sums of sines, or the course of the kernel itself, with noise, jitter, steps of quantisation and
float32; x is their exact integral. The bounds are those of the signals. Prints, by kind of attack, bound / reached at
the worst signal of each filter (median and largest over filters; 1 where the bound is attained), and what a bound costs
by order. Exits with status 1 if one error exceeds its bound.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import control as ct
import numpy as np
from numpy.typing import NDArray

import phyfilter_ctl as pf
from phyfilter_ctl.filter.sampling import Method, Precision, Rule

Array = NDArray[np.float64]

SIGNALS = 25  # at a time, through one filter
FINE = 8  # parts of a step on which slopes are constant
NODES, WEIGHTS = np.polynomial.legendre.leggauss(6)
RULES: tuple[Rule, ...] = ("hold", "average")
METHODS: tuple[Method, ...] = ("exact", "tustin")
ROUNDING = 1e-11  # of the simulation, beside the largest signal over a step


@dataclass(frozen=True, eq=False)
class Course:
    """Values at both ends of each part of a step, (parts, signals)."""

    first: Array
    last: Array

    @property
    def size(self) -> float:
        return float(max(np.abs(self.first).max(), np.abs(self.last).max()))

    def slope(self, part: float) -> float:
        return float(np.abs(self.last - self.first).max() / part)

    def __add__(self, other: Course) -> Course:
        return Course(self.first + other.first, self.last + other.last)

    def at(self, where: Array) -> Array:
        """Between the ends, 0 to 1."""
        return self.first[:, None] + (self.last - self.first)[:, None] * where[None, :, None]

    def samples(self, index: NDArray[np.intp]) -> Array:
        """At the beginnings of parts (N, signals); of the last one its end."""
        whole = np.concatenate([self.first, self.last[-1:]])
        return np.take_along_axis(whole, index, axis=0)


def switching(rng: np.random.Generator, parts: int, count: int) -> Array:
    """Signs (parts, count): square waves of random periods, random switching, sums of sines made square or not."""
    t, out = np.arange(parts)[:, None], np.empty((parts, count))
    out[:, 0::3] = np.sign(
        np.sin(2.0 * np.pi * t / rng.uniform(4.0, parts, (1, out[:, 0::3].shape[1])) + 1e-3)
    )
    for j in range(1, count, 3):
        dwell = int(rng.integers(1, max(parts // 4, 2)))
        out[:, j] = np.sign(rng.standard_normal(parts))[np.arange(parts) // dwell]
    sines = out[:, 2::3]
    for j in range(sines.shape[1]):
        periods, phases = rng.uniform(6.0, parts, 4), rng.uniform(0.0, 6.3, 4)
        sines[:, j] = np.sin(2.0 * np.pi * t / periods + phases).sum(axis=1) / 4.0
    return out


def sloped(signs: Array, size: float, part: float) -> Course:
    """From 0 on slopes of +-size."""
    values = np.concatenate([np.zeros((1, signs.shape[1])), np.cumsum(signs * size * part, axis=0)])
    return Course(values[:-1], values[1:])


def held(signs: Array, size: float) -> Course:
    return Course(size * signs, size * signs)


class Options(NamedTuple):
    """What is allowed to happen in one kind of attack."""

    g: float = 0.0  # |g'|
    f_theta: float = 0.0
    turning: float = 0.0  # |M_hat'|
    wrong: float = 0.0  # |M - M_hat|
    noise: float = 0.0
    jitter: int = 0  # parts of a step
    late: int = 0
    x_step: float = 0.0
    g_step: float = 0.0
    precision: Precision = "float64"
    derivative: int = 1


KINDS: dict[str, Options] = {
    "residual, |gamma|": Options(derivative=0),
    "residual, |gamma'|": Options(),
    "noise of x": Options(noise=1e-2),
    "wrong inertia": Options(wrong=0.3),
    "g moves": Options(g=40.0),
    "f_theta moves": Options(f_theta=40.0),
    "inertia moves": Options(turning=3.0, g=5.0),
    "jitter": Options(g=5.0, jitter=2),
    "wrong delay": Options(g=5.0, late=2),
    "quantisation": Options(g=5.0, x_step=1e-3, g_step=0.05),
    "float32": Options(g=5.0, precision="float32"),
    "all at once": Options(20.0, 20.0, 1.0, 0.2, 1e-2, 1, 1, 1e-3, 0.05, "float32"),
}


class Outcome(NamedTuple):
    attacks: int
    beyond: int
    ratio: float  # bound / reached


def attack(rng: np.random.Generator, sampled: pf.SampledPhyFilter, kind: Options, count: int) -> Outcome:
    """``count`` courses at a time through one filter."""
    h = sampled.dt
    part = h / FINE
    slow = float(np.min(-sampled.filter.poles.real))
    steps = int(min(max(10.0 / (slow * h), 20.0), 300.0))
    parts = steps * FINE
    signs = [switching(rng, parts, count) for _ in range(4)]
    result = pf.error_bound(sampled, {kind.derivative: 1.0})
    t = part * (np.arange(parts) + 0.5)
    worst = result.worst_residual(np.append(t, t[-1] + 0.5 * part))[:-1]
    impulse = np.diff(sampled.run(h * np.arange(steps + 2.0))[:, 0])[:steps]  # answer to u = 1, then 0
    towards = np.repeat(np.sign(impulse[::-1]), FINE)
    signs[0][:, 0], signs[1][:, 0], signs[2][:, 0] = worst, -towards, -towards
    gamma = held(signs[0], 1.0) if kind.derivative == 0 else sloped(signs[0], 1.0, part)
    g, f_theta = sloped(signs[1], kind.g, part), sloped(signs[2], kind.f_theta, part)
    if kind.turning:
        turn = sloped(
            np.sign(signs[3]) * np.where(np.arange(parts) // (4 * FINE) % 2, 1.0, -1.0)[:, None], 1.0, part
        )
        scale = min(kind.turning, 0.5 / max(turn.size, 1e-12))
        model = Course(2.0 + scale * turn.first, 2.0 + scale * turn.last)
    else:
        model = Course(np.full((parts, count), 2.0), np.full((parts, count), 2.0))
    where = 0.5 * (NODES + 1.0)
    force = g + gamma + f_theta
    speed = force.at(where) / (model.at(where) + kind.wrong)
    x = np.concatenate(
        [np.zeros((1, count)), np.cumsum(0.5 * part * np.einsum("pqs,q->ps", speed, WEIGHTS), axis=0)]
    )
    fastest = float(np.abs(speed).max()) * (1.0 + 1e-12)
    ends = np.abs(
        np.concatenate([force.first / (model.first + kind.wrong), force.last / (model.last + kind.wrong)])
    )
    fastest = max(fastest, float(ends.max()))
    grid = FINE * np.arange(steps + 1)[:, None] + np.zeros((1, count), dtype=int)
    off = rng.choice([-1, 1], size=grid.shape) * kind.jitter
    off[:, 0] = np.append(-towards[::FINE], 1.0).astype(int) * kind.jitter * (-1) ** np.arange(steps + 1)
    off[0] = 0
    index = np.clip(grid + off, 0, parts)
    seen = np.take_along_axis(x, np.clip(index - kind.late, 0, parts), axis=0)
    nu = kind.noise * np.sign(rng.standard_normal(seen.shape))
    pulse = np.diff(impulse, prepend=0.0)[::-1]
    nu[:, 0] = kind.noise * np.append(0.0, np.sign(pulse))
    seen = _stepped(seen + nu, kind.x_step)
    told = _stepped(g.samples(index), kind.g_step)
    inertia = model.samples(index) if kind.turning else np.full(count, 2.0)
    model_size = model.size
    if kind.precision == "float32":
        start = sampled.start(seen[0], inertia0=inertia[0] if kind.turning else inertia, g0=told[0])
        estimate = np.zeros(seen.shape)
        f_at = f_theta.samples(index)
        state = start
        for k in range(1, steps + 1):
            acting = told[k - 1] if sampled.sampling.g == "hold" else told[k]
            state, f_hat = sampled.step(
                state, seen[k], acting, f_at[k], inertia=inertia[k] if kind.turning else None
            )
            estimate[k] = f_hat
    else:
        estimate = sampled.run(seen, told, f_theta.samples(index), inertia)
    truth = gamma.samples(grid) + f_theta.samples(grid)
    implementation = pf.Implementation(
        g={0: g.size, 1: g.slope(part)},
        f_theta={0: f_theta.size, 1: f_theta.slope(part)},
        inertia={1: model.slope(part)} if kind.turning else {},
        jitter=kind.jitter * part,
        delay_error=kind.late * part,
        x_step=kind.x_step,
        g_step=kind.g_step,
        x={0: float(np.abs(seen).max())} if kind.precision == "float32" else {},
    )
    size = gamma.size if kind.derivative == 0 else gamma.slope(part)
    bound = pf.error_bound(
        sampled,
        pf.Bounded(
            {kind.derivative: size},
            noise=kind.noise,
            inertia_error=kind.wrong,
            rate=fastest,
            implementation=implementation,
        ),
        inertia=model_size,
    ).bound
    error = np.abs(truth - estimate)[1:].max(axis=0)
    if kind.derivative == 0:  # gamma jumps: at a sample it is what it was just before
        before = np.concatenate([gamma.last[FINE - 1 :: FINE]])
        error = np.abs(before + f_theta.samples(grid)[1:] - estimate[1:]).max(axis=0)
    allowed = bound * (1.0 + 1e-9) + ROUNDING * model_size * float(np.abs(x).max()) / h
    return Outcome(count, int(np.count_nonzero(error > allowed)), bound / float(error.max()))


def attack_continuous(rng: np.random.Generator, f: pf.PhyFilter, both: bool, count: int) -> Outcome:
    """|gamma'| <= 1, or |gamma| bounded as well, on straight lines through F, exactly."""
    result = pf.error_bound(f, {1: 1.0})
    size = np.inf
    if both:
        size = result.bound * rng.uniform(0.2, 1.0)
        result = pf.error_bound(f, {0: size, 1: 1.0})
    part = min(0.1 / float(np.abs(f.poles).max()), 0.1 * size)
    parts = min(int(12.0 / (part * float(np.min(-f.poles.real)))), 6000)
    gamma = np.zeros((parts + 1, count))
    for k, step in enumerate(switching(rng, parts, count) * part):
        gamma[k + 1] = np.clip(gamma[k] + step, -size, size)
    worst = result.worst_residual(part * np.arange(parts + 1))
    gamma[:, 0] = worst if both else np.concatenate([[0.0], np.cumsum(part * worst[1:])])
    gamma[:, 0] -= 0.0 if both else gamma[0, 0]
    straight = ct.StateSpace(f.A, f.B, f.C, 0.0).sample(part, method="foh")
    A, B, C, D = (np.asarray(matrix) for matrix in (straight.A, straight.B, straight.C, straight.D))
    state = np.linalg.solve(np.eye(len(A)) - A, B) * gamma[0]  # at rest on where it begins
    error = np.zeros(count)
    for k in range(parts + 1):
        error = np.maximum(error, np.abs(gamma[k] - (C @ state + D * gamma[k])[0]))
        state = A @ state + B * gamma[k]
    allowed = result.bound * (1.0 + 1e-7) + 1e-10 * np.abs(gamma).max(axis=0)
    return Outcome(count, int(np.count_nonzero(error > allowed)), result.bound / float(error.max()))


def times() -> None:
    """Print milliseconds of a bound against order."""
    print(f"{'ms of CPU, order':24} {'continuous':>12} {'sampled':>12} {'two bounds':>12}")
    for order in range(1, 7):
        f = pf.lowpass(order, 20.0)
        row = []
        for system, residual in ((f, {1: 1.0}), (f.sampled(0.01), {1: 1.0}), (f, {0: 1.0, 1: 20.0})):
            spent = []
            for _ in range(3):
                begun = time.process_time()
                pf.error_bound(system, residual)
                spent.append(1e3 * (time.process_time() - begun))
            row.append(min(spent))
        print(f"{order:<24} " + " ".join(f"{value:12.2f}" for value in row))


def _stepped(values: Array, step: float) -> Array:
    return step * np.round(values / step) if step else values


def filters(rng: np.random.Generator, precision: Precision) -> Iterator[pf.SampledPhyFilter]:
    """Without end: poles real, repeated and complex, orders 1 to 5, all types, steps and rules."""
    while True:
        order = int(rng.integers(1, 6))
        poles: list[complex] = []
        while len(poles) < order:
            size = 10.0 ** rng.uniform(0.3, 2.0)
            if order - len(poles) > 1 and rng.random() < 0.5:
                angle = rng.uniform(0.0, 1.4)
                poles += [
                    size * complex(-np.cos(angle), np.sin(angle)),
                    size * complex(-np.cos(angle), -np.sin(angle)),
                ]
            else:
                poles.append(complex(-size))
        f = pf.place_poles(poles, type=int(rng.integers(1, order + 1)))
        h = rng.uniform(0.02, 0.8) / float(np.abs(f.poles).max())
        g, f_theta = (RULES[k] for k in rng.integers(2, size=2))
        method = METHODS[int(rng.integers(2))]
        yield f.sampled(h, method, g=g, f_theta=f_theta, precision=precision)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=10_000, help="attacks in all")
    parser.add_argument("--quick", action="store_true", help="300 attacks")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    count = 300 if options.quick else options.count
    rng, beyond, done = np.random.default_rng(options.seed), 0, 0
    print(f"{'':24} {'attacks':>8} {'beyond':>7} {'bound / reached: median':>24} {'largest':>8}")
    kinds: dict[str, Options | bool] = {**KINDS, "continuous, |gamma'|": False, "|gamma| and |gamma'|": True}
    for name, kind in kinds.items():
        ratios: list[float] = []
        found = attacks = 0
        every = filters(rng, kind.precision if isinstance(kind, Options) else "float64")
        while attacks * len(kinds) < count:
            sampled = next(every)
            if isinstance(kind, Options):
                outcome = attack(rng, sampled, kind, SIGNALS)
            else:
                outcome = attack_continuous(rng, sampled.filter, kind, SIGNALS)
            attacks, found = attacks + outcome.attacks, found + outcome.beyond
            ratios.append(outcome.ratio)
        print(f"{name:24} {attacks:8} {found:7} {np.median(ratios):24.3f} {max(ratios):8.2f}")
        beyond, done = beyond + found, done + attacks
    print(f"{done} attacks, {beyond} beyond their bound")
    times()
    return int(beyond > 0)


if __name__ == "__main__":
    sys.exit(main())
