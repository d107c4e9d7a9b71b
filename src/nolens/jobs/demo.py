"""The demonstration: a simulated camera's files, and the photograph made from them."""

import importlib
from dataclasses import dataclass
from pathlib import Path

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.camera import develop, exposure_white, linear_from_srgb
from nolens.errors import FileError, OptionError
from nolens.evaluate import psnr, scale_fit
from nolens.files import read_frame, write_dng, write_png
from nolens.jobs.options import ReconstructOptions
from nolens.jobs.reconstruct import Outcome, Reporter, reconstruct
from nolens.operators import CroppedConvolution, Region
from nolens.twin import LensletMask, Sensor, caustic_psf, expose

_SENSOR_CELLS = (760, 1014)
"""Half of the paper's camera in each direction, in cells of 2×2 pixels."""
_SCENE_CELLS = 400
"""Side of the photograph: a full angle of 52° behind 1.28 mm of reduced thickness."""
_PIXEL_UM = 1.55
_WAVELENGTHS_NM = (600.0, 535.0, 465.0)
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
    """

    picture: Path
    psnr_db: float
    outcome: Outcome


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
    truth = _photograph()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"cannot make {folder}: {error.strerror or error}") from error
    reporter.note("simulating the camera: mask, point source and scene")
    measurement_path, psf_path = _capture(truth, folder)
    outcome = reconstruct(
        ReconstructOptions(
            measurement=measurement_path,
            psf=psf_path,
            psf_wider=True,
            region=f"{_SCENE_CELLS}x{_SCENE_CELLS}",
            tau=_TAU,
            output=(folder / "reconstruction.png",),
        ),
        reporter,
    )
    fitted = scale_fit(outcome.picture, truth)
    picture = folder / "demo.png"
    write_png(picture, _side_by_side(develop(read_frame(measurement_path)).values, fitted, truth))
    return DemoResult(picture, psnr(fitted, truth, 1.0), outcome)


def _capture(truth: Tensor, folder: Path) -> tuple[Path, Path]:
    """Files of the simulated camera: a scene, and a point source seen by a larger sensor."""
    sensor = Sensor()
    wide = (_SENSOR_CELLS[0] + _SCENE_CELLS, _SENSOR_CELLS[1] + _SCENE_CELLS)
    fine = caustic_psf(LensletMask(), (2 * wide[0], 2 * wide[1]), _PIXEL_UM, _WAVELENGTHS_NM)
    psf = nnf.avg_pool2d(fine[None], 2)[0]
    region = Region.centred(_SCENE_CELLS, _SCENE_CELLS, _SENSOR_CELLS)
    light = CroppedConvolution(psf, _SENSOR_CELLS, region)(truth).clamp_min(0)
    paths = folder / "measurement.dng", folder / "psf.dng"
    for path, image, seed in zip(paths, (light, psf), (1, 2), strict=True):
        counts = expose(image, sensor, fill=_FILL, seed=seed)
        write_dng(
            path, counts, pattern=sensor.mosaic, black=sensor.black_counts,
            white=sensor.white_counts,
        )  # fmt: skip
    return paths


def _photograph() -> Tensor:
    """scikit-image's astronaut in linear light, (3, cells, cells)."""
    try:
        data = importlib.import_module("skimage.data")
    except ImportError:
        raise OptionError(
            "the photograph of the demonstration comes with scikit-image, which is not "
            "installed; pip install 'nolens[demo]'"
        ) from None
    encoded = torch.from_numpy(data.astronaut()).permute(2, 0, 1).float() / 255
    linear = linear_from_srgb(encoded)
    size = (_SCENE_CELLS, _SCENE_CELLS)
    return nnf.interpolate(linear[None], size=size, mode="bilinear", antialias=True)[0]


def _side_by_side(measurement: Tensor, reconstruction: Tensor, truth: Tensor) -> Tensor:
    """Measurement | reconstruction | truth at one height, each exposed by itself."""
    height = truth.shape[-2]
    width = round(measurement.shape[-1] * height / measurement.shape[-2])
    small = nnf.interpolate(measurement.clamp_min(0)[None], size=(height, width), mode="area")[0]
    white = exposure_white(truth)
    panels = [small / exposure_white(small), reconstruction / white, truth / white]
    gap = torch.ones(3, height, 8)
    return torch.cat([panels[0], gap, panels[1], gap, panels[2]], dim=-1).clamp(0, 1)
