"""A diagram with its loop opened at one signal: the loop gain there, and its margins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import control as ct
import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from ..analysis.margins import LoopMargins
from ..analysis.margins.statespace import StateSpaceLoop
from ..analysis.margins.sweep import lag_to_instability
from ..results import Result
from .flattening import flatten

__all__ = ["SignalMargin", "open_loop"]

_CUT = "opened_in", "opened_out"


@dataclass(frozen=True, eq=False, repr=False)
class SignalMargin(Result):
    """Margins of a diagram at one of its signals; made by :func:`phyfilter_ctl.signal_margin`.

    Parameters
    ----------
    signal : str
    open_loop : control.StateSpace
        L, with the return difference 1 + L.
    """

    _figures = (
        "signal",
        "is_stable",
        "stable_gains",
        "gain_margin",
        "phase_margin",
        "delay_margin",
        "modulus_margin",
    )

    signal: str
    open_loop: ct.StateSpace

    @cached_property
    def _margins(self) -> LoopMargins:
        return LoopMargins(1.0, StateSpaceLoop(self.open_loop))

    @property
    def is_stable(self) -> bool:
        """Whether the closed diagram is stable, from its eigenvalues: modes that the signal does not see count too."""
        return self._margins.is_stable

    @property
    def stable_gains(self) -> tuple[tuple[float, float], ...]:
        """Intervals of the factors on the signal, above 0, with which the diagram is stable."""
        return self._margins.stable_ratios

    @property
    def gain_margin(self) -> tuple[float, float]:
        """The interval of them that contains 1; (nan, nan) if the diagram is unstable."""
        return self._margins.gain_margin

    @property
    def phase_margin(self) -> float:
        """Least phase, lag or lead, in rad that makes the diagram unstable: inf where none does, 0 if it is so
        already."""
        return self._margins.phase_margin

    @cached_property
    def delay_margin(self) -> float:
        """Least extra delay of the signal in seconds that makes the diagram unstable: inf where none does, 0 if it is
        unstable. In discrete time the delay is a lag in phase, exact for whole steps."""
        if not self.is_stable:
            return 0.0
        omega, lag = lag_to_instability(self._margins.loop, 1.0)
        return float(np.min(lag / omega, initial=np.inf))

    @property
    def gain_crossings(self) -> FloatArray:
        """Frequencies in rad/s at which |L| = 1, ascending."""
        return self._margins.gain_crossings

    @property
    def modulus_margin(self) -> float:
        """min |1 + L| over frequency; 0 if the diagram is unstable."""
        return self._margins.modulus_margin

    @property
    def sensitivity_peak(self) -> float:
        """max |1/(1 + L)| over frequency; inf if the diagram is unstable."""
        return self._margins.sensitivity_peak


def open_loop(
    system: ct.InputOutputSystem,
    signal: str,
    *,
    x0: ArrayLike | None = None,
    u0: ArrayLike | None = None,
    params: Mapping[str, ArrayLike] | None = None,
    t: float = 0.0,
) -> ct.StateSpace:
    """Loop gain L of a diagram opened at a signal, linearised, so that 1 + L is the return difference there.

    Parameters
    ----------
    system : control.InterconnectedSystem
        Any diagram that :func:`flatten` takes.
    signal : str
        ``block.signal``, an input (opened in front of that input alone) or an output (opened behind it, for all that
        read it) of a block; blocks of a diagram inside as ``diagram.block.signal``.
    x0, u0, params, t
        Point of linearisation, as for :meth:`FlatModel.linearize`.

    Returns
    -------
    control.StateSpace
        One input, one output, states of the diagram.

    Raises
    ------
    TypeError
        If the system is no diagram.
    ValueError
        If there is no such signal (those there are are named) or an input and an output share the name; and what
        :func:`flatten` and :meth:`FlatModel.linearize` raise.

    Notes
    -----
    A signal d is added at the place and the sum r before it read: r = -L (r + d). So the diagram stays closed and the
    point of linearisation is its own; L follows from the closed system r = T d as -T/(1 + T). Sampled blocks
    count as their continuous equivalents: what hold and sampling cost is in
    :func:`phyfilter_ctl.simulation.sampled_open_loop`, not here.

    Examples
    --------
    >>> plant = ct.tf([1.0], [1.0, 1.0], inputs="u", outputs="y", name="plant")
    >>> control = ct.tf([2.0], [1.0], inputs="e", outputs="u", name="p")
    >>> loop = ct.interconnect([plant, control, ct.summing_junction(["r", "-y"], "e", name="error")],
    ...                        inputs="r", outputs="y")
    >>> open_loop(loop, "p.u").dcgain().item()
    2.0
    """
    # What drives no input is 0, as where the diagram came from.
    flat = flatten(probed(system, signal), unconnected="zero")
    return loop_gain(flat.linearize(x0, probed_inputs(system, u0), params, t), signal)


def loop_gain(closed: ct.StateSpace, signal: str) -> ct.StateSpace:
    """L of a linear model of a :func:`probed` diagram, from its last input d to its last output r = -L (r + d).

    Parameters
    ----------
    closed : control.StateSpace
    signal : str
        Where it was probed, for messages.

    Raises
    ------
    ValueError
        If the diagram opened there has a singular algebraic loop.
    """
    A, B, C = np.asarray(closed.A), np.asarray(closed.B)[:, -1:], np.asarray(closed.C)[-1:]
    through = 1.0 + float(np.asarray(closed.D)[-1, -1])
    if through == 0.0:
        raise ValueError(
            f"{signal}: opened there, the diagram has a singular algebraic loop; open it elsewhere"
        )
    return ct.StateSpace(
        A - B @ C / through,
        B / through,
        -C / through,
        1.0 / through - 1.0,
        closed.dt,
        states=closed.state_labels,
        inputs="in",
        outputs="out",
        remove_useless_states=False,
    )


def probed(system: ct.InputOutputSystem, signal: str) -> ct.InterconnectedSystem:
    """A diagram with a last input d that is added at a signal and a last output that reads the signal before it.

    Parameters
    ----------
    system : control.InterconnectedSystem
    signal : str
        As for :func:`open_loop`.

    Raises
    ------
    TypeError, ValueError
        If the system is no diagram, or has no such signal.
    """
    if not isinstance(system, ct.InterconnectedSystem):
        raise TypeError(
            f"system: expected a diagram made by control.interconnect, got {type(system).__name__}; a single block has "
            "no loop to open"
        )
    return _probe(system, signal, signal)


def probed_inputs(system: ct.InputOutputSystem, u0: ArrayLike | None) -> FloatArray | None:
    """Inputs of the :func:`probed` diagram for those of the diagram, nothing added at the signal.

    Parameters
    ----------
    system : control.InterconnectedSystem
    u0 : (inputs,) array or None

    Raises
    ------
    ValueError
        For a wrong shape.
    """
    if u0 is None:
        return None
    inputs = np.atleast_1d(_signals.real("u0", u0))
    if inputs.shape != (system.ninputs,):
        raise ValueError(f"u0: expected shape ({system.ninputs},), got {inputs.shape}")
    return np.append(inputs, 0.0)


def _probe(diagram: ct.InterconnectedSystem, place: str, signal: str) -> ct.InterconnectedSystem:
    """The diagram with a last input that is added at the place and a last output that reads the sum before it."""
    parts = list(diagram.syslist)
    index, kind, row = _find(diagram, place, signal)
    if kind == "inside":
        part = parts[index]
        assert isinstance(part, ct.InterconnectedSystem)
        parts[index] = _probe(part, place[len(part.name) + 1 :], signal)
    inputs, outputs = (
        np.cumsum([0, *(getattr(p, n) for p in diagram.syslist)]) for n in ("ninputs", "noutputs")
    )
    connect, entering, leaving = (
        np.asarray(part, dtype=float) for part in (diagram.connect_map, diagram.input_map, diagram.output_map)
    )
    add, read = np.zeros(len(connect)), np.zeros(connect.shape[1] + len(connect))
    if kind == "input":
        # Other inputs of the diagram that act there pass by: they are no part of the loop, nor of the linear model.
        add[inputs[index] + row] = 1.0
        read[: connect.shape[1]] = connect[inputs[index] + row]
    elif kind == "output":
        add[:] = connect[:, outputs[index] + row]
        read[outputs[index] + row] = 1.0
    else:
        # The part has one input and one output more now, each the last of its own.
        connect = np.insert(
            np.insert(connect, inputs[index + 1], 0.0, axis=0), outputs[index + 1], 0.0, axis=1
        )
        entering = np.insert(entering, inputs[index + 1], 0.0, axis=0)
        shift = [outputs[index + 1], outputs[-1] + inputs[index + 1]]
        leaving = np.insert(leaving, shift, 0.0, axis=1)
        add, read = np.zeros(len(connect)), np.zeros(connect.shape[1] + len(connect))
        add[inputs[index + 1]] = 1.0
        read[outputs[index + 1]] = 1.0
    cut = ct.InterconnectedSystem(
        parts,
        inputs=[*diagram.input_labels, _CUT[0]],
        outputs=[*diagram.output_labels, _CUT[1]],
        name=diagram.name,
        params=diagram.params,
        dt=diagram.dt,
    )
    cut.connect_map = connect
    cut.input_map = np.column_stack([entering, add])
    cut.output_map = np.vstack([leaving, read])
    return cut


def _find(
    diagram: ct.InterconnectedSystem, place: str, signal: str
) -> tuple[int, Literal["input", "output", "inside"], int]:
    """(block, what, number of the signal) of ``block.signal``."""
    for i, part in enumerate(diagram.syslist):
        if not place.startswith(f"{part.name}."):
            continue
        rest = place[len(part.name) + 1 :]
        where = rest in part.input_labels, rest in part.output_labels
        if all(where):
            raise ValueError(
                f"{signal}: block {part.name} has an input and an output of that name; rename one, or open the loop "
                "at a neighbour"
            )
        if where[0]:
            return i, "input", part.input_labels.index(rest)
        if where[1]:
            return i, "output", part.output_labels.index(rest)
        if isinstance(part, ct.InterconnectedSystem):
            return i, "inside", 0
    there = [
        f"{part.name}.{label}"
        for part in diagram.syslist
        for label in (*part.input_labels, *part.output_labels)
    ]
    raise ValueError(f"{signal}: no such signal; expected one of {', '.join(there)}")
