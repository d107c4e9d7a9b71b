"""What `nolens measure psf` can be told."""

from pathlib import Path
from typing import Annotated, Any, Self

from nolens.camera import BlackLevel
from nolens.camera.part import PixelPitch
from nolens.errors import OptionError
from nolens.jobs.fields import FilePath, Name, Word, record_beside
from nolens.jobs.options import JobOptions, Written
from nolens.ranges import Between


class MeasurePsfOptions(JobOptions):
    """Options of `nolens measure psf`.

    Attributes
    ----------
    psf
        File of the PSF.
    pixel
        Distance of the file's pixels; None takes what the list of its folder says.
    camera
        Preset, folder or .toml file; None takes the camera in the PSF's folder, if there is one.
    channels
        ``grey`` for the mean of all, or one letter.
    black
        Count that stands for no light, in place of the file's own; "auto" reads it off the
        darkest corner.
    noise
        Standard deviation of the noise of a cell, in the file's counts; None has it estimated.
    plot
        Picture to write.
    """

    psf: FilePath
    pixel: PixelPitch | None = None
    camera: Name | None = None
    channels: Word = "grey"
    black: BlackLevel = None
    noise: Annotated[float, Between(0, 1e9)] | None = None
    plot: FilePath | None = None

    @classmethod
    def gather(cls, given: dict[str, Any]) -> Self:
        """Options as the command line gives them.

        Raises
        ------
        OptionError
            If a value cannot be used.
        """
        options = cls.checked(given)
        if options.channels.lower() not in ("grey", "r", "g", "b"):
            raise OptionError(
                f"--channels {options.channels}: the figures are those of one plane; give grey, "
                "the mean of all channels, or one of r, g and b"
            )
        return options

    @property
    def record(self) -> Path | None:
        """File of the run's record, beside the plot."""
        return None if self.plot is None else record_beside(self.plot)

    @property
    def inputs(self) -> dict[str, Path]:
        """The PSF."""
        return {"PSF": self.psf}

    @property
    def written(self) -> tuple[Written, ...]:
        """Plot and record."""
        if self.plot is None or self.record is None:
            return ()
        return (
            Written("plot", self.plot, "--plot"),
            Written("record of the run", self.record, "--plot"),
        )
