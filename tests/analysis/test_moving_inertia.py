"""Sets of inertia matrices and inertia that moves: exact vertices, closed forms, hand-made loops, simulations."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import control as ct
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eigvals, expm

from phyfilter_ctl import (
    FilterMargins,
    InertiaCertificate,
    Loop,
    PhyFilter,
    Status,
    inertia_tolerance,
    margins,
    place_poles,
    stack,
)
from phyfilter_ctl.analysis import configuration_hull
from phyfilter_ctl.analysis.margins._exact import exact, is_positive_definite
from phyfilter_ctl.analysis.margins.filter_margins import build_loop
from phyfilter_ctl.analysis.margins.openings import _root_mean_square, open_at_inertia, side_by_side

# Eigenvalues of matrices of a few states, no repeated ones among them.
CLOSE = 1e-9
# Growth over a few periods, in which the other states have not died out quite.
SIMULATED = 1e-3
LAG = ct.tf(1, [0.05, 1])


def held(margin: FilterMargins, **sets: Any) -> InertiaCertificate:
    """A constant M of a set, in the loop of these margins."""
    return inertia_tolerance(margin.filter, margin.around, rate=0.0, **sets)


def repeated(n: int, w: float = 20.0) -> PhyFilter:
    return PhyFilter.from_poles([-w] * n)


def spd(rng: np.random.Generator, n: int) -> np.ndarray:
    root = rng.standard_normal((n, n))
    return root @ root.T + 0.3 * np.eye(n)


# -- sets of constant matrices --------------------------------------------------------------------------------------

ARM = np.array([[0.9, 0.25, 0.05], [0.25, 0.3, 0.04], [0.05, 0.04, 0.02]])


@pytest.mark.parametrize("M_hat", [np.diag([10.0, 0.01]), ARM], ids=["mixed units", "arm"])
def test_interval_matrices_by_all_their_vertices(M_hat: np.ndarray):
    """Every corner of the box of symmetric matrices, 10 % off a centre that is not M_hat."""
    n, centre = len(M_hat), 1.3 * M_hat
    deviation = 0.1 * np.abs(M_hat)
    rows, columns = np.triu_indices(n)
    found = []
    for signs in itertools.product((-1.0, 1.0), repeat=len(rows)):
        M = centre.copy()
        M[rows, columns] += np.array(signs) * deviation[rows, columns]
        M[columns, rows] = M[rows, columns]
        found += list(eigvals(M_hat, M).real)
    margin = margins(repeated(3))
    low, high = held(margin, M_hat=M_hat, vertices=[centre], within=deviation).ratios.real
    # The corners' own rows attain the ends: v' M v has both extremes at sign patterns.
    assert (low, high) == pytest.approx((min(found), max(found)), rel=1e-7)
    assert held(margin, M_hat=M_hat, vertices=[centre], within=deviation).status == "proven"


@pytest.mark.parametrize("seed", range(5))
def test_hull_holds_every_mixture_and_knows_no_units(seed: int):
    rng = np.random.default_rng(seed)
    M_hat, vertices = spd(rng, 4), np.array([spd(rng, 4) for _ in range(5)])
    margin = margins(repeated(3))
    low, high = held(margin, M_hat=M_hat, vertices=vertices).ratios.real
    shares = rng.dirichlet(np.ones(5), 400)
    mixed = [eigvals(M_hat, np.tensordot(share, vertices, axes=1)).real for share in shares]
    assert low * (1.0 - CLOSE) <= np.min(mixed)
    assert np.max(mixed) <= high * (1.0 + CLOSE)
    corners = [eigvals(M_hat, M).real for M in vertices]
    assert (low, high) == pytest.approx((np.min(corners), np.max(corners)), rel=CLOSE)
    units = np.diag([1e3, 1.0, 1e-4, 30.0])
    scaled = held(margin, M_hat=units @ M_hat @ units, vertices=units @ vertices @ units).ratios.real
    assert scaled == pytest.approx([low, high], rel=1e-7)


def test_what_configurations_leave_between_them():
    """M of a double pendulum at 2,000 angles: in the cell's segment plus the deviation, which a quarter of it needs."""

    def inertia(q: np.ndarray) -> np.ndarray:
        return np.array([[3.0 + 2.0 * np.cos(q[0]), 1.0 + np.cos(q[0])], [1.0 + np.cos(q[0]), 1.0]])

    vertices, deviation = configuration_hull(inertia, [-2.5], [2.5], points=11)
    angles = np.linspace(-2.5, 2.5, 2000)
    cell = np.minimum((angles + 2.5) // 0.5, 9).astype(int)
    share = (angles + 2.5) / 0.5 - cell
    straight = (1 - share)[:, None, None] * vertices[cell] + share[:, None, None] * vertices[cell + 1]
    off = np.abs(np.array([inertia(np.array([q])) for q in angles]) - straight).max(axis=0)
    assert np.all(off <= deviation + 1e-12)
    assert off[0, 0] > 0.9 * deviation[0, 0]
    with pytest.raises(ValueError, match="no trigonometric polynomial"):
        configuration_hull(lambda q: [[2.0 + q[0] ** 2]], [-1.0], [1.0])


def test_matrices_that_are_refused():
    margin = margins(repeated(3))
    for given, text in (
        ({"vertices": [np.eye(3), np.eye(3)]}, "expected shape"),
        ({"vertices": [[1.0, -1.0], [1.0, 1.0]]}, r"vertices\[0\]: expected a positive definite"),
        ({"vertices": []}, "expected a list of inertia"),
        ({"vertices": [np.eye(3)]}, "expected the same"),
        ({"vertices": [np.eye(2)], "within": -np.eye(2)}, "bounds of 0 or more"),
    ):
        with pytest.raises(ValueError, match=text):
            held(margin, M_hat=np.eye(2), **given)
    assert "singular M" in held(margin, M_hat=[1.0], vertices=[1.0], within=[[1.0]]).message


# -- exact arithmetic -----------------------------------------------------------------------------------------------


def test_positive_definite_is_decided_without_rounding():
    size = 8  # Hilbert's matrix: least eigenvalue 1e-10, far below what one entry changes
    hilbert = np.array([[Fraction(1, i + j + 1) for j in range(size)] for i in range(size)], dtype=object)
    least = Fraction(1, 10**10)
    unit = np.eye(size, dtype=int)
    assert is_positive_definite(hilbert)
    assert is_positive_definite(hilbert - least * unit)
    assert not is_positive_definite(hilbert - 2 * least * unit)
    assert not is_positive_definite(exact(np.array([[1.0, 1.0], [1.0, 1.0]])))
    assert is_positive_definite(exact(np.array([[1.0, 1.0], [1.0, 1.0 + 2.3e-16]])))


# -- the loop -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [1, 2, 3, 4])
@pytest.mark.parametrize("actuator", [None, LAG], ids=["ideal", "lag"])
def test_opened_loop_closes_to_the_margins_poles(n: int, actuator: ct.TransferFunction | None):
    """Constant ratios: roots of the characteristic polynomial, or the eigenvalues of the other sampled assembly."""
    filter = place_poles(-10.0 * np.arange(1.0, n + 1.0))
    for dt, late in ((None, 0.0), (0.004, 0.0), (0.004, 0.006)):
        _, loop = build_loop(filter, Loop(actuator=actuator, delay=late), dt)
        opening = open_at_inertia(loop)
        for mu in (0.4, 1.0, 2.5):
            own = np.linalg.eigvals(opening.closed(mu))
            own = np.delete(own, np.argmin(np.abs(own))) if dt is not None and not late else own
            known = loop.roots(mu)
            for value in known:
                assert np.min(np.abs(own - value)) < 1e-6 * np.max(np.abs(known))


def test_coupled_axes_with_filters_of_their_own():
    """Closed-loop poles are zeros of det(I + F (M_hat M^-1 Act - I)), evaluated as it stands."""
    rng = np.random.default_rng(3)
    filters = [place_poles([-5.0, -9.0]), place_poles([-20.0, -25.0, -31.0]), place_poles([-12.0])]
    M_hat, M = np.diag([2.0, 0.1, 30.0]), spd(rng, 3)
    opening = side_by_side([open_at_inertia(build_loop(f, Loop(actuator=LAG), None)[1]) for f in filters])
    mu = M_hat @ np.linalg.inv(M)
    poles = np.linalg.eigvals(opening.closed(mu))
    for s in poles:
        F = np.diag([f(s) for f in filters])
        whole = np.eye(3) + F @ (mu * LAG(s) - np.eye(3))
        assert np.linalg.svd(whole, compute_uv=False)[-1] < 1e-8 * np.linalg.norm(whole, 2)
    verdict = inertia_tolerance(stack(filters), Loop(actuator=LAG), vertices=[M], M_hat=M_hat)
    assert (verdict.status is Status.PROVEN) == (poles.real.max() < 0.0)
    lost = inertia_tolerance(stack(filters), Loop(actuator=LAG), vertices=[M, 0.01 * M], M_hat=M_hat)
    assert (lost.status, lost.message) == (Status.REFUTED, "unstable for a constant M: vertex 1")


def test_motion_within_a_step_stays_below_its_bound():
    """Force behind a lag over a step, with a late command: what a mu of deviation 1 can add against |spread x|."""
    rng = np.random.default_rng(1)
    _, loop = build_loop(repeated(2), Loop(actuator=LAG, delay=0.013), 0.02)
    opening = open_at_inertia(loop)
    assert opening.dt is not None
    t = (np.arange(2000) + 0.5) * opening.dt / 2000
    for _ in range(20):
        x = rng.standard_normal(len(opening.A))
        mean_square = float(np.sum((opening.spread @ x) ** 2))
        assert float((opening.C @ x)[0]) ** 2 <= mean_square * (1.0 + CLOSE)
    assert len(opening.spread) > 1
    assert not opening.is_even
    # Bang-bang mu against the force itself, from the actuator at rest with commands 1 and -1.
    p = np.where(t < 0.013, 1.0 - np.exp(-t / 0.05), 0.0)
    begin = 1.0 - np.exp(-0.013 / 0.05)
    p = np.where(t < 0.013, p, -1.0 + (begin + 1.0) * np.exp(-(t - 0.013) / 0.05))
    worst = np.mean(np.abs(p))
    R = _root_mean_square(loop.actuator, 0.02, 0.013)
    bound = np.linalg.norm(R @ np.array([0.0, -1.0, 1.0]))
    assert worst <= bound
    assert bound == pytest.approx(np.sqrt(np.mean(p**2)), rel=1e-5)


# -- any speed ------------------------------------------------------------------------------------------------------

# The circle with diameter [1/r, r] touches the Nyquist curve: (3 + 2 sqrt 2), 4 for two and three repeated poles.
LIMITS = {2: 3.0 + 2.0 * np.sqrt(2.0), 3: 4.0}


@pytest.mark.parametrize("n", LIMITS)
@pytest.mark.parametrize("full", [False, True], ids=["low-pass", "type n"])
@pytest.mark.parametrize("w", [0.3, 20.0, 700.0])
def test_common_lyapunov_function_up_to_the_circle(n: int, full: bool, w: float):
    filter = PhyFilter.from_poles([-w] * n, repeated(n, w).a if full else None)
    for factor, status in ((0.999, Status.PROVEN), (1.001, Status.OPEN)):
        r = factor * LIMITS[n]
        found = inertia_tolerance(filter, ratios=(1.0 / r, r))
        assert found.status is status
        # By frequency: complex ratios about the middle.
        margin = margins(filter, Loop(inertia_ratio=0.5 * (r + 1.0 / r)))
        assert (margin.ratio_radius > 0.5 * (r - 1.0 / r)) == (status is Status.PROVEN)
    assert inertia_tolerance(repeated(1, w), ratios=(1e-3, 1e3)).status is Status.PROVEN


def test_the_matrix_falls_for_axes_that_turn():
    """kron(P, I) by numpy over random symmetric matrices with eigenvalues in the range."""
    rng = np.random.default_rng(5)
    filter = repeated(3)
    r = 3.9
    found = inertia_tolerance(filter, ratios=(1.0 / r, r))
    (P,), system = found.lyapunov, found.opening
    assert system is not None
    A, B, C = (np.asarray(part) for part in (system.A, system.B, system.C))
    for _ in range(50):
        turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        S = turn @ np.diag(rng.uniform(1.0 / r, r, 3)) @ turn.T
        closed = np.kron(A, np.eye(3)) + np.kron(B, np.eye(3)) @ S @ np.kron(C, np.eye(3))
        V = np.kron(P, np.eye(3))
        assert np.linalg.eigvalsh(closed.T @ V + V @ closed).max() < 0.0
    assert np.linalg.eigvalsh(P).min() > 0.0


def simulated(filter: PhyFilter, ratio, times: np.ndarray) -> np.ndarray:
    """|states of F| at times, from M(t) x' = tau, tau = -f_hat, F in companion form on M_hat x' - tau."""
    state, sizes = np.ones(filter.order), []
    for begin, end in itertools.pairwise(times):

        def slope(t: float, w: np.ndarray) -> np.ndarray:
            tau = -filter.b @ w
            acceleration = tau * ratio(t)  # M_hat = 1
            return np.append(w[1:], -filter.a @ w + acceleration - tau)

        state = solve_ivp(slope, (begin, end), state, rtol=1e-7, atol=1e-9, method="DOP853").y[:, -1]
        sizes.append(np.linalg.norm(state))
        state = state / sizes[-1]
    return np.array(sizes)


def test_switching_that_diverges_is_simulated():
    """n = 3: every constant M between M_hat/8 and 8 M_hat is stable, switched every 68 ms it diverges."""
    filter = repeated(3)
    assert inertia_tolerance(filter, ratios=(1 / 8, 8.0), rate=0.0).status is Status.PROVEN
    edges = 0.068 * np.arange(25.0)
    sizes = simulated(filter, lambda t: 8.0 if int((t + 1e-9) // 0.068) % 2 else 1 / 8, edges)
    assert np.prod(sizes[8:]) ** (1 / 8) == pytest.approx(1.283, abs=2e-3)
    lost = inertia_tolerance(filter, ratios=(1 / 8, 8.0))
    assert lost.status is Status.REFUTED
    assert lost.motion is not None
    motion = lost.motion
    edges = (motion.period * np.arange(13.0)[:, None] + motion.times[:-1]).ravel()
    sizes = simulated(filter, lambda t: motion.ratio(t + 1e-9), edges)
    assert np.prod(sizes[8:24]) ** (1 / 8) == pytest.approx(motion.growth, rel=SIMULATED)


def test_momentum_form_only_shifts_the_estimate():
    """A skater: (J omega)' = tau. f_hat is what the loop makes of f = -J' omega, nothing else."""
    filter, J_hat = repeated(2), 2.0

    def J(t: float) -> float:
        return 2.0 + 0.9 * np.sin(7.0 * t)

    def physics(t: float, state: np.ndarray) -> np.ndarray:
        w, momentum = state[:2], state[2]
        omega, rate = momentum / J(t), 6.3 * np.cos(7.0 * t)
        tau = -filter.b @ w - 3.0 * omega + np.sin(t)
        acceleration = (tau - rate * omega) / J(t)
        return np.array([w[1], -filter.a @ w + J_hat * acceleration - tau, tau])

    t = np.linspace(0.0, 1.5, 151)
    whole = solve_ivp(
        physics, (0.0, 1.5), [0.0, 0.0, 2.0], t_eval=t, rtol=1e-9, atol=1e-11, dense_output=True
    )
    opening = inertia_tolerance(filter, ratios=(J_hat / 2.9, J_hat / 1.1)).opening
    assert opening is not None
    A, B, C = (np.asarray(part) for part in (opening.A, opening.B, opening.C))

    def loop(time: float, w: np.ndarray) -> np.ndarray:
        mu, omega = J_hat / J(time), whole.sol(time)[2] / J(time)
        f, command = -6.3 * np.cos(7.0 * time) * omega, -3.0 * omega + np.sin(time)
        return (A + mu * B @ C) @ w + B[:, 0] * (mu * (f + command) - command)

    w = solve_ivp(loop, (0.0, 1.5), [0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-11).y
    assert -C[0] @ w == pytest.approx(filter.b @ whole.y[:2], abs=1e-6)


@pytest.mark.parametrize("method", ["exact", "euler", "tustin"])
def test_sampled_loop_that_switches_as_it_runs(method):
    """SampledPhyFilter itself in the loop, M switched at samples: growth as certified motion has it."""
    sampled = repeated(3).sampled(0.004, method)
    lost = inertia_tolerance(sampled, ratios=(1 / 9, 6.5))
    assert lost.motion is not None
    period = round(lost.motion.period / 0.004)
    x, tau, size = np.zeros(1), np.array([1.0]), []
    state = sampled.start(x)
    for k in range(16 * period):
        x = x + 0.004 * tau * lost.motion.ratio(0.004 * k + 1e-9)
        state, f_hat = sampled.step(state, x, tau)
        tau = -f_hat
        if k % period == period - 1:
            size.append(abs(float(f_hat[0])))
    assert size[-1] / size[-2] == pytest.approx(lost.motion.growth, rel=0.01)
    assert inertia_tolerance(sampled, ratios=(0.4, 2.5)).status is Status.PROVEN


def test_delay_by_the_circle():
    """First order: s + mu w e^(-s d); small gain about 1 is |w e/(j omega + w e)| r < 1, found on a dense grid."""
    omega = np.linspace(1e-3, 400.0, 400_001)
    P = 20.0 * np.exp(-0.06j * omega)
    radius = np.min(np.abs(1j * omega + P) / np.abs(P))
    for factor, status in ((0.999, Status.PROVEN), (1.001, Status.OPEN)):
        r = factor * radius
        assert (
            inertia_tolerance(PhyFilter([20.0]), Loop(delay=0.06), ratios=(1.0 - r, 1.0 + r)).status is status
        )


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({}, "expected one of them, the set in which the inertia is, got none"),
        ({"ratios": (1.0, 2.0), "vertices": [1.0], "M_hat": 1.0}, "got ratios and vertices"),
        ({"vertices": [1.0]}, "M_hat: goes with every set but ratios"),
        ({"ratios": (0.5, 2.0), "M_hat": 1.0}, "M_hat: goes with every set but ratios"),
        ({"between": (0.5, 2.0), "M_hat": 1.0}, "between, within: are of a constant M"),
        ({"ratios": (0.5, 2.0), "loop": Loop(1.0, 1.0)}, "take loop.inner"),
        ({"ratios": (0.5, 2.0), "loop": Loop(g="applied")}, "known for the command as g"),
        ({"ratios": (0.5, 2.0), "loop": Loop(inertia_ratio=2.0)}, "expected 1, as the set says"),
        ({"ratios": (2.0, 1.0)}, "0 < low <= high"),
        ({"ratios": (0.5, 2.0), "rate": -1.0}, "rate"),
        ({"ratios": (0.5, 2.0), "degree": 3}, "degree: expected"),
        ({"ratios": (0.5, 2.0), "loop": Loop(delay=0.01), "rate": 1.0}, "give dt"),
        ({"vertices": [[1.0, 2.0], [1.0, 3.0]], "M_hat": [1.0, 1.0], "rate": 1.0}, "rate other than 0"),
    ],
)
def test_questions_that_are_refused(given, text):
    with pytest.raises(ValueError, match=text):
        inertia_tolerance(repeated(3), **given)


def test_a_constant_M_in_the_complete_loop():
    """With outer gains every end of the stable ratios is that of the margins, and the inner loop is no excuse."""
    filter, loop = PhyFilter([12.0]), Loop(10.0, 6.0, actuator=0.1, delay=0.02)
    (low, high), *_ = margins(filter, loop).stable_ratios
    for ends, status in (
        ((1.01 * low, 0.99 * high), Status.PROVEN),
        ((0.99 * low, 0.99 * high), Status.REFUTED),
    ):
        assert inertia_tolerance(filter, loop, ratios=ends, rate=0.0).status is status
    assert (
        inertia_tolerance(filter, loop.inner, ratios=(0.99 * low, 0.99 * high), rate=0.0).status
        is Status.PROVEN
    )
    assert (
        inertia_tolerance(filter, loop, vertices=[[1.0, 1.0]], M_hat=[0.99 * low, 1.0], rate=0.0).status
        is Status.REFUTED
    )


def test_one_constant_member_that_is_unstable_refutes():
    lost = inertia_tolerance(repeated(3), ratios=(0.5, 9.5))
    assert (lost.status, lost.method) == (Status.REFUTED, "eigenvalues")
    assert lost.to_dict()["status"] == "refuted"


def random_attacks(
    closed: Callable[[float], np.ndarray], low: float, high: float, count: int, steps: int, seed: int
) -> np.ndarray:
    """ln of how far states grow under switching every 0.1 s at the soonest, dwell times of each attack its own."""
    rng = np.random.default_rng(seed)
    flows = np.array([expm(0.1 * closed(mu)) for mu in (low, high)])
    x = rng.standard_normal((count, flows.shape[-1]))
    growth, mode, left = np.zeros(count), rng.integers(0, 2, count), np.zeros(count)
    stay = np.exp(rng.uniform(0.0, np.log(40.0), (count, 2)))
    for _ in range(steps):
        turn = left <= 0.0
        mode = np.where(turn, 1 - mode, mode)
        left = np.where(turn, stay[np.arange(count), mode] * rng.uniform(0.9, 1.1, count), left - 1.0)
        size = np.linalg.norm(x, axis=1)
        x = np.einsum("kij,kj->ki", flows[mode], x / size[:, None])
        growth += np.log(np.linalg.norm(x, axis=1))
    return growth


@pytest.mark.parametrize("n", [2, 3, 4])
def test_random_switching_dies_out_where_proven(n: int):
    r = 0.99 * {**LIMITS, 4: 3.373}[n]
    found = inertia_tolerance(repeated(n, 1.0), ratios=(1.0 / r, r))
    assert found.status is Status.PROVEN
    assert found.opening is not None
    A, B, C = (np.asarray(part) for part in (found.opening.A, found.opening.B, found.opening.C))
    assert np.max(random_attacks(lambda mu: A + mu * B @ C, 1.0 / r, r, 500, 600, n)) < 0.0
