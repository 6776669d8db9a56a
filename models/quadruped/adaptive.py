"""The adaptive rival: composite adaptation of a disturbance torque beside a contact that follows the tracking error.

After RL2AC (S. Lyu et al., Robotics: Science and Systems 2024), whose abstract and whose description in the paper are
what this is built from: the code is not public, and the policy is trained without it. Under a policy with PD drives
the contact torque is linear in the error of the joints; what is left is the disturbance, and that alone is cancelled.
Per joint, e the error of tracking what the policy wants and T a scale of torque:

    tau = Kp e - Kd q' - disturbance,    f_hat = disturbance, cut at the limit
    M q'' + d q' = tau + phi . theta,     phi = (Kp e/T, -Kd q'/T, 1),     theta = (theta_e, theta_v, disturbance)
    epsilon = C(s) (M q'' + d q' - tau) - (C phi) . theta,                C = corner/(s + corner)
    theta'  = rate (C phi) epsilon/|C phi|^2 - rate mix (Kp e - Kd q') (0, 0, 1) - leak theta

The error of the prediction drives all of theta (gradient, normalised), that of tracking the disturbance: composite
adaptation (J.-J. Slotine, W. Li, "Applied Nonlinear Control", 1991, ch. 8.8). Without the contact's part, mix and leak
the estimate is the PhyFilter of order 2 with the poles -corner and -rate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .params import Params, params
from .robot import joint_inertia

__all__ = ["AdaptiveChoice", "AdaptiveLaw", "AdaptiveState"]

FloatArray = NDArray[np.float64]

# T, N m: the size of a joint's torque in a trot.
_SCALE = 10.0


@dataclass(frozen=True)
class AdaptiveChoice:
    """Numbers of the law.

    Parameters
    ----------
    rate : float
        Of adaptation, rad/s.
    corner : float
        Of what the prediction is compared in, rad/s.
    mix : float
        Weight of the tracking error beside the prediction's.
    leak : float
        rad/s.
    limit : float
        On the torque that is cancelled, N m.
    contact : bool
        Whether the contact's part is adapted too.

    Raises
    ------
    ValueError
        For numbers that are not finite, or a rate, corner or limit that is not positive, or a negative mix or leak.
    """

    rate: float
    corner: float = 20.0
    mix: float = 0.0
    leak: float = 0.0
    limit: float = 20.0
    contact: bool = True

    def __post_init__(self) -> None:
        for name, least in (("rate", 1e-9), ("corner", 1e-9), ("limit", 1e-9), ("mix", 0.0), ("leak", 0.0)):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= least):
                raise ValueError(
                    f"{name}: expected {'0 or more' if least == 0.0 else 'a positive number'}, got {value}"
                )


class AdaptiveState(NamedTuple):
    """What the law remembers of one sample."""

    qd: FloatArray  # (..., n) last joint velocities
    residual: FloatArray  # (..., n) C(s) (M q'' + d q' - tau)
    phi: FloatArray  # (..., n, 2) C phi without the one
    theta: FloatArray  # (..., n, 3)


class AdaptiveLaw:
    """The law for the twelve joints of any number of robots.

    Parameters
    ----------
    choice : AdaptiveChoice
    parameters : Params, optional
        The robot; None: that of ``params.toml``.

    Examples
    --------
    A torque of 2 N m on joints that the drives hold still:

    >>> law = AdaptiveLaw(AdaptiveChoice(5.0, contact=False))
    >>> zero = np.zeros((1, 12))
    >>> state = law.start(zero)
    >>> for _ in range(1000):
    ...     state, f_hat = law.step(state, zero, zero - 2.0)
    >>> f_hat.round(6)[0, 0].item()
    2.0
    """

    def __init__(self, choice: AdaptiveChoice, *, parameters: Params | None = None) -> None:
        p = params() if parameters is None else parameters
        self.choice: AdaptiveChoice = choice
        self._inertia, self._damping = joint_inertia(p), p.robot.damping
        self._kd, self._h = p.control.kd, p.control.dt

    def start(self, qd: FloatArray) -> AdaptiveState:
        """State at the first sample; nothing is known.

        Parameters
        ----------
        qd : (..., 12) array
            Joint velocities, rad/s.
        """
        none = np.zeros(qd.shape)
        return AdaptiveState(qd.copy(), none, np.zeros((*qd.shape, 2)), np.zeros((*qd.shape, 3)))

    def reset(self, state: AdaptiveState, which: NDArray[np.bool_], qd: FloatArray) -> AdaptiveState:
        """Start some of the robots afresh.

        Parameters
        ----------
        state : AdaptiveState
        which : (...) bool array
        qd : (..., 12) array
            Joint velocities now.
        """
        fresh = self.start(qd)
        pairs = zip(fresh, state, strict=True)
        return AdaptiveState(
            *(
                np.where(which.reshape(*which.shape, *[1] * (old.ndim - which.ndim)), new, old)
                for new, old in pairs
            )
        )

    def step(
        self, state: AdaptiveState, qd: FloatArray, torque: FloatArray
    ) -> tuple[AdaptiveState, FloatArray]:
        """Advance by one sample.

        Parameters
        ----------
        state : AdaptiveState
        qd : (..., 12) array
            Joint velocities now, rad/s.
        torque : (..., 12) array
            What the drives were told over the step that ends now, N m.

        Returns
        -------
        state : AdaptiveState
        f_hat : (..., 12) array
            The disturbance, N m, within the limit.
        """
        c, h = self.choice, self._h
        part, gain = -np.expm1(-c.corner * h), -np.expm1(-c.rate * h)
        motion = self._inertia * (qd - state.qd) / h + 0.5 * self._damping * (qd + state.qd)
        residual = state.residual + part * (motion - torque - state.residual)
        phi, drives = state.phi, torque + state.theta[..., 2]
        if c.contact:
            damped = -self._kd * state.qd
            phi = phi + part * (np.stack([drives - damped, damped], axis=-1) / _SCALE - phi)
        full = np.concatenate([phi, np.ones((*qd.shape, 1))], axis=-1)
        epsilon = (residual - (full * state.theta).sum(axis=-1)) / np.square(full).sum(axis=-1)
        theta = state.theta * np.exp(-c.leak * h) + gain * full * epsilon[..., None]
        theta[..., 2] = np.clip(theta[..., 2] - gain * c.mix * drives, -c.limit, c.limit)
        return AdaptiveState(qd.copy(), residual, phi, theta), theta[..., 2]
