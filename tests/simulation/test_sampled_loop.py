"""The linear model from instant to instant: closed forms, simulated perturbations, the margin of a filter's loop."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest
from scipy.linalg import expm

from phyfilter_ctl import Loop, PhyFilter, flatten, linearize_sampled, margins, sampled_open_loop
from phyfilter_ctl.analysis import SystemMargins
from phyfilter_ctl.blocks import sampled_block, wired
from phyfilter_ctl.diagram.opening import open_loop
from phyfilter_ctl.plants import mass, plant
from phyfilter_ctl.simulation import simulate

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


LAG, KP, KD = 0.1, 10.0, 6.0
# f, x, p alone, and what the law adds to them.
FREE_DRIFT = np.array([[-1.0 / LAG, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
LAW_DRIFT = np.array([[0.0, -KD / LAG, -KP / LAG], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])


def position_loop(filter: PhyFilter, h: float, *, law_sampled: bool, **options) -> ct.InterconnectedSystem:
    """Force lag, velocity x, position p; tau = -kp p - kd x - f_hat, by a continuous law or a sampled one."""
    law = ct.ss([], [], [], [[-KP, -KD, -1.0]], h if law_sampled else 0,
                inputs=["p", "x", "f_hat"], outputs="tau", name="law")  # fmt: skip
    parts = [
        ct.tf([1.0], [LAG, 1.0], inputs="tau", outputs="f", name="act"),
        ct.tf([1.0], [1.0, 0.0], inputs="f", outputs="x", name="mass"),
        ct.tf([1.0], [1.0, 0.0], inputs="x", outputs="p", name="position"),
        sampled_block(filter.sampled(h, **options), 1, name="filter"),
        sampled_block(law) if law_sampled else law,
    ]
    wires = {
        "act.tau": "law.tau", "mass.f": "act.f", "position.x": "mass.x", "filter.x": "mass.x",
        "filter.g": "law.tau", "law.p": "position.p", "law.x": "mass.x", "law.f_hat": "filter.f_hat",
    }  # fmt: skip
    return wired(parts, wires, inputs={"f_theta": "filter.f_theta"}, outputs={"x": "mass.x"}, name="loop")


def flow_by_hand(h: float, factor: complex = 1.0) -> np.ndarray:
    """f, x, p and the rest of the command a period later, the actuator's input times a factor."""
    held = factor * np.eye(3, 1) / LAG
    return expm(h * np.block([[FREE_DRIFT + factor * LAW_DRIFT, held], [np.zeros((1, 4))]]))


def rows_by_hand(filter: PhyFilter, h: float, flow: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same with the continuous law from instant to instant: closed-loop matrix, and tau.

    States f, x, p, those of 1/D in companion form, x and tau of the instant before.
    """
    n = filter.order
    A, B = np.diag(np.ones(n - 1), 1), np.eye(n)[:, -1:]
    A[-1] = -filter.a
    companion = expm(h * np.block([[A, B], [np.zeros((1, n + 1))]]))
    Ad, Bd = companion[:n, :n], companion[:n, n:]

    unit = np.eye(5 + n)
    f_x_p, w, before = unit[:3], unit[3 : 3 + n], unit[3 + n :]
    w = Ad @ w + Bd * ((f_x_p[1] - before[0]) / h - before[1])  # u = (x_k - x_{k-1})/h - g_{k-1}
    f_hat = filter.b @ w
    tau = -KP * f_x_p[2] - KD * f_x_p[1] - f_hat
    return np.vstack([flow[:3, :3] @ f_x_p - flow[:3, 3:] * f_hat, w, f_x_p[1], tau]), tau


def by_hand(filter: PhyFilter, h: float) -> tuple[np.ndarray, ct.StateSpace]:
    """Closed-loop matrix, and L at the actuator."""
    flow = flow_by_hand(h)
    closed, tau = rows_by_hand(filter, h, flow)
    # What is added to tau in front of the actuator, d, makes tau = T d before it; L = -T/(1 + T).
    added = np.vstack([flow[:3, 3:], np.zeros((filter.order + 2, 1))])
    return closed, ct.ss(closed - added * tau, added, -tau[None], 0.0, h, remove_useless_states=False)


@pytest.mark.parametrize(
    ("poles", "h", "options"),
    [
        ([-120.0], 0.02, {}),
        ([-20.0], 0.002, {}),
        ([-20.0], 0.02, {"nonfinite": "hold"}),
        ([-30.0, -45.0], 0.02, {}),
        ([-30.0, -45.0], 0.002, {"limit": 5.0}),
        ([-8.0, -9.0 + 7.0j, -9.0 - 7.0j], 0.01, {}),
    ],
)
def test_the_sampled_filter_acts_by_default(
    poles: list[complex], h: float, options: dict[str, str | float]
) -> None:
    """At its first instant f_hat = f_theta: the model is of the instants after that, whatever there is to settle."""
    filter = PhyFilter.from_poles(poles)
    closed, L = by_hand(filter, h)
    moving = 3 + filter.order  # x and tau of the instant before add poles at 0
    expected = np.sort(np.abs(np.linalg.eigvals(closed)))[-moving:]
    diagram = position_loop(filter, h, law_sampled=False, **options)
    flat = flatten(diagram)
    for settle in (0.0, 0.4 * h, h):
        found = np.sort(np.abs(linearize_sampled(flat, settle=settle).poles()))
        np.testing.assert_allclose(found[-moving:], expected, rtol=ROUND_OFF)
    z = np.exp(1j * h * np.array([1.0, 10.0, 60.0]))
    np.testing.assert_allclose(sampled_open_loop(diagram, "act.tau")(z), L(z), rtol=1e-8)


def test_a_slow_growth_is_the_one_that_a_run_shows() -> None:
    """120 rad/s every 20 ms: |L| = 3.60 at 10 rad/s and poles of 1.0017, which a simulated loop grows by."""
    h, steps = 0.02, 400
    diagram = position_loop(PhyFilter([120.0]), h, law_sampled=False)
    assert abs(sampled_open_loop(diagram, "act.tau")(np.exp(10j * h))) == pytest.approx(3.60, abs=0.005)
    radius = np.abs(linearize_sampled(diagram).poles()).max()
    assert radius == pytest.approx(1.0017, abs=5e-5)
    times = h * np.arange(2 * steps + 3)
    y = simulate(diagram, times, None, {"position.x[0]": 1.0}, method="exact").outputs.ravel()
    # One pair r exp(+-j a) left: y_k y_{k+2} - y_{k+1}^2 grows by r^2 a step.
    growth = y[:-2] * y[2:] - y[1:-1] ** 2
    assert (growth[2 * steps] / growth[steps]) ** (0.5 / steps) == pytest.approx(radius, rel=ROUND_OFF)


@pytest.mark.parametrize("settle", [-0.01, np.nan, np.inf])
def test_refuses_a_time_to_settle_that_is_none(settle: float) -> None:
    with pytest.raises(ValueError, match="settle: expected 0 or more seconds"):
        linearize_sampled(pendulum(), settle=settle)


def test_inputs_are_held_while_it_settles() -> None:
    """y' = u - y^3, u = r - y held: at rest at y = 1 for r = 2, where y' = u - 3 y."""
    h = 0.1
    body = plant(lambda t, x, u, p: {"y": u.u - x.y**3}, name="body", states={"y": 0.0}, inputs={"u": 0.0})
    gain = sampled_block(ct.ss([], [], [], [[1.0, -1.0]], h, inputs=["r", "y"], outputs="u", name="gain"))
    wires = {"body.u": "gain.u", "gain.y": "body.y"}
    loop = wired([body, gain], wires, inputs={"r": "gain.r"}, outputs={"y": "body.y"})
    poles = linearize_sampled(loop, u0=[2.0], settle=20.0).poles()
    q = np.exp(-3.0 * h)
    assert np.sort(poles.real) == pytest.approx([0.0, q - (1.0 - q) / 3.0], abs=1e-8)
    with pytest.raises(ValueError, match=r"u0: expected shape \(1,\) for r"):
        linearize_sampled(loop, u0=[1.0, 2.0])


# -- margins at a signal -------------------------------------------------------------------------------------------


def test_margins_of_a_sampled_loop() -> None:
    """Those that the loop of the filter has by its own equations."""
    h, filter = 0.02, PhyFilter([20.0])
    own = margins(filter.sampled(h), Loop(KP, KD, actuator=LAG))
    margin = margins(position_loop(filter, h, law_sampled=True), at="act.tau")
    assert margin.is_stable
    assert margin.gain_margin == pytest.approx(own.gain_margin, rel=1e-6)
    assert margin.phase_margin == pytest.approx(own.phase_margin, rel=1e-6)
    assert margin.modulus_margin == pytest.approx(own.modulus_margin, rel=1e-6)
    assert margin.delay_margin == pytest.approx(own.delay_margin, rel=3e-6)  # both halve down to 1e-6
    assert margin.delay_frequency == pytest.approx(own.delay_frequency, rel=1e-4)
    assert margin.disk.alpha == pytest.approx(own.disk.alpha, rel=1e-6)


def test_an_unstable_sampled_loop_has_no_margin() -> None:
    """Its continuous equivalents are stable, with 6.5 degrees of phase and 3.2 ms of delay to spare."""
    h, filter, lag = 0.02, PhyFilter([120.0]), ct.tf([1.0], [LAG, 1.0])
    own = margins(filter, Loop(KP, KD, actuator=lag))
    equivalent = open_loop(position_loop(filter, h, law_sampled=True), "act.tau")
    for continuous in (own, SystemMargins("act.tau", equivalent)):
        assert continuous.is_stable
        assert np.rad2deg(continuous.phase_margin) == pytest.approx(6.5, abs=0.05)
        assert continuous.delay_margin == pytest.approx(3.2e-3, abs=5e-5)
    for law_sampled, signal in ((True, "act.tau"), (False, "law.f_hat"), (False, "filter.x[0]")):
        margin = margins(position_loop(filter, h, law_sampled=law_sampled), at=signal)
        assert (margin.is_stable, margin.phase_margin, margin.delay_margin) == (False, 0.0, 0.0)


def test_a_signal_that_acts_between_the_instants_has_the_margins_that_can_be_told() -> None:
    """The continuous law's command: gain and phase act in the continuous part too; no L, so no delay and no disk."""
    h = 0.02
    diagram = position_loop(PhyFilter([20.0]), h, law_sampled=False)
    margin = margins(diagram, at="act.tau")
    for share, stable in ((0.999, True), (1.001, False)):
        for factor in (share * margin.gain_margin[1], np.exp(1j * share * margin.phase_margin)):
            closed, _ = rows_by_hand(PhyFilter([20.0]), h, flow_by_hand(h, factor))
            assert (np.abs(np.linalg.eigvals(closed)).max() < 1.0) == stable
    assert np.isnan([margin.delay_margin, margin.modulus_margin, *margin.disk.gain_margin]).all()
    assert "nan" not in margin.describe()
    assert "open the loop where filter reads or puts out" in margin.describe()
    assert not margins(position_loop(PhyFilter([120.0]), h, law_sampled=False), at="act.tau").is_stable


def test_bad_input_of_margins() -> None:
    diagram = position_loop(PhyFilter([120.0]), 0.02, law_sampled=False)
    with pytest.raises(ValueError, match=r"starts at 0, got 1\.0"):
        margins(diagram, at="law.f_hat", t=1.0)
    with pytest.raises(ValueError, match="one or several different signals"):
        margins(diagram, at=["law.f_hat", "law.f_hat"])
    lag = ct.tf([1.0], [1.0, 1.0], inputs="u", outputs="y", name="lag")
    continuous = ct.interconnect([lag], [["lag.u", "-lag.y"]], "lag.u", "lag.y", inputs="u", outputs="y")
    with pytest.raises(ValueError, match="no sampled blocks"):
        margins(continuous, at="lag.u", settle=1.0)


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
    limit = margins(PhyFilter([pole]).sampled(PERIOD)).max_ratio
    for ratio, stable in ((0.999 * limit, True), (1.001 * limit, False)):
        poles = linearize_sampled(filter_loop(pole, ratio), settle=0.01).poles()
        assert (np.abs(poles).max() < 1.0 + ROUND_OFF) == stable
    loop = sampled_open_loop(filter_loop(pole, limit), "command.u", settle=0.01)
    assert np.abs(1.0 + loop(np.exp(1j * np.linspace(0.001, np.pi, 4000)))).min() < 1e-3  # passes through -1


def held_lag(rate: float) -> ct.InterconnectedSystem:
    lag = ct.tf([rate], [1.0, rate], inputs="u", outputs="y", name="lag")
    hold = sampled_block(ct.ss([], [], [], [[1.0]], PERIOD, inputs="r", outputs="u", name="hold"))
    return wired([lag, hold], {"lag.u": "hold.u"}, inputs={"r": "hold.r"}, outputs={"y": "lag.y"})


@pytest.mark.parametrize("rate", [1.0, 2000.0, 1e5])
def test_fast_modes_are_exact(rate: float) -> None:
    fastest = np.abs(linearize_sampled(held_lag(rate)).poles()).max()
    assert fastest == pytest.approx(np.exp(-rate * PERIOD), rel=1e-9, abs=1e-15)


def test_refuses_what_has_no_common_period() -> None:
    with pytest.raises(ValueError, match="no sampled blocks"):
        linearize_sampled(ct.tf([1.0], [1.0, 1.0], name="lag"))
    two = [
        sampled_block(ct.ss([], [], [], [[1.0]], dt=dt, inputs="u", outputs="y", name=name))
        for dt, name in ((0.1, "slow"), (0.1 / np.sqrt(2.0), "fast"))
    ]
    both = wired([*two, ct.tf([1.0], [1.0, 1.0], inputs="u", outputs="y", name="lag")],
                 {"lag.u": "slow.y", "slow.u": "fast.y", "fast.u": "lag.y"}, outputs={"y": "lag.y"})  # fmt: skip
    with pytest.raises(ValueError, match=r"fast 0\.0707106781 s, slow 0\.1 s have no common multiple"):
        margins(both, at="slow.y")
