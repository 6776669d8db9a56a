"""Equations that stay a Python function: CasADi calls them back, in the virtual machine alone."""

from __future__ import annotations

import threading
import time
import warnings
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from itertools import count
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray

__all__ = ["Evaluation", "Interpreted", "RunEndedError", "acting"]

Evaluation: TypeAlias = Callable[[float, FloatArray, FloatArray, FloatArray], object]
"""(t, x, u, p) -> as many numbers as there are results."""

# CasADi takes functions of one name for one function where it looks for common subexpressions.
_NUMBERS = count()
_REMEDY = "Write that line with arithmetic and functions of numpy or math on t, x, u and params"


class RunEndedError(Exception):
    """Raised by a function that asks to end the run; its text says which block and when."""


class _Noted(threading.local):
    """What a run has to tell: runs of a batch are threads."""

    seconds: float = 0.0
    failure: str = ""
    ended: str = ""


class Interpreted(ca.Callback):
    """A Python function (t, x, u, p) -> column as a CasADi function.

    Parameters
    ----------
    name : str
        Of the CasADi function, where a number follows it: each has a name of its own.
    evaluate : callable
        The function; where it raises, the results are not-a-number.
    sizes : sequence of int
        Of x, u, p and the result.
    block : str
        Name of the block in messages.
    reason : str
        Why it runs as Python, with the line of source.
    depends : (results, inputs) bool array, optional
        Which input acts on which result. None: all.
    fills : sequence of float
        What the function gets for inputs that act on no result: it is called once with each, and where the results
        differ they are not-a-number.
    remedy : str
        What to do where C code is wanted.
    running : callable, optional
        Of a function that keeps something from call to call: gives the context that a run has it alone in, from the
        start. None: it keeps nothing.

    Attributes
    ----------
    seconds : float
        Spent in the function so far, by this thread.
    failure : str
        Of the first call of this thread that raised; "" for none.
    ended : str
        Why the function asked to end the run (:class:`RunEndedError`); "" while it did not.

    Notes
    -----
    Derivatives are finite differences. The function is called at points of the integrator's choosing, more than once at
    an instant and in any order. Whatever holds the CasADi function must hold this object too.

    Examples
    --------
    >>> halved = Interpreted("f", lambda t, x, u, p: [0.5 * x[0]], (1, 0, 0, 1), "half", "no expression")
    >>> halved(0.0, 3.0, [], []).full().item()
    1.5
    """

    def __init__(
        self,
        name: str,
        evaluate: Evaluation,
        sizes: Sequence[int],
        block: str,
        reason: str,
        depends: NDArray[np.bool_] | None = None,
        fills: Sequence[float] = (np.nan,),
        remedy: str = _REMEDY,
        running: Callable[[], AbstractContextManager[object]] | None = None,
    ) -> None:
        super().__init__()
        self._evaluate = evaluate
        self._sizes = (1, *sizes)
        self._depends = np.ones((sizes[3], sizes[1]), dtype=bool) if depends is None else depends
        self._unused = ~self._depends.any(axis=0)
        self._fills = tuple(fills) if self._unused.any() else (0.0,)
        self.block: str = block
        self.reason: str = reason
        self.remedy: str = remedy
        self.running: Callable[[], AbstractContextManager[object]] | None = running
        self._noted = _Noted()
        self.construct(f"{name}_{next(_NUMBERS)}", {"enable_fd": True})

    @property
    def seconds(self) -> float:
        """Spent in the function so far, by this thread."""
        return self._noted.seconds

    @seconds.setter
    def seconds(self, value: float) -> None:
        self._noted.seconds = value

    @property
    def failure(self) -> str:
        """Of the first call of this thread that raised; "" for none."""
        return self._noted.failure

    @failure.setter
    def failure(self, value: str) -> None:
        self._noted.failure = value

    @property
    def ended(self) -> str:
        """Why the function asked to end the run, in this thread; "" while it did not."""
        return self._noted.ended

    @ended.setter
    def ended(self, value: str) -> None:
        self._noted.ended = value

    def get_n_in(self) -> int:
        """CasADi asks: t, x, u and p."""
        return 4

    def get_n_out(self) -> int:
        """CasADi asks: one vector."""
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """CasADi asks: argument `i` is a dense column."""
        return ca.Sparsity.dense(self._sizes[i], 1)

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        """CasADi asks: result `i` is a dense column."""
        return ca.Sparsity.dense(self._sizes[4], 1)

    def has_jac_sparsity(self, oind: int, iind: int) -> bool:
        """CasADi asks: that of result `oind` by argument `iind` is known for u."""
        return iind == 2

    def get_jac_sparsity(self, oind: int, iind: int, symmetric: bool) -> ca.Sparsity:
        """CasADi asks: which input changes which entry of `oind` by `iind`; `symmetric` or not."""
        rows, columns = np.nonzero(self._depends)
        return ca.Sparsity.triplet(self._sizes[4], self._sizes[2], rows.tolist(), columns.tolist())

    def has_eval_buffer(self) -> bool:
        """CasADi asks: values are handed over in place."""
        return True

    def eval_buffer(self, arg: Sequence[memoryview | None], res: Sequence[memoryview | None]) -> int:
        """CasADi asks: `res` from `arg`; not-a-number, and a failure noted, where the function raises."""
        if res[0] is None:
            return 0
        begin = time.perf_counter()
        # CasADi hands over nothing for zeros.
        t, x, u, p = (
            np.zeros(size) if part is None else np.frombuffer(part)
            for part, size in zip(arg, self._sizes[:4], strict=True)
        )
        result = np.frombuffer(res[0])
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found = [self._called(float(t[0]), x, u, p, fill) for fill in self._fills]
            result[:] = np.where(np.equal(found[0], found[-1]), found[0], np.nan)
        except RunEndedError as error:
            self.ended = self.ended or str(error)
            result[:] = np.nan
        except Exception as error:
            self.failure = self.failure or f"{type(error).__name__}: {error} at t = {t[0]:.9g} s"
            result[:] = np.nan
        self.seconds += time.perf_counter() - begin
        return 0

    def _called(self, t: float, x: FloatArray, u: FloatArray, p: FloatArray, fill: float) -> FloatArray:
        # Copies, since the function may write into them.
        filled = np.where(self._unused, fill, u)
        found = np.array(self._evaluate(t, x.copy(), filled, p.copy()), dtype=float).reshape(-1)
        if len(found) != self._sizes[4]:
            raise ValueError(f"{len(found)} results, expected {self._sizes[4]}")
        return found


def acting(function: Callable[[FloatArray], FloatArray], places: Sequence[FloatArray]) -> NDArray[np.bool_]:
    """Which entry of the argument changes which entry of the result at some place, (results, arguments).

    Parameters
    ----------
    function : callable
    places : sequence of arrays

    Examples
    --------
    >>> acting(lambda u: np.array([u[1] ** 2, 3.0]), [np.zeros(2)]).tolist()
    [[False, True], [False, False]]
    """
    found = []
    for place in places:
        before = function(place)
        for j in range(len(place)):
            for change in (1e-3, 1.0, -2.7, 40.0):
                moved = place.copy()
                moved[j] += change
                after = function(moved)
                found.append((j, ~((after == before) | (np.isnan(after) & np.isnan(before)))))
    result = np.zeros((len(function(places[0])), len(places[0])), dtype=bool)
    for j, changed in found:
        result[:, j] |= changed
    return result
