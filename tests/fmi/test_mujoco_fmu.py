"""FMUs with MuJoCo inside: the same physics to the bit, states, threads, refused steps, errors that are caught."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import fmpy
import numpy as np
import pytest
from exported_fmus import quick_compiler

from phyfilter_ctl.codegen import CompilerError, find_compiler
from phyfilter_ctl.fmi import FmuError, check, describe
from phyfilter_ctl.fmi.instance import FmuInstance
from phyfilter_ctl.fmi.mujoco import export_mujoco_fmu
from phyfilter_ctl.fmi.unpacked import UnpackedFmu

mujoco = pytest.importorskip("mujoco", reason="needs the extra mujoco: pip install 'phyfilter-ctl[mujoco]'")
try:
    find_compiler()
except CompilerError:
    pytest.skip("needs a C compiler", allow_module_level=True)
if not sys.platform.startswith("linux"):
    pytest.skip("FMUs with MuJoCo are made on Linux", allow_module_level=True)

H = 0.002
STEPS = 600
DESK = f"""
<mujoco model="desk"><option timestep="{H}" integrator="implicitfast"/>
<worldbody><geom type="plane" size="0 0 1"/>
<body name="box" pos="0 0 .06"><freejoint name="base"/>
<geom type="box" size=".1 .08 .05" mass="1"/><site name="top"/></body>
<body pos="1 0 1"><joint name="elbow" axis="0 1 0" damping=".1"/>
<geom type="capsule" fromto="0 0 0 .4 0 0" size=".03" mass=".5"/>
<body pos=".4 0 0"><joint name="left rail" type="slide" axis="1 0 0" stiffness="50" damping="1"/>
<geom size=".04" mass=".2"/>
<body pos="0 0 -.1"><joint name="wrist" type="ball" damping=".01"/>
<geom type="capsule" fromto="0 0 0 0 0 -.1" size=".02" mass=".1"/></body></body></body></worldbody>
<actuator><motor name="turn" joint="elbow"/><position joint="elbow" kp="5"/>
<general name="lag" joint="left rail" dyntype="filter" dynprm=".05" gainprm="2"/></actuator>
<sensor><accelerometer name="imu" site="top"/><framequat objtype="body" objname="box"/>
<jointpos name="angle" joint="elbow"/>
</sensor></mujoco>"""
VERSIONS = ("2.0", "3.0")
QUICK = quick_compiler()
N_INPUTS, N_Q = 6, 13


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, UnpackedFmu]]:
    folder = tmp_path_factory.mktemp("mujoco")
    paths = {
        v: export_mujoco_fmu(DESK, folder / f"desk{v[0]}.fmu", fmi=v, body="box", compiler=QUICK)
        for v in VERSIONS
    }
    found = {version: UnpackedFmu(path) for version, path in paths.items()}
    yield found
    for fmu in found.values():
        fmu.close()


class Running:
    def __init__(self, fmu: UnpackedFmu, values: dict[str, float] | None = None) -> None:
        self.instance = FmuInstance(fmu, "cs", "desk")
        self.inputs, self.outputs = self.instance.signals("input"), self.instance.signals("output")
        self.k = 0
        self.instance.initialise(0.0, values=values or {})
        self.instance.begin()

    def step(self, u: np.ndarray, h: float = H) -> np.ndarray:
        self.inputs.write(self.instance, u)
        self.instance.do_step(self.k * H, h)
        self.k += round(h / H)
        return self.read()

    def read(self) -> np.ndarray:
        return self.outputs.read(self.instance)


def drive(steps: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.0, 2.0, (steps, N_INPUTS))


def simulated(u: np.ndarray, start: np.ndarray | None = None, *, held: int = 1) -> np.ndarray:
    """Positions, velocities and sensors after every row of inputs, from MuJoCo's own bindings."""
    model = mujoco.MjModel.from_xml_string(DESK)
    data = mujoco.MjData(model)
    if start is not None:
        data.qpos[:] = start
    rows = []
    for row in u:
        data.ctrl[:] = row[:3]
        data.xfrc_applied[1, :3] = row[3:]
        for _ in range(held):
            mujoco.mj_step(model, data)
        rows.append(np.concatenate([data.qpos, data.qvel, data.sensordata]))
    return np.array(rows)


@pytest.mark.parametrize("version", VERSIONS)
def test_run_is_that_of_mujoco_to_the_bit(fmus: dict[str, UnpackedFmu], version: str) -> None:
    u = drive(STEPS)
    running = Running(fmus[version])
    expected = simulated(u)
    assert np.ptp(expected[:, 2]) > 1e-3  # the box was moved, in contact
    np.testing.assert_array_equal([running.step(row) for row in u], expected)
    running.instance.close()


def test_one_communication_step_makes_several_timesteps(fmus: dict[str, UnpackedFmu]) -> None:
    u = drive(20)
    running = Running(fmus["3.0"])
    np.testing.assert_array_equal([running.step(row, 5 * H) for row in u], simulated(u, held=5))


def test_start_positions_are_parameters_of_the_start(fmus: dict[str, UnpackedFmu]) -> None:
    running = Running(fmus["2.0"], {"start.elbow": 0.5, "start.base.position[2]": 0.4})
    start = mujoco.MjModel.from_xml_string(DESK).qpos0
    start[[2, 7]] = 0.4, 0.5
    np.testing.assert_array_equal(running.read()[:N_Q], start)
    u = drive(50)
    np.testing.assert_array_equal([running.step(row) for row in u], simulated(u, start))
    with pytest.raises(FmuError, match="cannot be set now"):
        running.instance.set_values({"start.elbow": 0.0})


def test_names_units_and_kinds(fmus: dict[str, UnpackedFmu]) -> None:
    found = fmus["2.0"].description
    units = {entry.name: entry.unit for entry in found.variables}
    expected = {
        "ctrl.turn": "N m", "ctrl.actuator1": "rad", "ctrl.lag": "", "force[2]": "N",
        "qpos.base.position[0]": "m", "qpos.base.quaternion[3]": "1", "qpos.elbow": "rad", "qpos.joint2": "m",
        "qpos.wrist.quaternion[0]": "1", "qvel.base.velocity[1]": "m/s", "qvel.base.rate[2]": "rad/s",
        "qvel.elbow": "rad/s", "qvel.joint2": "m/s", "qvel.wrist.rate[2]": "rad/s", "sensor.imu[2]": "m/s^2",
        "sensor.sensor1[3]": "1", "sensor.angle": "rad", "start.joint2": "m",
    }  # fmt: skip
    assert expected.items() <= units.items()
    assert {entry.variability for entry in found.of("parameter")} == {"fixed"}
    assert (
        next(e.description for e in found.variables if e.name == "qpos.joint2")
        == "Position of joint left rail"
    )
    assert set(found.kinds) == {"cs"}
    assert fmus["3.0"].description.kinds["cs"].fixed_step == H


def test_state_saved_and_put_back(fmus: dict[str, UnpackedFmu]) -> None:
    u = drive(200)
    for fmu in fmus.values():
        running = Running(fmu)
        for row in u[:100]:
            running.step(row)
        state = running.instance.save()
        first = np.array([running.step(row) for row in u[100:]])
        running.instance.restore(state)
        running.k = 100
        np.testing.assert_array_equal([running.step(row) for row in u[100:]], first)
        np.testing.assert_array_equal(first, simulated(u)[100:])


def test_two_instances_take_turns(fmus: dict[str, UnpackedFmu]) -> None:
    drives = drive(100, 1), drive(100, 2)
    pair = [Running(fmus["3.0"]), Running(fmus["3.0"])]
    rows = np.array([[one.step(u[k]) for one, u in zip(pair, drives, strict=True)] for k in range(100)])
    for i, u in enumerate(drives):
        np.testing.assert_array_equal(rows[:, i], simulated(u))


def test_instances_in_threads(fmus: dict[str, UnpackedFmu]) -> None:
    # FMI 3: its importer's log function is not shared by the instances of a process.
    drives = [drive(150, seed) for seed in range(4)]
    several = [Running(fmus["3.0"]) for _ in drives]
    with ThreadPoolExecutor(4) as pool:
        runs = list(
            pool.map(lambda pair: [pair[0].step(row) for row in pair[1]], zip(several, drives, strict=True))
        )
    for rows, u in zip(runs, drives, strict=True):
        np.testing.assert_array_equal(rows, simulated(u))


@pytest.mark.parametrize("h", [0.5 * H, 1.5 * H, 1e-9, 1e5])
def test_step_that_is_no_multiple_is_refused_and_changes_nothing(
    fmus: dict[str, UnpackedFmu], h: float
) -> None:
    running, u = Running(fmus["3.0"]), drive(20)
    before = [running.step(row) for row in u[:10]]
    with pytest.raises(FmuError, match=r"(whole number|at most 1e7).*timesteps of 0\.002 s"):
        running.step(u[10], h)
    np.testing.assert_array_equal([*before, *(running.step(row) for row in u[10:])], simulated(u))


def test_divergence_is_a_discarded_step(
    fmus: dict[str, UnpackedFmu], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    running, u = Running(fmus["2.0"]), drive(20)
    before = [running.step(row) for row in u[:10]]
    huge = np.zeros(N_INPUTS)
    huge[3] = 1e200
    with pytest.raises(FmuError, match="not finite or beyond 1e10: the simulation is unstable") as caught:
        running.step(huge, 3 * H)
    assert caught.value.status == "discard"
    with pytest.raises(FmuError, match=r"input 'ctrl\.turn' is not finite"):
        running.step(np.full(N_INPUTS, np.nan))
    np.testing.assert_array_equal([*before, *(running.step(row) for row in u[10:])], simulated(u))
    assert not list(tmp_path.iterdir())  # MuJoCo's log file


@pytest.mark.parametrize(
    ("memory", "words"), [(10000, "MuJoCo: mj_stackAlloc: out of memory"), (6000, "no memory for all")]
)
def test_an_error_of_mujoco_does_not_end_the_process(tmp_path: Path, memory: int, words: str) -> None:
    cramped = DESK.replace("<worldbody>", f'<size memory="{memory}"/><worldbody>')
    fmu = UnpackedFmu(export_mujoco_fmu(cramped, tmp_path / "cramped.fmu", name="cramped", compiler=QUICK))
    u = np.zeros((40, N_INPUTS))
    expected = simulated(u[:10])
    try:
        for _ in range(2):  # the box comes down onto the table after some steps; a new instance starts afresh
            running = Running(fmu)
            np.testing.assert_array_equal([running.step(row) for row in u[:10]], expected)
            with pytest.raises(FmuError, match=words) as caught:
                _ = [running.step(row) for row in u[10:]]
            assert caught.value.status == "discard"
    finally:
        fmu.close()
    # The bindings of this process still hear their own errors.
    with pytest.raises((mujoco.FatalError, ValueError), match="out of memory"):
        mujoco.MjModel.from_xml_string(DESK.replace("<worldbody>", '<size memory="600"/><worldbody>'))


ALONE = """
import sys
import numpy as np
from fmpy import fmi2, read_model_description
folder, h = sys.argv[1], float(sys.argv[3])
found = read_model_description(folder)
one = fmi2.FMU2Slave(guid=found.guid, unzipDirectory=folder, modelIdentifier="desk", instanceName="alone")
one.instantiate()
one.setupExperiment(startTime=0.0)
one.enterInitializationMode()
one.exitInitializationMode()
inputs, outputs = (
    [v.valueReference for v in found.modelVariables if v.causality == kind] for kind in ("input", "output")
)
rows = []
for k, row in enumerate(np.load(sys.argv[2])):
    one.setReal(inputs, row.tolist())
    one.doStep(k * h, h)
    rows.append(one.getReal(outputs))
assert "mujoco" not in sys.modules
maps = [line.split()[-1] for line in open("/proc/self/maps") if "libmujoco" in line]
assert maps and all(entry.startswith(folder) for entry in maps), maps
np.save(sys.argv[4], rows)
"""


def test_library_inside_is_the_one_that_runs(fmus: dict[str, UnpackedFmu], tmp_path: Path) -> None:
    u = drive(100)
    np.save(tmp_path / "u.npy", u)
    script = tmp_path / "alone.py"
    script.write_text(ALONE, encoding="utf-8")
    arguments = [str(fmus["2.0"].folder), str(tmp_path / "u.npy"), str(H), str(tmp_path / "y.npy")]
    environment = {key: value for key, value in os.environ.items() if key != "LD_LIBRARY_PATH"}
    command = [sys.executable, str(script), *arguments]
    run = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=60, check=False)
    assert run.returncode == 0, run.stderr
    np.testing.assert_array_equal(np.load(tmp_path / "y.npy"), simulated(u))


@pytest.mark.parametrize("version", VERSIONS)
def test_checks_and_runs_in_fmpy(fmus: dict[str, UnpackedFmu], version: str) -> None:
    path = str(fmus[version].description.path)
    report = check(path)
    assert report.ok, str(report)
    # FMPy has no arrays of one quaternion and one position as one column: the joint alone.
    result = fmpy.simulate_fmu(path, stop_time=0.1, output_interval=H, output=["qpos.elbow", "qvel.elbow"])
    expected = simulated(np.zeros((50, N_INPUTS)))
    np.testing.assert_array_equal(result["qpos.elbow"][1:], expected[:, 7])
    np.testing.assert_array_equal(result["qvel.elbow"][1:], expected[:, N_Q + 6])


def test_what_is_inside(fmus: dict[str, UnpackedFmu]) -> None:
    with zipfile.ZipFile(fmus["2.0"].description.path) as archive:
        names = set(archive.namelist())
        licence = archive.read("documentation/licenses/mujoco_LICENSE").decode()
        page = archive.read("documentation/index.html").decode()
        assert archive.read("documentation/model.xml").decode() == DESK
    assert "Apache License" in licence
    assert "documentation/licenses/license.txt" in names
    assert "cannot be built without MuJoCo" in page
    assert not any(name.startswith("sources/") for name in names)
    assert sum(name.startswith("binaries/") for name in names) == 2


def with_part(part: str) -> str:
    return DESK.replace("<worldbody>", f"{part}<worldbody>")


@pytest.mark.parametrize(
    ("xml", "options", "words"),
    [
        ("<mujoco", {}, "expected MJCF"),
        ("<mujoco><worldbody><geom/></worldbody></mujoco>", {}, "xml: .*size"),
        ("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>", {}, "nothing moves"),
        (with_part('<asset><mesh file="a.stl"/></asset>'), {}, r"<mesh> refers to the file 'a\.stl'"),
        (with_part('<include file="b.xml"/>'), {}, "<include> refers to the file"),
        (with_part('<option><flag sleep="enable"/></option>'), {}, "sleep: expected a model without"),
        (DESK, {"body": "chair"}, "body: expected one of box"),
        (DESK, {"start": [0.0, 1.0]}, "start: expected shape"),
        (DESK, {"name": "my desk"}, "my desk"),
    ],
)
def test_what_cannot_be_exported_says_why(
    tmp_path: Path, xml: str, options: dict[str, object], words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        export_mujoco_fmu(xml, tmp_path / "no.fmu", **options)  # type: ignore[arg-type]  # wrong on purpose
    assert not list(tmp_path.iterdir())


def test_without_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ImportError, match=r"pip install 'phyfilter-ctl\[mujoco\]'"):
        export_mujoco_fmu(DESK, tmp_path / "no.fmu")


def test_other_systems_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    with pytest.raises(CompilerError, match="made on Linux"):
        export_mujoco_fmu(DESK, tmp_path / "no.fmu")


def test_description_of_a_model_without_inputs(tmp_path: Path) -> None:
    ball = (
        '<mujoco model="3 balls"><worldbody><body><freejoint/><geom size="0.1"/></body></worldbody></mujoco>'
    )
    path = export_mujoco_fmu(ball, tmp_path / "ball.fmu", compiler=QUICK)
    found = describe(path)
    assert not found.of("input")
    assert found.of("output")[0].name == "qpos.joint0.position"
    result = fmpy.simulate_fmu(str(path), stop_time=0.1, output_interval=H)
    # Semi-implicit Euler of a fall: z_k = -g h^2 k (k + 1) / 2.
    k = np.arange(51)
    np.testing.assert_allclose(
        result["qpos.joint0.position"][:, 2], -9.81 * H**2 * k * (k + 1) / 2, atol=1e-12
    )


@pytest.mark.slow
def test_control_ranges_are_bounds(tmp_path: Path) -> None:
    """Of controls that rest within them; what has no range has no bounds."""
    motors = '<motor name="a" joint="j" ctrlrange="-2 3"/><motor name="b" joint="j"/>'
    motors += '<motor name="c" joint="j" ctrlrange="1 3"/>'
    body = '<worldbody><body><joint name="j"/><geom size=".1"/></body></worldbody>'
    model = f"<mujoco>{body}<actuator>{motors}</actuator></mujoco>"
    path = export_mujoco_fmu(model, tmp_path / "arm.fmu", compiler=QUICK)
    found = {v.name: (v.min, v.max) for v in fmpy.read_model_description(str(path)).modelVariables}
    expected = {"ctrl.a": ("-2.0", "3.0"), "ctrl.b": (None, None), "ctrl.c": (None, None)}
    assert {name: found[name] for name in expected} == expected
