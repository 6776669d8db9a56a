"""A session on disk: JSON that people can read, and that anyone may have written.

The front end writes it (web/state/session.js), as it does without Python too. Version 1::

    {
      "format": "phyfilter-session",
      "version": 1,
      "design": {poles, numerator, sampling, assume, limits},    as in messages
      "family": "bessel",                                        or "custom"
      "pins": [{"name": "before", "design": {...}}],
      "recording": {"name": "flight.csv", "size": 81234, "sha256": "...", "columns": {...}},     or null
      "views": {"bode": {...}},                                  whatever each view has to keep
      "history": {"past": [{...}], "future": [{...}]}            designs, the oldest first
    }

Only ``format``, ``version`` and ``design`` must be there. The recording's data is not: its name, size and digest tell
whether a file is the same.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NoReturn, TypeVar

from ..recording import Recording
from .checking import Fields, MessageError, shown
from .designs import FAMILIES, read_design

__all__ = [
    "FORMAT",
    "LARGEST_SESSION",
    "VERSION",
    "checked_session",
    "load_session",
    "read_session",
    "recording_beside",
]

FORMAT, VERSION = "phyfilter-session", 1
LARGEST_SESSION = 900_000  # characters; the longest history has 300,000
_MOST_STEPS = 200  # of undo, and of redo
_MOST_PINS = 32
_MOST_ENTRIES, _DEEPEST = 5000, 8  # in what views keep
_LARGEST_RECORDING = 10**13  # bytes

_Entry = TypeVar("_Entry")


def read_session(text: str) -> dict[str, object]:
    """The session in the text of a file.

    Parameters
    ----------
    text : str
        JSON, as the designer saves it.

    Returns
    -------
    dict
        All fields of the schema, checked; as the front end takes it.

    Raises
    ------
    MessageError
        If it is no session, is of a newer version, or a field is wrong.

    Examples
    --------
    >>> from phyfilter_ctl.app.designs import Design
    >>> text = json.dumps({"format": "phyfilter-session", "version": 1, "design": Design().as_json()})
    >>> read_session(text)["design"]["poles"]
    [[-20.0, 0.0], [-20.0, 0.0]]
    """
    try:
        value: object = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError):
        raise MessageError("session", "expected a session that the designer saved, in JSON") from None
    return checked_session(value)


def load_session(path: str | os.PathLike[str]) -> dict[str, object]:
    """The session in a file.

    Parameters
    ----------
    path : str or path
        As the designer saved it.

    Returns
    -------
    dict
        As :func:`read_session` gives it.

    Raises
    ------
    ValueError
        If it is none; named by the path.
    OSError
        If it cannot be read.
    """
    with Path(path).open(encoding="utf-8") as file:
        try:
            text = file.read(LARGEST_SESSION + 1)
        except UnicodeDecodeError:
            text = ""
    if len(text) > LARGEST_SESSION:
        raise ValueError(f"{path}: expected at most {LARGEST_SESSION} characters of a session")
    try:
        return read_session(text)
    except MessageError as error:
        raise ValueError(f"{path}: {error}") from error


def checked_session(value: object) -> dict[str, object]:
    """A session, checked as :func:`read_session` does.

    Parameters
    ----------
    value : object
        As the JSON reader gives it.

    Returns
    -------
    dict

    Raises
    ------
    MessageError
        As there.
    """
    fields = Fields.of(value, "session")
    if fields.values.get("format") != FORMAT:
        raise fields.error("format", f"expected {FORMAT!r}: this file is no session of the designer")
    version = fields.integer("version", 1, 10**6)
    if version > VERSION:
        raise fields.error(
            "version",
            f"the session was saved by a newer designer, in version {version} of the format, and this one reads up "
            f"to {VERSION}: update phyfilter-ctl",
        )
    fields.only("format", "version", "design", "family", "pins", "recording", "views", "history")
    history = fields.fields("history") if "history" in fields else Fields({}, "session.history.")
    history.only("past", "future")
    return {
        "format": FORMAT,
        "version": VERSION,
        "design": _design(fields),
        "family": fields.choice("family", ("custom", *FAMILIES)) if "family" in fields else "custom",
        "pins": _each(fields, "pins", _MOST_PINS, _pin),
        "recording": _recording(fields.fields("recording")) if "recording" in fields else None,
        "views": _plain(fields.get("views"), "session.views") if "views" in fields else {},
        "history": {name: _each(history, name, _MOST_STEPS, _step) for name in ("past", "future")},
    }


def recording_beside(kept: Mapping[str, object], folder: Path) -> tuple[Recording | None, list[str]]:
    """The recording that a session was tried on, where the same file is in a folder.

    Parameters
    ----------
    kept : mapping
        As :func:`read_session` gives it.
    folder : Path
        That of the session's file.

    Returns
    -------
    recording : Recording or None
        None where no file has its name, size and digest.
    messages : list of str
        What is to be looked at.
    """
    from .imports import import_log, read_roles
    from .inbox import Source

    if kept.get("recording") is None:
        return None, []
    fields = Fields.of(kept["recording"], "recording")
    name = Path(fields.text("name")).name
    path = folder / name
    if "columns" not in fields or not path.is_file() or path.stat().st_size != fields.values.get("size"):
        return None, []
    with path.open("rb") as file:
        if "sha256" in fields and hashlib.file_digest(file, "sha256").hexdigest() != fields.text("sha256"):
            return None, []
    try:
        return import_log(Source(path, name), read_roles(fields.fields("columns")))
    except ValueError as error:
        return None, [str(error)]


# -- inside -----------------------------------------------------------------------------------------------------


def _design(fields: Fields) -> dict[str, object]:
    return read_design(fields).as_json()


def _step(value: object, where: str) -> dict[str, object]:
    return _design(Fields({"design": value}, f"{where}."))


def _pin(value: object, where: str) -> dict[str, object]:
    fields = Fields.of(value, where)
    fields.only("name", "design")
    return {"name": fields.text("name"), "design": _design(fields)}


def _recording(fields: Fields) -> dict[str, object]:
    fields.only("name", "size", "sha256", "columns")
    found: dict[str, object] = {"name": fields.text("name")}
    if "size" in fields:
        found["size"] = fields.integer("size", 0, _LARGEST_RECORDING)
    if "sha256" in fields:
        digest = fields.text("sha256")
        if len(digest) != 64 or set(digest) - set("0123456789abcdef"):
            raise fields.error("sha256", "expected 64 hexadecimal digits")
        found["sha256"] = digest
    if "columns" in fields:
        found["columns"] = _plain(fields.get("columns"), f"{fields.where}columns")
    return found


def _each(fields: Fields, key: str, most: int, read: Callable[[object, str], _Entry]) -> list[_Entry]:
    if key not in fields:
        return []
    where, values = f"{fields.where}{key}", fields.get(key)
    if not isinstance(values, list):
        raise MessageError(where, f"expected a list, got {shown(values)}")
    if len(values) > most:
        raise MessageError(where, f"expected at most {most} entries, got {len(values)}")
    return [read(value, f"{where}[{i}]") for i, value in enumerate(values)]


def _plain(value: object, where: str) -> Mapping[str, object]:
    """An object of what JSON holds, kept as it is: only the front end knows what it means."""
    if not isinstance(value, dict):
        raise MessageError(where, f"expected an object, got {shown(value)}")
    waiting: list[tuple[object, int]] = [(value, 0)]
    seen = 0
    while waiting:
        entry, depth = waiting.pop()
        seen += 1
        if seen > _MOST_ENTRIES or depth > _DEEPEST:
            raise MessageError(where, f"expected at most {_MOST_ENTRIES} entries in {_DEEPEST} levels")
        if isinstance(entry, dict):
            waiting += [(inside, depth + 1) for pair in entry.items() for inside in pair]
        elif isinstance(entry, list):
            waiting += [(inside, depth + 1) for inside in entry]
        elif not (entry is None or isinstance(entry, bool)):
            _check_plain(entry, where)
    return value


def _check_plain(entry: object, where: str) -> None:
    holder = Fields({"value": entry}, f"{where}.")
    if isinstance(entry, str):
        holder.text("value", LARGEST_SESSION)
    else:
        holder.number("value", -1e300, 1e300)


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(name)
