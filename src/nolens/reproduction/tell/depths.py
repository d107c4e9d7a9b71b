"""Fig. 8 beside the paper's: the PSF at other distances, and refocusing."""

from collections.abc import Mapping
from functools import partial
from typing import Any

from nolens.camera import exposure_white
from nolens.files.plot_reproduce import plot_overlay
from nolens.files.plot_reproduce_pictures import Panel, plot_pictures
from nolens.reproduction.depths import FAR_MM, NEAR_MM, OBJECTS_MM, REFERENCE_MM
from nolens.reproduction.paper import PAPER
from nolens.reproduction.rows import Row
from nolens.reproduction.steps import Found
from nolens.reproduction.tell.draft import Draft, Drawn, empty, refusal
from nolens.reproduction.workbench import Workbench

_MAGNIFIED = ("magnification 8", "magnification 3", "magnification 30")
_OBJECTS = ("near object", "far object")


def magnification(work: Workbench, found: Mapping[str, Found]) -> Draft:
    """PSFs at 3, 8 and 20 cm, and beyond 30 cm."""
    title = "Fig. 8a: the PSF at other distances"
    reason = refusal(found, ("magnification",))
    if reason is not None:
        return empty("magnification", title, _MAGNIFIED, reason)
    figures = found["magnification"].figures
    reduced_mm = figures["reduced_mm"]
    rows = []
    for distance_mm in reversed(NEAR_MM):
        key = f"magnification {distance_mm / 10:g}"
        each = figures[f"{distance_mm:g}"]
        value = 100 * each["larger"]
        printed = (PAPER[key].value or 0.0) / 100
        implied = printed / (1 / distance_mm - 1 / REFERENCE_MM)
        rows.append(
            Row(
                key,
                value,
                f"{value:.2f} %",
                "By registering one PSF on the other; 1 + D/z with the stack's D = "
                f"{reduced_mm:.2f} mm gives {100 * each['by_rays']:.2f} %. "
                "The paper's figure would be that of "
                f"D = {implied:.2f} mm"
                + (
                    ", as its other one would; but the cover glass and the air below it alone are "
                    f"{_cover_mm(work):.2f} mm. Its two figures agree with each other, not with "
                    "its camera: the distances or the way it measured are not what they are said "
                    "to be."
                    if distance_mm == NEAR_MM[-1]
                    else "."
                ),
            )
        )
    far = 100 * ((1 + figures[f"{FAR_MM:g}"]["larger"]) / (1 + figures["inf"]["larger"]) - 1)
    sensor = work.opened.camera.sensor
    half_um = max(sensor.rows, sensor.columns) / 2 * sensor.pitch.um
    rows.append(
        Row(
            "magnification 30",
            far,
            f"{far:.2f} %",
            f"At the edge of the whole sensor that is {far / 100 * half_um:.0f} µm, no more than a "
            "line of the PSF is wide: a registration finds it, the eye hardly does.",
        )
    )
    draw = partial(
        plot_overlay,
        patterns=found["magnification"].arrays["overlay"],
        names=("3 cm", "8 cm", "20 cm"),
        cell_um=work.preview.cell_um,
    )
    caption = (
        "The PSF at the middle of the sensor's right edge for a point source at three "
        "distances, binarised and laid over each other as in fig. 8a. Where all agree it is black."
    )
    return Draft(
        "magnification", title, (), (Drawn("magnification", caption, draw, 100.0),), tuple(rows)
    )


def _cover_mm(work: Workbench) -> float:
    """Reduced thickness of what lies below the mask's own layer."""
    camera = work.opened.camera
    indices = camera.indices(550.0)
    below = range(camera.mask.surface + 1, len(camera.layers))
    return sum(camera.layers[place].thickness.mm / indices[place] for place in below)


def refocus(work: Workbench, found: Mapping[str, Found]) -> Draft:
    """Two objects, each in focus in its own picture."""
    title = "Fig. 8b–e: two objects, refocused"
    reason = refusal(found, ("refocus",))
    if reason is not None:
        return empty("refocus", title, _OBJECTS, reason)
    arrays = found["refocus"].arrays
    white = exposure_white(arrays["truth"])
    near, far = (f"at-{distance_mm:g}mm" for distance_mm in OBJECTS_MM)
    panels = (
        Panel("the scene: near | far", arrays["truth"], white),
        Panel("focused at 8 cm", arrays[near], white),
        Panel("focused at 20 cm", arrays[far], white),
    )
    caption = (
        "A cat at 8 cm (left) and an astronaut at 20 cm (right) stand for the paper's doll and "
        "book; one frame, solved with the PSF of each distance."
    )
    draw = partial(plot_pictures, panels=panels)
    rows = tuple(
        _object_row(key, number, found["refocus"].figures) for number, key in enumerate(_OBJECTS)
    )
    return Draft("refocus", title, (), (Drawn("refocus", caption, draw),), rows)


def _object_row(key: str, number: int, figures: Mapping[str, Any]) -> Row:
    """Where an object was found, and how much better it comes out with its own PSF."""
    own, other = OBJECTS_MM[number], OBJECTS_MM[1 - number]
    found_mm = figures["objects"][number]["found_mm"]
    half = figures["depth_of_focus_per_m"] / 2
    ends = [1e2 / max(1e3 / own + side * half, 1e-9) for side in (1, -1)]
    far = f"{ends[1]:.1f} cm" if ends[1] < 1e4 else "infinity"
    sharp, blurred = (figures["halves"][f"{at:g}"][number] for at in (own, other))
    return Row(
        key,
        found_mm / 10,
        f"{found_mm / 10:.1f} cm",
        f"Found by itself as the depth at which this object is sharpest, from PSFs at 5 and 50 cm "
        f"alone. The pattern's edge moves by one line between {ends[0]:.1f} and {far}: that is "
        f"the depth of focus. With its own PSF the object's gradients have {sharp / blurred:.2f} "
        "times the energy that they have with the other one's.",
        sized=True,
    )
