"""One gate: what no signal can be is refused through every door that takes signals, in words that name it.

A door is a public function with one of its arrays left open. Each kind of bad input comes in the shape of the good one,
so that it is refused for what it is.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import control as ct
import numpy as np
import pytest
from numpy.typing import NDArray

import phyfilter_ctl as pf
from phyfilter_ctl import PhyFilter, Recording, baselines, plants, simulate
from phyfilter_ctl.baselines import DisturbanceObserver, Evolver, FeedbackNeuralNetwork
from phyfilter_ctl.controllers import known_torque, position_controller
from phyfilter_ctl.design import SquaredError, numerator_of_type
from phyfilter_ctl.learned import Chebyshev, Dictionary, Koopman, Network, window
from phyfilter_ctl.plants import quadrotor, small_arm, wind_field

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
BOUND = pf.ultimate_bound(PhyFilter([20.0]), residual={1: 1.0})
MARGIN = pf.prior_margin(PhyFilter([20.0]))
DRONE = {"motor_lag": 0.04, "rotor_max": 16.2, "delay_steps": 5}
ARM = small_arm()

Door = tuple[NDArray[np.float64], Callable[..., object]]
DOORS: dict[str, Door] = {
    "PhyFilter a": (np.array([400.0, 40.0]), PhyFilter),
    "PhyFilter b": (np.array([400.0, 40.0]), lambda v: PhyFilter([400.0, 40.0], v)),
    "sampled E": (np.eye(2), lambda v: F.sampled(0.01, E=v)),
    "run x": (X, lambda v: F.sampled(0.01).run(v)),
    "run g": (X, lambda v: F.sampled(0.01).run(X, v)),
    "run f_theta": (X, lambda v: F.sampled(0.01).run(X, f_theta=v)),
    "run inertia": (X, lambda v: F.sampled(0.01).run(X, inertia=v)),
    "run in float32": (X, lambda v: F.sampled(0.01, precision="float32").run(v)),
    "start": (X[0], lambda v: F.sampled(0.01).start(v)),
    "start f_hat0": (X[0], lambda v: F.sampled(0.01).start(X[0], f_hat0=v)),
    "step x": (X[0], lambda v: F.sampled(0.01).step(STATE, v)),
    "step g": (X[0], lambda v: F.sampled(0.01).step(STATE, X[0], v)),
    "step inertia": (np.ones(2), lambda v: F.sampled(0.01).step(STATE, X[0], inertia=v)),
    "Recording x": (X, lambda v: Recording.from_arrays(x=v, dt=0.01)),
    "Recording g": (X, lambda v: Recording.from_arrays(x=X, dt=0.01, g=v)),
    "Recording features": (X, lambda v: Recording.from_arrays(x=X, dt=0.01, features=v)),
    "Recording inertia": (X, lambda v: Recording.from_arrays(x=X, dt=0.01, inertia=v)),
    "Recording compare": (X, lambda v: LOG.compare({"v": v})),
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
    "simulate params": (np.array([2.0]), lambda v: simulate(GAIN, TIMES, 1.0, params={"k": v})),
    "linearize x0": (np.zeros(1), lambda v: pf.flatten(LAG).linearize(v)),
    "block start": (np.zeros(2), lambda v: pf.phyfilter_block(F, 2).rest_state(v)),
    "frequency_response omega": (np.array([1.0, 2.0]), lambda v: pf.frequency_response(F, v)),
    "sensitivity omega": (np.array([1.0, 2.0]), lambda v: MARGIN.sensitivity(v)),
    "inertia_within M_hat": (np.array([2.0, 1.0]), lambda v: MARGIN.inertia_within(v, 0.1)),
    "zeros_at": (np.array([3.0]), lambda v: pf.place_poles([-20.0, -20.0, -20.0], numerator=1, zeros_at=v)),
    "numerator_of_type a": (np.array([400.0, 40.0]), lambda v: numerator_of_type(v, 1)),
    "SquaredError weights": (np.ones(2), lambda v: SquaredError(v)),
    "learn weights": (np.ones(200), lambda v: pf.learn(FLIGHT, 1, starts=0, weights=v, wiener=False)),
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
    "SerialArm points": (np.array([[0.3, 0.0, -0.2]]), lambda v: ARM.check_reachable(v)),
}
TIME_DOORS: dict[str, Callable[..., object]] = {
    "run times": lambda t: F.sampled(0.01).run(X, times=t),
    "Recording times": lambda t: Recording.from_arrays(x=X, times=t),
    "DisturbanceObserver times": lambda t: DisturbanceObserver(8.0, 0.01).run(X, times=t),
    "simulate timepts": lambda t: simulate(LAG, t, 1.0),
    "envelope times": lambda t: BOUND.envelope(t),
}


def masked(values: NDArray[np.float64]) -> np.ma.MaskedArray:
    mask = np.zeros(values.shape, bool)
    mask.flat[values.size // 2] = True
    return np.ma.array(values, mask=mask)


def changed(values: NDArray[np.float64], to: object, kind: type = float) -> NDArray[np.generic]:
    other = values.astype(kind)
    other.flat[values.size // 2] = to
    return other


KINDS: dict[str, Callable[[NDArray[np.float64]], object]] = {
    "dates": lambda v: np.datetime64("2024-05-01T10:00:00", "ns") + (1e9 * v).astype("timedelta64[ns]"),
    "lengths of time": lambda v: (1e9 * v).astype("timedelta64[ns]"),
    "complex": lambda v: v + 1e-3j,
    "complex without an imaginary part": lambda v: v + 0j,
    "text": lambda v: v.astype(str),
    "objects": lambda v: changed(v, None, object),
    "masked": masked,
    "list of masked": lambda v: list(masked(v)),
    "nan": lambda v: changed(v, np.nan),
    "inf": lambda v: changed(v, -np.inf),
    "empty": lambda v: v[:0],
}
# A scalar or a diagonal may go in for these, an infinite frequency, or none at all.
ALLOWED = {("zeros_at", "empty"), ("SerialArm points", "empty"), ("Chebyshev Xi", "empty")}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("door", DOORS)
def test_what_no_signal_can_be_is_refused(door: str, kind: str) -> None:
    good, enter = DOORS[door]
    enter(good)
    bad = KINDS[kind](good)
    if (door, kind) in ALLOWED:
        enter(bad)
        return
    with pytest.raises((TypeError, ValueError), match=r"\w+.*: .*(expected|must|got|not finite)") as caught:
        enter(bad)
    assert re.search(r"[:;] .{6,}", str(caught.value)), str(caught.value)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in ("dates", "lengths of time")])
@pytest.mark.parametrize("door", TIME_DOORS)
def test_what_no_time_can_be_is_refused(door: str, kind: str) -> None:
    TIME_DOORS[door](TIMES)
    with pytest.raises((TypeError, ValueError), match=r"^(times|timepts): "):
        TIME_DOORS[door](KINDS[kind](TIMES))


@pytest.mark.parametrize("door", TIME_DOORS)
def test_times_run_forwards(door: str) -> None:
    if door != "envelope times":  # at any times, in any order
        with pytest.raises(
            ValueError, match=r"^(times|timepts): expected increasing times, got row 5 .*runs back"
        ):
            TIME_DOORS[door]([*TIMES[:-1], 0.03])


@pytest.mark.parametrize(
    "value", [np.datetime64("2024-05-01"), 1j, "0.1", None, np.ma.masked, np.nan, [0.1, 0.2], -0.1]
)
@pytest.mark.parametrize(
    "door",
    [
        lambda dt: Recording.from_arrays(x=X, dt=dt),
        lambda dt: LOG.resample(dt),
        F.sampled,
        lambda dt: DisturbanceObserver(8.0, dt),
        lambda dt: baselines.BackwardDifference(2).estimate(X, dt),
    ],
)
def test_what_no_sampling_interval_can_be_is_refused(door: Callable[..., object], value: object) -> None:
    with pytest.raises((TypeError, ValueError), match="dt"):
        door(value)
