"""Algebraic loops with kinks and jumps: with one solution, with several, and with none."""

from __future__ import annotations

import control as ct
import numpy as np
from scipy.optimize import brentq
from scipy.special import lambertw

from tests.corpus.reference import smooth
from tests.corpus.system import System


def _loop(
    name: str,
    law,
    answer,
    inputs=None,
    source: str = "",
    short: bool = False,
    residual=None,
    switching: bool = True,
) -> System:
    """y = law(y, r): a static block whose output comes back through another one."""

    def build():
        first = ct.nlsys(
            None, lambda t, x, u, p: [law(u[0], u[1])], inputs=["y", "r"], outputs=["v"], name="law"
        )
        second = ct.nlsys(None, lambda t, x, u, p: [u[0]], inputs=["v"], outputs=["y"], name="wire")
        return ct.interconnect([first, second], inputs=["r"], outputs=["y"], name="loop")

    command = inputs or (lambda times: np.zeros((1, len(times))))
    reference = (
        None if answer is None else lambda times, x0: np.array([[answer(r) for r in command(times)[0]]])
    )
    return System(
        name, "loops", name, build, reference, 1.0, inputs=command, source=source, short=short, residual=residual,
        switching=switching, fmu=answer is not None,
    )  # fmt: skip


def _sweep(low: float, high: float):
    return lambda times: np.linspace(low, high, len(times))[None]


def _root(f, low, high):
    return lambda r: brentq(lambda y: f(y, r) - y, low, high, xtol=1e-15)


def _pair() -> System:
    """Two unknowns: y1 = sat(r - y2), y2 = 0.5 y1 + 0.2."""

    def build():
        first = ct.nlsys(
            None,
            lambda t, x, u, p: [np.clip(u[1] - u[0], -1.0, 1.0)],
            inputs=["y2", "r"],
            outputs=["y1"],
            name="first",
        )
        second = ct.nlsys(
            None, lambda t, x, u, p: [0.5 * u[0] + 0.2], inputs=["y1"], outputs=["y2"], name="second"
        )
        return ct.interconnect([first, second], inputs=["r"], outputs=["y1", "y2"], name="pair")

    def answer(times, x0):
        r = np.linspace(-3.0, 3.0, len(times))
        y1 = np.clip((r - 0.2) / 1.5, -1.0, 1.0)
        return np.array([y1, 0.5 * y1 + 0.2])

    return System(
        "loop_two_unknowns",
        "loops",
        "two unknowns, saturation",
        build,
        answer,
        1.0,
        inputs=_sweep(-3.0, 3.0),
        switching=False,
    )


def _with_state(
    name: str, law, solved, rates, end: float, start, exists: bool = True, source="", switching=False
) -> System:
    """x' = rates(y, x), y = law(y, x)."""

    def build():
        first = ct.nlsys(
            None, lambda t, x, u, p: [law(u[0], u[1])], inputs=["y", "x"], outputs=["v"], name="law"
        )
        second = ct.nlsys(None, lambda t, x, u, p: [u[0]], inputs=["v"], outputs=["y"], name="wire")
        plant = ct.nlsys(
            lambda t, x, u, p: [rates(u[0], x[0])],
            lambda t, x, u, p: [x[0]],
            inputs=["y"],
            outputs=["x"],
            states=1,
            name="plant",
        )
        return ct.interconnect([first, second, plant], inputs=[], outputs=["x", "y"], inplist=[], name="loop")

    reference = None
    if exists:
        reference = smooth(
            lambda t, x: [rates(solved(x[0]), x[0])], outputs=lambda t, x, mode: [x[0], solved(x[0])]
        )
    return System(
        name, "loops", name, build, reference, end, start, source=source, switching=switching, fmu=exists
    )


def systems() -> list[System]:
    """Of the family loops."""
    kinked = lambda y, r: r - 0.5 * np.abs(y)  # noqa: E731
    thermal, drop = 0.026, 1000.0 * 1e-12  # V; V at the saturation current of the diode
    return [
        _loop("loop_saturation", lambda y, r: np.clip(r - y, -1.0, 1.0), lambda r: float(np.clip(r / 2.0, -1.0,
            1.0)), _sweep(-4.0, 4.0), switching=False, short=True),
        _loop("loop_abs", kinked, lambda r: r / 1.5 if r > 0 else 2.0 * r, _sweep(-2.0, 2.0), switching=False),
        _loop("loop_dead_zone", lambda y, r: r - 2.0 * (y - np.clip(y, -0.5, 0.5)),
            lambda r: r if abs(r) <= 0.5 else (r + np.sign(r)) / 3.0, _sweep(-2.0, 2.0), switching=False),
        _loop("loop_maximum", lambda y, r: np.maximum(0.0, r - 0.5 * y), lambda r: max(0.0, r / 1.5),
            _sweep(-1.0, 2.0), switching=False),
        _loop("loop_tanh", lambda y, r: np.tanh(r - 2.0 * y), _root(lambda y, r: np.tanh(r - 2.0 * y), -1.0,
            1.0), _sweep(-3.0, 3.0), switching=False),
        _loop("loop_cosine", lambda y, r: np.cos(y) + 0.0 * r, _root(lambda y, r: np.cos(y), 0.0, 1.0),
            source="textbook: the fixed point of the cosine", switching=False, short=True),
        _loop("loop_cubic", lambda y, r: r - y**3, _root(lambda y, r: r - y**3, -3.0, 3.0), _sweep(-4.0, 4.0),
            switching=False),
        _loop("loop_affine", lambda y, r: 2.0 * np.cos(5.0 * r) - 0.2 * y,
            lambda r: 2.0 * np.cos(5.0 * r) / 1.2, _sweep(0.0, 1.0),
            source="PathSim examples/example_algebraicloop.py", switching=False),
        _loop("loop_diode", lambda v, r: r - drop * (np.exp(v / thermal) - 1.0),
              lambda r: r + drop - thermal * float(np.real(lambertw(drop / thermal * np.exp((r + drop) / thermal)))),
              _sweep(-1.0, 5.0), "PathSim examples/example_diode.py", switching=False),
        _loop("loop_floor", lambda y, r: 1.9 - 0.5 * np.floor(y), lambda r: 1.4, short=True),
        _loop("loop_floor_rising", lambda y, r: 0.5 * np.floor(y) + 1.9, lambda r: 2.9, residual=lambda y,
            r: 0.5 * np.floor(y) + 1.9 - y),
        _loop("loop_sign", lambda y, r: r + 0.5 * np.sign(y), lambda r: r + 0.5, _sweep(0.6, 2.0)),
        _loop("loop_sign_falling", lambda y, r: r - 0.5 * np.sign(y), lambda r: r - 0.5, _sweep(0.6, 2.0)),
        _loop("loop_two_solutions", lambda y, r: np.where(y > 1.0, 3.0, 0.5), lambda r: 0.5, residual=lambda y,
            r: (3.0 if y > 1 else 0.5) - y),
        _loop("loop_square", lambda y, r: 0.25 * y**2 + r, lambda r: 2.0 - 2.0 * np.sqrt(1.0 - r), _sweep(-1.0,
            0.9), residual=lambda y, r: 0.25 * y**2 + r - y, switching=False),
        _loop("none_sign", lambda y, r: -2.0 * np.sign(y) + 0.5, None, short=True),
        _loop("none_where", lambda y, r: np.where(y > 1.0, 0.0, 2.0), None),
        _loop("none_parabola", lambda y, r: y**2 + 1.0, None, short=True),
        _loop("none_exponential", lambda y, r: np.exp(y), None),
        _loop("none_affine", lambda y, r: y + 2.0, None),
        _loop("none_floor", lambda y, r: 1.2 - np.floor(y), None),
        _loop("none_for_some", lambda y, r: y**2 + r, None, _sweep(0.0, 0.5)),
        _loop("none_abs", lambda y, r: np.abs(y) + 1.0, None),
        _loop("none_relay", lambda y, r: np.where(y >= 0.0, -1.0, 1.0), None),
        _pair(),
        _with_state("loop_saturated_plant", lambda y, x: np.clip(2.0 - 3.0 * x - y, -0.5, 0.5),
            lambda x: float(np.clip(1.0 - 1.5 * x, -0.5, 0.5)), lambda y, x: y - 0.2 * x, 6.0, (-1.0,)),
        _with_state("loop_cubic_plant", lambda y, x: 1.0 - x - y**3,
            lambda x: brentq(lambda y: 1.0 - x - y**3 - y, -5, 5, xtol=1e-15), lambda y, x: y, 5.0, (-2.0,),
            source="PathSim examples/example_algebraicchain.py, its idea"),
        _with_state("none_after_a_fold", lambda y, x: y**2 + x, None, lambda y, x: 0.2 + 0.0 * y, 3.0, (0.0,),
            exists=False),
        _with_state("none_after_a_jump", lambda y, x: np.where(y > 1.0, 0.0, x), None, lambda y,
            x: 0.5 + 0.0 * y, 4.0, (0.2,), exists=False),
    ]  # fmt: skip
