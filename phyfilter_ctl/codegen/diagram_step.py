"""``<name>_step`` of a flat diagram: one period, on integer ticks wherever nothing asks for more."""

from __future__ import annotations

import re

from .diagram_header import Layout, number

__all__ = ["held_numbers", "stack_bytes", "step_text"]

_SIZES = {"float": 4, "double": 8}
# Measured with gcc 12 on a Cortex-M4F: return addresses and registers of the step and of what runs the blocks; of the
# double arithmetic of a library; of pf_run.c, and of what finds events; and of a Newton iteration.
_FRAMES, _SOFT_DOUBLE, _RUN, _FIND_EVENTS, _NEWTON = 128, 64, 560, 640, 256
_DECLARED = re.compile(r"^  (?:const )?(?:pf_real|pf_time|casadi_real|int) ([^;={(]+)[;=]", re.M)
_NESTED = re.compile(r"^static int casadi_f\d+\(", re.M)
_LENGTH = re.compile(r"\[(\d+)\]")


def held_numbers(equations: str) -> int:
    """Numbers that the functions of a text hold at once: of the largest, or of all where they call each other.

    Parameters
    ----------
    equations : str
        As of :func:`phyfilter_ctl.codegen.casadi_source.casadi_header`.

    Returns
    -------
    int

    Examples
    --------
    >>> held_numbers("static int f(void) {\\n  pf_real a0, w[3];\\n}\\nint g(void) {\\n  pf_real a0;\\n}\\n")
    4
    """
    counts = [0]
    for function in equations.split("\n}\n"):
        entries = [entry for found in _DECLARED.findall(function) for entry in found.split(",")]
        lengths = [_LENGTH.search(entry) for entry in entries]
        counts.append(sum(int(length.group(1)) if length else 1 for length in lengths))
    return sum(counts) if _NESTED.search(equations) else max(counts)


def stack_bytes(layout: Layout) -> str:
    """C expression of the bytes of stack that a step takes at most on a core of 32 bits.

    Parameters
    ----------
    layout : Layout

    Returns
    -------
    str
    """
    n_x = len(layout.states)
    kept: list[str]
    reals = sum(task.n_v for task in layout.tasks) + len(layout.law_states) + 2 * layout.equation_locals
    total = _FRAMES + max((task.stack for task in layout.tasks), default=0) + 4 * len(layout.tasks)
    total += _SOFT_DOUBLE if layout.real == "double" or layout.timed else 0
    total += _NEWTON if layout.newton else 0
    if _on_grid(layout):
        reals += (4 if layout.substeps > 1 else 3) * n_x
        kept = []
        if _undoes(layout):
            reals += len(layout.held) + len(layout.law_states)
            kept = [task.moving for task in layout.tasks if task.moving]
    else:
        reals += _work(layout)
        total += _RUN + (_FIND_EVENTS if layout.events else 0)
        kept = [f"{2 if layout.can_fail else 1} * sizeof({layout.name})"]
    return " + ".join([str(total + _SIZES[layout.real] * reals), *kept])


def step_text(layout: Layout) -> str:
    """The step and what only it needs.

    Parameters
    ----------
    layout : Layout

    Returns
    -------
    str

    Notes
    -----
    Where every instant falls on a call, and there are neither events nor Newton iterations, integers tell what is due,
    time is computed where an equation reads it, and no more is kept than what a failure after its change would have to
    undo. Elsewhere pf_run.c goes from call to call, and a copy of the state is kept.
    """
    return _on_ticks(layout) if _on_grid(layout) else _on_time(layout)


def _on_grid(layout: Layout) -> bool:
    return layout.grid is not None and not (layout.newton or layout.events or layout.unknowns)


def _undoes(layout: Layout) -> bool:
    return bool(layout.tasks) and (bool(layout.states) or layout.can_fail)


def _on_ticks(layout: Layout) -> str:
    name, n_x, dynamic = layout.name, len(layout.states), bool(layout.states)
    saved = _saved(layout) if _undoes(layout) else []
    keep = "".join(
        f"  {declaration}\n  memcpy({local}, {place}, sizeof {local});\n"
        for declaration, local, place in saved
    )
    put_back = "".join(f"    memcpy({place}, {local}, sizeof {local});\n" for _, local, place in saved)
    fails = dynamic or any(task.can_fail for task in layout.tasks)
    lines = [
        f"int {name}_step({name} *self, const pf_real *u, pf_real *y) {{",
        *(["  int status = PF_OK;"] if fails else []),
        *([f"  pf_real x[{n_x}];"] if dynamic else []),
        *_times(layout),
        *([keep.rstrip()] if keep else []),
        *_sampled(layout, fails),
        *([f"  if (!status) status = advance(self, u, {_ends(layout)}, x);"] if dynamic else []),
        *(
            ["  if (status) {", *([put_back.rstrip()] if put_back else []), "    return status;", "  }"]
            if fails
            else []
        ),
        f"  for (int i = 0; i < {layout.capital}_N_U; i++) self->u[i] = u[i];",
        *_outputs(layout),
        *(["  memcpy(self->x, x, sizeof x);"] if dynamic else []),
        *_counted(layout),
        "  return PF_OK;",
        "}",
    ]
    return (_advance(layout) if dynamic else "") + "\n".join(lines) + "\n"


def _saved(layout: Layout) -> list[tuple[str, str, str]]:
    """What the sampled blocks change: declaration, local name, place."""
    found = []
    if layout.held:
        found.append((f"pf_real z[{len(layout.held)}];", "z", "self->z"))
    if layout.law_states and layout.states:
        found.append((f"pf_real s[{len(layout.law_states)}];", "s", "self->s"))
    return found + [task.undo for task in layout.tasks if task.undo]


def _timed(layout: Layout, *functions: str) -> bool:
    return any(name.startswith(functions) for name in layout.timed)


def _exact(layout: Layout) -> bool:
    """Steps are differences of times, to the last digit those of a run in pf_run.c."""
    return bool(layout.states) and layout.real == "double"


def _times(layout: Layout) -> list[str]:
    lines = []
    if _exact(layout) or _timed(layout, "dynamics", "output"):
        lines += [f"  const pf_time t = (pf_time)self->steps * {layout.capital}_STEP;"]
    if layout.tasks and _timed(layout, "signals", "law"):
        count = len(layout.tasks)
        lines += [
            f"  const int first = pf_earliest(0, self->ticks, PERIODS, {count});",
            "  const pf_time now = self->steps ? pf_instant(0, self->ticks, PERIODS, first) : 0;",
        ]
    return lines


def _ends(layout: Layout) -> str:
    if _exact(layout) or _timed(layout, "dynamics"):
        return f"t, (pf_time)(self->steps + 1) * {layout.capital}_STEP"
    return "0, 0"


def _sampled(layout: Layout, fails: bool) -> list[str]:
    if not layout.tasks:
        return []
    assert layout.grid is not None
    due = ", ".join(
        "1" if ticks == 1 else f"!self->steps || self->ticks[{i}] * {ticks} == self->steps"
        for i, ticks in enumerate(layout.grid)
    )
    now = "&now" if _timed(layout, "signals", "law") else "NULL"
    call = f"take(self, due, {now}, self->x, u);"
    return [f"  const int due[] = {{{due}}};", f"  status = {call}" if fails else f"  (void){call}"]


def _outputs(layout: Layout) -> list[str]:
    if not layout.outputs:
        return ["  (void)y;"]
    t = "&t" if _timed(layout, "output") else "NULL"
    return [f"  (void){layout.name}_output({t}, self->x, self->u, self->p_used, self->z, y);"]


def _counted(layout: Layout) -> list[str]:
    assert layout.grid is not None
    ticks = [
        f"  self->ticks[{i}] = self->steps + 1;"
        if ticks == 1
        else f"  if (due[{i}]) self->ticks[{i}] = self->steps ? self->ticks[{i}] + 1 : 1;"
        for i, ticks in enumerate(layout.grid)
    ]
    return [*(["  self->start = 0;"] if ticks else []), *ticks, "  self->steps++;"]


def _advance(layout: Layout) -> str:
    name, n_x, substeps = layout.name, len(layout.states), layout.substeps
    t = "&t" if _timed(layout, "dynamics") else "NULL"
    slope = f"""\
typedef struct {{
  const {name} *self;
  const pf_real *u;
}} held_inputs;

static int slope(const void *of, pf_time t, const pf_real *x, pf_real *dx) {{
  const held_inputs *const held = (const held_inputs *)of;
  const {name} *const self = held->self;
  (void)t;
  (void){name}_dynamics({t}, x, held->u, self->p_used, self->z, dx);
  return PF_OK;
}}

"""
    h = (
        "(pf_real)(next - t)"
        if layout.real == "double"
        else f"(pf_real)({layout.capital}_STEP{f' / {substeps}' if substeps > 1 else ''})"
    )
    opening = f"""\
/* x becomes the state at t_end, {substeps} step{"s"[: substeps - 1]} of Runge-Kutta later. */
static int advance(const {name} *self, const pf_real *u, pf_time t, pf_time t_end, pf_real *x) {{
  const held_inputs held = {{self, u}};
"""
    if substeps == 1:
        return f"""{slope}{opening}\
  const pf_time next = t_end;
  pf_real k[{n_x}], sum[{n_x}];
  return pf_rk4_(slope, &held, {n_x}, t, next, {h}, self->x, k, sum, x);
}}

"""
    return f"""{slope}{opening}\
  const pf_time begin = t;
  pf_real k[{n_x}], sum[{n_x}], from[{n_x}];
  memcpy(from, self->x, sizeof from);
  for (int i = 1;; i++) {{
    const pf_time next = i == {substeps} ? t_end : begin + (t_end - begin) * (pf_time)i / {number(substeps, "double")};
    const int status = pf_rk4_(slope, &held, {n_x}, t, next, {h}, from, k, sum, x);
    if (status || i == {substeps}) return status;
    memcpy(from, x, sizeof from);
    t = next;
  }}
}}

"""


def _on_time(layout: Layout) -> str:
    name, capital = layout.name, layout.capital
    if layout.between:
        going_on = f"""\
  if (!status) {{
    pf_real work[{_work(layout)}];
    pf_solver solver = {{PF_RK4, {capital}_STEP / {layout.substeps}, 0, 0, 0, 0}};
    pf_time reached;
    const pf_time end = (pf_time)(self->steps + 1) * {capital}_STEP;
    status = pf_approach(&{name}_model, self, work, &solver, t, end, NULL, &reached);
  }}
"""
        catch_up = f"status = pf_catch_up(&{name}_model, self, t - {capital}_STEP, t);"
    else:
        going_on = ""
        catch_up = f"""\
for (const pf_time limit = t + PF_COINCIDENT * {capital}_STEP; !status && next_instant(self) <= limit;)
      status = sample(self, limit, self->x);"""
    return f"""\
int {name}_step({name} *self, const pf_real *u, pf_real *y) {{
  const pf_time t = (pf_time)self->steps * {capital}_STEP;
  const {name} before = *self;
  int status = PF_OK;
  for (int i = 0; i < {capital}_N_U; i++) self->u[i] = u[i];
  if (self->steps == 0)
    status = start(self, 0);
  else
    {catch_up}
  if (!status) status = outputs(self, t, self->x, y);
{going_on}  if (status) {{
    *self = before;
    return status;
  }}
  self->steps++;
  return PF_OK;
}}
"""


def _work(layout: Layout) -> int:
    """pf_work_reals of the model."""
    states, events = len(layout.states), len(layout.events)
    return 8 * states + len(layout.inputs) + 1 + (4 * states + 5 * events if events else 0)
