"""`nolens compare`: pictures of one or several methods against the truth."""

import csv
import heapq
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from nolens.camera import flipped
from nolens.errors import DataError, OptionError
from nolens.evaluate import (
    Comparison,
    Fit,
    Motion,
    Registration,
    bootstrap_mean,
    compare_pictures,
    lies_beside,
    perceptual_distance,
    register_picture,
    turned_over,
)
from nolens.files.picture_sets import PictureSet, open_pictures
from nolens.files.plot_comparison import write_comparison_plot, write_worst_pictures
from nolens.jobs.fields import PICTURE, RESULT, FilePath, Files, Flip, Seed, Window, window_numbers
from nolens.jobs.options import RECORD, JobOptions, Option, Written, expand_home
from nolens.jobs.run import Product, Run, Writer, job
from nolens.ranges import Between

_TABLE, _PLOT, _RECORD = "compare.csv", "compare.png", "compare.json"
_TRIED = 5
"""Pictures of a method that are registered to see whether they lie beside their truth."""
_COMPARED = ("psnr_db", "ssim", "shown_psnr_db", "shown_ssim", "lpips")
"""Figures in which methods are compared with each other."""


class CompareOptions(JobOptions):
    """Say how near pictures come to the truth: PSNR, SSIM, MS-SSIM and LPIPS.

    nolens compare picture.tif truth.png

    nolens compare pictures/ truth/ -o report

    nolens compare tv=out-tv/ wiener=out-w/ --truth truth/ -o report

    Pictures belong to the truth of the same name, but for the suffix. They are laid on each other
    first; then gain and offset of each channel are fitted. The figures are those of linear light,
    and of the sRGB values that a screen shows. Several methods are compared on the pictures that
    all of them have, with 95 % intervals of the mean differences.
    """

    usage = "compare PICTURES TRUTH"

    pictures: Annotated[
        Files,
        Option(
            "Pictures: a file or a folder, then their truth. METHOD=FOLDER names several methods, "
            "with --truth.",
            needed="pictures and their truth (nolens compare PICTURES TRUTH)",
            role="input",
            positional=True,
        ),
    ]
    truth: Annotated[
        FilePath | None,
        Option(
            "What the pictures should show: a file, a folder, or a data set as it was published "
            "(DiffuserCam Mirflickr, LenslessPiCam's, FlatNet's, PhlatCam's; Parquet of Hugging "
            "Face), or a .csv in its folder that lists some of its pictures.",
            role="input",
            default="the last of the pictures",
        ),
    ] = None
    output: Annotated[
        FilePath | None,
        Option(
            f"Folder for the report: {_TABLE}, {_PLOT}, worst-METHOD.png and {_RECORD}.",
            role="output",
            flag="-o",
            default="the figures are only printed",
        ),
    ] = None
    registration: Annotated[
        Literal["auto", "none", "shift", "similarity", "homography"],
        Field(alias="register"),
        Option(
            "What may differ between the places of a picture and its truth: nothing; a shift; also "
            "scale and rotation (similarity); also a tilt (homography). auto: a similarity where "
            "pictures clearly lie beside their truth, and nothing otherwise.",
            label="Lay on the truth",
        ),
    ] = "auto"
    fit: Annotated[
        Fit,
        Option(
            "What of the pictures' brightness is free: gain and offset of each channel (affine), "
            "one factor (scale), or nothing.",
            label="Brightness",
        ),
    ] = "affine"
    crop: Annotated[
        Window | None,
        Option(
            "Part of the truth that the pictures show: HEIGHTxWIDTH+TOP+LEFT, as --crop of "
            "reconstruct.",
            PICTURE,
            default="all of it",
        ),
    ] = None
    flip: Annotated[
        Flip, Option("Turn the truth over, after --crop, as --flip of reconstruct.", PICTURE)
    ] = "none"
    bgr: Annotated[
        bool,
        Option(
            "The truth's channels are stored as B, G, R. Those of DiffuserCam's .npy are known.",
            PICTURE,
            negative=False,
        ),
    ] = False
    white: Annotated[
        float, Between(1e-6, 1e9), Option("Radiance of the truth that is white.", PICTURE)
    ] = 1.0
    worst: Annotated[
        int, Between(0, 50), Option("How many of the worst pictures are drawn.", RESULT)
    ] = 4
    seed: Annotated[Seed, Option("Of the resampling for the intervals.", RESULT)] = 0

    @property
    def sources(self) -> dict[str, Path]:
        """Where each method's pictures are."""
        paths = self.pictures if self.truth is not None else self.pictures[:-1]
        found: dict[str, Path] = {}
        for path in paths:
            head, equals, rest = str(path).partition("=")
            named = equals and not path.exists()
            name = Path(head).name if named else path.stem or str(path)
            if named:
                path = Path(head).parent / expand_home(Path(rest))
            if name in found or not name:
                raise OptionError(
                    f"two methods are called {name!r}: name each of them, such as tv={path}"
                )
            found[name] = path
        return found

    @property
    def truth_path(self) -> Path:
        """Where the truth is."""
        return self.pictures[-1] if self.truth is None else self.truth

    def check_together(self) -> None:
        """Refuse pictures without a truth."""
        if not self.sources:
            raise OptionError(
                f"{self.truth_path} has nothing to be compared with: nolens {self.usage}"
            )

    @property
    def inputs(self) -> dict[str, Path]:
        """Where pictures and truth are."""
        return {**{f"pictures {name}": path for name, path in self.sources.items()},
                "truth": self.truth_path}  # fmt: skip

    @property
    def output_folder(self) -> Path | None:
        """It is made where it does not exist."""
        return self.output

    @property
    def record(self) -> Path | None:
        """File of the run's record."""
        return None if self.output is None else self.output / _RECORD

    @property
    def written(self) -> tuple[Written, ...]:
        """Table, plot, worst pictures and record."""
        if self.output is None:
            return ()
        names = {"table": _TABLE, "plot": _PLOT, RECORD: _RECORD}
        names |= {f"worst of {name}": f"worst-{name}.png" for name in self.sources if self.worst}
        return tuple(Written(what, self.output / name) for what, name in names.items())


@dataclass
class Compared:
    """What is kept of a method: the figures of every picture, and its worst pictures.

    Parameters
    ----------
    motion
        What was free when its pictures were laid on the truth.
    """

    motion: Motion
    figures: dict[str, dict[str, float]] = field(default_factory=dict)
    registrations: dict[str, Registration] = field(default_factory=dict)
    worst: list[tuple[float, int, str, Comparison]] = field(default_factory=list)

    def add(self, name: str, found: Comparison, keep: int) -> None:
        """Take in a picture."""
        self.figures[name] = found.figures
        self.registrations[name] = found.registration
        entry = (-found.figures["psnr_db"], len(self.figures), name, found)
        heapq.heappush(self.worst, entry)
        if len(self.worst) > keep:
            heapq.heappop(self.worst)

    def column(self, figure: str) -> NDArray[np.float64]:
        """One figure of all pictures."""
        return np.array([each[figure] for each in self.figures.values()])


@job
def compare(run: Run[CompareOptions]) -> Product[dict[str, Compared]]:
    """Compare the pictures of every method with their truth, one at a time.

    Raises
    ------
    NolensError
        If a picture or an option cannot be used; then nothing is written.
    """
    options = run.options
    truth = open_pictures(options.truth_path, bgr=options.bgr)
    methods = _named_alike(
        {name: open_pictures(path) for name, path in options.sources.items()}, truth
    )
    names = _common(run, methods, truth)
    run.begin()
    perceptual = perceptual_distance()
    measure = partial(
        compare_pictures,
        fit=options.fit,
        white=options.white,
        perceptual=None if isinstance(perceptual, str) else perceptual,
    )
    truth_of = partial(_truth, options, truth)
    compared = {
        name: Compared(_motion(run, name, pictures, names, truth_of))
        for name, pictures in methods.items()
    }
    brightest = 0.0
    for done, name in enumerate(names):
        run.reporter.advance("pictures", done / len(names))
        expected = truth_of(name)
        brightest = max(brightest, float(expected.max()))
        for method, pictures in methods.items():
            try:
                found = measure(pictures.read(name), expected, register=compared[method].motion)
            except DataError as error:
                raise DataError(f"{name} of {pictures.source}: {error}") from error
            compared[method].add(name, found, options.worst)
    run.reporter.advance("pictures", 1.0)
    if isinstance(perceptual, str):
        run.reporter.note(f"LPIPS is left out: {perceptual}")
    if brightest > 1.01 * options.white:
        run.warn(
            f"the truth has {brightest:.3g}, and the peak of PSNR and SSIM is {options.white:g}: "
            f"give --white {brightest:.3g}"
        )
    figures = {
        "pictures": len(names),
        "methods": {name: _figures(each, options.seed) for name, each in compared.items()},
        "differences": _differences(compared, options.seed),
        "white": options.white,
        "fit": options.fit,
    }
    return Product(compared, figures, _writers(options, compared))


def _common(
    run: Run[CompareOptions], methods: Mapping[str, PictureSet], truth: PictureSet
) -> list[str]:
    """Names that all methods and the truth have; what is left out is said."""
    sets = {str(each.source): each for each in (truth, *methods.values())}
    known = [set(each.names) for each in sets.values()]
    common = set.intersection(*known)
    if not common:
        shown = "; ".join(f"{source} has {each.names[0]}" for source, each in sets.items())
        raise DataError(f"no picture has the name of its truth: {shown}. Give both the same name")
    for each in methods.values():
        left = [name for name in each.names if name not in common]
        if left:
            run.warn(
                f"{len(left)} of {len(each.names)} pictures of {each.source} are left out, as not "
                f"all others have them: {left[0]}" + (" and more" if len(left) > 1 else "")
            )
    return [name for name in truth.names if name in common]


def _named_alike(methods: dict[str, PictureSet], truth: PictureSet) -> dict[str, PictureSet]:
    """With the name of the truth where all have one picture, whatever their files are called."""
    if any(len(each.names) > 1 for each in (truth, *methods.values())):
        return methods
    return {method: _renamed(each, truth.names[0]) for method, each in methods.items()}


def _renamed(pictures: PictureSet, name: str) -> PictureSet:
    own = pictures.names[0]
    return replace(pictures, names=(name,), read=lambda _: pictures.read(own))


def _truth(options: CompareOptions, truth: PictureSet, name: str) -> Tensor:
    """The part of a truth that the pictures show, turned over as they are."""
    radiance = truth.read(name)
    if options.crop is not None:
        height, width, top, left = window_numbers(options.crop)
        top, left = top or 0, left or 0
        if (
            top < 0
            or left < 0
            or top + height > radiance.shape[-2]
            or left + width > radiance.shape[-1]
        ):
            raise OptionError(
                f"--crop {options.crop} is not within {name} of {truth.source}, which has "
                f"{radiance.shape[-2]}×{radiance.shape[-1]} pixels"
            )
        radiance = radiance[:, top : top + height, left : left + width]
    return flipped(radiance, options.flip)


def _motion(
    run: Run[CompareOptions], method: str, pictures: PictureSet, names: list[str], truth_of: Any
) -> Motion:
    """What is free for a method's pictures, by some of them where that is not said."""
    options = run.options
    if options.registration != "auto":
        return options.registration
    beside, over = [], []
    for name in names[:: math.ceil(len(names) / _TRIED)]:
        picture, truth = pictures.read(name), truth_of(name)
        found, as_it_is = (
            register_picture(picture, truth, each) for each in ("similarity", "none")
        )
        beside.append(found if lies_beside(found, as_it_is) else None)
        over.append(turned_over(picture, truth))
    if over[0] is not None and len(set(over)) == 1:
        run.warn(
            f"the pictures of {method} fit their truth much better turned over: --flip {over[0]}"
        )
        return "none"
    moved = [each for each in beside if each is not None]
    if len(moved) <= len(beside) / 2:
        return "none"
    scale, turn = moved[0].scale_and_turn()
    run.reporter.note(
        f"pictures of {method} lie beside their truth (scale {scale:.3f}, {turn:.2f}° turned): a "
        "similarity lays them on it; --register none leaves them"
    )
    return "similarity"


def _number(value: float) -> float | str | None:
    """In values that JSON has; nothing where there is none."""
    return value if math.isfinite(value) else "infinity" if value == math.inf else None


def _interval(values: NDArray[np.float64], seed: int) -> dict[str, float | str | None]:
    found = bootstrap_mean(values, seed=seed) if np.isfinite(values).all() else None
    mean, *ends = (
        (float(values.mean()), math.nan, math.nan)
        if found is None
        else (found.mean, found.low, found.high)
    )
    return {"mean": _number(mean), "low": _number(ends[0]), "high": _number(ends[1])}


def _figures(method: Compared, seed: int) -> dict[str, Any]:
    """Means of a method, with their intervals."""
    names = next(iter(method.figures.values()))
    errors = np.array([each.error_px for each in method.registrations.values()])
    return {
        "register": method.motion,
        "error_px": _number(float(np.median(errors))),
        **{name: _interval(method.column(name), seed) for name in names},
    }


def _differences(compared: Mapping[str, Compared], seed: int) -> list[dict[str, Any]]:
    """Of every method against each one after it, picture by picture."""
    rows = []
    names = list(compared)
    for place, one in enumerate(names):
        for other in names[place + 1 :]:
            for figure in _COMPARED:
                if figure not in next(iter(compared[one].figures.values())):
                    continue
                by = compared[one].column(figure) - compared[other].column(figure)
                rows.append(
                    {"method": one, "minus": other, "figure": figure, **_interval(by, seed)}
                )
    return rows


def _writers(options: CompareOptions, compared: Mapping[str, Compared]) -> dict[Path, Writer]:
    """Of the table, the plot and the worst pictures."""
    folder = options.output
    if folder is None:
        return {}
    columns = {
        name: {figure: each.column(figure) for figure in next(iter(each.figures.values()))}
        for name, each in compared.items()
    }
    writers: dict[Path, Writer] = {
        folder / _TABLE: partial(_write_table, compared),
        folder / _PLOT: partial(write_comparison_plot, figures=columns),
    }
    for name, each in compared.items():
        if options.worst:
            worst = [(label, found) for _, _, label, found in sorted(each.worst, reverse=True)]
            writers[folder / f"worst-{name}.png"] = partial(
                write_worst_pictures, pictures=worst, white=options.white
            )
    return writers


def _write_table(compared: Mapping[str, Compared], path: Path) -> None:
    """Every figure of every picture and where it lies on its truth, by method."""
    rows = [
        {"method": method, "picture": name, **figures, **each.registrations[name].figures()}
        for method, each in compared.items()
        for name, figures in each.figures.items()
    ]
    with path.open("w", newline="") as file:
        table = csv.DictWriter(file, rows[0].keys())
        table.writeheader()
        for row in rows:
            table.writerow({
                name: f"{value:.6g}" if isinstance(value, float) else value
                for name, value in row.items()
            })  # fmt: skip
