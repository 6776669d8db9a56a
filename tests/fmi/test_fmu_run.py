"""``fmu run`` and co-simulation with what FMUs do of their own: end the run, return early, ask for a step."""

import csv
import dataclasses

import numpy as np
import pytest
from foreign_ball import ball

import phyfilter_ctl as pf
from phyfilter_ctl.cli import main
from phyfilter_ctl.fmi import Fmu, cosimulate, describe, import_fmu

T = np.linspace(0.0, 1.0, 11)


def table(path):
    with path.open() as file:
        rows = list(csv.reader(file))
    return rows[0], np.array(rows[1:], dtype=float)


@pytest.mark.slow
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_an_fmu_that_ends_the_run_is_no_failure(build, fmi, tmp_path, capsys):
    path = build(fmi, defines=("ENDS_AT=0.5",))
    whole = cosimulate({"mass": build(fmi)}, T)
    block = import_fmu(Fmu(path, outputs=["x"]), kind="cs", step=0.1)  # the loop in Python and the one in C
    for part in (path, block):
        response = cosimulate({"mass": part}, T, outputs=["mass.x"] if fmi == "2.0" else ["mass.x[0]"])
        assert not response.success
        assert "asks to end the run at t = 0.5" in response.message
        assert np.array_equal(response.outputs[0, :6], whole.outputs[0, :6])
        assert np.isnan(response.outputs[0, 6:]).all()
    out = tmp_path / "out.csv"
    command = ["fmu", "run", str(path), "--stop", "1", "--step", "0.1", "--in-process", "--out", str(out)]
    assert main(command) == 0
    assert "note: FMU 'fmu': fmi" in capsys.readouterr().err
    assert table(out)[1][:, 0].tolist() == T[:6].tolist()


@pytest.mark.slow
def test_early_return(build):
    whole, early = (
        cosimulate({"mass": build("3.0", **options)}, T).outputs
        for options in ({}, {"defines": ("RETURNS_AT=0.25",)})
    )
    # RK4 of at most 1 ms either way.
    assert np.max(np.abs(whole - early)) < 1e-10
    block = import_fmu(build("3.0", defines=("RETURNS_AT=0.25",)), kind="cs", step=0.1)
    by_hand = [block.step([0.0, 0.0]) for _ in range(10)]
    assert np.max(np.abs(np.array(by_hand).T - early[:, 1:])) < 1e-10


@pytest.mark.slow
def test_what_is_recorded(build, tmp_path):
    """Any variable by name or pattern: an invariant of the ball between bounces, and counters."""
    out = tmp_path / "out.csv"
    command = [
        "fmu",
        "run",
        str(ball(tmp_path)),
        "--record",
        "energy",
        "t*k?",
        "--out",
        str(out),
        "--set",
        "e=1",
    ]
    assert main([*command, "--in-process"]) == 0
    names, values = table(out)
    assert names == ["time", "ticks", "energy"]
    assert np.max(np.abs(values[:, 2] - 9.81)) < 1e-10
    assert values[-1, 1] == 8.0
    kept = import_fmu(Fmu(build(), outputs=["der(*)", "steps"]), kind="cs", step=0.1)
    response = cosimulate({"mass": kept}, T)
    assert response.output_labels == ["mass.der(x)", "mass.der(v)", "mass.steps"]
    assert response.outputs[2].tolist() == list(range(11))
    with pytest.raises(ValueError, match=r"no numeric variable of .* matches 'speed'"):
        import_fmu(Fmu(build(), outputs=["speed"]))


def test_steps_that_it_asks_for(tmp_path, build):
    """The default experiment's step, in multiples of a fixed internal one."""
    found = describe(build())
    fixed = {"cs": dataclasses.replace(found.kinds["cs"], fixed_step=0.004)}
    assert found.communication_step == 0.01
    assert dataclasses.replace(found, kinds=fixed).communication_step == pytest.approx(0.008)
    assert dataclasses.replace(found, kinds=fixed, step=None).communication_step == 0.004


@pytest.mark.slow
def test_model_exchange_on_the_command_line(tmp_path, capsys):
    """With its events, its end, and inputs from a file, as by `simulate`."""
    path, out, given = ball(tmp_path, "3.0"), tmp_path / "out.csv", tmp_path / "in.csv"
    given.write_text("time,push\n0,0\n2,2\n")
    command = [
        "fmu",
        "run",
        str(path),
        "--in-process",
        "--step",
        "0.05",
        "--input",
        str(given),
        "--out",
        str(out),
    ]
    assert main([*command, "--set", "last=5"]) == 0
    assert "note: block Ball: the FMU asked to end the run at t = 1.25 s" in capsys.readouterr().err
    times = np.linspace(0.0, 2.0, 41)
    expected = pf.simulate(import_fmu(path), times, times).outputs
    assert np.array_equal(table(out)[1][:, 1:], expected[:, :26].T), "with the row at which it ended"
    given.write_text("time,pull\n0,0\n2,2\n")
    assert main(command) == 2
    assert "'pull' is no input of numbers; there are push" in capsys.readouterr().err
