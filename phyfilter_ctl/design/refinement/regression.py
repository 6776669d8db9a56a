"""What refinement asks of a model, a filter and logs: filtered residuals, filtered regressors, the adjoint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._sections import FloatArray
from ...filter import SampledPhyFilter
from ...learned import LearnedModel
from ...learned.model import expect_model
from ...recording import Recording

M = TypeVar("M", bound=LearnedModel)

# A log whose step is within this of the filter's, relative, is sampled at the filter's rate.
_SAME_STEP = 1e-6
# Doubling a change of the parameters doubles a change of a linear model to rounding; a nonlinear one misses by the
# square of the step, far above.
_LINEAR = 1e-7
_PROBED_ROWS = 64


@dataclass(frozen=True)
class Tuned(Generic[M]):
    """A model and the parameters of it that move; the rest stays as it is."""

    model: M
    index: NDArray[np.intp]  # (p,) places of the moving parameters in model.parameters

    @classmethod
    def of(cls, model: M, trainable: slice | ArrayLike | None) -> Tuned[M]:
        """Of a fitted model, with some of its parameters moving; None: all."""
        expect_model(model)
        count = len(model.parameters)
        if count == 0:
            raise ValueError("the model has no parameters to refine: fit it first")
        places = np.arange(count)
        if isinstance(trainable, slice):
            places = places[trainable]
        elif trainable is not None:
            given = np.asarray(trainable)
            if given.ndim != 1 or given.dtype.kind not in "iu":
                raise ValueError("trainable: expected a slice or the indices of parameters in one dimension")
            if len(np.unique(given)) != len(given) or np.any((given < 0) | (given >= count)):
                raise ValueError(f"trainable: expected different indices from 0 to {count - 1}")
            places = given.astype(np.intp)
        if len(places) == 0:
            raise ValueError("trainable: expected at least one parameter, got none")
        return cls(model, places)

    @property
    def count(self) -> int:
        """Number p of moving parameters."""
        return len(self.index)

    def moved(self, change: FloatArray) -> M:
        """The model with its moving parameters changed by ``change`` (p,)."""
        parameters = np.array(self.model.parameters)
        parameters[self.index] += change
        return self.model.with_parameters(parameters)

    def is_linear(self, z: FloatArray) -> bool:
        """Whether predictions are affine in the moving parameters, probed at some rows of z."""
        rows = z[:: max(1, len(z) // _PROBED_ROWS)]
        scale = 1.0 + np.abs(self.model.parameters[self.index])
        change = scale * np.random.default_rng(0).standard_normal(self.count)
        base = self.model.predict(rows)
        once, twice = (self.moved(factor * change).predict(rows) - base for factor in (1.0, 2.0))
        return bool(np.max(np.abs(twice - 2.0 * once)) <= _LINEAR * np.max(np.abs(twice), initial=1e-300))

    def regressors(self, z: FloatArray) -> FloatArray:
        """d f_theta / d(moving parameters) of a linear model, shape (N, n_x, p)."""
        base = self.model.predict(z)
        columns = np.empty((*base.shape, self.count))
        for j, unit in enumerate(np.eye(self.count)):
            columns[..., j] = self.moved(unit).predict(z) - base
        return columns

    def regressors_at(self, z: FloatArray) -> FloatArray:
        """The same at one sample z (n_z,), shape (n_x, p), by one vector-Jacobian product a channel."""
        channels = self.model.predict(z[None]).shape[1]
        return np.stack([self.model.vjp(z[None], unit[None])[self.index] for unit in np.eye(channels)])


def checked_filter(sampled: SampledPhyFilter) -> SampledPhyFilter:
    """The filter without its limit, so that f_hat is linear in f_theta."""
    if sampled.sampling.delay or sampled.sampling.precision != "float64":
        raise ValueError(
            "filter: refinement needs float64 and no delay; move x of the log by the known delay instead"
        )
    return replace(sampled, sampling=replace(sampled.sampling, limit=None, nonfinite="raise"))


def checked_logs(name: str, logs: Recording | Sequence[Recording], dt: float) -> tuple[Recording, ...]:
    """Logs with features, sampled at the filter's rate."""
    flights = (logs,) if isinstance(logs, Recording) else tuple(logs)
    for i, log in enumerate(flights):
        if not isinstance(log, Recording):
            raise TypeError(f"{name}[{i}]: expected a Recording, got {type(log).__name__}")
        if log.features is None:
            raise ValueError(
                f"{name}[{i}] has no features to evaluate the model at; log.with_signals(features=z)"
            )
        if not log.is_uniform or abs(log.dt - dt) > _SAME_STEP * dt:
            raise ValueError(
                f"{name}[{i}]: expected samples every {dt:g} s as the filter's, got {log!r}; log.resample({dt:g})"
            )
    return flights


def features_of(log: Recording) -> FloatArray:
    """Features z (N, n_z), which the log must have."""
    if log.features is None:
        raise ValueError("the log has no features")
    return log.features


def correction(sampled: SampledPhyFilter, log: Recording, f_theta: FloatArray) -> FloatArray:
    """f_hat - f_theta (N, n_x): what the filter adds to this prediction."""
    f_hat = sampled.run(log.x, log.g, f_theta, log.inertia)
    return np.asarray(f_hat - f_theta, dtype=float)


def filtered(sampled: SampledPhyFilter, signal: FloatArray) -> FloatArray:
    """F of the step means of a signal shaped as f_theta (N, n_x), or as regressors (N, n_x, p)."""
    columns = signal if signal.ndim == 3 else signal[..., None]
    result = np.empty(columns.shape)
    plain = replace(sampled, sampling=replace(sampled.sampling, E=None))
    for j in range(columns.shape[2]):
        column = np.ascontiguousarray(columns[..., j])
        result[..., j] = column - plain.run(np.zeros_like(column), f_theta=column)
    return result.reshape(signal.shape)


def filtered_adjoint(sampled: SampledPhyFilter, cotangent: FloatArray) -> FloatArray:
    """Transpose of :func:`filtered` on (N, n_x): the same filter, run backwards in time."""
    backward = np.zeros_like(cotangent)
    backward[1:] = _respond(sampled, cotangent[:0:-1])[::-1]
    if sampled.sampling.f_theta == "hold":
        return np.concatenate([backward[1:], np.zeros_like(backward[:1])])
    half = 0.5 * backward
    half[:-1] += 0.5 * backward[1:]
    return half


def _respond(sampled: SampledPhyFilter, u: FloatArray) -> FloatArray:
    """F of inputs u (m, n_x) held over each of m steps."""
    held = replace(sampled, sampling=replace(sampled.sampling, f_theta="hold", E=None))
    drive = np.concatenate([u, np.zeros_like(u[:1])])  # entry k drives step k + 1, with its sign turned
    return (drive - held.run(np.zeros_like(drive), f_theta=drive))[1:]
