"""The paper's own realisation, Eq. (5): open integrators that grow and cancel in the output.

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

from . import record
from .phyfilter import PhyFilter, SampledPhyFilter
from .sampling import Precision, Sampling

__all__ = ["PaperFilter", "PaperState"]

Array = NDArray[np.floating]


class PaperState(NamedTuple):
    """Integrators of one sample, of a filter of order n.

    Attributes
    ----------
    xi : (n, n_x) array
        xi and its derivatives.
    alpha, beta, x : (n, n_x) arrays
        f_hat, f_theta and x, each with its integrals.
    g : (n - 1, n_x) array
        Integrals of g, used by the general form.
    """

    xi: Array
    alpha: Array
    beta: Array
    x: Array
    g: Array


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

    def __post_init__(self) -> None:
        object.__setattr__(self, "dt", self.increments.dt)  # checked there

    @cached_property
    def increments(self) -> SampledPhyFilter:
        """The same filter by the increment recursion."""
        return SampledPhyFilter(
            self.filter, Sampling(self.dt, "euler", "hold", "hold", precision=self.precision)
        )

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
        x = np.asarray(x0, self.precision)
        zeros = np.zeros((self.order, len(x)), dtype=x.dtype)
        xi, alpha, beta, integrals, g = (zeros.copy() for _ in range(5))
        xi -= self._weights(x.dtype) * x
        if f_theta0 is not None:
            alpha[0] = beta[0] = f_theta0
        integrals[0] = x
        return PaperState(xi, alpha, beta, integrals, g[1:])

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
        filter, dtype = self.filter, state.x.dtype
        x = np.asarray(x, dtype)
        g, f_theta = (np.zeros_like(x) if v is None else np.asarray(v, dtype) for v in (g, f_theta))
        a, b, h = filter.a.astype(dtype), filter.b.astype(dtype), dtype.type(self.dt)
        xi, alpha, beta, integrals, held = (array.copy() for array in state)
        xi[:-1] += h * state.xi[1:]
        for chain, before in ((alpha, state.alpha), (beta, state.beta), (integrals, state.x)):
            chain[1:] += h * before[:-1]
        if filter.is_lowpass:
            xi[-1] += h * (-g - state.alpha[0])
        else:
            xi[-1] += h * ((a[0] - b[0]) * state.beta[0] - b[0] * g - a[0] * state.alpha[0])
            held += h * np.concatenate([g[None], state.g[:-1]])[: len(held)]
        integrals[0], beta[0] = x, f_theta
        alpha[0] = _output(filter, a, b, PaperState(xi, alpha, beta, integrals, held))
        return PaperState(xi, alpha, beta, integrals, held), alpha[0].copy()

    def shift_x(self, state: PaperState, dx: ArrayLike) -> PaperState:
        """Move the origin of x by dx (n_x,): as at the start, in the derivatives of xi.

        Parameters
        ----------
        state : PaperState
        dx : (n_x,) array
        """
        jump, x = np.asarray(dx, state.x.dtype), state.x.copy()
        x[0] += jump
        return state._replace(xi=state.xi - self._weights(jump.dtype) * jump, x=x)

    def _weights(self, dtype: np.dtype) -> Array:
        """With which the integrals of x enter f_hat, over the scale of xi (a_0 in the low-pass form), (n, 1)."""
        b = np.eye(self.order)[0] if self.filter.is_lowpass else self.filter.b
        return b[::-1, None].astype(dtype)


def _output(filter: PhyFilter, a: Array, b: Array, state: PaperState) -> Array:
    falling = a[:0:-1, None]  # a_{n-1} ... a_1, for the first to the (n-1)-th integral
    chi1 = (falling * state.alpha[1:]).sum(axis=0)
    if filter.is_lowpass:
        chi2 = state.beta[0] + (falling * state.beta[1:]).sum(axis=0)
        return a[0] * state.xi[0] - chi1 + chi2 + a[0] * state.x[-1]
    gain = b[:0:-1, None]
    chi2 = state.beta[0] + ((falling - gain) * state.beta[1:]).sum(axis=0)
    chi3 = (gain * state.g).sum(axis=0)
    return state.xi[0] - chi1 + chi2 - chi3 + (b[::-1, None] * state.x).sum(axis=0)
