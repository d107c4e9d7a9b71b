"""From one measured PSF of a folder to those of other distances."""

import math
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

from torch import Tensor

from nolens.calibrate.distances import Layers, Scaled, scaled_psf
from nolens.camera import PsfEntry, PsfKind, PsfSet
from nolens.errors import DataError, OptionError
from nolens.files import (
    CAMERA_FILE,
    InputFile,
    RunRecord,
    read_psf,
    read_psf_set,
    readable,
    write_psfs,
    write_record,
)
from nolens.jobs.calibration.distances_options import CalibrateDistancesOptions, psf_file
from nolens.jobs.calibration.folder import folder_camera
from nolens.jobs.clock import Clock
from nolens.jobs.options import check_apart
from nolens.jobs.reporter import Reporter
from nolens.quantities import Length

MEASURED: tuple[PsfKind, ...] = ("stitched", "extended", "captured", "solved")
"""Kinds that a PSF of another distance is made of; the first one has the widest view."""
_MUCH_UNKNOWN = 0.001
_DEFOCUSED_MM = 20.0


@dataclass(frozen=True)
class CalibrateDistancesOutcome:
    """PSFs that were added to a folder.

    Parameters
    ----------
    psfs
        (channels, rows, columns), by how the folder lists them.
    summary
        Figures, in values that JSON has.
    """

    psfs: dict[PsfEntry, Tensor]
    summary: dict[str, Any]


def calibrate_distances(
    options: CalibrateDistancesOptions, reporter: Reporter
) -> CalibrateDistancesOutcome:
    """Scale a measured PSF to other distances, and add them to its folder.

    Parameters
    ----------
    options
        Which folder, which distances.
    reporter
        Sees warnings and how far the work is.

    Raises
    ------
    NolensError
        If the folder or an option cannot be used; then nothing is written.
    """
    clock = Clock()
    psfs = read_psf_set(options.folder)
    layers = _layers(options)
    sources = {distance: _source(options, psfs, distance) for distance in options.distances}
    files = {f"PSF {each.file}": options.folder / each.file for each in sources.values()}
    check_apart(options, files)
    if (options.folder / CAMERA_FILE).is_file():
        files["camera"] = options.folder / CAMERA_FILE
    inputs = {role: InputFile.of(path) for role, path in files.items()}
    measured = {each.file: read_psf(options.folder, each) for each in sources.values()}
    made: dict[PsfEntry, Tensor] = {}
    rows: list[dict[str, Any]] = []
    warnings: list[str] = []
    for number, (distance, source) in enumerate(sources.items()):
        reporter.advance("distances", number / len(sources))
        found = scaled_psf(
            measured[source.file],
            source.cell.um,
            layers,
            measured_um=source.distance_um,
            wanted_um=_um(distance),
        )
        entry = PsfEntry(
            file=psf_file(distance),
            cell=source.cell,
            channels=source.channels,
            distance=distance,
            kind="scaled",
            usable_per_mm=source.usable_per_mm,
        )
        made[entry] = found.psf
        rows.append(
            {
                "file": entry.file,
                "distance": str(distance),
                "from": source.file,
                "from_distance": str(source.distance),
                "magnification": round(found.magnification, 6),
                "unknown_share": found.unknown_share,
            }
        )
        warnings += _doubts(found, distance)
    reporter.advance("distances", 1.0)
    for text in warnings:
        reporter.warn(text)
    summary = {
        "folder": readable(options.folder),
        "reduced_thickness_mm": round(layers.after.reduced_um * 1e-3, 5),
        "psfs": rows,
        "warnings": warnings,
        "outputs": [readable(each.path) for each in options.written],
        "seconds": clock.seconds,
    }
    record = RunRecord(
        started=clock.started,
        inputs=inputs,
        parameters=options.model_dump(mode="json", by_alias=True),
        result=summary,
        history=[],
        warnings=warnings,
    )
    write_psfs(
        options.folder, made, more={options.record.name: partial(write_record, record=record)}
    )
    return CalibrateDistancesOutcome(made, summary)


def _layers(options: CalibrateDistancesOptions) -> Layers:
    opened = folder_camera(options.folder)
    if opened is not None and options.reduced is not None:
        raise OptionError(
            f"--reduced {options.reduced}: the folder has a {CAMERA_FILE}, whose layers say the "
            "same. Leave --reduced out, or mend the layers"
        )
    if opened is not None:
        return Layers.of_camera(opened.camera)
    if options.reduced is None:
        raise OptionError(
            f"the folder has no {CAMERA_FILE}: give the reduced thickness between mask and sensor, "
            "the sum of thickness / index of all layers (--reduced 1.28mm)"
        )
    return Layers.of_air(options.reduced.um)


def _source(
    options: CalibrateDistancesOptions, psfs: PsfSet, distance: Length | Literal["infinity"]
) -> PsfEntry:
    """The measured PSF that one of another distance is made of."""
    there = [each for each in psfs.by_distance(MEASURED) if each.frame == "chief-ray"]
    if not there:
        raise DataError(
            f"{options.folder} has no measured PSF of a light straight ahead: add one first, with "
            "nolens calibrate FRAME... --distance 300mm"
        )
    if any(each.distance == distance for each in there):
        raise OptionError(
            f"the PSF of {distance} is in {options.folder} already, and was measured: leave "
            f"--at {distance} out"
        )
    if options.source is not None:
        for each in there:
            if each.distance == options.source:
                return each
        have = ", ".join(str(each.distance) for each in there)
        raise OptionError(f"--from {options.source}: measured PSFs are there for {have}")
    wanted = 1 / _um(distance)
    return min(there, key=lambda each: abs(1 / each.distance_um - wanted))


def _doubts(found: Scaled, distance: Length | Literal["infinity"]) -> list[str]:
    doubts = []
    if found.unknown_share > _MUCH_UNKNOWN:
        doubts.append(
            f"{100 * found.unknown_share:.2g} % of the PSF of {distance} lies beyond the measured "
            "one, and has the mean light of its neighbourhood: a stitched PSF, or one measured at "
            "a nearer distance would not need that"
        )
    if isinstance(distance, Length) and distance.mm < _DEFOCUSED_MM:
        doubts.append(
            f"{distance} is so near that the lenslets focus behind the sensor, which scaling does "
            "not show: measure a PSF there"
        )
    return doubts


def _um(distance: Length | Literal["infinity"]) -> float:
    return distance.um if isinstance(distance, Length) else math.inf
