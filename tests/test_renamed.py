"""Names of 0.2 warn and work."""

from __future__ import annotations

import importlib
import re

import control as ct
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl import _renamed
from phyfilter_ctl.migrate import migrated

F = pf.PhyFilter.from_poles([-20.0] * 3)
LAG = ct.tf(1, [0.02, 1])
PLANT = ct.tf([1.0], [1.0, 3.0, 3.0, 1.0], inputs="u", outputs="y", name="plant")
LAW = ct.tf([2.0], [1.0], inputs="e", outputs="u", name="p")
DIAGRAM = ct.interconnect(
    [PLANT, LAW, ct.summing_junction(["r", "-y"], "e", name="error")], inputs="r", outputs="y"
)
NAMES = {"pf": pf, "F": F, "LAG": LAG, "DIAGRAM": DIAGRAM, "ct": ct, "np": np}
# What 0.2 wrote, one for each name and way of use.
OLD = [
    "pf.prior_margin(F, actuator=LAG, delay=0.01, inertia_ratio=1.2)",
    "pf.prior_margin(F, dt=0.002, g='applied')",
    "pf.prior_margin(F, actuator=ct.tf(1, [0.05, 1]))",
    "pf.loop_margin(F, kp=10.0, kd=6.0, delay=0.01, dt=0.002)",
    "pf.loop_margin(F, kp=0.0, kd=0.0)",
    "pf.disk_margin(ct.tf(1, [1, 1, 0]))",
    "pf.disk_margin(ct.tf(1, [1, 1, 0]), skew=0.5)",
    "pf.signal_margin(DIAGRAM, 'plant.u')",
    "pf.moving_inertia(F, ratios=(0.5, 2.0), rate=0.0, actuator=LAG)",
    "pf.saturation_margin(F, kp=10.0, kd=6.0, g='commanded')",
    "pf.largest_bandwidth(lambda w: pf.PhyFilter([w]), delay=0.02, modulus_margin=0.5)",
    "pf.ultimate_bound(F, residual={1: 3.0})",
    "pf.ultimate_bound(F, residual={0: 1.0, 1: 3.0}, noise=0.01, inertia_error=0.1, rate=2.0, method='exact')",
    "pf.error_variance(F.sampled(0.01), residual=pf.gauss_markov(1.0, 0.5), noise=0.01)",
    "pf.tracking_tube(F, kp=10.0, kd=6.0, residual=[{1: 2.0}, {0: 0.1}], actuation={0: 0.1}, dt=0.01)",
    "pf.tracking_deviation(F, kp=10.0, kd=6.0, residual=pf.gauss_markov(1.0, 0.5), dt=0.01)",
    "pf.analyze(F, kp=10.0, kd=6.0, residual={1: 3.0}, noise=0.01)",
    "pf.pole_zero_map(F)",
    "pf.LoopConstraint(kp=10.0, kd=6.0, modulus_margin=0.4)",
]
KEPT = ("saturation_margin", "largest_bandwidth", "error_variance", "analyze")


def same(one: object, other: object) -> bool:
    told = [each.to_dict() if isinstance(each, pf.Result) else repr(each) for each in (one, other)]
    return told[0] == told[1]


@pytest.mark.parametrize("old", OLD)
def test_migrated_code_says_what_the_old_name_says(old):
    new, left = migrated(f"import phyfilter_ctl as pf\nfound = {old}\n")
    assert not left
    assert len(new) < len(old) + 60
    assert migrated(new)[0] == new
    now: dict[str, object] = dict(NAMES)
    exec(new, now)
    if not any(f"pf.{name}(" in old for name in KEPT):
        with pytest.warns(DeprecationWarning, match=r"is now .*\n.*migrate"):
            before = eval(old, dict(NAMES))
        if not isinstance(before, pf.LearnResult):
            assert same(before, now["found"])


def test_every_name_of_the_table_has_a_case():
    assert {*_renamed._FUNCTIONS} <= set(re.findall(r"pf\.(\w+)\(", " ".join(OLD)))


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_channels_had_lists_of_numbers():
    bank = pf.stack([F, pf.PhyFilter([5.0])])
    found = pf.loop_margin(bank, kp=[10.0, 4.0], kd=6.0)
    assert [each.delay_margin for each in found] == [
        pf.margins(F, pf.Loop(10.0, 6.0)).delay_margin,
        pf.margins(pf.PhyFilter([5.0]), pf.Loop(4.0, 6.0)).delay_margin,
    ]
    found = pf.ultimate_bound(bank, residual=[{1: 3.0}, {1: 1.0}], noise=0.01)
    assert found[1].bound == pf.error_bound(pf.PhyFilter([5.0]), pf.Bounded({1: 1.0}, noise=0.01)).bound
    assert len(pf.prior_margin(bank)) == 2


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_sets_of_matrices_were_methods_of_the_inner_margins():
    margin = pf.prior_margin(F)
    assert isinstance(margin, pf.FilterMargins)
    assert isinstance(margin, pf.PriorMargin)
    verdict = margin.inertia([2.0, 0.5], [1.0, 1.0])
    assert isinstance(verdict, pf.InertiaVerdict)
    assert (verdict.stable, verdict.test, verdict.status) == (True, "eigenvalues", "proven")
    assert not pf.prior_margin(F, inertia_ratio=1.2).inertia_between(1.0, 0.05, 5.0).stable
    assert margin.inertia([2.0, 10.0], [1.0, 1.0]).message == "unstable at the eigenvalue 10 of M_hat M^-1"
    assert margin.inertia_between(1.0, 0.2, 5.0).status == "proven"
    assert margin.inertia_within([2.0, 1.0], 0.5).method == "small gain"
    assert margin.inertia_hull([1.0], [1.0], deviation=[[0.1]]).status == "proven"


@pytest.mark.parametrize(
    ("module", "name"),
    [
        ("analysis", "BoundResult"),
        ("analysis", "PriorMargin"),
        ("analysis", "LoopMargin"),
        ("analysis", "gauss_markov"),
        ("analysis", "Implementation"),
        ("simulation", "FilterPlace"),
        ("simulation", "linearize_sampled"),
        ("simulation", "sampled_open_loop"),
        ("simulation", "signal_margin"),
        ("diagram", "SignalMargin"),
        ("filter", "LivePolicy"),
        ("plots", "pole_plot"),
        ("codegen", "write_folder"),
        ("design", "LoopConstraint"),
        ("design.learning", "LoopConstraint"),
    ],
)
def test_every_module_that_had_a_name_knows_it(module, name):
    room = importlib.import_module(f"phyfilter_ctl.{module}")
    with pytest.warns(DeprecationWarning, match=f"phyfilter_ctl.{module}.{name} is now"):
        assert getattr(room, name) is not None
    assert name not in room.__all__
    with pytest.raises(AttributeError, match="no attribute 'never'"):
        _ = room.never


def test_what_never_was_is_no_attribute():
    with pytest.raises(AttributeError, match="no attribute 'never'"):
        _ = pf.never
