"""Named variables of a plant: how they are declared, and how the equations see them."""

from __future__ import annotations

import keyword
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _signals
from ..blocks.function_block import unknown_name
from ..blocks.functions import Variable
from .algebra import Array

__all__ = ["Columns", "Declaration", "Group", "declared", "labelled"]

Bounds: TypeAlias = tuple[float, float] | tuple[float, float, float]
Declaration: TypeAlias = (
    ArrayLike | tuple[ArrayLike, str] | tuple[ArrayLike, str, str] | tuple[ArrayLike, str, str, Bounds]
)
"""Start value or default; with its unit; with its unit and a description; with (minimum, maximum) too, or (minimum,
maximum, nominal), which exports hand on. An array declares a vector or a matrix."""
_EXPECTED = (
    "start, (start, unit), (start, unit, description) or (start, unit, description, (minimum, maximum)), with a "
    "nominal value after the maximum where one is known"
)


_NO_BOUNDS = (-np.inf, np.inf)


@dataclass(frozen=True)
class Group:
    """Scalars that belong together under one name.

    Parameters
    ----------
    name : str
    shape : tuple of int
        () for a number, (n,) for a vector, (n, m) for a matrix.
    variables : tuple of Variable
        Row by row.
    """

    name: str
    shape: tuple[int, ...]
    variables: tuple[Variable, ...]

    def shaped(self, entries: ca.SX) -> ca.SX:
        """A column of the scalars as number, column or matrix."""
        return ca.reshape(entries, self.shape[1], self.shape[0]).T if len(self.shape) == 2 else entries


class Columns:
    """What the equations of a plant read: ``x.v`` is the state v, as a CasADi number, column or matrix.

    Parameters
    ----------
    kind : str
        "state", "input" or "parameter", for messages.
    values : mapping of str to array
    """

    def __init__(self, kind: str, values: Mapping[str, Array]) -> None:
        self._kind = kind
        self._values = dict(values)

    def __getattr__(self, name: str) -> Array:
        values: dict[str, Array] = self.__dict__.get("_values", {})
        if name not in values:
            raise AttributeError(unknown_name(self.__dict__.get("_kind", "name"), name, list(values)))
        return values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)


def declared(kind: str, declarations: Mapping[str, Declaration] | None) -> list[Group]:
    """Groups of a declaration.

    Parameters
    ----------
    kind : str
        "states", "inputs" or "params", for messages.
    declarations : mapping of str to Declaration, optional

    Raises
    ------
    ValueError
        For a name that is no identifier, a start that is not finite, has more than two dimensions or lies outside its
        bounds, and bounds that are none.
    TypeError
        For something that is no mapping, a start that is no number, or a unit that is no text.
    """
    if declarations is None:
        return []
    if not isinstance(declarations, Mapping):
        raise TypeError(f"{kind}: expected a dict of name -> {_EXPECTED}, got {type(declarations).__name__}")
    groups = []
    for name, entry in declarations.items():
        check_name(kind, name)
        worded = isinstance(entry, tuple) and len(entry) > 1 and isinstance(entry[1], str)
        start, *rest = [*entry] if isinstance(entry, tuple) and worded else [entry]
        texts = [text for text in rest[:2] if isinstance(text, str)]
        paired = len(rest) < 3 or isinstance(rest[2], tuple | list)
        if len(rest) > 3 or len(texts) < len(rest[:2]) or not paired:
            raise TypeError(f"{kind}: {name}: expected {_EXPECTED}, got {entry!r}")
        try:
            values = _signals.real(f"{kind}: {name}", start)
        except (TypeError, ValueError) as error:
            raise TypeError(
                f"{kind}: {name}: expected a number or an array to start from, with the unit after it as in "
                f"(0.0, 'm'); got {entry!r}"
            ) from error
        if values.ndim > 2 or values.size == 0 or not np.isfinite(values).all():
            raise ValueError(
                f"{kind}: {name}: expected finite values in at most two dimensions, got {start!r}"
            )
        bounds = _bounds(f"{kind}: {name}", rest[2], values) if len(rest) > 2 else _NO_BOUNDS
        groups.append(labelled(name, values, *texts, bounds=bounds))
    return groups


def _bounds(what: str, pair: object, values: NDArray[np.float64]) -> tuple[float, float, float]:
    """The pair as numbers, all values between them, and the nominal value, 0 where there is none."""
    ends = np.array([np.nan])
    with suppress(TypeError, ValueError):
        ends = np.asarray(pair, dtype=float)
    if ends.shape not in ((2,), (3,)) or not ends[0] < ends[1]:
        raise ValueError(
            f"{what}: expected bounds (minimum, maximum) or (minimum, maximum, nominal), minimum < maximum, got "
            f"{pair!r}"
        )
    nominal = float(ends[2]) if len(ends) > 2 else 0.0
    if len(ends) > 2 and not 0.0 < nominal < np.inf:
        raise ValueError(
            f"{what}: expected a nominal value above 0, the usual size of the signal, got {nominal!r}"
        )
    if not ((ends[0] <= values) & (values <= ends[1])).all():
        raise ValueError(f"{what}: starts at {values.tolist()}, outside its bounds {pair!r}")
    return float(ends[0]), float(ends[1]), nominal


def check_name(kind: str, name: object) -> None:
    """Refuse what the equations could not write as an attribute."""
    if (
        not isinstance(name, str)
        or not name.isidentifier()
        or keyword.iskeyword(name)
        or name.startswith("_")
    ):
        raise ValueError(
            f"{kind}: {name!r} cannot be written in the equations: expected a Python identifier such as 'v' or "
            "'drag_x', without a leading underscore"
        )


def labelled(
    name: str,
    values: ArrayLike,
    unit: str = "",
    description: str = "",
    *,
    bounds: Bounds = _NO_BOUNDS,
) -> Group:
    """A group with the labels name, name[i] or name[i,j].

    Parameters
    ----------
    name : str
    values : number, (n,) or (n, m) array
        Starts.
    unit, description : str
    bounds : (float, float) or (float, float, float)
        Minimum and maximum of every entry, and its nominal value.
    """
    array = np.asarray(values, dtype=float)
    minimum, maximum, *nominal = bounds
    variables = [
        Variable(
            name + (f"[{','.join(map(str, index))}]" if index else ""),
            float(value),
            unit,
            description,
            minimum,
            maximum,
            nominal[0] if nominal else 0.0,
        )
        for index, value in np.ndenumerate(array)
    ]
    return Group(name, array.shape, tuple(variables))


def flat(groups: Sequence[Group]) -> tuple[Variable, ...]:
    """All scalars, in order."""
    return tuple(variable for group in groups for variable in group.variables)
