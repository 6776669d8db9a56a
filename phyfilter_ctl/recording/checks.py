"""What a recording asks of its signals beside what every array must be."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _signals
from .._sections import FloatArray

# A step that long, in s and in usual steps, is a clock that was set, as for LiveRules.
_JUMP, _JUMP_STEPS = 60.0, 200.0


def fraction_of(fraction: float) -> float:
    """A share strictly between 0 and 1."""
    if not 0.0 < fraction < 1.0:
        raise ValueError(f"fraction: expected a number between 0 and 1, got {fraction!r}")
    return fraction


def columned(name: str, values: ArrayLike, width: int = 1) -> FloatArray:
    """A signal of ``width`` columns: that of one may be (N,). Not copied where that can be avoided."""
    given = _signals.real(name, values, copy=False)
    return given[:, None] if given.ndim == 1 and width == 1 else given


def measured(values: ArrayLike, *, copy: bool = True) -> FloatArray:
    """x, shape (N, n_x), N >= 2."""
    x = _signals.array("x", columned("x", values), ("N", "n_x"), finite=False, copy=copy)
    if len(x) < 2:
        raise ValueError(f"x: expected at least 2 samples, got {len(x)}")
    return x


def usable_or_nan(
    name: str, values: FloatArray, columns: Sequence[str] | None, *, finite: bool
) -> FloatArray:
    """The values, NaN where they are no numbers to reckon with; such are refused where all must be finite."""
    if finite:
        _signals.refuse_unusable(name, values, columns)
        return values
    return values if _signals.usable(values) else np.where(_signals.unusable(values), np.nan, values)


def signal(
    name: str,
    values: ArrayLike | None,
    shape: tuple[int, int],
    channels: Sequence[str],
    *,
    finite: bool = True,
) -> FloatArray | None:
    """A signal of the shape of x."""
    if values is None:
        return None
    array = _signals.array(name, columned(name, values, shape[1]), shape, beside="x", finite=False)
    return usable_or_nan(name, array, channels, finite=finite)


def is_jump(steps: FloatArray, dt: float) -> NDArray[np.bool_]:
    """Which steps (m,) are no gap but a clock that was set, or a log that goes on; ``dt`` is the usual step in s."""
    return np.asarray(steps > max(_JUMP, _JUMP_STEPS * dt))


def refuse_gaps(name: str, missing: NDArray[np.bool_]) -> None:
    """Raise for a log with gaps, where none can be used."""
    if missing.any():
        raise ValueError(
            f"{f'log {name!r}' if name else 'log'}: expected no gaps, got {int(missing.sum())} rows that miss a "
            f"signal, the first row {int(np.argmax(missing))}; give log.pieces(), the logs between the gaps"
        )


def features_of(values: ArrayLike | None, n: int, *, finite: bool = True) -> FloatArray | None:
    """Features, shape (n, n_z)."""
    if values is None:
        return None
    array = _signals.array("features", columned("features", values), (n, "n_z"), beside="x", finite=finite)
    return usable_or_nan("features", array, None, finite=finite)


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
