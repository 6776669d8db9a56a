"""python-control's own tests with PhyFilters in them: ``python -m tests.peers.python_control``.

Fetches the source of the installed version from PyPI into a temporary folder and runs its tests of linear systems
twice: as they are, and with a PhyFilter for every stable, strictly proper system with one input, one output and
continuous time that a test gives by numbers, or draws. Prints how many were put in and every test that comes out
otherwise, with the reason. Fails where there is none. With ``--quick`` only what fails with filters runs as it is.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tests.peers.put_in import PUT_IN, REPORT

ROOT = Path(__file__).parents[2]
# Those that take linear systems; plots are compared by tests/identities/test_python_control.py.
_FILES = (
    "bdalg canonical convert discrete frd freqresp input_element_int interconnect iosys lti margin matlab minreal "
    "modelsimp namedio nyquist pzmap rlocus statefbk statesp stochsys sysnorm timebase timeresp trdata "
    "type_conversion xferfcn"
)
TESTS = [f"control/tests/{name}_test.py" for name in _FILES.split()]
_TYPE = "with numbers and other filters a filter gives a transfer function, with state spaces one of those"
_STATES = "the states are the filter's sections, w[i], not the numbers that the test gave"
_NAME = "a filter is called phyfilter and no number is counted up for it"
_MONIC = "D begins with 1: both sides of the fraction have been divided"
# Test, error, reason.
REASONS = [
    (
        r"type_conversion_test.*truediv-tf-frd-xrd",
        "DID NOT RAISE",
        "a filter can be divided by measured responses",
    ),
    (r"type_conversion_test.*", r"assert False|DID NOT RAISE", _TYPE),
    (r"type_conversion_test.*truediv-tf-tf-tf", "for \\*\\* or pow", "a filter's copy is a state space"),
    (r"iosys_test.*test_linear(_interconnection|iosys_statespace)", "assert False|no attribute 'A'", _TYPE),
    (r"bdalg_test.*update_names", "number of states", _TYPE),
    (r"timeresp_test.*(to_pandas|signal_labels)", r"x\[", _STATES),
    (r"trdata_test.*trdata_params", "", _STATES),
    (r"matlab_test.*Connect2|modelsimp_test.*Modred", "not almost equal", _STATES),
    (r"xferfcn_test.*(truncate_coefficients|test_append)", "Not equal", _MONIC),
    (r"(iosys_test.*sstf_rename|namedio_test.*|frd_test.*named_signals)", "phyfilter|not True", _NAME),
    (
        r"interconnect_test.*string_inputoutput",
        "phyfilter",
        "two filters of one name: name them, ct.ss(F, name=...)",
    ),
    (r"xferfcn_test.*loadable_repr", "TransferFunc", "the name phyfilter is printed too"),
    (r"pzmap_test.*", "Not equal", "a filter's poles come slowest first"),
    (r"statefbk_test.*Gramsys", "slycot", "a filter is a state space too, and not refused"),
    (r"statefbk_test.*statefbk_errors", "did not match", "a filter is a state space too, and not refused"),
    (r"iosys_test.*test_connect", "FrozenInstance", "a filter is frozen"),
]


def fetched(folder: Path) -> Path | None:
    """The unpacked source of the installed version, from PyPI; None out of its reach."""
    wanted = f"control=={version('control')}"
    pip = [
        sys.executable,
        "-m",
        "pip",
        "download",
        "-q",
        "--no-deps",
        "--no-binary",
        "control",
        "--retries",
        "1",
    ]
    done = subprocess.run([*pip, "-d", str(folder), wanted], capture_output=True, text=True, check=False)
    if done.returncode:
        why = (done.stderr.strip().splitlines() or ["pip gives no reason"])[-1]
        print(f"skipped: python-control's own tests, for the source of {wanted} is out of reach ({why})")
        return None
    (archive,) = folder.glob("*.tar.gz")
    subprocess.run(["tar", "-xf", archive.name], cwd=folder, check=True)
    return folder / archive.name.removesuffix(".tar.gz")


def pytest_with(plugin: str, *files: str) -> list[str]:
    """The command that runs test files with a module of ours beside them."""
    options = ["-q", "-p", "no:cacheprovider", "-p", plugin]
    return [sys.executable, "-m", "pytest", *options, *files]


def started(source: Path, put_in: bool, tests: Sequence[str] = TESTS) -> subprocess.Popen[str]:
    """A run of the tests, or of those named."""
    environment = os.environ | {
        REPORT: str(source / f"{put_in}.json"),
        "PYTHONPATH": os.pathsep.join(map(str, (source, ROOT))),
        "MPLBACKEND": "Agg",
        "OPENBLAS_NUM_THREADS": "1",
    } | ({PUT_IN: "1"} if put_in else {})  # fmt: skip
    command = pytest_with("tests.peers.put_in", *tests)
    with open(source / f"{put_in}.txt", "w") as log:
        return subprocess.Popen(command, cwd=source, env=environment, stdout=log, stderr=log, text=True)


def reason(test: str, error: str) -> str:
    """Why it fails with filters; "" for none that is known."""
    return next((why for name, says, why in REASONS if re.search(name, test) and re.search(says, error)), "")


def _outcome(source: Path, put_in: bool) -> dict[str, Any]:
    report = source / f"{put_in}.json"
    if not report.exists():
        raise SystemExit((source / f"{put_in}.txt").read_text()[-3000:])
    return json.loads(report.read_text(encoding="utf-8"))


def compared(plain: dict[str, Any], ours: dict[str, Any]) -> tuple[dict[str, list[str]], list[str]]:
    """Tests that come out otherwise, by their reason; and those without one."""
    explained, open_ = dict[str, list[str]](), list[str]()
    for test in sorted(plain["outcomes"] | ours["outcomes"]):
        (before, _), (after, error) = (run["outcomes"].get(test, ("absent", "")) for run in (plain, ours))
        if before == after:
            continue
        name = test.removeprefix("control/tests/").encode("unicode_escape").decode()
        if why := reason(test, error) if (before, after) == ("passed", "failed") else "":
            explained.setdefault(why, []).append(name)
        else:
            open_.append(f"{name}: {before}, then {after}: {error.strip().partition(chr(10))[0]}")
    return explained, open_


def main() -> int:
    """Run both and compare; 1 if a difference has no reason."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="as they are only those that fail with filters")
    quick: bool = parser.parse_args().quick
    with tempfile.TemporaryDirectory() as folder:
        source = fetched(Path(folder))
        if source is None:
            return 0
        runs = (
            [started(source, put_in=True)] if quick else [started(source, put_in) for put_in in (False, True)]
        )
        for run in runs:
            run.wait()
        ours = _outcome(source, put_in=True)
        if quick:
            failed = [test for test, (kind, _) in ours["outcomes"].items() if kind == "failed"]
            started(source, put_in=False, tests=failed).wait()
        plain = _outcome(source, put_in=False)
    systems, tests = ours["systems"], len(ours["filtered"])
    print(f"control {version('control')}: {systems} systems became PhyFilters, in {tests} tests")
    for name, run in (("plain", plain), ("with filters", ours)):
        counts = Counter(kind for kind, _ in run["outcomes"].values())
        print(f"{name}: {', '.join(f'{counts[kind]} {kind}' for kind in ('passed', 'failed', 'skipped'))}")
    if quick:
        ours["outcomes"] = {test: ours["outcomes"][test] for test in plain["outcomes"]}
    explained, open_ = compared(plain, ours)
    for why, names in explained.items():
        print(f"{len(names)} otherwise: {why}", *names, sep="\n  ")
    print(f"{len(open_)} otherwise without a known reason", *open_, sep="\n  ")
    return int(bool(open_) or not tests)


if __name__ == "__main__":
    sys.exit(main())
