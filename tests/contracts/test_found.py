"""One protocol for what searches find, and one for what estimates f from a recording."""

from __future__ import annotations

import dataclasses
import inspect

import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl import learned
from phyfilter_ctl.baselines import BASELINES, BackwardDifference, tune
from phyfilter_ctl.design import optimal
from tests.meta.test_public_names import CALLABLES

RNG = np.random.default_rng(0)
T = 0.01 * np.arange(400)[:, None]
LOG = pf.Recording.from_arrays(
    x=np.hstack([np.sin(3.0 * T), np.cos(2.0 * T)]) + 1e-3 * RNG.standard_normal((400, 2)),
    g=np.hstack([0.3 * np.cos(T), 0.0 * T]),
    f_theta=np.hstack([2.0 * np.cos(3.0 * T), -1.5 * np.sin(2.0 * T)]),
    label=np.hstack([6.0 * np.cos(3.0 * T), -3.0 * np.sin(2.0 * T)]),
    dt=0.01,
    inertia=[2.0, 1.5],
)


def test_searches_answer_by_best() -> None:
    found = pf.learn(LOG, 1)
    assert found.best is found.filter
    assert optimal.least_bound(1, residual={1: 8.0}, noise=0.01).best.a == pytest.approx([20.0])
    fitted = learned.Chebyshev(1, n_d=0).fit(T, T)
    assert fitted.best is fitted.model
    tuned = tune(BackwardDifference, [(LOG.x, LOG.label, 0.01, 1)])
    assert tuned.best is tuned.differentiator


def test_every_result_with_a_status_that_found_something_has_best() -> None:
    """A search ends with a status; what it found is its filter, model or differentiator."""
    for thing in set(CALLABLES.values()):
        if not (inspect.isclass(thing) and issubclass(thing, pf.Result) and dataclasses.is_dataclass(thing)):
            continue
        names = {field.name for field in dataclasses.fields(thing)}
        if "status" in names and names & {"filter", "model", "differentiator"} and thing is not pf.LiveHealth:
            assert hasattr(thing, "best"), thing.__name__


@pytest.mark.parametrize("kind", BASELINES.values(), ids=BASELINES)
def test_baselines_estimate_from_recordings(kind) -> None:
    """f_hat = f_theta + M x' - g - f_theta: with M and g taken off by hand, the same."""
    other = kind.default(0.01) if hasattr(kind, "default") else tune(kind, [(LOG.x, LOG.label, 0.01, 1)]).best
    f_hat = other.estimate(LOG)
    assert f_hat.shape == LOG.x.shape
    steps = LOG.inertia * np.diff(LOG.x, axis=0) / 0.01 - LOG.g[:-1]
    steps -= 0.5 * (LOG.f_theta[1:] + LOG.f_theta[:-1])
    momentum = np.vstack([np.zeros((1, 2)), np.cumsum(0.01 * steps, axis=0)])
    np.testing.assert_allclose(f_hat, LOG.f_theta + other.estimate(momentum, 0.01), atol=1e-9)
    with pytest.raises(TypeError, match="dt: expected a number in seconds"):
        other.estimate(LOG.x)
    with pytest.raises(TypeError, match="dt: a recording has its own"):
        other.estimate(LOG, 0.01)
    with pytest.raises(ValueError, match="recording: expected equal steps"):
        other.estimate(pf.Recording([0.0, 0.01, 0.03], np.zeros((3, 1))))


def test_a_filter_estimates_as_it_runs() -> None:
    sampled = pf.lowpass(2, 20.0).sampled(0.01)
    np.testing.assert_array_equal(sampled.estimate(LOG), sampled.run(LOG))
    with pytest.raises(TypeError, match="recording: expected a Recording, got ndarray"):
        sampled.estimate(LOG.x)
