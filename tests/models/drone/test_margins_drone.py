"""The bandwidth at which the drone's loop breaks: formula, linearisation and flight."""

from __future__ import annotations

import importlib

import control as ct
import numpy as np
import pytest

from phyfilter_ctl import models

ROOM = f"{models.__name__}.drone"
margins = importlib.import_module(f"{ROOM}.margins")
params = importlib.import_module(f"{ROOM}.params").params

OUTER = 1.9
# The continuous formula leaves sampling out: (1 - e^(-w h))/h stands for w, 9 % at w h = 0.17.
OF_FORMULA = 0.10
# The sampled formula leaves out rotor drag alone, 0.2 1/s; bisection to 0.5 %.
OF_SAMPLED = 0.01


def determinant(bandwidth: float, outer: float) -> complex:
    """1 + F (Act - 1) + Act (Kp/s^2 + Kd/s) where its phase jumps: least over the imaginary axis, F of order 1."""
    omega = np.geomspace(10.0, 100.0, 4000)
    s = 1j * omega
    vehicle, dt = params().vehicle, params().sampling.dt
    act = np.exp(-s * (vehicle.delay + dt / 2)) / (vehicle.motor_lag * s + 1.0)
    kp, kd = outer**2, 2.0 * params().tuning.damping * outer
    value = 1.0 + bandwidth / (s + bandwidth) * (act - 1.0) + act * (kp / s**2 + kd / s)
    return complex(value[np.argmin(np.abs(value))])


@pytest.mark.slow
@pytest.mark.parametrize("outer", [OUTER, pytest.param(2.8, marks=pytest.mark.slow)])
def test_complete_formula_is_where_the_characteristic_function_vanishes(outer):
    limit = margins.predicted(outer).complete
    assert abs(determinant(limit, outer)) < 1e-3
    assert abs(determinant(0.9 * limit, outer)) > 0.02


@pytest.mark.slow
def test_flight_breaks_where_the_complete_formula_says():
    found = margins.breaking_bandwidth(OUTER, low=80.0, high=95.0, duration=6.0)
    formula = margins.predicted(OUTER)
    assert found == pytest.approx(formula.complete, rel=OF_FORMULA)
    assert found == pytest.approx(formula.sampled, rel=OF_SAMPLED)
    # The inner loop alone allows more.
    assert formula.inner > 1.2 * formula.complete


@pytest.mark.slow
def test_linearised_loop_agrees_with_flight_and_formula():
    exact = margins.exact_bandwidth(OUTER, low=80.0, high=90.0, tolerance=0.005)
    assert exact == pytest.approx(margins.predicted(OUTER).sampled, rel=OF_SAMPLED)


@pytest.mark.slow
def test_late_command_as_g_is_a_slower_filter():
    """1 + w h lateness divides the bandwidth: first order in w h, so 6 %."""
    held = margins.predicted(OUTER).sampled
    late = margins.exact_bandwidth(OUTER, "commanded", low=100.0, high=120.0, tolerance=0.01)
    assert late == pytest.approx(held / (1.0 - held * params().sampling.dt), rel=0.06)


def test_applied_thrust_has_no_limit():
    assert margins.breaking_bandwidth(OUTER, "applied") == np.inf
    assert margins.exact_bandwidth(OUTER, "applied", which="all") == np.inf


@pytest.mark.slow
def test_vehicle_breaks_in_the_horizontal_first_where_the_force_wanted_is_g():
    whole = margins.exact_bandwidth(OUTER, "commanded", which="all", low=5.0, high=50.0, tolerance=0.1)
    assert whole < 0.2 * margins.predicted(OUTER).complete


def test_limit_below_the_range_is_an_error():
    with pytest.raises(ValueError, match="low: the loop breaks at 150 rad/s already"):
        margins.breaking_bandwidth(OUTER, low=150.0)


def test_held_force_is_the_commanded_one():
    """The diagram of the formula: one filter of order 1 a channel, fed with F as it is now."""
    loop = margins._loop(margins._method(OUTER, 5.0, "held"), "held")
    assert isinstance(loop, ct.InterconnectedSystem)
    estimator = loop.syslist[loop.syslist_index["estimator"]]
    assert isinstance(estimator, ct.InterconnectedSystem)
    assert [part.name for part in estimator.syslist] == ["momentum", "prior", "filter"]
    assert estimator.syslist[1].nstates == 0  # neither lag nor delay
