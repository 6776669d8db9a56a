"""What a filter promises, as a result: the bound, its parts, what stands behind it and what it rests on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Literal, NamedTuple

import control as ct
import numpy as np
from numpy.typing import ArrayLike

from ... import _signals
from ..._renamed import former_field
from ..._sections import FloatArray
from ...filter import PhyFilter, SampledPhyFilter
from ...results import Result
from ..options import units_of
from . import kernels
from .kernels import Certificate, Kernel
from .sampled_kernels import SampledKernels
from .together import Together, together_of

__all__ = ["ErrorBound", "Method", "QuadraticProof"]

# How close a course within all bounds comes to a bound that is called exact.
_ATTAINED = 1e-2

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
class ErrorBound(Result):
    """What a filter promises; made by :func:`error_bound`.

    Attributes
    ----------
    system : PhyFilter or SampledPhyFilter
        The filter.
    method : str
        How the bound was found.
    residual : dict of int to float
        Bounds of derivatives as given.
    bound : float
        |f - f_hat| stays below it once the start is forgotten: the sum of ``parts``. At the samples, for a sampled
        filter; see ``between_samples``.
    intrinsic, inertia, noise : float
        Its parts: from the residual, from the wrong inertia, from the noise of x.
    implementation : dict of str to float
        Further parts, from what the filter meets as it runs; see :class:`Implementation`.
    derivative : int or None
        Which derivative of the residual alone gives the least bound.
    gains : dict of int to float
        Worst-case gain for each derivative given, in s^k.
    exact : bool
        Whether some residual within the bounds attains ``intrinsic`` to 1 %: method "exact", and with several
        derivatives the gap of the certificate.
    certificate : Certificate
        Enclosure of the gain that was used; of ``intrinsic`` itself with several derivatives ("exact" only). Rounded
        outwards.
    proof : QuadraticProof or None
        P and decay rate of "ellipsoid" and "lyapunov".
    covered, assumptions : tuple of str
        What a sampled filter's bound holds for beyond the ideal, and what it takes for granted; empty for a continuous
        one.
    course : Together or None
        Of several derivatives, the enclosure and the worst course that :meth:`worst_residual` gives.
    jitter : float
        How far in s a sampling instant may be off the grid.
    """

    _figures = (
        "system",
        "method",
        "residual",
        "bound",
        "intrinsic",
        "inertia",
        "noise",
        "implementation",
        "between_samples",
        "derivative",
        "gains",
        "exact",
        "certificate",
        "covered",
        "assumptions",
        "unit",
    )
    _units = MappingProxyType(
        dict.fromkeys(("bound", "intrinsic", "inertia", "noise", "implementation", "between_samples"), "{}")
    )
    _answer = ("bound",)

    system: PhyFilter | SampledPhyFilter
    method: Method
    residual: dict[int, float]
    intrinsic: float
    inertia: float
    noise: float
    derivative: int | None
    gains: dict[int, float]
    certificate: Certificate | None
    proof: QuadraticProof | None
    implementation: dict[str, float] = field(default_factory=dict)
    covered: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()
    course: Together | None = field(default=None, repr=False)
    jitter: float = field(default=0.0, repr=False)

    @property
    def prior(self) -> float:
        """``inertia`` by its name of 0.2."""
        return former_field(self, "prior", "inertia")

    @property
    def parts(self) -> dict[str, float]:
        """What the bound is the sum of, by name."""
        return {
            "residual": self.intrinsic,
            "inertia": self.inertia,
            "noise": self.noise,
            **self.implementation,
        }

    @property
    def bound(self) -> float:
        """Sum of the parts."""
        return sum(self.parts.values())

    @property
    def unit(self) -> str:
        """Of f, where the filter knows it."""
        return units_of(self.system).get("f", "")

    @property
    def exact(self) -> bool:
        """Whether the intrinsic part is attained."""
        if self.method != "exact" or self.certificate is None:
            return False
        return len(self.residual) == 1 or (self.course is not None and self.certificate.gap <= _ATTAINED)

    @cached_property
    def between_samples(self) -> float:
        """Bound at every time, for a sampled filter whose correction f_hat - f_theta is held between its samples.

        The bound of the same filter one step later: an estimate held until t_k + tau is late by tau, and a residual
        that is largest inside a step can stay there until its end. Infinite where neither gamma nor gamma' is bounded.
        Bounds of derivatives above the second are left out of it, since a residual that stays breaks them. Of samples
        that jitter an estimate is held longer by the jitter, and may come before its place on the grid.
        """
        sampled = self.system
        if not isinstance(sampled, SampledPhyFilter) or set(self.residual) == {0}:
            return self.bound
        sampling = sampled.sampling
        later = replace(sampling, delay=sampling.delay + sampling.dt + self.jitter)
        late = SampledPhyFilter(sampled.filter, later)
        given = {k: value for k, value in self.residual.items() if k <= 2}
        kernel = SampledKernels(late)
        found = [kernel.error(k).upper * given[k] for k in given if k <= kernel.highest]
        if found and len(given) > 1 and (course := together_of(late, given)) is not None:
            found.append(course.upper)
        held = min(found, default=float("inf"))
        early = self.intrinsic + (self.jitter * given.get(1, float("inf")) if self.jitter else 0.0)
        if 0 in given:  # the gain is the same at any delay
            early = max(self.intrinsic, min(early, kernel.error(0).upper * given[0]))
        return self.bound - self.intrinsic + max(early, held)

    def describe(self) -> str:
        """The bound, its parts and what it rests on, in a few lines.

        Examples
        --------
        >>> from phyfilter_ctl import Bounded, PhyFilter, error_bound
        >>> print(error_bound(PhyFilter([20.0]), Bounded({1: 3.0}, noise=0.01)).describe())
        bound             0.55 = residual 0.15 + noise 0.4
        from              derivative 1 of gamma; attained by a bang-bang residual
        """
        parts = [f"{name} {value:.4g}" for name, value in self.parts.items() if value] or ["nothing"]
        unit = f" {self.unit}" if self.unit else ""
        lines = [_line("bound", f"{self.bound:.6g}{unit} = {' + '.join(parts)}")]
        if isinstance(self.system, SampledPhyFilter):
            lines.append(_line("between samples", f"{self.between_samples:.6g}{unit}"))
        if self.derivative is not None:
            if self.course is not None and self.certificate is not None:
                orders = " and ".join(map(str, sorted(self.residual)))
                said = f"derivatives {orders} of gamma together; attained to {self.certificate.gap:.1g} of it"
            else:
                kind = "attained by a bang-bang residual" if self.exact else "an upper bound"
                said = f"derivative {self.derivative} of gamma; {kind}"
            lines.append(_line("from", said))
        lines += [_line("holds for", text) for text in self.covered]
        lines += [_line("as long as", text) for text in self.assumptions]
        return "\n".join(lines)

    @cached_property
    def _kernel(self) -> Kernel:
        if not isinstance(self.system, PhyFilter) or self.derivative is None:
            raise ValueError(
                "expected a continuous filter and a bound of the residual or of a derivative of it"
            )
        return kernels.error_kernel(self.system, self.derivative)

    def worst_residual(self, times: ArrayLike) -> FloatArray:
        """The course of gamma^(k) that drives the error to ``intrinsic`` at the last of the times.

        k is the derivative bounded; of several the lowest, and the course keeps all bounds.

        Parameters
        ----------
        times : (N,) array
            Ascending, in seconds.

        Returns
        -------
        (N,) array
            +-delta_k; with several derivatives bounded between them.

        Raises
        ------
        ValueError
            Where no residual was bounded.

        Examples
        --------
        >>> import numpy as np
        >>> from phyfilter_ctl import PhyFilter, error_bound
        >>> result = error_bound(PhyFilter([400.0, 40.0]), {1: 3.0})
        >>> result.worst_residual(np.linspace(0.0, 1.0, 3)).tolist()
        [3.0, 3.0, 3.0]
        """
        t = _signals.sample_times("times", times)
        if self.course is not None:
            return self.course.at(t[-1] - t)
        if isinstance(self.system, SampledPhyFilter) and self.derivative is not None:
            values = SampledKernels(self.system).at(self.derivative, t[-1] - t)
        else:
            values = self._kernel.gain * self._kernel.at(t[-1] - t)
        signs = np.where(values >= 0.0, 1.0, -1.0)
        if self.derivative == 0:
            signs[-1] = 1.0  # what the residual is now is in the error itself
        assert self.derivative is not None
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

        Notes
        -----
        It tends to ``bound``. Of several derivatives gamma is taken to have kept the bounds before the start too.

        Examples
        --------
        >>> from phyfilter_ctl import PhyFilter, error_bound
        >>> result = error_bound(PhyFilter([20.0]), {1: 1.0})
        >>> result.envelope([0.0, 0.05, 1.0], initial={0: 2.0}).round(4).tolist()
        [2.0, 0.7674, 0.05]
        """
        t = _signals.array("times", _signals.seconds("times", times), ("N",))
        k = self.derivative
        assert k is not None
        assert isinstance(self.system, PhyFilter)
        total = self.inertia + self.noise + self._grown(t)
        for j, value in (initial or {}).items():
            if not 0 <= j < k:
                raise ValueError(f"initial: expected derivatives 0 ... {k - 1}, got {j}")
            total = total + value * np.abs(kernels.error_kernel(self.system, j + 1).at(t))
        return total

    def _grown(self, t: FloatArray) -> FloatArray:
        """Bound of what gamma makes of the error since a start from 0, (N,).

        The error of a filter that has always run, which is within ``intrinsic``, less what its past still makes of it:
        at most delta_k times what is left of the kernel's integral.
        """
        assert self.derivative is not None
        kernel, size = self._kernel, self.residual[self.derivative]
        whole, grown = kernel.l1, kernel.running(t)
        if len(self.residual) == 1:
            return size * grown
        left = whole.upper - grown + (whole.upper - whole.lower)
        return np.minimum(size * grown, self.intrinsic + size * left)

    def plot(self) -> ct.ControlPlot:
        """Impulse response from the bounded derivative to the error, and how the bound builds up.

        Returns
        -------
        control.ControlPlot
        """
        from ...plots.promises import bound_plot

        kernel = self._kernel
        t = np.linspace(0.0, 0.6 * kernel.l1.horizon, 1000)
        assert self.derivative is not None
        return bound_plot(
            t,
            kernel.at(t),
            self._grown(t),
            self.derivative,
            self.intrinsic,
        )


def _line(name: str, text: str) -> str:
    return f"{name:<18}{text}"
