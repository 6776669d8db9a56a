"""What is compared: policies, and the filter in their joint loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from phyfilter_ctl.plants.legged import Contact

from .adaptive import AdaptiveChoice
from .loop import FilterChoice, paper_filter
from .policy import Policy, shipped

__all__ = [
    "GATED",
    "IMPROVED",
    "METHODS",
    "RIVAL",
    "SEEDS",
    "TUNED",
    "USUAL",
    "Method",
    "of_policies",
    "told",
]

SEEDS = (0, 1, 2)
# Of the policies that were trained with commands of up to 3 m/s.
WIDE = (0,)

# Chosen on validation walks (--choose): faster than the paper's; an impact counts no more than 8 N m; it dies out while
# the trunk is tilted or rolls.
IMPROVED = FilterChoice((4.0,), limit=8.0, anti_windup="residual", gate="tilt", gate_action="scale")
# Go1's, both put on policies that were trained without, and of two dozen variants each (--tune).
TUNED = FilterChoice((4.0,), contact="estimated")
RIVAL = AdaptiveChoice(4.0, leak=2.0)
# What the policies "wide" were trained with.
GATED = FilterChoice((4.0,), gate="tilt", gate_action="scale")


@dataclass(frozen=True)
class Method:
    """Policies of one training, and what runs with them.

    Attributes
    ----------
    label : str
    family : str
        Of the shipped policies.
    choice : FilterChoice, optional
        The filter while walking; None: none.
    given : tuple of Policy
        Instead of shipped ones.
    seeds : tuple of int
        Of the shipped ones, where there are fewer.
    """

    label: str
    family: str
    choice: FilterChoice | None
    given: tuple[Policy, ...] = ()
    seeds: tuple[int, ...] = SEEDS

    def policies(self, seeds: tuple[int, ...] = SEEDS) -> tuple[Policy, ...]:
        """Those given, or the shipped ones of the family.

        Parameters
        ----------
        seeds : tuple of int
        """
        there = [seed for seed in seeds if seed in self.seeds]
        return self.given or tuple(shipped(f"{self.family}-{seed}") for seed in there)


METHODS: dict[str, Method] = {
    "base": Method("base policy", "base", None),
    "observer": Method("base policy, filter put on", "base", paper_filter()),
    "filter": Method("trained with the filter", "filter", paper_filter()),
    "off": Method("the same, filter off", "filter", None),
    "improved": Method("the same, improved filter", "filter", IMPROVED),
    "basewide": Method("base policy, to 3 m/s", "basewide", None, seeds=WIDE),
    "wide": Method("with a filter, to 3 m/s", "wide", GATED, seeds=WIDE),
    "early_base": Method("base policy, half trained", "early_base", None),
    "early_observer": Method("half trained, filter put on", "early_base", paper_filter()),
    "early_filter": Method("half trained with the filter", "early_filter", paper_filter()),
    "early_off": Method("the same, filter off", "early_filter", None),
    "early_improved": Method("half trained, improved", "early_filter", IMPROVED),
}
# What is compared unless something else is asked for.
USUAL = ("base", "observer", "filter", "off", "improved", "basewide", "wide")


def told(method: Method, contact: Contact) -> Method:
    """The same, its filter told something else of the forces on the feet; without a filter as it is.

    Parameters
    ----------
    method : Method
    contact : {"omitted", "known", "estimated"}

    Examples
    --------
    >>> told(METHODS["filter"], "known").choice.contact, told(METHODS["base"], "known").choice
    ('known', None)
    """
    return (
        method if method.choice is None else replace(method, choice=replace(method.choice, contact=contact))
    )


def of_policies(policies: Sequence[Policy]) -> dict[str, Method]:
    """Methods for policies that are not shipped: with the filter they were trained with, and without.

    Parameters
    ----------
    policies : sequence of Policy

    Raises
    ------
    ValueError
        If they were trained with different filters.
    """
    filters = [policy.record.get("filter") for policy in policies]
    if any(entry != filters[0] for entry in filters):
        raise ValueError("policies that were trained with different filters: judge them one at a time")
    given, numbers = tuple(policies), filters[0]
    if numbers is None:
        return {"own": Method("own policy", "own", None, given)}
    choice = FilterChoice.of(numbers)
    return {
        "own": Method("own policy with its filter", "own", choice, given),
        "own_off": Method("own policy, filter off", "own", None, given),
    }
