"""Frequency responses of filters, continuous and sampled, and of any python-control state-space system."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple, cast, get_args, overload

import control as ct
import numpy as np
from control.lti import LTI
from matplotlib.axes import Axes
from numpy.typing import ArrayLike
from scipy.optimize import brentq, minimize_scalar

from .. import _signals, plots
from .._sections import ComplexArray, FloatArray
from ..filter import PhyFilter, SampledBank, SampledPhyFilter
from ..plots._units import frequency_unit
from ..plots.frequency import frequency_plot
from . import _paths, _resolvent, grids
from .channels import Filter, channels_of
from .options import assumed, input_gains
from .poles import PoleZeroMap, poles_of

__all__ = ["FilterResponse", "FilterResponseList", "Peak", "frequency_response"]

Input = Literal["gamma", "x", "g", "f_theta", "noise"]
Output = Literal["f_hat", "error"]

_HALF_POWER = 1.0 / np.sqrt(2.0)
# |F(0)| below this share of the peak is a band-pass whose b_0 is rounding, not a pass band that reaches 0.
_NO_DC = 1e-6
# A maximum on the grid must exceed the value at 0 or infinity by this to count: |F| is rounded there.
_ABOVE_LIMIT = 1e-12


class Peak(NamedTuple):
    """Largest magnitude and the frequency of it in rad/s (0 or inf where it is a limit that is approached)."""

    value: float
    omega: float


@dataclass(frozen=True, eq=False)
class FilterResponse:
    """Frequency response of one filter.

    Attributes
    ----------
    system : PhyFilter or SampledPhyFilter
    omega : (N,) array
        Frequencies in rad/s, ascending.
    F : (N,) complex array
        From the learning residual gamma = f - f_theta to f_hat - f_theta. For a sampled filter: as the samples of
        f_hat show it, the average over the step and the delay included.
    error : (N,) complex array
        1 - F, from gamma to f - f_hat, without cancellation at low frequencies.
    name : str
        "channel 0", ... of one of several channels with filters of their own; it begins the label.

    Notes
    -----
    A sampled filter sees a continuous gamma e^(j omega t) through its average over the step, (1 - e^(-j omega h)) /
    (j omega h), and a signal above the Nyquist frequency at its alias, which a response over omega cannot show: the
    figures hold for signals below Nyquist. Limits and float32 rounding do not enter. The responses are of one channel
    with M_hat = I and without E: what x, noise and g make of f_hat is E^+ M_hat, or E^+, times them.

    Examples
    --------
    >>> response = frequency_response(PhyFilter([20.0]), [2.0, 20.0])
    >>> response
    <FilterResponse of PhyFilter(a=[20.0]): 2 points, 2 to 20 rad/s>
    >>> np.abs(response.F).round(4).tolist()
    [0.995, 0.7071]
    >>> round(response.bandwidth, 9)
    20.0
    """

    system: Filter
    omega: FloatArray
    F: ComplexArray
    error: ComplexArray
    name: str = ""

    def response(self, input: Input, output: Output = "f_hat") -> ComplexArray:
        """Response from one signal to f_hat or to the error f - f_hat, shape (N,).

        Parameters
        ----------
        input : {"gamma", "x", "g", "f_theta", "noise"}
            "gamma": the residual f - f_theta. "x": the true x; with a delay the measurement lags it. "noise": sensor
            noise added to the measurement of x. "g", "f_theta": as in PhyFilter (M_hat = I).
        output : {"f_hat", "error"}
            For "error" f is an independent input, so every other input acts through f_hat alone.

        Returns
        -------
        (N,) complex array

        Raises
        ------
        ValueError
            If a name is unknown.

        Notes
        -----
        f_hat = f_theta + F (x' - g - f_theta), Eq. (3) of the paper:

        ========= ======== ==========
        input     f_hat    f - f_hat
        ========= ======== ==========
        gamma     F        1 - F
        x, noise  s F      -s F
        g         -F       F
        f_theta   1 - F    -(1 - F)
        ========= ======== ==========

        Sampled, with F_d(z) from u_k to f_hat_k: s F becomes F_d (1 - z^-1)/h, and g and f_theta pass z^-1 (hold)
        or (1 + z^-1)/2 (average) before F_d, with a delay the average over the delayed step.

        Examples
        --------
        >>> response = frequency_response(PhyFilter([20.0]), [20.0])
        >>> response.response("x").round(9).tolist()
        [(10+10j)]
        """
        for name, value, choices in (("input", input, Input), ("output", output, Output)):
            if value not in get_args(choices):
                raise ValueError(f"{name}: expected one of {', '.join(get_args(choices))}, got {value!r}")
        if input == "gamma":
            return self.F if output == "f_hat" else self.error
        value = _paths.to_estimate(self.system, self.omega, input)
        return value if output == "f_hat" else -value

    @property
    def pole_zero_map(self) -> PoleZeroMap:
        """Poles and zeros of the filter, of F and of 1 - F; it draws itself too."""
        return PoleZeroMap([poles_of(self.system, self.label)])

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What is taken for granted of the options of the filter."""
        return assumed(self.system)

    @property
    def nyquist(self) -> float:
        """Nyquist frequency pi/h in rad/s; infinite for a continuous filter."""
        return grids.nyquist(self.system)

    @cached_property
    def band_edges(self) -> tuple[float, float]:
        """Frequencies (low, high) in rad/s between which |F| stays above its reference / sqrt(2).

        The reference is |F(0)|, and low = 0; for a band-pass (F(0) = 0) it is the peak of |F|, and the edges are
        the first crossings on both sides of it. high is inf for a sampled filter that does not fall so far before
        its Nyquist frequency. Both are nan if F = 0.
        """
        grid = grids.search(self.system)
        gain = self._gain(grid)
        if not np.any(gain > 0.0):
            return float("nan"), float("nan")
        top = 0 if self._reaches_dc else int(np.argmax(gain))
        level = _HALF_POWER * (self._dc if self._reaches_dc else self.peak.value)
        low, high = 0.0, float("inf")
        if np.any(gain[top:] < level):
            high = self._crossing(level, grid, top + int(np.argmax(gain[top:] < level)) - 1)
        if np.any(gain[:top] < level):
            low = self._crossing(level, grid, int(np.flatnonzero(gain[:top] < level)[-1]))
        return low, high

    @property
    def bandwidth(self) -> float:
        """Width high - low of :attr:`band_edges` in rad/s: the -3 dB frequency of a low-pass filter."""
        low, high = self.band_edges
        return high - low

    @cached_property
    def peak(self) -> Peak:
        """Maximum of |F| and its frequency (0 where |F| only falls)."""
        return self._maximum(0, [Peak(self._dc, 0.0)])

    @cached_property
    def error_peak(self) -> Peak:
        """Maximum of |1 - F|: what the filter makes worse, and where. For a continuous filter that nowhere exceeds
        1 it is the limit 1 at inf."""
        limits = [Peak(abs(1.0 - self._filter.dc_gain), 0.0)]
        if np.isinf(self.nyquist):
            limits.append(Peak(1.0, float("inf")))
        return self._maximum(1, limits)

    def phase_lag(self, omega: ArrayLike | None = None) -> FloatArray:
        """Phase by which F lags, in rad, unwrapped.

        Parameters
        ----------
        omega : array_like, optional
            Frequencies in rad/s; None means those of the response.

        Returns
        -------
        array of the shape of ``omega``
            0 at omega = 0 for F(0) > 0; for a band-pass the branch with the least lag at the peak.

        Raises
        ------
        ValueError
            If a frequency is negative, not finite, or above the Nyquist frequency.

        Examples
        --------
        >>> round(float(frequency_response(PhyFilter([400.0, 40.0])).phase_lag(20.0)), 6)
        1.570796
        """
        wanted = self.omega if omega is None else _signals.real("omega", omega)
        flat = grids.checked(np.ravel(wanted), self.nyquist)
        grid = grids.search(self.system)
        every = np.union1d(grid[grid > 0.0], flat)
        # The delay turns F many times; taken out, the rest unwraps safely on a grid in log omega.
        delay = self.system.sampling.delay if isinstance(self.system, SampledPhyFilter) else 0.0
        F = _paths.residual(self.system, every)[0] * np.exp(1j * every * delay)
        phase = np.unwrap(np.angle(F))
        anchor = 0 if self._reaches_dc else int(np.argmax(np.abs(F)))
        phase -= 2.0 * np.pi * np.round(phase[anchor] / (2.0 * np.pi))
        lag = every * delay - phase
        return lag[np.searchsorted(every, flat)].reshape(np.shape(wanted))

    @cached_property
    def noise_gain(self) -> float:
        """What white sensor noise on x leaves in f_hat, in the direction that has most.

        The filter's own E and inertia (1 where it comes with every sample) count, by norm2(E^+ M_hat).

        Sampled: standard deviation of f_hat per standard deviation of noise that is independent from sample to
        sample, in 1/s, exact (the noise in x_k enters u_k and u_{k+1} with opposite signs). Continuous: the square
        root of the integral of |s F|^2 d omega / 2 pi over all omega, for noise of unit two-sided density; inf where
        F has relative degree 1, as s F then passes white noise unfiltered, whose variance is infinite. nan where
        poles are so lightly damped that rounding hides whether they decay.

        Notes
        -----
        Both from a Lyapunov equation of the chain of sections, the discrete one after a bilinear change that keeps
        the delta form.
        """
        return _paths.noise_gain(self.system) * input_gains(self.system, None, needed=False).x

    @property
    def label(self) -> str:
        """Order, band and step in words, as the legend has them."""
        return self.label_in("rad/s", 1.0)

    def label_in(self, unit: str, per: float) -> str:
        """The label in another unit of frequency.

        Parameters
        ----------
        unit : str
            Its name, such as "Hz".
        per : float
            How many rad/s one of it is.
        """
        low, high = (edge / per for edge in self.band_edges)
        band = f"{high:.3g}" if low == 0.0 else f"{low:.3g} to {high:.3g}"
        step = f", h = {1e3 * self.system.dt:.3g} ms" if isinstance(self.system, SampledPhyFilter) else ""
        name = f"{self.name}: " if self.name else ""
        return f"{name}n = {self._filter.order}, {band} {unit}{step}"

    def curve(self, label: str | None = None) -> plots.FrequencyCurve:
        """What a frequency plot draws of it.

        Parameters
        ----------
        label : str, optional
            Entry of the legend instead of :attr:`label`.
        """
        name = self.label if label is None else label
        return plots.FrequencyCurve(name, self.omega, self.F, self.error, -self.phase_lag(), self.nyquist)

    def plot(
        self,
        ax: Sequence[Axes] | None = None,
        *,
        label: str | None = None,
        limits: Sequence[plots.FrequencyLimit] = (),
        dB: bool | None = None,
        Hz: bool | None = None,
        deg: bool | None = None,
    ) -> ct.ControlPlot:
        """Draw |F|, |1 - F| and the phase of F.

        Parameters
        ----------
        ax : two Axes, optional
            Magnitude and phase; None makes a new figure.
        label : str, optional
            Entry of the legend instead of :attr:`label`.
        limits : sequence of FrequencyLimit
            What |F| or |1 - F| must stay below, drawn beside them.
        dB, Hz, deg : bool, optional
            Magnitudes in dB, frequencies in Hz, phase in degrees; None: python-control's settings ``freqplot.dB``,
            ``freqplot.Hz`` and ``freqplot.deg``.

        Returns
        -------
        control.ControlPlot
        """
        labels = None if label is None else [label]
        return FilterResponseList((self,)).plot(ax, labels=labels, limits=limits, dB=dB, Hz=Hz, deg=deg)

    def __repr__(self) -> str:
        points = f"{len(self.omega)} point{'s' * (len(self.omega) != 1)}"
        return f"<FilterResponse of {self.system!r}: {points}, {self.omega[0]:.4g} to {self.omega[-1]:.4g} rad/s>"

    # -- inside ---------------------------------------------------------------------------------------------------

    @property
    def _filter(self) -> PhyFilter:
        return self.system if isinstance(self.system, PhyFilter) else self.system.filter

    @property
    def _dc(self) -> float:
        return abs(self._filter.dc_gain)

    @cached_property
    def _reaches_dc(self) -> bool:
        return self._dc > _NO_DC * self.peak.value

    def _gain(self, omega: ArrayLike) -> FloatArray:
        return np.abs(_paths.residual(self.system, np.atleast_1d(_signals.real("omega", omega)))[0])

    def _crossing(self, level: float, grid: FloatArray, k: int) -> float:
        """Where |F| = level between grid[k] and grid[k + 1]."""
        low, high = float(grid[k]), float(grid[k + 1])
        return cast(float, brentq(lambda w: self._gain(w)[0] - level, low, high, xtol=1e-15 * high))

    def _maximum(self, which: Literal[0, 1], limits: list[Peak]) -> Peak:
        """Largest |F| (0) or |1 - F| (1) over the search grid, refined, or a limit at 0 or infinity."""
        grid = grids.search(self.system)
        values = np.abs(_paths.residual(self.system, grid)[which])
        limit = max(limits)
        k = int(np.argmax(values))
        if not values[k] > limit.value * (1.0 + _ABOVE_LIMIT):
            return limit
        if k == len(grid) - 1:
            return Peak(float(values[k]), float(grid[k]))
        found = minimize_scalar(
            lambda w: -float(np.abs(_paths.residual(self.system, np.array([w]))[which][0])),
            bounds=(grid[max(k - 1, 0)], grid[k + 1]),
            method="bounded",
            options={"xatol": 1e-9 * grid[k]},
        )
        return max(Peak(float(values[k]), float(grid[k])), Peak(float(-found.fun), float(found.x)))


class FilterResponseList(tuple[FilterResponse, ...]):
    """Responses of several filters over one axis; a tuple that can draw itself."""

    @property
    def pole_zero_map(self) -> PoleZeroMap:
        """Poles and zeros of all of them."""
        return PoleZeroMap(poles_of(each.system, each.label) for each in self)

    def plot(
        self,
        ax: Sequence[Axes] | None = None,
        *,
        labels: Sequence[str] | None = None,
        limits: Sequence[plots.FrequencyLimit] = (),
        dB: bool | None = None,
        Hz: bool | None = None,
        deg: bool | None = None,
    ) -> ct.ControlPlot:
        """Draw all responses into one magnitude and one phase diagram.

        Parameters
        ----------
        ax : two Axes, optional
            Magnitude and phase; None makes a new figure.
        labels : sequence of str, optional
            One entry of the legend each instead of the responses' own.
        limits : sequence of FrequencyLimit
            What |F| or |1 - F| must stay below, drawn beside them.
        dB, Hz, deg : bool, optional
            As for :meth:`FilterResponse.plot`.

        Returns
        -------
        control.ControlPlot

        Raises
        ------
        ValueError
            If there are more or fewer labels than responses.
        """
        if labels is not None and len(labels) != len(self):
            raise ValueError(f"labels: expected one for each of the {len(self)} responses, got {len(labels)}")
        if labels is None:
            labels = [each.label_in(*frequency_unit(Hz)) for each in self]
        curves = [each.curve(name) for name, each in zip(labels, self, strict=True)]
        return frequency_plot(curves, limits=limits, ax=ax, dB=dB, Hz=Hz, deg=deg)


@overload
def frequency_response(  # pyright: ignore[reportOverlappingOverload]  # a SampledPhyFilter with several responses
    system: SampledBank | Sequence[Filter], omega: ArrayLike | None = None
) -> FilterResponseList: ...


@overload
def frequency_response(  # pyright: ignore[reportOverlappingOverload]  # a PhyFilter, an LTI too, has more to tell
    system: Filter, omega: ArrayLike | None = None
) -> FilterResponse: ...


@overload
def frequency_response(system: LTI, omega: ArrayLike | None = None) -> ct.FrequencyResponseData: ...


def frequency_response(
    system: Filter | Sequence[Filter] | LTI, omega: ArrayLike | None = None
) -> FilterResponse | FilterResponseList | ct.FrequencyResponseData:
    """Frequency response of a filter, of several on one axis, or of a python-control system.

    Parameters
    ----------
    system : PhyFilter, SampledPhyFilter, a sequence of them, or a linear python-control system
    omega : array_like, shape (N,), optional
        Frequencies in rad/s, sorted before use. None: a logarithmic grid from two decades below the slowest to two
        above the fastest pole, for sampled systems up to the Nyquist frequency.

    Returns
    -------
    FilterResponse
        For one filter.
    FilterResponseList
        For several, and of what ``stack`` gives for every channel: over one common grid; each sampled one stops at
        its own Nyquist frequency.
    control.FrequencyResponseData
        For a python-control system, as ``control.frequency_response`` returns it.

    Raises
    ------
    TypeError
        If ``system`` is none of the above, such as a nonlinear system.
    ValueError
        If frequencies are not finite, none is left below the Nyquist frequency, one filter is asked for frequencies
        below 0 or above its Nyquist frequency.

    Notes
    -----
    Of a StateSpace by back substitution over its Schur form, for all frequencies together. Where j omega (or z) is
    exactly a pole, every entry is complex(inf, nan), as in python-control (which looks further for a zero at the same
    place, and then writes nan in both parts). Above the Nyquist frequency a discrete system's response repeats itself.

    Examples
    --------
    >>> filter = PhyFilter([400.0, 40.0])
    >>> both = frequency_response([filter, filter.sampled(0.01)])
    >>> [round(float(each.omega[-1]), 1) for each in both]
    [2000.0, 314.2]
    >>> data = frequency_response(filter.state_space(3), [1.0, 10.0, 100.0])
    >>> data.frdata.shape
    (3, 9, 3)
    """
    if isinstance(system, ct.StateSpace) and not isinstance(system, Filter):
        return _resolvent.frequency_response(system, omega)
    if isinstance(system, LTI) and not isinstance(system, Filter):
        return cast(ct.FrequencyResponseData, ct.frequency_response(system, omega))
    if (filters := channels_of(system)) is not None:
        return _responses(filters, omega)
    if isinstance(system, Filter):
        if omega is not None:
            grids.checked(grids.ordered(omega), grids.nyquist(system))
        return _responses([("", system)], omega)[0]
    raise TypeError(
        "frequency_response: expected a PhyFilter, a SampledPhyFilter, a sequence of them or a linear python-control "
        f"system, got {type(system).__name__}; linearise a nonlinear system first"
    )


def _responses(named: Sequence[tuple[str, Filter]], omega: ArrayLike | None) -> FilterResponseList:
    grid = grids.default([system for _, system in named]) if omega is None else grids.ordered(omega)
    answers = []
    for name, system in named:
        nyquist = grids.nyquist(system)
        below = grid[grid < nyquist]
        if omega is None and np.isfinite(nyquist):
            below = np.append(below, nyquist)
        elif nyquist in grid:
            below = np.append(below, grid[grid == nyquist])
        mine = grids.checked(below, nyquist)
        F, error = _paths.residual(system, mine)
        answers.append(FilterResponse(system, mine, F, error, name))
    return FilterResponseList(answers)
