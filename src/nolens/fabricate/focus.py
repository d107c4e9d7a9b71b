"""How exactly a camera must be made: a tolerance budget by rays, and the lines of its PSF."""

import math
from dataclasses import dataclass, replace

from nolens.amounts import amount
from nolens.camera import Camera, Flat, LoadedCamera, RandomLenslets
from nolens.design.focus import depth_of_focus_um, lenslet_aperture
from nolens.design.tolerances.study import BudgetLine
from nolens.errors import DataError
from nolens.evaluate import pattern_figures
from nolens.optics import PointSource, Stack, mask_to_sensor
from nolens.quantities import Length
from nolens.twin import REFERENCE_NM, Light, Twin, point_spread

PINHOLE_UM = 50.0
"""Diameter of the paper's point source."""
_PATCH = 384
"""Pixels along the side of the patch of sensor that stands for all of it."""


@dataclass(frozen=True)
class ToleranceBudget:
    """How far off the parameters of a camera may be.

    Parameters
    ----------
    lines
        One for each parameter; none where the camera leaves no room.
    method
        How the figures were computed, in a sentence or two.
    layer_mm
        What is allowed of the thickness that the frame sets; None where that is not known.
    """

    lines: tuple[BudgetLine, ...]
    method: str
    layer_mm: float | None


@dataclass(frozen=True)
class Focus:
    """How the lenslets of a mask focus on the sensor, by paraxial rays.

    Parameters
    ----------
    length_mm
        Focal length as in air, f = R / (n′ − 1).
    aperture
        Numerical aperture of a lenslet, half the pitch over f.
    off_mm
        How far behind the focus the sensor lies, as in air: D − f; negative in front of it.
    """

    length_mm: float
    aperture: float
    off_mm: float

    @property
    def depth_mm(self) -> float:
        """Depth of focus λ/NA² in air, from end to end (`uvimprint`)."""
        return float(depth_of_focus_um(REFERENCE_NM * 1e-3, self.aperture)) * 1e-3

    @property
    def room_mm(self) -> float:
        """By how much the sensor may leave its place: half the depth of focus, less |D − f|."""
        return self.depth_mm / 2 - abs(self.off_mm)


@dataclass(frozen=True)
class Lines:
    """Full width at half maximum of the PSF's autocorrelation, behind a layer of some thickness."""

    layer_mm: float
    width_um: float

    @property
    def line_um(self) -> float:
        """Width of a line with a Gaussian profile (`uvimprint`)."""
        return self.width_um / math.sqrt(2)


def focus_of(camera: Camera) -> Focus | None:
    """Focus of a mask of random lenslets at 550 nm (`mask_to_sensor`); None for other masks.

    Raises
    ------
    OptionError
        If a layer's index is not known at that wavelength.
    """
    relief = camera.mask.relief
    if not isinstance(relief, RandomLenslets):
        return None
    before, after = _media(camera)
    if after.indices[0] <= before:
        return None
    matrix = mask_to_sensor(before, after, relief.radius.um)
    length_mm = -1e-3 / float(matrix[1, 0]) / after.indices[-1]
    aperture = float(lenslet_aperture(relief.pitch.um, length_mm * 1e3))
    return Focus(length_mm, aperture, -float(matrix[0, 0]) * length_mm)


def ray_budget(camera: Camera) -> ToleranceBudget:
    r"""Divide the depth of focus of the lenslets among the layers.

    The sensor lies :math:`D - f = Σ t_j/n_j - R/(n' - n_0)` behind the focus. Parameters p that
    vary by ±a each, independently, move it by :math:`\sqrt{Σ (a\,∂(D-f)/∂p)^2}`; each of N may
    take 1/√N of the room that is left, :math:`λ/(2NA^2) - |D - f|`.

    Raises
    ------
    OptionError
        If a layer's index is not known at 550 nm.
    """
    focus = focus_of(camera)
    if focus is None:
        return ToleranceBudget(
            (),
            "The mask is not one of convex lenslets of one radius, so rays give no budget: "
            "nolens design tolerance computes one with waves.",
            None,
        )
    if focus.room_mm <= 0:
        return ToleranceBudget(
            (),
            f"No room: the sensor lies {abs(focus.off_mm):.2f} mm (as in air) "
            f"{'behind' if focus.off_mm > 0 else 'in front of'} the focus, more than half the "
            f"depth of focus λ/NA² = {focus.depth_mm:.2f} mm. nolens design thickness says which "
            "thickness is in focus.",
            None,
        )
    poured = camera.mask.surface
    slopes = _slopes(camera, focus)
    each_mm = focus.room_mm / math.sqrt(len(slopes))
    lines = []
    layer_mm = None
    for place, what, nominal, slope in slopes:
        allowed = each_mm / abs(slope)
        unit = "mm" if what == "thickness" else ""
        if place == poured and what == "thickness":
            layer_mm = allowed
        name = camera.layers[place].name or f"layer {place}"
        alone = focus.room_mm / abs(slope)
        effect = f"alone, ± {amount(alone, unit, digits=2)} would do"
        if what == "index" and allowed > (nominal - 1) / 2:
            effect = "hardly matters"
        lines.append(BudgetLine(f"{name}, {what}", nominal, allowed, unit, effect))
    return ToleranceBudget(
        tuple(lines),
        f"From rays at {REFERENCE_NM:g} nm: lenslets of focal length f = R/(n′ − 1) = "
        f"{focus.length_mm:.2f} mm and NA = pitch/(2f) = {focus.aperture:.3f} have a depth of "
        f"focus λ/NA² = {focus.depth_mm:.2f} mm. Half of it, less the {abs(focus.off_mm):.2f} mm "
        f"by which this camera is out of focus already, leaves {focus.room_mm:.2f} mm. Each of "
        f"{len(lines)} parameters may use 1/√{len(lines)} of that, {each_mm:.2f} mm.",
        layer_mm,
    )


def expected_lines(loaded: LoadedCamera, thicknesses_mm: tuple[float, ...]) -> tuple[Lines, ...]:
    """Simulate the check with a pinhole: the width of the lines for thicknesses of the resin.

    White light of a pinhole of 50 µm at the camera's reference distance falls on a patch of the
    mask; one wavelength stands for each colour of the sensor, whose PSFs are added.

    Raises
    ------
    NolensError
        If the camera cannot be simulated, or its PSF has no lines to measure.
    """
    if isinstance(loaded.camera.mask.relief, Flat):
        raise DataError("the mask is flat: it throws no lines on the sensor")
    twin = _patch(loaded)
    camera = twin.camera
    poured = camera.mask.surface
    source = PointSource(distance_um=camera.reference_distance.um, diameter_um=PINHOLE_UM)
    lines = []
    for thickness_mm in thicknesses_mm:
        layers = list(camera.layers)
        thickness = Length.of(thickness_mm, "mm")
        layers[poured] = layers[poured].model_copy(update={"thickness": thickness})
        other = replace(twin, camera=camera.model_copy(update={"layers": tuple(layers)}))
        psf = point_spread(
            other,
            source,
            twin.shape,
            superpixel=twin.superpixel,
            light=Light("white-led"),
            wavelengths=1,
        )
        width_um = pattern_figures(psf.mean(dim=0), twin.pixel_um).width_um
        lines.append(Lines(thickness_mm, width_um))
    return tuple(lines)


def _media(camera: Camera) -> tuple[float, Stack]:
    """Index in front of the mask's surface, and the layers from there to the sensor."""
    surface = camera.mask.surface
    indices = camera.media(REFERENCE_NM)
    thicknesses = tuple(layer.thickness.um for layer in camera.layers[surface:])
    return indices[surface], Stack(thicknesses, indices[surface + 1 :])


def _slopes(camera: Camera, focus: Focus) -> list[tuple[int, str, float, float]]:
    """Layer, what of it, its value, and ∂(D − f)/∂ of that, in mm to the mm or to the unit."""
    surface = camera.mask.surface
    before, after = _media(camera)
    slopes = []
    for number, (thickness_um, index) in enumerate(
        zip(after.thicknesses_um, after.indices, strict=True)
    ):
        place, thickness_mm = surface + number, thickness_um * 1e-3
        slopes.append((place, "thickness", thickness_mm, 1 / index))
        if index > 1:
            slope = -thickness_mm / index**2
            if number == 0:
                slope += focus.length_mm / (index - before)
            slopes.append((place, "index", index, slope))
    return slopes


def _patch(loaded: LoadedCamera) -> Twin:
    """The camera with so little of its sensor that a PSF takes a moment."""
    sensor = loaded.camera.sensor
    side = _PATCH * sensor.superpixel
    rows, columns = min(sensor.rows, side), min(sensor.columns, side)
    if not isinstance(loaded.camera.mask.relief, RandomLenslets):
        return Twin.of(loaded).reading(rows, columns)
    small = sensor.model_copy(update={"rows": rows, "columns": columns})
    return Twin.of(replace(loaded, camera=loaded.camera.model_copy(update={"sensor": small})))
