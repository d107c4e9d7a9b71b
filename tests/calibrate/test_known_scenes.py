"""Measurements of many scenes as a map of the PSF, and their weights."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from known_pairs import photograph

from nolens.calibrate.known_scenes import KnownScenes, ManyScenes, Weights, over_the_field
from nolens.errors import DataError
from nolens.operators import PixelRectangle
from reference import direct_sum

SMALL = st.integers(2, 6)


@settings(max_examples=40)
@given(SMALL, SMALL, SMALL, SMALL, st.integers(-3, 3), st.integers(-3, 3), st.integers(0, 99))
def test_is_the_direct_sum(rows, columns, height, width, top, left, seed):
    """Cropped, not periodic: any support, any size of PSF, even or odd, that can reach."""
    rng = np.random.default_rng(seed)
    sensor, psf = (rows, columns), (2 * rows + height, 2 * columns + width)
    scenes, terms = rng.uniform(size=(2, height, width)), rng.uniform(size=(3, height, width))
    p = rng.normal(size=(3, *psf))
    model = ManyScenes(
        torch.from_numpy(scenes), PixelRectangle(top, left, height, width), sensor, psf,
        torch.from_numpy(terms),
    )  # fmt: skip
    got = model(torch.from_numpy(p)).numpy()
    for number, scene in enumerate(scenes):
        wanted = sum(
            direct_sum(scene * term, (top, left), plane, sensor)
            for term, plane in zip(terms, p, strict=True)
        )
        np.testing.assert_allclose(got[number], wanted, atol=1e-10)


def test_terms_are_free_of_the_mean() -> None:
    """0 in the mean over the light, so that the first PSF is the mean one."""
    known = KnownScenes.of([photograph(0), photograph(1)], [photograph(0), photograph(1)])
    terms = over_the_field(known).double()
    light = (known.scenes / known.scenes.mean(dim=(-2, -1), keepdim=True)).sum(dim=0).double()
    assert torch.all(terms[0] == 1)
    assert torch.allclose((terms[1:] * light).sum(dim=(-2, -1)), torch.zeros(3).double(), atol=1e-2)
    steps = terms[1].diff(dim=0), terms[2].diff(dim=1)
    for step in steps:
        assert torch.allclose(step, torch.full_like(step, 2 / 96), atol=1e-6)
    bowl = terms[3] - terms[3].min()
    assert bowl[0, 0] == pytest.approx((63 / 96) ** 2 + (95 / 96) ** 2 - 2 / 96**2, abs=1e-5)


def test_binned_stays_in_place() -> None:
    """Coarse model of a PSF at zero shift is the coarse measurement, wherever the support lies."""
    scene = torch.rand(1, 40, 56, generator=torch.Generator().manual_seed(0))
    sensor = torch.zeros(1, 50, 70)
    sensor[:, 5:45, 9:65] = scene
    known = KnownScenes.of([scene], [sensor], support=PixelRectangle(5, 9, 40, 56)).binned(4)
    point = torch.zeros(1, *known.extent)
    point[0, known.extent[0] // 2, known.extent[1] // 2] = 1
    model = ManyScenes(
        known.scenes, known.support, known.sensor, known.extent, torch.ones_like(known.scenes)
    )
    inner = (slice(None), slice(3, -3), slice(4, -4))
    assert torch.allclose(model(point)[inner], known.measured[inner], atol=1e-5)


def test_saturated_pixels_stay_out_when_binned() -> None:
    valid = torch.ones(1, 32, 32, dtype=torch.bool)
    valid[0, 9, 17] = False
    known = KnownScenes.of([torch.rand(1, 32, 32)], [torch.rand(1, 32, 32)], [valid])
    assert (~known.binned(4).valid).nonzero().tolist() == [[0, 2, 4]]


def test_weights_whiten_light_and_noise() -> None:
    """Symmetric, not negative, and 1/P follows N + ε √(S S₀) of a known spectrum."""
    generator = torch.Generator().manual_seed(1)
    frequency = torch.hypot(torch.fft.fftfreq(128)[:, None], torch.fft.rfftfreq(128)[None])
    wanted = 1 / (1 + (frequency / 0.02) ** 4)
    light = torch.fft.irfft2(
        torch.fft.rfft2(torch.randn(6, 128, 128, generator=generator)) * wanted.sqrt(),
        s=(128, 128),
    )
    measured = light + 1e-3 * torch.randn(light.shape, generator=generator)
    weights = Weights.of(measured, torch.ones_like(measured, dtype=torch.bool))
    a, b = torch.randn(2, 6, 128, 128, generator=generator)
    assert torch.allclose(weights.product(a, b), weights.product(b, a), rtol=1e-4)
    assert bool((weights.product(a, a) > 0).all())
    for low, high in ((0.03, 0.06), (0.06, 0.12)):
        of = [weights.spectrum[:, (frequency - f).abs() < 0.003].mean() for f in (low, high)]
        falls = [wanted[(frequency - f).abs() < 0.003].mean() for f in (low, high)]
        assert float(of[1] / of[0]) == pytest.approx(float((falls[0] / falls[1]).sqrt()), rel=0.2)


@pytest.mark.parametrize(
    ("scenes", "measured", "words"),
    [
        ([], [], "0 scenes"),
        ([torch.rand(1, 8, 8)], [], "0 measurements"),
        ([torch.rand(1, 8, 8)], [torch.zeros(1, 8, 8)], "dark"),
        ([torch.ones(1, 8, 8)], [torch.rand(1, 8, 8)], "same everywhere"),
        ([torch.rand(1, 8, 8).log()*torch.nan], [torch.rand(1, 8, 8)], "NaN"),
        ([torch.rand(3, 8, 8)], [torch.rand(1, 8, 8)], "3 channels"),
        ([torch.rand(1, 8, 8), torch.rand(1, 8, 9)], [torch.rand(1, 8, 8)] * 2, "sizes"),
    ],
)  # fmt: skip
def test_refused(scenes, measured, words):
    with pytest.raises(DataError, match=words):
        KnownScenes.of(scenes, measured)
