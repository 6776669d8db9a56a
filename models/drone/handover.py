"""The tuned filter handed over: as FMUs and as C, each replayed on a recorded flight."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import control as ct
import fmpy
import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl.codegen import CompilerError, compile_sources, export_c, find_compiler
from phyfilter_ctl.filter import SampledPhyFilter
from phyfilter_ctl.filterfile import Signals
from phyfilter_ctl.fmi import FmuExperiment, export_fmu
from phyfilter_ctl.fmi.replay import Reference, write_reference
from phyfilter_ctl.learned import Chebyshev

from .diagram import controller_part, filter_part, vehicle_part
from .experiment import Flights, fly
from .flights import Scenario, conditions
from .methods import Method, estimator
from .params import params

__all__ = [
    "HandOver",
    "controller_system",
    "filter_system",
    "hand_over",
    "record_flight",
    "sampled_filter",
    "vehicle_system",
]

FloatArray = NDArray[np.float64]
Fmi = Literal["2.0", "3.0"]

_NAME = "drone_filter"
_AXES = range(3)
_SIGNALS = Signals(["x", "y", "z"], unit_x="kg m/s", unit_g="N", unit_f="N")
# Of the exports of the repository: a method that needs no training.
_PLAIN = Method("observer", 2.0, 6.0)

_REPLAY = """\
#include <stdio.h>

#include "{name}.h"

int main(void) {{
  static {name} filter;
  double v[9], f_hat[3];
  if ({name}_init(&filter, &{name}_parameters)) return 1;
  for (;;) {{
    for (int i = 0; i < 9; i++)
      if (scanf("%lf", v + i) != 1) return i ? 2 : 0;
    if ({name}_step(&filter, v, v + 3, v + 6, NULL, f_hat)) return 3;
    printf("%.17g %.17g %.17g\\n", f_hat[0], f_hat[1], f_hat[2]);
  }}
}}
"""


@dataclass(frozen=True)
class HandOver:
    """What was handed over, and how far it is from what flew.

    Attributes
    ----------
    fmus : dict of str to Path
        By FMI version; empty where there is no C compiler.
    c : Path or None
        Folder of C sources.
    samples : int
        Of the flight that was replayed.
    differences : dict of str to float
        Largest difference of f_hat from the one in flight, N: through the FMUs in FMPy ("fmi2", "fmi3") and through the
        compiled C ("c").
    message : str
        What was done, or what is left out and what would bring it.
    """

    fmus: Mapping[str, Path]
    c: Path | None
    samples: int
    differences: Mapping[str, float]
    message: str

    @property
    def fmu_max_abs_difference(self) -> float | None:
        """The larger one of both FMUs, N; None where there are none."""
        found = [value for name, value in self.differences.items() if name.startswith("fmi")]
        return max(found) if found else None


@dataclass(frozen=True)
class _Record:
    """Inputs and output of the filter in one flight, (N, 3) each."""

    x: FloatArray
    g: FloatArray
    f_theta: FloatArray
    f_hat: FloatArray

    @property
    def inputs(self) -> dict[str, FloatArray]:
        return {"x": self.x, "g": self.g, "f_theta": self.f_theta}

    @property
    def time(self) -> FloatArray:
        return params().sampling.dt * np.arange(len(self.x), dtype=np.float64)


def sampled_filter(method: Method) -> SampledPhyFilter:
    """The PhyFilter that a method flies with.

    Parameters
    ----------
    method : Method

    Raises
    ------
    ValueError
        If the method has none.

    Examples
    --------
    >>> sampled_filter(Method("observer", 2.0, 6.0)).filter.a.tolist()
    [6.0]
    """
    block = estimator(method)
    if block is None or block.filter is None:
        raise ValueError(
            f"{method.name}: expected a method with a PhyFilter (observer, phyfilter, phyfilter_type2) to hand over"
        )
    return block.filter.sampled


def record_flight(
    method: Method,
    model: Chebyshev | None = None,
    *,
    seed: int = 0,
    scenario: Scenario = "wind",
    duration: float | None = None,
) -> Flights:
    """One flight in CasADi's virtual machine, with the signals at the filter.

    Parameters
    ----------
    method : Method
    model : Chebyshev, optional
        SEER-I's model, for the methods that use it.
    seed : int
    scenario : {"mass", "wind"}
    duration : float, optional
        s; None means that of ``params.toml``.

    Raises
    ------
    ValueError
        If the method has no PhyFilter.

    Examples
    --------
    >>> record_flight(Method("observer", 2.0, 6.0), duration=0.1).signals["f_hat"].shape
    (1, 51, 3)
    """
    sampled_filter(method)
    keep = ("r", "r_ref", "v_m", "g", "f_hat", *(("f_theta",) if method.uses_seer else ()))
    # Not in C: what it is compared with is.
    return fly(method, conditions([seed], scenario), model, keep=keep, duration=duration, backend="vm")


def hand_over(
    method: Method,
    model: Chebyshev | None,
    folder: str | Path,
    *,
    flight: Flights | None = None,
) -> HandOver:
    """Export the filter of a method as FMU (FMI 2.0 and 3.0) and C, and replay a flight through all of them.

    Parameters
    ----------
    method : Method
    model : Chebyshev or None
        SEER-I's model, for the methods that use it; it flies where ``flight`` is None.
    folder : str or Path
        Made if it is not there; its parent must be. ``drone_filter_fmi2.fmu``, ``drone_filter_fmi3.fmu``, ``c/``, and
        the flight as ``flight_in.csv`` and ``flight_out.csv``; each is replaced whole or not at all.
    flight : Flights, optional
        Of this method, with v_m, g, f_hat and, where it has one, f_theta; its first one is replayed. None: the one of
        :func:`record_flight`.

    Returns
    -------
    HandOver
        Without a C compiler nothing is written; the message says so.

    Raises
    ------
    ValueError
        If the method has no PhyFilter, or the flight lacks a signal or failed.
    FileNotFoundError, FileExistsError
        If the folder cannot be made, or its ``c`` holds other files.
    CompilerError
        If the compiler fails.
    """
    sampled = sampled_filter(method)
    target = Path(folder)
    if not target.parent.is_dir():
        raise FileNotFoundError(f"{folder}: there is no folder {target.parent}")
    if target.exists() and not target.is_dir():
        raise FileExistsError(f"{folder}: is a file, expected a folder")
    record = _record(method, record_flight(method, model) if flight is None else flight)
    try:
        find_compiler()
    except CompilerError as error:
        return HandOver(
            {}, None, len(record.x), {},
            f"no FMU and no C of the filter, and no replay through them: {error}. "
            "pip install 'phyfilter-ctl[cross]' brings a compiler",
        )  # fmt: skip
    target.mkdir(exist_ok=True)
    c = export_c(sampled, target / "c", channels=3, name=_NAME, signals=_SIGNALS)
    differences = {"c": _difference(_through_c(c, sampled, record), record)}
    fmus: dict[str, Path] = {}
    versions: tuple[Fmi, ...] = ("2.0", "3.0")
    for version in versions:
        path = target / f"{_NAME}_fmi{version[0]}.fmu"
        fmus[version] = export_fmu(
            sampled,
            path,
            fmi=version,
            channels=3,
            name=_NAME,
            signals=_SIGNALS,
            experiment=FmuExperiment(stop=float(record.time[-1]), step=sampled.dt),
        )
        differences[f"fmi{version[0]}"] = _difference(_through_fmpy(path, version, record), record)
    _write_flight(target, record)
    worst = max(differences.values())
    message = (
        f"FMI 2.0, FMI 3.0 and C repeat the flight's {len(record.x)} samples of f_hat within {worst:.2g} N"
    )
    return HandOver(fmus, c, len(record.x), differences, message)


def vehicle_system() -> ct.InterconnectedSystem:
    """The vehicle in still air, for its export: commands and noise in, measurements and truth out."""
    return vehicle_part()


def controller_system() -> ct.InterconnectedSystem:
    """The controller at 2 rad/s, for its export."""
    return controller_part(_PLAIN)


def filter_system() -> ct.InterconnectedSystem:
    """The observer of order 1 at 6 rad/s with its known force, for its export."""
    part = filter_part(_PLAIN)
    assert part is not None
    return part


def _record(method: Method, flight: Flights) -> _Record:
    if flight.method != method:
        raise ValueError(
            f"flight: expected one of {method.name} with these gains, got one of {flight.method.name}"
        )
    needed = ["v_m", "g", "f_hat", *(["f_theta"] if method.uses_seer else [])]
    missing = [name for name in needed if name not in flight.signals]
    if missing:
        raise ValueError(
            f"flight: expected the signals {', '.join(needed)}, got none called {', '.join(missing)}; "
            "record_flight keeps them"
        )
    signals = {name: flight.signals[name][0] for name in needed}
    if not all(np.isfinite(values).all() for values in signals.values()):
        raise ValueError(f"flight: expected one that came to its end; {flight.message}")
    return _Record(
        params().vehicle.mass * signals["v_m"],
        signals["g"],
        signals.get("f_theta", np.zeros_like(signals["g"])),
        signals["f_hat"],
    )


def _difference(f_hat: FloatArray, record: _Record) -> float:
    return float(np.abs(f_hat - record.f_hat).max())


def _through_c(folder: Path, sampled: SampledPhyFilter, record: _Record) -> FloatArray:
    """f_hat of the exported sources, compiled with a main of our own."""
    sources = {
        path.name: path.read_text(encoding="utf-8")
        for path in folder.iterdir()
        if path.suffix in (".c", ".h") and path.name != "main.c"
    }
    # The step takes the g that was held over the interval; the diagram's block is given the one that acts from now on.
    g = np.vstack([record.g[:1], record.g[:-1]]) if sampled.g == "hold" else record.g
    table = np.hstack([record.x, g, record.f_theta])
    text = "\n".join(" ".join(map(repr, row)) for row in table.tolist()) + "\n"
    with tempfile.TemporaryDirectory(prefix="phyfilter-") as scratch:
        program = Path(scratch, "replay.exe")
        sources["replay.c"] = _REPLAY.format(name=_NAME)
        compile_sources(sources, program, kind="program", name=_NAME)
        run = subprocess.run([str(program)], input=text, capture_output=True, text=True, check=False)
    if run.returncode:
        raise RuntimeError(f"{_NAME} in C ends with status {run.returncode} on the recorded flight")
    return np.array(run.stdout.split(), dtype=float).reshape(-1, len(_AXES))


def _through_fmpy(path: Path, version: Fmi, record: _Record) -> FloatArray:
    """f_hat of the FMU, run by FMPy.

    The FMU takes a sample at the end of a step, FMPy sets inputs at its beginning: each is given a sample early. The
    first serves the start as well: FMPy takes the earlier one of two rows of the same time before the first step.
    """
    time = record.time
    at = np.concatenate([[time[0] - time[1], time[0]], time[:-1]])
    early = {name: np.vstack([v[:1], v[:1], v[1:]]) for name, v in record.inputs.items()}
    if version == "2.0":
        columns = {f"{name}[{i}]": values[:, i] for name, values in early.items() for i in _AXES}
        outputs = [f"f_hat[{i}]" for i in _AXES]
    else:
        columns, outputs = early, ["f_hat"]
    table = np.zeros(len(at), [("time", float), *((n, float, v.shape[1:]) for n, v in columns.items())])
    table["time"] = at
    for name, values in columns.items():
        table[name] = values
    result = fmpy.simulate_fmu(
        str(path),
        start_time=0.0,
        stop_time=float(time[-1]),
        output_interval=params().sampling.dt,
        fmi_type="CoSimulation",
        input=table,
        output=outputs,
    )
    if version == "2.0":
        return np.column_stack([result[name] for name in outputs])
    return np.asarray(result["f_hat"])


def _write_flight(folder: Path, record: _Record) -> None:
    """The flight in the form that ``phyfilter-ctl fmu check --reference`` takes."""
    reference = Reference(
        record.time,
        {f"{name}[{i}]": values[:, i] for name, values in record.inputs.items() for i in _AXES},
        {f"f_hat[{i}]": record.f_hat[:, i] for i in _AXES},
    )
    write_reference(folder / "flight_out.csv", reference)
