"""The mutation command: each kind of change, what a test kills and what it lets pass, and what no test runs."""

from __future__ import annotations

import tomllib
from collections import Counter
from pathlib import Path

import pytest

from tests.mutate import __main__ as command
from tests.mutate.mutants import (
    BOUNDARY,
    COMPARISON,
    CONSTANT,
    DROPPED,
    KINDS,
    OPERATOR,
    SIGN,
    drawn,
    mutants,
)

SOURCE = '''"""Docs with 1 number."""
LIMIT: float = 2.0


def bounded(x: float, log: list[str]) -> float:
    """x, at most 2.0."""
    if x >= LIMIT:
        log.append(f"{x + 1} is beyond")
        return LIMIT
    return x


def unseen(x: float) -> float:
    return -x * 3
'''
# Below, at and beyond the limit; what is logged is not looked at.
TESTS = """
from phyfilter_ctl.toy import bounded

def test_values():
    assert [bounded(x, []) for x in (1.0, 2.0, 5.0)] == [1.0, 2.0, 2.0]
"""


def changes(source: str) -> list[tuple[str, str, str]]:
    return [(each.kind, each.before, each.after) for each in mutants("toy.py", source)]


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("a = b - c", {(OPERATOR, "-", "+")}),
        ("a = (b) * c", {(OPERATOR, "*", "/"), (SIGN, "b", "(-(b))")}),
        ("a = b and c or d", {(OPERATOR, "and", "or"), (OPERATOR, "or", "and")}),
        ("a += b", {(OPERATOR, "+=", "-="), (DROPPED, "a += b", "pass")}),
        ("a = b is  not None", {(COMPARISON, "is  not", "is")}),
        ("a = b < c", {(COMPARISON, "<", ">="), (BOUNDARY, "<", "<=")}),
        ("a = b >= c", {(COMPARISON, ">=", "<"), (BOUNDARY, ">=", ">")}),
        ("a = 0.0, 1.5, 3", {(CONSTANT, "0.0", "1.0"), (CONSTANT, "1.5", "3.0"), (CONSTANT, "3", "4")}),
        ("a = True", {(CONSTANT, "True", "False")}),
        ("a = -b", {(SIGN, "-b", "b")}),
        ("a.b = c", {(DROPPED, "a.b = c", "pass")}),
        ("if a:\n    raise b", {(DROPPED, "if a:\n    raise b", "pass"), (DROPPED, "raise b", "pass")}),
        ('"""µ 1"""; a = "x" + f"{b + 1}"; f("µ")', {(OPERATOR, "+", "-"), (DROPPED, 'f("µ")', "pass")}),
        ("__all__ = [1]\ndef f(a: x + y): ...\nif TYPE_CHECKING:\n    a.b = c", set()),
    ],
)  # fmt: skip
def test_each_kind_of_change(source: str, expected: set[tuple[str, str, str]]) -> None:
    assert set(changes(source)) == expected
    assert len(changes(source)) == len(expected)


def test_kinds_are_drawn_in_equal_shares_and_again_by_the_seed() -> None:
    root = Path(command.ROOT)
    found = command.candidates(root, "filter")
    chosen = drawn(found, 30, 4)
    assert Counter(each.kind for each in chosen) == dict.fromkeys(KINDS, 5)
    assert chosen == drawn(found, 30, 4) != drawn(found, 30, 5)
    assert len(set(chosen)) == 30
    for each in chosen:
        source = (root / each.file).read_text(encoding="utf-8")
        assert each.applied(source) != source
        assert each.before in "\n".join(source.splitlines()[each.line - 1 :])
    with pytest.raises(
        ValueError, match=r"there is no phyfilter_ctl/attic; expected one of .*_intake, .* filter,"
    ):
        command.room_files(root, "attic")


@pytest.fixture
def toy(tmp_path: Path) -> Path:
    """A checkout of one module and one test."""
    (tmp_path / "phyfilter_ctl").mkdir()
    (tmp_path / "phyfilter_ctl" / "__init__.py").write_text("")
    (tmp_path / "phyfilter_ctl" / "toy.py").write_text(SOURCE)
    (tmp_path / "tests" / "mutate").mkdir(parents=True)
    for path in (command.ROOT / "tests" / "mutate").glob("*.py"):
        (tmp_path / "tests" / "mutate" / path.name).write_text(path.read_text())
    (tmp_path / "tests" / "test_toy.py").write_text(TESTS)
    (tmp_path / "pytest.ini").write_text("[pytest]\naddopts = -rf\n")
    return tmp_path


@pytest.mark.slow
def test_a_toy_room_has_killed_surviving_and_unseen_mutants(
    toy: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    pytest.importorskip(
        "coverage", reason="coverage is not installed: which tests run which lines is not recorded"
    )
    keep = tmp_path_factory.mktemp("keep")
    records = command.recorded(toy, keep)
    assert records.tests_by_line("phyfilter_ctl/toy.py").keys() >= {7, 8, 9, 10}
    everything = command.candidates(toy, "toy")
    outcomes = {
        (o.mutant.line, o.mutant.kind): (o.result, o.by)
        for o in command.survey(toy, records, "toy", everything, 2)
    }
    test = "tests/test_toy.py::test_values"
    assert outcomes[2, CONSTANT] == (command.KILLED, test)  # at import: judged by all that run a function
    assert outcomes[7, COMPARISON] == outcomes[7, DROPPED] == (command.KILLED, test)
    assert outcomes[7, BOUNDARY] == (command.SURVIVED, "")  # equal either way
    assert outcomes[8, DROPPED] == (command.SURVIVED, "")  # the log is not looked at
    assert outcomes[14, SIGN] == outcomes[14, CONSTANT] == (command.NOT_COVERED, "")
    assert (toy / "phyfilter_ctl" / "toy.py").read_text() == SOURCE
    assert command.recorded(toy, keep).folder == records.folder  # not again
    (toy / "tests" / "test_toy.py").write_text("")
    assert command.recorded(toy, keep).tests == {}  # another state


def test_a_score_below_the_baseline_is_told() -> None:
    known = {"toy": {"count": 6, "seed": 1, "score": 0.5}}
    assert "toy: 0.333 is below the baseline's 0.500" in command.lowered(known, "toy", 6, 1, 0.333)
    assert command.lowered(known, "toy", 6, 1, 0.5) == ""
    assert command.lowered(known, "toy", 6, 2, 0.0) == ""  # of other mutants nothing is known
    assert command.lowered(known, "other", 6, 1, 0.0) == ""


def test_the_baseline_names_rooms_that_are_there() -> None:
    baseline = tomllib.loads(command.BASELINE.read_text(encoding="utf-8"))
    assert baseline
    for room, known in baseline.items():
        assert command.room_files(command.ROOT, room)
        assert known["count"] >= 1
        assert 0.0 <= known["score"] <= 1.0
