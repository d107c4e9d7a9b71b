"""The point spread functions that were measured of a camera, as they are listed in its folder."""

import math
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from nolens.camera.part import ChannelName, Part, PixelPitch, TiffFile, refusal
from nolens.quantities import Angle, Length
from nolens.ranges import Between

PsfKind = Literal["captured", "stitched", "field-point", "extended", "scaled", "solved"]
"""Captured by the sensor; stitched of several captured ones, for all of the scene; of one field
point, stitched beyond what the sensor saw; extended beyond the sensor by ordinary pictures; scaled
from another distance's; solved from pictures of known scenes."""

BEST_FIRST: tuple[PsfKind, ...] = ("stitched", "extended", "captured", "solved", "scaled")
"""Those that extend beyond the sensor first, and measured ones before computed ones."""

Distance = Annotated[Length, Between("0.1 µm", "1000000 m")]
"""Of a scene or a point source from the camera."""
Depth = Distance | Literal["infinity"]


def depth_um(depth: Depth) -> float:
    """A distance as the optics take it: the word is infinity."""
    return depth.um if isinstance(depth, Length) else math.inf


FieldAngle = Annotated[Angle, Between("-89.9 deg", "89.9 deg")]
"""Off the camera's axis; at 90 deg no light reaches it."""


class PsfEntry(Part):
    """One PSF of a set.

    Attributes
    ----------
    file
        32-bit float TIFF in the set's folder, (channels, rows, columns), linear, not negative.
    pixel
        Pitch of its pixels.
    channels
        Name of every channel.
    distance
        Of the point source from the camera.
    angle
        Its field angles, to the right and up as the photographer sees it.
    kind
        How it came about.
    frame
        Whether the file's middle follows the ray through the camera's middle (zero shift is the
        pixel (rows // 2, columns // 2)), or stays on the sensor's as it was captured.
    wavelength
        Of the light; None where that is white, or not known.
    usable_per_mm
        Spatial frequency to which it stands out of its noise; None where that is not known.
    """

    file: TiffFile
    pixel: PixelPitch
    channels: tuple[ChannelName, ...] = Field(min_length=1, max_length=100)
    distance: Depth
    angle: tuple[FieldAngle, FieldAngle] = (Angle("0", "deg"), Angle("0", "deg"))
    kind: PsfKind = "captured"
    frame: Literal["chief-ray", "sensor"] = "chief-ray"
    wavelength: Annotated[Length, Between("350 nm", "1100 nm")] | None = None
    usable_per_mm: Annotated[float, Between(1e-6, 1e6)] | None = None

    @model_validator(mode="before")
    @classmethod
    def _rename_former_key(cls, fields: Any) -> Any:
        """Take `cell`, which lists of the first releases have for `pixel`."""
        if isinstance(fields, dict) and "pixel" not in fields and "cell" in fields:
            return {"pixel" if key == "cell" else key: each for key, each in fields.items()}
        return fields

    @property
    def distance_um(self) -> float:
        """Distance of the point source; may be infinite."""
        return depth_um(self.distance)

    @property
    def on_axis(self) -> bool:
        """Whether the point source is straight ahead."""
        return all(each.deg == 0 for each in self.angle)

    @property
    def cosine(self) -> float:
        """Of the angle between the light and the axis."""
        right, up = (math.tan(each.rad) for each in self.angle)
        return 1 / math.sqrt(1 + right**2 + up**2)

    def derived(self, file: str, kind: PsfKind, **changes: Any) -> "PsfEntry":
        """Entry of a PSF, of a source straight ahead, that is made of this one."""
        fields = {"distance": self.distance, "usable_per_mm": self.usable_per_mm, **changes}
        return PsfEntry(file=file, pixel=self.pixel, channels=self.channels, kind=kind, **fields)

    def replaces(self, other: "PsfEntry") -> bool:
        """Whether both are of the same kind, and of the same point source or one file."""
        place = self.distance, self.angle, self.wavelength
        same = place == (other.distance, other.angle, other.wavelength) or self.file == other.file
        return same and self.kind == other.kind


class PsfSet(Part):
    """All PSFs of one camera, in no particular order; all have the same pixels and channels."""

    schema_version: Literal[1] = 1
    psf: tuple[PsfEntry, ...] = Field(min_length=1, max_length=10_000)

    # Of the whole set, as an error of the field `psf` alone would show all of its entries.
    @model_validator(mode="after")
    def _one_camera(self) -> Self:
        first = self.psf[0]
        names: set[str] = set()
        for each in self.psf:
            if each.pixel != first.pixel or each.channels != first.channels:
                raise refusal(
                    f"{each.file} has pixels of {each.pixel} and channels "
                    f"{', '.join(each.channels)}, but {first.file} has {first.pixel} and "
                    f"{', '.join(first.channels)}: a set holds the PSFs of one camera, read out in "
                    "one way"
                )
            if each.file in names:
                raise refusal(f"{each.file} is named twice: give every PSF its own file")
            names.add(each.file)
        return self

    def by_distance(self, kinds: tuple[PsfKind, ...]) -> tuple[PsfEntry, ...]:
        """PSFs of points straight ahead, nearest first; at each distance the first kind there is.

        The kinds are those to take, the best first.
        """
        by_distance: dict[float, PsfEntry] = {}
        for kind in kinds:
            for each in self.psf:
                if each.kind == kind and each.on_axis:
                    by_distance.setdefault(each.distance_um, each)
        return tuple(by_distance[distance] for distance in sorted(by_distance))
