"""The steps of the process sheet, and the figures of the process that they need."""

from dataclasses import dataclass

from nolens.camera import Camera
from nolens.fabricate.focus import PINHOLE_UM, Lines, ToleranceBudget
from nolens.fabricate.frame import FrameGeometry
from nolens.fabricate.resin import MouldAmount, ResinAmount
from nolens.fabricate.sheet_parts import (
    Blank,
    Block,
    Section,
    Step,
    Steps,
    Table,
    Text,
    millimetres,
)

_PAPER = "the paper (uvimprint)"
_LAYERS_MM = tuple(number / 200 for number in range(5, 21))
"""From 0.025 to 0.1 mm."""
_EXACT_MM = 1e-6


@dataclass(frozen=True)
class _Cure:
    """How a poured resin becomes hard, by light or in an oven; None where no figure is public.

    `minutes` holds for an ultraviolet lamp of `lamp_w`, or at the oven's temperature.
    """

    source: str | None = None
    minutes: float | None = None
    lamp_w: float | None = None
    band_nm: tuple[float, float] | None = None
    dose_j_cm2: float | None = None
    temperature_c: float | None = None


@dataclass(frozen=True)
class Process:
    """Figures of the mould, which is baked, and of the curing.

    `surplus` is the fraction that is mixed, and drawn, beyond what is needed: it stays in the cup
    and the syringe. General advice.
    """

    cure: _Cure
    bake_temperature_c: float = 80.0
    bake_minutes: float = 60.0
    source: str = _PAPER
    surplus: float = 0.1

    @classmethod
    def of(cls, resin: str | None) -> "Process":
        """Figures for a resin by the name of its material (`nolens.camera.MATERIALS`).

        The paper's for its own resin and for PDMS (`uvimprint`, section II); for NOA 61 those
        that its maker gives for NOA 60, the wavelengths for all its adhesives (`norland60`);
        none for others, which the person at the bench fills in.
        """
        return cls(_CURES.get(resin or "", _Cure()))


@dataclass(frozen=True)
class Printing:
    """Thickness and number of a printed frame's layers, and how much higher than it they are."""

    layer_mm: float
    layers: int
    miss_mm: float

    @classmethod
    def of(cls, height_mm: float, *details_mm: float) -> "Printing":
        """Choose the thickest layers, up to 0.1 mm, of which a whole number makes the frame.

        Where none does, the nearest is chosen. The details' heights should be whole numbers of
        layers too, if some layer can make them so.
        """
        choices = []
        for layer_mm in _LAYERS_MM:
            layers = max(1, round(height_mm / layer_mm))
            printing = cls(layer_mm, layers, layers * layer_mm - height_mm)
            rough = [abs(each / layer_mm - round(each / layer_mm)) > 1e-6 for each in details_mm]
            miss = max(0.0, abs(printing.miss_mm) - _EXACT_MM)
            choices.append((miss, sum(rough), -layer_mm, printing))
        return min(choices, key=lambda each: each[:3])[3]


_HEAT = _Cure(source=_PAPER, minutes=Process.bake_minutes, temperature_c=Process.bake_temperature_c)
_CURES = {
    "pua311": _Cure(source=_PAPER, minutes=5.0, lamp_w=35.0),
    "noa61": _Cure(
        source="Norland, of NOA 60 (norland60); the data sheet that came with yours comes first",
        band_nm=(350.0, 380.0),
        dose_j_cm2=3.0,
    ),
    "pdms": _HEAT,
    "sylgard184": _HEAT,
}


@dataclass(frozen=True)
class Work:
    """All that the sheet is computed from: what is made, of what, how, and how exactly.

    `lines` are expected widths of the PSF's lines for some thicknesses, that of the camera in the
    middle; where they could not be computed there are none, and `no_lines` says why.
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


def step_sections(work: Work) -> tuple[Section, ...]:
    """All steps, numbered from 1."""
    sections = []
    first = 1
    for title, steps, after in (
        ("Make the mould", _mould(work), _mould_warnings(work)),
        ("Make the frame", _frame(work), ()),
        ("Pour and cure", _pour(work), ()),
        ("Measure what you made", _measure(work), _lines(work)),
    ):
        sections.append(Section(title, (Steps(first, steps), *after)))
        first += len(steps)
    return tuple(sections)


def size(width_mm: float, height_mm: float) -> str:
    """Write a width and a height, such as ``"12.98 × 11.15 mm"``."""
    return f"{millimetres(width_mm)} × {millimetres(height_mm)} mm"


def _mould(work: Work) -> tuple[Step, ...]:
    mould, process, frame = work.mould, work.process, work.frame
    baking = f"{process.bake_temperature_c:g} °C for {process.bake_minutes:g} min"
    sensor = work.camera.sensor
    return (
        Step(
            "Blow the master clean and lay it, relief upwards, flat in a dish of "
            f"{mould.dish_mm[0]:.1f} × {mould.dish_mm[1]:.1f} mm.",
            "advice",
        ),
        Step(
            f"Weigh and stir PDMS (Sylgard 184), {mould.ratio:g}:1 by mass; this is "
            f"{100 * process.surplus:g} % more than the mould takes.",
            "paper",
            f"{work.base_g:.2f} g base + {work.hardener_g:.2f} g hardener",
            (Blank("base", "g"), Blank("hardener", "g")),
        ),
        Step(
            "Degas in vacuum until no more bubbles rise; usually about 30 min (lafratta2010). The "
            "cup must hold several times as much: the mixture foams (advice).",
            "paper",
            blanks=(Blank("time", "min"),),
        ),
        Step(
            f"Pour it over the master, {mould.thickness_mm:g} mm high. Degas again if you see "
            "bubbles on the relief.",
            "paper",
            f"{mould.mass_g:.2f} g into the dish",
            (Blank("mass", "g"),),
        ),
        Step(
            "Bake on a level shelf.", "paper", baking, (Blank("oven", "°C"), Blank("time", "min"))
        ),
        Step(
            "Let it cool, peel it off slowly from one corner, and cut it larger than the frame "
            f"({size(frame.outer_width_mm, frame.outer_height_mm)}). Scratch the mark of "
            "pixel (0, 0) into its back (advice).",
            "paper",
        ),
        Step(
            "Check: no bubble or dust over the pixels "
            f"({size(sensor.width_mm, sensor.height_mm)}) and around; its two faces "
            "parallel. It is the mirror image of the master, with valleys for hills: right so.",
            "advice",
            blanks=(Blank("thickness", "mm"),),
        ),
    )


def _mould_warnings(work: Work) -> tuple[Block, ...]:
    if work.process.cure.temperature_c is None:
        return ()
    return (
        Text(
            "PDMS sticks to a mould of PDMS: treat the mould with a release agent first, and try "
            "it on a piece of scrap (advice).",
            "warning",
        ),
    )


def _frame(work: Work) -> tuple[Step, ...]:
    frame = work.frame
    details = (frame.vent_depth_mm,) if frame.vents else ()
    printing = Printing.of(frame.height_mm, *details)
    layers = f"{printing.layers} layers of {printing.layer_mm:.3f} mm"
    missed = round(printing.miss_mm, 3)
    if missed:
        layers += f" ({abs(missed):.3f} mm too {'high' if missed > 0 else 'low'})"
    return (
        Step(
            "Print frame.stl or frame.3mf standing on its foot, in black: it keeps light from the "
            "side away.",
            "computed",
            layers,
            (Blank("layer", "mm"),),
        ),
        Step(
            "Clean it and cure it as the printer's maker says. Take burrs off the wall's top: the "
            "mould must lie flat on it.",
            "advice",
        ),
        Step(
            "Check: height at the four corners (record, row 1). It slides over the package: "
            f"inside {size(frame.inner_width_mm, frame.inner_height_mm)}.",
            "computed",
            f"{work.height}{work.allowed}",
            (Blank("inside", "mm"),),
        ),
        Step(
            "Clean the board and the cover glass. Glue the frame around the package, its cut "
            "corner at pixel (0, 0). Close the foot all around, or the resin runs out.",
            "advice",
        ),
        Step(
            "Check: from the cover glass up to the wall's top, at the four corners (record, "
            "row 2).",
            "computed",
            f"{work.layer}{work.allowed}",
        ),
    )


def _pour(work: Work) -> tuple[Step, ...]:
    more = work.resin.pour_mm3 * (1 + work.process.surplus)
    return (
        Step(
            f"Draw about {more:.0f} µl of {work.resin_name} into a syringe, out of yellow and "
            "ultraviolet light. Put the board on the balance, set it to zero, and pour onto the "
            "cover glass.",
            "computed",
            work.pour,
            (Blank("poured", "µl" if work.resin.mass_mg is None else "mg"),),
        ),
        Step(
            "Degas until no more bubbles rise; a few minutes (advice).",
            "paper",
            blanks=(Blank("time", "min"),),
        ),
        Step(
            "Lay the mould on, relief down, mark to mark. One edge first, then let it sink, do "
            "not press (advice): what is too much leaves by the rim and the vents.",
            "paper",
        ),
        Step(
            "Check through the mould: no bubble over the pixels, and no wall's top that the "
            "mould does not touch.",
            "advice",
        ),
        _cure(work),
        Step("Let it cool. Peel the mould off slowly, from a corner.", "paper"),
    )


def _cure(work: Work) -> Step:
    cure = work.process.cure
    if cure.temperature_c is not None:
        return Step(
            "Bake with the mould on. Check first which temperature the sensor bears.",
            "paper",
            f"{cure.temperature_c:g} °C for {cure.minutes:g} min",
            (Blank("oven", "°C"), Blank("time", "min")),
        )
    if cure.dose_j_cm2 is not None and cure.band_nm is not None:
        return Step(
            "Cure through the mould with light of "
            f"{cure.band_nm[0]:g} to {cure.band_nm[1]:g} nm. Time in s = "
            f"{1000 * cure.dose_j_cm2:g} / irradiance in mW/cm².",
            "data sheet",
            f"{cure.dose_j_cm2:g} J/cm²",
            (Blank("irradiance", "mW/cm²"), Blank("time", "s")),
        )
    blanks = Blank("lamp", "W"), Blank("distance", "mm"), Blank("time", "min")
    if cure.minutes is not None and cure.lamp_w is not None:
        return Step(
            f"Cure with ultraviolet light through the mould, with a lamp of {cure.lamp_w:g} W. "
            "With another lamp go by the resin's data sheet and a trial on glass.",
            "paper",
            f"{cure.minutes:g} min",
            blanks,
        )
    return Step(
        f"Cure {work.resin_name} as its data sheet says; nolens knows no figures for it. Write "
        "down what worked.",
        "data sheet",
        blanks=blanks,
    )


def _measure(work: Work) -> tuple[Step, ...]:
    distance = work.camera.reference_distance
    return (
        Step(
            "Height over the board at four places beside the relief (record, row 3). The layer is "
            f"t′ = height − {work.glass_top} mm{_shrunk(work)}.",
            "computed",
            f"{work.height}{work.allowed}",
        ),
        Step(
            f"Put a white LED behind a pinhole of {PINHOLE_UM:g} µm at "
            f"{distance.mm:g} mm, straight ahead. In the dark, take a raw "
            "picture of it, no pixel saturated, and one with the light off. Subtract. Measure "
            "the full width at half maximum of the autocorrelation (FWHM).",
            "paper",
            _expected(work),
            (Blank("FWHM", "µm"),),
        ),
        Step(
            "Too thick or too thin? Print the next frame with the height "
            f"{work.height} mm + {work.layer} mm − measured t′. Right, but the "
            "lines are wide? Look for a tilt (the corners differ), bubbles, a mould that did not "
            "lie flat.",
            "computed",
            blanks=(Blank("next height", "mm"),),
        ),
    )


def _shrunk(work: Work) -> str:
    if not work.resin.shrinkage:
        return ""
    thinnest = work.frame.layer_mm * (1 - work.resin.shrinkage)
    return f"; shrinkage alone explains down to {thinnest:.2f} mm"


def _expected(work: Work) -> str:
    if not work.lines:
        return ""
    nominal = work.lines[len(work.lines) // 2]
    return f"FWHM {nominal.width_um:.1f} µm, lines {nominal.line_um:.1f} µm"


def _lines(work: Work) -> tuple[Block, ...]:
    if not work.lines:
        return (Text(f"No width can be predicted for this camera: {work.no_lines}", "note"),)
    rows = tuple(
        (f"{millimetres(each.layer_mm)} mm", f"{each.width_um:.1f} µm", f"{each.line_um:.1f} µm")
        for each in work.lines
    )
    table = Table(
        "Simulated width of the lines; nolens measure psf gives that of a captured PSF",
        ("t′", "FWHM of the autocorrelation", "FWHM of a line (÷ √2)"),
        (0.3, 0.35, 0.35),
        rows,
    )
    return (table,)
