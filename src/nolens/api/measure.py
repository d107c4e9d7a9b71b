"""How good a photograph is, what a PSF is like, how fine a camera resolves and how far it sees."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal, get_args

from torch import Tensor

from nolens.api.image import Image
from nolens.api.inputs import Progress, angle_of, distance_um, length_um, reported, source_of
from nolens.api.simulate import Camera, twin_of
from nolens.camera import Frame, develop
from nolens.errors import DataError, OptionError
from nolens.evaluate import (
    Comparison,
    EdgeResolution,
    Fit,
    FlatPicture,
    Motion,
    ObservedPair,
    PsfFigures,
    StarResolution,
    TwoPoints,
    compare_pictures,
    point_pair,
    psf_figures,
    scale_fit,
    siemens_star,
    slanted_edge,
    star_square_deg,
)
from nolens.evaluate import psnr as _psnr
from nolens.evaluate import ssim as _ssim
from nolens.experiments.off_axis import CORRELATIONS, FieldTarget
from nolens.experiments.off_axis import FieldOfView as _FieldOfView
from nolens.experiments.off_axis import compare as _compare_frames
from nolens.experiments.resolution import (
    POINT_ITERATIONS,
    TARGET_ITERATIONS,
    TAU,
    AngularScale,
    ScreenTarget,
    SimulatedTarget,
    SolverSettings,
    TwoPointTarget,
)
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.files.plot_measurements import (
    draw_edge,
    draw_star,
    draw_two_points,
    write_field_plot,
)
from nolens.operators import PixelRectangle
from nolens.quantities import Angle, Length
from nolens.solvers import Prior
from nolens.solvers.inputs import Plane, channels_of, one_of
from nolens.twin import Light

Target = Literal["siemens", "edge", "two-points"]
_SPOKES, _TILT_DEG = 36, 5.0
_ANGLES = tuple(f"{5 * number}deg" for number in range(11))
_REMEDY = "a smaller angle or a camera that reads fewer pixels"
_REMEDY_OF_PSFS = "fewer PSFs (field_points) or a camera that reads fewer pixels"


def psnr(picture: Image | Plane, truth: Image | Plane) -> float:
    """Peak signal-to-noise ratio in dB after the one factor that fits best.

    Parameters
    ----------
    picture, truth
        Linear, (channels, height, width), of one size. The peak is the truth's.

    Raises
    ------
    DataError
        If their sizes differ.
    """
    fitted, values = _fitted(picture, truth)
    return _psnr(fitted, values, float(values.max()))


def ssim(picture: Image | Plane, truth: Image | Plane) -> float:
    """Structural similarity, as `psnr` takes its pictures (`wang2004`).

    Raises
    ------
    DataError
        If their sizes differ.
    """
    fitted, values = _fitted(picture, truth)
    return _ssim(fitted, values, float(values.max()))


def compare(
    picture: Image | Plane,
    truth: Image | Plane,
    *,
    register: Motion = "none",
    fit: Fit = "affine",
    white: float = 1.0,
) -> Comparison:
    """PSNR, SSIM and MS-SSIM in linear light and as shown, as `nolens compare` has them.

    Parameters
    ----------
    picture, truth
        Linear, (channels, height, width).
    register
        What may differ between their places: ``"none"``, ``"shift"``, ``"similarity"`` or
        ``"homography"``.
    fit
        What of the picture's brightness is free: ``"affine"`` (gain and offset of each channel),
        ``"scale"`` (one factor) or ``"none"``.
    white
        Radiance of the truth that is white: the peak.

    Returns
    -------
    Comparison
        `figures`, `registration`, and both pictures on the same pixels.

    Raises
    ------
    DataError
        If their sizes or channels do not fit, or they do not show the same.
    """
    one, other = _values(picture, "picture"), _values(truth, "truth")
    return compare_pictures(one, other, register=register, fit=fit, white=white)


def measure_psf(psf: Image | Frame | Plane, pixel: str | Length, *, channel: int = 0) -> PsfFigures:
    """Width of the lines, pitch, contrast, sparsity and spectrum of a PSF (`psf_figures`).

    Parameters
    ----------
    psf
        A PSF, a raw frame of one, or linear values, (channels, height, width).
    pixel
        Distance of its pixels, such as ``"3.1um"``; of a raw mosaic, that of the superpixels.
    channel
        Which one is measured.

    Raises
    ------
    DataError
        If it shows nothing that can be measured.
    """
    values = develop(psf).values if isinstance(psf, Frame) else _values(psf, "PSF")
    if not 0 <= channel < values.shape[0]:
        raise DataError(f"channel is {channel}; the PSF has {values.shape[0]}, counted from 0")
    return psf_figures(values[channel], length_um(pixel))


@dataclass(frozen=True, repr=False)
class Resolution:
    """How fine a camera resolves, by one target. A notebook shows it as a plot.

    Parameters
    ----------
    target
        Which target.
    measured
        What was measured of it, with the picture.
    """

    target: Target
    measured: StarResolution | EdgeResolution | TwoPoints

    @property
    def figures(self) -> dict[str, Any]:
        """All figures by name, as ``nolens measure resolution --json`` prints them."""
        return self.measured.figures

    @property
    def resolved_deg(self) -> float | None:
        """Angle of the finest line pair, or of two points, that is resolved; None: not known."""
        resolved: float | None = self.figures["resolved_deg"]
        return resolved

    def _repr_png_(self) -> bytes:
        if isinstance(self.measured, StarResolution):
            return _png(partial(draw_star, self.measured))
        if isinstance(self.measured, EdgeResolution):
            return _png(partial(draw_edge, self.measured))
        return _png(partial(draw_two_points, self.measured))

    def __repr__(self) -> str:
        resolved = self.resolved_deg
        text = "not resolved" if resolved is None else f"{resolved:.3f}°"
        return f"Resolution({self.target}, {text})"


def measure_resolution(
    source: Camera | Image | Plane | Mapping[str | Angle, Image | Plane],
    target: Target = "siemens",
    *,
    camera: Camera | None = None,
    support: PixelRectangle | None = None,
    pixel_angle: str | Angle | None = None,
    spokes: int | None = None,
    angle: str | Angle | None = None,
    distance: str | Length = "300mm",
    iterations: int | None = None,
    tau: float = TAU,
    seed: int = 0,
    light: str = "white-led",
    wavelengths: int = 1,
    progress: Progress = False,
) -> Resolution:
    """How fine a camera resolves, by a target in a picture or before a simulated camera.

    Parameters
    ----------
    source
        A described camera, which is simulated; or a linear picture of the target. For two points,
        pictures by the angle between the points: ``{"0.5deg": one, "0.7deg": other}``.
    target
        ``"siemens"``, a star of bright spokes; ``"edge"``, a slanted edge; ``"two-points"``.
    camera, support
        Of a picture: the camera that took it, and the pixels that it shows; None: as many around
        the sensor's middle.
    pixel_angle
        Of a picture, in place of its camera: the angle of a pixel in the middle.
    spokes
        Bright spokes of the star; None takes what a picture shows, and 36 to simulate.
    angle, distance
        Of the simulated target: field angle that it fills (20° for a star, 10° for an edge), and
        from the target to the camera.
    iterations, tau
        Of the simulated picture's reconstruction; 300 iterations, 100 for two points.
    seed, light, wavelengths
        Of the simulation, as `simulate` takes them.
    progress
        Whether to show a bar, or a function for the fraction that is done.

    Raises
    ------
    OptionError
        If an option cannot be used, or the angle of a picture's pixels is not known.
    DataError
        If a picture shows no such target.
    """
    if target not in get_args(Target):
        raise OptionError(f"target is {target!r}; give one of {', '.join(get_args(Target))}")
    if isinstance(source, Camera):
        default = POINT_ITERATIONS if target == "two-points" else TARGET_ITERATIONS
        settings = SolverSettings(iterations or default, tau, seed=seed)
        depth_um, spokes = distance_um(distance), spokes or _SPOKES
        simulation: SimulatedTarget[FlatPicture | TwoPoints]
        if target == "two-points":
            simulation = TwoPointTarget(depth_um)
        elif target == "edge":
            edge = partial(slanted_edge, tilt_deg=_TILT_DEG)
            simulation = ScreenTarget(edge, angle_of(angle or "10deg").deg, depth_um)
        else:
            star = partial(siemens_star, periods=spokes)
            angle_deg = star_square_deg(angle_of(angle or "20deg").deg)
            simulation = ScreenTarget(star, angle_deg, depth_um)
        preview = VirtualExperiment(source.preview, Light(light), wavelengths)
        twin = twin_of(source, simulation.working_bytes(preview), _REMEDY)
        with reported(progress, target.replace("-", " ")) as advance:
            measured = simulation.measure(replace(preview, twin=twin), settings, advance)
        if isinstance(measured, TwoPoints):
            return Resolution(target, measured)
        return _of_picture(measured, target, spokes)
    scaled = partial(_scaled, camera=camera, support=support, pixel_angle=pixel_angle)
    if target == "two-points":
        return _of_pairs(source, scaled)
    if isinstance(source, Mapping):
        raise OptionError(f"the target {target} is measured in one picture: give that alone")
    picture, scale = scaled(source)
    return _of_picture(scale.flat(picture), target, spokes)


def _of_picture(picture: FlatPicture, target: Target, spokes: int | None) -> Resolution:
    if target == "edge":
        return Resolution(target, EdgeResolution.of(picture))
    return Resolution(target, StarResolution.of(picture, periods=spokes))


def _of_pairs(pictures: object, scaled: Callable[[Any], tuple[Tensor, AngularScale]]) -> Resolution:
    if not isinstance(pictures, Mapping) or not pictures:
        raise OptionError(
            "two points need a picture for each angle between them, such as "
            '{"0.5deg": one, "0.7deg": other}'
        )
    pairs = []
    for between, each in pictures.items():
        angle_deg = angle_of(between).deg
        picture, scale = scaled(each)
        pairs.append(ObservedPair(angle_deg, point_pair(picture, scale.pixels(angle_deg)), picture))
    return Resolution("two-points", TwoPoints.of(pairs))


def _scaled(
    picture: Image | Plane,
    *,
    camera: Camera | None,
    support: PixelRectangle | None,
    pixel_angle: str | Angle | None,
) -> tuple[Tensor, AngularScale]:
    """Mean of a picture's channels, and the angles of its pixels."""
    values = _values(picture, "picture").mean(dim=0)
    if (camera is None) == (pixel_angle is None):
        raise OptionError(
            "give either the camera that took the picture (camera=...) or the angle of one of its "
            'pixels (pixel_angle="0.138deg")'
        )
    if camera is None:
        return values, AngularScale(math.tan(angle_of(pixel_angle or "").rad))
    height, width = values.shape
    support = PixelRectangle.centred(height, width, camera.size) if support is None else support
    if (support.height, support.width) != (height, width):
        raise DataError(
            f"the support is {support.height}×{support.width} pixels, but the picture "
            f"{height}×{width}: give the support that it was reconstructed with"
        )
    return values, AngularScale.of_camera(camera.preview, support)


class FieldOfView(_FieldOfView):
    """How far to the side a camera sees. A notebook shows it as a plot.

    `figures` has all figures by name, as ``nolens measure field --json`` prints them; `psfs` are
    the PSFs by angle, `grid` the dots where a grid was measured, and `rays` curves by ray optics
    where the camera is known.
    """

    def _repr_png_(self) -> bytes:
        return _png(partial(write_field_plot, field=self, levels=CORRELATIONS))

    def __repr__(self) -> str:
        if self.grid is None:
            return f"FieldOfView({len(self.psfs)} PSFs up to {self.psfs[-1].angle_deg:.1f}°)"
        good = self.grid.angles.good_deg
        text = "none good" if good is None else f"good up to {good:.1f}°"
        return f"FieldOfView({len(self.grid.dots)} dots, {text})"


def measure_field(
    source: Camera | Mapping[str | Angle, Image | Plane],
    *,
    angles: Sequence[str | Angle] = _ANGLES,
    dot_pitch: str | Length | None = None,
    extent: str | Angle = "50deg",
    field_points: int = 1,
    simulated_psfs: int | None = None,
    prior: Prior | str = Prior.AUTO,
    distance: str | Length = "300mm",
    camera: Camera | None = None,
    pixel: str | Length | None = None,
    seed: int = 0,
    progress: Progress = False,
) -> FieldOfView:
    """How far to the side a camera sees, by PSFs at angles or by a grid of dots.

    Parameters
    ----------
    source
        A described camera, which is simulated; or captured PSFs on the pixels of the sensor, by
        the half angle to the right: ``{"0deg": central, "20deg": other}``.
    angles
        Half angles of the simulated point sources, rising.
    dot_pitch
        Distance of neighbouring dots: the simulated camera is shown a grid, whose picture is
        reconstructed. None compares PSFs.
    extent
        Half angle up to which there are dots.
    field_points
        PSFs along each side of the field with which the grid is reconstructed; odd.
    simulated_psfs
        PSFs along each side of the field between which those of the grid's dots are blended, odd;
        None takes one every 12.5°. How far off the blend is, ``grid.field_error`` says.
    prior
        What its reconstruction assumes: ``"auto"`` as for any scene, ``"l1"`` for points in the
        dark.
    distance
        Of the point sources or of the grid.
    camera, pixel
        Of captured PSFs: the camera that took them, or the distance of their pixels.
    seed
        Of the simulated noise.
    progress
        Whether to show a bar, or a function for the fraction that is done.

    Raises
    ------
    OptionError
        If an option cannot be used, or an angle is beyond the model.
    DataError
        If the PSFs cannot be compared, or the picture shows no grid.
    """
    if not isinstance(source, Camera):
        return _of_captured(source, distance, camera, pixel)
    at = [angle_of(each).deg for each in angles]
    if dot_pitch is None and (not at or at != sorted(set(at))):
        raise OptionError('give rising angles, such as ("0deg", "10deg", "20deg")')
    pitch_um = None if dot_pitch is None else length_um(dot_pitch)
    target = FieldTarget(
        distance_um(distance),
        at,
        pitch_um,
        angle_of(extent).deg,
        field_points,
        one_of(Prior, prior, "prior"),
        simulated_psfs,
    )
    remedy = _REMEDY if dot_pitch is None or field_points == 1 else _REMEDY_OF_PSFS
    twin = twin_of(source, target.working_bytes(source.preview), remedy)
    experiment = VirtualExperiment(twin, Light("white-led"), field_points=target.field_points)
    with reported(progress, "PSFs" if dot_pitch is None else "dots") as advance:
        field = target.measure(experiment, seed, advance)
    return FieldOfView(field.psfs, field.grid, field.rays)


def _of_captured(
    psfs: Mapping[str | Angle, Image | Plane],
    distance: str | Length,
    camera: Camera | None,
    pixel: str | Length | None,
) -> FieldOfView:
    """Captured PSFs beside the one from straight ahead."""
    planes = {
        angle_of(each).deg: _values(psf, f"PSF of {each}").mean(dim=0) for each, psf in psfs.items()
    }
    if 0.0 not in planes or len(planes) < 2:
        raise OptionError('give the central PSF, as "0deg", and others by their half angle')
    if (camera is None) == (pixel is None):
        raise OptionError(
            "give either the camera that took the PSFs (camera=...) or the distance of their "
            'pixels (pixel="3.1um")'
        )
    pixel_um = length_um(pixel or "") if camera is None else camera.pixel_um
    twin = None if camera is None else camera.preview
    measured = [
        _compare_frames(
            planes[0.0],
            planes[angle_deg],
            source_of(distance, (f"{angle_deg}deg", "0deg"), "0um"),
            pixel_um,
            twin,
        )
        for angle_deg in sorted(planes)
    ]
    return FieldOfView.of_psfs(measured, twin, distance_um(distance))


def _png(write: Callable[[Path], None]) -> bytes:
    """A plot as PNG, of what writes it as a file."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "plot.png"
        write(path)
        return path.read_bytes()


def _fitted(picture: Image | Plane, truth: Image | Plane) -> tuple[Tensor, Tensor]:
    image, values = _values(picture, "picture"), _values(truth, "truth")
    if image.shape != values.shape:
        raise DataError(
            f"the picture is {tuple(image.shape)} and the truth {tuple(values.shape)}, (channels, "
            "height, width): give both of one size"
        )
    return scale_fit(image, values), values


def _values(picture: Image | Plane, what: str) -> Tensor:
    values = picture.values if isinstance(picture, Image) else channels_of(picture, what)
    return values.float().cpu()
