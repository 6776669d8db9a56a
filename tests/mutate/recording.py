"""A pytest plugin that notes which test runs which lines of the package, and how long it takes.

What a fixture of a module or of the session runs counts for all tests that name it. Lines are those that coverage.py
sees: of the test's own process, not of programs that it starts.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

FOLDER = "PHYFILTER_LINES"  # variable with the folder to write into
FIXTURE = "fixture "  # begins the context of a fixture, which no test's name does


class _Recorder:
    def __init__(self, package: Path, folder: Path) -> None:
        import coverage  # which the suite itself does without

        self._notes, self._tests = folder / f"tests.{os.getpid()}.json", {}
        data = folder / f"lines.{os.getpid()}"
        self._coverage = coverage.Coverage(data_file=data, include=[f"{package}/*"], config_file=False)
        self._contexts: list[str] = [""]
        self._failed: set[str] = set()
        self._coverage.start()

    def _enter(self, context: str) -> None:
        self._contexts.append(context)
        self._coverage.switch_context(context)

    def _leave(self) -> None:
        self._contexts.pop()
        self._coverage.switch_context(self._contexts[-1])

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, Any, Any]:
        self._enter(item.nodeid)
        begin = time.perf_counter()
        try:
            return (yield)
        finally:
            seconds = time.perf_counter() - begin
            self._tests[item.nodeid] = {
                "passed": item.nodeid not in self._failed,
                "seconds": round(seconds, 4), "fixtures": sorted(getattr(item, "fixturenames", ())),
            }  # fmt: skip
            self._leave()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if not report.passed:
            self._failed.add(report.nodeid)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(
        self, fixturedef: pytest.FixtureDef[Any], request: pytest.FixtureRequest
    ) -> Generator[None, Any, Any]:
        if fixturedef.scope == "function":
            return (yield)
        self._enter(f"{FIXTURE}{fixturedef.argname}")
        try:
            return (yield)
        finally:
            self._leave()

    def pytest_sessionfinish(self) -> None:
        self._coverage.stop()
        self._coverage.save()
        self._notes.write_text(json.dumps(self._tests), encoding="utf-8")


def pytest_configure(config: pytest.Config) -> None:
    controller = not hasattr(config, "workerinput") and getattr(config.option, "numprocesses", 0)
    if not controller:  # a worker, or the only process there is
        folder = Path(os.environ[FOLDER])
        config.pluginmanager.register(_Recorder(Path.cwd() / "phyfilter_ctl", folder), "lines")
