"""How connections to the studio are read: fairly, and without a traceback for what is malformed."""

import asyncio
import logging
from collections import deque
from contextlib import suppress

import uvicorn
from fastapi import FastAPI
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

FRAME_BYTES = 2_000_000
"""The most that one message of a page may have."""
_REQUEST_PIECE, _MESSAGE_PIECE = 16_384, 4096
_AT_ONCE, _PAUSE_S = 4, 0.01
"""New connections that are first read at once, and the pause before the next ones."""


def configuration(app: FastAPI) -> uvicorn.Config:
    """How an application is served.

    Parameters
    ----------
    app
        It.
    """
    turns = _Turns()

    class Requests(H11Protocol):
        def connection_made(  # type: ignore[override]  # as uvicorn's own
            self, transport: asyncio.Transport
        ) -> None:
            _read_by(transport, _REQUEST_PIECE)
            super().connection_made(transport)
            turns.add(transport)

    config = uvicorn.Config(
        app,
        http=Requests,
        ws=_Messages,
        log_level="error",
        access_log=False,
        server_header=False,
        ws_max_size=FRAME_BYTES,
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=1,
        proxy_headers=False,
        lifespan="on",
    )
    logging.getLogger("uvicorn.error").addFilter(is_ours)
    return config


class _Turns:
    """New connections, of which some are read at once, and the next ones after a pause.

    Two hundred requests at once take a tenth of a second, in which no one else would be answered.
    """

    def __init__(self) -> None:
        self._waiting: deque[asyncio.Transport] = deque()
        self._begun = 0

    def add(self, transport: asyncio.Transport) -> None:
        """Read a connection when it is its turn."""
        if self._begun == 0:
            asyncio.get_running_loop().call_later(_PAUSE_S, self._next)
        if self._begun < _AT_ONCE:
            self._begun += 1
        else:
            transport.pause_reading()
            self._waiting.append(transport)

    def _next(self) -> None:
        self._begun = min(_AT_ONCE, len(self._waiting))
        for _ in range(self._begun):
            transport = self._waiting.popleft()
            if not transport.is_closing():
                transport.resume_reading()
        if self._begun > 0:
            asyncio.get_running_loop().call_later(_PAUSE_S, self._next)


class _Messages(WebSocketsSansIOProtocol):
    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        _read_by(transport, _MESSAGE_PIECE)
        super().connection_made(transport)


def _read_by(transport: asyncio.BaseTransport, size: int) -> None:
    """Read pieces of this size, between which others have their turn.

    All that was read is parsed at once: 256 kB of messages of two bytes take a second.
    """
    with suppress(AttributeError):  # A loop that is not asyncio's own.
        transport.max_size = size  # type: ignore[attr-defined]


def is_ours(record: logging.LogRecord) -> bool:
    """Whether an error is one of the studio.

    Text that is no UTF-8 is the sender's; what is still being answered at the end is cut off.
    """
    error = record.exc_info[1] if record.exc_info else None
    if isinstance(error, asyncio.CancelledError | UnicodeDecodeError):
        return False
    return not record.getMessage().startswith("Cancel ")
