"""What the paper says (`uvimprint`), and sections of the report that compare our values with it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import wraps
from pathlib import Path
from tempfile import TemporaryDirectory

from nolens.files.reports import ReportPicture, ReportRow, ReportSection
from nolens.interrupt import Unfinished
from nolens.reproduction.setup import ExperimentSetup
from nolens.reproduction.steps import StepResult


@dataclass(frozen=True)
class _Printed:
    """A value of the paper with its unit, and the number alone if there is one to compare with."""

    what: str
    where: str
    text: str
    value: float | None = None


PAPER: dict[str, _Printed] = {
    "radius": _Printed("radius of curvature R of the mask's features", "sec. II", "0.67 mm", 0.67),
    "radius printed": _Printed(
        "the same, by eq. 3 as it is printed", "sec. II, eq. 3", "0.67 mm", 0.67
    ),
    "thickness pdms": _Printed(
        "thickness t′ of a replica in PDMS", "sec. II, eq. 5", "1.44 mm", 1.44
    ),
    "± pdms": _Printed("± of that t′", "sec. II", "0.41 mm", 0.41),
    "thickness pua311": _Printed(
        "thickness t′ of a replica in PUA 311", "sec. II, eq. 5", "1.28 mm", 1.28
    ),
    "± pua311": _Printed("± of that t′", "sec. II", "0.37 mm", 0.37),
    "focal length": _Printed("mean focal length of the mask", "sec. II", "about 1 mm", 1.0),
    "aperture": _Printed("mean NA of a lenslet", "sec. II and III", "about 0.035", 0.035),
    "depth of focus": _Printed("depth of focus", "sec. II", "about 0.41 mm", 0.41),
    "film": _Printed("thickness of the sharpest PDMS film", "fig. 2c", "1.25 mm", 1.25),
    "film width": _Printed("FWHM of the autocorrelation behind it", "fig. 2c", "20.15 µm", 20.15),
    "width": _Printed("FWHM of the PSF's autocorrelation", "fig. 5b", "20.15 µm", 20.15),
    "line": _Printed("width of a line of the PSF, FWHM/√2", "sec. III", "14.25 µm", 14.25),
    "pitch": _Printed("mean pitch of the PSF's pattern", "fig. 5b", "69.75 µm", 69.75),
    "mtf": _Printed("MTF at 0°, 90°, 180°, 270°", "fig. 5c", "consistent in all directions"),
    "two points": _Printed("two points told apart, at 180 mm", "fig. 6a", "0.6°", 0.6),
    "siemens": _Printed("Siemens star resolved in all directions", "fig. 6b", "0.73°", 0.73),
    "correlation 0.6": _Printed(
        "half angle at which the correlation with the central PSF falls to 0.6",
        "fig. 6c and sec. III",
        "22.5°",
        22.5,
    ),
    "correlation 0.3": _Printed(
        "half angle at which it falls to 0.3", "fig. 6c and sec. III", "38°", 38.0
    ),
    "overlap": _Printed(
        "overlap of the PSFs that is lost for every 10°", "fig. 6c and sec. III", "9.7 %", 9.7
    ),
    "dots clear": _Printed("dots are clear within a field of", "fig. 6d", "45°", 45.0),
    "dots lost": _Printed("dots are not reconstructed beyond a field of", "fig. 6d", "76°", 76.0),
    "exposure": _Printed("exposure for a screen", "sec. III", "40–70 ms"),
    "scene 7a": _Printed("a screen that fills 60°, at 300 mm", "fig. 7a", "a picture"),
    "scene 7b": _Printed("a screen that fills 50°, at 300 mm", "fig. 7b", "a picture"),
    "scene 7c": _Printed("a screen that fills 30°, at 300 mm", "fig. 7c", "a picture"),
    "scene 7d": _Printed("a scene at 10 cm", "fig. 7d", "a picture"),
    "scene 7e": _Printed("a scene at 50 cm", "fig. 7e", "a picture"),
    "scene 7f": _Printed("a scene at 60 cm", "fig. 7f", "a picture"),
    "seconds": _Printed("time for a photograph", "sec. III", "up to 250 s on an RTX 3090", 250.0),
    "magnification 8": _Printed(
        "PSF for 8 cm, larger than for 20 cm by", "fig. 8a and sec. III", "0.36 %", 0.36
    ),
    "magnification 3": _Printed(
        "PSF for 3 cm, larger than for 20 cm by", "fig. 8a and sec. III", "1.32 %", 1.32
    ),
    "magnification 30": _Printed(
        "PSF for a far scene against that for 30 cm", "sec. III", "no noticeable change"
    ),
    "near object": _Printed("the near object's distance", "fig. 8d", "8 cm", 8.0),
    "far object": _Printed("the far object's distance", "fig. 8e", "20 cm", 20.0),
}
"""By the key that rows of the report have."""


def paper_row(
    key: str, value: float | None, text: str, why: str, *, sized: bool = False
) -> ReportRow:
    """A value that came out here, beside what the paper says.

    Parameters
    ----------
    key
        Of the paper's value, in `PAPER`.
    value
        The number in the paper's unit; None where there is none.
    text
        The value with its unit.
    why
        How it came about, and why it differs from the paper's.
    sized
        Whether it depends on how much of the sensor is read.
    """
    printed = PAPER[key]
    return ReportRow(
        key=key,
        what=printed.what,
        where=printed.where,
        paper=printed.text,
        paper_value=printed.value,
        value=value,
        text=text,
        ratio=None if value is None or printed.value is None else value / printed.value,
        why=why,
        reduced=sized,
    )


def not_made(keys: tuple[str, ...], reason: str) -> tuple[ReportRow, ...]:
    """Rows of a figure that this camera cannot give."""
    return tuple(paper_row(key, None, "–", f"Not made with this camera: {reason}") for key in keys)


@dataclass(frozen=True)
class Picture:
    """A picture of the report: its file's name without suffix, and what draws it as PNG."""

    name: str
    caption: str
    draw: Callable[[Path], None]
    width_mm: float = 180.0

    def drawn(self) -> ReportPicture:
        """The picture, drawn."""
        with TemporaryDirectory(prefix="nolens-") as folder:
            path = Path(folder) / f"{self.name}.png"
            with Unfinished(folder, path):
                self.draw(path)
                return ReportPicture(self.name, path.read_bytes(), self.caption, self.width_mm)


@dataclass(frozen=True)
class Content:
    """A figure of the paper, made again: table, pictures that are still to be drawn, and texts."""

    rows: tuple[ReportRow, ...]
    pictures: tuple[Picture, ...] = ()
    texts: tuple[str, ...] = ()


Results = Mapping[str, StepResult]
"""Of the steps, by name."""


def section(
    name: str, title: str, keys: tuple[str, ...] = (), needs: tuple[str, ...] = ()
) -> Callable[
    [Callable[[ExperimentSetup, Results], Content]],
    Callable[[ExperimentSetup, Results], ReportSection],
]:
    """Make a section of its content: ``@section(...)`` before the function that gives that.

    Parameters
    ----------
    name, title
        As in `ReportSection`.
    keys
        Of its rows, which say why where a step that it needs could not be done.
    needs
        Names of these steps.
    """

    def decorate(
        make: Callable[[ExperimentSetup, Results], Content],
    ) -> Callable[[ExperimentSetup, Results], ReportSection]:
        @wraps(make)
        def drawn(setup: ExperimentSetup, results: Results) -> ReportSection:
            refused = [results[step].refused for step in needs]
            reason = next((each for each in refused if each is not None), None)
            content = make(setup, results) if reason is None else Content(not_made(keys, reason))
            rows = (replace(row, reduced=row.reduced and setup.reduced) for row in content.rows)
            pictures = tuple(picture.drawn() for picture in content.pictures)
            return ReportSection(name, title, content.texts, pictures, tuple(rows))

        return drawn

    return decorate
