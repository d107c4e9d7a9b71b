"""Upright bars, bright and dark by turns, as a resolution target: contrast at one fineness."""

import math
from pathlib import Path
from typing import Annotated, Any

import torch
from torch import Tensor

from nolens.errors import DataError
from nolens.evaluate import FlatPicture
from nolens.files.plots import plot_figure, show_picture
from nolens.jobs.measuring.resolution import (
    OneFrameOptions,
    ResolutionTarget,
    ScreenPicture,
    TargetAngle,
    resolution_product,
    solver_line,
    target_picture,
)
from nolens.jobs.options import Option
from nolens.jobs.run import Product, Run, job
from nolens.ranges import Between

_PAIRS = 12


class BarOptions(OneFrameOptions):
    """Measure the contrast of upright bars of one width.

    nolens measure resolution bars bars.tif --period 0.8deg --camera paper
    """

    usage = "measure resolution bars FRAME --period ANGLE --camera FOLDER"

    period: Annotated[
        TargetAngle,
        Option("A bright bar and a dark one.", needed="their angle (--period 0.8deg)"),
    ]


class BarPicture(ScreenPicture):
    """Bars from edge to edge."""

    about = "upright bars"

    pairs: Annotated[int, Between(2, 500), Option("Bright bars.")] = _PAIRS

    def draw(self, side: int) -> Tensor:
        """Give it, (side, side) from 0 to 1, for a side in pixels."""
        return (torch.arange(side) * self.pairs / side % 1 < 0.5).double().expand(side, -1)


@job
def measure_bars(run: Run[BarOptions]) -> Product[float]:
    """Measure the contrast of the bars' fundamental; that of sharp black and white ones is 1."""
    side_deg = _PAIRS * run.options.period.deg
    picture = target_picture(run, BarPicture(pairs=_PAIRS).draw, side_deg, "bars")
    contrast = _contrast(picture, run.options.period.rad)
    figures = {"period_deg": run.options.period.deg, "contrast": contrast}

    def draw(_: float, path: Path) -> None:
        with plot_figure(path, (4.0, 4.0)) as figure:
            show_picture(figure.subplots(), picture.values.numpy())

    return resolution_product(run, "bars", contrast, figures, draw)


def _contrast(picture: FlatPicture, period: float) -> float:
    """By a wave of the period, fitted to the light along whole periods of the picture."""
    pixels = 2 * math.tan(period / 2) / picture.tangent
    light = picture.values.double().mean(0)
    whole = round(len(light) // pixels * pixels)
    if pixels < 2 or whole < 2 * pixels:
        raise DataError(
            f"bars of {pixels:.3g} pixels in {len(light)}: give 2 pixels to half of all"
        )
    turns = torch.arange(whole) * (2 * math.pi / pixels)
    wave = torch.stack([torch.ones(whole), turns.cos(), turns.sin()], dim=1).double()
    mean, even, odd = torch.linalg.lstsq(wave, light[:whole, None]).solution[:, 0].tolist()
    return math.hypot(even, odd) / mean * math.pi / 4


def _lines(summary: dict[str, Any]) -> list[str]:
    return [
        f"bars of {summary['period_deg']:.3f} deg a pair: contrast {summary['contrast']:.3f}",
        *solver_line(summary),
    ]


BARS = ResolutionTarget(measure_bars, _lines, BarPicture)
