"""What needs no network: filters learned from labels alone, a least-squares FIR, and a network for what they leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import lfilter

from phyfilter_ctl import stack
from phyfilter_ctl.design.learning import learn
from phyfilter_ctl.filter import FilterBank, PhyFilter
from phyfilter_ctl.recording import Recording

from .differentiator import WindowDifferentiator, counted, labels, train
from .params import params
from .tuning import Case, filtered

__all__ = ["Linear", "SlopeFIR", "fit_linear", "kept_error"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SlopeFIR:
    """Acceleration as a weighted sum of the last differences of the velocity, one response for all axes.

        a_k = sum_j c_j (v_(k-j) - v_(k-j-1)) / h

    Parameters
    ----------
    taps : (L,) array

    Examples
    --------
    >>> SlopeFIR(np.array([0.5, 0.5])).estimate([[0.0], [0.1], [0.3]], 0.1).ravel().round(6).tolist()
    [0.0, 0.5, 1.5]
    """

    taps: FloatArray

    @classmethod
    def fit(cls, logs: Sequence[Recording], length: int) -> SlopeFIR:
        """Of least squared error over all samples that count, all axes and flights."""
        gram, right = np.zeros((length, length)), np.zeros(length)
        for log in logs:
            kept = counted(log)
            past = _past(log.x, log.dt, length)[kept].reshape(-1, length)
            gram += past.T @ past
            right += past.T @ labels(log)[kept].ravel()
        return cls(np.asarray(np.linalg.solve(gram, right), dtype=float))

    def estimate(self, v: ArrayLike, dt: float) -> FloatArray:
        """Acceleration (N, n_x) of v (N, n_x) sampled every ``dt`` seconds."""
        rise = np.diff(np.asarray(v, dtype=float), axis=0, prepend=np.asarray(v, dtype=float)[:1]) / dt
        return np.asarray(lfilter(self.taps, [1.0], rise, axis=0))


def kept_error(estimate: FloatArray, log: Recording) -> FloatArray:
    """Error of the samples that count."""
    return (estimate - labels(log))[counted(log)]


def _past(v: FloatArray, dt: float, length: int) -> FloatArray:
    """(N, n_x, L): the difference of each sample and those before it."""
    rise = np.diff(v, axis=0, prepend=v[:1]) / dt
    padded = np.concatenate([np.zeros((length - 1, v.shape[1])), rise])
    return np.lib.stride_tricks.sliding_window_view(padded, length, axis=0)[:, :, ::-1]


@dataclass(frozen=True)
class Linear:
    """Fitted to the training flights, f_theta = 0 but for the network.

    Attributes
    ----------
    shared : PhyFilter
        Learned: one filter for all axes.
    axes : FilterBank
        Learned: one filter each.
    fir : SlopeFIR
    after : WindowDifferentiator
        A network for what ``shared`` leaves.
    """

    shared: PhyFilter
    axes: FilterBank
    fir: SlopeFIR
    after: WindowDifferentiator

    def estimates(self, logs: Sequence[Recording], dt: float) -> dict[str, list[FloatArray]]:
        """Acceleration (N, n_x) of each flight, by method."""
        shared = _estimates(self.shared, logs, dt)
        return {
            "learned": shared,
            "learned_axes": _estimates(self.axes, logs, dt),
            "fir": [self.fir.estimate(log.x, log.dt) for log in logs],
            "network_after": [y + self.after.predict(log.x) for y, log in zip(shared, logs, strict=True)],
        }


def _estimates(filter: PhyFilter | FilterBank, logs: Sequence[Recording], dt: float) -> list[FloatArray]:
    return filtered(filter, [Case(log, np.zeros_like(log.x)) for log in logs], dt)


def fit_linear(logs: Sequence[Recording], dt: float, *, stride: int, seed: int, iterations: int) -> Linear:
    """Fit all of them; ``stride``, ``seed`` and ``iterations`` are those of the network.

    Parameters
    ----------
    logs : sequence of Recording
        Training flights with labels.
    dt : float
        Nominal sampling interval, s.
    """
    chosen = params().linear
    bare = [log.with_signals(f_theta=None) for log in logs]
    weights = [np.where(np.arange(log.n) < counted(log).start, 0.0, 1.0) for log in bare]
    learned = [
        learn(
            bare, chosen.order, form="general", weights=weights, channels=channels, wiener=False, starts=2
        ).filter
        for channels in (None, *([i] for i in range(bare[0].n_x)))
    ]
    left = [
        log.with_signals(label=labels(log) - y)
        for log, y in zip(bare, _estimates(learned[0], bare, dt), strict=True)
    ]
    after = train(left, stride=stride, seed=seed, iterations=iterations)
    return Linear(learned[0], stack(learned[1:]), SlopeFIR.fit(bare, chosen.taps), after)
