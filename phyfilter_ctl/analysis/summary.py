"""What a filter promises, on one page: response, error, noise, and the margins of every loop that it is in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from ..filter import PhyFilter, SampledPhyFilter
from ..results import Result
from ..values import Bounded, Gaussian, Loop
from ..values.disturbance import bounded
from ..values.loop import Told
from .bounds import ErrorBound, error_bound
from .channels import Filter, per_channel
from .frequency import FilterResponse, frequency_response
from .margins import InertiaCertificate, SaturationMargin, inertia_tolerance, saturation_margin
from .margins.filter_margins import FilterMargins, checked_loop, filter_margins
from .margins.saturation import KnownActuation
from .options import checked_filter, inertia_of
from .tracking_error import TrackingTube, tracking_error
from .variance import error_variance
from .verdict import Sentence, on_error, on_loops

__all__ = ["Analysis", "analyze"]

# A zero of 1 - F is on the imaginary axis if its real part is no more than this share of it.
_ON_AXIS = 1e-6
# What a filter passes of a constant, as a share of its peak, below which it is a band-pass.
_BAND = 1e-6


@dataclass(frozen=True, eq=False, repr=False)
class Analysis(Result):
    """What one filter promises; made by :func:`analyze`.

    Parameters
    ----------
    response : FilterResponse
    bound : ErrorBound or None
        Of the error; None without a bound on the residual, or where a loop is not stable.
    noise_deviation : float or None
        Standard deviation that the noise of x gives f_hat; None where that of the noise is not known.
    inner_loop, complete_loop : margins or None
        With f_hat fed back; with the outer gains too, where there are some.
    saturated_loop : dict of str to SaturationMargin
        By what the filter is told.
    tracking : TrackingTube or None
    moving_inertia : dict of str to InertiaCertificate
        For a constant M and for one of any speed.
    blocked : dict of float to float
        By frequency in rad/s: where 1 - F blocks the residual, or a band-pass passes it, the share that the sampled
        loop with f_hat fed back leaves of it, since a held command lags by half a step.
    slope : float or None
        The \\|gamma'\\| that alone the bound takes for granted.
    unit : str
        Of f, where the filter knows it.
    """

    _figures = (
        "filter",
        "headline",
        "g",
        "is_stable",
        "bandwidth",
        "error_peak",
        "noise_gain",
        "bound",
        "noise_deviation",
        "inner_loop",
        "complete_loop",
        "saturated_loop",
        "tracking",
        "moving_inertia",
        "blocked",
        "unit",
    )
    _units = MappingProxyType({"noise_deviation": "{}", "noise_gain": "1/s"})

    response: FilterResponse
    bound: ErrorBound | None
    noise_deviation: float | None
    inner_loop: FilterMargins
    complete_loop: FilterMargins | None
    saturated_loop: Mapping[str, SaturationMargin]
    tracking: TrackingTube | None
    moving_inertia: Mapping[str, InertiaCertificate]
    blocked: Mapping[float, float]
    slope: float | None
    unit: str

    @property
    def system(self) -> Filter:
        """The filter as it runs."""
        return self.response.system

    @property
    def filter(self) -> PhyFilter:
        """Its coefficients."""
        return self.system if isinstance(self.system, PhyFilter) else self.system.filter

    @property
    def loops(self) -> tuple[FilterMargins, ...]:
        """Every loop that was analysed."""
        return (self.inner_loop,) if self.complete_loop is None else (self.inner_loop, self.complete_loop)

    @property
    def g(self) -> Told:
        """What the filter is told in the loops."""
        return self.inner_loop.g

    @property
    def is_stable(self) -> bool:
        """Whether every loop is."""
        return all(loop.is_stable for loop in self.loops)

    @property
    def bandwidth(self) -> float:
        """In rad/s."""
        return self.response.bandwidth

    @property
    def error_peak(self) -> float:
        """Maximum of |1 - F|."""
        return self.response.error_peak.value

    @property
    def noise_gain(self) -> float:
        """As :attr:`FilterResponse.noise_gain`."""
        return self.response.noise_gain

    @property
    def verdict(self) -> list[Sentence]:
        """The headline in sentences: the least of all loops, then the error."""
        said = on_loops(self.loops)
        if self.bound is not None:
            said.append(on_error(self.bound.bound, self.unit, self.slope))
        if self.noise_deviation is not None and self.is_stable:
            unit = f" {self.unit}" if self.unit else ""
            said.append(
                Sentence(f"Noise of f_hat {self.noise_deviation:.4g}{unit} (1 sigma), part of no bound.")
            )
        return said

    @property
    def headline(self) -> str:
        """The verdict as text."""
        return " ".join(sentence.text for sentence in self.verdict)

    def describe(self) -> str:
        """The page as text.

        Returns
        -------
        str
        """
        lines = [self.headline, "", self.filter.describe()]
        if isinstance(self.system, SampledPhyFilter):
            lines.append(f"{'sampled':<12}every {self.system.dt:g} s, {self.system.sampling.method}")
        return "\n".join([*lines, *self.details()])

    def details(self) -> list[str]:
        """Lines of the page below the filter: error, noise, loops, tube."""
        unit = f" {self.unit}" if self.unit else ""
        lines = []
        if self.bound is not None:
            lines += ["", f"largest error f - f_hat{f' in {self.unit}' if self.unit else ''}"]
            lines += ["  " + line for line in self.bound.describe().splitlines()]
        if self.noise_deviation is not None:
            lines.append(_line("noise of f_hat", f"{self.noise_deviation:.4g}{unit} (1 sigma)"))
        for omega, left in self.blocked.items():
            lines.append(
                _line("left when fed back", f"{left:.3g} at {_signals.in_both(omega)}, held commands")
            )
        lines += ["", "inner loop: f_hat fed back", *_indented(self.inner_loop)]
        for name, found in self.moving_inertia.items():
            low, high = found.ratios
            lines.append(
                _line(name, f"{found.status} for M_hat/M from {low:.4g} to {high:.4g}; {found.message}")
            )
        if self.complete_loop is not None:
            lines += ["", "complete loop: with the outer gains", *_indented(self.complete_loop)]
            excess = {
                g: f"{each.command_excess:.4g}" for g, each in self.saturated_loop.items() if each.is_stable
            }
            if "applied" in excess:
                lines.append(_line("command up to", f"{excess['applied']} times its limit: stable"))
            if "saturated" in excess:
                known = f"{excess['saturated']} times its limit if told what acts"
                known += f", {excess['commanded']} if the command" if "commanded" in excess else ""
                lines.append(_line("command up to", f"{known}: stable"))
        if self.tracking is not None:
            radius = (
                f"{self.tracking.radius:.4g} at most"
                if self.tracking.is_linear
                else "not proved: a limit may be met"
            )
            lines.append(_line("position error", f"{radius}, while |f| is bounded as gamma is"))
        if granted := self.inner_loop.assumptions:
            lines.append(_line("taken for granted", "; ".join(granted)))
        return lines


@per_channel
def analyze(
    filter: PhyFilter | SampledPhyFilter,
    loop: Loop | None = None,
    disturbance: Bounded | Mapping[int, float] | None = None,
    *,
    noise_deviation: float = 0.0,
    inertia: ArrayLike | None = None,
    ratios: Sequence[float] | None = None,
) -> Analysis:
    """What a filter promises: error, noise, and what the loops that it is in tolerate.

    The headline is the least of all loops: with outer gains the delay and the masses that both the inner and the
    complete loop tolerate, and where one of them is not stable no error is promised.

    Parameters
    ----------
    filter : PhyFilter, SampledPhyFilter or several
        A sampled one as it runs. Several, by ``stack`` or as a sequence: the answer is a ``PerChannel``, and every
        other argument one for all or a list.
    loop : Loop, optional
        Without gains f_hat alone is fed back.
    disturbance : Bounded, or mapping of int to float, optional
        What the error is bounded for; a mapping is the bounds of the residual alone. None: no bound.
    noise_deviation : float
        Standard deviation of independent noise of the samples of x, for a sampled filter. No part of a bound: noise of
        a known deviation has none.
    inertia : float, (n,) or (n, n) array_like, optional
        M_hat, in the spectral norm, by which noise of x counts. None: the filter's own, else 1.
    ratios : (low, high), optional
        Whether M_hat/M may be anywhere in between, constant and moving at any speed; with the command as g.

    Returns
    -------
    Analysis, or PerChannel of it

    Raises
    ------
    TypeError, ValueError
        As for :func:`error_bound`, :func:`~phyfilter_ctl.margins` and :func:`inertia_tolerance`; for a
        ``noise_deviation`` of a continuous filter, and for ``ratios`` with ``g="applied"``.

    Examples
    --------
    The complete loop tolerates less than the inner one, and is what is promised:

    >>> loop = Loop(10.0, 6.0, actuator=0.1, delay=0.02)
    >>> analyze(PhyFilter([12.0]), loop.inner).headline
    'Stable. Tolerates 74 ms more delay, masses from 0.233 times yours.'
    >>> analyze(PhyFilter([12.0]), loop, {1: 3.0}).headline
    'Stable. Tolerates 6.64 ms more delay, masses 0.718 to 5.54 times yours. Error at most 0.25 while |γ′| ≤ 3 per s.'
    """
    filter = checked_filter(filter)
    around = checked_loop(loop)
    noise_deviation = _signals.number("noise_deviation", noise_deviation, least=0.0)
    bounds = Bounded() if disturbance is None else bounded(disturbance)
    M = inertia_of(filter, inertia)
    if ratios is not None and around.g != "commanded":
        raise ValueError(
            f"ratios: whether M may move is known for the command as g, got g={around.g!r}; leave ratios out and see "
            "the stable ratios of the inner loop for a constant M"
        )
    response = frequency_response(filter)
    inner = filter_margins(filter, around.inner)
    complete, saturated = None, {}
    if around.has_gains:
        complete = filter_margins(filter, around)
        clipped = isinstance(filter, SampledPhyFilter) and filter.sampling.g_limit is not None
        commanded: tuple[KnownActuation, ...] = ("saturated",) if clipped else ("saturated", "commanded")
        saturated = {
            known: saturation_margin(filter, around, g=known)
            for known in (("applied",) if around.g == "applied" else commanded)
        }
    stable = inner.is_stable and (complete is None or complete.is_stable)
    bound = error_bound(filter, bounds, inertia=inertia) if any(bounds.parts) else None
    deviation = None
    if noise_deviation:
        if not isinstance(filter, SampledPhyFilter):
            raise ValueError("noise_deviation: is of samples; take filter.sampled(dt)")
        deviation = float(
            np.sqrt(error_variance(filter, Gaussian(noise=noise_deviation), inertia=inertia).noise)
        )
    tube, seen = None, {k: size for part in bounds.parts for k, size in part.items() if k <= 1}
    if seen and stable and complete is not None and around.kp > 0.0 and _has_tube(filter, around.g):
        tube = tracking_error(filter, around, Bounded(seen, noise=bounds.noise), inertia=M)
    moving = {}
    if ratios is not None:
        plain = replace(around.inner, inertia_ratio=1.0)
        moving = {
            "constant M": inertia_tolerance(filter, plain, ratios=ratios, rate=0.0),
            "M of any speed": inertia_tolerance(filter, plain, ratios=ratios),
        }
    units = filter.sampling.units if isinstance(filter, SampledPhyFilter) else {}
    return Analysis(
        response,
        bound if stable else None,
        deviation,
        inner,
        complete,
        saturated,
        tube,
        moving,
        _blocked(filter, response, complete or inner) if stable else {},
        bounds.slope,
        units.get("f", ""),
    )


def _has_tube(filter: PhyFilter | SampledPhyFilter, g: Told) -> bool:
    """Whether there is a tube of the position: for a sampled filter that is told a held command."""
    if not isinstance(filter, SampledPhyFilter):
        return False
    alone = filter.E is None or filter.E.shape[0] == 1
    sampling, known = filter.sampling, g == "commanded"
    return alone and sampling.g == "hold" and (known or not sampling.delay) and sampling.g_limit is None


def _blocked(
    filter: PhyFilter | SampledPhyFilter, response: FilterResponse, loop: FilterMargins
) -> dict[float, float]:
    """Share left of the residual by the sampled loop where F itself would leave none."""
    if not isinstance(filter, SampledPhyFilter):
        return {}
    roots = np.roots(filter.filter.error_numerator[::-1])
    on_axis = (roots.imag > 0.0) & (np.abs(roots.real) <= _ON_AXIS * np.abs(roots))
    found = {float(omega) for omega in roots.imag[on_axis]}
    if abs(filter.filter.dc_gain) <= _BAND * response.peak.value:
        found.add(response.peak.omega)
    below = np.array(sorted(omega for omega in found if 0.0 < omega < response.nyquist))
    left = loop.sensitivity(below) if len(below) else below
    return dict(zip(below.tolist(), left.tolist(), strict=True))


def _indented(result: FilterMargins) -> list[str]:
    return ["  " + line for line in result.describe().splitlines()]


def _line(name: str, text: str) -> str:
    return f"  {name:<18}{text}"
