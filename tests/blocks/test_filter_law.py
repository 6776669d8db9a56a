"""The law of a sampled filter in a diagram against the sampled filter itself, over the matrix of its options."""

import itertools

import casadi as ca
import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, stack
from phyfilter_ctl.blocks.law import filter_law
from tests.cpu_budget import slow_but

H = 0.002
N = 160
# Both add up a few hundred rounded terms of size 1 to 30; relative to the largest f_hat.
AGREE = 1e-12
# Coefficients rounded to float32 alike, signals rounded by the float32 loop only; x/h reaches 30.
AGREE_FLOAT32 = 3e-5

LOWPASS = PhyFilter.from_poles([-20.0, -5 + 8j, -5 - 8j])
GENERAL = PhyFilter(LOWPASS.a, [LOWPASS.a[0], 0.7 * LOWPASS.a[1], 12.0], poles=LOWPASS.poles)
BANDPASS = PhyFilter(LOWPASS.a, [0.0, LOWPASS.a[1], 3.0], poles=LOWPASS.poles)


def record(n_f=3, seed=0):
    rng = np.random.default_rng(seed)
    x = 0.02 * np.cumsum(rng.standard_normal((N, 3)), axis=0)
    g, f_theta = rng.standard_normal((2, N, 3))
    M = np.eye(3) + 0.1 * rng.standard_normal((N, 3, 3))
    return x, g, f_theta[:, :n_f], M, rng.standard_normal((3, 2))


def by_law(law, *signals):
    """Output phase, then update phase, at every instant, on inputs that are all known."""
    v = np.hstack([np.asarray(part).reshape(len(part), -1) for part in signals])
    s = np.array([entry.start for entry in law.states])
    t, state, put_in, q = ca.SX.sym("t"), ca.SX.sym("s", len(s)), ca.SX.sym("v", v.shape[1]), ca.SX(0, 1)
    results = [function(t, state, put_in, q) for function in (law.dynamics, law.output)]
    states, f_hat = ca.Function("both", [state, put_in, t], results).mapaccum(len(v))(s, v.T, 0.0)
    assert states.shape == (len(s), len(v))
    return np.array(f_hat).T


def by_steps(sampled, x, g, f_theta, inertia=None):
    first = None if inertia is None else inertia[0]
    state = sampled.start(x[0], f_theta0=f_theta[0], g0=g[0], inertia0=first)
    limit = np.inf if sampled.sampling.limit is None else sampled.sampling.limit
    f_hat = [np.clip(f_theta[0], -limit, limit)]
    for k in range(1, len(x)):
        acting = g[k - 1] if sampled.sampling.g == "hold" else g[k]
        M = None if inertia is None else inertia[k]
        state, out = sampled.step(state, x[k], acting, f_theta[k], inertia=M)
        f_hat.append(out)
    return np.array(f_hat)


def check(sampled, law, x, g, f_theta, inertia=None, put_in=None):
    expected = by_steps(sampled, x, g, f_theta, inertia)
    signals = (x, g, f_theta) if put_in is None else (x, g, f_theta, put_in)
    tolerance = AGREE if sampled.sampling.precision == "float64" else AGREE_FLOAT32
    np.testing.assert_allclose(
        by_law(law, *signals), expected, atol=tolerance * np.abs(expected).max(), rtol=0
    )


FORMS = {"lowpass": LOWPASS, "general": GENERAL, "bandpass": BANDPASS}


@pytest.mark.parametrize("filter", slow_but([GENERAL], FORMS.values()), ids=FORMS)
@pytest.mark.parametrize("method", ["exact", "euler", "tustin"])
@pytest.mark.parametrize("option", ["plain", "delay", "limits", "E", "float32"])
@pytest.mark.parametrize("nonfinite", slow_but(["hold"], ["raise", "hold"]))
def test_law_is_the_step(filter, method, option, nonfinite):
    x, g, f_theta, _, direction = record(2 if option == "E" else 3)
    settings = {
        "plain": {},
        "delay": {"delay": 0.0123},
        "limits": {"limit": [0.5, 1.0, 2.0], "g_limit": ([-0.3, -np.inf, 0.1], [0.5, 1.0, 2.0])},
        "E": {"E": direction, "delay": 0.6 * H},
        "float32": {"precision": "float32"},
    }[option]
    for g_rule, f_rule in itertools.product(["hold", "average"], ["hold", "average"]):
        sampled = filter.sampled(H, method, g_rule, f_rule, nonfinite=nonfinite, **settings)
        law = filter_law(sampled, 3)
        check(sampled, law, x, g, f_theta)
        # g acts on f_hat without delay where it is averaged, unless a delay comes first; where samples may be held, a
        # bad one acts at once.
        acts = law.feedthrough[:, 3:6].any()
        assert acts == (g_rule == "average" and (sampled.sampling.delay < H or nonfinite == "hold"))


@pytest.mark.parametrize("delay", slow_but([0.4 * H, 3.0 * H], [0.0, H, 0.4 * H, 3.0 * H, 6.15 * H]))
@pytest.mark.parametrize("kind", ["scalar", "diagonal", "full", "constant", "constant diagonal", "none"])
def test_inertia(delay, kind):
    x, g, f_theta, M, direction = record(2)
    sampled = GENERAL.sampled(H, delay=delay, E=direction, g="average")
    given, put_in, inertia = {
        "scalar": (np.repeat(M[:, :1, 0], 3, axis=1), M[:, :1, 0], "scalar"),
        "diagonal": (M[:, :, 0], M[:, :, 0], "diagonal"),
        "full": (M, M, "full"),
        "constant": (np.broadcast_to(M[0], M.shape), None, M[0]),
        "constant diagonal": (np.broadcast_to(M[0, 0], (N, 3)), None, M[0, 0]),
        "none": (None, None, None),
    }[kind]
    check(sampled, filter_law(sampled, 3, inertia=inertia), x, g, f_theta, given, put_in)


def test_stack_of_orders():
    x, g, f_theta, _, _ = record()
    sampled = stack(
        [entry.sampled(H, limit=1.5) for entry in (LOWPASS, PhyFilter([3.0]), PhyFilter([400.0, 40.0]))]
    )
    law = filter_law(sampled, 3)
    assert sum(entry.name.startswith("w[") for entry in law.states) == 6
    check(sampled, law, x, g, f_theta)


@pytest.mark.parametrize("option", ["plain", "delay", "g average", "euler", "tustin", "first sample", "E"])
@pytest.mark.parametrize("moving", [False, True])
def test_held_samples(option, moving):
    """Bad samples of every signal, gaps of one and of many samples, a gap from the start on; against ``run``."""
    x, g, f_theta, M, direction = record(2 if option == "E" else 3)
    settings = {
        "delay": {"delay": 0.0101},
        "g average": {"g": "average"},
        "euler": {"method": "euler"},
        "tustin": {"method": "tustin"},
        "E": {"E": direction, "delay": 0.3 * H},
    }.get(option, {})
    x[50], x[60:64, 1], g[100], f_theta[110:135, 0], M[150, 1, 1] = np.nan, np.inf, -np.inf, np.nan, np.nan
    if option == "first sample":
        x[:3, 0], g[4, 1], f_theta[5], M[0, 0, 0] = np.nan, np.nan, np.inf, np.nan
    sampled = GENERAL.sampled(H, nonfinite="hold", **settings)
    if moving:
        ours = by_law(filter_law(sampled, 3, inertia="full"), x, g, f_theta, M)
        expected = sampled.run(x, g, f_theta, M)
    else:
        ours = by_law(filter_law(sampled, 3), x, g, f_theta)
        expected = sampled.run(x, g, f_theta)
    assert np.isfinite(ours).all()
    np.testing.assert_allclose(ours, expected, atol=AGREE * np.abs(expected).max(), rtol=0)


def test_first_held_g():
    """With g held, a bad first g is found in the update phase: sample 0 and sample 1 are held, as in ``run``."""
    x, g, f_theta, _, _ = record()
    g[0, 1] = np.nan
    sampled = GENERAL.sampled(H, nonfinite="hold")
    expected = sampled.run(x, g, f_theta)
    np.testing.assert_allclose(
        by_law(filter_law(sampled, 3), x, g, f_theta), expected, atol=AGREE * np.abs(expected).max(), rtol=0
    )


def test_a_gap_may_be_long():
    """5000 held samples: the longer step's transition is the power of the step's, to rounding."""
    rng = np.random.default_rng(3)
    x = np.cumsum(rng.standard_normal((5200, 1)), axis=0) * 0.01
    zero = np.zeros_like(x)
    x[100:5100] = np.nan
    sampled = PhyFilter.from_poles([-0.02, -0.05, -3.0]).sampled(H, nonfinite="hold")
    expected = sampled.run(x)
    np.testing.assert_allclose(
        by_law(filter_law(sampled, 1), x, zero, zero), expected, atol=1e-11 * np.abs(expected).max(), rtol=0
    )


def test_labels_and_starts():
    law = filter_law(PhyFilter([20.0]).sampled(H), 2, inertia="full")
    assert [entry.name for entry in law.inputs[-4:]] == ["M[0,0]", "M[0,1]", "M[1,0]", "M[1,1]"]
    assert [entry.start for entry in law.inputs[-4:]] == [1.0, 0.0, 0.0, 1.0]
    names = [
        entry.name
        for entry in filter_law(
            GENERAL.sampled(H, delay=2.5 * H, nonfinite="hold"), 2, inertia="scalar"
        ).states
    ]
    assert len(set(names)) == len(names)
    with pytest.raises(ValueError, match="E has 3 rows"):
        filter_law(PhyFilter([20.0]).sampled(H, E=np.eye(3)[:, :2]), 2)
