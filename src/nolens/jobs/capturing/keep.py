"""One file of a capture: a frame or the mean of some, and the record beside it."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import torch

from nolens.calibrate.point_frames import check_alike
from nolens.capture import Levels, Shot
from nolens.files import (
    InputFile,
    RunRecord,
    check_holds,
    write_frame,
    write_into,
    write_record,
)
from nolens.jobs.capturing.options import CaptureOptions


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


def keep(
    path: Path,
    shot: Shot,
    levels: Levels,
    frames: int,
    *,
    options: CaptureOptions,
    started: str,
    inputs: Mapping[str, InputFile],
    warnings: list[str],
) -> None:
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
    options, started, inputs, warnings
        For the record.

    Raises
    ------
    NolensError
        If the file's kind cannot hold the frame, or it cannot be written.
    """
    check_holds(path, shot.frame)
    record = RunRecord(
        started=started,
        inputs=dict(inputs),
        parameters=options.model_dump(mode="json"),
        result=_facts(shot, levels, frames, options.kind),
        history=[],
        warnings=list(warnings),
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
