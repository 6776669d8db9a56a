"""The quadruped walks, trains and reports."""

from __future__ import annotations

import importlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from phyfilter_ctl import models
from phyfilter_ctl.cli import main

pytest.importorskip("mujoco", reason="mujoco is not installed: nothing walks")

ROOM = f"{models.__name__}.quadruped"
comparison = importlib.import_module(f"{ROOM}.comparison")
environment = importlib.import_module(f"{ROOM}.environment")
evaluation = importlib.import_module(f"{ROOM}.evaluation")
loop = importlib.import_module(f"{ROOM}.loop")
methods = importlib.import_module(f"{ROOM}.methods")
params = importlib.import_module(f"{ROOM}.params")
policy = importlib.import_module(f"{ROOM}.policy")
report = importlib.import_module(f"{ROOM}.report")
terrain = importlib.import_module(f"{ROOM}.terrain")
training = importlib.import_module(f"{ROOM}.training")

WEIGHT = params.params().robot.mass
STARTS = evaluation.phases(count=2)
# Single precision: the network in torch against plain numbers.
SINGLE = 2e-4


def shipped(family: str, count: int = 1) -> list[policy.Policy]:
    return [policy.shipped(f"{family}-{seed}") for seed in range(count)]


def test_groups_in_one_batch_walk_as_each_alone():
    cases = [evaluation.Case(0.3 * WEIGHT), evaluation.Case(push=75.0, strength=0.9)]
    groups = [
        evaluation.Group(shipped("base", 2)),
        evaluation.Group(shipped("filter"), loop.paper_filter()),
        evaluation.Group(shipped("filter"), methods.IMPROVED),
    ]
    together = evaluation.walk(groups, cases, starts=STARTS, duration=1.5)
    for group, found in zip(groups, together, strict=True):
        [alone] = evaluation.walk([group], cases, starts=STARTS, duration=1.5, threads=1)
        for name in ("error", "ripple", "fallen", "distance", "estimate"):
            assert np.array_equal(getattr(found, name), getattr(alone, name), equal_nan=True), name
        assert np.array_equal(found.trace.qpos, alone.trace.qpos)


def test_walks_do_not_depend_on_the_order_of_sums():
    """Neurons in another order and a gain of 1 + 2^-52, on rough ground: the same walks to the bit.

    That is how processors differ from one another; unrounded, the walks part.
    """
    [first] = shipped("filter")
    (weights, bias), (next_weights, next_bias), *rest = first.layers
    order = np.random.default_rng(0).permutation(len(bias))
    layers = ((weights[order], bias[order]), (next_weights[:, order], next_bias), *rest)
    other = policy.Policy(layers, first.robot, first.record)
    paper = loop.paper_filter()
    changed = replace(paper, gain=np.nextafter(1.0, 2.0))
    ground = terrain.Terrain("rough", 0.8)
    groups = [evaluation.Group([first], paper), evaluation.Group([other], changed)]
    one, two = (
        evaluation.walk([group], [evaluation.Case()], starts=STARTS, terrain=ground, duration=2.0)[0]
        for group in groups
    )
    assert not np.array_equal(one.trace.f_hat, two.trace.f_hat)
    assert np.array_equal(one.trace.qpos, two.trace.qpos)
    assert np.array_equal(one.distance, two.distance)


def test_filter_carries_what_it_was_not_trained_for():
    """Headline at a small scale: payload of 60 % of the weight, policy 0, two phases."""
    case = [evaluation.Case(0.6 * WEIGHT)]
    groups = [
        evaluation.Group(shipped("early_base")),
        evaluation.Group(shipped("early_filter"), loop.paper_filter()),
        evaluation.Group(shipped("filter"), loop.paper_filter()),
        evaluation.Group(shipped("filter"), methods.IMPROVED),
    ]
    base, early, late, improved = evaluation.walk(groups, case, starts=STARTS, duration=6.0)
    assert base.error.mean() > 0.4
    assert early.error.mean() < 0.3
    assert late.error.mean() < 0.2  # the paper's figure
    assert improved.error.mean() < 0.2
    assert not any(found.fallen.any() for found in (early, late, improved))
    assert late.estimate.mean() > 1.0


def test_phases_for_the_choice_are_not_those_of_the_test():
    chosen, tested = evaluation.phases(validation=True), evaluation.phases()
    assert np.abs(chosen[:, None] - tested).min() > 0.3


@pytest.mark.parametrize("groups", [[], [evaluation.Group(shipped("base"))]])
def test_nothing_to_walk(groups):
    with pytest.raises(ValueError, match="at least one group"):
        evaluation.walk(groups, [])


def test_environment_repeats_and_randomises_within_the_table():
    table = params.params().randomisation
    rewards = []
    for _ in range(2):
        walk = environment.Walk(8, None, seed=3)
        rewards.append([walk.step(np.zeros((8, 12))).reward for _ in range(5)])
    assert np.array_equal(rewards[0], rewards[1])
    assert np.all((walk.payload >= table.payload[0]) & (walk.payload <= table.payload[1]))
    assert np.all((walk.friction >= table.friction[0]) & (walk.friction <= table.friction[1]))
    assert np.ptp(walk.loop.kp) > 1.0
    with pytest.raises(ValueError, match="a state of 8 environments, expected 2"):
        environment.Walk(2, None, seed=0).restore(walk.state())


def _need_training() -> None:
    for name in ("torch", "rsl_rl"):
        pytest.importorskip(name, reason=f"{name} is not installed: nothing is trained")


def tiny(iterations: int, **changes: object) -> training.Training:
    given = {"seed": 5, "choice": loop.paper_filter(), "iterations": iterations, "environments": 4}
    return training.Training(**(given | changes))


# The library's dependencies warn about one another when they are imported.
@pytest.mark.filterwarnings("default")
def test_resumed_training_equals_an_uninterrupted_one(tmp_path: Path):
    _need_training()
    whole = training.train(training.Trainer(tiny(4)))
    checkpoint = tmp_path / "half.npz"
    training.train(training.Trainer(tiny(2)), checkpoint=checkpoint)
    resumed = training.train(training.Trainer(tiny(4)), checkpoint=checkpoint)
    assert resumed.record["iterations"] == 4
    assert resumed.record["reward"] == whole.record["reward"]
    for first, second in zip(whole.layers, resumed.layers, strict=True):
        assert np.array_equal(first[0], second[0])
        assert np.array_equal(first[1], second[1])
    with pytest.raises(ValueError, match="a checkpoint of another training: seed 5, not 6"):
        training.train(training.Trainer(tiny(4, seed=6)), checkpoint=checkpoint)
    (tmp_path / "no.npz").write_bytes(b"nothing")
    with pytest.raises(ValueError, match="no checkpoint"):
        training.train(training.Trainer(tiny(4)), checkpoint=tmp_path / "no.npz")


@pytest.mark.filterwarnings("default")
def test_policy_is_the_network_that_was_trained():
    _need_training()
    import torch

    trainer = training.Trainer(tiny(1, choice=None))
    trainer.iterate()
    seen = np.random.default_rng(0).normal(size=(6, policy.OBSERVATIONS))
    actor = trainer._algorithm.actor.eval()
    with torch.no_grad():
        wanted = actor(trainer._tensors(seen, np.zeros((6, environment.PRIVILEGED)))).numpy()
    assert trainer.policy()(seen) == pytest.approx(wanted, abs=SINGLE)


@pytest.mark.filterwarnings("default")
def test_train_and_judge_from_the_command_line(tmp_path: Path, capsys):
    _need_training()
    out = tmp_path / "own.json"
    arguments = ["run", "quadruped", "--quiet", "--train", "--filter", "--iterations", "1", "--out", str(out)]
    assert main(arguments) == 0
    assert "3072 steps" in capsys.readouterr().out
    target = tmp_path / "figures.json"
    judge = ["--policy", str(out), "--quick", "--payload", "0", "--speed", "0.5", "--terrain", "none"]
    assert main(["run", "quadruped", "--quiet", "--picture", "none", "--json", str(target), *judge]) == 0
    figures = json.loads(target.read_text())
    assert {"base", "filter", "own", "own_off"} <= set(figures["methods"])
    assert "own policy, filter off" in capsys.readouterr().out


def test_report_picture_and_figures(tmp_path: Path, capsys):
    target, picture = tmp_path / "figures.json", tmp_path / "figure.png"
    arguments = [
        "--quick",
        "--payload",
        "0.6",
        "--speed",
        "0.5",
        "--terrain",
        "gravel",
        "--difficulty",
        "0.2",
    ]
    assert (
        main(["run", "quadruped", "--quiet", "--json", str(target), "--picture", str(picture), *arguments])
        == 0
    )
    text, figures = capsys.readouterr().out, json.loads(target.read_text())
    assert "paper, 60 % payload: at most 0.2 m/s" in text
    assert "mean over 2 grounds with 95 % of these policies" in text
    assert np.shape(figures["methods"]["filter"]["terrain_success_by_walk"]["gravel"]) == (1, 1, 2)
    assert picture.stat().st_size > 10_000
    assert figures["methods"]["filter"]["payload_error"][0] < figures["methods"]["base"]["payload_error"][0]
    assert figures["methods"]["filter"]["terrain_success"]["gravel"] == [1.0]
    assert set(figures["steps_per_second"]) == {"robots", "mujoco", "loop", "filter"}


def test_each_random_ground_is_walked_on_once():
    """Walks are counted by ground, not by phases on one ground."""
    plan = comparison.Plan(("base",), (0,), 2, (0.0,), (1.0,), (0.8,), 2.0, ("rough",), grounds=2)
    both = comparison.score({"base": methods.METHODS["base"]}, plan)["base"].terrain["rough"]
    assert both.shape == (1, 1, 2)
    with pytest.raises(ValueError, match="grounds: expected at least 1, got 0"):
        replace(plan, grounds=0)


def test_intervals_are_over_grounds():
    values = np.array([0.0, 0.0, 1.0, 1.0])
    low, high = report.mean_interval(values)
    assert low == pytest.approx(0.0)
    assert high == pytest.approx(1.0)
    many = report.mean_interval(np.repeat(values, 25))
    # 1.96 sqrt(1/4/100) about 1/2; the bootstrap's grid and draws are within 0.01.
    assert many == pytest.approx((0.402, 0.598), abs=0.015)


@pytest.mark.usefixtures("flawless")
def test_stance_from_the_command_line(tmp_path: Path, capsys):
    target, picture = tmp_path / "stance.json", tmp_path / "stance.png"
    assert main(["run", "quadruped", "--stance", "--json", str(target), "--picture", str(picture)]) == 0
    assert "largest pole that stands" in capsys.readouterr().out
    assert json.loads(target.read_text())
    assert picture.stat().st_size > 10_000


def test_animation_without_a_renderer(tmp_path: Path):
    from PIL import Image

    animation = importlib.import_module(f"{ROOM}.animation")
    [found] = evaluation.walk(
        [evaluation.Group(shipped("filter"))], [evaluation.Case()], starts=STARTS[:1], duration=0.4
    )
    how = animation.animate(tmp_path / "a.gif", [found.trace.qpos[:, 0]], renderer=False)
    assert how.startswith("line drawing")
    with Image.open(tmp_path / "a.gif") as image:
        assert image.n_frames == 5
