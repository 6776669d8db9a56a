"""Work for the tests of the executor: functions that a worker process can import."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path


def squared(number: float) -> float:
    return number * number


def late_first(number: int) -> int:
    """The first job is answered last."""
    time.sleep(0.2 if number == 0 else 0.0)
    return -number


def refused(number: int) -> int:
    if number == 2:
        raise ValueError(f"job {number} is refused")
    print("printed by a job")  # must not get between the answers
    return number


def killed_once(job: tuple[str, int]) -> tuple[int, int]:
    """The worker of job 1 is killed the first time; which process answered comes along."""
    mark, number = Path(job[0]), job[1]
    if number == 1 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL if hasattr(signal, "SIGKILL") else signal.SIGTERM)
    return number, os.getpid()


def with_lock(lock: object, number: int) -> int:
    return number


def killed_always(number: int) -> int:
    os._exit(7)


class AwkwardError(Exception):
    """Cannot be made again from its arguments."""

    def __init__(self, first: int, second: int) -> None:
        super().__init__(f"{first} and {second}")


def awkward(number: int) -> int:
    raise AwkwardError(number, number + 1)
