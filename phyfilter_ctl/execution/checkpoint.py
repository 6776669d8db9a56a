"""Answers of a long study on disk, one line each, so that it goes on where it was broken off."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Generic, TypeVar

from .._output import naming, write_text

__all__ = ["Checkpoint"]

Answer = TypeVar("Answer")


class Checkpoint(Generic[Answer]):
    """A file of JSON lines: what study it is of, then a line for every job that is done.

    A line is on disk before the next job's is written. A last line that was cut off is dropped; its job is done again.

    Parameters
    ----------
    path : str or path-like
        Made where it does not exist.
    study : mapping
        What the answers depend on beside the names of the jobs (durations, seeds, versions); as JSON holds it. A file
        of another study is refused.
    to_json : callable
        Answer -> what JSON holds.
    from_json : callable
        Back again.

    Attributes
    ----------
    answers : dict
        By the names of their jobs.

    Raises
    ------
    ValueError
        If the file is of another study, or broken.
    OSError
        If it cannot be read or written.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from phyfilter_ctl.study import Executor
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "sizes.jsonl"
    ...     first = Checkpoint[int](path, {"seed": 1})
    ...     _ = list(Executor(workers=1).map(abs, [-2], names=["a"], checkpoint=first))
    ...     again = Checkpoint[int](path, {"seed": 1})
    ...     list(Executor(workers=1).map(abs, [-2, -5], names=["a", "b"], checkpoint=again)), path.read_text()
    ([2, 5], '{"study": {"seed": 1}}\\n{"job": "a", "answer": 2}\\n{"job": "b", "answer": 5}\\n')
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        study: Mapping[str, Any],
        *,
        to_json: Callable[[Answer], Any] = lambda answer: answer,
        from_json: Callable[[Any], Answer] = lambda answer: answer,
    ) -> None:
        self.path: Path = Path(path)
        self._to_json = to_json
        head = json.loads(json.dumps({"study": dict(study)}))
        self.answers: dict[str, Answer] = {}
        text = self.path.read_text(encoding="utf-8") if self.path.exists() else ""
        whole = text[: text.rfind("\n") + 1]
        if not whole:
            write_text(str(self.path), _line(head))
            return
        for number, line in enumerate(whole.splitlines(), 1):
            try:
                entry = json.loads(line)
            except (ValueError, RecursionError) as error:
                raise ValueError(f"{self.path}: line {number} is no JSON ({error}); delete it") from error
            if number == 1 and entry != head:
                raise ValueError(
                    f"{self.path}: answers of another study, {line[:200]}; expected {json.dumps(head)[:200]}: give "
                    "another file, or delete this one"
                )
            if number > 1 and not (isinstance(entry, dict) and set(entry) == {"job", "answer"}):
                raise ValueError(
                    f"{self.path}: line {number}: expected job and answer, got {line[:80]}; delete it"
                )
            if number > 1:
                self.answers[entry["job"]] = from_json(entry["answer"])
        if whole != text:
            write_text(str(self.path), whole)

    def add(self, job: str, answer: Answer) -> None:
        """Keep an answer.

        Parameters
        ----------
        job : str
            Its name.
        answer : object
        """
        with naming(self.path), self.path.open("a", encoding="utf-8") as file:
            file.write(_line({"job": job, "answer": self._to_json(answer)}))
            file.flush()
            os.fsync(file.fileno())
        self.answers[job] = answer


def _line(entry: Mapping[str, Any]) -> str:
    return json.dumps(entry, allow_nan=False) + "\n"
