"""The demonstration: the paper's camera, simulated, and the photograph made from its files."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.camera import LoadedCamera, develop, exposure_white, preset
from nolens.evaluate import psnr, scale_fit
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.files import read_frame, readable, write_frame, write_into, write_png
from nolens.jobs.fields import FilePath
from nolens.jobs.options import JobOptions, Option, Written
from nolens.jobs.reconstruction.job import reconstruct
from nolens.jobs.reconstruction.options import ReconstructOptions
from nolens.jobs.run import Product, Reporter, Run, job
from nolens.jobs.sample_pictures import sample_picture
from nolens.optics import PointSource
from nolens.twin import Light, Plane, Twin

_SCENE_PIXELS = (1520, 2028)
"""Part of the paper's sensor that is read for the scene: half of it in each direction."""
_PSF_PIXELS = (2320, 2828)
"""Part that is read for the point source: wider by what the scene moves the PSF."""
_DISTANCE_UM = 300e3
_SOURCE_UM = 50.0
_ANGLE_DEG = 50.0
_TAU = 1e-5


class DemoOptions(JobOptions):
    """Simulate a small lensless camera, and reconstruct a photograph from its files."""

    usage = "demo -o FOLDER"

    output: Annotated[
        FilePath,
        Option("Folder for the files of the camera and the pictures.", role="output", flag="-o"),
    ] = Path("demo")

    @property
    def output_folder(self) -> Path:
        """It is made where it does not exist."""
        return self.output

    @property
    def measurement(self) -> Path:
        """What the simulated camera measures of the scene."""
        return self.output / "measurement.dng"

    @property
    def psf(self) -> Path:
        """What it measures of a point source."""
        return self.output / "psf.dng"

    @property
    def picture(self) -> Path:
        """Measurement | reconstruction | truth."""
        return self.output / "demo.png"

    def reconstruction(self, region: str) -> ReconstructOptions:
        """How the camera's files are reconstructed."""
        return ReconstructOptions(
            measurement=self.measurement,
            psf=self.psf,
            psf_extent="wide",
            support=region,
            tau=_TAU,
            output=(self.output / "reconstruction.png",),
        )

    @property
    def written(self) -> tuple[Written, ...]:
        """Files of the camera, and the picture; those of the reconstruction are named by it."""
        return (
            Written("measurement", self.measurement),
            Written("PSF", self.psf),
            Written("picture", self.picture),
        )


@job
def run_demo(run: Run[DemoOptions]) -> Product[Tensor]:
    """Simulate a camera, write what it would write, reconstruct from those files.

    Raises
    ------
    OptionError
        If scikit-image, which brings the photograph, is not installed.
    FileError
        If the folder cannot be made.
    """
    options = run.options
    photograph = sample_picture("astronaut", "the photograph of the demonstration comes")
    truth, region = _capture(photograph, options, run.reporter)
    asked = options.reconstruction(region)
    solved = reconstruct(asked, run.reporter)
    run.warn(*solved.summary["warnings"], aloud=False)
    fitted = scale_fit(solved.value, truth)
    shown = _side_by_side(develop(read_frame(options.measurement)).values, fitted, truth)
    command = [
        "nolens",
        "reconstruct",
        str(options.measurement),
        "--psf",
        str(options.psf),
        "--psf-extent",
        "wide",
        "--support",
        region,
        "--tau",
        f"{_TAU:g}",
        "-o",
        str(asked.output[0]),
    ]
    figures = {
        **solved.summary,
        "psnr_db": psnr(fitted, truth, 1.0),
        "picture": readable(options.picture),
        "command": command,
    }
    files = [options.measurement, options.psf, *map(Path, solved.summary["outputs"])]
    return Product(
        solved.value,
        figures,
        {options.picture: partial(write_png, radiance=shown)},
        outputs=(*files, options.picture),
    )


def _capture(photograph: Tensor, options: DemoOptions, reporter: Reporter) -> tuple[Tensor, str]:
    """Write the files of the simulated camera; what their reconstruction is to show, and where."""
    reporter.note(
        f"the paper's camera: a point source at 300 mm, on the middle {_size(_PSF_PIXELS)} pixels"
    )
    wide = Twin.of(LoadedCamera.of(preset("paper"))).reading(*_PSF_PIXELS)
    experiment = VirtualExperiment(wide, Light("white-led"), wavelengths=1, field_points=5)
    source = PointSource(distance_um=_DISTANCE_UM, diameter_um=_SOURCE_UM)
    point = experiment.point(source, seed=2, progress=partial(reporter.advance, "point source"))

    points = experiment.field_points
    reporter.note(
        f"a scene that fills {_ANGLE_DEG:g}°, on the middle {_size(_SCENE_PIXELS)} pixels, with "
        f"{points}×{points} PSFs"
    )
    experiment = replace(experiment, twin=wide.reading(*_SCENE_PIXELS))
    shot = experiment.measure(
        (Plane(photograph, _ANGLE_DEG, _DISTANCE_UM),),
        seed=1,
        progress=partial(reporter.advance, "scene"),
    )
    model = "nolens simulated camera"
    writers = {
        options.measurement: partial(write_frame, frame=shot.frame, model=model),
        options.psf: partial(write_frame, frame=point, model=model),
    }
    write_into(options.output, writers)
    return shot.truth * shot.response, f"{shot.region.height}x{shot.region.width}"


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
