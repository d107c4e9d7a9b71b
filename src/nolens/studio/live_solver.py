"""Frame after frame through one PSF, with settings that may change between two of them."""

from dataclasses import dataclass, replace

from torch import Tensor

from nolens.camera import Frame, Measurement, PsfGeometry
from nolens.operators import PixelRectangle
from nolens.solvers import (
    Development,
    FieldPoint,
    Method,
    Problem,
    Reconstructor,
    Stream,
    wiener,
)
from nolens.studio.live_weight import LiveWeight, live_weight
from nolens.studio.schemas import Settings

_MOST_ROWS = 400
_LATENCY_S = 0.25
_BASIS_ERROR = 0.08
"""Of PSFs over the field: a frame then takes 1.6 times less than with that of a photo, for 0.1 to
0.3 dB (decision 18)."""


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
    field_points
        How many PSFs over the field were used, 1 for their mean.
    """

    radiance: Tensor
    channels: tuple[str, ...]
    iterations: int
    tau: float
    field_points: int


class LiveSolver:
    """Reconstructs measurements one after the other, warm-started where the settings stay.

    Of PSFs over the field it takes the mean, which costs what one PSF does; or all of them, if the
    settings say so.

    Parameters
    ----------
    psf
        On the pixels of the live view, (channels, rows, columns); or the sensor's own frame of a
        point source.
    support
        Pixels that light comes from; None for no limit.
    field_points
        PSFs over the field, `psf` among them; none where there is only that one.
    """

    def __init__(
        self,
        psf: Tensor | Frame,
        support: PixelRectangle | None = None,
        field_points: tuple[FieldPoint, ...] = (),
    ) -> None:
        self._psf, self._support, self._field_points = psf, support, field_points
        self._camera: tuple[Reconstructor, Reconstructor] | None = None
        self._problem: Problem | None = None
        self._frames: tuple[object, ...] = ()
        self._stream: Stream | None = None
        self._iterations = 0
        self._weights: dict[str, LiveWeight] = {}

    @property
    def field_points(self) -> int:
        """How many PSFs it has."""
        return max(1, len(self._field_points))

    def solve(self, measurement: Measurement, settings: Settings, brightness: float) -> LivePicture:
        """Reconstruct the next frame.

        Parameters
        ----------
        measurement
            The frame, developed to the pixels of the live view.
        settings
            Method, detail, iterations, and whether all PSFs over the field are used.
        brightness
            Exposure time times gain, which the picture is divided by.

        Raises
        ------
        NolensError
            If the frame or the PSF cannot be used; the next frame may be better.
        """
        over_field = settings.over_field and settings.method == "admm"
        single, problem = self._problem_for(measurement, over_field=over_field)
        values, valid = measurement.values, measurement.valid
        weight = self._weights.get(settings.method)
        if weight is None:
            weight = live_weight(single, problem.by_channel, Method(settings.method))
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
        points = problem.forward.field_points
        return LivePicture(picture / brightness, measurement.channels, iterations, tau, points)

    def await_weights(self) -> None:
        """Wait for the choices of weights that are being made."""
        for weight in self._weights.values():
            weight.wait()

    def _problem_for(
        self, measurement: Measurement, *, over_field: bool
    ) -> tuple[Reconstructor, Problem]:
        """What has one PSF, and the problem, built again where frames or model change."""
        frames = measurement.values.shape, measurement.channels
        if self._camera is None or self._frames[:2] != frames:
            whole = self._reconstructor(measurement)
            self._camera = whole, whole.averaged(measurement.size)
            self._weights, self._problem = {}, None
        whole, single = self._camera
        if self._problem is None or self._frames != (*frames, over_field):
            self._problem = (whole if over_field else single).problem(measurement)
            self._frames, self._stream = (*frames, over_field), None
        return single, self._problem

    def _reconstructor(self, measurement: Measurement) -> Reconstructor:
        """With the PSF, or PSFs, on the pixels of a measurement."""
        if isinstance(self._psf, Tensor):
            return Reconstructor(self._psf, self._support, tau=0.0)
        psf, rows = self._psf, measurement.size[0]
        height, width = psf.sensor or psf.counts.shape[-2:]
        by = max(1, height // (1 if psf.mosaic is None else 2) // rows)
        beyond = psf.counts.shape[-2] > height and psf.counts.shape[-1] > width
        development = Development(
            psf,
            bin_by=by,
            psf_geometry=PsfGeometry(extended=beyond),
            field_points=self._field_points,
        )
        return Reconstructor(
            development.prepared(measurement).values,
            self._support,
            tau=0.0,
            field_psf=development.field_psf(measurement),
            basis_error=_BASIS_ERROR,
        )


def live_bin(rows: int) -> int:
    """Sensor pixels along one of the live view, which has at most 400 rows of them."""
    return max(1, -(-rows // _MOST_ROWS))
