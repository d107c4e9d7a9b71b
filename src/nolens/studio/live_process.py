"""The process of the live view: camera, reconstruction, and what the page is shown of it."""

import os
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from nolens.capture import TwinSource
from nolens.errors import NolensError, OptionError
from nolens.studio.camera_thread import Taken, age_s
from nolens.studio.encode import White, message, picture_jpeg
from nolens.studio.live_save import Shown, kept_psf, save_shown
from nolens.studio.live_solver import Solved
from nolens.studio.live_source import LiveSource, open_live
from nolens.studio.scenes import decoded_scene, show_scene
from nolens.studio.schemas import Method, Settings
from nolens.studio.worker import Channel, Message

_FPS_OVER_S = 3.0
_WEBCAM_PIXELS = 4_000_000
"""Of a webcam's frame, which is decoded between two pictures of the live view."""
_NO_PSF = "no PSF is chosen: take one in Calibrate, or choose one, to see more than the raw frame"
_OWN: dict[Method, tuple[float, int]] = {"admm": (1e-4, 2), "wiener": (0.5, 1)}
"""τ and iterations that a method begins with."""


def main(channel: Channel) -> None:
    """Show what a camera sees, until the server tells to end."""
    view = LiveView(channel)
    threading.Thread(target=_listen, args=(channel, view), daemon=True).start()
    view.run()
    os._exit(0)


def _listen(channel: Channel, view: "LiveView") -> None:
    for told in channel.messages():
        view.put(told)
    view.put(("end",))


class LiveView:
    """Takes the newest frame, reconstructs it and tells the server; heeds what it is told between.

    Parameters
    ----------
    channel
        To the server.
    """

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._changed = threading.Condition()
        self._told: deque[Message] = deque()
        self._settings = Settings()
        self._used = dict(_OWN)
        self._source: LiveSource | None = None
        self._shown: Shown | None = None
        self._white = White()
        self._scene: str | None = None
        self._watched = False
        self._sent: deque[float] = deque()
        self._error: str | None = None
        self._webcam_trouble: str | None = None
        self._left = 0
        self._cores = torch.get_num_threads()

    def put(self, told: Message) -> None:
        """Take a message of the server, from any thread."""
        with self._changed:
            if told[0] == "webcam":  # The newest alone.
                self._told = deque(each for each in self._told if each[0] != "webcam")
            self._told.append(told)
            self._changed.notify_all()

    def run(self) -> None:
        """Work until the end is told."""
        while True:
            with self._changed:
                self._changed.wait_for(self._has_work)
                told = self._told.popleft() if self._told else None
            if told is None:
                self._look()
            elif told[0] == "end":
                self._leave()
                return
            else:
                self._heed(told)

    def _has_work(self) -> bool:
        source = self._source
        if self._told or source is None:
            return bool(self._told)
        frame = source.camera.has_frame and not self._settings.frozen
        return frame or source.camera.failure is not None

    def _heed(self, told: Message) -> None:
        if told[0] == "watched":
            self._watched = bool(told[1])
            if self._source is not None:
                self._source.camera.watch(self._watched)
            return
        if told[0] == "webcam":
            self._webcam(told[1])
            return
        _, number, verb, *what = told
        verbs: dict[str, Callable[..., Any]] = {
            "start": self._start,
            "stop": self._stop,
            "settings": self._set,
            "scene": self._see,
            "picture": self._see_picture,
            "save": self._save,
        }
        result, refused = None, None
        try:
            result = verbs[verb](*what)
        except NolensError as error:
            refused = str(error)
        except Exception as error:
            traceback.print_exc()
            refused = f"{type(error).__name__}: {error}"
        self._tell_state()  # Before the answer, so that who asked finds it.
        self._channel.answer(number, result, refused=refused)

    def _start(
        self, text: str, psf: str | None, changes: dict[str, Any], scene: str | None
    ) -> None:
        """Look through a source, in place of the one before."""
        self._leave()
        self._error = None
        self._settings = self._settings.model_copy(update={"frozen": False})
        self._change(changes)
        try:
            self._source = open_live(text, psf, self._settings, self._changed, self._warn)
        except NolensError as error:
            self._error = str(error)
            raise
        self._white = White()
        self._sees(None)
        self._source.camera.watch(self._watched)
        if self._source.twin is not None:
            self._see(scene or "chart")

    def _stop(self) -> None:
        self._leave()
        self._error = None

    def _leave(self) -> None:
        source, self._source, self._shown = self._source, None, None
        self._left += 1
        self._sent.clear()
        if source is not None:
            source.camera.close()

    def _set(self, changes: dict[str, Any]) -> dict[str, Any]:
        was_frozen = self._settings.frozen
        self._change(changes)
        if self._source is not None:
            if was_frozen:
                self._source.camera.take()  # It has waited since then.
            self._source.camera.expose(self._settings)
        return self._settings.model_dump()

    def _change(self, changes: dict[str, Any]) -> None:
        """Settings with changes; another method comes with what it was last used with."""
        method = changes.get("method", self._settings.method)
        if method != self._settings.method:
            tau, iterations = self._used[method]
            changes = {"tau": tau, "iterations": iterations, **changes}
        self._settings = self._settings.model_copy(update=changes)
        self._used[method] = self._settings.tau, self._settings.iterations

    def _see(self, name: str) -> str:
        show_scene(self._twin(), name)
        self._sees(name)
        return name

    def _see_picture(self, data: bytes) -> str:
        twin = self._twin()
        twin.show(decoded_scene(data))
        self._sees("picture")
        return "picture"

    def _webcam(self, data: bytes) -> None:
        """A frame of a visitor's webcam; one that cannot be used is passed over, and told."""
        if self._source is None or self._source.twin is None:
            return
        before = self._scene, self._webcam_trouble
        try:
            self._source.twin.show(decoded_scene(data, _WEBCAM_PIXELS))
            self._sees("webcam")
        except NolensError as error:
            self._sees(self._scene, f"the webcam's picture is not shown: {error}")
        if before != (self._scene, self._webcam_trouble):
            self._tell_state()

    def _sees(self, scene: str | None, webcam_trouble: str | None = None) -> None:
        """Keep what the twin sees, and why not the webcam's picture."""
        if self._error in (None, self._webcam_trouble):
            self._error = webcam_trouble
        self._scene, self._webcam_trouble = scene, webcam_trouble

    def _twin(self) -> TwinSource:
        if self._source is None or self._source.twin is None:
            raise OptionError(
                "only the simulated camera can be shown a scene: start twin:live before"
            )
        return self._source.twin

    def _save(self, formats: list[str], work: str, folder: str) -> dict[str, Any]:
        source, shown = self._source, self._shown
        if source is None or shown is None:
            raise OptionError("there is no frame to save yet: start a camera, and try again")
        if source.psf is None and source.twin is not None and source.opened is not None:
            source.psf = kept_psf(
                Path(work), source.camera_id or "", source.opened, source.twin.psf(), shown.shot
            )
        files = save_shown(Path(work) / folder, shown, formats, source.psf)
        return {
            "files": [str(path) for path in files],
            "psf_path": None if source.psf is None else str(source.psf),
        }

    def _look(self) -> None:
        """The newest frame, to the page; or the end of a camera that failed."""
        source = self._source
        assert source is not None
        taken = source.camera.take()
        if taken is None:
            self._error = source.camera.failure
            self._leave()
            self._tell_state()
            return
        solved, trouble = self._solve(source, taken)
        # A camera is computed too, or developed: it has half of the cores while it is the slower.
        behind = source.camera.has_frame
        torch.set_num_threads(self._cores if behind else max(1, self._cores // 2))
        parts = {"raw": taken.raw}
        white = 1.0
        if solved is not None:
            white = self._white.follow(solved.radiance)
            parts["picture"] = picture_jpeg(solved.radiance, solved.channels, white)
        self._shown = Shown(taken.shot, solved, white, self._settings, source.text)
        self._send(source, taken, solved, trouble, parts)

    def _solve(self, source: LiveSource, taken: Taken) -> tuple[Solved | None, str | None]:
        if source.solver is None:
            return None, _NO_PSF
        if taken.seen is None:
            return None, taken.trouble
        shot = taken.shot
        brightness = max(shot.exposure_s, 1e-9) * max(shot.gain, 1e-9)
        try:
            return source.solver.solve(taken.seen, self._settings, brightness), None
        except (NolensError, ArithmeticError) as error:
            return None, str(error)

    def _send(
        self,
        source: LiveSource,
        taken: Taken,
        solved: Solved | None,
        trouble: str | None,
        parts: dict[str, bytes],
    ) -> None:
        now = time.monotonic()
        self._sent.append(now)
        while self._sent[0] < now - _FPS_OVER_S:
            self._sent.popleft()
        over = now - self._sent[0]
        fps = (len(self._sent) - 1) / over if over > 0 else 0.0
        shot = taken.shot
        header = {
            "number": taken.number,
            "fps": round(fps, 2),
            "latency_ms": round(1e3 * age_s(shot), 1),
            "exposure_s": shot.exposure_s,
            "gain": shot.gain,
            "iterations": None if solved is None else solved.iterations,
            "histogram": taken.levels.histogram,
            "clipped_share": taken.levels.clipped_fraction,
            "dropped": source.camera.dropped,
            "frozen": self._settings.frozen,
            "trouble": trouble,
        }
        self._channel.send("frame", message(header, parts), round(fps, 2), source.camera.dropped)

    def _warn(self, text: str) -> None:
        self._error = text
        self._tell_state()

    def _tell_state(self) -> None:
        source = self._source
        limits = None if source is None else source.camera.limits
        state = {
            "running": source is not None,
            "source": None if source is None else source.text,
            "camera": None
            if source is None
            else {"id": source.camera_id, "name": source.camera.name},
            "settings": self._settings.model_dump(),
            "error": self._error,
            "psf_path": None if source is None or source.psf is None else str(source.psf),
            "limits": None if limits is None else vars(limits),
            "scene": self._scene if source is not None and source.twin is not None else None,
        }
        self._channel.send("state", state, self._left)
