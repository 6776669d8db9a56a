"""Arrays of every type, layout and shape, through every door: answered as plain float64 numbers, or refused by name.

A door answers as for the same numbers as float64 in C order, or refuses with a TypeError or ValueError that names the
argument; what holds no real numbers, or is masked, is always refused. Nothing else is raised, no input is changed.
"""

from __future__ import annotations

import dataclasses
import functools
import pickle
import re
import warnings
from collections.abc import Callable, Iterator
from decimal import Decimal
from types import FunctionType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from phyfilter_ctl import PhyFilter
from tests.contracts.doors import DOORS, TIME_DOORS, TIMES

Floats = NDArray[np.float64]
ALL = DOORS | {name: (TIMES, enter) for name, enter in TIME_DOORS.items()}


def whole(kind: str) -> Callable[[Floats], NDArray[Any]]:
    """As whole numbers, where the type reaches."""
    least = np.iinfo(kind).min
    return lambda v: np.maximum(np.round(3.0 * v), max(least, -100)).clip(max=100).astype(kind)


def put(values: Any, entry: object) -> Any:
    changed = values.copy()
    changed.flat[0] = entry
    return changed


def unaligned(v: NDArray[Any]) -> NDArray[Any]:
    return np.frombuffer(b"?" + v.tobytes(), v.dtype, offset=1).reshape(v.shape)


def frozen(v: NDArray[Any]) -> NDArray[Any]:
    v = v.copy()
    v.flags.writeable = False
    return v


# What it holds that has a value as float64.
NUMBERS: dict[str, Callable[[Floats], Any]] = {
    "float64": np.copy,
    "float32": lambda v: v.astype("f4"),
    "float16": lambda v: v.astype("f2"),
    "longdouble": lambda v: v.astype("g"),
    "big-endian": lambda v: v.astype(">f8"),
    "big-endian float32": lambda v: v.astype(">f4"),
    "big-endian int": lambda v: whole("i4")(v).astype(">i4"),
    **{kind: whole(kind) for kind in ("int8", "int16", "int32", "int64", "uint8", "uint64")},
    "bool": lambda v: v > 0.0,
    "largest int": lambda v: put(whole("i8")(v), np.iinfo("i8").max),
    "largest uint": lambda v: put(whole("u8")(v), np.iinfo("u8").max),
    "denormal": lambda v: put(v, 5e-324),
    "huge": lambda v: put(v, 1e200),
    "nan": lambda v: put(v, np.nan),
    "inf": lambda v: put(v, np.inf),
    "unmasked": lambda v: np.ma.array(v),
    "objects of floats": lambda v: v.astype(object),
    "objects beyond 64 bits": lambda v: put(v.astype(object), 2**70),
    "decimals": lambda v: put(v.astype(object), Decimal("0.1")),
}
# What has none.
NEITHER: dict[str, Callable[[Floats], Any]] = {
    "complex64": lambda v: v.astype("c8"),
    "complex": lambda v: v + 1e-3j,
    "datetime64": lambda v: (1e9 * v).astype("M8[ns]"),
    "datetime64 of generic unit": lambda v: np.full(v.shape, "NaT", "M8"),
    "timedelta64": lambda v: (1e9 * v).astype("m8[ns]"),
    "NaT": lambda v: np.full(v.shape, "NaT", "m8[s]"),
    "text": lambda v: v.astype(str),
    "bytes": lambda v: v.astype("S"),
    "record": lambda v: v.astype([("x", float)]),
    "void": lambda v: v.view("V8"),
    "masked": lambda v: np.ma.array(v, mask=put(np.zeros(v.shape, bool), True)),
    "all masked": lambda v: np.ma.masked_all(v.shape),
    "objects of nothing": lambda v: put(v.astype(object), None),
    "objects of arrays": lambda v: put(v.astype(object), {}),
}
LAYOUTS: dict[str, Callable[[Any], Any]] = {
    "C": lambda v: v,
    "Fortran": np.asfortranarray,
    "read-only": frozen,
    "strided": lambda v: np.repeat(v, 2, axis=0)[::2] if v.ndim else v,
    "reversed": lambda v: v[::-1].copy()[::-1] if v.ndim else v,
    "column of a wider one": lambda v: np.stack([v, v], axis=-1)[..., 0],
    "unaligned": unaligned,
    "list": lambda v: v.tolist(),
    "list of arrays": list,
    "memory": memoryview,
}
SHAPES: dict[str, Callable[[Any], Any]] = {
    "as it is": lambda v: v,
    "0-d": lambda v: v.reshape(-1)[0],
    "0-d array": lambda v: v.reshape(-1)[:1].reshape(()),
    "empty": lambda v: v[:0],
    "none": lambda v: v.reshape(-1)[:0].reshape(*v.shape[:-1], 0),
    "one sample less": lambda v: v[:-1],
    "axis before": lambda v: v[None],
    "axis behind": lambda v: v[..., None],
    "transposed": lambda v: v.T,
    "flat": lambda v: v.reshape(-1),
}


LISTS = ("list", "list of arrays")
MASKED = ("unmasked", "masked", "all masked")
# Right as well, though refused: they are no array of numbers.
REFUSED = ("objects of floats", "objects beyond 64 bits", "decimals")
# Complex numbers are what poles are.
COMPLEX = ("PhyFilter poles", "from_poles poles", "place_poles poles")
# What else a refusal may name: the pole or the coefficient found, the one of several that disagree.
NAMED = {
    "PhyFilter a": ["a", "D"],
    **{door: ["poles?"] for door in COMPLEX},
    "Chebyshev bounds": ["bounds", "Xi", "z"],
    "simulate_batch k": ["k", "params"],
    "small_arm mount": ["mount", "home"],
    "check_targets targets": ["targets?"],
}


def numbers(thing: object, seen: set[int]) -> Iterator[Any]:
    """All numbers that an answer holds, its closures included."""
    if isinstance(thing, bool | int | float | complex | np.generic):
        yield thing
    elif isinstance(thing, np.ndarray):
        yield np.asarray(thing)
    elif id(thing) not in seen:
        seen.add(id(thing))
        parts: list[object] = []
        if isinstance(thing, dict):
            parts = list(thing.values())
        elif isinstance(thing, list | tuple):
            parts = list(thing)
        elif isinstance(thing, FunctionType):
            parts = [cell.cell_contents for cell in thing.__closure__ or ()]
        elif isinstance(thing, functools.partial):
            parts = [thing.func, thing.args, thing.keywords]
        elif isinstance(thing, PhyFilter):
            parts = [thing.a, thing.b]
        elif dataclasses.is_dataclass(thing):
            parts = [getattr(thing, field.name) for field in dataclasses.fields(thing)]
        elif hasattr(thing, "__dict__") and not isinstance(thing, type):
            parts = list(vars(thing).values())
        for part in parts:
            yield from numbers(part, seen)


def outcome(enter: Callable[..., object], values: object) -> list[Any] | TypeError | ValueError:
    """The numbers of the answer, or the refusal."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of numbers as large and small as there are
        try:
            return list(numbers(enter(values), set()))
        except (TypeError, ValueError) as error:
            return error


def same(one: list[Any], other: list[Any]) -> bool:
    return len(one) == len(other) and all(
        np.shape(a) == np.shape(b) and np.allclose(a, b, rtol=1e-7, atol=1e-12, equal_nan=True)
        for a, b in zip(one, other, strict=True)
    )


def check(door: str, kind: str, layout: str, shape: str) -> None:
    """One array through one door."""
    good, enter = ALL[door]
    values = SHAPES[shape]((NUMBERS | NEITHER)[kind](good))
    given = LAYOUTS[layout](values)
    # Lists have lost the shape of what is empty.
    plain = None if kind in NEITHER else np.array(given if layout in LISTS else values, dtype=float)
    before = pickle.dumps(np.asarray(given)) if isinstance(given, np.ndarray) else b""
    answer = outcome(enter, given)
    assert not before or pickle.dumps(np.asarray(given)) == before, "the input has been changed"
    if isinstance(answer, Exception):
        named = "|".join(NAMED.get(door, [re.escape(door.split()[-1])]))
        assert re.search(rf"\b({named})\b", str(answer)), str(answer)
    if plain is None:
        allowed = door in TIME_DOORS and kind in ("datetime64", "timedelta64")
        allowed |= door in COMPLEX and kind in ("complex64", "complex")
        assert allowed or isinstance(answer, Exception) or not np.size(given), answer
        return
    expected = outcome(enter, plain)
    if isinstance(answer, Exception):
        assert isinstance(expected, Exception) or kind in REFUSED or door in TIME_DOORS, answer
    else:
        assert not isinstance(expected, Exception), expected
        assert same(answer, expected)


def laid_out(kind: str, layout: str, shape: str) -> bool:
    """Whether there is such an array: numpy's functions of layout drop masks, and memory has no dates and objects."""
    if layout == "C":
        return True
    if kind in MASKED or layout in ("memory", "unaligned"):
        return kind in ("float64", "float32", "int32", "big-endian") and layout not in ("list of arrays",)
    if layout == "list" and kind in NEITHER and kind not in ("text", "complex", "objects of nothing"):
        return False  # its entries are numbers then
    return shape not in ("0-d", "0-d array")


CASES = [
    (kind, layout, shape)
    for kind in NUMBERS | NEITHER
    for layout in LAYOUTS
    for shape in SHAPES
    if laid_out(kind, layout, shape)
]


@given(door=st.sampled_from(sorted(ALL)), case=st.sampled_from(CASES))
@settings(max_examples=300)
def test_any_array_is_right_or_refused_by_name(door: str, case: tuple[str, str, str]) -> None:
    check(door, *case)


@pytest.mark.slow
@pytest.mark.parametrize("door", ALL)
def test_every_kind_layout_and_shape(door: str) -> None:
    for kind, layout, shape in CASES:
        if (kind != "float64") + (layout != "C") + (shape != "as it is") <= 1:
            check(door, kind, layout, shape)
