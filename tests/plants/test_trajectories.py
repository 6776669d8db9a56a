"""Reference trajectories: each signal is the derivative of the one before, and the path is the one asked for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import control as ct
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl.blocks import wired
from phyfilter_ctl.plants import Plant, circle, lemniscate, mass, trajectory, waypoints

TIMES = [0.5, 2.0, 2.5, 4.5]
POINTS = np.array([[0.0, 1.0, 0.5], [1.0, 1.0, 1.5], [1.0, 1.0, 1.5], [-1.0, 0.0, 1.0]])


def spiral(t: Any, p: Any) -> list[Any]:
    return [p.pace * t * np.cos(t), p.pace * t * np.sin(t), 0.5]


REFERENCES = {
    "circle": circle(radius=2.0, speed=-1.5, height=0.7, ramp=2.0),
    "lemniscate": lemniscate(length=4.0, width=1.0, period=5.0, ramp=1.0),
    "waypoints": waypoints(TIMES, POINTS),
    "trajectory": trajectory(spiral, params={"pace": (0.3, "m/s")}),
}
# Of a central difference with steps of 1 ms: h^2/6 of a fifth derivative, of some thousand where the path turns fast.
H, DIFFERENCE = 1e-3, 2e-3


def at(block: Plant, t: float, **params: Any) -> np.ndarray:
    """r, v, a and j, (4, 3)."""
    return np.asarray(block.output(t, [], [], params=params)).reshape(4, 3)


@pytest.mark.parametrize("name", REFERENCES)
def test_each_signal_is_the_derivative_of_the_one_before(name: str) -> None:
    block = REFERENCES[name]
    assert block.output_labels[::3] == ["r_ref[0]", "v_ref[0]", "a_ref[0]", "j_ref[0]"]
    for t in np.linspace(-0.3, 6.0, 80):
        slope = (at(block, t + H) - at(block, t - H)) / (2.0 * H)
        np.testing.assert_allclose(at(block, t)[1:], slope[:3], atol=DIFFERENCE)


@pytest.mark.parametrize("name", ["circle", "lemniscate", "waypoints"])
def test_it_begins_at_rest_and_jerk_does_not_jump(name: str) -> None:
    block = REFERENCES[name]
    for t in (-1.0, 0.0):
        np.testing.assert_allclose(at(block, t)[1:], 0.0, atol=1e-12)
    for t in (0.0, 1.0, *TIMES):  # where pieces meet
        around = [at(block, t + shift) for shift in (-1e-9, 0.0, 1e-9)]
        np.testing.assert_allclose(around[0], around[1], atol=1e-5)
        np.testing.assert_allclose(around[2], around[1], atol=1e-5)
    functions = block.functions
    assert not {ca.OP_LT, ca.OP_LE, ca.OP_IF_ELSE_ZERO} & {
        functions.output.instruction_id(i) for i in range(functions.output.n_instructions())
    }


def test_rounds_have_the_size_and_the_speed_asked_for() -> None:
    r, v, a, _ = at(REFERENCES["circle"], 11.0)
    np.testing.assert_allclose([np.hypot(*r[:2]), r[2], np.hypot(*v[:2])], [2.0, 0.7, 1.5])
    np.testing.assert_allclose(a[:2], -(1.5**2) / 2.0**2 * r[:2], atol=1e-12)
    assert r[0] * v[1] - r[1] * v[0] == pytest.approx(-2.0 * 1.5)
    assert np.linalg.norm(at(REFERENCES["circle"], 11.0, speed=3.0)[1]) == pytest.approx(3.0)
    eight = np.array([at(REFERENCES["lemniscate"], t)[0] for t in np.linspace(5.0, 10.0, 2001)])
    np.testing.assert_allclose(np.ptp(eight, axis=0), [4.0, 1.0, 0.0], atol=1e-4)
    np.testing.assert_allclose(eight[0], eight[-1], atol=1e-9)


def test_waypoints_are_met_at_rest() -> None:
    block = REFERENCES["waypoints"]
    for t, point in zip(TIMES, POINTS, strict=True):
        np.testing.assert_allclose(at(block, t), [point, [0.0] * 3, [0.0] * 3, [0.0] * 3], atol=1e-12)
    np.testing.assert_allclose(at(block, 99.0)[0], POINTS[-1], atol=1e-12)
    np.testing.assert_allclose(at(block, 2.25)[0], POINTS[1], atol=1e-12)
    np.testing.assert_allclose(at(block, 99.0, points=2.0 * POINTS)[0], 2.0 * POINTS[-1], atol=1e-12)
    np.testing.assert_allclose(at(waypoints([0.0], [[1.0, 2.0, 3.0]]), 5.0)[0], [1.0, 2.0, 3.0])


def test_a_point_mass_follows_one_in_a_diagram() -> None:
    """Driven by the acceleration alone, from the right start."""
    reference, body = REFERENCES["waypoints"], mass(3, name="body")
    loop = wired(
        [reference, body],
        {"body.force": "reference.a_ref"},
        outputs={"r": "body.r", "r_ref": "reference.r_ref"},
    )
    t = np.linspace(0.0, 5.0, 501)
    run = pf.simulate(loop, t, initial_state={"body.r": POINTS[0]}, params={"mass": 1.0, "drag": 0.0})
    np.testing.assert_allclose(run.outputs["r"], run.outputs["r_ref"], atol=1e-6)
    assert isinstance(loop, ct.InterconnectedSystem)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: circle(radius=0.0), "radius: expected a finite number > 0 m"),
        (lambda: circle(ramp=0.0), "ramp: expected a finite number > 0 s"),
        (lambda: circle(speed=np.nan), "speed: expected a finite number"),
        (lambda: lemniscate(period=0.0), "period: expected the time of one figure"),
        (lambda: lemniscate(ramp=-1.0), "ramp: expected a finite number > 0 s"),
        (lambda: waypoints([1.0, 1.0], POINTS[:2]), "times: expected one increasing time"),
        (lambda: waypoints([], []), "times: expected"),
        (lambda: waypoints(TIMES, POINTS[:2]), r"points: expected shape \(4, 3\)"),
        (lambda: trajectory(lambda t, p: [float(t)]), "lost its symbols and became NaN"),
        (lambda: trajectory(lambda t, p: [p.siez]), "siez"),
    ],
)
def test_what_cannot_be_is_named(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()
