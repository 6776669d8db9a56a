"""Jobs on a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, TypeVar

from .progress import Report, silent

if TYPE_CHECKING:
    from distributed import Client, Future

__all__ = ["on_cluster"]

Job = TypeVar("Job")
Answer = TypeVar("Answer")


def on_cluster(
    address: str,
    work: Callable[[Job], Answer],
    jobs: Sequence[Job],
    *,
    names: Sequence[str],
    report: Report = silent,
    timeout: float = 30.0,
) -> list[Answer]:
    """Answers to independent jobs from a Dask cluster, in their order.

    Parameters
    ----------
    address : str
        Of the scheduler, such as tcp://127.0.0.1:8786. Its workers need this package.
    work : callable
        Job -> answer, a function of a module or a ``functools.partial`` of one.
    jobs : sequence
    names : sequence of str
        Of the jobs, for the report.
    report : callable
        Called as each job is waited for.
    timeout : float
        s to reach the scheduler, and to wait for a worker where it has none.

    Raises
    ------
    ValueError
        Without Dask, if no scheduler answers, or if it has no workers.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise ValueError(
            "a cluster needs Dask, which is not installed: pip install 'phyfilter-ctl[cluster]'"
        ) from error
    try:
        client = Client(address, timeout=timeout, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise ValueError(
            f"scheduler: none answers at {address!r} ({error}); start one with `dask scheduler`, and give the address "
            "that it prints"
        ) from error
    with client:
        # Not pure: a job runs again in the next study, and its key need not be computed from its content.
        futures = client.map(work, jobs, pure=False)
        answers = []
        for name, future in zip(names, futures, strict=True):
            report(name)
            answers.append(_answer(future, client, timeout))
        return answers


def _answer(future: Future[Answer], client: Client, timeout: float) -> Answer:
    """Without workers a job waits for ever."""
    while True:
        try:
            return future.result(timeout)
        except TimeoutError:
            if future.done():  # the job's own
                raise
            if not client.nthreads():
                address = client.scheduler_info()["address"]
                raise ValueError(
                    f"scheduler: {address} has no workers after {timeout:g} s; start some with "
                    f"`dask worker {address}`, in an environment that has this package"
                ) from None
