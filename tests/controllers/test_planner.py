"""The cooperative planner against brute-force least squares, CasADi's ipopt, KKT conditions and its promises."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls
from scipy.spatial.transform import Rotation

from phyfilter_ctl.controllers.planner import (
    CooperativePlanner,
    PlannerLimits,
    PlannerWeights,
    follow,
)
from phyfilter_ctl.controllers.planner import problem as programme_module
from phyfilter_ctl.controllers.planner.problem import Horizon, braking, quadratic_program, roll_out, rotations
from tests.cpu_budget import slow_but

DT = 0.07
MOUNT = np.array([0.05, 0.0, -0.05])
PLATFORM = [[-3.0, -3.0, 0.3], [3.0, 3.0, 2.5]]
WORKSPACE = [[0.18, -0.15, -0.3], [0.42, 0.15, -0.05]]
REST = np.array([0.0, 0.0, 1.3, 0.0, 0.0, 0.0, 0.3, 0.0, -0.15, 0.0, 0.0, 0.0])
# The promise: the closed form to 1e-6; in fact 1e-9 of accelerations of size 1.
CLOSED_FORM = 1e-6
# Gradients of size 1e3; the solver's tolerance on the dual is 1e-12 of its own scaling.
STATIONARY = 1e-6
# ipopt's own tolerance on a problem of this curvature.
IPOPT = 1e-4
# A solver's feasibility and the allowance for rounding (see problem.ROUNDING).
INSIDE = 2e-6
# A box without width is given 1e-6 on each side first.
PINNED = 3e-6
ROUNDED = 1e-12


def limits(**options):
    return PlannerLimits(PLATFORM, WORKSPACE, **options)


def tight():
    """Boxes of a few steps, an arm that stops in less than the horizon and a platform that does not."""
    return PlannerLimits(
        [[-0.4, -0.3, 0.8], [0.5, 0.3, 1.4]],
        [[0.25, -0.03, -0.2], [0.35, 0.03, -0.1]],
        platform_velocity=[0.6, 0.5, 0.4],
        arm_velocity=0.15,
        platform_acceleration=[0.4, 0.5, 0.6],
        arm_acceleration=[0.5, 0.8, 1.0],
    )


def wide():
    return PlannerLimits(
        [[-1e4] * 3, [1e4] * 3],
        [[-1e3] * 3, [1e3] * 3],
        platform_velocity=1e3,
        arm_velocity=1e3,
        platform_acceleration=1e4,
        arm_acceleration=1e4,
    )


def situation(seed, steps):
    """A state, last accelerations, an attitude with its rate, and targets near by."""
    rng = np.random.default_rng(seed)
    h = REST + np.repeat([0.3, 0.2, 0.05, 0.1], 3) * rng.uniform(-1.0, 1.0, 12)
    R = Rotation.from_rotvec(0.3 * rng.uniform(-1.0, 1.0, 3)).as_matrix()
    target = h[:3] + R @ (MOUNT + h[6:9]) + 0.3 * rng.uniform(-1.0, 1.0, (steps, 3))
    return h, 0.3 * rng.uniform(-1.0, 1.0, 6), R, 0.4 * rng.uniform(-1.0, 1.0, 3), target


def matrices():
    """The paper's A and B, block (4, 4) of A the identity."""
    chain, push = np.array([[1.0, DT], [0.0, 1.0]]), np.array([[0.5 * DT**2], [DT]])
    return np.kron(np.eye(2), np.kron(chain, np.eye(3))), np.kron(np.eye(2), np.kron(push, np.eye(3)))


def stepped(h, u):
    """States from x' = A x + B u, one by one."""
    A, B = matrices()
    states = [h]
    for push in u:
        states.append(A @ states[-1] + B @ push)
    return np.array(states)


def residuals(u, case, weights, kind="euler"):
    """Square roots of all costs as one vector, straight from their definitions."""
    h, u_before, R, omega, target = case
    states = stepped(h, u)
    turn, out = R, []
    x, y, z = omega
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    before = u_before
    for i in range(1, len(states)):
        turn = turn @ (
            (np.eye(3) + DT * cross) if kind == "euler" else Rotation.from_rotvec(DT * omega).as_matrix()
        )
        error = target[i - 1] - (states[i, :3] + turn @ MOUNT + turn @ states[i, 6:9])
        out.append(np.linalg.cholesky(weights.tracking).T @ error)
        out.append(np.linalg.cholesky(weights.smoothness).T @ (u[i - 1] - before))
        move = (states[i] - states[i - 1])[[0, 1, 2, 6, 7, 8]]
        out.append(np.sqrt(weights.increment.diagonal()) * move)
        before = u[i - 1]
    return np.concatenate(out)


def linear(function, steps):
    """Value at zero and matrix of an affine function of u (N, 6), column by column."""
    zero = function(np.zeros((steps, 6)))
    units = np.eye(6 * steps).reshape(-1, steps, 6)
    return zero, np.array([function(unit) - zero for unit in units]).T


# --- the programme ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["euler", "exponential"])
@pytest.mark.parametrize("seed", range(3))
def test_without_active_limits_the_plan_is_the_least_squares_solution(seed, kind):
    N = 8
    rng = np.random.default_rng(seed)
    spread = rng.standard_normal((6, 6))
    weights = PlannerWeights(smoothness=np.diag([700.0] * 3 + [1.0] * 3) + spread @ spread.T)
    planner = CooperativePlanner(wide(), MOUNT, horizon=N, weights=weights, rotation=kind)
    case = h, u_before, R, omega, target = situation(seed, N)
    plan = planner.plan(h, u_before, target=target, R=R, omega=omega)
    at_zero, J = linear(lambda u: residuals(u, case, weights, kind), N)
    expected = np.linalg.solve(J.T @ J, -J.T @ at_zero).reshape(N, 6)
    assert plan.status == "optimal"
    assert abs(plan.u - expected).max() < CLOSED_FORM
    assert abs(plan.h - stepped(h, plan.u)).max() < ROUNDED


def test_cost_is_the_sum_of_the_definitions():
    """Increments as first differences of states and inputs, and as mean velocity times dt, are the same cost."""
    N, weights = 5, PlannerWeights()
    case = h, u_before, R, omega, target = situation(3, N)
    turned = rotations(R, omega, DT, N, "euler")
    H, g, *_ = quadratic_program(
        Horizon.of(N, DT, limits(), weights), h, u_before=u_before, turned=turned, mount=MOUNT, target=target
    )
    rng = np.random.default_rng(4)
    base = np.sum(residuals(np.zeros((N, 6)), case, weights) ** 2)
    for u in rng.standard_normal((5, N, 6)):
        x = u.ravel()
        assert 0.5 * x @ H @ x + g @ x == pytest.approx(
            np.sum(residuals(u, case, weights) ** 2) - base, rel=1e-10
        )
        states = stepped(h, u)
        mean = 0.5 * DT * (states[1:, 3:6] + states[:-1, 3:6])
        assert abs(np.diff(states[:, :3], axis=0) - mean).max() < ROUNDED
    assert np.linalg.eigvalsh(H)[0] > 0.0


def limit_rows(u, h, box):
    """Every limit as a number that must not be positive, the stopping condition from its definition."""
    states = stepped(h, u)
    p, v = states[1:, [0, 1, 2, 6, 7, 8]], states[1:, [3, 4, 5, 9, 10, 11]]
    a = box.acceleration
    out = [p - box.upper, box.lower - p, v - box.velocity, -v - box.velocity, u - a, -u - a]
    for k in range(1, 40):
        fall = a * DT**2 * k * (k - 1) / 2.0
        ahead = DT * v[-1:] * (k - 0.5)
        out += [p[-1:] + ahead - fall - box.upper, box.lower - p[-1:] - ahead - fall]
    return np.concatenate([part.ravel() for part in out])


@pytest.mark.parametrize("seed", range(4))
def test_with_active_limits_the_kkt_conditions_hold(seed):
    """The gradient is a non-negative combination of the gradients of the active limits (Farkas, by nnls)."""
    N, box, weights = 6, tight(), PlannerWeights()
    planner = CooperativePlanner(box, MOUNT, horizon=N)
    rng = np.random.default_rng(seed)
    h, target = REST + 0.0, REST[:3] + MOUNT + REST[6:9] + rng.choice([-0.4, 0.4], 3) * [1.0, 1.0, 0.5]
    h[3:6] = rng.uniform(-0.2, 0.2, 3)
    case = h, np.zeros(6), np.eye(3), np.zeros(3), np.tile(target, (N, 1))
    plan = planner.plan(h, target=target)
    assert plan.status == "optimal"
    at_zero, J = linear(lambda u: residuals(u, case, weights), N)
    rows_at_zero, rows = linear(lambda u: limit_rows(u, h, box), N)
    x = plan.u.ravel()
    slack = rows_at_zero + rows @ x
    assert slack.max() < INSIDE
    active = slack > -1e-7
    assert active.sum() >= 3
    gradient = 2.0 * J.T @ (at_zero + J @ x)
    _, left = nnls(rows[active].T, -gradient)
    assert left < STATIONARY * np.linalg.norm(gradient)


def test_with_active_limits_ipopt_finds_the_same():
    N, box, weights = 6, tight(), PlannerWeights()
    target = np.array([0.75, 0.2, 0.95])
    plan = CooperativePlanner(box, MOUNT, horizon=N).plan(REST, target=target)
    u = ca.MX.sym("u", 6, N)
    A, B = matrices()
    x, before, cost, bounded, low, high = ca.DM(REST), ca.DM.zeros(6), 0, [], [], []
    axes, rates = [0, 1, 2, 6, 7, 8], [3, 4, 5, 9, 10, 11]
    for i in range(N):
        push = u[:, i]
        new = ca.DM(A) @ x + ca.DM(B) @ push
        move = ca.vertcat(*[new[j] - x[j] for j in axes])
        error = target - (new[:3] + MOUNT + new[6:9])
        cost += ca.bilin(ca.DM(weights.tracking), error, error)
        cost += ca.bilin(ca.DM(weights.smoothness), push - before, push - before)
        cost += ca.bilin(ca.DM(weights.increment), move, move)
        bounded += [new[j] for j in axes] + [new[j] for j in rates]
        low += [*box.lower, *-box.velocity]
        high += [*box.upper, *box.velocity]
        x, before = new, push
    for k in range(1, 40):
        fall = box.acceleration * DT**2 * k * (k - 1) / 2.0
        bounded += [x[j] + DT * (k - 0.5) * x[r] for j, r in zip(axes, rates, strict=True)]
        low += [*(box.lower - fall)]
        high += [*(box.upper + fall)]
    nlp = {"x": ca.vec(u), "f": cost, "g": ca.vertcat(*bounded)}
    options = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": False, "ipopt.tol": 1e-10}
    a = np.tile(box.acceleration, N)
    answer = ca.nlpsol("reference", "ipopt", nlp, options)(lbx=-a, ubx=a, lbg=low, ubg=high)
    assert abs(np.array(answer["x"]).reshape(N, 6) - plan.u).max() < IPOPT


@pytest.mark.parametrize(("solver", "tolerance"), [("qpoases", 1e-6), ("piqp", 1e-3)])
def test_solvers_agree(solver, tolerance, capfd):
    """piqp, an interior-point method, leaves more of the accelerations that hardly cost anything."""
    expected = CooperativePlanner(tight(), MOUNT, horizon=6).plan(REST, target=[0.75, 0.2, 0.95])
    plan = CooperativePlanner(tight(), MOUNT, horizon=6, solver=solver).plan(REST, target=[0.75, 0.2, 0.95])
    capfd.readouterr()
    assert plan.status == expected.status == "optimal"
    assert abs(plan.u - expected.u).max() < tolerance


def test_equal_inputs_give_equal_plans():
    planner = CooperativePlanner(tight(), MOUNT)
    first = planner.plan(REST, target=[0.75, 0.2, 0.95])
    planner.plan(REST, target=[-0.1, -0.2, 1.3])
    assert np.array_equal(planner.plan(REST, target=[0.75, 0.2, 0.95]).u, first.u)


# --- attitude -----------------------------------------------------------------------------------------------------


def test_rotation_prediction():
    rng = np.random.default_rng(5)
    R, omega = Rotation.from_rotvec(rng.standard_normal(3)).as_matrix(), rng.standard_normal(3)
    exact = rotations(R, omega, DT, 10, "exponential")
    euler = rotations(R, omega, DT, 10, "euler")
    for i in range(10):
        expected = R @ Rotation.from_rotvec((i + 1) * DT * omega).as_matrix()
        assert abs(exact[i] - expected).max() < ROUNDED
    x, y, z = omega
    assert euler[0] == pytest.approx(R + DT * R @ np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]), abs=ROUNDED)
    # Euler's step lengthens: det(I + dt [w]x) = 1 + dt^2 |w|^2.
    assert np.linalg.det(euler[-1]) == pytest.approx((1.0 + DT**2 * omega @ omega) ** 10, rel=1e-12)


def test_end_effector_hangs_where_the_attitude_puts_it():
    """A quarter turn to the left puts an arm that reaches forward to the left; it hangs below all the same."""
    yaw = Rotation.from_euler("z", np.pi / 2).as_matrix()
    plan = CooperativePlanner(wide(), MOUNT).plan(REST, target=[0.0, 0.35, 1.1], R=yaw)
    assert abs(plan.u).max() < 1e-9
    assert plan.end_effector[0] == pytest.approx([0.0, 0.35, 1.1], abs=1e-12)


# --- limits and feasibility ---------------------------------------------------------------------------------------


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6))
def test_braking_stops_in_the_least_distance(v):
    box = limits(platform_acceleration=[0.7, 1.1, 2.0])
    h = REST.copy()
    h[[3, 4, 5, 9, 10, 11]] = v
    u = braking(h, box, DT, 40)
    path = stepped(h, u)
    assert abs(path[-1, [3, 4, 5, 9, 10, 11]]).max() < ROUNDED
    assert (abs(u) <= box.acceleration + ROUNDED).all()
    k = np.arange(1, 60)[:, None]
    speed = np.abs(v)
    least = np.maximum(
        np.max(DT * speed * (k - 0.5) - box.acceleration * DT**2 * k * (k - 1) / 2, axis=0), 0.0
    )
    moved = (path[-1] - path[0])[[0, 1, 2, 6, 7, 8]]
    assert moved == pytest.approx(np.sign(v) * least, abs=1e-10)
    assert (np.diff(np.sign(v)[:, None] * path[:, [0, 1, 2, 6, 7, 8]].T, axis=1) >= -ROUNDED).all()


def jumping_targets(seed, steps):
    """Targets that jump about all that the tight limits can ever reach, every 3 to 25 steps."""
    rng = np.random.default_rng(seed)
    box, count, out = tight(), 0, []
    while count < steps:
        hold = int(rng.integers(3, 26))
        p = rng.uniform(box.lower, box.upper)
        out += [p[:3] + MOUNT + p[3:]] * hold
        count += hold
    return np.array(out[:steps])


def inside(path, box):
    p, v = path.h[:, [0, 1, 2, 6, 7, 8]], path.h[:, [3, 4, 5, 9, 10, 11]]
    return max(
        (p - box.upper).max(),
        (box.lower - p).max(),
        (abs(v) - box.velocity).max(),
        (abs(path.u) - box.acceleration).max(),
    )


@pytest.mark.slow
@settings(max_examples=10, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10_000), horizon=st.sampled_from([3, 5, 8]))
def test_a_plan_always_has_a_successor(seed, horizon):
    """200 plans, tight limits, horizons shorter than a stop, targets that jump: each is solved, no limit broken."""
    planner = CooperativePlanner(tight(), MOUNT, horizon=horizon)
    path = follow(planner, REST, targets=jumping_targets(seed, 201))
    assert set(path.statuses) == {"optimal"}, set(path.messages)
    assert inside(path, tight()) < INSIDE


def test_without_the_stopping_condition_plans_end_in_a_corner(monkeypatch):
    """The test above can fail: without those rows the same missions do."""
    free = programme_module.quadratic_program

    def short_sighted(horizon, h, **options):
        programme = free(horizon, h, **options)
        last = 6 * len(horizon.stopping)
        programme.upper[-last:], programme.lower[-last:] = 1e3, -1e3
        return programme

    monkeypatch.setattr("phyfilter_ctl.controllers.planner.planner.quadratic_program", short_sighted)
    path = follow(CooperativePlanner(tight(), MOUNT, horizon=3), REST, targets=jumping_targets(0, 201))
    assert "kept" in path.statuses
    assert np.isfinite(path.h).all()


@pytest.mark.slow
def test_boxes_without_width_hold_an_axis():
    still = PlannerLimits(PLATFORM, [[0.3, -0.1, -0.15], [0.3, 0.1, -0.15]])
    planner = CooperativePlanner(still, MOUNT)
    path = follow(
        planner, REST, targets=np.vstack([jumping_targets(1, 150), np.tile([1.0, 0.3, 1.0], (60, 1))])
    )
    assert set(path.statuses) == {"optimal"}
    assert abs(path.h[:, [6, 8]] - [0.3, -0.15]).max() < PINNED
    assert path.end_effector[-1] == pytest.approx([1.0, 0.3, 1.0], abs=2e-3)


def test_a_platform_without_a_box_flies_off():
    free = PlannerLimits([[-np.inf] * 3, [np.inf] * 3], WORKSPACE)
    path = follow(CooperativePlanner(free, MOUNT), REST, targets=lambda t: [20.0, 0.3, 1.0], steps=60)
    assert set(path.statuses) == {"optimal"}
    assert path.h[:, 3].max() == pytest.approx(1.5, abs=INSIDE)


# --- plans that fail ----------------------------------------------------------------------------------------------


def test_a_state_outside_keeps_the_plan_and_the_next_one_recovers():
    planner, target = CooperativePlanner(limits(), MOUNT), np.array([1.0, 0.2, 0.9])
    before = planner.plan(REST, target=target)
    thrown = before.h[1].copy()
    thrown[6] = 0.6
    kept = planner.plan(thrown, before.u[0], target=target, before=before)
    assert (kept.status, kept.age) == ("kept", 1)
    assert "arm x is at 0.6 m" in kept.message
    assert "infeasible" in kept.message
    assert np.array_equal(kept.h[:-1], before.h[1:])
    assert np.array_equal(kept.u[:-1], before.u[1:])
    assert kept.end_effector[:-1] == pytest.approx(before.end_effector[1:], abs=ROUNDED)
    again = planner.plan(kept.h[1], kept.u[0], target=target, before=kept)
    assert (again.status, again.message, again.age) == ("optimal", "", 0)


def test_a_kept_plan_ends_at_rest_within_the_limits():
    box = tight()
    planner = CooperativePlanner(box, MOUNT, horizon=4)
    plan = planner.plan(REST, target=[0.75, 0.2, 0.95])
    thrown = REST.copy()
    thrown[0] = 9.0
    for age in range(1, 31):
        plan = planner.plan(thrown, target=[0.75, 0.2, 0.95], before=plan)
        assert (plan.status, plan.age) == ("kept", age)
        p = plan.h[:, [0, 1, 2, 6, 7, 8]]
        assert (p <= box.upper + INSIDE).all()
        assert (p >= box.lower - INSIDE).all()
        assert (abs(plan.u) <= box.acceleration + ROUNDED).all()
    assert abs(plan.h[:, [3, 4, 5, 9, 10, 11]]).max() < ROUNDED


def test_without_a_plan_before_every_axis_brakes():
    thrown = REST.copy()
    thrown[[0, 3, 9]] = 9.0, -1.0, 0.2
    plan = CooperativePlanner(limits(), MOUNT).plan(thrown, target=[1.0, 0.2, 0.9])
    assert plan.status == "braking"
    assert "platform x is at 9 m" in plan.message
    assert np.array_equal(plan.h, roll_out(thrown, plan.u, DT))
    assert abs(plan.h[-1, [3, 4, 5, 9, 10, 11]]).max() < ROUNDED


def test_a_late_solve_is_not_used():
    planner = CooperativePlanner(limits(), MOUNT)
    before = planner.plan(REST, target=[1.0, 0.2, 0.9])
    hasty = CooperativePlanner(limits(), MOUNT, time_limit=1e-9)
    plan = hasty.plan(before.h[1], before.u[0], target=[1.0, 0.2, 0.9], before=before)
    assert plan.status == "kept"
    assert "expected at most 0.0 ms" in plan.message
    assert np.array_equal(plan.u[:-1], before.u[1:])


def test_a_solver_that_raises_or_returns_rubbish_is_a_status(monkeypatch):
    from phyfilter_ctl.controllers.planner import planner as module

    answer = module.ConicSolver.__call__
    target = [1.0, 0.2, 0.9]
    for broken in (
        lambda self, q: answer(self, q)._replace(x=np.full(90, np.nan)),
        lambda self, q: answer(self, q)._replace(x=np.full(90, 100.0)),
        lambda self, q: answer(self, q._replace(g=np.full(90, np.nan))),
        lambda self, q: answer(self, q._replace(H=-q.H)),
        lambda self, q: answer(self, q._replace(upper=q.lower[:-1])),
    ):
        planner = CooperativePlanner(limits(), MOUNT)
        before = planner.plan(REST, target=target)
        monkeypatch.setattr(module.ConicSolver, "__call__", broken)
        plan = planner.plan(before.h[1], target=target, before=before)
        monkeypatch.undo()
        assert plan.status == "kept"
        assert plan.message
        assert np.isfinite(plan.h).all()


# --- missions -----------------------------------------------------------------------------------------------------


def pick_and_place(t):
    """Above the stand, down to it, up, over to the area, down, up."""
    legs = [
        (3.0, [1.2, 0.4, 1.2]),
        (6.0, [1.2, 0.4, 0.9]),
        (8.0, [1.2, 0.4, 1.2]),
        (12.0, [-0.8, -0.5, 1.2]),
        (15.0, [-0.8, -0.5, 0.7]),
    ]
    return next((place for end, place in legs if t < end), [-0.8, -0.5, 1.2])


def tilting(t, h, u):
    tilt = 0.1 * np.array([np.sin(0.7 * t), np.cos(0.9 * t), 0.0])
    return Rotation.from_rotvec(tilt).as_matrix(), 0.1 * np.array([np.cos(t), np.sin(t), 0.0])


@pytest.mark.parametrize("attitude", slow_but([tilting], [None, tilting]))
def test_pick_and_place(attitude):
    planner = CooperativePlanner(limits(), MOUNT)
    path = follow(planner, REST, targets=pick_and_place, steps=230, attitude=attitude)
    assert set(path.statuses) == {"optimal"}
    assert set(path.messages) == {""}
    assert inside(path, limits()) < INSIDE
    error = np.linalg.norm(path.end_effector - path.target, axis=1)
    # Before the target moves on, as seen from one horizon earlier.
    holds = [int(end / DT) - 17 for end in (6.0, 15.0)]
    # Swings of 0.1 rad move a level arm by 4 cm; their prediction at a constant rate leaves part of it.
    assert error[holds].max() < (1e-3 if attitude is None else 2e-2)
    assert path.solve_seconds.shape == (230,)
    assert (path.solve_seconds > 0.0).all()


def test_samples_of_a_path():
    path = follow(CooperativePlanner(limits(), MOUNT), REST, targets=pick_and_place, steps=40)
    at_steps = path.sample(path.times)
    assert abs(at_steps.platform - path.h[:, :3]).max() < ROUNDED
    assert abs(at_steps.arm_velocity - path.h[:, 9:]).max() < ROUNDED
    assert np.array_equal(at_steps.platform_acceleration[:-1], path.u[:, :3])
    t, e = np.sort(np.random.default_rng(6).uniform(0.01, 2.79, 200)), 1e-6
    t = t[abs(t / DT - np.round(t / DT)) > 1e-3]
    here, ahead, behind = path.sample(t), path.sample(t + e), path.sample(t - e)
    for name in ("platform", "arm"):
        slope = (getattr(ahead, name) - getattr(behind, name)) / (2 * e)
        assert slope == pytest.approx(getattr(here, f"{name}_velocity"), abs=1e-8)
        slope = (getattr(ahead, f"{name}_velocity") - getattr(behind, f"{name}_velocity")) / (2 * e)
        assert slope == pytest.approx(getattr(here, f"{name}_acceleration"), abs=1e-8)
    for outside in (-0.1, 2.9, np.nan):
        with pytest.raises(ValueError, match="follow for more steps"):
            path.sample([0.0, outside])


def test_targets_as_rows_are_those_of_a_function():
    planner = CooperativePlanner(limits(), MOUNT, horizon=5)
    rows = np.array([pick_and_place(DT * k) for k in range(31)])
    seen = []
    by_rows = follow(planner, REST, targets=rows, progress=seen.append)
    by_function = follow(planner, REST, targets=lambda t: pick_and_place(min(t, 30 * DT)), steps=30)
    assert np.array_equal(by_rows.h, by_function.h)
    assert seen == list(range(1, 31))


@settings(max_examples=200, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1))
def test_what_a_state_reaches_is_reachable(seed):
    rng = np.random.default_rng(seed)
    box = tight()
    planner = CooperativePlanner(box, MOUNT)
    p = rng.uniform(box.lower, box.upper)
    axis = rng.standard_normal(2)
    tilt = Rotation.from_rotvec(rng.uniform(0.0, 0.35) * np.append(axis / np.linalg.norm(axis), 0.0))
    R = tilt * Rotation.from_euler("z", rng.uniform(-np.pi, np.pi))
    assert planner.reachable((p[:3] + R.apply(MOUNT + p[3:]))[None])[0]


# --- bad input ----------------------------------------------------------------------------------------------------


def test_targets_out_of_reach_are_refused_before_anything_is_solved(monkeypatch):
    planner = CooperativePlanner(tight(), MOUNT)
    monkeypatch.setattr(
        "phyfilter_ctl.controllers.planner.planner.ConicSolver.__call__", lambda *_: pytest.fail("solved")
    )
    for far in ([3.0, 0.0, 1.0], [0.3, 0.0, 2.0], [0.3, 0.0, 0.1]):
        with pytest.raises(ValueError, match=r"out of reach .* move the target or widen"):
            planner.plan(REST, target=far)
    # A ring: a platform that cannot move reaches nothing close by.
    hovering = PlannerLimits([[0.0, 0.0, 1.0]] * 2, WORKSPACE)
    assert CooperativePlanner(hovering, tilt_limit=0.0).reachable(
        [[0.3, 0, 0.9], [0.1, 0, 0.9]]
    ).tolist() == [
        True,
        False,
    ]
    rows = np.tile([0.3, 0.0, 1.1], (20, 1))
    rows[13] = [9.0, 0.0, 1.0]
    with pytest.raises(ValueError, match="target 13"):
        follow(planner, REST, targets=rows)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"platform": PLATFORM[::-1]}, r"platform x: lower limit 3 m, upper limit -3 m contradict"),
        ({"workspace": [[0.2, 0.1, -0.3], [0.4, 0.0, -0.1]]}, "arm y: .*contradict"),
        ({"workspace": [[0.2, 0.1, -0.3], [0.4, 0.2, np.inf]]}, "workspace: expected finite"),
        ({"platform": [[np.inf] * 3, [np.inf] * 3]}, "contradict"),
        ({"platform": [[0, 0, 0]] * 3}, r"platform: expected a number or shape \(2, 3\)"),
        ({"platform_acceleration": 0.0}, "platform x: expected a largest acceleration > 0, got 0"),
        ({"arm_velocity": [0.1, -0.1, 0.1]}, "arm y: expected a largest velocity > 0"),
        ({"arm_velocity": np.nan}, "arm_velocity: expected finite"),
    ],
)
def test_limits_that_contradict(options, match):
    with pytest.raises(ValueError, match=match):
        PlannerLimits(**({"platform": PLATFORM, "workspace": WORKSPACE} | options))


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"tracking": [1.0, 1.0, 0.0]}, "tracking: expected a positive definite"),
        ({"smoothness": [1.0, 1.0, 1.0, 1.0, 1.0, 0.0]}, "smoothness: expected a positive definite"),
        ({"platform_increment": [1.0, 1.0, -1.0]}, "platform_increment: expected a positive semidefinite"),
        ({"tracking": [[1.0, 2.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]}, "symmetric"),
        ({"tracking": [[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]}, "eigenvalue -1"),
        ({"arm_increment": [1.0, np.inf, 1.0]}, "arm_increment: expected finite"),
        ({"smoothness": [1.0, 1.0]}, "smoothness: expected a number or shape"),
    ],
)
def test_weights_that_are_not_definite(options, match):
    with pytest.raises(ValueError, match=match):
        PlannerWeights(**options)
    assert PlannerWeights(arm_increment=[0.0, 0.0, 0.0]).increment[3:, 3:].any() is np.False_


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"horizon": 1}, "horizon"),
        ({"horizon": 2.5}, "horizon"),
        ({"dt": 0.0}, "dt"),
        ({"time_limit": -1.0}, "time_limit"),
        ({"rotation": "exact"}, "euler, exponential"),
        ({"solver": "simplex"}, "daqp, qpoases"),
        ({"mount": [0.0, np.nan, 0.0]}, "mount"),
        ({"tilt_limit": -0.1}, "tilt_limit"),
    ],
)
def test_settings_out_of_range(options, match):
    with pytest.raises(ValueError, match=match):
        CooperativePlanner(limits(), **options)


def test_calls_with_wrong_input():
    planner = CooperativePlanner(limits(), MOUNT)
    target = [0.5, 0.0, 1.0]
    short = CooperativePlanner(limits(), MOUNT, horizon=4).plan(REST, target=target)
    for options, match in (
        ({"h": REST[:11]}, "h: expected a number or shape"),
        ({"h": np.append(REST[:11], np.nan)}, "h: expected finite"),
        ({"u_before": np.zeros(5)}, "u_before"),
        ({"target": np.zeros((4, 3))}, "target: expected a number or shape"),
        ({"R": 2.0 * np.eye(3)}, "rotation matrix"),
        ({"R": -np.eye(3)}, "rotation matrix"),
        ({"omega": [np.inf, 0.0, 0.0]}, "omega"),
        ({"before": short}, "plan of 15 steps, got 4"),
    ):
        with pytest.raises(ValueError, match=match):
            planner.plan(**({"h": REST, "target": target} | options))
    outside = REST.copy()
    outside[2] = 3.0
    for options, match in (
        ({"h": outside}, "h: platform z is at 3 m, expected 0.3 to 2.5 m; start inside"),
        ({"steps": None}, "steps"),
        ({"steps": 0}, "steps"),
        ({"targets": np.zeros((5, 2))}, "targets: expected at least 2 rows"),
    ):
        with pytest.raises(ValueError, match=match):
            follow(planner, **({"h": REST, "targets": lambda t: target, "steps": 5} | options))
    moving = REST.copy()
    moving[[6, 9]] = 0.41, 0.5
    assert "stops at" in planner.complaint(moving)
    moving[9] = 0.7
    assert "at most 0.6 m/s" in planner.complaint(moving)
