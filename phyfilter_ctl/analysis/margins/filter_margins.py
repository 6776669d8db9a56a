"""Margins of loops with a filter: over all ratios of modelled to true inertia, and at one of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ... import _signals
from ..._sections import ComplexArray, FloatArray
from ...filter import PhyFilter, SampledPhyFilter
from ...values import Loop
from ...values.actuator import checked_actuator
from ...values.loop import Told
from ..channels import per_channel
from ..options import assumed, checked_filter
from . import sweep
from ._applied import AppliedLoop, opened
from ._continuous import ContinuousLoop
from .margins import Margins
from .sampled import SampledLoop
from .scalar_search import NONE, Bound, ScalarSearch
from .sweep import Characteristic, Crossing, Swept

__all__ = ["FilterMargins", "build_loop", "checked_loop", "filter_margins", "sampled_delay_margin"]

# Fractions of a step at which the search for the delay margin of a sampled loop looks.
_FRACTIONS = 4
# It halves the last of them down to this share of the delay margin.
_DELAY_RESOLUTION = 1e-6
# Steps of delay up to which closed-loop poles are cheaper than the frequency response.
_FEW_STEPS = 60.0


@dataclass(frozen=True, eq=False, repr=False)
class FilterMargins(Margins):
    """Margins of a loop Q(s) + mu P(s) = 0, mu = M_hat / M, at one ratio mu and over all ratios; of a filter.

        1 + F (mu Act e^(-s delay) - 1) + mu Act e^(-s delay) (Kp/s^2 + Kd/s) = 0

    Parameters
    ----------
    inertia_ratio : float
        The mu at which gain, phase, delay, modulus and disk margins are taken.
    loop : Characteristic
        The characteristic function on the boundary of stability.
    filter : PhyFilter or SampledPhyFilter
        As it runs.
    around : Loop
        What is around it.

    Notes
    -----
    The loop is opened between the command and the actuator, behind the place where the filter reads the command, so
    L = mu Act e^(-s delay) (F + K)/(1 - F), and the sensitivity 1/(1 + L) is also what the loop leaves of the residual:
    1 - F for an ideal actuator at mu = 1. Gain margins and stable ratios are one thing: an actuator gain acts as mu.

    With ``g`` "applied" L = Act e^(-s delay) ((mu - 1) F + mu K): an actuator gain is no ratio, and the loop leaves
    |1 - Act e^(-s delay) F| / |1 + L| of the residual.

    For matrices Q I + M_hat M^-1 P = 0 splits into one scalar loop for each eigenvalue of M_hat M^-1, real or complex,
    as long as all axes share filter, gains and actuator: :func:`inertia_tolerance`. With ``inertia_ratio`` = 1 and the
    command as g the loop stays stable for every M, symmetric or not, with |(M - M_hat) M_hat^-1| below the modulus
    margin in the spectral norm.
    """

    _figures = ("g", "inertia_ratio", "stable_ratios", *Margins._figures, "assumptions")

    inertia_ratio: float
    loop: Characteristic = field(repr=False)
    filter: PhyFilter | SampledPhyFilter
    around: Loop = field(default_factory=Loop, repr=False)

    @property
    def g(self) -> Told:
        """What the filter is told: "commanded" or "applied"."""
        return "applied" if opened(self.loop, self.inertia_ratio)[0] is not self.loop else "commanded"

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What is taken for granted of the options of the filter and of the loop."""
        limited = self.around.command_limit is not None
        return (*assumed(self.filter), *(("the command stays within its limit",) if limited else ()))

    # -- over all ratios ----------------------------------------------------------------------------------------

    @cached_property
    def ratio_crossings(self) -> tuple[Crossing, ...]:
        """Every ratio mu > 0 with a closed-loop pole on the boundary of stability, and the frequency of that pole.

        With delay there are infinitely many; given are those up to a frequency beyond which poles only leave, and a
        few beyond it.
        """
        return tuple(self._over_ratios.crossings)

    @cached_property
    def stable_ratios(self) -> tuple[tuple[float, float], ...]:
        """Open intervals (low, high) of mu > 0 for which the loop is stable, ascending; high may be inf."""
        return self._over_ratios.intervals

    @property
    def min_ratio(self) -> float:
        """Lower end of the stable interval that contains mu = 1: 0 where there is no lower limit, nan where mu = 1 is
        not stable."""
        return self._stable_around_one()[0]

    @property
    def max_ratio(self) -> float:
        """Upper end of the stable interval that contains mu = 1: inf where there is no upper limit, nan where mu = 1
        is not stable."""
        return self._stable_around_one()[1]

    def stable(self, ratio: complex) -> bool:
        """Whether the loop is stable at this ratio.

        Parameters
        ----------
        ratio : complex
            mu = M_hat / M, or an eigenvalue of M_hat M^-1, which may be complex.

        Returns
        -------
        bool
            False on the boundary too.

        Raises
        ------
        ValueError
            If the ratio is not finite, or the delay turns the loop too many thousand times to count its poles.

        Notes
        -----
        Without delay from the roots of the characteristic polynomial, sampled from the eigenvalues of the closed loop;
        with delay from the turns of Q + mu P about 0 along the imaginary axis, with a bound on its slope that certifies
        that no turn is missed. Sampled with a delay of more than a hundred steps from the turns along the unit circle.
        """
        if not np.isfinite(ratio):
            raise ValueError(f"ratio: expected a finite number, got {ratio}")
        return self.loop.unstable(ratio) == 0

    # -- at one ratio -------------------------------------------------------------------------------------------

    @property
    def poles(self) -> ComplexArray | None:
        """Closed-loop poles at ``inertia_ratio``: in rad/s, sampled as z; None with delay in continuous time, where
        there are infinitely many."""
        return self.loop.roots(self.inertia_ratio)

    def sensitivity(self, omega: ArrayLike) -> FloatArray:
        """|Q|/|Q + mu P|: what the loop leaves of the residual, over frequency; |1/(1 + L)| with the command as g.

        Parameters
        ----------
        omega : (N,) array
            Frequencies in rad/s, above 0; sampled, up to the Nyquist frequency.

        Returns
        -------
        (N,) array
        """
        Q, P = self.loop(_signals.array("omega", omega, ("N",)))
        return np.abs(Q) / np.abs(Q + self.inertia_ratio * P)

    @cached_property
    def ratio_radius(self) -> float:
        """Largest r such that every complex ratio with |mu - inertia_ratio| < r is stable; 0 if that itself is not.

        For matrices: the loop stays stable for every M with |M_hat M^-1 - inertia_ratio I| < r in the spectral norm.
        """
        if not self.is_stable:
            return 0.0

        def distance(omega: FloatArray) -> FloatArray:
            Q, P = self.loop(omega)
            with np.errstate(divide="ignore"):
                return np.abs(Q + self.inertia_ratio * P) / np.abs(P)

        Q, P = self.loop.at_zero
        limit = abs(Q + self.inertia_ratio * P) / abs(P) if P else float("inf")
        return min(sweep.least(distance, self.loop.grid)[0], limit)

    # -- text and inside ----------------------------------------------------------------------------------------

    def _lines(self) -> dict[str, str]:
        ranges = ", ".join(f"{low:.4g} ... {high:.4g}" for low, high in self.stable_ratios) or "none"
        lines = super()._lines()
        answer = "stable" if lines.pop("stable") == "yes" else "unstable"
        told = {} if self.g == "commanded" else {"filter is told": "what acts"}
        return told | {"stable M_hat/M": ranges, f"at M_hat/M = {self.inertia_ratio:g}": answer} | lines

    @cached_property
    def _search(self) -> ScalarSearch:
        loop, ratio = self.loop, self.inertia_ratio
        delayed = (lambda: sampled_delay_margin(loop, ratio)) if isinstance(loop, SampledLoop) else None
        return ScalarSearch(*opened(loop, ratio), delayed)

    @cached_property
    def _over_ratios(self) -> ScalarSearch:
        """The gain of this one is mu."""
        return self._search if self.g == "commanded" else ScalarSearch(self.loop, self.inertia_ratio)

    def _stable_around_one(self) -> tuple[float, float]:
        inside = (each for each in self.stable_ratios if each[0] < 1.0 < each[1])
        return next(inside, (NONE, NONE))


@per_channel
def filter_margins(
    filter: PhyFilter | SampledPhyFilter, loop: Loop | None = None, *, dt: float | None = None
) -> FilterMargins:
    """Margins of the loop around a filter; see :func:`phyfilter_ctl.margins`, which takes diagrams too.

    Parameters
    ----------
    filter : PhyFilter, SampledPhyFilter or several
    loop : Loop, optional
        None: f_hat alone, fed back through an ideal actuator.
    dt : float, optional
        Sampling interval in seconds: for a PhyFilter short for ``filter.sampled(dt)``.

    Returns
    -------
    FilterMargins, or PerChannel of it

    Raises
    ------
    TypeError, ValueError
        As for :func:`phyfilter_ctl.margins`.

    Examples
    --------
    >>> round(filter_margins(PhyFilter.from_poles([-20.0] * 3)).max_ratio, 9)
    9.0
    """
    around = checked_loop(loop)
    system, found = build_loop(filter, around, dt)
    return FilterMargins(around.inertia_ratio, found, system, around)


def checked_loop(loop: Loop | None) -> Loop:
    """The loop; without one that of an ideal actuator and no gains.

    Raises
    ------
    TypeError
        If it is of another kind.
    """
    if loop is None:
        return Loop()
    if not isinstance(loop, Loop):
        raise TypeError(f"loop: expected a Loop(kp, kd, actuator, delay, ...), got {type(loop).__name__}")
    return loop


def build_loop(
    filter: PhyFilter | SampledPhyFilter, loop: Loop, dt: float | None
) -> tuple[PhyFilter | SampledPhyFilter, ContinuousLoop | SampledLoop]:
    """The filter as it runs, and its loop; all arguments checked."""
    filter = checked_filter(filter)
    dt = None if dt is None else _signals.number("dt", dt, "s", above=0.0)
    around = checked_actuator(loop.system), loop.delay, loop.kp, loop.kd
    if isinstance(filter, PhyFilter):
        if dt is None:
            kind = AppliedLoop if loop.g == "applied" else ContinuousLoop
            return filter, kind(filter, *around)
        filter = filter.sampled(dt)
    elif dt is not None and dt != filter.dt:
        raise ValueError(f"dt: {dt:g} s contradicts the {filter.dt:g} s of the sampled filter; leave dt out")
    if filter.sampling.g != "hold":
        raise ValueError(
            f"g={filter.sampling.g!r}: the command fed back is held between samples, and g='average' would need the "
            "command that is computed from its own result; use g='hold'"
        )
    if loop.g == "applied" and filter.sampling.delay:
        raise ValueError(
            f"filter: the measurement is {filter.sampling.delay:g} s late, with g='applied' expected 0; count it to "
            "the delay of the command"
        )
    return filter, SampledLoop(filter, *around, loop.g)


def sampled_delay_margin(
    loop: SampledLoop, ratio: float, read: Callable[[Characteristic], Swept] = lambda loop: loop
) -> Bound:
    """Whole steps only turn the loop, so the gain crossings of each part of a step tell how many it tolerates.

    ``read`` makes of a loop what its crossings are searched on: one that is quicker, say.
    """
    h = np.pi / loop.nyquist

    def first_loss(part: float) -> tuple[float, float]:
        """Steps of delay, of those whole + part, at which stability is first lost, and at which frequency."""
        later = loop.later(part * h)
        if later.unstable(ratio) != 0:
            return part, NONE
        view, gain = opened(later, ratio)
        omega, lag = sweep.lag_to_instability(read(view), gain)
        if not len(omega):
            return float("inf"), NONE
        k = int(np.argmin(lag / omega))
        return part + float(np.ceil(lag[k] / (omega[k] * h))), float(omega[k])

    lost, omega = min(first_loss(i / _FRACTIONS) for i in range(_FRACTIONS))
    if np.isinf(lost):
        return Bound(lost, NONE)
    kept = lost - 1.0 / _FRACTIONS  # on the lattice, below the first loss
    while lost - kept > _DELAY_RESOLUTION * lost:
        middle = 0.5 * (kept + lost)
        few = middle < _FEW_STEPS
        fine = loop.later(middle * h).unstable(ratio) == 0 if few else first_loss(middle % 1.0)[0] > middle
        kept, lost = (middle, lost) if fine else (kept, middle)
    if kept < _FEW_STEPS:
        roots = loop.later(kept * h).roots(ratio)
        omega = abs(float(np.angle(roots[np.argmax(np.abs(roots))]))) / h
    return Bound(kept * h, omega)
