"""Features from the recent past of a signal."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from . import _arrays


def window(x: ArrayLike, length: int, *, stride: int = 1) -> FloatArray:
    """Return the sample at hand and those before it, side by side.

        row k = [x_k, x_{k-s}, x_{k-2s}, ..., x_{k-(L-1)s}],    x_j = x_0 for j < 0

    Parameters
    ----------
    x : array_like, shape (N, n_x)
        Signal.
    length : int
        Number L of samples in a row.
    stride : int
        Spacing s of these samples; every row is kept.

    Returns
    -------
    (N, length * n_x) array
        The channels of x_k first, then those of x_{k-s}, and so on.

    Raises
    ------
    ValueError, TypeError
        If ``x`` is not a finite real array of shape (N, n_x), or ``length`` or ``stride`` is below 1.

    Examples
    --------
    >>> window([[1.0], [2.0], [3.0], [4.0]], 2, stride=2).tolist()
    [[1.0, 1.0], [2.0, 1.0], [3.0, 1.0], [4.0, 2.0]]
    """
    x = _arrays.rows("x", x)
    length, stride = _signals.count("length", length), _signals.count("stride", stride)
    reach = (length - 1) * stride
    padded = np.concatenate([np.repeat(x[:1], reach, axis=0), x])
    spans = np.lib.stride_tricks.sliding_window_view(padded, reach + 1, axis=0)
    newest_first = spans[:, :, ::-1][:, :, ::stride]
    return np.array(newest_first.transpose(0, 2, 1), order="C").reshape(len(x), length * x.shape[1])
