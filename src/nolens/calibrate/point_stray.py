"""Stray light in the picture of a point source, told where there is none of the point's."""

from dataclasses import dataclass

import torch
import torch.nn.functional as nnf
from torch import Tensor

_BLOCKS = 64
"""Blocks along the shorter side."""
_REACH_SHARE, _REACH_CELLS = 0.1, 48
"""How far a dark place lies from the PSF: farther than its lines from each other."""
_BRIGHTEST, _DARK_STEP, _DARK_SHARE = 0.95, 0.03, 0.25
"""Of the light near the PSF's bright lines, what a dark area has more than the darkest place,
and what it has in all, at most."""
_LEAST_DARK, _MOST_DARK = 0.02, 0.97
_LEAST_BORDER = 0.5
_LEAST_FITTED = 24
_ROUNDS = 20
_CAUTION = 1.0
"""Standard deviations above the plane from which a block shows the PSF's own wings."""
_FLOOR = 0.01


@dataclass(frozen=True)
class DarkArea:
    """Where an aperture keeps the PSF's light away.

    Parameters
    ----------
    side
        Pixels along a block.
    dark
        Bool, (block rows, block columns).
    """

    side: int
    dark: Tensor

    @property
    def share(self) -> float:
        """Fraction of the picture that is dark."""
        return float(self.dark.double().mean())

    def on_cells(self, rows: int, columns: int) -> Tensor:
        """The dark blocks' pixels, (rows, columns); what is left over at the edges is not dark."""
        spread = self.dark.repeat_interleave(self.side, 0).repeat_interleave(self.side, 1)
        return nnf.pad(spread, (0, columns - spread.shape[1], 0, rows - spread.shape[0]))


def dark_area(psf: Tensor) -> DarkArea | None:
    """Find the part without light; None where the PSF fills the picture.

    Every place is judged by the brightest one near it, nearer than a tenth of the picture and 48
    pixels, so that the dark between a PSF's lines does not count. Dark are places that have
    hardly more than the darkest one, by 3 % of what there is near bright lines; they are a dark
    area if they have less than a quarter of the others' light, and half of the picture's edge.
    Stray light of up to that quarter does not matter, if it is even to 3 %.

    Parameters
    ----------
    psf
        (channels, rows, columns).
    """
    shorter = min(psf.shape[-2:])
    side = max(2, shorter // _BLOCKS)
    blocks = nnf.avg_pool2d(psf.mean(dim=0)[None, None], side)[0, 0].double()
    reach = max(1, round(min(_REACH_SHARE * shorter, _REACH_CELLS) / side))
    near = nnf.max_pool2d(blocks[None, None], 2 * reach + 1, 1, reach)[0, 0]
    darkest = float(near.min())
    dark = near - darkest <= _DARK_STEP * (float(near.quantile(_BRIGHTEST)) - darkest)
    edge = torch.cat([dark[0], dark[-1], dark[1:-1, 0], dark[1:-1, -1]]).double().mean()
    share = float(dark.double().mean())
    if not (_LEAST_DARK <= share <= _MOST_DARK and float(edge) >= _LEAST_BORDER):
        return None
    if float(near[dark].mean()) > _DARK_SHARE * float(near[~dark].mean()):
        return None
    return DarkArea(side, dark)


def stray_light(psf: Tensor, area: DarkArea) -> Tensor:
    r"""Smooth light of other sources, from where an aperture leaves no light of the point.

    In every channel a plane :math:`a + b r + c s` is laid through the
    means of the dark blocks. The PSF's own faint wings reach into
    them: blocks that lie above the plane count less the more they do (Huber's weights, `huber1964`,
    on that side alone), so that one through the darkest of them remains. A curved surface would
    follow the wings and take light of the PSF away. Where few blocks are dark, or on one side
    only, it is even.

    Parameters
    ----------
    psf
        (channels, rows, columns).
    area
        Its dark area.

    Returns
    -------
    Tensor
        Of the same shape.
    """
    rows, columns = psf.shape[-2:]
    used = area.dark
    blocks = nnf.avg_pool2d(psf[None], area.side)[0].double()
    order = 3 if _surrounds(used) else 1
    places = [
        ((torch.arange(n, dtype=torch.float64) + 0.5) * area.side / size * 2 - 1)
        for n, size in zip(blocks.shape[-2:], (rows, columns), strict=True)
    ]
    basis = _surface(places[0], places[1], order)[used]
    fine = [torch.linspace(-1 + 1 / n, 1 - 1 / n, n, dtype=torch.float64) for n in (rows, columns)]
    everywhere = _surface(fine[0], fine[1], order)
    return torch.stack([everywhere @ _fit(basis, plane[used]) for plane in blocks]).to(psf.dtype)


def floor(psf: Tensor) -> Tensor:
    """Light of the darkest hundredth of blocks, (channels, 1, 1): the PSF's own, or stray."""
    side = max(2, min(psf.shape[-2:]) // _BLOCKS)
    blocks = nnf.avg_pool2d(psf[None], side)[0].flatten(1)
    return blocks.quantile(_FLOOR, dim=1)[:, None, None]


def _surrounds(used: Tensor) -> bool:
    """Whether blocks lie on all sides, so that a plane is held everywhere."""
    if int(used.sum()) < _LEAST_FITTED:
        return False
    reach = [(len(used) + 3) // 4, (used.shape[1] + 3) // 4]
    return bool(used[: reach[0]].any() and used[-reach[0] :].any()) and bool(
        used[:, : reach[1]].any() and used[:, -reach[1] :].any()
    )


def _surface(rows: Tensor, columns: Tensor, order: int) -> Tensor:
    """Terms of the plane on a grid, (rows, columns, order)."""
    r, s = torch.meshgrid(rows, columns, indexing="ij")
    return torch.stack([torch.ones_like(r), r, s][:order], dim=-1)


def _fit(basis: Tensor, values: Tensor) -> Tensor:
    weight = torch.ones_like(values)
    for _ in range(_ROUNDS):
        scaled = basis * weight[:, None].sqrt()
        solution: Tensor = torch.linalg.lstsq(scaled, (values * weight.sqrt())[:, None]).solution[
            :, 0
        ]
        above = values - basis @ solution
        # Below the plane there is only noise; above it wings as well.
        below = above[above <= 0].abs()
        # Of an even plane rounding can leave all above.
        spread = 1.4826 * (below if len(below) else above).median().clamp_min(1e-30)
        weight = torch.where(
            above > 0, (_CAUTION * spread / above.clamp_min(1e-30)).clamp(max=1), 1.0
        )
    return solution
