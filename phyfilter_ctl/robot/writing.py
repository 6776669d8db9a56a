"""A first version of a robot file for a log, with comments to complete it by."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from textwrap import wrap
from typing import TYPE_CHECKING

from ..filterfile.table import parsed
from ..logfiles.suggesting import is_force, is_velocity
from .document import FORMAT, VERSION, factor_of, preset_path, presets

if TYPE_CHECKING:
    from ..logfiles import Field, LogFile, Topic

__all__ = ["describe_log"]

_WIDE = 110
_IN_SPACE = """
[constants]
mass = "FILL IN"    # kg
gravity = 9.80665    # m/s^2

[signals.v]
{v}
frame = "ENU"    # FILL IN: or NED, NWU; FLU, FRD of the body

[signals.force]    # FILL IN: the known force, or what it is made of
{force}
frame = "ENU"
between = "hold"    # or "linear"

[model]    # vectors are in ENU and FLU here
x = "v"
unit = "m/s"
M = "mass"
g = "force - [0, 0, mass * gravity]"
"""
_ALONG = """
[constants]
mass = "FILL IN"    # kg; of what turns, kg m^2

[signals.v]{v_note}
{v}
{force}
[model]
x = "v"
unit = "{unit}"
M = "mass"
"""
_FORCE = """
[signals.force]    # FILL IN: whether it is the known force
{force}
between = "hold"    # or "linear"
"""
_SPACE = 3  # axes


def describe_log(log: LogFile) -> str:
    """A first robot file for a log: the preset whose topics it has, else a form to fill in, and all that it holds.

    Parameters
    ----------
    log : LogFile

    Returns
    -------
    str
        TOML; what has to be filled in is marked by ``FILL IN``.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from phyfilter_ctl import open_log
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "short.csv"
    ...     _ = path.write_text("t,v,u\\n0,0.0,1.0\\n1,0.1,1.0\\n")
    ...     print(describe_log(open_log(path, time_unit="s")).splitlines()[0])
    # Robot of short.csv: M x' = g + f
    """
    scores = {name: _share(name, log) for name in presets()}
    best = max(scores, key=lambda name: scores[name])
    body = _from_preset(best, log) if scores[best] > 0.5 else _form(log)
    head = [
        f"# Robot of {log.path.name}: M x' = g + f",
        f'format = "{FORMAT}"',
        f"version = {VERSION}",
    ]
    return "\n".join([*head, *body, "", "# The log holds:", *_contents(log)]) + "\n"


def _table(values: Mapping[str, object], key: str) -> dict[str, object]:
    found = values.get(key)
    return dict(found) if isinstance(found, dict) else {}


def _share(name: str, log: LogFile) -> float:
    """Share of a preset's signals that the log has."""
    signals = _table(parsed(preset_path(name)), "signals")
    there = [_has(_table(signals, signal), log) for signal in signals]
    return sum(there) / len(there)


def _has(signal: Mapping[str, object], log: LogFile) -> bool:
    topics = [t for t in log.topics if t.name == signal.get("topic", t.name)]
    fields = signal.get("fields", [signal.get("field")])
    names = [str(name) for name in fields] if isinstance(fields, list) else []
    return any(set(names) <= _names(topic) for topic in topics)


def _names(topic: Topic) -> set[str]:
    elements = {f"{f.name}[{i}]" for f in topic.fields for i in range(f.shape[0] if f.shape else 0)}
    return {field.name for field in topic.fields} | elements


def _from_preset(name: str, log: LogFile) -> list[str]:
    values = parsed(preset_path(name))
    asks, signals = _table(values, "asks"), _table(values, "signals")
    lines = [f'preset = "{name}"    # its keys may be given here again, one by one', ""]
    if asks:
        lines += ["[constants]", *(f'{key} = "FILL IN"    # {what}' for key, what in asks.items())]
    if "mechanism" in values:
        lines += [
            "[mechanism]",
            'file = "FILL IN"    # URDF or MJCF',
            'joints = ["FILL IN"]    # in the order of the log',
        ]
    missing = [key for key in signals if not _has(_table(signals, key), log)]
    for key in missing:
        given = {k: v for k, v in _table(signals, key).items() if k in ("topic", "field", "fields")}
        lines += ["", f"[signals.{key}]    # FILL IN: the log has not what the preset reads: {given}"]
    return lines


def _form(log: LogFile) -> list[str]:
    """By names and units of the log's fields: velocities along axes with gravity, else what there is."""
    most = max(log.topics, key=lambda t: t.count)
    v_topic, v = _of_kind(log, is_velocity)
    f_topic, force = _of_kind(log, is_force)
    in_space = len(v) == _SPACE and all(re.sub(r"[\[(].*", "", f.name).strip()[-1:] in "xyz" for f in v)
    if in_space:
        force = force if len(force) == _SPACE else ()
        return _IN_SPACE.format(
            v=_signal(log, v_topic or most, v, "m/s"),
            force=_signal(log, f_topic or most, force, "N", ("fx", "fy", "fz")),
        ).splitlines()
    own = v[0].unit if v and v[0].unit and factor_of(v[0].unit) else "m/s"
    frame = '\nframe = "none"' if len(v) == _SPACE else ""
    known = len(force) in (1, len(v)) and bool(force)
    frame_g = '\nframe = "none"' if len(force) == _SPACE else ""
    text = _ALONG.format(
        v_note="" if v else "    # FILL IN: the velocity",
        v=_signal(log, v_topic or most, v, own, ("FILL IN",)) + frame,
        force=_FORCE.format(force=_signal(log, f_topic or most, force, "N") + frame_g) if known else "",
        unit=own,
    )
    lines = text.splitlines()
    return (
        [*lines, 'g = "force"']
        if known
        else [*lines, '# g = "..."    # the known part of M x\', where there is one']
    )


def _of_kind(log: LogFile, is_kind: Callable[[str, str], bool]) -> tuple[Topic | None, tuple[Field, ...]]:
    """The topic with most samples that has such fields, and those, no arrays."""
    found = [(t, tuple(f for f in t.fields if not f.shape and is_kind(f.name, f.unit))) for t in log.topics]
    return max((each for each in found if each[1]), key=lambda each: each[0].count, default=(None, ()))


def _signal(
    log: LogFile, topic: Topic, fields: Sequence[Field], unit: str, missing: Sequence[str] = ()
) -> str:
    """Where a signal is and its unit: what the log says, else a guess to be looked at."""
    names = [f.name for f in fields] or list(missing)
    lines = [f"topic = {json.dumps(topic.name)}"] if len(log.topics) > 1 else []
    lines.append(f"field = {json.dumps(names[0])}" if len(names) == 1 else f"fields = {json.dumps(names)}")
    said = fields[0].unit if fields and len({f.unit for f in fields}) == 1 else ""
    lines.append(
        f'unit = "{said}"' if said and factor_of(said) else f'unit = "{unit}"    # FILL IN: or another'
    )
    return "\n".join(lines)


def _contents(log: LogFile) -> list[str]:
    lines: list[str] = []
    for topic in log.topics:
        lines.append(f"#   {topic.name}: {topic.count} samples, every {topic.clock.dt:.4g} s")
        words = [
            f"{f.name}{list(f.shape) if f.shape else ''}{f' ({f.unit})' if f.unit else ''}"
            for f in topic.fields
        ]
        lines += wrap(", ".join(words), _WIDE, initial_indent="#     ", subsequent_indent="#     ")
    return lines
