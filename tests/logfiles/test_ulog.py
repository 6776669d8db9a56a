"""PX4's ULog by a writer of our own, from the specification."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pyulog")

import phyfilter_ctl as pf
from tests.logfiles.ulog_writer import ulog, write_ulog

START = 5_000_000
SLOW, FAST = START + 100_000 * np.arange(20), START + 4_000 * np.arange(500) + 1500
UTC_AT_GPS = datetime(2025, 3, 4, 5, 6, 7, 250_000, UTC)


def flight() -> dict:
    rng = np.random.default_rng(0)
    gps = [0, int(UTC_AT_GPS.timestamp() * 1e6)]
    jumpy = FAST.copy()
    jumpy[10:] += 800_000  # a gap
    jumpy[20] = jumpy[19]
    return {
        "vehicle_local_position": {
            "timestamp": ("uint64_t", SLOW),
            "timestamp_sample": ("uint64_t", SLOW - 2_500),
            "vx": ("float", rng.standard_normal(20).astype(np.float32)),
            "xy_valid": ("bool", np.arange(20) % 2),
        },
        "vehicle_attitude": {
            "timestamp": ("uint64_t", FAST),
            "q": ("float", rng.standard_normal((500, 4)).astype(np.float32)),
        },
        ("sensor_accel", 0): {"timestamp": ("uint64_t", SLOW), "x": ("float", np.full(20, 9.5))},
        ("sensor_accel", 1): {"timestamp": ("uint64_t", jumpy), "x": ("float", np.full(500, np.nan))},
        "sensor_gps": {
            "timestamp": ("uint64_t", START + np.array([1, 2_000_000])),
            "time_utc_usec": ("uint64_t", gps),
        },
        "log_message": {"timestamp": ("uint64_t", SLOW[:1]), "text": ("char", np.full((1, 8), b"a"))},
    }


def test_what_was_written_is_read(tmp_path: Path) -> None:
    topics = flight()
    log = pf.open_log(
        write_ulog(tmp_path / "a.ulg", topics, start=START, dropouts=[(START + 1_900_000, 250)])
    )
    assert log.format == "ulog"
    assert [topic.name for topic in log.topics] == [
        *["log_message", "sensor_accel", "sensor_accel[1]"],
        *["sensor_gps", "vehicle_attitude", "vehicle_local_position"],
    ]
    position = log.read("vehicle_local_position", ["vx", "xy_valid"])
    np.testing.assert_array_equal(position.times, (SLOW - START) / 1e6)
    np.testing.assert_array_equal(position.values[:, 0], topics["vehicle_local_position"]["vx"][1])
    np.testing.assert_array_equal(position.values[:, 1], np.arange(20) % 2)
    assert position.units == ("m/s", "")
    attitude = log.read("vehicle_attitude")
    assert attitude.fields == ("q[0]", "q[1]", "q[2]", "q[3]")
    np.testing.assert_array_equal(attitude.values, topics["vehicle_attitude"]["q"][1])
    np.testing.assert_array_equal(attitude.times, (FAST - START) / 1e6)
    by_name = {topic.name: topic for topic in log.topics}
    assert [(f.name, f.unit, f.shape) for f in by_name["vehicle_attitude"].fields] == [("q", "1", (4,))]
    assert not by_name["log_message"].fields
    # The sample's own time is on the same clock.
    sampled = log.read("vehicle_local_position", ["vx"], clock="timestamp_sample")
    np.testing.assert_allclose(sampled.times, position.times - 2.5e-3, rtol=0, atol=1e-15)
    assert sampled.values.shape == (20, 1)


def test_clocks_dropouts_and_utc(tmp_path: Path) -> None:
    log = pf.open_log(
        write_ulog(tmp_path / "a.ulg", flight(), start=START, dropouts=[(START + 1_996_500, 250)])
    )
    assert log.dropouts[0].duration == 0.25
    assert log.start == datetime(2025, 3, 4, 5, 6, 5, 250_000, UTC)
    second = next(topic for topic in log.topics if topic.name == "sensor_accel[1]")
    assert second.clock.findings == ("1 gap, the longest 0.804 s", "1 time the same time twice")
    assert second.clock.dt == pytest.approx(0.004)
    assert np.isnan(log.read("sensor_accel[1]").values).all()


def test_a_log_that_was_cut_is_read_up_to_there_and_says_so(tmp_path: Path) -> None:
    whole = ulog(flight(), start=START)
    path = tmp_path / "cut.ulg"
    path.write_bytes(whole[: len(whole) // 2])
    log = pf.open_log(path)
    assert log.notes == ("cut off: the last message is incomplete",)
    assert 100 < len(log.read("vehicle_attitude").times) < 400
    path.write_bytes(whole[:12])
    with pytest.raises(ValueError, match="cut off or damaged within its definitions"):
        pf.open_log(path)
    path.write_bytes(b"ULok" + whole[4:])
    with pytest.raises(ValueError, match=r"ends in \.ulg, but does not begin as a ulog log"):
        pf.open_log(path)
    path.write_bytes(whole[:60])
    with pytest.raises(ValueError, match="cut off or damaged within its definitions"):
        pf.open_log(path)


def test_damage_that_pyulog_reads_for_ever_is_refused(tmp_path: Path) -> None:
    whole = ulog(flight(), start=START)
    path = tmp_path / "damaged.ulg"
    for end in (b"", whole[16:]):
        path.write_bytes(whole[:16] + b"\xff\xff\x00" + b"x" * 10 + end)
        with pytest.raises(ValueError, match="cut off or damaged within its definitions"):
            pf.open_log(path)


def test_its_unit_of_time_is_its_own(tmp_path: Path) -> None:
    path = write_ulog(tmp_path / "a.ulg", flight())
    with pytest.raises(ValueError, match="says its times itself; leave time_unit and time out"):
        pf.open_log(path, time_unit="us")
