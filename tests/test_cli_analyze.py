"""analyze: the page agrees with the library, in text, JSON and picture."""

import json
import re

import control as ct
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl import Bounded, Loop, error_bound, margins
from phyfilter_ctl.cli import main


@pytest.fixture
def continuous(tmp_path):
    path = tmp_path / "filter.toml"
    pf.save(path, pf.lowpass(2, 20.0))
    return str(path)


@pytest.fixture
def sampled(tmp_path):
    path = tmp_path / "sampled.toml"
    pf.save(path, pf.lowpass(2, 20.0).sampled(0.01))
    return str(path)


@pytest.mark.slow
def test_page_of_a_continuous_filter(continuous, tmp_path, capsys):
    picture = tmp_path / "page.png"
    arguments = [
        "--slope",
        "3",
        "--inertia-error",
        "0.1",
        "--rate",
        "2",
        "--lag",
        "0.05",
        "--kp",
        "10",
        "--kd",
        "6",
    ]
    assert main(["analyze", continuous, *arguments, "--json", "-", "--picture", str(picture)]) == 0
    figures = json.loads(capsys.readouterr().out)
    f = pf.lowpass(2, 20.0)
    expected = error_bound(f, Bounded({1: 3.0}, inertia_error=0.1, rate=2.0))
    assert figures["bound"]["bound"] == expected.bound
    assert figures["bound"]["inertia"] == expected.inertia
    lag = ct.tf([1.0], [0.05, 1.0])
    assert figures["inner_loop"]["modulus_margin"] == margins(f, Loop(actuator=lag)).modulus_margin
    assert figures["complete_loop"]["delay_margin"] == margins(f, Loop(10.0, 6.0, actuator=lag)).delay_margin
    assert picture.stat().st_size > 10_000


def test_page_says_whether_the_inertia_may_move(continuous, capsys):
    assert main(["analyze", continuous, "--inertia-ratio", "0.1", "20"]) == 0
    lines = capsys.readouterr().out.splitlines()
    constant, moving = (
        next(line for line in lines if words in line) for words in ("constant M", "any speed")
    )
    assert "proven for M_hat/M from 0.1 to 20; stable for every constant M" in constant
    assert "refuted" in moving
    assert "times as large after each period" in moving
    assert main(["analyze", continuous, "--inertia-ratio", "0.5", "2", "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)["moving_inertia"]["M of any speed"]
    assert (found["status"], found["method"]) == ("proven", "common quadratic")


def test_page_of_a_sampled_filter(sampled, capsys):
    assert (
        main(
            ["analyze", sampled, "--residual", "0=4", "1=12", "--noise", "0.01", "--noise-deviation", "0.003"]
        )
        == 0
    )
    text = capsys.readouterr().out
    for words in (
        "between samples",
        "derivatives 0 and 1 of gamma together; attained to",
        "noise of f_hat",
        "stable M_hat/M",
    ):
        assert words in text
    assert "as long as        g is held between the samples" in text
    arguments = ["--slope", "4", "--rate", "2", "--implementation", "g.1=48", "jitter=1e-4", "x_step=0.001"]
    assert main(["analyze", sampled, *arguments]) == 0
    text = capsys.readouterr().out
    assert "g between samples 0.24" in text
    assert "holds for         |g'| up to 48 between the samples" in text
    assert "as long as        f_theta is linear between the samples" in text
    assert main(["analyze", sampled, *arguments, "--json", "-"]) == 0
    figures = json.loads(capsys.readouterr().out)["bound"]
    expected = error_bound(
        pf.load(sampled),
        Bounded({1: 4.0}, rate=2.0, implementation=pf.Implementation(g={1: 48.0}, jitter=1e-4, x_step=0.001)),
    )
    assert figures["implementation"] == expected.implementation
    assert figures["covered"] == list(expected.covered)
    assert figures["assumptions"] == list(expected.assumptions)


def test_page_of_a_saturated_loop(sampled, capsys):
    loop = ["--kp", "10", "--kd", "6", "--delay", "0.01"]
    assert main(["analyze", sampled, "--slope", "3", "--residual", "2=9", *loop, "--json", "-"]) == 0
    figures = json.loads(capsys.readouterr().out)
    f = pf.lowpass(2, 20.0).sampled(0.01)
    tube = pf.tracking_error(f, pf.Loop(10.0, 6.0, delay=0.01), {1: 3.0})
    assert figures["tracking"]["radius"] == tube.radius
    told, untold = (
        pf.saturation_margin(f, pf.Loop(10.0, 6.0, delay=0.01), g=g).command_excess
        for g in ("saturated", "commanded")
    )
    assert figures["saturated_loop"]["commanded"]["command_excess"] == untold
    assert main(["analyze", sampled, "--slope", "3", *loop]) == 0
    page = capsys.readouterr().out
    assert f"{told:.4g} times its limit if told what acts, {untold:.4g} if the command" in page
    assert f"{tube.radius:.4g} at most" in page
    assert (
        main(["analyze", sampled, "--slope", "3", "--kp", "1000", "--kd", "1"]) == 0
    )  # unstable: nothing to promise
    page = capsys.readouterr().out
    assert page.startswith("Unstable with the outer gains: ")
    assert "Stable. Tolerates" not in page
    assert "Error at most" not in page
    assert "largest error" not in page
    assert "position error" not in page


def test_data_from_a_flight(sampled, tmp_path, capsys):
    rng = np.random.default_rng(1)
    gamma = np.zeros((6001, 1))
    for k in range(6000):
        gamma[k + 1] = 0.98 * gamma[k] + 0.2 * rng.standard_normal()
    x = np.cumsum(0.01 * gamma, axis=0) + 0.002 * rng.standard_normal((6001, 1))
    log = tmp_path / "flight.csv"
    pf.Recording.from_arrays(x=x, dt=0.01, channels=["vx"]).to_csv(log)
    assert main(["analyze", sampled, "--log", str(log), "--x", "vx", "--json", "-"]) == 0
    figures = json.loads(capsys.readouterr().out)
    value, low, high = figures["statistics"]["noise"].values()
    assert low < value < high
    assert value == pytest.approx(0.002, rel=0.1)
    assert figures["bound"]["derivative"] == 1
    # A deviation is no bound: it is stated by itself, as that of f_hat.
    assert figures["bound"]["noise"] == 0.0
    spread = pf.error_variance(pf.load(sampled), pf.Gaussian(noise=value)).noise ** 0.5
    assert figures["noise_deviation"] == pytest.approx(spread, rel=1e-12)
    assert f"Noise of f_hat {spread:.4g} (1 sigma)" in figures["headline"]


def test_the_headline_is_the_least_of_all_loops(tmp_path, capsys):
    """Delay and masses that both loops tolerate, rounded to the safe side; the command line prints the library's."""
    path, filter = tmp_path / "slow.toml", pf.lowpass(1, 12.0)
    pf.save(path, filter)
    assert main(["analyze", str(path), "--lag", "0.1", "--delay", "0.02", "--kp", "10", "--kd", "6"]) == 0
    headline = capsys.readouterr().out.splitlines()[0]
    loop = Loop(10.0, 6.0, actuator=0.1, delay=0.02)
    assert headline == pf.analyze(filter, loop).headline
    inner, complete = margins(filter, loop.inner), margins(filter, loop)
    assert complete.delay_margin < inner.delay_margin  # that of the inner loop alone would promise too much
    delay, least, most = (float(text) for text in re.findall(r"\d+\.?\d*", headline))
    exact = min(each.delay_margin for each in (inner, complete))
    assert 0.99 * exact < 1e-3 * delay <= exact
    ends = [
        max(each.min_ratio for each in (inner, complete)),
        min(each.max_ratio for each in (inner, complete)),
    ]
    assert 1.0 / ends[1] <= least < 1.01 / ends[1]
    assert 0.99 / ends[0] < most <= 1.0 / ends[0]


def test_inertia_of_the_file_counts_in_every_line(tmp_path):
    """Twelve times the inertia, twelve times the noise of x in f_hat, as a bound and as a deviation."""
    filter = pf.lowpass(2, 20.0)
    settings = {"disturbance": pf.Bounded({1: 3.0}, noise=0.01), "noise_deviation": 0.003}
    path = tmp_path / "heavy.toml"
    pf.save(path, filter.sampled(0.01, inertia=12.0, units={"f": "N"}))
    one, own = pf.analyze(filter.sampled(0.01), **settings), pf.analyze(pf.load(path), **settings)
    told = pf.analyze(filter.sampled(0.01), inertia=12.0, **settings)
    assert own.bound.noise == told.bound.noise == pytest.approx(12.0 * one.bound.noise, rel=1e-12)
    assert own.noise_deviation == told.noise_deviation == pytest.approx(12.0 * one.noise_deviation, rel=1e-12)
    assert "Error at most" in own.headline
    assert " N while" in own.headline


def test_inertia_noted_in_the_file_of_a_continuous_filter_counts(tmp_path, capsys):
    filter, path = pf.lowpass(2, 20.0), tmp_path / "noted.toml"
    pf.save(path, filter, channels=["v"], units={"f": "N"}, inertia=5.0)
    assert main(["analyze", str(path), "--slope", "3", "--noise", "0.01", "--json", "-"]) == 0
    figures = json.loads(capsys.readouterr().out)
    one = pf.error_bound(filter, pf.Bounded({1: 3.0}, noise=0.01))
    assert figures["bound"]["noise"] == pytest.approx(5.0 * one.noise, rel=1e-12)
    assert " N while" in figures["headline"]
    two = pf.stack([filter, pf.lowpass(1, 8.0)])
    pf.save(path, two, channels=["a", "b"], inertia=[2.0, 3.0])
    assert main(["analyze", str(path), "--slope", "3", "--noise", "0.01", "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)["channels"]
    for name, each, M in zip("ab", two, (2.0, 3.0), strict=True):
        noise = pf.error_bound(each, pf.Bounded({1: 3.0}, noise=0.01)).noise
        assert found[name]["bound"]["noise"] == pytest.approx(M * noise, rel=1e-12)


def test_a_filter_with_limits_has_a_page():
    filter = pf.lowpass(2, 20.0)
    limited = filter.sampled(0.01, limit=0.5, g_limit=(-2.0, 3.0), delay=0.01)
    found = pf.analyze(limited, pf.Loop(10.0, 6.0), {1: 3.0})
    assert found.tracking is None
    assert "taken for granted f_hat stays within its limit; g stays within its limits" in found.describe()
    late = pf.analyze(filter.sampled(0.01, delay=0.01), pf.Loop(10.0, 6.0), {1: 3.0})
    assert late.tracking is not None
    assert late.tracking.is_linear


def test_a_loop_that_diverges_promises_nothing():
    found = pf.analyze(pf.lowpass(2, 20.0).sampled(0.01), pf.Loop(1000.0, 1.0), {1: 3.0})
    assert found.inner_loop.is_stable
    assert not found.is_stable
    assert found.bound is None
    assert found.headline.startswith("Unstable")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--residual", "1"], "K=D"),
        (["--slope", "-1"], ">= 0"),
        (["--delay", "-1", "--lag", "0.1"], "delay"),
        (["--log", "nothing.csv"], "nothing.csv"),
        (["--picture", "page.txt"], "ends in"),
        (["--slope", "1", "--implementation", "g=3"], "g.K"),
        (["--slope", "1", "--implementation", "u.1=3"], "such as"),
        (["--slope", "1", "--implementation", "g.1=3"], "is for sampled filters"),
    ],
)
def test_wrong_options(continuous, arguments, message, capsys):
    assert main(["analyze", continuous, *arguments]) == 2
    assert message in capsys.readouterr().err


def test_g_of_the_loops(sampled, tmp_path, capsys):
    """The command line says what the library says, in figures, text and report."""
    report = tmp_path / "page.html"
    loop = ["--lag", "0.05", "--delay", "0.01", "--kp", "10", "--kd", "6", "--g", "applied"]
    assert main(["analyze", sampled, *loop, "--json", "-", "--report", str(report)]) == 0
    figures = json.loads(capsys.readouterr().out)
    f = pf.load(sampled)
    expected = margins(f, Loop(10.0, 6.0, actuator=0.05, delay=0.01, g="applied"))
    assert figures["g"] == "applied"
    assert figures["complete_loop"]["modulus_margin"] == expected.modulus_margin
    assert "what acts" in report.read_text()
    assert main(["analyze", sampled, *loop, "--inertia-ratio", "0.5", "2"]) == 2
    assert "leave ratios out" in capsys.readouterr().err
