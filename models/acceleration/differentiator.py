"""The learned differentiator: from the recent past of the velocity to the acceleration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl import Status, learned_model
from phyfilter_ctl.learned import LearnedModel, Network, Windowed
from phyfilter_ctl.recording import Recording

from .params import params

__all__ = [
    "counted",
    "labels",
    "least_squares_slope",
    "stride_of",
    "train",
]

FloatArray = NDArray[np.float64]


def least_squares_slope(length: int, spacing: float) -> LearnedModel:
    """Slope of the straight line through the window with least squares: a linear model that needs no training.

        f_theta = sum_j (c - j) v_{k-js} / (h sum_j (c - j)^2),    c = (L - 1) / 2,  h the spacing in seconds

    It weights the steps between the velocities of three axes, which :class:`~phyfilter_ctl.learned.Windowed` gives it.

    Parameters
    ----------
    length : int
        Velocities L in the window.
    spacing : float
        Time between them in s.

    Notes
    -----
    A. Savitzky, M. J. E. Golay, "Smoothing and differentiation of data by simplified least squares procedures",
    Analytical Chemistry 36(8), 1964: first derivative, first degree.

    Examples
    --------
    >>> slope = Windowed(least_squares_slope(3, 0.1), 3)
    >>> slope.predict(np.outer([0.0, 0.2, 0.4, 0.6], [1.0, 0.0, -1.0]))[-1].round(12).tolist()
    [2.0, 0.0, -2.0]
    """
    centred = 0.5 * (length - 1) - np.arange(length)
    # v_{k-js} = v_k - (the first j steps), so the weight of a step is minus the sum of those beyond it.
    weights = np.cumsum(centred)[:-1] / (spacing * np.sum(centred**2))
    z = ca.SX.sym("z", 3 * length)
    steps = ca.reshape(z, 3, length)[:, 1:]
    return learned_model(ca.Function("slope", [z], [steps @ ca.DM(weights)]))


def stride_of(span: float, dt: float) -> int:
    """Stride in samples at which a window of the usual length lasts ``span`` seconds at sampling interval ``dt``.

    Examples
    --------
    >>> stride_of(0.07, 0.002), stride_of(0.07, 0.018)
    (5, 1)
    """
    return max(1, round(span / (dt * (params().network.length - 1))))


def counted(log: Recording) -> slice:
    """Samples of a flight that are trained on and scored: all but its start.

    Raises
    ------
    ValueError
        If the flight is too short for any.
    """
    left_out = params().scoring.left_out
    first = int(np.searchsorted(log.times, log.times[0] + left_out))
    if first >= log.n:
        raise ValueError(
            f"flight {log.name!r} lasts {log.duration:.3g} s, expected more than the {left_out:g} s left out at its "
            "start; drop it"
        )
    return slice(first, None)


def labels(log: Recording) -> FloatArray:
    """True acceleration (N, n_x) of a flight.

    Raises
    ------
    ValueError
        If it has none.
    """
    if log.label is None:
        raise ValueError(
            f"flight {log.name!r} has no true acceleration: expected the columns ax, ay, az (m/s^2) beside vx, vy, vz"
        )
    return log.label


def train(
    logs: Sequence[Recording], *, stride: int, seed: int, iterations: int, every: int = 1
) -> Windowed[Network]:
    """Train a network of two hidden layers to give the acceleration from a window of velocities.

    Parameters
    ----------
    logs : sequence of Recording
        Flights with labels.
    stride : int
        Spacing of the window's velocities in samples.
    seed : int
        Seed of the first weights.
    iterations : int
        Most iterations of L-BFGS.
    every : int
        Train on every so many-th sample only.

    Raises
    ------
    ValueError
        If a flight has no label or is too short, or the training failed.
    """
    chosen = params().network
    network = Network(hidden=(chosen.units, chosen.units), l2=chosen.l2, max_iterations=iterations, seed=seed)
    untrained = Windowed(network, chosen.length, stride)
    rows = [slice(counted(log).start, None, every) for log in logs]
    z = np.concatenate([untrained.features(log.x)[pick] for log, pick in zip(logs, rows, strict=True)])
    f = np.concatenate([labels(log)[pick] for log, pick in zip(logs, rows, strict=True)])
    result = network.fit(z, f)
    if result.status is Status.FAILED:
        raise ValueError(f"training of the network failed: {result.message}")
    return replace(untrained, model=result.model)
