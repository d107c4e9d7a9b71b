"""Files for the workshop, in memory: solids, layouts, height maps and the process sheet."""

from nolens.fabricate.focus import ToleranceBudget
from nolens.fabricate.frame import FrameGeometry, Printer, poured_layer, shading_angle_deg
from nolens.fabricate.resin import MouldAmount, ResinAmount, Wetting
from nolens.fabricate.sheet import process_sheet
from nolens.fabricate.sheet_parts import Sheet
from nolens.fabricate.solid import Solid, decimated, frame_solid, relief_solid
from nolens.fabricate.surface import MOST_LEVELS, Levels, MadeSurface, SurfaceName, made_surface
from nolens.fabricate.workpieces import Workpieces

__all__ = [
    "MOST_LEVELS",
    "FrameGeometry",
    "Levels",
    "MadeSurface",
    "MouldAmount",
    "Printer",
    "ResinAmount",
    "Sheet",
    "Solid",
    "SurfaceName",
    "ToleranceBudget",
    "Wetting",
    "Workpieces",
    "decimated",
    "frame_solid",
    "made_surface",
    "poured_layer",
    "process_sheet",
    "relief_solid",
    "shading_angle_deg",
]
