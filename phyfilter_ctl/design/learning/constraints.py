"""What a learned filter must keep in the loop: margins, noise of the command, the bound for a residual of a slope."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, Protocol, get_args, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from ... import _signals
from ..._sections import FloatArray
from ...analysis import FilterMargins, error_bound, frequency_response
from ...analysis.margins import filter_margins
from ...analysis.margins.slopes import (
    LoopOnGrid,
    Margin,
    SampledLoop,
    Surroundings,
    Touch,
    approached,
    gain_at,
    modulus_at,
    touches,
)
from ...filter import SampledPhyFilter
from ...results import Result
from ...values import Loop

__all__ = ["LoopGoal", "LoopPrice", "MarginsLike", "Near", "again", "loop_of", "near_limits"]

# Spare room beyond this counts no further, and what has none is this far off.
_AMPLE, _LOST = 10.0, -1.0

Cost = Literal["estimation", "tracking"]


class MarginsLike(Protocol):
    """What is asked of the margins of a diagram: ``SystemMargins`` has it."""

    @property
    def is_stable(self) -> bool:
        """Whether the loop is stable."""
        ...

    @property
    def modulus_margin(self) -> float:
        """Least distance of L from -1."""
        ...

    @property
    def delay_margin(self) -> float:
        """Least extra delay in s that makes the loop unstable."""
        ...

    @property
    def gain_margin(self) -> tuple[float, float]:
        """Factors between which the loop stays stable."""
        ...


@runtime_checkable
class PlaceLike(Protocol):
    """A diagram with a place for the filter: ``FilterPlace`` of ``loops``."""

    def __call__(self, filter: SampledPhyFilter, /) -> MarginsLike:
        """The exact margins."""
        ...

    def loop(self, filter: SampledPhyFilter, /) -> Surroundings:
        """What is around the filter, for all of its sampling."""
        ...


@dataclass(frozen=True)
class Near:
    """Spare room of one limit where the loop comes near to it, and how F moves it.

    Attributes
    ----------
    name : str
    spare : float
        0 at the limit.
    omega : float
        In rad/s.
    slope : complex
        d spare = Re(slope dF(omega)).
    """

    name: str
    spare: float
    omega: float
    slope: complex


@dataclass(frozen=True, eq=False)
class LoopGoal:
    """A loop and what the filter must keep in it, for ``learn(..., loop=...)``.

    Parameters
    ----------
    loop : Loop, optional
        The loop; without gains the inner loop alone. With the command as g and at the inertia ratio 1: the ratios that
        must be borne are ``inertia_ratios``.
    modulus_margin : float
        Least distance of the open loop from -1, in [0, 1): 0.5, the default, holds the peak of the sensitivity at 2.
    delay_margin : float
        Least extra delay in s that must be tolerated.
    inertia_ratios : (float, float)
        M_hat / M between which the loop must be stable, around 1.
    noise_gain : float, optional
        Most standard deviation of f_hat per unit of the noise of x: what jitter of the command allows.
    slope, bound : float, optional
        Largest |f - f_hat| that a residual of \\|gamma'\\| <= slope may leave; both or none.
    cost : {"estimation", "tracking"}
        What the filter is to make least within the limits: mean square error of f_hat on the flights, or of tracking in
        this loop, of position (of velocity where kp is 0), with the flights' residual and noise as its disturbances.
        That of a filter in the loop: where the loop is slow, an estimate that lags costs it little, and noise much.
    reference : array_like, shape (N,) or (N, K), optional
        For ``cost="tracking"``: accelerations times M_hat, in the unit of f and at the flights' step, that the loop is
        asked to follow besides; it sends them as commands. None for standing still, or a residual recorded in motion.
    margins : callable, optional
        Margins of another loop instead of ``loop``: from the sampled filter to an object with
        ``is_stable``, ``modulus_margin``, ``delay_margin`` and ``gain_margin``. Of a python-control diagram with the
        filter as a block: :class:`~phyfilter_ctl.loops.FilterPlace`, which is searched as fast as a ``Loop``; a mere
        function, ``lambda f: margins(diagram(f), at="motor.u")``, is differenced.

    Raises
    ------
    ValueError
        For a number out of range, or a loop given twice.

    Examples
    --------
    >>> from phyfilter_ctl import PhyFilter
    >>> goal = LoopGoal(Loop(10.0, 6.0, actuator=0.05, delay=0.01))
    >>> {name: round(spare, 3) for name, spare in goal.spare(PhyFilter([5.0]).sampled(0.01)).items()}
    {'modulus margin': 0.024}
    """

    loop: Loop = field(default_factory=Loop)
    modulus_margin: float = 0.5
    delay_margin: float = 0.0
    inertia_ratios: tuple[float, float] = (1.0, 1.0)
    noise_gain: float | None = None
    slope: float | None = None
    bound: float | None = None
    cost: Cost = "estimation"
    reference: ArrayLike | None = field(default=None, repr=False)
    margins: Callable[[SampledPhyFilter], MarginsLike] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if not isinstance(self.loop, Loop):
            raise TypeError(f"loop: expected a Loop(kp, kd, actuator, delay), got {type(self.loop).__name__}")
        if self.loop.command_limit is not None:
            raise ValueError(
                "loop: the margins of a search know no limit of the command, got command_limit="
                f"{self.loop.command_limit:g}; leave it out, and see tracking_error of what is learned"
            )
        if self.loop.inertia_ratio != 1.0 or self.loop.g != "commanded":
            raise ValueError(
                "loop: expected the command as g and inertia_ratio 1, at which the filter is learned; the ratios that "
                f"must be borne are inertia_ratios=(low, high); got {self.loop}"
            )
        for name in ("modulus_margin", "delay_margin"):
            _signals.number(name, getattr(self, name), least=0.0)
        if not self.modulus_margin < 1.0:
            raise ValueError(
                f"modulus_margin: expected a number in [0, 1), got {self.modulus_margin:g}; no loop that acts reaches 1"
            )
        low, high = _signals.array("inertia_ratios", self.inertia_ratios, (2,)).tolist()
        if not 0.0 < low <= 1.0 <= high:
            raise ValueError(f"inertia_ratios: expected 0 < low <= 1 <= high, got {low:g} and {high:g}")
        object.__setattr__(self, "inertia_ratios", (low, high))
        if (self.slope is None) != (self.bound is None):
            raise ValueError("slope, bound: expected both or none")
        for name in ("noise_gain", "slope", "bound"):
            value = getattr(self, name)
            if value is not None:
                _signals.number(name, value, above=0.0)
        if self.margins is not None and self.loop != Loop():
            raise ValueError("margins: expected it alone, or a loop: one, not two")
        if not isinstance(self.cost, str) or self.cost not in get_args(Cost):
            raise ValueError(f"cost: expected one of {', '.join(get_args(Cost))}, got {self.cost!r}")
        if self.cost == "tracking" and not self.loop.has_gains:
            raise ValueError(
                'cost="tracking": expected a Loop with kp or kd, the outer loop whose error it is'
            )
        if self.reference is not None:
            if self.cost != "tracking":
                raise ValueError('reference: it plays a part in cost="tracking" only; leave it out')
            given = _signals.real("reference", self.reference)
            shape = ("N",) if given.ndim == 1 else ("N", "K")
            object.__setattr__(self, "reference", _signals.array("reference", given, shape))

    def spare(self, filter: SampledPhyFilter) -> dict[str, float]:
        """Spare room of every limit by the exact margins of the sampled loop: kept where it is 0 or more.

        Parameters
        ----------
        filter : SampledPhyFilter

        Returns
        -------
        dict of str to float
            The modulus margin's in units of its own, of others the share of the limit; -1 where the loop is unstable.
        """
        found = self._loop_margin(filter) if self.margins is None else self.margins(filter)
        spare = {"modulus margin": found.modulus_margin - self.modulus_margin if found.is_stable else _LOST}
        if self.delay_margin:
            spare["delay margin"] = found.delay_margin / self.delay_margin - 1.0 if found.is_stable else _LOST
        if self.inertia_ratios != (1.0, 1.0):
            low, high = found.gain_margin if found.is_stable else (np.inf, 0.0)
            spare["lower inertia ratio"] = 1.0 - low / self.inertia_ratios[0]
            spare["upper inertia ratio"] = high / self.inertia_ratios[1] - 1.0
        spare |= self.others(filter)
        return {name: float(np.clip(value, _LOST, _AMPLE)) for name, value in spare.items()}

    def others(self, filter: SampledPhyFilter) -> dict[str, float]:
        """Spare room of what is not a margin of the loop: noise and bound.

        Parameters
        ----------
        filter : SampledPhyFilter
        """
        found: dict[str, float] = {}
        if self.noise_gain is not None:
            found["noise gain"] = 1.0 - frequency_response(filter).noise_gain / self.noise_gain
        if self.slope is not None and self.bound is not None:
            found["bound"] = 1.0 - error_bound(filter, {1: self.slope}).bound / self.bound
        return found

    def _loop_margin(self, filter: SampledPhyFilter) -> FilterMargins:
        key = filter.dt, filter.sampling.delay, filter.sampling.g
        known = self._loops.get(key)
        if known is None:
            found = filter_margins(filter, self.loop)
            if isinstance(found.loop, SampledLoop):
                self._loops[key] = found.loop
            return found
        return FilterMargins(1.0, known.with_filter(filter), filter, self.loop)

    @cached_property
    def _loops(self) -> dict[tuple[float, float, str], SampledLoop]:
        """By step and delay, what is around the filter."""
        return {}


def loop_of(limits: LoopGoal, filter: SampledPhyFilter) -> Surroundings | None:
    """What filters of this one's step and delay stand in; None where only a function knows margins.

    Parameters
    ----------
    limits : LoopGoal
    filter : SampledPhyFilter
    """
    if isinstance(limits.margins, PlaceLike):
        return limits.margins.loop(filter)
    if limits.margins is not None:
        return None
    found = limits._loop_margin(filter).loop
    assert isinstance(found, SampledLoop)  # of a sampled filter
    return found


def near_limits(limits: LoopGoal, loop: LoopOnGrid) -> list[Near]:
    """Every place where the loop is at a limit or comes near to one.

    Parameters
    ----------
    limits : LoopGoal
    loop : LoopOnGrid
    """
    asked: list[Margin] = ["modulus"]
    if limits.delay_margin:
        asked.append("delay")
    if limits.inertia_ratios != (1.0, 1.0):
        asked.append("ratio")
    found = touches(loop, 1.0, *asked)
    found += modulus_at(loop, 1.0, approached(loop, 1.0, limits.modulus_margin))
    return [_spare_at(limits, touch) for touch in found]


def again(limits: LoopGoal, loop: LoopOnGrid, omega: FloatArray, *, gain: bool = False) -> list[Near]:
    r"""Spare room of the modulus at given frequencies.

    Parameters
    ----------
    limits : LoopGoal
    loop : LoopOnGrid
    omega : (k,) array
        In rad/s.
    gain : bool
        How far \|L\| is below 1 instead: where a gain crossing would have too little delay margin.
    """
    found = gain_at(loop, 1.0, omega) if gain else modulus_at(loop, 1.0, omega)
    return [_spare_at(limits, touch) for touch in found]


def _spare_at(limits: LoopGoal, touch: Touch) -> Near:
    low, high = limits.inertia_ratios
    name, least = {
        "modulus": ("modulus margin", limits.modulus_margin),
        "delay": ("delay margin", limits.delay_margin),
        "gain": ("delay margin", 1.0),
        "ratio": ("upper inertia ratio", high) if touch.value > 1.0 else ("lower inertia ratio", low),
    }[touch.margin]
    if touch.margin == "modulus":
        spare, slope = touch.value - least, touch.slope
    elif touch.margin == "gain" or name == "lower inertia ratio":
        spare, slope = 1.0 - touch.value / least, -touch.slope / least
    else:
        spare, slope = touch.value / least - 1.0, touch.slope / least
    return Near(name, spare, touch.omega, slope)


@dataclass(frozen=True, eq=False, repr=False)
class LoopPrice(Result):
    """What the loop asks of a learned filter, and what that costs: ``LearnResult.loop``.

    Attributes
    ----------
    constraint : LoopGoal
    spare : dict of str to float
        Spare room of every limit with the filter, by the exact functions; never negative.
    without : dict of str to float
        The same with the filter learned without the loop.
    rmse_without : float
        RMSE of that filter on the training flights.
    price : float
        RMSE over ``rmse_without``, less 1; nan where no filter is admissible.
    tracking : float or None
        With ``cost="tracking"``: root-mean-square tracking error in the loop, in the unit of f times s^2 (s for
        velocity), m for M_hat = 1 kg and f in N.
    tracking_of_estimator : float or None
        The same with the filter that estimates best within the limits.
    """

    constraint: LoopGoal
    spare: Mapping[str, float]
    without: Mapping[str, float]
    rmse_without: float
    price: float
    tracking: float | None = None
    tracking_of_estimator: float | None = None

    @property
    def binding(self) -> tuple[str, ...]:
        """Limits that the filter touches: asking less of them would lower the error."""
        return tuple(name for name, spare in self.spare.items() if spare < 1e-2)
