"""Real pairs as examples: brightness, place and binning of their pictures."""

import pytest
import torch

from nolens.errors import DataError
from nolens.operators import CroppedConvolution, PixelRectangle
from nolens.training.pairs import binned_picture, pair_shot
from nolens.training.pictures import training_picture

SENSOR, SIDE = (96, 112), 80
SUPPORT = PixelRectangle.centred(SIDE, SIDE, SENSOR)
GAINS = torch.tensor([0.5, 2.0, 1.0])[:, None, None]


def psf() -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    return (torch.rand(3, 128, 128, generator=generator) < 0.01).float()


@pytest.mark.parametrize("moved", [0, 4])
def test_truth_lies_where_the_measurement_has_it(moved: int) -> None:
    """Each channel as bright as it was, though the picture's own colours are others."""
    whole = training_picture(SIDE + 8, SIDE + 8, 3)
    scene = GAINS * whole[:, 4:-4, 4:-4]
    measured = CroppedConvolution(psf(), SENSOR, SUPPORT)(scene)
    measured += 0.01 * measured.mean() * torch.randn(measured.shape)
    given = whole[:, 4 - moved : 4 - moved + SIDE, 4:-4]
    valid = torch.ones_like(measured, dtype=torch.bool)
    example = pair_shot(measured, valid, psf(), given, SUPPORT)
    inner = (slice(None), slice(8, -8), slice(8, -8))
    error = (example.truth - scene)[inner].norm() / scene[inner].norm()
    assert float(error) < 0.1
    wrong = (GAINS * given - scene)[inner].norm() / scene[inner].norm()
    assert moved == 0 or float(wrong) > 0.2


def test_dark_measurement_is_refused() -> None:
    picture = training_picture(SIDE, SIDE, 3)
    noise = -torch.rand(3, *SENSOR) - 1
    valid = torch.ones_like(noise, dtype=torch.bool)
    with pytest.raises(DataError, match="shows nothing of the picture"):
        pair_shot(noise, valid, psf(), picture, SUPPORT)


def test_binned_pictures_lie_on_the_sensors_pixels() -> None:
    sensor, picture = (17, 24), torch.arange(11.0 * 13).reshape(1, 11, 13)
    coarse, support = binned_picture(picture, 2, sensor)
    whole = torch.zeros(1, *sensor)
    top, left = (17 - 11) // 2, (24 - 13) // 2
    whole[:, top : top + 11, left : left + 13] = picture
    here = whole[:, 2 * support.top :, 2 * support.left :]
    here = here[:, : 2 * support.height, : 2 * support.width]
    means = here.reshape(1, support.height, 2, support.width, 2).mean((2, 4))
    assert torch.equal(coarse, means)
