"""The methods that fly the mission: an outer loop, and what each takes for the unknown force and torque.

baseline    PD with the arm's weight at home fed forward
integral    the same with integral action
seer        SEER-I: Chebyshev models of the arm's force and torque
observer    PhyFilters of order 1 without models (f_theta = 0): disturbance observers of force and torque
phyfilter   PhyFilters of order 1 on SEER-I (the paper's)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, get_args

import numpy as np

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.controllers import AttitudeGains

from .params import params
from .vehicle import nominal

__all__ = ["METHODS", "NAMES", "Method", "MethodName"]

MethodName = Literal["baseline", "integral", "seer", "observer", "phyfilter"]
METHODS: tuple[MethodName, ...] = get_args(MethodName)

NAMES: dict[MethodName, str] = {
    "baseline": "PD",
    "integral": "PD with integral action",
    "seer": "SEER-I",
    "observer": "observer (f_theta = 0)",
    "phyfilter": "PhyFilter",
}


@dataclass(frozen=True)
class Method:
    """A method with its gains.

    Parameters
    ----------
    name : str
        One of ``METHODS``.
    position_bandwidth : float
        w of the outer loop in rad/s, horizontally: Kp = w^2, Kd = 2 zeta w.
    bandwidth : float
        Of the force's filter in rad/s; for ``integral`` the corner of the integral action (Ki = Kp times it).
    torque_bandwidth : float
        Of the torque's filter in rad/s.
    attitude_margin : float
        Modulus margin that the attitude loop alone is designed for.
    vertical_bandwidth : float
        w of the outer loop vertically; 0 means as horizontally.
    damping : float
        Of the outer loop.
    """

    name: MethodName
    position_bandwidth: float
    bandwidth: float = 0.0
    torque_bandwidth: float = 0.0
    attitude_margin: float = 0.6
    vertical_bandwidth: float = 0.0
    damping: float = 0.9

    def __post_init__(self) -> None:
        if self.name not in METHODS:
            raise ValueError(f"method: expected one of {', '.join(METHODS)}, got {self.name!r}")
        positive = ["position_bandwidth", "damping"]
        positive += ["bandwidth"] * (self.filters or self.name == "integral")
        positive += ["torque_bandwidth"] * self.filters
        for name in positive:
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise ValueError(f"{name}: expected a positive number, got {getattr(self, name)}")

    @property
    def filters(self) -> bool:
        """Whether it has filters of force and torque."""
        return self.name in ("observer", "phyfilter")

    @property
    def uses_seer(self) -> bool:
        """Whether SEER-I flies along."""
        return self.name in ("seer", "phyfilter")

    @property
    def structure(self) -> Method:
        """The method whose diagram this one shares: what differs are parameters of it, see :meth:`parameters`."""
        free = {} if self.filters else {"bandwidth": 1.0}
        return replace(self, position_bandwidth=1.0, vertical_bandwidth=0.0, attitude_margin=0.6, **free)

    @property
    def gains(self) -> dict[str, tuple[float, float]]:
        """Kp (1/s^2), Kd (1/s), Ki (1/s^3) of the outer loop, horizontally and vertically."""
        both = (self.position_bandwidth, self.vertical_bandwidth or self.position_bandwidth)
        corner = self.bandwidth if self.name == "integral" else 0.0
        return {
            "kp": (both[0] ** 2, both[1] ** 2),
            "kd": (2.0 * self.damping * both[0], 2.0 * self.damping * both[1]),
            "ki": (both[0] ** 2 * corner, both[1] ** 2 * corner),
        }

    @property
    def attitude(self) -> AttitudeGains:
        """Gains of the attitude loop."""
        return _attitude(self.attitude_margin)

    def parameters(self) -> dict[str, float]:
        """Parameters of the diagram that make it this method."""
        attitude = self.attitude
        return {
            **{
                f"controller.position.{name}[{i}]": gain
                for name, pair in self.gains.items()
                for i, gain in enumerate(pair)
            },
            "controller.position.drag_lead": attitude.kw[0] / attitude.kR[0],
            **{f"controller.attitude.kR[{i}]": gain for i, gain in enumerate(attitude.kR)},
            **{f"controller.attitude.kw[{i}]": gain for i, gain in enumerate(attitude.kw)},
        }

    def force_filter(self) -> PhyFilter:
        """The filter of the force."""
        return PhyFilter.from_poles([-self.bandwidth])

    def torque_filter(self) -> PhyFilter:
        """The filter of the torque."""
        return PhyFilter.from_poles([-self.torque_bandwidth])


@lru_cache(maxsize=128)
def _attitude(margin: float) -> AttitudeGains:
    return nominal().gains(params().sampling.dt, sharpness=params().tuning.sharpness, modulus_margin=margin)
