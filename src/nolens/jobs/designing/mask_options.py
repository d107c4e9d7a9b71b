"""What `nolens design mask` can be told, as a frozen model."""

import math
import re
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args

from pydantic import BeforeValidator
from pydantic_core import PydanticCustomError

from nolens.camera.part import PositiveLength
from nolens.design.masks import Arrangement, Limits, PsfGoals
from nolens.errors import OptionError
from nolens.files import CAMERA_FILE
from nolens.jobs.device import DeviceName
from nolens.jobs.fields import FilePath, Iterations, Name, Seed, Word
from nolens.jobs.options import JobOptions, Written
from nolens.quantities import Angle, Length, Share
from nolens.ranges import Between

RELIEF_FILE, PICTURE_FILE, RECORD_FILE = "relief.tif", "mask.png", "mask.json"
"""What is written into the camera's folder beside its description."""
_MAGNITUDE = re.compile(r"(.*%)\s*@\s*([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\s*/\s*mm")

Kind = Literal["random-lenslets", "lenslet-array", "diffuser", "contour", "optimised"]


def _refusal(reason: str) -> PydanticCustomError:
    return PydanticCustomError("refused", "{reason}", {"reason": reason})


def _share_and_frequency(given: Any) -> Any:
    if not isinstance(given, str):
        return given
    match = _MAGNITUDE.fullmatch(given.strip())
    if match is None:
        raise _refusal("give a share and a spatial frequency, such as 6%@80/mm")
    return match[1], float(match[2])


_Magnitude = Annotated[Share, Between("0.01 %", "100 %")]
_PerMm = Annotated[float, Between(1e-3, 1e5)]
SmallAngle = Annotated[Angle, Between("0.001 deg", "44.9 deg")]
_LENSLETS: dict[str, Any] = {"radius": None, "pitch": Length("70", "um")}
_DESIGNED: dict[str, Any] = {
    "radius": None,
    "height": Length("12", "um"),
    "slope": Angle("5.4", "deg"),
    "feature": Length("8", "um"),
    "levels": None,
    "period": None,
}
USED: dict[str, dict[str, Any]] = {
    "random-lenslets": {**_LENSLETS, "smoothing": Length("11", "um")},
    "lenslet-array": {**_LENSLETS, "smoothing": Length("2", "um"), "arrangement": "hexagonal"},
    "diffuser": {"angle": Angle("1", "deg"), "feature": Length("30", "um")},
    "contour": {
        **_DESIGNED,
        "line": Length("12", "um"),
        "spacing": Length("250", "um"),
        "iterations": 60,
    },
    "optimised": {
        **_DESIGNED,
        "pitch": None,
        "width": Length("8", "um"),
        "sparsity": Share("98", "%"),
        "magnitude": (Share("6", "%"), 80.0),
        "iterations": 100,
    },
}
"""Options that each kind of mask has, and what they are where they are not given."""


class MaskOptions(JobOptions):
    """What `nolens design mask` can be told.

    Attributes
    ----------
    kind
        Of the mask; `USED` says which of the options from `radius` on it has.
    camera
        Preset, folder or .toml file: the layers and the sensor that the mask is for.
    output
        Folder of the camera with the mask.
    light
        As in the simulations.
    seed
        Of what is random.
    overhang
        How far the mask reaches beyond the sensor; None takes what the camera has, or 1.5 mm.
    device
        auto, cpu or cuda.
    radius
        Radius of curvature of lenslets and lines; None takes the one that focuses on the sensor.
    pitch
        Mean distance of lenslets.
    smoothing
        Width of the Gaussian that rounds the edges between them.
    arrangement
        Of a regular array.
    angle
        Full width at half maximum of what a diffuser scatters, in air.
    feature
        Smallest feature; of a diffuser, the distance over which heights are alike.
    height, slope, levels
        Limits of the process.
    period
        Side of the square that a designed mask repeats; None takes `default_period_um`.
    line, spacing
        Width of a contour PSF's lines, and wavelength of the random field they come from.
    width, sparsity, magnitude
        Wanted figures of an optimised PSF; see `PsfGoals`.
    iterations
        Of the descent.
    """

    kind: Kind
    camera: Name = "paper"
    output: FilePath
    light: Word = "white-led"
    seed: Seed = 0
    overhang: PositiveLength | None = None
    device: DeviceName = "auto"
    radius: PositiveLength | None = None
    pitch: PositiveLength | None = None
    smoothing: PositiveLength | None = None
    arrangement: Arrangement | None = None
    angle: SmallAngle | None = None
    feature: PositiveLength | None = None
    height: PositiveLength | None = None
    slope: SmallAngle | None = None
    levels: Annotated[int, Between(2, 65536)] | None = None
    period: PositiveLength | None = None
    line: PositiveLength | None = None
    spacing: PositiveLength | None = None
    width: PositiveLength | None = None
    sparsity: Annotated[Share, Between("0 %", "99.99 %")] | None = None
    magnitude: (
        Annotated[tuple[_Magnitude, _PerMm], BeforeValidator(_share_and_frequency)] | None
    ) = None
    iterations: Iterations | None = None

    @classmethod
    def gather(cls, given: dict[str, Any]) -> Self:
        """Options as the command line gives them, and the defaults of the kind.

        Raises
        ------
        OptionError
            If one is missing, its value cannot be used, or the kind does not have it.
        """
        kinds = get_args(Kind)
        if given.get("kind") is None:
            raise OptionError(f"no kind of mask is given: {', '.join(kinds)}")
        if not given.get("output"):
            raise OptionError("no output is given; name the folder of the new camera (-o folder)")
        used = USED.get(str(given["kind"]), {})
        options = cls.checked({**used, **given})
        special = {name for each in USED.values() for name in each}
        foreign = [name for name in given if name in special and name not in used]
        if foreign:
            raise OptionError(
                f"--{foreign[0]} {given[foreign[0]]}: a mask of the kind {options.kind} does not "
                f"have it; it has {', '.join('--' + name for name in used)}"
            )
        smoothing, pitch = options.smoothing, options.pitch
        if smoothing is not None and pitch is not None and smoothing.exact >= pitch.exact:
            raise OptionError(
                f"--smoothing {smoothing} rounds lenslets away that are {pitch} apart: give less "
                "than their --pitch, such as a tenth of it"
            )
        return options

    @property
    def limits(self) -> Limits:
        """Limits of the process, of the kinds that have them."""
        assert self.height is not None and self.slope is not None and self.feature is not None
        return Limits(self.height.um, math.tan(self.slope.rad), self.feature.um, self.levels)

    @property
    def goals(self) -> PsfGoals:
        """Wanted figures, of an optimised mask."""
        assert self.width is not None and self.sparsity is not None and self.magnitude is not None
        share, per_mm = self.magnitude
        return PsfGoals(self.width.um, self.sparsity.value, share.value, per_mm)

    @property
    def inputs(self) -> dict[str, Path]:
        """No files but the camera's."""
        return {}

    @property
    def written(self) -> tuple[Written, ...]:
        """Description, relief, picture and record."""
        names = {
            "camera": CAMERA_FILE,
            "relief": RELIEF_FILE,
            "picture of the mask": PICTURE_FILE,
            "record": RECORD_FILE,
        }
        if self.kind == "random-lenslets":
            del names["relief"]
        return tuple(Written(what, self.output / name) for what, name in names.items())
