"""The denominators of a given order, each met exactly once: Hurwitz by construction, poles in bounds.

The chain in Schwarz form

    A = [[-d, -k_1], [k_1, 0, -k_2], [k_2, 0, ...], ...] - floor I,    B = sqrt(2 d) e_1,
    theta = log(d, k_1 ... k_{n-1})

has a Hurwitz characteristic polynomial for every theta (Schwarz, ZAMP 7 (1956): d and k_i are Routh's ratios), and
every polynomial with roots left of -floor has one theta. Poles may meet, cross from real to complex and repeat without
theta noticing, where products of sections have duplicates and roots have branch points. Two more properties are used:

* With floor = 0 the states are orthonormal: A + A' + B B' = 0, so their covariance under white noise is I and the
  least squares below stay well conditioned, whatever the poles (Ninness and Gustafsson, IEEE TAC 42 (1997)).
* The sum of the decay rates is d + n floor, and each is at least floor: bounds on d and k_i bound the poles.

Sensitivities with respect to theta lie in the span of the chain with every pole doubled, [xi, eta] with eta the same
chain behind the all-pass u - B'xi. They are constant rows of it, whatever the sampling.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import get_lapack_funcs, hessenberg, lu_solve, solve_triangular

from ..._sections import ComplexArray, FloatArray

# Poles that are to be moved left of the floor land this far from it, relative.
_INSIDE = 1e-3


@dataclass(frozen=True, eq=False)
class Chain:
    """A denominator of order n.

    Attributes
    ----------
    theta : (n,) array
        log d, log k_1 ... log k_{n-1}, all of rad/s.
    floor : float
        Least decay rate in rad/s.
    """

    theta: FloatArray
    floor: float

    @property
    def order(self) -> int:
        return len(self.theta)

    @cached_property
    def A(self) -> FloatArray:
        """(n, n) state matrix."""
        return self._skew - self.floor * np.eye(self.order)

    @cached_property
    def B(self) -> FloatArray:
        """(n,) input vector."""
        B = np.zeros(self.order)
        B[0] = np.sqrt(2.0 * np.exp(self.theta[0]))
        return B

    @cached_property
    def _skew(self) -> FloatArray:
        """A without the floor: skew but for the corner."""
        rates = np.exp(self.theta)
        A = np.diag(rates[1:], -1) - np.diag(rates[1:], 1)
        A[0, 0] = -rates[0]
        return A

    @cached_property
    def doubled(self) -> FloatArray:
        """[A2 B2; 0 0], shape (2n + 1, 2n + 1): the chain with every pole doubled, and its input."""
        n = self.order
        M = np.zeros((2 * n + 1, 2 * n + 1))
        M[:n, :n] = M[n : 2 * n, n : 2 * n] = self.A
        M[n : 2 * n, :n] = -np.outer(self.B, self.B)
        M[: 2 * n, -1] = np.tile(self.B, 2)
        return M

    @cached_property
    def poles(self) -> ComplexArray:
        """(n,) eigenvalues of A in rad/s."""
        return np.linalg.eigvals(self.A).astype(np.complex128)

    @cached_property
    def sensitivities(self) -> FloatArray:
        """Rows T (n, n, 2n): d xi_j / d theta_i = T[i, j] [xi; eta].

        T_i solves T A2 - A T = A_i [I 0], T B2 = B_i. Adding the second times B2' leaves two Lyapunov equations
        with the operator X -> A X + X A' (floor 0), which is regular for every Hurwitz A.

        Raises
        ------
        numpy.linalg.LinAlgError
            If it is singular to rounding: without the floor a pole would lie on the imaginary axis.
        """
        n, A, B = self.order, self._skew, self.B
        eye = np.eye(n)
        (getrf,) = get_lapack_funcs(("getrf",), (A,))
        # The Kronecker sum of A with itself; numpy.kron takes a tenth of a descent.
        total = A[:, None, :, None] * eye[:, None, :] + eye[:, None, :, None] * A[:, None, :]
        lu, order, _ = getrf(total.reshape(n * n, n * n))
        pivots = np.abs(np.diag(lu))
        if np.min(pivots) <= np.finfo(float).eps * np.max(pivots):
            raise np.linalg.LinAlgError("a pole of the chain without its floor lies on the imaginary axis")
        slopes, inputs = self._slopes
        drive = inputs[:, :, None] * B
        operator = (lu, order)
        first = lu_solve(operator, -(slopes + drive).reshape(n, n * n).T, check_finite=False).T
        first = first.reshape(n, n, n)
        behind = (first @ B)[:, :, None] * B - drive
        second = lu_solve(operator, behind.reshape(n, n * n).T, check_finite=False).T
        return np.concatenate([first, second.reshape(n, n, n)], axis=2)

    @cached_property
    def _slopes(self) -> tuple[FloatArray, FloatArray]:
        """A_i (n, n, n) and B_i (n, n), the derivatives by theta_i."""
        n = self.order
        rates = np.exp(self.theta)
        slopes, inputs = np.zeros((n, n, n)), np.zeros((n, n))
        slopes[0, 0, 0] = -rates[0]
        inputs[0] = 0.5 * self.B
        for i in range(1, n):
            slopes[i, i, i - 1], slopes[i, i - 1, i] = rates[i], -rates[i]
        return slopes, inputs

    @cached_property
    def lowpass(self) -> tuple[float, FloatArray]:
        """kappa, and its derivatives (n,), of the low-pass form F u = kappa xi_n: F(0) = 1."""
        slopes, inputs = self._slopes
        rest = -np.linalg.solve(self.A, self.B)
        moved = -np.linalg.solve(self.A, (inputs + slopes @ rest).T)[-1]
        kappa = 1.0 / float(rest[-1])
        return kappa, -(kappa**2) * moved

    @cached_property
    def polynomials(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Coefficients of D and of the numerators, and how theta moves them.

        Returns
        -------
        a : (n,) array
            Ascending coefficients of D, every one a sum of positive terms.
        R : (n, n) array
            Numerators: xi_i = sum_j R[j, i] s^j / D; upper left triangular, so b = R c for the output row c.
        a_slopes : (n, n) array
            d a_j / d theta_i at [i, j].
        R_slopes : (n, n, n) array
            d R / d theta_i at [i].
        """
        n = self.order
        squares = np.exp(2.0 * self.theta)
        # Minors of sI - A from the lower right corner: P_{j+1} = (s + floor) P_j + k^2 P_{j-1}; row 0 is the value, row
        # 1 + i the derivative by theta_i.
        minors = np.zeros((n + 1, n + 1, n + 1))
        minors[0, 0, 0] = 1.0
        for j in range(1, n + 1):
            minors[j] = self.floor * minors[j - 1]
            minors[j, :, 1:] += minors[j - 1, :, :-1]
            if j > 1:
                i = n - j + 1
                minors[j] += squares[i] * minors[j - 2]
                minors[j, 1 + i] += 2.0 * squares[i] * minors[j - 2, 0]
        d = np.exp(self.theta[0])
        minors[n] += d * minors[n - 1]
        minors[n, 1] += d * minors[n - 1, 0]
        R, R_slopes = np.zeros((n, n)), np.zeros((n, n, n))
        gains = np.sqrt(2.0 * d) * np.exp(np.concatenate([[0.0], np.cumsum(self.theta[1:])]))
        for i in range(n):
            R[:, i] = gains[i] * minors[n - 1 - i, 0, :n]
            R_slopes[:, :, i] = gains[i] * minors[n - 1 - i, 1:, :n]
            R_slopes[0, :, i] += 0.5 * R[:, i]
            R_slopes[1 : i + 1, :, i] += R[:, i]
        return minors[n, 0, :n].copy(), R, minors[n, 1:, :n].copy(), R_slopes

    def output(self, b: FloatArray) -> FloatArray:
        """Row c (n,) with c xi = N/D for ascending coefficients b of N."""
        # Columns in descending powers: state i starts at s^(n-1-i).
        R = self.polynomials[1][::-1]
        sizes = np.max(np.abs(R), axis=1)
        return np.asarray(solve_triangular(R / sizes[:, None], b[::-1] / sizes, lower=True))


def chain_of(poles: ComplexArray, floor: float = 0.0) -> Chain:
    """The chain with these poles (n,), complex ones in conjugate pairs next to each other.

    Poles that decay more slowly than the floor are moved left of it.
    """
    moved = np.array(poles, dtype=np.complex128)
    slow = moved.real > -(1.0 + _INSIDE) * floor
    moved[slow] = -(1.0 + _INSIDE) * floor + 1j * moved[slow].imag
    A, B = _orthonormal(moved + floor)
    bordered = np.zeros((len(B) + 1, len(B) + 1))
    bordered[0, 1:], bordered[1:, 0] = -B, B
    bordered[1:, 1:] = A + 0.5 * np.outer(B, B)
    # Householder: B to a multiple of e_1, the skew rest to a tridiagonal; both keep their size.
    reduced = np.abs(np.diag(np.asarray(hessenberg(bordered)), -1))
    rates = np.concatenate([[0.5 * reduced[0] ** 2], reduced[1:]])
    smallest = np.finfo(float).eps * float(np.max(rates))
    return Chain(np.log(np.maximum(rates, smallest)), floor)


def _orthonormal(poles: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """(A, B) with A + A' + B B' = 0: all-pass sections in series."""
    n = len(poles)
    A, B = np.zeros((n, n)), np.zeros(n)
    i = 0
    while i < n:
        decay, size = -poles[i].real, abs(poles[i])
        if poles[i].imag == 0.0:
            A[i, i], B[i] = -decay, np.sqrt(2.0 * decay)
            i += 1
        else:
            A[i : i + 2, i : i + 2] = [[-2.0 * decay, -size], [size, 0.0]]
            B[i] = 2.0 * np.sqrt(decay)
            i += 2
    return A - np.tril(np.outer(B, B), -1), B  # a pair takes its input in one state: nothing inside a section
