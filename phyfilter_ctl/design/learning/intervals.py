"""How well the data know what was learned: standard errors that hold for correlated errors.

    cov = A^-1 B A^-1,    A = sum_k w psi_k psi_k',    B = long-run covariance of q_k = sum over channels of w psi_k e_k

with psi the derivative of f_hat and e what is left (White, Econometrica 50 (1982); Ljung, System Identification, 1999,
ch. 9). Errors of a filter are coloured, so neighbouring q_k are not independent: B is Newey and West's (Econometrica 55
(1987)) within each flight, with Andrews' bandwidth (Econometrica 59 (1991)), or, of many flights, the covariance of
their sums. Channels of one sample count as one observation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from ..._sections import ComplexArray, FloatArray
from ...filter.sampling import Method
from ...results import Interval, Result
from .coordinates import chain_slopes
from .levenberg import bound
from .residuals import BEGINNINGS, Flight, each
from .samples import Samples
from .search import Best, OrderSearch
from .sensitivity import jacobian

__all__ = ["Directions", "Intervals", "beginnings", "directions_of", "intervals_of"]

_LEVEL = 0.95
# So many flights, and their sums are the independent observations.
_CLUSTERS = 12
# Directions whose share in A is below this are not known.
_UNKNOWN = 1e-12


@dataclass(frozen=True, eq=False, repr=False)
class Intervals(Result):
    """Standard errors and 95 % intervals.

    Attributes
    ----------
    poles : (n,) complex array
        As in the filter, in rad/s.
    pole_errors : (n, 2) array
        Standard errors of their real and imaginary parts in rad/s; infinite where poles meet, 0 for given ones.
        Unknowns at a bound count as known.
    dc_gain : Interval
        Of F(0); of no width where F(0) is given.
    rmse : Interval
        Of the root-mean-square error that flights like these have.
    kind : str
        What was taken as independent.
    degrees_of_freedom : float
        Of Student's t.
    """

    poles: ComplexArray
    pole_errors: FloatArray
    dc_gain: Interval
    rmse: Interval
    kind: str
    degrees_of_freedom: float

    @property
    def half_widths(self) -> FloatArray:
        """Half the 95 % intervals (n, 2) of the poles' real and imaginary parts in rad/s."""
        return float(stdtrit(self.degrees_of_freedom, 0.5 + 0.5 * _LEVEL)) * self.pole_errors


class Directions(NamedTuple):
    """In which the unknowns move the filter: rows of the doubled chain (p, 2n), and which of theta are at a bound."""

    rows: FloatArray
    known: NDArray[np.bool_]


def directions_of(search: OrderSearch, best: Best) -> Directions:
    """Of the best filter of a search, on its data."""
    chain = best.chain
    rows = jacobian(search.fine, chain, best.found.c, search.shape)
    slopes = chain_slopes(search.coordinates, chain, best.theta)
    rows = np.concatenate([slopes @ rows[: chain.order], rows[chain.order :]])
    upper, lower = search.box(chain.order)
    known = bound(best.theta, best.found.gradient, upper, lower)
    free = np.append(~known, np.ones(len(rows) - len(known), dtype=bool))
    return Directions(rows[free], known)


def beginnings(flights: Sequence[Flight]) -> tuple[list[Flight], float]:
    """Beginnings of the flights, ``BEGINNINGS`` samples of all together, and their share in all samples."""
    taking = [flight for flight in flights if flight.takes_part]
    counts = [flight.length - flight.first for flight in taking]
    share = min(1.0, BEGINNINGS / sum(counts))
    begun = [
        flight.beginning(flight.first + max(2, round(share * count)))
        for flight, count in zip(taking, counts, strict=True)
    ]
    return begun, share


def intervals_of(
    begun: Sequence[Flight],
    share: float,
    search: OrderSearch,
    best: Best,
    directions: Directions,
    offset: bool,
) -> Intervals:
    """Intervals of the best filter of a search on beginnings of its flights."""
    chain, (rows, known) = best.chain, directions
    work = partial(
        _scores,
        method=search.method,
        doubled=chain.doubled,
        c=best.found.c,
        rows=rows,
        offset=offset,
    )
    parts = [*each(work, begun)]
    A = np.sum([part[0] for part in parts], axis=0)
    squares, weight = (sum(part[k] for part in parts) for k in (2, 3))
    mean = squares / weight
    # The last column is that of the mean square itself.
    q = [np.column_stack([part[1][:, :-1], part[1][:, -1] - mean * part[4]]) for part in parts]
    B, degrees, kind = _long_run(q)
    inverse = _inverse(A)
    covariance = share * inverse @ B[:-1, :-1] @ inverse
    t = float(stdtrit(degrees, 0.5 + 0.5 * _LEVEL))
    spread = 0.5 * t * float(np.sqrt(share * B[-1, -1])) / max(squares, np.finfo(float).tiny)
    root = float(np.sqrt(mean))
    gain = search.filter(best).dc_gain
    half = t * _gain_error(rows, chain.doubled, covariance)
    if search.shape.form == "lowpass" or search.shape.dc_gain is not None:
        half = 0.0
    moved = np.zeros((len(covariance), chain.order))
    by_theta = search.coordinates.coefficients(chain, best.theta)[~known]
    moved[: len(by_theta)] = by_theta
    poles = search.filter(best).poles()
    return Intervals(
        poles,
        _pole_errors(poles, moved, covariance),
        Interval(gain, gain - half, gain + half),
        Interval(root, root * float(np.exp(-spread)), root * float(np.exp(spread))),
        kind,
        degrees,
    )


def _scores(
    flight: Flight,
    method: Method,
    doubled: FloatArray,
    c: FloatArray,
    rows: FloatArray,
    offset: bool,
) -> tuple[FloatArray, FloatArray, float, float, FloatArray]:
    """Of one flight: A, q_k with sum w e^2 as last column, sum w e^2, sum w, and sum w of every sample."""
    n, (m, K) = len(c), flight.u.shape
    psi, e = np.empty((len(rows), m, K)), np.empty((m, K))
    for chunk, s in Samples(flight, method).states(doubled):
        psi[:, chunk] = np.tensordot(rows, s, 1)
        e[chunk] = flight.target[chunk] - np.tensordot(c, s[:n], 1)
    w = flight.weight * (np.ones((m, K)) if flight.sample_weights is None else flight.sample_weights)
    w[: flight.first] = 0.0
    if offset:
        total = np.maximum(w.sum(axis=0), np.finfo(float).tiny)
        e -= (w * e).sum(axis=0) / total
        psi -= ((w * psi).sum(axis=1) / total)[:, None]
    A = np.einsum("imk,jmk,mk->ij", psi, psi, w, optimize=True)
    q = np.column_stack([np.einsum("imk,mk->mi", psi, w * e), (w * e * e).sum(axis=1)])
    return A, q[flight.first :], float(np.sum(w * e * e)), float(np.sum(w)), w[flight.first :].sum(axis=1)


def _long_run(parts: Sequence[FloatArray]) -> tuple[FloatArray, float, str]:
    """Covariance of the sum of all q (m, p), degrees of freedom, and what was taken as independent."""
    if len(parts) >= _CLUSTERS:
        sums = np.array([q.sum(axis=0) for q in parts])
        factor = len(parts) / (len(parts) - 1.0)
        return factor * sums.T @ sums, len(parts) - 1.0, f"{len(parts)} flights"
    samples = sum(len(q) for q in parts)
    reach = _bandwidth(parts, samples)
    B = np.sum([_bartlett(q, min(reach, len(q))) for q in parts], axis=0)
    return B, max(samples / reach - 1.0, 1.0), f"stretches of {reach} samples (Newey and West)"


def _bartlett(q: FloatArray, reach: int) -> FloatArray:
    """Newey and West's sum: Bartlett's window is that of all overlapping sums of ``reach`` samples."""
    total = np.concatenate([np.zeros((1, q.shape[1])), np.cumsum(q, axis=0)])
    last = np.minimum(np.arange(1, len(q) + reach), len(q))
    first = np.maximum(np.arange(1, len(q) + reach) - reach, 0)
    windows = total[last] - total[first]
    return windows.T @ windows / reach


def _bandwidth(parts: Sequence[FloatArray], samples: int) -> int:
    """Andrews' bandwidth in samples for Bartlett's window, every q taken as a first-order process."""
    power = np.sum([np.sum(q * q, axis=0) for q in parts], axis=0)
    lagged = np.sum([np.sum(q[1:] * q[:-1], axis=0) for q in parts], axis=0)
    seen = power > 0.0
    rho = np.clip(lagged[seen] / power[seen], -0.99, 0.99)
    if not len(rho):
        return 1
    # Columns are of different units: each counts alike.
    above = np.sum(4.0 * rho**2 / ((1.0 - rho) ** 6 * (1.0 + rho) ** 2) * (1.0 - rho) ** 4)
    reach = 1.1447 * (above / len(rho) * samples) ** (1.0 / 3.0)
    return int(np.clip(np.ceil(reach), 1, max(1, samples // 4)))


def _inverse(A: FloatArray) -> FloatArray:
    diagonal = np.diag(A)
    least = np.finfo(float).eps ** 2 * np.max(diagonal, initial=0.0)
    sizes = np.sqrt(np.where(diagonal > least, diagonal, 1.0))
    values, vectors = np.linalg.eigh(A / np.outer(sizes, sizes))
    values = np.maximum(values, _UNKNOWN * np.max(values, initial=1.0))
    return (vectors / values) @ vectors.T / np.outer(sizes, sizes)


def _gain_error(rows: FloatArray, doubled: FloatArray, covariance: FloatArray) -> float:
    slope = -rows @ np.linalg.solve(doubled[:-1, :-1], doubled[:-1, -1])
    return float(np.sqrt(max(slope @ covariance @ slope, 0.0)))


def _pole_errors(poles: ComplexArray, moved: FloatArray, covariance: FloatArray) -> FloatArray:
    """By d p = -sum_j p^j d a_j / D'(p)."""
    n = len(poles)
    apart = poles[:, None] - poles + np.eye(n)
    slopes = -(poles[:, None] ** np.arange(n)) @ moved.T
    with np.errstate(all="ignore"):
        slopes = slopes / np.prod(apart, axis=1)[:, None]
        parts = [np.einsum("ij,jk,ik->i", part, covariance, part) for part in (slopes.real, slopes.imag)]
    errors = np.sqrt(np.maximum(np.stack(parts, axis=1), 0.0))
    return np.where(np.isfinite(errors), errors, np.inf)
