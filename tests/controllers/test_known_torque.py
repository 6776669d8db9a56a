"""The known torque, and the attitude loop that makes up for a known and an estimated one."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from phyfilter_ctl import simulate
from phyfilter_ctl.blocks import SampledBlock, delay_line, wired
from phyfilter_ctl.controllers import AttitudeGains, Multirotor, attitude_controller
from phyfilter_ctl.controllers.known import known_torque
from phyfilter_ctl.plants import allocation_matrix, quadrotor

# N m: the rotors' model is exact at the instants, commands being held; Runge-Kutta at 2 ms is not quite.
EXACT = 1e-7
# N: rounding of a few sums.
ROUNDING = 1e-12

ARM, RATIO, LAG, MAX, DT = 0.25, 0.016, 0.04, 16.2, 0.002
J = np.array([0.035, 0.035, 0.06])
HOVER = 3.0 * 9.81 / 4.0


prior = partial(known_torque, J=J, arm=ARM, torque_ratio=RATIO, motor_lag=LAG, rotor_max=MAX, dt=DT)
vehicle = Multirotor(mass=3.0, J=J, arm=ARM, torque_ratio=RATIO, rotor_max=MAX, motor_lag=LAG)
attitude = partial(attitude_controller, vehicle, AttitudeGains((100.0, 4.0), (20.0, 4.0), 0.01), dt=DT)


def commanded(block: SampledBlock, inputs: list[float]) -> np.ndarray:
    assert block.law is not None
    values = [entry.start for entry in block.law.parameters]
    states = [entry.start for entry in block.law.states]
    return np.asarray(block.law.output(0.0, states, inputs, values)).ravel()


def test_known_torque_follows_the_vehicle_behind_lag_and_delay() -> None:
    steps = 5
    block = prior(start=HOVER, delay_steps=steps)
    line = delay_line([f"thrust[{i}]" for i in range(4)], steps, DT, name="line", start=HOVER)
    vehicle = quadrotor(
        mass=3.0, J=J, arm=ARM, torque_ratio=RATIO, motor_lag=LAG, rotor_max=MAX, name="vehicle"
    )
    diagram = wired(
        [block, line, vehicle],
        {"vehicle.thrust": "line.thrust_delayed", "prior_torque.omega": "vehicle.omega"},
        inputs={"thrust": ["line.thrust", "prior_torque.thrust"], "wind": "vehicle.wind"},
        outputs={"g": "prior_torque.g", "rotor": "vehicle.rotor", "omega": "vehicle.omega"},
    )
    time = DT * np.arange(200)
    commands = HOVER + np.random.default_rng(0).normal(0.0, 2.0, (4, len(time)))
    inputs = np.vstack([commands, np.zeros((3, len(time)))])
    run = simulate(diagram, time, inputs, method="rk4", max_step=DT, interpolation="hold", backend="vm")
    g, rotor, omega = run.outputs[:3].T, run.outputs[3:7], run.outputs[7:10].T
    tau = (allocation_matrix(ARM, RATIO)[1:] @ rotor).T
    np.testing.assert_allclose(g, tau - np.cross(omega, J * omega), rtol=0.0, atol=EXACT)
    assert np.ptp(tau) > 0.1  # something to follow


def test_known_torque_adds_the_trim() -> None:
    block = prior(trim=[0.1, -0.2, 0.3], start=5.0)
    np.testing.assert_allclose(
        commanded(block, [5.0] * 4 + [0.0] * 3), [0.1, -0.2, 0.3], rtol=0.0, atol=ROUNDING
    )


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: prior(J=[1.0, 0.0, 1.0]), "J: expected three positive"),
        (lambda: prior(motor_lag=0.0), "motor_lag: expected a finite number > 0"),
        (lambda: prior(trim=[0.0, 1.0]), "trim: expected shape"),
        (lambda: prior(start=[1.0, 2.0]), "start: expected a number or shape"),
        (lambda: prior(delay_steps=-1), "delay_steps: expected at least 0"),
    ],
)
def test_known_torque_refuses(make: Callable[[], object], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        make()


def test_known_torque_takes_whole_samples_only() -> None:
    steps: int = 1.5  # pyright: ignore[reportAssignmentType] - wrong on purpose
    with pytest.raises(TypeError, match="delay_steps: expected a whole number"):
        prior(delay_steps=steps)


def test_rotors_make_up_trim_at_once_and_an_estimate_behind_the_lead() -> None:
    """Trim does not pass the lead, so that nothing moves at the start; the estimate is led four times at once."""
    level = [0.0, 0.0, 4.0 * HOVER, 1.0, *[0.0] * 9]
    torque = np.array([0.05, 0.2, 0.01])
    A = allocation_matrix(ARM, RATIO)
    trimmed = A @ commanded(attitude(trim=torque), level)
    np.testing.assert_allclose(trimmed, [4.0 * HOVER, *-torque], rtol=0.0, atol=ROUNDING)
    small = 0.1 * torque
    estimated = A @ commanded(attitude(torque_estimate=True), [*level, *small])
    np.testing.assert_allclose(estimated, [4.0 * HOVER, *(-LAG / 0.01 * small)], rtol=0.0, atol=ROUNDING)


def test_without_them_the_law_is_the_one_that_it_was() -> None:
    plain, both = attitude(), attitude(trim=[0.0, 0.0, 0.0], torque_estimate=True)
    rng = np.random.default_rng(1)
    for _ in range(20):
        q = rng.normal(size=4)
        inputs = [*rng.normal(0.0, 5.0, 2), 30.0, *(q / np.linalg.norm(q)), *rng.normal(size=6)]
        np.testing.assert_array_equal(commanded(plain, inputs), commanded(both, [*inputs, 0.0, 0.0, 0.0]))
    assert plain.law is not None
    assert "trim" not in {entry.name.split("[")[0] for entry in plain.law.parameters}


def test_trim_of_another_shape_is_refused() -> None:
    with pytest.raises(ValueError, match="trim: expected shape"):
        attitude(trim=[0.0, 1.0])
