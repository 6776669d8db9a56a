"""Workers of a Dask scheduler."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar, cast

if TYPE_CHECKING:
    from distributed import Client, Future

__all__ = ["Cluster"]

Job = TypeVar("Job")
Answer = TypeVar("Answer")


class Cluster:
    """A Dask cluster by its address or client.

    Raises
    ------
    ValueError
        Without Dask, or if no scheduler answers.
    """

    def __init__(self, scheduler: str | Client, timeout: float) -> None:
        self.timeout: float = timeout
        self._own = isinstance(scheduler, str)
        if not isinstance(scheduler, str) and not hasattr(scheduler, "submit"):
            raise TypeError(f"scheduler: expected an address or a distributed.Client, got {scheduler!r}")
        self.client: Client = _client(scheduler, timeout) if isinstance(scheduler, str) else scheduler

    @property
    def size(self) -> int:
        """Threads of its workers now; workers may come and go."""
        return max(1, sum(cast("dict[str, int]", self.client.nthreads()).values()))

    def submit(self, work: Callable[[Job], Answer], job: Job) -> Future[Answer]:
        """Hand a job out; the scheduler gives the job of a killed worker to another."""
        # Not pure: a job runs again in the next study, and its key need not be computed from its content.
        return self.client.submit(work, job, pure=False)

    def refuse_idle(self) -> None:
        """Without workers a job waits for ever."""
        if not self.client.nthreads():
            address = self.client.scheduler_info()["address"]
            raise ValueError(
                f"scheduler: {address} has no workers after {self.timeout:g} s; start some with "
                f"`dask worker {address}`, in an environment that has this package"
            )

    def close(self) -> None:
        """Leave the cluster, if it was entered here."""
        if self._own:
            self.client.close()


def _client(address: str, timeout: float) -> Client:
    try:
        from distributed import Client
    except ImportError as error:
        raise ValueError(
            "a cluster needs Dask, which is not installed: pip install 'phyfilter-ctl[cluster]'"
        ) from error
    try:
        return Client(address, timeout=timeout, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise ValueError(
            f"scheduler: none answers at {address!r} ({error}); start one with `dask scheduler`, and give the address "
            "that it prints"
        ) from error
