"""The process that a foreign binary runs in: loads it, then calls what it is asked to call. See foreign.py.

Run as ``python -P foreign_host.py``. The package's rooms stay unloaded: they take seconds.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
import types
from pathlib import Path
from typing import Any


def main() -> None:
    """Serve the process at the other end of standard input and output until it goes."""
    # Prints of the binary must not get between the frames: they go where its errors go.
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interrupt is for the one who asks
    asked, answers = os.dup(0), os.dup(1)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    threading.Thread(target=_leave_with, args=(os.getppid(),), daemon=True).start()
    _without_rooms()
    from phyfilter_ctl.fmi.foreign_wire import decoded, encoded, receive, send

    what, _ = receive(asked)
    sys.path[:] = what.pop("path")
    from fmpy.fmi1 import FMICallException

    from phyfilter_ctl.fmi.binding import BindingError, bind
    from phyfilter_ctl.fmi.messages import MessageLog

    class Log(MessageLog):
        """Passes messages on at once: the last words before a crash are the best ones."""

        def add(self, status: int, category: bytes | None, message: bytes | None) -> None:
            super().add(status, category, message)
            send(answers, {"log": self.messages[-1]})

    log = Log()
    try:
        fmu: Any = bind(log, **what)
    except BindingError as error:
        send(answers, {"call": error.call, "failed": str(error)})
        return
    send(answers, {"results": None})
    while True:
        try:
            calls, arrays = receive(asked)
        except EOFError:
            return
        arguments: list[list[Any]] = []
        for _, words in calls:
            found, arrays = decoded(words, arrays, fmu.component)
            arguments.append(found)
        result: Any = None
        try:
            for (name, _), given in zip(calls, arguments, strict=True):
                result = getattr(fmu, name)(*given)
        except FMICallException as error:
            send(answers, {"function": error.function, "status": error.status})
            continue
        several = isinstance(result, tuple)
        changed = [value for value in arguments[-1] if hasattr(value, "_length_")]
        words, back = encoded((*(result if several else (result,)), *changed))
        send(answers, {"results": words, "several": several}, back)


def _without_rooms() -> None:
    """Make modules of fmi importable without the package's own start."""
    here = Path(__file__).resolve().parent
    for name, folder in (("phyfilter_ctl", here.parent), ("phyfilter_ctl.fmi", here)):
        package = types.ModuleType(name)
        package.__path__ = [str(folder)]
        sys.modules[name] = package


def _leave_with(parent: int) -> None:
    """End when the parent is gone, also in the middle of a call that never returns."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


if __name__ == "__main__":
    main()
