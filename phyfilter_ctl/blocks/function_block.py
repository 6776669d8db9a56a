"""A block from its CasADi functions: a python-control system that runs, linearises exactly and can be flattened."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from copy import deepcopy
from functools import cached_property
from typing import Any

import casadi as ca
import control as ct
import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from .functions import BlockFunctions, Variable

__all__ = ["FunctionBlock", "function_block"]

_ENTRY = re.compile(r"(.+)\[\d+(?:,\d+)*\]")


class Evaluator:
    """A CasADi function (t, x, u, p) of vectors on numpy arrays, through its buffers: about 2 us a call.

    Not for several threads at once: the buffers are its own.
    """

    def __init__(self, function: ca.Function) -> None:
        symbols = symbols_like(function)
        self._function = ca.Function("dense", symbols, [ca.densify(function(*symbols))])
        sizes = [self._function.numel_in(i) for i in range(4)]
        self._arguments = [np.zeros(size) for size in sizes]
        self._result = np.zeros(self._function.numel_out(0))
        buffer: Any = self._function.buffer()  # its stub knows nothing of memoryviews
        self._buffer, self._evaluate = buffer
        for i, values in enumerate(self._arguments):
            if len(values):
                self._buffer.set_arg(i, memoryview(values.data))
        if len(self._result):
            self._buffer.set_res(0, memoryview(self._result.data))

    def __call__(self, t: float, x: ArrayLike, u: ArrayLike, p: FloatArray) -> FloatArray:
        for name, values, given in zip("txup", self._arguments, (t, x, u, p), strict=True):
            if len(values):  # python-control hands a dummy state of length 1 to static systems
                given = np.asarray(given, dtype=float).reshape(-1)
                if given.shape != values.shape:
                    raise ValueError(f"{name}: expected {len(values)} values, got {len(given)}")
                values[:] = given
        self._evaluate()
        return self._result.copy()

    def __deepcopy__(self, memo: dict[int, object]) -> Evaluator:
        return Evaluator(self._function)  # a copy has buffers of its own

    def __reduce__(self) -> tuple[type[Evaluator], tuple[ca.Function]]:
        return Evaluator, (self._function,)  # nor does a buffer go to another process


def symbols_like(function: ca.Function, sizes: Sequence[int] | None = None) -> list[Any]:
    """Columns t, x, u, p of the kind that expands the function; of its own sizes, or of others."""
    kind = ca.SX if function.is_a("SXFunction") else ca.MX
    counts = [function.numel_in(i) for i in range(4)] if sizes is None else sizes
    return [kind.sym(name, count) for name, count in zip("txup", counts, strict=True)]


class FunctionBlock(ct.NonlinearIOSystem):
    """A python-control system made of CasADi functions; made by :func:`function_block` or a factory of plants.

    It behaves as any ``control.NonlinearIOSystem``; :meth:`linearize` is exact.

    Parameters
    ----------
    functions : BlockFunctions
    name : str
        Name of the block.
    dt : float or None
        0 for a continuous block, a sampling interval in seconds for a discrete one, None for a static one that goes
        with either.

    Raises
    ------
    ValueError
        If a function does not take (t, x, u, p) of the sizes that the variables say.

    Notes
    -----
    ``params`` of python-control's functions take a parameter by its name (arrays whole, or one entry as
    ``name[i]``), in a diagram also as ``block.name``, which goes to that block alone and wins over the bare name. The
    attribute ``params`` is empty, because python-control would merge those of all blocks of a diagram under their bare
    names; the values stand in ``functions.parameters``.
    """

    def __init__(self, functions: BlockFunctions, name: str, dt: float | None = 0.0) -> None:
        _check_sizes(functions, name)
        super().__init__(
            self._update,
            self._put_out,
            inputs=[entry.name for entry in functions.inputs],
            outputs=[entry.name for entry in functions.outputs],
            states=[entry.name for entry in functions.states],
            dt=dt,
            name=name,
        )
        self.functions = functions
        self.symbol: str = ""  # by which block diagrams show it: a kind of node, and its lines of text
        self._places = _places(functions.parameters)
        self._defaults = starts(functions.parameters)
        self._p = self._defaults
        self._evaluate_dynamics = Evaluator(functions.dynamics)
        self._evaluate_output = Evaluator(functions.output)

    @property
    def start_state(self) -> FloatArray:
        """Start values of the states, (states,); an initial state for ``control.input_output_response``."""
        return starts(self.functions.states)

    def parameter_vector(self, params: Mapping[str, ArrayLike] | None = None) -> FloatArray:
        """Values of ``functions.parameters``, (parameters,).

        Parameters
        ----------
        params : mapping of str to float or array, optional
            What differs from the defaults: ``name``, ``name[i]`` or ``block.name``.

        Raises
        ------
        ValueError
            For a name that the block does not have, or a value of another shape.
        """
        unknown = [key for key in params or {} if key.removeprefix(f"{self.name}.") not in self._places]
        if unknown:
            raise ValueError(unknown_name(f"parameter of {self.name!r}", unknown[0], list(self._places)))
        return self._values(params)

    def _values(self, params: Mapping[str, ArrayLike] | None) -> FloatArray:
        """As :meth:`parameter_vector`; names of other blocks, which a diagram hands on, are passed over."""
        if not params:
            return self._defaults
        values = self._defaults.copy()
        for prefix in ("", f"{self.name}."):  # the qualified name last, so that it wins
            for key, places in self._places.items():
                given = params.get(prefix + key)
                if given is None:
                    continue
                array = _signals.real(f"{self.name}: parameter {key!r}", given).reshape(-1)
                if array.size not in (1, len(places)) or not np.isfinite(array).all():
                    raise ValueError(
                        f"{self.name}: parameter {key!r}: expected {len(places)} finite "
                        f"value{'s' if len(places) > 1 else ''}, got {given!r}"
                    )
                values[places] = array
        return values

    # -- what python-control calls ------------------------------------------------------------------------------

    def _update(self, t: float, x: ArrayLike, u: ArrayLike, params: Mapping[str, ArrayLike]) -> FloatArray:
        return self._evaluate_dynamics(t, x, u, self._values(params))

    def _put_out(self, t: float, x: ArrayLike, u: ArrayLike, params: Mapping[str, ArrayLike]) -> FloatArray:
        return self._evaluate_output(t, x, u, self._values(params))

    def _update_params(self, params: Mapping[str, ArrayLike] | None) -> None:
        super()._update_params(params)
        self._p = self._values(params)

    def _rhs(self, t: float, x: ArrayLike, u: ArrayLike) -> FloatArray:
        return self._evaluate_dynamics(t, x, u, self._p)

    def _out(self, t: float, x: ArrayLike, u: ArrayLike) -> FloatArray:
        return self._evaluate_output(t, x, u, self._p)

    def __deepcopy__(self, memo: dict[int, object]) -> FunctionBlock:
        share(memo, self.functions)
        return copied(self, memo)

    # -- linearisation ------------------------------------------------------------------------------------------

    @cached_property
    def _jacobians(self) -> ca.Function:
        return jacobians(self.functions)

    # python-control's takes any keyword; this one names them.
    def linearize(  # pyright: ignore[reportIncompatibleMethodOverride]
        self,
        x0: ArrayLike | ct.OperatingPoint | None = None,
        u0: ArrayLike | None = None,
        t: float = 0.0,
        params: Mapping[str, ArrayLike] | None = None,
        eps: float = 0.0,
        copy_names: bool = True,
        *,
        name: str | None = None,
        inputs: int | Sequence[str] | None = None,
        outputs: int | Sequence[str] | None = None,
        states: int | Sequence[str] | None = None,
    ) -> ct.StateSpace:
        """Exact linearisation, by derivatives of the equations; ``control.linearize`` comes here too.

        Parameters
        ----------
        x0 : (states,) array, number or control.OperatingPoint, optional
            State; None means the start.
        u0 : (inputs,) array or number, optional
            Inputs; None means their defaults.
        t : float
            Time in seconds.
        params : mapping, optional
            Parameters that differ from the defaults.
        eps : float
            Not used: nothing is perturbed. In the signature because python-control's has it.
        copy_names : bool
            Whether the linear system has the names of this one.
        name : str, optional
            Name of the linear system; None means that of this one with ``$linearized``.
        inputs, outputs, states : int or sequence of str, optional
            Other names.

        Returns
        -------
        control.StateSpace

        Raises
        ------
        ValueError
            For wrong shapes, unknown parameters, where a derivative does not exist, or for a block without inputs or
            outputs.
        """
        x0, u0 = unpacked(x0, u0)
        x = point("x0", x0, self.functions.states)
        u = point("u0", u0, self.functions.inputs)
        n, m, k = len(x), len(u), len(self.functions.outputs)
        if not m or not k:
            raise ValueError(
                f"{self.name} has {m} inputs and {k} outputs: a python-control state space has one of each at least; "
                "differentiate functions.dynamics with casadi.jacobian instead"
            )
        A, B, C, D = (
            np.array(part, dtype=float).reshape(shape)  # CasADi forgets the other size of an empty matrix
            for part, shape in zip(
                self._jacobians(t, x, u, self.parameter_vector(params)),
                ((n, n), (n, m), (k, n), (k, m)),
                strict=True,
            )
        )
        self._refuse_non_finite(np.block([[A, B], [C, D]]))
        labels = linear_labels(self, copy_names, name, inputs, outputs, states)
        return ct.StateSpace(A, B, C, D, self.dt, remove_useless_states=False, **labels)

    def _refuse_non_finite(self, matrix: FloatArray) -> None:
        bad = np.argwhere(~np.isfinite(matrix))
        if len(bad):
            rows = [f"d({label})/dt" for label in self.state_labels] + self.output_labels
            columns = self.state_labels + self.input_labels
            row, column = bad[0]
            raise ValueError(
                f"{self.name}: the derivative of {rows[row]} by {columns[column]} is not finite at this point: move "
                "the point, or write the equation so that it has a derivative there (sqrt at 0 has none; norm does)"
            )


def function_block(functions: BlockFunctions, *, name: str, dt: float | None = 0.0) -> FunctionBlock:
    """A python-control system from CasADi functions.

    Parameters
    ----------
    functions : BlockFunctions
        Equations with named variables.
    name : str
        Name of the block.
    dt : float or None
        0 for a continuous block, a sampling interval in seconds for a discrete one, None for a static one that goes
        with either.

    Returns
    -------
    FunctionBlock

    Raises
    ------
    ValueError
        If a function does not take (t, x, u, p) of the sizes that the variables say.

    Examples
    --------
    >>> t, x, u, p = ca.SX.sym("t"), ca.SX.sym("x"), ca.SX.sym("u"), ca.SX.sym("p")
    >>> lag = function_block(
    ...     BlockFunctions(
    ...         (Variable("y"),), (Variable("u"),), (Variable("y"),), (Variable("T", 0.5, "s"),),
    ...         ca.Function("dynamics", [t, x, u, p], [(u - x) / p]), ca.Function("output", [t, x, u, p], [x])),
    ...     name="lag")
    >>> lag.dynamics(0.0, [1.0], [0.0]).tolist(), lag.linearize().A.tolist()
    ([-2.0], [[-2.0]])
    """
    return FunctionBlock(functions, name, dt)


def jacobians(functions: BlockFunctions) -> ca.Function:
    """(t, x, u, p) -> dense A, B, C, D."""
    symbolic = functions.dynamics.is_a("SXFunction") and functions.output.is_a("SXFunction")
    symbols = symbols_like(functions.dynamics if symbolic else functions.dynamics.wrap())
    x, u = symbols[1:3]
    parts = [
        ca.densify(ca.jacobian(function(*symbols), variable))
        for function in (functions.dynamics, functions.output)
        for variable in (x, u)
    ]
    return ca.Function("jacobians", symbols, parts)


def linear_labels(
    system: ct.InputOutputSystem,
    copy_names: bool,
    name: str | None,
    inputs: int | Sequence[str] | None,
    outputs: int | Sequence[str] | None,
    states: int | Sequence[str] | None,
) -> dict[str, Any]:
    """Names of a linearisation, as keywords of ``control.StateSpace``: the given ones, else those of the system."""
    own = {
        "inputs": system.input_labels,
        "outputs": system.output_labels,
        "states": system.state_labels or None,
    }
    given = {"inputs": inputs, "outputs": outputs, "states": states, "name": name}
    if copy_names:
        given = (
            own | {"name": f"{system.name}$linearized"} | {k: v for k, v in given.items() if v is not None}
        )
    return {kind: value for kind, value in given.items() if value is not None}


def starts(variables: Sequence[Variable]) -> FloatArray:
    """Start values or defaults, as a vector."""
    return np.array([entry.start for entry in variables], dtype=float)


def unpacked(
    x0: ArrayLike | ct.OperatingPoint | None, u0: ArrayLike | None
) -> tuple[ArrayLike | None, ArrayLike | None]:
    """State and inputs of an operating point; anything else as it is."""
    if not isinstance(x0, ct.OperatingPoint):
        return x0, u0
    return np.asarray(x0.states, dtype=float), np.asarray(x0.inputs, dtype=float) if u0 is None else u0


def point(name: str, values: ArrayLike | None, variables: Sequence[Variable]) -> FloatArray:
    """A vector for these variables; None means their starts, one number stands for all."""
    if values is None:
        return starts(variables)
    vector = _signals.real(name, values)
    if vector.ndim == 0:
        return np.full(len(variables), float(vector))
    if vector.shape != (len(variables),):
        raise ValueError(
            f"{name}: expected shape ({len(variables)},) for {', '.join(entry.name for entry in variables)}; "
            f"got {vector.shape}"
        )
    return vector


def unknown_name(what: str, name: str, known: Sequence[str]) -> str:
    """Message for a name that is not among the known ones."""
    near = difflib.get_close_matches(name, known, 1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return f"unknown {what}: {name!r}; expected one of {', '.join(known) or '(none)'}{hint}"


def share(memo: dict[int, object], *things: object) -> None:
    """Let a deep copy refer to these, which never change, instead of copying them."""
    for thing in things:
        memo[id(thing)] = thing


def copied(system: Any, memo: dict[int, object]) -> Any:
    """The rest of a deep copy, attribute by attribute."""
    copy = object.__new__(type(system))
    memo[id(system)] = copy
    copy.__dict__.update({name: deepcopy(value, memo) for name, value in vars(system).items()})
    return copy


def _places(parameters: Sequence[Variable]) -> dict[str, list[int]]:
    """Where each name stands in the vector: the labels, and arrays under their own name."""
    places: dict[str, list[int]] = {}
    for i, entry in enumerate(parameters):
        places[entry.name] = [i]
        if match := _ENTRY.fullmatch(entry.name):
            places.setdefault(match[1], []).append(i)
    return places


def _check_sizes(functions: BlockFunctions, name: str) -> None:
    expected = [1, len(functions.states), len(functions.inputs), len(functions.parameters)]
    for kind, function, results in (
        ("dynamics", functions.dynamics, len(functions.states)),
        ("output", functions.output, len(functions.outputs)),
    ):
        if function.n_in() != 4 or function.n_out() != 1:
            raise ValueError(
                f"{name}: {kind} takes {function.n_in()} arguments and returns {function.n_out()}: expected "
                "(t, x, u, p) and one"
            )
        got = [function.numel_in(i) for i in range(4)]
        if got != expected or function.numel_out(0) != results:
            raise ValueError(
                f"{name}: {kind} takes t, x, u, p of sizes {got} and returns {function.numel_out(0)} values; the "
                f"variables say {expected} and {results}"
            )
