"""Figures of the process that makes a camera: mould, curing, tolerances."""

from dataclasses import dataclass

PAPER = "the paper (uvimprint)"


@dataclass(frozen=True)
class Cure:
    """How a poured resin becomes hard; None where nobody published a figure.

    Parameters
    ----------
    source
        Where the figures come from; None where there are none.
    minutes
        How long the light, or the heat, must act.
    lamp_w
        Power of the ultraviolet lamp that is meant.
    band_nm
        Shortest and longest wavelength of the light.
    dose_j_cm2
        Energy of the light on the resin.
    temperature_c
        Of the oven, where heat cures it.
    """

    source: str | None = None
    minutes: float | None = None
    lamp_w: float | None = None
    band_nm: tuple[float, float] | None = None
    dose_j_cm2: float | None = None
    temperature_c: float | None = None


@dataclass(frozen=True)
class Process:
    """Figures of the mould and of the curing.

    Parameters
    ----------
    cure
        How the resin becomes hard.
    bake_temperature_c, bake_minutes
        Of the oven that makes the mould hard.
    source
        Where the figures of the mould come from.
    surplus
        Fraction that is mixed, and drawn, beyond what is needed: it stays in the cup and the
        syringe. General advice.
    """

    cure: Cure
    bake_temperature_c: float = 80.0
    bake_minutes: float = 60.0
    source: str = PAPER
    surplus: float = 0.1

    @classmethod
    def of(cls, resin: str | None) -> "Process":
        """Figures for a resin by the name of its material (`nolens.camera.MATERIALS`).

        The paper's for its own resin and for PDMS (`uvimprint`, section II); for NOA 61 those
        that its maker gives for NOA 60, the wavelengths for all its adhesives (`norland60`);
        none for others, which the person at the bench fills in.
        """
        return cls(_CURES.get(resin or "", Cure()))


@dataclass(frozen=True)
class Printing:
    """In which layers a frame is printed.

    Parameters
    ----------
    layer_mm
        Thickness of a layer.
    layers
        How many make the frame.
    miss_mm
        By how much they are higher than the frame.
    """

    layer_mm: float
    layers: int
    miss_mm: float

    @classmethod
    def of(cls, height_mm: float, *details_mm: float) -> "Printing":
        """Choose the thickest layers, up to 0.1 mm, that make whole numbers.

        Parameters
        ----------
        height_mm
            Of the frame. Where no layer fits it, the nearest is chosen.
        details_mm
            Heights that should be whole numbers of layers too, if some layer can make them so.
        """
        found = []
        for layer_mm in _LAYERS_MM:
            layers = max(1, round(height_mm / layer_mm))
            printing = cls(layer_mm, layers, layers * layer_mm - height_mm)
            rough = [abs(each / layer_mm - round(each / layer_mm)) > 1e-6 for each in details_mm]
            miss = max(0.0, abs(printing.miss_mm) - _EXACT_MM)
            found.append((miss, sum(rough), -layer_mm, printing))
        return min(found, key=lambda each: each[:3])[3]


_LAYERS_MM = tuple(number / 200 for number in range(5, 21))
"""From 0.025 to 0.1 mm."""
_EXACT_MM = 1e-6

_HEAT = Cure(source=PAPER, minutes=Process.bake_minutes, temperature_c=Process.bake_temperature_c)
_CURES = {
    "pua311": Cure(source=PAPER, minutes=5.0, lamp_w=35.0),
    "noa61": Cure(
        source="Norland, of NOA 60 (norland60); the data sheet that came with yours comes first",
        band_nm=(350.0, 380.0),
        dose_j_cm2=3.0,
    ),
    "pdms": _HEAT,
    "sylgard184": _HEAT,
}


@dataclass(frozen=True)
class ToleranceLine:
    """How far off one parameter may be.

    Parameters
    ----------
    parameter
        Its name, such as ``"resin thickness"``.
    nominal
        What it should be.
    allowed
        By how much it may be more or less.
    unit
        Of both; empty for plain numbers.
    effect
        What being off does.
    """

    parameter: str
    nominal: float
    allowed: float
    unit: str
    effect: str


@dataclass(frozen=True)
class ToleranceBudget:
    """How far off the parameters of a camera may be.

    Parameters
    ----------
    lines
        One for each parameter; none where the camera leaves no room.
    method
        How the figures were found, in a sentence or two.
    layer_mm
        What is allowed of the thickness that the frame sets; None where that is not known.
    """

    lines: tuple[ToleranceLine, ...]
    method: str
    layer_mm: float | None
