"""Matched sampling: the output row with which the sampled filter keeps the zeros of 1 - F at the samples.

Samples of gamma = e^(s t) reach the recursion as means over the step, so that w_k = X(s) e^(s t_k) with

    X(s) = (z I - I - dA)^-1 (-dA equilibrium) (z - 1)/(s h),    z = e^(s h)

and the estimate C w_k has no error where C X(s) = 1. Exact sampling (the row C of F itself) has it at s = 0 only:
what a step's mean differs from its end by, of order (s h)^2, is left at every other zero of 1 - F. The matched row
asks it, with k - 1 derivatives, at s = 0 (type k) and at each zero s = +-j w on the axis: k + 2 m real conditions on
n entries, that F itself met with k + 2 m <= n coefficients. What they leave free stays as near C as can be. A filter
of type 0 keeps its F(0) as well. Proof and figures: docs/sampling.md.

The poles, and so stability and start, are those of exact sampling; what is new is a numerator.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .._sections import ComplexArray, FloatArray, expm1

if TYPE_CHECKING:
    from .rational import Rational

__all__ = ["followed_frequencies", "kept", "matched_output"]

# A zero of 1 - F this near the axis, relative to its magnitude, was put there.
_ON_AXIS = 1e-6
# A row so many times larger than that of F lives on differences of states that a step too long made alike.
_LARGEST_CHANGE = 50.0


def followed_frequencies(filter: Rational) -> FloatArray:
    """Angular frequencies w > 0 in rad/s at which 1 - F vanishes, ascending."""
    c = filter.error_numerator[filter.type :]
    degree = len(c) - 1
    if degree < 2:
        return np.zeros(0)
    scale = abs(c[0]) ** (1.0 / degree)
    scaled = c / scale ** np.arange(degree, -1, -1.0)
    roots = np.roots(scaled[::-1]).astype(np.complex128)
    found = roots[(roots.imag > 0.0) & (np.abs(roots.real) <= _ON_AXIS * np.abs(roots))]
    return scale * np.sort(_polished(scaled, found).imag)


def _polished(c: FloatArray, roots: ComplexArray) -> ComplexArray:
    """Roots of the polynomial of ascending coefficients, two steps of Newton's method nearer."""
    slope = np.polynomial.polynomial.polyder(c)
    for _ in range(2):
        steepness = np.polynomial.polynomial.polyval(roots, slope)
        value = np.polynomial.polynomial.polyval(roots, c)
        roots = roots - np.divide(value, steepness, out=np.zeros_like(value), where=steepness != 0.0)
    return roots


def kept(filter: Rational, dt: float) -> bool | None:
    """Whether matched sampling keeps what exact sampling loses; None where it cannot."""
    w = followed_frequencies(filter)
    if filter.type < 2 and not len(w):
        return False
    return None if isinstance(_row(filter, w, dt), str) else True


def matched_output(filter: Rational, dt: float) -> FloatArray:
    """The matched row (n,) for a step of dt; C itself where exact sampling loses nothing.

    Raises
    ------
    ValueError
        If 1 - F vanishes at or beyond the Nyquist frequency, its zeros leave no room for F(0), or the step is far too
        long for the poles.
    """
    w = followed_frequencies(filter)
    if filter.type < 2 and not len(w):
        return filter.sections[2]
    row = _row(filter, w, dt)
    if isinstance(row, str):
        raise ValueError(f"method='matched': {row}, or use method='exact'")
    return row


def _row(filter: Rational, w: FloatArray, dt: float) -> FloatArray | str:
    """The matched row, or why there is none and what to do."""
    if reason := _against(filter, w, dt):
        return reason
    A, equilibrium, C = filter.sections
    dA = expm1(A, dt)
    rows = _at_zero(dA, equilibrium, filter, dt)
    targets = [float(C @ equilibrium) if filter.type == 0 else 1.0, *[0.0] * (len(rows) - 1)]
    for X in _on_axis(dA, equilibrium, w, dt):
        rows += [X.real, X.imag]
        targets += [1.0, 0.0]
    R = np.stack(rows)
    size = np.linalg.norm(R, axis=1)
    missing = (np.array(targets) - R @ C) / size
    change = np.linalg.lstsq(R / size[:, None], missing, rcond=None)[0]
    if not np.max(np.abs(change)) <= _LARGEST_CHANGE * np.max(np.abs(C)):
        return (
            f"a step of {dt:.6g} s is too long for poles of up to {np.max(np.abs(filter.poles)):.6g} rad/s, whose "
            "states it cannot tell apart; sample faster"
        )
    return np.asarray(C + change)


def _against(filter: Rational, w: FloatArray, dt: float) -> str:
    """Why zeros at these frequencies cannot be kept, and what to do; empty where they can."""
    if len(w) and w[-1] * dt >= np.pi:
        return (
            f"1 - F vanishes at {w[-1]:.6g} rad/s, at or beyond the Nyquist frequency pi/h = {np.pi / dt:.6g} rad/s, "
            "where no sampled filter can follow; sample faster"
        )
    if max(filter.type, 1) + 2 * len(w) > filter.order:
        return (
            f"order {filter.order} cannot keep both F(0) = {filter.dc_gain:.6g} and the zeros of 1 - F at "
            f"{', '.join(f'{entry:.6g}' for entry in w)} rad/s; take a higher order"
        )
    return ""


def _at_zero(dA: FloatArray, equilibrium: FloatArray, filter: Rational, dt: float) -> list[FloatArray]:
    """Taylor coefficients of X at s = 0, as many as the type says (one at least), s in units of the slowest pole."""
    unit = dt * float(np.min(np.abs(filter.poles)))
    rows: list[FloatArray] = []
    # ((z - 1) I - dA) X = -dA equilibrium (z - 1)/(s h), both sides as series in s.
    power = [1.0]  # (s h)^j / j!
    for j in range(max(filter.type, 1)):
        power.append(power[-1] * unit / (j + 1))
        row = equilibrium * (power[j] / (j + 1))
        if j:
            earlier = sum((power[i] * rows[j - i] for i in range(1, j + 1)), start=np.zeros_like(row))
            row = row + np.linalg.solve(dA, earlier)
        rows.append(row)
    return rows


def _on_axis(dA: FloatArray, equilibrium: FloatArray, w: FloatArray, dt: float) -> ComplexArray:
    """X at s = j w, (len(w), n)."""
    delta = np.expm1(1j * w * dt)
    entry = np.multiply.outer(delta / (1j * w * dt), -dA @ equilibrium)
    systems = delta[:, None, None] * np.eye(len(dA)) - dA
    return np.asarray(np.linalg.solve(systems, entry[..., None])[..., 0], dtype=np.complex128)
