"""`nolens measure`: the commands that it has are in `measure_*.py`."""

from cyclopts import App

from nolens.cli.measure_field import field
from nolens.cli.measure_psf import psf
from nolens.cli.measure_resolution import resolution
from nolens.cli.measure_target import target

measure = App(name="measure", help="Measure how good a camera is: PSF, resolution, field of view.")
measure.command(field)
measure.command(psf)
measure.command(resolution)
measure.command(target)
