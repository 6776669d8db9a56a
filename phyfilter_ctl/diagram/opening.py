"""A diagram probed at its signals: the loop gain where it is opened, its margins, and the way between two signals."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Literal

import control as ct
import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from .flattening import flatten

__all__ = ["between", "open_loop"]

_CUT = "opened_in", "opened_out"
# Of I + T: beyond it the inverse is rounding.
_SINGULAR = 1e12


def open_loop(
    system: ct.InputOutputSystem,
    signal: str | Sequence[str],
    *,
    x0: ArrayLike | None = None,
    u0: ArrayLike | None = None,
    params: Mapping[str, ArrayLike] | None = None,
    t: float = 0.0,
) -> ct.StateSpace:
    """Loop gain L of a diagram opened at a signal, linearised, so that I + L is the return difference there.

    Parameters
    ----------
    system : control.InterconnectedSystem
        Any diagram that :func:`flatten` takes.
    signal : str or sequence of str
        ``block.signal``, an input (opened in front of that input alone) or an output (opened behind it, for all that
        read it) of a block; blocks of a diagram inside as ``diagram.block.signal``. Several are opened all at once, and
        so are all of a vector: ``block.v`` for v[0], v[1], ...
    x0, u0, params, t
        Point of linearisation, as for :meth:`FlatModel.linearize`.

    Returns
    -------
    control.StateSpace
        One input and one output for each signal, states of the diagram.

    Raises
    ------
    TypeError
        If the system is no diagram.
    ValueError
        If there is no such signal (those there are are named), one is given twice, or an input and an output share the
        name; and what :func:`flatten` and :meth:`FlatModel.linearize` raise.

    Notes
    -----
    A signal d is added at the place and the sum r before it read: r = -L (r + d). So the diagram stays closed and the
    point of linearisation is its own; L follows from the closed system r = T d as -T (I + T)^-1. An input of a block
    that nothing drives is 0: only the loop counts, so what comes from outside need not be wired. Sampled blocks
    count as their continuous equivalents: what hold and sampling cost is in
    :func:`phyfilter_ctl.sampled_open_loop`, not here.

    Examples
    --------
    >>> plant = ct.tf([1.0], [1.0, 1.0], inputs="u", outputs="y", name="plant")
    >>> control = ct.tf([2.0], [1.0], inputs="e", outputs="u", name="p")
    >>> loop = ct.interconnect([plant, control, ct.summing_junction(["r", "-y"], "e", name="error")],
    ...                        inputs="r", outputs="y")
    >>> open_loop(loop, "p.u").dcgain().item()
    2.0
    """
    signals = signals_of(signal, system)
    p = len(signals)
    flat = flatten(probed(system, signals), unconnected="zero")
    closed = flat.linearize(x0, probed_inputs(system, u0, p), params, t)
    A, B, C, D = (np.asarray(part, dtype=float) for part in (closed.A, closed.B, closed.C, closed.D))
    ends = [["in"], ["out"]] if p == 1 else [[f"{end}[{i}]" for i in range(p)] for end in ("in", "out")]
    return ct.StateSpace(
        *loop_gain(A, B[:, -p:], C[-p:], D[-p:, -p:], signals),
        closed.dt,
        states=closed.state_labels,
        inputs=ends[0],
        outputs=ends[1],
        remove_useless_states=False,
    )


def between(
    system: ct.InputOutputSystem,
    source: str | Sequence[str],
    target: str | Sequence[str],
    *,
    x0: ArrayLike | None = None,
    u0: ArrayLike | None = None,
    params: Mapping[str, ArrayLike] | None = None,
    t: float = 0.0,
) -> ct.StateSpace:
    """Linear model of a diagram from one of its signals to another, all loops closed; Bode plots take it as it is.

    Parameters
    ----------
    system : control.InterconnectedSystem
        Any diagram that :func:`flatten` takes.
    source : str or sequence of str
        Where d is added: an input of the diagram, or ``block.signal`` as for ``open_loop`` (an input of a block:
        for that input alone; an output: behind it, for all that read it). ``block.v`` is all of a vector.
    target : str or sequence of str
        What is read: an output of the diagram, or ``block.signal``. An input is read as the block receives it, with d;
        an output as the block puts it out, without. So the sensitivity S is from an input of a block to itself, and
        S - 1 from an output to itself.
    x0, u0, params, t
        Point of linearisation, as for :meth:`FlatModel.linearize`.

    Returns
    -------
    control.StateSpace
        One input for each source and one output for each target, with their names and "_" for ".".

    Raises
    ------
    TypeError
        If the system is no diagram.
    ValueError
        If there is no such signal (those there are are named) or one is given twice; and what :func:`flatten` and
        :meth:`FlatModel.linearize` raise.

    Notes
    -----
    A name that the diagram has too is the diagram's. Sampled blocks count as their continuous equivalents, as for
    ``open_loop``; :func:`phyfilter_ctl.linearize_sampled` counts hold and sampling.

    Examples
    --------
    >>> plant = ct.tf([1.0], [1.0, 1.0], inputs="u", outputs="y", name="plant")
    >>> control = ct.tf([3.0], [1.0], inputs="e", outputs="u", name="p")
    >>> loop = ct.interconnect([plant, control, ct.summing_junction(["r", "-y"], "e", name="error")],
    ...                        inputs="r", outputs="y")
    >>> disturbance = between(loop, "plant.u", "plant.y")
    >>> disturbance.poles().real.tolist(), float(disturbance.dcgain())
    ([-4.0], 0.25)
    >>> response = ct.frequency_response(between(loop, "r", ["plant.u", "plant.y"]), [1.0, 4.0, 10.0])
    >>> response.magnitude.shape
    (2, 1, 3)
    """
    diagram = _diagram(system)
    sources = signals_of(source, diagram, diagram.input_labels)
    targets = signals_of(target, diagram, diagram.output_labels)
    added = [name for name in sources if name not in diagram.input_labels]
    read = [name for name in targets if name not in diagram.output_labels]
    flat = flatten(probed(probed(diagram, added), read, received=True), unconnected="zero")
    closed = flat.linearize(x0, probed_inputs(system, u0, len(added) + len(read)), params, t)
    # Each probe has an input and an output, those of the targets last.
    columns = [[*diagram.input_labels, *added].index(name) for name in sources]
    rows = [[*diagram.output_labels, *("" for _ in added), *read].index(name) for name in targets]
    return ct.StateSpace(
        closed.A,
        np.asarray(closed.B)[:, columns],
        np.asarray(closed.C)[rows],
        np.asarray(closed.D)[np.ix_(rows, columns)],
        closed.dt,
        states=closed.state_labels,
        inputs=[name.replace(".", "_") for name in sources],
        outputs=[name.replace(".", "_") for name in targets],
        remove_useless_states=False,
    )


def signals_of(
    signal: str | Sequence[str], system: ct.InputOutputSystem, own: Sequence[str] = ()
) -> tuple[str, ...]:
    """One signal or several as a tuple, the elements in the place of a whole vector.

    Parameters
    ----------
    signal : str or sequence of str
    system : control.InputOutputSystem
        Whose signals they are.
    own : sequence of str
        Labels of the diagram itself that count, before those of its blocks.

    Raises
    ------
    TypeError
        If it is neither a name nor a sequence of them.
    ValueError
        If there is none, or one twice.
    """
    several = isinstance(signal, Sequence) and all(isinstance(each, str) for each in signal)
    if not several:
        raise TypeError(f"signal: expected 'block.signal', or several of them, got {signal!r}")
    names = (signal,) if isinstance(signal, str) else signal
    signals = tuple(each for name in names for each in _elements(system, name, own))
    if not signals or len(set(signals)) < len(signals):
        raise ValueError(f"signal: expected one or several different signals, got {signals}")
    return signals


def _elements(system: ct.InputOutputSystem, name: str, labels: Sequence[str] = ()) -> tuple[str, ...]:
    """The signals name[0], name[1], ... of a vector; the name alone where it is one signal, or none."""
    if name in labels:
        return (name,)
    if whole := [label for label in labels if re.fullmatch(re.escape(name) + r"\[[\d,]+\]", label)]:
        return tuple(dict.fromkeys(whole))
    for part in system.syslist if isinstance(system, ct.InterconnectedSystem) else ():
        if name.startswith(f"{part.name}."):
            rest = name[len(part.name) + 1 :]
            inner = _elements(part, rest, [*part.input_labels, *part.output_labels])
            if inner != (rest,):
                return tuple(f"{part.name}.{each}" for each in inner)
    return (name,)


def loop_gain(
    A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, signals: Sequence[str]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Matrices of L from those of T: L = -T (I + T)^-1, T from the inputs d of a :func:`probed` diagram to its r.

    Parameters
    ----------
    A, B, C, D : arrays
    signals : sequence of str
        Where it was probed, for messages.

    Raises
    ------
    ValueError
        If the diagram opened there has a singular algebraic loop.
    """
    through = np.eye(len(D)) + D
    if np.linalg.cond(through) > _SINGULAR:
        raise ValueError(
            f"{', '.join(signals)}: opened there, the diagram has a singular algebraic loop; open it elsewhere"
        )
    inverse = np.linalg.inv(through)
    return A - B @ inverse @ C, B @ inverse, -inverse @ C, inverse - np.eye(len(D))


def probed(
    system: ct.InputOutputSystem, signals: Sequence[str], *, received: bool = False
) -> ct.InterconnectedSystem:
    """A diagram with last inputs d that are added at signals and last outputs that read the signals before them.

    Parameters
    ----------
    system : control.InterconnectedSystem
    signals : sequence of str
        As for ``open_loop``.
    received : bool
        Read inputs of blocks as the blocks receive them, with all that is added there.

    Raises
    ------
    TypeError, ValueError
        If the system is no diagram, or has no such signal.
    """
    diagram = _diagram(system)
    for signal in signals:
        diagram = _probe(diagram, signal, signal, received)
    return diagram


def _diagram(system: ct.InputOutputSystem) -> ct.InterconnectedSystem:
    if not isinstance(system, ct.InterconnectedSystem):
        raise TypeError(
            f"system: expected a diagram made by control.interconnect, got {type(system).__name__}; a single block has "
            "no signals inside"
        )
    return system


def probed_inputs(system: ct.InputOutputSystem, u0: ArrayLike | None, count: int) -> FloatArray | None:
    """Inputs of the :func:`probed` diagram for those of the diagram, nothing added at the signals.

    Parameters
    ----------
    system : control.InterconnectedSystem
    u0 : (inputs,) array or None
    count : int
        Number of signals.

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
    return np.append(inputs, np.zeros(count))


def _probe(
    diagram: ct.InterconnectedSystem, place: str, signal: str, received: bool
) -> ct.InterconnectedSystem:
    """The diagram with a last input that is added at the place and a last output that reads the sum before it."""
    parts = list(diagram.syslist)
    index, kind, row = _find(diagram, place, signal)
    if kind == "inside":
        part = parts[index]
        assert isinstance(part, ct.InterconnectedSystem)
        parts[index] = _probe(part, place[len(part.name) + 1 :], signal, received)
    inputs, outputs = (
        np.cumsum([0, *(getattr(p, n) for p in diagram.syslist)]) for n in ("ninputs", "noutputs")
    )
    connect, entering, leaving = (
        np.asarray(part, dtype=float) for part in (diagram.connect_map, diagram.input_map, diagram.output_map)
    )
    add, read = np.zeros(len(connect)), np.zeros(connect.shape[1] + len(connect))
    if kind == "input":
        add[inputs[index] + row] = 1.0
        if received:
            read[connect.shape[1] + inputs[index] + row] = 1.0
        else:
            # Other inputs of the diagram that act there pass by: they are no part of the loop, nor of its linear model.
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
    again = str(sum(label.startswith(_CUT[0]) for label in diagram.input_labels) or "")
    cut = ct.InterconnectedSystem(
        parts,
        inputs=[*diagram.input_labels, _CUT[0] + again],
        outputs=[*diagram.output_labels, _CUT[1] + again],
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
