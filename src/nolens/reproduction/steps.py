"""Steps of a long job whose results are saved, so that it goes on where it was interrupted."""

import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, TypeAdapter
from pydantic_core import to_json
from torch import Tensor

import nolens
from nolens.amounts import duration_text
from nolens.documents import parse_json
from nolens.errors import NolensError
from nolens.files import read_frame, read_text, versions, write_into, write_tiff32
from nolens.jobs.run import Reporter
from nolens.progress import Pace, ProgressCallback

_FIGURES, _TIMING = "figures.json", "timing.json"
_WITHOUT_RESULTS = ("cli", "fabricate", "files")
"""Rooms of nolens whose code does not change results."""
_WORK = "the paper's figures"


@dataclass(frozen=True)
class StepResult:
    """What came of a step.

    Parameters
    ----------
    figures
        Numbers, texts and lists of them, by name: values that JSON has.
    arrays
        (1 or 3, rows, columns), float32, by name.
    seconds
        What parts of it took, where that is a result.
    refused
        Why it could not be done with this camera; None where it was.
    """

    figures: Mapping[str, Any] = field(default_factory=dict)
    arrays: Mapping[str, Tensor] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    refused: str | None = None


@dataclass(frozen=True)
class Step:
    """A piece of work whose result is saved.

    Parameters
    ----------
    name
        Of its folder.
    what
        For the person who waits.
    parameters
        All that the result follows from, besides the code: values that JSON has.
    work
        Samples that it goes through, beside those of the other steps.
    run
        Does it.
    """

    name: str
    what: str
    parameters: Mapping[str, Any]
    work: float
    run: Callable[[ProgressCallback], StepResult]

    @property
    def key(self) -> str:
        """SHA-256 of parameters, nolens's code and the versions of what it computes with."""
        known = versions()
        del known["platform"]
        text = to_json(
            {
                "name": self.name,
                "parameters": self.parameters,
                "versions": known,
                "code": _code_digest(),
            }
        )
        return hashlib.sha256(text).hexdigest()


def carry_out(steps: Sequence[Step], folder: Path, reporter: Reporter) -> dict[str, StepResult]:
    """Do all steps, each of which is written when it is done; what is there already is taken.

    Parameters
    ----------
    steps
        In their order.
    folder
        Gets a folder for each of them.
    reporter
        Sees what is done and how long the rest will take.

    Returns
    -------
    dict
        Results by name, as they are read from their files.

    Raises
    ------
    FileError
        If a result cannot be written.
    """
    results: dict[str, StepResult] = {}
    for step in steps:
        earlier = _load(folder / step.name, step.key)
        if earlier is not None:
            results[step.name] = earlier
    if results:
        reporter.note(f"{len(results)} of {len(steps)} parts are there from an earlier run")
    todo = [step for step in steps if step.name not in results]
    whole, done, pace = sum(step.work for step in todo), 0.0, Pace()
    for number, step in enumerate(todo, 1):
        left = pace.seconds_left(_WORK, done / whole)
        more = "" if left is None or not pace.sure else f"; about {duration_text(left)} left"
        reporter.note(f"{step.what} ({number} of {len(todo)}{more})")

        def progress(fraction: float, before: float = done, step: Step = step) -> None:
            reporter.advance(_WORK, (before + fraction * step.work) / whole)

        progress(0.0)
        start = time.perf_counter()
        try:
            result = step.run(progress)
        except NolensError as error:
            result = StepResult(refused=str(error))
            reporter.warn(f"{step.what} cannot be made with this camera: {error}")
        taken = time.perf_counter() - start
        _write(folder / step.name, step.key, result, taken)
        done += step.work
        saved = _load(folder / step.name, step.key)
        if saved is not None:
            results[step.name] = saved
    return {step.name: results[step.name] for step in steps if step.name in results}


class _Saved(BaseModel):
    """What figures.json has; with a digest, as no schema knows the figures of every step.

    Attributes
    ----------
    key
        Of the step.
    figures, refused
        As `StepResult` has them.
    arrays
        SHA-256 of each array, by name.
    digest
        SHA-256 of all the rest.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    key: str
    figures: dict[str, Any]
    arrays: dict[str, str]
    refused: str | None
    digest: str = ""

    @property
    def expected(self) -> str:
        """SHA-256 of all but the digest."""
        text = to_json(self.model_dump(exclude={"digest"}), inf_nan_mode="null")
        return hashlib.sha256(text).hexdigest()


_SECONDS = TypeAdapter(dict[str, float])


@cache
def _code_digest() -> str:
    """SHA-256 of the files of nolens that results follow from."""
    digest = hashlib.sha256()
    root = Path(nolens.__file__).parent
    for path in sorted(root.rglob("*")):
        name = path.relative_to(root).as_posix()
        irrelevant = name.split("/")[0] in _WITHOUT_RESULTS
        if path.suffix in (".py", ".toml") and not irrelevant:
            digest.update(f"{name}\0".encode() + path.read_bytes())
    return digest.hexdigest()


def _write(folder: Path, key: str, result: StepResult, taken: float) -> None:
    """Files of a step, all or none."""
    saved = _Saved(
        key=key,
        figures=dict(result.figures),
        arrays={name: _array_digest(array) for name, array in sorted(result.arrays.items())},
        refused=result.refused,
    )
    saved = saved.model_copy(update={"digest": saved.expected})
    seconds = {"all": round(taken, 3), **{name: round(s, 3) for name, s in result.seconds.items()}}
    writers: dict[Path, Callable[[Path], None]] = {
        folder / f"{name}.tif": partial(write_tiff32, radiance=array)
        for name, array in result.arrays.items()
    }
    writers[folder / _TIMING] = partial(_write_json, value=seconds)
    writers[folder / _FIGURES] = partial(_write_json, value=saved.model_dump())
    write_into(folder, writers)


def _write_json(path: Path, value: dict[str, Any]) -> None:
    path.write_bytes(to_json(value, indent=1, inf_nan_mode="null") + b"\n")


def _load(folder: Path, key: str) -> StepResult | None:
    """A result of the same parameters and code; None where there is none, or it is damaged."""
    try:
        saved = _Saved.model_validate(_json(folder / _FIGURES))
        if saved.key != key or saved.digest != saved.expected:
            return None
        seconds = _SECONDS.validate_python(_json(folder / _TIMING))
        arrays = {name: read_frame(folder / f"{name}.tif").counts for name in saved.arrays}
    # pydantic's errors are ValueErrors.
    except (NolensError, ValueError):
        return None
    if any(_array_digest(arrays[name]) != digest for name, digest in saved.arrays.items()):
        return None
    return StepResult(saved.figures, arrays, seconds, saved.refused)


def _json(path: Path) -> Any:
    return parse_json(read_text(path, "JSON"), str(path))


def _array_digest(array: Tensor) -> str:
    values = array.detach().cpu().float().numpy()
    return hashlib.sha256(f"{values.shape}".encode() + values.tobytes()).hexdigest()
