"""Tuning finds what made the labels, says how it ended, and refuses what it cannot tune."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from phyfilter_ctl.baselines import (
    BASELINES,
    BackwardDifference,
    KalmanDifferentiator,
    LowpassDifference,
    RobustDifferentiator,
    SearchRange,
    TrackingDifferentiator,
    TunableDifferentiator,
    TuneResult,
    tune,
)
from phyfilter_ctl.baselines.protocol import Differentiator
from phyfilter_ctl.study import Executor
from tests.cpu_budget import slow_but

DT = 0.01


def flights(n: int = 600) -> list[tuple[np.ndarray, np.ndarray, float, int]]:
    """Two flights with known acceleration, the second at another rate."""
    made = []
    for seed, dt in ((0, DT), (1, 2 * DT)):
        rng = np.random.default_rng(seed)
        t = dt * np.arange(n)[:, None]
        omega, phase = np.array([1.0, 2.5]), rng.uniform(0.0, 6.0, 2)
        v = np.sin(omega * t + phase) + 0.01 * rng.standard_normal((n, 2))
        made.append((v, omega * np.cos(omega * t + phase), dt, 50))
    return made


def rmse(differentiator: Differentiator, data: list[tuple[np.ndarray, np.ndarray, float, int]]) -> float:
    errors = [(differentiator.estimate(v, dt) - label)[skip:].ravel() for v, label, dt, skip in data]
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


class Diverging(LowpassDifference):
    """One whose recursion leaves the range of floating-point numbers."""

    def estimate(self, v: object, dt: float) -> np.ndarray:
        raise FloatingPointError("the recursion diverged")


@pytest.mark.parametrize(
    "truth",
    [
        BackwardDifference(7),
        LowpassDifference(13.0),
        LowpassDifference(13.0, order=2),
        KalmanDifferentiator(0.37),
        TrackingDifferentiator(2.0, 6.0),
    ],
    ids=repr,
)
def test_finds_the_parameters_that_made_the_labels(
    truth: BackwardDifference | LowpassDifference | KalmanDifferentiator | TrackingDifferentiator,
) -> None:
    data = [(v, truth.estimate(v, dt), dt, skip) for v, _, dt, skip in flights()]
    fixed = {"order": truth.order} if isinstance(truth, LowpassDifference) else None
    result = tune(type(truth), data, fixed=fixed, tolerance=1e-4)
    assert result.status == "converged"
    found, expected = dataclasses.asdict(result.differentiator), dataclasses.asdict(truth)
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, rel=2e-2)
    assert result.rmse < 1e-2


@pytest.mark.parametrize("kind", slow_but([LowpassDifference, KalmanDifferentiator], BASELINES.values()))
def test_beats_its_defaults_and_reports_its_own_figure(kind: type[TunableDifferentiator]) -> None:
    data = flights()
    result = tune(kind, data)
    assert result.status in ("converged", "at_bound")
    assert result.rmse == pytest.approx(rmse(result.differentiator, data), rel=1e-12)
    assert result.rmse <= rmse(kind(), data)
    for r in kind.search_space(DT):
        assert r.low * (1 - 1e-9) <= getattr(result.differentiator, r.name) <= r.high * (1 + 1e-9)


def test_no_point_of_a_fine_grid_is_better() -> None:
    data = flights()
    fine = min(rmse(LowpassDifference(float(w)), data) for w in np.geomspace(0.5, 300.0, 400))
    # the grid has steps of 1.6 %, at which a quadratic minimum is this flat
    assert tune(LowpassDifference, data).rmse <= fine * (1.0 + 1e-4)


def test_long_flights_are_screened_short_and_give_the_same_optimum() -> None:
    long = flights(9000)
    fine = min(rmse(LowpassDifference(float(w)), long) for w in np.geomspace(5.0, 50.0, 100))
    assert tune(LowpassDifference, long).rmse <= fine * (1.0 + 1e-3)


@pytest.mark.slow
def test_other_processes_find_the_same() -> None:
    with Executor(2) as executor:
        assert tune(LowpassDifference, flights(), executor=executor) == tune(LowpassDifference, flights())


@pytest.mark.slow
def test_is_deterministic() -> None:
    one, again = (tune(RobustDifferentiator, flights(200), max_evaluations=20) for _ in range(2))
    assert one == again


def test_fixed_and_bounds() -> None:
    result = tune(RobustDifferentiator, flights(200), fixed={"mu": 1.5}, bounds={"k1": (2.0, 3.0)})
    assert result.differentiator.mu == 1.5
    assert 2.0 <= result.differentiator.k1 <= 3.0
    nothing_left = tune(LowpassDifference, flights(200), fixed={"cutoff": 5.0})
    assert nothing_left.differentiator == LowpassDifference(5.0)
    assert nothing_left.status == "converged"


def test_skipped_samples_do_not_count() -> None:
    data = flights(300)
    spoiled = []
    for v, label, dt, skip in data:
        bad = label.copy()
        bad[:skip] = np.nan
        spoiled.append((v, bad, dt, skip))
    assert tune(LowpassDifference, spoiled) == tune(LowpassDifference, data)


def test_statuses() -> None:
    data = flights(300)
    narrow = tune(LowpassDifference, data, bounds={"cutoff": (1.0, 2.0)})
    assert narrow.status == "at_bound"
    assert "cutoff at its upper bound 2" in narrow.message
    short = tune(TrackingDifferentiator, data, max_evaluations=3)
    assert short.status == "iteration_limit"
    assert "raise max_evaluations" in short.message
    failed = tune(Diverging, data)
    assert failed.status == "failed"
    assert failed.rmse == float("inf")
    assert "diverged" in failed.message
    assert isinstance(failed, TuneResult)


GOOD = (np.zeros((5, 2)), np.zeros((5, 2)), 0.01, 0)


@pytest.mark.parametrize(
    ("flight", "error", "words"),
    [
        (
            (np.zeros((5, 2)), np.zeros((5, 1)), 0.01, 0),
            ValueError,
            r"flights\[1\]: label: expected shape",
        ),
        ((np.zeros(5), np.zeros(5), 0.01, 0), ValueError, r"flights\[1\]: v: expected shape"),
        ((np.full((5, 2), np.nan), np.zeros((5, 2)), 0.01, 0), ValueError, "v: expected finite numbers"),
        (
            (np.zeros((5, 2)), np.full((5, 2), np.nan), 0.01, 2),
            ValueError,
            "label is not finite after the first 2",
        ),
        ((np.zeros((5, 2)), np.zeros((5, 2)), 0.0, 0), ValueError, "dt"),
        ((np.zeros((5, 2)), np.zeros((5, 2)), 0.01, 5), ValueError, "nothing would count"),
        ((np.zeros((5, 2)), np.zeros((5, 2)), 0.01, 0.5), TypeError, "skip: expected a whole number"),
    ],
)
def test_bad_flights(
    flight: tuple[np.ndarray, np.ndarray, float, int], error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words):
        tune(LowpassDifference, [GOOD, flight])


def test_bad_options() -> None:
    with pytest.raises(ValueError, match="expected at least one, got none"):
        tune(LowpassDifference, [])
    with pytest.raises(ValueError, match=r"LowpassDifference has no \['cutof'\], only \['cutoff', 'order'\]"):
        tune(LowpassDifference, [GOOD], fixed={"cutof": 1.0})
    with pytest.raises(ValueError, match=r"\['order'\] is not sought; sought are \['cutoff'\]"):
        tune(LowpassDifference, [GOOD], bounds={"order": (1.0, 2.0)})
    with pytest.raises(ValueError, match="cutoff: expected low < high"):
        tune(LowpassDifference, [GOOD], bounds={"cutoff": (2.0, 1.0)})
    with pytest.raises(ValueError, match="max_evaluations"):
        tune(LowpassDifference, [GOOD], max_evaluations=0)
    with pytest.raises(ValueError, match="tolerance"):
        tune(LowpassDifference, [GOOD], tolerance=0.0)
    with pytest.raises(ValueError, match="x: low"):
        SearchRange("x", 0.0, 1.0)
