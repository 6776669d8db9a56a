"""Reading messages that anyone may have written: every field is checked, every complaint names the field."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

__all__ = ["LONGEST_TEXT", "Fields", "MessageError", "shown"]

LONGEST_TEXT = 200  # characters of a name, a unit or a choice
_SHOWN = 40  # characters of an offending value that an error repeats
_MOST_BITS = 63


class MessageError(ValueError):
    """A message that cannot be answered.

    Parameters
    ----------
    where : str
        The field, such as "design.poles".
    problem : str
        What is wrong, what was expected, what to do.
    """

    def __init__(self, where: str, problem: str) -> None:
        super().__init__(f"{where}: {problem}")
        self.where = where


def shown(value: object) -> str:
    """An offending value, short, whatever it is.

    Parameters
    ----------
    value : object
        Anything; nested values are not looked into.

    Returns
    -------
    str

    Examples
    --------
    >>> shown(10**400), shown([[[]]]), shown(None), shown("x" * 50)
    ('an integer of 1329 bits', 'a list of 1', 'null', "'xxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxx...'")
    """
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value) if value.bit_length() <= _MOST_BITS else f"an integer of {value.bit_length()} bits"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, str):
        return repr(value if len(value) <= _SHOWN else value[:_SHOWN] + "...")
    if isinstance(value, list | tuple):
        return f"a list of {len(value)}"
    return "an object" if isinstance(value, dict) else f"a {type(value).__name__}"


@dataclass(frozen=True)
class Fields:
    """One object of a message.

    Parameters
    ----------
    values : mapping
        As the JSON reader gives them.
    where : str
        What stands before a field of it in a complaint: "", "design.", ...
    """

    values: Mapping[object, object]
    where: str = ""

    @classmethod
    def of(cls, value: object, where: str = "") -> Fields:
        """The fields of what should be an object.

        Parameters
        ----------
        value : object
            From the message.
        where : str
            Name of the field that holds it; empty for the message itself.

        Raises
        ------
        MessageError
            If it is none.
        """
        if not isinstance(value, Mapping):
            raise MessageError(where or "message", f"expected an object, got {shown(value)}")
        return cls(value, f"{where}." if where else "")

    def __contains__(self, key: str) -> bool:
        """Whether the field is there and not null."""
        return self.values.get(key) is not None

    def error(self, key: str, problem: str) -> MessageError:
        """The error to raise about a field."""
        return MessageError(f"{self.where}{key}", problem)

    def only(self, *known: str) -> None:
        """Refuse fields that mean nothing here: a misspelt one would be passed over in silence."""
        for key in self.values:
            if key not in known:
                raise MessageError(
                    self.where.removesuffix(".") or "message",
                    f"unknown field {shown(key)}; expected {', '.join(known)}",
                )

    def get(self, key: str) -> object:
        """A field that must be there; null counts as missing."""
        value = self.values.get(key)
        if value is None:
            raise self.error(key, "missing")
        return value

    def fields(self, key: str) -> Fields:
        """An object."""
        return Fields.of(self.get(key), f"{self.where}{key}")

    def number(self, key: str, low: float, high: float, *, unit: str = "") -> float:
        """A number from low to high."""
        return real(self.get(key), low, high, f"{self.where}{key}", unit)

    def integer(self, key: str, low: int, high: int) -> int:
        """An integer from low to high."""
        value = self.get(key)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise self.error(key, f"expected an integer from {low} to {high}, got {shown(value)}")
        return value

    def text(self, key: str, longest: int = LONGEST_TEXT) -> str:
        """Text that UTF-8 can hold, of at most so many characters."""
        value = self.get(key)
        if not isinstance(value, str):
            raise self.error(key, f"expected text, got {shown(value)}")
        if len(value) > longest:
            raise self.error(key, f"expected at most {longest} characters, got {len(value)}")
        try:
            value.encode()
        except UnicodeEncodeError:
            raise self.error(key, "expected text, got half a surrogate pair in it") from None
        return value

    def choice(self, key: str, choices: Sequence[str]) -> str:
        """One of some words."""
        value = self.get(key)
        if not (isinstance(value, str) and value in choices):
            raise self.error(key, f"expected one of {', '.join(choices)}, got {shown(value)}")
        return value

    def texts(self, key: str, low: int, high: int, longest: int = LONGEST_TEXT) -> list[str]:
        """A list of low to high texts."""
        entries = dict(enumerate(self.listed(key, low, high)))
        inside = Fields({str(i): entry for i, entry in entries.items()}, f"{self.where}{key}.")
        return [inside.text(str(i), longest) for i in entries]

    def numbers(self, key: str, low: int, high: int, *, size: float) -> list[float]:
        """A list of low to high numbers of magnitude up to ``size``."""
        entries = self.listed(key, low, high)
        return [real(e, -size, size, f"{self.where}{key}[{i}]") for i, e in enumerate(entries)]

    def points(self, key: str, low: int, high: int, *, size: float) -> list[complex]:
        """A list of low to high complex numbers [re, im], their parts of magnitude up to ``size``."""
        found: list[complex] = []
        for i, entry in enumerate(self.listed(key, low, high)):
            where = f"{self.where}{key}[{i}]"
            if not (isinstance(entry, list | tuple) and len(entry) == 2):
                raise MessageError(where, f"expected [re, im], got {shown(entry)}")
            re, im = (real(part, -size, size, where, "rad/s") for part in entry)
            found.append(complex(re, im))
        return found

    def listed(self, key: str, low: int, high: int) -> Sequence[object]:
        """A list of low to high entries of any kind."""
        value = self.get(key)
        if not isinstance(value, list | tuple):
            raise self.error(key, f"expected a list, got {shown(value)}")
        if not low <= len(value) <= high:
            raise self.error(key, f"expected {low} to {high} entries, got {len(value)}")
        return value


def real(value: object, low: float, high: float, where: str, unit: str = "") -> float:
    """A finite number from low to high.

    Parameters
    ----------
    value : object
    low, high : float
    where, unit : str
        For the complaint.

    Raises
    ------
    MessageError
        If it is none.
    """
    # Compared before it is converted: an integer of a thousand digits does not fit.
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float)
        or (isinstance(value, float) and not math.isfinite(value))
        or not low <= value <= high
    ):
        suffix = f" {unit}" if unit else ""
        raise MessageError(where, f"expected a number from {low:g} to {high:g}{suffix}, got {shown(value)}")
    return float(value)
