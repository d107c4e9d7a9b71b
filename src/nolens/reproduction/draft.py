"""A section of the report before its pictures are drawn."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from nolens.files.reports import ReportPicture, ReportSection
from nolens.interrupt import Unfinished
from nolens.reproduction.rows import Row, not_made
from nolens.reproduction.steps import Found


@dataclass(frozen=True)
class Drawn:
    """A picture and how it is drawn.

    Parameters
    ----------
    name
        Of its file, without suffix.
    caption
        What it shows.
    draw
        Writes it as PNG.
    width_mm
        How wide it is printed.
    """

    name: str
    caption: str
    draw: Callable[[Path], None]
    width_mm: float = 180.0


@dataclass(frozen=True)
class Draft:
    """A figure of the paper, made again.

    Parameters
    ----------
    name, title, texts
        As in `ReportSection`.
    pictures
        To be drawn.
    rows
        The table.
    """

    name: str
    title: str
    texts: tuple[str, ...]
    pictures: tuple[Drawn, ...]
    rows: tuple[Row, ...]

    def finished(self, *, reduced: bool) -> ReportSection:
        """Draw the pictures, and put the rows into words.

        Parameters
        ----------
        reduced
            Whether less than the whole sensor was read.
        """
        pictures = []
        with TemporaryDirectory(prefix="nolens-") as folder:
            paths = [Path(folder) / f"{each.name}.png" for each in self.pictures]
            with Unfinished(folder, *paths):
                for each, path in zip(self.pictures, paths, strict=True):
                    each.draw(path)
                    png = path.read_bytes()
                    pictures.append(ReportPicture(each.name, png, each.caption, each.width_mm))
        rows = tuple(row.told(reduced=reduced) for row in self.rows)
        return ReportSection(self.name, self.title, self.texts, tuple(pictures), rows)


def refusal(found: Mapping[str, Found], names: tuple[str, ...]) -> str | None:
    """Why a step that a section needs could not be done; None where all were."""
    return next((found[name].refused for name in names if found[name].refused is not None), None)


def empty(name: str, title: str, keys: tuple[str, ...], reason: str) -> Draft:
    """A section that this camera cannot give."""
    return Draft(name, title, (), (), not_made(keys, reason))
