"""FMUs and python-control systems run together, exchanging signals at communication points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

import control as ct
import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _signals
from .._renamed import takes_former
from .._sections import FloatArray
from ..simulation.signals import SignalsByName
from .cosimulation_clocks import ClockWires
from .cosimulation_outside import Outside, Signal
from .cosimulation_part import Part, StepControl, step_counts, step_problem
from .cosimulation_parts import make_part
from .cosimulation_run import Run
from .cosimulation_texts import TextExchange, text_wires
from .cosimulation_wiring import parameters_by_part, wire_up
from .inspect import Scalar
from .instance import FmuError
from .ssp_read import read_ssp
from .stepping import Master
from .system import Participant, System

__all__ = ["CosimulationResponse", "cosimulate"]


class CosimulationResponse(SignalsByName):
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


@takes_former
def cosimulate(
    system: System | Mapping[str, Participant] | str | Path,
    timepts: ArrayLike,
    *,
    inputs: Mapping[str, Signal] | None = None,
    outputs: Sequence[str] | None = None,
    parameters: Mapping[str, Scalar] | None = None,
    initial_state: Mapping[str, ArrayLike] | None = None,
    master: Master | None = None,
    progress: bool = False,
) -> CosimulationResponse:
    """Run FMUs and python-control systems wired together.

    The parts exchange signals at communication points and advance in between on inputs that they hold; :class:`Master`
    says how. Then events happen: clocks tick on the inputs at t_{k+1}, discrete inputs that changed are set in Event
    Mode, and what that changes is handed on at once. Ticks in between, and events that an FMU with Event Mode stops at,
    are handled where they occur, on the inputs held. **The FMUs' code is run**: in this process, or with
    ``Fmu(path, isolated=True)`` in processes of their own.

    Parameters
    ----------
    system : System, dict of parts, or an SSP file
        Parts and their wiring; a dict of parts without wires; a package as :func:`read_ssp` reads it. A package, and a
        diagram cut by :func:`cut_diagram`, bring names for inputs and outputs.
    timepts : (N,) array_like
        Times in seconds, increasing, at which results are wanted; communication points all of them.
    inputs : dict of str to float, (N,) array_like or callable, optional
        What drives inputs from outside, by ``part.input``: constant, at ``timepts`` (linear in between), or a function
        of time. An input that nothing drives keeps its start value.
    outputs : sequence of str, optional
        ``part.output``; all of them by default. String and Binary ones are recorded in ``texts`` of the response.
    parameters : dict of str to number, text or bytes, optional
        Parameters and start values by ``part.name``, before those of the system and of an :class:`Fmu`. Structural
        parameters of FMU files are set before all else.
    initial_state : dict of str to (n,) array_like, optional
        Of python-control systems, by part; by default the start values that its blocks know of, else zero.
    master : Master, optional
        Communication step, scheme and order, how inputs are held, step control. By default Jacobi from result to
        result.
    progress : bool
        Show a progress bar.

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

    Examples
    --------
    >>> import control as ct
    >>> plant = ct.ss([[0.0]], [[1.0]], [[1.0]], [[0.0]], inputs="u", outputs="y")
    >>> gain = ct.ss([], [], [], [[2.0]], inputs="e", outputs="u")
    >>> loop = System({"plant": plant, "gain": gain}, [("plant.u", "gain.u"), ("gain.e", "-plant.y")])
    >>> response = cosimulate(loop, [0.0, 0.5, 1.0], master=Master(0.01), initial_state={"plant": [1.0]})
    >>> response.output_labels
    ['plant.y', 'gain.u']
    >>> abs(float(response.outputs[0, -1]) - 0.1353) < 0.01  # exp(-2 t)
    True
    """
    whole = _whole(system)
    master = master or Master()
    times = _checked_times(timepts)
    with ExitStack() as stack:
        members = _members(
            stack,
            whole.parts,
            {**whole.parameters, **(parameters or {})},
            initial_state or {},
            master.intermediate,
        )
        clock_wires = ClockWires(members, whole.connections)
        handed, numbers = text_wires(members, clock_wires.others)
        wiring = wire_up(members, numbers, units=whole.units)
        wanted = _wanted(members, outputs, whole.outputs)
        texts = TextExchange(members, handed, wanted)
        _refuse_texts(members, inputs or {})
        run = Run(
            members,
            wiring,
            Outside(wiring, inputs or {}, whole.ends, times),
            _sequence(members, master),
            {name: wiring.source(label) for name, label in wanted.items() if name not in texts.rows},
            texts,
            clock_wires,
            master.threads,
            first=master.hold == "first",
        )
        rtol = master.tolerance
        control = None if rtol is None else StepControl(rtol, master.absolute_tolerance or rtol)
        _check_steps(members, times, master.step, control)
        try:
            run.over(times, master.step, control, progress)
        except FmuError as error:
            so_far = _response(run, times, str(error))
            if error.status == "ended":
                return so_far
            error.results = so_far
            raise
        return _response(run, times, run.message)


def _whole(system: object) -> System:
    if isinstance(system, System):
        return system
    if isinstance(system, str | Path):
        return read_ssp(system)
    if isinstance(system, Mapping):
        return System(system)
    raise TypeError(
        f"system: expected System(parts, connections), a dict of parts or an SSP file, got {system!r}"
    )


def _members(
    stack: ExitStack,
    parts: Mapping[str, Participant],
    parameters: Mapping[str, Scalar],
    initial_state: Mapping[str, ArrayLike],
    intermediate: bool,
) -> list[Part]:
    strange = sorted(set(initial_state) - set(parts))
    if strange:
        raise ValueError(f"initial_state: {strange[0]!r} names no part; there are {list(parts)}")
    values = parameters_by_part(list(parts), parameters)
    members: list[Part] = []
    for name, thing in parts.items():
        part = make_part(
            name, thing, values[name], initial_state=initial_state.get(name), intermediate=intermediate
        )
        stack.callback(part.close)
        members.append(part)
    return members


def _checked_times(timepts: ArrayLike) -> FloatArray:
    times = _signals.sample_times("timepts", timepts)
    if len(times) < 2:
        raise ValueError("timepts: expected at least two times in seconds, got one")
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


def _sequence(parts: Sequence[Part], master: Master) -> list[int] | None:
    names = [part.name for part in parts]
    order = master.order
    if order is not None and sorted(order) != sorted(names):
        raise ValueError(f"order: expected each part once, of {names}, got {list(order)}")
    return None if master.scheme == "jacobi" else [names.index(name) for name in order or names]


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
