"""How large the error can become: the paper's ultimate bound as a number, as tight as it can be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple, get_args

import control as ct
import numpy as np
from numpy.typing import ArrayLike

from ... import _signals
from ..._sections import FloatArray
from ...filter import PhyFilter, SampledPhyFilter
from ...results import Result
from ..channels import per_channel
from . import kernels, quadratic
from .kernels import Certificate, Kernel
from .sampled_kernels import SampledKernels

__all__ = ["BoundResult", "QuadraticProof", "ultimate_bound"]

Method = Literal["exact", "ellipsoid", "lyapunov", "lyapunov-raw"]


class QuadraticProof(NamedTuple):
    """What stands behind a bound that is not exact.

    Attributes
    ----------
    P : (n, n) array
        Lyapunov matrix, n the order of the filter.
    decay : float
        Rate in 1/s.
    """

    P: FloatArray
    decay: float


@dataclass(frozen=True, eq=False, repr=False)
class BoundResult(Result):
    """What a filter promises; made by :func:`ultimate_bound`.

    Attributes
    ----------
    system : PhyFilter or SampledPhyFilter
        The filter.
    method : str
        How the bound was found.
    residual : dict of int to float
        Bounds of derivatives as given.
    bound : float
        |f - f_hat| stays below it once the start is forgotten: ``intrinsic + prior + noise``. At the samples, for a
        sampled filter; see ``between_samples``.
    intrinsic, prior, noise : float
        Its parts: from the residual, from the wrong inertia, from the noise of x.
    derivative : int or None
        Which derivative of the residual gave the least bound.
    gains : dict of int to float
        Worst-case gain for each derivative given, in s^k.
    exact : bool
        Whether some residual within the bounds attains ``intrinsic``: one derivative given, method "exact". With
        several it is the least upper bound of the single ones.
    certificate : Certificate
        Enclosure of the gain that was used, truncation included ("exact" only).
    proof : QuadraticProof or None
        P and decay rate of "ellipsoid" and "lyapunov".
    assumptions : tuple of str
        What must hold between the samples for the bound of a sampled filter to hold; empty for a continuous one.
    """

    _figures = (
        "system",
        "method",
        "residual",
        "bound",
        "intrinsic",
        "prior",
        "noise",
        "between_samples",
        "derivative",
        "gains",
        "exact",
        "certificate",
        "assumptions",
    )

    system: PhyFilter | SampledPhyFilter
    method: Method
    residual: dict[int, float]
    intrinsic: float
    prior: float
    noise: float
    derivative: int | None
    gains: dict[int, float]
    certificate: Certificate | None
    proof: QuadraticProof | None
    assumptions: tuple[str, ...] = ()

    @property
    def bound(self) -> float:
        """Sum of the parts."""
        return self.intrinsic + self.prior + self.noise

    @property
    def exact(self) -> bool:
        """Whether the intrinsic part is attained."""
        return self.method == "exact" and len(self.residual) <= 1

    @property
    def between_samples(self) -> float:
        """Bound at every time, for a sampled filter whose correction f_hat - f_theta is held between its samples.

        For a bounded gamma the same; else larger by what gamma can move in a step, which without a bound of gamma' has
        no end.
        """
        if isinstance(self.system, SampledPhyFilter) and self.derivative:
            return self.bound + self.system.dt * self.residual.get(1, float("inf"))
        return self.bound

    @cached_property
    def _kernel(self) -> Kernel:
        if not isinstance(self.system, PhyFilter) or self.derivative is None:
            raise ValueError(
                "expected a continuous filter and a bound of the residual or of a derivative of it"
            )
        return kernels.error_kernel(self.system, self.derivative)

    def worst_residual(self, times: ArrayLike) -> FloatArray:
        """The bang-bang course of gamma^(k) that drives the error to ``intrinsic`` at the last of the times.

        Parameters
        ----------
        times : (N,) array
            Ascending, in seconds.

        Returns
        -------
        (N,) array
            +-delta_k.

        Raises
        ------
        ValueError
            For a sampled filter, or where no residual was bounded.

        Examples
        --------
        >>> import numpy as np
        >>> result = ultimate_bound(PhyFilter([400.0, 40.0]), residual={1: 3.0})
        >>> result.worst_residual(np.linspace(0.0, 1.0, 3)).tolist()
        [3.0, 3.0, 3.0]
        """
        kernel = self._kernel
        t = _signals.sample_times("times", times)
        assert self.derivative is not None
        signs = np.where(kernel.gain * kernel.at(t[-1] - t) >= 0.0, 1.0, -1.0)
        return self.residual[self.derivative] * signs

    def envelope(self, times: ArrayLike, initial: Mapping[int, float] | None = None) -> FloatArray:
        """Bound of the error over time from a start at f_hat = f_theta.

        Parameters
        ----------
        times : (N,) array
            Seconds since the start.
        initial : dict of int to float, optional
            Bounds of |gamma^(j)(0)|, j = 0 ... k - 1 with k = ``derivative``; None means the filter's error at the
            start is 0.

        Returns
        -------
        (N,) array

        Raises
        ------
        ValueError
            For a sampled filter, or an initial derivative out of range.

        Examples
        --------
        >>> result = ultimate_bound(PhyFilter([20.0]), residual={1: 1.0})
        >>> result.envelope([0.0, 0.05, 1.0], initial={0: 2.0}).round(4).tolist()
        [2.0, 0.7674, 0.05]
        """
        kernel = self._kernel
        t = _signals.array("times", _signals.seconds("times", times), ("N",))
        k = self.derivative
        assert k is not None
        assert isinstance(self.system, PhyFilter)
        total = self.prior + self.noise + self.residual[k] * kernel.running(t)
        for j, value in (initial or {}).items():
            if not 0 <= j < k:
                raise ValueError(f"initial: expected derivatives 0 ... {k - 1}, got {j}")
            total = total + value * np.abs(kernels.error_kernel(self.system, j + 1).at(t))
        return total

    def plot(self) -> ct.ControlPlot:
        """Impulse response from the bounded derivative to the error, and how the bound builds up.

        Returns
        -------
        control.ControlPlot
        """
        from ... import plots

        kernel = self._kernel
        t = np.linspace(0.0, 0.6 * kernel.l1.horizon, 1000)
        assert self.derivative is not None
        return plots.bound_plot(
            t,
            kernel.at(t),
            self.residual[self.derivative] * kernel.running(t),
            self.derivative,
            self.intrinsic,
        )


@per_channel
def ultimate_bound(
    filter: PhyFilter | SampledPhyFilter,
    *,
    residual: Mapping[int, float],
    inertia_error: float = 0.0,
    rate: float = 0.0,
    noise: float = 0.0,
    inertia: float = 1.0,
    method: Method = "exact",
) -> BoundResult:
    """Bound of |f - f_hat| after all transients.

    ``|f_err| <= min_k ||(1 - F) / s^k||_1 delta_k + ||F||_1 delta_M delta_x + ||s F||_1 |M_hat| |nu|``

    Parameters
    ----------
    filter : PhyFilter, SampledPhyFilter or several
        Sampled: exact for a residual that goes on between the samples, as long as g and f_theta go between them as its
        options say (see Notes). Several, by ``stack`` or as a sequence: the answer is a ``PerChannel`` of what each
        channel promises for itself, and every other argument one for all or a list.
    residual : dict of int to float
        delta_k: bounds of the k-th derivative of gamma = f - f_theta (2-norm), e.g. ``{0: 4.0, 1: 12.0}``; of a sampled
        filter k = 0 and 1 count, with method="matched" and no delay all up to its type.
    inertia_error : float
        delta_M: bound of M - M_hat in the spectral norm.
    rate : float
        delta_x: bound of |x'|.
    noise : float
        Bound of the noise of x.
    inertia : float
        |M_hat| in the spectral norm, by which noise of x counts.
    method : {"exact", "ellipsoid", "lyapunov", "lyapunov-raw"}
        "exact": the L1 norm of the impulse response, attained by a bang-bang residual. "ellipsoid": the best invariant
        ellipsoid. "lyapunov": the textbook's ball with Q = I in companion coordinates, time scaled by the filter's
        speed; "lyapunov-raw" unscaled. All but "exact" are for continuous filters.

    Returns
    -------
    BoundResult, or PerChannel of it

    Raises
    ------
    ValueError
        For negative bounds, no residual at all, or bounds of derivatives only beyond the type of the filter: then the
        error grows without bound.

    Notes
    -----
    The paper proves that the error ends in a ball "proportional to" its forcing. Here the forcing is
    ``D f_err = sum_k c_k gamma^(k) + N (M - M_hat) x'``, c_k = a_k - b_k, taken one derivative at a time.

    A sampled filter knows g and f_theta at the samples only. Its bound holds where they go between them as ``g`` and
    ``f_theta`` of the filter say, held or straight; what they do otherwise enters the residual and is not in the bound:
    ``assumptions`` of the result. It may be most of the error: one pole at 20 rad/s, gamma = 0.5 sin 2t and a smooth
    g = 8 sin 6t under the default g="hold" err by 5.1 times the bound at 10 ms and 9.6 times at 20 ms, under
    g="average" by 1.004 and 1.09 times.

    A ramp of slope r leaves an error that a sampled filter of type 2 or more does not lose: b_(n-1) r h^2/12 and terms
    of h^4 with method="exact", -r h/2 with "euler", none with "matched" and "tustin"; and r times its delay with any.

    Examples
    --------
    A residual that changes by at most 3 per second, through two poles at -20 rad/s:

    >>> round(ultimate_bound(PhyFilter([400.0, 40.0]), residual={1: 3.0}).bound, 9)
    0.3
    """
    if method not in get_args(Method):
        raise ValueError(f"method: expected one of {', '.join(get_args(Method))}, got {method!r}")
    given = _checked(
        residual, {"inertia_error": inertia_error, "rate": rate, "noise": noise, "inertia": inertia}
    )
    prior, noise = inertia_error * rate, noise * inertia
    if isinstance(filter, SampledPhyFilter):
        if method != "exact":
            raise ValueError(
                f"method={method!r} is for continuous filters: use method='exact' for a sampled one"
            )
        sampled = SampledKernels(filter)
        usable = _usable(given, sampled.highest, filter)
        enclosures = {k: sampled.error(k) for k in usable}
        gains = {k: enclosure.upper for k, enclosure in enclosures.items()}
        prior_gain = sampled.estimate().upper if prior else 0.0
        noise_gain = sampled.noise().upper if noise else 0.0
        proofs: dict[int, QuadraticProof] = {}
    else:
        usable = _usable(given, filter.type, filter)
        enclosures = {k: kernels.error_kernel(filter, k).l1 for k in usable} if method == "exact" else {}
        results = {
            k: _gain(kernels.error_kernel(filter, k), method, filter, enclosures.get(k)) for k in usable
        }
        gains = {k: gain for k, (gain, _) in results.items()}
        proofs = {k: proof for k, (_, proof) in results.items() if proof is not None}
        prior_gain = _gain_of(kernels.estimate_kernel(filter), method, filter) if prior else 0.0
        noise_gain = _gain_of(kernels.noise_kernel(filter), method, filter) if noise else 0.0
    best = min(usable, key=lambda k: gains[k] * given[k], default=None)
    return BoundResult(
        filter,
        method,
        given,
        0.0 if best is None else gains[best] * given[best],
        prior_gain * prior,
        noise_gain * noise,
        best,
        gains,
        None if best is None else enclosures.get(best),
        None if best is None else proofs.get(best),
        _assumptions(filter) if isinstance(filter, SampledPhyFilter) else (),
    )


def _assumptions(sampled: SampledPhyFilter) -> tuple[str, ...]:
    between = {"hold": "is held between the samples", "average": "goes straight from sample to sample"}
    said = [f"{name} {between[getattr(sampled.sampling, name)]}" for name in ("g", "f_theta")]
    return (*said, *(["f_hat stays within its limit"] if sampled.sampling.limit is not None else []))


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


def _checked(residual: Mapping[int, float], others: Mapping[str, float]) -> dict[int, float]:
    for name, value in others.items():
        if not (np.isfinite(value) and value >= 0.0):
            raise ValueError(f"{name}: expected a bound of 0 or more, got {value}")
    given: dict[int, float] = {}
    for k, value in residual.items():
        if not (isinstance(k, int | np.integer) and k >= 0):
            raise ValueError(f"residual: expected derivative orders 0, 1, ..., got {k!r}")
        if not (np.isfinite(value) and value >= 0.0):
            raise ValueError(f"residual[{k}]: expected a bound of 0 or more, got {value}")
        given[int(k)] = float(value)
    if not given:
        raise ValueError(
            "residual: expected a bound of gamma or of a derivative of it, e.g. {1: 2.0}; got none"
        )
    return given


def _usable(given: Mapping[int, float], limit: int, filter: PhyFilter | SampledPhyFilter) -> list[int]:
    usable = [k for k in given if k <= limit]
    if not usable:
        shared, least = filter.filter if isinstance(filter, SampledPhyFilter) else filter, min(given)
        if isinstance(filter, SampledPhyFilter) and shared.type > limit:
            reason = f"infinite: {_left_over(filter, limit)}; bound a derivative up to order {limit}"
        else:
            type_helps = isinstance(filter, PhyFilter) or least == 1
            other = f", or use a filter of type {least} (numerator_of_type)" if type_helps else ""
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
