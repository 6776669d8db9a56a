"""A robot file, read and checked: TOML over a preset, key by key."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from .. import _units
from ..filterfile.table import TomlTable, parsed
from .clocks import Between
from .frames import ATTITUDES, BODY, WORLD

__all__ = ["FORMAT", "VERSION", "RobotSignal", "presets", "tables_of"]

FORMAT = "phyfilter-robot"
VERSION = 1

_TOP = (
    "format",
    "version",
    "preset",
    "name",
    "time_unit",
    "time",
    "constants",
    "clocks",
    "signals",
    "expressions",
    "mechanism",
    "model",
)
_SIGNAL = (
    "topic",
    "field",
    "fields",
    "unit",
    "frame",
    "rotation",
    "frames",
    "between",
    "gap",
    "delay",
    "clock",
)
_MODEL = ("x", "clock", "channels", "unit", "M", "g", "f_theta", "f_theta_file", "features", "label")
_MECHANISM = ("file", "joints")
_TABLES = ("constants", "clocks", "signals", "expressions", "mechanism", "model")
_PRESETS = Path(__file__).with_name("presets")
_NONE = "none"
_GAP = 0.5  # s
# Beside what _units knows: what logs of robots call acceleration in, and how some of them spell units.
_UNITS = {"g": (9.80665, {"m": 1, "s": -2}), "": (1.0, {}), "us": (1e-6, {"s": 1})}


@dataclass(frozen=True)
class RobotSignal:
    """Where a signal stands in a log, and what it is there.

    Attributes
    ----------
    topic : str
        Empty: the log's only one.
    fields : tuple of str
        Columns, or arrays of them.
    is_number : bool
        Whether it is a number, of one column, and no vector.
    unit : str
        In the log; empty: as the log itself says.
    frame : str
        Of a vector of three: ENU, NED, NWU, FLU, FRD or none; empty where not said.
    rotation : str
        Of an attitude: wxyz, xyzw or rpy; else empty.
    frames : (str, str)
        Of an attitude: from which frame into which.
    between : {"linear", "hold"}
        What it does from a sample to the next.
    gap : float
        Longest time between two samples across which that holds, s.
    delay : float
        s by which it acts later than it is stamped.
    clock : str
        Field of times to take instead of the topic's own; empty: those.
    """

    topic: str
    fields: tuple[str, ...]
    is_number: bool
    unit: str
    frame: str
    rotation: str
    frames: tuple[str, str]
    between: Between
    gap: float
    delay: float
    clock: str

    @property
    def columns(self) -> int | None:
        """How many it must have; None for any number."""
        if self.rotation:
            return 3 if self.rotation == "rpy" else 4
        return 3 if self.frame not in ("", _NONE) else None


def presets() -> tuple[str, ...]:
    """Names of the robot files shipped with the library."""
    return tuple(sorted(path.stem for path in _PRESETS.glob("*.toml")))


def preset_path(name: str) -> Path:
    """The file of a preset."""
    return _PRESETS / f"{name}.toml"


def tables_of(path: Path) -> tuple[TomlTable, str]:
    """The checked tables of a robot file over those of its preset, and the preset's name."""
    own = TomlTable(path, "", parsed(path))
    own.refuse_other_formats(FORMAT, VERSION, "robot")
    own.refuse_unknown(_TOP)
    base: Mapping[str, object] = {}
    name = own.text("preset") if "preset" in own else ""
    if name:
        if name not in presets():
            raise own.error("preset", f"there is no {name!r}; {nearest(name, presets())}")
        base = parsed(preset_path(name))
    for key in _TABLES:
        if key in own:
            own.table(key)
    merged = TomlTable(path, "", _merged(base, own.values))
    for key, unit in TomlTable(path, "", base).table("asks").values.items() if "asks" in base else ():
        if key not in merged.table("constants"):
            raise merged.error(f"constants.{key}", f"missing: the preset {name!r} asks for it: {unit}")
    if "model" not in merged:
        raise merged.error("model", "missing: expected a table with x, and M and g where they are known")
    merged.table("model").refuse_unknown(_MODEL)
    if "mechanism" in merged:
        merged.table("mechanism").refuse_unknown(_MECHANISM)
    return merged, name


def _merged(base: Mapping[str, object], own: Mapping[str, object]) -> dict[str, object]:
    """Key by key, tables in tables too; "none" takes a key out."""
    result = dict(base)
    for key, value in own.items():
        under = result.get(key)
        if value == _NONE and key not in ("frame",):
            result.pop(key, None)
        elif isinstance(value, Mapping) and (under is None or isinstance(under, Mapping)):
            if "field" in value or "fields" in value:
                under = {k: v for k, v in (under or {}).items() if k not in ("field", "fields")}
            result[key] = _merged(under or {}, value)
        else:
            result[key] = value
    return result


def signal_of(table: TomlTable) -> RobotSignal:
    """A signal's table, checked."""
    table.refuse_unknown(_SIGNAL)
    if ("field" in table) == ("fields" in table):
        raise table.error("field", "expected either field (a number) or fields (a vector)")
    fields = (table.text("field"),) if "field" in table else tuple(table.texts("fields"))
    rotation = _choice(table, "rotation", ATTITUDES, "")
    frame = _choice(table, "frame", (*WORLD, *BODY, _NONE), "")
    if not fields:
        raise table.error("fields", "expected at least one, got none")
    if rotation and (frame or "frames" not in table):
        raise table.error(
            "frames", 'an attitude has two, such as frames = ["FRD", "NED"], from body to world'
        )
    if not rotation and "frames" in table:
        raise table.error("frames", "expected of an attitude only; give rotation, or frame of a vector")
    unit = table.text("unit") if "unit" in table else ("1" if rotation in ("wxyz", "xyzw") else "")
    if factor_of(unit) is None:
        raise table.error(
            "unit", f"not understood: {unit!r}; write such as m/s, deg, rad/s, rpm, N, g, us, 1"
        )
    gap = table.number("gap") if "gap" in table else _GAP
    if gap <= 0.0:
        raise table.error("gap", f"expected seconds above 0, got {gap}")
    return RobotSignal(
        topic=table.text("topic") if "topic" in table else "",
        fields=fields,
        is_number="field" in table,
        unit=unit,
        frame=frame,
        rotation=rotation,
        frames=_frames(table) if rotation else ("", ""),
        between="hold" if _choice(table, "between", get_args(Between), "linear") == "hold" else "linear",
        gap=gap,
        delay=table.number("delay") if "delay" in table else 0.0,
        clock=table.text("clock") if "clock" in table else "",
    )


def _frames(table: TomlTable) -> tuple[str, str]:
    found = table.texts("frames")
    pairs = [(body, world) for body in BODY for world in WORLD]
    if len(found) == 2 and ((pair := (found[0], found[1])) in pairs or pair[::-1] in pairs):
        return pair
    raise table.error(
        "frames",
        f"expected one of {', '.join(BODY)} and one of {', '.join(WORLD)}, body first if it turns body to world, got "
        f"{found}",
    )


def _choice(table: TomlTable, key: str, choices: tuple[Any, ...], usual: str) -> str:
    if key not in table:
        return usual
    if (found := table.text(key)) not in choices:
        raise table.error(key, f"expected one of {', '.join(choices)}, got {found!r}")
    return found


def factor_of(unit: str) -> tuple[float, Mapping[str, int]] | None:
    """Factor to SI and the powers of the base units; None for what is not understood."""
    if unit in _UNITS:
        return _UNITS[unit]
    found = _units.unit_definition(unit)
    return None if found.exponents is None else (found.factor, found.exponents)


def nearest(name: str, known: tuple[str, ...]) -> str:
    """What a misspelt name may have meant, in words."""
    near = difflib.get_close_matches(name, known, n=1)
    return (f"did you mean {near[0]!r}? " if near else "") + f"expected one of {', '.join(known)}"
