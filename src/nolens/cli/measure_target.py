"""`nolens measure target`."""

from nolens.cli.command import command
from nolens.jobs import TargetOptions, make_target

target = command(TargetOptions, make_target, lambda _: (), name="target")
