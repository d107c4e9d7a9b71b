"""What simulations begin with, a camera, and end with, its sensor's noisy counts in a file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch import Tensor

from nolens.camera import OpenCamera, Sensor
from nolens.errors import OptionError
from nolens.files import camera_files, read_camera, write_counts, write_dng
from nolens.jobs.run import Run
from nolens.jobs.scene_options import CameraOptions
from nolens.twin import Light, Twin
from nolens.twin.preview import preview_model


@dataclass(frozen=True)
class SimulatedCamera:
    """A camera whose description was read and suits what is to be written.

    Parameters
    ----------
    opened
        The camera.
    light
        Spectrum of the light.
    preview
        The camera with a stand-in for its relief.
    """

    opened: OpenCamera
    light: Light
    preview: Twin

    @classmethod
    def of(cls, run: Run[Any]) -> "SimulatedCamera":
        """Read the camera of a run whose options are `CameraOptions`.

        Raises
        ------
        NolensError
            If the camera or the light cannot be used, or the output not hold its counts.
        """
        options: CameraOptions = run.options
        opened = read_camera(options.camera)
        _check_raw(options.output, opened.camera.sensor)
        run.reads(camera_files(options.camera, opened.camera))
        bare = preview_model(opened, fresnel=options.fresnel)
        return cls(opened, Light(options.light), bare)

    @property
    def parameters(self) -> dict[str, Any]:
        """What the record has of it."""
        return {"camera_description": self.opened.camera.model_dump(mode="json")}


def _check_raw(path: Path, sensor: Sensor) -> None:
    """Refuse a DNG of a sensor without a colour mosaic or a whole black level."""
    if path.suffix.lower() != ".dng":
        return
    if sensor.mosaic == "none":
        raise OptionError(
            f"{path.name} would be a DNG, which holds a colour mosaic, and the sensor "
            f"{sensor.name!r} has none: write {path.with_suffix('.tif').name}"
        )
    if not sensor.black_counts.is_integer():
        raise OptionError(
            f"{path.name} would be a DNG with a whole black level, and the sensor {sensor.name!r} "
            f"has {sensor.black_counts:g}: write {path.with_suffix('.tif').name}, or round it"
        )


def write_raw(path: Path, counts: Tensor, sensor: Sensor, exposure_s: float | None = None) -> None:
    """Write counts as DNG or as 16-bit TIFF, by the suffix.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    white = sensor.saturated_counts
    if path.suffix.lower() == ".dng":
        write_dng(
            path,
            counts,
            pattern=sensor.mosaic,
            black=int(sensor.black_counts),
            white=white,
            exposure_s=exposure_s,
        )
    else:
        pattern = None if sensor.mosaic == "none" else sensor.mosaic
        write_counts(
            path,
            counts,
            mosaic=pattern,
            black=sensor.black_counts,
            white=white,
            exposure_s=exposure_s,
        )
