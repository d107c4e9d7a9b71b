"""`nolens measure resolution`: a command for each target that there is."""

from collections.abc import Callable
from typing import Annotated

from cyclopts import App, Parameter

from nolens.cli.command import command
from nolens.errors import OptionError
from nolens.jobs.measuring.resolution import resolution_target, target_names


def _measure(name: str) -> Callable[..., int]:
    """The command of a target; of one that cannot be loaded, a command that says why."""
    try:
        target = resolution_target(name)
    except OptionError as error:
        return _refusing(error)
    return command(target.job.options, target.job, target.lines, name=name)


def _refusing(error: OptionError) -> Callable[..., int]:
    def refuse(*_: Annotated[str, Parameter(allow_leading_hyphen=True, show=False)]) -> int:
        raise error

    refuse.__doc__ = str(error)
    return refuse


resolution = App(
    name="resolution", help="Measure how fine a camera resolves, by one of several targets."
)
for _name in target_names():
    resolution.command(_measure(_name), name=_name)
