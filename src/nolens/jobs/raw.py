"""What a simulated sensor makes of light: noisy counts in a file."""

from pathlib import Path

from torch import Tensor

from nolens.camera import Sensor
from nolens.errors import OptionError
from nolens.files import check_output, write_counts, write_dng

_TIFF = (".tif", ".tiff")
"""Of any figure of a sensor; counts are computed in float32."""


def check_raw(path: Path, sensor: Sensor, more: tuple[str, ...] = ()) -> None:
    """Refuse a file that cannot hold the sensor's counts, before any work is done for it.

    Parameters
    ----------
    path, sensor
        The file, and whose counts.
    more
        Suffixes of files that hold something else, and may be written too.

    Raises
    ------
    FileError
        If its suffix is none of these, or it cannot be written.
    OptionError
        If it is a DNG, and the sensor has no colour mosaic or no whole black level.
    """
    check_output(path, (".dng", *_TIFF, *more))
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
