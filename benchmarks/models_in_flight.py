"""The paper's models in loops made for them: a body under PD with f_hat fed back, each method with its own bandwidth.

    python benchmarks/models_in_flight.py [--seeds 100] [--only gust load battery field] [--quick]

2 kg on one axis, 100 Hz; an actuator of 50 ms, of which g knows 40; noise of 1 cm/s (velocity), 2 mm (position), 0.1
m/s^2 (accelerometer); PD of 3 rad/s. What is not known:

    gust     a periodic gust of two harmonics, 3 to 6 rad/s, 2 to 4 N, and turbulence: nothing says when it comes
    load     0.3 to 0.7 kg swing on a cable of 0.8 to 1.2 m, angle not measured
    battery  lifting against gravity, the actuator's gain falls to 55 to 80 % while it flies
    field    a force that depends on the place, 4 N, period 0.6 m, crossed at 1.5 m/s; shifted by up to 5 cm a flight

    PD, observer (F, no model), accelerometer (F on measured x', what INDI feeds back), exact (the filter told f)
    koopman        EVOLVER with a Koopman model from other flights, on f_hat and its past
    koopman online EVOLVER with one fitted in flight to the last 4 s
    seer-i, ii     Chebyshev model of the gain, its parameter adapted in flight; by value, by its slope
    network        of the place, from labelled flights; the filter behind it
    joint          network and filter learned together; the filter as it comes

Bandwidths are the best of 14 from 0.3 to 100 rad/s on 8 flights of other seeds, the noise of the command at most 2 % of
the weight; "edge" where that is the slowest, or the fastest that is so calm. Models are learned on 8 more. Printed:
median rms position error and by how much it is below the observer's, paired, with 95 % intervals; exits with 1 if a
flight diverges.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

import phyfilter_ctl as pf
from phyfilter_ctl.filter import FilterState
from phyfilter_ctl.learned import (
    AdaptationState,
    AdaptiveChebyshev,
    Chebyshev,
    Dictionary,
    Koopman,
    KoopmanState,
    Network,
    OnlineKoopman,
)
from phyfilter_ctl.study import median_interval, reduction

Array = NDArray[np.float64]
H, SECONDS, BEGIN, PARTS = 0.01, 24.0, 8.0, 2
M, LAG, KNOWN_LAG, GRAVITY = 2.0, 0.05, 0.04, 9.81
KP, KD = 9.0, 5.4
JITTER = 0.02
OF_V, OF_P, OF_A = 1e-2, 2e-3, 0.1
BANDWIDTHS = np.geomspace(0.3, 100.0, 14)
TUNE, TRAIN, TEST = range(1000, 1008), range(2000, 2008), 4000
LAGS, APART = 4, 8  # of f_hat, samples between them


# ------------------------------------------------------------------------------------------------ what is unknown


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


# ------------------------------------------------------------------------------------------------ the loop


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
    make: Callable[[int], Model],
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
    estimator, flown, keeps = (
        make(count),
        Flown(np.empty((steps, count)), np.empty((steps, count))),
        np.exp(-H / KNOWN_LAG),
    )
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


# ------------------------------------------------------------------------------------------------ estimators


@dataclass
class Filtered:
    """PhyFilter with a model of the sample."""

    filter: pf.PhyFilter
    model: Model | None = None
    state: FilterState | None = None

    def __post_init__(self) -> None:
        self.sampled = self.filter.sampled(H, g="average")

    def __call__(self, sample: Sample) -> Array:
        theta = None if self.model is None else self.model(sample)
        if self.state is None:
            self.state = self.sampled.start(sample.x, f_theta0=theta, g0=sample.g)
            return np.zeros_like(sample.x) if theta is None else theta
        self.state, f_hat = self.sampled.step(self.state, sample.x, sample.g, theta)
        return np.asarray(f_hat, dtype=float)


@dataclass
class Accelerometer:
    """F on what is measured of x' itself."""

    bandwidth: float
    f_hat: Array | float = 0.0

    def __call__(self, sample: Sample) -> Array:
        self.f_hat = sample.seen + (self.f_hat - sample.seen) * np.exp(-self.bandwidth * H)
        return np.asarray(self.f_hat)


class Evolved:
    """EVOLVER: the slope of a Koopman model of f_hat and its past, by one law for all flights or one for each."""

    def __init__(self, bandwidth: float, laws: Koopman | OnlineKoopman, count: int) -> None:
        self.filtered = Filtered(pf.PhyFilter([bandwidth]), lambda _: self.sum)
        self.laws, self.sum = laws, np.zeros(count)
        self.past = np.zeros((LAGS * APART + 1, count))
        self.states: list[KoopmanState] | None = None
        self.k = 0

    def __call__(self, sample: Sample) -> Array:
        f_hat = self.filtered(sample)
        self.past = np.vstack([f_hat[None], self.past[:-1]])
        z = self.past[: LAGS * APART : APART].T
        law = self.laws
        rate = law.rate(z)[:, 0] if isinstance(law, Koopman) else self._fitted(law, z)
        self.sum = self.sum + H * rate
        self.k += 1
        return f_hat

    def _fitted(self, law: OnlineKoopman, z: Array) -> Array:
        if self.k < LAGS * APART:
            return np.zeros(len(z))
        if self.states is None:
            self.states = [law.start(row) for row in z]
            return np.zeros(len(z))
        stepped = [law.step(state, row) for state, row in zip(self.states, z, strict=True)]
        self.states = [state for state, _ in stepped]
        rate = np.array([f_next[0] for _, f_next in stepped]) - z[:, 0]
        return np.clip(rate / H, -60.0, 60.0) * (self.k > 200)


class Seer:
    """SEER-I of every flight; as SEER-II by its slope along the path."""

    def __init__(self, law: AdaptiveChebyshev, *, by_slope: bool) -> None:
        self.law, self.by_slope = law, by_slope
        self.states: list[AdaptationState] = []
        self.before: tuple[Array, Array] | None = None

    def __call__(self, sample: Sample) -> Array:
        given = list(zip(sample.T[:, None], sample.x[:, None], sample.g[:, None], strict=True))
        if not self.states:
            self.states = [self.law.start(*one) for one in given]
        stepped = [self.law.step(state, *one) for state, one in zip(self.states, given, strict=True)]
        self.states = [state for state, _ in stepped]
        theta = np.array([f_theta[0] for _, f_theta in stepped])
        if not self.by_slope:
            return theta
        rows = self.law.model.regressor(sample.T[:, None])[:, 0]
        weights = np.array([state.varsigma for state in self.states])
        before = (theta, rows) if self.before is None else self.before
        value = before[0] + np.sum(weights * (rows - before[1]), axis=1)
        self.before = value, rows
        return value


# ------------------------------------------------------------------------------------------------ learning


def together(logs: Sequence[pf.Recording]) -> tuple[Array, Array]:
    """Features and labels of all."""
    z, f = ([np.asarray(getattr(log, name)) for log in logs] for name in ("features", "label"))
    return np.concatenate(z), np.concatenate(f)


def koopman(logs: Sequence[pf.Recording]) -> Koopman:
    """The next f_hat of an observer from its past."""
    rows, after, first = [], [], LAGS * APART
    for log in logs:
        f = np.asarray(pf.PhyFilter([6.0]).sampled(H, g="average").run(log.x, log.g))[:, 0]
        rows.append(np.stack([f[first - k * APART : len(f) - 1 - k * APART] for k in range(LAGS)], axis=1))
        after.append(f[first + 1 :, None])
    law = Koopman(Dictionary(LAGS, degree=1), 1, dt=H, l2=1e-4)
    return law.fit(np.concatenate(rows), np.concatenate(after)).model


def seer(logs: Sequence[pf.Recording]) -> AdaptiveChebyshev:
    """f = -(loss) T, trained on flights whose loss is known."""
    z, f = together(logs)
    z = np.stack([z[:, 1], -f[:, 0] / np.maximum(z[:, 1], 1.0)], axis=1)
    chebyshev = Chebyshev(1, degree_d=1, bounds=np.array([[0.0, 60.0], [0.0, 0.6]]))
    return AdaptiveChebyshev(chebyshev.fit(z, f).model, H, rate=2.0, bandwidth=10.0, g="average")


def of_place(model: Network) -> Model:
    return lambda sample: model.predict(sample.p[:, None])[:, 0]


def networks(logs: Sequence[pf.Recording]) -> tuple[Model, pf.PhyFilter, Model]:
    """A network of the place; filter and network learned together."""
    logs = [log.with_signals(features=np.asarray(log.features)[:, :1]) for log in logs]
    network, (z, f) = Network((16,), l2=1e-4, seed=0), together(logs)
    alone = network.fit(z[::4], f[::4]).model
    begun, start = network.fit(z[:400:20], f[:400:20]).model, pf.PhyFilter([6.0]).sampled(H, g="average")
    found = pf.learn_jointly(logs, begun, start, max_iterations=100)
    return of_place(alone), found.filter, of_place(found.model)


Make = Callable[[float], Callable[[int], Model]]


def methods(name: str, world: World, seconds: float) -> dict[str, Make]:
    """By name: from a bandwidth to the estimator of so many flights; a method without one takes none."""
    found: dict[str, Make] = {
        "PD": lambda _: lambda count: lambda sample: np.zeros(count),
        "observer": lambda a0: lambda count: Filtered(pf.PhyFilter([a0])),
        "accelerometer": lambda a0: lambda count: Accelerometer(a0),
        "exact": lambda a0: lambda count: Filtered(pf.PhyFilter([a0]), lambda sample: sample.f),
    }
    logs = fly(world, TRAIN, lambda _: Filtered(pf.PhyFilter([6.0])), seconds, keep=True).logs
    if name in ("gust", "load"):
        offline = koopman(logs)
        online = OnlineKoopman(Koopman(Dictionary(LAGS, degree=1), 1, dt=H, l2=1e-2), round(4.0 / H))
        found["koopman"] = lambda a0: lambda count: Evolved(a0, offline, count)
        found["koopman online"] = lambda a0: lambda count: Evolved(a0, online, count)
    if name == "battery":
        law = seer(logs)
        found["seer-i"] = lambda a0: lambda count: Filtered(pf.PhyFilter([a0]), Seer(law, by_slope=False))
        found["seer-ii"] = lambda a0: lambda count: Filtered(pf.PhyFilter([a0]), Seer(law, by_slope=True))
    if name == "field":
        alone, filter, joint = networks(logs)
        found["network"] = lambda a0: lambda count: Filtered(pf.PhyFilter([a0]), alone)
        found["joint"] = lambda _: lambda count: Filtered(filter, joint)
    return found


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--only", nargs="+", choices=list(WORLDS), default=list(WORLDS))
    parser.add_argument(
        "--quick", action="store_true", help="short flights of the field, three bandwidths, four seeds"
    )
    options = parser.parse_args()
    names = ["field"] if options.quick else options.only
    seconds, bandwidths = (BEGIN + 1.0, BANDWIDTHS[4:7]) if options.quick else (SECONDS, BANDWIDTHS)
    tests = range(TEST, TEST + (4 if options.quick else options.seeds))
    fell = 0
    for name in names:
        world, observed = WORLDS[name], np.zeros(0)
        print(f"{name}: {len(tests)} flights of {seconds:g} s, scored from {BEGIN:g} s on")
        print(f"  {'':15} {'rad/s':>6}      {'rms error, mm':>24}   {'below the observer, %':>24}")
        for method, make in methods(name, world, seconds).items():
            fixed = method in ("PD", "joint")
            costs = [] if fixed else [fly(world, TUNE, make(a0), seconds).cost for a0 in bandwidths]
            best = 0 if fixed else int(np.argmin(costs))
            calm = np.isfinite([*costs, np.inf])
            rms = 1e3 * fly(world, tests, make(float(bandwidths[best])), seconds).rms
            fell += int(np.sum(~np.isfinite(rms)))
            observed = rms if method == "observer" else observed
            middle = median_interval(rms)
            text = f"{middle.median:7.2f} [{middle.low:6.2f}, {middle.high:6.2f}]"
            versus = ""
            if method not in ("PD", "observer"):
                gain = reduction(rms, observed)
                versus = f"{gain.median:7.1f} [{gain.low:6.1f}, {gain.high:6.1f}]"
            edge = "" if fixed or (best > 0 and calm[best + 1]) else "edge"
            a0 = "" if fixed else f"{bandwidths[best]:.3g}"
            print(f"  {method:15} {a0:>6} {edge:4} {text:>24}   {versus:>24}", flush=True)
    return int(fell > 0)


if __name__ == "__main__":
    sys.exit(main())
