"""`nolens calibrate extrapolate`: a captured PSF that goes on beyond the sensor."""

from typing import Annotated, ClassVar

from torch import Tensor

from nolens.calibrate.extrapolate import check_picture, check_support, extrapolate
from nolens.camera import develop
from nolens.camera.psf_set import Depth
from nolens.errors import DataError, OptionError
from nolens.files import read_frame, read_psf, readable
from nolens.files.psf_folder import PsfFolder
from nolens.jobs.calibration.folder import FolderOptions, added
from nolens.jobs.fields import Files, Window
from nolens.jobs.options import Option
from nolens.jobs.reconstruction.options import parse_window
from nolens.jobs.run import Product, Run, job
from nolens.ranges import Between

_TAU = 5e-6


class CalibrateExtrapolateOptions(FolderOptions):
    """Extrapolate a captured PSF beyond the sensor, without further captures.

    nolens calibrate extrapolate mycamera raw1.dng raw2.dng --support 414x414

    nolens reconstruct raw1.dng --psf mycamera/extended-300mm.tif --psf-extent wide
    --support 414x414

    For a camera without an aperture. Without pictures, the PSF is continued with its mean light,
    which already brings most of the gain. With pictures, PSF and scenes are estimated together;
    that works for scenes that fill a small part of the sensor. Captures at angles give a better
    PSF than either (nolens calibrate stitch).

    Ctrl-C ends the run after the current step, and the PSF so far is written.
    """

    names: ClassVar = ("extended", "extend")
    usage = "calibrate extrapolate FOLDER RAW... --support 414x414"

    pictures: Annotated[
        Files,
        Option(
            "Raw frames of different scenes, whose light comes from the support only.",
            role="input",
            what="picture",
            positional=True,
        ),
    ] = ()
    support: Annotated[
        Window,
        Option(
            "Support of the scene, where its light comes from: HEIGHTxWIDTH in scene pixels, "
            "around the middle, or +TOP+LEFT after it; nolens calibrate plan gives it for an "
            "angle.",
            needed="the support of the scene, where its light comes from, in pixels (--support "
            "414x414; nolens calibrate plan CAMERA --angle 56deg gives it for an angle)",
            former="region",
        ),
    ]
    distance: Annotated[
        Depth | None, Option("Of the PSF to extrapolate.", default="the only captured one")
    ] = None
    rounds: Annotated[
        int, Between(1, 100), Option("Rounds; each estimates the scenes, then the PSF.")
    ] = 4

    def check_together(self) -> None:
        """Refuse a picture that is given twice."""
        if len(set(self.pictures)) < len(self.pictures):
            raise OptionError("a picture is given twice: it counts once")


@job
def calibrate_extrapolate(run: Run[CalibrateExtrapolateOptions]) -> Product[Tensor]:
    """Extrapolate a captured PSF beyond the sensor, and add the result to its folder.

    The reporter can stop it after a step.

    Raises
    ------
    NolensError
        If the folder, a picture or an option cannot be used; then nothing is written.
    """
    folder, step = PsfFolder(run.options.folder), run.reporter.step
    source = folder.captured_ahead(run.options.distance)
    options = run.options = run.options.model_copy(update={"distance": source.distance})
    psf = read_psf(options.folder, source)
    if not float(psf.sum()) > 0:
        raise DataError(f"{source.file} is dark: calibrate it again")
    support = parse_window(options.support, (psf.shape[-2], psf.shape[-1]), "--support")
    check_support(support, psf)
    run.reads({f"PSF {source.file}": options.folder / source.file})
    # A grey PSF serves the mean of a picture's colours.
    channels = "grey" if source.channels == ("grey",) else "all"
    pictures = [develop(read_frame(path), channels=channels) for path in options.pictures]
    for picture in pictures:
        check_picture(picture, psf, source.channels, source.file)
    run.begin()
    result = extrapolate(
        psf,
        pictures,
        support,
        rounds=options.rounds,
        tau=_TAU,
        step=lambda done, limit: step("step", done, limit, "the PSF"),
    )
    run.warn(*result.warnings())
    entry = source.derived(options.psf_file, "extended")
    figures = {
        "folder": readable(options.folder),
        "from": source.file,
        "file": entry.file,
        "support": [support.height, support.width],
        **result.figures(),
    }
    return added(result.psf, figures, options.folder, {entry: result.psf})
