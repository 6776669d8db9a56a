"""Names of 0.2 that are gone: each still works, warns, and says what to write. They go with 0.4.

``python -m phyfilter_ctl.migrate`` rewrites code that uses them.
"""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from functools import cache
from typing import Any

__all__ = ["former"]

_LOOP = "kp", "kd", "actuator", "delay", "inertia_ratio", "g", "command_limit"
_BOUNDED = "residual", "noise", "inertia_error", "rate", "actuation", "position_noise", "implementation"
_SETS = {
    "inertia": "vertices",
    "inertia_between": "between",
    "inertia_within": "within",
    "inertia_hull": "vertices",
}


def _now() -> Any:
    """The library, asked by name: these functions lie below and above all of it."""
    return importlib.import_module("phyfilter_ctl")


def _made(kind: str, given: Mapping[str, Any], *, parts: bool = False) -> Any:
    """A value of what is given, or one for each channel where something is a list; a list of ``parts`` adds up."""
    make = getattr(_now(), kind)
    lists = {
        name
        for name, value in given.items()
        if (isinstance(value, list | tuple) or getattr(value, "ndim", 0) == 1)
        and not (parts and name in ("residual", "actuation"))
    }
    if not lists:
        return make(**given)
    count = len(given[min(lists)])
    return [make(**{k: v[i] if k in lists else v for k, v in given.items()}) for i in range(count)]


def _taken(names: tuple[str, ...], keywords: dict[str, Any]) -> dict[str, Any]:
    return {name: keywords.pop(name) for name in names if name in keywords}


def _in_loop(name: str) -> Callable[..., Any]:
    def call(filter: Any, **keywords: Any) -> Any:
        loop = _made("Loop", _taken(_LOOP, keywords))
        return getattr(_now(), name)(filter, loop, **keywords)

    return call


def _prior_margin(filter: Any, **keywords: Any) -> Any:
    found = _in_loop("margins")(filter, **keywords)
    kind = _class("PriorMargin")
    made = [
        kind(m.inertia_ratio, m.loop, m.filter, m.around)
        for m in (found if isinstance(found, tuple) else [found])
    ]
    return type(found)(made) if isinstance(found, tuple) else made[0]


@cache
def _class(name: str) -> Any:
    """``PriorMargin`` with its methods for matrices, and ``InertiaVerdict``, what they gave."""
    now = _now()
    if name == "InertiaVerdict":
        stable = property(lambda self: self.status == "proven")
        return type(
            name, (now.InertiaCertificate,), {"stable": stable, "test": property(lambda self: self.method)}
        )

    def method(old: str) -> Callable[..., Any]:
        def asked(self: Any, M_hat: Any, *sets: Any, deviation: Any = None) -> Any:
            wanted = sets if old == "inertia_between" else [sets[0]] if old == "inertia" else sets[0]
            given = {_SETS[old]: wanted} | ({} if deviation is None else {"within": deviation})
            loop = replace(self.around, inertia_ratio=1.0)
            found = now.inertia_tolerance(self.filter, loop, M_hat=M_hat, rate=0.0, **given)
            return _class("InertiaVerdict")(*(getattr(found, each.name) for each in fields(found)))

        return asked

    return type(name, (now.FilterMargins,), {old: method(old) for old in _SETS})


def _ultimate_bound(filter: Any, **keywords: Any) -> Any:
    if keywords.get("rate") == 0.0:
        del keywords["rate"]
    return _now().error_bound(filter, _made("Bounded", _taken(_BOUNDED, keywords)), **keywords)


def _tracking_tube(filter: Any, **keywords: Any) -> Any:
    loop = _made("Loop", _taken(_LOOP, keywords))
    return _now().tracking_error(
        filter, loop, _made("Bounded", _taken(_BOUNDED, keywords), parts=True), **keywords
    )


def _tracking_deviation(filter: Any, **keywords: Any) -> Any:
    loop, given = _made("Loop", _taken(_LOOP, keywords)), _taken(_BOUNDED, keywords)
    return _now().tracking_error(filter, loop, _now().Gaussian(**given), **keywords)


def _disk_margin(L: Any, *, skew: float = 0.0) -> Any:
    return _now().margins(L).disk_margin(skew=skew)


def _signal_margin(system: Any, signal: Any, **keywords: Any) -> Any:
    return _now().margins(system, at=signal, **keywords)


def _loop_constraint(**keywords: Any) -> Any:
    return _now().LoopGoal(_now().Loop(**_taken(_LOOP, keywords)), **keywords)


def _pole_zero_map(system: Any) -> Any:
    return _now().frequency_response(system).pole_zero_map


# By name: what it is now, and what is written instead.
_FUNCTIONS: dict[str, tuple[Callable[..., Any], str]] = {
    "prior_margin": (_prior_margin, "margins(filter, Loop(actuator=..., delay=...))"),
    "loop_margin": (_in_loop("margins"), "margins(filter, Loop(kp, kd, actuator, delay))"),
    "disk_margin": (_disk_margin, "margins(L).disk"),
    "signal_margin": (_signal_margin, "margins(diagram, at=signal)"),
    "moving_inertia": (_in_loop("inertia_tolerance"), "inertia_tolerance(filter, loop, ratios=...)"),
    "ultimate_bound": (_ultimate_bound, "error_bound(filter, Bounded(residual, noise=...))"),
    "tracking_tube": (_tracking_tube, "tracking_error(filter, loop, Bounded(residual, noise=...))"),
    "tracking_deviation": (
        _tracking_deviation,
        "tracking_error(filter, loop, Gaussian(residual, noise=...))",
    ),
    "pole_zero_map": (_pole_zero_map, "frequency_response(filter).pole_zero_map"),
    "LoopConstraint": (_loop_constraint, "LoopGoal(Loop(kp, kd, actuator, delay), modulus_margin=...)"),
}
_CLASSES = {
    "BoundResult": "ErrorBound",
    "LivePolicy": "LiveRules",
    "LoopMargin": "FilterMargins",
    "LoopMargins": "Margins",
    "RatioMargins": "FilterMargins",
    "SignalMargin": "SystemMargins",
}
# Moved without a change: from a module to one that has it now.
_MOVED = {
    "FilterPlace": "phyfilter_ctl.loops",
    "OperatingPoint": "phyfilter_ctl.loops",
    "SampledModel": "phyfilter_ctl.loops",
    "linearize_sampled": "phyfilter_ctl",
    "sampled_open_loop": "phyfilter_ctl",
    "signal_margin": "phyfilter_ctl",
    "Implementation": "phyfilter_ctl",
    "gauss_markov": "phyfilter_ctl",
}
# Inside their rooms now: from a module to the one in it that has them.
_INNER = {
    "analysis.margins": ("filter_margins",),
    "blocks.filter_law": ("filter_law",),
    "codegen.compiler": ("cached_library",),
    "codegen.diagram_source": ("diagram_model",),
    "codegen.export_diagram": ("export_diagram",),
    "codegen.export_filter": ("export_filter",),
    "codegen.export_folder": ("write_folder",),
    "codegen.filter_model": ("filter_model",),
    "diagram.discrete": ("as_sampled",),
    "filterfile.document": ("settled_inertia", "settled_signals"),
    "plots._units": ("frequency_unit",),
    "plots.budget": ("budget_curves", "budget_plot"),
    "plots.estimates": ("estimate_plot",),
    "plots.frequency": ("frequency_plot",),
    "plots.learning": ("learning_plot",),
    "plots.logs": ("log_plot",),
    "plots.missed": ("density_plot", "missed_plot"),
    "plots.poles": ("PoleSet", "pole_plot"),
    "plots.promises": ("analysis_plot", "bound_plot", "trade_off_plot"),
    "plots.report": ("ReportPage", "report_html", "report_pdf"),
    "robot.findings": ("findings_of",),
}
_HOMES = {name: f"phyfilter_ctl.{module}" for module, names in _INNER.items() for name in names}


def former(module: str, name: str, *, level: int = 2) -> Any:
    """What a name of 0.2 stands for, with a warning.

    Parameters
    ----------
    module, name : str
        Where it was asked for.
    level : int
        How far up the caller is whom the warning is for.

    Returns
    -------
    object

    Raises
    ------
    AttributeError
        If there never was one.

    Examples
    --------
    >>> import warnings
    >>> with warnings.catch_warnings(record=True) as said:
    ...     warnings.simplefilter("always")
    ...     loop_margin = former("phyfilter_ctl", "loop_margin")
    >>> print(said[0].message)
    phyfilter_ctl.loop_margin is now margins(filter, Loop(kp, kd, actuator, delay)); the old name goes with 0.4, and
    `python -m phyfilter_ctl.migrate` rewrites it
    """
    if name in _FUNCTIONS:
        found, instead = _FUNCTIONS[name]
    elif name in ("PriorMargin", "InertiaVerdict"):
        found, instead = _class(name), "FilterMargins" if name == "PriorMargin" else "InertiaCertificate"
    elif name in _CLASSES:
        found, instead = getattr(_now(), _CLASSES[name]), _CLASSES[name]
    elif name in _MOVED and module != _MOVED[name]:
        found, instead = getattr(importlib.import_module(_MOVED[name]), name), f"{_MOVED[name]}.{name}"
    elif name in _HOMES and _HOMES[name].startswith(f"{module}."):
        found = getattr(importlib.import_module(_HOMES[name]), name)
        instead = f"an affair of {_HOMES[name]}, for which nothing is promised"
    else:
        raise AttributeError(f"module {module!r} has no attribute {name!r}")
    warnings.warn(
        f"{module}.{name} is now {instead}; the old name goes with 0.4, and\n`python -m phyfilter_ctl.migrate` "
        "rewrites it",
        DeprecationWarning,
        stacklevel=level,
    )
    return found
