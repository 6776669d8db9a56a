"""Cells of the tables of results and of the models' pages, so that tests can hold them against what is found."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[1]


def row_of(after: str, label: str, page: str = "docs/results.md") -> dict[str, str]:
    """The cells of a row by the head of their column, in the first table behind a text."""
    text = (ROOT / page).read_text(encoding="utf-8")
    lines = [line for line in text[text.index(after) :].splitlines() if line.startswith("|")]
    row = next(line for line in lines if line.startswith(f"| {label} |"))
    head, values = ([cell.strip(" *") for cell in line.strip("|").split("|")][1:] for line in (lines[0], row))
    return dict(zip(head, values, strict=True))
