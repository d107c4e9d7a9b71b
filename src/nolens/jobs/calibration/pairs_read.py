"""Measurements and the pictures that were shown, as the solver of their PSF takes them."""

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from nolens.calibrate.psf_from_scenes import KnownScenes
from nolens.camera import Frame, Measurement, develop
from nolens.errors import DataError, OptionError
from nolens.files import read_frame, read_picture
from nolens.jobs.calibration.pairs_options import CalibratePairsOptions
from nolens.jobs.reconstruction.options import parse_window
from nolens.operators import Region

_LARGEST = 3


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
    if options.region is None:
        return Region.centred(rows, columns, sensor)
    region = parse_window(options.region, sensor, "--region")
    if (region.height, region.width) != (rows, columns):
        raise OptionError(
            f"--region {options.region} has {region.height}×{region.width} cells, but the picture "
            f"{files[first]} {rows}×{columns}: it says where the pictures lie, cell by cell"
        )
    return region
