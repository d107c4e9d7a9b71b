"""What `nolens reproduce` can be told, as a frozen model."""

from pathlib import Path
from typing import Annotated

from nolens.jobs.fields import FilePath, Name
from nolens.jobs.given import JobOptions, Written
from nolens.ranges import Between

REPORT_FILES = ("report.html", "report.pdf", "report.json", "reproduction.md", "timing.json")
PICTURES, STEPS = "pictures", "steps"


class ReproduceOptions(JobOptions):
    """What `nolens reproduce` can be told.

    Attributes
    ----------
    output
        Folder of the report; made if missing.
    quick
        Read a part of the sensor, with fewer PSFs and iterations.
    seed
        Of the noise of all frames.
    camera
        Preset, folder or .toml file of the camera.
    """

    output: FilePath
    quick: bool = False
    seed: Annotated[int, Between(0, 2**31 - 1)] = 0
    camera: Name = "paper"

    @property
    def inputs(self) -> dict[str, Path]:
        """None but the camera's."""
        return {}

    @property
    def written(self) -> tuple[Written, ...]:
        """The report's files."""
        return tuple(Written("report", self.output / name) for name in REPORT_FILES)
