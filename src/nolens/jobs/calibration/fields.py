"""Options that several jobs of calibration have, each with its text."""

from pathlib import Path
from typing import Annotated, Literal

from nolens.camera.part import PositiveLength
from nolens.jobs.fields import FilePath
from nolens.jobs.options import JobOptions, Option
from nolens.quantities import Length

NEEDED_FOLDER = "the folder of the camera's PSFs, as nolens calibrate makes it"

PsfFolder = Annotated[
    FilePath,
    Option(
        "Of the camera's PSFs, as nolens calibrate makes it.",
        needed=NEEDED_FOLDER,
        role="input",
        positional=True,
    ),
]
Reduced = Annotated[
    PositiveLength | None,
    Option(
        "Sum of thickness / index of the layers between mask and sensor, such as 1.28mm, where "
        "the folder has no camera.toml."
    ),
]


class FolderOptions(JobOptions):
    """What the jobs have in common that add PSFs to a folder which has some."""

    folder: PsfFolder

    @property
    def output_folder(self) -> Path:
        """That of the PSFs."""
        return self.folder

    @property
    def inputs(self) -> dict[str, Path]:
        """Nothing but what the folder lists."""
        return {}


def distance_name(distance: Length | Literal["infinity"]) -> str:
    """A distance as the names of files have it, the same for 30 cm and 300 mm."""
    return f"{distance.mm:.6g}mm" if isinstance(distance, Length) else distance
