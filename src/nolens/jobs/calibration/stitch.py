"""`nolens calibrate stitch`: captured PSFs of a folder become one beyond the sensor."""

import math
from collections import Counter
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from torch import Tensor

from nolens.calibrate.distances import Layers
from nolens.calibrate.stitch import (
    STATED_DEG,
    Capture,
    Stitched,
    locate,
    search_um,
    stitch,
)
from nolens.calibrate.stitch_place import Placement
from nolens.camera import PsfEntry, PsfSet
from nolens.camera.psf_set import Depth
from nolens.errors import DataError, OptionError
from nolens.files import CAMERA_FILE, PSFS_FILE, read_psf, read_psf_set, readable
from nolens.jobs.calibration.fields import NEEDED_FOLDER, FolderOptions, Reduced, distance_name
from nolens.jobs.calibration.folder import added, folder_camera
from nolens.jobs.fields import FilePath
from nolens.jobs.options import Option, Written
from nolens.jobs.run import Product, Run, job
from nolens.quantities import Length

_REDUCED_SHARE = 0.15
"""How far a reduced thickness alone may put a pattern off its place; at 37° it is 11 %."""
_PLAN = "nolens calibrate plan CAMERA --angle 56deg lists the angles for a scene of 56°"
_OFF_DEG = 1.5
_MISFIT_CELLS = 1.0
_UNKNOWN_SHARE = 0.1


class CalibrateStitchOptions(FolderOptions):
    """Merge PSFs that were captured at several angles into an extended one, beyond the sensor.

    nolens calibrate stitch mycamera

    nolens reconstruct raw.dng --psf mycamera/stitched-300mm.tif --psf-extent wide --support 414x414

    A camera without an aperture sees light through mask that the PSF from straight ahead does
    not show. Point sources from the side move the pattern, so that the sensor sees its other
    parts: nolens calibrate plan lists the angles. They need be right to 3° only: each PSF is
    placed by what it has in common with the others.
    """

    usage = "calibrate stitch FOLDER"

    folder: Annotated[
        FilePath,
        Option(
            "Of the camera's PSFs, as nolens calibrate makes it, with one from straight ahead and "
            "others at angles (--angle).",
            needed=NEEDED_FOLDER,
            role="input",
            positional=True,
        ),
    ]
    distance: Annotated[
        Depth | None,
        Option("Of the point sources.", default="the only one that was captured at angles"),
    ] = None
    reduced: Reduced = None

    @property
    def record(self) -> Path | None:
        """File of the run's record; None until the distance in its name is known."""
        if self.distance is None:
            return None
        return self.folder / f"stitch-{distance_name(self.distance)}.json"

    @property
    def written(self) -> tuple[Written, ...]:
        """PSF, list and record, once the distance in their names is known."""
        if self.distance is None or self.record is None:
            return ()
        return (
            Written("PSF", self.folder / _psf_file(self.distance), "FOLDER"),
            Written("list of PSFs", self.folder / PSFS_FILE, "FOLDER"),
            Written("record of the run", self.record, "FOLDER"),
        )


def _psf_file(distance: Length | Literal["infinity"]) -> str:
    return f"stitched-{distance_name(distance)}.tif"


@dataclass(frozen=True)
class Captured:
    """PSFs that were captured of lights at one distance.

    Parameters
    ----------
    entries
        As the folder lists them.
    reference
        Number of the one from straight ahead.
    distance
        Of the lights.
    """

    entries: tuple[PsfEntry, ...]
    reference: int
    distance: Length | Literal["infinity"]


def chosen(options: CalibrateStitchOptions, psfs: PsfSet) -> Captured:
    """The PSFs to stitch.

    Raises
    ------
    OptionError
        If it is not clear which distance is meant.
    DataError
        If there are too few of it, or they cannot be stitched.
    """
    captured = [each for each in psfs.psf if each.kind == "captured"]
    distance = options.distance or _distance(options, captured)
    entries = tuple(each for each in captured if each.distance == distance)
    if not entries:
        have = ", ".join(sorted({str(each.distance) for each in captured})) or "no distance"
        raise OptionError(
            f"--distance {distance}: {options.folder} has captured PSFs of {have}; choose one"
        )
    ahead = [number for number, each in enumerate(entries) if each.on_axis]
    if not ahead:
        raise DataError(
            f"{options.folder} has no captured PSF of a light straight ahead at {distance}, which "
            "all others are laid on: add it with nolens calibrate FRAME... --distance "
            f"{_joined(distance)} -o {options.folder}"
        )
    if len(entries) == 1:
        raise DataError(
            f"{options.folder} has only the PSF of a light straight ahead at {distance}: capture "
            f"others at angles (nolens calibrate FRAME... --angle 28deg,0deg). {_PLAN}"
        )
    for each in entries:
        if not each.on_axis and each.frame != "sensor":
            raise DataError(
                f"{each.file} was moved to the middle, and what the sensor saw at its edges is "
                "lost: calibrate its frames again, so that it stays as captured (frame = "
                '"sensor")'
            )
    return Captured(entries, ahead[0], distance)


def stack_of(options: CalibrateStitchOptions) -> tuple[Layers, float]:
    """The layers, and the share by which they may put a pattern off.

    Raises
    ------
    OptionError
        If nothing says how far an angle moves the pattern, or two do.
    """
    opened = folder_camera(options.folder)
    if opened is not None and options.reduced is not None:
        raise OptionError(
            f"--reduced {options.reduced}: the folder has a {CAMERA_FILE}, whose layers say the "
            "same. Leave --reduced out, or mend the layers"
        )
    if opened is not None:
        return Layers.of_camera(opened.camera), 0.0
    if options.reduced is None:
        raise OptionError(
            f"the folder has no {CAMERA_FILE}: give the reduced thickness between mask and sensor, "
            "the sum of thickness / index of all layers (--reduced 1.28mm)"
        )
    return Layers.of_air(options.reduced.um), _REDUCED_SHARE


def _distance(
    options: CalibrateStitchOptions, captured: list[PsfEntry]
) -> Length | Literal["infinity"]:
    """The only distance with lights from the side."""
    aside = Counter(each.distance for each in captured if not each.on_axis)
    if not aside:
        raise DataError(
            f"{options.folder} has no captured PSF of a light from the side: add some (nolens "
            f"calibrate FRAME... --angle 28deg,0deg). {_PLAN}"
        )
    if len(aside) > 1:
        have = ", ".join(sorted(str(each) for each in aside))
        raise OptionError(
            f"{options.folder} has PSFs at angles of several distances ({have}): say which "
            "(--distance)"
        )
    return next(iter(aside))


def _joined(distance: Length | Literal["infinity"]) -> str:
    return str(distance).replace(" ", "")


@job
def calibrate_stitch(run: Run[CalibrateStitchOptions]) -> Product[Tensor]:
    """Register the captured PSFs of one distance, merge them, and add the result to their folder.

    Raises
    ------
    NolensError
        If the folder or an option cannot be used; then nothing is written.
    """
    reporter = run.reporter
    captured = chosen(run.options, read_psf_set(run.options.folder))
    options = run.options = run.options.model_copy(update={"distance": captured.distance})
    layers, inexact = stack_of(options)
    run.reads({f"PSF {each.file}": options.folder / each.file for each in captured.entries})
    if (options.folder / CAMERA_FILE).is_file():
        run.reads({"camera": options.folder / CAMERA_FILE})
    captures = [
        Capture.at_angle(
            read_psf(options.folder, each), each.angle, layers, each.cell.um, inexact=inexact
        )
        for each in captured.entries
    ]
    _check_sizes(captures, captured)
    run.begin()
    placement = locate(captures, captured.reference, partial(reporter.advance, "overlaps"))
    _check_placement(placement, captured)
    tick = partial(reporter.advance, "merging")
    found = stitch(captures, placement, captured.reference, tick)

    first = captured.entries[0]
    usable = [each.usable_per_mm for each in captured.entries]
    entry = PsfEntry(
        file=_psf_file(captured.distance),
        cell=first.cell,
        channels=first.channels,
        distance=captured.distance,
        kind="stitched",
        usable_per_mm=min((each for each in usable if each is not None), default=None),
    )
    rows = _rows(captures, captured, found, layers)
    run.warn(*_warnings(rows, found))
    figures = {
        "folder": readable(options.folder),
        "distance": str(captured.distance),
        "file": entry.file,
        "sensor_cells": list(captures[0].psf.shape[-2:]),
        "cells": list(found.psf.shape[-2:]),
        "region": list(found.region),
        "known_share": round(found.known_share, 6),
        "misfit_cells": round(placement.misfit, 4),
        "captures": rows,
    }
    return added(found.psf, figures, options.folder, {entry: found.psf})


def _check_sizes(captures: list[Capture], captured: Captured) -> None:
    first = captures[0].psf.shape
    for capture, entry in zip(captures, captured.entries, strict=True):
        if capture.psf.shape != first:
            raise DataError(
                f"{entry.file} has {capture.psf.shape[-2]}×{capture.psf.shape[-1]} cells, but "
                f"{captured.entries[0].file} {first[-2]}×{first[-1]}: stitch PSFs of one camera "
                "and setting; calibrate the other one again"
            )
        if not float(capture.psf.sum()) > 0:
            raise DataError(f"{entry.file} is dark: calibrate it again")


def _check_placement(placement: Placement, captured: Captured) -> None:
    for shift, correlation, entry in zip(
        placement.shifts, placement.correlations, captured.entries, strict=True
    ):
        if shift is None:
            raise DataError(
                f"{entry.file} does not fit the others: where it should overlap them by its angle "
                f"({entry.angle[0]}, {entry.angle[1]}), the best correlation is {correlation:.2f}. "
                "Its angle or its sign is wrong, or it is of another camera: calibrate it again, "
                f"or take it out of {PSFS_FILE}"
            )


def _rows(
    captures: list[Capture], captured: Captured, found: Stitched, layers: Layers
) -> list[dict[str, Any]]:
    """Figures of each capture; lengths and angles to the right and up."""
    rows: list[dict[str, Any]] = []
    for number, (capture, entry) in enumerate(zip(captures, captured.entries, strict=True)):
        shift = found.placement.shifts[number]
        assert shift is not None
        cell = entry.cell.um
        stated = capture.expected[1] * cell, -capture.expected[0] * cell
        seen = shift[1] * cell, -shift[0] * cell
        off = math.dist(stated, seen)
        slope = search_um(entry.angle, layers) / STATED_DEG
        rows.append(
            {
                "file": entry.file,
                "angle": [str(each) for each in entry.angle],
                "stated_shift_um": [round(each, 2) + 0.0 for each in stated],
                "shift_um": [round(each, 2) + 0.0 for each in seen],
                "off_um": round(off, 2),
                "off_deg": round(off / slope, 3),
                "gain": [round(each, 5) for each in found.gains[number]],
                "correlation": round(found.placement.correlations[number], 5),
            }
        )
    return rows


def _warnings(rows: list[dict[str, Any]], found: Stitched) -> list[str]:
    texts = [
        f"{row['file']} lies {row['off_um']:.0f} µm beside where its angle of "
        f"{', '.join(row['angle'])} puts it, about {row['off_deg']:.1f}°: check the angle, and "
        "the layers of the camera if others are off alike"
        for row in rows
        if row["off_deg"] > _OFF_DEG
    ]
    if found.placement.misfit > _MISFIT_CELLS:
        texts.append(
            f"the overlaps disagree by {found.placement.misfit:.1f} cells about where the PSFs "
            "lie: was the camera moved or turned between the captures?"
        )
    if 0 in found.region:
        texts.append(
            "no scene around the middle has its whole PSF seen: capture the opposite angles too, "
            "and the corners"
        )
    if found.known_share < 1 - _UNKNOWN_SHARE:
        texts.append(
            f"{100 * (1 - found.known_share):.0f} % of the stitched PSF was seen by none, and has "
            "the mean light around it: capture more angles, also in the corners"
        )
    return texts
