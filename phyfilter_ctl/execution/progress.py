"""A progress bar over the named steps of a job."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

__all__ = ["Report", "progress", "silent"]


class Report(Protocol):
    """Called with a few words at the beginning of every step."""

    def __call__(self, text: str, /) -> None: ...


def silent(text: str, /) -> None:
    """Say nothing of ``text``: the report of whoever wants none."""


@contextmanager
def progress(total: int, quiet: bool) -> Iterator[Report]:
    """A bar on standard error, where that is a terminal.

    Parameters
    ----------
    total : int
        Number of steps.
    quiet : bool
        No bar at all.
    """
    from tqdm import tqdm

    # disable=None: off where standard error is not a terminal.
    with tqdm(total=total, disable=True if quiet else None, leave=False, unit="step") as bar:
        begun = False

        def report(text: str, /) -> None:
            nonlocal begun
            if begun:
                bar.update()
            begun = True
            bar.set_description(text)

        yield report
