"""How the margins of a sampled loop move with its filter: exact derivatives at the frequencies where they are taken.

Q = 1 - m F and P = p F + r are affine in F, so with L = mu P/Q and X = Q/P

    d|1 + L| = Re(conj(1 + L) dL)/|1 + L|,      dL = mu (p Q + m P)/Q^2 dF,      dX = -(m P + p Q)/P^2 dF

A peak does not move with its frequency. Where a gain or phase crossing does, |L| = 1 or Im X = 0 gives how far.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from ..._sections import ComplexArray, FloatArray
from .. import _paths
from . import sweep
from ._sampled import SampledLoop

__all__ = ["Margin", "SampledLoop", "Touch", "modulus_at", "touches"]

Margin = Literal["modulus", "delay", "ratio"]

_MOST_DIPS = 8
_STEP = 1e-6  # relative, of differences along the frequency axis


class Touch(NamedTuple):
    """A frequency at which the loop comes near to a limit.

    Parameters
    ----------
    margin : {"modulus", "delay", "ratio"}
        What the value is: |1 + L| at a dip; seconds of delay at a gain crossing; M_hat/M at a phase crossing.
    omega : float
        In rad/s.
    value : float
    slope : complex
        d value = Re(slope dF(omega)), F from the measured residual of a step to f_hat.
    """

    margin: Margin
    omega: float
    value: float
    slope: complex


def touches(loop: SampledLoop, ratio: float, *margins: Margin) -> list[Touch]:
    """Every dip of |1 + L|, gain crossing and phase crossing, of the margins asked for.

    Parameters
    ----------
    loop : SampledLoop
        Of ``LoopMargins.loop``.
    ratio : float
        M_hat / M.
    *margins : {"modulus", "delay", "ratio"}

    Returns
    -------
    list of Touch

    Examples
    --------
    >>> from phyfilter_ctl import PhyFilter, loop_margin
    >>> margin = loop_margin(PhyFilter([5.0]), kp=10.0, kd=6.0, delay=0.02, dt=0.01)
    >>> least = min(touch.value for touch in touches(margin.loop, 1.0, "modulus"))
    >>> abs(least - margin.modulus_margin) < 1e-6
    True
    """
    found: list[Touch] = []
    if "modulus" in margins:
        found += _dips(loop, ratio)
    if "delay" in margins:
        found += _gain_crossings(loop, ratio)
    if "ratio" in margins:
        found += _phase_crossings(loop)
    return found


def _parts(loop: SampledLoop, omega: FloatArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Q, P and what d(P/Q) Q^2 is dF times of."""
    F, error = _paths._recursion(loop.sampled, omega)
    missing, through, outer = loop.surroundings(omega)
    Q, P = error - F * missing, F * through + outer
    return Q, P, through * Q + (1.0 + missing) * P


def _dips(loop: SampledLoop, ratio: float) -> list[Touch]:
    omega = loop.grid
    Q, P = loop(omega)
    with np.errstate(divide="ignore"):
        values = np.abs(Q + ratio * P) / np.abs(Q)
    left, here, right = values[:-2], values[1:-1], values[2:]
    inner = np.flatnonzero((here < left) & (here <= right)) + 1
    inner = inner[np.argsort(values[inner])][:_MOST_DIPS]
    # Parabola through three points; the grid's own ends may be lowest too.
    a, b = omega[inner - 1] - omega[inner], omega[inner + 1] - omega[inner]
    u, v = (values[inner - 1] - values[inner]) / a, (values[inner + 1] - values[inner]) / b
    bend = (v - u) / (b - a)  # f = u' t + bend t^2 through the three, u' = u - bend a
    vertex = omega[inner] - 0.5 * (u - bend * a) / np.where(bend > 0.0, bend, np.inf)
    vertex = np.clip(vertex, omega[inner - 1], omega[inner + 1])
    return modulus_at(loop, ratio, np.append(vertex, omega[-1]))


def modulus_at(loop: SampledLoop, ratio: float, omega: FloatArray) -> list[Touch]:
    """|1 + L| at given frequencies in rad/s."""
    Q, P, moved = _parts(loop, omega)
    z = 1.0 + ratio * P / Q
    values = np.abs(z)
    slopes = np.conj(z) * ratio * moved / Q**2 / values
    return [
        Touch("modulus", float(w), float(v), complex(g))
        for w, v, g in zip(omega, values, slopes, strict=True)
    ]


def _gain_crossings(loop: SampledLoop, ratio: float) -> list[Touch]:
    omega, lag = sweep.lag_to_instability(loop, ratio)
    if not len(omega):
        return []
    Q, P, moved = _parts(loop, omega)
    turned = _log_slope(loop, omega)  # d log L/d omega
    by_F = moved / (Q * P)  # d log L
    along = -(turned.imag / omega - lag / omega**2) / turned.real
    slopes = (-1j / omega + along) * by_F
    return [
        Touch("delay", float(w), float(v), complex(g))
        for w, v, g in zip(omega, lag / omega, slopes, strict=True)
    ]


def _phase_crossings(loop: SampledLoop) -> list[Touch]:
    crossings = [each for each in sweep.ratio_crossings(loop) if each.omega > 0.0]
    if not crossings:
        return []
    omega = np.array([each.omega for each in crossings])
    Q, P, moved = _parts(loop, omega)
    by_F = -moved / P**2
    inside = np.array([each.leaving != 0 for each in crossings])
    along = np.zeros(len(omega))
    if np.any(inside):
        turned = (Q / P)[inside] * -_log_slope(loop, omega[inside])  # d(Q/P)/d omega
        along[inside] = turned.real / turned.imag
    slopes = -by_F * (1.0 + 1j * along)
    return [
        Touch("ratio", each.omega, each.ratio, complex(g)) for each, g in zip(crossings, slopes, strict=True)
    ]


def _log_slope(loop: SampledLoop, omega: FloatArray) -> ComplexArray:
    """d log(P/Q)/d omega."""
    step = _STEP * omega
    Q1, P1 = loop(omega - step)
    Q2, P2 = loop(omega + step)
    return np.asarray(np.log((P2 * Q1) / (P1 * Q2)) / (2.0 * step), dtype=np.complex128)
