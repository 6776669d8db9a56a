"""Blocks that are copies of each other, so that their functions are traced once."""

from __future__ import annotations

from collections.abc import Mapping
from types import CellType, FunctionType

import control as ct

__all__ = ["copy_key"]

_PLAIN = (int, float, complex, str, bytes, bool, type(None))


def copy_key(system: object, given: Mapping[str, object]) -> tuple[object, ...] | None:
    """Equal for two blocks of one diagram whose functions are the same code on the same values; None where unknown.

    Parameters
    ----------
    system : object
        A block.
    given : mapping
        Parameter values from outside.

    Returns
    -------
    tuple or None

    Notes
    -----
    What is no number or text counts as the same only where it is the same object.

    Examples
    --------
    >>> def lag(rate):
    ...     return ct.nlsys(lambda t, x, u, params: rate * (u - x), None, inputs=1, outputs=1, states=1)
    >>> copy_key(lag(2.0), {}) == copy_key(lag(2.0), {}), copy_key(lag(2.0), {}) == copy_key(lag(3.0), {})
    (True, False)
    """
    if type(system) is not ct.NonlinearIOSystem:
        return None
    functions = [_function(function) for function in (system.updfcn, system.outfcn)]
    if any(function is None for function in functions):
        return None
    values = {**system.params, **given}
    labels = (system.state_labels, system.input_labels, system.output_labels)
    return (
        *functions,
        system.dt,
        *(tuple(part) for part in labels),
        tuple(sorted(system.params)),
        tuple((name, _content(values[name])) for name in sorted(values)),
    )


def _function(function: object) -> tuple[object, ...] | None:
    if function is None:
        return ()
    if type(function) is not FunctionType or function.__dict__:
        return None
    cells = tuple(_cell(cell) for cell in function.__closure__ or ())
    defaults = tuple(_content(value) for value in function.__defaults__ or ())
    named = tuple((name, _content(value)) for name, value in (function.__kwdefaults__ or {}).items())
    return id(function.__code__), id(function.__globals__), cells, defaults, named


def _cell(cell: CellType) -> object:
    try:
        return _content(cell.cell_contents)
    except ValueError:  # a name that has no value yet
        return ("empty", id(cell))


def _content(value: object) -> tuple[object, ...]:
    return (type(value), repr(value)) if type(value) in _PLAIN else (id(value),)
