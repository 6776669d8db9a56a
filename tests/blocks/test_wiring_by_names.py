"""One dictionary of signals: the diagram is that of single wires, and what is not clear is refused with names."""

from __future__ import annotations

import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, sampled_block
from phyfilter_ctl.blocks import wired
from phyfilter_ctl.diagram import flatten
from phyfilter_ctl.plants import mass, plant
from phyfilter_ctl.simulation import simulate

TIMES = np.linspace(0.0, 1.0, 51)
ZERO = np.zeros(2)


def law():
    def equations(t, x, u, p):
        return {}, {"force": p.k * (u.r_ref - u.r) - p.d * u.v - u.f_hat}

    return plant(
        equations,
        name="law",
        states={},
        inputs={"r": ZERO, "v": ZERO, "r_ref": ZERO, "f_hat": ZERO},
        outputs=["force"],
        params={"k": 4.0, "d": 3.0},
        optional=["f_hat"],
    )


def sensor():
    return plant(
        lambda t, x, u, p: ({}, {"r_m": u.r + u.n, "v_m": 1.0 * u.v}),
        name="sensor",
        states={},
        inputs={"r": ZERO, "v": ZERO, "n": ZERO},
        outputs=["r_m", "v_m"],
    )


def add():
    return plant(
        lambda t, x, u, p: ({}, {"force": u.a + u.d}),
        name="add",
        states={},
        inputs={"a": ZERO, "d": ZERO},
        outputs=["force"],
    )


def filter():
    return sampled_block(PhyFilter([20.0]).sampled(0.02), 2, name="filter")


SIGNALS = {
    "r": "body.r",
    "v": "body.v",
    "r_m": "sensor.r_m",
    "v_m": "sensor.v_m",
    "force": "add.force",
    "g": "law.force",
    "f_hat": "filter.f_hat",
    "law.r": "r_m",
    "law.v": "v_m",
    "filter.x": "v_m",
    "add.a": "g",
}
WIRES = {
    "sensor.r": "body.r",
    "sensor.v": "body.v",
    "law.r": "sensor.r_m",
    "law.v": "sensor.v_m",
    "law.f_hat": "filter.f_hat",
    "filter.x": "sensor.v_m",
    "filter.g": "law.force",
    "add.a": "law.force",
    "body.force": "add.force",
}


def blocks():
    return [law(), mass(2, name="body"), sensor(), add(), filter()]


def test_is_the_diagram_of_single_wires():
    ours = wired(blocks(), SIGNALS, inputs=["r_ref", "d", "n"], outputs=["r", "f_hat"], name="loop")
    theirs = wired(
        blocks(),
        WIRES,
        inputs={"r_ref": "law.r_ref", "d": "add.d", "n": "sensor.n"},
        outputs={"r": "body.r", "f_hat": "filter.f_hat"},
        name="loop",
    )
    assert ours.input_labels == theirs.input_labels
    assert ours.output_labels == theirs.output_labels
    np.testing.assert_array_equal(ours.connect_map, theirs.connect_map)
    np.testing.assert_array_equal(ours.input_map, theirs.input_map)
    np.testing.assert_array_equal(ours.output_map, theirs.output_map)
    u = np.repeat([[1.0], [-1.0], [0.5], [0.2], [0.0], [0.0]], len(TIMES), axis=1)
    response = simulate(ours, TIMES, u)
    assert response.success
    np.testing.assert_allclose(response.outputs["f_hat"][:, -1], [0.5, 0.2], atol=0.02)


def test_an_output_of_a_block_or_a_signal_is_shown_under_any_name():
    both = wired(
        blocks(),
        SIGNALS,
        inputs=["r_ref", "d", "n"],
        outputs={"place": "r", "push": "law.force"},
        name="loop",
    )
    assert both.output_labels == ["place[0]", "place[1]", "push[0]", "push[1]"]


def test_a_block_is_not_wired_to_itself():
    echo = plant(
        lambda t, x, u, p: ({}, {"v": 2.0 * u.v}), name="echo", states={}, inputs={"v": ZERO}, outputs=["v"]
    )
    diagram = wired([echo], {"v": "echo.v"}, outputs=["v"])
    with pytest.raises(ValueError, match=r"nothing drives echo\.v\[0\]"):
        flatten(diagram)


def test_a_wire_of_its_own_wins_over_the_name():
    body, follower = mass(2, name="body"), mass(2, name="follower")
    diagram = wired(
        [body, follower, law()],
        {"force": "law.force", "r": "body.r", "v": "body.v", "follower.force": "body.v"},
        inputs=["r_ref"],
        outputs={"r": "follower.r"},
    )
    labels = [f"{b.name}.{e}" for b in diagram.syslist for e in b.input_labels]
    sources = [f"{b.name}.{e}" for b in diagram.syslist for e in b.output_labels]
    row = diagram.connect_map[labels.index("follower.force[0]")]
    assert [sources[j] for j in np.flatnonzero(row)] == ["body.v[0]"]


@pytest.mark.parametrize(
    ("more", "ends", "message"),
    [
        (
            {"r_rf": "body.r"},
            {},
            r"signal 'r_rf' \(body\.r\) drives nothing and is no output.*did you mean 'r_ref'",
        ),
        ({"w": "body.q"}, {}, "block 'body' has no output 'q'"),
        ({"w": "bdy.r"}, {}, "no block 'bdy'; did you mean 'body'"),
        ({"w": "r"}, {}, "signal 'w': expected 'block.output'"),
        ({"law.r": "r_n"}, {}, r"law\.r: no signal 'r_n'; did you mean 'r_m'"),
        ({"law.rr": "r_m"}, {}, "block 'law' has no input 'rr'; did you mean 'r'"),
        ({"law.r[0]": "r_m"}, {}, "driven twice|1 entries"),
        ({}, {"inputs": ["r_rf"]}, "input 'r_rf': no input of a block without a wire.*did you mean 'r_ref'"),
        ({}, {"inputs": ["f_hat"]}, "'f_hat' is a signal and an input of the diagram"),
        ({}, {"outputs": ["f_het"]}, "output 'f_het': no signal 'f_het'; did you mean 'f_hat'"),
        ({}, {"outputs": {"y": "body.rr"}}, "block 'body' has no output 'rr'; did you mean 'r'"),
    ],
)
def test_what_is_not_clear_is_refused_with_names(more, ends, message):
    given = {"inputs": ["r_ref", "d", "n"], "outputs": ["r", "f_hat"]} | ends
    with pytest.raises(ValueError, match=message):
        wired(blocks(), SIGNALS | more, **given)


@pytest.mark.parametrize("what", ["inputs", "outputs"])
def test_a_text_is_no_sequence_of_names(what):
    with pytest.raises(
        TypeError, match=f"{what}: expected a mapping or a sequence of names, got the text 'r_ref'"
    ):
        wired(blocks(), SIGNALS, **{"inputs": ["r_ref"], "outputs": ["r"]} | {what: "r_ref"})
