"""Options of `nolens train`."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from nolens.camera.part import refusal
from nolens.camera.psf_set import Depth
from nolens.errors import OptionError
from nolens.files.weights import card_beside
from nolens.jobs.fields import CAMERAS, Device, FilePath, FullAngle, Name, Seed
from nolens.jobs.options import RECORD, JobOptions, Option, Written
from nolens.quantities import Angle
from nolens.ranges import Between
from nolens.solvers.denoising_network import Precision
from nolens.training.validation import MOST_GENERATED

TrainedPrior = Literal["denoiser", "unrolled"]
PICTURES, COURSE = "Pictures", "Course of the training"
RATES = {"denoiser": 1.5e-3, "unrolled": 4e-4}


def _weights(path: Path) -> Path:
    if path.suffix.lower() != ".npz":
        raise refusal("give denoiser, unrolled, none, or an .npz of weights that you trained")
    return path


class TrainOptions(JobOptions):
    """Train a prior that knows pictures, for any camera or for yours.

    nolens train mycamera -o mine.npz

    nolens train --prior denoiser --steps 2000 -o mine.npz

    CAMERA is the folder with its PSFs, or a description that is simulated. nolens reconstruct takes
    the result (--prior mine.npz). Ctrl-C keeps the weights so far and where the training stands
    (mine.state.npz), from where --resume goes on.
    """

    usage = "train [CAMERA] -o mine.npz"

    camera: Annotated[
        Name | None,
        Option(
            "Camera whose measurements are simulated to train on: a folder with PSFs, or "
            f"{CAMERAS}, whose PSFs are computed.",
            role="camera",
            positional=True,
            default="another random camera for each measurement",
        ),
    ] = None
    output: Annotated[
        FilePath,
        Option(
            "File for the weights: .npz. Their card goes beside it, as .json, and the record of "
            "the run, as .record.json.",
            needed="the file to write (-o mine.npz)",
            role="output",
            what="weights",
            suffixes=(".npz",),
            flag="-o",
        ),
    ]
    prior: Annotated[
        TrainedPrior,
        Option(
            "unrolled learns to mend what a reconstruction by the denoiser leaves, of measurements "
            "by your camera or by random ones; denoiser learns white noise.",
            label="Prior",
        ),
    ] = "unrolled"
    start: Annotated[
        TrainedPrior | Literal["none"] | Annotated[FilePath, AfterValidator(_weights)] | None,
        Option(
            "Weights to start from: those that come with nolens, of the same prior or of the "
            "denoiser, an .npz of yours for the same prior, whose size the network then has, or "
            "none.",
            default="those of the same prior that come with nolens",
        ),
    ] = None
    pairs: Annotated[
        FilePath | None,
        Option(
            "Folder of real pairs to train on too, as nolens collect makes it: measured/, "
            "pictures/ with the same names and, where there is one, dark.tif. Needs the folder of "
            "the camera with its measured PSFs.",
            role="input",
        ),
    ] = None
    photographs: Annotated[
        FilePath | None,
        Option(
            "Folder of photographs to train on beside generated pictures, with those in folders "
            "below it: .png, .jpg or .tif (sRGB), or float .exr, .tif and .npy (linear).",
            role="input",
        ),
    ] = None
    licence: Annotated[
        str,
        Field(min_length=1, max_length=1000),
        Option("Of the photographs, for the card, such as cc0-1.0."),
    ] = "not stated"
    steps: Annotated[int, Between(1, 1_000_000), Option("Batches to learn from.")] = 6_000
    seed: Annotated[Seed, Option("Of everything random in the training.")] = 0
    resume: Annotated[
        FilePath | None,
        Option(
            "Checkpoint (.state.npz) of a training that was stopped: goes on with it, given the "
            "same pictures and options.",
            role="input",
        ),
    ] = None
    pictures: Annotated[
        int,
        Between(1, MOST_GENERATED),
        Option("Generated pictures to cut patches from.", PICTURES),
    ] = 700
    validation: Annotated[
        FilePath | None,
        Option(
            "Folder of photographs that are not trained on: with generated pictures they tell "
            "which weights are the best.",
            PICTURES,
            role="input",
            default="generated pictures alone",
        ),
    ] = None
    distance: Annotated[
        Depth | None,
        Option(
            "Distance of the scenes from the camera, such as 300mm, or infinity.",
            PICTURES,
            default="the only one of the folder's PSFs, or the camera's reference_distance",
        ),
    ] = None
    angle: Annotated[
        FullAngle,
        Option("Field angle that the scenes fill, where the camera's PSFs are computed.", PICTURES),
    ] = Angle("40", "deg")
    rate: Annotated[
        Annotated[float, Between(1e-7, 1)] | None,
        Option(
            "Largest step of the optimiser.",
            COURSE,
            default="0.0015 for denoiser, 0.0004 for unrolled",
        ),
    ] = None
    patience: Annotated[
        int,
        Between(1, 100_000),
        Option("Checks by held-out pictures without progress after which it ends.", COURSE),
    ] = 12
    precision: Annotated[
        Precision,
        Option(
            "Of the network's features while it learns. bfloat16 takes about half the time on CUDA "
            "and on processors that have it (AVX512-BF16, AMX), and far longer on others.",
            COURSE,
        ),
    ] = "float32"
    device: Device = "auto"

    def check_together(self) -> None:
        """Refuse a camera where none is measured with."""
        if self.prior == "denoiser":
            for name in ("camera", "pairs", "distance", "angle"):
                if name in self.model_fields_set:
                    what = "CAMERA" if name == "camera" else self.flag(name)
                    raise OptionError(
                        f"--prior denoiser learns white noise, which is the same for every camera: "
                        f"leave {what} out, or train --prior unrolled"
                    )
        if self.camera is None:
            for name in ("distance", "angle"):
                if name in self.model_fields_set:
                    raise OptionError(
                        f"{self.flag(name)} is of scenes before a camera: give the camera "
                        "(nolens train CAMERA -o mine.npz), or leave it out"
                    )

    @property
    def inputs(self) -> dict[str, Path]:
        """None: pictures are listed by their folders, and a checkpoint says what it belongs to."""
        return {}

    @property
    def written(self) -> tuple[Written, ...]:
        """Weights, card and record."""
        return (
            *self.files,
            Written("card", card_beside(self.output)),
            Written(RECORD, self.record),
        )

    @property
    def record(self) -> Path:
        """File of the run's record."""
        return self.output.with_suffix(".record.json")

    @property
    def state(self) -> Path:
        """File of the checkpoint, as long as the training goes on."""
        return self.output.with_suffix(".state.npz")

    @property
    def largest_rate(self) -> float:
        """Of the optimiser."""
        return self.rate or RATES[self.prior]

    @property
    def first(self) -> Path | str:
        """Weights to start from."""
        return self.start or self.prior
