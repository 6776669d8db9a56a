"""Stops a real command in the middle of its work, and says what is left of it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import pytest

import phyfilter_ctl

# A command imports in 3 s; the machine may be busy with other tests.
SOON = 60.0
STATUS = {signal.SIGINT: 130, signal.SIGTERM: 143}
COMMAND = ["-m", "phyfilter_ctl"]

linux = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are looked up under /proc")


class Left(NamedTuple):
    """What a command leaves behind."""

    status: int
    said: str
    temporary: list[str]
    processes: list[int]


def below(parent: int) -> set[int]:
    """Processes that a process has started, and those that they have."""
    parents = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                state, above = (entry / "stat").read_text().rpartition(")")[2].split()[:2]
            except OSError:  # gone meanwhile
                continue
            if state != "Z":
                parents[int(entry.name)] = int(above)
    found, new = set[int](), {parent}
    while new:
        new = {pid for pid, above in parents.items() if above in new} - found
        found |= new
    return found


def until(ready: Callable[[], bool]) -> None:
    """Wait for it."""
    end = time.monotonic() + SOON
    while not ready():
        assert time.monotonic() < end, "not under way in time"
        time.sleep(0.02)


def stopped(
    arguments: Sequence[str],
    number: signal.Signals,
    folder: Path,
    ready: Callable[[int, Path], bool],
    *,
    program: Sequence[str] = COMMAND,
    environment: dict[str, str] | None = None,
) -> Left:
    """Run a command until it is ready (pid, folder of temporary files -> bool), send it the signal, wait for its end.

    What it prints is in the file ``printed`` of its folder.
    """
    temporary = folder / "temporary"
    temporary.mkdir()
    with (folder / "printed").open("w") as printed:
        process = subprocess.Popen(
            [sys.executable, *program, *arguments],
            cwd=folder,
            stdout=printed,
            stderr=subprocess.PIPE,
            text=True,
            env={
                **os.environ,
                "PYTHONPATH": os.pathsep.join([str(Path(phyfilter_ctl.__file__).parents[1]), *sys.path]),
                "TMPDIR": str(temporary),
                **(environment or {}),
            },
        )
    started = set[int]()
    try:
        until(lambda: process.poll() is not None or ready(process.pid, temporary))
        assert process.poll() is None, process.communicate()[1]
        started = below(process.pid)
        process.send_signal(number)
        said = process.communicate(timeout=SOON)[1]
        left = Left(process.returncode, said, sorted(entry.name for entry in temporary.iterdir()), [])
        # What has lost its parent hears of it by a pipe that closes.
        end = time.monotonic() + 5.0
        while (alive := [pid for pid in started if Path(f"/proc/{pid}").exists()]) and time.monotonic() < end:
            time.sleep(0.02)
        return left._replace(processes=alive)
    finally:
        process.kill()
        for pid in started:
            if Path(f"/proc/{pid}").exists():
                os.kill(pid, signal.SIGKILL)
        process.wait()
