"""Measurement, PSF, dark frame and flat field of a reconstruction, read and developed."""

from dataclasses import dataclass, replace
from pathlib import Path

from nolens.camera import (
    Frame,
    Measurement,
    PreparedPsf,
    black_level,
    develop,
    prepare_psf,
)
from nolens.files import read_frame
from nolens.jobs.reconstruction.options import ReconstructOptions
from nolens.jobs.reporter import Reporter
from nolens.operators.psf_detail import finest_detail


@dataclass(frozen=True)
class Developing:
    """How every frame of one camera is developed, and the PSF's frame.

    Parameters
    ----------
    options
        What was asked for.
    psf
        Frame of the PSF.
    dark, flat
        Frames; None without one.
    black
        Black level; None takes the files' own.
    """

    options: ReconstructOptions
    psf: Frame
    dark: Frame | None
    flat: Frame | None
    black: float | None

    @classmethod
    def read(cls, options: ReconstructOptions) -> "Developing":
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
        black = black_level(options.black, psf)
        return cls(options, psf, dark, flat, black)

    def frame(self, path: Path) -> Frame:
        """Frame of a measurement in a file."""
        return read_frame(path, mosaic=self.options.mosaic, bgr=self.options.bgr)

    def measurement(self, frame: Frame) -> Measurement:
        """A frame, developed."""
        return develop(
            frame, dark=self.dark, flat=self.flat, black=self.black, white=self.options.white,
            bin_by=self.options.bin_by, channels=self.options.channels,
        )  # fmt: skip

    def prepared(self, measurement: Measurement) -> PreparedPsf:
        """The PSF, developed and made to fit a measurement."""
        # A dark frame of another size than the PSF's cannot be taken from it; its files' own black
        # level is then what there is.
        dark = self.dark
        if dark is not None and dark.counts.shape != self.psf.counts.shape:
            dark = None
        grey = self.psf.mosaic is None and len(self.psf.channels) == 1
        psf = develop(
            self.psf, dark=dark, black=self.black, white=self.options.white,
            bin_by=self.options.bin_by, channels="all" if grey else self.options.channels,
        )  # fmt: skip
        options = self.options
        return prepare_psf(psf, measurement, scale=options.psf_scale, wider=options.psf_wider)

    def fitted(
        self, frame: Frame, reporter: Reporter, spare: int
    ) -> tuple["Developing", Measurement, PreparedPsf]:
        """A frame and the PSF, developed to cells no finer than the PSF carries, unless asked.

        Parameters
        ----------
        frame
            Of the measurement.
        reporter
            Is told where cells are made larger, or could be.
        spare
            How much finer than what the PSF carries the cells are to be.

        Returns
        -------
        tuple
            How it was developed, what came of the frame, and of the PSF.
        """
        options = self.options
        measurement = self.measurement(frame)
        prepared = self.prepared(measurement)
        if options.bin is not None:
            return self, measurement, prepared
        carried = int(0.5 / finest_detail(prepared.values))
        side = carried // spare
        # Parts of the scene name cells, and would name others.
        if side > 1 and options.region is None and options.crop in (None, "all"):
            reporter.note(
                f"the PSF carries no detail finer than {carried} cells: {side}×{side} of them are "
                "made one (--bin 1 keeps them apart)"
            )
            coarse = replace(self, options=options.model_copy(update={"bin": side}))
            measurement = coarse.measurement(frame)
            return coarse, measurement, coarse.prepared(measurement)
        if carried > 1:
            reporter.note(
                f"the PSF carries no detail finer than {carried} cells: --bin {carried} would be "
                f"about {carried * carried} times faster"
            )
        return self, measurement, prepared


def _read_psf(options: ReconstructOptions) -> Frame:
    """PSF, read like the measurement as far as its channels allow: it may be grey."""
    frame = read_frame(options.psf)
    if len(frame.channels) == 3:
        return read_frame(options.psf, bgr=True) if options.bgr else frame
    if options.mosaic is not None and frame.mosaic is None:
        return read_frame(options.psf, mosaic=options.mosaic)
    return frame
