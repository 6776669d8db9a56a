"""How the margins of a sampled loop move with its filter: exact derivatives at the frequencies where they are taken.

Q = 1 - m F and P = p F + r are affine in F, so with L = mu P/Q and X = Q/P

    d|1 + L| = Re(conj(1 + L) dL)/|1 + L|,      dL = mu (p Q + m P)/Q^2 dF,      dX = -(m P + p Q)/P^2 dF

A peak does not move with its frequency. Where a gain or phase crossing does, |L| = 1 or Im X = 0 gives how far.

A search tries many filters in one loop: what is around them, m, p and r, is found once on one grid.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple, Protocol

import numpy as np
from scipy.interpolate import CubicSpline

from ..._sections import ComplexArray, FloatArray
from ...filter import SampledPhyFilter
from . import sweep
from .sampled import SampledLoop

__all__ = [
    "Around",
    "LoopOnGrid",
    "Margin",
    "SampledLoop",
    "Surroundings",
    "Touch",
    "approached",
    "gain_at",
    "modulus_at",
    "touches",
]

Margin = Literal["modulus", "delay", "ratio", "gain"]

_MOST_DIPS = 8
# Points of a grid that serves every filter, a decade, and how far below the slowest filter it begins.
_PER_DECADE, _BELOW = 80, 0.05
_TURN = 0.05  # rad, of delay and hold from one point to the next
# |1 + L| this far above its limit may come to bind in a step; looked at this far apart, in logarithms.
_NEAR_LIMIT, _APART = 0.5, 0.12
# Pairs damped less than this are looked at around their own frequency, and where.
_SHARP, _ABOUT = 0.1, np.linspace(-4.0, 4.0, 17)
_FINE = 3e-3  # relative, between the points that a dip is refined by
_STEP = 1e-6  # relative, of differences along the frequency axis


class Touch(NamedTuple):
    """A frequency at which the loop comes near to a limit.

    Parameters
    ----------
    margin : {"modulus", "delay", "ratio", "gain"}
        What the value is: |1 + L| at a dip; seconds of delay at a gain crossing; M_hat/M at a phase crossing; |L|.
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


class Surroundings(Protocol):
    """What a filter stands in: Q = 1 - m F, P = p F + r."""

    @property
    def dt(self) -> float:
        """Seconds from sample to sample."""
        ...

    @property
    def corners(self) -> ComplexArray:
        """Poles and zeros about which the grid has to be dense, in rad/s."""
        ...

    @property
    def late(self) -> float:
        """Seconds of delay."""
        ...

    def surroundings(self, omega: FloatArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """m - 1, p and r at frequencies in rad/s, each (K,)."""
        ...

    def is_stable(self, filter: SampledPhyFilter) -> bool:
        """Whether the loop is, with this filter."""
        ...


@dataclass(frozen=True, eq=False)
class Around:
    """Surroundings known on a grid for every filter that is tried, and between its points by splines.

    Parameters
    ----------
    loop : Surroundings
    slowest : float
        Least rate of the filters in rad/s.
    """

    loop: Surroundings
    slowest: float

    @cached_property
    def grid(self) -> FloatArray:
        """(K,) rad/s."""
        end = np.pi / self.loop.dt
        low = min(_BELOW * self.slowest, 0.1 * end)
        count = int(_PER_DECADE * np.log10(end / low)) + 2
        sharp = self.loop.corners[(self.loop.corners.imag > 0.0) & (self.loop.corners.imag < end)]
        about = sharp.imag[:, None] + np.abs(sharp.real)[:, None] * _ABOUT
        turns = np.arange(0.0, end, _TURN / (self.loop.late + self.loop.dt))
        points = np.unique(np.concatenate([np.geomspace(low, end, count), about.ravel(), turns]))
        return points[(points >= low) & (points <= end)]

    @cached_property
    def values(self) -> ComplexArray:
        """m - 1, p and r, (3, K)."""
        return np.array(self.loop.surroundings(self.grid))

    def at(self, omega: FloatArray) -> ComplexArray:
        """The same elsewhere on the grid's range."""
        return self.values if omega is self.grid else np.asarray(self._spline(np.log(omega)))

    @cached_property
    def _spline(self) -> CubicSpline:
        return CubicSpline(np.log(self.grid), self.values, axis=1)


@dataclass(frozen=True, eq=False)
class LoopOnGrid(sweep.Remembered):
    """A filter in known surroundings; what :func:`touches` takes.

    Parameters
    ----------
    around : Around
    filter : SampledPhyFilter
    """

    around: Around
    filter: SampledPhyFilter

    @cached_property
    def grid(self) -> FloatArray:
        """Of the surroundings."""
        return self.around.grid

    @property
    def nyquist(self) -> float:
        """Highest frequency in rad/s."""
        return np.pi / self.filter.dt

    @cached_property
    def at_zero(self) -> tuple[float, float]:
        """Nothing is asked of it there."""
        return 1.0, 0.0

    @cached_property
    def at_nyquist(self) -> tuple[float, float] | None:
        """Q and P at z = -1, both real."""
        Q, P, _ = self.parts(self.grid[-1:])
        return float(Q[0].real), float(P[0].real)

    @cached_property
    def _transition(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        return self.filter.transition

    @property
    def sharp(self) -> FloatArray:
        """Frequencies about weakly damped poles of the filter."""
        poles = self.filter.filter.poles
        poles = poles[(poles.imag > 0.0) & (-poles.real < _SHARP * np.abs(poles))]
        omega = (poles.imag[:, None] - poles.real[:, None] * _ABOUT).ravel()
        return omega[(omega > self.grid[0]) & (omega < self.grid[-1])]

    def _evaluate(self, omega: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        Q, P, _ = self.parts(omega)
        return Q, P

    def parts(self, omega: FloatArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """As of :class:`SampledLoop`."""
        dA, equilibrium, C = self._transition
        delta = np.expm1(1j * omega * self.filter.dt)
        drive = np.broadcast_to(-dA @ equilibrium, (len(omega), len(dA)))[..., None].astype(np.complex128)
        F = (1.0 + delta) * (np.linalg.solve(delta[:, None, None] * np.eye(len(dA)) - dA, drive)[..., 0] @ C)
        missing, through, outer = self.around.at(omega)
        Q, P = 1.0 - F * (1.0 + missing), F * through + outer
        return Q, P, through * Q + (1.0 + missing) * P


def touches(loop: SampledLoop | LoopOnGrid, ratio: float, *margins: Margin) -> list[Touch]:
    """Every dip of |1 + L|, gain crossing and phase crossing, of the margins asked for.

    Parameters
    ----------
    loop : SampledLoop or LoopOnGrid
        Of ``Margins.loop``.
    ratio : float
        M_hat / M.
    *margins : {"modulus", "delay", "ratio"}

    Returns
    -------
    list of Touch

    Examples
    --------
    >>> from phyfilter_ctl import Loop, PhyFilter, margins
    >>> margin = margins(PhyFilter([5.0]), Loop(10.0, 6.0, delay=0.02), dt=0.01)
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


def _dips(loop: SampledLoop | LoopOnGrid, ratio: float) -> list[Touch]:
    omega = loop.grid
    Q, P = loop(omega)
    with np.errstate(divide="ignore"):
        values = np.abs(Q + ratio * P) / np.abs(Q)
    left, here, right = values[:-2], values[1:-1], values[2:]
    inner = np.flatnonzero((here < left) & (here <= right)) + 1
    inner = inner[np.argsort(values[inner])][:_MOST_DIPS]
    dips = _vertices(omega[[inner - 1, inner, inner + 1]], values[[inner - 1, inner, inner + 1]])
    around = dips * np.array([[1.0 - _FINE], [1.0], [1.0 + _FINE]])
    around = np.minimum(around, omega[-1] * np.array([[1.0 - _FINE], [1.0 - 0.5 * _FINE], [1.0]]))
    Q, P = loop(around.ravel())
    dips = _vertices(around, (np.abs(Q + ratio * P) / np.abs(Q)).reshape(3, -1))
    return modulus_at(loop, ratio, np.append(dips, omega[-1]))  # the grid's end may be lowest too


def _vertices(omega: FloatArray, values: FloatArray) -> FloatArray:
    """Of the parabolas through three points (3, k) each, between the outer ones."""
    a, b = omega[0] - omega[1], omega[2] - omega[1]
    u, v = (values[0] - values[1]) / a, (values[2] - values[1]) / b
    bend = (v - u) / (b - a)
    vertex = omega[1] - 0.5 * (u - bend * a) / np.where(bend > 0.0, bend, np.inf)
    return np.clip(vertex, omega[0], omega[2])


def approached(loop: LoopOnGrid, ratio: float, limit: float) -> FloatArray:
    """Frequencies at which a step of the filter may take |1 + L| below a limit: where it is little above it."""
    Q, P = loop(loop.grid)
    low = loop.grid[np.abs(Q + ratio * P) < (limit + _NEAR_LIMIT) * np.abs(Q)]
    kept = np.unique(np.round(np.log(low) / _APART), return_index=True)[1]
    return np.append(low[kept], loop.sharp)


def modulus_at(loop: SampledLoop | LoopOnGrid, ratio: float, omega: FloatArray) -> list[Touch]:
    """|1 + L| at given frequencies in rad/s."""
    Q, P, moved = loop.parts(omega)
    z = 1.0 + ratio * P / Q
    values = np.abs(z)
    slopes = np.conj(z) * ratio * moved / Q**2 / values
    return [
        Touch("modulus", float(w), float(v), complex(g))
        for w, v, g in zip(omega, values, slopes, strict=True)
    ]


def gain_at(loop: SampledLoop | LoopOnGrid, ratio: float, omega: FloatArray) -> list[Touch]:
    """|L| at given frequencies in rad/s: what is below 1 there has no delay margin to lose."""
    Q, P, moved = loop.parts(omega)
    L = ratio * P / Q
    slopes = np.conj(L) * ratio * moved / Q**2 / np.abs(L)
    return [
        Touch("gain", float(w), float(v), complex(g))
        for w, v, g in zip(omega, np.abs(L), slopes, strict=True)
    ]


def _gain_crossings(loop: SampledLoop | LoopOnGrid, ratio: float) -> list[Touch]:
    omega, lag = sweep.lag_to_instability(loop, ratio)
    if not len(omega):
        return []
    Q, P, moved = loop.parts(omega)
    turned = _log_slope(loop, omega)  # d log L/d omega
    by_F = moved / (Q * P)  # d log L
    along = -(turned.imag / omega - lag / omega**2) / turned.real
    slopes = (-1j / omega + along) * by_F
    return [
        Touch("delay", float(w), float(v), complex(g))
        for w, v, g in zip(omega, lag / omega, slopes, strict=True)
    ]


def _phase_crossings(loop: SampledLoop | LoopOnGrid) -> list[Touch]:
    crossings = [each for each in sweep.ratio_crossings(loop) if each.omega > 0.0]
    if not crossings:
        return []
    omega = np.array([each.omega for each in crossings])
    Q, P, moved = loop.parts(omega)
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


def _log_slope(loop: SampledLoop | LoopOnGrid, omega: FloatArray) -> ComplexArray:
    """d log(P/Q)/d omega."""
    step = _STEP * omega
    Q1, P1 = loop(omega - step)
    Q2, P2 = loop(omega + step)
    return np.asarray(np.log((P2 * Q1) / (P1 * Q2)) / (2.0 * step), dtype=np.complex128)
