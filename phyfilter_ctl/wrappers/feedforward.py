"""What the filter finds as feed-forward on top of a loop that exists: the one function that all wrappers share.

u = clip(u of the loop + compensate(y, f_hat)), and g is that of the command that acted, after the limits, as the mean
of its values at both ends of the step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _signals
from ..filter import LiveFilter

__all__ = ["FeedForward", "LoopModel"]

Y = TypeVar("Y")
Array = NDArray[np.floating]


@dataclass(frozen=True)
class LoopModel(Generic[Y]):
    """What a loop knows of its robot, from observations y and commands u.

    Parameters
    ----------
    x : callable
        y -> (n_x,) what M x' is about: velocities.
    g : callable
        (y, u) -> (n_x,) known part of M x', the command's effect included.
    compensate : callable
        (y, f_hat) -> what to add to u so that f_hat is cancelled, as far as the actuators reach.
    inertia : callable, optional
        y -> a number, (n_x,) or (n_x, n_x); None means I.
    f_theta : callable, optional
        y -> (n_f,) learned model of f; None means 0.
    low, high : float or array_like
        Limits of the command, low < high, else ValueError.
    """

    x: Callable[[Y], ArrayLike]
    g: Callable[[Y, Array], ArrayLike]
    compensate: Callable[[Y, Array], ArrayLike]
    inertia: Callable[[Y], ArrayLike] | None = None
    f_theta: Callable[[Y], ArrayLike] | None = None
    low: ArrayLike = -np.inf
    high: ArrayLike = np.inf

    def __post_init__(self) -> None:
        if not np.all(_signals.real("low", self.low) < _signals.real("high", self.high)):
            raise ValueError(f"low, high: expected low < high, got {self.low!r} and {self.high!r}")


class FeedForward(Generic[Y]):
    """A function to call once a sample between a controller and its actuators.

    Parameters
    ----------
    live : LiveFilter
        With ``g="hold"``, else ValueError: commands are held between samples. The command is the one that acts from
        this sample on; what it makes of g is kept for the next one.
    model : LoopModel

    Examples
    --------
    A proportional speed controller of a wheel of 0.5 kg m^2 on which 2 N m act that nobody told it:

    >>> from phyfilter_ctl import PhyFilter
    >>> wheel = LoopModel(
    ...     x=lambda y: [y], g=lambda y, u: u, compensate=lambda y, f_hat: -f_hat, inertia=lambda y: 0.5
    ... )
    >>> feedforward = FeedForward(PhyFilter([10.0]).sampled(0.01).live(1), wheel)
    >>> speed = 0.0
    >>> for k in range(300):
    ...     torque = feedforward(0.01 * k, speed, [2.0 * (1.0 - speed)])
    ...     speed += 0.01 * (float(torque[0]) + 2.0) / 0.5
    >>> round(speed, 3), feedforward.live.f_hat.round(3).tolist()
    (1.0, [2.0])
    """

    def __init__(self, live: LiveFilter, model: LoopModel[Y]) -> None:
        if live.recursion.sampling.g != "hold":
            raise ValueError('live: expected a filter sampled with g="hold", for the command is held')
        self.live = live
        self.model = model
        self._acting: tuple[Y, Array] | None = None
        self._seen: Y | None = None

    def reset(self) -> None:
        """Forget everything: a new episode, a robot that was put elsewhere."""
        self.live.reset()
        self._acting = self._seen = None

    def estimate(self, time: float, y: Y | None) -> Array:
        """f_hat (n_f,) from the observation y at a time in seconds; None: none came. Give a copy of a buffer."""
        if y is None:
            return self.live.step(time, None, self._g(None))
        f_theta = None if self.model.f_theta is None else self.model.f_theta(y)
        M = None if self.model.inertia is None else self.model.inertia(y)
        f_hat = self.live.step(time, self.model.x(y), self._g(y), f_theta, inertia=M)
        if not self.live.held:
            self._seen = y
        return f_hat

    def _g(self, y: Y | None) -> Array | None:
        """Mean over the step that ends now."""
        if self._acting is None:
            return None
        before, u = self._acting
        first = np.asarray(self.model.g(before, u), dtype=float)
        return first if y is None else 0.5 * (first + np.asarray(self.model.g(y, u), dtype=float))

    def command(self, u: ArrayLike) -> Array:
        """The command to send, within the limits, for the u that the loop wants to send; of its shape."""
        wanted = _signals.real("u", u)
        if self._seen is None:
            return np.clip(wanted, self.model.low, self.model.high)
        extra = np.asarray(self.model.compensate(self._seen, self.live.f_hat), dtype=float)
        sent = np.clip(wanted + extra, self.model.low, self.model.high)
        self._acting = (self._seen, sent)
        return sent

    def __call__(self, time: float, y: Y | None, u: ArrayLike) -> Array:
        """:meth:`estimate`, then :meth:`command`."""
        self.estimate(time, y)
        return self.command(u)
