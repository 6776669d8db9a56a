"""Handing over: a system as FMUs and as C, a recorded run replayed through each, and how far each is from it."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import control as ct
import numpy as np

from .._output import check_folder
from .._renamed import takes_former, takes_signals
from .._sections import FloatArray
from ..codegen import CompilerError, export_c, find_compiler
from ..codegen.compiler import compile_sources
from ..diagram import FlatModel, flatten
from ..filter import SampledPhyFilter
from .description import FmuExperiment, FmuSolver
from .export import export_fmu
from .fmu import Fmu
from .inspect import Scalar
from .replay import Reference, replay, replay_in_fmpy

__all__ = ["HandOver", "hand_over"]

Format = Literal["C", "FMI 2.0", "FMI 3.0"]

# Reads rows of inputs, writes rows of outputs. The filter's step takes x, g and f_theta, one after the other.
_FILTER_MAIN = """\
#include <stdio.h>

#include "{name}.h"

int main(void) {{
  static {name} self;
  double u[{read}], y[{n_f}];
  if ({name}_init(&self, &{name}_parameters)) return 3;
  for (;;) {{
    for (int i = 0; i < {read}; i++)
      if (scanf("%lf", u + i) != 1) return i ? 2 : 0;
    if ({name}_step(&self, u, u + {n_x}, u + 2 * {n_x}, NULL, y)) return 3;
    for (int i = 0; i < {n_f}; i++) printf("%.17g ", y[i]);
    printf("\\n");
  }}
}}
"""

_DIAGRAM_MAIN = """\
#include <stdio.h>

#include "{name}.h"

int main(void) {{
  static {name} self;
  static pf_real u[{inputs} + 1], y[{outputs} + 1], rest[{outputs} + 1];
  const long steps = (long)({dt!r} / {capital}_STEP + 0.5);
  const double off = steps * {capital}_STEP - {dt!r};
  if (steps < 1 || off > 1e-9 * {dt!r} || -off > 1e-9 * {dt!r}) return 4;
  if ({name}_init(&self)) return 3;
  for (long k = 0; k < {samples}; k++) {{
    for (int i = 0; i < {inputs}; i++)
      if (scanf("%lf", u + i) != 1) return 2;
    for (long j = 0; j < steps; j++)
      if ({name}_step(&self, u, j ? rest : y)) return 3;
    for (int i = 0; i < {outputs}; i++) printf("%.17g ", y[i]);
    printf("\\n");
  }}
  return 0;
}}
"""

_STATUS = {
    2: "reads a row that is not whole",
    3: "refuses a sample",
    4: "has a step of which the record's is no multiple",
}


@dataclass(frozen=True, eq=False)
class HandOver:
    """What was handed over, and how far it is from the record.

    Parameters
    ----------
    samples : int
        Of the record.
    exports : dict of str to Path
        By format: files of FMUs, the folder of C sources. Empty where there is no C compiler.
    differences : dict of str to dict of str to float
        By format, the largest difference of every recorded output, in its unit.
    message : str
        What is left out and what would bring it; "" if nothing is.
    """

    samples: int
    exports: Mapping[str, Path] = field(default_factory=dict)
    differences: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    message: str = ""

    @property
    def largest(self) -> dict[str, float]:
        """The largest difference of any output, by format."""
        return {name: max(found.values()) for name, found in self.differences.items()}

    @property
    def worst(self) -> float | None:
        """The largest of all; None where nothing was handed over."""
        return max(self.largest.values(), default=None)


@takes_signals
@takes_former
def hand_over(
    system: ct.InputOutputSystem | FlatModel | SampledPhyFilter,
    folder: str | Path,
    record: Reference | Callable[[], Reference],
    *,
    name: str,
    formats: Sequence[Format] = ("C", "FMI 2.0", "FMI 3.0"),
    solver: FmuSolver | None = None,
    parameters: Mapping[str, Scalar] | None = None,
    inputs_at: Literal["start", "end"] = "end",
    importer: Literal["own", "fmpy"] = "own",
    report: Callable[[str], object] | None = None,
) -> HandOver:
    """Export a system, replay a recorded run through every export, and say how far each is from the record.

    Parameters
    ----------
    system : control.InputOutputSystem, FlatModel or SampledPhyFilter
        A block, a diagram, or a filter.
    folder : str or Path
        Made if it is not there; its parent must be. It gets ``NAME_c/``, ``NAME_fmi2.fmu``, ``NAME_fmi3.fmu``, and the
        record as ``NAME_in.csv`` and ``NAME_out.csv``, which ``phyfilter-ctl fmu check --reference`` takes; each is
        replaced whole or not at all.
    record : Reference, or a function () -> Reference
        Inputs and outputs at equally spaced times, from :func:`simulate` or from a robot; its outputs may be some of
        the system's. A function is called once it is clear that there is a place to write to.
    name : str
        Of files and symbols, a C identifier.
    formats : sequence of {"C", "FMI 2.0", "FMI 3.0"}
    solver : FmuSolver, optional
        Of FMUs with continuous states.
    parameters : dict, optional
        Of FMUs in the replay; not for C.
    inputs_at : {"start", "end"}
        For FMUs, as for :func:`replay`: "end" for sampled blocks, "start" for a continuous system on held inputs.
    importer : {"own", "fmpy"}
        What runs the FMUs: this library, or FMPy, which shares no code with it and takes no ``parameters``.
    report : function of a text, optional
        Called at the beginning of every export with its format.

    Returns
    -------
    HandOver
        Without a C compiler nothing is written; the message says so.

    Raises
    ------
    ValueError
        If the record has no such inputs, outputs or spacing; for parameters that would be left out.
    FileNotFoundError, FileExistsError
        If the folder cannot be made, or the one of C sources holds other files.
    CompilerError
        If the compiler fails.

    Examples
    --------
    >>> from phyfilter_ctl import PhyFilter
    >>> sampled, t = PhyFilter([20.0]).sampled(0.002), 0.002 * np.arange(100)
    >>> x, f_theta = np.sin(t), np.zeros(100)
    >>> signals = {"x[0]": x, "g[0]": f_theta, "f_theta[0]": f_theta}
    >>> record = Reference(t, signals, {"f_hat[0]": sampled.run(x[:, None])[:, 0]})
    >>> with tempfile.TemporaryDirectory() as parent:
    ...     handed = hand_over(sampled, Path(parent, "wing"), record, name="wing")
    >>> handed.samples, sorted(handed.exports), handed.worst < 1e-12
    (100, ['C', 'FMI 2.0', 'FMI 3.0'], True)
    """
    if parameters and ("C" in formats or importer == "fmpy"):
        raise ValueError(
            "parameters: the replay in C or in FMPy takes none; leave these out, or change the system"
        )
    target = check_folder(folder)
    recorded = record() if callable(record) else record
    try:
        find_compiler()
    except CompilerError as error:
        return HandOver(
            len(recorded.times),
            message=f"no FMU and no C of {name}, and no replay through them: {error}. "
            "pip install 'phyfilter-ctl[cross]' brings a compiler",
        )
    target.mkdir(exist_ok=True)
    exports: dict[str, Path] = {}
    differences: dict[str, Mapping[str, float]] = {}
    dt = float(recorded.times[1] - recorded.times[0])
    for form in formats:
        if report is not None:
            report(form)
        if form == "C":
            exports[form] = export_c(system, target / f"{name}_c", name=name)
            found = _through_c(exports[form], system, recorded, name, dt)
        else:
            version: Literal["2.0", "3.0"] = "2.0" if form == "FMI 2.0" else "3.0"
            experiment = FmuExperiment(stop=float(recorded.times[-1]), step=dt, solver=solver)
            target_file = target / f"{name}_fmi{version[0]}.fmu"
            exports[form] = export_fmu(system, target_file, fmi=version, name=name, experiment=experiment)
            found = _through_fmu(exports[form], recorded, inputs_at, importer, parameters)
        differences[form] = {
            label: float(np.abs(found[label] - values).max()) for label, values in recorded.outputs.items()
        }
    recorded.write(target / f"{name}_out.csv")
    return HandOver(len(recorded.times), exports, differences)


def _through_fmu(
    path: Path,
    record: Reference,
    inputs_at: Literal["start", "end"],
    importer: Literal["own", "fmpy"],
    parameters: Mapping[str, Scalar] | None,
) -> dict[str, FloatArray]:
    if importer == "fmpy":
        return replay_in_fmpy(path, record, inputs_at=inputs_at)
    labels, outputs = replay(Fmu(path, parameters=parameters or {}), record, inputs_at=inputs_at)
    return dict(zip(labels, outputs.T, strict=True))


def _through_c(
    folder: Path,
    system: ct.InputOutputSystem | FlatModel | SampledPhyFilter,
    record: Reference,
    name: str,
    dt: float,
) -> dict[str, FloatArray]:
    """Outputs of the exported sources, compiled with a main of our own."""
    if isinstance(system, SampledPhyFilter):
        labels, (x, g, f_theta) = list(record.outputs), _filter_inputs(system, record)
        table, n_x = np.hstack([x, g, f_theta]), x.shape[1]
        main = _FILTER_MAIN.format(name=name, n_x=n_x, n_f=f_theta.shape[1], read=table.shape[1])
    else:
        flat = system if isinstance(system, FlatModel) else flatten(system)
        labels = [entry.name for entry in flat.outputs]
        table = np.column_stack([
            np.broadcast_to(record.inputs.get(entry.name, entry.start), record.times.shape) for entry in flat.inputs
        ])  # fmt: skip
        main = _DIAGRAM_MAIN.format(
            name=name,
            capital=name.upper(),
            inputs=len(flat.inputs),
            outputs=len(labels),
            dt=dt,
            samples=len(table),
        )
    sources = {
        path.name: path.read_text(encoding="utf-8")
        for path in folder.iterdir()
        if path.suffix in (".c", ".h") and path.name != "main.c"
    }
    text = "\n".join(" ".join(map(repr, row)) for row in table.tolist()) + "\n"
    with tempfile.TemporaryDirectory(prefix="phyfilter-") as scratch:
        program = Path(scratch, "replay.exe")
        compile_sources(sources | {"replay.c": main}, program, kind="program", name=name)
        run = subprocess.run([str(program)], input=text, capture_output=True, text=True, check=False)
    if run.returncode:
        why = _STATUS.get(run.returncode, f"ends with status {run.returncode}")
        raise ValueError(f"record: {name} in C {why}")
    values = np.array(run.stdout.split(), dtype=float).reshape(len(record.times), -1)
    return dict(zip(labels, values.T, strict=True))


def _filter_inputs(sampled: SampledPhyFilter, record: Reference) -> list[FloatArray]:
    """x, g and f_theta as the filter's step in C takes them."""
    rows: dict[str, list[FloatArray]] = {"x": [], "g": [], "f_theta": []}
    for label, values in record.inputs.items():
        if (base := label.split("[")[0]) not in rows:
            raise ValueError(f"record: expected inputs x, g and f_theta of a filter, got {label}")
        rows[base].append(values)
    if not all(rows.values()):
        raise ValueError(
            f"record: expected inputs x, g and f_theta of a filter, got {', '.join(record.inputs)}"
        )
    x, g, f_theta = (np.column_stack(entries) for entries in rows.values())
    if (
        sampled.sampling.g == "hold"
    ):  # the step takes the g that was held over the interval, a diagram the one from now on
        g = np.vstack([g[:1], g[:-1]])
    return [x, g, f_theta]
