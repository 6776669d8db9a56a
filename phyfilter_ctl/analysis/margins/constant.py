"""Sets of constant inertia matrices by the stable ratios of a loop: one pair, Loewner bounds, deviations, hulls."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ... import _signals
from ..._sections import FloatArray
from ...results import Status
from . import _inertia
from .filter_margins import FilterMargins
from .moving import FORCES, InertiaCertificate

__all__ = ["between_two", "of_hull", "of_pair", "within_deviation"]


def of_pair(margins: FilterMargins, M_hat: ArrayLike, M: ArrayLike) -> InertiaCertificate:
    """One pair of regular matrices, exact: every eigenvalue of M_hat M^-1."""
    found = _inertia.ratios(_inertia.checked_inertia("M_hat", M_hat), _inertia.checked_inertia("vertices", M))
    lost = [value for value in found if not margins.stable(complex(value))]
    ends = float(found.real.min()), float(found.real.max())
    if lost:
        message = f"unstable at the eigenvalue {_short(lost[0])} of M_hat M^-1"
        return _answer(margins, Status.REFUTED, "eigenvalues", *ends, message)
    return _answer(margins, Status.PROVEN, "eigenvalues", *ends, "stable at every eigenvalue of M_hat M^-1")


def between_two(
    margins: FilterMargins, M_hat: ArrayLike, low: ArrayLike, high: ArrayLike
) -> InertiaCertificate:
    """Every symmetric M with low <= M <= high: eigenvalues stay between the least for high and the largest for low."""
    named = {"M_hat": M_hat, "low": low, "high": high}
    model, least, most = (
        _inertia.definite(name, _inertia.checked_inertia(name, value)) for name, value in named.items()
    )
    if len({each.shape for each in (model, least, most)}) > 1:
        raise ValueError(
            f"M_hat, low and high: expected one shape, got {[each.shape for each in (model, least, most)]}"
        )
    apart = float(np.linalg.eigvalsh(most - least)[0])
    if apart < -1e-12 * float(np.max(np.abs(most))):
        raise ValueError(
            f"low and high: high - low has the eigenvalue {apart:.4g}, expected none below 0; are they exchanged?"
        )
    return _range(margins, *_inertia.loewner_range(model, least, most), attained=True)


def within_deviation(margins: FilterMargins, M_hat: ArrayLike, deviation: ArrayLike) -> InertiaCertificate:
    """Every M near M_hat: in the spectral norm for a number, entry by entry for a matrix."""
    model = _inertia.checked_inertia("M_hat", M_hat)
    spread = _signals.real("within", deviation)
    if not (np.all(np.isfinite(spread)) and np.all(spread >= 0.0)):
        raise ValueError(f"within: expected finite bounds of 0 or more, got {deviation!r}")
    if spread.shape not in ((), model.shape):
        raise ValueError(f"within: expected a number or shape {model.shape}, got {spread.shape}")
    if spread.ndim == 0:
        return _small_gain(margins, float(spread) * float(np.linalg.norm(np.linalg.inv(model), 2)))
    model = _inertia.definite("M_hat", model)
    return _set(margins, *_inertia.hull_range(model, model[None], np.maximum(spread, spread.T)))


def of_hull(
    margins: FilterMargins, M_hat: ArrayLike, vertices: ArrayLike, deviation: ArrayLike
) -> InertiaCertificate:
    """Every M of a polytope, off it by as much as a deviation, entry by entry."""
    model = _inertia.definite("M_hat", _inertia.checked_inertia("M_hat", M_hat))
    corners = _inertia.checked_vertices(model, vertices)
    spread = _signals.array("within", deviation, model.shape)
    if np.any(spread < 0.0):
        raise ValueError("within: expected bounds of 0 or more")
    return _set(margins, *_inertia.hull_range(model, corners, np.maximum(spread, spread.T)))


def _set(margins: FilterMargins, low: float, high: float, attained: bool) -> InertiaCertificate:
    """The verdict over a set of M from the range of the eigenvalues."""
    if np.isinf(high):
        message = "a singular M is not excluded: give tighter bounds"
        return _answer(margins, Status.OPEN, "range", low, np.inf, message)
    return _range(margins, low, high, attained=attained)


def _range(margins: FilterMargins, low: float, high: float, *, attained: bool) -> InertiaCertificate:
    whole = any(a < low and high < b for a, b in margins.stable_ratios)
    verb = "lie within" if whole else "are not all within"
    message = f"the eigenvalues of M_hat M^-1, {low:.4g} to {high:.4g}, {verb} one stable interval"
    status = Status.PROVEN
    if not whole:
        lost = attained and not (margins.stable(low) and margins.stable(high))
        status = Status.REFUTED if lost else Status.OPEN
        if not attained:
            message += "; with so many axes this need not mean instability"
    return _answer(margins, status, "range", low, high, message)


def _small_gain(margins: FilterMargins, relative: float) -> InertiaCertificate:
    # min |Q + P|/|Q|: with the command as g the modulus margin.
    limit = margins._over_ratios.disk(1.0).value if margins.is_stable else 0.0
    fine = relative < limit
    sign, name = "<" if fine else ">=", "modulus margin" if margins.g == "commanded" else "1/max |S|,"
    message = f"|M - M_hat| |M_hat^-1| = {relative:.4g} {sign} {name} {limit:.4g}"
    ends = 1.0 / (1.0 + relative), 1.0 / (1.0 - relative) if relative < 1.0 else np.inf
    return _answer(margins, Status.PROVEN if fine else Status.OPEN, "small gain", *ends, message)


def _answer(
    margins: FilterMargins, status: Status, method: str, low: float, high: float, message: str
) -> InertiaCertificate:
    ratios: FloatArray = np.array([low, high])
    known = FORCES, "M constant", *margins.assumptions
    return InertiaCertificate(status, method, ratios, 0.0, (), np.zeros(0), None, None, known, message)


def _short(value: complex) -> str:
    return f"{value.real:.6g}" if abs(value.imag) <= 1e-9 * abs(value) else f"{value:.6g}"
