"""Parameters by name, and a flat model as a table."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _signals
from ..blocks.functions import Variable
from .equations import Equations
from .probing import is_tunable

__all__ = ["override", "table", "without_constants"]


def override(variables: Sequence[Variable], values: Mapping[str, ArrayLike]) -> NDArray[np.float64]:
    """Starts of variables with some replaced by name.

    Parameters
    ----------
    variables : sequence of Variable
    values : mapping
        By full name, by what stands after the block where that is unambiguous, or by either without the index.

    Returns
    -------
    (variables,) array

    Raises
    ------
    ValueError
        For names that are unknown or ambiguous, and values of the wrong shape.

    Examples
    --------
    >>> override([Variable("a.k", 1.0), Variable("b.v[0]", 2.0), Variable("b.v[1]", 3.0)], {"v": [5.0, 6.0]})
    array([1., 5., 6.])
    """
    vector = np.array([variable.start for variable in variables], dtype=float)
    for name, value in values.items():
        places = _places([variable.name for variable in variables], name)
        array = _signals.real(f"parameter {name}", value)
        if array.size not in (1, len(places)):
            raise ValueError(f"parameter {name}: expected {len(places)} numbers, got shape {array.shape}")
        vector[places] = array.reshape(-1)
    return vector


def without_constants(
    constants: Sequence[tuple[str, object]], values: Mapping[str, ArrayLike]
) -> dict[str, ArrayLike]:
    """Values without those that are no numbers and that a model was made with.

    Parameters
    ----------
    constants : sequence of (str, object)
    values : mapping
        By full name or by what stands after the block.

    Returns
    -------
    dict

    Raises
    ------
    ValueError
        For another value than that of the model.

    Examples
    --------
    >>> without_constants([("estimator.correct", False)], {"correct": False, "k": 2.0})
    {'k': 2.0}
    """
    rest = dict(values)
    for name, value in values.items():
        if is_tunable(value):
            continue
        for fixed in (fixed for known, fixed in constants if name in (known, _last(known))):
            if not np.array_equal(np.asarray(fixed, dtype=object), np.asarray(value, dtype=object)):
                raise ValueError(
                    f"parameter {name}: the model was made with {fixed!r}, which is no number and cannot change in a "
                    f"run, got {value!r}; give it to flatten(..., params=), or give the diagram itself to simulate"
                )
            rest.pop(name, None)
    return rest


def _places(names: Sequence[str], wanted: str) -> list[int]:
    """All entries of one parameter."""
    for key in (lambda n: n, _without_index, _last, lambda n: _without_index(_last(n))):
        found = [i for i, name in enumerate(names) if key(name) == wanted]
        owners = {_without_index(names[i]) for i in found}
        if len(owners) > 1:
            raise ValueError(
                f"parameter {wanted} belongs to several blocks: write {' or '.join(sorted(owners))}"
            )
        if found:
            return found
    close = difflib.get_close_matches(wanted, [*names, *map(_last, names)], n=3, cutoff=0.5)
    known = f"close to it: {', '.join(close)}" if close else f"known: {', '.join(names) or 'none'}"
    raise ValueError(f"no parameter is called {wanted}; {known}")


def _without_index(name: str) -> str:
    return re.sub(r"\[[^\]]*\]$", "", name)


def _last(name: str) -> str:
    return name.rsplit(".", 1)[-1]


def table(flat: Equations) -> str:
    """States, signals, parameters and sampled blocks of a model, as text.

    Parameters
    ----------
    flat : Equations

    Returns
    -------
    str
    """
    kind = f"discrete, {flat.dt:g} s" if flat.dt else "continuous"
    lines = [f"{flat.name} ({kind}): blocks {', '.join(flat.order) or 'none'}"]
    groups = (
        ("inputs", flat.inputs),
        ("outputs", flat.outputs),
        ("states", flat.states),
        ("parameters", flat.parameters),
        ("held outputs", flat.held),
    )
    width = max((len(v.name) for _, variables in groups for v in variables), default=0)
    for title, variables in groups:
        if not variables:
            continue
        lines.append(title)
        for v in variables:
            start = "" if title in ("outputs", "held outputs") else f"{v.start:.6g}"
            lines.append(f"  {v.name:<{width}}  {start:>12}  {v.unit:<8} {v.description}".rstrip())
    if flat.tasks:
        lines.append("sampled blocks, in the order in which they run")
        lines += [f"  {task.name:<{width}}  {task.period:>12.6g}  s" for task in flat.tasks]
    return "\n".join(lines)
