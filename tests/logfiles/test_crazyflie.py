"""Logs of the Crazyflie's uSD deck, written after the description of the firmware's decoder."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

import phyfilter_ctl as pf


def usd(version: int) -> bytes:
    """100 events of state at 500 Hz and 10 of the battery; times in ms or us from 12 s on."""
    out = struct.pack("<BHH", 0xBC, version, 2)
    out += (
        struct.pack("<H", 1)
        + b"fixedFrequency\0"
        + struct.pack("<H", 2)
        + b"stateEstimate.vx(f)\0motor.m1(H)\0"
    )
    out += struct.pack("<H", 7) + b"battery\0" + struct.pack("<H", 1) + b"pm.vbat(f)\0"
    time = {
        1: lambda k: struct.pack("<I", 12_000 + 2 * k),
        2: lambda k: struct.pack("<Q", 12_000_000 + 2000 * k),
    }
    for k in range(100):
        out += struct.pack("<H", 1) + time[version](k) + struct.pack("<fH", 0.5 * k, 65_000 + k)
        if k % 10 == 5:
            out += struct.pack("<H", 7) + time[version](k) + struct.pack("<f", 3.75)
    return out + struct.pack("<I", zlib.crc32(out))


@pytest.mark.parametrize("version", [1, 2])
def test_what_was_written_is_read(tmp_path: Path, version: int) -> None:
    path = tmp_path / "log00"
    path.write_bytes(usd(version))
    log = pf.open_log(path)
    assert (log.format, log.notes) == ("crazyflie", ())
    state = log.read("fixedFrequency")
    np.testing.assert_array_equal(state.times, 2 * np.arange(100) / 1e3)
    np.testing.assert_array_equal(state.values, np.arange(100)[:, None] * [0.5, 1.0] + [0.0, 65_000.0])
    assert state.units == ("m/s", "")
    battery = log.read("battery")
    np.testing.assert_array_equal(battery.times, 2 * np.arange(5, 100, 10) / 1e3)
    assert battery.units == ("V",)


def test_a_log_that_was_cut_is_read_up_to_there_and_says_so(tmp_path: Path) -> None:
    path = tmp_path / "log00"
    path.write_bytes(usd(2)[:-500])
    log = pf.open_log(path)
    assert log.notes[0].startswith("its checksum is wrong: cut off or damaged; ")
    assert 50 < len(log.read("fixedFrequency").times) < 100
    path.write_bytes(usd(2)[:30])
    with pytest.raises(ValueError, match=r"no readable crazyflie log|subsection not found"):
        pf.open_log(path)
