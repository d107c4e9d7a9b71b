"""The live view as the server has it: its process, its state, its routes and its clients."""

import asyncio
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request, WebSocket, WebSocketDisconnect
from pydantic import ValidationError

from nolens.errors import DataError, NolensError, OptionError
from nolens.studio.requests import JsonRoute, parsed
from nolens.studio.schemas import (
    SCENES,
    BuiltinScene,
    LivePixel,
    LiveStart,
    LiveState,
    Saved,
    SaveRequest,
    SceneAnswer,
    Settings,
    SettingsChange,
)
from nolens.studio.worker import Message, NoAnswerError, RefusedError, Worker
from nolens.studio.workspace import Workspace

_TARGET = "nolens.studio.live_process:main"
_START_S = 90.0
_ANSWER_S = 10.0
_SAVE_S = 30.0
_TOO_SOON_S = 30.0
_MOST_CLIENTS = 32
SCENE_PATH = "/api/live/scene"
SCENE_BYTES = 32_000_000
WEBCAM_BYTES = 1_000_000
_MOST_SCENES = 4
_SCENE_NAME_BYTES = 10_000
_MESSAGES_PER_S, _MESSAGES_AT_ONCE = 100.0, 50
_PICTURES = (b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n")
_PICTURE_TYPES = ("image/jpeg", "image/png", "image/webp")
_Fraction = Annotated[float, Query(ge=0, lt=1)]
_MALFORMED = 1008
_TOO_MANY = 1013
_BYTES = {"schema": {"type": "string", "format": "binary"}}
_SCENE_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            "application/json": {"schema": BuiltinScene.model_json_schema()},
            **dict.fromkeys(_PICTURE_TYPES, _BYTES),
        },
    }
}


class _Client:
    """A page: it gets the newest message when it has acknowledged the one before."""

    def __init__(self) -> None:
        self.arrived = asyncio.Event()
        self.idle = asyncio.Event()
        self.idle.set()
        self.last = 0


class LiveHub:
    """The live view of one studio.

    Parameters
    ----------
    workspace
        Where PSFs are read and frames are saved.
    say
        Shows a message to the person at the terminal.
    """

    def __init__(self, workspace: Workspace, say: Callable[[str], None]) -> None:
        self._workspace, self._say = workspace, say
        self._worker: Worker | None = None
        self._state = LiveState()
        self._started: LiveStart | None = None
        self._clients: set[_Client] = set()
        self._newest: bytes | None = None
        self._number, self._left = 0, 0
        self._lock = threading.Lock()
        self._arrived: Message | None = None
        self._starting = asyncio.Lock()
        self._died_at = float("-inf")
        self._fps_at = float("-inf")

    @property
    def state(self) -> LiveState:
        """How it is now."""
        now = asyncio.get_running_loop().time()
        if now - self._fps_at > 3.0:
            return self._state.model_copy(update={"fps": 0.0})
        return self._state

    @property
    def pid(self) -> int | None:
        """Number of the process, while there is one."""
        return None if self._worker is None else self._worker.pid

    @property
    def newest(self) -> tuple[int, bytes | None]:
        """Number of the newest message, and it."""
        return self._number, self._newest

    def join(self) -> _Client | None:
        """A page opens the view; None where there are too many."""
        if len(self._clients) >= _MOST_CLIENTS:
            return None
        client = _Client()
        if self._newest is not None:
            client.arrived.set()
        self._clients.add(client)
        self._send_watched()
        return client

    def leave(self, client: _Client) -> None:
        """A page closes the view."""
        self._clients.discard(client)
        self._send_watched()

    def begin(self, request: LiveStart) -> None:
        """Start, without waiting for it; what goes wrong stands in the state."""
        self._restart = asyncio.get_running_loop().create_task(self._start_again(request))

    async def start(self, request: LiveStart) -> LiveState:
        """Take frames from a source, in place of the one before.

        Raises
        ------
        NolensError
            If it cannot be opened, or the PSF not be read; the text is for a person.
        """
        source, psf = await asyncio.to_thread(self._resolved, request)
        changes = _changes(request.settings)
        scene = self._state.scene if self._state.scene in SCENES else None
        async with self._starting:
            self._started = request
            try:
                await self._working().request(
                    "start", source, psf, changes, scene, seconds=_START_S
                )
            except RefusedError as error:
                if isinstance(error, NoAnswerError):
                    await self._end()  # It hangs in a camera, and would go on to.
                self._fail(str(error))
                raise
        return self.state

    async def stop(self) -> LiveState:
        """Give the camera back."""
        self._started = None
        worker = self._worker
        if worker is not None:
            try:
                await worker.request("stop", seconds=_ANSWER_S)
            except RefusedError:
                await self._end()
                self._state = LiveState(settings=self._state.settings)
        self._newest = None
        return self.state

    async def set(self, change: SettingsChange) -> Settings:
        """Change settings, from the next frame on."""
        settings = await self._working().request("settings", _changes(change), seconds=_ANSWER_S)
        return Settings.model_validate(settings)

    async def show(self, name: str) -> str:
        """Let the simulated camera look at a built-in scene."""
        return str(await self._working().request("scene", name, seconds=_ANSWER_S))

    async def show_picture(self, data: bytes) -> str:
        """Let it look at a JPEG or PNG."""
        return str(await self._working().request("picture", data, seconds=_ANSWER_S))

    def show_webcam(self, data: bytes) -> None:
        """Let it look at a frame of a webcam; only the newest counts."""
        if self._worker is not None and self._state.running:
            with suppress(RefusedError):
                self._worker.send("webcam", data, instead="webcam")

    async def save(self, formats: list[str], folder: str) -> Saved:
        """Write the displayed frame into a folder of the workspace."""
        if self._worker is None:
            raise OptionError("no camera is running: start one, and try again")
        work = str(self._workspace.work)
        saved = await self._worker.request("save", formats, work, folder, seconds=_SAVE_S)
        named = await asyncio.to_thread(self._workspace.named, saved)
        return Saved(files=named["files"], psf_path=named["psf_path"])

    async def pixel(self, of: str, across: float, down: float) -> LivePixel:
        """A pixel of the displayed frame, at fractions of its width and height."""
        if self._worker is None:
            raise OptionError("no camera is running: start one, and try again")
        pixel = await self._worker.request("pixel", of, across, down, seconds=_SAVE_S)
        return LivePixel(**pixel)

    async def close(self) -> None:
        """End the process, and with it all that it holds."""
        self._started = None
        await self._end()

    async def _end(self) -> None:
        worker, self._worker = self._worker, None
        if worker is not None:
            await worker.stop(0.8)

    def _working(self) -> Worker:
        if self._worker is None:
            on_message = partial(self._received, asyncio.get_running_loop())
            folders = self._workspace.paths
            self._worker = Worker("nolens-live", _TARGET, folders, on_message, self._died)
            self._send_watched()
        return self._worker

    def _send_watched(self) -> None:
        if self._worker is not None:
            with suppress(RefusedError):
                self._worker.send("watched", bool(self._clients), instead="watched")

    def _resolved(self, request: LiveStart) -> tuple[str, str | None]:
        """Source and PSF with real paths."""
        source = request.source
        kind, _, rest = source.partition(":")
        if kind == "folder":
            if not rest:
                raise OptionError("give the folder to watch, such as folder:work/uploads")
            source = f"folder:{self._workspace.resolve(rest)}"
        elif kind == "twin" and "/" in rest:
            source = f"twin:{self._workspace.resolve(rest)}"
        elif kind == "twin" and rest and rest not in self._workspace.presets():
            raise OptionError(
                f"there is no camera {rest!r}: give one of {', '.join(self._workspace.presets())}, "
                "or the path of a camera's folder such as work/cameras/mine"
            )
        psf = None if request.psf is None else str(self._workspace.resolve(request.psf))
        return source, psf

    def _received(self, loop: asyncio.AbstractEventLoop, message: Message) -> None:
        """In the worker's thread: of messages that come faster than they go, the newest stays."""
        if message[0] == "state":
            message = "state", self._named(message[1]), *message[2:]
        with self._lock:
            waiting = self._arrived is not None
            if message[0] == "frame":
                self._arrived = message
        with suppress(RuntimeError):  # The loop is closed.
            if message[0] == "state":
                loop.call_soon_threadsafe(self._changed, *message[1:])
            elif not waiting:
                loop.call_soon_threadsafe(self._publish)

    def _publish(self) -> None:
        with self._lock:
            message, self._arrived = self._arrived, None
        if message is None or not self._state.running:
            return
        _, self._newest, fps, dropped = message
        self._number += 1
        self._fps_at = asyncio.get_running_loop().time()
        self._state = self._state.model_copy(update={"fps": fps, "dropped": dropped})
        for client in self._clients:
            client.arrived.set()

    def _changed(self, state: dict[str, Any], left: int) -> None:
        """The state, and how many sources were left so far: their frames count no more."""
        before = self._state
        self._state = LiveState.model_validate(
            {**state, "fps": before.fps, "dropped": before.dropped}
        )
        if not self._state.running or left != self._left:
            self._newest, self._left, self._fps_at = None, left, float("-inf")
        if self._state.error and self._state.error != before.error:
            self._say(self._state.error)

    def _named(self, state: dict[str, Any]) -> dict[str, Any]:
        """A state with the paths of the page."""
        named: dict[str, Any] = self._workspace.named(state)
        if isinstance(state["source"], str):
            kind, colon, rest = state["source"].partition(":")
            named["source"] = f"{kind}{colon}{self._workspace.named(rest)}"
        return named

    def _fail(self, text: str) -> None:
        if self._state.error != text:
            self._say(text)
        self._state = self._state.model_copy(update={"running": False, "error": text})

    def _died(self, reason: str) -> None:
        """The process is gone: start it again, unless it has just been."""
        if self._worker is None:  # It was ended on purpose.
            return
        self._worker, self._newest = None, None
        now = asyncio.get_running_loop().time()
        again = self._started is not None and now - self._died_at > _TOO_SOON_S
        self._died_at = now
        text = f"the live view's process {reason}"
        if self._starting.locked() or not again or self._started is None:
            self._fail(f"{text}. Start it again")
            return
        self._fail(f"{text}. It is being started again")
        request = self._started.model_copy(
            update={
                "settings": SettingsChange(**self._state.settings.model_dump(exclude={"frozen"}))
            }
        )
        self.begin(request)

    async def _start_again(self, request: LiveStart) -> None:
        try:
            await self.start(request)
        except NolensError as error:
            self._fail(str(error))


def _changes(change: SettingsChange | None) -> dict[str, Any]:
    """Settings that are named in a change; no exposure time means automatic."""
    if change is None:
        return {}
    named = change.model_dump(exclude_unset=True)
    return {
        name: value for name, value in named.items() if value is not None or name == "exposure_s"
    }


def live_router(hub: LiveHub) -> APIRouter:
    """Routes of the live view."""
    router = APIRouter(prefix="/api/live", route_class=JsonRoute)

    # Each may have `SCENE_BYTES` in memory.
    receiving = asyncio.Semaphore(_MOST_SCENES)

    @router.get("")
    async def state() -> LiveState:
        return hub.state

    @router.post("/start")
    async def start(request: LiveStart) -> LiveState:
        return await hub.start(request)

    @router.post("/stop")
    async def stop() -> LiveState:
        return await hub.stop()

    @router.post("/settings")
    async def settings(change: SettingsChange) -> Settings:
        return await hub.set(change)

    @router.post("/scene", openapi_extra=_SCENE_BODY)
    async def scene(request: Request) -> SceneAnswer:
        kind = request.headers.get("content-type", "").split(";")[0].strip().lower()
        async with receiving:
            body = await request.body()
            if kind in _PICTURE_TYPES:
                return SceneAnswer(scene=await hub.show_picture(body))
        return SceneAnswer(scene=await hub.show(_builtin(body)))

    @router.post("/save")
    async def save(request: SaveRequest) -> Saved:
        return await hub.save(list(request.formats), request.folder)

    @router.get("/pixel")
    async def pixel(of: Literal["raw", "picture"], across: _Fraction, down: _Fraction) -> LivePixel:
        return await hub.pixel(of, across, down)

    @router.websocket("/frames")
    async def frames(socket: WebSocket) -> None:
        client = hub.join()
        if client is None:
            await socket.close(_TOO_MANY, "too many pages are open at once")
            return
        try:
            await socket.accept()
            await _serve(socket, client, hub)
        finally:
            hub.leave(client)

    return router


def _builtin(body: bytes) -> str:
    try:
        return BuiltinScene.model_validate(parsed(body[:_SCENE_NAME_BYTES])).builtin
    except (DataError, ValidationError):
        raise OptionError(
            f'the scene is none: give {{"builtin": "chart"}}, or a picture as {_PICTURE_TYPES[0]} '
            f"or {_PICTURE_TYPES[1]}"
        ) from None


async def _serve(socket: WebSocket, client: _Client, hub: LiveHub) -> None:
    """Send frames as they are asked for, until one side ends."""
    sending = asyncio.create_task(_send(socket, client, hub))
    receiving = asyncio.create_task(_receive(socket, client, hub))
    try:
        await asyncio.wait((sending, receiving), return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in (sending, receiving):
            task.cancel()
        results = await asyncio.gather(sending, receiving, return_exceptions=True)
    for result in results:
        known = (asyncio.CancelledError, WebSocketDisconnect, RuntimeError, OSError)
        if isinstance(result, BaseException) and not isinstance(result, known):
            raise result


async def _send(socket: WebSocket, client: _Client, hub: LiveHub) -> None:
    while True:
        await client.idle.wait()
        await client.arrived.wait()
        client.arrived.clear()
        number, message = hub.newest
        if message is None or number == client.last:
            continue
        client.last = number
        client.idle.clear()
        await socket.send_bytes(message)


async def _receive(socket: WebSocket, client: _Client, hub: LiveHub) -> None:
    loop = asyncio.get_running_loop()
    due = 0.0
    while True:
        # Who sends more than frames and pictures of a webcam need waits: what is not read yet
        # waits in its own connection.
        now = loop.time()
        due = max(due, now - _MESSAGES_AT_ONCE / _MESSAGES_PER_S) + 1 / _MESSAGES_PER_S
        if due > now:
            await asyncio.sleep(due - now)
        message = await socket.receive()
        if message["type"] == "websocket.disconnect":
            return
        text, data = message.get("text"), message.get("bytes")
        if text == "ok":
            client.idle.set()
        elif data is not None and data.startswith(_PICTURES) and len(data) <= WEBCAM_BYTES:
            hub.show_webcam(data)
        else:
            with suppress(RuntimeError):
                await socket.close(_MALFORMED, 'send "ok", or a JPEG or PNG')
            return
