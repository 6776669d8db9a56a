"""A multirotor's numbers given once: the blocks of the separate factories, to the last digit."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import FrozenInstanceError, fields, replace
from typing import Any

import numpy as np
import pytest

from phyfilter_ctl.blocks import SampledBlock, delay_line
from phyfilter_ctl.controllers import (
    AttitudeGains,
    Multirotor,
    attitude_controller,
)
from phyfilter_ctl.controllers.attitude import attitude_gains
from phyfilter_ctl.controllers.known import known_force, known_torque
from phyfilter_ctl.controllers.tracking import position_controller
from phyfilter_ctl.plants import Plant, quadrotor

H = 0.004
BODY: dict[str, Any] = {"mass": 1.7, "J": (0.011, 0.013, 0.021), "arm": 0.21, "torque_ratio": 0.013}
ROTORS: dict[str, Any] = {"motor_lag": 0.03, "rotor_max": 9.5}
FLIES: dict[str, Any] = BODY | ROTORS | {"drag": (0.4, 0.5, 0.3), "gravity": 9.8}
DRONE = Multirotor(**FLIES, delay=0.012, added_mass=0.2, name="drone")
GAINS = attitude_gains(motor_lag=0.03, delay=0.012 + 0.5 * H)
OUTER: dict[str, Any] = {"kp": (4.0, 6.0), "kd": (3.6, 5.0), "ki": (0.5, 0.6)}
FORCE: dict[str, Any] = {name: FLIES[name] for name in ("mass", "drag", "gravity")}


def equations(block: Plant | SampledBlock) -> list[np.ndarray]:
    """Variables with their starts, and what the equations give at random points."""
    law = block.functions if isinstance(block, Plant) else block.law
    assert law is not None
    groups = [law.states, law.inputs, law.parameters]
    rng, found = np.random.default_rng(0), []
    for _ in range(5):
        at = [np.array([v.start for v in group]) for group in groups]
        at[:2] = [values + 0.1 * rng.standard_normal(values.size) for values in at[:2]]
        found += [np.array(f(0.3, *at)).ravel() for f in (law.dynamics, law.output)]
    return [*found, *(np.array([v.start for v in group]) for group in groups)]


@pytest.mark.parametrize(
    ("ours", "separate"),
    [
        (lambda: DRONE.plant(), lambda: quadrotor(**FLIES, added_mass=0.2, name="drone")),
        (
            lambda: DRONE.attitude(H),
            lambda: attitude_controller(replace(DRONE, added_mass=0.0), GAINS, dt=H),
        ),
        (
            lambda: DRONE.attitude(H, trim=[0.1, 0.0, 0.2], torque_estimate=True, yaw=0.3, thrust_lead=0.05),
            lambda: attitude_controller(
                DRONE, GAINS, trim=[0.1, 0.0, 0.2], torque_estimate=True, yaw=0.3, thrust_lead=0.05, dt=H
            ),
        ),
        (
            lambda: DRONE.position(H, **OUTER, drag_lead=0.07),
            lambda: position_controller(**FORCE, **OUTER, drag_lead=0.07, dt=H),
        ),
        (
            lambda: DRONE.position(H, **OUTER),
            lambda: position_controller(**FORCE, **OUTER, drag_lead=GAINS.kw[0] / GAINS.kR[0], dt=H),
        ),
        (
            lambda: DRONE.known_force(H),
            lambda: known_force(**FORCE, **ROTORS, delay_steps=3, dt=H),
        ),
        (
            lambda: DRONE.known_force(H, kind="commanded"),
            lambda: known_force(**FORCE, **ROTORS, delay_steps=3, kind="commanded", dt=H),
        ),
        (
            lambda: DRONE.known_torque(H, trim=[0.1, 0.0, 0.2]),
            lambda: known_torque(
                **{k: v for k, v in (BODY | ROTORS).items() if k != "mass"},
                trim=[0.1, 0.0, 0.2],
                start=0.25 * 1.7 * 9.8,
                delay_steps=3,
                dt=H,
            ),
        ),
        (
            lambda: DRONE.thrust_delay(H),
            lambda: delay_line([f"thrust[{i}]" for i in range(4)], 3, H, start=0.25 * 1.7 * 9.8, unit="N"),
        ),
    ],
)
def test_it_makes_what_the_separate_factories_make(
    ours: Callable[[], Any], separate: Callable[[], Any]
) -> None:
    one, other = ours(), separate()
    assert (one.input_labels, one.output_labels) == (other.input_labels, other.output_labels)
    for found, expected in zip(equations(one), equations(other), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_the_hold_of_a_sample_is_counted_once() -> None:
    assert DRONE.gains(H) == GAINS
    law = DRONE.attitude(H).law
    assert law is not None
    assert {p.name: p.start for p in law.parameters}["thrust_lead"] == 0.03 + 0.012 + 0.5 * H
    assert [DRONE.delay_steps(dt) for dt in (0.001, 0.004, 0.005, 0.1)] == [12, 3, 2, 0]


def test_its_defaults_are_the_quadrotors() -> None:
    usual = {name: p.default for name, p in inspect.signature(quadrotor).parameters.items()}
    ours = {field.name: field.default for field in fields(Multirotor)}
    assert ours.pop("delay") == 0.0
    assert ours == usual
    assert len(ours) < 12


def test_it_is_a_value() -> None:
    given = np.array([0.011, 0.013, 0.021])
    drone = replace(DRONE, J=given)
    given[:] = 1.0
    assert drone == DRONE
    assert hash(drone) == hash(DRONE)
    assert Multirotor(drag=0.5).drag == (0.5, 0.5, 0.5)
    with pytest.raises(FrozenInstanceError):
        drone.mass = 2.0  # type: ignore[misc]  # what is tested


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mass": 0.0}, "mass: expected a finite number > 0 kg"),
        ({"J": [1.0, 0.0, 1.0]}, "J: expected three positive"),
        ({"J": [1.0, 1.0]}, r"J: expected shape \(3,\)"),
        ({"arm": -1.0}, "arm: expected a finite number > 0 m"),
        ({"drag": [1.0, -1.0, 0.0]}, "drag: expected"),
        ({"delay": -0.01}, "delay: expected a finite number >= 0 s"),
        ({"motor_lag": np.nan}, "motor_lag: expected a finite number >= 0 s"),
        ({"added_mass": -4.0}, "added_mass: expected more than -3 kg"),
        ({"added_mass": 5.0}, "rotor_max: expected at least"),
        ({"gravity": np.inf}, "gravity: expected a finite number"),
    ],
)
def test_bad_numbers_are_named(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Multirotor(**changes)


def test_bad_periods_are_named() -> None:
    for make in (DRONE.delay_steps, DRONE.attitude, DRONE.known_force, DRONE.thrust_delay):
        with pytest.raises(ValueError, match="dt: expected a finite number > 0"):
            make(0.0)
    assert isinstance(DRONE.gains(H, sharpness=2.0), AttitudeGains)
