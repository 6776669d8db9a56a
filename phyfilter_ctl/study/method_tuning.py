"""Tuning of methods at equal margin: the fastest loop that is allowed, and gains as TOML, one table a method."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from ..execution import Executor, Report, silent
from ..filterfile.table import TomlTable, parsed

__all__ = ["TunedMethod", "command_jitter", "fastest", "least_error", "read_tuned", "tuned_text"]

Method = TypeVar("Method")
Name = TypeVar("Name", bound=str)
T = TypeVar("T")

# What a tuning finds beside the gains, and digits of it in the file.
_FIGURES = {"modulus_margin": 4, "mae": 5, "jitter": 4}


@dataclass(frozen=True)
class TunedMethod(Generic[Method]):
    """A method and what its tuning found.

    Attributes
    ----------
    method : Method
    modulus_margin : float
        Least over channels and loads.
    mae : float
        Median over the tuning flights of the mean error, m.
    jitter : float
        Of the commands on these flights, see :func:`command_jitter`.
    interior : bool
        Whether candidates on both sides of it were tried, see :func:`least_error`; False where a wider search could
        find better gains.
    """

    method: Method
    modulus_margin: float
    mae: float
    jitter: float
    interior: bool = True


def fastest(speeds: Sequence[float] | np.ndarray, allowed: Callable[[float], T | None]) -> T | None:
    """What is allowed at the highest speed at which something is, by bisection.

    Parameters
    ----------
    speeds : sequence of float
        Ascending. What is allowed at one of them is taken to be allowed at all below.
    allowed : function of a speed
        What is allowed at it, such as a method that has the margin there; None where nothing is.

    Returns
    -------
    object or None
        None where nothing is allowed at the first.

    Examples
    --------
    >>> fastest([1.0, 1.5, 2.0, 2.5], lambda speed: f"at {speed}" if speed**2 < 5.0 else None)
    'at 2.0'
    """
    found, low, high = allowed(float(speeds[0])), 0, len(speeds)
    if found is None:
        return None
    while high - low > 1:
        middle = (low + high) // 2
        faster = allowed(float(speeds[middle]))
        if faster is None:
            high = middle
        else:
            low, found = middle, faster
    return found


def least_error(
    name: str,
    candidates: Iterable[tuple[str, Method]],
    tuned: Callable[[Method], TunedMethod[Method] | None],
    *,
    wanted: str = "the margin that is asked for",
    report: Report = silent,
    executor: Executor | None = None,
) -> TunedMethod[Method]:
    """The candidate with the least error of those that have what is asked for: a comparison at equal margin.

    For every speed of an estimator the loop around it is as fast as the margin lets it be (:func:`fastest`); of these
    the one that flies best is the method's. Methods that are tuned like this differ by what they are, not by how much
    margin each was allowed to spend.

    Parameters
    ----------
    name : str
        Of the method, for messages.
    candidates : iterable of (str, method)
        What is said of each, and the method with what is not found here; in the order of what is searched, so that the
        first and the last are the edges of the search.
    tuned : function (method) -> TunedMethod or None
        Finds the rest and flies it; None where nothing has what is asked for.
    wanted : str
        What is asked for, for the message.
    report : callable
        Told of every candidate.
    executor : Executor, optional
        What tunes them; None tunes one after the other, here. The answer is the same.

    Returns
    -------
    TunedMethod
        Not ``interior`` where it is the first or the last of several candidates. A neighbour that has not what is asked
        for bounds the search as well as one that flies worse.

    Raises
    ------
    ValueError
        If there is none.

    Examples
    --------
    >>> def flown(speed):
    ...     return None if speed > 3.0 else TunedMethod(speed, 0.5, abs(speed - 1.8), 0.0)
    >>> found = least_error("pd", [(f"{speed}", speed) for speed in (1.0, 2.0, 4.0)], flown)
    >>> found.method, found.interior
    (2.0, True)
    """
    listed = list(candidates)
    answers = (executor or Executor(1)).map(
        tuned, [candidate for _, candidate in listed], names=[text for text, _ in listed], report=report
    )
    kept = [(found, k) for k, found in enumerate(answers) if found is not None]
    if not kept:
        raise ValueError(f"{name}: no gains have {wanted}")
    best, k = min(kept, key=lambda entry: entry[0].mae)
    return replace(best, interior=len(listed) == 1 or 0 < k < len(listed) - 1)


def command_jitter(commands: ArrayLike, scale: float) -> float:
    """Noise of sampled commands over a scale: rms of their change from sample to sample, over sqrt 2.

    Parameters
    ----------
    commands : (B, N, n) array
        Flights, samples, actuators.
    scale : float
        In the unit of the commands.

    Examples
    --------
    >>> noise = np.random.default_rng(0).normal(0.0, 0.1, (1, 100_000, 1))
    >>> round(command_jitter(5.0 + noise, 1.0), 3)
    0.1
    """
    change = np.diff(_signals.array("commands", commands, ("B", "N", "n")), axis=1)
    return float(np.sqrt(0.5 * np.mean(change**2)) / scale)


def tuned_text(header: Sequence[str], found: Mapping[Name, TunedMethod[Any]], gains: Sequence[str]) -> str:
    """Tuned methods as TOML.

    Parameters
    ----------
    header : sequence of str
        Comment lines.
    found : mapping of str to TunedMethod
    gains : sequence of str
        Names of the methods' gains.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> entry = TunedMethod(SimpleNamespace(bandwidth=2.5), 0.51234, 0.0123456, 0.02)
    >>> print(tuned_text(["Found by hand."], {"pd": entry}, ["bandwidth"]), end="")
    # Found by hand.
    <BLANKLINE>
    [pd]
    bandwidth = 2.5
    modulus_margin = 0.5123
    mae = 0.01235
    jitter = 0.0200
    interior = true
    """
    lines = [f"# {line}" for line in header]
    for name, entry in found.items():
        lines += ["", f"[{name}]", *(f"{gain} = {getattr(entry.method, gain)}" for gain in gains)]
        lines += [f"{key} = {getattr(entry, key):.{digits}f}" for key, digits in _FIGURES.items()]
        lines.append(f"interior = {str(entry.interior).lower()}")
    return "\n".join(lines) + "\n"


def read_tuned(
    path: Path, methods: Sequence[Name], make: Callable[..., Method], gains: Sequence[str], *, command: str
) -> dict[Name, TunedMethod[Method]]:
    """Read what :func:`tuned_text` wrote.

    Parameters
    ----------
    path : Path
    methods : sequence of str
        Those that must be there.
    make : function
        A method from its name and, in their order, its gains.
    gains : sequence of str
    command : str
        What makes the file, for the message.

    Returns
    -------
    dict of str to TunedMethod

    Raises
    ------
    ValueError
        If it is no TOML, or a method or a number of one is missing or no number.
    """
    top, found = TomlTable(path, "", parsed(path)), (*_FIGURES, "interior")
    tables = {name: top.table(name) for name in methods if name in top}
    missing = [name for name in methods if name not in tables] or [
        f"{key} of {name}" for name in methods for key in (*gains, *found) if key not in tables[name]
    ]
    if missing:
        raise ValueError(f"{path.name}: no entry for {', '.join(missing)}; {command} makes them")
    return {
        name: TunedMethod(
            make(name, *(table.number(gain) for gain in gains)),
            *(table.number(key) for key in _FIGURES),
            interior=table.values["interior"] is True,
        )
        for name, table in tables.items()
    }
