"""The forward model with a point spread function that varies over the field."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import torch
import torch.nn.functional as nnf
from scipy.spatial import ConvexHull
from scipy.spatial.distance import cdist
from torch import Tensor

from nolens.errors import OptionError
from nolens.kernels import irfft2_window_, rfft2_window
from nolens.machine import mapped_copy
from nolens.operators.convolution import CroppedConvolution, PixelRectangle, times_transfer_

TRANSFER_BYTES = 4
"""Of a term's transfer function in float32, per pixel of the padded shape."""

_ASIDE = 1e-3
"""Part of their spread by which points on one line may lie beside it."""
_SMOOTHING = 1e-3
"""Of the spline: a place that is met twice counts once."""
_SAMPLES = 64
"""Rows and columns of the scene whose weights stand for all in means."""
_ROWS = 64
"""Of the scene, whose weights are computed at once."""
_APART = 1e-12
"""What weights must differ by at least, over what they have in common, in their squares."""

_BLOCKS = 8
"""Along each side of a PSF, whose means are its slow part."""
_DETAIL = 10.0
"""Width of details, in pixels."""

_BEYOND = 1.05
"""Over the norm that power iteration gives."""

Array = np.ndarray[Any, Any]


def interpolation_weights(places: Tensor, pixels: Tensor) -> Tensor:
    r"""How much the PSF of each field point counts at scene pixels; the sum is 1 at each.

    A PSF's brightness leans in proportion to the field angle, and its form changes with the square.
    So weights are those of the smoothest interpolation that is exact for what is linear: the
    spline :math:`\sum_k c_k \lVert x - x_k \rVert^3 + a + b^T x` (`duchon1977`). Some are
    negative. Beyond the outermost points those of the nearest place between them go on.

    Parameters
    ----------
    places
        (count, 2): row and column of each field point, in the sensor's frame.
    pixels
        (pixels, 2): likewise.

    Returns
    -------
    Tensor
        (count, pixels), float64.
    """
    at = places.double().cpu().numpy()
    middle = at.mean(axis=0)
    unit = max(float(np.abs(at - middle).max()), 1.0)
    at = (at - middle) / unit
    inside = _nearest_within(at, (pixels.double().cpu().numpy() - middle) / unit)
    linear, here = (np.pad(each, ((0, 0), (1, 0)), constant_values=1.0) for each in (at, inside))
    bending = cdist(at, at) ** 3 + _SMOOTHING * np.eye(len(at))
    system = np.block([[bending, linear], [linear.T, np.zeros((3, 3))]])
    wanted = np.concatenate([cdist(at, inside) ** 3, here.T])
    # Of points on one line the slope across it is undetermined, and not needed.
    solved = np.linalg.pinv(system, rcond=_APART, hermitian=True) @ wanted
    return torch.from_numpy(solved[: len(at)])


def _nearest_within(points: Array, pixels: Array) -> Array:
    """Pixels where they lie between the points; otherwise the nearest place on their hull."""
    _, spread, axes = np.linalg.svd(points)
    if len(points) < 3 or spread[1] <= _ASIDE * spread[0]:
        along = points @ axes[0]
        sides = [(points[along.argmin()], points[along.argmax()])]
        outside = np.ones(len(pixels), dtype=bool)
    else:
        hull = ConvexHull(points)
        sides = [(points[one], points[other]) for one, other in hull.simplices]
        normals, offsets = hull.equations[:, :2], hull.equations[:, 2]
        outside = (pixels @ normals.T + offsets).max(axis=1) > 0
    away = pixels[outside]
    nearest, least = away.copy(), np.full(len(away), np.inf)
    for start, end in sides:
        side = end - start
        part = ((away - start) @ side / max(side @ side, 1e-300)).clip(0, 1)
        place = start + part[:, None] * side
        distance = np.linalg.norm(away - place, axis=1)
        nearer = distance < least
        nearest[nearer], least[nearer] = place[nearer], distance[nearer]
    inside: Array = pixels.copy()
    inside[outside] = nearest
    return inside


def _pixels_of(rows: Tensor, columns: Tensor) -> Tensor:
    return torch.cartesian_prod(rows, columns).view(-1, 2)


def _sampled_weights(places: Tensor, scene: PixelRectangle) -> Tensor:
    """Weights on pixels that stand for the scene, (points, pixels)."""
    lines = [
        first + (torch.arange(count, dtype=torch.float64) + 0.5) * (length / count) - 0.5
        for first, length in ((scene.top, scene.height), (scene.left, scene.width))
        for count in (min(length, _SAMPLES),)
    ]
    return interpolation_weights(places, _pixels_of(*lines))


def mean_psf(psfs: Tensor, places: Tensor, scene: PixelRectangle) -> Tensor:
    """Mean over the scene of the PSFs at all pixels.

    Parameters
    ----------
    psfs, places
        As `FieldConvolution` takes them.
    scene
        Pixels that light comes from.
    """
    weights = _sampled_weights(places, scene).mean(dim=1)
    mean: Tensor = torch.tensordot(weights.to(psfs), psfs, dims=1)
    return mean


@dataclass(frozen=True)
class _Term:
    """A PSF in the Fourier domain, and how much it counts at each pixel of the scene.

    `stored` is the transfer function, in memory or in a file, on any device.
    """

    weight: Tensor
    stored: Tensor

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
        Fewer PSFs, of which those of the scene's pixels are combinations (Karhunen and Loève's
        basis, `lauer2002`), take their places: as few as err by this fraction of the PSFs, as root
        mean squares over PSFs and scene. 0 for as many as are given.
    mapped
        Whether the terms' transfer functions are in temporary files, from which they are read one
        by one whenever they are used (`nolens.machine.mapped_copy`).

    Raises
    ------
    OptionError
        If no light from the support reaches the sensor, the numbers of PSFs and places differ, or
        the error is not from 0 to below 1.

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
        if not 0 <= error < 1:
            raise OptionError(
                f"the error is {error:g}; give a fraction of the PSFs from 0 to below 1, such as "
                "0.01, or 0 for all of them"
            )
        super().__init__(psfs[0], sensor, support)
        scene = PixelRectangle(*self.geometry.origin, *self.geometry.scene[2:])
        self._field_points = len(psfs)
        self.transfer = torch.zeros_like(self.transfer)
        terms = []
        for psf, weight in _basis(psfs, places, scene, error):
            transfer = CroppedConvolution(psf, sensor, support).transfer
            mean = float(weight.mean(dtype=torch.float64))
            self.transfer.add_(transfer, alpha=mean)
            terms.append(_Term(weight, mapped_copy(transfer) if mapped else transfer))
        self.terms = tuple(terms)

    @property
    def field_points(self) -> int:
        """How many PSFs were given."""
        return self._field_points

    @property
    def power(self) -> Tensor:
        """Mean over the scene's pixels of |H|² of the half spectra of their PSFs."""
        total = torch.zeros_like(self.transfer.real)
        for term in self.terms:
            transfer = term.transfer(total)
            total.add_(transfer.real.square()).add_(transfer.imag.square())
        return total

    @property
    def norm_bound(self) -> float:
        """Its norm by power iteration, and a little more, as that comes from below."""
        like = self.transfer.real.new_empty((self.channels, *self.geometry.scene[2:]))
        return _BEYOND * self.norm(like)

    def to(self, device: torch.device) -> Self:
        """The same on a device; transfer functions of the terms come there when they are used."""
        there = super().to(device)
        there.terms = tuple(replace(each, weight=each.weight.to(device)) for each in self.terms)
        return there

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

    def of_products(self, rows: Tensor, columns: Tensor) -> Iterator[Tensor]:
        """Measurements of the products of each row with each column, those of the first row first.

        Parameters
        ----------
        rows, columns
            (number, height) and (number, width) of scenes.
        """
        for row in rows:
            for column in columns:
                yield self((row[:, None] * column).expand(self.channels, -1, -1))

    def light_spectrum(self, v: Tensor) -> Tensor:
        """Half spectrum of the sum of all terms on the padded shape."""
        total: Tensor | None = None
        for term in self.terms:
            spectrum = rfft2_window(v * term.weight, self.geometry.scene[:2], self.geometry.padded)
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
                spectrum * term.transfer(spectrum).conj(), self.geometry.scene, self.geometry.padded
            ).mul_(term.weight)
            scene = part if scene is None else scene.add_(part)
        assert scene is not None
        return scene


def _basis(
    psfs: Tensor, places: Tensor, scene: PixelRectangle, error: float
) -> Iterator[tuple[Tensor, Tensor]]:
    r"""The fewest PSFs of which those of all pixels are combinations, but for an error; weights.

    With the means :math:`C = R R^T` over the scene of the products of two weights, and
    :math:`H R = U Σ V^T`, the PSFs are the columns of :math:`H R V`, the weights
    :math:`V^T R^{-1} w`, whose products have the mean 1 with themselves and 0 with others. So the
    mean of |H|² is the sum of the terms'. How brightness changes over a PSF as a whole counts more
    than detail in the decomposition, as a scene's power falls with the square of the frequency.
    Otherwise it would be lost first, and with it the picture's shading.
    """
    samples = _sampled_weights(places, scene)
    products, vectors = torch.linalg.eigh(samples @ samples.T / samples.shape[1])
    known = products > _APART * products[-1]
    lengths, vectors = products[known].sqrt(), vectors[:, known]
    root = vectors * lengths
    detail, slow = (
        root.T @ (each @ each.T).double().cpu() @ root
        for each in (psfs.flatten(1), _slow_part(psfs))
    )
    energies, turned = (each.flip(-1) for each in torch.linalg.eigh(detail + slow))
    left = energies.flip(0).cumsum(0).flip(0)[1:]
    turned = turned[:, : int((left > error**2 * detail.trace()).sum()) + 1]
    weights = psfs.new_empty((turned.shape[1], scene.height, scene.width))
    rows, columns = torch.arange(scene.height), torch.arange(scene.width)
    for first in range(0, scene.height, _ROWS):
        part = rows[first : first + _ROWS]
        pixels = _pixels_of(scene.top + part, scene.left + columns)
        shares = turned.T / lengths @ vectors.T @ interpolation_weights(places, pixels)
        weights[:, part] = shares.view(-1, len(part), scene.width).to(weights)
    for amounts, weight in zip((root @ turned).T, weights, strict=True):
        yield torch.tensordot(amounts.to(psfs), psfs, dims=1), weight


def _slow_part(psfs: Tensor) -> Tensor:
    """Means of blocks of PSFs, (points, blocks), as they count beside all pixels."""
    means = nnf.adaptive_avg_pool2d(psfs.flatten(0, 1), _BLOCKS).view(len(psfs), -1)
    side = math.sqrt(psfs.shape[-2] * psfs.shape[-1])
    slow: Tensor = means * (side / _BLOCKS) * (side / _DETAIL)
    return slow
