"""Pictures laid on the truth: known homographies, and the error that is stated."""

import math

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy import ndimage
from skimage import data
from torch import Tensor

from nolens.evaluate.comparison import compare_pictures, lies_beside, turned_over
from nolens.evaluate.registration import Registration, register_picture, resampled

SIZE = (150, 200)


def photograph(rows: int = SIZE[0], columns: int = SIZE[1]) -> Tensor:
    part = torch.from_numpy(data.astronaut()[20 : 20 + 2 * rows, 40 : 40 + 2 * columns].copy())
    values = part.permute(2, 0, 1).double() / 255
    return torch.nn.functional.avg_pool2d(values[None], 2)[0]


def tilted(degrees: float, scale: float, shift: tuple[float, float]) -> NDArray[np.float64]:
    """Homography of a camera 250 pixels behind its picture, turned about the columns."""
    turn = math.radians(degrees)
    middle = [(n - 1) / 2 for n in SIZE]
    lens = np.array([[250, 0, middle[0]], [0, 250, middle[1]], [0, 0, 1.0]])
    rotation = np.array(
        [[math.cos(turn), 0, math.sin(turn)], [0, 1, 0], [-math.sin(turn), 0, math.cos(turn)]]
    )
    matrix = lens @ rotation @ np.diag([scale, scale, 1]) @ np.linalg.inv(lens)
    matrix /= matrix[2, 2]
    matrix[:2, 2] += shift
    return matrix


def seen(truth: Tensor, known: Registration, noise: float, seed: int = 0) -> Tensor:
    """The truth through a homography: blurred, of another brightness, noisy."""
    moved = resampled(truth, known)[0].numpy()
    blurred = np.stack([ndimage.gaussian_filter(each, 1.0) for each in moved])
    rough = np.random.default_rng(seed).standard_normal(blurred.shape)
    return torch.from_numpy(0.6 * blurred + 0.1 + noise * rough)


def test_tilt_and_scale_are_found_and_the_error_is_true() -> None:
    """2° of tilt and 5 % of scale, to 0.2 pixels; the stated error is that of many noises."""
    truth = photograph()
    known = Registration(tilted(2, 1.05, (2.3, -1.7)), "homography", 1, 0, SIZE)
    found = [
        register_picture(seen(truth, known, 0.05, seed), truth, "homography") for seed in range(4)
    ]
    errors = [each.moved_px(known) for each in found]
    assert max(errors) < 0.2
    stated = np.mean([each.error_px for each in found])
    assert 0.3 < stated / np.sqrt(np.mean(np.square(errors))) < 3
    scale, turn = found[0].scale_and_turn()
    assert scale == pytest.approx(known.scale_and_turn()[0], abs=0.003) and abs(turn) < 0.2
    assert all(each.found for each in found)
    # Less freedom than there is motion leaves most of it.
    assert register_picture(seen(truth, known, 0), truth, "shift").moved_px(known) > 1


def test_sizes_that_differ() -> None:
    """A truth of three times the pixels, and one that shows more than the picture."""
    fine = torch.from_numpy(data.astronaut().copy()).permute(2, 0, 1).double()[:, :510, :510] / 255
    picture = torch.nn.functional.avg_pool2d(fine[None], 3)[0]
    whole = register_picture(picture, fine, "similarity")
    assert whole.moved_px(register_picture(picture, fine, "none")) < 0.1
    part = picture[:, 10:150, 30:160]
    found = register_picture(part, picture, "similarity")
    middle = np.array([found.figures()[name] for name in ("row_in_truth", "column_in_truth")])
    assert middle == pytest.approx([79.5, 94.5], abs=0.05)
    assert compare_pictures(part, picture, register="shift").figures["psnr_db"] > 40


def test_what_lies_beside_its_truth() -> None:
    truth = photograph()
    noise = 0.02 * torch.randn(truth.shape, generator=torch.manual_seed(1))
    for rows, expected in ((2, True), (0, False)):
        picture = truth.roll(rows, -2) + noise
        found = register_picture(picture, truth, "similarity")
        assert lies_beside(found, register_picture(picture, truth, "none")) is expected
    assert turned_over(truth.flip(-2), truth) == "vertical"
    assert turned_over(truth, truth) is None
    other = torch.from_numpy(data.coffee()[:300, :400].copy()).permute(2, 0, 1).double()
    other = torch.nn.functional.avg_pool2d(other[None], 2)[0] / 255
    for motion in ("shift", "similarity", "homography"):
        assert not register_picture(other, truth, motion).found
