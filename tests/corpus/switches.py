"""Switches: if, where, sign, comparisons; quantisers; steps in time."""

from __future__ import annotations

import math

import numpy as np

from tests.corpus.reference import Exit, Hybrid, scheduled, stepped, switched
from tests.corpus.system import System, block


def _jump(threshold: float, below: float, above: float) -> System:
    def build():
        return block(lambda t, x, u, p: [np.where(x[0] < threshold, below, above)])

    def answer(times, x0):
        late = (threshold - x0[0]) / below
        return np.where(times < late, x0[0] + below * times, threshold + above * (times - late))

    return System(
        f"where_{threshold:g}_{below:g}_{above:g}", "switches", "x' = where(x < c, a, b)", build, answer, 2.0, (0.0,),
        short=above == 2.0,
    )  # fmt: skip


def _branch(a: float, b: float, c: float) -> System:
    def rates(t, x, u, p):
        if x[0] >= c:
            return [a - x[0]]
        return [b - x[0]]

    def answer(times, x0):
        late = math.log((b - x0[0]) / (b - c))
        return np.where(
            times < late,
            b + (x0[0] - b) * np.exp(-times),
            a + (c - a) * np.exp(-np.maximum(times - late, 0.0)),
        )

    return System(
        f"branch_{a:g}_{b:g}_{c:g}", "switches", "x' = (a if x >= c else b) - x", lambda: block(rates), answer, 4.0,
        (0.0,), short=a == 3.0,
    )  # fmt: skip


def _two_linear(seed: int) -> System:
    """Two stable linear modes on the two sides of a plane, along which both cross."""
    generator = np.random.default_rng(seed)
    turn = np.array([[0.0, 2.0], [-2.0, 0.0]])
    A = turn - np.diag(generator.uniform(0.1, 0.4, 2))
    B = 1.7 * turn - np.diag(generator.uniform(0.1, 0.4, 2))

    def build():
        return block(lambda t, x, u, p: np.where(x[0] > 0.0, A @ x, B @ x), 2)

    return System(
        f"flip_{seed}", "switches", "x' = A x or B x by the sign of x1", build,
        switched(lambda t, x: x[0], lambda t, x: A @ x, lambda t, x: B @ x), 5.0, (1.0, 0.5), short=seed == 1,
    )  # fmt: skip


def _sign_oscillator(w: float) -> System:
    def build():
        return block(lambda t, x, u, p: [x[1], -w * np.sign(x[0])], 2)

    return System(
        f"sign_oscillator_{w:g}", "switches", "x'' = -w sign(x)", build,
        switched(lambda t, x: x[0], lambda t, x: [x[1], -w], lambda t, x: [x[1], w]), 6.0, (1.0, 0.0),
    )  # fmt: skip


def _quadrants() -> System:
    def rates(t, x, u, p):
        if x[0] > 0:
            if x[1] > 0:
                return [-1.0, 2.0 - x[1]]
            return [-2.0, 1.0]
        return [np.where(x[1] > 1.5, 1.0, 0.5), -x[1]]

    def exits(mode):
        return {
            "++": (Exit(lambda t, x: -x[0], "-high"), Exit(lambda t, x: -x[1], "+-")),
            "+-": (Exit(lambda t, x: -x[0], "-low"), Exit(lambda t, x: x[1], "++")),
            "-high": (Exit(lambda t, x: x[0], "++"), Exit(lambda t, x: 1.5 - x[1], "-low")),
            "-low": (Exit(lambda t, x: x[0], "++"), Exit(lambda t, x: x[1] - 1.5, "-high")),
        }[mode]

    known = {
        "++": lambda x: [-1.0, 2.0 - x[1]], "+-": lambda x: [-2.0, 1.0],
        "-high": lambda x: [1.0, -x[1]], "-low": lambda x: [0.5, -x[1]],
    }  # fmt: skip
    reference = Hybrid(lambda t, x, mode: known[mode](x), exits, lambda t, x: "+-")
    # It comes to x1 = 0 from below with x2 > 0 and slides there: the run ends before.
    return System(
        "quadrants",
        "switches",
        "nested ifs in two states",
        lambda: block(rates, 2),
        reference,
        0.9,
        (1.5, -0.5),
    )


def _comparison(name: str, write, surface, above, below, end, start, short=False) -> System:
    return System(
        name, "switches", f"comparison: {name}", lambda: block(write, len(start)), switched(surface, above, below),
        end, start, short=short,
    )  # fmt: skip


def _both() -> System:
    """np.logical_and of two comparisons: a box that is crossed."""

    def build():
        return block(
            lambda t, x, u, p: [1.0, np.where(np.logical_and(x[0] > 0.5, x[0] < 1.25), 2.0 + x[1], -x[1])], 2
        )

    def rates(t, x, k):
        return [1.0, 2.0 + x[1] if k == 1 else -x[1]]

    return System(
        "logical_and", "switches", "where(and(x > a, x < b), ...)", build, scheduled([0.5, 1.25], rates), 2.0,
        (0.0, 0.4),
    )  # fmt: skip


def _either() -> System:
    def rates(t, x, u, p):
        if x[0] < 0.5 or x[0] > 1.25:
            return [1.0, -x[1]]
        return [1.0, 2.0 + x[1]]

    return System(
        "or_of_two", "switches", "if x < a or x > b", lambda: block(rates, 2),
        scheduled([0.5, 1.25], lambda t, x, k: [1.0, 2.0 + x[1] if k == 1 else -x[1]]), 2.0, (0.0, 0.4),
    )  # fmt: skip


def _select() -> System:
    def build():
        return block(lambda t, x, u, p: [np.select([x[0] < 1.0, x[0] < 2.0], [1.0, 0.5], 3.0) - 0.1 * x[0]])

    def rates(t, x, k):
        return [(1.0, 0.5, 3.0)[int(np.clip(k, 0, 2))] - 0.1 * x[0]]

    return System(
        "select",
        "switches",
        "np.select of two conditions",
        build,
        stepped(lambda t, x: x[0], rates),
        4.0,
        (0.0,),
    )


def _heaviside() -> System:
    def build():
        return block(lambda t, x, u, p: [x[1], -x[0] - 0.4 * np.heaviside(x[1], 0.5)], 2)

    return System(
        "heaviside", "switches", "np.heaviside in a force", build,
        switched(lambda t, x: x[1], lambda t, x: [x[1], -x[0] - 0.4], lambda t, x: [x[1], -x[0]]), 5.0, (2.0, 0.0),
    )  # fmt: skip


# -- quantisers ---------------------------------------------------------------------------------------------------


def _quantiser(name: str, write, value, level, end, start, short=False, source="") -> System:
    """x' by a staircase of x; ``level`` is the staircase of the mode."""
    return System(
        name, "quantisers", f"staircase: {name}", lambda: block(lambda t, x, u, p: write(t, x), len(start)),
        stepped(value, lambda t, x, k: level(t, x, k)), end, start, short=short, source=source,
    )  # fmt: skip


def _sawtooth(period: float) -> System:
    def build():
        return block(lambda t, x, u, p: [np.mod(t, period) - x[0]])

    return System(
        f"sawtooth_{period:g}", "quantisers", "x' = mod(t, T) - x", build,
        stepped(lambda t, x: t / period, lambda t, x, k: [t - k * period - x[0]]), 2.0, (0.0,), short=period == 0.7,
        source="Modelica.Blocks.Sources.SawTooth into a lag" if period == 0.7 else "",
    )  # fmt: skip


def _table(speed: float) -> System:
    table = np.array([1.0, -0.5, 2.0, 0.0, 1.0])

    def build():
        return block(lambda t, x, u, p: [speed, table[int(x[0])] - x[1]], 2)

    return System(
        f"table_of_int_{speed:g}", "quantisers", "table[int(x)]", build,
        stepped(lambda t, x: x[0], lambda t, x, k: [speed, table[k] - x[1]]), 4.5 / speed - 0.1, (0.1, 0.0),
        short=speed == 1.0,
    )  # fmt: skip


def _quantised_loop(step: float) -> System:
    """A double integrator under a feedback of a quantised position and a measured speed."""

    def build():
        return block(lambda t, x, u, p: [x[1], -step * np.round(x[0] / step) - 0.7 * x[1]], 2)

    return System(
        f"quantised_position_{step:g}", "quantisers", "x'' = -q round(x/q) - d x'", build,
        stepped(lambda t, x: x[0] / step + 0.5, lambda t, x, k: [x[1], -step * k - 0.7 * x[1]]), 3.0, (1.07, 0.3),
        source="textbook: feedback through a quantised measurement" if step == 0.25 else "",
    )  # fmt: skip


# -- steps in time ------------------------------------------------------------------------------------------------


def _time(
    name: str, write, switches, rates, end, start, source="", short=False, structure="", pace=0.0
) -> System:
    return System(
        name, "time steps", structure or f"time: {name}", lambda: block(write, len(start)),
        scheduled(switches, rates), end, start, source=source, short=short, pace=pace,
    )  # fmt: skip


def _if_time(t, x, u, p):
    if t < 1:
        return [1.0 - x[0]]
    return [-0.5 - x[0]]


def _pulse(width: float, period: float) -> System:
    def build():
        return block(lambda t, x, u, p: [np.where(np.mod(t, period) < width, 1.0, 0.0) - x[0]])

    switches = sorted([k * period for k in range(1, 40)] + [k * period + width for k in range(40)])
    return _time(
        f"pulse_{width:g}_{period:g}", lambda t, x, u, p: [np.where(np.mod(t, period) < width, 1.0, 0.0) - x[0]],
        switches, lambda t, x, k: [(1.0 if k % 2 == 0 else 0.0) - x[0]], 3.3 * period, (0.0,),
        source="Modelica.Blocks.Sources.Pulse into Continuous.FirstOrder" if width == 0.3 else "",
        short=width == 0.3, structure="x' = (mod(t, T) < w) - x",
    )  # fmt: skip


def _square(frequency: float) -> System:
    return _time(
        f"square_{frequency:g}", lambda t, x, u, p: [np.sign(np.sin(2 * np.pi * frequency * t)) - x[0]],
        [k / (2 * frequency) for k in range(1, 60)], lambda t, x, k: [(1.0, -1.0)[k % 2] - x[0]],
        3.7 / frequency, (0.0,), source="textbook: square wave into a lag" if frequency == 1.0 else "",
        short=frequency == 1.0, structure="x' = sign(sin(w t)) - x",
    )  # fmt: skip


def systems() -> list[System]:
    """Of the families switches, quantisers and time steps."""
    return [
        _jump(1.0, 1.0, 2.0), _jump(1.0, 1.0, 0.25), _jump(0.3, 0.5, 4.0),
        _branch(3.0, 2.0, 1.0), _branch(1.2, 2.0, 1.0), _branch(5.0, 1.5, 1.3),
        _two_linear(1), _two_linear(2), _two_linear(3),
        _sign_oscillator(1.0), _sign_oscillator(3.0),
        _quadrants(),
        _comparison("greater_equal", lambda t, x, u, p: [1.0 + 2.0 * (x[0] >= 1.0)], lambda t, x: x[0] - 1.0,
                    lambda t, x: [3.0], lambda t, x: [1.0], 2.0, (0.0,), True),
        _comparison("less_product", lambda t, x, u, p: [(x[0] < 2.0) * (3.0 - x[0]) + (x[0] >= 2.0) * 0.5],
                    lambda t, x: x[0] - 2.0, lambda t, x: [0.5], lambda t, x: [3.0 - x[0]], 3.0, (0.0,)),
        _comparison("sign_rate", lambda t, x, u, p: [2.0 + np.sign(x[0])], lambda t, x: x[0],
                    lambda t, x: [3.0], lambda t, x: [1.0], 2.0, (-1.0,), True),
        _comparison("copysign", lambda t, x, u, p: [2.0 + np.copysign(1.0, x[0] - 0.2)], lambda t, x: x[0] - 0.2,
                    lambda t, x: [3.0], lambda t, x: [1.0], 2.0, (-1.0,)),
        _comparison("product_of_states", lambda t, x, u, p: [x[1], np.where(x[0] * x[1] > 0.0, -3.0, -1.0) * x[0]],
                    lambda t, x: x[0] * x[1], lambda t, x: [x[1], -3.0 * x[0]], lambda t, x: [x[1], -x[0]], 5.0,
                    (1.0, 0.0)),
        _comparison("circle", lambda t, x, u, p: [x[1] - 0.1 * x[0], np.where(x[0] ** 2 + x[1] ** 2 > 1.0,
            -x[0] - 0.3 * x[1], -x[0] + 0.02)],
                    lambda t, x: x[0] ** 2 + x[1] ** 2 - 1.0, lambda t, x: [x[1] - 0.1 * x[0], -x[0] - 0.3 * x[1]],
                    lambda t, x: [x[1] - 0.1 * x[0], -x[0] + 0.02], 4.0, (2.0, 0.0)),
        _both(), _either(), _select(), _heaviside(),
        _quantiser("floor", lambda t, x: [1.0 + np.floor(x[0])], lambda t, x: x[0], lambda t, x, k: [1.0 + k],
            2.0, (0.0,), True),
        _quantiser("ceil", lambda t, x: [np.ceil(x[0] + 0.2)], lambda t, x: x[0] + 0.2, lambda t, x,
            k: [k + 1.0], 1.8, (0.0,)),
        _quantiser("round", lambda t, x: [1.0 + np.round(x[0])], lambda t, x: x[0] + 0.5, lambda t, x,
            k: [1.0 + k], 2.0, (0.0,), True),
        _quantiser("mod", lambda t, x: [1.0 + np.mod(x[0], 1.0)], lambda t, x: x[0], lambda t, x,
            k: [1.0 + x[0] - k], 2.5, (0.0,)),
        _quantiser("fmod", lambda t, x: [1.0 + np.fmod(x[0], 0.75)], lambda t, x: x[0] / 0.75, lambda t, x,
            k: [1.0 + x[0] - 0.75 * k], 2.5, (0.0,)),
        _quantiser("floor_divide", lambda t, x: [1.0 + (x[0] // 0.5)], lambda t, x: x[0] / 0.5, lambda t, x,
            k: [1.0 + k], 1.6, (0.0,)),
        _quantiser("trunc", lambda t, x: [1.0 + np.trunc(x[0])], lambda t, x: x[0], lambda t, x, k: [1.0 + k],
            1.8, (0.1,)),
        _quantiser("floor_down", lambda t, x: [-np.floor(x[0])], lambda t, x: x[0], lambda t, x, k: [-k], 2.0,
            (3.5,)),
        _quantiser("parity", lambda t, x: [np.where(np.mod(np.floor(x[0]), 2.0) < 0.5, 1.0, 0.5)], lambda t, x: x[0],
                   lambda t, x, k: [1.0 if k % 2 == 0 else 0.5], 4.0, (0.0,)),
        _sawtooth(0.7), _sawtooth(0.31), _table(1.0), _table(2.5), _quantised_loop(0.25), _quantised_loop(0.6),
        _time("if_t", _if_time, [1.0], lambda t, x, k: [(1.0, -0.5)[k] - x[0]], 2.0, (0.0,), short=True),
        _time("where_t_ramp", lambda t, x, u, p: [np.where(t < 0.8, 0.0, 2.0 * (t - 0.8)) - x[0]], [0.8],
              lambda t, x, k: [(0.0 if k == 0 else 2.0 * (t - 0.8)) - x[0]], 2.0, (1.0,),
              source="Modelica.Blocks.Sources.Ramp"),
        _time("staircase_t", lambda t, x, u, p: [np.floor(3.0 * t) - x[0]], [k / 3 for k in range(1, 9)],
              lambda t, x, k: [k - x[0]], 2.2, (0.0,)),
        _time("step_second_order", lambda t, x, u, p: [x[1], 4.0 * (np.where(t < 0.5, 0.0,
            1.0) - x[0]) - 1.2 * x[1]], [0.5],
              lambda t, x, k: [x[1], 4.0 * (k - x[0]) - 1.2 * x[1]], 4.0, (0.0, 0.0),
              source="Modelica.Blocks.Examples: Step into SecondOrder"),
        _time("short_pulse", lambda t, x, u, p: [1000.0 * (t > 1.0) * (t < 1.001) - x[0]], [1.0, 1.001],
              lambda t, x, k: [(1000.0 if k == 1 else 0.0) - x[0]], 3.0, (0.0,), pace=1000.0),
        _pulse(0.3, 1.0), _pulse(0.05, 0.4), _pulse(0.9, 1.7), _square(1.0), _square(2.5),
    ]  # fmt: skip
