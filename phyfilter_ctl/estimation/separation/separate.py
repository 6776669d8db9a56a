"""The front: what the residual of a recording is made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ... import _signals
from ..._sections import FloatArray
from ...filter.sampling import Rule
from ...recording import Recording
from ...recording.checks import refuse_gaps
from ...results import Result
from ..noise import given_noise
from ..smoothing import smooth_label
from ..spectrum import NoiseLevel
from .identifiability import Identifiability, identifiability
from .kalman import Course, Forward, forward, smoothed
from .parts import Part
from .structure import Samples, Structure, Working, samples_of, structure_of

__all__ = ["PartEstimate", "PartialSum", "Separation", "fractions", "separate"]

_WHITE = 4.0  # deviations of the mean square of the innovations beyond which the model is doubted
_LEAST = 20  # samples


@dataclass(frozen=True, eq=False, repr=False)
class PartialSum(Result):
    """The force of one part or several together.

    Attributes
    ----------
    force : (N, n_x) array
        At the end of the step up to each sample, as f_hat; NaN where it is not identified.
    sd : (N, n_x) array
        Standard deviation.
    """

    force: FloatArray
    sd: FloatArray


@dataclass(frozen=True, eq=False, repr=False)
class PartEstimate(PartialSum):
    """One part of the residual; made by :func:`separate`. What the data cannot tell apart is NaN.

    Attributes
    ----------
    force, sd : (N, n_x) arrays
        As for :class:`PartialSum`.
    labels : tuple of str
        Of its p scalars: parameters, or the channels of a force.
    identified : (p,) array
        Which of them the data tell from the other parts.
    value, sd_value : (p,) arrays
        At the end of the recording: of a parameter that is constant the estimate.
    course, sd_course : (N, p) arrays
        Over time.
    only_with : tuple of str
        Labels of other parts that it is known in a sum with.
    message : str
    """

    labels: tuple[str, ...]
    identified: NDArray[np.bool_]
    value: FloatArray
    sd_value: FloatArray
    course: FloatArray
    sd_course: FloatArray
    only_with: tuple[str, ...]
    message: str

    @property
    def interval(self) -> FloatArray:
        """95 % interval (p, 2) of the value."""
        return self.value[:, None] + 1.96 * self.sd_value[:, None] * np.array([-1.0, 1.0])


@dataclass(frozen=True, eq=False, repr=False)
class Separation(Result):
    """What the residual is made of; made by :func:`separate`.

    Attributes
    ----------
    recording : Recording
    parts : dict of str to PartEstimate
        By name.
    f_hat, f_hat_sd : (N, n_x) arrays
        f_theta and all parts: the estimate of f, whatever can be told apart in it, with its standard deviation.
    identifiability : Identifiability
    noise : (n_x,) array
        Deviation of the noise of M x that was counted on.
    log_likelihood : float
        Of the recording under these parts: compare it between bandwidths, deviations and sets of parts.
    consistency : float
        Mean square of the innovations in their own units: 1 where the parts describe the data. Above it intervals are
        too narrow.
    causal : bool
        As asked for.
    notes : tuple of str
        What to look at before trusting the figures.
    _ends : object
        What :meth:`together` and :func:`detect_changes` reckon with.
    """

    recording: Recording = field(repr=False)
    parts: Mapping[str, PartEstimate]
    f_hat: FloatArray
    f_hat_sd: FloatArray
    identifiability: Identifiability
    noise: FloatArray
    log_likelihood: float
    consistency: float
    causal: bool
    notes: tuple[str, ...]
    _ends: Ends = field(repr=False)

    _figures = (
        "parts",
        "f_hat",
        "f_hat_sd",
        "identifiability",
        "noise",
        "log_likelihood",
        "consistency",
        "notes",
    )

    def together(self, *names: str) -> PartialSum:
        """The force of several parts in sum, also of those known only as a sum.

        Parameters
        ----------
        names : str
            Of the parts.

        Raises
        ------
        ValueError
            If one is unknown, or has partners that are missing: the sum is then not known either.
        """
        unknown = [name for name in names if name not in self.parts]
        if unknown or not names:
            got = ", ".join(unknown) if names else "none"
            raise ValueError(f"names: expected some of {', '.join(self.parts)}, got {got}")
        inside = {label for name in names for label in self.parts[name].labels}
        for name in names:
            missing = [label for label in self.parts[name].only_with if label not in inside]
            if missing:
                raise ValueError(
                    f"names: {name} is known only in a sum with {', '.join(missing)}; name its part too"
                )
        return PartialSum(*self._ends.force([name in names for name in self.parts]))


@dataclass(frozen=True, eq=False)
class Ends:
    """The model at the end of each step: what forces follow from the scalars.

    Attributes
    ----------
    structure : Structure
    data : Samples
    c : (N, p) array
    covariance : (N, p, p) array
    working : Working
    run : Forward
    """

    structure: Structure
    data: Samples
    c: FloatArray
    covariance: FloatArray
    working: Working
    run: Forward

    def map(self, inside: Sequence[bool]) -> tuple[FloatArray, FloatArray]:
        """Force (N, n_x) of the parts inside, and its derivative (N, n_x, p) by all scalars."""
        structure, data = self.structure, self.data
        own = np.asarray(inside)[structure.part]
        L = data.load_end.copy()
        if (i := structure.theta) is not None:
            L[:, :, i] = structure.weight
        force = (L * own @ self.c[..., None])[..., 0]
        if i is None:
            return force, L * own
        into_x = np.linalg.inv(data.M_end + self.c[:, i, None, None] * structure.J)
        slope = (into_x @ (data.force_end[..., None] + L @ self.c[..., None]))[..., 0]
        resist, moved = slope @ structure.J, into_x @ L
        moved[:, :, i] -= (into_x @ resist[..., None])[..., 0]
        D = L * own
        if own[i]:
            theta = self.c[:, i, None]
            force = force - theta * resist
            D = D - theta[..., None] * (structure.J @ moved)
            D[:, :, i] -= resist
        return force, D

    def force(self, inside: Sequence[bool]) -> tuple[FloatArray, FloatArray]:
        """And its standard deviation."""
        force, D = self.map(inside)
        variance = np.einsum("nip,npq,niq->ni", D, self.covariance, D)
        return force, np.sqrt(np.maximum(variance, 0.0))


def separate(
    recording: Recording,
    parts: Sequence[Part],
    *,
    noise: NoiseLevel | ArrayLike | None = None,
    causal: bool = False,
    fraction: float | Mapping[str, float] = 0.5,
    g: Rule = "hold",
) -> Separation:
    """What the residual f - f_theta of M x' = g + f is made of: every part with its uncertainty, or what it hides in.

    Parameters
    ----------
    recording : Recording
        x, and what is known: g, f_theta, the inertia. Steps may differ.
    parts : sequence of Payload, AddedInertia, Regressor, ModelScale, SteadyForce, ColouredForce, SensorBias
        What the residual may be made of, with prior deviations: how large each may be.
    noise : NoiseLevel, float or (n_x,) array, optional
        Deviation of the white noise of M x, as for :func:`estimate`; None takes that of :func:`smooth_label`.
    causal : bool
        Whether each sample's estimate is from the samples up to it, as it would have been in flight; False uses all.
    fraction : float, or dict of str to float
        A scalar is identified if the data leave at most this share of its prior deviation, and would if the priors of
        all parameters were ten times as wide; by name of the part, where not one for all.
    g : {"hold", "average"}
        Between samples; f_theta and M run straight from one to the next.

    Returns
    -------
    Separation

    Raises
    ------
    TypeError
        If an argument is of another kind.
    ValueError
        If there are fewer than 20 samples or there are gaps, the parts do not fit the recording, or an option is out of
        range.

    Notes
    -----
    With c the scalars of all parts, the model sampled exactly at any steps is

        (M + theta J) x' = g + f_theta + L(t) c,    c_i' = -rate_i c_i + white noise,    measured x + white noise

    and (x, c) the state of a Kalman filter (causal) or smoother. x is not differentiated: its noise enters where it is
    measured, once. One part may add to the inertia, J proportional to a constant M: in 1/(M + theta J) and forces per
    inertia the model is linear. Without parameters the gain becomes constant and f_hat that of a PhyFilter: of order 2
    for one :class:`SteadyForce` that drifts.

    Whether a part is identified must not hang on priors: all but a hundredth of the information of the parameters'
    priors is taken out of the posterior first. What is not identified is reported in the sums that are, along the
    eigenvectors of that covariance in units of the prior. Random forces are known by their bandwidths and deviations;
    these are believed, and ``consistency`` says how well they fit.

    Examples
    --------
    A mass of 3 kg with 0.6 kg on it, lifted and lowered in gusts, seen by a velocity with noise of 1 cm/s:

    >>> from phyfilter_ctl.estimation import ColouredForce, Payload, SteadyForce
    >>> rng = np.random.default_rng(0)
    >>> t = 0.01 * np.arange(301)
    >>> g = 3.6 * (9.81 + 3.0 * np.sin(2.0 * t)) - 3.0 * 9.81
    >>> v = 1.5 * (1.0 - np.cos(2.0 * t)) + 0.01 * rng.standard_normal(t.shape)
    >>> log = Recording.from_arrays(x=v, g=g, dt=0.01, inertia=3.0)
    >>> parts = [Payload(1.0, gravity=[9.81]), ColouredForce(1.0, bandwidth=5.0)]
    >>> found = separate(log, parts, noise=0.03, g="average")
    >>> low, high = found.parts["payload"].interval[0]
    >>> bool(0.5 < low < 0.6 < high < 0.7)
    True

    At rest its weight is a force like any other:

    >>> rest = Recording.from_arrays(x=0.01 * rng.standard_normal(50), g=np.full(50, 5.9), dt=0.01, inertia=3.0)
    >>> found = separate(rest, [Payload(1.0, gravity=[9.81]), SteadyForce(20.0)], noise=0.03)
    >>> found.parts["payload"].value, found.parts["payload"].only_with
    (array([nan]), ('steady',))
    >>> found.together("payload", "steady").force[-1].round(1)
    array([-5.9])
    """
    if not isinstance(recording, Recording):
        raise TypeError(f"recording: expected a Recording, got {type(recording).__name__}")
    refuse_gaps(recording.name, recording.missing)
    if recording.n < _LEAST:
        raise ValueError(f"recording: expected at least {_LEAST} samples, got {recording.n}")
    if g not in ("hold", "average"):
        raise ValueError(f"g: expected 'hold' or 'average', got {g!r}")
    structure = structure_of(parts, recording.n_x)
    level = _noise(recording, noise, g)
    shares = fractions(structure, fraction)
    data = samples_of(recording, parts, structure, level, g)
    working = Working.of(structure, data.rho)
    run, course = _course(working, data, causal=causal)
    c, P = course.mean[:, recording.n_x :], course.covariance[:, recording.n_x :, recording.n_x :]
    found, covariance, turned = working.physical(c, P)
    ends = Ends(structure, data, found, covariance, working, run)
    elapsed = recording.times - recording.times[0]
    asked = slice(-1, None) if causal else slice(None)
    report, _ = identifiability(working, P[asked], elapsed[asked], found[-1], shares, turned[-1])
    known = np.broadcast_to(list(report.identified.values()), found.shape)
    if causal:
        known = identifiability(working, P, elapsed, found[-1], shares, turned[-1])[1]
    total, sd = ends.force([True] * len(parts))
    model = 0.0 if recording.f_theta is None else recording.f_theta
    square = float(np.mean(run.whitened**2))
    return Separation(
        recording,
        {part.name: _part(ends, report, known, i) for i, part in enumerate(parts)},
        model + total,
        sd,
        report,
        level,
        float(run.log_likelihood),
        square,
        causal,
        tuple(_notes(square, run.whitened.size, report)),
        ends,
    )


def _noise(log: Recording, noise: NoiseLevel | ArrayLike | None, g: Rule) -> FloatArray:
    level = smooth_label(log, g=g).noise if noise is None else None
    found = given_noise(noise if level is None else level, [log])
    assert found is not None
    if len(found.covariance) > 1:
        raise ValueError(
            "noise: expected white noise, got one of several lags; describe its colour by a SensorBias with a "
            "bandwidth, and give here what is white beside it"
        )
    if not np.all(found.value > 0.0):
        raise ValueError(
            f"noise: expected a deviation above 0 of every channel, got {found.value}; give noise="
        )
    return found.value


def fractions(structure: Structure, fraction: float | Mapping[str, float]) -> FloatArray:
    """Share of its prior deviation, for each scalar, below which it counts as identified."""
    given = dict(fraction) if isinstance(fraction, Mapping) else dict.fromkeys(structure.names, fraction)
    if unknown := given.keys() - set(structure.names):
        raise ValueError(
            f"fraction: expected names of {', '.join(structure.names)}, got {', '.join(sorted(unknown))}"
        )
    for name, value in given.items():
        if not 0.0 < _signals.number(f"fraction of {name}", value) < 1.0:
            raise ValueError(f"fraction of {name}: expected a number between 0 and 1, got {value}")
    return np.array([given.get(structure.names[i], 0.5) for i in structure.part])


def _course(working: Working, data: Samples, *, causal: bool) -> tuple[Forward, Course]:
    """The filter's, or the smoother's; again where random forces are scaled by the inertia that is found."""
    run = forward(working, data)
    if causal:
        return run, run.course
    if working.structure.theta is not None:
        run = forward(working, data, smoothed(working, run).mean)
    return run, smoothed(working, run)


def _part(ends: Ends, report: Identifiability, known: NDArray[np.bool_], i: int) -> PartEstimate:
    structure = ends.structure
    own = structure.part == i
    labels = tuple(label for label, mine in zip(structure.labels, own, strict=True) if mine)
    identified = np.array([report.identified[label] for label in labels])
    partners = report.partners(tuple(label for label in labels if not report.identified[label]))
    partners = tuple(label for label in partners if label not in labels)
    course = np.where(known, ends.c, np.nan)[:, own]
    variance = np.maximum(np.diagonal(ends.covariance, axis1=-2, axis2=-1), 0.0)
    sd = np.where(known, np.sqrt(variance), np.nan)[:, own]
    inside = [j == i for j in range(len(structure.names))]
    force, force_sd = ends.force(inside)
    _, D = ends.map(inside)
    unclear = np.any((D[:, :, own] != 0.0) & ~known[:, None, own], axis=-1)
    force, force_sd = (np.where(unclear, np.nan, each) for each in (force, force_sd))
    return PartEstimate(
        force,
        force_sd,
        labels,
        identified,
        np.where(identified, course[-1], np.nan),
        np.where(identified, sd[-1], np.nan),
        course,
        sd,
        partners,
        _message(labels, identified, partners, report),
    )


def _message(
    labels: tuple[str, ...], identified: NDArray[np.bool_], partners: tuple[str, ...], report: Identifiability
) -> str:
    if identified.all():
        return "identified"
    hidden = [label for label, fine in zip(labels, identified, strict=True) if not fine]
    sums = [str(each) for each in report.combinations if set(hidden) & each.coefficients.keys()]
    if partners or sums:
        return f"{', '.join(hidden)}: only as a sum: {'; '.join(sums)}"
    return f"{', '.join(hidden)}: the data say too little; move more, record longer, or declare how large it may be"


def _notes(square: float, count: int, report: Identifiability) -> list[str]:
    found = []
    if abs(square - 1.0) > _WHITE * np.sqrt(2.0 / count):
        found.append(
            f"the innovations' mean square is {square:.3g} and should be 1: deviations, bandwidths or the noise are "
            f"not those of the data, and intervals are too {'narrow' if square > 1.0 else 'wide'}"
        )
    if hidden := [label for label, fine in report.identified.items() if not fine]:
        found.append(f"not identified: {', '.join(hidden)}")
    return found
