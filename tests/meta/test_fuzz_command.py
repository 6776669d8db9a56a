"""The random search finds what the suite's few examples do not, says how to find it again, and ends in time."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# One example in a thousand fails; the suite would look at one.
PROPERTY = """
from hypothesis import given, settings, strategies as st

@settings(max_examples=1, deadline=None)
@given(n=st.integers(0, 2**40))
def test_property(n):
    assert n % 1000 != 123

@settings(max_examples=1)
@given(n=st.integers(0, 2**40), data=st.data())
def test_sound(n, data):
    data.draw(st.integers())

def test_no_property():
    raise AssertionError
"""


def search(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    (folder / "test_it.py").write_text(PROPERTY)
    (folder / "pytest.ini").write_text("[pytest]\n")
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-c",
        str(folder / "pytest.ini"),
        "-p",
        "tests.fuzz.plugin",
        "-p",
        "no:cacheprovider",
    ]
    return subprocess.run(
        [*command, f"--rootdir={folder}", *options, str(folder / "test_it.py")],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip


@pytest.mark.release
def test_a_rare_failure_is_found_twice(tmp_path):
    runs = [
        search(tmp_path, "--fuzz-minutes=2", "--hypothesis-seed=7", "-k", "test_property") for _ in range(2)
    ]
    found = [re.search(r"n=(\d+)", run.stdout) for run in runs]
    assert [run.returncode for run in runs] == [1, 1]
    assert [int(match[1]) % 1000 if match else runs for match in found] == [123, 123]
    assert (
        runs[0].stdout.count("again: python -m tests.fuzz --minutes 2 --seed 7 --only 'test_it.py::test_prop")
        == 1
    )


@pytest.mark.slow
def test_the_time_ends_a_search_that_finds_nothing(tmp_path):
    run = search(tmp_path, "--fuzz-minutes=0.005", "--hypothesis-seed=7", "-k", "test_sound or test_no")
    assert run.returncode == 0, run.stdout
    assert "1 passed, 2 deselected" in run.stdout
    count = re.search(r"(\d+) examples of 1 property tests", run.stdout)
    assert count is not None
    assert int(count[1]) > 1
