"""A model as C sources, with what an export must know of it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..blocks.functions import Variable

__all__ = ["CModel"]


@dataclass(frozen=True, eq=False)
class CModel:
    """C99 sources of a model: made from a flat diagram or from a filter.

    Parameters
    ----------
    name : str
        C identifier; every symbol of the sources starts with ``pf_`` or ``<name>_``.
    sources : dict of str to str
        File name to text. Each ``.c`` is compiled; ``-std=c99 -Wall -Wextra -Wpedantic -Werror`` passes.
    symbol : str
        The ``const pf_model`` that describes it (runtime/pf_model.h).
    states, inputs, outputs, parameters : tuple of Variable
        x, u, y and p in the order of the C vectors.
    sampled_states : tuple of Variable
        What ``pf_model.s`` copies.
    tasks : tuple of (str, float)
        Sampled blocks with instants of their own: name and period in seconds.
    communication : float
        Nominal interval in seconds of a sampled block that updates once per communication step; 0: there is none.
    depends : (n_x + n_y, n_x + n_u) bool array
        Which derivative and output depends on which state and input, now (for FMI's ModelStructure).
    remembers : bool
        Algebraic loops start from their solution at the last accepted step, which the model has to be told of.
    formula : str
        Transfer function as text, for comments and documentation; "" where there is none.
    description : str
    events : tuple of str
        Names of the events.
    step : float
        Seconds between two calls of ``<name>_step`` of a diagram; 0: there is no such function.
    """

    name: str
    sources: dict[str, str]
    symbol: str
    states: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    parameters: tuple[Variable, ...]
    sampled_states: tuple[Variable, ...] = ()
    tasks: tuple[tuple[str, float], ...] = ()
    communication: float = 0.0
    depends: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, 0), dtype=bool))
    remembers: bool = False
    formula: str = ""
    description: str = ""
    events: tuple[str, ...] = ()
    step: float = 0.0
