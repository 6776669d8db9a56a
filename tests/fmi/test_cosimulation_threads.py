"""FMUs stepped in parallel: the same bits as in turn, and no race."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import control as ct
import numpy as np
import pytest
from foreign_fmus import oscillator

from phyfilter_ctl.fmi import Master, System, cosimulate, export_fmu

T = np.linspace(0.0, 0.5, 6)


@pytest.mark.slow
def test_to_the_bit(tmp_path, build):
    """FMUs written by hand and exported ones of 2.0 and 3.0, a linear system and a nonlinear one among them."""
    lag = ct.ss([[0.98]], [[0.02]], [[1.0]], [[0.0]], dt=0.002, inputs="u", outputs="y", name="lag")
    filters = [export_fmu(lag, tmp_path / f"lag{fmi[0]}.fmu", fmi=fmi, name="lag") for fmi in ("2.0", "3.0")]
    parts = {
        "a": build(interpolates=True),
        "b": filters[0],
        "slow": ct.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]], inputs="u", outputs="y", name="slow"),
        "c": build("3.0"),
        "bend": ct.nlsys(None, lambda t, x, u, params: np.sin(u), inputs="u", outputs="y", name="bend"),
        "d": filters[1],
    }
    wires = [("a.place", "d.y"), ("b.u", "a.x"), ("slow.u", "b.y"), ("c.place[0]", "slow.y")]
    wires += [("c.place[1]", "b.y"), ("bend.u", "c.x[1]"), ("d.u", "bend.y", "-c.x[0]")]
    for options in ({"step": 0.002}, {"step": 0.002, "hold": "first"}):
        runs = [
            cosimulate(System(parts, wires), T, master=Master(threads=threads, **options))
            for threads in (1, 2, 3, 6, 6)
        ]
        assert all(np.array_equal(run.outputs, runs[0].outputs) for run in runs[1:])


@pytest.mark.slow
def test_no_race(tmp_path, monkeypatch):
    """Under ThreadSanitizer, which finds the race that a weaker order of memory makes."""
    gcc = shutil.which("gcc")
    library = gcc and subprocess.check_output([gcc, "-print-file-name=libtsan.so"], text=True).strip()
    if sys.platform != "linux" or not library or not Path(library).is_file():
        pytest.skip("gcc has no ThreadSanitizer here")
    monkeypatch.setattr("foreign_fmus.FLAGS", ("-fsanitize=thread", "-g"))
    paths = [oscillator(tmp_path, name=name, interpolates=name == "sloped") for name in ("plain", "sloped")]
    child = subprocess.run(
        [sys.executable, str(Path(__file__).with_name("run_threads.py")), *map(str, paths)],
        env=os.environ | {"LD_PRELOAD": library, "TSAN_OPTIONS": "exitcode=66", "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=300,
    )
    if "unexpected memory mapping" in child.stderr:
        pytest.skip("ThreadSanitizer does not run with this kernel's layout of memory")
    clean, _, raced = child.stderr.partition("with a race:")
    assert "ThreadSanitizer" not in clean
    assert "ThreadSanitizer: data race" in raced, child.stderr
    assert child.returncode == 66
