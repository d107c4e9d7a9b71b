"""What `nolens refocus` can be told, as a frozen model."""

import math
import re
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator

from nolens.camera.part import Counts, refusal
from nolens.camera.psf_set import Depth
from nolens.errors import OptionError
from nolens.files import CAMERA_FILE, PSFS_FILE
from nolens.jobs.device import DeviceName
from nolens.jobs.fields import Bin, FilePath, Iterations, Tau, Window, Word
from nolens.jobs.given import JobOptions, Written
from nolens.quantities import Length
from nolens.ranges import Between
from nolens.solvers import Prior

RECORD_FILE = "refocus.json"
FOCUSED_FILES = ("focused.png", "focused.tif")
STACK_FILES = {
    "stack": "stack.tif",
    "sweep": "sweep.png",
    "page with a slider": "sweep.html",
    "picture that is sharp everywhere": "all-in-focus.png",
    "depth map": "depth.png",
    "depths": "depth.tif",
}
"""What is written into the folder."""
_PLACE = re.compile(r"([0-9]{1,6})\s*,\s*([0-9]{1,6})")
_MOST_STEPS = 200


def depth_um(depth: Depth) -> float:
    """A depth as the optics take it: the word is infinity."""
    return depth.um if isinstance(depth, Length) else math.inf


def _two_depths(given: Any) -> Any:
    if not isinstance(given, str):
        return given
    parts = given.split(",")
    if len(parts) != 2:
        raise refusal("give the nearest and the farthest depth, such as 8cm,50cm or 8cm,infinity")
    return tuple(part.strip() for part in parts)


def _near_first(depths: tuple[Depth, Depth]) -> tuple[Depth, Depth]:
    if not depth_um(depths[0]) < depth_um(depths[1]):
        raise refusal("the first depth must be nearer than the second, such as 8cm,50cm")
    return depths


def _place(given: Any) -> Any:
    if not isinstance(given, str):
        return given
    match = _PLACE.fullmatch(given.strip())
    if match is None:
        raise refusal("give row and column of the picture in pixels, such as 120,200")
    return int(match[1]), int(match[2])


_Row = Annotated[int, Between(0, 999_999)]
Depths = Annotated[tuple[Depth, Depth], BeforeValidator(_two_depths), AfterValidator(_near_first)]


class RefocusOptions(JobOptions):
    """What `nolens refocus` can be told.

    Attributes
    ----------
    measurement
        File of the measurement.
    psfs
        Folder of the camera's PSFs.
    output
        Folder of all that is written.
    depth
        Of the picture; None finds the sharpest one.
    at
        Row and column of the picture that is to be sharp; None for the whole picture.
    search
        Nearest and farthest depth to look at; None takes those of the PSFs.
    stack
        Nearest and farthest depth of a focal stack; None for no stack.
    steps
        Depths of the stack.
    dark, flat, black, white, mosaic, bgr, channels, bin
        How the measurement is read, as in `ReconstructOptions`.
    region, tau, prior, iterations, device
        How it is reconstructed, as there.
    flip
        Turns the pictures over: vertical, horizontal or both.
    """

    measurement: FilePath
    psfs: FilePath
    output: FilePath
    depth: Depth | None = None
    at: Annotated[tuple[_Row, _Row], BeforeValidator(_place)] | None = None
    search: Depths | None = None
    stack: Depths | None = None
    steps: Annotated[int, Between(2, _MOST_STEPS)] = 9
    dark: FilePath | None = None
    flat: FilePath | None = None
    black: Counts | None = None
    white: Counts | None = None
    mosaic: Word | None = None
    bgr: bool = False
    channels: Word = "all"
    bin: Bin = 1
    region: Window | None = None
    tau: Tau = 1e-4
    prior: Prior = Prior.TV
    iterations: Iterations = 100
    device: DeviceName = "auto"
    flip: Literal["none", "vertical", "horizontal", "both"] = "none"

    @classmethod
    def gather(cls, given: dict[str, Any]) -> Self:
        """Options as the command line gives them.

        Raises
        ------
        OptionError
            If one is missing, its value cannot be used, or two do not go together.
        """
        for name, what in (
            ("measurement", "the measurement (nolens refocus RAW --psfs FOLDER -o FOLDER)"),
            ("psfs", f"the folder with the camera's {PSFS_FILE} (--psfs FOLDER)"),
            ("output", "the folder for the pictures (-o FOLDER)"),
        ):
            if not given.get(name):
                raise OptionError(f"no {name} is given; name {what}")
        options = cls.checked(given)
        if options.depth is not None:
            for name, value in (("at", options.at), ("search", options.search)):
                if value is not None:
                    raise OptionError(
                        f"--depth {options.depth} says the depth, and --{name} has it found: "
                        "leave one out"
                    )
        if "steps" in given and options.stack is None:
            raise OptionError(
                f"--steps {options.steps} are those of a focal stack: say between which depths, "
                "such as --stack 8cm,50cm"
            )
        if options.search is not None and not options.focused:
            raise OptionError(
                "--search looks for the sharpest depth, and --stack alone looks for none: add "
                "--at, or leave one out"
            )
        return options

    @property
    def focused(self) -> bool:
        """Whether a picture at one depth is written."""
        return self.stack is None or self.depth is not None or self.at is not None

    @property
    def record(self) -> Path:
        """File of the run's record."""
        return self.output / RECORD_FILE

    @property
    def inputs(self) -> dict[str, Path]:
        """Files that are read, by role, but for the PSFs."""
        roles = {
            "measurement": self.measurement,
            "list of PSFs": self.psfs / PSFS_FILE,
            "camera": self.psfs / CAMERA_FILE,
            "dark": self.dark,
            "flat": self.flat,
        }
        return {
            role: path
            for role, path in roles.items()
            if path is not None and (role != "camera" or path.is_file())
        }

    @property
    def written(self) -> tuple[Written, ...]:
        """Pictures, stack and record."""
        names: dict[str, str] = {}
        if self.focused:
            names |= dict(zip(("picture", "linear picture"), FOCUSED_FILES, strict=True))
        if self.stack is not None:
            names |= STACK_FILES
        names["record of the run"] = RECORD_FILE
        return tuple(Written(what, self.output / name) for what, name in names.items())
