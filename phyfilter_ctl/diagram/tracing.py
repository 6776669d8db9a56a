"""A python-control block written with numpy, traced into CasADi functions and probed against the original."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy

import casadi as ca
import control as ct
import numpy as np

from ..blocks.functions import BlockFunctions, Variable
from ..blocks.interpreted import Interpreted
from .branches import DefaultsError, UntraceableError, Way, merged, place_of, ways
from .probing import (
    MismatchError,
    Point,
    Reference,
    compare,
    filled,
    has_integers,
    is_tunable,
    numbers,
    probe_points,
    uncovered,
)
from .scalars import Array, Traced, as_array
from .shim import USES_CASADI, rebound

__all__ = ["trace"]

# An original that takes longer (an optimisation inside) is called as seldom as possible.
_SLOW = 0.02
# Of one point, so that a counter shows that acts at every so manieth call only.
_CALLS = 12
# Part by which an optimisation inside may differ when it starts from its last solution.
_WARM = 1e-4


@dataclasses.dataclass(frozen=True, eq=False)
class _Part:
    """The update or the output function of a block."""

    which: str
    function: Callable[..., object]
    size: int
    copy: Callable[..., object]
    uses_casadi: bool
    original: Reference


@dataclasses.dataclass(frozen=True, eq=False)
class _Symbols:
    """What the functions are traced with."""

    t: ca.SX
    x: ca.SX
    u: ca.SX
    parameters: Mapping[str, ca.SX]
    values: Mapping[str, object]

    @property
    def all(self) -> list[ca.SX]:
        p = ca.vertcat(*self.parameters.values()) if self.parameters else ca.SX(0, 1)
        return [self.t, self.x, self.u, p]


class _NewParametersError(UntraceableError):
    """The function reads parameters that have a default in its text."""

    def __init__(self, noted: Mapping[str, object]) -> None:
        super().__init__()
        self.noted = noted


def trace(
    system: ct.NonlinearIOSystem,
    path: str,
    given: Mapping[str, object],
    missing: Mapping[str, object] | None = None,
) -> BlockFunctions:
    """CasADi functions of a block whose update and output are Python functions of (t, x, u, params).

    Parameters
    ----------
    system : control.NonlinearIOSystem
    path : str
        Name of the block in messages.
    given : mapping
        Parameter values set by the diagrams around the block; they go over its own.
    missing : mapping, optional
        Values of parameters that the functions read and that neither the block nor a diagram has, or that are no
        numbers.

    Returns
    -------
    BlockFunctions
        Parameters: the block's numbers and arrays of numbers, entry by entry, and those that the functions read as
        ``params.get(name, number)``; all else stays what it is. A function that cannot be traced runs as Python:
        ``callbacks`` has it, with the reason.

    Raises
    ------
    ValueError
        For functions that fail wherever they are called, keep something from call to call, or read one parameter with
        different defaults.

    Notes
    -----
    The functions are run on numbers and arrays that carry expressions; ``np``, ``math``, ``float``, ``int``, ``max``,
    ... in them, and in the functions that they call, stand for functions of such numbers (:mod:`shim`). At an ``if``
    both sides are traced; an index that is a signal picks from each entry of its table. The trace is compared with
    the original at random points, of which at least one lies on each side of each condition. Functions that are
    written with CasADi's own functions are traced on SX columns.

    Integers are tried as parameters first; one that the functions need as a number (a loop count, not an exponent)
    stays a constant.

    Examples
    --------
    >>> pendulum = ct.nlsys(lambda t, x, u, params: [x[1], -params["k"] * np.sin(x[0]) + u[0]], None,
    ...                     inputs=1, states=["angle", "rate"], params={"k": 9.8}, name="pendulum")
    >>> functions = trace(pendulum, "pendulum", {})
    >>> [p.name for p in functions.parameters], functions.dynamics(0, [0, 2], [3], [9.8]).full().ravel().tolist()
    (['k'], [2.0, 3.0])
    """
    if system.ninputs is None or system.noutputs is None or system.nstates is None:
        raise ValueError(
            f"block {path}: the numbers of inputs, outputs and states are not set; give inputs=, outputs= and states= "
            "where it is made"
        )
    values = {**system.params, **given}
    known = set(system.params)
    missing, defaults = missing or {}, dict[str, object]()
    values |= {  # what is no number cannot be changed later
        name: missing[name]
        for name, value in system.params.items()
        if name in missing and not is_tunable(value)
    }
    parts = _parts(system, path, missing, defaults)
    try:
        points = probe_points(system, values, set())
        for part in parts:  # first, since a run on symbols would be kept too
            _check_memory(part, points)
        while True:
            try:
                return _attempt(system, path, parts, values, known, points)
            except _NewParametersError as more:
                values |= more.noted
                points = probe_points(system, values, set())
                known |= set(more.noted)
                defaults |= {name: value for name, value in more.noted.items() if name not in missing}
    except DefaultsError as error:
        raise DefaultsError(f"block {path}: {error}") from None


def _parts(
    system: ct.NonlinearIOSystem, path: str, missing: Mapping[str, object], defaults: Mapping[str, object]
) -> list[_Part]:
    """The functions that there are; no output function puts out the states."""
    found = []
    for which, function, size in (
        ("update", system.updfcn if system.nstates else None, int(system.nstates or 0)),
        ("output", system.outfcn, int(system.noutputs or 0)),
    ):
        if function is not None and size:
            reference = Reference(function, size, f"block {path}: its {which}", missing, defaults)
            seen: dict[int, object] = {}
            twin = rebound(function, seen)
            found.append(_Part(which, function, size, twin, USES_CASADI in seen, reference))
    return found


def _attempt(
    system: ct.NonlinearIOSystem,
    path: str,
    parts: Sequence[_Part],
    values: Mapping[str, object],
    known: set[str],
    plain: Sequence[Point],
) -> BlockFunctions:
    """Every function with as few integers as constants as it needs, else as a callback."""
    integers = [name for name, value in values.items() if has_integers(value)]
    choices = [set[str](), *({name} for name in integers), *([set(integers)] if len(integers) > 1 else [])]
    tried = []
    for constant in choices:
        points = probe_points(system, values, constant) if constant else plain
        symbols = _symbols(system, values, constant)
        functions, failures = dict[str, ca.Function](), dict[str, str]()
        for part in parts:
            try:
                functions[part.which] = _traced(part, symbols, points)
            except _NewParametersError:
                raise
            except (UntraceableError, MismatchError) as failure:
                failures[part.which] = str(failure)
                if constant:
                    break
        if not failures:
            return _finished(system, known, symbols, functions, {})
        tried.append((points, symbols, functions, failures))
    # With no constants, and a callback for what cannot be traced, alone.
    points, symbols, functions, failures = tried[0]
    callbacks = {
        part.which: _callback(part, symbols, points, path, failures[part.which])
        for part in parts
        if part.which in failures
    }
    return _finished(system, known, symbols, {**functions, **callbacks}, callbacks)


def _symbols(system: ct.NonlinearIOSystem, values: Mapping[str, object], constant: set[str]) -> _Symbols:
    tunable = [name for name, value in values.items() if name not in constant and is_tunable(value)]
    parameters = {name: ca.SX.sym(name, numbers(values[name]).size) for name in tunable}
    t, x, u = (
        ca.SX.sym("t"),
        ca.SX.sym("x", int(system.nstates or 0)),
        ca.SX.sym("u", int(system.ninputs or 0)),
    )
    return _Symbols(t, x, u, parameters, values)


def _traced(part: _Part, symbols: _Symbols, points: Sequence[Point]) -> ca.Function:
    """One function, on traced numbers or else, where it is written with CasADi's functions, on columns."""
    failures = []
    tunable = list(symbols.parameters)
    for columns in (False, True) if part.uses_casadi else (False,):
        try:
            found = _ways(part, symbols, columns)
            more, open_ = uncovered(found, symbols.all, points, symbols.values, tunable)
            if open_:
                raise UntraceableError(f"no point was found on both sides of the condition {open_[0]}")
            result = ca.densify(merged(found, part.size))
            traced = ca.Function(part.which, symbols.all, [result])
            probed = [*points, *more]
            compare(traced, probed, part.original.evaluate_all(probed), tunable)
            return traced
        except _NewParametersError:
            raise
        except (UntraceableError, MismatchError) as failure:
            failures.append(str(failure))
    raise UntraceableError(failures[0])


def _ways(part: _Part, symbols: _Symbols, columns: bool) -> list[Way]:
    given = {
        name: _symbolic(value, symbols.parameters.get(name), columns)
        for name, value in symbols.values.items()
    }
    if columns:
        function, t, vectors = part.function, symbols.t, [ca.SX(symbols.x), ca.SX(symbols.u)]
    else:
        function, t, vectors = part.copy, Traced(symbols.t), [_elements(symbols.x), _elements(symbols.u)]

    def body() -> ca.SX:
        # Copies for each way: a function may write into what it is given.
        params = part.original.params({name: copy(value) for name, value in given.items()})
        try:
            entries = list(_flattened(function(t, *map(copy, vectors), params)))
        except DefaultsError:
            params.noted.clear()
            raise
        finally:
            if params.noted:
                raise _NewParametersError(params.noted)
        result = ca.SX(ca.vertcat(*entries)) if entries else ca.SX(0, 1)
        if result.shape[0] != part.size:
            raise UntraceableError(f"expected {part.size} entries, got {result.shape[0]}")
        return result

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # CasADi's note on numpy functions; the probe is what counts
        try:
            found = ways(body, ca.vertcat(*symbols.all[:3]))
        except _NewParametersError:
            raise
        except (UntraceableError, RecursionError) as error:
            raise UntraceableError(_said(error)) from error
    if all(way.value is None for way in found):
        error = found[0].error
        raise UntraceableError(_said(error) if error is not None else "it gives nothing")
    own = {symbol.element_hash() for symbol in ca.symvar(ca.vertcat(*symbols.all))}
    asked = [decision.condition for way in found for decision in way.decisions]
    results = [way.value for way in found if way.value is not None]
    if any(symbol.element_hash() not in own for symbol in ca.symvar(ca.vertcat(*asked, *results))):
        raise UntraceableError("it keeps a signal from an earlier call")
    return found


def _said(error: Exception) -> str:
    """What went wrong and where."""
    text = str(error).strip().splitlines()
    what = text[-1].strip().rstrip(".") if text else type(error).__name__
    place = place_of(error)
    return f"{place}: {what}" if place else what


def _check_memory(part: _Part, points: Sequence[Point]) -> None:
    here, *others = points
    evaluate = part.original.evaluate
    first = evaluate(here)
    calls = _CALLS if part.original.seconds < _SLOW else 1
    again = part.original.evaluate_all([here] * calls)
    same = all(np.array_equal(first, value, equal_nan=True) for value in again)
    part.original.evaluate_all(others[:calls])
    near = _WARM * np.abs(first[np.isfinite(first)]).max(initial=0.0)
    if not same or not np.allclose(first, evaluate(here), rtol=0.0, atol=near, equal_nan=True):
        raise ValueError(
            f"{part.original.what} function gave different results in calls at one point, so it keeps something "
            "from call to call (a delay, a random number, a memory); make that a state, or a sampled block"
        )


def _callback(part: _Part, symbols: _Symbols, points: Sequence[Point], path: str, reason: str) -> Interpreted:
    """One function as Python."""
    original = part.original
    finite = next((p for p in points if np.isfinite(original.evaluate(p)).any()), None)
    if finite is None:
        what = (
            "is not finite at any probed point"
            if original.failure is None
            else f"fails wherever it is called: {original.failure}"
        )
        if isinstance(original.failure, KeyError):
            what += (
                "; a parameter without a value gets one by params= where the block is made, or of the call"
            )
        raise ValueError(f"{original.what} function {what}") from original.failure
    quick = original.seconds < _SLOW
    depends = original.depends(points[:6]) if part.which == "output" and quick else None
    tunable, values = list(symbols.parameters), symbols.values
    fills = (np.nan,)
    if depends is not None:
        blind = dataclasses.replace(finite, u=np.where(depends.any(axis=0), finite.u, np.nan))
        if not np.array_equal(original.evaluate(blind), original.evaluate(finite), equal_nan=True):
            fills = (0.0, 1.7)  # it looks at inputs that change nothing
    sizes = (*(symbol.shape[0] for symbol in symbols.all[1:]), part.size)
    return Interpreted(
        part.which,
        lambda t, x, u, p: original.call(t, x, u, filled(values, tunable, p)),
        sizes,
        path,
        f"its {part.which} function cannot be traced ({reason})",
        depends,
        fills,
    )


def _finished(
    system: ct.NonlinearIOSystem,
    known: set[str],
    symbols: _Symbols,
    functions: Mapping[str, ca.Function],
    callbacks: Mapping[str, Interpreted],
) -> BlockFunctions:
    """Drops what the diagrams gave and this block does not read."""
    t, x, u, p = symbols.all
    results = [
        functions["update"](t, x, u, p) if system.nstates else ca.SX(0, 1),
        functions["output"](t, x, u, p)
        if "output" in functions
        else x[: system.noutputs]
        if system.noutputs
        else ca.SX(0, 1),
    ]
    read = {symbol.element_hash() for symbol in ca.symvar(ca.vertcat(*results))}
    kept = [
        name
        for name, symbol in symbols.parameters.items()
        if name in known or callbacks or any(e.element_hash() in read for e in ca.vertsplit(symbol))
    ]
    p = ca.vertcat(*(symbols.parameters[name] for name in kept)) if kept else ca.SX(0, 1)
    variables: list[Variable] = []
    for name in kept:
        array = np.asarray(numbers(symbols.values[name]), dtype=float)
        for index in np.ndindex(array.shape):
            label = f"{name}[{','.join(map(str, index))}]" if index else name
            variables.append(Variable(label, float(array[index])))
    return BlockFunctions(
        states=tuple(Variable(label) for label in system.state_labels),
        inputs=tuple(Variable(label) for label in system.input_labels),
        outputs=tuple(Variable(label) for label in _output_labels(system)),
        parameters=tuple(variables),
        dynamics=ca.Function("dynamics", [t, x, u, p], [results[0]]),
        output=ca.Function("output", [t, x, u, p], [results[1]]),
        callbacks=tuple(callbacks.values()),
        constants=tuple(
            (name, v) for name, v in symbols.values.items() if name in known and not is_tunable(v)
        ),
    )


def _output_labels(system: ct.NonlinearIOSystem) -> list[str]:
    labels = list(system.output_labels)
    return labels if len(labels) == system.noutputs else [f"y[{i}]" for i in range(system.noutputs or 0)]


def _symbolic(value: object, symbol: ca.SX | None, columns: bool) -> object:
    if symbol is None:
        return (
            as_array(value)
            if isinstance(value, np.ndarray) and value.dtype.kind == "f" and not columns
            else value
        )
    if isinstance(value, list | tuple):
        parts = ca.vertsplit(symbol)
        return type(value)(parts if columns else [Traced(part) for part in parts])
    shape: tuple[int, ...] = numbers(value).shape
    if not shape:
        return symbol if columns else Traced(symbol)
    if columns and len(shape) <= 2:
        return ca.SX(symbol) if len(shape) == 1 else ca.reshape(symbol, *shape[::-1]).T
    return _elements(symbol).reshape(shape)


def _elements(column: ca.SX) -> Array:
    array = np.empty(column.shape[0], dtype=object)
    array[:] = [Traced(entry) for entry in ca.vertsplit(column)] if len(array) else []
    return array.view(Array)


def _flattened(value: object) -> Iterable[ca.SX | ca.DM | float]:
    if isinstance(value, Traced):
        yield value.expression
    elif isinstance(value, ca.SX | ca.DM):
        yield from (value[i, j] for i in range(value.shape[0]) for j in range(value.shape[1]))
    elif isinstance(value, list | tuple):
        for entry in value:
            yield from _flattened(entry)
    elif isinstance(value, np.ndarray):
        for entry in value.reshape(-1):
            yield from _flattened(entry)
    else:
        yield float(np.asarray(value, dtype=float))
