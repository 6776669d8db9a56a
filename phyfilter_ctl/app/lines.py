"""Connections to the designer's server: clients that dawdle are dropped, and a crowd of them keeps nobody out."""

from __future__ import annotations

import asyncio

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

__all__ = ["Line"]

MOST_LINES = 128  # at once
HEAD_SECONDS = (
    10.0  # the headers of a request must have arrived by then, from the first byte or the connection on
)
BODY_SECONDS = 40.0  # its body, from then on: longer than the application waits, which says why it refuses
READ_SECONDS = 30.0  # an answer that waits for the client must have gone on by then

# What h11 calls waiting for the headers of a request, for its body, and a connection that is being closed.
_INCOMPLETE = (h11.IDLE, h11.SEND_BODY, h11.CLOSED, h11.ERROR)


class Line(H11Protocol):
    """One connection.

    Headers, body and the client's reading have their time, however many bytes trickle in. Where there are too many
    connections, the new one takes the place of the one that has kept the server waiting longest: of those that have
    sent no request yet, else of those between two requests, else of those whose request is not all there.
    """

    _watched: object = None  # what of a request is being waited for, as h11 calls it
    _late: asyncio.TimerHandle | None = None
    _unread: asyncio.TimerHandle | None = None
    _since = 0.0

    def connection_made(self, transport: asyncio.Transport) -> None:
        """A new connection; one of too many is dropped."""
        super().connection_made(transport)
        self._since = self.loop.time()
        self._watch()
        lines = [line for line in self.connections if isinstance(line, Line)]
        if len(lines) > MOST_LINES:
            waiting = [line for line in lines if line is not self and line.conn.their_state in _INCOMPLETE]
            min(waiting, default=self, key=Line._patience).drop()

    def data_received(self, data: bytes) -> None:
        """A part of a request has come."""
        super().data_received(data)
        self._watch()

    def on_response_complete(self) -> None:
        """The next request has its own time."""
        super().on_response_complete()
        self._since = self.loop.time()
        if self.conn.their_state is h11.IDLE and not self.conn.trailing_data[0]:
            self._watched = None  # uvicorn closes it if the next request is long in coming
            self._cancel()
        else:
            self._watch()

    def pause_writing(self) -> None:
        """The client reads slowly: it has its time."""
        super().pause_writing()
        self._unread = self.loop.call_later(READ_SECONDS, self.drop)

    def resume_writing(self) -> None:
        """The client has read."""
        super().resume_writing()
        if self._unread is not None:
            self._unread.cancel()

    def connection_lost(self, exc: Exception | None) -> None:
        """Nothing is waited for any more."""
        self._cancel()
        if self._unread is not None:
            self._unread.cancel()
        super().connection_lost(exc)

    def drop(self) -> None:
        """Close the connection without another word, whatever is still to be sent."""
        self.connections.discard(self)  # at once: it is counted no longer
        self.transport.abort()

    def _patience(self) -> tuple[bool, bool, float]:
        """Who has least is the first to go."""
        return self.conn.their_state is h11.SEND_BODY, self.cycle is not None, self._since

    def _watch(self) -> None:
        """Set the time limit of what is being waited for; more of the same does not extend it."""
        state = self.conn.their_state
        if state is self._watched:
            return
        self._cancel()
        self._watched = state
        seconds = {h11.IDLE: HEAD_SECONDS, h11.SEND_BODY: BODY_SECONDS}.get(state)
        if seconds is not None:
            self._late = self.loop.call_later(seconds, self.drop)

    def _cancel(self) -> None:
        if self._late is not None:
            self._late.cancel()
