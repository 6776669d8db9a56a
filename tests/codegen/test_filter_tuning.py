"""New coefficients inside C, without libm: poles, transitions and outputs against Python, mpmath and numpy."""

import ctypes

import mpmath
import numpy as np
import pytest
from filter_harness import CFilter, compile_filters
from hypothesis import given, settings
from hypothesis import strategies as st

from phyfilter_ctl import PhyFilter, _sections
from phyfilter_ctl.codegen.compiler import compile_sources
from phyfilter_ctl.codegen.filter_code import filter_source, runtime_files
from phyfilter_ctl.filter.recursion import transition
from phyfilter_ctl.filter.retuning import moved

H = 0.002
# What C and Python may differ by where the poles are well conditioned; both err by some eps times the condition.
AGREE = 1e-13
METHODS = ["exact", "euler", "tustin"]


@pytest.fixture(scope="module")
def tune(tmp_path_factory):
    texts = runtime_files(
        ["pf_arithmetic.h", "pf_hurwitz.h", "pf_ieee.h", "pf_roots.c", "pf_tune.c", "pf_tune.h"]
    )
    texts["hurwitz.c"] = (
        '#include "pf_hurwitz.h"\nint hurwitz(int n, const double *a);\n'
        "int hurwitz(int n, const double *a) { return pf_hurwitz(n, a); }\n"
    )
    return Tune(
        compile_sources(texts, tmp_path_factory.mktemp("tune") / "tune.so", flags=["-fvisibility=default"])
    )


class Tune:
    """The functions of pf_tune.h on arrays."""

    def __init__(self, path):
        self.library = ctypes.CDLL(str(path))

    def _call(self, name, n, *arguments):
        kept = [np.ascontiguousarray(v) if isinstance(v, np.ndarray) else v for v in arguments]
        given = [ctypes.c_void_p(v.ctypes.data) if isinstance(v, np.ndarray) else v for v in kept]
        return self.library[name](n, *given)

    def hurwitz(self, a):
        return bool(self._call("hurwitz", len(a), np.asarray(a, dtype=float)))

    def roots(self, a):
        poles = np.zeros((len(a), 2))
        ok = self._call("pf_roots", len(a), np.asarray(a, dtype=float), poles)
        return poles @ [1.0, 1.0j] if ok else None

    def transition(self, poles, method, h):
        dA = np.zeros((len(poles), len(poles)))
        self._call("pf_transition", len(poles), pairs(poles), METHODS.index(method), ctypes.c_double(h), dA)
        return dA

    def chain(self, poles, a, b):
        n = len(poles)
        A, equilibrium, C = np.zeros((n, n)), np.zeros(n), np.zeros(n)
        self._call("pf_chain", n, pairs(poles), A, equilibrium)
        self._call("pf_chain_output", n, pairs(poles), np.array(a), np.array(b), C)
        return A, equilibrium, C

    def move_state(self, old, new, w):
        w = np.array(w)
        chains = [v for chain in (old, new) for v in (pairs(chain.poles), chain.equilibrium, chain.C)]
        self._call("pf_move_state", len(w), *chains, w)
        return w


def pairs(poles):
    return np.stack([poles.real, poles.imag], axis=1)


def spread_poles(n, rng):
    """Half real, half pairs, magnitudes a factor of 1.5 or more apart."""
    poles, size = [], 10.0 ** rng.uniform(-1, 1)
    while len(poles) < n:
        if n - len(poles) >= 2 and rng.random() < 0.5:
            damping = rng.uniform(0.1, 0.95)
            pole = size * (-damping + 1j * np.sqrt(1.0 - damping**2))
            poles += [pole, pole.conjugate()]
        else:
            poles.append(-size)
        size *= rng.uniform(1.5, 6.0)
    return _sections.pair_conjugates(np.array(poles, dtype=complex))


@pytest.mark.parametrize("n", range(1, 7))
def test_poles_are_pythons(tune, n):
    rng = np.random.default_rng(n)
    for _ in range(20):
        poles = spread_poles(n, rng)
        a = _sections.polynomial_from_roots(poles)
        np.testing.assert_allclose(tune.roots(a), _sections.roots_of_monic(a), rtol=AGREE)
        np.testing.assert_allclose(tune.roots(a), poles, rtol=AGREE)


@pytest.mark.parametrize(
    "poles",
    [
        *([-20.0] * n for n in range(1, 9)),
        *([-0.1237] * n for n in (2, 5)),
        *([-30 + 40j, -30 - 40j] * m for m in (1, 2, 3)),
        [-3.0, -3.0, -6 + 8j, -6 - 8j, -70.0, -70.0],
        [-1e-4, -1.0, -1e4, -1e4],
    ],
    ids=str,
)
def test_repeated_poles_are_recognised(tune, poles):
    poles = _sections.pair_conjugates(np.array(poles, dtype=complex))
    found = tune.roots(_sections.polynomial_from_roots(poles))
    np.testing.assert_allclose(found, poles, rtol=20 * np.finfo(float).eps)
    assert len(np.unique(found)) == len(np.unique(poles))


@pytest.mark.parametrize("method", METHODS)
def test_transitions_are_pythons(tune, method):
    rng = np.random.default_rng(5)
    for n in range(1, 7):
        for h in (1e-5, H, 0.0123, 0.7):
            filter = PhyFilter.from_poles(spread_poles(n, rng))
            ours, expected = (
                tune.transition(filter.poles, method, h),
                transition(filter.sections[0], method, h),
            )
            np.testing.assert_allclose(ours, expected, atol=AGREE * np.abs(expected).max(), rtol=0)


def test_slow_poles_keep_their_digits(tune):
    """Every entry, also those of 1e-9, to last places: mpmath with 50 digits knows."""
    poles = np.array([-1e-6, -3 + 4j, -3 - 4j, -2000.0], dtype=complex)
    A, _ = _sections.chain(poles)
    with mpmath.workdps(50):
        exact = mpmath.expm(mpmath.matrix(A.tolist()) * mpmath.mpf(H)) - mpmath.eye(4)
        expected = np.array(exact.tolist(), dtype=float)
    np.testing.assert_allclose(tune.transition(poles, "exact", H), expected, rtol=2e-14, atol=1e-30)


def test_chain_is_the_filter(tune):
    """C (sI - A)^-1 B = N/D, which needs none of the code that made A and C."""
    rng = np.random.default_rng(6)
    for n in range(1, 7):
        poles = spread_poles(n, rng)
        a = _sections.polynomial_from_roots(poles)
        b = a * rng.uniform(-1.0, 1.0, n)
        A, equilibrium, C = tune.chain(poles, a, b)
        for s in 1j * np.abs(poles[0]) * np.array([0.1, 1.0, 30.0]):
            response = C @ np.linalg.solve(s * np.eye(n) - A, -A @ equilibrium)
            expected = np.polyval(b[::-1], s) / np.polyval([1.0, *a[::-1]], s)
            assert abs(response - expected) < 1e-11 * np.abs(C).max()
        assert C @ equilibrium == pytest.approx(b[0] / a[0], rel=4e-16, abs=4e-16 * np.abs(C).sum())


def test_chain_keeps_its_digits_over_five_decades(tune):
    """The weights stay of the size of F because the fastest section comes first, as in Python."""
    rng = np.random.default_rng(8)
    for n in range(2, 9):
        poles = PhyFilter.from_poles(-np.geomspace(1e-2, 1e3, n)).poles
        if n > 3:
            poles = _sections.sort_poles(np.append(poles[:-2], [-40 + 30j, -40 - 30j]))
        a = _sections.polynomial_from_roots(poles)
        b = a * rng.uniform(0.2, 1.5, n) * rng.choice([-1.0, 1.0], n)
        expected = PhyFilter(a, b, poles=poles).sections
        for ours, python in zip(tune.chain(poles, a, b), expected, strict=True):
            np.testing.assert_allclose(ours, python, rtol=AGREE, atol=AGREE * np.abs(python).max())
        for s in 1j * np.geomspace(1e-3, 1e4, 8):
            response = tune.chain(poles, a, b)[2] @ np.linalg.solve(
                s * np.eye(n) - expected[0], -expected[0] @ expected[1]
            )
            wanted = np.polyval(b[::-1], s) / np.prod(s - poles)
            assert abs(response - wanted) < AGREE * np.max(np.abs(b / a))


def test_lowpass_is_the_last_section(tune):
    _, _, C = tune.chain(np.array([-3.0, -4.0], dtype=complex), [12.0, 7.0], [12.0, 0.0])
    assert C.tolist() == [0.0, 1.0]


def test_a_state_moves_as_in_python(tune):
    """From likely states of one filter to those of another of its order; other numerators, repeated poles, F = 0."""
    rng = np.random.default_rng(9)
    for n in range(1, 7):
        for k in range(12):
            filters = [
                PhyFilter.from_poles([-20.0] * n if (k + i) % 3 == 0 else spread_poles(n, rng))
                for i in range(2)
            ]
            old, new = (
                PhyFilter(entry.a, entry.a * rng.uniform(-0.5, 1.5, n) * (k < 11), poles=entry.poles)
                for entry in filters
            )
            chains = [entry.chain for entry in (old, new)]
            sampled, state = old.sampled(0.01), old.sampled(0.01).start([0.0])
            for u in np.cumsum(rng.standard_normal(50)):
                state, _ = sampled.step(state, [0.0], [-u])
            w = state.w[0]
            expected = moved(*chains, w[None])[0]
            condition = np.sqrt(np.linalg.cond(_sections.covariance(old.poles, old.poles, 0.01)))
            size = AGREE * condition * max(np.abs(w).max(), np.abs(expected).max())
            np.testing.assert_allclose(tune.move_state(*chains, w), expected, rtol=0.0, atol=size)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    st.lists(st.floats(-30.0, 10.0), min_size=1, max_size=3),
    st.lists(st.floats(-9.0, 9.0), min_size=0, max_size=2),
)
def test_stability_is_numpys(tune, reals, damped):
    """Real roots and pairs on either side of the axis; near the axis only rounding decides."""
    roots = [*reals, *(complex(r, s) for r in damped for s in (5.0, -5.0))]
    margin = max(np.real(roots))
    if abs(margin) < 1e-3:
        return
    a = np.real(np.poly(roots))[:0:-1]
    assert tune.hurwitz(a) == (margin < 0.0)
    found = tune.roots(a)
    assert (found is not None and bool(np.all(found.real < 0.0))) == (margin < 0.0)


# -- in the filter ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    sources = {}
    for n in (1, 2, 3, 4, 6):
        for precision in ("float64", "float32"):
            sampled = PhyFilter.from_poles([-20.0] * n).sampled(H, precision=precision)
            sources[n, precision] = filter_source(sampled, 2, name=f"order{n}_{precision}")
    return sources, compile_filters(list(sources.values()), tmp_path_factory.mktemp("tunable"))


def signals(count, seed=0):
    rng = np.random.default_rng(seed)
    return 2.0 * H * np.cumsum(rng.standard_normal((count, 2)), axis=0), *rng.standard_normal((2, count, 2))


def butterworth(n, cutoff):
    return PhyFilter.from_poles(cutoff * np.exp(1j * np.pi * (2 * np.arange(n) + n + 1) / (2 * n)))


@pytest.mark.parametrize("n", [1, 2, 3, 4, 6])
def test_retuned_is_the_new_filter(n, library):
    """From rest, whatever the order of the sections: f_hat is Python's of the new coefficients."""
    sources, compiled = library
    x, g, f_theta = signals(80)
    for new in (
        butterworth(n, 35.0),
        PhyFilter(butterworth(n, 9.0).a, 0.9 * butterworth(n, 9.0).a),
        PhyFilter.from_poles([-7.0] * n),
    ):
        sampled = new.sampled(H)
        ours = CFilter(compiled, sources[n, "float64"])
        assert ours.retune([new.a], [new.b]) == 0
        expected = sampled.run(x, g, f_theta)
        ours.start(x[0], None, f_theta[0])
        for k in range(1, 80):
            np.testing.assert_allclose(
                ours.step(x[k], g[k - 1], f_theta[k])[1], expected[k], atol=AGREE * 10, rtol=AGREE
            )


@pytest.mark.parametrize("by", ["coefficients", "poles"])
def test_there_and_back_is_the_same_filter(by, library):
    sources, compiled = library
    source = sources[6, "float64"]
    home, away = source.sampled.filter, butterworth(6, 35.0)
    returned, stayed = CFilter(compiled, source), CFilter(compiled, source)
    if by == "coefficients":
        assert returned.retune([away.a], [away.b]) == returned.retune([home.a], [home.b]) == 0
    else:
        for filter in (away, home):
            assert returned.call("retune_poles", pairs(filter.poles), filter.b) == 0
    x, g, f_theta = signals(40)
    for filter in (returned, stayed):
        filter.start(x[0])
    for k in range(1, 40):
        one, other = (filter.step(x[k], g[k - 1], f_theta[k])[1] for filter in (returned, stayed))
        # The poles are the exported ones, six of them equal; only dA is summed in another order.
        np.testing.assert_allclose(one, other, atol=AGREE)


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("n", [1, 2, 3, 4, 6])
def test_rest_stays_rest(n, precision, library):
    """A constant residual's estimate over hundreds of samples, to and from equal, undamped and many other poles."""
    sources, compiled = library
    ours = CFilter(compiled, sources[n, precision])
    level = np.array([5.0, -0.25])
    assert ours.start(np.zeros(2), level) == 0
    general = butterworth(n, 9.0)
    shares = np.array([1.0, *np.linspace(1.4, -0.6, n - 1)])
    damped = [-1 + 19.97j, -1 - 19.97j, -3.0, -3.0, -90.0, -90.0][:n] if n > 1 else [-20.0]
    for a, b in (
        (butterworth(n, 35.0).a, None),
        (general.a, shares * general.a),
        (PhyFilter.from_poles(damped).a, None),
        (PhyFilter.from_poles([-20.0] * n).a, None),
    ):
        assert ours.retune([a], [a * np.eye(n)[0] if b is None else b]) == 0
        f_hat = np.array([ours.step(np.zeros(2), -level, np.zeros(2))[1] for _ in range(200)], dtype=float)
        # At most a hundred times the rounding of a state, see tests/test_retuning.py; the weights of b sum up to 10.
        np.testing.assert_allclose(f_hat / level, 1.0, rtol=0.0, atol=1000 * np.finfo(precision).eps)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    n=st.sampled_from([1, 2, 3, 4, 6]),
    precision=st.sampled_from(["float64", "float32"]),
    cutoff=st.floats(0.5, 200.0),
    gain=st.floats(-1.5, 1.5),
    steps=st.integers(0, 40),
)
def test_f_hat_does_not_jump(library, n, precision, cutoff, gain, steps):
    """A step of no length shows the output as it is: u = 0 has no time to act."""
    sources, compiled = library
    ours = CFilter(compiled, sources[n, precision])
    x, g, f_theta = signals(60, seed=n)
    ours.start(x[0], None, f_theta[0])
    for k in range(1, steps + 1):
        ours.step(x[k], g[k - 1], f_theta[k])
    new = butterworth(n, cutoff)
    b = new.a * np.linspace(1.0, gain, n)
    instant = 1e-12
    _, before = ours.step(x[steps], np.zeros(2), f_theta[steps], dt=instant)
    assert ours.retune([new.a], [b]) == 0
    _, after = ours.step(x[steps], np.zeros(2), f_theta[steps], dt=instant)
    scale = max(1.0, float(np.abs(before).max()))
    # The steps themselves move it by cutoff * instant * |u|; in float the states are rounded after the exchange.
    allowed = (1e-8 if precision == "float64" else 1e-5) * scale
    np.testing.assert_allclose(after, before, atol=allowed)
