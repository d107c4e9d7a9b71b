"""The two criteria of cameras: against the twin, the ray matrices, each other and the paper."""

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from nolens.camera import LoadedCamera, ReliefFile, preset
from nolens.design.tolerances.models import Builds, RayModel, WaveModel, criterion_of
from nolens.design.tolerances.parameters import default_parameters
from nolens.design.tolerances.patch import Lenslets, Patch
from nolens.design.tolerances.sharpness import Sharpness
from nolens.errors import OptionError
from nolens.evaluate import pattern_figures
from nolens.optics import PointSource, Relief, Stack, mask_to_sensor
from nolens.quantities import Length
from nolens.twin import Light, Twin, point_spread

PAPER = LoadedCamera.of(preset("paper"))
GREEN = ((550.0, 1.0),)
WIDTH = Sharpness("line-width")
THICKNESS = ("resin.thickness",)


@pytest.fixture(scope="module")
def patch() -> Patch:
    return Patch.of(PAPER)


def wave(patch: Patch, sharpness: Sharpness = WIDTH) -> WaveModel:
    return WaveModel(patch, sharpness, GREEN)


def rays(patch: Patch, sharpness: Sharpness = WIDTH) -> RayModel:
    return RayModel(patch, sharpness, 550.0)


def column(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)[:, None]


def test_wave_model_is_the_twins(patch: Patch) -> None:
    """The same patch and changed layers, as a camera of their own that the twin simulates."""
    names = ("resin.thickness", "resin.index", "relief.gain", "cover glass.thickness")
    rows = torch.tensor([[1200.0, 1.50, 95.0, 470.0]]).double()
    pattern = wave(patch).psf(Builds.of(PAPER.camera, names, rows), 0)

    base = PAPER.camera
    layers = list(base.layers)
    layers[0] = layers[0].model_copy(
        update={"thickness": Length("1200", "um"), "material": None, "index": 1.50}
    )
    layers[1] = layers[1].model_copy(update={"thickness": Length("470", "um")})
    relief = ReliefFile(kind="file", file="patch.tif", grid=base.mask.relief.grid)  # type: ignore[union-attr]
    mask = base.mask.model_copy(update={"relief": relief})
    sensor = base.sensor.model_copy(update={"rows": 300, "columns": 300})
    camera = base.model_copy(update={"layers": tuple(layers), "mask": mask, "sensor": sensor})
    heights = patch.twin.mask.relief.height_um * 0.95
    twin = Twin.of(replace(PAPER, camera=camera, relief_um=heights))
    source = PointSource(distance_um=300e3)
    rows_, columns = pattern.shape
    cells = rows_ - 86, columns - 86
    seen = point_spread(twin, source, cells, light=Light("550nm"))[1]
    part = pattern[43:-43, 43:-43]
    assert float((part - seen).norm() / seen.norm()) < 2e-3
    found = pattern_figures(seen, 1.55).width_um / math.sqrt(2)
    assert WIDTH.of_psf(pattern, 1.55, 1.0) == pytest.approx(found, rel=0.02)


def test_shrinkage_scales_relief_and_layer(patch: Patch) -> None:
    """A relief that shrank in all directions, as the twin has it from a finer grid."""
    model = wave(patch)
    names = ("relief.shrinkage", "resin.thickness")
    rows = torch.tensor([[5.0, 1000.0]]).double()
    found = model.psf(Builds.of(PAPER.camera, names, rows), 0)
    relief = patch.twin.mask.relief
    small = Relief(relief.height_um * 0.95, relief.grid_um * 0.95)
    twin = replace(patch.twin, mask=replace(patch.twin.mask, relief=small))
    shrunk = wave(replace(patch, twin=twin))
    builds = Builds.of(PAPER.camera, ("resin.thickness",), column(950.0))
    expected = shrunk.psf(builds, 0)
    assert float((found - expected).norm() / expected.norm()) < 0.02


@given(
    thickness=st.floats(300, 3000), index=st.floats(1.3, 1.8), gain=st.floats(50, 150),
    shrinkage=st.floats(-5, 5), gap=st.floats(50, 900),
)  # fmt: skip
def test_beams_are_those_of_the_ray_matrices(
    thickness: float, index: float, gain: float, shrinkage: float, gap: float
) -> None:
    model = rays(FAKE)
    names = ("resin.thickness", "resin.index", "relief.gain", "relief.shrinkage", "gap.thickness")
    rows = torch.tensor([[thickness, index, gain, shrinkage, gap]], dtype=torch.float64)
    found = float(model.beam_um(Builds.of(PAPER.camera, names, rows))[0])

    scale = 1 - shrinkage / 100
    glass = PAPER.camera.indices(550.0)[1]
    after = Stack((thickness * scale, 490.0, gap), (index, glass, 1.0))
    matrix = mask_to_sensor(1.0, after, 700.0 * scale / (gain / 100))
    a, b = float(matrix[0, 0]), float(matrix[0, 1])
    # The Gaussian beam as wide at half height in its focus as a disc of the lenslet's area.
    area = math.sqrt(3) / 2 * (70.0 * scale) ** 2
    pupil = 1.029 * math.sqrt(4 / math.pi * area) * math.sqrt(2 * math.log(2)) / math.pi / 1.029**2
    expected = math.hypot(pupil * (a + b / 300e3), 0.55 * b / (math.pi * pupil))
    assert found == pytest.approx(expected, rel=2e-3)


FAKE = Patch(Twin.of(LoadedCamera.of(preset("small"))), (600.0, 600.0), Lenslets(700.0, 70.0, 0.5))
"""Lenslets of round figures on the layers of the paper's camera."""


def test_lenslets_of_a_relief_that_is_known() -> None:
    """Caps h = -d²/2R on a hexagonal lattice of 60 um, and hollows for the other side."""
    y, x = torch.meshgrid(torch.arange(312.0), torch.arange(300.0), indexing="ij")
    places = [
        (20 + row * 60 * math.sqrt(3) / 2, 10.3 + (column + row % 2 / 2) * 60)
        for row in range(-1, 8)
        for column in range(-1, 8)
    ]
    squared = torch.stack([(y - a) ** 2 + (x - b) ** 2 for a, b in places]).amin(0)
    relief = Relief(-squared / (2 * 500), 1.0)
    found = Lenslets.of(relief, bulging=1.0)
    assert found.radius_um == pytest.approx(500, rel=0.01)
    assert found.pitch_um == pytest.approx(60, rel=0.01)
    assert found.area_um2 == pytest.approx(math.sqrt(3) / 2 * found.pitch_um**2)
    assert found.gathered > 0.85
    assert Lenslets.of(Relief(-relief.height_um, 1.0), bulging=-1.0) == found
    with pytest.raises(OptionError, match="0 tops"):
        Lenslets.of(Relief(y * 0.1, 1.0), bulging=1.0)


def test_contrast_of_spots_is_that_of_a_drawn_lattice() -> None:
    """Gaussian spots of sigma 8 on a hexagonal lattice of 48 um, over 40 % background."""
    pitch, sigma, share = 48.0, 8.0, 0.6
    height = pitch * math.sqrt(3)
    y = (torch.arange(400).double() / 400 * height)[:, None]
    x = torch.arange(400).double() / 400 * pitch
    plane = torch.zeros(400, 400).double()
    for row in range(-6, 8):
        for place in range(-6, 8):
            a, b = row * height / 2, (place + row % 2 / 2) * pitch
            plane += torch.exp(-((y - a) ** 2 + (x - b) ** 2) / (2 * sigma**2))
    plane = share * plane / plane.mean() + (1 - share)
    expected = 100 * float(plane.std(correction=0) / plane.mean())
    spots = Sharpness("contrast").of_spots(torch.tensor([sigma]), torch.tensor([pitch]), share)
    assert float(spots[0]) == pytest.approx(expected, rel=1e-6)
    assert Sharpness("contrast").of_psf(plane.float(), 1.0, 1.0) == pytest.approx(expected)


def test_width_and_mtf_of_random_spots_are_those_of_one() -> None:
    """Gaussian spots at random places: figures of the pattern give back the spot's own."""
    sigma, cell, count = 6.0, 1.5, 300
    generator = torch.Generator().manual_seed(1)
    places = torch.rand(count, 2, generator=generator) * 768 * cell
    steps = torch.arange(768) * cell
    away = [steps[None] - places[:, axis, None] for axis in (0, 1)]
    period = 768 * cell
    rows, columns = (
        torch.exp(-((each - period * (each / period).round()) ** 2) / (2 * sigma**2))
        for each in away
    )
    pattern = torch.einsum("ny,nx->yx", rows, columns)
    for per_mm in (15.0, 30.0, 40.0):
        mtf = Sharpness("mtf", per_mm)
        expected = 100 * math.exp(-2 * (math.pi * sigma * per_mm * 1e-3) ** 2)
        assert mtf.of_psf(pattern, cell, count) == pytest.approx(expected, rel=0.12)
        one, pitch = torch.tensor([sigma]), torch.tensor([70.0])
        assert float(mtf.of_spots(one, pitch, 1.0)[0]) == pytest.approx(expected)
    fwhm = 2.3548 * sigma
    assert WIDTH.of_psf(pattern, cell, count) == pytest.approx(fwhm, rel=0.08)
    assert float(WIDTH.of_spots(torch.tensor([sigma]), pitch, 1.0)[0]) == pytest.approx(
        fwhm, rel=1e-4
    )


def test_even_patterns_have_no_lines() -> None:
    assert WIDTH.of_psf(torch.ones(64, 64), 1.55, 1.0) == math.inf
    assert Sharpness("contrast").of_psf(torch.ones(64, 64), 1.55, 1.0) == 0


@pytest.mark.parametrize(
    "text", ["line width", "mtf", "mtf@40", "mtf@0/mm", "mtf@-3/mm", "contrast "]
)
def test_bad_criteria(text: str) -> None:
    with pytest.raises(OptionError, match="mtf@40/mm"):
        Sharpness.parse(text)


@pytest.mark.parametrize("text", ["line-width", "contrast", "mtf@40/mm", "mtf@37.5/mm"])
def test_criteria_by_name(text: str) -> None:
    assert Sharpness.parse(text).name == text


def test_frequencies_that_the_pattern_does_not_show() -> None:
    for per_mm in (5.0, 400.0):
        with pytest.raises(OptionError, match="15/mm to 322/mm"):
            Sharpness("mtf", per_mm).check(1.55, 70.0)
    Sharpness("mtf", 40.0).check(1.55, 70.0)
    Sharpness("contrast").check(1.55, 70.0)


def worst(criterion: Callable[[Tensor], Tensor]) -> list[str]:
    """Parameters by the larger change at ± their tolerance."""
    parameters = default_parameters(PAPER.camera)
    middle = torch.tensor([each.middle for each in parameters]).double()
    steps = torch.diag(torch.tensor([each.tolerance for each in parameters])).double()
    nominal = float(criterion(middle[None])[0])
    found = {}
    for each, step in zip(parameters, steps, strict=True):
        ends = (float(criterion((middle + way * step)[None])[0]) for way in (-1, 1))
        found[each.name] = max(abs(end - nominal) for end in ends)
    return sorted(found, key=lambda name: -found[name])


@pytest.mark.parametrize(
    ("kind", "error"), [("line-width", 0.25), ("contrast", 0.06), ("mtf@40/mm", 0.35)]
)
def test_both_models_name_the_same_worst_offenders(kind: str, error: float, patch: Patch) -> None:
    """Figures agree to 25, 6 and 35 % near the focus; the first offender is the same."""
    sharpness = Sharpness.parse(kind)
    parameters = default_parameters(PAPER.camera)
    names = tuple(each.name for each in parameters)
    middle = torch.tensor([[each.middle for each in parameters]]).double()
    quick = criterion_of(rays(patch, sharpness), PAPER.camera, names)
    exact = criterion_of(wave(patch, sharpness), PAPER.camera, names)
    assert float(quick(middle)) == pytest.approx(float(exact(middle)), rel=error)
    by_rays, by_waves = worst(quick), worst(exact)
    assert by_rays[0] == by_waves[0] == "relief.gain"
    assert set(by_rays[1:3]) == {"resin.index", "resin.thickness"}
    assert len(set(by_rays[:4]) & set(by_waves[:4])) >= 3
    harmless = {"cover glass.index", "wedge", "decentre"}
    assert harmless - {"cover glass.index"} <= set(by_rays[-3:]) & set(by_waves[-3:])


def test_the_papers_tolerance_of_thickness(patch: Patch) -> None:
    """1.28 ± 0.37 mm keep the pattern "equally sharp": 5 % wider lines at the thin end."""
    width = criterion_of(wave(patch), PAPER.camera, THICKNESS)
    thin, best, thick = width(column(910.0, 1280.0, 1650.0)).tolist()
    assert best == pytest.approx(13.6, abs=0.2)
    assert thin / best == pytest.approx(1.05, abs=0.01)
    assert thick / best == pytest.approx(1.01, abs=0.01)
    # Twice as far off it is not as sharp any more.
    assert float(width(column(540.0))) / best > 1.15


def test_wedge_is_the_mean_over_the_sensor(patch: Patch) -> None:
    """Two places stand for the whole length: against nine, for a wedge of 2 degrees."""
    model = rays(patch)
    both = criterion_of(model, PAPER.camera, ("wedge", "decentre"))
    found = float(both(torch.tensor([[2.0, 50.0]]).double())[0])
    builds = Builds.of(PAPER.camera, ("wedge", "decentre"), torch.tensor([[2.0, 50.0]]).double())
    half = 4056 * 1.55 / 2
    places = (torch.arange(201) + 0.5) / 201 * 2 * half - half
    many = [float(model.figures(builds.at(PAPER.camera, float(place)))[0]) for place in places]
    assert found == pytest.approx(sum(many) / 201, rel=1e-4)
    assert found > float(both(torch.zeros(1, 2).double())[0])


def test_wedge_by_waves_uses_both_sides(patch: Patch) -> None:
    both = criterion_of(wave(patch), PAPER.camera, ("wedge",))
    alone = criterion_of(wave(patch), PAPER.camera, THICKNESS)
    away = 4056 * 1.55 / math.sqrt(12) * math.tan(math.radians(3.0))
    sides = alone(column(1060 - away, 1060 + away))
    assert float(both(column(3.0))[0]) == pytest.approx(float(sides.mean()), rel=1e-5)


def test_an_opening_that_leaves_the_sensor_changes_the_pattern() -> None:
    small = LoadedCamera.of(preset("small"))
    model = WaveModel(Patch.of(small), Sharpness("contrast"), GREEN)
    still, moved = (
        model.psf(Builds.of(small.camera, ("decentre",), column(by)), 0) for by in (0.0, 31.0)
    )
    # 20 pixels to the right.
    assert float((moved[:, 60:260] - still[:, 40:240]).norm() / still.norm()) < 1e-3
    assert float((moved - still).norm() / still.norm()) > 0.5


def test_a_relief_from_a_file(patch: Patch) -> None:
    """The same surface as a file gives the same figures; one that is too small is refused."""
    surface = patch.twin.mask.relief
    relief = ReliefFile(kind="file", file="a.tif", grid=Length("1.55", "um"))
    mask = PAPER.camera.mask.model_copy(update={"relief": relief})
    camera = PAPER.camera.model_copy(update={"mask": mask})
    other = Patch.of(
        LoadedCamera(camera, PAPER.quantum_efficiency, PAPER.acceptance, surface.height_um)
    )
    builds = Builds.of(PAPER.camera, THICKNESS, column(1060.0))
    assert min(other.side_um) > 400
    assert float(wave(other).figures(builds)[0]) == pytest.approx(
        float(wave(patch).figures(builds)[0]), rel=0.05
    )
    cut = surface.height_um[:150, :150]
    with pytest.raises(OptionError, match="mm or more"):
        Patch.of(LoadedCamera(camera, PAPER.quantum_efficiency, PAPER.acceptance, cut))


@pytest.fixture(scope="module")
def facing() -> LoadedCamera:
    """A film whose relief faces the sensor: its hollows gather light."""
    film = preset("paper-film")
    return LoadedCamera.of(
        film.model_copy(update={"mask": film.mask.model_copy(update={"surface": 1})})
    )


def test_beams_behind_a_film_that_faces_the_sensor(facing: LoadedCamera) -> None:
    patch = replace(FAKE, twin=Twin.of(facing_patch(facing)))
    rows = torch.tensor([[250.0, 300.0]]).double()
    names = ("film.thickness", "distance of the film.thickness")
    found = float(rays(patch).beam_um(Builds.of(facing.camera, names, rows))[0])
    film, air, glass, gap = facing.camera.indices(550.0)
    # It bulges away from the light.
    matrix = mask_to_sensor(film, Stack((300.0, 490.0, 235.0), (air, glass, gap)), -700.0)
    a, b = float(matrix[0, 0]), float(matrix[0, 1])
    pupil = 0.364 * math.sqrt(4 / math.pi * FAKE.lenslets.area_um2)
    away = film * (300e3 + 250 / film)
    expected = math.hypot(pupil * (a + b / away), 0.55 * b / (math.pi * film * pupil))
    assert found == pytest.approx(expected, rel=1e-6)


def test_waves_behind_a_film_that_faces_the_sensor(facing: LoadedCamera) -> None:
    patch = Patch.of(facing)
    assert patch.twin.camera.mask.surface == 1 and patch.lenslets.radius_um > 0
    pattern = wave(patch).psf(Builds.of(facing.camera, ("film.thickness",), column(305.0)), 0)
    cells = pattern.shape[0] - 86, pattern.shape[1] - 86
    sensor = facing.camera.sensor.model_copy(update={"rows": 300, "columns": 300})
    twin = replace(patch.twin, camera=patch.twin.camera.model_copy(update={"sensor": sensor}))
    seen = point_spread(twin, PointSource(distance_um=300e3), cells, light=Light("550nm"))[1]
    assert float((pattern[43:-43, 43:-43] - seen).norm() / seen.norm()) < 2e-3


def facing_patch(camera: LoadedCamera) -> LoadedCamera:
    """The camera with a little relief of its own, for models that do not look at it."""
    relief = ReliefFile(kind="file", file="a.tif", grid=Length("1.55", "um"))
    mask = camera.camera.mask.model_copy(update={"relief": relief})
    described = camera.camera.model_copy(update={"mask": mask})
    return replace(camera, camera=described, relief_um=torch.zeros(8, 8))


def test_pixels_widen_the_lines() -> None:
    """Against a Gaussian line that is averaged over pixels of 1.55 um: variances add."""
    builds = Builds.of(PAPER.camera, THICKNESS, column(1060.0))
    beam = float(rays(FAKE).beam_um(builds)[0])
    width = float(rays(FAKE).figures(builds)[0])
    assert (width / 2.354820) ** 2 - (beam / 2) ** 2 == pytest.approx(1.55**2 / 12, rel=1e-3)
