"""What a differentiator is, and what a tuner needs to know of its parameters."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Protocol, runtime_checkable

from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray


@runtime_checkable
class Differentiator(Protocol):
    """A causal estimator of acceleration from sampled velocity."""

    def estimate(self, v: ArrayLike, dt: float) -> FloatArray:
        """Estimate the acceleration at every sample from that sample and those before it.

        Parameters
        ----------
        v : array_like, shape (N, n_x)
            Velocity in m/s; any other signal and its unit as well.
        dt : float
            Sampling interval in s.

        Returns
        -------
        (N, n_x) array
            Derivative of v in m/s^2. The first row is zero: one sample has no slope.

        Raises
        ------
        ValueError, TypeError
            If ``v`` is not a finite real array of shape (N, n_x) or ``dt`` is not above zero.
        """
        ...


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
