"""`nolens design`: the commands that it has are in `design_*.py`."""

from cyclopts import App

design = App(name="design", help="Design a camera: thickness, tolerances and masks.")
