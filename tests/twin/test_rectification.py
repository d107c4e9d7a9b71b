"""Shading and distortion of the simulated camera, undone."""

import math

import torch

from nolens.camera import LoadedCamera, preset
from nolens.operators import PixelRectangle
from nolens.twin import FieldMap, Plane, Rectification, preview_model, render_planes

TWIN = preview_model(LoadedCamera.of(preset("paper")))


def test_an_even_plane_is_even_again():
    """On pixels that are binned as a measurement is."""
    rectangle = PixelRectangle(193, 253, 120, 160)
    field = FieldMap(TWIN, PixelRectangle(3 * 193, 3 * 253, 360, 480))
    light = (field.solid_angle() * field.vignetting()).float()
    binned = light.unflatten(0, (-1, 3)).unflatten(2, (-1, 3)).mean(dim=(1, 3))
    rectification = Rectification(TWIN, rectangle, 3)
    flat = rectification.flattened(binned[None])
    torch.testing.assert_close(flat, flat.mean().expand_as(flat), rtol=1e-5, atol=0)
    assert rectification.row()["least_response"] < 0.8


def test_a_plane_is_as_a_pinhole_shows_it():
    """A pattern of 60°: as it is, it is off by pixels; undistorted, by less than a third of one."""
    waves = 4
    rows, columns = ((torch.arange(800.0) + 0.5)[None] / 800 * 2 * math.pi * waves for _ in "yx")
    picture = 1 + rows.T.sin() * columns.sin()
    field, (view,) = render_planes(TWIN, (Plane(picture.expand(3, -1, -1), 60, 300e3),))
    rectification = Rectification(TWIN, field.support)
    seen = rectification.undistorted(view.radiance)[0]
    step = 2 * math.pi * waves * rectification.tangent_per_pixel / (2 * math.tan(math.pi / 6))

    def off(image: torch.Tensor) -> float:
        """Pixels by which it is off, at most, if its slope is the steepest."""
        # The axis is the pixel after the middle.
        down, right = ((torch.arange(count) - count // 2) * step for count in image.shape)
        expected = 1 + down[:, None].sin() * right.sin()
        return float((image - expected)[8:-8, 8:-8].abs().max()) / step

    assert off(seen) < 0.3
    assert off(view.radiance[0]) > 5
    assert seen.shape[0] > view.radiance.shape[1] + 10
