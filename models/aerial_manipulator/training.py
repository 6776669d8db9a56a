"""SEER-I for the arm: Chebyshev models of its force and torque, from hovering flights with the arm on the paper's path.

    p(t) = [0.28 + 0.1 sin(phi)/sqrt(5), 0.1 sin(phi)/sqrt(5/4), 0.105 + 0.1 cos(phi)] m, arm's base frame,

with phi' from 2.5 to 4.5 rad/s while a flight lasts. No wind, no load: nothing of what the mission adds is seen. The
models are of what an arm does along itself (see :mod:`.features`):

    force    of the arm on the platform, f_coupling, N
    torque   of the arm about its base, N m: tau_coupling less what force and weight do with the lever of the base

Which features and which degree is chosen on a flight of another motion: the arm goes between random points.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phyfilter_ctl.blocks import FunctionBlock
from phyfilter_ctl.learned import Chebyshev

from .experiment import Backend, Flights, fly
from .features import (
    HISTORY,
    SIZES,
    FeatureName,
    FeatureSet,
    features_block,
    spacing_steps,
    tip_block,
)
from .methods import Method
from .mission import Reference, arm, home_offset, reference, timepts
from .params import params
from .seer import Seer

__all__ = ["CANDIDATES", "Fit", "Training", "circling", "dataset", "off_distribution", "reaching", "train"]

FloatArray = NDArray[np.float64]

# Every so many samples go into the fit: neighbours repeat each other.
_EVERY = 5
# What flies while data are recorded: the middle of what is tried later.
_METHOD = Method("baseline", 1.8)
_KEPT = ("r_e", "q", "f_coupling", "tau_coupling", "v_m", "q_m", "omega_m", "joint_m", "joint_rate_m")
# s in which the circle grows from its middle, where the arm is at home, and which are not fitted.
_GROWS = 2.0
_CENTRE, _RADIUS = np.array([0.28, 0.0, 0.105]), 0.1
_SETS: tuple[tuple[FeatureName, ...], ...] = (
    ("place",),
    ("acc",),
    ("place", "rate"),
    ("place", "acc"),
    ("place", "felt"),
    ("place", "rate", "acc"),
    ("place", "acc", "felt"),
    ("place", "acc", "turn"),
)
# What a small computer adds up in a fraction of the 2 ms.
_MOST_TERMS = 128
_STILL = {"vehicle.wind.jet_speed": 0.0}

CANDIDATES: tuple[FeatureSet, ...] = tuple(
    FeatureSet(names, degree)
    for names in _SETS
    for degree in (1, 2)
    if (degree + 1) ** sum(SIZES[name] for name in names) <= _MOST_TERMS
)
"""Features and degrees that are tried for either model."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A candidate of one model.

    Attributes
    ----------
    features : FeatureSet
    terms : int
        Of its basis.
    train, held_out : float
        Root mean square of |error|, N or N m, on fitted flights and on the one that chooses.
    """

    features: FeatureSet
    terms: int
    train: float
    held_out: float


@dataclass(frozen=True, eq=False)
class Training:
    """Trained SEER-I models and how well they fit.

    Attributes
    ----------
    seer : Seer
    force, torque : tuple of Fit
        All candidates.
    chosen_force, chosen_torque : Fit
    label_force, label_torque : float
        Root mean square of |label| on the held-out flight, N and N m.
    message : str
    """

    seer: Seer
    force: tuple[Fit, ...]
    torque: tuple[Fit, ...]
    chosen_force: Fit
    chosen_torque: Fit
    label_force: float
    label_torque: float
    message: str


def circling(rates: tuple[float, float] | None = None, duration: float | None = None) -> Reference:
    """Hover with the arm on the paper's path.

    Parameters
    ----------
    rates : tuple of float, optional
        w in rad/s at the beginning and at the end; None means those of ``params.toml``.
    duration : float, optional
        s; None means that of ``params.toml``.
    """
    values = params().training
    first, last = values.rates if rates is None else rates
    length = values.duration if duration is None else duration
    time = timepts(length)
    omega = first + (last - first) * time / length
    phi = first * time + 0.5 * (last - first) * time**2 / length
    s = np.clip(time / _GROWS, 0.0, 1.0)
    size = _RADIUS * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    grow = _RADIUS * 30.0 * s**2 * (1.0 - s) ** 2 / _GROWS
    shape = np.array([1.0 / np.sqrt(5.0), 1.0 / np.sqrt(1.25), 0.0]), np.array([0.0, 0.0, 1.0])
    sine, cosine = np.sin(phi)[:, None], np.cos(phi)[:, None]
    around = sine * shape[0] + cosine * shape[1]
    along = omega[:, None] * (cosine * shape[0] - sine * shape[1])
    axes = arm().base_axes
    rate = grow[:, None] * around + size[:, None] * along
    return _hover(time, home_offset() + size[:, None] * around @ axes.T, rate @ axes.T)


def reaching(seed: int, duration: float | None = None) -> Reference:
    """Hover while the arm goes between random points of the planner's workspace, at rest in between.

    Parameters
    ----------
    seed : int
    duration : float, optional
        s; None means that of ``params.toml``.
    """
    values = params().training
    length = values.duration if duration is None else duration
    time = timepts(length)
    leg = 1.5 * values.move
    count = int(np.ceil(length / leg)) + 1
    low, high = (np.array(corner) for corner in params().planner.workspace)
    points = low + (high - low) * np.random.default_rng([seed, 2]).random((count, 3)) + arm().mount
    points = np.vstack([home_offset(), points])
    at = np.minimum((time / leg).astype(int), count - 1)
    s = np.clip((time - leg * at) / values.move, 0.0, 1.0)[:, None]
    way = points[at + 1] - points[at]
    rate = 30.0 * s**2 * (1.0 - s) ** 2 / values.move * way
    return _hover(time, points[at] + s**3 * (10.0 - 15.0 * s + 6.0 * s**2) * way, rate)


def _hover(time: FloatArray, offset: FloatArray, offset_rate: FloatArray) -> Reference:
    zero = np.zeros((len(time), 3))
    r = zero + np.array(params().mission.start)
    return Reference(time, r, zero, zero, zero, offset, offset_rate, np.zeros(len(time)), reference().path)


def dataset(flights: Flights) -> tuple[dict[str, FloatArray], FloatArray, FloatArray]:
    """Features by name, and force and torque as the models give them, of the samples that count."""
    links = arm()
    weight = np.array([0.0, 0.0, links.mass * params().vehicle.gravity])
    features, forces, torques = [], [], []
    for i in range(len(flights.seeds)):
        signals = {name: values[i] for name, values in flights.signals.items()}
        found, outward = _features(signals)
        features.append(found)
        force = _rotated_back(signals["q"], signals["f_coupling"])
        torque = signals["tau_coupling"] - np.cross(links.mount, force - weight)
        forces.append(_along_arm(outward, force))
        torques.append(_along_arm(outward, torque))
    begin = round(_GROWS / params().sampling.dt)
    rows = slice(begin, None, _EVERY)

    def together(parts: Sequence[FloatArray]) -> FloatArray:
        return np.concatenate([part[rows] for part in parts])

    names = list(features[0])
    return (
        {name: together([f[name] for f in features]) for name in names},
        together(forces),
        together(torques),
    )


def _features(signals: Mapping[str, FloatArray]) -> tuple[dict[str, FloatArray], FloatArray]:
    """What the diagram's blocks make of a record, by name; and the direction of the arm."""
    steps, n = spacing_steps(), len(signals["v_m"])
    ends = _outputs(tip_block(), np.hstack([signals["joint_m"], signals["joint_rate_m"]]))
    present = {"tip_v": ends["tip_v"], "omega": signals["omega_m"], "v": signals["v_m"]}
    given = [ends["tip"], ends["outward"], signals["q_m"]]
    for name in HISTORY:
        now = present[name]
        given += [np.vstack([np.repeat(now[:1], i * steps, axis=0), now[: n - i * steps]]) for i in range(4)]
    return _outputs(features_block(), np.hstack(given)), ends["outward"]


def _outputs(block: FunctionBlock, inputs: FloatArray) -> dict[str, FloatArray]:
    """Outputs of a static block by name, for inputs (N, n_u)."""
    functions, n = block.functions, len(inputs)
    p = np.tile(np.array([[entry.start] for entry in functions.parameters]).reshape(-1, 1), n)
    values = np.array(functions.output.map(n)(np.zeros((1, n)), np.zeros((0, n)), inputs.T, p)).T
    names = [entry.name.split("[")[0] for entry in functions.outputs]
    return {
        name: values[:, [i for i, other in enumerate(names) if other == name]]
        for name in dict.fromkeys(names)
    }


def _along_arm(outward: FloatArray, vectors: FloatArray) -> FloatArray:
    c, s = outward.T
    x, y, z = vectors.T
    return np.column_stack([c * x + s * y, c * y - s * x, z])


def _rotated_back(q: FloatArray, force: FloatArray) -> FloatArray:
    w, vector = q[:, :1], q[:, 1:]
    inner = np.cross(-vector, force) + w * force
    return force + 2.0 * np.cross(-vector, inner - w * force) + 2.0 * w * np.cross(-vector, force)


def columns(features: Mapping[str, FloatArray], names: Sequence[FeatureName]) -> FloatArray:
    """Chosen features side by side, (N, n_z)."""
    return np.hstack([features[name] for name in names])


@cache
def train(backend: Backend = "auto") -> Training:
    """Train SEER-I; nothing of wind or load is seen.

    Parameters
    ----------
    backend : {"auto", "vm", "c"}
        As for ``simulate``.
    """
    values = params().training
    fitted = dataset(_arm_flight(values.train, circling(), backend=backend))
    (seed,) = values.held_out
    held_out = dataset(_arm_flight((seed,), reaching(seed), backend=backend))
    z, z_held = fitted[0], held_out[0]
    force, chosen_force, force_model, one = _chosen(z, z_held, fitted[1], held_out[1])
    torque, chosen_torque, torque_model, other = _chosen(z, z_held, fitted[2], held_out[2])
    seer = Seer(force_model, torque_model, chosen_force.features, chosen_torque.features)
    labels = (_rms(held_out[1]), _rms(held_out[2]))
    return Training(
        seer, force, torque, chosen_force, chosen_torque, *labels, f"force: {one}; torque: {other}"
    )


def _chosen(
    fitted: Mapping[str, FloatArray], held_out: Mapping[str, FloatArray], labels: FloatArray, held: FloatArray
) -> tuple[tuple[Fit, ...], Fit, Chebyshev, str]:
    """All candidates, and the one with the least error on the held-out flight with its model and message."""
    fits, models = [], []
    for candidate in CANDIDATES:
        z, z_held = (columns(data, candidate.names) for data in (fitted, held_out))
        result = Chebyshev(candidate.degree, n_d=0, l2=params().training.l2).fit(z, labels)
        errors = (_rms(result.model.predict(z) - labels), _rms(result.model.predict(z_held) - held))
        fits.append(Fit(candidate, result.model.parameters.size // 3, *errors))
        models.append(result)
    best = min(range(len(fits)), key=lambda i: fits[i].held_out)
    return tuple(fits), fits[best], models[best].model, models[best].message


def off_distribution(training: Training, backend: Backend = "auto") -> dict[str, dict[str, float]]:
    """Errors of the models where they were not trained, root mean square of |error| and of |label|, N and N m.

    Parameters
    ----------
    training : Training
    backend : {"auto", "vm", "c"}
        As for ``simulate``.

    Returns
    -------
    dict
        By case: the path with other noise, the flight between points, a faster arm, a load, wind, and the mission
        itself in still air without load.
    """
    values = params().training
    held = {"vehicle.load.held": params().mission.payload}
    windy = {"vehicle.wind.jet_origin[1]": params().mission.start[1], "vehicle.wind.jet_origin[2]": 1.4}
    cases: dict[str, Flights] = {
        "path": _arm_flight(values.held_out, circling(), backend=backend),
        "points": _arm_flight(values.held_out, reaching(values.held_out[0]), backend=backend),
        "faster": _arm_flight(values.held_out, circling((5.0, 6.5)), backend=backend),
        "load": _arm_flight(values.held_out, circling(), others=held | _STILL, backend=backend),
        "wind": _arm_flight(values.held_out, circling(), others=windy, backend=backend),
        "mission": fly(
            _METHOD, values.held_out, keep=_KEPT, others=_STILL | {"vehicle.load.mass": 0.0}, backend=backend
        ),
    }
    return {name: _errors(training.seer, flights) for name, flights in cases.items()}


def _errors(seer: Seer, flights: Flights) -> dict[str, float]:
    features, force, torque = dataset(flights)
    return {
        "force": _rms(seer.force.predict(columns(features, seer.force_features.names)) - force),
        "force_label": _rms(force),
        "torque": _rms(seer.torque.predict(columns(features, seer.torque_features.names)) - torque),
        "torque_label": _rms(torque),
    }


def _arm_flight(
    seeds: Sequence[int],
    goals: Reference,
    *,
    others: Mapping[str, ArrayLike] | None = None,
    backend: Backend = "auto",
) -> Flights:
    others = _STILL if others is None else others
    return fly(_METHOD, seeds, goals=goals, keep=_KEPT, others=others, backend=backend)


def _rms(error: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))
