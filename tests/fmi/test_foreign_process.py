"""Foreign binaries in a process of their own, and in threads of this one."""

import json
import os
import sys
import threading
import time
import zipfile
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from foreign_ball import ball

from phyfilter_ctl import simulate
from phyfilter_ctl.cli import main
from phyfilter_ctl.fmi import (
    CosimulationResponse,
    Fmu,
    FmuError,
    Isolation,
    Master,
    check,
    cosimulate,
    import_fmu,
)
from tests.stopping import STATUS, below, linux, stopped

T = np.linspace(0.0, 1.0, 11)
ENDINGS = {"SEGFAULT": r"SIGSEGV", "ABORT": r"SIGABRT", "EXIT": r"exit\(3\)"}
posix = pytest.mark.skipif(os.name == "nt", reason="ends of processes are named by signals")


def evil(build, what, fmi="2.0"):
    return build(fmi, defines=("MISCHIEF_AT=0.35", f"MISCHIEF={what}"))


def assert_ends_with_results(path, match, healthy, isolated=True):
    with pytest.raises(FmuError, match=match) as caught:
        cosimulate({"a": Fmu(path, isolated=isolated)}, T)
    found = caught.value.results
    assert isinstance(found, CosimulationResponse)
    assert not found.success
    before = cosimulate({"a": healthy}, timepts=T)
    assert np.array_equal(found.outputs[:, :4], before.outputs[:, :4])
    assert np.all(np.isnan(found.outputs[:, 4:]))
    return caught.value


@posix
def test_a_crash_is_an_error_with_the_results_so_far(build):
    match = r"FMU 'a': fmi2DoStep: crashed: at t = 0.3 its process ended: SIGSEGV"
    assert assert_ends_with_results(evil(build, "SEGFAULT"), match, build()).status == "crashed"


@posix
@pytest.mark.slow
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
@pytest.mark.parametrize("what", sorted(ENDINGS))
def test_every_end(build, fmi, what):
    match = rf"fmi{fmi[0]}DoStep: crashed: at t = 0.3 its process ended: {ENDINGS[what]}"
    assert_ends_with_results(evil(build, what, fmi), match, build(fmi))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("isolation", "match"),
    [
        (Isolation(call_limit=3.0), "the call took longer than 3 s"),
        (Isolation(run_limit=4.0), "the run took longer"),
    ],
)
def test_a_hang_ends_at_its_limit(build, isolation, match):
    """Within a tenth of the limit and what ending a process takes; not never."""
    began = time.monotonic()
    path = evil(build, "HANG")
    assert assert_ends_with_results(path, match, build(), isolation).status == "time limit"
    assert time.monotonic() - began < 30.0


@linux
@pytest.mark.slow
@pytest.mark.parametrize("number", STATUS)
def test_a_command_that_is_stopped_ends_a_hanging_fmu(build, number, tmp_path):
    """Its process goes, and what was unpacked: within seconds, though a call may last a minute."""
    cpu = os.sysconf("SC_CLK_TCK")

    def is_hanging(pid, temporary):
        """Its process spends a second of CPU more than starting takes."""
        for child in below(pid):
            with suppress(OSError):
                spent = (Path("/proc") / str(child) / "stat").read_text().rpartition(")")[2].split()[11]
                if int(spent) > 3 * cpu:
                    return True
        return False

    began = time.monotonic()
    left = stopped(["fmu", "run", str(evil(build, "HANG")), "--stop", "1"], number, tmp_path, is_hanging)
    assert left[2:] == ([], [])
    assert left.status == STATUS[number], left.said
    assert time.monotonic() - began < 40.0


@pytest.mark.slow
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_same_bits_as_in_this_process(build, fmi):
    """Co-simulation with rollback, and model exchange, on either side of the border."""

    def run(isolated):
        found = cosimulate({"a": Fmu(build(fmi), isolated=isolated)}, T, master=Master(tolerance=1e-6))
        block = import_fmu(Fmu(build(fmi, kinds="me"), isolated=isolated))
        rate = block.dynamics(0.0, block.start_state + 0.3, np.full(block.ninputs, 0.2))
        block.close()
        return found.outputs, rate

    here, there = run(False), run(True)
    assert all(np.array_equal(a, b) for a, b in zip(here, there, strict=True))


@pytest.mark.slow
def test_events_on_either_side_of_the_border(tmp_path):
    """A bouncing ball in model exchange: indicators, event mode and steps of the integrator, call by call."""
    path = ball(tmp_path, "3.0")
    runs = [simulate(import_fmu(Fmu(path, isolated=isolated), kind="me"), T) for isolated in (False, True)]
    assert all(run.success for run in runs)
    assert np.array_equal(runs[0].outputs, runs[1].outputs)


@pytest.mark.slow
def test_what_it_logs_and_refuses_comes_back(build):
    assert_ends_with_results(
        build(defines=("FAIL_AT=0.35",)),
        r"fmi2DoStep: error: at t = 0.3; .*spring broke at t = 0.3: too long",
        build(),
    )
    with pytest.raises(FmuError, match=r"Instantiate: error: .*guid is other, not oscillator"):
        import_fmu(Fmu(build(guid="other"), isolated=True))


@posix
@pytest.mark.slow
def test_the_command_survives_what_it_runs(build, tmp_path, capsys):
    """Results so far are written and printed, the report goes on with the next stage, prints stay out of the table."""
    path = str(evil(build, "ABORT"))
    assert main(["fmu", "run", path, "--stop", "1", "--step", "0.1", "--out", str(tmp_path / "out.csv")]) == 1
    shown = capsys.readouterr()
    assert "SIGABRT" in shown.err
    assert "4 points, 0 to 0.3 s" in shown.out
    assert len((tmp_path / "out.csv").read_text().splitlines()) == 5
    assert main(["fmu", "check", path, "--json", "-"]) == 1
    report = json.loads(capsys.readouterr().out)
    assert any("SIGABRT" in finding["message"] for finding in report["findings"])
    assert report["stages"][-1] == "co-simulation: dependencies"
    assert "SIGABRT" in str(check(Fmu(path, isolated=True)))


def test_limits_above_zero():
    with pytest.raises(ValueError, match="call_limit: expected seconds > 0, got 0"):
        Isolation(call_limit=0.0)


def test_threads_load_without_a_change_of_folder(build):
    """Eight threads that load: another one that looks all the while sees one folder only."""
    paths, before, seen, problems, done = [build(), build("3.0")], os.getcwd(), set(), [], threading.Event()

    def look():
        while not done.is_set():
            seen.add(os.getcwd())

    def load(path):
        try:
            for _ in range(4):
                import_fmu(path, kind="cs").close()
        except Exception as error:
            problems.append(error)

    watcher = threading.Thread(target=look)
    threads = [threading.Thread(target=load, args=(paths[k % 2],)) for k in range(8)]
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    try:
        for thread in (watcher, *threads):
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        done.set()
        watcher.join()
        sys.setswitchinterval(interval)
    assert not problems
    assert seen == {before}


@pytest.mark.slow
def test_a_tool_coupled_fmu_runs_with_a_warning(build, tmp_path):
    path = tmp_path / "coupled.fmu"
    with zipfile.ZipFile(build()) as source, zipfile.ZipFile(path, "w") as target:
        for name in source.namelist():
            data = source.read(name)
            if name == "modelDescription.xml":
                data = data.replace(b"<CoSimulation ", b'<CoSimulation needsExecutionTool="true" ')
            target.writestr(name, data)
    with pytest.warns(UserWarning, match=r"needs the tool that made it \(by hand\)"):
        block = import_fmu(path, kind="cs")
    assert block.restart()[0] == 1.0


def test_a_32_bit_binary_is_called_so(build, tmp_path):
    path = tmp_path / "narrow.fmu"
    with zipfile.ZipFile(build()) as source, zipfile.ZipFile(path, "w") as target:
        for name in source.namelist():
            head = b"\x7fELF\x01\x01\x01" + bytes(9) + b"\x03\x00\x03\x00\x01" + bytes(60)
            target.writestr(name, head if name.startswith("binaries") else source.read(name))
    with pytest.raises(
        FmuError, match=r"oscillator2\.so is a 32-bit binary, and this Python is a 64-bit one"
    ):
        import_fmu(path)
    with pytest.raises(ValueError, match=r"it has binaries for x86-windows \(32-bit\)"):
        import_fmu(build(platform="win32"))
