"""Curves of a sensor: over wavelength, and over the angle of the light."""

from itertools import pairwise
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from nolens.camera.part import (
    ChannelName,
    CsvFile,
    Number,
    Part,
    Text,
    UnitInterval,
    Wavelength,
    refusal,
)
from nolens.ranges import Between

_Array = NDArray[np.float64]
_MOST_POINTS = 10_000
_MOST_CHANNELS = 256


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


SpectralCurveOrFile = Annotated[
    Annotated[SpectralCurve, Tag("curve")] | Annotated[CurveFile, Tag("file")],
    Discriminator(_kind),
]
AngularCurveOrFile = Annotated[
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
