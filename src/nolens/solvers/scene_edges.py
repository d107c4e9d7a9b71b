"""Where a scene ends, as its photograph shows: dark lines, and then light at once."""

import torch.nn.functional as nnf
from torch import Tensor

from nolens.operators import PixelRectangle

_DARK = 0.12
"""Of the scene's mean, that of a line beside the scene at most: some light strays there."""
_POINT, _POINT_SIDE = 0.3, 5
"""The same of the brightest pixels of such a line, as many of them as these together."""
_LIT, _JUMP = 0.2, 4.0
"""Of the scene's mean, and of the brightest line beside it, that of a line of it at least."""
_GOES_ON, _LEVEL = 0.8, 0.7
"""Of the first line of a scene, the second at least; of the third, the second: no slow rise."""
_MOST = 0.15
"""Of all lines, those at one side that may be dark: an even sky stays."""


def scene_edges(scene: Tensor, support: PixelRectangle) -> tuple[int | None, ...]:
    """Lines of the frame between which a scene lies: top, bottom, left and right.

    A support that is too large by a few lines is dark there in a photograph that has converged:
    each at most 0.12 of the scene's mean, and then comes one of four times as much or more. Where
    it is too small the light rises slowly, and a sky that is dark itself is wider. None of a side
    where that is not clear.

    Parameters
    ----------
    scene
        (channels, height, width), of the support.
    support
        Pixels of the frame, a line or more larger than the scene is likely to be.
    """
    values = scene / scene.mean((-2, -1), keepdim=True).clamp_min(1e-30)
    brightest = values.amax(0)
    top, bottom = _dark_lines(brightest), _dark_lines(brightest.flip(0))
    left, right = _dark_lines(brightest.T), _dark_lines(brightest.T.flip(0))
    return (
        support.top + top if top else None,
        support.top + support.height - bottom if bottom else None,
        support.left + left if left else None,
        support.left + support.width - right if right else None,
    )


def at_edges(support: PixelRectangle, edges: tuple[int | None, ...], by: int) -> PixelRectangle:
    """A support with its sides half a larger pixel beside edges, where those are clear.

    Parameters
    ----------
    support
        To move the sides of.
    edges
        As `scene_edges` gives them, on pixels that are by×by of the support's.
    by
        Its pixels along each of those.
    """
    sides = (
        support.top,
        support.top + support.height,
        support.left,
        support.left + support.width,
    )
    margin = max(1, by // 2)
    top, bottom, left, right = (
        side if edge is None else by * edge + margin * outwards
        for side, edge, outwards in zip(sides, edges, (-1, 1, -1, 1), strict=True)
    )
    return PixelRectangle(top, left, bottom - top, right - left)


def _dark_lines(plane: Tensor) -> int:
    """How many of a plane's first lines are dark, with light after them; 0 where none surely is."""
    means = plane.mean(1).tolist()
    near = nnf.avg_pool1d(plane[:, None], min(_POINT_SIDE, plane.shape[1]), 1)
    points = near.amax((1, 2)).tolist()
    before = 0.0
    for line in range(min(int(_MOST * len(means)), len(means) - 3) + 1):
        here, following, third = means[line : line + 3]
        rises = here > min(2 * before, _DARK)
        lit = max(here, following) >= max(_LIT, _JUMP * before)
        stays = following > max(_GOES_ON * here, _LEVEL * third)
        if line and rises and lit and stays:
            return line
        if here > _DARK or points[line] > _POINT:
            return 0
        before = max(before, here)
    return 0
