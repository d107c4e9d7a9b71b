"""What other packages add to nolens, by their entry points."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pkgutil import resolve_name
from typing import Any, Generic, Literal, TypeVar

from nolens.errors import OptionError
from nolens.printable import quoted

Kind = TypeVar("Kind")

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


@dataclass(frozen=True)
class Registry(Generic[Kind]):
    """Things of one kind by name: those of nolens, and those that other packages add.

    Attributes
    ----------
    group
        Of the entry points of other packages.
    own
        Where each of ours is, as ``module:attribute``; it is loaded where it is used.
    what
        What one is called in messages, such as "kind of mask".
    expected
        What an entry point must lead to, such as "class of MaskOptions".
    fits
        Whether something is that.
    """

    group: Group
    own: Mapping[str, str]
    what: str
    expected: str
    fits: Callable[[Any], bool]

    @property
    def names(self) -> tuple[str, ...]:
        """Those of nolens first; nothing is loaded."""
        return tuple(dict.fromkeys((*self.own, *plugin_names(self.group))))

    def load(self, name: str) -> Kind:
        """What has a name.

        Raises
        ------
        OptionError
            If nothing has, the package that adds it cannot be loaded, or it is something else.
        """
        if name not in self.names:
            raise OptionError(
                f"there is no {self.what} {quoted(name)}; there are {', '.join(self.names)}"
            )
        thing: Kind
        thing = resolve_name(self.own[name]) if name in self.own else load_plugin(self.group, name)
        if not self.fits(thing):
            raise OptionError(
                f"the entry point {name!r} of {self.group} leads to no {self.expected}: mend the "
                "package that has it, or uninstall it"
            )
        return thing
