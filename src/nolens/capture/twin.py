"""A simulated camera as a source of frames, and the chart that it looks at by default."""

import math
import secrets
import time
from datetime import UTC, datetime
from threading import Event, Lock
from typing import Self

import torch
from torch import Tensor

from nolens.camera import Frame, LoadedCamera, Sensor, preset
from nolens.capture.source import CameraSource, Limits, Shot
from nolens.errors import CameraError, DataError
from nolens.evaluate import siemens_star
from nolens.files import read_camera
from nolens.operators import PixelRectangle
from nolens.twin import (
    FieldMap,
    FieldModel,
    Light,
    Twin,
    expose,
    half_field,
    photocurrents,
    pixel_currents,
)

_ANGLE_DEG = 40.0
_LUMINANCE_CD_M2 = 1000.0
"""Of white: a bright screen, or a shop; frames then take no longer than they are far apart."""
_LIGHT = "white-led"
_PRESET = "live"
_FASTEST_S = 1 / 30
_FILL = 0.8
_POINT_RADIANCE = 1e3
"""Of a lamp behind a pinhole, over the pixel that it lies in."""
_LIMITS = Limits((1e-5, 10.0), (1.0, 16.0))
_COLOURS = (
    (0.9, 0.05, 0.04),
    (0.08, 0.7, 0.1),
    (0.05, 0.1, 0.85),
    (0.9, 0.75, 0.05),
    (0.75, 0.08, 0.6),
    (0.06, 0.65, 0.75),
)
_GREYS = (1.0, 0.6, 0.35, 0.2, 0.1, 0.04)


class TwinSource(CameraSource):
    """A camera of plain convolution, with shot and read noise, that takes its time as one would.

    Until it is shown something it looks at a chart.

    Parameters
    ----------
    camera
        The camera.
    seed
        Of the noise: each frame has its own, counted from this one. None takes another one each
        time, as no camera gives the same noise twice.
    """

    def __init__(self, camera: LoadedCamera, *, seed: int | None = None) -> None:
        self._camera = camera
        self._sensor = camera.camera.sensor
        self._seed = secrets.randbits(32) if seed is None else seed
        self._number = 0
        self._scene = chart()
        self._prepared: tuple[FieldModel, Tensor] | None = None
        self._rate: tuple[Tensor, Tensor] | None = None
        self._target: tuple[float, float] | None = None
        self._is_open = False
        self._last = -math.inf
        self._closed = Event()
        self._lock = Lock()

    @classmethod
    def of(cls, text: str, **_: object) -> Self:
        """The source of ``twin`` or ``twin:CAMERA``, for `open_source`."""
        return cls(read_camera(text) if text else LoadedCamera.of(preset(_PRESET)))

    @property
    def name(self) -> str:
        """Such as ``twin of live``."""
        return f"twin of {self._camera.camera.name}"

    @property
    def limits(self) -> Limits:
        """What it can be set to."""
        return _LIMITS

    @property
    def support(self) -> PixelRectangle:
        """Pixels that light comes from, in the sensor's frame."""
        return self._model.field.support

    def tangents(self) -> tuple[Tensor, Tensor]:
        """Of the field angles of every pixel of `support`, along rows and columns."""
        return self._model.field.tangents()

    def psf(self) -> Tensor:
        """PSF to reconstruct its frames with, (channels, rows, columns) in pixels.

        It is in electrons, so that a reconstruction shows the colours of the scene.
        """
        currents = photocurrents(self._model.twin, Light(_LIGHT), 1.0)[:, None, None]
        return self._model.psf() * (currents / currents.max())

    def show(self, radiance: Tensor) -> None:
        """Let it look at another scene, from the next frame on; from any thread.

        Parameters
        ----------
        radiance
            Linear, (3, height, width); 1 is white. It is seen in whole, as large as it fits.

        Raises
        ------
        DataError
            If it is no such picture.
        """
        if radiance.ndim != 3 or radiance.shape[0] != 3 or 0 in radiance.shape:
            raise DataError(
                f"the scene is of shape {tuple(radiance.shape)}: (3, height, width) is needed"
            )
        if not bool(torch.isfinite(radiance).all()) or float(radiance.min()) < 0:
            raise DataError("the scene holds NaN, infinity or negative light")
        self._scene = radiance.float()

    def show_point(self) -> None:
        """Let it look at a point source, straight ahead in the dark."""
        support = self.support
        scene = torch.zeros(3, support.height, support.width)
        scene[:, support.height // 2, support.width // 2] = _POINT_RADIANCE
        self._scene = scene

    def show_dark(self) -> None:
        """Let it look at nothing, as if it were covered."""
        self._scene = torch.zeros(3, 1, 1)

    def truth(self) -> Tensor:
        """What a reconstruction of the present scene is to show on the pixels of `support`.

        Returns
        -------
        Tensor
            Radiance times the fraction of its light that reaches the sensor, 1 in the middle;
            (channels, height, width).
        """
        field = self._model.field
        response = field.solid_angle() * field.vignetting()
        return self._on_pixels(self._scene) * (response / response.max()).float()

    def open(self) -> None:
        """Compute the camera's PSF, which takes some seconds the first time."""
        self._prepare()
        self._closed.clear()
        self._is_open = True
        if self._target is None:
            brightest = float(self._electrons_per_s(self._scene).max())
            fitting_s = _FILL * self._sensor.clip_electrons / max(brightest, 1e-9)
            self._target = min(max(fitting_s, _LIMITS.exposure_s[0]), 1.0), 1.0

    def set(self, *, exposure_s: float, gain: float) -> None:
        """Set exposure time and gain of all shots from the next one on."""
        _LIMITS.check(exposure_s, gain)
        self._target = exposure_s, gain

    def shot(self) -> Shot:
        """Take a frame, not sooner after the one before than a camera could."""
        if not self._is_open or self._target is None:
            raise CameraError(f"the {self.name} is not open, or was closed: open it first")
        exposure_s, gain = self._target
        own = self._sensor
        sensor = own.model_copy(update={"gain": own.gain * gain})
        electrons = self._electrons_per_s(self._scene) * exposure_s
        self._number += 1
        seed = self._seed + self._number
        counts = expose(electrons, sensor, seed=seed)
        due = self._last + max(exposure_s, _FASTEST_S)
        if self._closed.wait(max(0.0, due - time.monotonic())):
            raise CameraError(f"the {self.name} was closed: open it first")
        self._last = time.monotonic()
        return Shot(
            _frame(counts, sensor, exposure_s, self.name),
            datetime.now(UTC),
            exposure_s,
            gain,
            self.name,
            {
                "frame": self._number,
                "seed": seed,
                "luminance_cd_m2": _LUMINANCE_CD_M2,
                "light": _LIGHT,
            },
        )

    def close(self) -> None:
        """Stop."""
        self._is_open = False
        self._closed.set()

    @property
    def _model(self) -> FieldModel:
        return self._prepare()[0]

    def _prepare(self) -> tuple[FieldModel, Tensor]:
        """The camera's model, and electrons of every pixel in a second, to its light."""
        with self._lock:
            if self._prepared is None:
                twin = Twin.of(self._camera)
                camera = twin.camera
                model = FieldModel.of(
                    twin,
                    FieldMap.covering(twin, half_field(twin, _ANGLE_DEG)),
                    distance_um=camera.reference_distance.um,
                    light=Light(_LIGHT),
                )
                current = pixel_currents(twin, Light(_LIGHT), _LUMINANCE_CD_M2)
                self._prepared = model, current.contiguous()
            return self._prepared

    def _electrons_per_s(self, scene: Tensor) -> Tensor:
        """Of every pixel; computed once for a scene that stays."""
        if self._rate is None or self._rate[0] is not scene:
            model, current = self._prepare()
            self._rate = scene, model.light(self._on_pixels(scene)).mul_(current)
        return self._rate[1]

    def _on_pixels(self, scene: Tensor) -> Tensor:
        if len(self._sensor.channels) == 1:
            scene = scene.mean(dim=0, keepdim=True)
        return self._model.rendered(scene)


def _frame(counts: Tensor, sensor: Sensor, exposure_s: float, source: str) -> Frame:
    colours = None if sensor.mosaic == "none" else sensor.mosaic
    return Frame(
        counts=counts.float()[None],
        channels=("grey",) if colours is None else ("mosaic",),
        mosaic=colours,
        black=(sensor.black_counts,),
        white=float(sensor.saturated_counts),
        stored_as="uint16",
        source=source,
        exposure_s=exposure_s,
        black_stated=True,
    )


def chart(height: int = 360, width: int = 480) -> Tensor:
    """Draw a star of spokes, patches of colour and steps of grey on a dark ground.

    Parameters
    ----------
    height, width
        In pixels, at least 48.

    Returns
    -------
    Tensor
        Linear radiance, float32, (3, height, width); 1 is white.
    """
    picture = torch.full((3, height, width), 0.02)
    edge = min(height, width) // 24
    side = min(height - 4 * edge, (2 * width) // 3 - 2 * edge) // 2 * 2
    top = (height - side) // 2
    picture[:, top : top + side, edge : edge + side] += 0.9 * siemens_star(side, 16)
    left, right = side + 2 * edge, width - edge
    rows = torch.linspace(top, top + side, len(_COLOURS) + 1).round().int().tolist()
    middle = (left + right) // 2
    for number, (colour, grey) in enumerate(zip(_COLOURS, _GREYS, strict=True)):
        first, last = rows[number], rows[number + 1]
        picture[:, first:last, left:middle] = torch.tensor(colour)[:, None, None]
        picture[:, first:last, middle:right] = grey
    return picture
