"""`nolens capture`: raw frames of any source, one after the other."""

import math
import time
from collections.abc import Iterator
from contextlib import closing
from itertools import count, cycle
from pathlib import Path
from typing import Any

from nolens.capture import (
    CameraSource,
    Levels,
    Limits,
    Shot,
    TwinSource,
    available_sources,
    exposure_for,
    open_source,
)
from nolens.errors import NolensError
from nolens.files import read_picture
from nolens.jobs.capturing.keep import Burst, Naming, keep
from nolens.jobs.capturing.options import CaptureOptions, Kind
from nolens.jobs.run import Product, Reporter, Run, job

_LONGEST_S = 1.0
"""That is tried unasked."""
_FIRST_S = 0.01
_TRIES = 12
_DIGITS = 2
_LOOK_S = 0.1
_DARK = 0.02
"""Mean of a dark frame, as a fraction of its range, from which on light must have reached it."""
_FAINT = 0.2
_CLIPPED = 1e-3


def exposures(
    source: CameraSource, options: CaptureOptions, reporter: Reporter
) -> tuple[float, ...]:
    """Exposure times of the frames of one round, the shortest first; NaN where none can be set.

    Parameters
    ----------
    source
        The open camera.
    options
        They say the first exposure time, and how many there are.
    reporter
        Sees the tries.

    Raises
    ------
    OptionError
        If one of them, or the gain, is beyond the camera.
    CameraError
        If the camera gives no frames.
    """
    limits = source.limits
    if limits is None:
        return (math.nan,)
    if options.exposure is not None:
        first_s = options.exposure.s
        limits.check(first_s, options.gain)
    else:
        first_s = _found(source, limits, options, reporter)
    times = tuple(first_s * options.factor**number for number in range(options.bracket))
    limits.check(times[-1], options.gain)
    return times


def _found(
    source: CameraSource, limits: Limits, options: CaptureOptions, reporter: Reporter
) -> float:
    """An exposure time that fits what the camera sees now."""
    tried = Limits((limits.exposure_s[0], min(limits.exposure_s[1], _LONGEST_S)), limits.gain)
    exposure_s = min(max(_FIRST_S, tried.exposure_s[0]), tried.exposure_s[1])
    for number in range(_TRIES):
        reporter.advance("exposure", number / _TRIES)
        source.set(exposure_s=exposure_s, gain=options.gain)
        levels = Levels.of(source.shot().frame)
        better_s = exposure_for(levels, exposure_s, tried, every_pixel=options.kind == "psf")
        if better_s == exposure_s:
            break
        exposure_s = better_s
    reporter.advance("exposure", 1.0)
    if exposure_s >= _LONGEST_S:
        reporter.note(f"exposed {_LONGEST_S:g} s, the longest unasked: more light, or --exposure")
    digits = _DIGITS - 1 - math.floor(math.log10(exposure_s))
    return min(max(round(exposure_s, digits), tried.exposure_s[0]), tried.exposure_s[1])


class Stage:
    """Shows a simulated camera what a real one would be put before.

    Parameters
    ----------
    options
        They say what the frames are to show, and which pictures there are.

    Raises
    ------
    FileError
        If there is a folder without any.
    """

    def __init__(self, options: CaptureOptions) -> None:
        self._kind = options.kind
        self._paths = [*options.inputs.values()]
        self._next: Iterator[Path] = cycle(self._paths)

    def prepare(self, source: TwinSource, reporter: Reporter) -> None:
        """Show what is seen first."""
        if self._kind == "dark":
            reporter.note("the simulated camera is covered")
            source.show_dark()
        elif self._kind == "psf":
            reporter.note("the simulated camera looks at a point source, straight ahead")
            source.show_point()
        elif self._paths:
            source.show(read_picture(self._paths[0]).radiance)

    def turn(self, source: TwinSource) -> None:
        """Show the next picture, where there are several: each frame sees another one."""
        if self._kind == "frame" and len(self._paths) > 1:
            source.show(read_picture(next(self._next)).radiance)


class CaptureReporter(Reporter):
    """Whoever watches frames being taken."""

    def levels(self, levels: Levels) -> None:
        """See how bright the newest frame is."""


@job
def capture_frames(run: Run[CaptureOptions]) -> Product[None]:
    """Take frames and write each one as soon as it is taken, with a record of its own.

    A `CaptureReporter` also sees how bright they are.

    Raises
    ------
    NolensError
        If the camera, an option or an output cannot be used. What was written before stays.
    """
    options, reporter = run.options, run.reporter
    naming, stage = Naming.of(options), Stage(options)
    run.begin()
    source = open_source(
        options.source, existing=options.existing, mosaic=options.mosaic, tell=run.warn
    )
    if isinstance(source, TwinSource) and options.source == "auto":
        reporter.note(f"a simulated camera takes the frames, as {available_sources()[0].why}")
    work = _Work(run, source, stage, naming)
    with closing(source):
        if isinstance(source, TwinSource):
            stage.prepare(source, reporter)
        elif options.scene is not None:
            run.warn(f"{options.scene} is not shown: {source.name} sees its own scene")
        source.open()
        work.times = exposures(source, options, reporter)
        try:
            work.all_rounds()
        except NolensError as error:
            if files := len(work.outputs):
                many = "files written before are" if files > 1 else "file written before is"
                kept = f"the {files} {many} kept, in {naming.folder}"
                raise type(error)(f"{error} ({kept})") from error
            raise
    return Product(None, work.figures(), outputs=tuple(work.outputs))


class _Work:
    """All rounds of a capture, and what has been written so far."""

    def __init__(
        self, run: Run[CaptureOptions], source: CameraSource, stage: Stage, naming: Naming
    ) -> None:
        self.run, self.options, self.reporter = run, run.options, run.reporter
        self.source, self.stage, self.naming = source, stage, naming
        self.times: tuple[float, ...] = ()
        self.outputs: list[Path] = []
        self._taken = 0
        self._last: Shot | None = None
        self._exposures: dict[float, dict[str, float]] = {}
        self._stopped = False

    def all_rounds(self) -> None:
        """Take every frame, until all are taken or a person wants to stop."""
        for _ in self._rounds():
            for exposure_s in self.times:
                if not math.isnan(exposure_s):
                    self.source.set(exposure_s=exposure_s, gain=self.options.gain)
                self._burst(exposure_s)
                if self._stopped:
                    return

    def figures(self) -> dict[str, Any]:
        """Figures of the run; for each exposure time, the levels of its last frame."""
        assert self._last is not None
        return {
            "source": self.source.name,
            "kind": self.options.kind,
            "frames": self._taken,
            "files": len(self.outputs),
            "asked": {
                "exposure_s": None if math.isnan(self.times[0]) else self.times[0],
                "gain": self.options.gain,
                "bracket": self.options.bracket,
                "factor": self.options.factor,
            },
            "gain": self._last.gain,
            "size": list(self._last.frame.counts.shape[-2:]),
            "exposures": list(self._exposures.values()),
        }

    def _rounds(self) -> Iterator[int]:
        """Numbers of the rounds, each given when it is due."""
        if self.options.every is None:
            yield 0
            return
        begun, every_s = time.monotonic(), self.options.every.s
        for number in count() if self.options.count is None else range(self.options.count):
            left = begun + number * every_s - time.monotonic()
            if left < -every_s:
                self._warn(
                    f"a round takes longer than {self.options.every}: the next one begins as soon "
                    "as it can"
                )
            while left > 0:
                time.sleep(min(left, _LOOK_S))
                if self._step():
                    return
                left = begun + number * every_s - time.monotonic()
            yield number

    def _burst(self, exposure_s: float) -> None:
        burst = Burst()
        try:
            for _ in range(self.options.frames):
                if self.source.limits is None:  # Files may never come: Ctrl-C is to end that.
                    self.reporter.advance("waiting for a file", 0.0)
                if isinstance(self.source, TwinSource):
                    self.stage.turn(self.source)
                shot = self.source.shot()
                levels = self._look(shot, exposure_s)
                if self.options.average:
                    burst.add(shot)
                else:
                    self._write(shot, levels, exposure_s, 1)
                self._taken += 1
                self._stopped = self._step()
                if self._stopped:
                    break
        finally:
            # Also where the camera fails: what was taken is not lost.
            if burst.frames:
                mean = burst.mean()
                self._write(mean, Levels.of(mean.frame), exposure_s, burst.frames)

    def _look(self, shot: Shot, exposure_s: float) -> Levels:
        levels = Levels.of(shot.frame)
        self._last = shot
        self._exposures[exposure_s] = {
            "exposure_s": shot.exposure_s,
            "bright": levels.brightest if self.options.kind == "psf" else levels.bright,
            "clipped_share": levels.clipped_share,
        }
        if isinstance(self.reporter, CaptureReporter):
            self.reporter.levels(levels)
        if not self._taken:
            for text in _warnings(levels, self.options.kind):
                self._warn(text)
            if shot.details.get("defect_correction") and self.options.kind == "psf":
                self._warn(
                    "the sensor corrects what it takes for defect pixels, and changes bright "
                    "points: switch that off (docs/pi.md, Defect correction)"
                )
        return levels

    def _write(self, shot: Shot, levels: Levels, exposure_s: float, frames: int) -> None:
        named_s = shot.exposure_s if math.isnan(exposure_s) else exposure_s
        path = self.naming.next(named_s, _suffix(shot, self.options.average))
        keep(path, shot, levels, frames, self.run)
        self.outputs.append(path)

    def _step(self) -> bool:
        total = self.options.total or self._taken + 1
        return self.reporter.step("frame", self._taken, total, "the frames")

    def _warn(self, text: str) -> None:
        if text not in self.run.warnings:
            self.run.warn(text)


def _suffix(shot: Shot, average: bool) -> str:
    """Kind of file for a frame, where nobody asked for one."""
    if len(shot.frame.counts) > 1:
        return ".npy"
    return ".tif" if average or shot.frame.mosaic is None else ".dng"


def _warnings(levels: Levels, kind: Kind) -> list[str]:
    """What may be wrong with the frames, told by the first one."""
    clipped = f"{100 * levels.clipped_share:.2g} % of the pixels are saturated"
    if kind == "dark":
        if levels.mean > _DARK:
            return [
                f"light reaches the sensor: the mean of this dark frame is {100 * levels.mean:.2g} "
                "% of the range above black. Cover the camera"
            ]
        return []
    if kind == "psf" and levels.clipped_share > 0:
        return [f"{clipped}, and the PSF's peaks are cut off there: take a shorter --exposure"]
    if levels.clipped_share > _CLIPPED:
        return [f"{clipped}: take a shorter --exposure"]
    if levels.bright < _FAINT:
        return [
            f"the frame is faint: 99.9 % of its pixels lie below {100 * levels.bright:.2g} % of "
            "the range. Take a longer --exposure, or more light"
        ]
    return []
