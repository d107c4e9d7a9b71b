"""PSNR, SSIM and the fits, against other people's code and by their properties."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from skimage.metrics import peak_signal_noise_ratio, structural_similarity
from torch import Tensor
from torchmetrics.image import (
    MultiScaleStructuralSimilarityIndexMeasure,
    StructuralSimilarityIndexMeasure,
)

from nolens.evaluate import affine_fit, ms_ssim, psnr, scale_fit, ssim

SEEDS = st.integers(0, 10_000)


def pair(seed: int, shape: tuple[int, int, int] = (3, 24, 31)) -> tuple[Tensor, Tensor]:
    """A smooth picture, and the same with noise and another contrast."""
    generator = torch.Generator().manual_seed(seed)
    rough = torch.rand((1, *shape), generator=generator)
    truth = torch.nn.functional.avg_pool2d(rough, 5, stride=1, padding=2)[0]
    noisy = 0.8 * truth + 0.1 + 0.05 * torch.randn(shape, generator=generator)
    return noisy.clamp(0, 1), truth


@pytest.mark.parametrize("peak", [1.0, 255.0])
def test_psnr_is_that_of_scikit_image(peak: float) -> None:
    picture, truth = (peak * each for each in pair(1))
    expected = peak_signal_noise_ratio(truth.numpy(), picture.numpy(), data_range=peak)
    assert psnr(picture, truth, peak) == pytest.approx(expected, rel=1e-6)


def test_psnr_of_known_errors() -> None:
    truth = torch.zeros(1, 4, 4)
    assert psnr(truth + 0.1, truth, 1.0) == pytest.approx(20)
    assert psnr(truth + 0.1, truth, 10.0) == pytest.approx(40)
    assert psnr(truth, truth, 1.0) == math.inf


@pytest.mark.parametrize("shape", [(3, 24, 31), (1, 11, 11), (2, 40, 13)])
@pytest.mark.parametrize("peak", [1.0, 4095.0])
def test_ssim_is_that_of_scikit_image(shape: tuple[int, int, int], peak: float) -> None:
    picture, truth = (peak * each for each in pair(2, shape))
    values = []
    for x, y in zip(picture.double().numpy(), truth.double().numpy(), strict=True):
        _, every = structural_similarity(
            x, y, gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
            data_range=peak, full=True,
        )  # fmt: skip
        values.append(every[5:-5, 5:-5].mean())  # Where the window lies inside the picture.
    assert ssim(picture, truth, peak) == pytest.approx(np.mean(values), abs=1e-7)


def test_ssim_is_that_of_torchmetrics() -> None:
    picture, truth = pair(3)
    measure = StructuralSimilarityIndexMeasure(data_range=1.0, return_full_image=True)
    _, every = measure(picture[None].double(), truth[None].double())
    # Its own mean takes in the margin, for which it reflects the picture.
    inside = float(every[..., 5:-5, 5:-5].mean())
    assert ssim(picture, truth, 1.0) == pytest.approx(inside, abs=1e-6)


def test_ms_ssim_is_that_of_torchmetrics() -> None:
    """Its windows reach over the edge, by reflection: with even edges that is no difference."""
    picture, truth = (torch.nn.functional.pad(each, (90,) * 4) for each in pair(3, (1, 40, 56)))
    measure = MultiScaleStructuralSimilarityIndexMeasure(data_range=1.0, normalize="relu")
    expected = float(measure(picture[None].double(), truth[None].double()))
    assert ms_ssim(picture, truth, 1.0) == pytest.approx(expected, abs=0.01)
    assert ms_ssim(truth, truth, 1.0) == pytest.approx(1)
    assert math.isnan(ms_ssim(picture[..., :175], truth[..., :175], 1.0))


@pytest.mark.parametrize("seed", range(5))
def test_ssim_properties(seed: int) -> None:
    picture, truth = pair(seed)
    value = ssim(picture, truth, 1.0)
    assert -1 <= value < 1
    assert ssim(truth, truth, 1.0) == pytest.approx(1)
    assert ssim(truth, picture, 1.0) == pytest.approx(value)
    assert ssim(picture.flip(-1), truth.flip(-1), 1.0) == pytest.approx(value)
    assert ssim(picture * 7, truth * 7, 7.0) == pytest.approx(value, abs=1e-5)
    worse = picture + 0.2 * torch.randn(picture.shape, generator=torch.manual_seed(seed))
    assert ssim(worse, truth, 1.0) < value


@given(SEEDS)
def test_scale_fit_is_least_squares(seed: int) -> None:
    picture, truth = pair(seed)
    factor = np.linalg.lstsq(
        picture.double().reshape(-1, 1).numpy(), truth.double().flatten().numpy(), rcond=None
    )[0][0]
    assert torch.allclose(scale_fit(picture, truth), picture * float(factor), rtol=1e-5)


@given(SEEDS)
def test_affine_fit_is_least_squares_of_each_channel(seed: int) -> None:
    picture, truth = pair(seed)
    fitted = affine_fit(picture, truth)
    for x, y, z in zip(picture, truth, fitted, strict=True):
        columns = np.stack([x.double().flatten().numpy(), np.ones(x.numel())], axis=1)
        gain, offset = np.linalg.lstsq(columns, y.double().flatten().numpy(), rcond=None)[0]
        assert torch.allclose(z, float(gain) * x + float(offset), atol=1e-5)


@given(SEEDS, st.floats(0.01, 1e4), st.floats(-10, 10))
def test_fits_undo_what_they_fit(seed: int, gain: float, offset: float) -> None:
    picture, truth = pair(seed)
    assert torch.allclose(scale_fit(gain * truth, truth), truth, rtol=1e-4)
    scaled = scale_fit(gain * picture, truth)
    assert torch.allclose(scaled, scale_fit(picture, truth), rtol=1e-4)
    assert torch.allclose(scale_fit(scaled, truth), scaled, rtol=1e-4)
    moved = affine_fit(gain * picture.double() + offset, truth)
    assert torch.allclose(moved.float(), affine_fit(picture, truth), atol=1e-4)
    # A fit with more freedom is never further away.
    distance = [float((each.double() - truth).square().sum()) for each in (scaled, moved)]
    assert distance[1] <= distance[0] * (1 + 1e-6)


def test_fits_keep_channels_apart_or_together() -> None:
    picture, truth = pair(4)
    tinted = picture * torch.tensor([1.0, 2.0, 4.0])[:, None, None]
    assert torch.allclose(affine_fit(tinted, truth), affine_fit(picture, truth), atol=1e-5)
    ratio = scale_fit(tinted, truth) / tinted
    assert float(ratio.std()) < 1e-6


def test_fits_of_nothing() -> None:
    truth = pair(5)[1]
    dark = torch.zeros_like(truth)
    assert torch.equal(scale_fit(dark, truth), dark)
    means = truth.mean(dim=(-2, -1), keepdim=True).expand_as(truth)
    assert torch.allclose(affine_fit(dark, truth), means, atol=1e-6)
    assert torch.allclose(affine_fit(dark + 3, truth), means, atol=1e-6)
