"""`nolens refocus`: pictures at any depth of one measurement."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from nolens.camera import Measurement, arrange_rgb, develop, exposure_white
from nolens.errors import OptionError
from nolens.files import read_frame, write_png, write_tiff16
from nolens.files.plot_depth import plot_depth
from nolens.files.write_slider import SliderPage, write_slider
from nolens.files.write_stack import write_depths, write_stack
from nolens.files.write_sweep import write_sweep
from nolens.jobs.reconstruction.window import oriented, region_within
from nolens.jobs.refocusing.options import FOCUSED_FILES, STACK_FILES, RefocusOptions, depth_um
from nolens.jobs.refocusing.psfs import DepthPsfs, read_depth_psfs
from nolens.jobs.run import Product, Reporter, Run, Writer, job
from nolens.refocusing import (
    AllInFocus,
    Search,
    Sharpest,
    Solving,
    Stack,
    all_in_focus,
    even_depths,
    focal_stack,
    line_cells,
    per_m,
)
from nolens.refocusing import depth_um as depth_of
from nolens.solvers import admm_bytes

_WINDOW_LINES = 1.5
"""Width of the smallest window that tells depths, in lines of the PSF."""


@dataclass(frozen=True)
class Pages:
    """A focal stack, and what it shows of the scene.

    Parameters
    ----------
    stack
        Pictures as they are written.
    together
        The picture that is sharp everywhere, and the depths.
    """

    stack: Stack
    together: AllInFocus


def stack_writers(folder: Path, pages: Pages, title: str) -> dict[Path, Callable[[Path], None]]:
    """What writes each file of a stack.

    All pictures have one white, that of the picture which is sharp everywhere.

    Parameters
    ----------
    folder
        Where they go.
    pages
        What they show.
    title
        Of the page with the slider.
    """
    stack, together = pages.stack, pages.together
    white = exposure_white(together.picture)
    depths = stack.depths_um
    first, last = per_m(depths[0]), per_m(depths[-1])
    span = first - last or 1.0
    places = [(first - per_m(each)) / span for each in depths]
    steps = max(1, len(depths) - 1)
    numbers = ((first - together.per_m) / span * steps).round().long().clamp(0, len(depths) - 1)
    slider = SliderPage(title, stack.pages, depths, places, together.picture, numbers, white)
    return {
        folder / STACK_FILES[what]: write
        for what, write in {
            "stack": partial(write_stack, pages=stack.pages, depths_um=depths, white=white),
            "sweep": partial(
                write_sweep, pages=stack.pages, depths_um=depths, places=places, white=white
            ),
            "page with a slider": partial(write_slider, page=slider),
            "picture that is sharp everywhere": partial(write_png, radiance=together.picture),
            "depth map": partial(
                plot_depth, per_m=together.per_m, confidence=together.confidence, depths_um=depths
            ),
            "depths": partial(write_depths, per_m=together.per_m),
        }.items()
    }


@dataclass(frozen=True)
class RefocusWork:
    """All that has been checked before the first depth is reconstructed.

    Parameters
    ----------
    options
        What was asked for.
    psfs
        Of any depth.
    solving
        How every depth is reconstructed.
    reporter
        Sees every look.

    Raises
    ------
    OptionError
        If a place lies beside the picture, or nothing says where to look for the sharpest depth.
    """

    options: RefocusOptions
    psfs: DepthPsfs
    solving: Solving
    reporter: Reporter

    def __post_init__(self) -> None:
        self.place()
        if self.options.focused and self.options.depth is None:
            self.range_um()

    def range_um(self) -> tuple[float, float]:
        """Depths between which the sharpest one is sought."""
        if self.options.search is not None:
            near, far = self.options.search
            return depth_um(near), depth_um(far)
        near_um, far_um = self.psfs.distances_um[0], self.psfs.distances_um[-1]
        if near_um == far_um:
            raise OptionError(
                f"the folder {self.options.psfs} has PSFs of one distance only: say between which "
                "depths the sharpest is to be found (--search 8cm,infinity), or the depth (--depth "
                "8cm)"
            )
        return near_um, far_um

    def depths_um(self) -> tuple[float, ...]:
        """Depths of the stack."""
        assert self.options.stack is not None
        near, far = self.options.stack
        return even_depths(depth_um(near), depth_um(far), self.options.steps)

    def search(self) -> Search:
        """For the sharpest depth."""
        return Search(self.solving, self.psfs.at, *self.range_um(), self.psfs.depth_of_focus_per_m)

    def shown(self) -> tuple[int, int]:
        """(rows, columns) of the picture."""
        region = self.solving.region
        return self.solving.sensor if region is None else (region.height, region.width)

    def place(self) -> tuple[float, float] | None:
        """The place that is to be sharp, in a picture that is not turned over.

        Raises
        ------
        OptionError
            If it lies beside the picture.
        """
        if self.options.at is None:
            return None
        (row, column), (rows, columns) = self.options.at, self.shown()
        if row >= rows or column >= columns:
            raise OptionError(
                f"--at {row},{column} lies beside the picture, which has {rows}×{columns} pixels: "
                f"give a row up to {rows - 1} and a column up to {columns - 1}"
            )
        flip = self.options.flip
        return (
            rows - 1.0 - row if flip in ("vertical", "both") else float(row),
            columns - 1.0 - column if flip in ("horizontal", "both") else float(column),
        )

    def needed(self) -> float:
        """Bytes that are held while a depth is solved for."""
        psf = self.psfs.at(self.psfs.distances_um[-1])
        return admm_bytes(self.solving.problem(psf).cells)

    def depth_um(self, found: Sharpest | None) -> float:
        """What is asked for, or what was found."""
        if found is not None:
            return found.depth_um
        assert self.options.depth is not None
        return depth_um(self.options.depth)

    def focused(self) -> tuple[Tensor, Sharpest | None]:
        """Picture at the depth that is asked for, or at the sharpest one."""
        found = None
        if self.options.depth is None:
            found = self.search().run(self.place(), partial(self._step, kept="the sharpest depth"))
        psf = self.psfs.at(self.depth_um(found))
        limit = self.solving.iterations

        def advance(iteration: int) -> bool:
            # After a search that was ended the picture at what it found is still wanted.
            stop = self._step(iteration, limit, kept="the picture")
            return stop and (found is None or found.finished)

        result = self.solving.solve(psf, lambda progress: advance(progress.iteration))
        picture = self._picture(result.photograph.cpu())
        exposure_white(picture)  # An empty picture is an error before anything is written.
        return picture, found

    def stacked(self) -> tuple[Pages, bool]:
        """All depths of the stack, and whether it was ended before the last one."""
        depths = self.depths_um()
        made = focal_stack(
            self.solving, self.psfs.at, depths, partial(self._step, kept="the depths")
        )
        pages = torch.stack([self._picture(page) for page in made.pages])
        line = line_cells(self.psfs.between.known[0].psf) / self.psfs.bin_by
        stack = replace(made, pages=pages)
        together = all_in_focus(stack, _WINDOW_LINES * line)
        exposure_white(together.picture)  # As above.
        return Pages(stack, together), len(pages) < len(depths)

    def told(self, found: Sharpest | None) -> dict[str, Any]:
        """Figures of the picture at one depth."""
        depth = self.depth_um(found)
        half = self.psfs.depth_of_focus_per_m / 2
        nearest, farthest = depth_of(per_m(depth) + half), depth_of(max(0, per_m(depth) - half))
        summary: dict[str, Any] = {
            "depth_mm": in_mm(depth),
            "sharp_from_mm": in_mm(nearest),
            "sharp_to_mm": in_mm(farthest),
        }
        if found is not None:
            summary["tried"] = [
                {
                    "depth_mm": in_mm(each.depth_um),
                    "objective": each.objective,
                    "sharpness": each.sharpness,
                }
                for each in found.tried
            ]
        return summary

    def warnings(self) -> list[str]:
        """What can be said before the work begins."""
        texts = list(self.psfs.warnings)
        wanted = []
        if self.options.depth is not None:
            wanted.append(depth_um(self.options.depth))
        elif self.options.focused:
            near, far = self.range_um()
            wanted += [near, far]
            if per_m(near) - per_m(far) < self.psfs.depth_of_focus_per_m:
                texts.append(
                    "all depths that are looked at lie within one depth of focus "
                    f"({self.psfs.depth_of_focus_per_m:.3g}/m in 1/z): they look alike, and "
                    "which one is found means little"
                )
        if self.options.stack is not None:
            wanted += [depth_um(each) for each in self.options.stack]
        least, most = (per_m(self.psfs.distances_um[end]) for end in (-1, 0))
        room = self.psfs.depth_of_focus_per_m
        beyond = [each for each in wanted if not least - room <= per_m(each) <= most + room]
        if beyond:
            have = " to ".join(
                f"{in_mm(each)} mm" if math.isfinite(each) else "infinity"
                for each in dict.fromkeys((self.psfs.distances_um[0], self.psfs.distances_um[-1]))
            )
            texts.append(
                f"the PSFs are of {have}; beyond, they are magnified as rays are, which leaves out "
                "what the distance does to the mask's focus: calibrate at such a distance for more"
            )
        return texts

    def doubts(self, found: Sharpest | None) -> list[str]:
        """What the search left open."""
        if found is None or not found.at_end or not found.finished:
            return []
        if math.isinf(found.depth_um):
            return []
        return [
            f"the sharpest depth is the end of those that were looked at, {in_mm(found.depth_um)} "
            "mm: the true one may lie beyond (--search)"
        ]

    def _picture(self, scene: Tensor) -> Tensor:
        shown = arrange_rgb(scene, self.solving.measurement.channels)
        return oriented(shown, self.options.flip)

    def _step(self, done: int, limit: int, *, kept: str) -> bool:
        return self.reporter.step("iteration", done, limit, kept)


def in_mm(depth: float) -> float | str:
    """A depth in um as JSON has it: mm, or the word infinity."""
    return "infinity" if math.isinf(depth) else round(depth * 1e-3, 3)


@dataclass(frozen=True)
class Refocused:
    """Pictures of a refocusing.

    Parameters
    ----------
    picture
        Radiance at the depth that was asked for or found; None if only a stack was.
    pages
        The focal stack; None without one.
    """

    picture: Tensor | None
    pages: Pages | None


@job
def refocus(run: Run[RefocusOptions]) -> Product[Refocused]:
    """Find the depth, reconstruct, and write pictures, stack and record.

    Raises
    ------
    NolensError
        If an input, an option or an output cannot be used; then nothing is written.
    """
    options, reporter = run.options, run.reporter
    measurement = _measured(options)
    psfs = read_depth_psfs(options, measurement)
    run.reads(psfs.files)
    work = RefocusWork(options, psfs, _solving(options, measurement, psfs, run.device), reporter)
    run.warn(*work.warnings())
    run.begin(work.needed())

    figures: dict[str, Any] = {
        "depth_of_focus_per_m": psfs.depth_of_focus_per_m,
        "mask_to_sensor_um": psfs.between.reduced_um,
        "psf_distances_mm": [in_mm(each) for each in psfs.distances_um],
    }
    picture, pages, stopped = None, None, False
    writers: dict[Path, Writer] = {}
    if options.focused:
        picture, found = work.focused()
        stopped = found is not None and not found.finished
        figures |= work.told(found)
        run.warn(*work.doubts(found))
        for name, write in zip(FOCUSED_FILES, (write_png, write_tiff16), strict=True):
            writers[options.output / name] = partial(write, radiance=picture)
    if options.stack is not None and not stopped:
        pages, stopped = work.stacked()
        figures["stack_mm"] = [in_mm(each) for each in pages.stack.depths_um]
        writers |= stack_writers(options.output, pages, f"{options.measurement.name} refocused")
    figures["stop_reason"] = "interrupted" if stopped else "finished"
    return Product(Refocused(picture, pages), figures, writers)


def _measured(options: RefocusOptions) -> Measurement:
    read = partial(read_frame, mosaic=options.mosaic, bgr=options.bgr)
    frame = read(options.measurement)
    dark = read(options.dark) if options.dark else None
    flat = read(options.flat) if options.flat else None
    return develop(
        frame,
        dark=dark,
        flat=flat,
        black=options.black,
        white=options.white,
        bin_by=options.bin,
        channels=options.channels,
    )


def _solving(
    options: RefocusOptions, measurement: Measurement, psfs: DepthPsfs, device: torch.device
) -> Solving:
    sensor = measurement.values.shape[-2], measurement.values.shape[-1]
    region = None
    if options.support is not None:
        region = region_within(options.support, sensor, psfs.at(psfs.distances_um[-1]))
    return Solving(
        measurement, region, options.tau, options.prior, options.iterations, device=device
    )
