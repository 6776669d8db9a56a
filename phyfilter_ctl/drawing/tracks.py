"""Upright pieces of wires between two columns: which nets have one, in which order, and which turn twice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .grid import Joint
from .ranking import linear_order

__all__ = ["Channel", "End", "channel_of"]

_TOGETHER = 4.0  # px: nearer than that, two level pieces would lie on each other
_CLEAR = 7.0  # px from a piece that is added to others
_REACH = 60  # px: how far from the middle a free height is looked for
_JOGS, _TRIES = 6, 6
_ON_EACH_OTHER = 1000.0  # cost beside 1 of a crossing


class End(NamedTuple):
    """Of a net in a channel: the height, the bank, and the joint; none where its two halves meet."""

    y: float
    bank: int
    joint: Joint | None


@dataclass(frozen=True, eq=False)
class Channel:
    """Outcome of :func:`channel_of`.

    Parameters
    ----------
    ends : dict
        (net, half) -> its ends; half 1 is the right one of a net that turns twice.
    order : tuple of (net, half)
        Those that have an upright piece, from the left.
    """

    ends: Mapping[tuple[int, int], tuple[End, ...]]
    order: tuple[tuple[int, int], ...]


def channel_of(joints: Sequence[Joint], y: NDArray[np.float64]) -> Channel:
    """Upright pieces in an order with few crossings, none on another.

    Parameters
    ----------
    joints : sequence of Joint
    y : (items,) array
        Heights.

    Returns
    -------
    Channel
    """
    ends: dict[int, list[End]] = {}
    for joint in joints:
        ends.setdefault(joint.net, []).append(End(float(y[joint.item]) + joint.dy, joint.bank, joint))
    jogged: list[int] = []
    while True:
        halves = _halves(ends, jogged)
        order, another = _order(halves, jogged)
        if another is None:
            return Channel({key: tuple(some) for key, some in halves.items()}, tuple(order))
        jogged.append(another)


def _halves(ends: Mapping[int, list[End]], jogged: Sequence[int]) -> dict[tuple[int, int], list[End]]:
    found = {(net, 0): list(some) for net, some in ends.items()}
    taken = [end.y for some in ends.values() for end in some]
    for net in jogged:
        mine = [end.y for end in ends[net]]
        middle = (min(mine) + max(mine)) / 2
        free = min(
            (middle + step for step in range(-_REACH, _REACH + 1)),
            key=lambda z: (min(abs(z - other) for other in taken) < _CLEAR, abs(z - middle)),
        )
        taken.append(free)
        found[net, 0] = [end for end in ends[net] if end.bank < 0] + [End(free, 1, None)]
        found[net, 1] = [End(free, -1, None)] + [end for end in ends[net] if end.bank > 0]
    return found


def _order(
    halves: Mapping[tuple[int, int], list[End]], jogged: Sequence[int]
) -> tuple[list[tuple[int, int]], int | None]:
    """Upright pieces from the left; and a net that is to turn twice, where two would lie on each other."""
    upright = [key for key, some in halves.items() if max(e.y for e in some) - min(e.y for e in some) > 0.5]
    n = len(upright)
    spans = [(min(e.y for e in halves[key]), max(e.y for e in halves[key])) for key in upright]
    cost = np.zeros((n, n))  # [a, b]: of a standing right of b
    for a in range(n):
        for b in range(n):
            if a == b:
                continue
            left = [e.y for e in halves[upright[a]] if e.bank < 0]
            right = [e.y for e in halves[upright[b]] if e.bank > 0]
            cost[a, b] += sum(spans[b][0] - _TOGETHER < z < spans[b][1] + _TOGETHER for z in left)
            cost[a, b] += sum(spans[a][0] - _TOGETHER < z < spans[a][1] + _TOGETHER for z in right)
            cost[a, b] += _ON_EACH_OTHER * sum(abs(u - v) < _TOGETHER for u in left for v in right)
    order = linear_order(cost, _TRIES)
    if len(jogged) < _JOGS:
        for j, a in enumerate(order):
            for b in order[:j]:
                if cost[a, b] >= _ON_EACH_OTHER:
                    for net, _ in (upright[a], upright[b]):
                        if net not in jogged and {e.bank for e in halves[net, 0]} == {-1, 1}:
                            return [], net
    return [upright[i] for i in order], None
