"""What a simulated camera looks at."""

from collections.abc import Iterator
from itertools import cycle
from pathlib import Path

from nolens.capture import TwinSource
from nolens.errors import FileError
from nolens.files import PICTURE_SUFFIXES, InputFile, read_picture
from nolens.jobs.capturing.options import CaptureOptions
from nolens.jobs.reporter import Reporter


class Stage:
    """Shows a simulated camera what a real one would be put before.

    Parameters
    ----------
    options
        They say what the frames are to show, and which pictures there are.

    Raises
    ------
    FileError
        If there is no such picture, or a folder without any.
    """

    def __init__(self, options: CaptureOptions) -> None:
        self._kind = options.kind
        self._paths = [] if options.scene is None else _pictures(options.scene)
        self._next: Iterator[Path] = cycle(self._paths)

    def inputs(self) -> dict[str, InputFile]:
        """Hash the pictures, while they are as they are read."""
        if len(self._paths) == 1:
            return {"scene": InputFile.of(self._paths[0])}
        return {
            f"scene {number}": InputFile.of(path)
            for number, path in enumerate(self._paths, start=1)
        }

    def prepare(self, source: TwinSource, reporter: Reporter) -> None:
        """Show what is seen first."""
        if self._kind == "dark":
            reporter.note("the simulated camera is covered")
            source.show_dark()
        elif self._kind == "psf":
            reporter.note("the simulated camera looks at a point source, straight ahead")
            source.show_point()
        elif self._paths:
            source.show(read_picture(self._paths[0]).radiance)

    def turn(self, source: TwinSource) -> None:
        """Show the next picture, where there are several: each frame sees another one."""
        if self._kind == "frame" and len(self._paths) > 1:
            source.show(read_picture(next(self._next)).radiance)


def _pictures(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    found = sorted(
        each
        for each in path.iterdir()
        if each.suffix.lower() in PICTURE_SUFFIXES and not each.name.startswith(".")
    )
    if not found:
        raise FileError(
            f"the folder {path} holds no picture; its files can be {', '.join(PICTURE_SUFFIXES)}"
        )
    return found
