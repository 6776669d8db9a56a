"""No public function has more than twelve arguments, no object of options more than twelve fields."""

import dataclasses
import inspect

import pytest

from phyfilter_ctl.results import Result
from tests.meta.test_public_names import CALLABLES

MOST = 12
# An object of options can be made of defaults: at most so many fields have none.
REQUIRED = 2
RULES_OF_A_FILTER = "all that a filter is run with, set once, counted by every analysis, named in files"
EXCEPTIONS = {
    "filter.bank.FilterBank.sampled": RULES_OF_A_FILTER,
    "filter.phyfilter.PhyFilter.sampled": RULES_OF_A_FILTER,
    "filter.sampling.Sampling": RULES_OF_A_FILTER,
    "fmi.abilities.FmuKind": "read from an FMU, of what it can do",
    "logfiles.recordings.read_recording": "the twelve of Recording.read, and what a file may take in memory",
}


def public_functions():
    """Functions, classes that are no results or responses, and public methods, by name."""
    for thing in {id(thing): thing for thing in CALLABLES.values()}.values():
        name = f"{thing.__module__}.{thing.__qualname__}".removeprefix("phyfilter_ctl.")
        if not inspect.isclass(thing):
            yield name, thing
            continue
        for member in dir(thing):
            function = inspect.getattr_static(thing, member)
            function = getattr(function, "__func__", function)
            own = getattr(function, "__module__", None) or ""
            if (
                not member.startswith("_")
                and inspect.isfunction(function)
                and own.startswith("phyfilter_ctl")
            ):
                yield f"{name}.{member}", function


def options_objects():
    """Frozen dataclasses that a user makes: not results, and nearly all of them defaults."""
    for thing in {id(thing): thing for thing in CALLABLES.values()}.values():
        if not inspect.isclass(thing) or not dataclasses.is_dataclass(thing) or issubclass(thing, Result):
            continue
        given = inspect.signature(thing).parameters
        if sum(each.default is each.empty for each in given.values()) <= REQUIRED:
            yield f"{thing.__module__}.{thing.__qualname__}".removeprefix("phyfilter_ctl."), given


def too_long():
    found = {}
    for name, function in public_functions():
        try:
            names = set(inspect.signature(function).parameters) - {"self", "cls"}
        except ValueError:  # of a builtin
            continue
        if len(names) > MOST:
            found[name] = len(names)
    return found | {name: len(given) for name, given in options_objects() if len(given) > MOST}


FOUND = too_long()


def test_a_dozen_arguments_and_fields_at_most():
    found = {name: count for name, count in FOUND.items() if name not in EXCEPTIONS}
    assert not found, f"bundle what travels together, at most {MOST} each: {found}"


@pytest.mark.parametrize("name", EXCEPTIONS)
def test_exceptions_are_needed(name):
    assert name in FOUND, f"{name} is short now: take it out of the exceptions"


def test_there_is_something_to_look_at():
    assert len(list(public_functions())) > 300
    assert {"filter.sampling.Sampling", "execution.limits.Limits"} <= {name for name, _ in options_objects()}
