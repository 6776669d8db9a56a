"""Parts of the residual, against dense Gaussian conditioning, generalised least squares and steady Kalman filters."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are
from scipy.signal import lfilter

import phyfilter_ctl as pf
from phyfilter_ctl.baselines import KalmanDifferentiator
from phyfilter_ctl.estimation import (
    AddedInertia,
    ColouredForce,
    ModelScale,
    Payload,
    Regressor,
    SensorBias,
    SteadyForce,
    separate,
)

# Joint covariances of 40 samples, whose condition is below 1e8, solved at once: to 1e-7 of the estimates.
DENSE = 1e-7
# A recursion in double precision against a closed form.
STEADY = 1e-9

S = 0.02


def van_loan(rate, density, h):
    """Transition and noise covariance of (integral of c, c), by one matrix exponential."""
    A, Q = np.array([[0.0, 1.0], [0.0, -rate]]), np.diag([0.0, density])
    both = expm(np.block([[-A, Q], [np.zeros((2, 2)), A.T]]) * h)
    F = both[2:, 2:].T
    return F, F @ both[:2, 2:]


def lifted(times, M, loads, rates, densities, sds, measured, noise):
    """Sources of chance stacked: what x less its first sample and c (of each sample) take from each, their covariance.

    loads (m, n_x, p), noise (n_x, n_x) a covariance. Sources: c(0), what each step adds to (area, c) of each scalar,
    the noise of each sample.
    """
    m, n_x, p = loads.shape
    sources = p + 2 * p * m + n_x * (m + 1)
    of_x, of_c = np.zeros((m + 1, n_x, sources)), np.zeros((m + 1, p, sources))
    chance = np.diag(np.concatenate([sds, np.zeros(sources - p)]) ** 2)
    x, c = np.zeros((n_x, sources)), np.eye(p, sources)
    of_x[0], of_c[0] = x, c
    into_x = np.broadcast_to(np.linalg.inv(M), (m, n_x, n_x))
    for k, h in enumerate(np.diff(times)):
        area, following = np.zeros((p, sources)), np.zeros((p, sources))
        for i in range(p):
            F, Q = van_loan(rates[i], densities[i], h)
            at = p + 2 * (p * k + i)
            chance[at : at + 2, at : at + 2] = Q
            area[i] = F[0, 1] * c[i]
            area[i, at] += 1.0
            following[i] = F[1, 1] * c[i]
            following[i, at + 1] += 1.0
        x, c = x + into_x[k] @ loads[k] @ area, following
        of_x[k + 1], of_c[k + 1] = x, c
    seen, first = of_x + measured @ of_c, p + 2 * p * m
    for k in range(m + 1):
        own = slice(first + n_x * k, first + n_x * (k + 1))
        chance[own, own] = noise
        seen[k, :, own] += np.eye(n_x)
    return (seen - seen[0])[1:].reshape(-1, sources), of_c, chance


def mixed(moving):
    """Two channels, a full inertia that may move, irregular steps, every kind of linear part."""
    rng = np.random.default_rng(3)
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.01, 0.2, 39))])
    M = np.array([[2.0, 0.3], [0.3, 1.0]])
    M = M * (1.0 + 0.5 * np.sin(times))[:, None, None] if moving else M
    phi = rng.standard_normal((40, 2, 2))
    f_theta = np.stack([np.sin(3.0 * times), np.cos(times)], axis=1)
    parts = [
        Regressor(phi, sd=[1.0, 2.0], drift=0.2, name="drag"),
        ModelScale(0.5),
        SteadyForce(1.5, drift=0.3),
        ColouredForce([0.7, 1.1], bandwidth=30.0),
        SensorBias(0.03, bandwidth=0.5),
    ]
    x = 0.3 * np.cumsum(rng.standard_normal((40, 2)), axis=0)
    g = rng.standard_normal((40, 2))
    log = pf.Recording(times, x, g=g, f_theta=f_theta, inertia=M)
    eye, none, rise = np.eye(2), np.zeros((39, 2, 2)), (phi[1:] + phi[:-1]) / 2
    model = ((f_theta[1:] + f_theta[:-1]) / 2)[:, :, None]
    loads = np.concatenate([rise, model, none + eye, none + eye, none], axis=2)
    rates = [0.0] * 5 + [30.0] * 2 + [0.5] * 2
    densities = [0.04, 0.04, 0.0, 0.09, 0.09, 60.0 * 0.49, 60.0 * 1.21, 0.03**2, 0.03**2]
    sds = np.array([1.0, 2.0, 0.5, 1.5, 1.5, 0.7, 1.1, 0.03, 0.03])
    measured = np.hstack([np.zeros((2, 7)), eye])
    return log, parts, (times, M, loads, rates, densities, sds, measured), model


@pytest.mark.filterwarnings("ignore:the innovations' mean square")  # any numbers do
@pytest.mark.parametrize(("causal", "moving"), [(False, True), (True, False)])
def test_estimates_are_gaussian_conditioning(causal, moving):
    log, parts, (times, M, loads, rates, densities, sds, measured), model = mixed(moving)
    # Noise of M x of deviation S, as the inertia is full: that of x is correlated.
    found = separate(log, parts, noise=S, causal=causal, fraction=0.999999)
    into_x = np.linalg.inv(M.reshape(-1, 2, 2).mean(axis=0))
    noise = into_x @ into_x.T * S**2
    M = 0.5 * (M[1:] + M[:-1]) if moving else M
    seen, of_c, chance = lifted(times, M, loads, rates, densities, sds, measured, noise)
    drive = (np.linalg.inv(M) @ (np.diff(times)[:, None] * (log.g[:-1] + model[:, :, 0]))[..., None])[..., 0]
    y = (log.x[1:] - log.x[0] - np.cumsum(drive, axis=0)).ravel()
    joint = seen @ chance @ seen.T
    course = np.hstack([part.course for part in found.parts.values()])
    sd = np.hstack([part.sd_course for part in found.parts.values()])
    compared = 0
    for k in (3, 20, 39):
        end = 2 * k if causal else 78
        cross = of_c[k] @ chance @ seen[:end].T
        mean = cross @ np.linalg.solve(joint[:end, :end], y[:end])
        left = of_c[k] @ chance @ of_c[k].T - cross @ np.linalg.solve(joint[:end, :end], cross.T)
        there = np.isfinite(course[k])
        compared += there.sum()
        np.testing.assert_allclose(course[k][there], mean[there], rtol=0.0, atol=DENSE * np.abs(mean).max())
        np.testing.assert_allclose(sd[k][there], np.sqrt(np.diag(left))[there], rtol=DENSE * 10)
    assert compared > 10
    whole = np.linalg.slogdet(joint)[1] + y @ np.linalg.solve(joint, y) + 78.0 * np.log(2.0 * np.pi)
    assert found.log_likelihood == pytest.approx(-0.5 * whole, rel=DENSE)


def wandering(n=600, h=0.01):
    rng = np.random.default_rng(0)
    f = np.cumsum(rng.standard_normal(n)) * 0.3 * np.sqrt(h)
    return np.cumsum(f) * h + S * rng.standard_normal(n)


def test_one_wandering_force_is_the_steady_kalman_filter_and_a_phyfilter():
    """Theorem: sum of the parts = PhyFilter of the same noise; its order is that of the force plus one."""
    h, walk, M = 0.01, 0.3, 2.0
    x = wandering() / M
    log = pf.Recording.from_arrays(x=x, dt=h, inertia=M)
    found = separate(log, [SteadyForce(1e3, drift=walk)], noise=S, causal=True, fraction=0.999999)
    kalman = KalmanDifferentiator(q=walk**2, r=S**2)
    K1, K2 = kalman.gain(h)
    gain = found.parts["steady"]
    assert gain.identified.all()
    # The transient of the wide prior is forgotten: |pole|^n is below 1e-12 after 400 samples.
    late = slice(400, None)
    steady = np.asarray(lfilter([K2], [1.0, K1 + K2 * h - 2.0, 1.0 - K1], np.diff(M * x, prepend=M * x[0])))
    zeta = found.f_hat[:, 0]
    np.testing.assert_allclose(zeta[late], steady[late], rtol=0.0, atol=STEADY * np.abs(steady).max())
    # As a PhyFilter: D from the poles of the gain, N the one with the same first tap of the impulse response.
    poles = np.log(np.roots([1.0, K1 + K2 * h - 2.0, 1.0 - K1])) / h
    D = np.real(np.poly(poles))

    def first(b1):
        return (
            pf.PhyFilter(a=[D[2], D[1]], b=[D[2], b1])
            .sampled(h, method="exact")
            .run(np.eye(1, 3)[0, ::-1][:, None])[-1, 0]
        )

    b1 = -first(0.0) / (first(1.0) - first(0.0)) + K2 / (first(1.0) - first(0.0))
    F = pf.PhyFilter(a=[D[2], D[1]], b=[D[2], b1]).sampled(h, method="exact")
    np.testing.assert_allclose(
        zeta[late], F.run(x[:, None], inertia=M)[late, 0], rtol=0.0, atol=STEADY * np.abs(steady).max()
    )


@pytest.mark.slow
def test_sum_of_two_coloured_forces_is_the_steady_filter_of_their_spectrum():
    h, x = 0.01, wandering(2000)
    slow, fast = ColouredForce(1.0, 0.5, name="slow"), ColouredForce(0.5, 8.0, name="fast")
    found = separate(
        pf.Recording.from_arrays(x=x, dt=h), [slow, fast], noise=S, causal=True, fraction=0.999999
    )
    pairs = [van_loan(part.bandwidth, 2.0 * part.bandwidth * part.sd**2, h) for part in (slow, fast)]
    A, Q, H = np.eye(3), np.zeros((3, 3)), np.array([[1.0, 0.0, 0.0]])
    for i, (F, noise) in enumerate(pairs, start=1):
        A[0, i], A[i, i] = F[0, 1], F[1, 1]
        Q[0, 0] += noise[0, 0]
        Q[0, i] = Q[i, 0] = noise[0, 1]
        Q[i, i] = noise[1, 1]
    P = solve_discrete_are(A.T, H.T, Q, [[S**2]])
    K = P @ H.T / (H @ P @ H.T + S**2)
    z, sums = np.zeros(3), []
    for value in x - x[0]:
        z = A @ z
        z = z + K[:, 0] * (value - z[0])
        sums.append(z[1] + z[2])
    np.testing.assert_allclose(found.f_hat[1800:, 0], sums[1800:], rtol=0.0, atol=STEADY * np.abs(sums).max())


def hover_then_climb(rng, moving, n=300, h=0.01, mass=2.0, added=0.5):
    """A vehicle with a payload in gusts, its thrust as recorded; z up."""
    t = h * np.arange(n)
    wind = lfilter(
        [1.0],
        [1.0, -np.exp(-5.0 * h)],
        rng.standard_normal((n, 3)) * 0.5 * np.sqrt(1.0 - np.exp(-10.0 * h)),
        axis=0,
    )
    accelerate = np.stack([np.sin(2.0 * t), np.cos(2.0 * t), 0.5 * np.sin(t)], axis=1) * moving
    g = (mass + added) * accelerate + np.array([0.0, 0.0, added * 9.81])
    v = np.vstack(
        [np.zeros((1, 3)), np.cumsum((g + wind - [0.0, 0.0, added * 9.81])[:-1] * h / (mass + added), axis=0)]
    )
    return pf.Recording.from_arrays(
        x=v + S / mass * rng.standard_normal(v.shape), g=g, dt=h, inertia=mass
    ), wind


PARTS = [Payload(1.0), SteadyForce(10.0, name="mean"), ColouredForce(0.5, bandwidth=5.0, name="gust")]


def test_what_cannot_be_told_apart_is_reported_as_a_sum_only():
    log, _ = hover_then_climb(np.random.default_rng(0), 0.0, n=150)
    found = separate(log, PARTS, noise=S)
    payload, mean = found.parts["payload"], found.parts["mean"]
    assert np.isnan(payload.value).all()
    assert np.isnan(payload.force[:, 2]).all()
    assert payload.only_with == ("mean[2]",)
    assert mean.identified.tolist() == [True, True, False]
    assert np.isnan(mean.force[:, 2]).all()
    assert np.isfinite(mean.force[:, :2]).all()
    (known,) = found.identifiability.combinations
    assert known.coefficients.keys() == {"payload", "mean[2]"}
    # mean_z - 9.81 payload
    ratio = known.coefficients["payload"] / known.coefficients["mean[2]"]
    assert ratio == pytest.approx(-9.81, rel=0.02)
    assert "only as a sum" in payload.message
    assert any("payload" in note for note in found.notes)
    both = found.together("payload", "mean")
    assert abs(both.force[-1, 2] + 0.5 * 9.81) < 4.0 * both.sd[-1, 2] < 2.0
    with pytest.raises(ValueError, match=r"payload is known only in a sum with mean\[2\]; name its part too"):
        found.together("payload", "gust")


def test_at_hover_the_filter_never_takes_the_payload_for_known():
    """A linearised filter would: its estimates move, and with them the direction in which nothing is known."""
    log, _ = hover_then_climb(np.random.default_rng(1), 0.0, n=150)
    found = separate(log, PARTS, noise=S, causal=True)
    assert np.isnan(found.parts["payload"].course).all()
    assert np.isnan(found.parts["mean"].course[:, 2]).all()
    assert np.isfinite(found.parts["mean"].course[20:, 0]).all()


def test_forces_follow_from_the_scalars_by_their_derivatives():
    """Of each part, at the end of each step: what its force changes by, against differences of it."""
    log, _ = hover_then_climb(np.random.default_rng(4), 3.0, n=60)
    ends = separate(log, PARTS, noise=S)._ends
    for inside in ([True, False, False], [False, True, True], [True, True, True]):
        _, D = ends.map(inside)
        for i, step in enumerate(1e-5 * np.eye(len(ends.structure.labels))):
            change = (
                replace(ends, c=ends.c + step).map(inside)[0] - replace(ends, c=ends.c - step).map(inside)[0]
            )
            # Second differences: 1e-10 of forces of 10 N.
            np.testing.assert_allclose(D[:, :, i], change / 2e-5, rtol=0.0, atol=1e-8)


@pytest.mark.slow
def test_motion_tells_weight_from_wind():
    log, wind = hover_then_climb(np.random.default_rng(1), 3.0, n=800)
    found = separate(log, PARTS, noise=S)
    payload = found.parts["payload"]
    assert payload.identified.all()
    assert payload.message == "identified"
    assert payload.interval[0, 0] < 0.5 < payload.interval[0, 1]
    assert payload.sd_value[0] < 0.05
    whole = found.together("payload", "mean", "gust")
    np.testing.assert_allclose(whole.force, found.f_hat, atol=1e-12)
    parts = sum(part.force for part in found.parts.values())
    np.testing.assert_allclose(parts, found.f_hat, atol=1e-12)
    error = found.together("mean", "gust").force - wind
    assert np.sqrt(np.mean(error**2)) < 0.5 * np.sqrt(np.mean((found.f_hat - wind) ** 2))


@pytest.mark.filterwarnings("ignore:the innovations' mean square")  # any numbers do
def test_information_is_that_of_generalised_least_squares():
    """Of two regressors under a coloured force: Phi' V^-1 Phi, V the covariance of x, and a hundredth of the priors"""
    rng, h, n = np.random.default_rng(5), 0.05, 60
    phi = np.cumsum(rng.standard_normal((n, 1, 2)), axis=0)
    x = np.cumsum(rng.standard_normal(n)) * 0.1
    sds = np.array([50.0, 3.0])
    found = separate(
        pf.Recording.from_arrays(x=x, dt=h),
        [Regressor(phi, sd=sds, name="r"), ColouredForce(0.4, 2.0)],
        noise=S,
    )
    times, load = h * np.arange(n), np.ones((n - 1, 1, 1))
    seen, _, chance = lifted(
        times, np.eye(1), load, [2.0], [0.64], np.array([0.4]), np.zeros((1, 1)), S**2 * np.eye(1)
    )
    V = seen @ chance @ seen.T
    rows = np.cumsum(0.5 * (phi[1:, 0] + phi[:-1, 0]) * h, axis=0)
    # Prior deviations ten times as large.
    information = rows.T @ np.linalg.solve(V, rows) + np.diag(0.1 / sds) ** 2
    alone = np.sqrt(np.diag(np.linalg.inv(information))) / sds
    np.testing.assert_allclose(list(found.identifiability.ratio.values())[:2], alone, rtol=DENSE)


def test_a_bias_of_x_that_stays_is_never_reported():
    found = separate(
        pf.Recording.from_arrays(x=wandering(200), dt=0.01),
        [SensorBias(1.0), SteadyForce(5.0, drift=1.0)],
        noise=S,
    )
    assert np.isnan(found.parts["bias"].value).all()
    assert "say too little" in found.parts["bias"].message
    assert found.parts["steady"].identified.all()


@pytest.mark.slow
@pytest.mark.parametrize("causal", [False, True])
def test_intervals_of_the_payload_hold(causal):
    """Of 40 flights with 5 to 60 %, little noise, so that a regressor made of measured motion would show: the share
    that a 95 % interval holds, 33 or more of 40 in 99.9 % of such studies; and no bias.
    """
    rng, z = np.random.default_rng(7), []
    for _ in range(40):
        added = 2.0 * rng.uniform(0.05, 0.6)
        log, _ = hover_then_climb(rng, 3.0, n=200, added=added)
        found = separate(log, PARTS[::2], noise=S, causal=causal).parts["payload"]
        z.append((found.value[0] - added) / found.sd_value[0])
    z = np.array(z)
    assert np.sum(np.abs(z) < 1.96) >= 33
    assert abs(z.mean()) < 3.5 / np.sqrt(40.0)


@pytest.mark.slow
def test_added_inertia_and_a_weak_motor():
    """Through its reaction to the motion, and the command as a regressor, in closed loop with sensor noise."""
    rng, h, n = np.random.default_rng(2), 0.01, 600
    t = h * np.arange(n)
    command = 4.0 * np.sin(1.5 * t) + 2.0 * np.sign(np.sin(0.7 * t))
    J, extra, lost = 1.5, 0.4, 0.15
    motion = np.concatenate([[0.0], np.cumsum(h * (1.0 - lost) * command / (J + extra))[:-1]])
    log = pf.Recording.from_arrays(x=motion + 0.005 * rng.standard_normal(n), g=command, dt=h, inertia=J)
    parts = [
        AddedInertia(1.0, sd=1.0),
        Regressor(-command, sd=0.5, between="hold", name="loss"),
        ColouredForce(0.05, 5.0),
    ]
    found = separate(log, parts, noise=J * 0.005)
    # Only (1 - loss) / (J + added) is seen: no motion tells the two apart.
    assert not found.parts["added_inertia"].identified.any()
    assert found.parts["loss"].only_with == ("added_inertia",)
    fixed = separate(log, [parts[1], parts[2], AddedInertia(1.0, sd=1e-6, mean=extra)], noise=J * 0.005)
    low, high = fixed.parts["loss"].interval[0]
    assert low < lost < high < low + 0.05


def test_what_is_refused():
    log = pf.Recording.from_arrays(x=np.zeros((30, 2)), dt=0.1)
    wind = ColouredForce(1.0, 2.0)
    for parts, options, words in [
        ([], {}, "at least one"),
        ([wind, wind], {}, "'wind' twice"),
        ([Payload(1.0)], {}, "gravity: expected shape"),
        ([ModelScale()], {}, "no f_theta"),
        ([Regressor(np.zeros((20, 2)), 1.0)], {}, "expected 30 samples"),
        (
            [AddedInertia(1.0, 1.0), Payload(1.0, [0.0, 9.81])],
            {},
            "added_inertia and payload; only their sum",
        ),
        ([AddedInertia([1.0, 0.0], 1.0)], {}, "constant inertia M that it is proportional to"),
        ([ColouredForce(0.0, 2.0)], {}, "sd: expected a finite number > 0"),
        ([ColouredForce(1.0, 0.0)], {}, "bandwidth: expected a finite number > 0"),
        ([wind], {"fraction": 1.5}, "between 0 and 1"),
        ([wind], {"fraction": {"gust": 0.1}}, "expected names of wind"),
        ([wind], {"noise": 0.0}, "deviation: expected finite numbers > 0"),
        ([wind], {"g": "linear"}, "'hold' or 'average'"),
    ]:
        with pytest.raises(ValueError, match=words):
            separate(log, parts, **{"noise": 0.1, **options})
    with pytest.raises(TypeError, match="got str at place 0"):
        separate(log, ["wind"], noise=0.1)
    with pytest.raises(TypeError, match="expected a Recording"):
        separate(np.zeros(30), [wind], noise=0.1)


def test_momentum_and_velocity_say_the_same():
    """x = m v with M = 1, and x = v with M = m: noise, payload, its drift and its report are those of M x."""
    log, _ = hover_then_climb(np.random.default_rng(6), 3.0, n=60)
    momentum = pf.Recording.from_arrays(x=2.0 * log.x, g=log.g, dt=log.dt)
    options = {"noise": S, "causal": True}
    first = separate(log, [Payload(1.0, drift=0.3), *PARTS[1:]], **options)
    second = separate(momentum, [Payload(1.0, drift=0.3, x_per_velocity=2.0), *PARTS[1:]], **options)
    for name, part in first.parts.items():
        np.testing.assert_allclose(part.course, second.parts[name].course, rtol=0.0, atol=STEADY)
        np.testing.assert_allclose(part.sd_course, second.parts[name].sd_course, rtol=STEADY)
    ratios = [list(each.identifiability.ratio.values()) for each in (first, second)]
    np.testing.assert_allclose(*ratios, rtol=STEADY)
