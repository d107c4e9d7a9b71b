"""The sensor of a camera: its pixels, its electronics, and its curves over wavelength and angle."""

from typing import Annotated, Literal

from pydantic import Field, model_validator
from torch import Tensor

from nolens.camera.curves import AngularCurveOrFile, CurveFile, SpectralCurve, SpectralCurveOrFile
from nolens.camera.filters import FilterArray
from nolens.camera.part import Number, Part, PixelPitch, PositiveLength, Text, refusal
from nolens.ranges import Between

Pixels = Annotated[int, Field(strict=True), Between(16, 65535)]


class Package(Part):
    """The housing that a sensor is sold in, as a frame around it meets it.

    Attributes
    ----------
    source
        Where the figures come from; begins with "placeholder" where there are no public ones.
    width, height
        Outer size along the sensor's rows and columns.
    glass_top
        From the face that a frame stands on, usually the board's, up to the top of the package.
    """

    source: Text
    width: PositiveLength
    height: PositiveLength
    glass_top: PositiveLength


class Sensor(Part):
    """An image sensor.

    Attributes
    ----------
    name
        What it is called.
    rows, columns
        Pixels, from 16 to 65535; even where there is a colour mosaic.
    pitch
        From one pixel to the next, in both directions.
    mosaic
        Colours of the 2×2 superpixel, row by row, or "none".
    bits
        Of a stored count, 8 to 16.
    black_counts
        Count that stands for no light.
    full_well_electrons
        Electrons at which a pixel is full.
    read_noise_electrons
        Standard deviation of the read noise, in electrons.
    counts_per_electron
        Counts for one electron at gain 1.
    gain
        Factor on the counts per electron.
    line_time_us
        From the start of one line's exposure to that of the next; None where all lines are exposed
        at once, or nobody said it.
    rolling
        In what order lines are exposed: ``"down"`` from the first row, ``"up"`` from the last,
        ``"out"`` from the middle, ``"in"`` from both edges. The last two expose a line of
        the upper and one of the lower half at a time.
    quantum_efficiency
        Electrons per photon over wavelength, for each of `channels`.
    acceptance
        Response over the angle of incidence.
    filters
        On its pixels, for a sensor without a mosaic; None where all pixels are alike.
    package
        Its housing, which the files for the workshop are made to fit; None where nobody gave it.
    """

    name: Text
    rows: Pixels
    columns: Pixels
    pitch: PixelPitch
    mosaic: Literal["RGGB", "BGGR", "GRBG", "GBRG", "none"]
    bits: Annotated[int, Field(strict=True), Between(8, 16)]
    black_counts: Annotated[Number, Between(0, 65534)]
    full_well_electrons: Annotated[Number, Between(1, 1e9)]
    read_noise_electrons: Annotated[Number, Between(0, 1e6)]
    counts_per_electron: Annotated[Number, Between(1e-6, 1e6)]
    gain: Annotated[Number, Between(1e-3, 1e4)] = 1.0
    line_time_us: Annotated[Number, Between(1e-3, 1e9)] | None = None
    rolling: Literal["down", "up", "out", "in"] | None = None
    quantum_efficiency: SpectralCurveOrFile
    acceptance: AngularCurveOrFile
    filters: FilterArray | None = None
    package: Package | None = None

    @model_validator(mode="after")
    def _check_fit(self) -> "Sensor":
        if self.mosaic != "none" and (self.rows % 2 or self.columns % 2):
            raise refusal(
                f"{self.rows} rows and {self.columns} columns do not make whole 2×2 superpixels of "
                f'the mosaic {self.mosaic}: give even numbers, or mosaic = "none"'
            )
        if self.mosaic != "none" and self.filters is not None:
            raise refusal(
                f'the mosaic {self.mosaic} and filters are both given: give mosaic = "none" and '
                "the quantum efficiency without filters"
            )
        if self.black_counts >= self.white_counts:
            raise refusal(
                f"black_counts is {self.black_counts:g}, but the largest count of {self.bits} bits "
                f"is {self.white_counts}: give a smaller one"
            )
        if (self.line_time_us is None) != (self.rolling is None):
            missing = "rolling" if self.rolling is None else "line_time_us"
            raise refusal(
                f"{missing} is missing: a rolling shutter has both, such as line_time_us = 28.571 "
                'and rolling = "down" (or "up", "out", "in"); leave out both where all lines are '
                "exposed at once"
            )
        curve = self.quantum_efficiency
        if isinstance(curve, SpectralCurve) and set(curve.values) != set(self.channels):
            raise refusal(
                f"the quantum efficiency is given for {', '.join(curve.values)}, but a sensor "
                f"with the mosaic {self.mosaic} has the channels {', '.join(self.channels)}: "
                "give exactly these"
            )
        return self

    @property
    def files(self) -> list[str]:
        """Names of the files that have its curves and filters, in the camera's folder."""
        array = self.filters
        curves = (self.quantum_efficiency, self.acceptance, array and array.transmission)
        names = [curve.file for curve in curves if isinstance(curve, CurveFile)]
        return [*names, *([array.map] if array is not None and array.map is not None else [])]

    @property
    def channels(self) -> tuple[str, ...]:
        """``("R", "G", "B")``, or ``("grey",)`` without a mosaic."""
        return ("grey",) if self.mosaic == "none" else ("R", "G", "B")

    @property
    def superpixel(self) -> int:
        """Pixels along one of a reconstruction: 2 behind a colour mosaic."""
        return 1 if self.mosaic == "none" else 2

    @property
    def white_counts(self) -> int:
        """The largest count."""
        return int(2**self.bits - 1)

    @property
    def height_mm(self) -> float:
        """Height of all rows, in mm."""
        return self.rows * self.pitch.mm

    @property
    def width_mm(self) -> float:
        """Width of all columns, in mm."""
        return self.columns * self.pitch.mm

    @property
    def clip_electrons(self) -> float:
        """Electrons from which a pixel is saturated: it is full, or at the largest count."""
        per_electron = self.counts_per_electron * self.gain
        return min(self.full_well_electrons, (self.white_counts - self.black_counts) / per_electron)

    def noise_variance(self, counts: Tensor) -> Tensor:
        """Shot and read noise of pixels in counts², g b + g²r², from mean counts above black."""
        per_electron, read_noise = self.electrons
        return per_electron * counts + (per_electron * read_noise) ** 2

    @property
    def electrons(self) -> tuple[float, float]:
        """Counts per electron g, gain included, and the read noise r in electrons."""
        return self.counts_per_electron * self.gain, self.read_noise_electrons

    @property
    def saturated_counts(self) -> int:
        """Count from which a pixel is saturated: it is full, or at the largest count."""
        full = self.clip_electrons * self.counts_per_electron * self.gain
        return min(self.white_counts, round(self.black_counts + full))
