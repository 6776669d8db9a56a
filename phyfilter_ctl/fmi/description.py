"""What an FMU says of its model: one form, from which the XML of FMI 2.0 and 3.0 and the C table are written."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from math import inf, prod
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..blocks.functions import Variable
from ..codegen.model import CModel
from .clocks import owners_of
from .experiment import FmuExperiment, FmuSolver
from .names import LEGAL, legal_name, with_legal_names

__all__ = [
    "FIRST_REFERENCE",
    "Fmi",
    "FmuExperiment",
    "FmuInterface",
    "FmuSolver",
    "InterfaceVariable",
    "fmu_interface",
]

Kind = Literal[
    "time", "input", "output", "parameter", "fixed", "state", "derivative", "sampled", "condition",
    "solver_step", "solver_rtol", "solver_atol", "clock", "local", "structure",
]  # fmt: skip
Fmi = Literal["2.0", "3.0"]

# Value reference of the first variable: some importers take 0 for none.
FIRST_REFERENCE = 1

# Kind: causality, variability, initial.
_ROLES: dict[str, tuple[str, str, str]] = {
    "time": ("independent", "continuous", ""),
    "input": ("input", "continuous", "exact"),
    "output": ("output", "continuous", "calculated"),
    "parameter": ("parameter", "tunable", "exact"),
    "fixed": ("parameter", "fixed", "exact"),
    "state": ("local", "continuous", "exact"),
    "derivative": ("local", "continuous", "calculated"),
    "sampled": ("local", "discrete", "calculated"),
    "condition": ("local", "continuous", "calculated"),
    "solver_step": ("parameter", "fixed", "exact"),
    "solver_rtol": ("parameter", "fixed", "exact"),
    "solver_atol": ("parameter", "fixed", "exact"),
    "clock": ("input", "discrete", ""),
    "local": ("local", "continuous", "calculated"),
    "structure": ("structuralParameter", "fixed", "exact"),
}
_INDEXED = re.compile(r"(.*[^\[\]])\[(\d+(?:,\d+)*)\]")


@dataclass(frozen=True)
class InterfaceVariable:
    """A variable of an FMU; its value reference counts from 1 in :attr:`FmuInterface.variables`.

    Parameters
    ----------
    name : str
    kind : str
        Which vector of the model it is part of.
    first : int
        Where in that vector.
    shape : tuple of int
        () for a scalar.
    start : tuple of float, optional
        Flat, row by row.
    unit, description : str
    derivative_of : int, optional
        Place of the state.
    minimum, maximum : float
        As declared; infinite where nobody did.
    nominal : float
        As declared; 0 where nobody did.
    clock : int, optional
        Place of the clock at whose ticks alone it changes.
    length : int, optional
        Place of the structural parameter that is the length of its first axis.
    """

    name: str
    kind: Kind
    first: int = 0
    shape: tuple[int, ...] = ()
    start: tuple[float, ...] | None = None
    unit: str = ""
    description: str = ""
    derivative_of: int | None = None
    minimum: float = -inf
    maximum: float = inf
    nominal: float = 0.0
    clock: int | None = None
    length: int | None = None

    @property
    def count(self) -> int:
        """Number of scalars."""
        return prod(self.shape)

    @property
    def causality(self) -> str:
        """FMI's causality."""
        return _ROLES[self.kind][0]

    @property
    def variability(self) -> str:
        """FMI's variability."""
        return _ROLES[self.kind][1]

    @property
    def initial(self) -> str:
        """FMI's initial; "" for time."""
        return _ROLES[self.kind][2]


@dataclass(frozen=True, eq=False)
class FmuInterface:
    """A model as an FMU shows it.

    Parameters
    ----------
    model : CModel
    fmi : {"2.0", "3.0"}
    exchange, simulation : bool
        Model exchange; co-simulation.
    variables : tuple of InterfaceVariable
        In the order of the value references.
    experiment : FmuExperiment
    depends : (n_x + n_y, n_x + n_u) bool array
        Which derivative and output depends on which state and input.
    on_time : (n_x + n_y,) bool array
        Which depends on time itself.
    derivatives : bool
        Whether the model has directional and adjoint derivatives.
    fixed_step : float
        Communication steps are multiples of this, in seconds; 0: they may have any length.
    why : str
        C function that says why the model refused the last call; "": the codes of pf_model.h say it all.
    most_channels : int
        Where their number is a structural parameter: so many at most. Else 0.
    """

    model: CModel
    fmi: Fmi
    exchange: bool
    simulation: bool
    variables: tuple[InterfaceVariable, ...]
    experiment: FmuExperiment
    depends: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, 0), dtype=bool))
    on_time: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))
    derivatives: bool = True
    fixed_step: float = 0.0
    why: str = ""
    most_channels: int = 0

    @property
    def solver(self) -> FmuSolver:
        """Of co-simulation with continuous states."""
        return self.experiment.solver or FmuSolver()

    @property
    def description(self) -> str:
        """Of the experiment, else the model's own."""
        return self.experiment.description or self.model.description

    def of_kind(self, *kinds: Kind) -> tuple[int, ...]:
        """Places of the variables of some kinds.

        Parameters
        ----------
        kinds : str
        """
        return tuple(i for i, variable in enumerate(self.variables) if variable.kind in kinds)

    def dependencies(self, place: int) -> tuple[int, ...]:
        """Places of what an output or derivative depends on: states, inputs, time.

        Parameters
        ----------
        place : int
        """
        variable = self.variables[place]
        n_x = len(self.model.states)
        first = variable.first + (0 if variable.kind == "derivative" else n_x)
        row = np.any(self.depends[first : first + variable.count], axis=0).tolist()
        found = list(self.of_kind("time")) if self.on_time[first : first + variable.count].any() else []
        for i in self.of_kind("input", "state"):
            known = self.variables[i]
            at = known.first + (n_x if known.kind == "input" else 0)
            if any(row[at : at + known.count]):
                found.append(i)
        return tuple(found)

    @property
    def sampled(self) -> bool:
        """Whether blocks inside act at instants only: then outputs at the start depend on more than later."""
        return bool(self.model.tasks) or self.model.communication > 0.0


def fmu_interface(
    model: CModel,
    *,
    fmi: Fmi = "3.0",
    kinds: Sequence[Literal["cs", "me"]] = ("cs", "me"),
    experiment: FmuExperiment | None = None,
    arrays: bool = True,
    derivatives: bool = True,
    on_time: NDArray[np.bool_] | None = None,
    tunable: bool = True,
    fixed_step: float = 0.0,
    why: str = "",
    clocks: bool = False,
    recorded: int = 0,
) -> FmuInterface:
    """The variables and structure of an FMU.

    Parameters
    ----------
    model : CModel
    fmi : {"2.0", "3.0"}
    kinds : sequence of {"cs", "me"}
        Co-simulation, model exchange.
    experiment : FmuExperiment, optional
    arrays : bool
        FMI 3: x[0], x[1], ... become one array x. FMI 2 has scalars only.
    derivatives : bool
        Whether the model has directional and adjoint derivatives.
    on_time : (n_x + n_y,) bool array, optional
        Which derivative and output depends on time itself; None means none does.
    tunable : bool
        Whether parameters may change while running.
    fixed_step : float
        Communication steps are multiples of this, in seconds; 0: they may have any length.
    why : str
        C function that says why the model refused the last call.
    clocks : bool
        FMI 3: each sampled block with instants of its own gets a clock that the importer ticks.
    recorded : int
        So many of the model's outputs, the last, are signals to be read only, local variables.

    Raises
    ------
    ValueError
        If a name has no part before or after a dot, or two are equal; the message names it. If there are to be clocks
        and nothing that they could tick.

    Notes
    -----
    A part of a name that FMI's structured naming does not allow stands in single quotes, ``'v 1'``; letters beyond
    ASCII are spelt out. Where a name differs from the model's, the variable's description begins with the model's.
    """
    if fmi not in ("2.0", "3.0"):
        raise ValueError(f"fmi: expected '2.0' or '3.0', got {fmi!r}")
    chosen = set(kinds)
    if not chosen or not chosen <= {"cs", "me"}:
        raise ValueError(f"kinds: expected 'cs', 'me' or both, got {tuple(kinds)!r}")
    experiment = experiment or FmuExperiment()
    grouped = arrays and fmi == "3.0"
    if clocks and (fmi != "3.0" or not model.tasks):
        missing = (
            "FMI 3.0"
            if fmi != "3.0"
            else "a sampled block with instants of its own (of a filter: rate='fixed')"
        )
        raise ValueError(f"clocks=True needs {missing}")
    owners = owners_of(model) if clocks else ()
    model = with_legal_names(model)
    variables = [InterfaceVariable("time", "time", unit="s", description="Independent variable")]
    variables += _variables("input", model.inputs, grouped)
    inner = len(model.outputs) - recorded
    variables += [
        variable if variable.first < inner else replace(variable, kind="local")
        for variable in _variables("output", model.outputs, grouped)
    ]
    variables += _variables("parameter" if tunable else "fixed", model.parameters, grouped)
    taken = {variable.name for variable in variables}
    states = _variables("state", _beside(model.states, taken), grouped)
    first_state = len(variables)
    variables += states
    for i, state in enumerate(states):
        variables.append(
            InterfaceVariable(
                f"der({state.name})", "derivative", state.first, state.shape, None, _rate(state.unit),
                f"Time derivative of {state.name}", first_state + i,
            )
        )  # fmt: skip
    taken = {variable.name for variable in variables}
    variables += _sampled(model, owners, _beside(model.sampled_states, taken), grouped, len(variables))
    variables += [
        InterfaceVariable(f"condition.{name}", "condition", i, description=f"Passes 0 at the event {name}")
        for i, name in enumerate(model.events)
    ]
    if "cs" in chosen and model.states:
        variables += _solver_variables(experiment.solver or FmuSolver())
    _check_names(variables)
    n_x, n_rows = len(model.states), len(model.states) + len(model.outputs)
    shape = (n_rows, n_x + len(model.inputs))
    depends = np.asarray(model.depends, dtype=bool)
    return FmuInterface(
        model=model,
        fmi=fmi,
        exchange="me" in chosen,
        simulation="cs" in chosen,
        variables=tuple(variables),
        experiment=experiment,
        # A model that does not say depends on everything: safe for whoever looks for algebraic loops.
        depends=depends if depends.shape == shape else np.ones(shape, dtype=bool),
        on_time=np.zeros(n_rows, dtype=bool) if on_time is None else on_time,
        derivatives=derivatives,
        fixed_step=fixed_step,
        why=why,
    )


def _sampled(
    model: CModel, owners: tuple[int | None, ...], states: tuple[Variable, ...], grouped: bool, first: int
) -> list[InterfaceVariable]:
    """States of the sampled blocks, and before them the clocks, if there are to be some."""
    variables = _variables("sampled", states, grouped)
    if not owners:
        return variables
    clocks = [
        InterfaceVariable(
            f"clock.{legal_name(name)}", "clock", i, description=f"Ticks {name} every {period!r} s"
        )
        for i, (name, period) in enumerate(model.tasks)
    ]
    places = [owners[variable.first] for variable in variables]
    return clocks + [
        variable if owner is None else replace(variable, clock=first + owner)
        for variable, owner in zip(variables, places, strict=True)
    ]


def _solver_variables(solver: FmuSolver) -> list[InterfaceVariable]:
    texts = (
        "Longest step of the solver",
        "Relative tolerance of the solver",
        "Absolute tolerance of the solver",
    )
    variables = [
        InterfaceVariable(
            "solver.step",
            "solver_step",
            start=(solver.step or 0.0,),
            unit="s",
            description=texts[0],
            minimum=0.0,
        )
    ]
    if solver.method == "adaptive":
        variables.append(
            InterfaceVariable(
                "solver.rtol", "solver_rtol", start=(solver.rtol,), description=texts[1], minimum=0.0
            )
        )
        variables.append(
            InterfaceVariable(
                "solver.atol", "solver_atol", start=(solver.atol,), description=texts[2], minimum=0.0
            )
        )
    return variables


def _beside(vector: tuple[Variable, ...], taken: set[str]) -> tuple[Variable, ...]:
    """States whose names inputs, outputs or parameters have already get a name of their own."""
    bases = {_base(name) for name in taken}

    def named(variable: Variable) -> Variable:
        clash = variable.name in taken or _base(variable.name) in bases
        name = f"state.{variable.name}" if clash else variable.name
        return replace(variable, name=name)

    return tuple(named(variable) for variable in vector)


def _base(name: str) -> str:
    match = _INDEXED.fullmatch(name)
    return match.group(1) if match else name


def _rate(unit: str) -> str:
    if not unit or unit == "1":
        return "1/s" if unit else ""
    return f"{unit}/s" if re.fullmatch(r"[A-Za-z ]+", unit) else f"({unit})/s"


def _variables(kind: Kind, vector: tuple[Variable, ...], grouped: bool) -> list[InterfaceVariable]:
    started = kind in {"input", "parameter", "fixed", "state"}
    result, i = [], 0
    while i < len(vector):
        base, shape = _array_at(vector, i) if grouped else ("", ())
        if prod(shape) < 2:
            base, shape = vector[i].name, ()
        part = vector[i : i + prod(shape)]
        start = tuple(float(variable.start) for variable in part) if started else None
        # One pair of bounds for the whole array: what all of its entries keep.
        least, most = min(v.minimum for v in part), max(v.maximum for v in part)
        usual = max(v.nominal for v in part)
        about = part[0].unit, part[0].description
        result.append(
            InterfaceVariable(base, kind, i, shape, start, *about, minimum=least, maximum=most, nominal=usual)
        )
        i += len(part)
    return result


def _array_at(vector: tuple[Variable, ...], i: int) -> tuple[str, tuple[int, ...]]:
    """Name and shape of the array that begins at i: all its elements in a row, counted from 0."""
    match = _INDEXED.fullmatch(vector[i].name)
    if match is None:
        return "", ()
    base, unit = match.group(1), vector[i].unit
    everywhere = [variable for variable in vector if _base(variable.name) == base and "[" in variable.name]
    here = vector[i : i + len(everywhere)]
    indices = []
    for variable in here:
        found = _INDEXED.fullmatch(variable.name)
        if found is None or found.group(1) != base or variable.unit != unit:
            return "", ()
        indices.append(tuple(int(k) for k in found.group(2).split(",")))
    if len({len(index) for index in indices}) != 1:
        return "", ()
    shape = tuple(max(part) + 1 for part in zip(*indices, strict=True))
    complete = list(product(*(range(n) for n in shape)))
    return (base, shape) if indices == complete else ("", ())


def _check_names(variables: list[InterfaceVariable]) -> None:
    for variable in variables:
        name = variable.name
        plain = name[4:-1] if variable.kind == "derivative" else name
        if LEGAL.fullmatch(plain) is None:
            raise ValueError(
                f"{variable.kind} {name!r} is no legal FMI name: expected parts joined by dots; rename the signal"
            )
    double = [name for name, count in Counter(variable.name for variable in variables).items() if count > 1]
    if double:
        raise ValueError(
            f"two variables of the FMU are called {double[0]!r}; rename one of the signals or blocks"
        )
