"""`nolens capture`: raw frames of any source: one, many, averaged, bracketed, or a time-lapse."""

from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Annotated

from nolens.capture import (
    FrameNames,
    FrameSeries,
    Levels,
    SeriesCapture,
    TakenFrame,
    TwinSource,
    available_sources,
    open_source,
)
from nolens.errors import NolensError, OptionError
from nolens.files import (
    FRAME_SUFFIXES,
    check_holds,
    write_frame,
    write_into,
    write_record,
)
from nolens.files.pictures import picture_files
from nolens.jobs.fields import Exposure, FilePath, Interval, Mosaic, Name, record_beside
from nolens.jobs.options import RECORD, JobOptions, Option, Written
from nolens.jobs.run import Product, Reporter, Run, job
from nolens.ranges import Between

_WHAT, _CAMERA = "Series and exposure", "Camera"


class CaptureOptions(JobOptions):
    """Take raw frames with a camera: one, many, averaged, bracketed, or over a long time.

    nolens capture -o shot.dng

    nolens capture --psf --frames 8 -o point

    Each frame is written as soon as it is taken, with its record as .json beside it; Ctrl-C ends
    the series after the current frame, and the frames so far stay.
    """

    usage = "capture -o shot.dng"

    output: Annotated[
        FilePath,
        Option(
            "File to write: .dng (whole counts of a colour sensor), .tif (with mosaic and levels "
            "in it) or .npy (counts alone). Of several frames the name is numbered: -o day.dng "
            "writes day-0001.dng and so on. Without a suffix it is a folder.",
            needed="the file to write (-o shot.dng), or a folder for several",
            role="output",
            flag="-o",
        ),
    ]
    dark: Annotated[
        bool,
        Option(
            "The camera is covered: take frames to subtract from others, with the exposure time "
            "(--exposure) and gain of those.",
            negative=False,
        ),
    ] = False
    psf: Annotated[
        bool,
        Option(
            "The camera sees one point source: no pixel may be saturated. Then: nolens calibrate.",
            negative=False,
        ),
    ] = False
    frames: Annotated[int, Between(1, 100_000), Option("How many frames, one after the other.")] = 1
    average: Annotated[
        bool,
        Option(
            "The frames become one file, their mean (.tif or .npy, with fractions of counts).",
            _WHAT,
            negative=False,
        ),
    ] = False
    exposure: Annotated[
        Exposure | None,
        Option(
            "Exposure time, such as 40ms.",
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
        Interval | None, Option("Time from round to round of a time-lapse, such as 10s.", _WHAT)
    ] = None
    count: Annotated[
        Annotated[int, Between(1, 10_000_000)] | None,
        Option("Rounds of a time-lapse.", _WHAT, default="until Ctrl-C"),
    ] = None
    source: Annotated[
        Name,
        Option(
            "The camera: auto (the Raspberry Pi's, or else a simulated one), raspberry, "
            "raspberry:1 (the second camera), twin (simulated), twin:CAMERA (preset or folder), "
            "folder:PATH (raw files that another camera writes there), micromanager:ADAPTER:DEVICE "
            "or genicam:NAME (docs/cameras.md).",
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
        Option("Colours of the sensor's superpixel, where files or camera do not say it.", _CAMERA),
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
    def sets(self) -> bool:
        """Whether exposure time and gain can be set from here."""
        return not self.source.startswith("folder:")

    @property
    def series(self) -> FrameSeries:
        """What is taken."""
        return FrameSeries(
            kind="dark" if self.dark else "psf" if self.psf else "frame",
            frames=self.frames,
            average=self.average,
            exposure_s=None if self.exposure is None else self.exposure.s,
            gain=self.gain,
            bracket=self.bracket,
            factor=self.factor,
            every=self.every,
            rounds=self.count,
        )

    @property
    def names_folder(self) -> bool:
        """Whether the output is a folder, in which the job names the files."""
        return not self.output.suffix or self.output.is_dir()

    @property
    def output_folder(self) -> Path | None:
        """It is made where it does not exist, but for the one file that was named."""
        if self.names_folder:
            return self.output
        return self.output.parent if self.series.several else None

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
        pictures = picture_files(self.scene)
        if len(pictures) == 1:
            return {"scene": pictures[0]}
        return {f"scene {number}": path for number, path in enumerate(pictures, start=1)}

    @property
    def written(self) -> tuple[Written, ...]:
        """The one file and its record; several are named as they are written."""
        if self.series.several or self.names_folder:
            return ()
        record = record_beside(self.output)
        return (
            Written("output", self.output, suffixes=FRAME_SUFFIXES),
            Written(RECORD, record, suffixes=(".json",)),
        )


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
    options, series = run.options, run.options.series
    names = FrameNames(options.output, options.names_folder, series)
    run.begin()

    def warn_once(text: str) -> None:
        if text not in run.warnings:
            run.warn(text)

    source = open_source(
        options.source, existing=options.existing, mosaic=options.mosaic, warn=run.warn
    )
    if not isinstance(source, TwinSource):
        if options.scene is not None:
            run.warn(f"{options.scene} is not shown: {source.name} sees its own scene")
    elif options.source == "auto":
        run.reporter.note(f"a simulated camera takes the frames, as {available_sources()[0].why}")
    outputs: list[Path] = []

    def write(taken: TakenFrame) -> None:
        path = names.next(taken)
        _write_frame(path, taken, run)
        outputs.append(path)

    capture = SeriesCapture(
        series,
        source,
        options.inputs.values(),
        run.reporter,
        write=write,
        warn=warn_once,
        display=run.reporter.levels if isinstance(run.reporter, CaptureReporter) else None,
    )
    with closing(source):
        try:
            capture.run()
        except NolensError as error:
            if files := len(outputs):
                many = "files written before are" if files > 1 else "file written before is"
                written = f"the {files} {many} kept, in {names.folder}"
                raise type(error)(f"{error} ({written})") from error
            raise
    return Product(None, {**capture.figures(), "files": len(outputs)}, outputs=tuple(outputs))


def _write_frame(path: Path, taken: TakenFrame, run: Run[CaptureOptions]) -> None:
    """Write a frame and its record, both or neither."""
    frame, kind = taken.shot.frame, run.options.series.kind
    check_holds(path, frame)
    parameters = {**run.options.model_dump(mode="json"), "kind": kind}
    record = run.record({"kind": kind, **taken.figures()}, parameters)
    write_into(
        path.parent,
        {
            path: partial(write_frame, frame=frame, model=taken.shot.camera),
            path.with_suffix(".json"): partial(write_record, record=record),
        },
    )
