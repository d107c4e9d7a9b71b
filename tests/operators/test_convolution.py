"""The forward model against its defining sum, written as loops."""

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

from nolens.errors import OptionError
from nolens.kernels import fast_length
from nolens.operators import CroppedConvolution, Geometry, PixelRectangle
from reference import direct_sum

Pair = tuple[int, int]


def _sizes(least: int, most: int) -> st.SearchStrategy[Pair]:
    return st.tuples(st.integers(least, most), st.integers(least, most))


REGIONS = st.none() | st.builds(
    PixelRectangle,
    st.integers(-9, 10),
    st.integers(-9, 10),
    st.integers(1, 8),
    st.integers(1, 8),
)


def _reaches(sensor: Pair, psf: Pair, support: PixelRectangle) -> bool:
    """Whether some cell of the support sends light to some cell of the sensor."""
    lit = direct_sum(
        np.ones((support.height, support.width)), (support.top, support.left), np.ones(psf), sensor
    )
    return bool(lit.any())


def _check_direct_sum(
    sensor: Pair, psf_size: Pair, support: PixelRectangle | None, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    psf = rng.uniform(0.5, 1, (1, *psf_size))
    if support is not None and not _reaches(sensor, psf_size, support):
        with pytest.raises(OptionError, match="reaches the sensor"):
            CroppedConvolution(torch.from_numpy(psf), sensor, support)
        return
    operator = CroppedConvolution(torch.from_numpy(psf), sensor, support)
    v = rng.uniform(-1, 1, operator.domain_shape)
    expected = direct_sum(v, operator.geometry.origin, psf[0], sensor)
    got = operator(torch.from_numpy(v)[None])[0].numpy()
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-12 * v.size)
    rows, columns = torch.from_numpy(v[:, :2].T), torch.from_numpy(v[:2])
    images = operator.of_products(rows, columns)
    products = (row[:, None] * column for row in rows for column in columns)
    for image, product in zip(images, products, strict=True):
        torch.testing.assert_close(image, operator(product[None]), rtol=0, atol=1e-12 * v.size)


@given(_sizes(1, 7), _sizes(0, 7), REGIONS, st.integers(0, 99))
@example((4, 4), (0, 0), None, 0)
@example((5, 4), (0, 1), PixelRectangle(-2, 1, 4, 9), 0)
@example((3, 3), (9, 8), PixelRectangle(-6, 5, 2, 2), 0)
@settings(max_examples=120)
def test_operator_is_the_direct_sum(sensor, margin, support, seed):
    _check_direct_sum(sensor, (sensor[0] + margin[0], sensor[1] + margin[1]), support, seed)


@given(_sizes(1, 7), _sizes(0, 7), REGIONS, st.integers(0, 99))
@settings(max_examples=200)
def test_no_light_wraps_around_onto_the_sensor(sensor, margin, support, seed):
    """In a period of just the cells asked for, odd or even: no slack hides one that is missing."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("nolens.operators.convolution.fast_length", lambda cells, **_: cells)
        _check_direct_sum(sensor, (sensor[0] + margin[0], sensor[1] + margin[1]), support, seed)


@given(_sizes(1, 12), _sizes(0, 12), REGIONS)
@settings(max_examples=120)
def test_layout(sensor, margin, support):
    psf = (sensor[0] + margin[0], sensor[1] + margin[1])
    try:
        geometry = Geometry.build(sensor, psf, support)
    except OptionError:
        assert support is not None
        return
    for window in (geometry.sensor, geometry.scene):
        for axis in range(2):
            assert window[axis] >= 0
            assert window[axis] + window[axis + 2] <= geometry.padded[axis]
    assert geometry.sensor[2:] == sensor
    # The scene's first cell lies `origin` away from the sensor's.
    assert geometry.origin == tuple(geometry.scene[k] - geometry.sensor[k] for k in range(2))
    if support is None:
        assert geometry.scene == (0, 0, *geometry.padded)
        assert geometry.padded == tuple(
            fast_length(n + p - 1, of_rows=k == 1)
            for k, (n, p) in enumerate(zip(sensor, psf, strict=True))
        )
        return
    assert geometry.origin == (support.top, support.left)
    assert geometry.scene[2:] == (support.height, support.width)
    starts, lengths = (support.top, support.left), (support.height, support.width)
    for axis in range(2):
        if starts[axis] < sensor[axis] and starts[axis] + lengths[axis] > 0:
            assert geometry.padded[axis] <= fast_length(
                sensor[axis] + lengths[axis] - 1, of_rows=axis == 1
            )


@pytest.mark.parametrize("psf", [(6, 8), (7, 9), (6, 9), (13, 12)])
@pytest.mark.parametrize(
    "support", [None, PixelRectangle(1, 2, 4, 5), PixelRectangle(-1, -2, 6, 9)]
)
def test_light_through_the_centre_falls_on_its_own_cell(psf, support):
    kernel = torch.zeros(1, *psf, dtype=torch.float64)
    kernel[0, psf[0] // 2, psf[1] // 2] = 1
    operator = CroppedConvolution(kernel, (6, 8), support)
    origin = operator.geometry.origin
    for row, column in ((1, 2), (4, 6), (3, 3)):
        v = torch.zeros(1, *operator.domain_shape, dtype=torch.float64)
        v[0, row - origin[0], column - origin[1]] = 1
        expected = torch.zeros(1, 6, 8, dtype=torch.float64)
        expected[0, row, column] = 1
        torch.testing.assert_close(operator(v), expected, rtol=0, atol=1e-14)


def test_light_from_beyond_the_sensor_comes_in_from_its_side_only():
    """The farthest cells that reach the sensor light its edge, and not the opposite one."""
    psf = np.ones((1, 5, 7))
    operator = CroppedConvolution(torch.from_numpy(psf), (5, 7))
    top, left = operator.geometry.origin
    v = torch.zeros(1, *operator.domain_shape, dtype=torch.float64)
    v[0, -2 - top, 3 - left] = 1  # two rows above the sensor: PSF offsets reach +2
    image = operator(v)[0]
    assert image[0].min() > 0.5
    torch.testing.assert_close(image[1:], torch.zeros_like(image[1:]), rtol=0, atol=1e-14)


def test_one_psf_serves_every_channel():
    rng = np.random.default_rng(3)
    psf = torch.from_numpy(rng.random((1, 5, 6)))
    one, three = CroppedConvolution(psf, (5, 6)), CroppedConvolution(psf.repeat(3, 1, 1), (5, 6))
    v = torch.from_numpy(rng.random((3, *one.domain_shape)))
    torch.testing.assert_close(one(v), three(v), rtol=0, atol=1e-13)


def test_channels_do_not_mix():
    rng = np.random.default_rng(4)
    psf = rng.random((2, 5, 6))
    operator = CroppedConvolution(torch.from_numpy(psf), (4, 5), PixelRectangle(0, 0, 3, 3))
    v = rng.random((2, 3, 3))
    image = operator(torch.from_numpy(v)).numpy()
    for channel in range(2):
        np.testing.assert_allclose(
            image[channel], direct_sum(v[channel], (0, 0), psf[channel], (4, 5))
        )


def test_region_that_sends_no_light_is_named():
    with pytest.raises(OptionError, match="pixels 30 to 33"):
        CroppedConvolution(torch.ones(1, 6, 6), (6, 6), PixelRectangle(0, 30, 4, 4))
    with pytest.raises(OptionError, match="overlaps the sensor"):
        CroppedConvolution(torch.ones(1, 6, 6), (6, 6), PixelRectangle(-9, 0, 4, 4))


@pytest.mark.parametrize(("sensor", "size"), [((6, 8), (2, 4)), ((7, 7), (2, 4)), ((4, 4), (9, 7))])
def test_centred_region(sensor, size):
    support = PixelRectangle.centred(*size, sensor)
    assert (support.height, support.width) == size
    for first, length, whole in (
        (support.top, support.height, sensor[0]),
        (support.left, support.width, sensor[1]),
    ):
        before, after = first, whole - first - length
        assert abs(before - after) <= 1


@pytest.mark.parametrize("channels", [1, 2])
def test_number_of_channels_is_the_psfs(channels):
    operator = CroppedConvolution(torch.rand(3, 4, 5), (4, 5))
    with pytest.raises(ValueError, match=r"\(3, 8, 10\)"):
        operator(torch.rand(channels, 8, 10))
    with pytest.raises(ValueError, match=r"\(3, 4, 5\)"):
        operator.adjoint(torch.rand(channels, 4, 5))
