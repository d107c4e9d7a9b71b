"""Serving a studio: its port, how connections are read, its address, the browser, and its end."""

import asyncio
import errno
import logging
import os
import secrets
import socket
import sys
import threading
import webbrowser
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from urllib.parse import quote

import uvicorn
from fastapi import FastAPI
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from nolens.errors import OptionError
from nolens.studio.app import Studio, create_app
from nolens.studio.security import is_loopback
from nolens.studio.workspace import Workspace

PORT = 8350
_TRIED = 50
FRAME_BYTES = 2_000_000
"""The most that one message of a page may have."""
_REQUEST_PIECE, _MESSAGE_PIECE = 16_384, 4096
_AT_ONCE, _PAUSE_S = 4, 0.01
"""New connections that are first read at once, and the pause before the next ones."""
_SOURCES = ("auto", "raspberry", "twin", "folder")


@dataclass(frozen=True)
class Served:
    """Where a studio is.

    Parameters
    ----------
    url
        Its address, with its token where it has one.
    port
        Its port.
    """

    url: str
    port: int


def workspace_of(folders: Sequence[Path], source: str) -> tuple[Workspace, str]:
    """The folders of a studio, and its source as the page names it.

    A folder that the source names is one of those that can be read.

    Raises
    ------
    NolensError
        If the source is none, or a folder cannot be used.
    """
    kind, _, rest = source.partition(":")
    known = kind in _SOURCES and not (kind == "auto" and rest) and (kind != "folder" or rest)
    if not known:
        raise OptionError(
            f"--camera {source!r} is no source of frames; accepted are auto, raspberry, twin, "
            "twin:CAMERA (a preset, or a folder with camera.toml), and folder:PATH for a folder "
            "that another camera writes raw files into"
        )
    workspace = Workspace(folders)
    if kind not in ("folder", "twin") or not rest or rest in workspace.presets():
        return workspace, source
    path = Path(rest).expanduser()
    if not path.is_dir():
        raise OptionError(f"--camera {source}: there is no folder {path}")
    if workspace.name_of(path) is None:
        workspace = Workspace([*folders, path])
    return workspace, f"{kind}:{workspace.name_of(path)}"


def listen(host: str, port: int | None, say: Callable[[str], None]) -> socket.socket:
    """A socket that listens; without a port, on the studio's own or the next that is free.

    Parameters
    ----------
    host
        Address to listen on.
    port
        A port, 0 for any; None for the studio's own, or the next.
    say
        Shows a message to the person at the terminal.

    Raises
    ------
    OptionError
        If the port is in use or may not be used, or there is no such address here.
    """
    if port is not None and not 0 <= port <= 65535:
        raise OptionError(f"--port {port}: give 0 (any) to 65535, such as {PORT}")
    first = PORT if port is None else port
    try:
        return _bound(host, first)
    except OSError as error:
        if error.errno != errno.EADDRINUSE:
            raise OptionError(_refusal(host, first, error)) from None
    for other in range(first + 1, min(first + _TRIED, 65536)):
        try:
            listening = _bound(host, other)
        except OSError:
            continue
        if port is None:
            say(f"port {first} is in use, perhaps by another studio: this one takes {other}")
            return listening
        listening.close()
        raise OptionError(f"port {port} is in use; {other} is free: give --port {other}")
    raise OptionError(f"port {first} and those after it are in use: give another --port, or 0")


def serve(
    studio: Studio,
    listening: socket.socket,
    *,
    browser: bool,
    started: Callable[[Served], None],
) -> None:
    """Serve a studio until it is stopped (Ctrl-C).

    Parameters
    ----------
    studio
        What to serve.
    listening
        Where.
    browser
        Whether to open the page in the person's browser.
    started
        Called with the address, once it answers.

    Raises
    ------
    KeyboardInterrupt
        When it was stopped, and everything has ended.
    """
    token = None if is_loopback(studio.host) else secrets.token_urlsafe(24)
    studio = replace(studio, token=token)
    served = _served(studio, listening.getsockname()[1])
    server = _Server(configuration(create_app(studio)), lambda: _announce(served, browser, started))
    server.run(sockets=[listening])


class _Server(uvicorn.Server):
    """Calls a function once it answers."""

    def __init__(self, config: uvicorn.Config, on_start: Callable[[], None]) -> None:
        super().__init__(config)
        self._on_start = on_start

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        if not self.should_exit:
            await asyncio.to_thread(self._on_start)


def _announce(served: Served, browser: bool, started: Callable[[Served], None]) -> None:
    started(served)
    # Without a screen a browser in the terminal would come, and take it over.
    screen = sys.platform != "linux" or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    )
    if browser and screen:
        threading.Thread(target=webbrowser.open, args=(served.url,), daemon=True).start()


def _served(studio: Studio, port: int) -> Served:
    host = studio.host
    if host in ("0.0.0.0", "::", ""):
        host = _own_address()
    name = f"[{host}]" if ":" in host else host
    query = f"/?token={quote(studio.token)}" if studio.token else "/"
    return Served(f"http://{name}:{port}{query}", port)


def _own_address() -> str:
    """Address that others reach this computer by; nothing is sent for it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
            return str(probe.getsockname()[0])
        except OSError:
            return socket.gethostname()


def _bound(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    try:
        if os.name == "posix":  # Elsewhere it would let two programs have one port.
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((host, port))
        listening.listen(128)
    except (OSError, OverflowError):
        listening.close()
        raise
    return listening


def _refusal(host: str, port: int, error: OSError) -> str:
    if error.errno == errno.EACCES:
        return f"port {port} may not be used by this user: give one above 1023, such as {PORT}"
    return (
        f"cannot serve on {host}: {error.strerror or error}. Give an address of this computer: "
        "127.0.0.1 (this computer alone) or 0.0.0.0 (all networks, with a token)"
    )


def configuration(app: FastAPI) -> uvicorn.Config:
    """How an application is served: fairly, and without a traceback for what is malformed."""
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
