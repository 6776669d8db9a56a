"""Worker processes of this machine, by loky: the job of a killed one runs again.

They are fresh interpreters, not forks (which inherit the locks of other libraries' threads), and do not import the
script that starts them.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from multiprocessing.reduction import ForkingPickler
from threading import Lock
from typing import Any, TypeVar

__all__ = ["Processes"]

Job = TypeVar("Job")
Answer = TypeVar("Answer")

_ATTEMPTS = 3
# As multiprocessing talks to its own processes.
_dumps = ForkingPickler.dumps
_loads = ForkingPickler.loads  # pyright: ignore[reportAttributeAccessIssue] # a builtin, which is not bound
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
# One thread each, and one heap: those of glibc's threads and Arrow's pool keep what jobs free from one another.
_ENVIRONMENT = {
    **dict.fromkeys(_THREADS, "1"),
    "MALLOC_ARENA_MAX": "1",
    "ARROW_DEFAULT_MEMORY_POOL": "system",
}


class Processes:
    """Worker processes, started with the first job and kept for further ones."""

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._lock = Lock()
        self._pool: Any = None
        self._closed = False

    def run(self, work: Callable[[Job], Answer], job: Job) -> Answer:
        """The answer of one job; called from as many threads as processes are wanted."""
        from joblib.externals.loky import BrokenProcessPool

        for attempt in range(1, _ATTEMPTS + 1):
            # A killed worker takes down the jobs of its pool: the last attempt is made alone, so that none is given up
            # for what another did.
            alone = attempt == _ATTEMPTS
            pool = _pool_of(1) if alone else self._shared()
            try:
                answer, error = pool.submit(_answered, work, job).result()
            except BrokenProcessPool as broken:
                self._drop(pool)
                if self._closed or alone:
                    raise RuntimeError(
                        f"the worker process of a job ended {attempt} times without an answer (for want of memory "
                        f"perhaps; try fewer workers): {' '.join(str(broken).split())}"
                    ) from None
                continue
            except Exception as problem:  # of the way there or back: what the job raises is in its answer
                if self._closed:
                    raise
                raise TypeError(
                    "work: worker processes get what they run, and send what they answer, by pickle, and this cannot "
                    f"be pickled ({problem}); give workers=1"
                ) from problem
            finally:
                if alone:
                    pool.shutdown(kill_workers=True)
            if error is not None:
                raise error
            return answer
        raise AssertionError("unreachable: the last attempt returns or raises")

    def _shared(self) -> Any:
        with self._lock:
            if self._closed:
                raise RuntimeError("the executor is closed")
            if self._pool is None:
                self._pool = _pool_of(self._workers)
            return self._pool

    def _drop(self, pool: Any) -> None:
        with self._lock:
            if self._pool is pool:
                self._pool = None

    def close(self) -> None:
        """End them all, also those at work."""
        with self._lock:
            self._closed = True
            pool, self._pool = self._pool, None
        if pool is not None:
            pool.shutdown(kill_workers=True)


def _pool_of(workers: int) -> Any:
    from joblib.externals.loky import ProcessPoolExecutor

    environment = {name: value for name, value in _ENVIRONMENT.items() if name not in os.environ}
    return ProcessPoolExecutor(workers, initializer=_begin, env=environment)


def _begin() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for who waits for the answers
    os.dup2(2, 1)  # what jobs print does not mix with the answers of a command


def _answered(work: Callable[[Job], Answer], job: Job) -> tuple[Answer | None, Exception | None]:
    try:
        return work(job), None
    except Exception as error:  # whatever it is, it is raised where the answer is waited for
        try:
            _loads(_dumps(error))  # some exceptions cannot be made again from their arguments
        except Exception:  # their own code runs here, and may raise anything
            return None, RuntimeError(f"{type(error).__name__}: {error}")
        return None, error
