"""Units of frequency plots: as python-control's ``freqplot`` settings have them, unless a plot is told otherwise."""

from __future__ import annotations

from dataclasses import dataclass

import control as ct
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike, NDArray

from ._style import SMALL

__all__ = ["Units", "frequency_unit"]

FloatArray = NDArray[np.float64]


def frequency_unit(Hz: bool | None = None) -> tuple[str, float]:
    """What a frequency axis is in, as drawn: its name, and how many rad/s one of it is.

    Parameters
    ----------
    Hz : bool, optional
        None: python-control's setting ``freqplot.Hz``.

    Examples
    --------
    >>> frequency_unit(False), frequency_unit(True)[0]
    (('rad/s', 1.0), 'Hz')
    """
    units = Units.chosen(Hz=Hz)
    return units.frequency_name, units.per_frequency


@dataclass(frozen=True)
class Units:
    """Whether magnitudes are in dB, frequencies in Hz, phases in degrees.

    Parameters
    ----------
    dB, Hz, deg : bool
    """

    dB: bool
    Hz: bool
    deg: bool

    @classmethod
    def chosen(cls, *, dB: bool | None = None, Hz: bool | None = None, deg: bool | None = None) -> Units:
        """Those asked for; where None, python-control's settings ``freqplot.dB``, ``.Hz`` and ``.deg``."""
        asked = {"dB": dB, "Hz": Hz, "deg": deg}
        return cls(
            **{k: bool(ct.config.defaults[f"freqplot.{k}"] if v is None else v) for k, v in asked.items()}
        )

    @property
    def per_frequency(self) -> float:
        """rad/s in one unit of the frequency axis."""
        return 2.0 * np.pi if self.Hz else 1.0

    @property
    def frequency_name(self) -> str:
        """Of the frequency axis."""
        return "Hz" if self.Hz else "rad/s"

    def magnitude(self, values: ArrayLike) -> FloatArray:
        """Magnitudes as they are drawn."""
        with np.errstate(divide="ignore"):
            return 20.0 * np.log10(values) if self.dB else np.asarray(values, dtype=float)

    def height(self, drawn: ArrayLike) -> FloatArray:
        """Places on the paper of magnitudes as they are drawn: straight in dB."""
        return np.asarray(drawn, dtype=float) if self.dB else 20.0 * np.log10(drawn)

    def phase(self, radians: FloatArray) -> FloatArray:
        """Phases as they are drawn."""
        return np.rad2deg(radians) if self.deg else radians

    def dress_frequency(self, axes: Axes) -> None:
        """A logarithmic frequency axis with its name."""
        axes.set_xscale("log")
        axes.set_xlabel(f"Frequency [{self.frequency_name}]", fontsize=SMALL)

    def dress_magnitude(self, axes: Axes, name: str) -> None:
        """A magnitude axis with its name."""
        if not self.dB:
            axes.set_yscale("log")
        axes.set_ylabel(f"{name} [dB]" if self.dB else name, fontsize=SMALL)
