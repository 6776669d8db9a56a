"""The everyday systems run as they stand, and what they print is what linear theory says of their loops."""

import contextlib
import io
import re
import runpy
from functools import cache
from pathlib import Path

import control as ct
import matplotlib.pyplot as plt
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl import models
from phyfilter_ctl.cli import main

FOLDER = Path(__file__).resolve().parents[3] / "models" / "everyday"
PAGE = (Path(__file__).resolve().parents[3] / "docs" / "everyday.md").read_text(encoding="utf-8")
FILES = ("dc_motor", "pendulum", "two_link_arm", "differential_drive", "vertical_axis")
S = ct.tf("s")
# What theory leaves out: noise, sampling and lag, as a share of the error without and with the filter.
LEFT_OUT = (0.04, 0.15)


@cache
def ran(name, folder):
    """The names of a file that has run in a folder, and the numbers that it printed."""
    with contextlib.chdir(folder), contextlib.redirect_stdout(io.StringIO()) as said:
        try:
            names = runpy.run_path(str(FOLDER / f"{name}.py"), run_name="__main__")
        finally:
            plt.close("all")
    return names, said.getvalue()


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("everyday")


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


def passed(system, t, signal):
    return np.asarray(ct.forced_response(ct.minreal(system, verbose=False), t, signal).outputs)


def loops(name, folder):
    """Names of the file; without and with the filter: what theory leaves out, F(s), speed and signals."""
    names, _ = ran(name, folder)
    filters = (lambda speed: ct.tf([0.0], [1.0]), lambda speed: speed / (S + speed))
    runs = zip(LEFT_OUT, filters, names["runs"].values(), strict=True)
    return names, [(left_out, filter(speed), speed, found) for left_out, filter, (speed, found) in runs]


def test_these_are_the_files():
    assert {path.stem for path in FOLDER.glob("*.py")} == set(FILES)


@pytest.mark.parametrize("name", FILES)
def test_a_file_prints_and_draws(name, folder):
    names, said = ran(name, folder)
    assert (folder / f"{name}.png").stat().st_size > 10_000
    without, filtered = (float(re.search(r": ([\d.]+)", line)[1]) for line in said.splitlines()[:2])
    assert without > 2.5 * filtered
    speeds = [speed for speed, _ in names["runs"].values()]
    # What the page says, to the rounding of its numbers and the last digits of other machines.
    row = re.findall(rf"^\| \[.*?\]\(#{name.replace('_', '-')}\) \|.*$", PAGE, re.M)
    *_, loops, figures = row[0].strip("| ").split(" | ")
    assert [float(part) for part in loops.split(", ")] == pytest.approx(speeds, rel=0.01)
    shown = [float(part) for part in re.findall(r"[\d.]+", figures)]
    assert shown[:2] == pytest.approx([without, filtered], rel=0.02, abs=0.02)


def test_motor_errs_as_its_linear_loop_does_with_the_friction_that_acted(folder):
    names, found = loops("dc_motor", folder)
    J, t = names["J"], names["t"]
    lag = 1.0 / ((names["lag"] + names["dt"]) * S + 1.0)
    for left_out, F, speed, run in found:
        answers = 1.0 / (J * (S + lag * (speed + F * S) / (1.0 - F)))
        error = passed(answers * J * S * (1.0 - lag), t, run["r"]) - passed(answers, t, run["f"])
        assert rms(run["r"] - run["omega"]) == pytest.approx(rms(error), rel=left_out)


def test_pendulum_errs_by_what_the_filter_leaves_of_the_force(folder):
    names, found = loops("pendulum", folder)
    for left_out, F, speed, run in found:
        error = passed((1.0 - F) / (S + speed) ** 2, names["t"], -run["f"] / names["M"])
        assert rms(run["r"] - run["angle"]) == pytest.approx(rms(error), rel=left_out)


def test_arm_errs_by_what_the_filter_leaves_of_the_load_over_its_moving_inertia(folder):
    names, found = loops("two_link_arm", folder)
    for left_out, F, speed, run in found:
        left = np.array([passed(1.0 - F, names["t"], f) for f in run["f"]]).T
        inertia = [np.array(names["terms"](q, np.zeros(2), 0.0)[0]) for q in np.asarray(run["q"]).T]
        missing = np.linalg.solve(inertia, left[:, :, None])[:, :, 0].T
        error = [passed(-1.0 / (S + speed) ** 2, names["t"], each) for each in missing]
        for joint in range(2):
            assert rms(run["r"][joint] - run["q"][joint]) == pytest.approx(rms(error[joint]), rel=left_out)


def test_robot_on_wheels_errs_as_its_law_at_rest_relative_to_the_path(folder):
    """What is left of the force makes an error of (v, omega), and this one of the pose, by the two laws' gains."""
    names, found = loops("differential_drive", folder)
    t, M, (v, omega) = names["t"], names["M"], names["ref"]
    settled = t > 3.0
    goal = names["radius"] * np.array([np.sin(omega * t), 1.0 - np.cos(omega * t)])
    for left_out, F, speed, run in found:
        slow, turning = (passed(1.0 - F, t, f) / (m * speed) for f, m in zip(run["f"], M, strict=True))
        error = np.hypot(slow / (speed / 4.0), turning * v / (speed / 4.0) ** 2)
        apart = np.linalg.norm(np.asarray(run["pose"])[:2] - goal, axis=0)
        assert rms(apart[settled]) == pytest.approx(rms(error[settled]), rel=left_out)


def test_multirotor_sags_by_the_load_over_its_stiffness_and_the_filter_weighs_it(folder):
    names, [(_, _, speed, without), (_, _, _, filtered)] = loops("vertical_axis", folder)
    m, load, G, end = names["m"], names["load"], names["G"], names["t"] > 8.0
    assert without["z"][end].mean() == pytest.approx(-load * G / (m * speed**2), rel=LEFT_OUT[0])
    # What noise moves the mean of the estimates by: the momentum at both ends, over the time between.
    deviation = m * names["noise"] * np.sqrt(2.0) / 2.0
    for run in (without, filtered):
        assert -run["f_hat"][end].mean() / G == pytest.approx(load, abs=4.0 * deviation / G)
    assert abs(filtered["z"][end].mean()) < 0.05 * abs(without["z"][end].mean())


def test_the_motors_estimate_errs_by_its_lag_and_noise_alone(folder):
    """Between the reversals the friction changes slowly, and what is left is the noise that the theory gives."""
    names, [_, (_, _, speed, run)] = loops("dc_motor", folder)
    sampled = pf.lowpass(1, speed).sampled(names["dt"])
    noise = np.sqrt(pf.error_variance(sampled, pf.Gaussian(noise=names["noise"] * names["J"])).noise)
    slow = np.abs(run["omega"]) > 50.0
    assert rms((run["f_hat"] - run["f"])[slow]) < 1.5 * noise


@pytest.mark.parametrize("name", FILES)
def test_a_diagram_is_drawn_by_the_command(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    where = f"phyfilter_ctl.models.everyday.{name}:loop"
    assert main(["draw", where, "-o", "loop.svg", "--json", "-", "--quiet"]) == 0
    assert "filter.f_hat" in capsys.readouterr().out


def test_the_files_are_no_models_to_run(capsys):
    """``run`` offers studies alone; its help says how the files run."""
    assert "everyday" not in models.available()
    with pytest.raises(SystemExit, match="2"):
        main(["run", "everyday"])
    assert "invalid choice: 'everyday'" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="0"):
        main(["run", "--help"])
    assert "python -m phyfilter_ctl.models.everyday.pendulum" in capsys.readouterr().out
