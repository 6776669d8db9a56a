"""Searches along the frequency axis: crossings, intervals of stable ratios, peaks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from scipy.optimize import fminbound

from ..._sections import ComplexArray, FloatArray

__all__ = [
    "SAME",
    "Characteristic",
    "Crossing",
    "Remembered",
    "count_unstable",
    "gain_crossings",
    "grid",
    "intervals",
    "lag_to_instability",
    "least",
    "ratio_crossings",
    "sign_changes",
]

_POINTS_PER_DECADE = 150
# Corners slower than this share of the fastest are left to rounding.
_SLOWEST = 1e-14
# Change of the delay's phase from one point to the next in rad.
_TURN_PER_POINT = 0.1
_MOST_POINTS = 500_000
# Roots are refined to this, relative; at most as many steps as halvings would take.
_ROOT = 1e-15
_MOST_STEPS = 60
# Ratios that agree to this are one crossing (found from two sides); ratios below it are 0, above the other one inf.
SAME = 1e-10
# A pole with less damping than this is on the boundary of stability: rounding moves it by some 1e-14 of its size, and
# no plant is known to 1e-9. Relative to the pole, so that a slow one in a fast loop is stable.
_UNDAMPED = 1e-9
_ENDLESS = 1e12


class Swept(Protocol):
    """Q + mu P on the boundary of stability: j omega, or the unit circle."""

    @property
    def nyquist(self) -> float:
        """Highest frequency in rad/s; inf where the loop is not sampled."""
        ...

    @cached_property
    def grid(self) -> FloatArray:
        """Frequencies in rad/s, dense enough that every crossing has its own interval."""
        ...

    @cached_property
    def at_zero(self) -> tuple[float, float]:
        """Q and P at omega = 0, real, but for a common factor."""
        ...

    @cached_property
    def at_nyquist(self) -> tuple[float, float] | None:
        """The same at :attr:`nyquist`; None where nothing crosses there."""
        ...

    def __call__(self, omega: FloatArray, /) -> tuple[ComplexArray, ComplexArray]:
        """Q and P at frequencies in rad/s."""
        ...


class Characteristic(Swept, Protocol):
    """Q + mu P = 0, and where its poles are."""

    @cached_property
    def tail(self) -> tuple[float, float]:
        """Frequency beyond which poles only leave the stable region, and the ratio up to which every crossing is on the
        grid; inf where the grid has all."""
        ...

    @property
    def delay(self) -> float:
        """Seconds of delay."""
        ...

    def roots(self, ratio: complex) -> ComplexArray | None:
        """Closed-loop poles at a ratio mu, in rad/s or as z; None where there are infinitely many."""
        ...

    def unstable(self, ratio: complex) -> int | None:
        """How many poles are not stable at a ratio mu; None where one is on the boundary as far as rounding tells."""
        ...


class Remembered(ABC):
    """A loop that is evaluated on its own grid once, however many searches start there."""

    @abstractmethod
    def _evaluate(self, omega: FloatArray) -> tuple[ComplexArray, ComplexArray]: ...

    @cached_property
    def _on_grid(self) -> tuple[ComplexArray, ComplexArray]:
        return self._evaluate(vars(self)["grid"])

    def __call__(self, omega: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Q and P at frequencies in rad/s, each (K,)."""
        return self._on_grid if omega is vars(self).get("grid") else self._evaluate(omega)


def count_unstable(poles: ComplexArray, *, sampled: bool) -> int:
    """Number of poles that are not stable, those on the boundary among them; sampled, the poles are z - 1."""
    size = np.abs(poles)
    # |1 + d|^2 - 1 without the subtraction.
    beyond = poles.real + 0.5 * size**2 if sampled else poles.real
    return int(np.count_nonzero(beyond >= -_UNDAMPED * size))


class Crossing(NamedTuple):
    """A ratio at which a closed-loop pole sits on the boundary of stability.

    Parameters
    ----------
    ratio : float
        M_hat / M.
    omega : float
        Frequency of that pole in rad/s.
    leaving : int
        1 where the pole leaves the stable region as the ratio grows, -1 where it enters, 0 where it is real.
    """

    ratio: float
    omega: float
    leaving: int


def grid(corners: ComplexArray, end: float, *, turn: float = 0.0) -> FloatArray:
    """Logarithmic from three decades below the corners up to ``end`` (or three above), finer at resonances and where a
    delay of ``turn`` seconds turns fast."""
    sizes = np.abs(corners)
    sizes = sizes[sizes > _SLOWEST * sizes.max()]
    low = 1e-3 * min(float(sizes.min()), end)
    high = min(end, 1e3 * float(sizes.max())) if np.isinf(end) else end
    parts = [np.geomspace(low, high, int(_POINTS_PER_DECADE * np.log10(high / low)) + 2)]
    pairs = corners[corners.imag > 0.0]
    parts.append((pairs.imag[:, None] + np.abs(pairs.real)[:, None] * np.linspace(-8.0, 8.0, 65)).ravel())
    if turn > 0.0:
        spacing = _TURN_PER_POINT / turn
        # Below this the logarithmic grid is the finer one.
        first = spacing * _POINTS_PER_DECADE / np.log(10.0)
        count = max(0, int((high - first) / spacing) + 1) if high > first else 0
        if count > _MOST_POINTS:
            raise ValueError(
                f"the delay of {turn:g} s turns the loop {high * turn / (2.0 * np.pi):.3g} times below {high:.4g} "
                "rad/s, where its gain still counts, too often to search; leave out dynamics that are that much faster"
            )
        parts.append(first + spacing * np.arange(count))
    points = np.unique(np.concatenate(parts))
    return points[(points > 0.0) & (points <= high)]


def ratio_crossings(loop: Swept) -> list[Crossing]:
    """Every ratio mu > 0 at which the loop has a pole on the boundary: Q + mu P = 0 at a real frequency."""

    def angle(omega: FloatArray) -> FloatArray:
        Q, P = loop(omega)
        return np.imag(P * np.conj(Q))

    omega, before = sign_changes(angle, loop.grid)
    Q, P = loop(omega)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ratios = -np.real(Q / P)
    # As mu grows the pole moves along -1/(d log(P/Q)/ds): out where the phase falls through pi, its sine rising.
    leaving = -before.astype(int)
    found = [Crossing(float(r), float(w), int(d)) for r, w, d in zip(ratios, omega, leaving, strict=True)]
    ends = [(0.0, loop.at_zero)]
    if loop.at_nyquist is not None:
        ends.append((loop.nyquist, loop.at_nyquist))
    found += [Crossing(-q / p, w, 0) for w, (q, p) in ends if p]
    return sorted(each for each in found if SAME < each.ratio < _ENDLESS)


def intervals(loop: Characteristic, crossings: list[Crossing]) -> list[tuple[float, float]]:
    """Open intervals of ratios in which the loop is stable: between two crossings the verdict cannot change."""
    edges = [0.0]
    edges += [
        c.ratio for i, c in enumerate(crossings) if i == 0 or c.ratio > crossings[i - 1].ratio * (1.0 + SAME)
    ]
    # Poles that leave in the tail stay out once no crossing lets a pole back in.
    tail, known = loop.tail
    first_lost = min((c.ratio for c in crossings if c.omega > tail), default=float("inf"))
    last_back = max((c.ratio for c in crossings if c.leaving != 1), default=0.0)
    lost = min(max(first_lost, last_back), known)
    crossed = np.array([2 * c.leaving for c in crossings])
    ratios = np.array([c.ratio for c in crossings])
    first: int | None = None
    found = []
    for low, high in zip(edges, [*edges[1:], float("inf")], strict=True):
        if low >= lost:
            break
        inside = _inside(low, high)
        # Long delays cross hundreds of times: no need to count again where pairs that left have not come back. The two
        # real crossings, which may bring back one pole each, are not in this sum.
        if first is not None and first + int(np.sum(crossed[ratios < inside])) > 2:
            continue
        count = loop.unstable(inside)
        if low == 0.0:
            first = count
        if count == 0:
            found.append((low, high))
    return found


def _inside(low: float, high: float) -> float:
    if np.isinf(high):
        return 2.0 * low if low else 1.0
    return float(np.sqrt(low * high)) if low else 0.5 * high


def gain_crossings(loop: Swept, ratio: float) -> FloatArray:
    """Frequencies at which |mu P| = |Q|, (K,)."""

    def excess(omega: FloatArray) -> FloatArray:
        Q, P = loop(omega)
        return np.abs(ratio * P) - np.abs(Q)

    return sign_changes(excess, loop.grid)[0]


def lag_to_instability(loop: Swept, ratio: float) -> tuple[FloatArray, FloatArray]:
    """Gain crossings and the phase lag in (0, 2 pi] that would bring each of them to -1."""
    omega = gain_crossings(loop, ratio)
    Q, P = loop(omega)
    lag = np.angle(-ratio * P * np.conj(Q)) % (2.0 * np.pi)
    return omega, np.where(lag == 0.0, 2.0 * np.pi, lag)


def least(function: Callable[[FloatArray], FloatArray], points: FloatArray) -> tuple[float, float]:
    """Least value of a function (K,) -> (K,) over the range of the points, and where: every dip refined."""
    values = function(points)
    left, here, right = values[:-2], values[1:-1], values[2:]
    inner = np.flatnonzero((here <= left) & (here <= right) & (here < np.maximum(left, right))) + 1
    k = int(np.argmin(values))
    best = (float(values[k]), float(points[k]))
    # Only dips that a refinement by a few percent could bring below the best.
    for i in inner[values[inner] <= best[0] + 0.1 * abs(best[0])]:
        found = fminbound(
            lambda w: float(function(np.array([w]))[0]),
            points[i - 1],
            points[i + 1],
            xtol=float(1e-7 * points[i]),
            full_output=True,
        )
        best = min(best, (float(found[1]), float(found[0])))
    return best


def sign_changes(
    function: Callable[[FloatArray], FloatArray], points: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Roots of a function (K,) -> (K,) and its sign before each (0: unknown), all refined together.

    A dip towards 0 between points is looked into.
    """
    values = function(points)
    points, values = _with_dips(function, points, values)
    sign = np.sign(values)
    exact = points[sign == 0.0]
    k = np.flatnonzero(sign[:-1] * sign[1:] < 0.0)
    roots = _refined(function, (points[k], points[k + 1]), (values[k], values[k + 1]))
    found, before = np.concatenate([exact, roots]), np.concatenate([0.0 * exact, sign[k]])
    order = np.argsort(found)
    return found[order], before[order]


def _refined(
    function: Callable[[FloatArray], FloatArray],
    ends: tuple[FloatArray, FloatArray],
    values: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Chandrupatla's method on all brackets at once: inverse quadratic steps where they are safe, else halves.

    T. R. Chandrupatla, "A new hybrid quadratic/bisection algorithm for finding the zero of a nonlinear function without
    using derivatives", Advances in Engineering Software 28 (1997).
    """
    (a, b), (fa, fb) = ends, values
    t = np.full(np.shape(a), 0.5)
    for _ in range(_MOST_STEPS if len(a) else 0):
        x = a + t * (b - a)
        fx = function(x)
        same = np.sign(fx) == np.sign(fa)
        c, fc = np.where(same, a, b), np.where(same, fa, fb)
        b, fb = np.where(same, b, a), np.where(same, fb, fa)
        a, fa = x, fx
        width = np.abs(b - a)
        nearest = _ROOT * np.maximum(np.abs(a), np.abs(b))
        if np.all((width <= 2.0 * nearest) | (fa == 0.0)):
            break
        with np.errstate(divide="ignore", invalid="ignore"):
            xi, phi = (a - b) / (c - b), (fa - fb) / (fc - fb)
            quadratic = fa / (fb - fa) * fc / (fb - fc) + (c - a) / (b - a) * fa / (fc - fa) * fb / (fc - fb)
            safe = (phi**2 < xi) & ((1.0 - phi) ** 2 < 1.0 - xi) & np.isfinite(quadratic)
            least = np.minimum(nearest / width, 0.5)
        t = np.clip(np.where(safe, quadratic, 0.5), least, 1.0 - least)
        # A bracket that is done stays where it is.
        t = np.where((width <= 2.0 * nearest) | (fa == 0.0), 0.0, t)
    return np.where(np.abs(fa) <= np.abs(fb), a, b)


def _with_dips(
    function: Callable[[FloatArray], FloatArray], points: FloatArray, values: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Add the vertex of the parabola through every three points between which |value| dips without changing sign."""
    size, sign = np.abs(values), np.sign(values)
    dip = (
        (size[1:-1] < size[:-2])
        & (size[1:-1] < size[2:])
        & (sign[1:-1] == sign[:-2])
        & (sign[1:-1] == sign[2:])
    )
    i = np.flatnonzero(dip) + 1
    if len(i) == 0:
        return points, values
    left, right = points[i - 1] - points[i], points[i + 1] - points[i]
    rise_left, rise_right = (values[i - 1] - values[i]) / left, (values[i + 1] - values[i]) / right
    bend = (rise_right - rise_left) / (right - left)
    vertex = points[i] - 0.5 * (rise_left - bend * left) / bend
    vertex = vertex[(vertex > points[i - 1]) & (vertex < points[i + 1])]
    merged = np.concatenate([points, vertex])
    order = np.argsort(merged, kind="stable")
    return merged[order], np.concatenate([values, function(vertex)])[order]
