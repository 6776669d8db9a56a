"""The page's server: strangers are refused before anything is read, friends are answered, files stay where they may."""

from __future__ import annotations

import asyncio
import base64
import http.client
import importlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pytest

import phyfilter_ctl
from phyfilter_ctl import PhyFilter
from phyfilter_ctl.app.handling import Session
from phyfilter_ctl.app.modules import sent
from phyfilter_ctl.cli import app as command

pytest.importorskip("starlette", reason="starlette is not installed: the page's server is not tested")
pytest.importorskip("uvicorn", reason="uvicorn is not installed: the page's server is not tested")
httpx = pytest.importorskip("httpx", reason="httpx is not installed: the page's server is not tested")
server = importlib.import_module("phyfilter_ctl.app.server")
create_app, TOKEN_HEADER, TAB_HEADER = server.create_app, server.TOKEN_HEADER, server.TAB_HEADER

PORT = 8123
HOST = f"127.0.0.1:{PORT}"
TOKEN = "a-token-of-more-than-16-characters"
DESIGN = {
    "poles": [[-20, 0], [-20, 0]],
    "numerator": {"kind": "lowpass"},
    "sampling": {"dt": 0.002, "method": "exact"},
}
FRIEND = {"origin": f"http://{HOST}", TOKEN_HEADER: TOKEN, "content-type": "application/json"}
# A design is answered in milliseconds; the machine may be busy with other tests.
SOON = 20.0
# An answer of a millisecond; where small packets are held back it takes 40.
PROMPT = 0.02


@dataclass
class Asked:
    status: int
    headers: Mapping[str, str]
    body: bytes

    @property
    def json(self) -> dict:
        return json.loads(self.body)


def ask(
    app, method: str = "POST", path: str = "/message", *, body=None, headers=FRIEND, host: str = HOST
) -> Asked:
    async def once() -> Asked:
        transport = httpx.ASGITransport(app=app)
        async with httpx.AsyncClient(transport=transport, base_url=f"http://{host}") as client:
            content = body if isinstance(body, bytes | str) or body is None else json.dumps(body)
            answer = await client.request(method, path, content=content, headers=headers)
            return Asked(answer.status_code, answer.headers, answer.content)

    return asyncio.run(once())


@pytest.fixture
def app():
    return create_app(Session(), port=PORT, token=TOKEN)


def hello() -> dict:
    return {"id": 1, "op": "hello"}


# -- friends --------------------------------------------------------------------------------------------------------


def test_a_friend_is_answered(app):
    reply = ask(app, body=hello()).json
    assert (reply["id"], reply["op"], reply["ok"]) == (1, "hello", True)
    assert reply["version"] == phyfilter_ctl.__version__


def test_localhost_is_the_same_host(app):
    host = f"localhost:{PORT}"
    assert ask(app, body=hello(), host=host, headers={**FRIEND, "origin": f"http://{host}"}).json["ok"]


def test_every_tab_has_a_session_of_its_own(app):
    tabs = [{**FRIEND, TAB_HEADER: name} for name in ("a" * 16, "b" * 16)]
    assert ask(
        app, body={"id": 1, "op": "design", "design": {**DESIGN, "poles": [[-7, 0]]}}, headers=tabs[0]
    ).json["ok"]
    shown = [ask(app, body=hello(), headers=headers).json["design"]["poles"] for headers in (*tabs, FRIEND)]
    assert shown == [[[-7, 0]], [[-20, 0], [-20, 0]], [[-20, 0], [-20, 0]]]
    for name in ("", "short", "../" * 8, "x" * 65):
        refused = ask(app, body=hello(), headers={**FRIEND, TAB_HEADER: name})
        assert (refused.status, "name of a tab" in refused.json["error"]) == (400, True)


def test_a_design_comes_back_with_its_figures(app):
    reply = ask(app, body={"id": 7, "op": "design", "design": DESIGN}).json
    expected = PhyFilter.from_poles([-20.0, -20.0])
    assert reply["ok"]
    assert reply["filter"]["a"] == pytest.approx(expected.a.tolist(), rel=1e-12)


def test_the_session_starts_with_the_filter_it_was_given():
    app = create_app(Session(PhyFilter.from_poles([-7.0])), port=PORT, token=TOKEN)
    assert ask(app, body=hello()).json["design"]["poles"] == [[-7.0, 0.0]]


@pytest.mark.parametrize(
    ("path", "kind"),
    [
        ("/", "text/html"),
        ("/page.js", "text/javascript"),
        ("/page_model.js", "text/javascript"),
        ("/page_shelf.js", "text/javascript"),
        ("/page.css", "text/css"),
        ("/designer.js", "text/javascript"),
        ("/designer.css", "text/css"),
    ],
)
def test_the_page_needs_no_token_and_holds_none(app, path, kind):
    answer = ask(app, "GET", path, headers={})
    assert answer.status == 200
    assert answer.headers["content-type"].startswith(kind)
    assert TOKEN.encode() not in answer.body


def test_the_page_names_nothing_off_the_machine():
    for name in ("page.html", "page.js", "page.css", "designer.js", "designer.css"):
        text = sent(name)
        addresses = set(re.findall(r"(?:https?:)?//[\w.-]+\.\w+[^\s\"']*", text)) - {
            "http://www.w3.org/2000/svg"
        }
        assert not {a for a in addresses if a.startswith(("http", "//"))}, name
        assert not name.endswith("css") or "@import" not in text


def test_every_answer_carries_the_security_headers(app):
    answers = [
        ask(app, "GET", "/"),
        ask(app, "GET", "/nothing"),
        ask(app, body=hello()),
        ask(app, "DELETE", "/"),
    ]
    for answer in [*answers, ask(app, body=hello(), headers={})]:
        policy = answer.headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["referrer-policy"] == "no-referrer"
        assert answer.headers["cache-control"] == "no-store"
        assert "frame-ancestors 'none'" in policy
        assert "access-control-allow-origin" not in answer.headers
        assert "set-cookie" not in answer.headers


# -- strangers ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changed", "status", "word"),
    [
        ({TOKEN_HEADER: "wrong"}, 401, "token"),
        ({TOKEN_HEADER: TOKEN[:-1]}, 401, "token"),
        ({TOKEN_HEADER: ""}, 401, "token"),
        ({TOKEN_HEADER: None}, 401, "token"),
        ({"origin": "http://example.org"}, 403, "Origin"),
        ({"origin": "null"}, 403, "Origin"),
        ({"origin": f"https://{HOST}"}, 403, "Origin"),
        ({"origin": f"http://127.0.0.1:{PORT + 1}"}, 403, "Origin"),
        ({"origin": None}, 403, "Origin"),
        ({"sec-fetch-site": "cross-site"}, 403, "site"),
        ({"sec-fetch-site": "same-site"}, 403, "site"),
        ({"content-type": "text/plain"}, 415, "Content-Type"),
        ({"content-type": "application/x-www-form-urlencoded"}, 415, "Content-Type"),
        ({"content-type": None}, 415, "Content-Type"),
    ],
)
def test_a_wrong_header_is_refused(app, changed, status, word):
    headers = {name: value for name, value in {**FRIEND, **changed}.items() if value is not None}
    answer = ask(app, body=hello(), headers=headers)
    assert answer.status == status
    assert not answer.json["ok"]
    assert word in answer.json["error"]
    assert TOKEN not in answer.json["error"]


@pytest.mark.parametrize(
    "host", ["example.org", f"example.org:{PORT}", "127.0.0.1", f"127.0.0.1:{PORT + 1}", "[::1]:8123"]
)
@pytest.mark.parametrize("method", ["GET", "POST"])
def test_a_foreign_name_for_this_machine_is_refused(app, host, method):
    answer = ask(
        app, method, "/" if method == "GET" else "/message", headers={**FRIEND, "host": host}, body="{}"
    )
    assert (answer.status, answer.json["ok"]) == (403, False)


def test_two_tokens_are_not_one(app):
    headers = [*FRIEND.items(), (TOKEN_HEADER, TOKEN)]
    assert ask(app, body=hello(), headers=headers).status == 401


def test_nothing_else_can_be_got(app):
    for method in ("GET", "PUT", "DELETE", "OPTIONS"):
        assert ask(app, method, "/message").status == 405
    for path in (
        "/handling.py",
        "/server.py",
        "/page",
        "/static/designer.js",
        "/web/designer.js",
        "/theme.js",
        "/mathematics/filter.js",
        "/jsconfig.json",
        "/designer.js/",
    ):
        assert ask(app, "GET", path).status == 404


TRICKS = [
    "/../pyproject.toml",
    "/..%2f..%2fetc/passwd",
    "/%2e%2e/server.py",
    "/designer.js/../server.py",
    "/\\..\\server.py",
    "//page.js",
]


@pytest.mark.parametrize("path", TRICKS)
def test_paths_do_not_reach_the_disk(app, path):
    """Raw: a client would tidy the path before it is sent."""
    sent = []

    async def send(message):
        sent.append(message)

    async def receive():
        return {"type": "http.request", "body": b"", "more_body": False}

    for plain in (path, path.replace("%2f", "/").replace("%2e", ".")):
        scope = {
            "type": "http", "asgi": {"version": "3.0"}, "http_version": "1.1", "method": "GET", "scheme": "http",
            "path": plain, "raw_path": path.encode(), "query_string": b"", "root_path": "", "client": None,
            "server": ("127.0.0.1", PORT), "headers": [(b"host", HOST.encode())],
        }  # fmt: skip
        asyncio.run(app(scope, receive, send))
    assert [message["status"] for message in sent if message["type"] == "http.response.start"] == [404, 404]


def test_web_sockets_are_closed(app):
    sent = []

    async def send(message):
        sent.append(message)

    async def receive():
        return {"type": "websocket.connect"}

    asyncio.run(app({"type": "websocket", "path": "/message", "headers": []}, receive, send))
    assert [message["type"] for message in sent] == ["websocket.close"]


# -- bodies ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "body",
    [
        "", "{", "[]", "1", '"hello"', "null", '{"id": 1, "op": "hello", "x": NaN}', '{"id": Infinity}',
        "[" * 100_000, '{"id": ' + "9" * 5000 + "}", b"\xff\xfe{}", b"\x80",
    ],
)  # fmt: skip
def test_no_message_no_answer(app, body):
    answer = ask(app, body=body)
    assert (answer.status, answer.json["ok"]) == (400, False)


def test_size_is_limited_by_what_a_message_carries(app):
    assert ask(app, body={**hello(), "x": "y" * 1_000_001}).status == 413
    log = base64.b64encode(b"t,vx\n" + b"0.000,1.0\n" * 90_000).decode()
    piece = {"id": 1, "op": "upload", "name": "long.csv", "size": 900_005, "at": 0}
    assert ask(app, body={**piece, "data": log}).status == 200
    assert ask(app, body={**piece, "data": "x" * 25_000_000}).status == 413


@pytest.mark.parametrize("length", ["25000001", "9" * 30, "-1", "many"])
def test_a_length_is_refused_before_the_body_is_read(app, length):
    assert ask(app, body=b"{}", headers={**FRIEND, "content-length": length}).status == 413


def test_a_body_without_end_is_cut_off(app):
    async def endless():
        while True:
            yield b" " * 1_000_000

    async def once():
        async with httpx.AsyncClient(
            transport=httpx.ASGITransport(app=app), base_url=f"http://{HOST}"
        ) as client:
            return await client.post("/message", content=endless(), headers=FRIEND)

    assert asyncio.run(once()).status_code == 413


def test_a_slow_body_is_given_up(app, monkeypatch):
    monkeypatch.setattr(server, "BODY_SECONDS", 0.1)

    async def slow():
        yield b"{"
        await asyncio.sleep(SOON)

    async def once():
        async with httpx.AsyncClient(
            transport=httpx.ASGITransport(app=app), base_url=f"http://{HOST}"
        ) as client:
            return await client.post("/message", content=slow(), headers=FRIEND)

    assert asyncio.run(once()).status_code == 408


@pytest.mark.parametrize(
    "change",
    [
        {"poles": [[-1, 0]] * 1000},
        {"poles": []},
        {"poles": [[1e400, 0]]},
        {"poles": [[1, 0]]},
        {"poles": "poles"},
        {"sampling": {"dt": 0, "method": "exact"}},
        {"sampling": {"dt": 0.002, "method": "../../etc/passwd"}},
        {"numerator": {"kind": "b", "b": [None, None]}},
    ],
)
def test_a_hostile_design_is_an_error_and_no_crash(app, change):
    body = json.dumps({"id": 3, "op": "design", "design": {**DESIGN, **change}}).replace("Infinity", "1e400")
    reply = ask(app, body=body).json
    assert (reply["id"], reply["ok"]) == (3, False)
    assert len(reply["error"]) > 10
    assert "Traceback" not in reply["error"]


# -- threads --------------------------------------------------------------------------------------------------------


@pytest.fixture
def slow(monkeypatch) -> Iterator[tuple[threading.Event, list[int]]]:
    """Designs that last until told, and how many ran at once; other ops answer at once."""
    release, running, most = threading.Event(), [0], [0]

    def handle(session, message):
        if message["op"] in ("design", "estimate"):
            running[0] += 1
            most[0] = max(most[0], running[0])
            release.wait(SOON)
            running[0] -= 1
        return {"id": message["id"], "op": message["op"], "ok": True}

    monkeypatch.setattr(server, "handle", handle)
    yield release, most
    release.set()


def together(app, messages: list[dict], meanwhile: Callable[[], None] = lambda: None) -> list[dict]:
    async def all_of_them():
        async with httpx.AsyncClient(
            transport=httpx.ASGITransport(app=app), base_url=f"http://{HOST}"
        ) as client:
            tasks = [asyncio.create_task(client.post("/message", json=m, headers=FRIEND)) for m in messages]
            await asyncio.sleep(0.2)
            meanwhile()
            return [(await task).json() for task in tasks]

    return asyncio.run(all_of_them())


def test_one_design_at_a_time_and_jobs_meanwhile(app, slow):
    release, most = slow
    messages = [{"id": i, "op": "design"} for i in range(4)] + [{"id": 9, "op": "job"}]
    order = []

    async def run():
        async with httpx.AsyncClient(
            transport=httpx.ASGITransport(app=app), base_url=f"http://{HOST}"
        ) as client:

            async def one(message):
                order.append((await client.post("/message", json=message, headers=FRIEND)).json()["id"])
                release.set()

            await asyncio.gather(*(one(message) for message in messages))

    asyncio.run(run())
    assert order[0] == 9
    assert sorted(order) == [0, 1, 2, 3, 9]
    assert most == [1]


def test_the_queue_is_short(app, slow):
    release, _ = slow
    count = server.WAITING + 3
    replies = together(app, [{"id": i, "op": "design"} for i in range(count)], release.set)
    assert sum(not reply["ok"] for reply in replies) == 3
    assert all("busy" in reply["error"] for reply in replies if not reply["ok"])


def test_time_is_limited(monkeypatch, slow):
    monkeypatch.setitem(server._SECONDS, "design", 0.1)
    app = create_app(Session(), port=PORT, token=TOKEN)
    reply = ask(app, body={"id": 1, "op": "design"}).json
    assert (reply["id"], reply["ok"]) == (1, False)
    assert "no answer within 0.1 s" in reply["error"]


# -- copies of downloads --------------------------------------------------------------------------------------------


def save(app, name: str = "mine") -> dict:
    return ask(app, body={"id": 1, "op": "save", "design": DESIGN, "name": name}).json


@pytest.fixture
def keeping(tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    return folder, create_app(Session(), port=PORT, token=TOKEN, out=folder)


@pytest.mark.parametrize(
    "name", ["mine", "../../escape", "/etc/cron.d/x", "..", "a\x00b", ".bashrc", "CON", "x" * 150]
)
def test_copies_have_fixed_names(keeping, name, tmp_path):
    folder, app = keeping
    reply = save(app, name)
    if reply["ok"]:
        assert "/" not in reply["name"]
        assert "\\" not in reply["name"]
        assert not reply["name"].startswith(".")
        kept = f"filter-{reply['digest']}.toml"
        assert (folder / kept).read_bytes() == base64.b64decode(reply["base64"])
        assert reply["written"] == str(folder / kept)
        assert re.fullmatch(r"filter-[0-9a-f]{8}\.toml", kept)
        assert {path.name for path in tmp_path.rglob("*")} == {"out", kept}
    else:
        assert {path.name for path in tmp_path.rglob("*")} == {"out"}


def copied(app, folder: Path) -> Path:
    """Where the design's copy goes, which is not there yet."""
    path = Path(save(app)["written"])
    assert path.parent == folder
    path.unlink()
    return path


def test_links_are_replaced_not_followed(keeping, tmp_path):
    folder, app = keeping
    kept = copied(app, folder)
    precious = tmp_path / "precious"
    precious.write_text("untouched")
    try:
        kept.symlink_to(precious)
    except OSError:
        pytest.skip("symbolic links cannot be made here")
    assert save(app)["ok"]
    assert precious.read_text() == "untouched"
    assert not kept.is_symlink()


def test_a_copy_that_cannot_be_written_is_said(keeping):
    folder, app = keeping
    kept = copied(app, folder)
    kept.mkdir()
    reply = save(app)
    assert not reply["ok"]
    assert str(folder) in reply["error"]
    assert list(folder.iterdir()) == [kept]


def test_without_out_nothing_is_written(app, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert "written" not in save(app)
    assert list(tmp_path.iterdir()) == []


def test_bad_arguments_are_refused(tmp_path):
    with pytest.raises(ValueError, match="16 characters"):
        create_app(Session(), port=PORT, token="short")
    with pytest.raises(ValueError, match="existing folder"):
        create_app(Session(), port=PORT, token=TOKEN, out=tmp_path / "none")


# -- the real thing -------------------------------------------------------------------------------------------------

_SERVE = """
import sys
from pathlib import Path
from phyfilter_ctl.app.handling import Session
from phyfilter_ctl.app.server import serve
from threadpoolctl import threadpool_info
import phyfilter_ctl.app.server as server
answer = server.handle
def told(session, message):
    reply = answer(session, message)
    return {**reply, "threads": max(p["num_threads"] for p in threadpool_info())}
server.handle = told
try:
    serve(Session(), browser=False)
except KeyboardInterrupt:
    print("closed")
"""
# Long enough for who is in no hurry on a busy machine; the tests wait for it.
DAWDLING = 2.0
_IMPATIENT = f"""
import phyfilter_ctl.app.lines as lines
import phyfilter_ctl.app.server as server
server.BODY_SECONDS = {DAWDLING}
lines.HEAD_SECONDS = lines.READ_SECONDS = {DAWDLING}
lines.BODY_SECONDS = {2.0 * DAWDLING}
"""


@pytest.fixture
def served() -> Iterator[tuple[subprocess.Popen[str], int, str]]:
    yield from running(_SERVE)


@pytest.fixture
def impatient() -> Iterator[tuple[subprocess.Popen[str], int, str]]:
    yield from running(_IMPATIENT + _SERVE)


def running(script: str) -> Iterator[tuple[subprocess.Popen[str], int, str]]:
    environment = {**os.environ, "PYTHONPATH": str(Path(phyfilter_ctl.__file__).parents[1])}
    process = subprocess.Popen(
        [sys.executable, "-c", script],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    )
    try:
        assert process.stdout is not None
        found = re.search(r"http://127\.0\.0\.1:(\d+)/#token=([\w-]+)", process.stdout.readline())
        assert found
        yield process, int(found[1]), found[2]
    finally:
        process.kill()
        process.communicate()


def times_on_one_line(port: int, token: str, count: int) -> list[float]:
    """Seconds from a small question to its answer, one connection."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=SOON)
    headers = {"origin": f"http://127.0.0.1:{port}", TOKEN_HEADER: token, "content-type": "application/json"}
    times = []
    for _ in range(count):
        before = time.perf_counter()
        connection.request("POST", "/message", json.dumps({"id": 1, "op": "job", "job": 1}), headers)
        connection.getresponse().read()
        times.append(time.perf_counter() - before)
    connection.close()
    return times


def over_http(port: int, token: str, message: dict) -> dict:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=SOON)
    headers = {"origin": f"http://127.0.0.1:{port}", TOKEN_HEADER: token, "content-type": "application/json"}
    connection.request("POST", "/message", json.dumps(message), headers)
    try:
        return json.loads(connection.getresponse().read())
    finally:
        connection.close()


@pytest.mark.skipif(os.name != "posix", reason="signals are sent as POSIX has them")
def test_the_real_server_answers_on_loopback_only_and_ends_cleanly(served):
    process, port, token = served
    assert len(token) >= 43  # 256 bits
    reply = over_http(port, token, {"id": 1, "op": "design", "design": DESIGN})
    assert reply["ok"]
    assert reply["threads"] == 1
    assert not over_http(port, "x" * 43, hello())["ok"]
    assert min(times_on_one_line(port, token, 20)) < PROMPT
    for family, address in ((socket.AF_INET, "127.0.0.2"), (socket.AF_INET6, "::1")):
        with socket.socket(family) as other:
            other.settimeout(1.0)
            assert other.connect_ex((address, port)) != 0
    # Neither a second request on a line kept open nor nonsense on the wire holds it up.
    with socket.create_connection(("127.0.0.1", port), timeout=SOON) as raw:
        raw.sendall(b"\x16\x03\x01 nonsense\r\n\r\n")
        assert b"400" in raw.recv(1000)
    with socket.create_connection(("127.0.0.1", port), timeout=SOON):
        before = time.perf_counter()
        process.send_signal(signal.SIGINT)
        said, complained = process.communicate(timeout=SOON)
    assert time.perf_counter() - before < 5.0
    assert process.returncode == 0
    assert said.splitlines()[-1] == "closed"
    # A busy machine closes the idle line only as the time given to it runs out, and uvicorn says so.
    assert [line for line in complained.splitlines() if "graceful shutdown exceeded" not in line] == []


HALF = b"GET / HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nX-Half: "


def line_to(port: int, sent: bytes, **size: int) -> socket.socket:
    """A connection on which something has been sent."""
    line = socket.socket()
    if size:  # before it connects, or the window is agreed already
        line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, size["buffer"])
    line.settimeout(SOON)
    line.connect(("127.0.0.1", port))
    line.sendall(sent)
    return line


def rest(line: socket.socket) -> bytes:
    """All that comes until the other side closes; fails if it does not."""
    got = bytearray()
    try:
        while part := line.recv(1 << 20):
            got += part
    except ConnectionError:  # what is dropped with bytes unread is reset
        pass
    line.close()
    return bytes(got)


def test_half_sent_headers_keep_nobody_out(served):
    process, port, token = served
    crowd = [line_to(port, HALF % port) for _ in range(150)]
    assert over_http(port, token, hello())["ok"]
    assert over_http(port, token, {"id": 1, "op": "design", "design": DESIGN})["ok"]
    # Nor do bodies that do not come: strangers' are refused unread, and one who waits is not thrown out by the crowd.
    posted = b"POST /message HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nContent-Length: 9\r\n\r\n" % port
    crowd += [line_to(port, posted) for _ in range(150)]
    assert over_http(port, token, hello())["ok"]
    many = b"".join(b"X-%d: y\r\n" % i for i in range(100))
    for headers in (many, b"X-Long: " + b"y" * 20_000 + b"\r\n"):
        refused = rest(line_to(port, b"GET / HTTP/1.1\r\nHost: 127.0.0.1:%d\r\n%s\r\n" % (port, headers)))
        assert re.match(rb"HTTP/1.1 4(00|31) ", refused)
    for line in crowd:
        line.close()
    assert over_http(port, token, hello())["ok"]
    assert process.poll() is None


@pytest.mark.slow
def test_clients_that_dawdle_are_dropped(impatient):
    """At each stage of a request; one that is prompt is answered meanwhile, over and over on one connection."""
    _, port, token = impatient
    head = b"POST /message HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nOrigin: http://127.0.0.1:%d\r\n" % (port, port)
    head += b"%s: %s\r\nContent-Type: application/json\r\n" % (TOKEN_HEADER.encode(), token.encode())
    page = b"GET /designer.js HTTP/1.1\r\nHost: 127.0.0.1:%d\r\n" % port
    began = time.monotonic()
    silent = line_to(port, b"")
    half = line_to(port, HALF % port)
    body = line_to(port, head + b"Content-Length: 100\r\n\r\n{")
    unasked = line_to(port, page + b"Content-Length: 100\r\n\r\n{")
    again = line_to(port, page + b"\r\n" + HALF % port)
    unread = line_to(port, (page + b"\r\n") * 100, buffer=10_000)
    kept = http.client.HTTPConnection("127.0.0.1", port, timeout=SOON)
    while time.monotonic() - began < DAWDLING:
        with suppress(OSError):
            half.sendall(b"y")  # a byte now and then is not enough
        kept.request("GET", "/page.css", headers={"host": f"127.0.0.1:{port}"})
        assert len(kept.getresponse().read()) > 100
        time.sleep(0.1)
    kept.close()
    page_size = len(sent("designer.js"))
    assert rest(silent) == b""
    assert rest(half) == b""
    assert rest(body).startswith(b"HTTP/1.1 408")
    assert rest(unasked).startswith(b"HTTP/1.1 200")
    assert rest(again).startswith(b"HTTP/1.1 200")
    assert time.monotonic() - began < 2.0 * DAWDLING + SOON
    time.sleep(max(0.0, began + 2.0 * DAWDLING - time.monotonic()))
    assert len(rest(unread)) < 100 * page_size
    assert over_http(port, token, hello())["ok"]


def options(**given: object):
    import argparse

    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    arguments = [text for key, value in given.items() for text in (f"--{key}", str(value))]
    return parser.parse_args(arguments)


def test_the_command_starts_from_files(tmp_path, monkeypatch):
    phyfilter_ctl.save(tmp_path / "filter.toml", PhyFilter.from_poles([-5.0, -6.0]))
    (tmp_path / "flight.csv").write_text("t,vx,vy,vz\n0,0,0,0\n0.01,1,1,1\n0.02,2,2,2\n")
    (tmp_path / "out").mkdir()
    seen = {}

    def serve(session, **given):
        seen.update(given, session=session)

    monkeypatch.setattr(server, "serve", serve)
    given = options(log=tmp_path / "flight.csv", out=tmp_path / "out", port=0)
    given.file, given.no_browser = str(tmp_path / "filter.toml"), True
    assert command.main(given) == 0
    app = create_app(seen["session"], port=PORT, token=TOKEN)
    reply = ask(app, body=hello()).json
    assert sorted(p[0] for p in reply["design"]["poles"]) == pytest.approx([-6.0, -5.0], rel=1e-12)
    assert reply["log"]["samples"] == 3
    assert (seen["browser"], seen["out"]) == (False, tmp_path / "out")


def test_the_command_says_what_is_missing(monkeypatch, tmp_path):
    with pytest.raises(ValueError, match="no folder"):
        command.main(options(out=tmp_path / "none"))
    with pytest.raises(ValueError, match="65535"):
        command.main(options(port=70000))
    for name in [name for name in sys.modules if name == "uvicorn" or name == "phyfilter_ctl.app.server"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    monkeypatch.delattr("phyfilter_ctl.app.server")
    with pytest.raises(ValueError, match=r"pip install 'phyfilter-ctl\[app\]'"):
        command.main(options())
