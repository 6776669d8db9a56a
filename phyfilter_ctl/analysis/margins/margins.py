"""Margins of a loop: gain, phase, delay, modulus and disk, and the frequency each binds at, for all loops alike."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ... import _signals
from ..._sections import FloatArray
from ...results import Result
from .disk import DiskMargin, disk_of
from .scalar_search import NONE, MarginSearch, StableGains

__all__ = ["Margins"]

_NOTHING = StableGains(NONE, NONE, (NONE, NONE))


class Margins(Result):
    """Margins of a loop of gain L, with the return difference 1 + L; the base of all results that have margins.

    Frequencies are in rad/s, nan where nothing binds; those of a sampled loop are at most the Nyquist frequency.
    """

    _figures = (
        "is_stable",
        "stable_gains",
        "gain_margin",
        "gain_frequency",
        "phase_margin",
        "phase_frequency",
        "delay_margin",
        "delay_frequency",
        "modulus_margin",
        "modulus_frequency",
        "sensitivity_peak",
        "disk",
    )
    _answer = ("is_stable", "delay_margin", "modulus_margin")

    @cached_property
    def _search(self) -> MarginSearch:
        """What finds the margins; every kind of loop has its own."""
        raise NotImplementedError

    @property
    def is_stable(self) -> bool:
        """Whether the closed loop is stable, from its eigenvalues: modes that the signal does not see count too."""
        return self._search.is_stable

    @property
    def stable_gains(self) -> tuple[tuple[float, float], ...]:
        """Intervals of the factors on L, above 0, with which the loop is stable."""
        return tuple((each.low, each.high) for each in self._search.stable_gains)

    @property
    def gain_margin(self) -> tuple[float, float]:
        """Factors (low, high) on L between which the loop stays stable; (nan, nan) if it is not."""
        return self._around.low, self._around.high

    @property
    def gain_frequency(self) -> tuple[float, float]:
        """Frequencies at which either end of the gain margin binds."""
        return self._around.omega

    @property
    def gain_crossings(self) -> FloatArray:
        """Frequencies at which |L| = 1, ascending; of a matrix, at which an eigenvalue has modulus 1."""
        return self._search.gain_crossings

    @property
    def phase_margin(self) -> float:
        """Least phase in rad, lag or lead at all frequencies, that makes the loop unstable: inf where none does, 0 if
        it is unstable as it is."""
        return self._search.phase.value if self.is_stable else 0.0

    @property
    def phase_frequency(self) -> float:
        """Frequency at which the phase margin binds."""
        return self._search.phase.omega if self.is_stable else NONE

    @property
    def delay_margin(self) -> float:
        """Least extra delay in seconds that makes the loop unstable: inf where none does, 0 if it is unstable as it is.

        Sampled, a delay by a part of a step also changes what the plant does within it; that is taken into account.
        Where only L is known, in discrete time, it is a lag in phase, exact for whole steps.
        """
        return self._search.delay.value if self.is_stable else 0.0

    @property
    def delay_frequency(self) -> float:
        """Frequency at which the delay margin binds."""
        return self._search.delay.omega if self.is_stable else NONE

    @property
    def modulus_margin(self) -> float:
        """Least distance of L from -1, min |1 + L|: the disk margin of skew 1; 0 if the loop is unstable."""
        return self._modulus.alpha

    @property
    def modulus_frequency(self) -> float:
        """Frequency at which L is closest to -1; inf where it is in the limit."""
        return self._modulus.frequency

    @property
    def sensitivity_peak(self) -> float:
        """Maximum of |1/(1 + L)| over frequency; inf if the loop is unstable."""
        return 1.0 / self.modulus_margin if self.modulus_margin else float("inf")

    @cached_property
    def disk(self) -> DiskMargin:
        """Gain and phase that it tolerates together: :meth:`disk_margin` of skew 0."""
        return self.disk_margin()

    def disk_margin(self, *, skew: float = 0.0) -> DiskMargin:
        """Disk margin of the loop, of all opened signals at once where there are several.

        Parameters
        ----------
        skew : float
            See :class:`DiskMargin`.

        Returns
        -------
        DiskMargin
            With ``alpha`` 0 if the loop is unstable.

        Raises
        ------
        ValueError
            If the skew is not finite.
        """
        return disk_of(self._search, skew)

    # -- text and inside ----------------------------------------------------------------------------------------

    def describe(self) -> str:
        """The margins as text, one line each, with the frequency at which each binds.

        Returns
        -------
        str
        """
        return "\n".join(f"{name:<18}{text}" for name, text in self._lines().items())

    def _lines(self) -> dict[str, str]:
        if not self.is_stable:
            return {"stable": "no"}
        low, high = self.gain_margin
        ends = [f"{_signals.in_both(omega)}" for omega in self.gain_frequency if not np.isnan(omega)]
        disk = self.disk
        least, most = disk.gain_margin
        lines = {
            "stable": "yes",
            "gain margin": f"{low:.4g} to {high:.4g} times" + (" at " + " and ".join(ends) if ends else ""),
            "phase margin": f"{np.rad2deg(self.phase_margin):.4g} deg{_at(self.phase_frequency)}",
            "delay margin": f"{1e3 * self.delay_margin:.4g} ms{_at(self.delay_frequency)}",
            "modulus margin": f"{self.modulus_margin:.4g}{_at(self.modulus_frequency)}",
            "disk margin": f"{disk.alpha:.4g}{_at(disk.frequency)}: {least:.4g} to {most:.4g} times with "
            f"{np.rad2deg(disk.phase_margin):.4g} deg",
            "sensitivity": f"peak {self.sensitivity_peak:.4g}",
        }
        if self._search.missing:
            answered = {"delay margin": self.delay_margin, "modulus margin": self.modulus_margin}
            answered |= {"disk margin": disk.alpha, "sensitivity": self.sensitivity_peak}
            lines = {name: text for name, text in lines.items() if not np.isnan(answered.get(name, 0.0))}
            lines["not answered"] = self._search.missing
        return lines

    @cached_property
    def _modulus(self) -> DiskMargin:
        return disk_of(self._search, 1.0)

    @property
    def _around(self) -> StableGains:
        found = (each for each in self._search.stable_gains if each.low < 1.0 < each.high)
        return next(found, _NOTHING) if self.is_stable else _NOTHING


def _at(omega: float) -> str:
    return "" if np.isnan(omega) else f" at {_signals.in_both(omega)}"
