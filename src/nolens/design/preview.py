"""Focus and PSF of a camera as the thickness of its layers changes, in about a second."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from torch import Tensor

from nolens.amounts import rounded
from nolens.camera import LoadedCamera, RandomLenslets, SpectralCurve
from nolens.design.focus import LensletStack, depth_of_focus_um, lenslet_aperture
from nolens.errors import DataError, NolensError, OptionError
from nolens.evaluate import PsfFigures, psf_figures
from nolens.optics import PointSource
from nolens.progress import ProgressCallback
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


@dataclass(frozen=True)
class DesignPreview:
    """Focus and PSF of a camera.

    Parameters
    ----------
    loaded
        The camera.
    stack
        Its layers and lenslets, as ray matrices take them; other masks bend no light.
    psf
        The twin's at 550 nm, (1, 224, 224): a window as large as some pitches, which stands for
        the rest.
    pixel_um
        Pitch of its pixels.
    figures
        Of the PSF; the reason in place of them where it has no lines, as that of a flat mask or
        of one far out of focus.
    """

    loaded: LoadedCamera
    stack: LensletStack
    psf: Tensor
    pixel_um: float
    figures: PsfFigures | str

    @classmethod
    def of(
        cls, loaded: LoadedCamera, source_um: float, progress: ProgressCallback
    ) -> "DesignPreview":
        """Compute the PSF of a point source straight ahead.

        Parameters
        ----------
        loaded
            The camera.
        source_um
            Distance of the point source.
        progress
            Called with the fraction that is done.

        Raises
        ------
        DataError
            If no light reaches the sensor.
        """
        camera, relief = loaded.camera, loaded.camera.mask.relief
        superpixel = camera.sensor.superpixel
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
        stack = LensletStack(
            tuple(layer.thickness.um for layer in camera.layers),
            camera.indices(REFERENCE_NM),
            camera.mask.surface,
            relief.radius.um if isinstance(relief, RandomLenslets) else math.inf,
            source_um,
        )
        pixel_um = camera.sensor.pitch.um * superpixel
        figures: PsfFigures | str
        try:
            figures = psf_figures(psf[0], pixel_um, reduced_um=float(stack.behind_um), noise=0.0)
        except NolensError as error:
            figures = str(error)
        return cls(loaded, stack, psf, pixel_um, figures)

    def summary(self) -> dict[str, Any]:
        """Layers, focus and figures of the PSF, in values that JSON has."""
        camera = self.loaded.camera
        indices = camera.indices(REFERENCE_NM)
        return {
            "camera": camera.name,
            "layers": [
                {
                    "name": layer.name or str(number),
                    "material": layer.material,
                    "thickness_mm": layer.thickness.mm,
                    "index": round(index, 5),
                }
                for number, (layer, index) in enumerate(zip(camera.layers, indices, strict=True))
            ],
            "mask_surface": camera.mask.surface,
            **self._focus(),
            "reduced_mm": rounded(float(self.stack.behind_um) * 1e-3),
            "pixel_um": self.pixel_um,
            **self._psf(),
        }

    def _focus(self) -> dict[str, Any]:
        """Where lenslets are in focus, by ray matrices; nothing of masks that have none."""
        relief, stack = self.loaded.camera.mask.relief, self.stack
        summary: dict[str, Any] = {
            "radius_mm": None,
            "pitch_um": None,
            "mask_layer": stack.surface,
            "best_thickness_mm": None,
            "aperture": None,
            "depth_of_focus_mm": None,
        }
        if not isinstance(relief, RandomLenslets):
            return summary
        summary |= {"radius_mm": relief.radius.mm, "pitch_um": relief.pitch.um}
        surface = stack.surface
        best_um = float(stack.focused_thickness_um(surface))
        if best_um <= 0:
            return summary
        layers = (*stack.thicknesses_um[:surface], best_um, *stack.thicknesses_um[surface + 1 :])
        focused = replace(stack, thicknesses_um=layers)
        aperture = float(lenslet_aperture(relief.pitch.um, focused.behind_um))
        depth_um = float(depth_of_focus_um(REFERENCE_NM * 1e-3, aperture))
        return summary | {
            "best_thickness_mm": rounded(best_um * 1e-3),
            "aperture": rounded(aperture),
            "depth_of_focus_mm": rounded(depth_um * 1e-3),
            "depth_of_focus_in_layer_mm": rounded(float(stack.indices[surface]) * depth_um * 1e-3),
        }

    def _psf(self) -> dict[str, Any]:
        """Figures and curves of the PSF; none where it has no lines."""
        figures, empty = self.figures, list[float]()
        if isinstance(figures, str):
            return {
                "fwhm_um": None,
                "line_width_um": None,
                "contrast": None,
                "autocorrelation": {"um": empty, "value": empty},
                "magnitude": {"per_mm": empty, "value": empty},
            }
        summary: dict[str, Any] = rounded(
            {
                "fwhm_um": figures.fwhm_um,
                "line_width_um": figures.line_width_um,
                "contrast": figures.contrast,
                "autocorrelation": {"um": figures.lag_um, "value": figures.autocorrelation},
                "magnitude": {"per_mm": figures.per_mm, "value": figures.magnitude},
            }
        )
        return summary


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
