"""The linear model from instant to instant: closed forms, simulated perturbations, the margin of a filter's loop."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.analysis.margins import prior_margin
from phyfilter_ctl.blocks import sampled_block, wired
from phyfilter_ctl.plants import mass, plant
from phyfilter_ctl.simulation import linearize_sampled, sampled_open_loop, simulate

PERIOD = 0.002
ROUND_OFF = 1e-9  # poles of matrices of order 10 with repeated poles aside
CURVATURE = 5e-6  # of perturbations of 1e-5 over 50 periods, relative to them


def filter_loop(pole: float, ratio: float) -> ct.InterconnectedSystem:
    """M x' = -f_hat + f, the filter's inertia being ``ratio`` times the true one."""
    filter = sampled_block(PhyFilter([pole]).sampled(PERIOD), 1, inertia=ratio, name="filter")
    body = mass(1, name="body")

    def negated(t, x, u, p):
        return {}, {"u": u.wanted - u.f_hat}

    command = plant(
        negated, name="command", states={}, inputs={"f_hat": [0.0], "wanted": [0.0]}, outputs={"u": "N"}
    )
    zero = plant(lambda t, x, u, p: ({}, {"zero": [0.0]}), name="none", states={}, outputs={"zero": "N"})
    return wired(
        [body, filter, command, zero],
        {
            "filter.x": "body.v",
            "filter.g": "command.u",
            "filter.f_theta": "none.zero",
            "command.f_hat": "filter.f_hat",
            "body.force": "command.u",
        },
        inputs={"wanted": "command.wanted"},
        outputs={"v": "body.v"},
    )


def pendulum(weight: float = 0.0) -> ct.InterconnectedSystem:
    def swing(t, x, u, p):
        return {"angle": x.rate, "rate": u.torque - 9.81 * np.sin(x.angle)}

    def law(t, x, u, p):
        return {"sum": x.sum + PERIOD * (0.5 - u.angle)}, {
            "torque": 20.0 * (u.wanted - u.angle) - 3.0 * u.rate + 5.0 * x.sum
        }

    body = plant(swing, name="body", states={"angle": 0.5, "rate": 0.0}, inputs={"torque": 0.0})
    control = sampled_block(
        plant(
            law,
            name="law",
            states={"sum": weight},
            inputs={"angle": 0.0, "rate": 0.0, "wanted": 0.5},
            dt=PERIOD,
        ),
        name="law",
    )
    wires = {"body.torque": "law.torque", "law.angle": "body.angle", "law.rate": "body.rate"}
    return wired([body, control], wires, inputs={"wanted": "law.wanted"}, outputs={"angle": "body.angle"})


def test_held_gain_on_an_integrator() -> None:
    """x' = -k x_k held: the next x is (1 - k h) x."""
    gain = sampled_block(
        ct.ss([], [], [], [[300.0, -300.0]], dt=PERIOD, inputs=["r", "y"], outputs="u", name="gain")
    )
    body = ct.tf([1.0], [1.0, 0.0], inputs="u", outputs="y", name="body")
    wires = {"body.u": "gain.u", "gain.y": "body.y"}
    loop = wired([gain, body], wires, inputs={"r": "gain.r"}, outputs={"y": "body.y"})
    poles = np.sort(linearize_sampled(loop).poles().real)
    np.testing.assert_allclose(poles, [0.0, 1.0 - 300.0 * PERIOD], atol=ROUND_OFF)


def test_predicts_small_perturbations() -> None:
    steps, small = 50, 1e-5
    diagram = pendulum(9.81 * np.sin(0.5) / 5.0)  # at rest: its integral holds the weight
    times = PERIOD * np.arange(steps + 1)
    linear = linearize_sampled(diagram)
    A, C = np.asarray(linear.A), np.asarray(linear.C)
    rest = {"angle": 0.5, "rate": 0.0}
    for k, name in enumerate(rest):
        runs = [
            simulate(
                diagram, times, None, rest | {name: rest[name] + d}, method="rk4", max_step=PERIOD
            ).outputs
            for d in (0.0, small)
        ]
        state = np.zeros(len(A))
        state[k] = 1.0
        predicted = [float(C[0] @ np.linalg.matrix_power(A, i) @ state) for i in range(steps + 1)]
        np.testing.assert_allclose((runs[1] - runs[0]).ravel() / small, predicted, atol=CURVATURE)


def test_matches_the_margin_of_a_filters_loop() -> None:
    """n = 1 at w h = 0.04: unstable beyond M_hat/M = 51.007, by the formula and by the period's map."""
    pole = 0.04 / PERIOD
    limit = prior_margin(PhyFilter([pole]).sampled(PERIOD)).max_ratio
    for ratio, stable in ((0.999 * limit, True), (1.001 * limit, False)):
        poles = linearize_sampled(filter_loop(pole, ratio), settle=0.01).poles()
        assert (np.abs(poles).max() < 1.0 + ROUND_OFF) == stable
    loop = sampled_open_loop(filter_loop(pole, limit), "command.u", settle=0.01)
    assert np.abs(1.0 + loop(np.exp(1j * np.linspace(0.001, np.pi, 4000)))).min() < 1e-3  # passes through -1


def test_substeps_converge() -> None:
    """The Runge-Kutta map of x' = -100 x over 2 ms comes to exp(-0.2)."""
    lag = ct.tf([100.0], [1.0, 100.0], inputs="u", outputs="y", name="lag")
    hold = sampled_block(
        ct.ss([], [], [], [[1.0, 0.0]], dt=PERIOD, inputs=["r", "y"], outputs="u", name="hold")
    )
    wires = {"lag.u": "hold.u", "hold.y": "lag.y"}
    loop = wired([lag, hold], wires, inputs={"r": "hold.r"}, outputs={"y": "lag.y"})
    errors = [
        abs(np.abs(linearize_sampled(loop, substeps=n).poles()).max() - np.exp(-100.0 * PERIOD))
        for n in (1, 2)
    ]
    assert 12.0 < errors[0] / errors[1] < 20.0  # fourth order


def test_refuses_what_has_no_period_or_several() -> None:
    with pytest.raises(ValueError, match="no sampled blocks"):
        linearize_sampled(ct.tf([1.0], [1.0, 1.0], name="lag"))
    two = [
        sampled_block(ct.ss([], [], [], [[1.0]], dt=dt, inputs="u", outputs="y", name=name))
        for dt, name in ((0.1, "slow"), (0.05, "fast"))
    ]
    both = wired([*two, ct.tf([1.0], [1.0, 1.0], inputs="u", outputs="y", name="lag")],
                 {"lag.u": "slow.y", "slow.u": "fast.y", "fast.u": "lag.y"}, outputs={"y": "lag.y"})  # fmt: skip
    with pytest.raises(ValueError, match="several periods"):
        linearize_sampled(both)
    with pytest.raises(ValueError, match="substeps"):
        linearize_sampled(pendulum(), substeps=0)
