"""A camera whose files have been read."""

from dataclasses import dataclass

from torch import Tensor

from nolens.camera.curves import AngularCurve, CurveFile, SpectralCurve
from nolens.camera.description import Camera, ReliefFile
from nolens.errors import DataError


@dataclass(frozen=True)
class OpenCamera:
    """A camera with all that its description names.

    Attributes
    ----------
    camera
        The description.
    quantum_efficiency
        Electrons per photon over wavelength.
    acceptance
        Response over the angle of incidence.
    relief_um
        Heights in um, float32, (rows, columns); None where the relief is not a file.
    """

    camera: Camera
    quantum_efficiency: SpectralCurve
    acceptance: AngularCurve
    relief_um: Tensor | None = None


def opened(camera: Camera) -> OpenCamera:
    """Open a camera that names no files.

    Raises
    ------
    DataError
        If it does name one.
    """
    efficiency, acceptance = camera.sensor.quantum_efficiency, camera.sensor.acceptance
    relief = camera.mask.relief
    for part in (efficiency, acceptance, relief):
        if isinstance(part, CurveFile | ReliefFile):
            raise DataError(
                f"the camera {camera.name!r} names the file {part.file}: read it from its folder "
                "with nolens.files.cameras"
            )
    assert isinstance(efficiency, SpectralCurve) and isinstance(acceptance, AngularCurve)
    return OpenCamera(camera, efficiency, acceptance)
