"""What needs no network: filters learned from labels alone, a least-squares FIR, and a network for what they leave."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from phyfilter_ctl import Search, stack
from phyfilter_ctl.design import LearnResult, learn
from phyfilter_ctl.filter import FilterBank, PhyFilter
from phyfilter_ctl.learned import Network, Windowed
from phyfilter_ctl.recording import Recording, split

from .differentiator import counted, labels, train
from .params import params
from .tuning import Case, filtered, rmse

__all__ = ["Linear", "SlopeFIR", "fit_linear"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SlopeFIR:
    """Acceleration as a weighted sum of the last slopes of the velocity.

        a_k = sum_j c_j (v_(k-j) - v_(k-j-1)) / (t_(k-j) - t_(k-j-1))

    Parameters
    ----------
    taps : (n_x, L) array, or (1, L) where one response serves all axes

    Examples
    --------
    >>> log = Recording.from_arrays(x=[[0.0], [0.1], [0.3]], dt=0.1)
    >>> SlopeFIR(np.array([[0.5, 0.5]])).estimate(log).ravel().round(6).tolist()
    [0.0, 0.5, 1.5]
    """

    taps: FloatArray

    @property
    def length(self) -> int:
        """L."""
        return self.taps.shape[1]

    @classmethod
    def fit(cls, logs: Sequence[Recording], length: int, *, by_axis: bool = False) -> SlopeFIR:
        """Of least squared error over all samples that count and all flights."""
        n_x = logs[0].n_x
        gram, right = np.zeros((n_x, length, length)), np.zeros((n_x, length, 1))
        for log in logs:
            kept = counted(log)
            past = _past(log, length)[kept].transpose(1, 2, 0)
            gram += past @ past.transpose(0, 2, 1)
            right += past @ labels(log)[kept].T[:, :, None]
        if not by_axis:
            gram, right = gram.sum(axis=0, keepdims=True), right.sum(axis=0, keepdims=True)
        return cls(np.asarray(np.linalg.solve(gram, right)[:, :, 0], dtype=float))

    @classmethod
    def chosen(cls, logs: Sequence[Recording], lengths: Sequence[int], *, by_axis: bool = False) -> SlopeFIR:
        """Of the length that errs least on the faster flights, fitted to the slower ones; then fitted to all."""
        slower, faster = split(logs, fraction=params().filter.slower)
        errors = {
            length: rmse([fir.estimate(log) for log in faster], faster)
            for length in lengths
            for fir in [cls.fit(slower, length, by_axis=by_axis)]
        }
        return cls.fit(logs, min(errors, key=lambda length: errors[length]), by_axis=by_axis)

    def estimate(self, log: Recording) -> FloatArray:
        """Acceleration (N, n_x) of a flight's velocity, at its own times."""
        taps = np.broadcast_to(self.taps, (log.n_x, self.length))
        slopes = _slopes(log)
        return np.stack([lfilter(taps[i], [1.0], slopes[:, i]) for i in range(log.n_x)], axis=1)


def _slopes(log: Recording) -> FloatArray:
    """(N, n_x): between each sample and the one before, 0 at the first."""
    rise = np.diff(log.x, axis=0) / np.diff(log.times)[:, None]
    return np.concatenate([np.zeros((1, log.n_x)), rise])


def _past(log: Recording, length: int) -> FloatArray:
    """(N, n_x, L): the slope at each sample and those before it."""
    padded = np.concatenate([np.zeros((length - 1, log.n_x)), _slopes(log)])
    return np.lib.stride_tricks.sliding_window_view(padded, length, axis=0)[:, :, ::-1]


@dataclass(frozen=True)
class Linear:
    """Fitted to the training flights, f_theta = 0 but for the network.

    Attributes
    ----------
    result : LearnResult
        One filter for all axes, of the order that cross-validation chooses.
    axes : FilterBank
        One filter each, of the same order.
    fir, fir_axes : SlopeFIR
    after : Windowed
        A network for what the shared filter leaves.
    """

    result: LearnResult
    axes: FilterBank
    fir: SlopeFIR
    fir_axes: SlopeFIR
    after: Windowed[Network]

    def estimates(self, logs: Sequence[Recording], dt: float) -> dict[str, list[FloatArray]]:
        """Acceleration (N, n_x) of each flight, by method."""
        shared = _estimates(self.result.filter, logs, dt)
        return {
            "learned": shared,
            "learned_axes": _estimates(self.axes, logs, dt),
            "fir": [self.fir.estimate(log) for log in logs],
            "fir_axes": [self.fir_axes.estimate(log) for log in logs],
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
    with warnings.catch_warnings():
        # Slow and fast flights do; what that costs is what the comparison shows.
        warnings.filterwarnings("ignore", "flights disagree", UserWarning)
        result = learn(bare, chosen.orders, shape="general", search=Search(starts=chosen.starts))
        axes = [
            learn(
                bare,
                result.filter.order,
                channels=[i],
                shape="general",
                search=Search(start=result.filter, starts=0, cross_validate=False),
            ).filter
            for i in range(bare[0].n_x)
        ]
    left = [
        log.with_signals(label=labels(log) - y)
        for log, y in zip(bare, _estimates(result.filter, bare, dt), strict=True)
    ]
    after = train(left, stride=stride, seed=seed, iterations=iterations)
    fir, fir_axes = (SlopeFIR.chosen(bare, chosen.taps, by_axis=by_axis) for by_axis in (False, True))
    return Linear(result, stack(axes), fir, fir_axes, after)
