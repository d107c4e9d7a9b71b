"""Where a scene ends, as its photograph shows: dark lines, and then light at once."""

import math

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
_STEP, _STEPS = 1.35, 4.0
"""Of two lines over the two before them, at least, at either of two sides that lie as far from the
frame's middle; and of both together."""
_BRIGHT, _NO_LIGHT = 0.25, 0.1
"""Of the scene's mean, that of the second line of such a step at least; and that of a line as which
darker ones count."""
_DIM = 0.3
"""Of the scene's mean, less than which lines have that are left out without such a step."""
_LESS = 0.75
"""Of that line, less than which all lines before the step have."""
_PART = 0.2
"""Of the way from dark to lit, from which on a line has some of the scene."""
_FIRST, _INNERMOST = 4, 0.4
"""Lines before such a step at least: light of a scene that is cut rises there. Of all lines, those
before it at most."""

Edges = tuple[int | None, ...]
"""Lines between which a scene lies: top, bottom, left and right of it; None where unclear."""
NO_EDGES: Edges = (None,) * 4
"""All unclear."""


def scene_edges(scene: Tensor, support: PixelRectangle) -> Edges:
    """Where a scene ends, at each side by itself.

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
    brightest = _brightest(scene)
    top, bottom = _dark_lines(brightest), _dark_lines(brightest.flip(0))
    left, right = _dark_lines(brightest.T), _dark_lines(brightest.T.flip(0))
    return (
        support.top + top if top else None,
        support.top + support.height - bottom if bottom else None,
        support.left + left if left else None,
        support.left + support.width - right if right else None,
    )


def centred_edges(
    scene: Tensor, support: PixelRectangle, edges: Edges, sensor: tuple[int, int]
) -> Edges:
    """Edges as far from the frame's middle on both sides, where one side or none is clear.

    Those are the two lines as far from the middle where the light rises most at once, by 1.35 times
    at either and by 4 times in their product: noise has a glow beside the scene, and no side is
    clear by itself. Cameras are pointed at what they photograph; that two steps of something else
    are as far from the middle is chance. Without such lines, what lies opposite to a clear side, as
    long as that cuts off no light.

    Parameters
    ----------
    scene, support
        As `scene_edges` takes them.
    edges
        As it gives them.
    sensor
        (height, width) of the frame.
    """
    brightest = _brightest(scene)
    rows, columns = brightest.mean(1).tolist(), brightest.mean(0).tolist()
    return (
        *_opposite(rows, support.top, edges[:2], sensor[0]),
        *_opposite(columns, support.left, edges[2:], sensor[1]),
    )


def at_edges(support: PixelRectangle, edges: Edges, by: int) -> PixelRectangle:
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


def _brightest(scene: Tensor) -> Tensor:
    """The brightest channel of each pixel, over the mean of that channel."""
    return (scene / scene.mean((-2, -1), keepdim=True).clamp_min(1e-30)).amax(0)


def _opposite(lines: list[float], first: int, edges: Edges, size: int) -> Edges:
    """Edges of one direction: its lines' brightness, where in the frame they begin, its size."""
    start, end = edges
    if start is not None and end is not None:
        return edges
    steps = _steps_opposite(lines, first, size)
    if steps is not None and all(
        edge is None or abs(edge - step) > 1 for edge, step in zip(edges, steps, strict=True)
    ):
        return steps
    if start is not None and 2 * start < size:
        after = first + len(lines) - (size - start)
        return start, size - start if _may_begin(lines[::-1], after) else None
    if end is not None and 2 * end > size:
        before = size - end - first
        return size - end if _may_begin(lines, before) else None, end
    return edges


def _steps_opposite(lines: list[float], first: int, size: int) -> tuple[int, int] | None:
    """The two steps that lie as far from the middle, but for a line, and are largest together."""
    rises, falls = _steps(lines), _steps(lines[::-1])
    most, found = math.log(_STEPS), None
    for before, rise in rises.items():
        opposite = 2 * first + len(lines) - size + before
        for after in (opposite - 1, opposite, opposite + 1):
            both = rise + falls.get(after, -math.inf)
            if both > most:
                most = both
                end = first + len(lines) - _first_lit(lines[::-1], after)
                found = first + _first_lit(lines, before), end
    return found


def _first_lit(lines: list[float], before: int) -> int:
    """Lines before a step, without those that the scene fills in part."""
    dark, lit = min(lines[before - 3 : before - 1]), lines[before + 1]
    part = lines[before - 1] > dark + _PART * (lit - dark)
    return before - part


def _may_begin(lines: list[float], before: int) -> bool:
    """Whether a scene may begin after so many lines: they are dim, or it gets bright at once."""
    steps = _steps(lines)
    return max(lines[: max(before, 0)], default=0) < _DIM or any(
        near in steps for near in (before - 1, before, before + 1)
    )


def _steps(lines: list[float]) -> dict[int, float]:
    """Numbers of lines after which the light rises at once, and the logarithm by how much."""
    rises = {
        before: sum(lines[before : before + 2])
        / sum(max(each, _NO_LIGHT) for each in lines[before - 2 : before])
        for before in range(2, len(lines) - 1)
    }
    return {
        before: math.log(rise)
        for before, rise in rises.items()
        if rise > _STEP
        and _FIRST <= before <= _INNERMOST * len(lines)
        and lines[before + 1] > _BRIGHT
        and max(lines[:before]) < _LESS * lines[before + 1]
        and rise >= max(rises.get(beside, 0.0) for beside in (before - 1, before + 1))
    }


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
