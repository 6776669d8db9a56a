"""Python as engineers write it in blocks: traced, or run as Python, and equal to the original either way."""

import math
from functools import partial, reduce

import control as ct
import numpy as np
import pytest
from numpy import cos, sin

import phyfilter_ctl as pf
from phyfilter_ctl.diagram import flatten

A = np.array([[0.0, 1.0], [-2.0, -0.4]])
TABLE = ([0.0, 1.0, 3.0, 7.0], [2.0, -1.0, 0.5, 4.0])
GEARS = [40, 25, 16, 12, 10]


def filled(t, x, u, params):
    dx = np.zeros(2)
    dx[0] = x[1]
    dx[1:] = u[0] - x[0]
    return dx


def filled_like(t, x, u, params):
    dx = np.zeros_like(x)
    dx[:] = A @ x
    dx[1] += u[0]
    return dx


def updated_in_place(t, x, u, params):
    x += 0.5 * u[0]
    x[0] *= 2.0
    return x


def through_branches(t, x, u, params):
    if x[0] > 1.0 and not u[0] < 0.0:
        rate = 2.0 * x[1]
    elif abs(x[0]) < 0.2 or t > 2.0:
        rate = -(x[1] ** 2)
    else:
        rate = 0.3
    return [rate, u[1] if 0.0 <= x[1] <= 1.0 else -u[1]]


def helper(angle, gain=2.0):
    return gain * math.sin(angle) + float(angle)


def imported_inside(t, x, u, params):
    import math as m
    from math import atan2

    return [m.cos(x[0]), atan2(u[0], x[1])]


def with_loops(t, x, u, params):
    total = 0.0
    for i, value in enumerate(x):
        total += (i + 1) * value
    return [total, sum(a * b for a, b in zip(x, u, strict=True))]


def solved(t, x, u, params):
    inertia = np.array([[2.0 + cos(x[0]), 0.5 * sin(x[1])], [0.5 * sin(x[1]), 3.0]])
    return np.linalg.solve(inertia, u - x)


def inverted(t, x, u, params):
    R = np.array([[np.cos(x[0]), -np.sin(x[0])], [np.sin(x[0]), np.cos(x[0])]])
    return np.linalg.inv(R) @ u + np.linalg.det(R + np.eye(2))


def saturated(t, x, u, params):
    return [min(max(u[0], -1.0), 1.0), np.clip(u[1], -0.5, 0.5)]


def picked(t, x, u, params):
    return [GEARS[int(u[0]) - 1] * x[0], np.array([1.0, -2.0, 4.0])[round(abs(u[1]))]]


class Motor:
    gain = 3.0

    def rate(self, t, x, u, params):
        return [self.gain * x[1], math.tanh(u[0])]


TRACED = {
    "math.sin": lambda t, x, u, p: [math.sin(x[0]), math.exp(-x[1] ** 2)],
    "math.hypot, atan2": lambda t, x, u, p: [math.hypot(x[0], x[1]), math.atan2(u[0], x[0])],
    "math.pow, fabs, copysign": lambda t, x, u, p: [
        math.pow(abs(x[0]), 1.5),
        math.copysign(2.0, u[0]) * math.fabs(x[1]),
    ],
    "math.log with base, radians": lambda t, x, u, p: [math.log(1.0 + x[0] ** 2, 10), math.radians(u[0]) + math.pi],
    "math.floor, ceil, trunc": lambda t, x, u, p: [math.floor(x[0]) + math.ceil(x[1]), math.trunc(u[0])],
    "from numpy import": lambda t, x, u, p: [sin(x[0]), cos(u[0]) * x[1]],
    "float": lambda t, x, u, p: [float(x[0]) ** 2, np.float64(u[1])],
    "int, round": lambda t, x, u, p: [int(3.0 * x[0]), round(u[0])],
    "round with digits": lambda t, x, u, p: [round(x[0], 1), np.round(u[0], 2)],
    "filled in place": filled,
    "filled like the state": filled_like,
    "arguments updated in place": updated_in_place,
    "np.empty, slices": lambda t, x, u, p: np.concatenate([x[1:], -x[:1]]) + u,
    "if, elif, and, or, not, chained": through_branches,
    "conditional expression": lambda t, x, u, p: [x[0] if x[0] > 0.3 else 2 * u[0], 1.0 if t > 1 else x[1]],
    "min, max": saturated,
    "max of a list, of an array": lambda t, x, u, p: [max([x[0], x[1], 0.0]), np.max(u) - x.min()],
    "a list that a signal indexes": picked,
    "while with a count": lambda t, x, u, p: reduce(lambda a, _: a + 0.1 * (u - a), range(3), x),
    "loops, sum, zip": with_loops,
    "a helper with float and math": lambda t, x, u, p: [helper(x[0]), helper(u[0], gain=x[1])],
    "imports inside": imported_inside,
    "a method": Motor().rate,
    "functools.partial": partial(lambda k, t, x, u, p: [k * math.sin(x[0]), u[0]], 2.0),
    "np.where": lambda t, x, u, p: np.where(x > u, x, -2.0 * u),
    "np.where of numbers": lambda t, x, u, p: [np.where(u[0] > 0.0, x[0], -x[0]), np.where(x[1] < 0.0, 0.0, 1.0)],
    "np.select": lambda t, x, u, p: np.select([x < -0.5, x > 0.5], [-u, u], default=0.1),
    "np.clip, np.maximum, np.minimum": lambda t, x, u, p: [
        np.clip(x[0], -0.3, u[0] ** 2),
        np.maximum(x, u).sum() + np.minimum(x[1], 0),
    ],
    "a mask as factor": lambda t, x, u, p: (x > 0.0) * u + (x <= 0.0) * x,
    "np.sign, np.abs, np.heaviside": lambda t, x, u, p: [np.sign(x[0]) * np.abs(u[0]), np.heaviside(x[1], 0.5)],
    "np.interp": lambda t, x, u, p: [np.interp(x[0], *TABLE), np.interp(u[0], *TABLE, left=0.0, right=9.0)],
    "np.interp of an array": lambda t, x, u, p: np.interp(3.0 * x, *TABLE),
    "np.linalg.solve": solved,
    "np.linalg.inv, det": inverted,
    "np.linalg.norm": lambda t, x, u, p: [np.linalg.norm(x), np.linalg.norm([u[0], u[1], 1.0], 1)],
    "matrix products": lambda t, x, u, p: A @ x + A.T.dot(u) * (x @ u),
    "np.dot, np.outer, np.cross": lambda t, x, u, p: [
        np.dot(x, u) + np.outer(x, u)[0, 1],
        np.cross([*x, 1.0], [*u, 0.0])[2],
    ],
    "np.array of arrays, reshape, transpose": lambda t, x, u, p: (
        np.array([x, u]).reshape(2, 2).T @ np.array([1.0, 2.0])
    ),
    "np.hstack, np.vstack, np.stack": lambda t, x, u, p: (
        np.vstack([x, u])[:, 0] + np.hstack([x[0], u[:1]]) + np.stack((x, u))[1]
    ),
    "np.eye, np.diag, np.ones": lambda t, x, u, p: np.eye(2) @ x + np.diag([2.0, 3.0]) @ u + np.ones(2),
    "np.sum, np.mean, np.prod, np.cumsum": lambda t, x, u, p: [np.sum(x) + np.mean(u), np.prod(x) - np.cumsum(u)[1]],
    "np.mod, floor_divide, divmod": lambda t, x, u, p: [np.mod(x[0], 0.7), x[1] // 0.3 + divmod(u[0], 2.0)[1]],
    "wrapping of angles": lambda t, x, u, p: [
        (x[0] + np.pi) % (2 * np.pi) - np.pi,
        np.arctan2(np.sin(u[0]), np.cos(u[0])),
    ],
    "powers": lambda t, x, u, p: [x[0] ** 3 + abs(u[0]) ** 0.5, np.power(x[1], 2) + 2.0 ** u[1] + np.square(x[0])],
    "np.polyval": lambda t, x, u, p: [np.polyval([1.0, -2.0, 0.5], x[0]), np.polyval([3.0, 0.0], u[1])],
    "np.linspace inside": lambda t, x, u, p: [np.linspace(0.0, 1.0, 4) @ np.full(4, x[0]), u[0]],
    "astype, copy, flatten": lambda t, x, u, p: x.copy().astype(float).flatten() + np.asarray(u, dtype=float).ravel(),
    "x.T @ Q @ x": lambda t, x, u, p: [x.T @ A @ x, u.T @ u],
    "np.any, np.all": lambda t, x, u, p: [1.0 if np.any(x > 1.0) else x[0], 2.0 if np.all(u < 0.5) else u[0]],
    "unpacking": lambda t, x, u, p: (lambda a, b, c, d: [a * d, b - c])(*x, *u),
    "nested lists and numpy numbers": lambda t, x, u, p: np.array([[np.float64(2.0) * x[0]], [u[1]]]),
    "np.einsum": lambda t, x, u, p: np.einsum("ij,j->i", A, x) * np.einsum("i,i", x, u),
    "time": lambda t, x, u, p: [np.sin(2 * np.pi * t) * x[0], math.sqrt(t) + (t if t < 1.5 else 1.5)],
    "isinstance, len, np.isscalar": lambda t, x, u, p: [
        x[0] if isinstance(u[0], float) and len(x) == 2 else 0.0,
        u[0] if np.isscalar(x[0]) else 0.0,
    ],
}  # fmt: skip


def iterated(t, x, u, params):
    guess = 1.0
    while abs(guess * guess - 1.0 - x[0] ** 2) > 1e-12:
        guess = 0.5 * (guess + (1.0 + x[0] ** 2) / guess)
    return [guess, u[0]]


CALLBACKS = {
    "a loop until it converges": iterated,
    "a loop as long as a signal says": lambda t, x, u, p: [sum(1.0 for _ in range(int(100 * abs(x[0])))), u[0]],
    "np.linalg.eigvals": lambda t, x, u, p: np.linalg.eigvals(np.diag(x) @ np.diag(x)).real,
    "a dictionary with a signal as key": lambda t, x, u, p: [{0.0: 1.0}.get(float(np.round(x[0])), -1.0), u[0]],
    "np.linalg.svd": lambda t, x, u, p: np.linalg.svd(np.diag(x))[1],
    "np.roots": lambda t, x, u, p: np.sort(np.roots([1.0, -abs(x[0]) - 3.0, 1.0]).real),
}  # fmt: skip
ALL = {**TRACED, **CALLBACKS}


def block(function):
    return ct.nlsys(function, None, inputs=2, states=2, outputs=2, name="block")


@pytest.mark.parametrize(
    "idiom", [*TRACED, *(pytest.param(name, marks=pytest.mark.slow) for name in CALLBACKS)]
)
def test_idiom(idiom):
    function = ALL[idiom]
    flat = flatten(block(function))
    rng = np.random.default_rng(5)
    for scale in (0.1, 0.6, 1.0, 3.0, 1.0):
        t, x, u = float(rng.uniform(0.0, 3.0)), scale * rng.normal(size=2), scale * rng.normal(size=2)
        expected = np.asarray(function(t, x.copy(), u.copy(), {}), dtype=float).reshape(-1)
        traced = flat.dynamics(t, x, u, [], []).full().ravel()
        np.testing.assert_allclose(traced, expected, rtol=1e-9, atol=1e-12)
    assert [callback.block for callback in flat.callbacks] == ["block"] * (idiom in CALLBACKS), (
        flat.callbacks[0].reason
    )


GUARDED = {
    "np.nan_to_num": lambda t, x, u, p: [np.nan_to_num(np.sin(u[0]) / u[0], nan=1.0), np.nan_to_num(1.0 / u[1])],
    "np.nan_to_num of an array": lambda t, x, u, p: np.nan_to_num(u / x, nan=3.0, posinf=4.0, neginf=-4.0),
    "np.isnan, np.isfinite": lambda t, x, u, p: [
        np.where(np.isnan(u[0] / x[0]), 2.0, u[0] / x[0]), np.where(np.isfinite(u[1] / x[1]), x[1], -1.0)
    ],
    "if math.isnan, math.isinf": lambda t, x, u, p: [
        7.0 if math.isnan(u[0]) else u[0], 1.0 if math.isinf(u[1]) else 0.0
    ],
    "np.clip, max, min": lambda t, x, u, p: [np.clip(u[0], -1.0, 1.0), np.maximum(np.minimum(u[0], x[1]), x[0])],
    "np.maximum, np.minimum": lambda t, x, u, p: [
        np.maximum(x[1], u[1]) + np.minimum(3.0, u[0]), np.heaviside(u[1], 0.5)
    ],
    "np.fmax, np.fmin": lambda t, x, u, p: [np.fmax(u[0], -1.0), np.fmin(x[1], u[1])],
    "np.interp": lambda t, x, u, p: [np.interp(u[0], *TABLE), np.interp(u[1], *TABLE)],
}  # fmt: skip


@pytest.mark.parametrize("guard", GUARDED)
def test_not_a_number_goes_where_numpy_lets_it_go(guard):
    function = GUARDED[guard]
    flat = flatten(block(function))
    assert not flat.callbacks
    odd = (0.0, -0.0, 0.5, np.nan, np.inf, -np.inf)
    with np.errstate(all="ignore"):
        for u in np.array(np.meshgrid(odd, odd)).reshape(2, -1).T:
            for x in ([0.3, 0.4], [0.0, 2.0]):
                expected = np.array(function(0.0, np.array(x), u.copy(), {}), dtype=float).ravel()
                traced = flat.dynamics(0.0, x, u, [], []).full().ravel()
                np.testing.assert_allclose(traced, expected, rtol=1e-14)


def test_lookup_table_at_no_number():
    held = pf.lookup_table(TABLE[0], TABLE[1])
    assert held.output(0.0, [], [-np.inf]) == TABLE[1][0]
    assert held.output(0.0, [], [np.inf]) == TABLE[1][-1]
    assert np.isnan(held.output(0.0, [], [np.nan]))
    plane = pf.lookup_table([[0.0, 1.0], [0.0, 1.0]], [[0.0, 0.0], [1.0, 1.0]])
    assert np.isnan(plane.output(0.0, [], [np.nan, 0.5]))
    assert np.isnan(plane.output(0.0, [], [0.5, np.nan]))


@pytest.mark.slow
def test_guards_stand_in_compiled_code():
    guard = ct.nlsys(
        None,
        lambda t, x, u, p: [np.nan_to_num(np.sin(u[0]) / u[0], nan=1.0), np.clip(u[0], -1.0, 1.0), np.isfinite(u[0])],
        inputs=1, outputs=3, name="guard",
    )  # fmt: skip
    u = [0.0, 0.5, 2.0]
    runs = [pf.simulate(guard, [0.0, 1.0, 2.0], u, backend=backend) for backend in ("vm", "c")]
    for run in runs:
        np.testing.assert_allclose(run.outputs[0], [1.0, *np.sin(u[1:]) / u[1:]], rtol=1e-15)
        np.testing.assert_array_equal(run.outputs[2], 1.0)
    lost = pf.codegen.compile_model(flatten(guard)).simulate([0.0], [[np.nan]])
    np.testing.assert_array_equal(lost.outputs[0], [1.0, np.nan, 0.0])


@pytest.mark.parametrize("edge", [-1.0, 0.0, 1.0])
def test_branch_at_its_edge(edge):
    """The side is the original's where the condition changes, not only beside it."""
    flat = flatten(block(lambda t, x, u, p: [1.0 if x[0] > edge else -1.0, 1.0 if x[0] >= edge else -1.0]))
    assert flat.dynamics(0.0, [edge, 0.0], [0.0, 0.0], [], []).full().ravel().tolist() == [-1.0, 1.0]


def test_branches_that_differ_in_their_last_digits():
    """Printed to six digits both conditions are one."""
    pressed = lambda t, x, u, p: [1.0 if u[0] > 101325.1 else 0.0, 1.0 if u[0] > 101325.4 else 0.0]  # noqa: E731
    timed = lambda t, x, u, p: [1.0 if t > 1000.001 else 0.0, 1.0 if t > 1000.004 else 0.0]  # noqa: E731
    for function, points in (
        (pressed, [(0.0, 101325.0), (0.0, 101325.2), (0.0, 101326.0)]),
        (timed, [(1000.0, 0.0), (1000.002, 0.0), (1000.01, 0.0)]),
    ):
        flat = flatten(block(function))
        assert not flat.callbacks
        sides = [flat.dynamics(t, [0, 0], [u, 0], [], []).full().ravel().tolist() for t, u in points]
        assert sides == [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]


def test_table_ends_where_the_list_ends():
    flat = flatten(block(lambda t, x, u, p: [GEARS[int(u[0])], 0.0]))
    values = [flat.dynamics(0.0, [0, 0], [gear, 0], [], []).full()[0, 0] for gear in (0, 4.9, -1, -5, 5, -6)]
    assert values[:4] == [40, 10, 10, 40]
    assert np.isnan(values[4:]).all()


def test_narrow_side_is_found():
    """One side is a thousandth wide, far from where points are drawn."""
    narrow = lambda t, x, u, p: [x[0] if abs(x[0] - 7.3) < 1e-3 else 0.0, 0.0]  # noqa: E731
    flat = flatten(block(narrow))
    assert not flat.callbacks
    assert flat.dynamics(0.0, [7.3005, 0.0], [0.0, 0.0], [], []).full()[0, 0] == 7.3005


def test_side_that_no_point_reaches_runs_as_python():
    hidden = lambda t, x, u, p: [1.0 if math.sin(x[0]) > 2.0 else -x[0], 0.0]  # noqa: E731
    flat = flatten(block(hidden))
    assert "no point was found on both sides" in flat.callbacks[0].reason
    assert flat.dynamics(0.0, [3.0, 0.0], [0.0, 0.0], [], []).full()[0, 0] == -3.0


def test_originals_and_modules_are_left_alone():
    kept, sine = [1.0], math.sin

    def update(t, x, u, params):
        kept[0] = 2.0  # the same at each call: no memory
        return [kept[0] * math.sin(x[0]), u[0]]

    flat = flatten(block(update))
    assert not flat.callbacks
    assert math.sin is sine
    assert update.__globals__["math"] is math
    assert all(isinstance(value, float) for value in kept)


def test_function_with_a_buffer_of_its_own_runs_as_python():
    """It hands out the same array each time: nothing kept, but nothing to trace either."""
    buffer = np.zeros(2)

    def update(t, x, u, params):
        buffer[:] = np.sin(x) + u
        return buffer

    flat = flatten(block(update))
    assert "in update: buffer[:] = np.sin(x) + u" in flat.callbacks[0].reason
    value = flat.dynamics(0.0, [0.3, 0.4], [1.0, 2.0], [], []).full().ravel()
    np.testing.assert_allclose(value, [np.sin(0.3) + 1.0, np.sin(0.4) + 2.0])


@pytest.mark.slow
def test_defaults_in_the_text_are_parameters():
    def update(t, x, u, params):
        drag = params.get("drag", 0.5) if x[0] > 0.0 else params.get("back", 0.7)
        return [u[0] / params.get("m", 4.0) - drag * x[0]]

    plant = ct.nlsys(update, None, inputs=1, outputs=1, states=1, name="plant")
    flat = flatten(ct.interconnect([plant], inplist="plant", outlist="plant", inputs="u", outputs="y"))
    assert {v.name: v.start for v in flat.parameters} == {
        "plant.m": 4.0,
        "plant.drag": 0.5,
        "plant.back": 0.7,
    }
    times = np.linspace(0.0, 1.0, 11)
    for params in ({}, {"m": 2.0}, {"drag": 3.0, "m": 0.5}):
        ours = pf.simulate(plant, times, 1.0, params=params, rtol=1e-9, atol=1e-11)
        tight = {"rtol": 1e-9, "atol": 1e-11}
        theirs = ct.input_output_response(plant, times, 1.0, params=params, solve_ivp_kwargs=tight)
        np.testing.assert_allclose(ours.outputs, theirs.outputs, rtol=1e-6)
    with pytest.raises(ValueError, match="no parameter is called mass"):
        pf.simulate(plant, times, 1.0, params={"mass": 2.0})


def read_twice(t, x, u, params):
    return [params.get("k", 1.0) * u[0] - params.get("k", 2.0) * x[0]]


def read_on_two_sides(t, x, u, params):
    return [params.get("k", 1.0) if x[0] > 0.0 else params.get("k", 2.0)]


def read_once(t, x, u, params):
    return [params.get("k", 1.0) * u[0]]


def other_default(t, x, u, params):
    return [params.get("k", 2.0) * x[0]]


def with_condition(condition, reset=None):
    plant = ct.nlsys(read_once, None, inputs=1, outputs=1, states=1, name="plant")
    return pf.hybrid(plant, [pf.event(condition, reset)])


@pytest.mark.parametrize(
    "make",
    [
        lambda: ct.nlsys(read_twice, None, inputs=1, outputs=1, states=1, name="plant"),
        lambda: ct.nlsys(read_on_two_sides, None, inputs=1, outputs=1, states=1, name="plant"),
        lambda: ct.nlsys(read_once, other_default, inputs=1, outputs=1, states=1, name="plant"),
        lambda: with_condition(lambda t, x, u, p: other_default(t, x, u, p)[0]),
        lambda: with_condition(lambda t, x, u, p: x[0] - 1.0, other_default),
        lambda: ct.nlsys(
            lambda t, x, u, p: [iterated(t, x, u, p)[0] + other_default(t, x, u, p)[0]],
            read_once, inputs=1, outputs=1, states=1, name="plant",
        ),
    ],
    ids=["in one line", "on two sides of an if", "in two functions", "in a condition", "in a reset", "in a callback"],
)  # fmt: skip
def test_different_defaults_are_refused(make):
    """python-control takes each where it stands; as a parameter, k is one number."""
    with pytest.raises(
        ValueError,
        match=r"block plant: params.get\('k', ...\) has the default 1.0 in one place and 2.0 in another",
    ):
        flatten(make())
    plant = ct.nlsys(read_once, other_default, inputs=1, outputs=1, states=1, params={"k": 3.0}, name="plant")
    assert [v.start for v in flatten(plant).parameters] == [3.0]
    bare = ct.nlsys(read_once, other_default, inputs=1, outputs=1, states=1, name="plant")
    assert pf.simulate(bare, [0.0, 1.0], 0.0, [2.0], params={"k": 3.0}).outputs.tolist() == [6.0, 6.0]


class Peak:
    highest = -1e9

    def update(self, t, x, u, params):
        self.highest = max(self.highest, u[0])
        return [self.highest, 0.0]


def peak_in_a_dictionary():
    kept = {"highest": -1e9}

    def update(t, x, u, params):
        kept["highest"] = max(kept["highest"], u[0])
        return [kept["highest"], 0.0]

    return update


def peak_in_a_closure():
    highest = -1e9

    def update(t, x, u, params):
        nonlocal highest
        highest = max(highest, float(u[0]))
        return [highest, 0.0]

    return update


@pytest.mark.parametrize("make", [lambda: Peak().update, peak_in_a_dictionary, peak_in_a_closure])
def test_memory_that_changes_with_the_signals_is_refused(make):
    with pytest.raises(
        ValueError, match=r"block block: its update function gave different results.*make that a state"
    ):
        flatten(block(make()))


def test_signal_of_an_earlier_trace_is_not_traced():
    kept = {}
    first = ct.nlsys(
        None,
        lambda t, x, u, p: [p["n"] * kept.setdefault("first", u[0])],
        inputs=1,
        outputs=1,
        params={"n": 3},
        name="first",
    )
    flat = flatten(first)
    assert [callback.block for callback in flat.callbacks] == ["first"]
    assert flat.output(0.0, [], [2.0], [3], []) == 3 * kept["first"]


def test_what_a_function_notes_for_itself_is_no_memory():
    noted = {}

    def update(t, x, u, params):
        if "last" in noted:
            noted["again"] = noted["last"]
        noted["last"] = u[0]
        return [noted["last"], x[0]]

    flat = flatten(block(update))
    assert flat.dynamics(0.0, [3.0, 0.0], [2.0, 0.0], [], []).full().ravel().tolist() == [2.0, 3.0]


def test_parameters_without_a_value():
    """python-control hands ``params`` of a call to all blocks; a block need not have a value of its own."""
    limit = ct.nlsys(
        None,
        lambda t, x, u, params: np.clip(u, -params["umax"], params["umax"]),
        inputs=1,
        outputs=1,
        name="limit",
    )
    assert pf.simulate(limit, [0.0, 1.0], 3.0, params={"umax": 2.0}).outputs.tolist() == [2.0, 2.0]
    runs = pf.simulate_batch(limit, [0.0, 1.0], 3.0, params={"umax": [1.0, 2.5]})
    assert [run.outputs[-1] for run in runs] == [1.0, 2.5]
    with pytest.raises(ValueError, match="fails wherever it is called: 'umax'; a parameter without a value"):
        flatten(limit)


def test_callback_runs_names_itself_and_has_no_c():
    root = ct.nlsys(
        lambda t, x, u, params: [u[0] - iterated(t, x, u, params)[0]],
        None,
        inputs=1,
        outputs=1,
        states=1,
        name="root",
    )
    loop = ct.interconnect([root], inplist="root", outlist="root", inputs="u", outputs="y", name="loop")
    times = np.linspace(0.0, 1.0, 11)
    response = pf.simulate(loop, times, 2.0)
    reference = ct.input_output_response(loop, times, 2.0, solve_ivp_kwargs={"rtol": 1e-9, "atol": 1e-11})
    np.testing.assert_allclose(response.outputs, reference.outputs, rtol=1e-6)
    assert response.backend == "vm"
    assert list(response.callbacks) == ["root"]
    assert 0.0 < response.callbacks["root"] <= 1.0
    with pytest.raises(
        ValueError,
        match=r"block root runs as Python.*test_tracing_idioms.py, line \d+, in iterated: while abs",
    ):
        pf.simulate(loop, times, 2.0, backend="c")


def test_callback_that_fails_says_so():
    def update(t, x, u, params):
        if np.linalg.eigvals(np.diag(x)).real[0] > 1.0:
            raise ValueError("beyond the stop")
        return [1.0]

    plant = ct.nlsys(update, None, inputs=1, outputs=1, states=1, name="plant")
    response = pf.simulate(plant, [0.0, 0.5, 2.0])
    assert not response.success
    assert "block plant, which runs as Python, raised ValueError: beyond the stop" in str(response.message)


def test_two_callbacks_stay_two():
    """CasADi's search for common subexpressions takes functions of one name for one."""

    def rising(factor):
        def output(t, x, u, params):
            return [factor * np.linalg.eigvals(np.diag(u)).real[0]]

        return ct.nlsys(None, output, inputs="u", outputs="y", name=f"by{factor}")

    lag = ct.nlsys(lambda t, x, u, p: [u[0] + 10.0 * u[1]], None, inputs=2, outputs=1, states=1, name="lag")
    once, thrice = rising(1), rising(3)
    diagram = ct.interconnect(
        [once, thrice, lag],
        connections=[["lag.u[0]", "by1.y"], ["lag.u[1]", "by3.y"]],
        inplist=["by1.u", "by3.u"],
        inputs=2,
        outlist=["by1.y", "by3.y", "lag.y[0]"],
        outputs=3,
    )
    times = np.linspace(0.0, 1.0, 5)
    found = pf.simulate(diagram, times, [2.0, 5.0]).outputs
    np.testing.assert_allclose(found, [0.0 * times + 2.0, 0.0 * times + 15.0, 152.0 * times], rtol=1e-9)


@pytest.mark.slow
def test_callback_without_feedthrough_makes_no_loop():
    plant = ct.nlsys(
        lambda t, x, u, p: [u[0]],
        lambda t, x, u, p: [iterated(t, x, u, p)[0]],
        inputs=1,
        outputs=1,
        states=1,
        name="plant",
    )
    gain = ct.tf([1.0], [1.0], name="k", inputs="e", outputs="f")
    connections = [["plant.u[0]", "-k.f"], ["k.e", "plant.y[0]"]]
    loop = ct.interconnect(
        [plant, gain], connections=connections, inplist="k.e", outlist="plant", inputs="r", outputs="y"
    )
    assert not flatten(plant).feedthrough.any()
    response = pf.simulate(loop, [0.0, 0.5, 1.0], 0.0)
    assert response.success
    assert np.isfinite(response.outputs).all()
