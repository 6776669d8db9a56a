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

__all__ = ["Course", "Forward", "added", "forward", "smoothed", "started", "transition"]


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


def started(working: Working, x: FloatArray, R: FloatArray) -> Course:
    """At the first sample, x (..., n_x): nothing is known of x before it."""
    B, n_x = working.structure.measured, working.structure.n_x
    P = np.zeros((n_x + len(working.sd),) * 2)
    prior = np.diag(working.sd**2)
    P[n_x:, n_x:] = prior
    P[:n_x, :n_x] = B @ prior @ B.T + R
    P[:n_x, n_x:] = -B @ prior
    P[n_x:, :n_x] = P[:n_x, n_x:].T
    c = np.broadcast_to(working.mean, (*x.shape[:-1], len(working.sd)))
    mean = np.concatenate([x - c @ B.T, c], axis=-1)
    return Course(mean, np.broadcast_to(P, (*x.shape[:-1], *P.shape)))


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


def forward(working: Working, data: Samples, about: FloatArray | None = None) -> Forward:
    """The filter; random forces are scaled by the eta that it finds, or by that of means ``about`` (N, ..., n)."""
    structure = working.structure
    n_x, m = structure.n_x, len(data.h)
    first = started(working, data.x[0], data.R)
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


def smoothed(working: Working, run: Forward) -> Course:
    """Given all samples."""
    means, covariances = run.course.mean.copy(), run.course.covariance.copy()
    H = np.hstack([np.eye(working.structure.n_x), working.structure.measured])
    eye = np.eye(means.shape[-1])
    adjoint = np.zeros((*means.shape[1:], 1))
    information = np.zeros(covariances.shape[1:])
    for k in range(len(run.F) - 1, -1, -1):
        left = eye - run.gain[k] @ H
        seen = H.T @ run.S_inverse[k]
        adjoint = np.swapaxes(left, -1, -2) @ adjoint - seen @ run.innovation[k][..., None]
        information = np.swapaxes(left, -1, -2) @ information @ left + seen @ H
        back = np.swapaxes(run.F[k], -1, -2)
        adjoint, information = back @ adjoint, back @ information @ run.F[k]
        P = run.course.covariance[k]
        means[k] -= (P @ adjoint)[..., 0]
        covariances[k] -= P @ information @ P
    return Course(means, 0.5 * (covariances + np.swapaxes(covariances, -1, -2)))
