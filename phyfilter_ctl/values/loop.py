"""The loop around a filter: outer gains, actuator, delay, and what the filter is told."""

from __future__ import annotations

from dataclasses import dataclass, replace
from numbers import Real
from typing import Literal, get_args

import control as ct
import numpy as np

from .. import _signals
from .actuator import checked_actuator

__all__ = ["Loop", "Told"]

# What a filter in a loop is told: the command, or the force that acts, lag and delay of the actuator and all.
Told = Literal["commanded", "applied"]


@dataclass(frozen=True)
class Loop:
    """The loop around a filter: tau = M_hat (-kp position - kd x) - f_hat through actuator and delay.

    Parameters
    ----------
    kp, kd : float
        Outer gains per unit of modelled inertia in 1/s^2 and 1/s; both 0: f_hat alone is fed back.
    actuator : float, control.TransferFunction or control.StateSpace, optional
        A number is the time constant of a first-order lag in s. Systems are continuous, stable, proper, with one input
        and one output. None: an ideal one.
    delay : float
        Of the command, in s.
    inertia_ratio : float
        mu = M_hat / M at which margins and tracking errors are taken.
    g : {"commanded", "applied"}
        What the filter is told: the command v, or the force Act e^(-s delay) v that acts, lag and delay and all: a
        measured motor current times the torque constant, say; sampled, its mean over the step.
    command_limit : float, optional
        Most that the actuator has for the part of the command that is fed back, in the unit of f.

    Raises
    ------
    TypeError
        For an actuator of another kind.
    ValueError
        For a number out of range, an actuator that is unstable, improper, discrete or has several inputs.

    Examples
    --------
    >>> loop = Loop(10.0, 6.0, actuator=0.05, delay=0.01)
    >>> loop.inner
    Loop(kp=0.0, kd=0.0, actuator=0.05, delay=0.01, inertia_ratio=1.0, g='commanded', command_limit=None)
    """

    kp: float = 0.0
    kd: float = 0.0
    actuator: float | ct.TransferFunction | ct.StateSpace | None = None
    delay: float = 0.0
    inertia_ratio: float = 1.0
    g: Told = "commanded"
    command_limit: float | None = None

    def __post_init__(self) -> None:
        for name, unit in (("kp", "1/s^2"), ("kd", "1/s"), ("delay", "s")):
            object.__setattr__(self, name, _signals.number(name, getattr(self, name), unit, least=0.0))
        if not _signals.number("inertia_ratio", self.inertia_ratio, least=0.0):
            raise ValueError("inertia_ratio: expected a positive ratio M_hat / M, got 0")
        if not isinstance(self.g, str) or self.g not in get_args(Told):
            raise ValueError(f"g: expected {' or '.join(map(repr, get_args(Told)))}, got {self.g!r}")
        limit = self.command_limit
        if limit is not None and not (isinstance(limit, Real) and limit > 0.0):
            raise ValueError(f"command_limit: expected a positive force, got {limit!r}")
        checked_actuator(self.system)

    @property
    def inner(self) -> Loop:
        """The same without outer gains: f_hat alone fed back."""
        return replace(self, kp=0.0, kd=0.0)

    @property
    def has_gains(self) -> bool:
        """Whether there is an outer loop."""
        return bool(self.kp or self.kd)

    @property
    def system(self) -> ct.TransferFunction | ct.StateSpace | None:
        """The actuator as a python-control system; None for an ideal one."""
        if isinstance(self.actuator, int | float | np.integer | np.floating):
            lag = _signals.number("actuator", float(self.actuator), "s", least=0.0)
            return ct.TransferFunction([1.0], [lag, 1.0]) if lag else None
        return self.actuator
