"""How fine, dense and clear a PSF is: from a file to figures and a plot."""

import math
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from torch import Tensor

from nolens.camera import Frame, OpenCamera, black_level, check_psf, develop
from nolens.design.focus import depth_of_focus_um, lenslet_aperture
from nolens.errors import OptionError
from nolens.evaluate import PsfFigures, clipped_cells, psf_figures
from nolens.files import (
    CAMERA_FILE,
    PSFS_FILE,
    InputFile,
    RunRecord,
    camera_files,
    check_output,
    read_camera,
    read_frame,
    read_psf_set,
    readable,
    write_record,
    write_together,
)
from nolens.files.plot_psf import write_psf_plot
from nolens.jobs.clock import Clock
from nolens.jobs.measuring.psf_options import MeasurePsfOptions
from nolens.jobs.measuring.rounded import rounded
from nolens.jobs.options import check_apart
from nolens.jobs.reporter import Reporter
from nolens.optics import PointSource
from nolens.twin import REFERENCE_NM
from nolens.twin.preview import preview_model

_CLOSE = 0.01
_CURVES = (
    "lag_um",
    "autocorrelation",
    "row_autocorrelation",
    "per_mm",
    "magnitude",
    "direction_magnitude",
)


@dataclass(frozen=True)
class MeasurePsfOutcome:
    """What the measurement came to.

    Parameters
    ----------
    figures
        Of the PSF.
    summary
        All of them and what follows from them, in values that JSON has.
    """

    figures: PsfFigures
    summary: dict[str, Any]


def measure_psf(options: MeasurePsfOptions, reporter: Reporter) -> MeasurePsfOutcome:
    """Read a PSF and measure it; a plot is written if one is asked for.

    Parameters
    ----------
    options
        What to read and to write.
    reporter
        Is told of doubts.

    Raises
    ------
    NolensError
        If the file, the pitch or an output cannot be used, or it shows no pattern; then nothing is
        written.
    """
    clock = Clock()
    if options.psf.is_dir():
        raise OptionError(
            f"{options.psf} is a folder: give one of its PSFs, {_listed(options.psf)}"
        )
    frame = read_frame(options.psf)
    opened, files = _camera(options)
    check_apart(options, {**options.inputs, **files})
    if options.plot is not None and options.record is not None:
        check_output(options.plot, (".png",))
        check_output(options.record, (".json",))
    pixel_um = _pixel_um(options, frame, opened)
    one = len(frame.channels) == 1 and frame.mosaic is None
    measured = develop(
        frame,
        black=black_level(options.black, frame),
        channels="all" if one else options.channels.lower(),
    )
    warnings = check_psf(measured, measured.values)
    cell_um = pixel_um * (1 if frame.mosaic is None else 2)
    inputs = {role: InputFile.of(path) for role, path in {**options.inputs, **files}.items()}
    reduced_um = None
    if opened is not None:
        twin = preview_model(opened)
        reduced_um = twin.illumination(PointSource(), REFERENCE_NM).after.reduced_um
    plane = measured.values[0]
    figures = psf_figures(plane, cell_um, reduced_um=reduced_um, noise=options.noise)
    warnings += _doubts(figures, frame, plane)
    for text in warnings:
        reporter.warn(text)
    summary = {
        "psf": readable(options.psf),
        "camera": None if opened is None else opened.camera.name,
        "cells": list(plane.shape),
        "channel": measured.channels[0],
        **_told(figures),
        **_lenslets(figures, reduced_um),
        "warnings": warnings,
        "outputs": [readable(each.path) for each in options.written],
        "seconds": clock.seconds,
    }
    if options.plot is not None and options.record is not None:
        record = RunRecord(
            started=clock.started,
            inputs=inputs,
            parameters=options.model_dump(mode="json"),
            result=summary,
            history=[],
            warnings=warnings,
        )
        write_together(
            {
                options.record: partial(write_record, record=record),
                options.plot: partial(write_psf_plot, figures=figures, psf=plane, cell_um=cell_um),
            }
        )
    return MeasurePsfOutcome(figures, summary)


def _camera(options: MeasurePsfOptions) -> tuple[OpenCamera | None, dict[str, Path]]:
    """The camera that is named, or the one in the PSF's folder, and the files it is read from."""
    given: str | Path | None = options.camera
    if given is None and (options.psf.parent / CAMERA_FILE).is_file():
        given = options.psf.parent / CAMERA_FILE
    if given is None:
        return None, {}
    opened = read_camera(given)
    return opened, camera_files(given, opened.camera)


def _pixel_um(options: MeasurePsfOptions, frame: Frame, opened: OpenCamera | None) -> float:
    """Distance of the file's pixels, where all that is known of it agrees."""
    folder, given = options.psf.parent, options.pixel
    listed = None
    if (folder / PSFS_FILE).is_file():
        entries = {each.file: each for each in read_psf_set(folder).psf}
        entry = entries.get(options.psf.name)
        listed = None if entry is None else entry.cell
    if given is None and listed is None:
        raise OptionError(
            f"no pitch of the pixels of {options.psf} is known: give --pixel with its unit, such "
            "as --pixel 3.1um"
        )
    if given is not None and listed is not None and not _alike(given.um, listed.um):
        raise OptionError(
            f"--pixel {given}, but {folder / PSFS_FILE} says that the pixels of "
            f"{options.psf.name} are {listed} apart: leave --pixel out, or calibrate again"
        )
    length = given if given is not None else listed
    assert length is not None
    if opened is not None:
        _check_pitch(length.um, frame, opened)
    return length.um


def _check_pitch(pixel_um: float, frame: Frame, opened: OpenCamera) -> None:
    """Refuse a pitch that is not that of the camera's sensor, or of whole numbers of its pixels."""
    sensor = opened.camera.sensor
    ratio = pixel_um / sensor.pitch.um
    rows, columns = frame.counts.shape[-2:]
    binned = max(1, round(ratio))
    fitting = sensor.rows // rows
    whole = fitting >= 1 and (sensor.rows // fitting, sensor.columns // fitting) == (rows, columns)
    expected = fitting if whole else 1 if frame.mosaic is not None else binned
    if not _alike(ratio, expected):
        raise OptionError(
            f"--pixel {pixel_um:g} µm does not fit the camera {opened.camera.name!r}, whose "
            f"{sensor.rows}×{sensor.columns} pixels are {sensor.pitch} apart: those of a file of "
            f"{rows}×{columns} would be {expected * sensor.pitch.um:g} µm. Give that, or another "
            "--camera"
        )


def _alike(one: float, other: float) -> bool:
    return math.isclose(one, other, rel_tol=_CLOSE)


def _listed(folder: Path) -> str:
    if not (folder / PSFS_FILE).is_file():
        return "a picture file"
    files = [str(folder / each.file) for each in read_psf_set(folder).psf]
    return ", ".join(files[:3]) + (" …" if len(files) > 3 else "")


def _doubts(figures: PsfFigures, frame: Frame, plane: Tensor) -> list[str]:
    doubts = []
    clipped = clipped_cells(plane) if frame.white is None else 0
    if clipped:
        doubts.append(
            f"{clipped} cells of the PSF {frame.source}, many side by side, have its very "
            "largest value: it seems to be clipped, and its lines wider than they are. Take a "
            "shorter exposure"
        )
    if figures.pitch_um is None:
        doubts.append(
            f"the autocorrelation of the PSF {frame.source} has no second peak within a quarter "
            "of the frame: no pitch is told"
        )
    if figures.line_width_um < 2 * figures.cell_um:
        doubts.append(
            f"the lines of the PSF {frame.source} are {figures.line_width_um:.3g} µm wide, less "
            "than two cells: smaller pixels or a smaller --bin would tell more"
        )
    return doubts


def _told(figures: PsfFigures) -> dict[str, Any]:
    """All figures by name, the curves last."""
    named = asdict(figures)
    curves = {name: rounded(named.pop(name)) for name in _CURVES}
    return {**rounded(named), "curves": curves}


def _lenslets(figures: PsfFigures, reduced_um: float | None) -> dict[str, Any]:
    """Aperture and depth of focus of a lenslet as wide as the pitch (`uvimprint`)."""
    if reduced_um is None:
        return {}
    told: dict[str, Any] = {
        "reduced_thickness_mm": round(reduced_um * 1e-3, 5),
        "one_per_mm_in_per_degree": rounded(reduced_um * 1e-3 * math.pi / 180),
        "lenslet_aperture": None,
        "depth_of_focus_mm": None,
    }
    if figures.pitch_um is not None:
        aperture = lenslet_aperture(figures.pitch_um, reduced_um)
        depth_um = depth_of_focus_um(REFERENCE_NM * 1e-3, aperture)
        told["lenslet_aperture"] = rounded(float(aperture))
        told["depth_of_focus_mm"] = rounded(float(depth_um) * 1e-3)
    return told
