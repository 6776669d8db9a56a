"""Frequencies to evaluate a filter at, and the checks on given ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from ..filter import PhyFilter, SampledPhyFilter

__all__ = ["breaks", "checked", "decades", "default", "nyquist", "ordered", "search"]

Filter = PhyFilter | SampledPhyFilter

_POINTS_PER_DECADE = 200
_MOST_POINTS = 20_000  # with poles a hundred decades apart, still as many to a decade as a real pole needs
# A zero slower than every pole by more than this, or faster, is left out: |F| has fallen so far there that neither the
# band (to 1e-6 of the peak at most) nor a peak can lie beyond it.
_REACH = 1e12


def nyquist(system: Filter) -> float:
    """Nyquist frequency in rad/s, infinite for a continuous filter."""
    return np.pi / system.dt if isinstance(system, SampledPhyFilter) else float("inf")


def ordered(omega: ArrayLike) -> FloatArray:
    """Given frequencies, sorted."""
    grid = np.sort(np.atleast_1d(_signals.real("omega", omega)))
    if grid.ndim != 1 or len(grid) == 0 or not np.all(np.isfinite(grid)):
        raise ValueError(f"omega: expected finite frequencies in rad/s in one dimension, got {omega!r}")
    return grid


def checked(omega: FloatArray, nyquist: float) -> FloatArray:
    """Frequencies at which a filter with this Nyquist frequency has a response."""
    if len(omega) == 0:
        raise ValueError(
            f"omega: no frequency is below the Nyquist frequency {nyquist:.6g} rad/s of the filter"
        )
    if not np.all(np.isfinite(omega)) or omega.min() < 0.0:
        raise ValueError(f"omega: expected finite frequencies of 0 rad/s or more, got {omega.min():g}")
    if omega.max() > nyquist * (1.0 + 1e-12):
        raise ValueError(
            f"omega: {omega.max():.6g} rad/s is above the Nyquist frequency {nyquist:.6g} rad/s; stay at or below it"
        )
    return omega


def default(systems: Sequence[Filter]) -> FloatArray:
    """One grid for all systems."""
    filters = [each if isinstance(each, PhyFilter) else each.filter for each in systems]
    return decades(np.abs(np.concatenate([each.poles for each in filters])), max(map(nyquist, systems)))


def decades(sizes: FloatArray, nyquist: float) -> FloatArray:
    """Two decades to either side of the poles, at least two below the Nyquist frequency."""
    sizes = sizes[sizes > 0.0]
    low, high = (sizes.min(), sizes.max()) if len(sizes) else (1.0, 1.0)
    low = min(1e-2 * low, 1e-2 * nyquist)
    high = min(1e2 * high, nyquist)
    count = int(np.ceil(_POINTS_PER_DECADE * (np.log10(high) - np.log10(low)))) + 1
    return np.geomspace(low, high, min(count, _MOST_POINTS))


def breaks(filter: PhyFilter) -> FloatArray:
    """Frequencies in rad/s at which |F| bends: the sizes of its poles, and of the zeros within reach of them."""
    poles, zeros = np.abs(filter.poles), np.abs(filter.zeros)
    near = (zeros >= poles.min() / _REACH) & (zeros <= poles.max() * _REACH)
    return np.concatenate([poles, zeros[near]])


def search(system: Filter) -> FloatArray:
    """0 and frequencies dense enough that every maximum and crossing has its own interval."""
    filter = system if isinstance(system, PhyFilter) else system.filter
    limit = nyquist(system)
    grid = decades(breaks(filter), limit)
    # A lightly damped pair rises over its |Re p|, far narrower than the grid.
    pairs = filter.poles[filter.poles.imag > 0.0]
    around = (pairs.imag[:, None] - pairs.real[:, None] * np.linspace(-8.0, 8.0, 65)).ravel()
    grid = np.concatenate([grid, around[(around > 0.0) & (around < limit)]])
    return np.unique(np.concatenate([[0.0], grid, [limit] if np.isfinite(limit) else []]))
