"""Margins of a whole diagram at its signals: continuous, discrete, or with sampled blocks in continuous time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import control as ct
from numpy.typing import ArrayLike

from ..analysis.margins.matrix_search import MatrixSearch
from ..analysis.margins.scalar_search import Bound, MarginSearch, ScalarSearch
from ..analysis.margins.statespace import StateSpaceLoop
from ..diagram import FlatModel, SignalMargin, open_loop
from ..diagram.opening import signals_of
from .periodic import Matrix, scaled
from .sampled_loop import OpenedLoop, opened_loop, probed_flat
from .signal_delay import delay_margin

__all__ = ["signal_margin"]


def signal_margin(
    system: ct.InputOutputSystem,
    signal: str | Sequence[str],
    *,
    x0: ArrayLike | None = None,
    u0: ArrayLike | None = None,
    params: Mapping[str, ArrayLike] | None = None,
    t: float = 0.0,
    settle: float = 0.0,
) -> SignalMargin:
    """Margins of a whole diagram with the loop opened at a named signal, or at several at once.

    Parameters
    ----------
    system, signal, x0, u0, params, t
        As for :func:`phyfilter_ctl.diagram.open_loop`.
    settle
        With sampled blocks, as for :func:`linearize_sampled`.

    Returns
    -------
    SignalMargin
        With sampled blocks that of the sampled loop, with hold and delays: stable if the spectral radius over the
        common period is below 1; delays within a step are exact. ``about`` says where it was linearised, and which
        inputs of blocks nothing drives, so that they are 0. A signal that goes from a continuous block to a continuous
        one past the sampled blocks acts between the instants too: gain and phase margin are exact (eigenvalues with the
        factor inside the loop), the others nan.

    Raises
    ------
    TypeError, ValueError
        As for :func:`phyfilter_ctl.diagram.open_loop` and, with sampled blocks, :func:`sampled_open_loop`.

    Examples
    --------
    >>> plant = ct.tf([1.0], [1.0, 3.0, 3.0, 1.0], inputs="u", outputs="y", name="plant")
    >>> control = ct.tf([2.0], [1.0], inputs="e", outputs="u", name="p")
    >>> loop = ct.interconnect([plant, control, ct.summing_junction(["r", "-y"], "e", name="error")],
    ...                        inputs="r", outputs="y")
    >>> margin = signal_margin(loop, "plant.u")
    >>> [round(g, 6) for g in margin.gain_margin], round(margin.gain_frequency[1], 6)
    ([0.0, 4.0], 1.732051)
    """
    signals = signals_of(signal)
    named = signals[0] if len(signals) == 1 else signals
    flat = probed_flat(system, signals)
    if not flat.tasks:
        if settle:
            raise ValueError(f"{flat.name} has no sampled blocks: settle is for those")
        linear = open_loop(system, signals, x0=x0, u0=u0, params=params, t=t)
        return SignalMargin(named, linear, _undriven(flat))
    if t:
        raise ValueError(f"t: a diagram with sampled blocks starts at 0, got {t}; let it settle instead")
    loop = opened_loop(system, signals, x0, u0, settle, params)
    about = "; ".join(part for part in (loop.gain.point.describe(), _undriven(flat)) if part)
    if loop.kind == "between":
        places = " or ".join(task.name for task in flat.tasks)
        return SignalMargin(named, None, about, _between(loop, places))
    return SignalMargin(named, loop.gain, about, _search(loop))


def _undriven(flat: FlatModel) -> str:
    return f"nothing drives {', '.join(flat.undriven)}, taken as 0" if flat.undriven else ""


def _search(loop: OpenedLoop) -> MarginSearch:
    def delayed() -> Bound:
        return Bound(float("nan"), float("nan")) if loop.kind == "mixed" else delay_margin(loop)

    if loop.gain.ninputs == 1:
        return ScalarSearch(StateSpaceLoop(loop.gain), 1.0, delayed)
    missing = (
        "delay margin, as some signals are held and others only read at instants"
        if loop.kind == "mixed"
        else ""
    )
    return MatrixSearch.of(loop.gain, (len(loop.grid),) * loop.count, delayed, missing)


def _between(loop: OpenedLoop, places: str) -> MatrixSearch:
    last = slice(-loop.count, None)

    def closed(factor: complex) -> Matrix:
        return loop.model.wired(last, last, scaled(factor)).monodromy()

    missing = (
        "delay, modulus and disk margin, as the signal acts between the instants too; for those open the loop where "
        f"{places} reads or puts out"
    )
    return MatrixSearch(closed, loop.model.instants.period, None, (1,) * loop.count, missing=missing)
