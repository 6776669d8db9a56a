"""Channels, inertia, units and E are said once; every road that a filter takes has them."""

from __future__ import annotations

import base64
import io
import json
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import control as ct
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl import PhyFilter, SampledPhyFilter, filterfile
from phyfilter_ctl.app.handling import Session, handle
from phyfilter_ctl.app.sessions import read_session
from phyfilter_ctl.cli import main
from phyfilter_ctl.codegen import CompilerError, export_c, export_target, find_compiler
from phyfilter_ctl.fmi import Reference, describe, hand_over
from phyfilter_ctl.recording import Recording

F = PhyFilter([400.0, 40.0])
DT, N = 0.01, 60
UNITS = {"x": "m/s", "g": "N", "f": "N"}
NAMES = ["u", "v", "w"]
E = np.array([[1.0, 0.0], [0.3, 1.0], [0.0, -0.5]])
M = np.array([[2.0, 0.1, 0.0], [0.1, 1.5, 0.2], [0.0, 0.2, 3.0]])
# What is said of the signals: one at a time, and all of it together.
SAID: dict[str, dict[str, Any]] = {
    "scalar": {"channels": 3, "inertia": 1.8},
    "diagonal": {"inertia": [1.0, 2.0, 3.0], "units": UNITS},
    "full, named": {"channels": NAMES, "inertia": M, "units": UNITS},
    "with E": {"channels": NAMES, "inertia": M, "units": UNITS, "E": E},
    "E alone": {"E": E},
}
# Sums in another order, of f_hat of order 100: C, FMUs and CasADi against numpy.
ROUNDING = 1e-11
rng = np.random.default_rng(7)
X = 0.05 * np.cumsum(rng.standard_normal((N, 3)), axis=0)
G = rng.standard_normal((N, 3))


@pytest.fixture(params=SAID)
def sampled(request: pytest.FixtureRequest) -> SampledPhyFilter:
    return F.sampled(DT, **SAID[request.param])


@pytest.fixture
def compiler() -> None:
    try:
        find_compiler()
    except CompilerError as error:
        pytest.skip(str(error))


def by_hand(sampled: SampledPhyFilter) -> np.ndarray:
    """f_hat with everything given at the call to a filter that knows nothing of its signals."""
    inertia = sampled.sampling.inertia
    plain = replace(sampled.sampling, channels=None, inertia=None, units=None)
    assert not isinstance(inertia, str)
    return SampledPhyFilter(F, plain, E=sampled.E).run(X, G, inertia=inertia)


def saved(sampled: SampledPhyFilter, folder: Path) -> Path:
    path = folder / "filter.toml"
    filterfile.save(path, sampled)
    return path


def c_files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def asked(session: Session, op: str, **fields: object) -> dict[str, Any]:
    message = json.loads(json.dumps({"id": 1, "op": op, **fields}))
    reply: dict[str, Any] = json.loads(json.dumps(handle(session, message), allow_nan=False))
    assert reply["ok"], reply["error"]
    return reply


def on_page(session: Session, kind: str, design: dict[str, Any]) -> dict[str, bytes]:
    """Files of an export by the page."""
    reply = asked(session, "export", design=design, kind=kind)
    with zipfile.ZipFile(io.BytesIO(base64.b64decode(reply["base64"]))) as archive:
        return {Path(name).name: archive.read(name) for name in archive.namelist()}


# -- roads --------------------------------------------------------------------------------------------------------


def test_records_files_loops_and_live(sampled: SampledPhyFilter, tmp_path: Path) -> None:
    expected = by_hand(sampled)
    again = filterfile.load(saved(sampled, tmp_path))
    assert again == sampled
    assert isinstance(again, SampledPhyFilter)
    np.testing.assert_array_equal(again.run(X, G), expected)
    live, state = again.live(3), again.start(X[0])
    live.step(0.0, X[0])
    for k in range(1, N):
        state, f_hat = again.step(state, X[k], G[k - 1])
        np.testing.assert_allclose(f_hat, expected[k], atol=ROUNDING)
        np.testing.assert_allclose(live.step(DT * k, X[k], G[k - 1]), expected[k], atol=ROUNDING)


def test_recordings(sampled: SampledPhyFilter) -> None:
    names = sampled.sampling.names or NAMES
    log = Recording.from_arrays(x=X, g=G, dt=DT, channels=names, unit=sampled.sampling.units.get("x", ""))
    np.testing.assert_allclose(sampled.run(log), by_hand(sampled), atol=ROUNDING)
    of_log = replace(sampled.sampling, inertia=4.0)
    heavy = replace(log, inertia=4.0)
    np.testing.assert_allclose(sampled.run(heavy), by_hand(replace(sampled, sampling=of_log)), atol=ROUNDING)


def test_diagrams(sampled: SampledPhyFilter) -> None:
    expected, t = by_hand(sampled), DT * np.arange(N)
    inputs = np.hstack([X, G]).T
    block = pf.sampled_block(sampled, 3, f_theta=False)
    n_f = expected.shape[1]
    diagram = ct.interconnect(
        [block], inplist=block.input_labels, outlist=block.output_labels, inputs=6, outputs=n_f
    )
    held = pf.simulate(diagram, t, inputs, interpolation="hold").outputs.reshape(n_f, N)
    np.testing.assert_allclose(held.T, expected, atol=ROUNDING)
    linear = pf.phyfilter_block(sampled, 3, f_theta=False)
    found = ct.forced_response(linear, t, inputs, linear.rest_state(X[0], G[0])).outputs.reshape(n_f, N)
    np.testing.assert_allclose(found.T, expected, atol=ROUNDING)
    np.testing.assert_array_equal(sampled.to_ss(3).B[:, :6], linear.B)


def test_c_and_fmus(sampled: SampledPhyFilter, tmp_path: Path, compiler: None) -> None:
    expected = by_hand(sampled)
    signals = {f"{name}[{i}]": values[:, i] for name, values in (("x", X), ("g", G)) for i in range(3)}
    signals |= {f"f_theta[{i}]": np.zeros(N) for i in range(expected.shape[1])}
    outputs = {f"f_hat[{i}]": expected[:, i] for i in range(expected.shape[1])}
    record = Reference(DT * np.arange(N), signals, outputs)
    if not sampled.sampling.n_x and sampled.E is None:
        sampled = replace(sampled, sampling=sampled.sampling.told(channels=3))
    handed = hand_over(sampled, tmp_path / "road", record, name="road", formats=("C", "FMI 3.0"))
    assert not handed.message
    assert handed.worst is not None
    assert handed.worst < ROUNDING
    units = {entry.name: entry.unit for entry in describe(handed.exports["FMI 3.0"]).variables}
    for name, key in (("x", "x"), ("g", "g"), ("f_hat", "f")):
        assert (units[name] or "") == sampled.sampling.units.get(key, "")


def test_page_command_line_and_python_export_the_same_c(sampled: SampledPhyFilter, tmp_path: Path) -> None:
    path = saved(sampled, tmp_path)
    export_c(sampled, tmp_path / "python")
    assert main(["export", str(path), "--c", str(tmp_path / "command")]) == 0
    session = Session(filterfile.load(path))
    design = asked(session, "hello")["design"]
    expected = c_files(tmp_path / "python")
    assert c_files(tmp_path / "command") == expected
    opened = asked(Session(), "open", name="filter.toml", text=path.read_text())
    assert opened["messages"] == []
    for each in (design, opened["design"]):
        assert {
            name: data for name, data in on_page(session, "c", each).items() if name in expected
        } == expected


def test_page_saves_and_sessions_keep_it(sampled: SampledPhyFilter, tmp_path: Path) -> None:
    session = Session(sampled)
    design = asked(session, "hello")["design"]
    kept = {"format": "phyfilter-session", "version": 1, "design": design}
    design = read_session(json.dumps(kept))["design"]
    reply = asked(session, "save", design=design)
    path = tmp_path / "page.toml"
    path.write_bytes(base64.b64decode(reply["base64"]))
    assert filterfile.load(path) == sampled
    (said,) = reply["messages"]
    assert ("M_hat = 1;" in f"{said.removesuffix('.')};") == (sampled.sampling.inertia is None)
    assert all(f"{name} in {unit}" in said for name, unit in sampled.sampling.units.items())


# -- what goes before, and what is refused ------------------------------------------------------------------------


def test_an_inertia_noted_in_a_file_is_in_the_code(tmp_path: Path) -> None:
    plain = F.sampled(DT)
    filterfile.save(tmp_path / "f.toml", F, inertia=5.0)
    export_c(filterfile.load(tmp_path / "f.toml", dt=DT), tmp_path / "noted", channels=3)
    export_c(F.sampled(DT, inertia=5.0), tmp_path / "said", channels=3)
    export_c(plain, tmp_path / "given", channels=3, inertia=5.0)
    assert c_files(tmp_path / "noted") == c_files(tmp_path / "said") == c_files(tmp_path / "given")
    assert b"INERTIA 1" in c_files(tmp_path / "noted")["phyfilter.h"]


def test_an_inertia_that_is_an_input_survives(tmp_path: Path) -> None:
    moving = F.sampled(DT, channels=NAMES, inertia="full")
    assert filterfile.load(saved(moving, tmp_path)) == moving
    export_c(moving, tmp_path / "a")
    export_c(F.sampled(DT, channels=NAMES), tmp_path / "b", inertia="full")
    assert c_files(tmp_path / "a") == c_files(tmp_path / "b")
    assert pf.sampled_block(moving).input_labels[-1] == "M[2,2]"


def test_what_a_call_is_given_goes_before(tmp_path: Path) -> None:
    said = F.sampled(DT, channels=3, inertia=5.0)
    np.testing.assert_array_equal(said.run(X, inertia=2.0), F.sampled(DT).run(X, inertia=2.0))
    export_c(said, tmp_path / "a", inertia=2.0)
    export_c(F.sampled(DT, channels=3, inertia=2.0), tmp_path / "b")
    assert c_files(tmp_path / "a") == c_files(tmp_path / "b")


def test_contradictions_are_refused(tmp_path: Path) -> None:
    said = F.sampled(DT, channels=NAMES, inertia=5.0, units=UNITS)
    for told in ({"channels": ["a", "b", "c"]}, {"units": {"x": "mm/s"}}):
        with pytest.raises(ValueError, match="say it once"):
            pf.export_fmu(said, tmp_path / "f.fmu", ports=pf.fmi.FmuPorts(**told))
    for channels in (
        lambda: export_c(said, tmp_path / "c", channels=2),
        lambda: pf.export_fmu(said, tmp_path / "f.fmu", ports=pf.fmi.FmuPorts(channels=2)),
        lambda: pf.sampled_block(said, 2),
        lambda: pf.phyfilter_block(said, 2),
    ):
        with pytest.raises(ValueError, match=r"channels: the filter is for 3 \(u, v, w\), got 2"):
            channels()
    with pytest.raises(ValueError, match="per unit of mass"):
        export_target(F.sampled(DT, inertia=5.0), "px4", tmp_path / "px4")


def test_recordings_of_other_channels_are_refused() -> None:
    said = F.sampled(DT, channels=NAMES, units={"x": "m/s"})
    log = Recording.from_arrays(x=X, dt=DT, channels=["w", "u", "v"])
    with pytest.raises(ValueError, match="in another order"):
        said.run(log)
    with pytest.raises(ValueError, match="mm/s"):
        said.run(Recording.from_arrays(x=X, dt=DT, channels=NAMES, unit="mm/s"))
    with pytest.raises(TypeError, match="beside a recording"):
        said.run(log, G)


def test_the_inertia_of_the_open_log_is_exported(tmp_path: Path) -> None:
    log = Recording.from_arrays(x=X[:, :1], dt=DT, channels=["speed"], unit="m/s", inertia=12.0)
    session = Session(F.sampled(DT), log=log)
    design = asked(session, "hello")["design"]
    export_c(F.sampled(DT, channels=["speed"], inertia=12.0, units={"x": "m/s"}), tmp_path / "c")
    expected = c_files(tmp_path / "c")
    found = on_page(session, "c", design)
    assert {name: found[name] for name in expected} == expected
    own = Session(F.sampled(DT, inertia=3.0), log=log)
    reply = asked(own, "save", design=asked(own, "hello")["design"])
    assert "M_hat = 3.0" in reply["messages"][0]
