"""A multirotor's translation in a known wind, simulated and logged as PX4 logs it; shares no code with the library."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from phyfilter_ctl.logfiles import LogFile
from phyfilter_ctl.logfiles.contents import Column, Table

MASS, GRAVITY, MOTOR_THRUST = 1.5, 9.80665, 7.0
TICK = 1e-3  # s; motors, attitude and velocity are sampled on multiples of it

# North, east, down from east, north, up; forward, right, down from forward, left, up.
NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FRD = np.diag([1.0, -1.0, -1.0])


def log_of(
    path: str, topics: dict[str, tuple[np.ndarray, dict[str, np.ndarray]]], format: str = "ulog"
) -> LogFile:
    """A log of topics (times, columns by name) in memory."""

    def table(times, columns):
        return Table(
            tuple(Column(name) for name in columns),
            np.asarray(times, dtype=float),
            lambda names: np.stack([np.asarray(columns[name], dtype=float) for name in names], axis=1),
        )

    return LogFile(Path(path), format, None, (), (), {name: table(*topic) for name, topic in topics.items()})


def wind(t):
    """Force of the wind in N (..., 3), east, north, up."""
    t = np.asarray(t)
    return np.stack(
        [1.0 + 0.8 * np.sin(1.3 * t), -0.5 + 0.6 * np.cos(0.9 * t), 0.4 * np.sin(2.0 * t)], axis=-1
    )


SLOPE = np.array([0.8 * 1.3, 0.6 * 0.9, 0.4 * 2.0])  # largest |f'| of each, N/s


def attitude(t):
    """Body (forward, left, up) to world (east, north, up)."""
    t = np.asarray(t)
    yaw, pitch, roll = 0.5 + 0.2 * t, 0.25 * np.sin(1.1 * t), -0.2 * np.sin(0.7 * t + 1.0)
    return Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=-1))


@dataclass(frozen=True)
class Flight:
    times: np.ndarray
    v: np.ndarray  # east, north, up, of every tick
    motor_times: np.ndarray
    motors: np.ndarray


def fly(duration: float = 40.0, seed: int = 0) -> Flight:
    """Velocity at every tick, by Simpson's rule between them."""
    rng = np.random.default_rng(seed)
    n = round(duration / TICK)
    t = TICK * np.arange(n + 1)
    changes = np.unique(np.append(0, np.cumsum(rng.integers(3, 6, size=n // 3))))
    changes = changes[changes < n]  # a new command every 3 to 5 ms
    hover = MASS * GRAVITY / (4.0 * MOTOR_THRUST)
    motors = hover * (
        1.03 + 0.15 * np.sin(3.0 * TICK * changes)[:, None] + 0.02 * rng.standard_normal((len(changes), 4))
    )
    acting = motors[np.searchsorted(changes, np.arange(n), side="right") - 1].sum(axis=1) * MOTOR_THRUST

    def force(when):
        return attitude(when).apply(np.stack([0 * acting, 0 * acting, acting], axis=1)) + wind(when)

    mean = (force(t[:-1]) + 4.0 * force(t[:-1] + 0.5 * TICK) + force(t[1:])) / 6.0
    slope = mean / MASS - [0.0, 0.0, GRAVITY]
    return Flight(t, np.vstack([np.zeros(3), np.cumsum(slope * TICK, axis=0)]), t[changes], motors)


def px4_topics(flight: Flight, *, noise: float = 0.0, seed: int = 1, every: int = 20, dropouts: bool = True):
    """Topics as PX4 has them: NED and FRD, each at its own rate, the velocity with samples missing."""
    rng = np.random.default_rng(seed)
    rows = np.arange(0, len(flight.times), every)
    if dropouts:
        rows = rows[(rng.random(len(rows)) > 0.03) | (rows == 0)]
    v = flight.v[rows] + noise * rng.standard_normal((len(rows), 3))
    q_times = np.arange(0.0, flight.times[-1] + 1e-9, 0.008)
    body = Rotation.from_matrix(NED @ attitude(q_times).as_matrix() @ FRD).as_quat(scalar_first=True)
    body *= np.where(rng.random(len(body)) < 0.5, -1.0, 1.0)[:, None]  # q and -q are one attitude
    control = np.full((len(flight.motors), 12), np.nan)
    control[:, :4] = flight.motors
    return {
        "vehicle_local_position": (
            flight.times[rows],
            dict(zip(("vx", "vy", "vz"), (v @ NED.T).T, strict=True)),
        ),
        "vehicle_attitude": (q_times, {f"q[{i}]": body[:, i] for i in range(4)}),
        "actuator_motors": (flight.motor_times, {f"control[{i}]": control[:, i] for i in range(12)}),
    }
