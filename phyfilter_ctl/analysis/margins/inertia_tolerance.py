"""How wrong the modelled inertia may be: constant or moving, one number, matrices, sets of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ... import _signals
from ...filter import FilterBank, PhyFilter, SampledPhyFilter
from ...values import Loop
from ..channels import channels_of
from . import constant
from .filter_margins import FilterMargins, build_loop, checked_loop
from .moving import InertiaCertificate, answered, question_of

__all__ = ["inertia_tolerance"]


def inertia_tolerance(
    filter: PhyFilter | SampledPhyFilter | FilterBank,
    loop: Loop | None = None,
    *,
    ratios: ArrayLike | None = None,
    vertices: ArrayLike | None = None,
    between: tuple[ArrayLike, ArrayLike] | None = None,
    within: ArrayLike | None = None,
    M_hat: ArrayLike | None = None,
    rate: float | None = None,
    degree: int = 2,
    dt: float | None = None,
) -> InertiaCertificate:
    """Whether the loop stays stable for every inertia of a set: a proof, or a member or a motion that diverges.

        M(t) x' = tau + f,    tau = -f_hat,    f_hat = F [M_hat x' - tau]

    Parameters
    ----------
    filter : PhyFilter, SampledPhyFilter, or several
        A sampled one runs at its rate with the command held. Several (:func:`stack`): one for each axis, and M couples
        the axes.
    loop : Loop, optional
        With kp or kd for a constant M (``rate`` 0) and one filter for all axes; as is g="applied".
    ratios : (low, high), optional
        Where M_hat/M is; for matrices the eigenvalues of M_hat M^-1, which a filter shared by all axes makes one
        question. Several filters: with a diagonal M_hat.
    vertices : (J, n, n), (J, n) or (J,) array, optional
        Instead: symmetric positive definite matrices in whose convex hull M is (:func:`configuration_hull`). A single
        one, constant and with one filter for all axes, may be any regular matrix.
    between : (low, high), optional
        Instead: every symmetric M with low <= M <= high, differences positive semidefinite; an empty and a loaded
        robot. With ``rate`` 0.
    within : float or (n, n) array, optional
        Instead: every M with \\|M - M_hat\\| no more than this; a number in the spectral norm, M symmetric or not; a
        matrix entry by entry, M symmetric. With ``vertices``: how far, entry by entry, M may lie off their hull; what
        is between sampled configurations. With ``rate`` 0.
    M_hat : float, (n,) or (n, n) array, optional
        Modelled inertia, constant; not with ``ratios``. None: the filter's own. Symmetric positive definite but for a
        single vertex and a number ``within``.
    rate : float, optional
        Largest |d ln M/dt| in 1/s, with ``ratios`` of one axis; 0 for a constant M. None: any speed, jumps included.
    degree : {2, 4, 6, 8}
        Largest degree of Lyapunov functions that are tried for one axis at any speed. Above 2, and for ``rate`` and
        coupled axes, linear matrix inequalities are solved (extra ``lmi``).
    dt : float, optional
        Sampling interval in seconds: for a PhyFilter short for ``filter.sampled(dt)``.

    Returns
    -------
    InertiaCertificate

    Raises
    ------
    ImportError
        Without the extra ``lmi`` where only a linear matrix inequality can tell.
    TypeError
        If the filter or the loop is of another kind.
    ValueError
        If not one set is given, a matrix is not square, regular or as described, or the question is one that no method
        here answers: it says which.

    Notes
    -----
    A constant M: exact for ``ratios``, one pair and a hull, as the ends of the range of the eigenvalues of M_hat M^-1
    are attained at vertices (the largest eigenvalue of M_hat^-1/2 M M_hat^-1/2 is a convex function of M, the least a
    concave one); ``within`` a matrix exact up to 13 axes; ``between`` and ``within`` a number sufficient.

    M' does not appear: the filter sees M_hat x' - tau = (M_hat M^-1 - I) tau + M_hat M^-1 f, so that only M as it is
    counts, whether the robot is written M x' = ... or (M x)' = ...; what the latter has beside M x' is part of f. The
    loop is linear with f as its input: proven stable, a bounded f gives a bounded f_hat. A f that grows with x itself
    is a matter of the outer loop.

    Any speed, one filter: V = x' P x proves it exactly where the circle with the diameter [low, high] excludes the
    Nyquist curve, that is where the complex ratios about (low + high)/2 are stable within (high - low)/2
    (:attr:`FilterMargins.ratio_radius`); P solves a Riccati equation, and kron(P, I) serves every symmetric M_hat^-1/2
    M M_hat^-1/2 with eigenvalues in the range, however it turns. Sampled it holds for motion within the steps too. With
    delay in continuous time it is the circle criterion alone, over frequency.

    Higher degrees: V of products of states (for one axis). ``rate``: P linear in M_hat/M from knot to knot, matrix
    inequalities between them by Bernstein coefficients. Vertices: multipliers for p = M y, by vertices.

    Every P is checked in rational arithmetic, with a reserve for the rounding of the loop's matrices; what the solver
    says is not believed. Where no proof is found, motions back and forth between two values are searched for one that
    grows from period to period.

    References
    ----------
    Zames, "On the input-output stability of time-varying nonlinear feedback systems", IEEE Trans. Automatic Control 11
    (1966). Boyd, El Ghaoui, Feron, Balakrishnan, *Linear Matrix Inequalities in System and Control Theory*, SIAM 1994.

    Examples
    --------
    Three repeated poles tolerate any constant M_hat/M below 9, but not every motion between 1/8 and 8:

    >>> filter = PhyFilter.from_poles([-20.0] * 3)
    >>> inertia_tolerance(filter, ratios=(1 / 3.9, 3.9)).status
    <Status.PROVEN: 'proven'>
    >>> lost = inertia_tolerance(filter, ratios=(1 / 8, 8.0))
    >>> print(lost.message)
    diverges: 67.1 ms at 0.125, 66 ms at 8, and so on; 1.28 times as large after each period

    An arm of 2 kg m^2 and 8 kg that takes up to 1 kg with a lever, of which the model knows nothing:

    >>> loads = [[[2.0, 0.0], [0.0, 8.0]], [[2.5, 0.5], [0.5, 9.0]]]
    >>> inertia_tolerance(PhyFilter([20.0]), vertices=loads, M_hat=[2.0, 8.0], rate=0.0, dt=0.002).status
    <Status.PROVEN: 'proven'>
    >>> inertia_tolerance(filter, between=(0.1, 5.0), M_hat=1.0, rate=0.0).message
    'the eigenvalues of M_hat M^-1, 0.2 to 10, are not all within one stable interval'
    """
    around = checked_loop(loop)
    given = [
        name
        for name, each in (("ratios", ratios), ("vertices", vertices), ("between", between))
        if each is not None
    ]
    if within is not None and given != ["vertices"]:
        given.append("within")
    if len(given) != 1:
        raise ValueError(
            "ratios, vertices, between, within: expected one of them, the set in which the inertia is, got "
            f"{' and '.join(given) or 'none'}"
        )
    if M_hat is None and ratios is None and isinstance(filter, SampledPhyFilter):
        M_hat = filter.sampling.inertia_or(None)
    if (M_hat is None) != (ratios is not None):
        raise ValueError("M_hat: goes with every set but ratios, which are of M_hat/M already")
    if around.inertia_ratio != 1.0:
        raise ValueError(
            f"loop: inertia_ratio={around.inertia_ratio:g} names one M; expected 1, as the set says which are asked"
        )
    if rate is not None:
        rate = _signals.number("rate", rate, "1/s", least=0.0)
    shared = not isinstance(filter, FilterBank) and channels_of(filter) is None
    pair = (
        shared
        and rate == 0.0
        and vertices is not None
        and np.ndim(vertices) > 0
        and len(np.asarray(vertices)) == 1
    )
    if within is None and between is None and not pair:
        asked = {"ratios": ratios, "vertices": vertices, "M_hat": M_hat, "rate": rate, "degree": degree}
        return answered(question_of(filter, around, dt, **asked))
    if rate != 0.0 or not shared or isinstance(filter, FilterBank):
        raise ValueError(
            "between, within: are of a constant M and one filter for all axes: give rate=0, or ratios or vertices"
        )
    system, found = build_loop(filter, around, dt)
    margins, model = FilterMargins(1.0, found, system, around), np.ones(1) if M_hat is None else M_hat
    if within is not None and vertices is not None:
        return constant.of_hull(margins, model, vertices, within)
    if within is not None:
        return constant.within_deviation(margins, model, within)
    if between is not None:
        low, high = between
        return constant.between_two(margins, model, low, high)
    return constant.of_pair(
        margins, model, _signals.real("vertices", [] if vertices is None else vertices)[0]
    )
