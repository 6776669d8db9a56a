"""The wind against the Dryden closed forms, in theory and on one long run, and the jet's profile."""

import control as ct
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import expm, solve_discrete_lyapunov
from scipy.signal import welch

import phyfilter_ctl as pf
from phyfilter_ctl.plants import wind_field

EXACT = 1e-12
# Central differences of step 1e-6 on wind of some m/s.
DIFFERENCE = 1e-7
# 400 s of gusts with tau = 0.1 s: the estimate of a variance has a standard deviation of sqrt(2 tau/400) = 2 %.
VARIANCE = 0.08
# Welch's spectrum averaged over 48 segments (half overlapping) and 10 or more neighbouring bins: 5 %; four of them.
SPECTRUM = 0.2

V, L, T = 5.0, 0.5, 0.002
TAU = L / V


def gusts(**changes):
    given = {"mean": [V, 0.0, 0.0], "turbulence": 0.2, "length_scale": L, "noise_interval": T} | changes
    return wind_field(**given)


def along(omega):
    """Dryden's spectrum of the gust along the wind, two-sided in rad/s, for variance 1: integral dw/(2 pi) = 1."""
    return 2.0 * TAU / (1.0 + (TAU * omega) ** 2)


def across(omega):
    square = (TAU * omega) ** 2
    return TAU * (1.0 + 3.0 * square) / (1.0 + square) ** 2


def test_closed_forms_have_variance_one():
    """The forms the other tests compare with, by quadrature."""
    for form in (along, across):
        total = 2.0 * quad(form, 0.0, np.inf, limit=500)[0] / (2.0 * np.pi)
        assert total == pytest.approx(1.0, abs=1e-7)


def test_filters_have_dryden_spectra():
    """|H(jw)|^2 from the noise, as intensity 1, to the wind is sigma^2 times the closed forms; components apart."""
    linear = ct.ss(gusts().linearize())
    omega = np.logspace(-2, 4, 61)
    response = linear(1j * omega)[:, 3:] * np.sqrt(T)
    sigma = 0.2 * V
    for i, form in enumerate((along, across, across)):
        np.testing.assert_allclose(np.abs(response[i, i]) ** 2, sigma**2 * form(omega), rtol=1e-10)
        for j in {0, 1, 2} - {i}:
            np.testing.assert_allclose(response[i, j], 0.0, atol=EXACT)


@pytest.mark.parametrize("interval", [0.001, 0.002, 0.01])
def test_held_noise_gives_the_variance(interval):
    """Exact variance at the samples: sigma^2 tanh(z)/z along the wind, z = T/(2 tau); 1 - (T/tau)^2/12 nearly."""
    block = gusts(noise_interval=interval)
    linear = block.linearize()
    n = linear.nstates
    augmented = np.block([[linear.A, linear.B[:, 3:]], [np.zeros((3, n + 3))]])
    stepped = expm(augmented * interval)
    A, B = stepped[:n, :n], stepped[:n, n:]
    covariance = linear.C @ solve_discrete_lyapunov(A, B @ B.T) @ linear.C.T
    variance = np.diag(covariance) / (0.2 * V) ** 2
    z = interval / (2.0 * TAU)
    # Along: K^2 (1 - phi)^2/(1 - phi^2)/T with K^2 = 2 tau and phi = exp(-T/tau) is tanh(z)/z.
    assert variance[0] == pytest.approx(np.tanh(z) / z, rel=1e-10)
    np.testing.assert_allclose(variance, 1.0, atol=0.5 * (interval / TAU) ** 2)
    np.testing.assert_allclose(covariance - np.diag(np.diag(covariance)), 0.0, atol=EXACT)


@pytest.fixture(scope="module")
def long_run():
    t = np.arange(0.0, 400.0, T)
    noise = np.random.default_rng(11).normal(size=(3, len(t)))
    response = pf.simulate(gusts(), t, [*np.zeros((3, len(t))), *noise], interpolation="hold")
    assert response.success
    return (response.outputs[:, 1000:] - [[V], [0.0], [0.0]]) / (0.2 * V)


@pytest.mark.slow
def test_a_long_run_has_the_variance(long_run):
    np.testing.assert_allclose(long_run.var(axis=1), 1.0, atol=VARIANCE)
    np.testing.assert_allclose(long_run.mean(axis=1), 0.0, atol=VARIANCE)
    correlations = np.corrcoef(long_run)[np.triu_indices(3, 1)]
    np.testing.assert_allclose(correlations, 0.0, atol=VARIANCE)


def test_a_long_run_has_the_spectrum(long_run):
    frequency, density = welch(long_run, 1.0 / T, nperseg=8192)
    omega = 2.0 * np.pi * frequency
    for form, measured in zip((along, across, across), density / 2.0, strict=True):  # one-sided in Hz
        for low, high in [(3.0, 12.0), (12.0, 40.0), (40.0, 120.0), (120.0, 300.0)]:
            band = (omega >= low) & (omega < high)
            assert band.sum() >= 10
            assert measured[band].mean() / form(omega[band]).mean() == pytest.approx(1.0, abs=SPECTRUM)


def test_without_noise_only_the_mean_blows():
    response = pf.simulate(gusts(mean=[1.0, -2.0, 0.5], airspeed=2.0), np.linspace(0.0, 5.0, 11), 0.0)
    np.testing.assert_allclose(response.outputs, np.tile([[1.0], [-2.0], [0.5]], 11), atol=EXACT)
    still = wind_field(turbulence=0.5)
    assert still.parameters["airspeed"] == 1.0
    np.testing.assert_array_equal(still.output(0.0, np.ones(5), np.ones(6)), np.zeros(3))


def test_jet_has_its_profile():
    """On the axis far downstream the speed; exp(-1/2) of it a width beside; half at the fan; none behind."""
    direction = np.array([3.0, 0.0, 4.0]) / 5.0
    jet = wind_field(jet_speed=6.0, jet_origin=[1.0, 2.0, 3.0], jet_direction=10.0 * direction, jet_width=0.4)
    assert jet.parameters["airspeed"] == 6.0
    beside = np.array([0.0, 1.0, 0.0])

    def blows(downstream, aside):
        place = np.array([1.0, 2.0, 3.0]) + downstream * direction + aside * beside
        return jet.output(0.0, jet.start_state, [*place, 0.0, 0.0, 0.0])

    np.testing.assert_allclose(blows(5.0, 0.0), 6.0 * direction, rtol=EXACT, atol=EXACT)
    np.testing.assert_allclose(blows(5.0, 0.4), 6.0 * np.exp(-0.5) * direction, rtol=EXACT, atol=EXACT)
    np.testing.assert_allclose(blows(5.0, -0.8), 6.0 * np.exp(-2.0) * direction, rtol=EXACT, atol=EXACT)
    np.testing.assert_allclose(blows(0.0, 0.0), 3.0 * direction, rtol=EXACT, atol=EXACT)
    assert np.linalg.norm(blows(-0.8, 0.0)) < 0.003  # two widths upstream: 6/(1 + e^8)
    assert np.linalg.norm(blows(-1e6, 0.0)) == 0.0
    speeds = [np.linalg.norm(blows(s, 0.1)) for s in np.linspace(-1.0, 3.0, 41)]
    assert (np.diff(speeds) >= 0.0).all()


def test_gusts_stand_on_the_local_wind():
    """Turbulence 0.3 of |U| along U, to its left and above; the axes are orthogonal wherever the wind blows."""
    rng = np.random.default_rng(12)
    for mean in [[2.0, 1.0, -0.5], [0.0, 0.0, 3.0], [-1.0, 0.0, 0.0]]:
        field = wind_field(mean=mean, turbulence=0.3, jet_speed=5.0, jet_width=1.0)
        u = np.concatenate([rng.normal(size=3) - 20.0, np.zeros(3)])  # out of the jet
        root = np.sqrt(3.0)
        axes = np.array(
            [
                field.output(0.0, state, u) - mean
                for state in (
                    [1.0, 0.0, 0.0, 0.0, 0.0],
                    [0.0, 1.0 / root, 0.0, 0.0, 0.0],
                    [0.0, 0.0, 1.0 / root, 0.0, 0.0],
                )
            ]
        )
        speed = np.linalg.norm(mean)
        np.testing.assert_allclose(axes @ axes.T, (0.3 * speed) ** 2 * np.eye(3), atol=EXACT)
        np.testing.assert_allclose(axes[0], 0.3 * np.array(mean), atol=EXACT)
        assert axes[1][2] == 0.0
        assert np.linalg.det(axes) > 0.0
        # ... and the second lag takes (sqrt(3) - 1) away, so that slow gusts have gain 1.
        slow = field.output(0.0, [0.0, 1.0, 0.0, 1.0, 0.0], u) - mean
        np.testing.assert_allclose(slow, axes[1], atol=EXACT)


def test_linearises_to_central_differences():
    field = gusts(jet_speed=3.0, jet_direction=[0.3, 1.0, 0.2], jet_width=0.7)
    rng = np.random.default_rng(13)
    x, u = rng.normal(size=5), np.concatenate([0.3 * rng.normal(size=3), np.zeros(3)])
    slopes = [
        (field.output(0.0, x, u + step) - field.output(0.0, x, u - step)) / 2e-6
        for step in 1e-6 * np.eye(6)[:3]
    ]
    np.testing.assert_allclose(field.linearize(x, u).D[:, :3], np.transpose(slopes), atol=DIFFERENCE)
    assert np.isfinite(wind_field(turbulence=0.2).linearize().D).all()  # where no wind blows


def test_a_batch_varies_the_fan():
    field = wind_field(jet_speed=1.0)
    runs = pf.simulate_batch(
        field, [0.0, 1.0], [2.0, 0.0, 0.0, 0.0, 0.0, 0.0], params={"jet_speed": [1.0, 4.0], "jet_width": 0.3}
    )
    assert [float(run.outputs[0, -1]) for run in runs] == pytest.approx([1.0, 4.0], abs=1e-5)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"mean": [1.0, 2.0]}, "mean: expected shape"),
        ({"jet_origin": [0.0, np.nan, 0.0]}, "jet_origin: expected finite"),
        ({"jet_direction": np.zeros(3)}, "jet_direction: expected a vector other than 0"),
        ({"jet_speed": -1.0}, "jet_speed: expected a finite number >= 0 m/s, along jet_direction"),
        ({"turbulence": -0.1}, "turbulence: expected a finite number >= 0"),
        ({"jet_width": 0.0}, "jet_width: expected a finite number > 0 m"),
        ({"length_scale": -1.0}, "length_scale: expected a finite number > 0"),
        ({"airspeed": 0.0}, "airspeed: expected a finite number > 0 m/s"),
        ({"noise_interval": 0.0}, "noise_interval: expected a finite number > 0 s"),
        (
            {"mean": [20.0, 0.0, 0.0], "turbulence": 0.1, "length_scale": 0.1},
            "noise_interval: expected at most 0.001 s",
        ),
    ],
)
def test_bad_numbers_are_refused(given, message):
    with pytest.raises(ValueError, match=message):
        wind_field(**given)
