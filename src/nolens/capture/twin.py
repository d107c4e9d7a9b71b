"""A simulated camera as a source of frames."""

import math
import secrets
import time
from dataclasses import dataclass
from datetime import UTC, datetime
from threading import Event, Lock

import torch
from torch import Tensor

from nolens.camera import Frame, OpenCamera, Sensor
from nolens.capture.chart import chart
from nolens.capture.source import Limits, Shot
from nolens.errors import CameraError, DataError
from nolens.operators import Region
from nolens.optics import PointSource
from nolens.twin import (
    FieldMap,
    Light,
    PlainModel,
    Twin,
    aperture_room_um,
    expose,
    mosaic,
    photocurrents,
)

_ANGLE_DEG = 40.0
_LUMINANCE_CD_M2 = 1000.0
"""Of white: a bright screen, or a shop; frames then take no longer than they are far apart."""
_LIGHT = "white-led"
_FASTEST_S = 1 / 30
_FILL = 0.8
_POINT_RADIANCE = 1e3
"""Of a lamp behind a pinhole, over the pixel that it lies in."""
_LIMITS = Limits((1e-5, 10.0), (1.0, 16.0))


@dataclass(frozen=True)
class _Ready:
    """A camera that is worked out."""

    model: PlainModel
    current: Tensor
    """Electrons of every pixel in a second, to its light."""


class TwinSource:
    """A camera of plain convolution, with shot and read noise, that takes its time as one would.

    Until it is shown something it looks at a chart.

    Parameters
    ----------
    opened
        The camera.
    seed
        Of the noise: each frame has its own, counted from this one. None takes another one each
        time, as no camera gives the same noise twice.
    """

    def __init__(self, opened: OpenCamera, *, seed: int | None = None) -> None:
        self._opened = opened
        self._sensor = opened.camera.sensor
        self._seed = secrets.randbits(32) if seed is None else seed
        self._number = 0
        self._scene = chart()
        self._ready: _Ready | None = None
        self._rate: tuple[Tensor, Tensor] | None = None
        self._asked: tuple[float, float] | None = None
        self._is_open = False
        self._last = -math.inf
        self._closed = Event()
        self._lock = Lock()

    @property
    def name(self) -> str:
        """Such as ``twin of live``."""
        return f"twin of {self._opened.camera.name}"

    @property
    def limits(self) -> Limits:
        """What it can be set to."""
        return _LIMITS

    @property
    def region(self) -> Region:
        """Pixels that light comes from, in the sensor's frame."""
        return self._work_out().model.field.region

    def psf(self) -> Tensor:
        """PSF to reconstruct its frames with, (channels, rows, columns) in pixels.

        It is in electrons, so that a reconstruction shows the colours of the scene.
        """
        ready = self._work_out()
        currents = photocurrents(ready.model.twin, Light(_LIGHT), 1.0)[:, None, None]
        return ready.model.psf() * (currents / currents.max())

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
        region = self.region
        scene = torch.zeros(3, region.height, region.width)
        scene[:, region.height // 2, region.width // 2] = _POINT_RADIANCE
        self._scene = scene

    def show_dark(self) -> None:
        """Let it look at nothing, as if it were covered."""
        self._scene = torch.zeros(3, 1, 1)

    def truth(self) -> Tensor:
        """What a reconstruction of the present scene is to show on the pixels of `region`.

        Returns
        -------
        Tensor
            Radiance times the fraction of its light that reaches the sensor, 1 in the middle;
            (channels, height, width).
        """
        model = self._work_out().model
        response = model.field.solid_angle() * model.field.vignetting()
        return self._on_cells(model, self._scene) * (response / response.max()).float()

    def open(self) -> None:
        """Work the camera out, which takes some seconds the first time.

        Raises
        ------
        NolensError
            If the camera cannot be simulated.
        """
        self._work_out()
        self._closed.clear()
        self._is_open = True
        if self._asked is None:
            brightest = float(self._electrons_per_s(self._scene).max())
            wanted = _FILL * self._sensor.clip_electrons / max(brightest, 1e-9)
            self._asked = min(max(wanted, _LIMITS.exposure_s[0]), 1.0), 1.0

    def set(self, *, exposure_s: float, gain: float) -> None:
        """Set exposure time and gain of all shots from the next one on.

        Raises
        ------
        OptionError
            If they are beyond the limits.
        """
        _LIMITS.check(exposure_s, gain)
        self._asked = exposure_s, gain

    def shot(self) -> Shot:
        """Take a frame, not sooner after the one before than a camera could.

        Raises
        ------
        CameraError
            If it is not open.
        """
        if not self._is_open or self._asked is None:
            raise CameraError(f"the {self.name} is not open, or was closed: open it first")
        exposure_s, gain = self._asked
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
        """Stop; nothing happens where that is so already."""
        self._is_open = False
        self._closed.set()

    def _work_out(self) -> _Ready:
        with self._lock:
            if self._ready is None:
                twin = Twin.of(self._opened)
                camera = twin.camera
                model = PlainModel.of(
                    twin,
                    FieldMap.covering(twin, _half_field(twin)),
                    distance_um=camera.reference_distance.um,
                    light=Light(_LIGHT),
                )
                currents = photocurrents(twin, Light(_LIGHT), _LUMINANCE_CD_M2)[:, None, None]
                size = camera.sensor.rows, camera.sensor.columns
                current = mosaic(currents.expand(-1, *size), camera.sensor.mosaic)
                self._ready = _Ready(model, current.contiguous())
            return self._ready

    def _electrons_per_s(self, scene: Tensor) -> Tensor:
        """Of every pixel; a scene that stays is worked out once."""
        if self._rate is None or self._rate[0] is not scene:
            ready = self._work_out()
            light = ready.model.light(self._on_cells(ready.model, scene))
            self._rate = scene, light.mul_(ready.current)
        return self._rate[1]

    def _on_cells(self, model: PlainModel, scene: Tensor) -> Tensor:
        if len(self._sensor.channels) == 1:
            scene = scene.mean(dim=0, keepdim=True)
        return model.on_cells(scene)


def _half_field(twin: Twin) -> tuple[float, float]:
    """Tangents of half the field: 40° along the longer side, or what an aperture leaves of it."""
    sensor = twin.camera.sensor
    rows, columns = sensor.rows, sensor.columns
    longest = math.tan(math.radians(_ANGLE_DEG / 2))

    def tangents(longer: float) -> tuple[float, float]:
        return longer * rows / max(rows, columns), longer * columns / max(rows, columns)

    room = aperture_room_um(twin)
    if room is None:
        return tangents(longest)
    stays, leaves = 0.0, longest
    for _ in range(40):
        middle = (stays + leaves) / 2
        reach = [max(twin.shift_um(PointSource((0.0, tangent)))) for tangent in tangents(middle)]
        if all(each <= most for each, most in zip(reach, room, strict=True)):
            stays = middle
        else:
            leaves = middle
    return tangents(leaves)


def _frame(counts: Tensor, sensor: Sensor, exposure_s: float, source: str) -> Frame:
    pattern = None if sensor.mosaic == "none" else sensor.mosaic
    return Frame(
        counts=counts.float()[None],
        channels=("grey",) if pattern is None else ("mosaic",),
        mosaic=pattern,
        black=(sensor.black_counts,),
        white=float(sensor.saturated_counts),
        stored_as="uint16",
        source=source,
        exposure_s=exposure_s,
        black_stated=True,
    )
