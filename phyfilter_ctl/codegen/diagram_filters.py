"""Sampled PhyFilters of a diagram in its C code: the project's own filter instead of the traced law."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf

from ..blocks.functions import Variable
from ..blocks.sampled import FilterLaw
from ..diagram.model import Task
from ..filter import SampledPhyFilter
from .casadi_source import Real
from .diagram_header import TaskText, checked, in_comment, in_string
from .filter_code import LEAST, FilterSource, filter_source

__all__ = ["FilterTask", "filter_task"]

_CODE = {
    "PF_FILTER_NOT_HURWITZ": "D is not Hurwitz: a pole on or right of the imaginary axis",
    "PF_FILTER_STEP": "forward Euler diverges with these coefficients: |1 + p h| >= 1",
}


@dataclass(frozen=True, eq=False)
class FilterTask:
    """A sampled PhyFilter of a diagram as C.

    Parameters
    ----------
    source : FilterSource
    text : TaskText
    states : tuple of Variable
        w of its sections.
    parameters : tuple of Variable
        a, b and limits, which join those of the diagram.
    """

    source: FilterSource
    text: TaskText
    states: tuple[Variable, ...]
    parameters: tuple[Variable, ...]


def filter_task(
    task: Task,
    law: FilterLaw,
    *,
    name: str,
    number: int,
    parameter: int,
    settled: bool,
    real: Real,
    tunable: bool,
) -> FilterTask:
    """What a sampled PhyFilter adds to the C code of its diagram.

    Parameters
    ----------
    task : Task
        Whose inputs are x, g, f_theta and M, as of :func:`phyfilter_ctl.blocks.law.filter_law`.
    law : FilterLaw
    name : str
        C name of the filter.
    number : int
        Of the task.
    parameter : int
        Index of its first parameter in p.
    settled : bool
        Whether the inputs it put out on are final.
    real : {"double", "float"}
        In float the filter is float too; in double it has its own precision.
    tunable : bool
        Whether a, b and the limits become parameters.

    Returns
    -------
    FilterTask
    """
    sampled = law.sampled
    if real == "float":
        sampled = SampledPhyFilter(sampled.filters, replace(sampled.sampling, precision="float32"))
    source = filter_source(
        sampled,
        law.channels,
        name=name,
        inertia=law.inertia,
        variable=False,
        tunable=tunable,
        fixed=not tunable,
    )
    n_x, n_f, z = law.channels, source.n_f, task.held.start or 0
    member = f"filter_{number}"
    states = [
        Variable(f"{task.name}.w[{i},{j}]", description="state of a section")
        for i in range(n_f)
        for j in range(source.orders[i if len(source.orders) > 1 else 0])
    ]
    parameters = _parameters(task, source) if tunable else ()
    given = f"v{number}" if source.real == real else f"in{number}"
    n_learned = n_f if law.f_theta else 0
    learned = f"{given} + {2 * n_x}" if law.f_theta else f"no_model{number}"
    inertia = f"{given} + {2 * n_x + n_learned}" if source.inertia_entries else "NULL"
    n_v = len(task.law.inputs)
    signals = f"{given}, {given} + {n_x}, {learned}, {inertia}"
    moving = f"sizeof({name})" if source.fixed else f"offsetof({name}, rate)"
    call = f"filter_status({name}_output(&self->{member}, {signals}, "
    if source.real == real:
        output, copy, declarations = checked(f"{call}self->z + {z}))"), "", ""
    else:
        copy = f"    for (int i = 0; i < {n_v}; i++) in{number}[i] = ({name}_real)v{number}[i];\n"
        declarations = f"  {name}_real in{number}[{n_v}], out{number}[{n_f}];\n"
        output = copy + checked(f"{call}out{number}))")
        output += f"    for (int i = 0; i < {n_f}; i++) self->z[{z} + i] = (pf_real)out{number}[i];\n"
    if not law.f_theta:
        declarations += f"  static const {name}_real no_model{number}[{n_f}] = {{0}};\n"
    remember = f"{copy}    {name}_remember(&self->{member}, {given} + {n_x});\n"
    text = TaskText(
        name=task.name,
        period=task.period,
        n_v=n_v,
        settled=settled,
        output=output,
        update=remember if sampled.sampling.g == "hold" else "",
        commit="",
        declarations=declarations,
        member=f"{name} {member}; /* {in_comment(task.name)} */",
        init=f"  refused |= {name}_init(&self->{member}, &{name}_parameters);\n",
        states=_copies(source, member),
        check=_check(task, source, member, number, parameter) if parameters else "",
        put_in_force=f"  self->{member} = trial{number};\n" if parameters else "",
        include=f'#include "{name}.h"\n',
        undo=(
            f"{name}_real {member}[{moving} / sizeof({name}_real)];",
            member,
            f"&self->{member}",
        ),
        moving=moving,
        can_fail=True,
        stack=_stack(source),
    )
    return FilterTask(source, text, tuple(states), parameters)


def _stack(source: FilterSource) -> int:
    """Bytes of stack of a sample at most, measured with gcc 12 on a Cortex-M4F."""
    sampling = source.sampled.sampling
    late = sampling.nonfinite == "hold" or sampling.delay > 0.0
    frames = (
        128 + 96 * late + 2816 * (sampling.nonfinite == "hold")
    )  # a gap needs the transition over its length
    reals = source.n_f * (2 * source.sampled.order + 8) + 4 * source.n_x + 3 * source.inertia_entries
    return frames + (4 if source.real == "float" else 8) * reals


def _parameters(task: Task, source: FilterSource) -> tuple[Variable, ...]:
    """a of all filters, then b, then the limits of f_hat and of g."""
    found: list[Variable] = []
    for letter, text in (("a", "denominator of F"), ("b", "numerator of F")):
        for i, entry in enumerate(source.sampled.realised):
            values = entry.a if letter == "a" else entry.b
            for j in range(entry.order):
                name = f"{task.name}.{letter}[{_index(source, i, j)}]"
                found.append(
                    Variable(name, float(values[j]), _unit(entry.order - j), text, LEAST.get(letter, -inf))
                )
    about = {"limit": "bound on |f_hat|", "g_low": "least that acts of g", "g_high": "most that acts of g"}
    found += [
        Variable(f"{task.name}.{name}[{i}]", float(end), "", about[name], LEAST.get(name, -inf))
        for name, ends in source.limits.items()
        for i, end in enumerate(ends)
    ]
    return tuple(found)


def _index(source: FilterSource, i: int, j: int) -> str:
    return str(j) if len(source.orders) == 1 else f"{i},{j}"


def _unit(power: int) -> str:
    return "rad/s" if power == 1 else f"(rad/s)^{power}"


def _copies(source: FilterSource, member: str) -> str:
    """Statements that copy w of the sections behind what `s` has so far."""
    if len(source.orders) == 1:
        order = source.orders[0]
        return (
            f"  for (int i = 0; i < {source.n_f}; i++)\n"
            f"    for (int j = 0; j < {order}; j++) *s++ = (pf_real)self->{member}.w[i][j];\n"
        )
    return "".join(
        f"  for (int j = 0; j < {order}; j++) *s++ = (pf_real)self->{member}.w[{i}][j];\n"
        for i, order in enumerate(source.orders)
    )


def _check(task: Task, source: FilterSource, member: str, number: int, first: int) -> str:
    """Statements that retune a copy of the filter, trial<number>, where its parameters were changed."""
    name, orders, n = source.name, source.orders, source.sampled.order
    half = sum(orders)
    total = 2 * half + sum(map(len, source.limits.values()))
    table = ", ".join(str(order) for order in orders)
    quoted = in_string(task.name)
    follows = [
        i
        for i, entry in enumerate(source.sampled.realised)
        if entry.b[0] == entry.a[0] and not entry.b[1:].any()
    ]
    lines = [
        f"  {name} trial{number} = self->{member};",
        f"  if (!refusal && memcmp(self->p + {first}, self->p_used + {first}, {total} * sizeof(pf_real)) != 0) {{",
        f"    static const int orders[] = {{{table}}};",
        f"    pf_real *const a_set = self->p + {first}, *const b_set = a_set + {half};",
        f"    const pf_real *const b_used = self->p_used + {first + half};",
        f"    double a[{len(orders)}][{n}] = {{{{0}}}}, b[{len(orders)}][{n}] = {{{{0}}}};",
        "    int code = PF_FILTER_OK, next = 0;",
    ]
    if follows:
        # A low-pass filter stays one, of gain 1 at rest: b[0] is a[0] unless b is set itself.
        lines += ["    /* low-pass form: b[0] follows a[0] unless b is set too */"]
        begins = [sum(orders[:i]) for i in follows]
        lines += [
            f"    if (memcmp(b_set + {begin}, b_used + {begin}, {orders[i]} * sizeof(pf_real)) == 0) "
            f"b_set[{begin}] = b_used[{begin}] == self->p_used[{first + begin}] ? a_set[{begin}] : b_set[{begin}];"
            for i, begin in zip(follows, begins, strict=True)
        ]
    else:
        lines += ["    (void)b_used;"]
    lines += [
        f"    for (int i = 0; i < {len(orders)}; i++)",
        "      for (int j = 0; j < orders[i]; j++, next++) {",
        "        a[i][j] = (double)a_set[next];",
        "        b[i][j] = (double)b_set[next];",
        "      }",
        f"    if (memcmp(a_set, self->p_used + {first}, {2 * half} * sizeof(pf_real)) != 0)",
        f"      code = {name}_retune(&trial{number}, a[0], b[0]);",
    ]
    at = 2 * half
    for limit, ends in source.limits.items():
        lines += [
            f"    {name}_real {limit}[{len(ends)}];",
            f"    for (int i = 0; i < {len(ends)}; i++) {limit}[i] = ({name}_real)a_set[{at} + i];",
        ]
        at += len(ends)
    if "limit" in source.limits:
        lines += [f"    if (!code) code = {name}_set_limit(&trial{number}, limit);"]
    if "g_low" in source.limits:
        lines += [f"    if (!code) code = {name}_set_g_limit(&trial{number}, g_low, g_high);"]
    lines += [f'    if (code == {code}) refusal = "{quoted}: {text}";' for code, text in _CODE.items()]
    lines += [
        "    if (code && !refusal)",
        f'      refusal = "{quoted}: a coefficient or a limit is out of range";',
        "  }",
    ]
    return "\n".join(lines) + "\n"
