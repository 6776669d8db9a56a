"""CPU time until a program can begin: imports beside python-control's own, and the command's help.

    python benchmarks/start.py [--quick]

Median of several fresh processes each, one after the other in turn, so that a busy machine slows all alike. Judged:
``import phyfilter_ctl`` at most 1.3 times ``import control``, the help at most 0.3 s; "first filter" is what a user
pays in all, python-control included.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys

import numpy as np

MOST_IMPORT, MOST_HELP = 1.3, 0.3  # times import control; s
PROGRAMS = {
    "import control": ["-c", "import control"],
    "import phyfilter_ctl": ["-c", "import phyfilter_ctl"],
    "first filter": ["-c", "import phyfilter_ctl as pf; pf.place_poles([-20.0]).sampled(0.01)"],
    "phyfilter-ctl --help": ["-m", "phyfilter_ctl", "--help"],
}


def cpu_seconds(arguments: list[str]) -> float:
    """User and system time of one fresh process, less that of an empty one."""
    spent = []
    for program in (arguments, ["-c", ""]):
        before = os.times()
        subprocess.run([sys.executable, *program], check=True, stdout=subprocess.DEVNULL)
        after = os.times()
        spent.append(sum(after[2:4]) - sum(before[2:4]))
    return spent[0] - spent[1]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="three processes each, nothing judged")
    quick = parser.parse_args().quick
    runs = np.array(
        [[cpu_seconds(program) for program in PROGRAMS.values()] for _ in range(3 if quick else 11)]
    )
    seconds = dict(zip(PROGRAMS, np.median(runs, axis=0).tolist(), strict=True))
    for name, value in seconds.items():
        print(f"{name:22}{value:6.2f} s   {value / seconds['import control']:5.2f} times import control")
    within = (
        seconds["import phyfilter_ctl"] <= MOST_IMPORT * seconds["import control"]
        and seconds["phyfilter-ctl --help"] <= MOST_HELP
    )
    return int(not within and not quick)


if __name__ == "__main__":
    sys.exit(main())
