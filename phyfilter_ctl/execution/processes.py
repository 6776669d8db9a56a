"""Worker processes of this machine: one job at a time each; the job of a killed one runs again in the next.

They are fresh interpreters, not forks (which inherit the locks of other libraries' threads) and not those of
``multiprocessing`` (which import the calling script, and one killed worker ends them all).
"""

from __future__ import annotations

import contextlib
import os
import signal
import struct
import subprocess
import sys
from collections.abc import Callable
from multiprocessing.reduction import ForkingPickler
from threading import Lock
from typing import IO, TypeVar, cast

__all__ = ["Processes", "serve"]

Job = TypeVar("Job")
Answer = TypeVar("Answer")

_ATTEMPTS = 3
# As multiprocessing talks to its own processes.
_dumps = ForkingPickler.dumps
_loads = ForkingPickler.loads  # pyright: ignore[reportAttributeAccessIssue] # a builtin, which is not bound
_LENGTH = struct.Struct("<Q")
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
# One thread each, and one heap: those of glibc's threads and Arrow's pool keep what jobs free from one another.
_ENVIRONMENT = {
    **dict.fromkeys(_THREADS, "1"),
    "MALLOC_ARENA_MAX": "1",
    "ARROW_DEFAULT_MEMORY_POOL": "system",
}
# The path first, so that what a job imports is what its sender would.
_PROGRAM = "import sys; sys.path[:] = {path!r}; from phyfilter_ctl.execution.processes import serve; serve()"


class Processes:
    """Worker processes, started as jobs come and kept for further ones."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._idle: list[_Worker] = []
        self._all: list[_Worker] = []
        self._closed = False

    def run(self, work: Callable[[Job], Answer], job: Job) -> Answer:
        """The answer of one job; called from as many threads as processes are wanted."""
        text = _pickled(work, job)
        code: int | None = None
        for _ in range(_ATTEMPTS):
            worker = self._take()
            try:
                answer, error = worker.ask(text)
            except (EOFError, OSError):
                code = worker.end()
                if self._closed:
                    break
                continue
            with self._lock:
                self._idle.append(worker)
            if error is not None:
                raise error
            return cast("Answer", answer)
        raise RuntimeError(
            f"the worker process of a job ended {_ATTEMPTS} times without an answer (exit status {code}; -9: killed, "
            "for want of memory perhaps); try fewer workers"
        )

    def _take(self) -> _Worker:
        with self._lock:
            if self._closed:
                raise RuntimeError("the executor is closed")
            if self._idle:
                return self._idle.pop()
            worker = _Worker()
            self._all.append(worker)
            return worker

    def close(self) -> None:
        """End them all, also those at work."""
        with self._lock:
            self._closed = True
            workers, self._all, self._idle = self._all, [], []
        for worker in workers:
            worker.end()


class _Worker:
    """One process at the other end of two pipes."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", _PROGRAM.format(path=sys.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**_ENVIRONMENT, **os.environ},
        )

    def ask(self, text: memoryview) -> tuple[object, Exception | None]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        _send(self._process.stdin, text)
        return _loads(_receive(self._process.stdout))

    def end(self) -> int | None:
        self._process.kill()
        code = self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):  # what it did not read any more
                    pipe.close()
        return code


def serve() -> None:
    """Do jobs from standard input until it ends. What they print goes to standard error."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for who waits for the answers
    source, target = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.dup2(2, 1)
    while True:
        try:
            text = _receive(source)
        except EOFError:
            return
        try:
            work, job = _loads(text)
            reply = _dumps((work(job), None))
        except Exception as error:  # whatever it is, it is raised where the answer is waited for
            reply = _failure(error)
        _send(target, reply)


def _failure(error: Exception) -> memoryview:
    if isinstance(error, AttributeError) and "__main__" in str(error):
        error = TypeError(
            f"work: worker processes import what they run, and cannot import the script itself ({error}): put the "
            "function into a module of its own, or give workers=1"
        )
    try:
        text = _dumps((None, error))
        _loads(text)  # some exceptions cannot be made again from their arguments
    except Exception:  # their own code runs here, and may raise anything
        return _dumps((None, RuntimeError(f"{type(error).__name__}: {error}")))
    return text


def _pickled(work: object, job: object) -> memoryview:
    try:
        return _dumps((work, job))
    except Exception as error:  # of many kinds
        raise TypeError(
            f"work: worker processes get what they run by pickle, and this cannot be pickled ({error}): give a "
            "function of a module or a functools.partial of one, or workers=1"
        ) from error


def _send(pipe: IO[bytes], text: memoryview) -> None:
    pipe.write(_LENGTH.pack(len(text)))
    pipe.write(text)
    pipe.flush()


def _receive(pipe: IO[bytes]) -> bytes:
    head = pipe.read(_LENGTH.size)
    if len(head) < _LENGTH.size:
        raise EOFError
    (length,) = _LENGTH.unpack(head)
    text = pipe.read(length)
    if len(text) < length:
        raise EOFError
    return text
