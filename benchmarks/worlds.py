"""The loops of ``models_in_flight.py``, which describes them: what is unknown in each, and flights side by side."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

import phyfilter_ctl as pf

Array = NDArray[np.float64]
H, SECONDS, BEGIN, PARTS = 0.01, 24.0, 8.0, 2
M, LAG, KNOWN_LAG, GRAVITY = 2.0, 0.05, 0.04, 9.81
KP, KD = 9.0, 5.4
JITTER = 0.02
OF_V, OF_P, OF_A = 1e-2, 2e-3, 0.1


@dataclass(frozen=True)
class World:
    """What pushes a body of M in B flights, and the way it is asked to go: size sin(rate t + start)."""

    size: float
    rate: float
    ranges: Mapping[str, tuple[float, float]]  # of the flights' parameters
    weight: float = 0.0  # that the actuator carries
    extra: int = 0  # further states

    def draw(self, rng: list[np.random.Generator]) -> dict[str, Array]:
        drawn = {"start": (0.0, 2.0 * np.pi), **self.ranges}
        return {name: np.array([r.uniform(*ends) for r in rng]) for name, ends in drawn.items()}

    def force(self, w: dict[str, Array], t: float, y: Array, T: Array) -> tuple[Array, Array]:
        """On the body, and slopes of the further states; T is what the actuator adds to the weight."""
        return np.zeros_like(T), y[3:]

    def gain(self, w: dict[str, Array], t: float) -> Array | float:
        """Of the actuator."""
        return 1.0

    def reference(self, w: dict[str, Array], t: float) -> tuple[Array, Array, Array]:
        """Position, velocity, acceleration."""
        angle = self.rate * t + w["start"]
        r = self.size * np.sin(angle)
        return r, self.size * self.rate * np.cos(angle), -(self.rate**2) * r


class Gust(World):
    def force(self, w: dict[str, Array], t: float, y: Array, T: Array) -> tuple[Array, Array]:
        first, second = np.sin(w["rate"] * t + w["one"]), np.sin(2.0 * w["rate"] * t + w["two"])
        return w["size"] * (first + 0.4 * second), y[3:]


class Load(World):
    """Further states: angle of the cable and its rate."""

    def force(self, w: dict[str, Array], t: float, y: Array, T: Array) -> tuple[Array, Array]:
        angle, turning = y[3:]
        sine, cosine = np.sin(angle), np.cos(angle)
        # M a = T + N sin, N = m (g cos + l w^2 - a sin): the cable's tension, a found first.
        pull = w["mass"] * (GRAVITY * cosine + w["cable"] * turning**2)
        a = (T + pull * sine) / (M + w["mass"] * sine**2)
        turned = -(GRAVITY * sine + a * cosine) / w["cable"] - 0.05 * turning
        return M * a - T, np.stack([turning, turned])


class Battery(World):
    def gain(self, w: dict[str, Array], t: float) -> Array:
        return 1.0 - (1.0 - w["end"]) * min(t / SECONDS, 1.0)


class Field(World):
    def force(self, w: dict[str, Array], t: float, y: Array, T: Array) -> tuple[Array, Array]:
        return 4.0 * np.sin(2.0 * np.pi * (y[0] + w["shift"]) / 0.6), y[3:]


TURN = (0.0, 2.0 * np.pi)
WORLDS: dict[str, World] = {
    "gust": Gust(0.5, 0.5, {"rate": (3.0, 6.0), "size": (2.0, 4.0), "one": TURN, "two": TURN}),
    "load": Load(0.8, 1.2, {"mass": (0.3, 0.7), "cable": (0.8, 1.2), "first": (-0.3, 0.3)}, extra=2),
    "battery": Battery(0.6, 2.5, {"end": (0.55, 0.8)}, weight=M * GRAVITY),
    "field": Field(0.75, 2.0, {"shift": (-0.05, 0.05)}),
}


@dataclass(frozen=True)
class Sample:
    """What an estimator gets: M v, modelled force with weight, modelled actuator, place, M x' - g, the truth."""

    x: Array
    g: Array
    T: Array
    p: Array
    seen: Array
    f: Array


# From a sample to a value of each flight: f_theta, or f_hat.
Model = Callable[[Sample], Array]


@dataclass
class Flown:
    """Signals (N, B)."""

    error: Array
    commands: Array
    samples: list[Sample] = field(default_factory=list)

    @property
    def rms(self) -> Array:
        after = self.error[round(BEGIN / H) :]
        good = np.isfinite(after).all(axis=0) & (np.abs(after).max(axis=0) < 10.0)
        with np.errstate(all="ignore"):
            return np.where(good, np.sqrt(np.mean(after**2, axis=0)), np.inf)

    @property
    def cost(self) -> float:
        """For tuning: mean error, where the command is calm enough."""
        with np.errstate(all="ignore"):
            jitter = np.sqrt(0.5 * np.mean(np.diff(self.commands, axis=0) ** 2)) / (M * GRAVITY)
        return float(np.mean(self.rms)) if jitter <= JITTER else np.inf

    @property
    def logs(self) -> list[pf.Recording]:
        """What was seen, with the truth; place and modelled actuator are the features."""
        x, g, f, p, T = (
            np.array([getattr(one, name) for one in self.samples]) for name in ("x", "g", "f", "p", "T")
        )
        z = np.stack([p, T], axis=-1)
        return [
            pf.Recording.from_arrays(x=x[:, [i]], g=g[:, [i]], label=f[:, [i]], features=z[:, i], dt=H)
            for i in range(x.shape[1])
        ]


def slope(
    world: World, w: dict[str, Array], rough: Array, t: float, y: Array, u: Array
) -> tuple[Array, Array]:
    """Of the states (place, velocity, actuator, further ones), and the unknown force."""
    acting = world.gain(w, t) * y[2]
    pushed, more = world.force(w, t, y, acting - world.weight)
    f = pushed + rough + acting - y[2]
    return np.vstack([[y[1], (y[2] - world.weight + f) / M, (u - y[2]) / LAG], more]), f


def step(of: Callable[[float, Array], Array], t: float, y: Array) -> Array:
    """Runge and Kutta's, of fourth order."""
    h = H / PARTS
    a = of(t, y)
    b = of(t + 0.5 * h, y + 0.5 * h * a)
    c = of(t + 0.5 * h, y + 0.5 * h * b)
    return y + h / 6.0 * (a + 2.0 * b + 2.0 * c + of(t + h, y + h * c))


def fly(
    world: World,
    seeds: Sequence[int],
    estimator: Model,
    seconds: float,
    *,
    keep: bool = False,
) -> Flown:
    count, steps = len(seeds), round(seconds / H)
    rng = [np.random.default_rng(seed) for seed in seeds]
    w = world.draw(rng)
    noise = np.stack([r.standard_normal((4, steps)) for r in rng], axis=-1)  # v, p, accelerometer, turbulence
    blow, rough = np.exp(-2.0 * H), np.zeros(count)
    p, v, _ = world.reference(w, 0.0)
    T = modelled = np.full(count, world.weight)
    s = np.zeros((world.extra, count))
    if "first" in w:
        s[0] = w["first"]
    flown, keeps = Flown(np.empty((steps, count)), np.empty((steps, count))), np.exp(-H / KNOWN_LAG)
    for k in range(steps):
        rough = blow * rough + 0.3 * np.sqrt(1.0 - blow**2) * noise[3, k]
        y = np.vstack([[p, v, T], s])
        f = slope(world, w, rough, k * H, y, T)[1]
        seen = T - world.weight + f + M * OF_A * noise[2, k] - (modelled - world.weight)
        v_m, p_m = v + OF_V * noise[0, k], p + OF_P * noise[1, k]
        sample = Sample(M * v_m, modelled - world.weight, modelled, p_m, seen, f)
        f_hat = estimator(sample)
        r, r1, r2 = world.reference(w, k * H)
        u = M * (r2 + KP * (r - p_m) + KD * (r1 - v_m)) + world.weight - f_hat
        flown.error[k], flown.commands[k] = p - r, u
        if keep:
            flown.samples.append(sample)
        for j in range(PARTS):
            y = step(
                lambda t, y, u=u, rough=rough: slope(world, w, rough, t, y, u)[0], k * H + j * H / PARTS, y
            )
        p, v, T, s = y[0], y[1], y[2], y[3:]
        modelled = u + (modelled - u) * keeps
    return flown
