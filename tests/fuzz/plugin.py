"""The pytest plugin of ``python -m tests.fuzz``: of the tests, the property tests; of their examples, as many as there
is time for."""

from __future__ import annotations

import functools
import os
import time
from collections.abc import Generator

import hypothesis
import pytest
from hypothesis.errors import HypothesisException

_UNBOUNDED = 10**9
COMMAND = "python -m tests.fuzz"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--fuzz-minutes", type=float, default=1.0, help="time to search, shared by all property tests"
    )


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(_Summary())


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave property tests only, and lift the number of examples that one may have set for the suite."""
    properties = [
        item for item in items if getattr(getattr(item, "function", None), "is_hypothesis_test", False)
    ]
    config.hook.pytest_deselected(items=[item for item in items if item not in properties])
    items[:] = properties
    for item in properties:
        assert isinstance(item, pytest.Function)
        # Hypothesis has no other place for it: a second @settings is refused.
        item.function._hypothesis_internal_use_settings = hypothesis.settings(
            item.function._hypothesis_internal_use_settings,
            max_examples=_UNBOUNDED,
            derandomize=False,
            database=None,
            deadline=None,
            suppress_health_check=list(hypothesis.HealthCheck),
        )


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Function) -> Generator[None, object, object]:
    """Search for this test's share of the time. A skip is the one thing that ends a search at once."""
    workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    share = min(1.0, workers / len(item.session.items))
    seconds = 60.0 * item.config.getoption("--fuzz-minutes") * share
    end, over, failed, examples = 0.0, False, False, 0
    inner = item.function.hypothesis.inner_test

    @functools.wraps(inner)
    def bounded(*arguments: object, **keywords: object) -> None:
        nonlocal end, over, failed, examples
        examples += 1
        try:
            inner(*arguments, **keywords)
        except HypothesisException:  # the example does not fit: no failure
            raise
        except Exception:
            failed = True
            raise
        now = time.monotonic()
        # From the first example on, which may have compiled something for all of them.
        end = end or now + seconds
        over = not failed and now > end  # what has failed is shrunk for as long as that takes
        if over:
            pytest.skip("the time is over")

    item.function.hypothesis.inner_test = bounded
    try:
        return (yield)
    except pytest.skip.Exception:
        if not over:
            raise
        return None
    finally:
        item.function.hypothesis.inner_test = inner
        item.user_properties.append(("examples", examples))


class _Summary:
    """What was searched and found, by whatever worker."""

    def __init__(self) -> None:
        self.examples: dict[str, int] = {}
        self.failed: list[str] = []

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.failed.append(report.nodeid)
        if report.when == "call":
            self.examples[report.nodeid] = int(dict(report.user_properties).get("examples", 0))

    def pytest_terminal_summary(
        self, terminalreporter: pytest.TerminalReporter, config: pytest.Config
    ) -> None:
        least = min(self.examples.items(), key=lambda entry: entry[1], default=("", 0))
        terminalreporter.write_line(
            f"{sum(self.examples.values())} examples of {len(self.examples)} property tests, at least {least[1]} each "
            f"({least[0]})"
        )
        minutes, seed = config.getoption("--fuzz-minutes"), config.getoption("--hypothesis-seed")
        for name in self.failed:
            terminalreporter.write_line(
                f"again: {COMMAND} --minutes {minutes:g} --seed {seed} --only '{name}'", red=True
            )
