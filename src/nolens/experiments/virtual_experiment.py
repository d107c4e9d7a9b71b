"""A simulated camera with light in front of it: what other jobs take pictures with, in memory."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import torch
from torch import Tensor

from nolens.camera import FieldPsf, Frame, LoadedCamera, Measurement, Sensor, Shutter, develop
from nolens.errors import DataError
from nolens.operators import PixelRectangle
from nolens.optics import PointSource
from nolens.progress import ProgressCallback, part_of
from nolens.quantities import Angle
from nolens.solvers import Prior, Progress, Reconstructor
from nolens.twin import (
    LARGEST_ANGLE_DEG,
    Band,
    FieldMap,
    FieldModel,
    Irradiated,
    Light,
    Plane,
    PlaneView,
    Twin,
    check_field_points,
    colours_of,
    expose,
    field_nodes,
    irradiate,
    irradiate_bytes,
    mosaic,
    photocurrents,
    pixel_currents,
    point_spread,
    polychromatic_psf_bytes,
    render_planes,
    shortest_nm,
)
from nolens.twin import Frame as PsfFrame

_VISIBLE = 0.3
"""Fraction of the noise from which on the error of the field points is worth a warning."""


@dataclass(frozen=True)
class SimulatedMeasurement:
    """What the camera measured of a scene, and what was there.

    Parameters
    ----------
    frame
        The counts.
    support
        Pixels that light came from.
    truth
        Radiance on them, (channels, height, width); of a moving scene (frames, channels, height,
        width).
    response
        How much of it each pixel gives, (height, width), 1 for the brightest.
    exposure_s
        Exposure time.
    luminance_cd_m2
        Of what has the radiance 1.
    brightest_electrons
        Mean number that the light frees in the brightest pixel.
    field_points
        PSFs along each side of the scene.
    field_error
        See `Irradiated.relative_error`.
    """

    frame: Frame
    support: PixelRectangle
    truth: Tensor
    response: Tensor
    exposure_s: float
    luminance_cd_m2: float
    brightest_electrons: float
    field_points: int
    field_error: dict[str, float] | None

    @property
    def exposure_cd_s_m2(self) -> float:
        """Luminance of what has the radiance 1, times the exposure time."""
        return self.luminance_cd_m2 * self.exposure_s

    @property
    def warnings(self) -> list[str]:
        """That more field points are needed, where their error shows beside the noise."""
        return self.field_warnings("--field-points")

    def field_warnings(self, option: str) -> list[str]:
        """The same, of an experiment whose users set their number by another option."""
        if self.field_error is None or self.field_error["of_noise"] <= _VISIBLE:
            return []
        points, of_noise = self.field_points, self.field_error["of_noise"]
        # Bilinear interpolation errs with the square of the distance of its points.
        steps = (points - 1) * math.sqrt(of_noise / _VISIBLE)
        return [
            f"between the {points}×{points} field points the simulation is off by "
            f"{of_noise:.2g} of the noise: try {option} {2 * math.ceil(steps / 2) + 1}"
        ]


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

    def psf_bytes(
        self, source: PointSource, size: tuple[int, int] | None = None, pixels: int | None = None
    ) -> float:
        """Most memory that `psf` holds; a preview of the camera tells it.

        Raises
        ------
        OptionError
            If the optics do not hold for the source.
        """
        twin, size, pixels = self.twin, size or self.twin.shape, pixels or self.twin.superpixel
        twin.check_source(source)
        # Around the result as much is computed as the image of the source is wide.
        image = source.diameter_um * float(twin.stack().spread_um(torch.tensor(twin.p_of(source))))
        edge = math.ceil(image / source.distance_um / (pixels * twin.sensor_pitch_um))
        colours = colours_of(twin, self.light, self.wavelengths)
        working = polychromatic_psf_bytes(
            twin,
            source,
            (size[0] + 2 * edge, size[1] + 2 * edge),
            pixels,
            at_least=2,
            shortest=shortest_nm(colours),
        )
        return working + 8 * math.prod(size) * len(colours)

    def scene_bytes(self, planes: tuple[Plane, ...]) -> float:
        """Most memory that `measure` holds; a preview of the camera tells it."""
        colours = colours_of(self.twin, self.light, self.wavelengths)
        return irradiate_bytes(self.twin, planes, self.field_points, colours)

    def motion_bytes(self, plane: Plane) -> float:
        """Most memory that a moving scene takes (`field_model`); a preview of the camera tells it.

        Parameters
        ----------
        plane
            One frame of it.
        """
        support = FieldMap.covering(self.twin, plane.tangents).support
        spectra = self.field_points**2 * self.twin.superpixel**2
        return self.scene_bytes((plane,)) + 4 * spectra * math.prod(self.twin.psf_shape(support))

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
            Sensor pixels along one of the result; None takes those of the reconstruction, of which
            each channel has its own pixels of the mosaic.
        frame
            See `point_spread`.
        """
        pixels = pixels or self.twin.superpixel
        pattern = point_spread(
            self.twin,
            source,
            size or self.twin.shape,
            superpixel=pixels,
            light=self.light,
            wavelengths=self.wavelengths,
            frame=frame,
            mosaic=self.sensor.mosaic if pixels == self.sensor.superpixel > 1 else None,
            progress=progress,
        ).cpu()
        currents = photocurrents(self.twin, self.light, 1.0)
        return pattern * (currents / currents.max())[:, None, None]

    def field_psf(
        self,
        support: PixelRectangle,
        points: int,
        distance_um: float,
        diameter_um: float = 0.0,
        progress: ProgressCallback | None = None,
    ) -> FieldPsf:
        """PSFs without noise at a grid of field points, as large as the support needs.

        Parameters
        ----------
        support
            Pixels of the scene; the outer points are on its edges.
        points
            Along each side; odd.
        distance_um, diameter_um
            Of the point sources.
        progress
            Called with the fraction that is done.

        Raises
        ------
        OptionError
            If the number of points is even or less than 1.
        """
        check_field_points(points)
        field, size = FieldMap(self.twin, support), self.twin.psf_shape(support)
        nodes = [field_nodes(side, points) for side in (support.height, support.width)]
        for side, pixels in zip((support.height, support.width), nodes, strict=True):
            pixels[len(pixels) // 2] = side // 2  # On the axis, where the support is around it.
        values, places = [], []
        for number, (row, column) in enumerate(product(*nodes)):
            source = field.source(row, column, distance_um).within(LARGEST_ANGLE_DEG)
            source = replace(source, diameter_um=diameter_um)
            values.append(self.psf(source, size, part_of(progress, number, points * points)))
            shift = self.twin.shift_um(source)
            places.append([each / self.twin.pixel_um for each in shift])
        return FieldPsf.of(values, torch.tensor(places, dtype=torch.float64))

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
        light = mosaic(psf, self.sensor.mosaic)
        if self.twin.filters is None:
            return light
        currents = pixel_currents(self.twin, self.light, 1.0)
        return light * (currents / currents.max())

    def measure(
        self,
        planes: tuple[Plane, ...],
        *,
        fill: float = 0.9,
        seed: int = 0,
        bands: tuple[Band, ...] = (),
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
        bands
            What each channel of the pictures is; none where they are the sensor's.
        progress
            Called with the fraction that is done.
        """
        field, views = render_planes(self.twin, planes, len(bands) or None)
        return self.measure_views(
            field, views, fill=fill, seed=seed, bands=bands, progress=progress
        )

    def measure_views(
        self,
        field: FieldMap,
        views: tuple[PlaneView, ...],
        *,
        fill: float = 0.9,
        exposure_s: float | None = None,
        luminance_cd_m2: float = 1.0,
        seed: int = 0,
        bands: tuple[Band, ...] = (),
        progress: ProgressCallback | None = None,
    ) -> SimulatedMeasurement:
        """The sensor's frame of views on the pixels of a map; the rest as `measure`.

        Parameters
        ----------
        field, views
            As `render_planes` gives them.
        fill, seed, bands, progress
            As `measure` takes them.
        exposure_s
            Exposure time in place of `fill`.
        luminance_cd_m2
            Of what has the radiance 1, in one band where there are bands.

        Raises
        ------
        DataError
            If no light reaches the sensor, and no exposure time is given.
        """
        rate = light = torch.zeros(self.sensor.rows, self.sensor.columns)
        squared_error: float | None = 0.0
        slices: list[tuple[Light, Angle | None, tuple[PlaneView, ...]]]
        slices = [(self.light, None, views)]
        if bands:
            slices = [
                (band.light(self.light), band.polarisation, self._slice(views, number))
                for number, band in enumerate(bands)
            ]
        for number, (spectrum, polarisation, seen) in enumerate(slices):
            part = irradiate(
                self.twin,
                replace(field, twin=self.twin),
                seen,
                field_points=self.field_points,
                light=spectrum,
                wavelengths=self.wavelengths,
                progress=part_of(progress, number, len(slices)),
            )
            light = light + part.light
            rate = rate + part.light * pixel_currents(
                self.twin, spectrum, luminance_cd_m2, polarisation
            )
            if squared_error is not None:
                error = part.field_error
                squared_error = None if error is None else squared_error + error**2
        irradiance = Irradiated(light, None if squared_error is None else math.sqrt(squared_error))
        if exposure_s is None:
            exposure_s = self.exposure_of(rate, fill)
        electrons = rate * exposure_s
        response = field.solid_angle() * field.vignetting()
        return SimulatedMeasurement(
            self._frame(electrons, seed),
            field.support,
            torch.stack([plane.radiance for plane in views]).sum(dim=0),
            (response / response.max()).float(),
            exposure_s,
            luminance_cd_m2,
            float(electrons.max()),
            self.field_points,
            irradiance.relative_error(rate.double() * exposure_s, self.sensor),
        )

    def field_model(
        self, field: FieldMap, distance_um: float, progress: ProgressCallback | None = None
    ) -> FieldModel:
        """The camera with its PSFs computed, for moving scenes of one distance."""
        return FieldModel.of(
            self.twin,
            replace(field, twin=self.twin),
            distance_um=distance_um,
            light=self.light,
            wavelengths=self.wavelengths,
            field_points=self.field_points,
            progress=progress,
        )

    def measure_motion(
        self,
        model: FieldModel,
        scenes: Tensor,
        *,
        exposure_s: float,
        frame_s: float | None = None,
        luminance_cd_m2: float | None = None,
        fill: float = 0.9,
        seed: int = 0,
    ) -> SimulatedMeasurement:
        """The sensor's frame of a moving scene, line by line as its shutter exposes them.

        Each frame of the scene stands still for `frame_s`, and the last one to the end.

        Parameters
        ----------
        model
            Of the scene's pixels and distance (`field_model`).
        scenes
            Radiance on its pixels, (frames, channels, height, width).
        exposure_s
            Exposure time of a line.
        frame_s
            Time of a frame of the scene; None divides the whole exposure of the sensor.
        luminance_cd_m2
            Of what has the radiance 1; None exposes the brightest pixel to `fill`.
        fill, seed
            As `measure` takes them.
        """
        shutter = Shutter.of(self.sensor, exposure_s)
        times = shutter.frames(len(scenes))
        if frame_s is not None:
            times = torch.arange(len(scenes) + 1, dtype=torch.float64) * frame_s
            times[-1] = max(float(times[-1]), shutter.duration_s)
        light = torch.zeros(self.sensor.rows, self.sensor.columns)
        for scene, fractions in zip(scenes, shutter.fractions(times), strict=True):
            if bool(fractions.any()):
                light += fractions[:, None] * model.light(scene)
        electrons = light * pixel_currents(self.twin, self.light, 1.0) * exposure_s
        if luminance_cd_m2 is None:
            luminance_cd_m2 = self.exposure_of(electrons, fill)
        electrons *= luminance_cd_m2
        return SimulatedMeasurement(
            replace(self._frame(electrons, seed), exposure_s=exposure_s),
            model.field.support,
            scenes,
            model.response.float(),
            exposure_s,
            luminance_cd_m2,
            float(electrons.max()),
            self.field_points,
            None,
        )

    def _slice(self, views: tuple[PlaneView, ...], number: int) -> tuple[PlaneView, ...]:
        """One band of views, in the channels of the sensor."""
        count = len(self.sensor.channels)
        return tuple(
            replace(view, radiance=view.radiance[number : number + 1].expand(count, -1, -1))
            for view in views
        )

    def exposed(self, image: Tensor, fill: float, seed: int) -> Frame:
        """The sensor's frame of light on every pixel, its brightest exposed to `fill`."""
        return self._frame(image * self.exposure_of(image, fill), seed)

    def exposure_of(self, image: Tensor, fill: float) -> float:
        """Factor from light to electrons by which the brightest pixel is exposed to `fill`.

        Raises
        ------
        DataError
            If there is no light.
        """
        return fill * self.sensor.clip_electrons / brightest(image)

    def _frame(self, electrons: Tensor, seed: int) -> Frame:
        """What the sensor reads out of the mean electrons in its pixels, (rows, columns)."""
        sensor = self.sensor
        pattern = None if sensor.mosaic == "none" else sensor.mosaic
        return Frame(
            expose(electrons, sensor, seed=seed).float()[None],
            ("grey",) if pattern is None else ("mosaic",),
            pattern,
            (sensor.black_counts,),
            sensor.saturated_counts,
            "uint16",
            f"the measurement simulated by {self.twin.camera.name}",
            black_stated=True,
        )


def render_motion(twin: Twin, planes: Sequence[Plane]) -> tuple[FieldMap, Tensor]:
    """The map of the pixels of a moving scene, and its frames on them (`render_planes`)."""
    rendered = [render_planes(twin, (plane,)) for plane in planes]
    return rendered[0][0], torch.stack([views[0].radiance for _, views in rendered])


def brightest(light: Tensor) -> float:
    """The most light that there is.

    Raises
    ------
    DataError
        If there is none.
    """
    most = float(light.max())
    if not most > 0:
        raise DataError(
            "no light reaches the sensor: the scene is black, or all of it is hidden. Give a "
            "brighter scene"
        )
    return most


def solved(
    frame: Frame | Measurement,
    psf: Tensor,
    support: PixelRectangle | None,
    *,
    iterations: int = 300,
    tau: float | None = None,
    prior: Prior = Prior.AUTO,
    field_psf: FieldPsf | None = None,
    progress: ProgressCallback | None = None,
) -> Tensor:
    """Scene on the pixels of the support, by ADMM (`nolens.solvers.admm`).

    Parameters
    ----------
    frame
        What the sensor measured.
    psf
        On its pixels, as large as the sensor or larger, (channels, rows, columns).
    support
        Pixels that light can come from; None for no limit.
    iterations
        All of them are done.
    tau
        Weight of the prior; None chooses it by held-out pixels.
    prior
        What the scene is assumed to be like.
    field_psf
        PSFs over the field, for the picture; None takes `psf` for all of it.
    progress
        Called with the fraction that is done.
    """
    measurement = develop(frame) if isinstance(frame, Frame) else frame
    reconstructor = Reconstructor(psf, support, tau, prior, field_psf=field_psf)
    reconstructor = reconstructor.for_iterations(iterations)

    def advance(state: Progress) -> None:
        if progress is not None:
            progress(state.iteration / iterations)

    return reconstructor.solve(measurement, callback=advance).scene
