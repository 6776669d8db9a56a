"""Checks of recorded signals: each returns a checked copy or says which row is wrong."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from .._samples import LARGEST, interval, seconds, unmasked, unusable, usable
from .._sections import FloatArray

Where = Callable[[int], str]
_SHOWN = 5  # rows that an error lists


def row(index: int) -> str:
    """Place of a sample in an array; a file names its lines instead."""
    return f"row {index}"


def real(name: str, values: ArrayLike) -> FloatArray:
    """A copy as float64, NaN where it is masked."""
    try:
        if np.iscomplexobj(values):  # the conversion would drop the imaginary part with a warning only
            raise TypeError("it is complex")
        return np.array(unmasked(values), dtype=float)
    except (TypeError, ValueError) as error:
        raise TypeError(
            f"{name}: expected an array of real numbers with rows of one length: {error}"
        ) from error


def positive(name: str, value: float) -> float:
    """A positive finite number of seconds."""
    length = interval(name, value) if np.ndim(value) == 0 else float("nan")
    if not (np.isfinite(length) and length > 0.0):
        raise ValueError(f"{name}: expected a positive number of seconds, got {value!r}")
    return float(length)


def fraction_of(fraction: float) -> float:
    """A share strictly between 0 and 1."""
    if not 0.0 < fraction < 1.0:
        raise ValueError(f"fraction: expected a number between 0 and 1, got {fraction!r}")
    return fraction


def refuse_nonfinite(name: str, values: FloatArray, columns: Sequence[str], where: Where = row) -> None:
    """Raise at the first NaN, infinity or number too large to reckon with, of a two-dimensional array."""
    if usable(values):
        return
    bad = np.argwhere(unusable(values))
    index, column = (int(k) for k in bad[0])
    value = values[index, column]
    expected = f"a magnitude up to {LARGEST:g}" if np.isfinite(value) else "a finite number"
    remedy = "choose another unit" if np.isfinite(value) else "cut the log there or repair the samples"
    more = f"; {len(bad)} such values in all" if len(bad) > 1 else ""
    raise ValueError(
        f"{name}: {where(index)}, {columns[column]} is {value}, expected {expected}{more}; {remedy}"
    )


def refuse_unordered(name: str, times: FloatArray, where: Where = row) -> None:
    """Raise unless times increase."""
    bad = np.flatnonzero(np.diff(times) <= 1.0 / LARGEST) + 1
    if not len(bad):
        return
    listed = [
        f"{where(int(k))} ({times[k - 1]:.9g} s, then {times[k]:.9g} s: "
        f"{'stands still' if times[k] >= times[k - 1] else 'runs back'})"
        for k in bad[:_SHOWN]
    ]
    more = f" and {len(bad) - _SHOWN} more" if len(bad) > _SHOWN else ""
    raise ValueError(
        f"{name}: expected increasing times, but at {', '.join(listed)}{more}; drop repeated samples, split the log "
        "where it starts again"
    )


def measured(values: ArrayLike) -> FloatArray:
    """x, shape (N, n_x), N >= 2."""
    x = real("x", values)
    if x.ndim != 2 or x.shape[1] == 0:
        hint = "; for one channel give x[:, None]" if x.ndim == 1 else ""
        raise ValueError(f"x: expected shape (N, n_x), one row a sample, got {x.shape}{hint}")
    if len(x) < 2:
        raise ValueError(f"x: expected at least 2 samples, got {len(x)}")
    return x


def sample_times(values: ArrayLike, n: int) -> FloatArray:
    """Increasing finite times, shape (n,)."""
    times = seconds("times", values)
    if times.shape != (n,):
        raise ValueError(f"times: expected shape ({n},), one for every row of x, got {times.shape}")
    refuse_nonfinite("times", times[:, None], ("t",))
    refuse_unordered("times", times)
    return times


def channel_names(channels: Sequence[str] | None, n_x: int) -> tuple[str, ...]:
    """n_x different names that can stand in the header of a file."""
    if channels is None:
        return tuple(f"x[{i}]" for i in range(n_x))
    if isinstance(channels, str) or not all(isinstance(name, str) for name in channels):
        raise TypeError(f"channels: expected {n_x} names, got {channels!r}")
    names = tuple(channels)
    if len(names) != n_x:
        raise ValueError(
            f"channels: expected {n_x} names, one for every column of x, got {len(names)}: {names}"
        )
    if len(set(names)) < n_x:
        raise ValueError(f"channels: expected different names, got {names}")
    for name in names:
        if not name or name != name.strip() or not name.isprintable():
            raise ValueError(f"channels: expected printable names without spaces around them, got {name!r}")
    return names


def signal(
    name: str, values: ArrayLike | None, shape: tuple[int, int], channels: Sequence[str]
) -> FloatArray | None:
    """A finite signal of the shape of x."""
    if values is None:
        return None
    array = real(name, values)
    if array.shape != shape:
        raise ValueError(f"{name}: expected shape {shape} as x has, got {array.shape}")
    refuse_nonfinite(name, array, [f"channel {channel}" for channel in channels])
    return array


def features_of(values: ArrayLike | None, n: int) -> FloatArray | None:
    """Finite features, shape (n, n_z)."""
    if values is None:
        return None
    array = real("features", values)
    if array.ndim != 2 or len(array) != n or array.shape[1] == 0:
        raise ValueError(
            f"features: expected shape ({n}, n_z), one row for every row of x, got {array.shape}"
        )
    refuse_nonfinite("features", array, [f"column {k}" for k in range(array.shape[1])])
    return array


def inertia_of(values: ArrayLike | None, n: int, n_x: int) -> FloatArray | None:
    """A finite inertia of one of the five shapes."""
    if values is None:
        return None
    array = real("inertia", values)
    if array.ndim == 2 and n == n_x and array.shape == (n, n_x):
        raise ValueError(
            f"inertia: shape ({n}, {n_x}) is ambiguous where N == n_x: a matrix, or a diagonal for every sample; give "
            f"({n}, {n_x}, {n_x})"
        )
    if array.shape not in ((), (n_x,), (n_x, n_x), (n, n_x), (n, n_x, n_x)):
        raise ValueError(
            f"inertia: expected a scalar, ({n_x},), ({n_x}, {n_x}), ({n}, {n_x}) or ({n}, {n_x}, {n_x}), "
            f"got shape {array.shape}"
        )
    if inertia_varies(array, n):
        flat = array.reshape(n, -1)
        refuse_nonfinite("inertia", flat, [f"entry {_entry(k, array)}" for k in range(flat.shape[1])])
    elif not usable(array):
        raise ValueError(f"inertia: expected finite numbers up to {LARGEST:g}, got {array.tolist()}")
    return array


def _entry(k: int, inertia: FloatArray) -> tuple[int, ...]:
    return tuple(int(j) for j in np.unravel_index(k, inertia.shape[1:]))


def inertia_varies(inertia: FloatArray, n: int) -> bool:
    """Whether a checked inertia has one value a sample."""
    return inertia.ndim == 3 or (inertia.ndim == 2 and len(inertia) == n)


def full_inertia(inertia: FloatArray, n: int, n_x: int, *, varies: bool) -> FloatArray:
    """The inertia itself, or as (n, n_x, n_x) where its own shape would be ambiguous with n samples."""
    if inertia.ndim != 2 or n != n_x:
        return inertia
    return inertia[:, :, None] * np.eye(n_x) if varies else np.broadcast_to(inertia, (n, n_x, n_x))


def picked_inertia(
    inertia: FloatArray, n: int, n_picked: int, pick: Callable[[FloatArray], FloatArray]
) -> FloatArray:
    """Inertia of a log of ``n`` samples at the ``n_picked`` samples that ``pick`` takes."""
    varies = inertia_varies(inertia, n)
    n_x = inertia.shape[-1] if inertia.ndim else 1
    return full_inertia(pick(inertia) if varies else inertia, n_picked, n_x, varies=varies)


def inertia_rows(inertia: FloatArray, n: int, n_x: int) -> FloatArray:
    """Inertia as one row a sample: (n, n_x) for a scalar or a diagonal, (n, n_x^2) for a matrix."""
    if inertia.ndim < 2:
        return np.broadcast_to(inertia, (n, n_x))
    if inertia_varies(inertia, n):
        return inertia.reshape(n, -1)
    return np.broadcast_to(inertia.ravel(), (n, n_x * n_x))
