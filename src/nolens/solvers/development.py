"""From the frames of one camera to a measurement, and a PSF that fits it."""

from dataclasses import dataclass, field, replace

from nolens.camera import Frame, Measurement, PreparedPsf, develop, prepare_psf
from nolens.operators.psf_detail import finest_detail


@dataclass(frozen=True)
class Development:
    """How every frame of one camera is developed, and the frame of its PSF.

    Parameters
    ----------
    psf
        The sensor's frame of a point source, or a finished PSF.
    dark, flat
        Frames without light and of even light; None without one.
    black
        Black level in counts; None takes the frames' own.
    white
        Count from which a pixel is saturated; None takes the frames' own.
    bin_by
        Pixels along a superpixel that becomes one, for frame and PSF alike.
    channels
        As `develop` takes them.
    psf_scale, psf_extended
        Of a PSF that is larger than the measurement, as `prepare_psf` takes them.
    """

    psf: Frame = field(repr=False)
    dark: Frame | None = None
    flat: Frame | None = None
    black: float | None = None
    white: float | None = None
    bin_by: int = 1
    channels: str = "all"
    psf_scale: int | None = None
    psf_extended: bool = False

    def measurement(self, frame: Frame) -> Measurement:
        """A frame, developed."""
        return develop(
            frame,
            dark=self.dark,
            flat=self.flat,
            black=self.black,
            white=self.white,
            bin_by=self.bin_by,
            channels=self.channels,
        )

    def prepared(self, measurement: Measurement) -> PreparedPsf:
        """The PSF, developed and made to fit a measurement."""
        # A dark frame of another size than the PSF's cannot be taken from it; its files' own black
        # level is then what there is.
        dark = self.dark
        if dark is not None and dark.counts.shape != self.psf.counts.shape:
            dark = None
        grey = self.psf.mosaic is None and len(self.psf.channels) == 1
        psf = develop(
            self.psf,
            dark=dark,
            black=self.black,
            white=self.white,
            bin_by=self.bin_by,
            channels="all" if grey else self.channels,
        )
        return prepare_psf(psf, measurement, scale=self.psf_scale, wider=self.psf_extended)

    def fitted(self, frame: Frame, spare: int, *, coarsen: bool) -> "Developed":
        """A frame and the PSF on pixels that are no finer than the PSF carries.

        Parameters
        ----------
        frame
            Of the measurement.
        spare
            How many times finer than what the PSF carries the pixels are to be.
        coarsen
            Whether pixels may be made larger; otherwise a note says by how much they could be.
        """
        measurement = self.measurement(frame)
        prepared = self.prepared(measurement)
        carried = int(0.5 / finest_detail(prepared.values))
        side = carried // spare
        if coarsen and side > 1:
            note = (
                f"the PSF carries no detail finer than {carried} pixels: {side}×{side} of them are "
                "made one (--bin 1 keeps them apart)"
            )
            coarse = replace(self, bin_by=self.bin_by * side)
            measurement = coarse.measurement(frame)
            return Developed(coarse, measurement, coarse.prepared(measurement), (note,))
        notes: tuple[str, ...] = ()
        if carried > 1:
            notes = (
                f"the PSF carries no detail finer than {carried} pixels: --bin {carried} would be "
                f"about {carried * carried} times faster",
            )
        return Developed(self, measurement, prepared, notes)


@dataclass(frozen=True)
class Developed:
    """What came of a frame and of the PSF.

    Parameters
    ----------
    development
        How.
    measurement, prepared
        Of the frame, and of the PSF beside it.
    notes
        What was done, or could be.
    """

    development: Development
    measurement: Measurement
    prepared: PreparedPsf
    notes: tuple[str, ...]
