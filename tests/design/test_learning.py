"""Learning: the promise on a fixed log, known filters learned back, options, bad input."""

import dataclasses
import itertools
from types import SimpleNamespace

import matplotlib
import numpy as np
import pytest
from reference_log import reference_log
from scipy.optimize import minimize

from phyfilter_ctl import PhyFilter, Recording, Sampling, Search, Shape
from phyfilter_ctl.design.learning import LearnEvent, learn
from phyfilter_ctl.design.learning.verdict import status_of
from tests.cpu_budget import release_but, slow_but

matplotlib.use("Agg")

WITHIN = 1.01  # of the best cost known for the order and form, from any start
NEAR_FLOOR = 1.05
# A label without noise is learned back to rounding: costs are differences of sums, eps of the target's square, and
# poles move with the root of it.
RECOVERED = 1e-5
EXACT_FIT = 1e-6
# Costs of the two routes (correlations, and the filter run over the flights).
SAME_COST = 1e-9
# A descent stops when a step promises 1e-10 of the cost.
STOPPED = 1e-8


@pytest.fixture(scope="module")
def log():
    return reference_log()


@pytest.fixture(scope="module")
def short():
    return reference_log(4000)


def walk(seed, n=3000, channels=2):
    rng = np.random.default_rng(seed)
    return 0.1 * np.cumsum(rng.standard_normal((n, channels)), axis=0)


def random_filter(order, rng):
    """Poles anywhere the sampling resolves."""
    poles = []
    while len(poles) < order:
        size, damping = np.exp(rng.uniform(np.log(0.5), np.log(400.0))), rng.uniform(0.1, 1.5)
        if damping >= 1.0 or order - len(poles) == 1:
            poles.append(-size)
        else:
            turn = -damping + 1j * np.sqrt(1.0 - damping**2)
            poles += [size * turn, size * np.conj(turn)]
    return PhyFilter.from_poles(poles)


# -- the promise ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", release_but(("lowpass",), ("lowpass", "general")))
def test_any_start_comes_to_the_best_known_cost(log, form):
    best = dict.fromkeys(range(1, 7), np.inf)
    reached = {n: [] for n in best}
    for seed in range(5):
        rng = np.random.default_rng(100 + seed)
        starts = [random_filter(n, rng) for n in best]
        result = learn(log, 6, shape=form, search=Search(start=starts, seed=seed))
        for n, cost in result.costs.items():
            # A low-pass filter of order n that does worse than a lower order is not what comes back.
            given = min(result.costs[m] for m in range(1, n + 1)) if form == "lowpass" else cost
            reached[n].append(given)
            best[n] = min(best[n], given)
    for n, costs in reached.items():
        assert max(costs) <= WITHIN * best[n], n


def test_best_known_costs_are_also_scipys(short):
    """Nelder and Mead over poles, with the filter run over the log, ends nowhere better."""
    result = learn(short, 2)

    def cost(theta):
        a = [np.exp(2.0 * theta[0]), 2.0 * np.exp(theta[0] + theta[1])]
        f_hat = PhyFilter(a).sampled(short.dt).run(short.x, f_theta=short.f_theta)
        return float(np.mean((short.label - f_hat)[1:] ** 2))

    for start in ([2.0, 0.0], [5.0, -0.5]):
        other = minimize(cost, start, method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-10})
        assert result.cost <= other.fun * (1.0 + STOPPED)
        assert np.exp(other.x[0]) == pytest.approx(np.sqrt(result.filter.a[0]), rel=1e-3)


@pytest.mark.slow
def test_general_form_comes_near_the_wiener_filter(log):
    result = learn(log, 3, shape="general")
    assert result.wiener is not None
    assert result.wiener_ratio < NEAR_FLOOR
    low, high = result.wiener_interval
    assert low < result.wiener_ratio < high < NEAR_FLOOR
    assert result.wiener.filter_rmse == pytest.approx(result.rmse, rel=0.01)


@pytest.mark.slow
def test_cost_never_rises_with_the_order_of_the_general_form(short):
    for method in ("exact", "euler", "tustin"):
        costs = list(
            learn(
                short, 6, shape="general", sampling=Sampling(method=method), search=Search(starts=0)
            ).costs.values()
        )
        assert all(later <= earlier * (1.0 + 1e-12) for earlier, later in itertools.pairwise(costs))


@pytest.mark.slow
def test_lowpass_order_that_adds_nothing(log):
    two, four = learn(log, 2), learn(log, 4)
    assert two.status == "converged"
    assert four.status == "order_adds_nothing"
    assert four.order_used == four.filter.order == 2
    assert four.filter == two.filter
    assert "general" in four.message


def test_reported_errors_are_those_of_the_filter(short):
    other = reference_log(3000, seed=8)
    for form in ("lowpass", "general"):
        result = learn(short, 3, held_out=other, shape=form)
        for log, rmse in ((short, result.rmse), (other, result.held_out_rmse)):
            f_hat = result.filter.sampled(log.dt).run(log.x, f_theta=log.f_theta)
            assert np.sqrt(np.mean((log.label - f_hat)[1:] ** 2)) == pytest.approx(rmse, rel=SAME_COST)
        assert result.cost == pytest.approx(result.rmse**2, rel=SAME_COST)


# -- known filters -------------------------------------------------------------------------------------------

TRUTHS = {
    "first": PhyFilter([7.0]),
    "pair": PhyFilter([900.0, 24.0]),
    "repeated": PhyFilter.from_poles([-12.0, -12.0, -12.0]),
    "type 2": PhyFilter([1200.0, 600.0, 50.0], [1200.0, 600.0, 0.0]),
}


@pytest.mark.parametrize("name", TRUTHS)
@pytest.mark.parametrize("method", slow_but(("exact",), ("exact", "euler", "tustin")))
@pytest.mark.parametrize("irregular", slow_but([True], [False, True]))
def test_a_filter_is_learned_back(name, method, irregular):
    truth = TRUTHS[name]
    x = walk(1, 2500)
    steps = np.full(2500, 0.01)
    if irregular:
        steps *= np.round(1.0 + 0.3 * np.random.default_rng(2).uniform(-1.0, 1.0, 2500), 2)
        steps[1200] = 0.025  # dropped samples
    times = np.cumsum(steps)
    f_theta = 0.1 * walk(3, 2500)
    label = truth.sampled(0.01, method=method).run(x, f_theta=f_theta, times=times)
    log = Recording.from_arrays(x=x, times=times, label=label, f_theta=f_theta)
    form = "lowpass" if truth.is_lowpass else "general"
    result = learn(log, truth.order, shape=form, sampling=Sampling(method=method))
    assert result.rmse <= EXACT_FIT * np.std(label)
    np.testing.assert_allclose(result.filter.a, truth.a, rtol=RECOVERED)
    np.testing.assert_allclose(result.filter.b, truth.b, rtol=RECOVERED, atol=RECOVERED * truth.b[0])


@pytest.mark.slow
def test_many_flights_of_several_rates_with_inertia_and_held_g():
    truth = PhyFilter([400.0, 30.0])
    logs = []
    for seed, dt in enumerate((0.01, 0.004, 0.01)):
        x, g = walk(seed, 1500 + 100 * seed), walk(10 + seed, 1500 + 100 * seed)
        inertia = [2.0, 3.0]
        label = truth.sampled(dt, g="average").run(x, g, inertia=inertia)
        logs.append(Recording.from_arrays(x=x, g=g, dt=dt, label=label, inertia=inertia))
    result = learn(logs, 2, sampling=Sampling(g="average"))
    np.testing.assert_allclose(result.filter.a, truth.a, rtol=RECOVERED)
    wrong = learn(logs, 2, sampling=Sampling(g="hold"))
    assert wrong.rmse > 1e3 * result.rmse


def test_jump_at_a_gap_in_the_times_does_not_slow_the_filter():
    """The longest step bounds forward Euler only, and a gap is no step."""
    x = walk(4)
    times = 0.01 * np.arange(3000)
    times[1500:] += 2.0
    label = PhyFilter([30.0]).sampled(0.01).run(x, times=times)
    result = learn(Recording.from_arrays(x=x, times=times, label=label), 1)
    assert result.filter.a[0] == pytest.approx(30.0, rel=RECOVERED)


# -- weights, channels, flights ------------------------------------------------------------------------------


def test_weights_and_channels_choose_what_is_learned():
    x = walk(5)
    slow, fast = PhyFilter([4.0]).sampled(0.01), PhyFilter([40.0]).sampled(0.01)
    label = np.hstack([slow.run(x[:, :1]), fast.run(x[:, 1:])])
    log = Recording.from_arrays(x=x, dt=0.01, label=label, channels=["roll", "pitch"])
    assert learn(log, 1, channels=[0]).filter.a[0] == pytest.approx(4.0, rel=RECOVERED)
    assert learn(log, 1, channels=["pitch"]).filter.a[0] == pytest.approx(40.0, rel=RECOVERED)
    weights = np.zeros((3000, 2))
    weights[:, 1] = 1.0
    by_sample = learn(log, 1, weights=weights)
    assert by_sample.filter.a[0] == pytest.approx(40.0, rel=RECOVERED)
    assert by_sample.cost < 1e-6 * by_sample.rmse**2
    ends = [log.with_signals(label=run.run(x)) for run in (slow, fast)]
    assert learn(ends, 1, weights=[0.0, 2.0]).filter.a[0] == pytest.approx(40.0, rel=RECOVERED)
    middle = learn(ends, 1, weights=[1.0, 2.0]).filter.a[0]
    assert 4.0 < middle < 40.0


@pytest.mark.slow
def test_constant_weights_per_sample_change_nothing(short):
    plain = learn(short, 2)
    array = learn(short, 2, weights=np.full(short.n, 3.0))
    np.testing.assert_allclose(array.filter.a, plain.filter.a, rtol=1e-9)
    varying = np.full(short.n, 3.0)
    varying[0] = 1.0  # the first sample is left out, so this is constant too
    assert learn(short, 2, weights=varying).cost == pytest.approx(plain.cost, rel=1e-9)


def test_sample_weights_are_exact(short):
    """Random weights: no slowly varying signal, so the trials' shortcut alone would end elsewhere."""
    weights = np.random.default_rng(6).uniform(0.0, 1.0, (short.n, 3)) ** 4
    result = learn(short, 1, weights=weights)

    def cost(log_pole):
        f_hat = PhyFilter([np.exp(log_pole[0])]).sampled(short.dt).run(short.x, f_theta=short.f_theta)
        return float(np.sum((weights * (short.label - f_hat) ** 2)[1:]) / np.sum(weights[1:]))

    other = minimize(cost, [3.0], method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-14})
    assert result.cost == pytest.approx(other.fun, rel=STOPPED)
    assert np.log(result.filter.a[0]) == pytest.approx(other.x[0], abs=1e-4)


# -- the Wiener filter ---------------------------------------------------------------------------------------


def test_wiener_filter_of_a_known_response():
    """gamma* = h * u + noise: the taps are h, and no filter gets below the noise."""
    rng = np.random.default_rng(9)
    taps = np.array([0.5, 0.3, -0.1, 0.05])
    u, noise = rng.standard_normal((20_000, 1)), 0.1 * rng.standard_normal((20_000, 1))
    x = np.concatenate([[[0.0]], np.cumsum(0.01 * u, axis=0)])
    target = np.concatenate([[[0.0]], np.convolve(u[:, 0], taps)[:20_000, None] + noise])
    result = learn(Recording.from_arrays(x=x, dt=0.01, label=target), 1)
    found = np.zeros(64)
    found[: len(result.wiener.taps)] = result.wiener.taps
    np.testing.assert_allclose(found[:4], taps, atol=5.0 * 0.1 / np.sqrt(20_000))
    assert result.wiener.rmse == pytest.approx(0.1, rel=0.02)
    assert result.wiener_ratio > 1.5
    assert result.wiener_interval[0] > 1.4


def test_wiener_filter_looks_back_only():
    """A label that leads the residual cannot be reached."""
    rng = np.random.default_rng(11)
    u = rng.standard_normal((6000, 1))
    x = np.concatenate([[[0.0]], np.cumsum(0.01 * u, axis=0)])
    ahead = np.concatenate([u, [[0.0]]])  # label at sample k is u of the step after it
    result = learn(Recording.from_arrays(x=x, dt=0.01, label=ahead), 1)
    assert result.wiener.rmse == pytest.approx(np.std(u), rel=0.05)


@pytest.mark.slow
def test_both_are_scored_on_irregular_and_weighted_flights(short):
    times = short.times + 2e-4 * np.random.default_rng(12).uniform(-1.0, 1.0, short.n)
    jittered = dataclasses.replace(short, times=times)
    weights = [np.linspace(0.5, 1.5, short.n), 1.0]
    result = learn([jittered, short], 2, weights=weights, shape="general")
    plain = learn(short, 2, shape="general")
    assert result.wiener_ratio == pytest.approx(plain.wiener_ratio, abs=0.05)
    assert result.wiener.blocks == 8


# -- callbacks, history, plot --------------------------------------------------------------------------------


def test_history_is_what_the_callback_saw(short):
    seen = []
    result = learn(short, 2, search=Search(callback=seen.append))
    assert tuple(seen) == result.history
    assert all(isinstance(event, LearnEvent) for event in seen)
    by_start = {}
    for event in seen:
        assert event.cost <= by_start.get((event.order, event.start), np.inf)
        by_start[event.order, event.start] = event.cost
    assert min(by_start.values()) == pytest.approx(result.cost)


def test_cancelled_learning_returns_the_best_so_far(short):
    seen = []

    def stop(event):
        seen.append(event)
        return event.order == 2

    result = learn(short, 3, search=Search(callback=stop))
    assert result.status == "cancelled"
    assert result.wiener_ratio is None
    assert result.cost == pytest.approx(min(event.cost for event in seen))
    assert result.history[-1].order == 2


def test_cancelled_at_the_first_step(short):
    result = learn(short, 3, search=Search(callback=lambda event: True))
    assert result.status == "cancelled"
    assert result.order_used == 1
    assert len(result.history) == 1


@pytest.mark.slow
def test_the_same_seed_gives_the_same_filter(short):
    one, two = (learn(short, 4, shape="general", search=Search(seed=3)) for _ in range(2))
    assert one.filter == two.filter
    assert one.history == two.history


def test_statuses():
    # Which of many descents is still going down is a matter of rounding: what is said of one is not.
    assert status_of(SimpleNamespace(done=False), 2, 2, SimpleNamespace(shape=Shape())) == "iteration_limit"
    rng = np.random.default_rng(13)
    u = rng.standard_normal((2000, 1))
    x = np.concatenate([[[0.0]], np.cumsum(0.01 * u, axis=0)])
    direct = Recording.from_arrays(x=x, dt=0.01, label=np.concatenate([[[0.0]], u]))
    bound = learn(direct, 1)  # gamma* = u: as fast as can be
    assert bound.status == "at_bound"
    assert "faster sampling" in bound.message
    assert bound.filter.a[0] <= 3.0 / 0.01 * (1.0 + 1e-9) + 1.0


def test_plot_shows_errors_and_both_filters(short):
    import matplotlib.pyplot as plt

    result = learn(short, 2)
    shown = result.plot()
    assert shown.axes.shape == (3, 1)
    assert [text.get_text() for text in shown.legend.get_texts()][:2] == ["n = 2", "Wiener"]
    plt.close(shown.figure)
    with pytest.raises(ValueError, match="three axes"):
        result.plot(ax=[])


def test_result_is_frozen(short):
    result = learn(short, 1)
    with pytest.raises(dataclasses.FrozenInstanceError):
        result.rmse = 0.0


# -- bad input -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [0, -1, 13, 20])
def test_order_out_of_range(short, order):
    with pytest.raises(ValueError, match="order: expected 1 to 12"):
        learn(short, order)


def bad_calls():
    x = walk(20, 50)
    log = Recording.from_arrays(x=x, dt=0.01, label=walk(21, 50), name="hover")
    still = Recording.from_arrays(x=np.ones((50, 2)), dt=0.01, label=walk(21, 50))
    known = Recording.from_arrays(x=x, dt=0.01, label=x, f_theta=x)
    return {
        "label missing": ({"logs": log.with_signals(label=None)}, "'hover'.*no label"),
        "no logs": ({"logs": []}, "at least one"),
        "few samples": ({"logs": log.segment(0, 4), "order": 4}, "6 samples .* 8 parameters"),
        "constant x": ({"logs": still}, "residual .* constant"),
        "nothing to learn": ({"logs": known}, "target .* constant"),
        "form": ({"logs": log, "shape": "highpass"}, "shape: expected a Shape, or one of lowpass, general"),
        "label": ({"logs": log, "label": "lost"}, "label: expected one of given, offset"),
        "channel number": ({"logs": log, "channels": [2]}, "0 to 1"),
        "channel name": ({"logs": log, "channels": ["z"]}, "no channel 'z'"),
        "channel twice": ({"logs": log, "channels": [0, "x[0]"]}, "twice"),
        "no channel": ({"logs": log, "channels": []}, "channels"),
        "weights count": ({"logs": [log, log], "weights": [1.0]}, "each of the 2 logs"),
        "weights shape": ({"logs": log, "weights": np.ones(3)}, r"\(50,\)"),
        "weights negative": ({"logs": log, "weights": -1.0}, "0 or more"),
        "weights zero": ({"logs": log, "weights": 0.0}, "all are 0"),
        "start order": ({"logs": log, "search": Search(start=PhyFilter([1.0, 2.0, 3.0]))}, "order 3"),
        "held out": ({"logs": log, "held_out": log.with_signals(label=None)}, "no label"),
    }


@pytest.mark.parametrize("case", bad_calls())
def test_bad_values_are_refused(case):
    options, message = bad_calls()[case]
    options = {"order": 2, **options}
    with pytest.raises(ValueError, match=message):
        learn(options.pop("logs"), options.pop("order"), **options)


def test_bad_types_are_refused(short):
    with pytest.raises(TypeError, match="Recordings"):
        learn([short.x], 2)
    with pytest.raises(TypeError, match="PhyFilters"):
        learn(short, 2, search=Search(start=[3.0]))
    with pytest.raises(TypeError):
        learn(short, 2.5)
    with pytest.raises(TypeError, match="one entry a flight"):
        learn([short], 2, weights=2.0)


def test_cancelling_the_first_trials_of_unequal_steps_keeps_the_best_so_far() -> None:
    """Trials run on the mean step; broken off there, the best of them is judged on the real steps."""
    rng = np.random.default_rng(11)
    times = np.cumsum(rng.uniform(0.005, 0.015, 1500))
    x = np.cumsum(0.1 * rng.standard_normal((1500, 1)), axis=0)
    label = PhyFilter([400.0, 30.0]).sampled(0.01).run(x, times=times)
    log = Recording.from_arrays(x=x, times=times, label=label)
    seen: list[float] = []

    def stop(event: LearnEvent) -> bool:
        seen.append(event.cost)
        return len(seen) == 3

    result = learn(log, 2, search=Search(callback=stop))
    assert result.status == "cancelled"
    assert len(seen) == 3
    assert np.isfinite(result.rmse)
    assert all(cost >= 0.0 for cost in seen)


@pytest.mark.slow
def test_a_fit_down_to_rounding_has_a_wiener_floor() -> None:
    """Costs of moments with a block held out are then rounding of either sign; the refits must not fall over them."""
    n, dt = 28_000, 0.002
    t = dt * np.arange(n)
    f = np.stack([np.sin((1 + i) * t) + 0.5 * np.sin(7.0 * t + i) for i in range(3)], axis=1)
    noise = 1e-3 * np.random.default_rng(0).standard_normal((n, 3))
    result = learn(
        Recording.from_arrays(x=dt * np.cumsum(f, axis=0) + noise, dt=dt, label=f), 4, shape="general"
    )
    assert result.wiener is not None
