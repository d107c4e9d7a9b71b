"""The PSFs of a camera's folder, ready for any depth of one measurement."""

from dataclasses import dataclass
from pathlib import Path

from torch import Tensor

from nolens.camera import Camera, Frame, Measurement, PsfEntry, PsfKind, develop, prepare_psf
from nolens.camera.measurement import bin_mean
from nolens.camera.psf_warnings import edge_warning
from nolens.errors import DataError, OptionError
from nolens.files import CAMERA_FILE, read_camera, read_psf, read_psf_set
from nolens.jobs.refocusing.options import RefocusOptions
from nolens.refocusing import (
    PsfAt,
    PsfBetween,
    depth_of_focus_per_m,
    line_cells,
    lit_cells,
    measured_reduced_um,
    per_m,
)

_KINDS: tuple[PsfKind, ...] = ("stitched", "extended", "captured", "solved", "scaled")
"""Those that reach beyond the sensor first, and what was measured before what was worked out."""
_OF_THE_SENSOR = ("captured", "solved")
_ALIKE = 0.7
_LINES = 0.25


@dataclass(frozen=True)
class DepthPsfs:
    """PSFs for the depths of a scene.

    Parameters
    ----------
    between
        They, on the cells of the file.
    bin_by
        Cells along one of the measurement's.
    depth_of_focus_per_m
        Difference of 1/z that can be told.
    files
        Theirs, by role.
    warnings
        Sentences to show.
    """

    between: PsfBetween
    bin_by: int
    depth_of_focus_per_m: float
    files: dict[str, Path]
    warnings: tuple[str, ...]

    @property
    def distances_um(self) -> tuple[float, ...]:
        """The nearest first."""
        return tuple(each.distance_um for each in reversed(self.between.known))

    def at(self, depth_um: float) -> Tensor:
        """PSF of a depth on the measurement's cells."""
        return bin_mean(self.between.at(depth_um), self.bin_by)


def read_depth_psfs(options: RefocusOptions, measurement: Measurement) -> DepthPsfs:
    """Read the PSFs of points straight ahead that fit a measurement.

    Raises
    ------
    FileError
        If the folder has no list of PSFs, or one of them cannot be read.
    DataError
        If none is of points straight ahead, or they do not fit the measurement.
    OptionError
        If nothing says how the PSF changes with the distance.
    """
    entries = read_psf_set(options.psfs).by_distance(_KINDS)
    if not entries:
        raise DataError(
            f"the PSFs in {options.psfs} are all of point sources beside the axis: refocusing "
            "needs those straight ahead, at several distances (nolens calibrate)"
        )
    camera = _camera(options.psfs)
    files = {f"PSF {each.file}": options.psfs / each.file for each in entries}
    if camera is not None:
        _check_readout(measurement, camera, entries[0], options.bin)
    read = [(entry, _read(options, entry, measurement)) for entry in entries]
    known, wide = _alike(read, measurement, options.bin)
    reduced, warnings = _reduced(known, entries[0], camera, options.psfs)
    between = PsfBetween.of(known, reduced)
    seen = measurement.values.shape[-2] * options.bin, measurement.values.shape[-1] * options.bin
    cell_um = entries[0].cell.um
    edge = None if wide else edge_warning(entries[0].file, known[0].psf, seen)
    warnings += [] if edge is None else [edge]
    return DepthPsfs(
        between,
        options.bin,
        depth_of_focus_per_m(
            line_cells(known[0].psf) * cell_um, reduced, lit_cells(known[0].psf, seen) * cell_um
        ),
        files,
        (*warnings, *_gaps(between)),
    )


def _camera(folder: Path) -> Camera | None:
    return read_camera(folder).camera if (folder / CAMERA_FILE).is_file() else None


def _check_readout(measurement: Measurement, camera: Camera, entry: PsfEntry, bin_by: int) -> None:
    """Refuse a photograph that was read out in another way than the PSFs."""
    pixels = round(entry.cell.um / camera.sensor.pitch.um)
    sides = camera.sensor.rows, camera.sensor.columns
    rows, columns = (count // max(1, pixels) // bin_by for count in sides)
    if tuple(measurement.values.shape[-2:]) != (rows, columns):
        raise DataError(
            f"{measurement.source} has {measurement.size_text} cells, but the sensor of the camera "
            f"{camera.name!r} has {rows}×{columns} of the PSFs' {entry.cell}: give a photograph "
            "that was read out like the PSFs, uncut"
        )


def _read(options: RefocusOptions, entry: PsfEntry, measurement: Measurement) -> Tensor:
    """A PSF on the cells of its file, in the measurement's channels; checked against it."""
    counts = read_psf(options.psfs, entry)
    path = str(options.psfs / entry.file)
    frame = Frame(counts, entry.channels, None, (0.0,), None, "float32", path, black_stated=True)
    channels = "all" if len(entry.channels) == 1 else options.channels
    own = develop(frame, bin_by=options.bin, channels=channels)
    wider = own.values.shape[-2:] != measurement.values.shape[-2:]
    if wider and entry.kind in _OF_THE_SENSOR:
        raise DataError(
            f"the PSF {path} was {entry.kind} with {own.size_text} cells, but the measurement "
            f"{measurement.source} has {measurement.size_text}: give a photograph that was read "
            "out like the PSFs"
        )
    prepare_psf(own, measurement, wider=wider)
    return develop(frame, channels=channels).values.clamp_min(0)


def _alike(
    read: list[tuple[PsfEntry, Tensor]], measurement: Measurement, bin_by: int
) -> tuple[list[PsfAt], bool]:
    """PSFs of one size: those beyond the sensor where there are any; whether they are."""
    sensor = tuple(measurement.values.shape[-2:])
    wide = [
        pair
        for pair in read
        if (pair[1].shape[-2] // bin_by, pair[1].shape[-1] // bin_by) != sensor
    ]
    chosen = wide or read
    rows, columns = (min(psf.shape[axis] for _, psf in chosen) for axis in (-2, -1))
    return [PsfAt(_middle(psf, rows, columns), each.distance_um) for each, psf in chosen], bool(
        wide
    )


def _middle(psf: Tensor, rows: int, columns: int) -> Tensor:
    """Cells around the zero shift, which stays in the middle."""
    top, left = psf.shape[-2] // 2 - rows // 2, psf.shape[-1] // 2 - columns // 2
    return psf[..., top : top + rows, left : left + columns]


def _reduced(
    known: list[PsfAt], entry: PsfEntry, camera: Camera | None, folder: Path
) -> tuple[float, list[str]]:
    """Reduced distance of mask and sensor, and a warning where camera and PSFs disagree."""
    measured = measured_reduced_um(known)
    described = _described_um(camera) if camera is not None else None
    if described is None:
        if measured is None:
            one = len({each.distance_um for each in known}) == 1
            have = (
                f"is one PSF only, of {entry.distance}"
                if one
                else "are PSFs as large as each other"
            )
            raise OptionError(
                f"in {folder} there {have}, and nothing says how it changes with the distance: "
                f"calibrate a second, much nearer one, or put the camera's {CAMERA_FILE} there"
            )
        return measured, []
    if measured is None:
        return described, []
    span = per_m(min(each.distance_um for each in known)) - per_m(
        max(each.distance_um for each in known)
    )
    psf = known[0].psf
    apart = abs(measured - described) * 1e-6 * span * max(psf.shape[-2:]) / 2
    if apart < _LINES * line_cells(psf):
        return described, []
    return measured, [
        f"the PSFs change with the distance as if mask and sensor were {measured * 1e-3:.3g} mm "
        f"apart (in air), but by {CAMERA_FILE} it is {described * 1e-3:.3g} mm: the PSFs' is "
        "taken; check the distances they were taken at"
    ]


def _described_um(camera: Camera) -> float:
    """Σ thickness / index of the layers behind the mask."""
    first = camera.mask.surface
    indices = camera.indices(550.0)[first:]
    return sum(
        layer.thickness.um / index
        for layer, index in zip(camera.layers[first:], indices, strict=True)
    )


def _gaps(between: PsfBetween) -> list[str]:
    """Warn where neighbours are too unlike to be blended."""
    texts = []
    for number, alike in enumerate(between.alike):
        far, near = between.known[number].distance_um, between.known[number + 1].distance_um
        if alike < _ALIKE:
            texts.append(
                f"the depth set has a gap: brought to one size, the PSFs of {near * 1e-3:.4g} mm "
                f"and {far * 1e-3:.4g} mm are alike to {100 * alike:.0f} % only, so depths between "
                "them come out worse: calibrate one between"
            )
    return texts
