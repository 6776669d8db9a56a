"""Pictures of results: what is drawn are the results' numbers, axes are named with units, nothing leaves the figure."""

from __future__ import annotations

import io
from collections.abc import Iterator

import control as ct
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.text import Text

from phyfilter_ctl import (
    Bounded,
    Gaussian,
    PhyFilter,
    bandpass,
    error_bound,
    error_variance,
    frequency_response,
    gauss_markov,
    hz,
    lowpass,
    place_poles,
)
from phyfilter_ctl.analysis import error_budget
from phyfilter_ctl.design import trade_off
from phyfilter_ctl.plots import COLOURS, FrequencyLimit
from phyfilter_ctl.plots.budget import budget_curves, budget_plot
from phyfilter_ctl.plots.estimates import estimate_plot
from phyfilter_ctl.plots.learning import learning_plot
from phyfilter_ctl.plots.poles import PoleSet, pole_plot
from phyfilter_ctl.plots.promises import analysis_plot
from phyfilter_ctl.recording import Recording
from tests.cpu_budget import slow_but

# F at its zeros over |F| beside them: rounding of n roots.
ZERO = 1e-8
# Roots of coefficients against poles that are known.
CLOSE = 1e-9
# A vector file of a flight of 60,000 samples, in bytes; as strokes it has several MB.
LIGHT = 600_000

SECOND = PhyFilter([400.0, 40.0])
FOURTH = lowpass(4, 20.0, family="butterworth", type=2)
LEARNED = PhyFilter([9784.89, 930.837, 53.2642], [9630.64, 772.787, 3.13839])


@pytest.fixture(autouse=True)
def _settings_stay_and_figures_close() -> Iterator[None]:
    before = dict(mpl.rcParams)
    yield
    plt.close("all")
    assert dict(mpl.rcParams) == before


def outside_or_overlapping(plot: ct.ControlPlot) -> list[str]:
    """Names that leave the figure, and entries of a legend that cover each other."""
    canvas = plot.figure.canvas
    canvas.draw()
    renderer = canvas.get_renderer()
    page = plot.figure.bbox
    wrong: list[str] = []
    for axes in plot.figure.axes:
        texts: list[Text] = [axes.xaxis.label, axes.yaxis.label, *axes.texts]
        legend = axes.get_legend()
        texts += [] if legend is None else legend.get_texts()
        placed = [
            (text.get_text(), text.get_window_extent(renderer)) for text in texts if text.get_text().strip()
        ]
        for name, box in placed:
            clipped = box.width and not (
                box.x0 >= page.x0 - 1
                and box.x1 <= page.x1 + 1
                and box.y0 >= page.y0 - 1
                and box.y1 <= page.y1 + 1
            )
            if clipped:
                wrong.append(f"{name!r} leaves the figure")
        entries = [] if legend is None else [t for t in legend.get_texts() if t.get_text().strip()]
        boxes = [(t.get_text(), t.get_window_extent(renderer)) for t in entries]
        for k, (name, box) in enumerate(boxes):
            wrong += [f"{name!r} covers {other!r}" for other, there in boxes[:k] if box.overlaps(there)]
    return wrong


def legend_of(plot: ct.ControlPlot) -> list[str]:
    assert plot.legend is not None
    return [text.get_text() for text in plot.legend.get_texts()]


def points(line) -> np.ndarray:
    return np.asarray(line.get_xdata()) + 1j * np.asarray(line.get_ydata())


# -- poles and zeros --------------------------------------------------------------------------------------------------


def test_poles_in_the_s_plane() -> None:
    found = frequency_response([FOURTH, SECOND, bandpass(2, 4.0, 9.0)]).pole_zero_map
    plot = found.plot(labels=["fourth", "second", "band"])
    assert plot.lines.shape == (3, 3)
    for row, entry in zip(plot.lines, found, strict=True):
        for lines, roots in zip(row, (entry.poles, entry.zeros, entry.error_zeros), strict=True):
            drawn = points(lines[0]) if lines else np.zeros(0)
            np.testing.assert_array_equal(drawn, roots)
    (axes,) = plot.axes[:, 0]
    assert axes.get_xlabel() == "Real part [rad/s]"
    assert axes.get_aspect() == 1.0
    assert set(legend_of(plot)) >= {"fourth", "poles", "zeros of $1-F$"}
    assert "$\\times$2" in {text.get_text() for text in axes.texts}, "the double pole is counted"
    colours = [row[0][0].get_markeredgecolor() for row in plot.lines]
    assert colours == list(COLOURS[:3])
    assert not outside_or_overlapping(plot)


def test_zeros_are_zeros() -> None:
    for filter in (FOURTH, LEARNED, bandpass(2, 4.0, 9.0), place_poles([-3 + 4j, -3 - 4j], type=1)):
        (entry,) = frequency_response(filter).pole_zero_map
        scale = float(np.max(np.abs(filter.poles)))
        for zeros, response in ((entry.zeros, filter), (entry.error_zeros, filter.error)):
            beside = np.abs(response(zeros + 0.1j * scale))
            np.testing.assert_array_less(np.abs(response(zeros)), ZERO * beside)
        assert np.sum(entry.error_zeros == 0.0) == filter.type


@pytest.mark.parametrize("method", ["exact", "euler", "tustin"])
@pytest.mark.parametrize("filter", [SECOND, FOURTH, LEARNED, PhyFilter([20.0])], ids=repr)
def test_sampled_poles_and_zeros_rebuild_the_response(filter: PhyFilter, method) -> None:
    """F_d from its poles, its zeros and its value at one frequency is F_d at the others."""
    sampled = filter.sampled(0.01, method)
    (entry,) = frequency_response(sampled).pole_zero_map
    dA, equilibrium, C = sampled.transition
    omega = np.array([1.0, 5.0, 40.0, 200.0, 300.0])
    z = np.exp(1j * omega * sampled.dt)
    eye = np.eye(filter.order)
    direct = np.array([v * (C @ np.linalg.solve(v * eye - eye - dA, -dA @ equilibrium)) for v in z])
    rebuilt = np.array([np.prod(v - entry.zeros) / np.prod(v - entry.poles) for v in z])
    # The gain of the zeros is free, so one frequency is given.
    np.testing.assert_allclose(rebuilt / rebuilt[0], direct / direct[0], rtol=1e-6)
    assert len(entry.error_zeros) == 0


def test_z_plane_whole_and_enlarged() -> None:
    slow = frequency_response([SECOND.sampled(0.05), FOURTH.sampled(0.05)]).pole_zero_map.plot()
    (axes,) = slow.axes[:, 0]
    assert axes.get_xlabel() == "Real part of $z$"
    assert axes.get_xlim() == (-1.15, 1.15)
    radii = [np.abs(points(line)) for line in axes.get_lines() if len(line.get_xdata()) == 721]
    np.testing.assert_allclose(radii[0], 1.0, atol=CLOSE)
    # Each line of equal natural frequency begins on the unit circle where its name stands, and turns upwards.
    named = [text for text in axes.texts if "rad/s" in text.get_text()]
    assert len(named) == 2
    curves = [points(line) for line in axes.get_lines() if len(line.get_xdata()) < 721]
    for text in named:
        angle = 0.05 * float(text.get_text().split()[0])
        assert abs(complex(*text.xy) - np.exp(1j * angle)) < CLOSE
        begins = [z for z in curves if abs(z[0] - np.exp(1j * angle)) < CLOSE]
        assert begins
        assert all(abs(z[1]) < 1.0 for z in begins)
    fast = frequency_response([SECOND.sampled(0.002), FOURTH.sampled(0.002)]).pole_zero_map
    plot = fast.plot()
    (near,) = plot.axes[:, 0]
    left, right = near.get_xlim()
    assert left > 0.9, "poles near z = 1 are enlarged"
    for row, entry in zip(plot.lines, fast, strict=True):
        np.testing.assert_array_equal(points(row[0][0]), entry.poles)
        assert all(left < z.real < right for z in points(row[0][0]))
        inside = [z for z in entry.zeros if left < z.real < right]
        np.testing.assert_array_equal(points(row[1][0]), inside)
        assert len(row[1]) == 2, "the zeros far to the left share one mark"
    values = " ".join(text.get_text() for text in near.texts)
    assert "\N{LEFTWARDS ARROW} 0, \N{MINUS SIGN}0.9" in values
    for each in (slow, plot):
        assert not outside_or_overlapping(each)


def test_a_far_zero_is_at_the_rim_with_its_value() -> None:
    plot = frequency_response(LEARNED).pole_zero_map.plot()
    (axes,) = plot.axes[:, 0]
    inside, rim = plot.lines[0, 1]
    np.testing.assert_allclose(points(inside), [-13.1662], atol=1e-3)
    left, right = axes.get_xlim()
    assert left < points(rim)[0].real < left + 0.1 * (right - left)
    assert "\N{LEFTWARDS ARROW} \N{MINUS SIGN}233" in {text.get_text() for text in axes.texts}


def test_poles_on_given_axes_and_refusals() -> None:
    figure, axes = plt.subplots()
    assert frequency_response(SECOND).pole_zero_map.plot(axes).figure is figure
    with pytest.raises(ValueError, match="expected all filters continuous or all sampled"):
        frequency_response([SECOND, SECOND.sampled(0.01)]).pole_zero_map.plot()
    with pytest.raises(ValueError, match="labels: expected one for each of the 1 filters, got 2"):
        frequency_response(SECOND).pole_zero_map.plot(labels=["a", "b"])
    with pytest.raises(ValueError, match="each with a pole"):
        pole_plot([PoleSet("none", np.zeros(0, dtype=complex))])
    with pytest.raises(TypeError, match="expected a PhyFilter"):
        frequency_response([])


# -- magnitude with limits --------------------------------------------------------------------------------------------


def test_limits_beside_the_curves() -> None:
    response = frequency_response([FOURTH.sampled(0.005), SECOND.sampled(0.005)])
    limits = [FrequencyLimit("error", 0.1, high=2.0), FrequencyLimit("F", 0.05, low=100.0)]
    plot = response.plot(limits=limits)
    magnitude = plot.axes[0, 0]
    drawn = {line.get_linestyle(): line for line in magnitude.get_lines() if line.get_color() == "0.35"}
    left, right = magnitude.get_xlim()
    assert list(drawn["--"].get_xdata()) == [left, 2.0]
    assert list(drawn["--"].get_ydata()) == [0.1, 0.1]
    assert list(drawn["-"].get_xdata()) == [100.0, right]
    assert right == pytest.approx(np.pi / 0.005), "an open limit does not stretch the axis"
    assert "limits" in legend_of(plot)
    assert not outside_or_overlapping(plot)
    for entry, curves in zip(response, (plot.lines[0, 0][:2], plot.lines[0, 0][2:]), strict=True):
        np.testing.assert_array_equal(curves[0].get_ydata(), np.abs(entry.F))
        np.testing.assert_array_equal(curves[1].get_ydata(), np.abs(entry.error))


def test_three_filters_with_long_names_stay_in_the_figure() -> None:
    filter = lowpass(2, 20.0)
    plot = frequency_response([filter, filter.sampled(0.01), filter.sampled(0.05)]).plot()
    assert not outside_or_overlapping(plot)
    marks = [text for text in plot.axes[0, 0].texts if text.get_text() == "Nyquist"]
    assert [text.xy[0] for text in marks] == pytest.approx([np.pi / 0.05, np.pi / 0.01])


@pytest.mark.parametrize(
    ("of", "magnitude", "low", "high", "message"),
    [
        ("F", 0.0, 0.0, 1.0, "magnitude: expected a positive number"),
        ("error", 1.0, 2.0, 1.0, "low < high"),
        ("f_hat", 1.0, 0.0, 1.0, "of: expected 'F' or 'error'"),
    ],
)
def test_limits_refused(of, magnitude: float, low: float, high: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        FrequencyLimit(of, magnitude, low, high)


# -- error budget -----------------------------------------------------------------------------------------------------


def test_budget_of_bounds_as_bars() -> None:
    given = Bounded({1: 8.0}, noise=0.01, inertia_error=0.05, rate=2.0)
    bounds = {f"{w:g} rad/s": error_bound(lowpass(2, w), given) for w in (10.0, 20.0, 40.0)}
    budget = error_budget(bounds, unit="m/s^2")
    np.testing.assert_allclose(budget.total, [entry.bound for entry in bounds.values()], rtol=1e-12)
    plot = budget.plot()
    bars = plot.lines[0, 0]
    for container, part in zip(bars, ("intrinsic", "inertia", "noise"), strict=True):
        expected = [getattr(entry, part) for entry in bounds.values()]
        np.testing.assert_allclose([bar.get_width() for bar in container], expected, rtol=1e-12)
    ends = [bar.get_x() + bar.get_width() for bar in bars[-1]]
    np.testing.assert_allclose(ends, budget.total, rtol=1e-12, err_msg="the bars are stacked")
    assert len({container[0].get_hatch() for container in bars}) == 3, "told apart without colour"
    (axes,) = plot.axes[:, 0]
    assert axes.get_xlabel() == "Bound of $|f-\\hat f|$ [m/s$^2$]"
    assert [text.get_text() for text in axes.get_yticklabels()] == list(bounds)
    assert [text.get_text() for text in axes.texts] == [f"{value:.3g}" for value in budget.total]
    assert not outside_or_overlapping(plot)


def test_budget_over_bandwidth() -> None:
    designs = trade_off(
        PhyFilter([20.0]).faster,
        np.geomspace(0.1, 10.0, 21),
        cost=lambda each: error_bound(each, Bounded({1: 8.0}, noise=0.01)),
    )
    bounds = [error_bound(each, Bounded({1: 8.0}, noise=0.01)) for each in designs.results]
    budget = error_budget(bounds[::-1], unit="N")
    assert budget.bandwidth is not None
    assert np.all(np.diff(budget.bandwidth) > 0.0)
    np.testing.assert_allclose(budget.residual, designs.costs["residual"], rtol=1e-6)
    np.testing.assert_allclose(budget.noise, designs.costs["noise"], rtol=1e-6)
    plot = budget.plot()
    total, residual, noise, best = plot.lines[0, 0]
    np.testing.assert_array_equal(total.get_ydata(), budget.total)
    np.testing.assert_array_equal(residual.get_ydata(), budget.residual)
    np.testing.assert_array_equal(noise.get_ydata(), budget.noise)
    np.testing.assert_array_equal(noise.get_xdata(), budget.bandwidth)
    assert best.get_xdata() == [budget.bandwidth[designs.results.index(designs.best)]]
    assert len({line.get_linestyle() for line in (total, residual, noise)}) == 3
    assert plot.axes[0, 0].get_xlabel() == "Bandwidth [rad/s]"
    assert not outside_or_overlapping(plot)
    hertz = budget.plot(Hz=True)
    assert hertz.axes[0, 0].get_xlabel() == "Bandwidth [Hz]"
    np.testing.assert_allclose(hertz.lines[0, 0][0].get_xdata(), budget.bandwidth / hz(1.0))
    assert hertz.lines[0, 0][-1].get_label().endswith(" Hz")


def test_budget_of_variances() -> None:
    gamma = gauss_markov(1.0, 0.5)
    found = {w: error_variance(lowpass(2, w), Gaussian(gamma, noise=0.01)) for w in (5.0, 20.0)}
    named = error_budget({f"{w:g} rad/s": entry for w, entry in found.items()}, unit="N")
    assert list(named.parts) == ["residual", "noise"], "there is no prior in a variance"
    np.testing.assert_allclose(named.total, [entry.error for entry in found.values()], rtol=1e-12)
    assert named.plot().axes[0, 0].get_xlabel() == "Variance of $f-\\hat f$ [N$^2$]"
    over = error_budget(list(found.values()), bandwidth=list(found))
    assert over.plot().axes[0, 0].get_ylabel() == "Variance of $f-\\hat f$ [(unit of f)$^2$]"


def test_budget_refusals() -> None:
    bound = error_bound(SECOND, {1: 8.0})
    variance = error_variance(SECOND, Gaussian(noise=0.01))
    with pytest.raises(ValueError, match="at least one"):
        error_budget([])
    with pytest.raises(TypeError, match="all ErrorBound or all Variance, got ErrorBound, Variance"):
        error_budget([bound, variance])  # type: ignore[list-item]  # the mixture is what is refused
    with pytest.raises(ValueError, match="does not know its filter"):
        error_budget([variance])
    with pytest.raises(ValueError, match=r"bandwidth: expected shape \(1,\)"):
        error_budget([bound], bandwidth=[1.0, 2.0])
    with pytest.raises(ValueError, match="bandwidth: a mapping"):
        error_budget({"a": bound}, bandwidth=[1.0])
    with pytest.raises(ValueError, match="positive finite"):
        error_budget([bound], bandwidth=[np.inf])
    message = r"parts: expected at least one, each of shape \(1,\)"
    with pytest.raises(ValueError, match=message):
        budget_plot({"residual": np.ones(2)}, ["a"], label="")
    with pytest.raises(ValueError, match=message):
        budget_curves({}, np.ones(1), label="")


# -- estimates beside the truth ---------------------------------------------------------------------------------------


def flight(n: int = 400, channels: int = 3) -> Recording:
    rng = np.random.default_rng(7)
    t = 0.01 * np.arange(n)
    f = np.sin(np.outer(t, 1.0 + np.arange(channels)))
    x = np.cumsum(f, axis=0) * 0.01 + 1e-3 * rng.standard_normal(f.shape)
    names = ("vx", "vy", "vz")[:channels]
    return Recording.from_arrays(x=x, dt=0.01, label=f, f_theta=0.7 * f, channels=names, unit="m/s")


def test_estimates_beside_the_truth() -> None:
    log = flight()
    f_hat = SECOND.sampled(log.dt).run(log.x, f_theta=log.f_theta)
    found = log.compare({"PhyFilter": f_hat})
    assert list(found.estimates) == ["PhyFilter", "f_theta"]
    assert log.label is not None
    wrong = log.label - f_hat
    assert found.rmse["PhyFilter"] == pytest.approx(
        np.linalg.norm(wrong[1:]) / np.sqrt(wrong[1:].size), rel=1e-12
    )
    plot = found.plot()
    assert plot.axes.shape == plot.lines.shape == (6, 1)
    for i, channel in enumerate(log.channels):
        truth, estimate, model = plot.lines[2 * i, 0]
        np.testing.assert_array_equal(truth.get_ydata(), log.label[:, i])
        np.testing.assert_array_equal(estimate.get_ydata(), f_hat[:, i])
        np.testing.assert_array_equal(estimate.get_xdata(), log.times)
        np.testing.assert_array_equal(plot.lines[2 * i + 1, 0][0].get_ydata(), wrong[:, i])
        assert estimate.get_linestyle() != model.get_linestyle()
        assert plot.axes[2 * i, 0].get_ylabel() == f"$f$ of {channel} [m/s$^2$]"
        figures = {text.get_text() for text in plot.axes[2 * i + 1, 0].texts}
        assert figures == {"RMSE", *(f"{values[i]:.3g}" for values in found.channel_rmse.values())}
    assert plot.axes[-1, 0].get_xlabel() == "Time [s]"
    entry = legend_of(plot)[1]
    assert entry == f"PhyFilter, RMSE {found.rmse['PhyFilter']:.3g} m/s$^2$"
    assert not outside_or_overlapping(plot)


def test_one_channel_on_given_axes() -> None:
    log = flight(channels=1).with_signals(f_theta=None)
    figure, pair = plt.subplots(2, 1)
    found = log.compare({"none": np.zeros((log.n, 1))}, unit="N")
    plot = found.plot(ax=pair)
    assert plot.figure is figure
    assert legend_of(plot) == ["truth", "none"]
    np.testing.assert_array_equal(found.errors["none"], log.label)


def test_a_long_flight_is_a_light_file() -> None:
    log = flight(60_000, channels=1)
    plot = log.compare({"PhyFilter": SECOND.sampled(log.dt).run(log.x)}).plot()
    file = io.BytesIO()
    plot.figure.savefig(file, format="svg")
    assert len(file.getvalue()) < LIGHT


def test_comparison_refusals() -> None:
    log = flight(channels=1)
    with pytest.raises(ValueError, match="the log has no label"):
        log.with_signals(label=None).compare({})
    with pytest.raises(ValueError, match=r"bad: expected shape \(400, 1\)"):
        log.compare({"bad": np.zeros((3, 1))})
    with pytest.raises(ValueError, match="at least one estimate"):
        log.with_signals(f_theta=None).compare({})
    with pytest.raises(ValueError, match="ax: expected 2 axes"):
        log.compare({}).plot(ax=[plt.subplots()[1]])
    with pytest.raises(ValueError, match="errors and RMSE for each"):
        estimate_plot(log.times, log.x, {"a": log.x}, {}, {}, channels=log.channels)


# -- the others -------------------------------------------------------------------------------------------------------


def test_learning_curve_draws_root_mean_squares() -> None:
    (curve,) = [response.curve() for response in frequency_response([SECOND])]
    events = [(1, 0, 1, 0.04), (1, 0, 2, 0.01), (2, 0, 1, 0.0225), (2, 1, 1, 0.0144)]
    plot = learning_plot(events, [curve])
    drawn = [line.get_ydata().tolist() for line in plot.lines[0, 0]]
    assert drawn == [pytest.approx([0.2, 0.1]), pytest.approx([0.15]), pytest.approx([0.12])]
    errors = plot.axes[0, 0]
    assert errors.get_ylabel() == "RMS error [unit of f]"
    plot.figure.canvas.draw()
    labels = {text.get_text() for text in errors.get_yticklabels()}
    assert {"0.1", "0.15", "0.2"} <= labels, "read off without powers of ten"
    assert not outside_or_overlapping(plot)


def test_trade_off_and_bound_have_units() -> None:
    designs = trade_off(
        PhyFilter([20.0]).faster,
        np.geomspace(0.1, 10.0, 9),
        cost=lambda each: error_bound(each, Bounded({1: 8.0}, noise=0.01)),
    )
    curve = designs.plot()
    np.testing.assert_array_equal(curve.lines[0, 0][0].get_xdata(), designs.costs["residual"])
    np.testing.assert_array_equal(curve.lines[0, 0][0].get_ydata(), designs.costs["noise"])
    bound = error_bound(lowpass(2, 20.0, type=2), {2: 8.0})
    course = bound.plot()
    assert course.axes[0, 0].get_ylabel() == "Response to $\\gamma^{(2)}$ [s]"
    np.testing.assert_allclose(course.lines[1, 0][0].get_ydata()[-1], bound.intrinsic, rtol=1e-3)
    for plot in (curve, course):
        assert not outside_or_overlapping(plot)


@pytest.mark.parametrize("grown", slow_but([True], [True, False]))
def test_page_of_the_analysis(grown: bool) -> None:
    response = frequency_response(FOURTH.sampled(0.01))
    t = np.linspace(0.0, 1.0, 20)
    growth = [(t, 1.0 - np.exp(-9.0 * t), 1.0)] if grown else []
    both = {"inner loop": [np.abs(response.error)], "complete loop": [np.abs(response.error) ** 2]}
    plot = analysis_plot([response.curve()], response.omega, both, growth)
    inner, complete = plot.lines[1, 1]
    np.testing.assert_array_equal(inner.get_ydata(), np.abs(response.error))
    assert inner.get_linestyle() != complete.get_linestyle()
    assert plot.axes[0, 1].axison == grown
    assert not outside_or_overlapping(plot)
