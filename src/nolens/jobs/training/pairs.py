"""Pairs that `nolens collect` took, as shots to train on."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

from nolens.camera import Frame
from nolens.camera.psf_set import depth_um
from nolens.errors import DataError, NolensError, OptionError
from nolens.files import PSFS_FILE, read_frame, read_picture
from nolens.files.input import named_pairs
from nolens.files.psf_folder import PsfFolder
from nolens.jobs.run import Run
from nolens.jobs.training.options import TrainOptions
from nolens.solvers import Development, choose_psf
from nolens.training.measurements import Shot
from nolens.training.pairs import binned_picture, pair_shot

_MEASURED, _PICTURES, _DARK = "measured", "pictures", "dark.tif"
_LARGEST = 420
"""Side of a measurement in pixels, to which larger ones are binned."""
_HELD_OUT = 5
"""Of so many pairs one is held out, and one of fewer."""


@dataclass(frozen=True)
class Pairs:
    """Pairs to learn from, and those that are held out."""

    learnt: tuple[Shot, ...] = ()
    held_out: tuple[Shot, ...] = ()


def training_pairs(run: Run[TrainOptions], side: int) -> Pairs:
    """Pairs of the options; none where none are given.

    Parameters
    ----------
    run
        Of the job.
    side
        Pixels of a patch, which no picture may be smaller than.

    Raises
    ------
    NolensError
        If the camera has no measured PSF, or a pair cannot be used.
    """
    folder, options = run.options.pairs, run.options
    if folder is None:
        return Pairs()
    psfs = PsfFolder(Path(options.camera or "").expanduser())
    if not (psfs.path / PSFS_FILE).is_file():
        raise OptionError(
            f"--pairs needs the PSF that the camera was measured with: give its folder, with "
            f"{PSFS_FILE} (nolens train CAMERA --pairs {folder} -o mine.npz)"
        )
    distance = None if options.distance is None else depth_um(options.distance)
    scene = psfs.for_scene(distance)
    dark = folder / _DARK
    files = named_pairs(folder / _MEASURED, folder / _PICTURES)
    if len(files) < 2:
        raise DataError(f"{folder} has one pair, and one has to be held out: give two or more")
    run.reads({"dark frame": dark} if dark.is_file() else {})
    development = Development(
        scene.alone or scene.ahead, dark=read_frame(dark) if dark.is_file() else None
    )
    shots = []
    for number, (name, (measured, picture)) in enumerate(files.items()):
        run.reads({f"measurement {name}": measured, f"picture {name}": picture})
        frame = read_frame(measured)
        if number == 0:
            development = choose_psf(development, frame).development
        try:
            shots.append(_shot(development, frame, picture, side))
        except NolensError as error:
            raise type(error)(f"the pair {name}: {error}") from None
        run.reporter.advance("pairs", (number + 1) / len(files))
    count = math.ceil(len(shots) / _HELD_OUT)
    return Pairs(tuple(shots[:-count]), tuple(shots[-count:]))


def _shot(development: Development, frame: Frame, path: Path, side: int) -> Shot:
    picture = read_picture(path).radiance
    size = development.measurement(frame).size
    by = math.ceil(max(size) / _LARGEST)
    by = max(1, min(by, min(picture.shape[-2:]) // (side + 1)))
    coarse = replace(development, bin_by=development.bin_by * by)
    measurement = coarse.measurement(frame)
    if len(measurement.channels) == 1:
        picture = picture.mean(dim=0, keepdim=True)
    elif measurement.channels != ("R", "G", "B"):
        raise DataError(
            f"the measurement has the channels {', '.join(measurement.channels)}; grey or R, G "
            "and B are accepted"
        )
    truth, support = binned_picture(picture, by, size)
    if min(truth.shape[-2:]) < side:
        raise DataError(
            f"{path} has {picture.shape[-2]}×{picture.shape[-1]} pixels, and patches have "
            f"{side}×{side}"
        )
    psf = coarse.prepared(measurement).values
    psf = psf.expand(len(measurement.channels), -1, -1)
    return pair_shot(measurement.values, measurement.valid, psf.contiguous(), truth, support)
