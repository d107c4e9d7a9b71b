"""`nolens calibrate`: frames of a point source become a PSF in a camera's folder."""

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, ClassVar

from pydantic import Field
from torch import Tensor

from nolens.calibrate.centring import PlacedPsf, ReferencePsf, place_psf
from nolens.calibrate.distances import Layers
from nolens.calibrate.frames import PointFrames
from nolens.calibrate.point_psf import PointPsf, StrayLight, point_psf, point_psf_bytes
from nolens.camera import Frame, PsfEntry, PsfSet, Sensor
from nolens.camera.part import PixelPitch
from nolens.camera.psf_set import Depth
from nolens.errors import DataError, OptionError
from nolens.files import CAMERA_FILE, camera_files, read_frame, read_psf
from nolens.files.cameras import camera_copies
from nolens.jobs.calibration.folder import (
    RESULT,
    NewPsfOptions,
    added,
    check_channels,
    check_free,
    chosen_camera,
    folder_psfs,
    output_folder,
    pixel_of,
)
from nolens.jobs.fields import CAMERAS, Exposure, FieldAngles, FilePath, Files, Mosaic, Name
from nolens.jobs.options import Option
from nolens.jobs.run import Product, Reporter, Run, Writer, check_memory, job
from nolens.progress import ProgressCallback, within
from nolens.quantities import Angle, Length

_SOURCE, _FRAMES = "Point source", "Frames"
_MERGED_FRACTION = 0.5
"""Of the work on a PSF; the rest brings it into its place."""


class CalibratePointOptions(NewPsfOptions):
    """Make a PSF of pictures of one point source, and add it to a camera's folder.

    nolens calibrate point*.dng --distance 300mm --camera paper -o mycamera

    Once for each place of the point source: the folder gathers the PSFs of all distances and
    angles. Use a white LED behind a pinhole of 50 um in a dark room; more frames make less noise,
    and frames of several exposure times keep the faint parts where the long ones clip.
    """

    names: ClassVar = ("psf", "calibrate")
    usage = "calibrate FRAME... --distance 300mm -o FOLDER"

    frames: Annotated[
        Files,
        Field(min_length=1),
        Option(
            "Camera raw (.dng and others), .tif, .png or .npy, all of the same point source.",
            needed="the frames of one point source (nolens calibrate FRAME... --distance 300mm -o "
            "FOLDER)",
            role="input",
            positional=True,
            label="Frames",
        ),
    ]
    distance: Annotated[
        Depth,
        Option(
            "Of the point source from the camera, such as 300mm, or infinity.",
            _SOURCE,
            needed="that of the point source from the camera (--distance 300mm, or infinity)",
            label="Distance from the mask",
        ),
    ]
    angle: Annotated[
        FieldAngles,
        Option(
            "Field angles of the point source, to the right and up as the photographer sees it, "
            "such as 20deg,-10deg.",
            _SOURCE,
            default="0deg,0deg",
        ),
    ] = (Angle("0", "deg"), Angle("0", "deg"))
    dark: Annotated[
        Files,
        Option(
            "Frames with the point source off, after the others; those of each exposure time are "
            "subtracted from its frames.",
            _FRAMES,
            default="none, and the black level of the files",
            role="input",
            several=True,
            label="Dark frames",
        ),
    ] = ()
    exposure: Annotated[
        tuple[Exposure, ...],
        Field(max_length=100_000),
        Option(
            "Exposure time, such as 10ms: once for all frames, or once for each in their order.",
            _FRAMES,
            default="what the files say",
        ),
    ] = ()
    camera: Annotated[
        Name | None,
        Option(
            f"{CAMERAS}; it is copied into the folder.",
            _FRAMES,
            default="that of the folder, if it has one",
            role="camera",
            label="Description",
        ),
    ] = None
    pixel: Annotated[
        PixelPitch | None,
        Option(
            "Distance of the pixels in the frames, such as 1.55um, where no camera is known.",
            _FRAMES,
        ),
    ] = None
    mosaic: Annotated[
        Mosaic | None, Option("Colour mosaic of frames whose files do not say it.", _FRAMES)
    ] = None
    stray_light: Annotated[
        StrayLight,
        Option(
            "auto subtracts a smooth background where an aperture leaves a dark area, none leaves "
            "all in, floor takes the darkest light there is for stray light.",
            RESULT,
        ),
    ] = "auto"
    as_is: Annotated[
        bool,
        Option(
            "The frames are a finished PSF, such as another group's: subtract its black level and "
            "nothing else, and warn where frames of a camera would be refused. The middle of the "
            "file is its zero shift.",
            RESULT,
            default="off",
        ),
    ] = False
    output: Annotated[FilePath, output_folder("calibrate")]

    def check_together(self) -> None:
        """Refuse other times than frames, stray light of a finished PSF, and a frame twice."""
        if len(self.exposure) not in (0, 1, len(self.frames)):
            raise OptionError(
                f"--exposure is given {len(self.exposure)} times for {len(self.frames)} "
                "frames: give it once, for all of them, or once for each in their order"
            )
        if self.as_is and self.stray_light != "auto":
            raise OptionError(
                f"--as-is and --stray-light {self.stray_light} are both given: a PSF that is "
                "taken as it is keeps its stray light. Leave one of them out"
            )
        twice = [path for path in self.frames if self.frames.count(path) > 1]
        both = [path for path in self.dark if path in self.frames]
        if twice or both:
            raise OptionError(
                f"{(twice or both)[0]} is given twice: a frame counts once, as a frame or as a "
                "dark frame"
            )

    @property
    def suffix(self) -> str:
        """Distance and angle, as the names of files have them."""
        text = str(super().suffix)
        if any(each.deg != 0 for each in self.angle):
            text += "".join(f"-{each.deg:.6g}deg" for each in self.angle)
        return text

    @property
    def inputs(self) -> dict[str, Path]:
        """Frames and dark frames, by role."""
        return {
            f"{role} {number}": path
            for role, paths in (("frame", self.frames), ("dark frame", self.dark))
            for number, path in enumerate(paths, start=1)
        }


def _read_frames(
    options: CalibratePointOptions, sensor: Sensor | None, reporter: Reporter
) -> PointFrames:
    """All frames; the sensor says what files do not: mosaic, black and white level."""
    total = len(options.frames) + len(options.dark)
    frames = PointFrames()
    for number, path in enumerate(options.frames):
        reporter.advance("frames", number / total)
        stated = options.exposure[number % len(options.exposure)].s if options.exposure else None
        frames.add(_read(path, options, sensor), stated)
    for number, path in enumerate(options.dark, start=len(options.frames)):
        reporter.advance("frames", number / total)
        frames.add_dark(_read(path, options, sensor))
    reporter.advance("frames", 1.0)
    return frames


def _read(path: Path, options: CalibratePointOptions, sensor: Sensor | None) -> Frame:
    """Read a frame, with what the sensor says where the file does not."""
    frame = read_frame(path, mosaic=options.mosaic)
    if sensor is None:
        return frame
    whole = tuple(frame.counts.shape[-2:]) == (sensor.rows, sensor.columns)
    if frame.channels == ("grey",) and sensor.mosaic != "none" and whole:
        frame = replace(frame, channels=("mosaic",), mosaic=sensor.mosaic)
    if not frame.black_stated and len(frame.channels) == 1:
        white = min(sensor.saturated_counts, math.inf if frame.white is None else frame.white)
        frame = replace(frame, black=(sensor.black_counts,), white=white, black_stated=True)
    return frame


def _reference(options: CalibratePointOptions, psfs: PsfSet | None) -> PsfEntry | None:
    """A captured PSF to compare with: of the nearest other distance, straight ahead if any is."""
    captured = [each for each in (psfs.psf if psfs else ()) if each.kind == "captured"]
    here = 1e6 / _um(options)
    return min(
        captured,
        key=lambda each: (
            not _of_other_distance(each, options),
            abs(1e6 / each.distance_um - here),
        ),
        default=None,
    )


def _of_other_distance(entry: PsfEntry, options: CalibratePointOptions) -> bool:
    """Whether a PSF is straight ahead, in the middle, and of another distance."""
    return entry.on_axis and entry.frame == "chief-ray" and entry.distance != options.distance


def _um(options: CalibratePointOptions) -> float:
    return options.distance.um if isinstance(options.distance, Length) else math.inf


def _placed(
    point: PointPsf,
    options: CalibratePointOptions,
    layers: Layers | None,
    psfs: PsfSet | None,
    pixel_um: float,
    progress: ProgressCallback,
) -> PlacedPsf:
    """The PSF in its place, beside those of the folder; one that is finished stays as it is."""
    entry, reference = _reference(options, psfs), None
    if entry is not None:
        path = options.output / entry.file
        other = read_psf(options.output, entry)
        if other.shape != point.psf.shape:
            raise DataError(
                f"the PSF {path} has {other.shape[-2]}×{other.shape[-1]} pixels, but these frames "
                f"{point.psf.shape[-2]}×{point.psf.shape[-1]}: they are of another camera or "
                "setting. Give another folder (-o)"
            )
        if _of_other_distance(entry, options):
            reference = ReferencePsf(other, entry, str(path))
    if options.as_is:
        figures = {"centred_by": "its file", "shift_um": [0.0, 0.0]}
        return PlacedPsf(point.psf, "chief-ray", figures)
    return place_psf(
        point,
        pixel_um,
        distance_um=_um(options),
        angle=options.angle,
        layers=layers,
        reference=reference,
        progress=progress,
    )


@job
def calibrate_point(run: Run[CalibratePointOptions]) -> Product[Tensor]:
    """Average, clean and centre frames of a point source, and add the PSF to a folder.

    Raises
    ------
    NolensError
        If a frame, an option or the folder cannot be used; then nothing is written.
    """
    options, reporter = run.options, run.reporter
    loaded, copied = chosen_camera(options.output, options.camera)
    camera: dict[str, Writer] = {}
    if loaded is not None:
        run.reads(camera_files(copied or options.output / CAMERA_FILE, loaded.camera))
    if loaded is not None and copied is not None:
        camera = camera_copies(copied, loaded)
        check_free(options.output, list(camera))
    psfs = folder_psfs(options.output)

    sensor = None if loaded is None else loaded.camera.sensor
    frames = _read_frames(options, sensor, reporter)
    warnings, darks = frames.warnings(), frames.darks()
    pixel = pixel_of(frames.first, loaded, psfs, options.pixel)
    layers = None if loaded is None else Layers.of_camera(loaded.camera)
    needed = point_psf_bytes(frames.first.counts.numel(), len(frames.means))
    check_memory(needed, run.device, "frames of fewer exposure times need less")
    run.begin(needed)
    advance = partial(reporter.advance, "PSF")
    point = point_psf(
        frames.means,
        darks,
        pixel_um=pixel.um,
        stray=options.stray_light,
        sensor=sensor,
        as_is=options.as_is,
        progress=within(advance, 0.0, _MERGED_FRACTION),
    )
    rest = within(advance, _MERGED_FRACTION, 1 - _MERGED_FRACTION)
    placed = _placed(point, options, layers, psfs, pixel.um, rest)
    advance(1.0)

    usable = point.usable_per_mm
    entry = PsfEntry(
        file=options.psf_file,
        pixel=pixel,
        channels=frames.channels,
        distance=options.distance,
        angle=options.angle,
        kind="captured",
        frame=placed.frame,
        usable_per_mm=round(usable, 2) if usable > 0 else None,
    )
    check_channels(psfs, entry.channels)
    run.warn(*warnings, *point.warnings(known_floor=bool(darks) or options.as_is), *placed.warnings)
    figures = {
        "camera": None if loaded is None else loaded.camera.name,
        **entry.model_dump(mode="json"),
        "pixels": list(placed.psf.shape[-2:]),
        "frames": sum(mean.count for mean in frames.means.values()),
        "exposures": [
            {
                "ms": round(1e3 * time, 6) if frames.timed else None,
                "frames": mean.count,
                "dark_frames": darks[time].count if time in darks else 0,
                "clipped_fraction": float(mean.clipped.double().mean()),
                "brightness": round(ratio, 6),
            }
            for (time, mean), ratio in zip(sorted(frames.means.items()), point.ratios, strict=True)
        ],
        "unit": "counts per second" if frames.timed else "counts of one frame",
        **point.figures(),
        **placed.figures,
    }
    return added(placed.psf, figures, options.output, {entry: placed.psf}, camera)
