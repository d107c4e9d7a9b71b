"""Frame after frame through one PSF, with settings that may change between two of them."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from threading import Thread

import torch
from torch import Tensor

from nolens.camera import Frame, Measurement, PsfGeometry
from nolens.errors import NolensError
from nolens.files.weights import denoiser
from nolens.operators import PixelRectangle
from nolens.solvers import (
    Development,
    FieldPoint,
    Method,
    Problem,
    Reconstructor,
    circulant_wiener,
)
from nolens.solvers.inputs import tensor_of
from nolens.solvers.plug_and_play import PlugAndPlay
from nolens.solvers.result import window_of
from nolens.studio.live_stream import LiveStream
from nolens.studio.live_weight import LiveWeight, circulant_unit
from nolens.studio.schemas import Settings

_MOST_ROWS = 400
_BASIS_ERROR = 0.08
"""Of PSFs over the field: a frame then takes 1.6 times less than with that of a photo, for 0.1 to
0.3 dB (decision 18)."""
Acceptance = Callable[[int, tuple[int, int], Tensor], PixelRectangle | None]
"""Of a camera, by the sensor's pixels along one of the live view, (height, width) of a frame, and
the PSF: pixels whose light it accepts; None where that is not known."""


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
    prior
        What a record says of the prior; empty for the Wiener filter, which has none.
    """

    radiance: Tensor
    channels: tuple[str, ...]
    iterations: int
    tau: float
    field_points: int
    prior: dict[str, str]


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
    acceptance
        Of the camera: the support where none is given, from when a frame has shown no light beyond.
        Pictures are as large as frames then, too, and dark around it.
    device
        That it computes on.
    """

    def __init__(
        self,
        psf: Tensor | Frame,
        support: PixelRectangle | None = None,
        field_points: tuple[FieldPoint, ...] = (),
        acceptance: Acceptance | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        self._psf, self._support, self._field_points = psf, support, field_points
        self._acceptance, self._device = acceptance, device
        self._accepting: Thread | None = None
        self._accepted: tuple[Reconstructor, PixelRectangle] | None = None
        self._camera: tuple[Reconstructor, Reconstructor] | None = None
        self._problem: Problem | None = None
        self._frames: tuple[object, ...] = ()
        self._stream: LiveStream | None = None
        self._network: PlugAndPlay | None = None
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
            Method, detail, iterations, and whether the trained prior is used where it keeps the
            rate, and all PSFs over the field.
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
            weight = LiveWeight(single, problem.by_channel, Method(settings.method))
            self._weights[settings.method] = weight
        cuts = 0 if self._stream is None else self._stream.cuts
        tau = weight.follow(measurement, cuts, brightness) / settings.detail
        if settings.method == "wiener":
            self._stream = None
            filtered = replace(problem.measuring(values, valid), tau=tau * circulant_unit(problem))
            result = circulant_wiener(filtered)
            scene, iterations, prior = result.scene, result.iterations, {}
        else:
            stream = self._stream
            if stream is None or stream.iterations != settings.iterations:
                stream = LiveStream(problem.weighted(tau), settings.iterations)
                self._stream = stream
            stream.weigh(tau)
            solved = stream.solve(values, valid, self._prior(settings))
            scene, iterations, prior = solved.scene, solved.iterations, stream.facts
        window = problem.sensor_frame if self._support is None else problem.frame
        radiance = window_of(scene, window).cpu() / brightness
        points = problem.forward.field_points
        return LivePicture(radiance, measurement.channels, iterations, tau, points, prior)

    def await_choices(self) -> None:
        """Wait for the choices of weights, support and prior that are being made."""
        if self._accepting is not None:
            self._accepting.join()
        for weight in self._weights.values():
            weight.wait()
        if self._stream is not None:
            self._stream.wait()

    def _prior(self, settings: Settings) -> PlugAndPlay | None:
        """The trained prior with the detail of the settings; the same while they stay."""
        if not settings.trained:
            return None
        if self._network is None or self._network.detail != settings.detail:
            self._network = replace(denoiser(), detail=settings.detail)
        return self._network

    def _problem_for(
        self, measurement: Measurement, *, over_field: bool
    ) -> tuple[Reconstructor, Problem]:
        """What has one PSF, and the problem, built again where frames or model change."""
        frames = measurement.values.shape, measurement.channels
        if self._camera is None or self._frames[:2] != frames:
            whole = self._reconstructor(measurement)
            self._camera = whole, whole.averaged(measurement.size)
            self._weights, self._problem = {}, None
            if self._acceptance is not None and self._support is None:
                self._accepting = Thread(
                    target=self._accept, args=(whole, measurement), daemon=True
                )
                self._accepting.start()
        whole, single = self._camera
        if self._accepted is not None and self._accepted[0] is whole:
            whole = replace(whole, support=self._accepted[1])
            single = whole.averaged(measurement.size)
            self._camera, self._problem = (whole, single), None
            for weight in self._weights.values():
                weight.reconstructor = single
        if self._problem is None or self._frames != (*frames, over_field):
            self._problem = (whole if over_field else single).problem(measurement)
            self._frames, self._stream = (*frames, over_field), None
        return single, self._problem

    def _accept(self, whole: Reconstructor, measurement: Measurement) -> None:
        """Take the camera's acceptance, unless a measurement asks for light beyond."""
        assert self._acceptance is not None
        single = whole.averaged(measurement.size)
        psf = tensor_of(single.psf, "PSF")
        try:
            acceptance = self._acceptance(self._by(measurement), measurement.size, psf)
            if acceptance is None:
                return
            support = single.accept(measurement, acceptance).support
        except (NolensError, ArithmeticError):
            return  # Without it the view goes on.
        if support is not None:
            self._accepted = whole, support

    def _by(self, measurement: Measurement) -> int:
        """Pixels of the PSF along one of a measurement."""
        if isinstance(self._psf, Tensor):
            return 1
        height, _ = self._psf.sensor or self._psf.counts.shape[-2:]
        return max(1, height // (1 if self._psf.mosaic is None else 2) // measurement.size[0])

    def _reconstructor(self, measurement: Measurement) -> Reconstructor:
        """With the PSF, or PSFs, on the pixels of a measurement."""
        if isinstance(self._psf, Tensor):
            return Reconstructor(self._psf, self._support, tau=0.0, device=self._device)
        psf = self._psf
        height, width = psf.sensor or psf.counts.shape[-2:]
        beyond = psf.counts.shape[-2] > height and psf.counts.shape[-1] > width
        development = Development(
            psf,
            bin_by=self._by(measurement),
            psf_geometry=PsfGeometry(extended=beyond),
            field_points=self._field_points,
        )
        return Reconstructor(
            development.prepared(measurement).values,
            self._support,
            tau=0.0,
            device=self._device,
            field_psf=development.field_psf(measurement),
            basis_error=_BASIS_ERROR,
        )


def live_bin(rows: int) -> int:
    """Sensor pixels along one of the live view, which has at most 400 rows of them."""
    return max(1, -(-rows // _MOST_ROWS))
