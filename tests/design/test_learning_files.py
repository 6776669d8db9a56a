"""Learning from flights that stay in files: the same answer as in memory, few readings, bad flights, who reads them."""

from __future__ import annotations

import os
import signal
import threading
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from phyfilter_ctl import Reading, Recording, Search, learn
from phyfilter_ctl.design.learning import stored
from phyfilter_ctl.execution.processes import Processes
from phyfilter_ctl.logfiles import read_recording

# Files hold the numbers bit for bit. What is left: the trials begin where what was kept of the flights does.
SAME = 1e-10
# Trials that are not the same end near one minimum, where the cost is flat: its square root of SAME.
TWO_DESCENTS = 1e-5
H = 0.01
FEW = Search(starts=1)


def flight(seed: int, samples: int = 500) -> Recording:
    """Two channels of a Gauss-Markov force, g in one of them, noise on x."""
    rng = np.random.default_rng(seed)
    f = np.zeros((samples, 2))
    for k in range(1, samples):
        f[k] = 0.97 * f[k - 1] + 0.3 * rng.standard_normal(2)
    g = np.cumsum(0.1 * rng.standard_normal((samples, 2)), axis=0)
    x = np.vstack([np.zeros((1, 2)), np.cumsum(H * (f + g)[:-1], axis=0)]) + 2e-3 * rng.standard_normal(
        (samples, 2)
    )
    return Recording.from_arrays(x=x, dt=H, g=g, label=f, channels=["p", "q"], name=f"flight {seed}")


def from_csv(path: Path) -> Recording:
    return Recording.from_csv(path, x=["p", "q"])


@pytest.fixture(scope="module")
def flights():
    return [flight(seed, 400 + 40 * seed) for seed in range(6)]


@pytest.fixture(scope="module")
def files(flights, tmp_path_factory):
    folder = tmp_path_factory.mktemp("flights")
    for k, log in enumerate(flights):
        log.to_csv(folder / f"flight_{k}.csv")
    return sorted(folder.iterdir())


class Counting:
    """How often files are read."""

    def __init__(self) -> None:
        self.paths: list[str] = []

    def __call__(self, path: Path) -> Recording:
        self.paths.append(path.name)
        return from_csv(path)


def same(one, other, tolerance=SAME):
    np.testing.assert_allclose(other.filter.a, one.filter.a, rtol=tolerance)
    np.testing.assert_allclose(other.filter.b, one.filter.b, rtol=tolerance)
    assert other.rmse == pytest.approx(one.rmse, rel=tolerance)
    for name in ("wiener_ratio", "held_out_rmse"):
        if getattr(one, name) is not None:
            assert getattr(other, name) == pytest.approx(getattr(one, name), rel=tolerance)


@pytest.mark.slow
def test_files_and_functions_teach_what_recordings_do(flights, files):
    held = flight(77)
    expected = learn(flights, 2, held_out=held, shape="general", search=Search(starts=1))
    named: list[str] = []
    found = learn(
        files,
        2,
        held_out=[lambda: held],
        shape="general",
        search=Search(starts=1),
        reading=Reading(read=from_csv, workers=1, report=named.append),
    )
    same(expected, found)
    assert found.notes == expected.notes
    assert found.intervals.rmse == pytest.approx(expected.intervals.rmse, rel=SAME)
    assert named == [*map(str, files), "flight 0"]
    same(expected, learn(lambda: iter(flights), 2, held_out=held, shape="general", search=Search(starts=1)))


def test_a_descent_reads_no_file_again(files):
    read = Counting()
    learn(files, 2, reading=Reading(read=read, workers=1), search=FEW)
    names = [path.name for path in files]
    assert sorted(read.paths) == sorted(2 * names)  # the survey, and the RMSE of the answer
    assert read.paths[: len(names)] == names


def test_ends_that_are_too_short_are_read_again(flights, files, monkeypatch):
    """Slow poles remember more than what is kept: the answer on the whole flights does not change."""
    expected = learn(flights, 2, search=FEW)
    monkeypatch.setattr(stored, "ENDS", 6 * 2 * 8 * 20)
    monkeypatch.setattr(stored, "_BEGUN", 6 * 20)
    read = Counting()
    found = learn(files, 2, reading=Reading(read=read, workers=1), search=FEW)
    same(expected, found, TWO_DESCENTS)
    assert found.cost == pytest.approx(expected.cost, rel=SAME)
    assert found.intervals.rmse == pytest.approx(expected.intervals.rmse, rel=TWO_DESCENTS)
    assert len(read.paths) > 4 * len(files)


def test_ends_and_beginnings_are_bounded_whatever_their_number(flights, monkeypatch):
    monkeypatch.setattr(stored, "ENDS", 6 * 2 * 8 * 100)
    monkeypatch.setattr(stored, "_BEGUN", 6 * 100)
    found = stored.StoredFlights()
    for k, log in enumerate(flights):
        source = stored.Source("t", k, log.name, partial(stored.load, log, None, None, {}))
        survey, correlated = stored.surveyed(source, flights=1, skip=False)
        found.add(stored.StoredFlight(source, survey), correlated)
    assert sum(each.survey.end.nbytes for each in found) <= stored.ENDS
    end, complete = found[0].before(found[0].length)
    assert not complete
    np.testing.assert_array_equal(end, found[0].u.T[:, ::-1][:, : end.shape[1]])
    assert sum(each.survey.beginning.length for each in found) <= 6 * 100
    for count in (30, 300, 10**6):  # kept, not kept, more than there is
        np.testing.assert_array_equal(found[0].beginning(count).target, found[0].target[:count])


@pytest.mark.slow
def test_weights_offsets_and_unequal_steps_hold_for_files(flights, files):
    rng = np.random.default_rng(5)
    weights = [1.0, 0.0, 0.5, *(rng.uniform(0.5, 1.5, log.n) for log in flights[3:])]
    times = np.cumsum(rng.uniform(0.5, 1.5, flights[0].n)) * H
    uneven = Recording(times, flights[0].x, g=flights[0].g, label=flights[0].label, channels=["p", "q"])
    logs = [uneven, *flights[1:]]
    here = Reading(from_csv, workers=1)
    for options in (
        {"weights": weights, "search": Search(starts=0, cross_validate=True)},
        {"label": "offset", "search": Search(starts=0)},
    ):
        expected = learn(logs, 1, **options)
        found = learn([lambda: uneven, *files[1:]], 1, reading=here, **options)
        same(expected, found, TWO_DESCENTS)
        assert found.cost == pytest.approx(expected.cost, rel=SAME)


def test_bad_flights_are_named_or_left_out(flights, files, tmp_path):
    broken, bare = tmp_path / "broken.csv", tmp_path / "bare.csv"

    def one_channel() -> Recording:
        return Recording.from_arrays(
            x=flights[2].x[:, :1], dt=H, label=flights[2].label[:, :1], channels=["p"]
        )

    broken.write_text("t,p,q\n0,1,2\n0.01,oops,2\n")
    flights[0].with_signals(label=None).to_csv(bare)
    logs = [files[0], broken, *files[1:], bare, tmp_path / "gone.csv", one_channel]
    with pytest.raises(ValueError, match=r"broken\.csv: line 3, column 'p'.*'oops'"):
        learn(logs, 1, reading=Reading(read=from_csv, workers=1))
    found = learn(logs, 1, reading=Reading(read=from_csv, on_bad="skip", workers=1), search=FEW)
    same(learn(flights, 1, search=FEW), found)
    names, reasons = zip(*found.skipped, strict=True)
    assert names == (str(broken), str(bare), str(tmp_path / "gone.csv"), f"flight {len(logs) - 1}")
    for reason, text in zip(
        reasons, ("oops", "has no label", "No such file", "1 channels, p, where"), strict=True
    ):
        assert text in reason
    at_hand = learn(
        [*flights, flights[0].with_signals(label=None)], 1, reading=Reading(on_bad="skip"), search=FEW
    )
    assert [name for name, _ in at_hand.skipped] == ["flight 0"]
    with pytest.raises(ValueError, match=r"no good flight among 2; the first: .*broken\.csv"):
        learn([broken, bare], 1, reading=Reading(read=from_csv, on_bad="skip", workers=1))


def test_what_cannot_be_read_twice_is_refused_with_the_way_out(flights):
    with pytest.raises(TypeError, match=r"used up after one pass.*give a function that begins anew"):
        learn((log for log in flights), 1)
    rest = iter(flights)
    with pytest.raises(ValueError, match="made 0 flights in a later pass, 6 in the first"):
        learn(lambda: rest, 1, search=FEW)
    with pytest.raises(ValueError, match="workers: flights that one function makes"):
        learn(lambda: iter(flights), 1, reading=Reading(workers="tcp://127.0.0.1:1"))
    with pytest.raises(ValueError, match="on_bad: expected one of raise, skip"):
        learn(flights, 1, reading=Reading(on_bad="drop"))


def test_a_file_that_changes_is_noticed(flights, files, tmp_path):
    path = tmp_path / "growing.csv"
    flights[0].to_csv(path)

    def read(name: Path) -> Recording:
        found = from_csv(name)
        flights[1].to_csv(path)  # longer from now on
        return found

    with pytest.raises(ValueError, match=r"growing\.csv: changed while learn was reading it"):
        learn([path, *files[2:]], 1, reading=Reading(read=read, workers=1), search=FEW)


def test_a_folder_of_parquet_is_read_by_its_columns(flights, tmp_path):
    pa = pytest.importorskip("pyarrow", reason="the extra logs (pyarrow) is not installed")
    from pyarrow import parquet

    (tmp_path / "day=1").mkdir()
    for k, log in enumerate(flights):
        columns = {"t [s]": log.times}
        for i, name in enumerate(log.channels):
            columns |= {name: log.x[:, i], f"g_{name}": log.g[:, i], f"label_{name}": log.label[:, i]}
        parquet.write_table(pa.table(columns), tmp_path / "day=1" / f"{k}.parquet")
    read = partial(read_recording, x=["p", "q"])
    same(learn(flights, 1, search=FEW), learn(tmp_path, 1, reading=Reading(read=read, workers=1), search=FEW))
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match=r"a folder without \.parquet"):
        learn(tmp_path / "empty", 1)
    with pytest.raises(ValueError, match=r"no column 'r'.*it has p, g_p"):
        read_recording(tmp_path / "day=1" / "0.parquet", x=["r"])


# -- other processes ------------------------------------------------------------------------------------------------


@pytest.mark.release
def test_processes_and_a_cluster_find_the_same_numbers_though_a_worker_is_killed(files):
    read = partial(Recording.from_csv, x=["p", "q"])
    expected = learn(files, 2, shape="general", reading=Reading(read=read, workers=1))
    same(expected, learn(files, 2, shape="general", reading=Reading(read=read, workers=2)), 0.0)
    distributed = pytest.importorskip(
        "distributed", reason="the extra cluster (dask[distributed]) is not installed"
    )
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
        ) as local,
        distributed.Client(local, set_as_default=False) as client,
    ):
        client.wait_for_workers(2)
        victim = next(iter(client.run(os.getpid).values()))
        killed = threading.Event()

        def report(text: str) -> None:
            if text == str(files[3]) and not killed.is_set():
                os.kill(victim, signal.SIGKILL)
                killed.set()

        found = learn(files, 2, shape="general", reading=Reading(read=read, workers=client, report=report))
        assert killed.is_set()
    same(expected, found, 0.0)


def test_small_files_are_read_in_this_process(flights, files, monkeypatch):
    """Processes take seconds to start and these files milliseconds to read."""
    started = []
    monkeypatch.setattr(Processes, "__init__", lambda self, workers: started.append(workers))
    same(learn(flights, 1, search=FEW), learn(files, 1, reading=from_csv, search=FEW))
    assert not started
