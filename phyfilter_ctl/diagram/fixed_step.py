"""How long the steps of the classical Runge-Kutta method may be before it makes a stable mode grow.

For x' = lambda x one step multiplies x by R(h lambda), R(w) = 1 + w + w^2/2 + w^3/6 + w^4/24. Hairer, Wanner, "Solving
Ordinary Differential Equations II", IV.2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, cast

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csc_array
from scipy.sparse.linalg import ArpackError, eigs

from .model import FlatModel
from .naming import override

__all__ = [
    "StableStep",
    "fastest_modes",
    "largest_stable_step",
    "rates",
    "refuse_unstable_step",
    "state_jacobian",
]

# Beyond this many states a few eigenvalues are sought instead of all.
_MANY = 250
# Beyond this many a norm is taken where it says enough.
_FEW = 50
# A real part that is this part of the eigenvalue is rounding: an undamped oscillation is to stay bounded too.
_UNDAMPED = 1e-9
# Steps at the bound itself are let pass: the eigenvalue is no better known.
_ROUNDING = 1e-9


class StableStep(NamedTuple):
    """The longest step, and what bounds it.

    Attributes
    ----------
    seconds : float
        inf where nothing bounds it.
    eigenvalue : complex
        Of df/dx, 1/s.
    state : str
        The largest in that mode.
    """

    seconds: float
    eigenvalue: complex
    state: str


@lru_cache(maxsize=64)
def state_jacobian(flat: FlatModel) -> ca.Function:
    """(t, x, u, p, z) -> df/dx, sparse."""
    few = flat.dynamics.is_a("SXFunction") and len(flat.states) <= _FEW
    kind = ca.SX if few else cast(type[ca.SX], ca.MX)
    symbols = [kind.sym(name, flat.dynamics.size1_in(i)) for i, name in enumerate("txupz")]
    return ca.Function("jacobian", symbols, [ca.jacobian(flat.dynamics(*symbols), symbols[1])])


def fastest_modes(matrix: csc_array) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Eigenvalues of largest modulus, all of a small matrix, and their vectors as columns."""
    n = matrix.shape[0] if matrix.shape else 0
    if n <= _MANY:
        values, vectors = np.linalg.eig(matrix.toarray())
    else:
        try:
            found: Any = eigs(
                matrix, k=6, which="LM", v0=np.ones(n)
            )  # with vectors, which its types do not tell
            values, vectors = found
        except (ArpackError, RuntimeError):
            bound = float(abs(matrix).sum(axis=0).max())  # a norm bounds them
            values, vectors = np.array([-bound]), np.ones((n, 1))
    return np.asarray(values, dtype=complex), np.asarray(vectors, dtype=complex)


def largest_stable_step(flat: FlatModel, point: Mapping[str, ArrayLike] | None = None) -> StableStep:
    """Longest step of RK4 under which every decaying mode of the diagram, linearised at a point, decays.

    Parameters
    ----------
    flat : FlatModel
    point : mapping, optional
        States and inputs that are not at their start values, by name.

    Returns
    -------
    StableStep

    Raises
    ------
    ValueError
        For names that are unknown or ambiguous.

    Examples
    --------
    >>> import control as ct
    >>> from phyfilter_ctl.diagram import flatten
    >>> round(largest_stable_step(flatten(ct.tf([1.0], [1.0, 1.0]))).seconds, 6)
    2.785294
    """
    free = StableStep(np.inf, 0j, "")
    given = dict(point or {})
    inputs = {variable.name for variable in flat.inputs}
    u = override(flat.inputs, {name: given.pop(name) for name in list(given) if name in inputs})
    x = override(flat.states, given)
    if not flat.states or flat.dt > 0.0:
        return free
    z = np.array([variable.start for variable in flat.held])
    matrix = _state_matrix(flat, 0.0, x, u, flat.start_parameters(), z)
    if matrix is None:
        return free
    eigenvalues, vectors = fastest_modes(matrix)
    shortest = free
    for i, value in enumerate(eigenvalues):
        seconds = _boundary(complex(value))
        if seconds < shortest.seconds:
            mode = flat.states[int(np.argmax(np.abs(vectors[:, i])))].name
            shortest = StableStep(seconds, complex(value), mode)
    return shortest


def rates(flat: FlatModel, t: float, *at: NDArray[np.float64], below: float = 0.0) -> tuple[float, float]:
    """Of the fastest mode that decays more than it oscillates, and of the fastest of any kind, 1/s.

    ``at`` is x, u, p, z. Where a norm that bounds both is less than ``below``, it stands for them.
    """
    if len(flat.states) <= _FEW:
        small = state_jacobian(flat)(t, *at).full()
        if not np.all(np.isfinite(small)):
            return 0.0, 0.0
        values = np.linalg.eigvals(small)
    else:
        matrix = _state_matrix(flat, t, *at)
        if matrix is None:
            return 0.0, 0.0
        bound = float(abs(matrix).sum(axis=1).max())
        if bound < below:
            return bound, bound
        values = fastest_modes(matrix)[0]
    decaying = values[-values.real >= np.abs(values.imag)]
    return float(np.abs(decaying).max(initial=0.0)), float(np.abs(values).max(initial=0.0))


def _state_matrix(flat: FlatModel, t: float, *at: NDArray[np.float64]) -> csc_array | None:
    values = state_jacobian(flat)(t, *at)
    rows, columns = values.sparsity().get_triplet()
    matrix = csc_array((np.array(values.nonzeros()), (rows, columns)), shape=(len(flat.states),) * 2)
    return matrix if matrix.nnz and np.all(np.isfinite(matrix.data)) else None


def refuse_unstable_step(
    flat: FlatModel,
    step: float,
    way_out: str,
    substeps: int = 1,
    points: Sequence[Mapping[str, ArrayLike]] = (),
) -> None:
    """Raise where RK4 with this step turns a stable diagram unstable.

    Parameters
    ----------
    flat : FlatModel
    step : float
        Seconds.
    way_out : str
        What to do, for the message; ``{step}`` and ``{substeps}`` are filled in.
    substeps : int
        Of such steps in one call.
    points : sequence of mapping
        Where it is checked besides the start: states and inputs by name.

    Raises
    ------
    ValueError
        If a mode that decays there grows under RK4 with this step; for names that are unknown or ambiguous.
    """
    found = [(largest_stable_step(flat, point), f"at {dict(point)}") for point in points]
    bound, where = min(
        [(largest_stable_step(flat), "at its start"), *found], key=lambda entry: entry[0].seconds
    )
    if step > bound.seconds * (1.0 + _ROUNDING):
        advice = way_out.format(
            step=_rounded_down(bound.seconds), substeps=int(np.ceil(step * substeps / bound.seconds))
        )
        raise ValueError(
            f"step: {flat.name} has the eigenvalue {bound.eigenvalue:.4g} 1/s (mostly state {bound.state}) "
            f"{where}, a mode that grows without bound under Runge-Kutta steps of {step:.6g} s: at most "
            f"{_rounded_down(bound.seconds)} s; {advice}"
        )


def _rounded_down(seconds: float) -> str:
    """Three digits that are no longer than the step."""
    unit = 10.0 ** (np.floor(np.log10(seconds)) - 2)
    return f"{np.floor(seconds / unit) * unit:.3g}"


def _boundary(eigenvalue: complex) -> float:
    """Where h eigenvalue leaves the region abs(R) <= 1; inf for a mode that grows by itself."""
    size = abs(eigenvalue)
    if size == 0.0 or eigenvalue.real > _UNDAMPED * size:
        return np.inf
    # abs(R)^2 - 1 along the ray, a polynomial in r = h abs(lambda), divided by r.
    w = complex(min(eigenvalue.real, 0.0), eigenvalue.imag) / size
    R = np.array([w**k / factor for k, factor in enumerate((1, 1, 2, 6, 24))])
    square = np.real(np.convolve(R, R.conj()))
    roots = np.roots(square[:0:-1]).astype(complex)
    # An undamped mode has |R|^2 - 1 = r^6 (r^2/8 - 1) / 72: five roots at 0, known to eps^(1/5).
    crossings = [float(r.real) for r in roots.tolist() if abs(r.imag) < 1e-6 * abs(r) and r.real > 0.1]
    return min(crossings, default=np.inf) / size
