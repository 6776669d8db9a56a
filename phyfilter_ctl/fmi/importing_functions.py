"""A model-exchange FMU as functions that CasADi calls back: what :func:`flatten` makes of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, cast

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from ..blocks.functions import BlockEvent, BlockFunctions, Variable
from ..blocks.interpreted import Interpreted
from .inspect import FmuDescription

if TYPE_CHECKING:
    from .importing_blocks import FmuModel

__all__ = ["declared_feedthrough", "model_functions"]

# What the integrator's arithmetic may leave between a time and the event that it was to meet.
_ROUNDING = 1e-12
_REMEDY = (
    "Its binary cannot be merged into other code: hand over the rest as an FMU of its own and both as a package "
    "(cut_diagram, write_ssp), or run the diagram with simulate"
)


class _FmuMemory:
    """The discrete states of an FMU: what happens to them in a run.

    Parameters
    ----------
    block : FmuModel
    """

    def __init__(self, block: FmuModel) -> None:
        self._block = block
        self._fresh = False
        self._ended = ""

    @property
    def ended(self) -> str:
        """What to say where the FMU asked to end the run."""
        return self._ended

    @property
    def next_event(self) -> float:
        """Time of the next event, inf for none."""
        event = self._block.instance.next_event
        return np.inf if event is None else event

    def restart(self, t: float) -> None:
        """The event that follows initialises the FMU at this time."""
        self._block.rewind(t)
        self._fresh, self._ended = True, ""

    @contextmanager
    def running(self) -> Iterator[None]:
        """Keeps others from the FMU; afterwards it starts anew where it is used."""
        with self._block.lock:
            try:
                yield
            finally:
                self._block.rewind(None)

    def happen(self, t: float, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> FloatArray:
        """Event mode at a point, or the start of the run: x after it, and 1 where the run is to end."""
        block = self._block
        if self._fresh:
            self._fresh = False
            return np.append(block.start_at(x, u, params), 0.0)
        event = self.next_event
        block.move(event if abs(event - t) <= _ROUNDING * max(abs(t), 1.0) else t, x, u, params)
        return self._answer(block.instance.run_events(), t)

    def condition(self, t: float, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> FloatArray:
        """Event indicators; 0 counts as below 0, as FMI has it."""
        self._block.move(t, x, u, params)
        values = self._block.instance.indicators()
        return np.where(values > 0.0, values, np.minimum(values, -np.finfo(float).tiny))

    def completed(self, t: float, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> FloatArray:
        """1 where the FMU wants an event after this step, 2 where the run is to end."""
        self._block.move(t, x, u, params)
        event, end = self._block.instance.complete_step()
        self._say(end, t)
        return np.array([2.0 if end else float(event)])

    def _answer(self, end: bool, t: float) -> FloatArray:
        self._say(end, t)
        # An FMU that asks to end the run answers no more.
        x = np.zeros(self._block.nstates or 0) if end else self._block.instance.states()
        return np.append(x, float(end))

    def _say(self, end: bool, t: float) -> None:
        if end:
            self._ended = f"block {self._block.name}: the FMU asked to end the run at t = {t:.9g} s"


def model_functions(block: FmuModel) -> BlockFunctions:
    """Equations and events of an imported model-exchange FMU.

    Parameters
    ----------
    block : FmuModel

    Returns
    -------
    BlockFunctions
        Callbacks into the FMU, which stay in force as long as they are held. They move one and the same instance.
    """
    memory = _FmuMemory(block)
    name = block.name or "fmu"
    parameters = [
        Variable(key, float(value), block.units.get(key, "")) for key, value in block.params.items()
    ]
    keys = [variable.name for variable in parameters]
    sizes = (len(block.state_labels), len(block.input_labels), len(keys))
    reason = f"it is the imported FMU {block.description.path}"

    def callback(
        which: str,
        evaluate: Callable[[float, FloatArray, FloatArray, Mapping[str, float]], FloatArray],
        size: int,
        depends: NDArray[np.bool_] | None = None,
    ) -> ca.Function:
        if not size:
            symbols = [ca.SX.sym(letter, count) for letter, count in zip("txup", (1, *sizes), strict=True)]
            return ca.Function(which, symbols, [ca.SX(0, 1)])
        function = Interpreted(
            which,
            lambda t, x, u, p: evaluate(t, x, u, dict(zip(keys, p.tolist(), strict=True))),
            (*sizes, size),
            name,
            reason,
            depends,
            remedy=_REMEDY,
        )
        callbacks.append(function)
        return cast(ca.Function, function)

    callbacks: list[Interpreted] = []
    description = block.description
    through = declared_feedthrough(description, *block.labels)
    wants_steps = description.kinds["me"].completed_step
    event = BlockEvent(
        "event",
        0,
        callback("condition", memory.condition, description.event_indicators),
        callback("event", memory.happen, sizes[0] + 1),
        memory,
        callback("completed", memory.completed, 1) if wants_steps else None,
    )
    return BlockFunctions(
        states=_variables(block, block.state_labels, block.start_state),
        inputs=_variables(block, block.input_labels, block.start_inputs),
        outputs=_variables(block, block.output_labels, np.zeros(block.noutputs or 0)),
        parameters=tuple(parameters),
        dynamics=callback("update", block.rates_at, sizes[0]),
        output=callback("output", block.outputs_at, block.noutputs or 0, through),
        callbacks=tuple(callbacks),
        events=(event,),
    )


def _variables(block: FmuModel, labels: Sequence[str], starts: FloatArray) -> tuple[Variable, ...]:
    return tuple(
        Variable(label, float(start), block.units.get(label, ""))
        for label, start in zip(labels, starts, strict=True)
    )


def declared_feedthrough(
    description: FmuDescription, inputs: Sequence[str], outputs: Sequence[str]
) -> NDArray[np.bool_]:
    """Which input acts on which output, from the model structure; where nothing is said FMI means every input.

    Parameters
    ----------
    description : FmuDescription
    inputs, outputs : sequence of str
        Labels.

    Returns
    -------
    (outputs, inputs) bool array
    """
    owner = {label: entry.name for entry in description.variables for label in entry.labels}
    result = np.ones((len(outputs), len(inputs)), dtype=bool)
    for i, output in enumerate(outputs):
        known = description.dependencies.get(owner[output])
        if known is not None:
            result[i] = [owner[label] in known for label in inputs]
    return result
