"""Options of `nolens refocus`."""

import math
import re
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator

from nolens.camera.part import refusal
from nolens.camera.psf_set import Depth
from nolens.errors import OptionError
from nolens.files import CAMERA_FILE, PSFS_FILE
from nolens.jobs.fields import (
    INPUT,
    MAIN,
    SOLVER,
    Bgr,
    Bin,
    Black,
    Channels,
    Dark,
    Device,
    FilePath,
    Flat,
    Flip,
    Iterations,
    RawMosaic,
    ScenePrior,
    Support,
    Tau,
    White,
)
from nolens.jobs.options import JobOptions, Option, Written
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


_DEPTH = "Depth"


class RefocusOptions(JobOptions):
    """Focus a photograph at any depth, after it was taken.

    nolens refocus raw.dng --psfs camera -o out

    nolens refocus raw.dng --psfs camera --stack 8cm,50cm -o out

    Without --depth the sharpest depth is found: the one whose PSF explains the photograph best,
    or with --at the one at which that place is sharpest.
    """

    usage = "refocus RAW --psfs FOLDER -o FOLDER"

    measurement: Annotated[
        FilePath,
        Option(
            "What the sensor measured: camera raw, .png, .tif or .npy.",
            needed="the measurement (nolens refocus RAW --psfs FOLDER -o FOLDER)",
            role="input",
            positional=True,
            label="Raw file",
        ),
    ]
    psfs: Annotated[
        FilePath,
        Option(
            f"Folder with the camera's PSFs at some distances ({PSFS_FILE}, as nolens calibrate "
            "writes it), and camera.toml where there is one. Between distances PSFs are magnified.",
            needed=f"the folder with the camera's {PSFS_FILE} (--psfs FOLDER)",
            role="input",
            label="Camera",
        ),
    ]
    output: Annotated[
        FilePath,
        Option(
            "Folder for the pictures: focused.png, focused.tif (16 bits, linear) and "
            "refocus.json (the record); with --stack also stack.tif (for ImageJ), sweep.png "
            "(animated), sweep.html (a page with a slider), all-in-focus.png, depth.png and "
            "depth.tif (mm).",
            needed="the folder for the pictures (-o FOLDER)",
            role="output",
            flag="-o",
        ),
    ]
    depth: Annotated[
        Depth | None,
        Option(
            "Distance that is to be sharp, such as 8cm, or infinity.",
            _DEPTH,
            default="the sharpest",
        ),
    ] = None
    at: Annotated[
        tuple[_Row, _Row] | None,
        BeforeValidator(_place),
        Option(
            "ROW,COLUMN of focused.png, in pixels: what is to be sharp.",
            _DEPTH,
            default="the whole picture",
        ),
    ] = None
    search: Annotated[
        Depths | None,
        Option(
            "NEAR,FAR: depths between which the sharpest is sought, such as 8cm,infinity.",
            _DEPTH,
            default="the distances of the PSFs",
        ),
    ] = None
    stack: Annotated[
        Depths | None,
        Option(
            "NEAR,FAR: pictures at depths from near to far, in equal steps of 1/distance. Without "
            "--depth or --at, focused.png is left out.",
            _DEPTH,
            label="Nearest and Farthest",
        ),
    ] = None
    steps: Annotated[int, Between(2, _MOST_STEPS), Option("How many.", _DEPTH, label="Depths")] = 9
    support: Support = None
    tau: Annotated[
        Tau, Option("Weight of the prior.", MAIN, default="1e-4", label="τ, weight of the prior")
    ] = 1e-4
    dark: Dark = None
    flat: Flat = None
    black: Black = None
    white: White = None
    mosaic: RawMosaic = None
    bgr: Bgr = False
    channels: Channels = "all"
    bin: Annotated[Bin, Option("Average N×N pixels into one.", INPUT, label="Binning")] = 1
    prior: ScenePrior = Prior.TV
    iterations: Annotated[
        Iterations,
        Option(
            "Limit of the iterations for a picture; while searching, at most 60.",
            SOLVER,
            label="Iterations, at most",
        ),
    ] = 100
    device: Device = "auto"
    flip: Flip = "none"

    def check_together(self) -> None:
        """Refuse a depth that is stated and sought, and steps or a search without their use."""
        if self.depth is not None:
            for name, value in (("at", self.at), ("search", self.search)):
                if value is not None:
                    raise OptionError(
                        f"--depth {self.depth} says the depth, and --{name} has it found: "
                        "leave one out"
                    )
        if "steps" in self.model_fields_set and self.stack is None:
            raise OptionError(
                f"--steps {self.steps} are those of a focal stack: say between which depths, "
                "such as --stack 8cm,50cm"
            )
        if self.search is not None and not self.focused:
            raise OptionError(
                "--search looks for the sharpest depth, and --stack alone looks for none: add "
                "--at, or leave one out"
            )

    @property
    def focused(self) -> bool:
        """Whether a picture at one depth is written."""
        return self.stack is None or self.depth is not None or self.at is not None

    @property
    def record(self) -> Path:
        """File of the run's record."""
        return self.output / RECORD_FILE

    @property
    def output_folder(self) -> Path:
        """It is made where it does not exist."""
        return self.output

    @property
    def inputs(self) -> dict[str, Path]:
        """Files that are read, by role, but for the PSFs."""
        files = super().inputs
        files["list of PSFs"] = files.pop("psfs") / PSFS_FILE
        camera = self.psfs / CAMERA_FILE
        return files | {"camera": camera} if camera.is_file() else files

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
