"""How far the answer rests on what was declared: the same recordings under other declarations that fit them as well."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..._sections import FloatArray
from .kalman import Course, forward, started
from .structure import Samples, Structure, Working

__all__ = ["sensitivity"]

_FACTOR = 3.0  # by which a deviation or a bandwidth is declared otherwise
_AS_WELL = 2.0  # log-likelihood that another declaration may lose and still fit
_BETTER = 6.0  # and gain, before the data are said to prefer it
_GAIN = 0.03  # by which the known forces may be off
_INTERVAL = 1.96


def sensitivity(
    working: Working,
    data: Sequence[Samples],
    shared: FloatArray,
    identified: NDArray[np.bool_],
    sd: FloatArray,
) -> list[str]:
    """Notes on identified parameters that move out of their interval where a force is declared otherwise.

    Parameters
    ----------
    working : Working
    data : sequence of Samples
    shared : (p,) array
        As for :func:`started`.
    identified : (p,) bool array
    sd : (p,) array
        Deviations at the end, by which a shift is judged.
    """
    structure = working.structure
    asked = np.flatnonzero(structure.parameter & structure.recorded & identified)
    if not len(asked):
        return []
    usual, fit = _last(working, data, shared)
    found: list[str] = []
    for words, other in _others(structure):
        value, likelihood = _last(Working.of(other, working.rho), data, shared)
        if likelihood < fit - _AS_WELL:
            continue
        if likelihood > fit + _BETTER:
            found.append(f"the data prefer {words}: log-likelihood {likelihood - fit:+.0f}; declare it so")
        moved = [i for i in asked if abs(value[i] - usual[i]) > _INTERVAL * sd[i]]
        found += [
            f"{structure.labels[i]} depends on what was declared: {value[i]:.3g} for {usual[i]:.3g} +- "
            f"{_INTERVAL * sd[i]:.2g} with {words}, which fits as well"
            for i in moved
        ]
    if (i := structure.theta) is not None and i in asked:
        shift = _GAIN * (1.0 / working.rho + usual[i])
        if shift > _INTERVAL * sd[i]:
            found.append(
                f"{structure.labels[i]} depends on the scale of g: 3 % less of the force than g says shifts it by "
                f"{shift:.2g}, where its interval is +- {_INTERVAL * sd[i]:.2g}; no data tell the two apart"
            )
    return found


def _others(structure: Structure) -> Iterator[tuple[str, Structure]]:
    """Forces that are not recorded, each declared otherwise."""
    for number, name in enumerate(structure.names):
        own = (structure.part == number) & ~structure.recorded & np.any(structure.load != 0.0, axis=0)
        if not own.any():
            continue

        def times(values: FloatArray, factor: float, own: NDArray[np.bool_] = own) -> FloatArray:
            return np.where(own, factor * values, values)

        factors = (_FACTOR, 1.0 / _FACTOR)
        for k in factors if np.any(own & (structure.rate > 0.0)) else factors[:1]:
            wider = replace(structure, sd=times(structure.sd, k), density=times(structure.density, k**2))
            yield f"{name}: sd {_times(k)}", wider
            if np.any(own & (structure.rate > 0.0)):
                faster = replace(
                    structure, rate=times(structure.rate, k), density=times(structure.density, k)
                )
                yield f"{name}: bandwidth {_times(k)}", faster


def _times(factor: float) -> str:
    return f"{factor:g} times as large" if factor > 1.0 else f"{1.0 / factor:g} times smaller"


def _last(working: Working, data: Sequence[Samples], shared: FloatArray) -> tuple[FloatArray, float]:
    """Scalars (p,) after the last sample, and the log-likelihood of all."""
    n_x, likelihood = working.structure.n_x, 0.0
    before: Course | None = None
    for one in data:
        run = forward(working, one, None, started(working, one.x[0], one.R, before, shared))
        before = Course(run.course.mean[-1], run.course.covariance[-1])
        likelihood += float(run.log_likelihood)
    assert before is not None
    c, _, _ = working.physical(before.mean[n_x:], before.covariance[n_x:, n_x:])
    return c, likelihood
