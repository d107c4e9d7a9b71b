"""`nolens measure`: the commands that it has are in `measure_*.py`."""

from cyclopts import App

measure = App(name="measure", help="Measure how good a camera is: PSF, resolution, field of view.")
