"""All that the process sheet is computed from, and how its figures are written."""

from dataclasses import dataclass

from nolens.camera import Camera
from nolens.fabricate.drawing import millimetres
from nolens.fabricate.frame import FrameGeometry
from nolens.fabricate.process import Process, ToleranceBudget
from nolens.fabricate.resin import MouldAmount, ResinAmount
from nolens.fabricate.sheet_focus import Lines


@dataclass(frozen=True)
class Work:
    """All that the sheet is computed from.

    Parameters
    ----------
    camera, frame, resin, mould, process, budget
        What is made, of what, how, and how exactly.
    resin_name
        What the resin is called.
    lines
        Expected widths of the PSF's lines for some thicknesses, the wanted one in the middle;
        none where they could not be computed.
    no_lines
        Why not.
    """

    camera: Camera
    frame: FrameGeometry
    resin: ResinAmount
    mould: MouldAmount
    process: Process
    budget: ToleranceBudget
    resin_name: str
    lines: tuple[Lines, ...]
    no_lines: str

    @property
    def allowed(self) -> str:
        """What is allowed of every height, such as ``" ± 0.20 mm"``."""
        if self.budget.layer_mm is None:
            return " mm"
        return f" ± {self.budget.layer_mm:.2f} mm"

    @property
    def layer(self) -> str:
        """Thickness of the resin, such as ``"1.06"``."""
        return millimetres(self.frame.layer_mm)

    @property
    def height(self) -> str:
        """Height of the frame over the board."""
        return millimetres(self.frame.height_mm)

    @property
    def glass_top(self) -> str:
        """Height of the cover glass over the board."""
        return millimetres(self.frame.glass_top_mm)

    @property
    def base_g(self) -> float:
        """Base to weigh in, with what stays in the cup."""
        return self.mould.base_g * (1 + self.process.surplus)

    @property
    def hardener_g(self) -> float:
        """Hardener to weigh in."""
        return self.mould.hardener_g * (1 + self.process.surplus)

    @property
    def pour(self) -> str:
        """Resin for one camera, by volume and, where it is known, by mass."""
        volume = f"{self.resin.pour_mm3:.1f} µl"
        return volume if self.resin.mass_mg is None else f"{volume} = {self.resin.mass_mg:.0f} mg"


def size(width_mm: float, height_mm: float) -> str:
    """Write a width and a height, such as ``"12.98 × 11.15 mm"``."""
    return f"{millimetres(width_mm)} × {millimetres(height_mm)} mm"
