"""The signal paths of a filter as functions of frequency, continuous and sampled.

Sampled, z = e^(j theta), theta = omega h, delta = z - 1:

    w_k = w_{k-1} + dA (w_{k-1} - equilibrium u_k)   =>   F_d(z) = z C (delta I - dA)^-1 (-dA equilibrium)

from u_k to C w_k. delta is formed without the subtraction, so nothing is lost at frequencies far below the rate.
"""

from __future__ import annotations

import warnings
from typing import Literal

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from .._sections import ComplexArray, FloatArray
from ..filter import PhyFilter, SampledPhyFilter
from ..filter.sampling import Rule
from ..filter.windows import mean_weights
from . import _resolvent

__all__ = ["noise_gain", "residual", "to_estimate"]

# Below this theta the series of 1 - sin(theta/2)/(theta/2) is exact to rounding with three terms.
_SMALL_ANGLE = 0.02


def residual(system: PhyFilter | SampledPhyFilter, omega: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """From the residual gamma: (F to f_hat, 1 - F to the error), each (N,)."""
    if isinstance(system, PhyFilter):
        s = 1j * omega
        return system(s), system.error(s)
    F, error = _recursion(system, omega)
    theta = omega * system.dt
    # gamma reaches u_k averaged over the step, e^(-j theta/2) sinc, and late by the delay.
    sinc, short = _sinc(0.5 * theta)
    turn = 0.5 * theta + omega * system.sampling.delay
    missing = short - sinc * np.expm1(-1j * turn)
    return F * sinc * np.exp(-1j * turn), error + F * missing


def to_estimate(
    system: PhyFilter | SampledPhyFilter, omega: FloatArray, source: Literal["x", "g", "f_theta", "noise"]
) -> ComplexArray:
    """From x, g, f_theta or sensor noise to f_hat, (N,)."""
    if isinstance(system, PhyFilter):
        s = 1j * omega
        if source == "f_theta":
            return system.error(s)
        return -system(s) if source == "g" else s * system(s)
    F, error = _recursion(system, omega)
    theta = omega * system.dt
    if source in ("x", "noise"):
        rate = -np.expm1(-1j * theta) / system.dt
        return F * rate * (np.exp(-1j * omega * system.sampling.delay) if source == "x" else 1.0)
    rule = system.sampling.g if source == "g" else system.sampling.f_theta
    mean, missing = _step_mean(theta, rule, system.sampling.delay_steps)
    return -F * mean if source == "g" else error + F * missing


def noise_gain(system: PhyFilter | SampledPhyFilter) -> float:
    """Standard deviation of f_hat for white sensor noise on x; see FilterResponse.noise_gain."""
    if isinstance(system, PhyFilter):
        if system.b[-1] != 0.0:
            return float("inf")
        A, equilibrium, C = system.sections
        drive = A @ (A @ equilibrium)
        P = _covariance(A, drive)
        return float(np.sqrt(max(C @ P @ C, 0.0)))
    dA, equilibrium, C = system.transition
    # u_k = (nu_k - nu_{k-1})/h. The state w_k - B nu_k/h sees each nu once: it is driven by dA B nu_{k-1}/h.
    B = -dA @ equilibrium / system.dt
    # Bilinear change: dA P + P dA' + dA P dA' + Q = 0 is X P + P X' + T Q T' = 0 with T = (I + dA/2)^-1 and
    # X = T dA, in which nothing is subtracted from I.
    T = np.linalg.inv(np.eye(len(dA)) + 0.5 * dA)
    drive = T @ dA @ B
    P = _covariance(T @ dA, drive)
    # Where F(0) = 0 and every sample forgets the last the two cancel, to a rounding of either sign.
    return float(np.sqrt(max(C @ P @ C + (C @ B) ** 2, 0.0)))


def _covariance(A: FloatArray, drive: FloatArray) -> FloatArray:
    """P with A P + P A' + drive drive' = 0; nan where rounding hides whether the slowest state decays."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        try:
            return np.asarray(solve_continuous_lyapunov(A, -np.outer(drive, drive)))
        except RuntimeWarning:
            return np.full_like(A, np.nan)


def _recursion(system: SampledPhyFilter, omega: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """F_d and 1 - F_d, (N,) each."""
    dA, equilibrium, C = system.transition
    half = 0.5 * omega * system.dt
    delta = 2j * np.sin(half) * np.exp(1j * half)  # e^(j theta) - 1
    z = 1.0 + delta
    inputs = np.stack([-dA @ equilibrium, equilibrium], axis=1)
    driven, resting = _resolvent.evaluate(dA, inputs, C[None, :], np.zeros((1, 2)), delta)[0]
    dc = C @ equilibrium
    # (delta I - dA)^-1 (-dA) = I - delta (delta I - dA)^-1 leaves 1 - F_d as a product with delta.
    offset = 0.0 if system.filter.type > 0 else 1.0 - dc
    return z * driven, offset + delta * (z * resting - dc)


def _step_mean(theta: FloatArray, rule: Rule, delay: float) -> tuple[ComplexArray, ComplexArray]:
    """Mean of a signal over the step that ends ``delay`` (in steps) ago, per value now, and 1 minus it.

    1 minus it is summed without the subtraction, so nothing is lost at low frequencies.
    """
    weights = mean_weights(rule, delay)
    turns = np.expm1(-1j * np.arange(len(weights)) * theta[:, None])
    missing = np.asarray(-(turns @ weights), dtype=np.complex128)
    return 1.0 - missing, missing


def _sinc(angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """sin(x)/x and 1 - sin(x)/x, both to full relative precision."""
    sinc = np.sinc(angle / np.pi)
    square = angle**2
    series = square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0))
    return sinc, np.where(np.abs(angle) < _SMALL_ANGLE, series, 1.0 - sinc)
