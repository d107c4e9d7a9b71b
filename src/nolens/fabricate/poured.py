"""Which layer of a camera is poured."""

from nolens.camera import Camera, Layer
from nolens.errors import OptionError

_GLASSES = ("cover-glass", "d263", "bk7", "fused-silica")


def poured_layer(camera: Camera) -> Layer:
    """Find the layer that is poured onto the sensor's glass and has the mask's relief on top.

    What lies below it comes with the sensor: the cover glass and the air under it, or nothing.

    Raises
    ------
    OptionError
        If the mask is a film at a distance, or it does not lie on the sensor's own layers.
    """
    layers = camera.layers
    first = len(layers)
    if _is_air(layers[-1]):
        first -= 2
    elif layers[-1].material in _GLASSES:
        first -= 1
    between = layers[camera.mask.surface : max(first, 0)]
    advice = "give a camera whose masked layer lies on the cover glass, such as the preset paper"
    if any(_is_air(layer) for layer in between):
        raise OptionError(
            f"the mask of {camera.name!r} is a film with air between it and the glass: no resin is "
            f"poured there, and this frame is for pouring; {advice}"
        )
    if len(between) != 1:
        names = ", ".join(layer.name or "one without a name" for layer in between) or "none"
        raise OptionError(
            f"one layer is poured onto the glass, but between the mask's surface and the cover "
            f"glass of {camera.name!r} there are {len(between)} ({names}): {advice}"
        )
    return between[0]


def _is_air(layer: Layer) -> bool:
    return layer.material == "air" or layer.index == 1
