"""Model-exchange FMUs with events as participants of a co-simulation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from ..diagram import flatten
from ..simulation.adaptive import Integrator, StepError
from ..simulation.limits import Budget
from .cosimulation_part import Part
from .importing_model import FmuModel
from .instance import FmuError
from .units import FmuUnit, understood_unit

__all__ = ["ModelPart"]

# To count as exact beside communication errors of 1e-3 ... 1e-6.
_RTOL, _ATOL, _MOST_STEPS = 1e-9, 1e-11, 10**8


class ModelPart(Part):
    """A model-exchange FMU with events, integrated here; inputs are held over a communication step.

    Events at its end still see the inputs held; discrete inputs that change there are taken in at once. It goes back to
    a state where the FMU does, whose state holds its events.

    Parameters
    ----------
    name : str
    block : FmuModel
    owned : bool
        Whether to free it at the end.
    """

    def __init__(self, name: str, block: FmuModel, *, owned: bool) -> None:
        self.name = name
        self._block, self._owned = block, owned
        self._flat = flatten(block)
        self.inputs: tuple[str, ...] = tuple(block.input_labels)
        self.outputs: tuple[str, ...] = tuple(block.output_labels)
        self.start: FloatArray = block.start_inputs
        self.feedthrough: NDArray[np.bool_] = self._flat.feedthrough
        self.can_go_back: bool = block.instance.state_is_usable
        self.variable_step = True
        self.interval: float | None = None
        self._t, self._x, self._u = 0.0, self._flat.start_state(), self.start
        self._integrator = self._begun(np.inf)

    def unit(self, label: str) -> tuple[str, FmuUnit | None]:
        """Unit of an input or output, where the FMU gives one, and its meaning."""
        name = self._block.units.get(label, "")
        return name, self._block.description.units.get(name) or understood_unit(name)

    def type(self, label: str) -> str:
        """Any number: a block of python-control."""
        return ""

    def slopes(self, columns: NDArray[np.intp]) -> FloatArray | None:
        """Not known."""
        return None

    def initialise(self, start_time: float, stop_time: float) -> None:
        """Initialise the FMU."""
        self._integrator = self._begun(stop_time)
        self._t = start_time
        try:
            self._x = self._integrator.begin(self._flat.start_state(), np.zeros(0), start_time, self._u)
        except StepError as error:
            raise self._stopped(error) from error

    def begin(self) -> None:
        """Nothing to do: it has begun."""

    def put(self, u: FloatArray) -> None:
        """Hold these inputs from now on."""
        self._u = u.copy()

    def get(self) -> FloatArray:
        """Outputs at the present time, state and inputs."""
        return self._integrator.output(self._t, self._x, np.zeros(0), self._u)

    def advance(self, t: float, h: float, *, final: bool) -> None:
        """Integrate over h seconds, with the events on the way."""
        try:
            self._x, _ = self._integrator.run(
                self._x, np.zeros(0), (t, t + h), (self._u, self._u), np.zeros(0)
            )
        except StepError as error:
            self._t, self._x = error.time, self._integrator.x
            raise self._stopped(error) from error
        self._t = t + h

    @property
    def has_events(self) -> bool:
        """Discrete inputs, that may change at a communication point, and clocks that others trigger there."""
        return self._block.has_discrete_inputs or any(self.clocks)

    def happen(self, t: float) -> bool:
        """Discrete inputs that changed, and clocks that were triggered."""
        watch = self._integrator.watch
        if self._over:
            return False
        before = len(watch.log) if watch is not None else 0
        try:
            self._x = self._integrator.happen(self._x, np.zeros(0), t, self._u)
        except StepError as error:
            raise self._stopped(error) from error
        return watch is not None and len(watch.log) > before

    @property
    def clocks(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Names of triggered input clocks, and of output clocks."""
        return self._block.instance.schedule.ends

    def trigger(self, clock: str, t: float) -> None:
        """A triggered input clock is to tick at t, when events happen."""
        self._block.instance.schedule.trigger(clock, t)

    @property
    def ticks(self) -> Sequence[tuple[float, str]]:
        """Time in seconds and name of each tick of a clock."""
        return self._block.instance.ticks

    def save(self) -> object:
        """The FMU's state, and that of its integration."""
        fmu = self._block.instance.save()
        return fmu, self._t, self._x.copy(), self._u.copy(), self._integrator.state

    def restore(self, state: object) -> None:
        """Put both back."""
        assert isinstance(state, tuple)
        fmu, self._t, x, u, self._integrator.state = state
        self._x, self._u = x.copy(), u.copy()
        self._block.instance.restore(fmu)

    def forget(self, state: object) -> None:
        """Free the FMU's state."""
        assert isinstance(state, tuple)
        self._block.instance.forget(state[0])

    def messages(self) -> tuple[str, ...]:
        """What the FMU logged so far."""
        return self._block.messages

    def close(self) -> None:
        """Free the FMU where it is its own."""
        if self._owned:
            self._block.close()

    def _begun(self, until: float) -> Integrator:
        p = self._flat.start_parameters()
        return Integrator(self._flat, p, Budget(_MOST_STEPS), rtol=_RTOL, atol=_ATOL, until=until)

    def _stopped(self, error: StepError) -> FmuError:
        ended = self._over
        raised = next((callback.failure for callback in self._flat.callbacks if callback.failure), "")
        detail = f"{raised}; {error}" if raised else str(error)
        return FmuError(
            self.name, "integrate", "ended" if ended else "error", detail, error.time if ended else None
        )

    @property
    def _over(self) -> bool:
        """Whether the FMU has ended the run."""
        return any(memory.ended for memory in self._flat.memories)
