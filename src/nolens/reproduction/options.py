"""What `nolens reproduce` is asked for, the folder that it writes, and on which machine."""

import os
import platform
import shutil
from pathlib import Path
from typing import Annotated

from nolens.errors import FileError
from nolens.files import check_folder
from nolens.jobs.fields import FilePath, Name
from nolens.jobs.options import JobOptions, Written
from nolens.ranges import Between

_INFO = Path("/proc/cpuinfo")
REPORT_FILES = ("report.html", "report.pdf", "report.json", "reproduction.md", "timing.json")
PICTURES, STEPS = "pictures", "steps"


def machine_name() -> str:
    """Name of the processor, and how many cores there are."""
    name = platform.processor() or platform.machine()
    if _INFO.exists():
        lines = _INFO.read_text().splitlines()
        models = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
        name = next(models, name)
    return f"{name}, {os.cpu_count()} cores"


def check_report_folder(folder: Path, needed_bytes: float) -> None:
    """Refuse a folder that a report cannot be written to, before any work is done for it.

    Parameters
    ----------
    folder
        Need not exist.
    needed_bytes
        That will be written.

    Raises
    ------
    FileError
        If it is a file, cannot be written to, holds something else than a report, or lies on a
        disk without room.
    """
    check_folder(folder)
    if folder.is_dir():
        ours = {*REPORT_FILES, PICTURES, STEPS}
        # What begins with a dot is a system's, or left over by a run that was killed.
        others = (each.name for each in folder.iterdir() if not each.name.startswith("."))
        found = sorted(name for name in others if name not in ours)
        if found:
            raise FileError(
                f"{folder} holds {found[0]}, which is no part of a report: give a folder that is "
                "empty or new, or that of an earlier report (-o)"
            )
    there = next(each for each in (folder, *folder.absolute().parents) if each.exists())
    free = shutil.disk_usage(there).free
    if free < needed_bytes:
        raise FileError(
            f"the report needs about {needed_bytes / 1e6:.0f} MB, and the disk of {folder} has "
            f"{free / 1e6:.0f} MB left: make room, or give another folder (-o)"
        )


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
