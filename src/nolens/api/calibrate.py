"""PSFs from frames of a point source, and one of several that is extended beyond the sensor."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import torch

from nolens.api.inputs import Progress, Raw, angle_of, frame_of, length_um, reported
from nolens.api.simulate import Camera, Psf
from nolens.calibrate import psf_import
from nolens.calibrate.centring import place_psf
from nolens.calibrate.distances import Layers
from nolens.calibrate.frames import PointFrames
from nolens.calibrate.point_psf import PointPsf, StrayLight, point_psf
from nolens.calibrate.psf_import import PsfImport
from nolens.calibrate.stitch import Capture, Stitched, stitch_at_angles
from nolens.camera import BlackLevel, FieldPsf
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
class ImportedPsf(Psf):
    """A PSF that was measured elsewhere.

    Parameters
    ----------
    source
        Figures: black level, saturated pixels, notes and warnings.
    """

    source: PsfImport = field(repr=False)


@dataclass(frozen=True, repr=False)
class StitchedPsf(Psf):
    """A PSF that is known beyond the sensor; `field_psf` has that of each angle.

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
    point = point_psf(taken.means, taken.darks(), pixel_um=pixel_um, stray=stray_light)
    psf = point.psf
    if centre:
        psf = place_psf(psf, point.area, pixel_um).psf
    return CalibratedPsf(psf, taken.channels, point, pixel_um)


def import_psf(
    psf: Raw,
    *,
    dark: Raw | None = None,
    flat: Raw | None = None,
    black: BlackLevel = None,
    white: float | None = None,
    channels: str = "all",
    bin_by: int = 1,
    sensor: tuple[int, int] | None = None,
) -> ImportedPsf:
    """Make a PSF that was measured elsewhere fit a camera.

    A black level that the file does not state is read off the area that an aperture keeps dark;
    saturated pixels are continued from around them.

    Parameters
    ----------
    psf
        A file, a frame of `load`, or values; its middle is the zero shift.
    dark
        A frame without light, in place of the black level.
    flat
        A frame of even light, which the PSF is divided by: that takes the pattern of filters on the
        sensor's pixels out.
    black
        Black level in counts; ``"auto"`` reads it off the darkest corner.
    white
        Count from which a pixel is saturated; None takes what the file says or shows.
    channels
        ``"all"``, ``"grey"``, or letters such as ``"g"``.
    bin_by
        Pixels of the file along one of the PSF's.
    sensor
        (rows, columns) of the camera's measurements: the PSF is padded or cut to it.

    Raises
    ------
    NolensError
        If the file cannot be read, shows no light, or does not fit the sensor.
    """
    result = psf_import.import_psf(
        frame_of(psf, "PSF"),
        dark=None if dark is None else frame_of(dark, "dark frame"),
        flat=None if flat is None else frame_of(flat, "flat field"),
        black=black,
        white=white,
        channels=channels,
        bin_by=bin_by,
        sensor=sensor,
        partial=True,
    )
    return ImportedPsf(result.psf, result.channels, result)


def stitch_psfs(
    psfs: Mapping[Angles, Psf],
    camera: Camera,
    pixel: str | Length | None = None,
    *,
    progress: Progress = False,
) -> StitchedPsf:
    """Merge PSFs of point sources at several field angles into one beyond the sensor.

    The result has those of the angles, too, which `reconstruct` uses over the field.

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
    layers = Layers.of_camera(camera.loaded.camera)
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
    field_psf = FieldPsf.of([*result.at_captures()], torch.tensor(result.placement.shifts))
    support = PixelRectangle.centred(*result.support, sensor)
    return StitchedPsf(result.psf, channels, result, support, field_psf=field_psf)


def _listed(raw: Raw | Sequence[Raw]) -> list[Raw]:
    return list(raw) if isinstance(raw, (list, tuple)) else [raw]  # type: ignore[list-item]
