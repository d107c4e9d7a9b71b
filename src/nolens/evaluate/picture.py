"""Picture metrics and the fits that go before them."""

import math

import torch
import torch.nn.functional as nnf
from torch import Tensor

_WINDOW = 11
_SIGMA = 1.5
_K1, _K2 = 0.01, 0.03
_SCALE_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)


def scale_fit(picture: Tensor, truth: Tensor) -> Tensor:
    """Picture times the one factor that minimises the squared error over all channels.

    Parameters
    ----------
    picture, truth
        `(channels, height, width)` alike.
    """
    square = picture.double().square().sum()
    factor = (picture.double() * truth.double()).sum() / square if square > 0 else square
    return picture * factor.to(picture.dtype)


def affine_fit(picture: Tensor, truth: Tensor) -> Tensor:
    """Gain and offset of each channel that minimise the squared error, applied.

    Parameters
    ----------
    picture, truth
        `(channels, height, width)` alike.
    """
    p = picture.double() - picture.double().mean(dim=(-2, -1), keepdim=True)
    mean = truth.double().mean(dim=(-2, -1), keepdim=True)
    square = p.square().sum(dim=(-2, -1), keepdim=True)
    gain = (p * (truth.double() - mean)).sum(dim=(-2, -1), keepdim=True) / square.clamp_min(1e-300)
    return (gain * p + mean).to(picture.dtype)


def psnr(picture: Tensor, truth: Tensor, peak: float) -> float:
    """Peak signal-to-noise ratio 10 log₁₀(peak² / mean squared error), in dB.

    Parameters
    ----------
    picture, truth
        Of any shape, alike.
    peak
        Largest value that the truth can take.
    """
    error = float((picture.double() - truth.double()).square().mean())
    return 10 * math.log10(peak**2 / error) if error > 0 else math.inf


def ssim(picture: Tensor, truth: Tensor, peak: float) -> float:
    """Structural similarity, mean over pixels and channels (`wang2004`).

    Gaussian window of 11×11 pixels with σ = 1.5, K₁ = 0.01, K₂ = 0.03, over those pixels for
    which the window lies inside the picture.

    Parameters
    ----------
    picture, truth
        `(channels, height, width)` alike, at least 11 pixels high and wide.
    peak
        Largest value that the truth can take.
    """
    return ssim_and_ms_ssim(picture, truth, peak, scales=1)[0]


def ms_ssim(picture: Tensor, truth: Tensor, peak: float) -> float:
    """Structural similarity over five scales, mean over channels (`wang2003`).

    The product of contrast and structure of each scale and the luminance of the coarsest, with
    the paper's exponents; each scale averages 2×2 pixels of the one before. Negative means count
    as zero.

    Parameters
    ----------
    picture, truth
        `(channels, height, width)` alike, at least 176 pixels high and wide.
    peak
        Largest value that the truth can take.

    Returns
    -------
    float
        NaN where the pictures are too small for the five scales.
    """
    return ssim_and_ms_ssim(picture, truth, peak)[1]


def ssim_and_ms_ssim(
    picture: Tensor, truth: Tensor, peak: float, scales: int = len(_SCALE_WEIGHTS)
) -> tuple[float, float]:
    """Both, the first scale computed once: `ssim` and, with all scales, `ms_ssim`."""
    x, y = picture.double(), truth.double()
    large = min(x.shape[-2:]) // 2 ** (len(_SCALE_WEIGHTS) - 1) >= _WINDOW
    whole, product = math.nan, torch.ones(len(x), dtype=torch.float64, device=x.device)
    for number, weight in enumerate(_SCALE_WEIGHTS[: scales if large else 1]):
        if number:
            x, y = (nnf.avg_pool2d(each, 2) for each in (x, y))
        # Channel by channel: the maps of all windows are many times the picture.
        means = [_similarities(one, other, peak) for one, other in zip(x, y, strict=True)]
        similar, structure = torch.tensor(means, dtype=torch.float64, device=x.device).T
        if number == 0:
            whole = float(similar.mean())
        last = number == len(_SCALE_WEIGHTS) - 1
        product = product * (similar if last else structure).clamp_min(0) ** weight
    return whole, float(product.mean()) if large and scales > 1 else math.nan


def _similarities(x: Tensor, y: Tensor, peak: float) -> tuple[float, float]:
    """Mean over all windows of two planes: of the similarity, and of contrast with structure."""
    half = _WINDOW // 2
    bell = [math.exp(-((place - half) ** 2) / (2 * _SIGMA**2)) for place in range(_WINDOW)]
    weights = [each / math.fsum(bell) for each in bell]

    def local_mean(z: Tensor) -> Tensor:
        for axis in (-2, -1):
            count = z.shape[axis] - _WINDOW + 1
            mean = weights[half] * z.narrow(axis, half, count)
            for place, weight in enumerate(weights[:half]):
                across = z.narrow(axis, _WINDOW - 1 - place, count)
                mean.add_(z.narrow(axis, place, count) + across, alpha=weight)
            z = mean
        return z

    mean_x, mean_y = local_mean(x), local_mean(y)
    variance_x = local_mean(x * x) - mean_x**2
    variance_y = local_mean(y * y) - mean_y**2
    covariance = local_mean(x * y) - mean_x * mean_y
    c1, c2 = (_K1 * peak) ** 2, (_K2 * peak) ** 2
    luminance = (2 * mean_x * mean_y + c1) / (mean_x**2 + mean_y**2 + c1)
    structure = (2 * covariance + c2) / (variance_x + variance_y + c2)
    return float((luminance * structure).mean()), float(structure.mean())
