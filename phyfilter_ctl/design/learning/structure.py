"""What a learned F is made to be by construction: its gain at rest, zeros of 1 - F and of F, where its poles may lie.

Every condition is linear in the output row c of the chain with states xi, F = c xi:

    c xi(0) = F(0),    c xi^(j)(0) = 0 for 1 <= j < k (type k),    c xi(j w) = 1 (1 - F = 0) or 0 (F = 0)

so the numerator is found by least squares under equality constraints, and no penalty has to be weighed. The conditions
move with theta as the states do: the chain with doubled poles gives xi and its derivatives at any s.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass
from typing import SupportsIndex

import numpy as np
from numpy.typing import ArrayLike

from ... import _signals
from ..._choices import Form
from ..._sections import ComplexArray, FloatArray, given_poles
from ...filter import PhyFilter

__all__ = ["FREE", "Form", "Structure", "structure_of"]

# Damping ratio that complex poles keep where limits are set: a pole on the imaginary axis has no filter.
_LEAST_DAMPING = 0.02


@dataclass(frozen=True, eq=False)
class Structure:
    """Conditions on F.

    Attributes
    ----------
    dc_gain : float or None
        F(0); None leaves it free.
    type : int
        Zeros of 1 - F at s = 0, those beyond the first; 1 where only F(0) counts.
    zeros_at, blocked_at : (m,) arrays
        Angular frequencies in rad/s where 1 - F, and F, vanish.
    poles : (m,) complex array
        Poles that are given.
    pole_range : (float, float) or None
        Least and largest magnitude of the other poles in rad/s.
    damping : float or None
        Least damping ratio of the other poles.
    """

    dc_gain: float | None
    type: int
    zeros_at: FloatArray
    blocked_at: FloatArray
    poles: ComplexArray
    pole_range: tuple[float, float] | None
    damping: float | None

    @property
    def conditions(self) -> int:
        """Number of real conditions on the numerator."""
        at_rest = 0 if self.dc_gain is None else self.type
        return at_rest + 2 * (len(self.zeros_at) + len(self.blocked_at))

    @property
    def least_order(self) -> int:
        """Lowest order that can meet everything."""
        return max(self.conditions, len(self.poles), 1)

    @property
    def is_limited(self) -> bool:
        """Whether poles are given or limited beyond what the data say."""
        return bool(len(self.poles)) or self.pole_range is not None or self.damping is not None

    @property
    def least_damping(self) -> float:
        """Damping ratio that complex poles keep where limits are set."""
        return max(self.damping or 0.0, _LEAST_DAMPING)

    def rows(self, doubled: FloatArray) -> tuple[FloatArray, FloatArray]:
        """S (2n, p) of the states [xi; eta] and d (p,): F keeps its conditions where c S[:n] = d.

        Columns are scaled by powers of the slowest pole.
        """
        A, B = doubled[:-1, :-1], doubled[:-1, -1]
        columns: list[np.ndarray] = []
        targets: list[float] = []
        if self.dc_gain is not None:
            states, unit = -B, 1.0
            for j in range(self.type):
                if j == 1:
                    unit = float(np.min(np.abs(np.linalg.eigvals(A[: len(A) // 2, : len(A) // 2]))))
                states = np.asarray(np.linalg.solve(A, states * unit))
                columns.append(states)
                targets.append(0.0 if j else self.dc_gain)
        for omega, value in ((self.zeros_at, 1.0), (self.blocked_at, 0.0)):
            for w in omega:
                states = np.linalg.solve(1j * w * np.eye(len(A)) - A, B.astype(np.complex128))
                columns += [states.real, states.imag]
                targets += [value, 0.0]
        if not columns:
            return np.zeros((len(A), 0)), np.zeros(0)
        return np.stack(columns, axis=1), np.array(targets)

    def tidied(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """The numerator with the coefficients that follow from a exactly."""
        b = np.array(b)
        if self.dc_gain is not None:
            b[0] = self.dc_gain * a[0]
            b[1 : self.type] = a[1 : self.type]
        return b

    def refuse(self, order: int) -> None:
        """Refuse an order that cannot meet the conditions.

        Raises
        ------
        ValueError
            Naming the order that can.
        """
        if order < self.least_order:
            raise ValueError(
                f"order: {self.conditions} conditions on F (its gain at rest, type and zeros) and {len(self.poles)} "
                f"given poles need order {self.least_order} at least, got {order}"
            )


FREE = Structure(None, 1, np.zeros(0), np.zeros(0), np.zeros(0, dtype=np.complex128), None, None)


def structure_of(
    form: Form,
    *,
    dc_gain: float | None,
    type: SupportsIndex | None,
    zeros_at: ArrayLike,
    blocked_at: ArrayLike,
    poles: ArrayLike,
    pole_range: tuple[float, float] | None,
    damping: float | None,
) -> Structure:
    """The conditions that :func:`learn` was asked for, checked.

    Raises
    ------
    ValueError
        If they are out of range or contradict each other or the form.
    """
    kind = 1 if type is None else operator.index(type)
    gain = None if dc_gain is None else _signals.number("dc_gain", dc_gain)
    zeros, blocked = _frequencies("zeros_at", zeros_at), _frequencies("blocked_at", blocked_at)
    if kind < 1 or (kind > 1 and gain != 1.0):
        raise ValueError(
            f"type: expected 1 or more with dc_gain=1, got type={kind} with dc_gain={dc_gain}; type 0 is dc_gain=None"
        )
    if set(zeros) & set(blocked):
        raise ValueError("zeros_at, blocked_at: F cannot be 1 and 0 at one frequency")
    if form == "lowpass" and (kind > 1 or len(zeros) or len(blocked) or gain not in (1.0, None)):
        raise ValueError(
            "form: the low-pass form N = a_0 has F(0) = 1, type 1 and no zeros of choice; use form='general'"
        )
    given = given_poles(poles) if np.size(np.asarray(poles)) else FREE.poles
    return Structure(
        None if form == "lowpass" else gain,
        kind,
        zeros,
        blocked,
        PhyFilter.from_poles(given).poles() if len(given) else given,
        _range(pole_range),
        None if damping is None else _damping(damping),
    )


def _frequencies(name: str, values: ArrayLike) -> FloatArray:
    found = np.atleast_1d(_signals.real(name, values))
    if found.ndim != 1 or not np.all(np.isfinite(found) & (found > 0.0)) or len(set(found)) < len(found):
        raise ValueError(f"{name}: expected distinct positive frequencies in rad/s, got {found.tolist()}")
    return found


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
