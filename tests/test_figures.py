"""Pictures are legible: no text covers another, leaves the page or is too small, no two curves look alike."""

from __future__ import annotations

from collections.abc import Iterator

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.figure import Figure

import phyfilter_ctl as pf
from phyfilter_ctl import frequency_response
from phyfilter_ctl.plots import dress, letter_panels, typeset
from phyfilter_ctl.plots._style import LINES, PhaseLocator, line_style
from phyfilter_ctl.plots.budget import budget_curves
from phyfilter_ctl.plots.learning import learning_plot
from phyfilter_ctl.plots.logs import log_plot
from phyfilter_ctl.plots.missed import missed_plot
from phyfilter_ctl.plots.promises import analysis_plot
from tests.figures import faults

T = np.linspace(0.0, 2.0, 60)
WAVE = np.sin(3.0 * T)[:, None]
MANY = [pf.lowpass(2, 4.0 * 1.5**k) for k in range(16)]


@pytest.fixture(autouse=True)
def _figures_close() -> Iterator[None]:
    yield
    plt.close("all")


def test_ticks_of_phase_are_multiples_of_45_degrees() -> None:
    ticks = PhaseLocator().tick_values
    assert ticks(-190.0, 5.0) == [-180.0, -135.0, -90.0, -45.0, 0.0]
    assert ticks(-1500.0, 0.0)[-2:] == [-360.0, 0.0]
    assert ticks(-50.0, 0.0) == [-45.0, -30.0, -15.0, 0.0]
    for span in (70.0, 200.0, 500.0, 4000.0):
        assert 2 <= len(ticks(-span, 0.0)) <= 8


def test_curves_differ_beyond_seven() -> None:
    looks = {str(line_style(k)) for k in range(len(LINES) ** 2)}
    assert len(looks) == len(LINES) ** 2


def test_letters_run_in_reading_order() -> None:
    figure = Figure(figsize=(8.0, 6.0))
    grid = figure.add_gridspec(2, 6)
    for cell, title in (
        (grid[1, :3], "left"),
        (grid[0, 4:], "last"),
        (grid[1, 3:], "right"),
        (grid[0, :4], "first"),
    ):
        dress(figure.add_subplot(cell), title)
    letter_panels(figure)
    assert sorted(axes.get_title(loc="left") for axes in figure.axes) == [
        "a  first",
        "b  last",
        "c  left",
        "d  right",
    ]


@pytest.mark.slow
def test_faults_are_found() -> None:
    figure = Figure(figsize=(4.0, 3.0))
    left, right = figure.subplots(1, 2)
    left.bar([1, 2], [3, 4], label="bars")
    left.set_yscale("log")
    left.set_title("b  left", loc="left", fontsize=3)
    right.set_title("a  right", loc="left")
    right.plot([0, 1], label="one", color="C0")
    right.plot([1, 0], label="other", color="C0")
    right.legend()
    right.text(0.1, 0.5, "here", clip_on=False)
    right.text(0.1, 0.5, "there", clip_on=False)
    right.text(9.0, 0.5, "far", clip_on=False)
    found = "\n".join(faults(figure))
    for words in (
        "bars on a logarithmic axis",
        "pixels high",
        "2 entries of a legend look alike",
        " covers '",
        "'far' leaves the figure",
        "do not run from left to right",
        "no label on x",
    ):
        assert words in found, words


@pytest.mark.slow
@pytest.mark.parametrize(
    "drawn",
    [
        lambda: pf.frequency_response(MANY).plot(deg=True),
        lambda: frequency_response(MANY[:2]).pole_zero_map.plot(),
        lambda: frequency_response(
            [pf.PhyFilter([8.0 + 4.0 * k]).sampled(0.002) for k in range(3)]
        ).pole_zero_map.plot(),
        lambda: pf.trade_off(
            MANY[0].faster,
            np.geomspace(0.1, 10.0, 9),
            cost=lambda f: pf.error_bound(f, pf.Bounded({1: 8.0}, noise=0.01)),
        ).plot(),
        lambda: pf.trade_off(lambda margin: margin**2, [0.3, 0.5], label="Modulus margin").plot(),
        lambda: pf.error_bound(pf.lowpass(2, 20.0, type=2), {2: 8.0}).plot(),
        lambda: analysis_plot(
            [pf.frequency_response(MANY[3]).curve()], T + 1.0, {"inner loop": [T + 1.0]}, []
        ),
        lambda: budget_curves(
            {f"part {k}": 1.0 / (T + 0.1 + k) for k in range(9)}, T + 1.0, label="Error [N]"
        ),
        lambda: log_plot(
            T, WAVE, {f"g {k}": WAVE * k for k in range(9)}, channels=["v"], unit="m/s", force_unit="N"
        ),
        lambda: missed_plot(
            T,
            WAVE,
            np.ones(1),
            {"label": WAVE, "f_theta": -WAVE},
            (T + 1.0, T + 1.0, T + 2.0),
            channels=["v"],
        ),
        lambda: learning_plot(
            [(k, 0, i, 1.0 / (k + i)) for k in range(1, 9) for i in range(1, 5)],
            [response.curve() for response in [pf.frequency_response(MANY[3])]],
        ),
    ],
)
def test_pictures_of_the_library(drawn) -> None:
    assert not faults(drawn().figure)


def test_words_of_the_code_become_mathematics() -> None:
    assert typeset("wind: f_hat - f_theta") == "wind: $\\hat f$ - $f_\\theta$"
    assert typeset("m/s^2, |e|, a0 = 3") == "m/s$^2$, $|e|$, $a_0$ = 3"
    assert typeset("half_hat") == "half_hat"
