"""Flat models made by hand, without the machinery that makes them from diagrams."""

import casadi as ca
import numpy as np

from phyfilter_ctl.blocks.functions import BlockFunctions, Variable
from phyfilter_ctl.diagram.model import FlatModel, Task

# All that a serious compiler says about them; what the runtime passes beyond, -Wconversion, CasADi's code does not.
STRICT = ("-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Werror")


def symbols(n_x, n_u, n_p, n_z):
    sizes = (("t", 1), ("x", n_x), ("u", n_u), ("p", n_p), ("z", n_z))
    return [ca.SX.sym(name, size) for name, size in sizes]


def variables(name, count, starts=()):
    return tuple(Variable(f"{name}[{i}]", starts[i] if starts else 0.0) for i in range(count))


def model(name, arguments, dx, y, *, starts=(), parameters=(), inputs=(), tasks=(), held=()):
    _, x, u, _, _ = arguments
    return FlatModel(
        name,
        variables("x", x.numel(), starts),
        variables("u", u.numel(), inputs),
        variables("y", y.numel()),
        tuple(Variable(f"block.p{i}", value, "1/s") for i, value in enumerate(parameters)),
        held,
        ca.Function("f", arguments, [dx]),
        ca.Function("h", arguments, [y]),
        tasks,
    )


def pendulum():
    """Everything an expression may hold; y does not depend on x[1], and part of x' is structurally zero."""
    arguments = symbols(3, 2, 2, 0)
    t, x, u, p, _ = arguments
    dx = ca.vertcat(
        x[1],
        -p[0] * ca.sin(x[0]) - p[1] * x[1] * ca.fabs(x[1]) + ca.fmin(u[0], 2.0) + ca.sign(x[0]) * 1e-3,
        0,
    )
    y = ca.vertcat(
        ca.if_else(x[0] > 0.1, x[0] ** 2.5, ca.exp(x[0])),
        ca.atan2(u[1], 1 + x[0] ** 2) + ca.floor(3 * t) + ca.sqrt(1 + p[1]) + ca.tanh(x[2]),
    )
    return model(
        "pendulum", arguments, dx, y, starts=(0.7, -0.2, 0.4), parameters=(9.81, 0.3), inputs=(0.5, -1.0)
    )


def oscillator():
    """x'' = -w^2 x: x = cos w t."""
    arguments = symbols(2, 0, 1, 0)
    _, x, _, p, _ = arguments
    dx = ca.vertcat(x[1], -(p[0] ** 2) * x[0])
    return model("oscillator", arguments, dx, x[0] + 0, starts=(1.0, 0.0), parameters=(2.0,))


def integrator():
    """x' = u."""
    arguments = symbols(1, 1, 0, 0)
    _, x, u, _, _ = arguments
    return model("integrator", arguments, u + 0, ca.vertcat(x, u))


def law(gain, starts=(0.0, 0.5)):
    """Integral action and a counter: o = -k e - i + w / 10, i' = i + e / 100, n' = n + 1."""
    t, s, v, q = (
        ca.SX.sym("t"),
        ca.SX.sym("s", 2),
        ca.SX.sym("v", 2),
        ca.SX.sym("q", 1 if gain is None else 0),
    )
    k = q[0] if gain is None else gain
    return BlockFunctions(
        (Variable("i", starts[0]), Variable("n", starts[1])),
        (Variable("e"), Variable("w")),
        (Variable("o"),),
        (Variable("k", 2.0),) if gain is None else (),
        ca.Function("next", [t, s, v, q], [ca.vertcat(s[0] + 0.01 * v[0], s[1] + 1)]),
        ca.Function("out", [t, s, v, q], [-k * v[0] - s[0] + 0.1 * v[1] + 0.01 * s[1] + t]),
    )


def two_rates(slow=0.003, fast=0.002):
    """A pendulum under two sampled laws, each of which sees what the other holds."""
    arguments = symbols(2, 1, 3, 2)
    _, x, u, p, z = arguments
    dx = ca.vertcat(x[1], -p[0] * ca.sin(x[0]) - p[1] * x[1] + z[0] + u)
    y = ca.vertcat(x[0], z[0] + z[1], u + x[1])
    of_slow = ca.Function("v", arguments, [ca.vertcat(x[0] - u, z[1])])
    of_fast = ca.Function("v", arguments, [ca.vertcat(x[1], z[0])])
    tasks = (
        Task("slow", slow, law(None), of_slow, slice(0, 1), slice(2, 3)),
        Task("fast", fast, law(3.0), of_fast, slice(1, 2), slice(3, 3)),
    )
    held = (Variable("slow.o"), Variable("fast.o"))
    return model(
        "two_rates", arguments, dx, y, starts=(0.3, 0.0), parameters=(9.81, 0.2, 2.0), tasks=tasks, held=held
    )


def by_hand(flat, times, inputs, substeps=1, digits=9):
    """A flat model run by a loop on CasADi's functions: classical Runge-Kutta from stop to stop, inputs held.

    Instants and times are multiples of 10^-digits seconds, counted in integers.
    """
    p = np.array([v.start for v in flat.parameters])
    x = np.array([v.start for v in flat.states])
    z = np.array([v.start for v in flat.held])
    states = [np.array([v.start for v in task.law.states]) for task in flat.tasks]
    unit = 10**digits
    grid = [round(t * unit) for t in times]
    periods = [round(task.period * unit) for task in flat.tasks]
    stops = sorted({k for period in periods for k in range(0, grid[-1] + 1, period)} | set(grid))
    row, outputs = -1, []
    u = np.asarray(inputs[0])
    for at, following in zip(stops, [*stops[1:], None], strict=True):
        t = at / unit
        if at in grid:
            row += 1
            u = np.asarray(inputs[row])
        due = [i for i, period in enumerate(periods) if at % period == 0]
        for i in due:
            task = flat.tasks[i]
            v = task.signals(t, x, u, p, z)
            z[task.held] = np.asarray(task.law.output(t, states[i], v, p[task.parameters])).ravel()
        for i in due:
            task = flat.tasks[i]
            v = task.signals(t, x, u, p, z)
            states[i] = np.asarray(task.law.dynamics(t, states[i], v, p[task.parameters])).ravel()
        if at in grid:
            outputs.append(np.asarray(flat.output(t, x, u, p, z)).ravel())
        if following is None:
            break
        h = (following - at) / unit / substeps

        def slope(t, x, u=u, z=z):
            return np.asarray(flat.dynamics(t, x, u, p, z)).ravel()

        for j in range(substeps):
            s = t + j * h
            k1 = slope(s, x)
            k2 = slope(s + h / 2, x + h / 2 * k1)
            k3 = slope(s + h / 2, x + h / 2 * k2)
            k4 = slope(s + h, x + h * k3)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return np.array(outputs), x, np.concatenate(states) if states else np.zeros(0)
