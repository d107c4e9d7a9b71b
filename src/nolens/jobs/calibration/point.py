"""`nolens calibrate`: frames of a point source become a PSF in a camera's folder."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import Field
from torch import Tensor

from nolens.calibrate.centring import PlacedPsf, ReferencePsf, place_psf
from nolens.calibrate.distances import Layers
from nolens.calibrate.exposures import (
    SAME_TIME,
    UNCERTAIN_RATIO,
    FrameMean,
    add_frame,
    check_alike,
    match_darks,
)
from nolens.calibrate.point_psf import PointPsf, StrayLight, point_psf, point_psf_bytes
from nolens.camera import Frame, PsfEntry, PsfSet, Sensor
from nolens.camera.part import PixelPitch
from nolens.camera.psf_set import Depth
from nolens.errors import DataError, OptionError
from nolens.files import CAMERA_FILE, camera_files, read_frame, read_psf
from nolens.files.cameras import camera_copies
from nolens.jobs.calibration.folder import (
    RESULT,
    NewPsfOptions,
    added,
    check_channels,
    check_free,
    chosen_camera,
    folder_psfs,
    output_folder,
    pixel_of,
)
from nolens.jobs.fields import CAMERAS, Exposure, FieldAngles, FilePath, Files, Mosaic, Name
from nolens.jobs.options import Option
from nolens.jobs.run import Product, Reporter, Run, Writer, check_memory, job
from nolens.quantities import Angle, Length

_SOURCE, _FRAMES = "Point source", "Frames"
_MERGED_FRACTION = 0.5
"""Of the work on a PSF; the rest brings it into its place."""


class CalibratePointOptions(NewPsfOptions):
    """Make a PSF of pictures of one point source, and add it to a camera's folder.

    nolens calibrate point*.dng --distance 300mm --camera paper -o mycamera

    Once for each place of the point source: the folder gathers the PSFs of all distances and
    angles. Use a white LED behind a pinhole of 50 um in a dark room; more frames make less noise,
    and frames of several exposure times keep the faint parts where the long ones clip.
    """

    names: ClassVar = ("psf", "calibrate")
    usage = "calibrate FRAME... --distance 300mm -o FOLDER"

    frames: Annotated[
        Files,
        Field(min_length=1),
        Option(
            "Camera raw (.dng and others), .tif, .png or .npy, all of the same point source.",
            needed="the frames of one point source (nolens calibrate FRAME... --distance 300mm -o "
            "FOLDER)",
            role="input",
            positional=True,
            label="Frames",
        ),
    ]
    distance: Annotated[
        Depth,
        Option(
            "Of the point source from the camera, such as 300mm, or infinity.",
            _SOURCE,
            needed="that of the point source from the camera (--distance 300mm, or infinity)",
            label="Distance from the mask",
        ),
    ]
    angle: Annotated[
        FieldAngles,
        Option(
            "Field angles of the point source, to the right and up as the photographer sees it, "
            "such as 20deg,-10deg.",
            _SOURCE,
            default="0deg,0deg",
        ),
    ] = (Angle("0", "deg"), Angle("0", "deg"))
    dark: Annotated[
        Files,
        Option(
            "Frames with the point source off, after the others; those of each exposure time are "
            "subtracted from its frames.",
            _FRAMES,
            default="none, and the black level of the files",
            role="input",
            several=True,
            label="Dark frames",
        ),
    ] = ()
    exposure: Annotated[
        tuple[Exposure, ...],
        Field(max_length=100_000),
        Option(
            "Exposure time, such as 10ms: once for all frames, or once for each in their order.",
            _FRAMES,
            default="what the files say",
        ),
    ] = ()
    camera: Annotated[
        Name | None,
        Option(
            f"{CAMERAS}; it is copied into the folder.",
            _FRAMES,
            default="that of the folder, if it has one",
            role="camera",
            label="Description",
        ),
    ] = None
    pixel: Annotated[
        PixelPitch | None,
        Option(
            "Distance of the pixels in the frames, such as 1.55um, where no camera is known.",
            _FRAMES,
        ),
    ] = None
    mosaic: Annotated[
        Mosaic | None, Option("Colour mosaic of frames whose files do not say it.", _FRAMES)
    ] = None
    stray_light: Annotated[
        StrayLight,
        Option(
            "auto subtracts a smooth background where an aperture leaves a dark area, none leaves "
            "all in, floor takes the darkest light there is for stray light.",
            RESULT,
        ),
    ] = "auto"
    as_is: Annotated[
        bool,
        Option(
            "The frames are a finished PSF, such as another group's: subtract its black level and "
            "nothing else, and warn where frames of a camera would be refused. The middle of the "
            "file is its zero shift.",
            RESULT,
            default="off",
        ),
    ] = False
    output: Annotated[FilePath, output_folder("calibrate")]

    def check_together(self) -> None:
        """Refuse other times than frames, stray light of a finished PSF, and a frame twice."""
        if len(self.exposure) not in (0, 1, len(self.frames)):
            raise OptionError(
                f"--exposure is given {len(self.exposure)} times for {len(self.frames)} "
                "frames: give it once, for all of them, or once for each in their order"
            )
        if self.as_is and self.stray_light != "auto":
            raise OptionError(
                f"--as-is and --stray-light {self.stray_light} are both given: a PSF that is "
                "taken as it is keeps its stray light. Leave one of them out"
            )
        twice = [path for path in self.frames if self.frames.count(path) > 1]
        both = [path for path in self.dark if path in self.frames]
        if twice or both:
            raise OptionError(
                f"{(twice or both)[0]} is given twice: a frame counts once, as a frame or as a "
                "dark frame"
            )

    @property
    def suffix(self) -> str:
        """Distance and angle, as the names of files have them."""
        text = str(super().suffix)
        if any(each.deg != 0 for each in self.angle):
            text += "".join(f"-{each.deg:.6g}deg" for each in self.angle)
        return text

    @property
    def inputs(self) -> dict[str, Path]:
        """Frames and dark frames, by role."""
        return {
            f"{role} {number}": path
            for role, paths in (("frame", self.frames), ("dark frame", self.dark))
            for number, path in enumerate(paths, start=1)
        }


@dataclass(frozen=True)
class _Frames:
    """The frames, and the dark frames that belong to them, averaged by exposure time in s."""

    exposures: dict[float, FrameMean]
    darks: dict[float, FrameMean]
    timed: bool
    """Whether the exposure times are known."""
    warnings: list[str]

    @property
    def first(self) -> Frame:
        """One of the frames."""
        return next(iter(self.exposures.values())).first

    @property
    def channels(self) -> tuple[str, ...]:
        """Of the PSF."""
        return self.first.channels if self.first.mosaic is None else ("R", "G", "B")


def _read_frames(
    options: CalibratePointOptions, sensor: Sensor | None, reporter: Reporter
) -> _Frames:
    """Read all frames, and average those of one exposure time.

    The sensor says what files do not: mosaic, black and white level.
    """
    total = len(options.frames) + len(options.dark)
    exposures: dict[float, FrameMean] = {}
    known: list[bool] = []
    for number, path in enumerate(options.frames):
        reporter.advance("frames", number / total)
        frame = _read(path, options, sensor)
        stated = options.exposure[number % len(options.exposure)].s if options.exposure else None
        time = frame.exposure_s if stated is None else stated
        known.append(time is not None)
        if known[-1] != known[0]:
            raise DataError(
                f"{path} says {'its' if known[-1] else 'no'} exposure time, but "
                f"{options.frames[0]} does {'not' if known[-1] else 'so'}: give the time of every "
                "frame (--exposure, once for each in their order)"
            )
        if number > 0:
            check_alike(frame, next(iter(exposures.values())).first)
        add_frame(exposures, frame, time)
    mean = next(iter(exposures.values()))
    if not known[0] and not mean.alike:
        raise DataError(
            f"the frames do not say their exposure times, and differ by {100 * mean.uneven:.3g} % "
            f"in brightness from {mean.first.source}: give the times (--exposure, once for each "
            "frame in their order), or frames of one exposure"
        )
    darks: dict[float, FrameMean] = {}
    for number, path in enumerate(options.dark, start=len(options.frames)):
        reporter.advance("frames", number / total)
        frame = _read(path, options, sensor)
        check_alike(frame, next(iter(exposures.values())).first, "dark frame")
        add_frame(darks, frame, frame.exposure_s or None, "dark frame")
    reporter.advance("frames", 1.0)
    warnings = [
        f"frames of {1e3 * time:g} ms differ by {100 * mean.uneven:.2g} % in brightness: a light "
        "that flickers, or settings that changed between them"
        for time, mean in exposures.items()
        if not mean.alike
    ]
    first = mean.first
    if not darks and not first.black_stated:
        warnings.append(
            f"{first.source} does not say which count is black, and {first.black[0]:g} is taken: "
            "give dark frames (--dark), or a camera (--camera)"
        )
    if not math.isfinite(min(mean.white for mean in exposures.values())):
        warnings.append(
            f"{first.source} does not say from which count a pixel is saturated: make sure that "
            "none is"
        )
    matched = _matched(exposures, darks, known[0], warnings)
    return _Frames(exposures, matched, known[0], warnings)


def _read(path: Path, options: CalibratePointOptions, sensor: Sensor | None) -> Frame:
    """Read a frame, with what the sensor says where the file does not."""
    frame = read_frame(path, mosaic=options.mosaic)
    if sensor is None:
        return frame
    whole = tuple(frame.counts.shape[-2:]) == (sensor.rows, sensor.columns)
    if frame.channels == ("grey",) and sensor.mosaic != "none" and whole:
        frame = replace(frame, channels=("mosaic",), mosaic=sensor.mosaic)
    if not frame.black_stated and len(frame.channels) == 1:
        white = min(sensor.saturated_counts, math.inf if frame.white is None else frame.white)
        frame = replace(frame, black=(sensor.black_counts,), white=white, black_stated=True)
    return frame


def _matched(
    exposures: dict[float, FrameMean],
    darks: dict[float, FrameMean],
    timed: bool,
    warnings: list[str],
) -> dict[float, FrameMean]:
    """The dark frames that belong to each exposure time."""
    if not darks:
        return {}
    if not timed and len(darks) > 1:
        raise DataError(
            "the dark frames have several exposure times, and those of the frames are not known: "
            "give them (--exposure), or dark frames of the same time only"
        )
    matched = match_darks(exposures, darks)
    for time, mean in matched.items():
        own = mean.first.exposure_s
        same = own is not None and math.isclose(own, time, rel_tol=SAME_TIME)
        if timed and not same and own is not None:
            warnings.append(
                f"dark frames of {1e3 * own:g} ms are taken for frames of {1e3 * time:g} ms: where "
                "the sensor's dark current counts, take dark frames of every exposure time"
            )
    return matched


def _reference(options: CalibratePointOptions, psfs: PsfSet | None) -> PsfEntry | None:
    """A captured PSF to compare with: of the nearest other distance, straight ahead if any is."""
    captured = [each for each in (psfs.psf if psfs else ()) if each.kind == "captured"]
    here = 1e6 / _um(options)
    return min(
        captured,
        key=lambda each: (
            not _of_other_distance(each, options),
            abs(1e6 / each.distance_um - here),
        ),
        default=None,
    )


def _of_other_distance(entry: PsfEntry, options: CalibratePointOptions) -> bool:
    """Whether a PSF is straight ahead, in the middle, and of another distance."""
    return entry.on_axis and entry.frame == "chief-ray" and entry.distance != options.distance


def _um(options: CalibratePointOptions) -> float:
    return options.distance.um if isinstance(options.distance, Length) else math.inf


def _placed(
    point: PointPsf,
    options: CalibratePointOptions,
    layers: Layers | None,
    psfs: PsfSet | None,
    pixel_um: float,
    reporter: Reporter,
) -> PlacedPsf:
    """The PSF in its place, beside those of the folder; one that is finished stays as it is."""
    entry, reference = _reference(options, psfs), None
    if entry is not None:
        path = options.output / entry.file
        other = read_psf(options.output, entry)
        if other.shape != point.psf.shape:
            raise DataError(
                f"the PSF {path} has {other.shape[-2]}×{other.shape[-1]} pixels, but these frames "
                f"{point.psf.shape[-2]}×{point.psf.shape[-1]}: they are of another camera or "
                "setting. Give another folder (-o)"
            )
        if _of_other_distance(entry, options):
            reference = ReferencePsf(other, entry, str(path))
    if options.as_is:
        figures = {"centred_by": "its file", "shift_um": [0.0, 0.0]}
        return PlacedPsf(point.psf, "chief-ray", figures)
    return place_psf(
        point,
        pixel_um,
        distance_um=_um(options),
        angle=options.angle,
        layers=layers,
        reference=reference,
        progress=lambda fraction: reporter.advance(
            "PSF", _MERGED_FRACTION + (1 - _MERGED_FRACTION) * fraction
        ),
    )


@job
def calibrate_point(run: Run[CalibratePointOptions]) -> Product[Tensor]:
    """Average, clean and centre frames of a point source, and add the PSF to a folder.

    Raises
    ------
    NolensError
        If a frame, an option or the folder cannot be used; then nothing is written.
    """
    options, reporter = run.options, run.reporter
    opened, copied = chosen_camera(options.output, options.camera)
    camera: dict[str, Writer] = {}
    if opened is not None:
        run.reads(camera_files(copied or options.output / CAMERA_FILE, opened.camera))
    if opened is not None and copied is not None:
        camera = camera_copies(copied, opened)
        check_free(options.output, list(camera))
    psfs = folder_psfs(options.output)

    sensor = None if opened is None else opened.camera.sensor
    frames = _read_frames(options, sensor, reporter)
    pixel = pixel_of(frames.first, opened, psfs, options.pixel)
    layers = None if opened is None else Layers.of_camera(opened.camera)
    needed = point_psf_bytes(frames.first.counts.numel(), len(frames.exposures))
    check_memory(needed, run.device, "frames of fewer exposure times need less")
    run.begin(needed)
    point = point_psf(
        frames.exposures,
        frames.darks,
        pixel_um=pixel.um,
        stray=options.stray_light,
        sensor=sensor,
        as_is=options.as_is,
        progress=lambda fraction: reporter.advance("PSF", _MERGED_FRACTION * fraction),
    )
    placed = _placed(point, options, layers, psfs, pixel.um, reporter)
    reporter.advance("PSF", 1.0)

    usable = min(band.usable_per_mm for band in point.bands)
    entry = PsfEntry(
        file=options.psf_file,
        cell=pixel,
        channels=frames.channels,
        distance=options.distance,
        angle=options.angle,
        kind="captured",
        frame=placed.frame,
        usable_per_mm=round(usable, 2) if usable > 0 else None,
    )
    check_channels(psfs, entry.channels)
    run.warn(*frames.warnings, *_warnings(point, frames, usable, options.as_is), *placed.warnings)
    figures = {
        "camera": None if opened is None else opened.camera.name,
        **entry.model_dump(mode="json"),
        "pixels": list(placed.psf.shape[-2:]),
        **_figures(point, frames),
        **placed.figures,
    }
    return added(placed.psf, figures, options.output, {entry: placed.psf}, camera)


def _warnings(point: PointPsf, frames: _Frames, usable: float, as_is: bool) -> list[str]:
    """What may make the PSF worse than it could be."""
    texts = []
    if point.saturated_fraction > 0:
        texts.append(
            f"{100 * point.saturated_fraction:.2g} % of the pixels are saturated in every "
            "exposure, and too dark there: a frame of a shorter exposure gives them back"
        )
    if point.area is None and not frames.darks and not as_is:
        texts.append(
            "the PSF fills the sensor, so that nothing tells stray light from its own: what "
            "there is stays in. Dark frames (--dark), with the room as it was and the point source "
            "covered, take it away"
        )
    off = max(abs(ratio - 1) for ratio in point.ratios)
    if off > UNCERTAIN_RATIO:
        texts.append(
            f"the exposures are up to {100 * off:.2g} % off what their times say, and were "
            "corrected: the light or the shutter is not steady"
        )
    if usable <= 0:
        texts.append("the PSF's structure does not stand out of its noise: take more frames")
    return texts


def _figures(point: PointPsf, frames: _Frames) -> dict[str, Any]:
    """Figures of the PSF and of its frames, for the summary."""
    peak = float(point.psf.max())
    energy = point.psf.double().sum(dim=(-2, -1))
    peaks = point.psf.double().amax(dim=(-2, -1)).tolist()
    exposures = sorted(frames.exposures.items())
    return {
        "frames": sum(mean.count for _, mean in exposures),
        "exposures": [
            {
                "ms": round(1e3 * time, 6) if frames.timed else None,
                "frames": mean.count,
                "dark_frames": frames.darks[time].count if time in frames.darks else 0,
                "clipped_fraction": float(mean.clipped.double().mean()),
                "brightness": round(ratio, 6),
            }
            for (time, mean), ratio in zip(exposures, point.ratios, strict=True)
        ],
        "unit": "counts per second" if frames.timed else "counts of one frame",
        "peak": peak,
        "saturated_fraction": point.saturated_fraction,
        "frame_noise": {
            "read_counts": round(math.sqrt(point.noise.read_variance), 4),
            "counts_per_electron": round(point.noise.counts_per_electron, 5),
            "from": point.noise.known_from,
        },
        "noise_over_peak": [each / peak for each in point.noise_rms],
        "snr_db": [
            round(20 * math.log10(top / rms), 2) if top > 0 and rms > 0 else None
            for top, rms in zip(peaks, point.noise_rms, strict=True)
        ],
        "energy": (energy / energy.max()).tolist(),
        "contrast": round(point.contrast, 4),
        "dark_fraction": 0.0 if point.area is None else round(point.area.fraction, 4),
        "stray_over_peak": [each / peak for each in point.stray],
        "floor_over_peak": [each / peak for each in point.floor],
        "usable_per_mm_by_channel": [round(band.usable_per_mm, 2) for band in point.bands],
    }
