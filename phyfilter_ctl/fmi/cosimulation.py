"""FMUs and python-control systems run together, exchanging signals at communication points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Literal

import control as ct
import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _signals
from .._sections import FloatArray
from .archive import ArchiveLimits
from .clock_schedule import ClockTimes
from .cosimulation_clocks import ClockWires
from .cosimulation_outside import Outside, Signal
from .cosimulation_part import Part, StepControl, step_counts, step_problem
from .cosimulation_parts import make_part
from .cosimulation_run import Run
from .cosimulation_texts import TextExchange, text_wires
from .cosimulation_wiring import Connection, Wire, parameters_by_part, refuse_ill_formed, wire_up
from .foreign import Isolation
from .inspect import Scalar
from .instance import FmuError
from .ssp_cut import CutDiagram
from .ssp_read import opened_ssp

__all__ = ["CosimulationResponse", "cosimulate"]

Participant = str | Path | ct.InputOutputSystem


class CosimulationResponse(ct.TimeResponseData):
    """Result of :func:`cosimulate`: python-control's response data, and how it came about.

    Parameters
    ----------
    time : (N,) array
    outputs : (p, N) array
    inputs : (m, N) array or None
    output_labels, input_labels : sequence of str
    steps, rejected : int
        Communication steps made, and those that step control took back.
    messages : dict of str to tuple of str
        What each part logged.
    master : str
        What made the steps: "C" or "Python", and for which parts C had to call Python, or why there was no C.
    ticks : dict of str to (k,) array
        By ``part.clock``: the times in seconds at which clocks of the FMUs ticked, those of the FMUs' own included.
    intermediate : dict of str to control.TimeResponseData
        By part: what FMUs told of their outputs inside steps, at times of their own choice.
    message : str
        "" where the run succeeded, else what happened and what to try; ``success`` says which.
    texts : dict of str to (k,) array of objects
        Of outputs that are String (str) or Binary (bytes): their values at the first k times, all N where it succeeded.
    """

    def __init__(
        self,
        time: FloatArray,
        outputs: FloatArray,
        inputs: FloatArray | None = None,
        *,
        output_labels: Sequence[str],
        input_labels: Sequence[str] = (),
        steps: int = 0,
        rejected: int = 0,
        messages: Mapping[str, tuple[str, ...]] | None = None,
        master: str = "",
        message: str = "",
        texts: Mapping[str, NDArray[np.object_]] | None = None,
        ticks: Mapping[str, FloatArray] | None = None,
        intermediate: Mapping[str, ct.TimeResponseData] | None = None,
    ) -> None:
        super().__init__(
            time,
            outputs,
            None,
            inputs,
            issiso=False,
            output_labels=list(output_labels),
            input_labels=None if inputs is None else list(input_labels),
            title="Co-simulation",
            sysname="cosimulation",
            success=not message,
            message=message,
        )
        self.steps: int = steps
        self.rejected: int = rejected
        self.messages: dict[str, tuple[str, ...]] = dict(messages or {})
        self.texts: dict[str, NDArray[np.object_]] = dict(texts or {})
        self.master: str = master
        self.ticks: dict[str, FloatArray] = dict(ticks or {})
        self.intermediate: dict[str, ct.TimeResponseData] = dict(intermediate or {})


def cosimulate(
    parts: Mapping[str, Participant] | CutDiagram | str | Path,
    connections: Sequence[Connection | Wire] | None = None,
    *,
    timepts: ArrayLike,
    step: float | None = None,
    inputs: Mapping[str, Signal] | None = None,
    outputs: Sequence[str] | None = None,
    scheme: Literal["jacobi", "gauss-seidel"] = "jacobi",
    order: Sequence[str] | None = None,
    hold: Literal["zero", "first"] = "zero",
    parameters: Mapping[str, Scalar] | None = None,
    initial_state: Mapping[str, ArrayLike] | None = None,
    tolerance: float | None = None,
    absolute_tolerance: float | None = None,
    units: Literal["raise", "convert", "warn", "ignore"] = "raise",
    threads: int = 1,
    progress: bool = False,
    limits: ArchiveLimits | None = None,
    isolated: bool | Isolation = False,
    clocks: ClockTimes | None = None,
    intermediate: bool = False,
) -> CosimulationResponse:
    """Run FMUs and python-control systems wired together.

    At a communication point t_k every part has reached t_k; outputs are handed on along direct feedthrough until
    they settle, then each part advances to t_{k+1} on inputs that it holds:

    * Jacobi: the inputs at t_k, for all parts alike.
    * Gauss-Seidel: part after part, in order; a part sees the outputs at t_{k+1} of the parts before it.

    Then events happen: clocks tick on the inputs at t_{k+1}, discrete inputs that changed are set in Event Mode, and
    what that changes is handed on at once. Ticks in between, and events that an FMU with Event Mode stops at, are
    handled where they occur, on the inputs held.

    Both are of first order in the communication step, and of second order with ``hold="first"``, where inputs follow
    lines over a step: through the last two outputs (extrapolated), through both ends of the step where these are known
    (from outside, and from parts before in Gauss-Seidel). **The FMUs' code is run**: in this process, or with
    ``isolated`` in processes of their own.

    Parameters
    ----------
    parts : dict of str to str, Path or control.InputOutputSystem; or an SSP file; or CutDiagram
        FMU files (co-simulation; one with model exchange only is integrated here, with its events), blocks from
        :func:`import_fmu` (each run makes a new instance), or python-control systems. An SSP file, or a diagram cut by
        :func:`cut_diagram`, brings its own connections and parameters, and names for inputs and outputs.
    connections : sequence of tuple of str
        ``(input, output, ...)`` as in ``ct.interconnect``: ``("plant.f[0]", "controller.u[0]")``; several outputs are
        summed, ``"-part.y"`` is subtracted, ``"plant.f"`` stands for all its elements. String and Binary outputs go to
        inputs of their own type as they are. A triggered input clock ticks with the output clock that it is wired to:
        at the same communication point, or at the end of the step in which that one ticked.
    timepts : (N,) array_like
        Times in seconds, increasing, at which results are wanted; communication points all of them.
    step : float, optional
        Longest communication step; the spacing of ``timepts`` by default. With ``tolerance``: the first step.
    inputs : dict of str to float, (N,) array_like or callable, optional
        What drives inputs from outside, by ``part.input``: constant, at ``timepts`` (linear in between), or a function
        of time. An input that nothing drives keeps its start value.
    outputs : sequence of str, optional
        ``part.output``; all of them by default. String and Binary ones are recorded in ``texts`` of the response.
    scheme : {"jacobi", "gauss-seidel"}
    order : sequence of str, optional
        Parts in the order of Gauss-Seidel; as given by default.
    hold : {"zero", "first"}
        Whether continuous inputs are held over a step or follow lines. An FMU of FMI 2.0 that can interpolate inputs is
        given slopes (fmi2SetRealInputDerivatives); every other part is given the line's value in the middle of the step
        (FMI 3.0 has no call for slopes), which has the same integral. Discrete inputs and discrete systems hold.
    parameters : dict of str to number, text or bytes, optional
        Parameters and start values by ``part.name``. Structural parameters of FMU files are set before all else.
    initial_state : dict of str to (n,) array_like, optional
        Of python-control systems, by part; by default the start values that its blocks know of, else zero.
    tolerance, absolute_tolerance : float, optional
        Step control: each step is made once and again as two halves, the difference of all outputs is kept below
        ``absolute_tolerance + tolerance * |y|``, and the finer result is kept. All parts must be able to put back their
        state. ``absolute_tolerance`` is ``tolerance`` by default.
    units : {"raise", "convert", "warn", "ignore"}
        Where a wire joins different units; those of one dimension can be converted, by the factors and offsets that the
        FMUs define or their names say. Packages convert as SSP has it.
    threads : int
        For the steps of FMUs with Jacobi in C, except on Windows: worth it for FMUs whose steps take 10 us and more.
        The results do not depend on it.
    progress : bool
        Show a progress bar.
    limits : ArchiveLimits, optional
    isolated : bool or Isolation
        Whether each FMU file runs in a process of its own, and within which limits of time; that costs one exchange
        between processes a step, 0.3 to 0.6 ms. SECURITY.md says what it fences. Blocks from :func:`import_fmu` run
        as they were imported.
    clocks : dict of str to float or sequence of float, optional
        By ``part.clock``: for clocks whose interval is the importer's to choose, that in seconds; for triggered ones
        the times at which they tick. Periodic and countdown clocks tick as their FMU says.
    intermediate : bool
        Whether FMUs that provide intermediate updates (FMI 3.0) are to tell of their Float64 outputs inside steps, on
        the inputs held; ``response.intermediate`` has them.

    Returns
    -------
    CosimulationResponse
        A ``control.TimeResponseData``: ``outputs`` and ``inputs`` by full name. Where step control comes to steps
        below 1e-12 of the span, an algebraic loop loses its solution, or an output that is wanted or handed on becomes
        NaN or infinite, ``success`` is False, ``message`` says which, when and what to try, and later outputs are NaN.

    Raises
    ------
    ValueError
        If a name is unknown, an input is driven twice, units differ, an algebraic loop has no solution at the start, a
        part cannot make the steps or cannot go back
        for step control.
    FmuError
        If an FMU fails, or crashes or hangs in its own process: its name, the call, the time and what it logged. All
        instances are freed. Its ``results`` are the response up to the last result before, then NaN.

    Notes
    -----
    Where there is a C compiler the steps are made by a loop in C (compiled once per user) with the same results to
    rounding. It runs FMUs of this process and linear systems itself and calls Python for all other parts;
    ``response.master`` says which. Algebraic loops it solves with the slopes that Python found before, and asks again
    where these no longer do. Where texts or bytes are handed on or recorded, Python makes the steps.

    Loops of direct feedthrough are solved at each communication point by Newton's method, on directional or adjoint
    derivatives where the FMUs have them and on differences otherwise, to a residual of 1e-10 of the largest signal. An
    FMU that does not say which inputs its outputs depend on counts as if they depended on all.

    References
    ----------
    Schierz, T., Arnold, M., Clauss, C.: Co-simulation with communication step size control in an FMI compatible
    master algorithm. 9th International Modelica Conference, 2012.

    Examples
    --------
    >>> import control as ct
    >>> plant = ct.ss([[0.0]], [[1.0]], [[1.0]], [[0.0]], inputs="u", outputs="y")
    >>> gain = ct.ss([], [], [], [[2.0]], inputs="e", outputs="u")
    >>> response = cosimulate(
    ...     {"plant": plant, "gain": gain},
    ...     [("plant.u", "gain.u"), ("gain.e", "-plant.y")],
    ...     timepts=[0.0, 0.5, 1.0],
    ...     step=0.01,
    ...     initial_state={"plant": [1.0]},
    ... )
    >>> response.output_labels
    ['plant.y', 'gain.u']
    >>> abs(float(response.outputs[0, -1]) - 0.1353) < 0.01  # exp(-2 t)
    True
    """
    times = _checked_times(timepts, step)
    for name, value, known in (
        ("scheme", scheme, ("jacobi", "gauss-seidel")),
        ("hold", hold, ("zero", "first")),
    ):
        if value not in known:
            raise ValueError(f'{name}: expected "{known[0]}" or "{known[1]}", got {value!r}')
    if threads < 1:
        raise ValueError(f"threads: expected at least 1, got {threads}")
    for name, value in (("tolerance", tolerance), ("absolute_tolerance", absolute_tolerance)):
        if value is not None and not 0.0 < value < np.inf:
            raise ValueError(f"{name}: expected a number > 0, got {value}")
    refuse_ill_formed(connections or ())
    with ExitStack() as stack:
        names: Mapping[str, str] = {}
        wires: Sequence[Connection | Wire] = connections or ()
        outside: Mapping[str, Sequence[Wire]] = {}
        if isinstance(parts, str | Path):
            system = stack.enter_context(opened_ssp(parts, limits=limits))
            parts, wires, outside, names = (
                system.parts,
                [*system.wires, *wires],
                system.inputs,
                system.outputs,
            )
            parameters = {**system.parameters, **(parameters or {})}
        elif isinstance(parts, CutDiagram):
            outside = {label: [Wire(sink, "") for sink in sinks] for label, sinks in parts.inputs.items()}
            parts, wires, names = parts.parts, [*parts.wires, *wires], parts.outputs
        members = _members(
            stack, parts, parameters or {}, initial_state or {}, limits, isolated, clocks or {}, intermediate
        )
        clock_wires = ClockWires(members, wires)
        handed, numbers = text_wires(members, clock_wires.others)
        wiring = wire_up(members, numbers, units=units)
        wanted = _wanted(members, outputs, names)
        texts = TextExchange(members, handed, wanted)
        _refuse_texts(members, inputs or {})
        run = Run(
            members,
            wiring,
            Outside(wiring, inputs or {}, outside, times),
            _sequence(members, scheme, order),
            {name: wiring.source(label) for name, label in wanted.items() if name not in texts.rows},
            texts,
            clock_wires,
            threads,
            first=hold == "first",
        )
        control = StepControl(tolerance, absolute_tolerance or tolerance) if tolerance is not None else None
        _check_steps(members, times, step, control)
        try:
            run.over(times, step, control, progress)
        except FmuError as error:
            so_far = _response(run, times, str(error))
            if error.status == "ended":
                return so_far
            error.results = so_far
            raise
        return _response(run, times, run.message)


def _members(
    stack: ExitStack,
    parts: Mapping[str, Participant],
    parameters: Mapping[str, Scalar],
    initial_state: Mapping[str, ArrayLike],
    limits: ArchiveLimits | None,
    isolated: bool | Isolation,
    clocks: ClockTimes,
    intermediate: bool,
) -> list[Part]:
    if not parts:
        raise ValueError("parts: expected at least one")
    strange = sorted(set(initial_state) - set(parts))
    if strange:
        raise ValueError(f"initial_state: {strange[0]!r} names no part; there are {list(parts)}")
    values = parameters_by_part(list(parts), parameters)
    chosen: dict[str, dict[str, float | Sequence[float]]] = {name: {} for name in parts}
    for key, given in clocks.items():
        owner, _, clock = key.partition(".")
        if owner not in chosen:
            raise ValueError(f"clocks: {key!r} names no part; expected part.clock, of {list(parts)}")
        chosen[owner][clock] = given
    members: list[Part] = []
    for name, thing in parts.items():
        part = make_part(
            name,
            thing,
            values[name],
            initial_state=initial_state.get(name),
            limits=limits,
            isolated=isolated,
            clocks=chosen[name],
            intermediate=intermediate,
        )
        stack.callback(part.close)
        members.append(part)
    return members


def _checked_times(timepts: ArrayLike, step: float | None) -> FloatArray:
    times = _signals.sample_times("timepts", timepts)
    if len(times) < 2:
        raise ValueError("timepts: expected at least two times in seconds, got one")
    if step is not None and not 0.0 < step < np.inf:
        raise ValueError(f"step: expected seconds > 0, got {step}")
    return times


def _check_steps(
    parts: Sequence[Part], times: FloatArray, step: float | None, control: StepControl | None
) -> None:
    if control is None:
        spans = np.diff(times)
        steps = spans / step_counts(spans, step)
        problems = [problem for part in parts if (problem := step_problem(part, steps))]
    else:
        stuck = [part.name for part in parts if not part.can_go_back]
        rigid = [part.name for part in parts if not part.variable_step or part.interval]
        problems = []
        if stuck:
            problems.append(
                f"tolerance: {', '.join(stuck)} cannot put back a state, which step control needs"
            )
        if rigid:
            problems.append(
                f"tolerance: {', '.join(rigid)} cannot make steps of any length, as step control does"
            )
    if problems:
        raise ValueError("; ".join(problems))


def _sequence(parts: Sequence[Part], scheme: str, order: Sequence[str] | None) -> list[int] | None:
    names = [part.name for part in parts]
    if order is not None and sorted(order) != sorted(names):
        raise ValueError(f"order: expected each part once, of {names}, got {list(order)}")
    if scheme == "jacobi":
        if order is not None:
            raise ValueError('order: means nothing to scheme="jacobi"; expected scheme="gauss-seidel"')
        return None
    return [names.index(name) for name in order or names]


def _wanted(parts: Sequence[Part], outputs: Sequence[str] | None, names: Mapping[str, str]) -> dict[str, str]:
    """Outputs to be recorded: ``part.output`` by the name that it gets."""
    if outputs is not None:
        return {label: names.get(label, label) for label in outputs}
    labels = (f"{part.name}.{label}" for part in parts for label in (*part.outputs, *part.text_outputs))
    return dict(names) or {label: label for label in labels}


def _refuse_texts(parts: Sequence[Part], inputs: Mapping[str, Signal]) -> None:
    for part in parts:
        for label, kind in part.text_inputs.items():
            if (name := f"{part.name}.{label}") in inputs:
                raise ValueError(
                    f"inputs: {name!r} is {kind}, no signal of numbers: give it a constant value under parameters, or "
                    "drive it by a part"
                )


def _response(run: Run, times: FloatArray, message: str) -> CosimulationResponse:
    return CosimulationResponse(
        times,
        run.rows.T,
        run.outside.over(times).T if run.outside.labels else None,
        output_labels=list(run.chosen),
        input_labels=run.outside.labels,
        steps=run.steps,
        rejected=run.rejected,
        master=run.master,
        messages={part.name: part.messages() for part in run.parts},
        message=message,
        texts=run.texts.rows,
        ticks=_ticks(run.parts),
        intermediate=_told(run.parts),
    )


def _ticks(parts: Sequence[Part]) -> dict[str, FloatArray]:
    times: dict[str, list[float]] = {}
    for part in parts:
        for t, clock in part.ticks:
            times.setdefault(f"{part.name}.{clock}", []).append(t)
    return {name: np.array(found) for name, found in times.items()}


def _told(parts: Sequence[Part]) -> dict[str, ct.TimeResponseData]:
    found = {}
    for part in parts:
        labels, rows = part.intermediate
        if labels and rows:
            table = np.array(rows)
            found[part.name] = ct.TimeResponseData(
                table[:, 0],
                table[:, 1:].T,
                issiso=False,
                output_labels=list(labels),
                title="Inside steps",
                sysname=part.name,
            )
    return found
