"""Jobs handed out, answers in order: what ``learn``, ``simulate_batch``, tuning and studies run on."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from queue import Empty, SimpleQueue
from types import TracebackType
from typing import TYPE_CHECKING, Literal, Protocol, Self, TypeVar, get_args

from .. import _signals
from .checkpoint import Checkpoint
from .cluster import Cluster
from .processes import Processes
from .progress import Report, silent

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["Executor", "Kind"]

Kind = Literal["processes", "threads"]
Job = TypeVar("Job")
Answer = TypeVar("Answer")
A_co = TypeVar("A_co", covariant=True)

# Jobs that are out, or done and waiting for one before them, for each worker: bounds what answers take.
_AHEAD = 4


class Promise(Protocol[A_co]):
    """What concurrent.futures and Dask call a future."""

    def result(self) -> A_co:
        """The answer, waited for; or the job's error."""
        ...

    def add_done_callback(self, fn: Callable[[object], object], /) -> object:
        """Call a function with this promise once there is an answer."""
        ...

    def cancel(self) -> object:
        """Leave the job out where it has not begun."""
        ...


class Executor:
    """Runs independent jobs, here or on a cluster, and gives their answers in the order of the jobs.

    The answers, and so whatever is summed over them, do not depend on where the jobs ran, how many workers there were,
    or which of them was killed: the job of a killed worker runs again.

    Parameters
    ----------
    workers : int, optional
        Here: None means one per core; 1 runs the jobs one after the other in this process.
    kind : {"processes", "threads"}
        Threads suit jobs that release Python's lock (compiled simulations), and anything that cannot be pickled.
        Processes suit the others, such as reading files. Their jobs are pickled, lambdas included.
        They do not import the script that starts them, so it needs no ``if __name__ == "__main__"``.
    scheduler : str or distributed.Client, optional
        Of a Dask cluster, such as "tcp://127.0.0.1:8786", whose workers do the jobs instead; they need this package.
    timeout : float
        s to reach the scheduler, and to wait where it has no workers.

    Raises
    ------
    ValueError
        For options that are none of the above; without Dask, or if no scheduler answers.

    Examples
    --------
    >>> with Executor(workers=2, kind="threads") as executor:
    ...     list(executor.map(abs, [-2, 1, -3]))
    [2, 1, 3]
    """

    def __init__(
        self,
        workers: int | None = None,
        *,
        kind: Kind = "processes",
        scheduler: str | Client | None = None,
        timeout: float = 30.0,
    ) -> None:
        if kind not in get_args(Kind):
            raise ValueError(f"kind: expected one of {', '.join(get_args(Kind))}, got {kind!r}")
        if workers is not None:
            _signals.count("workers", workers)
            if scheduler is not None:
                raise ValueError("workers: those of the scheduler do the jobs; leave workers= out")
        _signals.duration("timeout", timeout)
        self.workers: int = workers or os.cpu_count() or 1
        self.kind: Kind = kind
        self.timeout = timeout
        self._cluster = None if scheduler is None else Cluster(scheduler, timeout)
        self._threads: ThreadPoolExecutor | None = None
        self._processes: Processes | None = None

    @property
    def is_here(self) -> bool:
        """Whether jobs run one after the other in this process."""
        return self._cluster is None and self.workers == 1

    @property
    def shares_memory(self) -> bool:
        """Whether jobs run in this process, one after the other or in its threads: nothing is pickled."""
        return self.is_here or (self._cluster is None and self.kind == "threads")

    @property
    def size(self) -> int:
        """Jobs that run at once, now: the workers of a cluster may come and go."""
        return self.workers if self._cluster is None else self._cluster.size

    def map(
        self,
        work: Callable[[Job], Answer],
        jobs: Sequence[Job],
        *,
        names: Sequence[str] | None = None,
        report: Report = silent,
        checkpoint: Checkpoint[Answer] | None = None,
    ) -> Iterator[Answer]:
        """Answers in the order of the jobs, each as soon as it and those before it are known.

        Parameters
        ----------
        work : callable
            Job -> answer. For clusters a function of a module of theirs, or a ``functools.partial`` of one.
        jobs : sequence
        names : sequence of str, optional
            Of the jobs, for reports, errors and the checkpoint; None means their numbers.
        report : callable
            Called with the name of every job, in order, before its answer is waited for.
        checkpoint : Checkpoint, optional
            Jobs whose answers it holds are not done again; new answers are added as they come.

        Raises
        ------
        Exception
            What a job raised; jobs that were not begun are dropped.
        RuntimeError
            If the process of one job is killed time and again.
        ValueError
            If a cluster has no workers for ``timeout``, or names are not as many as the jobs or, with a checkpoint, not
            different.
        """
        names = [str(i) for i in range(len(jobs))] if names is None else names
        if len(names) != len(jobs) or (checkpoint is not None and len(set(names)) < len(names)):
            raise ValueError(f"names: expected {len(jobs)} different ones, got {list(names)[:5]}")
        known = {} if checkpoint is None else checkpoint.answers
        todo = [i for i, name in enumerate(names) if name not in known]
        fresh = self._one_by_one(work, jobs, todo) if self.is_here else self._ahead(work, jobs, todo)
        return _ordered(names, known, fresh, report, checkpoint)

    def _one_by_one(
        self, work: Callable[[Job], Answer], jobs: Sequence[Job], todo: Sequence[int]
    ) -> Iterator[tuple[int, Callable[[], Answer]]]:
        return ((i, partial(work, jobs[i])) for i in todo)

    def _ahead(
        self, work: Callable[[Job], Answer], jobs: Sequence[Job], todo: Sequence[int]
    ) -> Iterator[tuple[int, Callable[[], Answer]]]:
        """Answers as they come, with so many jobs out that no worker waits, and no more."""
        done: SimpleQueue[int] = SimpleQueue()
        out: dict[int, Promise[Answer]] = {}
        queue, waiting, following = iter(todo), set[int](), 0
        try:
            while True:
                # Counted from the first that is not answered: late ones hold the others back, not in memory.
                while len(out) + len(waiting) < _AHEAD * self.size and (i := next(queue, None)) is not None:
                    out[i] = self._submit(work, jobs[i])
                    out[i].add_done_callback(lambda _, i=i: done.put(i))
                if not out:
                    return
                i = self._next(done)
                yield i, out.pop(i).result
                waiting.add(i)
                while following < len(todo) and todo[following] in waiting:
                    waiting.remove(todo[following])
                    following += 1
        finally:
            for promise in out.values():
                promise.cancel()

    def _next(self, done: SimpleQueue[int]) -> int:
        while True:
            try:
                return done.get(timeout=self.timeout)
            except Empty:
                if self._cluster is not None:
                    self._cluster.refuse_idle()

    def _submit(self, work: Callable[[Job], Answer], job: Job) -> Promise[Answer]:
        if self._cluster is not None:
            return self._cluster.submit(work, job)
        if self._threads is None:
            self._threads = ThreadPoolExecutor(self.workers)
        if self.kind == "threads":
            return self._threads.submit(work, job)
        if self._processes is None:
            self._processes = Processes(self.workers)
        return self._threads.submit(self._processes.run, work, job)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the workers that were started here; a cluster's go on."""
        if self._processes is not None:
            self._processes.close()
        if self._threads is not None:
            self._threads.shutdown(cancel_futures=True)
        if self._cluster is not None:
            self._cluster.close()
        self._processes = self._threads = None


def _ordered(
    names: Sequence[str],
    known: dict[str, Answer],
    fresh: Iterator[tuple[int, Callable[[], Answer]]],
    report: Report,
    checkpoint: Checkpoint[Answer] | None,
) -> Iterator[Answer]:
    """What a job raised is raised in its turn, so that it is the same one wherever the jobs ran."""
    early: dict[int, Callable[[], Answer]] = {}
    for i, name in enumerate(names):
        report(name)
        if name in known:
            yield known[name]
            continue
        while i not in early:
            j, early[j] = next(fresh)
            if checkpoint is not None and j > i:
                with suppress(Exception):  # raised in its turn
                    checkpoint.add(names[j], early[j]())
        answer = early.pop(i)()
        if checkpoint is not None and name not in checkpoint.answers:
            checkpoint.add(name, answer)
        yield answer
