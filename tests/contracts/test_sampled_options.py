"""One contract for every combination of options: run == step loop == block == a plain recursion."""

import itertools
from dataclasses import replace

import control as ct
import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, SampledPhyFilter, Sampling, phyfilter_block, stack
from phyfilter_ctl.filter import PaperFilter
from tests.cpu_budget import slow_but

H = 0.002
N = 240
SHORT = 80  # two blocks of a record, and a part of one
# Sums of a few hundred rounded terms of size 1 to 30 on either side.
AGREE = 1e-11
# A step loop in float32 and a record whose states are in double differ by a few roundings of f_hat.
AGREE_FLOAT32 = 2e-6

LOWPASS = PhyFilter.from_poles([-20.0, -5 + 8j, -5 - 8j])
GENERAL = PhyFilter(LOWPASS.a, [LOWPASS.a[0], 0.7 * LOWPASS.a[1], 12.0], poles=LOWPASS.poles)
BANDPASS = PhyFilter(LOWPASS.a, [0.0, LOWPASS.a[1], 3.0], poles=LOWPASS.poles)


def record(seed=0, n_f=3):
    rng = np.random.default_rng(seed)
    x = 0.02 * np.cumsum(rng.standard_normal((N, 3)), axis=0)
    g, f_theta = rng.standard_normal((2, N, 3))
    inertia = np.eye(3) + 0.1 * rng.standard_normal((N, 3, 3))
    times = np.cumsum(rng.uniform(0.5 * H, 1.5 * H, N))
    direction = rng.standard_normal((3, 2))
    return x, g, f_theta[:, :n_f], inertia, times, direction


def by_steps(sampled: SampledPhyFilter, x, g, f_theta, inertia=None, times=None):
    steps = [None] * len(x) if times is None else [None, *np.diff(times)]
    state = sampled.start(
        x[0], f_theta0=f_theta[0], g0=g[0], inertia0=None if inertia is None else inertia[0]
    )
    f_hat, held = [sampled.recursion.limited(f_theta[0])], [False]
    for k in range(1, len(x)):
        state, out = sampled.step(
            state,
            x[k],
            g[k - 1] if sampled.sampling.g == "hold" else g[k],
            f_theta[k],
            inertia=None if inertia is None else inertia[k],
            dt=steps[k],
        )
        f_hat.append(out)
        held.append(state.held)
    return np.array(f_hat), np.array(held)


FORMS = {"lowpass": LOWPASS, "general": GENERAL, "bandpass": BANDPASS}


@pytest.mark.parametrize("filter", slow_but([GENERAL], FORMS.values()), ids=FORMS)
@pytest.mark.parametrize("method", ["exact", "euler", "tustin"])
@pytest.mark.parametrize("option", ["plain", "delay", "limits", "E", "float32", "delay, E, float32"])
def test_run_is_the_step_loop(filter, method, option):
    settings = {}
    *signals, direction = record(n_f=2 if "E" in option else 3)
    x, g, f_theta, inertia, times = (signal[:SHORT] for signal in signals)
    if "delay" in option:
        settings["delay"] = 0.0123
    if "limit" in option:
        settings |= {"limit": [0.5, 1.0, 2.0], "g_limit": ([-0.3, -np.inf, 0.1], [0.5, 1.0, 2.0])}
    if "E" in option:
        settings["E"] = direction
    if "float32" in option:
        settings["precision"] = "float32"
    # Each of these changes the way through the code; crossed pairwise they make the matrix.
    for g_rule, f_rule in itertools.product(["hold", "average"], ["hold", "average"]):
        sampled = filter.sampled(H, method, g_rule, f_rule, **settings)
        for M, t in ((None, None), (inertia, None), (inertia[:, 0], times), (None, times)):
            ours = sampled.run(x, g, f_theta, M, t)
            loop, _ = by_steps(sampled, x, g, f_theta, M, t)
            assert ours.dtype == sampled.sampling.precision
            tolerance = (
                AGREE if sampled.sampling.precision == "float64" else AGREE_FLOAT32 * 50
            )  # x / h: 50 m/s^2 a step
            np.testing.assert_allclose(ours, loop, atol=tolerance * max(1.0, np.abs(ours).max()), rtol=0)


@pytest.mark.parametrize("method", ["exact", "euler", "tustin"])
@pytest.mark.parametrize("delay", [0.0, H, 0.4 * H, 3.0 * H, 6.15 * H])
@pytest.mark.parametrize("with_direction", [False, True])
def test_block_is_the_record(method, delay, with_direction):
    x, g, f_theta, inertia, _, direction = record(n_f=2 if with_direction else 3)
    for g_rule, f_rule in itertools.product(["hold", "average"], ["hold", "average"]):
        sampled = GENERAL.sampled(
            H, method, g_rule, f_rule, delay=delay, E=direction if with_direction else None
        )
        block = phyfilter_block(sampled, 3, inertia=inertia[0])
        inputs = np.hstack([x, g, f_theta]).T
        response = ct.forced_response(
            block, H * np.arange(N), inputs, X0=block.rest_state(x[0], g[0], f_theta[0])
        )
        expected = sampled.run(x, g, f_theta, inertia[0])
        np.testing.assert_allclose(response.outputs.T, expected, atol=AGREE * np.abs(expected).max(), rtol=0)


@pytest.mark.parametrize("times", [False, True])
def test_stack_is_each_channel_alone(times):
    x, g, f_theta, _, stamps, _ = record()
    stamps = stamps if times else None
    filters = [LOWPASS, PhyFilter([3.0]), PhyFilter([400.0, 40.0])]
    stacked = stack([entry.sampled(H, limit=1.5) for entry in filters])
    ours = stacked.run(x, g, f_theta, times=stamps)
    for i, entry in enumerate(filters):
        alone = entry.sampled(H, limit=1.5).run(x[:, [i]], g[:, [i]], f_theta[:, [i]], times=stamps)
        np.testing.assert_allclose(ours[:, [i]], alone, atol=AGREE)
    np.testing.assert_allclose(ours, by_steps(stacked, x, g, f_theta, times=stamps)[0], atol=AGREE)
    if not times:
        block = phyfilter_block(stack([entry.sampled(H) for entry in filters]))
        assert block.nstates == 6


@pytest.mark.parametrize("option", ["plain", "delay", "average", "float32"])
@pytest.mark.parametrize("times", [False, True])
def test_held_samples_never_enter_the_state(option, times):
    settings = {
        "plain": {},
        "delay": {"delay": 0.0101},
        "average": {"g": "average"},
        "float32": {"precision": "float32"},
    }[option]
    x, g, f_theta, inertia, stamps, _ = record()
    stamps = stamps if times else None
    x[50], x[60:64, 1], g[100], f_theta[200, 0], inertia[150, 1, 1] = np.nan, np.inf, -np.inf, np.nan, np.nan
    sampled = GENERAL.sampled(H, nonfinite="hold", **settings)
    ours, held = sampled.run(x, g, f_theta, inertia, stamps), sampled.held(x, g, f_theta, inertia)
    loop, loop_held = by_steps(sampled, x, g, f_theta, inertia, stamps)
    assert np.isfinite(ours).all()
    np.testing.assert_array_equal(held, loop_held)
    assert held.sum() == 8
    tolerance = AGREE if sampled.sampling.precision == "float64" else 50 * AGREE_FLOAT32
    np.testing.assert_allclose(ours, loop, atol=tolerance * np.abs(ours).max(), rtol=0)
    # f_hat - f_theta stays while samples are held; where f_theta is missing, the last one there was counts.
    f_theta[200, 0] = f_theta[199, 0]
    for k in (50, 60, 61, 62, 63, 150, 200):
        wanted = f_theta[k] + ours[k - 1] - f_theta[k - 1]
        np.testing.assert_allclose(ours[k], wanted, atol=tolerance * np.abs(ours).max())


def test_a_held_gap_is_one_longer_step():
    x, g, f_theta, _, _, _ = record()
    sampled = LOWPASS.sampled(H, f_theta="hold", nonfinite="hold")
    g[:], f_theta[:] = g[0], f_theta[0]
    broken = x.copy()
    broken[30:40] = np.nan
    kept = np.r_[0:30, 40:N]
    times = H * np.arange(N)
    expected = sampled.run(x[kept], g[kept], f_theta[kept], times=times[kept])
    np.testing.assert_allclose(sampled.run(broken, g, f_theta)[kept], expected, atol=AGREE)


@pytest.mark.parametrize("filter", [PhyFilter([3.0]), PhyFilter([400.0, 40.0]), LOWPASS, GENERAL, BANDPASS])
def test_the_papers_realisation_is_the_same_filter(filter):
    x, g, f_theta, _, _, _ = record()
    euler = filter.sampled(H, "euler", "hold", "hold")
    paper = PaperFilter(filter, H)
    np.testing.assert_allclose(paper.run(x, g, f_theta), euler.run(x, g, f_theta), atol=1e-10)


EULER = Sampling(H, "euler", "hold", "hold")


@pytest.mark.parametrize(
    "sampled",
    [
        SampledPhyFilter(GENERAL, EULER),
        SampledPhyFilter(GENERAL, replace(EULER, delay=0.0051)),
        PaperFilter(GENERAL, H),
    ],
)
def test_a_reset_of_x_is_no_acceleration(sampled):
    x, g, f_theta, _, _, _ = record()
    expected = sampled.run(x, g, f_theta)
    state = sampled.start(x[0], f_theta0=f_theta[0])
    jump = np.zeros(3)
    for k in range(1, N):
        if k == 100:
            jump = np.array([0.5, -3.0, 0.0])
            state = sampled.shift_x(state, jump)
        state, f_hat = sampled.step(state, x[k] + jump, g[k - 1], f_theta[k])
        np.testing.assert_allclose(f_hat, expected[k], atol=1e-9)


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize(
    "new",
    [LOWPASS, GENERAL, BANDPASS, PhyFilter([2.0]), PhyFilter.from_poles([-9.0] * 5)],
    ids=lambda f: str(f.order),
)
def test_retuning_does_not_bump(precision, new):
    x, g, f_theta, _, _, _ = record()
    old = GENERAL.sampled(H, precision=precision)
    state = old.start(x[0], f_theta0=f_theta[0])
    for k in range(1, 120):
        state, before = old.step(state, x[k], g[k - 1], f_theta[k])
    following = old.with_filter(new)
    state = old.retune(state, new)
    C = following.transition[2]
    states = state.w if state.carry is None else state.w + state.carry
    tolerance = 1e-12 if precision == "float64" else 1e-5
    np.testing.assert_allclose(f_theta[119] + states @ C, before, atol=tolerance * np.abs(before).max())
    state, after = following.step(state, x[120], g[119], f_theta[120])
    assert np.isfinite(after).all()


def test_retuning_to_itself_changes_nothing():
    x, g, f_theta, _, _, _ = record()
    sampled = GENERAL.sampled(H)
    state = sampled.start(x[0])
    for k in range(1, 30):
        state, _ = sampled.step(state, x[k], g[k - 1], f_theta[k])
    np.testing.assert_allclose(sampled.retune(state, GENERAL).w, state.w, rtol=1e-12)


@pytest.mark.parametrize("filter", [LOWPASS, GENERAL])
def test_start_at_an_estimate(filter):
    sampled = filter.sampled(H)
    state = sampled.start(np.zeros(2), f_hat0=[2.0, -3.0], f_theta0=[0.5, 0.5])
    # x' = g + f with the f that the start assumed: the estimate stays.
    for k in range(1, 50):
        state, f_hat = sampled.step(state, H * k * np.array([2.0, -3.0]), np.zeros(2), [0.5, 0.5])
        np.testing.assert_allclose(f_hat, [2.0, -3.0], atol=1e-12)


def test_limit_clamps_the_output_never_the_state():
    x, g, f_theta, _, _, _ = record()
    free, clamped = GENERAL.sampled(H), GENERAL.sampled(H, limit=0.3)
    np.testing.assert_array_equal(clamped.run(x, g, f_theta), np.clip(free.run(x, g, f_theta), -0.3, 0.3))


@pytest.mark.parametrize("option", ["plain", "average", "delay", "E", "limit", "float32", "stack"])
@pytest.mark.parametrize("inertia", ["none", "diagonal", "each", "full"])
def test_many_systems_are_each_system_alone(option, inertia):
    settings = {"average": {"g": "average"}, "delay": {"delay": 0.0051}, "limit": {"limit": [0.5, 1.0, 2.0]}}
    settings |= {"float32": {"precision": "float32"}}
    rng = np.random.default_rng(2)
    E = rng.standard_normal((3, 2)) if option == "E" else None
    filters = [LOWPASS, PhyFilter([3.0]), GENERAL] if option == "stack" else GENERAL
    sampled = SampledPhyFilter(filters, Sampling(H, **settings.get(option, {})), E=E)
    many = (2, 3)
    x = 0.02 * np.cumsum(rng.standard_normal((20, *many, 3)), axis=0)
    g, f_theta = (
        rng.standard_normal((20, *many, 3)),
        rng.standard_normal((20, *many, 2 if E is not None else 3)),
    )
    M = {
        "none": None,
        "diagonal": rng.uniform(1.0, 2.0, 3),
        "each": rng.uniform(1.0, 2.0, (*many, 3)),
        "full": np.eye(3) + 0.1 * rng.standard_normal((*many, 3, 3)),
    }[inertia]

    def march(signals, M):
        x, g, f_theta = signals
        state, f_hat = sampled.start(x[0], f_theta0=f_theta[0], g0=g[0]), []
        for k in range(1, len(x)):
            dt = 1.5 * H if k == 7 else None
            state, out = sampled.step(state, x[k], g[k], f_theta[k], inertia=M, dt=dt)
            f_hat.append(out)
        state = sampled.retune(sampled.shift_x(state, x[-1]), sampled.with_filter(BANDPASS))
        return np.array(f_hat), state.w

    together, retuned = march((x, g, f_theta), M)
    tolerance = AGREE if option != "float32" else AGREE_FLOAT32 * 50
    for one in np.ndindex(many):
        alone, w = march(
            [part[(slice(None), *one)] for part in (x, g, f_theta)], M if M is None or M.ndim == 1 else M[one]
        )
        scale = max(1.0, np.abs(alone).max())
        np.testing.assert_allclose(together[(slice(None), *one)], alone, atol=tolerance * scale, rtol=0)
        np.testing.assert_allclose(retuned[one], w, atol=tolerance * max(1.0, np.abs(w).max()), rtol=0)


def test_many_systems_refuse_what_one_of_them_spoils():
    sampled = LOWPASS.sampled(H)
    state, x = sampled.start(np.zeros((4, 2))), np.zeros((4, 2))
    x[2, 1] = np.nan
    with pytest.raises(ValueError, match=r"x: .*got nan in row 2, column 1; the state is unchanged"):
        sampled.step(state, x)
    with pytest.raises(ValueError, match="one system at a time"):
        LOWPASS.sampled(H, nonfinite="hold").start(np.zeros((4, 2)))
    with pytest.raises(ValueError, match=r"inertia: expected a number or shape \(2,\) or \(2, 2\), \(4, 2\)"):
        sampled.step(state, np.zeros((4, 2)), inertia=np.ones((3, 2)))


def test_a_diagonal_may_become_a_matrix_in_a_gap():
    x, g, f_theta, inertia, _, _ = record()
    diagonal, full = inertia[0].diagonal().copy(), np.diag(inertia[0].diagonal())
    sampled = GENERAL.sampled(H, nonfinite="hold")
    answers = []
    for early in (diagonal, full):
        state = sampled.start(x[0], inertia0=early)
        for k in range(1, 20):
            state, f_hat = sampled.step(
                state,
                x[k] if not 8 < k < 14 else np.full(3, np.nan),
                g[k - 1],
                f_theta[k],
                inertia=early if k < 11 else full,
            )
        answers.append(f_hat)
    np.testing.assert_allclose(*answers, atol=AGREE * np.abs(answers[0]).max())
