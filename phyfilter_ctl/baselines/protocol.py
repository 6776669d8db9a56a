"""What a differentiator is, and what a tuner needs to know of its parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from functools import wraps
from typing import Protocol, TypeVar, cast, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from ..filter import Log, PhyFilter, record
from ..filter.record import Estimator, is_log

_EQUAL = 1e-3  # of a step
S = TypeVar("S")


@runtime_checkable
class Differentiator(Estimator, Protocol):
    """A causal estimator of acceleration from sampled velocity, and so of f from a recording."""

    def estimate(self, v: ArrayLike | Log, dt: float | None = None) -> FloatArray:
        """Estimate the acceleration at every sample from that sample and those before it.

        Parameters
        ----------
        v : array_like, shape (N, n_x), or Recording
            Velocity in m/s; any other signal and its unit as well. A recording at equal steps: f_hat, f_theta and the
            derivative of the momentum that g and f_theta leave, as a filter has it.
        dt : float
            Sampling interval in s, of an array.

        Returns
        -------
        (N, n_x) array
            Derivative of v in m/s^2. The first row is zero: one sample has no slope.

        Raises
        ------
        ValueError, TypeError
            If ``v`` is not a finite real array of shape (N, n_x), ``dt`` is not above zero or missing, or the steps of
            the recording differ.
        """
        ...


def of_recordings(method: Callable[[S, ArrayLike, float], FloatArray]) -> Callable[..., FloatArray]:
    """A differentiator's ``estimate`` of an array, for recordings too."""

    @wraps(method)
    def estimate(self: S, v: ArrayLike | Log, dt: float | None = None) -> FloatArray:
        if not is_log(v):
            if dt is None:
                raise TypeError("dt: expected a number in seconds with an array, got none")
            return method(self, cast("ArrayLike", v), dt)
        if dt is not None:
            raise TypeError("dt: a recording has its own; leave it out")
        steps = np.diff(v.times)
        if len(steps) == 0 or np.ptp(steps) > _EQUAL * steps[0]:
            raise ValueError("recording: expected equal steps; see recording.resample(dt)")
        step = float(np.median(steps))
        recursion = PhyFilter([1.0]).sampled(step).recursion
        signals = record.checked_signals(recursion, v.x, v.g, v.f_theta, v.inertia)
        u = record.measured_residual(recursion, *signals, steps, slice(0, len(steps)))
        momentum = np.concatenate([np.zeros_like(u[:1]), np.cumsum(steps[:, None] * u, axis=0)])
        found = method(self, momentum, step)
        return found if v.f_theta is None else found + v.f_theta

    return estimate


@runtime_checkable
class TunableDifferentiator(Differentiator, Protocol):
    """A differentiator that says between which values its parameters are sought."""

    @classmethod
    def search_space(cls, dt: float) -> tuple[SearchRange, ...]:
        """Ranges of the tuning parameters for data sampled every ``dt`` seconds."""
        ...


@dataclass(frozen=True)
class SearchRange:
    """Range in which a tuning parameter is sought, evenly on a logarithmic scale.

    Parameters
    ----------
    name : str
        Name of the field of the differentiator.
    low, high : float
        Bounds, 0 < low < high, in the unit of the field.
    integer : bool
        Whether only whole numbers count.

    Raises
    ------
    ValueError
        If the bounds are not finite, not above zero or not in order.

    Examples
    --------
    >>> SearchRange("cutoff", 1.0, 1000.0).high
    1000.0
    """

    name: str
    low: float
    high: float
    _: KW_ONLY
    integer: bool = False

    def __post_init__(self) -> None:
        _signals.number(f"{self.name}: low", self.low, above=0.0)
        _signals.number(f"{self.name}: high", self.high, above=0.0)
        if not self.low < self.high:
            raise ValueError(f"{self.name}: expected low < high, got {self.low} and {self.high}")
