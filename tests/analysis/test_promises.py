"""Promises against simulation where options meet: at every time, with E, M_hat, delay, noise, a wrong inertia, a clock.

The filter is simulated from its coefficients, by SciPy: no code is shared with the bounds, nor with the recursion.
"""

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter, lsim, ss2tf

import phyfilter_ctl as pf
from tests.cpu_budget import slow_but

# Rounding of a simulation of a few hundred steps.
ROUNDING = 1e-9
# Parts of a step that a course is simulated with.
FINE = 20


def companion(F):
    """A, B, C, D of F, from its polynomials."""
    A = np.vstack([-F.a[::-1], np.eye(F.order)[:-1]])
    return A, np.eye(F.order)[:, :1], F.b[None, ::-1], np.zeros((1, 1))


def filtered(F, h, u):
    """F, exact for u (N, n_f) constant over each step, at the ends of the steps."""
    b, a = ss2tf(*cont2discrete(companion(F), h)[:4])
    return lfilter(np.append(b[0, 1:], 0.0), a, u, axis=0)


def flown(F, h, E_left, M_hat, M, forces, gamma, g, noise, late, moved):
    """Errors gamma - f_hat at all times (N FINE + 1, n_f), those at the samples (N + 1, n_f), and the largest |x'|.

    ``forces`` is M x'; ``late`` the delay and ``moved`` (N + 1,) what sampling instants are off, in parts of a step.
    """
    speed = np.linalg.solve(M, forces.T).T
    x = np.vstack([np.zeros(speed.shape[1]), np.cumsum(0.5 * (speed[1:] + speed[:-1]), axis=0)]) * h / FINE
    N = len(noise) - 1
    instants = np.clip(np.arange(N + 1) * FINE + moved, 0, N * FINE)
    y = x[np.maximum(instants - late, 0)] + noise
    # What acts over the delayed step that a sample shows: g at its beginning, held.
    known = np.zeros((N, len(M)))
    share = late % FINE / FINE
    for steps, weight in ((late // FINE, 1.0 - share), (late // FINE + 1, share)):
        before = np.arange(N) - steps
        known[before >= 0] += weight * g[instants[:-1]][before[before >= 0]]
    u = (np.diff(y, axis=0) @ M_hat.T / h - known) @ E_left.T
    f_hat = np.vstack([np.zeros(u.shape[1]), filtered(F, h, u)])
    held = f_hat[np.searchsorted(instants, np.arange(N * FINE + 1), side="right") - 1]
    return gamma - held, gamma[::FINE] - f_hat, np.linalg.norm(speed, axis=1).max()


def course(rng, N, h, bounds, end):
    """|gamma| and |gamma'| within bounds: at rest on one side, then up as fast as it may until ``end``; or random."""
    t, size = np.arange(N * FINE + 1) * h / FINE, bounds.get(0, np.inf)
    if rng.random() < 0.5:
        low = size if np.isfinite(size) else 0.3 * bounds[1] * t[end]
        return np.maximum(-bounds[1] * t, np.clip(bounds[1] * (t - t[end]) + low, -low, low))
    slopes = np.repeat(rng.choice([-1.0, 1.0], N * FINE), rng.integers(1, 30 * FINE))[: N * FINE] * bounds[1]
    walk = [0.0]
    for slope in slopes * h / FINE:
        walk.append(float(np.clip(walk[-1] + slope, -size, size)))
    return np.array(walk)


# Inertia, and E; the second axis of the first E is one on which no f acts.
PLANTS = {
    "small E": (2.0 * np.eye(2), np.array([[0.1], [0.0]])),
    "long E, diagonal M": (np.diag([0.5, 4.0]), np.array([[3.0], [4.0]])),
    "square E, full M": (np.array([[3.0, 0.7], [0.7, 1.5]]), np.array([[0.02, 0.01], [0.0, 0.5]])),
    "full M": (np.array([[3.0, 0.7], [0.7, 1.5]]), None),
}


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("seed", slow_but(range(4), range(40)))
def test_no_error_is_above_its_bound_at_any_time(plant, seed):
    """Noise by the worst signs, a wrong inertia, g that moves, a late x and a clock that jitters, all at once."""
    rng = np.random.default_rng(seed)
    M_hat, E = PLANTS[plant]
    F = [pf.PhyFilter([rng.uniform(2.0, 20.0)]), pf.lowpass(2, rng.uniform(3.0, 20.0)), pf.lowpass(3, 8.0)][
        seed % 3
    ]
    h, N = rng.uniform(0.1, 0.6) / np.abs(F.poles).max(), 200
    late = int(rng.choice([0, FINE // 2, FINE, 3 * FINE]))
    bounds = {1: rng.uniform(0.5, 4.0) / (N * h / 20.0)}
    bounds |= {0: 1.0} if seed % 2 else {}
    nu, drift = (rng.choice([0.0, 0.3]) * h for _ in range(2))
    wrong = rng.choice([0.0, 0.2]) * np.eye(2)
    parts = int(rng.choice([0, 2]))  # of a step, by which an instant may be off
    sampled = F.sampled(h, "exact", delay=late * h / FINE, E=E)
    E = np.eye(2) if E is None else E
    E_left = np.linalg.solve(E.T @ E, E.T)
    left, _, right = np.linalg.svd(E_left @ M_hat)
    end = N * FINE - int(rng.integers(0, FINE))
    gamma = np.outer(course(rng, N, h, bounds, end), left[:, 0])
    push = E_left.T @ left[:, 0]
    slope = drift / h
    t = np.arange(N * FINE + 1) * h / FINE
    g = np.outer(-slope * t, push / np.linalg.norm(push)) + 0.0
    pulse = np.zeros((N + 1, 2))
    pulse[1] = right[0]
    answer = filtered(F, h, np.diff(pulse, axis=0) @ M_hat.T / h @ E_left.T) @ left[:, 0]
    signs = np.append(0.0, -np.sign(answer[::-1]))
    noise = nu * np.outer(signs, right[0])
    moved = rng.integers(-parts, parts + 1, N + 1)
    moved[0] = 0  # where the simulation begins
    all_times, samples, rate = flown(
        F, h, E_left, M_hat, M_hat + wrong, gamma @ E.T + g, gamma, g, noise, late, moved
    )
    implementation = pf.Implementation(g={1: slope} if slope else {}, jitter=parts * h / FINE)
    found = pf.error_bound(
        sampled,
        pf.Bounded(
            bounds,
            noise=nu,
            inertia_error=float(np.linalg.norm(wrong, 2)),
            rate=float(rate),
            implementation=implementation,
        ),
        inertia=M_hat,
    )
    assert np.linalg.norm(samples, axis=1).max() <= found.bound * (1.0 + ROUNDING)
    assert np.linalg.norm(all_times, axis=1).max() <= found.between_samples * (1.0 + ROUNDING)


# What gamma at -delta_0 for long, then up as fast as it may, reaches just before the sample that shows it.
REACHED = [
    (5.0, 0.02, {0: 1.0, 1: 20.0}, 1.71983),
    (2.0, 0.1, {0: 1.0, 1: 4.0}, 1.50502),
    (5.0, 0.02, {0: 1.0, 1: 4.0}, 0.80803),
]


@pytest.mark.parametrize(("pole", "h", "bounds", "reached"), REACHED)
def test_a_residual_that_moves_inside_a_step_attains_the_bound_between_samples(pole, h, bounds, reached):
    F, N = pf.PhyFilter([pole]), int(np.ceil(30.0 / (pole * h)))
    t = np.arange(N * FINE + 1) * h / FINE
    gamma = np.clip(bounds[1] * (t - t[-1]) + bounds[0], -bounds[0], bounds[0])[:, None]
    one, still = np.eye(1), np.zeros((len(t), 1))
    noise, moved = np.zeros((N + 1, 1)), np.zeros(N + 1, dtype=int)
    errors, _, _ = flown(F, h, one, one, one, gamma, gamma, still, noise, 0, moved)
    found = pf.error_bound(F.sampled(h), bounds).between_samples
    assert errors[-2, 0] <= found * (1.0 + ROUNDING)
    # One part of a step before its end, during which gamma goes on by its slope; and the gap of the programme.
    assert errors[-2, 0] + bounds[1] * h / FINE == pytest.approx(found, rel=2e-4)
    assert found == pytest.approx(reached, rel=1e-4)


def test_gamma_and_its_second_derivative_bound_the_error_between_samples():
    F = pf.place_poles([-20.0, -20.0], type=2)
    found = pf.error_bound(F.sampled(0.01, "matched"), {0: 1.0, 2: 3.0})
    assert found.bound < found.between_samples == pytest.approx(0.0423, abs=5e-5)
    # A past within both bounds ends in gamma' of 2 sqrt(delta_0 delta_2) at most (Landau); the gap of the programme.
    assert found.between_samples <= found.bound + 0.01 * 2.0 * np.sqrt(1.0 * 3.0) + 1e-4
    assert pf.error_bound(F.sampled(0.01, "matched"), {2: 3.0}).between_samples == np.inf


@pytest.mark.parametrize("slope", [3.0, 12.0, 40.0])
@pytest.mark.parametrize(
    "F", [pf.PhyFilter([20.0]), pf.lowpass(3, 9.0, family="butterworth")], ids=["1", "3"]
)
def test_the_envelope_of_two_bounds_holds_and_tends_to_the_bound(F, slope):
    found = pf.error_bound(F, pf.Bounded({0: 1.0, 1: slope}, noise=0.001))
    t = np.linspace(0.0, 2.0, 801)
    start = found.derivative  # 1: the error at the start is 0, so gamma is
    rng = np.random.default_rng(7)
    envelope = found.envelope(t) - found.noise
    for dwell in (1, 5, 20, 40, 80, 200, 400, 800):
        signs = np.repeat(rng.choice([-1.0, 1.0], 801), dwell)[:801]
        gamma = [0.0 if start else float(signs[0])]
        for sign in signs[1:]:
            gamma.append(float(np.clip(gamma[-1] + sign * slope * t[1], -1.0, 1.0)))
        _, f_hat, _ = lsim(companion(F), gamma, t)
        assert np.all(np.abs(gamma - f_hat) <= envelope * (1.0 + 1e-6) + 1e-9)
    # What is left of the kernel after 50 time constants, and its enclosure of 2e-7.
    assert found.envelope([10.0])[0] == pytest.approx(found.bound, rel=1e-6)


@pytest.mark.parametrize("plant", PLANTS)
def test_noise_has_the_variance_of_its_widest_direction(plant):
    M_hat, E = PLANTS[plant]
    F, h, N = pf.lowpass(2, 20.0), 0.01, 100_000
    E_left = np.eye(2) if E is None else np.linalg.solve(E.T @ E, E.T)
    noise = 0.01 * np.random.default_rng(1).standard_normal((N, 2))
    f_hat = filtered(F, h, np.diff(noise, axis=0) @ M_hat.T / h @ E_left.T)
    widest = float(np.linalg.eigvalsh(np.atleast_2d(np.cov(f_hat.T)))[-1])
    sampled = F.sampled(h, "exact", E=E)
    found = pf.error_variance(sampled, pf.Gaussian(noise=0.01), inertia=M_hat).noise
    # 100,000 samples that forget within about 10: a standard deviation of 1.5 % (sqrt(2 * 10 / N)); three of them.
    assert widest == pytest.approx(found, rel=0.045)
    own = F.sampled(h, "exact", E=E, inertia=M_hat)
    assert pf.error_variance(own, pf.Gaussian(noise=0.01)).noise == found
    assert 0.01 * pf.frequency_response(own).noise_gain == pytest.approx(np.sqrt(found))
    bound = pf.error_bound(own, pf.Bounded({1: 1.0}, noise=0.01))
    assert bound.noise == pf.error_bound(sampled, pf.Bounded({1: 1.0}, noise=0.01), inertia=M_hat).noise


def test_each_channel_hears_its_own_row():
    """Of E^+ M_hat, or of M_hat: noise on all axes through two filters of their own."""
    slow, fast = pf.PhyFilter([5.0]), pf.PhyFilter([20.0])
    M_hat, E = PLANTS["square E, full M"]
    for given in (E, None):
        E_left = np.eye(2) if given is None else np.linalg.inv(given)
        bank = pf.stack([slow, fast]).sampled(0.01, E=given)
        for found, F, row in zip(
            pf.error_variance(bank, pf.Gaussian(noise=0.1), inertia=M_hat),
            (slow, fast),
            E_left @ M_hat,
            strict=True,
        ):
            alone = pf.error_variance(
                F.sampled(0.01), pf.Gaussian(noise=0.1), inertia=float(np.linalg.norm(row))
            )
            assert found.noise == pytest.approx(alone.noise, rel=1e-9)


def test_rounding_in_float32_is_bounded_with_E():
    M_hat, E = PLANTS["square E, full M"]
    F, N, size = pf.PhyFilter([20.0]), 4000, 100.0
    rng = np.random.default_rng(3)
    x = np.clip(np.cumsum(rng.choice([-0.02, 0.02], (N, 2)), axis=0), -size, size) + 50.0
    g = rng.uniform(-5.0, 5.0, (N, 2))
    coarse, fine = (F.sampled(0.01, E=E, precision=kind) for kind in ("float32", "float64"))
    error = np.abs(coarse.run(x, g, inertia=M_hat) - fine.run(x, g, inertia=M_hat)).max()
    given = pf.Implementation(x={0: 150.0}, g={0: 10.0, 1: 2000.0})
    rate = 0.02 * np.sqrt(2.0) / 0.01
    bounds = pf.Bounded({0: 1.0}, rate=rate, implementation=given)
    found = pf.error_bound(coarse, bounds, inertia=M_hat).implementation["rounding"]
    assert 1e-3 * found < error <= found


def test_inertia_error_without_rate_is_refused():
    for residual in ({1: 1.0}, {}):
        with pytest.raises(ValueError, match=r"inertia_error.*rate"):
            pf.Bounded(residual, inertia_error=0.5)


SAMPLED = pf.PhyFilter([20.0]).sampled(0.01)


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda: pf.error_bound(SAMPLED, 3.0), "bounds of the residual by order"),
        (lambda: pf.error_bound(SAMPLED, [3.0]), "bounds of the residual by order"),
        (lambda: pf.error_bound(SAMPLED, {1: [3.0]}), r"residual\[1\]: expected a number"),
        (lambda: pf.error_bound(SAMPLED, pf.Bounded({1: 3.0}, noise=[0.1])), "noise: expected a number"),
        (lambda: pf.error_bound(SAMPLED, pf.Bounded({1: 3.0}, rate="2")), "rate: expected a number"),
        (lambda: pf.error_variance(SAMPLED, pf.Gaussian(noise=[0.1, 0.1])), "noise: expected a number"),
        (lambda: pf.fixed_point(pf.PhyFilter([20.0]), x=1.0), "expected a SampledPhyFilter"),
    ],
)
def test_bad_input_is_named(ask, message):
    with pytest.raises(TypeError, match=message):
        ask()


def test_an_inertia_of_the_wrong_size_is_named():
    small = pf.PhyFilter([20.0]).sampled(0.01, E=[[0.1], [0.0]])
    with pytest.raises(ValueError, match="inertia"):
        pf.error_bound(small, pf.Bounded({1: 1.0}, noise=0.1), inertia=[1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match="inertia"):
        pf.error_variance(SAMPLED, pf.Gaussian(noise=0.1), inertia=-1.0)
    unknown = pf.PhyFilter([20.0]).sampled(0.01, inertia="scalar")
    with pytest.raises(ValueError, match="inertia: expected M_hat, which the filter takes with every sample"):
        pf.error_variance(unknown, pf.Gaussian(noise=0.1))
    assert pf.error_bound(unknown, {1: 1.0}).bound == pf.error_bound(SAMPLED, {1: 1.0}).bound


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.int64])
def test_numbers_of_numpy_are_numbers(kind):
    assert pf.error_variance(SAMPLED, pf.Gaussian(noise=kind(2)), inertia=kind(3)) == pf.error_variance(
        SAMPLED, pf.Gaussian(noise=2.0), inertia=3.0
    )
    assert (
        pf.error_bound(SAMPLED, pf.Bounded({1: kind(2)}, noise=kind(1)), inertia=kind(3)).bound
        == pf.error_bound(SAMPLED, pf.Bounded({1: 2.0}, noise=1.0), inertia=3.0).bound
    )
