"""A recorded flight as the filter takes it: known specific force, label per unit mass, and how late the thrust acts.

    v' = g + f,   g = R(q) e_z T - G e_z,   T = G T_sp / hover_throttle        (x = v, M = 1, world z up)

The label fa is a force in N. Where it repeats

    fa = m (v' - g),   v'_k = (v_{k-2} - 8 v_{k-1} + 8 v_{k+1} - v_{k+2}) / (12 h)

its ratio to the right-hand side is the mass m, and the misfit tells whether frames, units and the order of the
quaternion are the ones assumed here: world z up, q = (x, y, z, w) from body to world, thrust along body z.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from phyfilter_ctl.recording import Recording

__all__ = ["AXES", "BAND", "DelayScan", "WindTunnelFlight", "read"]

FloatArray = NDArray[np.float64]

AXES = ("x", "y", "z")
BAND = (
    1.0,
    8.0,
)  # Hz: above the manoeuvre, below the noise; in it the force hardly changes but by the motors

_GRAVITY = 9.81  # m/s^2; the labels of the recordings hold the same
_LATEST, _STEPS = 0.16, 33  # s, and how many delays are tried up to it
_SLOWEST = 0.05  # s: a longer step leaves no room for the band
_REGULAR = 0.1  # of a step: how far a time may be off the uniform grid (times are printed with few digits)
_UNIT_QUATERNION = 0.01
_OTHER_FRAMES = (
    0.5  # relative misfit of the label beyond which nothing says that the frames are the assumed ones
)

_VELOCITY, _LABEL = ("vx", "vy", "vz"), ("fax", "fay", "faz")
_INPUTS = ("qx", "qy", "qz", "qw", "T_sp", "hover_throttle")


@dataclass(frozen=True)
class DelayScan:
    """What is left of the specific force along the thrust axis, 1 to 8 Hz, when the set-point acts later.

    Attributes
    ----------
    delays : (m,) array
        s.
    rms : (m,) array
        m/s^2.
    """

    delays: FloatArray
    rms: FloatArray

    @property
    def best(self) -> float:
        """Delay with the least rms, s: transport, motors and the estimator of v together."""
        return float(self.delays[np.argmin(self.rms)])

    @property
    def reduction(self) -> float:
        """Share of the rms without delay that the best one removes."""
        return float(1.0 - np.min(self.rms) / self.rms[0])


@dataclass(frozen=True)
class WindTunnelFlight:
    """A recorded flight, checked.

    Attributes
    ----------
    log : Recording
        Name of the flight, and times on a uniform grid.
    v, g, label : (N, 3) array
        Velocity in m/s; known specific force and fa / m in m/s^2.
    z : (N, 6) array
        Features of a learned model: v and R(q) e_z T.
    mass : float
        m in kg, of the label or as given.
    misfit : float
        rms of fa - m (v' - g) relative to that of fa.
    delays : DelayScan
    """

    log: Recording
    v: FloatArray
    g: FloatArray
    label: FloatArray
    z: FloatArray
    mass: float
    misfit: float
    delays: DelayScan


def read(
    path: Path | str, *, mass: float | None = None, thrust_delay: float = 0.0, shortest: float = 3.0
) -> WindTunnelFlight:
    """Read a recorded flight.

    Parameters
    ----------
    path : path
        CSV with the columns t [s]; vx vy vz [m/s]; fax fay faz [N]; qx qy qz qw; T_sp and hover_throttle (one unit).
    mass : float, optional
        kg; None means the one that fits the label best.
    thrust_delay : float
        s by which the set-point acts later than recorded.
    shortest : float
        Least duration, s.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If a column is missing, the flight too short, too slowly or irregularly sampled, a number not finite, a
        quaternion not of unit length, a throttle negative, or the label fits the assumed frames with no mass.
    """
    try:
        raw = Recording.from_csv(
            path, x=_VELOCITY, label=_LABEL, features=_INPUTS, g=None, f_theta=None, inertia=None
        )
    except ValueError as error:
        names = ", ".join(("t", *_VELOCITY, *_LABEL, *_INPUTS))
        raise ValueError(f"{error}. A replay takes the columns {names}") from error
    times = _uniform(path, raw.times, shortest)
    v, force, inputs = raw.x, np.asarray(raw.label), np.asarray(raw.features)
    q, throttle, hover = inputs[:, :4], inputs[:, 4], inputs[:, 5]
    length = np.linalg.norm(q, axis=1)
    for column, bad, expected in (
        ("qx qy qz qw", np.abs(length - 1.0) > _UNIT_QUATERNION, "unit length"),
        ("hover_throttle", ~(hover > 0.0), "a positive throttle"),
        ("T_sp", throttle < 0.0, "a throttle of 0 or more"),
    ):
        if np.any(bad):
            raise ValueError(
                f"{path}: {column} at t = {raw.times[np.argmax(bad)]:.6g} s: expected {expected} "
                f"({int(bad.sum())} such rows)"
            )
    axis, thrust = _thrust_axis(q), _GRAVITY * throttle / hover
    up = np.array([0.0, 0.0, _GRAVITY])
    mass, misfit = _mass(path, force, _five_point(v, times) - axis * thrust[:, None] + up, mass)
    applied = axis * np.interp(times - thrust_delay, times, thrust)[:, None]
    along = np.sum((np.gradient(v, times, axis=0) + up) * axis, axis=1)
    return WindTunnelFlight(
        log=Recording(times, v, name=raw.name, channels=AXES, unit="m/s"),
        v=v,
        g=applied - up,
        label=force / mass,
        z=np.hstack([v, applied]),
        mass=mass,
        misfit=misfit,
        delays=_scan(times, along, thrust),
    )


def _uniform(path: Path | str, times: FloatArray, shortest: float) -> FloatArray:
    """The uniform grid that the times are rounded from."""
    duration = float(times[-1] - times[0])
    h = duration / (len(times) - 1)
    if duration < shortest:
        raise ValueError(
            f"{path}: lasts {duration:.3g} s, expected at least {shortest:.3g} s for start-up, horizon and the search "
            "for the delay; give a longer flight or a shorter start_up"
        )
    grid = times[0] + h * np.arange(len(times))
    if np.max(np.abs(times - grid)) > _REGULAR * h:
        steps = np.diff(times)
        k = int(np.argmax(np.abs(steps - np.median(steps))))
        raise ValueError(
            f"{path}: column 't' is not regular: expected steps of {np.median(steps):.6g} s throughout, the one after "
            f"t = {times[k]:.6g} s is {steps[k]:.6g} s; cut the flight there, or resample it"
        )
    if h > _SLOWEST:
        raise ValueError(f"{path}: column 't' has steps of {h:.3g} s, expected at most {_SLOWEST} s")
    return grid


def _thrust_axis(q: FloatArray) -> FloatArray:
    """R(q) e_z (N, 3) for q = (x, y, z, w), body to world."""
    x, y, z, w = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    return np.stack([2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)], axis=1)


def _five_point(v: FloatArray, times: FloatArray) -> FloatArray:
    """Central difference of fourth order; NaN in the two samples at each end."""
    slope = np.full_like(v, np.nan)
    slope[2:-2] = (v[:-4] - 8.0 * v[1:-3] + 8.0 * v[3:-1] - v[4:]) / (12.0 * (times[1] - times[0]))
    return slope


def _mass(
    path: Path | str, force: FloatArray, residual: FloatArray, given: float | None
) -> tuple[float, float]:
    """m that fits force = m residual best unless it is given, and the relative misfit."""
    y, r = force[2:-2], residual[2:-2]
    energy, scale = float(np.sum(r * r)), float(np.sum(y * y))
    if not (energy > 0.0 and scale > 0.0):
        raise ValueError(
            f"{path}: fax fay faz or the residual force are zero throughout, nothing to score against"
        )
    m = float(np.sum(r * y)) / energy if given is None else given
    misfit = float(np.sqrt(np.sum((y - m * r) ** 2) / scale))
    if given is None and (m <= 0.0 or misfit > _OTHER_FRAMES):
        raise ValueError(
            f"{path}: fax fay faz do not fit m (v' - g) with any mass: best {m:.3g} kg, misfit {100 * misfit:.0f} %, "
            f"expected below {100 * _OTHER_FRAMES:.0f} %; the world must be z up, q = (x, y, z, w) from body to world, "
            "thrust along body z; if they are, give mass="
        )
    return m, misfit


def _scan(times: FloatArray, along: FloatArray, thrust: FloatArray) -> DelayScan:
    """RMS of (specific force along the thrust axis - thrust d ago) in the band, by d."""
    h = times[1] - times[0]
    band = butter(2, [BAND[0], min(BAND[1], 0.4 / h)], "bandpass", fs=1.0 / h, output="sos")
    edge = int(
        np.ceil(1.0 / (BAND[0] * h))
    )  # a period of the band, where the two-sided filter is not settled
    delays = np.linspace(0.0, _LATEST, _STEPS)
    rms = [
        np.sqrt(np.mean(sosfiltfilt(band, along - np.interp(times - d, times, thrust))[edge:-edge] ** 2))
        for d in delays
    ]
    return DelayScan(delays, np.array(rms))
