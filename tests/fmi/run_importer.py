"""Runs an FMU or a package in a foreign importer, in a process of its own: a crash fails one test, not all.

    run_importer.py IMPORTER FILE STEP  < {"inputs": {name: [values]}, "outputs": [names]}  > [[values], ...]

One line of inputs is set before each step; the outputs are read after each step. In a package (.ssp) names are
component.signal.
"""

import json
import sys
from pathlib import Path


def cosim(path, step, inputs, outputs):
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimManipulator import CosimManipulator
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    if path.suffix == ".ssp":
        execution = CosimExecution.from_ssp_file(str(path), round(step * 1e9))
    else:
        execution = CosimExecution.from_step_size(step * 1e9)
        slave = execution.add_local_slave(CosimLocalSlave(str(path), "peer"))
    observer, manipulator = CosimObserver.create_last_value(), CosimManipulator.create_override()
    execution.add_observer(observer)
    execution.add_manipulator(manipulator)

    def place(label):
        part, _, name = label.rpartition(".")
        owner = execution.slave_index_from_instance_name(part) if part else slave
        (found,) = [v.reference for v in execution.slave_variables(owner) if v.name.decode() == name]
        return owner, found

    sinks, sources = [place(n) for n in inputs], [place(n) for n in outputs]
    rows = []
    for values in zip(*inputs.values(), strict=True):
        for (owner, reference), value in zip(sinks, values, strict=True):
            manipulator.slave_real_values(owner, [reference], [value])
        assert execution.step(), "step failed"
        rows.append([observer.last_real_values(owner, [reference])[0] for owner, reference in sources])
    return rows


def ecos(path, step, inputs, outputs):
    from ecospy import EcosSimulation, EcosSimulationStructure

    def place(label):
        part, _, name = label.rpartition(".")
        return f"{part or 'peer'}::{name}"

    if path.suffix == ".ssp":
        what = {"ssp_path": str(path)}
    else:
        what = {"structure": (structure := EcosSimulationStructure())}
        structure.add_model("peer", str(path))
    rows = []
    with EcosSimulation(**what, step_size=step) as simulation:
        simulation.init()
        for values in zip(*inputs.values(), strict=True):
            for name, value in zip(inputs, values, strict=True):
                simulation.set_real(place(name), value)
            simulation.step()
            rows.append([simulation.get_real(place(name)) for name in outputs])
    return rows


def main():
    importer, path, step = sys.argv[1:]
    task = json.load(sys.stdin)
    rows = {"cosim": cosim, "ecos": ecos}[importer](Path(path), float(step), task["inputs"], task["outputs"])
    print("\n" + json.dumps(rows))


if __name__ == "__main__":
    main()
