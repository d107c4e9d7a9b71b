"""A convolutional network that takes noise out of pictures, of any size and brightness."""

import itertools
import math
from collections.abc import Iterator
from typing import Literal

import torch
import torch.nn.functional as nnf
from torch import Tensor, nn

Precision = Literal["float32", "bfloat16"]

WIDTHS = (32, 64, 96)
"""Features of each scale; every scale has half the pixels of the one before, along each side."""
BLOCKS = (2, 2, 3)
"""Residual blocks of each scale, on the way down; as many on the way up."""
BANDS = 5
"""Of spatial frequency, in which the noise is stated: octaves below 1/2 cycle per pixel."""
PLANES = 3 * BANDS + 1
"""Noise of each channel and band, and the spread of the picture before."""
_FOLD = 2
"""Pixels along a side that become channels of the first scale."""
FOLDED = 3 * _FOLD**2
"""Those channels; planes of the noise come after them."""
STEP = _FOLD * 2 ** (len(WIDTHS) - 1)
"""Sides that the network takes are multiples of this."""
OVERLAP = 32
"""Pixels beyond a tile that the network sees, on each side where there are any."""
_TILE = 512
"""Side of a tile without its overlap."""


class DenoisingNetwork(nn.Module):
    r"""A U-Net without biases, which gets the noise of every channel and band as planes.

    Folded pixels (`shi2016`) go through three scales of residual blocks; what comes out is taken
    off the picture. As nothing in it has a bias, it is homogeneous (`mohan2020`): for c > 0

    .. math:: D(c v, c σ) = c D(v, σ),

    so that it does not depend on the unit of brightness. The noise as an input makes one network
    serve all levels (`zhang2022`). What is left of a measurement's noise when its blur is undone
    has a colour: σ is stated for octaves of spatial frequency, as the root mean density of the
    noise there, which is that of white noise of the same density.

    Three channels are denoised together; any other number one by one, as grey pictures, whose
    three channels are the same.

    With more than one picture, of the same scene, it mends the first by what the others show
    (`Refinement`).

    Parameters
    ----------
    widths, blocks
        Features and residual blocks of each scale; no more scales than `WIDTHS` has.
    pictures
        How many it takes.

    Attributes
    ----------
    precision
        Of the features; weights, picture and result always have float32.
    """

    precision: Precision = "float32"

    def __init__(
        self,
        widths: tuple[int, ...] = WIDTHS,
        blocks: tuple[int, ...] = BLOCKS,
        pictures: int = 1,
    ) -> None:
        super().__init__()
        self.widths, self.blocks, self.pictures = widths, blocks, pictures
        self.head = _convolution(FOLDED * pictures + PLANES, widths[0])
        pairs = list(itertools.pairwise(widths))
        self.encoders = nn.ModuleList(map(_blocks, widths[:-1], blocks[:-1]))
        self.downs = nn.ModuleList(nn.Conv2d(a, b, 2, 2, bias=False) for a, b in pairs)
        self.middle = _blocks(widths[-1], blocks[-1])
        self.ups = nn.ModuleList(nn.ConvTranspose2d(b, a, 2, 2, bias=False) for a, b in pairs)
        self.decoders = nn.ModuleList(map(_blocks, widths[:-1], blocks[:-1]))
        self.tail = _convolution(widths[0], FOLDED)

    @property
    def tile_bytes(self) -> float:
        """Most memory that a tile takes (`denoise`): about eight features of the first scale."""
        pixels = ((_TILE + 2 * OVERLAP) / _FOLD) ** 2
        return 4 * 8 * self.head.out_channels * pixels

    def forward(self, picture: Tensor, noise: Tensor) -> Tensor:
        """The picture without noise.

        Parameters
        ----------
        picture
            (count, 3 `pictures`, height, width), one picture after the other; sides are multiples
            of `STEP`.
        noise
            (count, `PLANES`, 1, 1); see `noise_planes`.
        """
        low = self.precision == "bfloat16"
        with torch.autocast(picture.device.type, torch.bfloat16, enabled=low):
            return picture[:, :3] - self._noise(picture, noise)

    def _noise(self, picture: Tensor, noise: Tensor) -> Tensor:
        folded = nnf.pixel_unshuffle(picture, _FOLD)
        planes = noise.expand(-1, -1, *folded.shape[-2:])
        features = self.head(torch.cat([folded, planes], dim=1))
        kept = []
        for encoder, down in zip(self.encoders, self.downs, strict=True):
            features = encoder(features)
            kept.append(features)
            features = down(features)
        features = self.middle(features)
        for up, decoder in zip(reversed(self.ups), reversed(self.decoders), strict=True):
            features = decoder(up(features) + kept.pop())
        taken: Tensor = nnf.pixel_shuffle(self.tail(features), _FOLD)
        return taken


def noise_planes(sigma: Tensor, spread: float | Tensor = 0.0) -> Tensor:
    """Planes of the noise of three channels.

    Parameters
    ----------
    sigma
        (count, 3) of white noise, or (count, 3, `BANDS`).
    spread
        How far the picture before the fit may be from the scene, (count,); 0 for mere noise.
    """
    bands = sigma if sigma.ndim == 3 else sigma[..., None].expand(-1, -1, BANDS)
    last = torch.as_tensor(spread).to(bands).expand(len(bands))[:, None]
    return torch.cat([bands.flatten(1), last], dim=1)[..., None, None]


class _Block(nn.Module):
    """A residual block."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first, self.second = _convolution(width, width), _convolution(width, width)

    def forward(self, features: Tensor) -> Tensor:
        change: Tensor = self.second(nnf.relu(self.first(features)))
        return features + change


def _blocks(width: int, count: int) -> nn.Sequential:
    return nn.Sequential(*(_Block(width) for _ in range(count)))


def _convolution(taken: int, given: int) -> nn.Conv2d:
    return nn.Conv2d(taken, given, 3, padding=1, bias=False)


def denoise(
    network: DenoisingNetwork, scene: Tensor, sigma: Tensor, spread: float = 0.0, turn: int = 0
) -> Tensor:
    """A scene of any number of channels and pixels without noise, in tiles where it is large.

    Parameters
    ----------
    network
        That does it.
    scene
        (channels, height, width), or (pictures, channels, height, width) for a network that takes
        more than one.
    sigma
        Standard deviation of each channel's noise, (channels,), or of its bands, (channels,
        `BANDS`).
    spread
        See `noise_planes`.
    turn
        Quarter turns by which the scene is turned for it, so that its errors do not add up from
        one time to the next.
    """
    pictures = scene[None] if scene.ndim == 3 else scene
    if pictures.shape[1] != 3:
        grey = [
            denoise(
                network,
                each[:, None].expand(-1, 3, -1, -1),
                level[None].expand(3, *level.shape),
                spread,
                turn,
            )
            for each, level in zip(pictures.transpose(0, 1), sigma, strict=True)
        ]
        return torch.cat([each.mean(0, keepdim=True) for each in grey])
    turned = torch.rot90(pictures.flatten(0, 1), turn % 4, (1, 2))
    height, width = turned.shape[1:]
    result = torch.empty_like(turned[:3])
    planes = noise_planes(sigma[None].to(turned.device, torch.float32), spread)
    for top, left in tiles(height, width):
        above, before = min(top, OVERLAP), min(left, OVERLAP)
        rows, columns = min(_TILE, height - top), min(_TILE, width - left)
        window = _window(turned, top - above, left - before, rows + above, columns + before)
        window = window[None].to(planes).contiguous(memory_format=torch.channels_last)
        result[:, top : top + rows, left : left + columns] = network(window, planes)[0][
            :, above : above + rows, before : before + columns
        ]
    return torch.rot90(result, -turn % 4, (1, 2))


def tiles(height: int, width: int) -> Iterator[tuple[int, int]]:
    """Upper left corners of the tiles of a scene."""
    for top in range(0, height, _TILE):
        for left in range(0, width, _TILE):
            yield top, left


def _window(scene: Tensor, top: int, left: int, rows: int, columns: int) -> Tensor:
    """A window and what overlaps it below and to the right, of sides that the network takes.

    Where the scene ends it is mirrored.
    """
    indices = []
    for axis, first, count in ((1, top, rows), (2, left, columns)):
        side = scene.shape[axis]
        whole = math.ceil((min(first + count + OVERLAP, side) - first) / STEP) * STEP
        period = max(2 * (side - 1), 1)
        places = torch.arange(first, first + whole) % period
        indices.append(torch.minimum(places, period - places).to(scene.device))
    return scene[:, indices[0][:, None], indices[1]]
