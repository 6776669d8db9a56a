"""Residual-force estimation on recorded flights, scored against the recorded force and against the motion.

    f_hat = f_theta + F(s) [v' - g - f_theta]        per unit mass: x = v, M = 1

g is thrust along the measured attitude, and gravity; f is everything else: wind, drag, battery, motor lag. Where the
recorded label is itself made of a difference of v, less g, a plain difference of v scores well against it, the more so
the less it filters, and motor lag counts as force. Hence the second score, which needs no label: how well f_hat_k,
held, predicts the velocity m samples on.

    ahead_k = f_hat_k - [(v_{k+m} - v_k) / (m h) - mean of g over the same time]
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl import PhyFilter, SampledPhyFilter, Status
from phyfilter_ctl.baselines import BackwardDifference, LowpassDifference
from phyfilter_ctl.learned import Chebyshev, FitResult, LearnedModel
from phyfilter_ctl.results import plain

from .replay_recordings import AXES, BAND, DelayScan, WindTunnelFlight, read

__all__ = [
    "DelayScan",
    "Flight",
    "Replay",
    "Score",
    "WindTunnelFlight",
    "default_filters",
    "figures",
    "replay",
    "table",
    "title",
]

FloatArray = NDArray[np.float64]

JUMP_GAIN = 10.0  # 1/s: what a jump of the measured v does to f_hat, the same for every method that filters
_RIDGE = 1e-3  # of the default model
_REPEATS = 0.02  # relative misfit below which the label holds nothing but v, q and T_sp
_SAME_RATE = 0.1
NAMES = {
    "zero": "no estimate (0)",
    "difference": "difference of v, less g",
    "lowpass": "low-pass difference of v, less g",
    "mean": "mean of the training flights",
    "model": "learned model alone",
    "phyfilter_1": "PhyFilter, n = 1",
    "type_2": "PhyFilter, n = 2, type 2",
}
_PLAIN = ("zero", "difference", "lowpass", "mean")


@dataclass(frozen=True)
class Score:
    """Errors of an estimate of f, root mean square over all samples after the start-up, m/s^2.

    Attributes
    ----------
    total : float
        Against the label, over all axes.
    axes : (float, float, float)
        The same for x, y and z.
    ahead : float
        Of the velocity predicted over the horizon with f_hat held, divided by the horizon; no label needed.
    """

    total: float
    axes: tuple[float, float, float]
    ahead: float


@dataclass(frozen=True)
class Flight:
    """One recording and its estimates.

    Attributes
    ----------
    recording : WindTunnelFlight
    estimates : dict of str to (N, 3) array
        f_hat by method, m/s^2.
    scores : dict of str to Score
    """

    recording: WindTunnelFlight
    estimates: Mapping[str, FloatArray]
    scores: Mapping[str, Score]


@dataclass(frozen=True)
class Replay:
    """All recordings, and the scores over all of them.

    Attributes
    ----------
    flights : tuple of Flight
    scores : dict of str to Score
        By method: zero, difference, lowpass; mean where there was training, model where there is one; every filter
        with f_theta = 0, and as ``"name+model"`` behind the model.
    filters : dict of str to PhyFilter or SampledPhyFilter
    model : LearnedModel, optional
    fit : FitResult, optional
        Of the training.
    train : tuple of str
        Names of the training flights.
    thrust_delay, start_up, horizon : float
        s, as given.
    """

    flights: tuple[Flight, ...]
    scores: Mapping[str, Score]
    filters: Mapping[str, PhyFilter | SampledPhyFilter]
    model: LearnedModel | None
    fit: FitResult[LearnedModel] | None
    train: tuple[str, ...]
    thrust_delay: float
    start_up: float
    horizon: float


def default_filters() -> dict[str, PhyFilter]:
    """Order 1, and order 2 of type 2, that pass a jump of v with the same gain, b_{n-1} = 10 1/s.

    Examples
    --------
    >>> {name: (F.type, F.b[-1].item()) for name, F in default_filters().items()}
    {'phyfilter_1': (1, 10.0), 'type_2': (2, 10.0)}
    """
    double = [0.25 * JUMP_GAIN**2, JUMP_GAIN]
    return {"phyfilter_1": PhyFilter([JUMP_GAIN]), "type_2": PhyFilter(double, double)}


def replay(
    paths: Sequence[Path | str],
    *,
    filters: Mapping[str, PhyFilter | SampledPhyFilter] | None = None,
    model: LearnedModel | None = None,
    train: Sequence[Path | str] = (),
    mass: float | None = None,
    thrust_delay: float = 0.0,
    start_up: float = 2.0,
    horizon: float = 0.2,
) -> Replay:
    """Estimate the residual force of recorded flights and score it.

    Parameters
    ----------
    paths : sequence of path
        CSV files with the columns t [s]; vx vy vz [m/s]; fax fay faz [N]; qx qy qz qw (body to world); T_sp and
        hover_throttle (one unit); world z up, every 50 ms or faster. Further columns are ignored.
    filters : mapping of str to PhyFilter or SampledPhyFilter, optional
        By name; None means :func:`default_filters`. A PhyFilter is sampled at the flight's interval, g="average".
    model : LearnedModel, optional
        f_theta from z = (v, R(q) e_z T) (N, 6) in m/s and m/s^2, to f (N, 3) in m/s^2. Fitted to ``train`` where that
        is given, else used as it is. None with ``train``: ``Chebyshev(1, n_d=0)``, multilinear.
    train : sequence of path
        Flights to learn from, none of them in ``paths``.
    mass : float, optional
        kg; None means the one that fits the label best, flight by flight.
    thrust_delay : float
        s by which the set-point acts later than recorded. The labels keep theirs, so their score prefers 0.
    start_up : float
        s at the beginning that no score counts.
    horizon : float
        s over which the velocity is predicted.

    Returns
    -------
    Replay

    Raises
    ------
    OSError
        If a file cannot be read.
    ValueError
        If a file lacks a column, is too short or irregular in time, holds a number that is not finite, a quaternion
        that is not of unit length, or a label that fits the assumed frames with no mass; if a flight is given twice;
        if a filter, the model or an option does not fit. File, column and row are named.
    """
    _check(thrust_delay=thrust_delay, start_up=start_up, horizon=horizon, mass=mass)
    _refuse_twice([*paths, *train])
    if not paths:
        raise ValueError("paths: expected at least one recorded flight, got none")
    filters = dict(default_filters() if filters is None else filters)
    if taken := [name for name in filters if name in (*_PLAIN, "model") or name.endswith("+model")]:
        raise ValueError(f"filters: {', '.join(map(repr, taken))} names another method; choose another name")
    shortest = start_up + max(horizon, 1.0) + 2.0
    recordings, learned_from = (
        [read(path, mass=mass, thrust_delay=thrust_delay, shortest=shortest) for path in group]
        for group in (paths, train)
    )
    fit, mean = None, None
    if learned_from:
        z, f = (np.concatenate([getattr(each, key) for each in learned_from]) for key in ("z", "label"))
        chosen: LearnedModel = Chebyshev(1, n_d=0, l2=_RIDGE) if model is None else model
        fit, mean = chosen.fit(z, f), np.mean(f, axis=0)
        model = None if fit.status is Status.FAILED else fit.model
    flights: list[Flight] = []
    for each in recordings:
        estimates = _estimates(each, filters, model, mean)
        scores = {key: _score([_errors(each, f_hat, start_up, horizon)]) for key, f_hat in estimates.items()}
        flights.append(Flight(each, estimates, scores))
    pooled = {
        key: _score([_errors(each.recording, each.estimates[key], start_up, horizon) for each in flights])
        for key in flights[0].scores
    }
    names = tuple(each.log.name for each in learned_from)
    return Replay(tuple(flights), pooled, filters, model, fit, names, thrust_delay, start_up, horizon)


def _check(*, thrust_delay: float, start_up: float, horizon: float, mass: float | None) -> None:
    for name, value in (("thrust_delay", thrust_delay), ("start_up", start_up)):
        if not (np.isfinite(value) and value >= 0.0):
            raise ValueError(f"{name}: expected 0 s or more, got {value}")
    if not (np.isfinite(horizon) and horizon > 0.0):
        raise ValueError(f"horizon: expected a positive number of seconds, got {horizon}")
    if mass is not None and not (np.isfinite(mass) and mass > 0.0):
        raise ValueError(f"mass: expected a positive number of kg, got {mass}")


def _refuse_twice(paths: Sequence[Path | str]) -> None:
    seen: set[Path] = set()
    for path in paths:
        if (resolved := Path(path).resolve()) in seen:
            raise ValueError(
                f"{path}: given twice; a test on training data says nothing, and a repeated flight counts twice"
            )
        seen.add(resolved)


def _estimates(
    recording: WindTunnelFlight,
    filters: Mapping[str, PhyFilter | SampledPhyFilter],
    model: LearnedModel | None,
    mean: FloatArray | None,
) -> dict[str, FloatArray]:
    v, g, h = recording.v, recording.g, recording.log.dt
    estimates = {
        "zero": np.zeros_like(v),
        "difference": BackwardDifference().estimate(v, h) - g,
        "lowpass": LowpassDifference(JUMP_GAIN).estimate(v, h) - g,
    }
    if mean is not None:
        estimates["mean"] = np.broadcast_to(mean, v.shape)
    theta = None
    if model is not None:
        theta = estimates["model"] = model.predict(recording.z)
        if theta.shape != v.shape:
            raise ValueError(f"model: expected f_theta of shape {v.shape} from 6 features, got {theta.shape}")
    for name, filter in filters.items():
        estimates[name] = _run(name, filter, recording, None)
        if theta is not None:
            estimates[f"{name}+model"] = _run(name, filter, recording, theta)
    return estimates


def _run(
    name: str, filter: PhyFilter | SampledPhyFilter, recording: WindTunnelFlight, f_theta: FloatArray | None
) -> FloatArray:
    log = recording.log
    sampled = filter.sampled(log.dt, g="average") if isinstance(filter, PhyFilter) else filter
    if not np.isclose(sampled.dt, log.dt, rtol=_SAME_RATE):
        raise ValueError(
            f"filter {name!r} is sampled every {sampled.dt:.6g} s, but {log.name} every {log.dt:.6g} s; give the "
            "PhyFilter itself, or sample it at that interval"
        )
    # A recorded interval differs from the nominal one in its last digits.
    times = None if np.isclose(sampled.dt, log.dt, rtol=1e-6) else log.times
    try:
        f_hat = sampled.run(recording.v, recording.g, f_theta, times=times)
    except ValueError as error:
        raise ValueError(f"filter {name!r} on {log.name}: {error}") from error
    if f_hat.shape != recording.v.shape:
        raise ValueError(f"filter {name!r}: expected f_hat of 3 channels, got {f_hat.shape[1]}")
    return np.asarray(f_hat, dtype=float)


def _errors(
    recording: WindTunnelFlight, f_hat: FloatArray, start_up: float, horizon: float
) -> tuple[FloatArray, FloatArray]:
    """f_hat - label, and the error of the prediction over the horizon per second, after the start-up."""
    h, v, g = recording.log.dt, recording.v, recording.g
    start, m = round(start_up / h), max(1, round(horizon / h))
    explained = np.vstack([np.zeros(3), np.cumsum(0.5 * h * (g[1:] + g[:-1]), axis=0)])
    rest = v - explained
    future = (rest[m:] - rest[:-m]) / (m * h)
    return (f_hat - recording.label)[start:], (f_hat[:-m] - future)[start:]


def _score(errors: Sequence[tuple[FloatArray, FloatArray]]) -> Score:
    against, ahead = (np.concatenate(parts) for parts in zip(*errors, strict=True))
    with np.errstate(over="ignore"):  # a filter that diverged scores inf
        x, y, z = np.sqrt(np.mean(against**2, axis=0)).tolist()
        return Score(float(np.sqrt(np.mean(against**2))), (x, y, z), float(np.sqrt(np.mean(ahead**2))))


def title(name: str) -> str:
    """A method in words.

    Examples
    --------
    >>> title("phyfilter_1+model")
    'PhyFilter, n = 1 + learned model'
    """
    base = name.removesuffix("+model")
    return NAMES.get(base, base) + (" + learned model" if base != name else "")


def table(replay: Replay) -> str:
    """The scores as text, and what they can and cannot say.

    Parameters
    ----------
    replay : Replay

    Returns
    -------
    str
    """
    flights, scores = replay.flights, replay.scores
    late = f", thrust taken {1e3 * replay.thrust_delay:.3g} ms late" if replay.thrust_delay else ""
    samples = sum(each.recording.log.n for each in flights)
    width = max(len(title(name)) for name in scores) + 2
    ahead = f"{replay.horizon:.3g} s ahead"
    lines = [
        f"{len(flights)} recorded flights, {samples} samples{late}; the first {replay.start_up:.3g} s do not count",
        "",
        f"{'RMSE in m/s^2':<{width}}{'x':>8}{'y':>8}{'z':>8}{'all':>8}{ahead:>14}",
    ]
    lines += [
        f"{title(name):<{width}}" + "".join(f"{e:>8.3f}" for e in (*s.axes, s.total)) + f"{s.ahead:>14.3f}"
        for name, s in scores.items()
    ]
    return "\n".join([*lines, "", *_by_flight(replay, ahead), "", *_remarks(replay)])


def _by_flight(replay: Replay, ahead: str) -> list[str]:
    """All axes and ahead, of everything but the plain methods."""
    shown = [name for name in replay.scores if name not in _PLAIN]
    width = max(len(each.recording.log.name) for each in replay.flights) + 2
    columns = {name: max(len(name), 13) + 2 for name in shown}
    head = f"{f'all / {ahead}':<{width}}" + "".join(f"{name:>{columns[name]}}" for name in shown)
    lines = [f"{head}   thrust late"]
    for each in replay.flights:
        pairs = {name: f"{each.scores[name].total:.3f} / {each.scores[name].ahead:.3f}" for name in shown}
        cells = "".join(f"{pairs[name]:>{columns[name]}}" for name in shown)
        delay = f"{1e3 * each.recording.delays.best:.0f} ms"
        lines.append(f"{each.recording.log.name:<{width}}{cells}{delay:>14}")
    return lines


def _remarks(replay: Replay) -> list[str]:
    recordings = [each.recording for each in replay.flights]
    masses, worst = [each.mass for each in recordings], max(each.misfit for each in recordings)
    scans = [1e3 * each.delays.best for each in recordings]
    gone = [100.0 * each.delays.reduction for each in recordings]
    remarks = [
        f"Mass {min(masses):.4g} to {max(masses):.4g} kg; with z up and q from body to world as x y z w, fa differs "
        f"from m (v' - g) by {100 * worst:.2g} % at most.",
        "fa repeats m (v' - g), with v' a central difference over five samples: no sensor of its own. A difference of\n"
        "v scores well against it by construction, the less filtered the better; its noise counts as truth."
        if worst < _REPEATS
        else "fa holds more than v, q and T_sp do; whether it comes from a sensor of its own cannot be seen from here.",
        "Ahead: error of the velocity predicted with f_hat held, per second. It needs no fa, and noise costs.",
        f"Thrust follows T_sp by {min(scans):.0f} to {max(scans):.0f} ms (median {np.median(scans):.0f}): a model so "
        f"late leaves {min(gone):.0f} to {max(gone):.0f} % less of\nthe specific force at {BAND[0]:g} to "
        f"{BAND[1]:g} Hz. Transport, motors and the estimator of v together, in closed loop.",
    ]
    if replay.fit is not None:
        remarks.append(
            f"Model learned from {', '.join(replay.train)}: RMSE {replay.fit.rmse:.3f} m/s^2 there; "
            f"{replay.fit.message}."
        )
    return remarks


def figures(replay: Replay) -> dict[str, object]:
    """What :func:`table` shows, for JSON; null where a filter diverged.

    Parameters
    ----------
    replay : Replay

    Returns
    -------
    dict
    """
    fit, recordings = replay.fit, [each.recording for each in replay.flights]
    training = None
    if fit is not None:
        training = {
            "flights": list(replay.train),
            "rmse": plain(fit.rmse, infinite=True),
            "status": fit.status,
        }
    return {
        "unit": "m/s^2",
        "thrust_delay": replay.thrust_delay,
        "start_up": replay.start_up,
        "horizon": replay.horizon,
        "label_repeats_difference": max(each.misfit for each in recordings) < _REPEATS,
        "scores": _as_json(replay.scores),
        "filters": {name: repr(filter) for name, filter in replay.filters.items()},
        "training": training,
        "flights": [
            {
                "name": each.log.name,
                "samples": each.log.n,
                "mass": each.mass,
                "label_misfit": each.misfit,
                "scores": _as_json(flight.scores),
                "thrust_late": {
                    "best": each.delays.best,
                    "delays": each.delays.delays.tolist(),
                    "rms": each.delays.rms.tolist(),
                },
            }
            for flight, each in zip(replay.flights, recordings, strict=True)
        ],
    }


def _as_json(scores: Mapping[str, Score]) -> dict[str, dict[str, float | str | None]]:
    return {
        name: {
            key: plain(value, infinite=True)
            for key, value in zip(keys, (s.total, *s.axes, s.ahead), strict=True)
        }
        for keys in [("total", *AXES, "ahead")]
        for name, s in scores.items()
    }
