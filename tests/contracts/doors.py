"""Doors: public functions with one of their arrays left open, and an array that fits; times likewise."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray

import phyfilter_ctl as pf
from phyfilter_ctl import PhyFilter, Recording, baselines, plants, simulate, study
from phyfilter_ctl.baselines import DisturbanceObserver, Evolver, FeedbackNeuralNetwork, SeerII
from phyfilter_ctl.blocks import delay_line
from phyfilter_ctl.controllers import (
    CooperativePlanner,
    PlannerLimits,
)
from phyfilter_ctl.controllers.known import known_force, known_torque
from phyfilter_ctl.controllers.tracking import position_controller
from phyfilter_ctl.design import SquaredError
from phyfilter_ctl.filter import PaperFilter
from phyfilter_ctl.learned import (
    AdaptiveChebyshev,
    Chebyshev,
    Dictionary,
    Koopman,
    Network,
    NeuralOde,
    OnlineKoopman,
    Trajectory,
    window,
)
from phyfilter_ctl.plants import quadrotor, small_arm, wind_field


def held(margin: pf.FilterMargins, **sets: Any) -> pf.InertiaCertificate:
    """A constant M of a set, in the loop of these margins."""
    return pf.inertia_tolerance(margin.filter, margin.around, rate=0.0, **sets)


F = PhyFilter([400.0, 40.0])
N = 6
TIMES = np.array([0.0, 0.010, 0.020, 0.031, 0.040, 0.050])
X = np.sin(3.0 * TIMES)[:, None] * [1.0, -2.0]
ONE = X[:, :1]
STATE = F.sampled(0.01).start(X[0])
LAG = ct.tf([1.0], [0.1, 1.0], inputs="u", outputs="y", name="lag")
LOG = Recording.from_arrays(x=X, times=TIMES, label=X)
GAIN = ct.nlsys(None, lambda t, x, u, p: p["k"] * u, inputs=1, outputs=1, params={"k": 2.0}, name="gain")
_T = 0.01 * np.arange(200)[:, None]
FLIGHT = Recording.from_arrays(x=-np.cos(_T), dt=0.01, g=np.zeros_like(_T), label=np.sin(_T))
MODEL = Chebyshev(degree=2, n_d=0).fit(X, X).model
BOUND = pf.error_bound(PhyFilter([20.0]), {1: 1.0})
MARGIN = pf.margins(PhyFilter([20.0]))
DRONE = {"motor_lag": 0.04, "rotor_max": 16.2, "delay_steps": 5}
ARM = small_arm()
PLANNER = CooperativePlanner(
    PlannerLimits([[-3, -3, 0.3], [3, 3, 2.5]], [[0.2, -0.15, -0.3], [0.4, 0.15, -0.1]])
)
H = np.array([0.0, 0.0, 1.2, 0.0, 0.0, 0.0, 0.3, 0.0, -0.2, 0.0, 0.0, 0.0])
W = np.ones((6, 1, 1))
CHEBYSHEV = Chebyshev(2, degree_d=1, n_d=1).fit(np.hstack([X, ONE]), X).model
ADAPTIVE = AdaptiveChebyshev(CHEBYSHEV, 0.01, rate=20.0)
ODE = NeuralOde((2,), max_iterations=1, segment=4).fit_trajectories(Trajectory(X, 0.01)).model

Door = tuple[NDArray[np.float64], Callable[..., object]]
DOORS: dict[str, Door] = {
    "PhyFilter a": (np.array([400.0, 40.0]), PhyFilter),
    "PhyFilter b": (np.array([400.0, 40.0]), lambda v: PhyFilter([400.0, 40.0], v)),
    "sampled E": (np.eye(2), lambda v: F.sampled(0.01, E=v)),
    "run x": (X, lambda v: F.sampled(0.01).run(v)),
    "run g": (X, lambda v: F.sampled(0.01).run(X, v)),
    "run f_theta": (X, lambda v: F.sampled(0.01).run(X, f_theta=v)),
    "run inertia": (X, lambda v: F.sampled(0.01).run(X, inertia=v)),
    "run in float32 x": (X, lambda v: F.sampled(0.01, precision="float32").run(v)),
    "start x0": (X[0], lambda v: F.sampled(0.01).start(v)),
    "start f_hat0": (X[0], lambda v: F.sampled(0.01).start(X[0], f_hat0=v)),
    "step x": (X[0], lambda v: F.sampled(0.01).step(STATE, v)),
    "step g": (X[0], lambda v: F.sampled(0.01).step(STATE, X[0], v)),
    "step inertia": (np.ones(2), lambda v: F.sampled(0.01).step(STATE, X[0], inertia=v)),
    "Recording x": (X, lambda v: Recording.from_arrays(x=v, dt=0.01)),
    "Recording g": (X, lambda v: Recording.from_arrays(x=X, dt=0.01, g=v)),
    "Recording features": (X, lambda v: Recording.from_arrays(x=X, dt=0.01, features=v)),
    "Recording inertia": (X, lambda v: Recording.from_arrays(x=X, dt=0.01, inertia=v)),
    "Recording compare v": (X, lambda v: LOG.compare({"v": v})),
    "BackwardDifference v": (X, lambda v: baselines.BackwardDifference(2).estimate(v, 0.01)),
    "KalmanDifferentiator v": (X, lambda v: baselines.KalmanDifferentiator(q=1.0, r=1.0).estimate(v, 0.01)),
    "tune v": (ONE, lambda v: baselines.tune(baselines.BackwardDifference, [(v, ONE, 0.01, 0)])),
    "tune label": (ONE, lambda v: baselines.tune(baselines.BackwardDifference, [(ONE, v, 0.01, 0)])),
    "DisturbanceObserver x": (X, lambda v: DisturbanceObserver(8.0, 0.01).run(v)),
    "DisturbanceObserver g": (X, lambda v: DisturbanceObserver(8.0, 0.01).run(X, v)),
    "FeedbackNeuralNetwork f_theta": (X, lambda v: FeedbackNeuralNetwork(8.0, 0.01).run(X, f_theta=v)),
    "Evolver slope": (X, lambda v: Evolver(8.0, 0.01).run(X, slope=v)),
    "Network z": (X, lambda v: Network((2,), max_iterations=2).fit(v, X)),
    "Network f": (X, lambda v: Network((2,), max_iterations=2).fit(X, v)),
    "Chebyshev z": (X, lambda v: MODEL.predict(v)),
    "Chebyshev cotangent": (X, lambda v: MODEL.vjp(X, v)),
    "Chebyshev parameters": (MODEL.parameters, lambda v: MODEL.with_parameters(v)),
    "Chebyshev Xi": (MODEL.Xi, lambda v: Chebyshev(degree=2, n_d=0, bounds=MODEL.bounds, Xi=v)),
    "Koopman z": (X, lambda v: Koopman(Dictionary(2, degree=1), 1, dt=0.01).fit(v, ONE)),
    "window x": (X, lambda v: window(v, 2)),
    "simulate inputs": (TIMES, lambda v: simulate(LAG, TIMES, v)),
    "simulate initial_state": (np.zeros(1), lambda v: simulate(LAG, TIMES, 1.0, v)),
    "simulate k": (np.array([2.0]), lambda v: simulate(GAIN, TIMES, 1.0, params={"k": v})),
    "linearize x0": (np.zeros(1), lambda v: pf.flatten(LAG).linearize(v)),
    "block x0": (np.zeros(2), lambda v: pf.phyfilter_block(F, 2).rest_state(v)),
    "frequency_response omega": (np.array([1.0, 2.0]), lambda v: pf.frequency_response(F, v)),
    "sensitivity omega": (np.array([1.0, 2.0]), lambda v: MARGIN.sensitivity(v)),
    "inertia_within M_hat": (np.array([2.0, 1.0]), lambda v: held(MARGIN, M_hat=v, within=0.1)),
    "zeros_at": (np.array([3.0]), lambda v: pf.place_poles([-20.0, -20.0, -20.0], type=1, zeros_at=v)),
    "SquaredError weights": (np.ones(2), lambda v: SquaredError(v)),
    "learn weights": (np.ones(200), lambda v: pf.learn(FLIGHT, 1, weights=v, search=pf.Search(starts=0))),
    "known_torque trim": (
        np.zeros(3),
        lambda v: known_torque(J=[0.1] * 3, arm=0.2, torque_ratio=0.01, dt=0.002, trim=v, **DRONE),
    ),
    "position_controller kp": (
        np.ones(2),
        lambda v: position_controller(mass=3.0, kp=v, kd=4.0, dt=0.002),
    ),
    "quadrotor drag": (np.ones(3), lambda v: quadrotor(drag=v)),
    "wind_field mean": (np.ones(3), lambda v: wind_field(mean=v)),
    "rigid_body J": (np.ones(3), lambda v: plants.rigid_body(J=v)),
    "PhyFilter poles": (np.array([-20.0, -20.0]), lambda v: PhyFilter([400.0, 40.0], poles=v)),
    "from_poles poles": (np.array([-20.0, -30.0]), PhyFilter.from_poles),
    "from_poles b": (np.array([600.0, 40.0]), lambda v: PhyFilter.from_poles([-20.0, -30.0], v)),
    "sampled limit": (np.ones(2), lambda v: F.sampled(0.01, limit=v).run(X)),
    "sampled g_limit": (np.ones(2), lambda v: F.sampled(0.01, g_limit=(-1.0, v)).run(X)),
    "start g0": (X[0], lambda v: F.sampled(0.01).start(X[0], g0=v)),
    "start f_theta0": (X[0], lambda v: F.sampled(0.01).start(X[0], f_theta0=v)),
    "start inertia0": (np.ones(2), lambda v: F.sampled(0.01).start(X[0], inertia0=v)),
    "step f_theta": (X[0], lambda v: F.sampled(0.01).step(STATE, X[0], f_theta=v)),
    "shift_x dx": (X[0], lambda v: F.sampled(0.01).shift_x(STATE, v)),
    "to_ss inertia": (np.ones(2), lambda v: F.sampled(0.01).to_ss(2, inertia=v)),
    "PaperFilter x": (X, lambda v: PaperFilter(F, 0.01).run(v)),
    "PaperFilter start x0": (X[0], lambda v: PaperFilter(F, 0.01).start(v)),
    "Recording label": (X, lambda v: Recording.from_arrays(x=X, dt=0.01, label=v)),
    "with_signals f_theta": (X, lambda v: LOG.with_signals(f_theta=v)),
    "LowpassDifference v": (X, lambda v: baselines.LowpassDifference(20.0).estimate(v, 0.01)),
    "TrackingDifferentiator v": (X, lambda v: baselines.TrackingDifferentiator(50.0).estimate(v, 0.01)),
    "RobustDifferentiator v": (X, lambda v: baselines.RobustDifferentiator(9.0).estimate(v, 0.01)),
    "Evolver f_theta0": (X[0], lambda v: Evolver(8.0, 0.01).run(X, slope=X, f_theta0=v)),
    "SeerII basis": (ONE, lambda v: SeerII(8.0, 0.01).run(ONE, basis=v, weights=W, weight_slopes=W)),
    "SeerII weights": (W, lambda v: SeerII(8.0, 0.01).run(ONE, basis=ONE, weights=v, weight_slopes=W)),
    "Chebyshev d": (np.array([[0.5]]), lambda v: CHEBYSHEV.varsigma(v)),
    "Chebyshev regressor x": (X, lambda v: MODEL.regressor(v)),
    "Chebyshev bounds": (MODEL.bounds, lambda v: Chebyshev(degree=2, n_d=0, bounds=v, Xi=MODEL.Xi)),
    "Dictionary z": (X, Dictionary(2, degree=2)),
    "Dictionary scaled_to z": (X, Dictionary(2, degree=2).scaled_to),
    "Dictionary centres": (np.ones((3, 2)), lambda v: Dictionary(2, degree=1, centres=v)(X)),
    "OnlineKoopman z": (X, lambda v: OnlineKoopman(Koopman(Dictionary(2, degree=1), 2, dt=0.01), 4).run(v)),
    "AdaptiveChebyshev z": (X, lambda v: ADAPTIVE.run(v, X)),
    "AdaptiveChebyshev x": (X, lambda v: ADAPTIVE.run(X, v)),
    "AdaptiveChebyshev g": (X, lambda v: ADAPTIVE.run(X, X, v)),
    "Trajectory x": (X, lambda v: Trajectory(v, 0.01)),
    "Trajectory u": (X, lambda v: Trajectory(X, 0.01, u=v)),
    "NeuralOde z": (X, lambda v: ODE.predict(v)),
    "block g0": (np.zeros(2), lambda v: pf.phyfilter_block(F, 2).rest_state(np.zeros(2), v)),
    "phyfilter_block inertia": (np.ones(2), lambda v: pf.phyfilter_block(F, 2, inertia=v)),
    "sampled_block inertia": (np.ones(2), lambda v: pf.sampled_block(F.sampled(0.01), 2, inertia=v)),
    "delay_line start": (np.ones(2), lambda v: delay_line(["u[0]", "u[1]"], 3, 0.01, start=v)),
    "linearize u0": (np.zeros(1), lambda v: pf.flatten(LAG).linearize(None, v)),
    "simulate_batch k": (
        np.array([1.0, 2.0]),
        lambda v: pf.simulate_batch(GAIN, TIMES, 1.0, params={"k": v}),
    ),
    "phase_lag omega": (np.array([1.0, 2.0]), lambda v: pf.frequency_response(F, [0.5, 3.0]).phase_lag(v)),
    "inertia_between low": (
        np.ones(2),
        lambda v: held(MARGIN, M_hat=np.ones(2), between=(v, 2.0 * np.ones(2))),
    ),
    "inertia_between high": (
        np.ones(2),
        lambda v: held(MARGIN, M_hat=np.ones(2), between=(0.5 * np.ones(2), v)),
    ),
    "inertia_tolerance vertices": (
        np.ones((1, 2)),
        lambda v: held(MARGIN, M_hat=np.ones(2), vertices=v),
    ),
    "error_budget bandwidth": (
        np.array([10.0, 20.0]),
        lambda v: pf.analysis.error_budget([BOUND, BOUND], bandwidth=v),
    ),
    "place_poles poles": (np.array([-20.0, -30.0]), pf.place_poles),
    "place_poles numerator": (np.array([400.0, 40.0]), lambda v: pf.place_poles([-20.0, -20.0], numerator=v)),
    "known_force drag": (np.ones(3), lambda v: known_force(mass=3.0, drag=v, dt=0.002, **DRONE)),
    "known_torque J": (
        np.full(3, 0.1),
        lambda v: known_torque(J=v, arm=0.2, torque_ratio=0.01, dt=0.002, **DRONE),
    ),
    "position_controller kd": (np.ones(2), lambda v: position_controller(mass=3.0, kp=4.0, kd=v, dt=0.002)),
    "wind_field jet_origin": (np.ones(3), lambda v: wind_field(jet_origin=v, jet_speed=1.0)),
    "wind_field jet_direction": (np.ones(3), lambda v: wind_field(jet_direction=v, jet_speed=1.0)),
    "quadrotor J": (np.full(3, 0.1), lambda v: quadrotor(J=v)),
    "aerial_manipulator drag": (np.ones(3), lambda v: plants.aerial_manipulator(drag=v)),
    "small_arm mount": (np.array([0.0, 0.0, -0.1]), lambda v: small_arm(mount=v)),
    "Sensor v": (np.ones(3), lambda v: plants.sensors({"v": plants.Sensor("velocity", 0.1, start=v)})),
    "median_interval values": (TIMES, study.median_interval),
    "reduction ours": (1.0 + TIMES, lambda v: study.reduction(v, np.ones(6))),
    "reduction theirs": (1.0 + TIMES, lambda v: study.reduction(np.ones(6), v)),
    "command_jitter commands": (X[None], lambda v: study.command_jitter(v, 1.0)),
    "reachable points": (np.array([[1.4, 0.0, 0.7]]), lambda v: PLANNER.reachable(v)),
    "check_targets targets": (np.array([[1.0, 0.0, 0.8]]), lambda v: PLANNER.check_targets(v)),
    "complaint h": (H, lambda v: PLANNER.complaint(v)),
    "SerialArm points": (np.array([[0.3, 0.0, -0.2]]), lambda v: ARM.check_reachable(v)),
}
TIME_DOORS: dict[str, Callable[..., object]] = {
    "run times": lambda t: F.sampled(0.01).run(X, times=t),
    "Recording times": lambda t: Recording.from_arrays(x=X, times=t),
    "DisturbanceObserver times": lambda t: DisturbanceObserver(8.0, 0.01).run(X, times=t),
    "simulate timepts": lambda t: simulate(LAG, t, 1.0),
    "sensitivity timepts": lambda t: pf.sensitivity(GAIN, t, 1.0, by=["k"]),
    "envelope times": lambda t: BOUND.envelope(t),
    "worst_residual times": lambda t: BOUND.worst_residual(t),
}
