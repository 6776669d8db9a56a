"""Algebraic loops of a co-simulation: signals that depend on themselves at one instant."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from .._sections import FloatArray
from .cosimulation_part import Part, StuckError
from .cosimulation_wiring import Wiring

__all__ = ["Loop", "find_loops"]

# What is left over of an input, as a part of the largest one in the loop. The second is for FMUs that reckon in single
# precision, and holds only where no step makes it smaller.
_SETTLED, _SETTLED_SINGLE = 1e-10, 1e-6
_ITERATIONS = 30
# A step that leaves more than this of the residual calls for a slope of its own.
_SLOW = 0.3
# 1 - gain below this, or a solution so much larger than what drives it: a gain of one.
_SINGULAR, _LARGEST = 1e-8, 1e6


@dataclass
class Loop:
    """Inputs v with v = w(v), w what the wires hand to them at one instant.

    Solved by Newton's method on w' (directional derivatives, known matrices or differences), kept between instants and
    bettered by Broyden's update; inputs that are no real numbers by iteration alone.

    Parameters
    ----------
    labels : tuple of str
        Of the inputs.
    inputs : (k,) int array
        Their places among all inputs.
    parts : tuple of int
        That they belong to.
    real : (k,) bool array
        Which of them may take any value.

    References
    ----------
    Kübler, R., Schiehlen, W.: Two methods of simulator coupling. Mathematical and Computer Modelling of Dynamical
    Systems 6(2), 2000. Broyden, C. G.: A class of methods for solving nonlinear simultaneous equations. Mathematics of
    Computation 19, 1965.
    """

    labels: tuple[str, ...]
    inputs: NDArray[np.intp]
    parts: tuple[int, ...]
    real: NDArray[np.bool_]
    slope: FloatArray = field(init=False)
    scale: float = 0.0

    def __post_init__(self) -> None:
        self.slope = np.zeros(
            (len(self.inputs), len(self.inputs))
        )  # right where the loop is declared, not real

    def solve(
        self,
        v: FloatArray,
        r: FloatArray,
        residual: Callable[[FloatArray], FloatArray],
        slope: Callable[[], FloatArray],
        t: float,
    ) -> None:
        """Call `residual` until what it was called with solves the loop.

        Parameters
        ----------
        v, r : (k,) array
            Inputs now, and w - v there.
        residual : callable
            w(v) - v, (k,) array.
        slope : callable
            Derivative of w where `residual` was called last, (k, k) array.
        t : float

        Raises
        ------
        StuckError
            If there is no solution, no single one, or none that is found.
        """
        self.scale = max(self.scale, _size(v), _size(v + r))
        limit = _LARGEST * self.scale
        slow = False
        for _ in range(_ITERATIONS):
            size = _size(r)
            if size <= _SETTLED * self.scale:
                return
            if slow:
                self.slope = self._masked(slope())
            step = self._newton(r, t)
            new, shorter = residual(v + step), 0
            while not _size(new) <= size and np.all(self.real) and shorter < 6:
                step, shorter = 0.5 * step, shorter + 1
                new = residual(v + step)
            if not np.all(np.isfinite(new)) or _size(v + step) > limit:
                break
            self.slope += self._masked(
                np.outer(new - r + step - self.slope @ step, step) / max(step @ step, 1e-300)
            )
            slow = _size(new) > _SLOW * size
            v, r = v + step, new
        if not _size(r) <= _SETTLED_SINGLE * max(self.scale, _size(v)) or _size(v) > limit:
            raise StuckError(self._words(t, f"no solution was found; {_size(r):.3g} is left over"))

    def _newton(self, r: FloatArray, t: float) -> FloatArray:
        matrix = np.eye(len(r)) - self.slope
        u, values, vt = np.linalg.svd(matrix)
        if values[-1] < _SINGULAR * max(1.0, values[0]):
            raise StuckError(self._words(t, "its gain is one, and it has no solution or many"))
        return vt.T @ ((u.T @ r) / values)

    def _masked(self, slope: FloatArray) -> FloatArray:
        return slope * np.outer(self.real, self.real)

    def _words(self, t: float, what: str) -> str:
        return (
            f"algebraic loop through {', '.join(self.labels)} at t = {t:g}: {what}. Look at the signs and gains around "
            "it, or break it where the plant has a delay or a state"
        )


def _size(values: FloatArray) -> float:
    return float(np.max(np.abs(values), initial=0.0))


def find_loops(parts: Sequence[Part], wiring: Wiring, through: NDArray[np.bool_]) -> tuple[Loop, ...]:
    """Loops of direct feedthrough, each after those that it depends on.

    Parameters
    ----------
    parts : sequence of Part
    wiring : Wiring
    through : (n_y, n_u) bool array
        Which input may act on which output without delay.
    """
    handed = (wiring.weights != 0.0).astype(int)
    sees = csr_array(handed @ through.astype(int))  # [i, j]: input i sees input j
    count, member = connected_components(sees, connection="strong")
    sizes = np.bincount(member, minlength=count)
    on_loop = (sizes[member] > 1) | (sees.diagonal() > 0)
    owner = np.repeat(np.arange(len(parts)), [len(part.inputs) for part in parts])
    types = [part.type(label) for part in parts for label in part.inputs]
    found: list[tuple[int, Loop]] = []
    for component in np.unique(member[on_loop]):
        places = np.flatnonzero(member == component)
        before = len(breadth_first_order(sees, places[0], return_predecessors=False))
        real = np.array([types[i] in ("", "Float64", "Float32") for i in places])
        labels = tuple(wiring.sinks[i] for i in places)
        found.append((before, Loop(labels, places, tuple(np.unique(owner[places]).tolist()), real)))
    return tuple(loop for _, loop in sorted(found, key=lambda pair: pair[0]))
