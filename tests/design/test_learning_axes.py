"""One filter for all axes, one each, or a matrix: what cross-validation chooses, and that it runs as learned."""

from functools import partial

import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, Reading, Recording, Search, stack
from phyfilter_ctl.design.learning import learn
from phyfilter_ctl.design.learning.axes import compare_axes

H = 0.01
RECOVERED = 1e-5
FILTERS = (PhyFilter([5.0]), PhyFilter([40.0]))
# Coordinates come from covariances of samples: the label here has no noise, so they are found nearly exactly.
COUPLED = np.array([[1.0, 0.6], [-0.4, 1.0]])


BARE = Search(starts=0, cross_validate=False)
# Trials on files begin where what was kept of them does; the answers do not differ by more than rounding.
SAME = 1e-9


def learner(logs):
    return learn(logs, 1, search=BARE)


def log_of(filters, T, seed, noise=0.05, n=1500):
    rng = np.random.default_rng(seed)
    phi = np.cumsum(rng.standard_normal((n, 2)) * [1.0, 3.0], axis=0)
    bank = stack(list(filters)).sampled(H)
    label = (bank.run(phi) + noise * rng.standard_normal(phi.shape)) @ T.T
    return Recording.from_arrays(x=phi @ T.T, dt=H, label=label)


def test_one_filter_is_enough_where_axes_are_alike():
    found = compare_axes([log_of((FILTERS[0], FILTERS[0]), np.eye(2), 1)], learner, folds=3)
    assert found.choice == "shared"
    assert found.filter.a[0] == pytest.approx(5.0, rel=0.05)


@pytest.mark.slow
def test_axes_that_differ_have_one_each():
    logs = [log_of(FILTERS, np.eye(2), seed, n=400) for seed in range(5)]
    found = compare_axes(logs, learner, folds=5)
    assert found.choice == "each"
    assert [one.a[0] for one in found.filter] == pytest.approx([5.0, 40.0], rel=0.05)
    assert found.scores["shared"].ratio > 1.0 + found.scores["shared"].standard_error


@pytest.mark.slow
def test_coupled_axes_have_a_matrix_that_runs_as_learned():
    """Inertia included: what is learned of M x' is what runs on x with M."""
    M = np.array([2.0, 0.5])
    log = log_of(FILTERS, COUPLED, 3)
    log = Recording.from_arrays(x=log.x / M, dt=H, label=log.label, inertia=M)
    found = compare_axes([log], learner, folds=3)
    assert found.choice == "coupled"
    poles = sorted(one.a[0] for one in found.filter)
    assert poles == pytest.approx([5.0, 40.0], rel=0.1)
    sampled = found.sampled()
    f_hat = sampled.run(log.x, inertia=M) @ found.T.T
    # By hand: carry u into phi, filter each by scipy's route of PhyFilter.run, and back.
    phi = (log.x * M) @ np.linalg.inv(found.T).T
    by_hand = stack(list(found.filter)).sampled(H).run(phi) @ found.T.T
    np.testing.assert_allclose(f_hat, by_hand, atol=RECOVERED)
    assert np.sqrt(np.mean((log.label - f_hat)[1:] ** 2)) < found.scores["each"].held_out_rmse


@pytest.mark.slow
def test_axes_of_files_are_those_of_recordings(tmp_path):
    """Three flights are cut into blocks, five are whole; what is read again is bit for bit the same."""
    read = partial(Recording.from_csv, x=["x[0]", "x[1]"])
    logs = [log_of(FILTERS, COUPLED, seed, n=300) for seed in range(5)]
    for k, log in enumerate(logs):
        log.to_csv(tmp_path / f"{k}.csv")
    files = sorted(tmp_path.iterdir())
    for count in (2, 5):
        expected = compare_axes(logs[:count], learner, folds=2)
        found = compare_axes(
            files[:count],
            lambda some: learn(some, 1, search=BARE, reading=Reading(workers=1)),
            folds=2,
            read=read,
        )
        assert found.choice == expected.choice
        np.testing.assert_allclose(found.T, expected.T, rtol=SAME)
        for kind, score in expected.scores.items():
            assert found.scores[kind].held_out_rmse == pytest.approx(score.held_out_rmse, rel=SAME)
            for one, other in zip(found.results[kind], expected.results[kind], strict=True):
                np.testing.assert_allclose(one.filter.a, other.filter.a, rtol=SAME)


def test_what_cannot_be_chosen_is_refused():
    log = log_of(FILTERS, np.eye(2), 1, n=50)
    with pytest.raises(ValueError, match="two channels"):
        compare_axes([Recording.from_arrays(x=log.x[:, :1], dt=H, label=log.label[:, :1])], learner)
    with pytest.raises(ValueError, match="no label"):
        compare_axes([log.with_signals(label=None)], learner)
    moving = Recording.from_arrays(x=log.x, dt=H, label=log.label, inertia=np.ones((50, 2)) + log.x**2)
    with pytest.raises(ValueError, match="inertia that varies"):
        compare_axes([moving], learner)
