"""Options of `nolens dataset make`."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field

from nolens.camera.part import refusal
from nolens.errors import OptionError
from nolens.experiments.dataset_items import Variation
from nolens.files.dataset import Layout
from nolens.jobs.fields import (
    CAMERAS,
    LIGHTS,
    Distances,
    Exposure,
    FilePath,
    FullAngle,
    Name,
    Scheduler,
    Seed,
    Word,
    Workers,
    between,
    ordered,
)
from nolens.jobs.options import JobOptions, Option
from nolens.jobs.simulation import EXPOSURE, OPTICS, Fill, Fresnel, SceneLuminance
from nolens.quantities import Angle, Luminance, Percentage
from nolens.ranges import Between
from nolens.twin import check_field_points

SCENES, ERRORS, STORAGE = "Scenes", "Errors of the camera", "Storage"
_SELECTION = re.compile(r"\d{1,9}(:\d{1,9})?(\s*,\s*\d{1,9}(:\d{1,9})?)*")
_TWO = "give one value, or the smallest and the largest, such as "

_Part = Annotated[Percentage, Between("0 %", "100 %")]
_Crop = Annotated[Percentage, Between("1 %", "100 %")]
_Turn = Annotated[Angle, Between("-180 deg", "180 deg")]
_Ratio = Annotated[float, Between(0.5, 2)]
_Gain = Annotated[float, Between(0.01, 1000)]
_Size = Annotated[float, Between(0, 100)]
_Noise = Annotated[float, Between(0.001, 1e6)]
_Counts = Annotated[float, Between(-65535, 65535)]

# From the smallest to the largest.
_Crops = Annotated[tuple[_Crop, _Crop], between(f"{_TWO}50%,100%"), AfterValidator(ordered)]
_Fills = Annotated[tuple[Fill, Fill], between(f"{_TWO}20%,90%"), AfterValidator(ordered)]
_Exposures = Annotated[
    tuple[Exposure, Exposure], between(f"{_TWO}10ms,40ms"), AfterValidator(ordered)
]
_Gains = Annotated[tuple[_Gain, _Gain], between(f"{_TWO}1,8"), AfterValidator(ordered)]
_Noises = Annotated[tuple[_Noise, _Noise], between(f"{_TWO}2,6"), AfterValidator(ordered)]
_Ratios = Annotated[tuple[_Ratio, _Ratio], between(f"{_TWO}0.98,1.02"), AfterValidator(ordered)]
_Turns = Annotated[tuple[_Turn, _Turn], between(f"{_TWO}-1deg,1deg"), AfterValidator(ordered)]
_Sizes = Annotated[tuple[_Size, _Size], between(f"{_TWO}0,2"), AfterValidator(ordered)]
_Parts = Annotated[tuple[_Part, _Part], between(f"{_TWO}0%,10%"), AfterValidator(ordered)]
_Offsets = Annotated[tuple[_Counts, _Counts], between(f"{_TWO}-8,8"), AfterValidator(ordered)]


def _selected(text: str) -> str:
    if not _SELECTION.fullmatch(text.strip()):
        raise refusal("give numbers of items, and first:end without the end, such as 17,40:50")
    return text


class DatasetOptions(JobOptions):
    """Make a data set: simulated measurements of pictures, and what a reconstruction is to show.

    nolens dataset make --scenes photos --camera paper --count 1000 -o folder

    nolens dataset make recipe.toml -o folder

    A recipe holds any of these options. Two values are a range, such as --fill 20%,90%, from which
    each item draws its own. A set that was stopped goes on where it was.
    """

    usage = "dataset make [RECIPE] -o FOLDER"

    recipe: Annotated[
        FilePath | None,
        Option(
            "TOML file with any of these options; what is given here comes before it.",
            role="input",
            positional=True,
        ),
    ] = None
    output: Annotated[
        FilePath,
        Option(
            "Folder for the data set: shards in data/, PSFs in psfs/, a card (README.md), its "
            "description (dataset.json) and the recipe.",
            needed="the folder for the data set (-o FOLDER)",
            role="output",
            flag="-o",
        ),
    ]
    scenes: Annotated[
        FilePath | None,
        Option(
            "Folder of pictures, with those in folders below it: .png, .jpg or .tif (sRGB), or "
            "float .tif and .npy (linear).",
            default="pictures of random leaves",
            role="input",
        ),
    ] = None
    camera: Annotated[
        tuple[Name, ...],
        Field(min_length=1, max_length=100),
        Option(f"Cameras to simulate: {CAMERAS}.", role="camera"),
    ] = ("paper",)
    count: Annotated[int, Between(1, 10_000_000), Option("Items.")] = 1000
    distance: Annotated[
        Distances,
        Option(
            "Distances of the scenes, such as 300mm, or infinity; each item has one of them.",
            default="each camera's reference_distance",
        ),
    ] = ()
    seed: Annotated[Seed, Option("Of all that is drawn.")] = 0
    workers: Workers = None
    scheduler: Scheduler = None
    items: Annotated[
        str | None,
        AfterValidator(_selected),
        Field(max_length=1000),
        Option(
            "Only these, as files of their own in place of the data set: numbers from 0, or "
            "FIRST:END without the end, such as 17,40:50."
        ),
    ] = None
    generator: Annotated[
        Literal["dead-leaves"], Option("What draws the scenes where no folder is given.", SCENES)
    ] = "dead-leaves"
    licence: Annotated[
        str,
        Field(min_length=1, max_length=1000),
        Option("Of the scenes, for the card, such as cc0-1.0.", SCENES),
    ] = "not stated"
    crop: Annotated[
        _Crops,
        Option(
            "Side of the part of a picture that is shown, over that of the largest that has the "
            "sensor's shape.",
            SCENES,
            default="100%",
        ),
    ] = (Percentage("100", "%"), Percentage("100", "%"))
    mirror: Annotated[bool, Option("Mirror half of the pictures.", SCENES)] = False
    validation: Annotated[_Part, Option("Part of the scenes for validation.", SCENES)] = Percentage(
        "5", "%"
    )
    test: Annotated[_Part, Option("Part of the scenes for tests.", SCENES)] = Percentage("5", "%")
    masks: Annotated[
        int,
        Between(1, 100_000),
        Option("Masks of each camera with random lenslets: its own, and others like it.", OPTICS),
    ] = 1
    angle: Annotated[
        FullAngle | None,
        Option(
            "Field angle that the scene fills along the sensor's longer side.",
            OPTICS,
            default="40deg, or what the camera's aperture leaves of it",
        ),
    ] = None
    field_points: Annotated[
        int,
        Between(1, 101),
        Option(
            "PSFs along each side of the scene, an odd number; between them they are blended.",
            OPTICS,
        ),
    ] = 1
    light: Annotated[Word, Option(f"{LIGHTS}.", OPTICS)] = "white-led"
    wavelengths: Annotated[
        int, Between(1, 100), Option("Wavelengths that stand for a channel.", OPTICS)
    ] = 3
    fresnel: Fresnel = True
    fill: Annotated[
        _Fills | None,
        Option(
            "Exposes each item so that its brightest pixel is filled to this fraction of what "
            "saturates it.",
            EXPOSURE,
            default="90%",
        ),
    ] = None
    exposure: Annotated[
        _Exposures | None,
        Option("Exposure time.", EXPOSURE, default="that of --fill"),
    ] = None
    luminance: SceneLuminance = Luminance("200", "cd/m2")
    gain: Annotated[
        _Gains,
        Option("Factor on the sensor's gain.", EXPOSURE, default="1"),
    ] = (1.0, 1.0)
    read_noise: Annotated[
        _Noises | None,
        Option("Read noise in electrons.", EXPOSURE, default="the sensor's"),
    ] = None
    psf_scale: Annotated[
        _Ratios,
        Option(
            "Size of the PSF that makes the measurement, over that of the one that is stored.",
            ERRORS,
            default="1",
        ),
    ] = (1.0, 1.0)
    psf_rotation: Annotated[
        _Turns,
        Option("By which it is turned, anticlockwise.", ERRORS, default="0deg"),
    ] = (Angle("0", "deg"), Angle("0", "deg"))
    psf_blur: Annotated[
        _Sizes,
        Option(
            "Standard deviation of a Gaussian that blurs it, in pixels of the truth.",
            ERRORS,
            default="0",
        ),
    ] = (0.0, 0.0)
    haze: Annotated[
        _Parts,
        Option("Even light on the sensor, over the mean of the scene's.", ERRORS, default="0%"),
    ] = (Percentage("0", "%"), Percentage("0", "%"))
    banding: Annotated[
        _Sizes,
        Option("Standard deviation of an offset of each row, in counts.", ERRORS, default="0"),
    ] = (0.0, 0.0)
    black_error: Annotated[
        _Offsets,
        Option("True black level minus the stated one, in counts.", ERRORS, default="0"),
    ] = (0.0, 0.0)
    measurement: Annotated[
        Literal["raw", "developed"],
        Option(
            "raw: counts as the sensor gives them. developed: R, G and B of each superpixel above "
            "the stated black level.",
            STORAGE,
        ),
    ] = "raw"
    layout: Annotated[
        Layout,
        Option(
            "webdataset: tar files of PNG and JSON. parquet: as Hugging Face's datasets reads it.",
            STORAGE,
        ),
    ] = "webdataset"
    shard: Annotated[int, Between(1, 100_000), Option("Items in a shard.", STORAGE)] = 100

    @classmethod
    def gather(
        cls,
        choices: dict[str, Any],
        config: Path | None = None,
        note: Callable[[str], None] = lambda text: None,
    ) -> Self:
        """As `JobOptions.gather`; the recipe is a configuration that is given by its place."""
        recipe = choices.get("recipe")
        if recipe and config:
            raise OptionError(
                f"the recipe {recipe} and --config {config} are both given: leave one out"
            )
        return super().gather(choices, Path(recipe) if recipe else config, note)

    def check_together(self) -> None:
        """Refuse two ways of exposing, and a validation and test that are more than all."""
        if self.fill is not None and self.exposure is not None:
            raise OptionError(
                "--fill and --exposure are both given, and each says how long to expose: leave "
                "one out"
            )
        if self.validation.value + self.test.value > 1:
            raise OptionError(
                f"--validation {self.validation} and --test {self.test} are more than all scenes: "
                "give parts that leave some for training"
            )
        check_field_points(self.field_points)

    @property
    def output_folder(self) -> Path:
        """It is made where it does not exist."""
        return self.output

    @property
    def numbers(self) -> list[int]:
        """Of the items that are made alone."""
        numbers: dict[int, None] = {}
        for part in (self.items or "").split(","):
            first, colon, end = part.strip().partition(":")
            last = int(end) if colon else int(first) + 1
            numbers |= dict.fromkeys(range(int(first), last))
        return list(numbers)

    @property
    def variation(self) -> Variation:
        """Ranges of what is drawn."""
        fill, exposure = self.fill or (Percentage("90", "%"),) * 2, self.exposure
        return Variation(
            crop=(self.crop[0].value, self.crop[1].value),
            mirror=self.mirror,
            fill=(fill[0].value, fill[1].value),
            exposure_s=None if exposure is None else (exposure[0].s, exposure[1].s),
            gain=self.gain,
            read_noise=self.read_noise,
            psf_scale=self.psf_scale,
            psf_rotation_deg=(self.psf_rotation[0].deg, self.psf_rotation[1].deg),
            psf_blur_pixels=self.psf_blur,
            haze=(self.haze[0].value, self.haze[1].value),
            banding_counts=self.banding,
            black_error_counts=self.black_error,
        )
