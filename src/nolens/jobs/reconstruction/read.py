"""Measurement, PSF, dark frame and flat field of a reconstruction, read and developed."""

from pathlib import Path

from nolens.camera import Frame, black_level
from nolens.files import read_frame
from nolens.jobs.reconstruction.options import ReconstructOptions
from nolens.jobs.reconstruction.solve import method_of
from nolens.jobs.run import Reporter
from nolens.solvers import Developed, Development
from nolens.solvers.reconstructor import SPARE


def read_development(options: ReconstructOptions) -> Development:
    """Read all but the measurement.

    Raises
    ------
    NolensError
        If a file cannot be read, or the black level not be told from the PSF.
    """
    psf = _read_psf(options)
    dark, flat = (
        read_frame(path, mosaic=options.mosaic, bgr=options.bgr) if path else None
        for path in (options.dark, options.flat)
    )
    return Development(
        psf,
        dark,
        flat,
        black_level(options.black, psf),
        options.white,
        options.bin_by,
        options.channels,
        options.psf_scale,
        options.psf_extent == "wide",
    )


def read_measurement(options: ReconstructOptions, path: Path) -> Frame:
    """Frame of a measurement in a file."""
    return read_frame(path, mosaic=options.mosaic, bgr=options.bgr)


def developed(
    options: ReconstructOptions, development: Development, frame: Frame, reporter: Reporter
) -> tuple[ReconstructOptions, Developed]:
    """A frame and the PSF, developed to cells no finer than the PSF carries, unless asked.

    Parameters
    ----------
    options
        What was asked for.
    development
        Of the camera.
    frame
        Of the measurement.
    reporter
        Is told where cells are made larger, or could be.

    Returns
    -------
    tuple
        The options, with the binning that was chosen, and what came of frame and PSF.
    """
    if options.bin is not None:
        measurement = development.measurement(frame)
        return options, Developed(development, measurement, development.prepared(measurement), ())
    # Parts of the scene name cells, and would name others.
    coarsen = options.support is None and options.crop in (None, "all")
    result = development.fitted(frame, SPARE[method_of(options)], coarsen=coarsen)
    for text in result.notes:
        reporter.note(text)
    if result.development.bin_by > 1:
        options = options.model_copy(update={"bin": result.development.bin_by})
    return options, result


def _read_psf(options: ReconstructOptions) -> Frame:
    """PSF, read like the measurement as far as its channels allow: it may be grey."""
    frame = read_frame(options.psf)
    if len(frame.channels) == 3:
        return read_frame(options.psf, bgr=True) if options.bgr else frame
    if options.mosaic is not None and frame.mosaic is None:
        return read_frame(options.psf, mosaic=options.mosaic)
    return frame
