"""What learning does not promise: filters that no flight shows, labels that are not f, descents at their end."""

import itertools
import warnings

import numpy as np
import pytest
from reference_log import reference_log
from scipy.signal import lfilter
from test_learning import random_filter

from phyfilter_ctl import PhyFilter, Recording, Sampling, Search, Shape
from phyfilter_ctl.cli.learn_report import Row, best_of
from phyfilter_ctl.design.learning import learn, levenberg
from phyfilter_ctl.design.learning.label_check import label_faults, label_sums
from phyfilter_ctl.design.learning.parametrisation import Chain
from phyfilter_ctl.design.learning.residuals import flights_of
from phyfilter_ctl.design.learning.search import OrderSearch
from phyfilter_ctl.design.learning.sensitivity import evaluate
from phyfilter_ctl.design.learning.shape import FREE, LOWPASS
from phyfilter_ctl.design.learning.sources import sources

H = 0.01
FINER = 4  # steps of the truth a sample
NOISE = 3e-3  # m/s
G = -9.81
TILT = 0.3  # 1/s, of velocity in the label
SETTLED = 2.0 * np.pi  # decay rate times length of the longest flight, at least
ROUNDING = 1e-9
# Costs that agree to this are one optimum.
ONE_OPTIMUM = 1e-8


def gusts(rng, n, h, time, deviation=1.0):
    keep = np.exp(-h / time)
    noise = deviation * np.sqrt(1.0 - keep**2) * rng.standard_normal((n, 2))
    return lfilter([1.0], [1.0, -keep], noise, axis=0)


def flight(
    seed, label=lambda f, g: f, *, f_mean=0.0, g=None, give_g=True, seconds=10.0, noise=NOISE, slow=0.0
):
    """M x' = g + f with f gusts about a mean, x with white and with slow noise; f and g drawn finely, then sampled."""
    rng = np.random.default_rng(seed)
    n = round(seconds / H)
    f = f_mean + gusts(rng, n * FINER, H / FINER, 0.3)
    held = np.zeros((n, 2)) if g is None else g(rng, n)
    slope = f + np.repeat(held, FINER, axis=0)
    x = np.cumsum(slope * H / FINER, axis=0)[::FINER]
    x = x + noise * rng.standard_normal(x.shape) + slow * gusts(rng, n, H, 0.3)
    return Recording.from_arrays(
        x=x,
        dt=H,
        g=held if g is not None and give_g else None,
        label=label(f[::FINER], held),
        channels=("vx", "vz"),
    )


def weight(rng, n):
    return np.tile([0.0, G], (n, 1))


def thrust(rng, n):
    return gusts(rng, n, H, 0.5, 3.0)


# -- filters that no flight shows ----------------------------------------------------------------------------


def tilted(seed):
    """A hover: v stays bounded. The accelerometer tilts with v, and each flight's label has lost its mean."""
    rng = np.random.default_rng(seed)
    v = lfilter([H], [1.0, -np.exp(-H)], gusts(rng, 2000, H, 0.1), axis=0)
    f = np.gradient(v, H, axis=0)
    label = f - TILT * v
    x = v + NOISE * rng.standard_normal(v.shape)
    return Recording.from_arrays(x=x, dt=H, label=label - np.mean(label, axis=0))


@pytest.fixture(scope="module")
def hover():
    return [tilted(seed) for seed in range(3)]


@pytest.fixture(scope="module")
def refused(hover):
    return learn(hover, 3, held_out=tilted(9), shape=Shape("general", dc_gain=None))


def test_a_gain_at_rest_that_no_flight_shows_is_refused(refused):
    assert refused.status == "not_identified"
    assert refused.order_used < 3
    assert refused.is_identified
    # No worse than f_theta alone on a constant residual, |1 - F(0)| = 1, but for what noise of the data adds.
    assert abs(1.0 - refused.filter.dc_gain) < 1.05
    assert "F(0) is not identified" in refused.message
    assert f"order {refused.order_used} is returned" in refused.message
    assert "shape='lowpass'" in refused.message


def test_the_low_pass_form_is_always_identified(hover):
    result = learn(hover, 2)
    assert result.is_identified
    assert result.filter.dc_gain == pytest.approx(1.0, rel=ROUNDING)


@pytest.mark.parametrize("form", ["lowpass", "general"])
def test_no_pole_is_slower_than_the_longest_flight_shows(form):
    """The label follows a pole that takes 25 flights to settle."""
    logs = [flight(seed, seconds=seconds) for seed, seconds in ((0, 4.0), (1, 8.0))]
    slow = PhyFilter([0.005])
    logs = [log.with_signals(label=slow.sampled(H).run(log.x)) for log in logs]
    result = learn(logs, 1, shape=form)
    assert np.all(-result.filter.poles.real >= SETTLED / 8.0 * (1.0 - 0.01))
    assert result.status == "at_bound"


def test_the_choice_among_orders_and_forms_leaves_such_filters_out():
    """The label is five times M x': order 1 in the general form fits it, with F(0) = 5."""
    logs = [flight(seed, lambda f, g: 5.0 * f) for seed in range(2)]
    with pytest.warns(UserWarning, match="M x' - g times"):  # not what is asked here
        rows = [
            Row(1, "general", learn(logs, 1, shape=Shape("general", dc_gain=None))),
            Row(1, "lowpass", learn(logs, 1)),
        ]
    assert rows[0].result.status == "not_identified"
    assert rows[0].result.rmse < rows[1].result.rmse
    assert best_of(rows) is rows[1]
    assert best_of(rows[:1]) is rows[0]  # and says so by its status


# -- labels that are not f -----------------------------------------------------------------------------------

FAULTS = {
    "holds gravity": (
        {"label": lambda f, g: f + g, "g": weight},
        "vz .*difference mean 9.81.* seems to hold g",
    ),
    "holds thrust": ({"label": lambda f, g: f + g, "g": thrust}, "v[xz] .* seems to hold g"),
    "noisy x": ({"label": lambda f, g: f + g, "g": thrust, "noise": 0.1}, "seems to hold g"),
    "g missing": ({"g": weight, "give_g": False}, "vz differs .* by 9.8.*g is missing"),
    "lost mean": (
        {"label": lambda f, g: f - np.mean(f, axis=0), "f_mean": 2.0},
        "over a flight.* its mean left in",
    ),
}
SOUND = {
    "plain": {},
    "mean of f": {"f_mean": 2.0},
    "gravity": {"g": weight},
    "thrust": {"g": thrust},
    "noisy x": {"noise": 0.1},
    "slow noise of x": {"slow": 0.02, "g": thrust},
    "filtered label": {"label": lambda f, g: lfilter([0.2], [1.0, -0.8], f, axis=0)},
    "noisy label": {"label": lambda f, g: f + 0.3 * np.random.default_rng(0).standard_normal(f.shape)},
    "scaled label": {"label": lambda f, g: 1.1 * f},
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_label_that_is_not_f_is_warned_of(fault):
    options, words = FAULTS[fault]
    logs = [flight(seed, **options) for seed in range(2)]
    with pytest.warns(UserWarning, match=words):
        result = learn(logs, 1, search=Search(starts=0))
    assert any("the label of" in note for note in result.notes)


@pytest.mark.parametrize("case", SOUND)
def test_a_sound_label_raises_no_alarm(case):
    for seed in range(0, 20, 2):
        flights = [flight(seed, **SOUND[case]), flight(seed + 1, seconds=3.0, **SOUND[case])]
        assert label_faults([*map(label_sums, flights_of(flights))], ("vx", "vz")) == []


def test_a_stretch_of_no_weight_is_not_looked_at():
    log = flight(0, g=weight)
    label, weights = log.label.copy(), np.ones(log.n)
    label[:800] += log.g[:800]
    weights[:800] = 0.0
    log = log.with_signals(label=label)
    assert label_faults([*map(label_sums, flights_of([log], weights=[weights]))], ("vx", "vz")) == []
    assert len(label_faults([*map(label_sums, flights_of([log]))], ("vx", "vz"))) == 1


def test_without_g_the_result_says_what_is_taken_as_f():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        without = learn(flight(0), 1, search=Search(starts=0))
        with_g = learn(flight(0, g=thrust), 1, search=Search(starts=0))
    assert without.notes == ("no g: M x' is taken as f",)
    assert with_g.notes == ()


# -- descents at their end -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_no_descent_says_limit_at_an_optimum():
    """48 descents from random starts, broken off at the step that comes to the optimum and at the two after it."""
    log = reference_log(600)
    data, _ = sources(flights_of([log]), "exact")
    for shape in (LOWPASS, FREE):
        search = OrderSearch(data, data, "exact", log.dt, SETTLED / log.duration, 400, lambda *_: None, shape)
        for n, seed in itertools.product((2, 3), range(4, 8)):
            theta = search.coordinates.of(random_filter(n, np.random.default_rng(seed)).poles)
            begun = levenberg.start(search.cost(data), theta)
            way = []
            upper, lower = search.box(n)
            end = levenberg.descend(
                search.cost(data), begun, upper, lower, limit=400, negligible=0.0, report=way.append
            )
            assert end.done
            reached = next(at for at in way if at.found.cost <= (1.0 + ONE_OPTIMUM) * end.found.cost)
            for limit in (reached.iterations, reached.iterations + 1, reached.iterations + 2):
                assert search._descend(n, 0, begun, data, limit).done


def test_a_chain_without_sensitivities_has_no_cost():
    """Its own decay is below rounding; the floor alone makes it stable."""
    log = reference_log(100)
    data, _ = sources(flights_of([log]), "exact")
    assert evaluate(data, Chain(np.array([-700.0, 0.0]), 1.0), FREE) is None


# -- limits of the actuators ---------------------------------------------------------------------------------------


def test_commands_beyond_the_actuators_are_learned_from_as_the_filter_will_take_them():
    """The label is what a filter with these limits makes of the log: with them it is learned back, without not."""
    rng = np.random.default_rng(3)
    g, gust = 3.0 * np.sin(np.outer(np.arange(600), [0.11, 0.07])), rng.standard_normal((600, 2))
    ends = ([-1.0, -2.0], [1.5, 1.0])
    x = np.cumsum(0.02 * (np.clip(g, *ends) + gust), axis=0)
    truth = PhyFilter([30.0]).sampled(0.02, g_limit=ends)
    log = Recording.from_arrays(x=x, dt=0.02, g=g, label=truth.run(x, g))
    found = learn(log, 1, sampling=Sampling(g_limit=ends), search=Search(starts=0))
    assert found.filter.a[0] == pytest.approx(30.0, rel=1e-6)
    np.testing.assert_allclose(found.sampled().run(x, g), log.label, atol=1e-6)
    with pytest.warns(UserWarning, match="label"):
        without = learn(log, 1, search=Search(starts=0))
    assert without.rmse > 0.1
    with pytest.raises(ValueError, match="one pair of numbers"):
        learn(log, 1, channels=[0], sampling=Sampling(g_limit=ends))
    alone = learn(log, 1, channels=[0], sampling=Sampling(g_limit=(-1.0, 1.5)), search=Search(starts=0))
    assert alone.filter.a[0] == pytest.approx(30.0, rel=1e-6)


# -- what is asked for in another way ------------------------------------------------------------------------


def test_of_several_orders_those_without_a_score_are_named():
    x = np.cumsum(np.random.default_rng(0).standard_normal((2000, 1)), axis=0)
    log = Recording.from_arrays(x=x, dt=H, label=PhyFilter([20.0]).sampled(H).run(x))
    result = learn(log, [1, 2, 3], search=Search(starts=0))
    assert result.order_used == 1
    assert result.message.startswith("order 1: the lowest of 1, 2, 3; cross-validated RMSE")
    assert "2, 3: not scored" in result.message
    two = learn(flight(0), [1, 2, 3], search=Search(starts=0))
    assert "as good as the best of 1 to 2;" in two.message
    assert "; 3: not scored" in two.message


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        (
            {"order": "auto"},
            TypeError,
            r"order: expected a whole number, or several .* range\(1, 7\), got 'auto'",
        ),
        ({"order": 1.0}, TypeError, r"order: expected a whole number, .* got 1\.0"),
        (
            {"recordings": {"a": flight(0)}},
            TypeError,
            r"recordings: expected Recordings, .* got dict; .* list\(logs\.values\(\)\)",
        ),
        (
            {"recordings": "folder/*.csv"},
            ValueError,
            r"folder/\*\.csv: no such file; of a pattern give sorted",
        ),
        ({"channels": "vx"}, ValueError, r"channels: .* got 'vx'; one is \['vx'\]"),
        (
            {"recordings": flight(0).with_signals(label=None)},
            ValueError,
            r"no label.*estimate\(log\), or smooth_label\(log\)",
        ),
    ],
)
def test_wrong_arguments_are_named_with_what_to_give(given, error, words):
    with pytest.raises(error, match=words):
        learn(**({"recordings": flight(0), "order": 1} | given))
