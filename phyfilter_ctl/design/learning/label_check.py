"""Whether a label can be the f of its flights.

Integrated from the start of a flight, label and M x' - g may differ by the noise of x at the two ends alone,

    D_k = int (label - f_theta - u) dt = noise of M x,

whatever the flight does and however noisy x is. So D grows with time where the label has another mean, and with the
integral of g where the label still holds g. What windows say of its unit, sign and channel, and whether g acts late, is
in ``recording.agreement``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...recording.agreement import (
    LagSums,
    WindowSums,
    label_factor_fault,
    lag_sums,
    late_g,
    late_text,
    window_sums,
)
from .residuals import Flight

# A mean below this share of the target's deviation is less than 1 % of its power: the fit hardly sees it.
_SIZABLE = 0.1
# Deviations of the noise at the ends: normal noise exceeds them once in 5e8.
_DEVIATIONS = 6.0
# How near D must be to the integral of g, by slope and by share of power. Noise of x, which does not grow, comes near
# neither unless g itself is as small as the noise.
_SLOPE, _POWER = 0.5, 0.9


class ChannelSums(NamedTuple):
    """What is needed of one channel of one flight, over the samples that count. D and the integral of g about their
    means."""

    duration: float
    end: float  # of D
    spread: float  # deviation of D about its straight line
    samples: int
    squares: float  # of the target about its mean
    g: tuple[int, float] | None  # number and squares
    products: tuple[float, float, float]  # D D, D int g, int g int g


class FlightSums(NamedTuple):
    """What is needed of one flight; empty of one that is too short to tell, or does not take part."""

    channels: tuple[ChannelSums, ...] = ()
    windows: tuple[WindowSums, ...] = ()
    lags: tuple[LagSums, ...] = ()
    step: float = 0.0


def label_sums(flight: Flight) -> FlightSums:
    """Of every channel of a flight."""
    if not flight.takes_part or flight.length - flight.first <= 2:
        return FlightSums()
    flight = flight.counted()
    u, label = flight.u[1:], 0.5 * (flight.target[1:] + flight.target[:-1])
    steps = None if flight.steps is None else flight.steps[1:]
    counts = np.ones(len(u), dtype=bool)
    if flight.sample_weights is not None:
        used = np.all(flight.sample_weights > 0.0, axis=1)
        counts = used[1:] & used[:-1]
    lags: tuple[LagSums, ...] = ()
    if flight.g is not None and counts.all():
        lags = lag_sums(u - label, flight.g[1:], flight.dt, steps)
    kept = None if steps is None else steps[counts]
    windows = window_sums(u[counts], label[counts], kept)
    return FlightSums(tuple(_sums(flight, j) for j in range(flight.u.shape[1])), windows, lags, flight.dt)


def label_faults(sums: Sequence[FlightSums], channels: Sequence[str], *, offset: bool = False) -> list[str]:
    """What is wrong with the labels and g of flights, in words, channel by channel; an empty list where nothing is.

    With ``offset`` they may be off by a constant a flight.
    """
    found = []
    windows, step = [own.windows for own in sums], max((own.step for own in sums), default=0.0)
    for j, name in enumerate(channels):
        parts = [own.channels[j] for own in sums if own.channels and own.channels[j].duration > 0.0]
        if not parts:
            continue
        fault = _held(parts, name) or label_factor_fault(windows, j, channels, step)
        if fault := fault or ("" if offset else _offset(parts, name)):
            found.append(fault)
        elif late := late_g([own.lags[j] for own in sums if own.lags], _deviation(parts)):
            found.append(late_text(late, name))
    return found


def _sums(flight: Flight, j: int) -> ChannelSums:
    """Integrals from the second sample on; the first label is not among the targets."""
    target, u = flight.target[:, j], flight.u[1:, j]
    steps = np.full(len(u), flight.dt) if flight.steps is None else flight.steps[1:]
    counts = np.ones(len(target), dtype=bool)
    if flight.sample_weights is not None:
        counts = flight.sample_weights[:, j] > 0.0
        steps = steps * (counts[1:] & counts[:-1])
    times, D = np.cumsum(steps), np.cumsum(steps * (0.5 * (target[1:] + target[:-1]) - u))
    duration, end, own = float(times[-1]), float(D[-1]), target[counts]
    spread = float(np.std(D - end / duration * times)) if duration > 0.0 else 0.0
    squares = float(np.sum((own - np.mean(own)) ** 2)) if len(own) else 0.0
    if flight.g is None:
        return ChannelSums(duration, end, spread, len(own), squares, None, (0.0, 0.0, 0.0))
    g = flight.g[:, j]
    integral = np.cumsum(steps * g[1:])
    d, integral = D - np.mean(D), integral - np.mean(integral)
    products = (float(d @ d), float(d @ integral), float(integral @ integral))
    known = (int(np.sum(counts)), float(np.sum(g[counts] ** 2)))
    return ChannelSums(duration, end, spread, len(own), squares, known, products)


def _held(parts: Sequence[ChannelSums], name: str) -> str | None:
    """Whether D is the integral of a g of some size, but for a constant a flight and little else."""
    known = [part.g for part in parts if part.g is not None]
    if len(known) < len(parts):
        return None
    size = float(np.sqrt(sum(squares for _, squares in known) / sum(count for count, _ in known)))
    if not size > _SIZABLE * _deviation(parts):
        return None
    all_of, both, own = np.sum([part.products for part in parts], axis=0)
    if abs(both - own) >= _SLOPE * own or both * both <= _POWER * own * all_of:
        return None
    return (
        f"the label of {name} differs from M x' - g by g (difference mean {_means(parts):.3g}, rms of g "
        f"{size:.3g}): it seems to hold g; give f = M x' - g, that is, take g off the label"
    )


def _offset(parts: Sequence[ChannelSums], name: str) -> str | None:
    """Whether the mean of D's slope is more than noise of x at the ends, and matters."""
    T = np.array([part.duration for part in parts])
    spread = np.array([part.spread for part in parts])
    noise = _DEVIATIONS * float(np.sqrt(np.sum(2.0 * spread**2 / T) / np.sum(T)))
    mean = _means(parts)
    if mean <= max(_SIZABLE * _deviation(parts), noise):
        return None
    without = "; g is missing: give it, unless it is 0" if all(part.g is None for part in parts) else ""
    return (
        f"the label of {name} differs from M x' - g by {mean:.3g} in the mean over a flight, where noise of x allows "
        f"{noise:.1g}{without}; check that it is f = M x' - g, in the same unit, its mean left in, "
        "or fit its mean out by label='offset'"
    )


def _means(parts: Sequence[ChannelSums]) -> float:
    """Root mean square, over the flights by their lengths, of the mean difference."""
    return float(np.sqrt(sum(p.end**2 / p.duration for p in parts) / sum(p.duration for p in parts)))


def _deviation(parts: Sequence[ChannelSums]) -> float:
    return float(np.sqrt(sum(part.squares for part in parts) / sum(part.samples for part in parts)))
