"""The state of a live filter on disk: readable JSON that gives back every bit, and only to the filter that wrote it."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from .. import _signals
from ..results import plain
from .loop import FilterState, PastStep, check_state
from .recursion import Recursion

__all__ = ["FORMAT", "VERSION", "parsed_state", "written_state"]

FORMAT = "phyfilter-live"
VERSION = 1
_LONGEST_FILE = 5_000_000  # bytes; a state has a few hundred
_LONGEST_TIME = 1e15  # s, and samples
_SHORTEST_STEP, _LONGEST_GAP = 1e-9, 1e6  # s; sums of them keep their digits
_KEYS = ("format", "version", "filter", "state", "fresh", "health")
# What `LiveHealth` holds, by type; the entries of its two dictionaries likewise.
_HEALTH: dict[str, tuple[type, ...]] = {
    "accepted": (int,),
    "counts": (dict,),
    "last": (dict,),
    "worst_gap": (int, float),
    "time": (int, float, type(None)),
}


def _identity(recursion: Recursion) -> dict[str, Any]:
    """What makes a filter that filter."""
    sampling = recursion.sampling
    return plain(
        {
            "dt": sampling.dt,
            "method": sampling.method,
            "g": sampling.g,
            "f_theta": sampling.f_theta,
            "precision": sampling.precision,
            "delay": sampling.delay,
            "limit": None if sampling.limit is None else sampling.limit.tolist(),
            "E": recursion.E,
            "poles": [chain.poles.tolist() for chain in recursion.chains],
            "C": [chain.C.tolist() for chain in recursion.chains],
        }
        | ({} if sampling.g_limit is None else {"g_limit": sampling.g_limit.tolist()})
        | ({} if sampling.inertia is None else {"inertia": sampling.inertia})
    )


def written_state(
    recursion: Recursion, state: FilterState, fresh: bool, health: dict[str, Any]
) -> dict[str, Any]:
    """The document, as JSON holds it."""
    head = {"format": FORMAT, "version": VERSION, "filter": _identity(recursion)}
    return head | {"state": plain(state), "fresh": fresh, "health": health}


def parsed_state(
    path: str | os.PathLike[str], recursion: Recursion, n_x: int
) -> tuple[FilterState, bool, dict[str, Any]]:
    """State, whether the filter waits for a sample to start from, and the fields of its health.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        As :meth:`LiveFilter.restore`.
    """
    document = _document(Path(path))
    mine = json.loads(json.dumps(_identity(recursion)))
    theirs = document["filter"]
    for key in (*mine, *(theirs if isinstance(theirs, dict) else ())):
        if key == "inertia" and isinstance(theirs, dict) and key not in theirs:
            continue  # saved before a filter had one: the state says which it took
        saved = theirs.get(key, "nothing") if isinstance(theirs, dict) else theirs
        if key not in mine or saved != mine[key]:
            raise ValueError(
                f"{path}: filter.{key}: saved with {saved!r}, this filter has {mine.get(key)!r}; restore with the "
                "filter that saved it, then retune"
            )
    try:
        state = _state(document["state"], recursion, n_x)
    except (TypeError, KeyError, ValueError) as error:
        raise ValueError(f"{path}: state.{error}") from error
    if not isinstance(document["fresh"], bool):
        raise ValueError(f"{path}: fresh: expected true or false, got {document['fresh']!r}")
    return state, document["fresh"], _health(path, document["health"])


def _document(path: Path) -> dict[str, Any]:
    data = path.read_bytes()
    if len(data) > _LONGEST_FILE:
        raise ValueError(f"{path}: {len(data)} bytes, expected a saved state of a live filter")
    try:
        document = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: expected a saved state of a live filter in JSON: {error}") from error
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise ValueError(f"{path}: format: expected {FORMAT!r}, a saved state of a live filter")
    version = document.get("version")
    if version != VERSION or isinstance(version, bool):
        newer = "; update the library" if isinstance(version, int) and version > VERSION else ""
        raise ValueError(f"{path}: version: expected {VERSION}, got {version!r}{newer}")
    if set(document) != set(_KEYS):
        odd = ", ".join(sorted(set(document) ^ set(_KEYS)))
        raise ValueError(f"{path}: {odd}: expected the keys {', '.join(_KEYS)} and no others")
    return document


def _state(given: dict[str, Any], recursion: Recursion, n_x: int) -> FilterState:
    """Raises TypeError, KeyError or ValueError that begins with the key."""
    if not isinstance(given, dict) or set(given) != set(FilterState._fields):
        raise ValueError(f": expected the entries {', '.join(FilterState._fields)}")
    kind = np.dtype(recursion.sampling.precision)
    n_f = recursion.channels(n_x)

    def vector(name: str, values: Any, *shape: int) -> np.ndarray:
        return _signals.array(name, values, shape).astype(kind)

    def inertia(name: str, values: Any) -> np.ndarray | None:
        if values is None:
            return None
        found = _signals.inertia(name, values, n_x).astype(kind)
        return found if found.ndim else np.full(n_x, found)

    def interval(i: int, entry: dict[str, Any]) -> PastStep:
        if not isinstance(entry, dict) or set(entry) != set(PastStep._fields):
            raise ValueError(f"past[{i}]: expected the entries {', '.join(PastStep._fields)}")
        g = tuple(vector(f"past[{i}].g", entry["g"], 2, n_x))
        f_theta = tuple(vector(f"past[{i}].f_theta", entry["f_theta"], 2, n_f))
        pair = entry["inertia"]
        if pair is not None and not (isinstance(pair, list) and len(pair) == 2):
            raise ValueError(f"past[{i}].inertia: expected those at both ends")
        first, last = (inertia(f"past[{i}].inertia", M) for M in pair or (None, None))
        both = None if first is None or last is None else (first, last)
        return PastStep(
            seconds(f"past[{i}].dt", entry["dt"], above=_SHORTEST_STEP),
            (g[0], g[1]),
            (f_theta[0], f_theta[1]),
            both,
        )

    def seconds(name: str, value: Any, above: float | None = None) -> float:
        found = _signals.number(name, value, "s", least=0.0, above=above)
        if found > _LONGEST_GAP:
            raise ValueError(f"{name}: expected at most {_LONGEST_GAP:g} s, got {found:g}")
        return found

    carry = given["carry"]
    state = FilterState(
        vector("w", given["w"], n_f, recursion.order),
        vector("carry", carry, n_f, recursion.order) if kind == np.float32 else None,
        vector("x", given["x"], n_x),
        None if given["g"] is None else vector("g", given["g"], n_x),
        vector("f_theta", given["f_theta"], n_f),
        inertia("inertia", given["inertia"]),
        given["held"] is True,
        seconds("gap", given["gap"]),
        tuple(interval(i, entry) for i, entry in enumerate(given["past"])),
    )
    check_state(recursion, state)
    return state


def _health(path: str | os.PathLike[str], given: Any) -> dict[str, Any]:
    def right(value: Any, types: tuple[type, ...]) -> bool:
        if isinstance(value, bool) or not isinstance(value, types):
            return False
        return not isinstance(value, int | float) or abs(value) <= _LONGEST_TIME

    good = isinstance(given, dict) and set(given) == set(_HEALTH)
    good = good and all(right(given[key], types) for key, types in _HEALTH.items())
    good = good and all(right(count, (int,)) and count >= 0 for count in given["counts"].values())
    good = good and all(right(time, (int, float)) for time in given["last"].values())
    if not good or given["accepted"] < 0 or given["worst_gap"] < 0.0:
        raise ValueError(
            f"{path}: health: expected {', '.join(_HEALTH)}, counts and times, got {str(given)[:80]}"
        )
    return given
