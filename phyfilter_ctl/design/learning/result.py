"""What learning returns, and what it tells while it runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import control as ct
import numpy as np

from ..._sections import ComplexArray, FloatArray
from ...filter import PhyFilter, SampledPhyFilter, Sampling
from ...filter.sampling import Method
from ...results import Result, SearchResult, Status
from .constraints import LoopPrice
from .intervals import Intervals
from .options import LearnEvent
from .validation import FlightScore, OrderScore
from .wiener import WienerFloor

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .evidence import Evidence

# A constant residual may be left with as much error as f_theta alone leaves, |1 - F(0)| = 1 (band-pass), and a little.
_MOST_LEFT = 1.05
# Largest sensitivity, |1 - F|, that loops are designed for; a residual with fewer periods a flight than these is left
# with no more than twice the error that f_theta alone leaves.
_PEAK, _PERIODS = 2.0, 3.0
_POINTS = 400


def error_peak(filter: PhyFilter, slowest: float) -> tuple[float, float]:
    """Largest |1 - F(j w)|, and w in rad/s, where flights of 2 pi / slowest show a few periods at most."""
    omega = np.linspace(0.0, _PERIODS * slowest, _POINTS)
    errors = np.abs(filter.error(1j * omega))
    k = int(np.argmax(errors))
    return float(errors[k]), float(omega[k])


def is_identified(filter: PhyFilter, slowest: float) -> bool:
    """Whether F is one that data can have shown: a constant residual is left no worse than by f_theta alone, and one of
    a few periods a flight not much worse."""
    return abs(1.0 - filter.dc_gain) <= _MOST_LEFT and error_peak(filter, slowest)[0] <= _PEAK


@dataclass(frozen=True, eq=False, repr=False)
class LearnResult(Result, SearchResult[PhyFilter]):
    """What :func:`learn` found.

    Attributes
    ----------
    filter : PhyFilter
        The learned filter.
    rmse : float
        Root-mean-square of label - f_hat over samples and channels of the training flights, unweighted, in the unit
        of f. The first sample of each flight, where f_hat = f_theta, is left out.
    cost : float
        Weighted mean square that was minimised.
    held_out_rmse : float or None
        As ``rmse`` on the held-out flights.
    order_used : int
        Order of ``filter``; below the one asked for where the low-pass form gains nothing from it, or F of the general
        form is not identified.
    status : Status
        CONVERGED; ORDER_ADDS_NOTHING (low-pass form: the lower order is returned); NOT_IDENTIFIED (general form: the
        fit of this order would estimate a steady residual worse than f_theta alone; a lower order is returned);
        AT_BOUND (a pole wants to be faster or slower than the data can show); ITERATION_LIMIT; CANCELLED (best so
        far); INFEASIBLE (no filter keeps the limits of ``loop``: F = 0 is returned, ``rmse`` is nan).
    message : str
        The status in words, and what to try.
    notes : tuple of str
        What was assumed of the logs, and what is wrong with their labels; the latter is also issued as a warning.
    skipped : tuple of (str, str)
        Bad flights that were left out, and why (``on_bad="skip"``).
    history : tuple of LearnEvent
        Every step that lowered a cost, of all orders and starts.
    costs : dict
        Least cost by order.
    sampling : Sampling
        What the filter was learned for; without a ``dt`` of its own that of the first flight, the median one where
        steps differ.
    slowest : float
        Least decay rate in rad/s that the flights show, 2 pi over the longest one.
    loop : LoopPrice or None
        With ``loop``: spare room of every limit, which of them bind, and what they cost.
    """

    filter: PhyFilter
    rmse: float
    cost: float
    held_out_rmse: float | None
    order_used: int
    status: Status
    message: str
    notes: tuple[str, ...]
    skipped: tuple[tuple[str, str], ...]
    history: tuple[LearnEvent, ...]
    costs: dict[int, float]
    sampling: Sampling
    slowest: float
    loop: LoopPrice | None = None
    _evidence: Evidence | None = field(default=None, init=False, repr=False)

    @property
    def best(self) -> PhyFilter:
        """``filter``: what every search calls what it found."""
        return self.filter

    @property
    def wiener(self) -> WienerFloor | None:
        """The causal Wiener filter and the comparison with it, computed when it is first asked for; None for a filter
        that limits of a loop bind, one that a callback cut short, and too few samples for folds."""
        return None if self._evidence is None else self._evidence.wiener

    @property
    def intervals(self) -> Intervals | None:
        """Standard errors and 95 % intervals, computed when they are first asked for; None as for ``wiener``."""
        return None if self._evidence is None else self._evidence.intervals

    @property
    def orders(self) -> tuple[OrderScore, ...]:
        """Every order on what it was not learned from: cross-validated when it is first asked for, or to choose."""
        return () if self._evidence is None else self._evidence.orders

    @property
    def flights(self) -> tuple[FlightScore, ...]:
        """Every flight with the filter learned without it, and with its own, computed when it is first asked for; empty
        for one flight and for more than 32."""
        return () if self._evidence is None else self._evidence.flights

    @property
    def E(self) -> FloatArray | None:
        """Direction in which f acts, (n_x, n_f), as ``sampling`` has it."""
        return self.sampling.E

    def _backed(self, evidence: Evidence | None) -> LearnResult:
        object.__setattr__(self, "_evidence", evidence)
        return self

    @property
    def dt(self) -> float:
        """Sampling interval in s of the first flight."""
        return self.sampling.dt

    @property
    def method(self) -> Method:
        """Discretisation the filter was learned for."""
        return self.sampling.method

    def sampled(self, dt: float | None = None) -> SampledPhyFilter:
        """The filter with everything it was learned for: method, rules of g and f_theta, delay, limit and E.

        Parameters
        ----------
        dt : float, optional
            Another sampling interval in s.

        Returns
        -------
        SampledPhyFilter

        Raises
        ------
        ValueError
            If no filter keeps the limits of the loop: F = 0 is not one to run.
        """
        if self.status is Status.INFEASIBLE:
            raise ValueError(f"sampled: {self.message}")
        # Twelve digits: times of a recording rarely give the interval to the last bit.
        step = float(f"{self.dt:.12g}") if dt is None else dt
        return SampledPhyFilter(self.filter, replace(self.sampling, dt=step))

    @property
    def is_identified(self) -> bool:
        """Whether F is one that data can have shown: |1 - F(0)| is 1 at most (a constant residual is left no worse than
        by f_theta alone), and |1 - F| 2 at most where the longest flight shows no more than three periods."""
        return is_identified(self.filter, self.slowest)

    @property
    def wiener_ratio(self) -> float | None:
        """RMSE of the filter over that of the causal Wiener filter, on the same held-out blocks; None without it."""
        return None if self.wiener is None else self.wiener.ratio

    @property
    def wiener_interval(self) -> tuple[float, float] | None:
        """95 % interval of ``wiener_ratio``."""
        return None if self.wiener is None else self.wiener.interval

    def plot(
        self,
        *,
        ax: Sequence[Axes] | None = None,
        dB: bool | None = None,
        Hz: bool | None = None,
        deg: bool | None = None,
    ) -> ct.ControlPlot:
        """Cost over the steps of the descents, and the filter beside the Wiener filter over frequency.

        Parameters
        ----------
        ax : three Axes, optional
            Where to draw the cost curve, magnitude and phase; None makes a new figure.
        dB, Hz, deg : bool, optional
            As for ``FilterResponse.plot``.

        Returns
        -------
        control.ControlPlot
        """
        from ...plots import FrequencyCurve
        from ...plots.learning import learning_plot

        omega = np.geomspace(1e-4, 1.0, _POINTS) * np.pi / self.dt
        responses = {f"n = {self.order_used}": _sampled_response(self, omega)}
        if self.wiener is not None:
            lags = self.wiener.dt * np.arange(len(self.wiener.taps))
            taps = np.asarray(self.wiener.taps, dtype=np.complex128)
            responses["Wiener"] = np.exp(-1j * np.outer(omega, lags)) @ taps
        curves = [
            FrequencyCurve(name, omega, F, 1.0 - F, np.unwrap(np.angle(F)), np.pi / self.dt)
            for name, F in responses.items()
        ]
        events = [(event.order, event.start, event.iteration, event.cost) for event in self.history]
        return learning_plot(events, curves, ax=ax, dB=dB, Hz=Hz, deg=deg)


def _sampled_response(result: LearnResult, omega: FloatArray) -> ComplexArray:
    """The sampled filter from u to f_hat - f_theta at frequencies in rad/s."""
    dA, equilibrium, C = result.filter.sampled(result.dt, result.method).transition
    back = np.exp(-1j * omega * result.dt)[:, None, None]
    eye = np.eye(len(dA))
    states = np.linalg.solve(eye - back * (eye + dA), np.tile(-dA @ equilibrium, (len(omega), 1))[..., None])
    return np.asarray(states[..., 0] @ C, dtype=np.complex128)
