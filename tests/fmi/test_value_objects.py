"""What is chosen once for several calls about FMUs: wrong values are named, and what 0.2 wrote still works."""

from __future__ import annotations

import gc
from dataclasses import FrozenInstanceError, replace
from pathlib import Path

import control as ct
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl import fmi
from phyfilter_ctl.fmi import (
    Fmu,
    FmuExperiment,
    FmuPorts,
    FmuSolver,
    Master,
    System,
    Wire,
    check,
    cosimulate,
    cut_diagram,
    describe,
    import_fmu,
    read_ssp,
    replay,
    write_ssp,
)
from phyfilter_ctl.fmi.mujoco import export_mujoco_fmu
from phyfilter_ctl.fmi.unpacked import UnpackedFmu
from phyfilter_ctl.migrate import migrated

F = pf.PhyFilter([400.0, 40.0])
PARTS = {"parts": {"a": "a.fmu"}}


@pytest.mark.parametrize(
    ("kind", "given", "error", "message"),
    [
        (FmuExperiment, {"start": 1.0, "stop": 0.5}, ValueError, "start < stop, got 1.0 and 0.5"),
        (FmuExperiment, {"stop": float("nan")}, ValueError, "stop: expected a finite number"),
        (FmuExperiment, {"step": 0.0}, ValueError, "step and tolerance above 0"),
        (FmuExperiment, {"tolerance": "fine"}, TypeError, "tolerance: expected a number, got 'fine'"),
        (
            FmuExperiment,
            {"solver": "rk4"},
            TypeError,
            r"solver: expected FmuSolver\(method, step\), got 'rk4'",
        ),
        (FmuExperiment, {"author": 3}, TypeError, "author: expected text, got 3"),
        (Fmu, {"path": 3.0}, TypeError, "path: expected an FMU file, got 3.0"),
        (Fmu, {"path": "a", "parameters": ["k"]}, TypeError, "parameters: expected {name: value}, got "),
        (
            Fmu,
            {"path": "a", "outputs": "x"},
            TypeError,
            "outputs: expected a list of names or patterns, got 'x'",
        ),
        (Fmu, {"path": "a", "clocks": {1: 2.0}}, TypeError, "clocks: expected {clock: seconds}"),
        (Fmu, {"path": "a", "tolerance": 0.0}, ValueError, "tolerance: expected a finite number > 0"),
        (Fmu, {"path": "a", "isolated": 5.0}, TypeError, "isolated: expected True, False or Isolation"),
        (Fmu, {"path": "a", "limits": 10}, TypeError, "limits: expected ArchiveLimits"),
        (Master, {"step": 0.0}, ValueError, "step: expected seconds > 0, got 0.0"),
        (Master, {"step": "short"}, TypeError, "step: expected a number, got 'short'"),
        (
            Master,
            {"scheme": "newton"},
            ValueError,
            'scheme: expected "jacobi" or "gauss-seidel", got \'newton\'',
        ),
        (Master, {"hold": "second"}, ValueError, 'hold: expected "zero" or "first"'),
        (
            Master,
            {"scheme": "gauss-seidel", "order": "ab"},
            TypeError,
            "order: expected names of parts, got 'ab'",
        ),
        (Master, {"order": ["a", "b"]}, ValueError, 'order: means nothing to scheme="jacobi"'),
        (Master, {"tolerance": -1e-3}, ValueError, "tolerance: expected a number > 0"),
        (
            Master,
            {"absolute_tolerance": 1e-3},
            ValueError,
            "absolute_tolerance: means nothing without tolerance",
        ),
        (Master, {"threads": 0}, ValueError, "threads: expected at least 1, got 0"),
        (Master, {"intermediate": 1}, ValueError, "intermediate: expected True or False, got 1"),
        (System, {"parts": {}}, ValueError, "parts: expected at least one"),
        (System, {"parts": ["a.fmu"]}, TypeError, "parts: expected a dict by name"),
        (
            System,
            {"parts": {"a": 3.0}},
            TypeError,
            "a: expected an FMU file, an imported FMU or a python-control",
        ),
        (
            System,
            PARTS | {"connections": ["a.u"]},
            ValueError,
            r"connections: expected \(.part.input., .part.output.",
        ),
        (
            System,
            PARTS | {"inputs": {"r": [1]}},
            TypeError,
            r"inputs: 'r': expected \[.part.input., \.\.\.\], got",
        ),
        (System, PARTS | {"outputs": {"y": ["a.y"]}}, TypeError, "outputs: 'y': expected \"part.output\""),
        (System, PARTS | {"parameters": {"b.k": 1.0}}, ValueError, "parameters: 'b.k' names no part"),
        (
            System,
            PARTS | {"units": "guess"},
            ValueError,
            "units: expected one of raise, convert, warn, ignore",
        ),
        (FmuPorts, {"channels": 0}, ValueError, "channels: expected at least 1, got 0"),
        (FmuPorts, {"inertia": "round"}, ValueError, "inertia: expected one of scalar, diagonal, full"),
        (FmuPorts, {"units": {"y": "m"}}, ValueError, "units: expected units of x, g, f"),
        (FmuPorts, {"max_channels": 2.5}, TypeError, "max_channels: expected a whole number, got 2.5"),
        (FmuPorts, {"record": "plant.*"}, TypeError, "record: expected a list of patterns"),
        (FmuPorts, {"clocks": "yes"}, ValueError, "clocks: expected True or False, got 'yes'"),
        (FmuPorts, {"xcp": True, "max_channels": 4}, ValueError, "fixed number of channels"),
    ],
)
def test_wrong_values_are_named(kind, given, error, message):
    with pytest.raises(error, match=message):
        kind(**given)


def test_values_compare_and_do_not_change():
    ports = FmuPorts(["u", "v"], inertia=[2.0, 3.0], units={"x": "m/s"}, record=["a.*"])
    assert ports == FmuPorts(("u", "v"), inertia=(2, 3), units={"x": "m/s"}, record=("a.*",))
    assert hash(ports) == hash(replace(ports))
    assert FmuExperiment(stop=2) == FmuExperiment(stop=2.0)
    with pytest.raises(FrozenInstanceError):
        ports.xcp = True


EXPORTS = [
    ("pf.export_fmu(F.sampled(0.01), path, channels=3)", "pf.export_fmu(F.sampled(0.01, channels=3), path)"),
    (
        "pf.export_fmu(F, path, channels=['a', 'b'], inertia=[1.0, 2.0], units={'x': 'm'}, arrays=False)",
        "pf.export_fmu(F, path, ports=pf.fmi.FmuPorts(channels=['a', 'b'], inertia=[1.0, 2.0], units={'x': 'm'}, "
        "arrays=False))",
    ),
    (
        "pf.export_fmu(F, path, solver=FmuSolver(step=1e-4), author='me', max_channels=3)",
        "pf.export_fmu(F, path, ports=pf.fmi.FmuPorts(max_channels=3), "
        "experiment=pf.fmi.FmuExperiment(solver=FmuSolver(step=1e-4), author='me'))",
    ),
    (
        "pf.export_fmu(F.sampled(0.01), path, inertia='full', rate='fixed', clocks=True)",
        "pf.export_fmu(F.sampled(0.01, inertia='full'), path, rate='fixed', ports=pf.fmi.FmuPorts(clocks=True))",
    ),
]


@pytest.mark.parametrize(("old", "new"), EXPORTS)
def test_former_arguments_of_export_warn_work_and_are_rewritten(tmp_path, old, new):
    assert migrated(f"{old}\n") == (f"{new}\n", [])
    assert migrated(f"{new}\n") == (f"{new}\n", [])
    files = {}
    for name, call in (("old", old), ("new", new)):
        text = call.replace("path,", "path, platforms=(),").replace("path)", "path, platforms=())")
        names = {"pf": pf, "F": F, "FmuSolver": FmuSolver, "path": tmp_path / f"{name}.fmu"}
        if name == "old":
            with pytest.warns(DeprecationWarning, match=r"export_fmu\(.*=\.\.\.\) is now") as said:
                eval(text, names)
            assert {each.filename for each in said} == {"<string>"}, "the caller's line, not the library's"
        else:
            eval(text, names)
        files[name] = names["path"].read_bytes()
    assert files["old"] == files["new"]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_former_argument_beside_a_value_object(tmp_path):
    path = pf.export_fmu(
        F, tmp_path / "a.fmu", platforms=(), experiment=FmuExperiment(stop=3.0), author="me", channels=2
    )
    found = describe(path)
    assert (found.stop_time, found.variables[1].labels) == (3.0, ("x[0]", "x[1]"))


def test_former_arguments_of_robots_and_hand_over(tmp_path):
    with (
        pytest.warns(DeprecationWarning, match=r"author=\.\.\.\) is now experiment=fmi.FmuExperiment"),
        pytest.raises((ValueError, ImportError)),
    ):
        export_mujoco_fmu("<mujoco", tmp_path / "a.fmu", author="me")
    hand_over = (
        "from phyfilter_ctl import fmi\nfmi.hand_over(F.sampled(0.01{}), folder, record, name='f'{})\n"
    )
    assert migrated(hand_over.format("", ", channels=2")) == (hand_over.format(", channels=2", ""), [])
    rewritten = migrated(
        "from phyfilter_ctl.fmi import export_mujoco_fmu\n\nexport_mujoco_fmu(xml, p, author='me')\n"
    )
    assert "from phyfilter_ctl.fmi import FmuExperiment\n" in rewritten[0]
    assert "export_mujoco_fmu(xml, p, experiment=FmuExperiment(author='me'))" in rewritten[0]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (
            "import_fmu(path, kind='cs', step=0.1, parameters={'x': 0.5}, outputs=['x'])",
            "import_fmu(Fmu(path, parameters={'x': 0.5}, outputs=['x']), kind='cs', step=0.1)",
        ),
        (
            "import_fmu(path=path, kind='me', isolated=True)",
            "import_fmu(Fmu(path, isolated=True), kind='me')",
        ),
        ("check(path, run=False, isolated=False)", "check(Fmu(path, isolated=False), run=False)"),
    ],
)
def test_what_was_chosen_call_by_call(build, old, new):
    line = "from phyfilter_ctl.fmi import Fmu, check, import_fmu\n{}\n"
    assert migrated(line.format(old)) == (line.format(new), [])
    names = {"path": build(), "Fmu": Fmu, "import_fmu": import_fmu, "check": check}
    with pytest.warns(DeprecationWarning, match=r"\) is now fmi.Fmu\(path, "):
        before = eval(old, names)
    after = eval(new, names)
    if "import_fmu" in old:
        assert (before.output_labels, before.values, before.dt) == (
            after.output_labels,
            after.values,
            after.dt,
        )
        assert (before.source.isolation is None) == (after.source.isolation is None)
    else:
        assert str(before) == str(after)


def test_one_choice_serves_import_cosimulation_and_check(build):
    """x(0) = 0.5 in all of them; check names a parameter that the FMU does not have."""
    chosen = Fmu(build(), parameters={"x": 0.5}, outputs=["x"], tolerance=1e-3, isolated=False)
    times = [0.0, 0.1, 0.2]
    block = import_fmu(chosen, kind="cs", step=0.1)
    assert pf.simulate(block, times).outputs[0] == 0.5
    found = pf.cosimulate({"mass": chosen}, timepts=times)
    assert (found.output_labels, found.outputs[0, 0]) == (["mass.x"], 0.5)
    assert pf.cosimulate({"mass": chosen}, timepts=times, parameters={"mass.x": 0.25}).outputs[0, 0] == 0.25
    assert check(chosen).ok
    with pytest.raises(ValueError, match="no variable with a start value is called stiffness"):
        check(replace(chosen, parameters={"stiffness": 2.0}))
    record = fmi.Reference(np.array(times), {}, {"x": found.outputs[0]})
    assert np.array_equal(replay(chosen, record)[1][:, 0], found.outputs[0])
    unpacked = UnpackedFmu(build())
    with pytest.warns(
        DeprecationWarning, match=r"replay\(UnpackedFmu\(path\), parameters=... is now|replay\(Unpacked"
    ):
        labels, rows = replay(unpacked, record, parameters={"x": 0.5})
    assert (labels, rows[0, 0]) == (("x",), 0.5)


TIMES = np.linspace(0.0, 0.5, 6)
RUNS = [
    (
        "cosimulate(PAIR, WIRES, timepts=TIMES, step=0.05, scheme='gauss-seidel', order=['b', 'a'])",
        "cosimulate(System(PAIR, WIRES), TIMES, master=Master(0.05, scheme='gauss-seidel', order=['b', 'a']))",
    ),
    (
        "cosimulate({'a': PATH}, [], timepts=TIMES, tolerance=1e-3, absolute_tolerance=1e-4, outputs=['a.x'])",
        "cosimulate({'a': PATH}, TIMES, outputs=['a.x'], master=Master(tolerance=1e-3, absolute_tolerance=1e-4))",
    ),
    (
        "cosimulate(PAIR, connections=WIRES, timepts=TIMES, units='ignore', hold='first', threads=1)",
        "cosimulate(System(PAIR, WIRES, units='ignore'), TIMES, master=Master(hold='first', threads=1))",
    ),
    ("cosimulate(parts={'a': PATH}, timepts=TIMES)", "cosimulate({'a': PATH}, TIMES)"),
]


@pytest.mark.parametrize(("old", "new"), RUNS)
def test_former_arguments_of_a_co_simulation(build, old, new):
    line = "from phyfilter_ctl.fmi import Master, System, cosimulate\n{}\n"
    assert migrated(line.format(old)) == (line.format(new), [])
    assert migrated(line.format(new)) == (line.format(new), [])
    names = {"cosimulate": cosimulate, "System": System, "Master": Master, "TIMES": TIMES, "PATH": build()}
    names |= {"PAIR": {"a": build(), "b": build()}, "WIRES": [("a.place", "b.x"), ("b.place", "a.x")]}
    with pytest.warns(DeprecationWarning, match=r"cosimulate\(.*\) is now ") as said:
        before = eval(old, names)
    assert {each.filename for each in said} == {"<string>"}
    after = eval(new, names)
    assert np.array_equal(before.outputs, after.outputs)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_what_was_chosen_of_all_parts_of_a_co_simulation(build):
    old = cosimulate({"a": build()}, timepts=TIMES, isolated=True, limits=None)
    new = cosimulate({"a": Fmu(build(), isolated=True)}, TIMES)
    assert np.array_equal(old.outputs, new.outputs)
    assert old.master == new.master == "Python: no part that C runs"
    with pytest.raises(ValueError, match=r"clocks: 'b\.tick' names no part; expected part\.clock, of"):
        cosimulate({"a": build()}, timepts=TIMES, clocks={"b.tick": 0.1})
    text = "cosimulate(parts, timepts=t, isolated=True)\n"
    assert migrated(f"from phyfilter_ctl.fmi import cosimulate\n{text}")[1] == [
        "line 2: cosimulate(isolated=...): docs/migration.md says"
    ]


def test_former_arguments_of_packages(build, tmp_path):
    """0.2 gave files, wires and ends one by one; a package took further wires, and limits of all its FMUs."""
    fmus, wires = {"a": build(), "b": build()}, [Wire("a.place", "b.x")]
    ends = {"inputs": {"where": ["b.place"]}, "outputs": {"y": "a.x"}, "parameters": {"b.k": 20.0}}
    new = write_ssp(System(fmus, wires, **ends), tmp_path / "new.ssp", name="pair", stop_time=1.0)
    with pytest.warns(
        DeprecationWarning, match=r"write_ssp\(path, fmus, wires\) is now write_ssp\(fmi.System"
    ):
        old = write_ssp(tmp_path / "old.ssp", fmus, wires, name="pair", stop_time=1.0, **ends)
    assert old.read_bytes() == new.read_bytes()
    line = "from phyfilter_ctl.fmi import System, write_ssp\n{}\n"
    assert migrated(line.format("write_ssp(path, fmus, wires, name='s', outputs=o)")) == (
        line.format("write_ssp(System(fmus, wires, outputs=o), path, name='s')"),
        [],
    )
    system = read_ssp(new)
    closed = replace(system, connections=[*system.connections, Wire("b.place", "a.x")], inputs={})
    with pytest.warns(DeprecationWarning, match="cosimulate"):
        before = cosimulate(new, [("b.place", "a.x")], timepts=TIMES, isolated=False, outputs=["y"])
    assert np.array_equal(before.outputs, cosimulate(closed, TIMES, outputs=["y"]).outputs)


def test_a_cut_diagram_had_a_class_of_its_own():
    loop = ct.interconnect(
        [ct.ss(-1.0, 1.0, 1.0, 0.0, inputs="u", outputs="y", name=name) for name in "ab"],
        connections=[["a.u", "-b.y"], ["b.u", "a.y"]],
        inplist=["a.u"],
        inputs=["r"],
        outlist=["a.y"],
        outputs=["y"],
    )
    cut = cut_diagram(loop)
    with pytest.warns(DeprecationWarning, match=r"System\.wires is now connections"):
        assert cut.wires == cut.connections
    with pytest.warns(DeprecationWarning, match="CutDiagram is now System"):
        former = fmi.CutDiagram(cut.parts, cut.connections, cut.inputs, cut.outputs)
    assert isinstance(former, System)


def test_a_package_as_a_system(build, tmp_path):
    """Read, changed, run, and written again; its files last as long as one of its parts does."""
    fmus = {"a": Fmu(build(), parameters={"k": 30.0}), "b": build()}
    pair = System(fmus, [("a.place", "-b.x"), Wire("b.place", "a.x", gain=2.0)], outputs={"y": "a.x"})
    found = read_ssp(write_ssp(pair, tmp_path / "pair.ssp"), isolated=False)
    assert [(w.sink, w.source, w.gain) for w in found.connections] == [
        ("a.place", "b.x", -1.0), ("b.place", "a.x", 2.0)
    ]  # fmt: skip
    assert (found.parameters["a.k"], found.parameters["b.k"], found.outputs) == (30.0, 8.0, {"y": "a.x"})
    given = {"initial_state": {}, "parameters": {"a.x": 0.3}}
    ours, theirs = (cosimulate(each, TIMES, outputs=["a.x", "b.x"], **given) for each in (pair, found))
    assert np.array_equal(ours.outputs, theirs.outputs)
    again = write_ssp(found, tmp_path / "again.ssp")
    assert np.array_equal(cosimulate(again, TIMES, outputs=["a.x", "b.x"], **given).outputs, ours.outputs)
    part, file = found.parts["a"], Path(found.parts["a"].path)
    del found
    gc.collect()
    assert file.is_file()
    changed = replace(part, isolated=True)
    del part
    gc.collect()
    assert file.is_file(), "a part with other choices keeps its file"
    del changed
    gc.collect()
    assert not file.exists()


def test_systems_that_cannot_be_written(build, tmp_path):
    block = ct.ss(-1.0, 1.0, 1.0, 0.0, inputs="u", outputs="y", name="a")
    with pytest.raises(TypeError, match="a: expected an FMU file, got StateSpace; export_fmu writes one"):
        write_ssp(System({"a": block}), tmp_path / "a.ssp")
    scaled = System({"a": build()}, inputs={"w": Wire("a.place", "", gain=2.0)})
    with pytest.raises(ValueError, match="an input with a gain or an offset needs a connector"):
        write_ssp(scaled, tmp_path / "a.ssp", system_connectors=False)
    run = cosimulate(
        read_ssp(write_ssp(scaled, tmp_path / "a.ssp")), TIMES, inputs={"w": 0.1}, outputs=["a.x"]
    )
    assert np.array_equal(
        run.outputs, cosimulate({"a": build()}, TIMES, inputs={"a.place": 0.2}, outputs=["a.x"]).outputs
    )
    with pytest.raises(TypeError, match="system: expected System"):
        cosimulate(3.0, TIMES)
