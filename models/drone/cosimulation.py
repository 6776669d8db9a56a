"""The loop as FMUs in a system structure package, co-simulated at the controllers' rate, against the diagram.

A co-simulation FMU advances on inputs that are set before the step and runs its sampled blocks at the step's end. What
it samples there is as old as those inputs: one sample late, unless the part that the signal comes from has made the
step already (Gauss-Seidel). Filter and controller answer each other within an instant, each with samples of its own, so
one of the wires between them is late in any order; so is a command into a vehicle that samples it.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import control as ct
import numpy as np
from numpy.typing import ArrayLike, NDArray

from phyfilter_ctl.blocks import Variable, signal_names
from phyfilter_ctl.diagram import FlatModel, flatten
from phyfilter_ctl.fmi import (
    FmuExperiment,
    FmuSolver,
    Master,
    System,
    Wire,
    cosimulate,
    cut_diagram,
    export_fmu,
    write_ssp,
)
from phyfilter_ctl.learned import Chebyshev
from phyfilter_ctl.simulation import simulate
from phyfilter_ctl.study import flight_signals, unit_noise

from .diagram import MEASURED, NOISES, build
from .experiment import start_state
from .flights import Scenario, conditions, timepts
from .late_wires import late_wires
from .methods import Method
from .params import params

__all__ = ["CUTS", "CoSimulation", "Cut", "CutRun", "cosimulation"]

FloatArray = NDArray[np.float64]
Fmi = Literal["2.0", "3.0"]
_AXES = range(3)


@dataclass(frozen=True)
class Cut:
    """A way to cut the loop and to run the parts.

    Attributes
    ----------
    name : str
    parts : tuple of str
        FMUs, in the order of Gauss-Seidel.
    scheme : {"jacobi", "gauss-seidel"}
    late : tuple of str
        Signals between the parts that are sampled one instant late.
    """

    name: str
    parts: tuple[str, ...]
    scheme: Literal["jacobi", "gauss-seidel"]
    late: tuple[str, ...]


_THREE = ("vehicle", "estimator", "controller")
CUTS = (
    Cut("three_jacobi", _THREE, "jacobi", (*MEASURED, "f_hat", "F", "thrust")),
    Cut("three", _THREE, "gauss-seidel", ("F", "thrust")),
    Cut("two", ("body", "computer"), "gauss-seidel", ()),
)
"""Vehicle, filter and controller as FMUs of their own, run side by side or one after the other; and two FMUs without a
late wire: the body, which has no sampled block, and a computer with filter, controller and the delay of commands."""


@dataclass(frozen=True, eq=False)
class CutRun:
    """What became of a cut.

    Attributes
    ----------
    cut : Cut
    position : (N, 3) array
        m.
    difference : float
        Largest distance of the position from that of the diagram, m.
    unexplained : float
        From that of the diagram with one sample of delay in the late wires, m.
    seconds : float
        That the co-simulation took.
    """

    cut: Cut
    position: FloatArray
    difference: float
    unexplained: float
    seconds: float


@dataclass(frozen=True, eq=False)
class CoSimulation:
    """Co-simulations of one flight.

    Attributes
    ----------
    step : float
        Of the communication, s.
    time : (N,) array
        s.
    noise : (18, N) array
        Of the diagram's inputs; Jacobi flies without that of the sensors.
    position : (N, 3) array
        In the diagram, m.
    runs : dict of str to CutRun
        By name of the cut.
    """

    step: float
    time: FloatArray
    noise: FloatArray
    position: FloatArray
    runs: Mapping[str, CutRun]

    @property
    def duration(self) -> float:
        """Of the flight, s."""
        return float(self.time[-1])

    @property
    def differences(self) -> dict[str, float]:
        """Largest distance from the diagram by cut, m."""
        return {name: run.difference for name, run in self.runs.items()}


def cosimulation(
    method: Method,
    model: Chebyshev | None = None,
    *,
    duration: float = 20.0,
    seed: int = 0,
    scenario: Scenario = "wind",
    fmi: Fmi = "2.0",
    cuts: Iterable[Cut] = CUTS,
    folder: str | Path | None = None,
) -> CoSimulation:
    """Fly the loop as FMUs and compare with the diagram.

    Parameters
    ----------
    method : Method
        One that estimates the force.
    model : Chebyshev, optional
        SEER-I's model, for the methods that use it.
    duration : float
        s.
    seed : int
        Of mass, wind and noise.
    scenario : {"mass", "wind"}
    fmi : {"2.0", "3.0"}
        Of the FMUs.
    cuts : iterable of Cut
        Of ``CUTS``.
    folder : str or Path, optional
        Where to leave the packages, ``drone_3.ssp`` and ``drone_2.ssp``; None: nowhere.

    Returns
    -------
    CoSimulation

    Raises
    ------
    ValueError
        If the method estimates nothing.
    CompilerError
        If this machine has no C compiler.

    Examples
    --------
    >>> {cut.name: cut.late for cut in CUTS if cut.scheme == "gauss-seidel"}
    {'three': ('F', 'thrust'), 'two': ()}
    """
    loop = build(method, model)
    if "estimator" not in loop.syslist_index:
        raise ValueError(
            f"{method.name}: expected a method with an estimator; its loop has no filter to cut off"
        )
    flight = _Flight(seed, scenario, timepts(duration))
    plain = {False: flight.fly(loop, quiet=False)}
    runs: dict[str, CutRun] = {}
    with tempfile.TemporaryDirectory(prefix="phyfilter-") as scratch:
        for cut in cuts:
            quiet = cut.scheme == "jacobi"
            if quiet not in plain:
                plain[quiet] = flight.fly(loop, quiet=quiet)
            signals = plain[quiet]
            package = Path(scratch if folder is None else folder, f"drone_{len(cut.parts)}.ssp")
            if all(run.cut.parts != cut.parts for run in runs.values()):
                flight.write(_cut(cut, method, model), package, fmi, signals)
            begin = time.perf_counter()
            r = flight.cosimulated(cut, package)
            seconds = time.perf_counter() - begin
            late = {f"{_owner(loop, name)}.{name}": signals[name][0] for name in cut.late}
            expected = signals["r"]
            if late:
                expected = flight.fly(late_wires(loop, late, params().sampling.dt), quiet=quiet)["r"]
            runs[cut.name] = CutRun(cut, r, _apart(r, signals["r"]), _apart(r, expected), seconds)
    return CoSimulation(params().sampling.dt, flight.time, flight.noise, plain[False]["r"], runs)


def _apart(r: FloatArray, other: FloatArray) -> float:
    return float(np.max(np.linalg.norm(r - other, axis=1)))


def _owner(loop: ct.InterconnectedSystem, signal: str) -> str:
    """The block that a signal comes from."""
    return next(b.name for b in loop.syslist if signal in signal_names(b.output_labels))


def _cut(cut: Cut, method: Method, model: Chebyshev | None) -> System:
    if "body" in cut.parts:
        apart = build(method, model, delay_apart=True)
        return cut_diagram(apart, {"body": ["vehicle"], "computer": ["controller", "estimator", "late"]})
    return cut_diagram(build(method, model), {name: [name] for name in cut.parts})


class _Flight:
    """One flight, in one piece or in parts."""

    def __init__(self, seed: int, scenario: Scenario, time: FloatArray) -> None:
        self.time = time
        self.settings = {name: row[0] for name, row in conditions([seed], scenario).parameters().items()}
        self.noise = unit_noise([seed], 3 * len(NOISES), len(time))[0]
        # Two samples without: the FMUs start on sensors at rest, and Gauss-Seidel looks one sample ahead.
        self.noise[:, :2] = 0.0

    def inputs(self, *, quiet: bool) -> FloatArray:
        """Noise of the diagram's inputs, (18, N); with ``quiet`` of the wind alone."""
        names = np.repeat(NOISES, len(_AXES))
        return np.where((names == "n_wind")[:, np.newaxis], self.noise, 0.0) if quiet else self.noise

    def fly(self, loop: ct.InterconnectedSystem, *, quiet: bool) -> dict[str, FloatArray]:
        """Signals (N, k) of a diagram."""
        response = simulate(
            loop,
            self.time,
            self.inputs(quiet=quiet),
            start_state(),
            params=self.settings,
            method="rk4",
            max_step=params().sampling.max_step,
            interpolation="hold",
        )
        signals, failed = flight_signals([response], [0], signal_names(loop.output_labels))
        if failed:
            raise RuntimeError(f"the flight fails: {response.message}")
        return {name: values[0] for name, values in signals.items()}

    def write(self, cut: System, path: Path, fmi: Fmi, signals: Mapping[str, FloatArray]) -> None:
        """The package of a cut; what this flight draws, and the first signals, are start values of the FMUs."""
        first = {f"{name}[{i}]": value for name, rows in signals.items() for i, value in enumerate(rows[0])}
        experiment = FmuExperiment(solver=FmuSolver(step=params().sampling.max_step))
        with tempfile.TemporaryDirectory(prefix="phyfilter-") as folder:
            files = {name: Path(folder, f"{name}.fmu") for name in cut.parts}
            wires = [wire for wire in cut.connections if isinstance(wire, Wire)]
            for name, part in cut.parts.items():
                assert isinstance(part, ct.InputOutputSystem)
                ends = (
                    (wire.sink.partition(".")[2], wire.source.partition(".")[2])
                    for wire in wires
                    if wire.sink.startswith(f"{name}.")
                )
                inputs = {sink: first[source] for sink, source in ends if source in first}
                flat = _started(flatten(part), inputs, start_state(), self.settings)
                export_fmu(flat, files[name], fmi=fmi, kinds=("cs",), name=name, experiment=experiment)
            outputs = {f"r[{i}]": cut.outputs[f"r[{i}]"] for i in _AXES}
            packed = replace(cut, parts=files, outputs=outputs)
            write_ssp(packed, path, name="drone", stop_time=float(self.time[-1]))

    def cosimulated(self, cut: Cut, package: Path) -> FloatArray:
        """Positions (N, 3)."""
        names = [f"{name}[{i}]" for name in NOISES for i in _AXES]
        given = self.inputs(quiet=cut.scheme == "jacobi").copy()
        if cut.scheme == "gauss-seidel":
            # What a part puts out at the end of its step goes to the next part at once: it has to hold that instant's
            # noise. That of the wind acts over the step and stays.
            ahead = [i for i, name in enumerate(names) if not name.startswith("n_wind")]
            given[ahead, :-1] = self.noise[ahead, 1:]
        response = cosimulate(
            package,
            self.time,
            inputs=dict(zip(names, given, strict=True)),
            master=Master(scheme=cut.scheme, order=cut.parts if cut.scheme == "gauss-seidel" else None),
        )
        return np.asarray(response.outputs).T


def _started(
    flat: FlatModel,
    inputs: Mapping[str, ArrayLike],
    states: Mapping[str, ArrayLike],
    parameters: Mapping[str, ArrayLike],
) -> FlatModel:
    """The model with other start values; names that are not its own change nothing."""

    def changed(variables: tuple[Variable, ...], given: Mapping[str, ArrayLike]) -> tuple[Variable, ...]:
        entries: dict[str, float] = {}
        for name, value in given.items():
            numbers = np.asarray(value, dtype=float)
            labels = [name] if numbers.ndim == 0 else [f"{name}[{i}]" for i in range(len(numbers))]
            entries |= dict(zip(labels, numbers.reshape(-1).tolist(), strict=True))
        return tuple(replace(entry, start=entries.get(entry.name, entry.start)) for entry in variables)

    return replace(
        flat,
        inputs=changed(flat.inputs, inputs),
        states=changed(flat.states, states),
        parameters=changed(flat.parameters, parameters),
    )


def table(found: CoSimulation) -> str:
    """Differences from the diagram as text."""
    lines = [
        f"{found.duration:g} s at {1e3 * found.step:g} ms, largest difference of the position from the diagram, m",
        "",
        f"{'':<40}{'difference':>12}{'unexplained':>13}   late wires",
    ]
    for run in found.runs.values():
        late = ", ".join(run.cut.late) or "none"
        name = f"{len(run.cut.parts)} FMUs, {run.cut.scheme}"
        lines.append(f"{name:<40}{run.difference:>12.2e}{run.unexplained:>13.2e}   {late}")
    lines += ["", "unexplained: from the diagram with one sample of delay in the late wires"]
    return "\n".join(lines)


def figures(found: CoSimulation) -> dict[str, object]:
    """The same for JSON."""
    return {
        "step": found.step,
        "duration": found.duration,
        "runs": {
            name: {"difference": run.difference, "unexplained": run.unexplained, "seconds": run.seconds}
            for name, run in found.runs.items()
        },
    }
