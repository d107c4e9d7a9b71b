"""The sum of convolutions over field points, against the sum written out, pixel by pixel."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from nolens.errors import OptionError
from nolens.operators import CroppedConvolution, FieldConvolution, PixelRectangle
from nolens.operators.field_convolution import interpolation_weights

SCENE = PixelRectangle(-2, -3, 9, 11)


def dense(places: torch.Tensor, scene: PixelRectangle) -> torch.Tensor:
    """Weights on every pixel, (points, height, width)."""
    rows = scene.top + torch.arange(scene.height)
    pixels = torch.cartesian_prod(rows, scene.left + torch.arange(scene.width))
    return interpolation_weights(places, pixels).view(-1, scene.height, scene.width).float()


@given(
    st.lists(
        st.tuples(st.floats(-6, 12), st.floats(-6, 12)).map(
            lambda place: (round(place[0], 2), round(place[1], 2))
        ),
        min_size=1,
        max_size=9,
        unique=True,
    )
)
def test_weights_share_every_pixel_out(places):
    weights = dense(torch.tensor(places), SCENE)
    torch.testing.assert_close(weights.sum(0), torch.ones(9, 11), rtol=0, atol=1e-4)


def test_weights_reproduce_what_is_linear_between_the_points():
    places = torch.tensor([(-2.0, -3), (-2, 7), (6, -3), (6, 7), (1.5, 2.5), (2, -3), (6, 3)])
    weights = dense(places, SCENE)
    rows, columns = torch.arange(9.0) - 2, torch.arange(11.0) - 3
    for axis, truth in ((0, rows[:, None].expand(9, 11)), (1, columns.expand(9, 11))):
        mean = (weights * places[:, axis, None, None]).sum(0)
        torch.testing.assert_close(mean, truth, rtol=0, atol=1e-4)


def test_weights_follow_what_goes_with_the_square():
    """Linear ones miss a quarter of a parabola in the middle between its top and an outer point."""
    places = torch.cartesian_prod(torch.tensor([-1.0, 0, 1]), torch.tensor([-1.0, 0, 1])) * 40
    pixels = torch.cartesian_prod(torch.arange(-40.0, 41, 4), torch.arange(-40.0, 41, 4))
    weights = interpolation_weights(places, pixels)
    for of in (lambda x: x[:, 0] ** 2, lambda x: x[:, 0] * x[:, 1]):
        missed = (weights * of(places)[:, None]).sum(0) - of(pixels)
        assert float(missed.abs().max()) < 0.08 * 40**2


def test_a_place_that_is_met_twice_counts_once():
    places = torch.tensor([(-2.0, -3), (-2, 7), (6, 2), (6, 2)])
    weights = dense(places, SCENE)
    torch.testing.assert_close(weights[2], weights[3])
    torch.testing.assert_close(weights[2] + weights[3], dense(places[:3], SCENE)[2])


def test_beyond_the_points_the_nearest_ones_go_on():
    weights = dense(torch.tensor([(2.0, 1), (2, 4)]), SCENE)
    assert torch.equal(weights[0, :, :5], torch.ones(9, 5))
    assert torch.equal(weights[1, :, 7:], torch.ones(9, 4))
    torch.testing.assert_close(weights[1, 0, 4:8], torch.tensor([0, 1 / 3, 2 / 3, 1]))


def test_it_is_the_sum_of_convolutions_of_parts():
    generator = torch.Generator().manual_seed(1)
    psfs = torch.rand((5, 3, 8, 9), generator=generator, dtype=torch.float64)
    places = torch.tensor([(-2.0, -3), (-2, 7), (6, -3), (6.5, 7), (1.0, 2.5)])
    operator = FieldConvolution(psfs, places, (5, 6), SCENE)
    v = torch.rand((3, 9, 11), generator=generator, dtype=torch.float64)
    parts = [
        CroppedConvolution(psf, (5, 6), SCENE)(weight * v)
        for psf, weight in zip(psfs, dense(places, SCENE).double(), strict=True)
    ]
    torch.testing.assert_close(operator(v), torch.stack(parts).sum(0))
    rows, columns = v[0, :, :2].T, v[0, :3]
    products = (row[:, None] * column for row in rows for column in columns)
    for image, product in zip(operator.of_products(rows, columns), products, strict=True):
        torch.testing.assert_close(image, operator(product.expand(3, -1, -1)))
    one = operator.single(1)
    torch.testing.assert_close(one(v[1:2]), operator(v)[1:2])
    factor = torch.tensor([2.0, 3, 4], dtype=torch.float64)[:, None, None]
    before = operator(v)
    operator.scale_(factor)
    torch.testing.assert_close(operator(v), factor * before)


def test_the_same_psf_everywhere_is_one_convolution():
    psf = torch.rand((1, 8, 9), generator=torch.Generator().manual_seed(2))
    places = torch.tensor([(0.0, 0), (0, 5), (4, 0), (4, 5)])
    single = CroppedConvolution(psf, (5, 6), SCENE)
    operator = FieldConvolution(psf.expand(4, 1, 8, 9), places, (5, 6), SCENE)
    v = torch.rand((1, 9, 11), generator=torch.Generator().manual_seed(3))
    torch.testing.assert_close(operator(v), single(v))
    torch.testing.assert_close(operator.transfer, single.transfer)
    torch.testing.assert_close(operator.power, single.power)


def test_fewer_psfs_keep_how_their_light_leans():
    """A lean of three thousandths, which shows where all of a shaded scene adds up."""
    generator = torch.Generator().manual_seed(4)
    detail = torch.rand((1, 160, 160), generator=generator, dtype=torch.float64)
    places = torch.cartesian_prod(torch.linspace(-30, 30, 3), torch.linspace(-30, 30, 3)) + 40
    change = torch.linspace(-1, 1, 160, dtype=torch.float64) * 3e-3
    rest = torch.rand((9, 1, 160, 160), generator=generator, dtype=torch.float64) - 0.5
    leans = (places[:, 1].double() / 30 - 4 / 3)[:, None, None, None]
    psfs = detail * (1 + leans * change) + 0.02 * rest
    scene = PixelRectangle(10, 10, 60, 60)
    whole, fewer = (
        FieldConvolution(psfs, places, (80, 80), scene, error=error) for error in (0.0, 0.01)
    )
    shaded = torch.linspace(-1, 1, 60, dtype=torch.float64).expand(60, 60)
    off = (fewer(shaded) - whole(shaded)) / whole(torch.ones_like(shaded)).mean()
    assert len(fewer.terms) == 2 and float(off.std()) < 1e-4, "without the lean 3e-4"


def test_every_psf_needs_a_place():
    with pytest.raises(OptionError, match="2 PSFs and 3 places"):
        FieldConvolution(torch.rand(2, 1, 4, 4), torch.zeros(3, 2), (4, 4))
    for error in (-1, 2, float("nan")):
        with pytest.raises(OptionError, match=f"error is {error}.*from 0 to below 1"):
            FieldConvolution(torch.rand(2, 1, 4, 4), torch.zeros(2, 2), (4, 4), error=error)


def test_fewer_psfs_take_the_places_of_their_combinations():
    """Nine PSFs of three and little else: as many terms, and what the error says."""
    generator = torch.Generator().manual_seed(2)
    three = torch.rand((3, 2, 12, 14), generator=generator, dtype=torch.float64)
    amounts = torch.rand((9, 3), generator=generator, dtype=torch.float64)
    rest = torch.rand((9, 2, 12, 14), generator=generator, dtype=torch.float64) - 0.5
    psfs = torch.einsum("kr,rchw->kchw", amounts, three) + 1e-3 * rest
    places = torch.cartesian_prod(torch.linspace(-2, 6, 3), torch.linspace(-3, 7, 3))
    whole = FieldConvolution(psfs, places, (9, 11), SCENE)
    fewer = FieldConvolution(psfs, places, (9, 11), SCENE, error=0.01)
    assert (len(whole.terms), len(fewer.terms), fewer.field_points) == (9, 3, 9)
    scene = torch.rand((2, 9, 11), generator=generator, dtype=torch.float64)
    error = float((fewer(scene) - whole(scene)).norm() / whole(scene).norm())
    assert 1e-5 < error < 2e-3
    torch.testing.assert_close(fewer.transfer, whole.transfer, rtol=0, atol=0.1)
    torch.testing.assert_close(fewer.power, whole.power, rtol=1e-2, atol=1e-2)
    assert len(FieldConvolution(psfs, places, (9, 11), SCENE, error=1e-5).terms) == 9
    for each in (whole, fewer):
        each.scale_(torch.tensor([2.0, 3.0])[:, None, None])
    torch.testing.assert_close(fewer.single(1)(scene[1:]), fewer(scene)[1:])
    torch.testing.assert_close(fewer(scene), whole(scene), rtol=0.02, atol=1e-2)
