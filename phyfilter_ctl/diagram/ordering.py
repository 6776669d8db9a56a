"""Order in which signals can be evaluated, and the loops that stand in the way."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

__all__ = ["components", "cycle", "levels", "tear"]


def components(nodes: Iterable[int], needs: Callable[[int], Sequence[int]]) -> list[list[int]]:
    """Strongly connected components, each after those that it needs (Tarjan 1972).

    Parameters
    ----------
    nodes : iterable of int
    needs : callable
        node -> the nodes that it needs; nodes that are not among ``nodes`` count as known.

    Returns
    -------
    list of list of int

    Examples
    --------
    >>> graph = {0: [1], 1: [2], 2: [1], 3: []}
    >>> [sorted(part) for part in components(graph, graph.__getitem__)]
    [[1, 2], [0], [3]]
    """
    members = dict.fromkeys(nodes)
    number: dict[int, int] = {}
    low: dict[int, int] = {}
    waiting: list[int] = []
    on_stack: set[int] = set()
    found: list[list[int]] = []
    for root in members:
        if root in number:
            continue
        calls = [(root, iter(needs(root)))]
        number[root] = low[root] = len(number)
        waiting.append(root)
        on_stack.add(root)
        while calls:
            node, rest = calls[-1]
            for child in rest:
                if child not in members:
                    continue
                if child not in number:
                    number[child] = low[child] = len(number)
                    waiting.append(child)
                    on_stack.add(child)
                    calls.append((child, iter(needs(child))))
                    break
                if child in on_stack:
                    low[node] = min(low[node], number[child])
            else:
                calls.pop()
                if calls:
                    low[calls[-1][0]] = min(low[calls[-1][0]], low[node])
                if low[node] == number[node]:
                    part = []
                    while not part or part[-1] != node:
                        part.append(waiting.pop())
                        on_stack.discard(part[-1])
                    found.append(part)
    return found


def levels(
    parts: Sequence[Sequence[int]], needs: Callable[[int], Sequence[int]], costly: Callable[[int], bool]
) -> list[tuple[int, list[int]]]:
    """The same components sorted so that costly ones of one level stand together, sums before them.

    Parameters
    ----------
    parts : sequence of sequence of int
        From :func:`components`.
    needs : callable
    costly : callable
        Whether a node is a block's output (a block is called once per level) rather than a sum.

    Returns
    -------
    list of (level, nodes)

    Examples
    --------
    Two blocks in parallel (1 and 3), each behind a sum (0 and 2): both are called after both sums.

    >>> graph = {0: [], 1: [0], 2: [], 3: [2]}
    >>> levels([[0], [1], [2], [3]], graph.__getitem__, lambda node: node % 2 == 1)
    [(0, [0]), (0, [2]), (0, [1]), (0, [3])]
    """
    level: dict[int, int] = {}
    keyed = []
    for part in parts:
        inside = set(part)
        heavy = len(part) > 1 or costly(part[0])
        known = [n for node in part for n in needs(node) if n not in inside and n in level]
        depth = max((level[n] // 2 + level[n] % 2 for n in known), default=0)
        for node in part:
            level[node] = 2 * depth + heavy
        keyed.append((2 * depth + heavy, list(part)))
    return [(key // 2, part) for key, part in sorted(keyed, key=lambda entry: entry[0])]


def tear(part: Sequence[int], needs: Callable[[int], Sequence[int]], preferred: set[int]) -> list[int]:
    """Few signals of a loop that, once known, leave the rest to be evaluated in order.

    Parameters
    ----------
    part : sequence of int
        A strongly connected component.
    needs : callable
    preferred : set of int
        Where to cut: inputs of blocks.

    Returns
    -------
    list of int

    Notes
    -----
    Greedy: cut where most paths cross, look at what is left. Not the least number, but close to it.

    Examples
    --------
    >>> graph = {0: [1], 1: [2, 0], 2: [0]}
    >>> tear([0, 1, 2], graph.__getitem__, set())
    [0]
    """
    cut: list[int] = []
    pending = [list(part)]
    while pending:
        loop = sorted(pending.pop())
        inside = set(loop)
        arriving = {node: sum(n in inside for n in needs(node)) for node in loop}
        leaving = dict.fromkeys(loop, 0)
        for node in loop:
            for n in needs(node):
                if n in inside:
                    leaving[n] += 1
        candidates = [node for node in loop if node in preferred] or loop
        chosen = max(candidates, key=lambda node: (arriving[node] * leaving[node], -node))
        cut.append(chosen)
        inside.discard(chosen)
        left = components(sorted(inside), needs)
        pending += [rest for rest in left if len(rest) > 1 or rest[0] in needs(rest[0])]
    return sorted(cut)


def cycle(part: Sequence[int], needs: Callable[[int], Sequence[int]]) -> list[int]:
    """One shortest way round a loop, in the direction in which the signals run; its first node stands at the end too.

    Parameters
    ----------
    part : sequence of int
        A strongly connected component.
    needs : callable

    Returns
    -------
    list of int

    Examples
    --------
    >>> graph = {0: [2], 1: [0], 2: [1]}
    >>> cycle([0, 1, 2], graph.__getitem__)
    [0, 1, 2, 0]
    """
    inside, start = set(part), min(part)
    before: dict[int, int] = {}
    front = [start]
    while front and start not in before:
        ahead = []
        for node in front:
            for n in needs(node):
                if n in inside and n not in before:
                    before[n] = node
                    ahead.append(n)
        front = ahead
    # ``before[n]`` is fed by n, so following it from the start runs with the signals.
    way = [start, before[start]]
    while way[-1] != start:
        way.append(before[way[-1]])
    return way
