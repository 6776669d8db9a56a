"""Delays as blocks: of whole samples, and of seconds."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from fractions import Fraction

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .continuous import pade
from .function_block import FunctionBlock
from .functions import BlockFunctions, Variable
from .sampled import SampledBlock, sampled_block

__all__ = ["delay_line", "transport_delay"]

# A delay of p/q periods runs q times a period: at most so many.
_FINEST = 100
# Up to this share of a period a delay is such a fraction: a few roundings of delay and dt.
_SAME = 1e-9


def delay_line(
    signals: Sequence[str],
    steps: int,
    dt: float,
    *,
    name: str = "delay_line",
    outputs: Sequence[str] | str = "_delayed",
    start: ArrayLike = 0.0,
    unit: str = "",
) -> SampledBlock:
    """Signals as they were a whole number of samples ago: y_k = u_(k - steps).

    Parameters
    ----------
    signals : sequence of str
        Labels of the n inputs, such as ``thrust[0]``.
    steps : int
        Number of samples, 0 or more; with 0 the block passes its inputs on and holds them.
    dt : float
        Sampling interval in seconds.
    name : str
        Name of the block.
    outputs : sequence of str or str
        Labels of the outputs; or what follows the name, in front of an index: ``thrust_delayed[0]``.
    start : number or (n,) array
        What comes out until the first sample has come through; also the default of the inputs.
    unit : str
        SI unit of the signals.

    Returns
    -------
    SampledBlock
        States past[i,j], what signal i puts out j samples from now.

    Raises
    ------
    ValueError
        For no signals, labels that repeat, a number of steps below 0, an interval that is not positive, or numbers of
        outputs or starts that are not those of the signals.
    TypeError
        For steps that are no whole number.

    Notes
    -----
    Only the present sample acts without delay on an output, and that with ``steps=0`` only, so a delay line breaks an
    algebraic loop among sampled blocks. Linearised in a diagram it is a chain of ``steps`` lags of dt each: the right
    delay, its phase at omega off by the factor 1 - (omega dt)^2/3.

    Examples
    --------
    >>> line = delay_line(["thrust[0]"], 5, 0.002)
    >>> line.output_labels, [state.name for state in line.law.states][:2]
    (['thrust_delayed[0]'], ['past[0,0]', 'past[0,1]'])
    """
    inputs, results = _ends(signals, outputs)
    try:
        count = operator.index(steps)
    except TypeError as error:
        raise TypeError(
            f"steps: expected a whole number of samples, got {steps!r}; a time is round(time / dt) samples"
        ) from error
    if count < 0:
        raise ValueError(f"steps: expected 0 samples or more, got {count}")
    starts = _signals.filled("start", start, (len(inputs),)).tolist()
    block = sampled_block(_law(inputs, results, count, starts, unit), dt=dt, name=name)
    block.symbol = f"delay\nz^−{count}" if count else ""
    return block


def transport_delay(
    signals: Sequence[str],
    delay: float,
    dt: float | None = None,
    *,
    order: int = 5,
    numdeg: int | None = None,
    name: str = "delay",
    outputs: Sequence[str] | str = "_delayed",
    start: ArrayLike = 0.0,
    unit: str = "",
) -> SampledBlock | FunctionBlock:
    """Signals as they were some seconds ago: y(t) = u(t - delay), exact for sampled signals.

    Parameters
    ----------
    signals : sequence of str
        Labels of the n inputs, such as ``command[0]``.
    delay : float
        Seconds, 0 or more.
    dt : float, optional
        Sampling interval in seconds of blocks that put the signals out or read them delayed. The delay is then exact, a
        fraction of dt too: of p/q periods it is a delay line of p samples that runs every dt/q seconds. None: the
        signals are continuous, and the delay is a Pade approximant.
    order, numdeg : int
        Without dt, degrees of the approximant's denominator and numerator, as for ``control.pade``. None: the same.
    name : str
        Name of the block.
    outputs : sequence of str or str
        Labels of the outputs; or what follows the name, in front of an index: ``command_delayed[0]``.
    start : number or (n,) array
        What the signals were before the start; also the default of the inputs.
    unit : str
        SI unit of the signals.

    Returns
    -------
    SampledBlock or FunctionBlock
        With dt a :func:`delay_line`; else a continuous block, linear, with ``order`` states a signal.

    Raises
    ------
    ValueError
        For a negative delay, a dt that is not positive, a delay that is no fraction of dt with a denominator up to 100,
        or degrees that do not fit; and as for :func:`delay_line`.
    TypeError
        For degrees that are no whole numbers.

    Notes
    -----
    With dt, exact means: held signals that change at multiples of dt (outputs of sampled blocks) act delayed to the
    digit; of a continuous signal, what sampled blocks read of it at multiples of dt is. Where a continuous signal goes
    on to a continuous block, the output is a staircase of steps of dt/q, off by what u does in that time.

    Pade of order n, both degrees alike: the gain is 1 at all frequencies; the phase is right to 1 degree up to
    omega delay = 0.6, 1.7, 3.0, 4.5 and 6.1 for n = 1 ... 5. It passes a part of the input on at once, (-1)^n u, so a
    step begins with a jump and an algebraic loop stays one; with ``numdeg = order - 1`` nothing passes at once, and the
    gain is right to 1 % up to 0.1, 0.9, 2.1, 3.5 and 5.0.

    Examples
    --------
    A command that a computer puts out 4 ms after the sample, every 10 ms:

    >>> computer = transport_delay(["command"], 0.004, 0.01, outputs=["torque"], unit="N m")
    >>> computer.period, len(computer.law.states)
    (0.002, 2)
    >>> pipe = transport_delay(["flow"], 1.5, order=3)
    >>> pipe.output_labels, pipe.nstates
    (['flow_delayed'], 3)
    """
    seconds = _signals.number("delay", delay, "s", least=0.0)
    inputs, results = _ends(signals, outputs)
    if dt is not None:
        steps, period = _fine_steps(seconds, _signals.duration("dt", dt))
        return delay_line(inputs, steps, period, name=name, outputs=results, start=start, unit=unit)
    n, m = _degrees(order, numdeg)
    before = _signals.filled("start", start, (len(inputs),))
    functions = _continuous(inputs, results, seconds, (n, m), before, unit)
    block = FunctionBlock(functions, name, 0.0 if functions.states else None)
    block.symbol = f"delay\ne^−{seconds:g}s"
    return block


def _fine_steps(delay: float, dt: float) -> tuple[int, float]:
    """How many samples of which length the delay has."""
    ratio = delay / dt
    found = Fraction(ratio).limit_denominator(_FINEST)
    if abs(float(found) - ratio) > _SAME:
        near = Fraction(ratio).limit_denominator(10)
        raise ValueError(
            f"delay: {delay:g} s is {ratio:g} periods of {dt:g} s, no fraction with a denominator up to {_FINEST}; "
            f"expected one such as {near} of a period, {float(near) * dt:g} s, or dt=None for a Pade approximant"
        )
    return found.numerator, dt / found.denominator


def _degrees(order: int, numdeg: int | None) -> tuple[int, int]:
    found = []
    for label, given, least in (("order", order, 1), ("numdeg", order if numdeg is None else numdeg, 0)):
        try:
            found.append(operator.index(given))
        except TypeError as error:
            raise TypeError(f"{label}: expected a whole number, got {given!r}") from error
        if found[-1] < least or found[-1] > found[0]:
            raise ValueError(f"{label}: expected {least} or more, and numdeg at most order, got {given}")
    return found[0], found[1]


def _continuous(
    inputs: Sequence[str],
    outputs: Sequence[str],
    delay: float,
    degrees: tuple[int, int],
    start: np.ndarray,
    unit: str,
) -> BlockFunctions:
    count, n = len(inputs), degrees[0] if delay else 0
    rest = np.zeros(0)
    A, B, C, D = (np.zeros(shape) for shape in ((0, 0), (0, count), (count, 0), (count, count)))
    if delay:
        system = pade(delay, count, *degrees)
        A, B, C, D = (np.asarray(part, dtype=float) for part in (system.A, system.B, system.C, system.D))
        rest = -np.linalg.solve(A, B @ start)
    else:
        D = np.eye(count)
    t, x, u, p = ca.SX.sym("t"), ca.SX.sym("x", n * count), ca.SX.sym("u", count), ca.SX.sym("p", 0)
    A, B, C, D = (ca.sparsify(ca.DM(part)) for part in (A, B, C, D))
    states = [f"{outputs[i]} to come, state {j}" for i in range(count) for j in range(n)]
    return BlockFunctions(
        tuple(Variable(f"lag[{k // n},{k % n}]", float(rest[k]), "", text) for k, text in enumerate(states)),
        tuple(Variable(label, float(value), unit) for label, value in zip(inputs, start, strict=True)),
        tuple(Variable(label, 0.0, unit) for label in outputs),
        (),
        ca.Function("dynamics", [t, x, u, p], [ca.densify(ca.mtimes(A, x) + ca.mtimes(B, u))]),
        ca.Function("output", [t, x, u, p], [ca.densify(ca.mtimes(C, x) + ca.mtimes(D, u))]),
    )


def _ends(signals: Sequence[str], outputs: Sequence[str] | str) -> tuple[list[str], list[str]]:
    """Labels of inputs and outputs."""
    inputs = _labels("signals", signals)
    if isinstance(outputs, str):
        outputs = [_suffixed(label, outputs) for label in inputs]
    results = _labels("outputs", outputs)
    if len(results) != len(inputs):
        raise ValueError(f"outputs: expected {len(inputs)} labels, one for each signal, got {len(results)}")
    return inputs, results


def _law(
    inputs: Sequence[str], outputs: Sequence[str], steps: int, starts: Sequence[float], unit: str
) -> BlockFunctions:
    n = len(inputs)
    states = tuple(
        Variable(f"past[{i},{j}]", starts[i], unit, f"{outputs[i]} in {j} samples")
        for i in range(n)
        for j in range(steps)
    )
    t, past, u, p = ca.SX.sym("t"), ca.SX.sym("past", len(states)), ca.SX.sym("u", n), ca.SX.sym("p", 0)
    # One row for each signal, with the present sample behind the past ones.
    rows = ca.horzcat(ca.reshape(past, steps, n).T, u)
    following = ca.reshape(rows[:, 1:].T, n * steps, 1)
    return BlockFunctions(
        states,
        tuple(Variable(label, value, unit) for label, value in zip(inputs, starts, strict=True)),
        tuple(Variable(label, 0.0, unit) for label in outputs),
        (),
        ca.Function("dynamics", [t, past, u, p], [following]),
        ca.Function("output", [t, past, u, p], [rows[:, 0]]),
    )


def _labels(kind: str, labels: Sequence[str]) -> list[str]:
    given = [labels] if isinstance(labels, str) else list(labels)
    if isinstance(labels, str) or not given or not all(isinstance(label, str) and label for label in given):
        raise ValueError(f"{kind}: expected a sequence of labels such as ['u[0]', 'u[1]'], got {labels!r}")
    repeated = sorted({label for label in given if given.count(label) > 1})
    if repeated:
        raise ValueError(f"{kind}: expected labels that differ, got {', '.join(repeated)} more than once")
    return given


def _suffixed(label: str, suffix: str) -> str:
    stem, bracket, index = label.partition("[")
    return stem + suffix + bracket + index
