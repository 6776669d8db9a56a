"""Lines of equal damping and natural frequency in the s-plane and the z-plane."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

__all__ = ["Box", "ComplexArray", "outside", "s_grid", "z_grid"]

ComplexArray = NDArray[np.complex128]
# Left, right, bottom and top of the picture.
Box = tuple[float, float, float, float]

_DAMPING = (0.2, 0.4, 0.6, 0.8)
_GRID = "0.86"
_AXIS = "0.55"
_STEPS = (1, 2, 2.5, 5, 10)


def outside(roots: ComplexArray, box: Box) -> NDArray[np.bool_]:
    """Which of the roots the picture does not show."""
    left, right, bottom, top = box
    return (roots.real < left) | (roots.real > right) | (roots.imag < bottom) | (roots.imag > top)


def s_grid(ax: Axes, box: Box) -> None:
    """Rays of equal damping, circles of equal natural frequency, and the two axes."""
    left, _, _, top = box
    radii = _ticks(1.25 * -left)
    arc: ComplexArray = np.exp(1j * np.linspace(0.5 * np.pi, 1.5 * np.pi, 181))
    for radius in radii:
        _line(ax, np.multiply(radius, arc, dtype=np.complex128))
        if radius < 0.95 * top:
            _name(ax, f"{radius:g}", 1j * radius, (3, 0))
    far = 2.0 * max(radii[-1], -left)
    for damping in _DAMPING:
        way = complex(-damping, np.sqrt(1.0 - damping**2))
        _mirrored(ax, np.array([0.0, far * way]))
        reach = min(0.97 * -left / damping, 0.92 * top / way.imag)
        _name(ax, f"$\\zeta$ {damping:g}", reach * way, (3, 0))
    for line in (ax.axhline, ax.axvline):
        line(0.0, color=_AXIS, linewidth=0.8, zorder=0.5)


def z_grid(ax: Axes, box: Box, dt: float | None) -> None:
    """Unit circle, and where e^{sh} takes the lines of equal damping and equal natural frequency.

    Frequencies are named in rad/s where the filters share their step, else as shares of 1/h.
    """
    left, right, bottom, top = box
    whole = left < -1.0
    _line(ax, np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 721)), colour=_AXIS)
    ax.axhline(0.0, color=_AXIS, linewidth=0.8, zorder=0.5)
    for damping in _DAMPING:
        slope = np.sqrt(1.0 - damping**2)
        z = np.exp(np.linspace(0.0, np.pi / slope, 400) * complex(-damping, slope))
        _mirrored(ax, z)
        # Where the spiral leaves the picture; in the whole circle the spirals lie too close to name all.
        seen = z[~outside(z, (left, right, bottom, 0.92 * top))]
        if not whole or damping in (0.2, 0.6):
            _name(ax, f"$\\zeta$ {damping:g}", complex(z[100] if whole else seen[-1]), (3, 0))
    unit = 1.0 if dt is None else 1.0 / dt
    quarter = np.exp(1j * np.linspace(0.5 * np.pi, np.pi, 200))
    for value in _ticks((np.pi if whole else 1.2 * (1.0 - left)) * unit):
        s = value / unit * quarter
        _mirrored(ax, np.exp(s[np.abs(s.imag) <= np.pi]))  # beyond pi the circle would repeat itself
        spot = complex(np.exp(1j * value / unit))
        # Near z = -1 a name would not fit between circle and frame.
        if value / unit < (2.5 if whole else np.pi) and not outside(np.array([spot]), box)[0]:
            away = (9.0 * spot.real, 7.0 * spot.imag) if whole else (4.0, 2.0)
            text = f"{value:g} rad/s" if dt is not None else f"{value:g}/h"
            _name(ax, text, spot, away, ha="left" if not whole or spot.real > 0.0 else "right")


def _ticks(largest: float) -> list[float]:
    """Round positive numbers up to about the largest."""
    ticks = np.asarray(MaxNLocator(nbins=5, steps=_STEPS).tick_values(0.0, largest), dtype=float)
    return [float(tick) for tick in ticks if tick > 0.0]


def _line(ax: Axes, z: ComplexArray, *, colour: str = _GRID) -> None:
    ax.plot(z.real, z.imag, color=colour, linewidth=0.7 if colour == _GRID else 1.0, zorder=0)


def _mirrored(ax: Axes, z: ComplexArray) -> None:
    _line(ax, z)
    _line(ax, z.conj())


def _name(ax: Axes, text: str, at: complex, away: tuple[float, float], *, ha: str = "left") -> None:
    """A small grey name of a grid line."""
    ax.annotate(
        text,
        (at.real, at.imag),
        xytext=away,
        textcoords="offset points",
        fontsize="xx-small",
        color="0.45",
        ha=ha,
        va="center",
        zorder=1,
        annotation_clip=True,
        clip_on=True,
    )
