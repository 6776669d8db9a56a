"""Events in FMUs, by an importer that shares no code: FMPy, whose CVODE locates them in model exchange by itself."""

import fmpy
import fmpy.validation
import hybrid_models as models
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl.fmi import FmuExperiment, FmuSolver

pytestmark = pytest.mark.slow

# Co-simulation: Dormand-Prince at rtol = 1e-9 inside, over the phases of a run. Model exchange: CVODE at the same: it
# controls the error of steps and finds roots to 1e-9 of one; a thermostat's 20 phases add it up.
TOLERANCE = {"CoSimulation": 1e-6, "ModelExchange": 1e-4}
RUNS = {
    "ball": (models.bouncing_ball, [1.0, 0.0, 1.0], 3.0),
    "thermostat": (models.thermostat, [20.0, 1.0], 40.0),
}


def exported(name, version, folder):
    make, start, end = RUNS[name]
    flat = pf.flatten(make())
    solver = FmuSolver("adaptive", rtol=1e-9, atol=1e-11)
    experiment = FmuExperiment(solver=solver)
    return flat, pf.export_fmu(flat, folder / f"{name}.fmu", fmi=version, experiment=experiment), start, end


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("name", RUNS)
def test_importer_meets_the_events(name, version, tmp_path):
    flat, path, start, end = exported(name, version, tmp_path)
    assert fmpy.validation.validate_fmu(str(path)) == []
    description = fmpy.read_model_description(str(path))
    indicators = description.numberOfEventIndicators if version == "2.0" else len(description.eventIndicators)
    assert indicators == len(flat.events)
    states = [unknown.variable.derivative.name for unknown in description.derivatives]
    output = next(variable.name for variable in description.modelVariables if variable.causality == "output")
    times = np.linspace(0.0, end, 31)
    expected = pf.simulate(flat, times, initial_state=start, backend="vm", rtol=1e-10, atol=1e-12)
    for kind, tolerance in TOLERANCE.items():
        found = fmpy.simulate_fmu(
            str(path), fmi_type=kind, stop_time=end, output_interval=end / 30, solver="CVode", relative_tolerance=1e-9,
            start_values=dict(zip(states, start, strict=True)),
        )  # fmt: skip
        # Events add rows to those of the times.
        rows = [np.flatnonzero(np.abs(found["time"] - time) < 1e-9)[-1] for time in times]
        values = np.asarray(expected.outputs).reshape(len(flat.outputs), -1)[0]
        np.testing.assert_allclose(found[output][rows], values, rtol=0.0, atol=tolerance, err_msg=kind)
