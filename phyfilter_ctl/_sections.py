"""Poles, first- and second-order sections, and the matrix exponential they need.

A filter F = N/D is realised as a chain of sections, each of unit gain at s = 0, so that every state has the
size of the residual that drives it:

* a real pole p:            w' = p (w - v)
* a pair sigma +- j omega:  w1' = sigma w1 - (omega^2 / r) w2 + r v,   w2' = r w1 + sigma w2,   r = |p|

``v`` is the section before (or the input of the chain). The pair tends to two equal real poles as omega -> 0, so
repeated and nearly repeated poles need no special case. N enters as a combination of the states.

The fastest section comes first: each state then passes what lies below its own pole, and the weights are about the
steps of F from one pole to the next. Slowest first, no state would pass more than the slowest pole lets through, and
weights that grow with the ratio of the poles, and cancel, would have to bring the rest back.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag, solve_triangular

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

# Coefficients that a set of poles reproduces to this relative error are the same polynomial in double
# precision: rounding each a_i once and forming the product of n factors costs about n eps.
SAME_POLYNOMIAL = 1e-14
# Poles given beside coefficients must reproduce them to this (they may have been typed with fewer digits).
_POLES_AGREE = 1e-6
# More poles than this leave no digits in the coefficients; finding them takes time with the cube of their number.
HIGHEST_ORDER = 64
_LARGEST_POLE = 1e300  # rad/s; sums of a few stay finite
# Poles whose magnitudes differ by less than this, relative, are equally fast.
_SAME_SPEED = 1e-10
# Taylor series of expm1 below this norm: 18 terms leave 0.5**18 / 19! < 1e-22 of the result.
_TAYLOR_NORM = 0.5
_TAYLOR_TERMS = 18
_KEPT_ORDER = 12
# Rows of one matrix product: small enough that no BLAS splits it over threads, whose start costs more than the work.
_SLAB = 128
_LONELY = (
    "the pole {:.6g} has no conjugate: complex poles come in pairs p, conj(p), so that the coefficients are "
    "real; add {:.6g}"
)


def polynomial_from_roots(roots: ComplexArray) -> FloatArray:
    """Ascending coefficients of prod (s - root) without the leading 1, shape (n,)."""
    coefficients = np.ones(1, dtype=np.complex128)
    for root in roots:
        coefficients = np.convolve(coefficients, np.array([1.0, -root])).astype(np.complex128)
    return np.real(coefficients[:0:-1]).copy()


def relative_difference(one: FloatArray, other: FloatArray) -> float:
    """Largest relative difference of two coefficient vectors that have no zero entry."""
    return float(np.max(np.abs(one - other) / np.abs(other)))


def roots_of_monic(a: FloatArray) -> ComplexArray:
    """Roots of s^n + a[n-1] s^(n-1) + ... + a[0], repeated ones recognised.

    A root of multiplicity m is spread by an eigenvalue solver over a circle of radius eps**(1/m). Where the mean
    of such a cluster, repeated, gives the coefficients back to rounding, it is the better answer.
    """
    n = len(a)
    scale = abs(a[0]) ** (1.0 / n) or 1.0
    scaled = a / scale ** np.arange(n, 0, -1)
    roots = np.roots(np.concatenate([[1.0], scaled[::-1]])).astype(np.complex128)
    if np.all(scaled > 0.0):  # no root at all on or right of the axis without this
        for radius in 10.0 ** np.arange(-1.0, -8.5, -0.5):
            merged = _merge_clusters(roots, radius)
            if len(np.unique(merged)) == n:  # none is near another: closer still, neither
                break
            error = relative_difference(polynomial_from_roots(merged), scaled)
            if error <= n * SAME_POLYNOMIAL:
                roots = merged
                break
    return sort_poles(roots * scale)


def _merge_clusters(roots: ComplexArray, radius: float) -> ComplexArray:
    """Replace roots that hang together within ``radius`` (relative) by their mean."""
    near = np.abs(roots[:, None] - roots[None, :]) <= radius * np.abs(roots)[:, None]
    reach = near | near.T
    for _ in range(len(roots).bit_length()):
        reach = reach @ reach
    merged = np.array([roots[row].mean() for row in reach], dtype=np.complex128)
    # A cluster that is its own mirror image has a real mean.
    alone = np.abs(merged.imag) <= 4.0 * np.finfo(float).eps * np.abs(merged)
    merged[alone] = merged[alone].real
    return merged


def sort_poles(poles: ComplexArray) -> ComplexArray:
    """Slowest first; each complex pair together and exactly conjugate, the positive imaginary part first.

    Magnitudes that differ by rounding count as equal: Butterworth's poles come in one order, however they were found.
    """
    kept = poles[poles.imag >= 0.0]
    kept = kept[np.argsort(np.abs(kept), kind="stable")]
    size = np.abs(kept)
    speed = np.cumsum(np.diff(size, prepend=size[:1]) > _SAME_SPEED * size)
    order = np.lexsort((kept.imag, kept.real, speed))
    both: list[complex] = []
    for pole in kept[order]:
        both += [complex(pole.real)] if pole.imag == 0.0 else [pole, pole.conjugate()]
    return np.array(both, dtype=np.complex128)


def pair_conjugates(poles: ComplexArray, tolerance: float = 1e-9) -> ComplexArray:
    """Make complex poles exact conjugate pairs.

    Raises
    ------
    ValueError
        If a complex pole has no conjugate within ``tolerance`` (relative).
    """
    rounding = 4.0 * np.finfo(float).eps * np.abs(poles)
    kept = [complex(p.real, 0.0) for p in poles[np.abs(poles.imag) <= rounding]]
    unpaired = list(poles[poles.imag < -rounding])
    for pole in poles[poles.imag > rounding]:
        partner = min(unpaired, key=lambda q: abs(q - pole.conjugate()), default=None)
        if partner is None or abs(partner - pole.conjugate()) > tolerance * abs(pole):
            raise ValueError(_LONELY.format(pole, pole.conjugate()))
        unpaired.remove(partner)
        kept.append(0.5 * (pole + partner.conjugate()))
    if unpaired:
        raise ValueError(_LONELY.format(unpaired[0], unpaired[0].conjugate()))
    return sort_poles(np.array(kept, dtype=np.complex128))


def found_poles(a: FloatArray) -> ComplexArray:
    """Roots of D for coefficients from outside, whatever their size."""
    try:
        with np.errstate(all="ignore"):
            return roots_of_monic(a)
    except np.linalg.LinAlgError:
        raise ValueError(
            f"a: poles that belong to {a.tolist()} are too far apart for double precision; use from_poles"
        ) from None


def given_poles(poles: ArrayLike, n: int | None = None) -> ComplexArray:
    """Finite poles, n of them, sorted and in exact pairs."""
    roots = np.atleast_1d(np.asarray(poles, dtype=np.complex128))
    if roots.ndim != 1 or len(roots) == 0:
        raise ValueError(f"poles: expected at least one pole in one dimension, got shape {roots.shape}")
    if n not in (None, len(roots)):
        raise ValueError(f"poles: expected {n} for the {n} coefficients in a, got {len(roots)}")
    if len(roots) > HIGHEST_ORDER:
        raise ValueError(f"poles: expected at most {HIGHEST_ORDER}, got {len(roots)}: choose a lower order")
    # Compared by parts: the magnitude itself may overflow.
    if not np.all(np.maximum(np.abs(roots.real), np.abs(roots.imag)) < _LARGEST_POLE):
        raise ValueError(f"poles: expected finite ones below {_LARGEST_POLE:g} rad/s, got {roots}")
    return pair_conjugates(roots)


def agreeing(roots: ComplexArray, a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """a and b of D = prod (s - root): as given where that holds to rounding, else from the roots.

    F and 1 - F are evaluated over the poles, with numerators from a and b: they add up to 1 as D and a agree.
    """
    product = polynomial_from_roots(roots)
    with np.errstate(all="ignore"):
        difference = relative_difference(product, a)
    if not difference <= _POLES_AGREE:
        raise ValueError(
            f"poles do not belong to a: their product gives {product.tolist()}, a is {a.tolist()}; give one of the two"
        )
    if difference <= len(a) * SAME_POLYNOMIAL:
        return a, b
    return product, np.where(b == a, product, b * (product / a))  # type and F(0) stay


def _fastest_first(poles: ComplexArray) -> ComplexArray:
    """Sorted poles turned round, of each pair the positive imaginary part again first: the order of the chain."""
    return poles[::-1].conj()


def chain(poles: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """State matrix A (n, n) of the chain of sections and its equilibrium for a unit input (n,).

    ``poles`` as :func:`sort_poles` has them, slowest first; the chain begins with the fastest. The input vector is
    ``-A @ equilibrium``; it is zero but for the first section.
    """
    n = len(poles)
    p = _fastest_first(poles)
    A = np.zeros((n, n))
    equilibrium = np.ones(n)
    i = 0
    while i < n:
        pole = p[i]
        if pole.imag == 0.0:
            A[i, i] = pole.real
            if i:
                A[i, i - 1] = -pole.real
            i += 1
        else:
            r = abs(pole)
            A[i, i] = A[i + 1, i + 1] = pole.real
            A[i, i + 1] = -(pole.imag**2) / r
            A[i + 1, i] = r
            if i:
                A[i, i - 1] = r
            equilibrium[i] = -pole.real / r
            i += 2
    return A, equilibrium


def chain_output(poles: ComplexArray, a: FloatArray, b: FloatArray) -> FloatArray:
    """Row C (n,) so that C (sI - A)^-1 B = N/D for the chain of ``poles``."""
    n = len(poles)
    output = np.zeros(n)
    if b[0] == a[0] and not np.any(b[1:]):
        output[-1] = 1.0
        return output
    scale, columns = _numerators(poles, a)
    scaled_b = b / scale ** np.arange(n, 0, -1)
    # Reversed, row s^(n-1) first, the matrix is lower triangular.
    output = np.asarray(solve_triangular(columns[::-1], scaled_b[::-1], lower=True))
    _, equilibrium = chain(poles)
    output[-1] += b[0] / a[0] - output @ equilibrium  # F(0) to the last digit
    return output


def chain_numerator(poles: ComplexArray, a: FloatArray, C: FloatArray) -> FloatArray:
    """Ascending coefficients (n,) of N = D C (sI - A)^-1 B: what :func:`chain_output` undoes."""
    scale, columns = _numerators(poles, a)
    return columns @ C * scale ** np.arange(len(C), 0, -1)


def _numerators(poles: ComplexArray, a: FloatArray) -> tuple[float, FloatArray]:
    """A frequency in rad/s, and in units of it the numerator of each state of the chain, column by column."""
    n = len(poles)
    # In s / scale all coefficients are of one size. Numerator of state i: the gains up to it times the
    # denominators after it, so its degree falls by one a state and the system is triangular.
    scale = float(abs(a[0]) ** (1.0 / n))
    p = _fastest_first(poles) / scale
    columns = np.zeros((n, n))
    gain, i = 1.0, 0
    while i < n:
        if p[i].imag == 0.0:
            gain *= -p[i].real
            columns[: n - i, i] = gain * _denominator(p[i + 1 :])
            i += 1
        else:
            r = abs(p[i])
            later = _denominator(p[i + 2 :])
            columns[: n - i, i] = gain * r * np.convolve(later, [-p[i].real, 1.0])
            gain *= r * r
            columns[: n - i - 1, i + 1] = gain * later
            i += 2
    return scale, columns


def side_by_side(
    chains: Sequence[tuple[FloatArray, FloatArray, FloatArray]],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Chains (A, equilibrium, C) of all channels as one system (A, B, C) with B = -A equilibrium."""
    A, B, C = (
        np.asarray(block_diag(*blocks), dtype=float)
        for blocks in zip(*[(A, (-A @ rest)[:, None], C[None, :]) for A, rest, C in chains], strict=True)
    )
    return A, B, C


def continuous_matrices(
    chains: Sequence[tuple[FloatArray, FloatArray, FloatArray]],
    momentum: FloatArray,
    E_left: FloatArray,
    f_theta: bool = True,
) -> tuple[tuple[FloatArray, FloatArray, FloatArray, FloatArray], FloatArray]:
    """(A, B, C, D) from x, g and f_theta to f_hat = f_theta + F (P x' - E_left g - f_theta), x not differentiated.

        z' = A z + A B P x - B (E_left g + f_theta),    f_hat = C z + C B P x + f_theta    (z = w - B P x)

    ``chains`` one per channel of f, ``momentum`` P = E_left M (n_f, n_x). With it the matrix that takes the first
    inputs to the state of rest, z = -B P x. Without ``f_theta`` it is no input, but 0.
    """
    A, B, C = side_by_side(chains)
    into = B @ momentum
    learned = np.eye(len(C))[:, : len(C) if f_theta else 0]
    inputs = np.hstack([A @ into, -B @ E_left, -B @ learned])
    through = np.hstack([C @ into, np.zeros_like(E_left), learned])
    rest = np.hstack([-into, np.zeros((len(A), inputs.shape[1] - into.shape[1]))])
    return (A, inputs, C, through), rest


def _denominator(poles: ComplexArray) -> FloatArray:
    """Ascending coefficients of prod (s - p) with the leading 1."""
    return np.concatenate([polynomial_from_roots(poles), [1.0]])


def covariance(poles: ComplexArray, other: ComplexArray, noise: float) -> FloatArray:
    """Covariance (n, m) of the states of two chains, less equilibrium times input, on one random input.

    The input is a random walk of unit intensity with white noise of intensity ``noise`` on it: the solution of
    A X + X A_other' + e e_other' + noise b b_other' = 0, e the equilibria, b the input vectors (zero but for the first
    entry). Section by section from the first: with sigma I + N for each, N^2 = -omega^2 I, a block of X is
    a polynomial of the two N over a number. ``poles`` as :func:`chain` has them.
    """
    p, q = _fastest_first(poles), _fastest_first(other)
    (_, e), (_, f) = chain(poles), chain(other)
    X = np.zeros((len(p), len(q)))
    i = 0
    while i < len(p):
        rows = slice(i, i + (1 if p[i].imag == 0.0 else 2))
        j = 0
        while j < len(q):
            columns = slice(j, j + (1 if q[j].imag == 0.0 else 2))
            R = np.outer(e[rows], f[columns])
            if i > 0:
                R[0] += abs(p[i]) * X[i - 1, columns]
            if j > 0:
                R[:, 0] += abs(q[j]) * X[rows, j - 1]
            if i == j == 0:
                R[0, 0] += noise * abs(p[0]) * abs(q[0])
            s, square = p[i].real + q[j].real, q[j].imag ** 2
            alpha = s * s + (p[i].imag - q[j].imag) * (p[i].imag + q[j].imag)
            RN = R @ _turn(q[j]).T
            whole = s * (alpha + 2.0 * square) * R + (alpha - 2.0 * s * s) * RN
            whole += _turn(p[i]) @ (2.0 * s * RN - alpha * R)
            X[rows, columns] = -whole / (alpha * alpha + 4.0 * s * s * square)
            j = columns.stop
        i = rows.stop
    return X


def _turn(pole: complex) -> FloatArray:
    """N, a section without its damping."""
    r = abs(pole)
    return np.zeros((1, 1)) if pole.imag == 0.0 else np.array([[0.0, -(pole.imag**2) / r], [r, 0.0]])


def expm1(A: FloatArray, step: FloatArray | float) -> FloatArray:
    """exp(A step) - I, accurate relative to its own size, for one step or many.

    Taylor series of A step / 2^q, then q squarings in delta form, (I + X)^2 - I = 2X + X^2: nothing is ever
    subtracted from I, so slow poles keep their digits. For many steps the series is one matrix product of powers
    of the step with the powers of A.

    Parameters
    ----------
    A : (n, n) array
    step : float or (N,) array

    Returns
    -------
    (n, n) or (N, n, n) array
    """
    n = len(A)
    steps = np.atleast_1d(np.asarray(step, dtype=float))
    size = np.abs(steps) * float(np.linalg.norm(A, np.inf))
    with np.errstate(divide="ignore"):
        squarings = np.maximum(0, np.ceil(np.log2(size / _TAYLOR_NORM))).astype(np.intp)
    powers = _kept_powers(np.asarray(A, dtype=float).tobytes()) if n <= _KEPT_ORDER else _powers(A)
    result = np.empty((len(steps), n, n))
    for q in np.unique(squarings) if len(steps) > 1 else squarings:
        rows = squarings == q
        reduced = steps[rows] / 2.0**q
        basis = np.cumprod(
            np.broadcast_to(reduced[:, None], (len(reduced), _TAYLOR_TERMS)), axis=1, dtype=float
        )
        X = multiply(basis, powers).reshape(-1, n, n)
        for _ in range(q):
            X = 2.0 * X + X @ X
        result[rows] = X
    return result[0] if np.ndim(step) == 0 else result


def _powers(A: FloatArray) -> FloatArray:
    """A^j / j! from j = 1 on, a row each."""
    powers = np.empty((_TAYLOR_TERMS, A.size))
    term = np.eye(len(A))
    for j in range(_TAYLOR_TERMS):
        term = term @ A / (j + 1)
        powers[j] = term.ravel()
    return powers


@lru_cache(maxsize=64)
def _kept_powers(A: bytes) -> FloatArray:
    """:func:`_powers` of a small matrix: a bound halves its steps again and again."""
    entries = np.array(np.frombuffer(A))
    n = math.isqrt(len(entries))
    powers = _powers(entries.reshape(n, n))
    powers.setflags(write=False)  # all callers share them
    return powers


def multiply(rows: FloatArray, matrix: FloatArray) -> FloatArray:
    """rows @ matrix, a slab of rows at a time."""
    product = np.empty((len(rows), matrix.shape[1]))
    for first in range(0, len(rows), _SLAB):
        np.matmul(rows[first : first + _SLAB], matrix, out=product[first : first + _SLAB])
    return product
