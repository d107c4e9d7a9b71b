"""Drawings to scale on a page of a PDF."""

from pathlib import Path

from matplotlib import get_data_path
from reportlab.lib.colors import HexColor
from reportlab.lib.units import mm
from reportlab.pdfbase import pdfmetrics
from reportlab.pdfbase.ttfonts import TTFont
from reportlab.platypus import Flowable

from nolens.fabricate.drawing import INK, TONES, Drawing, Line, Shape, Word

REGULAR, BOLD = "DejaVuSans", "DejaVuSans-Bold"
"""Fonts that have every sign of a sheet; they come with matplotlib."""


def register_fonts() -> None:
    """Make the fonts known to reportlab; they are embedded in what uses them."""
    known = pdfmetrics.getRegisteredFontNames()
    for name in (REGULAR, BOLD):
        if name not in known:
            path = Path(get_data_path()) / "fonts" / "ttf" / f"{name}.ttf"
            pdfmetrics.registerFont(TTFont(name, path))


class Picture(Flowable):  # type: ignore[misc]
    """A drawing in true millimetres.

    Parameters
    ----------
    drawing
        The drawing.
    """

    def __init__(self, drawing: Drawing) -> None:
        super().__init__()
        self.drawing = drawing
        self.width, self.height = drawing.width_mm * mm, drawing.height_mm * mm

    def draw(self) -> None:
        """Draw all shapes, in their order."""
        self.canv.setStrokeColor(HexColor(INK))
        self.canv.setLineJoin(1)
        for shape in self.drawing.shapes:
            self._shape(shape)

    def _at(self, place: tuple[float, float]) -> tuple[float, float]:
        return place[0] * mm, self.height - place[1] * mm

    def _shape(self, shape: Shape) -> None:
        canvas = self.canv
        if isinstance(shape, Word):
            canvas.setFont(BOLD if shape.bold else REGULAR, shape.size_mm * mm)
            canvas.setFillColor(HexColor(INK))
            write = {
                "start": canvas.drawString,
                "middle": canvas.drawCentredString,
                "end": canvas.drawRightString,
            }
            write[shape.anchor](*self._at(shape.at), shape.text)
            return
        canvas.setLineWidth(shape.weight_mm * mm)
        if isinstance(shape, Line):
            canvas.line(*self._at(shape.start), *self._at(shape.end))
            return
        canvas.setFillColor(HexColor(TONES[shape.tone]))
        path = canvas.beginPath()
        path.moveTo(*self._at(shape.points[0]))
        for corner in shape.points[1:]:
            path.lineTo(*self._at(corner))
        path.close()
        canvas.drawPath(path, stroke=1, fill=1)
