"""Exported FMUs in other people's importers: libcosimpy (FMI 2) and ecospy (FMI 2 and 3), beside FMPy elsewhere."""

import json
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from exported_fmus import FILTER, PERIOD, Instance, exported

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
    path = exported("sampled", fmi, arrays=False)
    found = run(importer, path, PERIOD, inputs, [f"f_hat[{i}]" for i in range(3)])
    # The first sample is taken at the start, on the start values of the inputs.
    expected = FILTER.sampled(PERIOD).run(np.vstack([np.zeros((1, 3)), x]), np.vstack([np.zeros((1, 3)), g]))[
        1:
    ]
    np.testing.assert_allclose(found, expected, rtol=0, atol=ROUNDING)


@pytest.mark.slow
@pytest.mark.parametrize(("importer", "fmi"), CASES)
@pytest.mark.parametrize(("name", "signals", "outputs"), [
    ("oscillator", {"force": 3.0}, ["place", "pull"]), ("loop", {"goal": 1.5, "f_theta": 0.25}, ["s", "v", "f_hat"]),
])  # fmt: skip
def test_models(importer, fmi, name, signals, outputs):
    """The same steps as through FMPy's wrappers."""
    path = exported(name, fmi, arrays=False)
    inputs = {signal: [value] * 30 for signal, value in signals.items()}
    found = run(importer, path, 0.005, inputs, outputs)
    with Instance(path) as fmu:
        fmu.start()
        for row in found:
            fmu.step(0.005, **signals)
            np.testing.assert_allclose(row, fmu.get(*outputs), rtol=0, atol=1e-9)
