"""Help in two steps: ``--help`` has what most people need, ``--help-all`` the rest by group."""

from cyclopts.help import DefaultFormatter, HelpPanel
from rich.console import Console, ConsoleOptions

_WITHOUT_GROUP = ("Commands", "Arguments", "Parameters")
"""Headings that cyclopts gives to what has no group."""


class BriefFormatter(DefaultFormatter):
    """Formats what has no group of its own, and counts the other options.

    Attributes
    ----------
    more
        How many options are left out.
    """

    def __init__(self) -> None:
        super().__init__()
        self.more = 0

    def __call__(self, console: Console, options: ConsoleOptions, panel: HelpPanel) -> None:
        """Print a panel, or count the options in it."""
        if panel.title in _WITHOUT_GROUP:
            super().__call__(console, options, panel)
        else:
            self.more += len(panel.entries)
