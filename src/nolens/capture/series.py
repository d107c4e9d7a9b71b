"""Frames of any source, one after the other: averaged, bracketed, or over a long time."""

import math
import re
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import count, cycle
from pathlib import Path
from typing import Any, Literal, Protocol

from nolens.capture.exposure import Burst, Levels, fitting_exposure
from nolens.capture.source import BurstSource, CameraSource, Limits, Shot
from nolens.capture.twin import TwinSource
from nolens.errors import FileError, OptionError
from nolens.files import FRAME_SUFFIXES, read_picture
from nolens.quantities import Duration

_LONGEST_S = 1.0
"""Exposure time that is taken at most where none is asked for."""
_POLL_S = 0.1
_DARK = 0.02
"""Mean of a dark frame, as a fraction of its range, from which on light must have reached it."""
_FAINT = 0.2
_CLIPPED = 1e-3

Kind = Literal["frame", "dark", "psf"]
"""What frames show: a scene, nothing (the camera is covered), or a point source."""


class Watcher(Protocol):
    """Whoever watches frames being taken; `nolens.jobs.Reporter` is one."""

    def note(self, text: str) -> None:
        """Say something a person should know before it happens."""

    def advance(self, what: str, fraction: float) -> None:
        """See how much of a piece of work is done, from 0 to 1."""

    def step(self, what: str, done: int, limit: int, result: str) -> bool:
        """See how many frames are taken; True ends the series, and `result` so far stays."""


@dataclass(frozen=True)
class FrameSeries:
    """What frames are taken, in rounds.

    Parameters
    ----------
    kind
        What they show.
    frames
        One after the other with each exposure time.
    average
        Whether these become one, their mean.
    exposure_s
        The first exposure time; None takes one that fits what the camera sees, up to 1 s.
    gain
        Analogue gain.
    bracket, factor
        Exposure times in a round, and how many times as long each is as the one before.
    every
        From the beginning of a round to that of the next one; None for one round only.
    rounds
        How many there are, if there are several; None for no end.
    """

    kind: Kind = "frame"
    frames: int = 1
    average: bool = False
    exposure_s: float | None = None
    gain: float = 1.0
    bracket: int = 1
    factor: float = 4.0
    every: Duration | None = None
    rounds: int | None = None

    @property
    def several(self) -> bool:
        """Whether more than one file may come of it."""
        return self.bracket * (1 if self.average else self.frames) > 1 or self.every is not None

    @property
    def total(self) -> int | None:
        """Frames that are taken in all; None where they go on until they are stopped."""
        rounds = 1 if self.every is None else self.rounds
        return None if rounds is None else rounds * self.bracket * self.frames


@dataclass(frozen=True)
class TakenFrame:
    """A frame, or the mean of some, to be written.

    Parameters
    ----------
    shot
        The frame.
    levels
        How it fills its range.
    request_s
        Exposure time that the camera was set to, or that it reports where none can be set.
    frames
        How many it is the mean of.
    """

    shot: Shot
    levels: Levels
    request_s: float
    frames: int = 1

    def figures(self) -> dict[str, Any]:
        """Camera, exposure, size and levels, for the record of the frame."""
        shot, frame, levels = self.shot, self.shot.frame, self.levels
        return {
            "camera": shot.camera,
            "taken": shot.taken.isoformat(timespec="milliseconds"),
            "exposure_s": shot.exposure_s,
            "gain": shot.gain,
            "frames": self.frames,
            "size": list(frame.counts.shape[-2:]),
            "mosaic": frame.mosaic,
            "black": list(frame.black),
            "white": frame.white,
            "clipped_fraction": levels.clipped_fraction,
            "bright": levels.bright,
            "brightest": levels.brightest,
            "mean": levels.mean,
            "details": shot.details,
        }


class FrameNames:
    """Gives every file of a series its name, and none that is taken.

    Raises a FileError for an unknown suffix, and an OptionError for an average as .dng.

    Parameters
    ----------
    output
        The file to write, whose name is numbered where there are several; or a folder.
    is_folder
        Whether it is one: then the kind of frames names the files.
    series
        What is taken.
    """

    def __init__(self, output: Path, is_folder: bool, series: FrameSeries) -> None:
        self._series = series
        self.folder, self._stem, self._suffix = output.parent, output.stem, output.suffix
        if is_folder:
            self.folder, self._stem, self._suffix = output, str(series.kind), ""
        # That of one file was checked with its folder.
        elif output.suffix.lower() not in FRAME_SUFFIXES:
            raise FileError(
                f"cannot write {output}: the suffix {output.suffix} is not known here. "
                f"Accepted: {', '.join(FRAME_SUFFIXES)}"
            )
        elif series.average and output.suffix.lower() == ".dng":
            raise OptionError(
                f"{output.name} would be a DNG, which holds whole counts, and an average has "
                f"fractions: write {output.with_suffix('.tif').name}"
            )
        self._numbered = series.several or is_folder
        self._number = self._largest() if self._numbered else 0

    def next(self, taken: TakenFrame) -> Path:
        """Name of the next file."""
        name = self._stem
        if self._numbered:
            self._number += 1
            name += f"-{self._number:04d}"
        if self._series.bracket > 1:
            name += f"-{1e3 * taken.request_s:.4g}ms"
        # Not with_suffix: what follows the last dot of the name may be part of a number.
        return self.folder / f"{name}{self._suffix or self._default_suffix(taken.shot)}"

    def _default_suffix(self, shot: Shot) -> str:
        if len(shot.frame.counts) > 1:
            return ".npy"
        return ".tif" if self._series.average or shot.frame.mosaic is None else ".dng"

    def _largest(self) -> int:
        """Largest number that is taken, so that frames of another day stay."""
        pattern = re.compile(rf"{re.escape(self._stem)}-(\d+)(?:-[^/]*ms)?\.\w+")
        try:
            names = [each.name for each in self.folder.iterdir()]
        except OSError:  # It is made with the first frame.
            return 0
        matches = (pattern.fullmatch(name) for name in names)
        return max((int(match[1]) for match in matches if match), default=0)


class SeriesCapture:
    """Takes a series of frames from a source.

    Parameters
    ----------
    series
        What is taken.
    source
        Is opened by `run`, and left open.
    scenes
        Pictures that a simulated camera looks at, one for each frame in turn.
    watcher
        Sees the progress, and may end the series.
    write
        Called with each frame to write, as soon as it is taken.
    warn
        Called with a sentence about what may be wrong.
    display
        Called with the levels of every frame.
    """

    def __init__(
        self,
        series: FrameSeries,
        source: CameraSource,
        scenes: Iterable[Path],
        watcher: Watcher,
        *,
        write: Callable[[TakenFrame], None],
        warn: Callable[[str], None],
        display: Callable[[Levels], None] | None = None,
    ) -> None:
        self._series, self._source, self._watcher = series, source, watcher
        self._write, self._warn, self._display = write, warn, display
        self._scenes = [*scenes]
        self._next_scene = cycle(self._scenes)
        self._times: tuple[float, ...] = ()
        self._taken = 0
        self._last: Shot | None = None
        self._exposures: dict[float, dict[str, float]] = {}

    def run(self) -> None:
        """Take every frame, until all are taken or the watcher ends it.

        Raises
        ------
        NolensError
            If the camera gives no frames, or a setting or file cannot be used. What was taken
            before is written.
        """
        if isinstance(self._source, TwinSource):
            # It looks first at what a real one would be put before.
            self._show(self._source)
        self._source.open()
        self._times = self._exposure_times()
        for _ in self._rounds():
            for exposure_s in self._times:
                if not math.isnan(exposure_s):
                    self._source.set(exposure_s=exposure_s, gain=self._series.gain)
                if self._burst(exposure_s):
                    return

    def figures(self) -> dict[str, Any]:
        """Figures of the series; for each exposure time, the levels of its last frame."""
        assert self._last is not None
        series = self._series
        return {
            "source": self._source.name,
            "kind": series.kind,
            "frames": self._taken,
            "request": {
                "exposure_s": None if math.isnan(self._times[0]) else self._times[0],
                "gain": series.gain,
                "bracket": series.bracket,
                "factor": series.factor,
            },
            "gain": self._last.gain,
            "size": list(self._last.frame.counts.shape[-2:]),
            "exposures": list(self._exposures.values()),
        }

    def _show(self, twin: TwinSource) -> None:
        if self._series.kind == "dark":
            self._watcher.note("the simulated camera is covered")
            twin.show_dark()
        elif self._series.kind == "psf":
            self._watcher.note("the simulated camera looks at a point source, straight ahead")
            twin.show_point()
        elif self._scenes:
            twin.show(read_picture(self._scenes[0]).radiance)

    def _exposure_times(self) -> tuple[float, ...]:
        """Of the frames of one round, the shortest first; NaN where none can be set."""
        series, limits = self._series, self._source.limits
        if limits is None:
            if series.exposure_s is not None:
                raise OptionError(
                    f"{self._source.name} has no exposure time that can be set: leave out "
                    "--exposure"
                )
            return (math.nan,)
        first_s = series.exposure_s
        if first_s is None:
            first_s = self._fitting_exposure(limits)
        else:
            limits.check(first_s, series.gain)
        times = tuple(first_s * series.factor**number for number in range(series.bracket))
        limits.check(times[-1], series.gain)
        return times

    def _fitting_exposure(self, limits: Limits) -> float:
        shortest, longest = limits.exposure_s
        exposure_s = fitting_exposure(
            self._source,
            Limits((shortest, min(longest, _LONGEST_S)), limits.gain),
            self._series.gain,
            every_pixel=self._series.kind == "psf",
            progress=partial(self._watcher.advance, "exposure"),
        )
        if exposure_s >= _LONGEST_S:
            self._watcher.note(
                f"exposed {_LONGEST_S:g} s, the longest unasked: more light, or --exposure"
            )
        return exposure_s

    def _rounds(self) -> Iterator[int]:
        """Numbers of the rounds, each when it is due."""
        every = self._series.every
        if every is None:
            yield 0
            return
        begun = time.monotonic()
        for number in count() if self._series.rounds is None else range(self._series.rounds):
            due = begun + number * every.s
            left = due - time.monotonic()
            if left < -every.s:
                self._warn(
                    f"a round takes longer than {every}: the next one begins as soon as it can"
                )
            while left > 0:
                time.sleep(min(left, _POLL_S))
                if self._step():
                    return
                left = due - time.monotonic()
            yield number

    def _burst(self, exposure_s: float) -> bool:
        """Take the frames of one exposure time; True if the watcher ends the series."""
        burst = Burst()
        shots = self._shots()
        try:
            for shot in shots:
                levels = self._check(shot, exposure_s)
                if self._series.average:
                    burst.add(shot)
                else:
                    self._hand_over(shot, levels, exposure_s, 1)
                self._taken += 1
                if self._step():
                    return True
            return False
        finally:
            shots.close()
            # Also where the camera fails: what was taken is not lost.
            if burst.frames:
                mean = burst.mean()
                self._hand_over(mean, Levels.of(mean.frame), exposure_s, burst.frames)

    def _shots(self) -> Generator[Shot]:
        """Frames of one exposure time."""
        if self._series.frames > 1 and isinstance(self._source, BurstSource):
            yield from self._source.burst(self._series.frames)
            return
        for _ in range(self._series.frames):
            yield self._shot()

    def _shot(self) -> Shot:
        if self._source.limits is None:  # Files may never come: Ctrl-C is to end that.
            self._watcher.advance("waiting for a file", 0.0)
        several = self._series.kind == "frame" and len(self._scenes) > 1
        if isinstance(self._source, TwinSource) and several:
            self._source.show(read_picture(next(self._next_scene)).radiance)
        return self._source.shot()

    def _check(self, shot: Shot, exposure_s: float) -> Levels:
        """Levels of a frame, which are displayed; the first one's may be warned of."""
        levels = Levels.of(shot.frame)
        self._last = shot
        self._exposures[exposure_s] = {
            "exposure_s": shot.exposure_s,
            "bright": levels.brightest if self._series.kind == "psf" else levels.bright,
            "clipped_fraction": levels.clipped_fraction,
        }
        if self._display is not None:
            self._display(levels)
        if not self._taken:
            for text in _warnings(shot, levels, self._series.kind):
                self._warn(text)
        return levels

    def _hand_over(self, shot: Shot, levels: Levels, exposure_s: float, frames: int) -> None:
        request_s = shot.exposure_s if math.isnan(exposure_s) else exposure_s
        self._write(TakenFrame(shot, levels, request_s, frames))

    def _step(self) -> bool:
        total = self._series.total or self._taken + 1
        return self._watcher.step("frame", self._taken, total, "the frames")


def _warnings(shot: Shot, levels: Levels, kind: Kind) -> list[str]:
    """What may be wrong with the frames, by the first one."""
    texts = []
    clipped = f"{100 * levels.clipped_fraction:.2g} % of the pixels are saturated"
    if kind == "dark":
        if levels.mean > _DARK:
            texts.append(
                f"light reaches the sensor: the mean of this dark frame is {100 * levels.mean:.2g} "
                "% of the range above black. Cover the camera"
            )
    elif kind == "psf" and levels.clipped_fraction > 0:
        texts.append(f"{clipped}, and the PSF's peaks are cut off there: take a shorter --exposure")
    elif levels.clipped_fraction > _CLIPPED:
        texts.append(f"{clipped}: take a shorter --exposure")
    elif levels.bright < _FAINT:
        texts.append(
            f"the frame is faint: 99.9 % of its pixels lie below {100 * levels.bright:.2g} % of "
            "the range. Take a longer --exposure, or more light"
        )
    if kind == "psf" and shot.details.get("defect_correction"):
        texts.append(
            "the sensor corrects what it takes for defect pixels, and changes bright points: "
            "switch that off (docs/pi.md, Defect correction)"
        )
    return texts
