"""Light of a scene on the pixels: against patterns of single points, sums and convolutions."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from cameras import (
    GREEN,
    WHITE,
    cropped,
    flattened,
    in_grey,
    reduced_um,
    relative_error,
    twin_of,
)
from torch import Tensor

from nolens.camera import AngularCurve, Aperture
from nolens.errors import OptionError
from nolens.operators import CroppedConvolution
from nolens.optics import PointSource
from nolens.quantities import Length
from nolens.twin import (
    FieldMap,
    Plane,
    PlaneView,
    Twin,
    irradiate,
    mosaic,
    point_spread,
    render_planes,
)

DISTANCE_UM = 300e3


@pytest.fixture(scope="module")
def open_mask() -> Twin:
    """64 × 80 cells of the paper's camera."""
    return twin_of(cropped(128, 160, overhang="1.1 mm"))


@pytest.fixture(scope="module")
def aperture() -> Twin:
    return twin_of(cropped(256, 320, of="small"))


@pytest.fixture(scope="module")
def grey() -> Twin:
    """64 × 80 cells that are single pixels of 3.1 um."""
    return twin_of(in_grey(cropped(64, 80, pitch="3.1 um", overhang="1.5 mm", grid="3.1 um")))


def _dark(field: FieldMap, channels: int) -> Tensor:
    return torch.zeros(channels, field.support.height, field.support.width)


def _frame(twin: Twin) -> tuple[int, int]:
    return twin.camera.sensor.rows, twin.camera.sensor.columns


def _by_hand(twin: Twin, field: FieldMap, scene: Tensor, distance_um: float) -> Tensor:
    """Every lit cell with a pattern of its own, in its own place."""
    total = torch.zeros(_frame(twin), dtype=torch.float64)
    solid = field.solid_angle()
    for row, column in scene.amax(dim=0).nonzero().tolist():
        source = field.source(row, column, distance_um)
        psf = point_spread(twin, source, _frame(twin), light=GREEN, frame="sensor")
        sent = psf * (scene[:, row, column] * float(solid[row, column]))[:, None, None]
        total += mosaic(sent, twin.camera.sensor.mosaic)
    return total


@pytest.fixture
def sampled_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    """As many samples to the pixel as `point_spread` takes: two, where `irradiate` takes one."""
    monkeypatch.setattr("nolens.twin.irradiance.samples_per_pixel", lambda twin, **_: 2)


# Middle, a corner, and the middles of two sides, as cells of a support of 2n × 2m: field points.
NODES = [(0.5, 0.5), (0.0, 0.0), (1.0, 0.5), (0.0, 1.0)]


def _lit(field: FieldMap, place: tuple[float, float]) -> tuple[int, int]:
    """The field point of 3 × 3 at a place from 0 to 1."""
    return (
        round(place[0] * (field.support.height - 1)),
        round(place[1] * (field.support.width - 1)),
    )


@pytest.mark.parametrize("place", NODES)
@pytest.mark.parametrize("name", ["open_mask", "aperture"])
def test_a_single_cell_gives_the_pattern_of_its_point(name, place, request, sampled_alike):
    """In its own place: radiance times solid angle times the point spread function there."""
    twin: Twin = request.getfixturevalue(name)
    field = FieldMap.covering(twin, (0.12, 0.16) if name == "open_mask" else (0.06, 0.08))
    scene = _dark(field, 3)
    row, column = _lit(field, place)
    scene[:, row, column] = torch.tensor([1.0, 2.0, 3.0])
    got = irradiate(twin, field, (PlaneView(scene, DISTANCE_UM),), field_points=3, light=GREEN)
    expected = _by_hand(twin, field, scene, DISTANCE_UM)
    # Windows are cut differently; what little light an aperture diffracts past them differs.
    assert relative_error(got.light, expected) < (1e-4 if name == "open_mask" else 2e-3)


def test_one_sample_is_enough_for_a_pixel_of_a_mosaic(open_mask):
    """Instead of two by two: the pattern is so smooth that 0.3 % are all they change."""
    field = FieldMap.covering(open_mask, (0.12, 0.16))
    scene = _dark(field, 3)
    scene[(slice(None), *_lit(field, (0.0, 0.5)))] = 1
    got = irradiate(open_mask, field, (PlaneView(scene, DISTANCE_UM),), field_points=3, light=GREEN)
    error = relative_error(got.light, _by_hand(open_mask, field, scene, DISTANCE_UM))
    assert 1e-4 < error < 5e-3


def test_grey_pixels(grey):
    field = FieldMap.covering(grey, (0.12, 0.16))
    scene = _dark(field, 1)
    scene[(slice(None), *_lit(field, (1.0, 0.5)))] = 1
    got = irradiate(grey, field, (PlaneView(scene, DISTANCE_UM),), field_points=3, light=GREEN)
    assert relative_error(got.light, _by_hand(grey, field, scene, DISTANCE_UM)) < 1e-4


def test_grey_agrees_with_the_mean_of_a_mosaic(open_mask):
    """One channel at the mosaic's pixels: 2 × 2 of them are one of twice the size."""
    mask = open_mask.mask
    large = replace(
        twin_of(in_grey(flattened(cropped(64, 80, pitch="3.1 um")))), mask=mask,
    )  # fmt: skip
    picture = torch.rand(1, 9, 12, generator=torch.Generator().manual_seed(3))
    light = []
    for twin, channels in ((open_mask, 3), (large, 1)):
        plane = Plane(picture.expand(channels, -1, -1), 16.0, DISTANCE_UM)
        field, seen = render_planes(twin, (plane,))
        light.append(irradiate(twin, field, seen, field_points=3, light=GREEN).light)
    binned = torch.nn.functional.avg_pool2d(light[0][None], 2)[0]
    assert relative_error(binned, light[1]) < 2e-3


@pytest.mark.parametrize("field_points", [1, 3])
@pytest.mark.parametrize("distance_um", [80e3, float("inf")])
def test_without_a_mask_an_even_scene_lights_every_pixel_evenly(field_points, distance_um):
    """With the sum of solid angle times vignetting, for the light of a far scene; that of a near
    one spreads on its way through the layers, by 1 + D/z in both directions."""
    twin = twin_of(flattened(cropped(32, 48)))
    field, seen = render_planes(twin, (Plane(torch.full((3, 4, 5), 0.5), 20.0, distance_um),))
    got = irradiate(twin, field, seen, field_points=field_points, light=GREEN)
    expected = (field.solid_angle() * field.vignetting() * seen[0].radiance[0]).sum()
    expected /= (1 + reduced_um(twin.camera) / distance_um) ** 2
    pixels = torch.full((32, 48), float(expected))
    torch.testing.assert_close(got.light, pixels, rtol=2e-3, atol=0)
    if field_points == 3:
        assert got.field_error is not None
        assert got.field_error < 1e-3 * float(expected)


@pytest.mark.parametrize("field_points", [3, 5])
def test_field_points_that_no_pixel_sees(field_points):
    """Pixels are blind beyond 25°: the outer field points still serve the cells beside them."""
    camera = flattened(in_grey(cropped(32, 48, pitch="6.2 um")))
    blind = AngularCurve(source="blind", angle_deg=(0, 20, 25), response=(1, 1, 0))
    sensor = camera.sensor.model_copy(update={"acceptance": blind})
    twin = twin_of(camera.model_copy(update={"sensor": sensor}))
    field, seen = render_planes(twin, (Plane(torch.ones(1, 4, 5), 70.0, float("inf")),))
    weights = field.solid_angle() * field.vignetting()
    assert float(weights[0, 0]) == 0
    got = irradiate(twin, field, seen, field_points=field_points, light=GREEN)
    expected = torch.full((32, 48), float((weights * seen[0].radiance[0]).sum()))
    torch.testing.assert_close(got.light, expected, rtol=1e-3, atol=0)


def test_light_is_linear_and_planes_add_up(grey):
    field = FieldMap.covering(grey, (0.05, 0.08))
    generator = torch.Generator().manual_seed(4)
    one, other = (torch.rand(_dark(field, 1).shape, generator=generator) for _ in range(2))

    def light(*seen: PlaneView) -> Tensor:
        return irradiate(grey, field, seen, field_points=3, light=GREEN).light.double()

    near, far = light(PlaneView(one, 60e3)), light(PlaneView(other, DISTANCE_UM))
    assert (
        relative_error(light(PlaneView(one, 60e3), PlaneView(other, DISTANCE_UM)), near + far)
        < 1e-5
    )
    assert relative_error(light(PlaneView(3 * one, 60e3)), 3 * near) < 1e-5
    both = light(PlaneView(one + other, DISTANCE_UM))
    assert relative_error(both, light(PlaneView(one, DISTANCE_UM)) + far) < 1e-5
    # At another distance the pattern has another size.
    assert relative_error(light(PlaneView(one, DISTANCE_UM)), near) > 1e-3


def test_near_and_far_planes_each_have_their_own_pattern(open_mask, sampled_alike):
    field = FieldMap.covering(open_mask, (0.05, 0.08))
    near, far = _dark(field, 3), _dark(field, 3)
    near[(slice(None), *_lit(field, (1.0, 0.0)))] = 1
    far[(slice(None), *_lit(field, (0.0, 0.5)))] = 1
    seen = PlaneView(near, 40e3), PlaneView(far, DISTANCE_UM)
    got = irradiate(open_mask, field, seen, field_points=3, light=GREEN)
    expected = sum(_by_hand(open_mask, field, each.radiance, each.distance_um) for each in seen)
    assert isinstance(expected, Tensor)
    assert relative_error(got.light, expected) < 1e-3


def test_bright_above_and_to_the_right_is_bright_there_on_the_sensor(aperture):
    """The picture that the camera gives is upright."""
    picture = torch.zeros(3, 2, 2)
    picture[:, 0, 1] = 1
    field, seen = render_planes(aperture, (Plane(picture, 9.0, DISTANCE_UM),))
    light = irradiate(aperture, field, seen, field_points=3, light=GREEN).light.double()
    share = light / light.sum()
    row = float((share.sum(dim=1) * torch.arange(256.0)).sum()) - 127.5
    column = float((share.sum(dim=0) * torch.arange(320.0)).sum()) - 159.5
    # Where the chief rays fall, on average.
    support, weights = field.support, seen[0].radiance[0] * field.solid_angle() * field.vignetting()
    down = torch.arange(support.height)[:, None] + support.top - aperture.shape[0] // 2
    right = torch.arange(support.width) + support.left - aperture.shape[1] // 2
    expected = [2 * float((weights * each).sum() / weights.sum()) for each in (down, right)]
    assert expected[0] < -20 < 20 < expected[1]
    assert (row, column) == pytest.approx(expected, abs=2)


@pytest.mark.parametrize("field_points", [1, 3, 5])
def test_the_corners_of_a_wide_scene_stay_in_their_place(field_points):
    """Where a pinhole throws them, though the field points of the support's corners lie beyond 50°,
    where the model ends. A cell is 12 um."""
    camera = flattened(in_grey(cropped(256, 256, pitch="12.4 um")))
    side = Length.parse("0.2 mm")
    hole = Aperture(shape="rectangle", width=side, height=side)
    mask = camera.mask.model_copy(update={"aperture": hole})
    twin = twin_of(camera.model_copy(update={"mask": mask}))
    field, seen = render_planes(twin, (Plane(torch.ones(1, 4, 4), 80.0, DISTANCE_UM),))
    assert field.source(0, 0, DISTANCE_UM).angle_deg > 51
    place = (torch.arange(256.0) - 127.5) * twin.sensor_pitch_um
    inside = seen[0].radiance[0].nonzero().tolist()
    for row, column in (inside[0], inside[-1], inside[len(inside) // 3]):
        scene = torch.zeros_like(seen[0].radiance)
        scene[0, row, column] = 1
        got = irradiate(
            twin, field, (PlaneView(scene, DISTANCE_UM),), field_points=field_points, light=GREEN
        )
        share = got.light.double() / got.light.double().sum()
        middle = [float((share.sum(dim=axis) * place).sum()) for axis in (1, 0)]
        expected = twin.shift_um(field.source(row, column, DISTANCE_UM))
        assert middle == pytest.approx(expected, abs=3)


def test_one_field_point_is_the_plain_convolution(open_mask):
    """Of the operator that reconstructions use, with the point spread function of the axis."""
    picture = torch.rand(3, 9, 12, generator=torch.Generator().manual_seed(5))
    field, seen = render_planes(open_mask, (Plane(picture, 16.0, DISTANCE_UM),))
    got = irradiate(open_mask, field, seen, field_points=1, light=WHITE, wavelengths=1)
    assert got.field_error is None
    cells = tuple(2 * (n // 2 + max(field.support.height, field.support.width)) for n in (64, 80))
    psf = point_spread(
        open_mask, PointSource(distance_um=DISTANCE_UM), (2 * cells[0], 2 * cells[1]),
        light=WHITE, wavelengths=1,
    )  # fmt: skip

    def binned(planes: Tensor) -> Tensor:
        """Cells as a reconstruction has them: R, the mean of both G, B."""
        red, one, other, blue = (planes[..., k // 2 :: 2, k % 2 :: 2] for k in range(4))
        if planes.ndim == 2:
            return torch.stack([red, (one + other) / 2, blue])
        return torch.stack([red[0], (one[1] + other[1]) / 2, blue[2]])

    operator = CroppedConvolution(binned(psf).double(), open_mask.shape, field.support)
    weights = field.solid_angle() * field.vignetting()
    expected = operator(seen[0].radiance * weights)
    for channel, part in enumerate(binned(got.light)):
        assert relative_error(part, expected[channel]) < 1e-3
        # What a convolution can get wrong is the pattern's place: by one cell, it is far off.
        moved = expected[channel].roll(1, 1)
        assert relative_error(part[:, 1:], moved[:, 1:]) > 5e-3


# --- How well the interpolation does ---------------------------------------------------------


@pytest.fixture(scope="module")
def stars(grey: Twin) -> tuple[FieldMap, Tensor, Tensor]:
    """Forty lit cells in a field of 40°, and their light without interpolation."""
    field = FieldMap.covering(grey, (0.27, 0.36))
    generator = torch.Generator().manual_seed(6)
    scene = _dark(field, 1)
    for place in torch.rand(40, 2, generator=generator).tolist():
        row = int(place[0] * field.support.height)
        column = int(place[1] * field.support.width)
        scene[0, row, column] = 1
    return field, scene, _by_hand(grey, field, scene, DISTANCE_UM)


def test_the_estimate_of_the_error_is_about_right(grey, stars):
    """Within a factor of 2.5 of what patterns of the cells' own give, and four times smaller
    with half the distance."""
    field, scene, expected = stars
    true, estimated = {}, {}
    for points in (1, 3, 5, 9):
        got = irradiate(
            grey, field, (PlaneView(scene, DISTANCE_UM),), field_points=points, light=GREEN
        )
        true[points] = float((got.light - expected).square().mean().sqrt())
        estimated[points] = got.field_error
    assert estimated[1] is None
    for points in (3, 5):
        error = estimated[points]
        assert error is not None
        assert true[points] / 2.5 < error < 2.5 * true[points]
    assert true[3] < 0.7 * true[1]
    assert true[5] == pytest.approx(true[3] / 4, rel=0.5)
    assert true[9] == pytest.approx(true[5] / 4, rel=0.5)
    # Hundredths of the light's variation: much less than photon noise.
    assert true[5] < 0.02 * float(expected.std())


@pytest.mark.parametrize("field_points", [0, 2, 4, -1, -3])
def test_field_points_without_a_middle_are_refused(grey, field_points):
    field = FieldMap.covering(grey, (0.1, 0.1))
    with pytest.raises(OptionError, match="an odd number along each side is needed"):
        irradiate(
            grey, field, (PlaneView(_dark(field, 1), DISTANCE_UM),),
            field_points=field_points, light=GREEN,
        )  # fmt: skip


@pytest.mark.parametrize(
    ("tangents", "field_points"),
    [((0.001, 0.001), 3), ((0.005, 0.01), 9), ((0.012, 0.1), 15), ((0.006, 0.05), 5)],
)
def test_more_field_points_than_cells(grey, tangents, field_points):
    """Fewer are taken; the light is that of many."""
    field = FieldMap.covering(grey, tangents)
    assert min(field.support.height, field.support.width) <= field_points + 1
    scene = torch.rand(_dark(field, 1).shape, generator=torch.Generator().manual_seed(7))
    seen = (PlaneView(scene, DISTANCE_UM),)
    many = irradiate(grey, field, seen, field_points=field_points, light=GREEN)
    few = irradiate(grey, field, seen, field_points=3, light=GREEN)
    assert relative_error(many.light, few.light) < 1e-3
    assert many.field_error is not None


def test_a_dark_scene_gives_no_light(grey):
    field = FieldMap.covering(grey, (0.1, 0.1))
    got = irradiate(
        grey, field, (PlaneView(_dark(field, 1), DISTANCE_UM),), field_points=3, light=GREEN
    )
    assert float(got.light.abs().max()) == 0
    assert got.field_error == 0


def test_scenes_that_need_more_mask_are_refused() -> None:
    twin = twin_of(cropped(64, 64, overhang="0.3 mm"))
    field, seen = render_planes(twin, (Plane(torch.ones(3, 4, 4), 60.0, DISTANCE_UM),))
    with pytest.raises(OptionError, match="give it an overhang of"):
        irradiate(twin, field, seen, field_points=3, light=GREEN)


def test_progress_ends_at_one(grey: Twin) -> None:
    field = FieldMap.covering(grey, (0.05, 0.05))
    scene = _dark(field, 1)
    scene[0, 0, 0] = 1  # Most field points have nothing to do.
    shares: list[float] = []
    note: Callable[[float], None] = shares.append
    seen = PlaneView(scene, 60e3), PlaneView(scene, DISTANCE_UM)
    irradiate(grey, field, seen, field_points=3, light=GREEN, progress=note)
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1)
    assert len(set(shares)) >= 2 * 9
