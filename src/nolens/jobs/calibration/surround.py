"""`nolens calibrate surround`: a captured PSF that goes on beyond the sensor."""

from pathlib import Path
from typing import Annotated, Literal

import torch
from torch import Tensor

from nolens.calibrate.surround import Extended, extend, filled, steps
from nolens.camera import Measurement, PsfEntry, PsfSet, develop
from nolens.camera.psf_set import Depth
from nolens.errors import DataError, OptionError
from nolens.files import PSFS_FILE, read_frame, read_psf, read_psf_set, readable
from nolens.jobs.calibration.fields import FolderOptions, distance_name
from nolens.jobs.calibration.folder import added
from nolens.jobs.fields import Files, Window
from nolens.jobs.options import Option, Written
from nolens.jobs.reconstruction.options import parse_window
from nolens.jobs.run import Product, Run, job
from nolens.operators import Region
from nolens.quantities import Length
from nolens.ranges import Between

_TAU = 1e-5


class CalibrateSurroundOptions(FolderOptions):
    """Extrapolate a captured PSF beyond the sensor, without further captures.

    nolens calibrate surround mycamera raw1.dng raw2.dng --support 414x414

    nolens reconstruct raw1.dng --psf mycamera/extended-300mm.tif --psf-extent wide
    --support 414x414

    For a camera without an aperture. Without pictures, the PSF goes on with its mean light; that
    alone is worth most. From pictures of ordinary scenes the pattern itself is estimated together
    with the scenes, where they show it: scenes that fill a small part of the sensor do. Captures
    at angles give more than either (nolens calibrate stitch).

    Ctrl-C ends it after a step, and the PSF so far is written.
    """

    usage = "calibrate surround FOLDER RAW... --support 414x414"

    pictures: Annotated[
        Files,
        Option(
            "Raw frames of different scenes, whose light comes from the support only.",
            role="input",
            positional=True,
        ),
    ] = ()
    support: Annotated[
        Window,
        Option(
            "Support of the scene, where its light comes from: HEIGHTxWIDTH in scene pixels, "
            "around the middle, or +TOP+LEFT after it; nolens calibrate plan tells it for an "
            "angle.",
            needed="the support of the scene, where its light comes from, in pixels (--support "
            "414x414; nolens calibrate plan CAMERA --angle 56deg tells it for an angle)",
            former="region",
        ),
    ]
    distance: Annotated[
        Depth | None, Option("Of the PSF to extrapolate.", default="the only captured one")
    ] = None
    rounds: Annotated[
        int, Between(1, 100), Option("Turns in which scenes and PSF are estimated.")
    ] = 4

    def check_together(self) -> None:
        """Refuse a picture that is given twice."""
        if len(set(self.pictures)) < len(self.pictures):
            raise OptionError("a picture is given twice: it counts once")

    @property
    def record(self) -> Path | None:
        """File of the run's record; None until the distance in its name is known."""
        if self.distance is None:
            return None
        return self.folder / f"extend-{distance_name(self.distance)}.json"

    @property
    def inputs(self) -> dict[str, Path]:
        """Pictures, by role."""
        return {f"picture {number}": path for number, path in enumerate(self.pictures, start=1)}

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
    return f"extended-{distance_name(distance)}.tif"


@job
def calibrate_surround(run: Run[CalibrateSurroundOptions]) -> Product[Tensor]:
    """Extrapolate a captured PSF beyond the sensor, and add the result to its folder.

    The reporter can stop it after a step.

    Raises
    ------
    NolensError
        If the folder, a picture or an option cannot be used; then nothing is written.
    """
    reporter = run.reporter
    source = _source(run.options, read_psf_set(run.options.folder))
    options = run.options = run.options.model_copy(update={"distance": source.distance})
    psf = read_psf(options.folder, source)
    if not float(psf.sum()) > 0:
        raise DataError(f"{source.file} is dark: calibrate it again")
    sensor = (psf.shape[-2], psf.shape[-1])
    region = parse_window(options.support, sensor, "--support")
    _check_region(region, sensor)
    run.reads({f"PSF {source.file}": options.folder / source.file})
    pictures = [_picture(options, number, psf, source) for number in range(len(options.pictures))]
    run.begin()
    wide = filled(psf, region)
    stopped = False

    def step(done: int) -> bool:
        nonlocal stopped
        limit = steps(options.rounds, len(pictures))
        stopped = reporter.step("step", done, limit, "the PSF")
        return stopped

    found = Extended(wide, False, ())
    if pictures:
        step(0)
        found = extend(psf, pictures, region, rounds=options.rounds, tau=_TAU, step=step)
    run.warn(*_warnings(found))
    entry = PsfEntry(
        file=_psf_file(source.distance),
        cell=source.cell,
        channels=source.channels,
        distance=source.distance,
        kind="extended",
        usable_per_mm=source.usable_per_mm,
    )
    figures = {
        "folder": readable(options.folder),
        "from": source.file,
        "file": entry.file,
        "cells": list(found.psf.shape[-2:]),
        "region": [region.height, region.width],
        "surround": "pictures" if found.found else "mean light",
        "rounds": max(0, len(found.misfit) - 1),
        "misfit": [round(each, 7) for each in found.misfit],
        "interrupted": stopped,
    }
    return added(found.psf, figures, options.folder, {entry: found.psf})


def _source(options: CalibrateSurroundOptions, psfs: PsfSet) -> PsfEntry:
    """The captured PSF that is extended."""
    there = [each for each in psfs.by_distance(("captured",)) if each.frame == "chief-ray"]
    if not there:
        raise DataError(
            f"{options.folder} has no captured PSF of a light straight ahead: add one first, with "
            "nolens calibrate FRAME... --distance 300mm"
        )
    have = ", ".join(str(each.distance) for each in there)
    if options.distance is None and len(there) > 1:
        raise OptionError(
            f"{options.folder} has captured PSFs of several distances ({have}): say which is "
            "nearest to the pictures' (--distance)"
        )
    for each in there:
        if options.distance in (None, each.distance):
            return each
    raise OptionError(
        f"--distance {options.distance}: {options.folder} has captured PSFs of {have}; choose one"
    )


def _check_region(region: Region, sensor: tuple[int, int]) -> None:
    starts, sizes = (region.top, region.left), (region.height, region.width)
    for start, size, count in zip(starts, sizes, sensor, strict=True):
        if size > count or start + size <= 0 or start >= count:
            raise OptionError(
                f"--support {size} cells from cell {start} on: light must fall on the sensor's "
                f"{count} cells through the middle of the PSF, and cover no more of them than "
                "there are; nolens calibrate plan CAMERA --angle 56deg tells the region"
            )


def _picture(
    options: CalibrateSurroundOptions, number: int, psf: Tensor, source: PsfEntry
) -> Measurement:
    """What the sensor measured of a scene, on the PSF's cells."""
    # A grey PSF serves the mean of a picture's colours.
    grey = source.channels == ("grey",)
    found = develop(read_frame(options.pictures[number]), channels="grey" if grey else "all")
    if found.channels != source.channels:
        raise DataError(
            f"{found.source} has the channels {', '.join(found.channels)}, but the PSF "
            f"{source.file} {', '.join(source.channels)}: give raw frames of the same camera"
        )
    if found.values.shape != psf.shape:
        raise DataError(
            f"{found.source} has {found.size_text} cells, but the PSF {source.file} "
            f"{psf.shape[-2]}×{psf.shape[-1]}: give raw frames of the same camera, whole"
        )
    light = torch.where(found.valid, found.values, 0).sum(dim=(-2, -1))
    if not bool((light > 0).all()):
        raise DataError(f"{found.source} shows no light in at least one channel: leave it out")
    return found


def _warnings(found: Extended) -> list[str]:
    texts = []
    if found.misfit and not found.found:
        share = 1 - found.misfit[1] / found.misfit[0]
        texts.append(
            f"the pictures show too little of what lies beyond the sensor ({100 * share:.1f} % of "
            "what their reconstruction leaves over): it has the pattern's mean light. Captures at "
            "angles give more (nolens calibrate plan)"
        )
    return texts
