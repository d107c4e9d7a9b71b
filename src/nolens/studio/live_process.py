"""The process of the live view: camera, reconstruction, and the messages with both for the page."""

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
from nolens.studio.live_camera import LiveFrame, LiveSource, age_s, open_live
from nolens.studio.live_save import DisplayedFrame, save_frame, stored_psf
from nolens.studio.live_solver import LivePicture
from nolens.studio.pictures import White, decoded_scene, message, picture_jpeg, show_scene
from nolens.studio.schemas import Method, Settings
from nolens.studio.worker import Channel, Message

_FPS_OVER_S = 3.0
_FRAME_S = 10.0
_WEBCAM_PIXELS = 4_000_000
"""Of a webcam's frame, which is decoded between two pictures of the live view."""
_NO_PSF = "no PSF is chosen: take one in Calibrate, or choose one, to see more than the raw frame"
_OWN: dict[tuple[Method, bool], tuple[float, int]] = {
    ("admm", False): (1.0, 2),
    ("admm", True): (1.0, 1),
    ("wiener", False): (1.0, 1),
    ("wiener", True): (1.0, 1),
}
"""Detail and iterations that a method begins with, and with PSFs over the field."""


def main(channel: Channel) -> None:
    """Show frames of a camera and their reconstructions, until the server ends it."""
    view = LiveView(channel)
    threading.Thread(target=_listen, args=(channel, view), daemon=True).start()
    view.run()
    os._exit(0)


def _listen(channel: Channel, view: "LiveView") -> None:
    for each in channel.messages():
        view.put(each)
    view.put(("end",))


class LiveView:
    """Reconstructs the newest frame and sends it to the server; heeds its messages between.

    Parameters
    ----------
    channel
        To the server.
    """

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._changed = threading.Condition()
        self._messages: deque[Message] = deque()
        self._settings = Settings()
        self._used = dict(_OWN)
        self._source: LiveSource | None = None
        self._displayed: DisplayedFrame | None = None
        self._white = White()
        self._scene: str | None = None
        self._watched = False
        self._sent: deque[float] = deque()
        self._error: str | None = None
        self._webcam_trouble: str | None = None
        self._left = 0
        self._cores = torch.get_num_threads()

    def put(self, message: Message) -> None:
        """Take a message of the server, from any thread."""
        with self._changed:
            if message[0] == "webcam":  # The newest alone.
                self._messages = deque(each for each in self._messages if each[0] != "webcam")
            self._messages.append(message)
            self._changed.notify_all()

    def run(self) -> None:
        """Work until the server ends it."""
        while True:
            with self._changed:
                self._changed.wait_for(self._has_work)
                message = self._messages.popleft() if self._messages else None
            if message is None:
                self._look()
            elif message[0] == "end":
                self._leave()
                return
            else:
                self._heed(message)

    def _has_work(self) -> bool:
        source = self._source
        if self._messages or source is None:
            return bool(self._messages)
        frame = source.camera.has_frame and not self._settings.frozen
        return frame or source.camera.failure is not None

    def _heed(self, message: Message) -> None:
        if message[0] == "watched":
            self._watched = bool(message[1])
            if self._source is not None:
                self._source.camera.watch(self._watched)
            return
        if message[0] == "webcam":
            self._webcam(message[1])
            return
        _, number, verb, *what = message
        verbs: dict[str, Callable[..., Any]] = {
            "start": self._start,
            "stop": self._stop,
            "settings": self._set,
            "scene": self._see,
            "picture": self._see_picture,
            "save": self._save,
            "pixel": self._pixel,
        }
        result, refused = None, None
        try:
            result = verbs[verb](*what)
        except NolensError as error:
            refused = str(error)
        except Exception as error:
            traceback.print_exc()
            refused = f"{type(error).__name__}: {error}"
        self._send_state()  # Before the answer, so that who asked finds it.
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
        source, self._source, self._displayed = self._source, None, None
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
        before = self._settings
        after = before.model_copy(update=changes)
        method = after.method, after.over_field
        if method != (before.method, before.over_field):
            detail, iterations = self._used[method]
            changes = {"detail": detail, "iterations": iterations, **changes}
            after = before.model_copy(update=changes)
        self._settings = after
        self._used[method] = after.detail, after.iterations

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
        """A frame of a visitor's webcam; one that cannot be used is passed over, with an error."""
        if self._source is None or self._source.twin is None:
            return
        before = self._scene, self._webcam_trouble
        try:
            self._source.twin.show(decoded_scene(data, _WEBCAM_PIXELS))
            self._sees("webcam")
        except NolensError as error:
            self._sees(self._scene, f"the webcam's picture is not shown: {error}")
        if before != (self._scene, self._webcam_trouble):
            self._send_state()

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
        self._renew()
        source, displayed = self._source, self._displayed
        if source is None:
            raise OptionError("there is no frame to save: start a camera, and try again")
        if displayed is None:
            raise OptionError(
                "there is no frame to save yet: none has come from the camera; try again when the "
                "page shows one"
            )
        if source.psf is None and source.twin is not None and source.loaded is not None:
            source.psf = stored_psf(
                Path(work), source.camera_id or "", source.loaded, source.twin.psf(), displayed.shot
            )
        files = save_frame(Path(work) / folder, displayed, formats, source.psf)
        return {
            "files": [str(path) for path in files],
            "psf_path": None if source.psf is None else str(source.psf),
        }

    def _renew(self) -> None:
        """Look where the last frame is old, as nobody has looked for long, or none has come yet.

        In a watched folder one may never come, and is not waited for.
        """
        if self._source is None or self._settings.frozen:
            return
        camera = self._source.camera
        is_first = self._displayed is None and camera.limits is not None
        if not is_first and not camera.is_resting:
            return
        camera.watch(self._watched)
        with self._changed:
            self._changed.wait_for(lambda: camera.has_frame or camera.failure, _FRAME_S)
        if camera.has_frame:
            self._look()

    def _pixel(self, of: str, across: float, down: float) -> dict[str, Any]:
        """A pixel of the displayed frame, at fractions of its width and height."""
        displayed = self._displayed
        if displayed is None:
            raise OptionError("there is no frame yet: start a camera, and try again")
        frame, picture = displayed.shot.frame, displayed.picture
        if of == "raw":
            values, names, unit = frame.counts, frame.channels, "counts"
        elif picture is None:
            raise OptionError("there is no reconstruction")
        else:
            values, names, unit = picture.radiance, picture.channels, "radiance"
        height, width = values.shape[-2:]
        x, y = int(across * width), int(down * height)
        if of == "raw" and frame.mosaic is not None:
            names = (frame.mosaic[2 * (y % 2) + x % 2],)
        pixel = dict(zip(names, values[:, y, x].tolist(), strict=True))
        return {"x": x, "y": y, "unit": unit, "values": pixel}

    def _look(self) -> None:
        """The newest frame, to the page; or the end of a camera that failed."""
        source = self._source
        assert source is not None
        frame = source.camera.take()
        if frame is None:
            self._error = source.camera.failure
            self._leave()
            self._send_state()
            return
        picture, trouble = self._solve(source, frame)
        # A camera is computed too, or developed: it has half of the cores while it is the slower.
        behind = source.camera.has_frame
        torch.set_num_threads(self._cores if behind else max(1, self._cores // 2))
        parts = {"raw": frame.raw}
        white = 1.0
        if picture is not None:
            white = self._white.follow(picture.radiance)
            parts["picture"] = picture_jpeg(picture.radiance, picture.channels, white)
        self._displayed = DisplayedFrame(frame.shot, picture, white, self._settings, source.text)
        self._send(source, frame, picture, trouble, parts)

    def _solve(self, source: LiveSource, frame: LiveFrame) -> tuple[LivePicture | None, str | None]:
        if source.solver is None:
            return None, _NO_PSF
        if frame.measurement is None:
            return None, frame.trouble
        shot = frame.shot
        brightness = max(shot.exposure_s, 1e-9) * max(shot.gain, 1e-9)
        try:
            return source.solver.solve(frame.measurement, self._settings, brightness), None
        except (NolensError, ArithmeticError) as error:
            return None, str(error)

    def _send(
        self,
        source: LiveSource,
        frame: LiveFrame,
        picture: LivePicture | None,
        trouble: str | None,
        parts: dict[str, bytes],
    ) -> None:
        now = time.monotonic()
        self._sent.append(now)
        while self._sent[0] < now - _FPS_OVER_S:
            self._sent.popleft()
        over = now - self._sent[0]
        fps = (len(self._sent) - 1) / over if over > 0 else 0.0
        shot = frame.shot
        header = {
            "number": frame.number,
            "fps": round(fps, 2),
            "latency_ms": round(1e3 * age_s(shot), 1),
            "exposure_s": shot.exposure_s,
            "gain": shot.gain,
            "iterations": None if picture is None else picture.iterations,
            "tau": None if picture is None else picture.tau,
            "prior": None if picture is None else picture.prior.get("prior"),
            "histogram": frame.levels.histogram,
            "clipped_fraction": frame.levels.clipped_fraction,
            "dropped": source.camera.dropped,
            "frozen": self._settings.frozen,
            "trouble": trouble,
        }
        self._channel.send("frame", message(header, parts), round(fps, 2), source.camera.dropped)

    def _warn(self, text: str) -> None:
        self._error = text
        self._send_state()

    def _send_state(self) -> None:
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
            "field_points": 1
            if source is None or source.solver is None
            else source.solver.field_points,
            "limits": None if limits is None else vars(limits),
            "scene": self._scene if source is not None and source.twin is not None else None,
        }
        self._channel.send("state", state, self._left)
