"""A process of its own for a foreign binary: what it does to its process, it does not do to ours."""

from __future__ import annotations

import ctypes
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.spawn import get_executable
from pathlib import Path
from typing import Any

from fmpy.fmi1 import FMICallException

from .binding import BindingError
from .foreign_wire import COMPONENT, decoded, encoded, receive, send
from .messages import MessageLog

__all__ = ["ForeignFmu", "ForeignProcessError", "Isolation"]

_HOST = Path(__file__).with_name("foreign_host.py")
_LAST_SECONDS = 5.0  # for a process that was asked to end
# Calls that answer nothing but a status travel with the next one that does.
_SILENT = ("fmi2Set", "fmi3Set", "setTime", "setContinuousStates", "freeFMUstate", "freeFMUState")


@dataclass(frozen=True)
class Isolation:
    """Limits of a foreign binary that runs in a process of its own.

    Parameters
    ----------
    call_limit : float
        Seconds that one call may take, loading included.
    run_limit : float, optional
        Seconds from its start after which no call may be under way.

    Raises
    ------
    ValueError
        If a limit is not above zero.
    """

    call_limit: float = 60.0
    run_limit: float | None = None

    def __post_init__(self) -> None:
        for name in ("call_limit", "run_limit"):
            value = getattr(self, name)
            if value is not None and not value > 0.0:
                raise ValueError(f"{name}: expected seconds > 0, got {value}")


class ForeignProcessError(RuntimeError):
    """The process of a foreign binary is gone.

    Parameters
    ----------
    status : {"crashed", "time limit"}
    message : str
    """

    def __init__(self, status: str, message: str) -> None:
        super().__init__(message)
        self.status = status


class ForeignFmu:
    """FMPy's binding of an instance, in another process; any of its functions is a method here.

    A call that sets something is made together with the next one that returns something, and fails there.

    Parameters
    ----------
    log : MessageLog
    isolation : Isolation
    what
        As for :func:`binding.bind`.

    Raises
    ------
    BindingError
        If the binary cannot be loaded or makes no instance.
    ForeignProcessError
        If it ends its process, or overruns a limit, already then.
    """

    component = COMPONENT

    def __init__(self, log: MessageLog, isolation: Isolation, **what: object) -> None:
        self._log, self._isolation = log, isolation
        self._waiting: list[list[object]] = []
        self._arrays = b""
        self._begun = time.monotonic()
        self._called: float | None = None
        self._late = ""
        self._ended = threading.Event()
        self._lock = threading.Lock()
        # No multiprocessing: its children start with the caller's own script, and need it guarded against that.
        self._process = subprocess.Popen(
            [get_executable() or sys.executable, "-P", str(_HOST)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        threading.Thread(target=self._watch, daemon=True).start()
        try:
            self._exchange({"path": sys.path, **what})
        except BaseException:
            self._end()
            raise

    def __getattr__(self, name: str) -> Callable[..., Any]:
        if name.startswith("_"):
            raise AttributeError(name)
        return lambda *arguments: self._request(name, *arguments)

    def freeInstance(self) -> None:  # FMPy's name
        """Free the instance and end the process."""
        try:
            if self._process.poll() is None:
                self._request("freeInstance")
        finally:
            self._end()

    def freeLibrary(self) -> None:  # FMPy's name
        """End the process."""
        self._end()

    def _request(self, name: str, *arguments: object) -> Any:
        words, arrays = encoded(arguments)
        calls, data = [*self._waiting, [name, words]], self._arrays + arrays
        if name.startswith(_SILENT):
            self._waiting, self._arrays = calls, data
            return None
        self._waiting, self._arrays = [], b""
        answer, back = self._exchange(calls, data)
        try:
            found, _ = decoded(answer["results"], back)
            changeable = [value for value in arguments if isinstance(value, ctypes.Array)]
            results = found[: len(found) - len(changeable)]
            for old, new in zip(changeable, found[len(results) :], strict=True):
                old[:] = new
            return tuple(results) if answer["several"] else results[0]
        except (EOFError, LookupError, TypeError, ValueError) as error:
            raise self._gone("it answered something else than the results of a call") from error

    def _exchange(self, message: object, arrays: bytes = b"") -> tuple[dict[str, Any], bytes]:
        asked, answers = self._process.stdin, self._process.stdout
        assert asked is not None
        assert answers is not None
        with self._lock:
            self._called = time.monotonic()
            try:
                send(asked.fileno(), message, arrays)
                while True:
                    answer, back = receive(answers.fileno())
                    if not isinstance(answer, dict):
                        raise EOFError("no frame")
                    if "log" not in answer:
                        break
                    self._log.messages.append(str(answer["log"]))
            except (EOFError, OSError, ValueError) as error:  # ValueError: the pipe is closed
                raise self._gone() from error
            except BaseException:  # a signal: the answer is not waited for, and the next call would get it
                self._end()
                raise
            finally:
                self._called = None
        if "failed" in answer:
            raise BindingError(str(answer.get("call")), str(answer["failed"]))
        if "status" in answer:
            if not isinstance(answer["status"], int):
                raise self._gone("it answered a status that is no number")
            raise FMICallException(function=str(answer.get("function")), status=answer["status"])
        return answer, back

    def _gone(self, why: str = "") -> ForeignProcessError:
        self._end()
        if self._late:
            return ForeignProcessError("time limit", self._late)
        return ForeignProcessError(
            "crashed", why or f"its process ended: {_ending(self._process.returncode)}"
        )

    def _end(self) -> None:
        self._ended.set()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        try:
            self._process.wait(_LAST_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _watch(self) -> None:
        """One thread looks at the clock, so that calls cost no timer each."""
        limits = self._isolation
        shortest = min(limits.call_limit, limits.run_limit or limits.call_limit)
        while not self._ended.wait(min(0.2, shortest / 10.0)):
            called, now = self._called, time.monotonic()
            if called is None:
                continue
            if now - called > limits.call_limit:
                self._late = f"the call took longer than {limits.call_limit:g} s, and its process was ended"
            elif limits.run_limit is not None and now - self._begun > limits.run_limit:
                self._late = f"the run took longer than {limits.run_limit:g} s, and its process was ended"
            else:
                continue
            self._process.kill()
            return


def _ending(code: int) -> str:
    """How a process ended, in words.

    >>> _ending(-11), _ending(3)
    ('SIGSEGV (Segmentation fault)', 'exit(3)')
    """
    if code < 0:
        try:
            return f"{signal.Signals(-code).name} ({signal.strsignal(-code)})"
        except ValueError:
            return f"signal {-code}"
    return f"exit({code})" if code < 1 << 16 else f"status 0x{code:08X}"
