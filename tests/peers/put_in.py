"""The pytest plugin of ``python -m tests.peers.python_control``: PhyFilters in python-control's own tests."""

from __future__ import annotations

import functools
import importlib
import json
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import control as ct
import numpy as np
import pytest

from phyfilter_ctl import PhyFilter

REPORT, PUT_IN = "PHYFILTER_PEERS_REPORT", "PHYFILTER_PEERS_PUT_IN"
# What a filter cannot hold.
_NAMED = {
    "name",
    "inputs",
    "outputs",
    "states",
    "input_prefix",
    "output_prefix",
    "state_prefix",
    "display_format",
}


def put_in(system: Any, given: tuple[Any, ...], named: dict[str, Any]) -> Any:
    """The system as a PhyFilter where it is given by numbers and the form fits, else as it is."""
    if any(isinstance(each, ct.InputOutputSystem) for each in given) or _NAMED & set(named):
        return system
    if type(system) not in (ct.TransferFunction, ct.StateSpace) or not system.issiso() or system.dt != 0:
        return system
    try:
        found = PhyFilter.from_tf(system)
    except ValueError:  # not strictly proper, not stable, or a constant
        return system
    _Run.systems += 1
    return found


def _asked_by_a_test() -> bool:
    return sys._getframe(2).f_globals.get("__name__", "").startswith("control.tests.")


class _StandIn(type):
    """Type of a class that stands for python-control's own: it is that one, but for what the tests construct by it."""

    def __call__(cls, *args: Any, **keywords: Any) -> Any:
        system = cls.__base__(*args, **keywords)
        return put_in(system, args, keywords) if _asked_by_a_test() else system

    def __instancecheck__(cls, instance: object) -> bool:
        return isinstance(instance, cls.__base__)

    def __subclasscheck__(cls, subclass: type) -> bool:
        return issubclass(subclass, cls.__base__)

    def __eq__(cls, other: object) -> bool:
        return other is cls or other is cls.__base__

    def __hash__(cls) -> int:
        return hash(cls.__base__)


def _standing_in(function: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(function)
    def constructed(*args: Any, **keywords: Any) -> Any:
        system = function(*args, **keywords)
        return put_in(system, args, keywords) if _asked_by_a_test() else system

    return constructed


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(_Run())
    if PUT_IN not in os.environ:
        return
    # Here, since MATLAB's names bring MATLAB's settings of plots to a whole process; and before the stand-ins, since
    # flat linear systems are made of python-control's own classes.
    for room in ("flatsys", "matlab"):
        importlib.import_module(f"control.{room}")
    functions, kinds = (ct.tf, ct.ss, ct.rss, ct.zpk), (ct.TransferFunction, ct.StateSpace)
    stands: dict[str, tuple[Any, Any]] = {each.__name__: (each, _standing_in(each)) for each in functions}
    stands |= {kind.__name__: (kind, _StandIn(kind.__name__, (kind,), {})) for kind in kinds}
    for room in [room for name, room in sys.modules.items() if name.split(".")[0] == "control"]:
        for name, (own, stand) in stands.items():
            if getattr(room, name, None) is own:
                setattr(room, name, stand)


def _parts(value: object, depth: int = 3) -> Iterator[object]:
    yield value
    if depth and not isinstance(value, PhyFilter):
        held = value if isinstance(value, dict) else getattr(value, "__dict__", {})
        for part in value if isinstance(value, list | tuple) else held.values():
            yield from _parts(part, depth - 1)


class _Run:
    """What is put in, where, and what comes of it."""

    systems = 0

    def __init__(self) -> None:
        self.outcomes: dict[str, tuple[str, str]] = {}
        self.filtered: set[str] = set()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Any:
        np.random.seed(0)  # noqa: NPY002  (what python-control draws from: the same systems in every run)
        before = _Run.systems
        result = yield
        if _Run.systems > before:
            self.filtered.add(item.nodeid)
        return result

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_call(self, item: pytest.Item) -> None:
        if any(isinstance(part, PhyFilter) for part in _parts(getattr(item, "funcargs", {}))):
            self.filtered.add(item.nodeid)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call" or not report.passed:
            crash = getattr(report.longrepr, "reprcrash", None)
            self.outcomes[report.nodeid] = report.outcome, crash.message if crash else ""

    def pytest_sessionfinish(self) -> None:
        found = {"outcomes": self.outcomes, "filtered": sorted(self.filtered), "systems": self.systems}
        Path(os.environ[REPORT]).write_text(json.dumps(found), encoding="utf-8")
