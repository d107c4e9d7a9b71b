"""`nolens calibrate import`: PSFs that were measured elsewhere, into a camera's folder."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field
from torch import Tensor

from nolens.calibrate.centring import place_psf
from nolens.calibrate.distances import Layers
from nolens.calibrate.point_psf import dark_area
from nolens.calibrate.psf_import import PsfImport, import_psf
from nolens.camera import BlackLevel, Frame, PsfEntry, Sensor
from nolens.camera.part import PixelPitch
from nolens.camera.psf import extrapolation_note
from nolens.camera.psf_set import Depth
from nolens.errors import DataError, OptionError
from nolens.files import PSFS_FILE, read_frame, readable
from nolens.files.psf_folder import PsfFolder
from nolens.jobs.calibration.folder import added, filter_warnings, output_folder, place_name
from nolens.jobs.fields import (
    CAMERAS,
    INPUT,
    RESULT,
    Bgr,
    Bin,
    Channels,
    Dark,
    Distances,
    FieldAngles,
    FilePath,
    Files,
    Flat,
    Mosaic,
    Name,
    White,
    Window,
    window_numbers,
)
from nolens.jobs.options import JobOptions, Option, Written
from nolens.jobs.run import Product, Run, job
from nolens.quantities import Angle

_AHEAD = (Angle("0", "deg"), Angle("0", "deg"))


class CalibrateImportOptions(JobOptions):
    """Add PSFs that were measured or computed elsewhere to a camera's folder.

    nolens calibrate import near.tif far.tif --distance 20cm --distance 40cm --pixel 3.1um -o
    theirs

    Each file becomes the PSF of its place. The black level is subtracted, saturated pixels
    are continued from around them, and the PSF is cut or padded to the camera's sensor; nothing
    else is done. Frames of one point source at several exposures are for nolens calibrate.
    """

    usage = "calibrate import PSF... --distance 300mm -o FOLDER"

    psfs: Annotated[
        Files,
        Field(min_length=1, max_length=1000),
        Option(
            "A PSF each: camera raw, .tif, .npy, .mat or another file of docs/formats.md, linear; "
            "one of several by its number, such as psf.npy#2. Its middle pixel (row rows // 2, "
            "column columns // 2) is the zero shift.",
            needed="the files of the PSFs (nolens calibrate import PSF... --distance 300mm -o "
            "FOLDER)",
            role="input",
            what="PSF",
            positional=True,
            label="PSFs",
        ),
    ]
    distance: Annotated[
        Distances,
        Field(min_length=1),
        Option(
            "Distance of the point source from the camera, such as 300mm, or infinity: once for "
            "all, or once for each in their order.",
            needed="that of the point source from the camera (--distance 300mm, or infinity; once "
            "for each PSF)",
            label="Distances of the PSFs",
        ),
    ]
    angle: Annotated[
        tuple[FieldAngles, ...],
        Field(max_length=1000),
        Option(
            "Field angles of the point source, to the right and up, such as 20deg,-10deg: once "
            "for each PSF in their order. One at an angle shows the sensor as it was, not centred.",
            default="straight ahead",
            label="Field angles",
        ),
    ] = ()
    pixel: Annotated[
        PixelPitch | None,
        Option(
            "Distance of the pixels in the PSFs' files, such as 3.1um, where no camera is known.",
            label="Pitch of the pixels",
        ),
    ] = None
    camera: Annotated[
        Name | None,
        Option(
            f"Description of the camera: {CAMERAS}; it is copied into the folder.",
            default="camera.toml of the folder, if it has one",
            role="camera",
        ),
    ] = None
    sensor: Annotated[
        Window | None,
        Option(
            "HEIGHTxWIDTH of the sensor in pixels of the PSF, whose dark sides were cut off: it "
            "gets dark pixels around its middle. What is larger in one direction is cut.",
            label="Size of the sensor",
            default="the camera's, that of the folder's PSFs, or the first file's",
        ),
    ] = None
    psf_extent: Annotated[
        Literal["sensor", "wide"],
        Option(
            "wide: extended PSFs, whose files also show light that falls beside the sensor.",
            INPUT,
            former="psf_wider",
            former_switch="wide",
            label="Extended PSFs",
        ),
    ] = "sensor"
    dark: Dark = None
    flat: Flat = None
    black: Annotated[
        BlackLevel,
        Option(
            'Black level in counts, or "auto": read off the darkest corner.',
            INPUT,
            default="what the file says, or the area that an aperture keeps dark",
            label="Black level",
        ),
    ] = None
    white: White = None
    mosaic: Annotated[
        Mosaic | None, Option("Colour mosaic of PSFs whose files do not say it.", INPUT)
    ] = None
    bgr: Bgr = False
    channels: Channels = "all"
    bin: Annotated[
        Bin,
        Option(
            "Average NxN pixels of a file that is finer than the camera's frames.",
            INPUT,
            label="Binning",
        ),
    ] = 1
    centre: Annotated[
        Literal["file", "light"],
        Option(
            "file takes the middle of the file for the zero shift; light moves it there as nolens "
            "calibrate does: the PSF is laid over that of another distance, or its light centred.",
            RESULT,
            label="Zero shift",
        ),
    ] = "file"
    output: Annotated[FilePath, output_folder("import")]

    def check_together(self) -> None:
        """Refuse other places than PSFs, one place twice, and what an extended PSF cannot be."""
        count = len(self.psfs)
        for name, several, example in (
            ("distance", self.distance, "20cm"),
            ("angle", self.angle, "20deg,0deg"),
        ):
            if len(several) not in (0, 1, count):
                raise OptionError(
                    f"--{name} is given {len(several)} times for {count} PSFs: give it once for "
                    f"each in their order (--{name} {example}), or once for all of them"
                )
        for number, place in enumerate(self.places):
            if place in self.places[:number]:
                raise OptionError(
                    f"{self.psfs[self.places.index(place)]} and {self.psfs[number]} are both of "
                    f"{place_name(*place)}: give each its own --distance or --angle. Frames of "
                    "one point source are averaged and merged by nolens calibrate"
                )
        wide = self.psf_extent == "wide"
        for name, is_set in (
            ("sensor", self.sensor is not None),
            ("angle", any(angle != _AHEAD for _, angle in self.places)),
            ("centre light", self.centre == "light"),
        ):
            if wide and is_set:
                raise OptionError(
                    f"--{name} is for PSFs that are as large as the sensor, and --psf-extent wide "
                    "for extended ones, from straight ahead: leave one of them out"
                )
        if self.sensor is not None and window_numbers(self.sensor)[2] is not None:
            raise OptionError(
                f"--sensor {self.sensor}: give HEIGHTxWIDTH alone; the PSF's middle is the sensor's"
            )

    @property
    def places(self) -> tuple[tuple[Depth, tuple[Angle, Angle]], ...]:
        """Distance and angles of each PSF."""
        count = len(self.psfs)
        distances = self.distance * count if len(self.distance) == 1 else self.distance
        angles = self.angle or (_AHEAD,)
        angles = angles * count if len(angles) == 1 else angles
        return tuple(zip(distances, angles, strict=True))

    @property
    def psf_files(self) -> tuple[str, ...]:
        """Name of each PSF in the folder."""
        begin = "extended" if self.psf_extent == "wide" else "psf"
        return tuple(f"{begin}-{place_name(*each)}.tif" for each in self.places)

    @property
    def output_folder(self) -> Path:
        """It is made where it does not exist."""
        return self.output

    @property
    def record(self) -> Path:
        """File of the run's record, named after its first PSF."""
        return self.output / f"import-{place_name(*self.places[0])}.json"

    @property
    def files(self) -> tuple[Written, ...]:
        """PSFs and list."""
        psfs = (Written(f"PSF {each}", self.output / each) for each in self.psf_files)
        return (*psfs, Written("list of PSFs", self.output / PSFS_FILE))


@job
def calibrate_import(run: Run[CalibrateImportOptions]) -> Product[dict[PsfEntry, Tensor]]:
    """Make finished PSFs fit a camera, and add them to its folder.

    Raises
    ------
    NolensError
        If a file, an option or the folder cannot be used; then nothing is written.
    """
    options, reporter = run.options, run.reporter
    folder = PsfFolder(options.output)
    copies = {} if options.camera is None else folder.take(options.camera)
    run.reads(folder.camera_files)
    camera = None if folder.camera is None else folder.camera.camera
    sensor = _sensor_size(options, folder)
    chip = None if camera is None else camera.sensor
    dark = None if options.dark is None else _read(options, options.dark, chip)
    flat = None if options.flat is None else _read(options, options.flat, chip)
    run.begin()
    made: dict[PsfEntry, Tensor] = {}
    rows: list[dict[str, Any]] = []
    for number, path in enumerate(options.psfs):
        reporter.advance("PSFs", number / len(options.psfs))
        imported = import_psf(
            _read(options, path, chip),
            dark=dark,
            flat=flat,
            black=options.black,
            white=options.white,
            channels=options.channels,
            bin_by=options.bin,
            sensor=sensor,
            partial=options.sensor is not None,
            wide=options.psf_extent == "wide",
        )
        sensor = sensor or (imported.psf.shape[-2], imported.psf.shape[-1])
        entry = _entry(options, number, imported, folder)
        first = next(iter(made), entry)
        if (entry.pixel, entry.channels) != (first.pixel, first.channels):
            raise DataError(
                f"{path} has the channels {', '.join(entry.channels)} and pixels of {entry.pixel}, "
                f"but {options.psfs[0]} {', '.join(first.channels)} and {first.pixel}: a folder "
                "holds the PSFs of one camera (--channels grey makes all of them grey)"
            )
        psf, figures = imported.psf, imported.figures()
        run.warn(*imported.warnings)
        if flat is None:
            run.warn(*filter_warnings(chip, entry.file))
        if options.centre == "light":
            placed = place_psf(
                psf,
                dark_area(psf),
                entry.pixel.um,
                distance_um=entry.distance_um,
                angle=entry.angle,
                layers=None if camera is None else Layers.of_camera(camera),
                reference=folder.reference(entry, sensor, made),
            )
            psf, figures = placed.psf, figures | placed.figures
            run.warn(*placed.warnings)
        made[entry] = psf
        rows.append({"source": readable(path), **entry.model_dump(mode="json"), **figures})
        size = psf.shape[-2], psf.shape[-1]
        beyond = extrapolation_note(entry.file, psf, size, readable(options.output))
        if entry.kind == "captured" and entry.on_axis and beyond is not None:
            reporter.note(beyond)
    reporter.advance("PSFs", 1.0)
    summary = {"camera": None if camera is None else camera.name, "psfs": rows}
    return added(made, summary, options.output, made, copies)


def _sensor_size(options: CalibrateImportOptions, folder: PsfFolder) -> tuple[int, int] | None:
    """Rows and columns that PSFs get; None leaves them to the first one."""
    known = folder.sensor_size
    if options.sensor is None:
        return known
    rows, columns, _, _ = window_numbers(options.sensor)
    if known not in (None, (rows, columns)):
        assert known is not None
        raise OptionError(
            f"--sensor {options.sensor}: the camera and PSFs of {options.output} have "
            f"{known[0]}x{known[1]} pixels. Leave --sensor out, or give another folder (-o)"
        )
    return rows, columns


def _read(options: CalibrateImportOptions, path: Path, sensor: Sensor | None) -> Frame:
    """A file; the sensor says the mosaic of one that is as large as it is, and has one channel."""
    mosaic: str | None = options.mosaic
    frame = read_frame(path, mosaic=mosaic, bgr=options.bgr)
    whole = sensor is not None and frame.size == (sensor.rows, sensor.columns)
    if whole and sensor is not None and frame.channels == ("grey",) and sensor.mosaic != "none":
        return read_frame(path, mosaic=sensor.mosaic)
    return frame


def _entry(
    options: CalibrateImportOptions, number: int, imported: PsfImport, folder: PsfFolder
) -> PsfEntry:
    """How the folder lists a PSF."""
    distance, angle = options.places[number]
    folder.check_channels(imported.channels, ", or --channels grey where the folder's are grey")
    entry = PsfEntry(
        file=options.psf_files[number],
        pixel=folder.pitch(options.pixel, imported.merged),
        channels=imported.channels,
        distance=distance,
        angle=angle,
        kind="extended" if options.psf_extent == "wide" else "captured",
    )
    return entry if entry.on_axis else entry.model_copy(update={"frame": "sensor"})
