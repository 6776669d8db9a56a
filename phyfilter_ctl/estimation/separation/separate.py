"""The front: what the residual of a recording is made of."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import cast, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ... import _signals
from ..._sections import FloatArray
from ...filter.sampling import Rule
from ...recording import Recording
from ...recording.checks import refuse_gaps
from ..noise import Noise, given_noise
from ..smoothing import smooth_label
from .found import Ends, PartEstimate, Separation
from .identifiability import Identifiability, identifiability
from .kalman import Course, Forward, Later, forward, smoothed, started
from .parts import AddedInertia, ModelScale, Part, Payload, Regressor
from .sensitivity import sensitivity as _sensitivity
from .structure import Samples, Structure, Working, samples_of, structure_of

__all__ = ["fractions", "separate"]

_WHITE = 4.0  # deviations of the mean square of the innovations beyond which the model is doubted
_WRONG = 10.0  # mean square of the innovations from which it is warned
_AT_REST = 2.0  # deviations of the noise, of all of x
_SHOWN = 5  # times of resets in a note
_LEAST = 20  # samples


@overload
def separate(
    recording: Recording,
    parts: Sequence[Part],
    *,
    noise: Noise | ArrayLike | None = None,
    causal: bool = False,
    fraction: float | Mapping[str, float] = 0.5,
    g: Rule = "hold",
    shared: Sequence[str] | None = None,
    sensitivity: bool = True,
) -> Separation: ...


@overload
def separate(
    recording: Sequence[Recording],
    parts: Sequence[Part] | Sequence[Sequence[Part]],
    *,
    noise: Noise | ArrayLike | None = None,
    causal: bool = False,
    fraction: float | Mapping[str, float] = 0.5,
    g: Rule = "hold",
    shared: Sequence[str] | None = None,
    sensitivity: bool = True,
) -> tuple[Separation, ...]: ...


def separate(
    recording: Recording | Sequence[Recording],
    parts: Sequence[Part] | Sequence[Sequence[Part]],
    *,
    noise: Noise | ArrayLike | None = None,
    causal: bool = False,
    fraction: float | Mapping[str, float] = 0.5,
    g: Rule = "hold",
    shared: Sequence[str] | None = None,
    sensitivity: bool = True,
) -> Separation | tuple[Separation, ...]:
    """What the residual f - f_theta of M x' = g + f is made of: every part with its uncertainty, or what it hides in.

    Parameters
    ----------
    recording : Recording, or sequence of them
        x, and what is known: g, f_theta, the inertia. Steps may differ.
    parts : sequence of Payload, AddedInertia, Regressor, ModelScale, SteadyForce, ColouredForce, SensorBias
        What the residual may be made of, with prior deviations: how large each may be. For several recordings also one
        such sequence each, which differ in the ``values`` of regressors alone.
    noise : Noise, float or (n_x,) array, optional
        Deviation of the white noise of M x, as for :func:`estimate`; None takes that of :func:`smooth_label`.
    causal : bool
        Whether each sample's estimate is from the samples up to it, as it would have been in flight; False uses all.
    fraction : float, or dict of str to float
        A scalar is identified if the data leave at most this share of its prior deviation, and would if the priors of
        all parameters were ten times as wide; by name of the part, where not one for all.
    g : {"hold", "average"}
        Between samples; f_theta and M run straight from one to the next.
    shared : sequence of str, optional
        Names of the parts, constant ones, that are the same in all of several recordings; None: payload, added inertia,
        regressors and scales of models, as far as they do not drift. The others begin anew in each.
    sensitivity : bool
        Whether ``notes`` say which parameters leave their intervals where a random or steady force is declared with
        three times or a third of its deviation or bandwidth, and the data fit as well. Takes a filter's run for each.

    Returns
    -------
    Separation, or tuple of Separation
        One for each recording. Its estimates rest on all recordings, with ``causal=True`` on those before it;
        ``log_likelihood`` is that of a recording given those before it, so that their sum is that of all.

    Raises
    ------
    TypeError
        If an argument is of another kind.
    ValueError
        If there are fewer than 20 samples or there are gaps, an inertia is asked for where neither g nor f_theta is
        recorded, the parts do not fit the recording or, of several, each
        other, a shared part is not constant, or an option is out of range.

    Warns
    -----
    UserWarning
        If the mean square of the innovations is above 10: the parts are not those of the data.

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

    A step over which x jumps as no force can move it, alone among its neighbours, is an estimator's reset: what x is
    after it, its sample alone says, and ``notes`` give the time.

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

    Two flights with the same payload know it better than one:

    >>> one, two = (separate(logs, parts, noise=0.03, g="average") for logs in (log, [log, log]))
    >>> (two[0].parts["payload"].sd_value / one.parts["payload"].sd_value).round(2)
    array([0.71])
    """
    single = isinstance(recording, Recording)
    logs = [recording] if single else list(cast("Sequence[Recording]", recording))
    for log in logs:
        _usable(log)
    if not logs:
        raise ValueError("recording: expected at least one, got none")
    if g not in ("hold", "average"):
        raise ValueError(f"g: expected 'hold' or 'average', got {g!r}")
    each = _parts_of_each(logs, parts)
    structure = structure_of(each[0], logs[0].n_x)
    common = _common(structure, each[0], shared)
    for log, own in zip(logs[1:], each[1:], strict=True):
        _refuse_others(structure, structure_of(own, log.n_x))
    shares = fractions(structure, fraction)
    levels = [_noise(log, noise, g) for log in logs]
    data = [
        samples_of(log, own, structure, level, g) for log, own, level in zip(logs, each, levels, strict=True)
    ]
    if max(one.rho for one in data) - min(one.rho for one in data) > 1e-9 * data[0].rho:
        raise ValueError(
            "recording: expected one inertia in all of them, got several, and a part that adds to it"
        )
    for log in logs:
        _refuse_unforced(structure, log)
    working = Working.of(structure, data[0].rho)
    runs, courses = _courses(working, data, common, causal=causal)
    found = tuple(
        _separation(log, own, Ends.of(working, one, run, course), level, shares, causal=causal)
        for log, own, one, run, course, level in zip(logs, each, data, runs, courses, levels, strict=True)
    )
    if sensitivity:
        last = found[-1]
        identified = np.array(list(last.identifiability.identified.values()))
        sd = np.sqrt(np.maximum(np.diag(last._ends.covariance[-1]), 0.0))
        depends = tuple(_sensitivity(working, data, common, identified, sd))
        found = tuple(replace(one, notes=one.notes + depends) for one in found)
    return found[0] if single else found


def _usable(log: Recording) -> None:
    if not isinstance(log, Recording):
        raise TypeError(f"recording: expected a Recording or several, got {type(log).__name__}")
    refuse_gaps(log.name, log.missing)
    if log.n < _LEAST:
        raise ValueError(f"recording: expected at least {_LEAST} samples, got {log.n}")


def _refuse_unforced(structure: Structure, log: Recording) -> None:
    if structure.theta is not None and log.g is None and log.f_theta is None:
        raise ValueError(
            f"recording: expected g, the known forces that move what {structure.labels[structure.theta]} resists, got "
            "neither g nor f_theta; see with_signals(g=...), zeros where there are none"
        )


def _parts_of_each(
    logs: Sequence[Recording], parts: Sequence[Part] | Sequence[Sequence[Part]]
) -> list[Sequence[Part]]:
    nested = [isinstance(entry, Sequence) and not isinstance(entry, str) for entry in parts]
    if not any(nested):
        return [cast("Sequence[Part]", parts)] * len(logs)
    if not all(nested) or len(parts) != len(logs):
        raise ValueError(f"parts: expected one sequence for each of {len(logs)} recordings, got {len(parts)}")
    return list(cast("Sequence[Sequence[Part]]", parts))


def _refuse_others(first: Structure, other: Structure) -> None:
    if first.labels != other.labels or any(
        not np.array_equal(getattr(first, key), getattr(other, key))
        for key in ("mean", "sd", "rate", "density", "load", "weight", "J", "measured")
    ):
        raise ValueError(
            "parts: expected those of each recording to differ in the values of regressors alone, "
            f"got {', '.join(first.labels)} and {', '.join(other.labels)} or other deviations"
        )


def _common(structure: Structure, parts: Sequence[Part], shared: Sequence[str] | None) -> FloatArray:
    """1 for each scalar that all recordings have in common, else 0."""
    constant = {
        structure.names[i] for i in structure.part[(structure.density == 0.0) & (structure.rate == 0.0)]
    }
    lasting = (Payload, AddedInertia, Regressor, ModelScale)
    names = [part.name for part in parts if isinstance(part, lasting) and part.name in constant]
    if shared is not None:
        names = [shared] if isinstance(shared, str) else list(shared)
    if unknown := [name for name in names if name not in structure.names]:
        raise ValueError(f"shared: expected names of {', '.join(structure.names)}, got {', '.join(unknown)}")
    if moving := [name for name in names if name not in constant]:
        raise ValueError(
            f"shared: expected constant parts, got {', '.join(moving)}; leave out drift or the name"
        )
    return np.array([float(structure.names[i] in names) for i in structure.part])


def _separation(
    log: Recording, parts: Sequence[Part], ends: Ends, level: FloatArray, shares: FloatArray, *, causal: bool
) -> Separation:
    working, run = ends.working, ends.run
    square = float(np.mean(run.whitened**2))
    if square > _WRONG:
        warnings.warn(
            f"the innovations' mean square is {square:.3g} and should be 1: the parts are not those of the data, and "
            "what is called identified is not; see notes",
            stacklevel=3,
        )
    P, turned = ends.working_covariance, ends.turned
    elapsed = log.times - log.times[0]
    asked = slice(-1, None) if causal else slice(None)
    report, _ = identifiability(working, P[asked], elapsed[asked], ends.c[-1], shares, turned[-1])
    known = np.broadcast_to(list(report.identified.values()), ends.c.shape)
    if causal:
        known = identifiability(working, P, elapsed, ends.c[-1], shares, turned[-1])[1]
    total, sd = ends.force([True] * len(parts))
    model = 0.0 if log.f_theta is None else log.f_theta
    return Separation(
        log,
        {part.name: _part(ends, report, known, i) for i, part in enumerate(parts)},
        model + total,
        sd,
        report,
        level,
        float(run.log_likelihood),
        square,
        causal,
        tuple(_notes(square, run.whitened.size, report) + _of_motion(log, ends)),
        ends,
    )


def _noise(log: Recording, noise: Noise | ArrayLike | None, g: Rule) -> FloatArray:
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


def _courses(
    working: Working, data: Sequence[Samples], shared: FloatArray, *, causal: bool
) -> tuple[list[Forward], list[Course]]:
    """Of the filter, or the smoother; again where random forces are scaled by the inertia that is found."""
    runs = _filtered(working, data, shared, [None] * len(data))
    if causal:
        return runs, [run.course for run in runs]
    courses = _smoothed(working, runs, shared)
    if working.structure.theta is not None:
        runs = _filtered(working, data, shared, [course.mean for course in courses])
        courses = _smoothed(working, runs, shared)
    return runs, courses


def _filtered(
    working: Working, data: Sequence[Samples], shared: FloatArray, about: Sequence[FloatArray | None]
) -> list[Forward]:
    runs: list[Forward] = []
    before: Course | None = None
    for one, means in zip(data, about, strict=True):
        run = forward(working, one, means, started(working, one.x[0], one.R, before, shared))
        before = Course(run.course.mean[-1], run.course.covariance[-1])
        runs.append(run)
    return runs


def _smoothed(working: Working, runs: Sequence[Forward], shared: FloatArray) -> list[Course]:
    later: Later | None = None
    courses: list[Course] = []
    for run in reversed(runs):
        course, first = smoothed(working, run, later)
        courses.append(course)
        later = first.through(working, shared)
    return courses[::-1]


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


def _of_motion(log: Recording, ends: Ends) -> list[str]:
    """What the recording itself is: at rest, or reset by its estimator."""
    data, found = ends.data, []
    if ends.structure.theta is not None and np.all(
        np.std(data.x, axis=0) <= _AT_REST * np.sqrt(np.diag(data.R))
    ):
        found.append(
            "x does not move beyond its noise: a vehicle that never left the ground is carried by it, and no part "
            "can be told from that; cut to where it moves"
        )
    if data.reset is not None:
        times = ", ".join(f"{t:.6g}" for t in log.times[1:][data.reset][:_SHOWN])
        more = ", ..." if data.reset.sum() > _SHOWN else ""
        found.append(
            f"x jumps as no force can move it, as by an estimator's reset; steps taken out, up to t = {times}{more} s"
        )
    return found
