"""`nolens calibrate extrapolate`: a captured PSF that goes on beyond the sensor."""

from pathlib import Path
from typing import Annotated, ClassVar

import torch
from torch import Tensor

from nolens.calibrate.extrapolate import ExtrapolatedPsf, extrapolate, filled, steps
from nolens.camera import Measurement, PsfEntry, PsfSet, develop
from nolens.camera.psf_set import Depth
from nolens.errors import DataError, OptionError
from nolens.files import read_frame, read_psf, read_psf_set, readable
from nolens.jobs.calibration.folder import FolderOptions, added, made_of, psfs_ahead
from nolens.jobs.fields import Files, Window
from nolens.jobs.options import Option
from nolens.jobs.reconstruction.options import parse_window
from nolens.jobs.run import Product, Run, job
from nolens.ranges import Between

_TAU = 1e-5


class CalibrateExtrapolateOptions(FolderOptions):
    """Extrapolate a captured PSF beyond the sensor, without further captures.

    nolens calibrate extrapolate mycamera raw1.dng raw2.dng --support 414x414

    nolens reconstruct raw1.dng --psf mycamera/extended-300mm.tif --psf-extent wide
    --support 414x414

    For a camera without an aperture. Without pictures, the PSF goes on with its mean light; that
    alone is worth most. From pictures of ordinary scenes the PSF itself is estimated together
    with the scenes, where they show it: scenes that fill a small part of the sensor do. Captures
    at angles give more than either (nolens calibrate stitch).

    Ctrl-C ends it after a step, and the PSF so far is written.
    """

    names: ClassVar = ("extended", "extend")
    usage = "calibrate extrapolate FOLDER RAW... --support 414x414"

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
    def inputs(self) -> dict[str, Path]:
        """Pictures, by role."""
        return {f"picture {number}": path for number, path in enumerate(self.pictures, start=1)}


@job
def calibrate_extrapolate(run: Run[CalibrateExtrapolateOptions]) -> Product[Tensor]:
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
    mean_light = ExtrapolatedPsf(filled(psf, region), False, ())
    run.reads({f"PSF {source.file}": options.folder / source.file})
    pictures = [_picture(path, psf, source) for path in options.pictures]
    run.begin()
    stopped = False

    def step(done: int) -> bool:
        nonlocal stopped
        limit = steps(options.rounds, len(pictures))
        stopped = reporter.step("step", done, limit, "the PSF")
        return stopped

    result = mean_light
    if pictures:
        step(0)
        result = extrapolate(psf, pictures, region, rounds=options.rounds, tau=_TAU, step=step)
    run.warn(*result.warnings())
    entry = made_of(source, options.psf_file, "extended")
    figures = {
        "folder": readable(options.folder),
        "from": source.file,
        "file": entry.file,
        "pixels": list(result.psf.shape[-2:]),
        "support": [region.height, region.width],
        "extrapolated_by": "pictures" if result.from_pictures else "mean light",
        "rounds": max(0, len(result.residual) - 1),
        "residual": [round(each, 7) for each in result.residual],
        "interrupted": stopped,
    }
    return added(result.psf, figures, options.folder, {entry: result.psf})


def _source(options: CalibrateExtrapolateOptions, psfs: PsfSet) -> PsfEntry:
    """The captured PSF that is extended."""
    there = psfs_ahead(options.folder, psfs, ("captured",))
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


def _picture(path: Path, psf: Tensor, source: PsfEntry) -> Measurement:
    """What the sensor measured of a scene, on the PSF's pixels."""
    # A grey PSF serves the mean of a picture's colours.
    grey = source.channels == ("grey",)
    picture = develop(read_frame(path), channels="grey" if grey else "all")
    if picture.channels != source.channels:
        raise DataError(
            f"{picture.source} has the channels {', '.join(picture.channels)}, but the PSF "
            f"{source.file} {', '.join(source.channels)}: give raw frames of the same camera"
        )
    if picture.values.shape != psf.shape:
        raise DataError(
            f"{picture.source} has {picture.size_text} pixels, but the PSF {source.file} "
            f"{psf.shape[-2]}×{psf.shape[-1]}: give raw frames of the same camera, whole"
        )
    light = torch.where(picture.valid, picture.values, 0).sum(dim=(-2, -1))
    if not bool((light > 0).all()):
        raise DataError(f"{picture.source} shows no light in at least one channel: leave it out")
    return picture
