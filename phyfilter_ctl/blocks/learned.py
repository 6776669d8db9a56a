"""A learned model of the unknown dynamics as a block."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from ..learned import LearnedModel
from ..learned.model import expect_model
from .function_block import FunctionBlock, symbols_like
from .functions import BlockFunctions, Variable

__all__ = ["learned_block"]


def learned_block(
    model: LearnedModel,
    *,
    name: str = "f_theta",
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
) -> FunctionBlock:
    """A learned model f_theta(z) as a static python-control block.

    Parameters
    ----------
    model : LearnedModel
        Fitted; from elsewhere by :func:`~phyfilter_ctl.learned_model`.
    name : str
        Name of the block.
    inputs, outputs : sequence of str, optional
        Labels of the features and of the prediction; None means z[0], z[1] ... and f_theta[0], f_theta[1] ..., the
        second as the filter blocks' input is called.

    Returns
    -------
    FunctionBlock
        Without states, linearised exactly; it goes into continuous and discrete diagrams.

    Raises
    ------
    TypeError
        For something that is not a learned model.
    ValueError
        For a model that has not been fitted, or another number of labels than it has features or outputs.

    Examples
    --------
    >>> import numpy as np
    >>> from phyfilter_ctl.learned import Chebyshev
    >>> v = np.linspace(-3.0, 3.0, 50)[:, None]
    >>> block = learned_block(Chebyshev(2, n_d=0).fit(v, -0.4 * v**2).model, inputs=["v"])
    >>> block(2.0).round(6).item(), block.linearize(u0=[2.0]).D.round(6).item()
    (-1.6, -1.6)
    """
    expect_model(model)
    function = model.casadi()
    symbols = symbols_like(function, (1, 0, function.numel_in(0), 0))
    functions = BlockFunctions(
        (),
        labelled("inputs", "z", inputs, function.numel_in(0)),
        labelled("outputs", "f_theta", outputs, function.numel_out(0)),
        (),
        ca.Function("dynamics", symbols, [ca.DM(0, 1)]),
        ca.Function("output", symbols, [function(symbols[2])]),
    )
    block = FunctionBlock(functions, name, None)
    block.symbol = "learned"
    return block


def labelled(what: str, letter: str, labels: Sequence[str] | None, count: int) -> tuple[Variable, ...]:
    """``count`` variables by their labels; None means the letter with an index."""
    names = [f"{letter}[{i}]" for i in range(count)] if labels is None else list(labels)
    if len(names) != count:
        raise ValueError(f"{what}: expected {count} labels, got {len(names)}: {names}")
    return tuple(Variable(label) for label in names)
