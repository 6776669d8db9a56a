"""A sampled filter in 32-bit integers with 64-bit sums: scalings without overflow, and a proven bound of the error.

With v = dx - h (g + f_theta) and b = dA equilibrium / h the recursion (``filter/recursion.py``) is

    w <- w + dA w - b v,        f_hat = f_theta + C w.

Every signal is an integer times a power of two. A state has 30 bits below its least significant one, v keeps what its
rounding leaves for the next step; so neither lets small residuals stall. What is rounded:

* w, to nearest, where it is multiplied: half a bit, through dA and through C;
* v: what is carried over makes of half a bit of v as much noise of x;
* coefficients: known differences, times the largest states and signals;
* products shifted to the scale of the state, below: 2^-30 bits; f_hat, to nearest: half a bit.

Each goes on through the l1 norms of the impulse responses from where it comes in (``SampledKernels``). The states stay
within their integers by the l1 norms from x, g and f_theta to them, errors included.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import floor, log2

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._sections import FloatArray
from ..._signals import number
from ...filter import SampledPhyFilter
from .sampled_kernels import SampledKernels, StateGains

__all__ = ["FixedPoint", "fixed_point"]

Integers = NDArray[np.int64]

GUARD = 30  # bits of a state, and of v, below its least significant one
_WORD = 2**31 - 1
# Signals fill 29 to 30 of 31 bits: their differences and sums of two fit.
_SIGNAL = 29
# f_theta needs no finer steps than so many bits below those of f_hat.
_BELOW = 16
# Bits by which f_theta may be shifted up: it fills 30, the sum with C w 63.
_UP = 32
# Sums and logarithms are in double precision, certificates are closed to 1e-8.
_COMPUTED = 1.0 + 1e-6
# Room for the errors of the states themselves, checked afterwards.
_ROOM = (2.0**-16, 2.0**-10, 2.0**-4)
_SIGNALS = ("x", "g", "f_theta")


@dataclass(frozen=True, eq=False)
class FixedPoint:
    """A sampled filter in fixed point: what ``export_c(real="q31")`` writes, and a twin of it, equal to the bit.

    Parameters
    ----------
    sampled : SampledPhyFilter
    ranges : dict of str to float
        Largest |x|, |g|, |f_theta|, and |f_hat| that follows from them. Beyond the first three inputs saturate.
    fraction : dict of str to int
        Fractional bits of x, g, f_theta, f_hat and v: an integer k stands for k 2^-fraction.
    states : tuple of int
        Fractional bits of the states.
    dA, b, C : int64 arrays (n, n), (n,), (n,)
        Mantissas of the coefficients, in 32 bits.
    of_g, of_f_theta : int
        Mantissas of the step: v = dx - of_g g - of_f_theta f_theta.
    shifts : dict of str to int
        Bits by which x and f_theta are shifted up, and products with dA, b and C down.
    error_bound : float
        Bound of |f_hat - f_hat of exact arithmetic| for inputs on the grid and within their ranges, in the unit of f.

    Examples
    --------
    >>> from phyfilter_ctl import PhyFilter
    >>> fixed = fixed_point(PhyFilter([400.0, 40.0]).sampled(0.002), x=10.0, g=20.0, f_theta=20.0)
    >>> fixed.error_bound < 1e-5
    True
    >>> x = fixed.integers("x", 0.004 * np.arange(400.0)[:, None])    # x' = 2
    >>> f_hat, flags = fixed.run(x)
    >>> fixed.reals("f_hat", f_hat[-1]).round(4).tolist(), bool(flags.any())
    ([2.0], False)
    """

    sampled: SampledPhyFilter
    ranges: Mapping[str, float]
    fraction: Mapping[str, int]
    states: tuple[int, ...]
    dA: Integers
    b: Integers
    C: Integers
    of_g: int
    of_f_theta: int
    shifts: Mapping[str, int]
    error_bound: float

    def most(self, name: str) -> int:
        """Largest integer that an input may be; beyond it saturates.

        Parameters
        ----------
        name : {"x", "g", "f_theta"}
        """
        return floor(self.ranges[name] * 2.0 ** self.fraction[name])

    def limit(self, channels: int) -> Integers:
        """Largest |f_hat| of each channel as an integer, (channels,).

        Parameters
        ----------
        channels : int
        """
        limit = self.sampled.sampling.limit
        if limit is None:
            return np.full(channels, _WORD, dtype=np.int64)
        scaled = np.broadcast_to(limit, (channels,)) * 2.0 ** self.fraction["f_hat"]
        return np.floor(np.minimum(scaled, float(_WORD))).astype(np.int64)

    def integers(self, name: str, values: ArrayLike) -> Integers:
        """Values of a signal on its grid, to nearest; beyond 32 bits they saturate.

        Parameters
        ----------
        name : {"x", "g", "f_theta", "f_hat"}
        values : array_like
            In the unit of the signal.

        Raises
        ------
        ValueError
            For not-a-number, for which there is no integer.
        """
        scaled = np.rint(np.asarray(values, dtype=float) * 2.0 ** self.fraction[name])
        if np.isnan(scaled).any():
            raise ValueError(f"{name}: expected numbers, got nan; leave such samples out, integers have none")
        return np.clip(scaled, -float(_WORD), float(_WORD)).astype(np.int64)

    def reals(self, name: str, values: ArrayLike) -> FloatArray:
        """What integers of a signal stand for.

        Parameters
        ----------
        name : {"x", "g", "f_theta", "f_hat"}
        values : array_like of int
        """
        return np.asarray(values) * 2.0 ** -self.fraction[name]

    def run(
        self, x: ArrayLike, g: ArrayLike | None = None, f_theta: ArrayLike | None = None
    ) -> tuple[Integers, Integers]:
        """f_hat over a record, in the integer arithmetic of the C code.

        Parameters
        ----------
        x, g, f_theta : (N, n_x) arrays of int
            In the steps of ``fraction``, rows as for ``SampledPhyFilter.run``; None means 0.

        Returns
        -------
        f_hat : (N, n_x) int64 array
        flags : (N,) int64 array
            What saturated: 1 x, 2 g, 4 f_theta, 8 a state, 16 f_hat at its limit.

        Raises
        ------
        TypeError, ValueError
            For signals that are not of integers in 32 bits, or not of one shape (N, n_x) with at least one row.
        """
        record = {
            name: _integral(name, np.zeros_like(x) if given is None else given)
            for name, given in zip(_SIGNALS, (x, g, f_theta), strict=True)
        }
        if len({values.shape for values in record.values()}) > 1:
            shapes = ", ".join(f"{name} {values.shape}" for name, values in record.items())
            raise ValueError(f"expected signals of one shape (N, n_x), got {shapes}")
        inside = {name: np.clip(values, -self.most(name), self.most(name)) for name, values in record.items()}
        flags = np.zeros(len(inside["x"]), dtype=np.int64)
        for bit, name in enumerate(_SIGNALS):
            beyond = np.any(inside[name] != record[name], axis=1)
            if name == "g" and self.sampled.sampling.g == "hold":
                beyond = np.append(False, beyond[:-1])  # it acts until the next sample
            flags |= beyond.astype(np.int64) << bit
        v = self._changes(**inside)
        f_theta_up, limit = inside["f_theta"] << self.shifts["f_theta"], self.limit(v.shape[1])
        f_hat = np.empty_like(v)
        s, largest = np.zeros((v.shape[1], len(self.C)), dtype=np.int64), (_WORD << GUARD) - (1 << GUARD)
        for k in range(len(v)):
            s += ((_nearest(s, GUARD) @ self.dA.T) >> self.shifts["dA"]) - (
                np.multiply.outer(v[k], self.b) >> self.shifts["b"]
            )
            flags[k] |= 8 * int(np.any(np.abs(s) > largest))
            np.clip(s, -largest, largest, out=s)
            y = f_theta_up[k] + _nearest(s, GUARD) @ self.C
            y = _nearest(y, self.shifts["C"])
            f_hat[k] = np.clip(y, -limit, limit)
            flags[k] |= 16 * int(np.any(f_hat[k] != y))
        return f_hat, flags

    def _changes(self, x: Integers, g: Integers, f_theta: Integers) -> Integers:
        """v of each step; what rounding leaves is carried over."""
        sampling = self.sampled.sampling
        total = np.diff(x, axis=0, prepend=x[:1]) << self.shifts["x"]
        for values, factor, rule in (
            (g, self.of_g, sampling.g),
            (f_theta, self.of_f_theta, sampling.f_theta),
        ):
            over = values[:-1] if rule == "hold" else values[1:] + values[:-1]
            total[1:] -= factor * over
        v, carry = np.empty_like(total), np.zeros_like(total[0])
        for k, row in enumerate(total):
            carry += row
            v[k] = carry >> GUARD
            carry &= (1 << GUARD) - 1
        return v


def fixed_point(sampled: SampledPhyFilter, *, x: float, g: float = 0.0, f_theta: float = 0.0) -> FixedPoint:
    """Scale a sampled filter for 32-bit integers, so that nothing overflows, and bound what rounding does.

    Parameters
    ----------
    sampled : SampledPhyFilter
        One filter for all channels, without delay, E, g_limit and nonfinite="hold".
    x, g, f_theta : float
        Largest |x|, |g| and |f_theta| of any channel, in their units. Tight ones make f_hat finer.

    Returns
    -------
    FixedPoint

    Raises
    ------
    TypeError
        For a filter that is not sampled.
    ValueError
        For an option that integers do not have, ranges that are not positive (x) or negative, and where 32 bits do
        not hold the signals: a step so long that a pole's factor is beyond 2, or h (g + f_theta) beyond 2^30 times x.

    Examples
    --------
    >>> from phyfilter_ctl import PhyFilter
    >>> fixed = fixed_point(PhyFilter([20.0]).sampled(0.01), x=8.0, g=10.0)
    >>> fixed.fraction["x"], fixed.most("x") == 2**29
    (26, True)
    """
    _check(sampled)
    ranges = {
        "x": number("x", x, above=0.0),
        "g": number("g", g, least=0.0),
        "f_theta": number("f_theta", f_theta, least=0.0),
    }
    for room in _ROOM:
        fixed = _scaled(sampled, ranges, room)
        if fixed is not None:
            return fixed
    raise ValueError(
        "fixed point: rounding could fill the states of this filter; it is too slow for its step, or its poles too far "
        "apart: take a longer step or a lower order"
    )


def _check(sampled: SampledPhyFilter) -> None:
    if not isinstance(sampled, SampledPhyFilter):
        raise TypeError(
            f"sampled: expected a SampledPhyFilter, got {type(sampled).__name__}; take filter.sampled(dt)"
        )
    sampling = sampled.sampling
    refused = {
        "several filters": len(sampled.filters) > 1,
        "E": sampled.E is not None,
        "delay": sampling.delay > 0.0,
        "g_limit": sampling.g_limit is not None,
        "nonfinite='hold'": sampling.nonfinite == "hold",
    }
    for name, there in refused.items():
        if there:
            raise ValueError(f"fixed point has no {name}: expected one plain filter; export float or double")


def _scaled(sampled: SampledPhyFilter, ranges: Mapping[str, float], room: float) -> FixedPoint | None:
    """Scaled with so much room in the states; None where rounding errors might not fit in."""
    kernels, h = SampledKernels(sampled), sampled.dt
    gains, sampling = kernels.state_gains(), sampled.sampling
    (dA, equilibrium, C), X, G = sampled.transition, ranges["x"], ranges["g"] + ranges["f_theta"]
    b = dA @ equilibrium / h
    fraction = {name: _SIGNAL - floor(log2(value)) if value else 0 for name, value in ranges.items()}
    f_hat = ranges["f_theta"] + kernels.noise().upper * X + kernels.estimate().upper * G
    if sampling.limit is not None:
        f_hat = min(f_hat, float(np.max(sampling.limit)))
    fraction["f_hat"] = _room_for(f_hat * (1.0 + 2.0**-16))
    finest = fraction["f_hat"] + _BELOW
    fraction["f_theta"] = min(fraction["f_theta"], finest) if ranges["f_theta"] else fraction["f_hat"]

    largest = (X * gains.of_x + G * gains.of_u) * (1.0 + room)
    states = np.array([_room_for(size) for size in largest])
    v = 2.0 * X + h * G
    fraction["v"] = min(fraction["x"], _room_for(v * (1.0 + 2.0**-16)))
    steps = {name: h * (0.5 if getattr(sampling, name) == "average" else 1.0) for name in ("g", "f_theta")}

    def of_signal(name: str) -> float:
        return steps[name] * 2.0 ** (fraction["v"] - fraction[name] + GUARD) if ranges[name] else 0.0

    while max(of_signal("g"), of_signal("f_theta")) > _WORD - 1:
        fraction["v"] -= 1
    up = GUARD + fraction["v"] - fraction["x"]
    mantissas = {
        "dA": dA * 2.0 ** (states[:, None] - states + GUARD),
        "b": b * 2.0 ** (states - fraction["v"] + GUARD),
        "C": C * 2.0 ** (fraction["f_hat"] - states),
    }
    coarser = fraction["f_hat"] - fraction["f_theta"]  # f_theta, where a limit makes f_hat so much smaller
    lowest = max(1, -coarser)
    shifts = {
        "x": up,
        "dA": _shift(mantissas["dA"], 2.0**31),
        "b": _shift(mantissas["b"][:, None], 2.0**61 / (v * 2.0 ** fraction["v"] + 2.0)),
        "C": min(_shift(mantissas["C"][None], 2.0**31), _UP - coarser),
    }
    if min(up, shifts["dA"], shifts["b"], shifts["C"] - lowest) < 0:
        raise ValueError(
            f"fixed point: 32 bits do not hold this filter at h = {h:g} s with these ranges; take a shorter step, "
            "ranges nearer to what the signals do, a limit nearer to f_theta, or a numerator of less gain"
        )
    shifts["f_theta"] = shifts["C"] + coarser
    rounded = {
        name: np.rint(values * 2.0 ** shifts[name]).astype(np.int64) for name, values in mantissas.items()
    }
    fixed = FixedPoint(
        sampled=sampled,
        ranges={**ranges, "f_hat": f_hat},
        fraction=fraction,
        states=tuple(int(bits) for bits in states),
        of_g=round(of_signal("g")),
        of_f_theta=round(of_signal("f_theta")),
        shifts=shifts,
        error_bound=0.0,
        **rounded,
    )
    error, of_states = _errors(fixed, kernels, gains, largest)
    if np.any(largest / (1.0 + room) + of_states > largest):
        return None
    return replace(fixed, error_bound=error)


def _room_for(size: float) -> int:
    """Most fractional bits with which sizes up to this fit into a word, a few steps to spare."""
    return floor(log2((_WORD - 8) / size))


def _shift(mantissas: FloatArray, most: float) -> int:
    """Most bits by which rows may be scaled up: each fits a word, sums of magnitudes stay below ``most``; up to 30."""
    size, total = float(np.abs(mantissas).max()), float(np.abs(mantissas).sum(axis=1).max())
    return min(GUARD, floor(log2((_WORD - 1) / size)), floor(log2((most - mantissas.size) / total)))


def _errors(
    fixed: FixedPoint, kernels: SampledKernels, gains: StateGains, largest: FloatArray
) -> tuple[float, FloatArray]:
    """Bounds of the errors of f_hat and of the states (n,), from states up to ``largest``."""
    sampled, fraction, shifts, ranges = fixed.sampled, fixed.fraction, fixed.shifts, fixed.ranges
    (dA, equilibrium, C), h = sampled.transition, sampled.dt
    states = np.array(fixed.states)
    bit, bit_v, X = 2.0**-states, 2.0 ** -fraction["v"], ranges["x"]
    # Coefficients as they are: what the mantissas stand for.
    dA_is = fixed.dA * 2.0 ** (states - states[:, None] - GUARD - shifts["dA"])
    b_is = fixed.b * 2.0 ** (fraction["v"] - states - GUARD - shifts["b"])
    C_is = fixed.C * 2.0 ** (states - fraction["f_hat"] - shifts["C"])
    b_off = np.abs(b_is - dA @ equilibrium / h)
    held = 0.0  # h (g + f_theta) as it is, and what it is off
    v_off = 0.0
    for name, factor in (("g", fixed.of_g), ("f_theta", fixed.of_f_theta)):
        twice = 2.0 if getattr(sampled.sampling, name) == "average" else 1.0
        step = twice * factor * 2.0 ** (fraction[name] - fraction["v"] - GUARD)
        held += step * ranges[name]
        v_off += abs(step - h) * ranges[name] if ranges[name] else 0.0
    shifted = sum(2.0**-GUARD for name in ("dA", "b") if shifts[name]) * bit
    local = 0.5 * np.abs(dA_is) @ bit + np.abs(dA_is - dA) @ largest + shifted
    from_b = gains.changes * (X + bit_v) + gains.to_output * held
    output = 0.5 * np.abs(C_is) @ bit + np.abs(C_is - C) @ largest + 0.5 * 2.0 ** -fraction["f_hat"]
    if sampled.sampling.limit is not None:
        output += 2.0 ** -fraction["f_hat"]
    error = (
        gains.to_output @ local
        + b_off @ from_b
        + kernels.estimate().upper / h * v_off
        + kernels.noise().upper * 0.5 * bit_v
        + output
    )
    everything = local + b_off * (2.0 * X + bit_v + held)
    of_states = kernels.between_states() @ everything + gains.of_u / h * v_off + gains.of_x * 0.5 * bit_v
    return float(error) * _COMPUTED, of_states * _COMPUTED


def _integral(name: str, values: ArrayLike) -> Integers:
    array = np.asarray(values)
    if array.ndim != 2 or array.dtype.kind not in "iu":
        raise TypeError(
            f"{name}: expected integers (N, n_x), got {array.dtype} {array.shape}; integers({name!r}, ...) makes them"
        )
    if not array.size or array.min() < -_WORD - 1 or array.max() > _WORD:
        raise ValueError(
            f"{name}: expected one sample of 32 bits or more, got {array.dtype} {array.shape}; integers({name!r}, ...) "
            "saturates"
        )
    return array.astype(np.int64)


def _nearest(values: Integers, bits: int) -> Integers:
    """Shifted down, to nearest."""
    return (values + (1 << (bits - 1))) >> bits
