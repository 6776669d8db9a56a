"""The C that ties one model to the FMI shell, and the shell's own files."""

from __future__ import annotations

from importlib import resources
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from ..codegen.diagram_source import runtime_sources
from .calibration import page_glue, page_source
from .clocks import as_fraction
from .description import FIRST_REFERENCE, FmuInterface

__all__ = ["SHELL", "fmi_headers", "fmu_sources", "glue_source"]

SHELL = ("pf_fmi.h", "pf_fmi.c", "pf_fmi_run.c", "pf_fmi_state.c", "pf_fmi_derivative.c", "pf_fmi_clock.c")
_FRONT = {"2.0": "pf_fmi2.c", "3.0": "pf_fmi3.c"}
_HEADERS = {
    "2.0": ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    "3.0": ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}
_RUNTIME = ("pf_ieee.h", "pf_model.h", "pf_run.h", "pf_run.c")
_VECTORS = {"local": "output"}  # where signals lie that a kind of their own describes
# Steps of the solver, or instants, within one communication step: more is a mistake in the importer's units.
_MOST_STEPS = 1e7


def fmi_headers(fmi: str) -> dict[str, str]:
    """The standard's C headers: needed to compile, not part of an FMU.

    Parameters
    ----------
    fmi : {"2.0", "3.0"}

    Raises
    ------
    RuntimeError
        If fmpy, which brings them, is not installed.
    """
    found = find_spec("fmpy")
    if found is None or found.origin is None:
        raise RuntimeError("the FMI headers come with fmpy, which is not installed: pip install fmpy")
    folder = Path(found.origin).parent / "c-code"
    return {name: (folder / name).read_text(encoding="utf-8") for name in _HEADERS[fmi]}


def fmu_sources(
    interface: FmuInterface, token: str, *, accept_bad_inputs: bool = False, xcp: bool = False
) -> dict[str, str]:
    """Everything in the folder sources: model, runtime, shell and the table between them.

    Parameters
    ----------
    interface : FmuInterface
    token : str
    accept_bad_inputs : bool
        Leave inputs that are not finite to the model (``nonfinite="hold"``).
    xcp : bool
        With a page for calibration tools.
    """
    folder = resources.files("phyfilter_ctl.fmi") / "shell"
    parts = (*SHELL, _FRONT[interface.fmi], *(["pf_fmi_xcp.c"] if xcp else []))
    shell = {name: (folder / name).read_text(encoding="utf-8") for name in parts}
    name, glue = interface.model.name, glue_source(interface, token, accept_bad_inputs=accept_bad_inputs)
    own = {f"{name}_fmu.c": page_glue(glue, name) if xcp else glue}
    if xcp:
        own[f"{name}_xcp.c"] = page_source(interface, token)
    sources = {**runtime_sources(_RUNTIME), **interface.model.sources, **shell, **own}
    return dict(sorted(sources.items()))


def glue_source(interface: FmuInterface, token: str, *, accept_bad_inputs: bool = False) -> str:
    """``<name>_fmu.c``: the table pf_fmu_here.

    Parameters
    ----------
    interface : FmuInterface
    token : str
    accept_bad_inputs : bool
    """
    model = interface.model
    variables = "\n".join(
        f"    {{PF_FMI_{_VECTORS.get(variable.kind, variable.kind).upper()}, {variable.first}, {variable.count}, "
        f"{variable.count // variable.shape[0] if variable.length else 0}}}, "
        f"/* {reference}: {_in_comment(variable.name)} */"
        for reference, variable in enumerate(interface.variables, FIRST_REFERENCE)
    )
    reason = f"\n    .why = {interface.why}," if interface.why else ""
    declared = f"const char *{interface.why}(void);\n" if interface.why else ""
    ticked = [interface.variables[i] for i in interface.of_kind("clock")]
    clocks = "".join(
        f"    {{{_quoted(clock.name)}, {period!r}, {counter}u, {resolution}u}},\n"
        for clock, (_, period) in zip(ticked, model.tasks, strict=bool(ticked))
        for counter, resolution in (as_fraction(period),)
    )
    table = f"static const pf_fmi_clock CLOCKS[] = {{\n{clocks}}};\n\n" if ticked else ""
    reason += "\n    .clocks = CLOCKS," if ticked else ""
    states = [interface.variables[i] for i in interface.of_kind("state")]
    if any(state.nominal for state in states):
        values = ", ".join(repr(state.nominal or 1.0) for state in states for _ in range(state.count))
        table += f"static const pf_real NOMINALS[] = {{{values}}};\n\n"
        reason += "\n    .nominals = NOMINALS,"
    names = ", ".join(_quoted(variable.name) for variable in model.inputs) or "0"
    counts = np.concatenate([[0], np.cumsum(interface.depends.sum(axis=1))])
    columns = [int(column) for column in np.nonzero(interface.depends)[1]] or [0]
    solver, kinds = interface.solver, []
    channels = [interface.variables[i].start for i in interface.of_kind("structure")]
    if interface.exchange:
        kinds.append("PF_FMI_MODEL_EXCHANGE")
    if interface.simulation:
        kinds.append("PF_FMI_CO_SIMULATION")
    method = "PF_RK4" if solver.method == "rk4" else "PF_ADAPTIVE"
    return f"""\
/* The FMU's variables and how they lie in the model. Generated. */
#include "pf_fmi.h"

extern const pf_model {model.symbol};
{declared}
static const pf_fmi_variable VARIABLES[] = {{
    {{PF_FMI_KINDS, 0, 0, 0}}, /* 0: no variable */
{variables}
}};

{table}static const char *const INPUTS[] = {{{names}}};

/* Rows: derivatives, outputs. Columns: states, inputs. */
static const uint32_t ROWS[] = {{{_list(counts.tolist())}}};
static const uint32_t COLUMNS[] = {{{_list(columns)}}};

const pf_fmu pf_fmu_here = {{
    .model = &{model.symbol},
    .token = "{{{token}}}",
    .kinds = {" | ".join(kinds)},
    .variables = VARIABLES,
    .n_variables = {len(interface.variables)},
    .channels = {int(channels[0][0]) if channels and channels[0] else 0},
    .most_channels = {interface.most_channels},
    .inputs = INPUTS,
    .solver = {{{method}, {solver.step!r}, {solver.rtol!r}, {solver.atol!r}, 0.0, 0}},
    .communication = {float(model.communication)!r},
    .longest_step = {_longest_step(interface)!r},
    .accept_bad_inputs = {int(accept_bad_inputs)},{reason}
    .rows = ROWS,
    .columns = COLUMNS}};
"""


def _in_comment(text: str) -> str:
    return text.replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?")


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("?", "\\?")  # ?? would be a trigraph
    return f'"{escaped}"'


def _list(numbers: list[int]) -> str:
    lines = [numbers[i : i + 24] for i in range(0, len(numbers), 24)]
    return ",\n    ".join(", ".join(str(number) for number in line) for line in lines)


def _longest_step(interface: FmuInterface) -> float:
    intervals = [period for _, period in interface.model.tasks]
    if interface.model.states and interface.solver.method == "rk4" and interface.solver.step:
        intervals.append(interface.solver.step)
    return _MOST_STEPS * min(intervals) if intervals else 1e300
