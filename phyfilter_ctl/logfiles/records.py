"""Records of fixed layout that stand at known places of a file."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray

_BLOCK = 1 << 12  # rows that stay in a processor's cache
_PIECE = 1 << 16  # records that are gathered at a time


def gathered(
    data: NDArray[np.uint8], offsets: NDArray[np.int64], layout: np.dtype[np.void]
) -> NDArray[np.void]:
    """Records of one layout, in the order of their offsets."""
    out = np.empty(len(offsets), layout)
    reach = np.arange(layout.itemsize)
    for k in range(0, len(offsets), _PIECE):
        rows = data[offsets[k : k + _PIECE, None] + reach]
        out[k : k + _PIECE] = np.ascontiguousarray(rows).view(layout)[:, 0]
    return out


def side_by_side(columns: Sequence[NDArray[np.generic]]) -> FloatArray:
    """Columns of records as floats, shape (N, k): some rows at a time, for records lie row by row."""
    out = np.empty((len(columns[0]), len(columns)))
    for k in range(0, len(out), _BLOCK):
        for j, column in enumerate(columns):
            out[k : k + _BLOCK, j] = column[k : k + _BLOCK]
    return out


def layout_of(names: Sequence[str], kinds: Sequence[str]) -> np.dtype[np.void]:
    """Packed little-endian fields."""
    return np.dtype(
        [(name, np.dtype(kind).newbyteorder("<")) for name, kind in zip(names, kinds, strict=True)]
    )
