"""Frame after frame through one PSF, with settings that may change between two of them."""

from dataclasses import dataclass, replace

from torch import Tensor

from nolens.camera import Frame, Measurement, develop, prepare_psf
from nolens.operators import PixelRectangle
from nolens.solvers import Method, Problem, Reconstructor, Stream, wiener
from nolens.studio.live_weight import LiveWeight, live_weight
from nolens.studio.schemas import Settings

_MOST_ROWS = 400
_LATENCY_S = 0.25


@dataclass(frozen=True)
class LivePicture:
    """A picture of the live view.

    Parameters
    ----------
    radiance
        (channels, height, width), as bright as the scene, whatever the exposure was.
    channels
        Their names.
    iterations
        That it took.
    tau
        Weight of the prior (`Problem.weight`).
    """

    radiance: Tensor
    channels: tuple[str, ...]
    iterations: int
    tau: float


class LiveSolver:
    """Reconstructs measurements one after the other, warm-started where the settings stay.

    Parameters
    ----------
    psf
        On the pixels of the live view, (channels, rows, columns); or the sensor's own frame of a
        point source.
    support
        Pixels that light comes from; None for no limit.
    """

    def __init__(self, psf: Tensor | Frame, support: PixelRectangle | None = None) -> None:
        self._psf, self._support = psf, support
        self._problem: Problem | None = None
        self._channels: tuple[str, ...] = ()
        self._stream: Stream | None = None
        self._iterations = 0
        self._weights: dict[str, LiveWeight] = {}

    def solve(self, measurement: Measurement, settings: Settings, brightness: float) -> LivePicture:
        """Reconstruct the next frame.

        Parameters
        ----------
        measurement
            The frame, developed to the pixels of the live view.
        settings
            Method, detail and iterations.
        brightness
            Exposure time times gain, which the picture is divided by.

        Raises
        ------
        NolensError
            If the frame or the PSF cannot be used; the next frame may be better.
        """
        problem = self._problem_for(measurement)
        values, valid = measurement.values, measurement.valid
        weight = self._weights.get(settings.method)
        if weight is None:
            reconstructor = Reconstructor(self._prepared_psf(measurement), self._support)
            weight = live_weight(reconstructor, problem, Method(settings.method))
            self._weights[settings.method] = weight
        cuts = 0 if self._stream is None else self._stream.cuts
        tau = weight.follow(measurement, cuts, brightness) / settings.detail
        if settings.method == "wiener":
            self._stream = None
            filtered = replace(problem.measuring(values, valid), tau=tau * problem.tau_unit**2)
            result = wiener(filtered)
            picture, iterations = result.photograph, result.iterations
        else:
            if self._stream is None or self._iterations != settings.iterations:
                self._iterations = settings.iterations
                self._stream = Stream(
                    problem.weighted(tau), iterations=settings.iterations, latency_s=_LATENCY_S
                )
            self._stream.weigh(tau)
            solved = self._stream.solve(values, valid)
            picture, iterations = solved.photograph, solved.iterations
        return LivePicture(picture / brightness, measurement.channels, iterations, tau)

    def await_weights(self) -> None:
        """Wait for the choices of weights that are being made."""
        for weight in self._weights.values():
            weight.wait()

    def _problem_for(self, measurement: Measurement) -> Problem:
        """The problem of this PSF, built again where size or channels of the frames change."""
        problem = self._problem
        if (
            problem is None
            or problem.data.shape != measurement.values.shape
            or self._channels != measurement.channels
        ):
            psf = self._prepared_psf(measurement)
            problem = Reconstructor(psf, self._support, tau=0.0).problem(measurement)
            self._problem, self._channels, self._stream = problem, measurement.channels, None
            self._weights = {}
        return problem

    def _prepared_psf(self, measurement: Measurement) -> Tensor:
        if isinstance(self._psf, Tensor):
            return self._psf
        rows = self._psf.counts.shape[-2] // (1 if self._psf.mosaic is None else 2)
        psf = develop(self._psf, bin_by=max(1, rows // measurement.values.shape[-2]))
        return prepare_psf(psf, measurement).values


def live_bin(rows: int) -> int:
    """Sensor pixels along one of the live view, which has at most 400 rows of them."""
    return max(1, -(-rows // _MOST_ROWS))
