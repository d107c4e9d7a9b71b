"""Everything that the workshop gets for one camera, its figures, and what to heed."""

import math
from dataclasses import asdict, dataclass
from typing import Any, Self

from nolens.amounts import amount
from nolens.camera import Camera, Package
from nolens.fabricate.frame import FrameGeometry, poured_layer, shading_angle_deg
from nolens.fabricate.resin import MouldAmount, ResinAmount
from nolens.fabricate.solid import Solid, decimated, frame_solid, relief_solid
from nolens.fabricate.surface import MOST_LEVELS, Levels, MadeSurface
from nolens.optics import Relief

_LARGE_BYTES = 20e6


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
    base_mm
        Thickness under the relief's lowest point.
    printer_shrinkage
        Fraction of its lengths that a print of the frame loses.
    shading_angle_deg
        See `nolens.fabricate.shading_angle_deg`.
    """

    frame: FrameGeometry
    resin: ResinAmount
    mould: MouldAmount
    solid: Solid
    mask: MadeSurface
    levels: Levels
    thinned: MadeSurface
    relief: Solid
    base_mm: float
    printer_shrinkage: float
    shading_angle_deg: float | None

    @classmethod
    def of(
        cls,
        camera: Camera,
        frame: FrameGeometry,
        resin: ResinAmount,
        mould: MouldAmount,
        surface: MadeSurface,
        mask: MadeSurface,
        *,
        levels: int,
        triangles: int,
        base_mm: float,
        printer_shrinkage: float,
    ) -> Self:
        """Build the solids and the levels.

        Parameters
        ----------
        camera, frame, resin, mould
            What is made, its measures and amounts.
        surface, mask
            What is made of the camera's relief, at the relief's own pitch and at that of the files.
        levels, triangles
            Steps of the layout; the most triangles that the relief's solid has.
        base_mm, printer_shrinkage
            As the fields are.

        Raises
        ------
        OptionError
            If a count or measure makes no solid or layout.
        DataError
            If a solid is not closed.
        """
        steps = Levels(mask, levels)
        steps.check_size()
        thinned = decimated(surface, triangles)
        title = f"frame of {camera.name}, in mm; cut corner at pixel (0, 0)"
        pieces = cls(
            frame=frame,
            resin=resin,
            mould=mould,
            solid=frame_solid(frame, title).grown(printer_shrinkage),
            mask=mask,
            levels=steps,
            thinned=thinned,
            relief=relief_solid(thinned, base_mm),
            base_mm=base_mm,
            printer_shrinkage=printer_shrinkage,
            shading_angle_deg=shading_angle_deg(camera, frame),
        )
        for each in (pieces.solid, pieces.relief):
            each.check_closed()
        return pieces

    def figures(self, camera: Camera, relief: Relief) -> dict[str, Any]:
        """All figures of frame, resin, mould, mask and relief, in values that JSON has."""
        frame, resin, mould = self.frame, self.resin, self.mould
        material = camera.material_of(poured_layer(camera))
        return {
            "frame": {
                **asdict(frame),
                "outer_mm": _mm(frame.outer_width_mm, frame.outer_height_mm, frame.height_mm),
                "inner_mm": _mm(frame.inner_width_mm, frame.inner_height_mm),
                "volume_mm3": round(frame.volume_mm3, 4),
                "solid_mm3": round(self.solid.volume_mm3, 4),
                "shading_angle_deg": _rounded(self.shading_angle_deg, 2),
                "printed_larger": round(1 / (1 - self.printer_shrinkage), 6),
            },
            "resin": {
                "material": None if material is None else material.name,
                "cavity_mm3": round(resin.cavity_mm3, 4),
                "cavity_mg": _rounded(resin.cavity_mg, 3),
                "overflow_mm3": round(resin.overflow_mm3, 4),
                "meniscus_mm3": round(resin.meniscus_mm3, 4),
                "shrinkage": resin.shrinkage,
                "pour_mm3": round(resin.pour_mm3, 4),
                "mass_mg": _rounded(resin.mass_mg, 3),
                "density_g_cm3": resin.density_g_cm3,
                "relief_mm3": _relief_mm3(relief),
                "thinnest_layer_mm": round(frame.layer_mm * (1 - resin.shrinkage), 4),
            },
            "mould": {
                "dish_mm": _mm(*mould.dish_mm),
                "thickness_mm": mould.thickness_mm,
                "ratio": mould.ratio,
                "mass_g": round(mould.mass_g, 3),
                "base_g": round(mould.base_g, 3),
                "hardener_g": round(mould.hardener_g, 3),
            },
            "mask": {
                "surface": self.mask.name,
                "about": self.mask.words,
                "points": list(self.mask.height_um.shape),
                "pitch_um": self.mask.pitch_um,
                "size_mm": _mm(*self.mask.size_mm),
                "heights_um": list(self.mask.range_um),
                "levels": self.levels.count,
                "step_um": self.levels.step_um,
                "rms_error_um": self.mask.rms_error_um,
            },
            "relief": {
                "triangles": len(self.relief.triangles),
                "points": list(self.thinned.height_um.shape),
                "pitch_um": self.thinned.pitch_um,
                "rms_error_um": self.thinned.rms_error_um,
                "largest_error_um": self.thinned.largest_error_um,
                "solid_mm3": round(self.relief.volume_mm3, 4),
                "base_mm": self.base_mm,
            },
        }

    @property
    def size_note(self) -> str | None:
        """How large the mask's files will be, where that is much."""
        sizes = {
            "mask.tif": 2.0 * self.mask.height_um.numel(),
            "mask.gds": self.levels.expected_bytes("GDS"),
            "mask.oas": self.levels.expected_bytes("OASIS"),
        }
        if sum(sizes.values()) <= _LARGE_BYTES:
            return None
        large = ", ".join(f"{name} {size / 1e6:.0f} MB" for name, size in sizes.items())
        return (
            f"files will have about: {large}. A coarser --pitch, a --crop or fewer --levels make "
            "them smaller"
        )

    def warnings(
        self, camera: Camera, package: Package | None, relief: Relief, coarsest_um: float
    ) -> list[str]:
        """What the maker must know of the sensor's package, the amounts, the sizes and the steps.

        A step of `coarsest_um` turns the light by a quarter of a wavelength.
        """
        frame = self.frame
        warnings = list(self.resin.notes)
        if package is not None and package.source.startswith("placeholder"):
            warnings.append(
                f"the package's size is no measurement ({package.source}): measure the sensor "
                "before printing"
            )
        if camera.mask.aperture is not None:
            warnings.append(
                "the camera has an aperture, which these files do not hold: make it of opaque film"
            )
        height, width = (side * 1e-3 for side in relief.extent_um)
        if width > frame.inner_width_mm or height > frame.inner_height_mm:
            warnings.append(
                f"the relief of {width:.4g} × {height:.4g} mm is larger than the frame's inside of "
                f"{frame.inner_width_mm:.4g} × {frame.inner_height_mm:.4g} mm: on the camera it "
                "ends at the wall"
            )
        if self.shading_angle_deg == 0:
            warnings.append("the wall stands over the sensor's edge and shades it")
        if self.levels.step_um > coarsest_um:
            low, high = self.mask.range_um
            needed = math.ceil((high - low) / coarsest_um) + 1
            advice = "take mask.tif instead"
            if needed <= MOST_LEVELS:
                advice = f"--levels {needed} would not"
            warnings.append(
                f"{self.levels.count} levels lie {amount(self.levels.step_um, 'um', digits=2)} "
                f"apart, more than the {amount(coarsest_um, 'um', digits=2)} that turn the light "
                "by a quarter of a wavelength: a mask made of mask.gds or mask.oas scatters light; "
                f"{advice}"
            )
        return warnings


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)


def _mm(*lengths_mm: float) -> list[float]:
    return [round(length, 4) for length in lengths_mm]


def _relief_mm3(relief: Relief) -> float:
    """What the relief adds to the resin: its mean height over its area."""
    area_mm2 = math.prod(relief.extent_um) * 1e-6
    return round(float(relief.height_um.double().mean()) * 1e-3 * area_mm2, 4)
