"""The learned differentiator: from the recent past of the velocity to the acceleration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from phyfilter_ctl.learned import Network, window
from phyfilter_ctl.recording import Recording
from phyfilter_ctl.results import Status

from .params import params

__all__ = [
    "LeastSquaresSlope",
    "Predictor",
    "WindowDifferentiator",
    "counted",
    "labels",
    "stride_of",
    "train",
]

FloatArray = NDArray[np.float64]


class Predictor(Protocol):
    """Anything that maps features (N, n_z) to accelerations (N, n_x), such as a fitted ``learned.Network``."""

    def predict(self, z: ArrayLike) -> FloatArray:
        """Accelerations (N, n_x) in m/s^2."""
        ...

    def casadi(self) -> ca.Function:
        """The same for one sample: z (n_z,) -> (n_x,)."""
        ...


@dataclass(frozen=True)
class WindowDifferentiator:
    """Acceleration from a window of past velocities, f_theta(v_k, v_{k-s}, ..., v_{k-(L-1)s}).

    Parameters
    ----------
    model : Predictor
        Takes the features of :meth:`features`.
    length : int
        Velocities L in the window, at least 2.
    stride : int
        Their spacing s in samples, at least 1.

    Raises
    ------
    ValueError
        If ``length`` is below 2 or ``stride`` below 1.

    Examples
    --------
    >>> slope = WindowDifferentiator(LeastSquaresSlope(3, 0.1), length=3, stride=1)
    >>> slope.predict([[0.0], [0.2], [0.4], [0.6]])[-1].round(12).tolist()
    [2.0]
    """

    model: Predictor
    length: int
    stride: int

    def __post_init__(self) -> None:
        if self.length < 2 or self.stride < 1:
            raise ValueError(
                f"expected length >= 2 and stride >= 1, got length {self.length} and stride {self.stride}"
            )

    @property
    def reach(self) -> int:
        """Samples before the present one that the window reaches back to."""
        return (self.length - 1) * self.stride

    def features(self, v: ArrayLike) -> FloatArray:
        """Features (N, L n_x) of the velocities v (N, n_x): the newest velocity, then the L - 1 steps back.

        A linear, invertible change of the window itself. Neighbouring velocities are nearly equal, and a network
        would first have to learn to subtract them.
        """
        v = np.asarray(v, dtype=float)
        past = window(v, self.length, stride=self.stride).reshape(len(v), self.length, -1)
        steps = past[:, :-1] - past[:, 1:]
        return np.concatenate([past[:, :1], steps], axis=1).reshape(len(v), -1)

    def predict(self, v: ArrayLike) -> FloatArray:
        """Acceleration (N, n_x) in m/s^2 from velocities v (N, n_x) in m/s; causal."""
        return self.model.predict(self.features(v))


@dataclass(frozen=True)
class LeastSquaresSlope:
    """Slope of the straight line through the window with least squares: a linear model that needs no training.

        f_theta = sum_j (c - j) v_{k-js} / (h sum_j (c - j)^2),    c = (L - 1) / 2,  h the spacing in seconds

    It weights the steps between the velocities, so it takes the features of :class:`WindowDifferentiator`.

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
    """

    length: int
    spacing: float

    def predict(self, z: ArrayLike) -> FloatArray:
        """Slope (N, n_x) of the features z (N, L n_x)."""
        z = np.asarray(z, dtype=float)
        steps = z.reshape(len(z), self.length, -1)[:, 1:]
        return np.einsum("j,kjc->kc", self._weights, steps)

    def casadi(self) -> ca.Function:
        """The same for one sample of three axes: z (3 L,) -> (3,)."""
        z = ca.SX.sym("z", 3 * self.length)
        steps = ca.reshape(z, 3, self.length)[:, 1:]
        return ca.Function("slope", [z], [steps @ ca.DM(self._weights)])

    @property
    def _weights(self) -> FloatArray:
        """Of the steps: v_{k-js} = v_k - (the first j steps), so that of a step is minus the sum of those beyond it."""
        centred = 0.5 * (self.length - 1) - np.arange(self.length)
        return np.cumsum(centred)[:-1] / (self.spacing * np.sum(centred**2))


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
) -> WindowDifferentiator:
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
    untrained = WindowDifferentiator(network, chosen.length, stride)
    rows = [slice(counted(log).start, None, every) for log in logs]
    z = np.concatenate([untrained.features(log.x)[pick] for log, pick in zip(logs, rows, strict=True)])
    f = np.concatenate([labels(log)[pick] for log, pick in zip(logs, rows, strict=True)])
    result = network.fit(z, f)
    if result.status is Status.FAILED:
        raise ValueError(f"training of the network failed: {result.message}")
    return WindowDifferentiator(result.model, chosen.length, stride)
