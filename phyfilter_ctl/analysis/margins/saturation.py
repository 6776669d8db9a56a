"""Loops whose actuator saturates: how far beyond its limit the command may go before stability is no longer proved.

The command v goes through sigma(v) to actuator and plant. Opened there, with chi = 1 - F + mu Act e^(-s delay) (F + K),
K = Kp/s^2 + Kd/s, the closed loop answers something added to v by

    g is the command v          S = (1 - F) / chi,    the filter takes v - sigma(v) for a force
    g is sigma(v)               S = 1 / chi           the filter knows; F itself runs on the truth
    g is Act sigma(v)           S = 1 / chi           with chi = 1 + Act e^(-s delay) ((mu - 1) F + mu K)

and sees the saturation's dead zone v - sigma(v) through 1 - S. For a dead zone in the sector [0, 1 - k], that is sigma
in [k, 1], the circle criterion asks for Re(1 - S) < 1/(1 - k) at all frequencies: with m = min Re S,

    k > -m / (1 - m),    1/k < 1 + 1/|m|        (every k from 0 on where m >= 0)

G. Zames, "On the input-output stability of time-varying nonlinear feedback systems, Part II", IEEE TAC 11 (1966);
sampled, Y. Z. Tsypkin, "Frequency criteria for the absolute stability of nonlinear sampled-data systems", Automation
and Remote Control 25 (1964). With two integrators in K there is no global statement of this kind: at low frequencies
S ~ -omega^2/(mu Kp).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, get_args

import numpy as np

from ... import _signals
from ..._sections import ComplexArray, FloatArray
from ...filter import PhyFilter, SampledPhyFilter
from ...results import Result
from ...values import Loop
from ..channels import per_channel
from ..options import assumed
from . import sweep
from .filter_margins import build_loop, checked_loop
from .sweep import Characteristic

__all__ = ["KnownActuation", "SaturationMargin", "saturation_margin"]

KnownActuation = Literal["saturated", "commanded", "applied"]
# Share of 1 that m may be below 0 by rounding: S itself is of size 1.
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False, repr=False)
class SaturationMargin(Result):
    """What is proved of a loop with a saturated actuator; made by :func:`saturation_margin`.

    Parameters
    ----------
    g : {"saturated", "commanded", "applied"}
        What the filter is told.
    inertia_ratio : float
        mu = M_hat / M.
    loop : Characteristic
        The linear loop, Q + mu P = 0.
    numerator : callable
        Of S, over Q + mu P: frequencies in rad/s (N,) -> complex (N,).
    filter : PhyFilter or SampledPhyFilter
        As it runs.
    """

    _figures = (
        "g",
        "inertia_ratio",
        "is_stable",
        "least_gain",
        "command_excess",
        "frequency",
        "assumptions",
    )
    _answer = ("is_stable", "command_excess")

    g: KnownActuation
    inertia_ratio: float
    loop: Characteristic = field(repr=False)
    numerator: Callable[[FloatArray], ComplexArray] = field(repr=False)
    filter: PhyFilter | SampledPhyFilter = field(repr=False)

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What is taken for granted of the options of the filter."""
        return assumed(self.filter, counted=("g_limit",))

    @cached_property
    def is_stable(self) -> bool:
        """Whether the loop is stable while nothing saturates."""
        return self.loop.unstable(self.inertia_ratio) == 0

    def sensitivity(self, omega: FloatArray) -> ComplexArray:
        """S, complex (N,), at frequencies in rad/s above 0.

        Parameters
        ----------
        omega : (N,) array
        """
        Q, P = self.loop(omega)
        return self.numerator(omega) / (Q + self.inertia_ratio * P)

    @cached_property
    def _least(self) -> tuple[float, float]:
        """m and its frequency."""
        return sweep.least(lambda omega: self.sensitivity(omega).real, self.loop.grid)

    @property
    def frequency(self) -> float:
        """Frequency in rad/s at which Re S is least."""
        return self._least[1]

    @cached_property
    def least_gain(self) -> float:
        """k: the loop is stable for every sigma(v, t) with k' v^2 <= v sigma <= v^2, k' > k, whatever it does over
        time; 0 where any k' > 0 will do, nan where the loop is unstable as it is."""
        if not self.is_stable:
            return float("nan")
        m = self._least[0]
        return 0.0 if m > -_ROUNDING else -m / (1.0 - m)

    @property
    def command_excess(self) -> float:
        """1/k: stable while the command stays below this many times the actuator's limit; inf where there is no bound
        on it, nan where the loop is unstable as it is."""
        k = self.least_gain
        return float("inf") if k == 0.0 else 1.0 / k

    def describe(self) -> str:
        """The answer as text, one line each.

        Returns
        -------
        str
        """
        known = {
            "saturated": "what acts",
            "commanded": "the command, not what acts",
            "applied": "what acts, lag and delay and all",
        }[self.g]
        lines = {"told to the filter": known, f"at M_hat/M = {self.inertia_ratio:g}": "stable"}
        if not self.is_stable:
            lines[f"at M_hat/M = {self.inertia_ratio:g}"] = "unstable"
        elif np.isinf(self.command_excess):
            lines["saturated"] = "stable for commands of any size"
        else:
            lines["saturated"] = f"stable for commands up to {self.command_excess:.4g} times the limit"
            lines["binds at"] = _signals.in_both(self.frequency)
        return "\n".join(f"{name:<20}{text}" for name, text in lines.items())


@per_channel
def saturation_margin(
    filter: PhyFilter | SampledPhyFilter,
    loop: Loop | None = None,
    *,
    g: KnownActuation | None = None,
    dt: float | None = None,
) -> SaturationMargin:
    """How far beyond the actuator's limit the command may go, by the circle criterion.

    Parameters
    ----------
    filter : PhyFilter, SampledPhyFilter or several
        As for :func:`~phyfilter_ctl.margins`.
    loop : Loop, optional
        Without gains the loop through the filter alone. The saturation comes before delay and actuator. The answer is
        in units of the limit, whatever ``command_limit`` is.
    g : {"saturated", "commanded", "applied"}, optional
        What the filter is told: what the saturation leaves of the command, as with ``Sampling.g_limit``, the command
        itself, or the force that acts behind saturation, lag and delay. None: "applied" if that is the loop's ``g``,
        else "saturated".
    dt : float, optional
        Sampling interval in seconds: for a PhyFilter short for ``filter.sampled(dt)``.

    Returns
    -------
    SaturationMargin, or PerChannel of it

    Raises
    ------
    TypeError, ValueError
        As for :func:`~phyfilter_ctl.margins`, for a ``g`` that contradicts the loop's, and for a filter with
        ``g_limit`` under g="commanded".

    Notes
    -----
    Sufficient, not necessary, and for any sigma in the sector, one that changes over time too: a limit that sags, an
    actuator that loses part of its gain. A linear gain of k' > k is among them, so k is no less than the lower gain
    margin of the same loop. It is a statement of stability, not of how large the command gets; that takes a bound
    on f. Sampled, the loop is the sampled one, exactly. One channel: limits of several coupled ones are not covered.

    Examples
    --------
    An exact model and an ideal actuator: told what acts, the saturated loop is the one without filter. Told the
    command, the integrator in 1/(1 - F) winds up.

    >>> F, loop = PhyFilter([20.0]), Loop(10.0, 6.0)
    >>> [round(saturation_margin(F, loop, g=g).command_excess, 1) for g in ("saturated", "commanded")]
    [8.4, 8.0]
    """
    around = checked_loop(loop)
    if g is not None and not isinstance(g, str):
        raise TypeError(f"g: expected one of {', '.join(get_args(KnownActuation))}, got {g!r}")
    known: KnownActuation = g or ("applied" if around.g == "applied" else "saturated")
    if known not in get_args(KnownActuation):
        raise ValueError(f"g: expected {', '.join(map(repr, get_args(KnownActuation)))}, got {g!r}")
    if around.g == "applied" != known:
        raise ValueError(f"g={known!r}: contradicts the g='applied' of the loop; leave one of them out")
    told = "applied" if known == "applied" else "commanded"
    system, found = build_loop(filter, replace(around, g=told), dt)
    if known == "commanded":
        assumed(system, refused={"g_limit": "the filter is told what its limit leaves; use g='saturated'"})
    numerator = found.error if known == "commanded" else found.normalisation
    return SaturationMargin(known, around.inertia_ratio, found, numerator, system)
