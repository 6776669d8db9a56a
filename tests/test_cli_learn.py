"""``phyfilter-ctl learn``: table, JSON, picture, the saved filter, stopping, and how it says what is wrong."""

from __future__ import annotations

import importlib
import json
import os
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from phyfilter_ctl import Loop, PhyFilter, Recording, filterfile, margins
from phyfilter_ctl.cli import flights as in_files
from phyfilter_ctl.cli import main
from phyfilter_ctl.design import learning
from phyfilter_ctl.learned import Network

DT = 0.01
# The label is made by the filter itself: what the descent leaves is rounding of the log's text and of the sums.
EXACT = 1e-6
TRUTH = PhyFilter([300.0, 25.0])


def flight(seed: int, *, n: int = 800, name: str = "log", noise: float = 0.0) -> Recording:
    """x a random walk, f_theta and g of their own; f is what the true filter makes of them, and noise."""
    rng = np.random.default_rng(seed)
    x = DT * np.cumsum(rng.standard_normal((n, 2)), axis=0)
    g, f_theta = rng.standard_normal((2, n, 2))
    label = TRUTH.sampled(DT).run(x, g, f_theta, 1.5) + noise * rng.standard_normal((n, 2))
    return Recording.from_arrays(
        x=x, dt=DT, g=g, f_theta=f_theta, label=label, inertia=1.5, channels=["px", "py"], name=name
    )


@pytest.fixture
def logs(tmp_path, monkeypatch) -> Path:
    """Two flights to learn from and one held out, in the working folder."""
    monkeypatch.chdir(tmp_path)
    for seed, name in enumerate(("one", "two", "held")):
        flight(seed, noise=0.05).to_csv(f"{name}.csv")
    return tmp_path


def test_known_filter_comes_back_through_the_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    flight(0).to_csv("log.csv")
    options = ["--x", "px,py", "--order", "2", "--form", "lowpass", "--out", "filter.toml"]
    assert main(["learn", "log.csv", *options]) == 0
    shown = capsys.readouterr()
    assert "order 2, low-pass" in shown.out
    assert shown.err == "wrote filter.toml\n"
    found = filterfile.load("filter.toml")
    np.testing.assert_allclose(found.filter.a, TRUTH.a, rtol=EXACT)
    assert (found.dt, found.sampling.method, found.sampling.g) == (DT, "exact", "hold")
    assert found.sampling.names == ("px", "py")
    # One row a sample in the log, but the same in every one.
    np.testing.assert_array_equal(found.sampling.inertia, [1.5, 1.5])
    # The file is one that the next command takes.
    assert main(["design", "filter.toml"]) == 0
    assert "every 0.01 s, exact" in capsys.readouterr().out


@pytest.mark.slow
def test_figures_are_those_of_learn(logs, capsys):
    arguments = ["one.csv", "two.csv", "--held-out", "held.csv", "--x", "px,py", "--order", "2", "1"]
    assert main(["learn", *arguments, "--json", "-"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert [(row["order"], row["form"]) for row in figures["filters"]] == [
        (1, "lowpass"),
        (1, "general"),
        (2, "lowpass"),
        (2, "general"),
    ]
    training = [Recording.from_csv(f"{name}.csv", x=["px", "py"]) for name in ("one", "two")]
    held = Recording.from_csv("held.csv", x=["px", "py"])
    expected = learning.learn(
        training, 2, held_out=held, search=learning.Search(cross_validate=True)
    )  # as the command, for two files
    row = figures["filters"][2]
    assert row["a"] == expected.filter.a.tolist()
    assert row["rmse"] == expected.rmse
    assert row["wiener"]["ratio"] == expected.wiener_ratio
    # The RMSE by running the filter, by a route that shares nothing with learning.
    f_hat = PhyFilter(row["a"], row["b"]).sampled(DT).run(held.x, held.g, held.f_theta, held.inertia)
    assert row["held_out_rmse"] == pytest.approx(np.sqrt(np.mean((f_hat - held.label)[1:] ** 2)), rel=EXACT)
    gamma = (held.label - held.f_theta)[1:]
    assert figures["f_theta"]["held_out_rmse"] == pytest.approx(np.sqrt(np.mean(gamma**2)), rel=EXACT)
    # The truth is of order 2 in the low-pass form: no more coefficients are chosen.
    assert figures["best"] == 2


def test_a_choice_of_the_general_form_alone_leaves_the_low_pass_form_out(logs, capsys):
    """And a gain of 1, however it is written, is none."""
    arguments = ["learn", "one.csv", "--x", "px,py", "--order", "1", "--starts", "0", "--json", "-"]
    for gain, forms in {"2": ["general"], "1.0": ["lowpass", "general"]}.items():
        assert main([*arguments, "--dc-gain", gain]) == 0
        assert [row["form"] for row in json.loads(capsys.readouterr().out)["filters"]] == forms


FOLDER = ["learn", "day", "--held-out", "held.csv", "--x", "px,py"]
FOLDER += ["--order", "1", "--form", "lowpass", "--starts", "0"]


@pytest.fixture
def folder(logs) -> Path:
    """Two flights in a folder, one of them as Parquet."""
    pytest.importorskip("pyarrow", reason="the extra logs (pyarrow) is not installed")
    from pyarrow import csv, parquet

    (logs / "day" / "noon").mkdir(parents=True)
    (logs / "one.csv").rename(logs / "day" / "one.csv")
    table = csv.read_csv(logs / "two.csv")
    named = table.rename_columns(["t [s]", *table.column_names[1:]])
    parquet.write_table(named, logs / "day" / "noon" / "two.parquet")
    return logs


def test_folders_stay_in_files_and_bad_flights_are_left_out_on_request(folder, monkeypatch, capsys):
    assert main([*FOLDER, "--json", "-"]) == 0
    expected = json.loads(capsys.readouterr().out)
    assert (expected["logs"], expected["skipped"]) == (["two", "one"], {})
    broken = folder / "day" / "broken.csv"
    broken.write_text("t,px,py\n0,1,2\n0.01,oops,2\n")
    assert main(FOLDER) == 2
    assert "'oops'" in capsys.readouterr().err
    # Nothing is kept in memory: learn is given paths.
    monkeypatch.setattr(in_files, "_AT_HAND", 0)
    given, learn = [], learning.learn
    monkeypatch.setattr(
        learning, "learn", lambda logs, *rest, **options: given.append(logs) or learn(logs, *rest, **options)
    )
    assert main([*FOLDER, "--skip-bad", "--workers", "1", "--json", "found.json"]) == 0
    shown = capsys.readouterr().out
    assert f"note: left out: {Path('day', 'broken.csv')}: line 3" in shown
    found = json.loads((folder / "found.json").read_text())
    assert all(isinstance(log, Path) for logs in given for log in logs)
    assert list(found["skipped"]) == [str(Path("day", "broken.csv"))]
    same_figures(expected, found)


def same_figures(expected, found):
    for key in ("logs", "samples", "channels", "best"):
        assert found[key] == expected[key]
    assert found["f_theta"] == pytest.approx(expected["f_theta"], rel=EXACT)
    for one, other in zip(expected["filters"], found["filters"], strict=True):
        for key in ("a", "rmse", "held_out_rmse"):
            assert other[key] == pytest.approx(one[key], rel=EXACT)


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_a_cluster_reads_the_folder(folder, capsys):
    pytest.importorskip("distributed", reason="the extra cluster (dask[distributed]) is not installed")
    distributed = importlib.import_module("distributed")
    assert main([*FOLDER, "--json", "-"]) == 0
    expected = json.loads(capsys.readouterr().out)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, protocol="tcp://", dashboard_address=None
    ) as local:
        assert main([*FOLDER, "--scheduler", local.scheduler_address, "--json", "-"]) == 0
    same_figures(expected, json.loads(capsys.readouterr().out))


@pytest.mark.slow
def test_text_has_every_figure_and_marks_the_best(logs, capsys):
    assert main(["learn", "one.csv", "--x", "px,py", "--order", "1", "2", "--json", "figures.json"]) == 0
    shown = capsys.readouterr().out
    figures = json.loads(Path("figures.json").read_text())
    for k, row in enumerate(figures["filters"]):
        form = "low-pass" if row["form"] == "lowpass" else "general"
        (line,) = [line for line in shown.splitlines() if line.startswith(f"order {row['order']}, {form}")]
        assert f"{row['rmse']:.4g}" in line
        assert f"{row['wiener']['ratio']:.3f}" in line
        assert row["status"] in line
        assert ("<- best" in line) == (k == figures["best"])
    # Without held-out flights the held-out blocks decide: order 1 is worse, no order 2 needs more coefficients.
    assert figures["filters"][figures["best"]]["order"] == 2
    assert figures["filters"][figures["best"]]["form"] == "lowpass"
    assert "within two standard errors (few flights)" in figures["reason"]
    assert figures["reason"] in shown
    # 95 % intervals in the text and in the figures.
    interval = figures["filters"][figures["best"]]["intervals"]["rmse"]
    assert f"RMSE {interval['low']:.4g} to {interval['high']:.4g}; F(0) = 1 by construction" in shown


def test_what_is_wrong_with_a_label_is_printed_and_in_the_figures(logs, capsys):
    t = DT * np.arange(800)[:, None] * [1.0, 2.0]
    g = np.full_like(t, -9.81)
    x = np.sin(t) * [1.0, 0.5] - 9.81 * DT * np.arange(800)[:, None]
    log = Recording.from_arrays(x=x, dt=DT, g=g, label=np.cos(t) + g, channels=["px", "py"])
    log.to_csv("holds_g.csv")
    arguments = ["--x", "px,py", "--order", "1", "--form", "lowpass", "--json", "figures.json"]
    assert main(["learn", "holds_g.csv", *arguments]) == 0
    shown = capsys.readouterr()
    assert "note: the label of px differs from M x' - g by g" in shown.out
    assert shown.err == "wrote figures.json\n"
    assert len(json.loads(Path("figures.json").read_text())["notes"]) == 2
    assert main(["learn", "one.csv", *arguments, "--g", "none"]) == 0
    assert "note: no g: M x' is taken as f" in capsys.readouterr().out


@pytest.mark.slow
def test_structure_is_what_learn_is_asked_for(logs, capsys):
    options = [
        "--type",
        "2",
        "--zeros-at",
        "3.0",
        "--pole-range",
        "1,100",
        "--damping",
        "0.4",
        "--delay",
        "0.004",
    ]
    arguments = ["one.csv", "--x", "px,py", "--order", "4", "--starts", "0", *options, "--label-offset"]
    assert main(["learn", *arguments, "--json", "-", "--out", "filter.toml"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["filters"]
    found = filterfile.load("filter.toml")
    assert row["form"] == "general"
    assert found.filter.type == 2
    assert abs(found.filter.error(3j)) < EXACT
    assert found.sampling.delay == 0.004
    assert np.all(-found.filter.poles().real >= 0.4 * np.abs(found.filter.poles()) * (1.0 - EXACT))


@pytest.mark.slow
def test_flights_are_left_out_one_by_one_and_axes_compared(logs, capsys):
    options = ["--x", "px,py", "--order", "1", "--form", "lowpass", "--starts", "0", "--json", "figures.json"]
    assert main(["learn", "one.csv", "two.csv", *options, "--compare-axes"]) == 0
    shown = capsys.readouterr().out
    (row,) = json.loads(Path("figures.json").read_text())["filters"]
    assert [score["flight"] for score in row["flights"]] == [0, 1]
    assert f"{row['flights'][1]['left_out_rmse']:.4g}" in shown
    assert "axes, RMSE on what was not learned from: shared" in shown


@pytest.mark.slow
def test_picture_is_written(logs):
    arguments = ["one.csv", "--x", "px,py", "--order", "1", "--form", "lowpass", "--picture", "costs.png"]
    assert main(["learn", *arguments]) == 0
    assert Path("costs.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_columns_by_name_and_without_times(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    log = flight(3)
    table = np.hstack([log.x[:, :1], log.label[:, :1], log.g[:, :1], log.f_theta[:, :1]])
    np.savetxt("bare.csv", table, delimiter=";", header="p;F;thrust;model", comments="")
    columns = ["--x", "p", "--label", "F", "--g", "thrust", "--f-theta", "model", "--inertia", "1.5"]
    arguments = ["bare.csv", *columns, "--dt", "0.01", "--delimiter", ";", "--order", "2", "--json", "-"]
    assert main(["learn", *arguments]) == 0
    row = json.loads(capsys.readouterr().out)["filters"][0]
    np.testing.assert_allclose(row["a"], TRUTH.a, rtol=EXACT)
    # Left out, the signals are missed: the label cannot be explained.
    without = [*columns[:4], "--g", "none", "--f-theta", "none"]
    arguments = ["bare.csv", *without, "--dt", "0.01", "--delimiter", ";", "--order", "2", "--json", "-"]
    assert main(["learn", *arguments]) == 0
    assert json.loads(capsys.readouterr().out)["filters"][0]["rmse"] > 1e3 * row["rmse"]


def test_first_ctrl_c_keeps_the_best_so_far(logs, monkeypatch, capsys):
    learn = learning.learn

    def interrupted(*arguments, search, **options):
        def report(event):
            if event.order == 2:
                os.kill(os.getpid(), signal.SIGINT)
            return search.callback(event)

        return learn(*arguments, search=replace(search, callback=report), **options)

    monkeypatch.setattr(learning, "learn", interrupted)
    before = signal.getsignal(signal.SIGINT)
    arguments = ["one.csv", "--x", "px,py", "--order", "1", "2", "3", "--form", "lowpass"]
    assert main(["learn", *arguments, "--out", "filter.toml", "--json", "figures.json"]) == 130
    assert signal.getsignal(signal.SIGINT) is before
    figures = json.loads(Path("figures.json").read_text())
    assert [row["status"] for row in figures["filters"]] == ["converged", "cancelled"]
    assert figures["filters"][1]["wiener"] is None
    assert filterfile.load("filter.toml").filter.order == 1
    assert "cancelled" in capsys.readouterr().out


def test_second_ctrl_c_stops_at_once(logs, monkeypatch, capsys):
    def stubborn(*arguments, **options):
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)
        raise AssertionError("went on")

    monkeypatch.setattr(learning, "learn", stubborn)
    assert main(["learn", "one.csv", "--x", "px,py", "--out", "filter.toml"]) == 130
    assert capsys.readouterr().err == "phyfilter-ctl: stopped\n"
    assert not Path("filter.toml").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["absent.csv"], "absent.csv: No such file"),
        (["one.csv"], "no column 'vx' (x)"),
        (["one.csv", "--x", "px,py", "--label", "none"], "no label"),
        (["one.csv", "--x", "px,py", "--label", "label_px"], "expected 2 columns"),
        (["one.csv", "--x", "px,,py"], "--x: expected names"),
        (["one.csv", "--x", "px,py", "--order", "0"], "--order: expected 1 to 12, got 0"),
        (["one.csv", "--x", "px,py", "--order", "20"], "--order: expected 1 to 12, got 20"),
        (["one.csv", "--x", "px,py", "--order", "two"], "--order"),
        (["one.csv", "--x", "px,py", "--form", "bandpass"], "--form"),
        (["one.csv", "--x", "px,py", "--channels", "pz"], "no channel 'pz'"),
        (["one.csv", "--x", "px,py", "--inertia", "1,2,3"], "inertia"),
        (["one.csv", "--x", "px,py", "--seed", "-1"], "--seed"),
        (["one.csv", "--x", "px,py", "--zeros-at", "a,b"], "--zeros-at: expected numbers"),
        (["one.csv", "--x", "px,py", "--type", "2"], "need order 2 at least"),
        (["one.csv", "--x", "px,py", "--time", "t", "--dt", "0.01"], "--time and --dt"),
        (["one.csv", "--x", "px,py", "--held-out", "one.csv"], "given twice"),
        (["one.csv", "--x", "px,py", "--out", "filter.txt"], "ends in .toml"),
        (["one.csv", "--x", "px,py", "--picture", "absent/p.png"], "no folder"),
        (["short.csv", "--x", "px,py", "--order", "12"], "samples of f"),
        (["still.csv", "--x", "px,py"], "constant"),
        (["nan.csv", "--x", "px,py"], "line 3"),
        ([], "LOG.csv"),
    ],
)
def test_bad_input_is_one_line_and_status_2(arguments, message, logs, capsys):
    flight(4, n=8).to_csv("short.csv")
    still = np.zeros((50, 2))
    Recording.from_arrays(x=still, dt=DT, label=still, channels=["px", "py"]).to_csv("still.csv")
    Path("nan.csv").write_text("t,px,py,label_px,label_py\n0,1,2,3,4\n0.01,nan,2,3,4\n")
    before = sorted(logs.iterdir())
    try:
        status = main(["learn", *arguments])
    except SystemExit as stop:  # found by argparse itself
        status = stop.code
    shown = capsys.readouterr()
    assert status == 2
    assert message in shown.err
    assert shown.err.count("\n") == 1
    assert shown.out == ""
    assert sorted(logs.iterdir()) == before


@pytest.mark.release
def test_help_teaches_by_examples_that_run(logs, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["learn", "--help"])
    assert stop.value.code == 0
    shown = capsys.readouterr().out
    lines = [line.strip() for line in shown.splitlines() if line.startswith("  phyfilter-ctl learn")]
    examples = [line.split("   ")[0].split()[1:] for line in lines]
    assert len(examples) == 8
    one, held = (flight(seed, n=300, noise=0.05) for seed in (5, 6))
    for path, log in (("flight.csv", one), ("slow_1.csv", one), ("fast_1.csv", held)):
        table = np.hstack(
            [log.times[:, None], log.x, log.x[:, :1], log.label, log.label[:, :1], log.g, log.f_theta]
        )
        header = "t,vx,vy,vz,ax,ay,az,ux,uy,mx,my"
        table = np.hstack([table, log.x, log.label])
        np.savetxt(path, table, delimiter=",", header=header + ",px,py,fx,fy", comments="")
    for folder in ("day_1", "day_2"):
        Path(folder).mkdir()
        Path(folder, "flight.csv").write_bytes(Path("flight.csv").read_bytes())
    model = Network((3,), max_iterations=5).fit(one.x[:, [0, 1, 1]], one.x[:, [0, 1, 1]]).model
    model.save("network.npz")
    for words in examples:
        words = [word.replace("*", "1").replace(".onnx", ".npz") for word in words]
        assert main(words) == 0, words
    capsys.readouterr()
    assert main(["design", "filter.toml"]) == 0


def drone(*, scale: float = 1.0, with_g: bool = True) -> str:
    """A velocity in wind as CSV text: x' = g + f, g of gravity and thrust; times in units of ``scale`` s."""
    t = DT * np.arange(3000)
    f = np.stack([np.sin(1.3 * t), np.cos(0.7 * t)], axis=1)
    g = np.stack([3.0 * np.sin(2.0 * t), 4.0 * np.sin(1.1 * t) - 9.81 + 9.81], axis=1)
    rng = np.random.default_rng(0)
    x = np.cumsum(DT * (f + g), axis=0) + 2e-3 * rng.standard_normal(f.shape)
    head, columns = "t,px,py,label_px,label_py", [t / scale + 0.25, x, f]
    if with_g:
        head, columns = head + ",g_px,g_py", [*columns, g]
    rows = np.column_stack(columns).tolist()
    return "\n".join([head, *(",".join(f"{v!r}" for v in row) for row in rows)]) + "\n"


def test_a_column_of_microseconds_is_refused_until_its_unit_is_given(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("us.csv").write_text(drone(scale=1e-6))
    arguments = [
        "learn",
        "us.csv",
        "--x",
        "px,py",
        "--order",
        "1",
        "--form",
        "lowpass",
        "--out",
        "filter.toml",
    ]
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert "the time steps are 10000 s, expected 10 us to 1 s" in said
    assert "0.01 s if it counts us" in said
    assert not Path("filter.toml").exists()
    assert main([*arguments, "--time-unit", "us"]) == 0
    assert filterfile.load("filter.toml").dt == DT
    assert "note: us:" not in capsys.readouterr().out


def test_a_flight_without_its_g_is_said_and_saves_nothing(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("no_g.csv").write_text(drone(with_g=False))
    arguments = [
        "learn",
        "no_g.csv",
        "--x",
        "px,py",
        "--order",
        "1",
        "--form",
        "lowpass",
        "--out",
        "filter.toml",
    ]
    assert main(arguments) == 2
    shown = capsys.readouterr()
    assert "there is no g, and M x' misses the label by" in shown.out
    assert "filter.toml: not written: no filter is better than none" in shown.err
    assert not Path("filter.toml").exists()
    Path("with_g.csv").write_text(drone())
    assert main([arguments[0], "with_g.csv", *arguments[2:]]) == 0
    assert "note:" not in capsys.readouterr().out


@pytest.mark.slow
def test_margin_is_kept_in_the_loop_and_its_price_is_said(logs, capsys):
    loop = ["--lag", "0.05", "--loop-delay", "0.01", "--kp", "10", "--kd", "6"]
    options = ["--x", "px,py", "--order", "1", "--form", "lowpass", "--json", "figures.json"]
    assert main(["learn", "one.csv", *options, "--margin", "0.5", *loop, "--out", "filter.toml"]) == 0
    assert "modulus margin binds" in capsys.readouterr().out
    (row,) = json.loads((logs / "figures.json").read_text())["filters"]
    margin = margins(filterfile.load("filter.toml"), Loop(10.0, 6.0, actuator=0.05, delay=0.01))
    assert margin.modulus_margin >= 0.5
    assert row["loop"]["price"] > 0.0
    assert main(["learn", "one.csv", *options, "--margin", "0.95", *loop, "--out", "none.toml"]) != 0
    assert "lower the outer gains" in capsys.readouterr().err
    assert main(["learn", "one.csv", *options, *loop]) != 0
    assert "--margin" in capsys.readouterr().err
