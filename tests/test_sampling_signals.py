"""What a filter is run with is said once, in its Sampling: channels, inertia and units."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl import PhyFilter
from phyfilter_ctl.filter import Sampling

F = PhyFilter([400.0, 40.0])
UNITS = {"x": "m/s", "g": "N", "f": "N"}
rng = np.random.default_rng(5)
X, G = rng.standard_normal((2, 40, 3))
M_FULL = np.array([[2.0, 0.1, 0.0], [0.1, 1.5, 0.2], [0.0, 0.2, 3.0]])


@pytest.mark.parametrize("inertia", [1.8, [1.0, 2.0, 3.0], M_FULL])
def test_records_and_loops_take_the_inertia_of_the_filter(inertia: Any) -> None:
    said_once, plain = F.sampled(0.01, inertia=inertia), F.sampled(0.01)
    np.testing.assert_array_equal(said_once.run(X, G), plain.run(X, G, inertia=inertia))
    np.testing.assert_array_equal(said_once.run(X, G, inertia=0.5), plain.run(X, G, inertia=0.5))
    state, of_call = said_once.start(X[0]), plain.start(X[0], inertia0=inertia)
    live = said_once.live(3)
    live.step(0.0, X[0])
    for k in range(1, 5):
        state, f_hat = said_once.step(state, X[k], G[k])
        of_call, expected = plain.step(of_call, X[k], G[k])
        np.testing.assert_array_equal(f_hat, expected)
        np.testing.assert_array_equal(live.step(0.01 * k, X[k], G[k]), expected)
    one, other = said_once.to_ss(3), plain.to_ss(3, inertia=inertia)
    np.testing.assert_array_equal(one.B, other.B)


def test_an_inertia_that_comes_with_every_sample_is_asked_for() -> None:
    moving = F.sampled(0.01, inertia="diagonal")
    for call in (lambda: moving.run(X), lambda: moving.step(moving.start(X[0]), X[1]), moving.to_ss):
        with pytest.raises(ValueError, match="inertia: expected M_hat"):
            call()
    np.testing.assert_array_equal(
        moving.run(X, inertia=[1.0, 2.0, 3.0]), F.sampled(0.01).run(X, inertia=[1, 2, 3])
    )


def test_a_sampling_is_checked_compared_and_kept() -> None:
    full = Sampling(0.01, channels=["a", "b", "c"], inertia=M_FULL, units=UNITS)
    assert (full.n_x, full.names, full.units) == (3, ("a", "b", "c"), UNITS)
    assert full == replace(full, dt=0.01) == pickle.loads(pickle.dumps(full))
    assert hash(full) == hash(replace(full))
    others: list[dict[str, Any]] = [
        {"channels": 3},
        {"inertia": 2.0},
        {"inertia": "full"},
        {"units": {"x": "m"}},
    ]
    for other in others:
        assert full != replace(full, **other)
    assert Sampling(0.01, inertia=[1.0, 2.0]).n_x == Sampling(0.01, channels=2).n_x == 2
    assert Sampling(0.01).n_x is Sampling(0.01, inertia=2.0).n_x is None
    assert (
        eval(repr(Sampling(0.01, channels=2, inertia=2.0, units=UNITS)), {"Sampling": Sampling}).units
        == UNITS
    )
    assert isinstance(full.inertia, np.ndarray)
    with pytest.raises(ValueError, match="read-only"):
        full.inertia[0, 0] = 5.0


@pytest.mark.parametrize(
    ("options", "error", "said"),
    [
        ({"channels": 0}, ValueError, "channels: expected"),
        ({"channels": ["a", "a"]}, ValueError, "different names"),
        ({"channels": "abc"}, TypeError, "channels: expected"),
        ({"inertia": [1.0, np.nan]}, ValueError, "inertia: expected finite"),
        ({"inertia": "matrix"}, ValueError, "inertia: expected one of scalar, diagonal, full"),
        ({"inertia": [1.0, 2.0], "channels": 3}, ValueError, r"inertia: expected a number or shape \(3,\)"),
        ({"inertia": np.ones((2, 3))}, ValueError, "inertia: expected"),
        ({"inertia": []}, ValueError, "inertia: expected"),
        ({"units": {"y": "m"}}, ValueError, "units: expected units of x, g, f"),
        ({"units": {"x": 3}}, TypeError, "units: expected text for x"),
    ],
)
def test_what_cannot_be_is_refused(options: dict[str, Any], error: type[Exception], said: str) -> None:
    with pytest.raises(error, match=said):
        F.sampled(0.01, **options)


def test_channels_that_contradict_are_refused() -> None:
    named = F.sampled(0.01, channels=["u", "v"])
    for call in (
        lambda: named.run(X),
        lambda: named.start(X[0]),
        lambda: named.live(3),
        lambda: named.to_ss(3),
        lambda: F.sampled(0.01, channels=2, E=np.eye(3)),
        lambda: pf.stack([F] * 3).sampled(0.01, channels=2),
        lambda: pf.stack([F] * 3).sampled(0.01, inertia=[1.0, 2.0]),
    ):
        with pytest.raises(ValueError, match=r"2 \("):
            call()


def test_options_go_in_one_by_one_or_as_a_sampling() -> None:
    sampling = Sampling(0.01, g="average", inertia=2.0, channels=3)
    assert F.sampled(sampling) == F.sampled(0.01, g="average", inertia=2.0, channels=3)
    bank = pf.stack([F, F, F])
    assert bank.sampled(sampling) == bank.sampled(0.01, g="average", inertia=2.0, channels=3)
    with pytest.raises(ValueError, match="delay: expected no options beside a Sampling"):
        F.sampled(sampling, delay=0.1)


def test_each_channel_alone_has_its_own() -> None:
    bank = pf.stack([F] * 3).sampled(0.01, channels=["a", "b", "c"], inertia=[1.0, 2.0, 3.0], units=UNITS)
    alone = bank.by_channel
    assert [part.sampling.names for part in alone] == [("a",), ("b",), ("c",)]
    assert [np.asarray(part.sampling.inertia).tolist() for part in alone] == [1.0, 2.0, 3.0]
    whole = bank.run(X)
    for i, part in enumerate(alone):
        np.testing.assert_allclose(part.run(X[:, [i]])[:, 0], whole[:, i], rtol=1e-12)


def test_states_saved_before_a_filter_had_an_inertia_still_open(tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    old = F.sampled(0.01).live(3)
    for k in range(3):
        old.step(0.01 * k, X[k])
    old.save(path)
    heavy = F.sampled(0.01, inertia=2.0)
    live = heavy.live(3)
    live.restore(path)
    state, expected = F.sampled(0.01).step(old.state, X[3], inertia=2.0)
    del state
    np.testing.assert_allclose(live.step(0.03, X[3]), expected, rtol=1e-12)
    live.save(path)
    assert json.loads(path.read_text())["filter"]["inertia"] == 2.0
    with pytest.raises(ValueError, match=r"filter\.inertia"):
        F.sampled(0.01, inertia=3.0).live(3).restore(path)


def test_a_filter_retuned_goes_on_with_the_inertia_of_the_new_one() -> None:
    light, heavy = F.sampled(0.01, inertia=2.0), F.sampled(0.01, inertia=4.0)
    live = light.live(3)
    for k in range(3):
        live.step(0.01 * k, X[k])
    before, kept = live.state, light.retune(live.state, light)
    np.testing.assert_array_equal(kept.inertia, before.inertia)
    live.retune(heavy)
    _, expected = heavy.step(live.state, X[3], inertia=4.0)
    np.testing.assert_array_equal(live.step(0.03, X[3]), expected)
    assert live.state.inertia is not None
    assert live.state.inertia.tolist() == [4.0] * 3
    own, _ = light.step(before, X[3], inertia=7.0)  # given at a step: kept, as nothing else was said since
    np.testing.assert_array_equal(light.retune(own, PhyFilter([5.0])).inertia, [7.0] * 3)
