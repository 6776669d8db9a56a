"""A diagram with a sampled filter as a package of this library's FMUs, against its simulation in one piece."""

import control as ct
import numpy as np
import pytest
import test_export_importers as importers
from fmpy.ssp.simulation import simulate_ssp

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.blocks import sampled_block
from phyfilter_ctl.codegen import find_compiler
from phyfilter_ctl.codegen.compiler import CompilerError
from phyfilter_ctl.fmi import Master, check, cosimulate, cut_diagram, export_ssp, read_ssp
from phyfilter_ctl.simulation import simulate

try:
    find_compiler()
except CompilerError:
    pytest.skip("no C compiler: FMUs cannot be built", allow_module_level=True)

# Three FMUs are compiled; tests/fmi/test_ssp.py cuts diagrams without.
pytestmark = pytest.mark.slow

# Between the instants of the filter, which are multiples of 20 ms: at one, f_hat jumps, and a late value is far off.
T = np.concatenate([[0.0], 0.01 + 0.04 * np.arange(25)])
INPUTS = {"ref": 1.0, "w": 0.7}
PARTS = {"plant": ["plant"], "controller": ["pd"], "filter": ["filter"]}
ORDER_ONE = 0.2


def diagram(drive=True, **options):
    """With ``drive`` the learned model is an input of the whole."""
    plant = ct.nlsys(
        lambda t, x, u, p: np.array(
            [x[1], (u[0] + u[1] - 0.8 * x[1] * abs(x[1]) - np.sin(x[0])) / p.get("m", 1.5)]
        ),
        lambda t, x, u, p: np.array([x[0], x[1]]),
        inputs=["f", "w"],
        outputs=["q", "v"],
        states=["q", "v"],
        params={"m": 1.5},
        name="plant",
    )
    controller = ct.ss(
        [[-30.0]],
        [[-9.0, -4.0, 9.0, -1.0]],
        [[30.0]],
        np.zeros((1, 4)),
        inputs=["q", "v", "ref", "f_hat"],
        outputs=["f"],
        name="pd",
    )
    sampled = PhyFilter([400.0, 40.0]).sampled(0.02)
    return ct.interconnect(
        [plant, controller, sampled_block(sampled, channels=1, inertia=1.5, name="filter", **options)],
        connections=[
            ["plant.f", "pd.f"],
            ["pd.q", "plant.q"],
            ["pd.v", "plant.v"],
            ["pd.f_hat", "filter.f_hat[0]"],
            ["filter.x[0]", "plant.v"],
            ["filter.g[0]", "pd.f"],
        ],
        inplist=["pd.ref", "plant.w", *(["filter.f_theta[0]"] if drive else [])],
        inputs=["ref", "w", *(["f_theta"] if drive else [])],
        outlist=["plant.q", "plant.v", "filter.f_hat[0]"],
        outputs=["q", "v", "f_hat"],
        name="loop",
    )


@pytest.fixture(scope="module")
def monolith():
    u = np.array([np.ones_like(T), np.full_like(T, 0.7), np.zeros_like(T)])
    return np.asarray(simulate(diagram(), T, u, rtol=1e-10, atol=1e-12).outputs)


@pytest.fixture(scope="module")
def packages(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ssp")
    together = {"plant": ["plant"], "control": ["pd", "filter"]}
    return {
        "three": export_ssp(diagram(), folder / "three.ssp", split=PARTS, stop_time=1.0),
        "connected": export_ssp(
            diagram(), folder / "connected.ssp", split=PARTS, stop_time=1.0, system_connectors=True
        ),
        "two": export_ssp(diagram(), folder / "two.ssp", split=together, fmi="3.0"),
    }


@pytest.mark.parametrize("name", ["three", "two", "connected"])
@pytest.mark.parametrize("scheme", ["jacobi", "gauss-seidel"])
def test_converges_to_the_diagram(packages, monolith, name, scheme):
    errors = []
    for step in (0.005, 0.0025, 0.00125):
        found = cosimulate(packages[name], T, inputs=INPUTS, master=Master(step, scheme=scheme))
        assert found.output_labels == ["q", "v", "f_hat"]
        errors.append(np.max(np.abs(np.asarray(found.outputs) - monolith), axis=1))
    ratios = np.divide(errors[:-1], errors[1:])
    assert np.all(np.abs(ratios - 2.0) < ORDER_ONE), ratios


@pytest.mark.filterwarnings("ignore:Unused input")
def test_without_a_learned_model(packages, tmp_path):
    """Left out of the block, or left open: the numbers are those of a model that is held at 0 from outside."""
    together = {"plant": ["plant"], "control": ["pd", "filter"]}
    out = export_ssp(diagram(drive=False, f_theta=False), tmp_path / "out.ssp", split=together, fmi="3.0")
    left = export_ssp(diagram(drive=False), tmp_path / "left.ssp", split=together, fmi="3.0")
    expected = cosimulate(packages["two"], T, inputs=INPUTS, master=Master(0.005)).outputs
    for package in (out, left):
        found = cosimulate(package, T, inputs=INPUTS, master=Master(0.005)).outputs
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def test_fmpy_runs_it_too(packages, monolith):
    errors = []
    held = {"ref": lambda t: 1.0, "w": lambda t: 0.7, "f_theta": lambda t: 0.0}
    for step in (0.005, 0.0025):
        rows = simulate_ssp(str(packages["connected"]), stop_time=1.0, step_size=step, input=held)
        at = [int(np.argmin(np.abs(rows["time"] + step - t))) for t in T[1:]]
        errors.append(max(np.max(np.abs(rows[n][at] - monolith[i, 1:])) for i, n in enumerate(("q", "v"))))
    assert abs(errors[0] / errors[1] - 2.0) < ORDER_ONE


def test_parts_are_sound_fmus(packages):
    for package in packages.values():
        system = read_ssp(package)
        for path in system.parts.values():
            report = check(path)
            assert report.ok, str(report)


def test_parameters_of_the_package(packages):
    """The plant's mass is in the parameter file, and acts."""
    system = read_ssp(packages["three"])
    (mass,) = [key for key in system.parameters if key.endswith(".m")]
    assert system.parameters[mass] == 1.5
    light = cosimulate(packages["three"], T, inputs=INPUTS, parameters={mass: 1.0}, master=Master(0.005))
    usual = cosimulate(packages["three"], T, inputs=INPUTS, master=Master(0.005))
    assert not np.array_equal(light.outputs, usual.outputs)


def test_rollback_of_our_own_fmus(packages, monolith):
    found = cosimulate(packages["two"], T, inputs=INPUTS, master=Master(0.005, tolerance=1e-4))
    assert found.rejected > 0
    assert np.max(np.abs(np.asarray(found.outputs)[:2] - monolith[:2])) < 0.02


def test_sampled_blocks_do_not_run_in_python_control():
    with pytest.raises(TypeError, match=r"'filter' is a sampled block, .* export the part with export_fmu"):
        cosimulate(cut_diagram(diagram(), PARTS), timepts=T)


@pytest.mark.parametrize("importer", ["cosim", "ecos"])
def test_other_hosts_run_it_to_rounding(packages, importer):
    steps, h = 100, 0.005
    inputs = {"controller.ref": [1.0] * steps, "plant.w": [0.7] * steps}
    found = importers.run(importer, packages["three"], h, inputs, ["plant.q", "plant.v", "filter.f_hat[0]"])
    ours = cosimulate(packages["three"], timepts=h * np.arange(steps + 1), inputs=INPUTS)
    np.testing.assert_allclose(found, np.asarray(ours.outputs)[:, 1:].T, rtol=0, atol=importers.ROUNDING)
