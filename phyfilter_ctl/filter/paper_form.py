"""The paper's own realisation, Eq. (5): open integrators that grow and cancel in the output.

    s_{k+1} = s_k + h (S s_k + c f_hat_k + P v_k),    f_hat_k = H s_k + J v_k,    v = (x, g, f_theta)

Kept for comparison, teaching and the paper's Algorithm 1; nothing else knows of it. Forward Euler, inputs held over the
step. A channel carries 4n - 3 states in the low-pass form (xi and its n - 1 derivatives, n - 1 integrals each of f_hat,
f_theta and x), and n - 1 integrals of g more in the general form, here with the supplement's two misprints put right
(-b_0 g in the equation of xi, b_1 as the last coefficient of chi_3).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _signals
from .._sections import FloatArray
from . import record
from .phyfilter import PhyFilter, SampledPhyFilter
from .sampling import Precision, Sampling

__all__ = ["PaperFilter", "PaperMatrices", "PaperState", "paper_matrices", "shift_matrix"]

Array = NDArray[np.floating]
_X, _G, _F = range(3)


class PaperMatrices(NamedTuple):
    """What depends on the coefficients, affine in them; states number s.

    Attributes
    ----------
    H, c : (s,) arrays
    J : (3,) array
    P : (s, 3) array
    start : (s,) array
        State at x(0) = 1.
    """

    H: Array
    J: Array
    c: Array
    P: Array
    start: Array


class PaperState(NamedTuple):
    """Integrators of one sample, and what they are driven by until the next.

    Attributes
    ----------
    s : (s, n_x) array
        xi and its derivatives; the integrals of f_hat, of f_theta, of x and, in the general form, of g.
    x, f_theta, f_hat : (n_x,) arrays
    """

    s: Array
    x: Array
    f_theta: Array
    f_hat: Array


@dataclass(frozen=True)
class PaperFilter:
    """A filter as Eq. (5) prints it: 4n - 3 states of which all but n grow without bound, for comparison only.

    Parameters
    ----------
    filter : PhyFilter
    dt : float
        Sampling interval in seconds.
    precision : {"float64", "float32"}
        Arithmetic, without compensation.
    general : bool, optional
        Whether the general form is meant; by default where N is not a_0.

    Raises
    ------
    ValueError
        If forward Euler diverges at this step.

    Examples
    --------
    In exact arithmetic it is the sampled filter under forward Euler with held inputs:

    >>> x = np.cumsum(np.ones((50, 1)), axis=0)
    >>> paper = PaperFilter(PhyFilter([400.0, 40.0]), 0.002)
    >>> bool(np.allclose(paper.run(x), paper.increments.run(x), rtol=1e-9))
    True
    """

    filter: PhyFilter
    dt: float
    precision: Precision = "float64"
    general: bool | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "dt", self.increments.dt)  # checked there

    @cached_property
    def increments(self) -> SampledPhyFilter:
        """The same filter by the increment recursion."""
        return SampledPhyFilter(
            self.filter, Sampling(self.dt, "euler", "hold", "hold", precision=self.precision)
        )

    @cached_property
    def matrices(self) -> PaperMatrices:
        """What depends on the coefficients, in the arithmetic of the filter."""
        a, b = self.filter.a, self.filter.b
        general = not self.filter.is_lowpass if self.general is None else self.general
        found = paper_matrices(np.concatenate([a, b]) if general else a, self.order, lowpass=not general)
        return PaperMatrices(*(part.astype(self.precision) for part in found))

    @cached_property
    def shift(self) -> Array:
        """S (s, s): each integrator's input is the one before it."""
        return shift_matrix(self.order, len(self.matrices.H)).astype(self.precision)

    @property
    def order(self) -> int:
        """Order of the filter."""
        return self.filter.order

    def with_filter(self, filter: PhyFilter) -> PaperFilter:
        """The same around other coefficients.

        Parameters
        ----------
        filter : PhyFilter
        """
        return replace(self, filter=filter)

    def run(
        self, x: ArrayLike, g: ArrayLike | None = None, f_theta: ArrayLike | None = None
    ) -> NDArray[np.floating]:
        """f_hat over a whole record of equal steps.

        Parameters
        ----------
        x, g, f_theta
            As for :meth:`SampledPhyFilter.run`.

        Raises
        ------
        ValueError
            For wrong shapes, or samples that are not finite.
        """
        x, g, f_theta, _ = record.finite_signals(self.increments.recursion, x, g, f_theta, None)
        state = self.start(x[0], f_theta0=f_theta[0])
        f_hat = f_theta.copy()
        for k in range(1, len(x)):  # the rounding of every step is what this realisation is kept to show
            state, f_hat[k] = self.step(state, x[k], g[k - 1], f_theta[k])
        return f_hat

    def start(self, x0: ArrayLike, *, f_theta0: ArrayLike | None = None) -> PaperState:
        """Bumpless start: xi^(i)(0) = -b_{n-1-i} x(0) (low-pass form: xi^(n-1)(0) = -x(0)), the rest 0.

        Parameters
        ----------
        x0 : (n_x,) array
        f_theta0 : (n_x,) array, optional
            None means 0.
        """
        x = _signals.array("x0", x0, ("n_x",)).astype(self.precision)
        f_theta = np.zeros_like(x)
        if f_theta0 is not None:
            f_theta = _signals.array("f_theta0", f_theta0, x.shape).astype(self.precision)
        return PaperState(self.matrices.start[:, None] * x, x, f_theta, f_theta)

    def step(
        self, state: PaperState, x: ArrayLike, g: ArrayLike | None = None, f_theta: ArrayLike | None = None
    ) -> tuple[PaperState, NDArray[np.floating]]:
        """Integrate over one step with everything held, then form f_hat.

        Parameters
        ----------
        state : PaperState
        x, g, f_theta : (n_x,) arrays
            As for :meth:`SampledPhyFilter.step` with ``g="hold"``.
        """
        now, dtype = self.matrices, state.x.dtype
        n_x = state.x.shape
        x = _signals.array("x", x, n_x).astype(dtype)
        g, f_theta = (
            np.zeros_like(x) if value is None else _signals.array(name, value, n_x).astype(dtype)
            for name, value in (("g", g), ("f_theta", f_theta))
        )
        rate = self.shift @ state.s + now.c[:, None] * state.f_hat
        rate += now.P @ np.stack([state.x, g, state.f_theta])
        s = state.s + dtype.type(self.dt) * rate
        f_hat = now.H @ s + now.J[_X] * x + now.J[_F] * f_theta
        return PaperState(s, x, f_theta, f_hat), f_hat

    def shift_x(self, state: PaperState, dx: ArrayLike) -> PaperState:
        """Move the origin of x by dx (n_x,): as at the start, in the derivatives of xi.

        Parameters
        ----------
        state : PaperState
        dx : (n_x,) array
        """
        jump = np.asarray(dx, state.x.dtype)
        return state._replace(s=state.s + self.matrices.start[:, None] * jump, x=state.x + jump)


def shift_matrix(n: int, size: int) -> FloatArray:
    """S (size, size) of order n: the derivatives of xi, then chains of n - 1 integrals."""
    shift = np.zeros((size, size))
    shift[np.arange(n - 1), np.arange(1, n)] = 1.0
    for first in range(n, size, max(n - 1, 1)):
        rows = np.arange(first + 1, first + n - 1)
        shift[rows, rows - 1] = 1.0
    return shift


def paper_matrices(p: FloatArray, n: int, *, lowpass: bool) -> PaperMatrices:
    """Matrices for coefficients p = a, or (a, b); affine in p."""
    a, b = p[:n], p[n:]
    chains = 3 if lowpass else 4  # integrals of f_hat, f_theta, x, and of g in the general form
    size = n + chains * (n - 1)
    first = [n + i * (n - 1) for i in range(chains)]
    H, J, c, P, start = np.zeros(size), np.zeros(3), np.zeros(size), np.zeros((size, 3)), np.zeros(size)
    J[_F] = 1.0
    H[first[0] : first[0] + n - 1] = -a[:0:-1]
    if lowpass:
        H[0] = a[0]
        H[first[1] : first[1] + n - 1] = a[:0:-1]
        c[n - 1], P[n - 1, _G], start[n - 1] = -1.0, -1.0, -1.0
    else:
        H[0] = 1.0
        H[first[1] : first[1] + n - 1] = (a - b)[:0:-1]
        H[first[3] : first[3] + n - 1] = -b[:0:-1]
        c[n - 1], P[n - 1, _G], P[n - 1, _F] = -a[0], -b[0], a[0] - b[0]
        start[:n] = -b[::-1]
    # The j-th integral of x enters with b_{n-1-j}: the 0-th, x itself, through J.
    weights = np.append(np.zeros(n - 1), a[0]) if lowpass else b[::-1]
    J[_X] = weights[0]
    H[first[2] : first[2] + n - 1] = weights[1:]
    if n > 1:
        c[first[0]], P[first[1], _F], P[first[2], _X] = 1.0, 1.0, 1.0
        if not lowpass:
            P[first[3], _G] = 1.0
    return PaperMatrices(H, J, c, P, start)
