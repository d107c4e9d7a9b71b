"""Pictures of one measurement with other values of one option, and the sheet of them all."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from torch import Tensor

from nolens.files.contact_sheet import SheetPicture, write_contact_sheet
from nolens.jobs.reconstruction.options import ReconstructOptions
from nolens.jobs.run import Writer
from nolens.solvers import Method, Result


@dataclass(frozen=True)
class SweptPicture:
    """One picture of a sweep.

    Parameters
    ----------
    name
        Of its value, as in the file's name; None for that of the options: the picture itself.
    settings
        Options that give it alone.
    tau
        Weight of the prior that was used.
    result
        What the solver gave.
    picture
        Radiance of the part that is written, as it is written.
    """

    name: str | None
    settings: dict[str, Any]
    tau: float
    result: Result = field(repr=False)
    picture: Tensor = field(repr=False)

    def path(self, options: ReconstructOptions, output: Path) -> Path:
        """Its file, of the kind of one of the outputs."""
        return output if self.name is None else options.swept_path(output, self.name)

    def row(self, options: ReconstructOptions) -> dict[str, Any]:
        """Of the record."""
        return {
            "file": self.path(options, options.output[0]).name,
            "settings": self.settings,
            "text": text_of(self.settings),
            "tau": self.tau,
            "iterations": self.result.iterations,
            "stop_reason": self.result.stop_reason,
        }

    @property
    def label(self) -> str:
        """Its option as the command line has it, and the weight."""
        return f"{text_of(self.settings)}\nτ = {self.tau:.2g}"


def text_of(settings: Mapping[str, Any]) -> str:
    """Options as the command line has them."""
    texts = []
    for name, value in settings.items():
        number = f"{value:.3g}" if isinstance(value, float) else value
        texts.append(f"no --{name}" if value is None else f"--{name} {number}")
    return " ".join(texts)


def sweep_settings(
    options: ReconstructOptions, name: str | None, sensor: tuple[int, int]
) -> dict[str, Any]:
    """The option, by name, that gives a picture of the sweep alone.

    Parameters
    ----------
    name
        Of `ReconstructOptions.swept_names`.
    sensor
        (height, width) of the measurement.
    """
    if options.sweep == "tau":
        factor = _factor(name)
        if options.tau == "auto":
            return {"detail": options.detail / factor}
        return {"tau": options.tau * factor}
    if options.sweep == "method":
        return {"method": options.method if name is None else Method(name)}
    if options.sweep == "prior":
        return {"prior": name or options.prior}
    if name is None:
        return {"support": options.support}
    if name == "full":
        return {"support": name}
    height, width = (max(1, round(_factor(name) * side)) for side in sensor)
    return {"support": f"{height}x{width}"}


def swept_options(
    options: ReconstructOptions, name: str, sensor: tuple[int, int]
) -> ReconstructOptions:
    """Options of a picture of the sweep.

    Parameters
    ----------
    name, sensor
        As `sweep_settings` takes them.
    """
    settings = sweep_settings(options, name, sensor)
    if options.sweep == "support":
        settings |= {"field": None, "camera": None}
    return options.model_copy(update=settings)


def _factor(name: str | None) -> float:
    """What the name of a file says: x0.5."""
    return 1.0 if name is None else float(name.removeprefix("x"))


def sweep_writers(
    options: ReconstructOptions,
    pictures: Sequence[SweptPicture],
    white: float,
    write: Callable[..., None],
) -> dict[Path, Writer]:
    """What writes the pictures of a sweep, but for the options' own, and the sheet of all.

    Parameters
    ----------
    white
        Radiance that is white in all of them.
    write
        Writes a `picture` to a path.
    """
    writers: dict[Path, Writer] = {
        each.path(options, output): partial(write, picture=each.picture)
        for each in pictures
        if each.name is not None
        for output in options.output
    }
    sheet = [SheetPicture(each.label, each.picture) for each in pictures]
    writers[options.contact_sheet] = partial(write_contact_sheet, pictures=sheet, white=white)
    return writers
