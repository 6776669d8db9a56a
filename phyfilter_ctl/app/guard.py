"""Who may ask the designer's page for anything, and what every answer carries."""

from __future__ import annotations

import hmac
import json

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

__all__ = ["TOKEN_HEADER", "Guard", "RefusedError", "refusal"]

TOKEN_HEADER = "x-phyfilter-token"
MOST_HEADERS, LARGEST_HEAD = 64, 16_384  # of a request; bytes of them all
_HEADERS = {
    "content-security-policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src 'self' data:; font-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cache-control": "no-store",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
}


class RefusedError(Exception):
    """A request that is not answered.

    Parameters
    ----------
    status : int
        HTTP status.
    reason : str
        One sentence.
    """

    def __init__(self, status: int, reason: str) -> None:
        super().__init__(reason)
        self.status = status


def refusal(refused: RefusedError) -> Response:
    """The answer to a request that is refused.

    Parameters
    ----------
    refused : RefusedError

    Returns
    -------
    Response
        A message that is not ok.
    """
    # The rest of a refused body is not waited for.
    close = {"connection": "close"}
    text = json.dumps({"id": None, "op": None, "ok": False, "error": str(refused)})
    return Response(text, refused.status, headers=close, media_type="application/json")


class Guard:
    """Refuses strangers before anything is read, and puts the security headers on every answer.

    Parameters
    ----------
    app : ASGIApp
        What answers friends.
    port : int
        Port of 127.0.0.1 that requests must name as their Host and Origin.
    token : str
        Secret that they must carry, but for reading the page's files.
    """

    def __init__(self, app: ASGIApp, *, port: int, token: str) -> None:
        self._app = app
        self._hosts = (f"127.0.0.1:{port}", f"localhost:{port}")
        self._token = token.encode()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            return await self._app(scope, receive, send)
        if scope["type"] != "http":  # there are no web sockets here
            return await send({"type": "websocket.close", "code": 1008})

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(_HEADERS)
            await send(message)

        try:
            self._check(scope["method"], Headers(scope=scope))
        except RefusedError as refused:
            return await refusal(refused)(scope, receive, send_guarded)
        await self._app(scope, receive, send_guarded)

    def _check(self, method: str, headers: Headers) -> None:
        if len(headers) > MOST_HEADERS or sum(map(len, (*headers.keys(), *headers.values()))) > LARGEST_HEAD:
            raise RefusedError(431, f"expected at most {MOST_HEADERS} headers of {LARGEST_HEAD} bytes in all")
        host = _single(headers, "host")
        if host not in self._hosts:  # a foreign name that resolves to this machine
            raise RefusedError(403, f"wrong Host: expected {self._hosts[0]}")
        if method in ("GET", "HEAD"):
            return
        if _single(headers, "origin") != f"http://{host}":
            raise RefusedError(403, f"wrong Origin: expected http://{host}")
        if headers.get("sec-fetch-site", "same-origin") != "same-origin":
            raise RefusedError(403, "the request comes from another site")
        if not hmac.compare_digest((_single(headers, TOKEN_HEADER) or "").encode(), self._token):
            raise RefusedError(
                401, "wrong or missing token: open the address that phyfilter-ctl app printed, to its end"
            )
        if (_single(headers, "content-type") or "").split(";")[0].strip().lower() != "application/json":
            raise RefusedError(415, "wrong Content-Type: expected application/json")


def _single(headers: Headers, name: str) -> str | None:
    """The value of a header that must stand once."""
    values = headers.getlist(name)
    return values[0] if len(values) == 1 else None
