"""A camera with another mask: what all kinds of masks share, and the job that makes one.

A kind is a class of options that derives from `MaskOptions` and makes its mask. It is known by its
name in `MASK_KINDS`, or by an entry point of another package (``nolens.masks``).
"""

import math
from abc import abstractmethod
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar

import torch

from nolens.camera import LoadedCamera, RandomLenslets
from nolens.camera.part import PositiveLength
from nolens.design.masks import (
    RELIEF_FILE,
    Blank,
    Limits,
    MadeMask,
    MaskComparison,
    TileDescent,
)
from nolens.files import CAMERA_FILE, write_camera
from nolens.files.cameras import curve_copies
from nolens.files.plot_design import plot_mask
from nolens.jobs.fields import (
    CAMERAS,
    LIGHTS,
    Device,
    FilePath,
    Iterations,
    Name,
    OutputFolderOptions,
    Seed,
    Word,
)
from nolens.jobs.options import Option, Written
from nolens.jobs.run import (
    Product,
    Reporter,
    Run,
    Writer,
    announce_memory,
    job,
)
from nolens.machine import pick_device
from nolens.plugins import Registry
from nolens.quantities import Angle, Length
from nolens.ranges import Between
from nolens.twin import Light, preview_model

DESCENT = "Descent"
"""Headings of options of masks that repeat a tile."""
Steps = Annotated[Iterations, Option("Steps, at most.", DESCENT)]
SmallAngle = Annotated[Angle, Between("0.001 deg", "44.9 deg")]

_PICTURE_FILE = "mask.png"
_OPTICS, _PROCESS, _RESULT = "Camera and light", "Process", "Result"
_Levels = Annotated[int, Between(2, 65536)]
_OVERHANG = Length("1.5", "mm")


class MaskOptions(OutputFolderOptions):
    """Options that every kind of mask has: a kind derives from it, with fields of its own.

    Attributes
    ----------
    kind
        Its name.
    """

    usage = "design mask KIND -o FOLDER"
    record_file = "mask.json"
    kind: ClassVar[str]

    output: Annotated[
        FilePath,
        Option(
            "Folder of the new camera: camera.toml, relief.tif, mask.png (a picture of relief and "
            "PSF) and mask.json (the record).",
            needed="the folder of the new camera (-o folder)",
            role="output",
            flag="-o",
        ),
    ]
    camera: Annotated[
        Name,
        Option(f"Camera with the layers and the sensor to design for: {CAMERAS}.", role="camera"),
    ] = "paper"
    light: Annotated[Word, Option(f"{LIGHTS}.", _OPTICS)] = "white-led"
    device: Device = "auto"
    seed: Annotated[Seed, Option("Of what is random.", _RESULT)] = 0
    overhang: Annotated[
        PositiveLength | None,
        Option(
            "How far the mask extends beyond the sensor.",
            _RESULT,
            default="as in the camera, or 1.5mm",
        ),
    ] = None

    @abstractmethod
    def mask(self, blank: Blank) -> MadeMask:
        """Make the mask.

        Parameters
        ----------
        blank
            The camera that it is for.

        Raises
        ------
        OptionError
            If there is no such mask, it is too steep for any grid, limits contradict each other,
            or the machine has too little memory.
        """

    def blank(self, loaded: LoadedCamera, reporter: Reporter) -> Blank:
        """The camera that the mask is made for, by the name that it will have.

        Raises
        ------
        OptionError
            If the light or the device cannot be used.
        """
        name = f"{loaded.camera.name}, {self.kind} mask"
        relief = loaded.camera.mask.relief
        own = relief.overhang if isinstance(relief, RandomLenslets) else _OVERHANG
        return Blank(
            replace(loaded, camera=loaded.camera.model_copy(update={"name": name})),
            preview_model(loaded),
            Light(self.light),
            self.overhang or own,
            pick_device(self.device),
            lambda needed: announce_memory(needed, reporter),
            lambda done, limit: reporter.step("step", done, limit, "the mask"),
        )

    @property
    def written(self) -> tuple[Written, ...]:
        """Description, relief, picture and record."""
        names = {
            "camera": CAMERA_FILE,
            "relief": RELIEF_FILE,
            "picture of the mask": _PICTURE_FILE,
        }
        return self.in_folder(names)


class TileOptions(MaskOptions):
    """Options of masks that repeat a tile; a kind derives from it."""

    radius: Annotated[
        PositiveLength | None,
        Option(
            "Radius of curvature of the lenslets or lines that it begins with.",
            DESCENT,
            default="what focuses on the sensor",
        ),
    ] = None
    iterations: Steps
    feature: Annotated[PositiveLength, Option("Smallest feature.", _PROCESS)] = Length("8", "um")
    height: Annotated[PositiveLength, Option("Largest height of the relief.", _PROCESS)] = Length(
        "12", "um"
    )
    slope: Annotated[SmallAngle, Option("Steepest slope.", _PROCESS)] = Angle("5.4", "deg")
    levels: Annotated[
        _Levels | None,
        Option(
            "Number of heights that the process makes, from the lowest to --height above it.",
            _PROCESS,
            default="any height",
        ),
    ] = None
    period: Annotated[
        PositiveLength | None,
        Option(
            "Side of the square that the mask repeats.",
            _PROCESS,
            default="the width of a 75deg scene on the sensor, or of the aperture",
        ),
    ] = None

    @property
    def limits(self) -> Limits:
        """Limits of the process."""
        return Limits(self.height.um, math.tan(self.slope.rad), self.feature.um, self.levels)

    @abstractmethod
    def heights(self, descent: TileDescent) -> tuple[torch.Tensor, torch.Tensor | None]:
        """Heights of the tile in um, and the PSF that was the target where one was drawn."""

    def mask(self, blank: Blank) -> MadeMask:
        """Design the tile, and spread it over the sensor."""
        return blank.tiled(
            self.limits,
            self.heights,
            radius_um=None if self.radius is None else self.radius.um,
            period_um=None if self.period is None else self.period.um,
            iterations=self.iterations,
        )


_HERE = "nolens.jobs.designing"
MASK_KINDS = Registry[type[MaskOptions]](
    "nolens.masks",
    {
        "random-lenslets": f"{_HERE}.mask_lenslets:RandomLensletsMask",
        "lenslet-array": f"{_HERE}.mask_lenslets:LensletArrayMask",
        "diffuser": f"{_HERE}.mask_diffuser:DiffuserMask",
        "contour": f"{_HERE}.mask_contour:ContourMask",
        "optimised": f"{_HERE}.mask_optimised:OptimisedMask",
    },
    "kind of mask",
    "class of MaskOptions",
    lambda each: isinstance(each, type) and issubclass(each, MaskOptions),
)


def with_mask(kind: str, loaded: LoadedCamera, reporter: Reporter, **options: Any) -> LoadedCamera:
    """A camera with another mask, in memory.

    Parameters
    ----------
    kind
        A name in `MASK_KINDS`.
    loaded
        The camera with the layers and the sensor.
    reporter
        Learns what is done.
    options
        Of that kind, by name.

    Raises
    ------
    OptionError
        If there is no such kind or option, or a value cannot be used.
    """
    # Nothing is written: the folder is an option of the job alone.
    of_kind = MASK_KINDS.load(kind).gather({**options, "output": Path("unused")})
    return of_kind.mask(of_kind.blank(loaded, reporter)).loaded


@job
def design_mask(run: Run[MaskOptions]) -> Product[LoadedCamera]:
    """Design a mask for a camera and write the camera that has it.

    Raises
    ------
    NolensError
        If an option or an output cannot be used; then nothing is written.
    """
    options, reporter = run.options, run.reporter
    loaded = run.camera(options.camera)
    blank = options.blank(loaded, reporter)
    run.begin()
    made = options.mask(blank)
    comparison = MaskComparison.of(blank, made, partial(reporter.advance, "figures"))
    name = made.loaded.camera.name
    summary = {"camera": name, "kind": options.kind, **comparison.summary()}
    plot = partial(plot_mask, comparison=comparison, title=name)
    more: dict[str, Writer] = {**curve_copies(options.camera, loaded), _PICTURE_FILE: plot}

    return Product(
        made.loaded,
        summary,
        {options.output / name: write for name, write in more.items()},
        parameters={"kind": options.kind},
        outputs=tuple(each.path for each in options.written if each.path != options.record),
        commit=lambda files: write_camera(
            options.output, made.loaded.camera, made.loaded.relief_um, more=files
        ),
    )
