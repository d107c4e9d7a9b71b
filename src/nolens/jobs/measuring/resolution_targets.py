"""The targets of `nolens measure resolution`, by name; other packages add theirs."""

from abc import abstractmethod
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import Any, ClassVar

from torch import Tensor

from nolens.errors import OptionError
from nolens.jobs.measuring.resolution_options import ResolutionOptions
from nolens.jobs.options import JobOptions
from nolens.jobs.run import Reporter, Result
from nolens.plugins import load_plugin, plugin_names

_HERE = "nolens.jobs.measuring"
_TARGETS = {
    "two-points": f"{_HERE}.two_points:TWO_POINTS",
    "siemens": f"{_HERE}.siemens:SIEMENS",
    "edge": f"{_HERE}.edge:EDGE",
}


class ScreenPicture(JobOptions):
    """A target in black and white, to show on a screen.

    Its fields are options of `nolens measure target`, each with a default; a name that a target
    before it has means the same.

    Attributes
    ----------
    about
        What it shows.
    """

    about: ClassVar[str]

    @abstractmethod
    def draw(self, side: int) -> Tensor:
        """Give it, (side, side) from 0 to 1, for a side in pixels."""


@dataclass(frozen=True)
class ResolutionTarget:
    """What can be put in front of a camera to measure how fine it resolves.

    Parameters
    ----------
    options
        Of the measurement; their docstring is the help of its command.
    job
        Measures.
    lines
        What a person at a terminal is told of the summary.
    picture
        The target as `nolens measure target` draws it; None where no screen can show it.
    """

    options: type[ResolutionOptions]
    job: Callable[[Any, Reporter], Result[Any]]
    lines: Callable[[dict[str, Any]], Iterable[str]]
    picture: type[ScreenPicture] | None = None


def target_names() -> tuple[str, ...]:
    """Names of the targets, those of other packages (entry points ``nolens.targets``) last."""
    return (*_TARGETS, *(name for name in plugin_names("nolens.targets") if name not in _TARGETS))


def resolution_target(name: str) -> ResolutionTarget:
    """The target of a name.

    Raises
    ------
    OptionError
        If there is none, or the package that adds it cannot be loaded.
    """
    target = (
        resolve_name(_TARGETS[name]) if name in _TARGETS else load_plugin("nolens.targets", name)
    )
    if not isinstance(target, ResolutionTarget):
        what = "is no target" if target is None else f"is a {type(target).__name__}, and no target"
        raise OptionError(f"{name!r} {what}; known are {', '.join(target_names())}")
    return target


def screen_pictures() -> dict[str, type[ScreenPicture]]:
    """Pictures of the targets that have one, by name, but for packages that cannot be loaded."""
    pictures = {}
    for name in target_names():
        with suppress(OptionError):
            target = resolution_target(name)
            if target.picture is not None:
                pictures[name] = target.picture
    return pictures
