"""The drone's study: points, flights, learned filters, the cluster, and what is printed and drawn."""

from __future__ import annotations

import importlib
import json
from dataclasses import replace

import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, models
from tests.figures import faults

ROOM = f"{models.__name__}.drone"
experiment = importlib.import_module(f"{ROOM}.experiment")
flights = importlib.import_module(f"{ROOM}.flights")
methods = importlib.import_module(f"{ROOM}.methods")
points = importlib.import_module(f"{ROOM}.study_points")
report = importlib.import_module(f"{ROOM}.study_report")
picture = importlib.import_module(f"{ROOM}.study_picture")
study = importlib.import_module(f"{ROOM}.study")
training = importlib.import_module(f"{ROOM}.training")
tuning = importlib.import_module(f"{ROOM}.tuning")
params = importlib.import_module(f"{ROOM}.params").params

Method = methods.Method
Point = points.Point

# s: the start-up of 6 s and what is scored.
SHORT = 7.0
TINY = points.Grid(
    seeds=(0, 1),
    map_seeds=(0,),
    bandwidths=2,
    map_bandwidths=2,
    map_speeds=1,
    delays=(0, 5),
    factors=(0.0, 1.0),
    duration=SHORT,
)
OURS = Method("phyfilter", 1.9, 6.0, 0.4)
GIVEN = {
    "integral": Method("integral", 2.0, 0.2),
    "seer": Method("seer", 2.0, 0.4),
    "observer": Method("observer", 1.9, 6.0),
    "phyfilter": OURS,
    "phyfilter_type2": Method("phyfilter_type2", 1.9, 6.0, 0.4),
}
# The same coefficients, from poles and as given: rounding over 3500 samples.
SAME_FLIGHT = 1e-9


@pytest.fixture(scope="module")
def model():
    return training.train("vm").model


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    return tmp_path_factory.mktemp("study") / "outcomes.jsonl"


@pytest.fixture(scope="module")
def found(kept):
    """Two axes, flown here; margins are another test's."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "modulus_margin", lambda v, m: 1.0 - 0.25 * v.position_bandwidth)
        yield study.study(["wind", "map"], grid=TINY, methods=GIVEN, backend="vm", workers=1, checkpoint=kept)
    study._with_margin.cache_clear()


def outcome(axis, family, value, errors, *, margin=None, speed=None):
    point = Point(axis, family, value, OURS, speed=speed)
    return study.Outcome(point, {kind: tuple(errors) for kind in ("wind", "mass")}, margin, 1.9)


# -- the plan -----------------------------------------------------------------------------------------------------


def test_every_axis_has_its_points():
    planned = points.plan(points.AXES, GIVEN, TINY)
    count = {axis: sum(point.axis == axis for point in planned) for axis in points.AXES}
    # 3 choices of g, 4 forms, the tuned filter, 4 methods at 2 places, SEER-I and 2 filters at 2 bandwidths.
    assert count == {"g": 6, "order": 8, "learned": 1, "delay": 8, "wind": 8, "mass": 8, "map": 5}


def test_the_same_flight_is_a_point_of_two_axes_but_one_job():
    assert study.steps(["g"], TINY) == 6 + 1  # and the limits
    assert study.steps(["order"], TINY) == 8
    assert study.steps(["g", "order"], TINY) == 6 + 8 - 2 + 1  # order 1 with the applied thrust is both
    assert study.steps(["mass", "wind"], TINY) == 16  # not flown in the same scenarios


def test_wrong_plans_are_refused_before_anything_flies():
    with pytest.raises(ValueError, match=r"axes: expected some of g, order, .* got colour"):
        study.study(["colour"], methods=GIVEN)
    with pytest.raises(ValueError, match="missing observer"):
        study.study(["wind"], methods={name: m for name, m in GIVEN.items() if name != "observer"})


# -- methods as no comparison flies them -------------------------------------------------------------------------


@pytest.mark.slow
def test_replaced_filter_is_the_methods_own(model):
    """With the coefficients of its own filter given, a method is itself."""
    own = methods.filter_of(OURS)
    other = replace(OURS, coefficients=(tuple(own.a), tuple(own.b)))
    windy = flights.conditions([0, 1], "wind")
    scores = [
        experiment.fly(each, windy, model, duration=SHORT, backend="vm").score() for each in (other, OURS)
    ]
    np.testing.assert_allclose(scores[0].total, scores[1].total, rtol=SAME_FLIGHT)


@pytest.mark.slow
def test_a_late_sample_costs_little_margin():
    observer = Method("observer", 1.9, 2.0)
    late = tuning.modulus_margin(replace(observer, late=1))
    assert late == pytest.approx(tuning.modulus_margin(observer), abs=0.002)


def test_delay_that_nobody_was_told_breaks_the_loop():
    baseline = Method("baseline", 1.9)
    still = flights.conditions([0], "mass")
    errors = [
        experiment.fly(replace(baseline, late=late), still, duration=SHORT, backend="vm").score().total[0]
        for late in (0, 25)
    ]
    assert errors[1] > 5.0 * errors[0]


def test_methods_that_make_no_sense_are_refused():
    with pytest.raises(ValueError, match="observer has no PhyFilter on SEER-I"):
        Method("observer", 1.9, 6.0, coefficients=((6.0,), (6.0,)))
    with pytest.raises(ValueError, match="late: expected 0 samples or more, got -1"):
        replace(OURS, late=-1)
    still = flights.conditions([0], "mass")
    with pytest.raises(ValueError, match="fly slower"):
        experiment.fly(Method("baseline", 1.9, late=1), still, others={"controller.reference.speed": 9.0})


# -- outcomes -----------------------------------------------------------------------------------------------------


def test_spread_survives_failed_flights():
    errors = [0.1, 0.2, 0.3, 0.4, np.inf]
    spread = outcome("g", "applied", 1.0, errors).spread("wind")
    assert (spread.low, spread.median, spread.high) == (0.2, 0.3, 0.4)


def test_winner_has_the_least_median():
    w = points.bandwidths(2)
    entries = [outcome("map", "seer", 0.4, [0.3], speed=1.0)]
    entries += [outcome("map", "observer", at, [e], speed=1.0) for at, e in zip(w, (0.5, 0.2), strict=True)]
    entries += [outcome("map", "phyfilter", at, [e], speed=1.0) for at, e in zip(w, (0.4, 0.1), strict=True)]
    made = study.Study(TINY, GIVEN, tuple(entries), (), None)
    assert made.winners("wind") == {(w[0], 1.0): "seer", (w[1], 1.0): "phyfilter"}
    assert made.least("mass") == {(w[0], 1.0): 0.3, (w[1], 1.0): 0.1}


@pytest.mark.slow
def test_points_fly_as_the_comparison_does(found, model):
    curve = found.curves("wind")["observer"]
    assert [entry.point.value for entry in curve] == [0.0, 1.0]
    for entry, strength in zip(curve, (0.0, 1.0), strict=True):
        drawn = flights.conditions(TINY.seeds, "wind", strength=strength)
        flown = experiment.fly(GIVEN["observer"], drawn, duration=SHORT, backend="vm").score()
        assert entry.errors["wind"] == tuple(flown.total)
    # Without wind it is the flight with unknown mass alone.
    still = experiment.fly(
        GIVEN["observer"], flights.conditions(TINY.seeds, "mass"), duration=SHORT, backend="vm"
    )
    assert curve[0].errors["wind"] == tuple(still.score().total)


@pytest.mark.slow
def test_scaled_masses_fly_scaled(model):
    point = Point("mass", "observer", 0.0, GIVEN["observer"], mass_scale=0.0, scenarios=("mass",))
    light = study.evaluate(point, TINY, model, backend="vm").errors["mass"]
    heavy = study.evaluate(replace(point, mass_scale=2.0), TINY, model, backend="vm").errors["mass"]
    assert max(light) < 0.5 * min(heavy)


def test_margin_decides_whether_a_filter_flies(model, monkeypatch):
    """The outer loop is as fast as the margin lets it be, and where that never is there nothing flies."""
    point = Point("learned", "x", 1.0, OURS, with_margin=True, needs_margin=True, scenarios=("mass",))
    for slope, fastest in ((0.22, 1.8), (0.20, 2.0)):
        monkeypatch.setattr(study, "modulus_margin", lambda v, m, k=slope: 0.9001 - k * v.position_bandwidth)
        study._with_margin.cache_clear()
        flown = study.evaluate(point, TINY, model, backend="vm")
        assert flown.position_bandwidth == pytest.approx(fastest)
        assert flown.margin == pytest.approx(0.9001 - slope * fastest)
        assert len(flown.errors["mass"]) == 2
    monkeypatch.setattr(study, "modulus_margin", lambda v, m: 0.1)
    study._with_margin.cache_clear()
    assert study.evaluate(point, TINY, model, backend="vm").errors == {}
    study._with_margin.cache_clear()


# -- learned filters ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_learned_filter_beats_its_neighbours_on_its_flights(model):
    logs, weights = study.records(OURS, model, duration=8.0, backend="vm")
    (learned,) = study.learn_filters(logs, weights, [(1, "lowpass")])
    pole = learned.coefficients[0][0]

    def rmse(a: float) -> float:
        squares = count = 0.0
        for log, weight in zip(logs, weights, strict=True):
            sampled = PhyFilter([a]).sampled(log.dt, g="average")
            error = sampled.run(log.x, g=log.g, f_theta=log.f_theta) - log.label
            squares, count = squares + float(np.sum(weight[:, None] * error**2)), count + 3.0 * weight.sum()
        return float(np.sqrt(squares / count))

    assert rmse(pole) < min(rmse(0.7 * pole), rmse(1.4 * pole), rmse(OURS.bandwidth))


# -- what is printed and drawn ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def whole():
    """All axes, made up."""
    learned = points.LearnedFilter(1, "lowpass", ((3.0,), (3.0,)), 0.2, "")
    rng = np.random.default_rng(0)
    planned = points.plan(points.AXES, GIVEN, TINY, [learned])
    outcomes = [
        study.Outcome(
            p,
            {kind: tuple(rng.uniform(0.01, 0.1, 2)) for kind in p.scenarios},
            0.5 if p.with_margin else None,
            1.9,
        )
        for p in planned
    ]
    diverged = next(i for i, entry in enumerate(outcomes) if entry.point.family == "commanded")
    outcomes[diverged] = replace(outcomes[diverged], errors={"mass": (np.inf,) * 2, "wind": (np.inf,) * 2})
    unfit = next(i for i, entry in enumerate(outcomes) if entry.point.family == learned.name)
    outcomes[unfit] = replace(outcomes[unfit], errors={}, margin=0.2)
    margins = importlib.import_module(f"{ROOM}.margins")
    limits = {"held": 85.0, "commanded": 107.0, "collective": 95.0, "applied": np.inf}
    where = margins.Limits(1.9, margins.Prediction(94.8, 77.9, 85.0), limits, limits, limits)
    return study.Study(TINY, GIVEN, tuple(outcomes), (learned,), where)


def test_table_says_what_failed_and_what_has_no_limit(whole):
    text = report.table(whole)
    rows = {line.split()[0]: line.split()[1:] for line in text.splitlines() if line.startswith("  ")}
    assert "inf" in next(line for line in text.splitlines() if line.startswith("  commanded"))
    assert (
        next(line for line in text.splitlines() if line.startswith("  low-pass, n = 1")).split()[4:6]
        == ["not"] * 2
    )
    assert rows["applied"] == ["none"] * 3
    assert all(title in text for title in report.TITLES.values())
    assert max(map(len, text.splitlines())) <= 120


def test_figures_are_json(whole):
    text = json.dumps(report.figures(whole), allow_nan=False)
    back = json.loads(text)
    assert back["axes"]["g"]["commanded"][0]["wind"]["median"] == "Infinity"
    assert back["limits"]["simulated"]["applied"] == "Infinity"
    assert len(back["winners"]["wind"]) == 2
    assert set(back["axes"]) == set(points.AXES)


@pytest.mark.slow
def test_picture_has_a_panel_for_everything(whole, found):
    figure = picture.draw(whole)
    assert [axes.get_title(loc="left")[0] for axes in figure.axes] == list("abcdefghi")
    assert not faults(figure)
    assert len(picture.draw(found).axes) == 3


@pytest.mark.slow
def test_study_goes_on_where_it_was_broken_off(found, kept, monkeypatch):
    lines = kept.read_text().splitlines()
    assert len(lines) == 1 + study.steps(["wind", "map"], TINY)
    monkeypatch.setattr(study, "fly", None)  # nothing flies again
    again = study.study(["wind", "map"], grid=TINY, methods=GIVEN, backend="vm", workers=1, checkpoint=kept)
    assert again.outcomes == found.outcomes


# -- the cluster --------------------------------------------------------------------------------------------------


@pytest.mark.release
@pytest.mark.filterwarnings("default")  # Dask's event loop and sockets warn about themselves
def test_cluster_finds_the_same_numbers(found):
    distributed = pytest.importorskip(
        "distributed", reason="the extra cluster (dask[distributed]) is not installed"
    )
    named: list[str] = []
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None
    ) as local:
        there = study.study(
            ["wind"],
            grid=TINY,
            methods=GIVEN,
            backend="vm",
            report=named.append,
            scheduler=local.scheduler_address,
        )
    assert there.outcomes == tuple(entry for entry in found.outcomes if entry.point.axis == "wind")
    assert len(named) == study.steps(["wind"], TINY)
