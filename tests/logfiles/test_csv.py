"""CSV of any dialect, and what all logs have in common: what is read is what was written, or is refused by name."""

from __future__ import annotations

import sys
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl.recording import csvfile


def written(folder: Path, text: str, name: str = "log.csv", encoding: str = "utf-8") -> Path:
    path = folder / name
    path.write_bytes(text.encode(encoding))
    return path


@pytest.mark.parametrize(
    ("delimiter", "decimal"), [*((d, ".") for d in ",;\t| "), *((d, ",") for d in ";\t| ")]
)
def test_dialects_hold_the_same_numbers(tmp_path: Path, delimiter: str, decimal: str) -> None:
    rows = [("0.5", "-1.25e-3"), ("0.75", ""), ("1.5", "2.0")]
    text = delimiter.join(["time_s", "v"]) + "\n"
    text += "".join(delimiter.join(row).replace(".", decimal) + "\n" for row in rows)
    signal = pf.open_log(written(tmp_path, "﻿# a comment\n\n" + text)).read("table")
    assert signal.times.tolist() == [0.0, 0.25, 1.0]
    np.testing.assert_array_equal(signal.values[:, 0], [-1.25e-3, np.nan, 2.0])


@pytest.mark.parametrize("decimal", [".", ","])
def test_polars_reads_what_the_slow_way_reads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, decimal: str
) -> None:
    pytest.importorskip("polars")
    rng = np.random.default_rng(1)
    values = rng.standard_normal((200, 3)) * 10.0 ** rng.integers(-300, 300, (200, 3))
    texts = [[repr(v) for v in row] for row in values.tolist()]
    texts[3][1] = ""
    text = "t_s;text;a;b\n" + "".join(f"{k};x;{row[1]};{row[2]}\n" for k, row in enumerate(texts))
    path = written(tmp_path, text.replace(".", decimal))
    slow = pf.open_log(path).read("table").values
    monkeypatch.setattr(csvfile, "_LARGE", 0)
    fast = csvfile.open_csv(path, *csvfile.dialect(path))._read_by_polars([2, 3], True)
    assert fast is not None
    np.testing.assert_array_equal(fast, slow)
    path.write_text(path.read_text() + "9;x;1\n")
    with pytest.raises(ValueError, match="line 202 has 3 fields, expected 4"):
        pf.open_log(path).read("table", ["a"])


def test_units_of_time_are_the_files_or_are_asked_for(tmp_path: Path) -> None:
    ticks = 1_700_000_000_123_456_789 + 2_000_000 * np.arange(5)
    path = written(tmp_path, "timestamp,v\n" + "".join(f"{t},1\n" for t in ticks))
    with pytest.raises(
        ValueError, match=r"does not say its unit; its steps would be 2e\+06 s in s, .* 0\.002 s in ns"
    ):
        pf.open_log(path)
    log = pf.open_log(path, time_unit="ns")
    # Exact: whole numbers until the division.
    assert log.read("table").times.tolist() == [0.0, 0.002, 0.004, 0.006, 0.008]
    assert log.notes == ("time 0 is 1700000000123456789 ns of 'timestamp'",)
    assert log.start is None  # 1970 is not certain
    wrong = pf.open_log(path, time_unit="s").topics[0].clock.findings
    assert wrong == ("dt 2e+06 s is above 1 s: a slow topic, or a wrong unit of time?",)
    named = written(tmp_path, path.read_text().replace("timestamp", "timestamp [ns]"), "named.csv")
    np.testing.assert_array_equal(pf.open_log(named).read("table").times, log.read("table").times)
    with pytest.raises(ValueError, match=r"is in ns: leave time_unit='ms' out"):
        pf.open_log(named, time_unit="ms")
    with pytest.raises(ValueError, match="expected one of s, ms, us, ns, got 'min'"):
        pf.open_log(named, time_unit="min")  # type: ignore[arg-type]


def test_time_zones_come_to_utc_and_local_times_say_so(tmp_path: Path) -> None:
    zoned = "time,v\n2024-10-27T02:59:59.5+02:00,1\n2024-10-27T02:00:00.000000001+01:00,2\n"
    log = pf.open_log(written(tmp_path, zoned))
    assert log.start == datetime(2024, 10, 27, 0, 59, 59, 500_000, UTC)
    assert log.read("").times.tolist() == [0.0, 0.500000001]
    local = pf.open_log(written(tmp_path, "time,v\n2024-10-27 02:59:59.5,1\n2024-10-27 03:00:00,2\n"))
    assert local.start is None
    assert local.notes == ("'time' is local time of an unknown zone",)
    mixed = written(tmp_path, "time,v\n2024-10-27T02:59:59,1\n2024-10-27T03:00:00Z,2\n")
    with pytest.raises(ValueError, match="some times have a time zone and some do not"):
        pf.open_log(mixed)


def test_clocks_are_described_and_left_alone(tmp_path: Path) -> None:
    times = [0.0, 0.1, 0.2, 1.2, 1.1, 1.1, 1.2, 1.3]
    log = pf.open_log(written(tmp_path, "t_s,v\n" + "".join(f"{t},1\n" for t in times)))
    assert log.read("table").times.tolist() == times
    assert log.topics[0].clock.findings == (
        "1 gap, the longest 1 s",
        "the clock runs back 1 time",
        "1 time the same time twice",
    )


BROKEN = {
    "": "the file is empty",
    "t_s,v\n": "no rows follow the header",
    "t_s,v\n0,1\n1": "line 3 has 1 fields, expected 2",
    "t_s,v\n0,1\n1,2\n2,x\n" * 40: "line 6, column 'v': 'v' is not a number|'x'|'t_s'",
    "a,b\n0,1\n1,2\n": "no column is known as the times; name it by time",
    "t_s,time\n0,1\n1,2\n": "'t_s', 'time' may be the times; name it by time",
    "time,v\n2024-01-01T00:00:00,1\nyesterday,2\n": "line 3, column 'time': 'yesterday' is neither",
}


@pytest.mark.parametrize("text", BROKEN)
def test_broken_tables_are_refused_with_the_reason(tmp_path: Path, text: str) -> None:
    with pytest.raises(ValueError, match=BROKEN[text]) as caught:
        pf.open_log(written(tmp_path, text)).read("table")
    assert str(tmp_path / "log.csv") in str(caught.value)


def test_topics_and_fields_that_are_not_there_are_named(tmp_path: Path) -> None:
    log = pf.open_log(written(tmp_path, "t_s,v,mode\n0,1,auto\n1,2,auto\n"))
    assert log.topics[0].notes == ("left out, as text: mode",)
    with pytest.raises(ValueError, match=r"has no topic 'tabel'; did you mean 'table'\? It has: table"):
        log.read("tabel")
    with pytest.raises(ValueError, match="has no field 'w' It has: v"):
        log.read("table", ["w"])
    with pytest.raises(TypeError, match=r"write \['v'\]"):
        log.read("table", "v")
    with pytest.raises(ValueError, match="expected a field of times, one of none here, got 'v'"):
        log.read("table", clock="v")
    with pytest.raises(ValueError, match="there is no column 'z'"):
        pf.open_log(log.path, time="z")


def test_a_package_that_is_missing_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.ulg"
    path.write_bytes(b"ULog\x01\x12\x35\x01" + bytes(8))
    monkeypatch.setitem(sys.modules, "pyulog", None)
    with pytest.raises(ValueError, match=r"needs the package pyulog: pip install 'phyfilter-ctl\[logs\]'"):
        pf.open_log(path)


def test_a_file_of_no_known_format_says_which_are_known(tmp_path: Path) -> None:
    path = tmp_path / "noise.bin"
    path.write_bytes(b"\x00\x01\x02" * 9)
    with pytest.raises(ValueError, match=r"begins as no format that is known here: .*csv"):
        pf.open_log(path)
    with pytest.raises(FileNotFoundError):
        pf.open_log(tmp_path / "nothing.csv")
