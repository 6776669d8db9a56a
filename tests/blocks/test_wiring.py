"""Wiring by vectors gives the diagram that ``control.interconnect`` gives entry by entry, and refuses what is wrong."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest

from phyfilter_ctl.blocks import wired
from phyfilter_ctl.diagram import flatten
from phyfilter_ctl.plants import mass

ROUND_OFF = 1e-14  # the same functions, wired twice


def lag(name: str) -> ct.StateSpace:
    return ct.ss(
        -np.eye(2),
        np.eye(2),
        np.eye(2),
        np.zeros((2, 2)),
        inputs=["u[0]", "u[1]"],
        outputs=["y[0]", "y[1]"],
        name=name,
    )


def test_is_the_diagram_of_interconnect() -> None:
    body, filter = mass(2, drag=0.3, name="body"), lag("filter")
    ours = wired(
        [body, filter], {"body.force": "filter.y"}, inputs={"f": "filter.u"}, outputs={"r": "body.r"}
    )
    theirs = ct.interconnect(
        [body, filter],
        connections=[["body.force[0]", "filter.y[0]"], ["body.force[1]", "filter.y[1]"]],
        inplist=["filter.u[0]", "filter.u[1]"],
        outlist=["body.r[0]", "body.r[1]"],
        check_unused=False,
    )
    x, u = np.array([0.1, 0.2, 0.3, -0.4, 0.5, 0.6]), np.array([1.0, -2.0])
    np.testing.assert_allclose(
        flatten(ours).linearize(x, u).A, flatten(theirs).linearize(x, u).A, atol=ROUND_OFF
    )
    assert ours.input_labels == ["f[0]", "f[1]"]


def test_one_input_drives_several() -> None:
    both = wired([lag("a"), lag("b")], {}, inputs={"u": ["a.u", "b.u"]}, outputs={"y": "a.y", "z": "b.y"})
    gain = np.asarray(flatten(both).linearize()(0.0))
    np.testing.assert_allclose(np.abs(gain), np.vstack([np.eye(2), np.eye(2)]), atol=ROUND_OFF)


@pytest.mark.parametrize(
    ("wires", "inputs", "message"),
    [
        ({"body.force": "fliter.y"}, {}, "no block 'fliter'; did you mean 'filter'"),
        ({"body.forse": "filter.y"}, {}, "no input 'forse'; did you mean 'force'"),
        ({"body.force": "filter.y"}, {"f": "body.force"}, "driven twice"),
        ({"one.force": "filter.y"}, {}, "1 entries, but filter.y has 2"),
        ({}, {"f": ["one.force", "body.force"]}, "targets of one length"),
    ],
)
def test_refuses(wires: dict[str, str], inputs: dict[str, str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        wired([mass(2, name="body"), mass(1, name="one"), lag("filter")], wires, inputs=inputs)


def test_refuses_equal_names() -> None:
    with pytest.raises(ValueError, match="different names"):
        wired([lag("a"), lag("a")], {})
