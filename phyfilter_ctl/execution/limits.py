"""What a simulation may take of the machine."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from .. import _signals
from .executor import Executor

__all__ = ["Limits", "limits_of"]


@dataclass(frozen=True)
class Limits:
    """What a simulation may take of the machine, and whether it shows how far it is.

    Parameters
    ----------
    max_steps : int, optional
        Steps of integration that a run may try. None: of error control 1 million and 20 for each time and instant, of
        fixed length 100 million.
    time_limit : float, optional
        Seconds of this machine's time that a run may take.
    workers : int or Executor, optional
        Of a batch: threads, None for one per core; or what runs it instead, such as
        ``Executor(scheduler="tcp://...")``, a Dask cluster. The numbers are the same where its machines are alike.
    progress : bool
        Show a progress bar.

    Raises
    ------
    ValueError, TypeError
        If one of them is out of range, or of another type.

    Examples
    --------
    >>> Limits(max_steps=2000, time_limit=1.5).max_steps
    2000
    """

    max_steps: int | None = None
    time_limit: float | None = None
    workers: int | Executor | None = None
    progress: bool = False

    def __post_init__(self) -> None:
        steps, seconds = self.max_steps, self.time_limit
        if steps is not None and (isinstance(steps, bool) or not isinstance(steps, int) or steps < 1):
            raise ValueError(f"max_steps: expected a whole number above 0 or None, got {steps!r}")
        real = isinstance(seconds, int | float | np.number) and not isinstance(seconds, bool)
        if seconds is not None and not (real and float(seconds) > 0.0):
            raise ValueError(f"time_limit: expected a positive number of seconds or None, got {seconds!r}")
        if self.workers is not None and not isinstance(self.workers, Executor):
            _signals.count("workers", self.workers)
        if not isinstance(self.progress, bool):
            raise TypeError(f"progress: expected True or False, got {self.progress!r}")


def limits_of(given: Limits | Mapping[str, object] | None, call: str, *, batch: bool = False) -> Limits:
    """The argument ``limits`` of a call.

    Parameters
    ----------
    given : Limits, mapping or None
    call : str
        Name of the function, for messages.
    batch : bool
        Whether it takes ``workers``.

    Raises
    ------
    ValueError, TypeError
        For something else, unknown names, or ``workers`` where there is nothing to share out.

    Examples
    --------
    >>> limits_of({"max_steps": 100}, "simulate")
    Limits(max_steps=100, time_limit=None, workers=None, progress=False)
    """
    if given is not None and not isinstance(given, Limits | Mapping):
        raise TypeError(
            f"limits: expected a Limits or a mapping such as {{'max_steps': 1000}}, got {given!r}"
        )
    if isinstance(given, Mapping):
        known = [field.name for field in fields(Limits)]
        unknown = [name for name in given if name not in known]
        if unknown:
            close = difflib.get_close_matches(str(unknown[0]), known, 1)
            said = f"; did you mean {close[0]!r}?" if close else ""
            raise ValueError(f"limits: expected {', '.join(known)}, got {unknown[0]!r}{said}")
        values: dict[str, object] = dict(given)
        given = Limits(**values)  # pyright: ignore[reportArgumentType]  # it checks them
    found = given or Limits()
    if found.workers is not None and not batch:
        raise ValueError(f"limits: workers are of simulate_batch; {call} makes one run")
    return found
