"""The forward model with a point spread function that varies over the field."""

import math
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import torch
from scipy.spatial import Delaunay
from torch import Tensor

from nolens.errors import OptionError
from nolens.kernels import irfft2_window_, rfft2_window
from nolens.kernels.fft import Window
from nolens.machine import mapped_copy
from nolens.operators.convolution import CroppedConvolution, PixelRectangle, times_transfer_

TRANSFER_BYTES = 4
"""Of a term's transfer function in float32, per pixel of the padded shape."""

_FAR = 1e3
"""How far outside the field points their weights go on, in lengths of the scene."""
_ASIDE = 1e-3
"""Part of their spread by which points on one line may lie beside it."""

_BEYOND = 1.05
"""Over the norm that power iteration gives."""

Array = np.ndarray[Any, Any]


@dataclass(frozen=True)
class FieldWeight:
    """How much the PSF of one field point counts, on a rectangle of the scene's pixels.

    Parameters
    ----------
    top, left
        First row and column of the rectangle in the scene.
    values
        (height, width), from 0 to 1; 0 beside the rectangle.
    """

    top: int
    left: int
    values: Tensor

    @property
    def window(self) -> tuple[slice, slice]:
        """Rows and columns of the scene."""
        height, width = self.values.shape
        return slice(self.top, self.top + height), slice(self.left, self.left + width)

    @classmethod
    def of_grid(cls, values: Tensor, top: int = 0, left: int = 0) -> "FieldWeight | None":
        """Weights without the rows and columns of zeros around them; None where all are zero."""
        rows, columns = (values.any(dim=axis).nonzero().flatten().tolist() for axis in (1, 0))
        if not rows:
            return None
        trimmed = values[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        return cls(top + rows[0], left + columns[0], trimmed.contiguous())


def interpolation_weights(places: Tensor, scene: PixelRectangle) -> list[FieldWeight | None]:
    """Weights with which a scene is shared out to field points; they sum to 1 at every pixel.

    In a triangle of three neighbours (Delaunay's), a weight falls linearly from 1 at its own point
    to 0 at the two others; for points on one line, from one to the next. Beyond the outermost
    points, weights go on outwards as they are on the lines between them.

    Parameters
    ----------
    places
        (count, 2): row and column of each field point, in the sensor's frame.
    scene
        Pixels to weigh.

    Returns
    -------
    list
        One for each point; None where it counts for no pixel. float32.
    """
    at = places.double().cpu().numpy()
    rows = scene.top + np.arange(scene.height, dtype=np.float64)
    columns = scene.left + np.arange(scene.width, dtype=np.float64)
    middle = at.mean(axis=0)
    _, spread, axes = np.linalg.svd(at - middle)
    if len(at) < 3 or spread[1] <= _ASIDE * spread[0]:
        along = (rows - middle[0])[:, None] * axes[0, 0] + (columns - middle[1]) * axes[0, 1]
        return _weights_on_line((at - middle) @ axes[0], along)
    return _weights_in_triangles(at, rows, columns)


def mean_psf(psfs: Tensor, places: Tensor, scene: PixelRectangle) -> Tensor:
    """Mean of PSFs over the field, each by the pixels that it counts for.

    Parameters
    ----------
    psfs, places
        As `FieldConvolution` takes them.
    scene
        Pixels that light comes from.
    """
    weights = interpolation_weights(places, scene)
    parts = [0.0 if each is None else float(each.values.sum()) for each in weights]
    mean: Tensor = torch.tensordot(psfs.new_tensor(parts) / sum(parts), psfs, dims=1)
    return mean


def _weights_on_line(points: Array, pixels: Array) -> list[FieldWeight | None]:
    order = np.argsort(points)
    units = np.eye(len(points))
    return [
        FieldWeight.of_grid(
            torch.from_numpy(np.interp(pixels, points[order], unit[order]).astype(np.float32))
        )
        for unit in units
    ]


def _weights_in_triangles(at: Array, rows: Array, columns: Array) -> list[FieldWeight | None]:
    middle, outermost = at.mean(axis=0), np.unique(Delaunay(at).convex_hull)
    far = _FAR * max(len(rows), len(columns), np.abs(at - middle).max())
    outwards = at[outermost] - middle
    outwards *= far / np.linalg.norm(outwards, axis=1, keepdims=True)
    points = np.concatenate([at, middle + outwards])
    owners = np.concatenate([np.arange(len(at)), outermost])
    totals = np.zeros((len(at), len(rows), len(columns)), dtype=np.float32)
    free = np.ones((len(rows), len(columns)), dtype=bool)
    for triangle in Delaunay(points).simplices:
        corners = points[triangle]
        inside = tuple(
            slice(*np.searchsorted(axis, (low - 1, high + 1)))
            for axis, low, high in zip(
                (rows, columns), corners.min(axis=0), corners.max(axis=0), strict=True
            )
        )
        shares = _barycentric(corners, rows[inside[0]], columns[inside[1]])
        here = free[inside] & (shares.min(axis=0) >= -1e-9)
        free[inside] &= ~here
        for owner, share in zip(owners[triangle], shares, strict=True):
            totals[owner][inside] += np.where(here, share.clip(0, 1), 0)
    return [FieldWeight.of_grid(torch.from_numpy(each)) for each in totals]


def _barycentric(corners: Array, rows: Array, columns: Array) -> Array:
    """Shares of a triangle's three corners at pixels, (3, rows, columns)."""
    matrix = np.linalg.inv(np.concatenate([corners.T, np.ones((1, 3))]))
    by_row, by_column, rest = (matrix[:, k, None, None] for k in range(3))
    shares: Array = by_row * rows[:, None] + by_column * columns + rest
    return shares


@dataclass(frozen=True)
class _Share:
    """A PSF and what of the scene it counts for.

    `mean` is the weight's mean over the scene, and `square` what |H|² counts in the mean of the
    squares: as much for a field point, 1 for a PSF of a basis.
    """

    psf: Tensor
    weight: FieldWeight
    mean: float
    square: float


@dataclass(frozen=True)
class _Term:
    """A share in the Fourier domain: its weight, where that lies in the padded shape, its PSF.

    `stored` is the transfer function, in memory or in a file, on any device.
    """

    weight: FieldWeight
    window: Window
    stored: Tensor
    square: float

    def transfer(self, beside: Tensor) -> Tensor:
        """The transfer function, on the device of another tensor."""
        return self.stored.to(beside.device, non_blocking=True)


class FieldConvolution(CroppedConvolution):
    r"""Crop of a sum of convolutions of parts of the scene: a PSF that varies over the field.

    .. math:: b = C \sum_k h_k * (w_k ⊙ v), \qquad \sum_k w_k = 1,

    with the PSF :math:`h_k` at field point k about its own chief ray, and weights that interpolate
    between field points (`interpolation_weights`): Nagy and O'Leary's model (`nagy1998`). All
    terms are summed in the Fourier domain, so the operator has one inverse transform, and one
    forward transform for each term, of a window.

    Parameters
    ----------
    psfs
        `(points, channels, height, width)`, as `CroppedConvolution` takes each.
    places
        (points, 2): where the ray through each PSF's middle falls, as row and column of the
        sensor's frame; the scene pixel there sees that PSF.
    sensor, support
        As `CroppedConvolution` takes them.
    error
        Fewer PSFs, of which those of the field points are combinations (Karhunen and Loève's
        basis, `lauer2002`), may take their places where that costs less time: as few as err by this
        fraction of the PSFs, as root mean squares over PSFs and scene. 0 for none.
    mapped
        Whether the terms' transfer functions are in temporary files, from which they are read one
        by one whenever they are used (`nolens.machine.mapped_copy`).

    Raises
    ------
    OptionError
        If no light from the support reaches the sensor, or the numbers of PSFs and places differ.

    Notes
    -----
    `transfer` is that of the mean PSF, each by the pixels that it counts for: the best single PSF
    for a scene of which nothing is known.
    """

    def __init__(
        self,
        psfs: Tensor,
        places: Tensor,
        sensor: tuple[int, int],
        support: PixelRectangle | None = None,
        *,
        error: float = 0.0,
        mapped: bool = False,
    ) -> None:
        if len(psfs) != len(places):
            raise OptionError(
                f"there are {len(psfs)} PSFs and {len(places)} places: give one place for each"
            )
        super().__init__(psfs[0], sensor, support)
        geometry = self.geometry
        scene = PixelRectangle(*geometry.origin, *geometry.scene[2:])
        shares = []
        for psf, weight in zip(psfs, interpolation_weights(places, scene), strict=True):
            if weight is None:
                continue
            values = weight.values.to(psf)
            part = float(values.sum(dtype=torch.float64)) / (scene.height * scene.width)
            shares.append(_Share(psf, replace(weight, values=values), part, part))
        self._field_points = len(shares)
        if error > 0:
            basis = _basis(shares, scene, error)
            if _cost(basis, geometry.padded) < _cost(shares, geometry.padded):
                shares = basis
        self.transfer = torch.zeros_like(self.transfer)
        terms = []
        for share in shares:
            transfer = CroppedConvolution(share.psf, sensor, support).transfer
            self.transfer.add_(transfer, alpha=share.mean)
            weight = share.weight
            top, left = geometry.scene[0] + weight.top, geometry.scene[1] + weight.left
            window = top, left, *weight.values.shape
            stored = mapped_copy(transfer) if mapped else transfer
            terms.append(_Term(weight, window, stored, share.square))
        self.terms = tuple(terms)

    @property
    def field_points(self) -> int:
        """How many PSFs were given that count for a pixel of the scene."""
        return self._field_points

    @property
    def power(self) -> Tensor:
        """Mean of |H|² of the half spectra, each by the pixels that its PSF counts for."""
        total = torch.zeros_like(self.transfer.real)
        for term in self.terms:
            transfer = term.transfer(total)
            total.add_(transfer.real.square(), alpha=term.square)
            total.add_(transfer.imag.square(), alpha=term.square)
        return total

    @property
    def norm_bound(self) -> float:
        """Its norm by power iteration, and a little more, as that comes from below."""
        like = self.transfer.real.new_empty((self.channels, *self.geometry.scene[2:]))
        return _BEYOND * self.norm(like)

    def single(self, channel: int) -> Self:
        """That of one channel, which shares its memory."""
        single = super().single(channel)
        part = slice(channel, channel + 1)
        single.terms = tuple(replace(each, stored=each.stored[part]) for each in self.terms)
        return single

    def scale_(self, factor: Tensor) -> None:
        """Multiply the PSFs, every channel by its factor, in place."""
        super().scale_(factor)
        for term in self.terms:
            torch.view_as_real(term.stored).mul_(factor.to(term.stored.device)[..., None])

    def light_spectrum(self, v: Tensor) -> Tensor:
        """Half spectrum of the sum of all terms on the padded shape."""
        total: Tensor | None = None
        for term in self.terms:
            part = v[..., *term.weight.window] * term.weight.values
            spectrum = rfft2_window(part, term.window[:2], self.geometry.padded)
            if total is None:
                total = times_transfer_(spectrum, term.transfer(spectrum))
            else:
                total.addcmul_(spectrum, term.transfer(spectrum))
        assert total is not None
        return total

    def scene_of(self, spectrum: Tensor) -> Tensor:
        """Adjoint of all terms, from the half spectrum of y on the padded shape, which stays."""
        scene: Tensor | None = None
        for term in self.terms:
            part = irfft2_window_(
                spectrum * term.transfer(spectrum).conj(), term.window, self.geometry.padded
            )
            if scene is None:
                scene = part.new_zeros((*part.shape[:-2], *self.geometry.scene[2:]))
            scene[..., *term.weight.window] += part.mul_(term.weight.values)
        assert scene is not None
        return scene


def _basis(shares: list[_Share], scene: PixelRectangle, error: float) -> list[_Share]:
    r"""The fewest PSFs of which those of the field points are combinations, but for an error.

    With the parts :math:`p_k` of the scene and the decomposition :math:`(\sqrt{p_k}\, h_k)_k =
    U Σ V^T`, they are :math:`g_r = \sum_k U_{kr} \sqrt{p_k}\, h_k`, with the weights
    :math:`\sum_k (U_{kr} / \sqrt{p_k})\, w_k`; so the mean of |H|² is :math:`\sum_r |G_r|^2`.
    """
    roots = torch.tensor([math.sqrt(each.mean) for each in shares], dtype=torch.float64)
    flat = torch.stack([each.psf.flatten() for each in shares])
    gram = (flat @ flat.T).double().cpu() * roots[:, None] * roots
    energies, vectors = (each.flip(-1) for each in torch.linalg.eigh(gram))
    left = 1 - energies.cumsum(0) / energies.sum()
    rank = min(int((left > error**2).sum()) + 1, len(shares))
    basis = []
    for vector in vectors[:, :rank].T:
        psf = torch.zeros_like(shares[0].psf)
        values = psf.new_zeros(scene.height, scene.width)
        for each, amount, root in zip(shares, vector.tolist(), roots.tolist(), strict=True):
            psf.add_(each.psf, alpha=amount * root)
            values[each.weight.window].add_(each.weight.values, alpha=amount / root)
        mean = float(values.mean(dtype=torch.float64))
        basis.append(_Share(psf, FieldWeight(0, 0, values), mean, 1.0))
    return basis


def _cost(shares: list[_Share], padded: tuple[int, int]) -> float:
    """Time of the terms' transforms, of all columns and the windows' rows, over that of columns."""
    return sum(1 + len(each.weight.values) / (2 * padded[0]) for each in shares)
