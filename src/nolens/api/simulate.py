"""Cameras that are described, their PSFs, and what they measure of a scene."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from nolens.api.image import Image
from nolens.api.inputs import (
    Progress,
    Scene,
    angle_of,
    distance_um,
    radiance_of,
    reported,
    source_of,
)
from nolens.calibrate.distances import pixel_angle
from nolens.camera import FieldPsf, Frame, LoadedCamera, ReliefFile, develop
from nolens.errors import DataError, OptionError
from nolens.experiments.virtual_experiment import VirtualExperiment, render_motion
from nolens.files import read_camera, read_light
from nolens.jobs.bands import bands_of
from nolens.operators import PixelRectangle
from nolens.quantities import Angle, Duration, Length
from nolens.solvers.inputs import Plane, channels_of
from nolens.twin import Plane as ScenePlane
from nolens.twin import Twin, check_simulation_memory, in_channels, preview_model


class Camera:
    """A lensless camera that is described: sensor, layers and mask.

    Parameters
    ----------
    description
        ``"paper"``, ``"small"``, a folder with camera.toml, a .toml file, or an `LoadedCamera`.
    pixels
        (rows, columns) in the middle of the sensor that are read out, even numbers of a mosaic;
        None reads all.
    device
        Where to compute: ``"cpu"`` or ``"cuda"``.

    Raises
    ------
    FileError
        If there is no such camera, or a file it names cannot be read.
    DataError
        If the description is no camera.
    OptionError
        If the sensor has fewer pixels, or odd numbers part the superpixels of its mosaic.
    """

    def __init__(
        self,
        description: str | Path | LoadedCamera,
        *,
        pixels: tuple[int, int] | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        if not isinstance(description, LoadedCamera):
            description = read_camera(description)
        sensor = description.camera.sensor
        whole, step = (sensor.rows, sensor.columns), sensor.superpixel
        if pixels is not None and not all(
            0 < count <= most and count % step == 0
            for count, most in zip(pixels, whole, strict=True)
        ):
            raise OptionError(
                f"pixels is {pixels}, and the sensor has {whole[0]}×{whole[1]}: give no more of "
                "them" + (", even numbers for its mosaic" if step > 1 else "")
            )
        self.loaded: LoadedCamera = description
        self.pixels = pixels
        self.device = torch.device(device)

    @property
    def name(self) -> str:
        """As its description says."""
        return self.loaded.camera.name

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels of a measurement."""
        return tuple(self.loaded.camera.sensor.channels)

    @property
    def pixel_um(self) -> float:
        """Distance of the pixels of a measurement; of a mosaic, that of the superpixels."""
        return preview_model(self.loaded).pixel_um

    @cached_property
    def size(self) -> tuple[int, int]:
        """(height, width) of a measurement in pixels; of a mosaic, superpixels of 2×2."""
        return self.preview.shape

    @cached_property
    def preview(self) -> Twin:
        """The simulated camera with a stand-in for its relief, for estimates."""
        return self._read(preview_model(self.loaded))

    @property
    def read_out(self) -> LoadedCamera:
        """The description of a camera with no more pixels than are read out."""
        preview = self.preview
        return replace(self.loaded, camera=preview.camera, filters=preview.filters)

    @cached_property
    def twin(self) -> Twin:
        """The simulated camera; the paper's takes seconds."""
        return self._read(Twin.of(self.loaded, device=self.device))

    def with_relief(self, heights_um: Plane, grid: str | Length) -> "Camera":
        """The same camera with another mask.

        Parameters
        ----------
        heights_um
            Of the mask's surface over a flat one, (rows, columns), in µm; it should reach beyond
            the sensor as far as light from the side passes.
        grid
            Distance of its points, such as ``"1um"``.

        Raises
        ------
        DataError
            If the heights are no numbers.
        """
        heights = channels_of(heights_um, "relief")[0].float().cpu()
        spacing = grid if isinstance(grid, Length) else Length.parse(grid)
        relief = ReliefFile(kind="file", file="relief.tif", grid=spacing)
        loaded = self.loaded.with_relief(relief, heights)
        return Camera(loaded, pixels=self.pixels, device=self.device)

    def _read(self, whole: Twin) -> Twin:
        return whole if self.pixels is None else whole.reading(*self.pixels)

    def __repr__(self) -> str:
        height, width = self.size
        return f"Camera({self.name!r}, {height}×{width} pixels, {', '.join(self.channels)})"


@dataclass(frozen=True, repr=False)
class Psf(Image):
    """A point spread function: what the sensor sees of a point source, (channels, height, width).

    Its middle, the pixel (height // 2, width // 2), is the zero shift.

    Parameters
    ----------
    field_psf
        Those of other directions, too; None of a point source alone.
    """

    field_psf: FieldPsf | None = field(default=None, repr=False, kw_only=True)


@dataclass(frozen=True, repr=False)
class SimulatedMeasurement(Image):
    """What a simulated camera measured of a scene, and what was there. `values` are linear.

    Parameters
    ----------
    frame
        The raw frame: counts behind the colour mosaic, with noise.
    truth
        Radiance of the scene on the pixels of the support, (channels, height, width); of a scene
        with bands (bands, height, width), of a moving one (frames, channels, height, width).
    response
        How much of it each pixel gives, (height, width), 1 for the brightest.
    support
        Pixels that light comes from.
    pixel_rad
        Angle of a pixel of the scene in the middle of the view.
    """

    frame: Frame = field(repr=False)
    truth: Tensor = field(repr=False)
    response: Tensor = field(repr=False)
    support: PixelRectangle
    pixel_rad: float = field(repr=False)

    @property
    def expected(self) -> Tensor:
        """The scene as bright as its light reaches the sensor: what a reconstruction shows."""
        return self.truth * self.response

    def binned_support(self, by: int) -> PixelRectangle:
        """Pixels that light comes from, where `by`×`by` of the measurement's are one."""
        return self.support if by == 1 else self.support.coarser(by)


def psf(
    camera: Camera,
    distance: str | Length = "300mm",
    *,
    angle: tuple[str | Angle, str | Angle] = ("0deg", "0deg"),
    size: tuple[int, int] | None = None,
    support: PixelRectangle | None = None,
    diameter: str | Length = "50um",
    light: str = "white-led",
    wavelengths: int = 3,
    field_points: int = 1,
    progress: Progress = False,
) -> Psf:
    """The PSF of a described camera, without noise.

    Parameters
    ----------
    camera
        The camera.
    distance
        From the point source to the camera, or ``"infinity"``.
    angle
        Field angles of the point source, to the right and up as the photographer sees it.
    size
        (height, width) in pixels; None takes the sensor's.
    support
        Of the scenes to be reconstructed: the PSF is as large as they need.
    diameter
        Of the point source.
    light
        Its spectrum, such as ``"white-led"`` or ``"535nm"``, or a .csv with the columns
        ``wavelength_nm,power``.
    wavelengths
        How many stand for a channel.
    field_points
        PSFs along each side of the `support`, as `reconstruct` uses them where the PSF varies over
        the field; odd. 1 computes that of `angle` alone.
    progress
        Whether to show a bar, or a function for the fraction that is done.

    Raises
    ------
    OptionError
        If a quantity, the light or the size cannot be used.
    DataError
        If no light reaches these pixels.
    """
    if size is not None and support is not None:
        raise OptionError("size and support both say how large the PSF is: leave one out")
    if support is not None:
        rows, columns = camera.size
        size = (rows + support.height, columns + support.width)
    source = source_of(distance, angle, diameter)
    if field_points != 1 and (support is None or source.angle_deg > 0):
        raise OptionError(
            f"field_points {field_points} covers a support with PSFs of several angles: give the "
            "support (such as that of a simulated measurement), and no angle"
        )
    preview = VirtualExperiment(camera.preview, read_light(light), wavelengths)
    working = preview.psf_bytes(source, size)
    twin = twin_of(camera, working, "a smaller size or a camera that reads fewer pixels")
    experiment = replace(preview, twin=twin)
    field_psf = None
    with reported(progress, "PSF") as report:
        if support is None or field_points == 1:
            values = experiment.psf(source, size, report)
        else:
            field_psf = experiment.field_psf(
                support, field_points, source.distance_um, source.diameter_um, report
            )
            values = field_psf.on_axis
    if not float(values.max()) > 0:
        raise DataError(
            f"no light from {source.angle_deg:.4g} deg off the axis reaches these pixels: choose a "
            "smaller angle or a larger size"
        )
    return Psf(values, camera.channels, field_psf=field_psf)


def simulate_point(
    camera: Camera,
    distance: str | Length = "300mm",
    *,
    angle: tuple[str | Angle, str | Angle] = ("0deg", "0deg"),
    diameter: str | Length = "50um",
    fill: float = 0.9,
    seed: int = 0,
    light: str = "white-led",
    wavelengths: int = 3,
    progress: Progress = False,
) -> Frame:
    """The raw frame that a described camera takes of one point source, with noise.

    Parameters
    ----------
    camera, distance, angle, diameter, light, wavelengths, progress
        As `psf` takes them.
    fill
        Fraction of a full pixel that the brightest one is exposed to; above 1 it clips.
    seed
        Of the noise.

    Raises
    ------
    OptionError
        If a quantity or the light cannot be used.
    """
    experiment = VirtualExperiment(camera.twin, read_light(light), wavelengths)
    with reported(progress, "point source") as report:
        return experiment.point(
            source_of(distance, angle, diameter), fill=fill, seed=seed, progress=report
        )


def simulate(
    scene: Scene | Sequence[Scene],
    camera: Camera,
    *,
    angle: str | Angle = "30deg",
    distance: str | Length = "300mm",
    bands: Sequence[str | Length | Angle] = (),
    exposure: str | Duration | None = None,
    fill: float = 0.9,
    seed: int = 0,
    light: str = "white-led",
    wavelengths: int = 1,
    field_points: int = 5,
    progress: Progress = False,
) -> SimulatedMeasurement:
    """What a described camera measures of a scene, with a PSF that varies over the field.

    Parameters
    ----------
    scene
        A picture: its file, 8 or 16-bit sRGB (height, width, 3), or linear radiance as floats. With
        `bands` linear radiance, (bands, height, width); with an `exposure` a sequence of pictures.
    camera
        The camera.
    angle
        Field angle that the scene's longer side fills, from edge to edge.
    distance
        From the scene to the camera, or ``"infinity"``.
    bands
        What the channels of a scene are: wavelengths such as ``"450nm"``, or angles of its
        polarised light such as ``"45deg"``.
    exposure
        Of a line of a rolling shutter, such as ``"1ms"``: the scene moves, and its pictures share
        the time from the first line's exposure to the last one's equally.
    fill
        Fraction of a full pixel that the brightest one is exposed to, 0 to 1.
    seed
        Of the noise.
    light
        Spectrum of the scene's white.
    wavelengths
        How many stand for a channel.
    field_points
        PSFs along each side of the scene; odd.
    progress
        Whether to show a bar, or a function for the fraction that is done.

    Raises
    ------
    NolensError
        If the scene or a parameter cannot be used.
    """
    if not 0 < fill <= 1:
        raise OptionError(f"fill is {fill!r}; give a fraction above 0 and up to 1, such as 0.9")
    if bands and exposure is not None:
        raise OptionError("bands and exposure are given, but a moving scene has no bands")
    known = bands_of(",".join(map(str, bands))) if bands else ()
    place = angle_of(angle).deg, distance_um(distance)
    planes = _planes(scene, camera, place, len(known), moving=exposure is not None)
    preview = VirtualExperiment(camera.preview, read_light(light), wavelengths, field_points)
    working = preview.scene_bytes(planes) if exposure is None else preview.motion_bytes(planes[0])
    twin = twin_of(camera, working, "a smaller angle or a camera that reads fewer pixels")
    experiment = replace(preview, twin=twin)
    with reported(progress, "measurement") as report:
        if exposure is None:
            shot = experiment.measure(planes, fill=fill, seed=seed, bands=known, progress=report)
        else:
            field, scenes = render_motion(twin, planes)
            model = experiment.field_model(field, planes[0].distance_um, report)
            time = exposure if isinstance(exposure, Duration) else Duration.parse(exposure)
            shot = experiment.measure_motion(model, scenes, exposure_s=time.s, fill=fill, seed=seed)
    values = develop(shot.frame).values
    return SimulatedMeasurement(
        values,
        camera.channels,
        shot.frame,
        shot.truth,
        shot.response,
        shot.support,
        pixel_angle(camera.loaded.camera, camera.pixel_um),
    )


def _planes(
    scene: Any,
    camera: Camera,
    place: tuple[float, float],
    bands: int,
    *,
    moving: bool,
) -> tuple[ScenePlane, ...]:
    """The picture at its place, or every picture of a moving scene."""
    if bands:
        cube = channels_of(scene, "scene").float()
        if len(cube) != bands:
            raise DataError(
                f"the scene has {len(cube)} pictures and there are {bands} bands: give one for each"
            )
        return (ScenePlane(cube, *place),)
    channels, read = len(camera.channels), map(radiance_of, scene if moving else [scene])
    return tuple(
        ScenePlane(in_channels(radiance, channels), *place, opacity) for radiance, opacity in read
    )


def twin_of(camera: Camera, working: float, remedy: str) -> Twin:
    """The simulated camera, if there is memory for its relief and `working` bytes beside it.

    Raises
    ------
    OptionError
        If the machine has less memory than that; the remedy is what needs less.
    """
    check_simulation_memory(camera.loaded, working, camera.device, f"{remedy} needs less")
    return camera.twin
