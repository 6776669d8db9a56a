"""A flat diagram as C: equations from CasADi, sampled blocks at their own instants, and the table that runs it."""

from __future__ import annotations

import re
import zlib
from dataclasses import replace
from fractions import Fraction
from importlib import resources
from math import gcd, lcm

from ..blocks.functions import Variable, dependencies
from ..diagram.discrete import as_sampled
from ..diagram.model import FlatModel
from ..diagram.switches import located
from .casadi_source import Real, casadi_header
from .diagram_equations import dependence, directional_functions, flat_functions, law_functions, settled_tasks
from .diagram_filters import FilterTask, filter_task
from .diagram_header import Layout, TaskText, checked, header_text
from .diagram_step import held_numbers, stack_bytes
from .diagram_text import source_text
from .identifiers import checked_identifier, identifiers, model_identifier
from .model import CModel

__all__ = ["diagram_model", "runtime_sources"]

_RUNTIME = ("pf_ieee.h", "pf_model.h", "pf_run.h", "pf_run.c", "pf_instants.h", "pf_crc.h")
# Periods whose common divisor is this much shorter than the shortest of them have none in practice.
_FINEST_STEP = 1e-3
_LONGEST_FRACTION = 10**9
_DEFAULT_STEP = 1e-3
_MOST_SUBSTEPS = 10**6


def runtime_sources(
    names: tuple[str, ...] = _RUNTIME, real: Real = "double", events: bool = False
) -> dict[str, str]:
    """Texts of the C files that no model changes.

    Parameters
    ----------
    names : tuple of str
        Files of codegen/runtime.
    real : {"double", "float"}
        What ``pf_real`` is where the compiler is not told otherwise (-DPF_REAL=...).
    events : bool
        With what runs events, pf_events.h.

    Examples
    --------
    >>> "#define PF_REAL float" in runtime_sources(("pf_model.h",), "float")["pf_model.h"]
    True
    """
    folder = resources.files("phyfilter_ctl.codegen") / "runtime"
    texts = {name: (folder / name).read_text(encoding="utf-8") for name in names}
    if real == "float" and "pf_model.h" in texts:
        texts["pf_model.h"] = texts["pf_model.h"].replace("#define PF_REAL double", "#define PF_REAL float")
    if events and "pf_model.h" in texts:
        texts["pf_model.h"] = texts["pf_model.h"].replace("#define PF_EVENTS 0", "#define PF_EVENTS 1")
    return texts


def diagram_model(
    flat: FlatModel,
    *,
    name: str | None = None,
    real: Real = "double",
    derivatives: bool = True,
    tunable: bool = True,
    step: float | None = None,
    substeps: int = 1,
) -> CModel:
    """C99 sources of a flat diagram.

    Parameters
    ----------
    flat : FlatModel
        Continuous with or without sampled blocks, or discrete.
    name : str, optional
        C identifier, prefix of all symbols; made from the diagram's name if not given.
    real : {"double", "float"}
        Numbers of the C code. Time is double in any case, and so is what an equation computes from it until it no
        longer grows with it; a block without a scalar form (a table, say) gets time as float there.
    derivatives : bool
        With directional and adjoint products.
    tunable : bool
        Coefficients and limits of sampled PhyFilters become parameters behind those of the diagram: ``block.a[j]``,
        ``block.b[j]`` (``[i,j]`` where channels differ), ``block.limit[i]``,
        ``block.g_low[i]``, ``block.g_high[i]``.
    step : float, optional
        Seconds between two calls of ``<name>_step``. By default the longest that meets every instant of the sampled
        blocks; 1 ms where there are none.
    substeps : int
        Runge-Kutta steps in one call of ``<name>_step``.

    Returns
    -------
    CModel

    Raises
    ------
    ValueError
        If the name is none in C, the step or substeps are not positive, CasADi has no C code for a part of the diagram,
        or a nonlinear algebraic loop is to be solved in float.

    Notes
    -----
    Instants are counted in integers and happen at start + k * period; ``<name>_step`` computes a time only where an
    equation reads it.

    Examples
    --------
    >>> import casadi as ca
    >>> t, x, u, p, z = (ca.SX.sym(n, m) for n, m in (("t", 1), ("x", 1), ("u", 1), ("p", 1), ("z", 0)))
    >>> flat = FlatModel(
    ...     "lag", (Variable("x"),), (Variable("u"),), (Variable("y"),), (Variable("rate", 2.0, "1/s"),), (),
    ...     ca.Function("f", [t, x, u, p, z], [p * (u - x)]), ca.Function("h", [t, x, u, p, z], [x]))
    >>> model = diagram_model(flat)
    >>> model.symbol, sorted(file for file in model.sources if file.startswith("lag"))
    ('lag_model', ['lag.c', 'lag.h', 'lag_equations.h'])
    """
    if real not in ("double", "float"):
        raise ValueError(f"real: expected 'double' or 'float', got {real!r}")
    if isinstance(substeps, bool) or not isinstance(substeps, int) or not 1 <= substeps <= _MOST_SUBSTEPS:
        raise ValueError(f"substeps: expected a whole number from 1 to {_MOST_SUBSTEPS}, got {substeps!r}")
    if flat.callbacks:
        callback = flat.callbacks[0]
        raise ValueError(
            f"block {callback.block} runs as Python, for which there is no C code: {callback.reason}. {callback.remedy}"
        )
    flat = as_sampled(flat)
    if (
        real == "double"
    ):  # float loses what places a switch: ranges that count periods, levels at their borders
        flat = located(flat)
    prefix = model_identifier(flat.name) if name is None else checked_identifier(name)
    functions = flat_functions(flat)
    parts = _Parts(flat.parameters)
    settled = settled_tasks(flat.tasks)
    names = identifiers(task.name for task in flat.tasks)
    for i, task in enumerate(flat.tasks):
        if task.filter is None:
            functions |= law_functions(task.law, i)
            parts.add_law(flat, i, prefix, settled[i])
        else:
            parts.add_filter(
                filter_task(
                    task, task.filter, name=f"{prefix}_filter_{names[i]}", number=i, parameter=len(parts.parameters),
                    settled=settled[i], real=real, tunable=tunable,
                )
            )  # fmt: skip
    products = directional_functions(flat) if derivatives else {}
    equations = casadi_header(functions | products, prefix, real)
    base, grid = _base_step(flat, step)
    newton = "casadi_newton(" in equations
    sampled_states = tuple(parts.law_states + parts.filter_states)
    parameters = tuple(parts.parameters)
    layout = Layout(
        name=prefix, real=real, description=flat.name or prefix, states=flat.states, inputs=flat.inputs,
        outputs=flat.outputs, parameters=parameters, held=flat.held, sampled_states=sampled_states,
        law_states=tuple(parts.law_states), tasks=tuple(parts.tasks), derivatives=bool(products),
        can_fail=newton or bool(parts.sources and len(parts.tasks) > 1), newton=newton, step=base, substeps=substeps,
        grid=grid, timed=frozenset(name for name, f in functions.items() if dependencies(f, 0).any()),
        between=bool(flat.states) or grid is None, version=_version(prefix, real, parameters),
        equation_locals=held_numbers(equations),
        unknowns=0 if flat.unknowns is None else flat.unknowns.numel_out(0), events=flat.events,
    )  # fmt: skip
    words = _words(layout)
    if prefix in words:
        other = model_identifier(flat.name, words) if name is None else checked_identifier(name, words)
        return diagram_model(
            flat,
            name=other,
            real=real,
            derivatives=derivatives,
            tunable=tunable,
            step=step,
            substeps=substeps,
        )
    return CModel(
        name=prefix,
        sources={
            f"{prefix}.h": header_text(layout, stack_bytes(layout)),
            f"{prefix}.c": source_text(layout, f"{prefix}_equations.h"),
            f"{prefix}_equations.h": equations,
            **parts.sources,
            **runtime_sources(
                (*_RUNTIME, "pf_events.h") if flat.events else _RUNTIME, real, bool(flat.events)
            ),
        },
        symbol=f"{prefix}_model",
        states=flat.states,
        inputs=flat.inputs,
        outputs=flat.outputs,
        parameters=parameters,
        sampled_states=sampled_states,
        tasks=tuple((task.name, task.period) for task in flat.tasks),
        step=base,
        events=tuple(event.name for event in flat.events),
        depends=dependence(flat),
        remembers=flat.unknowns is not None,
        description=flat.name,
    )


def _words(layout: Layout) -> frozenset[str]:
    """Names in the model's own files, whatever it is called: none of them can be its type too."""
    other = replace(layout, name="pf_own")
    text = re.sub(
        r'/\*.*?\*/|"[^"]*"', " ", header_text(other, "0") + source_text(other, ""), flags=re.DOTALL
    )
    return frozenset(re.findall(r"[A-Za-z_]\w*", text))


class _Parts:
    """What the sampled blocks add to a model, collected one by one."""

    def __init__(self, parameters: tuple[Variable, ...]) -> None:
        self.tasks: list[TaskText] = []
        self.law_states: list[Variable] = []
        self.filter_states: list[Variable] = []
        self.parameters = list(parameters)
        self.sources: dict[str, str] = {}

    def add_law(self, flat: FlatModel, i: int, prefix: str, settled: bool) -> None:
        self.tasks.append(_law_text(flat, i, prefix, len(self.law_states), settled))
        self.law_states += [_in_block(flat.tasks[i].name, variable) for variable in flat.tasks[i].law.states]

    def add_filter(self, part: FilterTask) -> None:
        self.tasks.append(part.text)
        self.filter_states += part.states
        self.parameters += part.parameters
        self.sources |= part.source.sources


def _law_text(flat: FlatModel, i: int, prefix: str, offset: int, settled: bool) -> TaskText:
    """A sampled block that runs its law: output into its part of z, update through a copy of its states."""
    task = flat.tasks[i]
    signals = f"v{i}" if task.law.inputs else "NULL"
    call = f"(now, self->s + {offset}, {signals}, self->p_used + {task.parameters.start or 0}"
    states = len(task.law.states)
    output = checked(f"{prefix}_law_output_{i}{call}, self->z + {task.held.start or 0})")
    update = checked(f"{prefix}_law_update_{i}{call}, next{i})")
    return TaskText(
        name=task.name,
        period=task.period,
        n_v=len(task.law.inputs),
        settled=settled,
        output=output if task.law.outputs else "",
        update=update if states else "",
        commit=f"    for (int i = 0; i < {states}; i++) self->s[{offset} + i] = next{i}[i];\n"
        if states
        else "",
        declarations=f"  pf_real next{i}[{states}] = {{0}};\n" if states else "",
    )


def _in_block(block: str, variable: Variable) -> Variable:
    return replace(variable, name=f"{block}.{variable.name}")


def _base_step(flat: FlatModel, step: float | None) -> tuple[float, tuple[int, ...] | None]:
    """Seconds of one call of ``<name>_step``, and calls in each period; None where instants fall between calls."""
    if step is not None and not 0.0 < step < float("inf"):
        raise ValueError(f"step: expected a positive number of seconds, got {step!r}")
    periods = [Fraction(task.period).limit_denominator(_LONGEST_FRACTION) for task in flat.tasks]
    if not periods:
        return (_DEFAULT_STEP if step is None else float(step)), ()
    if step is None:
        denominator = lcm(*(period.denominator for period in periods))
        common = Fraction(gcd(*(int(period * denominator) for period in periods)), denominator)
        shortest = min(task.period for task in flat.tasks)
        if common < _FINEST_STEP * shortest:
            return shortest, None
        # The period itself where it is the divisor: not a digit lost to the fraction.
        step = next(
            (task.period for task in flat.tasks if Fraction(common) == periods[flat.tasks.index(task)]),
            float(common),
        )
    else:
        common = Fraction(step).limit_denominator(_LONGEST_FRACTION)
    if not common or any((period / common).denominator != 1 for period in periods):
        return float(step), None
    return float(step), tuple(int(period / common) for period in periods)


def _version(name: str, real: Real, parameters: tuple[Variable, ...]) -> int:
    """Number that changes with the names and the order of the parameters."""
    return zlib.crc32("\n".join([name, real, *(parameter.name for parameter in parameters)]).encode())
