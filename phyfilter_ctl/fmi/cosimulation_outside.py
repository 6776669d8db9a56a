"""Inputs of a co-simulation that no part drives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _signals
from .._sections import FloatArray
from .cosimulation_wiring import Wire, Wiring

__all__ = ["Outside", "Signal"]

Signal = float | ArrayLike | Callable[[float], float]


class Outside:
    """Inputs that no part drives.

    Parameters
    ----------
    wiring : Wiring
    inputs : dict of str to number, array or callable
    connectors : dict of str to sequence of Wire
        What a name in ``inputs`` drives, where it is no input itself.
    times : (N,) array
        Of the arrays in ``inputs``.
    """

    def __init__(
        self,
        wiring: Wiring,
        inputs: Mapping[str, Signal],
        connectors: Mapping[str, Sequence[Wire]],
        times: FloatArray,
    ) -> None:
        self.labels: tuple[str, ...] = tuple(inputs)
        self.has_functions: bool = any(callable(value) for value in inputs.values())
        self._signals = [_signal(name, value, times) for name, value in inputs.items()]
        self.matrix: FloatArray = np.zeros((len(wiring.sinks), len(inputs)))
        self.offset: FloatArray = np.zeros(len(wiring.sinks))
        for j, name in enumerate(inputs):
            for wire in connectors.get(name, [Wire(name, "")]):
                i = wiring.sink(wire.sink)
                if wiring.driven[i] or np.any(self.matrix[i]):
                    raise ValueError(f"inputs: {wire.sink!r} is driven already")
                self.matrix[i, j] = wire.gain
                self.offset[i] = wire.offset
        self.driven: NDArray[np.bool_] = np.any(self.matrix != 0.0, axis=1)

    def at(self, t: float) -> FloatArray:
        """Values at a time.

        Parameters
        ----------
        t : float
        """
        return self.over(np.array([t]))[0]

    def over(self, times: FloatArray) -> FloatArray:
        """Values at times, (N, signals).

        Parameters
        ----------
        times : (N,) array
        """
        columns = [signal(times) for signal in self._signals]
        return np.column_stack(columns) if columns else np.zeros((len(times), 0))


def _signal(name: str, value: Signal, times: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """A function of an array of times."""
    if callable(value):
        return lambda ts: np.array([value(t) for t in ts.tolist()], dtype=float)
    array = _signals.real(f"inputs: {name!r}", value)
    if array.shape not in ((), times.shape) or not np.all(np.isfinite(array)):
        raise ValueError(
            f"inputs: {name!r}: expected a number, {len(times)} finite values (one per time) or a function of time, "
            f"got shape {array.shape}"
        )
    if array.ndim == 0:
        return lambda ts: np.full(len(ts), float(array))
    return lambda ts: np.interp(ts, times, array)
