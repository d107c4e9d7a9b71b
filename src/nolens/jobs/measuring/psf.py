"""How fine, dense and clear a PSF is: from a file to figures and a plot."""

from functools import partial
from pathlib import Path
from typing import Annotated

from torch import Tensor

from nolens.amounts import rounded
from nolens.camera import BlackLevel, Frame, black_level, check_psf, develop
from nolens.camera.part import PixelPitch
from nolens.camera.psf import extrapolation_note
from nolens.design.focus import lenslet_figures
from nolens.errors import OptionError
from nolens.evaluate import PsfFigures, clipped_pixels, psf_figures
from nolens.files import (
    read_frame,
    readable,
)
from nolens.files.plot_measurements import write_psf_plot
from nolens.files.psf_folder import PsfFolder, check_pitch
from nolens.jobs.fields import CAMERAS, FilePath, Name, RecordedOptions, Word
from nolens.jobs.options import Option
from nolens.jobs.run import Product, Run, Writer, job
from nolens.optics import PointSource
from nolens.ranges import Between
from nolens.twin import REFERENCE_NM, preview_model

_PSF = "PSF"
_Noise = Annotated[float, Between(0, 1e9)]


class MeasurePsfOptions(RecordedOptions):
    """Measure a PSF: width of its lines, pitch, spectrum, contrast, noise.

    nolens measure psf psf.tif --pixel 3.1um --plot psf.png

    The same figures as in the paper's Fig. 5, from the autocorrelation and the spectrum.
    """

    usage = "measure psf PSF --pixel 3.1um"

    psf: Annotated[
        FilePath,
        Option(
            "Picture of a point source: camera raw, .tif, .png or .npy, or one of the PSFs in a "
            "folder of nolens calibrate.",
            needed="the picture of a point source (nolens measure psf PSF --pixel 3.1um)",
            role="input",
            what="PSF",
            positional=True,
            label="PSF",
        ),
    ]
    pixel: Annotated[
        PixelPitch | None,
        Option(
            "Distance of the file's pixels, such as 3.1um. In a raw file behind a colour mosaic "
            "four of them make a pixel of the PSF: give the sensor's own pitch.",
            default="what psfs.toml beside it says",
        ),
    ] = None
    camera: Annotated[
        Name | None,
        Option(
            "Camera that the PSF is from, for angles in the scene, the aperture of a lenslet and "
            f"its depth of focus: {CAMERAS}.",
            default="camera.toml beside the PSF, if there is one",
            role="camera",
        ),
    ] = None
    channels: Annotated[Word, Option("grey (mean of all), r, g or b.", _PSF, label="Channels")] = (
        "grey"
    )
    black: Annotated[
        BlackLevel,
        Option(
            'Count that stands for no light, or "auto": read off the darkest corner.',
            _PSF,
            default="what the file says",
            label="Black level",
        ),
    ] = None
    noise: Annotated[
        _Noise | None,
        Option(
            "Standard deviation of the noise of a pixel of the PSF, in counts; 0 for a PSF "
            "without noise.",
            _PSF,
            default="the power at the frequencies where it is least",
        ),
    ] = None
    plot: Annotated[
        FilePath | None,
        Option(
            "Picture to write (.png): PSF, autocorrelation, spectral magnitude. The record of the "
            "run goes beside it, as .json.",
            role="output",
            suffixes=(".png",),
        ),
    ] = None

    def check_together(self) -> None:
        """Refuse more than one channel."""
        if self.channels.lower() not in ("grey", "r", "g", "b"):
            raise OptionError(
                f"--channels {self.channels}: the figures are those of one plane; give grey, "
                "the mean of all channels, or one of r, g and b"
            )


@job
def measure_psf(run: Run[MeasurePsfOptions]) -> Product[PsfFigures]:
    """Read a PSF and measure it; a plot is written if one is asked for.

    Raises
    ------
    NolensError
        If the file, the pitch or an output cannot be used, or it shows no pattern; then nothing is
        written.
    """
    options = run.options
    if options.psf.is_dir():
        files = [str(options.psf / each.file) for each in PsfFolder(options.psf).psfs]
        listed = ", ".join(files[:3]) + (" …" if len(files) > 3 else "")
        raise OptionError(
            f"{options.psf} is a folder: give one of its PSFs, {listed or 'a picture file'}"
        )
    frame = read_frame(options.psf)
    loaded = run.camera_beside(options.camera, options.psf.parent)
    folder = PsfFolder(options.psf.parent)
    pixel = folder.pixel_of(options.psf.name, options.pixel)
    entry = next((each for each in folder.psfs if each.file == options.psf.name), None)
    if loaded is not None:
        check_pitch(pixel, frame, loaded)
    one = len(frame.channels) == 1 and frame.mosaic is None
    measured = develop(
        frame,
        black=black_level(options.black, frame),
        channels="all" if one else options.channels.lower(),
    )
    warnings = check_psf(measured, measured.values)
    if entry is not None and entry.kind == "captured" and entry.on_axis:
        place = readable(folder.path)
        beyond = extrapolation_note(entry.file, measured.values, measured.size, place)
        if beyond is not None:
            run.reporter.note(beyond)
    run.begin()
    cell_um = pixel.um * (1 if frame.mosaic is None else 2)
    reduced_um = None
    if loaded is not None:
        twin = preview_model(loaded)
        reduced_um = twin.illumination(PointSource(), REFERENCE_NM).after.reduced_um
    plane = measured.values[0]
    figures = psf_figures(plane, cell_um, reduced_um=reduced_um, noise=options.noise)
    run.warn(*warnings, *_clipped(frame, plane), *figures.warnings(frame.source))
    writers: dict[Path, Writer] = {}
    if options.plot is not None:
        writers[options.plot] = partial(
            write_psf_plot, figures=figures, psf=plane, pixel_um=cell_um
        )
    return Product(
        figures,
        {
            "psf": readable(options.psf),
            "camera": None if loaded is None else loaded.camera.name,
            "pixels": list(plane.shape),
            "channel": measured.channels[0],
            **rounded(figures.figures),
            **lenslet_figures(figures.pitch_um, reduced_um),
        },
        writers,
    )


def _clipped(frame: Frame, plane: Tensor) -> list[str]:
    clipped = clipped_pixels(plane) if frame.white is None else 0
    if not clipped:
        return []
    return [
        f"{clipped} pixels of the PSF {frame.source}, many side by side, have its very largest "
        "value: it seems to be clipped, and its lines wider than they are. Take a shorter exposure"
    ]
