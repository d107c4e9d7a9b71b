"""PSFs from frames of a point source, and one of several that is extended beyond the sensor."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from nolens.api.inputs import Progress, Raw, angle_of, frame_of, length_um, reported
from nolens.api.simulate import Camera, Psf
from nolens.calibrate.centring import place_psf
from nolens.calibrate.distances import Layers
from nolens.calibrate.frames import PointFrames
from nolens.calibrate.point_psf import PointPsf, StrayLight, point_psf
from nolens.calibrate.stitch import Capture, Stitched, stitch_at_angles
from nolens.errors import OptionError
from nolens.operators import PixelRectangle
from nolens.quantities import Angle, Length

Angles = tuple[str | Angle, str | Angle]
"""Field angles of a point source, to the right and up as the photographer sees it."""


@dataclass(frozen=True, repr=False)
class CalibratedPsf(Psf):
    """A PSF that the sensor captured.

    Parameters
    ----------
    point
        Figures: noise, stray light, contrast, spectrum beside that of the noise.
    pixel_um
        Distance of its pixels.
    """

    point: PointPsf = field(repr=False)
    pixel_um: float


@dataclass(frozen=True, repr=False)
class StitchedPsf(Psf):
    """A PSF that is known beyond the sensor.

    Parameters
    ----------
    stitched
        Figures: where the captures lie, and their brightness.
    support
        Pixels of scenes for which the PSF is known.
    """

    stitched: Stitched = field(repr=False)
    support: PixelRectangle


def calibrate_psf(
    frames: Raw | Sequence[Raw],
    pixel: str | Length,
    *,
    dark: Raw | Sequence[Raw] = (),
    stray_light: StrayLight = "auto",
    as_is: bool = False,
    centre: bool = True,
) -> CalibratedPsf:
    """Make a PSF of raw frames of one point source: averaged, merged, without stray light.

    Frames of one exposure time are averaged, those of several merged to a high dynamic range.

    Parameters
    ----------
    frames
        Of the point source: files, or frames of `load`. Their exposure times are those that the
        files state; frames without one are taken to be alike.
    pixel
        Distance of the PSF's pixels, such as ``"3.1um"``; of a mosaic, that of the superpixels.
    dark
        Frames without the point source, of the same exposure times.
    stray_light
        ``"auto"``, ``"none"`` or ``"floor"``: what is subtracted as light of other sources.
    as_is
        Whether the frames are a finished PSF, of which only the black level is subtracted.
    centre
        Whether the light is moved to the middle, where an aperture leaves a dark area around it.

    Raises
    ------
    NolensError
        If a frame cannot be read, they do not fit together, or show no point source.
    """
    listed = _listed(frames)
    if not listed:
        raise OptionError("no frame is given: give one or more of a point source")
    taken = PointFrames()
    for each in listed:
        taken.add(frame_of(each, "frame"))
    for each in _listed(dark):
        taken.add_dark(frame_of(each, "dark frame"))
    pixel_um = length_um(pixel)
    point = point_psf(taken.means, taken.darks(), pixel_um=pixel_um, stray=stray_light, as_is=as_is)
    psf = point.psf
    if centre and not as_is:
        psf = place_psf(point, pixel_um).psf
    return CalibratedPsf(psf, taken.channels, point, pixel_um)


def stitch_psfs(
    psfs: Mapping[Angles, Psf],
    camera: Camera,
    pixel: str | Length | None = None,
    *,
    progress: Progress = False,
) -> StitchedPsf:
    """Merge PSFs of point sources at several field angles into one beyond the sensor.

    Parameters
    ----------
    psfs
        By field angle, such as ``{("0deg", "0deg"): ahead, ("25deg", "0deg"): right}``; each as the
        sensor captured it (``calibrate_psf(..., centre=False)``), one of them from straight ahead.
    camera
        Whose layers say where an angle moves the PSF.
    pixel
        Distance of the PSFs' pixels; None takes that of the camera's pixels or superpixels.
    progress
        Whether to show a bar, or a function for the fraction that is done.

    Raises
    ------
    DataError
        If the PSFs do not fit together.
    OptionError
        If none is of a source straight ahead.
    """
    layers = Layers.of_camera(camera.opened.camera)
    pixel_um = camera.pixel_um if pixel is None else length_um(pixel)
    captures = []
    for both, psf in psfs.items():
        angle = angle_of(both[0]), angle_of(both[1])
        name = f"the PSF at ({angle[0]}, {angle[1]})"
        captures.append(Capture.at_angle(psf.values.cpu(), angle, layers, pixel_um, name=name))
    with reported(progress, "overlaps") as report:
        result = stitch_at_angles(captures, report)
    sensor = captures[0].psf.shape[-2], captures[0].psf.shape[-1]
    channels = next(iter(psfs.values())).channels
    return StitchedPsf(
        result.psf, channels, result, PixelRectangle.centred(*result.support, sensor)
    )


def _listed(raw: Raw | Sequence[Raw]) -> list[Raw]:
    return list(raw) if isinstance(raw, (list, tuple)) else [raw]  # type: ignore[list-item]
