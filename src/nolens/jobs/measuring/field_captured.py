"""PSFs of a camera's folder that were captured at angles, beside the central one."""

import math
from collections.abc import Sequence
from pathlib import Path

from nolens.camera import PsfEntry
from nolens.errors import DataError
from nolens.evaluate import clipped_cells
from nolens.experiments.off_axis import OffAxis, compared
from nolens.experiments.virtual_experiment import Tick
from nolens.files import read_psf, read_psf_set
from nolens.optics import PointSource
from nolens.twin import Twin


def captured_off_axis(
    folder: Path, twin: Twin | None, tick: Tick
) -> tuple[list[OffAxis], float, list[str]]:
    """Compare the PSFs of a camera's folder that were captured at angles with the central one.

    Parameters
    ----------
    folder
        With its list of PSFs.
    twin
        The camera; None leaves out what follows from it.
    tick
        Called with the share that is done.

    Returns
    -------
    tuple
        One for each PSF, by angle, the central one first; the distance of the light in um; and
        sentences to show, one for each doubt.

    Raises
    ------
    DataError
        If there is no central PSF or none from the side, or they do not fit the camera.
    FileError
        If a file cannot be read.
    """
    central, others = _chosen(folder, read_psf_set(folder).psf)
    doubts = []
    first = read_psf(folder, central).mean(dim=0)
    if twin is not None and not math.isclose(central.cell.um, twin.cell_um, rel_tol=0.01):
        raise DataError(
            f"{central.file} has cells of {central.cell}, but a reconstruction with the camera "
            f"{twin.camera.name!r} has cells of {twin.cell_um:g} µm: give the camera that the PSFs "
            "are from (--camera)"
        )
    found = []
    for number, entry in enumerate(others):
        tick(number / len(others))
        pattern = first if entry is central else read_psf(folder, entry).mean(dim=0)
        clipped = clipped_cells(pattern)
        if clipped:
            doubts.append(
                f"{clipped} cells of {folder / entry.file}, many side by side, have its very "
                "largest value: it seems to be clipped. Take a shorter exposure"
            )
        found.append(compared(first, pattern, source_of(entry), central.cell.um, twin))
    return found, central.distance_um, doubts


def source_of(entry: PsfEntry) -> PointSource:
    """Light of a PSF: to the right of the axis, and above it, where rows count downwards."""
    right, up = (math.tan(angle.rad) for angle in entry.angle)
    return PointSource((-up, right), entry.distance_um)


def _chosen(folder: Path, entries: Sequence[PsfEntry]) -> tuple[PsfEntry, list[PsfEntry]]:
    """The central PSF, and all of its distance by angle; those of the distance with the most."""
    captured = [
        each for each in entries
        if each.kind == "captured" and (each.on_axis or each.frame == "sensor")
    ]  # fmt: skip
    groups: dict[float, list[PsfEntry]] = {}
    for entry in captured:
        groups.setdefault(entry.distance_um, []).append(entry)
    whole = [group for group in groups.values() if any(each.on_axis for each in group)]
    if not whole:
        raise DataError(
            f"{folder} has no captured PSF of a light straight ahead to compare others with: "
            "calibrate one (nolens calibrate), at the distance of those from the side"
        )
    group = max(whole, key=len)
    if len(group) == 1:
        raise DataError(
            f"{folder} has no captured PSF of a light from the side at the distance of "
            f"{group[0].file}: calibrate some at known angles (nolens calibrate)"
        )
    central = next(each for each in group if each.on_axis)
    return central, sorted(group, key=lambda each: source_of(each).angle_deg)
