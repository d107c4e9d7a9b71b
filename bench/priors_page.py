"""Tables and pictures of `docs/priors.md`, from what `bench/priors.py` measured."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch

from machine import describe
from nolens.evaluate import Interval, bootstrap_mean
from nolens.files.contact_sheet import SheetPicture, write_contact_sheet
from page import write_part
from priors_cases import (
    ANGLE,
    EXPOSURES,
    FIGURES,
    KINDS,
    MASKS,
    PIXELS,
    UNSEEN,
    Case,
    Figures,
    better,
    cases,
    perceptual,
    simulated,
    unseen_cases,
)
from priors_charts import ChartRow, chart_sheets, chart_tables
from priors_photographs import INSTALLED, PHOTOGRAPHS

RETUNED = "TV, retuned"
UNITS = {
    "psnr_db": ("PSNR", 2), "ssim": ("SSIM", 3), "shown_psnr_db": ("PSNR as shown", 2),
    "shown_ssim": ("SSIM as shown", 3), "lpips": ("LPIPS", 3),
}  # fmt: skip
"""Names in tables, and digits after the point."""


@dataclass(frozen=True)
class Measured:
    """Figures of a case by prior, and by weight of it."""

    case: Case
    rows: dict[str, dict[str, Figures]] = field(repr=False)

    def value(self, method: str, name: str) -> float:
        """A figure of a method: the best weight and kind of TV for it, or a prior as it comes."""
        if method in self.rows:
            return self.rows[method]["auto"][name]
        kinds = KINDS if method == RETUNED else (method.split(",")[0],)
        best, *others = (row for kind in kinds for row in self.rows[kind].values())
        for row in others:
            best = row if better(name, row, best) else best
        return best[name]

    def over_tv(self, method: str, name: str) -> float:
        """Difference of a method from retuned TV."""
        return self.value(method, name) - self.value(RETUNED, name)


def _by_photograph(
    measured: Sequence[Measured], value: Callable[[Measured], float]
) -> dict[str, float]:
    """Mean of the cases of each photograph."""
    values: dict[str, list[float]] = {}
    for each in measured:
        values.setdefault(each.case.photograph.name, []).append(value(each))
    return {name: statistics.mean(of_cases) for name, of_cases in values.items()}


def _interval(measured: Sequence[Measured], method: str, name: str) -> Interval:
    """Mean difference from retuned TV: what is drawn again are photographs."""
    means = _by_photograph(measured, lambda each: each.over_tv(method, name))
    return bootstrap_mean(np.array(list(means.values())))


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    return [*lines, *("| " + " | ".join(row) + " |" for row in rows), ""]


def _with_ends(interval: Interval, digits: int) -> str:
    if np.isnan(interval.low):
        return f"{interval.mean:+.{digits}f}"
    ends = f"{interval.low:+.{digits}f} to {interval.high:+.{digits}f}"
    return f"**{interval.mean:+.{digits}f}** ({ends})"


@dataclass(frozen=True)
class Page:
    """All that was measured.

    Parameters
    ----------
    folder
        That has the files.
    trained
        Priors that are compared with total variation.
    measured, unseen
        Cases that have rows of all of them: of the main table, and with masks of no training.
    charts
        Of the Siemens star, two points and text.
    """

    folder: Path
    trained: tuple[str, ...]
    measured: list[Measured] = field(repr=False)
    unseen: list[Measured] = field(repr=False)
    charts: list[ChartRow] = field(repr=False)

    def write(self, page: Path, pictures: Path) -> None:
        """Write the page's part between the marks, and the pictures."""
        lines = self._head() if self.measured else ["No case is measured yet.", ""]
        if self.measured:
            lines += self._means() + self._differences() + self._by_mask() + self._photographs()
            lines += self._sheets(pictures)
        if self.unseen:
            lines += self._with_unseen()
        if self.charts:
            lines += chart_tables(self.charts)
            lines += chart_sheets(self.folder, self.charts, pictures)
        page.parent.mkdir(parents=True, exist_ok=True)
        write_part(page, "bench/priors.py", "\n".join(lines))

    @property
    def _figures(self) -> list[str]:
        """Those that all rows have."""
        every = [
            row
            for each in (*self.measured, *self.unseen)
            for of_prior in each.rows.values()
            for row in of_prior.values()
        ]
        return [name for name in FIGURES if all(name in row for row in every)]

    def _head(self) -> list[str]:
        machine = describe()
        photographs = {each.case.photograph.name for each in self.measured}
        debian = sorted({each.package for each in PHOTOGRAPHS} - set(INSTALLED))
        own = [
            max(rows, key=lambda weight: rows[weight]["psnr_db"]) == "auto"
            for each in self.measured
            for rows in (each.rows[kind] for kind in KINDS)
        ]
        lpips = [
            "LPIPS is left out: AlexNet's weights, 233 MB, are not on this machine, and come by a",
            "download alone ([compare](compare.md) takes them where they are).",
        ]
        return [
            f"Made by `make bench-priors` on {machine['cpu']}, one thread. "
            f"{len(photographs)} photographs, {len(MASKS)} masks and {len(EXPOSURES)} exposures:",
            f"{len(self.measured)} of {len(cases())} cases. The middle {PIXELS[0]}×{PIXELS[1]} "
            f"pixels of the paper's sensor, scenes of {ANGLE.removesuffix('deg')}°, a PSF that",
            "varies over the field, noise, a colour mosaic, exposed to a fraction of the full",
            "well; reconstructed with one PSF. Masks: the paper's, contours, random lenslets of",
            "150 µm. One factor for all of a picture is fitted to the truth. PSNR in dB with the",
            "truth's largest value as peak; figures as shown are of the sRGB values.",
            "",
            f"**{RETUNED}** is total variation at its best: for each case and each figure the",
            f"better of {' and '.join(KINDS)}, with the weight that is the best for the truth, of",
            "a grid by factors of two around the weight that the program chooses. It goes on until",
            "PSNR is worse. No user has the truth. The program's own weight had the best PSNR in",
            f"{statistics.mean(own):.0%} of the runs. All other rows are as they come, without a",
            "parameter. Differences are averaged over the cases of a photograph first; intervals",
            "(95 %, bootstrap) are of a mean over photographs.",
            "",
            "No photograph was used for training. `--fetch` downloads those of Debian's packages",
            f"{', '.join(debian)};",
            "they are not part of nolens.",
            *(lpips if isinstance(perceptual(), str) else []),
            "",
        ]

    def _means(self) -> list[str]:
        names = self._figures
        retuned = [f"{kind}, retuned" for kind in KINDS]
        methods = [*KINDS, *retuned, RETUNED, *self.trained]
        rows = []
        for method in methods:
            values = [
                statistics.mean(each.value(method, name) for each in self.measured)
                for name in names
            ]
            cells = [f"{value:.{UNITS[name][1]}f}"
                     for name, value in zip(names, values, strict=True)]  # fmt: skip
            times = [each.rows[method]["auto"]["seconds"]
                     for each in self.measured if method in each.rows]  # fmt: skip
            cells.append(f"{statistics.median(times):.1f}" if times else "")
            rows.append([method, *cells])
        heads = ["mean of all cases", *(UNITS[name][0] for name in names), "seconds (median)"]
        return _table(heads, rows)

    def _differences(self) -> list[str]:
        if not self.trained:
            return []
        rows = []
        for method in self.trained:
            cells = [
                _with_ends(_interval(self.measured, method, name), UNITS[name][1])
                for name in self._figures
            ]
            means = _by_photograph(self.measured, lambda each, m=method: each.over_tv(m, "psnr_db"))
            worst = min(means, key=means.__getitem__)
            case = min(self.measured, key=lambda each, m=method: each.over_tv(m, "psnr_db"))
            below = sum(each.over_tv(method, "psnr_db") < 0 for each in self.measured)
            rows.append([
                method, *cells, f"{means[worst]:+.2f} ({worst})",
                f"{case.over_tv(method, 'psnr_db'):+.2f} ({_where(case.case)})",
                f"{below} of {len(self.measured)}",
            ])  # fmt: skip
        heads = [
            f"over {RETUNED}", *(UNITS[name][0] for name in self._figures),
            "worst photograph", "worst case", "cases below",
        ]  # fmt: skip
        return ["Differences:", "", *_table(heads, rows)]

    def _by_mask(self) -> list[str]:
        rows = []
        for mask in MASKS:
            for exposure in (*EXPOSURES, None):
                part = [
                    each
                    for each in self.measured
                    if each.case.mask == mask and exposure in (None, each.case.exposure)
                ]
                if part:
                    name = "all" if exposure is None else f"{exposure:.0%}"
                    rows.append([mask, name, *self._cells(part)])
        heads = ["mask", "exposure", "cases", *self._columns]
        return ["By mask and exposure, PSNR in linear light:", "", *_table(heads, rows)]

    @property
    def _columns(self) -> list[str]:
        return [*KINDS, RETUNED, *(f"{each} over it" for each in self.trained)]

    def _cells(self, part: Sequence[Measured], *, ends: bool = True) -> list[str]:
        """Number of cases, PSNR of TV, and what trained priors add."""
        means = [
            f"{statistics.mean(each.value(method, 'psnr_db') for each in part):.2f}"
            for method in (*KINDS, RETUNED)
        ]
        added = [_interval(part, method, "psnr_db") for method in self.trained]
        texts = [_with_ends(each, 2) if ends else f"{each.mean:+.2f}" for each in added]
        return [str(len(part)), *means, *texts]

    def _photographs(self) -> list[str]:
        rows = []
        for photograph in PHOTOGRAPHS:
            part = [each for each in self.measured if each.case.photograph == photograph]
            source = [photograph.package, photograph.licence]
            if part:
                rows.append([photograph.name, *source, *self._cells(part, ends=False)])
        heads = ["photograph", "from", "licence", "cases", *self._columns]
        return ["By photograph:", "", *_table(heads, rows)]

    def _with_unseen(self) -> list[str]:
        rows = []
        for mask in UNSEEN:
            for exposure in sorted({each.case.exposure for each in self.unseen}, reverse=True):
                part = [
                    each
                    for each in self.unseen
                    if each.case.mask == mask and each.case.exposure == exposure
                ]
                rows.append([mask, f"{exposure:.0%}", *self._cells(part)])
            part = [each for each in self.unseen if each.case.mask == mask]
            rows.append([mask, "all", *self._cells(part)])
        heads = ["mask", "exposure", "cases", *self._columns]
        return [
            f"With PSFs of a kind that no prior was trained with, {len(self.unseen)} of "
            f"{len(unseen_cases())} cases:",
            "",
            *_table(heads, rows),
        ]

    def _sheets(self, folder: Path) -> list[str]:
        """Best, median and worst case of the photographs that may be shown."""
        by = self.trained[-1] if self.trained else None

        def order(each: Measured) -> float:
            return each.over_tv(by, "psnr_db") if by else each.value(RETUNED, "psnr_db")

        shown = sorted((each for each in self.measured if each.case.photograph.shown), key=order)
        if not shown:
            return []
        sign = "+" if by else ""
        chosen = {"best": shown[-1], "median": shown[len(shown) // 2], "worst": shown[0]}
        what = f"difference of {by} from {RETUNED}" if by else f"PSNR of {RETUNED}"
        names = ", ".join(each.name for each in PHOTOGRAPHS if each.shown)
        lines = [
            f"Best, median and worst case by {what}, of the {len(shown)} cases of photographs that",
            f"are in the public domain ({names}):",
            "",
        ]
        folder.mkdir(parents=True, exist_ok=True)
        for place, each in chosen.items():
            self._sheet(each, folder / f"{place}.png")
            text = f"{place.capitalize()}: {_where(each.case)}, {order(each):{sign}.2f} dB"
            lines += [f"![{text}]({folder.name}/{place}.png)", "", f"*{text}.*", ""]
        return lines

    def _sheet(self, measured: Measured, path: Path) -> None:
        case = measured.case
        shot = simulated(
            self.folder / "shots" / f"{case.name}.npz",
            case.mask,
            lambda: case.photograph.radiance(self.folder),
            case.exposure,
        )
        truth = shot.expected
        sheet = [SheetPicture(f"truth: {_where(case)}", truth)]
        kinds = {
            kind: max(row["psnr_db"] for row in measured.rows[kind].values()) for kind in KINDS
        }
        for prior in (max(kinds, key=kinds.__getitem__), *self.trained):
            best = max(row["psnr_db"] for row in measured.rows[prior].values())
            name = f"{prior}, retuned" if prior in KINDS else prior
            with np.load(self.folder / "rows" / case.name / f"{prior}.npz") as kept:
                picture = torch.from_numpy(kept["picture"]).float()
            sheet.append(SheetPicture(f"{name}: {best:.2f} dB", picture))
        write_contact_sheet(path, pictures=sheet, white=float(truth.max()))


def _where(case: Case) -> str:
    return f"{case.photograph.name}, {case.mask}, {case.exposure:.0%}"
