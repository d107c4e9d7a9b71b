"""What `nolens fabricate` makes, and its figures."""

import math
from dataclasses import asdict, dataclass
from typing import Any

from nolens.camera import OpenCamera
from nolens.fabricate import (
    FrameGeometry,
    Levels,
    MadeSurface,
    MouldAmount,
    ResinAmount,
    Solid,
    poured_layer,
    shading_angle_deg,
)
from nolens.jobs.fabrication.options import FabricateOptions
from nolens.optics import Relief


@dataclass(frozen=True)
class Workpieces:
    """What the workshop gets, in memory.

    Parameters
    ----------
    frame, resin, mould
        Measures and amounts.
    solid
        The frame, as large as it is printed.
    mask
        The surface that is written, at the pitch of its files.
    levels
        The same in steps.
    thinned
        The same with fewer points, for the STL.
    relief
        The STL's solid.
    """

    frame: FrameGeometry
    resin: ResinAmount
    mould: MouldAmount
    solid: Solid
    mask: MadeSurface
    levels: Levels
    thinned: MadeSurface
    relief: Solid


def figures(
    options: FabricateOptions, opened: OpenCamera, pieces: Workpieces, relief: Relief
) -> dict[str, Any]:
    """All computed figures, in values that JSON has.

    Parameters
    ----------
    options
        What was asked for.
    opened
        The camera.
    pieces
        What was made of it.
    relief
        On the camera.
    """
    frame, resin, mould = pieces.frame, pieces.resin, pieces.mould
    angle = shading_angle_deg(opened.camera, frame)
    made_of = opened.camera.material_of(poured_layer(opened.camera))
    low, high = pieces.mask.range_um
    return {
        "frame": {
            **asdict(frame),
            "outer_mm": _rounded(frame.outer_width_mm, frame.outer_height_mm, frame.height_mm),
            "inner_mm": _rounded(frame.inner_width_mm, frame.inner_height_mm),
            "volume_mm3": round(frame.volume_mm3, 4),
            "solid_mm3": round(pieces.solid.volume_mm3, 4),
            "printed_larger": round(1 / (1 - options.printer_shrinkage.value), 6),
            "shading_angle_deg": None if angle is None else round(angle, 2),
        },
        "resin": {
            "material": None if made_of is None else made_of.name,
            "cavity_mm3": round(resin.cavity_mm3, 4),
            "cavity_mg": None if resin.cavity_mg is None else round(resin.cavity_mg, 3),
            "overflow_mm3": round(resin.overflow_mm3, 4),
            "meniscus_mm3": round(resin.meniscus_mm3, 4),
            "shrinkage": resin.shrinkage,
            "pour_mm3": round(resin.pour_mm3, 4),
            "mass_mg": None if resin.mass_mg is None else round(resin.mass_mg, 3),
            "density_g_cm3": resin.density_g_cm3,
            "relief_mm3": _relief_mm3(relief),
            "thinnest_layer_mm": round(frame.layer_mm * (1 - resin.shrinkage), 4),
        },
        "mould": {
            "dish_mm": _rounded(*mould.dish_mm),
            "thickness_mm": mould.thickness_mm,
            "ratio": mould.ratio,
            "mass_g": round(mould.mass_g, 3),
            "base_g": round(mould.base_g, 3),
            "hardener_g": round(mould.hardener_g, 3),
        },
        "mask": {
            "surface": pieces.mask.name,
            "about": pieces.mask.words,
            "points": list(pieces.mask.height_um.shape),
            "pitch_um": pieces.mask.pitch_um,
            "size_mm": _rounded(*pieces.mask.size_mm),
            "heights_um": [low, high],
            "levels": pieces.levels.count,
            "step_um": pieces.levels.step_um,
            "rms_error_um": pieces.mask.rms_error_um,
        },
        "relief": {
            "triangles": len(pieces.relief.triangles),
            "points": list(pieces.thinned.height_um.shape),
            "pitch_um": pieces.thinned.pitch_um,
            "rms_error_um": pieces.thinned.rms_error_um,
            "largest_error_um": pieces.thinned.largest_error_um,
            "base_mm": options.base.mm,
            "solid_mm3": round(pieces.relief.volume_mm3, 4),
        },
    }


def _rounded(*lengths_mm: float) -> list[float]:
    return [round(length, 4) for length in lengths_mm]


def _relief_mm3(relief: Relief) -> float:
    """What the relief adds to the resin: its mean height over its area."""
    area_mm2 = math.prod(relief.extent_um) * 1e-6
    return round(float(relief.height_um.double().mean()) * 1e-3 * area_mm2, 4)
