"""A screen that pictures are shown on before a camera, and the one before a simulated camera."""

import math
from typing import Protocol

import numpy as np
import torch
import torch.nn.functional as nnf
from scipy import ndimage
from torch import Tensor

from nolens.calibrate.screen_place import Place
from nolens.capture.twin import TwinSource

_DOT = 1 / 8
"""Side of a dot, in heights of the screen."""
_PLACES = (0.1, 0.5, 0.9)
_TURN_DEG, _OFF = 1.5, (0.02, -0.03)
"""A simulated screen is turned, and lies aside by so many of its heights, as real ones do."""


class Screen(Protocol):
    """Something that shows pictures, one at a time."""

    @property
    def size(self) -> tuple[int, int]:
        """(rows, columns) of its pixels."""

    def show(self, picture: Tensor) -> None:
        """Show a picture on all of it, and return when it can be seen.

        Parameters
        ----------
        picture
            Linear, (3, rows, columns) of its size; 1 is as bright as it becomes.

        Raises
        ------
        ScreenError
            If it does not show it.
        """

    def close(self) -> None:
        """End."""


class TwinScreen(Screen):
    """What a simulated camera sees of a flat screen, by the field angles of its pixels.

    Parameters
    ----------
    source
        The camera; open.
    width_mm, distance_mm
        Of the screen, and how far it is away.
    """

    size = (180, 320)

    def __init__(self, source: TwinSource, width_mm: float, distance_mm: float) -> None:
        self._source = source
        rows, columns = (each.numpy() * distance_mm for each in source.tangents())
        pitch_mm = width_mm / self.size[1]
        turn = math.radians(_TURN_DEG)
        down = math.cos(turn) * rows - math.sin(turn) * columns
        right = math.sin(turn) * rows + math.cos(turn) * columns
        self.places = np.stack([
            line / pitch_mm + (count - 1) / 2 - off * self.size[0]
            for line, count, off in zip((down, right), self.size, _OFF, strict=True)
        ])  # fmt: skip
        """(row, column) on the screen of every pixel that the camera sees."""

    def show(self, picture: Tensor) -> None:
        """Let the camera see it, and darkness beside it."""
        planes = picture.double().numpy()
        seen = [ndimage.map_coordinates(each, self.places, order=1) for each in planes]
        self._source.show(torch.from_numpy(np.stack(seen)).clamp_min(0))

    def close(self) -> None:
        """Leave the camera in the dark."""
        self._source.show_dark()


def on_screen(picture: Tensor, size: tuple[int, int]) -> Tensor:
    """A picture as large as it fits on a screen, in its middle, black beside it.

    Parameters
    ----------
    picture
        Linear, (3, rows, columns).
    size
        (rows, columns) of the screen.
    """
    rows, columns = picture.shape[-2:]
    by = min(size[0] / rows, size[1] / columns)
    fitted = max(1, round(rows * by)), max(1, round(columns * by))
    scaled = nnf.interpolate(picture[None].float(), fitted, mode="bilinear", antialias=True)[0]
    top, left = (size[0] - fitted[0]) // 2, (size[1] - fitted[1]) // 2
    canvas = torch.zeros(3, *size)
    canvas[:, top : top + fitted[0], left : left + fitted[1]] = scaled.clamp(0, 1)
    return canvas


def dots(size: tuple[int, int]) -> tuple[dict[Place, Tensor], Place]:
    """Nine pictures of a white dot each, by its place on the screen, and that of the middle one."""
    side = max(2, round(_DOT * size[0]))
    pictures: dict[Place, Tensor] = {}
    for row in _PLACES:
        for column in _PLACES:
            corner = [
                min(max(round(at * count - side / 2), 0), count - side)
                for at, count in zip((row, column), size, strict=True)
            ]
            picture = torch.zeros(3, *size)
            picture[:, corner[0] : corner[0] + side, corner[1] : corner[1] + side] = 1
            pictures[corner[0] + (side - 1) / 2, corner[1] + (side - 1) / 2] = picture
    return pictures, list(pictures)[len(pictures) // 2]
