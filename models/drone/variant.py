"""Closed loops that the comparison does not fly: a filter of any coefficients, and a delay that nobody was told."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import control as ct
import numpy as np
from numpy.typing import ArrayLike

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.analysis import frequency_response
from phyfilter_ctl.blocks import delay_line, sampled_block, wired
from phyfilter_ctl.diagram import FlatModel, flatten
from phyfilter_ctl.learned import Chebyshev
from phyfilter_ctl.simulation import BackendChoice, sampled_open_loop, simulate_batch

from .diagram import MEASURED, NOISES, build, controller_part, filter_part, momentum, nothing, vehicle_part
from .experiment import Flights, Score, fly, start_state
from .flights import Conditions, noise, timepts
from .methods import Method
from .params import params
from .reference import check_feasible
from .tuning import modulus_margin

__all__ = ["Variant", "flown", "loop", "margin"]

# As in the tuning, whose margin this is where nothing is varied.
_OMEGA = np.geomspace(0.05, 1500.0, 300)
_SETTLE = 4.0
_ROUND_OFF = 1e-7
_AXES = range(3)


@dataclass(frozen=True)
class Variant:
    """A method, and what of its loop is another.

    Parameters
    ----------
    method : Method
    coefficients : ((n,) tuple, (n,) tuple), optional
        a and b of a filter in the place of the method's own, for a PhyFilter on SEER-I.
    late : int
        Samples by which the commands reach the rotors later than controller and prior know.
    """

    method: Method
    coefficients: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    late: int = 0

    def __post_init__(self) -> None:
        if self.coefficients is not None and self.method.name not in ("phyfilter", "phyfilter_type2"):
            raise ValueError(f"coefficients: {self.method.name} has no PhyFilter on SEER-I to replace")
        if self.late < 0:
            raise ValueError(f"late: expected 0 samples or more, got {self.late}")

    @property
    def is_plain(self) -> bool:
        """Whether it is the method as the comparison flies it."""
        return self.coefficients is None and self.late == 0

    @property
    def structure(self) -> Variant:
        """The variant whose diagram this one shares."""
        return replace(self, method=self.method.structure)


def loop(variant: Variant, model: Chebyshev | None = None) -> ct.InterconnectedSystem:
    """The whole closed loop of a variant, with the parameters' names of :func:`build`.

    Parameters
    ----------
    variant : Variant
    model : Chebyshev, optional
        SEER-I's model, for the methods that use it.

    Returns
    -------
    control.InterconnectedSystem
        Inputs as those of :func:`build`, outputs r and r_ref.

    Examples
    --------
    >>> late = loop(Variant(Method("observer", 2.0, 6.0), late=3))
    >>> late.ninputs, late.output_labels[::3]
    (18, ['r[0]', 'r_ref[0]'])
    """
    method = variant.method
    if variant.is_plain:
        return build(method, model)
    own = variant.coefficients is not None
    estimator = filter_part(replace(method, name="seer") if own else method, model)
    systems: list[ct.InputOutputSystem] = [vehicle_part(), controller_part(method)]
    wires = {f"controller.{name}": f"vehicle.{name}" for name in MEASURED if name != "a_m"}
    wires["vehicle.thrust"], f_hat = "controller.thrust", "estimator.f_hat"
    if variant.late:
        systems.append(_lateness(variant.late))
        wires |= {"late.thrust": "controller.thrust", "vehicle.thrust": "late.thrust_delayed"}
    if estimator is None:
        systems.append(nothing("no_estimate"))
        f_hat = "no_estimate.zero"
    else:
        systems.append(estimator)
        known = {label.split("[")[0] for label in estimator.input_labels}
        wires |= {f"estimator.{name}": f"vehicle.{name}" for name in MEASURED if name in known}
        wires |= {f"estimator.{name}": f"controller.{name}" for name in ("F", "thrust")}
    if variant.coefficients is not None:
        a, b = variant.coefficients
        rule = "hold" if method.known == "commanded" else "average"
        sampled = PhyFilter(a, b).sampled(params().sampling.dt, g=rule)
        systems += [momentum(), sampled_block(sampled, 3, name="filter")]
        wires |= {"momentum.v": "vehicle.v_m", "filter.x": "momentum.x", "filter.g": "estimator.g"}
        wires["filter.f_theta"], f_hat = "estimator.f_theta", "filter.f_hat"
    return wired(
        systems,
        wires | {"controller.f_hat": f_hat},
        inputs={name: f"vehicle.{name}" for name in NOISES},
        outputs={"r": "vehicle.r", "r_ref": "controller.r_ref"},
        name="drone",
    )


def _lateness(steps: int) -> ct.InputOutputSystem:
    vehicle = params().vehicle
    labels = [f"thrust[{i}]" for i in range(4)]
    hover = 0.25 * vehicle.mass * vehicle.gravity
    return delay_line(labels, steps, params().sampling.dt, name="late", start=hover, unit="N")


@lru_cache(maxsize=32)
def _flat(structure: Variant, model: Chebyshev | None) -> FlatModel:
    return flatten(loop(structure, model))


def flown(
    variant: Variant,
    conditions: Conditions,
    model: Chebyshev | None = None,
    *,
    duration: float | None = None,
    others: Mapping[str, ArrayLike] | None = None,
    backend: BackendChoice = "auto",
    workers: int | None = None,
) -> Score:
    """Tracking errors of a variant; arguments as for :func:`phyfilter_ctl.models.drone.experiment.fly`.

    Parameters
    ----------
    variant : Variant
    conditions, model, duration, others, backend, workers
        As for ``fly``.
    """
    if variant.is_plain:
        return fly(
            variant.method,
            conditions,
            model,
            duration=duration,
            others=others,
            backend=backend,
            workers=workers,
        ).score()
    mission, others = params().mission, dict(others or {})
    speed = float(np.max(others.get("controller.reference.speed", mission.speed)))
    check_feasible(speed, mission.radius, params().vehicle.mass + float(conditions.added_mass.max()))
    time = timepts(duration)
    runs = simulate_batch(
        _flat(variant.structure, model),
        time,
        noise(conditions.seeds, len(time)),
        start_state(),
        params={**conditions.parameters(), **variant.method.parameters(), **others},
        method="rk4",
        max_step=params().sampling.max_step,
        interpolation="hold",
        backend=backend,
        workers=workers,
    )
    places = np.array([np.asarray(run.outputs).T for run in runs])
    signals = {"r": places[:, :, :3], "r_ref": places[:, :, 3:]}
    return Flights(variant.method, conditions, time, signals, "").score()


def margin(variant: Variant, model: Chebyshev | None = None) -> float:
    """Modulus margin of a variant, as :func:`phyfilter_ctl.models.drone.tuning.modulus_margin` takes it of a method.

    Parameters
    ----------
    variant : Variant
    model : Chebyshev, optional
        SEER-I's model, for the methods that use it.
    """
    if variant.is_plain:
        return modulus_margin(variant.method, model)
    system = loop(variant.structure, model)
    slow = params().tuning.lag_factor * params().vehicle.motor_lag
    return min(
        _least_distance(system, channel, variant.method.parameters()
                        | {"vehicle.quadrotor.added_mass": mass, "vehicle.quadrotor.motor_lag": slow})
        for channel in ("F[0]", "F[2]")
        for mass in (0.0, params().mass.high)
    )  # fmt: skip


def _least_distance(system: ct.InterconnectedSystem, channel: str, settings: Mapping[str, float]) -> float:
    """Of the loop gain from -1, 0 where the loop is unstable."""
    L = sampled_open_loop(
        system,
        f"controller.position.{channel}",
        start_state(),
        settle=_SETTLE,
        params={**settings, "controller.reference.speed": 1e-9},
    )
    A, B, C, D = (np.asarray(part) for part in (L.A, L.B, L.C, L.D))
    if np.abs(np.linalg.eigvals(A - B @ C / (1.0 + D[0, 0]))).max() > 1.0 + _ROUND_OFF:
        return 0.0
    return float(np.abs(1.0 + np.asarray(frequency_response(L, _OMEGA).frdata).reshape(-1)).min())
