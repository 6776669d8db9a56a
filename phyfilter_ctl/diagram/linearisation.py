"""Linear models of flat ones, by exact derivatives."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import control as ct
import numpy as np

from .._sections import FloatArray
from ..blocks.functions import BlockFunctions, Variable
from .equations import Equations
from .structure import is_affine

__all__ = ["is_linear", "linear_model"]

STEPS = 20  # of Newton's method for the held outputs: 1 where the equivalents are linear


def is_linear(flat: Equations) -> bool:
    """Whether dynamics and outputs are linear in states, inputs and held outputs, whatever the parameters.

    Parameters
    ----------
    flat : Equations

    Returns
    -------
    bool
    """
    for function in (flat.dynamics, flat.output):
        if not function.is_a("SXFunction"):
            return False
        t, x, u, p, z = (ca.SX.sym(name, function.size1_in(i)) for i, name in enumerate("txupz"))
        value = function(t, x, u, p, z)
        offset = function(0, ca.SX.zeros(x.shape), ca.SX.zeros(u.shape), p, ca.SX.zeros(z.shape))
        if ca.jacobian(value, t).nnz() or not is_affine(function, (0, 1, 2, 4)):
            return False
        if offset.nnz() and ca.sparsify(offset).nnz() != 0:
            return False
    return True


def linear_model(flat: Equations, x0: FloatArray, u0: FloatArray, p: FloatArray, t: float) -> ct.StateSpace:
    """Jacobians at a point, with the sampled blocks replaced by their continuous equivalents.

    Parameters
    ----------
    flat : Equations
    x0 : array
        States; those of the equivalents may follow, else they are at their starts.
    u0, p : arrays
        Inputs and parameters.
    t : float
        Time in seconds.

    Returns
    -------
    control.StateSpace

    Raises
    ------
    ValueError
        For a sampled block without a continuous equivalent, a block that raises, or no solution for the outputs of
        those there are.
    """
    for callback in flat.callbacks:
        callback.failure = ""
    equivalents = []
    for task in flat.tasks:
        if task.continuous is None:
            raise ValueError(
                f"block {task.name} is sampled and has no continuous equivalent; linearise the diagram without it"
            )
        equivalents.append(task.continuous)
    n, sizes = len(flat.states), [len(e.states) for e in equivalents]
    s0 = np.array([v.start for e in equivalents for v in e.states])
    if len(x0) == n + len(s0):
        x0, s0 = x0[:n], x0[n:]
    parts = np.split(s0, np.cumsum(sizes)[:-1]) if equivalents else []
    z = _held(flat, x0, u0, p, t, parts)
    point = (t, x0, u0, p, z)
    sampled = sum(
        len(task.law.outputs) for task in flat.tasks
    )  # starts of algebraic loops, behind, act on nothing
    Ax, Bu, Ez = (_jacobian(flat.dynamics, i, point) for i in (1, 2, 4))
    Cx, Du, Fz = (_jacobian(flat.output, i, point) for i in (1, 2, 4))
    Ez, Fz = Ez[:, :sampled], Fz[:, :sampled]
    # Equivalents: s' = As s + Bs v, z = Cs s + Ds v, and v = Gx x + Gu u + Gz z.
    rows: list[list[FloatArray]] = [[] for _ in range(7)]
    for task, equivalent, s in zip(flat.tasks, equivalents, parts, strict=True):
        v = np.asarray(task.signals(*point), dtype=float).reshape(-1)
        inside = (t, s, v, _parameters(equivalent, task.law.parameters, p[task.parameters]))
        for row, block in zip(
            rows,
            (
                *(_jacobian(f, i, inside) for f in (equivalent.dynamics, equivalent.output) for i in (1, 2)),
                *(_jacobian(task.signals, i, point) for i in (1, 2)),
                _jacobian(task.signals, 4, point)[:, :sampled],
            ),
            strict=True,
        ):
            row.append(block)
    order = [i for task in flat.tasks for i in range(task.held.start, task.held.stop)]
    As, Bs, Cs, Ds = (_diagonal(blocks) for blocks in rows[:4])
    widths = (n, len(u0), sampled)
    Gx, Gu, Gz = (np.vstack([np.zeros((0, w)), *blocks]) for blocks, w in zip(rows[4:], widths, strict=True))
    back = np.argsort(order) if order else np.zeros(0, dtype=int)  # from the order of tasks to that of z
    Cs, Ds = Cs[back], Ds[back]
    solve = np.linalg.inv(np.eye(sampled) - Ds @ Gz)
    Zx, Zs, Zu = solve @ Ds @ Gx, solve @ Cs, solve @ Ds @ Gu
    A = np.block([[Ax + Ez @ Zx, Ez @ Zs], [Bs @ (Gx + Gz @ Zx), As + Bs @ Gz @ Zs]])
    B = np.vstack([Bu + Ez @ Zu, Bs @ (Gu + Gz @ Zu)])
    C = np.hstack([Cx + Fz @ Zx, Fz @ Zs])
    D = Du + Fz @ Zu
    raised = next((callback for callback in flat.callbacks if callback.failure), None)
    if raised is not None:
        raise ValueError(f"block {raised.block}, which runs as Python, raised {raised.failure}")
    names = [v.name for v in flat.states]
    names += [
        f"{task.name}.{v.name}" for task, e in zip(flat.tasks, equivalents, strict=True) for v in e.states
    ]
    return ct.StateSpace(
        A,
        B,
        C,
        D,
        flat.dt,
        states=_plain(names),
        inputs=_plain([v.name for v in flat.inputs]),
        outputs=_plain([v.name for v in flat.outputs]),
        name=flat.name.replace(".", "_"),
        remove_useless_states=False,
    )


def _held(
    flat: Equations, x: FloatArray, u: FloatArray, p: FloatArray, t: float, states: Sequence[FloatArray]
) -> FloatArray:
    """Outputs of the equivalents at the point, which may see each other."""
    z = np.array([v.start for v in flat.held])
    for _ in range(STEPS if flat.tasks else 0):
        result, slope = z.copy(), np.zeros((len(z), len(z)))
        for task, s in zip(flat.tasks, states, strict=True):
            equivalent = task.continuous
            assert equivalent is not None
            v = np.asarray(task.signals(t, x, u, p, z), dtype=float).reshape(-1)
            inside = (t, s, v, _parameters(equivalent, task.law.parameters, p[task.parameters]))
            result[task.held] = np.asarray(equivalent.output(*inside), dtype=float).reshape(-1)
            slope[task.held] = _jacobian(equivalent.output, 2, inside) @ _jacobian(
                task.signals, 4, (t, x, u, p, z)
            )
        step = np.asarray(np.linalg.solve(np.eye(len(z)) - slope, result - z), dtype=float)
        z = z + step
        if np.max(np.abs(step), initial=0.0) <= 1e-12 * (1.0 + np.max(np.abs(z), initial=0.0)):
            return z
    if not flat.tasks:
        return z
    raise ValueError(
        "no solution for the outputs of the sampled blocks' continuous equivalents at this point"
    )


def _parameters(equivalent: BlockFunctions, law: Sequence[Variable], q: FloatArray) -> FloatArray:
    """The law's parameters where the equivalent takes the same ones, by name; else its own starts."""
    values = {variable.name: float(value) for variable, value in zip(law, q, strict=True)}
    return np.array([values.get(v.name, v.start) for v in equivalent.parameters])


def _jacobian(function: ca.Function, argument: int, point: Sequence[float | FloatArray]) -> FloatArray:
    symbols = [ca.MX.sym(f"a{i}", function.size1_in(i)) for i in range(function.n_in())]
    jacobian = ca.Function("jacobian", symbols, [ca.jacobian(function(*symbols), symbols[argument])])
    shape = (function.size1_out(0), function.size1_in(argument))
    return np.asarray(jacobian(*point).full(), dtype=float).reshape(shape)


def _diagonal(blocks: Sequence[FloatArray]) -> FloatArray:
    result = np.zeros((sum(b.shape[0] for b in blocks), sum(b.shape[1] for b in blocks)))
    row = column = 0
    for block in blocks:
        result[row : row + block.shape[0], column : column + block.shape[1]] = block
        row, column = row + block.shape[0], column + block.shape[1]
    return result


def _plain(names: Sequence[str]) -> list[str]:
    """python-control allows no points in names; its own joint is the underscore."""
    return [name.replace(".", "_") for name in names]
