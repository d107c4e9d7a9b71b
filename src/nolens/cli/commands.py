"""What `nolens` can be told to do."""

from collections.abc import Sequence

from nolens.cli.app import application, without_read_limit
from nolens.cli.app import run as run_app

COMMANDS = {
    "reconstruct:reconstruct": "Reconstruct a photograph "
    "from a measurement and a PSF, or a sequence of them.",
    "refocus:refocus": "Focus a photograph at any depth, after it was taken.",
    "capture:capture": "Take raw frames with a camera: "
    "one, many, averaged, bracketed, or over a long time.",
    "reconstruct:info": "Say what a file holds: size, channels, mosaic, levels, range.",
    "calibrate:calibrate": "Make a PSF of "
    "pictures of one point source, and add it to a camera's folder.",
    "measure:measure": "Measure how good a camera is: PSF, resolution, field of view.",
    "simulate:simulate": "Simulate what a lensless camera measures of a scene.",
    "simulate:psf": "Simulate what a lensless camera shows of a point source.",
    "camera:camera": "Descriptions of cameras.",
    "material:material": "Materials that layers of a camera are made of.",
    "design:design": "Design a camera: thickness, tolerances and masks.",
    "fabricate:fabricate": "Write the files that a camera is made from: "
    "frame, mask, process sheet.",
    "reproduce:reproduce": "Make every figure of the paper again that simulation can give, "
    "beside the paper's values.",
    "studio:studio": "Open a page on which to see through a camera, design it, calibrate it and "
    "take pictures.",
    "demo:demo": "Simulate a small lensless camera, and reconstruct a photograph from its files.",
}
"""Every command by file and name, and the first sentence of its help.

A command loads only what it uses, which is why they are known by name here.
"""


def run(arguments: Sequence[str]) -> int:
    """Run one command and return its exit code.

    Raises
    ------
    OptionError
        If the arguments name no command, or an option or value that it does not have.
    """
    arguments = without_read_limit(arguments)
    app = application()
    listed = not arguments or arguments[0].startswith("-")
    for path, sentence in COMMANDS.items():
        # A help that is given here replaces the command's own, so only the list of all has it.
        app.command(f"nolens.cli.{path}", help=sentence if listed else None)
    return run_app(app, arguments)
