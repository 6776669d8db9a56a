"""Loops whose inertia moves: proofs that they stay stable, or a motion under which they do not."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import cast

import control as ct
import numpy as np
from numpy.typing import ArrayLike

from ... import _signals
from ..._sections import FloatArray
from ...filter import FilterBank, PhyFilter, SampledPhyFilter
from ...results import Result, Status, in_lines
from ...values import Loop
from ..channels import Filter, channels_of
from . import _inequalities, _inertia, switching
from ._continuous import ContinuousLoop
from .filter_margins import FilterMargins, build_loop
from .openings import Opening, open_at_inertia, side_by_side
from .switching import InertiaMotion

__all__ = ["FORCES", "InertiaCertificate", "Question", "answered", "question_of"]

# Pieces of P over the range of the ratio that are tried one after another.
_PIECES = (1, 4, 12)
# Products of states beyond which a Lyapunov function of higher degree is refused.
_MOST_PRODUCTS = 3000
_ONE_AXIS = "one axis, or principal axes of M_hat^-1/2 M M_hat^-1/2 that do not turn"
FORCES = (
    "forces with M' in them (Coriolis, a load that comes) are part of f: they shift f_hat, not its stability"
)


@dataclass(frozen=True, eq=False, repr=False)
class InertiaCertificate(Result):
    """Whether a loop stays stable for every inertia of a set; made by :func:`inertia_tolerance`.

    Parameters
    ----------
    status : Status
        PROVEN: for every member, and every motion of them. REFUTED: ``motion``, or a constant member, diverges. OPEN:
        neither; a sufficient test that fails says no more.
    method : str
        What decided.
    ratios : (2,) array
        Least and largest eigenvalue of M_hat M^-1 over the set (real part of the eigenvalues of one pair).
    rate : float or None
        Largest |d ln M/dt| in 1/s; None for M of any speed, jumps included.
    lyapunov : tuple of (N, N) arrays
        P of V = x' P x, in the states of ``opening``; one, or one at each of ``knots``, or for each vertex. Of a higher
        degree: of the products of states. One filter for several axes: kron(P, I).
    knots : (K,) array
        Values of M_hat/M between which P is linear; empty where there is one P.
    motion : InertiaMotion or None
        What refutes it.
    opening : control.StateSpace or None
        The loop opened at the inertia, s to p, closed by s = M_hat M^-1 p: state matrix A + B M_hat M^-1 C.
    assumptions : tuple of str
        What the proof is for.
    message : str
    """

    _figures = (
        "status",
        "method",
        "ratios",
        "rate",
        "lyapunov",
        "knots",
        "motion",
        "assumptions",
        "message",
    )
    _units = MappingProxyType({"rate": "1/s"})

    status: Status
    method: str
    ratios: FloatArray
    rate: float | None
    lyapunov: tuple[FloatArray, ...]
    knots: FloatArray
    motion: InertiaMotion | None
    opening: ct.StateSpace | None = field(repr=False)
    assumptions: tuple[str, ...]
    message: str

    def describe(self) -> str:
        """What is decided, as text, one line each.

        Returns
        -------
        str

        Examples
        --------
        >>> from phyfilter_ctl import inertia_tolerance
        >>> found = inertia_tolerance(PhyFilter([5.0]).sampled(0.01), ratios=(0.5, 1.5))
        >>> found.describe().splitlines()[1:3]
        ['M_hat/M             0.5 to 1.5, at any speed', 'by                  common quadratic']
        """
        low, high = self.ratios
        speed = "at any speed" if self.rate is None else f"|d ln M/dt| up to {self.rate:g} 1/s"
        return in_lines(
            {
                "status": f"{self.status}: {self.status.meaning}",
                "M_hat/M": f"{low:.4g} to {high:.4g}, {'constant' if self.rate == 0.0 else speed}",
                "by": self.method,
                "as": self.message,
                "holds for": "; ".join(self.assumptions),
            }
        )


@dataclass(frozen=True, eq=False)
class Question:
    """What is asked, checked."""

    margins: tuple[FilterMargins, ...]
    opening: Opening | None
    low: float
    high: float
    M_hat: FloatArray
    vertices: FloatArray
    rate: float | None
    degree: int

    @property
    def shared(self) -> bool:
        """Whether all axes have one filter."""
        return len(self.margins) == 1

    @property
    def any_speed(self) -> bool:
        """Whether M may move as fast as it likes."""
        return self.rate is None

    def answer(
        self,
        status: Status,
        method: str,
        message: str,
        *,
        P: tuple[FloatArray, ...] = (),
        knots: FloatArray | None = None,
        motion: InertiaMotion | None = None,
        only: tuple[str, ...] = (),
    ) -> InertiaCertificate:
        """A certificate of what one method found, with what it rests on."""
        known = [FORCES, *only, *self.margins[0].assumptions]
        if self.M_hat.size > 1:
            known.append("M symmetric, M_hat constant")
        opening = None
        if self.opening is not None:
            o = self.opening
            opening = ct.StateSpace(o.A, o.B, o.C, np.zeros((o.axes, o.axes)), o.dt or 0)
        ends = np.array([self.low, self.high])
        knots = np.zeros(0) if knots is None else knots
        return InertiaCertificate(
            status, method, ends, self.rate, P, knots, motion, opening, tuple(known), message
        )


def question_of(
    filter: PhyFilter | SampledPhyFilter | FilterBank,
    loop: Loop,
    dt: float | None,
    *,
    ratios: ArrayLike | None,
    vertices: ArrayLike | None,
    M_hat: ArrayLike | None,
    rate: float | None,
    degree: int,
) -> Question:
    """The question of ratios or vertices, checked."""
    several = channels_of(filter)
    single = [cast(Filter, filter)] if several is None else [entry for _, entry in several]
    margins = tuple(
        FilterMargins(1.0, found, system, loop) for system, found in (build_loop(e, loop, dt) for e in single)
    )
    first = margins[0].loop
    if loop.has_gains and (rate != 0.0 or len(margins) > 1):
        raise ValueError(
            "loop: with kp or kd only a constant M (rate=0) and one filter for all axes can be answered; a moving M, "
            "and axes with filters of their own, for the inner loop alone: take loop.inner"
        )
    if loop.g != "commanded" and (rate != 0.0 or len(margins) > 1):
        raise ValueError(
            f"loop: a moving M, and axes with filters of their own, are known for the command as g, got g={loop.g!r}"
        )
    if rate and (vertices is not None or len(margins) > 1):
        raise ValueError("rate: a rate other than 0 goes with ratios of one axis; leave it out: any speed")
    if degree not in (2, 4, 6, 8):
        raise ValueError(f"degree: expected 2, 4, 6 or 8, got {degree!r}")
    if vertices is not None and M_hat is not None:
        model = _inertia.definite("M_hat", _inertia.checked_inertia("M_hat", M_hat))
        corners = _inertia.checked_vertices(model, vertices)
        low, high, _ = _inertia.hull_range(model, corners)
    else:
        low, high = map(float, _signals.array("ratios", [] if ratios is None else ratios, (2,)))
        if not 0.0 < low <= high:
            raise ValueError(f"ratios: expected 0 < low <= high, got {low:g} and {high:g}")
        model, corners = np.eye(len(margins)), np.zeros((0, 0, 0))
    if len(margins) > 1 and len(model) != len(margins):
        raise ValueError(f"M_hat: expected {len(margins)} axes, one for each filter, got {len(model)}")
    late = loop.delay > 0.0 and isinstance(first, ContinuousLoop)
    if late and (len(margins) > 1 or degree > 2 or rate):
        raise ValueError(
            f"delay: with {loop.delay:g} s in continuous time only one filter, at any speed or for a constant M, by "
            "degree 2 can be answered; give dt, the step at which the filter runs"
        )
    alone = late or loop.has_gains or loop.g != "commanded"
    return Question(margins, None if alone else _opening(margins), low, high, model, corners, rate, degree)


def answered(question: Question) -> InertiaCertificate:
    """The first of all methods that can tell."""
    for attempt in (_constant, _small_gain, _rate_bounded, _higher_degree, _coupled, _diverging):
        found = attempt(question)
        if found is not None:
            return found
    message = "no proof, and no motion back and forth between two values that diverges"
    return question.answer(Status.OPEN, "none", message)


def _opening(margins: tuple[FilterMargins, ...]) -> Opening:
    found = [open_at_inertia(margin.loop) for margin in margins]
    return found[0] if len(found) == 1 else side_by_side(found)


def _constant(q: Question) -> InertiaCertificate | None:
    """Members that do not move: what is unstable there is refuted; with rate 0 what is stable is proven."""
    if q.shared:
        return _constant_of_one(q.margins[0], q)
    assert q.opening is not None
    opening = q.opening
    inverse = _ratios(q)
    ends = [np.diag(np.full(opening.axes, end)) for end in (q.low, q.high)]
    names = [f"vertex {j}" for j in range(len(inverse))] or [f"M_hat/M = {mu:.6g}" for mu in (q.low, q.high)]
    for where, mu in zip(names, inverse or ends, strict=True):
        if not opening.growth(opening.closed(mu)) < 0.0:
            return q.answer(Status.REFUTED, "eigenvalues", f"unstable for a constant M: {where}")
    if len(inverse) == 1:
        return q.answer(Status.PROVEN, "eigenvalues", "stable for the one M of the set")
    if len(inverse):

        def stable(M: FloatArray) -> bool:
            return opening.growth(opening.closed(_ratio(q.M_hat, M))) < 0.0

        M = switching.worst_mixture(stable, q.vertices)
        if M is not None:
            return q.answer(Status.REFUTED, "eigenvalues", f"unstable for the constant M = {M.tolist()}")
    return None


def _ratios(q: Question) -> list[FloatArray]:
    """mu = M_hat M^-1 at the vertices."""
    return [_ratio(q.M_hat, M) for M in q.vertices]


def _ratio(M_hat: FloatArray, M: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.solve(M.T, M_hat.T).T, dtype=float)


def _constant_of_one(margin: FilterMargins, q: Question) -> InertiaCertificate | None:
    lost = next((value for value in (q.low, q.high) if not margin.stable(value)), None)
    whole = any(a < q.low and q.high < b for a, b in margin.stable_ratios)
    if lost is None and not whole and not len(q.vertices):
        edges = [edge for pair in margin.stable_ratios for edge in pair if q.low <= edge <= q.high]
        lost = edges[0] if edges else None
    if lost is not None:
        return q.answer(Status.REFUTED, "eigenvalues", f"unstable for a constant M: M_hat/M = {lost:.6g}")
    if q.rate == 0.0:
        if whole:
            return q.answer(Status.PROVEN, "stable ratios", "stable for every constant M of the set")
        return q.answer(Status.OPEN, "none", "the ratios lie in different stable intervals")
    return None


def _small_gain(q: Question) -> InertiaCertificate | None:
    """A common quadratic Lyapunov function over the whole range of the ratio."""
    diagonal = not np.any(q.M_hat - np.diag(np.diag(q.M_hat)))
    if q.rate == 0.0 or (not q.shared and not diagonal):
        return None
    message = "V = x' P x falls for every motion within the ratios, at any speed"
    if q.opening is None:
        middle, radius = 0.5 * (q.low + q.high), 0.5 * (q.high - q.low)
        margin = FilterMargins(middle, q.margins[0].loop, q.margins[0].filter)
        if margin.ratio_radius > radius:
            text = f"circle criterion over frequency: radius {margin.ratio_radius:.4g} about {middle:.4g}"
            return q.answer(Status.PROVEN, "circle criterion", text)
        return None
    P = _inequalities.solved_by_riccati(q.opening.by_clock(), q.low, q.high)
    return None if P is None else q.answer(Status.PROVEN, "common quadratic", message, P=(P,))


def _rate_bounded(q: Question) -> InertiaCertificate | None:
    if not q.rate or q.opening is None:
        return None
    opening, rate = q.opening.by_clock(), q.rate / q.opening.clock
    for pieces in _PIECES:
        knots = np.geomspace(q.low, q.high, pieces + 1)
        if (
            q.opening.dt is not None
            and pieces > 1
            and np.log(q.high / q.low) / pieces < q.rate * q.opening.dt
        ):
            break  # a step would go over several knots
        values = _inequalities.rate_bounded(opening, knots, rate).solve("inertia_tolerance(rate=...)")
        if values is not None:
            message = f"V = x' P(M_hat/M) x, linear between {pieces + 1} knots, falls at this rate"
            P = tuple(values[: pieces + 1])
            return q.answer(
                Status.PROVEN, "parameter-dependent", message, P=P, knots=knots, only=(_ONE_AXIS,)
            )
    return None


def _higher_degree(q: Question) -> InertiaCertificate | None:
    if q.rate is not None or not q.shared or len(q.M_hat) > 1 or q.opening is None:
        return None
    opening, sampled = q.opening.by_clock(), q.opening.dt is not None
    for half in range(2, q.degree // 2 + 1):
        if not opening.is_even or len(opening.A) ** half > _MOST_PRODUCTS:
            return None
        matrices = [_inequalities.power(opening.closed(mu), half, sampled) for mu in (q.low, q.high)]
        values = _inequalities.common(matrices, sampled).solve("inertia_tolerance(degree=...)")
        if values is not None:
            message = f"V of degree {2 * half} falls for every motion within the ratios, at any speed"
            only = (_ONE_AXIS,)
            return q.answer(Status.PROVEN, f"common of degree {2 * half}", message, P=(values[0],), only=only)
    return None


def _coupled(q: Question) -> InertiaCertificate | None:
    """Vertices of matrices where the range of the ratio does not tell."""
    if not len(q.vertices) or q.M_hat.size == 1 or q.opening is None:
        return None
    opening, n = q.opening.by_clock(), len(q.M_hat)
    if q.shared:
        opening = side_by_side([opening] * n)
    # A congruence by powers of two: no axis is lost beside others, and nothing is rounded.
    units = np.exp2(-np.round(0.5 * np.log2(np.diag(q.M_hat))))
    units = np.outer(units, units)
    constant = q.rate == 0.0
    wanted = _inequalities.polytope(opening, q.M_hat * units, q.vertices * units, constant=constant)
    values = wanted.solve("inertia_tolerance(vertices=...)")
    if values is None:
        return None
    message = (
        "V = x' P x falls at every vertex" if not constant else "V = x' P(M) x falls for every constant M"
    )
    only = () if opening.dt is None or constant else ("M changes at the samples only",)
    return q.answer(Status.PROVEN, "vertices", message, P=tuple(values[:-1]), only=only)


def _diverging(q: Question) -> InertiaCertificate | None:
    if q.rate == 0.0 or q.opening is None:
        return None
    if len(q.vertices) and q.M_hat.size > 1:
        opening = side_by_side([q.opening] * len(q.M_hat)) if q.shared else q.opening
        motion = switching.worst_switching(opening, _ratios(q))
    elif q.shared:
        motion = switching.worst_motion(q.opening, q.low, q.high, q.rate)
    else:
        unit = np.eye(q.opening.axes)
        motion = switching.worst_switching(q.opening, [q.low * unit, q.high * unit])
    if motion is None:
        return None
    times = np.diff(motion.times)
    names = [f"{a:.4g}" if a == b else f"{a:.4g} to {b:.4g}" for a, b in motion.ratios] or [
        f"vertex {j}" for j in motion.vertices
    ]
    held = ", ".join(f"{1e3 * time:.3g} ms at {name}" for time, name in zip(times, names, strict=True))
    message = f"diverges: {held}, and so on; {motion.growth:.3g} times as large after each period"
    return q.answer(Status.REFUTED, "periodic motion", message, motion=motion)
