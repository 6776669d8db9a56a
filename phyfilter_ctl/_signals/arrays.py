"""Numbers and arrays: real, finite, of one shape."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from .._sections import FloatArray
from .containers import contained

__all__ = [
    "INSTEAD",
    "LARGEST",
    "Given",
    "Where",
    "array",
    "filled",
    "inertia",
    "real",
    "refuse_unusable",
    "row",
    "unmasked",
    "unusable",
    "usable",
]

# Of a sample, in any unit: the square of a larger one, times a step or a weight, may leave double precision.
LARGEST = 1e150

_DOUBLE = np.dtype(float)

# What to give instead, by numpy's letter for the kind.
INSTEAD = {
    "c": "give its real part, or its magnitude",
    "m": "divide it by numpy.timedelta64(1, 's')",
    "M": "dates go in as times only; elsewhere give numbers",
    "O": "convert its entries to float; where some are missing, to NaN",
}
Where = Callable[[int], str]
Given: TypeAlias = ArrayLike | Sequence[ArrayLike]


def row(index: int) -> str:
    """Place of a sample in an array; a file names its lines instead."""
    return f"row {index}"


# -- arrays ---------------------------------------------------------------------------------------------------------


def real(name: str, values: Given, dtype: DTypeLike = float, *, copy: bool = True) -> FloatArray:
    """A copy as float64, NaN where it is masked.

    Parameters
    ----------
    name : str
        For the complaint.
    values : array_like
        A frame, a series or a labelled array too; its rows go by position.
    dtype : dtype_like
        float32 instead; what it does not reach becomes infinite. Of a complex one complex numbers are let in too.
    copy : bool
        Whether to copy what is of this type already.

    Raises
    ------
    TypeError
        If they are no real numbers, or rows of several lengths.

    Examples
    --------
    >>> real("x", np.ma.array([1, 2], mask=[False, True])).tolist()
    [1.0, nan]
    """
    try:
        given = np.asarray(unmasked(values if type(values) is np.ndarray else contained(name, values)))
    except (TypeError, ValueError) as error:
        if str(error).startswith(f"{name}: "):
            raise
        raise TypeError(
            f"{name}: expected an array of real numbers with rows of one length: {error}"
        ) from error
    if given.dtype.kind not in "fiub" and not (given.dtype.kind == "c" and np.dtype(dtype).kind == "c"):
        held = (
            f"{given.dtype} ({type(given.flat[0]).__name__})"
            if given.dtype.kind == "O" and given.size
            else given.dtype
        )
        advice = INSTEAD.get(given.dtype.kind, "convert it to float")
        raise TypeError(f"{name}: expected an array of real numbers, got {held}; {advice}")
    if given.dtype is _DOUBLE and dtype is float:  # as nearly always, and at every step of a loop
        return given.copy() if copy else given
    with np.errstate(over="ignore"):  # of a wider type: an infinity, refused as such
        return given.astype(dtype, copy=copy)


def array(
    name: str,
    values: Given,
    shape: Sequence[int | str],
    *,
    beside: str = "",
    empty: bool = False,
    finite: bool = True,
    copy: bool = True,
) -> FloatArray:
    """A copy as float64 of finite real numbers of a shape.

    Parameters
    ----------
    name : str
        For the complaint.
    values : array_like
    shape : sequence of int and str
        Lengths; a name such as "N" stands for any length of at least 1, the same wherever it stands.
    beside : str
        What the shape is taken from.
    empty : bool
        Whether lengths that a name stands for may be 0.
    finite : bool
        Whether to refuse NaN, infinities and numbers beyond :data:`LARGEST`.
    copy : bool
        As for :func:`real`.

    Raises
    ------
    TypeError
        As for :func:`real`.
    ValueError
        If the shape is another, or a number not finite.

    Examples
    --------
    >>> array("v", [[1, 2], [3, 4]], ("N", 2)).tolist()
    [[1.0, 2.0], [3.0, 4.0]]
    >>> array("v", [1, 2], ("N", "n_x"))
    Traceback (most recent call last):
        ...
    ValueError: v: expected shape (N, n_x), got (2,); for one channel give v[:, None]
    """
    given = real(name, values, copy=copy)
    if not _fits(given.shape, shape, empty):
        wanted = f"({', '.join(map(str, shape))}{',' if len(shape) == 1 else ''})"
        reason = f" to go with {beside}" if beside else ""
        advice = _reshaping(name.rpartition(" ")[2], given.shape, shape, empty)
        raise ValueError(f"{name}: expected shape {wanted}{reason}, got {given.shape}{advice}")
    if finite:
        refuse_unusable(name, given)
    return given


def filled(
    name: str, values: Given, shape: Sequence[int], *, least: float = -np.inf, finite: bool = True
) -> FloatArray:
    """A copy as float64, where a single number, or a single row, stands for all.

    Parameters
    ----------
    name : str
    values : array_like
    shape : sequence of int
    least : float
        No number may lie below.
    finite : bool
        As for :func:`array`.

    Raises
    ------
    TypeError, ValueError
        As for :func:`array`, and if a number lies below ``least``.

    Examples
    --------
    >>> filled("drag", 0.5, (3,), least=0.0).tolist()
    [0.5, 0.5, 0.5]
    """
    given = real(name, values)
    wanted = tuple(shape)
    if given.ndim > len(wanted) or given.shape != wanted[len(wanted) - given.ndim :]:
        raise ValueError(f"{name}: expected a number or shape {wanted}, got shape {given.shape}")
    if finite:
        refuse_unusable(name, given)
    if given.size and given.min() < least:
        raise ValueError(f"{name}: expected numbers >= {least:g}, got {given.tolist()}")
    return np.broadcast_to(given, wanted).copy()


def inertia(name: str, values: Given, n_x: int, n: int | None = None, *, finite: bool = True) -> FloatArray:
    """An inertia M as it was given: a number, a diagonal or a matrix, of one sample or with one for each of ``n``.

    Parameters
    ----------
    name : str
    values : array_like
        A number, (n_x,) or (n_x, n_x); with ``n`` also (n, n_x) or (n, n_x, n_x).
    n_x, n : int
    finite : bool
        As for :func:`array`.

    Raises
    ------
    TypeError, ValueError
        As for :func:`array`; and where n == n_x leaves open what (n, n_x) means.
    """
    given = real(name, values)
    shapes: list[tuple[int, ...]] = [(), (n_x,), (n_x, n_x)]
    if n is not None:
        if given.ndim == 2 and given.shape == (n, n_x) and n == n_x:
            raise ValueError(
                f"{name}: shape ({n}, {n_x}) is ambiguous where N == n_x: a matrix, or a diagonal for every sample; "
                f"give ({n}, {n_x}, {n_x})"
            )
        shapes += [(n, n_x), (n, n_x, n_x)]
    if given.shape not in shapes:
        listed = ", ".join(str(shape) for shape in shapes[1:-1])
        raise ValueError(
            f"{name}: expected a number or shape {listed} or {shapes[-1]}, got shape {given.shape}"
        )
    if finite:
        refuse_unusable(name, given)
    return given


def _fits(got: tuple[int, ...], shape: Sequence[int | str], empty: bool) -> bool:
    if len(got) != len(shape):
        return False
    lengths: dict[str, int] = {}
    for length, wanted in zip(got, shape, strict=True):
        if isinstance(wanted, str):
            if (length == 0 and not empty) or length != lengths.setdefault(wanted, length):
                return False
        elif length != wanted:
            return False
    return True


def _reshaping(name: str, got: tuple[int, ...], shape: Sequence[int | str], empty: bool) -> str:
    """What to do about a shape."""
    if 0 in got and len(got) == len(shape):
        return "; give at least one of each"
    if len(got) == 1 and len(shape) == 2:
        if _fits((got[0], 1), shape, empty):
            return f"; for one channel give {name}[:, None]"
        return f"; for one sample give {name}[None]" if _fits((1, got[0]), shape, empty) else ""
    if len(got) == 2 and _fits(got[::-1], shape, empty):
        return f"; give its transpose {name}.T, one row a sample"
    return ""


def unmasked(values: Given) -> Given:
    """The values with NaN (NaT) where they are masked: numpy would hand out what lies under the mask.

    Parameters
    ----------
    values : array_like
        Masked arrays, also in lists; anything else is given back as it is.
    """
    if type(values) is np.ndarray:  # at every step of a loop
        return values
    if isinstance(values, list | tuple) and _hold_masked(values):
        masked = _stacked(values)
    elif isinstance(values, np.ma.MaskedArray):
        masked = values
    else:
        return values
    kind = masked.dtype.kind
    plain = np.array(masked.data, float if kind in "iub" else masked.dtype)
    if kind in "iubfcmMO":
        plain[np.ma.getmaskarray(masked)] = None if kind == "O" else "NaT" if kind in "mM" else np.nan
    return plain


def _hold_masked(values: Sequence[object]) -> bool:
    kinds = set(map(type, values))
    if any(issubclass(kind, np.ma.MaskedArray) for kind in kinds):
        return True
    return bool(kinds & {list, tuple}) and any(
        _hold_masked(entry) for entry in values if isinstance(entry, list | tuple)
    )


def _stacked(values: object) -> np.ma.MaskedArray:
    if isinstance(values, list | tuple):
        return np.ma.stack([_stacked(entry) for entry in values])
    return np.ma.asarray(values)


# -- what is finite -------------------------------------------------------------------------------------------------


def usable(values: NDArray[np.floating]) -> bool:
    """Whether all are finite and no larger than :data:`LARGEST`, without an array of their size."""
    return not values.size or (float(values.min()) >= -LARGEST and float(values.max()) <= LARGEST)


def unusable(values: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Which are not."""
    return ~(np.abs(values) <= np.float64(LARGEST))


def refuse_unusable(
    name: str,
    values: NDArray[np.floating],
    columns: Sequence[str] | None = None,
    where: Where | None = None,
    *,
    advice: str = "leave it out or repair it",
) -> None:
    """Raise at the first NaN, infinity or number too large to reckon with.

    Parameters
    ----------
    name : str
    values : array
    columns : sequence of str, optional
        What the second index is called; by default "column k".
    where : callable, optional
        What the first index is called; by default "row k", or "entry k" of a vector.
    advice : str
        What to do about a value that is not finite.
    """
    if usable(values):
        return
    bad = np.argwhere(unusable(values))
    index = tuple(int(k) for k in bad[0])
    value = float(values[index])
    place = ""
    if index:
        place = (
            f" in {where(index[0]) if where else f'entry {index[0]}' if len(index) == 1 else row(index[0])}"
        )
    if len(index) == 2:
        place += f", {columns[index[1]] if columns else f'column {index[1]}'}"
    elif len(index) > 2:
        place += f", entry {index[1:]}"
    more = f"; {len(bad)} such values in all" if len(bad) > 1 else ""
    if np.isfinite(value):
        expected, advice = f"finite numbers up to {LARGEST:g}", "choose another unit"
    else:
        expected = "finite numbers, none masked"
    raise ValueError(f"{name}: expected {expected}, got {value:g}{place}{more}; {advice}")
