"""Why leaving out the contact helps, and why pushes get worse: the linear loop of a standing robot.

Order 1, constant diagonal M, contact left out: whatever the robot stands on, the joint controller is a PID,

    f_hat = F (M q'' + d q' - tau),  F = a0/(s + a0),   tau = -Kp q - Kd q' - f_hat
    =>   tau = -[(1 + a0/s)(Kp + Kd s) + a0 (M s + d)] q                       integral gain a0 Kp

so the legs sag under no constant load. A contact torque that is known in g leaves f = 0 in stance, and PD is all there
is. With a general filter: tau = -[Kp + Kd s + F (M s^2 + d s)]/(1 - F) q.
An integral has to be paid for: there is a largest a0 that stands, and below it a mode of the trunk is left with little
damping. What a push leaves in the filter dies out with the filter's poles, as long as the loop is closed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import control as ct
import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.analysis import frequency_response
from phyfilter_ctl.plants.legged.simulator import simulator

from .gait import neutral
from .params import params
from .robot import compile_model, joint_inertia

if TYPE_CHECKING:
    from mujoco._structs import MjData, MjModel  # the public names are not seen by type checkers

__all__ = [
    "CASES",
    "Case",
    "Row",
    "closed",
    "controller",
    "figures",
    "largest_bandwidth",
    "largest_poles",
    "linearized",
    "pid",
    "settled",
    "study",
    "table",
]

FloatArray = NDArray[np.float64]

_N = 12
# The posture is held with these while the robot settles, N m/rad and N m s/rad: stiff enough that it does not sag.
_HOLD = (200.0, 4.0)
_SETTLE = 20.0  # s
# Gains that stand without a policy, N m/rad and N m s/rad.
_STIFF = (80.0, 2.0)
# Step of the central differences in MuJoCo's coordinates.
_STEP = 1e-6
# Feet creep on their soft contacts: modes at 1 to within this are not the controller's affair.
_CREEP = 1e-5
_OMEGA = np.geomspace(0.1, 300.0, 240)
# rad/s where the compliance to a load is read: slow beside the gait.
_SLOW = 0.1


@dataclass(frozen=True)
class Case:
    """A joint controller that stands.

    Parameters
    ----------
    name : str
    filter : PhyFilter or None
        None: PD alone.
    kp, kd : float
        N m/rad, N m s/rad.
    """

    name: str
    filter: PhyFilter | None
    kp: float
    kd: float


@dataclass(frozen=True)
class Row:
    """What a controller does for the stance.

    Attributes
    ----------
    case : Case
    radius : float
        Largest modulus of the loop's poles, feet's creep left out; 1 and more: it does not stand.
    modulus_margin : float
        1/max singular value of S at the motors, all twelve at once.
    sag : float
        Vertical compliance of the trunk at 0.1 rad/s, m/N.
    tilt : float
        Largest roll and pitch for a sinusoidal lateral force on the trunk, rad/N, and
    at : float
        its frequency, rad/s.
    damping : float
        Least damping ratio of the loop's modes between 1 and 40 rad/s.
    """

    case: Case
    radius: float
    modulus_margin: float
    sag: float
    tilt: float
    at: float
    damping: float

    @property
    def stands(self) -> bool:
        """Whether the loop is stable."""
        return self.radius < 1.0


def settled() -> tuple[MjModel, MjData]:
    """The robot on flat ground, held in the neutral stance until it is at rest; its torques are in ``data.ctrl``.

    Raises
    ------
    ImportError
        Without the extra ``mujoco``.
    """
    mujoco = simulator("the quadruped's stance")
    p, model = params(), compile_model()
    data = mujoco.MjData(model)
    goal = neutral()
    data.qpos[2], data.qpos[3], data.qpos[7:] = p.gait.height + p.robot.foot_radius, 1.0, goal
    for _ in range(round(_SETTLE / p.control.dt)):
        data.ctrl[:] = _HOLD[0] * (goal - data.qpos[7:]) - _HOLD[1] * data.qvel[6:]
        mujoco.mj_step(model, data)
    return model, data


def linearized() -> ct.StateSpace:
    """The robot on its four feet, from sample to sample, about the neutral stance.

    Returns
    -------
    control.StateSpace
        36 states; inputs torque[12] (N m) and force[3] on the trunk (N, world); outputs q[12] (rad), qd[12] (rad/s),
        place[3] (m) and tilt[3] (rad) of the trunk. MuJoCo's own differences for the torques, central ones of its step
        for the force.

    Raises
    ------
    ImportError
        Without the extra ``mujoco``.
    """
    model, data = settled()
    mujoco = simulator("the quadruped's stance")
    n = model.nv
    A, B = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, model.nu))
    mujoco.mjd_transitionFD(model, data, _STEP, True, A, B, None, None)
    E = np.column_stack([_force_column(model, data, axis) for axis in range(3)])
    C = np.zeros((2 * _N + 6, 2 * n))
    C[:_N, 6:n] = C[_N : 2 * _N, n + 6 :] = np.eye(_N)
    C[2 * _N :, :6] = np.eye(6)
    return ct.StateSpace(
        A,
        np.hstack([B, E]),
        C,
        0.0,
        params().control.dt,
        inputs=_labels({"torque": _N, "force": 3}),
        outputs=_labels({"q": _N, "qd": _N, "place": 3, "tilt": 3}),
        name="stance",
    )


def _labels(sizes: Mapping[str, int]) -> list[str]:
    return [f"{name}[{i}]" for name, size in sizes.items() for i in range(size)]


def _force_column(model: MjModel, data: MjData, axis: int) -> FloatArray:
    """State after a step per newton on the trunk."""
    mujoco = simulator("the quadruped's stance")
    trunk, ends = model.body("trunk").id, []
    for sign in (1.0, -1.0):
        copy = mujoco.MjData(model)
        spec = mujoco.mjtState.mjSTATE_INTEGRATION
        state = np.empty(mujoco.mj_stateSize(model, spec))
        mujoco.mj_getState(model, data, state, spec)
        mujoco.mj_setState(model, copy, state, spec)
        copy.xfrc_applied[trunk, axis] = sign
        mujoco.mj_step(model, copy)
        difference = np.zeros(model.nv)
        mujoco.mj_differentiatePos(model, difference, 1.0, data.qpos, copy.qpos)
        ends.append(np.concatenate([difference, copy.qvel - data.qvel]))
    return 0.5 * (ends[0] - ends[1])


def controller(case: Case) -> ct.StateSpace:
    """Torque of the joint loop from q and q', sampled: PD less f_hat, contact left out.

    Parameters
    ----------
    case : Case

    Returns
    -------
    control.StateSpace
        Inputs q[12], qd[12]; outputs torque[12]; angles from the target.
    """
    p, eye, zero = params(), np.eye(_N), np.zeros((_N, _N))
    dt = p.control.dt
    gains = np.hstack([case.kp * eye, case.kd * eye])
    if case.filter is None:
        return ct.StateSpace([], [], [], -gains, dt, name="joint_loop")
    dA, equilibrium, C = case.filter.sampled(dt).transition
    order = len(equilibrium)
    A_w = np.kron(eye, np.eye(order) + dA)
    B_w = np.kron(eye, -(dA @ equilibrium)[:, None])
    C_w = np.kron(eye, C[None, :])
    inertia, damping = np.diag(joint_inertia()) / dt, 0.5 * p.robot.damping * eye
    # u of the step that ends now, from the velocity and torque of the sample before and the velocity of now.
    before = np.hstack([np.zeros((_N, order * _N)), damping - inertia, -eye])
    now = np.hstack([zero, damping + inertia])
    w_A, w_B = np.hstack([A_w, np.zeros((order * _N, 2 * _N))]) + B_w @ before, B_w @ now
    tau_A, tau_B = -C_w @ w_A, -gains - C_w @ w_B
    velocity_A, velocity_B = np.zeros((_N, w_A.shape[1])), np.hstack([zero, eye])
    return ct.StateSpace(
        np.vstack([w_A, velocity_A, tau_A]),
        np.vstack([w_B, velocity_B, tau_B]),
        tau_A,
        tau_B,
        dt,
        name="joint_loop",
    )


def pid(case: Case, omega: FloatArray, joint: int = 0) -> NDArray[np.complex128]:
    """The PID that the joint loop with order 1 is: torque over -q, at real frequencies.

    Parameters
    ----------
    case : Case
        With a low-pass filter of order 1.
    omega : (N,) array
        rad/s.
    joint : int

    Raises
    ------
    ValueError
        For another filter.
    """
    if case.filter is None or case.filter.order != 1 or case.filter.type != 1:
        raise ValueError(f"{case.name}: expected a low-pass filter of order 1")
    s, a0 = 1j * np.asarray(omega), float(case.filter.a[0])
    own = joint_inertia()[joint] * s + params().robot.damping
    return (1.0 + a0 / s) * (case.kp + case.kd * s) + a0 * own


def study(cases: Sequence[Case] | None = None, *, plant: ct.StateSpace | None = None) -> list[Row]:
    """Stability, margin and compliances of the standing robot.

    Parameters
    ----------
    cases : sequence of Case, optional
        None: ``CASES``.
    plant : control.StateSpace, optional
        Of :func:`linearized`; None: it is made.
    """
    plant = linearized() if plant is None else plant
    return [_row(case, plant) for case in (CASES if cases is None else cases)]


def _row(case: Case, plant: ct.StateSpace) -> Row:
    loop = closed(case, plant)
    poles = np.linalg.eigvals(np.asarray(loop.A))
    poles = poles[np.abs(poles - 1.0) > _CREEP]
    radius = float(np.abs(poles).max())
    K = np.asarray(frequency_response(controller(case), _OMEGA).frdata).transpose(2, 0, 1)
    P = np.asarray(frequency_response(_joints_alone(plant), _OMEGA).frdata).transpose(2, 0, 1)
    least = np.linalg.svd(np.eye(_N) - K @ P, compute_uv=False)[:, -1].min()
    if radius >= 1.0:
        return Row(case, radius, 0.0, np.inf, np.inf, np.nan, np.nan)
    to = np.abs(np.asarray(frequency_response(loop, _OMEGA).frdata))
    tilt = np.hypot(to[3, 1], to[4, 1])  # roll and pitch for a lateral force
    sag = np.abs(np.asarray(frequency_response(loop, np.array([_SLOW])).frdata))[2, 2, 0]
    peak = int(tilt.argmax())
    return Row(
        case, radius, float(least), float(sag), float(tilt[peak]), float(_OMEGA[peak]), _damping(poles)
    )


def _joints_alone(plant: ct.StateSpace) -> ct.StateSpace:
    B, C = np.asarray(plant.B)[:, :_N], np.asarray(plant.C)[: 2 * _N]
    return ct.StateSpace(np.asarray(plant.A), B, C, np.zeros((2 * _N, _N)), plant.dt)


def closed(case: Case, plant: ct.StateSpace) -> ct.StateSpace:
    """From a force on the trunk (N, world) to its place (m) and tilt (rad), with the joint loop closed.

    Parameters
    ----------
    case : Case
    plant : control.StateSpace
        Of :func:`linearized`.
    """
    K = controller(case)
    A, B, C = (np.asarray(part) for part in (plant.A, plant.B, plant.C))
    KA, KB, KC, KD = (np.asarray(part) for part in (K.A, K.B, K.C, K.D))
    joints = C[: 2 * _N]
    A_closed = np.block([[A + B[:, :_N] @ KD @ joints, B[:, :_N] @ KC], [KB @ joints, KA]])
    inputs = np.vstack([B[:, _N:], np.zeros((len(KA), 3))])
    outputs = np.hstack([C[2 * _N :], np.zeros((6, len(KA)))])
    return ct.StateSpace(A_closed, inputs, outputs, np.zeros((6, 3)), plant.dt)


def _damping(poles: NDArray[np.complexfloating] | FloatArray) -> float:
    s = np.log(poles[np.abs(poles) > 0.05].astype(complex)) / params().control.dt
    s = s[(np.abs(s) > 1.0) & (np.abs(s) < 40.0)]
    return float((-s.real / np.abs(s)).min())


def largest_bandwidth(kp: float, kd: float, *, order: int = 1, plant: ct.StateSpace | None = None) -> float:
    """The largest pole, rad/s, of a low-pass filter of equal poles with which the robot stands, to 1 %.

    Parameters
    ----------
    kp, kd : float
        N m/rad, N m s/rad.
    order : int
    plant : control.StateSpace, optional
        Of :func:`linearized`.
    """
    plant = linearized() if plant is None else plant

    def stands(pole: float) -> bool:
        case = Case("", PhyFilter.from_poles([-pole] * order), kp, kd)
        poles = np.linalg.eigvals(np.asarray(closed(case, plant).A))
        return bool(np.abs(poles[np.abs(poles - 1.0) > _CREEP]).max() < 1.0)

    low, high = 0.05, 100.0
    if not stands(low):
        return 0.0
    while high / low > 1.01:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if stands(middle) else (low, middle)
    return low


def largest_poles(plant: ct.StateSpace | None = None) -> dict[str, tuple[float, float]]:
    """Largest poles of order 1 and 2 that stand, rad/s, with the vendor's gains and with stiff ones.

    Parameters
    ----------
    plant : control.StateSpace, optional
        Of :func:`linearized`.
    """
    plant = linearized() if plant is None else plant
    return {
        name: (largest_bandwidth(*pair, plant=plant), largest_bandwidth(*pair, order=2, plant=plant))
        for name, pair in _gains().items()
    }


def _gains() -> dict[str, tuple[float, float]]:
    return {"vendor": (params().control.kp, params().control.kd), "stiff": _STIFF}


def _cases() -> tuple[Case, ...]:
    filters = {
        "PD": None,
        "a0 = 0.3": PhyFilter([0.3]),
        "a0 = 1": PhyFilter([1.0]),
        "a0 = 5": PhyFilter([5.0]),
        "order 2 at 2 rad/s": PhyFilter.from_poles([-2.0, -2.0]),
        "band-pass 0.2 to 1 rad/s": PhyFilter.from_poles([-0.2, -1.0], b=[0.0, 1.0]),
    }
    return tuple(
        Case(f"{label}, {name}", entry, *pair)
        for label, pair in _gains().items()
        for name, entry in filters.items()
    )


CASES = _cases()
"""PD and filters, with the vendor's gains and with stiff ones."""


def table(rows: Sequence[Row], limits: Mapping[str, tuple[float, float]]) -> str:
    """The study as text.

    Parameters
    ----------
    rows : sequence of Row
    limits : dict of str to (float, float)
        Largest poles of order 1 and 2 that stand, by gains.
    """
    lines = [
        "standing, linear: the trunk's compliance at 0.1 rad/s, largest tilt for a lateral force, margin at the motors",
        f"{'':<34}{'stands':>7}{'sag mm/N':>10}{'tilt mrad/N':>13}{'at rad/s':>10}{'damping':>9}{'margin':>8}",
    ]
    for row in rows:
        cells = (
            f"{'yes':>7}{1e3 * row.sag:>10.3f}{1e3 * row.tilt:>13.2f}{row.at:>10.1f}{row.damping:>9.2f}"
            f"{row.modulus_margin:>8.2f}"
            if row.stands
            else f"{'no':>7}"
        )
        lines.append(f"{row.case.name:<34}{cells}")
    for name, (one, two) in limits.items():
        lines.append(f"largest pole that stands, {name}: order 1 {one:.2f} rad/s, order 2 {two:.2f} rad/s")
    return "\n".join(lines)


def figures(rows: Sequence[Row], limits: Mapping[str, tuple[float, float]]) -> dict[str, object]:
    """The study for JSON.

    Parameters
    ----------
    rows, limits
        As for :func:`table`.
    """

    def number(value: float) -> float | None:
        return value if np.isfinite(value) else None

    return {
        "stance": {
            row.case.name: {
                "stands": row.stands,
                "sag_m_per_N": number(row.sag),
                "tilt_rad_per_N": number(row.tilt),
                "least_damping": number(row.damping),
                "modulus_margin": row.modulus_margin,
            }
            for row in rows
        },
        "largest_pole": {name: {"order_1": one, "order_2": two} for name, (one, two) in limits.items()},
    }
