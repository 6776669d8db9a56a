"""Hostile files at every entry point: refused in words that name the file, in little memory, and nothing is left."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl.cli import main
from tests import hostile_files

ROWS = hostile_files.rows()


@pytest.mark.parametrize("row", ROWS, ids=[row.name for row in ROWS])
def test_a_hostile_file_is_refused_in_words(
    row: hostile_files.Row, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip(row.package)
    temporary, folder = tmp_path / "temporary", tmp_path / "files"
    temporary.mkdir()
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    hostile_files.said(row, folder)
    assert not list(temporary.iterdir()), "what was unpacked is left"


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the address space is limited on Linux only")
def test_none_takes_much_memory() -> None:
    """All rows in one process that may take 2 GB."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.hostile_files"],
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    assert len(done.stdout.splitlines()) == len(ROWS)


@pytest.mark.parametrize(
    "make",
    [
        partial(hostile_files.bag, packed="BZ2"),
        partial(hostile_files.bag, packed="LZ4"),
        lambda path: hostile_files.bag2(path.with_suffix(""), "MESSAGE"),
        lambda path: hostile_files.bag2(path.with_suffix(""), "FILE"),
        lambda path: hostile_files.mcap(path.with_suffix("")),
    ],
    ids=["bz2", "lz4", "messages", "files", "mcap"],
)
def test_a_packed_bag_is_read_where_it_is_allowed(make: Callable[[Path], Path], tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    path = make(tmp_path / "a.bag")
    (topic,) = pf.open_log(path, largest=1 << 28).topics
    assert topic.count == 1


def test_more_is_read_where_it_is_allowed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("h5py")
    path = hostile_files.hdf5_matrix(tmp_path / "a.h5")
    needed, chunk = 8 * 1000 * 257, 8 * 10 * 256
    with pytest.raises(ValueError, match=f"{needed} bytes of memory for topic 'table'"):
        pf.open_log(path, largest=needed - 1).read("table")
    assert pf.open_log(path, largest=needed).read("table").values.shape == (1000, 256)
    assert main(["log", str(path), "--largest", str(chunk)]) == 0
    assert main(["log", str(path), "--largest", str(chunk - 1)]) == 2
    assert f"{chunk} bytes of memory for a chunk of 'v'" in capsys.readouterr().err


@pytest.mark.skipif(sys.platform == "win32", reason="the size of files is limited on POSIX systems only")
def test_a_full_disk_names_its_file_and_leaves_nothing(tmp_path: Path) -> None:
    """A real limit of 1000 bytes a file, in a process of its own; a file that was there stays."""
    pf.save(tmp_path / "there.csv", pf.lowpass(1, 5.0))
    before = (tmp_path / "there.csv").read_bytes()
    done = subprocess.run(
        [sys.executable, "-c", _FULL], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout.split("\n") == [
        "[Errno 27] File too large: 'there.csv'",
        "[Errno 27] File too large: 'new.csv'",
        "[Errno 27] File too large: 'filter.fmu'",
        "[Errno 27] File too large: 'folder'",
        "[Errno 27] File too large: 'answers.jsonl'",
        "",
    ]
    assert (tmp_path / "there.csv").read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["there.csv"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
def test_a_full_device_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(OSError, match="No space left on device: '/dev/full'"):
        pf.Recording.from_arrays(x=np.zeros((10_000, 3)), dt=0.01).to_csv("/dev/full")


_FULL = """
import resource, tempfile
import numpy as np
import phyfilter_ctl as pf
from phyfilter_ctl._output import replacing_folder
from phyfilter_ctl.execution import Checkpoint
from phyfilter_ctl.fmi import export_fmu

log = pf.Recording.from_arrays(x=np.random.default_rng(0).normal(size=(1000, 3)), dt=0.01)

def folder():
    with replacing_folder("folder") as new:
        (new / "a").write_bytes(bytes(5000))

def answers():
    Checkpoint("answers.jsonl", {"study": "x" * 5000})

resource.setrlimit(resource.RLIMIT_FSIZE, (1000, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
for write in (
    lambda: log.to_csv("there.csv"),
    lambda: log.to_csv("new.csv"),
    lambda: export_fmu(pf.lowpass(2, 20.0).sampled(0.01), "filter.fmu", platforms=()),
    folder,
    answers,
):
    try:
        write()
    except OSError as error:
        print(error)
"""
