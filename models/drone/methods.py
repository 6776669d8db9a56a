"""The methods that fly the circle: an outer loop, and what each takes for the unknown force.

baseline         PD with feed-forward of drag, jerk and body rates
integral         the same with integral action
seer             SEER-I: Chebyshev model of the unknown mass, adapted in flight
observer         PhyFilter of order 1 without a model (f_theta = 0): the disturbance observer
indi             incremental dynamic inversion on the accelerometer
l1               L1 adaptive, piecewise-constant law
phyfilter        PhyFilter of order 1 on SEER-I (the paper's)
phyfilter_type2  PhyFilter of order 2 and type 2 on SEER-I
accelerometer    PhyFilter of order 1 on SEER-I with v' measured: the sensors of INDI
known_mass       the baseline, told the mass

All of them know the nominal mass, and their trim is its weight; the payload's is unknown to all but the last.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.blocks import SampledBlock, adaptive_block, sampled_block
from phyfilter_ctl.controllers import indi, l1_adaptive
from phyfilter_ctl.learned import AdaptiveChebyshev, Chebyshev

from .params import params

__all__ = [
    "METHODS",
    "NAMES",
    "Known",
    "Method",
    "MethodName",
    "Payload",
    "estimator",
    "filter_of",
    "seer_block",
]

MethodName = Literal[
    "baseline",
    "integral",
    "seer",
    "observer",
    "indi",
    "l1",
    "phyfilter",
    "phyfilter_type2",
    "accelerometer",
    "known_mass",
]
METHODS: tuple[MethodName, ...] = get_args(MethodName)
_ON_SEER = ("phyfilter", "phyfilter_type2", "accelerometer")
Payload = Literal["lumped", "separated", "told"]
Known = Literal["applied", "collective", "commanded"]

NAMES: dict[str, str] = {
    "baseline": "PD",
    "integral": "PD with integral action",
    "seer": "SEER-I",
    "observer": "observer (f_theta = 0)",
    "indi": "INDI",
    "l1": "L1 adaptive",
    "phyfilter": "PhyFilter, order 1",
    "phyfilter_type2": "PhyFilter, type 2",
    "accelerometer": "PhyFilter, accelerometer",
    "known_mass": "PD that knows the mass",
}


@dataclass(frozen=True)
class Method:
    """A method with its gains.

    Parameters
    ----------
    name : str
        One of ``METHODS``.
    position_bandwidth : float
        w of the outer loop in rad/s: Kp = w^2, Kd = 2 zeta w.
    bandwidth : float
        Of the estimator in rad/s; for ``integral`` the corner of the integral action (Ki = Kp times it), for ``seer``
        the speed of its adaptation in 1/s. 0 where there is none.
    seer_rate : float
        Speed of adaptation in 1/s of the SEER-I that a PhyFilter repairs.
    known : {"applied", "collective", "commanded"}
        The known force g: modelled thrust that acts, commanded collective, or commanded force.
    order : int
        Order of the PhyFilter, with equal poles.
    damping : float
        Of the outer loop.
    with_model : bool
        Whether a PhyFilter has SEER-I for its f_theta; else f_theta = 0.
    model_scale : float
        Factor on that f_theta: an error of the model.
    coefficients : ((n,) tuple, (n,) tuple), optional
        a and b of a filter in the place of the method's own, for a PhyFilter on SEER-I.
    late : int
        Samples by which the commands reach the rotors later than controller and prior know.
    payload : {"lumped", "separated", "told"}
        Of the observer: whether the payload's part of f is its f_theta, with the mass as the separation block finds it
        in flight, or as it is told.
    """

    name: MethodName
    position_bandwidth: float
    bandwidth: float = 0.0
    seer_rate: float = 0.0
    known: Known = "applied"
    order: int = 1
    damping: float = 0.9
    with_model: bool = True
    model_scale: float = 1.0
    coefficients: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    late: int = 0
    payload: Payload = "lumped"

    def __post_init__(self) -> None:
        if self.name not in METHODS:
            raise ValueError(f"method: expected one of {', '.join(METHODS)}, got {self.name!r}")
        for name in ("position_bandwidth", "damping"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise ValueError(f"{name}: expected a positive number, got {getattr(self, name)}")
        for name in ("bandwidth", "seer_rate"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) >= 0.0):
                raise ValueError(f"{name}: expected 0 or more, got {getattr(self, name)}")
        if self.coefficients is not None and self.name not in _ON_SEER:
            raise ValueError(f"coefficients: {self.name} has no PhyFilter on SEER-I to replace")
        if self.payload != "lumped" and self.name != "observer":
            raise ValueError(
                f"payload: {self.name} has a model or no filter; expected 'lumped', got {self.payload!r}"
            )
        if self.late < 0:
            raise ValueError(f"late: expected 0 samples or more, got {self.late}")

    @property
    def uses_seer(self) -> bool:
        """Whether SEER-I flies along."""
        return self.name == "seer" or (self.with_model and self.name in _ON_SEER)

    @property
    def tunable(self) -> bool:
        """Whether it has a bandwidth of its own beside the outer loop."""
        return self.name not in ("baseline", "known_mass")

    def with_bandwidth(self, bandwidth: float) -> Method:
        """The same method, faster or slower."""
        return replace(self, bandwidth=float(bandwidth))

    @property
    def structure(self) -> Method:
        """The method whose diagram this one shares: what differs are parameters of it, see :meth:`parameters`."""
        free = self.name in ("integral", "seer", "indi", "l1")
        return replace(self, position_bandwidth=1.0, bandwidth=1.0 if free else self.bandwidth, seer_rate=1.0)

    def parameters(self) -> dict[str, float]:
        """Parameters of the diagram that make it this method."""
        kp, kd, ki = self.gains
        values = {"controller.position.kp": kp, "controller.position.kd": kd, "controller.position.ki": ki}
        if self.name in ("indi", "l1"):
            values["estimator.filter.bandwidth"] = self.bandwidth
        if self.uses_seer:
            values["estimator.seer.rate"] = self.bandwidth if self.name == "seer" else self.seer_rate
        return values

    @property
    def gains(self) -> tuple[float, float, float]:
        """Kp (1/s^2), Kd (1/s), Ki (1/s^3) of the outer loop."""
        w = self.position_bandwidth
        return w**2, 2.0 * self.damping * w, (w**2 * self.bandwidth if self.name == "integral" else 0.0)


def filter_of(method: Method) -> PhyFilter | None:
    """The PhyFilter of a method, None where it has none."""
    if method.coefficients is not None:
        a, b = method.coefficients
        return PhyFilter(a, b)
    if method.name == "phyfilter_type2":
        low = PhyFilter.from_poles([-method.bandwidth] * 2)
        return PhyFilter(low.a, b=low.a)  # N = D - s^2: zeros of 1 - F at 0, twice
    if method.name in ("phyfilter", "observer", "accelerometer"):
        return PhyFilter.from_poles([-method.bandwidth] * method.order)
    return None


def estimator(method: Method) -> SampledBlock | None:
    """The block that estimates the unknown force, f_hat from x, g, f_theta (INDI: a, q, g); None where none does."""
    vehicle, dt = params().vehicle, params().sampling.dt
    filter = filter_of(method)
    if filter is not None:
        g = "hold" if method.known == "commanded" else "average"
        return sampled_block(filter.sampled(dt, g=g), 3, name="filter")
    if method.name == "indi":
        return indi(
            mass=vehicle.mass,
            gravity=vehicle.gravity,
            bandwidth=method.bandwidth,
            damping=np.sqrt(0.5),
            dt=dt,
            name="filter",
        )
    if method.name == "l1":
        return l1_adaptive(
            dt=dt, pole=params().l1.pole, bandwidth=method.bandwidth, g="average", name="filter"
        )
    return None


def seer_block(method: Method, model: Chebyshev) -> SampledBlock:
    """SEER-I with its adaptive law as a block."""
    rate = method.bandwidth if method.name == "seer" else method.seer_rate
    law = AdaptiveChebyshev(
        model, params().sampling.dt, rate=rate, bandwidth=params().seer.prediction, g="average"
    )
    return adaptive_block(law, name="seer")
