"""The closed loop in time: after steps of the command and of the residual, and after one wrong sample of x.

At the samples, with everything in units of M_hat and mu = M_hat/M,

    x'_k = mu (what the held command did over the step + f),      u_k = x'_k + (nu_k - nu_(k-1))/h - v_(k-1),
    w_k = w_(k-1) + dA (w_(k-1) - w_e u_k),      v_k = tau_0 - C w_k,

x'_k the mean over the step that ends at k, v the command, nu the noise of x; actuator, hold and delay exact.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from .._sections import FloatArray
from ..analysis.margins.sampled import SampledLoop
from ..filter import SampledPhyFilter
from ..results import plain
from .designs import Design
from .loops import margin_of
from .steps import settling_time

__all__ = ["loop_responses", "simulate"]

_MOST_SAMPLES = 1500
_LONGEST_DELAY = 400.0  # steps
_SETTLINGS, _DECAYS = 1.5, 5.0  # that are drawn, of F and of the slowest pole of the loop
_MOST_SETTLINGS = 6.0
_LARGEST = 1e9  # of what is drawn; an unstable loop ends there


def loop_responses(design: Design, members: Sequence[Design]) -> dict[str, object]:
    """Responses of the design's closed loop, and least and largest ones over its variations.

    Parameters
    ----------
    design : Design
    members : sequence of Design
        Of the same filter.

    Returns
    -------
    dict
        t, command, disturbance, noise, noise_sd, dt, message.
    """
    end, message = _duration(design), ""
    dt = design.dt
    if end > _MOST_SAMPLES * dt:
        dt = end / _MOST_SAMPLES
        message = (
            f"Drawn for a loop sampled every {1e3 * dt:.4g} ms: the response takes too many steps of yours. "
        )
    designs = [replace(each, dt=dt) for each in (design, *members)]
    late = max(each.assume.delay for each in designs) / dt
    try:
        sampled = design.sampled_at(dt)
    except ValueError:
        return _nothing("The sampled filter is unstable: the loop with it is not drawn.")
    if late > _LONGEST_DELAY:
        return _nothing(f"A delay of {late:.4g} steps is too long to draw: sample slower, or assume less.")
    count = max(math.ceil(end / dt), 8)
    values = simulate(sampled, designs, count)
    with np.errstate(over="ignore", invalid="ignore"):
        values[~(np.abs(values) <= _LARGEST)] = np.nan
        noise = values[:, 2] * design.assume.noise
        sd = design.assume.noise * math.sqrt(float(np.sum(values[0, 2] ** 2)))
    curves = (values[:, 0], values[:, 1], noise)
    found: dict[str, object] = {"t": (dt * np.arange(1, count + 1)).tolist(), "dt": dt, "noise_sd": plain(sd)}
    for key, each in zip(("command", "disturbance", "noise"), curves, strict=True):
        found[key] = {"value": plain(each[0])}
        if members:
            found[key] = {
                "value": plain(each[0]),
                "low": plain(each.min(axis=0)),
                "high": plain(each.max(axis=0)),
            }
    if members:
        message += f"Band: {len(members)} loops on a grid over the assumed ranges."
    return found | {"message": message.strip()}


def _nothing(message: str) -> dict[str, object]:
    empty: dict[str, object] = {key: {"value": []} for key in ("command", "disturbance", "noise")}
    return {"t": [], "dt": None, "noise_sd": None, **empty, "message": message}


def _duration(design: Design) -> float:
    """Time in s in which F, and the loop as far as it decays, come to rest."""
    settling = settling_time(design.filter)
    if not settling > 0.0:  # also nan
        settling = 4.0 / float(np.min(-design.filter.poles.real))
    least = _SETTLINGS * settling + 4.0 * (design.assume.lag + design.assume.delay)
    try:
        sampled = design.sampled
        if design.assume.delay > 50.0 * design.dt:
            return least
        z = margin_of(design, sampled).loop.roots(design.assume.ratio)
    except (ValueError, np.linalg.LinAlgError):
        return least
    radius = float(np.max(np.abs(z))) if z is not None and len(z) else 0.0
    decay = -math.log(radius) / design.dt if 0.0 < radius < 1.0 else 0.0
    return max(least, min(_DECAYS / decay, _MOST_SETTLINGS * least) if decay > 0.0 else least)


def simulate(sampled: SampledPhyFilter, designs: Sequence[Design], count: int) -> FloatArray:
    """M_hat x' after a unit step of tau_0, M x' after one of f, and the command after x_0 alone was off by 1.

    Parameters
    ----------
    sampled : SampledPhyFilter
        The filter of all the loops, at their step.
    designs : sequence of Design, length K
        Give ratio, lag and delay.
    count : int

    Returns
    -------
    (K, 3, count) array
        x' as means over the steps that end at the samples h, 2 h, ...; the command at the samples 0, h, ....
    """
    h = sampled.dt
    dA, equilibrium, C = sampled.transition
    drive = dA @ equilibrium
    mu = np.array([each.assume.ratio for each in designs])[:, None]
    kept, moved, newer, older, whole = (
        np.array(each) for each in zip(*map(_plant(sampled), designs), strict=True)
    )
    K = len(designs)
    rows, late = np.arange(K), int(whole.max()) + 2
    sent = np.zeros((count + late + 1, K, 3))  # the command at sample k is at k + late
    act, w = np.zeros((K, 3)), np.zeros((K, 3, len(dA)))
    noise = np.array([0.0, 0.0, 1.0 / h])
    w -= noise[None, :, None] * drive  # x_0 is off: u_0 = nu_0/h
    sent[late] = np.array([1.0, 0.0, 0.0]) - w @ C
    residual = np.array([0.0, 1.0, 0.0])
    values = np.empty((count, K, 3))
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(count):
            new, old = sent[k + late - whole, rows], sent[k + late - whole - 1, rows]
            change = moved[:, None] * act + newer[:, 1:] * new + older[:, 1:] * old
            act = (1.0 + kept[:, None]) * act + newer[:, :1] * new + older[:, :1] * old
            rate = mu * (change / h + residual)
            u = rate - sent[k + late] - (noise if k == 0 else 0.0)
            w = w + w @ dA.T - u[:, :, None] * drive
            sent[k + late + 1] = np.array([1.0, 0.0, 0.0]) - w @ C
            values[k] = rate
    values[:, :, 1] /= mu[:, 0]
    values[:, :, 2] = sent[late : late + count, :, 2]
    return np.ascontiguousarray(values.transpose(1, 2, 0))


def _plant(
    sampled: SampledPhyFilter,
) -> Callable[[Design], tuple[float, float, FloatArray, FloatArray, int]]:
    """Of a design: what the lag keeps of its state over a step less 1, what of the state moves x, what of the newer
    and the older command goes to the state and to x, and the whole steps of delay."""

    def of(design: Design) -> tuple[float, float, FloatArray, FloatArray, int]:
        loop = margin_of(design, sampled, exact=True).loop
        assert isinstance(loop, SampledLoop)
        transition, newer, older, whole = loop.plant
        m = len(transition) - 2
        if m == 0:
            return 0.0, 0.0, np.array([0.0, newer[0]]), np.array([0.0, older[0]]), whole
        return float(transition[0, 0]), float(transition[1, 0]), newer[:2], older[:2], whole

    return of
