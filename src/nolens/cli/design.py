"""`nolens design`: the commands that it has are in `design_*.py`."""

from cyclopts import App

from nolens.cli.design_mask import mask
from nolens.cli.design_thickness import thickness
from nolens.cli.design_tolerance import tolerance

design = App(name="design", help="Design a camera: thickness, tolerances and masks.")
design.command(mask)
design.command(thickness)
design.command(tolerance)
