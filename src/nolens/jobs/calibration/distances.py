"""`nolens calibrate distances`: from one measured PSF of a folder to those of other distances."""

from pathlib import Path
from typing import Annotated, Any

from pydantic import Field
from torch import Tensor

from nolens.calibrate.distances import evenly_between, scaled_psf
from nolens.camera import PsfEntry, PsfKind
from nolens.camera.psf_set import Depth
from nolens.errors import OptionError
from nolens.files import PSFS_FILE, read_psf, readable
from nolens.files.psf_folder import PsfFolder
from nolens.jobs.calibration.folder import (
    FolderOptions,
    Reduced,
    added,
    distance_name,
)
from nolens.jobs.fields import Distances, two_parts
from nolens.jobs.options import RECORD, Option, Written
from nolens.jobs.run import Product, Run, job
from nolens.ranges import Between

_MEASURED: tuple[PsfKind, ...] = ("stitched", "extended", "captured", "solved")
"""Kinds that a PSF of another distance is made of; the first one has the widest view."""


class CalibrateDistancesOptions(FolderOptions):
    """Make PSFs of other distances of a measured one, by how the rays magnify it.

    nolens calibrate distances mycamera --at 8cm --at 20cm --at infinity

    The PSF of a point source at the distance z is 1 + D/z times as large as that of a far one, D
    being the reduced thickness between mask and sensor. The larger the measured PSF, the better:
    one that was stitched is taken before one that was captured.
    """

    usage = "calibrate distances FOLDER --at 8cm --at 20cm"

    at: Annotated[
        Distances, Option("Distance that a PSF is wanted at, or infinity; again for more.")
    ] = ()
    between: Annotated[
        tuple[Depth, Depth] | None,
        two_parts("give two distances, such as 8cm,1m or 8cm,infinity"),
        Option("The nearest and the farthest of several distances, such as 8cm,1m, with --count."),
    ] = None
    count: Annotated[
        Annotated[int, Between(2, 1000)] | None,
        Option(
            "How many distances --between has; they are equally far apart in 1/z, as PSFs are "
            "in size."
        ),
    ] = None
    source: Annotated[
        Depth | None,
        Field(alias="from"),
        Option(
            "Distance of the measured PSF that all come from.", default="the nearest one, in 1/z"
        ),
    ] = None
    reduced: Reduced = None

    def check_together(self) -> None:
        """Refuse no distance, one given twice, and a span without a number of distances."""
        if not self.at and self.between is None:
            raise OptionError(
                "no distance is given: say which PSFs are wanted (--at 8cm --at infinity, or "
                "--between 8cm,1m --count 8)"
            )
        if (self.between is None) != (self.count is None):
            raise OptionError("--between and --count go together: --between 8cm,1m --count 8")
        names = [distance_name(each) for each in self.distances]
        for each in names:
            if names.count(each) > 1:
                raise OptionError(f"the distance {each} is given twice: give it once")

    @property
    def distances(self) -> tuple[Depth, ...]:
        """All distances that PSFs are wanted at."""
        if self.between is None or self.count is None:
            return self.at
        return (*self.at, *evenly_between(*self.between, self.count))

    @property
    def record(self) -> Path:
        """File of the run's record."""
        return self.folder / "distances.json"

    @property
    def written(self) -> tuple[Written, ...]:
        """PSFs, list and record."""
        return (
            *(
                Written(f"PSF of {distance}", self.folder / _psf_file(distance), "--at")
                for distance in self.distances
            ),
            Written("list of PSFs", self.folder / PSFS_FILE),
            Written(RECORD, self.record),
        )


def _psf_file(distance: Depth) -> str:
    return f"scaled-{distance_name(distance)}.tif"


@job
def calibrate_distances(run: Run[CalibrateDistancesOptions]) -> Product[dict[PsfEntry, Tensor]]:
    """Scale a measured PSF to other distances, and add them to its folder.

    Raises
    ------
    NolensError
        If the folder or an option cannot be used; then nothing is written.
    """
    options, reporter = run.options, run.reporter
    folder = PsfFolder(options.folder)
    there = folder.ahead(*_MEASURED)
    layers = folder.layers(options.reduced)
    sources = {each: folder.nearest(there, each, options.source) for each in options.distances}
    run.reads({f"PSF {each.file}": options.folder / each.file for each in sources.values()})
    run.reads(folder.camera_files)
    measured = {each.file: read_psf(options.folder, each) for each in sources.values()}
    run.begin()
    made: dict[PsfEntry, Tensor] = {}
    rows: list[dict[str, Any]] = []
    warnings: list[str] = []
    for number, (distance, source) in enumerate(sources.items()):
        reporter.advance("distances", number / len(sources))
        entry = source.derived(_psf_file(distance), "scaled", distance=distance)
        scaled = scaled_psf(
            measured[source.file],
            source.pixel.um,
            layers,
            measured_um=source.distance_um,
            target_um=entry.distance_um,
        )
        made[entry] = scaled.psf
        rows.append(
            {
                "file": entry.file,
                "distance": str(distance),
                "from": source.file,
                "from_distance": str(source.distance),
                "magnification": round(scaled.magnification, 6),
                "unknown_fraction": scaled.unknown_fraction,
            }
        )
        warnings += scaled.warnings(distance)
    reporter.advance("distances", 1.0)
    run.warn(*warnings)
    figures = {
        "folder": readable(options.folder),
        "reduced_thickness_mm": round(layers.after.reduced_um * 1e-3, 5),
        "psfs": rows,
    }
    return added(made, figures, options.folder, made)
