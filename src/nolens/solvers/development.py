"""From the frames of one camera to a measurement, and a PSF that fits it."""

from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from nolens.camera import (
    FieldPsf,
    Frame,
    Measurement,
    PreparedPsf,
    PsfGeometry,
    develop,
    prepare_psf,
)
from nolens.kernels import rfft2

_FAINTEST = 1e-2
"""Transfer, as a fraction of the strongest, below which detail drowns in a measurement's noise."""
_NOISE_AT_MOST = 0.1
"""Fraction of the strongest transfer up to which what is left everywhere counts as noise."""
_CLEAR = 2.0
"""How far above that a transfer must be."""
_RINGS = 100
_SMALLEST = 16
_HIGHEST = 0.5


@dataclass(frozen=True)
class FieldPoint:
    """The frame of a point source at another angle than the PSF's.

    Parameters
    ----------
    frame
        Its middle follows the ray through the camera's middle.
    place
        Rows and columns from the sensor's middle to where that ray falls, in pixels of the
        developed frame.
    """

    frame: Frame = field(repr=False)
    place: tuple[float, float]


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
    psf_geometry
        How the PSF's pixels lie on the measurement's (`choose_psf`).
    field_points
        PSFs at several angles, where it varies over the field; `psf` is one of them.
    alone
        The PSF for all of the field, where that is not `psf`.
    """

    psf: Frame = field(repr=False)
    dark: Frame | None = None
    flat: Frame | None = None
    black: float | None = None
    white: float | None = None
    bin_by: int = 1
    channels: str = "all"
    psf_geometry: PsfGeometry = PsfGeometry()  # noqa: RUF009 (frozen)
    field_points: tuple[FieldPoint, ...] = field(default=(), repr=False)
    alone: Frame | None = field(default=None, repr=False)

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
        prepared = prepare_psf(self.developed_psf(measurement), measurement, self.psf_geometry)
        source, note = self.psf.source, ""
        if len(measurement.channels) > 1 and self.psf.channels == ("grey",):
            note = (
                f"the PSF {source} is grey and serves all colours, which are the sensor's: a PSF "
                "in colour, of white light, balances them and keeps more of their detail"
            )
        elif measurement.channels == ("grey",) and self.channels != "grey":
            note = f"the measurement is grey: so is the PSF {source} taken"
        if not note or self.psf.channels == measurement.channels:
            return prepared
        return replace(prepared, notes=(*prepared.notes, note))

    @property
    def merged(self) -> int:
        """Pixels of the PSF, as it was captured, along one of the measurement's."""
        return self.bin_by * (self.psf_geometry.scale or 1)

    def field_psf(self, measurement: Measurement) -> FieldPsf | None:
        """The PSFs of all field points, made to fit a measurement; None of a single one."""
        if not self.field_points:
            return None
        planes = [
            replace(self, psf=each.frame).prepared(measurement).values for each in self.field_points
        ]
        places = torch.tensor([each.place for each in self.field_points], dtype=torch.float64)
        return FieldPsf.of(planes, places / self.merged).flipped_places(self.psf_geometry.flip)

    def psf_alone(self, measurement: Measurement) -> Tensor | None:
        """The PSF for all of the field, made to fit a measurement; None where that is `psf`."""
        if self.alone is None:
            return None
        return replace(self, psf=self.alone).prepared(measurement).values

    def developed_psf(self, measurement: Measurement) -> Measurement:
        """The PSF, developed for the channels of a measurement.

        One that is finished (`Frame.is_linear`) has no black level left, and no pixel saturates.
        """
        psf, dark, black, white = self.psf, self.dark, self.black, self.white
        # A dark frame of another size than the PSF's cannot be taken from it; its files' own black
        # level is then what there is.
        if psf.is_linear or (dark is not None and dark.counts.shape != psf.counts.shape):
            dark = None
        if psf.is_linear:
            black = white = None
        channels = self.channels
        if psf.mosaic is None and len(psf.channels) == 1:
            channels = "all"
        elif measurement.channels == ("grey",):
            channels = "grey"
        return develop(
            psf, dark=dark, black=black, white=white, bin_by=self.bin_by, channels=channels
        )

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
    """A measurement, the PSF that fits it, how they were developed, and notes on what was done."""

    development: Development
    measurement: Measurement
    prepared: PreparedPsf
    notes: tuple[str, ...]


def finest_detail(psf: Tensor) -> float:
    r"""Highest spatial frequency that a PSF carries, in cycles per pixel; 0.5 at most.

    A frequency is carried where the transfer, the root of the mean power in its ring under Hann's
    window, is at least 1 % of the strongest ring's, and twice what is left in the weakest, if
    that is below 10 % of the strongest and so may be noise. Squares of b×b pixels still hold what
    is carried where :math:`b < 1/(2f)`.

    Parameters
    ----------
    psf
        (channels, rows, columns); the channel that carries most counts.
    """
    rows, columns = psf.shape[-2:]
    if min(rows, columns) < _SMALLEST:
        return _HIGHEST
    window = torch.outer(
        torch.hann_window(rows, periodic=False), torch.hann_window(columns, periodic=False)
    )
    rings = min(_RINGS, min(rows, columns) // 4)
    down = torch.fft.fftfreq(rows)[:, None]
    right = torch.fft.rfftfreq(columns)
    ring = (torch.hypot(down, right) * (rings / _HIGHEST)).int().clamp_(max=rings).flatten()
    count = torch.bincount(ring, minlength=rings + 1)[:rings]
    finest = 0.0
    for plane in psf.cpu().float():
        mean = (plane * window).sum() / window.sum()
        power = rfft2((plane - mean) * window).abs().square_().flatten()
        transfer = (torch.bincount(ring, power, rings + 1)[:rings] / count).sqrt()
        strongest, weakest = float(transfer.max()), float(transfer.min())
        least = _FAINTEST * strongest
        if weakest < _NOISE_AT_MOST * strongest:
            least = max(least, _CLEAR * weakest)
        last = int((transfer >= least).nonzero()[-1])
        finest = max(finest, (last + 1) / rings * _HIGHEST)
        if finest >= _HIGHEST:
            break
    return finest
