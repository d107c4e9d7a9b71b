"""What the tests of the process sheet share: cameras, sheets, and all words of a sheet."""

from collections.abc import Iterator
from dataclasses import replace

from nolens.camera import Camera, LoadedCamera, preset
from nolens.fabricate import FrameGeometry, MouldAmount, ResinAmount, ToleranceBudget
from nolens.fabricate.focus import Lines
from nolens.fabricate.sheet import process_sheet
from nolens.fabricate.sheet_parts import Blank, Blanks, Figure, Sheet, Steps, Table, Text
from nolens.quantities import Length

LINES = (Lines(0.9, 21.0), Lines(1.0, 20.0), Lines(1.1, 19.0))
"""Stand in for the simulated ones, which take seconds."""


def camera_of(*, thickness_mm: float | None = None, material: str | None = None) -> Camera:
    """The paper's camera with another layer of resin."""
    camera = preset("paper")
    resin, *others = camera.layers
    if thickness_mm is not None:
        resin = resin.model_copy(update={"thickness": Length.of(thickness_mm, "mm")})
    if material is not None:
        resin = resin.model_copy(update={"material": material})
    return camera.model_copy(update={"layers": (resin, *others)})


def changed(camera: Camera, **relief: str) -> Camera:
    """The camera with other lengths of its lenslets, as text."""
    lengths = {name: Length.parse(text) for name, text in relief.items()}
    mask = camera.mask.model_copy(
        update={"relief": camera.mask.relief.model_copy(update=lengths)}
    )  # fmt: skip
    return camera.model_copy(update={"mask": mask})


def sheet_of(camera: Camera, tolerances: ToleranceBudget | None = None, **frame: float) -> Sheet:
    """The sheet of a camera, with a frame of other measures if any are given."""
    made = replace(FrameGeometry.of(camera), **frame)
    return process_sheet(
        LoadedCamera.of(camera),
        made,
        ResinAmount.of(camera, made),
        MouldAmount.of(made),
        tolerances,
    )


def words_of(sheet: Sheet) -> str:
    """All words of a sheet but those of its drawings, one a line."""
    return "\n".join(_words(sheet))


def _words(sheet: Sheet) -> Iterator[str]:
    yield sheet.title
    yield sheet.subtitle
    for section in sheet.sections:
        yield section.title
        for block in section.blocks:
            if isinstance(block, Text):
                yield block.text
            elif isinstance(block, Blanks):
                yield from map(_blank, block.blanks)
            elif isinstance(block, Figure):
                yield block.drawing.title
                yield block.caption
            elif isinstance(block, Steps):
                for step in block.steps:
                    yield from (step.text, step.amount, step.origin)
                    yield from map(_blank, step.blanks)
            else:
                assert isinstance(block, Table)
                yield block.caption
                yield from block.columns
                for row in block.rows:
                    yield from (cell if isinstance(cell, str) else _blank(cell) for cell in row)


def _blank(blank: Blank) -> str:
    return f"{blank.label} {blank.unit}"
