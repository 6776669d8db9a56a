"""Nonlinear recursions over many samples, run by CasADi's virtual machine.

A step (state, sample, parameters) -> state written once as an expression is chained over a block of samples;
the block is called again and again with the state it ended in.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from .._sections import FloatArray

# Samples in a block. Longer blocks run no faster and are slower to build: 28,000 x 3 samples take 38 ms at 64,
# 24 ms at 512, and 23 ms at 28,000, where building takes 0.1 s instead of 1 ms.
BLOCK = 512


def blocked(name: str, state: ca.SX, v: ca.SX, parameters: ca.SX, following: ca.SX) -> ca.Function:
    """Chain the step ``state -> following`` over BLOCK samples."""
    step = ca.Function(name, [state, v, parameters], [following])
    return step.mapaccum(f"{name}_block", BLOCK)


def run(
    block: ca.Function, state: FloatArray, v: FloatArray, parameters: FloatArray, advice: str
) -> FloatArray:
    """States after every sample, shape (N, n_state).

    Raises
    ------
    FloatingPointError
        If a state leaves the range of floating-point numbers; ``advice`` says what to try.
    """
    shared = np.repeat(parameters[:, None], BLOCK, axis=1)
    states = np.empty((len(v), len(state)))
    for first in range(0, len(v), BLOCK):
        here = v[first : first + BLOCK]
        filled = np.pad(here, ((0, BLOCK - len(here)), (0, 0)), mode="edge")
        after = block(state, filled.T, shared).full()
        states[first : first + len(here)] = after.T[: len(here)]
        state = after[:, -1]
    finite = np.isfinite(states).all(axis=1)
    if not finite.all():
        raise FloatingPointError(
            f"the recursion diverged at sample {int(np.argmin(finite))} of {len(v)}; {advice}"
        )
    return states
