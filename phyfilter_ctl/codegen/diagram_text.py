"""The C file of a flat diagram: the table pf_model and all behind it."""

from __future__ import annotations

from ..blocks.functions import Variable
from .casadi_source import Real
from .diagram_header import Layout, checked, in_comment, in_string, number, room
from .diagram_step import step_text

__all__ = ["source_text"]


def _initial(variables: tuple[Variable, ...], real: Real) -> str:
    return (
        "{" + ", ".join(number(variable.start, real) for variable in variables) + "}" if variables else "{0}"
    )


def _table(layout: Layout) -> str:
    name = layout.name
    products = ("directional", "adjoint")
    entries = [
        f'"{name}"', f"sizeof({name})",
        *(f"{layout.capital}_{key}" for key in ("N_X", "N_U", "N_Y", "N_P", "N_S", "N_TASKS")), "0",
        f"{name}_init", "states", "inputs", "parameters", "sampled_states", "apply", "start", "derivatives", "outputs",
        "next_instant", "sample", "NULL", *(product if layout.derivatives else "NULL" for product in products),
        "accepted" if layout.unknowns else "NULL", "&EVENTS" if layout.events else "NULL",
    ]  # fmt: skip
    lines, line = [], "   "
    for entry in entries:
        if len(line) + len(entry) > 106:
            lines.append(line)
            line = "   "
        line += f" {entry},"
    return f"const pf_model {name}_model = {{\n" + "\n".join([*lines, line.rstrip(",")]) + "\n};\n"


def _accepted(layout: Layout) -> str:
    if not layout.unknowns:
        return ""
    name = layout.name
    return f"""
static void accepted(void *instance, pf_time t) {{
  {name} *const self = ({name} *)instance;
  pf_real found[{layout.unknowns}], sum = 0;
  if ({name}_unknowns(&t, self->x, self->u, self->p_used, self->z, found)) return;
  for (int i = 0; i < {layout.unknowns}; i++) sum += found[i] - found[i];
  if (sum == 0) memcpy(self->z + {len(layout.held) - layout.unknowns}, found, sizeof found);
}}
"""


def _events(layout: Layout) -> str:
    if not layout.events:
        return ""
    name = layout.name
    opening = f"  {name} *const self = ({name} *)instance;\n"
    cases = "".join(
        f"    case {i}: /* {in_comment(event.name)} */\n"
        f"      status = {name}_event_{i}(&t, x, self->u, self->p_used, self->z, after);\n      break;\n"
        for i, event in enumerate(layout.events)
        if event.reset is not None
    )
    resets = (
        f"""\
{opening}  pf_real after[{room(layout.states)}];
  int status = PF_OK;
  switch (event) {{
{cases}    default:
      (void)t;
      return PF_OK;
  }}
  if (!status) memcpy(x, after, sizeof after);
  return status;
"""
        if cases
        else "  (void)instance;\n  (void)t;\n  (void)event;\n  (void)x;\n  return PF_OK;\n"
    )
    directions = ", ".join(str(event.direction) for event in layout.events)
    return f"""
static const signed char DIRECTIONS[] = {{{directions}}};

static pf_events *event_clock(void *self) {{ return &(({name} *)self)->events; }}
static pf_side *event_sides(void *self) {{ return (({name} *)self)->sides; }}

static int conditions(void *instance, pf_time t, const pf_real *x, pf_real *g) {{
{opening}  return {name}_conditions(&t, x, self->u, self->p_used, self->z, g);
}}

static int event_reset(void *instance, pf_time t, int event, pf_real *x) {{
{resets}}}

static const pf_event_table EVENTS = {{
    {len(layout.events)}, DIRECTIONS, event_clock, event_sides, conditions, event_reset}};
"""


def _sample(layout: Layout) -> str:
    begin = "  accepted(instance, t);\n" if layout.unknowns else ""
    begin += (
        "  memset(event_clock(instance), 0, sizeof(pf_events)); /* sides are those of the start */\n"
        if layout.events
        else ""
    )
    if not layout.tasks:
        return (
            f"""\
static int start(void *instance, pf_time t) {{
  (void)instance;
  (void)t;
{begin}  return PF_OK;
}}
"""
            + """
static pf_time next_instant(const void *instance) {
  (void)instance;
  return PF_NEVER;
}

static int sample(void *instance, pf_time t, const pf_real *x) {
  (void)instance;
  (void)t;
  (void)x;
  return PF_OK;
}
"""
        )
    name, count = layout.name, len(layout.tasks)
    save = f"  const {name} before = *self;\n" if layout.can_fail else ""
    restore = "*self = before;\n    " if layout.can_fail else ""
    periods = ", ".join(number(task.period, "double") for task in layout.tasks)
    return f"""\
#include "pf_ieee.h" /* a table follows */
static const pf_time PERIODS[] = {{{periods}}}; /* s */

static pf_time next_instant(const void *instance) {{
  const {name} *const self = (const {name} *)instance;
  const int first = pf_earliest(self->start, self->ticks, PERIODS, {count});
  return pf_instant(self->start, self->ticks, PERIODS, first);
}}

{_take(layout)}
static int sample(void *instance, pf_time t, const pf_real *x) {{
  {name} *const self = ({name} *)instance;
  const pf_time now = next_instant(self);
  int due[{count}], status;
  if (!pf_due(self->start, self->ticks, PERIODS, {count}, t, due)) return PF_OK;
{save}  status = take(self, due, &now, x, self->u);
  if (status) {{
    {restore}return status;
  }}
  for (int i = 0; i < {count}; i++) self->ticks[i] += due[i];
  return PF_OK;
}}

static int start(void *instance, pf_time t) {{
  {name} *const self = ({name} *)instance;
  self->start = t;
  for (int i = 0; i < {count}; i++) self->ticks[i] = 0;
{begin}  return sample(self, t, self->x);
}}
"""


_FILTER_STATUS = """\
static int filter_status(int code) {
  if (!code) return PF_OK;
  return code == PF_FILTER_NOT_FINITE ? PF_NOT_FINITE : PF_UNUSABLE;
}

"""


def _take(layout: Layout) -> str:
    """All that are due put out first, each on what those before it put out; then all take over what they have seen."""
    name = layout.name
    outputs, updates, commits, variables = [], [], [], []
    for i, task in enumerate(layout.tasks):
        signals = checked(f"{name}_signals_{i}(now, x, u, self->p_used, self->z, v{i})") if task.n_v else ""
        variables.append(f"  const int due{i} = due[{i}];\n")
        variables.append((f"  pf_real v{i}[{task.n_v}];\n" if task.n_v else "") + task.declarations)
        opening = f"  if (due{i}) {{ /* {in_comment(task.name)} */\n"
        outputs.append(f"{opening}{signals}{task.output}  }}\n" if signals or task.output else "")
        if task.update:
            updates.append(f"{opening}{'' if task.settled else signals}{task.update}  }}\n")
        if task.commit:
            commits.append(f"  if (due{i}) {{\n{task.commit}  }}\n")
    status = _FILTER_STATUS if any(task.can_fail for task in layout.tasks) else ""
    checks = any("status" in part for part in outputs + updates)
    return f"""\
{status}/* All that are due put out first, each on what those before it put out; then all take over what they have seen.
 * What has changed by then stays where one fails. */
static int take({name} *self, const int *due, const pf_time *now, const pf_real *x, const pf_real *u) {{
{"  int status;" + chr(10) if checks else ""}{"".join(variables)}  (void)now;
  (void)x;
  (void)u;
{"".join(outputs)}{"".join(updates)}{"".join(commits)}  return PF_OK;
}}
"""


def _evaluations(layout: Layout) -> str:
    name = layout.name

    def evaluation(function: str, equation: str, result: str, present: bool) -> str:
        if not present:
            body = f"  (void)instance;\n  (void)t;\n  (void)x;\n  (void){result};\n  return PF_OK;\n"
        else:
            body = (
                f"  const {name} *const self = (const {name} *)instance;\n"
                f"  return {name}_{equation}(&t, x, self->u, self->p_used, self->z, {result});\n"
            )
        return f"static int {function}(void *instance, pf_time t, const pf_real *x, pf_real *{result}) {{\n{body}}}\n"

    text = evaluation("derivatives", "dynamics", "dx", bool(layout.states))
    text += "\n" + evaluation("outputs", "output", "y", bool(layout.outputs))
    if layout.derivatives:
        point = "&t, self->x, self->u, self->p_used, self->z"
        opening = f"  const {name} *const self = (const {name} *)instance;\n"
        text += f"""
static int directional(void *instance, pf_time t, const pf_real *seed_x, const pf_real *seed_u, const pf_real *seed_p,
                       pf_real *dx, pf_real *y) {{
{opening}  return {name}_directional({point}, seed_x, seed_u, seed_p, dx, y);
}}

static int adjoint(void *instance, pf_time t, const pf_real *seed_dx, const pf_real *seed_y, pf_real *x, pf_real *u,
                   pf_real *p) {{
{opening}  for (int i = 0; i < {layout.capital}_N_P; i++) p[i] = 0; /* those of filters stay so */
  return {name}_adjoint({point}, seed_dx, seed_y, x, u, p);
}}
"""
    return text


def _parameters(layout: Layout) -> str:
    name = layout.name
    checks = "".join(task.check for task in layout.tasks)
    commits = "".join(task.put_in_force for task in layout.tasks)
    if not layout.parameters:
        return (
            "static const char *apply(void *instance) {\n  (void)instance;\n  return NULL;\n}\n"
            + _set_parameters(name, layout.capital)
        )
    messages = ",\n".join(
        f'    "{in_string(variable.name)} is not a number"' for variable in layout.parameters
    )
    return f"""\
static const char *const NOT_A_NUMBER[] = {{
{messages}}};

static const char *apply(void *instance) {{
  {name} *const self = ({name} *)instance;
  const char *refusal = NULL;
  for (int i = {layout.capital}_N_P - 1; i >= 0; i--)
    if (self->p[i] != self->p[i]) refusal = NOT_A_NUMBER[i];
{checks}  if (refusal) {{
    memcpy(self->p, self->p_used, sizeof self->p);
    return refusal;
  }}
{commits}  memcpy(self->p_used, self->p, sizeof self->p);
  return NULL;
}}

{_set_parameters(name, layout.capital)}"""


def _set_parameters(name: str, capital: str) -> str:
    return f"""
void {name}_seal({name}_parameters *parameters) {{
  parameters->version = {capital}_PARAMETERS_VERSION;
  parameters->crc = pf_crc32(parameters->p, sizeof parameters->p);
}}

const char *{name}_set_parameters({name} *self, const {name}_parameters *parameters) {{
  if (parameters->version != {capital}_PARAMETERS_VERSION) return "parameters of another version of {name}";
  if (parameters->crc != pf_crc32(parameters->p, sizeof parameters->p)) return "parameters damaged: CRC-32 differs";
  memcpy(self->p, parameters->p, sizeof self->p);
  return apply(self);
}}
"""


def source_text(layout: Layout, equations: str) -> str:
    """The file ``<name>.c``: the table and all behind it; ``equations`` is the name of the included file."""
    name = layout.name
    real = layout.real
    inits = "".join(task.init for task in layout.tasks)
    law_states = len(layout.law_states)
    copies = f"  for (int i = 0; i < {law_states}; i++) *s++ = self->s[i];\n" if law_states else ""
    copies += "".join(task.states for task in layout.tasks)
    write = f"  for (int i = 0; i < {law_states}; i++) self->s[i] = s[i];\n" if law_states else ""
    set_unread = "" if law_states else "  (void)self;\n  (void)s;\n"
    copy_unread = "" if copies else "  (void)self;\n  (void)s;\n"
    return f"""\
/* {in_comment(layout.description)}. Generated. */
#include "pf_ieee.h"

#include "{name}.h"

#include <math.h>
#include <string.h>

#include "{equations}"
#include "pf_crc.h"
#include "pf_instants.h"
{'#include "pf_run.h"' + chr(10) if layout.between else ""}
#include "pf_ieee.h" /* a table follows */
static const {name} INITIAL = {{
    .start = PF_NEVER,
    .x = {_initial(layout.states, real)},
    .u = {_initial(layout.inputs, real)},
    .p = {_initial(layout.parameters, real)},
    .p_used = {_initial(layout.parameters, real)},
    .z = {_initial(layout.held, real)},
    .s = {_initial(layout.law_states, real)}}};

int {name}_init(void *instance) {{
  {name} *const self = ({name} *)instance;
  int refused = !pf_ieee_holds_();
  memcpy(self, &INITIAL, sizeof INITIAL);
{inits}  return refused ? PF_UNUSABLE : PF_OK;
}}

static pf_real *states(void *self) {{ return (({name} *)self)->x; }}
static pf_real *inputs(void *self) {{ return (({name} *)self)->u; }}
static pf_real *parameters(void *self) {{ return (({name} *)self)->p; }}

static void sampled_states(const void *instance, pf_real *s) {{
  const {name} *const self = (const {name} *)instance;
{copy_unread}{copies}}}

void {name}_set_states({name} *self, const pf_real *s) {{
{set_unread}{write}}}

{_evaluations(layout)}{_accepted(layout)}{_events(layout)}
{_sample(layout)}
{_parameters(layout)}
int {name}_reset({name} *self) {{
  int status;
  pf_real kept[{room(layout.parameters)}];
  memcpy(kept, self->p_used, sizeof kept);
  status = {name}_init(self);
  memcpy(self->p, kept, sizeof kept);
  return status || apply(self) ? PF_UNUSABLE : PF_OK;
}}

{_table(layout)}
{step_text(layout)}"""
