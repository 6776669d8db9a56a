"""Exported FMUs run as the library and closed forms do: FMI 2 and 3, co-simulation and model exchange."""

import fmpy
import numpy as np
import pytest
from exported_fmus import (
    FILTER,
    GENERAL,
    MODELS,
    PERIOD,
    Instance,
    closed_loop,
    described,
    exported,
    quick_compiler,
    refused,
)
from fmpy.validation import validate_fmu
from lxml import etree
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from phyfilter_ctl.fmi import FmuPorts
from phyfilter_ctl.fmi.description import FmuExperiment, FmuSolver
from tests.cpu_budget import slow_but

VERSIONS = ("2.0", "3.0")
# Same operations in the same order in C as in numpy, but for sums over short vectors: a few units in the last place.
LAST_PLACE = 1e-14
# RK4 in steps of 1 ms against exact solutions of systems with |p| <= 40 rad/s.
FIXED_STEP = 1e-9
# fmpy integrates model exchange with CVode at its relative tolerance of 1e-5 (here 1e-8) and a long absolute one.
IMPORTER = 2e-5
PULL = 8.0  # N/m, stiffness of the oscillator


def flight(n, channels, seed=3):
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.normal(0.0, 0.01, (n, channels)), axis=0)
    return x, rng.normal(0.0, 1.0, (n, channels)), rng.normal(0.0, 1.0, (n, channels))


def free_swing(t, mass=2.0, stiffness=8.0, damping=0.4, force=0.0):
    A = np.array([[0.0, 1.0], [-stiffness / mass, -damping / mass]])
    rest = np.array([force / stiffness, 0.0])
    return rest + expm(A * t) @ (np.array([1.0, 0.0]) - rest)


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("name", slow_but(("sampled", "oscillator"), MODELS))
def test_valid(name, fmi):
    path = exported(name, fmi)
    assert validate_fmu(str(path)) == []
    description = described(path)
    assert description.coSimulation.canGetAndSetFMUstate
    assert description.modelExchange.canGetAndSetFMUstate
    assert description.generationDateAndTime is None


def test_side_files_are_valid(tmp_path):
    folder = fmpy.extract(str(exported("loop", "3.0")), unzipdir=str(tmp_path))
    schema = etree.XMLSchema(file=f"{fmpy.__path__[0]}/schema/fmi3/fmi3TerminalsAndIcons.xsd")
    schema.assertValid(etree.parse(f"{folder}/terminalsAndIcons/terminalsAndIcons.xml"))
    terminals = etree.parse(f"{folder}/terminalsAndIcons/terminalsAndIcons.xml")
    names = {variable.name for variable in described(exported("loop", "3.0")).modelVariables}
    assert {e.get("variableName") for e in terminals.iter("TerminalMemberVariable")} <= names
    etree.XMLSchema(file=f"{fmpy.__path__[0]}/schema/fmi3/fmi3BuildDescription.xsd").assertValid(
        etree.parse(f"{folder}/sources/buildDescription.xml")
    )
    for picture in ("icon", "terminal"):
        assert (tmp_path / "terminalsAndIcons" / f"{picture}.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize(("name", "form", "channels"), [("sampled", FILTER, 3), ("fixed", GENERAL, 2)])
def test_sampled_filter_equals_run(name, form, channels, fmi):
    x, g, f_theta = flight(400, channels)
    expected = form.sampled(PERIOD).run(x, g, f_theta)
    with Instance(exported(name, fmi)) as fmu:
        fmu.start(x=x[0], g=g[0], f_theta=f_theta[0])
        found = [fmu.get("f_hat")]
        for k in range(1, len(x)):
            fmu.step(PERIOD, x=x[k], g=g[k], f_theta=f_theta[k])
            found.append(fmu.get("f_hat"))
    np.testing.assert_allclose(found, expected, rtol=0, atol=LAST_PLACE * np.abs(expected).max() * 10)


@pytest.mark.parametrize("fmi", VERSIONS)
def test_sampled_filter_over_irregular_steps(fmi):
    x, g, f_theta = flight(300, 3)
    steps = PERIOD * np.random.default_rng(5).uniform(0.2, 4.0, len(x) - 1)
    times = np.concatenate([[0.0], np.cumsum(steps)])
    expected = FILTER.sampled(PERIOD).run(x, g, f_theta, times=times)
    with Instance(exported("sampled", fmi)) as fmu:
        fmu.start(x=x[0], g=g[0], f_theta=f_theta[0])
        found = [fmu.get("f_hat")]
        for k in range(1, len(x)):
            fmu.step(times[k] - times[k - 1], x=x[k], g=g[k], f_theta=f_theta[k])
            found.append(fmu.get("f_hat"))
    # The step is a difference of times here and there: its rounding is 1e-16 of the time, 1e-13 of the step.
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)


@pytest.mark.parametrize("fmi", VERSIONS)
def test_sampled_filter_in_model_exchange(fmi):
    """At time events, every dt; inputs set in Event Mode count at the event."""
    x, g, f_theta = flight(100, 3)
    expected = FILTER.sampled(PERIOD).run(x, g, f_theta)
    with Instance(exported("sampled", fmi), "me") as fmu:
        fmu.enter().set(x=x[0], g=g[0], f_theta=f_theta[0])
        fmu.fmu.exitInitializationMode()
        after = fmu.update()
        fmu.fmu.enterContinuousTimeMode()
        found = [fmu.get("f_hat")]
        for k in range(1, len(x)):
            assert after == pytest.approx(k * PERIOD, rel=1e-12)
            fmu.fmu.setTime(after)
            fmu.fmu.enterEventMode()
            fmu.set(x=x[k], g=g[k], f_theta=f_theta[k])
            after = fmu.update()
            fmu.fmu.enterContinuousTimeMode()
            found.append(fmu.get("f_hat"))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("fmi", VERSIONS)
def test_continuous_filter_against_its_transfer_function(fmi):
    """A residual of 1.5 sin(9 t): x is its integral. f_hat tends to |F| and phase of F(9j)."""
    omega, size, h, end = 9.0, 1.5, 1e-3, 3.0
    with Instance(exported("continuous", fmi)) as fmu:
        fmu.start(x=0.0)
        for k in range(round(end / h)):
            fmu.step(
                h, x=size / omega * (1 - np.cos(omega * (k * h + h / 2)))
            )  # held: the value of the middle
        fmu.set(x=size / omega * (1 - np.cos(omega * end)))
        found = fmu.get("f_hat")
    F = GENERAL(1j * omega)
    # The hold of x, taken at the middle of each step, errs by (omega h)^2 / 24 and the output by h omega / 2 of s F x.
    assert found == pytest.approx(np.full(2, size * np.imag(F * np.exp(1j * omega * end))), abs=5e-3)


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize(
    "steps",
    [[0.01] * 200, [2.0], [1e-9] * 20 + [1.0, 1.0 - 20e-9], [0.3, 0.0007, 1.2, 0.4, 0.0993]],
    ids=["regular", "huge", "tiny", "irregular"],
)
def test_communication_steps_do_not_matter(fmi, steps):
    with Instance(exported("oscillator", fmi)) as fmu:
        fmu.start()
        for h in steps:
            fmu.step(h)
        found = fmu.get("place", "pull")
    assert found[0] == pytest.approx(free_swing(2.0)[0], abs=FIXED_STEP)
    assert found[1] == pytest.approx(PULL * found[0], rel=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize("fmi", VERSIONS)
def test_adaptive_solver_keeps_its_tolerance(fmi):
    for rtol in (1e-4, 1e-10):
        path = exported(
            "oscillator",
            fmi,
            experiment=FmuExperiment(solver=FmuSolver("adaptive", rtol=rtol, atol=rtol * 1e-2)),
        )
        with Instance(path) as fmu:
            fmu.start()
            for h in (0.7, 1.3):
                fmu.step(h)
            error = abs(fmu.get("place")[0] - free_swing(2.0)[0])
        assert error < 20 * rtol
    with Instance(path, tolerance=1e-3) as fmu:  # what the importer asks for counts
        fmu.start()
        assert fmu.get("solver.rtol")[0] == 1e-3


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
def test_importer_runs_the_oscillator(fmi, kind):
    start = {"mass": 3.0}
    result = fmpy.simulate_fmu(
        str(exported("oscillator", fmi)),
        fmi_type=kind,
        stop_time=2.0,
        start_values=start,
        relative_tolerance=1e-8,
    )
    expected = [free_swing(t, mass=3.0)[0] for t in result["time"]]
    tolerance = FIXED_STEP if kind == "CoSimulation" else IMPORTER
    assert result["place"][0] == 1.0
    np.testing.assert_allclose(result["place"], expected, rtol=0, atol=tolerance)


def body(v, s, thrust, h):
    """The plant of the closed loop after h seconds of constant thrust."""

    def rates(_, y):
        return [(thrust - 0.3 * y[0] * np.sqrt(y[0] ** 2 + 1.0)) / 1.2, y[0]]

    return solve_ivp(rates, (0.0, h), [v, s], rtol=1e-12, atol=1e-13).y[:, -1]


def loop_by_hand(goal, f_theta, ticks):
    """The closed loop of exported_fmus.closed_loop after so many instants of its fastest block."""
    observer = FILTER.sampled(0.005)
    state = observer.start([0.0], f_theta0=[f_theta])
    v = s = 0.0
    thrust, f_hat = 4.0 * goal, f_theta
    for k in range(1, ticks + 1):
        v, s = body(v, s, thrust, 0.005)
        state, estimate = observer.step(state, [v], [thrust], [f_theta])
        f_hat = float(estimate[0])
        if k % 4 == 0:
            thrust = 4.0 * goal - 4.0 * s - 3.0 * v
    return np.array([s, v, f_hat])


@pytest.mark.parametrize("fmi", VERSIONS)
def test_diagram_of_several_rates(fmi):
    expected = loop_by_hand(1.5, 0.25, 80)
    for h in (0.005, 0.1, 0.0123):
        with Instance(exported("loop", fmi)) as fmu:
            fmu.start(goal=1.5, f_theta=0.25)
            while fmu.time < 0.4 - h:
                fmu.step(h)
            fmu.step(0.4 - fmu.time)
            found = fmu.get("s", "v", "f_hat")
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("fmi", VERSIONS)
def test_diagram_in_the_importers_solver(fmi):
    result = fmpy.simulate_fmu(
        str(exported("loop", fmi)), fmi_type="ModelExchange", stop_time=0.4, relative_tolerance=1e-9,
        start_values={"goal": 1.5, "f_theta": 0.25},
    )  # fmt: skip
    expected = loop_by_hand(1.5, 0.25, 80)
    assert result["time"][-1] == pytest.approx(0.4)
    found = [result[name][-1] for name in ("s", "v", "f_hat")]
    np.testing.assert_allclose(found, expected, rtol=0, atol=IMPORTER)


def test_event_mode_samples_the_inputs_of_the_instant():
    """FMI 3 co-simulation with event mode: what is set at an instant counts at it, as in the library's own run."""
    x, g, f_theta = flight(60, 2)
    expected = GENERAL.sampled(PERIOD).run(x, g, f_theta)
    path = exported("fixed", "3.0")
    with Instance(path, event_mode=True, early_return=True) as fmu:
        fmu.start(x=x[0], g=g[0], f_theta=f_theta[0])
        found = [fmu.get("f_hat")]
        for k in range(1, len(x)):
            event, _, early, reached = fmu.step(0.05)  # far beyond the next instant
            assert event
            assert early
            assert reached == pytest.approx(k * PERIOD, rel=1e-12)
            fmu.fmu.enterEventMode()
            fmu.set(x=x[k], g=g[k], f_theta=f_theta[k])
            fmu.update()
            found.append(fmu.get("f_hat"))
            fmu.fmu.enterStepMode()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["fixed", "loop"])
def test_event_mode_ignored_or_without_early_return(name):
    """Instants inside a step that may not end early happen all the same, and those at its end are not lost."""
    outputs = {"fixed": ["f_hat"], "loop": ["s", "v", "f_hat"]}[name]
    start = {"fixed": {"x": 1.0, "f_theta": 0.5}, "loop": {"goal": 1.0}}[name]
    found = []
    for options in ({}, {"event_mode": True}):
        with Instance(exported(name, "3.0"), **options) as fmu:
            fmu.start(**start)
            if name == "fixed":
                fmu.set(x=2.0)
            for _ in range(4):
                event = fmu.step(0.02)[0]
                assert event == bool(options)
            fmu.step(0.0011)
            found.append(fmu.get(*outputs))
    np.testing.assert_allclose(found[0], found[1], rtol=1e-9)


@pytest.mark.slow
def test_inertia_and_options_are_those_of_the_filter(tmp_path):
    from phyfilter_ctl.fmi.export import export_fmu

    rng = np.random.default_rng(8)
    E = np.array([[1.0, 0.5, 0.0], [0.0, 1.0, -1.0]])
    sampled = FILTER.sampled(
        PERIOD,
        "tustin",
        "average",
        "hold",
        E=E.T,
        delay=0.005,
        limit=[0.4, 3.0],
        g_limit=(-1.0, 0.7),
        nonfinite="hold",
    )
    x, g = rng.normal(size=(2, 200, 3)) * [[[0.01]], [[1.0]]]
    f_theta = rng.normal(size=(200, 2))
    inertia = 1.0 + 0.2 * rng.random((200, 3, 3))
    path = export_fmu(
        sampled,
        tmp_path / "a.fmu",
        name="rich",
        compiler=quick_compiler(),
        ports=FmuPorts(channels=3, inertia="full"),
    )
    x[50, 1] = np.nan  # held over, as the filter's own policy says
    expected = sampled.run(x, g, f_theta, inertia=inertia)
    with Instance(path) as fmu:
        fmu.start(x=x[0], g=g[0], f_theta=f_theta[0], M=inertia[0].ravel())
        found = [fmu.get("f_hat")]
        for k in range(1, 200):
            fmu.step(PERIOD, x=x[k], g=g[k], f_theta=f_theta[k], M=inertia[k].ravel())
            found.append(fmu.get("f_hat"))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("fmi", VERSIONS)
def test_outputs_are_right_at_the_start_and_after_set(fmi):
    with Instance(exported("oscillator", fmi)) as fmu:
        fmu.enter()
        assert fmu.get("pull")[0] == PULL
        fmu.set(stiffness=10.0)
        assert fmu.get("pull")[0] == 10.0  # in Initialization Mode already
        fmu.fmu.exitInitializationMode()
        assert fmu.get("pull")[0] == 10.0
    with Instance(exported("continuous", fmi)) as fmu:
        fmu.start(x=5.0, f_theta=0.75)
        assert fmu.get("f_hat").tolist() == [0.75, 0.75]
        before = fmu.get("f_hat")
        fmu.set(f_theta=1.75)
        assert (fmu.get("f_hat") - before).tolist() == [1.0, 1.0]  # feedthrough without a step
    with Instance(exported("loop", fmi)) as fmu:
        fmu.enter().set(goal=2.0, f_theta=0.5)
        assert fmu.get("s", "v", "f_hat").tolist() == [0.0, 0.0, 0.5]


def test_slopes_of_inputs():
    """FMI 2: a force that rises evenly, in one step."""
    with Instance(exported("oscillator", "2.0")) as fmu:
        fmu.start()
        refs, _ = fmu.references("force")
        fmu.fmu.setRealInputDerivatives(refs, [1], [3.0])
        fmu.step(1.0)
        found = fmu.get("place", "force")
        fmu.step(1.0)  # slopes are those of one step
        assert fmu.get("force")[0] == found[1] == 3.0
        assert refused(fmu.fmu.setRealInputDerivatives, refs, [2], [3.0]) == 3
    exact = solve_ivp(lambda t, y: [y[1], (3.0 * t - 8.0 * y[0] - 0.4 * y[1]) / 2.0], (0.0, 1.0), [1.0, 0.0],
                      rtol=1e-11, atol=1e-12)  # fmt: skip
    assert found[0] == pytest.approx(exact.y[0, -1], abs=FIXED_STEP)


def test_library_runs_the_same_loop():
    """The in-process run of the same diagram, where it is there, gives what the FMU gives."""
    simulate = pytest.importorskip("phyfilter_ctl.simulation").simulate
    times = np.arange(0.0, 0.4 + 1e-9, 0.005)
    inputs = np.vstack([np.full(len(times), 1.5), np.full(len(times), 0.25)])
    response = simulate(closed_loop(), times, inputs)
    with Instance(exported("loop", "3.0")) as fmu:
        fmu.start(goal=1.5, f_theta=0.25)
        for _ in times[1:]:
            fmu.step(0.005)
        np.testing.assert_allclose(fmu.get("s", "v", "f_hat"), response.outputs[:, -1], rtol=0, atol=1e-9)
