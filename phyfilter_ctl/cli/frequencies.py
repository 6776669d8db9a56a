"""Frequencies on the command line: rad/s, or Hz by a second option; and the units of pictures."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from typing import TypeVar

__all__ = ["add_frequency", "add_picture_units", "complex_numbers", "numbers"]

_Number = TypeVar("_Number", float, complex)


def numbers(text: str) -> list[float]:
    """Real numbers with commas between them."""
    return _parsed(float, text, "numbers")


def complex_numbers(text: str) -> list[complex]:
    """Complex numbers with commas between them."""
    return _parsed(complex, text.replace("i", "j"), "numbers such as -20 or -20+10j")


def _parsed(kind: type[_Number], text: str, expected: str) -> list[_Number]:
    try:
        return [kind(part.strip()) for part in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"expected {expected} with commas between them, got {text!r}"
        ) from None


def add_frequency(
    parser: argparse._ArgumentGroup,
    name: str,
    parse: Callable[[str], list[_Number]],
    *,
    metavar: str,
    help: str,
) -> None:
    """An option in rad/s and beside it one in Hz, ``NAME-hz``; both leave rad/s in the same place, one may be given."""
    pair = parser.add_mutually_exclusive_group()
    pair.add_argument(name, type=parse, metavar=metavar, help=help)
    pair.add_argument(
        f"{name}-hz",
        dest=name.removeprefix("--").replace("-", "_"),
        type=lambda text: [2.0 * math.pi * value for value in parse(text)],
        metavar=metavar,
        help="the same in Hz",
    )


def add_picture_units(parser: argparse._ArgumentGroup, *, magnitudes: bool = True) -> None:
    """``--hz`` and ``--db``: what pictures are drawn in; None where not given."""
    parser.add_argument(
        "--hz", action="store_true", default=None, help="the picture over Hz instead of rad/s"
    )
    if magnitudes:
        parser.add_argument("--db", action="store_true", default=None, help="the picture's magnitudes in dB")
