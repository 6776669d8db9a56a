"""One executor: order, errors, killed workers, checkpoints; what a cluster without workers says."""

from __future__ import annotations

import gc
import importlib
import json
import os
import sys
import threading
from functools import partial
from pathlib import Path

import jobs
import pytest

from phyfilter_ctl.study import Checkpoint, Executor

KINDS = [{"workers": 1}, {"workers": 3, "kind": "threads"}]


@pytest.fixture(scope="module")
def processes():
    sys.path.insert(0, str(Path(__file__).parent))
    with Executor(2) as executor:
        yield executor
    sys.path.remove(str(Path(__file__).parent))


@pytest.mark.parametrize("options", KINDS)
def test_answers_come_in_the_order_of_the_jobs(options):
    said: list[str] = []
    with Executor(**options) as executor:
        found = list(
            executor.map(
                jobs.late_first, range(40), names=[f"job {k}" for k in range(40)], report=said.append
            )
        )
    assert found == [-k for k in range(40)]
    assert said == [f"job {k}" for k in range(40)]


def test_few_answers_wait_for_a_late_one(monkeypatch):
    """While the first job is at work no more than so many others are begun: memory does not grow with the jobs."""
    begun: list[int] = []

    def work(number: int) -> int:
        begun.append(number)
        while number == 0 and len(begun) < 8:
            pass
        return number

    with Executor(2, kind="threads") as executor:
        answers = executor.map(work, range(1000))
        assert next(answers) == 0
        assert len(begun) <= 2 * 8 + 2


def test_processes_answer_print_fail_and_are_replaced(processes, tmp_path):
    assert list(processes.map(jobs.squared, [1.5, 2.0, 3.0])) == [2.25, 4.0, 9.0]
    answers = processes.map(jobs.refused, [1, 2, 3])
    assert next(answers) == 1
    with pytest.raises(ValueError, match="job 2 is refused"):
        next(answers)
    work = [(str(tmp_path / "mark"), k) for k in range(4)]
    found = list(processes.map(jobs.killed_once, work))
    assert [number for number, _ in found] == [0, 1, 2, 3]
    assert os.getpid() not in {process for _, process in found}
    assert (tmp_path / "mark").exists()  # so one was killed
    assert list(processes.map(lambda job: job + 1, [1])) == [2]  # of a script or a notebook
    with pytest.raises(TypeError, match="cannot be pickled"):
        list(processes.map(partial(jobs.with_lock, threading.Lock()), [1]))


def test_an_error_that_is_kept_and_collected_late_harms_nothing(processes):
    """A caller who keeps the exception keeps the frames of the job that went out, in a cycle."""
    kept: list[BaseException] = []
    for number in range(3):
        try:
            list(processes.map(jobs.refused, [2]))
        except ValueError as error:
            kept.append(error)
            error.__context__ = kept[0] if number else None
    kept.append(ValueError(kept))  # a cycle through the list
    assert len(kept) == 4
    kept.clear()
    gc.collect()
    assert list(processes.map(jobs.squared, [3.0])) == [9.0]


def test_an_error_that_cannot_be_made_again_arrives_as_its_text(processes):
    with pytest.raises(RuntimeError, match="AwkwardError: 3 and 4"):
        list(processes.map(jobs.awkward, [3]))


@pytest.mark.slow
def test_a_job_that_always_kills_its_worker_is_given_up(processes):
    with pytest.raises(RuntimeError, match=r"ended 3 times without an answer.*EXIT\(7\)"):
        list(processes.map(jobs.killed_always, [1]))


def test_checkpoint_is_readable_resumes_and_refuses_another_study(tmp_path):
    path, study, done = tmp_path / "study.jsonl", {"seeds": [1, 2]}, []

    def work(number: int) -> float:
        done.append(number)
        return number / 3.0

    def fly(numbers: list[int], held: Checkpoint[float]) -> list[float]:
        names = [f"flight {number}" for number in numbers]
        return list(Executor(1).map(work, numbers, names=names, checkpoint=held))

    assert fly([1, 2], Checkpoint(path, study)) == [1 / 3, 2 / 3]
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert lines == [
        {"study": study},
        {"job": "flight 1", "answer": 1 / 3},
        {"job": "flight 2", "answer": 2 / 3},
    ]
    with path.open("a") as file:
        file.write('{"job": "flight 3", "ans')  # killed while it wrote
    assert fly([1, 2, 3], Checkpoint(path, study)) == [1 / 3, 2 / 3, 1.0]
    assert done == [1, 2, 3]
    assert [json.loads(line) for line in path.read_text().splitlines()][-1]["answer"] == 1.0
    with pytest.raises(ValueError, match=r"answers of another study, .*expected .*\[3\]"):
        Checkpoint(path, {"seeds": [3]})
    with pytest.raises(ValueError, match="expected 2 different ones"):
        Executor(1).map(work, [1, 2], names=["a", "a"], checkpoint=Checkpoint(path, study))


def test_wrong_options_are_refused():
    with pytest.raises(ValueError, match="workers: expected at least 1"):
        Executor(0)
    with pytest.raises(ValueError, match="kind: expected one of processes, threads"):
        Executor(kind="fibres")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="those of the scheduler do the jobs"):
        Executor(2, scheduler="tcp://127.0.0.1:1")
    with pytest.raises(TypeError, match="an address or a distributed"):
        Executor(scheduler=3)  # type: ignore[arg-type]


def test_missing_dask_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ValueError, match=r"pip install 'phyfilter-ctl\[cluster\]'"):
        Executor(scheduler="tcp://127.0.0.1:1")


@pytest.fixture
def distributed():
    pytest.importorskip("distributed", reason="the extra cluster (dask[distributed]) is not installed")
    return importlib.import_module("distributed")


@pytest.mark.filterwarnings("default")
def test_scheduler_that_does_not_answer_is_named(distributed):
    for address in ("tcp://127.0.0.1:1", "nonsense"):
        with pytest.raises(ValueError, match=f"scheduler: none answers at '{address}'"):
            Executor(scheduler=address, timeout=0.5)


@pytest.mark.filterwarnings("default")
def test_scheduler_without_workers_is_named_and_late_workers_are_taken(distributed):
    with (
        distributed.LocalCluster(
            n_workers=0, processes=False, protocol="tcp://", dashboard_address=None
        ) as local,
        Executor(scheduler=local.scheduler_address, timeout=0.5) as executor,
    ):
        with pytest.raises(
            ValueError, match=r"has no workers after 0\.5 s; start some with `dask worker tcp"
        ):
            list(executor.map(abs, [-1]))
        local.scale(1)
        assert list(executor.map(partial(pow, 2), range(20))) == [2**k for k in range(20)]
        with (
            distributed.Client(local.scheduler_address, set_as_default=False) as client,
            Executor(scheduler=client) as given,
        ):
            assert list(given.map(abs, [-3, 2])) == [3, 2]
            given.close()
            assert client.status == "running"  # it is its owner's to close
