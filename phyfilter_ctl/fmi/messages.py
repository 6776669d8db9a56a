"""What FMUs log: the last messages of each instance."""

from __future__ import annotations

import ctypes
import weakref
from collections import deque
from collections.abc import Callable, Iterable
from functools import cache

import fmpy
from fmpy import fmi2

__all__ = ["MessageLog", "claim_messages", "complaints", "fmi2_callbacks", "status_word"]

_STATUS = ("ok", "warning", "discard", "error", "fatal", "pending")
_KEPT = 200
_SHOWN = 5


def status_word(status: int) -> str:
    """A status of FMI in a word.

    Parameters
    ----------
    status : int

    Examples
    --------
    >>> status_word(2), status_word(9)
    ('discard', 'status 9')
    """
    return _STATUS[status] if 0 <= status < len(_STATUS) else f"status {status}"


def complaints(messages: Iterable[str]) -> list[str]:
    """What an FMU logged beyond information, each message once.

    Parameters
    ----------
    messages : iterable of str
        Of an instance.

    Examples
    --------
    >>> complaints(["[warning] steps: long", "[ok] steps: 3 made", "[warning] steps: long"])
    ['[warning] steps: long']
    """
    return [message for message in dict.fromkeys(messages) if not message.startswith("[ok]")]


class MessageLog:
    """Last messages of one instance."""

    def __init__(self) -> None:
        self.messages: deque[str] = deque(maxlen=_KEPT)

    def add(self, status: int, category: bytes | None, message: bytes | None) -> None:
        """Keep a message as FMI hands it over.

        Parameters
        ----------
        status : int
        category, message : bytes or None
        """
        text = (message or b"").decode("utf-8", "replace").strip()
        where = (category or b"").decode("utf-8", "replace")
        self.messages.append(f"[{status_word(status)}] {where}: {text}")

    def latest(self) -> str:
        """The latest few in a line; "" where there are none."""
        return "; ".join(list(self.messages)[-_SHOWN:])


# FMI 2.0's logger is variadic. fmpy formats the messages in C and passes them to one logger per process, so this one
# serves all instances, finds the instance by its environment pointer, and must never be freed.
_LOGS: weakref.WeakValueDictionary[int, MessageLog] = weakref.WeakValueDictionary()


def _log_fmi2(environment: int | None, _: bytes, status: int, category: bytes, message: bytes) -> None:
    log = _LOGS.get(environment or 0)
    if log is not None:
        log.add(status, category, message)


_LOGGER = fmi2.fmi2CallbackLoggerTYPE(_log_fmi2)
_ALLOCATE = fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
_FREE = fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.free)


@cache
def _logger_proxy() -> Callable[..., object] | None:
    try:
        from fmpy.logging import addLoggerProxy
    except (ImportError, OSError, AttributeError):  # fmpy has no such library for some platforms
        return None
    return addLoggerProxy


def _proxied(callbacks: fmi2.fmi2CallbackFunctions) -> fmi2.fmi2CallbackFunctions:
    """Make the messages of all FMI 2.0 instances come to `_LOGGER`, formatted."""
    callbacks.logger = _LOGGER
    proxy = _logger_proxy()
    if proxy is not None:
        proxy(ctypes.byref(callbacks))
    return callbacks


def fmi2_callbacks(log: MessageLog) -> fmi2.fmi2CallbackFunctions:
    """What an FMI 2.0 instance that logs here is given; it must live as long as the instance.

    Parameters
    ----------
    log : MessageLog
    """
    callbacks = fmi2.fmi2CallbackFunctions()
    callbacks.allocateMemory = _ALLOCATE
    callbacks.freeMemory = _FREE
    callbacks.componentEnvironment = id(log)
    _LOGS[id(log)] = log
    return _proxied(callbacks)


def claim_messages() -> None:
    """Another user of fmpy in this process may have taken the messages of FMI 2.0 since the last call."""
    _proxied(fmi2.fmi2CallbackFunctions())
