"""How large the error can become: the paper's ultimate bound as a number, as tight as it can be."""

from __future__ import annotations

from collections.abc import Mapping
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike

from ...filter import PhyFilter, SampledPhyFilter
from ...values import Bounded, Implementation
from ...values.disturbance import bounded
from ..channels import per_channel
from ..options import checked_filter, input_gains
from . import kernels, quadratic
from .implementation import Run
from .kernels import Certificate, Kernel
from .result import ErrorBound, Method, QuadraticProof
from .sampled_kernels import SampledKernels
from .together import together_of

__all__ = ["error_bound", "of_error"]


@per_channel
def error_bound(
    filter: PhyFilter | SampledPhyFilter,
    disturbance: Bounded | Mapping[int, float],
    *,
    method: Method = "exact",
    inertia: ArrayLike | None = None,
) -> ErrorBound:
    """Bound of |f - f_hat| after all transients.

    ``|f_err| <= min_k ||(1 - F) / s^k||_1 delta_k + ||F||_1 |E^+| delta_M delta_x + ||s F||_1 |E^+ M_hat| |nu|``, the
    first term of several derivatives less: the largest error of a residual that keeps all their bounds at once.
    Without E, E^+ is I.

    Parameters
    ----------
    filter : PhyFilter, SampledPhyFilter or several
        Sampled: exact for a residual that goes on between the samples, as long as g and f_theta go between them as its
        options say (see Notes). Several, by ``stack`` or as a sequence: the answer is a ``PerChannel`` of what each
        channel promises for itself, and every other argument one for all or a list.
    disturbance : Bounded, or mapping of int to float
        What is bounded of the residual, the noise of x, and a wrong inertia; a mapping is the bounds of the residual
        alone. Of a sampled filter the orders 0 and 1 of the residual count, with method="matched" and no delay all up
        to its type. ``implementation`` is for sampled filters: each of its entries is a part of the bound.
    inertia : float, (n_x,) or (n_x, n_x) array_like, optional
        M_hat, by which noise of x counts, in the spectral norm: a number, a diagonal, a matrix. None: the filter's own,
        else 1.
    method : {"exact", "ellipsoid", "lyapunov", "lyapunov-raw"}
        "exact": the L1 norm of the impulse response, attained by a bang-bang residual; of several derivatives a linear
        programme, enclosed from both sides. "ellipsoid": the best invariant
        ellipsoid. "lyapunov": the textbook's ball with Q = I in companion coordinates, time scaled by the filter's
        speed; "lyapunov-raw" unscaled. All but "exact" are for continuous filters.

    Returns
    -------
    ErrorBound, or PerChannel of it

    Raises
    ------
    TypeError
        For a disturbance of another kind.
    ValueError
        For no residual at all, bounds of derivatives only beyond the type of the filter, as then the error grows
        without bound, or what only :func:`tracking_error` counts: parts that add up, actuation, position_noise.

    Notes
    -----
    The paper proves that the error ends in a ball "proportional to" its forcing. Here the forcing is
    ``D f_err = sum_k c_k gamma^(k) + N (M - M_hat) x'``, c_k = a_k - b_k, taken one derivative at a time.

    A sampled filter knows g and f_theta at the samples only. Without ``implementation`` its bound holds where they go
    between them as ``g`` and ``f_theta`` of the filter say, held or straight; that, and all else that is taken for
    granted, is in ``assumptions`` of the result. It may be most of the error: one pole at 20 rad/s, gamma = 0.5 sin 2t
    and a smooth g = 8 sin 6t under the default g="hold" err by 5.1 times the bound at 10 ms and 9.6 times at 20 ms.
    With ``implementation=Implementation(g={1: 48.0})`` the bound holds; g' and gamma' of constant sign attain it.

    A ramp of slope r leaves an error that a sampled filter of type 2 or more does not lose: b_(n-1) r h^2/12 and terms
    of h^4 with method="exact", -r h/2 with "euler", none with "matched" and "tustin"; and r times its delay with any.

    Examples
    --------
    A residual that changes by at most 3 per second, through two poles at -20 rad/s:

    >>> round(error_bound(PhyFilter([400.0, 40.0]), {1: 3.0}).bound, 9)
    0.3
    """
    filter = checked_filter(filter)
    if not isinstance(method, str) or method not in get_args(Method):
        raise ValueError(f"method: expected one of {', '.join(get_args(Method))}, got {method!r}")
    bounds = of_error(disturbance)
    implementation, noise, rate = bounds.implementation, bounds.noise, bounds.rate or 0.0
    inertia_error, given = bounds.inertia_error, dict(bounds.parts[0])
    inputs = input_gains(filter, inertia, needed=bool(noise or implementation))
    wrong, heard = inputs.g * inertia_error * rate, inputs.x * noise
    if isinstance(filter, SampledPhyFilter):
        if method != "exact":
            raise ValueError(
                f"method={method!r} is for continuous filters: use method='exact' for a sampled one"
            )
        sampled = SampledKernels(filter)
        usable = _usable(given, sampled.highest, filter)
        enclosures = {k: sampled.error(k) for k in usable}
        gains = {k: enclosure.upper for k, enclosure in enclosures.items()}
        inertia_gain = sampled.estimate().upper if wrong else 0.0
        noise_gain = sampled.noise().upper if heard else 0.0
        run = Run(sampled, implementation or Implementation(), rate, noise, inputs)
        terms, covered, assumed = run.terms(), run.covered(), run.assumed()
        proofs: dict[int, QuadraticProof] = {}
    else:
        if implementation is not None:
            raise ValueError("implementation: is for sampled filters; take filter.sampled(dt)")
        terms, covered, assumed = {}, (), ()
        usable = _usable(given, filter.type, filter)
        enclosures = {k: kernels.error_kernel(filter, k).l1 for k in usable} if method == "exact" else {}
        results = {
            k: _gain(kernels.error_kernel(filter, k), method, filter, enclosures.get(k)) for k in usable
        }
        gains = {k: gain for k, (gain, _) in results.items()}
        proofs = {k: proof for k, (_, proof) in results.items() if proof is not None}
        inertia_gain = _gain_of(kernels.estimate_kernel(filter), method, filter) if wrong else 0.0
        noise_gain = _gain_of(kernels.noise_kernel(filter), method, filter) if heard else 0.0
    best = min(usable, key=lambda k: gains[k] * given[k])
    intrinsic, certificate = gains[best] * given[best], enclosures.get(best)
    course = together_of(filter, given) if method == "exact" and len(given) > 1 and intrinsic > 0.0 else None
    if course is not None and certificate is not None:
        intrinsic = min(intrinsic, course.upper)
        certificate = certificate._replace(
            lower=min(course.lower, intrinsic), upper=intrinsic, points=len(course.knots)
        )
    return ErrorBound(
        filter,
        method,
        given,
        intrinsic,
        inertia_gain * wrong,
        noise_gain * heard,
        best,
        gains,
        certificate,
        proofs.get(best),
        terms,
        covered,
        assumed,
        course,
        0.0 if implementation is None else implementation.jitter,
    )


def _gain_of(kernel: Kernel, method: Method, filter: PhyFilter) -> float:
    return _gain(kernel, method, filter, kernel.l1 if method == "exact" else None)[0]


def _gain(
    kernel: Kernel, method: Method, filter: PhyFilter, enclosure: Certificate | None
) -> tuple[float, QuadraticProof | None]:
    """Peak-to-peak gain by the method, and its proof."""
    if enclosure is not None:
        return enclosure.upper, None
    speed = 1.0 / kernel.unit
    if method == "ellipsoid":
        found = quadratic.ellipsoid(kernel.A, kernel.B, kernel.C)
        decay = found.decay * speed
    elif method == "lyapunov":
        found = quadratic.ball(filter.a / speed ** np.arange(filter.order, 0, -1.0), kernel.numerator)
        decay = found.decay * speed
    else:
        found = quadratic.ball(filter.a, kernel.numerator * speed ** np.arange(filter.order, 0, -1.0))
        decay = found.decay
    return abs(kernel.gain) * (abs(kernel.direct) + found.gain), QuadraticProof(found.P, decay)


def of_error(disturbance: Bounded | Mapping[int, float]) -> Bounded:
    """Bounds of what makes the estimate err.

    Raises
    ------
    TypeError
        For a disturbance of another kind.
    ValueError
        Without a residual, or for bounds of what the estimate does not see.
    """
    bounds = bounded(disturbance)
    if not any(bounds.parts):
        raise ValueError(
            "residual: expected a bound of gamma or of a derivative of it, e.g. {1: 2.0}; got none"
        )
    if len(bounds.parts) > 1:
        raise ValueError(
            f"residual: expected the bounds of one residual, got {len(bounds.parts)} parts that add up, which are for "
            "tracking_error; one for each channel is a list of Bounded"
        )
    if bounds.actuation or bounds.position_noise:
        raise ValueError("actuation, position_noise: do not enter the estimate's error; see tracking_error")
    return bounds


def _usable(given: Mapping[int, float], limit: int, filter: PhyFilter | SampledPhyFilter) -> list[int]:
    usable = [k for k in given if k <= limit]
    if not usable:
        shared, least = filter.filter if isinstance(filter, SampledPhyFilter) else filter, min(given)
        if isinstance(filter, SampledPhyFilter) and shared.type > limit:
            reason = f"infinite: {_left_over(filter, limit)}; bound a derivative up to order {limit}"
        else:
            type_helps = isinstance(filter, PhyFilter) or least == 1
            other = f", or use a filter of type {least}, place_poles(..., type={least})" if type_helps else ""
            reason = (
                f"infinite: the filter is of type {shared.type}, so a residual whose derivative of order {least} is "
                f"bounded can grow without end and the error with it; bound a derivative up to order {limit}{other}"
            )
        raise ValueError(f"residual: the bound from derivative {least} is {reason}")
    return usable


def _left_over(sampled: SampledPhyFilter, limit: int) -> str:
    """What stands against a bound from a derivative that the type would allow."""
    method, late = sampled.sampling.method, sampled.sampling.delay > 0.0
    if limit > 1:
        return f"sampled with method={method!r}, the filter leaves an error of residuals t^{limit}; use 'matched'"
    left = {"exact": [f"b_{sampled.order - 1} h^2/12"], "euler": ["-h/2"]}.get(method, [])
    left += ["its delay"] if late else []
    return (
        f"sampled with method={method!r}, the filter leaves {' and '.join(left)} times the slope of a ramp as a steady "
        f"error, and the slope can grow without end{'' if late else '; use method=' + repr('matched')}"
    )
