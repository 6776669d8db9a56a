"""What a learned F is made to be by construction: its gain at rest, zeros of 1 - F and of F, where its poles may lie.

Every condition is linear in the output row c of the chain with states xi, F = c xi:

    c xi(0) = F(0),    c xi^(j)(0) = 0 for 1 <= j < k (type k),    c xi(j w) = 1 (1 - F = 0) or 0 (F = 0)

so the numerator is found by least squares under equality constraints, and no penalty has to be weighed. The conditions
move with theta as the states do: the chain with doubled poles gives xi and its derivatives at any s.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import SupportsIndex, get_args

import numpy as np
from numpy.typing import ArrayLike

from ... import _signals
from ..._choices import Form
from ..._sections import FloatArray, given_poles
from ...filter import PhyFilter

__all__ = ["FREE", "LOWPASS", "Form", "Shape", "condition_rows", "refuse_order", "shape_of", "tidied"]

# Damping ratio that complex poles keep where limits are set: a pole on the imaginary axis has no filter.
_LEAST_DAMPING = 0.02


@dataclass(frozen=True, init=False)
class Shape:
    """What a learned F is made to be, for ``learn(..., shape=...)``.

    Parameters
    ----------
    form : {"lowpass", "general"}
        N = a_0, or N free but for the conditions below.
    dc_gain : float or None
        F(0) of the general form: 1, the default, follows a constant residual with no steady error. 0 leaves it alone
        (band-pass). None leaves F(0) to the data, which rarely hold it.
    type : int
        Zeros of 1 - F at s = 0 (general form): 2 follows ramps with no steady error, and so on.
    zeros_at : array_like, shape (m,)
        Angular frequencies in rad/s at which 1 - F vanishes, as for :func:`~phyfilter_ctl.place_poles`: what is
        periodic there is followed.
    blocked_at : array_like, shape (m,)
        Angular frequencies in rad/s at which F vanishes: what is periodic there, a vibration, is not followed.
    poles : array_like, shape (m,)
        Poles in rad/s that are given; the others are learned.
    pole_range : (float, float), optional
        Least and largest magnitude in rad/s of the poles that are learned, inside what the data show (Notes of
        :func:`~phyfilter_ctl.learn`).
    damping : float, optional
        Least damping ratio of the poles that are learned.

    Raises
    ------
    ValueError
        If a condition is out of range, or contradicts another one or the form.

    Examples
    --------
    >>> Shape("general", type=2, zeros_at=[6.28]).least_order
    4
    """

    form: Form
    dc_gain: float | None
    type: int
    zeros_at: tuple[float, ...]
    blocked_at: tuple[float, ...]
    poles: tuple[complex, ...]
    pole_range: tuple[float, float] | None
    damping: float | None

    def __init__(
        self,
        form: Form = "lowpass",
        *,
        dc_gain: float | None = 1.0,
        type: SupportsIndex = 1,
        zeros_at: ArrayLike = (),
        blocked_at: ArrayLike = (),
        poles: ArrayLike = (),
        pole_range: Sequence[float] | None = None,
        damping: float | None = None,
    ) -> None:
        if form not in get_args(Form):
            raise ValueError(f"form: expected one of {', '.join(get_args(Form))}, got {form!r}")
        kind = operator.index(type)
        gain = None if dc_gain is None else _signals.number("dc_gain", dc_gain)
        zeros, blocked = _frequencies("zeros_at", zeros_at), _frequencies("blocked_at", blocked_at)
        if kind < 1 or (kind > 1 and gain != 1.0):
            raise ValueError(
                f"type: expected 1 or more with dc_gain=1, got type={kind} with dc_gain={dc_gain}; type 0 is "
                "dc_gain=None"
            )
        if set(zeros) & set(blocked):
            raise ValueError("zeros_at, blocked_at: F cannot be 1 and 0 at one frequency")
        if form == "lowpass" and (kind > 1 or zeros or blocked or gain not in (1.0, None)):
            raise ValueError(
                "form: the low-pass form N = a_0 has F(0) = 1, type 1 and no zeros of choice; use the form 'general'"
            )
        given: tuple[complex, ...] = ()
        if np.size(np.asarray(poles)):
            given = tuple(PhyFilter.from_poles(given_poles(poles)).poles().tolist())
        values = (
            form,
            gain,
            kind,
            zeros,
            blocked,
            given,
            _range(pole_range),
            None if damping is None else _damping(damping),
        )
        for entry, value in zip(fields(self), values, strict=True):
            object.__setattr__(self, entry.name, value)

    @property
    def conditions(self) -> int:
        """Number of real conditions on the numerator."""
        at_rest = 0 if self.form == "lowpass" or self.dc_gain is None else self.type
        return at_rest + 2 * (len(self.zeros_at) + len(self.blocked_at))

    @property
    def least_order(self) -> int:
        """Lowest order that can meet everything."""
        return max(self.conditions, len(self.poles), 1)

    @property
    def is_limited(self) -> bool:
        """Whether poles are given or limited beyond what the data say."""
        return bool(self.poles) or self.pole_range is not None or self.damping is not None

    @property
    def least_damping(self) -> float:
        """Damping ratio that complex poles keep where limits are set."""
        return max(self.damping or 0.0, _LEAST_DAMPING)


def shape_of(given: Shape | Form) -> Shape:
    """A shape, or the one that a word says."""
    if isinstance(given, Shape):
        return given
    if given not in get_args(Form):
        raise ValueError(f"shape: expected a Shape, or one of {', '.join(get_args(Form))}, got {given!r}")
    return Shape(given)


def condition_rows(shape: Shape, doubled: FloatArray) -> tuple[FloatArray, FloatArray]:
    """S (2n, p) of the states [xi; eta] and d (p,): F keeps its conditions where c S[:n] = d.

    Columns are scaled by powers of the slowest pole.
    """
    A, B = doubled[:-1, :-1], doubled[:-1, -1]
    columns: list[np.ndarray] = []
    targets: list[float] = []
    if shape.dc_gain is not None:
        states, unit = -B, 1.0
        for j in range(shape.type):
            if j == 1:
                unit = float(np.min(np.abs(np.linalg.eigvals(A[: len(A) // 2, : len(A) // 2]))))
            states = np.asarray(np.linalg.solve(A, states * unit))
            columns.append(states)
            targets.append(0.0 if j else shape.dc_gain)
    for omega, value in ((shape.zeros_at, 1.0), (shape.blocked_at, 0.0)):
        for w in omega:
            states = np.linalg.solve(1j * w * np.eye(len(A)) - A, B.astype(np.complex128))
            columns += [states.real, states.imag]
            targets += [value, 0.0]
    if not columns:
        return np.zeros((len(A), 0)), np.zeros(0)
    return np.stack(columns, axis=1), np.array(targets)


def tidied(shape: Shape, a: FloatArray, b: FloatArray) -> FloatArray:
    """The numerator with the coefficients that follow from a exactly."""
    b = np.array(b)
    if shape.dc_gain is not None:
        b[0] = shape.dc_gain * a[0]
        b[1 : shape.type] = a[1 : shape.type]
    return b


def refuse_order(shape: Shape, order: int) -> None:
    """Refuse an order that cannot meet the conditions.

    Raises
    ------
    ValueError
        Naming the order that can.
    """
    if order < shape.least_order:
        raise ValueError(
            f"order: {shape.conditions} conditions on F (its gain at rest, type and zeros) and {len(shape.poles)} "
            f"given poles need order {shape.least_order} at least, got {order}"
        )


def _frequencies(name: str, values: ArrayLike) -> tuple[float, ...]:
    found = np.atleast_1d(_signals.real(name, values))
    if found.ndim != 1 or not np.all(np.isfinite(found) & (found > 0.0)) or len(set(found)) < len(found):
        raise ValueError(f"{name}: expected distinct positive frequencies in rad/s, got {found.tolist()}")
    return tuple(found.tolist())


def _range(limits: Sequence[float] | None) -> tuple[float, float] | None:
    if limits is None:
        return None
    low, high = _signals.array("pole_range", limits, (2,))
    if not 0.0 < low < high < np.inf:
        raise ValueError(
            f"pole_range: expected 0 < least < largest magnitude in rad/s, got {low:g}, {high:g}"
        )
    return float(low), float(high)


def _damping(damping: float) -> float:
    value = _signals.number("damping", damping)
    if not 0.0 <= value <= 1.0:
        raise ValueError(f"damping: expected a least damping ratio of 0 to 1, got {value:g}")
    return value


LOWPASS = Shape()
FREE = Shape("general", dc_gain=None)
