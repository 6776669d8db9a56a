"""Generated flights of a small quadrotor: velocity, as an onboard estimate would give it, and true acceleration.

    p'' + 2 zeta w p' + w^2 p = w^2 sat(k (v_ref - v))        tilt and thrust loop, p the thrust acceleration
    v' = p - (d_1 + d_2 |v - w_g|) (v - w_g)                  rotor and body drag against the air

v_ref is a stick moved at random times, w_g a first-order (Ornstein-Uhlenbeck) gust, both per axis; gravity is trimmed
away. The measurement adds white and slowly varying noise. Nothing here is recorded.
"""

from __future__ import annotations

from functools import cache
from typing import Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from phyfilter_ctl.recording import Recording

from .params import Params, params

__all__ = ["generate"]

FloatArray = NDArray[np.float64]

_BLOCK = 500


def generate(kind: Literal["train", "test"], seed: int = 0, *, share: float = 1.0) -> tuple[Recording, ...]:
    """Generated flights: speeds of 0 to 2 m/s to train on (the slowest flight first), of 0 to 3 m/s to test on.

    Parameters
    ----------
    kind : {"train", "test"}
    seed : int
        Seed of set-points, gusts and noise, at least 0. Training and test flights of one seed are independent.
    share : float
        Share, above 0, of the full number of samples (28,000 and 8,400), for quick runs.

    Returns
    -------
    tuple of Recording
        x the measured velocity (n, 3) in m/s, label the true acceleration in m/s^2.

    Raises
    ------
    ValueError
        If ``kind`` is unknown or ``seed`` or ``share`` out of range.

    Examples
    --------
    >>> flights = generate("train", seed=1, share=0.05)
    >>> len(flights), sum(flight.n for flight in flights)
    (8, 1400)
    """
    values = params()
    sampling, chosen = values.sampling, values.setpoints
    if kind not in ("train", "test"):
        raise ValueError(f"kind: expected 'train' or 'test', got {kind!r}")
    if seed < 0 or not share > 0.0:
        raise ValueError(f"expected seed >= 0 and share > 0, got seed {seed} and share {share}")
    if kind == "train":
        limits = np.linspace(chosen.train_speed_low, chosen.train_speed_high, sampling.train_flights)
        total, stream = sampling.train_samples, 0
    else:
        limits = np.full(sampling.test_flights, chosen.test_speed_high)
        total, stream = sampling.test_samples, 1
    rng = np.random.default_rng([seed, stream])
    samples = max(2, round(share * total / len(limits)))
    return tuple(
        _flight(f"generated_{kind}_{i}", float(limit), samples, rng, values) for i, limit in enumerate(limits)
    )


def _flight(name: str, limit: float, samples: int, rng: np.random.Generator, values: Params) -> Recording:
    dt, substeps = values.sampling.dt, values.sampling.substeps
    before = round(values.sampling.warm_up / dt)
    fine = (before + samples) * substeps
    step = dt / substeps
    commands = _set_points(limit, fine, step, rng, values)
    gusts = _coloured(fine, step, values.wind.deviation, values.wind.time_constant, rng)
    velocity, acceleration = _simulate(commands, gusts, step)
    recorded = slice(before * substeps, None, substeps)
    sensor = values.sensor
    noise = _coloured(samples, dt, sensor.coloured, sensor.coloured_time_constant, rng)
    noise += sensor.white * rng.standard_normal((samples, 3))
    return Recording.from_arrays(
        x=velocity[recorded] + noise,
        dt=dt,
        label=acceleration[recorded],
        name=name,
        channels=("vx", "vy", "vz"),
        unit="m/s",
    )


def _set_points(limit: float, n: int, step: float, rng: np.random.Generator, values: Params) -> FloatArray:
    """Stick commands (n, 3) in m/s: steps to random velocities of at most ``limit``, smoothed."""
    chosen = values.setpoints
    longest = int(np.ceil(n * step / chosen.hold_low)) + 1
    starts = np.cumsum(rng.uniform(chosen.hold_low, chosen.hold_high, longest))
    direction = rng.standard_normal((longest + 1, 3)) * [1.0, 1.0, chosen.vertical]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    targets = direction * rng.uniform(0.0, limit, (longest + 1, 1))
    steps = targets[np.searchsorted(starts, step * np.arange(n), side="right")]
    pole = np.exp(-chosen.smoothing * step)
    for _ in range(2):
        steps = np.asarray(lfilter([1.0 - pole], [1.0, -pole], steps, axis=0))
    return steps


def _coloured(
    n: int, step: float, deviation: float, time_constant: float, rng: np.random.Generator
) -> FloatArray:
    """Samples (n, 3) of a stationary first-order Gauss-Markov process per axis, exactly."""
    pole = np.exp(-step / time_constant)
    drive = deviation * np.sqrt(1.0 - pole**2) * rng.standard_normal((n, 3))
    drive[0] = deviation * rng.standard_normal(3)
    return np.asarray(lfilter([1.0], [1.0, -pole], drive, axis=0))


def _simulate(commands: FloatArray, gusts: FloatArray, step: float) -> tuple[FloatArray, FloatArray]:
    """True velocity and acceleration (n, 3), from rest."""
    block = _block(step)
    inputs = np.hstack([commands, gusts])
    n = len(inputs)
    inputs = np.pad(inputs, ((0, -n % _BLOCK), (0, 0)), mode="edge")
    state = np.zeros(9)
    recorded = np.empty((len(inputs), 6))
    for first in range(0, len(inputs), _BLOCK):
        state, outputs = block(state, inputs[first : first + _BLOCK].T)
        state = state[:, -1]
        recorded[first : first + _BLOCK] = outputs.full().T
    return recorded[:n, :3], recorded[:n, 3:]


@cache
def _block(step: float) -> ca.Function:
    """A block of Runge-Kutta 4 steps with command and gust held, chained by CasADi."""
    state, inputs = ca.SX.sym("state", 9), ca.SX.sym("inputs", 6)
    slope = ca.Function("slope", [state, inputs], [_slope(state, inputs)])
    k1 = slope(state, inputs)
    k2 = slope(state + 0.5 * step * k1, inputs)
    k3 = slope(state + 0.5 * step * k2, inputs)
    k4 = slope(state + step * k3, inputs)
    after = state + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    seen = ca.vertcat(
        state[:3], slope(state, inputs)[:3]
    )  # before the step: command and gust as at this instant
    return ca.Function("quadrotor", [state, inputs], [after, seen]).mapaccum("quadrotor_block", _BLOCK)


def _slope(state: ca.SX, inputs: ca.SX) -> ca.SX:
    """Time derivative of (v, p, p'), each with three axes."""
    vehicle = params().vehicle
    v, p, rate = state[:3], state[3:6], state[6:]
    command, gust = inputs[:3], inputs[3:]
    wanted = vehicle.velocity_gain * (command - v)
    size = ca.sqrt(ca.sumsqr(wanted) + 1e-12)  # differentiable and never 0/0 at rest
    wanted = wanted * ca.fmin(1.0, vehicle.acceleration_limit / size)
    air = v - gust
    drag = (vehicle.linear_drag + vehicle.quadratic_drag * ca.sqrt(ca.sumsqr(air) + 1e-12)) * air
    w = vehicle.tilt_frequency
    return ca.vertcat(p - drag, rate, w**2 * (wanted - p) - 2.0 * vehicle.tilt_damping * w * rate)
