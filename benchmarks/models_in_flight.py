"""The paper's models in loops made for them: a body under PD with f_hat fed back, each method with its own bandwidth.

    python benchmarks/models_in_flight.py [--seeds 100] [--only gust load battery field] [--quick]

2 kg on one axis, 100 Hz; an actuator of 50 ms, of which g knows 40; noise of 1 cm/s (velocity), 2 mm (position), 0.1
m/s^2 (accelerometer); PD of 3 rad/s. What is not known:

    gust     a periodic gust of two harmonics, 3 to 6 rad/s, 2 to 4 N, and turbulence: nothing says when it comes
    load     0.3 to 0.7 kg swing on a cable of 0.8 to 1.2 m, angle not measured
    battery  lifting against gravity, the actuator's gain falls to 55 to 80 % while it flies
    field    a force that depends on the place, 4 N, period 0.6 m, crossed at 1.5 m/s; shifted by up to 5 cm a flight

    PD, observer (F, no model), accelerometer (F on measured x'), exact (the filter told f)
    l1             L1 adaptive, piecewise-constant law, its predictor's pole at -1 rad/s
    indi           on measured x', as INDI has it: Butterworth filters of order 2
    koopman        EVOLVER with a Koopman model from other flights, on f_hat and its past
    koopman online EVOLVER with one fitted in flight to the last 4 s
    seer-i, ii     Chebyshev model of the gain, its parameter adapted in flight; by value, by its slope
    network        of the place, from labelled flights; the filter behind it
    joint          network and filter learned together; the filter as it comes

Bandwidths are the best of 17 from 0.3 to 300 rad/s and then of 4 about it, on 8 flights of other seeds, the noise of
the command at most 2 % of the weight: "noise" where a faster one is not so calm, "rate" where it is as fast as the
samples. Models are learned on 8 more. Printed: median rms position error and by how much it is below the observer's,
paired, with 95 % intervals; exits with 1 if a flight diverges or a grid begins too fast.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from worlds import BEGIN, SECONDS, WORLDS, Array, Flown, H, Model, Sample, World, fly

import phyfilter_ctl as pf
from phyfilter_ctl.filter import FilterState, Sampling
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

BANDWIDTHS = np.geomspace(0.3, 300.0, 17)
FINER = (-0.67, -0.33, 0.33, 0.67)  # between its neighbours
TUNE, TRAIN, TEST = range(1000, 1008), range(2000, 2008), 4000
L1_POLE = -1.0  # e^(pole h) = 0.99 of a constant force, as the drone has it
LAGS, APART = 4, 8  # of f_hat, samples between them


# ------------------------------------------------------------------------------------------------ estimators


@dataclass
class Filtered:
    """PhyFilter with a model of the sample."""

    filter: pf.PhyFilter | pf.FilterBank
    model: Model | None = None
    state: FilterState | None = None

    def __post_init__(self) -> None:
        self.sampled = pf.SampledPhyFilter(self.filter, Sampling(H, g="average"))

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

    bandwidths: Array
    f_hat: Array | float = 0.0

    def __call__(self, sample: Sample) -> Array:
        self.f_hat = sample.seen + (self.f_hat - sample.seen) * np.exp(-self.bandwidths * H)
        return np.asarray(self.f_hat)


class Incremental:
    """INDI: measured x' and the force that acts behind equal Butterworth filters; Tustin's rule, as :func:`indi`."""

    def __init__(self, bandwidths: Array) -> None:
        w, c = bandwidths, 2.0 / H
        damped = np.sqrt(2.0) * w * c
        self.b = w**2 / (c**2 + damped + w**2)
        self.a = 2.0 * (w**2 - c**2) / (c**2 + damped + w**2), (c**2 - damped + w**2) / (c**2 + damped + w**2)
        self.first = self.second = np.zeros_like(w)

    def __call__(self, sample: Sample) -> Array:
        f_hat = self.b * sample.seen + self.first
        self.first = 2.0 * self.b * sample.seen - self.a[0] * f_hat + self.second
        self.second = self.b * sample.seen - self.a[1] * f_hat
        return f_hat


class Evolved:
    """EVOLVER: the slope of a Koopman model of f_hat and its past, by one law for all flights or one for each."""

    def __init__(self, bandwidths: Array, laws: Koopman | OnlineKoopman) -> None:
        count = len(bandwidths)
        self.filtered = Filtered(order_1(bandwidths), lambda _: self.sum)
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


def order_1(bandwidths: Array) -> pf.FilterBank:
    return pf.FilterBank([pf.PhyFilter([float(a0)]) for a0 in bandwidths])


def l1(bandwidths: Array) -> Model:
    """L1 adaptive: exp(pole h) times the observer, which :func:`l1_adaptive` shows."""
    observer = Filtered(order_1(bandwidths))
    return lambda sample: np.exp(L1_POLE * H) * observer(sample)


Make = Callable[[Array], Model]


def methods(name: str, world: World, seconds: float) -> dict[str, Make]:
    """By name: from the bandwidth of each flight to their estimator; a method without one takes none."""
    found: dict[str, Make] = {
        "PD": lambda a0: lambda sample: np.zeros(len(a0)),
        "observer": lambda a0: Filtered(order_1(a0)),
        "l1": l1,
        "accelerometer": Accelerometer,
        "indi": Incremental,
        "exact": lambda a0: Filtered(order_1(a0), lambda sample: sample.f),
    }
    at_6 = np.full(len(TRAIN), 6.0)
    logs = fly(world, TRAIN, Filtered(order_1(at_6)), seconds, keep=True).logs
    if name in ("gust", "load"):
        offline = koopman(logs)
        online = OnlineKoopman(Koopman(Dictionary(LAGS, degree=1), 1, dt=H, l2=1e-2), round(4.0 / H))
        found["koopman"] = lambda a0: Evolved(a0, offline)
        found["koopman online"] = lambda a0: Evolved(a0, online)
    if name == "battery":
        law = seer(logs)
        found["seer-i"] = lambda a0: Filtered(order_1(a0), Seer(law, by_slope=False))
        found["seer-ii"] = lambda a0: Filtered(order_1(a0), Seer(law, by_slope=True))
    if name == "field":
        alone, filter, joint = networks(logs)
        found["network"] = lambda a0: Filtered(order_1(a0), alone)
        found["joint"] = lambda _: Filtered(filter, joint)
    return found


def tuned(world: World, make: Make, bandwidths: Array, seconds: float) -> tuple[float, str]:
    """The best bandwidth, and what keeps it from being faster or slower, if anything does."""

    def costs(tried: Array) -> list[float]:
        count = len(TUNE)
        flown = fly(world, [*TUNE] * len(tried), make(np.repeat(tried, count)), seconds)
        parts = (slice(k, k + count) for k in range(0, count * len(tried), count))
        return [Flown(flown.error[:, part], flown.commands[:, part]).cost for part in parts]

    coarse = costs(bandwidths)
    k = int(np.argmin(coarse))
    if k == 0 or not np.isfinite(coarse[k]):
        return float(bandwidths[k]), "edge"
    finer = bandwidths[k] * (bandwidths[1] / bandwidths[0]) ** np.array(FINER)
    finer = finer[finer <= bandwidths[-1]]
    tried, found = np.concatenate([[bandwidths[k]], finer]), [coarse[k], *costs(finer)]
    best = int(np.argmin(found))
    if k == len(bandwidths) - 1:
        return float(tried[best]), "" if best else "rate"
    return float(tried[best]), "" if np.isfinite(coarse[k + 1]) else "noise"


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
        print(f"  {'':15} {'rad/s':>6}       {'rms error, mm':>24}   {'below the observer, %':>24}")
        for method, make in methods(name, world, seconds).items():
            fixed = method in ("PD", "joint")
            a0, bound = (0.0, "") if fixed else tuned(world, make, bandwidths, seconds)
            rms = 1e3 * fly(world, tests, make(np.full(len(tests), a0)), seconds).rms
            fell += int(np.sum(~np.isfinite(rms))) + (bound == "edge" and not options.quick)
            observed = rms if method == "observer" else observed
            middle = median_interval(rms)
            text = f"{middle.value:7.2f} [{middle.low:6.2f}, {middle.high:6.2f}]"
            versus = ""
            if method not in ("PD", "observer"):
                gain = reduction(rms, observed)
                versus = f"{gain.value:7.1f} [{gain.low:6.1f}, {gain.high:6.1f}]"
            speed = "" if fixed else f"{a0:.3g}"
            print(f"  {method:15} {speed:>6} {bound:5} {text:>24}   {versus:>24}", flush=True)
    return int(fell > 0)


if __name__ == "__main__":
    sys.exit(main())
