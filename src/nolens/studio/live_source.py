"""What the live view looks through: a camera, and the PSF that its frames are solved with."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from nolens.camera import LoadedCamera
from nolens.camera.measurement import bin_mean
from nolens.capture import TwinSource, open_source
from nolens.errors import NolensError
from nolens.files import read_camera, read_frame
from nolens.operators import Region
from nolens.studio.camera_thread import CameraThread
from nolens.studio.live_solver import LiveSolver, Psf, cells_in_one
from nolens.studio.schemas import Settings

_OPEN_S = 60.0
_TWIN = "live"


@dataclass
class LiveSource:
    """A camera that is open.

    Parameters
    ----------
    text
        As `nolens.capture.open_source` takes it.
    camera
        What takes its frames.
    solver
        What reconstructs them; None without a PSF.
    psf
        File of the PSF; None where there is none, or the twin's own has not been written yet.
    twin, opened
        The simulated camera, if it is one, and its description.
    """

    text: str
    camera: CameraThread
    solver: LiveSolver | None
    psf: Path | None
    twin: TwinSource | None = None
    opened: LoadedCamera | None = None

    @property
    def camera_id(self) -> str | None:
        """Preset or folder of a simulated camera."""
        return None if self.twin is None else self.text.removeprefix("twin:")


def open_live(
    text: str,
    psf: str | None,
    settings: Settings,
    changed: threading.Condition,
    tell: Callable[[str], None],
) -> LiveSource:
    """Open a source of frames.

    Parameters
    ----------
    text
        As `nolens.capture.open_source` takes it.
    psf
        File of a PSF; None for none, or the simulated camera's own.
    settings
        How to expose at first.
    changed
        Notified with every frame.
    tell
        Called with a sentence about a file that cannot be read.

    Raises
    ------
    NolensError
        If the source or the PSF cannot be used.
    """
    frame = None if psf is None else read_frame(psf)
    file = None if psf is None else Path(psf)
    source = open_source(text, warn=tell)
    camera = CameraThread(source, settings, changed)
    try:
        camera.open(_OPEN_S)
    except NolensError:
        camera.close()
        raise
    if not isinstance(source, TwinSource):
        solver = None if frame is None else LiveSolver(Psf(frame=frame))
        return LiveSource("raspberry" if text == "auto" else text, camera, solver, file)
    given = text.partition(":")[2] or _TWIN
    solver = LiveSolver(_own_psf(source) if frame is None else Psf(frame=frame))
    return LiveSource(f"twin:{given}", camera, solver, file, source, read_camera(given))


def _own_psf(source: TwinSource) -> Psf:
    """PSF and region of a simulated camera, in the cells of the live view."""
    psf, region = source.psf(), source.region
    by = cells_in_one(psf.shape[-2])
    if by == 1:
        return Psf(cells=psf, region=region)
    size = -(-region.height // by), -(-region.width // by)
    coarse = Region(region.top // by, region.left // by, *size)
    return Psf(cells=bin_mean(psf, by), region=coarse)
