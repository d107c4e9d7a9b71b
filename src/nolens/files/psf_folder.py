"""The folder that a camera's PSFs are gathered in: what it has, and what fits to it."""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from decimal import Decimal
from functools import cached_property
from pathlib import Path
from typing import Literal

import torch
from torch import Tensor

from nolens.calibrate.centring import ReferencePsf
from nolens.calibrate.distances import Layers
from nolens.calibrate.field_coverage import coverage_warnings
from nolens.camera import Camera, FieldPsf, Frame, LoadedCamera, PsfEntry, PsfKind
from nolens.camera.field_psf import around_middle, odd_light, spread
from nolens.camera.psf_set import BEST_FIRST
from nolens.errors import DataError, FileError, OptionError
from nolens.files.atomic import Writer
from nolens.files.cameras import (
    CAMERA_FILE,
    PSFS_FILE,
    camera_copies,
    camera_files,
    read_camera,
    read_description,
    read_psf,
    read_psf_frame,
    read_psf_set,
    sensor_size,
)
from nolens.operators import PixelRectangle
from nolens.quantities import Length
from nolens.solvers import FieldPoint

Distance = Length | Literal["infinity"]
_CLOSE = 0.01
_SENSOR_SIZED: tuple[PsfKind, ...] = ("captured", "solved")
"""Kinds of PSFs that are as large as the sensor."""
_ONE_SIZED: tuple[PsfKind, ...] = (*_SENSOR_SIZED, "field-point")
"""Kinds of PSFs that are as large as others of the kind and distance."""
_AGAIN = (
    "Make it again as the others were made (nolens calibrate, calibrate import or psf), or remove "
    f"its entry from {PSFS_FILE}"
)
_PLAN = "nolens calibrate plan CAMERA --angle 56deg lists the angles for a scene of 56°"


@dataclass(frozen=True)
class ScenePsfs:
    """PSFs of one distance, as a scene there is reconstructed with them.

    Parameters
    ----------
    entries
        How the folder lists them, the one straight ahead first, and `alone` last.
    ahead
        The PSF straight ahead.
    field_points
        All of them; none where there is only that one.
    note
        Which are left out, and why; empty where none are.
    alone
        The one for all of the scene, where that is not `ahead`.
    """

    entries: tuple[PsfEntry, ...]
    ahead: Frame = field(repr=False)
    field_points: tuple[FieldPoint, ...] = field(repr=False)
    note: str
    alone: Frame | None = field(default=None, repr=False)


class PsfFolder:
    """A camera's folder, whose description and list of PSFs are read when they are needed.

    Attributes
    ----------
    path
        It need not exist.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._camera_source: str | Path = path / CAMERA_FILE

    @cached_property
    def camera(self) -> LoadedCamera | None:
        """The camera that the folder describes, if it describes one."""
        path = self.path / CAMERA_FILE
        return read_camera(path) if path.is_file() else None

    @property
    def camera_files(self) -> dict[str, Path]:
        """What the camera is read from, by role."""
        return {} if self.camera is None else camera_files(self._camera_source, self.camera.camera)

    @cached_property
    def psfs(self) -> tuple[PsfEntry, ...]:
        """The PSFs that it lists; none without a list."""
        return read_psf_set(self.path).psf if (self.path / PSFS_FILE).is_file() else ()

    def take(self, name: str) -> dict[str, Writer]:
        """Take the camera of a name for that of the folder: what writes its files there.

        Raises
        ------
        OptionError
            If the folder has the description of another one.
        FileError
            If one of the files would be written over another.
        """
        loaded = read_camera(name)
        if self.camera is not None:
            if self.camera.camera != loaded.camera:
                raise OptionError(
                    f"--camera {name} is not the camera that {self.path / CAMERA_FILE} describes: "
                    "leave --camera out, or give another folder (-o)"
                )
            return {}
        copies = camera_copies(name, loaded)
        for each in copies:
            if (self.path / each).exists():
                raise FileError(
                    f"the camera's {each} would overwrite {self.path / each}: give another folder "
                    "(-o)"
                )
        self.camera, self._camera_source = loaded, name
        return copies

    def layers(self, reduced: Length | None) -> Layers:
        """The layers of the folder's camera, or those of a reduced thickness.

        Raises
        ------
        OptionError
            If there is neither, or both.
        """
        if self.camera is not None and reduced is not None:
            raise OptionError(
                f"--reduced {reduced}: the folder has a {CAMERA_FILE}, whose layers say the same. "
                "Leave --reduced out, or mend the layers"
            )
        if self.camera is not None:
            return Layers.of_camera(self.camera.camera)
        if reduced is None:
            raise OptionError(
                f"the folder has no {CAMERA_FILE}: give the reduced thickness between mask and "
                "sensor, the sum of thickness / index of all layers (--reduced 1.28mm)"
            )
        return Layers.of_air(reduced.um)

    def ahead(self, *kinds: PsfKind) -> list[PsfEntry]:
        """PSFs of sources straight ahead, in the frame of the chief ray, nearest first.

        Raises
        ------
        NolensError
            If there is none.
        """
        listed = read_psf_set(self.path).by_distance(kinds)
        ahead = [each for each in listed if each.frame == "chief-ray"]
        if not ahead:
            kind = "captured" if kinds == ("captured",) else "measured"
            raise DataError(
                f"{self.path} has no {kind} PSF of a light straight ahead: add one first, with "
                "nolens calibrate FRAME... --distance 300mm"
            )
        return ahead

    def frame(self, entry: PsfEntry) -> Frame:
        """One of its PSFs, as a frame.

        Raises
        ------
        NolensError
            If its file cannot be read.
        """
        frame = read_psf_frame(self.path, entry)
        return replace(frame, sensor=frame.sensor or sensor_size(self.path, entry, frame.counts))

    def for_scene(self, distance_um: float | None, most: int | None = None) -> ScenePsfs:
        """PSFs for a scene at a distance: the best at each angle, about its chief ray.

        Parameters
        ----------
        distance_um
            Of the scene; None takes that of the PSFs straight ahead, if it is the only one.
        most
            How many PSFs, spread evenly; None takes all there are.

        Raises
        ------
        NolensError
            If there is none, the distance is none of theirs or not clear, a file is bad, or one is
            of another size or exposure than the others.
        """
        listed = self.ahead(*BEST_FIRST)
        have = ", ".join(str(each.distance) for each in listed)
        if distance_um is None and len(listed) > 1:
            raise OptionError(
                f"{self.path} has PSFs of several distances ({have}): say which is nearest to the "
                f"scene's (--distance {str(listed[0].distance).replace(' ', '')})"
            )
        ahead = next((e for e in listed if distance_um in (None, e.distance_um)), None)
        if ahead is None:
            raise OptionError(
                f"{self.path} has no PSF of the distance that is asked for, but those of {have}: "
                "choose one (--distance)"
            )
        entries, note = ([], "") if most == 1 else self._over_field(ahead)
        if not entries:
            return ScenePsfs((ahead,), self.frame(ahead), (), note)
        places = [self._place(each) for each in entries]
        chosen = spread(places, len(places) if most is None else most)
        read = [*(entries[number] for number in chosen), ahead]
        frames = [self.frame(each) for each in read]
        self._check_sizes(read, frames)
        self._check_light(read, frames)
        size = max(each.size[0] for each in frames), max(each.size[1] for each in frames)
        # What the file says of the sensor holds for the largest; the others are made as large.
        sensor = next((each.sensor for each in frames if each.size == size), None)
        frames = [
            replace(each, counts=around_middle(each.counts, size), sensor=sensor) for each in frames
        ]
        *frames, alone = frames
        points = tuple(
            FieldPoint(frame, places[number]) for frame, number in zip(frames, chosen, strict=True)
        )
        used = tuple(entries[number] for number in chosen)
        if ahead in used:
            return ScenePsfs(used, frames[0], points, note)
        return ScenePsfs((*used, ahead), frames[0], points, note, alone)

    def _over_field(self, ahead: PsfEntry) -> tuple[list[PsfEntry], str]:
        """Those of field points, or the best at each angle, of one straight ahead.

        They have its distance and wavelength. None where that is the only one that can be used; and
        why others cannot.
        """
        alike = ahead.distance, ahead.wavelength
        there = [each for each in self.psfs if (each.distance, each.wavelength) == alike]
        at_angles = [each for each in there if not each.on_axis]
        best = {
            each.angle: each
            for kind in reversed(BEST_FIRST)
            for each in at_angles
            if each.kind == kind and each.frame == "chief-ray"
        }
        made = {each.angle: each for each in there if each.kind == "field-point"}
        if any(each.on_axis for each in made.values()):
            best = made
        elif best:
            best[ahead.angle] = ahead
        if at_angles and not best:
            return [], (
                f"{len(at_angles)} PSFs of {self.path} are left out, as they show the sensor as it "
                f"was, and their angles are not exact: nolens calibrate stitch {self.path} makes "
                "PSFs over the field of them"
            )
        if best and not (self.path / CAMERA_FILE).is_file():
            return [], (
                f"{len(at_angles)} PSFs of {self.path} are left out: where light of their angles "
                f"falls follows from the layers of a {CAMERA_FILE}, which is not there"
            )
        return [*best.values()], ""

    def _check_sizes(self, entries: list[PsfEntry], frames: list[Frame]) -> None:
        """Refuse a PSF that is not as large as the sensor, or as the others of its kind."""
        for kind in _ONE_SIZED:
            alike = [(e, f) for e, f in zip(entries, frames, strict=True) if e.kind == kind]
            if not alike:
                continue
            sensor = self._sensor_of(alike[0][0].pixel) if kind in _SENSOR_SIZED else None
            ((size, _),) = Counter(frame.size for _, frame in alike).most_common(1)
            for entry, frame in alike:
                if frame.size != (sensor or size):
                    rows, columns = sensor or size
                    whose = f"the sensor of {CAMERA_FILE} has" if sensor else "other PSFs have"
                    raise DataError(
                        f"{self.path / entry.file} has {frame.size_text} pixels, but {whose} "
                        f"{rows}×{columns}: it is of another camera or setting, or was cut. "
                        f"{_AGAIN}"
                    )

    def _check_light(self, entries: list[PsfEntry], frames: list[Frame]) -> None:
        """Refuse a PSF that is brighter or darker than those of its kind and size let expect."""
        groups: dict[tuple[PsfKind, tuple[int, int]], dict[PsfEntry, float]] = {}
        for entry, frame in zip(entries, frames, strict=True):
            light = float(frame.counts.sum(dtype=torch.float64))
            groups.setdefault((entry.kind, frame.size), {})[entry] = light
        for alike in groups.values():
            if len(alike) == 1:
                continue
            odd = odd_light([each.cosine for each in alike], [*alike.values()])
            if odd is not None:
                entry, light = [*alike.items()][odd[0]]
                raise DataError(
                    f"{self.path / entry.file} has {odd[1]:.3g} times the light that the "
                    f"other PSFs of {entry.distance} let expect at its angle (its values "
                    f"sum up to {light:.4g}, expected {light / odd[1]:.4g}): it is of "
                    f"another exposure, light or camera. {_AGAIN}"
                )

    def _sensor_of(self, pixel: Length) -> tuple[int, int] | None:
        """Rows and columns of the described sensor in pixels of a pitch, if it is its PSFs'."""
        sensor = self._described.sensor
        if not _alike(pixel.um, sensor.superpixel * sensor.pitch.um):
            return None
        return sensor.rows // sensor.superpixel, sensor.columns // sensor.superpixel

    def coverage_warnings(
        self,
        field_psf: FieldPsf | None,
        support: PixelRectangle | None,
        sensor: tuple[int, int],
        merged: int,
        stated: str = "",
    ) -> list[str]:
        """Warn of a scene that goes on far beyond the PSFs over the field (`coverage_warnings`).

        Parameters
        ----------
        field_psf
            PSFs of this folder, on a measurement's pixels; None of a single one.
        support
            Of the scene; None takes the sensor's frame.
        sensor
            (height, width) of the measurement.
        merged
            Pixels of the folder's PSFs along one of the measurement's.
        stated
            Options that ask for this scene or these PSFs.

        Raises
        ------
        OptionError
            If a scene that was asked for goes on far beyond them.
        """
        if field_psf is None:
            return []
        scene = support or PixelRectangle(0, 0, *sensor)
        pixel_um = merged * self.psfs[0].pixel.um
        return coverage_warnings(
            field_psf.places, scene, sensor, pixel_um, self._described_layers, stated
        )

    @cached_property
    def _described(self) -> Camera:
        """Its camera, whose other files are not read."""
        return read_description(self.path / CAMERA_FILE)

    @property
    def _described_layers(self) -> Layers:
        return Layers.of_camera(self._described)

    def _place(self, entry: PsfEntry) -> tuple[float, float]:
        """Row and column from the sensor's middle to where a PSF's chief ray falls."""
        right, up = self._described_layers.shift_um(entry.angle)
        return -up / entry.pixel.um, right / entry.pixel.um

    def captured_ahead(self, distance: Distance | None) -> PsfEntry:
        """The captured PSF of a source straight ahead; without a distance, the only one.

        Raises
        ------
        NolensError
            If there is none, or several.
        """
        ahead = self.ahead("captured")
        have = ", ".join(str(each.distance) for each in ahead)
        if distance is None and len(ahead) > 1:
            raise OptionError(
                f"{self.path} has captured PSFs of several distances ({have}): say which is "
                "nearest to the pictures' (--distance)"
            )
        for each in ahead:
            if distance in (None, each.distance):
                return each
        raise OptionError(
            f"--distance {distance}: {self.path} has captured PSFs of {have}; choose one"
        )

    def nearest(
        self, measured: list[PsfEntry], distance: Distance, source: Distance | None
    ) -> PsfEntry:
        """The measured PSF that one of another distance is made of.

        Parameters
        ----------
        measured
            Those that there are.
        distance
            Of the new one.
        source
            Of the measured one; None takes the nearest, in 1/z.

        Raises
        ------
        OptionError
            If the distance was measured itself, or the source was not.
        """
        if any(each.distance == distance for each in measured):
            raise OptionError(
                f"the PSF of {distance} is in {self.path} already, and was measured: leave "
                f"--at {distance} out"
            )
        if source is not None:
            for each in measured:
                if each.distance == source:
                    return each
            have = ", ".join(str(each.distance) for each in measured)
            raise OptionError(f"--from {source}: measured PSFs are there for {have}")
        nearness = 1 / distance.um if isinstance(distance, Length) else 0.0
        return min(measured, key=lambda each: abs(1 / each.distance_um - nearness))

    def at_angles(self, distance: Distance | None) -> list[PsfEntry]:
        """Captured PSFs of one distance at several angles, one of them from straight ahead.

        Without a distance, those of the only one that has any from the side.

        Raises
        ------
        NolensError
            If that is not clear, one from straight ahead or from the side is missing, or one was
            moved.
        """
        captured = [each for each in read_psf_set(self.path).psf if each.kind == "captured"]
        distance = distance or self._distance_aside(captured)
        entries = [each for each in captured if each.distance == distance]
        if not entries:
            have = ", ".join(sorted({str(each.distance) for each in captured})) or "no distance"
            raise OptionError(
                f"--distance {distance}: {self.path} has captured PSFs of {have}; choose one"
            )
        if not any(each.on_axis for each in entries):
            raise DataError(
                f"{self.path} has no captured PSF of a light straight ahead at {distance}, which "
                "all others are laid on: add it with nolens calibrate FRAME... --distance "
                f"{str(distance).replace(' ', '')} -o {self.path}"
            )
        if len(entries) == 1:
            raise DataError(
                f"{self.path} has only the PSF of a light straight ahead at {distance}: capture "
                f"others at angles (nolens calibrate FRAME... --angle 28deg,0deg). {_PLAN}"
            )
        for each in entries:
            if not each.on_axis and each.frame != "sensor":
                raise DataError(
                    f"{each.file} was moved to the middle, and what the sensor captured at its "
                    "edges is lost: calibrate its frames again, so that it stays as captured "
                    '(frame = "sensor")'
                )
        return entries

    def _distance_aside(self, captured: list[PsfEntry]) -> Distance:
        """The only distance with lights from the side."""
        aside = {each.distance for each in captured if not each.on_axis}
        if not aside:
            raise DataError(
                f"{self.path} has no captured PSF of a light from the side: add some (nolens "
                f"calibrate FRAME... --angle 28deg,0deg). {_PLAN}"
            )
        if len(aside) > 1:
            have = ", ".join(sorted(str(each) for each in aside))
            raise OptionError(
                f"{self.path} has PSFs at angles of several distances ({have}): say which "
                "(--distance)"
            )
        return aside.pop()

    @property
    def sensor_size(self) -> tuple[int, int] | None:
        """Rows and columns of a captured PSF: the camera's, or those of the PSFs there are.

        None where neither is there.
        """
        if self.camera is not None:
            sensor = self.camera.camera.sensor
            return sensor.rows // sensor.superpixel, sensor.columns // sensor.superpixel
        captured = [each for each in self.psfs if each.kind == "captured"]
        if not captured:
            return None
        rows, columns = read_psf(self.path, captured[0]).shape[-2:]
        return rows, columns

    def reference(
        self, entry: PsfEntry, size: tuple[int, int], new: Mapping[PsfEntry, Tensor] | None = None
    ) -> ReferencePsf | None:
        """The PSF of another distance that a new one is laid over: the nearest straight ahead.

        `new` has PSFs that are not in the folder yet, but will be.

        Raises
        ------
        DataError
            If the captured PSFs of the folder have another size.
        """

        def of_other_distance(other: PsfEntry) -> bool:
            ahead = other.on_axis and other.frame == "chief-ray"
            return ahead and other.distance != entry.distance

        new = new or {}
        captured = [each for each in (*self.psfs, *new) if each.kind == "captured"]
        if not captured:
            return None
        nearest = min(
            captured,
            key=lambda each: (
                not of_other_distance(each),
                abs(1e6 / each.distance_um - 1e6 / entry.distance_um),
            ),
        )
        path = self.path / nearest.file
        psf = new[nearest] if nearest in new else read_psf(self.path, nearest)
        if psf.shape[-2:] != size:
            raise DataError(
                f"the PSF {path} has {psf.shape[-2]}×{psf.shape[-1]} pixels, but these frames "
                f"{size[0]}×{size[1]}: they are of another camera or setting. Give another folder "
                "(-o)"
            )
        return ReferencePsf(psf, nearest, str(path)) if of_other_distance(nearest) else None

    def check_channels(self, channels: tuple[str, ...], remedy: str = "") -> None:
        """Refuse a PSF whose channels are not those of the folder's.

        Raises
        ------
        OptionError
            If they are not.
        """
        first = self.psfs[0] if self.psfs else None
        if first is not None and first.channels != channels:
            raise OptionError(
                f"the PSF {first.file} of the folder has the channels {', '.join(first.channels)}, "
                f"but this one would have {', '.join(channels)}: give another folder (-o){remedy}"
            )

    def pixel(self, frame: Frame, pitch: Length | None) -> Length:
        """Pitch of the pixels of the reconstruction: of a frame's pixels, or 2×2 superpixels.

        The camera, or PSFs of it, say it, or the stated pitch of the frame's pixels.

        Raises
        ------
        NolensError
            If nothing says it, or the frame's size or pixels are not the camera's.
        """
        if self.camera is not None:
            pixel_of_camera(frame, self.camera)
        return self.pitch(pitch, 1 if frame.mosaic is None else 2)

    def pitch(self, pitch: Length | None, merged: int) -> Length:
        """Pitch of the pixels of a PSF, each of so many pixels of its file along a side.

        The camera, or PSFs of it, say it, or the stated pitch of the file's pixels.

        Raises
        ------
        NolensError
            If nothing says it, or not all say the same.
        """
        first = self.psfs[0] if self.psfs else None
        stated = None if pitch is None else _times(pitch, merged)
        known: Length | None = None
        if self.camera is not None:
            known = _superpixel(self.camera)
            named = f"the camera {self.camera.camera.name!r}"
        elif first is not None:
            known, named = first.pixel, f"the PSF {first.file}"
        pixel = known or stated
        if pixel is None:
            raise OptionError(
                "the distance of the pixels is not known: give it (--pixel 1.55um), or the folder "
                "of a camera, with its camera.toml (-o)"
            )
        if stated is not None and known is not None and stated != known:
            given = "not" if merged == 1 else f"but {merged} of its pixels are"
            raise OptionError(
                f"--pixel {pitch}: a pixel of {named} is {known} wide, {given} {stated}; "
                "leave --pixel out, or give another folder (-o)"
            )
        if first is not None and first.pixel != pixel:
            raise DataError(
                f"the PSF {first.file} of the folder has pixels of {first.pixel}, but these "
                f"frames {pixel}: they are of another camera. Give another folder (-o)"
            )
        return pixel

    def pixel_of(self, name: str, pitch: Length | None) -> Length:
        """Distance of the pixels of one of its files, as it is stated or listed.

        Raises
        ------
        OptionError
            If it is neither, or both and they differ.
        """
        listed = next((each.pixel for each in self.psfs if each.file == name), None)
        if pitch is not None and listed is not None and not _alike(pitch.um, listed.um):
            raise OptionError(
                f"--pixel {pitch}, but {self.path / PSFS_FILE} says that the pixels of {name} are "
                f"{listed} apart: leave --pixel out, or calibrate again"
            )
        pixel = listed if pitch is None else pitch
        if pixel is None:
            raise OptionError(
                f"no pitch of the pixels of {self.path / name} is known: give --pixel with its "
                "unit, such as --pixel 3.1um"
            )
        return pixel


def check_pitch(pixel: Length, frame: Frame, loaded: LoadedCamera) -> None:
    """Refuse a pitch that is not that of the camera's sensor, or of whole numbers of its pixels.

    Raises
    ------
    OptionError
        If it is not.
    """
    sensor = loaded.camera.sensor
    ratio = pixel.um / sensor.pitch.um
    rows, columns = frame.counts.shape[-2:]
    binned = max(1, round(ratio))
    fitting = sensor.rows // rows
    whole = fitting >= 1 and (sensor.rows // fitting, sensor.columns // fitting) == (rows, columns)
    expected = fitting if whole else 1 if frame.mosaic is not None else binned
    if not _alike(ratio, expected):
        raise OptionError(
            f"--pixel {pixel.um:g} µm does not fit the camera {loaded.camera.name!r}, whose "
            f"{sensor.rows}×{sensor.columns} pixels are {sensor.pitch} apart: those of a file of "
            f"{rows}×{columns} would be {expected * sensor.pitch.um:g} µm. Give that, or another "
            "--camera"
        )


def _alike(one: float, other: float) -> bool:
    return math.isclose(one, other, rel_tol=_CLOSE)


def pixel_of_camera(frame: Frame, loaded: LoadedCamera) -> Length:
    """Pitch of a camera's pixels or superpixels; a frame that is not of it is refused.

    Raises
    ------
    DataError
        If the frame has another size or mosaic than the camera.
    """
    sensor = loaded.camera.sensor
    bin_by = sensor.superpixel
    if frame.mosaic is None and frame.channels == ("R", "G", "B") and bin_by == 2:
        size, what = (sensor.rows // 2, sensor.columns // 2), "superpixels"
    else:
        size, what = (sensor.rows, sensor.columns), "pixels"
    if tuple(frame.counts.shape[-2:]) != size:
        raise DataError(
            f"{frame.source} has {frame.size_text} pixels, but the camera "
            f"{loaded.camera.name!r} has {size[0]}×{size[1]} {what}: give frames of this "
            "camera, whole and not binned"
        )
    if frame.mosaic is not None and frame.mosaic != sensor.mosaic:
        raise DataError(
            f"{frame.source} has the colour mosaic {frame.mosaic}, but the camera "
            f"{loaded.camera.name!r} has {sensor.mosaic}: give frames of this camera, not turned"
        )
    return _superpixel(loaded)


def _superpixel(loaded: LoadedCamera) -> Length:
    """Pitch of the pixels of a camera's PSFs."""
    sensor = loaded.camera.sensor
    return _times(sensor.pitch, sensor.superpixel)


def _times(length: Length, factor: int) -> Length:
    return Length(f"{(Decimal(length.number) * factor).normalize():f}", length.unit)
