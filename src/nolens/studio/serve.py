"""Serving a studio: a port for it, its address for a person, the browser, and its end."""

import asyncio
import errno
import os
import secrets
import socket
import sys
import threading
import webbrowser
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from urllib.parse import quote

import uvicorn

from nolens.errors import OptionError
from nolens.studio.app import Studio, create_app
from nolens.studio.connections import configuration
from nolens.studio.security import is_loopback
from nolens.studio.workspace import Workspace

PORT = 8350
_TRIED = 50
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
        Port that was asked for, 0 for any; None where none was.
    say
        Tells a person at the terminal.

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
            found = _bound(host, other)
        except OSError:
            continue
        if port is None:
            say(f"port {first} is in use, perhaps by another studio: this one takes {other}")
            return found
        found.close()
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
        Told the address, once it answers.

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
    """Tells when it answers."""

    def __init__(self, config: uvicorn.Config, ready: Callable[[], None]) -> None:
        super().__init__(config)
        self._ready = ready

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        if not self.should_exit:
            await asyncio.to_thread(self._ready)


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
    found = socket.socket(family, socket.SOCK_STREAM)
    try:
        if os.name == "posix":  # Elsewhere it would let two programs have one port.
            found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        found.bind((host, port))
        found.listen(128)
    except (OSError, OverflowError):
        found.close()
        raise
    return found


def _refusal(host: str, port: int, error: OSError) -> str:
    if error.errno == errno.EACCES:
        return f"port {port} may not be used by this user: give one above 1023, such as {PORT}"
    return (
        f"cannot serve on {host}: {error.strerror or error}. Give an address of this computer: "
        "127.0.0.1 (this computer alone) or 0.0.0.0 (all networks, with a token)"
    )
