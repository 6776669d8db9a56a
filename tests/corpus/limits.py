"""Saturations, dead zones, limits of rate, anti-windup, tables of values: kinks."""

from __future__ import annotations

import control as ct
import numpy as np

import phyfilter_ctl as pf
from tests.corpus.reference import Exit, Hybrid, switched
from tests.corpus.system import System, block


def _pieces(
    name: str, write, breaks, value, rates, end: float, start, source: str = "", short: bool = False,
    structure: str = "", family: str = "limits",
) -> System:  # fmt: skip
    """A continuous law in pieces of a value: mode k between the breaks k - 1 and k."""
    breaks = list(breaks)

    def exits(k):
        found = []
        if k < len(breaks):
            found.append(Exit(lambda t, x: value(t, x) - breaks[k], k + 1))
        if k > 0:
            found.append(Exit(lambda t, x: breaks[k - 1] - value(t, x), k - 1))
        return found

    reference = Hybrid(rates, exits, lambda t, x: int(np.searchsorted(breaks, value(t, x))))
    return System(
        name, family, structure or name, lambda: block(lambda t, x, u, p: write(t, x), len(start)), reference,
            end, start,
        source=source, switching=False, short=short,
    )  # fmt: skip


def _saturated_loop(limit: float) -> System:
    def clip(k, v):
        return (-limit, v, limit)[k]

    def command(x):
        return 3.0 * (1.0 - x[0]) - 1.5 * x[1]

    return _pieces(
        f"saturated_position_{limit:g}", lambda t, x: [x[1], np.clip(command(x), -limit, limit)], [-limit, limit],
        lambda t, x: command(x), lambda t, x, k: [x[1], clip(k, command(x))], 8.0, (-1.0, 0.0), short=limit == 0.4,
        structure="x'' = clip(k (r - x) - d x')",
        source="",
    )  # fmt: skip


def _minmax() -> System:
    def command(x):
        return 2.0 - x[0] - x[1]

    return _pieces(
        "min_max", lambda t, x: [x[1], np.minimum(np.maximum(command(x), -0.3), 0.9)], [-0.3, 0.9],
        lambda t, x: command(x), lambda t, x, k: [x[1], (-0.3, command(x), 0.9)[k]], 8.0, (-1.0, 0.0),
    )  # fmt: skip


def _dead_zone(width: float) -> System:
    def write(t, x):
        return [x[1], -4.0 * (x[0] - np.clip(x[0], -width, width)) - 0.2 * x[1]]

    return _pieces(
        f"dead_zone_{width:g}", write, [-width, width], lambda t, x: x[0],
        lambda t, x, k: [x[1], -4.0 * (x[0] + width, 0.0, x[0] - width)[k] - 0.2 * x[1]], 8.0, (1.0, 0.5),
        structure="spring with a dead zone", short=width == 0.2,
        source="Modelica.Blocks.Nonlinear.DeadZone; play in a spring" if width == 0.2 else "",
    )  # fmt: skip


def _elastic_stop() -> System:
    """A mass between two elastic stops, by ifs."""

    def write(t, x):
        force = np.sin(1.1 * t)
        if x[0] > 0.4:
            return [x[1], force - 50.0 * (x[0] - 0.4)]
        if x[0] < -0.3:
            return [x[1], force - 50.0 * (x[0] + 0.3)]
        return [x[1], force]

    return _pieces(
        "elastic_stops", write, [-0.3, 0.4], lambda t, x: x[0],
        lambda t, x, k: [x[1], np.sin(1.1 * t) - 50.0 * (x[0] + 0.3, 0.0, x[0] - 0.4)[k]], 6.0, (0.0, 0.0),
        source="Modelica.Mechanics.Translational.Components.ElastoGap, its text",
    )  # fmt: skip


def _damped_stop() -> System:
    """A contact with damping: its force jumps where it begins."""

    def build():
        return block(
            lambda t, x, u, p: [x[1], -9.81 - np.where(x[0] < 0.0, 1000.0 * x[0] + 10.0 * x[1], 0.0)], 2
        )

    reference = switched(
        lambda t, x: x[0],
        lambda t, x: [x[1], -9.81],
        lambda t, x: [x[1], -9.81 - 1000.0 * x[0] - 10.0 * x[1]],
    )
    return System(
        "damped_contact", "limits", "contact force k x + d x' where x < 0", build, reference, 2.0, (1.0, 0.0),
            short=True,
        source="Modelica.Mechanics.Translational: ElastoGap with damping, its text",
    )  # fmt: skip


def _absolute(
    name: str, write, below, above, end: float, start, value=lambda t, x: x[0], source: str = ""
) -> System:
    reference = switched(value, above, below)
    return System(
        name, "limits", name, lambda: block(lambda t, x, u, p: write(t, x), len(start)), reference, end, start,
        source=source, switching=False,
    )  # fmt: skip


def _rate_limit(limit: float) -> System:
    """A rate limiter as a fast lag whose rate is clipped, behind a sine."""

    def want(t, x):
        return 8.0 * (np.sin(2.0 * t) - x[0])

    return _pieces(
        f"rate_limit_{limit:g}", lambda t, x: [np.clip(want(t, x), -limit, limit), x[0] - x[1]], [-limit,
            limit], want,
        lambda t, x, k: [(-limit, want(t, x), limit)[k], x[0] - x[1]], 6.0, (0.0, 0.0), structure="rate limiter",
        source="Modelica.Blocks.Nonlinear.SlewRateLimiter, its text" if limit == 1.2 else "",
    )  # fmt: skip


def _back_calculation(kp: float, limit: float) -> System:
    """A PI law with back-calculation on an integrator with a lag, after a large step."""

    def raw(x):
        return kp * (2.0 - x[0]) + x[2]

    def rates(t, x, k):
        v = raw(x)
        s = (-limit, v, limit)[k]
        return [x[1], s - x[1], 1.2 * (2.0 - x[0]) + (s - v) / 0.5]

    def write(t, x):
        v = kp * (2.0 - x[0]) + x[2]
        s = np.clip(v, -limit, limit)
        return [x[1], s - x[1], 1.2 * (2.0 - x[0]) + (s - v) / 0.5]

    return _pieces(
        f"back_calculation_{kp:g}_{limit:g}", write, [-limit, limit], lambda t, x: raw(x), rates, 12.0,
        (0.0, 0.0, 0.0), structure="PI law with back-calculation", short=kp == 2.0,
        source="K. J. Astrom and T. Hagglund, PID Controllers: anti-windup" if kp == 2.0 else "",
    )  # fmt: skip


def _conditional() -> System:
    """Anti-windup by conditional integration: the integrator stops while the command is beyond its limits."""

    def raw(x):
        return 2.0 * (1.0 - x[0]) + x[1]

    def write(t, x):
        v = 2.0 * (1.0 - x[0]) + x[1]
        return [np.clip(v, -0.5, 0.5) - 0.2 * x[0], np.where(np.abs(v) < 0.5, 1.0 - x[0], 0.0)]

    def rates(t, x, k):
        v = raw(x)
        return [(-0.5, v, 0.5)[k] - 0.2 * x[0], 1.0 - x[0] if k == 1 else 0.0]

    made = _pieces(
        "conditional_integration", write, [-0.5, 0.5], lambda t, x: raw(x), rates, 8.0, (0.0, 0.0),
        source="K. J. Astrom and T. Hagglund, PID Controllers: conditional integration",
    )  # fmt: skip
    return System(**{**vars(made), "switching": True})


def _water_wheel() -> System:
    def build():
        return block(lambda t, x, u, p: [1.0 - 0.6 * np.sqrt(np.maximum(x[0] - 0.5, 0.0))], 1)

    return System(
        "overflow", "limits", "flow over an edge: sqrt(max(x - h, 0))", build,
        switched(lambda t, x: x[0] - 0.5, lambda t, x: [1.0 - 0.6 * np.sqrt(np.maximum(x[0] - 0.5, 0.0))],
            lambda t, x: [1.0]),
        6.0, (0.0,), switching=False,
    )  # fmt: skip


# -- tables -------------------------------------------------------------------------------------------------------

_AT, _VALUES = np.array([-1.0, 0.0, 0.5, 2.0]), np.array([2.0, 0.3, 1.1, -1.0])


def _line(k: int, v: float) -> float:
    if k == 0:
        return float(_VALUES[0])
    if k == len(_AT):
        return float(_VALUES[-1])
    return _VALUES[k - 1] + (_VALUES[k] - _VALUES[k - 1]) * (v - _AT[k - 1]) / (_AT[k] - _AT[k - 1])


def _interp(name: str, write, value, rates, end, start, source="", short=False) -> System:
    return _pieces(name, write, _AT, value, rates, end, start, source, short, f"table: {name}", "tables")


def _lookup_block() -> System:
    def build():
        table = pf.lookup_table(_AT, _VALUES, inputs="place", outputs="force", name="table")
        mass = ct.nlsys(
            lambda t, x, u, p: [x[1], u[0] - 0.3 * x[1]], lambda t, x, u, p: [x[0]], inputs=["force"],
            outputs=["place"], states=2, name="mass",
        )  # fmt: skip
        return ct.interconnect([table, mass], inputs=[], outputs=["place"], inplist=[], name="table_loop")

    made = _interp(
        "x",
        lambda t, x: x,
        lambda t, x: x[0],
        lambda t, x, k: [x[1], _line(k, x[0]) - 0.3 * x[1]],
        8.0,
        (-1.5, 0.0),
    )
    reference = Hybrid(
        made.reference.rates, made.reference.exits, made.reference.start, lambda t, x, k: [x[0]]
    )
    return System("lookup_table_block", "tables", "table: block in a loop", build, reference, 8.0, (-1.5, 0.0),
        switching=False,
                  source="Modelica.Blocks.Tables.CombiTable1Ds, its text")  # fmt: skip


def _time_table() -> System:
    at, values = np.array([0.0, 0.7, 1.0, 2.2, 3.0]), np.array([0.0, 1.0, -0.5, 0.5, 0.5])

    def line(k, t):
        k = min(max(k, 1), len(at) - 1)
        return values[k - 1] + (values[k] - values[k - 1]) * (t - at[k - 1]) / (at[k] - at[k - 1])

    return _pieces(
        "time_table", lambda t, x: [np.interp(t, at, values) - x[0]], at[1:-1], lambda t, x: t,
        lambda t, x, k: [line(k + 1, t) - x[0]], 3.0, (0.2,), family="tables",
        source="Modelica.Blocks.Sources.TimeTable, its text", structure="table: interp in time",
    )  # fmt: skip


def _engine() -> System:
    """A motor whose torque is a table of speed, against a load."""
    speeds, torques = np.array([0.0, 100.0, 250.0, 400.0]), np.array([40.0, 120.0, 160.0, 90.0])

    def torque(k, v):
        if k in (0, len(speeds)):
            return float(torques[0] if k == 0 else torques[-1])
        return torques[k - 1] + (torques[k] - torques[k - 1]) * (v - speeds[k - 1]) / (
            speeds[k] - speeds[k - 1]
        )

    return _pieces(
        "engine_map", lambda t, x: [(np.interp(x[0], speeds, torques) - 0.001 * x[0] ** 2) / 0.8], speeds,
            lambda t, x: x[0],
        lambda t, x, k: [(torque(k, x[0]) - 0.001 * x[0] ** 2) / 0.8], 4.0, (20.0,), family="tables",
            structure="table: engine",
    )  # fmt: skip


def systems() -> list[System]:
    """Of the families limits and tables."""
    return [
        _saturated_loop(0.4), _saturated_loop(1.5), _minmax(), _dead_zone(0.2), _dead_zone(0.6),
            _elastic_stop(), _damped_stop(),
        _absolute("absolute_spring", lambda t, x: [x[1], -x[0] * (1.0 + np.abs(x[0]))], lambda t, x: [x[1],
            -x[0] * (1.0 - x[0])],
                  lambda t, x: [x[1], -x[0] * (1.0 + x[0])], 8.0, (1.0, 0.0)),
        _absolute("bilinear_spring", lambda t, x: [x[1], np.where(x[0] > 0, -x[0], -4.0 * x[0])], lambda t,
            x: [x[1], -4.0 * x[0]],
                  lambda t, x: [x[1], -x[0]], 9.0, (1.0, 0.0),
                  source="textbook: bilinear oscillator, S. W. Shaw and P. J. Holmes, 1983"),
        _absolute("rectifier", lambda t, x: [np.maximum(np.sin(3.0 * t), 0.0) - 0.5 * x[0]], lambda t,
            x: [-0.5 * x[0]],
                  lambda t, x: [np.sin(3.0 * t) - 0.5 * x[0]], 5.0, (0.0,), value=lambda t, x: np.sin(3.0 * t),
                  source="Modelica.Electrical.Analog.Examples.Rectifier, its idea"),
        _absolute("diode_charge", lambda t, x: [np.maximum(np.sin(4.0 * t) - x[0], 0.0) * 20.0 - 0.3 * x[0]],
            lambda t, x: [-0.3 * x[0]],
                  lambda t, x: [20.0 * (np.sin(4.0 * t) - x[0]) - 0.3 * x[0]], 4.0, (0.0,), value=lambda t,
                  x: np.sin(4.0 * t) - x[0],
                  source="textbook: peak detector"),
        _rate_limit(1.2), _rate_limit(0.5), _back_calculation(2.0, 0.6), _back_calculation(4.0, 1.0),
            _conditional(), _water_wheel(),
        _interp("interp_force", lambda t, x: [x[1], np.interp(x[0], _AT, _VALUES) - 0.3 * x[1]], lambda t, x: x[0],
                lambda t, x, k: [x[1], _line(k, x[0]) - 0.3 * x[1]], 8.0, (-1.5, 0.0), short=True),
        _interp("interp_scalar", lambda t, x: [1.5 - np.interp(x[0], _AT, _VALUES)], lambda t, x: x[0],
                lambda t, x, k: [1.5 - _line(k, x[0])], 1.5, (-0.4,)),
        _lookup_block(), _time_table(), _engine(),
    ]  # fmt: skip
