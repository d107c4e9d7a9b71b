"""Types of options that several jobs have, each with its range."""

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from nolens.camera.part import Counts, refusal
from nolens.camera.psf import Flip as TurnOver
from nolens.camera.psf_set import Depth, FieldAngle
from nolens.errors import OptionError
from nolens.jobs.options import RECORD, JobOptions, Option, Written, expand_home
from nolens.machine import DeviceName
from nolens.quantities import Angle, Duration, Percentage
from nolens.ranges import Between
from nolens.solvers import Prior
from nolens.solvers.psf_choice import Extent
from nolens.solvers.scene_prior import PRIORS

_WINDOW = re.compile(r"([0-9]{1,6})x([0-9]{1,6})(?:([+-][0-9]{1,6})([+-][0-9]{1,6}))?")
# Of Linux; temporary files add some characters to a name.
_LONGEST_NAME, _LONGEST_PATH = 220, 4000
_CONTROL = re.compile(rb"[\x00-\x1f\x7f]")

INPUT, SOLVER, PICTURE = "Files and channels", "Model and solver", "Picture"
RESULT, RUN = "Result", "How it runs"
"""Headings of options that several jobs have."""


def _possible(path: Path) -> Path:
    """Refuse a path that no system has, before it is asked for."""
    try:
        encoded = os.fsencode(path)
    except UnicodeEncodeError:
        raise refusal(
            "it has half of a character in it (a lone surrogate): give the whole name"
        ) from None
    if _CONTROL.search(encoded):
        raise refusal(
            "it has control characters, such as NUL or a new line: give a name without them"
        )
    if len(encoded) > _LONGEST_PATH or max(map(len, encoded.split(b"/"))) > _LONGEST_NAME:
        raise refusal(
            f"a name may have {_LONGEST_NAME} bytes and a path {_LONGEST_PATH}: give a shorter one"
        )
    return path


def record_beside(path: Path) -> Path:
    """File of the record that belongs to one that is written, whatever that is called."""
    return path.parent / f"{path.stem}.json"


def window_numbers(text: str) -> tuple[int, int, int | None, int | None]:
    """Height, width, top and left of HEIGHTxWIDTH or HEIGHTxWIDTH+TOP+LEFT.

    Raises
    ------
    OptionError
        If the text is neither, or a size is zero.
    """
    match = _WINDOW.fullmatch(text.strip())
    if match is None or 0 in (int(match[1]), int(match[2])):
        raise OptionError(
            "give HEIGHTxWIDTH or HEIGHTxWIDTH+TOP+LEFT in pixels, such as 400x400 or "
            "270x410+0+60, each below a million"
        )
    top, left = (None if each is None else int(each) for each in match.group(3, 4))
    return int(match[1]), int(match[2]), top, left


def _window(text: str) -> str:
    try:
        window_numbers(text)
    except OptionError as error:
        raise refusal(str(error)) from None
    return text


def check_detail(detail: float, tau: float | Literal["auto"]) -> None:
    """Refuse a factor on the automatic τ beside a τ that is stated.

    Raises
    ------
    OptionError
        If both are given.
    """
    if detail != 1 and tau != "auto":
        raise OptionError(
            f"--detail {detail:g} is a factor on the automatic tau, and --tau {tau:g} is a number: "
            "leave one out"
        )


def parts(pattern: str, needed: str) -> BeforeValidator:
    """Read a text as the groups of a pattern; `needed` says what to give instead of others."""

    def split(value: Any) -> Any:
        if not isinstance(value, str):
            return value
        match = re.fullmatch(pattern, value.strip())
        if match is None:
            raise refusal(needed)
        return match.groups()

    return BeforeValidator(split)


def two_parts(needed: str) -> BeforeValidator:
    """Read a text such as "8cm,1m" as two values, as `parts` does."""
    return parts(r"([^,]*?)\s*,\s*([^,]*)", needed)


def between(needed: str) -> BeforeValidator:
    """Read one value, or two such as "1,2", as the smallest and the largest."""

    def split(value: Any) -> Any:
        given = [each.strip() for each in value.split(",")] if isinstance(value, str) else value
        values = tuple(given) if isinstance(given, list | tuple) else (given,)
        if len(values) not in (1, 2):
            raise refusal(needed)
        return values[0], values[-1]

    return BeforeValidator(split)


def ordered(values: tuple[Any, Any]) -> tuple[Any, Any]:
    """Refuse a smallest value above the largest."""
    low, high = (getattr(each, "exact", each) for each in values)
    if low > high:
        raise refusal(f"{values[0]} is more than {values[1]}: give the smaller value first")
    return values


FilePath = Annotated[Path, AfterValidator(expand_home), AfterValidator(_possible)]
"""Of a file or folder; ~ is the home folder."""
Files = Annotated[tuple[FilePath, ...], Field(max_length=100_000)]
Name = Annotated[str, Field(max_length=_LONGEST_PATH)]
"""A preset or a path: of cameras and materials."""
Word = Annotated[str, Field(max_length=200)]
"""A choice, or a short expression that is read later."""
Window = Annotated[str, AfterValidator(_window), Field(max_length=40)]
"""HEIGHTxWIDTH, or HEIGHTxWIDTH+TOP+LEFT; what fits the measurement is known when it is read."""
Seed = Annotated[int, Between(0, 2**63 - 1)]
Iterations = Annotated[int, Between(1, 1_000_000)]
Tau = Annotated[float, Between(0, 1e6)]
ChosenTau = Annotated[
    Tau | Literal["auto"],
    Option(
        "Weight of the prior: less shows more detail, more hides noise. auto: the strongest with "
        "which pixels that are left out of the fit are predicted as well as they can be. A number "
        "means the same at any binning, support and number of channels.",
        SOLVER,
        label="τ, weight of the prior",
    ),
]
Detail = Annotated[
    Annotated[float, Between(0.01, 100)],
    Option(
        "How much detail: the automatic τ, and a trained prior's own weight, are divided by it. 2 "
        "shows more detail and more noise, 0.5 less of both.",
        label="Detail",
    ),
]
Bin = Annotated[int, Between(1, 64)]
"""Pixels along a superpixel; a sensor has no more detail to lose."""
FieldAngles = Annotated[
    tuple[FieldAngle, FieldAngle],
    two_parts("give two angles, to the right and up, such as 20deg,0deg"),
]
"""Of a point source, to the right and up as the photographer sees it."""
FullAngle = Annotated[Angle, Between("0.001 deg", "179.9 deg")]
"""From side to side."""
Exposure = Annotated[Duration, Between("0.001 µs", "1000000 s")]
Interval = Annotated[Duration, Between("1 µs", "1000000 s")]
Fraction = Annotated[Percentage, Between("0 %", "100 %")]
Distances = Annotated[tuple[Depth, ...], Field(max_length=1000)]
Mosaic = Literal["RGGB", "BGGR", "GRBG", "GBRG"]

CAMERAS = "paper, paper-film, small, live, a folder with camera.toml, or a .toml file"
"""What the name of a camera may be."""
LIGHTS = "white-led, daylight, equal-energy, or one wavelength such as 535nm"
"""What the spectrum of a light may be."""

# Options that several jobs have, each with its text: ``dark: Dark = None``.

Dark = Annotated[
    FilePath | None,
    Option(
        "Dark frame; it is subtracted, and holds the black level too.",
        INPUT,
        role="input",
        label="Dark frame",
    ),
]
Flat = Annotated[
    FilePath | None,
    Option(
        "Flat field; the measurement is divided by it.", INPUT, role="input", label="Flat field"
    ),
]
Black = Annotated[
    Counts | None,
    Option("Black level in counts. Camera raw says it.", INPUT, label="Black level"),
]
White = Annotated[
    Counts | None,
    Option(
        "Count from which a pixel is saturated. Camera raw and 8 or 16-bit files say it.",
        INPUT,
        label="Saturated from",
    ),
]
RawMosaic = Annotated[
    Word | None,
    Option(
        "RGGB, BGGR, GRBG or GBRG: a .tif, .png or .npy holds raw counts of a colour mosaic.",
        INPUT,
        label="Colour mosaic",
    ),
]
Bgr = Annotated[
    bool,
    Option("Colour channels are stored as B, G, R.", INPUT, label="Channels in the order B, G, R"),
]
Channels = Annotated[
    Word, Option("all, grey, or letters such as g or rg.", INPUT, label="Channels")
]
Support = Annotated[
    Window | None,
    Option(
        "Scene pixels that light can come from: HEIGHTxWIDTH around the middle of the sensor, or "
        "HEIGHTxWIDTH+TOP+LEFT in pixels of the sensor's frame.",
        default="no limit",
        former="region",
        label="Support of the scene",
    ),
]
ChosenSupport = Annotated[
    Window | Literal["auto", "full"],
    Option(
        "Scene pixels that light can come from. auto: the smallest rectangle outside which the "
        "measurement shows no light; where none explains it as well, and for a sequence or batch, "
        "what the camera accepts (camera.toml beside the PSF, or --camera), or else full. full: no "
        "limit. HEIGHTxWIDTH around the middle of the sensor, or "
        "HEIGHTxWIDTH+TOP+LEFT in pixels of the sensor's frame.",
        former="region",
        label="Support of the scene",
    ),
]
PsfExtent = Annotated[
    Extent,
    Option(
        "What a PSF file that is larger than the measurement shows. wide: it is extended, with "
        "light that falls beside the sensor. sensor: no more than the sensor sees, on finer "
        "pixels. auto: what explains the measurement.",
        INPUT,
        former="psf_wider",
        former_switch="wide",
        label="Larger PSF file",
    ),
]
PsfScale = Annotated[
    Bin | None,
    Option(
        "The PSF file is finer: N×N of its pixels are one of the measurement's.",
        INPUT,
        default="what explains the measurement",
        label="PSF pixels finer by",
    ),
]
PsfFlip = Annotated[
    Literal["auto", "none", "vertical", "horizontal", "both"],
    Option(
        "Turn the PSF over first, as --flip turns pictures. auto: only where it explains the "
        "measurement badly as it is, and clearly better turned over.",
        INPUT,
        label="Turn the PSF",
    ),
]
Device = Annotated[DeviceName, Option("Where to compute; auto takes CUDA where there is one.", RUN)]
Workers = Annotated[
    Annotated[int, Between(1, 1000)] | None,
    Option(
        "Worker processes of this machine, each with one thread.",
        default="as many as there are cores, and memory for",
        label="Worker processes",
    ),
]
Scheduler = Annotated[
    Word | None,
    Option(
        "Workers of a Dask cluster instead: the address of its scheduler, such as "
        "tcp://host:8786, or a scheduler file. They need the same version of nolens "
        "(nolens[cluster]), and none of the files.",
        RUN,
        label="Dask scheduler",
    ),
]
FieldPoints = Annotated[
    Annotated[int, Between(1, 1000)] | Literal["auto"],
    Option(
        "How many PSFs of a folder to take at most, spread over the field; 1 takes the one "
        "straight ahead for all of the scene. auto: all there are at that distance; reconstruct "
        "takes one where it explains the measurement clearly better.",
        SOLVER,
        label="PSFs over the field",
    ),
]
_PRIOR = Option("What the scene is assumed to be like.", SOLVER, label="Prior")
ScenePrior = Annotated[Prior, _PRIOR]


def _weights(path: Path) -> Path:
    if path.suffix.lower() != ".npz":
        raise refusal("an .npz of weights that nolens train wrote")
    return path


if TYPE_CHECKING:
    AnyPrior = str | Path
else:
    AnyPrior = Annotated[
        Literal[PRIORS] | Annotated[FilePath, AfterValidator(_weights)],
        Option(
            "What the scene is assumed to be like: tv is total variation, colour-tv that of the "
            "colours together, isotropic-tv that of all directions, l1 few bright points, none "
            "nothing; ridge, denoiser and unrolled are trained, and so is an .npz of your own "
            "(nolens train). auto: denoiser for a photo, and total variation for a sequence and "
            "where another option is about how to minimise.",
            SOLVER,
            # As of a material: a name that is known, or a file in its place.
            role="material",
            label="Prior",
        ),
    ]
Flip = Annotated[
    TurnOver,
    Option(
        "Turn the picture over: vertical exchanges top and bottom, horizontal left and right.",
        label="Turn the picture",
    ),
]


class OutputFolderOptions(JobOptions):
    """What the jobs have in common that make a folder, ``output``, with a record in it.

    Attributes
    ----------
    record_file
        Name of the record.
    """

    record_file: ClassVar[str]

    if TYPE_CHECKING:
        # Each job declares it at its own place among its fields, with its own text.
        output: FilePath

    @property
    def record(self) -> Path:
        """File of the run's record."""
        return self.output / self.record_file

    @property
    def output_folder(self) -> Path:
        """It is made where it does not exist."""
        return self.output

    def in_folder(self, names: Mapping[str, str]) -> tuple[Written, ...]:
        """Files in the folder, by role, and the record."""
        files = tuple(Written(what, self.output / name) for what, name in names.items())
        return (*files, Written(RECORD, self.record))


class RecordedOptions(JobOptions):
    """What the jobs have in common whose record goes beside the first file that they write."""

    @property
    def record(self) -> Path | None:
        """File of the run's record; None where nothing is written."""
        return record_beside(self.files[0].path) if self.files else None
