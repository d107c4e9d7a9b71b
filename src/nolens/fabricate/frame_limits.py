"""What a frame's measures must keep to, and a printer's limits."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from nolens.errors import OptionError

if TYPE_CHECKING:
    from nolens.fabricate.frame import FrameGeometry

_SLACK_MM = 1e-9
"""Measures that were parsed from decimal text may miss a limit by their rounding."""


@dataclass(frozen=True)
class Printer:
    """What a printer can make.

    Parameters
    ----------
    smallest_mm
        Thinnest wall and narrowest channel.
    bed_mm
        (width, depth) of its bed.
    """

    smallest_mm: float = 0.4
    bed_mm: tuple[float, float] = (120.0, 68.0)


def check_sizes(frame: "FrameGeometry") -> None:
    """Refuse measures that no length has.

    Raises
    ------
    OptionError
        If one is negative, or zero where it must not be.
    """
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


def check_rim_and_vents(frame: "FrameGeometry") -> None:
    """Refuse a rim and vents that the wall has no room for.

    Raises
    ------
    OptionError
        If the rim takes the whole wall's top, the resin would run out below the glass, or the
        vents stand in each other's way.
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


def check_printer(frame: "FrameGeometry", printer: Printer) -> None:
    """Refuse a frame that a printer cannot make.

    Raises
    ------
    OptionError
        If a part is thinner than its smallest feature, or the frame larger than its bed.
    """
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
