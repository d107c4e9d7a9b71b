"""What `nolens` can be told to do: all of its commands, in the order that its help lists them."""

from nolens.cli.app import app, run
from nolens.cli.calibrate import calibrate
from nolens.cli.camera import camera
from nolens.cli.demo import demo
from nolens.cli.design import design
from nolens.cli.fabricate import fabricate
from nolens.cli.material import material
from nolens.cli.measure import measure
from nolens.cli.reconstruct import info, reconstruct
from nolens.cli.refocus import refocus
from nolens.cli.reproduce import reproduce
from nolens.cli.simulate import psf, simulate

__all__ = ["run"]

for command in (
    reconstruct, refocus, info, calibrate, measure, simulate, psf, camera, material, design,
    fabricate, reproduce, demo,
):  # fmt: skip
    app.command(command)
