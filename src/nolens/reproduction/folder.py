"""The folder of a report: what may lie in it, and whether there is room."""

import shutil
from pathlib import Path

from nolens.errors import FileError
from nolens.files import check_folder
from nolens.reproduction.options import PICTURES, REPORT_FILES, STEPS


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
