"""A picture of how far away things are."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from torch import Tensor

from nolens.files.write_stack import depth_text

_WIDE_INCHES = 7.5
_UNKNOWN = 0.25
_MOST_TICKS = 12


def plot_depth(path: Path, per_m: Tensor, confidence: Tensor, depths_um: Sequence[float]) -> None:
    """Draw a depth map in colours, and grey where nothing tells the depth.

    Parameters
    ----------
    path
        PNG to be written.
    per_m
        1/z of every pixel in 1/m, (rows, columns).
    confidence
        From 0 to 1, as `nolens.refocusing.AllInFocus` has it.
    depths_um
        Depths of the stack that it comes from, the nearest first.
    """
    # It takes a third of a second, which other commands need not wait.
    import matplotlib as mpl
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    known = [1e6 / each for each in depths_um]
    norm, colours = Normalize(min(known), max(known) + 1e-9), mpl.colormaps["viridis"]
    shown = colours(norm(per_m.numpy()))[..., :3]
    sure = (confidence / _UNKNOWN).clamp(0, 1).numpy()[..., None]
    shown = shown * sure + 0.75 * (1 - sure)
    rows, columns = per_m.shape
    size = (_WIDE_INCHES, np.clip(_WIDE_INCHES * 0.8 * rows / columns + 0.5, 2, 12))
    with mpl.rc_context({"font.size": 9}):
        figure = Figure(figsize=size, dpi=120, layout="constrained")
        axes = figure.add_subplot()
        axes.imshow(shown, interpolation="nearest")
        axes.set_xlabel("column, pixels")
        axes.set_ylabel("row, pixels")
        bar = figure.colorbar(ScalarMappable(norm, colours), ax=axes)
        every = -(-len(known) // _MOST_TICKS)
        bar.set_ticks(known[::every], labels=[depth_text(each) for each in depths_um[::every]])
        bar.set_label("distance (grey: not known)")
        figure.savefig(path, metadata={"Software": None})
