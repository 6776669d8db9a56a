"""Robot and joint loop as FMUs: their walk against the one in a process, on flat ground and on others."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phyfilter_ctl import models, simulate
from phyfilter_ctl.codegen import CompilerError, find_compiler
from phyfilter_ctl.fmi import describe

mujoco = pytest.importorskip("mujoco", reason="needs the extra mujoco: pip install 'phyfilter-ctl[mujoco]'")
try:
    find_compiler()
except CompilerError:
    pytest.skip("needs a C compiler", allow_module_level=True)
if not sys.platform.startswith("linux"):
    pytest.skip("FMUs with MuJoCo are made on Linux", allow_module_level=True)

ROOM = f"{models.__name__}.quadruped"
batch = importlib.import_module(f"{ROOM}.batch")
cosimulation = importlib.import_module(f"{ROOM}.cosimulation")
gait = importlib.import_module(f"{ROOM}.gait")
handover = importlib.import_module(f"{ROOM}.handover")
params = importlib.import_module(f"{ROOM}.params").params
terrain = importlib.import_module(f"{ROOM}.terrain")

# Sums in another order, of torques up to 36 N m: some units of 7e-15.
ROUNDING = 1e-12
# The same in the loop over hundreds of contacts: 1e-14 rad was seen, chaos would be far above.
IN_THE_LOOP = 1e-9


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Path]:
    folder = tmp_path_factory.mktemp("walk")
    return cosimulation.cosimulation(duration=2.0, folder=folder), folder


def test_two_fmus_walk_as_the_process_does(walk: tuple[Any, Path]) -> None:
    found, _ = walk
    assert found.steps == 400
    assert found.distance > 0.2  # a walk, of 0.5 m/s after a second
    assert 1.0 < found.f_hat < params().filter.limit  # the filter works, below its limit
    assert found.robot == 0.0
    assert found.torque < ROUNDING
    assert found.estimate < ROUNDING
    assert found.loop < IN_THE_LOOP
    assert 2e6 < found.sizes["robot"] < 8e6
    assert all(value > 0.0 for value in found.seconds.values())


def test_what_is_printed(walk: tuple[Any, Path]) -> None:
    found, _ = walk
    text = cosimulation.table(found)
    for words in ("to the bit", "400 steps", "FMI 3.0"):
        assert words in text
    assert all(len(line) < 160 for line in text.splitlines())
    figures = cosimulation.figures(found)
    assert figures["robot_max_abs_difference"] == 0.0
    assert figures["steps"] == 400


def test_wires_fit(walk: tuple[Any, Path]) -> None:
    _, folder = walk
    robot, loop = describe(folder / "quadruped.fmu"), describe(folder / "joint_loop.fmu")
    inputs = [label for entry in loop.of("input") for label in entry.labels]
    assert inputs == [f"{name}[{i}]" for name in ("target", "q", "qd") for i in range(12)]
    legs, joints = ("FL", "FR", "HL", "HR"), ("abduction", "hip", "knee")
    assert [entry.name for entry in robot.of("input")] == [
        *(f"ctrl.{leg}_{joint}" for leg in legs for joint in joints),
        "force",
    ]
    units = {entry.name: entry.unit for entry in (*robot.variables, *loop.variables)}
    assert {units[name] for name in ("torque", "f_hat", "ctrl.HR_knee")} == {"N m"}
    starts = {entry.name: entry.starts for entry in robot.of("parameter")}
    assert starts["start.base.position"][2] == pytest.approx(
        params().gait.height + params().robot.foot_radius
    )


def test_joint_loop_in_a_diagram_holds_its_target() -> None:
    """Without FMUs: standing still, the law alone gives torque; with q at the target and at rest there is none."""
    system = handover.joint_loop_system()
    held = np.concatenate([gait.neutral(), gait.neutral(), np.zeros(12)])
    response = simulate(system, np.linspace(0.0, 0.02, 5), np.outer(held, np.ones(5)))
    np.testing.assert_allclose(response.outputs, 0.0, atol=ROUNDING)


def test_terrain_and_its_friction_are_those_of_the_batch() -> None:
    ground = terrain.Terrain("gravel", 0.5)
    several = batch.Batch(1, terrain=ground, threads=1)
    model = mujoco.MjModel.from_xml_string(handover.robot_xml(ground))
    feet = [model.geom(f"{leg}_foot").id for leg in ("FL", "FR", "HL", "HR")]
    np.testing.assert_array_equal(several._friction[0, feet, 0], model.geom_friction[feet, 0])
    plain = mujoco.MjModel.from_xml_string(handover.robot_xml())
    assert model.geom_friction[feet[0], 0] < plain.geom_friction[feet[0], 0]


def test_robot_on_gravel_is_an_fmu_too(tmp_path: Path) -> None:
    path = handover.quadruped_fmu(tmp_path / "gravel.fmu", terrain=terrain.Terrain("gravel", 0.5), fmi="2.0")
    assert describe(path).step == params().control.dt


@pytest.mark.parametrize("duration", [0.0, -1.0, 0.01, float("nan")])
def test_durations_that_are_too_short(duration: float) -> None:
    with pytest.raises(ValueError, match=r"duration: expected at least 0\.02 s"):
        cosimulation.cosimulation(duration=duration)


def test_policy_that_is_not_there() -> None:
    with pytest.raises(ValueError, match="no policy 'nobody'"):
        cosimulation.cosimulation(policy="nobody")
