"""Every option of a reconstruction, as one frozen model: the command line's and the TOML's."""

import difflib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, ValidationError

from nolens.camera import BlackLevel
from nolens.camera.part import Counts
from nolens.documents import parse_toml
from nolens.errors import OptionError
from nolens.files import read_text
from nolens.jobs.device import DeviceName
from nolens.jobs.fields import (
    Bin,
    FilePath,
    Files,
    FullAngle,
    Interval,
    Iterations,
    Name,
    Tau,
    Window,
    Word,
    record_beside,
    window_numbers,
)
from nolens.jobs.options import JobOptions, Written, check_apart, expand_home, explain
from nolens.operators import Region
from nolens.printable import quoted
from nolens.ranges import Between
from nolens.solvers import Method, Prior, Quality

_Penalty = Annotated[float, Between(1e-9, 1e9)]


class ReconstructOptions(JobOptions):
    """What `nolens reconstruct` can be told; a TOML file holds the same names.

    Attributes
    ----------
    measurement, psf
        Files of the measurement and of the point spread function.
    output
        Pictures to write: .png (8-bit sRGB), .tif (linear).
    tiff_bits
        16 (scaled so that white is 65535) or 32 (radiance as it is).
    dark, flat
        Files of a dark frame (it holds the black level too) and of a flat field.
    black
        Black level in counts; "auto" reads it off the PSF's darkest corner. None takes what
        the files say.
    white
        Count from which a pixel is saturated, where the files do not say.
    mosaic
        Colour mosaic of a TIFF, PNG or npy that holds raw counts.
    bgr
        The files' channels are in the order B, G, R.
    psf_scale, psf_wider
        Which of the two a larger PSF file is: finer by this factor, or wider.
    quality
        draft, photo or exact: how to solve and when to stop. None is photo, or what `method` says.
    method
        Solver.
    tau
        Weight of the prior (Wiener: of ‖v‖²/2), in unit norms. None takes the method's own.
    prior
        What the scene is assumed to be like.
    iterations, tolerance
        Limit, and relative residual at which to stop. None takes the preset's own. In a sequence,
        the iterations of every frame after the first.
    smooth_part
        Whether ADMM solves for the smooth part of a full view directly. None takes the preset's.
    resume
        State file of an interrupted run to go on with.
    latency
        Longest time for a frame of a sequence.
    penalties
        μ₁, μ₂, μ₃ of ADMM to start with. None leaves them to the program.
    balance
        Whether ADMM's penalties are balanced as it runs.
    relaxation
        α of ADMM, between 0 and 2.
    bin
        Cells of bin × bin pixels. None makes them no finer than the PSF carries.
    channels
        all, grey, or letters such as g or rg.
    region
        Cells that light can come from: HEIGHTxWIDTH around the middle of the sensor, or
        HEIGHTxWIDTH+TOP+LEFT in the cells of the sensor's frame.
    field, camera
        Angle from side to side that light can come from, and the camera (preset, folder, .toml)
        whose layers make cells of it.
    crop
        Part of the scene that is written, in the same notation, or "all". None takes the
        region, or without one the sensor's frame.
    flip
        Turns the picture over: vertical, horizontal or both.
    device
        auto, cpu or cuda.
    """

    measurement: FilePath
    psf: FilePath
    output: Files = Field(min_length=1)
    tiff_bits: Literal[16, 32] = 16
    dark: FilePath | None = None
    flat: FilePath | None = None
    black: BlackLevel = None
    white: Counts | None = None
    mosaic: Word | None = None
    bgr: bool = False
    psf_scale: Bin | None = None
    psf_wider: bool = False
    quality: Quality | None = None
    method: Method = Method.ADMM
    tau: Tau | None = None
    prior: Prior = Prior.TV
    iterations: Iterations | None = None
    tolerance: Annotated[float, Between(0, 1)] | None = None
    smooth_part: bool | None = None
    resume: FilePath | None = None
    latency: Interval | None = None
    penalties: tuple[_Penalty, _Penalty, _Penalty] | None = None
    balance: bool = True
    relaxation: Annotated[float, Between(0.01, 1.99)] = 1.8
    bin: Bin | None = None
    channels: Word = "all"
    region: Window | None = None
    field: FullAngle | None = None
    camera: Name | None = None
    crop: Window | Literal["all"] | None = None
    flip: Literal["none", "vertical", "horizontal", "both"] = "none"
    device: DeviceName = "auto"

    @classmethod
    def gather(cls, given: dict[str, Any], config: Path | None) -> "ReconstructOptions":
        """Options from the command line and, for what it leaves out, from a TOML file.

        Parameters
        ----------
        given
            Options that were given, by name.
        config
            TOML file with any of the same names; relative paths in it start from its folder.

        Raises
        ------
        FileError
            If the TOML file cannot be read.
        DataError
            If it is no TOML file.
        OptionError
            If a name is unknown (with the nearest known one) or a value cannot be used.
        """
        config = expand_home(config) if config else None
        stored = _read_config(config) if config else {}
        values = {**stored, **given}
        for name in values:
            if name not in cls.model_fields:
                raise OptionError(
                    f"{config} has the key {name!r}, which is no option{_nearest(name, cls)}"
                )
        for name, what in (
            ("measurement", "the measurement (nolens reconstruct RAW --psf PSF -o out.png)"),
            ("psf", "the point spread function (--psf FILE)"),
            ("output", "the picture to write (-o out.png)"),
        ):
            if not values.get(name):
                raise OptionError(f"no {name} is given; name {what}")
        try:
            options = cls.model_validate(values)
        except ValidationError as error:
            raise OptionError(explain(error, dict.fromkeys({*stored} - {*given}, config))) from None
        if config:
            check_apart(options, {"configuration": config})
        return options

    @property
    def inputs(self) -> dict[str, Path]:
        """Files that are read, by role."""
        roles = {
            "measurement": self.measurement,
            "psf": self.psf,
            "dark": self.dark,
            "flat": self.flat,
        }
        return {role: path for role, path in roles.items() if path is not None}

    @property
    def bin_by(self) -> int:
        """Pixels along a cell, as far as it is said."""
        return 1 if self.bin is None else self.bin

    @property
    def record(self) -> Path:
        """File of the run's record."""
        return record_beside(self.output[0])

    @property
    def state(self) -> Path:
        """File of the state that an interrupted run leaves."""
        return self.output[0].with_suffix(".state.npz")

    def check_single(self) -> None:
        """Refuse what only a sequence can be told.

        Raises
        ------
        OptionError
            If there is such an option.
        """
        if self.latency is not None:
            raise OptionError(
                f"--latency {self.latency} bounds the frames of a sequence, and {self.measurement} "
                "is one frame: leave it out, or give a folder or a stack of frames"
            )

    @property
    def written(self) -> tuple[Written, ...]:
        """Pictures and record."""
        pictures = tuple(Written("output", path) for path in self.output)
        return (*pictures, Written("record of the run", self.record))


def parse_window(text: str, sensor: tuple[int, int], option: str) -> Region:
    """Read HEIGHTxWIDTH or HEIGHTxWIDTH+TOP+LEFT.

    Raises
    ------
    OptionError
        If the text is neither, or a size is zero.
    """
    try:
        height, width, top, left = window_numbers(text)
    except OptionError as error:
        raise OptionError(f"{option} is {quoted(text)}: {error}") from None
    if top is None or left is None:
        return Region.centred(height, width, sensor)
    return Region(top, left, height, width)


def _read_config(path: Path) -> dict[str, Any]:
    values = parse_toml(read_text(path), str(path))
    names = [name.replace("-", "_") for name in values]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise OptionError(f"{path} has the key {twice} twice, with _ and with -: leave one out")
    values = dict(zip(names, values.values(), strict=True))
    for name in ("measurement", "psf", "dark", "flat", "resume"):
        if isinstance(values.get(name), str):
            values[name] = path.parent / expand_home(Path(values[name]))
    if "output" in values:
        output = values["output"]
        files = [output] if isinstance(output, str) else output
        if not isinstance(files, list) or not all(isinstance(file, str) for file in files):
            raise OptionError(f"output in {path} is {output!r}; give a file name or a list of them")
        values["output"] = tuple(path.parent / expand_home(Path(file)) for file in files)
    return values


def _nearest(name: str, model: type[BaseModel]) -> str:
    near = difflib.get_close_matches(name, model.model_fields, n=1)
    return (
        f". Did you mean {near[0]!r}?" if near else f"; known are {', '.join(model.model_fields)}"
    )
