"""The actuator of a loop: one checked form for transfer functions and state space."""

from __future__ import annotations

from dataclasses import dataclass

import control as ct
import numpy as np
from scipy.signal import tf2ss

from .. import _sections, _signals
from .._sections import ComplexArray, FloatArray

__all__ = ["Actuator", "checked_actuator", "checked_number"]

# Coefficients of a numerator below this, relative to the largest in scaled time, come from rounding.
_NOTHING = 1e-13


@dataclass(frozen=True, eq=False)
class Actuator:
    """Act(s) = numerator / prod (s - poles), stable and proper."""

    numerator: FloatArray  # ascending
    poles: ComplexArray
    matrices: tuple[FloatArray, FloatArray, FloatArray, FloatArray]

    @property
    def denominator(self) -> FloatArray:
        """Ascending coefficients with the leading 1."""
        return np.append(_sections.polynomial_from_roots(self.poles), 1.0)


def checked_actuator(actuator: ct.TransferFunction | ct.StateSpace | None) -> Actuator:
    """The actuator, 1 where there is none.

    Raises
    ------
    TypeError
        If it is no linear python-control system.
    ValueError
        If it is not continuous, single-input single-output, proper, or has a pole outside the open left half plane.
    """
    if actuator is None:
        return Actuator(np.ones(1), np.zeros(0, dtype=np.complex128), _static(1.0))
    if not isinstance(actuator, ct.TransferFunction | ct.StateSpace):
        raise TypeError(
            "actuator: expected a python-control TransferFunction or StateSpace, or None for an ideal one, got "
            f"{type(actuator).__name__}; a lag of T seconds is control.tf(1, [T, 1])"
        )
    if actuator.isdtime(strict=True):
        raise ValueError(
            f"actuator: expected a continuous-time system, got dt = {actuator.dt}; a sampled loop takes the "
            "continuous actuator too and discretises it behind the hold"
        )
    if actuator.ninputs != 1 or actuator.noutputs != 1:
        raise ValueError(
            f"actuator: expected one input and one output, got {actuator.ninputs} and {actuator.noutputs}; axes with "
            "different actuators are analysed one by one"
        )
    found = _from_tf(actuator) if isinstance(actuator, ct.TransferFunction) else _from_ss(actuator)
    if len(found.poles) and not np.max(found.poles.real) < 0.0:
        worst = found.poles[np.argmax(found.poles.real)]
        raise ValueError(
            f"actuator: pole {worst:.6g} rad/s is not in the open left half plane; the command would not hold it. "
            "Close its own loop first and give the closed one"
        )
    return found


def checked_number(name: str, value: float, *, least: float, unit: str = "") -> float:
    """A finite number of at least ``least``."""
    return _signals.number(name, value, unit.strip(), least=least)


def _static(gain: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    return np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[gain]])


def _from_tf(actuator: ct.TransferFunction) -> Actuator:
    numerator = np.trim_zeros(np.atleast_1d(np.asarray(actuator.num[0][0], dtype=float)), "f")
    denominator = np.trim_zeros(np.atleast_1d(np.asarray(actuator.den[0][0], dtype=float)), "f")
    if len(numerator) > len(denominator):
        raise ValueError(
            f"actuator: numerator of degree {len(numerator) - 1} over degree {len(denominator) - 1} is not proper; no "
            "actuator differentiates its command"
        )
    numerator, denominator = numerator / denominator[0], denominator / denominator[0]
    if len(numerator) == 0:
        numerator = np.zeros(1)
    if len(denominator) == 1:
        return Actuator(numerator, np.zeros(0, dtype=np.complex128), _static(float(numerator[0])))
    lowest = denominator[:0:-1]
    # Roots at 0 are refused later, by name.
    poles = _sections.roots_of_monic(lowest) if lowest[0] else np.roots(denominator).astype(np.complex128)
    A, B, C, D = (np.asarray(part, dtype=float) for part in tf2ss(numerator, denominator))
    return Actuator(numerator[::-1].copy(), poles, (A, B, C, D))


def _from_ss(actuator: ct.StateSpace) -> Actuator:
    A, B, C, D = (np.asarray(part, dtype=float) for part in (actuator.A, actuator.B, actuator.C, actuator.D))
    if len(A) == 0:
        return Actuator(D[0], np.zeros(0, dtype=np.complex128), (A, B, C, D))
    poles = np.linalg.eigvals(A).astype(np.complex128)
    # C adj(sI - A) B = det(sI - A + B C) - det(sI - A), in a time that brings the poles to size 1.
    scale = float(np.max(np.abs(poles))) or 1.0
    own = np.poly(A / scale)
    numerator = np.poly((A - B @ C) / scale) - (1.0 - D[0, 0]) * own
    numerator = np.where(np.abs(numerator) <= _NOTHING * np.max(np.abs(numerator)), 0.0, numerator)
    powers = scale ** np.arange(len(own))
    return Actuator(np.real(numerator * powers)[::-1].astype(np.float64), poles, (A, B, C, D))
