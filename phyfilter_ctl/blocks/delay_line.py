"""A delay of whole samples, as a sampled block."""

from __future__ import annotations

import operator
from collections.abc import Sequence

import casadi as ca
from numpy.typing import ArrayLike

from .. import _signals
from .functions import BlockFunctions, Variable
from .sampled import SampledBlock, sampled_block

__all__ = ["delay_line"]


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
    inputs = _labels("signals", signals)
    if isinstance(outputs, str):
        outputs = [_suffixed(label, outputs) for label in inputs]
    results = _labels("outputs", outputs)
    if len(results) != len(inputs):
        raise ValueError(f"outputs: expected {len(inputs)} labels, one for each signal, got {len(results)}")
    try:
        count = operator.index(steps)
    except TypeError as error:
        raise TypeError(
            f"steps: expected a whole number of samples, got {steps!r}; a time is round(time / dt) samples"
        ) from error
    if count < 0:
        raise ValueError(f"steps: expected 0 samples or more, got {count}")
    starts = _signals.filled("start", start, (len(inputs),)).tolist()
    return sampled_block(_law(inputs, results, count, starts, unit), dt=dt, name=name)


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
