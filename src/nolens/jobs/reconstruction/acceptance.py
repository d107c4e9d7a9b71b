"""The camera that a measurement is of, where it is known, and what it accepts light from."""

from pathlib import Path
from typing import TYPE_CHECKING

from torch import Tensor

from nolens.errors import NolensError
from nolens.files import CAMERA_FILE
from nolens.operators import Geometry, PixelRectangle

if TYPE_CHECKING:
    from nolens.camera import LoadedCamera


def camera_of(
    name: str | None, folder: Path, bin_by: int, sensor: tuple[int, int]
) -> "LoadedCamera | None":
    """The camera of a name, or else of a folder; None where it has no measurement of that size.

    Parameters
    ----------
    name, folder
        Of the camera.
    bin_by, sensor
        Pixels along a superpixel of the measurement, and its (height, width).
    """
    camera = name or folder / CAMERA_FILE
    if isinstance(camera, Path) and not camera.is_file():
        return None
    # Most reconstructions need no camera.
    from nolens.files import read_camera

    try:
        loaded = read_camera(camera)
    except NolensError:  # A file beside the PSF may be of another kind.
        return None
    side = bin_by * loaded.camera.sensor.superpixel
    size = loaded.camera.sensor.rows // side, loaded.camera.sensor.columns // side
    return loaded if size == sensor else None


def acceptance_of(
    loaded: "LoadedCamera",
    bin_by: int,
    sensor: tuple[int, int],
    psf: Tensor,
    nearest_um: float | None,
) -> PixelRectangle | None:
    """Pixels whose light a camera accepts (`acceptance_support`).

    None where that is all that the sensor can see, or the camera's mask cannot be computed.

    Parameters
    ----------
    loaded
        The camera.
    bin_by, sensor, psf
        The measurement's pixels along a superpixel, its (height, width), and its PSF.
    nearest_um
        Distance of the nearest thing in the scene; None where it is not known.
    """
    # Most reconstructions need no camera.
    from nolens.twin import acceptance_support, preview_model

    try:
        twin = preview_model(loaded)
    except NolensError:
        return None
    support = acceptance_support(twin, nearest_um)
    support = support if bin_by == 1 else support.coarser(bin_by)
    seen = Geometry.build(sensor, (psf.shape[-2], psf.shape[-1]), None)
    whole = PixelRectangle(*seen.origin, *seen.scene[2:])
    support = support.intersection(whole)
    return None if support == whole else support
