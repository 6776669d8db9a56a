"""What a sampled block does as continuous time sees it, for linear analysis: sampling and hold left out."""

from __future__ import annotations

from typing import Any

import casadi as ca
import control as ct
import numpy as np
from scipy.linalg import block_diag

from .._sections import FloatArray, continuous_matrices
from ..filter import SampledPhyFilter
from ..filter.matrices import constant_inertia
from .function_block import symbols_like
from .functions import BlockFunctions, Variable
from .law import filter_inputs

__all__ = ["continuous_filter", "continuous_law", "continuous_moving_inertia", "forward_difference", "pade"]

# Order of the Pade approximant of the filter's delay of g and f_theta: phase within 0.2 degrees up to omega delay = 2.
_PADE_ORDER = 3
# Smallest reciprocal condition of A + I for which Tustin's map is turned round.
_LEAST_RCOND = 1e-12


def continuous_filter(
    sampled: SampledPhyFilter,
    inertia: FloatArray | None,
    channels: int,
    moving: int = 0,
    f_theta: bool = True,
) -> ct.StateSpace:
    """The filter that a sampled one stands for: f_hat = f_theta + F [M x' - e^(-delay s) (g + f_theta)].

    Parameters
    ----------
    sampled : SampledPhyFilter
        ``limit``, ``nonfinite``, ``method`` and the holds are left out.
    inertia : (n_x,) or (n_x, n_x) array or None
        M_hat; None for I.
    channels : int
        Number n_x of channels of x.
    moving : int
        Number of inputs M that follow; their columns are zero, since M multiplies x', which is zero at a point of rest.
    f_theta : bool
        Whether f_theta is an input.
    """
    n_x = channels
    E_left = sampled.recursion.E_left
    E_left = np.eye(n_x) if E_left is None else E_left
    n_f = len(E_left)
    filters = sampled.filters * n_f if len(sampled.filters) == 1 else sampled.filters
    momentum = E_left @ constant_inertia(inertia, n_x)
    (A, B, C, D), _ = continuous_matrices([entry.sections for entry in filters], momentum, E_left)
    if sampled.sampling.delay:
        # x, then v = delayed (E_left g + f_theta): the columns of B for f_theta act on it; f_theta passes through D.
        lag = pade(sampled.sampling.delay, n_f, _PADE_ORDER)
        into = np.hstack([np.zeros((n_f, n_x)), E_left, np.eye(n_f)])
        drive = B[:, 2 * n_x :]
        direct = B.copy()
        direct[:, n_x:] = 0.0
        A, B, C, D = (
            np.block([[A, drive @ lag.C], [np.zeros((lag.nstates, len(A))), lag.A]]),
            np.vstack([direct + drive @ lag.D @ into, lag.B @ into]),
            np.hstack([C, np.zeros((n_f, lag.nstates))]),
            D,
        )
    given = 2 * n_x + (n_f if f_theta else 0)
    B, D = (np.hstack([part[:, :given], np.zeros((len(part), moving))]) for part in (B, D))
    return ct.StateSpace(A, B, C, D, 0, remove_useless_states=False)


def continuous_law(
    A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, period: float
) -> ct.StateSpace:
    """The continuous system whose Tustin discretisation with this period is x+ = A x + B u, y = C x + D u.

        s = (2/period) (z - 1)/(z + 1);  the state at rest is the same in both

    Parameters
    ----------
    A, B, C, D : arrays
    period : float
        Seconds.

    Raises
    ------
    ValueError
        If A has an eigenvalue at -1, which no continuous system gives.
    """
    n = len(A)
    if n == 0:
        return ct.StateSpace(A, B, C, D, 0, remove_useless_states=False)
    if 1.0 / np.linalg.cond(A + np.eye(n)) < _LEAST_RCOND:
        raise ValueError(
            "the law has an eigenvalue at -1, which alternates from sample to sample: no continuous system does that; "
            "leave the block out of the linear analysis, or move the eigenvalue"
        )
    P = np.linalg.inv(A + np.eye(n))
    return ct.StateSpace(
        (2.0 / period) * (np.eye(n) - 2.0 * P),
        (2.0 / period) * P @ B,
        2.0 * C @ P,
        D - C @ P @ B,
        0,
        remove_useless_states=False,
    )


def continuous_moving_inertia(
    sampled: SampledPhyFilter, channels: int, inertia: str, f_theta: bool = True
) -> BlockFunctions:
    """:func:`continuous_filter` where M is an input: F [(M x)' - ...], which is F [M x' - ...] at x = 0.

    Parameters
    ----------
    sampled : SampledPhyFilter
    channels : int
        Number n_x of channels of x.
    inertia : {"scalar", "diagonal", "full"}
    f_theta : bool
        Whether f_theta is an input.
    """
    n_x = channels
    unit = continuous_filter(sampled, None, n_x, f_theta=f_theta)
    n_f = unit.noutputs
    inputs = filter_inputs(n_x, n_f, inertia, f_theta)
    t, p = ca.SX.sym("t"), ca.SX.sym("p", 0)
    z, u = ca.SX.sym("z", unit.nstates), ca.SX.sym("u", len(inputs))
    x, rest, M = ca.vertsplit(u, [0, n_x, unit.ninputs, len(inputs)])
    moved = ca.mtimes(ca.reshape(M, n_x, n_x).T, x) if inertia == "full" else M * x
    v = ca.vertcat(moved, rest)
    A, B, C, D = (ca.sparsify(ca.DM(np.asarray(part))) for part in (unit.A, unit.B, unit.C, unit.D))
    return BlockFunctions(
        tuple(Variable(f"z[{i}]") for i in range(unit.nstates)),
        inputs,
        tuple(Variable(f"f_hat[{i}]") for i in range(n_f)),
        (),
        ca.Function("dynamics", [t, z, u, p], [ca.mtimes(A, z) + ca.mtimes(B, v)]),
        ca.Function("output", [t, z, u, p], [ca.mtimes(C, z) + ca.mtimes(D, v)]),
    )


def forward_difference(law: BlockFunctions, period: float) -> BlockFunctions:
    """x' = (next x - x) / period, y as it is: a continuous equivalent of first order in the period.

    Parameters
    ----------
    law : BlockFunctions
    period : float
        Seconds.
    """
    if not law.states:
        return law
    symbols = symbols_like(law.dynamics)
    following: Any = law.dynamics(*symbols)
    rate = (following - symbols[1]) / period
    return BlockFunctions(
        law.states,
        law.inputs,
        law.outputs,
        law.parameters,
        ca.Function("dynamics", symbols, [rate]),
        law.output,
    )


def pade(delay: float, channels: int, order: int, numdeg: int | None = None) -> ct.StateSpace:
    """Pade approximant of a delay, of channels side by side: ``control.pade``, well scaled.

    Parameters
    ----------
    delay : float
        Seconds, above 0.
    channels : int
    order, numdeg : int
        Degrees of denominator and numerator; None takes that of the denominator.
    """
    # In s delay, so that the matrices are of one size whatever the delay.
    numerator, denominator = (
        np.trim_zeros(part, "f") for part in map(np.asarray, ct.pade(1.0, order, numdeg))
    )
    A, B, C, D = state_matrices(ct.tf2ss(numerator, denominator))
    parts = (block_diag(*[part] * channels) for part in (A / delay, B / delay, C, D))
    return ct.StateSpace(*parts, 0, remove_useless_states=False)


def state_matrices(system: object) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """A, B, C and D of what python-control converts to a state space."""
    linear = system if isinstance(system, ct.StateSpace) else ct.ss(system)
    assert isinstance(linear, ct.StateSpace)
    A, B, C, D = (np.asarray(part, dtype=float) for part in (linear.A, linear.B, linear.C, linear.D))
    return A, B, C, D
