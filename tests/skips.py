"""Which skips a run is to have, by reason and number: a pytest plugin for CI, where a test that cannot run is a fault.

    pytest --skips FILE             or PHYFILTER_SKIPS=FILE pytest

Each line of FILE is a number and a reason; empty lines and what follows # do not count. In reasons paths are shortened
to the name of what they lead to, and numbers and versions to 0, so that they are the same everywhere. A run with other
skips fails and says which. Without FILE nothing is checked.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import pytest

_PATH = re.compile(r"(?:[A-Za-z]:)?[/\\\\](?:[^\s/\\\\'\",:;()]+[/\\\\])+")
_NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)*(?!\w)")  # and not h5py


def normal(reason: str) -> str:
    """A reason as every machine gives it, in one line.

    Examples
    --------
    >>> normal("Skipped: no C compiler: /usr/local/bin/gcc 13.2.0 failed")
    'no C compiler: gcc 0 failed'
    """
    return " ".join(_NUMBER.sub("0", _PATH.sub("", reason.removeprefix("Skipped: "))).split())


def expected(text: str) -> Counter[str]:
    """Numbers by reason.

    Raises
    ------
    ValueError
        If a line does not begin with a number > 0 and a reason, or a reason stands there twice.
    """
    found: Counter[str] = Counter()
    for line in text.splitlines():
        count, _, reason = line.partition("#")[0].strip().partition(" ")
        reason = normal(reason)
        if not count:
            continue
        if not (count.isdecimal() and int(count) > 0 and reason):
            raise ValueError(f"expected a number > 0 and a reason, got {line!r}")
        if reason in found:
            raise ValueError(f"expected each reason once, got twice: {reason}")
        found[reason] = int(count)
    return found


def differences(wanted: Counter[str], found: Counter[str]) -> list[str]:
    """A sentence for each reason whose number is another one."""
    return [
        f"{found[reason]} skipped, expected {wanted[reason]}: {reason}"
        for reason in sorted(wanted | found)
        if found[reason] != wanted[reason]
    ]


def _reasons(reports: Iterable[object]) -> Counter[str]:
    # (path, line, reason) of what was skipped; expected failures are reported as skipped too, and have text. A file is
    # skipped once, though its tests and its examples are.
    known = [
        (each, each.longrepr)
        for each in reports
        if isinstance(each, pytest.TestReport | pytest.CollectReport)
    ]
    tests = [where for each, where in known if isinstance(each, pytest.TestReport)]
    files = {
        where for each, where in known if isinstance(each, pytest.CollectReport) and isinstance(where, tuple)
    }
    return Counter(normal(str(where[2])) for where in (*tests, *files) if isinstance(where, tuple))


_wanted = pytest.StashKey[Counter[str]]()
_said = pytest.StashKey[list[str]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--skips",
        metavar="FILE",
        default=os.environ.get("PHYFILTER_SKIPS"),
        help="skips that are expected: see tests/skips.py",
    )


def pytest_configure(config: pytest.Config) -> None:
    path = config.getoption("--skips")
    if path and not hasattr(config, "workerinput"):  # the controller of workers hears of all of them
        try:
            config.stash[_wanted] = expected(Path(path).read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise pytest.UsageError(f"--skips {path}: {error}") from error


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    config = session.config
    terminal = config.pluginmanager.get_plugin("terminalreporter")
    if _wanted not in config.stash or terminal is None:
        return
    config.stash[_said] = differences(config.stash[_wanted], _reasons(terminal.stats.get("skipped", ())))
    if config.stash[_said] and session.exitstatus in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    for sentence in config.stash.get(_said, []):
        terminalreporter.write_line(sentence, red=True)
