"""Sampled blocks for continuous diagrams: they run at their own rate and hold their outputs in between."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NoReturn, get_args

import control as ct
import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from ..filter import FilterBank, PhyFilter, SampledPhyFilter
from ..filter.matrices import channel_counts, checked_learned, constant_inertia
from .continuous import (
    continuous_filter,
    continuous_law,
    continuous_moving_inertia,
    forward_difference,
    state_matrices,
)
from .function_block import FunctionBlock, copied, linear_labels, point, share, unpacked
from .functions import BlockFunctions
from .law import filter_inputs, filter_law

__all__ = ["FilterLaw", "SampledBlock", "sampled_block"]

MovingInertia = Literal["scalar", "diagonal", "full"]


@dataclass(frozen=True, eq=False)
class FilterLaw:
    """A sampled PhyFilter as part of a diagram.

    Parameters
    ----------
    sampled : SampledPhyFilter
    channels : int
        Number n_x of channels of x.
    inertia : (n_x,) or (n_x, n_x) array, {"scalar", "diagonal", "full"} or None
        Constant inertia; or that the inertia is an input (M[0]; M[0] ... M[n_x-1]; M[0,0], M[0,1] ... row by row);
        or None for I.
    f_theta : bool
        Whether f_theta is an input; else it is 0.
    """

    sampled: SampledPhyFilter
    channels: int
    inertia: FloatArray | MovingInertia | None = None
    f_theta: bool = True


class _LinearState:
    """What a state space is made from: python-control's own holds lambdas, which do not pickle."""

    def __init__(self, system: ct.StateSpace) -> None:
        self.matrices = (system.A, system.B, system.C, system.D, system.dt)
        self.names = {
            "name": system.name,
            "inputs": system.input_labels,
            "outputs": system.output_labels,
            "states": system.state_labels or None,
        }

    def restored(self) -> ct.StateSpace:
        return ct.StateSpace(*self.matrices, remove_useless_states=False, **self.names)


def _no_states(t: float, x: ArrayLike, u: ArrayLike, params: Mapping[str, ArrayLike]) -> FloatArray:
    return np.zeros(0)


class SampledBlock(ct.NonlinearIOSystem):
    """A block with a rate of its own in a continuous python-control diagram; made by :func:`sampled_block`.

    At its instants, every ``period`` seconds from the start of a run, it reads its inputs and puts out; in between it
    holds its outputs. ``control.interconnect`` takes it like any continuous system. python-control cannot run it (its
    own functions raise an error that says so); ``phyfilter_ctl.simulate`` does.

    Parameters
    ----------
    inputs, outputs : sequence of str
        Labels.
    period : float
        Seconds between its instants.
    name : str
        Name of the block.
    law : BlockFunctions or None
        What it does at an instant: output (t, s, v, q) and dynamics (t, s, v, q) -> next s, on its states s, inputs v
        and parameters q. None where ``system`` says it and flattening the diagram will find out.
    filter : FilterLaw or None
        What the law is made from where the block is a sampled PhyFilter.
    system : control.InputOutputSystem or None
        The discrete system that was wrapped.
    """

    def __init__(
        self,
        inputs: Sequence[str],
        outputs: Sequence[str],
        *,
        period: float,
        name: str,
        law: BlockFunctions | None = None,
        filter: FilterLaw | None = None,
        system: ct.InputOutputSystem | None = None,
    ) -> None:
        super().__init__(None, self._refuse, inputs=list(inputs), outputs=list(outputs), dt=0, name=name)
        self.updfcn = _no_states  # python-control's own is a lambda, which does not pickle
        self.period: float = float(period)
        self.law = law
        self.filter = filter
        self.system = system
        self.symbol: str = ""  # by which block diagrams show it: a kind of node, and its lines of text

    def __getstate__(self) -> dict[str, Any]:
        state = {name: value for name, value in vars(self).items() if name != "continuous"}
        if type(self.system) is ct.StateSpace:
            state["system"] = _LinearState(self.system)
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        system = state["system"]
        self.__dict__.update(state, system=system.restored() if isinstance(system, _LinearState) else system)

    def __deepcopy__(self, memo: dict[int, object]) -> SampledBlock:
        share(memo, self.law, self.filter, self.system)
        twin = copied(self, memo)
        if self.law is not None and any(callback.running for callback in self.law.callbacks):
            twin.system = copy.deepcopy(self.system)  # it keeps something, of its own
            twin.law = getattr(twin.system, "functions", None)
        return twin

    def __str__(self) -> str:
        return (
            f"{ct.InputOutputSystem.__str__(self)}\nSampled every {self.period:g} s, outputs held in between"
        )

    # -- what python-control would run --------------------------------------------------------------------------

    def _isstatic(self) -> bool:
        return False

    def _refuse(self, *_: object) -> NoReturn:
        raise TypeError(
            f"block {self.name!r} is sampled every {self.period:g} s in a continuous diagram, which python-control "
            "cannot run: use phyfilter_ctl.simulate(diagram, timepts, inputs), or "
            "phyfilter_ctl.flatten(diagram).linearize() for a linear model with the block's continuous equivalent"
        )

    def _rhs(self, t: float, x: ArrayLike, u: ArrayLike) -> NoReturn:
        self._refuse(t, x, u)

    def _out(self, t: float, x: ArrayLike, u: ArrayLike) -> NoReturn:
        self._refuse(t, x, u)

    # -- continuous equivalent ----------------------------------------------------------------------------------

    @cached_property
    def continuous(self) -> BlockFunctions | ct.StateSpace | None:
        """What the block does as continuous time sees it; sampling and hold are left out.

        A filter: F itself, with its delay of g and f_theta as a Pade approximant of order 3, without ``limit``,
        ``g_limit`` and ``nonfinite``; an M that is an input counts as (M x)' instead of M x', which is the same at
        x = 0. A linear law: the system whose Tustin discretisation it is. Functions: themselves where they have no
        states, else x' = (next x - x) / period. None for a nonlinear system that has not been traced.
        """
        if self.filter is not None:
            law = self.filter
            if isinstance(law.inertia, str):
                return continuous_moving_inertia(law.sampled, law.channels, law.inertia, law.f_theta)
            return self._named(continuous_filter(law.sampled, law.inertia, law.channels, f_theta=law.f_theta))
        if self.law is not None:
            return forward_difference(self.law, self.period)
        if isinstance(self.system, ct.StateSpace | ct.TransferFunction):
            return self.linearize()
        return None

    # python-control's takes any keyword; this one names them.
    def linearize(  # pyright: ignore[reportIncompatibleMethodOverride]
        self,
        x0: ArrayLike | ct.OperatingPoint | None = None,
        u0: ArrayLike | None = None,
        t: float = 0.0,
        params: Mapping[str, ArrayLike] | None = None,
        eps: float = 1e-6,
        copy_names: bool = True,
        *,
        name: str | None = None,
        inputs: int | Sequence[str] | None = None,
        outputs: int | Sequence[str] | None = None,
        states: int | Sequence[str] | None = None,
    ) -> ct.StateSpace:
        """Continuous equivalent of the block, linear: sampling and hold are left out.

        A filter: F itself (see :attr:`continuous`). Any other law: linearised at the point, then the continuous system
        whose Tustin discretisation that is.

        Parameters
        ----------
        x0 : (states,) array, number or control.OperatingPoint, optional
            State of the law; None means its start. A filter does not need it.
        u0 : (inputs,) array or number, optional
            Inputs; None means their defaults. Of a filter only the inertia counts, where that is an input.
        t : float
            Time in seconds.
        params : mapping, optional
            Parameters that differ from the defaults.
        eps : float
            Perturbation with which python-control linearises a wrapped system that is not ours.
        copy_names : bool
            Whether the linear system has the names of this one.
        name : str, optional
            Name of the linear system; None means that of this one with ``$linearized``.
        inputs, outputs, states : int or sequence of str, optional
            Other names.

        Returns
        -------
        control.StateSpace
            Continuous.

        Raises
        ------
        ValueError
            For wrong shapes, or a law that no continuous system gives.
        """
        x0, u0 = unpacked(x0, u0)
        if self.filter is not None:
            linear = self._linear_filter(self.filter, u0)
        else:
            law = self._linear_law(x0, u0, t, params, eps)
            linear = continuous_law(*law, self.period)
        labels = linear_labels(self, copy_names, name, inputs, outputs, states)
        return ct.StateSpace(linear, remove_useless_states=False, **labels)

    def _linear_filter(self, law: FilterLaw, u0: ArrayLike | None) -> ct.StateSpace:
        n_x, sampled = law.channels, law.sampled
        if not isinstance(law.inertia, str):
            return continuous_filter(sampled, law.inertia, n_x, f_theta=law.f_theta)
        variables = filter_inputs(n_x, self.noutputs, law.inertia, law.f_theta)
        M = point("u0", u0, variables)[2 * n_x + (self.noutputs if law.f_theta else 0) :]
        constant = M.reshape(n_x, n_x) if law.inertia == "full" else np.broadcast_to(M, (n_x,))
        return continuous_filter(sampled, constant, n_x, len(M), law.f_theta)

    def _linear_law(
        self,
        x0: ArrayLike | None,
        u0: ArrayLike | None,
        t: float,
        params: Mapping[str, ArrayLike] | None,
        eps: float,
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        if self.law is not None:
            block = FunctionBlock(self.law, self.name, self.period)
            return state_matrices(block.linearize(x0, u0, t, params))
        if isinstance(self.system, ct.NonlinearIOSystem) and not isinstance(self.system, ct.StateSpace):
            system: Any = self.system  # whose stub takes whole seconds only
            return state_matrices(
                system.linearize(0.0 if x0 is None else x0, u0, t=t, params=params, eps=eps)
            )
        return state_matrices(self.system)

    def _named(self, linear: ct.StateSpace) -> ct.StateSpace:
        return ct.StateSpace(
            linear, remove_useless_states=False, **linear_labels(self, True, None, None, None, None)
        )


def sampled_block(
    system: SampledPhyFilter | ct.InputOutputSystem | BlockFunctions,
    channels: int | None = None,
    *,
    inertia: ArrayLike | MovingInertia | None = None,
    f_theta: bool | None = None,
    dt: float | None = None,
    name: str | None = None,
) -> SampledBlock:
    """A filter or a discrete controller that runs at its own rate in a continuous python-control diagram.

    Parameters
    ----------
    system : SampledPhyFilter, discrete python-control system or BlockFunctions
        What the block does at its instants.
    channels : int, optional
        Number n_x of channels of x of a filter; needed where neither its ``sampling``, E nor one filter per channel
        tells it.
    inertia : float, (n_x,) or (n_x, n_x) array, {"scalar", "diagonal", "full"}, optional
        Inertia M_hat of a filter. Constant; or which kind of M(t) is an input of the block: one number M[0], a diagonal
        M[0] ... M[n_x-1], or a matrix M[0,0], M[0,1] ... row by row. None takes that of its ``sampling``, else I.
    f_theta : bool, optional
        Whether a filter has inputs for a learned model; None means True. They may be left open in a diagram; f_theta
        is then 0.
    dt : float, optional
        Seconds between instants, for BlockFunctions; a filter or a discrete system has its own.
    name : str, optional
        Name of the block; None means that of the system, "phyfilter" for a filter.

    Returns
    -------
    SampledBlock
        Of a filter: inputs x[i], g[i], f_theta[i] and M, outputs f_hat[i]. Else those of the system.

    Raises
    ------
    ValueError
        For a system without a sampling interval, a number of channels that is missing or contradictory, or an inertia
        of the wrong shape.
    TypeError
        For something that cannot be sampled, or an ``f_theta`` that is no bool.

    Notes
    -----
    At its first instant a filter puts out f_theta and remembers what it reads. Then it is
    :meth:`SampledPhyFilter.step` at every instant. With ``g="hold"``, ``run``, blocks and FMUs take the g that acts
    from this sample on (the block keeps it and uses it at the next one, so that a command may depend on f_hat without
    an algebraic loop); ``step``, ``live.step`` and C take the g that acted since the last sample. With ``g="average"``
    all take g at this sample.

    A continuous diagram cannot have two time bases in python-control; a sampled block therefore says dt = 0 there.

    Examples
    --------
    >>> import control as ct
    >>> from phyfilter_ctl import PhyFilter
    >>> block = sampled_block(PhyFilter([20.0]).sampled(0.002), 1, f_theta=False)
    >>> plant = ct.ss([[0.0]], [[1.0]], [[1.0]], [[0.0]], inputs="f", outputs="x[0]", name="mass")
    >>> loop = ct.interconnect([plant, block], inputs=["f", "g[0]"], outputs=["f_hat[0]"])
    >>> block.period, loop.dt
    (0.002, 0)
    >>> ct.step_response(loop, 1.0)
    Traceback (most recent call last):
    ...
    TypeError: block 'phyfilter' is sampled every 0.002 s in a continuous diagram, which python-control cannot run: ...
    """
    if isinstance(system, SampledPhyFilter):
        if dt is not None:
            raise ValueError(f"dt: the filter is sampled every {system.dt:g} s; leave dt out")
        learned = checked_learned(True if f_theta is None else f_theta)
        return _filter_block(system, channels, inertia, learned, "phyfilter" if name is None else name)
    if channels is not None or inertia is not None or f_theta is not None:
        raise ValueError("channels, inertia and f_theta: only a SampledPhyFilter has them; leave them out")
    if isinstance(system, BlockFunctions):
        if dt is None:
            raise ValueError("dt: expected the seconds between instants of the functions, got None")
        return _law_block(system, _signals.duration("dt", dt), "sampled" if name is None else name)
    if isinstance(system, PhyFilter | FilterBank):
        kind = type(system).__name__
        raise TypeError(f"sampled_block: a {kind} is continuous; sample it first: filter.sampled(dt)")
    if not isinstance(system, ct.InputOutputSystem) or isinstance(system, ct.FrequencyResponseData):
        raise TypeError(
            "sampled_block: expected a SampledPhyFilter, a discrete python-control system or BlockFunctions, got "
            f"{type(system).__name__}"
        )
    if dt is not None and dt != system.dt:
        raise ValueError(f"dt: {system.name!r} has its own sampling interval {system.dt}; leave dt out")
    if not isinstance(system.dt, float | int) or isinstance(system.dt, bool) or not system.dt > 0.0:
        raise ValueError(
            f"{system.name!r} has dt = {system.dt}: expected a sampling interval in seconds; give it one (dt=...), or "
            "discretise it with control.sample_system"
        )
    name = system.name if name is None else name
    functions = getattr(system, "functions", None)
    return SampledBlock(
        system.input_labels,
        system.output_labels,
        period=_signals.duration("dt", system.dt),
        name=name,
        law=functions if isinstance(functions, BlockFunctions) else None,
        system=system,
    )


def _filter_block(
    sampled: SampledPhyFilter,
    channels: int | None,
    inertia: ArrayLike | MovingInertia | None,
    f_theta: bool,
    name: str,
) -> SampledBlock:
    channels = sampled.sampling.channels_or(channels)
    n_x, _ = channel_counts(len(sampled.filters), sampled.E, channels)
    inertia = sampled.sampling.inertia if inertia is None else inertia
    law = FilterLaw(sampled, n_x, _checked_inertia(inertia, n_x), f_theta)
    functions = filter_law(sampled, n_x, inertia=law.inertia, f_theta=f_theta)
    block = _law_block(functions, sampled.dt, name)
    block.filter = law
    return block


def _checked_inertia(
    inertia: ArrayLike | MovingInertia | None, n_x: int
) -> FloatArray | MovingInertia | None:
    """Constant inertia as (n_x,) or (n_x, n_x)."""
    for kind in get_args(MovingInertia):
        if isinstance(inertia, str) and inertia == kind:
            return kind
    if isinstance(inertia, str):
        raise ValueError(
            f"inertia: expected 'scalar', 'diagonal' or 'full' for an input, or the constant, got {inertia!r}"
        )
    if inertia is None:
        return None
    full = constant_inertia(inertia, n_x)
    return full if np.ndim(inertia) == 2 else np.diag(full).copy()


def _law_block(law: BlockFunctions, period: float, name: str) -> SampledBlock:
    return SampledBlock(
        [entry.name for entry in law.inputs],
        [entry.name for entry in law.outputs],
        period=period,
        name=name,
        law=law,
    )
