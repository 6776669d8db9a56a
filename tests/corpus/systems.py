"""All systems of the corpus."""

from __future__ import annotations

from tests.corpus import events, friction, limits, loops, sampled, smooth, switches
from tests.corpus.system import System

FAMILIES: dict[str, list[System]] = {}
for _module in (switches, friction, limits, events, smooth, loops, sampled):
    for _each in _module.systems():
        FAMILIES.setdefault(_each.family, []).append(_each)


def all_systems() -> list[System]:
    """In order of families."""
    return [each for family in FAMILIES.values() for each in family]


def by_name(name: str) -> System:
    """One of them."""
    return next(each for each in all_systems() if each.name == name)
