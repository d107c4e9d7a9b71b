"""`nolens calibrate`: the commands that it has are in `calibrate_*.py`."""

from cyclopts import App

from nolens.cli.calibrate_distances import distances
from nolens.cli.calibrate_pairs import pairs
from nolens.cli.calibrate_point import point
from nolens.cli.calibrate_stitch import plan, stitch
from nolens.cli.calibrate_surround import surround

calibrate = App(name="calibrate")
calibrate.default(point)
calibrate.command(distances)
calibrate.command(pairs)
calibrate.command(plan)
calibrate.command(stitch)
calibrate.command(surround)
