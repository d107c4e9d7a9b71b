"""How fine, dense and clear a PSF is: from a file to figures and a plot."""

import math
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from torch import Tensor

from nolens.amounts import rounded
from nolens.camera import BlackLevel, Frame, LoadedCamera, black_level, check_psf, develop
from nolens.camera.part import PixelPitch
from nolens.design.focus import depth_of_focus_um, lenslet_aperture
from nolens.errors import OptionError
from nolens.evaluate import PsfFigures, clipped_pixels, psf_figures
from nolens.files import (
    CAMERA_FILE,
    PSFS_FILE,
    read_frame,
    read_psf_set,
    readable,
)
from nolens.files.plot_measurements import write_psf_plot
from nolens.jobs.fields import CAMERAS, FilePath, Name, PlotOptions, Word
from nolens.jobs.options import Option
from nolens.jobs.run import Product, Run, Writer, job
from nolens.optics import PointSource
from nolens.ranges import Between
from nolens.twin import REFERENCE_NM, preview_model

_CLOSE = 0.01
_PSF = "PSF"
_Noise = Annotated[float, Between(0, 1e9)]


class MeasurePsfOptions(PlotOptions):
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
    channels: Annotated[Word, Option("grey (mean of all), r, g or b.", _PSF)] = "grey"
    black: Annotated[
        BlackLevel,
        Option(
            'Count that stands for no light, or "auto": read off the darkest corner.',
            _PSF,
            default="what the file says",
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
        ),
    ] = None

    def check_together(self) -> None:
        """Refuse more than one channel."""
        if self.channels.lower() not in ("grey", "r", "g", "b"):
            raise OptionError(
                f"--channels {self.channels}: the figures are those of one plane; give grey, "
                "the mean of all channels, or one of r, g and b"
            )

    @property
    def inputs(self) -> dict[str, Path]:
        """The PSF."""
        return {"PSF": self.psf}


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
        raise OptionError(
            f"{options.psf} is a folder: give one of its PSFs, {_listed(options.psf)}"
        )
    frame = read_frame(options.psf)
    loaded = _camera(run)
    pixel_um = _pixel_um(options, frame, loaded)
    one = len(frame.channels) == 1 and frame.mosaic is None
    measured = develop(
        frame,
        black=black_level(options.black, frame),
        channels="all" if one else options.channels.lower(),
    )
    warnings = check_psf(measured, measured.values)
    run.begin()
    cell_um = pixel_um * (1 if frame.mosaic is None else 2)
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
            **_lenslets(figures, reduced_um),
        },
        writers,
    )


def _camera(run: Run[MeasurePsfOptions]) -> LoadedCamera | None:
    """The camera that is named, or the one in the PSF's folder."""
    beside = run.options.psf.parent / CAMERA_FILE
    name = run.options.camera or (beside if beside.is_file() else None)
    return None if name is None else run.camera(name)


def _pixel_um(options: MeasurePsfOptions, frame: Frame, loaded: LoadedCamera | None) -> float:
    """Distance of the file's pixels, where all that is known of it agrees."""
    folder, pixel = options.psf.parent, options.pixel
    listed = None
    if (folder / PSFS_FILE).is_file():
        entries = {each.file: each for each in read_psf_set(folder).psf}
        entry = entries.get(options.psf.name)
        listed = None if entry is None else entry.pixel
    if pixel is None and listed is None:
        raise OptionError(
            f"no pitch of the pixels of {options.psf} is known: give --pixel with its unit, such "
            "as --pixel 3.1um"
        )
    if pixel is not None and listed is not None and not _alike(pixel.um, listed.um):
        raise OptionError(
            f"--pixel {pixel}, but {folder / PSFS_FILE} says that the pixels of "
            f"{options.psf.name} are {listed} apart: leave --pixel out, or calibrate again"
        )
    length = listed if pixel is None else pixel
    assert length is not None
    if loaded is not None:
        _check_pitch(length.um, frame, loaded)
    return length.um


def _check_pitch(pixel_um: float, frame: Frame, loaded: LoadedCamera) -> None:
    """Refuse a pitch that is not that of the camera's sensor, or of whole numbers of its pixels."""
    sensor = loaded.camera.sensor
    ratio = pixel_um / sensor.pitch.um
    rows, columns = frame.counts.shape[-2:]
    binned = max(1, round(ratio))
    fitting = sensor.rows // rows
    whole = fitting >= 1 and (sensor.rows // fitting, sensor.columns // fitting) == (rows, columns)
    expected = fitting if whole else 1 if frame.mosaic is not None else binned
    if not _alike(ratio, expected):
        raise OptionError(
            f"--pixel {pixel_um:g} µm does not fit the camera {loaded.camera.name!r}, whose "
            f"{sensor.rows}×{sensor.columns} pixels are {sensor.pitch} apart: those of a file of "
            f"{rows}×{columns} would be {expected * sensor.pitch.um:g} µm. Give that, or another "
            "--camera"
        )


def _alike(one: float, other: float) -> bool:
    return math.isclose(one, other, rel_tol=_CLOSE)


def _listed(folder: Path) -> str:
    if not (folder / PSFS_FILE).is_file():
        return "a picture file"
    files = [str(folder / each.file) for each in read_psf_set(folder).psf]
    return ", ".join(files[:3]) + (" …" if len(files) > 3 else "")


def _clipped(frame: Frame, plane: Tensor) -> list[str]:
    clipped = clipped_pixels(plane) if frame.white is None else 0
    if not clipped:
        return []
    return [
        f"{clipped} pixels of the PSF {frame.source}, many side by side, have its very largest "
        "value: it seems to be clipped, and its lines wider than they are. Take a shorter exposure"
    ]


def _lenslets(figures: PsfFigures, reduced_um: float | None) -> dict[str, Any]:
    """Aperture and depth of focus of a lenslet as wide as the pitch (`uvimprint`)."""
    if reduced_um is None:
        return {}
    lenslets: dict[str, Any] = {
        "reduced_thickness_mm": round(reduced_um * 1e-3, 5),
        "one_per_mm_in_per_degree": rounded(reduced_um * 1e-3 * math.pi / 180),
        "lenslet_aperture": None,
        "depth_of_focus_mm": None,
    }
    if figures.pitch_um is not None:
        aperture = lenslet_aperture(figures.pitch_um, reduced_um)
        depth_um = depth_of_focus_um(REFERENCE_NM * 1e-3, aperture)
        lenslets["lenslet_aperture"] = rounded(float(aperture))
        lenslets["depth_of_focus_mm"] = rounded(float(depth_um) * 1e-3)
    return lenslets
