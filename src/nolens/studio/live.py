"""The live view as the server has it: its process, its state, and who looks at it."""

import asyncio
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

from nolens.errors import NolensError, OptionError
from nolens.studio.scene_names import SCENES
from nolens.studio.schemas import LiveStart, LiveState, Saved, Settings, SettingsChange
from nolens.studio.worker import NoAnswerError, RefusedError, Told, Worker
from nolens.studio.workspace import Workspace

_TARGET = "nolens.studio.live_process:main"
_START_S = 90.0
_ANSWER_S = 10.0
_SAVE_S = 30.0
_TOO_SOON_S = 30.0
_MOST_CLIENTS = 32


class Client:
    """Someone who looks: is handed the newest message, when it has dealt with the one before."""

    def __init__(self) -> None:
        self.arrived = asyncio.Event()
        self.ready = asyncio.Event()
        self.ready.set()
        self.seen = 0


class LiveHub:
    """The live view of one studio.

    Parameters
    ----------
    workspace
        Where PSFs are read and frames are saved.
    say
        Tells a person at the terminal.
    """

    def __init__(self, workspace: Workspace, say: Callable[[str], None]) -> None:
        self._workspace, self._say = workspace, say
        self._worker: Worker | None = None
        self._state = LiveState()
        self._started: LiveStart | None = None
        self._clients: set[Client] = set()
        self._newest: bytes | None = None
        self._number, self._left = 0, 0
        self._lock = threading.Lock()
        self._arrived: Told | None = None
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

    def join(self) -> Client | None:
        """Someone comes to look; None where there are too many."""
        if len(self._clients) >= _MOST_CLIENTS:
            return None
        client = Client()
        if self._newest is not None:
            client.arrived.set()
        self._clients.add(client)
        self._tell_watched()
        return client

    def leave(self, client: Client) -> None:
        """Someone looks no more."""
        self._clients.discard(client)
        self._tell_watched()

    def begin(self, asked: LiveStart) -> None:
        """Start, without waiting for it; what goes wrong is told in the state."""
        self._restart = asyncio.get_running_loop().create_task(self._start_again(asked))

    async def start(self, asked: LiveStart) -> LiveState:
        """Look through a source, in place of the one before.

        Raises
        ------
        NolensError
            If it cannot be opened, or the PSF not be read; the text is for a person.
        """
        source, psf = await asyncio.to_thread(self._resolved, asked)
        changes = _given(asked.settings)
        scene = self._state.scene if self._state.scene in SCENES else None
        async with self._starting:
            self._started = asked
            try:
                await self._working().ask("start", source, psf, changes, scene, seconds=_START_S)
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
                await worker.ask("stop", seconds=_ANSWER_S)
            except RefusedError:
                await self._end()
                self._state = LiveState(settings=self._state.settings)
        self._newest = None
        return self.state

    async def set(self, change: SettingsChange) -> Settings:
        """Change settings, from the next frame on."""
        found = await self._working().ask("settings", _given(change), seconds=_ANSWER_S)
        return Settings.model_validate(found)

    async def show(self, name: str) -> str:
        """Let the simulated camera look at a built-in scene."""
        return str(await self._working().ask("scene", name, seconds=_ANSWER_S))

    async def show_picture(self, data: bytes) -> str:
        """Let it look at a JPEG or PNG."""
        return str(await self._working().ask("picture", data, seconds=_ANSWER_S))

    def show_webcam(self, data: bytes) -> None:
        """Let it look at a frame of a webcam; only the newest counts."""
        if self._worker is not None and self._state.running:
            with suppress(RefusedError):
                self._worker.tell("webcam", data, instead="webcam")

    async def save(self, formats: list[str], folder: str) -> Saved:
        """Write the frame that is shown into a folder of the workspace."""
        if self._worker is None:
            raise OptionError("no camera is running: start one, and try again")
        work = str(self._workspace.work)
        found = await self._worker.ask("save", formats, work, folder, seconds=_SAVE_S)
        named = await asyncio.to_thread(self._workspace.named, found)
        return Saved(files=named["files"], psf_path=named["psf_path"])

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
            hear = partial(self._hear, asyncio.get_running_loop())
            folders = self._workspace.paths
            self._worker = Worker("nolens-live", _TARGET, folders, hear, self._died)
            self._tell_watched()
        return self._worker

    def _tell_watched(self) -> None:
        if self._worker is not None:
            with suppress(RefusedError):
                self._worker.tell("watched", bool(self._clients), instead="watched")

    def _resolved(self, asked: LiveStart) -> tuple[str, str | None]:
        """Source and PSF with real paths."""
        source = asked.source
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
        psf = None if asked.psf is None else str(self._workspace.resolve(asked.psf))
        return source, psf

    def _hear(self, loop: asyncio.AbstractEventLoop, message: Told) -> None:
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
            self._newest, self._left = None, left
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
        asked = self._started.model_copy(
            update={
                "settings": SettingsChange(**self._state.settings.model_dump(exclude={"frozen"}))
            }
        )
        self.begin(asked)

    async def _start_again(self, asked: LiveStart) -> None:
        try:
            await self.start(asked)
        except NolensError as error:
            self._fail(str(error))


def _given(change: SettingsChange | None) -> dict[str, Any]:
    """Settings that are named in a change; no exposure time means automatic."""
    if change is None:
        return {}
    named = change.model_dump(exclude_unset=True)
    return {
        name: value for name, value in named.items() if value is not None or name == "exposure_s"
    }
