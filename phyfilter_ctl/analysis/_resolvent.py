"""G(s) = C (s I - A)^-1 B + D at many points s, without one dense solve per point.

Three savings, each taken only where it keeps the answer:

* A falls apart into blocks that no entry connects (the channels of a filter). Each is evaluated alone, equal
  ones once.
* Modal: A = V diag(l) V^-1 makes G a sum of simple fractions, one matrix product for all points. Right only with
  well conditioned eigenvectors, so never with repeated poles that share a chain.
* Schur: A = Q T Q* with T triangular always exists and Q is unitary. Back substitution runs over all points at
  once, its inner loop being matrix products (Laub, "Efficient multivariable frequency response computations",
  IEEE Trans. Automatic Control 26 (1981), who uses the Hessenberg form).

Points next to an eigenvalue are solved directly, as neither form resolves the distance to it.
"""

from __future__ import annotations

from dataclasses import dataclass

import control as ct
import numpy as np
from numpy.linalg import LinAlgError
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import matrix_balance, schur
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from .._sections import ComplexArray, FloatArray
from . import grids

__all__ = ["evaluate", "frequency_response"]

# The modal form loses about cond(V) eps; this leaves two digits below the 1e-9 the result is held to.
_EIGENVECTOR_CONDITION = 1e5
# Largest difference from direct solves, relative to their peak, that the modal form may show at the probes.
_PROBE_TOLERANCE = 1e-11
# Eigenvalues are known to a few eps |A|, so the distance |s - l| is good to 1e-9 above this many times |A|.
_NEAR = 1e-6
# Bytes of working memory per chunk of points: fits a core's cache with its neighbours, and bounds the total.
_CHUNK_BYTES = 1 << 22
# A product is cut into stacked ones of at most this many multiplications, where BLAS libraries stay on one thread:
# for matrices of this size a second one gains little on an idle machine and costs many times the work on a busy one.
_ONE_THREAD = 1 << 18
_LEAST_WIDTH = 16
# At a pole python-control writes this for every entry.
_AT_POLE = complex(np.inf, np.nan)


def frequency_response(system: ct.StateSpace, omega: ArrayLike | None) -> ct.FrequencyResponseData:
    """As control.frequency_response, for a state-space system."""
    discrete = system.isdtime(strict=True)
    dt = float(system.dt) if discrete else 0.0  # dt = True counts samples
    if omega is None:
        poles = np.asarray(system.poles(), dtype=np.complex128)
        if discrete:
            poles = np.log(poles[poles != 0.0]) / dt
        nyquist = np.pi / dt if discrete else np.inf
        grid = grids.decades(np.abs(poles), nyquist)
        grid = grid[grid <= nyquist]
    else:
        grid = grids.ordered(omega)
    points = np.asarray(np.exp(1j * grid * dt) if discrete else 1j * grid, dtype=np.complex128)
    A, B, C, D = (np.asarray(matrix, dtype=float) for matrix in (system.A, system.B, system.C, system.D))
    return ct.FrequencyResponseData(
        evaluate(A, B, C, D, points),
        grid,
        return_magphase=True,
        dt=system.dt,
        sysname=system.name,
        inputs=system.input_labels,
        outputs=system.output_labels,
    )


def evaluate(
    A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, points: ComplexArray
) -> ComplexArray:
    """Values C (s I - A)^-1 B + D at the points s.

    Parameters
    ----------
    A, B, C, D : (n, n), (n, m), (p, n), (p, m) arrays
    points : (N,) complex array
        s = j omega, or z = e^(j omega dt) for a discrete-time system.

    Returns
    -------
    (p, m, N) complex array
        Every entry is complex(inf, nan) at a point where s I - A is singular.

    Raises
    ------
    ValueError
        If a matrix holds a number that is not finite.
    """
    for name, matrix in (("A", A), ("B", B), ("C", C), ("D", D)):
        if not np.all(np.isfinite(matrix)):
            raise ValueError(f"{name}: every entry must be finite to evaluate a frequency response")
    values = np.empty((*D.shape, len(points)), dtype=np.complex128)
    values[:] = D[:, :, None]
    if len(A) == 0 or len(points) == 0:
        return values
    at_pole = np.zeros(len(points), dtype=bool)
    done: dict[tuple[bytes, bytes, bytes], tuple[ComplexArray, NDArray[np.bool_]]] = {}
    count, label = connected_components(csr_array(A != 0.0), directed=False)
    for block in range(count):
        states = np.flatnonzero(label == block)
        inputs = np.flatnonzero(np.any(B[states], axis=0))
        outputs = np.flatnonzero(np.any(C[:, states], axis=1))
        # Adding 0.0 turns -0.0 into 0.0, so that equal blocks have equal bytes.
        a = A[states][:, states] + 0.0
        b = B[states][:, inputs] + 0.0
        c = C[outputs][:, states] + 0.0
        key = (a.tobytes(), b.tobytes(), c.tobytes())
        if key not in done:
            done[key] = _block(a, b, c, points)
        part, singular = done[key]
        at_pole |= singular
        # One row at a time: a fancy index over both axes would copy the whole block first.
        for i, output in enumerate(outputs):
            for j, input_ in enumerate(inputs):
                values[output, input_] += part[i, j]
    values[:, :, at_pole] = _AT_POLE
    return values


def _block(
    A: FloatArray, B: FloatArray, C: FloatArray, points: ComplexArray
) -> tuple[ComplexArray, NDArray[np.bool_]]:
    """Values (p, m, N) for one connected block, and where s I - A is singular (N,)."""
    if C.shape[0] < B.shape[1]:  # fewer right-hand sides from the left
        values, singular = _block(A.T, C.T, B.T, points)
        return values.transpose(1, 0, 2), singular
    # Powers of two, so without rounding: companion matrices have entries that dwarf their eigenvalues.
    A, scaling = matrix_balance(A, permute=False, separate=True)[:2]
    scale = np.asarray(scaling[0])
    B, C = B / scale[:, None], C * scale
    form = _modal(A, B, C, points) or _Triangular.build(A, B, C)
    near = _near(form.eigenvalues, A, points)
    with np.errstate(
        divide="ignore", invalid="ignore", over="ignore"
    ):  # points on a pole are overwritten below
        values = form(points)
    singular = np.zeros(len(points), dtype=bool)
    where = np.flatnonzero(near)
    values[:, :, where], singular[where] = _direct(A, B, C, points[where])
    return values, singular


@dataclass(frozen=True)
class _Modal:
    """G as a sum over the eigenvalues, each conjugate pair l = sigma +- j omega taken together:

        r/(s - l) + conj(r)/(s - conj(l)) = 2 (Re r (s - sigma) - Im r omega) / ((s - l)(s - conj(l)))

    so that the weights are real and the product with them costs half of a complex one.
    """

    eigenvalues: ComplexArray
    weights: FloatArray  # (p m, n)
    shape: tuple[int, int]

    @classmethod
    def build(cls, eigenvalues: ComplexArray, left: ComplexArray, right: ComplexArray) -> _Modal:
        """From C V (p, n) and V^-1 B (n, m), conjugate pairs side by side as LAPACK returns them."""
        residues = (left[:, None, :] * right.T[None, :, :]).reshape(
            len(left) * right.shape[1], len(eigenvalues)
        )
        first = np.flatnonzero(eigenvalues.imag > 0.0)
        weights = residues.real.copy()
        weights[:, first] = 2.0 * residues[:, first].real
        weights[:, first + 1] = -2.0 * residues[:, first].imag
        return cls(eigenvalues, weights, (len(left), right.shape[1]))

    def __call__(self, points: ComplexArray) -> ComplexArray:
        values = np.empty((len(self.weights), len(points)), dtype=np.complex128)
        pole = self.eigenvalues[:, None]
        first = np.flatnonzero(self.eigenvalues.imag > 0.0)
        for part in _chunks(len(points), 2 * len(self.eigenvalues) + len(self.weights)):
            fractions = 1.0 / (points[part] - pole)
            both = fractions[first] * fractions[first + 1]
            fractions[first] = (points[part] - pole[first].real) * both
            fractions[first + 1] = pole[first].imag * both
            values[:, part] = _real_times(self.weights, fractions)
        return values.reshape(*self.shape, len(points))


@dataclass(frozen=True)
class _Triangular:
    """G = left (s I - T)^-1 right with T in real Schur form: 1 x 1 and 2 x 2 blocks on the diagonal."""

    eigenvalues: ComplexArray
    T: FloatArray
    left: FloatArray
    right: FloatArray

    @classmethod
    def build(cls, A: FloatArray, B: FloatArray, C: FloatArray) -> _Triangular:
        T, Q = schur(A, output="real")[:2]
        eigenvalues = np.diag(T).astype(np.complex128)
        for i in np.flatnonzero(np.diag(T, -1)):  # LAPACK makes both diagonal entries of such a block equal
            eigenvalues[i] += 1j * np.sqrt(-T[i, i + 1] * T[i + 1, i])
            eigenvalues[i + 1] = eigenvalues[i].conj()
        return cls(eigenvalues, T, C @ Q, Q.T @ B)

    def __call__(self, points: ComplexArray) -> ComplexArray:
        (p, n), m = self.left.shape, self.right.shape[1]
        values = np.empty((p, m, len(points)), dtype=np.complex128)
        for part in _chunks(len(points), n * (m + 1) + p * m):
            K = part.stop - part.start
            X = np.empty((n, m, K), dtype=np.complex128)
            X[:] = self.right[:, :, None]
            self._substitute(points[part], 1.0 / (points[part] - self.eigenvalues[:, None]), X, 0, n)
            values[:, :, part] = _real_times(self.left, X.reshape(n, m * K)).reshape(p, m, K)
        return values

    def _substitute(self, s: ComplexArray, inverse: ComplexArray, X: ComplexArray, lo: int, hi: int) -> None:
        """Solve rows lo ... hi of (s I - T) X = R in place, X (n, m, K) holding R. Halving the rows turns nearly
        all of it into matrix products."""
        T = self.T
        if hi - lo == 1:
            X[lo] *= inverse[lo]
        elif hi - lo == 2 and T[lo + 1, lo] != 0.0:
            off = s - T[lo, lo]
            both = inverse[lo] * inverse[lo + 1]
            first = (off * X[lo] + T[lo, lo + 1] * X[lo + 1]) * both
            X[lo + 1] = (off * X[lo + 1] + T[lo + 1, lo] * X[lo]) * both
            X[lo] = first
        else:
            middle = (lo + hi) // 2
            if T[middle, middle - 1] != 0.0:  # never cut a 2 x 2 block
                middle += 1 if middle + 1 < hi else -1
            self._substitute(s, inverse, X, middle, hi)
            flat = X.reshape(len(X), X.shape[1] * X.shape[2])
            flat[lo:middle] += _real_times(T[lo:middle, middle:hi], flat[middle:hi])
            self._substitute(s, inverse, X, lo, middle)


def _real_times(real: FloatArray, values: ComplexArray) -> ComplexArray:
    """Product of a real (r, n) with a complex (n, K) matrix, contiguous, at half the cost of a complex product."""
    (rows, inner), columns = real.shape, values.view(np.float64)
    product = np.empty((rows, columns.shape[1]))
    width = max(_LEAST_WIDTH, _ONE_THREAD // max(rows * inner, 1))
    whole = columns.shape[1] // width * width
    stacked = (inner, whole // width, width)
    np.matmul(
        real,
        columns[:, :whole].reshape(stacked).swapaxes(0, 1),
        out=product[:, :whole].reshape(rows, *stacked[1:]).swapaxes(0, 1),
    )
    product[:, whole:] = real @ columns[:, whole:]
    return product.view(np.complex128)


def _modal(A: FloatArray, B: FloatArray, C: FloatArray, points: ComplexArray) -> _Modal | None:
    """The modal form, or None where the eigenvectors do not carry it."""
    try:
        eigenvalues, V = np.linalg.eig(A)
        if not np.linalg.cond(V) <= _EIGENVECTOR_CONDITION:
            return None
        right = np.asarray(np.linalg.solve(V, B), dtype=np.complex128)
    except LinAlgError:
        return None
    form = _Modal.build(eigenvalues.astype(np.complex128), (C @ V).astype(np.complex128), right)
    probes = _probes(form.eigenvalues, A, points)
    exact, singular = _direct(A, B, C, probes)
    if exact.size == 0:
        return form
    error = np.max(np.abs(form(probes) - exact))
    return form if not np.any(singular) and error <= _PROBE_TOLERANCE * np.max(np.abs(exact)) else None


def _probes(eigenvalues: ComplexArray, A: FloatArray, points: ComplexArray) -> ComplexArray:
    """The ends, the middle and the points closest to the four eigenvalues that come closest to a point."""
    usable = points[~_near(eigenvalues, A, points)]
    if len(usable) == 0:
        return usable
    closest = [
        (float(np.min(d)), int(np.argmin(d))) for d in (np.abs(usable - value) for value in eigenvalues)
    ]
    chosen = {0, len(usable) // 2, len(usable) - 1, *(k for _, k in sorted(closest)[:4])}
    return usable[sorted(chosen)]


def _near(eigenvalues: ComplexArray, A: FloatArray, points: ComplexArray) -> NDArray[np.bool_]:
    """Which points lie next to an eigenvalue, as far as its rounding lets one tell."""
    radius = _NEAR * float(np.linalg.norm(A, 2))
    near = np.zeros(len(points), dtype=bool)
    for value in eigenvalues:
        near |= np.abs(points - value) <= radius
    return near


def _direct(
    A: FloatArray, B: FloatArray, C: FloatArray, points: ComplexArray
) -> tuple[ComplexArray, NDArray[np.bool_]]:
    """One dense solve per point; singular points are marked."""
    values = np.empty((len(C), B.shape[1], len(points)), dtype=np.complex128)
    singular = np.zeros(len(points), dtype=bool)
    eye = np.eye(len(A))
    # A block that no input reaches is looked at all the same: older numpy solves for no column without factorising.
    right = B if B.shape[1] else np.ones((len(A), 1))
    for k, s in enumerate(points):
        try:
            values[:, :, k] = (C @ np.linalg.solve(s * eye - A, right))[:, : B.shape[1]]
        except LinAlgError:
            values[:, :, k] = _AT_POLE
            singular[k] = True
    return values, singular


def _chunks(count: int, numbers: int) -> list[slice]:
    """Slices of ``count`` points whose ``numbers`` complex numbers each fill the working memory."""
    size = max(16, _CHUNK_BYTES // (16 * max(numbers, 1)))
    return [slice(k, min(k + size, count)) for k in range(0, count, size)]
