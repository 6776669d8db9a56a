"""A run with other skips than those listed fails and says which, also where workers do the work."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.skips import differences, expected, normal

ROOT = Path(__file__).parents[2]
TESTS = {
    "test_one.py": """
import pytest

@pytest.mark.parametrize("path", ["/usr/bin/gcc", "/opt/x/bin/gcc"])
def test_compiled(path):
    pytest.skip(f"{path} 12.2 is no use: 3 faults")

@pytest.mark.xfail
def test_known():
    raise AssertionError

def test_sound():
    pass
""",
    "test_two.py": "import pytest\npytest.importorskip('attic', reason='the extra attic is not installed')",
    "test_three.py": "import pytest\npytest.importorskip('attic', reason='the extra attic is not installed')",
}
ALL = "2  gcc 0 is no use: 0 faults  # by 2 of them\n\n2  the extra attic is not installed\n"


def run(folder: Path, listed: str, *options: str) -> tuple[int, str]:
    (folder / "skips.txt").write_text(listed)
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-c",
        str(folder / "pytest.ini"),
        f"--rootdir={folder}",
        str(folder),
    ]
    command += [
        "-p",
        "xdist.plugin",
        "-p",
        "tests.skips",
        "-pno:cacheprovider",
        f"--skips={folder / 'skips.txt'}",
        *options,
    ]
    lean = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    done = subprocess.run(command, cwd=ROOT, env=lean, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in {**TESTS, "pytest.ini": "[pytest]\n"}.items():
        (tmp_path / name).write_text(text)
    return tmp_path


def test_skips_as_listed_pass(folder: Path) -> None:
    code, said = run(folder, ALL, "-n0")
    assert code == 0, said


def test_other_skips_fail_the_run_and_are_named(folder: Path) -> None:
    code, said = run(folder, "1 gcc 0 is no use: 0 faults\n1 a tool is not there", "-n2")
    assert code == 1
    for sentence in (
        "2 skipped, expected 1: gcc 0 is no use: 0 faults",
        "2 skipped, expected 0: the extra attic is not installed",
        "0 skipped, expected 1: a tool is not there",
    ):
        assert sentence in said


def test_a_bad_list_ends_the_run_before_it_begins(folder: Path) -> None:
    code, said = run(folder, "many reasons", "-n0")
    assert code == pytest.ExitCode.USAGE_ERROR
    assert "expected a number > 0 and a reason, got 'many reasons'" in said


def test_reasons_are_the_same_on_every_machine() -> None:
    for reason in ("Skipped: '/home/me/a b/c.py' 3.11 failed", "'C:\\x\\c.py' 3.12.1 failed"):
        assert normal(reason).endswith("c.py' 0 failed")
    assert (
        normal("pip install 'phyfilter-ctl[torch]'\n  or none")
        == "pip install 'phyfilter-ctl[torch]' or none"
    )
    assert normal("h5py 3 of 3.11.0 for Go1") == "h5py 0 of 0 for Go1"
    with pytest.raises(ValueError, match="expected each reason once, got twice: a 0"):
        expected("1 a 1\n2 a 2")
    assert differences(expected("2 a"), expected("2 a")) == []
