"""Filters behind real signals, in C: every fault is said, bounded, and forgotten as fast as the filter settles."""

import ctypes

import numpy as np
import pytest

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.codegen.compiler import compile_sources
from phyfilter_ctl.codegen.export_folder import own_symbols
from phyfilter_ctl.codegen.filter_guard import guard_sources
from phyfilter_ctl.codegen.filter_source import filter_source

pytestmark = pytest.mark.slow
H = 0.002
FILTER = PhyFilter.from_poles([-30.0, -20.0 + 15.0j, -20.0 - 15.0j])
SETTLING = int(0.8 / H)  # 16 time constants of the slowest poles: a fault has faded to 1e-7 of itself
STRICT = ["-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion", "-Wdouble-promotion", "-Werror"]
MISSED, NOT_FINITE, TIME, LIMIT, REFUSED, STATE, REPAIRED = (1 << i for i in range(7))
# What the tests look at, by name; and a tuning of the caller's choice.
ACCESS = """\
#include "craft_guard.h"
static craft_guard self, other;
int begin(void);
uint32_t step(uint64_t time, const craft_real *x, const craft_real *g, const craft_real *f_theta, craft_real *f_hat);
int send(const double *poles, const double *b, int damage);
void flip(int in_state, int byte, int bit);
int size(int in_state);
void bound(double value);
uint32_t count(int which);
void check(void);
int begin(void) { (void)other; return craft_guard_init(&self, &craft_parameters); }
uint32_t step(uint64_t time, const craft_real *x, const craft_real *g, const craft_real *f_theta, craft_real *f_hat) {
  return craft_guard_step(&self, time, x, g, f_theta, NULL, f_hat);
}
int send(const double *poles, const double *b, int damage) {
  craft_tuning tuning = {0};
  memcpy(tuning.poles, poles, sizeof tuning.poles);
  memcpy(tuning.b, b, sizeof tuning.b);
  craft_guard_seal(&tuning);
  if (damage == 1) tuning.b[0][0] += 1.0;
  if (damage == 2) tuning.version++;
  const int code = craft_guard_send(&self, &tuning);
  if (!code && damage == 3) self.tunings[(self.sent - 1u) & 1u].b[0][0] += 1.0; /* on its way */
  return code;
}
static unsigned char *place(int in_state) {
  return in_state ? (unsigned char *)self.filter.w : (unsigned char *)self.filter.dA;
}
int size(int in_state) { return (int)(in_state ? sizeof self.filter.w : sizeof self.filter.dA); }
void flip(int in_state, int byte, int bit) { place(in_state)[byte] ^= (unsigned char)(1u << bit); }
void bound(double value) { for (int i = 0; i < craft_N_F; i++) self.plausible[i] = (craft_real)value; }
uint32_t count(int which) {
  const uint32_t counts[] = {self.missed, self.bad, self.jumps, self.refused, self.implausible};
  return counts[which];
}
void check(void) { craft_guard_check(&self); }
"""


class Guard:
    """One guarded filter of two channels in C, and the same filter in Python."""

    def __init__(self, folder, precision, **options):
        self.sampled = FILTER.sampled(H, precision=precision, **options)
        source = filter_source(self.sampled, 2, name="craft")
        texts = (
            own_symbols(source.sources, "craft")
            | guard_sources("craft")
            | {"access.c": "#include <string.h>\n" + ACCESS}
        )
        self.library = ctypes.CDLL(
            str(compile_sources(texts, folder / "guard.so", flags=[*STRICT, "-fvisibility=default"]))
        )
        self.dtype = np.dtype(precision)
        # Of forces of some N: what is left of a fault, and the rounding of samples in float.
        self.faded = 1e-5 + (2e-3 if precision == "float32" else 0.0)
        assert self.library.begin() == 0

    def step(self, time, x, g=0.0, f_theta=0.0):
        """Health and f_hat of one sample; time in steps."""
        values = [np.broadcast_to(value, 2).astype(self.dtype) for value in (x, g, f_theta)]
        f_hat = np.full(2, np.nan, self.dtype)
        pointers = [value.ctypes.data_as(ctypes.c_void_p) for value in (*values, f_hat)]
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
        guard.library.flip(0, int(rng.integers(guard.library.size(0))), int(rng.integers(8)))
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
        guard.library.flip(1, int(rng.integers(guard.library.size(1))), int(rng.integers(8)))
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
