"""Which wires lead back, what stands in the feedback path, and in which column each part stands."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .reading import Edge, Scheme

__all__ = ["Ranks", "linear_order", "ranks_of"]

_TRIES = 400  # starts of the search for an order, times the number of parts
_TOWARDS = 0.1  # cost of calling a wire feedback that leads back towards the reference; 1 for others
_TINY = 0.09  # of all preferences among orders with the same feedback


@dataclass(frozen=True, eq=False)
class Ranks:
    """Outcome of :func:`ranks_of`.

    Parameters
    ----------
    columns : tuple of int
        Of each part, from the left.
    mirrored : frozenset of int
        Parts in the feedback path: their signals go left.
    back : frozenset of Edge
        Wires that lead back.
    main : frozenset of int
        Parts on the way to the main output.
    above : frozenset of (part, output)
        Wires that lead back above the forward path.
    """

    columns: tuple[int, ...]
    mirrored: frozenset[int]
    back: frozenset[Edge]
    main: frozenset[int]
    above: frozenset[tuple[int, int]] = frozenset()


def linear_order(cost: NDArray[np.float64], tries: int) -> list[int]:
    """An order in which the sum of cost[i, j] over all i that stand behind j is small; always the same."""
    n = len(cost)
    best, least = list(range(n)), np.inf
    for start in range(0, n, max(1, n // max(tries, 1))):
        order = [(i + start) % n for i in range(n)]
        moved = True
        while moved:
            moved = False
            for v in range(n):
                place = order.index(v)
                others = np.array(order[:place] + order[place + 1 :], dtype=int)
                ahead, behind = cost[v, others], cost[others, v]
                price = np.concatenate([[0.0], np.cumsum(ahead - behind)]) + behind.sum()
                cheapest = int(np.argmin(price))
                if price[cheapest] < price[place] - 1e-9:
                    order.remove(v)
                    order.insert(cheapest, v)
                    moved = True
        total = float(np.tril(cost[np.ix_(order, order)], -1).sum())
        if total < least - 1e-9:
            best, least = order, total
    return best


def ranks_of(
    scheme: Scheme, *, near: bool, taps: bool, below: Collection[str], ahead: Collection[str]
) -> Ranks:
    """Columns of the parts.

    Parameters
    ----------
    scheme : Scheme
    near : bool
        Whether inputs may stand beside what they drive, not only at the left border.
    taps : bool
        Whether outputs stand beside what they show.
    below, ahead : collection of str
        Blocks that stand in the feedback path, or do not, whatever is found.

    Returns
    -------
    Ranks
    """
    parts, edges = scheme.parts, scheme.edges
    inner = [k for k, part in enumerate(parts) if part.kind not in ("input", "output")]
    ends = [e.source for o in range(len(parts)) if parts[o].kind == "output" for e in edges if e.target == o]
    ends = [v for v in dict.fromkeys(ends) if v in set(inner)]
    rank = _ranks(scheme, inner, ends)
    back = frozenset(
        e for e in edges if e.source in rank and e.target in rank and rank[e.source] >= rank[e.target]
    )
    onward = [e for e in edges if e not in back]
    reach = {v: min([rank[e.target] for e in back if e.source == v], default=len(rank)) for v in ends}
    last = min(ends, key=lambda v: (reach[v], ends.index(v)), default=None)
    main = _reached([last], onward, backwards=True) if last is not None else set()
    mirrored = _mirrored(scheme, rank, back, onward, last, main, ends, below, ahead)
    columns = _columns(scheme, rank, back, onward, mirrored, near=near, taps=taps)
    if taps:
        mirrored |= {e.target for e in edges if parts[e.target].kind == "output" and e.source in mirrored}
    return Ranks(columns, frozenset(mirrored), back, frozenset(main))


def _ranks(scheme: Scheme, inner: Sequence[int], ends: Sequence[int]) -> dict[int, int]:
    """Place of each part in an order with little feedback."""
    parts, edges = scheme.parts, scheme.edges
    at = {v: i for i, v in enumerate(inner)}
    n = len(inner)
    cost, tiny = np.zeros((n, n)), _TINY / max(n, 1)
    level = _levels(scheme, inner, ends)
    for e in edges:
        if e.source in at and e.target in at and e.source != e.target:
            towards = e.source in level and level.get(e.target, 0) <= level[e.source]
            cost[at[e.source], at[e.target]] = _TOWARDS if towards else 1.0
    cost += np.triu(np.full((n, n), 1e-4 * tiny), 1)
    firsts = dict.fromkeys(e.target for e in edges if parts[e.source].kind == "input" and e.target in at)
    for k, v in enumerate(firsts):
        cost[at[v], :] += tiny * (0.01 if k else 0.9 if v not in ends[:1] else 0.0)
    for k, v in enumerate(ends):
        cost[:, at[v]] += tiny * (0.01 if k else 1.0)
    np.fill_diagonal(cost, 0.0)
    return {inner[i]: place for place, i in enumerate(linear_order(cost, max(3, _TRIES // max(n, 1))))}


def _levels(scheme: Scheme, inner: Sequence[int], ends: Sequence[int]) -> dict[int, int]:
    """Steps from the references: the first input that does not enter at the first output's block, and all r - y."""
    parts, edges = scheme.parts, scheme.edges
    errors = [
        e.source
        for e in edges
        if parts[e.source].kind == "input" and [p.sign for p in parts[e.target].inputs] in ([1, -1], [-1, 1])
        and parts[e.target].inputs[e.input].sign > 0
    ]  # fmt: skip
    driven = {e.target for e in edges}
    starts = [k for k, part in enumerate(parts) if part.kind == "input"] + [
        v for v in inner if v not in driven
    ]
    for first in starts:
        level = dict.fromkeys([first, *errors], 0)
        todo = list(level)
        for v in todo:
            for e in edges:
                if e.source == v and e.target not in level:
                    level[e.target] = level[v] + 1
                    todo.append(e.target)
        if ends and level.get(ends[0], 0) > (parts[first].kind == "input"):
            return level
    return {}


def _reached(starts: Collection[int], edges: Collection[Edge], *, backwards: bool = False) -> set[int]:
    seen, todo = set(starts), list(starts)
    step: Callable[[Edge], tuple[int, int]] = (
        (lambda e: (e.target, e.source)) if backwards else (lambda e: (e.source, e.target))
    )
    following: dict[int, list[int]] = {}
    for e in edges:
        following.setdefault(step(e)[0], []).append(step(e)[1])
    for v in todo:
        for u in following.get(v, ()):
            if u not in seen:
                seen.add(u)
                todo.append(u)
    return seen


def _mirrored(
    scheme: Scheme, rank: dict[int, int], back: Collection[Edge], onward: Sequence[Edge], last: int | None,
    main: Collection[int], ends: Collection[int], below: Collection[str], ahead: Collection[str],
) -> set[int]:  # fmt: skip
    """Parts that turn back, lie on no way to the main output, and are seen only behind it."""
    behind = _reached([last], onward) if last is not None else set()
    shown = _reached(ends, onward, backwards=True)
    found: set[int] = set()
    for v in sorted(rank, key=rank.__getitem__, reverse=True):
        follow = [e.target for e in onward if e.source == v and e.target in rank]
        turns = any(e.source == v != e.target for e in back) or any(t in found for t in follow)
        if turns and v not in main and all(t in found for t in follow) and (v not in shown or v in behind):
            found.add(v)
        name = scheme.parts[v].name
        if name and name in below:
            found.add(v)
        elif name and name in ahead:
            found.discard(v)
    return found


def _columns(
    scheme: Scheme, rank: dict[int, int], back: Collection[Edge], onward: Sequence[Edge], mirrored: Collection[int],
    *, near: bool, taps: bool,
) -> tuple[int, ...]:  # fmt: skip
    parts, edges = scheme.parts, scheme.edges
    column = dict.fromkeys(range(len(parts)), 0)
    into: dict[int, list[Edge]] = {v: [] for v in column}
    out: dict[int, list[Edge]] = {v: [] for v in column}
    for e in edges:
        into[e.target].append(e)
        out[e.source].append(e)
    order = sorted(rank, key=rank.__getitem__)
    for v in order:
        if v not in mirrored:
            ahead = [
                e.source for e in into[v] if e not in back and e.source not in mirrored and e.source in rank
            ]
            column[v] = 1 + max((column[u] for u in ahead), default=0)
    for v in reversed(order):  # what nothing in the diagram drives stands by its first reader
        follow = [
            column[e.target]
            for e in out[v]
            if e not in back and e.target not in mirrored and e.target in rank
        ]
        if v not in mirrored and follow and not any(e.source in rank for e in into[v]):
            column[v] = min(follow) - 1
    for v in reversed(order):
        if v in mirrored:
            readers = [
                e.target
                for e in out[v]
                if e.target in rank and (e.target not in mirrored or rank[e.target] > rank[v])
            ]
            low = max((column[t] + (parts[t].kind == "sum" or t in mirrored) for t in readers), default=1)
            high = min(
                (column[e.source] for e in into[v] if e.source not in mirrored and e.source in rank),
                default=low,
            )
            column[v] = max(low, high)
    right = 1 + max((column[v] for v in rank), default=0)
    for v, part in enumerate(parts):
        if part.kind == "output":
            source = next((e.source for e in into[v]), None)
            beside = taps and source is not None and source in rank
            column[v] = (
                right if not beside or source is None else column[source] + (-1 if source in mirrored else 1)
            )
        elif part.kind == "input":
            column[v] = min((column[e.target] for e in out[v]), default=1) - 1 if near else 0
    least = min(column.values(), default=0)
    return tuple(column[v] - least for v in range(len(parts)))
