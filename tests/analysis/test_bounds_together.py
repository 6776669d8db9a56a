"""Several derivatives bounded at once: closed forms, brute force on another grid, and the course through the filter."""

import control as ct
import numpy as np
import pytest
from scipy.optimize import linprog

import phyfilter_ctl as pf
from phyfilter_ctl import error_bound

# To what below and above meet; most do to 1e-4.
GAP = 2e-3
TYPE_3 = pf.place_poles([-20.0, -15 + 10j, -15 - 10j], type=3)


@pytest.mark.parametrize("slope", [5.0, 40.0, 400.0])
def test_one_pole_in_closed_form(slope):
    """gamma goes from -1 to 1 as fast as it may and the error is taken there: slope/a (1 - exp(-2 a / slope))."""
    result = error_bound(pf.PhyFilter([20.0]), {0: 1.0, 1: slope})
    exact = slope / 20.0 * (1.0 - np.exp(-40.0 / slope))
    assert result.certificate.lower <= exact <= result.bound <= exact * (1.0 + GAP)
    assert result.exact
    if slope == 40.0:  # both alone promise 2: 1.58 times as much
        assert min(result.gains[0], result.gains[1] * slope) / result.bound == pytest.approx(
            1.0 / (1.0 - np.exp(-1.0)), rel=1e-3
        )


def brute_force(f, given, h, count):
    """Largest error over samples of gamma every h, differences for derivatives, F by trapezoids on its response."""
    t = h * np.arange(count)
    response = ct.impulse_response(ct.ss(f.transfer_function), t).outputs
    weights = -h * response
    weights[0] = 1.0 - 0.5 * h * response[0]
    rows, tops = [], []
    for j, bound in given.items():
        difference = np.eye(count)
        for _ in range(j):
            difference = np.diff(difference, axis=0) / h
        rows.append(difference)
        tops.append(np.full(len(difference), bound))
    A, b = np.vstack(rows), np.concatenate(tops)
    found = linprog(-weights, A_ub=np.vstack([A, -A]), b_ub=np.r_[b, b], bounds=(None, None), method="highs")
    return -found.fun


@pytest.mark.parametrize(
    ("f", "given"),
    [
        (pf.lowpass(2, 20.0), {0: 1.0, 1: 20.0}),
        (pf.lowpass(2, 20.0), {0: 1.0, 2: 400.0}),
        pytest.param(TYPE_3, {0: 1.0, 1: 20.0, 2: 400.0}, marks=pytest.mark.slow),
        pytest.param(pf.place_poles([-15.0, -40.0]), {0: 1.0, 1: 5.0, 2: 300.0}, marks=pytest.mark.slow),
    ],
)
def test_brute_force_agrees(f, given):
    result = error_bound(f, given)
    h = 0.02 / float(np.abs(f.poles).max())
    found = brute_force(f, given, 2.0 * h, 250 if len(given) == 2 else 600)
    # Differences instead of derivatives: first order in the step of 1/25 of the fastest time constant.
    assert found == pytest.approx(result.bound, rel=0.02)
    assert result.certificate.gap <= GAP
    assert result.bound <= min(result.gains[k] * given[k] for k in result.gains)


@pytest.mark.parametrize("given", [{0: 1.0, 1: 20.0}, {1: 20.0, 2: 400.0}, {0: 1.0, 2: 400.0}])
def test_the_course_keeps_all_bounds_and_attains_the_bound(given):
    """Through the sampled filter itself, matched: gamma from the course on a fine grid, x by its exact integral."""
    f = TYPE_3 if 0 not in given else pf.lowpass(2, 20.0)
    sampled = f.sampled(0.01, "matched")
    result = error_bound(sampled, given)
    fine, n = 40, 160
    h = sampled.dt / fine
    t = h * np.arange(n * fine + 1)
    course = result.worst_residual(t)
    lowest = min(given)
    for k, bound in given.items():
        derivative = course
        for _ in range(k - lowest):
            derivative = np.diff(derivative) / h
        assert np.abs(derivative).max() <= bound * (1.0 + 1e-6)
    gamma = (
        course if lowest == 0 else np.concatenate([[0.0], np.cumsum(0.5 * h * (course[1:] + course[:-1]))])
    )
    gamma = gamma - (gamma[0] if lowest else 0.0)
    x = np.concatenate([[0.0], np.cumsum(0.5 * h * (gamma[1:] + gamma[:-1]))])
    error = gamma[-1] - sampled.run(x[::fine])[-1, 0]
    # Straight lines for the course's parabolas on the fine grid.
    assert abs(error) == pytest.approx(result.bound, rel=3e-3)


def test_a_bound_that_adds_nothing_changes_nothing():
    f = pf.lowpass(2, 20.0)
    alone = error_bound(f, {1: 1.0}).bound
    assert error_bound(f, {0: 1e3, 1: 1.0}).bound == pytest.approx(alone, rel=1e-6)
    # Beyond the type, beside a lower one: less than that alone.
    both = error_bound(f, {0: 1.0, 2: 100.0})
    assert both.derivative == 0
    assert both.bound < 0.5 * both.gains[0]
    assert "derivatives 0 and 2 of gamma together" in both.describe()
    assert error_bound(f, {0: 1.0, 1: 0.0}).bound == 0.0
