"""What disturbs a filter and its loop: bounds of signals, or their spectra and deviations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field

import control as ct
import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._signals import number

__all__ = ["Bounded", "Bounds", "Gaussian", "Implementation", "Shape", "bounded", "gauss_markov", "shaping"]

Bounds = Mapping[int, float] | Sequence[Mapping[int, float]]
Shape = ct.StateSpace | ct.TransferFunction


@dataclass(frozen=True, kw_only=True)
class Implementation:
    """What is known of the signals, the clock and the converters of a filter as it runs; bounds, by default ideal.

    Signals have bounds of their derivatives by order, as ``residual`` has, in the 2-norm and between the samples too.

    Parameters
    ----------
    g : dict of int to float
        0: |g|, for the rounding; 1: |g'|, of a g that moves between the samples, under either rule; 2: |g''|, under
        g="average". Without 1 (or 2) g is taken to go between the samples as the filter's rule says.
    f_theta : dict of int to float
        The same of f_theta.
    x : dict of int to float
        0: |x|, for the rounding; 2: |x''|. |x'| is ``rate`` of :class:`Bounded`.
    inertia : dict of int to float
        1, 2: |M_hat'| and |M_hat''| in the spectral norm, per s and s^2, of a model of the inertia that moves.
    f : float, optional
        Largest |f| that is possible: what a filter with a ``limit`` promises rests on it.
    jitter : float
        How far in s a sampling instant may be off its place on the grid, each on its own.
    delay_error : float
        How far in s the delay of x may be off the one that the filter knows, constant.
    x_step, g_step : float
        Steps of quantisation; of n axes of step q in the 2-norm: sqrt(n) q.
    rounding : float
        How far rounding may move f_hat in another arithmetic than the filter's, so without ``x[0]``: in fixed point
        ``FixedPoint.error_bound``; of n axes in the 2-norm sqrt(n) times as much.

    Raises
    ------
    ValueError
        For a negative bound or an order that does not count.

    Examples
    --------
    A g that is smooth and taken as held, through one pole: h/2 |g'| more.

    >>> from phyfilter_ctl import PhyFilter, error_bound
    >>> sampled = PhyFilter([20.0]).sampled(0.01)
    >>> found = error_bound(sampled, Bounded({1: 1.0}, implementation=Implementation(g={1: 48.0})))
    >>> round(found.implementation["g between samples"], 9)
    0.24
    """

    g: Mapping[int, float] = field(default_factory=dict)
    f_theta: Mapping[int, float] = field(default_factory=dict)
    x: Mapping[int, float] = field(default_factory=dict)
    inertia: Mapping[int, float] = field(default_factory=dict)
    f: float | None = None
    jitter: float = 0.0
    delay_error: float = 0.0
    x_step: float = 0.0
    g_step: float = 0.0
    rounding: float = 0.0

    def __post_init__(self) -> None:
        orders = {"g": (0, 1, 2), "f_theta": (0, 1, 2), "x": (0, 2), "inertia": (1, 2)}
        for name, allowed in orders.items():
            given = getattr(self, name)
            if not isinstance(given, Mapping):
                raise ValueError(
                    f"{name}: expected bounds by order of derivative, e.g. {{1: 2.0}}, got {given!r}"
                )
            for k, value in given.items():
                if k not in allowed:
                    advice = "; |x'| is `rate`" if name == "x" else ""
                    raise ValueError(f"{name}: expected derivatives of order {allowed}, got {k!r}{advice}")
                number(f"{name}[{k}]", value, least=0.0)
        for name in ("jitter", "delay_error", "x_step", "g_step", "rounding"):
            number(name, getattr(self, name), least=0.0)
        if self.f is not None:
            number("f", self.f, least=0.0)
        if self.rounding and 0 in self.x:
            raise ValueError("rounding: expected without x[0], from which that of float or double is found")


@dataclass(frozen=True)
class Bounded:
    r"""Disturbances by their bounds, whatever they do within them.

    Parameters
    ----------
    residual : mapping of int to float, or sequence of them
        Bounds delta_k of the k-th derivatives of gamma = f - f_theta, in f per s^k (2-norm): ``{0: 4.0, 1: 12.0}``. A
        sequence: of parts that add up, a slow one with a bound on its slope and a rough one with a bound on itself, say
        (of :func:`~phyfilter_ctl.tracking_error`). A list of ``Bounded`` is one for each channel.
    noise : float
        Of x, in its unit.
    inertia_error : float
        Of M - M_hat in the spectral norm; with ``rate``, by which it counts.
    rate : float, optional
        Of \|x'\|.
    actuation : mapping of int to float, or sequence of them
        The same as ``residual`` for what the actuator does beyond its model: gains, lags and feed-forward that it
        misses.
    position_noise : float
        Of the position, in the unit of x times s.
    implementation : Implementation, optional
        What a sampled filter meets as it runs.

    Raises
    ------
    TypeError
        For a bound that is not a number, or bounds of a signal that are not by order.
    ValueError
        For a negative bound, an order that is no derivative's, or an ``inertia_error`` without ``rate``.

    Examples
    --------
    >>> Bounded({1: 3.0}, noise=0.01).residual
    {1: 3.0}
    >>> Bounded({1: 3.0}, inertia_error=0.2)
    Traceback (most recent call last):
    ValueError: inertia_error: what it does grows with |x'|; give its bound too, rate=...
    """

    residual: Bounds = field(default_factory=dict)
    _: KW_ONLY
    noise: float = 0.0
    inertia_error: float = 0.0
    rate: float | None = None
    actuation: Bounds = ()
    position_noise: float = 0.0
    implementation: Implementation | None = None

    def __post_init__(self) -> None:
        for name in ("residual", "actuation"):
            object.__setattr__(self, name, _by_order(name, getattr(self, name)))
        for name in ("noise", "inertia_error", "position_noise"):
            object.__setattr__(self, name, number(name, getattr(self, name), least=0.0))
        if self.rate is not None:
            object.__setattr__(self, "rate", number("rate", self.rate, least=0.0))
        if self.inertia_error and not self.rate:
            raise ValueError("inertia_error: what it does grows with |x'|; give its bound too, rate=...")
        if self.implementation is not None and not isinstance(self.implementation, Implementation):
            raise TypeError(f"implementation: expected an Implementation, got {self.implementation!r}")

    @property
    def parts(self) -> tuple[Mapping[int, float], ...]:
        """Of the residual, as they add up."""
        return _parts(self.residual)

    @property
    def slope(self) -> float | None:
        r"""The \|gamma'\| that alone is known of the residual."""
        return self.parts[0][1] if len(self.parts) == 1 and set(self.parts[0]) == {1} else None


@dataclass(frozen=True)
class Gaussian:
    """Stationary Gaussian disturbances by their spectra and deviations.

    Parameters
    ----------
    residual, actuation : control system or (L,) array, optional
        Shaping filters of gamma and of what the actuator does beyond its model, from unit white noise, stable and
        strictly proper: :func:`gauss_markov`. Or, for :func:`~phyfilter_ctl.tracking_error`, their autocovariances at
        the lags 0, dt, 2 dt, ...; the signals then run straight from sample to sample.
    noise : float or control system
        Of x: of a sampled filter the standard deviation of independent noise of its samples; of a continuous one the
        square root of the density of white noise, or a shaping filter.
    position_noise : float
        Standard deviation of independent noise of the samples of the position.

    Raises
    ------
    ValueError
        For a negative deviation, or a shaping filter that is not stable, strictly proper, continuous, with one output.

    Examples
    --------
    >>> Gaussian(gauss_markov(1.0, 0.5), noise=0.01).noise
    0.01
    """

    residual: Shape | ArrayLike | None = None
    _: KW_ONLY
    noise: float | Shape = 0.0
    actuation: Shape | ArrayLike | None = None
    position_noise: float = 0.0

    def __post_init__(self) -> None:
        for name in ("residual", "actuation", "noise"):
            value = getattr(self, name)
            if isinstance(value, ct.StateSpace | ct.TransferFunction):
                shaping(name, value)
            elif name == "noise":
                object.__setattr__(self, name, number(name, value, least=0.0))
        object.__setattr__(self, "position_noise", number("position_noise", self.position_noise, least=0.0))


def bounded(disturbance: Bounded | Mapping[int, float]) -> Bounded:
    """Bounds, of which a mapping is those of the residual alone.

    Raises
    ------
    TypeError
        For a disturbance of another kind.
    """
    if isinstance(disturbance, Bounded):
        return disturbance
    if isinstance(disturbance, Mapping):
        return Bounded(disturbance)
    raise TypeError(
        f"disturbance: expected a Bounded, or bounds of the residual by order of derivative, e.g. {{1: 2.0}}, got "
        f"{disturbance!r}"
    )


def _parts(given: Bounds) -> tuple[Mapping[int, float], ...]:
    return (given,) if isinstance(given, Mapping) else tuple(given)


def _by_order(name: str, given: Bounds) -> Bounds:
    """Bounds by order of derivative, checked: one mapping, or a tuple of them."""
    if not isinstance(given, Mapping | Sequence) or isinstance(given, str):
        raise TypeError(f"{name}: expected bounds by order of derivative, e.g. {{1: 2.0}}, got {given!r}")
    checked = []
    for part in _parts(given):
        if not isinstance(part, Mapping):
            raise TypeError(
                f"{name}: expected bounds by order of derivative, e.g. {{1: 2.0}}, got {part!r} in {given!r}"
            )
        for k in part:
            if isinstance(k, bool) or not (isinstance(k, int | np.integer) and k >= 0):
                raise ValueError(f"{name}: expected derivative orders 0, 1, ..., got {k!r}")
        if not part and not isinstance(given, Mapping):
            raise ValueError(f"{name}: expected {{derivative: bound}} for each part, got none")
        checked.append({int(k): number(f"{name}[{k}]", value, least=0.0) for k, value in part.items()})
    return checked[0] if isinstance(given, Mapping) else tuple(checked)


def gauss_markov(deviation: float, time_constant: float) -> ct.StateSpace:
    """Shaping filter of a first-order Gauss-Markov process: exponentially correlated, stationary.

    Parameters
    ----------
    deviation : float
        Its standard deviation.
    time_constant : float
        Seconds after which the correlation has fallen to 1/e.

    Returns
    -------
    control.StateSpace
        From unit white noise to the process.

    Raises
    ------
    ValueError
        Unless both are positive.

    Examples
    --------
    >>> from phyfilter_ctl import PhyFilter, error_variance
    >>> error = error_variance(PhyFilter([20.0]), Gaussian(gauss_markov(1.0, 0.5))).residual_error
    >>> round(float(error), 6)
    0.090909
    """
    deviation = _signals.number("deviation", deviation, above=0.0)
    rate = 1.0 / _signals.number("time_constant", time_constant, "s", above=0.0)
    return ct.StateSpace([[-rate]], [[deviation * np.sqrt(2.0 * rate)]], [[1.0]], [[0.0]])


def shaping(name: str, system: Shape) -> ct.StateSpace:
    """A shaping filter as a state space, checked: continuous, one output, strictly proper, stable."""
    if not isinstance(system, ct.StateSpace | ct.TransferFunction):
        raise ValueError(
            f"{name}: expected a control.StateSpace or TransferFunction, got {type(system).__name__}"
        )
    shape = system if isinstance(system, ct.StateSpace) else ct.StateSpace(ct.tf2ss(system))
    if shape.isdtime(strict=True):
        raise ValueError(f"{name}: expected a continuous shaping filter, got one with dt = {shape.dt}")
    if shape.noutputs != 1:
        raise ValueError(
            f"{name}: expected one output, got {shape.noutputs}; variances are those of one channel"
        )
    if np.any(shape.D != 0.0):
        raise ValueError(
            f"{name}: expected a strictly proper shaping filter; white noise has an infinite variance"
        )
    poles = np.linalg.eigvals(shape.A)
    if np.any(poles.real >= 0.0):
        raise ValueError(
            f"{name}: expected a stable shaping filter, got a pole at {poles[np.argmax(poles.real)]:.6g}"
        )
    return shape
