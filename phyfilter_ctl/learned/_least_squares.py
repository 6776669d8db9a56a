"""Linear least squares with a ridge, over any number of rows in bounded memory."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.linalg import lstsq
from threadpoolctl import threadpool_limits

from .._sections import FloatArray


def ridge(blocks: Iterator[tuple[FloatArray, FloatArray]], l2: float, columns: int) -> tuple[FloatArray, int]:
    """Minimise |B W - F|^2 / N + l2 |W|^2 over W (m, n_x), by QR block after block.

    The factor R of the blocks so far is carried on, so the condition of B is never squared. Coefficients that
    neither the data nor the ridge determine come out with the least norm.

    Parameters
    ----------
    blocks : iterator of (rows, m) and (rows, n_x) arrays
        B and F, some rows at a time.
    l2 : float
        Weight of the ridge.
    columns : int
        m.

    Returns
    -------
    W : (m, n_x) array
        Not a number where the basis overflows.
    rank : int
        Number of directions of W that the data alone determine.
    """
    # One thread: several are slower on a busy machine and make the last digits depend on the number of cores.
    with threadpool_limits(1, user_api="blas"):
        R, total, waiting, pending = None, 0, [], 0
        for B, F in blocks:
            waiting.append(np.hstack([B, F]))
            pending += len(B)
            total += len(B)
            if pending >= 4 * columns:  # so that the triangle carried along costs little
                R, waiting, pending = _triangle(R, waiting), [], 0
        if waiting:
            R = _triangle(R, waiting)
        assert R is not None  # there is at least one row
        A, right = R[:, :columns], R[:, columns:]
        if not np.all(np.isfinite(R)):
            return np.full((columns, right.shape[1]), np.nan), 0
        rank = int(np.linalg.matrix_rank(A))
        if l2 > 0.0:
            A = np.vstack([A, np.sqrt(l2 * total) * np.eye(columns)])
            right = np.vstack([right, np.zeros((columns, right.shape[1]))])
        solution = lstsq(A, right, lapack_driver="gelsy", cond=np.finfo(float).eps * max(A.shape))
    assert solution is not None  # what the type of SciPy's function allows for
    return np.asarray(solution[0], dtype=float), rank


def _triangle(R: FloatArray | None, rows: list[FloatArray]) -> FloatArray:
    stacked = np.vstack(rows if R is None else [R, *rows])
    return np.asarray(np.linalg.qr(stacked, mode="r"), dtype=float)
