"""A step function run many times without a loop in Python."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import casadi as ca
import numpy as np

from .._sections import FloatArray

__all__ = ["Call", "Chain", "bind"]

BASE = 10
LEVELS = 4  # 1, 10, 100 and 1000 steps in one call
_WORTH = 5  # calls of a longer chain


@lru_cache(maxsize=256)
def _chained(step: ca.Function, level: int) -> ca.Function:
    """BASE**level steps: (state, data columns, p) -> (state, records)."""
    if level == 0:
        return step
    part = _chained(step, level - 1)
    state, p = ca.MX.sym("state", part.size1_in(0)), ca.MX.sym("p", part.size1_in(2))
    width = part.size2_in(1)
    data = ca.MX.sym("data", part.size1_in(1), BASE * width)
    records, now = [], state
    for columns in ca.horzsplit(data, width):
        now, record = part.call([now, columns, p], level == 1 and part.is_a("MXFunction"), False)
        records.append(record)
    return ca.Function(f"pf_chain{level}", [state, data, p], [now, ca.horzcat(*records)])


class Chain:
    """Runs a step function over data, keeping its state; one per run and thread.

    Parameters
    ----------
    step : casadi.Function
        (state, data, p) -> (next state, record), dense columns.
    state : (n,) array
    p : (n_p,) array
    """

    def __init__(self, step: ca.Function, state: FloatArray, p: FloatArray) -> None:
        self.step = step
        self._p = np.array(p, dtype=float)
        self._state = np.array(state, dtype=float)
        self._next = np.empty_like(self._state)
        self._buffers: dict[int, tuple[ca.FunctionBuffer, Callable[[], None]]] = {}

    @property
    def p(self) -> FloatArray:
        """A copy of the parameters."""
        return self._p.copy()

    @p.setter
    def p(self, value: FloatArray) -> None:
        self._p[:] = value

    @property
    def state(self) -> FloatArray:
        """A copy of the state now."""
        return self._state.copy()

    @state.setter
    def state(self, value: FloatArray) -> None:
        self._state[:] = value

    def run(self, data: FloatArray) -> FloatArray:
        """Records (S, n_r) of the steps that data (S, n_d) describes.

        Where a solver inside the diagram does not converge, the state is NaN from there on.
        """
        data = np.ascontiguousarray(data, dtype=float)
        records = np.zeros((len(data), self.step.size1_out(1)))
        done = 0
        for level in reversed(range(LEVELS)):
            size = BASE**level
            if level > 1 and level not in self._buffers and len(data) - done < _WORTH * size:
                continue  # the function would cost more to make than it saves
            while len(data) - done >= size:
                self._call(level, data[done : done + size], records[done : done + size])
                done += size
        return records

    def _call(self, level: int, data: FloatArray, records: FloatArray) -> None:
        if level not in self._buffers:
            function = _chained(self.step, level)
            buffer, trigger = function.buffer()
            self._buffers[level] = (buffer, trigger)
            bind(buffer.set_arg, 2, self._p)
        buffer, trigger = self._buffers[level]
        bind(buffer.set_arg, 0, self._state)
        bind(buffer.set_arg, 1, data)
        bind(buffer.set_res, 0, self._next)
        bind(buffer.set_res, 1, records)
        trigger()  # without the GIL
        self._state, self._next = self._next, self._state


def bind(setter: Callable[..., None], index: int, array: FloatArray) -> None:
    """Let a buffered function use an array in place."""
    if array.size:  # an empty argument has no address, and needs none
        setter(index, array.data)


class Call:
    """A CasADi function on fixed arrays."""

    def __init__(self, function: ca.Function, arguments: list[FloatArray]) -> None:
        shapes = [(function.size2_out(i), function.size1_out(i)) for i in range(function.n_out())]
        self.results: list[FloatArray] = [np.zeros(shape) for shape in shapes]
        self._arguments = arguments
        self._buffer, self._trigger = function.buffer()
        for i, array in enumerate(arguments):
            bind(self._buffer.set_arg, i, array)
        for i, array in enumerate(self.results):
            bind(self._buffer.set_res, i, array)

    def __call__(self) -> list[FloatArray]:
        self._trigger()
        return self.results
