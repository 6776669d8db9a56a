"""Prior margins quick enough to follow a drag: the loop is evaluated once on its grid and read off between."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from .._sections import ComplexArray, FloatArray
from ..analysis import PriorMargin

__all__ = ["phase_and_delay", "read_off"]

# Points of the loop's grid that are closer than this, relative, count as one.
_SAME_POINT = 1e-6


@dataclass(frozen=True, eq=False)
class _ReadOff:
    """A loop whose values between the points of its grid come from cubic splines over log omega.

    The grid has 150 points a decade, more at resonances and where a delay turns fast, so crossings move by some 1e-6
    of themselves; how many poles are unstable is still counted by the loop itself. One evaluation of a sampled loop
    costs a millisecond whatever the number of points, and a search takes forty.
    """

    exact: PriorMargin

    @property
    def nyquist(self) -> float:
        return self.exact.loop.nyquist

    @cached_property
    def tail(self) -> tuple[float, float]:
        return self.exact.loop.tail

    @cached_property
    def grid(self) -> FloatArray:
        points = self.exact.loop.grid
        apart = np.diff(points) > _SAME_POINT * points[:-1]
        return points[np.append(apart, True)]

    @cached_property
    def at_zero(self) -> tuple[float, float]:
        return self.exact.loop.at_zero

    @cached_property
    def at_nyquist(self) -> tuple[float, float] | None:
        if self.grid[-1] != self.nyquist:
            return self.exact.loop.at_nyquist
        Q, P = self._on_grid
        return float(Q[-1].real), float(P[-1].real)

    @property
    def delay(self) -> float:
        return self.exact.loop.delay

    @cached_property
    def _splines(self) -> CubicSpline:
        return CubicSpline(np.log(self.grid), np.stack(self._on_grid, axis=1))

    def __call__(self, omega: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        if omega is self.grid:
            return self._on_grid
        found = np.asarray(self._splines(np.log(omega)), dtype=np.complex128)
        return found[:, 0], found[:, 1]

    @cached_property
    def _on_grid(self) -> tuple[ComplexArray, ComplexArray]:
        return self.exact.loop(self.grid)

    def roots(self, ratio: complex) -> ComplexArray | None:
        return self.exact.loop.roots(ratio)

    def unstable(self, ratio: complex) -> int | None:
        return self.exact.loop.unstable(ratio)


def read_off(margin: PriorMargin) -> PriorMargin:
    """The same margins, from one evaluation of the loop; its ``delay_margin`` is :func:`phase_and_delay`'s.

    Parameters
    ----------
    margin : PriorMargin
        Of a sampled filter.

    Returns
    -------
    PriorMargin
    """
    return PriorMargin(margin.inertia_ratio, _ReadOff(margin), margin.filter)


def phase_and_delay(margin: PriorMargin) -> tuple[float, float]:
    """Phase margin in degrees and delay margin in s from one search; 0 where the loop is unstable.

    Parameters
    ----------
    margin : PriorMargin

    Returns
    -------
    phase, delay : float
        The delay is the phase over the frequency, as of whole steps. What a part of a step changes within the step
        moves it by less than half a step; the search for that takes ten times as long.
    """
    if not margin.is_stable:
        return 0.0, 0.0
    omega = margin.gain_crossings
    Q, P = margin.loop(omega)
    lag = np.angle(-margin.inertia_ratio * P * np.conj(Q)) % (2.0 * np.pi)
    lag[lag == 0.0] = 2.0 * np.pi
    phase = np.min(np.minimum(lag, 2.0 * np.pi - lag), initial=np.inf)
    return float(np.rad2deg(phase)), float(np.min(lag / omega, initial=np.inf))
