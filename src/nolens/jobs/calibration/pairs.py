"""`nolens calibrate pairs`: a PSF from measurements of known pictures."""

from functools import partial
from pathlib import Path
from typing import Annotated, ClassVar

import torch
from torch import Tensor

from nolens.calibrate.pairs import KnownPairs
from nolens.camera import Frame, PsfEntry, develop
from nolens.camera.part import PixelPitch
from nolens.camera.psf_set import Depth
from nolens.errors import DataError, OptionError
from nolens.files import read_frame, read_picture
from nolens.files.input import named_pairs
from nolens.files.psf_folder import PsfFolder
from nolens.jobs.calibration.folder import NewPsfOptions, added, output_folder
from nolens.jobs.fields import INPUT, RESULT, Black, Dark, FilePath, Mosaic, White, Window
from nolens.jobs.options import Option
from nolens.jobs.reconstruction.options import parse_window
from nolens.jobs.run import Product, Run, job


class CalibratePairsOptions(NewPsfOptions):
    """Solve the PSF from measurements of known pictures, where no point source is to be had.

    nolens calibrate pairs measured pictures --distance 300mm --pixel 1.55um -o mycamera

    Show pictures with much detail on a screen, five or more, the room dark; the PSF is the one
    that explains all of the measurements. It is as large as sensor and picture together, an
    extended PSF: nolens reconstruct takes it with --psf-extent wide.
    """

    names: ClassVar = ("solved", "pairs")
    usage = "calibrate pairs MEASURED PICTURES --distance 300mm -o FOLDER"

    measured: Annotated[
        FilePath,
        Option(
            "Folder of what the camera measured: camera raw, .tif, .png or .npy.",
            needed="the folder of measurements (nolens calibrate pairs MEASURED PICTURES "
            "--distance 300mm -o FOLDER)",
            role="input",
            positional=True,
        ),
    ]
    pictures: Annotated[
        FilePath,
        Option(
            "Folder of what was displayed, with the same names: .png, .jpg or .tif of 8 or 16 bits "
            "(sRGB), or float .tif and .npy (linear). Their pixels are those of a reconstruction: "
            "pixel (i, j) is the one whose light falls through the middle of the PSF onto pixel "
            "(i, j) of the sensor; with a colour mosaic, onto superpixel (i, j) of 2×2 pixels.",
            needed="the folder of pictures (nolens calibrate pairs MEASURED PICTURES --distance "
            "300mm -o FOLDER)",
            role="input",
            positional=True,
        ),
    ]
    distance: Annotated[
        Depth,
        Option(
            "Distance of the pictures from the camera, such as 300mm, or infinity.",
            needed="that of the pictures from the camera (--distance 300mm, or infinity)",
        ),
    ]
    pixel: Annotated[
        PixelPitch | None,
        Option(
            "Distance of the pixels in the measurements, such as 1.55um, where the folder has no "
            "camera.",
        ),
    ] = None
    support: Annotated[
        Window | None,
        Option(
            "Where the pictures' pixels lie: HEIGHTxWIDTH+TOP+LEFT in pixels of the sensor's "
            "frame.",
            default="in the middle",
            former="region",
        ),
    ] = None
    dark: Dark = None
    black: Black = None
    white: White = None
    mosaic: Annotated[
        Mosaic | None, Option("Colour mosaic of measurements whose files do not say it.", INPUT)
    ] = None
    bgr: Annotated[
        bool,
        Option("Colour channels of all files are stored as B, G, R.", INPUT, negative=False),
    ] = False
    each_channel: Annotated[
        bool,
        Option(
            "A PSF for each channel.",
            RESULT,
            default="one for all channels, from all of them",
            negative=False,
        ),
    ] = False
    check: Annotated[
        bool,
        Option(
            "Also solve without each pair in turn, and say how well that one is reconstructed.",
            RESULT,
            negative=False,
        ),
    ] = False
    output: Annotated[FilePath, output_folder("pairs")]

    @property
    def inputs(self) -> dict[str, Path]:
        """Dark frame, by role; the pairs are listed by their folders."""
        return {} if self.dark is None else {"dark frame": self.dark}


def _read_pairs(
    options: CalibratePairsOptions, files: dict[str, tuple[Path, Path]]
) -> tuple[KnownPairs, Frame]:
    """All pairs, and the frame of the first one."""

    def read(path: Path) -> Frame:
        return read_frame(path, mosaic=options.mosaic, bgr=options.bgr)

    dark = None if options.dark is None else read(options.dark)
    frames = {name: read(path) for name, (path, _) in files.items()}
    measured = {
        name: develop(frame, dark=dark, black=options.black, white=options.white)
        for name, frame in frames.items()
    }
    first = next(iter(measured.values()))
    pictures = {
        name: (_radiance(path, first.channels, options.bgr), f"the picture {path}")
        for name, (_, path) in files.items()
    }
    sensor, support = (first.values.shape[-2], first.values.shape[-1]), None
    if options.support is not None:
        support = parse_window(options.support, sensor, "--support")
    pairs = KnownPairs(measured, pictures, support, each_channel=options.each_channel)
    return pairs, next(iter(frames.values()))


def _radiance(path: Path, channels: tuple[str, ...], bgr: bool) -> Tensor:
    """A picture in the channels of the measurements."""
    picture = read_picture(path)
    if picture.opacity is not None and float(picture.opacity.min()) < 1:
        raise DataError(
            f"{path} is transparent: give the picture as it was displayed, without alpha"
        )
    radiance = picture.radiance.flip(0) if bgr else picture.radiance
    if channels == ("grey",):
        return radiance.mean(dim=0, keepdim=True)
    return torch.stack([radiance["RGB".index(each)] for each in channels])


@job
def calibrate_pairs(run: Run[CalibratePairsOptions]) -> Product[Tensor]:
    """Solve the PSF that explains measurements of known pictures, and add it to a folder.

    Raises
    ------
    NolensError
        If a file, an option or the folder cannot be used; then nothing is written.
    """
    options = run.options
    files = named_pairs(options.measured, options.pictures)
    if options.check and len(files) < 2:
        raise OptionError("--check solves without each pair in turn, and there is only one")
    for name, (measured, picture) in files.items():
        run.reads({f"measurement {name}": measured, f"picture {name}": picture})
    folder = PsfFolder(options.output)
    run.reads(folder.camera_files)
    pairs, frame = _read_pairs(options, files)
    entry = PsfEntry(
        file=options.psf_file,
        pixel=folder.pixel(frame, options.pixel),
        channels=pairs.channels if options.each_channel else ("grey",),
        distance=options.distance,
        kind="solved",
    )
    remedy = "" if options.each_channel else ", or solve each channel (--each-channel)"
    folder.check_channels(entry.channels, remedy)
    run.begin(pairs.bytes_needed, "fewer or smaller pictures need less")
    result = pairs.solve(check=options.check, progress=partial(run.reporter.advance, "PSF"))
    run.warn(*result.warnings())
    figures = {
        "camera": None if folder.camera is None else folder.camera.camera.name,
        **entry.model_dump(mode="json"),
        **result.figures(),
    }
    return added(result.psf, figures, options.output, {entry: result.psf})
