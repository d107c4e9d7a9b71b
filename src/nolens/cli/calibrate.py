"""`nolens calibrate`: the commands that it has are in `calibrate_*.py`."""

from cyclopts import App

calibrate = App(name="calibrate", help="Calibrate a camera: its PSFs, from what it measured.")
