"""What :mod:`tests.mutate.recording` wrote, read back: tests by file and line."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from tests.mutate.recording import FIXTURE


@dataclass(frozen=True, eq=False)
class Records:
    """Lines and tests of one state of the code.

    Attributes
    ----------
    folder : Path
        With the files of coverage.py, one of each process.
    root : str
        Where the tree stood.
    tests : mapping
        By name: seconds, fixtures and whether it passed.
    """

    folder: Path
    root: str
    tests: Mapping[str, Mapping[str, Any]]

    @classmethod
    def read(cls, folder: Path) -> Records:
        """The records of a folder."""
        tests: dict[str, Mapping[str, Any]] = {}
        for path in sorted(folder.glob("tests.*.json")):
            tests |= json.loads(path.read_text(encoding="utf-8"))
        return cls(folder, (folder / "root").read_text(encoding="utf-8"), tests)

    def seconds(self, test: str) -> float:
        """That a test took."""
        return float(self.tests[test]["seconds"])

    @cache  # noqa: B019  # one object a run
    def tests_by_line(self, file: str) -> Mapping[int, set[str]]:
        """Tests that passed and run a line of a file, by line; a fixture's lines are those of all that name it."""
        import coverage

        passed = [test for test, known in self.tests.items() if known["passed"]]
        naming: dict[str, list[str]] = defaultdict(list)
        for test in passed:
            for fixture in self.tests[test]["fixtures"]:
                naming[FIXTURE + fixture].append(test)
        good, found = set(passed), defaultdict[int, set[str]](set)
        for path in sorted(self.folder.glob("lines.*")):
            data = coverage.CoverageData(str(path))
            data.read()
            for line, contexts in data.contexts_by_lineno(f"{self.root}/{file}").items():
                for context in contexts:
                    found[line] |= set(naming[context]) if context.startswith(FIXTURE) else good & {context}
        return found
