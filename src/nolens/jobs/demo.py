"""The demonstration: the paper's camera, simulated, and the photograph made from its files."""

from dataclasses import dataclass
from pathlib import Path

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.camera import develop, exposure_white, opened, preset
from nolens.errors import FileError
from nolens.evaluate import psnr, scale_fit
from nolens.files import read_frame, write_dng, write_png
from nolens.jobs.reconstruction.job import reconstruct
from nolens.jobs.reconstruction.options import ReconstructOptions
from nolens.jobs.reporter import Reporter
from nolens.jobs.run import Result
from nolens.jobs.sample_pictures import sample_picture
from nolens.optics import PointSource
from nolens.twin import (
    Light,
    Plane,
    Twin,
    arrange,
    expose,
    irradiate,
    mosaic,
    photocurrents,
    point_spread,
)

_SCENE_PIXELS = (1520, 2028)
"""Part of the paper's sensor that is read for the scene: half of it in each direction."""
_PSF_PIXELS = (2320, 2828)
"""Part that is read for the point source: wider by what the scene moves the pattern."""
_DISTANCE_UM = 300e3
_SOURCE_UM = 50.0
_ANGLE_DEG = 50.0
_FIELD_POINTS = 5
_WAVELENGTHS = 1
_FILL = 0.9
_TAU = 1e-5


@dataclass(frozen=True)
class DemoResult:
    """Where the picture is, and how good it came out.

    Parameters
    ----------
    picture
        PNG: measurement | reconstruction | truth.
    psnr_db
        Of the linear reconstruction, after one scale factor.
    outcome
        What `reconstruct` gave.
    command
        Arguments of `nolens` that reconstruct the same from the camera's files.
    """

    picture: Path
    psnr_db: float
    outcome: Result[Tensor]
    command: tuple[str, ...]


def run_demo(folder: Path, reporter: Reporter) -> DemoResult:
    """Simulate a camera, write what it would write, reconstruct from those files.

    Parameters
    ----------
    folder
        Gets measurement.dng, psf.dng, reconstruction.png and demo.png; made if missing.
    reporter
        Sees notes and iterations.

    Raises
    ------
    OptionError
        If scikit-image, which brings the photograph, is not installed.
    FileError
        If the folder cannot be made.
    """
    photograph = sample_picture("astronaut", "the photograph of the demonstration comes")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"cannot make {folder}: {error.strerror or error}") from error
    measurement_path, psf_path, truth, region = _capture(photograph, folder, reporter)
    options = ReconstructOptions(
        measurement=measurement_path,
        psf=psf_path,
        psf_wider=True,
        region=region,
        tau=_TAU,
        output=(folder / "reconstruction.png",),
    )
    outcome = reconstruct(options, reporter)
    fitted = scale_fit(outcome.value, truth)
    picture = folder / "demo.png"
    write_png(picture, _side_by_side(develop(read_frame(measurement_path)).values, fitted, truth))
    command = (
        "reconstruct",
        str(measurement_path),
        "--psf",
        str(psf_path),
        "--psf-wider",
        "--region",
        region,
        "--tau",
        f"{_TAU:g}",
        "-o",
        str(options.output[0]),
    )
    return DemoResult(picture, psnr(fitted, truth, 1.0), outcome, command)


def _capture(
    photograph: Tensor, folder: Path, reporter: Reporter
) -> tuple[Path, Path, Tensor, str]:
    """Files of the simulated camera; what its reconstruction is to show, and where."""
    light = Light("white-led")
    reporter.note(
        f"the paper's camera: a point source at 300 mm, on the middle {_size(_PSF_PIXELS)} pixels"
    )
    wide = Twin.of(opened(preset("paper"))).reading(*_PSF_PIXELS)
    source = PointSource(distance_um=_DISTANCE_UM, diameter_um=_SOURCE_UM)
    psf = point_spread(
        wide,
        source,
        _PSF_PIXELS,
        light=light,
        wavelengths=_WAVELENGTHS,
        frame="sensor",
        tick=lambda share: reporter.advance("point source", share),
    )
    sensor = wide.camera.sensor

    reporter.note(
        f"a scene that fills {_ANGLE_DEG:g}°, on the middle {_size(_SCENE_PIXELS)} pixels, with "
        f"{_FIELD_POINTS}×{_FIELD_POINTS} PSFs"
    )
    twin = wide.reading(*_SCENE_PIXELS)
    field, seen = arrange(twin, (Plane(photograph, _ANGLE_DEG, _DISTANCE_UM),))
    irradiated = irradiate(
        twin,
        field,
        seen,
        field_points=_FIELD_POINTS,
        light=light,
        wavelengths=_WAVELENGTHS,
        tick=lambda share: reporter.advance("scene", share),
    )
    paths = folder / "measurement.dng", folder / "psf.dng"
    sees = photocurrents(twin, light, 1.0)[:, None, None]
    colours = mosaic(sees.expand(-1, *_SCENE_PIXELS), sensor.mosaic)
    images = irradiated.light * colours, mosaic(psf * sees, sensor.mosaic)
    for path, image, seed in zip(paths, images, (1, 2), strict=True):
        electrons = image * (_FILL * sensor.clip_electrons / float(image.max()))
        write_dng(
            path,
            expose(electrons, sensor, seed=seed),
            pattern=sensor.mosaic,
            black=int(sensor.black_counts),
            white=sensor.white_counts,
        )
    response = field.solid_angle() * field.vignetting()
    truth = seen[0].radiance * (response / response.max()).float()
    return *paths, truth, f"{field.region.height}x{field.region.width}"


def _size(pixels: tuple[int, int]) -> str:
    return f"{pixels[1]}×{pixels[0]}"


def _side_by_side(measurement: Tensor, reconstruction: Tensor, truth: Tensor) -> Tensor:
    """Measurement | reconstruction | truth at one height, each exposed by itself."""
    height = truth.shape[-2]
    width = round(measurement.shape[-1] * height / measurement.shape[-2])
    small = nnf.interpolate(measurement.clamp_min(0)[None], size=(height, width), mode="area")[0]
    white = exposure_white(truth)
    panels = [small / exposure_white(small), reconstruction / white, truth / white]
    gap = torch.ones(3, height, 8)
    return torch.cat([panels[0], gap, panels[1], gap, panels[2]], dim=-1).clamp(0, 1)
