"""Variance of the estimate and of its error for noise of x and a random residual, in closed form."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import control as ct
import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

from .. import _sections
from .._sections import FloatArray
from ..filter import PhyFilter, SampledPhyFilter
from ..results import Result, in_lines, with_unit
from ..values import Gaussian, Shape
from ..values.disturbance import shaping
from .channels import per_channel
from .options import assumed, checked_filter, input_gains, units_of

__all__ = ["Variance", "discretised", "error_variance"]


@dataclass(frozen=True, repr=False)
class Variance(Result):
    """Variances of one channel; made by :func:`error_variance`.

    Attributes
    ----------
    noise : float
        Of the estimate, from the noise of x. The error has it too.
    residual_error : float
        Of f - f_hat, from the residual.
    residual_estimate : float
        Of f_hat - f_theta, from the residual.
    unit : str
        Of f, where the filter knows it; the variances are in its square.
    assumptions : tuple of str
        What is taken for granted of the options of the filter.
    """

    _figures = ("noise", "residual_error", "residual_estimate", "error", "estimate", "unit", "assumptions")
    _units = MappingProxyType(dict.fromkeys(_figures[:5], "{}^2"))
    _answer = ("error",)

    noise: float
    residual_error: float
    residual_estimate: float
    unit: str = ""
    assumptions: tuple[str, ...] = ()

    @property
    def error(self) -> float:
        """Of f - f_hat."""
        return self.noise + self.residual_error

    @property
    def estimate(self) -> float:
        """Of f_hat - f_theta."""
        return self.noise + self.residual_estimate

    def describe(self) -> str:
        """The standard deviations as text, one line each: square roots of the variances, in units of f.

        Returns
        -------
        str

        Examples
        --------
        >>> filter = PhyFilter([20.0]).sampled(0.002, units={"f": "N"})
        >>> print(error_variance(filter, Gaussian(noise=0.001)).describe())
        error               0.0198 N (1 sigma)
          noise             0.0198 N
          residual          0 N
        estimate            0.0198 N (1 sigma)
        """
        figures = {"error": self.error, "  noise": self.noise, "  residual": self.residual_error}
        lines = {name: with_unit(value**0.5, self.unit) for name, value in figures.items()}
        lines["error"] += " (1 sigma)"
        return in_lines(lines | {"estimate": f"{with_unit(self.estimate**0.5, self.unit)} (1 sigma)"})


@per_channel
def error_variance(
    filter: PhyFilter | SampledPhyFilter,
    disturbance: Gaussian,
    *,
    inertia: ArrayLike | None = None,
) -> Variance:
    """Steady variances of one channel.

    Parameters
    ----------
    filter : PhyFilter, SampledPhyFilter or several
        Sampled: variances at the samples, the residual going on between them. Several, by ``stack`` or as a sequence:
        the answer is a ``PerChannel``, and every other argument one for all or a list.
    disturbance : Gaussian
        Residual and noise of x. Noise of a sampled filter: standard deviation of independent samples; continuous:
        square root of the two-sided power density in units of x per sqrt(Hz), or the shaping filter of coloured noise.
    inertia : float, (n_x,) or (n_x, n_x) array_like, optional
        M_hat, by which noise of x counts. None: the filter's own, else 1.

    Returns
    -------
    Variance, or PerChannel of it

    Raises
    ------
    TypeError
        For a disturbance of another kind.
    ValueError
        For white noise where s F has a direct path (b_{n-1} != 0), as its variance is infinite, coloured noise of a
        sampled filter, autocovariances, or what only :func:`tracking_error` counts: actuation, position_noise.

    Notes
    -----
    C P C' with P from the Lyapunov equation of filter and shaping filter together; for the sampled filter the
    covariance of the residual and of its average over a step is exact (Van Loan, IEEE TAC 23 (3), 1978).

    Noise, independent from axis to axis, has the covariance c E^+ M_hat M_hat' E^+' in f_hat, c the variance of one
    channel with M_hat = 1. Its largest eigenvalue is given, c norm2(E^+ M_hat)^2: of the direction that has most.

    Examples
    --------
    Independent noise of 1 mm/s at 500 Hz through a first-order filter of 20 rad/s:

    >>> variance = error_variance(PhyFilter([20.0]).sampled(0.002), Gaussian(noise=0.001))
    >>> round(variance.noise**0.5, 6)
    0.0198
    """
    filter = checked_filter(filter)
    if not isinstance(disturbance, Gaussian):
        raise TypeError(
            f"disturbance: expected Gaussian(residual, noise=...), got {disturbance!r}; for bounds see error_bound"
        )
    if disturbance.actuation is not None or disturbance.position_noise:
        raise ValueError("actuation, position_noise: do not enter the estimate's error; see tracking_error")
    residual, noise = disturbance.residual, disturbance.noise
    if residual is not None and not isinstance(residual, ct.StateSpace | ct.TransferFunction):
        raise ValueError(
            "residual: expected a shaping filter, got autocovariances; see tracking_error for those"
        )
    shape = None if residual is None else shaping("residual", residual)
    if isinstance(filter, SampledPhyFilter):
        if isinstance(noise, ct.StateSpace | ct.TransferFunction):
            raise ValueError("noise: expected a standard deviation for a sampled filter, got a system")
        from_noise = _sampled_noise(filter, noise)
        parts = (0.0, 0.0) if shape is None else _sampled_residual(filter, shape)
    else:
        from_noise = _noise(filter, noise)
        parts = (0.0, 0.0) if shape is None else _residual(filter, shape)
    size = input_gains(filter, inertia, needed=from_noise > 0.0).x
    return Variance(
        from_noise * size * size, *parts, unit=units_of(filter).get("f", ""), assumptions=assumed(filter)
    )


def _residual(filter: PhyFilter, shape: ct.StateSpace) -> tuple[float, float]:
    A, equilibrium, C = filter.sections
    joint = np.block([[shape.A, np.zeros((shape.nstates, len(A)))], [np.outer(-A @ equilibrium, shape.C), A]])
    P = _steady(joint, np.vstack([shape.B, np.zeros((len(A), shape.ninputs))]))
    error = np.concatenate([shape.C[0], -C])
    estimate = np.concatenate([np.zeros(shape.nstates), C])
    return float(error @ P @ error), float(estimate @ P @ estimate)


def _noise(filter: PhyFilter, noise: float | Shape) -> float:
    A, equilibrium, C = filter.sections
    B = -A @ equilibrium
    if not isinstance(noise, ct.StateSpace | ct.TransferFunction):
        density = noise
        if density == 0.0:
            return 0.0
        if filter.b[-1] != 0.0:
            raise ValueError(
                "noise: white noise has an infinite variance through s F, whose direct path is "
                f"b_{filter.order - 1} = {filter.b[-1]:.6g}; give a shaping filter, or the sampled "
                "filter and its noise per sample"
            )
        P = _steady(A, density * B[:, None])
        row = C @ A
        return float(row @ P @ row)
    shape = shaping("noise", noise)
    joint = np.block([[shape.A, np.zeros((shape.nstates, len(A)))], [np.outer(B, shape.C), A]])
    P = _steady(joint, np.vstack([shape.B, np.zeros((len(A), shape.ninputs))]))
    row = np.concatenate([(C @ B) * shape.C[0], C @ A])
    return float(row @ P @ row)


def _sampled_noise(sampled: SampledPhyFilter, deviation: float) -> float:
    dA, equilibrium, C = sampled.transition
    n = len(dA)
    entry = -dA @ equilibrium / sampled.dt
    joint = np.zeros((n + 1, n + 1))
    joint[:n, :n] = np.eye(n) + dA
    joint[:n, n] = -entry  # the sample before
    drive = np.append(entry, 1.0)
    P = np.asarray(solve_discrete_lyapunov(joint, np.outer(drive, drive)))
    return deviation * deviation * float(C @ P[:n, :n] @ C)


def _sampled_residual(sampled: SampledPhyFilter, shape: ct.StateSpace) -> tuple[float, float]:
    dA, equilibrium, C = sampled.transition
    n, m, h = len(dA), shape.nstates, sampled.dt
    # Process and its integral over a step, with their joint covariance.
    F = np.block([[shape.A, np.zeros((m, 1))], [shape.C, np.zeros((1, 1))]])
    Q = np.zeros((m + 1, m + 1))
    entry_of_noise = np.asarray(shape.B)
    Q[:m, :m] = entry_of_noise @ entry_of_noise.T
    step, covariance = discretised(F, Q, h)
    joint = np.zeros((m + n, m + n))
    joint[:m, :m] = step[:m, :m]
    entry = -dA @ equilibrium / h
    joint[m:, :m] = np.outer(entry, step[m, :m])
    joint[m:, m:] = np.eye(n) + dA
    drive = np.zeros((m + n, m + 1))
    drive[:m, :m] = np.eye(m)
    drive[m:, m] = entry
    P = np.asarray(solve_discrete_lyapunov(joint, drive @ covariance @ drive.T))
    later = np.eye(m) + _sections.expm1(np.asarray(shape.A), sampled.sampling.delay)
    gamma = shape.C[0]
    estimate = float(C @ P[m:, m:] @ C)
    now = float(gamma @ P[:m, :m] @ gamma)
    return now - 2.0 * float(gamma @ later @ P[:m, m:] @ C) + estimate, estimate


def discretised(F: FloatArray, Q: FloatArray, h: float) -> tuple[FloatArray, FloatArray]:
    """e^(F h) and the covariance that white noise of density Q adds over a step (Van Loan)."""
    n = len(F)
    both = np.block([[-F, Q], [np.zeros((n, n)), F.T]])
    grown = np.eye(2 * n) + _sections.expm1(both, h)
    step = grown[n:, n:].T
    return step, step @ grown[:n, n:]


def _steady(A: FloatArray, B: FloatArray) -> FloatArray:
    return np.asarray(solve_continuous_lyapunov(A, -B @ B.T))
