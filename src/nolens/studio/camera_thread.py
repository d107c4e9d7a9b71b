"""A camera beside the live view: the newest of its frames, exposed as it should be."""

import threading
import time
import traceback
from dataclasses import dataclass

import torch

from nolens.camera import Frame, Measurement, develop
from nolens.capture import CameraSource, Levels, Limits, Shot, TwinSource, exposure_for
from nolens.errors import CameraError, NolensError
from nolens.studio.encode import raw_jpeg
from nolens.studio.live_solver import cells_in_one
from nolens.studio.schemas import Settings

_LONGEST_S = 0.25
"""Automatic exposure is no longer than this: a live view would stand still."""
_FASTER = 2.0
_UNWATCHED_S = 1.0
_SAME = 0.05


@dataclass(frozen=True)
class Taken:
    """A frame, and how it fills the range of its counts.

    Parameters
    ----------
    number
        Counted from 1 since the source was opened.
    shot
        The frame.
    levels
        Its histogram.
    raw
        What the page shows of it, as JPEG.
    seen
        Its linear values, in the pixels of the live view; None where they cannot be used.
    trouble
        Why not.
    """

    number: int
    shot: Shot
    levels: Levels
    raw: bytes
    seen: Measurement | None
    trouble: str | None


class CameraThread:
    """Takes frames in a thread of its own; a frame that nobody took is replaced by the next.

    A simulated camera works out a frame only when the one before was taken.

    Parameters
    ----------
    source
        Used by this thread alone from now on.
    settings
        How to expose.
    changed
        Notified with every frame, and when there will be none any more.
    """

    def __init__(
        self, source: CameraSource, settings: Settings, changed: threading.Condition
    ) -> None:
        self.dropped = 0
        self.failure: str | None = None
        self.watched = False
        self._source, self._settings, self._changed = source, settings, changed
        self._newest: Taken | None = None
        self._number = 0
        self._asked: tuple[float, float] | None = None
        self._opened = threading.Event()
        self._ending = threading.Event()
        self._wake = threading.Event()
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)

    @property
    def name(self) -> str:
        """Of the camera."""
        return self._source.name

    @property
    def limits(self) -> Limits | None:
        """What it can be set to."""
        return self._source.limits

    def open(self, seconds: float) -> None:
        """Open the source.

        Raises
        ------
        CameraError
            If it cannot be, or not in this time.
        """
        self._thread.start()
        if not self._opened.wait(seconds):
            raise CameraError(f"{self.name} has not opened within {seconds:g} s")
        if self.failure is not None:
            raise CameraError(self.failure)

    def take(self) -> Taken | None:
        """The newest frame, once."""
        with self._changed:
            taken, self._newest = self._newest, None
            self._changed.notify_all()
        return taken

    @property
    def has_frame(self) -> bool:
        """Whether there is one to take."""
        return self._newest is not None

    def expose(self, settings: Settings) -> None:
        """Use other settings from the next frame on."""
        self._settings = settings
        self._wake.set()

    def watch(self, watched: bool) -> None:
        """Say whether anyone looks: otherwise a frame a second will do."""
        self.watched = watched
        self._wake.set()

    def close(self) -> None:
        """End the thread and give the source back."""
        self._ending.set()
        self._wake.set()
        with self._changed:
            self._changed.notify_all()
        if self._thread.ident is None:
            return
        self._thread.join(0.7)
        if self._thread.is_alive():
            # It waits for a frame that may never come; closing ends that.
            self._source.close()
            self._thread.join(2.0)

    def _run(self) -> None:
        torch.set_num_threads(1)
        try:
            self._source.open()
            self._opened.set()
            while not self._ending.is_set():
                self._set()
                self._offer(self._source.shot())
                self._rest()
        except NolensError as error:
            self._fail(str(error))
        except Exception as error:
            traceback.print_exc()
            self._fail(f"{self.name} failed: {type(error).__name__}: {error}")
        finally:
            self._opened.set()
            self._source.close()

    def _fail(self, text: str) -> None:
        if not self._ending.is_set():
            with self._changed:
                self.failure = text
                self._changed.notify_all()

    def _offer(self, shot: Shot) -> None:
        levels = Levels.of(shot.frame)
        raw, (seen, trouble) = raw_jpeg(shot.frame), _developed(shot.frame)
        self._number += 1
        with self._changed:
            self.dropped += self._newest is not None
            self._newest = Taken(self._number, shot, levels, raw, seen, trouble)
            self._changed.notify_all()
        self._expose_next(shot, levels)

    def _rest(self) -> None:
        self._wake.clear()
        if not self.watched:
            self._wake.wait(_UNWATCHED_S)
        if isinstance(self._source, TwinSource):
            with self._changed:
                self._changed.wait_for(lambda: self._newest is None or self._ending.is_set())

    def _expose_next(self, shot: Shot, levels: Levels) -> None:
        """Automatic exposure: towards 80 % of the range, by a factor of 2 a frame at most."""
        limits, settings = self._source.limits, self._settings
        if limits is None or settings.exposure_s is not None:
            return
        if self._asked is not None and abs(shot.exposure_s / self._asked[0] - 1) > _SAME:
            return  # A frame that was exposed before the last change: it says nothing new.
        wanted = exposure_for(levels, shot.exposure_s, limits)
        wanted = min(max(wanted, shot.exposure_s / _FASTER), shot.exposure_s * _FASTER)
        longest = max(limits.exposure_s[0], min(_LONGEST_S, limits.exposure_s[1]))
        self._asked = min(wanted, longest), self._gain(limits)

    def _set(self) -> None:
        limits, settings = self._source.limits, self._settings
        if limits is None:
            return
        if settings.exposure_s is not None:
            shortest, longest = limits.exposure_s
            asked = min(max(settings.exposure_s, shortest), longest), self._gain(limits)
        elif self._asked is not None:
            asked = self._asked[0], self._gain(limits)
        else:
            return
        self._source.set(exposure_s=asked[0], gain=asked[1])
        self._asked = asked

    def _gain(self, limits: Limits) -> float:
        return min(max(self._settings.gain, limits.gain[0]), limits.gain[1])


def _developed(frame: Frame) -> tuple[Measurement | None, str | None]:
    """Linear values of a frame, or why there are none. It is as much work as the camera's own."""
    rows = frame.counts.shape[-2] // (1 if frame.mosaic is None else 2)
    try:
        return develop(frame, bin_by=cells_in_one(rows)), None
    except NolensError as error:
        return None, str(error)


def age_s(shot: Shot) -> float:
    """How long ago a shot was taken."""
    return max(0.0, time.time() - shot.taken.timestamp())
