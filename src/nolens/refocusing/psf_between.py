"""The PSF of any depth from those of a few, and the distance of mask and sensor behind it."""

import math
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Self

import torch
from torch import Tensor

from nolens.calibrate.distances import Layers
from nolens.calibrate.registration import register
from nolens.camera import (
    Camera,
    FieldPsf,
    Frame,
    Measurement,
    PsfEntry,
    PsfGeometry,
    develop,
    prepare_psf,
)
from nolens.camera.measurement import bin_mean
from nolens.camera.psf import edge_warning
from nolens.errors import DataError, OptionError
from nolens.optics.magnification import covered, magnified
from nolens.refocusing.depth import (
    depth_mm,
    depth_of_focus_per_m,
    depth_um,
    line_pixels,
    lit_pixels,
    per_m,
)

_LARGEST_UM = 20e3
"""Reduced distance of mask and sensor beyond which none is sought."""
_LEAST_LINES = 0.25
"""Lines by which the edge must move between two PSFs for them to tell the magnification."""
_LEAST_ALIKE = 0.7
"""Correlation of neighbours below which they are too unlike to be blended."""
_NAMED = 3
"""Depths of a gap that a message names."""
_OF_THE_SENSOR = ("captured", "solved")
"""Kinds of PSFs that are as large as the sensor's frame."""


@dataclass(frozen=True)
class PsfAt:
    """A PSF and the distance of its point source.

    Parameters
    ----------
    psf
        (channels, rows, columns); zero shift is the pixel (rows // 2, columns // 2).
    distance_um
        May be infinite.
    """

    psf: Tensor
    distance_um: float

    def depth_of_focus_per_m(self, reduced_um: float, sensor: tuple[int, int]) -> float:
        """`nolens.refocusing.depth_of_focus_per_m` on a sensor of (rows, columns) in its pixels."""
        return depth_of_focus_per_m(line_pixels(self.psf), reduced_um, lit_pixels(self.psf, sensor))


@dataclass(frozen=True)
class PsfBetween:
    """PSFs at some distances, and what leads from one to another.

    Parameters
    ----------
    known
        The farthest first.
    reduced_um
        Reduced distance D of mask and sensor: a source at z magnifies the PSF by 1 + D/z.
    moved
        Pixels by which each is moved down and to the right against the first one.
    brightness
        Of each, beside the first one.
    alike
        Correlation of each with the next one, once it is magnified to its distance.
    """

    known: tuple[PsfAt, ...]
    reduced_um: float
    moved: tuple[tuple[float, float], ...]
    brightness: tuple[float, ...]
    alike: tuple[float, ...]

    @classmethod
    def of(cls, known: Sequence[PsfAt], reduced_um: float) -> Self:
        """Bring PSFs into one place and to one brightness.

        Parameters
        ----------
        known
            Of one camera, alike in shape, each at its own distance.
        reduced_um
            D; `measured_reduced_um` finds it.
        """
        ordered = tuple(sorted(known, key=lambda each: -each.distance_um))
        moved, brightness, alike = [(0.0, 0.0)], [1.0], []
        for one, two in pairwise(ordered):
            factor = _factor(reduced_um, one.distance_um, two.distance_um)
            place = register(two.psf, one.psf, magnification=factor)
            here = moved[-1]
            moved.append((here[0] + place.shift[0], here[1] + place.shift[1]))
            size = (one.psf.shape[-2], one.psf.shape[-1])
            both = covered(size, factor, moved=place.shift)
            larger = magnified(one.psf, factor, moved=place.shift)
            larger, target = (each.mean(dim=0)[both].double() for each in (larger, two.psf))
            brightness.append(brightness[-1] * float(target.sum() / larger.sum()))
            alike.append(float(torch.corrcoef(torch.stack([larger, target]))[0, 1]))
        return cls(ordered, reduced_um, tuple(moved), tuple(brightness), tuple(alike))

    def at(self, depth_um: float) -> Tensor:
        r"""The PSF of a depth: its neighbours, magnified to it and blended linearly in 1/z.

        Beyond the ends the last one is magnified: :math:`M = (1 + D/z) / (1 + D/z_i)`.

        Parameters
        ----------
        depth_um
            May be infinite.
        """
        places = [per_m(each.distance_um) for each in self.known]
        place = per_m(depth_um)
        upper = bisect_left(places, place)
        if upper in (0, len(places)) or places[upper] == place:
            return self._from(min(upper, len(places) - 1), depth_um)[0]
        fraction = (place - places[upper - 1]) / (places[upper] - places[upper - 1])
        one, one_covers = self._from(upper - 1, depth_um)
        two, two_covers = self._from(upper, depth_um)
        weights = (1 - fraction) * one_covers, fraction * two_covers
        return (weights[0] * one + weights[1] * two) / (weights[0] + weights[1]).clamp_min(1e-9)

    @property
    def warnings(self) -> list[str]:
        """About neighbours too unlike to be blended."""
        return [
            f"the depth set has a gap: {self._unlike(number)}, so depths between them come out "
            "worse: calibrate one between"
            for number, alike in enumerate(self.alike)
            if alike < _LEAST_ALIKE
        ]

    def check(self, depths_um: Sequence[float], focus_per_m: float, stated: str) -> None:
        """Refuse depths whose PSFs cannot be made of the neighbours, which are too unlike.

        Beyond an end, PSFs are magnified as between the last two: if that does not make one of
        these of the other, it makes none beyond.

        Parameters
        ----------
        depths_um
            That are asked for.
        focus_per_m
            Depth of focus, within which a depth has the PSF of a known one.
        stated
            What asks for them, for the message.

        Raises
        ------
        OptionError
            If there is such a depth.
        """
        places = [per_m(each.distance_um) for each in self.known]
        gaps: dict[int, list[float]] = {}
        for depth in depths_um:
            place = per_m(depth)
            if min(abs(place - each) for each in places) <= focus_per_m or not self.alike:
                continue
            number = min(max(bisect_left(places, place) - 1, 0), len(self.alike) - 1)
            if self.alike[number] < _LEAST_ALIKE:
                gaps.setdefault(number, []).append(depth)
        if not gaps:
            return
        texts = []
        for number, depths in gaps.items():
            named = ", ".join(_text(each) for each in depths[:_NAMED])
            more = f" and {len(depths) - _NAMED} more" if len(depths) > _NAMED else ""
            texts.append(f"{self._unlike(number)}, so that of {named}{more} cannot be made of them")
        first = next(iter(gaps.values()))
        missing = first[len(first) // 2]
        have = ", ".join(_text(each.distance_um) for each in reversed(self.known))
        raise OptionError(
            f"{stated}: the depth set has a gap: {'; '.join(texts)}. Calibrate one there (nolens "
            f"calibrate FRAME... --distance {_text(missing).replace(' ', '')}), or state depths "
            f"that PSFs are of: {have}"
        )

    def _unlike(self, number: int) -> str:
        """What is said of a PSF and the next nearer one that are too unlike."""
        far, near = (_text(each.distance_um) for each in self.known[number : number + 2])
        alike = 100 * self.alike[number]
        return f"brought to one size, the PSFs of {near} and {far} are alike to {alike:.0f} % only"

    def _from(self, number: int, depth_um: float) -> tuple[Tensor, Tensor]:
        """One of the PSFs magnified to a depth, and the pixels that it covers there."""
        known, shift = self.known[number], self.moved[number]
        factor = _factor(self.reduced_um, known.distance_um, depth_um)
        moved = (-shift[0] * factor if shift[0] else 0.0, -shift[1] * factor if shift[1] else 0.0)
        size = (known.psf.shape[-2], known.psf.shape[-1])
        psf = magnified(known.psf, factor, moved=moved).div_(self.brightness[number])
        return psf, covered(size, factor, moved=moved).float()


@dataclass(frozen=True)
class DepthField:
    """PSFs over the field at some distances, for the depths of one measurement.

    Parameters
    ----------
    known
        By distance; on the measurement's pixels. None where there is the one straight ahead alone.
    layers
        Of the camera: they say how much larger a PSF is at another depth, by its angle.
    pixel_um
        Pitch of the measurement's pixels.
    """

    known: Mapping[float, FieldPsf | None]
    layers: Layers
    pixel_um: float

    def at(self, depth_um: float, ahead: Tensor) -> FieldPsf | None:
        """PSFs over the field of a depth, as bright as the one straight ahead.

        Those of the nearest distance in 1/z, each magnified by the layers at its angle. None where
        that distance has the one straight ahead alone.
        """
        nearest_um = min(self.known, key=lambda each: abs(per_m(each) - per_m(depth_um)))
        field = self.known[nearest_um]
        if field is None:
            return None
        factors = [
            self.layers.magnification(depth_um, shift)
            / self.layers.magnification(nearest_um, shift)
            for shift in (field.places.norm(dim=1) * self.pixel_um).tolist()
        ]
        values = torch.stack(
            [magnified(psf, factor) for psf, factor in zip(field.values, factors, strict=True)]
        )
        field = FieldPsf(values, field.places)
        size = [min(pair) for pair in zip(values.shape[-2:], ahead.shape[-2:], strict=True)]
        bright = [float(_middle(each, size).sum()) for each in (ahead, field.on_axis)]
        return FieldPsf(values * (bright[0] / bright[1]), field.places)


@dataclass(frozen=True)
class DepthPsfs:
    """The PSFs of a camera, for the depths of one measurement.

    Parameters
    ----------
    between
        PSFs on pixels of their own.
    bin_by
        So many of these, along a side, are one pixel of the measurement.
    depth_of_focus_per_m
        See `nolens.refocusing.depth_of_focus_per_m`.
    warnings
        What may make pictures worse than they could be.
    field
        PSFs over the field, where they are known.
    """

    between: PsfBetween
    bin_by: int
    depth_of_focus_per_m: float
    warnings: tuple[str, ...] = ()
    field: DepthField | None = None

    @classmethod
    def of(
        cls,
        known: Sequence[PsfAt],
        reduced_um: float,
        measurement: Measurement,
        bin_by: int = 1,
        warnings: Sequence[str] = (),
    ) -> Self:
        """PSFs, as `PsfBetween.of` takes them, for a measurement that was binned by `bin_by`.

        The depth of focus is the farthest one's, the least magnified: at the sensor's edges a
        near one is cut, and its wider lines would make the depth of focus too large.
        """
        between = PsfBetween.of(known, reduced_um)
        farthest = between.known[0]
        focus = farthest.depth_of_focus_per_m(reduced_um, _unbinned(measurement, bin_by))
        return cls(between, bin_by, focus, (*warnings, *between.warnings))

    @classmethod
    def of_set(
        cls,
        frames: Mapping[PsfEntry, Frame],
        measurement: Measurement,
        camera: Camera | None,
        *,
        where: str,
        bin_by: int,
        channels: str,
    ) -> Self:
        """PSFs of sources straight ahead, checked against a measurement and their camera.

        Where some extend beyond the sensor, only those are used, cut to one size.

        Parameters
        ----------
        frames
            PSFs, the nearest source first.
        measurement
            Developed with the same `bin_by` and `channels`.
        camera
            Description of the camera, where there is one: its layers say how the PSF changes with
            the distance where the PSFs themselves do not.
        where
            The folder of the PSFs, for messages.

        Raises
        ------
        DataError
            If a PSF or the camera does not fit the measurement.
        OptionError
            If nothing says how the PSF changes with the distance.
        """
        nearest = next(iter(frames))
        if camera is not None:
            _check_readout(measurement, camera, nearest, bin_by)
        psfs = [
            PsfAt(_fitting_psf(entry, frame, measurement, bin_by, channels), entry.distance_um)
            for entry, frame in frames.items()
        ]
        wide = [
            each
            for each in psfs
            if tuple(side // bin_by for side in each.psf.shape[-2:]) != measurement.size
        ]
        known = _cut_alike(wide or psfs)
        reduced, warnings = _reduced_distance(known, nearest, camera, where)
        sensor = _unbinned(measurement, bin_by)
        edge = None if wide else edge_warning(nearest.file, known[0].psf, sensor)
        if edge is not None:
            warnings.append(edge)
        return cls.of(known, reduced, measurement, bin_by, warnings)

    @property
    def distances_um(self) -> tuple[float, ...]:
        """The nearest first."""
        return tuple(each.distance_um for each in reversed(self.between.known))

    @property
    def middle_um(self) -> float:
        """Depth halfway between the nearest and the farthest distance, in 1/z."""
        return depth_um((per_m(self.distances_um[0]) + per_m(self.distances_um[-1])) / 2)

    @property
    def line(self) -> float:
        """Width of the farthest PSF's lines, in pixels of the measurement."""
        return line_pixels(self.between.known[0].psf) / self.bin_by

    def at(self, depth_um: float) -> Tensor:
        """PSF of a depth on the measurement's pixels."""
        return bin_mean(self.between.at(depth_um), self.bin_by)

    def field_at(self, depth_um: float) -> FieldPsf | None:
        """PSFs over the field of a depth; None where they are not known (`DepthField.at`)."""
        return None if self.field is None else self.field.at(depth_um, self.at(depth_um))

    def figures(self) -> dict[str, Any]:
        """Depth of focus, reduced distance of mask and sensor, and distances of the PSFs."""
        return {
            "depth_of_focus_per_m": self.depth_of_focus_per_m,
            "mask_to_sensor_um": self.between.reduced_um,
            "psf_distances_mm": [depth_mm(each) for each in self.distances_um],
        }

    def check_depths(self, depths_um: Sequence[float], stated: str) -> None:
        """Refuse depths that are asked for in a gap of the depth set (`PsfBetween.check`).

        Raises
        ------
        OptionError
            If there is one.
        """
        self.between.check(depths_um, self.depth_of_focus_per_m, stated)

    def depth_warnings(
        self, depths_um: Sequence[float], search_um: tuple[float, float] | None
    ) -> list[str]:
        """About depths that are asked for, and about those between which one is sought."""
        texts = []
        focus, distances = self.depth_of_focus_per_m, self.distances_um
        if search_um is not None:
            depths_um = (*search_um, *depths_um)
            if per_m(search_um[0]) - per_m(search_um[1]) < focus:
                texts.append(
                    f"all depths that are looked at lie within one depth of focus ({focus:.3g}/m "
                    "in 1/z): they look alike, and which one is found means little"
                )
        least, most = per_m(distances[-1]), per_m(distances[0])
        if not all(least - focus <= per_m(each) <= most + focus for each in depths_um):
            have = " to ".join(
                f"{depth_mm(each)} mm" if math.isfinite(each) else "infinity"
                for each in dict.fromkeys((distances[0], distances[-1]))
            )
            texts.append(
                f"the PSFs are of {have}; beyond, they are magnified as rays are, which leaves out "
                "what the distance does to the mask's focus: calibrate at such a distance for more"
            )
        return texts


def _middle(psf: Tensor, size: Sequence[int]) -> Tensor:
    """Its part around the zero shift."""
    starts = [side // 2 - n // 2 for side, n in zip(psf.shape[-2:], size, strict=True)]
    return psf[..., starts[0] : starts[0] + size[0], starts[1] : starts[1] + size[1]]


def _unbinned(measurement: Measurement, bin_by: int) -> tuple[int, int]:
    return measurement.size[0] * bin_by, measurement.size[1] * bin_by


def _check_readout(measurement: Measurement, camera: Camera, entry: PsfEntry, bin_by: int) -> None:
    """Refuse a photograph that was read out in another way than the PSFs."""
    pixels = round(entry.pixel.um / camera.sensor.pitch.um)
    sides = camera.sensor.rows, camera.sensor.columns
    rows, columns = (count // max(1, pixels) // bin_by for count in sides)
    if measurement.size != (rows, columns):
        raise DataError(
            f"{measurement.source} has {measurement.size_text} pixels, but the sensor of the "
            f"camera {camera.name!r} has {rows}×{columns} of the PSFs' {entry.pixel}: give a "
            "photograph that was read out like the PSFs, uncut"
        )


def _fitting_psf(
    entry: PsfEntry, frame: Frame, measurement: Measurement, bin_by: int, channels: str
) -> Tensor:
    """A PSF on the pixels of its file, in the measurement's channels; checked against it."""
    if len(entry.channels) == 1:
        channels = "all"
    psf = develop(frame, bin_by=bin_by, channels=channels)
    extended = psf.size != measurement.size
    if extended and entry.kind in _OF_THE_SENSOR:
        raise DataError(
            f"the PSF {frame.source} was {entry.kind} with {psf.size_text} pixels, but the "
            f"measurement {measurement.source} has {measurement.size_text}: give a photograph that "
            "was read out like the PSFs"
        )
    prepare_psf(psf, measurement, PsfGeometry(extended=extended))
    return develop(frame, channels=channels).values


def _cut_alike(psfs: Sequence[PsfAt]) -> list[PsfAt]:
    """PSFs cut to the size that all of them have; the zero shift stays in the middle."""
    rows, columns = (min(each.psf.shape[axis] for each in psfs) for axis in (-2, -1))

    def middle(psf: Tensor) -> Tensor:
        top, left = psf.shape[-2] // 2 - rows // 2, psf.shape[-1] // 2 - columns // 2
        return psf[..., top : top + rows, left : left + columns]

    return [replace(each, psf=middle(each.psf)) for each in psfs]


def _reduced_distance(
    known: Sequence[PsfAt], entry: PsfEntry, camera: Camera | None, where: str
) -> tuple[float, list[str]]:
    """Reduced distance of mask and sensor, and a warning where camera and PSFs disagree."""
    measured = measured_reduced_um(known)
    described = None if camera is None else reduced_um(camera, camera.mask.surface)
    if measured is None and described is None:
        one = len({each.distance_um for each in known}) == 1
        have = f"is one PSF only, of {entry.distance}" if one else "are PSFs as large as each other"
        raise OptionError(
            f"in {where} there {have}, and nothing says how it changes with the distance: "
            "calibrate a second, much nearer one, or put the camera's camera.toml there"
        )
    if measured is None or (described is not None and _explained_by(described, known, measured)):
        assert described is not None
        return described, []
    if described is None:
        return measured, []
    return measured, [
        f"the PSFs change with the distance as if mask and sensor were {measured * 1e-3:.3g} mm "
        f"apart (in air), but by camera.toml it is {described * 1e-3:.3g} mm: the PSFs' is "
        "taken; check the distances they were taken at"
    ]


def measured_reduced_um(known: Sequence[PsfAt]) -> float | None:
    """D from how much larger the nearest source's PSF is than the farthest one's.

    Parameters
    ----------
    known
        PSFs of one camera, alike in shape.

    Returns
    -------
    float or None
        None where there is one distance only, or the sizes are too alike to tell.

    Raises
    ------
    DataError
        If the sizes differ by more than the distances do.
    """
    near = min(known, key=lambda each: each.distance_um)
    far = max(known, key=lambda each: each.distance_um)
    if near.distance_um == far.distance_um:
        return None
    line = line_pixels(far.psf)
    largest = _factor(_LARGEST_UM, far.distance_um, near.distance_um)
    factor = register(near.psf, far.psf, magnification=(1.0, largest)).magnification
    if (factor - 1) * max(far.psf.shape[-2:]) / 2 < _LEAST_LINES * line:
        return None
    difference = per_m(near.distance_um) - factor * per_m(far.distance_um)
    if not difference > 0:
        raise DataError(
            f"from {far.distance_um * 1e-3:.4g} to {near.distance_um * 1e-3:.4g} mm the PSF "
            f"becomes {factor:.4g} times as large, more than the PSF of any camera: check the "
            "distances that the PSFs were taken at, and that they show more than noise (nolens "
            "measure psf)"
        )
    return 1e6 * (factor - 1) / difference


def _explained_by(reduced_um: float, known: Sequence[PsfAt], measured_um: float) -> bool:
    """Whether the sizes of PSFs follow from a reduced distance beside the one measured on them.

    They do where the edge of the nearest PSF differs by less than a quarter of a line.
    """
    places = [per_m(each.distance_um) for each in known]
    psf = known[0].psf
    difference = abs(measured_um - reduced_um) * 1e-6 * (max(places) - min(places))
    return difference * max(psf.shape[-2:]) / 2 < _LEAST_LINES * line_pixels(psf)


def reduced_um(camera: Camera, first: int) -> float:
    """Σ thickness / index of a camera's layers from one of them down to the sensor, at 550 nm.

    Times the index of the space that the scene is in: a source at z has its image at z / n.
    """
    layers = zip(camera.layers[first:], camera.indices(550.0)[first:], strict=True)
    return camera.outside * sum(layer.thickness.um / index for layer, index in layers)


def _text(depth_um: float) -> str:
    return "infinity" if math.isinf(depth_um) else f"{depth_um * 1e-3:.4g} mm"


def _factor(reduced_um: float, from_um: float, to_um: float) -> float:
    return (1 + reduced_um / to_um) / (1 + reduced_um / from_um)
