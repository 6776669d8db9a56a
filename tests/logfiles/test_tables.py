"""Parquet, Arrow, Feather, .mat and HDF5 by their libraries' own writers."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("h5py")
pytest.importorskip("pyarrow")

import h5py
import pyarrow as pa
import pyarrow.feather as feather
import pyarrow.parquet as pq
from scipy.io import savemat

import phyfilter_ctl as pf

TICKS = 1_700_000_000_123_456_789 + 2_000_000 * np.arange(50)
V = np.sin(0.1 * np.arange(50))
Q = np.random.default_rng(0).standard_normal((50, 4))


def arrow_table(times: object) -> object:
    v = pa.array([None, *V[1:].tolist()])
    q = pa.FixedSizeListArray.from_arrays(pa.array(Q.ravel()), 4)
    schema = pa.schema(
        [("time", times.type), pa.field("v", pa.float64(), metadata={"unit": "m/s"}), ("q", q.type)]
    )
    table = pa.table([times, v, q], schema=schema)
    return table.append_column("mode", pa.array(["auto"] * 50)).append_column("armed", pa.array([True] * 50))


def stream(table: object, path: Path) -> None:
    with pa.ipc.new_stream(str(path), table.schema) as sink:
        sink.write_table(table, max_chunksize=20)


ARROWS: dict[str, Callable[..., None]] = {
    "parquet": pq.write_table,
    "feather": feather.write_feather,
    "arrow": stream,
}


@pytest.mark.parametrize("kind", ARROWS)
def test_arrow_says_its_unit_of_time_and_its_zone(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"log.{kind}"
    ARROWS[kind](arrow_table(pa.array(TICKS, pa.timestamp("ns", tz="Europe/Berlin"))), path)
    log = pf.open_log(path)
    assert log.start == datetime(2023, 11, 14, 22, 13, 20, 123_456, UTC)
    signal = log.read("table")
    assert signal.fields == ("v", "q[0]", "q[1]", "q[2]", "q[3]", "armed")
    assert signal.units == ("m/s", "", "", "", "", "")
    np.testing.assert_array_equal(signal.times, 2_000_000 * np.arange(50) / 1e9)
    np.testing.assert_array_equal(signal.values[:, 0], [np.nan, *V[1:]])
    np.testing.assert_array_equal(log.read("table", ["q"]).values, Q)
    assert log.topics[0].notes == ("left out, as no numbers: mode (string)",)
    ARROWS[kind](arrow_table(pa.array(TICKS, pa.timestamp("ns"))), path)
    assert pf.open_log(path).start is None
    ARROWS[kind](arrow_table(pa.array(2_000_000 * np.arange(50), pa.duration("ns"))), path)
    np.testing.assert_array_equal(
        pf.open_log(path).read("table").times, signal.times
    )  # timedelta64, not 2e6 s
    ARROWS[kind](arrow_table(pa.array(TICKS)), path)
    with pytest.raises(ValueError, match="does not say its unit"):
        pf.open_log(path)
    np.testing.assert_array_equal(pf.open_log(path, time_unit="ns").read("table").times, signal.times)
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(ValueError, match=r"log\.(parquet|feather|arrow): "):
        pf.open_log(path, time_unit="ns").read("table")


def write_hdf5(path: Path, **times: object) -> Path:
    with h5py.File(path, "w") as file:
        for k, (name, values) in enumerate(times.items()):
            group = file.create_group(name)
            group["time"] = values
            group["time"].attrs["units"] = "us"
            group["q"] = Q if k == 0 else Q.T
            group["v"] = V[:, None]
            group["v"].attrs["unit"] = "m/s"
            group["short"] = V[:20]
        rows = np.zeros(5, [("t_s", "f8"), ("x", "f4"), ("name", "S4")])
        rows["t_s"], rows["x"] = np.arange(5.0), 7.0
        if not times:
            file["table_of_rows"] = rows
    return path


def test_hdf5_groups_share_a_zero(tmp_path: Path) -> None:
    micro = TICKS // 1000
    log = pf.open_log(write_hdf5(tmp_path / "log.h5", imu=micro, motor=micro + 500))
    assert log.format == "hdf5"
    for name, offset in {"imu": 0.0, "motor": 500e-6}.items():
        signal = log.read(name)
        np.testing.assert_allclose(signal.times, 0.002 * np.arange(50) + offset, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(log.read(name, ["q"]).values, Q)
        np.testing.assert_array_equal(log.read(name, ["v"]).values[:, 0], V)
    assert log.read("imu", ["v"]).units == ("m/s",)
    assert log.topics[0].notes == ("left out, short: shape (20,) has no axis of the 50 of 'time'",)
    rows = pf.open_log(write_hdf5(tmp_path / "rows.h5"))
    assert rows.read("table_of_rows").values.tolist() == [[7.0]] * 5
    path = tmp_path / "cut.h5"
    path.write_bytes(log.path.read_bytes()[:1000])
    with pytest.raises(ValueError, match=r"no readable hdf5 log: .*truncated"):
        pf.open_log(path)


def test_a_field_at_another_rate_is_refused_with_the_reason(tmp_path: Path) -> None:
    log = pf.open_log(write_hdf5(tmp_path / "log.h5", imu=TICKS // 1000))
    with pytest.raises(ValueError, match=r"no field 'short'.* shape \(20,\) has no axis of the 50 of 'time'"):
        log.read("imu", ["short"])


def test_groups_that_count_differently_have_no_common_clock(tmp_path: Path) -> None:
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        file["a/t_s"], file["a/v"], file["b/t_ms"], file["b/v"] = TICKS / 1e9, V, TICKS / 1e6, V
    with pytest.raises(ValueError, match="its groups count time in ms and s: no common clock"):
        pf.open_log(path)
    assert [topic.name for topic in pf.open_log(path, time="t_ms").topics] == ["b"]
    with h5py.File(path, "w") as file:  # whole seconds beside broken ones
        file["a/t_s"], file["a/v"], file["b/t_s"], file["b/v"] = (
            np.arange(7, 57),
            V,
            6.75 + 0.5 * np.arange(50),
            V,
        )
    log = pf.open_log(path)
    assert log.read("a").times[0] - log.read("b").times[0] == 0.25


def test_matlab_structs_are_topics(tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    log = {"t": 0.002 * np.arange(50)[:, None], "q": Q, "v": V[None, :], "note": "text"}
    savemat(path, {"flight": log, "gain": 3.0})
    with pytest.raises(ValueError, match=r"does not say its unit; its steps would be 0.002 s in s"):
        pf.open_log(path)
    opened = pf.open_log(path, time_unit="s")
    assert opened.format == "mat"
    np.testing.assert_array_equal(opened.read("flight", ["q"]).values, Q)
    np.testing.assert_array_equal(opened.read("flight", ["v"]).values[:, 0], V)
    savemat(path, {"time_ms": np.arange(50), "v": V}, format="4")
    assert pf.open_log(path).read("").times[1] == 0.001
    path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(ValueError, match=r"log\.mat: "):
        pf.open_log(path)


def test_matlab_7_3_is_hdf5_inside(tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["flight/t_s"] = 0.002 * np.arange(50)[None, :]
        file["flight/q"] = Q.T
        file["flight/q"].attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    log = pf.open_log(path)
    assert log.format == "mat"
    np.testing.assert_array_equal(log.read("flight").values, Q)


def test_numbers_of_another_file_are_not_read(tmp_path: Path) -> None:
    secret = tmp_path / "secret.bin"
    secret.write_bytes(np.arange(50.0).tobytes())
    outside, layout = tmp_path / "outside.h5", h5py.VirtualLayout((50,), float)
    with h5py.File(outside, "w") as file:
        file["time_s"] = 0.01 * np.arange(50)
        file.create_dataset("v", (50,), float, external=[(str(secret), 0, h5py.h5f.UNLIMITED)])
    with h5py.File(tmp_path / "source.h5", "w") as file:
        file["v"] = V
    layout[:] = h5py.VirtualSource(str(tmp_path / "source.h5"), "v", (50,))
    virtual = tmp_path / "virtual.h5"
    with h5py.File(virtual, "w") as file:
        file["time_s"] = 0.01 * np.arange(50)
        file.create_virtual_dataset("v", layout)
    for path in (outside, virtual):
        with pytest.raises(ValueError, match="'v' takes its numbers from another file, which is not read"):
            pf.open_log(path)


def test_a_csv_counts_by_its_lines_before_it_is_read(tmp_path: Path) -> None:
    rows = 500
    path = tmp_path / "long.csv"
    path.write_text("t_s,v,w\n" + "".join(f"{0.01 * k!r},{k},{-k}\n" for k in range(rows)))
    enough = 8 * (rows + 2)  # a line for the header, one that may lack its end
    assert len(pf.open_log(path, largest=enough).topics) == 1
    with pytest.raises(
        ValueError, match=r"long\.csv: 4016 bytes of memory for a column, expected at most 4000"
    ):
        pf.open_log(path, largest=8 * rows)
    with pytest.raises(ValueError, match=r"12000 bytes of memory for topic 'table'"):
        pf.open_log(path, largest=enough).read("table")


def test_a_list_of_parquet_counts_with_all_its_elements(tmp_path: Path) -> None:
    """One element of 256 is asked for; all are read."""
    rows, width = 100, 256
    wide = pa.FixedSizeListArray.from_arrays(pa.array(np.arange(float(rows * width))), width)
    path = tmp_path / "wide.parquet"
    pq.write_table(pa.table({"t": pa.array(0.01 * np.arange(rows)), "q": wide}), path, compression="zstd")
    enough = 8 * rows * width * 2  # what the file keeps beside the numbers is less than they are
    assert pf.open_log(path, time_unit="s", largest=enough).read("table", ["q[0]"]).values.shape == (rows, 1)
    with pytest.raises(ValueError, match=r"wide\.parquet: .* bytes of memory for the columns q"):
        pf.open_log(path, time_unit="s", largest=8 * rows * width // 2).read("table", ["q[0]"])


def test_parquet_reads_as_csv_does(tmp_path):
    """The same table, by :meth:`Recording.read`."""
    t = 0.01 * np.arange(300)
    columns = {"t": t, "vx [m/s]": np.sin(3.0 * t), "label_vx": 3.0 * np.cos(3.0 * t)}
    pq.write_table(pa.table(columns), tmp_path / "flight.parquet")
    rows = "".join(
        f"{','.join(repr(float(value)) for value in row)}\n" for row in zip(*columns.values(), strict=True)
    )
    (tmp_path / "flight.csv").write_text(f"{','.join(columns)}\n{rows}")
    found, expected = (
        pf.Recording.read(tmp_path / f"flight.{kind}", x=["vx"]) for kind in ("parquet", "csv")
    )
    assert (found.channels, found.unit, found.name) == (expected.channels, expected.unit, expected.name)
    np.testing.assert_allclose(found.x, expected.x, rtol=1e-12)
    np.testing.assert_allclose(found.label, expected.label, rtol=1e-12)
    np.testing.assert_allclose(found.times - found.times[0], expected.times, atol=1e-12)
    columns["t"] = 1e3 * t
    pq.write_table(pa.table(columns), tmp_path / "ticks.parquet")
    with pytest.raises(ValueError, match=r"expected 10 us to 1 s.*say it by time_unit="):
        pf.Recording.read(tmp_path / "ticks.parquet", x=["vx"])
    assert pf.Recording.read(tmp_path / "ticks.parquet", x=["vx"], time_unit="ms").dt == pytest.approx(0.01)
