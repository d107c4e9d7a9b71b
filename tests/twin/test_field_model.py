"""The model with stored spectra: the same light as `irradiate`, for any scene."""

import math

import pytest
import torch
from cameras import WHITE, cropped, flattened, in_grey, relative_error, twin_of

from nolens.camera import Camera
from nolens.operators import PixelRectangle
from nolens.optics import PointSource
from nolens.twin import FieldMap, FieldModel, PlaneView, irradiate, point_spread

FAR_UM = 300e3
CAMERAS = {
    "colour": lambda: cropped(48, 64, of="small"),
    "grey": lambda: in_grey(cropped(48, 64, of="small")),
    "no aperture": lambda: flattened(cropped(48, 64, of="small")),
}


def model_of(camera: Camera, field_points: int = 1) -> FieldModel:
    twin = twin_of(camera)
    field = FieldMap.covering(twin, (0.06, 0.09))
    return FieldModel.of(
        twin, field, distance_um=FAR_UM, light=WHITE, wavelengths=2, field_points=field_points
    )


@pytest.mark.parametrize(
    ("name", "field_points"), [*((name, 1) for name in CAMERAS), ("colour", 3)]
)
def test_light_is_that_of_irradiate(name: str, field_points: int) -> None:
    camera = CAMERAS[name]()
    model, twin = model_of(camera, field_points), twin_of(camera)
    support = model.field.support
    channels = len(model.twin.camera.sensor.channels)
    generator = torch.Generator().manual_seed(0)
    for _ in range(2):
        scene = torch.rand(channels, support.height, support.width, generator=generator)
        expected = irradiate(
            twin,
            model.field,
            (PlaneView(scene, FAR_UM),),
            field_points=field_points,
            light=WHITE,
            wavelengths=2,
        ).light
        found = model.light(scene)
        assert found.shape == expected.shape
        # Several PSFs are cut into windows, which differ with the area that the estimate needs.
        within = 1e-5 if field_points == 1 else 5e-3
        assert relative_error(found, expected) < within
        assert float((found - expected).abs().max()) < within * float(expected.max())


def test_psf_is_that_of_a_point_straight_ahead_at_the_pixels_places() -> None:
    camera = cropped(144, 176, of="small")
    found = model_of(camera).psf()
    size = camera.sensor.rows, camera.sensor.columns
    pixels = point_spread(
        twin_of(camera), PointSource(distance_um=FAR_UM), size, light=WHITE, wavelengths=2
    )
    green = (pixels[1, ::2, 1::2] + pixels[1, 1::2, ::2]) / 2
    expected = torch.stack([pixels[0, ::2, ::2], green, pixels[2, 1::2, 1::2]])
    assert found.shape == expected.shape
    # Patterns are cut into windows, which differ with the area: a part in a thousand.
    assert relative_error(found, expected) < 5e-3


def test_without_an_aperture_the_psf_reaches_as_far_as_the_fields_light() -> None:
    model = model_of(CAMERAS["no aperture"]())
    support, cells = model.field.support, model.twin.shape
    assert model.psf().shape[1:] == (cells[0] + support.height - 1, cells[1] + support.width - 1)


def test_a_picture_is_seen_in_whole_and_upright() -> None:
    model = model_of(CAMERAS["colour"]())
    support = model.field.support
    picture = torch.zeros(3, 40, 20)
    picture[0, :20] = 1.0
    picture[1, :, :10] = 0.5
    cells = model.rendered(picture)
    assert cells.shape == (3, support.height, support.width)
    lit = (cells.sum(dim=0) > 0.25).nonzero()
    height, width = (int(lit[:, axis].max() - lit[:, axis].min()) + 1 for axis in (0, 1))
    # Twice as high as wide: the height fills the field, dark remains at the sides.
    assert support.height - 2 <= height + support.height // 40
    assert width < support.width
    top, left = cells[:, : support.height // 2 - 1], cells[..., : support.width // 2 - 1]
    assert float(top[0].max()) == pytest.approx(1.0, abs=1e-3)
    assert float(cells[0, support.height // 2 + 1 :].max()) < 1e-3
    assert float(left[1].max()) == pytest.approx(0.5, abs=1e-3)
    assert float(cells[1, :, support.width // 2 + 1 :].max()) < 1e-3


def test_a_picture_covers_the_field_to_its_corners() -> None:
    camera = cropped(144, 176, of="small")
    field = FieldMap.covering(twin_of(camera), (0.5, 0.6))
    model = FieldModel.of(twin_of(camera), field, distance_um=FAR_UM, light=WHITE, wavelengths=1)
    for size in ((40, 60), (60, 40), (round(100 * model.aspect), 100)):
        covered = model.rendered(torch.ones(3, *size), whole=False)
        assert float(covered.min()) > 0.999
    assert float(model.rendered(torch.ones(3, 40, 60)).min()) == 0


def test_a_wide_picture_fills_the_width() -> None:
    model = model_of(CAMERAS["grey"]())
    support = model.field.support
    cells = model.rendered(torch.ones(1, 8, 200))
    assert isinstance(support, PixelRectangle)
    assert bool((cells[0, support.height // 2] > 0.4).all())
    assert float(cells[0, 0].max()) == 0


def test_altered_psfs_are_magnified_turned_and_blurred_about_their_chief_rays() -> None:
    model = model_of(cropped(256, 320, of="small"))
    psf = model.psf()
    same = model.altered(scale=1.0 + 1e-9).psf()
    assert relative_error(same, psf) < 1e-4
    rows, columns = (torch.arange(count) - (count - 1) / 2 for count in psf.shape[-2:])
    squared = rows.square()[:, None] + columns.square()
    turned = psf.flip(-1).transpose(-2, -1)  # By a right angle, anticlockwise.

    def spread(each: torch.Tensor) -> float:
        """Mean square of the distance of its light from the middle."""
        return float((each.double() * squared).sum() / each.double().sum())

    for changed, expected in (
        (model.altered(scale=0.9), 0.81 * spread(psf)),
        (model.altered(rotation_rad=0.1), spread(psf)),
        (model.altered(blur_pixels=1.5), spread(psf) + 2 * 1.5**2),
    ):
        other = changed.psf()
        assert float(other.sum()) == pytest.approx(float(psf.sum()), rel=5e-3)
        assert spread(other) == pytest.approx(expected, rel=5e-3)
    quarter = model.altered(rotation_rad=math.pi / 2).psf()
    side = min(psf.shape[-2:])
    assert relative_error(cut(quarter, side)[1], cut(turned, side)[1]) < 0.1


def cut(psf: torch.Tensor, side: int) -> torch.Tensor:
    """The middle of a PSF."""
    top, left = ((count - side) // 2 for count in psf.shape[-2:])
    return psf[:, top : top + side, left : left + side]
