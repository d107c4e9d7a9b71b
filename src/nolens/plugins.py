"""What other packages add to nolens, by their entry points."""

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal

from nolens.errors import OptionError

Group = Literal[
    "nolens.masks", "nolens.priors", "nolens.readers", "nolens.sources", "nolens.targets"
]


@cache
def _points(group: Group) -> dict[str, EntryPoint]:
    return {each.name: each for each in entry_points(group=group)}


def plugin_names(group: Group) -> tuple[str, ...]:
    """Names of what packages add to a group, sorted; nothing is loaded."""
    return tuple(sorted(_points(group)))


def load_plugin(group: Group, name: str) -> Any:
    """What a package adds under a name; None where none does.

    Raises
    ------
    OptionError
        If the package cannot be loaded.
    """
    point = _points(group).get(name)
    if point is None:
        return None
    try:
        return point.load()
    except Exception as error:  # Whatever another package's code raises.
        package = "a package" if point.dist is None else point.dist.name
        raise OptionError(
            f"{package} adds {name!r} to {group}, and cannot be loaded: "
            f"{type(error).__name__}: {error}. Mend it, or uninstall it"
        ) from error
