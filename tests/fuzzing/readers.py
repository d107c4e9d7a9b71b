"""Readers of files that a program of ours wrote and no command is given by name."""

import shutil
from collections.abc import Callable
from pathlib import Path

from nolens.files import read_record
from nolens.studio.jobs import JobQueue
from nolens.studio.workspace import Workspace


def _record(path: Path) -> None:
    read_record(path)


def _job(folder: Path) -> None:
    """A studio starts whatever stands in the folder of a job."""
    work = folder / "work"
    (work / "jobs").mkdir(parents=True)
    shutil.copytree(folder, work / "jobs" / JOB, ignore=shutil.ignore_patterns("work"))
    workspace = Workspace([work])
    JobQueue(workspace).all()
    workspace.listing("work/jobs")


def _workspace(folder: Path) -> None:
    """The page lists whatever cameras stand in its workspace."""
    workspace = Workspace([folder.parent])
    workspace.cameras()
    workspace.listing(f"work/{folder.name}")


JOB = "20260101-000000-psf-0000"
"""Id of the job that is damaged."""
READERS: dict[str, Callable[[Path], None]] = {
    "@record": _record,
    "@job": _job,
    "@workspace": _workspace,
}
"""What is run, by the first argument of its target."""
