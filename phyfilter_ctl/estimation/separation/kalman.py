"""The Kalman filter of the parts and its smoother.

Exact where the model is linear. Where parts add to the inertia N = M + sum c_i J_i it is not: each step of the filter
is linearised about the parameters that it finds, the smoother about its own answer (B. M. Bell, "The iterated Kalman
smoother as a Gauss-Newton method", SIAM Journal on Optimization 4 (3), 1994), but for one term. What N resists is the
motion by forces known up to parameters; the motion by random forces w is N^-1 w with N as it was last estimated. Were
its derivative by N counted too, a small N would explain the motion by a small w, which is likelier: the estimate would
be drawn towards N = 0, as least squares are by a regressor that holds the noise.

The smoother is Bryson's and Frazier's in the form of G. J. Bierman, "Fixed interval smoothing with discrete
measurements", International Journal of Control 18 (1), 1973, which inverts no covariance of the state.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

from ..._sections import FloatArray
from .structure import Moments, Samples, Structure, moments

__all__ = ["Course", "Forward", "Transition", "forward", "smoothed", "transition"]


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


@dataclass(frozen=True, eq=False)
class Transition:
    """Over one step, or over all of them along the first axis.

    Attributes
    ----------
    dx : (..., n_x) array
        Movement of x from the scalars that it is linearised at.
    F, Q : (..., n, n) arrays
        Transition of (x, c), and the covariance that the step adds.
    """

    dx: FloatArray
    F: FloatArray
    Q: FloatArray


def transition(
    structure: Structure,
    step: Moments,
    h: FloatArray,
    impulse: FloatArray,
    load: FloatArray,
    M: FloatArray,
    c: FloatArray,
) -> Transition:
    """From scalars c (..., p); h (..., 1, 1), M (..., n_x, n_x) and the moments broadcast."""
    n_x, p = structure.n_x, len(structure.labels)
    force = impulse + (load @ (step.area * c)[..., None])[..., 0]
    if structure.has_inertia:
        into_x = np.linalg.inv(M + np.tensordot(c, structure.inertia, 1))
        dx = (into_x @ force[..., None])[..., 0]
        known = impulse + (load @ np.where(structure.random, 0.0, step.area * c)[..., None])[..., 0]
        resisted = (into_x @ known[..., None])[..., 0]
        push = into_x @ (load - np.einsum("pij,...j->...ip", structure.inertia, resisted) / h)
    else:
        into_x = np.linalg.inv(M)
        dx = (into_x @ force[..., None])[..., 0]
        push = into_x @ load
    F = np.zeros((*c.shape[:-1], n_x + p, n_x + p))
    Q = np.zeros_like(F)
    x, own = np.arange(n_x), np.arange(n_x, n_x + p)
    F[..., x, x] = 1.0
    F[..., own, own] = step.stay
    F[..., :n_x, n_x:] = push * step.area[..., None, :]
    Q[..., :n_x, :n_x] = (push * step.area_area[..., None, :]) @ np.swapaxes(push, -1, -2)
    Q[..., :n_x, n_x:] = push * step.area_end[..., None, :]
    Q[..., n_x:, :n_x] = np.swapaxes(Q[..., :n_x, n_x:], -1, -2)
    Q[..., own, own] = step.end
    return Transition(dx, F, Q)


def started(structure: Structure, x: FloatArray, R: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance at the first sample, x (..., n_x): nothing is known of x before it."""
    B, n_x = structure.measured, structure.n_x
    P = np.zeros((n_x + len(structure.labels),) * 2)
    prior = np.diag(structure.sd**2)
    P[n_x:, n_x:] = prior
    P[:n_x, :n_x] = B @ prior @ B.T + R
    P[:n_x, n_x:] = -B @ prior
    P[n_x:, :n_x] = P[:n_x, n_x:].T
    c = np.broadcast_to(structure.mean, (*x.shape[:-1], len(structure.labels)))
    mean = np.concatenate([x - c @ B.T, c], axis=-1)
    return mean, np.broadcast_to(P, (*x.shape[:-1], *P.shape))


@dataclass(frozen=True, eq=False)
class _Step(Course):
    """The state after one measurement, and how it came about; see :class:`Forward`."""

    F: FloatArray
    gain: FloatArray
    S_inverse: FloatArray
    innovation: FloatArray


def _measured(
    before: Course, x: FloatArray, R: FloatArray, H: FloatArray, c: FloatArray, step: Transition
) -> _Step:
    """A step on, linearised at the scalars c, and the measurement x (..., n_x) at its end; Joseph's form."""
    n_x, F = len(H), step.F
    # F (z - z_c) + f(z_c), where x enters f as it is and c through F and dx.
    z = (F @ before.mean[..., None])[..., 0]
    z[..., :n_x] += step.dx - (F[..., :n_x, n_x:] @ c[..., None])[..., 0]
    P = F @ before.covariance @ np.swapaxes(F, -1, -2) + step.Q
    cross = P @ H.T
    S_inverse = np.asarray(np.linalg.inv(H @ cross + R), dtype=float)
    K = cross @ S_inverse
    innovation = x - z @ H.T
    left = np.eye(P.shape[-1]) - K @ H
    P = left @ P @ np.swapaxes(left, -1, -2) + K @ R @ np.swapaxes(K, -1, -2)
    P = 0.5 * (P + np.swapaxes(P, -1, -2))
    return _Step(z + (K @ innovation[..., None])[..., 0], P, F, K, S_inverse, innovation)


def forward(structure: Structure, data: Samples, about: FloatArray | None = None) -> Forward:
    """The filter, linearised about its own estimate, or about a course (N, ..., n) of means."""
    n_x, m = structure.n_x, len(data.h)
    z, P = started(structure, data.x[0], data.R)
    H = np.hstack([np.eye(n_x), structure.measured])
    of_step = _of_steps(structure, data, None if about is None else about[:-1, ..., n_x:])
    relinearised = structure.has_inertia and about is None
    before: Course | _Step = Course(z, P)
    steps: list[_Step] = []
    for k in range(m):
        after = _measured(before, data.x[k + 1], data.R, H, *of_step(k, before.mean[..., n_x:]))
        if relinearised:
            c = np.where(structure.random, before.mean[..., n_x:], after.mean[..., n_x:])
            after = _measured(before, data.x[k + 1], data.R, H, *of_step(k, c))
        steps.append(after)
        before = after
    F, gain, S_inverse, innovation = (
        np.array([getattr(each, name) for each in steps]) for name in ("F", "gain", "S_inverse", "innovation")
    )
    means, covariances = (
        np.concatenate([first[None], [getattr(each, name) for each in steps]])
        for name, first in (("mean", z), ("covariance", P))
    )
    roots = np.linalg.cholesky(S_inverse)
    whitened = (np.swapaxes(roots, -1, -2) @ innovation[..., None])[..., 0]
    determinants = 2.0 * np.log(np.diagonal(roots, axis1=-2, axis2=-1)).sum(axis=(0, -1))
    likelihood = 0.5 * (determinants - np.sum(whitened**2, axis=(0, -1)) - m * n_x * math.log(2.0 * math.pi))
    return Forward(Course(means, covariances), F, innovation, whitened, S_inverse, gain, likelihood)


def _of_steps(
    structure: Structure, data: Samples, about: FloatArray | None
) -> Callable[[int, FloatArray], tuple[FloatArray, Transition]]:
    """The transition of each step and the scalars it is linearised at: all at once where these are known before."""
    lengths, which = np.unique(data.h, return_inverse=True)
    sampled = [moments(structure.rate, structure.density, float(h)) for h in lengths]
    if structure.has_inertia and about is None:

        def one(k: int, c: FloatArray) -> tuple[FloatArray, Transition]:
            step, h = sampled[which[k]], data.h[k : k + 1, None]
            return c, transition(structure, step, h, data.impulse[k], data.load[k], data.M[k], c)

        return one
    c = np.zeros((*data.impulse.shape[:-1], len(structure.labels))) if about is None else about
    beside = tuple(range(1, data.impulse.ndim - 1))
    step = Moments(
        *(
            np.expand_dims(np.array([getattr(each, f.name) for each in sampled])[which], beside)
            for f in fields(Moments)
        )
    )
    h, M = (np.expand_dims(each, beside) for each in (data.h[:, None, None], data.M))
    every = transition(structure, step, h, data.impulse, data.load, M, c)
    return lambda k, _: (c[k], Transition(every.dx[k], every.F[k], every.Q[k]))


def smoothed(structure: Structure, run: Forward) -> Course:
    """Given all samples."""
    means, covariances = run.course.mean.copy(), run.course.covariance.copy()
    H = np.hstack([np.eye(structure.n_x), structure.measured])
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
