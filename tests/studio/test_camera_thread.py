"""A camera beside the live view: exposure, dropped frames, and cameras that fail or hang."""

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from itertools import pairwise

import pytest
import torch

from nolens.camera import Frame
from nolens.capture import Limits, Shot
from nolens.errors import CameraError
from nolens.studio import live_camera
from nolens.studio.live_camera import CameraThread, LiveFrame
from nolens.studio.schemas import Settings
from patience import PATIENCE_S, until

WHITE, BLACK = 4095.0, 256.0


class Lamp:
    """A camera before an even scene of some counts per second, with one bright pixel in a hundred.

    Parameters
    ----------
    rate
        Counts a second, of the bright pixels.
    fails_at
        Number of the frame at which it is unplugged.
    """

    name = "lamp"
    limits = Limits((1e-4, 10.0), (1.0, 4.0))

    def __init__(self, rate: float, fails_at: int | None = None, pause_s: float = 0.0) -> None:
        self.rate, self.fails_at, self.pause_s = rate, fails_at, pause_s
        self.exposure_s, self.gain, self.count, self.closed = 0.01, 1.0, 0, 0
        self.hang, self.let_go = threading.Event(), threading.Event()

    def open(self) -> None:
        pass

    def set(self, *, exposure_s: float, gain: float) -> None:
        self.limits.check(exposure_s, gain)
        self.exposure_s, self.gain = exposure_s, gain

    def shot(self) -> Shot:
        self.count += 1
        if self.count == self.fails_at:
            raise CameraError("the camera was unplugged: plug it in and start it again")
        time.sleep(self.pause_s)
        counts = torch.full((1, 64, 64), BLACK + 5)
        counts[0, ::8, ::8] = BLACK + self.rate * self.exposure_s * self.gain
        counts = counts.clamp(max=WHITE).round()
        frame = Frame(counts, ("mosaic",), "RGGB", (BLACK,), WHITE, "uint16", "lamp")
        return Shot(frame, datetime.now(UTC), self.exposure_s, self.gain, "lamp", {})

    def close(self) -> None:
        self.closed += 1


class Stuck(Lamp):
    """A camera that gives no frame until it is closed."""

    def shot(self) -> Shot:
        self.hang.wait()
        self.let_go.set()
        raise CameraError("closed")

    def close(self) -> None:
        super().close()
        self.hang.set()


@contextmanager
def running(
    source: Lamp, settings: Settings
) -> Iterator[tuple[CameraThread, Callable[[], LiveFrame]]]:
    changed = threading.Condition()
    camera = CameraThread(source, settings, changed)
    camera.watch(True)
    camera.open(PATIENCE_S)

    def take() -> LiveFrame:
        with changed:
            assert changed.wait_for(
                lambda: camera.has_frame or camera.failure is not None, PATIENCE_S
            )
        taken = camera.take()
        assert taken is not None, camera.failure
        return taken

    try:
        yield camera, take
    finally:
        camera.close()


@pytest.mark.parametrize("rate", [2e3, 3e5, 4e7])
def test_automatic_exposure_fills_the_range_by_steps(rate: float) -> None:
    with running(Lamp(rate, pause_s=0.005), Settings()) as (_, take):
        frames = [take() for _ in range(25)]
    times = [frame.shot.exposure_s for frame in frames]
    for one, other in pairwise(frames):
        steps = abs(math.log2(other.shot.exposure_s / one.shot.exposure_s))
        assert steps < 1.01 * (other.number - one.number)
    wanted = min(0.25, max(1e-4, 0.8 * (WHITE - BLACK) / rate))
    assert times[-1] == pytest.approx(wanted, rel=0.15)
    assert times[-1] == times[-3]


def test_given_exposure_is_kept_within_what_the_camera_can() -> None:
    lamp = Lamp(1e5, pause_s=0.005)
    with running(lamp, Settings(exposure_s=1e-6, gain=100.0)) as (camera, take):
        shot = take().shot
        assert (shot.exposure_s, shot.gain) == (1e-4, 4.0)
        camera.expose(Settings(exposure_s=0.02, gain=2.0))
        assert any(take().shot.exposure_s == 0.02 for _ in range(5))


def test_frames_that_nobody_takes_are_dropped() -> None:
    lamp = Lamp(1e5, pause_s=0.002)
    with running(lamp, Settings(exposure_s=0.01)) as (camera, take):
        first = take().number
        until(lambda: lamp.count > first + 12, "twelve frames more")
        second = take().number
    assert second - first > 10
    assert camera.dropped >= second - first - 2


def test_no_frame_is_taken_while_nobody_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    """A frame now and then for a while, then none until somebody looks, or changes a setting."""
    monkeypatch.setattr(live_camera, "_UNWATCHED_S", 0.01)
    monkeypatch.setattr(live_camera, "_REST_AFTER_S", 0.05)
    lamp = Lamp(1e5, pause_s=0.001)
    with running(lamp, Settings(exposure_s=0.01)) as (camera, _):
        camera.watch(False)
        until(lambda: camera.is_resting, "it rests")
        time.sleep(0.05)  # The frame that was being taken.
        count = lamp.count
        time.sleep(0.1)
        assert lamp.count == count
        camera.expose(Settings(exposure_s=0.02))
        until(lambda: lamp.count == count + 1, "a frame as it is set now")
        time.sleep(0.05)
        assert (lamp.count, lamp.exposure_s) == (count + 1, 0.02)
        camera.watch(True)
        until(lambda: lamp.count > count + 5, "frames again")


def test_camera_that_is_unplugged_is_told_and_given_back() -> None:
    lamp = Lamp(1e5, fails_at=3, pause_s=0.01)
    with running(lamp, Settings()) as (camera, take):
        with pytest.raises(AssertionError, match="unplugged"):
            while True:
                take()
        assert camera.failure is not None and "unplugged" in camera.failure
    assert lamp.closed >= 1


def test_camera_that_hangs_can_be_closed() -> None:
    lamp = Stuck(1e5)
    with running(lamp, Settings()):
        pass
    assert lamp.let_go.wait(PATIENCE_S)
    assert lamp.closed >= 1


def test_camera_that_does_not_open_is_told() -> None:
    class Absent(Lamp):
        def open(self) -> None:
            raise CameraError("no camera is connected")

    camera = CameraThread(Absent(1.0), Settings(), threading.Condition())
    with pytest.raises(CameraError, match="no camera is connected"):
        camera.open(PATIENCE_S)


def test_frame_that_cannot_be_used_is_shown_with_the_reason() -> None:
    """Each cell has a saturated pixel: nothing is left to reconstruct from."""

    class Glaring(Lamp):
        def shot(self) -> Shot:
            found = super().shot()
            found.frame.counts[:, ::2, ::2] = WHITE
            return found

    with running(Glaring(1e3, pause_s=0.005), Settings(exposure_s=0.01)) as (_, take):
        taken = take()
    assert taken.measurement is None
    assert taken.trouble is not None and "saturated" in taken.trouble
    assert taken.levels.clipped_fraction == pytest.approx(0.25, abs=0.02)
    assert taken.raw.startswith(b"\xff\xd8")
