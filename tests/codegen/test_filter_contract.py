"""One contract for the sampled filter in Python and in C: every option, every call, double and float."""

import ctypes
import itertools
from dataclasses import dataclass

import numpy as np
import pytest
from filter_harness import CFilter, compile_filters

from phyfilter_ctl import PhyFilter, SampledPhyFilter, place_poles, stack
from phyfilter_ctl.codegen.filter_code import filter_source

pytestmark = pytest.mark.slow  # the default suite has other tests of the same code

H = 0.002
N = 160
# The two sum the same few dozen terms in another order (Python through BLAS): last places of the largest f_hat, which
# is some ten times smaller than the largest of the terms. Measured: 5.5.
LAST_PLACES = 24
# A change of coefficients solves with a covariance whose condition is some tenfold an order for equal poles; the state
# it is applied to is one of likely states, which feel about its root. In float the work is done in double.
RETUNED = 4.0

LOWPASS = PhyFilter.from_poles([-20.0, -5 + 8j, -5 - 8j])
GENERAL = PhyFilter(LOWPASS.a, [LOWPASS.a[0], 0.7 * LOWPASS.a[1], 12.0], poles=LOWPASS.poles)
BANDPASS = PhyFilter(LOWPASS.a, [0.0, LOWPASS.a[1], 3.0], poles=LOWPASS.poles)
SIXTH = PhyFilter.from_poles([-30.0] * 6)
FILTERS = {"lowpass": LOWPASS, "general": GENERAL, "bandpass": BANDPASS, "sixth": SIXTH}
STACK = [PhyFilter([3.0]), PhyFilter([400.0, 40.0]), GENERAL]


def record():
    rng = np.random.default_rng(0)
    x = 0.02 * np.cumsum(rng.standard_normal((N, 3)), axis=0)
    g, f_theta = rng.standard_normal((2, N, 3))
    inertia = np.eye(3) + 0.1 * rng.standard_normal((N, 3, 3))
    times = np.cumsum(rng.uniform(0.5 * H, 1.5 * H, N))
    return x, g, f_theta, inertia, times, rng.standard_normal((3, 2))


X, G, F_THETA, M, TIMES, E = record()
INERTIA = {
    "none": (None, None),
    "scalar": (1.3, None),
    "diagonal": ([1.0, 2.0, 0.5], None),
    "full": (M[0], None),
    "scalar(t)": ("scalar", M[:, 0, 0]),
    "diagonal(t)": ("diagonal", M[:, 0]),
    "full(t)": ("full", M),
}
OPTIONS = {
    "plain": {},
    "delay": {"delay": 6.15 * H},
    "whole delay": {"delay": 3.0 * H},
    "limits": {"limit": [0.5, 1.0, 2.0], "g_limit": ([-0.3, -np.inf, 0.1], [0.5, 1.0, 2.0])},
    "E": {"E": E},
    "held": {"nonfinite": "hold"},
    "E, delay, held, limits": {
        "E": E,
        "delay": 2.6 * H,
        "nonfinite": "hold",
        "limit": 1.5,
        "g_limit": (-0.4, 0.7),
    },
}


@dataclass(frozen=True)
class Case:
    name: str
    sampled: SampledPhyFilter
    inertia: str
    variable: bool  # unequal steps
    tunable: bool = True


# Type 2, and nothing left of a sine of 6 rad/s, at the samples too.
MATCHED = place_poles([-20.0] * 5, type=2, zeros_at=[6.0])


def cases() -> list[Case]:
    """Every pair of option values once or more, by walking through the longest lists with coprime strides."""
    found = []
    rules = list(itertools.product(["hold", "average"], repeat=2))
    k = 0
    for settings in OPTIONS.values():
        for rule in rules:
            for precision in ("float64", "float32"):
                method = ["exact", "tustin", "euler"][k % 3]
                filter = list(FILTERS.values())[(k // 2) % 4]
                sampled = filter.sampled(H, method, *rule, precision=precision, **settings)
                inertia = list(INERTIA)[k % len(INERTIA)]
                found.append(Case(f"case{k}_{precision}", sampled, inertia, k % 5 < 2, k % 4 != 1))
                k += 1
    for precision in ("float64", "float32"):
        sampled = stack([entry.sampled(H, precision=precision, limit=4.0) for entry in STACK])
        found += [
            Case(f"stack_{precision}", sampled, "none", True),
            Case(f"stack_fixed_{precision}", sampled, "full", False, False),
            Case(f"matched_{precision}", MATCHED.sampled(18e-3, precision=precision), "none", True),
        ]
    return found


CASES = cases()


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    sources = {
        case.name: filter_source(
            case.sampled,
            3,
            name=case.name,
            inertia=INERTIA[case.inertia][0],
            variable=case.variable,
            tunable=case.tunable,
        )
        for case in CASES
    }
    return sources, compile_filters(list(sources.values()), tmp_path_factory.mktemp("filters"))


def at(values, k):
    return None if values is None else values[k]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_steps_are_the_same(case, compiled):
    sources, library = compiled
    sampled, ours = case.sampled, CFilter(library, sources[case.name])
    constant, moving = INERTIA[case.inertia]
    x, g, f_theta = X.copy(), G.copy(), F_THETA[:, : ours.source.n_f].copy()
    if sampled.sampling.nonfinite == "hold":
        x[50], x[60:64, 1], f_theta[90, 0], g[100] = np.nan, np.inf, np.nan, -np.inf
    dtype = np.dtype(sampled.sampling.precision)
    x, g, f_theta = x.astype(dtype), g.astype(dtype), f_theta.astype(dtype)

    state = sampled.start(
        x[0], f_theta0=f_theta[0], g0=g[0], inertia0=None if isinstance(constant, str) else constant
    )
    if moving is not None:
        state = sampled.start(x[0], f_theta0=f_theta[0], g0=g[0], inertia0=moving[0])
    assert ours.start(x[0], None, f_theta[0], at(moving, 0), g[0]) == 0
    expected, got = np.empty((2, N - 1, ours.source.n_f))
    for k in range(1, N):
        dt = float(TIMES[k] - TIMES[k - 1]) if case.variable else None
        if k == 70:  # a reset of the estimate of x, in both
            state = sampled.shift_x(state, [0.5, -3.0, 0.0])
            assert ours.call("shift_x", [0.5, -3.0, 0.0]) == 0
        if k >= 70:
            x[k] += np.array([0.5, -3.0, 0.0], dtype)
        if k == 110 and case.tunable:
            new = retuned(sampled)
            following = sampled.with_filter(new)
            state, sampled = sampled.retune(state, following), following
            assert ours.retune([entry.a for entry in new], [entry.b for entry in new]) == 0
        g_given = g[k - 1] if sampled.sampling.g == "hold" else g[k]
        state, expected[k - 1] = sampled.step(state, x[k], g_given, f_theta[k], inertia=at(moving, k), dt=dt)
        code, got[k - 1] = ours.step(x[k], g_given, f_theta[k], at(moving, k), dt)
        assert code == 0
    scale = np.abs(expected).max()
    assert scale > 0.3
    places = np.full((N - 1, 1), LAST_PLACES * np.finfo(dtype).eps * scale)
    if dtype == np.float64:
        places[109:] *= RETUNED ** (sampled.order - 1)
    assert np.all(np.abs(got - expected) <= places)


def retuned(sampled: SampledPhyFilter) -> list[PhyFilter]:
    """Other coefficients of the same orders; simple poles, so that both find them from a to the last places."""
    new = []
    for entry in sampled.filters:
        poles = -12.0 * 1.6 ** np.arange(entry.order) + 0j
        if entry.order == 3:
            poles[1:] = [-9 + 14j, -9 - 14j]
        other = PhyFilter.from_poles(poles)
        new.append(PhyFilter(other.a, 0.8 * other.a * entry.b / entry.a))
    return new


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_two_phases_are_the_step(precision, compiled):
    """Put out, then remember g: the g of the sample before acts, and the first instant is the start."""
    sources, library = compiled
    for case in CASES:
        if (
            case.sampled.sampling.precision != precision
            or case.variable
            or case.sampled.sampling.nonfinite == "hold"
        ):
            continue
        source, moving = sources[case.name], INERTIA[case.inertia][1]
        phased, stepped = CFilter(library, source), CFilter(library, source)
        f_theta = F_THETA[:, : source.n_f]
        assert stepped.start(X[0], None, f_theta[0], at(moving, 0), G[0]) == 0
        for k in range(30):
            code, f_hat = phased.step(X[k], G[k], f_theta[k], at(moving, k), name="output")
            assert code == 0
            phased.call("remember", G[k])
            if k == 0:
                limit = case.sampled.sampling.limit
                first = f_theta[0] if limit is None else np.clip(f_theta[0], -limit, limit)
                np.testing.assert_array_equal(f_hat, first.astype(precision))
                continue
            g = G[k - 1] if case.sampled.sampling.g == "hold" else G[k]
            np.testing.assert_array_equal(f_hat, stepped.step(X[k], g, f_theta[k], at(moving, k))[1])


def simple(tmp_path, sampled, **settings):
    source = filter_source(sampled, 2, name="one", **settings)
    return source, CFilter(compile_filters([source], tmp_path), source)


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_start_at_an_estimate(tmp_path, precision):
    sampled = GENERAL.sampled(H, precision=precision)
    _, ours = simple(tmp_path, sampled)
    state = sampled.start([0.1, 0.2], f_hat0=[2.0, -3.0], f_theta0=[0.5, 0.25])
    assert ours.start([0.1, 0.2], [2.0, -3.0], [0.5, 0.25]) == 0
    for k in range(1, 20):
        x = np.array([0.1, 0.2]) + H * k * np.array([2.0, -3.0])
        state, expected = sampled.step(state, x, np.zeros(2), [0.5, 0.25])
        _, got = ours.step(x, np.zeros(2), [0.5, 0.25])
        np.testing.assert_allclose(got, expected, rtol=LAST_PLACES * np.finfo(precision).eps)


def test_what_is_refused_changes_nothing(tmp_path):
    limited = GENERAL.sampled(
        40.0 * H, "euler", limit=2.0, g="average", g_limit=(-1.0, 1.0)
    )  # diverges at 50 H
    _, ours = simple(tmp_path, limited)
    ours.start(X[0, :2], None, F_THETA[0, :2])
    ours.step(X[1, :2], G[1, :2], F_THETA[1, :2])
    before = ours.memory.copy()
    bad = np.array([0.0, np.nan])
    a = np.array(GENERAL.a)
    refusals = {
        "x": (1, ours.step(bad, G[2, :2], F_THETA[2, :2])),
        "g": (1, ours.step(X[2, :2], bad, F_THETA[2, :2])),
        "f_theta": (1, ours.step(X[2, :2], G[2, :2], [np.inf, 0.0])),
        "dt 0": (2, ours.step(X[2, :2], G[2, :2], F_THETA[2, :2], dt=0.0)),
        "dt nan": (2, ours.step(X[2, :2], G[2, :2], F_THETA[2, :2], dt=np.nan)),
        "dt too long for Euler": (2, ours.step(X[2, :2], G[2, :2], F_THETA[2, :2], dt=70.0 * H)),
        "not Hurwitz": (5, ours.retune([a * [1, -1, 1]], [GENERAL.b])),
        "marginal": (5, ours.retune([a * [1, 0, 1]], [GENERAL.b])),
        "a nan": (1, ours.retune([a * np.nan], [GENERAL.b])),
        "b inf": (1, ours.retune([a], [GENERAL.b * np.inf])),
        "Euler diverges": (2, ours.retune([[1e9, 3e6, 3e3]], [GENERAL.b])),
        "limit 0": (7, ours.call("set_limit", [1.0, 0.0])),
        "limit nan": (7, ours.call("set_limit", [np.nan, 1.0])),
        "g_limit": (7, ours.call("set_g_limit", [0.0, 1.0], [1.0, 1.0])),
        "g_limit nan": (7, ours.call("set_g_limit", [0.0, np.nan], [1.0, 1.0])),
        "shift": (1, ours.call("shift_x", bad)),
        "poles": (5, ours.call("retune_poles", [[[-1.0, 1.0], [-1.0, -2.0], [-3.0, 0.0]]], [GENERAL.b])),
        "start": (1, ours.start(bad)),
    }
    for what, (expected, got) in refusals.items():
        code = got if isinstance(got, int) else got[0]
        assert code == expected, what
        if not isinstance(got, int):
            assert np.isnan(got[1]).all(), f"{what}: f_hat was written"
    np.testing.assert_array_equal(ours.memory, before)


def test_band_pass_has_no_estimate_to_start_from(tmp_path):
    _, ours = simple(tmp_path, BANDPASS.sampled(H), tunable=False, variable=False)
    assert ours.start(X[0, :2], [1.0, 0.0]) == 6
    assert ours.start(X[0, :2], [0.0, 0.0]) == 0


def test_parameters_are_checked(tmp_path):
    source = filter_source(GENERAL.sampled(H, precision="float32"), 2, name="one")
    library = compile_filters([source], tmp_path)
    ours = CFilter(library, source)
    original = (ctypes.c_ubyte * 8).in_dll(library, "one_parameters")
    size = 8 + 8 + 2 * 8 + 3 * 8 * 4 + 4 * (9 + 3 + 3)
    whole = np.frombuffer(ctypes.string_at(ctypes.addressof(original), size), np.uint8)
    for place, code in ((0, 3), (4, 4), (8, 4), (20, 4), (60, 4), (size - 2, 4)):
        damaged = whole.copy()
        damaged[place] ^= 4
        init = library["one_init"]
        assert init(ctypes.c_void_p(ours.memory.ctypes.data), ctypes.c_void_p(damaged.ctypes.data)) == code


def test_memory_is_all_there_is(tmp_path):
    """A copy of the instance goes on exactly as the instance does."""
    sampled = GENERAL.sampled(H, delay=0.011, nonfinite="hold", precision="float32")
    _, ours = simple(tmp_path, sampled, inertia="diagonal")
    ours.start(X[0, :2])
    for k in range(1, 60):
        ours.step(X[k, :2] * (np.nan if k in (30, 57, 58, 59) else 1.0), G[k, :2], F_THETA[k, :2], [1.0, 2.0])
    saved = ours.memory.copy()
    first = [ours.step(X[k, :2], G[k, :2], F_THETA[k, :2], [1.5, 2.0])[1] for k in range(60, 90)]
    ours.memory[:] = saved
    again = [ours.step(X[k, :2], G[k, :2], F_THETA[k, :2], [1.5, 2.0])[1] for k in range(60, 90)]
    np.testing.assert_array_equal(first, again)


@pytest.mark.slow
def test_many_short_steps_in_a_long_delay(tmp_path):
    """More intervals than are kept: neighbours are joined, the mean stays, only detail is lost."""
    sampled = LOWPASS.sampled(H, delay=10 * H, g="average")
    source, ours = simple(tmp_path, sampled)
    assert "one_PAST 13" in source.sources["one.h"]
    times = np.cumsum(np.random.default_rng(3).uniform(0.02 * H, 0.3 * H, 4000))
    times -= times[0]
    g = np.stack([np.sin(9.0 * times), np.cos(4.0 * times)], axis=1)
    zero = np.zeros(2)
    state = sampled.start(zero, g0=g[0])
    ours.start(zero, None, None, None, g[0])
    worst = 0.0
    for k in range(1, len(times)):
        dt = float(times[k] - times[k - 1])
        state, expected = sampled.step(state, zero, g[k], zero, dt=dt)
        _, got = ours.step(zero, g[k], zero, dt=dt)
        worst = max(worst, float(np.abs(got - expected).max()))
    # Straight lines over delay / 13 instead of delay / 60: the sag of sin(9 t) over 3 ms is 1e-4.
    assert worst < 2e-4
