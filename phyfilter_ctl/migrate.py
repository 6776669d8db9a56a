"""Code of 0.2 with the names of 0.3: calls, imports and doctests rewritten where that is mechanical.

    python -m phyfilter_ctl.migrate FILE_OR_FOLDER ...            shows what would change
    python -m phyfilter_ctl.migrate --write FILE_OR_FOLDER ...    changes it

Reads Python, notebooks that jupytext keeps as Python, and the Python blocks of Markdown. What only a reader can decide
is listed by line; ``docs/migration.md`` has the table.
"""

from __future__ import annotations

import argparse
import ast
import difflib
import doctest
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from ._renamed import FORMER_OPTIONS, FUNCTIONS, HOMES, OPTIONS

__all__ = ["migrated"]

_LOOP = "kp", "kd", "actuator", "delay", "inertia_ratio", "g", "command_limit"
_BOUNDED = "noise", "inertia_error", "rate", "actuation", "position_noise", "implementation"
_GAUSSIAN = "noise", "actuation", "position_noise"
_TO_REWRITE = (
    "CutDiagram",
    "Signals",
    "attitude_gains",
    "bound_trade_off",
    "findings_of",
    "known_force",
    "known_torque",
    "position_controller",
    "load_signals",
    "margin_trade_off",
    "numerator_of_type",
    "read_reference",
    "variance_trade_off",
    "write_reference",
)
_MODULES = {"pf", "phyfilter_ctl", "filterfile", *(home.split(".")[1] for home in HOMES.values())}
# A lag as Loop takes it: a number.
_LAG = re.compile(r"(?:ct|control)\.(?:tf|TransferFunction)\(\[?1(?:\.0)?\]?, \[([^,\[\]]+), 1(?:\.0)?\]\)")
# Classes, and functions that kept their arguments.
_RENAMED = {
    "BoundResult": "ErrorBound",
    "InertiaVerdict": "InertiaCertificate",
    "LivePolicy": "LiveRules",
    "LoopConstraint": "LoopGoal",
    "LoopMargin": "FilterMargins",
    "LoopMargins": "Margins",
    "LoopMarginsLike": "MarginsLike",
    "NoiseLevel": "Noise",
    "MarginTradeOff": "TradeOff",
    "PriorMargin": "FilterMargins",
    "RatioMargins": "FilterMargins",
    "RobotCheck": "Check",
    "SignalMargin": "SystemMargins",
}
# Names that moved to another module without a change.
_MOVED = {
    "FilterPlace": "phyfilter_ctl.loops",
    "OperatingPoint": "phyfilter_ctl.loops",
    "SampledModel": "phyfilter_ctl.loops",
    "linearize_sampled": "phyfilter_ctl",
    "sampled_open_loop": "phyfilter_ctl",
    "Implementation": "phyfilter_ctl",
    "gauss_markov": "phyfilter_ctl",
    "TradeOff": "phyfilter_ctl",
    "Interval": "phyfilter_ctl.results",
    "Finding": "phyfilter_ctl.recording",
    "EstimatorComparison": "phyfilter_ctl.baselines",
}
_PORTS = "channels", "inertia", "units", "max_channels", "arrays", "record", "clocks", "xcp"
_EXPERIMENT = "solver", "author", "description"
_MASTER = "step", "scheme", "order", "hold", "tolerance", "absolute_tolerance", "threads", "intermediate"
# Functions of FMUs, and arguments that they had.
_OF_FMI = {
    "export_fmu": (*_PORTS, *_EXPERIMENT),
    "export_mujoco_fmu": ("author", "description"),
    "hand_over": ("channels",),
    "import_fmu": ("path", "parameters", "tolerance", "outputs", "limits", "isolated", "clocks"),
    "check": ("limits", "isolated"),
    "replay": ("parameters",),
    "cosimulate": (*_MASTER, "parts", "connections", "units", "limits", "isolated", "clocks"),
    "write_ssp": ("fmus", "wires", "inputs", "outputs", "parameters"),
}
_FMI_NAMES = {"Fmu", "FmuExperiment", "FmuPorts", "Master", "System", "read_ssp"}


@dataclass
class _Call:
    """A call taken apart: texts of its arguments, and what its new form needs."""

    positional: list[str]
    named: dict[str, str]
    stars: list[str]
    prefix: str
    needs: set[str] = field(default_factory=set)

    def taken(self, *names: str) -> dict[str, str]:
        return {name: self.named.pop(name) for name in names if name in self.named}

    def value(self, name: str, arguments: list[str]) -> str:
        self.needs.add(name.partition(".")[0])
        return f"{self.prefix}{name}({', '.join(arguments)})"

    def of_fmi(self, name: str, arguments: list[str]) -> str:
        """A value object of the room ``fmi``."""
        if self.prefix and not self.prefix.endswith("fmi."):
            return f"{self.prefix}fmi.{name}({', '.join(arguments)})"
        return self.value(name, arguments)

    def bundle(self, into: str, kind: str, names: tuple[str, ...], *first: str) -> None:
        """Keywords put into the value object that has them now; the ``first`` of them without their names."""
        taken = {name: text for name, text in self.taken(*names).items() if text != "None"}
        if taken:
            plain = [taken.pop(name) for name in first if name in taken]
            arguments = [*plain, *(f"{name}={text}" for name, text in taken.items())]
            self.named[into] = self.of_fmi(kind, arguments)

    def sampled(self, *names: str) -> None:
        """What a filter sampled in the call itself takes there."""
        if self.positional and re.fullmatch(r".*\.sampled\(.*\)", self.positional[0]):
            told = "".join(f", {name}={text}" for name, text in self.taken(*names).items())
            self.positional[0] = f"{self.positional[0][:-1]}{told})"

    def loop(self) -> list[str]:
        """A Loop of what is given of it; none of nothing."""
        given = {name: text for name, text in self.taken(*_LOOP).items() if text != "None"}
        if "actuator" in given and (lag := _LAG.fullmatch(given["actuator"])):
            given["actuator"] = lag[1]
        gains = [given.pop("kp"), given.pop("kd")] if {"kp", "kd"} <= given.keys() else []
        gains = [] if gains in (["0.0", "0.0"], ["0", "0"]) else gains
        arguments = [*gains, *(f"{name}={text}" for name, text in given.items()), *self.stars]
        self.stars = []
        return [self.value("Loop", arguments)] if arguments else []

    def disturbance(self, kind: str, names: tuple[str, ...]) -> list[str]:
        residual, others = self.taken("residual").get("residual"), self.taken(*names)
        others = {name: text for name, text in others.items() if text != "None"}
        if kind == "Bounded" and residual is not None and not others:
            return [residual]
        if residual is None and not others and kind == "Bounded":
            return []
        arguments = [] if residual in (None, "None") else [str(residual)]
        return [self.value(kind, [*arguments, *(f"{name}={text}" for name, text in others.items())])]

    def written(self, name: str, arguments: list[str]) -> str:
        rest = [*(f"{key}={text}" for key, text in self.named.items()), *self.stars]
        return self.value(name, [*arguments, *rest])


def _export(call: _Call) -> str:
    call.sampled("channels", "inertia", "units")
    if {"ports", "experiment"} & call.named.keys() and call.named.keys() & {*_PORTS, *_EXPERIMENT}:
        raise KeyError("export_fmu")  # of both forms: by hand
    call.bundle("ports", "FmuPorts", _PORTS)
    call.bundle("experiment", "FmuExperiment", _EXPERIMENT)
    return call.written("export_fmu", call.positional)


def _export_robot(call: _Call) -> str:
    call.bundle("experiment", "FmuExperiment", _EXPERIMENT)
    return call.written("export_mujoco_fmu", call.positional)


def _one_fmu(name: str) -> Callable[[_Call], str]:
    def rewrite(call: _Call) -> str:
        if "path" in call.named:
            call.positional.insert(0, call.named.pop("path"))
        chosen = call.taken(*_OF_FMI[name])
        if not call.positional or re.match(r"(\w+\.)*Fmu\(", call.positional[0]):
            raise KeyError(name)
        chosen = {key: text for key, text in chosen.items() if text != "None"}
        if chosen:
            given = [f"{key}={text}" for key, text in chosen.items()]
            call.positional[0] = call.of_fmi("Fmu", [call.positional[0], *given])
        return call.written(name, call.positional)

    return rewrite


def _cosimulation(call: _Call) -> str:
    if {"limits", "isolated", "clocks"} & call.named.keys():
        raise KeyError("cosimulate")  # of which parts, a reader says
    if "parts" in call.named:
        call.positional.insert(0, call.named.pop("parts"))
    given = call.positional[1:]
    wires = given[0] if given else call.named.pop("connections", "None")
    units = [f"units={text}" for text in call.taken("units").values()]
    system = call.positional[0]
    if wires not in ("[]", "()", "None") or units:
        parts = [system, wires] if wires not in ("[]", "()", "None") else [system]
        system = call.of_fmi("System", [*parts, *units])
    times = call.named.pop("timepts", None)
    call.positional = [system] if times is None else [system, times]
    call.bundle("master", "Master", _MASTER, "step")
    return call.written("cosimulate", call.positional)


def _package(call: _Call) -> str:
    given = dict(zip(("path", "fmus", "wires"), call.positional, strict=False)) | call.taken(
        "path", "fmus", "wires"
    )
    ends = [f"{name}={text}" for name, text in call.taken("inputs", "outputs", "parameters").items()]
    wires = [] if given["wires"] in ("[]", "()") else [given["wires"]]
    return call.written("write_ssp", [call.of_fmi("System", [given["fmus"], *wires, *ends]), given["path"]])


def _hand(call: _Call) -> str:
    call.sampled("channels")
    if "channels" in call.named:
        raise KeyError("hand_over")
    return call.written("hand_over", call.positional)


def _of_filter(name: str) -> Callable[[_Call], str]:
    return lambda call: call.written(name, [*call.positional, *call.loop()])


def _saturation(call: _Call) -> str:
    told = call.taken("g")
    told = {} if told.get("g") == '"saturated"' else told
    loop = call.loop()
    call.named = told | call.named
    return call.written("saturation_margin", [*call.positional, *loop])


def _disk(call: _Call) -> str:
    skew = call.taken("skew")
    found = call.written("margins", call.positional)
    return f"{found}.disk_margin(skew={skew['skew']})" if skew else f"{found}.disk"


def _signal(call: _Call) -> str:
    system, *signal = call.positional
    if signal:
        call.named = {"at": signal[0]} | call.named
    elif "signal" in call.named:
        call.named = {"at": call.named.pop("signal")} | call.named
    return call.written("margins", [system])


def _bound(call: _Call) -> str:
    return call.written("error_bound", [*call.positional, *call.disturbance("Bounded", _BOUNDED)])


def _variance(call: _Call) -> str:
    if len(call.positional) > 1 or not ({"noise", "residual"} & call.named.keys() or call.stars):
        raise KeyError("error_variance")  # as it is now
    stars, call.stars = call.stars, []
    if stars:
        return call.written("error_variance", [*call.positional, call.value("Gaussian", stars)])
    return call.written("error_variance", [*call.positional, *call.disturbance("Gaussian", _GAUSSIAN)])


def _tracking(kind: str, names: tuple[str, ...]) -> Callable[[_Call], str]:
    def rewrite(call: _Call) -> str:
        loop = call.loop() or [call.value("Loop", [])]
        return call.written("tracking_error", [*call.positional, *loop, *call.disturbance(kind, names)])

    return rewrite


def _analyze(call: _Call) -> str:
    if len(call.positional) > 1 or not ({*_LOOP, "residual", *_BOUNDED} & call.named.keys()):
        raise KeyError("analyze")
    stars, call.stars = call.stars, []
    loop, disturbance = call.loop(), call.disturbance("Bounded", _BOUNDED)
    call.stars = stars
    if disturbance and not loop:
        call.named = {"disturbance": disturbance.pop()} | call.named
    return call.written("analyze", [*call.positional, *loop, *disturbance])


def _goal(call: _Call) -> str:
    stars, call.stars = call.stars, []
    loop = call.loop()
    call.stars = stars
    return call.written("LoopGoal", [*call.positional, *loop])


def _learn(call: _Call) -> str:
    call.named = {"recordings" if name == "logs" else name: text for name, text in call.named.items()}
    call.taken("wiener", "intervals")
    made: dict[str, str] = {}
    for option, (kind, names) in OPTIONS.items():
        own = {
            "workers" if name == "scheduler" else name: text
            for name, text in call.taken(*names).items()
            if text != "None" or name == "dc_gain"
        }
        if own.keys() == {(first := names[0])} and option in ("shape", "reading"):
            made[option] = own[first]  # a form, or what reads a file
        elif own:
            first = [own.pop("form")] if "form" in own else []
            made[option] = call.value(kind, [*first, *(f"{name}={text}" for name, text in own.items())])
    if (offset := call.taken("label_offset").get("label_offset", "False")) != "False":
        made["label"] = '"offset"' if offset == "True" else f'"offset" if {offset} else "given"'
    if made.keys() & call.named.keys():
        raise KeyError("learn")  # old and new options of one kind
    call.named = made | call.named
    text = call.written("learn", call.positional)
    call.needs.discard("learn")
    return text


def _axes(call: _Call) -> str:
    logs, learner = call.positional
    asked = re.fullmatch(r"lambda (\w+): (?:[\w.]+\.)?learn\(\1, (.*)\)", learner, re.S)
    if asked is None or "folds" in call.named:
        raise KeyError("learn_axes")  # for a reader
    if read := call.taken("read"):
        call.named["reading"] = read["read"]
    return call.written("learn", [logs, f'{asked[2]}, axes="compare"'])


def _poles(call: _Call) -> str:
    return call.written("frequency_response", call.positional) + ".pole_zero_map"


def _noise(name: str) -> Callable[[_Call], str]:
    return lambda call: call.written(f"Noise.{name}", call.positional)


def _by_speed(call: _Call) -> str:
    if "percentile" in call.named:
        call.named["by"] = f"lambda log: log.speed({call.named.pop('percentile')})"
    if len(call.positional) > 1:
        call.named["fraction"] = call.positional.pop()
    return call.written("split", call.positional)


def _by_figure(call: _Call) -> str:
    call.named = {"by": call.named.pop("key")} | call.named
    return call.written("split", call.positional)


_ROTORS = "mass", "J", "arm", "torque_ratio", "gravity", "rotor_max", "motor_lag", "delay"
_PAIRS = {
    "servo": (("servo_bandwidth", "servo_damping"), ("40.0", "1.0")),
    "nominal": (("nominal_mass", "nominal_J"), ("None", "None")),
}


def _attitude(call: _Call) -> str:
    gains = call.taken("kR", "kw", "lead_filter")
    if len(gains) < 3 or call.stars:
        raise KeyError("attitude_controller")
    vehicle = call.value("Multirotor", [f"{name}={text}" for name, text in call.taken(*_ROTORS).items()])
    whole = {text.removesuffix(f".{name}") for name, text in gains.items()}
    made = whole.pop() if len(whole) == 1 else call.value("AttitudeGains", list(gains.values()))
    return call.written("attitude_controller", [vehicle, made])


def _manipulator(call: _Call) -> str:
    for name, (parts, usual) in _PAIRS.items():
        if found := call.taken(*parts):
            texts = [found.get(part, other) for part, other in zip(parts, usual, strict=True)]
            call.named[name] = f"({', '.join(texts)})"
    return call.written("aerial_manipulator", call.positional)


def _changes(call: _Call) -> str:
    if not call.positional or not re.fullmatch(r"[\w.]+(\(.*\))?", call.positional[0], re.S):
        raise KeyError("detect_changes")
    found, *part = call.positional
    rest = [*part, *(f"{key}={text}" for key, text in call.named.items()), *call.stars]
    return f"{found}.changes({', '.join(rest)})"


def _compared(call: _Call) -> str:
    call.prefix = ""
    return call.written("compare", call.positional)


def _typed(name: str) -> Callable[[_Call], str]:
    """A number as numerator is the type; coefficients stay, and so does what only its name is known of."""

    def rewrite(call: _Call) -> str:
        text = call.named.get("numerator", "")
        if text in ('"lowpass"', "'lowpass'"):
            del call.named["numerator"]
        elif re.fullmatch(r"\d+", text):
            call.named = {"type" if key == "numerator" else key: each for key, each in call.named.items()}
        else:
            raise KeyError(name)
        return call.written(name, call.positional)

    return rewrite


_OF_ADAM = "batch", "patience", "max_epochs", "seed"


def _train(call: _Call) -> str:
    more = ", ".join(f"{name}={text}" for name, text in call.taken(*_OF_ADAM).items())
    text = call.named.get("optimiser", "None")
    made = re.fullmatch(r"([\w.]*Adam)\((.*)\)", text)
    if made:
        call.named["optimiser"] = f"{made[1]}({made[2]}{', ' if made[2] else ''}{more})"
    elif text == "None":
        call.named["optimiser"] = call.value("Adam", [more])
    else:
        raise KeyError("train")
    return call.written("train", call.positional)


_OF_LIMITS = "max_steps", "time_limit", "workers", "executor", "progress"


def _run(name: str) -> Callable[[_Call], str]:
    def written(call: _Call) -> str:
        limits = {
            name: text for name, text in call.taken(*_OF_LIMITS).items() if text not in ("None", "False")
        }
        limits = {"workers" if name == "executor" else name: text for name, text in limits.items()}
        if limits and "limits" in call.named:
            raise KeyError(name)
        if limits:
            call.named["limits"] = "{" + ", ".join(f'"{key}": {text}' for key, text in limits.items()) + "}"
        if at := call.taken("t_eval"):
            if len(call.positional) < 2:
                raise KeyError(name)
            call.positional[1] = f"({call.positional[1]}, {at['t_eval']})"
        squeeze = call.taken("squeeze")
        return call.written(name, call.positional) + (f"(squeeze={squeeze['squeeze']})" if squeeze else "")

    return written


_CALLS: dict[str, Callable[[_Call], str]] = {
    "detect_changes": _changes,
    "compare_estimators": _compared,
    "place_poles": _typed("place_poles"),
    "lowpass": _typed("lowpass"),
    "simulate": _run("simulate"),
    "simulate_batch": _run("simulate_batch"),
    "train": _train,
    "known_noise": _noise("known"),
    "measurement_noise": _noise("at_rest"),
    "split_by_speed": _by_speed,
    "split_flights": _by_figure,
    "attitude_controller": _attitude,
    "aerial_manipulator": _manipulator,
    "prior_margin": _of_filter("margins"),
    "loop_margin": _of_filter("margins"),
    "disk_margin": _disk,
    "signal_margin": _signal,
    "moving_inertia": _of_filter("inertia_tolerance"),
    "saturation_margin": _saturation,
    "largest_bandwidth": _of_filter("largest_bandwidth"),
    "ultimate_bound": _bound,
    "error_variance": _variance,
    "tracking_tube": _tracking("Bounded", _BOUNDED),
    "tracking_deviation": _tracking("Gaussian", _GAUSSIAN),
    "analyze": _analyze,
    "LoopConstraint": _goal,
    "learn": _learn,
    "learn_axes": _axes,
    "pole_zero_map": _poles,
    "export_fmu": _export,
    "export_mujoco_fmu": _export_robot,
    "hand_over": _hand,
    "import_fmu": _one_fmu("import_fmu"),
    "check": _one_fmu("check"),
    "replay": _one_fmu("replay"),
    "cosimulate": _cosimulation,
    "write_ssp": _package,
}
# Calls of these in their new form are left alone.
_KEPT = {
    *("saturation_margin", "largest_bandwidth", "error_variance", "analyze", "learn"),
    *("attitude_controller", "aerial_manipulator"),
    *("lowpass", "place_poles"),
    *("simulate", "simulate_batch", "train"),
    *_OF_FMI,
}
# Where a name that a rule writes is from, if not from the package.
_HOME: dict[str, str] = dict.fromkeys(("Multirotor", "AttitudeGains"), "phyfilter_ctl.controllers")
_HOME["compare"] = "phyfilter_ctl.baselines"
_HOME |= {"Adam": "phyfilter_ctl.design.adjoint"}
_HOME |= dict.fromkeys(_FMI_NAMES, "phyfilter_ctl.fmi")
_GONE = {*_CALLS, *_RENAMED} - _KEPT


def migrated(source: str) -> tuple[str, list[str]]:
    """Python source with the names of today, and what is left to do by hand.

    Parameters
    ----------
    source : str

    Returns
    -------
    (str, list of str)

    Examples
    --------
    >>> print(migrated("import phyfilter_ctl as pf\\nm = pf.loop_margin(F, kp=10.0, kd=6.0, delay=0.01)\\n")[0])
    import phyfilter_ctl as pf
    m = pf.margins(F, pf.Loop(10.0, 6.0, delay=0.01))
    <BLANKLINE>
    """
    try:
        tree = ast.parse(source)
    except SyntaxError as error:
        return source, [f"line {error.lineno}: not Python: {error.msg}"]
    names = _imported(tree)
    needs: set[str] = set()
    done = 0
    while (call := _next(tree, source, names)) is not None:
        node, rewrite = call
        text, wanted = rewrite
        source = _replaced(source, node, text)
        needs |= wanted
        tree = ast.parse(source)
        done += 1
    source = _doctests(_imports(source, needs))
    return source, _left(source)


def _imported(tree: ast.AST) -> set[str]:
    """Names that a file takes from this library, and those that it gives the library."""
    found = {"pf", "phyfilter_ctl"}  # as pages call it without saying so again
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (
            node.level or (node.module or "").startswith("phyfilter_ctl")
        ):
            found |= {entry.asname or entry.name for entry in node.names}
        elif isinstance(node, ast.Import):
            found |= {e.asname or e.name for e in node.names if e.name.split(".")[0] == "phyfilter_ctl"}
    return found


def _next(tree: ast.AST, source: str, names: set[str]) -> tuple[ast.Call, tuple[str, set[str]]] | None:
    """A call of an old name that has none inside it, with its new text."""
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    for node in sorted(calls, key=lambda node: (node.end_lineno or 0, node.end_col_offset or 0)):
        function = node.func
        if isinstance(function, ast.Name):
            name, prefix = function.id, ""
            known = name in names or name in _GONE
        elif isinstance(function, ast.Attribute):
            prefix = f"{ast.get_source_segment(source, function.value)}."
            name, prefix = function.attr, prefix.removesuffix("analysis.")
            known = bool(re.fullmatch(r"[\w.]+", prefix)) and prefix.split(".")[0] in names
        else:
            continue
        if not known or name not in _CALLS:
            continue
        if name in _KEPT and not _is_old(node, name):
            continue
        texts = [_segment(source, argument) for argument in node.args]
        named = {k.arg: _segment(source, k.value) for k in node.keywords if k.arg}
        stars = [f"**{_segment(source, k.value)}" for k in node.keywords if k.arg is None]
        made = _Call(texts, named, stars, prefix)
        try:
            text = _CALLS[name](made)
        except KeyError:
            continue
        return node, (text, made.needs if not made.prefix else set())
    return None


def _is_old(node: ast.Call, name: str) -> bool:
    """Whether a call of a function that kept its name is one of its old form."""
    given = {keyword.arg for keyword in node.keywords}
    if name == "train":
        return bool(given & {*_OF_ADAM[:3]}) or {"seed", "optimiser"} <= given
    if name in ("simulate", "simulate_batch"):
        return bool(given & {*_OF_LIMITS, "t_eval", "squeeze"})
    if name == "attitude_controller":
        return not node.args and "mass" in given
    if name == "aerial_manipulator":
        return any(part in given for parts, _ in _PAIRS.values() for part in parts)
    if name in ("lowpass", "place_poles"):
        return "numerator" in given
    if name == "error_variance":
        return len(node.args) == 1 and bool(given & {"noise", "residual", None})
    if name == "saturation_margin":
        return bool(given & ({*_LOOP, None} - {"g"}))
    if name == "write_ssp" and len(node.args) > 2:
        return True
    if name == "cosimulate" and len(node.args) > 1 and "timepts" in given:
        return True
    if name in _OF_FMI:
        return bool(given & {*_OF_FMI[name]})
    if name == "learn":
        return bool(given & FORMER_OPTIONS)
    if name == "largest_bandwidth":
        return bool(given & {*_LOOP, None})
    return len(node.args) == 1 and bool(given & {*_LOOP, "residual", *_BOUNDED})


def _segment(source: str, node: ast.AST) -> str:
    text = ast.get_source_segment(source, node) or ""
    return text if "#" in text or '"""' in text else re.sub(r"\s*\n\s*", " ", text)


def _replaced(source: str, node: ast.Call, text: str) -> str:
    lines = source.splitlines(keepends=True)
    assert node.end_lineno is not None
    assert node.end_col_offset is not None
    first, last = lines[node.lineno - 1].encode(), lines[node.end_lineno - 1].encode()
    before, after = first[: node.col_offset].decode(), last[node.end_col_offset :].decode()
    lines[node.lineno - 1 : node.end_lineno] = [before + text + after]
    return "".join(lines)


def _imports(source: str, needs: set[str]) -> str:
    """Imports without what is gone and with what is needed, and other uses of classes by their new names."""
    tree = ast.parse(source)
    wanted: dict[str, set[str]] = {}
    aliases: list[tuple[int, int, str]] = []
    missing = needs - _imported(tree)
    for name in missing & _HOME.keys():
        wanted.setdefault(_HOME[name], set()).add(name)
    missing -= _HOME.keys()
    ours = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        and not node.level
        and (node.module or "").startswith("phyfilter_ctl")
    ]
    # The package last: it takes what the others no longer have.
    for node in sorted(ours, key=lambda node: node.module == "phyfilter_ctl"):
        entries = {entry.name: entry.asname for entry in node.names}
        kept, changed = dict(entries), False
        for name, alias in entries.items():
            new = _RENAMED.get(name)
            elsewhere = _MOVED.get(name)
            if new is not None and alias is None:
                del kept[name]
                if node.module == "phyfilter_ctl.diagram":  # which margins left
                    missing.add(new)
                else:
                    kept[new] = None
                changed = True
            elif name in _GONE:
                del kept[name]
                changed = True
            elif (
                elsewhere is not None
                and node.module != elsewhere
                and elsewhere != "phyfilter_ctl"
                and alias is None
            ):
                del kept[name]
                wanted.setdefault(elsewhere, set()).add(name)
                changed = True
            elif elsewhere == "phyfilter_ctl" and (node.module or "").split(".")[1:2] in (
                ["simulation"],
                ["analysis"],
            ):
                del kept[name]
                missing.add(name)
                changed = True
        if node.module == "phyfilter_ctl" and missing:
            kept |= dict.fromkeys(missing)
            missing, changed = set(), True
        if changed:
            ordered = sorted(kept, key=lambda n: (not n.isupper(), not n[:1].isupper(), n))
            texts = [name if kept[name] is None else f"{name} as {kept[name]}" for name in ordered]
            indent = " " * node.col_offset
            text = f"{indent}from {node.module} import {', '.join(texts)}\n" if texts else ""
            if len(text) > 110 and not indent:
                text = f"from {node.module} import (\n" + "".join(f"    {each},\n" for each in texts) + ")\n"
            aliases.append((node.lineno - 1, node.end_lineno or node.lineno, text))
    if missing:
        wanted.setdefault("phyfilter_ctl", set()).update(missing)
    lines = source.splitlines(keepends=True)
    if wanted:
        made = "".join(
            f"from {module} import {', '.join(sorted(names))}\n" for module, names in sorted(wanted.items())
        )
        if aliases:
            start, end, text = aliases[0]
            indent = re.match(r"\s*", lines[start])
            aliases[0] = start, end, text + (indent[0] if indent else "") + made
        else:
            lines.insert(_after_imports(tree), made)
    for start, end, text in sorted(aliases, reverse=True):
        lines[start:end] = [text] if text else []
    source = "".join(lines)
    for old, new in _RENAMED.items():
        source = re.sub(rf"(?<![\w\"'/`.]){old}(?![\w\"'`])", new, source)
        source = re.sub(rf"\b(pf|phyfilter_ctl)\.{old}\b", rf"\1.{new}", source)
    return source


def _after_imports(tree: ast.Module) -> int:
    found = [node.end_lineno or 0 for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
    return found[-1] if found else 0


def _doctests(source: str) -> str:
    """Examples in docstrings, each docstring's together."""
    if ">>> " not in source:
        return source
    lines = source.splitlines(keepends=True)
    for block in _blocks(lines):
        prompts = [re.match(r"\s*(>>> |\.\.\. ?)", lines[i]) for i in block]
        indent = re.match(r"\s*", lines[block[0]])
        margin = indent[0] if indent else ""
        code = "".join(
            lines[i][len(found[0]) :] or "\n" for i, found in zip(block, prompts, strict=True) if found
        )
        new, _ = migrated(code) if any(name in code for name in {*_CALLS, *_RENAMED, *_MOVED}) else (code, [])
        if new != code and ">>> " not in new:
            examples = doctest.DocTestParser().get_examples("")
            assert not examples
            parsed = ast.parse(new)
            starts = {node.lineno for node in parsed.body}
            told = [
                f"{margin}{'>>>' if i in starts else '...'} {text}".rstrip() + "\n"
                for i, text in enumerate(new.splitlines(), 1)
            ]
            lines[block[0]] = "".join(told)
            for i in block[1:]:
                lines[i] = ""
    return "".join(lines)


def _blocks(lines: list[str]) -> Iterator[list[int]]:
    """Lines of examples without output between them."""
    block: list[int] = []
    for i, line in enumerate(lines):
        if re.match(r"\s*(>>> |\.\.\.( |$))", line):
            block.append(i)
        elif block:
            yield block
            block = []
    if block:
        yield block


def _left(source: str) -> list[str]:
    """Uses of names that are gone, by line."""
    uses = {
        name: re.compile(rf"(?<![\w/.`]){name}(?!\w)|\b(?:pf|phyfilter_ctl|analysis)\.{name}\b")
        for name in _GONE
    }
    uses |= {
        name: re.compile(rf"\.{name}\(") for name in ("inertia_between", "inertia_within", "inertia_hull")
    }
    found = [
        f"line {number}: {name}: {line.strip()[:90]}"
        for number, line in enumerate(source.splitlines(), 1)
        for name, use in sorted(uses.items())
        if use.search(line)
    ]
    return found + _by_hand(source)


def _by_hand(source: str) -> list[str]:
    """Names that are elsewhere now, or of which a call has to be thought over, by line."""
    found: list[tuple[int, str]] = []
    for node in ast.walk(ast.parse(source)):
        name = getattr(getattr(node, "func", None), "attr", getattr(getattr(node, "func", None), "id", ""))
        if isinstance(node, ast.Call) and name in ("cosimulate", "hand_over") and _is_old(node, name):
            given = [keyword.arg for keyword in node.keywords if keyword.arg in _OF_FMI[name]]
            found.append(
                (node.lineno, f"{name}({', '.join(f'{each}=...' for each in given)}): docs/migration.md says")
            )
        if (
            isinstance(node, ast.ImportFrom)
            and not node.level
            and (node.module or "").startswith("phyfilter_ctl")
        ):
            for name in (alias.name for alias in node.names):
                home = HOMES.get(name, "")
                if name in _TO_REWRITE:
                    found.append((node.lineno, f"{name} is now {FUNCTIONS[name][1]}"))
                elif home.startswith(f"{node.module}."):
                    found.append((node.lineno, f"{name} is imported from {home}"))
        elif isinstance(node, ast.Call) and _is_learn(node.func) and _is_old(node, "learn"):
            old = sorted({str(keyword.arg) for keyword in node.keywords} & FORMER_OPTIONS)
            found.append(
                (node.lineno, f"learn({', '.join(old)}): give them to shape, sampling, search or reading")
            )
        elif (
            isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in _MODULES
        ):
            if node.attr in _TO_REWRITE:
                found.append((node.lineno, f"{node.attr} is now {FUNCTIONS[node.attr][1]}"))
            elif HOMES.get(node.attr, "").startswith(f"phyfilter_ctl.{node.value.id}."):
                found.append((node.lineno, f"{node.attr} is imported from {HOMES[node.attr]}"))
    return [f"line {number}: {text}" for number, text in found]


def _is_learn(function: ast.expr) -> bool:
    return getattr(function, "id", getattr(function, "attr", "")) == "learn"


def _markdown(text: str) -> tuple[str, list[str]]:
    """The Python blocks of a page."""
    left: list[str] = []

    def block(found: re.Match[str]) -> str:
        new, more = migrated(found[2])
        left.extend(more)
        return f"{found[1]}{new}{found[3]}"

    new = re.sub(
        r"(^```(?:\{?python\}?|py|pycon|\{code-cell\}[^\n]*)[^\n]*\n)(.*?)(^```)",
        block,
        text,
        flags=re.M | re.S,
    )
    return new, left


def main(arguments: list[str] | None = None) -> int:
    """Rewrite what is named; 1 where something is left to do by hand.

    Parameters
    ----------
    arguments : list of str, optional
        Of the command line; None: those of the process.

    Returns
    -------
    int
    """
    parser = argparse.ArgumentParser(
        prog="python -m phyfilter_ctl.migrate",
        description=(__doc__ or "").split("\n\n")[0],
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("paths", nargs="+", type=Path, help="files or folders")
    parser.add_argument(
        "--write", action="store_true", help="change the files instead of showing what would change"
    )
    asked = parser.parse_args(arguments)
    files = [
        file
        for path in asked.paths
        for file in (sorted(path.rglob("*")) if path.is_dir() else [path])
        if file.suffix in (".py", ".md") and ".venv" not in file.parts
    ]
    status = 0
    for file in files:
        before = file.read_text(encoding="utf-8")
        after, left = (_markdown if file.suffix == ".md" else migrated)(before)
        if after != before and asked.write:
            file.write_text(after, encoding="utf-8")
            print(f"{file}: rewritten")
        elif after != before:
            told = difflib.unified_diff(
                before.splitlines(), after.splitlines(), str(file), str(file), lineterm="", n=1
            )
            print("\n".join(told))
        for each in left:
            print(f"{file}: by hand: {each}")
            status = 1
    return status


if __name__ == "__main__":
    sys.exit(main())
