"""Pictures of targets from files, and the angles of their cells."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from torch import Tensor

from nolens.camera import Measurement, OpenCamera, develop, prepare_psf
from nolens.errors import DataError, OptionError
from nolens.experiments.resolution import TAU, AngularScale
from nolens.experiments.virtual_experiment import solved
from nolens.files import CAMERA_FILE, camera_files, read_camera, read_frame
from nolens.jobs.measuring.resolution_options import ResolutionOptions
from nolens.jobs.reconstruction.options import parse_window
from nolens.jobs.run import Run
from nolens.operators import Region
from nolens.twin import preview_model

Options = TypeVar("Options", bound=ResolutionOptions)


@dataclass(frozen=True)
class GivenCamera:
    """The camera that took the frames, as far as it is known.

    Parameters
    ----------
    opened
        It; None where the angle of a cell is given in its place.
    files
        Files it is read from, by role.
    """

    opened: OpenCamera | None
    files: dict[str, Path]

    @classmethod
    def of(cls, options: ResolutionOptions) -> "GivenCamera":
        """Read the camera that is named, or the one beside the PSF.

        Raises
        ------
        NolensError
            If it cannot be read, or nothing says how large a cell is.
        """
        given: str | Path | None = options.camera
        if options.cell_angle is not None:
            return cls(None, {})
        if given is None and options.psf is not None:
            beside = options.psf.parent / CAMERA_FILE
            given = beside if beside.is_file() else None
        if given is None:
            raise OptionError(
                "nothing says under which angle a cell is seen: give the camera that took the "
                "frames (--camera FOLDER), or the angle (--cell-angle 0.138deg)"
            )
        opened = read_camera(given)
        return cls(opened, camera_files(given, opened.camera))


@dataclass(frozen=True)
class TargetPicture:
    """One picture of a target.

    Parameters
    ----------
    picture
        Mean of its channels, (height, width).
    scale
        Angles of its cells.
    """

    picture: Tensor
    scale: AngularScale


def target_pictures(run: Run[Options], iterations: int) -> list[TargetPicture]:
    """Give every frame as a picture: read, or reconstructed with the PSF.

    Every file is read and checked before the first one is reconstructed.

    Parameters
    ----------
    run
        Which frames, and how.
    iterations
        Of ADMM.

    Raises
    ------
    NolensError
        If a file cannot be used.
    """
    options, camera = run.options, GivenCamera.of(run.options)
    run.reads(camera.files)
    if options.psf is None:
        return [_read(path, options, camera) for path in options.frames]
    ready = _ready(options, run.warn)
    scales = [
        _scale(path, options, camera, each.region)
        for path, each in zip(options.frames, ready, strict=True)
    ]
    run.begin()
    found = []
    for number, (each, scale) in enumerate(zip(ready, scales, strict=True)):

        def tick(share: float, number: int = number) -> None:
            run.reporter.advance("frames", (number + share) / len(ready))

        picture = solved(
            each.seen,
            each.psf,
            each.region,
            iterations=iterations,
            tau=options.tau or TAU,
            tick=tick,
        )[0]
        found.append(TargetPicture(picture, scale))
    return found


def _read(path: Path, options: ResolutionOptions, camera: GivenCamera) -> TargetPicture:
    """A picture that was reconstructed already."""
    frame = read_frame(path)
    if frame.mosaic is not None:
        raise DataError(
            f"{path} holds raw counts behind a colour mosaic: give --psf to reconstruct it, or a "
            "picture that nolens reconstruct wrote"
        )
    picture = develop(frame, channels="grey").values[0]
    height, width = picture.shape
    if camera.opened is None:
        return TargetPicture(picture, _scale(path, options, camera, Region(0, 0, height, width)))
    sensor = preview_model(camera.opened).shape
    region = Region.centred(height, width, sensor)
    if options.support is not None:
        region = parse_window(options.support, sensor, "--support")
    if (region.height, region.width) != (height, width):
        raise OptionError(
            f"--support {options.support} is {region.height}×{region.width} pixels, but "
            f"{path} shows {height}×{width}: give the support that it was reconstructed with"
        )
    return TargetPicture(picture, _scale(path, options, camera, region))


@dataclass(frozen=True)
class _Ready:
    """What one reconstruction starts from."""

    seen: Measurement
    psf: Tensor
    region: Region


def _ready(options: ResolutionOptions, warn: Callable[..., None]) -> list[_Ready]:
    """All raw frames, developed, with the PSF that fits them."""
    assert options.psf is not None
    dark = None if options.dark is None else read_frame(options.dark)
    psf = read_frame(options.psf)
    psf_dark = dark if dark is not None and dark.counts.shape == psf.counts.shape else None
    point = develop(psf, dark=psf_dark, channels="grey")
    found = []
    for number, path in enumerate(options.frames):
        seen = develop(read_frame(path), dark=dark, channels="grey")
        prepared = prepare_psf(point, seen, wider=options.psf_extent == "wide")
        if number == 0:
            warn(*prepared.notes, *prepared.warnings)
        rows, columns = seen.values.shape[-2:]
        region = Region(0, 0, rows, columns)
        if options.support is not None:
            region = parse_window(options.support, (rows, columns), "--support")
        found.append(_Ready(seen, prepared.values, region))
    return found


def _scale(
    path: Path, options: ResolutionOptions, camera: GivenCamera, region: Region
) -> AngularScale:
    if options.cell_angle is not None:
        return AngularScale(math.tan(options.cell_angle.rad))
    assert camera.opened is not None
    twin = preview_model(camera.opened)
    rows, columns = twin.shape
    if region.height > 2 * rows or region.width > 2 * columns:
        raise DataError(
            f"{path} shows {region.height}×{region.width} cells, but the sensor of "
            f"{camera.opened.camera.name!r} has {rows}×{columns}: give the camera that took it"
        )
    return AngularScale.of_camera(twin, region)
