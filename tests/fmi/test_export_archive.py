"""The archive of an exported FMU: reproducible, rebuildable, and refused in words where it cannot be made."""

import ctypes
import hashlib
import os
import re
import shutil
import subprocess
import sys
import warnings
import zipfile
from dataclasses import replace
from pathlib import Path

import casadi as ca
import control as ct
import fmpy
import numpy as np
import pytest
from exported_fmus import FILTER, PERIOD, Instance, exported, oscillator, quick_compiler, refused
from fmpy.build import build_platform_binary
from fmpy.validation import validate_fmu

import phyfilter_ctl as pf
from phyfilter_ctl._units import unit_definition
from phyfilter_ctl.blocks.functions import BlockFunctions, Variable
from phyfilter_ctl.codegen import CompilerError
from phyfilter_ctl.codegen.diagram_source import diagram_model
from phyfilter_ctl.fmi import FmuPorts
from phyfilter_ctl.fmi.build import build_binaries
from phyfilter_ctl.fmi.description import FmuExperiment, FmuSolver, fmu_interface
from phyfilter_ctl.fmi.description_xml import model_description
from phyfilter_ctl.fmi.export import export_fmu
from phyfilter_ctl.fmi.glue import glue_source

pytestmark = pytest.mark.slow  # the default suite has other tests of the same code

VERSIONS = ("2.0", "3.0")
# Tests that compile: FMI 3.0 stands for both, CI runs both.
BUILT = [pytest.param("2.0", marks=pytest.mark.slow), "3.0"]
LARGEST = 100_000  # bytes: a filter for one platform


def digest(path):
    return hashlib.sha256(path.read_bytes()).hexdigest()


# ---- reproducible ----


@pytest.mark.slow
@pytest.mark.parametrize("fmi", BUILT)
def test_two_builds_are_identical(tmp_path, fmi):
    sampled = FILTER.sampled(PERIOD)
    first = export_fmu(sampled, tmp_path / "a.fmu", fmi=fmi, ports=FmuPorts(channels=3))
    (tmp_path / "elsewhere").mkdir()
    second = export_fmu(sampled, tmp_path / "elsewhere" / "b.fmu", fmi=fmi, ports=FmuPorts(channels=3))
    assert digest(first) == digest(second)
    assert first.stat().st_size < LARGEST
    assert os.listdir(tmp_path / "elsewhere") == ["b.fmu"]  # nothing left behind


@pytest.mark.slow
def test_another_process_builds_the_same(tmp_path):
    code = (
        "import sys, phyfilter_ctl as pf; from phyfilter_ctl.fmi.export import export_fmu;"
        "export_fmu(pf.PhyFilter([400.0, 40.0]), sys.argv[1], platforms=())"
    )
    environment = os.environ | {"PYTHONHASHSEED": "7"}
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "a")], check=True, env=environment)
    assert digest(tmp_path / "a") == digest(export_fmu(FILTER, tmp_path / "b", platforms=()))


def test_date_comes_from_the_environment(tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    path = export_fmu(FILTER, tmp_path / "a.fmu", platforms=())
    description = fmpy.read_model_description(str(path))
    assert description.generationDateAndTime == "2023-11-14T22:13:20Z"
    assert validate_fmu(str(path)) == []


@pytest.mark.slow
def test_token_follows_the_content(tmp_path):
    def token(system, **options):
        path = export_fmu(system, tmp_path / "a.fmu", platforms=(), **options)
        return fmpy.read_model_description(str(path)).guid

    assert token(FILTER) == token(FILTER)
    scalars = token(FILTER, ports=FmuPorts(arrays=False))
    assert len({token(FILTER), token(FILTER.faster(2.0)), scalars, token(FILTER, fmi="2.0")}) == 4


def test_entries_are_sorted_and_without_dates():
    with zipfile.ZipFile(exported("oscillator", "3.0")) as archive:
        infos = archive.infolist()
    assert [info.filename for info in infos] == sorted(info.filename for info in infos)
    assert {info.date_time for info in infos} == {(1980, 1, 1, 0, 0, 0)}


# ---- sources ----


@pytest.mark.slow
@pytest.mark.parametrize("fmi", BUILT)
@pytest.mark.skipif(shutil.which("cmake") is None, reason="cmake is not installed: sources are not rebuilt")
def test_sources_rebuild_with_fmpy(tmp_path, fmi):
    folder = tmp_path / "fmu"
    fmpy.extract(str(exported("oscillator", fmi)), unzipdir=str(folder))
    shutil.rmtree(folder / "binaries")
    (tmp_path / "build").mkdir()
    build_platform_binary(folder, tmp_path / "build")
    rebuilt = fmpy.simulate_fmu(str(folder), stop_time=1.0, output_interval=0.1)
    shipped = fmpy.simulate_fmu(str(exported("oscillator", fmi)), stop_time=1.0, output_interval=0.1)
    np.testing.assert_allclose(rebuilt["place"], shipped["place"], rtol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("fmi", BUILT)
def test_only_the_standards_symbols_are_visible(tmp_path, fmi):
    if shutil.which("nm") is None:
        pytest.skip("nm is not installed: symbols are not listed")
    path = export_fmu(FILTER.sampled(PERIOD), tmp_path / "a.fmu", fmi=fmi)
    fmpy.extract(str(path), unzipdir=str(tmp_path / "u"))
    (library,) = tmp_path.glob("u/binaries/*/*")
    listed = subprocess.run(
        ["nm", "-D", "--defined-only", str(library)], capture_output=True, text=True, check=True
    )
    names = {line.split()[-1] for line in listed.stdout.splitlines()}
    prefix = f"fmi{fmi[0]}"
    assert {name for name in names if not name.startswith(prefix)} == set()
    header = Path(fmpy.__path__[0], "c-code", f"{prefix}Functions.h").read_text()
    declared = set(re.findall(rf"{prefix}FullName\(({prefix}\w+)\)", header))
    assert names == declared


@pytest.mark.slow
@pytest.mark.parametrize("fmi", BUILT)
def test_sources_are_pedantic(tmp_path, fmi):
    for system in (FILTER.sampled(PERIOD, limit=2.0), FILTER, oscillator()):
        flags = ["-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Werror"]
        export_fmu(system, tmp_path / "a.fmu", fmi=fmi, name="strict", compiler=[*quick_compiler(), *flags])


def test_sources_only_without_a_compiler(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr("phyfilter_ctl.codegen.compiler.find_spec", lambda name: None)
    with pytest.warns(UserWarning, match=r"a\.fmu holds sources only.*no C compiler"):
        path = export_fmu(FILTER, tmp_path / "a.fmu")
    with zipfile.ZipFile(path) as archive:
        assert not [name for name in archive.namelist() if name.startswith("binaries")]
        assert "no C compiler was found" in archive.read("documentation/index.html").decode()
    assert validate_fmu(str(path)) == []
    with pytest.raises(CompilerError, match="not found"):
        export_fmu(FILTER, tmp_path / "b.fmu", compiler="no-such-cc")
    monkeypatch.setattr("phyfilter_ctl.fmi.build.find_spec", lambda name: None)
    with pytest.raises(CompilerError, match="cross"):
        build_binaries({}, name="a", fmi="3.0", platforms=("aarch64-linux",))
    assert not (tmp_path / "b.fmu").exists()


def test_failing_compiler_is_quoted(tmp_path):
    with pytest.raises(CompilerError, match="broken"):
        export_fmu(
            FILTER,
            tmp_path / "a.fmu",
            compiler=["sh", "-c", "[ $# = 1 ] && echo 1 || (echo broken >&2; exit 1)", "x"],
        )
    assert not list(tmp_path.iterdir())


# ---- names, units, structure ----


@pytest.mark.parametrize("name", ["", "a..b", "v."])
def test_illegal_names_are_named(name):
    model = replace(diagram_model(pf.flatten(oscillator()), name="swing"), inputs=(Variable(name),))
    with pytest.raises(ValueError, match="no legal FMI name"):
        fmu_interface(model)


def test_names_that_need_it_are_quoted_or_spelt_out():
    names = ["v 1", "1v", "a:b", "v[x]", "v[0", "it's", "b.v 1[2]", "é", "θ", "e", "theta", "v_1", "b.k"]
    model = diagram_model(pf.flatten(oscillator()), name="swing")
    interface = fmu_interface(
        replace(model, inputs=tuple(Variable(name, 0.0, "", "x") for name in names)), fmi="2.0"
    )
    inputs = [(v.name, v.description) for v in interface.variables if v.kind == "input"]
    assert inputs == [
        ("'v 1'", "v 1: x"), ("'1v'", "1v: x"), ("'a:b'", "a:b: x"), ("'v[x]'", "v[x]: x"), ("'v[0'", "v[0: x"),
        ("'it\\'s'", "it's: x"), ("b.'v 1'[2]", "b.v 1[2]: x"), ("e_2", "é: x"), ("theta_2", "θ: x"), ("e", "x"),
        ("theta", "x"), ("v_1", "x"), ("b.k", "x"),
    ]  # fmt: skip


def test_legal_names_and_clashes():
    model = diagram_model(pf.flatten(oscillator()), name="swing")
    for name in ("'odd name'", "a.b[1,2].c", "_x"):
        interface = fmu_interface(replace(model, inputs=(Variable(name),)))
        assert name in [variable.name for variable in interface.variables]
    with pytest.raises(ValueError, match=r"called 'pull'"):
        fmu_interface(replace(model, inputs=(Variable("pull"),)))
    # A state called as an output is another variable of the same value.
    names = [variable.name for variable in fmu_interface(model).variables]
    assert {"place", "state.place", "der(state.place)", "speed", "der(speed)"} <= set(names)


def test_quoted_names_do_not_break_the_c_code():
    model = diagram_model(pf.flatten(oscillator()), name="swing")
    text = glue_source(fmu_interface(replace(model, inputs=(Variable("'*/ ?? \\\" x'"),))), "0")
    assert "*/ ??" not in text
    assert r'"\'' not in text
    assert r"\\\"" in text


def test_arrays():
    def named(*names, unit=""):
        inputs = tuple(Variable(name, float(i), unit) for i, name in enumerate(names))
        model = replace(
            diagram_model(pf.flatten(oscillator()), name="swing"),
            inputs=inputs,
            depends=np.zeros((0, 0), dtype=bool),
        )
        interface = fmu_interface(model)
        return {interface.variables[i].name: interface.variables[i].shape for i in interface.of_kind("input")}

    assert named("u[0]", "u[1]", "u[2]") == {"u": (3,)}
    assert named("M[0,0]", "M[0,1]", "M[1,0]", "M[1,1]") == {"M": (2, 2)}
    assert named("u[0]") == {"u[0]": ()}
    assert named("u[1]", "u[0]") == {"u[1]": (), "u[0]": ()}
    assert named("u[0]", "w", "u[1]") == {"u[0]": (), "w": (), "u[1]": ()}
    assert named("M[0,0]", "M[0,1]", "M[1,0]") == {"M[0,0]": (), "M[0,1]": (), "M[1,0]": ()}
    assert named("b.u[0]", "b.u[1]", "c[0].u") == {"b.u": (2,), "c[0].u": ()}


@pytest.mark.parametrize(
    ("text", "exponents", "factor"),
    [
        ("m/s^2", {"m": 1, "s": -2}, 1.0), ("N m", {"kg": 1, "m": 2, "s": -2}, 1.0),
        ("rad/s", {"s": -1, "rad": 1}, 1.0),
        ("kg", {"kg": 1}, 1.0), ("1/s", {"s": -1}, 1.0), ("(rad/s)^2", {"s": -2, "rad": 2}, 1.0), ("1", {}, 1.0),
        ("kg*m**2", {"kg": 1, "m": 2}, 1.0), ("N.m/rad", {"kg": 1, "m": 2, "s": -2, "rad": -1}, 1.0),
        ("km/h", {"m": 1, "s": -1}, 1 / 3.6), ("deg", {"rad": 1}, np.pi / 180), ("mm", {"m": 1}, 1e-3),
        ("kN", {"kg": 1, "m": 1, "s": -2}, 1e3), ("V s/(rad A)", {"kg": 1, "m": 2, "s": -2, "A": -2, "rad": -1}, 1.0),
        ("m s^-2", {"m": 1, "s": -2}, 1.0), ("m/s2", {"m": 1, "s": -2}, 1.0), ("min", {"s": 1}, 60.0),
    ],
)  # fmt: skip
def test_units(text, exponents, factor):
    unit = unit_definition(text)
    assert unit.exponents == exponents
    assert unit.factor == pytest.approx(factor, rel=1e-15)


@pytest.mark.parametrize("text", ["m/", "(m", "m)", "smoots", "m^0.5", "m^", "/", "N/sqrt(Hz)", "€"])
def test_units_that_are_not_understood_are_kept(text):
    assert unit_definition(text).exponents is None


@pytest.mark.slow
def test_bounds_are_those_declared_and_no_others(tmp_path):
    tank = pf.plant(
        lambda t, x, u, p: {"level": u.flow - p.drain * x.level},
        states={"level": (1.0, "m", "height", (0.0, 4.0))},
        inputs={"flow": (0.5, "m/s", "inflow", (-1.0, 2.5))},
        params={"drain": (0.2, "1/s", "outlet", (0.0, float("inf")))},
    )
    wired = ct.interconnect([tank], inplist=["flow"], inputs=["in"], outlist=["level"], outputs=["out"])
    sampled = FILTER.sampled(PERIOD, limit=[2.0, 3.0], g_limit=(-1.0, 1.0))
    observed = pf.sampled_block(sampled, channels=2, name="observer")
    expected = [
        (
            tank,
            {
                "state.level": (0.0, 4.0),
                "level": (None, None),
                "flow": (-1.0, 2.5),
                "drain": (0.0, None),
                "solver.step": (0.0, None),
            },
        ),
        (wired, {"in": (-1.0, 2.5)}),
        (sampled, {"a": (0.0, None), "limit": (0.0, None), "f_hat": (None, None), "g_low": (None, None)}),
        (observed, {"observer.a": (0.0, None), "observer.limit": (0.0, None), "observer.b": (None, None)}),
    ]
    for fmi in VERSIONS:
        for system, bounds in expected:
            ports = FmuPorts(channels=2) if system is sampled else None
            path = export_fmu(system, tmp_path / "a.fmu", fmi=fmi, platforms=(), ports=ports)
            assert validate_fmu(str(path)) == []
            variables = fmpy.read_model_description(str(path)).modelVariables
            found = {v.name.partition("[")[0]: (v.min, v.max) for v in variables}
            for name, (least, most) in bounds.items():
                assert found[name] == tuple(None if end is None else str(end) for end in (least, most))
            assert all(v.nominal is None for v in variables)


@pytest.mark.slow
@pytest.mark.parametrize("fmi", VERSIONS)
def test_nominal_values(tmp_path, fmi):
    """In the description and in the function that solvers of importers ask; 1 where nobody said."""
    plant = pf.plant(
        lambda t, x, u, p: {"p": u.q, "v": -x.v, "s": x.v},
        states={
            "p": (1e5, "Pa", "pressure", (0.0, np.inf, 2e5)),
            "v": ([0.0, 0.0], "m/s"),
            "s": ([0.0, 0.0], "m", "place", (-1.0, 1.0, 0.01)),
        },
        inputs={"q": (0.0, "Pa/s", "inflow", (-np.inf, np.inf, 300.0))},
        outputs=["v"],
    )
    path = export_fmu(plant, tmp_path / "a.fmu", fmi=fmi, kinds=["me"], compiler=quick_compiler())
    assert validate_fmu(str(path)) == []
    variables = fmpy.read_model_description(str(path)).modelVariables
    found = {v.name.partition("[")[0]: v.nominal for v in variables}
    assert {name: float(value) for name, value in found.items() if value} == {"p": 2e5, "s": 0.01, "q": 300.0}
    with Instance(path, "me") as instance:
        instance.start()
        values = (ctypes.c_double * 5)()
        ask = getattr(instance.fmu, f"fmi{fmi[0]}GetNominalsOfContinuousStates")
        ask(instance.fmu.component, values, 5)
    assert list(values) == [2e5, 1.0, 1.0, 0.01, 0.01]


@pytest.mark.parametrize("nominal", [0.0, -1.0, float("inf"), float("nan")])
def test_nominal_values_that_are_none_are_refused(nominal):
    with pytest.raises(ValueError, match=r"params: k: expected a nominal value above 0"):
        pf.plant(
            lambda t, x, u, p: {"v": p.k},
            states={"v": 0.0},
            params={"k": (1.0, "m", "gain", (0.0, 2.0, nominal))},
        )


@pytest.mark.parametrize("bounds", [(2.0, 3.0), (1.0, 1.0), (0.0,), ("a", "b"), (0.0, float("nan"))])
def test_bounds_that_are_none_are_refused(bounds):
    with pytest.raises(ValueError, match=r"params: k: .*bounds"):
        pf.plant(lambda t, x, u, p: {"v": p.k}, states={"v": 0.0}, params={"k": (1.0, "m", "gain", bounds)})


def test_unit_of_every_variable_is_defined():
    for fmi in VERSIONS:
        description = fmpy.read_model_description(str(exported("oscillator", fmi)))
        units = {unit.name: unit for unit in description.unitDefinitions}
        speed = next(v for v in description.modelVariables if v.name == "der(speed)")
        assert speed.unit in units
        assert {v.unit for v in description.modelVariables if v.unit} == set(units)
        base = units["N/m"].baseUnit
        assert (int(base.kg or 0), int(base.m or 0), int(base.s or 0)) == (1, 0, -2)


def test_structure_is_complete_without_sparsity():
    model = replace(
        diagram_model(pf.flatten(oscillator()), name="swing"), depends=np.zeros((0, 0), dtype=bool)
    )
    interface = fmu_interface(model)
    assert interface.depends.all()
    assert 'dependencies=""' not in model_description(interface, "0", ())


def test_dependence_on_time_is_told(tmp_path):
    def swing(t, x, u, p):
        return {"a": np.cos(t) - x.a, "b": x.a}, {"early": x.b, "late": x.b + t}

    system = pf.plant(swing, states={"a": 0.0, "b": 0.0}, inputs={})
    description = fmpy.read_model_description(str(export_fmu(system, tmp_path / "a.fmu", platforms=())))
    found = {
        u.variable.name: [d.name for d in u.dependencies]
        for u in description.outputs + description.derivatives
    }
    assert found == {"early": ["b"], "late": ["time", "b"], "der(a)": ["time", "a"], "der(b)": ["a"]}


def test_step_at_which_euler_diverges_is_discarded(tmp_path):
    path = export_fmu(FILTER.sampled(PERIOD, "euler"), tmp_path / "a.fmu", compiler=quick_compiler())
    with Instance(path) as fmu:
        fmu.start(x=1.0)
        fmu.step(PERIOD, x=1.1)
        before = fmu.get("f_hat")
        assert refused(fmu.fmu.doStep, PERIOD, 0.2) == 2  # |1 - 20 * 0.2| > 1
        assert "Euler" in fmu.messages[-1]
        assert fmu.get("f_hat") == before
        fmu.step(PERIOD, x=1.1)


@pytest.mark.slow
def test_single_precision_filter(tmp_path):
    sampled = FILTER.sampled(PERIOD, precision="float32")
    path = export_fmu(sampled, tmp_path / "a.fmu", compiler=quick_compiler(), ports=FmuPorts(channels=2))
    x = np.random.default_rng(1).normal(size=(50, 2)).cumsum(axis=0) * 0.01
    with Instance(path) as fmu:
        fmu.start(x=x[0])
        found = [fmu.get("f_hat")]
        for row in x[1:]:
            fmu.step(PERIOD, x=row)
            found.append(fmu.get("f_hat"))
    expected = sampled.run(x)
    np.testing.assert_allclose(
        found, expected, rtol=0, atol=4 * np.finfo(np.float32).eps * np.abs(expected).max()
    )


def test_signals_name_channels_and_units(tmp_path):
    units = {"x": "m/s", "g": "m/s^2", "f": "m/s^2"}
    bank = [FILTER, pf.PhyFilter([1000.0, 300.0, 30.0])]
    path = export_fmu(
        bank, tmp_path / "a.fmu", platforms=(), ports=FmuPorts(channels=["x", "y"], units=units)
    )
    assert validate_fmu(str(path)) == []
    variables = {v.name: v for v in fmpy.read_model_description(str(path)).modelVariables}
    assert variables["x"].unit == "m/s"
    assert variables["f_hat"].unit == variables["g"].unit == "m/s^2"
    assert variables["x"].shape == (2,)
    assert float(variables["a[1,2]"].start) == 30.0  # orders differ: no rectangular array
    assert variables["a[1,2]"].unit == "rad/s"


# ---- bad input ----


def test_options_that_make_no_sense(tmp_path):
    path = tmp_path / "a.fmu"
    with pytest.raises(ValueError, match="fmi: expected"):
        export_fmu(FILTER, path, fmi="1.0")
    with pytest.raises(ValueError, match="kinds: expected"):
        export_fmu(FILTER, path, kinds=("se",))
    with pytest.raises(ValueError, match="kinds: expected"):
        export_fmu(FILTER, path, kinds=())
    with pytest.raises(ValueError, match="channels belongs to filters"):
        export_fmu(oscillator(), path, ports=FmuPorts(channels=2))
    with pytest.raises(ValueError, match="rate="):
        export_fmu(oscillator(), path, rate="fixed")
    with pytest.raises(TypeError, match="expected a filter or a python-control system"):
        export_fmu(np.eye(2), path)
    with pytest.raises(ValueError, match="C identifier"):
        export_fmu(FILTER, path, name="two words")
    with pytest.raises(FileNotFoundError, match="no such folder"):
        export_fmu(FILTER, tmp_path / "none" / "a.fmu", platforms=())
    with pytest.raises(IsADirectoryError):
        export_fmu(FILTER, tmp_path, platforms=())
    with pytest.raises(ValueError, match="solver step"):
        FmuSolver(step=0.0)
    with pytest.raises(ValueError, match="solver method"):
        FmuSolver("bdf")
    with pytest.raises(ValueError, match="start < stop"):
        FmuExperiment(stop=0.0)
    assert not list(tmp_path.iterdir())


def test_block_that_cannot_be_traced_is_named_with_its_line(tmp_path):
    def update(t, x, u, params):
        return [-np.linalg.svd(np.diag(x))[1][0]]

    system = ct.nlsys(update, None, states=["x"], inputs=["u"], outputs=["y"], name="decomposing")
    with pytest.raises(
        ValueError, match=r"block decomposing runs as Python.*line \d+, in update: return \[-np.linalg"
    ):
        export_fmu(system, tmp_path / "a.fmu")
    assert not list(tmp_path.iterdir())


# ---- corners ----


def test_static_model_and_one_kind(tmp_path):
    """No states, no samples; co-simulation only, so that the other kind is refused."""
    path = export_fmu(ct.ss([], [], [], [[2.0, -1.0]], name="gain"), tmp_path / "a.fmu", kinds=("cs",))
    assert validate_fmu(str(path)) == []
    with Instance(path) as fmu:
        fmu.start(u=[3.0, 1.0])
        outputs = [v.name for v in fmu.description.modelVariables if v.causality == "output"]
        assert fmu.get(*outputs) == [5.0]
        fmu.step(1e6, u=[1.0, 1.0])
        assert fmu.get(*outputs) == [1.0]
    assert fmpy.read_model_description(str(path)).modelExchange is None


def test_discrete_diagram(tmp_path):
    """A discrete python-control system updates at its own rate."""
    system = ct.ss([[0.5]], [[1.0]], [[1.0]], [[0.0]], dt=0.1, name="slow")
    path = export_fmu(system, tmp_path / "a.fmu")
    assert validate_fmu(str(path)) == []
    with Instance(path) as fmu:
        output = next(v.name for v in fmu.description.modelVariables if v.causality == "output")
        signal = next(v.name for v in fmu.description.modelVariables if v.causality == "input")
        fmu.start(**{signal: 1.0} if "[" not in signal else {signal.split("[")[0]: 1.0})
        fmu.step(0.05)
        fmu.step(0.2)
        fmu.step(0.25)
        assert fmu.get(output)[0] == pytest.approx(2.0 * (1 - 0.5**5), rel=1e-12)


def test_diverging_model_is_discarded(tmp_path):
    def explode(t, x, u, p):
        return {"x": x.x * x.x}

    system = pf.plant(explode, states={"x": 1.0}, inputs={})
    path = export_fmu(
        system,
        tmp_path / "a.fmu",
        name="explode",
        compiler=quick_compiler(),
        experiment=FmuExperiment(solver=FmuSolver("adaptive")),
    )
    with Instance(path) as fmu:
        fmu.start()
        fmu.step(0.5)
        value = fmu.get("x")
        assert value[0] == pytest.approx(2.0, rel=1e-6)
        assert refused(fmu.fmu.doStep, 0.5, 1.0) == 2  # x = 1/(1 - t)
        assert fmu.get("x") == value
        fmu.step(0.25)
        assert fmu.get("x")[0] == pytest.approx(4.0, rel=1e-6)


def test_parameters_of_functions_with_a_newton_solver_inside(tmp_path):
    """A rootfinder in the equations: exported where CasADi has C for it, else refused by name."""
    y, u = ca.MX.sym("y"), ca.MX.sym("u")
    residual = ca.Function("r", [y, u], [y**3 + y - u])
    solve = ca.rootfinder("solve", "fast_newton", residual)
    t, x, p = ca.MX.sym("t"), ca.MX.sym("x"), ca.MX.sym("p", 0)
    functions = BlockFunctions(
        (Variable("x"),), (Variable("u"),), (Variable("y"),), (),
        ca.Function("f", [t, x, u, p], [solve(0.0, u) - x]), ca.Function("h", [t, x, u, p], [x]),
    )  # fmt: skip
    path = export_fmu(
        pf.function_block(functions, name="implicit"), tmp_path / "a.fmu", compiler=quick_compiler()
    )
    with Instance(path) as fmu:
        fmu.start(u=10.0)
        fmu.step(30.0)
        assert fmu.get("y")[0] == pytest.approx(2.0, abs=1e-9)


def test_documentation_says_what_it_is():
    with zipfile.ZipFile(exported("sampled", "3.0")) as archive:
        page = archive.read("documentation/index.html").decode()
    for text in ("F(s) = ", "<svg", "one sample per communication step", "f_theta", "Parameters"):
        assert text in page
    assert not re.search(r"(src|href)=", page.split("<svg")[0])  # nothing from elsewhere


@pytest.mark.slow
def test_matplotlib_settings_are_left_alone(tmp_path):
    import matplotlib as mpl

    with mpl.rc_context({"font.size": 17.0}), warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("default", DeprecationWarning)  # of others
        one = export_fmu(FILTER, tmp_path / "a.fmu", platforms=())
        assert mpl.rcParams["font.size"] == 17.0
    two = export_fmu(FILTER, tmp_path / "b.fmu", platforms=())
    assert digest(one) == digest(two)
