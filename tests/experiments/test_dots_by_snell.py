"""The field of a camera: dots move where Snell's law says, PSFs lose what leaves the sensor."""

import math

import pytest
import torch
from torch import Tensor

from nolens.camera import LoadedCamera
from nolens.errors import DataError, OptionError
from nolens.experiments.dot_grid import (
    Rays,
    angle_between_deg,
    dot_grid,
    grid_tangents,
    locate_grid,
)
from nolens.experiments.off_axis import off_axis, ray_curves
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.files import read_camera
from nolens.twin import Twin, preview_model

PITCH_UM, DISTANCE_UM = 24e3, 300e3
CELL_UM = 3.1


@pytest.fixture(scope="module")
def small() -> LoadedCamera:
    return read_camera("small")


@pytest.fixture(scope="module")
def bare(small: LoadedCamera) -> Twin:
    return preview_model(small, fresnel=False)


@pytest.fixture(scope="module")
def bench(small: LoadedCamera) -> VirtualExperiment:
    return VirtualExperiment.of(small, light="535nm", field_points=3)


def snell_um(tangent: float, twin: Twin) -> float:
    """Σ t tan(asin(sin θ / n)), by hand."""
    camera = twin.camera
    sine = math.sin(math.atan(tangent))
    return sum(
        layer.thickness.um * math.tan(math.asin(sine / index))
        for layer, index in zip(camera.layers, camera.indices(550.0), strict=True)
    )


def drawn(
    twin: Twin, *, side: int = 760, turned_deg: float = 0.0, beside: tuple[float, float] = (0, 0),
    pitch_um: float = PITCH_UM, straight: bool = False, reach_deg: float = 48.0,
) -> Tensor:  # fmt: skip
    """Dots of 1.5 cells deviation where Snell's law puts those of a turned grid, or rays that
    went straight on; as bright as they are."""
    found = torch.zeros(side, side, dtype=torch.float64)
    reduced = sum(
        layer.thickness.um / index
        for layer, index in zip(twin.camera.layers, twin.camera.indices(550.0), strict=True)
    )
    angle = math.radians(turned_deg)
    for row, column in grid_tangents(pitch_um, DISTANCE_UM, 52.0):
        x = column * math.cos(angle) - row * math.sin(angle) + beside[1]
        y = column * math.sin(angle) + row * math.cos(angle) + beside[0]
        reach = math.hypot(x, y)
        if reach > math.tan(math.radians(reach_deg)):
            continue
        length = reduced * reach if straight else snell_um(reach, twin)
        unit = (y / reach, x / reach) if reach > 0 else (0.0, 0.0)
        at = [side // 2 + length * each / CELL_UM for each in unit]
        low = [max(0, int(each) - 8) for each in at]
        rows, columns = (torch.arange(each, min(side, each + 17)).double() for each in low)
        squared = (rows[:, None] - at[0]) ** 2 + (columns - at[1]) ** 2
        cosine = 1 / math.sqrt(1 + reach**2)
        accepted = float(twin.response()(torch.tensor(1 - cosine**2)))
        found[low[0] : low[0] + len(rows), low[1] : low[1] + len(columns)] += (
            cosine**4 * accepted * torch.exp(-squared / 4.5)
        )
    return found


@pytest.mark.parametrize(("turned_deg", "beside"), [(0.0, (0.0, 0.0)), (-12.0, (0.004, -0.011))])
def test_dots_lie_where_snells_law_says(
    bare: Twin, turned_deg: float, beside: tuple[float, float]
) -> None:
    picture = drawn(bare, turned_deg=turned_deg, beside=beside)
    grid = locate_grid(picture, bare, pitch_um=PITCH_UM, distance_um=DISTANCE_UM, extent_deg=47.0)
    assert grid.placement.pitch_mm == pytest.approx(24.0, rel=1e-3)
    assert grid.placement.turned_deg == pytest.approx(turned_deg, abs=0.05)
    assert grid.placement.beside == pytest.approx(beside, abs=1e-3)
    assert len(grid.dots) > 450
    assert {dot.grade for dot in grid.dots} == {"good"}
    assert grid.angles.lost_deg is None and grid.angles.good_deg == pytest.approx(47, abs=1.5)
    for dot in grid.dots:
        assert dot.error_pixels is not None and dot.error_deg is not None and dot.light is not None
        assert dot.error_pixels < 0.1
        assert dot.light == pytest.approx(dot.expected_light, abs=0.05)
        assert dot.width == pytest.approx(1, abs=0.06)
    cell_deg = math.degrees(math.atan(CELL_UM / bare.stack().reduced_um))
    assert grid.pixel_deg == pytest.approx(cell_deg)


def test_rays_that_go_straight_on_are_off_their_places(bare: Twin) -> None:
    """Without refraction a dot at 40° would lie some ten cells further out."""
    picture = drawn(bare, straight=True, side=1000)
    grid = locate_grid(picture, bare, pitch_um=PITCH_UM, distance_um=DISTANCE_UM, extent_deg=47.0)
    for angle in (20, 25):
        dot = min(grid.dots, key=lambda each: abs(each.angle_deg - angle))
        tangent = math.tan(math.radians(dot.angle_deg))
        wrong = (bare.stack().reduced_um * tangent - snell_um(tangent, bare)) / CELL_UM
        # The pose takes up what a larger distance would do as well.
        assert dot.error_pixels is not None and 1 < wrong / 2 < dot.error_pixels < wrong
    assert grid.angles.good_deg is not None and 8 < grid.angles.good_deg < 30


@pytest.mark.parametrize("tangent", [(0.0, 0.0), (0.3, -0.1), (-0.5, 0.9)])
def test_rays(bare: Twin, tangent: tuple[float, float]) -> None:
    """There by Snell's law, back again, and how far apart neighbours are, by small steps."""
    rays = Rays.of(bare, (760, 700))
    (place,) = rays.places([tangent])
    reach = math.hypot(*tangent)
    away = [(at - middle) * CELL_UM for at, middle in zip(place, (380, 350), strict=True)]
    assert math.hypot(*away) == pytest.approx(snell_um(reach, bare), rel=1e-6)
    assert rays.tangents([place])[0] == pytest.approx(tangent, abs=1e-9)
    unit = (tangent[0] / reach, tangent[1] / reach) if reach else (1.0, 0.0)
    steps = []
    for down, right in (unit, (-unit[1], unit[0])):
        (near,) = rays.places([(tangent[0] + 1e-5 * down, tangent[1] + 1e-5 * right)])
        steps.append(math.dist(near, place) / 1e-5)
    assert rays.spacings([tangent], 0.05)[0] == pytest.approx(0.05 * min(steps), rel=1e-3)


def test_angle_between_rays() -> None:
    one, other = (0.0, math.tan(math.radians(20))), (0.0, math.tan(math.radians(-25)))
    assert angle_between_deg(one, other) == pytest.approx(45)
    assert angle_between_deg((0.0, 1.0), (1.0, 0.0)) == pytest.approx(60)


@pytest.mark.parametrize("pitch_um", [17e3, 32e3])
def test_another_pitch_is_named(bare: Twin, pitch_um: float) -> None:
    picture = drawn(bare, pitch_um=pitch_um)
    with pytest.raises(DataError, match=r"lie (17|32|31.9) mm apart at 300 mm, not 24"):
        locate_grid(picture, bare, pitch_um=PITCH_UM, distance_um=DISTANCE_UM)


def test_no_grid_is_refused(bare: Twin) -> None:
    with pytest.raises(DataError, match="empty"):
        locate_grid(torch.zeros(300, 300), bare, pitch_um=PITCH_UM, distance_um=DISTANCE_UM)
    one = torch.zeros(300, 300)
    one[150, 150] = 1
    with pytest.raises(DataError, match="has 1 bright dots"):
        locate_grid(one, bare, pitch_um=PITCH_UM, distance_um=DISTANCE_UM)
    with pytest.raises(OptionError, match="they need 2 or more"):
        locate_grid(one, bare, pitch_um=1e3, distance_um=DISTANCE_UM)
    with pytest.raises(OptionError, match="only one"):
        grid_tangents(PITCH_UM, DISTANCE_UM, 2.0)
    with pytest.raises(OptionError, match="more than"):
        grid_tangents(1e3, DISTANCE_UM, 50.0)


def test_simulated_grid(bench: VirtualExperiment) -> None:
    """Scene, noise and reconstruction: dots within a fifth of a cell of Snell's law."""
    grid = dot_grid(bench, pitch_um=15e3, distance_um=DISTANCE_UM, extent_deg=9.8, iterations=60)
    assert len(grid.dots) == 37 and grid.angles.lost_deg is None
    assert grid.simulated_psfs == 3 and grid.field_error is not None
    assert 0.3 < grid.field_error["of_noise"] < 0.6
    assert len(grid.warnings) == 1 and "try --simulated-psfs 5" in grid.warnings[0]
    assert grid.placement.pitch_mm == pytest.approx(15, rel=5e-3)
    assert abs(grid.placement.turned_deg) < 0.3
    middle = grid.picture.shape[0] // 2
    for dot in grid.dots:
        assert dot.position is not None and dot.light is not None and dot.grade == "good"
        away = [(at - middle) * CELL_UM for at in dot.position]
        reach = snell_um(math.tan(math.radians(dot.angle_deg)), bench.twin)
        assert math.hypot(*away) == pytest.approx(reach, abs=0.2 * CELL_UM)
        assert dot.light == pytest.approx(dot.expected_light, abs=0.15)


def test_off_axis(bench: VirtualExperiment) -> None:
    """Overlap and shift by Snell's law; light that the sensor loses as it leaves."""
    angles = [0.0, 4.0, 10.0]
    found = off_axis(bench, angles, distance_um=DISTANCE_UM, seed=3)
    assert [each.angle_deg for each in found] == pytest.approx(angles)
    height, width = (cells * CELL_UM for cells in bench.twin.shape)
    for each in found:
        moved = snell_um(math.tan(math.radians(each.angle_deg)), bench.twin)
        assert each.expected_shift_um == pytest.approx(moved, rel=1e-3)
        assert each.shift_um == pytest.approx(moved, abs=3)
        assert each.overlap_width == pytest.approx(1 - moved / width, rel=1e-3)
        assert each.overlap_height == pytest.approx(1 - moved / height, rel=1e-3)
        assert each.correlation_overlap > 0.98
    assert found[0].correlation > 0.99 and found[0].light == pytest.approx(1, abs=1e-6)
    assert found[2].correlation < 0.85 < found[1].correlation
    for each in found[:2]:
        # The pattern is still whole, so its norm is as its light.
        assert each.light is not None and each.correlation_one_exposure is not None
        exposed = each.correlation * each.light
        assert each.correlation_one_exposure == pytest.approx(exposed, abs=0.05)
    # At 4 deg light is lost by angle alone.
    assert found[1].light == pytest.approx(found[1].expected_light, rel=0.03)
    cosine = math.cos(math.radians(4))
    accepted = float(bench.twin.response()(torch.tensor(1 - cosine**2)))
    assert found[1].expected_light == pytest.approx(cosine**3 * accepted, rel=1e-6)
    curves = ray_curves(bench.twin, 4.0, DISTANCE_UM)
    assert len(curves["angle_deg"]) > 20 and curves["angle_deg"][-1] == pytest.approx(4.0)
    assert curves["light"][-1] == pytest.approx(found[1].expected_light, rel=1e-6)
    assert curves["overlap_height"][-1] == pytest.approx(found[1].overlap_height, rel=1e-6)
    with pytest.raises(OptionError, match="beyond the model"):
        off_axis(bench, [0.0, 55.0])


def test_noise_has_a_seed(bench: VirtualExperiment) -> None:
    one, again, other = (off_axis(bench, [6.0], seed=seed)[0].correlation for seed in (1, 1, 2))
    assert one == again != other
