"""Parts and a recording as one linear state-space model, (x, c) with c the scalars of all parts, sampled exactly.

    M x' = g + f_theta + L(t) c,      c_i' = -rate_i c_i + noise,      measured x + B c + noise

x itself is a state, so that neither x nor its noise is ever differentiated. An inertia part theta J, J = rho M, makes

    (1 + rho theta) M x' = g + f_theta + theta w + L(t) c,      w its weight

which is bilinear in theta, and linear in eta = 1/(1 + rho theta) - 1 and in forces per added inertia, (1 + eta) c:

    M x' = g + f_theta + eta (g + f_theta - w/rho) + L(t) (1 + eta) c

So the filter runs on these, and nothing is linearised: a regressor made of the measured motion would hold the noise,
one of the estimated motion the other parts, and both bias theta. What comes out is turned back at the end.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from ... import _signals
from ..._sections import FloatArray
from ...filter.sampling import Rule
from ...recording import Recording
from ...recording.checks import inertia_varies
from .parts import ModelScale, Part, Regressor, Terms

__all__ = [
    "LEAST_SHARE",
    "Moments",
    "Samples",
    "Structure",
    "Working",
    "moments",
    "samples_of",
    "structure_of",
]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)
_PROPORTIONAL = 1e-6  # of J, by which it may differ from rho M
LEAST_SHARE = 0.01  # of M in M + theta J: no payload of a hundred times the vehicle
_RESET = 10.0  # usual deviations of a step: a reset of x
_ROBUST = 1.4826  # standard deviation of a Gaussian over the median of its magnitude
_FEW = 4.0  # rate h up to which a dozen nodes integrate to the last digit


@dataclass(frozen=True, eq=False)
class Structure:
    """What does not depend on the recording. The scalars c of all parts one after the other, p in all.

    Attributes
    ----------
    names : tuple of str
        Of the parts.
    labels : tuple of str
        Of the scalars.
    part : (p,) array
        Which part each belongs to.
    mean, sd, rate, density : (p,) arrays
        As for :class:`Terms`.
    parameter : (p,) array
    load : (n_x, p) array
        0 where it is recorded.
    recorded : (p,) array
        Whether it is.
    theta : int or None
        Which scalar adds to the inertia.
    weight : (n_x,) array
        Its own force; 0 without one.
    J : (n_x, n_x) array
        What it adds to M.
    measured : (n_x, p) array
    """

    names: tuple[str, ...]
    labels: tuple[str, ...]
    part: NDArray[np.intp]
    mean: FloatArray
    sd: FloatArray
    rate: FloatArray
    density: FloatArray
    parameter: NDArray[np.bool_]
    load: FloatArray
    recorded: NDArray[np.bool_]
    theta: int | None
    weight: FloatArray
    J: FloatArray
    measured: FloatArray

    @property
    def n_x(self) -> int:
        """Channels."""
        return len(self.load)

    @property
    def random(self) -> NDArray[np.bool_]:
        """Which scalars are driven by noise."""
        return self.density > 0.0

    def rho(self, M: FloatArray) -> float:
        """J over M; 0 without an inertia part.

        Raises
        ------
        ValueError
            If M (..., n_x, n_x) is not constant and proportional to J.
        """
        if self.theta is None:
            return 0.0
        ratio = float(np.sum(self.J * M) / np.sum(M * M))
        if np.max(np.abs(ratio * M - self.J)) > _PROPORTIONAL * np.max(np.abs(self.J)) or not ratio > 0.0:
            raise ValueError(
                f"{self.labels[self.theta]}: expected a constant inertia M that it is proportional to, got another; "
                "give channels of other inertias as recordings of their own"
            )
        return ratio


def structure_of(parts: Sequence[Part], n_x: int) -> Structure:
    """The parts together.

    Raises
    ------
    TypeError
        If one is no part.
    ValueError
        If there are none, two have one name, or one does not fit the channels.
    """
    for i, part in enumerate(parts):
        if not isinstance(part, Part):
            raise TypeError(
                f"parts: expected Payload, ColouredForce and the like, got {type(part).__name__} at place {i}"
            )
    if not parts:
        raise ValueError("parts: expected at least one, such as ColouredForce(sd=1.0, bandwidth=2.0)")
    names = tuple(part.name for part in parts)
    if twice := [name for name, count in Counter(names).items() if count > 1]:
        raise ValueError(f"parts: expected different names, got {twice[0]!r} twice; give name=")
    terms: list[Terms] = [part._terms(n_x) for part in parts]
    counts = [len(each.labels) for each in terms]
    heavy = [i for i, each in enumerate(terms) if each.inertia is not None]
    if len(heavy) > 1:
        both = " and ".join(names[i] for i in heavy[:2])
        raise ValueError(
            f"parts: expected at most one that adds to the inertia, got {both}; only their sum is seen"
        )
    theta = int(np.sum(counts[: heavy[0]])) if heavy else None
    weight, J = np.zeros(n_x), np.zeros((n_x, n_x))
    for i in heavy:
        own, load = terms[i].inertia, terms[i].load
        assert own is not None
        assert load is not None
        weight, J = load[:, 0], own
    loads = [
        np.zeros((n_x, p)) if each.load is None or each.inertia is not None else each.load
        for each, p in zip(terms, counts, strict=True)
    ]
    return Structure(
        names,
        tuple(label for each in terms for label in each.labels),
        np.repeat(np.arange(len(terms)), counts),
        *(
            np.concatenate([getattr(each, key) for each in terms])
            for key in ("mean", "sd", "rate", "density")
        ),
        parameter=np.repeat([each.parameter for each in terms], counts),
        load=np.hstack(loads),
        recorded=np.repeat([each.load is None or each.inertia is not None for each in terms], counts),
        theta=theta,
        weight=weight,
        J=J,
        measured=np.hstack([each.measured for each in terms]),
    )


@dataclass(frozen=True, eq=False)
class Moments:
    """Exact sampling of the scalars over a step of length h; all (p,).

    Attributes
    ----------
    area : array
        Integral of c over the step for c = 1 at its beginning.
    stay : array
        What is left of it at the end.
    end, area_end, area_area : array
        Covariances that the noise of the step adds to c at the end and to its integral.
    """

    area: FloatArray
    stay: FloatArray
    end: FloatArray
    area_end: FloatArray
    area_area: FloatArray


def moments(rate: FloatArray, density: FloatArray, h: float) -> Moments:
    """Of a Gauss-Markov scalar, a random walk (rate 0) or a constant."""
    y = rate * h
    if np.max(y, initial=0.0) > _FEW:
        return _long(rate, density, h)
    s = 0.5 * (1.0 + _NODES)[:, None]
    left = np.exp(-y * s)
    weight = 0.5 * _WEIGHTS[:, None]
    # Integral of c from s to the end of the step, in units of h, by the same nodes again.
    rest = s * np.sum(weight[:, :, None] * np.exp(-y * s * s[:, :, None]), axis=0) if len(y) else s * left
    return Moments(
        h * np.sum(weight * left, axis=0),
        np.exp(-y),
        density * h * np.sum(weight * left**2, axis=0),
        density * h**2 * np.sum(weight * rest * left, axis=0),
        density * h**3 * np.sum(weight * rest**2, axis=0),
    )


def _long(rate: FloatArray, density: FloatArray, h: float) -> Moments:
    """The same in closed form where steps are long, and scalar by scalar where they are not."""
    parts = []
    for r, q in zip(rate.tolist(), density.tolist(), strict=True):
        if r * h <= _FEW:
            parts.append(moments(np.array([r]), np.array([q]), h))
            continue
        once, twice = -np.expm1(-r * h), -np.expm1(-2.0 * r * h)
        entries = (once / r, np.exp(-r * h), q * twice / (2.0 * r), q * once**2 / (2.0 * r**2))
        joint = q / r**2 * (h - 2.0 * once / r + twice / (2.0 * r))
        parts.append(Moments(*(np.array([entry]) for entry in (*entries, joint))))
    return Moments(
        *(
            np.concatenate([getattr(each, key) for each in parts])
            for key in ("area", "stay", "end", "area_end", "area_area")
        )
    )


@dataclass(frozen=True, eq=False)
class Samples:
    """Recordings as the model sees them; leading axes (...) after time are recordings side by side.

    Attributes
    ----------
    x : (N, ..., n_x) array
    h : (m,) array
        Lengths of the m = N - 1 steps, s.
    impulse : (m, ..., n_x) array
        Integral of g + f_theta over each step.
    load : (m, ..., n_x, p) array
        Mean of L over each step.
    M : (m, n_x, n_x) array
        Mean of M over each step.
    R : (n_x, n_x) array
        Covariance of the noise of x.
    rho : float
        J over M.
    force_end : (N, ..., n_x) array
        g + f_theta at the end of the step up to each sample, and of the first at its beginning.
    load_end : (N, ..., n_x, p) array
        L at the samples.
    M_end : (N, n_x, n_x) array
        M at the samples.
    reset : (m,) bool array or None
        Steps over which an estimator reset x; None: none.
    """

    x: FloatArray
    h: FloatArray
    impulse: FloatArray
    load: FloatArray
    M: FloatArray
    R: FloatArray
    rho: float
    force_end: FloatArray
    load_end: FloatArray
    M_end: FloatArray
    reset: NDArray[np.bool_] | None = None


def resets(rest: FloatArray, h: FloatArray, sd: FloatArray) -> NDArray[np.bool_]:
    """Which of m steps an estimator reset x over: one step alone that no force and no noise explains.

    ``rest`` (m, n_x) is by how much x moved beyond what is known, ``sd`` (n_x,) the noise of x. A force that sets in
    moves all steps that follow, a single wrong sample two of them; neither is a reset.
    """
    beside = np.abs(rest - median_filter(rest, size=(5, 1), mode="nearest"))
    usual = np.maximum(_ROBUST * np.median(beside, axis=0), np.sqrt(2.0) * sd)
    far = np.any(beside > _RESET * usual * np.maximum(h / np.median(h), 1.0)[:, None], axis=1)
    near = np.concatenate([[False], far[:-1]]) | np.concatenate([far[1:], [False]])
    return far & ~near


def samples_of(
    log: Recording, parts: Sequence[Part], structure: Structure, noise: FloatArray, g: Rule
) -> Samples:
    """Of one recording; ``noise`` (n_x,) is the deviation of the noise of M x."""
    h, n, n_x = np.diff(log.times), log.n, log.n_x
    known = np.zeros((n, n_x)) if log.g is None else log.g
    model = np.zeros((n, n_x)) if log.f_theta is None else log.f_theta
    acting = known[:-1] if g == "hold" else _means(known)
    load_end = np.broadcast_to(structure.load, (n, *structure.load.shape)).copy()
    load = load_end[:-1].copy()
    for i, part in enumerate(parts):
        if isinstance(part, Regressor | ModelScale):
            own = structure.part == i
            values = part._recorded(log)
            load[:, :, own] = values[:-1] if part.between == "hold" else _means(values)
            load_end[:, :, own] = (
                np.concatenate([values[:1], values[:-1]]) if part.between == "hold" else values
            )
    M_end = _matrices(log)
    M, rho = _means(M_end), structure.rho(M_end)
    force = acting + _means(model)
    force_end = (np.concatenate([known[:1], known[:-1]]) if g == "hold" else known) + model
    if structure.theta is not None:
        load[:, :, structure.theta] = force - structure.weight / rho
        load_end[:, :, structure.theta] = force_end - structure.weight / rho
    into_x = np.linalg.inv(M_end.mean(axis=0))
    R = into_x @ np.diag(noise**2) @ into_x.T
    rest = np.diff(log.x, axis=0) - (h[:, None] * force) @ into_x.T
    reset = resets(rest, h, np.sqrt(np.diag(R)))
    return Samples(
        log.x,
        h,
        h[:, None] * force,
        load,
        M,
        R,
        rho,
        force_end,
        load_end,
        M_end,
        reset if reset.any() else None,
    )


def _means(values: FloatArray) -> FloatArray:
    return 0.5 * (values[1:] + values[:-1])


def _matrices(log: Recording) -> FloatArray:
    """M (N, n_x, n_x) of a recording."""
    M, n, n_x = log.inertia, log.n, log.n_x
    eye = np.eye(n_x)
    if M is None:
        full = eye
    elif inertia_varies(M, n):
        full = M if M.ndim == 3 else M[:, :, None] * eye
    else:
        full = M if M.ndim == 2 else eye * M
    found = np.broadcast_to(full, (n, n_x, n_x))
    if not np.all(np.abs(np.linalg.det(found)) > 0.0):
        raise ValueError("inertia: expected invertible matrices, got one that is singular")
    _signals.refuse_unusable("inertia", found)
    return found


@dataclass(frozen=True, eq=False)
class Working:
    """The scalars that the filter runs on: eta for theta, (1 + eta) c for the others.

    Attributes
    ----------
    structure : Structure
    rho : float
    mean, sd : (p,) arrays
        Prior, that of eta to first order.
    """

    structure: Structure
    rho: float
    mean: FloatArray
    sd: FloatArray

    @classmethod
    def of(cls, structure: Structure, rho: float) -> Working:
        """For an inertia part of this J over M."""
        mean, sd = structure.mean.copy(), structure.sd.copy()
        if (i := structure.theta) is not None:
            whole = 1.0 + rho * mean[i]
            if not whole > 0.0:
                raise ValueError(
                    f"{structure.labels[i]}: mean: expected a positive inertia, got {mean[i]:g} beside M"
                )
            eta = 1.0 / whole - 1.0, rho * sd[i] / whole**2
            mean, sd = mean / whole, sd / whole
            mean[i], sd[i] = eta
        return cls(structure, rho, mean, sd)

    def scale(self, c: FloatArray) -> FloatArray:
        """Working over physical deviations (..., p) of noise, at working scalars c."""
        found = np.ones(c.shape)
        if (i := self.structure.theta) is not None:
            share = np.maximum(1.0 + c[..., i : i + 1], LEAST_SHARE)
            found = found * share
            found[..., i] = self.rho * share[..., 0] ** 2
        return found

    def physical(self, c: FloatArray, P: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Scalars (..., p), covariance (..., p, p) and the derivative (..., p, p) by the working ones."""
        D = np.broadcast_to(np.eye(c.shape[-1]), P.shape).copy()
        if (i := self.structure.theta) is None:
            return c, P, D
        share = np.maximum(1.0 + c[..., i], LEAST_SHARE)
        found = c / share[..., None]
        D /= share[..., None, None]
        D[..., :, i] = -c / share[..., None] ** 2
        found[..., i] = (1.0 / share - 1.0) / self.rho
        D[..., i, i] = -1.0 / (self.rho * share**2)
        return found, D @ P @ np.swapaxes(D, -1, -2), D
