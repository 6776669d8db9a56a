"""A session for every tab of the browser: two tabs do not disturb each other, and the oldest give way."""

from __future__ import annotations

import re
import threading
import time
from collections import OrderedDict
from collections.abc import Callable

from .handling import Session

__all__ = ["TAB_HEADER", "Tabs", "is_tab"]

TAB_HEADER = "x-phyfilter-tab"
MOST_TABS = 16
LONGEST_IDLE = 24 * 3600.0  # s without a message

_NAME = re.compile(r"[A-Za-z0-9_-]{16,64}")


def is_tab(name: str) -> bool:
    """Whether a tab may be called so.

    Parameters
    ----------
    name : str
        From a request.

    Returns
    -------
    bool

    Examples
    --------
    >>> is_tab("0123456789abcdef"), is_tab("../../etc/passwd")
    (True, False)
    """
    return _NAME.fullmatch(name) is not None


class Tabs:
    """The sessions of a server.

    Parameters
    ----------
    first : Session
        Answers who names no tab; every tab starts where it started.
    now : callable, optional
        Time in s.

    Examples
    --------
    >>> tabs = Tabs(Session())
    >>> one, other = tabs.of("a" * 16), tabs.of("b" * 16)
    >>> one is other, one is tabs.of("a" * 16)
    (False, True)
    """

    def __init__(self, first: Session, *, now: Callable[[], float] = time.monotonic) -> None:
        self._first = first
        self._now = now
        self._lock = threading.Lock()
        self._open: OrderedDict[str, tuple[Session, float]] = OrderedDict()  # the longest idle first

    def of(self, tab: str | None) -> Session:
        """The session of a tab; a new one where there is none any more.

        Parameters
        ----------
        tab : str or None
            Its name.

        Returns
        -------
        Session
        """
        if tab is None:
            return self._first
        now, gone = self._now(), []
        with self._lock:
            session, _ = self._open.pop(tab, (None, now))
            session = session or self._first.again()
            self._open[tab] = session, now
            while len(self._open) > MOST_TABS or now - next(iter(self._open.values()))[1] > LONGEST_IDLE:
                gone.append(self._open.popitem(last=False)[1][0])
        for old in gone:
            old.close()
        return session

    def close(self) -> None:
        """End the learning jobs of all."""
        with self._lock:
            sessions = [self._first, *(session for session, _ in self._open.values())]
            self._open.clear()
        for session in sessions:
            session.close()
