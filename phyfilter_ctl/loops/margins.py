"""Stability margins of everything: the loop around a filter, a loop gain, a whole diagram at its signals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast, overload

import control as ct
from numpy.typing import ArrayLike

from ..analysis import FilterMargins, SystemMargins
from ..analysis.channels import Filter, channels_of
from ..analysis.margins import filter_margins, gain_margins
from ..analysis.margins.matrix_search import MatrixSearch
from ..analysis.margins.scalar_search import Bound, MarginSearch, ScalarSearch
from ..analysis.margins.statespace import StateSpaceLoop
from ..diagram import FlatModel
from ..diagram.opening import open_loop, signals_of
from ..filter import SampledBank, SampledPhyFilter
from ..results import PerChannel
from ..values import Loop
from .periodic import Matrix, scaled
from .sampled_loop import OpenedLoop, opened_loop, probed_flat
from .signal_delay import delay_margin

__all__ = ["margins", "signal_margins"]


@overload
def margins(  # pyright: ignore[reportOverlappingOverload]  # a bank is a sampled filter too, and answers by channel
    system: SampledBank | Sequence[Filter],
    loop: Loop | Sequence[Loop] | None = None,
    *,
    dt: float | None = None,
) -> PerChannel[FilterMargins]: ...


@overload
def margins(system: Filter, loop: Loop | None = None, *, dt: float | None = None) -> FilterMargins: ...


@overload
def margins(
    system: ct.InputOutputSystem,
    *,
    at: str | Sequence[str] | None = None,
    x0: ArrayLike | None = None,
    u0: ArrayLike | None = None,
    params: Mapping[str, ArrayLike] | None = None,
    t: float = 0.0,
    settle: float = 0.0,
) -> SystemMargins: ...


def margins(
    system: ct.InputOutputSystem | SampledPhyFilter | SampledBank | Sequence[Filter],
    loop: Loop | Sequence[Loop] | None = None,
    *,
    at: str | Sequence[str] | None = None,
    dt: float | None = None,
    x0: ArrayLike | None = None,
    u0: ArrayLike | None = None,
    params: Mapping[str, ArrayLike] | None = None,
    t: float = 0.0,
    settle: float = 0.0,
) -> FilterMargins | SystemMargins | PerChannel[FilterMargins]:
    """Stability margins: of the loop around a filter, of a loop gain, or of a diagram opened at a wire.

    Parameters
    ----------
    system : PhyFilter, SampledPhyFilter, several of them, control.StateSpace, TransferFunction or InterconnectedSystem
        A filter, with f_hat fed back: a sampled one runs at its rate with the command held over the step, as it is
        (method, delay of the measurement); its limit is left out. Several, by ``stack`` or as a sequence: the answer is
        a ``PerChannel``, and the loop one for all or a list. A system without ``at``: the loop gain L with the return
        difference I + L (negative feedback), as many outputs as inputs. With ``at``: a diagram, opened there.
    loop : Loop, optional
        Of a filter: outer gains, actuator, delay, inertia ratio, what the filter is told. None: f_hat alone, fed back
        through an ideal actuator.
    at : str or sequence of str, optional
        ``block.signal`` of a diagram; several, or all of a vector ``block.v``, are opened all at once.
    dt : float, optional
        Sampling interval in seconds: for a PhyFilter short for ``filter.sampled(dt)``.
    x0, u0, params, t
        Point of linearisation of a diagram, as for :meth:`FlatModel.linearize`.
    settle : float
        Of a diagram with sampled blocks, as for :func:`linearize_sampled`.

    Returns
    -------
    FilterMargins, PerChannel of it, or SystemMargins
        Of a diagram with sampled blocks those of the sampled loop, with hold and delays: stable if the spectral radius
        over the common period is below 1; delays within a step are exact. ``about`` says where it was linearised, and
        which inputs of blocks nothing drives, so that they are 0. A signal that goes from a continuous block to a
        continuous one past the sampled blocks acts between the instants too: gain and phase margin are exact
        (eigenvalues with the factor inside the loop), the others nan.

    Raises
    ------
    TypeError
        If the system or the loop is of another kind.
    ValueError
        For a filter that has g="average", a measurement delay with g="applied", or a ``dt`` that contradicts it; for an
        L that is not square; for a diagram as :func:`phyfilter_ctl.between` and, with sampled blocks,
        :func:`sampled_open_loop`; for an argument that is of another kind of system.

    Notes
    -----
    The loop around a filter is, with mu = M_hat / M,

        1 + F (mu Act e^(-s delay) - 1) + mu Act e^(-s delay) (Kp/s^2 + Kd/s) = 0

    x is the velocity. Crossings of the boundary of stability are searched along the frequency axis; between two of them
    the verdict is that of one ratio, taken from the closed-loop poles, with delay from a certified count (see
    :meth:`FilterMargins.stable`). Sampled, the outer loop acts on the samples of position and velocity, late like the
    filter's if that has a delay. Without gains it is the inner loop alone, which overestimates the limits where the
    actuator lags.

    Told what acts, the loop is 1 + Act e^(-s delay) [(mu - 1) F + mu (Kp/s^2 + Kd/s)] = 0, and with an exact inertia
    the filter is not in it. Gain, phase, delay, modulus and disk margins are those of this loop opened at the command,
    at ``inertia_ratio``; a gain of the actuator is told too, so that the gain margin and ``stable_ratios``, over mu,
    are two things here. A current that reads wrong by a gain is not covered.

    Examples
    --------
    Three repeated poles tolerate an inertia taken nine times too large, and no lower limit:

    >>> from dataclasses import replace
    >>> from phyfilter_ctl import PhyFilter
    >>> found = margins(PhyFilter.from_poles([-20.0] * 3))
    >>> round(found.min_ratio, 9), round(found.max_ratio, 9)
    (0.0, 9.0)

    A first-order lag of 100 ms and 20 ms of delay: 15 rad/s is fine, 20 rad/s is not. A filter that is told what acts
    may be faster, as far as the inertia is known.

    >>> loop = Loop(10.0, 6.0, actuator=0.1, delay=0.02)
    >>> [margins(PhyFilter([w]), loop).is_stable for w in (15.0, 20.0)]
    [True, False]
    >>> found = margins(PhyFilter([20.0]), replace(loop, g="applied"))
    >>> found.is_stable, [tuple(round(ratio, 2) for ratio in ends) for ends in found.stable_ratios]
    (True, [(0.26, 5.89)])

    A diagram at one of its wires, and the page of a filter's margins:

    >>> plant = ct.tf([1.0], [1.0, 3.0, 3.0, 1.0], inputs="u", outputs="y", name="plant")
    >>> control = ct.tf([2.0], [1.0], inputs="e", outputs="u", name="p")
    >>> diagram = ct.interconnect([plant, control, ct.summing_junction(["r", "-y"], "e", name="error")],
    ...                           inputs="r", outputs="y")
    >>> [round(g, 6) for g in margins(diagram, at="plant.u").gain_margin]
    [0.0, 4.0]
    >>> print(margins(PhyFilter([20.0]), dt=0.002).describe())
    stable M_hat/M    0 ... 51.01
    at M_hat/M = 1    stable
    gain margin       0 to 51.01 times at 1571 rad/s (250 Hz)
    phase margin      88.88 deg at 19.61 rad/s (3.12 Hz)
    delay margin      79.13 ms at 19.6 rad/s (3.12 Hz)
    modulus margin    0.9804 at 1571 rad/s (250 Hz)
    disk margin       1.923 at 1571 rad/s (250 Hz): 0.01961 to 51.01 times with 87.75 deg
    sensitivity       peak 1.02
    """
    of_diagram = {"x0": x0, "u0": u0, "params": params, "t": t or None, "settle": settle or None}
    if isinstance(system, Filter) or channels_of(system) is not None:
        _refuse({"at": at} | of_diagram, "a filter, which has no wires")
        return filter_margins(cast(Any, system), cast(Any, loop), dt=dt)
    if not isinstance(system, ct.InputOutputSystem):
        raise TypeError(
            "system: expected a filter, a python-control StateSpace or TransferFunction L, or a diagram with at=, got "
            f"{type(system).__name__}"
        )
    _refuse({"loop": loop, "dt": dt}, "a python-control system, which has its loop and its step in it")
    if at is not None:
        return signal_margins(system, at, x0=x0, u0=u0, params=params, t=t, settle=settle)
    if not isinstance(system, ct.StateSpace | ct.TransferFunction):
        raise TypeError(
            f"at: expected a wire of the diagram {system.name!r}, as 'block.signal', at which it is opened"
        )
    _refuse(of_diagram, "a loop gain, which is linear; with at= they are of a diagram")
    return gain_margins(system)


def _refuse(given: Mapping[str, object], kind: str) -> None:
    """Arguments of another kind of system."""
    named = [name for name, value in given.items() if value is not None]
    if named:
        raise ValueError(
            f"{', '.join(named)}: not for {kind}; leave {'it' if len(named) == 1 else 'them'} out"
        )


def signal_margins(
    system: ct.InputOutputSystem,
    signal: str | Sequence[str],
    *,
    x0: ArrayLike | None = None,
    u0: ArrayLike | None = None,
    params: Mapping[str, ArrayLike] | None = None,
    t: float = 0.0,
    settle: float = 0.0,
) -> SystemMargins:
    """Margins of a whole diagram with the loop opened at a named signal, or at several at once; see :func:`margins`."""
    signals = signals_of(signal, system)
    named = signals[0] if len(signals) == 1 else signals
    flat = probed_flat(system, signals)
    if not flat.tasks:
        if settle:
            raise ValueError(f"{flat.name} has no sampled blocks: settle is for those")
        linear = open_loop(system, signals, x0=x0, u0=u0, params=params, t=t)
        return SystemMargins(named, linear, _undriven(flat))
    if t:
        raise ValueError(f"t: a diagram with sampled blocks starts at 0, got {t}; let it settle instead")
    loop = opened_loop(system, signals, x0, u0, settle, params)
    about = "; ".join(part for part in (loop.gain.point.describe(), _undriven(flat)) if part)
    if loop.kind == "between":
        places = " or ".join(task.name for task in flat.tasks)
        return SystemMargins(named, None, about, _between(loop, places))
    return SystemMargins(named, loop.gain, about, _search(loop))


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
