"""Equations of motion, written once, as a python-control system."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..blocks.function_block import FunctionBlock, copied, share, unknown_name
from ..blocks.functions import BlockFunctions
from .algebra import Array, Scalar
from .declaration import Columns, Declaration, Group, check_name, declared, flat, labelled
from .interpreting import as_python, on_numbers

__all__ = [
    "Equations",
    "Plant",
    "Results",
    "plant",
]

Results: TypeAlias = Mapping[str, Scalar | Sequence[Scalar]]
Equations: TypeAlias = Callable[[Array, Columns, Columns, Columns], Results | tuple[Results, Results]]
"""(t, x, u, p) -> derivatives of the states by name; or these and the outputs."""

_ADVICE = (
    "write them with arithmetic, numpy's elementwise functions and phyfilter_ctl.plants' norm, where, stack, ...; "
    "math.sin, float(), an `if` on a state and assignment into np.zeros do not go, but with interpreted=True"
)


class Plant(FunctionBlock):
    """Equations of motion as a python-control system; made by :func:`plant`.

    It simulates in python-control, linearises exactly and can be flattened and exported.

    Parameters
    ----------
    functions : BlockFunctions
        The equations with their variables, starts and units.
    name : str
        Name of the block.
    dt : float
        0 for a continuous plant, else a sampling interval in seconds.
    """

    def __init__(self, functions: BlockFunctions, name: str, dt: float = 0.0) -> None:
        super().__init__(functions, name, dt)

    def __deepcopy__(self, memo: dict[int, object]) -> Plant:
        share(memo, self.functions)
        return copied(self, memo)

    @property
    def parameters(self) -> dict[str, float]:
        """Values of the parameters by label, ``J[0,0]`` for entries of arrays."""
        return {entry.name: entry.start for entry in self.functions.parameters}

    def with_parameters(self, values: Mapping[str, ArrayLike]) -> Plant:
        """The same plant with other values of some parameters.

        Parameters
        ----------
        values : mapping of str to float or array
            By name, arrays whole or entry by entry as ``name[i]``.

        Raises
        ------
        ValueError
            For a name that the plant does not have, or a value of another shape.

        Examples
        --------
        >>> from phyfilter_ctl.plants import mass
        >>> mass().with_parameters({"mass": 2.0}).parameters["mass"]
        2.0
        """
        vector = self.parameter_vector(values)
        parameters = tuple(
            replace(entry, start=float(value))
            for entry, value in zip(self.functions.parameters, vector, strict=True)
        )
        return Plant(replace(self.functions, parameters=parameters), self.name, float(self.dt or 0.0))

    def describe(self) -> str:
        """Variables with starts, units and descriptions, for reading.

        Examples
        --------
        >>> from phyfilter_ctl.plants import mass
        >>> print(mass(1).describe())
        mass
        state      r[0]       0      m       position
        state      v[0]       0      m/s     velocity
        input      force[0]   0      N       force
        output     r[0]              m       position
        output     v[0]              m/s     velocity
        parameter  mass       1      kg      mass
        parameter  drag       0      kg/m    quadratic drag
        """
        rows = [
            (
                kind,
                entry.name,
                "" if kind == "output" else f"{entry.start:g}",
                entry.unit,
                f"{entry.description} (optional)" if entry.optional else entry.description,
            )
            for kind, variables in (
                ("state", self.functions.states),
                ("input", self.functions.inputs),
                ("output", self.functions.outputs),
                ("parameter", self.functions.parameters),
            )
            for entry in variables
        ]
        width = max((len(row[1]) for row in rows), default=0) + 3
        lines = [
            f"{kind:<11}{name:<{width}}{start:<7}{unit:<8}{text}" for kind, name, start, unit, text in rows
        ]
        return "\n".join([self.name, *(line.rstrip() for line in lines)])


def plant(
    equations: Equations,
    *,
    states: Mapping[str, Declaration],
    inputs: Mapping[str, Declaration] | None = None,
    outputs: Mapping[str, str | tuple[str, str]] | Sequence[str] | None = None,
    params: Mapping[str, Declaration] | None = None,
    optional: Sequence[str] = (),
    name: str | None = None,
    dt: float = 0.0,
    interpreted: bool = False,
) -> Plant:
    """A python-control system from equations that are written once.

    Parameters
    ----------
    equations : function (t, x, u, p) -> derivatives, or (derivatives, outputs)
        Reads the states as ``x.v``, the inputs as ``u.force``, the parameters as ``p.mass``: CasADi numbers, columns or
        matrices, as declared. Returns dicts: of each state its derivative (with dt its next value), of each output its
        value. Without outputs the states are the outputs.
    states, inputs, params : dict
        name -> start, (start, unit) or (start, unit, description), in SI units. An array declares a vector, with labels
        v[0], v[1] ..., or a matrix, J[0,0], J[0,1] ... A start of an input is its default. A fourth entry (minimum,
        maximum), infinite where open, or (minimum, maximum, nominal), the usual size last, goes into exported FMUs;
        nothing is clipped.
    outputs : dict or sequence of str, optional
        name -> unit or (unit, description), or names alone, which choose and order the outputs of the equations; None
        means all. An output called like a state or an input has its unit.
    optional : sequence of str
        Inputs that a diagram may leave open: they are then at their default.
    name : str, optional
        Name of the block; None means that of the function.
    dt : float
        0 for a continuous plant, else a sampling interval in seconds.
    interpreted : bool
        Leave the equations a Python function: it gets numbers and numpy arrays, may do with them what it likes, and
        runs as Python wherever the plant runs. Such a plant has no C code, and its derivatives are differences.

    Returns
    -------
    Plant
        Its CasADi functions are in ``functions``.

    Raises
    ------
    ValueError, TypeError
        For derivatives that are missing, unknown or of the wrong shape, names that are no identifiers, or equations
        that cannot be traced; the message names the variable and says what to write.

    Examples
    --------
    >>> def pendulum(t, x, u, p):
    ...     gravity = p.gravity / p.length * np.sin(x.angle)
    ...     return {"angle": x.rate, "rate": u.torque / (p.mass * p.length**2) - gravity}
    >>> swing = plant(
    ...     pendulum,
    ...     states={"angle": (0.1, "rad"), "rate": (0.0, "rad/s")},
    ...     inputs={"torque": (0.0, "N m")},
    ...     params={"mass": (0.5, "kg"), "length": (2.0, "m"), "gravity": (9.81, "m/s^2")},
    ... )
    >>> swing.linearize(0.0).A.tolist()
    [[0.0, 1.0], [-4.905, 0.0]]
    >>> swing.dynamics(0.0, [0.0, 0.0], [1.0], params={"mass": 1.0}).tolist()
    [0.0, 0.25]
    """
    name = str(getattr(equations, "__name__", "plant")) if name is None else name
    groups = [
        declared(kind, given) for kind, given in (("states", states), ("inputs", inputs), ("params", params))
    ]
    groups[1] = _optional(name, groups[1], optional)
    t: ca.SX = ca.SX.sym("t")
    columns = [ca.SX.sym(kind, len(flat(group))) for kind, group in zip("xup", groups, strict=True)]
    if interpreted:
        starts = [np.array([v.start for v in flat(group)], dtype=float) for group in groups]
        result = on_numbers(equations, groups, 0.0, *starts)
    else:
        result = _run(equations, name, t, columns, groups)
    pair = result if isinstance(result, tuple) else (result, None)
    if len(pair) != 2 or not all(isinstance(part, Mapping) or part is None for part in pair):
        raise TypeError(
            f"{name}: expected the equations to return a dict of derivatives, or two dicts (derivatives, outputs), got "
            f"{type(result).__name__}"
        )
    arguments = [t, *columns]
    derivatives = _derivatives(name, pair[0] or {}, groups[0], arguments)
    chosen, values = _outputs(name, pair[1], outputs, groups, columns, arguments)
    functions = BlockFunctions(
        flat(groups[0]),
        flat(groups[1]),
        flat(chosen),
        flat(groups[2]),
        ca.Function("dynamics", arguments, [ca.densify(derivatives)]),
        ca.Function("output", arguments, [ca.densify(values)]),
    )
    if interpreted:
        functions = as_python(functions, equations, groups, chosen, name, has_outputs=pair[1] is not None)
    return Plant(functions, name, dt)


def _optional(name: str, inputs: Sequence[Group], optional: Sequence[str]) -> list[Group]:
    known = [group.name for group in inputs]
    if isinstance(optional, str) or not set(optional) <= set(known):
        wrong = (
            optional if isinstance(optional, str) else next(each for each in optional if each not in known)
        )
        raise ValueError(f"{name}: optional: expected names of inputs; {unknown_name('input', wrong, known)}")
    return [
        replace(group, variables=tuple(replace(entry, optional=True) for entry in group.variables))
        if group.name in optional
        else group
        for group in inputs
    ]


_KINDS = ("states", "inputs", "parameters")


def _run(
    equations: Equations, name: str, t: ca.SX, columns: Sequence[ca.SX], groups: Sequence[Sequence[Group]]
) -> Results | tuple[Results, Results]:
    """The equations on symbols."""
    views = [
        Columns(
            kind.removesuffix("s"), dict(zip([g.name for g in group], _parts(column, group), strict=True))
        )
        for kind, column, group in zip(_KINDS, columns, groups, strict=True)
    ]
    with warnings.catch_warnings():
        # CasADi announces a change in numpy's functions on its types that none of the elementwise ones has.
        warnings.simplefilter("ignore", FutureWarning)
        try:
            return equations(t, *views)
        except AttributeError as error:
            raise ValueError(f"{name}: {error}") from error
        except Exception as error:
            raise ValueError(f"{name}: the equations failed on CasADi columns: {error}; {_ADVICE}") from error


def _parts(column: ca.SX, groups: Sequence[Group]) -> list[ca.SX]:
    ends = np.cumsum([0, *(len(group.variables) for group in groups)]).tolist()
    parts = ca.vertsplit(column, ends) if groups else []
    return [group.shaped(part) for group, part in zip(groups, parts, strict=True)]


def _derivatives(name: str, results: Results, states: Sequence[Group], arguments: Sequence[ca.SX]) -> ca.SX:
    known = [group.name for group in states]
    for given in results:
        if given not in known:
            raise ValueError(f"{name}: {unknown_name('state among the derivatives', given, known)}")
    rows = [ca.SX(0, 1)]
    for group in states:
        if group.name not in results:
            raise ValueError(
                f"{name}: no derivative of the state {group.name!r}: expected one of each, got those of "
                f"{', '.join(results) or 'none'}"
            )
        what = f"{name}: derivative of {group.name!r}"
        value = _expression(what, results[group.name], arguments)
        if _shape(value, group.shape) != group.shape:
            raise ValueError(f"{what}: expected shape {group.shape}, as its start has; got {value.shape}")
        rows.append(_row_by_row(value))
    return ca.vertcat(*rows)


def _outputs(
    name: str,
    results: Results | None,
    declared_outputs: Mapping[str, str | tuple[str, str]] | Sequence[str] | None,
    groups: Sequence[Sequence[Group]],
    columns: Sequence[ca.SX],
    arguments: Sequence[ca.SX],
) -> tuple[list[Group], ca.SX]:
    """Groups and values of the outputs, in the order asked for."""
    alike = {group.name: group for group in [*groups[1], *groups[0]]}
    values = {}
    if results is None:
        values = dict(zip([group.name for group in groups[0]], _parts(columns[0], groups[0]), strict=True))
    for key, value in (results or {}).items():
        check_name("outputs", key)
        values[key] = _expression(f"{name}: output {key!r}", value, arguments)
    if isinstance(declared_outputs, str):
        raise TypeError(f"outputs: expected a dict or a sequence of names, got the text {declared_outputs!r}")
    wanted = list(values) if declared_outputs is None else list(declared_outputs)
    chosen, rows = [], [ca.SX(0, 1)]
    for key in wanted:
        if key not in values:
            raise ValueError(f"{name}: {unknown_name('output', key, list(values))}")
        like = alike.get(key)
        texts = (like.variables[0].unit, like.variables[0].description) if like else ("", "")
        if isinstance(declared_outputs, Mapping):
            said = declared_outputs[key]
            texts = (said, texts[1]) if isinstance(said, str) else said
        shape = _shape(values[key], like.shape if like else None)
        chosen.append(labelled(key, np.zeros(shape), *texts))
        rows.append(_row_by_row(values[key]))
    return chosen, ca.vertcat(*rows)


def _expression(what: str, value: Scalar | Sequence[Scalar], arguments: Sequence[ca.SX]) -> ca.SX:
    """A result of the equations as CasADi expression: columns, numbers, or (nested) lists of them."""
    try:
        expression = _as_sx(value)
    except (NotImplementedError, TypeError, ValueError, RuntimeError) as error:
        raise TypeError(
            f"{what}: expected a number, a CasADi column or a list of them, got {type(value).__name__} {value!r}"
        ) from error
    probe = ca.Function("probe", list(arguments), [expression], {"allow_free": True})
    if probe.has_free():
        raise ValueError(f"{what} depends on symbols of another model: {', '.join(probe.get_free())}")
    constants = (
        probe.instruction_constant(i)
        for i in range(probe.n_instructions())
        if probe.instruction_id(i) == ca.OP_CONST
    )
    if any(np.isnan(constant) for constant in constants):
        raise ValueError(f"{what} lost its symbols and became NaN: the equations left CasADi; {_ADVICE}")
    return expression


def _as_sx(value: Scalar | Sequence[Scalar]) -> ca.SX:
    if isinstance(value, np.ndarray) and value.dtype == object:
        value = value.tolist()
    if isinstance(value, list | tuple):
        rows = [_as_sx(entry) for entry in value]
        return ca.vertcat(
            *[
                row.T if isinstance(entry, list | tuple) else row
                for row, entry in zip(rows, value, strict=True)
            ]
        )
    return ca.SX(value if isinstance(value, ca.SX | ca.DM) else np.asarray(value, dtype=float))


def _shape(value: ca.SX, wanted: tuple[int, ...] | None) -> tuple[int, ...]:
    """Shape of an expression; CasADi does not tell a number, a vector of one and a 1 x 1 matrix apart."""
    rows, columns = value.shape
    if wanted is not None and wanted in ((), (1,), (1, 1)) and (rows, columns) == (1, 1):
        return wanted
    if wanted is not None and len(wanted) == 2:
        return rows, columns
    if columns == 1:
        return () if rows == 1 else (rows,)
    return rows, columns


def _row_by_row(value: ca.SX) -> ca.SX:
    return ca.reshape(value.T, value.numel(), 1)
