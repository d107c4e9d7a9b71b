"""The place of a PSF: centred, laid over the PSF of another distance, or as it was captured."""

import math
from dataclasses import dataclass, field
from typing import Any, Literal

import torch
from torch import Tensor

from nolens.calibrate.distances import Layers, with_mean_light
from nolens.calibrate.point_psf import DarkArea
from nolens.calibrate.registration import NEARBY, Shift, register
from nolens.camera import PsfEntry
from nolens.errors import DataError
from nolens.optics.magnification import covered, magnified
from nolens.progress import ProgressCallback
from nolens.quantities import Angle

_LEAST_ALIKE = 0.4
_LARGE_DEG, _LARGE_FRACTION = 2.0, 0.05
_OFF_PREDICTED = 0.2
"""Of M − 1: twins are predicted to 2 %, the paper's own figures are two thirds off."""
_AHEAD = (Angle("0", "deg"), Angle("0", "deg"))


@dataclass(frozen=True)
class ReferencePsf:
    """A PSF of the same camera and another distance, from straight ahead.

    Parameters
    ----------
    psf
        (channels, rows, columns).
    entry
        Its description.
    path
        Of its file, for messages.
    """

    psf: Tensor
    entry: PsfEntry
    path: str


@dataclass(frozen=True)
class PlacedPsf:
    """A PSF in its place.

    Parameters
    ----------
    psf
        (channels, rows, columns).
    frame
        What its middle follows.
    figures
        How its place was determined, in values that JSON has; lengths to the right and up.
    warnings
        What a person should know.
    """

    psf: Tensor
    frame: Literal["chief-ray", "sensor"]
    figures: dict[str, Any]
    warnings: list[str] = field(default_factory=list)


def place_psf(
    psf: Tensor,
    area: DarkArea | None,
    pixel_um: float,
    *,
    distance_um: float = math.inf,
    angle: tuple[Angle, Angle] = _AHEAD,
    layers: Layers | None = None,
    reference: ReferencePsf | None = None,
    progress: ProgressCallback | None = None,
) -> PlacedPsf:
    """Bring a PSF into its place.

    One from straight ahead is laid over that of another distance, if there is one; else its light
    is centred where an aperture leaves a dark area. Without one it stays where the sensor
    captured it, as does a PSF from the side.

    Parameters
    ----------
    psf
        As it was captured, (channels, rows, columns).
    area
        Where an aperture leaves no light of it; None if it fills the sensor.
    pixel_um
        Pitch of its pixels.
    distance_um, angle
        Of the point source; the angle to the right and up.
    layers
        The camera's, if they are known.
    reference
        The PSF that it is laid over.
    progress
        Called with the fraction that is done.

    Raises
    ------
    DataError
        If the reference is not of the same camera.
    """
    if any(each.deg != 0 for each in angle):
        return _as_captured(psf, area, angle, layers, pixel_um)
    if reference is not None:
        return _on_reference(psf, distance_um, layers, pixel_um, reference, progress)
    if area is not None:
        shift = centroid(psf, area.on_pixels(*psf.shape[-2:]))
        return _centred(psf, shift, {"centred_by": "centroid"}, layers, pixel_um)
    return PlacedPsf(psf, "chief-ray", {"centred_by": "stated angle", "shift_um": [0.0, 0.0]})


def centroid(psf: Tensor, dark: Tensor) -> Shift:
    """Centre of the light outside the dark area, (row, column) in pixels from the middle."""
    light = psf.double().clamp_min(0).sum(dim=0) * ~dark
    light = light / light.sum()
    places = [torch.arange(n, dtype=torch.float64) - (n - 1) / 2 for n in light.shape]
    return float(light.sum(dim=1) @ places[0]), float(light.sum(dim=0) @ places[1])


def _on_reference(
    psf: Tensor,
    distance_um: float,
    layers: Layers | None,
    pixel_um: float,
    reference: ReferencePsf,
    progress: ProgressCallback | None,
) -> PlacedPsf:
    """The PSF where it lies on that of another distance; checked against what the layers say."""
    entry, expected = reference.entry, None
    if layers is not None:
        expected = layers.magnification(distance_um) / layers.magnification(entry.distance_um)
    result = register(psf, reference.psf, magnification=expected or NEARBY, progress=progress)
    if result.correlation < _LEAST_ALIKE:
        raise DataError(
            f"the PSF is not that of {reference.path} in another size: their correlation is "
            f"{result.correlation:.2f}, and less than {_LEAST_ALIKE:g} means another camera, "
            "another mask or a wrong distance. Give another folder (-o), or calibrate "
            f"{entry.distance} again"
        )
    figures = {
        "centred_by": entry.file,
        "correlation": round(result.correlation, 5),
        "magnification": round(result.magnification, 6),
        "expected_magnification": None if expected is None else round(expected, 6),
    }
    placed = _centred(psf, result.shift, figures, layers, pixel_um)
    if expected is not None:
        off = abs(result.magnification - expected)
        half = min(psf.shape[-2:]) / 2
        if off > _OFF_PREDICTED * abs(expected - 1) and off * half > 0.5:
            placed.warnings.append(
                f"the PSF is {result.magnification:.4f} times as large as that of "
                f"{entry.distance}, and the layers say {expected:.4f}: check both distances and "
                "the layers of the camera"
            )
    return placed


def _centred(
    psf: Tensor, shift: Shift, figures: dict[str, Any], layers: Layers | None, pixel_um: float
) -> PlacedPsf:
    """The PSF whose light lies `shift` beside the middle, moved back into it.

    What moves in from beyond its edges has the mean light around it.
    """
    back = (-shift[0], -shift[1])
    known = covered((psf.shape[-2], psf.shape[-1]), 1.0, moved=back)
    psf = with_mean_light(magnified(psf, 1.0, moved=back), known)
    figures["shift_um"] = [_rounded(shift[1] * pixel_um), _rounded(-shift[0] * pixel_um)]
    placed = PlacedPsf(psf, "chief-ray", figures)
    size = math.hypot(*shift)
    if layers is None:
        far, text = size > _LARGE_FRACTION * min(psf.shape[-2:]), ""
    else:
        angle = math.degrees(math.atan(size * pixel_um / layers.reduced_um))
        far, text = angle > _LARGE_DEG, f", as of a light {angle:.1f}° off the axis"
    if far:
        placed.warnings.append(
            f"the PSF lies {size * pixel_um:.0f} µm beside the middle{text}, and was moved "
            "there: if the light was not meant to be straight ahead, say where it was (--angle)"
        )
    return placed


def _as_captured(
    psf: Tensor,
    area: DarkArea | None,
    angle: tuple[Angle, Angle],
    layers: Layers | None,
    pixel_um: float,
) -> PlacedPsf:
    """The PSF where the sensor captured it; checked against Snell's law."""
    figures: dict[str, Any] = {"centred_by": "stated angle"}
    placed = PlacedPsf(psf, "sensor", figures)
    if layers is None:
        return placed
    expected = layers.shift_um(angle)
    figures["expected_shift_um"] = [_rounded(each) for each in expected]
    if area is None:
        return placed
    row, column = centroid(psf, area.on_pixels(*psf.shape[-2:]))
    measured = column * pixel_um, -row * pixel_um
    figures["shift_um"] = [_rounded(each) for each in measured]
    off = math.degrees(math.atan(math.dist(measured, expected) / layers.reduced_um))
    if off > _LARGE_DEG:
        placed.warnings.append(
            f"the PSF lies {measured[0]:z.0f} µm to the right and {measured[1]:z.0f} µm up of the "
            f"middle, and by Snell's law an angle of {angle[0]}, {angle[1]} "
            f"puts it at {expected[0]:.0f} and {expected[1]:.0f}: about {off:.1f}° off. "
            "Check the angle, and that the whole PSF is on the sensor"
        )
    return placed


def _rounded(value: float) -> float:
    """To a thousandth, without a minus before zero."""
    return round(value, 3) + 0.0
