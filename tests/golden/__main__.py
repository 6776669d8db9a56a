"""Every figure of the library on fixed random cases, kept before a change and compared after it.

    python -m tests.golden record build/golden.json      before: on the code as it is
    python -m tests.golden compare build/golden.json     after: what differs, by name; status 1 if anything does

Sections: ``filters`` (filter, loop and disturbance with every analysis), ``learning`` (recordings by shapes by orders),
``exports`` (digests of C and of FMU descriptions), ``models`` (what ``phyfilter-ctl run MODEL --quick`` reports).
Numbers agree to a billionth of themselves on one machine; on another, kernels round otherwise. A refusal is a figure
too: its type counts, its words do not.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from tests.golden.cases import SECTIONS

SAME = 1e-9  # of the larger of two numbers: what a change of the order of sums leaves
SMALL = 1e-12  # of what is nothing but rounding
SHOWN = 40


def differences(before: Mapping[str, Any], after: Mapping[str, Any]) -> Iterator[str]:
    """What is not the same in a case, in words."""
    for name in sorted({*before, *after}):
        if name not in before or name not in after:
            yield f"{name}: {'is new' if name not in before else 'is gone'}"
            continue
        old, new = before[name], after[name]
        if isinstance(old, float | int) and isinstance(new, float | int):
            if old != new and not math.isclose(old, new, rel_tol=SAME, abs_tol=SMALL):
                yield f"{name}: {old!r} was, {new!r} is"
        elif old != new:
            yield f"{name}: {old!r} was, {new!r} is"


def found(section: str, count: int | None) -> dict[str, dict[str, Any]]:
    """Figures of a section by case."""
    cases = SECTIONS[section]()
    kept = list(cases)[: None if count is None else count]
    result, began = {}, time.monotonic()
    for number, name in enumerate(kept, start=1):
        result[name] = cases[name]()
        if sys.stderr.isatty():
            print(f"\r{section}: {number} of {len(kept)}", end="", file=sys.stderr, flush=True)
    figures = sum(map(len, result.values()))
    print(f"{section}: {len(kept)} cases, {figures} figures in {time.monotonic() - began:.0f} s", flush=True)
    return result


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.golden",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("what", choices=("record", "compare"))
    parser.add_argument("file", type=Path)
    parser.add_argument("--only", nargs="+", choices=SECTIONS, default=list(SECTIONS), help="sections (all)")
    parser.add_argument("--count", type=int, metavar="N", help="the first N cases of each section")
    options = parser.parse_args()
    if options.what == "record":
        kept = json.loads(options.file.read_text(encoding="utf-8")) if options.file.exists() else {}
        kept |= {section: found(section, options.count) for section in options.only}
        options.file.parent.mkdir(parents=True, exist_ok=True)
        options.file.write_text(json.dumps(kept, indent=0), encoding="utf-8")
        return 0
    kept = json.loads(options.file.read_text(encoding="utf-8"))
    if missing := [section for section in options.only if section not in kept]:
        parser.error(f"{options.file} has no {', '.join(missing)}: record them on the code as it was")
    changed: list[str] = []
    for section in options.only:
        for case, figures in found(section, options.count).items():
            before = kept[section].get(case)
            told = ["is new"] if before is None else differences(before, json.loads(json.dumps(figures)))
            changed += [f"{section}, {case}: {text}" for text in told]
    print(*changed[:SHOWN], sep="\n", end="\n" * bool(changed))
    print(f"{len(changed)} figures differ" if changed else "all figures are as they were")
    return int(bool(changed))


if __name__ == "__main__":
    sys.exit(main())
