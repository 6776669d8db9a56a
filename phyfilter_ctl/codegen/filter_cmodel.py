"""A PhyFilter by itself as a C model: what an FMU of a filter is made from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._sections import FloatArray
from ..blocks.functions import Variable
from ..filter import PhyFilter, SampledPhyFilter
from .filter_code import LEAST, InertiaInput, braces, filter_source, inertia_kind, runtime_files
from .identifiers import checked_identifier
from .model import CModel

__all__ = ["filter_model"]

_RUNTIME = ("pf_ieee.h", "pf_model.h", "pf_run.c", "pf_run.h")


def filter_model(
    filter: PhyFilter | SampledPhyFilter | Sequence[PhyFilter],
    channels: int,
    *,
    inertia: ArrayLike | InertiaInput | None = None,
    names: Sequence[str] = (),
    units: Mapping[str, str] | None = None,
    name: str = "phyfilter",
    rate: Literal["communication", "fixed"] = "communication",
    tunable: bool = True,
) -> CModel:
    """A filter as a C model.

    Parameters
    ----------
    filter : PhyFilter, SampledPhyFilter or sequence of PhyFilter
        A continuous filter gives continuous states, a sampled one an update at its samples; a sequence is one
        continuous filter per channel.
    channels : int
        Number n_x of channels of x.
    inertia : float, (n_x,) or (n_x, n_x) array, {"scalar", "diagonal", "full"} or None
        Constant inertia; or, for a sampled filter, the kind of inertia that is an input; None takes that of the
        filter's ``sampling``, else I.
    names : sequence of str
        Of the channels of a continuous filter; a sampled one has them, and units, in its ``sampling``.
    units : mapping of str to str, optional
        Of "x", "g" and "f" of a continuous filter.
    name : str
        C identifier.
    rate : {"communication", "fixed"}
        When a sampled filter takes a sample: once per communication step, over the time that has passed; or on its own
        grid, every dt seconds.
    tunable : bool
        Whether a, b and the limits are parameters.

    Returns
    -------
    CModel
        Inputs x[i], g[i], f_theta[i] (and M), outputs f_hat[i]; parameters a[j], b[j] (a[i,j], b[i,j] where each
        channel has its own filter), limit[i], g_low[i], g_high[i]; states w[i,j].

    Raises
    ------
    ValueError
        As :func:`filter_source`; or for an inertia that is an input of a continuous filter.

    Notes
    -----
    Sampled: at a sample f_hat uses x, f_theta and the inertia as they are; a held g is the g that acts from this sample
    on, which is kept for the next one. f_hat is held until the next sample. At the start f_hat = f_theta.

    Continuous: z' = A w + A equilibrium (g + f_theta), f_hat = f_theta + C w with w = z - A equilibrium M (x - x(0)),
    the equations of :func:`phyfilter_ctl.phyfilter_block` counted from x(0): x is not differentiated, z = 0 is the
    state at rest and f_hat starts at f_theta, whatever x(0).

    A filter in the low-pass form (b = [a_0, 0, ...]) stays in it while a is set: b[0] follows a[0]. Setting b ends
    that.

    Examples
    --------
    >>> model = filter_model(PhyFilter([400.0, 40.0]), 2)
    >>> [entry.name for entry in model.states], [entry.name for entry in model.parameters]
    (['w[0,0]', 'w[0,1]', 'w[1,0]', 'w[1,1]'], ['a[0]', 'a[1]', 'b[0]', 'b[1]'])
    """
    name = checked_identifier(name)
    if isinstance(filter, SampledPhyFilter):
        inertia = filter.sampling.inertia if inertia is None else inertia
        return _sampled_model(filter, channels, inertia, name, rate, tunable)
    if names and len(names) != channels:
        raise ValueError(f"names: expected {channels}, one for each channel, got {len(names)}")
    filters = (filter,) if isinstance(filter, PhyFilter) else tuple(filter)
    labels = _Labels(tuple(names), {} if units is None else units)
    return _continuous_model(filters, channels, inertia, name, tunable, labels)


class _Labels(NamedTuple):
    """Names of channels and units of x, g and f, where they are known."""

    names: tuple[str, ...]
    units: Mapping[str, str]

    def unit(self, signal: str) -> str:
        return self.units.get(signal, "")

    def of(self, i: int) -> str:
        return f" of {self.names[i]}" if i < len(self.names) else ""


def _sampled_model(
    sampled: SampledPhyFilter,
    channels: int,
    inertia: ArrayLike | InertiaInput | None,
    name: str,
    rate: Literal["communication", "fixed"],
    tunable: bool,
) -> CModel:
    if rate not in ("communication", "fixed"):
        raise ValueError(f"rate: expected 'communication' or 'fixed', got {rate!r}")
    communication = rate == "communication"
    source = filter_source(
        sampled,
        channels,
        name=name,
        inertia=inertia,
        variable=communication,
        tunable=tunable,
        long_steps=communication,
    )
    code = f"""\
#include "pf_ieee.h"

#include "{name}.h"

#define {name}_COMMUNICATION {int(communication)}
#define {name}_COEFFICIENTS {sum(source.orders)}
#define {name}_MODEL_NAME "{name}"
#define PF_NAME {name}
#include "pf_filter_model.h"
"""
    n_f = source.n_f
    labels = _Labels(sampled.sampling.names, sampled.sampling.units)
    own = labels if n_f == channels else _Labels((), labels.units)
    which = " that acts from this sample on" if sampled.sampling.g == "hold" else " at this sample"
    inputs = _inputs(channels, n_f, labels, own, which) + _inertia_inputs(inertia, channels)
    parameters = _coefficients(sampled.realised) if tunable else ()
    if tunable:
        about = {
            "limit": (labels.unit("f"), "bound on |f_hat|", own),
            "g_low": (labels.unit("g"), "least that acts of g", labels),
            "g_high": (labels.unit("g"), "most that acts of g", labels),
        }
        parameters += tuple(
            Variable(f"{name}[{i}]", float(end), unit, f"{text}{whose.of(i)}", LEAST.get(name, -inf))
            for name, ends in source.limits.items()
            for unit, text, whose in (about[name],)
            for i, end in enumerate(ends)
        )
    return CModel(
        name,
        source.sources | {f"{name}_model.c": code} | runtime_files([*_RUNTIME, "pf_filter_model.h"]),
        f"{name}_model",
        (),
        inputs,
        _outputs(n_f, own),
        parameters,
        _section_states(sampled.filters, n_f, labels),
        () if communication else ((name, sampled.dt),),
        sampled.dt if communication else 0.0,
        np.zeros((n_f, len(inputs)), dtype=bool),
        formula=_formula(sampled.filters),
        description=f"PhyFilter sampled every {sampled.dt:g} s: estimate f_hat of the unknown part of M x' = g + f",
    )


def _continuous_model(
    filters: tuple[PhyFilter, ...],
    channels: int,
    inertia: ArrayLike | InertiaInput | None,
    name: str,
    tunable: bool,
    labels: _Labels,
) -> CModel:
    if channels < 1 or len(filters) not in (1, channels):
        raise ValueError(
            f"{len(filters)} filters for {channels} channels: expected one, or one per channel, and a channel or more"
        )
    if isinstance(inertia, str):
        raise ValueError(
            f"inertia={inertia!r} as an input needs a sampled filter; a continuous one takes a constant inertia"
        )
    kind, constant = inertia_kind(inertia, channels)
    if kind == 1 and constant is not None:
        kind, constant = 2, np.repeat(constant, channels)
    orders = [entry.order for entry in filters]
    n = max(orders)

    def padded(rows: Sequence[FloatArray]) -> FloatArray:
        return np.array([np.pad(row, [(0, n - len(row))] + [(0, 0)] * (row.ndim - 1)) for row in rows])

    numbers = {
        "a": padded([entry.a for entry in filters]),
        "b": padded([entry.b for entry in filters]),
        "poles": padded([np.stack([entry.poles.real, entry.poles.imag], axis=1) for entry in filters]),
    }
    if constant is not None:
        numbers["inertia"] = constant
    options = {
        "N_X": channels,
        "ORDER": n,
        "FILTERS": len(filters),
        "COEFFICIENTS": sum(orders),
        "INERTIA": kind,
        "TUNABLE": int(tunable),
    }
    defines = "\n".join(f"#define {name}_{option} {value}" for option, value in options.items())
    members = "\n".join(f"  .{member} = {braces(values, False)}," for member, values in numbers.items())
    code = f"""\
#include "pf_ieee.h"

{defines}
#define {name}_MODEL_NAME "{name}"
#define PF_NAME {name}
#include "pf_filter_continuous.h"

#include "pf_ieee.h" /* a table follows */
static const {name}_numbers {name}_parameters = {{
  .order = {{{", ".join(map(str, orders))}}},
{members}
}};

#define PF_NAME {name}
#define PF_FILTER_MODEL
#include "pf_filter_continuous.h"
"""
    runtime = [
        *_RUNTIME,
        "pf_filter_continuous.h",
        "pf_arithmetic.h",
        "pf_hurwitz.h",
        "pf_tune.c",
        "pf_tune.h",
    ]
    runtime += ["pf_roots.c"] if tunable else []
    inputs = _inputs(channels, channels, labels, labels)
    return CModel(
        name,
        {f"{name}_model.c": code} | runtime_files(runtime),
        f"{name}_model",
        _section_states(filters, channels, labels),
        inputs,
        _outputs(channels, labels),
        _coefficients(filters) if tunable else (),
        depends=_continuous_depends(filters, channels, constant, tunable=tunable),
        formula=_formula(filters),
        description="PhyFilter: estimate f_hat of the unknown part of the dynamics M x' = g + f",
    )


def _continuous_depends(
    filters: tuple[PhyFilter, ...], channels: int, inertia: FloatArray | None, *, tunable: bool
) -> NDArray[np.bool_]:
    """Which derivative and output depends on which state and input; if tunable, also where coefficients to come can
    bring it in."""
    bank = filters * channels if len(filters) == 1 else filters
    firsts = np.cumsum([0, *(entry.order for entry in bank)])
    n_z = int(firsts[-1])
    coupled = np.eye(channels, dtype=bool)
    if inertia is not None and inertia.size == channels**2 and channels > 1:
        coupled = inertia.reshape(channels, channels) != 0.0
    depends = np.zeros((n_z + channels, n_z + 3 * channels), dtype=bool)
    for i, entry in enumerate(bank):
        A, _, C = entry.sections
        n = entry.order
        A_may, C_may = A != 0.0, C != 0.0
        if tunable:
            A_may, C_may = np.abs(np.subtract.outer(range(n), range(n))) <= 1, np.ones(n, dtype=bool)
        rows = slice(int(firsts[i]), int(firsts[i + 1]))
        depends[rows, rows] = A_may
        depends[n_z + i, rows] = C_may
        of_x = n_z + np.flatnonzero(coupled[i])
        depends[np.ix_(firsts[i] + np.flatnonzero(A_may[:, 0]), of_x)] = True
        depends[n_z + i, of_x] = C_may[0]
        depends[firsts[i], [n_z + channels + i, n_z + 2 * channels + i]] = True
        depends[n_z + i, n_z + 2 * channels + i] = True
    return depends


# -- variables ------------------------------------------------------------------------------------------------------


def _inputs(n_x: int, n_f: int, labels: _Labels, own: _Labels, which_g: str = "") -> tuple[Variable, ...]:
    return (
        *(Variable(f"x[{i}]", 0.0, labels.unit("x"), f"measured state{labels.of(i)}") for i in range(n_x)),
        *(
            Variable(f"g[{i}]", 0.0, labels.unit("g"), f"known part of M x'{labels.of(i)}{which_g}")
            for i in range(n_x)
        ),
        *(
            Variable(f"f_theta[{i}]", 0.0, own.unit("f"), f"learned model of f{own.of(i)}")
            for i in range(n_f)
        ),
    )


def _inertia_inputs(inertia: ArrayLike | InertiaInput | None, n_x: int) -> tuple[Variable, ...]:
    text = "model of the inertia"
    if isinstance(inertia, str) and inertia == "full":
        return tuple(Variable(f"M[{i},{j}]", float(i == j), "", text) for i in range(n_x) for j in range(n_x))
    if isinstance(inertia, str):
        return tuple(Variable(f"M[{i}]", 1.0, "", text) for i in range(1 if inertia == "scalar" else n_x))
    return ()


def _outputs(n_f: int, own: _Labels) -> tuple[Variable, ...]:
    return tuple(Variable(f"f_hat[{i}]", 0.0, own.unit("f"), f"estimate of f{own.of(i)}") for i in range(n_f))


def _section_states(filters: tuple[PhyFilter, ...], n_f: int, labels: _Labels) -> tuple[Variable, ...]:
    bank = filters * n_f if len(filters) == 1 else filters
    return tuple(
        Variable(f"w[{i},{j}]", 0.0, labels.unit("f"), "state of a section")
        for i, entry in enumerate(bank)
        for j in range(entry.order)
    )


def _coefficients(filters: tuple[PhyFilter, ...]) -> tuple[Variable, ...]:
    found: list[Variable] = []
    for letter, text in (("a", "coefficient of the denominator of F"), ("b", "coefficient of its numerator")):
        for i, entry in enumerate(filters):
            values = entry.a if letter == "a" else entry.b
            for j, value in enumerate(values):
                index = f"{j}" if len(filters) == 1 else f"{i},{j}"
                power = entry.order - j
                unit = "rad/s" if power == 1 else f"(rad/s)^{power}"
                found.append(
                    Variable(f"{letter}[{index}]", float(value), unit, text, LEAST.get(letter, -inf))
                )
    return tuple(found)


def _formula(filters: tuple[PhyFilter, ...]) -> str:
    if len(filters) == 1:
        return f"F(s) = {filters[0].formula()}"
    return "\n".join(f"F{i}(s) = {entry.formula()}" for i, entry in enumerate(filters))
