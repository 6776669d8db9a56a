"""Margins of a whole diagram at one of its signals: continuous, discrete, or with sampled blocks in continuous time."""

from __future__ import annotations

from collections.abc import Mapping

import control as ct
from numpy.typing import ArrayLike

from ..blocks.functions import dependencies
from ..diagram import FlatModel, SignalMargin, open_loop
from .sampled_loop import probed_flat, sampled_open_loop

__all__ = ["signal_margin"]


def signal_margin(
    system: ct.InputOutputSystem,
    signal: str,
    *,
    x0: ArrayLike | None = None,
    u0: ArrayLike | None = None,
    params: Mapping[str, ArrayLike] | None = None,
    t: float = 0.0,
    settle: float = 0.0,
    substeps: int | None = None,
) -> SignalMargin:
    """Margins of a whole diagram with the loop opened at a named signal.

    Parameters
    ----------
    system, signal, x0, u0, params, t
        As for :func:`phyfilter_ctl.diagram.open_loop`.
    settle, substeps
        With sampled blocks, as for :func:`linearize_sampled`.

    Returns
    -------
    SignalMargin
        With sampled blocks that of the sampled loop, with hold and delays: stable if the spectral radius from instant
        to instant is below 1, the rest from L(e^(j omega h)) up to the Nyquist frequency.

    Raises
    ------
    TypeError, ValueError
        As for :func:`phyfilter_ctl.diagram.open_loop` and, with sampled blocks, :func:`sampled_open_loop`; for sampled
        blocks of several periods; for a signal that goes from a continuous block to a continuous one past the sampled
        blocks: a gain or delay there acts between the instants too, of which L from instant to instant knows nothing.

    Examples
    --------
    >>> plant = ct.tf([1.0], [1.0, 3.0, 3.0, 1.0], inputs="u", outputs="y", name="plant")
    >>> control = ct.tf([2.0], [1.0], inputs="e", outputs="u", name="p")
    >>> loop = ct.interconnect([plant, control, ct.summing_junction(["r", "-y"], "e", name="error")],
    ...                        inputs="r", outputs="y")
    >>> margin = signal_margin(loop, "plant.u")
    >>> [round(g, 6) for g in margin.gain_margin]
    [0.0, 4.0]
    """
    flat = probed_flat(system, signal)
    if not flat.tasks:
        if settle or substeps is not None:
            raise ValueError(f"{flat.name} has no sampled blocks: settle and substeps are for those")
        return SignalMargin(signal, open_loop(system, signal, x0=x0, u0=u0, params=params, t=t))
    if t:
        raise ValueError(f"t: a diagram with sampled blocks starts at 0, got {t}; let it settle instead")
    if _acts_between_instants(flat):
        places = " or ".join(task.name for task in flat.tasks)
        raise ValueError(
            f"{signal} goes from continuous block to continuous block, past the sampled ones, so margins there cannot "
            f"be told from instant to instant: open the loop where {places} reads or puts out; whether the diagram is "
            "stable as it is, the poles of linearize_sampled tell"
        )
    L = sampled_open_loop(system, signal, x0, u0=u0, settle=settle, params=params, substeps=substeps)
    return SignalMargin(signal, L)


def _acts_between_instants(flat: FlatModel) -> bool:
    """Whether a probed signal moves between the instants, and what is added to it acts there too."""
    moves = any(dependencies(flat.output, of)[-1].any() for of in (0, 1))
    return moves and bool(dependencies(flat.dynamics, 2)[:, -1].any())
