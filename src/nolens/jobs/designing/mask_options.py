"""Options of `nolens design mask`."""

import math
import re
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import BeforeValidator, model_validator

from nolens.camera.part import PositiveLength, refusal
from nolens.design.masks import Arrangement, Limits, PsfGoals
from nolens.errors import OptionError
from nolens.files import CAMERA_FILE
from nolens.jobs.fields import (
    CAMERAS,
    LIGHTS,
    Device,
    FilePath,
    Iterations,
    Name,
    Seed,
    Word,
)
from nolens.jobs.options import JobOptions, Option, Written
from nolens.quantities import Angle, Length, Share
from nolens.ranges import Between

RELIEF_FILE, PICTURE_FILE, RECORD_FILE = "relief.tif", "mask.png", "mask.json"
"""What is written into the camera's folder beside its description."""
_MAGNITUDE = re.compile(r"(.*%)\s*@\s*([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\s*/\s*mm")

_OPTICS, _LENSLETS, _RESULT = "Camera and light", "Lenslets", "Result"
_PROCESS, _WANTED = "Process (contour, optimised)", "Wanted PSF"

Kind = Literal["random-lenslets", "lenslet-array", "diffuser", "contour", "optimised"]
_KINDS = get_args(Kind)


def _share_and_frequency(given: Any) -> Any:
    if not isinstance(given, str):
        return given
    match = _MAGNITUDE.fullmatch(given.strip())
    if match is None:
        raise refusal("give a fraction and a spatial frequency, such as 6%@80/mm")
    return match[1], float(match[2])


_Magnitude = Annotated[Share, Between("0.01 %", "100 %")]
_PerMm = Annotated[float, Between(1e-3, 1e5)]
_MagnitudeAt = Annotated[tuple[_Magnitude, _PerMm], BeforeValidator(_share_and_frequency)]
_Sparsity = Annotated[Share, Between("0 %", "99.99 %")]
_Levels = Annotated[int, Between(2, 65536)]
SmallAngle = Annotated[Angle, Between("0.001 deg", "44.9 deg")]
_OF_LENSLETS: dict[str, Any] = {"radius": None, "pitch": Length("70", "um")}
_OF_DESIGNS: dict[str, Any] = {
    "radius": None,
    "height": Length("12", "um"),
    "slope": Angle("5.4", "deg"),
    "feature": Length("8", "um"),
    "levels": None,
    "period": None,
}
USED: dict[str, dict[str, Any]] = {
    "random-lenslets": {**_OF_LENSLETS, "smoothing": Length("11", "um")},
    "lenslet-array": {**_OF_LENSLETS, "smoothing": Length("2", "um"), "arrangement": "hexagonal"},
    "diffuser": {"angle": Angle("1", "deg"), "feature": Length("30", "um")},
    "contour": {
        **_OF_DESIGNS,
        "line": Length("12", "um"),
        "spacing": Length("250", "um"),
        "iterations": 60,
    },
    "optimised": {
        **_OF_DESIGNS,
        "pitch": None,
        "width": Length("8", "um"),
        "sparsity": Share("98", "%"),
        "magnitude": (Share("6", "%"), 80.0),
        "iterations": 100,
    },
}
"""Options that each kind of mask has, and what they are where they are not given."""


class MaskOptions(JobOptions):
    """Design a mask for a camera, and write the camera that has it.

    nolens design mask optimised --camera paper -o designed

    The kinds: random-lenslets (the paper's model of its diffuser), lenslet-array (regular),
    diffuser (a Gaussian surface), contour (a PSF of thin lines, by near-field phase retrieval; such
    masks made by edge filtering are the subject of the patent application US 2025/0377536 A1),
    optimised (a PSF of wanted width, sparsity and spectrum, by following the gradient through the
    camera's own layers).
    """

    usage = "design mask KIND -o FOLDER"

    kind: Annotated[
        Kind,
        Option(
            f"{', '.join(_KINDS[:-1])} or {_KINDS[-1]}.",
            needed=f"one of {', '.join(_KINDS)}",
            positional=True,
        ),
    ]
    output: Annotated[
        FilePath,
        Option(
            "Folder of the new camera: camera.toml, relief.tif, mask.png (a picture of relief and "
            "PSF) and mask.json (the record).",
            _RESULT,
            needed="the folder of the new camera (-o folder)",
            role="output",
            flag="-o",
        ),
    ]
    camera: Annotated[
        Name, Option(f"{CAMERAS}: its layers and sensor are kept.", _OPTICS, role="camera")
    ] = "paper"
    light: Annotated[Word, Option(f"{LIGHTS}.", _OPTICS)] = "white-led"
    device: Device = "auto"
    seed: Annotated[Seed, Option("Of what is random.", _RESULT)] = 0
    overhang: Annotated[
        PositiveLength | None,
        Option(
            "How far the mask reaches beyond the sensor.",
            _RESULT,
            default="as in the camera, or 1.5mm",
        ),
    ] = None
    radius: Annotated[
        PositiveLength | None,
        Option(
            "Radius of curvature of lenslets, and of the lines that contour begins with.",
            _LENSLETS,
            default="what focuses on the sensor",
        ),
    ] = None
    pitch: Annotated[
        PositiveLength | None,
        Option(
            "Mean distance of lenslets; of those that optimised begins with.",
            _LENSLETS,
            default="70um; for optimised, as large as the slope allows",
        ),
    ] = None
    smoothing: Annotated[
        PositiveLength | None,
        Option(
            "Width of the Gaussian that rounds the edges between lenslets.",
            _LENSLETS,
            default="11um; for lenslet-array 2um",
        ),
    ] = None
    arrangement: Annotated[
        Arrangement | None, Option("For lenslet-array.", _LENSLETS, default="hexagonal")
    ] = None
    angle: Annotated[
        SmallAngle | None,
        Option(
            "For diffuser, full width at half maximum of the light that it scatters, in air.",
            _WANTED,
            default="1deg",
        ),
    ] = None
    line: Annotated[
        PositiveLength | None, Option("For contour, width of a line.", _WANTED, default="12um")
    ] = None
    spacing: Annotated[
        PositiveLength | None,
        Option("For contour, lines lie about half of this apart.", _WANTED, default="250um"),
    ] = None
    width: Annotated[
        PositiveLength | None,
        Option("For optimised, of the PSF's autocorrelation, at most.", _WANTED, default="8um"),
    ] = None
    sparsity: Annotated[
        _Sparsity | None,
        Option(
            "For optimised, fraction of the sensor without light, at least.",
            _WANTED,
            default="98%",
        ),
    ] = None
    magnitude: Annotated[
        _MagnitudeAt | None,
        Option(
            "For optimised, spectral magnitude of 1 mm2 of the PSF, at least, up to a spatial "
            "frequency on the sensor.",
            _WANTED,
            default="6%@80/mm",
        ),
    ] = None
    feature: Annotated[
        PositiveLength | None,
        Option(
            "Smallest feature; for diffuser, the distance over which heights are alike.",
            _PROCESS,
            default="8um; for diffuser 30um",
        ),
    ] = None
    height: Annotated[
        PositiveLength | None, Option("Largest height of the relief.", _PROCESS, default="12um")
    ] = None
    slope: Annotated[SmallAngle | None, Option("Steepest slope.", _PROCESS, default="5.4deg")] = (
        None
    )
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
    iterations: Annotated[
        Iterations | None,
        Option("Steps of the descent.", _PROCESS, default="60; for optimised 100"),
    ] = None

    @model_validator(mode="before")
    @classmethod
    def _as_its_kind_has_it(cls, given: Any) -> Any:
        """What is not given is as `USED` has it for the kind."""
        return {**USED.get(str(given.get("kind")), {}), **given}

    def check_together(self) -> None:
        """Refuse what the kind does not have, and lenslets that are rounded away."""
        used = USED[self.kind]
        special = {name for each in USED.values() for name in each}
        for name in type(self).model_fields:
            if name in self.model_fields_set & special and name not in used:
                raise OptionError(
                    f"--{name}: a mask of the kind {self.kind} does not have it; it has "
                    f"{', '.join('--' + name for name in used)}"
                )
        smoothing, pitch = self.smoothing, self.pitch
        if smoothing is not None and pitch is not None and smoothing.exact >= pitch.exact:
            raise OptionError(
                f"--smoothing {smoothing} rounds lenslets away that are {pitch} apart: give less "
                "than their --pitch, such as a tenth of it"
            )

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
    def record(self) -> Path:
        """File of the run's record."""
        return self.output / RECORD_FILE

    @property
    def output_folder(self) -> Path:
        """It is made where it does not exist."""
        return self.output

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
