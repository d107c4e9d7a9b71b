"""Siemens star, two points and text through the simulated camera: is detail invented?

Of a picture, what is finer than the bars that nolens reports as just seen is compared with the
same part of the truth: `right` is how much of the truth's it shows, `wrong` is what it shows
beside that, as a fraction of the truth's. A blurred picture shows little of both. A prior that
invents has more of `wrong` than total variation.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import matplotlib
import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont
from scipy import ndimage
from torch import Tensor

import nolens as nl
from nolens.errors import DataError
from nolens.evaluate import RAYLEIGH_DIP, point_pair, resolved_separation, siemens_star
from nolens.files.contact_sheet import SheetPicture, write_contact_sheet
from priors_cases import KINDS, MASKS, figures, psf_for, simulated, written

EXPOSURES = (0.9, 0.1)
SIDE, FINER = 218, 4
"""Pixels of the scene along a chart, and of the drawing to each of them."""
SPOKES, SECTORS = 36, 8
WIDTHS = (1.25, 2.0, 3.0, 4.5, 6.0)
"""Between these, in pixels, lie the widths of spokes whose contrast is reported together."""
HALF_RING = 1.5
SEPARATIONS, PLACES = (2.0, 2.5, 3.0, 4.0, 5.0, 6.0), 5
"""Of two points in pixels, and how often each is drawn, at other places within a pixel."""
CELL = 34
HEIGHTS = (36, 28, 22, 17, 13, 10, 8, 6)
"""Of lines of text, in pixels."""
TEXT = "Lensless cameras 0123456789 see what the light says of it"


@dataclass(frozen=True)
class ChartRow:
    """Figures of a chart by mask, exposure and prior; `truth` is one of them."""

    chart: str
    mask: str
    exposure: float
    figures: dict[str, dict[str, float | None]]

    @property
    def name(self) -> str:
        """Of its files."""
        return f"{self.chart}-{self.mask}-{self.exposure:g}"

    def contrasts(self, name: str) -> list[str]:
        """Of a star's spokes by their width."""
        row = self.figures[name]
        return [f"{row[f'placed_{low:g}']:.2f} ({row[f'any_{low:g}']:.2f})" for low in WIDTHS[:-1]]


def star() -> Tensor:
    """Spokes that meet in the middle."""
    return siemens_star(FINER * SIDE, SPOKES).float().expand(3, -1, -1)


def _middle(row: int, column: int) -> tuple[float, float]:
    """Of a pair of points, in pixels of the scene."""
    fraction = row / PLACES
    margin = SIDE / 2 - CELL * len(SEPARATIONS) / 2
    top = SIDE / 2 - CELL * PLACES / 2
    return top + CELL * (row + 0.5) + fraction, margin + CELL * (column + 0.5) + 0.7 * fraction


def points() -> Tensor:
    """Pairs of bright dots, a pixel wide, in the dark: a column for each separation."""
    side = FINER * SIDE
    down, right = torch.meshgrid(torch.arange(side), torch.arange(side), indexing="ij")
    light = torch.zeros(side, side)
    for row in range(PLACES):
        for column, apart in enumerate(SEPARATIONS):
            middle = _middle(row, column)
            for end in (-apart / 2, apart / 2):
                away = torch.hypot(
                    (down + 0.5) / FINER - middle[0], (right + 0.5) / FINER - middle[1] - end
                )
                light[away <= 0.5] = 1.0
    return light.expand(3, -1, -1)


def text() -> Tensor:
    """Lines of black letters on white, each smaller than the one above."""
    page = Image.new("L", (FINER * SIDE, FINER * SIDE), 255)
    draw = ImageDraw.Draw(page)
    family = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
    top = 6 * FINER
    for height in HEIGHTS:
        font = ImageFont.truetype(str(family), height * FINER)
        draw.text((6 * FINER, top), TEXT, fill=0, font=font)
        top += round(1.35 * height * FINER)
    return torch.from_numpy(np.asarray(page).copy()).float().div(255).expand(3, -1, -1)


SHOWN = {"star": ("paper", 0.1), "text": ("paper", 0.9)}
CHARTS: dict[str, Callable[[], Tensor]] = {"star": star, "points": points, "text": text}


def chart_rows(
    folder: Path, priors: list[str], *, measure: bool, again: bool = False
) -> list[ChartRow]:
    """What was measured of the charts; what is missing is measured first where it is asked for."""
    rows: list[ChartRow] = []
    for mask in MASKS:
        for exposure in EXPOSURES:
            for chart in CHARTS:
                row = ChartRow(chart, mask, exposure, {})
                path = folder / "charts" / f"{row.name}.json"
                known = json.loads(path.read_text()) if path.exists() else {}
                row.figures.update(known)
                if measure:
                    _measure(folder, row, priors, again=again)
                    told = json.dumps(row.figures)
                    written(path, lambda part, each=told: part.write_text(each))
                if row.figures:
                    rows.append(row)
    return rows


def _measure(folder: Path, row: ChartRow, priors: list[str], *, again: bool) -> None:
    """Add what is missing of a row."""
    shot = simulated(
        folder / "charts" / f"{row.name}.npz", row.mask, CHARTS[row.chart], row.exposure
    )
    truth = shot.expected
    for prior in priors:
        name = Path(prior).stem
        if name in row.figures and not (again and prior not in KINDS):
            continue
        photo = nl.reconstruct(shot, psf_for(folder, row.mask, shot), prior=prior)
        picture = figures(photo.values, truth)[1]
        limit = photo.report.resolution_pixels if photo.report else None
        if "truth" not in row.figures:
            row.figures["truth"] = {"limit_px": max(limit or 1.0, 1.0)}
            row.figures["truth"] |= _of_chart(row, truth, truth)
        row.figures[name] = _of_chart(row, picture, truth)
        path, kept = folder / "charts" / f"{row.name}-{name}.npz", picture.half().numpy()
        written(path, lambda part, each=kept: np.savez_compressed(part, picture=each))
        print(row.name, name, row.figures[name], flush=True)


def _of_chart(row: ChartRow, picture: Tensor, truth: Tensor) -> dict[str, float | None]:
    """Figures of one picture, of the mean of its colours."""
    limit = row.figures["truth"]["limit_px"]
    assert limit is not None
    values, expected = picture.mean(0).double().numpy(), truth.mean(0).double().numpy()
    # A Gaussian that passes half of bars which are as wide as the limit.
    sigma = limit * math.sqrt(2 * math.log(2)) / math.pi
    fine, true = (each - ndimage.gaussian_filter(each, sigma) for each in (values, expected))
    right = float((fine * true).sum() / (true * true).sum())
    wrong = float(np.sqrt(((fine - right * true) ** 2).sum() / (true * true).sum()))
    found: dict[str, float | None] = {"right": right, "wrong": wrong}
    if row.chart == "star":
        found |= _of_star(values, expected)
    if row.chart == "points":
        found |= _of_points(values)
    return found


def _of_star(values: np.ndarray, truth: np.ndarray) -> dict[str, float | None]:
    """Contrast of spokes by their width, as fractions of that of wide ones in the truth.

    `any` is that of whatever has so many periods on a circle, in each sector by itself; `placed`
    that of spokes where the truth has them.
    """
    rows, columns = np.indices(values.shape)
    row, column = rows - (values.shape[0] - 1) / 2, columns - (values.shape[1] - 1) / 2
    radius, turn = np.hypot(row, column), np.arctan2(-row, column)
    wave = np.exp(-1j * SPOKES * turn)
    sector = np.floor((turn / (2 * math.pi) % 1) * SECTORS).astype(int)

    def amplitudes(picture: np.ndarray, middle: float) -> np.ndarray:
        parts = []
        for number in range(SECTORS):
            part = (np.abs(radius - middle) < HALF_RING) & (sector == number)
            level = picture[part] - picture[part].mean()
            parts.append((level * (wave[part] - wave[part].mean())).mean())
        return np.array(parts)

    wide = np.abs(amplitudes(truth, 0.8 * SIDE / 2)).mean()
    found: dict[str, float | None] = {}
    for low, high in pairwise(WIDTHS):
        rings = np.arange(low * SPOKES / math.pi, high * SPOKES / math.pi)
        shown = [(amplitudes(values, each), amplitudes(truth, each)) for each in rings]
        every = [np.abs(one).mean() for one, _ in shown]
        placed = [(one * true.conj()).real.sum() / np.abs(true).sum() for one, true in shown]
        found[f"any_{low:g}"] = float(np.mean(every) / wide)
        found[f"placed_{low:g}"] = float(np.mean(placed) / wide)
    return found


def _of_points(values: np.ndarray) -> dict[str, float | None]:
    """Smallest separation from which on points are resolved (Rayleigh's dip), in pixels."""
    dips: list[list[float]] = [[] for _ in SEPARATIONS]
    for row in range(PLACES):
        for column, apart in enumerate(SEPARATIONS):
            down, right = (round(each) for each in _middle(row, column))
            half = CELL // 2 - 3
            cell = values[down - half : down + half + 1, right - half : right + half + 1]
            try:
                dips[column].append(point_pair(torch.from_numpy(cell.copy()), apart).dip)
            except DataError:
                dips[column].append(0.0)
    means = tuple(float(np.mean(each)) for each in dips)
    errors = tuple(float(np.std(each) / math.sqrt(len(each))) for each in dips)
    found = resolved_separation(SEPARATIONS, means, errors)
    named = {f"dip_{apart:g}": dip for apart, dip in zip(SEPARATIONS, means, strict=True)}
    value = found.value if found.value is not None else found.resolved
    return {"resolved_px": value, **named}


def chart_tables(rows: list[ChartRow]) -> list[str]:
    """Markdown of them."""
    priors = list(dict.fromkeys(name for row in rows for name in row.figures if name != "truth"))
    lines = [
        "Charts that show whether detail is invented: a Siemens star, pairs of points and text, by",
        "the priors as they come. Of detail that is finer than the bars of 10 % contrast which",
        "nolens reports as just seen, *right* is how much of the truth's a picture shows, *wrong*",
        "what it shows beside that, both as fractions of the truth's. What is invented adds to",
        "*wrong*, so that of a trained prior is to be no larger than that of TV. Of points, the",
        f"separation from which on the dip is at least {RAYLEIGH_DIP:.1%}, in pixels.",
        "",
        *_table(["chart", "mask", "exposure", "finest bars", *priors], _all_charts(rows, priors)),
        "Contrast of the star's spokes by their width in pixels, as fractions of that of wide",
        "ones: spokes that lie where the truth has them; in brackets, all that is as fine.",
        "",
    ]
    widths = [f"{low:g} to {high:g} px" for low, high in pairwise(WIDTHS)]
    of_star = [
        [row.mask, f"{row.exposure:.0%}", name, *row.contrasts(name)]
        for row in rows
        if row.chart == "star"
        for name in ("truth", *priors)
        if name in row.figures
    ]
    return [*lines, *_table(["mask", "exposure", "prior", *widths], of_star)]


def _table(heads: list[str], rows: list[list[str]]) -> list[str]:
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    return [*lines, *("| " + " | ".join(row) + " |" for row in rows), ""]


def _all_charts(rows: list[ChartRow], priors: list[str]) -> list[list[str]]:
    return [
        [
            chart,
            row.mask,
            f"{row.exposure:.0%}",
            f"{row.figures['truth']['limit_px']:.1f} px",
            *(_cell(chart, row.figures.get(prior)) for prior in priors),
        ]
        for chart in CHARTS
        for row in rows
        if row.chart == chart
    ]


def _cell(chart: str, found: dict[str, float | None] | None) -> str:
    if found is None:
        return ""
    text = f"right {found['right']:.2f}, wrong {found['wrong']:.2f}"
    if chart == "points":
        resolved = found["resolved_px"]
        text += "; none resolved" if resolved is None else f"; from {resolved:.1f} px"
    return text


def chart_sheets(folder: Path, rows: list[ChartRow], pictures: Path) -> list[str]:
    """Those of `SHOWN`, side by side."""
    lines: list[str] = []
    pictures.mkdir(parents=True, exist_ok=True)
    for row in rows:
        if SHOWN.get(row.chart) != (row.mask, row.exposure):
            continue
        path = folder / "charts" / f"{row.name}.npz"
        truth = simulated(path, row.mask, CHARTS[row.chart], row.exposure).expected
        sheet = [SheetPicture("truth", truth)]
        for prior in row.figures:
            file = folder / "charts" / f"{row.name}-{prior}.npz"
            if file.exists():
                with np.load(file) as kept:
                    picture = torch.from_numpy(kept["picture"]).float()
                sheet.append(SheetPicture(prior, picture))
        out = pictures / f"{row.chart}.png"
        write_contact_sheet(out, pictures=sheet, white=float(truth.max()))
        told = f"{row.chart.capitalize()}: {row.mask}, {row.exposure:.0%}"
        lines += [f"![{told}]({pictures.name}/{out.name})", "", f"*{told}.*", ""]
    return lines
