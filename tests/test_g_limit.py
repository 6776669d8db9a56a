"""``g_limit``: the filter is told what a saturated actuator leaves of a command."""

from __future__ import annotations

import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, Sampling, lowpass, sampled_block, simulate
from phyfilter_ctl.filter import LiveRules

H = 0.002
FILTER = lowpass(2, 20.0, family="butterworth")
LOW, HIGH = np.array([-0.5, -np.inf]), np.array([0.8, 0.3])
ENDS = (LOW, HIGH)
# Sums of a few hundred rounded terms, x/h up to 30.
AGREE = 1e-12


def record(n=120):
    rng = np.random.default_rng(3)
    x = 0.02 * np.cumsum(rng.standard_normal((n, 2)), axis=0)
    g, f_theta = rng.standard_normal((2, n, 2))
    return x, g, f_theta


@pytest.mark.parametrize("options", [{}, {"delay": 0.0051}, {"precision": "float32"}, {"limit": 0.7}])
def test_it_is_a_clip_of_g_before_all_else(options):
    x, g, f_theta = record()
    for rule in ("hold", "average"):
        told = FILTER.sampled(H, g=rule, g_limit=ENDS, **options)
        plain = FILTER.sampled(H, g=rule, **options)
        clipped = np.clip(g, LOW, HIGH).astype(plain.sampling.precision)
        np.testing.assert_array_equal(told.run(x, g, f_theta), plain.run(x, clipped, f_theta))
        states = [one.start(x[0], f_theta0=f_theta[0], g0=G[0]) for one, G in ((told, g), (plain, clipped))]
        for k in range(1, 40):
            states, f_hat = zip(
                *(
                    one.step(state, x[k], G[k], f_theta[k])
                    for one, state, G in zip((told, plain), states, (g, clipped), strict=True)
                ),
                strict=True,
            )
            np.testing.assert_array_equal(*f_hat)


def test_no_g_is_the_end_next_to_zero():
    x, _, _ = record()
    raised = FILTER.sampled(H, g_limit=(1.0, 2.0))
    np.testing.assert_array_equal(raised.run(x), FILTER.sampled(H).run(x, np.ones_like(x)))


def test_live_and_systems_side_by_side():
    x, g, f_theta = record()
    sampled = FILTER.sampled(H, g_limit=ENDS)
    expected = sampled.run(x, g, f_theta)
    live = sampled.live(2, LiveRules())
    many = sampled.start(np.stack([x[0], x[0]]), f_theta0=np.stack([f_theta[0], f_theta[0]]))
    for k, acting in enumerate(np.vstack([g[:1], g[:-1]])):
        ours = live.step(k * H, x[k], acting, f_theta[k])
        np.testing.assert_allclose(ours, expected[k], atol=AGREE * np.abs(expected).max())
        if k:
            many, f_hat = sampled.step(many, *(np.stack([s, s]) for s in (x[k], acting, f_theta[k])))
            np.testing.assert_allclose(f_hat[1], expected[k], atol=AGREE * np.abs(expected).max())


def test_what_is_not_finite_stays_bad():
    """A command that is infinite is a fault, not a saturated actuator."""
    x, g, _ = record()
    g[7, 0], g[9, 1] = np.inf, np.nan
    with pytest.raises(ValueError, match=r"g: .*inf in row 7"):
        FILTER.sampled(H, g_limit=ENDS).run(x, g)
    held = FILTER.sampled(H, g_limit=ENDS, nonfinite="hold")
    np.testing.assert_array_equal(np.flatnonzero(held.held(x, g)), [8, 10])
    plain = FILTER.sampled(H, nonfinite="hold")
    clipped = np.where(np.isfinite(g), np.clip(g, LOW, HIGH), g)
    np.testing.assert_array_equal(held.run(x, g), plain.run(x, clipped))


def test_in_a_diagram():
    """The block in ``simulate``, started by itself, against ``run``."""
    x, g, f_theta = record(60)
    sampled = FILTER.sampled(H, g_limit=ENDS)
    block = sampled_block(sampled, 2)
    response = simulate(block, H * np.arange(60), np.hstack([x, g, f_theta]).T, interpolation="hold")
    expected = sampled.run(x, g, f_theta)
    np.testing.assert_allclose(response.outputs.T, expected, atol=AGREE * np.abs(expected).max())


@pytest.mark.parametrize("order", [1, 2])
def test_an_actuator_in_saturation_is_no_force(order):
    """Saturated for good: told what acts f_hat is F f, by its step response; told the command it is off by the rest."""
    n, limit, f = 900, 2.0, 3.0
    a = 20.0
    F = PhyFilter.from_poles([-a] * order)
    command = np.full((n, 1), -5.0)  # 3 more than the actuator gives
    t = H * np.arange(n)
    x = ((f - limit) * t)[:, None]
    step = 1.0 - np.exp(-a * t) * (1.0 if order == 1 else 1.0 + a * t)
    for sampled, seen in ((F.sampled(H, g_limit=(-limit, limit)), f), (F.sampled(H), f + 3.0)):
        np.testing.assert_allclose(sampled.run(x, command)[:, 0], seen * step, atol=1e-11 * seen)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (4.0, "expected a pair"),
        ((1.0, 2.0, 3.0), "expected a pair"),
        ((2.0, 2.0), "low < high, got 2.0 and 2.0"),
        ((1.0, np.nan), "low < high"),
        (([0.0, 1.0], [2.0, 3.0, 4.0]), "one size"),
        (([[0.0]], [[1.0]]), "one size"),
    ],
)
def test_what_is_refused(given, message):
    with pytest.raises(ValueError, match=f"g_limit: .*{message}"):
        Sampling(H, g_limit=given)


def test_channels_must_fit():
    two = FILTER.sampled(H, g_limit=([-1.0, -2.0], 3.0))
    assert two.sampling.g_limit is not None
    assert not two.sampling.g_limit.flags.writeable
    assert repr(two).endswith("sampled(0.002, g_limit=[[-1.0, -2.0], [3.0, 3.0]])")
    with pytest.raises(
        ValueError, match="g_limit: 2 pairs for 3 channels of g; expected one pair of numbers or 3"
    ):
        two.run(np.zeros((4, 3)))
    with pytest.raises(ValueError, match="g_limit: 2 pairs for 3 channels"):
        FILTER.sampled(H, E=np.eye(3)[:, :2], g_limit=([-1.0, -2.0], 3.0))
    with pytest.raises(ValueError, match=r"g_limit=.*has no linear block"):
        two.to_ss(2)
