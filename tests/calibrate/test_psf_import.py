"""PSFs from elsewhere: what is put where they are clipped, their black level, and their size."""

import pytest
import torch
from captured_at_angles import DISTANCE_UM, grey_camera
from point_light import light_of
from skimage.data import astronaut
from torch import Tensor

from nolens.calibrate.psf_import import continued, import_psf
from nolens.camera import Frame
from nolens.camera.measurement import saturation_count
from nolens.errors import DataError
from nolens.evaluate import psnr, scale_fit
from nolens.experiments.virtual_experiment import SimulatedMeasurement, VirtualExperiment, solved
from nolens.optics import PointSource
from nolens.twin import Plane

BLACK, WHITE = 64.0, 4095.0


def frame_of(values: Tensor, *, stored_as: str = "uint16", white: float | None = 65535.0) -> Frame:
    return Frame(values, ("grey",), None, (0.0,), white, stored_as, "psf.tif")


def gaussian(side: int, width: float) -> Tensor:
    steps = torch.arange(side, dtype=torch.float64) - (side - 1) / 2
    line = torch.exp(-steps.square() / (2 * width**2))
    return (line[:, None] * line).float()


def test_a_clipped_gaussian_comes_back() -> None:
    """Its logarithm is a parabola, which is biharmonic: nothing is smoother."""
    truth = gaussian(41, 4.0)
    for level in (0.8, 0.5, 0.3):
        clipped = truth >= level
        result = continued(truth.clamp(max=level), clipped)
        assert torch.equal(result[~clipped], truth[~clipped])
        assert torch.allclose(result[clipped], truth[clipped], rtol=0.03)
    # At an edge of the sensor, too.
    half = truth[:, 20:]
    result = continued(half.clamp(max=0.6), half >= 0.6)
    assert torch.allclose(result, half, rtol=0.12)
    assert torch.equal(continued(truth, truth > 2), truth)


def test_what_is_put_there_is_bounded() -> None:
    """Steep slopes all around would rise to a thousand times what clips."""
    steps = torch.arange(40) - 19.5
    slope = (12 - torch.hypot(steps[:, None], steps)).exp()
    result = continued(slope.clamp(max=1), slope >= 1)
    assert float(result[slope >= 1].min()) >= 1 - 1e-6
    assert float(result.max()) == pytest.approx(4, rel=1e-5)


@pytest.fixture(scope="module")
def bench() -> VirtualExperiment:
    return VirtualExperiment.of(grey_camera(96, 128), field_points=3)


def quality(shot: SimulatedMeasurement, psf: Tensor) -> float:
    scene = solved(shot.frame, psf, shot.support, iterations=60)
    truth = shot.truth * shot.response
    return psnr(scale_fit(scene, truth), truth, 1.0)


def test_reconstruction_with_a_clipped_psf(bench: VirtualExperiment) -> None:
    """12 bits, 2 % of them clipped: nearly as good as the whole PSF, and better than a hole."""
    psf = bench.psf(PointSource(distance_um=DISTANCE_UM, diameter_um=50.0))
    picture = (torch.from_numpy(astronaut()[..., 1].copy()).float() / 255).square()
    shot = bench.measure((Plane(picture[None], 4.0, DISTANCE_UM),), seed=0)
    scaled = (WHITE - BLACK) * psf / psf.flatten().quantile(0.98)
    counts = (BLACK + scaled).round().clamp(max=WHITE)
    # The file says neither that 4095 is the largest count nor that 64 is black.
    result = import_psf(frame_of(counts), black=BLACK)
    assert result.saturated_fraction == pytest.approx(0.02, abs=0.002) and not result.warnings
    whole, imported, clipped = (quality(shot, each) for each in (psf, result.psf, counts - BLACK))
    assert imported > whole - 0.4
    assert imported > clipped + 0.5
    # So much that it is a guess.
    result = import_psf(frame_of((3 * (counts - BLACK) + BLACK).clamp(max=WHITE)), black=BLACK)
    (warning,) = result.warnings
    assert result.saturated_fraction > 0.05 and "nolens calibrate pairs" in warning


def test_black_level_of_an_aperture() -> None:
    """It is read off the dark area where nobody states it, and said."""
    light = light_of("small")[None]
    noise = torch.randn(light.shape, generator=torch.Generator().manual_seed(1))
    counts = (BLACK + 2000 * light / light.max() + 3 * noise).round()
    result = import_psf(frame_of(counts))
    assert result.background[0] == pytest.approx(BLACK, abs=1.0) and not result.black_stated
    stated = import_psf(frame_of(counts), black=BLACK)
    assert stated.background == (0.0,) and stated.black_stated
    assert psnr(result.psf, stated.psf, float(stated.psf.max())) > 55
    # Nothing is taken from a PSF whose black is 0 already.
    finished = frame_of(light, stored_as="float32", white=None)
    assert torch.equal(import_psf(finished).psf, light)
    # Without a dark area a black level is the PSF's own light, or not: it is said, not guessed.
    full = frame_of(100 + 50 * gaussian(80, 2.0).roll(9, 0)[None])
    (warning,) = import_psf(full).warnings
    assert "black level that the file does not state" in warning
    assert float(import_psf(full, black="auto").psf.max()) == pytest.approx(50, rel=0.1)


def test_size_of_the_sensor() -> None:
    """The zero shift stays in the middle, whether rows and columns are odd or even."""
    for rows, columns in ((40, 40), (41, 41), (40, 61), (61, 40)):
        values = torch.zeros(1, rows, columns)
        values[0, rows // 2 - 1 : rows // 2 + 2, columns // 2 - 1 : columns // 2 + 2] = 100.0
        values[0, rows // 2, columns // 2] = 200.0
        result = import_psf(frame_of(values), sensor=(48, 55), partial=True)
        assert result.psf.shape == (1, 48, 55) and float(result.psf[0, 24, 27]) == 200
        assert float(result.psf.sum()) == 1000
        (note,) = result.notes
        assert ("columns are cut off" in note) == (columns > 55)
        assert ("dark rows are added" in note) == (rows < 48)
    for sensor, words in (
        ((20, 20), "--bin 2"),
        ((30, 30), "no N fits"),
        ((80, 80), "binned by 2"),
        ((70, 80), "say so"),
        ((40, 50), "turned by 90°"),
    ):
        side = (1, 50, 40) if sensor == (40, 50) else (1, 40, 40)
        values = torch.zeros(side)
        values[0, 20:23, 20:23] = 100.0
        with pytest.raises(DataError, match=words):
            import_psf(frame_of(values), sensor=sensor)
    whole = import_psf(frame_of(values), sensor=(80, 90), partial=True).psf
    assert whole.shape == (1, 80, 90) and float(whole[0, 40, 45]) == float(values[0, 25, 20])


def test_count_that_clips() -> None:
    """Many pixels of just the largest value are clipped, in floats too; a peak is not."""
    peak = gaussian(64, 6.0)[None]
    counts = (1000 * peak).round()
    assert saturation_count(frame_of(counts)) == 65535
    assert saturation_count(frame_of(counts.clamp(max=600))) == 600
    floats = frame_of(peak.clamp(max=0.5), stored_as="float32", white=None)
    assert saturation_count(floats) == 0.5
    whole = frame_of(peak, stored_as="float32", white=None)
    assert saturation_count(whole) == float("inf")
    assert saturation_count(frame_of(peak.gt(0.5).float(), white=None)) == float("inf")
