"""ArduPilot's DataFlash by a writer of our own, from the format's definition."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pymavlink")

import phyfilter_ctl as pf
from tests.logfiles.dataflash_writer import HEAD, Message, dataflash

MESSAGES: dict[str, Message] = {
    "XKF1": ("QBccCfff", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD", "s#dddnnn", "F-BBB000"),
    "GPS": ("QBHILL", "TimeUS,I,GWk,GMS,Lat,Lng", "s#-sdd", "F--CGG"),
    "RFND": ("QHZ", "TimeUS,Dist,Text", "sm-", "FB-"),
    "IMU": ("Qff", "TimeUS,AccX,GyrX", "soE", "F00"),
}
START = 30_000_000


def rows() -> list[tuple[str, tuple]]:
    found: list[tuple[str, tuple]] = []
    for k in range(200):
        t = START + 2500 * k
        found.append(("IMU", (t, 0.25 * k, -0.5 * k)))
        if k % 10 == 0:
            found += [("XKF1", (t, core, 100 * core + k, -k, 35999, 1.5 * k, 0.0, -1.0)) for core in (0, 1)]
        if k % 50 == 0:
            found += [("GPS", (t, 0, 2356 if k else 0, 446_767_000 + 5 * k // 2, 481_234_567, -113_333_333))]
            found += [("RFND", (t, 123, "down"))]
    return found


def test_what_was_written_is_read_in_base_units(tmp_path: Path) -> None:
    path = tmp_path / "00000001.BIN"
    path.write_bytes(dataflash(MESSAGES, rows()))
    log = pf.open_log(path)
    assert log.format == "dataflash"
    assert not log.notes
    assert {"IMU", "XKF1[0]", "XKF1[1]", "GPS[0]", "RFND"} <= {topic.name for topic in log.topics}
    zero = 1  # of UNIT, the first message with a time
    imu = log.read("IMU")
    np.testing.assert_array_equal(imu.times, (START + 2500 * np.arange(200) - zero) / 1e6)
    np.testing.assert_array_equal(imu.values, np.outer(np.arange(200), [0.25, -0.5]))
    assert imu.units == ("m/s/s", "rad/s")
    second = log.read("XKF1[1]", ["Roll", "Yaw", "VN"])
    np.testing.assert_array_equal(second.values[:, 0], (100 + np.arange(0, 200, 10)) / 100)
    assert set(second.values[:, 1]) == {359.99}
    assert second.units == ("deg", "deg", "m/s")
    distance = log.read("RFND")
    assert (distance.fields, distance.units, distance.values[0, 0]) == (("Dist",), ("m",), 1.23)
    assert log.read("GPS[0]", ["Lat"]).values[0, 0] == 48.1234567


def test_utc_is_gps_time_less_the_leap_seconds(tmp_path: Path) -> None:
    path = tmp_path / "log.bin"
    path.write_bytes(dataflash(MESSAGES, rows()))
    log = pf.open_log(path)
    # GPS week 2356 begins on 2025-03-02, and 446767.125 s are 5 d 4 h 6 min 7.125 s; 30.125 s after boot.
    known = datetime(2025, 3, 7, 4, 6, 7, 125_000, UTC)
    assert log.start is not None
    assert (known - log.start).total_seconds() == pytest.approx(18 + 30.125 - 1e-6, abs=2e-6)


def test_damage_is_said(tmp_path: Path) -> None:
    whole = dataflash(MESSAGES, rows())
    path = tmp_path / "log.bin"
    path.write_bytes(whole[:-20])
    assert pf.open_log(path).notes == ("cut off: the last message is incomplete",)
    path.write_bytes(whole + b"\xff" * 700)
    assert pf.open_log(path).notes == ("700 bytes are no messages",)
    path.write_bytes(HEAD + b"\x80" + b"\0" * 30)
    with pytest.raises(ValueError, match=r"no readable dataflash log|holds no samples"):
        pf.open_log(path)
    path.write_text("FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n")
    with pytest.raises(ValueError, match=r"a text dump of DataFlash; give the \.bin"):
        pf.open_log(path)
