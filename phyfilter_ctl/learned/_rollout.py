"""Rollouts of x' = g + f(x, u) over many segments at once, and their exact gradient.

Classical Runge-Kutta steps, all segments side by side; the gradient is the adjoint of those steps, so it belongs to
the sampled rollout and not to the differential equation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._sections import FloatArray
from .layers import Layers, flat

# Segments in one batch: the activations of all stages stay in a few MB.
_BATCH = 256
# Runge-Kutta: where a stage takes place (in half steps), how far it looks along the slope before, its weight.
_STAGES = ((0, 0.0, 1.0 / 6.0), (1, 0.5, 1.0 / 3.0), (1, 0.5, 1.0 / 3.0), (2, 1.0, 1.0 / 6.0))


@dataclass(frozen=True, eq=False)
class Segments:
    """Pieces of trajectories of equal length.

    Parameters
    ----------
    x : (B, S + 1, n_x) array
        Measured samples.
    g, u : (B, 2 S + 1, n_x), (B, 2 S + 1, n_u) arrays
        Known dynamics and inputs at the samples and half-way between them; of a held input the last entry of a step
        belongs to the next one, so ``held`` says whether to use the value at its start.
    dt : (B,) array
        Sampling times, s.
    """

    x: FloatArray
    g: FloatArray
    u: FloatArray
    dt: FloatArray
    held: tuple[bool, bool]

    def stage(self, i: int, half: int) -> tuple[FloatArray, FloatArray]:
        """g and u in step i, ``half`` half steps after its start."""
        g, u = (
            a[:, 2 * i + (0 if held else half)] for a, held in zip((self.g, self.u), self.held, strict=True)
        )
        return g, u

    def mean_f(self, first: int, last: int) -> FloatArray:
        """Mean of f between two samples as the motion shows it, (B, n_x)."""
        g = self.g[:, 2 * first : 2 * last + 1 : 2]
        known = g[:, :-1].mean(axis=1) + (
            0.0 if self.held[0] else 0.5 * (g[:, -1] - g[:, 0]) / (last - first)
        )
        return (self.x[:, last] - self.x[:, first]) / ((last - first) * self.dt[:, None]) - known

    def mean_z(self, first: int, last: int) -> FloatArray:
        """Mean of (x, u) over the same span, (B, n_x + n_u)."""
        x = 0.5 * (self.x[:, first:last] + self.x[:, first + 1 : last + 1]).mean(axis=1)
        u = self.u[:, 2 * first : 2 * last + 1 : 2]
        u = u[:, :-1] if self.held[1] else 0.5 * (u[:, :-1] + u[:, 1:])
        return np.hstack([x, u.mean(axis=1)])

    def rows(self, rows: slice) -> Segments:
        """Some of the segments."""
        return Segments(self.x[rows], self.g[rows], self.u[rows], self.dt[rows], self.held)


def misfit(
    layers: Layers, segments: Segments, starts: FloatArray, scale: FloatArray
) -> tuple[float, FloatArray, FloatArray]:
    """Half the sum of ((rollout - x) / scale)^2 over all segments and samples, and its gradients.

    Parameters
    ----------
    layers : Layers
        f(x, u).
    segments : Segments
        Data.
    starts : (B, n_x) array
        States at the start of the segments.
    scale : (n_x,) array
        Unit of the misfit in each channel.

    Returns
    -------
    value : float
    of_parameters : (n_parameters,) array
    of_starts : (B, n_x) array
    """
    value, of_parameters, of_starts = 0.0, np.zeros(len(layers.parameters)), np.empty_like(starts)
    for first in range(0, len(starts), _BATCH):
        rows = slice(first, first + _BATCH)
        part, gradient, of_starts[rows] = _batch(layers, segments.rows(rows), starts[rows], scale)
        value, of_parameters = value + part, of_parameters + gradient
    return value, of_parameters, of_starts


def ends(layers: Layers, segments: Segments, starts: FloatArray) -> FloatArray:
    """States (B, n_x) at the end of the segments."""
    x = np.empty_like(starts)
    for first in range(0, len(starts), _BATCH):
        rows = slice(first, first + _BATCH)
        part, state = segments.rows(rows), starts[rows]
        for i in range(part.x.shape[1] - 1):
            state, _ = _step(layers, part, i, state)
        x[rows] = state
    return x


def _batch(
    layers: Layers, segments: Segments, starts: FloatArray, scale: FloatArray
) -> tuple[float, FloatArray, FloatArray]:
    steps = segments.x.shape[1] - 1
    states, tapes = [starts], []
    for i in range(steps):
        state, tape = _step(layers, segments, i, states[-1])
        states.append(state)
        tapes.append(tape)
    errors = [(state - segments.x[:, i]) / scale for i, state in enumerate(states)]
    value = 0.5 * float(sum(np.sum(error**2) for error in errors))
    gradient = layers.no_gradient()
    costate = errors[-1] / scale
    for i in reversed(range(steps)):
        costate = _step_back(layers, segments, tapes[i], costate, gradient) + errors[i] / scale
    return value, flat(gradient), costate


def _step(
    layers: Layers, segments: Segments, i: int, x: FloatArray
) -> tuple[FloatArray, list[list[FloatArray]]]:
    """One Runge-Kutta step, with the activations of its stages."""
    h = segments.dt[:, None]
    slope, after, tape = np.zeros_like(x), x, []
    for half, reach, weight in _STAGES:
        g, u = segments.stage(i, half)
        f, activations = layers.forward(np.hstack([x + reach * h * slope, u]))
        slope = g + f
        after = after + weight * h * slope
        tape.append(activations)
    return after, tape


def _step_back(
    layers: Layers,
    segments: Segments,
    tape: list[list[FloatArray]],
    costate: FloatArray,
    gradient: list[tuple[FloatArray, FloatArray]],
) -> FloatArray:
    """Cotangent of the state before a step, from that after it; the gradients of the layers are added to."""
    h, n_x = segments.dt[:, None], costate.shape[1]
    before = costate
    passed = np.zeros_like(costate)  # to the slope, through the stage that looks along it
    for (_, reach, weight), activations in zip(reversed(_STAGES), reversed(tape), strict=True):
        of_slope = weight * h * costate + passed
        of_state = layers.backward(activations, of_slope, gradient)[:, :n_x]
        before = before + of_state
        passed = reach * h * of_state
    return before
