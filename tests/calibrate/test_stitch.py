"""PSFs from captures at angles: against the wide PSF, and by the picture they give."""

import math
from dataclasses import replace
from itertools import combinations

import pytest
import torch
from captured_at_angles import CELL_UM, DISTANCE_UM, captured, grey_camera, lights
from skimage.data import astronaut
from torch import Tensor

from nolens.calibrate.distances import Layers
from nolens.calibrate.registration import Match, Shift
from nolens.calibrate.stitch import Capture, Placement, Stitched, locate, stitch
from nolens.evaluate import psnr, scale_fit
from nolens.experiments.virtual_experiment import SimulatedMeasurement, VirtualExperiment, solved
from nolens.optics import PointSource
from nolens.quantities import Angle
from nolens.twin import Plane

ROWS, COLUMNS, SCENE_DEG = 192, 240, 8.3


@pytest.fixture(scope="module")
def bench() -> VirtualExperiment:
    return VirtualExperiment.of(grey_camera(ROWS, COLUMNS))


def captures(
    bench: VirtualExperiment, error_deg: float
) -> tuple[list[Capture], list[tuple[float, float]]]:
    """Captures with noise, placed by their stated angles, and where their light really fell."""
    layers = Layers.of_camera(bench.twin.camera)
    found, truth = [], []
    for light in lights(SCENE_DEG / 2 + 1, error_deg):
        stated = (Angle.of(light.stated_deg[0], "deg"), Angle.of(light.stated_deg[1], "deg"))
        right, up = layers.shift_um(stated)
        psf = captured(bench, light)
        expected, search = (-up / CELL_UM, right / CELL_UM), 30.0 if right or up else 0.0
        found.append(Capture(psf, expected, search, pixel_um=CELL_UM))
        shift = bench.twin.shift_um(light.source)
        truth.append((shift[0] / CELL_UM, shift[1] / CELL_UM))
    return found, truth


@pytest.fixture(scope="module")
def made(bench: VirtualExperiment) -> tuple[Stitched, list[tuple[float, float]]]:
    found, truth = captures(bench, 0.5)
    return stitch(found, locate(found, 4), 4), truth


def correlation(one: Tensor, other: Tensor) -> float:
    one, other = one.double() - one.double().mean(), other.double() - other.double().mean()
    return float((one * other).sum() / (one.norm() * other.norm()))


def test_where_the_light_really_was(made: tuple[Stitched, list[tuple[float, float]]]) -> None:
    found, truth = made
    for shift, wanted in zip(found.placement.shifts, truth, strict=True):
        assert math.dist(shift, wanted) < 0.05
    assert found.placement.residual < 0.05
    assert all(each.correlation > 0.9 for each in found.placement.overlaps.values())


def test_is_the_wide_psf(
    made: tuple[Stitched, list[tuple[float, float]]], bench: VirtualExperiment
) -> None:
    found, truth = made
    rows, columns = found.psf.shape[-2:]
    assert rows == pytest.approx(ROWS + 2 * max(abs(each[0]) for each in truth), abs=1.1)
    source = PointSource(distance_um=DISTANCE_UM, diameter_um=50.0)
    wide = bench.psf(source, (rows, columns))
    scale = float(found.psf.mean() / wide.mean())
    # Within the support's reach; further out only some corners were seen.
    height, width = (found.support[0] + ROWS, found.support[1] + COLUMNS)
    top, left = (rows - height) // 2, (columns - width) // 2
    inner = (..., slice(top, top + height), slice(left, left + width))
    assert correlation(found.psf[inner], wide[inner]) > 0.98
    edge = (height - ROWS) // 2, (width - COLUMNS) // 2
    for side in (
        (..., slice(0, edge[0]), slice(edge[1], -edge[1])),
        (..., slice(-edge[0], None), slice(edge[1], -edge[1])),
        (..., slice(edge[0], -edge[0]), slice(0, edge[1])),
        (..., slice(edge[0], -edge[0]), slice(-edge[1], None)),
    ):
        assert correlation(found.psf[inner][side], wide[inner][side]) > 0.99
    off = (found.psf / scale - wide)[inner]
    assert float(off.square().mean().sqrt()) < 0.05 * float(wide[inner].square().mean().sqrt())
    assert 0.9 < found.known_fraction < 1


def test_psf_of_a_corner_is_its_own(
    made: tuple[Stitched, list[tuple[float, float]]], bench: VirtualExperiment
) -> None:
    """At the angle where the light really was, by the PSF of the simulated camera there."""
    found, truth = made
    corner = lights(SCENE_DEG / 2 + 1, 0.5)[0]
    layers = Layers.of_camera(bench.twin.camera)
    for angle, actual in zip(found.angle(0, layers), corner.actual_deg, strict=True):
        assert angle.deg == pytest.approx(actual, abs=0.01)
    psf = next(found.at_captures())
    rows, columns = psf.shape[-2:]
    expected = bench.psf(corner.source, (rows, columns))
    top = (rows - ROWS) // 2 - round(truth[0][0])
    left = (columns - COLUMNS) // 2 - round(truth[0][1])
    own = (..., slice(top, top + ROWS), slice(left, left + COLUMNS))
    assert correlation(psf[own], expected[own]) > 0.9995
    off = psf[own] / psf[own].mean() - expected[own] / expected[own].mean()
    assert float(off.square().mean().sqrt()) < 0.03


def gamma_free() -> Tensor:
    picture = torch.from_numpy(astronaut()[..., 1].copy()).float() / 255
    return picture.square()[None]


def quality(shot: SimulatedMeasurement, psf: Tensor, *, confined: bool = True) -> float:
    """PSNR of the reconstruction, against what each cell of the scene gives."""
    seen = solved(shot.frame, psf, shot.support if confined else None, iterations=60, tau=5e-6)
    truth = shot.truth * shot.response
    return psnr(scale_fit(seen, truth), truth, 1.0)


def test_a_dense_scene_needs_it(
    made: tuple[Stitched, list[tuple[float, float]]], bench: VirtualExperiment
) -> None:
    """As much of the sensor as 56 degrees are of the paper's: 10 dB, angles half a degree off."""
    shot = bench.measure((Plane(gamma_free(), SCENE_DEG, DISTANCE_UM),), seed=1)
    assert shot.support.height <= made[0].support[0] and shot.support.width <= made[0].support[1]
    as_captured = quality(shot, captured(bench, lights(SCENE_DEG / 2, 0.0)[4]))
    assert quality(shot, made[0].psf) > as_captured + 10


def flat_captures(gains: list[float], shifts: list[tuple[float, float]]) -> list[Capture]:
    generator = torch.Generator().manual_seed(0)
    wide = 1 + torch.rand((2, 200, 240), generator=generator)
    found = []
    for gain, (row, column) in zip(gains, shifts, strict=True):
        top, left = 50 - int(row), 60 - int(column)
        factor = torch.tensor([gain, 2 * gain if gain != 1 else 1.0])[:, None, None]
        found.append(
            Capture(factor * wide[:, top : top + 100, left : left + 120], (row, column), 1.0)
        )
    return found


def placement(shifts: list[tuple[float, float]]) -> Placement:
    overlaps = {
        (a, b): Match((shifts[b][0] - shifts[a][0], shifts[b][1] - shifts[a][1]), 1.0, 1)
        for a, b in combinations(range(len(shifts)), 2)
    }
    return Placement(tuple(shifts), (1.0,) * len(shifts), overlaps, 0.0)


def test_brightness_and_places_are_exact() -> None:
    """Parts of one pattern, in whole cells and with other brightness: the pattern comes back."""
    shifts = [(0.0, 0.0), (20.0, 30.0), (-20.0, -30.0), (20.0, -30.0), (-20.0, 30.0)]
    gains = [1.0, 0.5, 0.8, 1.7, 0.3]
    given = flat_captures(gains, shifts)
    shares: list[float] = []
    found = stitch(given, placement(shifts), 0, shares.append)
    assert shares == [0.0, 0.2, 0.4, 0.6, 0.8]
    for row, gain in zip(found.gains, gains, strict=True):
        assert row == pytest.approx((gain, 2 * gain if gain != 1 else 1.0), rel=1e-3)
    assert found.psf.shape == (2, 140, 180) and found.support == (40, 60)
    generator = torch.Generator().manual_seed(0)
    wide = 1 + torch.rand((2, 200, 240), generator=generator)
    inner = (..., slice(2, -2), slice(2, -2))
    assert torch.allclose(found.psf[inner], wide[:, 30:170, 30:210][inner], rtol=2e-3)


def test_uneven_light_of_an_angle_is_its_own() -> None:
    """Captures lean in proportion to the angle: so do their PSFs beyond, about the one ahead."""
    shifts = [(0.0, 0.0), (20.0, 30.0), (-20.0, -30.0), (20.0, -30.0), (-20.0, 30.0)]

    def leaning(shift: tuple[float, float], size: tuple[int, int], middle: Shift) -> Tensor:
        """Brightness on pixels around the PSF's middle."""
        places = (torch.arange(n) - at for n, at in zip(size, middle, strict=True))
        down, right = (5e-5 * by * place for by, place in zip(shift, places, strict=True))
        return (down[:, None] + right).exp()

    given = [
        replace(each, psf=each.psf * leaning(shift, (100, 120), (50 + shift[0], 60 + shift[1])))
        for each, shift in zip(
            flat_captures([1.0, 0.5, 0.8, 1.7, 0.3], shifts), shifts, strict=True
        )
    ]
    found = [*stitch(given, placement(shifts), 0).at_captures()]
    generator = torch.Generator().manual_seed(0)
    wide = (1 + torch.rand((2, 200, 240), generator=generator))[:, 30:170, 30:210]
    inner = (..., slice(2, -2), slice(2, -2))
    for shift, psf in zip(shifts, found, strict=True):
        truth = wide * leaning(shift, (140, 180), (70, 90))
        assert torch.allclose(psf[inner], truth[inner], rtol=4e-3), shift


def test_brightness_is_compared_whatever_the_contrast() -> None:
    """A view of spots is as bright as the even ones beside it; by logarithms it is 12 % off."""
    shifts = [(0.0, 0.0), (20.0, 40.0), (-20.0, -40.0), (20.0, -40.0), (-20.0, 40.0)]
    even = Capture(torch.ones(1, 100, 120), (0.0, 0.0), 1.0)
    spots = torch.zeros(1, 100, 120)
    spots[:, 2::5, 2::5] = 25.0
    given = [even, even, even, even, replace(even, psf=spots)]
    psf = [*stitch(given, placement(shifts), 0).at_captures()][4]
    own = psf[:, 40:140, 0:120]
    assert float(own.mean() / psf.mean()) == pytest.approx(1, abs=0.03)


def test_spots_between_pixels_keep_their_light() -> None:
    """Splines undershoot beside them: cut off at zero, captures are up to 40 % brighter."""
    shifts = [(0.0, 0.0), (20.5, 30.5), (-20.5, -30.5), (20.0, -30.0), (-20.0, 30.0)]
    spots = torch.zeros(1, 100, 120)
    spots[:, 4::8, 4::8] = 1.0
    given = [Capture(spots, shift, 1.0) for shift in shifts]
    found = stitch(given, Placement(tuple(shifts), (1.0,) * 5, {}, 0.0), 0)
    light = [float(psf.mean()) for psf in found.at_captures()]
    assert light == pytest.approx([float(spots.mean())] * 5, rel=0.04)


def test_views_count_by_their_angle() -> None:
    """Off the sensor's edge only the view whose light passes there; in the middle the one ahead."""
    shifts = [(0.0, 0.0), (0.0, 40.0), (0.0, -40.0)]
    given = [
        Capture(torch.full((1, 100, 120), value), shift, 1.0)
        for value, shift in zip((1.0, 3.0, 5.0), shifts, strict=True)
    ]
    # Without overlaps to compare, brightness stays.
    found = stitch(given, Placement(tuple(shifts), (1.0,) * 3, {}, 0.0), 0)
    line = found.psf[0, 50]
    at = {x: float(line[100 + x]) for x in (-75, -50, -40, 0, 40, 50, 75)}
    assert at[-75] == pytest.approx(3) and at[75] == pytest.approx(5)
    aside = math.exp(-((1 / 0.4) ** 2) / 2)
    # Both of the others fade: their edges are half as far as they fade along.
    assert at[0] == pytest.approx((1 + 4 * aside) / (1 + aside), rel=5e-3)
    assert 1.3 < at[-40] < at[-50] < 3 and 1.3 < at[40] < at[50] < 5
    # At a view's own angle only that one, but where it was not seen; no seam between.
    own = [*found.at_captures()][1][0, 50]
    assert torch.allclose(own[10:110], torch.tensor(3.0)) and torch.allclose(own[120:], line[120:])
    assert float((own[119] - line[119]).abs()) < 0.1 * float((3 - line[119]).abs())


def test_nothing_is_seen_in_the_corners() -> None:
    shifts = [(0.0, 0.0), (0.0, 40.0), (40.0, 0.0)]
    given = [Capture(torch.full((1, 100, 120), 2.0), each, 1.0) for each in shifts]
    found = stitch(given, placement(shifts), 0)
    assert found.support == (0, 0)
    assert found.psf.shape == (1, 180, 200) and found.known_fraction < 0.75
    assert torch.allclose(found.psf, torch.tensor(2.0), rtol=1e-4)
