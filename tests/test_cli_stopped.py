"""Ctrl-C and SIGTERM: a command that is stopped in its work leaves no temporary files and no processes."""

from __future__ import annotations

import http.client
import json
import os
import re
import shlex
import signal
from base64 import b64encode
from pathlib import Path

import pytest

from phyfilter_ctl import PhyFilter, save
from phyfilter_ctl.codegen import find_compiler
from tests.cpu_budget import slow_but
from tests.stopping import SOON, STATUS, Left, below, linux, stopped

pytestmark = linux

# Flights are kept in memory where they are few; these are read by workers as larger ones are.
_LEARN = """
import sys
from phyfilter_ctl.cli import flights, main
flights._AT_HAND = -1
sys.exit(main(sys.argv[1:]))
"""


def assert_nothing_is_left(left: Left, number: signal.Signals) -> None:
    assert left.status == STATUS[number], left.said
    assert left.said.splitlines()[-1] == "phyfilter-ctl: stopped"
    assert "Traceback" not in left.said
    assert left.temporary == []
    assert left.processes == []


@pytest.mark.parametrize("number", slow_but([signal.SIGTERM], STATUS))
def test_learning_ends_its_workers(number: signal.Signals, tmp_path: Path) -> None:
    """They wait for flights that never come: pipes that nobody writes to."""
    for name in ("one.csv", "two.csv"):
        os.mkfifo(tmp_path / name)
    left = stopped(
        ["learn", "one.csv", "two.csv", "--workers", "2"],
        number,
        tmp_path,
        # Two workers and the process that keeps their books.
        lambda pid, _: len(below(pid)) >= 3,
        program=["-c", _LEARN],
    )
    assert_nothing_is_left(left, number)


@pytest.mark.slow
@pytest.mark.parametrize("number", STATUS)
def test_the_designer_drops_what_was_brought_to_it(number: signal.Signals, tmp_path: Path) -> None:
    """Half of a file has arrived when the signal comes."""
    pytest.importorskip("uvicorn", reason="uvicorn is not installed: the page's server is not tested")
    half = {
        "id": 1,
        "op": "upload",
        "name": "log.csv",
        "size": 8,
        "at": 0,
        "data": b64encode(b"t,v\n").decode(),
    }

    def has_half(pid: int, temporary: Path) -> bool:
        if not (
            address := re.search(r"127\.0\.0\.1:(\d+)/#token=([\w-]+)\n", (tmp_path / "printed").read_text())
        ):
            return False
        host = f"127.0.0.1:{address[1]}"
        connection = http.client.HTTPConnection(host, timeout=SOON)
        headers = {"origin": f"http://{host}", "x-phyfilter-token": address[2]}
        connection.request(
            "POST", "/message", json.dumps(half), headers | {"content-type": "application/json"}
        )
        assert json.loads(connection.getresponse().read())["ok"]
        connection.close()
        return [path.read_bytes() for path in temporary.rglob("*.csv")] == [b"t,v\n"]

    left = stopped(["app", "--no-browser"], number, tmp_path, has_half)
    assert_nothing_is_left(left, number)


@pytest.mark.slow
@pytest.mark.parametrize("number", STATUS)
def test_an_export_ends_its_compiler(number: signal.Signals, tmp_path: Path) -> None:
    """The compiler is the usual one, but that it does not come to an end with a library."""
    usual = shlex.join(find_compiler().command)
    save(tmp_path / "filter.toml", PhyFilter.from_poles([-20.0]))
    slow = tmp_path / "cc"
    slow.write_text(f'#!/bin/sh\ncase "$*" in *product*) exec sleep 600;; esac\nexec {usual} "$@"\n')
    slow.chmod(0o755)
    left = stopped(
        ["export", "filter.toml", "--dt", "0.01", "--fmu", "filter.fmu"],
        number,
        tmp_path,
        lambda pid, temporary: any(temporary.rglob("*.c")) and bool(below(pid)),
        environment={"CC": str(slow)},
    )
    assert_nothing_is_left(left, number)
    assert not list(tmp_path.glob("*.fmu")) + list(tmp_path.glob(".*"))
