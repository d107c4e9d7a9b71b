"""`nolens capture`: raw frames of any source: one, many, averaged, bracketed, or a time-lapse."""

import math
import re
import time
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from itertools import count, cycle
from pathlib import Path
from typing import Annotated, Any, Literal

from nolens.capture import (
    Burst,
    CameraSource,
    Levels,
    Limits,
    Shot,
    TwinSource,
    available_sources,
    fitting_exposure,
    open_source,
)
from nolens.errors import FileError, NolensError, OptionError
from nolens.files import (
    FRAME_SUFFIXES,
    PICTURE_SUFFIXES,
    RunRecord,
    check_holds,
    read_picture,
    write_frame,
    write_into,
    write_record,
)
from nolens.jobs.fields import Exposure, FilePath, Interval, Mosaic, Name, record_beside
from nolens.jobs.options import JobOptions, Option, Written
from nolens.jobs.run import Product, Reporter, Run, job
from nolens.ranges import Between

_LONGEST_S = 1.0
"""Exposure time that is taken at most where none is asked for."""
_POLL_S = 0.1
_DARK = 0.02
"""Mean of a dark frame, as a fraction of its range, from which on light must have reached it."""
_FAINT = 0.2
_CLIPPED = 1e-3

Kind = Literal["frame", "dark", "psf"]
"""What frames show: a scene, nothing (the camera is covered), or a point source."""

_WHAT, _CAMERA = "What is taken", "Camera"


class CaptureOptions(JobOptions):
    """Take raw frames with a camera: one, many, averaged, bracketed, or over a long time.

    nolens capture -o shot.dng

    Each frame is written as soon as it is taken, with its record as .json beside it; Ctrl-C ends
    after the frame in work, and what was taken stays.
    """

    usage = "capture -o shot.dng"

    output: Annotated[
        FilePath,
        Option(
            ".dng (whole counts of a colour sensor), .tif (with mosaic and levels in it) or .npy "
            "(counts alone). Of several frames the name is numbered: -o day.dng writes "
            "day-0001.dng and so on. Without a suffix it is a folder.",
            needed="the file to write (-o shot.dng), or a folder for several",
            role="output",
            flag="-o",
        ),
    ]
    dark: Annotated[
        bool,
        Option(
            "The camera is covered: take what is subtracted from other frames, with their exposure "
            "time (--exposure) and gain.",
            _WHAT,
            negative=False,
        ),
    ] = False
    psf: Annotated[
        bool,
        Option(
            "The camera sees one point source: no pixel may be saturated. Then: nolens calibrate.",
            _WHAT,
            negative=False,
        ),
    ] = False
    frames: Annotated[int, Between(1, 100_000), Option("Frames one after the other.", _WHAT)] = 1
    average: Annotated[
        bool,
        Option(
            "These become one file, their mean (.tif or .npy, with fractions of counts).",
            _WHAT,
            negative=False,
        ),
    ] = False
    exposure: Annotated[
        Exposure | None,
        Option(
            "Exposure time, such as 40ms.",
            _WHAT,
            default="one that fits what the camera sees, up to 1 s",
        ),
    ] = None
    gain: Annotated[
        float,
        Between(1e-3, 1e4),
        Option("Analogue gain of the sensor; 1 has the least noise.", _WHAT),
    ] = 1.0
    bracket: Annotated[
        int,
        Between(1, 20),
        Option(
            "Exposure times, each --factor times as long as the one before; the first is "
            "--exposure.",
            _WHAT,
        ),
    ] = 1
    factor: Annotated[
        float,
        Between(1.01, 1000),
        Option("Between the exposure times of a bracket.", _WHAT),
    ] = 4.0
    every: Annotated[
        Interval | None, Option("Begin a new round each 10s, for a time-lapse.", _WHAT)
    ] = None
    count: Annotated[
        Annotated[int, Between(1, 10_000_000)] | None,
        Option("Rounds of a time-lapse.", _WHAT, default="until Ctrl-C"),
    ] = None
    source: Annotated[
        Name,
        Option(
            "auto (the Raspberry Pi's camera, or else a simulated one), raspberry, raspberry:1 "
            "(the second camera), twin (simulated), twin:CAMERA (preset or folder), or folder:PATH "
            "(raw files that another camera writes there).",
            _CAMERA,
        ),
    ] = "auto"
    scene: Annotated[
        FilePath | None,
        Option(
            "Picture that a simulated camera looks at, or a folder of them, as of a film: each "
            "frame sees the next one.",
            _CAMERA,
            default="a test chart",
            role="input",
        ),
    ] = None
    existing: Annotated[
        bool,
        Option("Files that a watched folder holds already are taken too.", _CAMERA, negative=False),
    ] = False
    mosaic: Annotated[
        Mosaic | None,
        Option("Colours of the 2×2 cell of a watched folder's files that do not say it.", _CAMERA),
    ] = None

    def check_together(self) -> None:
        """Refuse what a frame cannot show, and options without their use."""
        stated = self.model_fields_set
        if self.dark and self.psf:
            raise OptionError(
                "--dark and --psf are both given: a frame shows either, leave one out"
            )
        if self.count is not None and self.every is None:
            raise OptionError(
                f"--count {self.count} says how many rounds a time-lapse has, and --every how "
                "far they are apart: give both, or --frames for frames one after the other"
            )
        if self.average and self.frames == 1:
            raise OptionError("--average has only one frame: give more, such as --frames 16")
        if "factor" in stated and self.bracket == 1:
            raise OptionError(
                f"--factor {self.factor:g} lies between the exposure times of a bracket, and "
                "there is none: give --bracket 3, or leave it out"
            )
        if self.dark and self.exposure is None and self.sets:
            raise OptionError(
                "a dark frame needs the exposure time of the frames that it is subtracted from: "
                "give it, such as --exposure 40ms"
            )
        if self.scene is not None and self.source.partition(":")[0] not in ("auto", "twin"):
            raise OptionError(
                f"--scene {self.scene} is what a simulated camera looks at, and {self.source}"
                " is none: leave it out, or give --source twin"
            )
        if not self.sets and not stated.isdisjoint(("exposure", "gain", "bracket")):
            raise OptionError(
                "exposure time and gain of a watched folder's frames are set at their camera: "
                "leave out --exposure, --gain and --bracket"
            )

    @property
    def kind(self) -> Kind:
        """What the frames show."""
        return "dark" if self.dark else "psf" if self.psf else "frame"

    @property
    def sets(self) -> bool:
        """Whether exposure time and gain can be set from here."""
        return not self.source.startswith("folder:")

    @property
    def several(self) -> bool:
        """Whether more than one file may be written."""
        files = self.bracket * (1 if self.average else self.frames)
        return files > 1 or self.every is not None

    @property
    def total(self) -> int | None:
        """Frames that are taken in all; None where they go on until they are stopped."""
        rounds = 1 if self.every is None else self.count
        return None if rounds is None else rounds * self.bracket * self.frames

    @property
    def names_folder(self) -> bool:
        """Whether the output is a folder, in which the job names the files."""
        return not self.output.suffix or self.output.is_dir()

    @property
    def output_folder(self) -> Path | None:
        """It is made where it does not exist, but for the one file that was named."""
        if self.names_folder:
            return self.output
        return self.output.parent if self.several else None

    @property
    def inputs(self) -> dict[str, Path]:
        """Pictures that a simulated camera looks at, in their order.

        Raises
        ------
        FileError
            If they are to come from a folder without any.
        """
        if self.scene is None:
            return {}
        pictures = _pictures(self.scene)
        if len(pictures) == 1:
            return {"scene": pictures[0]}
        return {f"scene {number}": path for number, path in enumerate(pictures, start=1)}

    @property
    def written(self) -> tuple[Written, ...]:
        """The one file and its record; several are named as they are written."""
        if self.several or self.names_folder:
            return ()
        record = record_beside(self.output)
        return (
            Written("output", self.output, suffixes=FRAME_SUFFIXES),
            Written("record of the run", record, suffixes=(".json",)),
        )


def _pictures(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    pictures = sorted(
        each
        for each in path.iterdir()
        if each.suffix.lower() in PICTURE_SUFFIXES and not each.name.startswith(".")
    )
    if not pictures:
        raise FileError(
            f"the folder {path} holds no picture; its files can be {', '.join(PICTURE_SUFFIXES)}"
        )
    return pictures


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
    options = run.options
    names = _FileNames(options)
    run.begin()
    source = open_source(
        options.source, existing=options.existing, mosaic=options.mosaic, warn=run.warn
    )
    if isinstance(source, TwinSource) and options.source == "auto":
        run.reporter.note(f"a simulated camera takes the frames, as {available_sources()[0].why}")
    capture = _Capture(run, source, names)
    with closing(source):
        capture.open()
        try:
            capture.all_rounds()
        except NolensError as error:
            if files := len(capture.outputs):
                many = "files written before are" if files > 1 else "file written before is"
                written = f"the {files} {many} kept, in {names.folder}"
                raise type(error)(f"{error} ({written})") from error
            raise
    return Product(None, capture.figures(), outputs=tuple(capture.outputs))


class _FileNames:
    """Gives every file its name, and none that is taken.

    Raises a FileError for an unknown suffix, and an OptionError for an average as .dng.
    """

    def __init__(self, options: CaptureOptions) -> None:
        output = options.output
        self._options, self._number = options, 0
        self.folder, self._stem, self._suffix = output.parent, output.stem, output.suffix
        if options.names_folder:
            self.folder, self._stem, self._suffix = output, str(options.kind), ""
        else:
            # That of one file was checked with its folder.
            if output.suffix.lower() not in FRAME_SUFFIXES:
                raise FileError(
                    f"cannot write {output}: the suffix {output.suffix} is not known here. "
                    f"Accepted: {', '.join(FRAME_SUFFIXES)}"
                )
            if options.average and output.suffix.lower() == ".dng":
                raise OptionError(
                    f"{output.name} would be a DNG, which holds whole counts, and an average has "
                    f"fractions: write {output.with_suffix('.tif').name}"
                )
        self._numbered = options.several or not self._suffix
        if self._numbered:
            self._number = self._largest()

    def next(self, shot: Shot, exposure_s: float) -> Path:
        """Name of the next file."""
        name = self._stem
        if self._numbered:
            self._number += 1
            name += f"-{self._number:04d}"
        if self._options.bracket > 1:
            name += f"-{1e3 * exposure_s:.4g}ms"
        # Not with_suffix: what follows the last dot of the name may be part of a number.
        return self.folder / f"{name}{self._suffix or self._default_suffix(shot)}"

    def _default_suffix(self, shot: Shot) -> str:
        if len(shot.frame.counts) > 1:
            return ".npy"
        return ".tif" if self._options.average or shot.frame.mosaic is None else ".dng"

    def _largest(self) -> int:
        """Largest number that is taken, so that frames of another day stay."""
        pattern = re.compile(rf"{re.escape(self._stem)}-(\d+)(?:-[^/]*ms)?\.\w+")
        try:
            names = [each.name for each in self.folder.iterdir()]
        except OSError:  # It is made with the first frame.
            return 0
        matches = (pattern.fullmatch(name) for name in names)
        return max((int(match[1]) for match in matches if match), default=0)


class _Capture:
    """All rounds of a capture, and what has been written so far."""

    def __init__(self, run: Run[CaptureOptions], source: CameraSource, names: _FileNames) -> None:
        self._run, self._options, self._reporter = run, run.options, run.reporter
        self._source, self._names = source, names
        self._scenes = [*run.options.inputs.values()]
        self._next_scene: Iterator[Path] = cycle(self._scenes)
        self._times: tuple[float, ...] = ()
        self.outputs: list[Path] = []
        self._taken = 0
        self._last: Shot | None = None
        self._exposures: dict[float, dict[str, float]] = {}
        self._stopped = False

    def open(self) -> None:
        """Open the camera and set the exposure times.

        A simulated camera is shown first what a real one would be put before.
        """
        if isinstance(self._source, TwinSource):
            self._show(self._source)
        elif self._options.scene is not None:
            self._run.warn(
                f"{self._options.scene} is not shown: {self._source.name} sees its own scene"
            )
        self._source.open()
        self._times = self._exposure_times()

    def all_rounds(self) -> None:
        """Take every frame, until all are taken or a person wants to stop."""
        for _ in self._rounds():
            for exposure_s in self._times:
                if not math.isnan(exposure_s):
                    self._source.set(exposure_s=exposure_s, gain=self._options.gain)
                self._burst(exposure_s)
                if self._stopped:
                    return

    def figures(self) -> dict[str, Any]:
        """Figures of the run; for each exposure time, the levels of its last frame."""
        assert self._last is not None
        return {
            "source": self._source.name,
            "kind": self._options.kind,
            "frames": self._taken,
            "files": len(self.outputs),
            "asked": {
                "exposure_s": None if math.isnan(self._times[0]) else self._times[0],
                "gain": self._options.gain,
                "bracket": self._options.bracket,
                "factor": self._options.factor,
            },
            "gain": self._last.gain,
            "size": list(self._last.frame.counts.shape[-2:]),
            "exposures": list(self._exposures.values()),
        }

    def _show(self, twin: TwinSource) -> None:
        if self._options.kind == "dark":
            self._reporter.note("the simulated camera is covered")
            twin.show_dark()
        elif self._options.kind == "psf":
            self._reporter.note("the simulated camera looks at a point source, straight ahead")
            twin.show_point()
        elif self._scenes:
            twin.show(read_picture(self._scenes[0]).radiance)

    def _exposure_times(self) -> tuple[float, ...]:
        """Of the frames of one round, the shortest first; NaN where none can be set."""
        options, limits = self._options, self._source.limits
        if limits is None:
            return (math.nan,)
        if options.exposure is not None:
            first_s = options.exposure.s
            limits.check(first_s, options.gain)
        else:
            first_s = self._fitting_exposure(limits)
        times = tuple(first_s * options.factor**number for number in range(options.bracket))
        limits.check(times[-1], options.gain)
        return times

    def _fitting_exposure(self, limits: Limits) -> float:
        shortest, longest = limits.exposure_s
        longest = min(longest, _LONGEST_S)
        exposure_s = fitting_exposure(
            self._source,
            Limits((shortest, longest), limits.gain),
            self._options.gain,
            every_pixel=self._options.kind == "psf",
            progress=partial(self._reporter.advance, "exposure"),
        )
        if exposure_s >= _LONGEST_S:
            self._reporter.note(
                f"exposed {_LONGEST_S:g} s, the longest unasked: more light, or --exposure"
            )
        return exposure_s

    def _rounds(self) -> Iterator[int]:
        """Numbers of the rounds, each when it is due."""
        if self._options.every is None:
            yield 0
            return
        begun, every_s = time.monotonic(), self._options.every.s
        for number in count() if self._options.count is None else range(self._options.count):
            left = begun + number * every_s - time.monotonic()
            if left < -every_s:
                self._warn_once(
                    f"a round takes longer than {self._options.every}: the next one begins as "
                    "soon as it can"
                )
            while left > 0:
                time.sleep(min(left, _POLL_S))
                if self._step():
                    return
                left = begun + number * every_s - time.monotonic()
            yield number

    def _burst(self, exposure_s: float) -> None:
        burst = Burst()
        try:
            for _ in range(self._options.frames):
                shot = self._shot()
                levels = self._check(shot, exposure_s)
                if self._options.average:
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

    def _shot(self) -> Shot:
        if self._source.limits is None:  # Files may never come: Ctrl-C is to end that.
            self._reporter.advance("waiting for a file", 0.0)
        several = self._options.kind == "frame" and len(self._scenes) > 1
        if isinstance(self._source, TwinSource) and several:
            self._source.show(read_picture(next(self._next_scene)).radiance)
        return self._source.shot()

    def _check(self, shot: Shot, exposure_s: float) -> Levels:
        """Levels of a frame, which the reporter sees; the first one's may be warned of."""
        levels = Levels.of(shot.frame)
        self._last = shot
        self._exposures[exposure_s] = {
            "exposure_s": shot.exposure_s,
            "bright": levels.brightest if self._options.kind == "psf" else levels.bright,
            "clipped_share": levels.clipped_fraction,
        }
        if isinstance(self._reporter, CaptureReporter):
            self._reporter.levels(levels)
        if not self._taken:
            for text in _warnings(shot, levels, self._options.kind):
                self._warn_once(text)
        return levels

    def _write(self, shot: Shot, levels: Levels, exposure_s: float, frames: int) -> None:
        """Write a frame, the mean of so many, and its record, both or neither."""
        run, frame = self._run, shot.frame
        path = self._names.next(shot, shot.exposure_s if math.isnan(exposure_s) else exposure_s)
        check_holds(path, frame)
        facts = {
            "kind": run.options.kind,
            "camera": shot.camera,
            "taken": shot.taken.isoformat(timespec="milliseconds"),
            "exposure_s": shot.exposure_s,
            "gain": shot.gain,
            "frames": frames,
            "size": list(frame.counts.shape[-2:]),
            "mosaic": frame.mosaic,
            "black": list(frame.black),
            "white": frame.white,
            "clipped_share": levels.clipped_fraction,
            "bright": levels.bright,
            "brightest": levels.brightest,
            "mean": levels.mean,
            "details": shot.details,
        }
        record = RunRecord(
            started=run.clock.started,
            inputs=run.inputs,
            parameters={**run.options.model_dump(mode="json"), "kind": run.options.kind},
            result=facts,
            history=[],
            warnings=list(run.warnings),
        )
        write_into(
            path.parent,
            {
                path: partial(write_frame, frame=frame, model=shot.camera),
                path.with_suffix(".json"): partial(write_record, record=record),
            },
        )
        self.outputs.append(path)

    def _step(self) -> bool:
        total = self._options.total or self._taken + 1
        return self._reporter.step("frame", self._taken, total, "the frames")

    def _warn_once(self, text: str) -> None:
        if text not in self._run.warnings:
            self._run.warn(text)


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
