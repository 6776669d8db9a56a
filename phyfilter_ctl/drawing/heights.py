"""Heights of all items: wires by weight, each made level where separations and the wires before it allow."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from .grid import Grid, Item, Joint

__all__ = ["heights_of"]

FloatArray = NDArray[np.float64]
# px between parts, beside lanes, beside terminals, between them, and from a terminal to the sum below or above it.
_GAP, _THIN, _BESIDE, _TERMINALS, _TIED = 22.0, 8.0, 10.0, 2.0, 18.0
_TURN = 14.0  # px between a turn and its sum, beside half a lane: room for the arrow and the sign
_LEVEL = 1e-6


def heights_of(grid: Grid) -> FloatArray:
    """Heights of the items' middles in px, y down, the highest edge at 0.

    Parameters
    ----------
    grid : Grid

    Returns
    -------
    (items,) array
    """
    blocks = _Blocks(len(grid.items))
    for column in grid.columns:
        line = [0.0]
        line_up = [item for unit in column for item in unit]
        for a, b in pairwise(line_up):
            one, other = grid.items[a], grid.items[b]
            line.append(
                line[-1]
                + one.down
                + other.up
                + _separation(one, other, tied=not grid.attached.isdisjoint((a, b)))
            )
        blocks.separate(line_up, np.array(line))
    for exact in (True, False):
        for link in sorted(grid.links, key=lambda link: (-link.weight, link.channel)):
            one, other = link.one, link.other
            if not exact or one.bank != other.bank:
                blocks.level(one, other, exact)
    y = blocks.placed()
    return y - min((y[i] - item.up for i, item in enumerate(grid.items)), default=0.0)


def _separation(one: Item, other: Item, *, tied: bool) -> float:
    kinds = {one.kind, other.kind}
    if "turn" in kinds:
        return _TURN if "part" in kinds else _THIN
    if "lane" in kinds:
        return _THIN
    if tied and one.terminal != other.terminal:  # a terminal above or below its sum
        return _TIED
    if one.terminal or other.terminal:
        return _TERMINALS if one.terminal and other.terminal else _BESIDE
    return _GAP


class _Blocks:
    """Items tied into rigid blocks, and the least distance from each block to each other one."""

    def __init__(self, count: int) -> None:
        self._block = np.arange(count)  # of each item: its block, by row of the matrix
        self._offset = np.zeros(count)
        self._least = np.full((count, count), -np.inf)  # [a, b]: of y_b - y_a
        np.fill_diagonal(self._least, 0.0)
        self._alive = np.ones(count, dtype=bool)

    def separate(self, items: Sequence[int], y: FloatArray) -> None:
        """Distances of items in one column, which are the least ones."""
        at = np.array(items, dtype=int)
        i, j = np.triu_indices(len(at), 1)
        self._least[at[i], at[j]] = y[j] - y[i]

    def level(self, one: Joint, other: Joint, exact: bool) -> None:
        """Tie two items so that a wire between them is level; where it cannot be, as nearly as it can."""
        i, j = one.item, other.item
        a, b = int(self._block[i]), int(self._block[j])
        if a == b:
            return
        wanted = one.dy - other.dy + self._offset[i] - self._offset[j]
        low, high = self._least[a, b], -self._least[b, a]
        if low - _LEVEL <= wanted <= high + _LEVEL:
            self._tie(a, b, wanted)
        elif not exact:
            self._tie(a, b, float(min(max(wanted, low), high)))

    def _tie(self, a: int, b: int, distance: float) -> None:
        # All distances are least ones before: only those that end or begin where b says more than a did can grow.
        least = self._least
        down, up = least[:, b] - distance, least[b] + distance
        rows, columns = np.flatnonzero(down > least[:, a]), np.flatnonzero(up > least[a])
        np.maximum(least[:, a], down, out=least[:, a])
        np.maximum(least[a], up, out=least[a])
        least[a, a] = 0.0
        self._alive[b] = False
        least[b, :] = least[:, b] = -np.inf
        ends, starts = (np.flatnonzero(reached > -np.inf) for reached in (least[a], least[:, a]))
        for i, j in ((rows, ends), (starts, columns)):
            block = i[:, None], j[None]
            least[block] = np.maximum(least[block], least[i, a][:, None] + least[a, j][None])
        mine = self._block == b
        self._offset[mine] += distance
        self._block[mine] = a
        if len(least) > 2 * np.count_nonzero(self._alive) + 8:
            self._shrink()

    def _shrink(self) -> None:
        kept = np.flatnonzero(self._alive)
        new = np.zeros(len(self._alive), dtype=int)
        new[kept] = np.arange(len(kept))
        self._block, self._least = new[self._block], self._least[kept][:, kept]
        self._alive = np.ones(len(kept), dtype=bool)

    def placed(self) -> FloatArray:
        """Heights of the items; blocks that are not tied together as near to the first as they can be."""
        self._shrink()
        y = np.full(len(self._least), np.nan)
        sizes = np.bincount(self._block, minlength=len(y))
        for a in np.argsort(-sizes, kind="stable"):
            done = np.flatnonzero(~np.isnan(y))
            low = max((y[b] + self._least[b, a] for b in done), default=-np.inf)
            high = min((y[b] - self._least[a, b] for b in done), default=np.inf)
            y[a] = min(max(0.0, low), high)
        return y[self._block] + self._offset
