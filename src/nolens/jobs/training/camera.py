"""The camera that measurements to train on are simulated with."""

import math
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import torch

from nolens.camera import FieldPsf, LoadedCamera, RandomLenslets
from nolens.camera.psf_set import depth_um
from nolens.errors import DataError, FileError
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.files import CAMERA_FILE, PSFS_FILE
from nolens.files.psf_folder import PsfFolder
from nolens.jobs.run import Run
from nolens.jobs.training.options import TrainOptions
from nolens.optics import PointSource
from nolens.progress import ProgressCallback, part_of
from nolens.quantities import Length
from nolens.training.cameras import SMALLEST_PSF, KnownCamera, RandomCameras, TrainingCamera
from nolens.twin import LARGEST_ANGLE_DEG, Light, distance_um, preview_model

_LARGEST_PSF = 676
"""Pixels along a side of a computed PSF, which the largest scene and sensor to train on need."""
_LIGHT, _WAVELENGTHS = "white-led", 3
_DIAMETER_UM = 50.0
_SIMULATED = 12
_LARGER, _FLATTER, _PIXELS = (-0.5, 1.0), (-0.2, 0.5), (-0.2, 0.5)
"""Logarithms of factors on the paper's lenslets, on their radius beyond that, and on its pixels."""
_PLACES = (0, 0), (0, 1), (1, 0), (-0.7, -0.7)
"""Of the field points, over half of the scene's angle."""
_REMEDY = "a camera with fewer or larger pixels, or a coarser grid of its relief, needs less"


def training_camera(run: Run[TrainOptions]) -> TrainingCamera | None:
    """The camera of the options, random ones where they name none; None of white noise.

    Raises
    ------
    NolensError
        If it has no PSF, or one that is too small, or has other channels than grey or three.
    """
    name = run.options.camera
    if run.options.prior == "denoiser":
        return None
    if name is None:
        return _random_cameras(run)
    folder = Path(name).expanduser()
    if (folder / PSFS_FILE).is_file():
        return _checked(_of_folder(run, folder), name)
    if folder.is_dir() and not (folder / CAMERA_FILE).is_file():
        raise FileError(
            f"the folder {folder} has no PSF to train with: neither {PSFS_FILE}, which nolens "
            f"calibrate writes, nor {CAMERA_FILE}, by which PSFs are computed"
        )
    return _checked(_simulated(run, name), name)


def _of_folder(run: Run[TrainOptions], path: Path) -> KnownCamera:
    """A camera by the PSFs that its folder lists."""
    distance = run.options.distance
    folder = PsfFolder(path)
    run.reads({PSFS_FILE: path / PSFS_FILE, **folder.camera_files})
    scene = folder.for_scene(None if distance is None else depth_um(distance))
    if scene.note:
        run.reporter.note(scene.note)
    run.reads({f"PSF {each.file}": path / each.file for each in scene.entries})
    planes = [each.frame.counts for each in scene.field_points] or [scene.ahead.counts]
    places = [each.place for each in scene.field_points] or [(0.0, 0.0)]
    sensor = None if folder.camera is None else folder.camera.camera.sensor
    colours = 3 if sensor is None else len(sensor.channels)
    if len(planes[0]) == 1 and colours == 3:
        planes = [each.expand(3, -1, -1) for each in planes]
    values = FieldPsf.of([each.float() for each in planes], torch.tensor(places).double())
    return KnownCamera.of(values, sensor)


def _simulated(run: Run[TrainOptions], name: str) -> KnownCamera:
    """A camera by PSFs that the twin computes at a few field points."""
    return _by_twin(run, run.camera(name), partial(run.reporter.advance, "PSFs"))


def _random_cameras(run: Run[TrainOptions]) -> RandomCameras:
    """Random ones, and some of random lenslets over the paper's layers, by the twin: their PSFs are
    as diffraction makes them, and change over the field.
    """
    random = np.random.default_rng(run.options.seed)
    paper = run.camera("paper")
    relief, sensor = paper.camera.mask.relief, paper.camera.sensor
    assert isinstance(relief, RandomLenslets)
    known = []
    for number in range(_SIMULATED):
        by = math.exp(random.uniform(*_LARGER))
        lenslets = {
            "pitch": _times(relief.pitch, by),
            "radius": _times(relief.radius, by * math.exp(random.uniform(*_FLATTER))),
            "seed": int(random.integers(2**31)),
        }
        pixels = {
            "pitch": _times(sensor.pitch, math.exp(random.uniform(*_PIXELS))),
            "rows": 2 * _LARGEST_PSF,
            "columns": 2 * _LARGEST_PSF,
        }
        part = {"sensor": sensor.model_copy(update=pixels)}
        loaded = paper.with_relief(relief.model_copy(update=lenslets))
        loaded = replace(loaded, camera=loaded.camera.model_copy(update=part))
        progress = partial(run.reporter.advance, "simulated cameras")
        known.append(_by_twin(run, loaded, part_of(progress, number, _SIMULATED)))
    return RandomCameras(tuple(known))


def _times(length: Length, factor: float) -> Length:
    return Length(f"{factor * length.um:.4g}", "um")


def _by_twin(
    run: Run[TrainOptions], loaded: LoadedCamera, progress: ProgressCallback
) -> KnownCamera:
    """A camera by PSFs that the twin computes at a few field points."""
    options = run.options
    preview = VirtualExperiment(preview_model(loaded), Light(_LIGHT), _WAVELENGTHS)
    away = distance_um(options.distance, loaded)
    tangent = math.tan(options.angle.rad / 2)
    sources = [
        PointSource(
            (down * tangent, right * tangent), away, 0.0 if math.isinf(away) else _DIAMETER_UM
        ).within(LARGEST_ANGLE_DEG)
        for down, right in _PLACES
    ]
    rows, columns = preview.twin.shape
    size = min(rows, _LARGEST_PSF), min(columns, _LARGEST_PSF)
    working = max(preview.psf_bytes(each, size) for each in sources)
    twin = run.twin(loaded, working, _REMEDY)
    experiment = replace(preview, twin=twin)
    planes = [
        experiment.psf(
            source,
            size,
            part_of(progress, number, len(sources)),
        )
        for number, source in enumerate(sources)
    ]
    places = [[each / twin.pixel_um for each in twin.shift_um(source)] for source in sources]
    return KnownCamera.of(
        FieldPsf.of(planes, torch.tensor(places, dtype=torch.float64)), loaded.camera.sensor
    )


def _checked(camera: KnownCamera, name: str) -> KnownCamera:
    """Refuse PSFs that nothing can be learnt with."""
    values = camera.psfs.values
    channels, rows, columns = values.shape[1:]
    if min(rows, columns) < SMALLEST_PSF:
        raise DataError(
            f"the PSFs of {name} have {rows}×{columns} pixels, and training needs at least "
            f"{SMALLEST_PSF}×{SMALLEST_PSF}: give a camera with more"
        )
    if channels not in (1, 3):
        raise DataError(
            f"the PSFs of {name} have {channels} channels: give those of a grey camera, or of one "
            "with R, G and B"
        )
    middle = values[..., rows // 4 : -(rows // 4), columns // 4 : -(columns // 4)]
    if not bool(torch.isfinite(values).all() & (middle.sum(dim=(-2, -1)) > 0).all()):
        raise DataError(
            f"a PSF of {name} is dark around its middle, or holds NaN or infinity: calibrate it "
            "again"
        )
    return camera
