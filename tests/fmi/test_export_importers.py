"""Exported FMUs in other people's importers: libcosimpy (FMI 2) and ecospy (FMI 2 and 3), beside FMPy elsewhere."""

import json
import subprocess
import sys
from functools import cache
from pathlib import Path

import fmpy
import numpy as np
import pytest
from exported_fmus import FILTER, PERIOD, Instance, exported

from phyfilter_ctl.fmi import FmuPorts, cosimulate

SCRIPT = Path(__file__).parent / "run_importer.py"
IMPORTERS = {"cosim": "libcosimpy", "ecos": "ecospy"}
CASES = [("cosim", "2.0"), ("ecos", "2.0"), ("ecos", "3.0")]
# The importers' communication step is a difference of their times: rounding of 1e-16 of the time, 1e-13 of the step.
ROUNDING = 1e-11


@cache
def missing(importer):
    """Why an importer cannot be used; "" where it can."""
    package = IMPORTERS[importer]
    run = subprocess.run(
        [sys.executable, "-c", f"import {package}"], capture_output=True, text=True, check=False
    )
    return "" if run.returncode == 0 else f"{package} is not there: {run.stderr.strip().splitlines()[-1]}"


def run(importer, path, step, inputs, outputs):
    if missing(importer):
        pytest.skip(missing(importer))
    answer = subprocess.run(
        [sys.executable, str(SCRIPT), importer, str(path), repr(step)],
        input=json.dumps({"inputs": inputs, "outputs": outputs}), capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert answer.returncode == 0, (answer.stdout + answer.stderr)[-3000:]
    return np.array(json.loads(answer.stdout.splitlines()[-1]))


@pytest.mark.slow
@pytest.mark.parametrize(("importer", "fmi"), CASES)
def test_sampled_filter(importer, fmi):
    rng = np.random.default_rng(6)
    x = np.cumsum(rng.normal(0.0, 0.01, (40, 3)), axis=0)
    g = rng.normal(size=(40, 3))
    inputs = {f"{s}[{i}]": v[:, i].tolist() for s, v in (("x", x), ("g", g)) for i in range(3)}
    path = exported("sampled", fmi, ports=FmuPorts(arrays=False))
    found = run(importer, path, PERIOD, inputs, [f"f_hat[{i}]" for i in range(3)])
    # The first sample is taken at the start, on the start values of the inputs.
    expected = FILTER.sampled(PERIOD).run(np.vstack([np.zeros((1, 3)), x]), np.vstack([np.zeros((1, 3)), g]))[
        1:
    ]
    np.testing.assert_allclose(found, expected, rtol=0, atol=ROUNDING)


@pytest.mark.slow
def test_arrays_and_scalars_are_one_model_in_every_host():
    """x as one array and as x[0], x[1], x[2]: in FMPy, in this library's importer, and scalars in ecos."""
    times = PERIOD * np.arange(31)
    x, g = (np.sin(np.outer(times, w)) for w in ([9.0, 7.0, 5.0], [3.0, 4.0, 6.0]))
    signals = {f"{s}[{i}]": v[:, i] for s, v in (("x", x), ("g", g)) for i in range(3)}
    outputs = [f"f_hat[{i}]" for i in range(3)]
    found = {}
    for arrays in (True, False):
        path = exported("sampled", "3.0", ports=FmuPorts(arrays=arrays))
        own = cosimulate(
            {"fmu": path}, timepts=times, inputs={f"fmu.{name}": values for name, values in signals.items()},
            outputs=[f"fmu.{name}" for name in outputs],
        )  # fmt: skip
        found["own", arrays] = own.outputs.T
        columns = {"x": x, "g": g} if arrays else signals
        kinds = [(name, float, values.shape[1:]) for name, values in columns.items()]
        table = np.zeros(len(times), [("time", float), *kinds])
        table["time"] = times
        for name, values in columns.items():
            table[name] = values
        wanted = ["f_hat"] if arrays else outputs
        result = fmpy.simulate_fmu(
            str(path), input=table, output=wanted, stop_time=times[-1], output_interval=PERIOD,
            fmi_type="CoSimulation",
        )  # fmt: skip
        found["fmpy", arrays] = np.column_stack([result[name] for name in wanted])
    for host in ("own", "fmpy"):
        np.testing.assert_array_equal(found[host, True], found[host, False])
    # FMPy sets the inputs of a step at its start, and reads outputs before the next ones are set.
    np.testing.assert_allclose(found["fmpy", True][1:], found["own", True][1:], rtol=0, atol=ROUNDING)
    inputs = {name: values[:-1].tolist() for name, values in signals.items()}
    in_ecos = run("ecos", exported("sampled", "3.0", ports=FmuPorts(arrays=False)), PERIOD, inputs, outputs)
    np.testing.assert_allclose(in_ecos, found["fmpy", False][1:], rtol=0, atol=ROUNDING)


@pytest.mark.slow
@pytest.mark.parametrize(("importer", "fmi"), CASES)
@pytest.mark.parametrize(("name", "signals", "outputs"), [
    ("oscillator", {"force": 3.0}, ["place", "pull"]), ("loop", {"goal": 1.5, "f_theta": 0.25}, ["s", "v", "f_hat"]),
])  # fmt: skip
def test_models(importer, fmi, name, signals, outputs):
    """The same steps as through FMPy's wrappers."""
    path = exported(name, fmi, ports=FmuPorts(arrays=False))
    inputs = {signal: [value] * 30 for signal, value in signals.items()}
    found = run(importer, path, 0.005, inputs, outputs)
    with Instance(path) as fmu:
        fmu.start()
        for row in found:
            fmu.step(0.005, **signals)
            np.testing.assert_allclose(row, fmu.get(*outputs), rtol=0, atol=1e-9)
