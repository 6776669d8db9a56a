"""What a cut into co-simulated parts costs, told without one: the diagram with a sample of delay in some wires."""

from __future__ import annotations

from collections.abc import Mapping

import control as ct
import numpy as np
from numpy.typing import ArrayLike

from phyfilter_ctl.blocks import delay_line, signal_names

__all__ = ["late_wires"]


def late_wires(
    system: ct.InterconnectedSystem, late: Mapping[str, ArrayLike], dt: float
) -> ct.InterconnectedSystem:
    """A diagram in which other blocks read some signals one sample late.

    A co-simulated part holds its inputs over a step. A sampled block in it therefore sees a signal of another part one
    sample late, unless that part has made the step before it (Gauss-Seidel). With these signals late, the diagram does
    what the co-simulation does, to rounding; what is left then is a mistake.

    Parameters
    ----------
    system : control.InterconnectedSystem
    late : dict of str to number or (k,) array
        ``block.signal`` of each signal, whole vectors under one name, and what is read before its first sample has come
        through.
    dt : float
        Sampling interval, s.

    Returns
    -------
    control.InterconnectedSystem
        With the names, inputs and outputs of ``system``, and a block ``late_BLOCK_SIGNAL`` for each signal. Outputs of
        the diagram are not late.

    Raises
    ------
    ValueError
        For a block or a signal that is not there.

    Examples
    --------
    >>> from phyfilter_ctl import simulate
    >>> from phyfilter_ctl.blocks import sampled_block, wired
    >>> twice = [ct.ss([], [], [], [[2.0]], dt=1.0, inputs="u", outputs="y", name=name) for name in ("a", "b")]
    >>> pair = wired([sampled_block(block, name=block.name) for block in twice], {"b.u": "a.y"},
    ...              inputs={"in": "a.u"}, outputs={"out": "b.y"}, name="pair")
    >>> late = late_wires(pair, {"a.y": 0.5}, 1.0)
    >>> [simulate(each, [0.0, 1.0, 2.0], [1.0, 2.0, 3.0]).outputs.tolist() for each in (pair, late)]
    [[4.0, 8.0, 12.0], [1.0, 4.0, 8.0]]
    """
    blocks = list(system.syslist)
    lines, moved = [], []
    rows, columns = system.connect_map.shape
    for source, start in late.items():
        block, _, signal = source.partition(".")
        if block not in system.syslist_index:
            raise ValueError(
                f"late: {source}: no block {block!r}; there are {', '.join(system.syslist_index)}"
            )
        at = system.syslist_index[block]
        labels = [label for label in blocks[at].output_labels if signal_names([label]) == [signal]]
        if not labels:
            there = ", ".join(signal_names(blocks[at].output_labels))
            raise ValueError(f"late: {source}: block {block!r} has no output {signal!r}; there are {there}")
        lines.append(delay_line(labels, 1, dt, name=f"late_{block}_{signal}", start=start))
        moved += [system.output_offset[at] + blocks[at].output_labels.index(label) for label in labels]
    delayed = ct.InterconnectedSystem(
        [*blocks, *lines],
        inputs=system.input_labels,
        outputs=system.output_labels,
        name=system.name,
        params=system.params,
        warn_duplicate=False,
    )
    n = len(moved)
    connect = np.zeros((rows + n, columns + n))
    connect[:rows, :columns] = system.connect_map
    connect[:rows, columns:] = connect[:rows, moved]
    connect[:rows, moved] = 0.0
    connect[rows + np.arange(n), moved] = 1.0
    delayed.set_connect_map(connect)
    delayed.set_input_map(np.vstack([system.input_map, np.zeros((n, system.ninputs))]))
    seen, through = np.split(system.output_map, [columns], axis=1)
    pad = np.zeros((system.noutputs, n))
    delayed.set_output_map(np.hstack([seen, pad, through, pad] if through.shape[1] else [seen, pad]))
    return delayed
