"""Ten thousand messages that no front end would send: each is answered in JSON, none crashes, none leaves a file."""

from __future__ import annotations

import asyncio
import base64
import importlib
import json
import logging
import re
from typing import Any

import numpy as np
import pytest

from phyfilter_ctl.app.handling import Session
from tests.cpu_budget import release_but

pytest.importorskip("starlette", reason="starlette is not installed: the page's server is not fuzzed")
server = importlib.import_module("phyfilter_ctl.app.server")

HOST = "127.0.0.1:8123"
TOKEN = "a-token-of-more-than-16-characters"
HEADERS = [
    (b"host", HOST.encode()),
    (b"origin", f"http://{HOST}".encode()),
    (server.TOKEN_HEADER.encode(), TOKEN.encode()),
    (b"content-type", b"application/json"),
]
CHUNKS, CHUNK = 5, 2000

OPS = [
    "hello",
    "design",
    "loop",
    "locus",
    "responses",
    "family",
    "upload",
    "preview",
    "import",
    "measured",
    "forget",
    "estimate",
    "learn",
    "job",
    "cancel",
    "python",
    "save",
    "open",
    "session",
    "export",
]
LOG = "t,vx,ax\n" + "".join(f"{0.01 * k:.2f},{k % 7},{k % 3}\n" for k in range(40))
FILES = [LOG.encode(), LOG.replace(".", "#").replace(",", ";").replace("#", ",").encode()]
FILES += [
    magic + bytes(range(256))
    for magic in (
        b"ULog\x01\x12\x35",
        b"\xa3\x95\x80",
        b"PAR1",
        b"\x89HDF\r\n\x1a\n",
        b"MATLAB ",
        b"\x89MCAP0\r\n",
    )
]
# What stands where something else is expected.
ODD: list[object] = [
    None, True, False, 0, -1, 1, 1e308, -1e-308, 1e400, 10**400, "", "x", "\x00", "../../etc/passwd", "\ud800",
    "é" * 300, "__class__", "NaN", [], [[]], [[[[[[]]]]]], {}, {"a": {"b": {}}}, [1e400], [None] * 1000,
    [[-1, 0]] * 1000, "9" * 1000, {"poles": "self"}, [[-1, 1]], [-1, 0], "$(id)", "{0.__class__}", "%s%n",
]  # fmt: skip


class Fuzzer:
    """Messages, from nearly right to bytes."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)

    def pick(self, things: list) -> Any:
        return things[int(self.rng.integers(len(things)))]

    def odd_or(self, value: object, chance: float = 0.2) -> object:
        return self.pick(ODD) if self.rng.random() < chance else value

    def design(self) -> object:
        n = int(self.rng.integers(1, 10))
        poles = [[-float(10 ** self.rng.uniform(-4, 6)), 0.0] for _ in range(n)]
        if n > 1 and self.rng.random() < 0.5:
            imag = float(10 ** self.rng.uniform(-2, 4))
            poles[:2] = [[poles[0][0], imag], [poles[0][0], -imag]]
        kind = self.pick(["lowpass", "type", "zeros", "b", "none"])
        numerator = {"kind": kind, "type": n - 1, "zeros": [[0, 0]], "gain": 1.0, "b": [1.0] * n}
        wanted = {"lowpass": [], "type": ["type"], "zeros": ["zeros", "gain"], "b": ["b"]}.get(
            str(kind), ["b"]
        )
        return {
            "poles": self.odd_or(poles, 0.1),
            "numerator": self.odd_or({key: numerator[key] for key in ["kind", *wanted]}, 0.1),
            "sampling": self.odd_or(
                {"dt": self.odd_or(0.002, 0.1), "method": self.pick(["exact", "euler", "tustin"])}, 0.1
            ),
            "assume": self.odd_or({"slope": self.odd_or(1.0), "noise": 0.01, "lag": 0.01, "unit": "N"}, 0.1),
            "limits": self.odd_or(None, 0.1),
        }

    def fields(self, op: str) -> dict[str, object]:
        values: dict[str, dict[str, object]] = {
            "family": {"family": "butterworth", "order": 3, "cutoff": 20.0, "damping": 0.7, "band": [1, 10]},
            "upload": self.piece(),
            "preview": {"time": "t", "time_unit": self.pick(["s", "ms", "us", "ns"])},
            "import": {
                "time": "t",
                "x": ["vx"],
                "label": ["ax"],
                "inertia": self.pick([["ax"], [1.5], [], [1, 2, 3]]),
                "unit_x": "mm/s",
                "step": 0.02,
            },
            "measured": {"channel": 0},
            "locus": {"over": "bandwidth"},
            "learn": {"order": 1, "form": "lowpass"},
            "job": {"job": 1},
            "cancel": {"job": 1},
            "open": {"name": "filter.toml", "text": 'format = "phyfilter"\nversion = 1\na = [400.0, 40.0]\n'},
            "session": {"text": self.session()},
            "save": {"name": "filter"},
            "estimate": {"channel": 0},
            # A compiler run takes a second: never a kind that exists.
            "export": {"kind": "exe", "channels": 1, "name": "wing"},
            "exports": {"channels": 3},
            # A search takes seconds: never a trade that exists.
            "meet": {"trade": "money", "form": "general", "delay_margin": 0.01, "ratios": [0.5, 2.0]},
            "front": {"job": 1},
            # Pictures take a second: never a format that exists.
            "report": {"format": "docx", "name": "wing"},
            "unmeet": {"job": 1},
        }
        return values.get(op, {})

    def session(self) -> str:
        """A session file, from nearly right to cut off."""
        kept = {
            "format": self.odd_or("phyfilter-session", 0.1),
            "version": self.odd_or(1, 0.1),
            "design": self.odd_or(self.design(), 0.1),
            "pins": self.odd_or([{"name": self.odd_or("before"), "design": self.design()}], 0.3),
            "recording": self.odd_or({"name": "a.csv", "size": self.odd_or(1)}, 0.2),
            "views": self.odd_or({"bode": self.pick(ODD)}, 0.3),
            "history": self.odd_or({"past": self.odd_or([self.design()]), "future": []}, 0.2),
        }
        text = json.dumps(kept)
        return text[: int(self.rng.integers(len(text)))] if self.rng.random() < 0.1 else text

    def piece(self) -> dict[str, object]:
        """A file in one piece, cut or with bytes changed, under the name of one format or another."""
        raw = bytearray(self.pick(FILES)[: int(self.rng.integers(1, 400))])
        for _ in range(int(self.rng.integers(4))):
            raw[int(self.rng.integers(len(raw)))] = int(self.rng.integers(256))
        name = f"flight{self.pick(['.csv', '.ulg', '.bin', '.mat', '.h5', '.parquet', '.mcap', '', '.x y'])}"
        return {"name": name, "size": len(raw), "at": 0, "data": base64.b64encode(raw).decode()}

    def message(self) -> bytes:
        op = str(self.pick(OPS))
        message = {"id": self.odd_or(int(self.rng.integers(1000)), 0.05), "op": self.odd_or(op, 0.05)}
        message |= {key: self.odd_or(value) for key, value in self.fields(op).items()}
        designed = (
            "design",
            "loop",
            "locus",
            "responses",
            "estimate",
            "python",
            "save",
            "export",
            "exports",
            "meet",
            "report",
        )
        if op in designed:
            message["design"] = self.odd_or(self.design(), 0.1)
        if op == "compare":
            message["designs"] = self.odd_or([self.odd_or(self.design(), 0.1) for _ in range(2)], 0.1)
        if self.rng.random() < 0.05:
            message[str(self.pick(["x", "design", "__proto__", ""]))] = self.pick(ODD)
        text = json.dumps(message).replace("Infinity", "1e400").encode()
        if self.rng.random() < 0.1:  # bytes changed, or the end missing
            raw = bytearray(text[: int(self.rng.integers(1, len(text) + 1))])
            for _ in range(3):
                raw[int(self.rng.integers(len(raw)))] = int(self.rng.integers(256))
            return bytes(raw)
        return text


async def post(app, body: bytes) -> tuple[int, bytes]:
    """One request over ASGI, without a client that would take longer than the answer."""
    sent: list = []

    async def receive() -> dict:
        return {"type": "http.request", "body": body, "more_body": False}

    async def send(message: dict) -> None:
        sent.append(message)

    scope = {
        "type": "http", "asgi": {"version": "3.0"}, "http_version": "1.1", "method": "POST", "scheme": "http",
        "path": "/message", "raw_path": b"/message", "query_string": b"", "root_path": "", "client": None,
        "server": ("127.0.0.1", 8123), "headers": HEADERS,
    }  # fmt: skip
    await app(scope, receive, send)
    return sent[0]["status"], b"".join(message.get("body", b"") for message in sent[1:])


@pytest.mark.parametrize("chunk", release_but((0, 1), range(CHUNKS)))
def test_no_message_crashes(chunk, tmp_path, caplog):
    fuzz, session = Fuzzer(chunk), Session()
    app = server.create_app(session, port=8123, token=TOKEN, out=tmp_path)
    seen: dict[tuple[int, bool], int] = {}

    async def all_of_them() -> None:
        for _ in range(CHUNK):
            body = fuzz.message()
            status, text = await post(app, body)
            reply = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} in a reply"))
            assert reply["ok"] or 0 < len(reply["error"]) < 1000, body[:300]
            assert "Traceback" not in str(reply.get("error"))
            assert status in ((200,) if reply["ok"] else (200, 400, 413)), body[:300]
            seen[status, reply["ok"]] = seen.get((status, reply["ok"]), 0) + 1

    with caplog.at_level(logging.WARNING):
        asyncio.run(all_of_them())
    session.close()
    assert not caplog.records
    # Enough of each kind that the test means something.
    assert seen[200, True] > CHUNK / 10
    assert seen[200, False] > CHUNK / 10
    assert seen[400, False] > CHUNK / 50
    assert all(re.fullmatch(r"filter-[0-9a-f]{8}\.toml", path.name) for path in tmp_path.iterdir())
    # And it still works.
    reply = server.handle(session, {"id": 1, "op": "hello"})
    assert reply["ok"]
