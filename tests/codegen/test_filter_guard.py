"""Filters behind real signals, in C: faults that the guard can see are said, bounded, and forgotten as fast as the
filter settles."""

import ctypes
from pathlib import Path

import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, SampledPhyFilter
from phyfilter_ctl.codegen.compiler import compile_sources
from phyfilter_ctl.codegen.export_folder import own_symbols
from phyfilter_ctl.codegen.filter_code import filter_source
from phyfilter_ctl.codegen.filter_guard import guard_sources

pytestmark = pytest.mark.slow
H = 0.002
FILTER = PhyFilter.from_poles([-30.0, -20.0 + 15.0j, -20.0 - 15.0j])
SETTLING = int(0.8 / H)  # 16 time constants of the slowest poles: a fault has faded to 1e-7 of itself
STRICT = ["-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion", "-Wdouble-promotion", "-Werror"]
MISSED, NOT_FINITE, TIME, LIMIT, REFUSED, STATE, REPAIRED, DAMAGED = (1 << i for i in range(8))
ACCESS = (Path(__file__).parents[1] / "c" / "guard_access.c").read_text()
DA, STATES, DA_OTHER, ORDER, A, B, POLES, A_HOME, POLES_HOME, RATE, DT, PARAMETERS, OPTIONAL = range(13)


class Guard:
    """One guarded filter of two channels in C, and the same filter in Python."""

    def __init__(self, folder, precision, *, inertia=None, E=None, places="AT(C)", filter_=FILTER, **options):
        self.sampled = filter_.sampled(H, precision=precision, **options)
        if E is not None:
            self.sampled = SampledPhyFilter(self.sampled.filters, self.sampled.sampling, E=E)
        source = filter_source(self.sampled, 2, name="craft", inertia=inertia)
        texts = (
            own_symbols(source.sources, "craft")
            | guard_sources("craft", 0)
            | {"access.c": ACCESS.replace("PLACES_OF_OPTIONS", places)}
        )
        self.library = ctypes.CDLL(
            str(compile_sources(texts, folder / "guard.so", flags=[*STRICT, "-fvisibility=default"]))
        )
        self.dtype = np.dtype(precision)
        # Of forces of some N: what is left of a fault, and the rounding of samples in float.
        self.faded = 1e-5 + (2e-3 if precision == "float32" else 0.0)
        assert self.library.begin() == 0

    def step(self, time, x, g=0.0, f_theta=0.0, *, inertia=None, in_place=False):
        """Health and f_hat of one sample; time in steps."""
        values = [np.broadcast_to(value, 2).astype(self.dtype) for value in (x, g, f_theta)]
        f_hat = values[2] if in_place else np.full(2, np.nan, self.dtype)
        values += [f_hat] if inertia is None else [f_hat, np.array(inertia, self.dtype)]
        pointers = [value.ctypes.data_as(ctypes.c_void_p) for value in values]
        pointers += [None] if inertia is None else []
        microseconds = ctypes.c_uint64(round(time * H * 1e6) + 1_000_000)
        return self.library.step(microseconds, *pointers), f_hat

    def send(self, poles, damage=0):
        pairs = np.array([[p.real, p.imag] for p in poles])
        a = np.poly(poles)[:0:-1].real
        b = np.array([a[0], *np.zeros(len(poles) - 1)])
        return self.library.send(
            pairs.ctypes.data_as(ctypes.c_void_p), b.ctypes.data_as(ctypes.c_void_p), damage
        )

    def count(self, which):
        return self.library.count(["missed", "bad", "jumps", "refused", "implausible"].index(which))


@pytest.fixture(scope="module", params=["float64", "float32"])
def built(request, tmp_path_factory):
    return Guard(tmp_path_factory.mktemp(request.param), request.param)


@pytest.fixture
def guard(built):
    assert built.library.begin() == 0
    return built


def flight(samples, seed=1):
    """v of a body that a force of some N pushes, and the thrust it knows of."""
    rng = np.random.default_rng(seed)
    t = np.arange(samples) * H
    force = 2.0 * np.sin(3.0 * t)[:, None] + [1.0, -0.5]
    g = 0.3 * rng.standard_normal((samples, 2))
    return np.cumsum((force + g) * H, axis=0), g


def fly(guard, x, g, times=None):
    out = [guard.step(k if times is None else times[k], x[k], g[k]) for k in range(len(x))]
    return np.array([health for health, _ in out]), np.array([f_hat for _, f_hat in out])


def test_without_faults_it_is_the_filter(guard):
    x, g = flight(400)
    health, f_hat = fly(guard, x, g)
    state = guard.sampled.start(x[0].astype(guard.dtype), g0=g[0].astype(guard.dtype))
    reference = [np.zeros(2)]
    for k in range(1, 400):
        state, value = guard.sampled.step(state, x[k].astype(guard.dtype), g[k].astype(guard.dtype))
        reference.append(value)
    assert not health.any()
    np.testing.assert_allclose(f_hat, reference, rtol=0, atol=2e3 * np.finfo(guard.dtype).eps)


def test_missing_samples_are_one_longer_step(guard):
    x, g = flight(400)
    held = np.repeat(g[::40], 40, axis=0)  # held g: a longer step then knows its mean
    x = x - np.cumsum((g - held) * H, axis=0)
    kept = np.ones(400, bool)
    kept[[50, 51, 52, 120]] = False
    indices = np.flatnonzero(kept)
    health, f_hat = fly(guard, x[kept], held[kept], indices)
    assert [int(i) for i in indices[health == MISSED]] == [53, 121]
    assert guard.count("missed") == 4
    assert guard.library.begin() == 0
    _, whole = fly(guard, x, held)
    # A longer step takes the force as constant over 8 ms: 2 N * 3 rad/s * 4 ms of it, and fades.
    np.testing.assert_allclose(f_hat[health == MISSED], whole[[53, 121]], atol=0.03)
    np.testing.assert_allclose(f_hat[-1], whole[-1], atol=1e-3)


def test_what_is_not_finite_is_held(guard):
    x, g = flight(400)
    _health, f_hat = fly(guard, x[:200], g[:200])
    for k in range(200, 210):
        bad, value = guard.step(k, [np.nan, x[k, 1]], g[k], f_theta=0.5)
        assert bad == NOT_FINITE
        np.testing.assert_allclose(value, f_hat[-1] + 0.5, rtol=1e-6)
    bad, value = guard.step(210, x[210], g[210], f_theta=np.inf)
    assert bad == NOT_FINITE
    assert np.isfinite(value).all()
    assert guard.step(211, x[211], g[211])[0] == MISSED
    assert guard.count("bad") == 11


@pytest.mark.parametrize("jump", [-150, 0, 100, 10**12])
def test_time_that_makes_no_sense_starts_again_without_a_jump(guard, jump):
    x, g = flight(300 + SETTLING)
    _, before = fly(guard, x[:200], g[:200])
    health, value = guard.step(199 + jump, x[200], g[200])
    assert health == TIME
    assert guard.count("jumps") == 1
    np.testing.assert_allclose(value, before[-1], rtol=1e-5)
    n = len(x)
    health, after = fly(guard, x[201:], g[201:], np.arange(200, n) + jump)
    assert not health.any()
    guard.library.begin()
    _, whole = fly(guard, x, g)
    np.testing.assert_allclose(after[-1], whole[-1], rtol=0, atol=guard.faded)


def test_tuning_from_another_thread(guard):
    x, g = flight(200 + SETTLING)
    _, before = fly(guard, x[:200], g[:200])
    faster = [-60.0, -40.0 + 10.0j, -40.0 - 10.0j]
    assert guard.send(faster, damage=1) == 4  # PF_FILTER_CORRUPT
    assert guard.send(faster, damage=2) == 3  # PF_FILTER_VERSION
    assert guard.send([-60.0, 1.0, -2.0]) == 5  # PF_FILTER_NOT_HURWITZ
    assert guard.send(faster) == 0
    assert guard.send(faster) == 7  # the first was not seen yet
    health, value = guard.step(200, x[200], g[200])
    assert health == 0
    np.testing.assert_allclose(value, before[-1], atol=0.2)  # one step's change, not a jump to 0
    assert guard.send(faster, damage=3) == 0
    assert guard.step(201, x[201], g[201])[0] == REFUSED
    assert guard.count("refused") == 1
    health, after = fly(guard, x[202:], g[202:], np.arange(202, len(x)))
    retuned = PhyFilter.from_poles(faster).sampled(H)
    state, expected = retuned.start(x[0], g0=g[0]), np.zeros(2)
    for k in range(1, len(x)):
        state, expected = retuned.step(state, x[k], g[k])
    assert not health.any()
    np.testing.assert_allclose(after[-1], expected, atol=guard.faded)


def test_bits_that_flip_in_the_coefficients_are_found_and_put_back(guard):
    x, g = flight(200 + SETTLING)
    guard.library.begin()
    _, whole = fly(guard, x, g)
    rng = np.random.default_rng(2)
    for _ in range(6):
        guard.library.begin()
        fly(guard, x[:200], g[:200])
        guard.library.flip(DA, int(rng.integers(guard.library.size(DA))), int(rng.integers(8)))
        guard.library.check()
        health, value = guard.step(200, x[200], g[200])
        assert health == REPAIRED
        np.testing.assert_allclose(value, whole[200], atol=0.2)
        health, after = fly(guard, x[201:], g[201:], np.arange(201, len(x)))
        assert not health.any()
        np.testing.assert_allclose(after[-1], whole[-1], rtol=0, atol=guard.faded)


def test_bits_that_flip_in_the_state_are_bounded_and_forgotten(guard):
    x, g = flight(200 + SETTLING)
    _, whole = fly(guard, x, g)
    bound, seen = 10.0, 0
    rng = np.random.default_rng(3)
    for _ in range(20):
        guard.library.begin()
        guard.library.bound(ctypes.c_double(bound))
        fly(guard, x[:200], g[:200])
        guard.library.flip(STATES, int(rng.integers(guard.library.size(STATES))), int(rng.integers(8)))
        health, after = fly(guard, x[200:], g[200:], np.arange(200, len(x)))
        assert np.abs(after).max() <= bound
        assert set(health) <= {0, STATE}
        seen += STATE in health
        np.testing.assert_allclose(after[-1], whole[-1], rtol=0, atol=guard.faded)
    assert seen > 1, "no flip was large"


def test_a_limit_that_binds_is_said(tmp_path):
    limited = Guard(tmp_path, "float64", limit=1.5)
    x, g = flight(600)
    health, f_hat = fly(limited, x, g)
    assert ((health == LIMIT) == (np.abs(f_hat).max(axis=1) >= 1.5)).all()
    assert (health == LIMIT).any()


def test_f_hat_in_the_memory_of_f_theta(guard):
    x, g = flight(300)
    x = x + 0.5 * H * np.arange(300)[:, None]  # f_theta explains this part
    apart = [guard.step(k, x[k] if k != 250 else np.nan, g[k], 0.5) for k in range(300)]
    guard.library.begin()
    in_place = [guard.step(k, x[k] if k != 250 else np.nan, g[k], 0.5, in_place=True) for k in range(300)]
    assert [health for health, _ in in_place] == [health for health, _ in apart]
    np.testing.assert_array_equal([f_hat for _, f_hat in in_place], [f_hat for _, f_hat in apart])


def test_the_limit_holds_whatever_comes_in(tmp_path):
    limited = Guard(tmp_path, "float64", limit=1.5)
    x, g = flight(600)
    health, f_hat = fly(limited, x, g)
    at_limit = next(int(k) for k in np.flatnonzero(health == LIMIT) if f_hat[k, 0] == 1.5)
    for bad, expected in (("x", NOT_FINITE), ("time", TIME), ("state", STATE)):
        limited.library.begin()
        fly(limited, x[: at_limit + 1], g[: at_limit + 1])
        limited.library.bound(ctypes.c_double(1e-3 if bad == "state" else 0.0))
        time, sample = at_limit + (0 if bad == "time" else 1), x[at_limit + 1]
        # f_theta alone is beyond the limit, and so is f_theta with the correction.
        said, value = limited.step(
            time, sample * (np.nan if bad == "x" else 1.0), g[at_limit + 1], f_theta=2.0
        )
        assert said == expected | LIMIT
        np.testing.assert_array_equal(value, 1.5)


def test_an_inertia_that_is_not_given_again_survives_a_restart(tmp_path):
    heavy = Guard(tmp_path, "float64", inertia="scalar", nonfinite="hold")
    x, g = flight(300 + SETTLING)
    M = 2.0  # M x' = g + f: the velocities of half the force
    state, expected = heavy.sampled.start(x[0] / M, g0=g[0], inertia0=M), np.zeros(2)
    for k in range(1, 300 + SETTLING):
        state, expected = heavy.sampled.step(state, x[k] / M, g[k], inertia=M)
    for fault in ("time", "coefficients", "state", "inertia"):
        heavy.library.begin()
        x_heavy, offset = x / M, 0
        for k in range(300 + SETTLING):
            if k == 150:
                offset = -100 if fault == "time" else 0
                heavy.library.bound(ctypes.c_double(1e-3 if fault == "state" else 0.0))
                if fault == "coefficients":
                    heavy.library.flip(DA, 3, 4)
                    heavy.library.check()
            given = [M] if k == 0 else [np.nan] if (fault, k) == ("inertia", 150) else None
            health, f_hat = heavy.step(k + offset, x_heavy[k], g[k], inertia=given)
            if k == 150:
                assert (
                    health
                    == {"time": TIME, "coefficients": REPAIRED, "state": STATE, "inertia": NOT_FINITE}[fault]
                )
                heavy.library.bound(ctypes.c_double(0.0))
        assert heavy.count("bad") == (fault == "inertia")
        np.testing.assert_allclose(f_hat, expected, atol=heavy.faded)


def test_a_flip_in_any_number_that_stays_is_found(tmp_path):
    every = Guard(
        tmp_path, "float32", inertia=[1.0, 2.0], E=np.eye(2), delay=0.004, limit=20.0, g_limit=(-50.0, 50.0),
        places="AT(C), AT(equilibrium), AT(limit), AT(g_low), AT(g_high), AT(E_left), AT(inertia), AT(delay)",
    )  # fmt: skip
    x, g = flight(40)
    _, whole = fly(every, x, g)
    rng = np.random.default_rng(4)
    kept = [which for which in range(OPTIONAL + 8) if which not in (STATES, DA_OTHER, PARAMETERS)]
    assert every.library.size(OPTIONAL + 7) > 0 == every.library.size(OPTIONAL + 8)
    for which in kept:
        every.library.begin()
        fly(every, x[:30], g[:30])
        every.library.flip(which, int(rng.integers(every.library.size(which))), int(rng.integers(8)))
        every.library.check()
        health, value = every.step(30, x[30], g[30])
        assert health == REPAIRED, which
        np.testing.assert_allclose(value, whole[30], atol=0.3)
    # The transition of another length is under no CRC: a check makes the next longer step compute it anew.
    late = []
    for damage in (False, True):
        every.library.begin()
        fly(every, x[:30], g[:30])
        every.step(32, x[32], g[32])
        if damage:
            every.library.flip(DA_OTHER, 3, 6)
        every.library.check()
        health, value = every.step(34, x[34], g[34])
        assert health == MISSED
        late.append(value)
    np.testing.assert_array_equal(*late)


def test_parameters_that_are_damaged_too_stop_the_filter(guard):
    x, g = flight(200)
    fly(guard, x[:100], g[:100])
    guard.library.flip(ORDER, 0, 1)
    assert (
        guard.send([-60.0, -40.0 + 10.0j, -40.0 - 10.0j]) == 0
    )  # the other thread does not look at the filter
    guard.library.flip(PARAMETERS, 5, 5)
    guard.library.check()
    for k in (100, 101):
        health, value = guard.step(k, x[k], g[k], f_theta=0.25)
        assert health & ~REFUSED == DAMAGED  # the poles that were sent have no filter to go to
        np.testing.assert_array_equal(value, 0.25)
    guard.library.flip(PARAMETERS, 5, 5)  # as if read rightly again
    guard.library.check()
    assert guard.step(102, x[102], g[102])[0] == REPAIRED
    assert guard.step(103, x[103], g[103])[0] == 0


def test_a_guard_that_was_never_started_says_so(guard):
    guard.library.forget()
    guard.library.check()
    health, value = guard.step(0, 1.0, 2.0, f_theta=0.25)
    assert health == DAMAGED
    np.testing.assert_array_equal(value, 0.25)
    assert guard.send([-60.0, -40.0, -20.0]) == 7  # PF_FILTER_INVALID


def test_forward_euler_says_that_a_sample_came_late(tmp_path):
    euler = Guard(tmp_path, "float64", filter_=PhyFilter.from_poles([-300.0, -280.0, -260.0]), method="euler")
    x, g = flight(200)
    fly(euler, x[:100], g[:100])
    health, value = euler.step(103, x[103], g[103])  # 8 ms: |1 - 300 * 0.008| > 1
    assert health == MISSED
    assert euler.count("missed") == 3
    assert np.isfinite(value).all()
    assert euler.step(104, x[104], g[104])[0] == 0
