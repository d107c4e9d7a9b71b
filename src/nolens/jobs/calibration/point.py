"""`nolens calibrate`: frames of a point source become a PSF in a camera's folder."""

from functools import partial
from typing import Annotated, ClassVar

from pydantic import Field
from torch import Tensor

from nolens.calibrate.centring import place_psf
from nolens.calibrate.distances import Layers
from nolens.calibrate.frames import PointFrames
from nolens.calibrate.point_psf import StrayLight, point_psf, point_psf_bytes
from nolens.camera import PsfEntry, Sensor
from nolens.camera.part import PixelPitch
from nolens.camera.psf import extrapolation_note
from nolens.camera.psf_set import Depth
from nolens.errors import OptionError
from nolens.files import read_frame, readable
from nolens.files.psf_folder import PsfFolder
from nolens.jobs.calibration.folder import (
    NewPsfOptions,
    added,
    filter_warnings,
    output_folder,
    place_name,
)
from nolens.jobs.fields import CAMERAS, RESULT, Exposure, FieldAngles, FilePath, Files, Mosaic, Name
from nolens.jobs.options import Option
from nolens.jobs.run import Product, Reporter, Run, job
from nolens.progress import within
from nolens.quantities import Angle

_FRAMES = "Frames"
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
            "Frames of one point source: camera raw (.dng and others), .tif, .png or .npy.",
            needed="the frames of one point source (nolens calibrate FRAME... --distance 300mm -o "
            "FOLDER)",
            role="input",
            what="frame",
            positional=True,
            label="Frames",
        ),
    ]
    distance: Annotated[
        Depth,
        Option(
            "Distance of the point source from the camera, such as 300mm, or infinity.",
            needed="that of the point source from the camera (--distance 300mm, or infinity)",
            label="Distance from the mask",
        ),
    ]
    angle: Annotated[
        FieldAngles,
        Option(
            "Field angles of the point source, to the right and up as the photographer sees it, "
            "such as 20deg,-10deg.",
            default="0deg,0deg",
            label="Field angles",
        ),
    ] = (Angle("0", "deg"), Angle("0", "deg"))
    dark: Annotated[
        Files,
        Option(
            "Frames with the point source off, after the others; those of each exposure time are "
            "subtracted from its frames.",
            default="none, and the black level of the files",
            role="input",
            what="dark frame",
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
            label="Exposure times",
        ),
    ] = ()
    camera: Annotated[
        Name | None,
        Option(
            f"Description of the camera: {CAMERAS}. It is copied into the folder.",
            default="that of the folder, if it has one",
            role="camera",
            label="Description",
        ),
    ] = None
    pixel: Annotated[
        PixelPitch | None,
        Option(
            "Distance of the pixels in the frames, such as 1.55um, where no camera is known.",
        ),
    ] = None
    mosaic: Annotated[
        Mosaic | None,
        Option(
            "Colour mosaic of frames whose files do not say it.", _FRAMES, label="Colour mosaic"
        ),
    ] = None
    stray_light: Annotated[
        StrayLight,
        Option(
            "auto subtracts a smooth background where an aperture leaves a dark area, none "
            "subtracts nothing, floor subtracts the darkest light of the frame.",
            RESULT,
            label="Stray light",
        ),
    ] = "auto"
    output: Annotated[FilePath, output_folder("calibrate")]

    def check_together(self) -> None:
        """Refuse other times than frames, and a frame twice."""
        if len(self.exposure) not in (0, 1, len(self.frames)):
            raise OptionError(
                f"--exposure is given {len(self.exposure)} times for {len(self.frames)} "
                "frames: give it once, for all of them, or once for each in their order"
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
        return place_name(self.distance, self.angle)


def _read_frames(
    options: CalibratePointOptions, sensor: Sensor | None, reporter: Reporter
) -> PointFrames:
    """All frames; the sensor says what files do not: mosaic, black and white level."""
    total = len(options.frames) + len(options.dark)
    frames = PointFrames(sensor)
    for number, path in enumerate([*options.frames, *options.dark]):
        reporter.advance("frames", number / total)
        frame = read_frame(path, mosaic=options.mosaic)
        if number >= len(options.frames):
            frames.add_dark(frame)
        elif options.exposure:
            frames.add(frame, options.exposure[number % len(options.exposure)].s)
        else:
            frames.add(frame)
    reporter.advance("frames", 1.0)
    return frames


@job
def calibrate_point(run: Run[CalibratePointOptions]) -> Product[Tensor]:
    """Average, clean and centre frames of a point source, and add the PSF to a folder.

    Raises
    ------
    NolensError
        If a frame, an option or the folder cannot be used; then nothing is written.
    """
    options, reporter = run.options, run.reporter
    folder = PsfFolder(options.output)
    copies = {} if options.camera is None else folder.take(options.camera)
    run.reads(folder.camera_files)
    camera = None if folder.camera is None else folder.camera.camera
    sensor = None if camera is None else camera.sensor
    frames = _read_frames(options, sensor, reporter)
    warnings, darks = frames.warnings(), frames.darks()
    entry = PsfEntry(
        file=options.psf_file,
        pixel=folder.pixel(frames.first, options.pixel),
        channels=frames.channels,
        distance=options.distance,
        angle=options.angle,
    )
    folder.check_channels(entry.channels)
    needed = point_psf_bytes(frames.first.counts.numel(), len(frames.means))
    run.begin(needed, "frames of fewer exposure times need less")
    advance = partial(reporter.advance, "PSF")
    point = point_psf(
        frames.means,
        darks,
        pixel_um=entry.pixel.um,
        stray=options.stray_light,
        sensor=sensor,
        progress=within(advance, 0.0, _MERGED_FRACTION),
    )
    reference = folder.reference(entry, (point.psf.shape[-2], point.psf.shape[-1]))
    placed = place_psf(
        point.psf,
        point.area,
        entry.pixel.um,
        distance_um=entry.distance_um,
        angle=options.angle,
        layers=None if camera is None else Layers.of_camera(camera),
        reference=reference,
        progress=within(advance, _MERGED_FRACTION, 1 - _MERGED_FRACTION),
    )
    advance(1.0)

    run.warn(*filter_warnings(sensor, entry.file))
    usable = round(point.usable_per_mm, 2) or None
    entry = entry.model_copy(update={"frame": placed.frame, "usable_per_mm": usable})
    run.warn(*warnings, *point.warnings(known_floor=bool(darks)), *placed.warnings)
    size = placed.psf.shape[-2], placed.psf.shape[-1]
    beyond = extrapolation_note(entry.file, placed.psf, size, readable(options.output))
    if entry.on_axis and beyond is not None:
        reporter.note(beyond)
    figures = {
        "camera": None if camera is None else camera.name,
        **entry.model_dump(mode="json"),
        "pixels": list(placed.psf.shape[-2:]),
        **frames.figures(point.ratios),
        **point.figures(),
        **placed.figures,
    }
    return added(placed.psf, figures, options.output, {entry: placed.psf}, copies)
