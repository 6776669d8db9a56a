"""Whether a label can be the f of its flights.

Integrated from the start of a flight, label and M x' - g may differ by the noise of x at the two ends alone,

    D_k = int (label - f_theta - u) dt = noise of M x,

whatever the flight does and however noisy x is. So D grows with time where the label has another mean, and with the
integral of g where the label still holds g.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..._sections import FloatArray
from .residuals import Flight

# A mean below this share of the target's deviation is less than 1 % of its power: the fit hardly sees it.
_SIZABLE = 0.1
# Deviations of the noise at the ends: normal noise exceeds them once in 5e8.
_DEVIATIONS = 6.0
# How near D must be to the integral of g, by slope and by share of power. Noise of x, which does not grow, comes near
# neither unless g itself is as small as the noise.
_SLOPE, _POWER = 0.5, 0.9


class _Channel(NamedTuple):
    """One channel of one flight, the samples that count."""

    times: FloatArray
    D: FloatArray
    target: FloatArray
    g: FloatArray | None
    integral: FloatArray | None  # of g


def label_faults(flights: Sequence[Flight], channels: Sequence[str], *, offset: bool = False) -> list[str]:
    """What is wrong with the labels, in words, channel by channel; an empty list where nothing is.

    With ``offset`` they may be off by a constant a flight.
    """
    taking = [flight for flight in flights if flight.takes_part and len(flight.u) > 2]
    found = []
    for j, name in enumerate(channels):
        parts = [part for flight in taking if (part := _channel(flight, j)).times[-1] > 0.0]
        if parts and (fault := _held(parts, name) or ("" if offset else _offset(parts, name))):
            found.append(fault)
    return found


def _channel(flight: Flight, j: int) -> _Channel:
    """Integrals from the second sample on; the first label is not among the targets."""
    target, u = flight.target[:, j], flight.u[1:, j]
    steps = np.full(len(u), flight.dt) if flight.steps is None else flight.steps[1:]
    counts = np.ones(len(target), dtype=bool)
    if flight.sample_weights is not None:
        counts = flight.sample_weights[:, j] > 0.0
        steps = steps * (counts[1:] & counts[:-1])
    D = np.cumsum(steps * (0.5 * (target[1:] + target[:-1]) - u))
    if flight.g is None:
        return _Channel(np.cumsum(steps), D, target[counts], None, None)
    g = flight.g[:, j]
    integral = np.cumsum(steps * 0.5 * (g[1:] + g[:-1]))
    return _Channel(np.cumsum(steps), D, target[counts], g[counts], integral)


def _held(parts: Sequence[_Channel], name: str) -> str | None:
    """Whether D is the integral of a g of some size, but for a constant a flight and little else."""
    known = [part.g for part in parts if part.g is not None]
    if len(known) < len(parts) or not _rms(known) > _SIZABLE * _deviation(parts):
        return None
    d = np.concatenate([part.D - np.mean(part.D) for part in parts])
    g = np.concatenate(
        [part.integral - np.mean(part.integral) for part in parts if part.integral is not None]
    )
    both, own = float(d @ g), float(g @ g)
    if abs(both - own) >= _SLOPE * own or both * both <= _POWER * own * float(d @ d):
        return None
    return (
        f"the label of {name} differs from M x' - g by g (difference mean {_means(parts):.3g}, rms of g "
        f"{_rms(known):.3g}): it seems to hold g; give f = M x' - g, that is, take g off the label"
    )


def _offset(parts: Sequence[_Channel], name: str) -> str | None:
    """Whether the mean of D's slope is more than noise of x at the ends, and matters."""
    T = np.array([part.times[-1] for part in parts])
    spread = np.array([np.std(part.D - part.D[-1] / part.times[-1] * part.times) for part in parts])
    noise = _DEVIATIONS * float(np.sqrt(np.sum(2.0 * spread**2 / T) / np.sum(T)))
    mean = _means(parts)
    if mean <= max(_SIZABLE * _deviation(parts), noise):
        return None
    without = "; g is missing: give it, unless it is 0" if all(part.g is None for part in parts) else ""
    return (
        f"the label of {name} differs from M x' - g by {mean:.3g} in the mean over a flight, where noise of x allows "
        f"{noise:.1g}{without}; check that it is f = M x' - g, in the same unit, its mean left in, "
        "or fit its mean out by label_offset=True"
    )


def _means(parts: Sequence[_Channel]) -> float:
    """Root mean square, over the flights by their lengths, of the mean difference."""
    return float(
        np.sqrt(sum(p.D[-1] ** 2 / p.times[-1] for p in parts) / sum(float(p.times[-1]) for p in parts))
    )


def _deviation(parts: Sequence[_Channel]) -> float:
    return _rms([part.target - np.mean(part.target) for part in parts])


def _rms(signals: Sequence[FloatArray]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(signals) ** 2)))
