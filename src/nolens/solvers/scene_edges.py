"""Where a scene ends, as its photograph shows: dark lines, and then light at once."""

import torch
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
_STEPS = 0.2
"""Of the logarithm of light, the rise at both of two lines together, at least, that lie as far from
the frame's middle."""
_LEAST, _STEP = 0.03, 0.6
"""That of each of them at least, and as much as counts: one that is very clear is not enough."""
_PARTS = 20
"""Of a line: a scene ends along all of them, what is in it not."""
_TRIM = 0.3, 0.6
"""Of the parts, in the order of their rises, where those begin and end whose mean is the line's:
nothing in a scene that is up to two fifths as wide counts."""
_GLOW, _LESS = 1.1, 0.75
"""Of lines before such a step, or of those after it, what lines further out have at most."""
_NO_LIGHT = 0.1
"""Of the scene's mean, that of a line as which darker ones count."""
_DIM = 0.3
"""Of the scene's mean, less than which lines have that are left out without such a step."""
_BEGINS = 0.25
"""Of the logarithm of light, the rise where a scene may begin beside lines that are less dim."""
_PART = 0.2
"""Of the way from dark to lit, from which on a line has some of the scene."""
_INNERMOST = 0.4
"""Of all lines, those before either of them at most."""
_ENDS = 4
"""Lines from where the PSF's support ends, within which steps are the PSF's."""
_PAIRS = 3
"""Pairs of steps that are asked for at most, the largest first."""
_SEPARATE = 2
"""Lines within which two steps are the same."""

Edges = tuple[int | None, ...]
"""Lines between which a scene lies: top, bottom, left and right of it; None where unclear."""
NO_EDGES: Edges = (None,) * 4
"""All unclear."""


def scene_edges(scene: Tensor, support: PixelRectangle, *, exact: bool = False) -> Edges:
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
    exact
        Whether the last of the dark lines is left out, too. On larger pixels it has a part of the
        scene, maybe.
    """
    brightest = _brightest(scene)
    top, bottom, left, right = (
        _dark_lines(plane, exact=exact)
        for plane in (brightest, brightest.flip(0), brightest.T, brightest.T.flip(0))
    )
    return (
        support.top + top if top else None,
        support.bottom - bottom if bottom else None,
        support.left + left if left else None,
        support.right - right if right else None,
    )


def centred_edges(
    scene: Tensor,
    support: PixelRectangle,
    edges: Edges,
    sensor: tuple[int, int],
    psf_support: PixelRectangle,
) -> tuple[list[Edges], list[Edges]]:
    r"""Pairs of edges as far from the frame's middle, where one side or none is clear.

    With L the logarithm of light in a part of line k, that line's rise is the trimmed mean over the
    parts (of those from 0.3 to 0.6 in their order) of

    .. math:: \tfrac{1}{2}(L_{k+1} + L_{k+2}) - \tfrac{1}{2}(L_{k-1} + L_{k-2})
              - \max(0, L_{k-1} - L_{k-4})

    The last term is the slope of the glow that noise has beside a scene, where no side is clear by
    itself. The pairs have the largest rises together. Cameras are pointed at what they photograph;
    that two steps of something else are as far from the middle is chance. Without such lines, what
    lies opposite to a clear side, as long as that cuts off no light.

    Parameters
    ----------
    scene, support
        As `scene_edges` takes them.
    edges
        As it gives them.
    sensor
        (height, width) of the frame.
    psf_support
        Pixels whose light the PSF has on all of the sensor: where they end is a step, too.

    Returns
    -------
    Top and bottom, and left and right: pairs, the likeliest first.
    """
    brightest = _brightest(scene)
    rows = psf_support.top, psf_support.bottom
    columns = psf_support.left, psf_support.right
    return (
        _opposite(brightest, support.top, edges[:2], sensor[0], rows),
        _opposite(brightest.T, support.left, edges[2:], sensor[1], columns),
    )


def at_edges(support: PixelRectangle, edges: Edges, margin: int = 1) -> PixelRectangle:
    """A support with its sides beside edges, where those are clear.

    Parameters
    ----------
    support
        To move the sides of.
    edges
        As `scene_edges` gives them.
    margin
        Pixels from an edge outwards to the side.
    """
    sides = support.top, support.bottom, support.left, support.right
    top, bottom, left, right = (
        side if edge is None else edge + margin * outwards
        for side, edge, outwards in zip(sides, edges, (-1, 1, -1, 1), strict=True)
    )
    return PixelRectangle(top, left, bottom - top, right - left)


def _brightest(scene: Tensor) -> Tensor:
    """The brightest channel of each pixel, over the mean of that channel."""
    return (scene / scene.mean((-2, -1), keepdim=True).clamp_min(1e-30)).amax(0)


def _opposite(
    plane: Tensor, first: int, edges: Edges, size: int, psf_ends: tuple[int, int]
) -> list[Edges]:
    """Pairs of one direction: its lines, where in the frame they begin, the size of that."""
    start, end = edges
    if start is not None and end is not None:
        return []
    pairs: list[Edges] = list(_steps_opposite(plane, first, size, psf_ends))
    if pairs and any(
        edge is not None and step is not None and abs(edge - step) <= 1
        for edge, step in zip(edges, pairs[0], strict=True)
    ):
        pairs = []
    if start is not None and 2 * start < size:
        after = first + len(plane) - (size - start)
        pairs.append((start, size - start if _may_begin(plane.flip(0), after) else None))
    elif end is not None and 2 * end > size:
        pairs.append((size - end if _may_begin(plane, size - end - first) else None, end))
    return pairs


def _steps_opposite(
    plane: Tensor, first: int, size: int, psf_ends: tuple[int, int]
) -> list[tuple[int, int]]:
    """Steps that lie as far from the middle, but for a line: those that are largest together."""
    starts, ends = _step_lines(plane), _step_lines(plane.flip(0))
    pairs = []
    for before, rise in starts.items():
        start = first + before
        for after, fall in ends.items():
            end = first + len(plane) - after
            both = min(rise, _STEP) + min(fall, _STEP)
            to_ends = min(abs(start - psf_ends[0]), abs(end - psf_ends[1]))
            if abs(start + end - size) <= 1 and both >= _STEPS and to_ends > _ENDS:
                pairs.append((both, start, end))
    pairs.sort(reverse=True)
    largest: list[tuple[int, int]] = []
    for _, start, end in pairs:
        if all(abs(start - other) > _SEPARATE for other, _ in largest):
            largest.append((start, end))
    return largest[:_PAIRS]


def _step_lines(plane: Tensor) -> dict[int, float]:
    """Numbers of lines before light that rises at once, beside glow; and by how much."""
    means: list[float] = plane.mean(1).tolist()
    lines: dict[int, float] = {}
    for before, rise in _rises(plane).items():
        if rise >= _LEAST and before <= _INNERMOST * len(means) and _beside_glow(means, before):
            lit = _first_lit(means, before)
            lines[lit] = max(rise, lines.get(lit, 0.0))
    return lines


def _beside_glow(means: list[float], before: int) -> bool:
    """Whether light further out than the lines before a step is less, as that of glow is."""
    glow = sum(means[before - 2 : before]) / 2
    return max(means[:before]) <= max(_GLOW * glow, _LESS * means[before + 1])


def _first_lit(means: list[float], before: int) -> int:
    """Lines before a step, without those that the scene fills in part."""
    dark = sum(means[before - 2 : before]) / 2
    lit = sum(means[before + 1 : before + 3]) / 2
    near = (before - 1, before)
    return next((k for k in near if means[k] > dark + _PART * (lit - dark)), before + 1)


def _may_begin(plane: Tensor, before: int) -> bool:
    """Whether a scene may begin after so many lines: they are dim, or it gets bright at once."""
    rises = _rises(plane)
    return max(plane.mean(1)[: max(before, 0)].tolist(), default=0) < _DIM or any(
        rises.get(near, 0.0) >= _BEGINS for near in (before - 1, before, before + 1)
    )


def _rises(plane: Tensor) -> dict[int, float]:
    """The rise of each line that has enough beside it, as `centred_edges` defines it."""
    if len(plane) < 7:
        return {}
    parts = torch.stack([each.mean(1) for each in plane.chunk(_PARTS, 1)], 1)
    light = (parts + _NO_LIGHT).log()
    after = (light[5:-1] + light[6:]) / 2
    before = (light[3:-3] + light[2:-4]) / 2
    slope = (light[3:-3] - light[:-6]).clamp_min(0)
    rises = (after - before - slope).sort(1).values
    first, end = (round(share * rises.shape[1]) for share in _TRIM)
    return dict(enumerate(rises[:, first:end].mean(1).tolist(), 4))


def _dark_lines(plane: Tensor, *, exact: bool) -> int:
    """How many of a plane's first lines are dark, with light after them; 0 where none surely is."""
    means = plane.mean(1).tolist()
    near = nnf.avg_pool1d(plane[:, None], min(_POINT_SIDE, plane.shape[1]), 1)
    points = near.amax((1, 2)).tolist()
    before = 0.0
    for line in range(min(int(_MOST * len(means)), len(means) - 3) + 1):
        here, following, third = means[line : line + 3]
        dark = here <= _DARK and points[line] <= _POINT
        rises = here > min(2 * before, _DARK)
        lit = max(here, following) >= max(_LIT, _JUMP * before)
        stays = following > max(_GOES_ON * here, _LEVEL * third)
        if line and rises and lit and stays:
            return line + 1 if exact and dark and following >= _JUMP * here else line
        if not dark:
            return 0
        before = max(before, here)
    return 0
