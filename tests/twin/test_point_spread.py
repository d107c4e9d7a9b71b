"""The pattern of a point source on the paper's camera: the paper's figures, Snell, colours."""

import math
from dataclasses import replace

import pytest
import torch
from cameras import (
    GREEN,
    WHITE,
    cropped,
    in_grey,
    offset,
    reduced_um,
    relative_error,
    snell_um,
    toward,
    twin_of,
)
from torch import Tensor

from nolens.evaluate import pattern_figures
from nolens.optics import (
    Grid,
    Illumination,
    MaskSurface,
    Media,
    PointSource,
    Relief,
    Stack,
    monochromatic_psf,
    random_lenslets,
)
from nolens.quantities import Length
from nolens.twin import Light, Twin, point_spread

PIXEL_UM = 1.55
PINHOLE = PointSource(distance_um=300e3, diameter_um=50.0)
"""The paper's point source: a pinhole of 50 um, 300 mm away."""


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_figures_are_those_of_the_papers_prototype(seed):
    """Autocorrelation 20.15 um wide, pitch 69.75 um; the seed is not what makes them so."""
    twin = twin_of(cropped(1024, 1024, overhang="0.3 mm", seed=seed))
    psf = point_spread(twin, PINHOLE, (1024, 1024), light=WHITE, wavelengths=1)
    figures = pattern_figures(psf.mean(dim=0), PIXEL_UM)
    assert figures.width_um == pytest.approx(20, abs=2)
    assert figures.pitch_um == pytest.approx(70, abs=5)


def test_sharpest_where_eq_5_says():
    """Within the depth of focus, 0.41 mm: t' = R n'/(n' − 1) − n'(t_g/n_g + d_g)."""
    radius, index = 0.67, 1.47
    expected = radius * index / (index - 1) - index * (0.49 / 1.52 + 0.235)
    assert expected == pytest.approx(1.28, abs=0.01)
    twin = twin_of(in_grey(cropped(640, 640, overhang="0.3 mm")))
    resin, *others = twin.camera.layers
    width = {}
    for tenths in range(6, 21, 2):
        thickness = Length.of(tenths / 10, "mm")
        layers = (resin.model_copy(update={"thickness": thickness}), *others)
        other = replace(twin, camera=twin.camera.model_copy(update={"layers": layers}))
        psf = point_spread(other, PINHOLE, (640, 640), light=WHITE, wavelengths=2)
        width[thickness.mm] = pattern_figures(psf[0], PIXEL_UM).width_um
    sharpest = min(width, key=lambda mm: width[mm])
    assert sharpest == pytest.approx(expected, abs=0.41)
    assert width[0.6] > 1.1 * width[sharpest]
    assert width[2.0] > 1.02 * width[sharpest]


# --- Where light falls -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def wide() -> Twin:
    return twin_of(in_grey(cropped(200, 1300, overhang="0.9 mm")))


def _on_sensor(twin: Twin, source: PointSource) -> Tensor:
    cells = twin.camera.sensor.rows, twin.camera.sensor.columns
    return point_spread(twin, source, cells, light=GREEN, frame="sensor")[0]


@pytest.fixture(scope="module")
def straight(wide: Twin) -> Tensor:
    return _on_sensor(wide, PointSource())


@pytest.mark.parametrize(("angle_deg", "azimuth_deg"), [(10, 0), (20, 180), (30, 0)])
def test_image_moves_as_snells_law_has_it(wide, straight, angle_deg, azimuth_deg):
    """To the right if the source is to the right, to the left if it is to the left."""
    moved = offset(_on_sensor(wide, toward(angle_deg, azimuth_deg)), straight)
    expected = math.cos(math.radians(azimuth_deg)) * snell_um(wide.camera, angle_deg)
    assert moved[1] * PIXEL_UM == pytest.approx(expected, abs=max(0.775, 0.01 * abs(expected)))
    assert moved[0] * PIXEL_UM == pytest.approx(0, abs=0.775)


def test_a_source_above_the_axis_has_its_image_above():
    twin = twin_of(in_grey(cropped(700, 500, overhang="0.7 mm")))
    source = toward(15, -60)
    assert source.tangent[0] < 0 < source.tangent[1]
    moved = offset(_on_sensor(twin, source), _on_sensor(twin, PointSource()))
    whole, azimuth = snell_um(twin.camera, 15), math.radians(-60)
    expected = whole * math.sin(azimuth), whole * math.cos(azimuth)
    assert [each * PIXEL_UM for each in moved] == pytest.approx(expected, abs=0.775)


def test_the_frame_of_the_chief_ray_follows_the_image(wide, straight):
    """On the same part of the mask, which is what the chief ray's frame shows."""
    followed = point_spread(wide, toward(20, 0), (200, 400), light=GREEN)[0]
    assert offset(followed, straight[:, 450:850]) == pytest.approx((0, 0), abs=0.1)


def _places(pattern: Tensor, far: Tensor, left: int, width: int) -> float:
    """How far a part of the far source's pattern is moved along the rows, in pixels."""
    template = torch.zeros_like(far)
    window = torch.hann_window(far.shape[0])[:, None] * torch.hann_window(width)
    part = far[:, left : left + width]
    template[:, left : left + width] = (part - part.mean()) * window
    return offset(pattern, template)[1]


def test_near_sources_have_larger_patterns():
    """By 1 + D/z, with D the layers' reduced thickness: the parts left and right of the axis move
    away from each other."""
    twin = twin_of(in_grey(cropped(200, 1300, overhang="0.3 mm")))
    reduced = reduced_um(twin.camera)
    assert reduced == pytest.approx(1278, abs=1.5)

    pattern = {
        distance: point_spread(twin, PointSource(distance_um=distance), (200, 1300), light=GREEN)[0]
        for distance in (80e3, 200e3, math.inf)
    }
    width, left, right = 200, 40, 1060

    def magnification(near: float, far: float) -> float:
        first, last = (_places(pattern[near], pattern[far], at, width) for at in (left, right))
        assert first < 0 < last
        return 1 + (last - first) / (right - left)

    def expected(distance_um: float) -> float:
        return 1 + reduced / distance_um

    for near, far in ((80e3, math.inf), (200e3, math.inf), (80e3, 200e3)):
        wanted = expected(near) / expected(far) - 1
        assert magnification(near, far) - 1 == pytest.approx(wanted, rel=0.05)


# --- Colours and samples ---------------------------------------------------------------------


def test_three_wavelengths_stand_for_the_spectrum():
    """3 against 21: correlation above 0.99 in every channel, and no visible difference."""
    twin = twin_of(cropped(100, 100, overhang="0.5 mm"))
    source = toward(15, 0, 300e3)
    one, few, many = (
        point_spread(twin, source, (100, 100), light=WHITE, wavelengths=count)
        for count in (1, 3, 21)
    )
    for channel in range(3):
        both = torch.stack([few[channel].flatten(), many[channel].flatten()])
        assert float(torch.corrcoef(both)[0, 1]) > 0.99
        error = relative_error(few[channel], many[channel])
        assert error < 2e-3
        assert error < 0.2 * relative_error(one[channel], many[channel])


def test_channels_see_their_own_colours():
    """The light of each channel is that of its mean wavelength, nearly."""
    twin = twin_of(cropped(100, 100, overhang="0.3 mm"))
    psf = point_spread(twin, PointSource(), (100, 100), light=WHITE, wavelengths=1)
    for channel, name in enumerate("RGB"):
        ((nm, _),) = WHITE.wavelengths(twin.quantum_efficiency, name, 1)
        alone = replace(WHITE, name=f"{nm}nm")
        expected = point_spread(twin, PointSource(), (100, 100), light=alone, wavelengths=1)
        assert relative_error(psf[channel], expected[channel]) < 1e-6


@pytest.mark.parametrize("wavelength_nm", [420.0, 680.0])
def test_each_wavelength_has_its_own_indices_and_diffraction(wavelength_nm):
    """Against the pattern of layers whose indices are looked up here."""
    twin = twin_of(in_grey(cropped(100, 100, overhang="0.6 mm")))
    source = toward(20, 10, 300e3)
    indices = twin.camera.indices(wavelength_nm)
    layers = Stack((1060.0, 490.0, 235.0), indices)
    light = Illumination(source, Stack((), ()), layers)
    media = Media(wavelength_nm * 1e-3, 1.0, indices[0])
    grid = Grid(100, 100, PIXEL_UM, twin.shift_um(source)).finer(2)
    fine = monochromatic_psf(light, twin.mask, media, grid, response=twin.response())
    expected = torch.nn.functional.avg_pool2d(fine[None], 2)[0]
    got = point_spread(twin, source, (100, 100), light=Light(f"{wavelength_nm}nm"))[0]
    assert relative_error(got, expected) < 2e-3


def test_half_the_pitch_changes_nothing(monkeypatch):
    """Relief and samples twice as fine: the pixels change by less than 1 % (in fact by 0.1 %)."""
    fine = random_lenslets(
        radius_um=670.0, pitch_um=70.0, smoothing_um=11.0, size_um=(900.0, 900.0),
        grid_um=PIXEL_UM / 2, seed=0,
    ).height_um[:-1, :-1]  # fmt: skip
    assert all(count % 2 for count in fine.shape)  # So the coarse one has the same middle.
    coarse = Relief(fine[::2, ::2].contiguous(), PIXEL_UM)
    twin = replace(twin_of(in_grey(cropped(200, 200, overhang="0.3 mm"))), mask=MaskSurface(coarse))
    source = toward(18, 20, 300e3)
    usual = point_spread(twin, source, (200, 200), light=WHITE, wavelengths=1)

    def twice(twin: Twin, *, at_least: int, **_: float) -> int:
        return 2 * at_least

    def as_it_is(twin: Twin, pitch_um: float, **_: float) -> Twin:
        return twin

    monkeypatch.setattr("nolens.twin.psf.samples_per_pixel", twice)
    monkeypatch.setattr("nolens.twin.psf.sampled", as_it_is)
    finer = replace(twin, mask=MaskSurface(Relief(fine, PIXEL_UM / 2)))
    better = point_spread(finer, source, (200, 200), light=WHITE, wavelengths=1)
    assert 1e-5 < relative_error(usual, better) < 2e-3


def test_cells_are_means_of_their_pixels():
    twin = twin_of(cropped(128, 128, overhang="0.4 mm"))
    source = toward(10, 30, 300e3)
    fine = point_spread(twin, source, (64, 96), light=GREEN)
    cells = point_spread(twin, source, (32, 48), superpixel=2, light=GREEN)
    expected = fine.reshape(3, 32, 2, 48, 2).mean(dim=(2, 4))
    assert relative_error(cells, expected) < 1e-4


def test_progress_ends_at_one():
    twin = twin_of(cropped(64, 64, overhang="0.3 mm"))
    shares: list[float] = []
    point_spread(twin, PointSource(), (32, 32), light=WHITE, wavelengths=2, progress=shares.append)
    assert shares == sorted(shares)
    assert shares == pytest.approx([(k + 1) / 6 for k in range(6)])
