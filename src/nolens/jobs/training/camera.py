"""The camera that measurements to train on are simulated with."""

import math
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch

from nolens.camera import FieldPsf, LoadedCamera
from nolens.camera.psf_set import depth_um
from nolens.errors import DataError, FileError
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.files import CAMERA_FILE, PSFS_FILE
from nolens.files.psf_folder import PsfFolder
from nolens.jobs.designing.mask import with_mask
from nolens.jobs.run import Run
from nolens.jobs.training.options import TrainOptions
from nolens.optics import PointSource
from nolens.progress import ProgressCallback, part_of
from nolens.quantities import Angle, Length
from nolens.training.cameras import SMALLEST_PSF, KnownCamera, RandomCameras
from nolens.twin import LARGEST_ANGLE_DEG, Light, distance_um, preview_model

_LARGEST_PSF = 768
"""Pixels along a side of a computed PSF, which the largest scene and sensor to train on need."""
_LIGHT = "white-led"
_WAVELENGTHS = 3
"""Of a channel, of a camera that is named; random ones have one."""
_DIAMETER_UM = 50.0
_PLACES = tuple(product((-1, 0, 1), repeat=2))
"""Of the field points, over half of the scene's angle."""
SIMULATED = 12
"""Cameras by the twin, where none is named."""
SIMULATED_BYTES = SIMULATED * len(_PLACES) * 3 * _LARGEST_PSF**2 * 2
"""That their PSFs take, in float16."""
_ANGLE = Angle("60", "deg")
"""That scenes before them fill at most."""
_PIXELS = -0.2, 0.5
"""Logarithm of a factor on the paper's pixels."""
_STEEPEST = 4.1
"""Largest angle in degrees that a surface scatters into, on the paper's pixels; on larger ones no
grid would carry it."""
_REMEDY = "a camera with fewer or larger pixels, or a coarser grid of its relief, needs less"


def named_camera(run: Run[TrainOptions]) -> KnownCamera | None:
    """The camera of the options, if they name one.

    Raises
    ------
    NolensError
        If it has no PSF, or one that is too small, or has other channels than grey or three.
    """
    name = run.options.camera
    if name is None:
        return None
    folder = Path(name).expanduser()
    if (folder / PSFS_FILE).is_file():
        return _checked(_of_folder(run, folder), name)
    if folder.is_dir() and not (folder / CAMERA_FILE).is_file():
        raise FileError(
            f"the folder {folder} has no PSF to train with: neither {PSFS_FILE}, which nolens "
            f"calibrate writes, nor {CAMERA_FILE}, by which PSFs are computed"
        )
    progress = partial(run.reporter.advance, "PSFs")
    camera = _by_twin(run, run.camera(name), run.options.angle, _WAVELENGTHS, progress)
    return _checked(camera, name)


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


def random_cameras(run: Run[TrainOptions]) -> RandomCameras:
    """Random ones, and some of lenslets and Gaussian surfaces on the paper's layers, by the twin:
    their PSFs are as diffraction makes them, and change over the field.
    """
    random = np.random.default_rng(run.options.seed)
    paper = run.camera("paper")
    sensor = paper.camera.sensor
    known = []
    for number in range(SIMULATED):
        factor = math.exp(random.uniform(*_PIXELS))
        pixels = {
            "pitch": Length(f"{factor * sensor.pitch.um:.4g}", "um"),
            "rows": 2 * _LARGEST_PSF,
            "columns": 2 * _LARGEST_PSF,
        }
        part = {"sensor": sensor.model_copy(update=pixels)}
        coarse = replace(paper, camera=paper.camera.model_copy(update=part))
        kind, options = _random_mask(random, number, factor)
        loaded = with_mask(kind, coarse, run.reporter, **options)
        progress = partial(run.reporter.advance, "simulated cameras")
        camera = _by_twin(run, loaded, _ANGLE, 1, part_of(progress, number, SIMULATED))
        values = camera.psfs.values
        half = (values / values.max()).half()
        known.append(replace(camera, psfs=replace(camera.psfs, values=half)))
    return RandomCameras(tuple(known))


def _random_mask(
    random: np.random.Generator, number: int, factor: float
) -> tuple[str, dict[str, Any]]:
    """One of three kinds, and its options, for a sensor whose pixels are larger by a factor: the
    paper's lenslets and other ones, which focus on the sensor, and Gaussian surfaces.
    """

    def drawn(low: float, high: float) -> float:
        return math.exp(random.uniform(math.log(low), math.log(high)))

    seed = {"seed": int(random.integers(2**31)), "device": "cpu"}
    if number % 3 == 0:
        pitch = drawn(45, 180)
        radius = f"{9.5 * pitch * drawn(0.8, 1.6):.0f}um"
        return "random-lenslets", {"pitch": f"{pitch:.1f}um", "radius": radius, **seed}
    if number % 3 == 1:
        return "random-lenslets", {"pitch": f"{drawn(60, 150):.1f}um", **seed}
    angle = f"{min(drawn(0.4, 4), _STEEPEST / factor):.2f}deg"
    return "diffuser", {"angle": angle, "feature": f"{drawn(15, 60):.1f}um", **seed}


def _by_twin(
    run: Run[TrainOptions],
    loaded: LoadedCamera,
    angle: Angle,
    wavelengths: int,
    progress: ProgressCallback,
) -> KnownCamera:
    """A camera by PSFs that the twin computes at a few field points."""
    options = run.options
    preview = VirtualExperiment(preview_model(loaded), Light(_LIGHT), wavelengths)
    away = distance_um(options.distance, loaded)
    tangent = math.tan(angle.rad / 2)
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
