"""The printed frame around a sensor: its measures, from the package and the camera's layers."""

import math
from dataclasses import dataclass
from typing import Self

from nolens.camera import Camera, Package
from nolens.errors import OptionError
from nolens.fabricate.frame_limits import Printer, check_printer, check_rim_and_vents, check_sizes
from nolens.fabricate.poured import poured_layer

_RIM_SHARE, _MARK_SHARE = 0.3, 0.8
_VENT_DEPTH_MM, _VENT_SHARE = 0.25, 0.25


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
        check_sizes(self)
        check_rim_and_vents(self)
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
            rim_mm = min(_RIM_SHARE * wall_mm, spare, layer_mm / 2)
        if mark_mm is None:
            seat = wall_mm - rim_mm
            room = 2 * seat - math.sqrt(2) * printer.smallest_mm
            mark_mm = max(0.0, min(_MARK_SHARE * wall_mm, room))
        if vent_depth_mm is None:
            vent_depth_mm = min(_VENT_DEPTH_MM, _VENT_SHARE * layer_mm)
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
        check_printer(frame, printer)
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
