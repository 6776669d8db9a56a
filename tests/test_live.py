"""The live filter: on clean stamps it is ``run``; every fault does what the rules say, and is recorded."""

import json
import math
import random
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phyfilter_ctl import PhyFilter, stack
from phyfilter_ctl.filter import LiveHealth, LiveRules
from tests.cpu_budget import slow_but
from tests.live_soak import APART, KINDS, Sensor, expected, live_filter

H, N = 0.01, 300
FILTER = PhyFilter([400.0, 44.0], [380.0, 10.0])
NAN = float("nan")
AGREE = 1e-12


def record(seed=0):
    rng = np.random.default_rng(seed)
    x = np.cumsum(0.05 * rng.standard_normal((N, 2)), axis=0)
    g, f_theta = rng.standard_normal((2, N, 2))
    return x, g, f_theta, np.cumsum(rng.uniform(0.6 * H, 1.4 * H, N)), 1.0 + 0.1 * rng.random((N, 2))


def through(live, x, g, f_theta, times, inertia=None):
    acting = np.vstack([g[:1], g[:-1]]) if live.recursion.sampling.g == "hold" else g
    masses = [None] * len(x) if inertia is None else inertia
    rows = zip(times, x, acting, f_theta, masses, strict=True)
    return np.array([live.step(t, *row, inertia=M) for t, *row, M in rows])


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"delay": 0.013},
        {"g": "average", "f_theta": "hold"},
        {"method": "tustin"},
        {"precision": "float32"},
    ],
    ids=str,
)
@pytest.mark.parametrize("rules", [LiveRules(), LiveRules(stuck_after=3)], ids=["default", "stuck"])
def test_clean_stamps_are_the_record(options, rules):
    x, g, f_theta, times, inertia = record()
    sampled = stack(
        [FILTER.sampled(H, limit=20.0, **options), PhyFilter([9.0]).sampled(H, limit=20.0, **options)]
    )
    for stamps, M in ((H * np.arange(N), None), (times, inertia)):
        live = sampled.live(2, rules)
        ours, expected = through(live, x, g, f_theta, stamps, M), sampled.run(x, g, f_theta, M, stamps)
        tolerance = AGREE if "precision" not in options else 1e-5
        np.testing.assert_allclose(ours, expected, atol=tolerance * np.abs(expected).max())
        assert live.health.accepted == N
        assert live.health.describe().endswith("nothing else happened")


def test_what_it_is_given_may_be_a_buffer_that_changes():
    x, g, f_theta, times, _ = record()
    live, buffer, ours = FILTER.sampled(H).live(2), np.empty((3, 2)), []
    state, steps = FILTER.sampled(H).start(x[0], f_theta0=f_theta[0]), []
    for k in range(N):
        buffer[:] = x[k], g[max(k - 1, 0)], f_theta[k]
        ours.append(live.step(times[k], *buffer))
        if k:
            state, f_hat = FILTER.sampled(H).step(state, *buffer, dt=times[k] - times[k - 1])
            steps.append(f_hat)
    expected = FILTER.sampled(H).run(x, g, f_theta, times=times)
    np.testing.assert_allclose(ours, expected, atol=1e-11)
    np.testing.assert_allclose(steps, expected[1:], atol=1e-11)


def test_a_short_gap_is_one_longer_step_and_keeps_the_estimate():
    """NaN, no measurement, and a sensor that is stuck (taken back): the same as ``run`` with these samples held."""
    x, g, f_theta, times, _ = record()
    broken = x.copy()
    broken[50:60], broken[100] = NAN, np.inf
    stuck = broken.copy()
    stuck[150:157, 1] = stuck[149, 1]
    broken[150:157] = NAN
    live = FILTER.sampled(H).live(2, LiveRules(stuck_after=5))
    ours = through(live, stuck, g, f_theta, times)
    expected = FILTER.sampled(H, nonfinite="hold").run(broken, g, f_theta, times=times)
    seen = np.r_[0:150, 153:N]  # until it is recognised, a sensor is believed
    np.testing.assert_allclose(ours[seen], expected[seen], atol=1e-11)
    np.testing.assert_allclose(ours[55] - f_theta[55], ours[49] - f_theta[49], atol=1e-12)
    assert live.health.counts | {"nonfinite": 11, "stuck": 7} == live.health.counts
    assert live.health.counts["gap"] == 0
    assert live.health.worst_gap == pytest.approx(times[60] - times[49])


@pytest.mark.parametrize("after", ["decay", "keep", "reset"])
@pytest.mark.parametrize("fault", ["missing", "lost", "stuck"])
def test_beyond_the_longest_gap_goes_the_policys_way(after, fault):
    rules = LiveRules(longest_gap=0.1, decay_time=0.3, missing=after, stuck=after, stuck_after=3)
    live = PhyFilter([40.0]).sampled(H).live(1, rules)
    for k in range(200):
        before = live.step(k * H, [2.0 * k * H])
    assert before == pytest.approx(2.0)
    gap = 0.5
    share = {"decay": math.exp(-(gap - 0.1) / 0.3), "keep": 1.0, "reset": 0.0}[after]
    last = 199 * H
    if fault != "lost":
        for k in range(1, 51):
            f_hat = live.step(last + k * H, None if fault == "missing" else [2.0 * last])
            if 2 <= k <= 10:
                assert f_hat == pytest.approx(2.0)
        assert f_hat == pytest.approx(2.0 * share)
        assert live.held
        share = {"decay": math.exp(-(gap + H - 0.1) / 0.3), "keep": 1.0, "reset": 0.0}[after]
        last += H
    f_hat = live.step(last + gap, [-7.0])  # wherever it is now
    assert f_hat == pytest.approx(2.0 * share)
    assert not live.held
    assert live.health.counts["gap"] == 1
    f_hat = live.step(last + gap + H, [-7.0 + 2.0 * H])
    assert f_hat == pytest.approx(2.0 + (2.0 * share - 2.0) * math.exp(-40.0 * H))


@pytest.mark.parametrize("fault", ["missing", "lost"])
@pytest.mark.parametrize(("gap", "closed"), [(10, True), (11, False)])
def test_the_longest_gap_itself_is_closed_and_one_step_more_is_not(fault, gap, closed):
    """Ten steps of 0.01 s sum up to a little more or less than 0.1 s: that is no gap beyond it."""
    live = PhyFilter([40.0]).sampled(H).live(1, LiveRules(longest_gap=10 * H, missing="reset"))
    for k in range(100):
        live.step(k * H, [2.0 * k * H])
    for k in range(100, 99 + gap) if fault == "missing" else ():
        assert live.step(k * H, None) == pytest.approx(2.0)
    assert live.health.counts["gap"] == 0
    back = 99 + gap
    f_hat = live.step(back * H, [2.0 * 99 * H])  # it stood still meanwhile
    assert live.health.counts["gap"] == (0 if closed else 1)
    expected = (
        2.0 * math.exp(-40.0 * gap * H) if closed else 0.0
    )  # one longer step to a residual of 0, or anew
    assert f_hat == pytest.approx([expected], abs=1e-12)
    assert live.health.worst_gap == pytest.approx(gap * H)


@pytest.mark.parametrize("clock", ["keep", "reset"])
@pytest.mark.parametrize("jump", [1e6, -1e6, -0.05])
def test_a_clock_that_is_set(clock, jump):
    """Small steps back show at the third late stamp; the estimate is kept, and the residual's step is not made up."""
    live = PhyFilter([40.0]).sampled(H).live(1, LiveRules(clock=clock))
    for k in range(200):
        live.step(k * H, [2.0 * k * H])
    held = []
    for k in range(200, 210):
        f_hat = live.step(k * H + jump, [2.0 * k * H])
        held.append(live.held)
        if clock == "keep":
            assert f_hat == pytest.approx(2.0)
    assert held == [jump == -0.05] * 2 + [False] * 8
    if clock == "reset":
        assert f_hat == pytest.approx(2.0 * -math.expm1(-40.0 * H * (7 if jump == -0.05 else 9)))
    counts = Counter({kind: count for kind, count in live.health.counts.items() if count})
    assert counts == {"clock_ahead" if jump > 0 else "clock_back": 1}


def test_late_and_double_samples_are_dropped():
    live = PhyFilter([40.0]).sampled(H).live(1)
    order = [0, 1, 2, 4, 3, 5, 5, 6]
    for k in order:
        f_hat = live.step(k * H, [2.0 * k * H])
    assert f_hat == pytest.approx(-2.0 * math.expm1(-40.0 * 6 * H))
    counts = {kind: count for kind, count in live.health.counts.items() if count}
    assert counts == {"lost": 1, "late": 1, "duplicate": 1}
    assert live.health.last["late"] == 3 * H


def test_a_stamp_that_stays_late_is_no_clock_that_was_set_back():
    """Three in a row are a clock only where they go on; one and the same stamp is sent again."""
    live = PhyFilter([40.0]).sampled(H).live(1)
    for k in [0, 1, 2, 3, 4, 2, 2, 2, 2]:
        live.step(k * H, [0.0])
    assert {kind: count for kind, count in live.health.counts.items() if count} == {"late": 4}


def test_units_of_stamps_are_told():
    live = PhyFilter([40.0]).sampled(H).live(1)
    live.step(0, [0.0])
    live.step(10_000, [0.0])
    live.step(20_000, [0.0])
    with pytest.raises(ValueError, match=r"time: expected stamps in seconds, about 0.01 s apart, got 10000"):
        live.step(30_000, [0.0])
    for time in ("1", None, [1.0], np.datetime64("2026-01-01")):
        with pytest.raises(TypeError):
            live.step(time, [0.0])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"longest_gap": 0.0}, "longest_gap: expected a finite number > 0 s"),
        ({"longest_gap": 0.011}, "two nominal steps"),
        ({"longest_gap": 0.2, "clock_jump": 0.1}, "clock_jump: expected more than longest_gap"),
        ({"stuck_after": 1}, "stuck_after"),
        ({"clock": "decay"}, "clock: expected one of keep, reset"),
        ({"missing": "hold"}, "missing: expected one of decay, keep, reset"),
    ],
)
def test_bad_policies_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        FILTER.sampled(H).live(2, LiveRules(**settings))


def test_forward_euler_must_survive_the_longest_gap():
    with pytest.raises(ValueError, match="forward Euler diverges"):
        PhyFilter([30.0]).sampled(H, "euler").live(1, LiveRules(longest_gap=0.1))
    euler = PhyFilter([30.0]).sampled(H, "euler")
    rules = euler.live(1).rules
    assert (
        0.9999 * 2.0 / 30.0 < rules.longest_gap < 2.0 / 30.0
    )  # what is stable as one step, as for every route
    assert rules.decay_time == pytest.approx(1.0 / 30.0)
    with pytest.raises(ValueError, match="forward Euler diverges"):
        euler.live(1).retune(PhyFilter([40.0]).sampled(H, "euler"))


def test_wrong_shapes_change_nothing():
    live = FILTER.sampled(H).live(2)
    live.step(0.0, [1.0, 2.0])
    before = (live.state, live.health)
    for arguments in (([1.0],), ([1.0, 2.0], [1.0]), ([1.0, 2.0], None, [1.0] * 3)):
        with pytest.raises(ValueError, match="expected shapes"):
            live.step(H, *arguments)
    assert before == (live.state, live.health)


@pytest.mark.parametrize(
    "options", [{}, {"delay": 0.013, "nonfinite": "hold"}, {"precision": "float32"}], ids=str
)
@pytest.mark.parametrize("at", [0, 120, 205])
def test_a_restart_in_between_changes_nothing(tmp_path, options, at):
    x, g, f_theta, times, inertia = record()
    x[200:210] = NAN
    sampled = FILTER.sampled(H, **options)
    whole, first, second = (sampled.live(2) for _ in range(3))
    expected = through(whole, x, g, f_theta, times, inertia)
    acting = np.vstack([g[:1], g[:-1]])
    for k in range(at):
        first.step(times[k], x[k], acting[k], f_theta[k], inertia=inertia[k])
    first.save(tmp_path / "live.json")
    second.restore(tmp_path / "live.json")
    for k in range(at, N):
        f_hat = second.step(times[k], x[k], acting[k], f_theta[k], inertia=inertia[k])
        np.testing.assert_array_equal(f_hat, expected[k])
    assert second.health == whole.health


def test_states_of_others_are_refused(tmp_path):
    path = tmp_path / "live.json"
    live = FILTER.sampled(H).live(2)
    for k in range(9):
        live.step(k * H, [0.1 * k, 0.0])
    live.save(path)
    good, state = json.loads(path.read_text()), live.state
    others = {
        "dt: saved with 0.01, this filter has 0.02": FILTER.sampled(2 * H),
        "poles": PhyFilter([400.0, 45.0]).sampled(H),
        "limit": FILTER.sampled(H, limit=1.0),
        "precision": FILTER.sampled(H, precision="float32"),
        "g_limit": FILTER.sampled(H, g_limit=(-1.0, 1.0)),
    }
    for message, other in others.items():
        with pytest.raises(ValueError, match=message):
            other.live(2).restore(path)
    with pytest.raises(ValueError, match=r"state\.w: expected shape \(3, 2\)"):
        FILTER.sampled(H).live(3).restore(path)
    broken = {
        "format": good | {"format": "other"},
        "update the library": good | {"version": 2},
        "no others": good | {"extra": 1},
        r"state\.x": good | {"state": good["state"] | {"x": [1.0, None]}},
        r"state\.gap": good | {"state": good["state"] | {"gap": -1.0}},
        r"state\.past|state\.": good | {"state": good["state"] | {"past": [{}]}},
        "health": good | {"health": good["health"] | {"accepted": "many"}},
        "fresh": good | {"fresh": 1},
    }
    for message, document in broken.items():
        path.write_text(json.dumps(document))
        with pytest.raises(ValueError, match=message):
            live.restore(path)
    path.write_text("[")
    with pytest.raises(ValueError, match="JSON"):
        live.restore(path)
    assert live.state is state


VALUES = (None, True, -1, 0, 1e308, "x", [], {}, [[1.0]], [None], NAN, 10**400)


def changed(document, rng):
    """One entry somewhere in it gone, added or of another value."""
    *way, last = rng.choice([path for path in paths(document, ()) if path])
    at = document
    for key in way:
        at = at[key]
    what = rng.random()
    if what < 0.2:
        del at[last]
    elif what < 0.3 and isinstance(at, dict):
        at["more"] = 1
    else:
        at[last] = rng.choice(VALUES)
    return document


def paths(value, way):
    yield way
    entries = (
        value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    )
    for key, entry in entries:
        yield from paths(entry, (*way, key))


@pytest.mark.parametrize("count", slow_but([80], [80, 4000]))
def test_damaged_states_are_refused_or_run(tmp_path, count):
    sampled, path, rng = FILTER.sampled(H, delay=0.013), tmp_path / "live.json", random.Random(0)
    live = sampled.live(2)
    for k in range(30):
        live.step(H * k, None if 20 < k < 25 else [0.1 * k, 0.0], [1.0, 2.0], inertia=[1.0, 2.0])
    live.step(0.3, None)
    live.save(path)
    text, restored = path.read_text(), 0
    for i in range(count):
        if i % 4:
            path.write_text(json.dumps(changed(json.loads(text), rng)))
        else:
            place = rng.randrange(len(text))
            path.write_bytes(text[:place].encode() + rng.randbytes(1) + text[place + 1 :].encode())
        try:
            (live := sampled.live(2)).restore(path)
        except ValueError:
            continue
        restored += 1
        for k in (31, 32):
            assert np.isfinite(live.step(H * k, [3.0, 0.0], [1.0, 2.0])).all()
        assert live.health.describe()
    assert 0 < restored < count / 2


def test_retuning_does_not_bump_and_keeps_the_record():
    sampled, live = FILTER.sampled(H), FILTER.sampled(H).live(1)
    for k in range(100):
        before = live.step(k * H, [2.0 * k * H])
    live.step(100 * H, None)
    live.retune(sampled.with_filter(PhyFilter([5.0])))
    assert live.f_hat == pytest.approx(before)
    assert live.held
    assert live.health.accepted == 100
    assert live.step(101 * H, [2.0 * 101 * H])[0] == pytest.approx(before[0], abs=0.05)
    live.reset()
    assert live.f_hat.tolist() == [0.0]
    assert live.step(101 * H, [9.0]).tolist() == [0.0]  # at any time: a new start
    assert not live.held
    assert live.step(102 * H, [9.0 + 2.0 * H]) == pytest.approx(-2.0 * math.expm1(-5.0 * H))
    assert live.health.counts == live.health.counts | {"late": 0, "duplicate": 0, "clock_back": 0}


def test_nothing_good_ever():
    live = FILTER.sampled(H).live(2)
    for k in range(100):
        assert live.step(k * H, None, [NAN, 1.0], [NAN, 3.0]).tolist() == [0.0, 3.0]
    assert live.health.accepted == 0
    assert live.step(1.0, [5.0, 5.0], None, [1.0, 1.0]).tolist() == [1.0, 1.0]
    assert isinstance(live.health, LiveHealth)


def test_nothing_but_bad_stamps(tmp_path):
    live = FILTER.sampled(H).live(1)
    for time in (NAN, math.inf, NAN):
        assert live.step(time, [1.0]).tolist() == [0.0]
    assert "3 samples whose time is not finite" in live.health.describe()
    live.save(tmp_path / "live.json")
    live.restore(tmp_path / "live.json")
    assert live.health.counts["stamp"] == 3


FAULTS = st.lists(st.tuples(st.sampled_from(KINDS), st.integers(1, 30), st.integers(APART, 20)), max_size=12)


@given(FAULTS, st.integers(0, 2**16))
@settings(max_examples=15, deadline=None)
def test_the_record_is_what_was_injected(faults, seed):
    """Faults of every kind in any order: never a NaN out, and the health record counts what was injected."""
    schedule = [("good", APART)]
    for kind, n, rest in faults:
        schedule += [(kind, 1 if kind in ("late", "clock") else n), ("good", rest)]
    live, sensor = live_filter(), Sensor(0, seed)
    for _, stamp, x in sensor.deliveries(schedule):
        assert np.isfinite(live.step(stamp, x, inertia=1.2)).all()
    wanted, met = expected(schedule), Counter(live.health.counts) + Counter(accepted=live.health.accepted)
    assert {kind: count for kind, count in wanted.items() if count} == dict(met)
