"""A python-control block written with numpy, traced into CasADi functions and probed against the original."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import control as ct
import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from ..blocks.functions import BlockFunctions, Variable

__all__ = ["trace"]

PROBES = 14
RELATIVE = 1e-8  # of an entry: the traced function may sum in another order
ABSOLUTE = 1e-12  # of the largest number around: what cancellation leaves

_WAY_OUT = (
    "Write the block with phyfilter_ctl.plant; or let it use numpy functions of t, x, u and params and return a list "
    "or np.array([...]): no math.*, no float(), no array filled in place (dx = np.zeros(n); dx[0] = ...), no branch "
    "on a signal or parameter (np.where, np.clip, np.maximum do that)"
)


class _FailedError(Exception):
    """One way of tracing did not work; the next may."""


def trace(system: ct.NonlinearIOSystem, path: str, given: Mapping[str, object]) -> BlockFunctions:
    """CasADi functions of a block whose update and output are Python functions of (t, x, u, params).

    Parameters
    ----------
    system : control.NonlinearIOSystem
    path : str
        Name of the block in messages.
    given : mapping
        Parameter values set by the diagrams around the block; they go over its own.

    Returns
    -------
    BlockFunctions
        Parameters: the block's numbers and arrays of numbers, entry by entry; all else stays what it is.

    Raises
    ------
    ValueError
        For a function that cannot be traced, or whose trace differs from the original at a probed point.

    Notes
    -----
    Two routes are tried, x and u as arrays of SX scalars (x @ x, unpacking) and as SX columns (np.clip, np.where),
    each function by its own. Integers are tried as parameters first; one that the functions need as a number (a loop
    count, not an exponent) stays a constant.

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
    reference = _Reference(system)
    points = _probe_points(system, values, set())
    originals = [reference.evaluate(point, path) for point in points]
    if reference.failure is not None and all(np.isnan(np.concatenate(pair)).all() for pair in originals):
        raise ValueError(
            f"block {path}: its functions fail wherever they are called: {reference.failure}"
        ) from reference.failure
    if not _same(originals[0], reference.evaluate(points[0], path)):
        raise ValueError(
            f"block {path}: two calls at one point gave different results, so it keeps something from call to call "
            "(a delay, a random number, a memory); make that a state, or a sampled block"
        )
    reasons: list[str] = []
    integers = [name for name, value in values.items() if _has_integers(value)]
    for constant in [set[str](), *({name} for name in integers), set(integers)]:
        if constant:
            points = _probe_points(system, values, constant)
            originals = [reference.evaluate(point, path) for point in points]
        try:
            return _attempt(system, values, constant, points, originals)
        except _FailedError as failure:
            reasons.append(str(failure))
    raise ValueError(f"block {path}: {reasons[0]}. {_WAY_OUT}")


def _attempt(
    system: ct.NonlinearIOSystem,
    values: Mapping[str, object],
    constant: set[str],
    points: Sequence[_Point],
    originals: Sequence[tuple[FloatArray, FloatArray]],
) -> BlockFunctions:
    n, m = int(system.nstates or 0), int(system.ninputs or 0)
    t, x, u = ca.SX.sym("t"), ca.SX.sym("x", n), ca.SX.sym("u", m)
    tunable = [name for name, value in values.items() if name not in constant and _is_tunable(value)]
    symbols = {name: ca.SX.sym(name, int(np.size(_numbers(values[name])))) for name in tunable}
    p = ca.vertcat(*symbols.values()) if symbols else ca.SX(0, 1)
    functions = []
    for which, function, size in (
        ("update", system.updfcn if n else None, n),
        ("output", system.outfcn, int(system.noutputs or 0)),
    ):
        position = 0 if which == "update" else 1
        failures = []
        for columns in (False, True):
            try:
                identity = function is None
                result = x[:size] if identity else _call(function, t, x, u, values, symbols, columns, size)
                traced = ca.Function(which, [t, x, u, p], [ca.densify(result)])
                _compare(traced, points, [original[position] for original in originals], tunable)
                functions.append(traced)
                break
            except _FailedError as failure:
                failures.append(str(failure))
        else:
            raise _FailedError(
                f"its {which} function cannot be traced ({'; '.join(dict.fromkeys(failures))})"
            )
    return _finished(system, values, symbols, (t, x, u), functions)


def _finished(
    system: ct.NonlinearIOSystem,
    values: Mapping[str, object],
    symbols: Mapping[str, ca.SX],
    signals: tuple[ca.SX, ca.SX, ca.SX],
    functions: Sequence[ca.Function],
) -> BlockFunctions:
    """Drops what the diagrams gave and this block does not read."""
    p = ca.vertcat(*symbols.values()) if symbols else ca.SX(0, 1)
    results = [function(*signals, p) for function in functions]
    read = {symbol.element_hash() for symbol in ca.symvar(ca.vertcat(*results))}
    kept = [
        name
        for name, symbol in symbols.items()
        if name in system.params or any(e.element_hash() in read for e in ca.vertsplit(symbol))
    ]
    p = ca.vertcat(*(symbols[name] for name in kept)) if kept else ca.SX(0, 1)
    variables: list[Variable] = []
    for name in kept:
        array = np.asarray(_numbers(values[name]), dtype=float)
        for index in np.ndindex(array.shape):
            label = f"{name}[{','.join(map(str, index))}]" if index else name
            variables.append(Variable(label, float(array[index])))
    return BlockFunctions(
        states=tuple(Variable(label) for label in system.state_labels),
        inputs=tuple(Variable(label) for label in system.input_labels),
        outputs=tuple(Variable(label) for label in _output_labels(system)),
        parameters=tuple(variables),
        dynamics=ca.Function("dynamics", [*signals, p], [results[0]]),
        output=ca.Function("output", [*signals, p], [results[1]]),
    )


def _output_labels(system: ct.NonlinearIOSystem) -> list[str]:
    labels = list(system.output_labels)
    return labels if len(labels) == system.noutputs else [f"y[{i}]" for i in range(system.noutputs or 0)]


def _call(
    function: Callable[..., object],
    t: ca.SX,
    x: ca.SX,
    u: ca.SX,
    values: Mapping[str, object],
    symbols: Mapping[str, ca.SX],
    columns: bool,
    size: int,
) -> ca.SX:
    params = {name: _symbolic(value, symbols.get(name), columns) for name, value in values.items()}
    arguments = (t, ca.SX(x), ca.SX(u)) if columns else (t, _elements(x), _elements(u))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # CasADi's note on numpy functions; the probe is what counts
            entries = list(_flattened(function(*arguments, params)))
            result = ca.SX(ca.vertcat(*entries)) if entries else ca.SX(0, 1)
    except Exception as error:
        text = str(error).strip().splitlines()
        raise _FailedError(text[-1].strip().rstrip(".") if text else type(error).__name__) from error
    if result.shape[0] != size:
        raise _FailedError(f"expected {size} entries, got {result.shape[0]}")
    return result


def _symbolic(value: object, symbol: ca.SX | None, columns: bool) -> object:
    if symbol is None:
        return value
    if isinstance(value, list | tuple):
        return type(value)(ca.vertsplit(symbol))
    shape: tuple[int, ...] = _numbers(value).shape
    if not shape:
        return symbol
    if columns and len(shape) <= 2:
        return ca.SX(symbol) if len(shape) == 1 else ca.reshape(symbol, *shape[::-1]).T
    return _elements(symbol).reshape(shape)


def _elements(column: ca.SX) -> NDArray[np.object_]:
    array = np.empty(column.shape[0], dtype=object)
    for i in range(column.shape[0]):
        array[i] = column[i]
    return array


def _flattened(value: object) -> Iterable[ca.SX | ca.DM | float]:
    if isinstance(value, ca.SX | ca.DM):
        yield from (value[i, j] for i in range(value.shape[0]) for j in range(value.shape[1]))
    elif isinstance(value, list | tuple):
        for entry in value:
            yield from _flattened(entry)
    elif isinstance(value, np.ndarray):
        for entry in value.reshape(-1):
            yield from _flattened(entry)
    else:
        yield float(np.asarray(value, dtype=float))


@dataclass(frozen=True)
class _Point:
    t: float
    x: FloatArray
    u: FloatArray
    values: Mapping[str, object]


def _probe_points(
    system: ct.NonlinearIOSystem, values: Mapping[str, object], constant: set[str]
) -> list[_Point]:
    """Small and large, positive and of both signs, the last ones with other parameter values."""
    rng = np.random.default_rng(20240)
    n, m = system.nstates or 0, system.ninputs or 0
    points = []
    for i in range(PROBES):
        scale = (1.0, 0.05, 1.0, 30.0, 3.0)[i % 5]
        draw = (lambda k: rng.uniform(0.1, 1.0, k)) if i % 3 == 1 else (lambda k: rng.normal(size=k))
        changed = (
            values
            if i < PROBES - 5
            else {k: v if k in constant else _moved(v, rng) for k, v in values.items()}
        )
        points.append(_Point(float(rng.uniform(0.0, 3.0)), scale * draw(n), scale * draw(m), changed))
    return points


def _moved(value: object, rng: np.random.Generator) -> object:
    """Another value of a parameter; integers stay integers."""
    if not _is_tunable(value):
        return value
    if isinstance(value, list | tuple):
        return type(value)(_moved(entry, rng) for entry in value)
    if _has_integers(value):
        return value + 1 if isinstance(value, np.ndarray) else int(_numbers(value)) + 1
    array = _numbers(value)
    moved = array * rng.uniform(0.8, 1.2, array.shape) + 0.01 * rng.uniform(0.0, 1.0, array.shape)
    return float(moved) if moved.ndim == 0 else moved


def _has_integers(value: object) -> bool:
    if isinstance(value, list | tuple):
        return any(_has_integers(entry) for entry in value)
    if isinstance(value, np.ndarray):
        return value.dtype.kind in "iu"
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def _is_tunable(value: object) -> bool:
    if isinstance(value, bool | np.bool_):
        return False
    if isinstance(value, list | tuple):
        return len(value) > 0 and all(np.ndim(e) == 0 and _is_tunable(e) for e in value)
    if isinstance(value, np.ndarray):
        return value.dtype.kind in "iuf" and value.size > 0
    return isinstance(value, int | float | np.integer | np.floating)


def _numbers(value: object) -> FloatArray:
    return np.asarray(value, dtype=float)


class _Reference:
    """The original, evaluated by python-control itself."""

    def __init__(self, system: ct.NonlinearIOSystem) -> None:
        self._system = system
        self.failure: Exception | None = None

    def evaluate(self, point: _Point, path: str) -> tuple[FloatArray, FloatArray]:
        """(update, output); not-a-number where a function refuses the point."""
        system = self._system
        sizes = (system.nstates or 0, system.noutputs or 0)
        before = system._current_params
        results: list[FloatArray] = []
        try:
            for evaluate, size in zip((system.dynamics, system.output), sizes, strict=True):
                # dict(...): a function may write into what it is given
                arguments = (point.t, point.x.copy(), point.u.copy(), dict(point.values))
                with warnings.catch_warnings(), np.errstate(all="ignore"):
                    warnings.simplefilter("ignore")
                    try:
                        result = (
                            np.asarray(evaluate(*arguments), dtype=float).reshape(-1) if size else np.zeros(0)
                        )
                    except Exception as error:
                        self.failure = error
                        result = np.full(size, np.nan)
                if len(result) != size:
                    which = "update" if evaluate == system.dynamics else "output"
                    raise ValueError(
                        f"block {path}: its {which} function gives {len(result)} entries, expected {size}"
                    )
                results.append(result)
        finally:
            system._current_params = before
        return results[0], results[1]


def _compare(
    traced: ca.Function, points: Sequence[_Point], originals: Sequence[FloatArray], tunable: Sequence[str]
) -> None:
    checked = np.zeros(traced.size1_out(0), dtype=bool)
    for point, original in zip(points, originals, strict=True):
        parts = [_numbers(point.values[name]).reshape(-1) for name in tunable]
        p = np.concatenate(parts) if parts else np.zeros(0)
        value = np.asarray(traced(point.t, point.x, point.u, p), dtype=float).reshape(-1)
        known = np.isfinite(original)
        largest = max(
            [1.0, *(float(np.max(np.abs(a))) for a in (original[known], point.x, point.u) if a.size)]
        )
        error = np.abs(value[known] - original[known])
        if not np.all(error <= RELATIVE * np.abs(original[known]) + ABSOLUTE * largest):
            raise _FailedError(
                f"traced with symbols it gives {value.tolist()}, the original {original.tolist()} at x={point.x}, "
                f"u={point.u}"
            )
        checked |= known
    if not np.all(checked):
        raise _FailedError(f"entries {np.flatnonzero(~checked).tolist()} are not finite at any probed point")


def _same(first: Sequence[FloatArray], second: Sequence[FloatArray]) -> bool:
    return all(np.array_equal(a, b, equal_nan=True) for a, b in zip(first, second, strict=True))
