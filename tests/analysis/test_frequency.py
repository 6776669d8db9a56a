"""Frequency responses against python-control, closed forms and what the recursion does to sines."""

from __future__ import annotations

import warnings

import control as ct
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag

from phyfilter_ctl import PhyFilter, plots
from phyfilter_ctl.analysis import (
    FilterResponse,
    FilterResponseList,
    _paths,
    _resolvent,
    frequency_response,
    grids,
)
from phyfilter_ctl.design import bandpass, lowpass, place_poles
from phyfilter_ctl.filter import SampledPhyFilter

mpl.use("Agg")

# Against direct solves, relative to the peak: what the engine is held to.
PEAK = 1e-9
# Closed forms and refined figures.
CLOSE = 1e-9
# Amplitudes fitted to a record: rounding of some thousand samples, transients below e^-40.
FITTED = 1e-8

OMEGA = np.geomspace(1e-2, 1e3, 60)


def same_as_control(system: ct.StateSpace, omega: np.ndarray) -> None:
    ours = frequency_response(system, omega)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # python-control warns at poles and above Nyquist
        theirs = ct.frequency_response(system, omega, squeeze=False)
    assert isinstance(ours, ct.FrequencyResponseData)
    np.testing.assert_array_equal(ours.omega, theirs.omega)
    assert ours.input_labels == theirs.input_labels
    assert ours.output_labels == theirs.output_labels
    assert (ours.dt, ours.sysname, ours.return_magphase) == (
        theirs.dt,
        theirs.sysname,
        theirs.return_magphase,
    )
    finite = np.isfinite(theirs.frdata)
    np.testing.assert_array_equal(np.isfinite(ours.frdata), finite)
    np.testing.assert_array_equal(np.isposinf(ours.frdata.real), np.isposinf(theirs.frdata.real))
    peak = np.max(np.abs(theirs.frdata[finite]), initial=0.0)
    np.testing.assert_allclose(ours.frdata[finite], theirs.frdata[finite], rtol=0.0, atol=PEAK * peak)


def random_system(seed: int, n: int, m: int, p: int, *, dt: float = 0.0) -> ct.StateSpace:
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    size = np.max(np.abs(np.linalg.eigvals(A)))
    A = 0.95 * A / size if dt else A - (size + 0.5) * np.eye(n)
    return ct.ss(A, rng.standard_normal((n, m)), rng.standard_normal((p, n)), rng.standard_normal((p, m)), dt)


# -- state space against python-control -----------------------------------------------------------------------------


@given(
    seed=st.integers(0, 10**6),
    n=st.integers(1, 9),
    m=st.integers(1, 3),
    p=st.integers(1, 3),
    dt=st.sampled_from([0.0, 0.01]),
)
@settings(max_examples=60, deadline=None)
def test_random_systems(seed: int, n: int, m: int, p: int, dt: float) -> None:
    same_as_control(random_system(seed, n, m, p, dt=dt), OMEGA[OMEGA < 314.0] if dt else OMEGA)


@given(
    poles=st.lists(st.floats(0.5, 80.0), min_size=1, max_size=3),
    repeat=st.integers(1, 3),
    channels=st.integers(1, 3),
)
@settings(max_examples=30, deadline=None)
def test_repeated_poles(poles: list[float], repeat: int, channels: int) -> None:
    same_as_control(PhyFilter.from_poles(np.repeat(-np.array(poles), repeat)).state_space(channels), OMEGA)


def dense_jordan(blocks: int, size: int, io: int) -> ct.StateSpace:
    rng = np.random.default_rng(3)
    J = block_diag(*[np.diag([-5.0 - 3.0 * k] * size) + 5.0 * np.eye(size, k=1) for k in range(blocks)])
    n = blocks * size
    S = np.linalg.qr(rng.standard_normal((n, n)))[0] * np.geomspace(1.0, 10.0, n)
    return ct.ss(
        S @ J @ np.linalg.inv(S),
        rng.standard_normal((n, io)),
        rng.standard_normal((io, n)),
        np.zeros((io, io)),
    )


def test_chains_of_repeated_poles() -> None:
    same_as_control(dense_jordan(3, 4, 2), OMEGA)


@pytest.mark.parametrize("shape", [(24, 5, 4), (24, 1, 4), (24, 4, 1)])
def test_back_substitution_is_a_solve_per_point(shape: tuple[int, int, int]) -> None:
    """Complex pairs, more or fewer inputs than outputs, and so many points that there are several chunks."""
    system = random_system(7, *shape)
    points = 1j * np.geomspace(1e-2, 1e2, 3001)
    values = _resolvent.evaluate(system.A, system.B, system.C, system.D, points)
    direct = _resolvent._direct(system.A, system.B, system.C, points) + system.D[:, :, None]
    np.testing.assert_allclose(values, direct, rtol=0.0, atol=PEAK * np.max(np.abs(direct)))


def test_decoupled_blocks_in_any_order() -> None:
    rng = np.random.default_rng(5)
    parts = [PhyFilter([400.0, 40.0]).state_space(2), random_system(2, 3, 1, 2), random_system(4, 2, 2, 1)]
    A, B, C, D = (block_diag(*[getattr(part, name) for part in parts]) for name in "ABCD")
    order = rng.permutation(len(A))
    mix = rng.standard_normal((B.shape[1], 4)), rng.standard_normal((3, C.shape[0]))
    same_as_control(
        ct.ss(A[order][:, order], (B @ mix[0])[order], (mix[1] @ C)[:, order], mix[1] @ D @ mix[0]), OMEGA
    )
    same_as_control(ct.ss(A[order][:, order], B[order], C[:, order], D), OMEGA)


def test_companion_form_with_huge_entries() -> None:
    system = ct.tf2ss(PhyFilter.from_poles([-200.0] * 5).transfer_function)
    same_as_control(system, OMEGA)
    near = _resolvent._near(np.full(5, -200.0 + 0j), system.A, 1j * OMEGA)
    assert np.any(near)  # without balancing the distance to the poles could not be told


def test_slow_and_fast_poles_side_by_side() -> None:
    A = np.array([[-1e5, 3e4, 0.0], [0.0, -1e-3, 1.0], [0.0, 0.0, -1e-3]])
    same_as_control(ct.ss(A, np.eye(3), np.eye(3), np.zeros((3, 3))), np.geomspace(1e-6, 1e6, 80))


@pytest.mark.parametrize(
    ("A", "omega"),
    [
        ([[0.0]], [0.0, 1.0]),
        ([[0.0, 1.0], [0.0, 0.0]], [0.0, 1e-9, 1.0]),
        ([[0.0, 3.0], [-3.0, 0.0]], [2.0, 3.0, 3.0 + 1e-9]),
        ([[-1.0, 0.0, 0.0], [1.0, -2.0, 0.0], [0.0, 0.0, 0.0]], [0.0, 2.0]),
    ],
)
def test_on_a_pole(A: list[list[float]], omega: list[float]) -> None:
    n = len(A)
    same_as_control(ct.ss(A, np.ones((n, 1)), np.arange(1.0, n + 1)[None, :], [[1.0]]), np.array(omega))


def test_on_a_pole_every_entry_says_so() -> None:
    """Where python-control looks for a zero at the same place, which it cannot for systems that are not square."""
    system = ct.ss(np.diag([-1.0, 0.0]), [[1.0], [0.0]], [[1.0, 0.0], [2.0, 0.0]], np.zeros((2, 1)))
    data = frequency_response(system, [0.0, 1.0]).frdata
    assert np.all(np.isposinf(data[:, :, 0].real))
    assert np.all(np.isnan(data[:, :, 0].imag))
    np.testing.assert_allclose(data[:, 0, 1], np.array([1.0, 2.0]) / (1.0 + 1.0j), rtol=CLOSE)


def test_static_gain_discrete_and_default_grid() -> None:
    same_as_control(ct.ss([], [], [], [[2.0, 1.0]]), OMEGA)
    same_as_control(ct.ss([[0.5]], [[1.0]], [[1.0]], [[0.0]], True), np.array([0.1, 3.0]))
    system = random_system(9, 4, 1, 1, dt=0.01)
    grid = frequency_response(system).omega
    assert grid[-1] <= np.pi / 0.01 * (1.0 + CLOSE)
    with pytest.raises(ValueError, match="A: every entry must be finite"):
        frequency_response(ct.ss([[np.nan]], [[1.0]], [[1.0]], [[0.0]]), [1.0])


def test_transfer_functions_go_to_python_control() -> None:
    data = frequency_response(PhyFilter([20.0]).transfer_function, [20.0])
    np.testing.assert_allclose(data.frdata[0, 0], [0.5 - 0.5j], rtol=CLOSE)


# -- a continuous filter --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("filter", [PhyFilter([20.0]), lowpass(4, 20.0), bandpass(4, 4.0, 9.0)])
def test_paths_are_those_of_the_state_space(filter: PhyFilter) -> None:
    response = frequency_response(filter, OMEGA)
    data = ct.frequency_response(filter.state_space(1), OMEGA, squeeze=False).frdata[0]
    for k, name in enumerate(("x", "g", "f_theta")):
        np.testing.assert_allclose(response.response(name), data[k], rtol=1e-8, atol=1e-12)
        np.testing.assert_array_equal(response.response(name, "error"), -response.response(name))
    np.testing.assert_allclose(response.F, -data[1], rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(response.F + response.error, 1.0, rtol=1e-12)
    np.testing.assert_array_equal(response.response("noise"), response.response("x"))
    np.testing.assert_array_equal(response.response("gamma", "error"), response.error)


def test_second_order_closed_forms() -> None:
    zeta, wn = 0.2, 7.0
    response = frequency_response(PhyFilter([wn**2, 2.0 * zeta * wn]))
    value, omega = response.peak
    assert value == pytest.approx(1.0 / (2.0 * zeta * np.sqrt(1.0 - zeta**2)), rel=CLOSE)
    assert omega == pytest.approx(wn * np.sqrt(1.0 - 2.0 * zeta**2), rel=1e-6)  # |F| is flat there
    drop = 1.0 - 2.0 * zeta**2
    assert response.bandwidth == pytest.approx(wn * np.sqrt(drop + np.sqrt(drop**2 + 1.0)), rel=CLOSE)
    assert response.noise_gain == pytest.approx(wn**2 / np.sqrt(4.0 * zeta * wn), rel=CLOSE)
    damped = np.geomspace(0.01, 100.0, 31) * wn
    lag = np.arctan2(2.0 * zeta * wn * damped, wn**2 - damped**2)
    np.testing.assert_allclose(response.phase_lag(damped), lag, atol=CLOSE)


def test_lightly_damped_peak_is_not_missed() -> None:
    value, omega = frequency_response(PhyFilter([100.0, 2e-5])).peak
    assert value == pytest.approx(10.0 / 2e-5, rel=1e-6)
    assert omega == pytest.approx(10.0, rel=1e-9)


@pytest.mark.parametrize("order", [1, 2, 5])
def test_binomial_closed_forms(order: int) -> None:
    response = frequency_response(lowpass(order, 20.0, norm="natural"))
    assert response.bandwidth == pytest.approx(20.0 * np.sqrt(2.0 ** (1.0 / order) - 1.0), rel=CLOSE)
    assert response.band_edges[0] == 0.0
    assert response.peak == (1.0, 0.0)
    np.testing.assert_allclose(
        response.phase_lag([0.0, 20.0, 2e4]), order * np.arctan([0, 1, 1e3]), atol=CLOSE
    )
    if order == 1:
        assert response.noise_gain == np.inf
        assert response.error_peak == (1.0, np.inf)
    assert response.omega[[0, -1]] == pytest.approx([0.2, 2000.0])


def test_error_peak_of_the_second_order_filter() -> None:
    # |1 - F|^2 of D = (s + 1)^2 is w^2 (w^2 + 4)/(w^2 + 1)^2, greatest at w^2 = 2: 4/3.
    value, omega = frequency_response(PhyFilter([1.0, 2.0])).error_peak
    assert (value, omega) == (
        pytest.approx(np.sqrt(4.0 / 3.0), rel=CLOSE),
        pytest.approx(np.sqrt(2.0), rel=1e-6),
    )


@pytest.mark.parametrize("order", [2, 4, 8])
def test_bandpass_figures(order: int) -> None:
    response = frequency_response(bandpass(order, 4.0, 9.0))
    assert response.band_edges == pytest.approx((4.0, 9.0), rel=CLOSE)
    assert response.bandwidth == pytest.approx(5.0, rel=CLOSE)
    assert response.peak.value == pytest.approx(1.0, rel=CLOSE)
    np.testing.assert_allclose(response.phase_lag([6.0, 9.0]), [0.0, np.pi / 8 * order], atol=1e-9)


def test_figures_of_nothing() -> None:
    response = frequency_response(PhyFilter([20.0], [0.0]))
    assert np.isnan(response.bandwidth)
    assert response.peak.value == 0.0


def test_low_frequencies_without_cancellation() -> None:
    response = frequency_response(place_poles([-20.0] * 3, type=3), [1e-3])
    np.testing.assert_allclose(response.error, (1e-3j / (20.0 + 1e-3j)) ** 3, rtol=CLOSE)


# -- a sampled filter, against what the recursion does to a sine ----------------------------------------------------

H = 0.01
SAMPLED = [
    PhyFilter([20.0]).sampled(H),
    lowpass(3, 15.0).sampled(H, g="average", f_theta="hold"),
    lowpass(2, 15.0).sampled(H, method="euler"),
    lowpass(2, 15.0, type=2).sampled(H, method="tustin"),
    lowpass(2, 15.0).sampled(H, delay=3 * H),
    lowpass(2, 15.0).sampled(H, g="average", delay=2.4 * H),
    lowpass(2, 15.0).sampled(H, f_theta="hold", delay=0.7 * H),
    bandpass(2, 15.0, 40.0).sampled(H),
]


def fitted(sampled: SampledPhyFilter, omega: float, input: str) -> complex:
    """Amplitude of f_hat for an input e^(j omega t), from the recursion over a record."""
    t = H * np.arange(1200)
    delayed = t - sampled.sampling.delay
    zero = np.zeros((len(t), 1))
    x, g, f_theta = zero, zero, zero
    amplitudes = []
    for part in (np.cos, np.sin):
        wave = part(omega * t)[:, None]
        if input == "gamma":  # x' = gamma, integrated exactly
            x = (np.sin(omega * delayed) if part is np.cos else -np.cos(omega * delayed))[:, None] / omega
        elif input == "x":
            x = part(omega * delayed)[:, None]
        elif input == "noise":
            x = wave
        elif input == "g":
            g = wave
        else:
            f_theta = wave
        amplitudes.append(sampled.run(x, g, f_theta)[:, 0])
    steady = (amplitudes[0] + 1j * amplitudes[1]) * np.exp(-1j * omega * t)
    assert np.ptp(steady[-200:].real) < 1e-6 * max(1.0, np.max(np.abs(steady)))
    return complex(steady[-1])


@pytest.mark.parametrize("sampled", SAMPLED, ids=repr)
@pytest.mark.parametrize("input", ["gamma", "x", "g", "f_theta", "noise"])
def test_response_is_what_the_recursion_does(sampled: SampledPhyFilter, input: str) -> None:
    omega = np.array([3.0, 40.0, 250.0])
    expected = np.array([fitted(sampled, w, input) for w in omega])
    response = frequency_response(sampled, omega)
    np.testing.assert_allclose(response.response(input), expected, rtol=FITTED, atol=FITTED)
    np.testing.assert_allclose(response.F + response.error, 1.0, atol=1e-12)
    if input != "gamma":
        np.testing.assert_array_equal(response.response(input, "error"), -response.response(input))


@pytest.mark.parametrize("sampled", SAMPLED, ids=repr)
def test_sampled_noise_gain_from_the_impulse_response(sampled: SampledPhyFilter) -> None:
    x = np.zeros((1500, 1))
    x[50] = 1.0
    gain = np.sqrt(np.sum(sampled.run(x) ** 2))
    assert frequency_response(sampled).noise_gain == pytest.approx(gain, rel=1e-7)


def test_sampled_tends_to_continuous() -> None:
    filter = lowpass(3, 20.0)
    omega = np.geomspace(0.1, 200.0, 40)
    exact = frequency_response(filter, omega)
    fine = frequency_response(filter.sampled(1e-5), omega)
    for name in ("gamma", "x", "f_theta", "noise"):
        wanted = exact.response(name)
        np.testing.assert_allclose(fine.response(name), wanted, atol=2e-3 * np.max(np.abs(wanted)))
    assert fine.bandwidth == pytest.approx(exact.bandwidth, rel=1e-3)


def test_slow_poles_keep_their_digits() -> None:
    # theta = 1e-8: 1 - F = j w (1/p + h/2 - h/2 + ...) to first order, lost if formed as 1 - F or z - 1.
    response = frequency_response(PhyFilter([1e-2]).sampled(1e-3), [1e-7])
    s = 1e-7j
    np.testing.assert_allclose(response.error, s / (s + 1e-2), rtol=1e-6)
    assert response.noise_gain == pytest.approx(1e-2 / np.sqrt(1.0), rel=1e-4)


def test_lag_grows_with_the_delay() -> None:
    filter = lowpass(2, 20.0)
    plain, late = (frequency_response(filter.sampled(H, delay=d)) for d in (0.0, 0.5))
    omega = np.array([1.0, 20.0, 300.0])
    np.testing.assert_allclose(late.phase_lag(omega) - plain.phase_lag(omega), 0.5 * omega, atol=CLOSE)
    assert late.phase_lag().shape == late.omega.shape


def test_bandwidth_beyond_nyquist_is_infinite() -> None:
    # At the Nyquist frequency the step average alone leaves 2/pi of gamma, so F must exceed 1 there.
    response = frequency_response(lowpass(2, 500.0, type=2).sampled(H))
    assert np.abs(response.F[-1]) > np.sqrt(0.5)
    assert response.bandwidth == np.inf


# -- several on one axis, plots and refusals ------------------------------------------------------------------------


def test_several_share_their_grid() -> None:
    filter = lowpass(2, 20.0)
    both = frequency_response([filter, filter.sampled(0.01), filter.sampled(0.05)])
    assert isinstance(both, FilterResponseList)
    assert [each.omega[-1] for each in both[1:]] == [np.pi / 0.01, np.pi / 0.05]
    shared = both[0].omega
    for each in both[1:]:
        np.testing.assert_array_equal(each.omega[:-1], shared[: len(each.omega) - 1])
    given_grid = frequency_response([filter, filter.sampled(0.05)], [100.0, 1.0])
    assert [each.omega.tolist() for each in given_grid] == [[1.0, 100.0], [1.0]]
    assert given_grid[0].nyquist == np.inf


def test_plot() -> None:
    filter = lowpass(2, 20.0)
    both = frequency_response([filter, filter.sampled(0.01)])
    before = dict(mpl.rcParams)
    plot = both.plot(labels=["continuous", "100 Hz"])
    assert dict(mpl.rcParams) == before
    assert isinstance(plot, ct.ControlPlot)
    magnitude, phase = plot.axes[:, 0]
    assert [len(lines) for lines in plot.lines[:, 0]] == [4, 2]
    np.testing.assert_array_equal(plot.lines[0, 0][1].get_ydata(), np.abs(both[0].error))
    np.testing.assert_allclose(
        np.deg2rad(plot.lines[1, 0][0].get_ydata()), np.unwrap(np.angle(both[0].F)), atol=1e-9
    )
    marks = [line.get_xdata()[0] for line in magnitude.get_lines() if line.get_linestyle() == ":"]
    assert marks == [np.pi / 0.01]
    texts = [text.get_text() for text in plot.legend.get_texts()]
    assert texts == ["continuous", "100 Hz", "$F$", "$1-F$"]
    assert "rad/s" in phase.get_xlabel()
    plot.figure.canvas.draw()
    again = both[0].plot([magnitude, phase], label="again")
    assert again.figure is plot.figure
    plt.close(plot.figure)


def test_plots_in_hertz_and_decibel_as_python_control() -> None:
    filter = lowpass(2, 20.0)
    response = frequency_response(filter.sampled(0.01))
    limit = plots.FrequencyLimit("error", 2.0, high=10.0)
    plot = response.plot(dB=True, Hz=True, deg=False, limits=[limit])
    plt.figure()
    theirs = ct.bode_plot(
        ct.frequency_response(filter, response.omega), dB=True, Hz=True, deg=False, wrap_phase=False
    )
    for axes, their in zip(plot.axes[:, 0], theirs.axes[:, 0], strict=True):
        assert axes.get_xscale() == their.get_xscale() == "log"
        assert axes.get_yscale() == their.get_yscale() == "linear"
    assert plot.axes[0, 0].get_ylabel() == theirs.axes[0, 0].get_ylabel() == "Magnitude [dB]"
    assert "[rad]" in plot.axes[1, 0].get_ylabel()
    assert plot.axes[1, 0].get_xlabel() == theirs.axes[1, 0].get_xlabel() == "Frequency [Hz]"
    gain, phase = plot.lines[0, 0][0], plot.lines[1, 0][0]
    np.testing.assert_array_equal(gain.get_xdata(), theirs.lines[0, 0][0].get_xdata())
    np.testing.assert_allclose(gain.get_ydata(), 20.0 * np.log10(np.abs(response.F)))
    np.testing.assert_allclose(phase.get_ydata(), -response.phase_lag())
    (drawn,) = [line for line in plot.axes[0, 0].get_lines() if line.get_color() == "0.35"]
    assert drawn.get_xdata()[1] == pytest.approx(10.0 / (2.0 * np.pi))
    assert drawn.get_ydata()[0] == pytest.approx(20.0 * np.log10(2.0))
    assert [line.get_xdata()[0] for line in plot.axes[0, 0].get_lines() if line.get_linestyle() == ":"] == [
        50.0
    ]
    assert plot.legend.get_texts()[0].get_text() == "n = 2, 3.17 Hz, h = 10 ms"
    for figure in (plot.figure, theirs.figure):
        plt.close(figure)


def test_plots_follow_python_control_s_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    response = frequency_response(PhyFilter([20.0]))
    plain = response.plot()
    for name in ("dB", "Hz"):
        monkeypatch.setitem(ct.config.defaults, f"freqplot.{name}", True)
    set_so, said = response.plot(), response.plot(dB=False, Hz=False)
    assert set_so.axes[1, 0].get_xlabel() == "Frequency [Hz]"
    assert set_so.axes[0, 0].get_ylabel() == "Magnitude [dB]"
    assert [ax.get_xlabel() for ax in said.axes[:, 0]] == [ax.get_xlabel() for ax in plain.axes[:, 0]]
    np.testing.assert_array_equal(said.lines[0, 0][0].get_xydata(), plain.lines[0, 0][0].get_xydata())
    for plot in (plain, set_so, said):
        plt.close(plot.figure)


def test_plot_refusals() -> None:
    response = frequency_response(PhyFilter([20.0]))
    with pytest.raises(ValueError, match="labels: expected one for each of the 1 responses, got 2"):
        FilterResponseList((response,)).plot(labels=["a", "b"])
    figure, ax = plt.subplots()
    with pytest.raises(ValueError, match="ax: expected two axes"):
        response.plot([ax])
    plt.close(figure)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda f: frequency_response(f, [-1.0, 1.0]), "frequencies of 0 rad/s or more, got -1"),
        (lambda f: frequency_response(f, [np.nan]), "finite frequencies"),
        (lambda f: frequency_response(f, []), "finite frequencies"),
        (lambda f: frequency_response(f, [[1.0]]), "one dimension"),
        (
            lambda f: frequency_response(f.sampled(0.01), [400.0]),
            "400 rad/s is above the Nyquist frequency 314.159",
        ),
        (lambda f: frequency_response([f.sampled(0.01)], [400.0]), "no frequency is below the Nyquist"),
        (
            lambda f: frequency_response(f).response("u"),
            "input: expected one of gamma, x, g, f_theta, noise, got 'u'",
        ),
        (lambda f: frequency_response(f).response("x", "f"), "output: expected one of f_hat, error"),
        (lambda f: frequency_response(f.sampled(0.01)).phase_lag(400.0), "above the Nyquist"),
    ],
)
def test_refusals(call, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call(PhyFilter([20.0]))


@pytest.mark.parametrize(
    "system", ["F", 3.0, [], [PhyFilter([1.0]), 2], ct.nlsys(None, lambda t, x, u, p: u)]
)
def test_wrong_systems(system) -> None:
    with pytest.raises(TypeError, match="expected a PhyFilter, a SampledPhyFilter, a sequence"):
        frequency_response(system)


def test_at_zero_frequency() -> None:
    for system in (PhyFilter([20.0]), PhyFilter([20.0]).sampled(0.01, delay=0.02)):
        response = frequency_response(system, 0.0)
        assert isinstance(response, FilterResponse)
        assert response.F.tolist() == [1.0]
        assert response.error.tolist() == [0.0]


def test_zeros_out_of_reach_leave_band_and_peak_alone() -> None:
    """Their sizes span 350 decades: the search stays short and finite."""
    poles = [-20.0, -15 + 8j, -15 - 8j]
    far = frequency_response(PhyFilter.from_poles(poles, [1.1e-88, 1.0, 1.3e-266]), OMEGA)
    near = frequency_response(PhyFilter.from_poles(poles, [0.0, 1.0, 0.0]), OMEGA)
    assert far.band_edges == pytest.approx(near.band_edges, rel=CLOSE)
    assert far.peak == pytest.approx(near.peak, rel=1e-6)  # where it is, to the square root of rounding


@pytest.mark.parametrize("poles", [[-1e-100, -1e100], [-1e-90, -1.0, -1e90]])
def test_the_search_grid_is_bounded(poles: list[float]) -> None:
    filter = PhyFilter.from_poles(poles)
    assert len(grids.search(filter)) <= grids._MOST_POINTS + 2
    assert frequency_response(filter).bandwidth == pytest.approx(-poles[0], rel=1e-2)


def test_noise_that_cancels_is_zero_not_nan() -> None:
    """F(0) = 0 and steps so long that every sample forgets the last: f_hat is F(0) u."""
    sampled = PhyFilter.from_poles(
        [-59864.39146456445 + 80089.04253752434j, -59864.39146456445 - 80089.04253752434j, -99990.0],
        [0.0, -1.7384802399547234, 3.983256450251602],
    ).sampled(1.0)
    # Rounding of the two variances that cancel, each of size (C B)^2, leaves the root of eps.
    size = np.abs(sampled.transition[2]).sum() / sampled.dt
    assert 0.0 <= frequency_response(sampled).noise_gain <= 1e-7 * size


def test_noise_that_rounding_hides_is_nan_without_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    swing = np.array([[0.0, 1.0], [-1.0, 0.0]])  # never decays: the sum of its eigenvalues is 0 exactly
    assert np.isnan(_paths._covariance(swing, np.ones(2))).all()
    monkeypatch.setattr(_paths, "_covariance", lambda A, drive: np.full_like(A, np.nan))
    assert np.isnan(frequency_response(PhyFilter([20.0]).sampled(0.01), [1.0]).noise_gain)
