"""Units of FMUs and packages, and conversions between them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from .._units import unit_definition

__all__ = ["AS_IS", "FmuUnit", "Linear", "conversion", "understood_unit"]


@dataclass(frozen=True)
class FmuUnit:
    """A unit in SI base units: value in SI = factor * value + offset.

    Parameters
    ----------
    exponents : dict of str to int
        Of kg, m, s, A, K, mol, cd, rad; only those that are not zero.
    factor, offset : float
    """

    exponents: Mapping[str, int]
    factor: float = 1.0
    offset: float = 0.0


def understood_unit(name: str) -> FmuUnit | None:
    """What a unit's name says, where its file or system does not define it.

    Parameters
    ----------
    name : str

    Examples
    --------
    >>> understood_unit("mm")
    FmuUnit(exponents={'m': 1}, factor=0.001, offset=0.0)
    """
    found = unit_definition(name)
    return None if found.exponents is None else FmuUnit(found.exponents, found.factor)


class Linear(NamedTuple):
    """target = gain * source + offset."""

    gain: float = 1.0
    offset: float = 0.0

    def __call__(self, value: float) -> float:
        """The target.

        Parameters
        ----------
        value : float
        """
        return self.gain * value + self.offset

    def after(self, first: Linear) -> Linear:
        """Both, the other one first.

        Parameters
        ----------
        first : Linear

        Examples
        --------
        >>> Linear(2.0, 1.0).after(Linear(3.0, 10.0))
        Linear(gain=6.0, offset=21.0)
        """
        return Linear(self.gain * first.gain, self(first.offset))


AS_IS = Linear()


def conversion(source: FmuUnit | None, target: FmuUnit | None) -> Linear | None:
    """From one unit to another; none where one is not known; None where they measure different things.

    Parameters
    ----------
    source, target : FmuUnit or None

    Examples
    --------
    >>> conversion(FmuUnit({"m": 1}, 1e-3), FmuUnit({"m": 1}))
    Linear(gain=0.001, offset=0.0)
    >>> conversion(FmuUnit({"m": 1}), FmuUnit({"s": 1})) is None
    True
    """
    if source is None or target is None or source == target:
        return AS_IS
    # An angle is a number: rad/s may drive 1/s.
    plain = [{key: n for key, n in unit.exponents.items() if key != "rad"} for unit in (source, target)]
    if plain[0] != plain[1]:
        return None
    return Linear(source.factor / target.factor, (source.offset - target.offset) / target.factor)
