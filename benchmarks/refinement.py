"""What refinement is worth on generated flights that it has not seen, and what a change of the model in flight does.

Flights of a body with quadratic drag, cross-coupling and gusts; the model is fitted to slow flights, the flights to
refine on and to score on are faster ones. Gusts are part of f, but no function of the features: no model can learn
them, and every one can mistake them for drag. Figures, in m/s^2:

1. offline: errors on unseen flights and the filter's share, before and after;
2. what the refined model forgot of the slow flights, with and without memory;
3. online with forgetting, flight after flight;
4. jumps of f_theta: the general form, EVOLVER, and the estimate of the online refiner.

    python benchmarks/refinement.py [--quick]
"""

from __future__ import annotations

import argparse
import sys
import time
from itertools import product

import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.baselines.observers import Evolver
from phyfilter_ctl.design.refinement import ModelScore, refine, score_model
from phyfilter_ctl.design.refinement.online import OnlineRefiner
from phyfilter_ctl.learned import Chebyshev, LearnedModel, Network
from phyfilter_ctl.recording import Recording

Array = NDArray[np.float64]

DT = 0.005
POLES = {"fast": [-12.0, -12.0], "slow": [-4.0, -4.0]}
FILTER = PhyFilter.from_poles(POLES["fast"])
SLOW, FAST = 1.0, 2.0  # m/s; root mean square of each channel is 0.7 of it
GUST = 0.4  # m/s^2, likewise
BOUNDS = np.array([[-5.0, 5.0]] * 3)


def drag(v: Array) -> Array:
    """True f without gusts: quadratic drag, a lift that couples x and y into z, an offset."""
    speed = np.linalg.norm(v, axis=1, keepdims=True)
    lift = np.zeros_like(v)
    lift[:, 2] = 0.12 * v[:, 0] ** 2 - 0.08 * v[:, 0] * v[:, 1]
    return -0.18 * speed * v + lift + np.array([0.3, 0.0, -0.2])


def flight(seed: int, speed: float, seconds: float, *, gust: float = GUST, noise: float = 3e-3) -> Recording:
    """One flight: velocities as sums of sines, gusts of 0.1 to 3 rad/s, white noise on the measured velocity."""
    rng = np.random.default_rng(seed)
    t = DT * np.arange(round(seconds / DT) + 1)

    def sines(low: float, high: float, size: float) -> tuple[Array, Array]:
        omega, phase = rng.uniform(low, high, (6, 3)), rng.uniform(0.0, 2.0 * np.pi, (6, 3))
        angle = omega * t[:, None, None] + phase
        size /= np.sqrt(6.0)
        return size * np.sin(angle).sum(axis=1), size * (omega * np.cos(angle)).sum(axis=1)

    v, slope = sines(0.2, 2.0, speed)
    f = drag(v) + sines(0.1, 3.0, gust)[0]
    measured = v + noise * rng.standard_normal(v.shape)
    return Recording.from_arrays(
        x=measured, dt=DT, g=slope - f, label=f, features=measured, name=f"{speed:g} m/s, seed {seed}"
    )


def fitted_on_slow_flights(count: int, seconds: float, degree: int) -> tuple[dict[str, LearnedModel], Array]:
    """The models before refinement, and the features that they were fitted to."""
    v = np.concatenate([flight(seed, SLOW, seconds).x for seed in range(count)])[::5]
    models: dict[str, LearnedModel] = {
        "chebyshev": Chebyshev(degree, n_d=0, l2=1e-3, bounds=BOUNDS).fit(v, drag(v)).model,
        "network": Network((12, 12), seed=0, tolerance=1e-6).fit(v, drag(v)).model,
    }
    return models, v


def rmse(error: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1) / error.shape[1])))


def model_error(model: LearnedModel, logs: list[Recording]) -> float:
    """Against f without gusts, at what the flights visit."""
    return rmse(np.concatenate([model.predict(log.x) - drag(log.x) for log in logs]))


def _row(where: str, when: str, model: LearnedModel, score: ModelScore, unseen: list[Recording]) -> str:
    return (
        f"{where:>24} {when:>10} {model_error(model, unseen):11.3f} {score.f_theta_rmse:8.3f} "
        f"{score.f_hat_rmse:8.4f} {score.share:6.3f}"
    )


def offline(models: dict[str, LearnedModel], training: list[Recording], unseen: list[Recording]) -> bool:
    """Table 1; whether refinement lowers error and share on unseen flights."""
    print(f"\n1. offline, {len(training)} flights to refine on, scored on {len(unseen)} unseen ones")
    print(
        f"{'':>24} {'':>10} {'model error':>11} {'f_theta':>8} {'f_hat':>8} {'share':>6} "
        f"{'trust':>8} {'time':>8}  status"
    )
    ok = True
    for (name, model), (speed, poles) in product(models.items(), POLES.items()):
        sampled = PhyFilter.from_poles(poles).sampled(DT, g="average")
        first = score_model(model, unseen, sampled)

        where = f"{name}, {speed} filter"
        print(_row(where, "before", model, first, unseen))
        begun = time.perf_counter()
        result = refine(model, training, sampled)
        seconds = time.perf_counter() - begun
        score = score_model(result.model, unseen, sampled)
        tail = f"{result.trust:8.1e} {seconds:6.2f} s  {result.status}"
        print(_row(where, "after", result.model, score, unseen), tail)
        ok = ok and score.f_theta_rmse < first.f_theta_rmse and score.share < first.share
    return ok


def forgetting(
    models: dict[str, LearnedModel],
    old_features: Array,
    training: list[Recording],
    unseen: list[Recording],
    slow: list[Recording],
) -> None:
    """Table 2."""
    sampled = FILTER.sampled(DT, g="average")
    print("\n2. what is forgotten: model error on unseen fast flights and on slow ones as in the first fit")
    for name, model in models.items():
        print(
            f"{f'{name}, before':>36}: fast {model_error(model, unseen):.3f}, slow {model_error(model, slow):.3f}"
        )
        for keep in (0.0, 1.0, 10.0):
            memory = old_features[::4] if keep else None
            refined = refine(model, training, sampled, memory=memory, keep=keep).model
            what = f"memory with keep {keep:g}" if keep else "no memory"
            print(
                f"{f'{name}, {what}':>36}: fast {model_error(refined, unseen):.3f}, "
                f"slow {model_error(refined, slow):.3f}"
            )


def online(model: LearnedModel, logs: list[Recording]) -> bool:
    """Table 3; whether error and share in flight are below those of the model as it was, on every flight."""
    sampled = FILTER.sampled(DT, g="average")
    print("\n3. online, chebyshev, flight after flight (figures in flight, with parameters of the past only)")
    print(
        f"{'forgetting':>11} {'flight':>7} {'f_theta':>8} {'unrefined':>9} {'f_hat':>8} {'unrefined':>9} {'share':>6}"
    )
    better = True
    for constant in (10.0, 30.0, 100.0):
        refiner = OnlineRefiner(model, sampled, forgetting=constant)
        begun = time.perf_counter()
        flown, _ = refiner.run_all(logs)
        seconds = time.perf_counter() - begun
        for i, (log, seen) in enumerate(zip(logs, flown, strict=True)):
            first = score_model(model, log, sampled)
            assert log.label is not None
            share, error = rmse(seen.f_hat - seen.f_theta) / rmse(seen.f_hat), rmse(seen.f_theta - log.label)
            better = better and share < first.share and error < first.f_theta_rmse
            if i in (0, 1, len(logs) - 1):
                print(
                    f"{constant:9.0f} s {i + 1:7d} {error:8.3f} {first.f_theta_rmse:9.3f} "
                    f"{rmse(seen.f_hat - log.label):8.4f} {first.f_hat_rmse:9.4f} {share:6.3f} {first.share:9.3f}"
                )
        samples = sum(log.n for log in logs)
        print(f"{'':>11} {1e6 * seconds / samples:.1f} us a sample, {len(refiner.tuned.index)} parameters")
    return better


def jumps(seconds: float) -> None:
    """Table 4: where f_theta jumps and f does not, where both jump, and a model refined in flight."""
    a0 = 12.0
    general = PhyFilter([a0]).sampled(DT, g="average")
    evolver = Evolver(a0, DT, g="average")
    t = DT * np.arange(round(seconds / DT) + 1)[:, None]
    middle = len(t) // 2
    step = np.where(t > t[middle], 1.0, 0.0)
    smooth, slope = np.sin(2.0 * t), 2.0 * np.cos(2.0 * t)
    print(f"\n4. a jump of 1 m/s^2 of f_theta = sin(2 t), a_0 = {a0:g} rad/s: error of f_hat after it")
    print(f"{'':>34} {'peak':>8} {'rms 1 s':>8} {'at 3/a_0':>17}")

    def backward(f: Array) -> Array:
        return np.diff(f, axis=0, prepend=f[:1]) / DT

    jump = np.zeros_like(t)
    jump[middle + 1] = 1.0
    after, later = slice(middle + 1, middle + 1 + round(1.0 / DT)), middle + 1 + round(3.0 / a0 / DT)
    for name, f in (("f_theta jumps, f does not", smooth), ("both jump", smooth + step)):
        x = np.concatenate([np.zeros((1, 1)), np.cumsum(0.5 * DT * (f[1:] + f[:-1]), axis=0)])
        if f is not smooth:  # the jump is at a sample: the step before it has none of it
            x -= 0.5 * DT * step
        estimates = {
            "general form": general.run(x, f_theta=smooth + step),
            "EVOLVER, smooth slope": evolver.run(x, slope=slope),
            "EVOLVER, slope and jump": evolver.run(x, slope=slope, jumps=jump),
            "EVOLVER, slope by differences": evolver.run(x, slope=backward(smooth + step)),
        }
        print(f"  {name}")
        for form, f_hat in estimates.items():
            error = np.abs(f_hat - f)
            print(f"{form:>34} {error[after].max():8.4f} {rmse(error[after]):8.4f} {error[later, 0]:17.4f}")


def updates_in_flight(model: LearnedModel, logs: list[Recording]) -> None:
    """The end of table 4: a model refined in flight, its changes passed on or not."""
    sampled = FILTER.sampled(DT, g="average")
    print("  model refined in flight: error of f_hat, and its largest change at an update")
    print(f"{'every':>10} {'forgetting':>11} {'f_theta passed on':>24} {'consistent with updates':>26}")
    for every, constant in ((10, 10.0), (200, 10.0), (200, 2.0)):
        refiner = OnlineRefiner(model, sampled, forgetting=constant, every=every)
        flown, _ = refiner.run_all(logs)
        errors: dict[str, list[Array]] = {"passed": [], "consistent": []}
        kicks = {"passed": 0.0, "consistent": 0.0}
        for log, seen in zip(logs, flown, strict=True):
            assert log.label is not None
            passed = sampled.run(log.x, log.g, seen.f_theta)
            at = seen.updates[1:]
            at = at[at + 1 < log.n]
            for name, f_hat in (("passed", passed), ("consistent", seen.f_hat)):
                errors[name].append(f_hat - log.label)
                kicks[name] = max(kicks[name], float(np.max(np.abs(f_hat[at + 1] - f_hat[at]))))
        cells = [f"{rmse(np.concatenate(errors[name])):8.4f}, kick {kicks[name]:7.3f}" for name in errors]
        print(f"{every:10d} {constant:9.0f} s {cells[0]:>24} {cells[1]:>26}")


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="short flights, to see that it runs")
    quick = parser.parse_args().quick
    seconds, count = (10.0, 3) if quick else (30.0, 6)
    models, old_features = fitted_on_slow_flights(count, seconds, 2 if quick else 3)
    if quick:
        models.pop("network")
    training = [flight(100 + i, FAST, seconds) for i in range(count)]
    unseen = [flight(200 + i, FAST, seconds) for i in range(count)]
    slow = [flight(300 + i, SLOW, seconds) for i in range(count)]
    ok = offline(models, training, unseen)
    forgetting(models, old_features, training, unseen, slow)
    ok = online(models["chebyshev"], training) and ok
    jumps(10.0)
    updates_in_flight(models["chebyshev"], training)
    print(f"\nrefinement lowers error and share: {'holds' if ok else 'DOES NOT HOLD'}")
    return 0 if ok else 1


if __name__ == "__main__":
    sys.exit(main())
