"""`nolens calibrate pairs`: a PSF from measurements of known pictures."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import torch
from torch import Tensor

from nolens.calibrate.psf_from_scenes import (
    KnownScenes,
    SolvedPsf,
    psf_from_scenes,
    psf_from_scenes_bytes,
    unexplained,
)
from nolens.camera import Frame, Measurement, PsfEntry, develop
from nolens.camera.part import PixelPitch
from nolens.camera.psf_set import Depth
from nolens.errors import DataError, FileError, OptionError
from nolens.evaluate import affine_fit, psnr, ssim
from nolens.experiments.virtual_experiment import solved
from nolens.files import CAMERA_FILE, PSFS_FILE, camera_files, read_frame, read_picture
from nolens.jobs.calibration.fields import distance_name
from nolens.jobs.calibration.folder import added, cell_of, folder_camera, folder_psfs
from nolens.jobs.fields import INPUT, Black, Dark, FilePath, Mosaic, White, Window
from nolens.jobs.options import JobOptions, Option, Written
from nolens.jobs.reconstruction.options import parse_window
from nolens.jobs.run import Product, Run, check_memory, job
from nolens.operators import Region

_LARGEST = 3
_ILL_POSED = 3
_LIKE_NONE = 0.95
_UNLIKE_THE_OTHERS = 1.3
_ITERATIONS, _TAU = 100, 1e-4
_PSF_SHARE = 0.9
"""Of the work on a pair that is left out; the rest is its reconstruction."""
_SMALLEST = 16
_WINDOW = 11


_PAIRS, _RESULT = "Pairs", "Result"


class CalibratePairsOptions(JobOptions):
    """Solve the PSF from measurements of known pictures, where no point source is to be had.

    nolens calibrate pairs measured pictures --distance 300mm --pixel 1.55um -o mycamera

    Show pictures with much detail on a screen, five or more, the room dark; the PSF is the one
    that explains all of the measurements. It is as large as sensor and picture together, an
    extended PSF: nolens reconstruct takes it with --psf-extent wide.
    """

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
            "Folder of what was shown, with the same names: .png, .jpg or .tif of 8 or 16 bits "
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
            "Of the pictures from the camera, such as 300mm, or infinity.",
            _PAIRS,
            needed="that of the pictures from the camera (--distance 300mm, or infinity)",
        ),
    ]
    pixel: Annotated[
        PixelPitch | None,
        Option(
            "Distance of the pixels in the measurements, such as 1.55um, where the folder has no "
            "camera.",
            _PAIRS,
        ),
    ] = None
    support: Annotated[
        Window | None,
        Option(
            "Where the pictures' pixels lie: HEIGHTxWIDTH+TOP+LEFT in pixels of the sensor's "
            "frame.",
            _PAIRS,
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
            _RESULT,
            default="one for all channels, from all of them",
            negative=False,
        ),
    ] = False
    check: Annotated[
        bool,
        Option(
            "Also solve without each pair in turn, and say how well that one is reconstructed.",
            _RESULT,
            negative=False,
        ),
    ] = False
    output: Annotated[
        FilePath,
        Option(
            "Folder of the camera's PSFs; made if it is not there. The PSF, the list psfs.toml and "
            "the record pairs-….json go into it.",
            _RESULT,
            needed="the folder of the camera's PSFs (-o folder)",
            role="output",
            flag="-o",
        ),
    ]

    @property
    def psf(self) -> Path:
        """File of the PSF."""
        return self.output / f"solved-{distance_name(self.distance)}.tif"

    @property
    def record(self) -> Path:
        """File of the run's record."""
        return self.output / f"pairs-{distance_name(self.distance)}.json"

    @property
    def output_folder(self) -> Path:
        """It is made where it does not exist."""
        return self.output

    @property
    def inputs(self) -> dict[str, Path]:
        """Dark frame, by role; the pairs are found in their folders."""
        return {} if self.dark is None else {"dark frame": self.dark}

    @property
    def written(self) -> tuple[Written, ...]:
        """PSF, list and record."""
        return (
            Written("PSF", self.psf),
            Written("list of PSFs", self.output / PSFS_FILE),
            Written("record of the run", self.record),
        )


def named_pairs(measured: Path, pictures: Path) -> dict[str, tuple[Path, Path]]:
    """Files of the same name, but for the suffix, in both folders, in the order of their names.

    Raises
    ------
    FileError
        If a folder is none or has two files of one name, or a file has no partner.
    """
    found = [_by_name(folder) for folder in (measured, pictures)]
    for folder, here, there, other in (
        (measured, found[0], found[1], pictures),
        (pictures, found[1], found[0], measured),
    ):
        alone = sorted(here.keys() - there.keys())
        if alone:
            raise FileError(
                f"{folder / here[alone[0]].name} has no partner in {other} ({len(found[0])} "
                f"measurements, {len(found[1])} pictures): give both the same name, such as "
                f"{alone[0]}.png, and keep other files elsewhere"
            )
    if not found[0]:
        raise FileError(f"{measured} is empty: give a folder of measurements, and one of pictures")
    return {name: (found[0][name], found[1][name]) for name in sorted(found[0])}


def _by_name(folder: Path) -> dict[str, Path]:
    if not folder.is_dir():
        raise FileError(f"{folder} is no folder: give one of measurements and one of pictures")
    files: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or not path.is_file():
            continue
        if path.stem in files:
            raise FileError(
                f"{path} and {files[path.stem].name} have one name, and it is not clear which is "
                "meant: keep one of them elsewhere"
            )
        files[path.stem] = path
    return files


@dataclass(frozen=True)
class ReadPairs:
    """All pairs.

    Attributes
    ----------
    first
        Frame of the first one.
    measured
        By name.
    pictures
        Radiance, (channels, rows, columns), by name.
    region
        Where the pictures' cells lie in the sensor's frame.
    """

    first: Frame
    measured: dict[str, Measurement]
    pictures: dict[str, Tensor]
    region: Region

    @property
    def channels(self) -> tuple[str, ...]:
        """Of the measurements."""
        return next(iter(self.measured.values())).channels

    def known(self, names: list[str], channels: list[int]) -> KnownScenes:
        """Some of the pairs, in some of the channels."""
        return KnownScenes.of(
            [self.pictures[name][channels] for name in names],
            [self.measured[name].values[channels] for name in names],
            [self.measured[name].valid[channels] for name in names],
            self.region,
        )


def read_pairs(options: CalibratePairsOptions, pairs: dict[str, tuple[Path, Path]]) -> ReadPairs:
    """Read all of them.

    Raises
    ------
    NolensError
        If a file cannot be read, is dark or even, or does not fit the others.
    """

    def read(path: Path) -> Frame:
        return read_frame(path, mosaic=options.mosaic, bgr=options.bgr)

    dark = None if options.dark is None else read(options.dark)
    frames = {name: read(path) for name, (path, _) in pairs.items()}
    measured = {
        name: develop(frame, dark=dark, black=options.black, white=options.white)
        for name, frame in frames.items()
    }
    first = next(iter(measured.values()))
    for each in measured.values():
        if each.channels != first.channels or each.values.shape != first.values.shape:
            raise DataError(
                f"{each.source} has {each.size_text} cells of {', '.join(each.channels)}, but "
                f"{first.source} {first.size_text} of {', '.join(first.channels)}: give "
                "measurements of one camera, read out in one way"
            )
        _check_light(each.values, each.source, "the measurement")
    pictures = {
        name: _radiance(path, first.channels, options.bgr) for name, (_, path) in pairs.items()
    }
    sensor = (first.values.shape[-2], first.values.shape[-1])
    region = _region(options, pictures, {name: path for name, (_, path) in pairs.items()}, sensor)
    return ReadPairs(next(iter(frames.values())), measured, pictures, region)


def _radiance(path: Path, channels: tuple[str, ...], bgr: bool) -> Tensor:
    """A picture in the channels of the measurements."""
    picture = read_picture(path)
    if picture.opacity is not None and float(picture.opacity.min()) < 1:
        raise DataError(f"{path} is transparent: give the picture as it was shown, without alpha")
    radiance = picture.radiance.flip(0) if bgr else picture.radiance
    if channels == ("grey",):
        radiance = radiance.mean(dim=0, keepdim=True)
    else:
        radiance = torch.stack([radiance["RGB".index(each)] for each in channels])
    _check_light(radiance, str(path), "the picture")
    return radiance


def _check_light(values: Tensor, source: str, what: str) -> None:
    if not bool((values.double().mean(dim=(-2, -1)) > 0).all()):
        raise DataError(
            f"{what} {source} is dark in at least one channel, and nothing can be learnt from it: "
            "leave the pair out, or check the exposure and the black level (--black)"
        )
    flat = values.flatten(-2)
    if not bool((flat.amax(dim=-1) > flat.amin(dim=-1)).all()):
        raise DataError(
            f"{what} {source} is the same everywhere in at least one channel, and nothing can be "
            "learnt from it: leave the pair out, and take pictures with much detail"
        )


def _region(
    options: CalibratePairsOptions,
    pictures: dict[str, Tensor],
    files: dict[str, Path],
    sensor: tuple[int, int],
) -> Region:
    first = next(iter(pictures))
    rows, columns = pictures[first].shape[-2:]
    for name, picture in pictures.items():
        if picture.shape[-2:] != (rows, columns):
            raise DataError(
                f"{files[name]} has {picture.shape[-2]}×{picture.shape[-1]} cells, but "
                f"{files[first]} {rows}×{columns}: all pictures must lie on the same cells"
            )
    if rows > _LARGEST * sensor[0] or columns > _LARGEST * sensor[1]:
        raise DataError(
            f"{files[first]} has {rows}×{columns} cells, and the sensor {sensor[0]}×{sensor[1]}: "
            "scale the pictures so that a cell is what one cell of the sensor sees, as a "
            "reconstruction shows it"
        )
    if options.support is None:
        return Region.centred(rows, columns, sensor)
    region = parse_window(options.support, sensor, "--support")
    if (region.height, region.width) != (rows, columns):
        raise OptionError(
            f"--support {options.support} has {region.height}×{region.width} pixels, but the "
            f"picture {files[first]} {rows}×{columns}: it says where the pictures lie, pixel by "
            "pixel"
        )
    return region


@job
def calibrate_pairs(run: Run[CalibratePairsOptions]) -> Product[Tensor]:
    """Solve the PSF that explains measurements of known pictures, and add it to a folder.

    Raises
    ------
    NolensError
        If a file, an option or the folder cannot be used; then nothing is written.
    """
    options = run.options
    pairs = named_pairs(options.measured, options.pictures)
    names = list(pairs)
    if options.check and len(names) < 2:
        raise OptionError("--check solves without each pair in turn, and there is only one")
    files: dict[str, Path] = {}
    for name, (measured, picture) in pairs.items():
        files |= {f"measurement {name}": measured, f"picture {name}": picture}
    opened, psfs = folder_camera(options.output), folder_psfs(options.output)
    if opened is not None:
        files |= camera_files(options.output / CAMERA_FILE, opened.camera)
    run.reads(files)
    read = read_pairs(options, pairs)
    cell = cell_of(read.first, opened, psfs, options.pixel)
    channels = read.channels if options.each_channel else ("grey",)
    if psfs is not None and psfs.psf[0].channels != channels:
        raise OptionError(
            f"the PSF {psfs.psf[0].file} of the folder has the channels "
            f"{', '.join(psfs.psf[0].channels)}, but this one would have {', '.join(channels)}: "
            "give another folder (-o)"
            + ("" if options.each_channel else ", or solve each channel (--each-channel)")
        )
    entry = PsfEntry(
        file=options.psf.name,
        cell=cell,
        channels=channels,
        distance=options.distance,
        kind="solved",
    )
    rounds = 1 + (len(names) if options.check else 0)
    needed = _needed(read)
    check_memory(needed, run.device, "fewer or smaller pictures need less")
    run.begin(needed)

    def tick(number: int) -> Callable[[float], None]:
        return lambda share: run.reporter.advance("PSF", (number + share) / rounds)

    found = _solved(read, names, options, tick(0))
    psf = torch.stack([each.psf for each in found])
    checks = [
        _left_out(read, names, left, options, tick(1 + number))
        for number, left in enumerate(names if options.check else [])
    ]
    rows = _rows(read, names, found)
    run.warn(*_warnings(rows))
    figures = {
        "camera": None if opened is None else opened.camera.name,
        **entry.model_dump(mode="json"),
        "cells": list(psf.shape[-2:]),
        "support_share": round(float(found[0].support.double().mean()), 4),
        "pairs": rows,
        "left_out": checks,
    }
    return added(psf, figures, options.output, {entry: psf})


def _groups(read: ReadPairs, options: CalibratePairsOptions) -> list[list[int]]:
    """Channels that have a PSF in common."""
    every = list(range(len(read.channels)))
    return [[each] for each in every] if options.each_channel else [every]


def _solved(
    read: ReadPairs,
    names: list[str],
    options: CalibratePairsOptions,
    tick: Callable[[float], None],
) -> list[SolvedPsf]:
    """A PSF for each group of channels, of some of the pairs."""
    groups = _groups(read, options)
    found = []
    for number, group in enumerate(groups):

        def advance(share: float, number: int = number) -> None:
            tick((number + share) / len(groups))

        found.append(psf_from_scenes(read.known(names, group), tick=advance))
    return found


def _left_out(
    read: ReadPairs,
    names: list[str],
    left: str,
    options: CalibratePairsOptions,
    tick: Callable[[float], None],
) -> dict[str, Any]:
    """How well a pair is explained and reconstructed with the PSF of the others."""
    others = [name for name in names if name != left]
    found = _solved(read, others, options, lambda share: tick(_PSF_SHARE * share))
    psf = torch.stack([each.psf for each in found])
    groups = _groups(read, options)
    misfit = torch.cat(
        [
            unexplained(read.known([left], group), plane)
            for group, plane in zip(groups, psf, strict=True)
        ]
    )
    truth = read.pictures[left]
    scene = solved(
        read.measured[left],
        psf,
        read.region,
        iterations=_ITERATIONS,
        tau=_TAU,
        tick=lambda share: tick(_PSF_SHARE + (1 - _PSF_SHARE) * share),
    )
    peak = float(truth.max())
    shown = affine_fit(scene, truth).clamp(0, peak)
    large = min(truth.shape[-2:]) >= _WINDOW
    return {
        "name": left,
        "misfit": [round(each, 4) for each in misfit.tolist()],
        "psnr_db": round(psnr(shown, truth, peak), 3),
        "ssim": round(ssim(shown, truth, peak), 4) if large else None,
    }


def _rows(read: ReadPairs, names: list[str], found: list[SolvedPsf]) -> list[dict[str, Any]]:
    """What the solution says of each pair, channel by channel."""
    many = len(read.channels) // len(found)

    def of(number: int, figures: str) -> list[float]:
        return [
            round(float(getattr(each, figures)[number * many + channel]), 4)
            for each in found
            for channel in range(many)
        ]

    return [
        {
            "name": name,
            "gain": of(number, "gains"),
            "misfit": of(number, "misfit"),
            "misfit_varying": of(number, "misfit_varying"),
        }
        for number, name in enumerate(names)
    ]


def _warnings(rows: list[dict[str, Any]]) -> list[str]:
    texts = []
    if len(rows) < _ILL_POSED:
        texts.append(
            f"{len(rows)} pair{'' if len(rows) == 1 else 's'} can be explained by many PSFs: take "
            "five or more, of pictures with much detail"
        )
    means = [sum(row["misfit"]) / len(row["misfit"]) for row in rows]
    middle = sorted(means)[len(means) // 2]
    for row, mean in zip(rows, means, strict=True):
        if mean > _LIKE_NONE or (len(rows) > 2 and mean > _UNLIKE_THE_OTHERS * middle):
            texts.append(
                f"the pair {row['name']} is explained badly ({100 * mean:.0f} % of its measurement "
                f"is left, {100 * middle:.0f} % of the others): is that the picture that was "
                "shown, in its place and not turned?"
            )
    return texts


def _needed(read: ReadPairs) -> float:
    """Bytes that solving for the PSF holds at once, of pictures large enough for one."""
    sensor = read.measured[next(iter(read.measured))].values
    rows, columns = sensor.shape[-2] + read.region.height, sensor.shape[-1] + read.region.width
    if min(sensor.shape[-2:]) < _SMALLEST or min(read.region.height, read.region.width) < _SMALLEST:
        raise DataError(
            f"the sensor has {sensor.shape[-2]}×{sensor.shape[-1]} cells and the pictures "
            f"{read.region.height}×{read.region.width}: give at least {_SMALLEST} in each direction"
        )
    return psf_from_scenes_bytes((rows, columns), len(read.measured) * sensor.shape[0])
