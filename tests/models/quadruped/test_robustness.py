"""Policies of several trainings under everything they may meet: pairing, intervals, and what is refused."""

from __future__ import annotations

import importlib
import json

import numpy as np
import pytest

from phyfilter_ctl import models
from phyfilter_ctl.cli import main

pytest.importorskip("mujoco", reason="mujoco is not installed: nothing walks")

ROOM = f"{models.__name__}.quadruped"
evaluation = importlib.import_module(f"{ROOM}.evaluation")
params = importlib.import_module(f"{ROOM}.params")
policy = importlib.import_module(f"{ROOM}.policy")
robustness = importlib.import_module(f"{ROOM}.robustness")
terrain = importlib.import_module(f"{ROOM}.terrain")

P = params.params("go1")
FAMILIES = ("base", "filter", "basefull")


def trot(seed: int, steps: int = 10, robot: str = "go1") -> object:
    """The trot itself: a network of zeros."""
    return policy.Policy(((np.zeros((12, 47)), np.zeros(12)),), robot, {"seed": seed, "steps": steps})


def filled(**changes: np.ndarray) -> object:
    values = {
        ("flat", name): {figure: np.array([0.1, 0.2, 0.3]) for figure in robustness.FIGURES}
        for name in robustness.ARMS
    }
    for name, value in changes.items():
        values["flat", name]["error"] = value
    return robustness.Judged("go1", (0, 1, 2), {"base": 10, "basefull": 20}, values)


def test_a_difference_counts_where_every_seed_agrees():
    found = filled(
        put_on=np.array([0.05, 0.15, 0.25]),
        filter=np.array([0.05, 0.21, 0.25]),
        full=np.array([0.2, 0.3, 0.4]),
        off=np.array([np.nan, np.nan, np.nan]),
        est=np.array([0.05, np.nan, 0.25]),
    )
    lines = robustness.table(found).splitlines()
    [head] = [k for k, line in enumerate(lines) if line.startswith("velocity error")]
    row = lines[head + 1]
    assert "trained for 10 steps (basefull 20)" in lines[0]
    assert row.count("<") == 1
    assert row.count(">") == 1
    assert "15.0 [5.0, 25.0] <" in row
    assert "30.0 [20.0, 40.0] >" in row
    assert "21.0 [5.0, 25.0]  " in row, "one seed is worse"
    assert row.count(" -") == 1, "no walk of any policy has the figure"
    assert json.loads(json.dumps(robustness.figures(found)))["conditions"]["flat"]["est"]["error"][1] is None


@pytest.mark.slow
def test_arms_walk_side_by_side_and_each_policy_has_its_figure():
    found = {family: [trot(0), trot(1)] for family in FAMILIES}
    ground = terrain.Terrain("rough", 0.5, count=3)
    wanted = (
        robustness.Condition("flat", evaluation.Case(robot="go1", speed=0.0)),
        robustness.Condition("ground", evaluation.Case(robot="go1", speed=0.0), ground),
    )
    judged = robustness.judge(found, wanted, starts=1, duration=0.1, threads=1)
    assert set(judged.values) == {(row, arm) for row in ("flat", "ground") for arm in robustness.ARMS}
    for values in judged.values.values():
        assert all(value.shape == (2,) for value in values.values())
        assert np.all(values["fallen"] == 0.0)
        assert np.all(values["error"] < 0.6)


def test_a_judgement_that_was_stopped_goes_on(tmp_path, monkeypatch):
    """What was walked is not walked again, unless the policy, the condition or the number of walks is another."""
    walked = []

    def judge(one, batch, *, starts, **_):
        [base], value = one["base"], float(len(walked))
        walked.append((base.record["seed"], [entry.label for entry in batch], starts))
        if len(walked) == 3:
            raise KeyboardInterrupt
        figures = dict.fromkeys(robustness.FIGURES, np.array([value])) | {"ripple": np.array([np.nan])}
        cells = {(entry.label, arm): figures for entry in batch for arm in robustness.ARMS}
        return robustness.Judged("go1", (0,), {"base": 10}, cells)

    monkeypatch.setattr(robustness, "judge", judge)
    found = {family: [trot(0), trot(1)] for family in FAMILIES}
    wanted = robustness.conditions("go1", quick=True)
    with pytest.raises(KeyboardInterrupt):
        robustness.judge_each(found, wanted, starts=1, folder=tmp_path)
    flat, rough = ["nothing", "payload 60 %"], ["rough 0.3"]
    assert walked == [(0, flat, 1), (0, rough, 1), (1, flat, 1)]
    judged = robustness.judge_each(found, wanted, starts=1, folder=tmp_path)
    assert walked[3:] == [(1, flat, 1), (1, rough, 1)]
    assert judged.seeds == (0, 1)
    assert judged.values["rough 0.3", "base"]["error"].tolist() == [1.0, 4.0]
    assert np.isnan(judged.values["nothing", "full"]["ripple"]).all()
    assert len(list(tmp_path.iterdir())) == 4
    robustness.judge_each(found, wanted[:1], starts=2, folder=tmp_path)
    other = policy.Policy(((np.full((12, 47), 1e-9), np.zeros(12)),), "go1", {"seed": 0, "steps": 10})
    robustness.judge_each({family: [other] for family in FAMILIES}, wanted[2:], starts=1, folder=tmp_path)
    assert walked[5:] == [(0, ["nothing"], 2), (1, ["nothing"], 2), (0, rough, 1)]


def test_walks_without_a_figure_are_left_out():
    walks = np.array([[0.2, np.nan, 0.4], [np.nan, np.nan, np.nan]])
    found = robustness._of_policies(walks)
    assert found[0] == pytest.approx(0.3)
    assert np.isnan(found[1])
    assert robustness._of_policies(np.array([[True, False]]))[0] == 0.5


def test_conditions_are_what_the_robot_can_carry():
    rows = robustness.conditions("go1")
    labels = [row.label for row in rows]
    assert len(set(labels)) == len(labels)
    assert max(row.case.payload for row in rows) == pytest.approx(0.9 * P.robot.mass)
    assert max(row.case.speed for row in rows) == 2.83
    assert {row.case.disabled for row in rows} == {"", *P.robot.joints[:3]}
    risers = {round(ground.riser, 3) for row in rows if (ground := row.ground)} - {0.0}
    assert risers == {0.06, 0.10, 0.14, 0.17}
    assert sum(row.ground is not None and row.ground.count == 10 for row in rows) == 4


def test_slopes_rise_by_their_angle():
    up, down = (terrain.Terrain(kind, 0.5) for kind in ("slope", "descent"))
    assert float(up.height(3.0, 0.0)) == pytest.approx(2.0 * np.tan(np.radians(10.0)), abs=1e-5)
    assert float(down.height(3.0, 0.0)) == -float(up.height(3.0, 0.0))
    assert float(up.height(0.5, 0.0)) == 0.0


def test_policies_come_in_whole_sets(tmp_path, capsys):
    for family in FAMILIES[:2]:
        policy.save(trot(0), tmp_path / f"{family}-0.json")
    with pytest.raises(
        ValueError, match=r"no seed with policies of all trainings \(base-0.json, filter-0.json"
    ):
        robustness.policies("go1", folder=tmp_path)
    policy.save(trot(0, 20), tmp_path / "basefull-0.json")
    robustness.policies(
        "go1", folder=tmp_path
    )  # the only training that may be longer, and just twice as long
    for family, steps in (("basefull", 30), ("filter", 20)):
        policy.save(trot(0, steps), tmp_path / f"{family}-0.json")
        with pytest.raises(
            ValueError, match=f"trained equally long.* got robots go1, steps: .*{family} {steps}"
        ):
            robustness.policies("go1", folder=tmp_path)
        policy.save(trot(0), tmp_path / f"{family}-0.json")
    for family in FAMILIES:
        policy.save(trot(1, 20 if family == "basefull" else 10), tmp_path / f"{family}-1.json")
    with pytest.raises(ValueError, match="steps: base 10; filter 10; basefull 10, 20"):
        robustness.policies("go1", folder=tmp_path)
    for family in FAMILIES:
        (tmp_path / f"{family}-1.json").unlink()
    policy.save(trot(1), tmp_path / "base-1.json")
    found = robustness.policies("go1", folder=tmp_path)
    assert {family: len(entries) for family, entries in found.items()} == dict.fromkeys(FAMILIES, 1)
    assert main(["run", "quadruped", "--quiet", "--policies", str(tmp_path)]) == 2
    assert "--policies with --robustness" in capsys.readouterr().err
    for wrong, message in (
        ("--contact known", "--robustness has filters of its own"),
        ("--robot go9", "got 'go9'"),
    ):
        assert main(["run", "quadruped", "--quiet", "--robustness", *wrong.split()]) == 2
        assert message in capsys.readouterr().err


def test_transport_and_clearance_are_those_of_the_trot():
    """The trot lifts its feet by less than its table says: the legs sag, the soles touch ground half of the time."""
    case = evaluation.Case(robot="go1", speed=0.0)
    [found] = evaluation.walk(
        [evaluation.Group([trot(0)])], [case], starts=np.zeros(1), duration=1.0, threads=1
    )
    assert 0.01 < found.clearance.item() < P.gait.clearance
    assert found.transport.item() > 0.0


@pytest.mark.slow
def test_command_prints_the_table(tmp_path, capsys):
    for family in FAMILIES:
        policy.save(trot(0), tmp_path / f"{family}-0.json")
    target = tmp_path / "figures.json"
    command = ["run", "quadruped", "--robustness", "--policies", str(tmp_path), "--quick", "--quiet"]
    picture = tmp_path / "arms.png"
    assert main([*command, "--threads", "1", "--json", str(target), "--picture", str(picture)]) == 0
    assert picture.read_bytes()[:4] == b"\x89PNG"
    assert "trained for 10 steps" in capsys.readouterr().out
    assert set(json.loads(target.read_text())["conditions"]) == {"nothing", "payload 60 %", "rough 0.3"}
