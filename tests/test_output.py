"""Files and folders are written whole or not at all, and what killed processes left is cleared away."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, _output, save
from phyfilter_ctl._output import replacing, replacing_folder, write_text
from phyfilter_ctl.codegen.export_folder import write_folder
from phyfilter_ctl.fmi.archive_write import write_archive
from phyfilter_ctl.fmi.replay import Reference
from phyfilter_ctl.learned import _files
from phyfilter_ctl.recording import Recording

posix = pytest.mark.skipif(sys.platform == "win32", reason="needs the locks and links of POSIX")
# The module alone: the whole package takes a second to import. `die` is for the function that a write is killed in.
_START = f"""
import os, runpy, signal, sys
module = runpy.run_path({_output.__file__!r})
target = sys.argv[1]
def die(*_, **__): os.kill(os.getpid(), signal.SIGKILL)
"""
_FILE = """
with module["replacing"](target) as file:
    file.write(b"new")
"""
_FOLDER = """
with module["replacing_folder"](target) as folder:
    (folder / "file").write_text("new")
"""


def killed(target: Path, work: str) -> list[Path]:
    """What a process leaves that was killed in the middle of its work."""
    ended = subprocess.run([sys.executable, "-c", _START + work, str(target)], check=False)
    assert ended.returncode == -signal.SIGKILL
    return [path for path in target.parent.iterdir() if path.name.startswith(".")]


@posix
@pytest.mark.parametrize("work", [f"{_FILE}    die()", f"os.fsync = die{_FILE}", f"os.replace = die{_FILE}"])
def test_the_next_write_removes_what_a_killed_one_left(tmp_path, work):
    target = tmp_path / "t.toml"
    target.write_text("old")
    (left,) = killed(target, work)
    assert target.read_text() == "old"
    write_text(str(tmp_path / "u.toml"), "another target")
    assert left.exists()
    write_text(str(target), "newer")
    assert target.read_text() == "newer"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["t.toml", "u.toml"]


@posix
@pytest.mark.parametrize("renames", [0, 1, 2])
def test_a_folder_is_old_or_new_after_the_next_write(tmp_path, renames):
    """Killed after so many of the two renames; between them the folder is away, and even a write that fails puts it
    back."""
    target = tmp_path / "code"
    with replacing_folder(target) as folder:
        (folder / "file").write_text("old")
    steps = (
        f"steps = iter([os.replace] * {renames} + [die])\nos.replace = lambda *paths: next(steps)(*paths)\n"
    )
    (left,) = killed(target, f"import shutil; shutil.rmtree = die\n{steps}{_FOLDER}")
    assert left.is_dir()
    assert target.exists() == (renames != 1)
    with pytest.raises(ZeroDivisionError), replacing_folder(target):
        raise ZeroDivisionError
    assert [path.name for path in tmp_path.iterdir()] == ["code"]
    assert (target / "file").read_text() == ("new" if renames == 2 else "old")


def test_a_writer_at_work_is_left_alone(tmp_path):
    target, folder = tmp_path / "t.toml", tmp_path / "code"
    with replacing(target) as first, replacing_folder(folder) as first_folder:
        first.write(b"first")
        (first_folder / "first").touch()
        write_text(str(target), "second")
        write_folder(folder, {"second": ""})
        assert target.read_text() == "second"
    assert target.read_text() == "first"
    assert [path.name for path in folder.iterdir()] == ["first"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["code", "t.toml"]


def leftover(target: Path) -> Path:
    """As :func:`replacing` names them; nobody holds a lock on it."""
    return target.with_name(f".{target.name}.{'0' * 12}.tmp")


_WRITERS = {
    "filter": lambda path: save(path, PhyFilter([20.0])),
    "log": lambda path: Recording.from_arrays(x=[[0.5], [0.25]], dt=0.1).to_csv(path),
    "archive": lambda path: write_archive(path, {"a": "1"}),
    "reference_out.csv": lambda path: Reference(np.arange(2.0), {}, {"y": np.ones(2)}).write(path),
    "model": lambda path: _files.write(path, "test", {}),
    "folder": lambda path: write_folder(path, {"a.c": ""}),
}


@posix
@pytest.mark.parametrize("name", _WRITERS)
def test_every_writer_clears_its_leftovers(tmp_path, name):
    target = tmp_path / name
    leftover(target).touch()
    other = leftover(target).with_name(f".{name}.notes.tmp")
    other.touch()
    _WRITERS[name](target)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([name, other.name])


@posix
def test_a_writer_whose_temporary_was_taken_makes_another(tmp_path, monkeypatch):
    """Between making and locking it, another process may take it for a leftover."""
    claimed = _output._claimed
    taken = []

    def late(descriptor: int, part: Path) -> bool:
        if len(taken) < 2:
            taken.append(part)
            _output._remove_leftover(part, tmp_path / "t")
        return claimed(descriptor, part)

    monkeypatch.setattr(_output, "_claimed", late)
    write_text(str(tmp_path / "t"), "whole")
    taken.clear()
    write_folder(tmp_path / "code", {"a.c": ""})
    assert len(set(taken)) == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["code", "t"]


@posix
def test_without_locks_nothing_is_taken_for_a_leftover(tmp_path, monkeypatch):
    def no_locks(*_: object) -> None:
        raise OSError("this file system has no locks")

    monkeypatch.setattr(_output.fcntl, "flock", no_locks)
    leftover(tmp_path / "t").touch()
    write_text(str(tmp_path / "t"), "whole")
    write_folder(tmp_path / "code", {"a.c": ""})
    assert len(list(tmp_path.iterdir())) == 3


@posix
def test_what_is_no_file_is_written_to_and_not_replaced(tmp_path):
    """As /dev/null is, which root could replace."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        write_text(str(pipe), "text")
        assert os.read(reader, 10) == b"text"
    finally:
        os.close(reader)
    assert pipe.is_fifo()


_TOO_LARGE = """
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
try:
    with module[sys.argv[2]](target) as new:
        new.write(bytes(10_000)) if sys.argv[2] == "replacing" else (new / "part").write_bytes(bytes(10_000))
except OSError as error:
    print(error.filename)
"""


@posix
@pytest.mark.parametrize("kind", ["replacing", "replacing_folder"])
def test_a_write_that_finds_no_room_names_its_target(tmp_path, kind):
    """By the limit on the size of a file, which ends a write as a full disk does."""
    target = tmp_path / "target"
    told = subprocess.run(
        [sys.executable, "-c", _START + _TOO_LARGE, str(target), kind],
        capture_output=True,
        text=True,
        check=True,
    )
    assert told.stdout.strip() == str(target)
    assert list(tmp_path.iterdir()) == []
