"""The filter of joint torques, for any number of robots at once.

Per joint, with the residual of each step measured in the inertia form (M is never inverted, q'' never formed):

    u_k = M (q'_k - q'_{k-1}) / h - mean of g over the step
    w_k = w_{k-1} + dA (w_{k-1} - equilibrium u_k),    f_hat_k = C w_k             (as in :mod:`phyfilter_ctl.filter`)

The learned part f_theta is zero here: the paper does not define one for the legs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..filter import SampledPhyFilter, Sampling, StepConstants
from ..filter.recursion import applied, increment, mean, momentum, output, residual
from ..plants.legged import JointQuantities, JointSpacePrior

__all__ = [
    "AntiWindup",
    "Gate",
    "JointFilterState",
    "JointTorqueFilter",
]

FloatArray = NDArray[np.floating]
AntiWindup = Literal["none", "clamp", "back_calculation", "residual"]
Gate = Literal["scale", "hold"]


class JointFilterState(NamedTuple):
    """What the filter remembers of one sample. Immutable; made by ``start``, advanced by ``step``."""

    w: FloatArray  # (..., n, order) states of the sections
    qd: FloatArray  # (..., n) last joint velocities
    inertia: FloatArray | None  # last inertia; None before the first step
    known: FloatArray | None  # (..., n) last known torque without the motors'


@dataclass(frozen=True, eq=False)
class JointTorqueFilter:
    """Estimates the residual torque f of M q'' = g + f, vectorised over robots and joints.

    Parameters
    ----------
    sampled : SampledPhyFilter
        One filter for all joints, or one per joint (of one order). Order and b are free: a band-pass filter (b_0 = 0)
        forgets constant torques, a contact torque that was left out of g among them. ``limit`` bounds |f_hat| in N m.
        ``g`` says which M, bias and contact act over a step. "average": the mean of those given at both its ends
        (second order for a continuous plant). "hold": those given with the step act over all of it; exact with a
        simulator's own, read after its step, where it advances q' by forward Euler, as MuJoCo does. The motors' torque
        is held anyway.
    prior : JointSpacePrior
        What M and g consist of.
    anti_windup : {"clamp", "back_calculation", "residual", "none"}
        What the limit does to the states; f_hat itself is limited in any case. "clamp": the state of every section is
        brought back to the limit at once, so that nothing winds up beyond it; order 1: w = clip(w). "back_calculation":
        the same, but with time constant ``tracking_time``. "residual": u itself is limited, so that one impact counts
        no more than the limit does. "none": the states are left alone.
    gate : {"scale", "hold"}
        What a gate below 1 given to ``step`` does: "scale" multiplies u (at 0 f_hat dies out), "hold" multiplies the
        change of the states (at 0 f_hat stays).
    leak : float
        Extra decay of the states in rad/s: f_hat forgets.
    tracking_time : float
        Seconds, for "back_calculation".

    Raises
    ------
    ValueError
        For options out of range, filters of several orders, or a sampled filter with E, a delay, float32 or
        ``nonfinite="hold"``.

    Examples
    --------
    A wheel of 0.1 kg m^2 on which 2 N m act that nobody told the filter:

    >>> from phyfilter_ctl import PhyFilter
    >>> prior = JointSpacePrior(inertia="constant", bias="none", contact="omitted", constant_inertia=0.1)
    >>> wheels = JointTorqueFilter(PhyFilter([5.0]).sampled(0.01, g="average", limit=20.0), prior)
    >>> state = wheels.start(np.zeros((3, 1)))
    >>> for k in range(1, 101):
    ...     qd = np.full((3, 1), 2.0 / 0.1 * 0.01 * k)
    ...     state, f_hat = wheels.step(state, qd, JointQuantities(qd), np.zeros((3, 1)))
    >>> (f_hat / (1.0 - np.exp(-5.0))).round(12).ravel().tolist()
    [2.0, 2.0, 2.0]
    """

    sampled: SampledPhyFilter
    prior: JointSpacePrior
    anti_windup: AntiWindup = "clamp"
    gate: Gate = "scale"
    leak: float = 0.0
    tracking_time: float = 0.1

    def __post_init__(self) -> None:
        for name, kind in (("sampled", SampledPhyFilter), ("prior", JointSpacePrior)):
            if not isinstance(value := getattr(self, name), kind):
                raise TypeError(f"{name}: expected a {kind.__name__}, got {type(value).__name__}")
        for name, choices in (("anti_windup", AntiWindup), ("gate", Gate)):
            if getattr(self, name) not in get_args(choices):
                expected = ", ".join(get_args(choices))
                raise ValueError(f"{name}: expected one of {expected}, got {getattr(self, name)!r}")
        for name, value, least in (("leak", self.leak, 0.0), ("tracking_time", self.tracking_time, 1e-9)):
            if not (np.isfinite(value) and value >= least):
                raise ValueError(
                    f"{name}: expected {'0 or more' if least == 0.0 else 'a positive time'}, got {value}"
                )
        other = self._sampling.unusual.keys() & {"delay", "precision", "nonfinite", "g_limit"}
        if other or self.sampled.E is not None:
            raise ValueError(f"sampled: expected none of {', '.join(sorted(other)) or 'E'}; leave it out")
        orders = [entry.order for entry in self.sampled.filters]
        if len(set(orders)) > 1:
            raise ValueError(f"filters of orders {orders}: expected one order for all joints")

    @property
    def _sampling(self) -> Sampling:
        return self.sampled.sampling

    @cached_property
    def _constants(self) -> StepConstants:
        dA, equilibrium, C = self.sampled.recursion.bank
        h = self.sampled.dt
        if self.leak:
            # I + dA becomes e^{-leak h} (I + dA), the input matrix -dA equilibrium stays.
            drive = dA @ equilibrium[..., None]
            dA = dA * np.exp(-self.leak * h) + np.expm1(-self.leak * h) * np.eye(dA.shape[-1])
            equilibrium = np.linalg.solve(dA, drive)[..., 0]
        if len(dA) == 1:
            return StepConstants(np.ascontiguousarray(dA[0].T), equilibrium[0], C[0], np.float64(1.0 / h))
        return StepConstants(dA, equilibrium, C, np.float64(1.0 / h))

    @cached_property
    def _norms(self) -> FloatArray:
        """As ``_constants.dA``: takes the squares of the states to the squared size of their section."""
        norms = np.stack([_section_norms(entry.sections[0]) for entry in self.sampled.filters])
        return norms[0] if len(norms) == 1 else np.swapaxes(norms, -1, -2)

    def start(self, qd: ArrayLike, quantities: JointQuantities | None = None) -> JointFilterState:
        """State at the first sample; f_hat starts at 0.

        Parameters
        ----------
        qd : (..., n) array
            Joint velocities in rad/s, of one robot or of many.
        quantities : JointQuantities, optional
            At the first sample. None: the first step takes its own for both of its ends.

        Returns
        -------
        JointFilterState

        Raises
        ------
        ValueError
            For a wrong shape or numbers that are not finite.
        """
        velocity = np.array(qd, dtype=float)
        if velocity.ndim < 1 or velocity.shape[-1] == 0:
            raise ValueError(f"qd: expected shape (..., n) with n joints, got {velocity.shape}")
        self.sampled.recursion.channels(velocity.shape[-1])
        if not np.isfinite(velocity).all():
            raise ValueError("qd: expected finite joint velocities")
        inertia = known = None
        if quantities is not None:
            inertia, known = self._model(quantities, velocity.shape)
        return JointFilterState(np.zeros((*velocity.shape, self.sampled.order)), velocity, inertia, known)

    def step(
        self,
        state: JointFilterState,
        qd: ArrayLike,
        quantities: JointQuantities,
        torque: ArrayLike,
        *,
        gate: ArrayLike | None = None,
    ) -> tuple[JointFilterState, FloatArray]:
        """Advance by one sample. Pure: the state given is not changed.

        Parameters
        ----------
        state : JointFilterState
        qd : (..., n) array
            Joint velocities now.
        quantities : JointQuantities
            At this sample; ``g="hold"``: over the step that ends now.
        torque : (..., n) array
            Motor torques over the step that ends now, that is the command of the sample before: the command of this
            sample may use the f_hat returned here.
        gate : array that broadcasts to (..., n), optional
            In [0, 1], per joint: a foot in the air, say. None means 1.

        Returns
        -------
        state : JointFilterState
        f_hat : (..., n) array
            In N m, within the limit.

        Raises
        ------
        ValueError
            For wrong shapes, numbers that are not finite (the first robot is named), a gate outside [0, 1], or an
            inertia that is not positive definite.
        """
        velocity = np.array(qd, dtype=float)
        tau = np.asarray(torque, dtype=float)
        if velocity.shape != state.qd.shape or tau.shape != velocity.shape:
            raise ValueError(
                f"expected qd and torque of shape {state.qd.shape}, as at the start; got {velocity.shape} and "
                f"{tau.shape}"
            )
        inertia, known = self._model(quantities, velocity.shape)
        M, g = inertia, known
        if self._sampling.g == "average" and state.inertia is not None and state.known is not None:
            M, g = mean("average", state.inertia, M), mean("average", state.known, g)
        u = residual(momentum(M, velocity - state.qd) / self.sampled.dt, g, tau, None)
        if not np.isfinite(u).all():
            _refuse(u)
        share = None if gate is None else _gate(gate, velocity.shape)
        w = self._advance(state.w, u, share)
        f_hat = self.sampled.recursion.limited(output(w, None, self._constants.C))
        return JointFilterState(w, velocity, inertia, known), f_hat

    def reset(
        self,
        state: JointFilterState,
        which: ArrayLike,
        qd: ArrayLike,
        quantities: JointQuantities | None = None,
    ) -> JointFilterState:
        """Start some of the robots afresh, after a fall say.

        Parameters
        ----------
        state : JointFilterState
        which : (...) bool array
            The robots, without the axis of the joints.
        qd : (..., n) array
            Joint velocities now; only those of the chosen robots are used.
        quantities : JointQuantities, optional
            Now; None keeps those before the reset, which ``g="average"`` then takes into the next step.

        Returns
        -------
        JointFilterState
            f_hat of the chosen robots starts at 0; all others go on.

        Raises
        ------
        ValueError
            For wrong shapes.
        """
        chosen, velocity = np.asarray(which, dtype=bool), np.asarray(qd, dtype=float)
        if chosen.shape != state.qd.shape[:-1] or velocity.shape != state.qd.shape:
            raise ValueError(
                f"expected which of shape {state.qd.shape[:-1]} and qd of shape {state.qd.shape}, got {chosen.shape} "
                f"and {velocity.shape}"
            )
        w = np.where(chosen[..., None, None], 0.0, state.w)
        state = state._replace(w=w, qd=np.where(chosen[..., None], velocity, state.qd))
        if quantities is None or state.inertia is None or state.known is None:
            return state
        inertia, known = self._model(quantities, velocity.shape)
        if self.prior.constant_inertia is None:
            axes = (..., None, None) if inertia.ndim > velocity.ndim else (..., None)
            inertia = np.where(chosen[axes], inertia, state.inertia)
        return state._replace(inertia=inertia, known=np.where(chosen[..., None], known, state.known))

    def _model(self, quantities: JointQuantities, shape: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
        """Inertia and the known torque without the motors'."""
        if quantities.qd.shape != shape:
            raise ValueError(f"quantities: qd of shape {quantities.qd.shape}, expected {shape}")
        known = self.prior.known_torque(quantities, 0.0)
        if known.shape != shape:
            raise ValueError(f"quantities: known torque of shape {known.shape}, expected {shape}")
        inertia = self.prior.inertia_matrix(quantities)
        full = self.prior.constant_inertia is not None and inertia.ndim == 2
        return np.broadcast_to(inertia, (*shape, shape[-1])) if full else inertia, known

    def _advance(self, w: FloatArray, u: FloatArray, share: FloatArray | None) -> FloatArray:
        limit = self._sampling.limit
        if self.anti_windup == "residual":
            u = self.sampled.recursion.limited(u)
        if share is not None and self.gate == "scale":
            u = u * share
        change = increment(w, u, self._constants)
        if share is not None and self.gate == "hold":
            change = change * share[..., None]
        w = w + change
        if limit is not None and self.anti_windup in ("clamp", "back_calculation"):
            size = np.sqrt(applied(self._norms, w * w))
            part = 1.0 if self.anti_windup == "clamp" else -np.expm1(-self.sampled.dt / self.tracking_time)
            w *= 1.0 - part * (1.0 - limit[..., None] / np.maximum(size, limit[..., None]))
        return w


def _section_norms(A: FloatArray) -> FloatArray:
    """Matrix (n, n) that takes the squares of the states to the squared size of their section, for each state.

    A real section has |w|. A pair has sqrt(w1^2 + (omega/r)^2 w2^2), which shrinks as e^{sigma t} on its own and is 1
    at rest on a residual 1. Bringing a state back to a ball of that norm cannot make two solutions diverge.
    """
    n = len(A)
    norms = np.eye(n)
    for i in range(n - 1):
        if A[i, i + 1] != 0.0:
            weight = -A[i, i + 1] / A[i + 1, i]
            norms[i : i + 2, i : i + 2] = [[1.0, 1.0], [weight, weight]]
    return norms


def _gate(gate: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    share = np.asarray(gate, dtype=float)
    if not np.all((share >= 0.0) & (share <= 1.0)):
        raise ValueError("gate: expected numbers in [0, 1]")
    try:
        return np.broadcast_to(share, shape)
    except ValueError:
        raise ValueError(f"gate: shape {share.shape} does not broadcast to {shape}") from None


def _refuse(u: FloatArray) -> None:
    where = np.argwhere(~np.isfinite(u))[0]
    robot = "" if u.ndim == 1 else f" of robot {tuple(where[:-1].tolist())}"
    raise ValueError(
        f"the residual of joint {where[-1]}{robot} is not finite: check qd, torque and the quantities; the state is "
        "unchanged; reset that robot"
    )
