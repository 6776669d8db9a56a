"""Filters out of what other libraries hold: python-control's systems, scipy's (b, a), zeros and poles, sections."""

from __future__ import annotations

from typing import Any

import control as ct
import numpy as np

from .. import _sections, _signals
from .._sections import ComplexArray, FloatArray

_DIGITAL = " (scipy's digital filters do not fit: ask it for analog=True, and sample the filter then)"


def rational(system: Any) -> tuple[FloatArray, ComplexArray | FloatArray, bool]:
    """(b ascending and padded to n, what D is known by, whether that is its poles and not its coefficients a)."""
    if isinstance(system, ct.InputOutputSystem):
        num, den = _of_system(system)
    elif hasattr(system, "to_tf"):  # scipy.signal.lti and dlti
        if system.dt is not None:
            raise ValueError(f"from_tf: the system is discrete, dt = {system.dt}; expected a continuous one")
        if hasattr(system, "A"):  # scipy's own way leaves rounding in front of the numerator
            num, den = _of_system(ct.ss(system.A, system.B, system.C, system.D))
        else:
            whole = system.to_tf()
            num, den = whole.num, whole.den
    elif isinstance(system, tuple) and len(system) == 3:
        return _of_zeros(*system)
    elif isinstance(system, tuple) and len(system) == 2:
        num, den = system
    elif np.ndim(system) == 2 and np.shape(system)[-1] == 6:
        return _of_sections(_signals.real("sos", system))
    else:
        raise TypeError(
            "from_tf: expected a python-control system, scipy's (b, a) or (z, p, k) as a tuple, or sos of shape "
            f"(sections, 6), got {type(system).__name__}"
        )
    num, den = _row("b", num), _row("a", den)
    if den[0] == 0.0:
        raise ValueError(
            f"from_tf: a = {den.tolist()} begins with zero, so its order is not told; leave leading zeros out "
            "(coefficients descend here, the highest power of s first)"
        )
    a = (den / den[0])[:0:-1]
    return _padded(num / den[0], len(a)), a, False


def _of_system(system: ct.InputOutputSystem) -> tuple[Any, Any]:
    if isinstance(system, ct.FrequencyResponseData) or not isinstance(system, ct.LTI):
        raise TypeError(
            f"from_tf: {type(system).__name__} has no transfer function; fit or linearise one first"
        )
    if system.isdtime(strict=True):
        raise ValueError(
            f"from_tf: the system is discrete, dt = {system.dt}; expected a continuous one, which is then sampled: "
            "F.sampled(dt)"
        )
    if not system.issiso():
        raise ValueError(
            f"from_tf: expected one input and one output, got {system.ninputs} and {system.noutputs}; take one "
            "entry, system[0, 0]"
        )
    ((num,),), ((den,),) = ct.tfdata(system)
    return num, den


def _of_zeros(z: Any, p: Any, k: Any) -> tuple[FloatArray, ComplexArray, bool]:
    zeros, poles = (
        np.atleast_1d(_signals.real(name, roots, np.complex128)).astype(np.complex128)
        for name, roots in (("z", z), ("p", p))
    )
    if np.ndim(k):
        raise ValueError(f"from_tf: k: expected one gain, got shape {np.shape(k)}; one filter has one input")
    num = np.atleast_1d(np.poly(zeros)) * float(k)
    scale = np.max(np.abs(num))
    if np.any(np.abs(np.imag(num)) > 1e-9 * scale):
        raise ValueError(f"from_tf: zeros {zeros.tolist()} are no conjugate pairs, so N would not be real")
    return _padded(np.real(num).astype(float), len(poles)), poles, True


def _of_sections(sos: FloatArray) -> tuple[FloatArray, ComplexArray, bool]:
    num, poles = np.ones(1), np.zeros(0, dtype=np.complex128)
    for i, section in enumerate(sos):
        den = np.trim_zeros(section[3:], "f")  # an analog section of first order begins with zeros
        if len(den) == 0:
            raise ValueError(f"from_tf: sos[{i}] has no denominator: {section.tolist()}")
        num = np.convolve(num, section[:3] / den[0])
        poles = np.append(poles, _sections.found_poles((den / den[0])[:0:-1]) if len(den) > 1 else [])
    return _padded(np.real(num).astype(float), len(poles)), poles, True


def _row(name: str, values: Any) -> FloatArray:
    row = _signals.real(name, values)
    row = np.atleast_1d(
        row[0] if row.ndim == 2 and len(row) == 1 else row
    )  # scipy.signal.ss2tf gives one row
    if row.ndim != 1 or len(row) == 0:
        raise ValueError(
            f"from_tf: {name}: expected the coefficients of one transfer function, got shape {row.shape}; one "
            "filter has one input and one output"
        )
    return row


def _padded(descending: FloatArray, order: int) -> FloatArray:
    """Ascending b_0 ... b_(n-1)."""
    if order == 0:
        raise ValueError("from_tf: the system is a constant; expected one with at least one pole")
    num = np.trim_zeros(descending, "f")
    if len(num) > order:
        raise ValueError(
            f"from_tf: numerator of degree {len(num) - 1} over a denominator of degree {order} is not strictly "
            "proper: the filter would pass noise of any frequency; expected a lower degree of the numerator"
            + _DIGITAL
        )
    return np.pad(num[::-1], (0, order - len(num)))
