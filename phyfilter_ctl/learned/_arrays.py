"""What the learned models share: read-only numbers, vectors of parameters, pairs of rows, entries of a file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _signals
from .._sections import FloatArray
from .._signals import Given

# Numbers in the largest intermediate array: it stays in the cache, and no BLAS splits the product over threads.
_CHUNK = 1 << 17


def rows(name: str, values: Given, columns: int | None = None) -> FloatArray:
    """Finite samples, shape (N, columns)."""
    return _signals.array(name, values, ("N", "n" if columns is None else columns))


def frozen(name: str, values: ArrayLike, shape: tuple[int, ...] | None = None) -> FloatArray:
    """A finite, read-only copy; ``shape`` -1 stands for any length."""
    wanted = np.shape(values) if shape is None else tuple("N" if n == -1 else n for n in shape)
    array = _signals.array(name, values, wanted, empty=True)
    array.flags.writeable = False
    return array


def parameter_vector(values: ArrayLike, size: int) -> FloatArray:
    """A finite vector of ``size`` parameters."""
    return _signals.array("parameters", values, (size,))


def pairs(
    z: ArrayLike, f: ArrayLike, n_z: int | None = None, n_x: int | None = None
) -> tuple[FloatArray, FloatArray]:
    """Features and unknown dynamics with the same number of rows."""
    z = rows("z", z, n_z)
    return z, _signals.array("f", f, (len(z), "n_x" if n_x is None else n_x), beside="z")


def with_cotangent(z: ArrayLike, cotangent: ArrayLike, n_z: int, n_x: int) -> tuple[FloatArray, FloatArray]:
    """Features and a cotangent of the prediction with the same number of rows."""
    z = rows("z", z, n_z)
    return z, _signals.array("cotangent", cotangent, (len(z), n_x), beside="z")


def number(name: str, value: float, *, positive: bool = False) -> float:
    """A finite number >= 0, or > 0."""
    return _signals.number(name, value, above=0.0 if positive else None, least=0.0)


def chunks(count: int, width: int) -> Iterator[slice]:
    """Slices of ``count`` rows, each short enough for rows of ``width`` numbers."""
    rows = max(1, _CHUNK // max(width, 1))
    return (slice(first, first + rows) for first in range(0, count, rows))


def rms(difference: FloatArray) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(difference**2)))


def expect_entries(path: object, arrays: Mapping[str, NDArray[np.generic]], names: Iterable[str]) -> None:
    """Refuse a file with other entries than these."""
    if set(names) != set(arrays):
        raise ValueError(f"{path}: expected the entries {sorted(names)}, got {sorted(arrays)}; save it again")


def floats(arrays: Mapping[str, NDArray[np.generic]], name: str) -> FloatArray:
    """An entry of a file that must hold float64."""
    if arrays[name].dtype != np.float64:
        raise ValueError(f"{name}: expected float64, got {arrays[name].dtype}")
    return arrays[name].astype(float)


def weight_arrays(weights: Iterable[FloatArray], biases: Iterable[FloatArray]) -> dict[str, FloatArray]:
    """Weights and biases as entries of a file: weights_0, biases_0, weights_1, ..."""
    entries = {f"weights_{i}": W for i, W in enumerate(weights)}
    return entries | {f"biases_{i}": b for i, b in enumerate(biases)}


def read_weights(
    path: object, arrays: Mapping[str, NDArray[np.generic]], others: Iterable[str]
) -> tuple[tuple[FloatArray, ...], tuple[FloatArray, ...]]:
    """Weights and biases from the entries of a file that holds ``others`` besides, and nothing else."""
    depth = sum(name.startswith("weights_") for name in arrays)
    kinds = ("weights", "biases")
    expect_entries(path, arrays, (*others, *(f"{kind}_{i}" for kind in kinds for i in range(depth))))
    weights, biases = (tuple(floats(arrays, f"{kind}_{i}") for i in range(depth)) for kind in kinds)
    return weights, biases
