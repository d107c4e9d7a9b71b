"""The files of a focal stack."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from nolens.camera import exposure_white
from nolens.files import write_png
from nolens.files.plot_depth import plot_depth
from nolens.files.write_slider import SliderPage, write_slider
from nolens.files.write_stack import write_depths, write_stack
from nolens.files.write_sweep import write_sweep
from nolens.jobs.refocusing.options import STACK_FILES
from nolens.refocusing import AllInFocus, Stack, per_m


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
