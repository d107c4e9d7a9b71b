"""Where a captured PSF belongs: in the middle, over those of other distances, or as it was seen."""

import math
from dataclasses import dataclass, field
from typing import Any, Literal

from torch import Tensor

from nolens.calibrate.distances import Layers, with_mean_light
from nolens.calibrate.magnify import covered, magnified
from nolens.calibrate.point import PointPsf, centroid
from nolens.calibrate.point_register import NEARBY, register
from nolens.camera import PsfEntry, PsfSet
from nolens.errors import DataError
from nolens.files import read_psf
from nolens.jobs.calibration.point_options import CalibratePointOptions

_LEAST_ALIKE = 0.4
_LARGE_DEG, _LARGE_SHARE = 2.0, 0.05
_OFF_PREDICTED = 0.2
"""Of M − 1: twins are predicted to 2 %, the paper's own figures are two thirds off."""


@dataclass(frozen=True)
class Placed:
    """A PSF in its place.

    Parameters
    ----------
    psf
        (channels, rows, columns).
    frame
        What its middle follows.
    figures
        How it was found, in values that JSON has.
    warnings
        What a person should know.
    """

    psf: Tensor
    frame: Literal["chief-ray", "sensor"]
    figures: dict[str, Any]
    warnings: list[str] = field(default_factory=list)


def placed(
    found: PointPsf,
    options: CalibratePointOptions,
    layers: Layers | None,
    psfs: PsfSet | None,
    cell_um: float,
) -> Placed:
    """Bring a PSF into its place.

    One from straight ahead is laid over that of the nearest other distance in the folder, or
    else, where an aperture leaves a dark area, its light is centred; without one it stays where
    the sensor saw it. One from the side stays there as well, and one that is taken as it is.

    Parameters
    ----------
    found
        The PSF as it was captured.
    options
        They say where the light was.
    layers
        The camera's, if they are known.
    psfs
        What the folder has.
    cell_um
        Distance of the cells.

    Raises
    ------
    DataError
        If the folder's PSFs are not of the same camera.
    """
    reference = _reference(options, psfs)
    other = None if reference is None else read_psf(options.output, reference)
    if reference is not None and other is not None and other.shape != found.psf.shape:
        raise DataError(
            f"the PSF {options.output / reference.file} has {other.shape[-2]}×{other.shape[-1]} "
            f"cells, but these frames {found.psf.shape[-2]}×{found.psf.shape[-1]}: they are of "
            "another camera or setting. Give another folder (-o)"
        )
    if options.as_is:
        return Placed(found.psf, "chief-ray", {"centred_by": "its file", "shift_um": [0.0, 0.0]})
    on_axis = all(each.deg == 0 for each in options.angle)
    if not on_axis:
        return _as_seen(found, options, layers, cell_um)
    if reference is not None and other is not None and _of_other_distance(reference, options):
        return _laid_over(found, options, layers, cell_um, reference, other)
    if found.area is not None:
        dark = found.area.on_cells(*found.psf.shape[-2:])
        shift = centroid(found.psf, dark)
        return _moved(found, shift, {"centred_by": "centroid"}, layers, cell_um)
    return Placed(found.psf, "chief-ray", {"centred_by": "stated angle", "shift_um": [0.0, 0.0]})


def _reference(options: CalibratePointOptions, psfs: PsfSet | None) -> PsfEntry | None:
    """A captured PSF to compare with: of the nearest other distance, straight ahead if any is."""
    captured = [each for each in (psfs.psf if psfs else ()) if each.kind == "captured"]
    if not captured:
        return None
    here = _diopters(_um(options))
    return min(
        captured,
        key=lambda each: (
            not (each.on_axis and _of_other_distance(each, options)),
            abs(_diopters(each.distance_um) - here),
        ),
    )


def _of_other_distance(entry: PsfEntry, options: CalibratePointOptions) -> bool:
    return entry.on_axis and entry.frame == "chief-ray" and entry.distance != options.distance


def _laid_over(
    found: PointPsf,
    options: CalibratePointOptions,
    layers: Layers | None,
    cell_um: float,
    entry: PsfEntry,
    other: Tensor,
) -> Placed:
    expected = None
    if layers is not None:
        here, there = layers.magnification(_um(options)), layers.magnification(entry.distance_um)
        expected = here / there
    laid = register(found.psf, other, magnification=expected or NEARBY)
    if laid.correlation < _LEAST_ALIKE:
        raise DataError(
            f"the pattern is not that of {options.output / entry.file} in another size: their "
            f"correlation is {laid.correlation:.2f}, and less than {_LEAST_ALIKE:g} means another "
            "camera, another mask or a wrong distance. Give another folder (-o), or calibrate "
            f"{entry.distance} again"
        )
    figures: dict[str, Any] = {
        "centred_by": entry.file,
        "correlation": round(laid.correlation, 5),
        "magnification": round(laid.magnification, 6),
        "expected_magnification": None if expected is None else round(expected, 6),
    }
    place = _moved(found, laid.shift, figures, layers, cell_um)
    if expected is not None:
        off = abs(laid.magnification - expected)
        half = min(found.psf.shape[-2:]) / 2
        if off > _OFF_PREDICTED * abs(expected - 1) and off * half > 0.5:
            place.warnings.append(
                f"the pattern is {laid.magnification:.4f} times as large as that of "
                f"{entry.distance}, and the layers say {expected:.4f}: check both distances and "
                "the layers of the camera"
            )
    return place


def _moved(
    found: PointPsf,
    shift: tuple[float, float],
    figures: dict[str, Any],
    layers: Layers | None,
    cell_um: float,
) -> Placed:
    """The PSF with its light, which lies beside the middle by so many cells, in the middle."""
    back = -shift[0], -shift[1]
    psf = magnified(found.psf, 1.0, moved=back)
    psf = with_mean_light(psf, covered((psf.shape[-2], psf.shape[-1]), 1.0, moved=back))
    figures["shift_um"] = [_rounded(shift[1] * cell_um), _rounded(-shift[0] * cell_um)]
    place = Placed(psf, "chief-ray", figures)
    size = math.hypot(*shift)
    if layers is None:
        far, text = size > _LARGE_SHARE * min(psf.shape[-2:]), ""
    else:
        reduced = layers.before.reduced_um + layers.after.reduced_um
        angle = math.degrees(math.atan(size * cell_um / reduced))
        far, text = angle > _LARGE_DEG, f", as of a light {angle:.1f}° off the axis"
    if far:
        place.warnings.append(
            f"the pattern lies {size * cell_um:.0f} µm beside the middle{text}, and was moved "
            "there: if the light was not meant to be straight ahead, say where it was (--angle)"
        )
    return place


def _as_seen(
    found: PointPsf, options: CalibratePointOptions, layers: Layers | None, cell_um: float
) -> Placed:
    figures: dict[str, Any] = {"centred_by": "stated angle"}
    place = Placed(found.psf, "sensor", figures)
    if layers is None:
        return place
    expected = layers.shift_um(options.angle)
    figures["expected_shift_um"] = [_rounded(each) for each in expected]
    if found.area is None:
        return place
    row, column = centroid(found.psf, found.area.on_cells(*found.psf.shape[-2:]))
    seen = column * cell_um, -row * cell_um
    figures["shift_um"] = [_rounded(each) for each in seen]
    reduced = layers.before.reduced_um + layers.after.reduced_um
    off = math.degrees(math.atan(math.dist(seen, expected) / reduced))
    if off > _LARGE_DEG:
        place.warnings.append(
            f"the pattern lies {seen[0]:z.0f} µm to the right and {seen[1]:z.0f} µm up of the "
            f"middle, and by Snell's law an angle of {options.angle[0]}, {options.angle[1]} "
            f"puts it at {expected[0]:.0f} and {expected[1]:.0f}: about {off:.1f}° off. "
            "Check the angle, and that the whole pattern is on the sensor"
        )
    return place


def _um(options: CalibratePointOptions) -> float:
    return math.inf if options.distance == "infinity" else options.distance.um


def _diopters(distance_um: float) -> float:
    return 1e6 / distance_um


def _rounded(value: float) -> float:
    return round(value, 3) + 0.0
