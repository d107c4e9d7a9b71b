"""A camera made ready: what it refuses, how large sources blur, and what surfaces reflect."""

import math
import re
from dataclasses import replace
from itertools import pairwise

import pytest
import torch
from cameras import (
    GREEN,
    GREEN_NM,
    cropped,
    flattened,
    in_grey,
    reduced_um,
    relative_error,
    snell_um,
    toward,
    twin_of,
)
from torch import Tensor

from nolens.camera import Aperture, Camera, LoadedCamera, ReliefFile, preset
from nolens.errors import OptionError
from nolens.optics import Grid, PointSource
from nolens.quantities import Length
from nolens.twin import Twin, point_spread, polychromatic_psf

# --- Refusals ---------------------------------------------------------------------------------


def _named(refused: pytest.ExceptionInfo[OptionError], pattern: str) -> float:
    found = re.search(pattern, str(refused.value))
    assert found is not None
    return float(found[1])


@pytest.mark.parametrize("radius", ["0.67 mm", "0.15 mm"])
@pytest.mark.parametrize("grid", ["6.2 µm", "12 µm", "20 µm"])
def test_a_coarse_relief_is_refused_with_a_pitch_that_works(grid, radius):
    """Finer samples show steeper slopes; the pitch that is named has to allow for that."""
    camera = cropped(128, 160, overhang="0.3 mm", grid=grid, radius=radius)
    with pytest.raises(OptionError, match=f"every {grid}, too coarse") as refused:
        twin_of(camera)
    named = _named(refused, r"a grid of ([0-9.]+) µm or finer would do")
    twin = twin_of(cropped(128, 160, overhang="0.3 mm", grid=f"{named} um", radius=radius))
    assert twin.mask.relief.grid_um == named
    # Nor is it so fine that it wastes work: twice would be too coarse.
    with pytest.raises(OptionError, match="too coarse"):
        twin_of(cropped(128, 160, overhang="0.3 mm", grid=f"{2 * named:g} um", radius=radius))


def test_the_presets_relief_is_fine_enough():
    for name in ("paper", "small"):
        twin = twin_of(cropped(128, 128, of=name))
        assert twin.mask.relief.grid_um == 1.55 < twin.coarsest_pitch_um()


def test_four_samples_to_the_fastest_turn():
    """Of the phase that a slope gives light of 400 nm at 50°: (n' cos θ' − cos θ)·slope/λ turns
    in a um."""
    twin = twin_of(cropped(128, 128, overhang="0.1 mm"))
    index = twin.camera.indices(400.0)[0]
    sine = math.sin(math.radians(50))
    coupling = math.sqrt(index**2 - sine**2) - math.cos(math.radians(50))
    expected = 0.4 / (4 * coupling * twin.mask.relief.steepest)
    assert twin.coarsest_pitch_um() == pytest.approx(expected, rel=1e-6)


def _check(camera: Camera, source: PointSource, cells: int) -> None:
    twin_of(camera).check_extent(source, Grid(cells, cells, 1.55))


@pytest.mark.parametrize(
    ("angle_deg", "azimuth_deg", "distance_um"),
    [(5, 0, math.inf), (25, 200, 300e3), (35, 45, math.inf), (45, 200, 20e3), (50, 200, math.inf)],
)
def test_too_little_overhang_is_refused_with_one_that_works(angle_deg, azimuth_deg, distance_um):
    source = toward(angle_deg, azimuth_deg, distance_um)
    with pytest.raises(OptionError, match="beyond the sensor") as refused:
        _check(cropped(64, 64, overhang="0.02 mm"), source, 64)
    named = _named(refused, r"an overhang of ([0-9.]+) mm or more")
    _check(cropped(64, 64, overhang=f"{named} mm"), source, 64)
    # Nor is it much too large: with 0.2 mm less, light would pass beyond the relief.
    if named > 0.25:
        with pytest.raises(OptionError, match="beyond the sensor"):
            _check(cropped(64, 64, overhang=f"{named - 0.2:.2f} mm"), source, 64)
    # The chief ray alone reaches so far.
    along = max(abs(math.sin(math.radians(azimuth_deg))), abs(math.cos(math.radians(azimuth_deg))))
    camera = cropped(64, 64)
    assert named * 1e3 > 0.9 * along * snell_um(camera, angle_deg)


def test_overhang_is_counted_from_the_sensors_edge():
    """Ten times as many pixels need about the same."""
    named = []
    for pixels in (64, 640):
        with pytest.raises(OptionError, match="beyond the sensor") as refused:
            _check(cropped(pixels, pixels, overhang="0.02 mm"), toward(30, 20), pixels)
        named.append(_named(refused, r"an overhang of ([0-9.]+) mm or more"))
    assert named[1] == pytest.approx(named[0], abs=0.1)


def test_wider_patterns_need_more_overhang():
    """What lies beside the sensor counts from the sensor's edge."""
    camera, source = cropped(64, 64, overhang="0.3 mm"), toward(5)
    _check(camera, source, 64)
    with pytest.raises(OptionError, match="beyond the sensor"):
        _check(camera, source, 400)


def test_point_spread_checks_its_reach():
    twin = twin_of(cropped(64, 64, overhang="0.2 mm"))
    point_spread(twin, PointSource(), (64, 64), light=GREEN)
    with pytest.raises(OptionError, match="give it an overhang"):
        point_spread(twin, toward(20), (64, 64), light=GREEN, frame="sensor")
    # Around the chief ray's foot, the light has come through the middle.
    point_spread(twin, toward(20), (64, 64), light=GREEN)


@pytest.mark.parametrize("kind", ["aperture", "flat"])
def test_cameras_whose_light_ends_by_itself_are_not_refused(kind):
    camera = cropped(64, 64, of="small") if kind == "aperture" else flattened(cropped(64, 64))
    twin = twin_of(camera)
    twin.check_extent(toward(50), Grid(2000, 2000, 1.55))
    dark = point_spread(twin, toward(50), (64, 64), light=GREEN, frame="sensor")
    expected = 0.32 * math.cos(math.radians(50)) ** 3 if kind == "flat" else 0.0
    assert float(dark.mean()) == pytest.approx(expected, abs=2e-3)


def test_sources_beyond_the_model():
    twin = twin_of(flattened(cropped(64, 64)))

    def spread(source: PointSource) -> Tensor:
        return point_spread(twin, source, (16, 16), light=GREEN)

    for azimuth in (0, 90, 225):
        spread(toward(50, azimuth))
        with pytest.raises(OptionError, match=r"50\.1 deg off the axis is beyond the model"):
            spread(toward(50.1, azimuth))
    spread(PointSource(distance_um=1e3))
    with pytest.raises(OptionError, match=r"a distance of 0\.99 mm .* choose 1 mm or more"):
        spread(PointSource(distance_um=0.99e3))
    with pytest.raises(OptionError, match="a source at infinity has no diameter"):
        spread(PointSource(diameter_um=50.0))
    with pytest.raises(OptionError, match="must be 0 µm"):
        spread(PointSource(distance_um=300e3, diameter_um=-1.0))


# --- Parts -------------------------------------------------------------------------------------


def test_reading_fewer_pixels_keeps_the_mask():
    """The middle of the same pattern."""
    twin = twin_of(cropped(200, 260, overhang="0.3 mm"))
    part = twin.reading(100, 120)
    assert (part.camera.sensor.rows, part.camera.sensor.columns) == (100, 120)
    assert part.shape == (50, 60)
    assert part.mask is twin.mask
    source = toward(5, 30, 300e3)
    whole = point_spread(twin, source, (200, 260), light=GREEN, frame="sensor")
    middle = point_spread(part, source, (100, 120), light=GREEN, frame="sensor")
    assert relative_error(middle, whole[:, 50:150, 70:190]) < 1e-3


def test_a_relief_of_a_file_lies_over_the_middle():
    """A lenslet at a quarter of the surface focuses there, and rows are rows."""
    camera = cropped(128, 128)
    relief = ReliefFile(kind="file", file="relief.tif", grid=Length.parse("1.55 um"))
    camera = camera.model_copy(
        update={"mask": camera.mask.model_copy(update={"relief": relief, "aperture": None})}
    )
    rows, columns = torch.arange(400.0)[:, None] - 199.5, torch.arange(440.0) - 219.5
    away = (rows + 40).square() + (columns - 30).square()  # 40 samples up, 30 to the right.
    heights = (35**2 - away).clamp_min(0) * 1.55**2 / (2 * 670.0)
    bare = LoadedCamera.of(flattened(camera))
    twin = Twin.of(
        LoadedCamera(camera, bare.quantum_efficiency, bare.acceptance, heights.contiguous())
    )
    psf = point_spread(twin, PointSource(), (128, 128), light=GREEN)[1]
    row, column = divmod(int(psf.argmax()), 128)
    assert (row - 63.5, column - 63.5) == pytest.approx((-40, 30), abs=1)


def test_layers_above_the_mask_are_passed_first():
    """A film at a distance in front of the cover glass: its place on the sensor is that of all."""
    twin = twin_of(in_grey(cropped(64, 64, of="paper-film", overhang="0.6 mm")))
    source = toward(20, 30)
    moved = twin.shift_um(source)
    expected = snell_um(twin.camera, 20)
    assert math.hypot(*moved) == pytest.approx(expected, rel=1e-6)
    assert math.atan2(*moved) == pytest.approx(math.radians(30))
    below = flattened(twin.camera).model_copy(
        update={"mask": twin.camera.mask.model_copy(update={"surface": 1})}
    )
    light = twin_of(below).illumination(source, GREEN_NM)
    assert light.before.thicknesses_um == (305.0,)
    assert light.after.thicknesses_um == (400.0, 490.0, 235.0)
    media = twin_of(below, fresnel=True).media(GREEN_NM)
    film, _, glass, _ = twin.camera.indices(GREEN_NM)
    assert (media.above, media.below) == (film, 1.0)
    assert media.surfaces == (1.0, film, 1.0, glass, 1.0)
    assert media.wavelength_um == pytest.approx(0.55)
    assert twin.media(GREEN_NM).surfaces == ()


# --- Sources with a size ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pinhole() -> Twin:
    """No lenslets, and a hole of 0.1 mm."""
    camera = flattened(in_grey(preset("small")))
    hole = Aperture(shape="ellipse", width=Length.parse("0.1 mm"), height=Length.parse("0.1 mm"))
    mask = camera.mask.model_copy(update={"aperture": hole})
    return twin_of(camera.model_copy(update={"mask": mask}))


def _spread(image: Tensor) -> Tensor:
    """Covariance of the places of the light, in um², rows first."""
    rows, columns = (
        (torch.arange(count, dtype=torch.float64) - (count - 1) / 2) * 1.55 for count in image.shape
    )
    places = torch.stack(torch.meshgrid(rows, columns, indexing="ij")).reshape(2, -1)
    return torch.cov(places, correction=0, aweights=image.double().flatten())


@pytest.mark.parametrize(("diameter_mm", "distance_mm"), [(6.0, 60.0), (10.0, 150.0)])
def test_a_large_source_blurs_the_image_by_its_own(pinhole, diameter_mm, distance_mm):
    """A disc of a·D/z: its variance, a²D²/16z², comes on top, and no light is lost."""
    source = PointSource(distance_um=distance_mm * 1e3)
    large = replace(source, diameter_um=diameter_mm * 1e3)
    point, disc = (
        point_spread(pinhole, each, (360, 360), light=GREEN)[0].double() for each in (source, large)
    )
    image_um = diameter_mm / distance_mm * reduced_um(pinhole.camera)
    expected = image_um**2 / 16 * torch.eye(2)
    more = _spread(disc) - _spread(point)
    torch.testing.assert_close(more, expected.double(), rtol=0.02, atol=0.02 * image_um**2 / 16)
    assert float(disc.sum()) == pytest.approx(float(point.sum()), rel=1e-3)


def test_a_large_source_blurs_light_into_the_frame_and_out_of_it():
    """A part of the frame is the same as in the whole one: nothing wraps around its edges."""
    twin = twin_of(in_grey(cropped(64, 64, overhang="0.6 mm")))
    source = PointSource(distance_um=100e3, diameter_um=5e3)  # An image of 41 pixels.
    whole = point_spread(twin, source, (240, 260), light=GREEN)[0]
    part = point_spread(twin, source, (60, 80), light=GREEN)[0]
    assert relative_error(part, whole[90:150, 90:170]) < 5e-3


@pytest.mark.parametrize("azimuth_deg", [0, 60])
def test_an_oblique_source_blurs_like_its_points(pinhole, azimuth_deg):
    """At 35° the disc's image is a sixth shorter along the direction of the angle: against the sum
    of forty points all over the disc, and against the displacement's slope."""
    centre, distance, radius = toward(35, azimuth_deg), 80e3, 4e3
    disc = replace(centre, distance_um=distance, diameter_um=2 * radius)
    grid = Grid(220, 220, 1.55, pinhole.shift_um(disc)).finer(2)
    sources = []
    for k in range(40):  # A sunflower: evenly over the disc.
        away, turn = radius * math.sqrt((k + 0.5) / 40), k * math.pi * (3 - math.sqrt(5))
        moved = away * math.sin(turn) / distance, away * math.cos(turn) / distance
        tangent = centre.tangent[0] + moved[0], centre.tangent[1] + moved[1]
        sources.append(PointSource(tangent, distance))
    points = torch.stack(
        [polychromatic_psf(pinhole, each, grid, ((GREEN_NM, 1.0),), average=2) for each in sources]
    ).mean(dim=0)
    blurred, sharp = (
        point_spread(pinhole, replace(disc, diameter_um=each), (220, 220), light=GREEN)[0]
        for each in (2 * radius, 0.0)
    )
    more, expected = (_spread(each) - _spread(sharp) for each in (blurred, points))
    size = float(expected.trace())
    torch.testing.assert_close(more, expected, rtol=0, atol=0.03 * size)
    tangents = [math.tan(math.radians(each)) for each in (34.9, 35.0, 35.1)]
    moved_um = [snell_um(pinhole.camera, each) for each in (34.9, 35.0, 35.1)]
    along = (moved_um[2] - moved_um[0]) / (tangents[2] - tangents[0])
    across = moved_um[1] / tangents[1]
    small, large = torch.linalg.eigvalsh(more).tolist()
    assert small == pytest.approx((2 * radius * along / distance) ** 2 / 16, rel=0.02)
    assert large == pytest.approx((2 * radius * across / distance) ** 2 / 16, rel=0.02)
    assert relative_error(blurred, points) < 0.1


# --- Surfaces -----------------------------------------------------------------------------------


def _fresnel(camera: Camera, angle_deg: float) -> float:
    """Share of unpolarised light that passes all surfaces, from Fresnel's tangents and sines."""
    indices = [1.0, *camera.indices(GREEN_NM)]
    passed = 1.0
    for before, after in pairwise(indices):
        if angle_deg == 0:
            passed *= 1 - ((after - before) / (after + before)) ** 2
            continue
        one, other = (math.asin(math.sin(math.radians(angle_deg)) / n) for n in (before, after))
        across = (math.sin(one - other) / math.sin(one + other)) ** 2
        along = (math.tan(one - other) / math.tan(one + other)) ** 2
        passed *= 1 - (across + along) / 2
    return passed


@pytest.mark.parametrize("angle_deg", [0, 25, 45])
@pytest.mark.parametrize("bare", [True, False])
def test_surfaces_reflect_what_fresnel_says(angle_deg, bare):
    """Against the same camera without losses; a relief turns light too little to matter."""
    camera = in_grey(cropped(128, 128, overhang="0.4 mm"))
    camera = flattened(camera) if bare else camera
    source = toward(angle_deg, 20)
    lossless, lossy = (
        point_spread(twin_of(camera, fresnel=fresnel), source, (128, 128), light=GREEN)
        for fresnel in (False, True)
    )
    expected = _fresnel(camera, angle_deg)
    assert 0.7 < expected < 0.95
    share = float(lossy.mean() / lossless.mean())
    assert share == pytest.approx(expected, rel=1e-4 if bare else 2e-3)


@pytest.mark.parametrize("fresnel", [False, True])
@pytest.mark.parametrize("bare", [True, False])
def test_vignetting_is_that_of_the_pattern(fresnel, bare):
    """The mean at 40°, against the axis: cos³, acceptance 0.56, and what surfaces reflect."""
    camera = in_grey(cropped(400, 400, overhang="0.2 mm"))
    twin = twin_of(flattened(camera) if bare else camera, fresnel=fresnel)
    axis, oblique = (
        float(point_spread(twin, source, (400, 400), light=GREEN).mean())
        for source in (PointSource(), toward(40, 115))
    )
    p = torch.tensor([0.0, math.sin(math.radians(40))], dtype=torch.float64)
    vignetting = twin.vignetting(p).tolist()
    assert vignetting[0] == pytest.approx(1)
    assert oblique / axis == pytest.approx(vignetting[1], rel=1e-3 if bare else 0.02)
    losses = _fresnel(camera, 40) / _fresnel(camera, 0) if fresnel else 1.0
    expected = 0.56 * math.cos(math.radians(40)) ** 3 * losses
    assert vignetting[1] == pytest.approx(expected, rel=1e-6)
