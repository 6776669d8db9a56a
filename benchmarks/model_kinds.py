"""What each kind of learned model is worth behind the filter, on the drone's circle in wind.

    python benchmarks/model_kinds.py [--quick] [--only NAME ...]

Flights of the drone of ``models/drone`` with an unknown payload through the jet of a fan, flown by the observer. Every
estimator sees x, g and what it says of itself, and gives f_hat by the filter of order 1; its bandwidth is the best of
a list on flights of other seeds. Scored is the last part of each flight: the first is there to learn from. Printed are
the RMSE of f_hat and its change against the filter without a model, as the mean over flights with the 95 % interval
of that mean; a flight (mass, wind, gusts, noise) is the independent unit.

    observer         f_theta = 0
    seer-i           Chebyshev model of the payload, adapted in flight; learned from labelled flights in still air
    seer-ii          the same model by the slope along its path
    evolver          Koopman model of the observer's own f_hat, over the latest seconds; nothing learned before
    feedback-network neural ODE on position, from the trajectory of the flight's first part; no label, no derivative
    network          network on position, from labelled flights in wind; the filter learned after it
    joint            the same network and filter learned together
    joint-torch      a network of SiLU units trained in PyTorch, the filter a layer behind it; read back from ONNX
    still-air        Chebyshev model on position, from labelled flights in still air
    refined          the same refined on flights in wind without labels
    refined-online   the same refined in the flight itself
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from phyfilter_ctl import PhyFilter, Recording, Sampling, learned_model, models
from phyfilter_ctl.baselines import DisturbanceObserver, Evolver, FeedbackNeuralNetwork, SeerII
from phyfilter_ctl.design import OnlineRefiner, learn, learn_jointly, refine
from phyfilter_ctl.learned import (
    AdaptiveChebyshev,
    Chebyshev,
    Dictionary,
    Koopman,
    Network,
    NeuralOde,
    OnlineKoopman,
    Trajectory,
)

# By name: in a checkout the models stand beside the package, where type checkers do not look.
experiment, drone_flights, drone_methods, drone_params, drone_training = (
    import_module(f"{models.__name__}.drone.{name}")
    for name in ("experiment", "flights", "methods", "params", "training")
)
params = drone_params.params

Array = NDArray[np.float64]
Scenario = Literal["mass", "wind"]

DT = 0.002
LEARNED_FROM = 18.0  # s of each flight, before what is scored
BANDWIDTHS = (2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 12.0)  # rad/s
EVERY = 10  # samples between those that slow models are run on or fitted to: 20 ms
FLYING = drone_methods.Method("observer", 1.8, 6.0)


@dataclass(frozen=True)
class Flight:
    """What the estimators see, and the true f (N, 3) in N; r (N, 2) is the place on the circle in m."""

    x: Array
    g: Array
    f: Array
    r: Array

    @property
    def log(self) -> Recording:
        return Recording.from_arrays(x=self.x, dt=DT, g=self.g, label=self.f, features=self.r)


# From a flight and a bandwidth in rad/s to f_hat.
Estimator = Callable[[Flight, float], NDArray[np.floating]]


@cache
def flights(seeds: tuple[int, ...], scenario: Scenario) -> tuple[Flight, ...]:
    kept = experiment.fly(
        FLYING, drone_flights.conditions(seeds, scenario), keep=("v_m", "g", "f_mass", "f_wind", "r")
    ).signals
    f = kept["f_mass"] + kept["f_wind"]
    x = params().vehicle.mass * kept["v_m"]
    return tuple(Flight(*parts) for parts in zip(x, kept["g"], f, kept["r"][..., :2], strict=True))


def rmse(f_hat: NDArray[np.floating], flight: Flight) -> float:
    scored = slice(round(LEARNED_FROM / DT), None)
    return float(np.sqrt(np.mean((f_hat - flight.f)[scored] ** 2)))


def behind(filter_of: Callable[[float], PhyFilter], model: Callable[[Flight], Array]) -> Estimator:
    return lambda flight, a0: np.asarray(
        filter_of(a0).sampled(DT, g="average").run(flight.x, flight.g, model(flight))
    )


def first_order(a0: float) -> PhyFilter:
    return PhyFilter([a0])


def observer() -> Estimator:
    return lambda flight, a0: np.asarray(
        DisturbanceObserver(a0, DT, g="average").run(flight.x, flight.g), dtype=float
    )


# ------------------------------------------------------------------------------------------------ SEER-I, SEER-II


@cache
def seer() -> tuple[AdaptiveChebyshev, int]:
    """The drone's law, and how many samples its feature reaches back."""
    values = params().seer
    law = AdaptiveChebyshev(
        drone_training.train().model, DT, rate=1.0, bandwidth=values.prediction, g="average"
    )
    return law, round(values.history / DT)


def acceleration(flight: Flight) -> Array:
    steps = seer()[1]
    v = flight.x / params().vehicle.mass
    past = np.concatenate([np.repeat(v[:1], steps, axis=0), v[:-steps]])
    return (v - past) / (steps * DT)


def seer_i() -> Estimator:
    return behind(first_order, lambda flight: seer()[0].run(acceleration(flight), flight.x, flight.g).f_theta)


def seer_ii() -> Estimator:
    def estimate(flight: Flight, a0: float) -> Array:
        z = acceleration(flight)
        varsigma = seer()[0].run(z, flight.x, flight.g).varsigma
        Y = drone_training.train().model.regressor(z)  # Xi Phi(z): what varsigma weighs, (N, 3, q)
        count, n_x, q = Y.shape
        weights = np.zeros((count, n_x, n_x * q))
        for i in range(n_x):
            weights[:, i, i * q : (i + 1) * q] = varsigma
        return SeerII(a0, DT, g="average").run(
            flight.x,
            flight.g,
            basis=Y.reshape(count, -1),
            weights=weights,
            weight_slopes=np.zeros_like(weights),  # varsigma is constant but for its adaptation
        )

    return estimate


# ------------------------------------------------------------------------------------------------ EVOLVER


def evolver() -> Estimator:
    def estimate(flight: Flight, a0: float) -> Array:
        # f' = h(f, x, d): its own estimate, the velocity, and the place in the jet. Ridge and window from flights of
        # the tuning seeds: with a ridge a hundred times weaker the model follows the noise of f_hat.
        f = observer()(flight, 8.0)[::EVERY]
        z = np.hstack([f, flight.r[::EVERY], flight.x[::EVERY, :2] / params().vehicle.mass])
        dictionary = Dictionary(7, degree=1).scaled_to(z[: round(4.0 / (EVERY * DT))])
        law = OnlineKoopman(Koopman(dictionary, 3, dt=EVERY * DT, l2=1.0), round(5.0 / (EVERY * DT)))
        slope = np.repeat(law.run(z).rate, EVERY, axis=0)[: len(flight.x)]
        return Evolver(a0, DT, g="average").run(flight.x, flight.g, slope=slope)

    return estimate


# ------------------------------------------------------------------------------------- feedback neural network


def feedback_network() -> Estimator:
    fitted: dict[int, Array] = {}

    def prediction(flight: Flight) -> Array:
        if id(flight) not in fitted:
            past = slice(0, round(LEARNED_FROM / DT), EVERY)
            g = np.add.reduceat(flight.g, np.arange(0, len(flight.g), EVERY)) / EVERY
            known = g[: len(flight.x[past])]
            motion = Trajectory(flight.x[past], EVERY * DT, g=known, u=flight.r[past])
            result = NeuralOde((12,), segment=10, l2=1e-4, max_iterations=150).fit_trajectories(motion)
            fitted[id(flight)] = result.model.predict(np.hstack([flight.x, flight.r]))
        return fitted[id(flight)]

    return lambda flight, a0: np.asarray(
        FeedbackNeuralNetwork(a0, DT, g="average").run(flight.x, flight.g, prediction(flight))
    )


# ------------------------------------------------------------------------------------------ networks and filters


def training(scenario: Scenario) -> tuple[Flight, ...]:
    return flights(tuple(params().seeds.train), scenario)


def labelled(given: Sequence[Flight]) -> tuple[Array, Array]:
    """Places and true f, some of the samples: neighbours repeat each other."""
    r, f = (np.concatenate([getattr(flight, name)[::EVERY] for flight in given]) for name in ("r", "f"))
    return r, f


def network() -> Estimator:
    given = training("wind")
    model = Network((12,), seed=0).fit(*labelled(given)).model
    told = [flight.log.with_signals(f_theta=model.predict(flight.r)) for flight in given]
    filter = learn(told, 1, sampling=Sampling(g="average")).filter
    return behind(lambda _: filter, lambda flight: model.predict(flight.r))


def joint() -> Estimator:
    given = training("wind")
    model = Network((12,), seed=0).fit(*labelled(given)).model
    start = PhyFilter([6.0]).sampled(DT, g="average")
    result = learn_jointly([flight.log for flight in given], model, start, max_iterations=100)
    return behind(lambda _: result.filter, lambda flight: result.model.predict(flight.r))


def joint_torch() -> Estimator:
    import torch  # an extra

    from phyfilter_ctl.design.torch_layer import PhyFilterLayer

    def batch(parts: Sequence[Array]) -> torch.Tensor:
        return torch.from_numpy(np.stack(parts))

    given = training("wind")
    x, g, f, r = (batch([getattr(flight, name) for flight in given]) for name in ("x", "g", "f", "r"))
    torch.manual_seed(0)
    model = torch.nn.Sequential(torch.nn.Linear(2, 12), torch.nn.SiLU(), torch.nn.Linear(12, 3)).double()
    layer = PhyFilterLayer(PhyFilter([6.0]), DT, g="average")
    moving = [*model.parameters(), *layer.parameters()]
    optimiser = torch.optim.LBFGS(moving, max_iter=100, line_search_fn="strong_wolfe")

    def closure() -> torch.Tensor:
        optimiser.zero_grad()
        loss = (layer(x, g, model(r)) - f).square().mean()
        loss.backward()
        return loss

    optimiser.step(closure)
    read = learned_model(model)
    return behind(lambda _: layer.filter(), lambda flight: read.predict(flight.r))


# ------------------------------------------------------------------------------------------------ refinement


@cache
def still_air_model() -> Chebyshev:
    bounds = np.array([[-2.5, 2.5], [-2.5, 2.5]])
    return Chebyshev(4, n_d=0, l2=1e-6, bounds=bounds, outside="clip").fit(*labelled(training("mass"))).model


def still_air() -> Estimator:
    return behind(first_order, lambda flight: still_air_model().predict(flight.r))


def refined() -> Estimator:
    sampled = PhyFilter([6.0]).sampled(DT, g="average")
    logs = [flight.log.with_signals(label=None) for flight in training("wind")]
    model = refine(still_air_model(), logs, sampled).model
    return behind(first_order, lambda flight: model.predict(flight.r))


def refined_online() -> Estimator:
    def estimate(flight: Flight, a0: float) -> Array:
        sampled = PhyFilter([a0]).sampled(DT, g="average")
        return OnlineRefiner(still_air_model(), sampled, forgetting=30.0, every=50).run(flight.log).f_hat

    return estimate


KINDS: dict[str, Callable[[], Estimator]] = {
    "observer": observer,
    "seer-i": seer_i,
    "seer-ii": seer_ii,
    "evolver": evolver,
    "feedback-network": feedback_network,
    "network": network,
    "joint": joint,
    "joint-torch": joint_torch,
    "still-air": still_air,
    "refined": refined,
    "refined-online": refined_online,
}


def chosen(estimate: Estimator, tuning: Sequence[Flight], bandwidths: Sequence[float]) -> float:
    costs = [np.mean([rmse(estimate(flight, a0), flight) for flight in tuning]) for a0 in bandwidths]
    return bandwidths[int(np.argmin(costs))]


def interval(values: Array) -> tuple[float, float]:
    """Mean, and half the width of its 95 % interval."""
    half = student.ppf(0.975, len(values) - 1) * np.std(values, ddof=1) / np.sqrt(len(values))
    return float(np.mean(values)), float(half)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="three flights, to see that it runs")
    parser.add_argument("--only", nargs="+", choices=list(KINDS), default=list(KINDS))
    options = parser.parse_args()
    test = flights(tuple(range(3 if options.quick else params().seeds.test)), "wind")
    tuning = flights(tuple(params().seeds.tune[: 1 if options.quick else 3]), "wind")
    bandwidths = (4.0, 8.0) if options.quick else BANDWIDTHS
    print(f"{len(test)} flights in wind with an unknown payload, scored after {LEARNED_FROM:g} s")
    print(f"{'':<17}{'rad/s':>6}{'RMSE of f_hat in N':>20}{'change':>18}{'CPU':>9}")
    without: Array | None = None
    for name in dict.fromkeys(["observer", *options.only]):
        if name == "joint-torch" and not (find_spec("torch") and find_spec("onnxscript")):
            print(f"{name:<17}not measured: needs the extra torch")
            continue
        begun = time.process_time()
        estimate = KINDS[name]()
        fixed = name in ("network", "joint", "joint-torch")  # whose filter is learned
        a0 = 0.0 if fixed else chosen(estimate, tuning, bandwidths)
        found = np.array([rmse(estimate(flight, a0), flight) for flight in test])
        without = found if without is None else without
        mean, half = interval(found)
        change, width = interval(found / without - 1.0)
        versus = "" if name == "observer" else f"{change:+.1%} ± {width:.1%}"
        print(
            f"{name:<17}{'' if fixed else f'{a0:g}':>6}{f'{mean:.3f} ± {half:.3f}':>20}{versus:>18}"
            f"{time.process_time() - begun:>7.1f} s",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
