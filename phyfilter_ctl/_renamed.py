"""Names of 0.2 that are gone: each still works, warns, and says what to write. They go with 0.4.

``python -m phyfilter_ctl.migrate`` rewrites code that uses them.
"""

from __future__ import annotations

import importlib
import inspect
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from functools import cache, wraps
from numbers import Integral
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, get_args

import lazy_loader

__all__ = [
    "FUNCTIONS",
    "HOMES",
    "attached",
    "former",
    "former_field",
    "takes_former",
    "takes_former_options",
    "takes_limits",
    "takes_numerator",
    "takes_pairs",
    "takes_rotors",
    "takes_signals",
]

_P = ParamSpec("_P")
_T = TypeVar("_T")

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


def former_field(result: object, name: str, now: str) -> Any:
    """A field of a result that had another name in 0.2, with a warning.

    Parameters
    ----------
    result : object
    name, now : str
    """
    _warn(f"{type(result).__name__}.{name} is now {now}", 4)
    return getattr(result, now)


_ROTORS = "mass", "J", "arm", "torque_ratio", "gravity", "rotor_max", "motor_lag", "delay"


def takes_rotors(call: Callable[_P, _T]) -> Callable[_P, _T]:
    """A function that had a multirotor's numbers and gains one by one in 0.2: it still takes them, with a warning.

    Parameters
    ----------
    call : callable
    """

    @wraps(call)
    def taken(*given: _P.args, **keywords: _P.kwargs) -> _T:
        if given or "mass" not in keywords:
            return call(*given, **keywords)
        named: dict[str, Any] = dict(keywords)
        controllers = importlib.import_module("phyfilter_ctl.controllers")
        gains = [named.pop(name) for name in ("kR", "kw", "lead_filter")]
        vehicle = controllers.Multirotor(**_taken(_ROTORS, named))
        name = call.__name__
        _warn(f"{name}(mass=..., kR=...) is now {name}(Multirotor(mass=...), AttitudeGains(kR, kw, ...))", 3)
        whole: Any = call
        return whole(vehicle, controllers.AttitudeGains(*gains), **named)

    return taken


def _of_multirotor(module: str, name: str) -> Callable[..., Any]:
    return lambda **keywords: getattr(importlib.import_module(f"phyfilter_ctl.controllers.{module}"), name)(
        **keywords
    )


_PAIRS = {"servo": ("servo_bandwidth", "servo_damping"), "nominal": ("nominal_mass", "nominal_J")}


def takes_pairs(call: Callable[_P, _T]) -> Callable[_P, _T]:
    """An aerial manipulator whose servo and nominal values were given one by one in 0.2: still so, with a warning.

    Parameters
    ----------
    call : callable
    """

    @wraps(call)
    def taken(*given: _P.args, **keywords: _P.kwargs) -> _T:
        named: dict[str, Any] = dict(keywords)
        usual = {"servo": (40.0, 1.0), "nominal": (None, None)}
        for name, parts in _PAIRS.items():
            found = _taken(parts, named)
            if found:
                named[name] = tuple(
                    found.get(part, other) for part, other in zip(parts, usual[name], strict=True)
                )
                _warn(f"{call.__name__}({parts[0]}=..., {parts[1]}=...) is now {name}=(..., ...)", 3)
        whole: Any = call
        return whole(*given, **named)

    return taken


@dataclass(frozen=True)
class _Signals:
    """0.2's note beside a filter."""

    channels: Sequence[str] = ()
    unit_x: str = ""
    unit_g: str = ""
    unit_f: str = ""
    inertia: Any = None

    def told(self) -> dict[str, Any]:
        units = {key: unit for key in ("x", "g", "f") if (unit := getattr(self, f"unit_{key}"))}
        given = {"channels": tuple(self.channels), "inertia": self.inertia, "units": units}
        return {key: value for key, value in given.items() if value is not None and value not in ((), {})}


def _load_signals(path: Any) -> _Signals:
    filter, noted = importlib.import_module("phyfilter_ctl.filterfile.document").read_noted(path)
    known = getattr(filter, "sampling", None) or _now().SampledPhyFilter(filter, 1.0).sampling.told(**noted)
    units = {f"unit_{key}": unit for key, unit in known.units.items()}
    constant = None if known.inertia is None or isinstance(known.inertia, str) else known.inertia.tolist()
    return _Signals(known.names, inertia=constant, **units)


def _knowing(value: Any, told: dict[str, Any]) -> Any:
    """A sampled filter with what it is told; anything else as it is."""
    return replace(value, sampling=value.sampling.told(**told)) if hasattr(value, "sampling") else value


def takes_signals(call: Callable[_P, _T]) -> Callable[_P, _T]:
    """A function that had the keyword ``signals`` in 0.2: it still takes it, with a warning.

    Parameters
    ----------
    call : callable
    """

    @wraps(call)
    def taken(*given: _P.args, **keywords: _P.kwargs) -> _T:
        if "signals" not in keywords:
            return call(*given, **keywords)
        named: dict[str, Any] = dict(keywords)
        told = {} if (signals := named.pop("signals")) is None else signals.told()
        _warn(
            f"{call.__name__}(signals=...) is now the filter's own: filter.sampled(dt, channels=..., units=...)",
            3,
        )
        sampled = any(hasattr(each, "sampling") for each in (*given, *named.values()))
        values = [_knowing(each, told) for each in given]
        named = {name: _knowing(each, told) for name, each in named.items()}
        whole: Any = call
        return whole(*values, **(named if sampled else told | named))

    return taken


def _split_by_speed(flights: Any, fraction: float = 0.5, *, percentile: float = 99.0) -> Any:
    return _now().split(flights, lambda log: log.speed(percentile), fraction=fraction)


def _split_flights(flights: Any, *, key: Callable[[Any], float], fraction: float = 0.5) -> Any:
    return _now().split(flights, key, fraction=fraction)


@cache
def _trade_off() -> Any:
    """``TradeOff`` with the fields of 0.2's two."""

    def cost(name: str) -> property:
        return property(lambda self: self.costs[name])

    fields_of_0_2 = {
        "following": cost("residual"),
        "noise": cost("noise"),
        "rmse": cost("rmse"),
        "margins": property(lambda self: self.values),
        "filters": property(lambda self: self.results),
        "best": property(lambda self: self.best_index),
    }
    return type("TradeOff", (_now().TradeOff,), fields_of_0_2)


def _traded(design: Callable[[float], Any], values: Any, label: str, **keywords: Any) -> Any:
    found = _now().trade_off(design, values, label=label, **keywords)
    return _trade_off()(*(getattr(found, each.name) for each in fields(found)))


def _bound_trade_off(order: int, *, points: int = 100, **keywords: Any) -> Any:
    residual, noise, inertia = keywords["residual"], keywords["noise"], keywords.get("inertia", 1.0)
    if len(residual) != 1 or not noise > 0.0:
        raise ValueError("expected one bounded derivative and a positive noise")
    best = _now().design.optimal.least_bound(order, **keywords).filter
    bounds = _now().Bounded(residual, noise=noise)
    (k,) = residual
    return _traded(
        best.faster,
        [10.0 ** (-1.0 / k + i * (1.0 + 1.0 / k) / (points - 1)) for i in range(points)],
        f"bound from |gamma^({k})| and |nu|",
        cost=lambda filter: _now().error_bound(filter, bounds, inertia=inertia),
    )


def _variance_trade_off(order: int, *, points: int = 100, **keywords: Any) -> Any:
    dt, data = keywords.get("dt"), _now().Gaussian(keywords["residual"], noise=keywords["noise"])
    best = _now().design.optimal.least_variance(order, **keywords).filter
    return _traded(
        best.faster,
        [10.0 ** (2.0 * i / (points - 1) - 1.0) for i in range(points)],
        "standard deviation",
        cost=lambda filter: _now().error_variance(filter if dt is None else filter.sampled(dt), data),
    )


def _margin_trade_off(learner: Callable[[Any], Any], loop: Any, margins: Any) -> Any:
    goals = [replace(loop, modulus_margin=float(margin)) for margin in margins]  # refused before it learns
    goal = {each.modulus_margin: each for each in goals}
    return _traded(lambda margin: learner(goal[margin]), margins, "Modulus margin")


def _learn_axes(logs: Any, learner: Callable[[Any], Any], **keywords: Any) -> Any:
    return importlib.import_module("phyfilter_ctl.design.learning.axes").compare_axes(
        logs, learner, **keywords
    )


# Options of learn that were keywords of their own, by the class that has them.
OPTIONS = {
    "shape": (
        "Shape",
        ("form", "dc_gain", "type", "zeros_at", "blocked_at", "poles", "pole_range", "damping"),
    ),
    "sampling": ("Sampling", ("method", "g", "f_theta", "delay", "limit", "g_limit", "E")),
    "search": (
        "Search",
        ("start", "starts", "seed", "max_iterations", "regularisation", "cross_validate", "callback"),
    ),
    "reading": ("Reading", ("read", "on_bad", "workers", "scheduler", "report")),
}
_NEVER_NONE = "type", "start"  # None was their default
FORMER_OPTIONS = {
    *(name for _, names in OPTIONS.values() for name in names),
    *("logs", "label_offset", "wiener", "intervals"),
}


def takes_former_options(call: Callable[_P, _T]) -> Callable[_P, _T]:
    """``learn``, which had 36 arguments in 0.2: it still takes those by keyword, with a warning.

    Parameters
    ----------
    call : callable
    """

    @wraps(call)
    def taken(*given: _P.args, **keywords: _P.kwargs) -> _T:
        whole: Any = call
        named: dict[str, Any] = dict(keywords)
        asked = [name for name in named if name in FORMER_OPTIONS]
        if not asked:
            return whole(*given, **named)
        told = []
        for option, (kind, names) in OPTIONS.items():
            if own := _taken(names, named):
                own = {k: v for k, v in own.items() if v is not None or k not in _NEVER_NONE}
                if (scheduler := own.pop("scheduler", None)) is not None:
                    own["workers"] = scheduler
                made, beside = getattr(_now(), kind), named.get(option)
                if beside is not None:
                    own = (vars(beside) if isinstance(beside, made) else {names[0]: beside}) | own
                named[option] = made(**own)
                told.append(f"{option}={kind}({', '.join(f'{name}=...' for name in own)})")
        if "logs" in named:
            named["recordings"] = named.pop("logs")
        if "label_offset" in named:
            named["label"] = "offset" if named.pop("label_offset") else "given"
            told.append("label='offset'")
        if _taken(("wiener", "intervals"), named):
            told.append("nothing: result.wiener and result.intervals are computed when they are asked for")
        _warn(
            f"learn({', '.join(f'{name}=...' for name in asked)}) is now {', '.join(told) or 'recordings'}", 3
        )
        return whole(*given, **named)

    return taken


def takes_numerator(call: Callable[_P, _T]) -> Callable[_P, _T]:
    """A function whose ``type`` was a number or "lowpass" as ``numerator`` in 0.2: it still takes it, with a warning.

    Parameters
    ----------
    call : callable
    """

    @wraps(call)
    def taken(*given: _P.args, **keywords: _P.kwargs) -> _T:
        old: Any = keywords.get("numerator")
        if not isinstance(old, str | Integral):
            return call(*given, **keywords)
        kind = 1 if old == "lowpass" else old
        _warn(f"{call.__name__}(numerator={old!r}) is now {call.__name__}(type={kind!r})", 3)
        named: dict[str, Any] = {k: v for k, v in keywords.items() if k != "numerator"} | {"type": kind}
        whole: Any = call
        return whole(*given, **named)

    return taken


def _numerator_of_type(a: Any, k: int) -> Any:
    import numpy as np  # the command's help needs none

    return np.where(np.arange(len(a)) < k, np.asarray(a, dtype=float), 0.0)


# By name: what it is now, and what is written instead.
FUNCTIONS: dict[str, tuple[Callable[..., Any], str]] = {
    "learn_axes": (_learn_axes, 'learn(recordings, order, axes="compare")'),
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
    "Signals": (_Signals, "what Sampling has: filter.sampled(dt, channels=..., inertia=..., units=...)"),
    "load_signals": (_load_signals, "load(path).sampling, or load(path, dt=...).sampling"),
    "findings_of": (lambda recording, **keywords: recording.check(**keywords).findings, "recording.check()"),
    "attitude_gains": (_of_multirotor("attitude", "attitude_gains"), "Multirotor(...).gains(dt)"),
    "known_force": (_of_multirotor("known", "known_force"), "Multirotor(...).known_force(dt)"),
    "position_controller": (
        _of_multirotor("tracking", "position_controller"),
        "Multirotor(...).position(dt, kp=..., kd=...)",
    ),
    "known_torque": (_of_multirotor("known", "known_torque"), "Multirotor(...).known_torque(dt)"),
    "CutDiagram": (
        lambda parts, wires, inputs, outputs: importlib.import_module("phyfilter_ctl.fmi").System(
            parts, wires, inputs=inputs, outputs=outputs
        ),
        "System(parts, connections, inputs=..., outputs=...)",
    ),
    "read_reference": (lambda path: _now().fmi.Reference.read(path), "Reference.read(path)"),
    "write_reference": (lambda path, reference: reference.write(path), "reference.write(path)"),
    "known_noise": (lambda *given, **named: _now().Noise.known(*given, **named), "Noise.known(...)"),
    "measurement_noise": (
        lambda recording, **named: _now().Noise.at_rest(recording, **named),
        "Noise.at_rest(recording, start=..., end=...)",
    ),
    "split_by_speed": (_split_by_speed, "split(recordings)"),
    "split_flights": (_split_flights, "split(recordings, by=function)"),
    "bound_trade_off": (
        _bound_trade_off,
        "trade_off(filter.faster, speeds, cost=lambda f: error_bound(f, ...))",
    ),
    "variance_trade_off": (
        _variance_trade_off,
        "trade_off(filter.faster, speeds, cost=lambda f: error_variance(f, ...))",
    ),
    "numerator_of_type": (_numerator_of_type, "place_poles(poles, type=k).b"),
    "detect_changes": (
        lambda separation, part, **named: separation.changes(part, **named),
        "separation.changes(part)",
    ),
    "compare_estimators": (
        lambda *given, **named: importlib.import_module("phyfilter_ctl.baselines").compare(*given, **named),
        "baselines.compare(recordings)",
    ),
    "margin_trade_off": (
        _margin_trade_off,
        "trade_off(lambda m: learn(..., loop=replace(goal, modulus_margin=m)), margins)",
    ),
    "LoopConstraint": (_loop_constraint, "LoopGoal(Loop(kp, kd, actuator, delay), modulus_margin=...)"),
}
_CLASSES = {
    "BoundResult": "ErrorBound",
    "LivePolicy": "LiveRules",
    "LoopMargin": "FilterMargins",
    "LoopMargins": "Margins",
    "MarginTradeOff": "TradeOff",
    "NoiseLevel": "Noise",
    "RobotCheck": "Check",
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
    "TradeOff": "phyfilter_ctl",
    "Interval": "phyfilter_ctl.results",
    "Finding": "phyfilter_ctl.recording",
    "EstimatorComparison": "phyfilter_ctl.baselines",
}
# Inside their rooms now: from a module to the one in it that has them.
_INNER = {
    "analysis.margins": ("filter_margins",),
    "analysis.poles": ("PolesAndZeros",),
    "app.designs": ("Assumptions", "Design", "Numerator"),
    "app.handling": ("Session", "handle"),
    "app.jobs": ("LearningJob",),
    "baselines.protocol": ("Differentiator",),
    "blocks.functions": ("dependencies",),
    "blocks.law": ("filter_law",),
    "codegen.compiler": ("cached_library", "compile_sources"),
    "codegen.diagram_source": ("diagram_model",),
    "codegen.diagram_folder": ("export_diagram",),
    "codegen.filter_folder": ("export_filter",),
    "codegen.export_folder": ("write_folder",),
    "codegen.filter_cmodel": ("filter_model",),
    "codegen.filter_code": ("FilterSource", "filter_source"),
    "controllers.allocation": ("allocate",),
    "controllers.attitude": ("attitude_error",),
    "controllers.known": ("KnownForce",),
    "design.adjoint": ("CasadiCost", "CostTerms"),
    "design.refinement": ("score_model",),
    "design.learning.constraints": ("Near",),
    "diagram.discrete": ("as_sampled",),
    "diagram.opening": ("open_loop",),
    "filter.sampling": ("InertiaInput", "SamplingOptions"),
    "fmi.importing_blocks": ("FmuBlock",),
    "fmi.replay": ("replay_in_fmpy",),
    "learned.function_model": ("FunctionModel",),
    "learned.onnx": ("OnnxGraph", "OnnxNetwork", "OnnxNode"),
    "logfiles.suggesting": ("suggestions",),
    "plants.algebra": ("quaternion_product", "quaternion_rate", "rotation_matrix"),
    "plants.coupling": ("Accelerations", "coupled_accelerations", "payload_motion"),
    "plots._units": ("frequency_unit",),
    "plots.budget": ("budget_curves", "budget_plot"),
    "plots.estimates": ("estimate_plot",),
    "plots.frequency": ("frequency_plot",),
    "plots.learning": ("learning_plot",),
    "plots.logs": ("log_plot",),
    "plots.missed": ("density_plot", "missed_plot"),
    "plots.poles": ("PoleSet", "pole_plot"),
    "plots.promises": ("analysis_plot", "bound_plot", "trade_off_plot"),
    "plots.report_pages": ("ReportPage", "report_html", "report_pdf"),
    "wrappers.simulators": ("JointState",),
}
HOMES = {name: f"phyfilter_ctl.{module}" for module, names in _INNER.items() for name in names}


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
    `python -m phyfilter_ctl.migrate` rewrites or lists it
    """
    if name in FUNCTIONS:
        found, instead = FUNCTIONS[name]
    elif name in ("PriorMargin", "InertiaVerdict"):
        found, instead = _class(name), "FilterMargins" if name == "PriorMargin" else "InertiaCertificate"
    elif name == "Suspicion":
        words = get_args(importlib.import_module("phyfilter_ctl.recording.findings").Suspicion)
        found, instead = StrEnum(name, {word.upper(): word for word in words}), 'its word, "time_unit"'
    elif name in _CLASSES:
        found, instead = getattr(_now(), _CLASSES[name]), _CLASSES[name]
    elif name == "Interval" and module == "phyfilter_ctl.filter":  # another one than that of results
        found, instead = _now().filter.PastStep, "phyfilter_ctl.filter.PastStep"
    elif name in _MOVED and module != _MOVED[name]:
        found, instead = getattr(importlib.import_module(_MOVED[name]), name), f"{_MOVED[name]}.{name}"
    elif name in HOMES and HOMES[name].startswith(f"{module}."):
        found = getattr(importlib.import_module(HOMES[name]), name)
        instead = f"an affair of {HOMES[name]}, for which nothing is promised"
    else:
        raise AttributeError(f"module {module!r} has no attribute {name!r}")
    _warn(f"{module}.{name} is now {instead}", level + 1)
    return found


def attached(package: str, file: str) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """``__getattr__``, ``__dir__`` and ``__all__`` of a package with a stub: what it lists when used, former names too.

    Parameters
    ----------
    package, file : str
        Its ``__name__`` and ``__file__``.
    """
    named, directory, names = lazy_loader.attach_stub(package, file)

    def find(name: str) -> object:
        try:
            return named(name)
        except AttributeError:
            if name in names:
                raise
            # phyfilter_ctl.fmi without an import of its own
            if name.isidentifier() and not name.startswith("_") and Path(file).with_name(name).is_dir():
                return importlib.import_module(f"{package}.{name}")
            return former(package, name, level=3)

    return find, directory, names


def takes_former(call: Callable[_P, _T]) -> Callable[_P, _T]:
    """A function that took more arguments in 0.2: it still takes them, with a warning.

    Parameters
    ----------
    call : callable
        One of ``_FORMER_ARGUMENTS``.
    """
    adapted = _FORMER_ARGUMENTS[call.__name__]

    @wraps(call)
    def taken(*given: _P.args, **keywords: _P.kwargs) -> _T:
        arguments, named = list[Any](given), dict[str, Any](keywords)
        for said in adapted(arguments, named):
            _warn(f"{call.__name__}({said}", _outside())
        whole: Any = call
        return whole(*arguments, **named)

    return taken


def takes_limits(call: Callable[_P, _T]) -> Callable[_P, _T]:
    """A function that runs, with arguments of 0.2 that ``limits``, ``timepts`` or the response has now: with a warning.

    Parameters
    ----------
    call : callable
    """

    @wraps(call)
    def taken(*given: _P.args, **keywords: _P.kwargs) -> _T:
        arguments, named = list[Any](given), dict[str, Any](keywords)
        old = _taken(("max_steps", "time_limit", "workers", "executor"), named)
        if isinstance(named.get("progress"), bool):
            old["progress"] = named.pop("progress")
        if old:
            _warn(
                f"{call.__name__}({', '.join(f'{n}=...' for n in old)}) is now {_as_limits(old)}", _outside()
            )
            old = {name: value for name, value in old.items() if value is not None and value is not False}
            if {"workers", "executor"} <= old.keys():
                raise ValueError(
                    "workers and executor: expected one of them; the executor has workers of its own"
                )
            if "executor" in old:
                old["workers"] = old.pop("executor")
            if old.get("max_steps") == 0 and call.__qualname__.startswith("CompiledModel"):
                del old["max_steps"]  # it meant no bound
            named["limits"] = {**(named.get("limits") or {}), **old}
        if (at := named.pop("t_eval", None)) is not None:
            _warn(
                f"{call.__name__}(timepts, t_eval=...) is now {call.__name__}((timepts, t_eval), ...)",
                _outside(),
            )
            if len(arguments) > 1:
                arguments[1] = (arguments[1], at)
            else:
                named["timepts"] = (named["timepts"], at)
        whole: Any = call
        if "squeeze" not in named:
            return whole(*arguments, **named)
        squeeze = named.pop("squeeze")
        _warn(
            f"{call.__name__}(squeeze=...) is now what python-control has for it, response(squeeze=...)",
            _outside(),
        )
        found: Any = whole(*arguments, **named)
        kind: Any = type(found)  # a batch is a list
        several = isinstance(found, list)
        return kind([response(squeeze=squeeze) for response in found]) if several else found(squeeze=squeeze)

    return taken


def _as_limits(old: Mapping[str, Any]) -> str:
    names = dict.fromkeys("workers" if name == "executor" else name for name in old)
    return f"limits={{{', '.join(f'{name!r}: ...' for name in names)}}}"


def _outside() -> int:
    """Level of the first caller that is not here, for :func:`_warn`."""
    frame, level = inspect.currentframe(), 0
    while frame is not None and frame.f_code.co_filename == __file__:
        frame, level = frame.f_back, level + 1
    return level + 1


def _bundled(named: dict[str, Any], into: str, kind: str, names: tuple[str, ...]) -> list[str]:
    """Keywords put into the value object that has them now."""
    taken = _taken(names, named)
    if not taken:
        return []
    given = named.get(into)
    named[into] = (
        getattr(importlib.import_module("phyfilter_ctl.fmi"), kind)(**taken)
        if given is None
        else replace(given, **taken)
    )
    shown = ", ".join(f"{name}=..." for name in taken)
    return [f"{shown}) is now {into}=fmi.{kind}({shown})"]


def _export_fmu(arguments: list[Any], named: dict[str, Any]) -> list[str]:
    said = _own_channels(arguments, named, ("channels", "inertia", "units"))
    ports = ("channels", "inertia", "units", "max_channels", "arrays", "record", "clocks", "xcp")
    said += _bundled(named, "ports", "FmuPorts", ports)
    return said + _bundled(named, "experiment", "FmuExperiment", ("solver", "author", "description"))


def _export_mujoco_fmu(arguments: list[Any], named: dict[str, Any]) -> list[str]:
    return _bundled(named, "experiment", "FmuExperiment", ("author", "description"))


def _own_channels(arguments: list[Any], named: dict[str, Any], names: tuple[str, ...]) -> list[str]:
    """What a sampled filter has itself."""
    system = arguments[0] if arguments else named.get("system")
    if not hasattr(system, "sampling") or not (told := _taken(names, named)):
        return []
    if arguments:
        arguments[0] = _knowing(system, told)
    else:
        named["system"] = _knowing(system, told)
    shown = ", ".join(f"{name}=..." for name in told)
    return [f"{shown}) is now the filter's own: filter.sampled(dt, {shown})"]


def _hand_over(arguments: list[Any], named: dict[str, Any]) -> list[str]:
    said = _own_channels(arguments, named, ("channels",))
    named.pop("channels", None)  # of a diagram: it meant nothing
    return said


def _of_one_fmu(*names: str) -> Callable[[list[Any], dict[str, Any]], list[str]]:
    """What is chosen of an FMU, which was given call by call."""

    def adapt(arguments: list[Any], named: dict[str, Any]) -> list[str]:
        fmi = importlib.import_module("phyfilter_ctl.fmi")
        taken = _taken(names, named)
        said = [f"{name}=..." for name in taken]
        if "path" in named:
            arguments.insert(0, named.pop("path"))
            said.insert(0, "path=...")
        if arguments and type(arguments[0]).__name__ == "UnpackedFmu":
            unpacked = arguments[0]
            given = {"parameters": {**unpacked.structure, **unpacked.values}, "isolated": unpacked.isolation}
            arguments[0] = fmi.Fmu(unpacked.description.path, **given)
            said.insert(0, "UnpackedFmu(path)")
        if not said:
            return []
        fmu = fmi.Fmu.of(arguments[0] if arguments else named.pop("fmu"))
        arguments[:1] = [replace(fmu, **taken)]
        return [
            f"{', '.join(said)}) is now fmi.Fmu({', '.join(['path', *(f'{name}=...' for name in taken)])})"
        ]

    return adapt


def _cosimulate(arguments: list[Any], named: dict[str, Any]) -> list[str]:
    fmi = importlib.import_module("phyfilter_ctl.fmi")
    said: list[str] = []
    if "parts" in named:
        arguments.insert(0, named.pop("parts"))
        said.append("parts=...")
    wires: Any = ()
    if len(arguments) > 1 and "timepts" in named:
        wires = arguments.pop(1)
        said.append("parts, connections")
    if "connections" in named:
        wires = named.pop("connections")
        said.append("connections=...")
    chosen = _taken(("limits", "isolated", "clocks"), named)
    units = _taken(("units",), named)
    said += [f"{name}=..." for name in (*units, *chosen)]
    if said:
        first = arguments[0] if arguments else named.pop("system")
        if isinstance(first, str | Path):
            packed = {name: value for name, value in chosen.items() if name != "clocks"}
            system = fmi.read_ssp(first, **packed)
        else:
            system = first if isinstance(first, fmi.System) else fmi.System(first)
        parts = _chosen_parts(system.parts, chosen)
        arguments[:1] = [
            replace(system, parts=parts, connections=(*system.connections, *(wires or ())), **units)
        ]
        said = [
            f"{', '.join(said)}) is now cosimulate(fmi.System({{part: fmi.Fmu(path, ...)}}, connections), timepts)"
        ]
    if named.get("tolerance") is None:
        named.pop("absolute_tolerance", None)  # it meant nothing alone
    names = ("step", "scheme", "order", "hold", "tolerance", "absolute_tolerance", "threads", "intermediate")
    return said + _bundled(named, "master", "Master", names)


def _chosen_parts(parts: Mapping[str, Any], chosen: Mapping[str, Any]) -> dict[str, Any]:
    """Parts with what was chosen of all of them, and with clocks by part."""
    fmi = importlib.import_module("phyfilter_ctl.fmi")
    clocks: dict[str, dict[str, Any]] = {name: {} for name in parts}
    for key, times in (chosen.get("clocks") or {}).items():
        owner, _, clock = key.partition(".")
        if owner not in clocks:
            raise ValueError(f"clocks: {key!r} names no part; expected part.clock, of {list(parts)}")
        clocks[owner][clock] = times
    of_all = {name: value for name, value in chosen.items() if name != "clocks" and value is not None}
    made: dict[str, Any] = {}
    for name, part in parts.items():
        made[name] = part
        if isinstance(part, str | Path | fmi.Fmu):
            fmu = fmi.Fmu.of(part)
            made[name] = replace(fmu, clocks={**fmu.clocks, **clocks[name]}, **of_all)
        elif clocks[name]:
            if not isinstance(part, fmi.FmuSteps):
                raise ValueError(f"clocks: {name} has none that can be given here; give them to import_fmu")
            fmu = fmi.Fmu(
                part.description.path,
                parameters={**part.source.structure, **part.values},
                outputs=part.patterns,
                clocks={**part.clocks, **clocks[name]},
                isolated=part.source.isolation,
            )
            made[name] = fmi.import_fmu(fmu, kind=part.instance.kind, name=part.name, step=part.interval)
    return made


def _write_ssp(arguments: list[Any], named: dict[str, Any]) -> list[str]:
    fmi = importlib.import_module("phyfilter_ctl.fmi")
    first = arguments[0] if arguments else named.get("system", named.get("fmus"))
    if isinstance(first, fmi.System):
        return []
    given = dict(zip(("path", "fmus", "wires"), arguments, strict=False))
    given |= _taken(("path", "fmus", "wires"), named)
    rest = _taken(("inputs", "outputs", "parameters"), named)
    ends = {name: value for name, value in rest.items() if value is not None}
    arguments[:] = [fmi.System(given["fmus"], given["wires"], **ends), given["path"]]
    return ["path, fmus, wires) is now write_ssp(fmi.System(fmus, wires, inputs=..., outputs=...), path)"]


def _train(arguments: list[Any], named: dict[str, Any]) -> list[str]:
    taken = _taken(("batch", "patience", "max_epochs", "seed"), named)
    if not taken:
        return []
    adam = importlib.import_module("phyfilter_ctl.design.adjoint").Adam
    named["optimiser"] = replace(named.get("optimiser") or adam(), **taken)
    shown = ", ".join(f"{name}=..." for name in taken)
    return [f"{shown}) is now optimiser=Adam({shown})"]


_FORMER_ARGUMENTS: dict[str, Callable[[list[Any], dict[str, Any]], list[str]]] = {
    "export_fmu": _export_fmu,
    "export_mujoco_fmu": _export_mujoco_fmu,
    "hand_over": _hand_over,
    "import_fmu": _of_one_fmu("parameters", "tolerance", "outputs", "limits", "isolated", "clocks"),
    "check": _of_one_fmu("limits", "isolated"),
    "replay": _of_one_fmu("parameters"),
    "cosimulate": _cosimulate,
    "write_ssp": _write_ssp,
    "train": _train,
}


def _warn(what: str, level: int) -> None:
    warnings.warn(
        f"{what}; the old name goes with 0.4, and\n`python -m phyfilter_ctl.migrate` rewrites or lists it",
        DeprecationWarning,
        stacklevel=level,
    )
