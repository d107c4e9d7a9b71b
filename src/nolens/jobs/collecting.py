"""`nolens collect`: pictures shown on a screen, and what a camera measures of them, as pairs."""

import hashlib
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from nolens.calibrate.screen_place import ScreenPlace, find_screen
from nolens.camera import Frame, develop
from nolens.capture import CameraSource, Levels, Limits, Shot, TwinSource, open_source
from nolens.capture.exposure import fitting_exposure
from nolens.capture.screen import Screen, TwinScreen, dots, on_screen
from nolens.engine import Manifest
from nolens.errors import CameraError, DataError, OptionError
from nolens.evaluate.registration import Registration, resampled
from nolens.files import read_frame, write_frame, write_into, write_png
from nolens.files.picture_sets import PictureSet, open_pictures
from nolens.jobs.fields import Exposure, FilePath, Name, OutputFolderOptions
from nolens.jobs.options import Option, Written
from nolens.jobs.run import Product, Reporter, Run, Writer, job
from nolens.operators import PixelRectangle
from nolens.quantities import Length
from nolens.ranges import Between

_LONGEST_S, _DOT_TIMES = 1.0, 16.0
"""Exposure time of a white screen, at most, and how many of it a dot takes."""
_CLIPPED = 1e-3
_TRIES = 3
_MOVED_PX = 1.0
_CAMERA = "Camera and screen"
MEASURED, PICTURES, PATTERN, DARK = "measured", "pictures", "pattern", "dark"


class CollectOptions(OutputFolderOptions):
    """Show pictures on a screen, and take a raw frame of each: pairs of measurement and picture.

    nolens collect pictures/ --distance 300mm --screen-width 520mm -o pairs

    A page opens, to be put on the screen before the camera, as large as it is; the room dark.
    First a white screen sets the exposure, and nine dots, one after the other, show where the
    screen lies in the camera's pixels. Each picture is followed by a black screen. Stopped at any
    time, the same command goes on. The folder has the frames, the pictures on the pixels of a
    reconstruction, and a dark frame, as nolens calibrate pairs and nolens compare take them.
    """

    usage = "collect PICTURES --distance 300mm --screen-width 520mm -o FOLDER"
    record_file: ClassVar[str] = "collect.json"

    pictures: Annotated[
        FilePath,
        Option(
            "Pictures to show: a folder, or a data set as nolens compare takes it.",
            needed="the pictures to show (nolens collect PICTURES --distance 300mm --screen-width "
            "520mm -o FOLDER)",
            role="input",
            positional=True,
        ),
    ]
    output: Annotated[
        FilePath,
        Option(
            f"Folder for {MEASURED}/ (raw frames), {PICTURES}/ (what they show, PNG), "
            f"{DARK}.tif, {PATTERN}/ (frames of the dots and of black screens) and collect.json "
            "(the record).",
            needed="the folder for the pairs (-o FOLDER)",
            role="output",
            flag="-o",
        ),
    ]
    distance: Annotated[
        Length,
        Between("1 mm", "100 m"),
        Option(
            "From the camera to the screen, such as 300mm.",
            needed="that from the camera to the screen (--distance 300mm)",
        ),
    ]
    screen_width: Annotated[
        Length,
        Between("5 mm", "20 m"),
        Option(
            "Of the lit part of the screen, such as 520mm.",
            needed="that of the lit part of the screen (--screen-width 520mm)",
        ),
    ]
    source: Annotated[
        Name, Option("The camera, as --source of capture; twin sees a simulated screen.")
    ] = "auto"
    exposure: Annotated[
        Exposure | None,
        Option("Of every picture, such as 40ms.", default="what fits a white screen, up to 1 s"),
    ] = None
    gain: Annotated[float, Between(1e-3, 1e4), Option("Analogue gain of the camera.", _CAMERA)] = (
        1.0
    )
    interleave: Annotated[
        int,
        Between(1, 100_000),
        Option("After so many pictures a black and a white screen are taken again.", _CAMERA),
    ] = 25

    @property
    def written(self) -> tuple[Written, ...]:
        """The record; frames are named as they are taken."""
        return self.in_folder({})


class CollectReporter(Reporter):
    """Whoever watches pictures being shown; it has the screen."""

    def screen(self) -> Screen:
        """The screen before the camera.

        Raises
        ------
        OptionError
            If there is none.
        """
        raise OptionError(
            "there is no screen to show pictures on: run nolens collect at a terminal, or give "
            "--source twin"
        )


@dataclass(frozen=True)
class _Bench:
    """A camera before a screen.

    Parameters
    ----------
    source, screen
        Both open.
    exposure_s
        Of pictures; None where none can be set.
    gain
        Of all frames.
    """

    source: CameraSource
    screen: Screen
    exposure_s: float | None
    gain: float

    @classmethod
    def of(cls, run: Run[CollectOptions], source: CameraSource, noted: float | None) -> "_Bench":
        """With the exposure that was noted before, that is stated, or that fits a white screen."""
        options = run.options
        screen: Screen
        if isinstance(source, TwinSource):
            screen = TwinScreen(source, options.screen_width.mm, options.distance.mm)
        elif isinstance(run.reporter, CollectReporter):
            screen = run.reporter.screen()
        else:
            screen = CollectReporter().screen()
        exposure = None if options.exposure is None else options.exposure.s
        exposure = exposure if noted is None else noted
        limits = source.limits
        if exposure is None and limits is not None:
            screen.show(torch.ones(3, *screen.size))
            shortest, longest = limits.exposure_s
            exposure = fitting_exposure(
                source,
                Limits((shortest, min(longest, _LONGEST_S)), limits.gain),
                options.gain,
                progress=partial(run.reporter.advance, "exposure"),
            )
        return cls(source, screen, exposure if limits is not None else None, options.gain)

    def black(self) -> None:
        """Blank the screen."""
        self.screen.show(torch.zeros(3, *self.screen.size))

    def shot(self, picture: Tensor, times: float = 1.0) -> Shot:
        """A frame of a picture, the screen blanked after it.

        Raises
        ------
        CameraError
            If the camera gives none in three tries, or one that is saturated.
        """
        reason = "no frame came"
        for _ in range(_TRIES):
            self.screen.show(picture)
            try:
                if self.exposure_s is not None and self.source.limits is not None:
                    exposure_s = min(times * self.exposure_s, self.source.limits.exposure_s[1])
                    self.source.set(exposure_s=exposure_s, gain=self.gain)
                shot = self.source.shot()
            except CameraError as error:
                reason = str(error)
                continue
            finally:
                self.black()
            clipped = Levels.of(shot.frame).clipped_fraction
            if clipped <= _CLIPPED:
                return shot
            raise CameraError(
                f"{100 * clipped:.2g} % of the pixels of a frame are saturated: give a shorter "
                "--exposure"
            )
        raise CameraError(f"the camera failed {_TRIES} times: {reason}")


@job
def collect(run: Run[CollectOptions]) -> Product[ScreenPlace]:
    """Show every picture that is not done yet, and write its frame, and the picture as it lies.

    Raises
    ------
    NolensError
        If the camera, the screen or an option cannot be used, or the screen is not found. What
        was written before stays, and the same options go on.
    """
    options = run.options
    pictures = open_pictures(options.pictures)
    run.begin()
    manifest = Manifest.open(options.output, _about(options, pictures), pictures.names)
    with closing(manifest), closing(open_source(options.source)) as source:
        source.open()
        bench = _Bench.of(run, source, manifest.notes.get("exposure_s"))
        with closing(bench.screen):
            manifest.note(exposure_s=bench.exposure_s)
            session = _Session(run, bench, manifest)
            session.find()
            session.show(pictures)
        counts = manifest.counts
    place = session.place
    figures = {
        "source": source.name,
        "distance": str(options.distance).replace(" ", ""),
        "pictures": counts["done"],
        "failed": counts["failed"],
        "left": counts["waiting"],
        "exposure_s": bench.exposure_s,
        "screen": {
            "pixels": list(bench.screen.size),
            "matrix": place.matrix.tolist(),
            "error_px": place.error_px,
            "support": session.support.text,
        },
        "white": session.whites,
        "dark": session.write_dark(),
    }
    return Product(place, figures, outputs=(options.output,))


def _about(options: CollectOptions, pictures: PictureSet) -> dict[str, str]:
    """What the pairs depend on."""
    names = hashlib.sha256("\n".join(pictures.names).encode()).hexdigest()
    return {
        "pictures": f"{len(pictures.names)} of {names[:16]}",
        "source": options.source,
        "distance": str(options.distance),
        "width of the screen": str(options.screen_width),
        "gain": f"{options.gain:g}",
    }


class _Session:
    """Pictures that are shown and taken until all are, or somebody ends it."""

    def __init__(self, run: Run[CollectOptions], bench: _Bench, manifest: Manifest) -> None:
        self._run, self._bench, self._manifest = run, bench, manifest
        self._folder = run.options.output
        self._black = torch.zeros(3, *bench.screen.size)
        self.place: ScreenPlace
        self.support: PixelRectangle
        self.whites: list[float] = []

    def find(self) -> None:
        """Take the dots, keep their frames, and find the screen by them."""
        bench, (pictures, middle) = self._bench, dots(self._bench.screen.size)
        times = _DOT_TIMES
        while True:
            try:
                shots = {"black": bench.shot(self._black, times)}
                for number, picture in enumerate(pictures.values(), start=1):
                    self._run.reporter.advance("dots", number / len(pictures))
                    shots[f"dot-{number}"] = bench.shot(picture, times)
                break
            except CameraError:
                if times <= 1:
                    raise
                times = max(times / 4, 1.0)
        self._keep({self._folder / PATTERN / name: shot for name, shot in shots.items()})
        values = [develop(shot.frame).values for shot in shots.values()]
        frames = {place: each - values[0] for place, each in zip(pictures, values[1:], strict=True)}
        try:
            self.place = find_screen(frames, middle)
        except DataError as error:
            raise DataError(
                f"{error} (frames of the dots: {self._folder / PATTERN}; what was taken before "
                "stays, and the same command goes on)"
            ) from error
        sensor = values[0].shape[-2], values[0].shape[-1]
        self.support = self.place.support(bench.screen.size, sensor)
        before = self._manifest.notes.get("matrix")
        if before is not None:
            moved = self._registration(np.array(before)).moved_px(self._registration())
            if moved > _MOVED_PX:
                self._run.warn(
                    f"screen or camera moved by {moved:.1f} pixels since the last run: pictures "
                    "from now on lie as they do now"
                )
        self._manifest.note(matrix=self.place.matrix.tolist())

    def show(self, pictures: PictureSet) -> None:
        """Show all that are missing."""
        reporter, missing = self._run.reporter, self._manifest.missing
        every = self._run.options.interleave
        for number, name in enumerate(missing):
            if number % every == 0:
                self._references()
            if reporter.step("picture", number, len(missing), "the pairs"):
                return
            self._pair(name, pictures.read(name))
        reporter.step("picture", len(missing), max(len(missing), 1), "the pairs")

    def _pair(self, name: str, picture: Tensor) -> None:
        shown = on_screen(picture, self._bench.screen.size)
        try:
            shot = self._bench.shot(shown)
        except CameraError as error:
            self._manifest.fail(name, str(error), _TRIES)
            self._run.warn(f"{name} was not taken: {error}")
            return
        seen, inside = resampled(shown, self._registration())
        truth = (seen * torch.from_numpy(inside)).float()
        levels = Levels.of(shot.frame)
        self._manifest.keep(
            name,
            {"taken": shot.taken.isoformat(timespec="milliseconds"), "bright": levels.bright,
             "mean": levels.mean},
            {
                self._folder / MEASURED / f"{name}{_suffix(shot.frame)}": _writer(shot),
                self._folder / PICTURES / f"{name}.png": partial(
                    write_png, radiance=truth, white=1.0
                ),
            },
        )  # fmt: skip

    def _references(self) -> None:
        """A black and a white screen: the dark frame, and how bright the screen is now."""
        taken = len(list((self._folder / PATTERN).glob("dark-*")))
        dark = self._bench.shot(self._black)
        self._keep({self._folder / PATTERN / f"dark-{taken + 1:04d}": dark})
        white = self._bench.shot(torch.ones_like(self._black))
        self.whites.append(Levels.of(white.frame).mean - Levels.of(dark.frame).mean)

    def _keep(self, shots: dict[Path, Shot]) -> None:
        writers: dict[Path, Writer] = {
            path.with_name(f"{path.name}{_suffix(shot.frame)}"): _writer(shot)
            for path, shot in shots.items()
        }
        write_into(self._folder, writers)

    def write_dark(self) -> str | None:
        """Write the mean of all dark frames of this folder; its name, where there are any."""
        paths = sorted((self._folder / PATTERN).glob("dark-*"))
        if not paths:
            return None
        first = read_frame(paths[0])
        total = sum((read_frame(path).counts.double() for path in paths[1:]), first.counts.double())
        dark = replace(first, counts=(total / len(paths)).float())
        name = f"{DARK}{'.npy' if len(dark.counts) > 1 else '.tif'}"
        write_into(self._folder, {self._folder / name: partial(write_frame, frame=dark)})
        return name

    def _registration(self, matrix: Any = None) -> Registration:
        """From the pixels of the support to those of the screen."""
        moved = np.eye(3)
        moved[:2, 2] = self.support.top, self.support.left
        size = self.support.height, self.support.width
        return Registration(
            (self.place.matrix if matrix is None else matrix) @ moved, "homography", 1.0,
            self.place.error_px, size,
        )  # fmt: skip


def _suffix(frame: Frame) -> str:
    """Of the kind of file that holds a frame."""
    return ".npy" if len(frame.counts) > 1 else ".tif" if frame.mosaic is None else ".dng"


def _writer(shot: Shot) -> Writer:
    return partial(write_frame, frame=shot.frame, model=shot.camera)
