"""The designer as a page of one's own: an ASGI application that answers one browser on this machine.

What keeps others out: the socket is bound to 127.0.0.1; a random token, which travels in the fragment of the address
and in a header, never in a cookie or a query; the Host and Origin of every request are compared; and a content
security policy allows the page nothing but its own files and this server (guard.py). Clients that dawdle are
dropped (lines.py).
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
import secrets
import socket
import threading
import webbrowser
from collections.abc import AsyncIterator, Callable, Mapping
from functools import partial
from pathlib import Path
from typing import NoReturn

import anyio
import anyio.to_thread
import uvicorn
from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response
from starlette.routing import Route
from starlette.types import ASGIApp
from threadpoolctl import threadpool_limits

from .._output import replacing
from . import exports
from .guard import LARGEST_HEAD, TOKEN_HEADER, Guard, RefusedError, refusal
from .handling import Session, handle
from .lines import Line
from .modules import sent
from .tabs import TAB_HEADER, Tabs, is_tab

__all__ = ["TOKEN_HEADER", "create_app", "serve"]

LARGEST_LOG = 25_000_000  # bytes of a request that carries a recording
LARGEST_OTHER = 1_000_000  # bytes of any other
QUICKLY_READ = 100_000  # bytes of JSON that are read without a thread
USUAL_PORTS = range(8463, 8471)  # below those that systems give away: a browser finds its work again there
BODY_SECONDS = 30.0  # a request must have arrived by then
WAITING = (
    8  # requests of one kind that may queue (the page sends one at a time); all fit in anyio's 40 threads
)

# The only files there are to get: no path of a request ever reaches the file system.
_FILES = {
    "/": ("page.html", "text/html"),
    "/page.js": ("page.js", "text/javascript"),
    "/page_model.js": ("page_model.js", "text/javascript"),
    "/page_shelf.js": ("page_shelf.js", "text/javascript"),
    "/page.css": ("page.css", "text/css"),
    "/designer.js": ("designer.js", "text/javascript"),
    "/designer.css": ("designer.css", "text/css"),
}
# Which computations wait for each other; a lane is a thread, so a long export does not hold up the next design.
_LANES = {
    "log": ("forget", "estimate", "learn", "measured"),
    "import": ("upload", "preview", "import", "example"),
    "job": ("job", "cancel"),
    "export": ("export", "exports", "report"),
    "compare": ("compare",),
    "meet": ("meet", "front", "unmeet"),
    "loop": ("loop", "locus", "responses"),
}
_SECONDS = {
    "design": 30.0,
    "log": 60.0,
    "import": 600.0,
    "job": 10.0,
    "export": 180.0,
    "compare": 30.0,
    "meet": 10.0,
    "loop": 30.0,
}
_LARGE = frozenset({"session", "upload"})
# What is written under --out: the name comes from here and from the design, never from a request.
_NAMES = {
    "save": "filter-{}.toml",
    "fmu2": "filter_fmi2-{}.fmu",
    "fmu3": "filter_fmi3-{}.fmu",
} | {kind: f"filter_{kind}-{{}}.zip" for kind in exports.KINDS if not kind.startswith("fmu")}

Reply = dict[str, object]


# -- what is answered -----------------------------------------------------------------------------------------------


class _Lane:
    """One computation at a time."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self._turn = threading.Lock()
        self._count = threading.Lock()
        self._waiting = 0

    def enter(self) -> bool:
        """Take a place in the queue; false if it is full."""
        with self._count:
            if self._waiting >= WAITING:
                return False
            self._waiting += 1
            return True

    def run(self, work: Callable[[], str]) -> str:
        """Work in this thread, in turn; what was given up on still holds its turn until it ends."""
        try:
            with self._turn:
                return work()
        finally:
            with self._count:
                self._waiting -= 1


class _Desk:
    """Takes messages off requests, has them answered in threads, keeps copies of downloads."""

    def __init__(self, tabs: Tabs, out: Path | None) -> None:
        self._tabs = tabs
        self._out = out
        self._lanes = {name: _Lane(seconds) for name, seconds in _SECONDS.items()}
        self._lane_of = {op: name for name, ops in _LANES.items() for op in ops}

    async def message(self, request: Request) -> Response:
        try:
            tab = request.headers.get(TAB_HEADER)
            if tab is not None and not is_tab(tab):
                raise RefusedError(400, "wrong name of a tab: expected 16 to 64 letters and digits")
            body = await _body(request)
            small = len(body) <= QUICKLY_READ
            message = _message(body) if small else await anyio.to_thread.run_sync(_message, body)
            return _json(await self._answer(message, tab))
        except RefusedError as refused:
            return refusal(refused)

    async def _answer(self, message: dict[str, object], tab: str | None) -> str:
        op = message.get("op")
        lane = self._lanes[self._lane_of.get(op, "design") if isinstance(op, str) else "design"]
        if not lane.enter():
            return _text(_failed(message, "Python is busy: wait for its answers, then try again"))
        # All of it in one thread: on a busy machine every change of threads costs milliseconds.
        work = partial(self._work, message, tab)
        try:
            with anyio.fail_after(lane.seconds):
                return await anyio.to_thread.run_sync(lane.run, work, abandon_on_cancel=True)
        except TimeoutError:
            error = f"no answer within {lane.seconds:g} s: use fewer poles or a shorter recording"
            return _text(_failed(message, error))

    def _work(self, message: dict[str, object], tab: str | None) -> str:
        reply = handle(self._tabs.of(tab), message)
        return _text(reply if self._out is None else self._keep(message, reply))

    def _keep(self, message: Mapping[str, object], reply: Reply) -> Reply:
        """Write a download under the folder of --out too."""
        kind = message.get("kind") if message.get("op") == "export" else message.get("op")
        data = reply.get("base64")
        if not reply.get("ok") or kind not in _NAMES or not isinstance(data, str) or self._out is None:
            return reply
        try:
            path = self._out / _NAMES[str(kind)].format(reply["digest"])
            with replacing(path, follow_links=False) as file:
                file.write(base64.b64decode(data))
        except OSError as error:
            return _failed(message, f"{self._out}: {error.strerror or 'cannot be written'}")
        return {**reply, "written": str(path)}


async def _body(request: Request) -> bytes:
    """The whole body, or a refusal as soon as it is too long or too slow."""
    length = request.headers.get("content-length", "0")
    if not length.isdecimal() or len(length) > 12 or int(length) > LARGEST_LOG:
        raise _too_large(LARGEST_LOG)
    parts, total = [], 0
    try:
        with anyio.fail_after(BODY_SECONDS):
            async for part in request.stream():
                total += len(part)
                if total > LARGEST_LOG:
                    raise _too_large(LARGEST_LOG)
                parts.append(part)
    except TimeoutError:
        raise RefusedError(408, f"the request did not arrive within {BODY_SECONDS:g} s") from None
    except ClientDisconnect:
        raise RefusedError(400, "the browser went away") from None
    return b"".join(parts)


def _message(body: bytes) -> dict[str, object]:
    """The JSON object of a request."""
    try:
        message = json.loads(body.decode(), parse_constant=_refuse_constant)
    except (
        ValueError,
        RecursionError,
    ):  # not UTF-8, not JSON, NaN, a number of 5000 digits, nested without end
        raise RefusedError(400, "expected a JSON object of finite numbers, in UTF-8") from None
    if not isinstance(message, dict):
        raise RefusedError(400, f"expected a JSON object, got {type(message).__name__}")
    if len(body) > LARGEST_OTHER and message.get("op") not in _LARGE:
        raise _too_large(LARGEST_OTHER)
    return message


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(name)


def _too_large(limit: int) -> RefusedError:
    return RefusedError(413, f"the request is larger than {limit / 1e6:g} MB")


def _failed(message: Mapping[str, object], error: str) -> Reply:
    return {"id": message.get("id"), "op": message.get("op"), "ok": False, "error": error}


def _text(reply: Reply) -> str:
    return json.dumps(reply, allow_nan=False, separators=(",", ":"))


def _json(text: str, status: int = 200) -> Response:
    return Response(text, status, media_type="application/json")


# -- the application ------------------------------------------------------------------------------------------------


def create_app(session: Session, *, port: int, token: str, out: Path | None = None) -> ASGIApp:
    """The ASGI application of one designer.

    Parameters
    ----------
    session : Session
        What the designer starts from: every tab of the browser has a session of its own that starts like this one.
    port : int
        Port of 127.0.0.1 that it will be served at: the Host and Origin of a request must name it.
    token : str
        Secret that requests must carry in the header ``x-phyfilter-token``; at least 16 characters.
    out : Path, optional
        Existing folder that gets a copy of every download, under fixed names; None for downloads only.

    Raises
    ------
    ValueError
        If the token is short or ``out`` is no folder.

    Examples
    --------
    >>> import secrets
    >>> from phyfilter_ctl.app.handling import Session
    >>> app = create_app(Session(), port=8000, token=secrets.token_urlsafe(32))
    """
    if len(token) < 16:
        raise ValueError(f"expected a token of 16 characters or more, got {len(token)}")
    if out is not None and not out.is_dir():
        raise ValueError(f"{out}: expected an existing folder")
    tabs = Tabs(session)
    desk = _Desk(tabs, out.resolve() if out is not None else None)

    @contextlib.asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        yield
        tabs.close()

    routes = [Route(path, _file, methods=["GET"]) for path in _FILES]
    routes.append(Route("/message", desk.message, methods=["POST"]))
    app = Starlette(routes=routes, lifespan=lifespan)
    app.router.redirect_slashes = False
    return Guard(app, port=port, token=token)


async def _file(request: Request) -> Response:
    name, kind = _FILES[request.url.path]
    return Response(await anyio.to_thread.run_sync(sent, name), media_type=kind)


def serve(
    session: Session,
    *,
    port: int = 0,
    out: Path | None = None,
    browser: bool = True,
    token: str | None = None,
) -> None:
    """Serve the designer on 127.0.0.1 until a signal ends it, with one BLAS thread.

    Prints the address, whose fragment is the token.

    Parameters
    ----------
    session : Session
        What every tab of the browser starts from; learning jobs are cancelled at the end.
    port : int
        Port; 0 for a free one, the same as the last time where that can be: what the browser keeps it keeps for an
        address.
    out : Path, optional
        Existing folder that gets a copy of every download.
    browser : bool
        Open the address in the browser.
    token : str, optional
        Secret of the address; None for a random one of 256 bits.

    Raises
    ------
    ValueError
        If ``port`` is no port or ``out`` is no folder.
    OSError
        If the port is taken.
    KeyboardInterrupt
        On Ctrl-C, once the server has closed.
    """
    if not 0 <= port <= 65535:
        raise ValueError(f"port: expected 0 to 65535, got {port}")
    token = secrets.token_urlsafe(32) if token is None else token
    # Named as TCP, or the event loop does not switch off the delay of small packets: 40 ms on every answer.
    with (
        socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP) as listener,
        threadpool_limits(limits=1),
    ):
        if os.name == "posix":  # elsewhere this option lets two programs share a port
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        _listen(listener, port)  # from here on a browser waits instead of failing
        port = listener.getsockname()[1]
        config = uvicorn.Config(
            create_app(session, port=port, token=token, out=out),
            log_config=None,
            log_level="error",
            access_log=False,
            server_header=False,
            proxy_headers=False,
            ws="none",
            lifespan="on",
            http=Line,
            h11_max_incomplete_event_size=LARGEST_HEAD,
            timeout_keep_alive=30,
            timeout_graceful_shutdown=1,
        )
        address = f"http://127.0.0.1:{port}/#token={token}"
        print(f"the designer is at {address}\nCtrl-C ends it", flush=True)
        if browser:  # a browser that runs in the terminal would never return
            threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
        uvicorn.Server(config).run(sockets=[listener])  # hands a signal on once it has closed


def _listen(listener: socket.socket, port: int) -> None:
    """At the port, or for 0 at the first of the usual ones that nobody has, or at any."""
    for usual in USUAL_PORTS if port == 0 else ():
        with contextlib.suppress(OSError):
            listener.bind(("127.0.0.1", usual))
            listener.listen()
            return
    listener.bind(("127.0.0.1", port))
    listener.listen()
