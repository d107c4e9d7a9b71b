"""Frame after frame through one PSF, with settings that may change between two of them."""

from dataclasses import dataclass, replace

from torch import Tensor

from nolens.camera import Frame, Measurement, develop, prepare_psf
from nolens.errors import DataError
from nolens.operators import Region
from nolens.solvers import Problem, Reconstructor, Stream, wiener
from nolens.studio.schemas import Settings

_MOST_ROWS = 400
_LATENCY_S = 0.25


@dataclass(frozen=True)
class Solved:
    """A picture of the live view.

    Parameters
    ----------
    radiance
        (channels, height, width), as bright as the scene, whatever the exposure was.
    channels
        Their names.
    iterations
        That it took.
    """

    radiance: Tensor
    channels: tuple[str, ...]
    iterations: int


@dataclass(frozen=True)
class Psf:
    """What frames are reconstructed with.

    Parameters
    ----------
    cells
        A PSF on the pixels of the reconstruction, (channels, rows, columns); or else
    frame
        the sensor's own frame of a point source.
    region
        Pixels that light comes from; None for no limit.
    """

    cells: Tensor | None = None
    frame: Frame | None = None
    region: Region | None = None


class LiveSolver:
    """Solves what is given it, warm-started where the settings stay.

    Parameters
    ----------
    psf
        What to solve with.
    """

    def __init__(self, psf: Psf) -> None:
        self._psf = psf
        self._problem: Problem | None = None
        self._channels: tuple[str, ...] = ()
        self._stream: Stream | None = None
        self._posed: tuple[object, ...] = ()

    def solve(self, seen: Measurement, settings: Settings, brightness: float) -> Solved:
        """Reconstruct the next frame.

        Parameters
        ----------
        seen
            It, developed to the pixels of the live view.
        settings
            How.
        brightness
            Exposure time times gain, which the picture is divided by.

        Raises
        ------
        NolensError
            If the frame or the PSF cannot be used; the next frame may be better.
        """
        problem = self._posed_for(seen)
        if settings.method == "wiener":
            self._stream, self._posed = None, ()
            found = wiener(replace(problem.measuring(seen.values, seen.valid), tau=settings.tau))
            picture, iterations = found.photograph, found.iterations
        else:
            posed = (settings.tau, settings.iterations)
            if self._stream is None or self._posed != posed:
                self._posed = posed
                self._stream = Stream(
                    replace(problem, tau=settings.tau),
                    iterations=settings.iterations,
                    latency_s=_LATENCY_S,
                )
            solved = self._stream.solve(seen.values, seen.valid)
            picture, iterations = solved.photograph, solved.iterations
        return Solved(picture / brightness, seen.channels, iterations)

    def _posed_for(self, seen: Measurement) -> Problem:
        """The problem of this PSF, laid out anew where the frames have become others."""
        problem = self._problem
        if (
            problem is None
            or problem.data.shape != seen.values.shape
            or self._channels != seen.channels
        ):
            problem = Reconstructor(self._prepared(seen), self._psf.region).problem(seen)
            self._problem, self._channels, self._stream = problem, seen.channels, None
        return problem

    def _prepared(self, seen: Measurement) -> Tensor:
        if self._psf.cells is not None:
            return self._psf.cells
        frame = self._psf.frame
        if frame is None:
            raise DataError("no PSF is chosen")
        rows = seen.values.shape[-2]
        own = frame.counts.shape[-2] // (1 if frame.mosaic is None else 2)
        psf = develop(frame, bin_by=max(1, own // rows))
        return prepare_psf(psf, seen).values


def cells_in_one(rows: int) -> int:
    """Sensor pixels along one of the live view, which has at most 400 rows of them."""
    return max(1, -(-rows // _MOST_ROWS))
