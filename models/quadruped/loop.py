"""The joint loop at 200 Hz: PD, and the filter, or an adaptive rival, that corrects its target.

    tau = Kp (q_d - f_hat/Kp - q) - Kd q',   cut at the motors' limits;   M q'' = -d q' + tau + f,   f_hat = F(s) f

M is constant and diagonal. g is tau - d q', and J' F_c where the filter is told of the forces on the feet, as in the
paper; left out, f_hat carries the load of the legs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl.controllers import JointFilterState, JointTorqueFilter
from phyfilter_ctl.controllers.joint_torque import AntiWindup, Gate
from phyfilter_ctl.filter import PhyFilter
from phyfilter_ctl.plants import JointQuantities, JointSpacePrior
from phyfilter_ctl.plants.legged import Contact

from .adaptive import AdaptiveChoice, AdaptiveLaw, AdaptiveState
from .batch import Batch
from .contact import carried
from .gait import sent
from .params import Params, params
from .robot import joint_inertia

__all__ = ["FilterChoice", "JointLoop", "advance", "make_filter", "paper_filter"]

FloatArray = NDArray[np.float64]
GateSource = Literal["none", "contact", "tilt"]


@dataclass(frozen=True)
class FilterChoice:
    """A filter of the joint torques.

    Parameters
    ----------
    a : tuple of float
        Coefficients, ascending.
    b : tuple of float, optional
        Of the numerator; None: the low-pass form.
    limit : float
        On |f_hat|, N m.
    anti_windup : {"clamp", "back_calculation", "residual", "none"}
    gate : {"none", "contact", "tilt"}
        What opens it: nothing, the load of each foot, or an upright and calm trunk.
    gate_action : {"scale", "hold"}
        What a closed gate does to f_hat: it dies out, or stays.
    leak : float
        rad/s.
    gain : float
        Part of f_hat that is used.
    fade : (float, float)
        Seconds in which the gate "tilt" takes f_hat from the motors when it closes, and gives it back when it opens;
        (0, 0): it acts on the estimate alone.
    contact : {"omitted", "known", "estimated"}
        J' F_c in g: none, the simulator's, or what the robot can know of it (``contact.carried``).

    Raises
    ------
    ValueError
        For times that are not both positive, a fade without that gate, or an unknown contact.
    """

    a: tuple[float, ...]
    b: tuple[float, ...] | None = None
    limit: float = 20.0
    anti_windup: AntiWindup = "clamp"
    gate: GateSource = "none"
    gate_action: Gate = "hold"
    leak: float = 0.0
    gain: float = 1.0
    fade: tuple[float, float] = (0.0, 0.0)
    contact: Contact = "omitted"

    def __post_init__(self) -> None:
        if self.contact not in get_args(Contact):
            expected = ", ".join(get_args(Contact))
            raise ValueError(f"contact: expected one of {expected}, got {self.contact!r}")
        if self.fade != (0.0, 0.0) and (self.gate != "tilt" or not min(self.fade) > 0.0):
            raise ValueError(
                f"fade: expected two positive times and the gate 'tilt', got {self.fade}, {self.gate!r}"
            )

    @staticmethod
    def of(record: Mapping[str, Any]) -> FilterChoice:
        """As a training record has it.

        Parameters
        ----------
        record : mapping

        Raises
        ------
        ValueError
            For unknown or missing entries.
        """
        try:
            values: dict[str, Any] = {n: tuple(v) if isinstance(v, list) else v for n, v in record.items()}
            return FilterChoice(**values)
        except TypeError as error:
            raise ValueError(f"record of a filter: {error}") from None


def paper_filter(contact: Contact = "omitted") -> FilterChoice:
    """Order 1 with the paper's a0.

    Parameters
    ----------
    contact : {"omitted", "known", "estimated"}
        The paper's g has it.

    Examples
    --------
    >>> paper_filter().a
    (1.0,)
    """
    numbers = params().filter
    return FilterChoice((numbers.a0,), limit=numbers.limit, contact=contact)


def make_filter(choice: FilterChoice, *, parameters: Params | None = None) -> JointTorqueFilter:
    """The filter of twelve joints.

    Parameters
    ----------
    choice : FilterChoice
    parameters : Params, optional
    """
    p = params() if parameters is None else parameters
    prior = JointSpacePrior(
        inertia="constant",
        bias="damping",
        contact=choice.contact,
        constant_inertia=joint_inertia(p),
        damping=p.robot.damping,
    )
    # The forces on the feet are those of the step that ends.
    g: Literal["average", "hold"] = "average" if choice.contact == "omitted" else "hold"
    return JointTorqueFilter(
        PhyFilter(choice.a, choice.b).sampled(p.control.dt, g=g, limit=choice.limit),
        prior,
        anti_windup=choice.anti_windup,
        gate=choice.gate_action,
        leak=choice.leak,
    )


# A foot carries when it is loaded with more than this, N; a trunk is calm below this rate of roll and pitch, rad/s, and
# this tilt.
_CARRIES = 5.0
_CALM_RATE, _CALM_TILT = 1.5, 0.15
# Arrays that the next step depends on, besides the filter's state.
_KEPT = ("kp", "kd", "strength", "torque", "f_hat", "share", "under_way")


class JointLoop:
    """PD and filter around a batch of robots, or around some of them.

    Parameters
    ----------
    batch : Batch
    choice : FilterChoice or AdaptiveChoice, optional
        The filter, or the adaptive rival; None: PD alone.
    rows : slice
        Which robots; all by default.
    rng : numpy.random.Generator, optional
        Of the encoders' noise; None: one of its own.
    """

    def __init__(
        self,
        batch: Batch,
        choice: FilterChoice | AdaptiveChoice | None = None,
        *,
        rows: slice = slice(None),
        rng: np.random.Generator | None = None,
    ) -> None:
        p = batch.parameters
        self._control = p.control
        self._rng = np.random.default_rng(0) if rng is None else rng
        self.batch: Batch = batch
        self.choice: FilterChoice | AdaptiveChoice | None = choice
        self.rows: slice = rows
        self.filter: JointTorqueFilter | None = None
        self.rival: AdaptiveLaw | None = None
        if isinstance(choice, FilterChoice):
            self.filter = make_filter(choice, parameters=p)
        elif choice is not None:
            self.rival = AdaptiveLaw(choice, parameters=p)
        size = len(range(*rows.indices(batch.size)))
        self.kp: FloatArray = np.full((size, 1), p.control.kp)
        self.kd: FloatArray = np.full((size, 1), p.control.kd)
        self.strength: FloatArray = np.ones((size, 1))
        # What the correction of the target is made with: the gain as it is known.
        self.nominal: float = p.control.kp
        self._limits = np.tile(p.robot.torque_limits, 4)
        self._fastest = np.tile(p.robot.speed_limits, 4)
        # Targets on their way to the drives, the oldest first; nan: none was sent yet.
        self.under_way: FloatArray = np.full((p.control.delay, size, 12), np.nan)
        self.torque: FloatArray = np.zeros((size, 12))
        self.f_hat: FloatArray = np.zeros((size, 12))
        # Part of f_hat that the gate leaves to the motors.
        self.share: FloatArray = np.ones((size, 1))
        self._state: JointFilterState | None = None
        self._adapted: AdaptiveState | None = None
        self.restart(np.ones(size, dtype=bool))

    def restart(self, which: NDArray[np.bool_]) -> None:
        """Forget what was estimated, after a reset.

        Parameters
        ----------
        which : (E,) bool array
        """
        self.torque[which] = 0.0
        self.f_hat[which] = 0.0
        self.share[which] = 1.0
        self.under_way[:, which] = np.nan
        qd = self.batch.qd[self.rows]
        if self.filter is not None:
            old = self._state
            self._state = self.filter.start(qd) if old is None else self.filter.reset(old, which, qd)
        if self.rival is not None:
            now = self._adapted
            self._adapted = self.rival.start(qd) if now is None else self.rival.reset(now, which, qd)

    def advance(self, target: FloatArray) -> None:
        """Hold a target for one step of the policy.

        Parameters
        ----------
        target : (E, 12) array
            Joint angles.
        """
        for _ in range(self._control.decimation):
            self.batch.step(self.update(target))

    def update(self, target: FloatArray) -> FloatArray:
        """One sample of the joint loop: what the motors give until the next.

        Parameters
        ----------
        target : (E, 12) array
            Joint angles.

        Returns
        -------
        (E, 12) array
            In N m; ``torque`` is what they are told.
        """
        q, qd = self._measured()
        self._estimate(qd)
        wanted = self._delayed(sent(target - self.f_hat / self.nominal, parameters=self.batch.parameters))
        low, high = self._available()
        self.torque = np.clip(self.kp * (wanted - q) - self.kd * qd, low, high)
        return self.strength * self.torque

    def _measured(self) -> tuple[FloatArray, FloatArray]:
        q, qd = self.batch.q[self.rows], self.batch.qd[self.rows]
        if self._control.noise_angle > 0.0:
            q = q + self._control.noise_angle * self._rng.standard_normal(q.shape)
        if self._control.noise_rate > 0.0:
            qd = qd + self._control.noise_rate * self._rng.standard_normal(qd.shape)
        return q, qd

    def _delayed(self, wanted: FloatArray) -> FloatArray:
        """The target that the drives have by now; the first one after a restart is there at once."""
        if not len(self.under_way):
            return wanted
        self.under_way = np.where(np.isnan(self.under_way), wanted, self.under_way)
        arrived = self.under_way[0]
        self.under_way = np.concatenate([self.under_way[1:], wanted[None]])
        return arrived

    def _available(self) -> tuple[FloatArray, FloatArray]:
        """Smallest and largest torque of the motors at their speed: a straight line to the no-load speed."""
        if not len(self._fastest):
            return -self._limits, self._limits
        part = self.batch.qd[self.rows] / self._fastest
        low = -self._limits * np.clip(1.0 + part, 0.0, 1.0)
        return low, self._limits * np.clip(1.0 - part, 0.0, 1.0)

    def _estimate(self, qd: FloatArray) -> None:
        if self.rival is not None and self._adapted is not None:
            self._adapted, self.f_hat = self.rival.step(self._adapted, qd, self.torque)
        if self.filter is None or self._state is None or not isinstance(self.choice, FilterChoice):
            return
        gate = self._gate()
        self._state, f_hat = self.filter.step(self._state, qd, self._known(qd), self.torque, gate=gate)
        if gate is not None and self.choice.fade[0] > 0.0:
            time = np.where(gate < self.share, *self.choice.fade)
            self.share = self.share - np.expm1(-self._control.dt / time) * (gate - self.share)
        self.f_hat = f_hat * (self.choice.gain * self.share)

    def _known(self, qd: FloatArray) -> JointQuantities:
        contact = self.choice.contact if isinstance(self.choice, FilterChoice) else "omitted"
        if contact == "known":
            return JointQuantities(qd, contact_torque=self.batch.contact[self.rows])
        if contact == "estimated":
            q, up = self.batch.q[self.rows], self.batch.up[self.rows]
            return JointQuantities(
                qd, contact_estimate=carried(q, up, self.torque, parameters=self.batch.parameters)
            )
        return JointQuantities(qd)

    def _gate(self) -> FloatArray | None:
        if not isinstance(self.choice, FilterChoice) or self.choice.gate == "none":
            return None
        if self.choice.gate == "contact":
            return np.repeat((self.batch.load[self.rows] > _CARRIES).astype(float), 3, axis=1)
        tilt, rate = self.batch.lean
        calm = (rate[self.rows] < _CALM_RATE) & (tilt[self.rows] < _CALM_TILT)
        return calm[:, None].astype(float)

    def state(self) -> dict[str, NDArray[np.generic]]:
        """What the next step depends on; a loop with the rival, in which nothing is trained, has none."""
        if self.rival is not None:
            raise ValueError(
                "a loop with the adaptive rival cannot be gone on with: nothing is trained in it"
            )
        found: dict[str, NDArray[np.generic]] = {name: np.array(getattr(self, name)) for name in _KEPT}
        if self._state is not None:
            found |= {name: value for name, value in self._state._asdict().items() if value is not None}
        return found

    def restore(self, state: dict[str, NDArray[np.generic]]) -> None:
        """Go on from there.

        Parameters
        ----------
        state : dict
            Of :meth:`state`, of a loop with the same filter.

        Raises
        ------
        ValueError
            If that loop had another filter.
        """
        if ("w" in state) != (self._state is not None):
            raise ValueError("a state with a filter in one case, without in the other")
        for name in _KEPT:
            setattr(self, name, np.array(state[name]))
        if self._state is not None:
            parts = {name: state.get(name) for name in JointFilterState._fields}
            self._state = JointFilterState(**parts)  # pyright: ignore[reportArgumentType] - arrays that it made itself


def advance(
    batch: Batch,
    loops: Sequence[JointLoop],
    target: FloatArray,
    *,
    watch: Callable[[FloatArray], None] | None = None,
) -> None:
    """Hold targets for one step of the policies, in several loops that share a batch.

    Parameters
    ----------
    batch : Batch
    loops : sequence of JointLoop
        Whose rows follow one another and make up the batch.
    target : (E, 12) array
        Joint angles.
    watch : function of the torques (E, 12), optional
        Called after every step of the simulator.
    """
    for _ in range(batch.parameters.control.decimation):
        torque = np.concatenate([loop.update(target[loop.rows]) for loop in loops])
        batch.step(torque)
        if watch is not None:
            watch(torque)
