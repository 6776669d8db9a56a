"""The linear model of a diagram with sampled blocks as those see it: from instant to instant, with hold and delay."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import control as ct
import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._sections import FloatArray
from ..blocks.function_block import point
from ..blocks.functions import dependencies
from ..diagram import FlatModel, flatten
from ..diagram.opening import loop_gain, probed, probed_inputs, signals_of
from ..simulation.arguments import Start, start_vector
from .periodic import PeriodicModel, held
from .settling import OperatingPoint, settled

__all__ = [
    "OpenedLoop",
    "SampledModel",
    "linearize_sampled",
    "opened_loop",
    "probed_flat",
    "sampled_open_loop",
]


class SampledModel(ct.StateSpace):
    """A discrete linear model of a diagram, and where it was linearised.

    Parameters
    ----------
    matrices : sequence of arrays
        A, B, C, D.
    dt : float
        Seconds.
    point : OperatingPoint
    inputs, outputs : sequence of str
        Names.
    """

    def __init__(
        self,
        matrices: Sequence[FloatArray],
        dt: float,
        point: OperatingPoint,
        *,
        inputs: Sequence[str],
        outputs: Sequence[str],
    ) -> None:
        super().__init__(
            *matrices, dt, inputs=list(inputs), outputs=list(outputs), remove_useless_states=False
        )
        self.point: OperatingPoint = point


def linearize_sampled(
    sys: ct.InputOutputSystem | FlatModel,
    initial_state: Start | None = None,
    *,
    u0: ArrayLike | None = None,
    settle: float = 0.0,
    params: Mapping[str, ArrayLike] | None = None,
) -> SampledModel:
    """Discrete linear model of a diagram with sampled blocks, of one period or of several.

    What happens from one instant to the next, linear: the sampled blocks run, then the rest moves on with their outputs
    held, by the matrix exponential. So sampling, hold, order of the blocks and delays count, which
    :meth:`FlatModel.linearize` leaves out.

    Parameters
    ----------
    sys : control.InputOutputSystem or FlatModel
        With at least one sampled block.
    initial_state : array, list, mapping or number, optional
        As for :func:`simulate`.
    u0 : (inputs,) array, optional
        Inputs, held throughout; None means their defaults.
    settle : float
        Seconds that the diagram runs before it is linearised where it has come to: whole common periods, and at least
        one, because at its first instant a sampled filter only starts and passes nothing on.
    params : mapping, optional
        As for :func:`simulate`.

    Returns
    -------
    SampledModel
        A control.StateSpace; its ``point`` says where it was linearised, and whether that is at rest. Inputs are held
        between instants, outputs are those at the instant. States are those of the model, of the sampled blocks, and
        what these hold. Blocks of several periods: dt is their least common multiple, and inputs and outputs come once
        for each instant in it, as ``name@0``, ``name@1`` ...: the lifted system.

    Raises
    ------
    ValueError
        For a diagram without sampled blocks, without inputs or outputs, or with periods that have no common multiple
        within 2000 instants; for inputs of the wrong shape or a negative time to settle; or if the diagram does not
        stay finite while it settles.

    Notes
    -----
    Exact for diagrams that are linear in their continuous states, and for others at rest; elsewhere every interval has
    the derivatives at its beginning. Lifting: P. Khargonekar, K. Poolla, A. Tannenbaum, "Robust control of linear
    time-invariant plants using periodic compensation", IEEE Trans. Automatic Control 30 (1985).

    Examples
    --------
    A held command makes the loop of an integrator unstable where gain times period reaches 2:

    >>> from phyfilter_ctl.blocks import sampled_block, wired
    >>> gain = sampled_block(ct.ss([], [], [], [[1.5, -1.5]], dt=1.0, inputs=["r", "y"], outputs="u", name="gain"))
    >>> body = ct.tf([1.0], [1.0, 0.0], inputs="u", outputs="y", name="body")
    >>> loop = wired(
    ...     [gain, body], {"body.u": "gain.u", "gain.y": "body.y"}, inputs={"r": "gain.r"}, outputs={"y": "body.y"}
    ... )
    >>> model = linearize_sampled(loop)
    >>> sorted(model.poles().real.round(12).tolist()), model.point.describe()
    ([-0.5, 0.0], 'at rest after 1 s')
    """
    flat = sys if isinstance(sys, FlatModel) else flatten(sys)
    if flat.tasks and not (flat.inputs and flat.outputs):
        raise ValueError(f"{flat.name} has no inputs or no outputs: a linear model needs one of each")
    model, where = _settled(flat, initial_state, u0, settle, params)
    every = slice(None)
    instants = range(len(model.at))
    matrices = model.wired(every, every, held).lifted(instants)
    names = [[v.name for v in part] for part in (flat.inputs, flat.outputs)]
    if len(instants) > 1:
        names = [[f"{name}@{j}" for j in instants for name in part] for part in names]
    return SampledModel(matrices, model.instants.period, where, inputs=names[0], outputs=names[1])


def sampled_open_loop(
    system: ct.InputOutputSystem,
    signal: str | Sequence[str],
    initial_state: Start | None = None,
    *,
    u0: ArrayLike | None = None,
    settle: float = 0.0,
    params: Mapping[str, ArrayLike] | None = None,
) -> SampledModel:
    """Loop gain L of a sampled diagram opened at a signal, so that I + L is the return difference there.

    Parameters
    ----------
    system : control.InterconnectedSystem
        With sampled blocks.
    signal : str or sequence of str
        As for :func:`phyfilter_ctl.between`.
    initial_state, u0, settle, params
        As for :func:`linearize_sampled`.

    Returns
    -------
    SampledModel
        Discrete; one input and output for each signal where dt is the period in which it changes or is read. Blocks of
        several periods: dt is their least common multiple, and a signal that changes (or is read) N times in it is
        lifted to N inputs and outputs, ``in@0`` ... ``in@N-1``. L is scalar for a signal at the slowest rate.

    Raises
    ------
    TypeError, ValueError
        As for :func:`phyfilter_ctl.between` and :func:`linearize_sampled`.

    Notes
    -----
    An input of a block that nothing drives is 0: only the loop counts, so what comes from outside need not be wired.

    What is added at the signal is held from instant to instant. So L is that of the diagram where the signal itself is
    held, or only sampled blocks read it; where a continuous block drives a continuous one, it is that of a loop with a
    hold in this place. The closed loop that belongs to it, and whether that is stable, is the diagram's in any case.

    Examples
    --------
    >>> from phyfilter_ctl.blocks import sampled_block, wired
    >>> gain = sampled_block(ct.ss([], [], [], [[-1.5]], dt=1.0, inputs="y", outputs="u", name="gain"))
    >>> body = ct.tf([1.0], [1.0, 0.0], inputs="u", outputs="y", name="body")
    >>> loop = wired([gain, body], {"body.u": "gain.u", "gain.y": "body.y"}, outputs={"y": "body.y"})
    >>> abs(1.0 + sampled_open_loop(loop, "gain.u")(-1.0)).round(9).item()  # 2/1.5 times the gain would be the limit
    0.25
    """
    return opened_loop(system, signal, initial_state, u0, settle, params).gain


@lru_cache(maxsize=16)
def probed_flat(system: ct.InputOutputSystem, signals: tuple[str, ...]) -> FlatModel:
    """The diagram with its probes at the signals, flat; see :func:`phyfilter_ctl.diagram.opening.probed`."""
    return flatten(probed(system, signals), unconnected="zero")


@dataclass(frozen=True, eq=False)
class OpenedLoop:
    """A sampled diagram opened at signals.

    Parameters
    ----------
    model : PeriodicModel
        Of the probed diagram.
    count : int
        Number of signals, the last inputs and outputs.
    kind : {"held", "read", "mixed", "between"}
        Whether the signals change at the instants of ``grid`` only; are read there only; some this, some that; or act
        between instants too.
    grid : tuple of int
        Instants of the model.
    gain : SampledModel
        L over a hyperperiod, signal by signal.
    """

    model: PeriodicModel
    count: int
    kind: Literal["held", "read", "mixed", "between"]
    grid: tuple[int, ...]
    gain: SampledModel


def opened_loop(
    system: ct.InputOutputSystem,
    signal: str | Sequence[str],
    initial_state: Start | None,
    u0: ArrayLike | None,
    settle: float,
    params: Mapping[str, ArrayLike] | None,
) -> OpenedLoop:
    """The loop of :func:`sampled_open_loop` with all that margins need."""
    signals = signals_of(signal, system)
    flat, p = probed_flat(system, signals), len(signals)
    model, where = _settled(flat, initial_state, probed_inputs(system, u0, p), settle, params)
    kind, grid = _grid(flat, p, model)
    last = slice(-p, None)
    T = model.wired(last, last, held).lifted(grid)
    order = np.arange(p * len(grid)).reshape(len(grid), p).T.ravel()  # signal by signal
    A, B, C, D = loop_gain(T[0], T[1][:, order], T[2][order], T[3][order][:, order], signals)
    ends = ["in", "out"] if p == 1 else ["in[{}]", "out[{}]"]
    names = [
        [end.format(i) + (f"@{j}" if len(grid) > 1 else "") for i in range(p) for j in range(len(grid))]
        for end in ends
    ]
    gain = SampledModel((A, B, C, D), model.instants.period, where, inputs=names[0], outputs=names[1])
    return OpenedLoop(model, p, kind, grid, gain)


def _settled(
    flat: FlatModel,
    initial_state: Start | None,
    u0: ArrayLike | None,
    settle: float,
    params: Mapping[str, ArrayLike] | None,
) -> tuple[PeriodicModel, OperatingPoint]:
    u = point("u0", u0, flat.inputs)
    return settled(flat, start_vector(flat, initial_state), u, flat.start_parameters(params), settle)


def _grid(
    flat: FlatModel, count: int, model: PeriodicModel
) -> tuple[Literal["held", "read", "mixed", "between"], tuple[int, ...]]:
    """When the last ``count`` outputs change, or the last inputs are read, whichever is less often."""
    due, every = model.instants.due, tuple(range(len(model.at)))
    moves: NDArray[np.bool_] = np.logical_or(
        *(np.any(dependencies(flat.output, of)[-count:], axis=1) for of in (0, 1))
    )
    sources = np.array(dependencies(flat.output, 4)[-count:])
    acts: NDArray[np.bool_] = np.logical_or.reduce(dependencies(flat.dynamics, 2)[:, -count:], axis=0)
    readers = np.array([dependencies(task.signals, 2)[:, -count:].any(axis=0) for task in flat.tasks])
    drivers = np.array([sources[:, task.held].any(axis=1) for task in flat.tasks])
    kinds: dict[Literal["held", "read"], set[int]] = {}
    for i in range(count):
        choices: list[tuple[Literal["held", "read"], set[int]]] = []
        if not acts[i]:
            choices.append(("read", set(np.flatnonzero(due[:, readers[:, i]].any(axis=1)).tolist())))
        if not moves[i]:
            choices.append(("held", set(np.flatnonzero(due[:, drivers[:, i]].any(axis=1)).tolist())))
        if not choices:
            return "between", every
        kind, when = min(choices, key=lambda choice: len(choice[1]))
        kinds.setdefault(kind, set()).update(when)
    grid = tuple(sorted(set().union(*kinds.values()))) or (0,)
    return (next(iter(kinds)) if len(kinds) == 1 else "mixed"), grid
