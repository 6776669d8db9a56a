"""The public C header of a flat diagram, and what both its files are made from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..blocks.functions import Variable
from ..diagram.equations import FlatEvent
from .casadi_source import Real
from .identifiers import identifiers

__all__ = ["Layout", "TaskText", "checked", "header_text", "in_comment", "in_string", "number", "room"]


@dataclass(frozen=True)
class TaskText:
    """What one sampled block adds to the C text; statements see self, now, x, u, status and its own v<i>."""

    name: str
    period: float
    n_v: int
    settled: bool
    output: str
    update: str
    commit: str
    declarations: str = ""
    member: str = ""
    init: str = ""
    states: str = ""
    check: str = ""
    put_in_force: str = ""
    include: str = ""
    undo: tuple[str, str, str] | None = None  # array that keeps what it changes: declaration, name, place
    moving: str = ""  # bytes of that, as C
    can_fail: bool = False
    stack: int = 0  # bytes that what it calls takes


@dataclass(frozen=True)
class Layout:
    """All that the texts need to know of a model."""

    name: str
    real: Real
    description: str
    states: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    parameters: tuple[Variable, ...]
    held: tuple[Variable, ...]
    sampled_states: tuple[Variable, ...]
    law_states: tuple[Variable, ...]
    tasks: tuple[TaskText, ...]
    derivatives: bool
    can_fail: bool
    step: float
    substeps: int
    between: bool
    version: int
    grid: tuple[int, ...] | None = None  # steps in each period; None: instants fall between them
    newton: bool = False
    timed: frozenset[str] = frozenset()  # equations that read time
    equation_locals: int = 0  # numbers that the largest of them holds at once
    unknowns: int = 0
    events: tuple[FlatEvent, ...] = ()

    @property
    def capital(self) -> str:
        return self.name.upper()


def number(value: float, real: Real) -> str:
    """A constant of C that reads back as the same number.

    Examples
    --------
    >>> number(0.1, "double"), number(2.0, "float"), number(float("-inf"), "double")
    ('0.1', '2.0f', '-INFINITY')
    """
    if value != value:
        return "NAN"
    if value in (float("inf"), float("-inf")):
        return "INFINITY" if value > 0 else "-INFINITY"
    return repr(float(value)) + ("f" if real == "float" else "")


def checked(call: str) -> str:
    """A call whose failure ends the function that it stands in."""
    return f"    status = {call};\n    if (status) return status;\n"


def room(entries: Sequence[object]) -> int:
    """Length of the array that holds them: C has none of length 0."""
    return max(len(entries), 1)


def in_string(text: str) -> str:
    """Text as it may stand between the quotation marks of a C string."""
    plain = text.encode("ascii", "replace").decode().replace("\\", "\\\\").replace('"', '\\"')
    return " ".join(plain.split()).replace("??", "? ?")


def in_comment(text: str) -> str:
    """Text as it may stand in a C comment."""
    return " ".join(text.replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?").split())


def _enum(layout: Layout, kind: str, variables: tuple[Variable, ...]) -> str:
    """Indices of one vector, a line per signal with its unit."""
    if not variables:
        return ""
    names = identifiers(variable.name for variable in variables)
    lines = []
    for index, (variable, name) in enumerate(zip(variables, names, strict=True)):
        facts = [variable.name, variable.unit or "-", f"{variable.start:g}", variable.description]
        note = in_comment(", ".join(fact for fact in facts if fact))
        lines.append(f"  {layout.capital}_{kind}_{name.upper()} = {index}, /* {note} */")
    lines[-1] = lines[-1].replace(", /*", " /*", 1)
    return "enum {\n" + "\n".join(lines) + "\n};\n"


def _event_members(layout: Layout) -> str:
    return f"  pf_events events;\n  pf_side sides[{len(layout.events)}];\n" if layout.events else ""


def header_text(layout: Layout, stack: str) -> str:
    """The public header ``<name>.h``; ``stack`` is the C expression of the bytes that a step takes."""
    name, capital = layout.name, layout.capital
    sizes = {
        "N_X": layout.states, "N_U": layout.inputs, "N_Y": layout.outputs, "N_P": layout.parameters,
        "N_S": layout.sampled_states, "N_TASKS": layout.tasks,
    }  # fmt: skip
    enums = [
        ("x: states", _enum(layout, "X", layout.states)),
        ("u: inputs", _enum(layout, "U", layout.inputs)),
        ("y: outputs", _enum(layout, "Y", layout.outputs)),
        ("p: parameters", _enum(layout, "P", layout.parameters)),
        ("s: states of the sampled blocks", _enum(layout, "S", layout.sampled_states)),
    ]
    described = "".join(f"/* {title}; name, unit, start */\n{text}\n" for title, text in enums if text)
    tasks = "".join(f" *   {in_comment(task.name)}: every {task.period:.9g} s\n" for task in layout.tasks)
    members = "".join(f"  {task.member}\n" for task in layout.tasks if task.member)
    includes = "".join(dict.fromkeys(task.include for task in layout.tasks if task.include))
    called = f" Called {name} here." if layout.description != name else ""
    return f"""\
/* {in_comment(layout.description)}
 *{called}
 * {len(layout.states)} states, {len(layout.inputs)} inputs, {len(layout.outputs)} outputs; SI units, rad/s.
{" * Sampled blocks, in the order in which they run:" + chr(10) + tasks if tasks else ""} */
#ifndef {capital}_H
#define {capital}_H
#include <stdint.h>

#include "pf_model.h"
{includes}
#ifdef __cplusplus
extern "C" {{
#endif

/* pf_real of an export in another precision that was included before this: keep the two in files of their own. */
typedef char {name}_needs_pf_real_to_be_{layout.real}[sizeof(pf_real) == sizeof({layout.real}) ? 1 : -1];

enum {{
{chr(10).join(f"  {capital}_{key} = {len(value)}," for key, value in sizes.items()).rstrip(",")}
}};

{described}/* The whole state: copy it to save it. Only the functions below and {name}_model write to it. */
typedef struct {{
  pf_time start; /* of the run */
  int64_t steps; /* of {name}_step so far */
  int64_t ticks[{room(layout.tasks)}]; /* instants of each sampled block so far */
  pf_real x[{room(layout.states)}], u[{room(layout.inputs)}];
  pf_real p[{room(layout.parameters)}], p_used[{room(layout.parameters)}]; /* as set, and in force */
  pf_real z[{room(layout.held)}]; /* outputs of the sampled blocks, held; unknowns of algebraic loops */
  pf_real s[{room(layout.law_states)}]; /* states of the sampled blocks */
{_event_members(layout)}{members}}} {name};

extern const pf_model {name}_model;

#define {capital}_STEP {number(layout.step, "double")} /* s, between two calls of {name}_step */

/* Bytes of stack that {name}_step takes at most, on a core of 32 bits and optimised (-O1 to -O3, -Os). Functions of
 * <math.h> come on top. */
#define {capital}_STACK_BYTES ({stack})

int {name}_init(void *self); /* start values; t = 0. Not PF_OK: do not run it, see pf_ieee.h */
int {name}_reset({name} *self); /* the same, parameters kept */

/* One period: takes the inputs u (n_u) at the present time, runs the sampled blocks that are due, writes the outputs
 * y (n_y) of the present time, and goes on to the next one, {capital}_STEP later, with u held. PF_OK, or the state is
 * as before the call. */
int {name}_step({name} *self, const pf_real *u, pf_real *y);

/* Sets the states of the sampled blocks; those of a PhyFilter are left as they are. */
void {name}_set_states({name} *self, const pf_real *s);

#define {capital}_PARAMETERS_VERSION 0x{layout.version:08x}u /* of their names and order */

typedef struct {{
  uint32_t version, crc; /* {name}_seal fills them: CRC-32 of p */
  pf_real p[{room(layout.parameters)}];
}} {name}_parameters;

void {name}_seal({name}_parameters *parameters);

/* Puts parameters in force, all or none: NULL, or why they are refused. */
const char *{name}_set_parameters({name} *self, const {name}_parameters *parameters);

#ifdef __cplusplus
}}
#endif
#endif
"""
