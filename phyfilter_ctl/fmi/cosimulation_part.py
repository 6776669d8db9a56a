"""What a participant of a co-simulation can do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from .units import FmuUnit
from .values import Opaque

__all__ = [
    "SETTLED",
    "SMALLEST",
    "Part",
    "StepControl",
    "StuckError",
    "step_counts",
    "step_problem",
    "too_small",
    "unsettled",
]

# Communication steps below this part of the span cannot be told from rounding of the time.
SMALLEST = 1e-12
# Signals that move by less, as a part of the largest one, rest.
SETTLED = 1e-6

# Communication steps that differ by less are rounding of one step.
_SAME_STEP = 1e-6


class StuckError(Exception):
    """The run cannot go on, and says what to try."""


@dataclass
class StepControl:
    """Tolerances, and the step to try next.

    Parameters
    ----------
    rtol, atol : float
    step : float
    """

    rtol: float
    atol: float
    step: float = 0.0


class Part(Protocol):
    """One participant.

    Attributes
    ----------
    name : str
    inputs, outputs : tuple of str
        Labels.
    start : (inputs,) array
        Values of the inputs that nothing drives.
    feedthrough : (outputs, inputs) bool array
        Which input acts on which output without delay.
    can_go_back : bool
        Whether :meth:`save` and :meth:`restore` work.
    variable_step : bool
        Whether communication steps may differ.
    interval : float or None
        Seconds that steps must be multiples of.
    text_inputs, text_outputs : dict of str to str
        String and Binary variables: label and type.
    """

    name: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    start: FloatArray
    feedthrough: NDArray[np.bool_]
    can_go_back: bool
    variable_step: bool
    interval: float | None
    text_inputs: Mapping[str, str] = MappingProxyType({})
    text_outputs: Mapping[str, str] = MappingProxyType({})

    @property
    def in_python(self) -> str:
        """Why the loop in C calls the part through Python; "" where it runs the part itself."""
        return "with equations in Python"

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Which inputs may change within a communication step: (inputs,) bool array."""
        return np.ones(len(self.inputs), dtype=bool)

    @property
    def interpolates(self) -> bool:
        """Whether :meth:`incline` works."""
        return False

    def incline(self, slopes: FloatArray) -> None:
        """Let the inputs follow lines over the next step, from the values put, with these slopes in 1/s."""
        raise RuntimeError(f"{self.name}: takes no slopes")

    def unit(self, label: str) -> tuple[str, FmuUnit | None]:
        """Unit of an input or output, and what it means, where that is known."""
        ...

    def type(self, label: str) -> str:
        """Type of an input or output as in FmuVariable; "" where it may be any number."""
        ...

    def slopes(self, columns: NDArray[np.intp]) -> FloatArray | None:
        """Derivatives of all outputs by these inputs, (outputs, columns), where the part knows them."""
        ...

    def initialise(self, start_time: float, stop_time: float) -> None:
        """Start at a time in seconds; inputs may still be set and outputs read before :meth:`begin`."""
        ...

    def begin(self) -> None:
        """End the initialisation."""
        ...

    def put(self, u: FloatArray) -> None:
        """Set all inputs."""
        ...

    def get(self) -> FloatArray:
        """All outputs."""
        ...

    def get_text(self, label: str) -> Opaque:
        """A String or Binary output."""
        raise KeyError(label)

    def put_text(self, label: str, value: Opaque) -> None:
        """Set a String or Binary input."""
        raise KeyError(label)

    def advance(self, t: float, h: float, *, final: bool) -> None:
        """Step from t to t + h; ``final`` where no state of a time before t will be restored.

        Where the part ends the run at t + h, the error that it raises says so; it then still has outputs there.
        """
        ...

    @property
    def has_events(self) -> bool:
        """Whether :meth:`happen` may do anything."""
        return False

    def happen(self, t: float) -> bool:
        """Events that are due at t, on the inputs there; whether there were any."""
        return False

    @property
    def clocks(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Names of triggered input clocks, and of output clocks."""
        return (), ()

    def trigger(self, clock: str, t: float) -> None:
        """A triggered input clock is to tick at t, when events happen."""

    @property
    def ticks(self) -> Sequence[tuple[float, str]]:
        """Time in seconds and name of each tick of a clock."""
        return ()

    @property
    def intermediate(self) -> tuple[tuple[str, ...], Sequence[Sequence[float]]]:
        """Outputs that it told of inside steps, and each time t and their values."""
        return (), ()

    def save(self) -> object:
        """The state as it is now."""
        ...

    def restore(self, state: object) -> None:
        """Go back to a saved state."""
        ...

    def forget(self, state: object) -> None:
        """Free a saved state."""
        ...

    def messages(self) -> tuple[str, ...]:
        """What the part logged."""
        ...

    def close(self) -> None:
        """Free everything."""
        ...


def step_problem(part: Part, steps: FloatArray) -> str:
    """Why a part cannot make these communication steps; "" if it can.

    Parameters
    ----------
    part : Part
    steps : (k,) array
        Seconds.
    """
    if not part.variable_step and np.ptp(steps) > _SAME_STEP * np.max(steps):
        return f"{part.name}: all communication steps must be equal, got {np.min(steps):g} to {np.max(steps):g} s"
    if part.interval:
        counts = steps / part.interval
        if np.any(np.abs(counts - np.round(counts)) > _SAME_STEP * counts) or np.any(counts < 0.5):
            return (
                f"{part.name}: communication steps must be multiples of {part.interval:g} s, got {np.min(steps):g} to "
                f"{np.max(steps):g} s"
            )
    return ""


def step_counts(spans: FloatArray, step: float | None) -> NDArray[np.intp]:
    """Equal communication steps between results.

    Parameters
    ----------
    spans : (k,) array
        Seconds between results.
    step : float, optional
        Longest.
    """
    if step is None:
        return np.ones(len(spans), np.intp)
    return np.maximum(1, np.ceil(spans / step * (1.0 - 1e-9))).astype(np.intp)


def too_small(t: float, smallest: float) -> str:
    """What to say where step control comes to an end.

    Parameters
    ----------
    t, smallest : float
        Time and smallest step in seconds.
    """
    return (
        f"the communication step fell below {smallest:g} s at t = {t:g}: loosen the tolerance, or look for a jump in a "
        "signal there"
    )


def unsettled(t: float) -> str:
    """What to say where signals do not come to rest at one instant.

    Parameters
    ----------
    t : float
    """
    return (
        f"signals do not come to rest at t = {t:g}: an output moves with an input that its FMU's description leaves "
        "out, or with each reading; fmu check finds which"
    )
