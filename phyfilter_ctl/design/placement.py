"""Filters by placement: poles given one by one or by a family and a cutoff, numerators by what 1 - F must cancel."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from contextlib import suppress
from typing import Literal, SupportsIndex, cast, get_args

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import ArrayLike
from scipy import signal
from scipy.optimize import brentq

from .. import _signals
from .._choices import Family
from .._renamed import takes_numerator
from .._sections import ComplexArray, FloatArray
from ..filter import PhyFilter

__all__ = ["Family", "bandpass", "hz", "lowpass", "place_poles"]

# ITAE standard forms with a_0 = 1: the inner coefficients a_1 ... a_{n-1} of D that minimise the integral of t |e|
# for a step into 1/D (the criterion of Graham and Lathrop, 1953; their figures came from an analogue computer and
# are a little off the minimum). Found by minimising the integral written out in closed form between the zeros of e.
_ITAE: dict[int, tuple[float, ...]] = {
    1: (),
    2: (1.504888,),
    3: (2.171487, 1.782778),
    4: (2.647307, 3.345769, 1.952039),
    5: (3.256831, 4.673131, 4.497612, 2.066823),
    6: (3.739917, 6.792901, 6.934691, 5.629398, 2.152377),
    7: (4.323339, 8.681845, 11.582138, 9.356018, 6.746499, 2.220210),
    8: (4.814831, 11.340244, 16.115991, 17.594452, 11.889969, 7.852604, 2.275430),
}
# |F| at the cutoff, and at both edges of a band.
_HALF_POWER = 1.0 / np.sqrt(2.0)


def hz(frequency: float) -> float:
    """Angular frequency in rad/s of a frequency in Hz, for whatever takes rad/s.

    Parameters
    ----------
    frequency : float
        In Hz.

    Raises
    ------
    TypeError, ValueError
        If it is not one finite real number.

    Examples
    --------
    >>> round(hz(1.0), 6)
    6.283185
    >>> lowpass(1, hz(3.2)).poles.real.round(3).tolist()
    [-20.106]
    """
    return 2.0 * np.pi * _signals.number("frequency", frequency, "Hz")


@takes_numerator
def place_poles(
    poles: ArrayLike,
    *,
    type: SupportsIndex = 1,
    numerator: Sequence[float] | FloatArray | None = None,
    zeros_at: ArrayLike = (),
) -> PhyFilter:
    """Return the filter with these poles and a numerator chosen by what 1 - F must cancel.

    Parameters
    ----------
    poles : array_like, shape (n,)
        Roots of D in rad/s; complex ones in conjugate pairs. They are kept exactly.
    type : int
        Zeros k of 1 - F at s = 0, 1 <= k <= n: b_i = a_i for i < k and 0 beyond. 1 is the low-pass form, N = a_0; k = n
        is N = D - s^n. Residuals that are polynomials in t of degree k - 1 are followed with no steady error.
    numerator : array_like, shape (n,), optional
        The ascending coefficients b_0 ... b_{n-1} themselves, in place of a type.
    zeros_at : array_like, shape (m,), optional
        Angular frequencies w > 0 in rad/s at which 1 - F vanishes too, so that a residual periodic there is
        followed with no steady error (internal model). The type k is kept and b_k ... b_{k+2m-1} are solved from
        (D - N)(j w) = 0; this needs an order n >= k + 2 m.

    Returns
    -------
    PhyFilter

    Raises
    ------
    ValueError
        If a pole is not in the open left half plane or lacks its conjugate; if the type is outside 1 ... n; if
        frequencies in ``zeros_at`` are not positive and distinct, need a higher order (which one is said), or the
        coefficients are given and a type or frequencies as well.

    Notes
    -----
    1 - F = (D - N)/D, the general form of the paper's supplement "Filtering learning residual with more general
    form". The zeros follow Francis and Wonham, "The internal model principle of control theory", Automatica 12
    (1976): D - N = s^k W(s) Q(s) with W the product of s^2 + w^2. Q is the quotient of the untouched head of D by
    W, so W divides D - N exactly and no system of equations has to be solved.

    Examples
    --------
    >>> place_poles([-20, -20])
    PhyFilter(a=[400.0, 40.0])
    >>> place_poles([-20, -20], type=2).type
    2
    >>> hum = place_poles([-20, -20, -20], zeros_at=[6.0])
    >>> hum.type, bool(abs(hum.error(6j)) < 1e-12)
    (1, True)
    """
    shape = PhyFilter.from_poles(poles)
    frequencies = _frequencies(zeros_at)
    if numerator is not None:
        if len(frequencies) or type != 1:
            raise ValueError(
                f"{'zeros_at' if len(frequencies) else 'type'}: the zeros of 1 - F decide the numerator, which is "
                "already given by its coefficients; give one of the two"
            )
        return PhyFilter.from_poles(poles, _signals.array("numerator", numerator, (shape.order,)))
    kind = _type("type", type, shape.order)
    if kind == 1 and len(frequencies) == 0:
        return shape
    return PhyFilter(shape.a, _cancelling(shape.a, kind, frequencies), poles=shape.poles)


@takes_numerator
def lowpass(
    order: SupportsIndex,
    cutoff: float,
    *,
    family: Family = "binomial",
    type: SupportsIndex = 1,
    norm: Literal["magnitude", "natural"] = "magnitude",
) -> PhyFilter:
    """Return the filter of a family with a given cutoff.

    Parameters
    ----------
    order : int
        Order n of D, at least 1 ("itae": at most 8).
    cutoff : float
        Cutoff in rad/s.
    family : "binomial", "butterworth", "bessel" or "itae"
        Binomial: n equal poles, no overshoot. Butterworth: flattest magnitude. Bessel: flattest delay. ITAE: least
        integral of t |e| for a step residual.
    type : int
        As in :func:`place_poles`.
    norm : "magnitude" or "natural"
        "magnitude": |F(j cutoff)| = 1/sqrt(2), the first time |F| falls to it, whatever the family and type.
        "natural": a_0 = cutoff^n, so binomial poles are all at -cutoff.

    Returns
    -------
    PhyFilter

    Raises
    ------
    ValueError
        If the order, the cutoff, the family, the type or the norm is none of the above.

    Notes
    -----
    Butterworth and Bessel prototypes are scipy's. The ITAE criterion is Graham and Lathrop, "The synthesis of
    optimum transient response: criteria and standard forms", Trans. AIEE 72 (1953); the coefficients stored here
    minimise it numerically.

    Examples
    --------
    >>> butterworth = lowpass(3, 20.0, family="butterworth")
    >>> abs(butterworth(20j)).round(12).item()
    0.707106781187
    >>> lowpass(2, 20.0, norm="natural")
    PhyFilter(a=[400.0, 40.0])
    """
    n = _order(order)
    cutoff = _frequency("cutoff", cutoff)
    poles = _prototype(n, family)
    kind = _type("type", type, n)
    if norm == "magnitude":
        cutoff = cutoff / _half_power(place_poles(poles, type=kind))
    elif norm != "natural":
        raise ValueError(f'norm: expected "magnitude" or "natural", got {norm!r}')
    return place_poles(poles * cutoff, type=kind)


def bandpass(
    order: SupportsIndex,
    low: float,
    high: float,
    *,
    family: Family = "butterworth",
    dt: float = 0.0,
    delay: float = 0.0,
) -> PhyFilter:
    """Return the band-pass filter with the edges low and high.

    Parameters
    ----------
    order : int
        Order n of D, even: a low-pass prototype of order n/2 is carried to the band.
    low, high : float
        Band edges in rad/s, low < high, where |F| = 1/sqrt(2). At the centre sqrt(low high) F = 1.
    family : "binomial", "butterworth", "bessel" or "itae"
        Family of the prototype.
    dt : float
        Interval in s over which the fed-back estimate is held; 0 for one that acts without a hold.
    delay : float
        Known delay in s with which the fed-back estimate acts, beside the hold.

    Returns
    -------
    PhyFilter
        With b_0 = 0: what is constant in the residual is left alone. Order 2 with a lead has no coefficient left for
        that: F(0) = -(high - low) sin(w T)/w, in the notation below.

    Raises
    ------
    ValueError
        If the order is odd or below 2, an edge is not positive, low >= high, the family is unknown, an interval or
        delay is negative, or they ask for a lead of a quarter of the centre's period and more.

    Notes
    -----
    General form of the paper's supplement with N = k s^(n/2). The low-pass to band-pass change
    s -> (s^2 + low high)/((high - low) s) is made on the poles (scipy.signal.lp2bp_zpk), which are kept exactly.

    A hold lags by dt/2: fed back, 1 - F exp(-s T) of a force at the centre w is left over, T = dt/2 + delay, which is
    w T where F = 1. With ``dt`` or ``delay`` F(j w) = exp(j w T), by

        N = k s^(n/2) (cos(w T) + sin(w T) s/w),    n = 2: N = k (cos(w T) s - w sin(w T)).

    The poles stay. What the hold's gain leaves is (w dt)^2/12 at most.

    Examples
    --------
    >>> band = bandpass(2, 4.0, 9.0)
    >>> [round(float(abs(band(1j * w))), 6) for w in (4.0, 6.0, 9.0)]
    [0.707107, 1.0, 0.707107]
    >>> band.b.round(9).tolist()
    [0.0, 5.0]

    Held for 20 ms and 10 ms late, so 20 ms ahead:

    >>> ahead = bandpass(4, 4.0, 9.0, dt=0.02, delay=0.01)
    >>> abs(ahead(6j) * np.exp(-6j * 0.02) - 1.0).round(12).item()
    0.0
    """
    n = _order(order)
    if n % 2:
        raise ValueError(
            f"order: a band-pass has an even order (twice its prototype's), got {n}; use {n - 1 or 2} or {n + 1}"
        )
    low, high = _frequency("low", low), _frequency("high", high)
    if not low < high:
        raise ValueError(f"low, high: expected low < high, got {low:g} and {high:g} rad/s")
    poles = _prototype(n // 2, family)
    poles = poles / _half_power(PhyFilter.from_poles(poles))
    gain = float(np.prod(-poles).real)
    _, band, k = signal.lp2bp_zpk(np.zeros(0), poles, gain, wo=float(np.sqrt(low * high)), bw=high - low)
    centre = float(np.sqrt(low * high))
    lead = centre * _lag(dt, delay, centre)
    b = np.zeros(n)
    b[n // 2] = k.real * np.cos(lead)
    if n > 2:
        b[n // 2 + 1] = k.real * np.sin(lead) / centre
    else:
        b[0] -= k.real * np.sin(lead) * centre
    return PhyFilter.from_poles(band, b)


def _lag(dt: float, delay: float, centre: float) -> float:
    """By which a held and delayed estimate comes late, s."""
    lag = 0.5 * _signals.number("dt", dt, "s", least=0.0) + _signals.number("delay", delay, "s", least=0.0)
    if centre * lag >= 0.5 * np.pi:
        raise ValueError(
            f"dt, delay: expected dt/2 + delay below a quarter of the centre's period, {0.5 * np.pi / centre:g} s, got "
            f"{lag:g} s; sample faster, or choose a lower band"
        )
    return lag


def _cancelling(a: FloatArray, kind: int, frequencies: FloatArray) -> FloatArray:
    """Numerator of type ``kind`` with (D - N)(j w) = 0 at the frequencies."""
    n, solved = len(a), 2 * len(frequencies)
    b = a.copy()
    b[kind:] = 0.0
    if solved == 0:
        return b
    if kind + solved > n:
        raise ValueError(
            f"zeros_at: type {kind} and {len(frequencies)} frequencies need order {kind} + 2 x {len(frequencies)} = "
            f"{kind + solved}, got {n} poles; add {kind + solved - n}"
        )
    # In s / scale the coefficients are of one size; the geometric mean keeps wide sets of frequencies central.
    scale = float(np.exp(np.mean(np.log(frequencies))))
    with np.errstate(over="ignore"):
        powers = scale ** np.arange(n, 0, -1)
    if not (np.isfinite(powers).all() and powers.all()):
        raise ValueError(
            f"zeros_at: power {n} of {scale:g} rad/s leaves the range of double precision; expected frequencies "
            "that the loop can meet, or another unit of time"
        )
    cancel = np.array([1.0])
    for w in frequencies / scale:
        cancel = polynomial.polymul(cancel, [w * w, 0.0, 1.0])
    head = np.concatenate([np.zeros(solved), (a / powers)[kind + solved :], [1.0]])
    quotient, _ = polynomial.polydiv(head, cancel)
    kept = polynomial.polymul(quotient, cancel)[:-1] * powers[kind:]
    b[kind : kind + solved] = a[kind : kind + solved] - kept[:solved]
    return b


def _prototype(n: int, family: str) -> ComplexArray:
    """Poles of the family's low-pass prototype with a_0 = 1."""
    if family == "binomial":
        return np.full(n, -1.0 + 0.0j)
    if family == "butterworth":
        return np.asarray(signal.buttap(n)[1], dtype=np.complex128)
    if family == "bessel":
        try:
            with np.errstate(all="ignore"):  # on the way to the error
                return np.asarray(signal.besselap(n, norm="phase")[1], dtype=np.complex128)
        except RuntimeError as error:
            raise ValueError(
                f"order: the poles of Bessel's order {n} cannot be told; expected a lower one"
            ) from error
    if family == "itae":
        if n not in _ITAE:
            raise ValueError(f"order: ITAE forms are tabulated for orders 1 ... {max(_ITAE)}, got {n}")
        return PhyFilter([1.0, *_ITAE[n]]).poles
    raise ValueError(f"family: expected one of {', '.join(get_args(Family))}, got {family!r}")


def _half_power(prototype: PhyFilter) -> float:
    """Least frequency at which |F| falls to 1/sqrt(2), for a filter with F(0) = 1 and a_0 = 1."""

    def above(log_omega: float) -> float:
        return float(abs(prototype(1j * np.exp(log_omega)))) - _HALF_POWER

    grid = np.linspace(np.log(1e-3), np.log(1e3), 1201)
    below = int(np.argmax(np.abs(prototype(1j * np.exp(grid))) < _HALF_POWER))
    return float(np.exp(cast(float, brentq(above, grid[below - 1], grid[below], xtol=1e-15))))


def _order(order: SupportsIndex) -> int:
    n = _integer("order", order)
    if n < 1:
        raise ValueError(f"order: expected at least 1, got {n}")
    return n


def _type(name: str, value: object, order: int) -> int:
    kind = _integer(name, value)
    if not 1 <= kind <= order:
        raise ValueError(
            f"{name}: a filter of order {order} can have type 1 ... {order}, got {kind}"
            + (f"; type {kind} needs {kind} poles" if kind > order else "")
        )
    return kind


def _integer(name: str, value: object) -> int:
    if isinstance(value, SupportsIndex) and not isinstance(value, (bool, np.bool_)):
        with suppress(TypeError):  # an array of one number has the method, but refuses
            return operator.index(value)
    raise TypeError(f"{name}: expected an integer, got {value!r}")


def _frequency(name: str, value: float) -> float:
    if not (np.ndim(value) == 0 and np.isfinite(value) and value > 0.0):
        raise ValueError(f"{name}: expected a positive frequency in rad/s, got {value!r}")
    return float(value)


def _frequencies(values: ArrayLike) -> FloatArray:
    frequencies = np.atleast_1d(_signals.real("zeros_at", values))
    if frequencies.ndim != 1 or not np.all(np.isfinite(frequencies) & (frequencies > 0.0)):
        raise ValueError(f"zeros_at: expected positive frequencies in rad/s, got {frequencies.tolist()}")
    if len(np.unique(frequencies)) < len(frequencies):
        raise ValueError(f"zeros_at: expected distinct frequencies, got {frequencies.tolist()}")
    return frequencies
