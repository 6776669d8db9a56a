"""The drone's filter and loop handed over: FMUs and C against the flight in the process they were made in."""

from __future__ import annotations

import importlib
from dataclasses import replace

import numpy as np
import pytest

from phyfilter_ctl import models, simulate
from phyfilter_ctl.codegen import CompilerError, find_compiler
from phyfilter_ctl.fmi import check
from phyfilter_ctl.learned import Chebyshev

ROOM = f"{models.__name__}.drone"
cosimulation = importlib.import_module(f"{ROOM}.cosimulation")
diagram = importlib.import_module(f"{ROOM}.diagram")
experiment = importlib.import_module(f"{ROOM}.experiment")
flights = importlib.import_module(f"{ROOM}.flights")
handover = importlib.import_module(f"{ROOM}.handover")
methods = importlib.import_module(f"{ROOM}.methods")
params = importlib.import_module(f"{ROOM}.params").params

try:
    find_compiler()
    COMPILER = True
except CompilerError:
    COMPILER = False
needs_compiler = pytest.mark.skipif(not COMPILER, reason="no C compiler: FMUs cannot be built")

# Sums of forces of 30 N and of momenta times 500 per second, in another order.
ROUNDING = 1e-11
# m, the same: rounding of 2500 steps in a loop that forgets it.
TRAJECTORY = 1e-11
# m: a sample of delay in a loop of 2 rad/s under gusts and noise moves the vehicle by more than this, and by less.
SEEN, LARGEST = 1e-4, 2e-2

OBSERVER = methods.Method("observer", 2.0, 6.0)
REPAIRED = methods.Method("phyfilter", 1.9, 6.0, 2.0, known="commanded")


def payload_model():
    """f = -dm (v' + g e_z), the force that SEER-I learns from flights, fitted to its formula."""
    rng = np.random.default_rng(3)
    bounds = np.array([[-4.0, 4.0]] * 3 + [[0.0, params().mass.high]])
    z = rng.uniform(bounds[:, 0], bounds[:, 1], (1500, 4))
    force = -z[:, 3:] * (z[:, :3] + [0.0, 0.0, params().vehicle.gravity])
    return Chebyshev(params().seer.degree, n_d=1, l2=params().seer.l2, bounds=bounds).fit(z, force).model


MODEL = payload_model()


@pytest.fixture(scope="module")
def flight():
    return handover.record_flight(OBSERVER, duration=3.0)


@pytest.fixture(scope="module")
def handed(flight, tmp_path_factory):
    return handover.hand_over(OBSERVER, None, tmp_path_factory.mktemp("handed") / "drone", flight=flight)


@pytest.fixture(scope="module")
def cosimulated(tmp_path_factory):
    return cosimulation.cosimulation(OBSERVER, duration=5.0, folder=tmp_path_factory.mktemp("packages"))


@pytest.mark.slow
@needs_compiler
def test_exports_repeat_the_flight(handed, flight):
    assert set(handed.differences) == {"FMI 2.0", "FMI 3.0", "C"}
    assert handed.worst < ROUNDING
    assert handed.samples == len(flight.time)
    # Something to repeat: f_hat is no zero, and the weight it has to find is in it.
    assert np.abs(flight.signals["f_hat"]).max() > 1.0


@pytest.mark.slow
@needs_compiler
def test_the_recorded_flight_goes_along(handed):
    """The files serve the library's own importer too."""
    folder = handed.exports["C"].parent
    record = folder / "drone_filter_out.csv"
    assert sorted(path.name for path in folder.iterdir()) == [
        f"drone_filter_{what}" for what in ("c", "fmi2.fmu", "fmi3.fmu", "in.csv", "out.csv")
    ]
    for form in ("FMI 2.0", "FMI 3.0"):
        report = check(handed.exports[form], reference=record, inputs_at="end", atol=ROUNDING, rtol=0.0)
        assert report.ok, str(report)


@pytest.mark.release
@needs_compiler
def test_another_flight_is_told_apart(flight, tmp_path):
    """A difference where the record is not the filter's: one sample late."""
    late = np.roll(flight.signals["f_hat"], 1, axis=1)
    wrong = replace(flight, signals={**flight.signals, "f_hat": late})
    found = handover.hand_over(OBSERVER, None, tmp_path / "wrong", flight=wrong)
    expected = np.abs(late - flight.signals["f_hat"]).max()
    for form in ("FMI 2.0", "FMI 3.0", "C"):
        assert found.largest[form] == pytest.approx(expected, rel=1e-9)


@pytest.mark.release
@needs_compiler
def test_filter_on_a_learned_model_with_held_g(tmp_path):
    flown = handover.record_flight(REPAIRED, MODEL, duration=1.0)
    assert np.abs(flown.signals["f_theta"]).max() > 0.1
    handed = handover.hand_over(REPAIRED, MODEL, tmp_path / "drone", flight=flown)
    assert handed.worst < ROUNDING


def test_what_cannot_be_handed_over(flight, tmp_path):
    def refused(
        match: str, *, method=OBSERVER, folder="drone", error: type[Exception] = ValueError, flown=flight
    ):
        with pytest.raises(error, match=match):
            handover.hand_over(method, None, tmp_path / folder, flight=flown)

    refused("baseline: expected a method with a PhyFilter", method=methods.Method("baseline", 2.0))
    refused("l1: expected a method with a PhyFilter", method=methods.Method("l1", 2.0, 6.0))
    refused("expected one of observer with these gains", method=replace(OBSERVER, bandwidth=7.0))
    few = {name: flight.signals[name] for name in ("r", "g", "f_hat")}
    refused("got none called v_m; record_flight", flown=replace(flight, signals=few))
    fallen = {**flight.signals, "f_hat": np.full_like(flight.signals["f_hat"], np.nan)}
    refused("came to its end; fell", flown=replace(flight, signals=fallen, message="fell"))
    refused("there is no folder", folder="none/drone", error=FileNotFoundError)
    (tmp_path / "file").write_text("")
    refused("is a file", folder="file", error=FileExistsError)
    with pytest.raises(ValueError, match="baseline: expected a method with an estimator"):
        cosimulation.cosimulation(methods.Method("baseline", 2.0))


@pytest.mark.release
@needs_compiler
def test_one_sample_is_all_that_a_cut_costs(cosimulated):
    """Off the diagram as far as one sample of delay in the late wires takes it, to rounding."""
    for name in ("three_jacobi", "three"):
        run = cosimulated.runs[name]
        assert SEEN < run.difference < LARGEST
        assert run.unexplained < TRAJECTORY
    # Side by side all wires are late, one after the other only those back to the parts before.
    assert cosimulated.differences["three"] < cosimulated.differences["three_jacobi"]
    assert cosimulated.step == params().sampling.dt


@pytest.mark.slow
@needs_compiler
def test_same_trajectory_from_vm_c_and_fmus(cosimulated):
    drone = diagram.build(OBSERVER)
    rows = [drone.output_labels.index(f"r[{i}]") for i in range(3)]
    drawn = flights.conditions([0], "wind").parameters()
    found = [cosimulated.runs["two"].position, cosimulated.position]
    for backend in ("vm", "c"):
        response = simulate(
            drone,
            cosimulated.time,
            cosimulated.noise,
            experiment.start_state(),
            params={name: values[0] for name, values in drawn.items()},
            method="rk4",
            max_step=params().sampling.max_step,
            backend=backend,
            interpolation="hold",
        )
        found.append(np.asarray(response.outputs)[rows].T)
    assert cosimulated.duration == 5.0
    for position in found[1:]:
        np.testing.assert_allclose(position, found[0], rtol=0, atol=TRAJECTORY)
    # It flies: a third of the circle, never far from it.
    assert np.ptp(found[0][:, 0]) > 1.0
    assert np.abs(np.hypot(*found[0][:, :2].T) - params().mission.radius).max() < 0.6


def test_systems_of_the_recipes():
    vehicle, controller, filter = (
        getattr(handover, f"{name}_system")() for name in ("vehicle", "controller", "filter")
    )
    for source, sinks in ((vehicle, (controller, filter)), (controller, (vehicle, filter))):
        for sink in sinks:
            shared = set(source.output_labels) & set(sink.input_labels)
            assert shared, (source.name, sink.name)
    assert [label for label in filter.output_labels if label.startswith("f_hat")] == [
        label for label in controller.input_labels if label.startswith("f_hat")
    ]
