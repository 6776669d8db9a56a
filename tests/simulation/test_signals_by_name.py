"""Signals of responses by name: whole vectors, single entries, and what python-control does with the rest."""

import pickle

import control as ct
import numpy as np
import pytest

from phyfilter_ctl.blocks import wired
from phyfilter_ctl.fmi import Master, cosimulate
from phyfilter_ctl.plants import mass
from phyfilter_ctl.simulation import simulate, simulate_batch
from phyfilter_ctl.simulation.signals import Signals

TIMES = np.linspace(0.0, 1.0, 6)


def pair():
    blocks = [mass(2, name="lead"), mass(2, name="follower")]
    return wired(
        blocks,
        {"follower.force": "lead.v"},
        inputs={"push": "lead.force"},
        outputs={"place": "follower.r", "v": "follower.v"},
        name="pair",
    )


@pytest.fixture(scope="module")
def response():
    return simulate(pair(), TIMES, [1.0, -2.0])


def test_vectors_and_entries_of_outputs_states_and_inputs(response):
    np.testing.assert_array_equal(response.outputs["place"], response.y[:2])
    np.testing.assert_array_equal(response.outputs["v"], response.y[2:])
    np.testing.assert_array_equal(response.outputs["v[1]"], response.y[3])
    np.testing.assert_array_equal(response.states["follower.r"], response.states[4:6])
    np.testing.assert_array_equal(response.inputs["push"], response.u)


def test_vectors_are_cut_listed_and_asked_again(response):
    np.testing.assert_array_equal(response.outputs["v", 2:], response.y[2:, 2:])
    np.testing.assert_array_equal(response.outputs["v", [1, 4, 5]], response.y[2:, [1, 4, 5]])
    np.testing.assert_array_equal(response.outputs[["v[1]", "place"]], response.y[[3, 0, 1]])
    np.testing.assert_array_equal(response.outputs["v"]["v[1]"], response.y[3])
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(response)).outputs["v"], response.y[2:])


def test_what_python_control_does_stays(response):
    theirs = ct.TimeResponseData(
        response.t, response.y, issiso=False, output_labels=list(response.output_labels)
    ).outputs
    for key in ("v[1]", ["v[1]", "place[0]"], 2, slice(1, 3), (0, 5), (slice(None), 2), [0, 3], Ellipsis):
        np.testing.assert_array_equal(response.outputs[key], theirs[key])
    assert isinstance(response.outputs, type(theirs))


def test_the_exact_label_wins():
    signals = Signals(np.arange(6.0).reshape(3, 2), ["r", "r[0]", "r[1]"])
    assert signals["r"].tolist() == [0.0, 1.0]
    assert signals["r[1]"].tolist() == [4.0, 5.0]
    assert signals["r", 1:].tolist() == [1.0]


def test_entries_that_are_apart_and_of_matrices():
    signals = Signals(np.arange(10.0).reshape(5, 2), ["a[0]", "J[0,0]", "a[1]", "J[0,1]", "t"])
    assert signals["a"][:, 0].tolist() == [0.0, 4.0]
    assert signals["J"][:, 0].tolist() == [2.0, 6.0]


def test_a_squeezed_response():
    lag = ct.tf([1.0], [1.0, 1.0], inputs="u", outputs="y")
    response = simulate(lag, TIMES, 1.0)
    np.testing.assert_array_equal(response.outputs["y"], response.y[0])
    single = simulate(ct.tf([1.0], [1.0, 1.0]), TIMES, 1.0)
    assert single.outputs.shape == single.outputs["y[0]"].shape == (6,)
    assert single.outputs["y"].shape == (1, 6)


@pytest.mark.parametrize("name", ["plase", "place[2]", ["v", "plase"]])
def test_an_unknown_name_has_those_close_to_it(response, name):
    with pytest.raises(ValueError, match=r"unknown signal name 'plac?s?e(\[2\])?'; close to it: .*place"):
        response.outputs[name]
    with pytest.raises(ValueError, match="known: place, v"):
        response.outputs["zzzz"]


def test_a_batch_has_the_runs_first():
    runs = simulate_batch(pair(), TIMES, params={"lead.mass": [1.0, 2.0, 4.0]}, inputs=1.0)
    assert runs.outputs.shape == (3, 4, 6)
    np.testing.assert_array_equal(runs.outputs["v"], np.stack([run.y[2:] for run in runs]))
    np.testing.assert_array_equal(runs.outputs["v[1]"], np.stack([run.y[3] for run in runs]))
    np.testing.assert_array_equal(runs.states["lead.v"], np.stack([run.states["lead.v"] for run in runs]))
    np.testing.assert_array_equal(runs.inputs["push"], np.ones((3, 2, 6)))
    np.testing.assert_array_equal(runs.outputs[1, 2], runs[1].y[2])
    with pytest.raises(ValueError, match="close to it: place"):
        runs.outputs["plase"]


def test_a_cosimulation_too():
    run = cosimulate(
        {"pair": pair()}, TIMES, inputs={"pair.push[0]": 1.0, "pair.push[1]": -2.0}, master=Master(0.2)
    )
    np.testing.assert_array_equal(run.outputs["pair.v"], [run.outputs["pair.v[0]"], run.outputs["pair.v[1]"]])
