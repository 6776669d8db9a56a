"""Jobs on a Dask cluster: what is refused in words, and what is waited for."""

from __future__ import annotations

import importlib
import sys

import pytest

cluster = importlib.import_module("phyfilter_ctl.study.cluster")


def test_missing_dask_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ValueError, match=r"pip install 'phyfilter-ctl\[cluster\]'"):
        cluster.on_cluster("tcp://127.0.0.1:1", abs, [1], names=["1"])


@pytest.mark.filterwarnings("default")
def test_scheduler_that_does_not_answer_is_named():
    pytest.importorskip("distributed", reason="the extra cluster (dask[distributed]) is not installed")
    for address in ("tcp://127.0.0.1:1", "nonsense"):
        with pytest.raises(ValueError, match=f"scheduler: none answers at '{address}'"):
            cluster.on_cluster(address, abs, [1], names=["1"], timeout=0.5)


@pytest.mark.filterwarnings("default")
def test_scheduler_without_workers_is_named():
    distributed = pytest.importorskip(
        "distributed", reason="the extra cluster (dask[distributed]) is not installed"
    )
    with (
        distributed.LocalCluster(
            n_workers=0, processes=False, protocol="tcp://", dashboard_address=None
        ) as local,
        pytest.raises(ValueError, match=r"has no workers after 0\.5 s; start some with `dask worker tcp"),
    ):
        cluster.on_cluster(local.scheduler_address, abs, [1], names=["1"], timeout=0.5)


class Job:
    """A job on a cluster with one worker: what it comes to each time it is asked, an answer or an error."""

    def __init__(self, *steps: object, done: bool = False) -> None:
        self.steps, self.done, self.nthreads = iter(steps), lambda: done, lambda: {"tcp://a:1": 1}

    def result(self, timeout: float) -> object:
        step = next(self.steps)
        if isinstance(step, Exception):
            raise step
        return step


def test_long_jobs_are_waited_for_and_fail_with_their_own_errors():
    late, own = Job(TimeoutError(), TimeoutError(), 7), Job(TimeoutError("its own"), done=True)
    assert cluster._answer(late, late, 1.0) == 7
    with pytest.raises(TimeoutError, match="its own"):
        cluster._answer(own, own, 1.0)
