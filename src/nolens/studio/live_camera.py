"""The camera of the live view: its source, its frames and exposure, the PSF that it comes with."""

import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from nolens.camera import Frame, LoadedCamera, Measurement, develop
from nolens.camera.measurement import bin_mean
from nolens.capture import (
    CameraSource,
    Levels,
    Limits,
    Shot,
    TwinSource,
    exposure_for,
    open_source,
)
from nolens.errors import CameraError, NolensError
from nolens.files import PSFS_FILE, read_camera, read_frame
from nolens.files.psf_folder import PsfFolder
from nolens.machine import pick_device
from nolens.operators import PixelRectangle
from nolens.studio.live_solver import LiveSolver, live_bin
from nolens.studio.pictures import raw_jpeg
from nolens.studio.schemas import Settings

_OPEN_S = 60.0
_TWIN = "live"
_LONGEST_S = 0.25
"""Automatic exposure is no longer than this: a live view would stand still."""
_LARGEST_FACTOR = 2.0
_UNWATCHED_S = 1.0
_TWIN_PERIOD_S = 0.05
"""Shortest time from one frame of the simulated camera to the next; it has no frame rate."""
_REST_AFTER_S = 10.0
_SAME = 0.05


@dataclass(frozen=True)
class LiveFrame:
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
        Its counts as JPEG.
    measurement
        Its linear values, in the pixels of the live view; None where they cannot be used.
    trouble
        Why not.
    """

    number: int
    shot: Shot
    levels: Levels
    raw: bytes
    measurement: Measurement | None
    trouble: str | None


class CameraThread:
    """Takes frames in a thread of its own; a frame that was not used is replaced by the next.

    A simulated camera computes a frame only when the one before was used.

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
        self._watched_s = self._offered_s = time.monotonic()
        self._source, self._settings, self._changed = source, settings, changed
        self._newest: LiveFrame | None = None
        self._number = 0
        self._target: tuple[float, float] | None = None
        self._open = threading.Event()
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
        if not self._open.wait(seconds):
            raise CameraError(f"{self.name} has not opened within {seconds:g} s")
        if self.failure is not None:
            raise CameraError(self.failure)

    def take(self) -> LiveFrame | None:
        """The newest frame, once."""
        with self._changed:
            frame, self._newest = self._newest, None
            self._changed.notify_all()
        return frame

    @property
    def has_frame(self) -> bool:
        """Whether there is one to take."""
        return self._newest is not None

    def expose(self, settings: Settings) -> None:
        """Use other settings from the next frame on."""
        self._settings = settings
        self._wake.set()

    def watch(self, watched: bool) -> None:
        """Say whether anyone looks: otherwise a frame a second will do, and soon none."""
        self.watched, self._watched_s = watched, time.monotonic()
        self._wake.set()

    @property
    def is_resting(self) -> bool:
        """Whether it takes no frames, since nobody has looked for long."""
        return not self.watched and time.monotonic() - self._watched_s > _REST_AFTER_S

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
            self._open.set()
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
            self._open.set()
            self._source.close()

    def _fail(self, text: str) -> None:
        if not self._ending.is_set():
            with self._changed:
                self.failure = text
                self._changed.notify_all()

    def _offer(self, shot: Shot) -> None:
        levels = Levels.of(shot.frame)
        raw, (measurement, trouble) = raw_jpeg(shot.frame), _developed(shot.frame)
        self._number, self._offered_s = self._number + 1, time.monotonic()
        with self._changed:
            self.dropped += self._newest is not None
            self._newest = LiveFrame(self._number, shot, levels, raw, measurement, trouble)
            self._changed.notify_all()
        self._expose_next(shot, levels)

    def _rest(self) -> None:
        self._wake.clear()
        if not self.watched:
            self._wake.wait(None if self.is_resting else _UNWATCHED_S)
        if isinstance(self._source, TwinSource):
            with self._changed:
                self._changed.wait_for(lambda: self._newest is None or self._ending.is_set())
            self._ending.wait(max(self._offered_s + _TWIN_PERIOD_S - time.monotonic(), 0))

    def _expose_next(self, shot: Shot, levels: Levels) -> None:
        """Automatic exposure: towards 80 % of the range, by a factor of 2 a frame at most."""
        limits, settings = self._source.limits, self._settings
        if limits is None or settings.exposure_s is not None:
            return
        if self._target is not None and abs(shot.exposure_s / self._target[0] - 1) > _SAME:
            return  # A frame that was exposed before the last change: it says nothing new.
        exposure_s = exposure_for(levels, shot.exposure_s, limits)
        shortest_s = shot.exposure_s / _LARGEST_FACTOR
        exposure_s = min(max(exposure_s, shortest_s), shot.exposure_s * _LARGEST_FACTOR)
        longest = max(limits.exposure_s[0], min(_LONGEST_S, limits.exposure_s[1]))
        self._target = min(exposure_s, longest), self._gain(limits)

    def _set(self) -> None:
        limits, settings = self._source.limits, self._settings
        if limits is None:
            return
        if settings.exposure_s is not None:
            shortest, longest = limits.exposure_s
            exposure_s = min(max(settings.exposure_s, shortest), longest)
        elif self._target is not None:
            exposure_s = self._target[0]
        else:
            return
        self._target = exposure_s, self._gain(limits)
        self._source.set(exposure_s=exposure_s, gain=self._target[1])

    def _gain(self, limits: Limits) -> float:
        return min(max(self._settings.gain, limits.gain[0]), limits.gain[1])


def _developed(frame: Frame) -> tuple[Measurement | None, str | None]:
    """Linear values of a frame, or why there are none. It is as much work as the camera's own."""
    rows = frame.counts.shape[-2] // (1 if frame.mosaic is None else 2)
    try:
        return develop(frame, bin_by=live_bin(rows)), None
    except NolensError as error:
        return None, str(error)


def age_s(shot: Shot) -> float:
    """How long ago a shot was taken."""
    return max(0.0, time.time() - shot.taken.timestamp())


@dataclass
class LiveSource:
    """A camera that is open.

    Parameters
    ----------
    text
        As `nolens.capture.open_source` takes it.
    camera
        What takes its frames.
    solver
        What reconstructs them; None without a PSF.
    psf
        File of the PSF; None where there is none, or the twin's own has not been written yet.
    twin, loaded
        The simulated camera, if it is one, and its description.
    """

    text: str
    camera: CameraThread
    solver: LiveSolver | None
    psf: Path | None
    twin: TwinSource | None = None
    loaded: LoadedCamera | None = None

    @property
    def camera_id(self) -> str | None:
        """Preset or folder of a simulated camera."""
        return None if self.twin is None else self.text.removeprefix("twin:")


def open_live(
    text: str,
    psf: str | None,
    settings: Settings,
    changed: threading.Condition,
    warn: Callable[[str], None],
) -> LiveSource:
    """Open a source of frames.

    Parameters
    ----------
    text
        As `nolens.capture.open_source` takes it.
    psf
        File of a PSF, or the list of a folder's (psfs.toml); None for none, or the simulated
        camera's own.
    settings
        How to expose at first.
    changed
        Notified with every frame.
    warn
        Called with a sentence about a file that cannot be read.

    Raises
    ------
    NolensError
        If the source or the PSF cannot be used.
    """
    solver = None if psf is None else _solver(Path(psf))
    file = None if psf is None else Path(psf)
    source = open_source(text, warn=warn)
    camera = CameraThread(source, settings, changed)
    try:
        camera.open(_OPEN_S)
    except NolensError:
        camera.close()
        raise
    if not isinstance(source, TwinSource):
        return LiveSource("raspberry" if text == "auto" else text, camera, solver, file)
    name = text.partition(":")[2] or _TWIN
    loaded = read_camera(name)
    solver = solver or _twin_solver(source, loaded)
    return LiveSource(f"twin:{name}", camera, solver, file, source, loaded)


def _solver(psf: Path) -> LiveSolver:
    """Solver with the PSF of a file, or with all PSFs over the field that a folder lists."""
    acceptance, device = partial(_acceptance, psf.parent), pick_device("auto")
    if psf.name != PSFS_FILE:
        return LiveSolver(read_frame(psf), acceptance=acceptance, device=device)
    psfs = PsfFolder(psf.parent).for_scene(None)
    return LiveSolver(
        psfs.ahead, field_points=psfs.field_points, acceptance=acceptance, device=device
    )


def _acceptance(
    folder: Path, by: int, sensor: tuple[int, int], psf: Tensor
) -> PixelRectangle | None:
    """What the camera of a folder accepts, where that is its PSF's and has such frames."""
    # Most live views know no camera.
    from nolens.jobs.reconstruction.acceptance import acceptance_of, camera_of

    loaded = camera_of(None, folder, by, sensor)
    return None if loaded is None else acceptance_of(loaded, by, sensor, psf, None)


def _twin_solver(source: TwinSource, loaded: LoadedCamera) -> LiveSolver:
    """Solver with the PSF and the support of a simulated camera, in pixels of the live view."""
    psf, support, device = source.psf(), source.support, pick_device("auto")
    # The PSF may have more rows than the sensor.
    by = live_bin(loaded.camera.sensor.rows // loaded.camera.sensor.superpixel)
    if by == 1:
        return LiveSolver(psf, support, device=device)
    size = -(-support.height // by), -(-support.width // by)
    coarse = PixelRectangle(support.top // by, support.left // by, *size)
    return LiveSolver(bin_mean(psf, by), coarse, device=device)
