"""How the suite runs everywhere: one BLAS thread a worker, hypothesis without chance, what cannot be compiled skipped.

Random search is a command of its own, ``python -m tests.fuzz``.
"""

from __future__ import annotations

import doctest
import gc
import importlib
import os
import signal
import sys
import threading
from collections.abc import Generator, Iterator
from functools import cache
from pathlib import Path
from types import ModuleType

# Before anything imports numpy: two workers with two threads each wait for one another. A setting from outside stays.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# A shell starts what runs in its background deaf to Ctrl-C, and commands that tests start and stop would be so too.
if (
    signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    and threading.current_thread() is threading.main_thread()
):
    signal.signal(signal.SIGINT, signal.default_int_handler)

import hypothesis
import pytest
from _pytest.doctest import DoctestModule

pytest_plugins = ["tests.cpu_budget", "tests.skips"]

# How long an example takes to draw says how busy the machine is.
_CALM = {"deadline": None, "database": None, "suppress_health_check": [hypothesis.HealthCheck.too_slow]}
hypothesis.settings.register_profile("suite", derandomize=True, **_CALM)
hypothesis.settings.register_profile("fuzz", print_blob=True, **_CALM)
hypothesis.settings.load_profile(os.environ.get("PHYFILTER_HYPOTHESIS_PROFILE", "suite"))


# Thousands of tests are looked through for garbage again and again: a tenth of the suite's time.
gc.set_threshold(100_000, 20, 100)


@pytest.fixture(scope="session", autouse=True)
def quick_compiler(request: pytest.FixtureRequest) -> Iterator[None]:
    """The default one without optimisation, which takes a third of the time; $CC from outside stays.

    Contraction is off in any case, so that the numbers are the same. Depth (``-m slow``) is compiled as users do.
    """
    from phyfilter_ctl.codegen import find_compiler  # the controller of the workers gets by without

    with pytest.MonkeyPatch.context() as patch:
        quick = "not slow" in (request.config.getoption("markexpr") or "") and "CC" not in os.environ
        if quick and not _why_not() and len(command := find_compiler().command) == 1:
            patch.setenv("CC", f"""sh -c 'exec {command[0]} "$@" -O0' {command[0]}""")
        yield


# In the message of what an extra brings, and how to install it.
_EXTRA = "pip install 'phyfilter-ctl["


@cache
def _why_not() -> str:
    """Why nothing can be compiled here; "" where it can."""
    from phyfilter_ctl.codegen import CompilerError, find_compiler

    try:
        find_compiler()
    except CompilerError as error:
        return str(error)
    return ""


def _missing(error: BaseException | None) -> str:
    """What this machine lacks, where an error, or what it came from, says so: a compiler or an extra; else ""."""
    from phyfilter_ctl.codegen import CompilerError

    # pytest collects the failures of a doctest in `failures`.
    causes = [error, *getattr(error, "failures", ())]
    seen: set[int] = set()
    while causes:
        cause = causes.pop()
        if cause is None or id(cause) in seen:
            continue
        seen.add(id(cause))
        if isinstance(cause, CompilerError) and str(cause).startswith("no C compiler"):
            return _why_not()
        if isinstance(cause, ImportError) and (" needs the extra " in str(cause) or _EXTRA in str(cause)):
            return str(cause)
        if isinstance(cause, doctest.UnexpectedException):
            causes.append(cause.exc_info[1])
        causes += [cause.__cause__, cause.__context__]
    return ""


class _Doctests(DoctestModule):
    """Examples of a module under the name by which people import it: the models at the top are in the package too."""

    def _getobj(self) -> ModuleType:
        parts = self.path.relative_to(self.config.rootpath).with_suffix("").parts
        name = ".".join(("phyfilter_ctl", *parts) if parts[0] == "models" else parts)
        try:
            return importlib.import_module(name.removesuffix(".__init__"))
        except ImportError as error:
            missing = _missing(error)
            if (
                isinstance(error, ModuleNotFoundError)
                and (error.name or "").partition(".")[0] != "phyfilter_ctl"
            ):
                missing = f"{name} needs {error.name}, which is not installed"
            if missing:
                pytest.skip(missing, allow_module_level=True)
            raise


@pytest.hookimpl(wrapper=True)
def pytest_collect_file(
    file_path: Path, parent: pytest.Collector
) -> Generator[None, list[pytest.Collector], list[pytest.Collector]]:
    """Take examples of the package's modules as above; an import that fails for another reason is an error."""
    ours = (
        file_path.is_relative_to(parent.config.rootpath)
        and file_path.relative_to(parent.config.rootpath).parts[0]
    )
    return [
        _Doctests.from_parent(parent, path=file_path)
        if isinstance(each, DoctestModule) and ours in ("models", "phyfilter_ctl")
        else each
        for each in (yield)
    ]


@pytest.fixture(autouse=True)
def _no_figures_left() -> Iterator[None]:
    """Close what a test drew: python-control draws the next one into the figure that is open."""
    yield
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Turn the errors that no test is about into a skip with its reason."""
    report = yield
    if report.failed and call.excinfo is not None and (missing := _missing(call.excinfo.value)):
        report.outcome = "skipped"
        report.longrepr = (str(item.path), item.location[1] or 0, f"Skipped: {missing}")
    return report
