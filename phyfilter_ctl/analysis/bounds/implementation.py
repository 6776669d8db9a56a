"""What a filter meets as it runs: signals that move between its samples, a clock, steps of converters, arithmetic.

The recursion is fed with u = M' dx / h - (g + f_theta as the rules take them). The mean of gamma over the step is what
the bounds of ``sampled_kernels`` are for; the rest is a disturbance of u, or noise of x, and both have their gains:

* a disturbance d of u: ||h||_1 |d|, h the impulse response of the recursion;
* noise v of x: ||h_i - h_(i-1)||_1 |M_hat| |v| / h, and ||h||_1 |M_hat'| |v| where M_hat moves.

With E what comes from x and g passes E^+ on its way to u: |E^+ M_hat| for |M_hat|, |E^+| times all other forces.

The disturbances are kernels against what is bounded (Peano's): the mean of g over a step less g at its beginning is
the integral of (1 - s/h) g'(s) ds, at most h/2 |g'|; less the mean of both ends h/4 |g'| or h^2/12 |g''|.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...filter import SampledPhyFilter
from ...values import Implementation
from ..options import InputGains, assumed
from .rounding import AXES, rounding_error
from .sampled_kernels import SampledKernels

__all__ = ["Run"]

# Means over one period of |v - what the rule takes| for a window that begins inside a step: hold, straight lines.
_LATE_LINES = 1.0 / 3.0


@dataclass(frozen=True, eq=False)
class Run:
    """The terms of one sampled filter, with what they cover and what is still assumed.

    Parameters
    ----------
    kernels : SampledKernels
    bounds : Implementation
    rate, noise : float
        |x'|, noise of x.
    gains : InputGains
        What M_hat and E make of x and g.
    """

    kernels: SampledKernels
    bounds: Implementation
    rate: float
    noise: float
    gains: InputGains

    def __post_init__(self) -> None:
        needs = [name for name in ("jitter", "delay_error") if getattr(self.bounds, name)]
        needs += ["inertia"] if self.bounds.inertia else []
        needs += ["x[0]"] if 0 in self.bounds.x else []
        if needs and not self.rate > 0.0:
            raise ValueError(f"{needs[0]}: what it does grows with |x'|; give its bound too, rate=...")
        sampling = self.sampled.sampling
        for name in ("g", "f_theta"):
            given = getattr(self.bounds, name)
            if 2 in given and 1 not in given and getattr(sampling, name) == "hold":
                raise ValueError(
                    f"{name}: |{name}''| says nothing of a signal that is taken as held; give its rate, "
                    f"{{1: ...}}, or sample with {name}='average'"
                )

    @property
    def sampled(self) -> SampledPhyFilter:
        """The filter."""
        return self.kernels.sampled

    @property
    def _off_grid(self) -> bool:
        """Whether the delayed steps begin inside the steps of the signals."""
        steps = self.sampled.sampling.delay_steps
        return abs(steps - round(steps)) > 1e-9

    def terms(self) -> dict[str, float]:
        """Error from each, by name; those that are 0 are left out."""
        of_f, of_x = self.kernels.estimate().upper, self.kernels.noise().upper
        of_u = of_f * self.gains.g  # of forces that pass E^+, as f_theta does not
        b, V = self.bounds, self.rate
        turning = b.inertia.get(1, 0.0)  # |M_hat'|, which is no matter where it is bounded by its second only

        def like_noise(size: float) -> float:
            return (of_x * self.gains.x + of_u * turning) * size

        late = b.delay_error * V
        delay = like_noise(late)
        if 2 in b.x:
            delay = min(delay, of_f * self.gains.x * b.x[2] * b.delay_error)
        early = b.g.get(1, 0.0) + turning * V
        found = {
            "g between samples": of_u * self._between("g"),
            "f_theta between samples": of_f * self._between("f_theta"),
            "inertia between samples": of_u * self._turning() + of_u * turning * self.noise,
            "jitter": like_noise(b.jitter * V)
            + (of_u * early + (1.0 + of_f) * b.f_theta.get(1, 0.0)) * b.jitter,
            "delay": delay,
            "quantisation": like_noise(0.5 * b.x_step) + of_u * 0.5 * b.g_step,
            "rounding": self._rounding(of_f, of_x),
            "limit": self._beyond_limit(),
        }
        return {name: float(value) for name, value in found.items() if value > 0.0}

    def _between(self, name: str) -> float:
        """Bound of |mean over a step - what the rule takes| of g or f_theta."""
        h, given = self.sampled.dt, getattr(self.bounds, name)
        if getattr(self.sampled.sampling, name) == "hold":
            return 0.5 * h * given.get(1, 0.0)
        share = _LATE_LINES if self._off_grid else 0.25
        found = [share * h * given[1]] if 1 in given else []
        found += [h * h / 12.0 * given[2]] if 2 in given else []
        return min(found, default=0.0)

    def _turning(self) -> float:
        """Bound of |mean of both ends of M_hat times mean of x' - mean of M_hat x'| over a step.

        m(s) = M_hat(s) - the mean of its ends has m(0) = -m(h), so goes on as a function that changes its sign every h;
        of those |m|, as its root mean square, is at most h/pi |m'| in the mean (Wirtinger). With |x''| the mean of m
        counts, h^2/12 |M_hat''|, and the covariance of m and x', at most h^2/12 |M_hat'| |x''| (Chebyshev).
        """
        b, h, V, late = self.bounds, self.sampled.dt, self.rate, self._off_grid
        found = []
        if 1 in b.inertia:
            found.append((h / np.pi + (0.5 * h if late else 0.0)) * b.inertia[1] * V)
        if {1, 2} <= set(b.inertia) and 2 in b.x:
            square = b.inertia[2] * V * (1.0 / 12.0 + (0.125 if late else 0.0)) + b.inertia[1] * b.x[2] / 12.0
            found.append(h * h * square)
        if b.inertia and not found:
            raise ValueError("inertia: expected the bound of |M_hat'| too, {1: ...}")
        return min(found, default=0.0)

    def _rounding(self, of_f: float, of_x: float) -> float:
        b = self.bounds
        if 0 not in b.x:
            return b.rounding
        if self.sampled.sampling.delay:
            raise ValueError("x[0]: the bound of the rounding is for filters without delay; leave it out")
        sizes = (b.x[0], self.rate, b.g.get(0, 0.0), b.f_theta.get(0, 0.0))
        return rounding_error(self.kernels, sizes, self.gains, of_f, of_x)

    def _beyond_limit(self) -> float:
        """A projection on a convex set brings nothing further from a point of it, and f is that far from the set."""
        limit = self.sampled.sampling.limit
        return (
            0.0 if limit is None or self.bounds.f is None else max(self.bounds.f - float(np.min(limit)), 0.0)
        )

    # -- in words ---------------------------------------------------------------------------------------------------

    def covered(self) -> tuple[str, ...]:
        """What the bound holds for beyond the ideal."""
        b, said = self.bounds, []
        for name in ("g", "f_theta"):
            rates = sorted((k, v) for k, v in getattr(b, name).items() if k)
            said += [f"|{_primed(name, k)}| up to {v:g} between the samples" for k, v in rates]
        said += [f"|{_primed('M_hat', k)}| up to {v:g}" for k, v in sorted(b.inertia.items())]
        said += [f"|x''| up to {b.x[2]:g}"] if 2 in b.x else []
        said += [f"sampling instants up to {b.jitter:g} s off the grid"] if b.jitter else []
        said += [f"a delay of x off by up to {b.delay_error:g} s"] if b.delay_error else []
        said += [f"x in steps of {b.x_step:g}"] if b.x_step else []
        said += [f"g in steps of {b.g_step:g}"] if b.g_step else []
        said += [f"rounding that moves f_hat by up to {b.rounding:g}"] if b.rounding else []
        if 0 in b.x:
            sizes = [f"|x| up to {b.x[0]:g}"] + [
                f"|{name}| up to {getattr(b, name).get(0, 0.0):g}" for name in ("g", "f_theta")
            ]
            said.append(
                f"rounding in {self.sampled.sampling.precision} of up to {AXES} axes, {', '.join(sizes)}"
            )
        if self.sampled.sampling.limit is not None and b.f is not None:
            said.append(f"f_hat at its limit, |f| up to {b.f:g}")
        return tuple(said)

    def assumed(self) -> tuple[str, ...]:
        """What the bound takes for granted."""
        sampling, b = self.sampled.sampling, self.bounds
        on_grid = ", changed on the grid" if b.jitter else ""
        between = {
            "hold": f"is held between the samples{on_grid}",
            "average": "is linear between the samples",
        }
        said = [
            f"{name} {between[getattr(sampling, name)]}"
            for name in ("g", "f_theta")
            if not {1, 2} & set(getattr(b, name))
        ]
        said += [] if b.inertia else ["M_hat is constant over a step"]
        said += [] if b.jitter else [f"samples come every {sampling.dt:g} s, on time"]
        late = f"{sampling.delay:g} s late" if sampling.delay else "without delay"
        said += [] if b.delay_error else [f"x is measured {late}"]
        said += [] if b.x_step else ["what x is rounded to counts as its noise"]
        said += (
            []
            if 0 in b.x or b.rounding
            else [f"rounding of the recursion ({sampling.precision}) is left out"]
        )
        if sampling.limit is not None and b.f is None:
            said.append("f_hat stays within its limit, or |f| does")
        return (*said, *assumed(self.sampled, counted=("limit",)))


def _primed(name: str, k: int) -> str:
    return name + "'" * k
