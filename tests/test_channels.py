"""Filters of their own for several channels: whatever is asked of all together is what each answers alone."""

from __future__ import annotations

import json
import re
import zipfile
from dataclasses import replace
from pathlib import Path

import control as ct
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl import PerChannel, PhyFilter, SampledPhyFilter
from phyfilter_ctl.analysis import FilterResponseList
from phyfilter_ctl.cli import main
from phyfilter_ctl.estimation.estimate import sampled_for
from phyfilter_ctl.filter import FilterBank, SampledBank

mpl.use("Agg")

DT = 0.01
FILTERS = [
    PhyFilter([20.0]),
    pf.lowpass(2, 8.0, family="butterworth"),
    PhyFilter.from_poles([-3 + 4j, -3 - 4j, -30.0], [750.0, 100.0, 7.0]),
]
BANK = pf.stack(FILTERS)
SAMPLED = BANK.sampled(DT)
OMEGA = np.geomspace(0.1, 300.0, 30)
# The same numbers through matrices of another size.
ROUNDING = 1e-12


def signals(seed: int = 0, count: int = 200) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [rng.standard_normal((count, 3)) for _ in range(3)]


def same(one: ct.LTI, part: ct.LTI, channel: int) -> None:
    """Channel by channel: entries of x, g and f_theta of one channel, and no others."""
    whole, alone = (ct.frequency_response(system, OMEGA).frdata for system in (one, part))
    for k in range(3):  # x, g, f_theta
        np.testing.assert_allclose(whole[channel, 3 * k + channel], alone[0, k], rtol=1e-8)
        others = [3 * k + j for j in range(3) if j != channel]
        np.testing.assert_allclose(whole[channel, others], 0.0, atol=ROUNDING)


# -- what they are ------------------------------------------------------------------------------------------------


def test_sampled_and_stacked_or_stacked_and_sampled() -> None:
    assert isinstance(BANK, FilterBank)
    assert isinstance(SAMPLED, SampledBank)
    assert pf.stack([F.sampled(DT) for F in FILTERS]) == SAMPLED == SampledPhyFilter(FILTERS, DT)
    assert pf.stack(BANK) == BANK
    assert eval(repr(BANK), {"stack": pf.stack, "PhyFilter": PhyFilter}) == BANK
    options = pf.Sampling(DT, "tustin", delay=0.004, limit=[1.0, 2.0, 3.0], g_limit=(0.0, [1.0, 2.0, 3.0]))
    parts = BANK.sampled(options).by_channel
    assert [part.filter for part in parts] == FILTERS
    assert [float(part.sampling.limit) for part in parts if part.sampling.limit is not None] == [
        1.0,
        2.0,
        3.0,
    ]
    assert [part.sampling.g_limit.tolist() for part in parts if part.sampling.g_limit is not None] == [
        [0.0, 1.0],
        [0.0, 2.0],
        [0.0, 3.0],
    ]
    alone = FILTERS[0].sampled(DT)
    assert alone.by_channel == (alone,)


def test_runs_as_its_channels() -> None:
    x, g, f_theta = signals()
    f_hat = SAMPLED.run(x, g, f_theta, 1.5)
    for i, part in enumerate(SAMPLED.by_channel):
        alone = part.run(x[:, i], g[:, i], f_theta[:, i], 1.5)
        np.testing.assert_allclose(f_hat[:, i], alone[:, 0], rtol=ROUNDING, atol=ROUNDING)


def test_as_systems_of_python_control() -> None:
    for i, part in enumerate(SAMPLED.by_channel):
        same(BANK.to_ss(), FILTERS[i].state_space(), i)
        same(SAMPLED.to_ss(), part.to_ss(), i)
        for block in (pf.phyfilter_block(BANK), BANK.to_ss()):
            same(block, pf.phyfilter_block(FILTERS[i], 1), i)
        tf, alone = SAMPLED.to_tf(), part.to_tf()
        np.testing.assert_allclose(tf[i, i](0.9), alone[0, 0](0.9), rtol=1e-8)
    assert BANK.to_ss().state_labels == pf.phyfilter_block(BANK).state_labels
    assert pf.sampled_block(SAMPLED).output_labels == ["f_hat[0]", "f_hat[1]", "f_hat[2]"]


def test_retuned_to_another_bank() -> None:
    slower = pf.stack([F.faster(0.5) for F in FILTERS])
    state = SAMPLED.start(np.zeros(3), f_hat0=[1.0, 2.0, 3.0])
    changed = SAMPLED.retune(state, slower)
    for i, part in enumerate(SAMPLED.by_channel):
        alone = part.retune(part.start([0.0], f_hat0=[i + 1.0]), slower[i])
        np.testing.assert_allclose(changed.w[i, : alone.w.shape[1]], alone.w[0], rtol=1e-9, atol=1e-12)


# -- analysis -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("system", [BANK, SAMPLED, SampledPhyFilter(FILTERS, DT)])
def test_analysis_answers_channel_by_channel(system: FilterBank | SampledPhyFilter) -> None:
    parts = list(system) if isinstance(system, FilterBank) else list(system.by_channel)
    slopes = [{1: 3.0}, {1: 1.0}, {0: 2.0}]
    met = [pf.Bounded(k, inertia_error=e, rate=2.0) for k, e in zip(slopes, (0.1, 0.2, 0.0), strict=True)]
    bounds = pf.error_bound(system, met)
    variances = pf.error_variance(system, pf.Gaussian(pf.gauss_markov(1.0, 0.5)), inertia=(1.0, 2.0, 3.0))
    lag = ct.tf(1, [0.02, 1])
    priors = pf.margins(system, pf.Loop(actuator=lag, delay=0.002))
    loops = pf.margins(system, [pf.Loop(kp, 4.0, actuator=lag) for kp in (1.0, 2.0, 3.0)])
    for found in (bounds, variances, priors, loops):
        assert isinstance(found, PerChannel)
        assert len(found) == 3
    for i, part in enumerate(parts):
        error = [0.1, 0.2, 0.0][i]
        assert (
            bounds[i].bound
            == pf.error_bound(part, pf.Bounded(slopes[i], inertia_error=error, rate=2.0)).bound
        )
        alone = pf.error_variance(part, pf.Gaussian(pf.gauss_markov(1.0, 0.5)), inertia=i + 1.0)
        assert variances[i].error == alone.error
        assert priors[i].modulus_margin == pf.margins(part, pf.Loop(actuator=lag, delay=0.002)).modulus_margin
        assert loops[i].delay_margin == pf.margins(part, pf.Loop(i + 1.0, 4.0, actuator=lag)).delay_margin
    assert list(bounds.to_dict()) == ["channel 0", "channel 1", "channel 2"]
    assert json.dumps(bounds.to_dict()["channel 1"]) == json.dumps(bounds[1].to_dict())
    assert repr(bounds).startswith("channel 0: ErrorBound(\n")
    assert "channel 2" in bounds._repr_html_()
    budget = pf.error_budget(bounds)
    assert budget.names == ("channel 0", "channel 1", "channel 2")
    np.testing.assert_array_equal(budget.total, [bound.bound for bound in bounds])


@pytest.mark.parametrize("system", [BANK, SAMPLED])
def test_responses_and_poles_in_one_picture(system: FilterBank | SampledPhyFilter) -> None:
    parts = list(system) if isinstance(system, FilterBank) else list(system.by_channel)
    responses, roots = pf.frequency_response(system, OMEGA), pf.frequency_response(system).pole_zero_map
    assert isinstance(responses, FilterResponseList)
    for i, part in enumerate(parts):
        alone = pf.frequency_response(part, OMEGA)
        np.testing.assert_array_equal(responses[i].F, alone.F)
        assert responses[i].label == roots[i].label == f"channel {i}: {alone.label}"
        np.testing.assert_array_equal(roots[i].poles, pf.frequency_response(part).pole_zero_map[0].poles)
    for plot in (responses.plot(), roots.plot()):
        texts = [text.get_text() for text in plot.legend.get_texts()]
        assert all(each.label in texts for each in responses)
        plt.close(plot.figure)


def test_several_designs_are_a_sequence_without_channels() -> None:
    bounds = pf.error_bound(FILTERS, {1: 1.0})
    assert [each.bound for each in bounds] == [pf.error_bound(F, {1: 1.0}).bound for F in FILTERS]
    assert [each.name for each in pf.frequency_response(FILTERS, OMEGA)] == ["", "", ""]


def test_bandwidth_that_every_channel_bears() -> None:
    lag = ct.tf(1, [0.1, 1])
    own = [
        pf.largest_bandwidth(
            lambda w, n=n: pf.lowpass(n, w),
            pf.Loop(10.0, 6.0, actuator=lag),
            modulus_margin=0.0,
            low=8.0,
            high=40.0,
        ).limit
        for n in (1, 2)
    ]
    both = pf.largest_bandwidth(
        lambda w: pf.stack([pf.lowpass(1, w), pf.lowpass(2, w)]),
        pf.Loop(10.0, 6.0, actuator=lag),
        modulus_margin=0.0,
        low=8.0,
        high=40.0,
    )
    assert both.limit == pytest.approx(min(own), rel=1e-6)


def test_lists_of_another_length_are_refused() -> None:
    with pytest.raises(
        ValueError, match="disturbance: expected one for all channels or one for each of the 3, got 2"
    ):
        pf.error_bound(BANK, [pf.Bounded({1: 1.0}, noise=noise) for noise in (0.1, 0.2)])


# -- handed over --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("system", [BANK, SAMPLED, pf.stack([FILTERS[0]])])
def test_through_a_file(system: FilterBank | SampledPhyFilter, tmp_path: Path) -> None:
    count = len(system if isinstance(system, FilterBank) else system.filters)
    names = [f"v{i}" for i in range(count)]
    if isinstance(system, SampledPhyFilter):
        system = replace(system, sampling=replace(system.sampling, channels=names))
        pf.save(tmp_path / "f.toml", system)
    else:
        pf.save(tmp_path / "f.toml", system, channels=names)
        assert pf.load(tmp_path / "f.toml", dt=0.01).sampling.names == tuple(names)
        with pytest.raises(ValueError, match=f"expected {count} names"):
            pf.save(tmp_path / "g.toml", system, channels=[*names, "w"])
    again = pf.load(tmp_path / "f.toml")
    assert again == system
    assert isinstance(again, FilterBank) == isinstance(system, FilterBank)
    with pytest.raises(TypeError, match="stack them first"):
        pf.save(tmp_path / "g.toml", FILTERS)  # type: ignore[arg-type]  # wrong on purpose


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """One with names and sampled, one without either."""
    monkeypatch.chdir(tmp_path)
    pf.save("named.toml", replace(SAMPLED, sampling=SAMPLED.sampling.told(channels=["vx", "vy", "vz"])))
    pf.save("bank.toml", BANK)
    return tmp_path


@pytest.mark.parametrize(
    ("command", "file"),
    [
        (["design"], "named.toml"),
        (["analyze", "--slope", "3"], "bank.toml"),
        pytest.param(
            ["analyze", "--slope", "3", "--kp", "2", "--lag", "0.01"], "named.toml", marks=pytest.mark.slow
        ),
        pytest.param(["design", "--at", "1,2"], "bank.toml", marks=pytest.mark.slow),
    ],
)
def test_commands_on_a_file_of_several(
    files: Path, command: list[str], file: str, capsys: pytest.CaptureFixture[str]
) -> None:
    def figures(file: str) -> dict:
        assert main([command[0], file, *command[1:], "--json", "-"]) == 0
        return json.loads(capsys.readouterr().out)

    several = figures(file)["channels"]
    named = file == "named.toml"
    names = ["vx", "vy", "vz"] if named else ["channel 0", "channel 1", "channel 2"]
    assert list(several) == names
    pf.save("one.toml", FILTERS[2].sampled(DT) if named else FILTERS[2])
    assert several[names[2]] == figures("one.toml")
    assert main([command[0], file, *command[1:]]) == 0
    shown = capsys.readouterr().out
    assert shown.count("F(s) = ") == 3
    # The verdict comes first where there is one.
    assert re.search(
        rf"\n\n{names[2]}:\n{'(Stable|Unstable).*' if command[0] == 'analyze' else ''}\n*F\(s\) = ", shown
    )


@pytest.mark.slow
@pytest.mark.parametrize("command", [["design"], ["analyze", "--slope", "3", "--kp", "2"]])
def test_pictures_of_a_file_of_several(
    files: Path, command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with mpl.rc_context({"svg.fonttype": "none"}):
        assert main([command[0], "bank.toml", *command[1:], "--picture", "page.svg", "--hz"]) == 0
    drawn = Path("page.svg").read_text()
    assert "channel 2: n = 3" in drawn
    assert "Frequency [Hz]" in drawn


def test_design_samples_a_bank_and_export_writes_it(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["design", "bank.toml", "--dt", str(DT), "--out", "sampled.toml"]) == 0
    assert pf.load("sampled.toml") == SAMPLED
    assert main(["design", "named.toml", "--dt", "0.02", "--out", "again.toml"]) == 0
    assert pf.load("again.toml") == BANK.sampled(0.02, channels=["vx", "vy", "vz"])
    assert main(["export", "bank.toml", "--dt", str(DT), "--c", "bank"]) == 0
    assert main(["export", "named.toml", "--c", "named"]) == 0
    for one, other in zip(*(sorted(Path(k).glob("*.[ch]")) for k in ("bank", "named")), strict=True):
        said = [line for line in other.read_text().splitlines() if "channels:" not in line]
        assert one.read_text().splitlines() == said
    assert main(["export", "bank.toml", "--fmu", "bank.fmu", "--platform", "none", "--fmi", "2.0"]) == 0
    with zipfile.ZipFile("bank.fmu") as archive:
        description = archive.read("modelDescription.xml").decode()
    assert 'name="f_hat[2]"' in description
    assert 'name="f_hat[3]"' not in description
    assert main(["export", "bank.toml", "--c", "other"]) == 2
    assert "give the sampling interval with --dt" in capsys.readouterr().err
    with pytest.raises(TypeError, match="expected a sampled one"):
        pf.export_c(BANK, files / "third")  # type: ignore[arg-type]  # wrong on purpose


def test_learned_per_channel(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    truth = pf.stack([PhyFilter([20.0]), PhyFilter([60.0])])
    x = DT * np.cumsum(np.random.default_rng(1).standard_normal((600, 2)), axis=0)
    label = truth.sampled(DT).run(x)
    log = pf.Recording.from_arrays(x=x, dt=DT, label=label, channels=["px", "py"])
    log.to_csv("log.csv")
    found = pf.stack([pf.learn(log, 1, channels=[name]).filter for name in log.channels])
    words = [
        "learn",
        "log.csv",
        "--x",
        "px,py",
        "--order",
        "1",
        "--form",
        "lowpass",
        "--per-channel",
        "--starts",
        "1",
    ]
    assert main([*words, "--out", "f.toml", "--picture", "f.png", "--json", "f.json"]) == 0
    shown = capsys.readouterr().out
    assert "px:\n" in shown
    assert "py:\n" in shown
    assert list(json.loads(Path("f.json").read_text())["channels"]) == ["px", "py"]
    learned = pf.load("f.toml")
    assert isinstance(learned, SampledPhyFilter)
    assert learned.sampling.names == ("px", "py")
    for i, F in enumerate(truth):
        np.testing.assert_allclose(found[i].a, F.a, rtol=1e-6)
        np.testing.assert_allclose(learned.filters[i].a, F.a, rtol=1e-6)
    assert main([*words, "--channels", "px"]) == 2
    assert "choose them by --x" in capsys.readouterr().err


def test_estimates_take_a_bank() -> None:
    log = pf.Recording.from_arrays(x=signals()[0], dt=DT)
    assert sampled_for(BANK, [log], "hold", "average") == SAMPLED


def test_the_designer_shows_one_filter() -> None:
    from phyfilter_ctl.app.designs import Design

    for several in (BANK, SAMPLED):
        with pytest.raises(ValueError, match="expected one filter, got 3"):
            Design().with_filter(several)
