"""The printed frame around a sensor: its measures, their limits, and the shade that it casts."""

import math
from dataclasses import dataclass
from typing import Self

import torch

from nolens.camera import Camera, Layer, Package
from nolens.errors import OptionError
from nolens.optics import Stack
from nolens.twin import REFERENCE_NM

_RIM_FRACTION, _MARK_FRACTION = 0.3, 0.8
_VENT_DEPTH_MM, _VENT_FRACTION = 0.25, 0.25
_SLACK_MM = 1e-9
"""Measures that were parsed from decimal text may miss a limit by their rounding."""
_GLASSES = ("cover-glass", "d263", "bk7", "fused-silica")
_BISECTIONS = 60


@dataclass(frozen=True)
class Printer:
    """Thinnest wall and narrowest channel that a printer makes; (width, depth) of its bed."""

    smallest_mm: float = 0.4
    bed_mm: tuple[float, float] = (120.0, 68.0)


@dataclass(frozen=True)
class FrameGeometry:
    """Measures of the frame that stands around a sensor's package and sets the mask's height.

    The frame stands on the face that the package stands on. Seen from the scene, x goes along
    the sensor's rows to the right and y from row to row upwards; z goes towards the scene. At
    the top the inside edge is cut at 45° (the pouring rim), channels cross the wall (vents), and
    the outer corner at pixel (0, 0) is cut off over the whole height (the mark). The mould lies
    on what is left of the wall's top.

    Parameters
    ----------
    package_width_mm, package_height_mm, glass_top_mm
        The sensor's package along the rows, across them, and up to the top of its glass.
    layer_mm
        Thickness t′ of the resin over the glass.
    clearance_mm
        Between the package and the frame, on every side.
    wall_mm
        Thickness of the wall.
    rim_mm
        Legs of the pouring rim; 0 for a sharp edge.
    vent_width_mm, vent_depth_mm, vents
        Section and number of the vents. They are dealt to the sides right, left, top, bottom in
        turn, and stand evenly along each.
    mark_mm
        Legs of the corner that is cut off; 0 for none.

    Raises
    ------
    OptionError
        If no solid has these measures, or the resin could not stay in it.
    """

    package_width_mm: float
    package_height_mm: float
    glass_top_mm: float
    layer_mm: float
    clearance_mm: float
    wall_mm: float
    rim_mm: float
    vent_width_mm: float
    vent_depth_mm: float
    vents: int
    mark_mm: float

    def __post_init__(self) -> None:
        _check_sizes(self)
        _check_rim_and_vents(self)
        room = self.mark_room_mm
        if self.mark_mm > 0 and room <= 0:
            raise OptionError(
                f"a mark of {self.mark_mm:g} mm cuts through the corner of the wall: give less "
                f"than {2 * self.seat_mm:.3g} mm (--mark), or a thicker --wall"
            )

    @classmethod
    def of(
        cls,
        camera: Camera,
        *,
        package: Package | None = None,
        wall_mm: float = 1.0,
        clearance_mm: float = 0.1,
        rim_mm: float | None = None,
        vent_width_mm: float = 0.8,
        vent_depth_mm: float | None = None,
        vents: int = 4,
        mark_mm: float | None = None,
        printer: Printer | None = None,
    ) -> Self:
        """Measure the frame of a camera whose mask is a layer poured onto its glass.

        Parameters
        ----------
        camera
            Its layers say how thick the resin is.
        package
            Instead of the package that the camera's sensor has.
        wall_mm, clearance_mm, vent_width_mm, vents
            See the class.
        rim_mm
            None takes 0.3 of the wall, less where the wall's top or the resin needs it.
        vent_depth_mm
            None takes 0.25 mm, or a quarter of a thinner resin.
        mark_mm
            None takes 0.8 of the wall, less where the corner needs it.
        printer
            What it can make; None takes the usual one.

        Raises
        ------
        OptionError
            If nobody gave a package, the camera's mask is not poured onto its glass, or the
            frame cannot be made or printed.
        """
        package = package or camera.sensor.package
        printer = printer or Printer()
        if package is None:
            raise OptionError(
                f"nobody gave the package of the sensor {camera.sensor.name!r}: give "
                "[sensor.package] in camera.toml, or --package 12.98mmx11.15mm --glass-top 1.9mm"
            )
        sensor = camera.sensor
        if package.width.mm < sensor.width_mm or package.height.mm < sensor.height_mm:
            raise OptionError(
                f"the package of {package.width} × {package.height} is smaller than the sensor's "
                f"pixels, {sensor.width_mm:g} × {sensor.height_mm:g} mm: give its outer size "
                "(--package, or [sensor.package] in camera.toml)"
            )
        layer_mm = poured_layer(camera).thickness.mm
        if rim_mm is None:
            spare = max(0.0, wall_mm - printer.smallest_mm)
            rim_mm = min(_RIM_FRACTION * wall_mm, spare, layer_mm / 2)
        if mark_mm is None:
            seat = wall_mm - rim_mm
            room = 2 * seat - math.sqrt(2) * printer.smallest_mm
            mark_mm = max(0.0, min(_MARK_FRACTION * wall_mm, room))
        if vent_depth_mm is None:
            vent_depth_mm = min(_VENT_DEPTH_MM, _VENT_FRACTION * layer_mm)
        frame = cls(
            package_width_mm=package.width.mm,
            package_height_mm=package.height.mm,
            glass_top_mm=package.glass_top.mm,
            layer_mm=layer_mm,
            clearance_mm=clearance_mm,
            wall_mm=wall_mm,
            rim_mm=rim_mm,
            vent_width_mm=vent_width_mm,
            vent_depth_mm=vent_depth_mm,
            vents=vents,
            mark_mm=mark_mm,
        )
        _check_printer(frame, printer)
        return frame

    @property
    def inner_width_mm(self) -> float:
        """Between the walls, along the rows."""
        return self.package_width_mm + 2 * self.clearance_mm

    @property
    def inner_height_mm(self) -> float:
        """Between the walls, across the rows."""
        return self.package_height_mm + 2 * self.clearance_mm

    @property
    def outer_width_mm(self) -> float:
        """Of the whole frame, along the rows."""
        return self.inner_width_mm + 2 * self.wall_mm

    @property
    def outer_height_mm(self) -> float:
        """Of the whole frame, across the rows."""
        return self.inner_height_mm + 2 * self.wall_mm

    @property
    def height_mm(self) -> float:
        """Of the whole frame: its top is level with the mask's surface."""
        return self.glass_top_mm + self.layer_mm

    @property
    def seat_mm(self) -> float:
        """Width of the wall's top, on which the mould lies."""
        return self.wall_mm - self.rim_mm

    @property
    def mark_room_mm(self) -> float:
        """Between the face of the mark and the nearest corner inside, at the rim's top."""
        return (2 * self.seat_mm - self.mark_mm) / math.sqrt(2)

    @property
    def rim_mm3(self) -> float:
        """Volume over the rim: r²(w + h) + 4r³/3 around an opening of w × h."""
        r = self.rim_mm
        return r * r * (self.inner_width_mm + self.inner_height_mm) + 4 * r**3 / 3

    @property
    def vents_mm3(self) -> float:
        """Volume of the vents, but for what the rim has taken already."""
        r, depth = self.rim_mm, self.vent_depth_mm
        shared = r * r / 2 if depth >= r else depth * r - depth * depth / 2
        return self.vents * self.vent_width_mm * (depth * self.wall_mm - shared)

    @property
    def volume_mm3(self) -> float:
        """Volume of the solid."""
        ring = self.outer_width_mm * self.outer_height_mm - self._opening_mm2 - self.mark_mm**2 / 2
        return ring * self.height_mm - self.rim_mm3 - self.vents_mm3

    @property
    def cavity_mm3(self) -> float:
        """Volume of the cavity up to the frame's top: the opening's, less the package's.

        The spaces over the rim and in the vents come on top (`rim_mm3`, `vents_mm3`), and what
        the relief's mean height adds, which is below a thousandth.
        """
        package = self.package_width_mm * self.package_height_mm * self.glass_top_mm
        return self._opening_mm2 * self.height_mm - package

    @property
    def _opening_mm2(self) -> float:
        return self.inner_width_mm * self.inner_height_mm

    def vent_offsets_mm(self) -> tuple[tuple[float, ...], ...]:
        """Where the vents' middles are along the sides right, left, top and bottom, from each's."""
        lengths = (self.inner_height_mm,) * 2 + (self.inner_width_mm,) * 2
        counts = ((self.vents + 3 - side) // 4 for side in range(4))
        return tuple(
            tuple(((place + 0.5) / count - 0.5) * length for place in range(count))
            for count, length in zip(counts, lengths, strict=True)
        )

    @property
    def vent_gap_mm(self) -> float:
        """Least wall between two vents, and twice that between a vent and the cavity's corner."""
        right, _, top, _ = map(len, self.vent_offsets_mm())
        lengths = ((self.inner_height_mm, right), (self.inner_width_mm, top))
        return min(
            (length / count - self.vent_width_mm for length, count in lengths if count),
            default=math.inf,
        )


def poured_layer(camera: Camera) -> Layer:
    """Find the layer that is poured onto the sensor's glass and has the mask's relief on top.

    What lies below it comes with the sensor: the cover glass and the air under it, or nothing.

    Raises
    ------
    OptionError
        If the mask is a film at a distance, or it does not lie on the sensor's own layers.
    """
    layers = camera.layers
    first = len(layers)
    if is_air(layers[-1]):
        first -= 2
    elif layers[-1].material in _GLASSES:
        first -= 1
    between = layers[camera.mask.surface : max(first, 0)]
    advice = "give a camera whose masked layer lies on the cover glass, such as the preset paper"
    if any(is_air(layer) for layer in between):
        raise OptionError(
            f"the mask of {camera.name!r} is a film with air between it and the glass: no resin is "
            f"poured there, and this frame is for pouring; {advice}"
        )
    if len(between) != 1:
        names = ", ".join(layer.name or "one without a name" for layer in between) or "none"
        raise OptionError(
            f"one layer is poured onto the glass, but between the mask's surface and the cover "
            f"glass of {camera.name!r} there are {len(between)} ({names}): {advice}"
        )
    return between[0]


def shading_angle_deg(camera: Camera, frame: FrameGeometry) -> float | None:
    r"""Field angle from which on the wall shades the pixels along the sensor's edge.

    Light with p = sin θ (Snell's law conserves it) reaches a pixel from
    :math:`D = \sum_i t_i p/\sqrt{n_i^2 - p^2}` beside it at the mask's surface, which is level
    with the frame's top. It passes the wall's upper edge while D is at most the distance a from
    the outermost pixel to the cavity's wall, plus the rim r, and the rim's lower edge while
    :math:`D - r p/\sqrt{n^2 - p^2} ≤ a`, with n the resin's index. The angle is the smaller one of
    both directions; a corner's pixel is shaded from there on too.

    The camera's layers count at 550 nm; the sensor's middle is taken as the package's. The angle
    is 0 where the wall stands over the pixels, and None where no angle is shaded.
    """
    surface = camera.mask.surface
    thicknesses = tuple(layer.thickness.um * 1e-3 for layer in camera.layers[surface:])
    indices = camera.indices(REFERENCE_NM)[surface:]
    whole = Stack(thicknesses, indices)
    below = Stack((thicknesses[0] - frame.rim_mm, *thicknesses[1:]), indices)
    sensor = camera.sensor
    room = min(
        (frame.inner_width_mm - sensor.width_mm) / 2,
        (frame.inner_height_mm - sensor.height_mm) / 2,
    )

    def passes(angle_deg: float) -> bool:
        p = torch.tensor(math.sin(math.radians(angle_deg)), dtype=torch.float64)
        upper, lower = (float(stack.displacement_um(p)) for stack in (whole, below))
        return upper <= room + frame.rim_mm and lower <= room

    low, high = 0.0, 90.0 - 1e-9
    if passes(high):
        return None
    if not passes(low):
        return 0.0
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        low, high = (middle, high) if passes(middle) else (low, middle)
    return low


def _check_sizes(frame: FrameGeometry) -> None:
    """Refuse measures that are negative, or zero where they must not be."""
    positive = {
        "package's width (--package)": frame.package_width_mm,
        "package's height (--package)": frame.package_height_mm,
        "top of the glass (--glass-top)": frame.glass_top_mm,
        "resin's thickness": frame.layer_mm,
        "wall (--wall)": frame.wall_mm,
    }
    for what, size in positive.items():
        if not 0 < size < math.inf:
            raise OptionError(f"the {what} is {size:g} mm: it must be more than 0 mm")
    rest = {
        "clearance (--clearance)": frame.clearance_mm,
        "rim (--rim)": frame.rim_mm,
        "mark (--mark)": frame.mark_mm,
    }
    for what, size in rest.items():
        if not 0 <= size < math.inf:
            raise OptionError(f"the {what} is {size:g} mm: it must be 0 mm or more")
    if frame.vents < 0:
        raise OptionError(f"{frame.vents} vents (--vents): give 0 or more")


def _check_rim_and_vents(frame: FrameGeometry) -> None:
    """Refuse a rim and vents that the wall has no room for.

    The rim may not take the whole wall's top, the resin not run out below the glass, and the
    vents not stand in each other's way.
    """
    if frame.rim_mm > 0 and frame.rim_mm >= frame.wall_mm:
        raise OptionError(
            f"a pouring rim of {frame.rim_mm:g} mm leaves nothing of the wall of "
            f"{frame.wall_mm:g} mm for the mould to lie on: give less (--rim) or a thicker --wall"
        )
    if frame.rim_mm > frame.layer_mm:
        raise OptionError(
            f"a pouring rim of {frame.rim_mm:g} mm reaches below the glass, over which the resin "
            f"is {frame.layer_mm:g} mm thick: give at most that (--rim)"
        )
    if frame.vents == 0:
        return
    for what, size in (("width", frame.vent_width_mm), ("depth", frame.vent_depth_mm)):
        if not 0 < size < math.inf:
            raise OptionError(
                f"a vent's {what} is {size:g} mm (--vent-{what}): it must be more than 0 mm; "
                "--vents 0 leaves them out"
            )
    if frame.vent_depth_mm >= frame.layer_mm:
        raise OptionError(
            f"vents {frame.vent_depth_mm:g} mm deep let the resin run out down to the glass, over "
            f"which it should be {frame.layer_mm:g} mm thick: give less (--vent-depth)"
        )
    beside = 2 * max(0.0, frame.mark_mm - frame.wall_mm)
    if frame.vent_gap_mm <= beside:
        raise OptionError(
            f"{frame.vents} vents of {frame.vent_width_mm:g} mm do not fit into walls of "
            f"{frame.inner_width_mm:.4g} and {frame.inner_height_mm:.4g} mm: give fewer (--vents) "
            "or narrower ones (--vent-width)"
        )


def _check_printer(frame: FrameGeometry, printer: Printer) -> None:
    """Refuse a frame with parts thinner than a printer's smallest feature, or beyond its bed."""
    smallest = printer.smallest_mm
    thin = {
        f"the wall of {frame.wall_mm:g} mm (--wall)": frame.wall_mm,
        f"the wall's top of {frame.seat_mm:.3g} mm beside the rim (--rim)": frame.seat_mm,
    }
    if frame.mark_mm > 0:
        room = frame.mark_room_mm
        thin[f"the wall of {room:.3g} mm that the mark leaves at its corner (--mark)"] = room
    if frame.vents:
        gap = frame.vent_gap_mm
        thin[f"a vent of {frame.vent_width_mm:g} mm (--vent-width)"] = frame.vent_width_mm
        thin[f"the wall of {gap:.3g} mm between vents (--vents)"] = gap
    for what, size in thin.items():
        if size < smallest - _SLACK_MM:
            raise OptionError(
                f"{what} is thinner than the printer's smallest feature of {smallest:g} mm: give "
                f"{smallest:g} mm or more, or what a finer printer makes (--smallest)"
            )
    bed = sorted(printer.bed_mm)
    outer = sorted((frame.outer_width_mm, frame.outer_height_mm))
    if any(size > most + _SLACK_MM for size, most in zip(outer, bed, strict=True)):
        raise OptionError(
            f"the frame of {frame.outer_width_mm:.5g} × {frame.outer_height_mm:.5g} mm is larger "
            f"than the printer's bed of {printer.bed_mm[0]:g} × {printer.bed_mm[1]:g} mm: give a "
            "larger one (--bed), or a smaller wall or package"
        )


def is_air(layer: Layer) -> bool:
    """Whether a layer is a gap."""
    return layer.material == "air" or layer.index == 1
