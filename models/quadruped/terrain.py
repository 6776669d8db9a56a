"""Grounds, flat and others. Robots walk along +x from the origin; the first metre is flat.

Heights are given on a grid that MuJoCo reads as a height field; stairs are boxes, for their edges. Difficulty d is in
[0, 1]:

    stairs   risers of 0.01 + 0.05 d m, treads of 0.30 m
    rough    uniform heights of up to 0.02 + 0.12 d m on a grid of 0.20 m, linear between
    wave     sum of two sines along x and y, each of amplitude 0.015 + 0.04 d m and length 1.2 m
    gravel   uniform heights of up to 0.01 + 0.05 d m on a grid of 0.06 m, as stones, and friction falls to 0.8 - 0.3 d
    tall     stairs with risers of 0.06 + 0.11 d m
    slope    up at 20 d degrees, descent: down at as many
    tiles    a curriculum: square tiles, kinds side by side along y, difficulties rising along x to d; robots start in
             the middle of one, and slopes and stairs go up from there on all sides
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import RegularGridInterpolator

__all__ = ["COLUMNS", "HALF_TILE", "KINDS", "LANE", "LEVELS", "RANDOM", "Kind", "Terrain", "tile_centre"]

FloatArray = NDArray[np.float64]
Kind = Literal["flat", "stairs", "rough", "wave", "gravel", "tall", "slope", "descent", "tiles"]
KINDS: tuple[Kind, ...] = get_args(Kind)
# Of random heights: every seed is another ground. The others are one ground each.
RANDOM: tuple[Kind, ...] = ("rough", "gravel")

# Grid of the height fields, m; robots that leave the lane leave the field.
_CELL = 0.06
_BEHIND, _AHEAD, _ASIDE = 2.0, 14.0, 4.0
LANE: float = (round(2.0 * _ASIDE / _CELL) + 1) * _CELL
_FLAT, _BLEND = 1.0, 0.5
_TREAD = 0.3
_STEPS = 36
_WAVE = 1.2
_STEEPEST = 20.0
_ROUGH_GRID = 0.2
# Tiles: kinds along y, levels along x; cells a side, cells of flat ground around all of them.
COLUMNS: tuple[Kind, ...] = ("rough", "wave", "gravel", "slope", "stairs")
LEVELS = 6
_TILE_CELLS, _BORDER_CELLS = 84, 12
HALF_TILE: float = 0.5 * _TILE_CELLS * _CELL


@dataclass(frozen=True)
class Terrain:
    """One ground.

    Parameters
    ----------
    kind : {"flat", "stairs", "rough", "wave", "gravel", "tall", "slope", "descent", "tiles"}
    difficulty : float
        In [0, 1].
    seed : int
        Of the random heights.
    count : int
        So many grounds side by side, of this seed and the following ones, ``LANE`` apart along y.

    Raises
    ------
    ValueError
        For another kind, a difficulty out of range, a negative seed, or several grounds that are no fields.

    Examples
    --------
    >>> Terrain("stairs", 0.5).riser
    0.035
    """

    kind: Kind = "flat"
    difficulty: float = 0.0
    seed: int = 0
    count: int = 1

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"terrain: expected one of {', '.join(KINDS)}, got {self.kind!r}")
        if not 0.0 <= self.difficulty <= 1.0:
            raise ValueError(f"terrain: expected a difficulty in [0, 1], got {self.difficulty}")
        if not isinstance(self.seed, int) or self.seed < 0:
            raise ValueError(f"terrain: expected a seed of 0 or more, got {self.seed!r}")
        if self.count != 1 and (self.count < 1 or self.kind not in ("rough", "wave", "gravel")):
            raise ValueError(
                f"terrain: expected rough, wave or gravel side by side, got {self.count} of {self.kind}"
            )

    @property
    def riser(self) -> float:
        """Of one stair, m."""
        d = self.difficulty
        return {"stairs": 0.01 + 0.05 * d, "tall": 0.06 + 0.11 * d}.get(self.kind, 0.0)

    @property
    def friction(self) -> float:
        """Factor on the friction of the feet."""
        return 1.0 - 0.375 * self.difficulty if self.kind == "gravel" else 1.0

    @cached_property
    def grid(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """x (columns) and y (rows) of the grid, and heights (rows, columns), m."""
        if self.kind == "tiles":
            return _tiles(self.difficulty, self.seed)
        if self.count > 1:
            seeds = range(self.seed, self.seed + self.count)
            fields = [replace(self, seed=seed, count=1).grid for seed in seeds]
            x, y, _ = fields[0]
            beside = np.concatenate([y + LANE * k for k in range(self.count)])
            return x, beside, np.concatenate([z for _, _, z in fields])
        x = np.arange(-_BEHIND, _AHEAD + 0.5 * _CELL, _CELL)
        y = np.arange(-_ASIDE, _ASIDE + 0.5 * _CELL, _CELL)
        d, rng = self.difficulty, np.random.default_rng([self.seed, KINDS.index(self.kind)])
        if self.kind == "rough":
            z = _between(rng.uniform(0.0, 0.02 + 0.12 * d, (60, 100)), x, y)
        elif self.kind == "wave":
            k = 2.0 * np.pi / _WAVE
            # Whole micrometres: the last digit of a sine depends on the processor.
            z = np.round((0.015 + 0.04 * d) * (np.sin(k * x) + np.sin(k * y + 1.0)[:, None]), 6)
        elif self.kind == "gravel":
            z = rng.uniform(0.0, 0.01 + 0.05 * d, (len(y), len(x)))
        elif self.kind in ("slope", "descent"):
            rise = round(float(np.tan(np.radians(_STEEPEST * d))), 6) * np.maximum(x - _FLAT, 0.0)
            return x, y, np.tile(rise if self.kind == "slope" else -rise, (len(y), 1))
        else:
            z = np.zeros((len(y), len(x)))
        fade = np.clip((x - _FLAT) / _BLEND, 0.0, 1.0)
        return x, y, z * fade

    def height(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Of the ground under points.

        Parameters
        ----------
        x, y : (...) array
            In m; beyond the field the value at its edge.

        Returns
        -------
        (...) array
            In m.
        """
        px, py = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
        if self.kind == "flat":
            return np.zeros(px.shape)
        if self.riser:
            return self.riser * np.clip(np.floor((px - _FLAT) / _TREAD) + 1.0, 0.0, _STEPS)
        gx, gy, _ = self.grid
        points = np.stack([np.clip(py, gy[0], gy[-1]), np.clip(px, gx[0], gx[-1])], axis=-1)
        return np.asarray(self._between(points)).reshape(px.shape)

    @cached_property
    def _between(self) -> RegularGridInterpolator:
        x, y, z = self.grid
        return RegularGridInterpolator((y, x), z)

    def xml(self) -> tuple[str, str]:
        """MJCF of assets and of the geoms of the ground."""
        common = 'contype="1" conaffinity="0" material="ground" rgba="1 1 1 1"'
        if self.kind == "flat":
            return "", f'<geom name="ground" type="plane" size="0 0 1" {common}/>\n'
        if self.riser:
            return "", self._stairs(common)
        x, y, z = self.grid
        low, span = float(z.min()), max(float(np.ptp(z)), 1e-6)
        # MuJoCo reads the rows of an XML file from the largest y downwards, as in a picture.
        heights = " ".join(f"{value:.5f}" for value in ((z[::-1] - low) / span).ravel())
        half_x, half_y = 0.5 * (x[-1] - x[0]), 0.5 * (y[-1] - y[0])
        asset = (
            f'<hfield name="ground" nrow="{len(y)}" ncol="{len(x)}" size="{half_x} {half_y} {span} 0.1" '
            f'elevation="{heights}"/>\n'
        )
        middle_x, middle_y = 0.5 * (x[-1] + x[0]), 0.5 * (y[-1] + y[0])
        geom = f'<geom name="ground" type="hfield" hfield="ground" pos="{middle_x} {middle_y} {low}" {common}/>\n'
        return asset, geom

    def _stairs(self, common: str) -> str:
        # Every box reaches down to the plane; the last one is a landing.
        geoms = [f'<geom name="ground" type="plane" size="0 0 1" {common}/>\n']
        for k in range(_STEPS):
            start = _FLAT + k * _TREAD
            half = 0.5 * (_TREAD if k < _STEPS - 1 else 10.0)
            top = 0.5 * self.riser * (k + 1)
            geoms.append(
                f'<geom type="box" size="{half} {_ASIDE} {top}" pos="{start + half} 0 {top}" {common}/>\n'
            )
        return "".join(geoms)


def tile_centre(level: ArrayLike, column: ArrayLike) -> FloatArray:
    """x and y of the middle of tiles, (..., 2) m.

    Parameters
    ----------
    level : (...) int array
        From 0, the easiest.
    column : (...) int array
        Of ``COLUMNS``.

    Examples
    --------
    >>> tile_centre(1, 0).round(2).tolist()
    [7.56, 2.52]
    """
    place = np.stack(np.broadcast_arrays(level, column), axis=-1).astype(float)
    return 2.0 * HALF_TILE * (place + 0.5)


def _tiles(hardest: float, seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    size, border = _TILE_CELLS, _BORDER_CELLS
    x, y = (_CELL * np.arange(-border, size * n + border + 1.0) for n in (LEVELS, len(COLUMNS)))
    z = np.zeros((len(y), len(x)))
    for level in range(LEVELS):
        for column, kind in enumerate(COLUMNS):
            rows, columns = (slice(border + size * k, border + size * (k + 1) + 1) for k in (column, level))
            z[rows, columns] = _tile(kind, hardest * (level + 1) / LEVELS, [seed, level, column])
    return x, y, z


def _tile(kind: Kind, d: float, seed: list[int]) -> FloatArray:
    """Heights of a tile, 0 at its edge."""
    along = _CELL * np.arange(_TILE_CELLS + 1) - HALF_TILE
    out = np.maximum(np.abs(along), np.abs(along)[:, None])
    left = HALF_TILE - np.maximum(out, 0.5 * _FLAT)
    if kind == "slope":
        return -round(float(np.tan(np.radians(_STEEPEST * d))), 6) * left
    if kind == "stairs":
        return -(0.01 + 0.05 * d) * np.ceil(np.round(left / _TREAD, 6))
    fade = np.clip((out - 0.5 * _FLAT) / _BLEND, 0.0, 1.0) * np.clip((HALF_TILE - out) / _BLEND, 0.0, 1.0)
    # Any patch of the ground that is walked on in tests, of another seed.
    _, _, z = Terrain(kind, d, 1000 + seed[0]).grid
    row = 10 * seed[2] % (z.shape[0] - len(along))
    column = 60 + 7 * seed[1]
    return z[row : row + len(along), column : column + len(along)] * fade


def _between(coarse: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """Heights on a coarse grid, linear between its points."""
    gy = -_ASIDE - 1.0 + _ROUGH_GRID * np.arange(coarse.shape[0])
    gx = -_BEHIND - 1.0 + _ROUGH_GRID * np.arange(coarse.shape[1])
    Y, X = np.meshgrid(y, x, indexing="ij")
    return RegularGridInterpolator((gy, gx), coarse)(np.stack([Y, X], axis=-1))
