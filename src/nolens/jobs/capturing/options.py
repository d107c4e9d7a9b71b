"""What `nolens capture` can be told, as a frozen model."""

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from nolens.errors import OptionError
from nolens.jobs.fields import Exposure, FilePath, Interval, Mosaic, Name, record_beside
from nolens.jobs.options import JobOptions, Written
from nolens.ranges import Between

Kind = Literal["frame", "dark", "psf"]


class CaptureOptions(JobOptions):
    """What `nolens capture` can be told.

    Attributes
    ----------
    output
        File to write (.dng, .tif, .npy), whose name is numbered where there are several; without
        a suffix, a folder for numbered files.
    kind
        What the frames show: a scene, nothing (the camera is covered), or a point source.
    source
        Text for `nolens.capture.open_source`.
    scene
        Picture that a simulated camera looks at, or a folder of them: each frame sees the next.
    exposure
        Exposure time; None finds one that fits.
    gain
        Analogue gain.
    frames
        How many are taken one after the other.
    average
        Whether these become one file, their mean.
    bracket
        How many exposure times, each `factor` times as long as the one before.
    factor
        Between the exposure times of a bracket.
    every, count
        Time between the beginnings of two rounds of all that, and how many rounds; None takes
        one round, or goes on until it is stopped.
    existing
        Whether files that a watched folder holds already are taken too.
    mosaic
        Of the files of a watched folder that do not say it.
    """

    output: FilePath
    kind: Kind = "frame"
    source: Name = "auto"
    scene: FilePath | None = None
    exposure: Exposure | None = None
    gain: Annotated[float, Between(1e-3, 1e4)] = 1.0
    frames: Annotated[int, Between(1, 100_000)] = 1
    average: bool = False
    bracket: Annotated[int, Between(1, 20)] = 1
    factor: Annotated[float, Between(1.01, 1000)] = 4.0
    every: Interval | None = None
    count: Annotated[int, Between(1, 10_000_000)] | None = None
    existing: bool = False
    mosaic: Mosaic | None = None

    @classmethod
    def gather(cls, given: dict[str, Any]) -> Self:
        """Options as the command line gives them.

        Raises
        ------
        OptionError
            If one is missing, its value cannot be used, or two do not go together.
        """
        if not given.get("output"):
            raise OptionError(
                "no output is given; name the file to write (-o shot.dng), or a folder for several"
            )
        options = cls.checked(given)
        if options.count is not None and options.every is None:
            raise OptionError(
                f"--count {options.count} says how many rounds a time-lapse has, and --every how "
                "far they are apart: give both, or --frames for frames one after the other"
            )
        if options.average and options.frames == 1:
            raise OptionError("--average has only one frame: give more, such as --frames 16")
        if "factor" in given and options.bracket == 1:
            raise OptionError(
                f"--factor {options.factor:g} lies between the exposure times of a bracket, and "
                "there is none: give --bracket 3, or leave it out"
            )
        if options.kind == "dark" and options.exposure is None and options.sets:
            raise OptionError(
                "a dark frame needs the exposure time of the frames that it is subtracted from: "
                "give it, such as --exposure 40ms"
            )
        if options.scene is not None and options.source.partition(":")[0] not in ("auto", "twin"):
            raise OptionError(
                f"--scene {options.scene} is what a simulated camera looks at, and {options.source}"
                " is none: leave it out, or give --source twin"
            )
        if not options.sets and any(name in given for name in ("exposure", "gain", "bracket")):
            raise OptionError(
                "exposure time and gain of a watched folder's frames are set at their camera: "
                "leave out --exposure, --gain and --bracket"
            )
        return options

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
    def inputs(self) -> dict[str, Path]:
        """Files that are read, by role."""
        return {} if self.scene is None else {"scene": self.scene}

    @property
    def written(self) -> tuple[Written, ...]:
        """The one file and its record; the names of several are found as they are written."""
        if self.several or not self.output.suffix:
            return ()
        record = record_beside(self.output)
        return (Written("output", self.output), Written("record of the run", record))
