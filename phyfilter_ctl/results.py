"""What designers, learners, tuners and planners return has in common: a status that says what to try, and its looks.

Every result is a frozen dataclass. Its ``repr`` fits on a screen, a notebook shows it as a table, and ``to_dict`` makes
of it what JSON holds.
"""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import Field, fields, is_dataclass
from enum import Enum, StrEnum
from typing import Any, ClassVar, NamedTuple, Protocol, TypeGuard, TypeVar

import numpy as np

from ._renamed import former_field

__all__ = ["Interval", "PerChannel", "Result", "SearchResult", "Status", "plain"]

_LISTED = 6  # entries of a sequence that repr lists
_WIDTH = 100  # characters of a value in repr
_TEXT = 400  # characters of a message in repr
# Units by name, where a name means the same in every result.
_FREQUENCIES = ("bandwidth", "crossing", "frequency", "slowest")
_TIMES = ("block", "delay_margin", "dt", "horizon", "span", "t_reached", "time_constant", "worst_gap")
_UNITS = (
    dict.fromkeys(_FREQUENCIES, "rad/s")
    | {f"{margin}_frequency": "rad/s" for margin in ("gain", "phase", "delay", "modulus")}
    | dict.fromkeys(_TIMES, "s")
    | {"phase_margin": "rad"}
)


class Status(StrEnum):
    """How a search ended. A member equals its word, which is what JSON holds; ``meaning`` says what to try.

    Attributes
    ----------
    meaning : str

    Examples
    --------
    >>> Status.ITERATION_LIMIT == "iteration_limit", f"{Status.ITERATION_LIMIT}"
    (True, 'iteration_limit')
    >>> Status("iteration_limit").meaning
    'it was still getting better when the iterations ran out: raise max_iterations, or the tolerance'
    """

    meaning: str

    CONVERGED = "converged", "found: nothing near it is better"
    OPTIMAL = "optimal", "found: nothing at all is better"
    ITERATION_LIMIT = (
        "iteration_limit",
        "it was still getting better when the iterations ran out: raise max_iterations, or the tolerance",
    )
    STALLED = (
        "stalled",
        "no way further down before the tolerance was met; usable: else scale the data, raise the tolerance or start "
        "elsewhere",
    )
    AT_BOUND = (
        "at_bound",
        "found at the end of the range allowed: widen the range, or take a lower order or other data",
    )
    ORDER_ADDS_NOTHING = (
        "order_adds_nothing",
        "a lower order does as well, and is returned: take it, or try another form",
    )
    NOT_IDENTIFIED = (
        "not_identified",
        "the data do not show F at low frequency at this order, a lower one is returned: add flights with steady "
        "residuals, or take the low-pass form",
    )
    REJECTED = (
        "rejected",
        "no better than what was given, which is returned: take more data, or change less of it",
    )
    CANCELLED = "cancelled", "the callback stopped it: the best so far is returned"
    DIVERGED = (
        "diverged",
        "it left the stable region; the best before that is returned: take smaller steps, or coordinates that are "
        "always stable",
    )
    FAILED = "failed", "no answer, what was given is returned: the message says why"
    LIMITED = "limited", "found: beyond it what was asked for does not hold"
    UNLIMITED = "unlimited", "all of the range will do: widen it"
    INFEASIBLE = "infeasible", "not even the lower end of the range will do: ask for less, or start lower"
    PROVEN = "proven", "it holds, and what proves it is in the result"
    REFUTED = "refuted", "it does not hold: the result has a case in which it fails"
    OPEN = "open", "neither proven nor refuted: ask for a narrower range, or for a stronger method"
    KEPT = "kept", "no new plan: the one before goes on; the message says why"
    BRAKING = "braking", "no plan at all: every axis brakes; the message says why"

    def __new__(cls, word: str, meaning: str = "") -> Status:
        """A member from its word, with what it means."""
        member = str.__new__(cls, word)
        member._value_ = word
        member.meaning = meaning
        return member


class Result:
    """Looks and JSON of a frozen dataclass; a class derives from it and is declared with ``repr=False``.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True, repr=False)
    ... class Fit(Result):
    ...     gains: np.ndarray
    ...     status: Status
    >>> fit = Fit(np.arange(3000.0), Status.CONVERGED)
    >>> fit
    Fit(
        gains=array of shape (3000,), 0 to 2999,
        status='converged',
    )
    >>> sorted(fit.to_dict())
    ['gains', 'status']
    """

    __slots__ = ()

    # What to_dict, repr and describe give, properties too; () for all fields.
    _figures: ClassVar[tuple[str, ...]] = ()
    # Those that a result shows where it is an entry of another one; its status is shown in any case.
    _answer: ClassVar[tuple[str, ...]] = ()
    # Units of figures whose name alone does not say it; "{}" is the result's own unit.
    _units: ClassVar[Mapping[str, str]] = {}

    def figures(self) -> dict[str, tuple[Any, str]]:
        """The answer, as repr, notebooks and pages show it: value and unit of each figure.

        Returns
        -------
        dict of str to (value, unit)
            The unit is "" where there is none, or where it is not known.

        Examples
        --------
        >>> from phyfilter_ctl import PhyFilter, error_bound
        >>> error_bound(PhyFilter([20.0]).sampled(0.01, units={"f": "N"}), {1: 3.0}).figures()["noise"]
        (0.0, 'N')
        """
        return {name: (value, self._unit_of(name)) for name, value in self._shown()}

    def _unit_of(self, name: str) -> str:
        unit, own = self._units.get(name, _UNITS.get(name, "")), getattr(self, "unit", "")
        return unit.format(own) if own or "{}" not in unit else ""

    def to_dict(self) -> dict[str, Any]:
        """What JSON can hold of it.

        Returns
        -------
        dict
            By name. Arrays become lists, complex numbers pairs [real, imaginary], statuses their words, infinite
            numbers "Infinity" and "-Infinity"; None is what is not known or not defined.

        Examples
        --------
        >>> from phyfilter_ctl import PhyFilter, error_bound
        >>> round(error_bound(PhyFilter([20.0]), {1: 3.0}).to_dict()["bound"], 9)
        0.15
        """
        names = self._figures or tuple(field.name for field in _shown(self))
        return {name: plain(getattr(self, name), infinite=True) for name in names}

    def describe(self) -> str:
        """The figures as text, one line each; without those that are empty.

        Returns
        -------
        str

        Examples
        --------
        >>> from phyfilter_ctl import PhyFilter, Recording
        >>> log = Recording.from_arrays(x=np.zeros((3, 1)), dt=0.1, label=np.ones((3, 1)))
        >>> print(log.compare({"nothing": np.zeros((3, 1))}).describe())
        channels            x[0]
        rmse                {'nothing': 1}
        channel rmse        {'nothing': array([1])}
        """
        return in_lines(
            {name.replace("_", " "): _in_words(value, unit) for name, (value, unit) in self.figures().items()}
        )

    def _shown(self) -> list[tuple[str, object]]:
        """The answer, by name: figures that follow from the fields too."""
        names = self._figures or tuple(field.name for field in _shown(self) if field.repr)
        return [(name, getattr(self, name)) for name in names]

    def __repr__(self) -> str:
        lines = [f"    {name}={_measured(value, unit)},\n" for name, (value, unit) in self.figures().items()]
        return f"{type(self).__name__}(\n{''.join(lines)})"

    def _repr_html_(self) -> str:
        rows = [
            f"<tr><th style='text-align:left'>{html.escape(name)}</th>"
            f"<td style='text-align:left'>{html.escape(_in_words(value, unit))}</td></tr>"
            for name, (value, unit) in self.figures().items()
        ]
        return f"<table><caption>{type(self).__name__}</caption>{''.join(rows)}</table>"


_Found = TypeVar("_Found", covariant=True)


class SearchResult(Protocol[_Found]):
    """What every search returns: :func:`~phyfilter_ctl.learn`, ``tune``, ``fit``, ``least_bound`` and the others."""

    @property
    def best(self) -> _Found:
        """What was looked for, a filter, a model or a differentiator: the best one found, whatever the status."""
        ...


class Interval(NamedTuple):
    """An estimate with the ends of its confidence interval.

    Attributes
    ----------
    value, low, high : float

    Examples
    --------
    >>> found = Interval(0.05, 0.041, 0.0622)
    >>> value, low, high = found
    >>> found.text(100.0, 1)
    '5.0 [4.1, 6.2]'
    """

    value: float
    low: float
    high: float

    @property
    def median(self) -> float:
        """``value`` by its name of 0.2."""
        return former_field(self, "median", "value")

    def text(self, scale: float = 1.0, digits: int = 2) -> str:
        """For tables: the value with both ends.

        Parameters
        ----------
        scale : float
            From the unit of the values to that of the table.
        digits : int
            Behind the point.

        Returns
        -------
        str
        """
        value, low, high = (f"{scale * each:.{digits}f}" for each in self)
        return f"{value} [{low}, {high}]"


_Answer = TypeVar("_Answer", bound=Result, covariant=True)


class PerChannel(tuple[_Answer, ...]):
    """Answers channel by channel: a tuple of results.

    Examples
    --------
    >>> from phyfilter_ctl import PhyFilter, error_bound, stack
    >>> bounds = error_bound(stack([PhyFilter([20.0]), PhyFilter([5.0])]), [{1: 3.0}, {1: 1.0}])
    >>> [round(each.bound, 9) for each in bounds]
    [0.15, 0.2]
    """

    __slots__ = ()

    @property
    def by_name(self) -> dict[str, _Answer]:
        """The same as a dictionary: "channel 0", ..."""
        return {f"channel {i}": entry for i, entry in enumerate(self)}

    def to_dict(self) -> dict[str, Any]:
        """What JSON can hold of it, by the names of :attr:`by_name`."""
        return {name: plain(entry, infinite=True) for name, entry in self.by_name.items()}

    def __repr__(self) -> str:
        return "\n".join(f"{name}: {entry!r}" for name, entry in self.by_name.items())

    def _repr_html_(self) -> str:
        rows = [
            f"<tr><th style='text-align:left'>{name}</th><td>{entry._repr_html_()}</td></tr>"
            for name, entry in self.by_name.items()
        ]
        return f"<table>{''.join(rows)}</table>"


def _shown(thing: Any) -> list[Field[Any]]:
    return [field for field in fields(thing) if not field.name.startswith("_")]


# -- JSON -----------------------------------------------------------------------------------------------------------


def plain(value: object, *, infinite: bool = False) -> Any:
    """A value as JSON holds it.

    Parameters
    ----------
    value : object
        Of a kind that JSON has not: its ``to_dict()``, its fields if a dataclass, else its ``repr``.
    infinite : bool
        Infinite numbers as the words "Infinity" and "-Infinity", which Python's ``float`` and JavaScript's ``Number``
        read; False: as None. What is not a number is None in any case.

    Returns
    -------
    None, bool, int, float, str, list or dict

    Examples
    --------
    >>> plain({1: np.array([1.0, np.inf]), "pole": -2 + 1j, "status": Status.FAILED})
    {'1': [1.0, None], 'pole': [-2.0, 1.0], 'status': 'failed'}
    >>> plain([1.0, -np.inf, np.nan], infinite=True)
    [1.0, '-Infinity', None]
    """
    if isinstance(value, Enum):
        return plain(value.value, infinite=infinite)
    if isinstance(value, np.ndarray | np.generic):
        real = value.dtype.kind in "biuf" and np.isfinite(value).all()  # curves, many times a second
        if real or infinite or value.dtype.kind != "f":
            return value.tolist() if real else plain(value.tolist(), infinite=infinite)
        held = np.array(value, dtype=object)
        held[~np.isfinite(value)] = None
        return held.tolist()
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        words = infinite and math.isinf(value)
        return (
            value if math.isfinite(value) else ("Infinity" if value > 0.0 else "-Infinity") if words else None
        )
    if isinstance(value, complex):
        return [plain(part, infinite=infinite) for part in (value.real, value.imag)]
    if callable(as_dict := getattr(value, "_asdict", None)):  # a named tuple
        value = as_dict()
    if isinstance(value, Mapping):
        return {
            str(plain(key, infinite=infinite)): plain(entry, infinite=infinite)
            for key, entry in value.items()
        }
    if isinstance(value, Sequence | Set):
        return [plain(entry, infinite=infinite) for entry in value]
    if callable(to_dict := getattr(value, "to_dict", None)):
        return to_dict()
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name), infinite=infinite) for field in _shown(value)}
    return repr(value)


# -- one screen -----------------------------------------------------------------------------------------------------


def summary(value: object) -> str:
    """A value in one line.

    Parameters
    ----------
    value : object

    Examples
    --------
    >>> summary(np.eye(50)), summary([1.0 / 3.0, 2]), summary(range(1000))
    ('array of shape (50, 50), 0 to 1', '[0.333333, 2]', '1000 entries of type int')
    """
    if isinstance(value, Status):
        return repr(str(value))
    if isinstance(value, str):
        return repr(value if len(value) <= _TEXT else value[: _TEXT - 3] + "...")
    if isinstance(value, np.ndarray):
        return _array(value)
    if isinstance(value, bool | np.bool_):
        return str(value)
    if isinstance(value, float | complex | np.floating | np.complexfloating):
        return f"{value:.6g}"
    if isinstance(value, Result):
        names = [*(["status"] if hasattr(value, "status") else []), *value._answer]
        shown = "".join(f"{n}={_measured(getattr(value, n), value._unit_of(n))}, " for n in names)
        return f"{type(value).__name__}({shown}...)"
    if isinstance(value, Mapping) and len(value) <= _LISTED:
        return _short("{" + ", ".join(f"{key!r}: {summary(v)}" for key, v in value.items()) + "}", value)
    if _are_texts(value):
        text = f"({', '.join(map(repr, value))}{',' if len(value) == 1 else ''})"
        return text if len(text) <= _TEXT else text[: _TEXT - 3] + "..."
    if isinstance(value, Mapping | Sequence | Set):
        if isinstance(value, Mapping) or len(value) > _LISTED:
            return _counted(value)
        left, right = "[]" if isinstance(value, list) else ("(", ",)" if len(value) == 1 else ")")
        return _short(left + ", ".join(map(summary, value)) + right, value)
    return _short(repr(value), value)


def _measured(value: object, unit: str) -> str:
    """As :func:`summary`, with its unit where it is a figure."""
    if not unit or value is None or isinstance(value, str | Result):
        return summary(value)
    return f"{summary(value)} {unit}"


def _array(value: np.ndarray) -> str:
    if value.size <= _LISTED and value.ndim <= 1:
        return f"array({summary(value.tolist())})"
    span = ""
    if value.size and value.dtype.kind in "fiu":
        finite = value[np.isfinite(value)]
        span = f", {finite.min():.6g} to {finite.max():.6g}" if finite.size else ", none finite"
        span += "" if finite.size in (0, value.size) else ", not all finite"
    return f"array of shape {value.shape}{span}"


def _counted(value: Any) -> str:
    kinds = {type(entry).__name__ for entry in (value.values() if isinstance(value, Mapping) else value)}
    return f"{len(value)} entries of type {' or '.join(sorted(kinds)[:3])}"


def _short(text: str, value: Any) -> str:
    text = " ".join(text.split())
    if len(text) <= (_TEXT if isinstance(value, Mapping) else _WIDTH):
        return text
    return _counted(value) if isinstance(value, Sequence | Set | Mapping) else f"{type(value).__name__}(...)"


def _are_texts(value: object) -> TypeGuard[tuple[str, ...]]:
    return isinstance(value, tuple) and bool(value) and all(isinstance(entry, str) for entry in value)


def _in_words(value: object, unit: str = "") -> str:
    """As :func:`summary`, for people: empty where there is nothing to say."""
    if unit and (said := _in_words(value)):
        return said if isinstance(value, str | Result) else f"{said} {unit}"
    if isinstance(value, Status):
        return f"{value}: {value.meaning}"
    if isinstance(value, str):
        return value if len(value) <= _TEXT else value[: _TEXT - 3] + "..."
    if _are_texts(value):
        return "; ".join(value)
    if value is None or (isinstance(value, np.ndarray | Sequence | Mapping | Set) and len(value) == 0):
        return ""
    if isinstance(value, np.ndarray) and value.ndim == 1 and value.size <= _LISTED:
        return ", ".join(map(summary, value.tolist()))
    if isinstance(value, tuple) and len(value) <= _LISTED:
        return ", ".join(map(summary, value))
    return summary(value)


def in_lines(figures: Mapping[str, str]) -> str:
    """Names and texts, one line each; without those that are empty.

    Examples
    --------
    >>> print(in_lines({"radius": "0.2 m", "limit": ""}))
    radius              0.2 m
    """
    return "\n".join(f"{name:<20}{text}" for name, text in figures.items() if text)


def with_unit(value: float, unit: str) -> str:
    """A figure to four digits, with its unit where it has one.

    Examples
    --------
    >>> with_unit(0.25, "N"), with_unit(0.25, "")
    ('0.25 N', '0.25')
    """
    return f"{value:.4g} {unit}".strip()
