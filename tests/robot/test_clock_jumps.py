"""A log whose clock was set: read, checked, estimated and run again, from the command line and from Python."""

import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl import open_log
from phyfilter_ctl.cli import main
from phyfilter_ctl.robot import Robot, describe_log

DT, JUMP = 0.01, 3600.0
CART = """
format = "phyfilter-robot"
version = 1
[constants]
mass = 2.0
[signals.v]
field = "speed"
unit = "m/s"
[signals.force]
field = "force_N"
unit = "N"
between = "hold"
[model]
x = "v"
unit = "m/s"
M = "mass"
g = "force"
"""


def drag(t):
    return 1.0 + 0.5 * np.sin(0.8 * t)


@pytest.fixture
def cart(tmp_path):
    """60 s of a cart of 2 kg under a held force and a slow one that is not known; the clock set after 30 s."""
    t = DT * np.arange(6000)
    force = 3.0 * np.sin(1.3 * t)
    speed = np.concatenate([[0.0], np.cumsum((force + drag(t))[:-1] * DT / 2.0)])
    speed += 0.002 * np.random.default_rng(0).standard_normal(len(t))
    t[3000:] += JUMP
    rows = [f"{a:.2f},{v:.6f},{f:.6f}" for a, v, f in zip(t, speed, force, strict=True)]
    path = tmp_path / "cart.csv"
    path.write_text("\n".join(["t_s,speed,force_N", *rows]) + "\n")
    (tmp_path / "robot.toml").write_text(CART)
    return path


def test_conventions_are_judged_by_a_part_without_the_jump(cart):
    found = Robot.load(cart.parent / "robot.toml").check(cart)
    assert [finding.suspicion for finding in found.findings] == ["clock_jump"]
    assert found.findings[0].message.startswith(
        "the times jump ahead 1 time, first by 3600.01 s after 29.99 s"
    )
    assert list(found.misfits) == ["as declared"]


def test_the_command_estimates_over_it(cart, capsys):
    assert main(["estimate", str(cart), "--robot", str(cart.parent / "robot.toml")]) == 0
    said = capsys.readouterr()
    assert "jump ahead 1 time, first by 3600.01 s" in said.out + said.err


def test_the_saved_filter_runs_on_the_log_that_it_came_from(cart, tmp_path):
    log = Robot.load(cart.parent / "robot.toml").read(cart)
    found = pf.estimate(log)
    pf.save(tmp_path / "filter.toml", found.filter)
    again = pf.load(tmp_path / "filter.toml")
    f_hat = again.run(log.x, log.g, log.f_theta, log.inertia, log.times)
    np.testing.assert_allclose(f_hat, found.f_hat[0], atol=1e-12)
    truth = drag(np.where(log.times > JUMP, log.times - JUMP, log.times))
    near = slice(2990, 3020)  # no step of the estimate at the jump: it errs there as it does elsewhere
    worst = np.max(np.abs(f_hat[500:, 0] - truth[500:]))
    assert np.max(np.abs(f_hat[near, 0] - truth[near])) <= worst
    assert worst < 0.35


def test_a_jump_is_no_gap_of_a_logs_clock(cart):
    (topic,) = open_log(cart).topics
    assert (topic.clock.jumps, topic.clock.gaps) == (1, 0)
    assert topic.clock.longest == pytest.approx(DT)
    assert topic.clock.findings == (
        "the clock jumps ahead 1 time, by up to 3600.01 s: it was set, or the log goes on after a pause",
    )


def test_a_recording_says_so_too(cart):
    said = Robot.load(cart.parent / "robot.toml").read(cart).describe()
    assert "gaps      none" in said
    assert "jumps     1 of the clock, the first ahead by 3600.01 s after 29.99 s" in said


def test_a_gap_stays_a_gap():
    t = np.r_[0.0:5.0:0.01, 6.0:10.0:0.01]
    log = pf.Recording.from_arrays(x=np.sin(t), times=t)
    assert log.check().ok


def test_a_form_has_the_fields_of_the_log(cart, tmp_path):
    text = describe_log(open_log(cart))
    assert 'field = "speed"' in text
    assert 'field = "force_N"' in text
    assert not any(word in text for word in ("ENU", "gravity", '"vx"'))
    (tmp_path / "own.toml").write_text(text.replace('"FILL IN"', "2.0"))
    found = Robot.load(tmp_path / "own.toml").read(cart)
    assert found.channels == ("v",) or found.n_x == 1
    assert found.g is not None
