"""Values that travel together: what they hold, and what they refuse before anything is computed."""

from __future__ import annotations

from dataclasses import fields

import control as ct
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl import Bounded, Gaussian, Loop

F = pf.PhyFilter([12.0])
LOOP = Loop(10.0, 6.0, actuator=0.1, delay=0.02)


def test_a_number_is_a_lag():
    for lag in (0.1, np.float64(0.1), ct.tf(1, [0.1, 1]), ct.tf2ss(ct.tf(1, [0.1, 1]))):
        found = pf.margins(F, Loop(10.0, 6.0, lag, 0.02))
        assert found.delay_margin == pytest.approx(pf.margins(F, LOOP).delay_margin, rel=1e-9)
    for none in (0.0, 0, None):
        assert pf.margins(F, Loop(actuator=none)).to_dict() == pf.margins(F).to_dict()


def test_the_inner_loop_has_all_but_the_gains():
    assert LOOP.inner == Loop(actuator=0.1, delay=0.02)
    assert LOOP.has_gains
    assert not LOOP.inner.has_gains
    assert Loop(kd=1.0).has_gains


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"kp": -1.0}, r"kp: expected a finite number >= 0 1/s\^2"),
        ({"kd": float("nan")}, "kd: "),
        ({"delay": -0.1}, "delay: "),
        ({"actuator": -0.1}, "actuator: expected a finite number >= 0 s"),
        ({"actuator": ct.tf(1, [1, -1])}, "open left half plane"),
        ({"inertia_ratio": 0.0}, "inertia_ratio: expected a positive"),
        ({"g": "measured"}, "g: expected 'commanded' or 'applied', got 'measured'"),
        ({"command_limit": 0.0}, "command_limit: expected a positive force"),
    ],
)
def test_a_loop_that_cannot_be_is_refused(given, message):
    with pytest.raises(ValueError, match=message):
        Loop(**given)


def test_a_limit_of_the_command_is_named_where_it_does_not_count():
    limited = Loop(10.0, 6.0, actuator=0.1, command_limit=2.0)
    assert "the command stays within its limit" in pf.margins(F, limited).assumptions
    assert "the command stays within its limit" not in pf.margins(F, LOOP).assumptions
    gusts = Gaussian(pf.gauss_markov(1.0, 0.5))
    assert "the command stays within its limit" in pf.tracking_error(F, limited, gusts, dt=0.01).assumptions
    assert pf.tracking_error(F, limited, {0: 0.5}, dt=0.01).command_limit == 2.0
    assert (
        "the command stays within its limit"
        in pf.inertia_tolerance(F, limited.inner, ratios=(0.9, 1.1)).assumptions
    )
    found = pf.largest_bandwidth(lambda w: pf.PhyFilter([w]), limited)
    assert found.message.endswith("while the command stays within its limit")
    with pytest.raises(ValueError, match="know no limit of the command, got command_limit=2"):
        pf.LoopGoal(limited)


def test_every_field_of_a_loop_counts_somewhere():
    """A change of each field alone changes what is said of a loop."""
    changes = {"kp": 11.0, "kd": 7.0, "actuator": 0.05, "delay": 0.01, "inertia_ratio": 1.2, "g": "applied"}
    assert {entry.name for entry in fields(Loop)} == {*changes, "command_limit"}
    base = pf.margins(F, LOOP).describe()
    given = {entry.name: getattr(LOOP, entry.name) for entry in fields(Loop)}
    for name, value in changes.items():
        assert pf.margins(F, Loop(**given | {name: value})).describe() != base, name


def test_bounds_of_a_mapping_are_those_of_the_residual():
    assert pf.error_bound(F, {1: 3.0}).bound == pf.error_bound(F, Bounded({1: 3.0})).bound
    assert Bounded({np.int64(1): np.float32(3.0)}).residual == {1: 3.0}
    assert Bounded([{1: 3.0}, {0: 0.1}]).parts == ({1: 3.0}, {0: 0.1})
    assert (Bounded({1: 3.0}).slope, Bounded({0: 1.0, 1: 3.0}).slope, Bounded().slope) == (3.0, None, None)


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ({"residual": 3.0}, TypeError, "residual: expected bounds by order"),
        ({"residual": [3.0]}, TypeError, "residual: expected bounds by order"),
        ({"residual": "1"}, TypeError, "residual: expected bounds by order"),
        ({"residual": {-1: 1.0}}, ValueError, "residual: expected derivative orders"),
        ({"residual": {True: 1.0}}, ValueError, "residual: expected derivative orders"),
        ({"residual": {0: -1.0}}, ValueError, r"residual\[0\]: "),
        ({"actuation": {0: float("inf")}}, ValueError, r"actuation\[0\]: "),
        ({"noise": -0.1}, ValueError, "noise: "),
        ({"inertia_error": 0.1}, ValueError, "give its bound too, rate="),
        ({"inertia_error": 0.1, "rate": 0.0}, ValueError, "give its bound too, rate="),
        ({"implementation": {"jitter": 1.0}}, TypeError, "implementation: expected an Implementation"),
    ],
)
def test_bounds_that_cannot_be_are_refused(given, error, message):
    with pytest.raises(error, match=message):
        Bounded(**given)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"noise": -0.1}, "noise: "),
        ({"position_noise": -0.1}, "position_noise: "),
        ({"residual": ct.tf([1.0, 0.0], [1.0, 1.0])}, "residual: expected a strictly proper"),
        ({"actuation": ct.tf([1.0], [1.0, -1.0])}, "actuation: expected a stable"),
    ],
)
def test_spectra_that_cannot_be_are_refused(given, message):
    with pytest.raises(ValueError, match=message):
        Gaussian(**given)


def test_what_a_question_does_not_count_is_refused():
    sampled = F.sampled(0.01)
    with pytest.raises(TypeError, match=r"disturbance: expected Gaussian.*for bounds see error_bound"):
        pf.error_variance(sampled, Bounded({1: 1.0}))  # type: ignore[arg-type]  # on purpose
    with pytest.raises(TypeError, match="disturbance: expected a Bounded"):
        pf.error_bound(sampled, Gaussian(noise=0.1))  # type: ignore[arg-type]  # on purpose
    for given in ({"actuation": pf.gauss_markov(1.0, 1.0)}, {"position_noise": 0.1}):
        with pytest.raises(ValueError, match="see tracking_error"):
            pf.error_variance(sampled, Gaussian(**given))
    with pytest.raises(ValueError, match="autocovariances; see tracking_error"):
        pf.error_variance(sampled, Gaussian([1.0, 0.5]))
    with pytest.raises(ValueError, match="noise: expected a standard deviation of the samples"):
        pf.tracking_error(sampled, LOOP, Gaussian(noise=pf.gauss_markov(1.0, 1.0)))


def test_one_for_each_channel_is_a_list():
    bank, slow = pf.stack([F, pf.PhyFilter([5.0])]), Loop(4.0, 3.0)
    each = pf.margins(bank, [LOOP, slow])
    assert [found.delay_margin for found in each] == [
        pf.margins(F, LOOP).delay_margin,
        pf.margins(pf.PhyFilter([5.0]), slow).delay_margin,
    ]
    tubes = pf.tracking_error(bank, slow, [{1: 1.0}, Bounded({1: 2.0})], dt=0.01)
    assert tubes[1].radius == pf.tracking_error(pf.PhyFilter([5.0]), slow, {1: 2.0}, dt=0.01).radius
    page = pf.analyze(bank, LOOP, {1: 1.0}, ratios=(0.9, 1.1))
    assert [set(found.moving_inertia) for found in page] == [{"constant M", "M of any speed"}] * 2
    with pytest.raises(
        ValueError, match="loop: expected one for all channels or one for each of the 2, got 3"
    ):
        pf.margins(bank, [LOOP] * 3)
