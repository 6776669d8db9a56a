"""Inertia that moves, by linear matrix inequalities (extra lmi): the solver's matrices against plain numpy."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.linalg import eigvals

from phyfilter_ctl import InertiaCertificate, Loop, PhyFilter, Status, inertia_tolerance, place_poles, stack
from phyfilter_ctl.analysis.margins import _inequalities
from phyfilter_ctl.analysis.margins.filter_margins import build_loop
from phyfilter_ctl.analysis.margins.openings import open_at_inertia

pytest.importorskip("cvxpy")

CUBIC = PhyFilter.from_poles([-20.0] * 3)


def loop_of(found: InertiaCertificate) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    assert found.opening is not None
    return tuple(np.asarray(part) for part in (found.opening.A, found.opening.B, found.opening.C))


def between(found: InertiaCertificate, mu: float) -> tuple[np.ndarray, np.ndarray]:
    """P and dP/dmu at a ratio."""
    i = int(np.clip(np.searchsorted(found.knots, mu) - 1, 0, len(found.knots) - 2))
    a, b = found.knots[i : i + 2]
    slope = (found.lyapunov[i + 1] - found.lyapunov[i]) / (b - a)
    return found.lyapunov[i] + (mu - a) * slope, slope


@pytest.mark.parametrize("rate", [3.0, pytest.param(12.0, marks=pytest.mark.slow)])
def test_parameter_dependent_function_falls(rate: float):
    """At 500 ratios and both rates, by eigenvalues; the same range at any speed diverges."""
    found = inertia_tolerance(CUBIC, ratios=(1 / 8, 8.0), rate=rate)
    assert (found.status, found.method) == (Status.PROVEN, "parameter-dependent")
    A, B, C = loop_of(found)
    for mu in np.geomspace(1 / 8, 8.0, 500):
        P, slope = between(found, mu)
        assert np.linalg.eigvalsh(P)[0] > 0.0
        flow = P @ (A + mu * B @ C)
        for sign in (-1.0, 1.0):
            assert np.linalg.eigvalsh(flow + flow.T + sign * rate * mu * slope)[-1] < 0.0


@pytest.mark.parametrize("lag", [False, True], ids=["ideal", "lag"])
def test_parameter_dependent_function_falls_from_sample_to_sample(lag: bool):
    """At 100 ratios, 9 ratios after the step, and, behind a lag, every deviation within it."""
    import control as ct

    actuator = ct.tf(1, [0.01, 1]) if lag else None
    filter, r, rate, dt = (CUBIC, 4.0, 3.0, 0.004) if lag else (CUBIC, 6.5, 5.0, 0.004)
    found = inertia_tolerance(filter, Loop(actuator=actuator), ratios=(1 / 6.5, r), rate=rate, dt=dt)
    assert found.status is Status.PROVEN
    assert found.method == "parameter-dependent"
    A, B, C = loop_of(found)
    opening = open_at_inertia(build_loop(filter, Loop(actuator=actuator), dt)[1])
    for mu in np.geomspace(1 / 6.5, r, 100):
        P, _ = between(found, mu)
        for after in np.clip(mu * np.exp(rate * dt * np.linspace(-1.0, 1.0, 9)), 1 / 6.5, r):
            later, _ = between(found, after)
            directions = [np.zeros(A.shape[0])]
            if lag:
                directions += [
                    sign * mu * np.expm1(rate * dt) * row for row in opening.spread for sign in (-1, 1)
                ]
            for direction in directions:
                step = A + B @ (mu * C + direction[None])
                assert np.linalg.eigvalsh(step.T @ later @ step - P)[-1] < 0.0


@pytest.mark.parametrize(("degree", "r"), [(4, 4.6), (6, 5.0), pytest.param(8, 5.2, marks=pytest.mark.slow)])
def test_higher_degrees_prove_more(degree: int, r: float):
    """V = P of the products of states, along random states and ratios."""
    found = inertia_tolerance(CUBIC, ratios=(1 / r, r), degree=degree)
    assert found.method == f"common of degree {degree}"
    assert inertia_tolerance(CUBIC, ratios=(1 / r, r)).status is Status.OPEN
    A, B, C = loop_of(found)
    half = degree // 2
    entries = list(itertools.combinations_with_replacement(range(3), half))
    weights = [np.sqrt(len(set(itertools.permutations(entry)))) for entry in entries]

    def value(x: np.ndarray) -> np.ndarray:
        products = np.array(
            [w * np.prod(x[:, list(e)], axis=1) for w, e in zip(weights, entries, strict=True)]
        )
        return np.einsum("ik,ij,jk->k", products, found.lyapunov[0], products)

    x = np.random.default_rng(0).standard_normal((2000, 3))
    for mu in np.geomspace(1 / r, r, 7):
        step = 1e-6 * x @ (A + mu * B @ C).T / np.abs(A).max()
        assert np.all(value(x) > 0.0)
        assert np.all(value(x + step) < value(x - step))


def test_sampled_products_of_states():
    found = inertia_tolerance(CUBIC, ratios=(1 / 4.3, 4.3), dt=0.002, degree=4)
    assert found.method == "common of degree 4"


BANK = stack([PhyFilter.from_poles([-20.0] * 2), PhyFilter.from_poles([-10.0] * 3)])
COUPLED = np.array([[[8.0, 0.3], [0.3, 1.0]], [[0.3, -0.02], [-0.02, 0.9]]])


@pytest.mark.parametrize("dt", [None, 0.01])
@pytest.mark.parametrize("units", [1.0, 1e-3])
def test_coupled_axes_at_any_speed(dt: float | None, units: float):
    """V falls at random mixtures of the vertices, in any units; too wide for the range of the ratio alone."""
    scale = np.diag([1.0, units])
    M_hat, vertices = scale @ np.diag([1.5, 0.8]) @ scale, scale @ COUPLED @ scale
    found = inertia_tolerance(BANK, vertices=vertices, M_hat=M_hat, dt=dt)
    assert (found.status, found.method) == (Status.PROVEN, "vertices")
    assert ("M changes at the samples only" in found.assumptions) == (dt is not None)
    A, B, C = loop_of(found)
    (P,) = found.lyapunov
    same = np.diag(np.exp2(-np.round(0.5 * np.log2(np.diag(M_hat)))))
    for share in np.linspace(0.0, 1.0, 21):
        M = same @ (share * vertices[0] + (1.0 - share) * vertices[1]) @ same
        closed = A + B @ (same @ M_hat @ same) @ np.linalg.inv(M) @ C
        falls = closed.T @ P @ closed - P if dt is not None else P @ closed + closed.T @ P
        assert np.linalg.eigvalsh(falls)[-1] < 0.0


def test_every_constant_mixture_of_coupled_axes():
    """P of the mixture proves what eigenvalues of sampled mixtures show."""
    found = inertia_tolerance(BANK, vertices=2.0 * COUPLED, M_hat=[1.5, 0.8], rate=0.0)
    assert (found.status, len(found.lyapunov)) == (Status.PROVEN, 2)
    A, B, C = loop_of(found)
    for share in np.linspace(0.0, 1.0, 51):
        M = 2.0 * (share * COUPLED[0] + (1.0 - share) * COUPLED[1])
        assert eigvals(A + B @ np.diag([1.5, 0.8]) @ np.linalg.inv(M) @ C).real.max() < 0.0


def test_switching_of_coupled_axes_that_diverges():
    slow = stack([place_poles([-20.0] * 3), place_poles([-18.0] * 3)])
    vertices = np.array([np.diag([8.0, 1.0]), np.diag([1 / 8, 1.0])]) + 0.01 * np.ones((2, 2))
    found = inertia_tolerance(slow, vertices=vertices, M_hat=[1.0, 1.0])
    assert found.status is Status.REFUTED
    assert found.motion is not None
    assert found.motion.growth > 1.1
    assert found.motion.vertices.tolist() == [0, 1]


def test_what_the_solver_says_is_not_believed():
    """A matrix that is off by little, as a solver's may be, does not hold."""
    opening = open_at_inertia(build_loop(CUBIC, Loop(), None)[1]).by_clock()
    wanted = _inequalities.small_gain(opening, 1 / 3.9, 3.9)
    P = _inequalities.solved_by_riccati(opening, 1 / 3.9, 3.9)
    assert P is not None
    assert wanted.hold([P])
    assert not wanted.hold([0.9 * P])
    assert not wanted.hold([P * np.nan])
    assert not _inequalities.small_gain(opening, 1 / 4.1, 4.1).hold([P])
