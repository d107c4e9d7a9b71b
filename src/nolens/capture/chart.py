"""A scene for a camera that is shown none: lines, colours and greys, drawn."""

import torch
from torch import Tensor

from nolens.evaluate import siemens_star

_COLOURS = (
    (0.9, 0.05, 0.04),
    (0.08, 0.7, 0.1),
    (0.05, 0.1, 0.85),
    (0.9, 0.75, 0.05),
    (0.75, 0.08, 0.6),
    (0.06, 0.65, 0.75),
)
_GREYS = (1.0, 0.6, 0.35, 0.2, 0.1, 0.04)


def chart(height: int = 360, width: int = 480) -> Tensor:
    """Draw a star of spokes, patches of colour and steps of grey on a dark ground.

    Parameters
    ----------
    height, width
        In pixels, at least 48.

    Returns
    -------
    Tensor
        Linear radiance, float32, (3, height, width); 1 is white.
    """
    picture = torch.full((3, height, width), 0.02)
    edge = min(height, width) // 24
    side = min(height - 4 * edge, (2 * width) // 3 - 2 * edge) // 2 * 2
    top = (height - side) // 2
    picture[:, top : top + side, edge : edge + side] += 0.9 * siemens_star(side, 16)
    left, right = side + 2 * edge, width - edge
    rows = torch.linspace(top, top + side, len(_COLOURS) + 1).round().int().tolist()
    middle = (left + right) // 2
    for number, (colour, grey) in enumerate(zip(_COLOURS, _GREYS, strict=True)):
        first, last = rows[number], rows[number + 1]
        picture[:, first:last, left:middle] = torch.tensor(colour)[:, None, None]
        picture[:, first:last, middle:right] = grey
    return picture
