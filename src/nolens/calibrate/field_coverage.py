"""Whether PSFs at several angles cover the field of a scene."""

from torch import Tensor

from nolens.calibrate.distances import Layers
from nolens.errors import OptionError
from nolens.operators import PixelRectangle

_FARTHER = 1.3
"""How many times farther out than the outermost PSF a scene may go on."""
_NARROW_DEG = 5.0
"""Half a scene's angle up to which the PSF of the axis is enough."""


def coverage_warnings(
    places: Tensor,
    scene: PixelRectangle,
    sensor: tuple[int, int],
    pixel_um: float,
    layers: Layers,
    stated: str = "",
) -> list[str]:
    """Warn of a scene that goes on far beyond the outermost PSFs; refuse one that was asked for.

    Parameters
    ----------
    places
        (points, 2): where the chief rays of the PSFs fall, as `FieldPsf` has them.
    scene
        Pixels of the scene, in the sensor's frame.
    sensor
        (height, width) of the sensor.
    pixel_um
        Pitch of the pixels.
    layers
        Of the camera.
    stated
        Options that ask for this scene or these PSFs, for the message; empty where none does, as
        a photograph with the PSFs that there are is better than none.

    Raises
    ------
    OptionError
        If a scene that was asked for goes on far beyond them.
    """
    top, left = scene.top - sensor[0] // 2, scene.left - sensor[1] // 2
    bottom, right = top + scene.height - 1, left + scene.width - 1
    low, high = places.amin(dim=0).tolist(), places.amax(dim=0).tolist()
    sides = {
        "to the right": (right, high[1]),
        "to the left": (-left, -low[1]),
        "up": (-top, -low[0]),
        "down": (bottom, high[0]),
    }
    missing = []
    for side, pixels in sides.items():
        edge, outermost = (
            layers.angle_at((max(0.0, each) * pixel_um, 0.0))[0].deg for each in pixels
        )
        if edge > max(_FARTHER * outermost, _NARROW_DEG):
            missing.append(f"{edge:.0f}° {side} (the PSFs to {outermost:.0f}°)")
    if not missing:
        return []
    beyond = f"the scene goes on to {', '.join(missing)}"
    remedy = (
        "PSFs at the angles that are missing: nolens calibrate plan lists those to capture, nolens "
        "psf --field --field-points computes them"
    )
    if stated:
        raise OptionError(
            f"{stated}: {beyond}. Add {remedy}. Or state a smaller support; or neither a support "
            "nor a number of PSFs, which takes all PSFs, and beyond them that of the outermost "
            "angle"
        )
    return [f"{beyond}: the PSF there is taken for that of the outermost angle. Add {remedy}"]
