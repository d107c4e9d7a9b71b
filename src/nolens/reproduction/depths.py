"""Fig. 8: how the PSF grows as its source comes nearer, and objects refocused."""

import math
from collections.abc import Mapping
from functools import partial
from typing import Any

import torch
from torch import Tensor

from nolens.calibrate.registration import register
from nolens.camera import develop, exposure_white
from nolens.evaluate import scale_fit
from nolens.experiments.virtual_experiment import solved
from nolens.files.plot_reproduction import Panel, plot_overlay, plot_pictures
from nolens.files.reports import ReportRow
from nolens.operators import PixelRectangle
from nolens.optics import PointSource
from nolens.progress import ProgressCallback, part_of, within
from nolens.refocusing import (
    Autofocus,
    DepthReconstructor,
    PsfAt,
    PsfBetween,
    reduced_um,
    sharpness,
)
from nolens.reproduction.comparison import PAPER, Content, Picture, Results, paper_row, section
from nolens.reproduction.setup import PINHOLE_UM, TAU, ExperimentSetup
from nolens.reproduction.steps import Step, StepResult
from nolens.twin import FieldMap, Plane

_REFERENCE_MM, _NEAR_MM = 200.0, (30.0, 80.0)
_FAR_MM = 300.0
_OBJECTS_MM = (80.0, 200.0)
_KNOWN_MM = (50.0, 500.0)
_ANGLE_DEG = 40.0
_CORNER_PIXELS = 300
_WINDOW_PIXELS, _EDGE_PIXELS = 2.0, 6
_SEARCHED, _SEARCH_ITERATIONS = 6.5, 60
"""One search, in reconstructions of so many iterations: some twelve depths on coarser pixels."""
_MAGNIFIED = ("magnification 8", "magnification 3", "magnification 30")
_OBJECTS = ("near object", "far object")


def steps(setup: ExperimentSetup) -> tuple[Step, ...]:
    """Magnification of the PSF, and a photograph of two objects refocused."""
    support = _support(setup)
    solving = setup.solve_work(support, setup.size.iterations)
    searching = _SEARCHED * setup.solve_work(support, _SEARCH_ITERATIONS)
    return (
        Step(
            "magnification",
            "fig. 8a: PSFs at four distances",
            setup.parameters(),
            8 * setup.psf_work(),
            lambda progress: _magnified(setup, progress),
        ),
        Step(
            "refocus",
            "fig. 8b–e: two objects, refocused",
            setup.parameters(tau=TAU),
            2 * (setup.scene_work() + solving + searching),
            lambda progress: _refocused(setup, progress),
        ),
    )


def _magnified(setup: ExperimentSetup, progress: ProgressCallback) -> StepResult:
    """How much larger the PSF is at each distance, by registering it on that of 20 cm."""
    distances = (_REFERENCE_MM, *_NEAR_MM, _FAR_MM, math.inf)
    psfs = []
    for number, distance_mm in enumerate(distances):
        size = 0.0 if math.isinf(distance_mm) else PINHOLE_UM
        source = PointSource(distance_um=1e3 * distance_mm, diameter_um=size)
        part = part_of(progress, number, len(distances))
        psfs.append(setup.experiment.psf(source, progress=part))
    reduced_mm = setup.experiment.twin.stack().reduced_um * 1e-3
    own = 1 + reduced_mm / _REFERENCE_MM
    figures: dict[str, Any] = {"reduced_mm": reduced_mm}
    for distance_mm, psf in zip(distances[1:], psfs[1:], strict=True):
        expected = (1 + reduced_mm / distance_mm) / own
        placed = register(psf, psfs[0], magnification=expected)
        figures[f"{distance_mm:g}"] = {
            "larger": placed.magnification - 1,
            "by_rays": expected - 1,
            "correlation": placed.correlation,
        }
    corner = [_corner(psf.sum(dim=0)) for psf in (psfs[1], psfs[2], psfs[0])]
    return StepResult(figures, {"overlay": torch.stack(corner)})


def _corner(psf: Tensor) -> Tensor:
    """The middle of the right edge, where a magnification moves the PSF most."""
    rows, columns = psf.shape
    size = min(rows, columns, _CORNER_PIXELS)
    top = (rows - size) // 2
    return psf[top : top + size, columns - size :]


def _planes(setup: ExperimentSetup) -> tuple[Plane, ...]:
    """A near object to the left, in front of a far picture that is seen to the right of it."""
    near, far = (setup.picture(name) for name in ("chelsea", "astronaut"))
    rows, columns = near.shape[-2:]
    square = near[:, :, columns - rows :] if columns > rows else near
    side = square.shape[-1]
    picture = torch.zeros(len(near), side, 2 * side)
    picture[:, :, :side] = square
    opacity = torch.zeros(side, 2 * side)
    opacity[:, :side] = 1.0
    wide = torch.zeros(len(far), far.shape[-2], 2 * far.shape[-1])
    wide[:, :, far.shape[-1] :] = far
    return (
        Plane(picture, _ANGLE_DEG, 1e3 * _OBJECTS_MM[0], opacity),
        Plane(wide, _ANGLE_DEG, 1e3 * _OBJECTS_MM[1]),
    )


def _support(setup: ExperimentSetup) -> PixelRectangle:
    longer = math.tan(math.radians(_ANGLE_DEG) / 2)
    return FieldMap.covering(setup.preview, (longer / 2, longer)).support


def _refocused(setup: ExperimentSetup, progress: ProgressCallback) -> StepResult:
    """One frame of both objects: the depth of each by autofocus, and both pictures.

    The search knows PSFs of two other distances, nearer and farther than both objects.
    """
    shot = setup.experiment.measure(
        _planes(setup), seed=setup.seed, progress=within(progress, 0.0, 0.4)
    )
    truth = shot.truth * shot.response
    known = [PsfAt(setup.wide_psf(1e3 * each, shot.support), 1e3 * each) for each in _KNOWN_MM]
    progress(0.45)
    reconstructor = DepthReconstructor(
        develop(shot.frame), shot.support, TAU, iterations=setup.size.iterations
    )
    twin = setup.experiment.twin
    distance_um = twin.stack().reduced_um
    focus_per_m = known[-1].depth_of_focus_per_m(distance_um, twin.shape)
    between = PsfBetween.of(known, distance_um)
    search = Autofocus(
        reconstructor, between.at, known[0].distance_um, known[1].distance_um, focus_per_m
    )
    figures: dict[str, Any] = {"depth_of_focus_per_m": focus_per_m, "objects": []}
    arrays = {"truth": truth}
    rows, columns = truth.shape[-2:]
    for number, distance_mm in enumerate(_OBJECTS_MM):
        before = 0.45 + 0.275 * number

        def step(done: int, limit: int, before: float = before) -> bool:
            progress(before + 0.1 * done / limit)
            return False

        focus = search.run((rows / 2, columns * (1 + 2 * number) / 4), step)
        picture = solved(
            shot.frame,
            setup.wide_psf(1e3 * distance_mm, shot.support),
            shot.support,
            iterations=setup.size.iterations,
            tau=TAU,
            progress=within(progress, before + 0.1, 0.175),
        )
        arrays[f"at-{distance_mm:g}mm"] = scale_fit(picture, truth)
        figures["objects"].append(
            {
                "distance_mm": distance_mm,
                "depth_mm": focus.depth_um * 1e-3,
                "tried": [
                    {
                        "depth_mm": each.depth_um * 1e-3,
                        "sharpness": each.sharpness,
                        "objective": each.objective,
                    }
                    for each in focus.tried
                ],
            }
        )
    return StepResult({**figures, "halves": _halves(arrays)}, arrays)


def _halves(arrays: dict[str, Tensor]) -> dict[str, list[float]]:
    """Energy of the gradient of the near object's half and of the far one's, in both pictures."""
    halves = {}
    for distance_mm in _OBJECTS_MM:
        picture = arrays[f"at-{distance_mm:g}mm"]
        middle = picture.shape[-1] // 2
        energy = sharpness(picture, _WINDOW_PIXELS)
        # Pixels at the edge between the objects belong to neither.
        parts = energy[:, : middle - _EDGE_PIXELS], energy[:, middle + _EDGE_PIXELS :]
        halves[f"{distance_mm:g}"] = [float(part.mean()) for part in parts]
    return halves


@section("magnification", "Fig. 8a: the PSF at other distances", _MAGNIFIED, ("magnification",))
def magnification(setup: ExperimentSetup, results: Results) -> Content:
    """PSFs at 3, 8 and 20 cm, and beyond 30 cm."""
    figures, camera = results["magnification"].figures, setup.loaded.camera
    reduced_mm = figures["reduced_mm"]
    cover_mm = 1e-3 * reduced_um(camera, camera.mask.surface + 1)
    rows = []
    for distance_mm in reversed(_NEAR_MM):
        key = f"magnification {distance_mm / 10:g}"
        each = figures[f"{distance_mm:g}"]
        value = 100 * each["larger"]
        printed = (PAPER[key].value or 0.0) / 100
        implied_mm = printed / (1 / distance_mm - 1 / _REFERENCE_MM)
        rows.append(
            paper_row(
                key,
                value,
                f"{value:.2f} %",
                "By registering one PSF on the other; 1 + D/z with the stack's D = "
                f"{reduced_mm:.2f} mm gives {100 * each['by_rays']:.2f} %. "
                "The paper's figure would be that of "
                f"D = {implied_mm:.2f} mm"
                + (
                    ", as its other one would; but the cover glass and the air below it alone are "
                    f"{cover_mm:.2f} mm. Its two figures agree with each other, not with its "
                    "camera: the distances or the way it measured are not what they are said to be."
                    if distance_mm == _NEAR_MM[-1]
                    else "."
                ),
            )
        )
    far = 100 * ((1 + figures[f"{_FAR_MM:g}"]["larger"]) / (1 + figures["inf"]["larger"]) - 1)
    sensor = camera.sensor
    half_um = max(sensor.rows, sensor.columns) / 2 * sensor.pitch.um
    rows.append(
        paper_row(
            "magnification 30",
            far,
            f"{far:.2f} %",
            f"At the edge of the whole sensor that is {far / 100 * half_um:.0f} µm, no more than a "
            "line of the PSF is wide: a registration finds it, the eye hardly does.",
        )
    )
    draw = partial(
        plot_overlay,
        psfs=results["magnification"].arrays["overlay"],
        names=("3 cm", "8 cm", "20 cm"),
        pixel_um=setup.preview.pixel_um,
    )
    caption = (
        "The PSF at the middle of the sensor's right edge for a point source at three "
        "distances, binarised and laid over each other as in fig. 8a. Where all agree it is black."
    )
    return Content(tuple(rows), (Picture("magnification", caption, draw, 100.0),))


@section("refocus", "Fig. 8b–e: two objects, refocused", _OBJECTS, ("refocus",))
def refocus(setup: ExperimentSetup, results: Results) -> Content:
    """Two objects, each in focus in its own picture."""
    arrays = results["refocus"].arrays
    white = exposure_white(arrays["truth"])
    near, far = (f"at-{distance_mm:g}mm" for distance_mm in _OBJECTS_MM)
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
        _object_row(key, number, results["refocus"].figures) for number, key in enumerate(_OBJECTS)
    )
    return Content(rows, (Picture("refocus", caption, draw),))


def _object_row(key: str, number: int, figures: Mapping[str, Any]) -> ReportRow:
    """Where an object was found, and how much better it comes out with its own PSF."""
    own, other = _OBJECTS_MM[number], _OBJECTS_MM[1 - number]
    depth_mm = figures["objects"][number]["depth_mm"]
    half = figures["depth_of_focus_per_m"] / 2
    ends = [1e2 / max(1e3 / own + side * half, 1e-9) for side in (1, -1)]
    far = f"{ends[1]:.1f} cm" if ends[1] < 1e4 else "infinity"
    sharp, blurred = (figures["halves"][f"{at:g}"][number] for at in (own, other))
    return paper_row(
        key,
        depth_mm / 10,
        f"{depth_mm / 10:.1f} cm",
        f"Found by itself as the depth at which this object is sharpest, from PSFs at 5 and 50 cm "
        f"alone. The PSF's edge moves by one line between {ends[0]:.1f} and {far}: that is "
        f"the depth of focus. With its own PSF the object's gradients have {sharp / blurred:.2f} "
        "times the energy that they have with the other one's.",
        sized=True,
    )
