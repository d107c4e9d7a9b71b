"""The pattern of a point source: its place, its size, its brightness, and how it is cut."""

import math
from dataclasses import replace

import pytest
import torch
from optical_bench import (
    GLASS,
    MEDIA,
    NOTHING,
    PAPER,
    RESIN,
    WAVELENGTH_UM,
    Pair,
    Way,
    caps,
    centroid_um,
    places_um,
    relative_error,
    snell_um,
)
from torch import Tensor

from nolens.optics import (
    Grid,
    Illumination,
    MaskSurface,
    Media,
    Opening,
    PointSource,
    Relief,
    Stack,
    divergence,
    monochromatic_psf,
    random_lenslets,
    transmittance,
)

PITCH_UM = 1.55
FILM = Stack((300.0,), (RESIN,))
FLAT = MaskSurface(Relief(torch.zeros(3, 3), PITCH_UM))
INFINITE = math.inf


def _papers_mask(size_um: float, grid_um: float) -> Relief:
    return random_lenslets(
        radius_um=670,
        pitch_um=70,
        smoothing_um=11,
        size_um=(size_um, size_um),
        grid_um=grid_um,
        seed=1,
    )


@pytest.fixture(scope="module")
def fine() -> Relief:
    """The paper's mask on a grid of a quarter of a pixel, of 48 n + 1 samples."""
    relief = _papers_mask(1000.0, PITCH_UM / 4)
    side = (min(relief.height_um.shape) - 1) // 48 * 48 + 1
    return Relief(relief.height_um[:side, :side].contiguous(), relief.grid_um)


def _every(relief: Relief, step: int) -> Relief:
    """The same surface by every so many samples, about the same middle."""
    return Relief(relief.height_um[::step, ::step].contiguous(), relief.grid_um * step)


@pytest.fixture(scope="module")
def mask() -> MaskSurface:
    """The same on a grid of one pixel, and so wide that no window reaches its edges."""
    return MaskSurface(_papers_mask(2000.0, PITCH_UM))


def _below(way: Way) -> Pair:
    """Where light that passes the middle of the mask arrives."""
    return way.along(snell_um(PAPER, way.angle_deg))


def _pixels(pattern: Tensor, samples: int) -> Tensor:
    """Means over squares of so many samples."""
    rows, columns = (n // samples for n in pattern.shape)
    return pattern.double().view(rows, samples, columns, samples).mean((1, 3))


# --- brightness


@pytest.mark.parametrize("distance_um", [1e3, 3e5, INFINITE])
@pytest.mark.parametrize("way", [Way(0), Way(30, 37), Way(50, -120)], ids=str)
def test_flat_mask(way, distance_um):
    """cos³ of the local ray, spread over the sensor as the rays diverge: to 4e-4 everywhere."""
    grid = Grid(120, 180, PITCH_UM / 2, (100.0, -50.0))
    light = way.light(distance_um)
    flat = MaskSurface(Relief(torch.zeros(2, 2), PITCH_UM / 2))
    got = monochromatic_psf(light, flat, MEDIA, grid).double()
    if math.isinf(distance_um):
        expected = torch.full_like(got, math.cos(math.radians(way.angle_deg)) ** 3)
    else:
        start = light.source.origin_um()
        reach = torch.hypot(
            grid.positions_um(0)[:, None] - start[0], grid.positions_um(1) - start[1]
        )
        air = Stack((distance_um,), (1.0,))
        p = air.then(PAPER).ray(reach)
        # A ring of radius r and width dr on the mask becomes one of r' and dr' on the sensor.
        at_mask, per_p = air.displacement_um(p), air.spread_um(p)
        ring = at_mask * per_p / (reach * (per_p + PAPER.spread_um(p)))
        expected = (1 - p.square()).pow(1.5) * ring
    assert float((got / expected - 1).abs().max()) < 4e-4


def test_near_source_loses_what_its_light_spreads():
    """Straight ahead: 1 / (1 + D/z)², D the layers' reduced length."""
    for distance_um in (1e4, 1e5):
        got = monochromatic_psf(Way(0).light(distance_um), FLAT, MEDIA, Grid(1, 1, PITCH_UM))
        expected = (1 + PAPER.reduced_um / distance_um) ** -2
        assert float(got[0, 0]) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("distance_um", [1e4, 3e5])
def test_layers_before_the_mask_spread_the_light_like_those_behind(distance_um):
    """Straight ahead: 1 / (1 + D/z)² with D of all layers."""
    media = Media(WAVELENGTH_UM, RESIN, RESIN)
    light = Illumination(PointSource(distance_um=distance_um), FILM, PAPER)
    got = float(monochromatic_psf(light, FLAT, media, Grid(1, 1, PITCH_UM)))
    length = FILM.then(PAPER).reduced_um
    assert got == pytest.approx((1 + length / distance_um) ** -2, rel=6e-4)


@pytest.mark.parametrize("way", [Way(0), Way(45, 15)], ids=str)
def test_lenslets_only_move_light(way, mask):
    """All that falls into an opening arrives: its area times cos³θ, to 1 %.

    The opening's edges diffract 0.5 % beyond the band that is kept.
    """
    open_mask = replace(mask, opening=Opening("ellipse", 180.0, 240.0))
    got = monochromatic_psf(way.light(), open_mask, MEDIA, Grid(400, 420, PITCH_UM, _below(way)))
    area = math.pi / 4 * 180 * 240
    light = float(got.double().sum()) * PITCH_UM**2
    assert light == pytest.approx(area * math.cos(math.radians(way.angle_deg)) ** 3, rel=1e-2)


def test_response_and_surfaces_scale_the_light():
    way = Way(40, 60)
    grid = Grid(9, 8, PITCH_UM)
    plain = monochromatic_psf(way.light(), FLAT, MEDIA, grid)
    weighted = monochromatic_psf(way.light(), FLAT, MEDIA, grid, response=lambda p2: 1 - p2)
    torch.testing.assert_close(weighted, plain * (1 - way.p**2), rtol=1e-5, atol=0)
    indices = (1.0, RESIN, GLASS, 1.0)
    lossy = monochromatic_psf(way.light(), FLAT, replace(MEDIA, surfaces=indices), grid)
    passed = float(transmittance(indices, torch.tensor(way.p**2, dtype=torch.float64)))
    assert passed < 0.94
    # The flat pattern ripples by 2e-4 from the fading at the window's edges.
    torch.testing.assert_close(lossy, plain * passed, rtol=1e-4, atol=0)


# --- place and size


@pytest.mark.parametrize("way", [Way(10, 25), Way(30, -160), Way(50, 90)], ids=str)
def test_spot_lies_where_snells_law_says(way):
    """A lenslet of 60 µm: its brightest sample within one sample, its middle within 0.15 µm."""
    place = _below(way)
    centre = tuple(round(each / PITCH_UM) * PITCH_UM for each in place)
    grid = Grid(121, 121, PITCH_UM, (centre[0], centre[1]))
    lenslet = MaskSurface(caps(501, PITCH_UM, 670.0, 60.0, [(0.0, 0.0)]))
    pattern = monochromatic_psf(way.light(), lenslet, MEDIA, grid)
    row, column = divmod(int(pattern.argmax()), 121)
    brightest = grid.positions_um(0)[row], grid.positions_um(1)[column]
    assert float(pattern.max()) > 2 * float(pattern.median())
    for got, middle, expected in zip(
        brightest, centroid_um(pattern, grid, place, 60.0), place, strict=True
    ):
        assert abs(float(got) - expected) <= PITCH_UM
        assert middle == pytest.approx(expected, abs=0.15)


@pytest.mark.parametrize("before", [NOTHING, FILM], ids=["bare", "film"])
@pytest.mark.parametrize("distance_um", [1e4, 3e4, 3e5])
def test_near_source_magnifies_the_pattern(distance_um, before):
    """By 1 + D/z: the spots of two lenslets, to 2e-4."""
    pair = MaskSurface(caps(701, PITCH_UM, 670.0, 120.0, [(0.0, -200.0), (0.0, 200.0)]))
    grid = Grid(101, 421, PITCH_UM)
    pattern = monochromatic_psf(Way(0).light(distance_um, before), pair, MEDIA, grid)
    expected = 1 + PAPER.reduced_um / (distance_um + before.reduced_um)
    spots = [centroid_um(pattern, grid, (0.0, side * 200 * expected), 60.0) for side in (-1, 1)]
    assert (spots[1][1] - spots[0][1]) / 400 == pytest.approx(expected, rel=2e-4)
    assert [spot[0] for spot in spots] == pytest.approx([0, 0], abs=0.02)


@pytest.mark.parametrize("distance_um", [2e3, INFINITE])
def test_source_in_a_medium(distance_um, mask):
    """Optical paths in wavelengths say it all: indices times n are a wavelength n times longer."""
    n, source, grid = 1.33, PointSource((0.2, -0.3), distance_um), Grid(48, 64, PITCH_UM)

    def pattern(scale: float) -> Tensor:
        before, after = (
            Stack(each.thicknesses_um, tuple(scale * index for index in each.indices))
            for each in (FILM, PAPER)
        )
        media = Media(WAVELENGTH_UM * scale, scale * RESIN, scale * GLASS)
        return monochromatic_psf(Illumination(source, before, after, scale), mask, media, grid)

    assert relative_error(pattern(n), pattern(1.0)) < 1e-4


@pytest.mark.parametrize("slope", [0.01, -0.01])
@pytest.mark.parametrize("angle_deg", [0, 20, 40, 50])
def test_wedge_turns_light_as_its_facet_refracts(angle_deg, slope):
    """Snell's law in three dimensions at a tilted facet, and then through the layers.

    A phase of (n' − 1)·h would miss by 1.7 µm at 40°.
    """
    way = Way(angle_deg)
    columns = places_um(301, PITCH_UM)
    wedge = Relief((slope * columns).float().expand(301, -1).contiguous(), PITCH_UM)
    # In the plane of the columns and of the axis towards the sensor.
    normal = [slope / math.hypot(1, slope), 1 / math.hypot(1, slope)]
    ray = [way.p, math.sqrt(1 - way.p**2)]
    into = ray[0] * normal[0] + ray[1] * normal[1]
    out = math.sqrt(RESIN**2 - 1 + into**2)
    turned = way.p + (out - into) * normal[0]
    expected = math.copysign(
        float(PAPER.displacement_um(torch.tensor(abs(turned), dtype=torch.float64))), turned
    )
    straight = _below(way)[1]
    assert abs(expected - straight) > 5

    surface = MaskSurface(wedge, Opening("ellipse", 150.0, 150.0))
    grid = Grid(301, 301, PITCH_UM, (0.0, straight))
    pattern = monochromatic_psf(way.light(), surface, MEDIA, grid).double()
    got = float((pattern.sum(0) * grid.positions_um(1)).sum() / pattern.sum())
    assert got == pytest.approx(expected, abs=0.3)


@pytest.mark.parametrize("slope", [0.4, -0.4])
def test_steep_relief_loses_no_light(slope):
    """Light that is turned by 11° is followed to where it lands, and none is cut off."""
    pitch = PITCH_UM / 2
    columns = places_um(601, pitch)
    wedge = Relief((slope * columns).float().expand(601, -1).contiguous(), pitch)
    surface = MaskSurface(wedge, Opening("ellipse", 160.0, 160.0))
    turned = slope * (RESIN - 1)
    reach = float(PAPER.displacement_um(torch.tensor(abs(turned), dtype=torch.float64)))
    grid = Grid(500, 500, pitch, (0.0, math.copysign(reach, slope)))
    pattern = monochromatic_psf(Way(0).light(), surface, MEDIA, grid).double()
    light = float(pattern.sum()) * pitch**2
    assert light == pytest.approx(math.pi / 4 * 160**2, rel=1e-2)
    middle = float((pattern.sum(0) * grid.positions_um(1)).sum() / pattern.sum())
    assert middle == pytest.approx(grid.centre_um[1], abs=0.5)


def test_pattern_moves_with_the_mask(mask):
    """A mask that is moved by whole samples: the same pattern, so far to the side."""
    relief = mask.relief
    moved = Relief(relief.height_um.roll((5, -8), (0, 1)), relief.grid_um)
    grid = Grid(60, 70, PITCH_UM)
    there = replace(grid, centre_um=(5 * PITCH_UM, -8 * PITCH_UM))
    first = monochromatic_psf(Way(0).light(), mask, MEDIA, grid)
    second = monochromatic_psf(Way(0).light(), MaskSurface(moved), MEDIA, there)
    assert relative_error(second, first) < 1e-5


@pytest.mark.parametrize("counts", [(300, 301), (301, 300)])
def test_samples_of_the_relief_may_be_of_any_number(counts):
    """A lenslet that falls between the samples gives the pattern of one on a sample."""

    def pattern(rows: int, columns: int) -> Tensor:
        grid = Grid(rows, columns, PITCH_UM)
        squared = grid.positions_um(0)[:, None].square() + grid.positions_um(1).square()
        height = torch.exp(-squared / (2 * 25.0**2)).float()
        return monochromatic_psf(
            Way(20, 30).light(),
            MaskSurface(Relief(height, PITCH_UM)),
            MEDIA,
            Grid(80, 80, PITCH_UM, _below(Way(20, 30))),
        )

    assert relative_error(pattern(*counts), pattern(301, 301)) < 1e-3


@pytest.mark.parametrize("way", [Way(0), Way(15, -40), Way(50, 10), Way(50, 190)], ids=str)
def test_surface_is_level_beyond_its_edges(way):
    """Windows partly or wholly beside a small relief see its outermost samples go on."""
    height = torch.randn(40, 51, generator=torch.Generator().manual_seed(3)) * 0.02
    padded = torch.nn.functional.pad(height[None, None], (900,) * 4, mode="replicate")[0, 0]
    grid = Grid(90, 100, PITCH_UM, (30.0, -20.0))
    small, large = (
        monochromatic_psf(way.light(), MaskSurface(Relief(each, PITCH_UM)), MEDIA, grid)
        for each in (height, padded.contiguous())
    )
    assert torch.equal(small, large)


def test_far_source_is_a_plane_wave(mask):
    """100 m away. It still magnifies by 1.3e-5, which moves the corners by 3 nm."""
    for way in (Way(0), Way(30, 25)):
        grid = Grid(200, 240, PITCH_UM, _below(way))
        far, infinite = (
            monochromatic_psf(way.light(each), mask, MEDIA, grid) for each in (1e8, INFINITE)
        )
        assert relative_error(far, infinite) < 3.2e-4


# --- windows and sampling


@pytest.mark.parametrize("distance_um", [1e4, 3e5, INFINITE])
@pytest.mark.parametrize("way", [Way(0), Way(45, 20)], ids=str)
def test_windows_agree_with_one(way, distance_um, mask, monkeypatch):
    grid = Grid(300, 360, PITCH_UM, _below(way))
    patterns, parts = [], []
    for largest in (3072, 200):
        monkeypatch.setattr("nolens.optics.psf._LARGEST", largest)
        done: list[float] = []
        light = way.light(distance_um)
        patterns.append(monochromatic_psf(light, mask, MEDIA, grid, progress=done.append))
        assert done == sorted(done)
        assert done[-1] == 1
        parts.append(len(done))
    assert parts == [1, 4]
    assert relative_error(patterns[1], patterns[0]) < 5e-5


@pytest.mark.parametrize("way", [Way(0), Way(45, 90)], ids=str)
def test_wider_margin_changes_little(way, mask, monkeypatch):
    """Light from twice as far around, and diffracted twice as far, is not missed."""
    grid = Grid(120, 140, PITCH_UM, _below(way))
    usual = monochromatic_psf(way.light(), mask, MEDIA, grid)
    monkeypatch.setattr("nolens.optics.psf._FRESNEL_WIDTHS", 6.0)
    wide = monochromatic_psf(way.light(), mask, MEDIA, grid)
    assert relative_error(usual, wide) < 4e-5


@pytest.mark.parametrize("distance_um", [1e4, INFINITE])
@pytest.mark.parametrize("way", [Way(0), Way(40, 65)], ids=str)
def test_finer_sampling_changes_no_pixel(way, distance_um, fine):
    """Of 1.55 µm, by 2 × 2 or 4 × 4 samples, and reliefs of 1.55 µm to 0.39 µm."""
    light = way.light(distance_um)

    def pixels(step: int, samples: int) -> Tensor:
        grid = Grid(160, 170, PITCH_UM, _below(way)).finer(samples)
        surface = MaskSurface(_every(fine, step))
        return _pixels(monochromatic_psf(light, surface, MEDIA, grid), samples)

    best = pixels(1, 4)
    # The light's own structure, that 2 × 2 samples miss.
    assert relative_error(pixels(2, 2), best) < 1.2e-3
    assert relative_error(pixels(4, 2), best) < 1.2e-3
    # The relief's, at the same samples.
    assert relative_error(pixels(4, 4), best) < 8e-5


@pytest.mark.parametrize(("distance_um", "steps"), [(1e4, 4), (3e5, 8), (INFINITE, 8)])
def test_coarsest_relief_that_is_allowed_is_fine_enough(distance_um, steps, fine):
    """Steps of half a pixel: 3.1 µm near by, and 6.2 µm farther away."""
    pitch = PITCH_UM / 2
    coarse, best = (MaskSurface(_every(fine, step)) for step in (2 * steps, 2))
    coupling = float(MEDIA.coupling(torch.zeros((), dtype=torch.float64)))
    limit = best.coarsest_pitch_um(WAVELENGTH_UM, coupling, divergence(pitch, distance_um))
    assert limit / 1.5 < coarse.relief.grid_um <= limit
    grid = Grid(200, 216, pitch)
    got, expected = (
        monochromatic_psf(Way(0).light(distance_um), each, MEDIA, grid) for each in (coarse, best)
    )
    assert relative_error(got, expected) < 6e-4


@pytest.mark.parametrize("distance_um", [1e4, INFINITE])
@pytest.mark.parametrize("way", [Way(0), Way(40, 65)], ids=str)
def test_finer_samples_contain_the_coarse_ones(way, distance_um, mask):
    light, centre = way.light(distance_um), _below(way)
    coarse = monochromatic_psf(light, mask, MEDIA, Grid(121, 141, PITCH_UM, centre))
    for n in (2, 3):
        grid = Grid(120 * n + 1, 140 * n + 1, PITCH_UM / n, centre)
        assert relative_error(monochromatic_psf(light, mask, MEDIA, grid)[::n, ::n], coarse) < 1e-4


def test_coupling_is_the_difference_of_the_axial_paths():
    """n' cos θ' − n cos θ; without the relief's media differing there is no pattern."""
    for way in (Way(0), Way(40)):
        squared = torch.tensor(way.p**2, dtype=torch.float64)
        inside = math.asin(way.p / RESIN)
        expected = RESIN * math.cos(inside) - math.cos(math.radians(way.angle_deg))
        assert float(MEDIA.coupling(squared)) == pytest.approx(expected, rel=1e-12)
    matched = Media(WAVELENGTH_UM, RESIN, RESIN)
    lenslet = MaskSurface(caps(101, PITCH_UM, 670.0, 60.0, [(0.0, 0.0)]))
    pattern = monochromatic_psf(Way(0).light(), lenslet, matched, Grid(40, 40, PITCH_UM))
    torch.testing.assert_close(pattern, torch.ones(40, 40), rtol=0, atol=4e-4)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device here")
@pytest.mark.parametrize("distance_um", [1e4, INFINITE])
def test_pattern_on_cuda(distance_um, mask):
    """The same to float32, with every option, and on the relief's device."""
    way = Way(40, 25)
    media = replace(MEDIA, surfaces=(1.0, RESIN, GLASS, 1.0))
    grid = Grid(240, 260, PITCH_UM / 2, _below(way))
    opening = Opening("ellipse", 300.0, 250.0)
    patterns = [
        monochromatic_psf(
            way.light(distance_um),
            MaskSurface(Relief(mask.relief.height_um.to(device), PITCH_UM), opening),
            media,
            grid,
            response=lambda squared: 1 - squared,
        )
        for device in ("cpu", "cuda")
    ]
    assert patterns[1].device.type == "cuda"
    assert relative_error(patterns[1].cpu(), patterns[0]) < 1e-4
