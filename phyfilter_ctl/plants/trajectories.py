"""Reference trajectories as blocks of time: position, velocity, acceleration and jerk."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .algebra import Array
from .declaration import Columns, Declaration
from .factory import Plant, Results, plant

__all__ = ["circle", "lemniscate", "trajectory", "waypoints"]

_OUTPUTS = {
    "r_ref": ("m", "wanted position"),
    "v_ref": ("m/s", "wanted velocity"),
    "a_ref": ("m/s^2", "wanted acceleration"),
    "j_ref": ("m/s^3", "wanted jerk"),
}


def trajectory(
    position: Callable[[Array, Columns], Any],
    *,
    params: Mapping[str, Declaration] | None = None,
    name: str = "reference",
) -> Plant:
    """A reference from its position over time; velocity, acceleration and jerk are its exact derivatives.

    Parameters
    ----------
    position : function (t, p) -> (n,) array or list
        Position in m at the time t in s, written as for :func:`plant`; ``p.name`` reads a parameter.
    params : dict, optional
        As for :func:`plant`: name -> start, (start, unit) or (start, unit, description).
    name : str
        Name of the block.

    Returns
    -------
    Plant
        Static, without inputs. Outputs r_ref (m), v_ref (m/s), a_ref (m/s^2) and j_ref (m/s^3).

    Raises
    ------
    ValueError, TypeError
        For a position that cannot be traced, as for :func:`plant`.

    Notes
    -----
    Where the position has a corner, as that of ``np.clip``, the derivatives are those of one side.

    Examples
    --------
    Up and down by 0.5 m:

    >>> bob = trajectory(lambda t, p: [0.0, 0.0, 1.0 + p.size * np.sin(t)], params={"size": (0.5, "m")})
    >>> bob.output(0.5 * np.pi, [], []).reshape(4, 3)[:, 2].round(9).tolist()
    [1.5, 0.0, -0.5, -0.0]
    """

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
        given = position(t, p)
        r = ca.SX(ca.vertcat(*given) if isinstance(given, list | tuple | np.ndarray) else given)
        v = ca.jacobian(r, t)
        a = ca.jacobian(v, t)
        return {}, {"r_ref": r, "v_ref": v, "a_ref": a, "j_ref": ca.jacobian(a, t)}

    return plant(equations, states={}, outputs=_OUTPUTS, params=params, name=name)


def circle(
    *,
    radius: float = 1.5,
    speed: float = 2.0,
    height: float = 1.5,
    ramp: float = 3.0,
    name: str = "reference",
) -> Plant:
    """A level circle about the z axis that is sped up smoothly from rest.

        r = (R cos phi, R sin phi, h),   phi' = (V/R) S(t/T),   S(s) = s^3 (10 - 15 s + 6 s^2) up to s = 1, then 1

    Parameters
    ----------
    radius : float
        R in m. The flight begins at (R, 0, h), towards y.
    speed : float
        V in m/s; negative: clockwise.
    height : float
        h in m.
    ramp : float
        T in s.
    name : str
        Name of the block.

    Returns
    -------
    Plant
        As :func:`trajectory`; jerk is continuous. Parameters speed, radius, height and ramp.

    Raises
    ------
    ValueError
        For a radius or a ramp that is not positive.

    Examples
    --------
    >>> r, v, a, j = circle().output(60.0, [], []).reshape(4, 3)
    >>> round(float(np.hypot(*v[:2])), 9), round(float(np.hypot(*a[:2])), 9)
    (2.0, 2.666666667)
    """
    params = {
        "speed": (_signals.number("speed", speed, "m/s"), "m/s", "on the circle"),
        "radius": (_signals.number("radius", radius, "m", above=0.0), "m", "of the circle"),
        "height": (_signals.number("height", height, "m"), "m", "above the origin"),
    }
    return _rounds(
        lambda phi, p: ca.vertcat(p.radius * ca.cos(phi), p.radius * ca.sin(phi), p.height),
        lambda p: p.speed / p.radius,
        params,
        ramp,
        name,
    )


def lemniscate(
    *,
    length: float = 3.0,
    width: float = 1.5,
    period: float = 8.0,
    height: float = 1.5,
    ramp: float = 3.0,
    name: str = "reference",
) -> Plant:
    """A level figure of eight through the origin, Gerono's, that is sped up smoothly from rest.

        r = (L/2 sin phi, W/2 sin 2 phi, h),   phi' = (2 pi/P) S(t/T)

    with S of :func:`circle`.

    Parameters
    ----------
    length, width : float
        L along x and W along y in m.
    period : float
        P of one figure in s; negative: the other way round.
    height : float
        h in m.
    ramp : float
        T in s.
    name : str
        Name of the block.

    Returns
    -------
    Plant
        As :func:`trajectory`; jerk is continuous. Parameters length, width, period, height and ramp.

    Raises
    ------
    ValueError
        For a ramp that is not positive, or a period of 0.

    Examples
    --------
    >>> lemniscate().output(0.0, [], [])[:3].tolist()
    [0.0, 0.0, 1.5]
    """
    if not _signals.number("period", period, "s"):
        raise ValueError("period: expected the time of one figure in s, not 0")
    params = {
        "length": (_signals.number("length", length, "m"), "m", "along x"),
        "width": (_signals.number("width", width, "m"), "m", "along y"),
        "period": (period, "s", "of one figure"),
        "height": (_signals.number("height", height, "m"), "m", "above the origin"),
    }
    return _rounds(
        lambda phi, p: ca.vertcat(0.5 * p.length * ca.sin(phi), 0.5 * p.width * ca.sin(2.0 * phi), p.height),
        lambda p: 2.0 * np.pi / p.period,
        params,
        ramp,
        name,
    )


def _rounds(
    path: Callable[[Array, Columns], Array],
    full: Callable[[Columns], Array],
    params: Mapping[str, Declaration],
    ramp: float,
    name: str,
) -> Plant:
    """A path over its angle phi, whose rate goes from 0 to ``full`` within the ramp."""
    ramp = _signals.number("ramp", ramp, "s", above=0.0)

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
        rate, s = full(p), np.fmax(np.fmin(t / p.ramp, 1.0), 0.0)
        # Clipped s makes each derivative right on both sides of the ramp's ends, without a jump in the expressions.
        phi = rate * (p.ramp * s**4 * (2.5 - 3.0 * s + s**2) + np.fmax(t - p.ramp, 0.0))
        d1 = rate * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        d2 = rate / p.ramp * 30.0 * s**2 * (1.0 - s) ** 2
        d3 = rate / p.ramp**2 * 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)
        angle = ca.SX.sym("phi")
        slopes = [path(angle, p)]
        for _ in range(3):
            slopes.append(ca.jacobian(slopes[-1], angle))
        r, first, second, third = ca.substitute(slopes, [angle], [phi])
        return {}, {
            "r_ref": r,
            "v_ref": d1 * first,
            "a_ref": d2 * first + d1**2 * second,
            "j_ref": d3 * first + 3.0 * d1 * d2 * second + d1**3 * third,
        }

    declared = {**params, "ramp": (ramp, "s", "in which it speeds up")}
    return plant(equations, states={}, outputs=_OUTPUTS, params=declared, name=name)


def waypoints(times: ArrayLike, points: ArrayLike, *, name: str = "reference") -> Plant:
    """From point to point, at rest at each, with continuous jerk.

        r = p_i + (p_(i+1) - p_i) S((t - t_i)/(t_(i+1) - t_i)),     S(s) = s^4 (35 - 84 s + 70 s^2 - 20 s^3)

    S has the least snap of all ways from rest to rest. A point given twice is held in between.

    Parameters
    ----------
    times : (n,) array
        t_i in s, when each point is reached; before the first and after the last it holds those.
    points : (n, 3) array
        p_i in m.
    name : str
        Name of the block.

    Returns
    -------
    Plant
        As :func:`trajectory`. Parameters times and points.

    Raises
    ------
    ValueError
        For times that do not increase, or points of another shape.

    Examples
    --------
    Up by 1 m within 2 s:

    >>> lift = waypoints([1.0, 3.0], [[0.0, 0.0, 0.5], [0.0, 0.0, 1.5]])
    >>> [float(lift.output(t, [], [])[2].round(9)) for t in (0.0, 1.0, 2.0, 3.0, 9.0)]
    [0.5, 0.5, 1.0, 1.5, 1.5]
    """
    at = _signals.real("times", times)
    if at.ndim != 1 or not at.size or (np.diff(at) <= 0.0).any():
        raise ValueError(f"times: expected one increasing time a point in s, got {times!r}")
    given = _signals.array("points", points, (at.size, 3))

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
        found = [p.points[0, :].T, *[ca.SX.zeros(3)] * 3]
        for i in range(at.size - 1):
            length = p.times[i + 1] - p.times[i]
            s = np.fmax(np.fmin((t - p.times[i]) / length, 1.0), 0.0)
            way = (p.points[i + 1, :] - p.points[i, :]).T
            shares = (
                s**4 * (35.0 - 84.0 * s + 70.0 * s**2 - 20.0 * s**3),
                140.0 * (s * (1.0 - s)) ** 3 / length,
                420.0 * (s * (1.0 - s)) ** 2 * (1.0 - 2.0 * s) / length**2,
                840.0 * s * (1.0 - s) * (1.0 - 5.0 * s + 5.0 * s**2) / length**3,
            )
            found = [total + way * share for total, share in zip(found, shares, strict=True)]
        return {}, dict(zip(_OUTPUTS, found, strict=True))

    params = {"times": (at, "s", "when each point is reached"), "points": (given, "m", "to be reached")}
    return plant(equations, states={}, outputs=_OUTPUTS, params=params, name=name)
