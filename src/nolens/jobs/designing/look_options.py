"""What a quick look at a design can be told."""

from pathlib import Path
from typing import Any, Self

from pydantic import Field

from nolens.camera.part import PositiveLength
from nolens.camera.psf_set import Depth
from nolens.errors import OptionError
from nolens.jobs.fields import FilePath, Name, Word
from nolens.jobs.given import JobOptions, Written


class Thicknesses(JobOptions):
    """Thickness of some layers of a camera, by name or, of one without a name, by its number."""

    thickness: dict[Word, PositiveLength] = Field(default_factory=dict, max_length=20)


class LookOptions(Thicknesses):
    """What a quick look at a design can be told.

    Attributes
    ----------
    camera
        Preset, folder or .toml file.
    thickness
        Of layers, by their names, in place of the camera's.
    distance
        Of the point source; None takes the camera's reference_distance.
    output
        Picture of the PSF to write (.png).
    """

    camera: Name = "paper"
    distance: Depth | None = None
    output: FilePath

    @classmethod
    def gather(cls, given: dict[str, Any]) -> Self:
        """Options by name.

        Raises
        ------
        OptionError
            If one is missing, or its value cannot be used.
        """
        if not given.get("output"):
            raise OptionError("no output is given; name the picture of the PSF (-o psf.png)")
        return cls.checked(given)

    @property
    def inputs(self) -> dict[str, Path]:
        """None but the camera's."""
        return {}

    @property
    def written(self) -> tuple[Written, ...]:
        """The picture."""
        return (Written("picture", self.output),)
