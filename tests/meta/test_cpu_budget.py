"""A test file that costs too much fails the run, also where workers of pytest-xdist share it."""

import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from tests.cpu_budget import LIMIT, over_budget

ROOT = Path(__file__).parents[2]
SLOW = "@pytest.mark.slow\n"


def test_sentences():
    assert over_budget(Counter({"a.py": LIMIT / 2})) == []
    (sentence,) = over_budget(Counter({"a.py": LIMIT / 2, "b.py": 2.0 * LIMIT}))
    assert sentence.startswith(f"b.py: {2.0 * LIMIT:.0f} CPU s of at most")


@pytest.mark.slow
@pytest.mark.parametrize(("workers", "mark"), [("1", ""), ("0", ""), ("1", SLOW)])
def test_run_fails(tmp_path, workers, mark):
    (tmp_path / "conftest.py").write_text(
        "import tests.cpu_budget\n"
        "tests.cpu_budget.over_budget.__defaults__ = (-1.0,)  # CPU time may be counted in whole ticks\n"
        "pytest_plugins = ['tests.cpu_budget']\n"
    )
    (tmp_path / "test_a.py").write_text(f"import pytest\n{mark}def test_a(): pass\n")
    options = ["-n", workers, "-p", "no:cacheprovider", "-c", os.devnull, "--rootdir", str(tmp_path)]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", *options, str(tmp_path)],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ("test_a.py: 0 CPU s of at most" in done.stdout) == (not mark), done.stdout
    assert done.returncode == (0 if mark else 1)
