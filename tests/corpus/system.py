"""What a system of the corpus is: a diagram as a user writes it, and its answer by an independent way."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import control as ct
import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class System:
    """A system of the corpus.

    Parameters
    ----------
    name : str
    family : str
    structure : str
        What its equations look like; systems that differ in numbers only have the same.
    build : callable
        () -> the diagram.
    reference : callable or None
        (times, start) -> outputs (n_y, N): a ``Hybrid``, or a closed form. None where no solution exists: the right
        answer is a status.
    end : float
        Seconds of the run.
    start : sequence of float
        States at its beginning.
    hidden : sequence of float
        Start of the reference where the diagram begins at its own defaults.
    inputs : callable, optional
        times -> inputs (n_u, N), straight lines between the times.
    times : (N,) array, optional
        By default 41 even ones.
    source : str
        Where the system is from; "" for our own.
    switching : bool
        Whether its rates jump, which costs steps of fixed length their order.
    pace : float
        Largest rate of a mode, where the answer at the times does not show it.
    stiff : bool
        Whether a mode is so fast that explicit methods and steps of fixed length cannot do it.
    movable : sequence of float, optional
        States that another start may move (1) or not (0); by default all that are not 0.
    fmu : bool
        Whether an FMU of it is run.
    residual : callable, optional
        (y, r) -> 0 for a solution, where there are several: any of them is right. Of a loop with one output y and
        one input r.
    short : bool
        Whether it belongs to the short form.
    """

    name: str
    family: str
    structure: str
    build: Callable[[], ct.InputOutputSystem]
    reference: Callable[[Array, ArrayLike], Array] | None
    end: float
    start: Sequence[float] = ()
    hidden: Sequence[float] = ()
    inputs: Callable[[Array], Array] | None = None
    times: Array | None = None
    source: str = ""
    switching: bool = True
    pace: float = 0.0
    stiff: bool = False
    movable: Sequence[float] | float = 1.0
    fmu: bool = True
    residual: Callable[[float, float], float] | None = None
    short: bool = False

    @property
    def timepts(self) -> Array:
        """Times of the run."""
        return np.linspace(0.0, self.end, 41) if self.times is None else self.times

    @property
    def solvable(self) -> bool:
        """Whether it has a solution."""
        return self.reference is not None


def block(
    rates: Callable[..., object] | None, states: int = 1, output: Callable[..., object] | None = None,
    outputs: int | None = None, inputs: int = 0, name: str = "plant",
) -> ct.NonlinearIOSystem:  # fmt: skip
    """``control.nlsys`` with states x[0] ..., outputs y[0] ..., by default the states."""
    return ct.nlsys(
        rates, output, inputs=inputs, states=states, outputs=states if outputs is None else outputs, name=name
    )
