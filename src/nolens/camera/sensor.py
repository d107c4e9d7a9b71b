"""The sensor of a camera: its pixels, its electronics, and its curves over wavelength and angle."""

from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from nolens.camera.part import (
    ChannelName,
    CsvFile,
    Number,
    Part,
    PixelPitch,
    PositiveLength,
    Text,
    UnitInterval,
    Wavelength,
    refusal,
)
from nolens.ranges import Between

_Array = NDArray[np.float64]
_MOST_POINTS = 10_000
_MOST_CHANNELS = 16


class SpectralCurve(Part):
    """Fraction of the photons that become electrons, for each channel, over wavelength.

    Attributes
    ----------
    source
        Where the figures come from; begins with "placeholder" where there are no public ones.
    wavelength_nm
        Wavelengths in nm, increasing, at least two.
    values
        For each channel one value from 0 to 1 for each wavelength.
    """

    source: Text
    wavelength_nm: tuple[Wavelength, ...] = Field(min_length=2, max_length=_MOST_POINTS)
    values: dict[
        ChannelName, Annotated[tuple[UnitInterval, ...], Field(max_length=_MOST_POINTS)]
    ] = Field(min_length=1, max_length=_MOST_CHANNELS)

    @field_validator("wavelength_nm")
    @classmethod
    def _check_wavelengths(cls, wavelengths: tuple[float, ...]) -> tuple[float, ...]:
        _check_increasing(wavelengths)
        return wavelengths

    @model_validator(mode="after")
    def _check_lengths(self) -> "SpectralCurve":
        for channel, values in self.values.items():
            _check_length(f"values.{channel}", values, "wavelength_nm", self.wavelength_nm)
        return self

    def at(self, channel: str, wavelength_nm: _Array) -> _Array:
        """Values of one channel at wavelengths of any shape, linear between points, 0 outside."""
        table = self.values[channel]
        return np.interp(wavelength_nm, self.wavelength_nm, table, left=0.0, right=0.0)


class AngularCurve(Part):
    """Response of a pixel over the angle at which light falls on it.

    Attributes
    ----------
    source
        Where the figures come from; begins with "placeholder" where there are no public ones.
    angle_deg
        Angles of incidence in degrees, increasing from 0 to at most 90, at least two.
    response
        One value from 0 to 1 for each angle; more than 0 at 0 degrees.
    """

    source: Text
    angle_deg: tuple[Annotated[Number, Between(0, 90)], ...] = Field(
        min_length=2, max_length=_MOST_POINTS
    )
    response: tuple[UnitInterval, ...] = Field(max_length=_MOST_POINTS)

    @field_validator("angle_deg")
    @classmethod
    def _check_angles(cls, angles: tuple[float, ...]) -> tuple[float, ...]:
        if angles[0] != 0:
            raise refusal(f"it begins at {angles[0]:g}: begin at 0 degrees", row=0)
        _check_increasing(angles)
        return angles

    @field_validator("response")
    @classmethod
    def _check_response(cls, response: tuple[float, ...]) -> tuple[float, ...]:
        if response and response[0] == 0:
            raise refusal("its first value, at 0 degrees, is 0: give one above 0", row=0)
        return response

    @model_validator(mode="after")
    def _check_lengths(self) -> "AngularCurve":
        _check_length("response", self.response, "angle_deg", self.angle_deg)
        return self

    def at(self, angle_deg: _Array) -> _Array:
        """Response at angles of any shape, linear between points; beyond them the last holds."""
        return np.interp(angle_deg, self.angle_deg, self.response)


class CurveFile(Part):
    """A curve in a CSV file.

    Attributes
    ----------
    file
        Name of the file, relative to the camera's folder. Its first line is
        ``wavelength_nm,R,G,B`` or ``wavelength_nm,grey`` for a spectral curve, and
        ``angle_deg,response`` for an angular one.
    """

    file: CsvFile


def _kind(value: object) -> str:
    if isinstance(value, CurveFile) or (isinstance(value, dict) and "file" in value):
        return "file"
    return "curve"


_QuantumEfficiency = Annotated[
    Annotated[SpectralCurve, Tag("curve")] | Annotated[CurveFile, Tag("file")],
    Discriminator(_kind),
]
_Acceptance = Annotated[
    Annotated[AngularCurve, Tag("curve")] | Annotated[CurveFile, Tag("file")],
    Discriminator(_kind),
]


def _check_increasing(values: tuple[float, ...]) -> None:
    for index, (one, other) in enumerate(pairwise(values), start=1):
        if other <= one:
            raise refusal(
                f"{other:g} follows {one:g}: put the values in increasing order, each once",
                row=index,
            )


def _check_length(
    name: str, values: tuple[float, ...], axis: str, along: tuple[float, ...]
) -> None:
    if len(values) != len(along):
        raise refusal(
            f"{name} has {len(values)} values, but {axis} has {len(along)}: give as many of both"
        )


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
    quantum_efficiency: _QuantumEfficiency
    acceptance: _Acceptance
    package: Package | None = None

    @model_validator(mode="after")
    def _check_fit(self) -> "Sensor":
        if self.mosaic != "none" and (self.rows % 2 or self.columns % 2):
            raise refusal(
                f"{self.rows} rows and {self.columns} columns do not make whole 2×2 superpixels of "
                f'the mosaic {self.mosaic}: give even numbers, or mosaic = "none"'
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

    @property
    def saturated_counts(self) -> int:
        """Count from which a pixel is saturated: it is full, or at the largest count."""
        full = self.clip_electrons * self.counts_per_electron * self.gain
        return min(self.white_counts, round(self.black_counts + full))
