"""Safety, sources and placeholders of the process sheet."""

from collections.abc import Iterator

from nolens.camera import SpectralCurve
from nolens.fabricate.crown import Wetting
from nolens.fabricate.poured import poured_layer
from nolens.fabricate.sheet_parts import Section, Text
from nolens.fabricate.sheet_work import Work

_PLACEHOLDER = "placeholder"


def safety_section() -> Section:
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


def source_section(work: Work) -> Section:
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
    for what, source in _sources(work):
        if source is not None and _PLACEHOLDER in source:
            yield what if source.startswith(_PLACEHOLDER) else f"{what} (in part)"


def _sources(work: Work) -> Iterator[tuple[str, str | None]]:
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
