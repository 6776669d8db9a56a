"""Random search for what the suite has not seen: ``python -m tests.fuzz --minutes 10``, from the top of the checkout.

Every property test (the mutated files and messages and the random calls into FMUs are ones too) gets an equal share of
the time and a fresh seed. A failure prints the example, shrunk, and how to run it again.
"""

from __future__ import annotations

import argparse
import os
import secrets
import subprocess
import sys
from pathlib import Path

from tests.fuzz.plugin import COMMAND

ROOT = Path(__file__).parents[2]


def main() -> int:
    """Search; 1 if something was found."""
    parser = argparse.ArgumentParser(
        prog=COMMAND, description="Random search: all property tests, with other examples than the suite's."
    )
    parser.add_argument(
        "--minutes", type=float, default=5.0, help="time to search, without start and shrinking"
    )
    parser.add_argument("--seed", type=int, help="of an earlier search, to run it again")
    parser.add_argument(
        "--only", metavar="NAME", help="part of a test's name, or all of it: FILE::TEST[PARAMETERS]"
    )
    options = parser.parse_args()
    if not options.minutes > 0.0:
        parser.error(f"--minutes: expected a number > 0, got {options.minutes}")
    seed = secrets.randbelow(2**32) if options.seed is None else options.seed
    again = [COMMAND, f"--minutes {options.minutes:g} --seed {seed}"]
    print(" ".join([*again, *([f"--only '{options.only}'"] if options.only else [])]), flush=True)
    command = [sys.executable, "-m", "pytest", "-p", "tests.fuzz.plugin", f"--fuzz-minutes={options.minutes}"]
    # Slow ones too, one by one over the workers; no limit of CPU time.
    command += ["-q", "-rfE", "--dist=load", "-pno:tests.cpu_budget", "-pno:cacheprovider", "-m", ""]
    command += [f"--hypothesis-seed={seed}", *_selected(options.only)]
    environment = {**os.environ, "PHYFILTER_HYPOTHESIS_PROFILE": "fuzz"}
    return int(subprocess.run(command, cwd=ROOT, env=environment, check=False).returncode != 0)


def _selected(only: str | None) -> list[str]:
    if only and "::" in only:
        return ["-n0", only]
    tests = sorted(Path(ROOT, "tests").rglob("test_*.py"))
    files = [str(path) for path in tests if "from hypothesis import" in path.read_text(encoding="utf-8")]
    return [*files, *(["-k", only] if only else [])]


if __name__ == "__main__":
    sys.exit(main())
