"""What a check of an FMU came upon."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from ..results import plain
from .archive import ArchiveLimits
from .instance import FmuError

__all__ = ["CheckReport", "Checker", "Finding", "Rule"]

# As the loaders of Linux, macOS and Windows say it.
_MISSING = re.compile("cannot open shared object file|Library not loaded|or one of its dependencies")
Rule = Literal[
    "schema", "units", "variables", "structure", "names", "state", "dependencies", "derivatives", "step"
]
# Paragraphs of FMI 2.0 and of FMI 3.0.
RULES: Mapping[Rule, tuple[str, str]] = {
    "schema": ("2.2", "2.4"),
    "units": ("2.2.2", "2.4.3"),
    "variables": ("2.2.7", "2.4.7"),
    "structure": ("2.2.8", "2.4.8"),
    "names": ("2.2.9", "2.4.7"),
    "state": ("2.1.8", "2.2.7"),
    "dependencies": ("2.2.8", "2.2.9"),
    "derivatives": ("2.1.9", "2.2.12"),
    "step": ("4.2.2", "4.2.1"),
}


@dataclass(frozen=True)
class Finding:
    """Something that a check came upon.

    Parameters
    ----------
    level : {"error", "warning", "hint"}
        Errors break a rule of FMI or a promise of the description; warnings are what importers may stumble over; hints
        are worth knowing.
    stage : str
    message : str
    rule : str
        Of an error: the paragraph of the standard.
    """

    level: Literal["error", "warning", "hint"]
    stage: str
    message: str
    rule: str = ""


@dataclass(frozen=True)
class CheckReport:
    """Result of :func:`check`.

    Parameters
    ----------
    path : str
    stages : tuple of str
        Checks that were made, in order.
    findings : tuple of Finding
    figures : dict of str to float
        What was measured, such as the largest deviation from the reference.
    """

    path: str
    stages: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    figures: dict[str, float] = field(default_factory=dict)

    @property
    def ok(self) -> bool:
        """Whether no error was found."""
        return not self.errors

    @property
    def errors(self) -> tuple[Finding, ...]:
        """Findings that are errors."""
        return tuple(entry for entry in self.findings if entry.level == "error")

    def as_json(self) -> str:
        """All of it as JSON."""
        figures = plain(self.figures, infinite=True)
        return json.dumps(dataclasses.asdict(self) | {"ok": self.ok, "figures": figures}, indent=2)

    def __str__(self) -> str:
        verdict = "ok" if self.ok else f"{len(self.errors)} error{'s' * (len(self.errors) > 1)}"
        lines = [f"{self.path}: {verdict}"]
        for stage in self.stages:
            found = [entry for entry in self.findings if entry.stage == stage]
            state = "failed" if any(entry.level == "error" for entry in found) else "ok"
            lines.append(f"  {stage:<22} {state}")
            lines += [
                f"    {entry.level}: {entry.message}{f' ({entry.rule})' if entry.rule else ''}"
                for entry in found
            ]
        lines += [f"  {key}: {value:.3g}" for key, value in self.figures.items()]
        return "\n".join(lines)


class Checker:
    """Collects findings, stage by stage.

    Parameters
    ----------
    path : Path
    limits : ArchiveLimits, optional
    """

    def __init__(self, path: Path, limits: ArchiveLimits | None) -> None:
        self.path: Path = path
        self.limits: ArchiveLimits | None = limits
        self.fmi: str = ""
        self.needs_tool: bool = False
        self.unavailable: bool = False
        self.stages: list[str] = []
        self.findings: list[Finding] = []
        self.figures: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str, rule: Rule | None = None, *, probing: bool = False) -> Iterator[None]:
        """A stage that fails ends, and the others go on.

        Parameters
        ----------
        name : str
        rule : str, optional
            What its errors break.
        probing : bool
            Whether values are tried that the FMU may refuse by good right: then that it does is no error.
        """
        self.stages.append(name)
        self._rule: Rule | None = rule
        try:
            yield
        except FmuError as error:
            if error.status == "ended":
                self.hint(str(error))
            elif self.lacks(error):
                self.unavailable = True
                self.warning(f"not run, for want of something outside the FMU: {error}")
            elif probing and error.status in ("discard", "error", "refused"):
                self.warning(f"cannot be looked at further: {error}")
            else:
                self.error(str(error))
        except (ValueError, OSError) as error:
            self.error(str(error))
        except (ArithmeticError, MemoryError, RecursionError) as error:
            self.error(
                f"a number or a nesting that this machine cannot hold: {type(error).__name__}: {error}"
            )

    def lacks(self, error: FmuError) -> bool:
        """Whether an FMU fails for what this machine has not: a library that it links, the tool that it says it needs.

        Parameters
        ----------
        error : FmuError
        """
        if error.call == "Instantiate":
            return self.needs_tool
        return error.call == "load the binary" and bool(_MISSING.search(str(error)))

    def error(self, message: str, rule: Rule | None = None) -> None:
        """A rule or a promise broken."""
        broken = rule or self._rule
        where = f"FMI {self.fmi}, {RULES[broken][self.fmi == '3.0']}" if broken and self.fmi else ""
        self.findings.append(Finding("error", self.stages[-1], message, where))

    def warning(self, message: str) -> None:
        """Something that importers may stumble over."""
        self.findings.append(Finding("warning", self.stages[-1], message))

    def hint(self, message: str) -> None:
        """Something worth knowing."""
        self.findings.append(Finding("hint", self.stages[-1], message))

    def report(self) -> CheckReport:
        """What was found so far."""
        return CheckReport(str(self.path), tuple(self.stages), tuple(self.findings), self.figures)
