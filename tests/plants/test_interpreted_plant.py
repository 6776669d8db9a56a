"""Equations that stay Python, beside the same ones traced."""

import control as ct
import numpy as np
import pytest

import phyfilter_ctl as pf

STATES = {"angle": (0.3, "rad"), "v": ([0.0, 1.0], "m/s")}
INPUTS, PARAMS = {"torque": (0.0, "N m")}, {"k": (2.0, "1/s^2"), "J": np.diag([1.0, 2.0])}


def motion(t, x, u, p):
    sine = np.sin(x.angle)
    return (
        {"angle": x.v[0] * 1.0, "v": p.J @ x.v * -0.1 + u.torque},
        {"height": -sine, "load": p.k * u.torque},
    )


def with_a_loop(t, x, u, p):
    """The sine as a series, as long as it takes."""
    sine, term, n = 0.0, x.angle, 1
    while abs(term) > 1e-18:
        sine, term, n = sine + term, -term * x.angle**2 / ((n + 1) * (n + 2)), n + 2
    return {"angle": x.v[0], "v": -0.1 * (p.J @ x.v) + u.torque}, {"height": -sine, "load": p.k * u.torque}


def test_interpreted_plant_is_the_traced_one():
    traced = pf.plant(motion, states=STATES, inputs=INPUTS, params=PARAMS)
    python = pf.plant(with_a_loop, states=STATES, inputs=INPUTS, params=PARAMS, interpreted=True)
    x, u = [0.4, -0.2, 0.7], [1.5]
    for one, other in ((traced.dynamics, python.dynamics), (traced.output, python.output)):
        np.testing.assert_allclose(other(0.0, x, u), one(0.0, x, u), rtol=1e-12)
        np.testing.assert_allclose(other(0.0, x, u, {"k": 3.0}), one(0.0, x, u, {"k": 3.0}), rtol=1e-12)
    assert python.functions.feedthrough.tolist() == [[False], [True]]
    np.testing.assert_allclose(python.linearize(x, u).A, traced.linearize(x, u).A, atol=1e-6)
    times = np.linspace(0.0, 1.0, 5)
    ours = pf.simulate(python, times, 0.2, params={"k": 1.0})
    np.testing.assert_allclose(
        ours.outputs, pf.simulate(traced, times, 0.2, params={"k": 1.0}).outputs, atol=1e-9
    )
    assert list(ours.callbacks) == ["with_a_loop"]


def test_interpreted_plant_has_no_c_and_keeps_its_checks():
    python = pf.plant(with_a_loop, states=STATES, inputs=INPUTS, params=PARAMS, interpreted=True)
    with pytest.raises(ValueError, match=r"block with_a_loop runs as Python.*interpreted=True"):
        pf.simulate(python, [0.0, 1.0], backend="c")
    with pytest.raises(ValueError, match="no derivative of the state 'v'"):
        pf.plant(lambda t, x, u, p: {"angle": 0.0}, states=STATES, name="short", interpreted=True)


def test_lookup_tables_against_numpy_and_bilinear_by_hand():
    places, values = [0.0, 1.0, 3.0, 7.0], [2.0, -1.0, 0.5, 4.0]
    table = pf.lookup_table(places, values)
    for at in (-2.0, 0.0, 0.4, 1.0, 2.9, 7.0, 9.0):
        assert table.output(0.0, [], [at])[0] == pytest.approx(np.interp(at, places, values), abs=1e-14)
    line = pf.lookup_table(places, values, extrapolation="linear")
    assert line.output(0.0, [], [-2.0])[0] == pytest.approx(8.0)
    assert line.output(0.0, [], [9.0])[0] == pytest.approx(4.0 + 2.0 * 3.5 / 4.0)
    grid = np.array([[1.0, 2.0, 4.0], [0.0, -1.0, 3.0]])
    surface = pf.lookup_table([[0.0, 2.0], [10.0, 20.0, 40.0]], grid, inputs=["speed", "load"], name="map")
    a, b = 0.25, 0.6
    by_hand = (1 - a) * ((1 - b) * 2.0 + b * 4.0) + a * ((1 - b) * -1.0 + b * 3.0)
    assert surface.output(0.0, [], [0.5, 32.0])[0] == pytest.approx(by_hand, abs=1e-14)
    assert surface.output(0.0, [], [9.0, 0.0])[0] == 0.0
    assert surface.output(0.0, [], [0.0, 10.0], {"table[0,0]": 5.0})[0] == 5.0
    loop = ct.interconnect(
        [surface], inplist=["map.speed", "map.load"], outlist="map", inputs=["n", "m"], outputs="y"
    )
    assert pf.simulate(loop, [0.0, 1.0], [[0.5, 0.5], [32.0, 32.0]]).outputs[0] == pytest.approx(by_hand)


@pytest.mark.parametrize(
    ("breakpoints", "table", "message"),
    [
        ([0.0, 0.0], [1.0, 2.0], "breakpoints: expected two or more finite numbers that increase"),
        ([[0.0, 1.0], [1.0, np.nan]], np.ones((2, 2)), r"breakpoints\[1\]"),
        ([0.0, 1.0], [1.0, 2.0, 3.0], r"shape \(2,\), as the breakpoints are, got shape \(3,\)"),
    ],
)
def test_tables_that_are_none(breakpoints, table, message):
    with pytest.raises(ValueError, match=message):
        pf.lookup_table(breakpoints, table)
