"""Unit strings as SI factors and exponents: units of FMUs and of recorded signals."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

__all__ = ["UnitDefinition", "unit_definition"]

_SI = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
_PI = math.pi
# Symbol: factor to SI, exponents of _SI.
_SYMBOLS: dict[str, tuple[float, tuple[int, ...]]] = {
    "kg": (1.0, (1, 0, 0, 0, 0, 0, 0, 0)),
    "g": (1e-3, (1, 0, 0, 0, 0, 0, 0, 0)),
    "m": (1.0, (0, 1, 0, 0, 0, 0, 0, 0)),
    "s": (1.0, (0, 0, 1, 0, 0, 0, 0, 0)),
    "min": (60.0, (0, 0, 1, 0, 0, 0, 0, 0)),
    "h": (3600.0, (0, 0, 1, 0, 0, 0, 0, 0)),
    "A": (1.0, (0, 0, 0, 1, 0, 0, 0, 0)),
    "K": (1.0, (0, 0, 0, 0, 1, 0, 0, 0)),
    "mol": (1.0, (0, 0, 0, 0, 0, 1, 0, 0)),
    "cd": (1.0, (0, 0, 0, 0, 0, 0, 1, 0)),
    "rad": (1.0, (0, 0, 0, 0, 0, 0, 0, 1)),
    "deg": (_PI / 180, (0, 0, 0, 0, 0, 0, 0, 1)),
    "rev": (2 * _PI, (0, 0, 0, 0, 0, 0, 0, 1)),
    "rpm": (_PI / 30, (0, 0, -1, 0, 0, 0, 0, 1)),
    "Hz": (1.0, (0, 0, -1, 0, 0, 0, 0, 0)),
    "N": (1.0, (1, 1, -2, 0, 0, 0, 0, 0)),
    "Pa": (1.0, (1, -1, -2, 0, 0, 0, 0, 0)),
    "J": (1.0, (1, 2, -2, 0, 0, 0, 0, 0)),
    "W": (1.0, (1, 2, -3, 0, 0, 0, 0, 0)),
    "C": (1.0, (0, 0, 1, 1, 0, 0, 0, 0)),
    "V": (1.0, (1, 2, -3, -1, 0, 0, 0, 0)),
    "Ohm": (1.0, (1, 2, -3, -2, 0, 0, 0, 0)),
    "F": (1.0, (-1, -2, 4, 2, 0, 0, 0, 0)),
    "H": (1.0, (1, 2, -2, -2, 0, 0, 0, 0)),
    "T": (1.0, (1, 0, -2, -1, 0, 0, 0, 0)),
    "Wb": (1.0, (1, 2, -2, -1, 0, 0, 0, 0)),
    "1": (1.0, (0,) * 8),
    "%": (0.01, (0,) * 8),
}
_PREFIXES = {"k": 1e3, "M": 1e6, "G": 1e9, "c": 1e-2, "m": 1e-3, "u": 1e-6, "n": 1e-9}
# What people read beside the SI unit: name, factor, offset (shown = factor * SI + offset).
_DISPLAY: dict[str, tuple[tuple[str, float, float], ...]] = {
    "rad": (("deg", 180 / _PI, 0.0),),
    "rad/s": (("deg/s", 180 / _PI, 0.0), ("r/min", 30 / _PI, 0.0)),
    "rad/s^2": (("deg/s^2", 180 / _PI, 0.0),),
    "m": (("mm", 1e3, 0.0),),
    "m/s": (("km/h", 3.6, 0.0),),
    "s": (("ms", 1e3, 0.0),),
    "kg": (("g", 1e3, 0.0),),
    "K": (("degC", 1.0, -273.15),),
}
_TOKEN = re.compile(r"\s*(?:([A-Za-z]+|%|1)|(\^|\*\*)?\s*([-+]?\d+)|([*./()\u00b7]))")


@dataclass(frozen=True)
class UnitDefinition:
    """A unit and what it is in SI.

    Parameters
    ----------
    name : str
        As on the variables.
    exponents : dict of str to int or None
        Powers of kg, m, s, A, K, mol, cd and rad other than 0; None where the unit is not understood.
    factor : float
        Value in SI = factor * value.
    display : tuple of (str, float, float)
        Name, factor and offset of units to show instead: shown = factor * value + offset.
    """

    name: str
    exponents: dict[str, int] | None
    factor: float = 1.0
    display: tuple[tuple[str, float, float], ...] = ()


def unit_definition(text: str) -> UnitDefinition:
    """Reads a unit such as "m/s^2", "N m", "kg m^2" or "1/(rad s)".

    Parameters
    ----------
    text : str
        Symbols with SI prefixes, apart by spaces, ``*`` or ``.``; ``/`` divides by the next factor alone.

    Examples
    --------
    >>> unit_definition("N m").exponents
    {'kg': 1, 'm': 2, 's': -2}
    >>> unit_definition("km/h").factor
    0.2777777777777778
    >>> unit_definition("furlong").exponents is None
    True
    """
    display = _DISPLAY.get(text, ())
    parsed = _parse(text)
    if parsed is None:
        return UnitDefinition(text, None, 1.0, display)
    factor, powers = parsed
    return UnitDefinition(
        text, {name: power for name, power in zip(_SI, powers, strict=True) if power}, factor, display
    )


def _parse(text: str) -> tuple[float, list[int]] | None:
    tokens: list[str] = []
    at = 0
    while at < len(text.rstrip()):
        match = _TOKEN.match(text, at)
        if match is None:
            return None
        symbol, _, power, sign = match.groups()
        tokens.append(symbol if symbol else f"^{int(power)}" if power else sign)
        at = match.end()
    try:
        result, rest = _product(tokens)
    except ValueError:
        return None
    return None if rest else result


def _product(tokens: list[str]) -> tuple[tuple[float, list[int]], list[str]]:
    factor, powers, direction = 1.0, [0] * 8, 1
    if not tokens:
        raise ValueError("nothing")
    while tokens and tokens[0] != ")":
        if tokens[0] in {"/", "*", ".", "\u00b7"}:
            direction = -1 if tokens[0] == "/" else 1
            tokens = tokens[1:]
        (size, exponents), tokens = _factor(tokens)
        power = direction
        if tokens and tokens[0].startswith("^"):
            power *= int(tokens[0][1:])
            tokens = tokens[1:]
        factor *= size**power
        powers = [a + power * b for a, b in zip(powers, exponents, strict=True)]
        direction = 1
    return (factor, powers), tokens


def _factor(tokens: list[str]) -> tuple[tuple[float, list[int]], list[str]]:
    if not tokens:
        raise ValueError("a factor is missing")
    head, rest = tokens[0], tokens[1:]
    if head == "(":
        inside, rest = _product(rest)
        if not rest or rest[0] != ")":
            raise ValueError("a parenthesis is open")
        return inside, rest[1:]
    if head in _SYMBOLS:
        size, exponents = _SYMBOLS[head]
        return (size, list(exponents)), rest
    if head[:1] in _PREFIXES and head[1:] in _SYMBOLS and head[1:] not in {"1", "%", "kg"}:
        size, exponents = _SYMBOLS[head[1:]]
        return (_PREFIXES[head[0]] * size, list(exponents)), rest
    raise ValueError(head)
