"""The demonstration: the paper's camera, simulated, and the photograph made from its files."""

from functools import partial
from pathlib import Path
from typing import Annotated

from torch import Tensor

from nolens.camera import LoadedCamera, develop
from nolens.evaluate import psnr, scale_fit
from nolens.experiments.demonstration import DISTANCE, Demonstration, demonstrate, side_by_side
from nolens.files import (
    PSFS_FILE,
    read_frame,
    readable,
    write_frame,
    write_into,
    write_png,
    write_psfs,
)
from nolens.files.cameras import camera_copies
from nolens.files.psf_folder import PsfFolder
from nolens.files.sample_pictures import sample_picture
from nolens.jobs.calibration.folder import field_entries
from nolens.jobs.fields import FilePath
from nolens.jobs.options import JobOptions, Option, Written
from nolens.jobs.reconstruction.job import reconstruct
from nolens.jobs.reconstruction.options import ReconstructOptions
from nolens.jobs.run import Product, Run, job

_MODEL = "nolens simulated camera"


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
    def camera(self) -> Path:
        """Folder of the camera, with what it measures of point sources."""
        return self.output / "camera"

    @property
    def picture(self) -> Path:
        """Measurement | reconstruction | truth."""
        return self.output / "demo.png"

    def reconstruction(self, support: str) -> ReconstructOptions:
        """How the camera's files are reconstructed."""
        return ReconstructOptions(
            measurement=self.measurement,
            psf=self.camera,
            support=support,
            output=(self.output / "reconstruction.png",),
        )

    @property
    def written(self) -> tuple[Written, ...]:
        """Files of the camera, and the picture; those of the reconstruction are named by it."""
        return (
            Written("measurement", self.measurement),
            Written("list of PSFs", self.camera / PSFS_FILE),
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
    demonstration = demonstrate(photograph, run.reporter.note, run.reporter.advance)
    write_into(
        options.output,
        {
            options.measurement: partial(write_frame, frame=demonstration.scene, model=_MODEL),
        },
    )
    psfs = _write_camera(options.camera, demonstration)
    truth = demonstration.truth
    support = f"{demonstration.support.height}x{demonstration.support.width}"
    reconstruction = options.reconstruction(support)
    solved = reconstruct(reconstruction, run.reporter)
    run.warn(*solved.summary["warnings"], aloud=False)
    fitted = scale_fit(solved.value, truth)
    panels = side_by_side(develop(read_frame(options.measurement)).values, fitted, truth)
    command = [
        "nolens",
        "reconstruct",
        str(options.measurement),
        "--psf",
        str(options.camera),
        "--support",
        support,
        "-o",
        str(reconstruction.output[0]),
    ]
    figures = {
        **solved.summary,
        "psnr_db": psnr(fitted, truth, 1.0),
        "picture": readable(options.picture),
        "command": command,
    }
    files = [options.measurement, *psfs, *map(Path, solved.summary["outputs"])]
    return Product(
        solved.value,
        figures,
        {options.picture: partial(write_png, radiance=panels)},
        outputs=(*files, options.picture),
    )


def _write_camera(folder: Path, demonstration: Demonstration) -> list[Path]:
    """The description and the PSFs of the camera, and what was written."""
    camera = demonstration.camera
    writers = camera_copies(camera.name, LoadedCamera.of(camera))
    entries = field_entries(
        demonstration.psfs,
        camera,
        PsfFolder(folder).pitch(camera.sensor.pitch, camera.sensor.superpixel),
        DISTANCE,
        "extended",
    )
    write_psfs(folder, entries, more=writers)
    return [folder / name for name in (*writers, PSFS_FILE, *(each.file for each in entries))]
