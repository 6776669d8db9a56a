"""Disk margins: gain and phase together, in one channel or in all at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ... import _signals
from ...results import Result, in_lines
from .scalar_search import MarginSearch

__all__ = ["DiskMargin", "disk_of"]


@dataclass(frozen=True, eq=False, repr=False)
class DiskMargin(Result):
    """Gain and phase that all channels of a loop tolerate at once; the ``disk`` of all margins.

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
        >>> from phyfilter_ctl import margins
        >>> print(margins(ct.tf(1, [1, 1, 0])).disk.describe())
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


def disk_of(search: MarginSearch, skew: float) -> DiskMargin:
    """The same of a search for margins."""
    skew = _signals.number("skew", skew)
    alpha, omega = search.disk(skew) if search.is_stable else (0.0, float("nan"))
    return DiskMargin(alpha, skew, omega)
