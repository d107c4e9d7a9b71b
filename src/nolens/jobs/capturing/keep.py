"""Names of the files of captured frames, and their writing."""

import re
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import torch

from nolens.calibrate.point_frames import check_alike
from nolens.capture import Levels, Shot
from nolens.errors import FileError, OptionError
from nolens.files import (
    FRAME_SUFFIXES,
    RunRecord,
    check_holds,
    write_frame,
    write_into,
    write_record,
)
from nolens.jobs.capturing.options import CaptureOptions
from nolens.jobs.run import Run


@dataclass
class Naming:
    """Gives every file its name, and none that is taken.

    Parameters
    ----------
    folder
        Where they go.
    stem
        What their names begin with.
    suffix
        None where it follows from the frames.
    options
        They say whether there are several.
    """

    folder: Path
    stem: str
    suffix: str | None
    options: CaptureOptions
    _number: int = field(default=0, init=False)

    @classmethod
    def of(cls, options: CaptureOptions) -> "Naming":
        """Find the folder, and the numbers that are taken there.

        Raises
        ------
        FileError
            If the suffix is not known.
        OptionError
            If an average is to be a .dng.
        """
        output = options.output
        if options.names_folder:
            found = cls(output, options.kind, None, options)
        else:
            # That of one file was checked with its folder.
            if output.suffix.lower() not in FRAME_SUFFIXES:
                raise FileError(
                    f"cannot write {output}: the suffix {output.suffix} is not known here. "
                    f"Accepted: {', '.join(FRAME_SUFFIXES)}"
                )
            if options.average and output.suffix.lower() == ".dng":
                raise OptionError(
                    f"{output.name} would be a DNG, which holds whole counts, and an average has "
                    f"fractions: write {output.with_suffix('.tif').name}"
                )
            found = cls(output.parent, output.stem, output.suffix, options)
        if found._numbered:
            found._number = found._last()
        return found

    def next(self, exposure_s: float, suffix: str) -> Path:
        """Name of the next file.

        Parameters
        ----------
        exposure_s
            Of its frames.
        suffix
            Where none was given.
        """
        name = self.stem
        if self._numbered:
            self._number += 1
            name += f"-{self._number:04d}"
        if self.options.bracket > 1:
            name += f"-{1e3 * exposure_s:.4g}ms"
        # Not with_suffix: what follows the last dot of the name may be part of a number.
        return self.folder / f"{name}{self.suffix or suffix}"

    @property
    def _numbered(self) -> bool:
        return self.options.several or self.suffix is None

    def _last(self) -> int:
        """Largest number that is taken, so that frames of another day stay."""
        pattern = re.compile(rf"{re.escape(self.stem)}-(\d+)(?:-[^/]*ms)?\.\w+")
        try:
            names = [each.name for each in self.folder.iterdir()]
        except OSError:  # It is made with the first frame.
            return 0
        found = (pattern.fullmatch(name) for name in names)
        return max((int(match[1]) for match in found if match), default=0)


class Burst:
    """The mean of frames of one exposure, which are added as they come."""

    def __init__(self) -> None:
        self.frames = 0
        self._first: Shot | None = None
        self._sum = torch.empty(0)
        self._clipped = torch.empty(0, dtype=torch.bool)

    def add(self, shot: Shot) -> None:
        """Add a frame.

        Raises
        ------
        DataError
            If it does not have the size, colours and levels of the first one.
        """
        counts = shot.frame.counts
        if self._first is None:
            self._first = shot
            self._sum = torch.zeros_like(counts, dtype=torch.float64)
            self._clipped = torch.zeros_like(counts, dtype=torch.bool)
        check_alike(shot.frame, self._first.frame)
        self._sum += counts
        if shot.frame.white is not None:
            self._clipped |= counts >= shot.frame.white
        self.frames += 1

    def mean(self) -> Shot:
        """Their mean; a pixel that is saturated in one of them is so in the mean."""
        assert self._first is not None
        counts = (self._sum / self.frames).float()
        if self._first.frame.white is not None:
            counts[self._clipped] = self._first.frame.white
        return replace(self._first, frame=replace(self._first.frame, counts=counts))


def keep(path: Path, shot: Shot, levels: Levels, frames: int, run: Run[CaptureOptions]) -> None:
    """Write a frame and its record, both or neither.

    Parameters
    ----------
    path
        Of the frame; the record has its name with .json.
    shot
        The frame, or the mean of some.
    levels
        Of this frame.
    frames
        How many it is the mean of.
    run
        What it is a part of.

    Raises
    ------
    NolensError
        If the file's kind cannot hold the frame, or it cannot be written.
    """
    check_holds(path, shot.frame)
    record = RunRecord(
        started=run.clock.started,
        inputs=run.inputs,
        parameters={**run.options.model_dump(mode="json"), "kind": run.options.kind},
        result=_facts(shot, levels, frames, run.options.kind),
        history=[],
        warnings=list(run.warnings),
    )
    write_into(
        path.parent,
        {
            path: partial(write_frame, frame=shot.frame, model=shot.camera),
            path.with_suffix(".json"): partial(write_record, record=record),
        },
    )


def _facts(shot: Shot, levels: Levels, frames: int, kind: str) -> dict[str, Any]:
    frame = shot.frame
    return {
        "kind": kind,
        "camera": shot.camera,
        "taken": shot.taken.isoformat(timespec="milliseconds"),
        "exposure_s": shot.exposure_s,
        "gain": shot.gain,
        "frames": frames,
        "size": list(frame.counts.shape[-2:]),
        "mosaic": frame.mosaic,
        "black": list(frame.black),
        "white": frame.white,
        "clipped_share": levels.clipped_share,
        "bright": levels.bright,
        "brightest": levels.brightest,
        "mean": levels.mean,
        "details": shot.details,
    }
