"""Disk margins: gain and phase together, in one channel or in all at once."""

from __future__ import annotations

from dataclasses import dataclass

import control as ct
import numpy as np

from ... import _signals
from ...results import Result, in_lines
from .matrix_search import MatrixSearch
from .scalar_search import MarginSearch

__all__ = ["DiskMargin", "disk_margin", "disk_of"]


@dataclass(frozen=True, eq=False, repr=False)
class DiskMargin(Result):
    """Gain and phase that all channels of a loop tolerate at once; made by :func:`disk_margin`.

    Each channel may be multiplied by its own f = (1 + (1 - skew)/2 d)/(1 - (1 + skew)/2 d), d any stable system of
    gain below ``alpha``.

    Parameters
    ----------
    alpha : float
        Size of the disk; 0 if the loop is unstable, nan where it cannot be told.
    skew : float
        0: gain up and down alike; 1: of S, the modulus margin; -1: of T, multiplicative uncertainty.
    frequency : float
        Frequency in rad/s at which it binds.

    References
    ----------
    P. Seiler, A. Packard, P. Gahinet, "An introduction to disk margins", IEEE Control Systems Magazine 40 (2020).
    """

    _figures = ("alpha", "skew", "frequency", "gain_margin", "phase_margin")
    _answer = ("alpha",)

    alpha: float
    skew: float
    frequency: float

    def describe(self) -> str:
        """The margin as text, one line each.

        Returns
        -------
        str

        Examples
        --------
        >>> import control as ct
        >>> print(disk_margin(ct.tf(1, [1, 1, 0])).describe())
        alpha               0.8944 of skew 0, at 1 rad/s (0.159 Hz)
        gain                0.382 to 2.618 times in every channel
        phase               48.19 deg in every channel
        """
        if not self.alpha > 0.0:
            return in_lines({"alpha": "0: unstable" if self.alpha == 0.0 else "cannot be computed"})
        low, high = self.gain_margin
        return in_lines(
            {
                "alpha": f"{self.alpha:.4g} of skew {self.skew:g}, at {_signals.in_both(self.frequency)}",
                "gain": f"{low:.4g} to {high:.4g} times in every channel",
                "phase": f"{np.rad2deg(self.phase_margin):.4g} deg in every channel",
            }
        )

    @property
    def gain_margin(self) -> tuple[float, float]:
        """Real factors (low, high) in the disk: all channels may be scaled within it, each by its own."""
        if np.isnan(self.alpha):
            return self.alpha, self.alpha
        below, above = 0.5 * self.alpha * (1.0 - self.skew), 0.5 * self.alpha * (1.0 + self.skew)
        low = max(0.0, (1.0 - below) / (1.0 + above)) if above > -1.0 else 0.0
        return low, (1.0 + below) / (1.0 - above) if above < 1.0 else float("inf")

    @property
    def phase_margin(self) -> float:
        """Phase in rad that all channels may be turned by, lag or lead, each by its own: inf where any."""
        if np.isnan(self.alpha):
            return self.alpha
        a, s = self.alpha**2, self.skew**2
        # A circle |f| = 1 that lies inside has no point where |d| = alpha.
        below, above = 4.0 - a * (1.0 + s), 4.0 + a * (1.0 - s)
        return float(np.arccos(below / above)) if below > -abs(above) else float("inf")


def disk_margin(L: ct.StateSpace | ct.TransferFunction, *, skew: float = 0.0) -> DiskMargin:
    """Disk margin of a loop gain: what every channel tolerates in gain and phase, all at once.

        alpha = 1/max over omega of mu(S + (skew - 1)/2 I),    S = (I + L)^-1

    Parameters
    ----------
    L : control.StateSpace or control.TransferFunction
        Loop gain with the return difference I + L (negative feedback), as many outputs as inputs; continuous or
        discrete.
    skew : float
        See :class:`DiskMargin`.

    Returns
    -------
    DiskMargin

    Raises
    ------
    TypeError
        If L is of another kind.
    ValueError
        If L is not square, or the skew is not finite.

    Notes
    -----
    ``control.disk_margins`` looks at given frequencies and needs slycot for several channels. Here the peak is searched
    for, and mu is bounded from above by min over diagonal D of the largest singular value of D M D^-1, a convex
    problem: that is mu itself for up to three channels (A. Packard, J. Doyle, "The complex structured singular value",
    Automatica 29 (1993)), and a guarantee for more.

    Examples
    --------
    One channel at a time this loop has margins of 90 degrees and more; both together have 21.

    >>> P = ct.ss([[0, 10], [-10, 0]], [[1, 0], [0, 1]], [[1, 10], [-10, 1]], 0)
    >>> K = ct.ss([], [], [], [[1, -2], [0, 1]])
    >>> both = disk_margin(P * K)
    >>> round(both.alpha, 4), round(float(np.rad2deg(both.phase_margin)), 2)
    (0.3762, 21.3)
    """
    if not isinstance(L, ct.StateSpace | ct.TransferFunction):
        raise TypeError(
            f"L: expected a python-control StateSpace or TransferFunction, got {type(L).__name__}"
        )
    if L.ninputs != L.noutputs:
        raise ValueError(f"L: expected as many outputs as inputs, got {L.noutputs} and {L.ninputs}")
    return disk_of(MatrixSearch.of(ct.StateSpace(ct.ss(L), remove_useless_states=False)), skew)


def disk_of(search: MarginSearch, skew: float) -> DiskMargin:
    """The same of a search for margins."""
    skew = _signals.number("skew", skew)
    alpha, omega = search.disk(skew) if search.is_stable else (0.0, float("nan"))
    return DiskMargin(alpha, skew, omega)
