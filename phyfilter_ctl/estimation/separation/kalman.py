"""The Kalman filter of the parts and its smoother.

The smoother is Bryson's and Frazier's in the form of G. J. Bierman, "Fixed interval smoothing with discrete
measurements", International Journal of Control 18 (1), 1973, which inverts no covariance of the state.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..._sections import FloatArray
from .structure import Moments, Samples, Working, moments

__all__ = ["Course", "Forward", "Later", "added", "forward", "smoothed", "started", "transition"]


_ANEW = 100.0  # deviation of x over a reset, over the jump


@dataclass(frozen=True, eq=False)
class Course:
    """Means (N, ..., n) and covariances (N, ..., n, n) of the state (x, c) at the samples."""

    mean: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, eq=False)
class Forward:
    """The filter over a recording.

    Attributes
    ----------
    course : Course
        Given the samples up to each one.
    F : (m, ..., n, n) array
        Transitions.
    innovation, whitened : (m, ..., n_x) arrays
        Of the samples from the second on; and in units of their own standard deviation, uncorrelated.
    S_inverse : (m, ..., n_x, n_x) array
    gain : (m, ..., n, n_x) array
    log_likelihood : (...) array
    """

    course: Course
    F: FloatArray
    innovation: FloatArray
    whitened: FloatArray
    S_inverse: FloatArray
    gain: FloatArray
    log_likelihood: FloatArray


def transition(area: FloatArray, stay: FloatArray, push: FloatArray) -> FloatArray:
    """Transition (..., n, n) of (x, c): ``push`` (..., n_x, p) is M^-1 L, the rest as in :class:`Moments`."""
    n_x, p = push.shape[-2:]
    F = np.zeros((*push.shape[:-2], n_x + p, n_x + p))
    x, own = np.arange(n_x), np.arange(n_x, n_x + p)
    F[..., x, x] = 1.0
    F[..., own, own] = stay
    F[..., :n_x, n_x:] = push * area
    return F


def added(step: Moments, push: FloatArray, scale: FloatArray) -> FloatArray:
    """Covariance (..., n, n) that a step adds, by noise of ``scale`` (..., p) times the stated deviations."""
    n_x, p = push.shape[-2:]
    Q = np.zeros((*push.shape[:-2], n_x + p, n_x + p))
    own = np.arange(n_x, n_x + p)
    square = scale**2
    Q[..., :n_x, :n_x] = (push * (square * step.area_area)[..., None, :]) @ np.swapaxes(push, -1, -2)
    Q[..., :n_x, n_x:] = push * (square * step.area_end)[..., None, :]
    Q[..., n_x:, :n_x] = np.swapaxes(Q[..., :n_x, n_x:], -1, -2)
    Q[..., own, own] = square * step.end
    return Q


def started(
    working: Working,
    x: FloatArray,
    R: FloatArray,
    before: Course | None = None,
    shared: FloatArray | None = None,
) -> Course:
    """At the first sample, x (..., n_x): nothing is known of x before it.

    Of the scalars that are ``shared`` (p,), 1 or 0, with the recording before is known what its last state says.
    """
    B, n_x = working.structure.measured, working.structure.n_x
    n = n_x + len(working.sd)
    c = np.broadcast_to(working.mean, (*x.shape[:-1], len(working.sd)))
    prior = np.diag(working.sd**2)
    if before is not None and shared is not None:
        c = np.where(shared > 0.0, before.mean[..., n_x:], c)
        both = shared[:, None] * shared
        prior = np.diag((1.0 - shared) * working.sd**2) + both * before.covariance[..., n_x:, n_x:]
    P = np.zeros((*x.shape[:-1], n, n))
    P[..., n_x:, n_x:] = prior
    P[..., :n_x, :n_x] = B @ prior @ B.T + R
    P[..., :n_x, n_x:] = -B @ prior
    P[..., n_x:, :n_x] = np.swapaxes(P[..., :n_x, n_x:], -1, -2)
    return Course(np.concatenate([x - c @ B.T, c], axis=-1), P)


@dataclass(frozen=True, eq=False)
class _Step(Course):
    """The state after one measurement, and how it came about; see :class:`Forward`."""

    F: FloatArray
    gain: FloatArray
    S_inverse: FloatArray
    innovation: FloatArray


def _measured(
    before: Course, x: FloatArray, R: FloatArray, H: FloatArray, F: FloatArray, Q: FloatArray, dx: FloatArray
) -> _Step:
    """A step on, and the measurement x (..., n_x) at its end; Joseph's form."""
    z = (F @ before.mean[..., None])[..., 0]
    z[..., : len(H)] += dx
    P = F @ before.covariance @ np.swapaxes(F, -1, -2) + Q
    cross = P @ H.T
    S_inverse = np.asarray(np.linalg.inv(H @ cross + R), dtype=float)
    K = cross @ S_inverse
    innovation = x - z @ H.T
    left = np.eye(P.shape[-1]) - K @ H
    P = left @ P @ np.swapaxes(left, -1, -2) + K @ R @ np.swapaxes(K, -1, -2)
    P = 0.5 * (P + np.swapaxes(P, -1, -2))
    return _Step(z + (K @ innovation[..., None])[..., 0], P, F, K, S_inverse, innovation)


def forward(
    working: Working, data: Samples, about: FloatArray | None = None, first: Course | None = None
) -> Forward:
    """The filter; random forces are scaled by the eta that it finds, or by that of means ``about`` (N, ..., n).

    ``first`` is the state at the first sample; None: nothing is known but the priors.
    """
    structure = working.structure
    n_x, m = structure.n_x, len(data.h)
    first = started(working, data.x[0], data.R) if first is None else first
    H = np.hstack([np.eye(n_x), structure.measured])
    lengths, which = np.unique(data.h, return_inverse=True)
    steps = [moments(structure.rate, structure.density, float(h)) for h in lengths]
    beside = (slice(None), *(None,) * (data.impulse.ndim - 2))
    into_x = np.linalg.inv(data.M)[beside]
    push, dx = into_x @ data.load, (into_x @ data.impulse[..., None])[..., 0]
    area, stay = (np.array([getattr(each, key) for each in steps])[which][beside] for key in ("area", "stay"))
    F = transition(area[..., None, :], stay, push)
    found: list[_Step] = []
    before: Course = first
    for k in range(m):
        scale = working.scale((before.mean if about is None else about[k])[..., n_x:])
        Q = added(steps[which[k]], push[k], scale)
        if data.reset is not None and data.reset[k]:
            # What x is after a reset, its sample alone says.
            Q[..., :n_x, :n_x] += np.diag((_ANEW * (data.x[k + 1] - data.x[k])) ** 2 + np.diag(data.R))
        before = _measured(before, data.x[k + 1], data.R, H, F[k], Q, dx[k])
        found.append(before)
    gain, S_inverse, innovation = (
        np.array([getattr(each, key) for each in found]) for key in ("gain", "S_inverse", "innovation")
    )
    course = Course(
        np.concatenate([first.mean[None], [each.mean for each in found]]),
        np.concatenate([first.covariance[None], [each.covariance for each in found]]),
    )
    roots = np.linalg.cholesky(S_inverse)
    whitened = (np.swapaxes(roots, -1, -2) @ innovation[..., None])[..., 0]
    determinants = 2.0 * np.log(np.diagonal(roots, axis1=-2, axis2=-1)).sum(axis=(0, -1))
    likelihood = 0.5 * (determinants - np.sum(whitened**2, axis=(0, -1)) - m * n_x * math.log(2.0 * math.pi))
    return Forward(course, F, innovation, whitened, S_inverse, gain, likelihood)


@dataclass(frozen=True, eq=False)
class Later:
    """What samples after a state say of it: its mean given them all is mean - P adjoint, and P - P information P.

    Attributes
    ----------
    adjoint : (..., n, 1) array
    information : (..., n, n) array
    """

    adjoint: FloatArray
    information: FloatArray

    def through(self, working: Working, shared: FloatArray) -> Later:
        """Of the last state of the recording before, which has scalars in common with this one."""
        n_x = working.structure.n_x
        F = np.zeros_like(self.information)
        F[..., :n_x, n_x:] = -working.structure.measured * shared
        F[..., n_x:, n_x:] = np.diag(shared)
        back = np.swapaxes(F, -1, -2)
        return Later(back @ self.adjoint, back @ self.information @ F)


def smoothed(working: Working, run: Forward, later: Later | None = None) -> tuple[Course, Later]:
    """Given all samples, and what later recordings say of the last state; and what all say of the first state."""
    means, covariances = run.course.mean.copy(), run.course.covariance.copy()
    H = np.hstack([np.eye(working.structure.n_x), working.structure.measured])
    eye = np.eye(means.shape[-1])
    if later is None:
        later = Later(np.zeros((*means.shape[1:], 1)), np.zeros(covariances.shape[1:]))
    adjoint, information = later.adjoint, later.information
    for k in range(len(run.F), -1, -1):
        P = run.course.covariance[k]
        means[k] -= (P @ adjoint)[..., 0]
        covariances[k] -= P @ information @ P
        if k == 0:
            break
        left = eye - run.gain[k - 1] @ H
        seen = H.T @ run.S_inverse[k - 1]
        adjoint = np.swapaxes(left, -1, -2) @ adjoint - seen @ run.innovation[k - 1][..., None]
        information = np.swapaxes(left, -1, -2) @ information @ left + seen @ H
        back = np.swapaxes(run.F[k - 1], -1, -2)
        adjoint, information = back @ adjoint, back @ information @ run.F[k - 1]
    course = Course(means, 0.5 * (covariances + np.swapaxes(covariances, -1, -2)))
    return course, Later(adjoint, information)
