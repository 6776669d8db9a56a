"""Files as they come, opened after a look at them: what is recognised, what is asked, what is said."""

from __future__ import annotations

import argparse
import base64
from pathlib import Path

import numpy as np
import pytest
from designer_messages import answered, message_of, refused

from phyfilter_ctl.app.handling import Session
from phyfilter_ctl.app.imports import free_memory
from phyfilter_ctl.cli import app as command

N = 60
T_US = 1_700_000_000_000_000 + 10_000 * np.arange(N)
V = np.sin(0.2 * np.arange(N))
A = 5.0 * np.cos(0.2 * np.arange(N))
PARSED = 1e-9  # relative: numbers are written with twelve digits


def tunnel(rows: int = N) -> str:
    """A wind tunnel's table: 28 columns, semicolons, decimal commas, microseconds, a column of text."""
    rng = np.random.default_rng(4)
    header = ["stamp", *(f"p{i} [Pa]" for i in range(23)), "u [mm/s]", "fx [N]", "mass [g]", "remark"]
    lines = [";".join(header)]
    for k in range(rows):
        cells = [f"{p:.3f}" for p in rng.standard_normal(23)]
        cells += [f"{1e3 * V[k]:.12g}", f"{A[k]:.12g}", "1500,0"]
        lines.append(";".join([str(T_US[k]), *(c.replace(".", ",") for c in cells), "ok"]))
    assert len(header) == 28
    return "\n".join(lines) + "\n"


def send(session: Session, name: str, text: str | bytes, *, piece: int = 3000) -> None:
    data = text.encode() if isinstance(text, str) else text
    for at in range(0, len(data), piece):
        part = base64.b64encode(data[at : at + piece]).decode()
        answered(session, "upload", name=name, size=len(data), at=at, data=part)


def opened(name: str, text: str | bytes) -> Session:
    session = Session()
    send(session, name, text)
    return session


def test_a_table_of_28_columns_is_shown_whole_and_opened_in_si():
    session = opened("tunnel 3.csv", tunnel())
    shown = answered(session, "preview")
    assert [c["key"] for c in shown["columns"]] == tunnel().split("\n")[0].split(";")
    assert shown["columns"][24]["first"][0] == "0"
    assert "," in shown["columns"][1]["first"][0]
    assert [c["key"] for c in shown["columns"] if not c["numeric"]] == ["remark"]
    said = " ".join(shown["messages"])
    assert "semicolons" in said
    assert "decimal commas" in said
    # Microseconds are recognised, said, and not taken in silence.
    time = shown["time"]
    assert (time["column"], time["unit"], time["recognised"]) == ("stamp", "us", True)
    assert "microseconds: 0.01 s" in time["said"]
    roles = {"x": ["u [mm/s]"], "label": ["fx [N]"], "inertia": ["mass [g]"]}
    assert refused(session, "import", time="stamp", **roles)["where"] == "time_unit"
    reply = answered(session, "import", time="stamp", time_unit="us", **roles)
    log = session.log
    assert log is not None
    assert (log.name, log.channels, log.unit) == ("tunnel 3", ("u",), "m/s")
    np.testing.assert_allclose(log.times, 0.01 * np.arange(N), rtol=PARSED)
    np.testing.assert_allclose(log.x[:, 0], V, rtol=PARSED, atol=PARSED)
    assert log.label is not None
    np.testing.assert_allclose(log.label[:, 0], A, rtol=PARSED)
    assert log.inertia is not None
    np.testing.assert_allclose(log.inertia, 1.5)
    assert any("mm/s was taken as 0.001 m/s" in text for text in reply["messages"])
    assert reply["log"]["unit_f"] == "N"


@pytest.mark.parametrize(
    ("name", "step", "unit", "recognised"),
    [
        ("t", 0.01, "s", False),
        ("t", 10, "ms", True),
        ("time", 2000, "us", True),
        ("time", 5_000_000, "ns", True),
        ("time_us", 2000, "us", False),
        ("t [ms]", 5, "ms", False),
    ],
)
def test_what_a_column_of_times_counts(name, step, unit, recognised):
    text = f"{name},vx,ax\n" + "".join(f"{step * k},{k % 3},{k % 2}\n" for k in range(30))
    time = answered(opened("a.csv", text), "preview")["time"]
    assert (time["unit"], time["recognised"]) == (unit, recognised)
    assert 1e-3 <= time["step"] <= 0.011


@pytest.mark.parametrize(
    ("header", "roles"),
    [
        ("t,speed,force_N", {"x": ["speed"]}),
        ("t,vx,vy,vz,ax,ay,az", {"x": ["vx", "vy", "vz"], "label": ["ax", "ay", "az"]}),
        (
            "t,q,label_q,g_q,f_theta_q",
            {"x": ["q"], "label": ["label_q"], "g": ["g_q"], "f_theta": ["f_theta_q"]},
        ),
        ("t,v [m/s],a [m/s^2],mass", {"x": ["v [m/s]"], "label": ["a [m/s^2]"], "inertia": ["mass"]}),
        ("t,a1,a2,a3,a4,a5", {"x": []}),
    ],
)
def test_roles_are_suggested_by_names(header, roles):
    rows = "".join(",".join([f"{0.1 * k:.1f}", *["1.5"] * header.count(",")]) + "\n" for k in range(5))
    found = answered(opened("a.csv", f"{header}\n{rows}"), "preview")["roles"]
    assert found == {"x": [], "label": [], "g": [], "f_theta": [], "inertia": []} | roles


def test_uneven_steps_are_said_and_resampled():
    times = np.cumsum(np.where(np.arange(200) % 3, 0.01, 0.013))
    text = "t;v\n" + "".join(f"{t:.4f};{2.0 * t:.6f}\n".replace(".", ",") for t in times)
    session = opened("a.csv", text)
    assert not answered(session, "preview")["time"]["even"]
    assert "differ" in " ".join(answered(session, "import", x=["v"])["messages"])
    session = opened("a.csv", text)
    reply = answered(session, "import", x=["v"], step=0.01)
    assert "Resampled from 200 samples to" in reply["messages"][0]
    log = session.log
    assert log is not None
    assert log.is_uniform
    np.testing.assert_allclose(log.x[:, 0], 2.0 * (log.times + times[0]), atol=2e-6)


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"x": []}, "choose the columns"),
        ({"x": ["p"], "label": ["fx [N]", "u [mm/s]"]}, "expected 1 columns"),
        ({"x": ["nothing"]}, "there is no column 'nothing'"),
        ({"x": ["remark"]}, "line 2, column 'remark': 'ok' is not a number"),
        ({"x": ["u [mm/s]"], "inertia": [1.0, 2.0]}, "expected 1, 1 or 1 of them, got 2"),
        ({"x": ["u [mm/s]", "p0 [Pa]"]}, "different units"),
        ({"x": ["u [mm/s]"], "unit_x": 3}, "expected text"),
        ({"x": ["u [mm/s]"], "step": 0}, "expected a number"),
    ],
)
def test_wrong_roles_are_said_and_nothing_is_opened(fields, said):
    session = opened("t.csv", tunnel(8))
    reply = refused(session, "import", **({"time": "stamp", "time_unit": "us"} | fields))
    assert said in reply["error"]
    assert "/" not in reply["error"].replace("mm/s", "")
    assert session.log is None
    assert answered(session, "preview")["columns"]  # and it may be tried again


def test_pieces_out_of_order_and_broken_files_are_refused():
    session = Session()
    assert "no file has arrived" in refused(session, "preview")["error"]
    piece = base64.b64encode(b"t,v\n").decode()
    assert "send the file again" in refused(session, "upload", name="a", size=9, at=4, data=piece)["error"]
    answered(session, "upload", name="a", size=9, at=0, data=piece)
    assert "no file has arrived" in refused(session, "preview")["error"]
    assert (
        "expected 9 bytes" in refused(session, "upload", name="a", size=9, at=4, data=piece[:4] * 2)["error"]
    )
    assert "base64" in refused(session, "upload", name="a", size=9, at=4, data="?")["error"]
    assert "GB are free" in refused(session, "upload", name="a", size=2**49, at=0, data=piece)["error"]
    send(session, "a.ulg", b"\x00\xff" * 40)
    error = refused(session, "preview")["error"]
    assert error.startswith("a.ulg") or error.startswith("ends in .ulg")
    assert "does not begin as a ulog log" in error


def test_a_log_beyond_the_memory_is_refused_in_words(monkeypatch):
    monkeypatch.setattr("phyfilter_ctl.app.imports.free_memory", lambda: 100.0)
    error = refused(opened("t.csv", tunnel(8)), "import", x=["u [mm/s]"], time="stamp", time_unit="us")[
        "error"
    ]
    assert "choose fewer columns, or cut the log" in error
    assert free_memory() > 1e6


def test_a_file_named_at_the_start_waits_to_be_asked_about(tmp_path):
    path = tmp_path / "tunnel.csv"
    path.write_text(tunnel(8))
    session = Session(waiting=path)
    assert answered(session, "hello")["waiting"] == "tunnel.csv"
    assert answered(session, "preview")["file"]["name"] == "tunnel.csv"
    session.close()
    assert path.exists()


@pytest.mark.slow
def test_noise_step_and_slope_of_a_log_with_known_ones():
    rng = np.random.default_rng(2)
    t = 0.01 * np.arange(4000)
    f = 3.0 * np.sin(1.5 * t)  # steepest 4.5
    x = -2.0 * np.cos(1.5 * t) + 0.004 * rng.standard_normal(len(t))
    text = "t,v,label_v\n" + "".join(f"{a:.2f},{b:.9f},{c:.9f}\n" for a, b, c in zip(t, x, f, strict=True))
    session = opened("a.csv", text)
    answered(session, "import", x=["v"], label=["label_v"])
    found = answered(session, "measured")
    assert found["dt"] == 0.01
    assert found["noise"] == pytest.approx(0.004, rel=0.1)
    assert found["slope"] == pytest.approx(4.5, rel=0.01)
    assert "4000 samples, 0 s to 39.99 s" in found["messages"][0]


@pytest.mark.slow
def test_the_example_says_that_it_is_simulated():
    session = Session()
    reply = answered(session, "example")
    assert "Simulated" in reply["log"]["name"]
    assert "not a recording" in reply["messages"][0]
    assert answered(session, "estimate", design=message_of([-20.0]))["rmse"] > 0.0


@pytest.mark.parametrize(
    ("column", "typed", "factor"), [("speed_kmh", "", 3.6), ("speed [km/h]", "", 3.6), ("speed", "km/h", 3.6)]
)
def test_the_command_and_the_dialog_convert_alike(
    column: str, typed: str, factor: float, tmp_path: Path
) -> None:
    path = tmp_path / "cart.csv"
    rows = [f"{0.01 * k:.2f},{factor * V[k]:.12g},{1e-3 * A[k]:.12g}" for k in range(N)]
    path.write_text("\n".join([f"t,{column},force", *rows]) + "\n")
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    options = ["--log", str(path), "--x", column, "--label", "force", "--unit-f", "kN"]
    log, said = command._log(parser.parse_args(options + (["--unit-x", typed] if typed else [])))
    session = Session()
    send(session, "cart.csv", path.read_text())
    units = {"unit_f": "kN"} | ({"unit_x": typed} if typed else {})
    reply = answered(session, "import", time="t", time_unit="s", x=[column], label=["force"], **units)
    assert said == reply["messages"]
    assert any("km/h was taken as 0.277778 m/s" in message for message in said)
    for each in (log, session.log):
        assert each is not None
        assert each.unit == "m/s"
        np.testing.assert_allclose(each.x[:, 0], V, atol=PARSED)
        np.testing.assert_allclose(each.label[:, 0], A, atol=PARSED)
