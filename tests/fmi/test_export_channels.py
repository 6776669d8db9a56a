"""The number of channels as a structural parameter: an FMU with n of 6 channels in use is the FMU of n channels."""

import fmpy
import numpy as np
import pytest
from exported_fmus import FILTER, GENERAL, PERIOD, Instance, quick_compiler, refused

import phyfilter_ctl as pf
from phyfilter_ctl.fmi import Fmu, FmuPorts, check, cosimulate, export_fmu, import_fmu

MOST = 6
RATES = {"fixed": "fixed"}
PORTS = {"continuous": {}, "sampled": {"inertia": "diagonal"}, "fixed": {"clocks": True}}
SYSTEMS = {"continuous": GENERAL, "sampled": FILTER.sampled(PERIOD), "fixed": GENERAL.sampled(PERIOD)}
T = np.linspace(0.0, 0.04, 21)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("channels")


def made(folder, name, channels, most=None):
    path = folder / f"{name}_{channels}_{most}.fmu"
    if not path.exists():
        ports = FmuPorts(channels=channels, max_channels=most, **PORTS[name])
        rate = RATES.get(name, "communication")
        export_fmu(SYSTEMS[name], path, compiler=quick_compiler(), name="wing", rate=rate, ports=ports)
    return path


def inputs(n):
    """The same for a channel, however many there are."""
    found = {f"x[{i}]": np.sin((3.0 + i) * T) for i in range(n)}
    return found | {f"g[{i}]": np.cos((2.0 + i) * T) for i in range(n)}


@pytest.mark.slow
@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("n", [1, 4])
def test_as_the_fmu_of_so_many_channels(folder, name, n):
    def run(path, parameters):
        signals = {f"fmu.{label}": values for label, values in inputs(n).items()}
        found = cosimulate({"fmu": path}, timepts=T, inputs=signals, parameters=parameters)
        return dict(zip(found.output_labels, found.outputs, strict=True))

    own, free = run(made(folder, name, n), {}), run(made(folder, name, 4, MOST), {"fmu.channels": n})
    assert list(free) == list(own)
    for label, values in own.items():
        np.testing.assert_array_equal(free[label], values)
        assert np.ptp(values) > 0.0


@pytest.mark.slow
@pytest.mark.parametrize("n", [1, 4])
def test_model_exchange(folder, n):
    path = made(folder, "continuous", 4, MOST)
    block = import_fmu(Fmu(path, parameters={"channels": n}), kind="me")
    other = import_fmu(made(folder, "continuous", n), kind="me")
    assert (block.nstates, block.ninputs) == (3 * n, 3 * n)
    u = np.vstack([np.sin((1.0 + i) * T) for i in range(3 * n)])
    here, there = (pf.simulate(each, T, u).outputs for each in (block, other))
    np.testing.assert_allclose(here, there, rtol=0, atol=1e-12)  # rounding of the solver's steps
    x, v = np.linspace(0.1, 0.5, 3 * n), np.linspace(-1.0, 1.0, 3 * n)
    block.output(0.0, x, u[:, 0])
    A = np.array([block.instance.directional(*task) for task in _columns(block, v)])
    eps = 1e-6
    ends = [block.dynamics(0.0, x + sign * eps * v, u[:, 0]) for sign in (1.0, -1.0)]
    np.testing.assert_allclose(A[0], (ends[0] - ends[1]) / (2.0 * eps), rtol=1e-6, atol=1e-6)


@pytest.mark.slow
def test_ticked_by_the_importer(folder):
    """Clocks with the channels chosen: in co-simulation by event mode as in model exchange, and sample for sample."""
    path = made(folder, "fixed", 4, MOST)
    given = inputs(3)
    stepped = cosimulate(
        {"fmu": path}, timepts=T, inputs={f"fmu.{label}": values for label, values in given.items()},
        parameters={"fmu.channels": 3},
    )  # fmt: skip
    block = import_fmu(Fmu(path, parameters={"channels": 3}), kind="me")
    rest = np.zeros(len(T))
    exchanged = pf.simulate(block, T, np.array([given.get(label, rest) for label in block.input_labels]))
    x, g = (np.column_stack([given[f"{s}[{i}]"] for i in range(3)]) for s in "xg")
    expected = SYSTEMS["fixed"].run(x, g)
    for outputs in (stepped.outputs, exchanged.outputs):
        np.testing.assert_allclose(outputs.T, expected, rtol=0, atol=1e-12)


def _columns(block, v):
    by_name = {entry.name: entry.reference for entry in block.description.variables}
    return [([by_name["der(w)"]], [by_name["w"]], v, len(v))]


@pytest.mark.slow
def test_calls(folder):
    """Through FMPy's thin wrappers: what is allowed when, and what is refused without harm."""
    path = made(folder, "sampled", 4, MOST)
    with Instance(path) as instance:
        fmu, by_name = instance.fmu, {v.name: v.valueReference for v in instance.description.modelVariables}
        channels, f_hat, x = (by_name[name] for name in ("channels", "f_hat", "x"))
        assert refused(fmu.setUInt64, [channels], [3]) == 3
        assert "not allowed in Instantiated" in instance.messages[-1]
        fmu.enterConfigurationMode()
        for wrong in (0, MOST + 1, 2**63):
            assert refused(fmu.setUInt64, [channels], [wrong]) == 3
            assert f"{wrong} channels; expected 1 to {MOST}" in instance.messages[-1]
        assert refused(fmu.setUInt64, [x], [3]) == 3
        assert refused(fmu.getFloat64, [channels]) == 3
        assert refused(fmu.enterInitializationMode) == 3
        fmu.setUInt64([channels], [5])
        fmu.exitConfigurationMode()
        assert fmu.getUInt64([channels]) == [5]
        assert refused(fmu.setFloat64, [x], [0.0] * 4) == 3, "there are 5 now"
        fmu.setFloat64([x], np.arange(5.0).tolist())
        instance.enter()
        fmu.exitInitializationMode()
        assert refused(fmu.enterConfigurationMode) == 3
        state = fmu.getFMUState()
        instance.step(PERIOD)
        assert len(fmu.getFloat64([f_hat], 5)) == 5
        fmu.reset()
        assert fmu.getUInt64([channels]) == [4]
        fmu.setFMUState(state)
        assert fmu.getUInt64([channels]) == [5]
        fmu.freeFMUState(state)


@pytest.mark.slow
@pytest.mark.parametrize("name", SYSTEMS)
def test_valid_and_at_home_in_fmpy(folder, name):
    path = made(folder, name, 4, MOST)
    assert check(path).ok
    assert not fmpy.validation.validate_fmu(str(path))
    signals = inputs(4)
    table = np.zeros(len(T), [("time", float), ("x", float, (4,)), ("g", float, (4,))])
    table["time"] = T
    for label, values in signals.items():
        table[label[0]][:, int(label[2])] = values
    here, there = (
        fmpy.simulate_fmu(str(each), input=table, stop_time=T[-1], output_interval=PERIOD, output=["f_hat"],
                          fmi_type="CoSimulation")["f_hat"]
        for each in (path, made(folder, name, 4))
    )  # fmt: skip
    np.testing.assert_array_equal(here, there)


def test_what_cannot_have_channels_to_choose(tmp_path):
    sampled = FILTER.sampled(PERIOD)
    for system, options, message in (
        (sampled, {"fmi": "2.0"}, "arrays of FMI 3"),
        (sampled, {"arrays": False}, "arrays of FMI 3"),
        ([FILTER, GENERAL], {}, "one filter for all channels"),
        (sampled, {"inertia": "full"}, "an inertia that is one number"),
        (sampled, {"inertia": [1.0, 2.0]}, "an inertia that is one number"),
        (sampled, {"channels": 7}, "1 <= channels <= max_channels .* got 7 and 6"),
        (sampled, {"channels": ["a", "b"]}, "channels without names"),
    ):
        fmi = options.pop("fmi", "3.0")
        ports = FmuPorts(max_channels=MOST, **options)
        with pytest.raises(ValueError, match=f"max_channels needs {message}"):
            export_fmu(system, tmp_path / "no.fmu", fmi=fmi, platforms=(), ports=ports)
    assert not list(tmp_path.iterdir())
