"""Focus and PSF of a camera as the thickness of its layers changes, in about a second."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from torch import Tensor

from nolens.camera import LoadedCamera, RandomLenslets, SpectralCurve
from nolens.design.focus import LensletStack, depth_of_focus_um, lenslet_aperture
from nolens.errors import DataError, OptionError
from nolens.optics import PointSource
from nolens.quantities import Length
from nolens.twin import REFERENCE_NM, Light, Twin, point_spread

_PIXELS = 224
"""Sides of the PSF's window: ten pitches of the paper's lenslets."""


def with_thickness(loaded: LoadedCamera, thickness: Mapping[str, Length]) -> LoadedCamera:
    """A camera with layers of other thickness.

    Parameters
    ----------
    loaded
        The camera.
    thickness
        By the layer's name, or its number from 0 where it has none.

    Raises
    ------
    OptionError
        If it has no such layer.
    """
    layers = list(loaded.camera.layers)
    names = [each.name or str(number) for number, each in enumerate(layers)]
    for name, length in thickness.items():
        if name not in names:
            raise OptionError(
                f"{loaded.camera.name!r} has no layer {name!r}: its layers are {', '.join(names)}"
            )
        place = names.index(name)
        layers[place] = layers[place].model_copy(update={"thickness": length})
    camera = loaded.camera.model_copy(update={"layers": tuple(layers)})
    return replace(loaded, camera=camera)


def lenslet_stack(loaded: LoadedCamera, source_um: float) -> LensletStack:
    """Layers and lenslets of a camera, as ray matrices take them; other masks bend no light."""
    camera, relief = loaded.camera, loaded.camera.mask.relief
    return LensletStack(
        tuple(layer.thickness.um for layer in camera.layers),
        camera.indices(REFERENCE_NM),
        camera.mask.surface,
        relief.radius.um if isinstance(relief, RandomLenslets) else math.inf,
        source_um,
    )


@dataclass(frozen=True)
class BestThickness:
    """Thickness of the mask's layer that focuses, and the focus there.

    Parameters
    ----------
    thickness_um
        Zero or less where none focuses.
    aperture, depth_of_focus_um
        See `nolens.design.focus`; the depth is as in air.
    index
        Of the layer.
    """

    thickness_um: float
    aperture: float
    depth_of_focus_um: float
    index: float

    @classmethod
    def of(cls, stack: LensletStack, pitch_um: float) -> "BestThickness":
        """Solve for the layer behind lenslets of a pitch."""
        surface = stack.surface
        best_um = float(stack.focused_thickness_um(surface))
        layers = (*stack.thicknesses_um[:surface], best_um, *stack.thicknesses_um[surface + 1 :])
        focused = replace(stack, thicknesses_um=layers)
        aperture = float(lenslet_aperture(pitch_um, focused.behind_um))
        depth_um = float(depth_of_focus_um(REFERENCE_NM * 1e-3, aperture))
        return cls(best_um, aperture, depth_um, float(stack.indices[surface]))


def preview_psf(
    loaded: LoadedCamera, source_um: float, progress: Callable[[float], None]
) -> tuple[Tensor, float]:
    """The twin's PSF at 550 nm in a window as large as some pitches, which stands for the rest.

    Parameters
    ----------
    loaded
        The camera.
    source_um
        Distance of the point source, straight ahead.
    progress
        Called with the fraction that is done.

    Returns
    -------
    tuple
        The PSF, (1, 224, 224), and the pitch of its pixels in um.

    Raises
    ------
    DataError
        If no light reaches the sensor.
    """
    sensor = loaded.camera.sensor
    superpixel = 1 if sensor.mosaic == "none" else 2
    psf = point_spread(
        _grey_patch(loaded, _PIXELS * superpixel),
        PointSource(distance_um=source_um),
        (_PIXELS, _PIXELS),
        superpixel=superpixel,
        light=Light(f"{REFERENCE_NM:g}nm"),
        wavelengths=1,
        progress=progress,
    )
    if not float(psf.max()) > 0:
        raise DataError(
            "no light of a point straight ahead reaches the sensor through these layers"
        )
    return psf, sensor.pitch.um * superpixel


def _grey_patch(loaded: LoadedCamera, side: int) -> Twin:
    """A grey camera of so many pixels: one wavelength is worked out, and a piece of the mask."""
    sensor, curve = loaded.camera.sensor, loaded.quantum_efficiency
    channel = "G" if "G" in sensor.channels else sensor.channels[0]
    grey = SpectralCurve(
        source=curve.source,
        wavelength_nm=curve.wavelength_nm,
        values={"grey": curve.values[channel]},
    )
    small = sensor.model_copy(update={"rows": side, "columns": side, "mosaic": "none"})
    camera = loaded.camera.model_copy(update={"sensor": small})
    return Twin.of(replace(loaded, camera=camera, quantum_efficiency=grey))
