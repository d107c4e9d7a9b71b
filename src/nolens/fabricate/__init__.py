"""Files for the workshop, in memory: solids, layouts, height maps and the process sheet."""

from nolens.fabricate.crown import Wetting
from nolens.fabricate.frame import FrameGeometry
from nolens.fabricate.frame_limits import Printer
from nolens.fabricate.levels import Levels
from nolens.fabricate.process import ToleranceBudget, ToleranceLine
from nolens.fabricate.relief_solid import decimated, relief_solid
from nolens.fabricate.resin import MouldAmount, ResinAmount
from nolens.fabricate.shading import shading_angle_deg
from nolens.fabricate.sheet import process_sheet
from nolens.fabricate.sheet_parts import Sheet
from nolens.fabricate.solid import Solid, frame_solid
from nolens.fabricate.surface import MadeSurface, SurfaceName, made_surface

__all__ = [
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
    "ToleranceLine",
    "Wetting",
    "decimated",
    "frame_solid",
    "made_surface",
    "process_sheet",
    "relief_solid",
    "shading_angle_deg",
]
