"""Conditions on a learned F: unit gain, type, prescribed zeros and poles, limits. They hold by construction."""

import numpy as np
import pytest
from reference_log import reference_log
from scipy import signal
from scipy.linalg import null_space

from phyfilter_ctl import PhyFilter, Recording, Search, Shape, place_poles
from phyfilter_ctl.design.learning import learn
from phyfilter_ctl.design.learning.coordinates import Limited
from phyfilter_ctl.design.learning.parametrisation import Chain
from phyfilter_ctl.design.learning.residuals import flights_of
from phyfilter_ctl.design.learning.sensitivity import evaluate
from phyfilter_ctl.design.learning.sources import sources

H = 0.01
# Central differences of a cost of size 1 over 1e-5: h^2 and eps / h.
DIFFERENCE = 1e-6
# A noiseless label is learned back to rounding; poles move with the root of what is left of the cost.
RECOVERED = 1e-5
# Conditions hold to rounding of the numerator's change of basis.
ROUNDING = 1e-9
# Three poles that meet are known to the cube root of rounding.
REPEATED = 1e-4


def log_of(truth, seed=1, noise=0.0, n=2500):
    rng = np.random.default_rng(seed)
    x = 0.1 * np.cumsum(rng.standard_normal((n, 2)), axis=0)
    label = truth.sampled(H, "exact").run(x)
    return Recording.from_arrays(x=x, dt=H, label=label + noise * rng.standard_normal(label.shape))


@pytest.fixture(scope="module")
def data():
    return sources(flights_of([reference_log(1500)]), "exact")[0]


@pytest.mark.parametrize(
    "given",
    [{}, {"type": 3}, {"zeros_at": [6.0]}, {"dc_gain": None, "blocked_at": [40.0]}, {"dc_gain": 0.0}],
    ids=["unit gain", "type 3", "zeros of 1 - F", "zeros of F", "band-pass"],
)
def test_gradient_of_the_constrained_cost(data, given):
    wanted = Shape("general", **given)
    theta = np.log([30.0, 25.0, 12.0, 6.0])

    def cost(t):
        return evaluate(data, Chain(t, 0.1), wanted)

    step = 1e-5
    found = [
        (cost(theta + step * e).cost - cost(theta - step * e).cost) / (2.0 * step) for e in np.eye(len(theta))
    ]
    gradient = cost(theta).gradient
    np.testing.assert_allclose(gradient, found, atol=DIFFERENCE * np.max(np.abs(gradient)))


def test_gradient_within_limits(data):
    limited = Limited(np.array([-3.0 + 0.0j]), 2.0, 90.0, 0.3)
    theta = np.array(
        [np.log(20.0), -0.4, np.log(15.0), 0.5, np.log(40.0)]
    )  # a pair, two real poles, one more

    def cost(t):
        chain = limited.chain(t)
        return limited.pulled(evaluate(data, chain, Shape("general")), chain, t)

    step = 1e-5
    found = [
        (cost(theta + step * e).cost - cost(theta - step * e).cost) / (2.0 * step) for e in np.eye(len(theta))
    ]
    gradient = cost(theta).gradient
    np.testing.assert_allclose(gradient, found, atol=DIFFERENCE * np.max(np.abs(gradient)))
    poles = limited.chain(theta).poles
    np.testing.assert_allclose(
        limited.chain(limited.of(poles)).polynomials[0], limited.chain(theta).polynomials[0]
    )


def test_numerator_of_given_poles_is_least_squares_under_the_conditions():
    """With every pole given: numpy on responses of 1/D, s/D, s^2/D that scipy simulates, in the null space of the
    conditions."""
    log = log_of(PhyFilter([9.0]), noise=0.3)
    poles = [-4.0, -10.0, -30.0]
    result = learn(log, 3, shape=Shape("general", type=2, poles=poles))
    a = result.filter.a
    u = np.diff(log.x, axis=0) / H
    A, B = np.diag([1.0, 1.0], 1), np.array([[0.0], [0.0], [1.0]])
    A[2] = -a
    held = signal.cont2discrete((A, B, np.eye(3), np.zeros((3, 1))), H, "zoh")
    states = [signal.dlsim((*held[:4], H), np.append(part, 0.0))[2][1:] for part in u.T]
    columns = [np.stack([part[:, i] for part in states], axis=1).ravel() for i in range(3)]
    X = np.stack(columns, axis=1) * [a[0], a[1], a[2]]
    conditions = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # b_i / a_i = 1 for i < 2
    Z, fixed = null_space(conditions), np.array([1.0, 1.0, 0.0])
    free = np.linalg.lstsq(X @ Z, log.label[1:].ravel() - X @ fixed, rcond=None)[0]
    expected = (fixed + Z @ free) * a
    np.testing.assert_allclose(result.filter.b, expected, rtol=RECOVERED)
    np.testing.assert_allclose(np.sort(result.filter.poles().real), np.sort(poles), rtol=ROUNDING)


TRUTHS = {
    "type 2": (place_poles([-10.0, -14.0, -30.0], type=2), {"type": 2}),
    "1 - F at 6 rad/s": (place_poles([-9.0, -14.0, -30.0], zeros_at=[6.0]), {"zeros_at": [6.0]}),
    "F at 40 rad/s": (PhyFilter([400.0, 40.0], [0.0, 30.0]), {"dc_gain": 0.0}),
}


@pytest.mark.parametrize("name", TRUTHS)
def test_a_filter_of_the_shape_is_learned_back(name):
    truth, given = TRUTHS[name]
    result = learn(log_of(truth), truth.order, shape=Shape("general", **given))
    np.testing.assert_allclose(result.filter.a, truth.a, rtol=RECOVERED)
    np.testing.assert_allclose(result.filter.b, truth.b, rtol=RECOVERED, atol=RECOVERED * np.max(truth.b))


def test_conditions_hold_where_the_label_is_another_filter():
    log = log_of(PhyFilter([400.0, 30.0]), noise=0.1)
    result = learn(
        log,
        5,
        shape=Shape("general", type=2, zeros_at=[3.0], pole_range=(2.0, 120.0), damping=0.5),
        search=Search(starts=1),
    )
    found = result.filter
    assert result.order_used == 5
    assert found.type == 2
    assert abs(found.error(3j)) < ROUNDING
    notched = learn(log, 3, shape=Shape("general", blocked_at=[80.0])).filter
    assert notched.dc_gain == 1.0
    assert abs(notched(80j)) < ROUNDING


@pytest.mark.slow
def test_poles_stay_within_limits_and_given_ones_stay():
    log = log_of(PhyFilter([400.0, 6.0]), n=1200)  # damping 0.15, 20 rad/s
    quick = Search(starts=1, cross_validate=False)
    result = learn(log, 2, shape=Shape("general", damping=0.6), search=quick)
    assert result.status == "at_bound"
    assert "damping ratio 0.6" in result.message
    poles = result.filter.poles()
    assert np.all(-poles.real >= 0.6 * np.abs(poles) * (1.0 - ROUNDING))
    slow = learn(log, 3, shape=Shape("general", pole_range=(1.0, 12.0)), search=quick)
    assert np.all(np.abs(slow.filter.poles()) <= 12.0 * (1.0 + REPEATED))
    kept = learn(log, 4, shape=Shape("general", poles=[-5.0 + 2.0j, -5.0 - 2.0j]), search=quick)
    assert np.min(np.abs(kept.filter.poles() - (-5.0 + 2.0j))) < ROUNDING
    # The truth is among them: its poles beside the given ones, which zeros cancel.
    assert kept.rmse < RECOVERED * np.std(log.label)


def test_gain_is_one_unless_freed():
    """The label is twice M x': with a gain of its own the filter says 2, by default it says 1."""
    log = log_of(PhyFilter([30.0]))
    log = log.with_signals(label=1.5 * log.label)
    assert learn(log, 1, shape="general").filter.dc_gain == 1.0
    assert learn(log, 1, shape=Shape("general", dc_gain=None)).filter.dc_gain == pytest.approx(
        1.5, rel=RECOVERED
    )


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"type": 3}, "need order 3 at least, got 2"),
        ({"zeros_at": [6.0]}, "3 conditions"),
        ({"type": 2, "dc_gain": None}, "type=2 with dc_gain=None"),
        ({"zeros_at": [6.0, 6.0]}, "distinct positive"),
        ({"zeros_at": [6.0], "blocked_at": [6.0]}, "1 and 0 at one frequency"),
        ({"pole_range": (5.0, 2.0)}, "0 < least < largest"),
        ({"pole_range": (1e4, 1e5)}, "a part of what the flights show"),
        ({"damping": 1.5}, "0 to 1"),
        ({"poles": [1.0]}, "not Hurwitz"),
        ({"poles": [-1.0, -2.0, -3.0]}, "3 given poles"),
        ({"form": "lowpass", "zeros_at": [6.0]}, "the form 'general'"),
    ],
)
def test_what_cannot_be_met_is_refused(given, message):
    with pytest.raises(ValueError, match=message):
        learn(log_of(PhyFilter([9.0]), n=300), 2, shape=Shape(**{"form": "general", **given}))
