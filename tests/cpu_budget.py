"""What every test file costs in CPU seconds, its compilers and other children included, and the most it may cost.

A pytest plugin: the suite has to stay one that people run. The limit is generous, so that a slow machine passes and
only a file that has grown out of its place fails the run. Set-up that a file is the first to need counts for that
file; those marked ``slow`` or ``release`` have no limit.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Collection, Generator, Iterable

import pytest
from _pytest.mark.structures import ParameterSet

# Three times what the dearest file takes on a machine of 2024 with other work beside it.
LIMIT = 60.0
SHOWN = 5

_spent = pytest.StashKey[Counter[str]]()
_limited = pytest.StashKey[Counter[str]]()


def cpu_seconds() -> float:
    """CPU time of this process and of its children that have ended, in seconds."""
    return sum(os.times()[:4])


def over_budget(spent: Counter[str], limit: float = LIMIT) -> list[str]:
    """A sentence for each file that costs more than it may."""
    return [
        f"{name}: {seconds:.0f} CPU s of at most {limit:.0f}; share what it builds in a fixture, or mark depth as slow"
        for name, seconds in spent.most_common()
        if seconds > limit
    ]


def slow_but(kept: Collection[object], values: Iterable[object]) -> list[ParameterSet]:
    """Values (tuples for several names) of a parametrised test: those kept stand for all, the rest is depth."""
    return [
        pytest.param(
            *value if isinstance(value, tuple) else (value,), marks=() if value in kept else pytest.mark.slow
        )
        for value in values
    ]


def release_but(kept: Collection[object], values: Iterable[object]) -> list[ParameterSet]:
    """The same one rank deeper: those kept are depth, the rest is for a release."""
    return [
        pytest.param(
            *value if isinstance(value, tuple) else (value,),
            marks=pytest.mark.slow if value in kept else pytest.mark.release,
        )
        for value in values
    ]


def pytest_configure(config: pytest.Config) -> None:
    config.stash[_spent] = Counter()
    config.stash[_limited] = Counter()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    before = cpu_seconds()
    result = yield
    name, seconds = item.nodeid.split("::")[0], cpu_seconds() - before
    item.config.stash[_spent][name] += seconds
    if item.get_closest_marker("slow") is None and item.get_closest_marker("release") is None:
        item.config.stash[_limited][name] += seconds
    return result


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: object) -> None:
    """Add up what a worker of pytest-xdist has spent."""
    config, output = getattr(node, "config", None), getattr(node, "workeroutput", {})
    if config is not None:
        config.stash[_spent].update(output.get("cpu_spent", {}))
        config.stash[_limited].update(output.get("cpu_limited", {}))


def pytest_sessionfinish(session: pytest.Session) -> None:
    config = session.config
    output = getattr(config, "workeroutput", None)
    if output is not None:  # a worker: its controller judges
        output["cpu_spent"], output["cpu_limited"] = dict(config.stash[_spent]), dict(config.stash[_limited])
    elif over_budget(config.stash[_limited]) and session.exitstatus == 0:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    spent = config.stash[_spent]
    dearest = ", ".join(f"{name} {seconds:.0f}" for name, seconds in spent.most_common(SHOWN))
    terminalreporter.write_line(f"CPU seconds in tests: {spent.total():.0f} ({dearest})")
    for sentence in over_budget(config.stash[_limited]):
        terminalreporter.write_line(sentence, red=True)
