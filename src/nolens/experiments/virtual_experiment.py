"""A simulated camera with light in front of it: what other jobs take pictures with, in memory."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from nolens.camera import Camera, Frame, LoadedCamera, Measurement, Sensor, develop
from nolens.operators import Region
from nolens.optics import PointSource
from nolens.progress import ProgressCallback
from nolens.solvers import Progress, Reconstructor
from nolens.twin import (
    FieldMap,
    Light,
    Plane,
    PlaneView,
    Twin,
    expose,
    irradiate,
    mosaic,
    photocurrents,
    point_spread,
    render_planes,
)
from nolens.twin import Frame as PsfFrame


@dataclass(frozen=True)
class SimulatedMeasurement:
    """What the camera measured of a scene, and what was there.

    Parameters
    ----------
    frame
        The counts.
    region
        Pixels that light came from.
    truth
        Radiance on them, (channels, height, width).
    response
        How much of it each pixel gives, (height, width), 1 for the brightest.
    exposure_cd_s_m2
        Luminance of what has the radiance 1, times the exposure time.
    """

    frame: Frame
    region: Region
    truth: Tensor
    response: Tensor
    exposure_cd_s_m2: float


@dataclass(frozen=True)
class VirtualExperiment:
    """A simulated camera and the light it sees.

    Parameters
    ----------
    twin
        The camera.
    light
        Spectrum of the light.
    wavelengths
        How many stand for a channel.
    field_points
        PSFs along each side of a scene; odd.
    """

    twin: Twin
    light: Light
    wavelengths: int = 1
    field_points: int = 5

    @classmethod
    def of(
        cls,
        loaded: LoadedCamera,
        *,
        light: str = "white-led",
        wavelengths: int = 1,
        field_points: int = 5,
        device: torch.device | str = "cpu",
    ) -> "VirtualExperiment":
        """Make a camera ready (seconds for the paper's).

        Raises
        ------
        OptionError
            If the light is unknown, or the relief coarser than it needs.
        """
        return cls(Twin.of(loaded, device=device), Light(light), wavelengths, field_points)

    @property
    def sensor(self) -> Sensor:
        """Of the camera."""
        return self.twin.camera.sensor

    def psf(
        self,
        source: PointSource,
        size: tuple[int, int] | None = None,
        progress: ProgressCallback | None = None,
        *,
        pixels: int | None = None,
        frame: PsfFrame = "chief-ray",
    ) -> Tensor:
        """PSF without noise, (channels, rows, columns), each channel as bright as it is observed.

        Parameters
        ----------
        source
            The point source.
        size
            (rows, columns), which may be more than the sensor has; None takes the sensor's.
        progress
            Called with the fraction that is done.
        pixels
            Sensor pixels along one of the result; None takes those of the reconstruction.
        frame
            See `point_spread`.
        """
        pattern = point_spread(
            self.twin,
            source,
            size or self.twin.shape,
            superpixel=pixels or self.twin.superpixel,
            light=self.light,
            wavelengths=self.wavelengths,
            frame=frame,
            progress=progress,
        ).cpu()
        currents = photocurrents(self.twin, self.light, 1.0)
        return pattern * (currents / currents.max())[:, None, None]

    def point(
        self,
        source: PointSource,
        *,
        fill: float = 0.9,
        seed: int = 0,
        progress: ProgressCallback | None = None,
    ) -> Frame:
        """The sensor's frame of one point source.

        Parameters
        ----------
        source
            The point.
        fill
            Fraction of a full pixel that the brightest one is exposed to; above 1 it clips.
        seed
            Of the noise.
        progress
            Called with the fraction that is done.
        """
        return self.exposed(self.light_of(source, progress), fill, seed)

    def light_of(self, source: PointSource, progress: ProgressCallback | None = None) -> Tensor:
        """Light of one point on every pixel, in the pixel's colour; points add up."""
        size = self.sensor.rows, self.sensor.columns
        psf = self.psf(source, size, progress, pixels=1, frame="sensor")
        return mosaic(psf, self.sensor.mosaic)

    def measure(
        self,
        planes: tuple[Plane, ...],
        *,
        fill: float = 0.9,
        seed: int = 0,
        progress: ProgressCallback | None = None,
    ) -> SimulatedMeasurement:
        """The sensor's frame of a scene, with PSFs that vary over the field.

        Parameters
        ----------
        planes
            Pictures at distances.
        fill
            Fraction of a full pixel that the brightest one is exposed to.
        seed
            Of the noise.
        progress
            Called with the fraction that is done.
        """
        field, views = render_planes(self.twin, planes)
        return self.measure_views(field, views, fill=fill, seed=seed, progress=progress)

    def measure_views(
        self,
        field: FieldMap,
        views: tuple[PlaneView, ...],
        *,
        fill: float = 0.9,
        seed: int = 0,
        progress: ProgressCallback | None = None,
    ) -> SimulatedMeasurement:
        """The sensor's frame of views on the pixels of a map; the rest as `measure`."""
        irradiance = irradiate(
            self.twin,
            replace(field, twin=self.twin),
            views,
            field_points=self.field_points,
            light=self.light,
            wavelengths=self.wavelengths,
            progress=progress,
        )
        currents = photocurrents(self.twin, self.light, 1.0)[:, None, None]
        light = irradiance.light
        image = light * mosaic(currents.expand(-1, *light.shape), self.sensor.mosaic)
        response = field.solid_angle() * field.vignetting()
        return SimulatedMeasurement(
            self.exposed(image, fill, seed),
            field.region,
            torch.stack([plane.radiance for plane in views]).sum(dim=0),
            (response / response.max()).float(),
            fill * self.sensor.clip_electrons / float(image.max()),
        )

    def exposed(self, image: Tensor, fill: float, seed: int) -> Frame:
        """The sensor's frame of light on every pixel, its brightest exposed to `fill`."""
        electrons = image * (fill * self.sensor.clip_electrons / float(image.max()))
        return raw_frame(expose(electrons, self.sensor, seed=seed), self.twin.camera)


def raw_frame(counts: Tensor, camera: Camera, exposure_s: float | None = None) -> Frame:
    """The frame of a simulated sensor's counts, (rows, columns)."""
    sensor = camera.sensor
    pattern = None if sensor.mosaic == "none" else sensor.mosaic
    return Frame(
        counts.float()[None],
        ("grey",) if pattern is None else ("mosaic",),
        pattern,
        (sensor.black_counts,),
        sensor.saturated_counts,
        "uint16",
        f"simulated by {camera.name}",
        exposure_s=exposure_s,
        black_stated=True,
    )


def solved(
    frame: Frame | Measurement,
    psf: Tensor,
    region: Region | None,
    *,
    iterations: int = 300,
    tau: float = 1e-5,
    progress: ProgressCallback | None = None,
) -> Tensor:
    """Scene on the pixels of the support, by ADMM (`nolens.solvers.admm`).

    Parameters
    ----------
    frame
        What the sensor measured.
    psf
        On its pixels, as large as the sensor or larger, (channels, rows, columns).
    region
        Pixels that light can come from; None for no limit.
    iterations, tau
        As `nolens reconstruct` takes them; all iterations are done.
    progress
        Called with the fraction that is done.
    """
    measurement = develop(frame) if isinstance(frame, Frame) else frame
    reconstructor = Reconstructor(psf, region, tau).for_iterations(iterations)

    def advance(state: Progress) -> None:
        if progress is not None:
            progress(state.iteration / iterations)

    return reconstructor.solve(measurement, callback=advance).scene
