"""How a PSF's file is to be read: finer, extended, mirrored, with a black level; by the data.

Candidates are tried on a coarse grid, and judged by how well the scene that each one gives predicts
sensor pixels that were left out of the fit (`Reconstructor.predict`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import torch.nn.functional as nnf
from torch import Tensor

from nolens.amounts import percent
from nolens.camera import Flip, Frame, Measurement, PsfGeometry, dark_corner, prepare_psf
from nolens.camera.psf import black_is_known, sizes_text
from nolens.errors import DataError
from nolens.solvers.development import Development
from nolens.solvers.held_out import Prediction
from nolens.solvers.reconstructor import Reconstructor

Extent = Literal["auto", "sensor", "wide"]

_BEYOND = 2
"""Times the sensor, of which a PSF is tried."""
_MISSED = 0.15
"""Of the measurement beside its noise: where a PSF misses more, its mirror images are tried."""
_PART_MISSED = 0.5
"""Where a PSF of which parts were cut off misses more, it is not one."""
_AS_DARK = 0.9
"""Of a black level, what nearly all pixels of a frame that has it reach."""
_DARKEST = 0.01
"""Fraction of the pixels that need not."""
_FAINT = 0.02
"""Of a PSF's peak: light alone leaves 1 % of the pixels darker than that."""
_SAMPLES = 1_000_000
_MOST_FINER = 4
"""Times that an extended PSF is tried to be finer, where its sizes do not tell."""
_MIRRORED: tuple[Flip, ...] = ("horizontal", "vertical", "both")
_FLIPS: dict[Flip, str] = {
    "none": "",
    "horizontal": "mirrored left to right (--psf-flip horizontal)",
    "vertical": "upside down (--psf-flip vertical)",
    "both": "rotated by 180° (--psf-flip both)",
}


@dataclass(frozen=True)
class PsfSettings:
    """What is said of a PSF's file; the rest is chosen.

    Parameters
    ----------
    scale
        Pixels of the PSF along one of the measurement; None is chosen.
    extent
        ``"sensor"`` where all of a larger file is the sensor, ``"wide"`` where it goes on beyond.
    flip
        How the PSF is to be turned over.
    """

    scale: int | None = None
    extent: Extent = "auto"
    flip: Flip | Literal["auto"] = "auto"


@dataclass(frozen=True)
class PsfTrial:
    """A way to read a PSF's file, and how well it explains the measurement.

    Parameters
    ----------
    development
        With that geometry and black level.
    prediction
        Of the pixels that were left out.
    """

    development: Development
    prediction: Prediction

    @property
    def geometry(self) -> PsfGeometry:
        """How the PSF's pixels lie on the measurement's."""
        return self.development.psf_geometry

    def row(self) -> dict[str, Any]:
        """A row of the run's record."""
        return {
            **geometry_row(self.geometry),
            "black": self.development.black,
            "psf_black": list(self.development.psf.black),
            "unexplained": self.prediction.unexplained,
            "unexplained_by_noise": self.prediction.unexplained_by_noise,
        }


@dataclass(frozen=True)
class PsfChoice:
    """How a PSF's file is read.

    Parameters
    ----------
    development
        With the geometry and the black level.
    notes
        Sentences that say what was chosen, and why.
    trials
        What was tried.
    """

    development: Development
    notes: tuple[str, ...] = ()
    trials: tuple[PsfTrial, ...] = ()


def geometry_row(geometry: PsfGeometry) -> dict[str, Any]:
    """A geometry in values that JSON has."""
    return {
        "scale": geometry.scale or 1,
        "extended": geometry.extended,
        "partial": geometry.partial,
        "flip": geometry.flip,
    }


def choose_psf(
    development: Development, frame: Frame, settings: PsfSettings | None = None
) -> PsfChoice:
    """Choose how a PSF's file is read for a measurement.

    Sizes leave one geometry or a few; a file of ours says its own (`Frame.sensor`), unless the
    measurement is clearly one of the sensor's middle, and not of merged pixels. One of the sensor's
    size is tried once, and mirrored where it explains the measurement badly. A black level that
    nobody states, and the PSF's corners have, is subtracted where that predicts better.

    Parameters
    ----------
    development
        Of the camera's frames.
    frame
        The measurement.
    settings
        What a person says of the PSF; None leaves all of it to the data.

    Raises
    ------
    DataError
        If the PSF does not fit the measurement, or two ways to read it explain it alike.
    """
    settings = PsfSettings() if settings is None else settings
    measurement = development.measurement(frame)
    psf = development.developed_psf(measurement)
    noted = _noted_scale(development, measurement, psf.size, settings)
    geometries = _geometries(psf.size, measurement.size, settings, noted)
    levels = [
        _Level.of(each, frame) if each is not development else _Level(development, measurement, psf)
        for each in _black_levels(development, psf, frame)
    ]
    mirrored = settings.flip == "auto" and noted is None
    part = geometries[0].partial and noted is None and settings.scale is None
    doubtful = len(geometries) > 1 or part
    middle = []  # One of the sensor's middle has the size of one of merged pixels.
    if noted is not None and noted > 1 and settings.extent != "sensor":
        middle = _geometries(psf.size, measurement.size, replace(settings, scale=1), None)
    trials: list[PsfTrial] = []
    if doubtful or mirrored or middle or len(levels) > 1:
        trials = _tried(levels, [*geometries, *middle])
    if trials and min(each.prediction.missed for each in trials) > _MISSED:
        further = [] if noted is not None else _finer_extended(psf.size, measurement.size, settings)
        trials += _tried(levels, further)
        if mirrored:
            turned = [replace(each, flip=flip) for each in geometries for flip in _MIRRORED]
            trials += _tried(levels, turned)
    best = _best(trials, len(geometries), psf, measurement) if trials else None
    if doubtful and best is None:
        prepare_psf(psf, measurement)  # Says what sizes would fit.
    if best is not None and part and best.prediction.missed > _PART_MISSED:
        raise DataError(
            f"{sizes_text(psf, measurement)}: as a part of a PSF, dark around it (--psf-scale 1), "
            f"it leaves {_percent(best)} of the contrast unexplained, so it was binned, or is "
            "another camera's. Use files of one size (the same --bin and the same cut)"
        )
    chosen = replace(development, psf_geometry=geometries[0]) if best is None else best.development
    notes = []
    if chosen.psf_geometry != _geometry_stated(settings):
        notes.append(_geometry_note(chosen, best, trials, noted))
    if chosen.black != development.black:
        notes.append(
            f"neither {frame.source} nor the PSF {psf.source} states a black level: "
            f"{chosen.black:g} counts, read off the PSF's darkest pixels, are subtracted from both "
            "(--black 0 keeps them)"
        )
    if chosen.psf.black != development.psf.black:
        notes.append(
            f"the PSF {psf.source} states no black level: {chosen.psf.black[0]:g} counts, read off "
            "its darkest pixels, are subtracted from it (--black 0 keeps them)"
        )
    return PsfChoice(chosen, tuple(notes), tuple(trials))


def _noted_scale(
    development: Development, measurement: Measurement, have: tuple[int, int], settings: PsfSettings
) -> int | None:
    """Pixels of the PSF along one of the measurement, where its file says the sensor's size."""
    if development.psf.sensor is None or settings.scale is not None:
        return None
    rows, columns = (count // development.bin_by for count in development.psf.sensor)
    scale = max(1, rows // measurement.size[0])
    finer = have[0] // scale, have[1] // scale
    if (rows // scale, columns // scale) != measurement.size:
        return None
    return None if settings.extent == "wide" and finer == measurement.size else scale


def _geometries(
    have: tuple[int, int], need: tuple[int, int], settings: PsfSettings, noted: int | None
) -> list[PsfGeometry]:
    """Geometries that sizes (height, width) allow; one at the least."""
    larger = all(mine > its for mine, its in zip(have, need, strict=True))
    stated = settings.scale if noted is None else noted
    if stated is not None:
        scales = [stated]
    else:
        finer = {mine // its for mine, its in zip(have, need, strict=True)} - {1}
        wide = settings.extent == "wide" or not larger
        scales = [1] if wide else [1, *sorted(each for each in finer if _fills(have, need, each))]
    flip: Flip = "none" if settings.flip == "auto" else settings.flip
    made = [
        _geometry(have, need, each, flip, extended=settings.extent == "wide") for each in scales
    ]
    if settings.extent == "sensor" and noted is None:
        made = [each for each in made if not each.extended]
    return made or [PsfGeometry(settings.scale, flip=flip)]


def _finer_extended(
    have: tuple[int, int], need: tuple[int, int], settings: PsfSettings
) -> list[PsfGeometry]:
    """Geometries of a PSF that is finer, and still larger than the measurement."""
    if settings.scale is not None or settings.extent == "sensor":
        return []
    most = min(min(mine // its for mine, its in zip(have, need, strict=True)), _MOST_FINER)
    return [
        replace(_geometries(have, need, replace(settings, scale=scale), None)[0], extended=True)
        for scale in range(2, most + 1)
        if not _fills(have, need, scale)
    ]


def _fills(have: tuple[int, int], need: tuple[int, int], scale: int) -> bool:
    """Whether a finer PSF is as large as the measurement in one direction or both."""
    return any(mine // scale == its for mine, its in zip(have, need, strict=True))


def _geometry(
    have: tuple[int, int], need: tuple[int, int], scale: int, flip: Flip, *, extended: bool
) -> PsfGeometry:
    """The geometry of one scale; sizes that do not fit it are refused later (`prepare_psf`)."""
    rows, columns = (mine // scale - its for mine, its in zip(have, need, strict=True))
    beyond = min(rows, columns) >= 0 and max(rows, columns) > 0
    if scale == 1:
        whole = have == need[::-1] or min(rows, columns) == 0
        return PsfGeometry(
            extended=extended or (beyond and min(rows, columns) > 0),
            partial=not whole and max(rows, columns) < 0,
            flip=flip,
        )
    return PsfGeometry(
        scale,
        extended=extended or beyond,
        partial=not extended and min(rows, columns) < 0 <= max(rows, columns),
        flip=flip,
    )


def _black_levels(development: Development, psf: Measurement, frame: Frame) -> list[Development]:
    """As it is; and without the black level that a PSF seems to have, if nobody states one."""
    if development.black is not None or black_is_known(psf, psf.values):
        return [development]
    level, darkest = dark_corner(development.psf), _darkest(development.psf)
    if darkest < _FAINT * float(development.psf.counts.max()):
        return [development]
    if darkest < _AS_DARK * level:
        level = round(darkest)  # Light falls in the corners.
    unstated = not (frame.black_stated or development.dark is not None)
    if unstated and _darkest(frame) >= _AS_DARK * level:
        return [development, replace(development, black=level)]
    point = replace(development.psf, black=(level,), black_stated=True)
    return [development, replace(development, psf=point)]


def _darkest(frame: Frame) -> float:
    """Count that nearly all pixels reach: light alone leaves darker ones, noise few."""
    counts = frame.counts.flatten()
    counts = counts[:: max(1, len(counts) // _SAMPLES)]
    return float(counts.kthvalue(max(1, round(_DARKEST * len(counts)))).values)


@dataclass(frozen=True)
class _Level:
    """A development with one of the black levels that are tried, and both frames by it."""

    development: Development
    measurement: Measurement
    psf: Measurement

    @classmethod
    def of(cls, development: Development, frame: Frame) -> "_Level":
        """Of the measurement's frame."""
        measurement = development.measurement(frame)
        return cls(development, measurement, development.developed_psf(measurement))

    def prediction(self, geometry: PsfGeometry) -> Prediction | None:
        """How well left-out pixels are predicted, in the measurement's strongest channel."""
        psf = prepare_psf(self.psf, self.measurement, geometry).values
        channel = self.measurement.brightest
        psf = psf[channel % len(psf)][None]
        height, width = self.measurement.size
        solver = Reconstructor(_middle(psf, (_BEYOND * height, _BEYOND * width)))
        return solver.predict(self.measurement.values[channel], self.measurement.valid[channel])


def _tried(levels: Sequence[_Level], geometries: Sequence[PsfGeometry]) -> list[PsfTrial]:
    """Every geometry with the black level that suits it; none where pixels are too few."""
    trials = []
    for geometry in geometries:
        choice: PsfTrial | None = None
        for level in levels:
            prediction = level.prediction(geometry)
            if prediction is None:
                return []
            if choice is None or prediction.is_likely_better(choice.prediction):
                choice = PsfTrial(replace(level.development, psf_geometry=geometry), prediction)
        if choice is not None:
            trials.append(choice)
    return trials


def _middle(psf: Tensor, most: tuple[int, int]) -> Tensor:
    """At most so many rows and columns around the zero shift."""
    sides = []
    for have, need in zip(psf.shape[-2:], most, strict=True):
        cut = have // 2 - need // 2
        sides.append((-cut, need + cut - have) if have > need else (0, 0))
    return nnf.pad(psf, (*sides[1], *sides[0]))


def _best(
    trials: Sequence[PsfTrial], usual: int, psf: Measurement, measurement: Measurement
) -> PsfTrial:
    """The trial that explains the measurement best; two that do are an error.

    After the `usual` ones come those that must be clearly better than these: PSFs that are turned
    over, than the same one upright.
    """
    upright = {replace(each.geometry, flip="none"): each for each in trials[:usual]}
    winners = dict(upright)
    for each in sorted(trials[usual:], key=_unexplained, reverse=True):
        place = replace(each.geometry, flip="none")
        rivals = [upright[place]] if place in upright else trials[:usual]
        if all(each.prediction.is_clearly_better(other.prediction) for other in rivals):
            winners[place] = each
    best, *others = sorted(winners.values(), key=_unexplained)
    for other in others:
        if not best.prediction.is_clearly_better(other.prediction):
            unless = (
                ", if the PSF is this camera's" if best.prediction.missed > _PART_MISSED else ""
            )
            raise DataError(
                f"{sizes_text(psf, measurement)}. Taken as {_name(best.geometry)} it leaves "
                f"{_percent(best)} of the contrast unexplained, as {_name(other.geometry)} "
                f"{_percent(other)}: too close to tell. Say which{unless}"
            )
    return best


def _unexplained(trial: PsfTrial) -> float:
    return trial.prediction.unexplained


def _geometry_stated(settings: PsfSettings) -> PsfGeometry:
    """What a person said; it needs no note."""
    flip: Flip = "none" if settings.flip == "auto" else settings.flip
    return PsfGeometry(settings.scale, extended=settings.extent == "wide", flip=flip)


def _geometry_note(
    chosen: Development, best: PsfTrial | None, trials: Sequence[PsfTrial], noted: int | None
) -> str:
    text = f"the PSF {chosen.psf.source} is taken as {_name(chosen.psf_geometry)}"
    if noted == (chosen.psf_geometry.scale or 1):
        return f"{text}, as its file says"
    upright = replace(chosen.psf_geometry, flip="none")
    others = [
        each
        for each in trials
        if each.geometry == upright or replace(each.geometry, flip="none") != upright
    ]
    others = [each for each in others if each is not best]
    if best is None or not others:
        return text
    other = min(others, key=_unexplained)
    return (
        f"{text}: {_percent(best)} of the contrast is unexplained; taken as "
        f"{_name(other.geometry)}, {_percent(other)}"
    )


def _percent(trial: PsfTrial) -> str:
    return percent(trial.prediction.unexplained)


def _name(geometry: PsfGeometry) -> str:
    """A geometry as text, with the options for it."""
    scale = geometry.scale or 1
    parts = [f"{scale} times finer (--psf-scale {scale})" if scale > 1 else ""]
    if geometry.extended:
        parts.append("extended (--psf-extent wide)")
    if geometry.partial:
        parts.append("a part, dark around it (--psf-scale 1)" if scale == 1 else "dark beside it")
    parts.append(_FLIPS[geometry.flip])
    return ", ".join(part for part in parts if part) or "it is"
