"""The live view: how it is, what it is told, and its frames."""

import asyncio
from contextlib import suppress
from typing import Any

from fastapi import APIRouter, Request, WebSocket, WebSocketDisconnect
from pydantic import ValidationError

from nolens.errors import DataError, OptionError
from nolens.studio.live import Client, LiveHub
from nolens.studio.requests import JsonRoute, parsed
from nolens.studio.schemas import (
    BuiltinScene,
    LiveStart,
    LiveState,
    Saved,
    SaveRequest,
    SceneShown,
    Settings,
    SettingsChange,
)

SCENE_PATH = "/api/live/scene"
SCENE_BYTES = 32_000_000
WEBCAM_BYTES = 1_000_000
_MOST_SCENES = 4
_SCENE_NAME_BYTES = 10_000
_MESSAGES_PER_S, _MESSAGES_AT_ONCE = 100.0, 50
_PICTURES = (b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n")
_PICTURE_TYPES = ("image/jpeg", "image/png", "image/webp")
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


def live_router(hub: LiveHub) -> APIRouter:
    """Routes of the live view."""
    router = APIRouter(prefix="/api/live", route_class=JsonRoute)

    # Each may have `SCENE_BYTES` in memory.
    receiving = asyncio.Semaphore(_MOST_SCENES)

    @router.get("")
    async def state() -> LiveState:
        return hub.state

    @router.post("/start")
    async def start(asked: LiveStart) -> LiveState:
        return await hub.start(asked)

    @router.post("/stop")
    async def stop() -> LiveState:
        return await hub.stop()

    @router.post("/settings")
    async def settings(change: SettingsChange) -> Settings:
        return await hub.set(change)

    @router.post("/scene", openapi_extra=_SCENE_BODY)
    async def scene(request: Request) -> SceneShown:
        kind = request.headers.get("content-type", "").split(";")[0].strip().lower()
        async with receiving:
            body = await request.body()
            if kind in _PICTURE_TYPES:
                return SceneShown(scene=await hub.show_picture(body))
        return SceneShown(scene=await hub.show(_builtin(body)))

    @router.post("/save")
    async def save(asked: SaveRequest) -> Saved:
        return await hub.save(list(asked.formats), asked.folder)

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


async def _serve(socket: WebSocket, client: Client, hub: LiveHub) -> None:
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


async def _send(socket: WebSocket, client: Client, hub: LiveHub) -> None:
    while True:
        await client.ready.wait()
        await client.arrived.wait()
        client.arrived.clear()
        number, message = hub.newest
        if message is None or number == client.seen:
            continue
        client.seen = number
        client.ready.clear()
        await socket.send_bytes(message)


async def _receive(socket: WebSocket, client: Client, hub: LiveHub) -> None:
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
            client.ready.set()
        elif data is not None and data.startswith(_PICTURES) and len(data) <= WEBCAM_BYTES:
            hub.show_webcam(data)
        else:
            with suppress(RuntimeError):
                await socket.close(_MALFORMED, 'send "ok", or a JPEG or PNG')
            return
