"""What a run gives back: python-control's response, with what became of it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from .._sections import FloatArray
from ..blocks.functions import Variable
from ..diagram import FlatModel
from .arguments import Run
from .signals import SignalsByName

__all__ = [
    "Backend",
    "Method",
    "Outcome",
    "SimulationResponse",
    "response_of",
    "shares_of",
    "with_outputs_checked",
]

Method: TypeAlias = Literal["rk4", "adaptive", "stiff", "exact"]
Backend: TypeAlias = Literal["vm", "c", "numpy"]


class Outcome(NamedTuple):
    """What a run found, time-major."""

    x: FloatArray  # (N, n_x)
    y: FloatArray  # (N, n_y)
    steps: int
    message: str
    failed_at: float
    events: tuple[tuple[float, str], ...] = ()


class SimulationResponse(SignalsByName):
    """A ``control.TimeResponseData`` made by :func:`simulate`; its ``.plot()`` and shapes are python-control's.

    ``outputs["r"]`` is the whole vector r[0], r[1], ..., (k, N), where no signal is called ``r`` alone, and
    ``outputs["r[0]"]`` one entry, (N,); so of ``states`` and ``inputs``. An unknown name raises ``ValueError`` with the
    names close to it.

    Parameters
    ----------
    time : (N,) array
        Seconds.
    outputs : (n_y, N) array
    states : (n_x, N) array
    inputs : (n_u, N) array
    labels : tuple of (outputs, states, inputs)
        Names of the signals.
    name : str
        Name of the diagram.
    method : {"rk4", "adaptive", "stiff", "exact", "discrete"}
        How it was integrated; at the end, where "auto" changed it on the way.
    backend : {"vm", "c", "numpy"}
        What ran it.
    steps : int
        Steps of integration; 0 where they were not counted.
    message : str
        "" where the run succeeded; else what happened, when, and what to try. ``success`` says which.
    failed_at : float
        Time in seconds that the run came to before it failed; inf where it succeeded. Later values are NaN, those of
        the states only where it failed by a state.
    events : tuple of (float, str)
        Events that happened: seconds and name, in order. C does not record them.
    callbacks : mapping of str to float, optional
        Blocks that ran as Python, since their functions cannot be traced, and the share of the run's time that they
        took, 0 to 1; see ``FlatModel.callbacks`` for the reasons.
    squeeze : bool, optional
        As for ``control.input_output_response``.
    notes : tuple of str
        What is worth knowing of a run that succeeded.
    explanation : str
        Why this backend was taken.
    """

    def __init__(
        self,
        time: FloatArray,
        outputs: FloatArray,
        *,
        states: FloatArray,
        inputs: FloatArray,
        labels: tuple[list[str], list[str], list[str]],
        name: str,
        method: Method | Literal["discrete"],
        backend: Backend,
        steps: int = 0,
        message: str = "",
        failed_at: float = np.inf,
        events: tuple[tuple[float, str], ...] = (),
        squeeze: bool | None = None,
        notes: tuple[str, ...] = (),
        explanation: str = "",
        callbacks: Mapping[str, float] | None = None,
    ) -> None:
        super().__init__(
            time, outputs, states=states, inputs=inputs, issiso=len(outputs) == 1 and len(inputs) == 1,
            output_labels=labels[0], state_labels=labels[1], input_labels=labels[2], squeeze=squeeze,
            title=f"Response of {name}", sysname=name, success=not message, message=message or None,
        )  # fmt: skip
        self.method = method
        self.backend = backend
        self.steps = steps
        self.failed_at = failed_at
        self.notes = notes
        self.explanation = explanation
        self.callbacks: dict[str, float] = dict(callbacks or {})
        self.events = events


def with_outputs_checked(flat: FlatModel, run: Run, outcome: Outcome) -> Outcome:
    """Where the states are finite and an output is not, the run failed there; later outputs are not-a-number."""
    y = outcome.y
    if outcome.message or np.all(np.isfinite(y)):
        return outcome
    row, column = np.argwhere(~np.isfinite(y))[0]
    at = float(run.times[row])
    message = (
        f"output {flat.outputs[column].name} is {y[row, column]} at t = {at:.9g} s, while the states are "
        "finite; look for a division by 0 or a root of a negative number on the way to it"
    )
    y = np.where(np.arange(len(y))[:, None] <= row, y, np.nan)
    return outcome._replace(y=y, message=message, failed_at=at)


def response_of(
    flat: FlatModel,
    run: Run,
    outcome: Outcome,
    *,
    method: Method | Literal["discrete"],
    backend: Backend,
    squeeze: bool | None,
    notes: tuple[str, ...] = (),
    explanation: str = "",
    callbacks: Mapping[str, float] | None = None,
) -> SimulationResponse:
    """Time-major arrays as a response."""
    x, y, steps, message, failed_at, events = outcome
    raised = next((c for c in flat.callbacks if c.failure), None)
    ended = next((c.ended for c in flat.callbacks if c.ended), "")
    if ended:  # nothing else went wrong: what follows of it is no news
        message = ended
    elif message and raised is not None:
        message = f"block {raised.block}, which runs as Python, raised {raised.failure}; {message}"
    times, y, x, u = (
        (part if run.shown is None else part[run.shown]) for part in (run.times, y, x, run.inputs)
    )
    return SimulationResponse(
        times, y.T, states=x.T, inputs=u.T,
        labels=(_names(flat.outputs), _names(flat.states), _names(flat.inputs)), name=flat.name, method=method,
        backend=backend, steps=steps, message=message, failed_at=failed_at, squeeze=squeeze, notes=notes,
        explanation=explanation, callbacks=callbacks, events=events,
    )  # fmt: skip


def shares_of(flat: FlatModel) -> Callable[[], dict[str, float]]:
    """Starts the clock of a run; what it returns gives the share of each block that runs as Python."""
    begin = time.perf_counter()
    before = [callback.seconds for callback in flat.callbacks]
    for callback in flat.callbacks:
        callback.failure = callback.ended = ""

    def shares() -> dict[str, float]:
        total = max(time.perf_counter() - begin, 1e-9)
        found: dict[str, float] = {}
        for callback, spent in zip(flat.callbacks, before, strict=True):
            found[callback.block] = found.get(callback.block, 0.0) + (callback.seconds - spent) / total
        return found

    return shares


def _names(variables: Iterable[Variable]) -> list[str]:
    return [variable.name for variable in variables]
