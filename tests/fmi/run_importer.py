"""Runs one FMU in one foreign importer, in a process of its own: a crash there is a failed test, not the end of all.

    run_importer.py IMPORTER FMU STEP  < {"inputs": {name: [values]}, "outputs": [names]}  > [[values], ...]

One line of inputs is set before each step; the outputs are read at the start and after each step.
"""

import json
import sys
from pathlib import Path


def cosim(path, step, inputs, outputs):
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimManipulator import CosimManipulator
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    execution = CosimExecution.from_step_size(step * 1e9)
    slave = execution.add_local_slave(CosimLocalSlave(str(path), "peer"))
    observer, manipulator = CosimObserver.create_last_value(), CosimManipulator.create_override()
    execution.add_observer(observer)
    execution.add_manipulator(manipulator)
    variables = execution.slave_variables(slave)
    references = {variable.name.decode(): variable.reference for variable in variables}
    rows = []
    for k in range(len(next(iter(inputs.values())))):
        manipulator.slave_real_values(slave, [references[n] for n in inputs], [inputs[n][k] for n in inputs])
        assert execution.step(), "step failed"
        rows.append(list(observer.last_real_values(slave, [references[n] for n in outputs])))
    return rows


def ecos(path, step, inputs, outputs):
    from ecospy import EcosSimulation, EcosSimulationStructure

    structure = EcosSimulationStructure()
    structure.add_model("peer", str(path))
    rows = []
    with EcosSimulation(structure=structure, step_size=step) as simulation:
        simulation.init()
        for k in range(len(next(iter(inputs.values())))):
            for name in inputs:
                simulation.set_real(f"peer::{name}", inputs[name][k])
            simulation.step()
            rows.append([simulation.get_real(f"peer::{name}") for name in outputs])
    return rows


def main():
    importer, path, step = sys.argv[1:]
    task = json.load(sys.stdin)
    rows = {"cosim": cosim, "ecos": ecos}[importer](Path(path), float(step), task["inputs"], task["outputs"])
    print("\n" + json.dumps(rows))


if __name__ == "__main__":
    main()
