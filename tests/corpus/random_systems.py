"""Seeded systems with their answers: piecewise linear modes, relays, saturations, chains of masses with friction."""

from __future__ import annotations

import numpy as np

from tests.corpus.reference import Exit, Hybrid, filippov, switched
from tests.corpus.system import Array, System, block


def _hurwitz(generator: np.random.Generator, n: int) -> Array:
    """A stable matrix: skew for turning, a positive definite part for decay."""
    turn = generator.normal(size=(n, n))
    decay = generator.normal(size=(n, n)) / np.sqrt(n)
    return (turn - turn.T) - decay @ decay.T - 0.2 * np.eye(n)


def _crossed(name: str, generator: np.random.Generator) -> System:
    """Two affine modes on the sides of a plane, along whose normal both have one rate: it is crossed, never slid on."""
    n = int(generator.integers(2, 5))
    A, normal = _hurwitz(generator, n), generator.normal(size=n)
    normal /= np.linalg.norm(normal)
    along = np.eye(n) - np.outer(normal, normal)
    B = A + 1.5 * along @ generator.normal(size=(n, n)) / n
    B -= 0.6 * along  # to keep it bounded
    a, b = generator.normal(size=n), np.zeros(n)
    b = a + along @ generator.normal(size=n)
    level = 0.3 * generator.normal()
    start = 1.5 * generator.normal(size=n)

    def surface(t, x):
        return normal @ x - level

    def build():
        if generator_choice:
            return block(lambda t, x, u, p: np.where(normal @ x > level, A @ x + a, B @ x + b), n)

        def rates(t, x, u, p):
            if normal @ x > level:
                return A @ x + a
            return B @ x + b

        return block(rates, n)

    generator_choice = bool(generator.integers(2))
    return System(
        name, "random", f"random: affine modes of {n} states", build,
        switched(surface, lambda t, x: A @ x + a, lambda t, x: B @ x + b), 3.0, tuple(start),
    )  # fmt: skip


def _relay(name: str, generator: np.random.Generator) -> System:
    """A linear system under a relay on a linear surface: crossed, or slid on, as it comes."""
    n = int(generator.integers(2, 5))
    A, push, normal = _hurwitz(generator, n), generator.normal(size=n), generator.normal(size=n)
    if normal @ push < 0:
        normal = -normal  # the relay attracts
    start, drive = 1.5 * generator.normal(size=n), generator.normal(size=n)
    omega = generator.uniform(1.0, 3.0)

    def build():
        return block(lambda t, x, u, p: A @ x - push * np.sign(normal @ x) + drive * np.sin(omega * t), n)

    def rates(t, x, s):
        return A @ x - push * s[0] + drive * np.sin(omega * t)

    return System(
        name, "random", f"random: relay on {n} states", build,
        filippov(rates, lambda t, x: [normal @ x], lambda t, x, s: [normal @ rates(t, x, s)]), 3.0, tuple(start),
    )  # fmt: skip


def _saturated(name: str, generator: np.random.Generator) -> System:
    """A linear system under a saturated feedback."""
    n = int(generator.integers(2, 5))
    A, push, gain = _hurwitz(generator, n), generator.normal(size=n), generator.normal(size=n)
    limit, start = generator.uniform(0.2, 1.0), 2.0 * generator.normal(size=n)

    def build():
        return block(lambda t, x, u, p: A @ x + push * np.clip(gain @ x, -limit, limit), n)

    def exits(k):
        found = []
        if k < 2:
            found.append(Exit(lambda t, x: gain @ x - (-limit, limit)[k], k + 1))
        if k > 0:
            found.append(Exit(lambda t, x: (-limit, limit)[k - 1] - gain @ x, k - 1))
        return found

    def rates(t, x, k):
        return A @ x + push * (-limit, gain @ x, limit)[k]

    return System(
        name, "random", f"random: saturated feedback of {n} states", build,
        Hybrid(rates, exits, lambda t, x: int(np.searchsorted([-limit, limit], gain @ x))), 3.0, tuple(start),
        switching=False,
    )  # fmt: skip


def _chain(name: str, generator: np.random.Generator) -> System:
    """Masses in a row, coupled by springs and dampers, each on a rough floor, the first one pushed."""
    n = int(generator.integers(1, 4))
    mass, stiff = generator.uniform(0.5, 2.0, n), generator.uniform(1.0, 6.0, n)
    damp, level = generator.uniform(0.05, 0.4, n), generator.uniform(0.1, 0.7, n)
    force, omega = generator.uniform(0.5, 3.0), generator.uniform(0.5, 2.5)
    start = np.concatenate(
        [generator.normal(size=n) * 0.5, generator.normal(size=n) * generator.integers(0, 2)]
    )

    def accelerations(t, x, s):
        """Place i is tied to place i - 1, the first one to the wall."""
        pulls = []
        for i in range(n):
            before, speed = (x[i - 1], x[n + i - 1]) if i else (0.0, 0.0)
            pulls.append(stiff[i] * (x[i] - before) + damp[i] * (x[n + i] - speed))
        pulls.append(0.0)
        push = [force * np.sin(omega * t) if i == 0 else 0.0 for i in range(n)]
        return [(push[i] - pulls[i] + pulls[i + 1] - level[i] * s[i]) / mass[i] for i in range(n)]

    def build():
        def rates(t, x, u, p):
            signs = [np.sign(x[n + i]) for i in range(n)]
            return [*[x[n + i] for i in range(n)], *accelerations(t, x, signs)]

        return block(rates, 2 * n)

    return System(
        name, "random", f"random: chain of {n} masses with friction", build,
        filippov(
            lambda t, x, s: [*x[n:], *accelerations(t, x, s)], lambda t, x: list(x[n:]), accelerations
        ), 5.0, tuple(start),
    )  # fmt: skip


KINDS = (_crossed, _relay, _saturated, _chain)


def random_system(seed: int) -> System:
    """The system of a seed."""
    generator = np.random.default_rng(seed)
    return KINDS[seed % len(KINDS)](f"random_{seed}", generator)


def random_systems(count: int, seed: int = 0) -> list[System]:
    """Systems of consecutive seeds."""
    return [random_system(1000 * seed + k) for k in range(count)]
