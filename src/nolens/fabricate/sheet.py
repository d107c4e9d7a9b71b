"""The process sheet: what the maker of a camera does, step by step, with this camera's figures."""

from collections.abc import Iterator

from nolens.amounts import amount
from nolens.camera import LoadedCamera, SpectralCurve
from nolens.errors import NolensError
from nolens.fabricate.focus import Lines, ToleranceBudget, expected_lines, ray_budget
from nolens.fabricate.frame import FrameGeometry, poured_layer
from nolens.fabricate.resin import MouldAmount, ResinAmount, Wetting
from nolens.fabricate.sheet_drawings import draw_section, draw_top, material_name
from nolens.fabricate.sheet_parts import Blank, Blanks, Figure, Section, Sheet, Table, Text
from nolens.fabricate.sheet_steps import Process, Work, size, step_sections

_FILES = (
    ("frame.stl, frame.3mf", "the frame, for the printer; in mm"),
    ("mask.tif", "heights of the relief, 16 bit, for grey-scale or two-photon lithography"),
    ("mask.gds, mask.oas", "the same as levels, for lithography with several masks"),
)
"""Files that are written beside the sheet, and what for; each says which surface it holds."""
_CORNERS = 4
_ALIKE = "Cameras that are to share one PSF need the same t′ far more exactly (paper)."
_PLACEHOLDER = "placeholder"


def process_sheet(
    loaded: LoadedCamera,
    frame: FrameGeometry,
    resin: ResinAmount,
    mould: MouldAmount,
    tolerances: ToleranceBudget | None = None,
    *,
    relief_file: str = "relief-master.stl",
) -> Sheet:
    """Write the process sheet of a camera whose mask is moulded onto its sensor.

    The process is the paper's (`uvimprint`, section II); amounts, heights, tolerances and the
    width of the lines are computed for this camera.

    Parameters
    ----------
    loaded
        The camera.
    frame
        The frame around its sensor.
    resin, mould
        What is poured and mixed.
    tolerances
        The budget; None takes a first one from rays (`ray_budget`).
    relief_file
        Name of the file that holds the relief as a solid.

    Raises
    ------
    OptionError
        If the camera's mask is not poured onto its glass, the frame is too large for the sheet,
        or an index is not known at 550 nm.
    """
    camera = loaded.camera
    budget = tolerances or ray_budget(camera)
    lines, no_lines = _lines(loaded, budget)
    poured = poured_layer(camera)
    work = Work(
        camera=camera,
        frame=frame,
        resin=resin,
        mould=mould,
        process=Process.of(poured.material),
        budget=budget,
        resin_name=material_name(poured),
        lines=lines,
        no_lines=no_lines,
    )
    sections = [
        _aim(work),
        _safety(),
        _materials(work, relief_file),
        *step_sections(work),
        _record(work),
        _budget(work),
        _source_notes(work),
    ]
    return Sheet(
        title=f"Process sheet: camera “{camera.name}”",
        subtitle=(
            f"A mask of {work.resin_name}, {work.layer} mm thick, moulded onto the sensor "
            f"{camera.sensor.name}"
        ),
        sections=tuple(
            Section(f"{number}  {section.title}", section.blocks)
            for number, section in enumerate(sections, 1)
        ),
    )


def _lines(loaded: LoadedCamera, budget: ToleranceBudget) -> tuple[tuple[Lines, ...], str]:
    """Expected widths at the camera's thickness and, where they are known, at its limits."""
    nominal = poured_layer(loaded.camera).thickness.mm
    limits: tuple[float, ...] = (nominal,)
    if budget.layer_mm is not None:
        thinnest = max(nominal - budget.layer_mm, nominal / 2)
        limits = (round(thinnest, 2), nominal, round(nominal + budget.layer_mm, 2))
    try:
        return expected_lines(loaded, limits), ""
    except NolensError as error:
        return (), str(error)


def _aim(work: Work) -> Section:
    who = Blank("made by"), Blank("date"), Blank("batch")
    return Section(
        "What you make",
        (
            Blanks(who),
            Figure(
                draw_section(work.camera, work.frame, work.mould),
                "The relief on top of the resin is too low to be drawn. Measure the bar: if it is "
                "not 10 mm long, the printer changed the scale (print at 100 %).",
            ),
            Figure(
                draw_top(work.camera, work.frame),
                "The cut corner of the frame stands at pixel (0, 0); the mould carries the same "
                "mark on its back.",
            ),
        ),
    )


def _materials(work: Work, relief_file: str) -> Section:
    resin, mould = work.resin, work.mould
    frame = work.frame
    package = (
        f"{size(frame.package_width_mm, frame.package_height_mm)}, the glass's top at "
        f"{work.glass_top} mm"
    )
    surplus = f"{100 * work.process.surplus:g} %"
    amounts = (
        (
            "PDMS, base (Sylgard 184)",
            f"{work.base_g:.2f} g",
            f"mould of {mould.base_g:.2f} g + {surplus}",
        ),
        (
            "PDMS, hardener",
            f"{work.hardener_g:.2f} g",
            f"mould of {mould.hardener_g:.2f} g + {surplus}",
        ),
        (f"resin: {work.resin_name}", work.pour, _pour_note(work)),
        ("sensor on its board", "1", f"{work.camera.sensor.name}; check its package: {package}"),
        ("master mask", "1", "relief as in the files, or the diffuser that they model"),
    )
    solid = "the relief as a solid, for a printer that is fine enough"
    files = (*_FILES, (relief_file, solid))
    tools = (
        "Balance (0.001 g for the resin, 0.01 g for PDMS), dish, cups, syringe, vacuum "
        f"chamber, oven ({work.process.bake_temperature_c:g} °C), ultraviolet lamp, height gauge "
        "or micrometer (0.01 mm), printer, white LED with a pinhole."
    )
    if work.process.cure.temperature_c is not None:
        tools = tools.replace(" ultraviolet lamp,", "")
    return Section(
        "Materials, files, tools",
        (
            Table(
                "Amounts for one camera",
                ("what", "amount", "how it comes about"),
                (0.3, 0.27, 0.43),
                amounts,
            ),
            *(Text(note[0].upper() + note[1:] + ".", "warning") for note in resin.notes),
            Table("Files", ("file", "what for"), (0.3, 0.7), files),
            Text(f"Tools: {tools}"),
        ),
    )


def _pour_note(work: Work) -> str:
    resin = work.resin
    text = (
        f"cavity {resin.cavity_mm3:.1f} µl, rim and vents {resin.overflow_mm3:.1f} µl; "
        f"{100 * resin.shrinkage:.3g} % shrinkage; crown {resin.meniscus_mm3:.1f} µl"
    )
    if resin.cavity_mg is not None:
        text += (
            f"; cured, the cavity holds {resin.cavity_mg:.1f} mg at {resin.density_g_cm3:g} g/cm³"
        )
    return text


def _record(work: Work) -> Section:
    height = f"{work.height}{work.allowed}"
    heads = "what", "target", *(f"corner {number}" for number in range(1, _CORNERS + 1))
    four: tuple[str | Blank, ...] = tuple(Blank(unit="mm") for _ in range(_CORNERS))
    rows: tuple[tuple[str | Blank, ...], ...] = (
        ("1  height of the frame", height, *four),
        ("2  wall's top over the glass", f"{work.layer}{work.allowed}", *four),
        ("3  height when cured", height, *four),
        (f"4  t′ = row 3 − {work.glass_top} mm", f"{work.layer}{work.allowed}", *four),
    )
    return Section(
        "Record of what was measured",
        (
            Text(
                "Corner 1 is the one with the mark; go on clockwise, seen from the scene.", "note"
            ),
            Table("Heights", heads, (0.26, 0.18, 0.14, 0.14, 0.14, 0.14), rows),
            Blanks((Blank("remarks"),)),
        ),
    )


def _budget(work: Work) -> Section:
    budget = work.budget
    method = Text(f"{budget.method} {_ALIKE}", "note" if budget.lines else "warning")
    if not budget.lines:
        return Section("Tolerance budget", (method,))
    rows = tuple(
        (
            line.parameter,
            amount(line.nominal, line.unit, digits=4),
            f"± {amount(line.allowed, line.unit, digits=2)}",
            line.effect,
        )
        for line in budget.lines
    )
    heads = "parameter", "target", "allowed", "effect"
    table = Table("How far off each may be", heads, (0.3, 0.2, 0.2, 0.3), rows)
    return Section("Tolerance budget", (table, method))


def _safety() -> Section:
    """What the maker must heed; general advice."""
    return Section(
        "Safety",
        (
            Text(
                "Ultraviolet light: goggles against it, skin covered, a closed chamber. Liquid "
                "resin: nitrile gloves and goggles; acrylates make allergic. Air the room. Oven: "
                "hot. Vacuum: a shield in front of glass. Cured waste to the rubbish, liquid "
                "resin never down the drain. The safety data sheets of your materials come before "
                "this sheet (advice).",
                "warning",
            ),
        ),
    )


def _source_notes(work: Work) -> Section:
    """Where instructions and figures come from, and which of them are placeholders."""
    texts = [
        Text(
            "Behind each step: paper = as in Fabrication of Integrated Lensless Cameras via "
            "UV-Imprint Lithography, section II (uvimprint); advice = general practice of the "
            "workshop, not from the paper; computed = from this camera's description; data sheet "
            "= what the maker of the material says. Figures in large letters are this camera's, "
            "but for those of baking and curing.",
            "note",
        ),
        Text(f"Mould: {work.process.source}. Curing: {_cure_source(work)}.", "note"),
    ]
    placeholders = list(_placeholders(work))
    if placeholders:
        texts.append(
            Text(
                f"Placeholders, to be replaced by what you measure: {'; '.join(placeholders)}. "
                "Their reasons: nolens camera show, nolens material show.",
                "note",
            )
        )
    return Section("Sources", tuple(texts))


def _cure_source(work: Work) -> str:
    source = work.process.cure.source
    if source is None:
        return f"no public figures are known to nolens for {work.resin_name}"
    return source


def _placeholders(work: Work) -> Iterator[str]:
    for what, source in _figure_sources(work):
        if source is not None and _PLACEHOLDER in source:
            yield what if source.startswith(_PLACEHOLDER) else f"{what} (in part)"


def _figure_sources(work: Work) -> Iterator[tuple[str, str | None]]:
    """What the sheet's figures rest on, and where that comes from."""
    camera, frame = work.camera, work.frame
    package = camera.sensor.package
    own = frame.package_width_mm, frame.package_height_mm, frame.glass_top_mm
    if package is not None and own == tuple(
        length.mm for length in (package.width, package.height, package.glass_top)
    ):
        yield "package of the sensor", package.source
    poured = poured_layer(camera)
    for layer in camera.layers:
        made_of = camera.material_of(layer)
        if made_of is not None:
            yield f"index of {made_of.name}", made_of.source
            if layer == poured:
                yield f"density of {made_of.name}", made_of.density_source
                yield f"shrinkage of {made_of.name}", made_of.cure_shrinkage_source
    if work.resin.meniscus_mm3 > 0:
        yield "crown of the resin", Wetting().source
    if work.lines and isinstance(camera.sensor.quantum_efficiency, SpectralCurve):
        yield "colours of the sensor", camera.sensor.quantum_efficiency.source
