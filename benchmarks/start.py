"""CPU time until a program can begin: imports beside python-control's own, and every command's help and typing errors.

    python benchmarks/start.py [--quick]

Fresh processes, one after the other in turn, so that a busy machine slows all alike. Judged: ``import phyfilter_ctl``
at most 1.3 times ``import control`` (medians, each less an empty process; not with ``--quick``); the help of every
command and job, and an option that it does not have, below 0.15 s each (the least of the rounds, Python's own start
included). "first filter" and "first design" are what a user pays in all, python-control included.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Mapping

import numpy as np

from phyfilter_ctl.cli import describe_commands

MOST_IMPORT, BUDGET = 1.3, 0.15  # times import control; s
COMMAND = ["-m", "phyfilter_ctl"]
PROGRAMS = {
    "nothing": ["-c", ""],
    "import control": ["-c", "import control"],
    "import phyfilter_ctl": ["-c", "import phyfilter_ctl"],
    "first filter": ["-c", "import phyfilter_ctl as pf; pf.place_poles([-20.0]).sampled(0.01)"],
    "first design": [*COMMAND, "design", "--poles", "-20,-20"],
}


def asked() -> dict[str, list[str]]:
    """What no work stands behind: help and a typing error of every command, job and model, and a command unknown."""
    names = [name.split()[1:] for name in describe_commands()]
    words = [[*name, option] for name in names for option in ("--help", "--no-such-option")]
    return {" ".join(each): [*COMMAND, *each] for each in [*words, ["no_such_command"]]}


def cpu_seconds(arguments: list[str]) -> float:
    """User and system time of one fresh process."""
    before = os.times()
    subprocess.run([sys.executable, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    after = os.times()
    return sum(after[2:4]) - sum(before[2:4])


def rounds(programs: Mapping[str, list[str]], count: int) -> np.ndarray:
    """Seconds, a row a round."""
    return np.array([[cpu_seconds(program) for program in programs.values()] for _ in range(count)])


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="three rounds; the imports are not judged")
    quick = parser.parse_args().quick
    medians = np.median(rounds(PROGRAMS, 3 if quick else 11), axis=0).tolist()
    seconds = {name: each - medians[0] for name, each in zip(PROGRAMS, medians, strict=True)}
    for name, value in list(seconds.items())[1:]:
        print(f"{name:64}{value:6.2f} s   {value / seconds['import control']:5.2f} times import control")
    words = asked()
    least = dict(zip(words, rounds(words, 3 if quick else 7).min(axis=0).tolist(), strict=True))
    for name, value in least.items():
        print(f"phyfilter-ctl {name:50}{value:6.2f} s{'   ABOVE THE BUDGET' if value > BUDGET else ''}")
    within = seconds["import phyfilter_ctl"] <= MOST_IMPORT * seconds["import control"]
    return int(max(least.values()) > BUDGET or not (within or quick))


if __name__ == "__main__":
    sys.exit(main())
