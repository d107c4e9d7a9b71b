"""Simulated frames of a point source give back the true PSF."""

import pytest
import torch
from point_light import Shot, bench, decibels, light_of, rms, warm_pixels

from nolens.calibrate.exposures import Exposure, Noise, merge
from nolens.calibrate.frames import FrameMean
from nolens.calibrate.point_psf import PointPsf, StrayLight, dark_area, point_psf, stray_light
from nolens.camera import Frame
from nolens.errors import DataError
from nolens.evaluate import scale_fit

OPEN = ("paper", (256, 320))
SMALL = ("small", None)


def shot(camera: tuple[str, tuple[int, int] | None], **more: object) -> Shot:
    return Shot(bench(*camera), light_of(*camera), **more)  # type: ignore[arg-type]


def calibrated(
    taken: Shot, fills: dict[float, float], count: int = 8, darks: int = 8,
    stray: StrayLight = "auto",
) -> PointPsf:  # fmt: skip
    """Frames by exposure time, each with its fill of the brightest pixel, and dark frames."""
    frames = {time: taken.frames(count, fill, time) for time, fill in fills.items()}
    dark = {}
    if darks:
        dark = {time: taken.darks(darks, 70000 + 100 * n) for n, time in enumerate(fills)}
    return point_psf(frames, dark, pixel_um=3.1, stray=stray)


@pytest.mark.parametrize("camera", [SMALL, OPEN], ids=["aperture", "open"])
def test_noisy_clipped_frames_give_back_the_psf(
    camera: tuple[str, tuple[int, int] | None],
) -> None:
    """Two exposures, one of which clips, pixels that differ in the dark: far above 40 dB."""
    size = (bench(*camera).sensor.rows, bench(*camera).sensor.columns)
    taken = shot(camera, warm=warm_pixels(size))
    found = calibrated(taken, {0.01: 0.5, 0.04: 2.0}, darks=1)
    assert decibels(found.psf, taken.truth) > 60
    assert found.saturated_fraction == 0
    assert found.ratios == pytest.approx((1, 1), abs=2e-3)
    # The rest is the noise that was foretold, and no more.
    truth = taken.truth
    rest = scale_fit(found.psf, truth) - truth
    scale = float(truth.double().sum() / found.psf.double().sum())
    foretold = rms(torch.tensor(found.noise_rms)) * scale
    assert rms(rest) == pytest.approx(foretold, rel=0.08)
    assert found.noise.known_from == "frames"
    assert found.noise.counts_per_electron == pytest.approx(0.47, rel=0.15)
    assert found.noise.read_variance == pytest.approx((3 * 0.47) ** 2 + 1 / 12, rel=0.25)
    # Without the short exposure, or without dark frames, it is much worse.
    alone = {0.04: taken.frames(8, 2.0, 0.04)}
    with pytest.raises(DataError, match="saturated in every exposure"):
        point_psf(alone, {}, pixel_um=3.1)
    worse = calibrated(taken, {0.01: 0.5, 0.04: 2.0}, darks=0)
    assert decibels(worse.psf, truth) < decibels(found.psf, truth) - 6


def test_the_dark_between_spots_has_no_light() -> None:
    """Cut off at zero, its noise would be a tenth of the mean light, with spots 8 pixels apart."""
    spots = torch.zeros_like(light_of(*OPEN))
    spots[..., ::8, ::8], spots[..., 1::8, 1::8] = 1.0, 1.0
    taken = Shot(bench(*OPEN), spots)
    found, truth = calibrated(taken, {0.01: 0.02}, count=4).psf, taken.truth
    dark = truth == 0
    assert float(dark.double().mean()) > 0.9
    assert abs(float(found[dark].mean())) < 0.02 * float(found.mean())


def test_several_exposures_are_better_than_each() -> None:
    taken = shot(SMALL)
    both = calibrated(taken, {0.01: 0.5, 0.04: 2.0}, count=4)
    short = calibrated(taken, {0.01: 0.5}, count=8)
    assert decibels(both.psf, taken.truth) > decibels(short.psf, taken.truth) + 3


def test_counts_near_white_are_not_cut() -> None:
    """Of pixels that are nearly full, only the darker readings do not clip."""
    noise, white = Noise(2.0, 0.5, "camera"), 3800.0
    spread = float(noise.variance(torch.tensor(white)).sqrt())
    level = torch.full((1, 200, 200), white / 2)
    level[:, :20] = white - spread
    generator = torch.Generator().manual_seed(0)
    parts = []
    for time in (0.01, 0.02):
        mean = level * time / 0.02
        drawn = mean + noise.variance(mean).sqrt() * torch.randn(mean.shape, generator=generator)
        clipped = drawn >= white
        assert bool(clipped.any()) == (time == 0.02)
        parts.append(Exposure(drawn.clamp(max=white), clipped, 1, time, torch.tensor(white)))
    merged = merge(parts, noise)
    assert not merged.saturated.any()
    off = float((merged.rate * 0.02 - level)[:, :20].double().mean())
    assert abs(off) < 0.08 * spread


def test_wrong_exposure_times_are_corrected_or_refused() -> None:
    taken = shot(SMALL)
    found = calibrated(taken, {0.01: 0.5, 0.0412: 2.0})
    assert found.ratios == pytest.approx((1, 4 / 4.12), abs=1e-3)
    assert decibels(found.psf, taken.truth) > 60
    with pytest.raises(DataError, match=r"times as bright as .* not 6 times"):
        calibrated(taken, {0.01: 0.5, 0.06: 2.0})


def test_one_frame_tells_its_noise() -> None:
    taken = shot(OPEN)
    for sensor, known in ((None, "picture"), (taken.camera.sensor, "camera")):
        shares: list[float] = []
        frames = {1.0: taken.frames(1, 0.9)}
        found = point_psf(frames, {}, pixel_um=3.1, sensor=sensor, progress=shares.append)
        assert len(shares) > 3 and shares == sorted(shares)
        assert found.noise.known_from == known
        assert found.noise.counts_per_electron == pytest.approx(0.47, rel=0.15)
        assert decibels(found.psf, taken.truth) > 48


def veil(size: tuple[int, int], even: float, slope: float) -> torch.Tensor:
    return even + slope * torch.linspace(-1, 1, size[1])[None].expand(size)


def test_stray_light_is_taken_away_beside_an_aperture() -> None:
    taken = shot(SMALL, veil=veil((256, 320), 0.03, 0.005))
    found = calibrated(taken, {0.01: 0.5, 0.04: 2.0})
    assert found.area is not None and 0.3 < found.area.fraction < 0.8
    assert decibels(found.psf, taken.truth) > 60
    peaks = found.psf.amax(dim=(-2, -1))
    green = float(found.stray[1] / peaks[1])
    assert green == pytest.approx(0.03, rel=0.1)
    kept = calibrated(taken, {0.01: 0.5, 0.04: 2.0}, stray="none")
    assert decibels(kept.psf, taken.truth) < 35
    assert kept.floor[1] / float(kept.psf[1].max()) == pytest.approx(0.025, abs=0.005)


def test_the_patterns_own_wings_are_no_stray_light() -> None:
    """Without noise and without other light, next to nothing may be taken away."""
    truth = shot(SMALL).truth
    area = dark_area(truth)
    assert area is not None
    taken = stray_light(truth, area).mean(dim=(-2, -1)) / truth.amax(dim=(-2, -1))
    # Red is seen at 600 nm, where diffraction's wings are wider than in green.
    assert bool((taken.abs() < 1.3e-4 * torch.tensor([600, 535, 535]) / 535).all())


def test_an_open_pattern_keeps_its_floor() -> None:
    """Nothing tells it from stray light, unless somebody says so."""
    taken = shot(OPEN)
    found = calibrated(taken, {0.01: 0.5})
    assert found.area is None and found.stray == (0, 0, 0)
    peaks = found.psf.amax(dim=(-2, -1)).tolist()
    # Red sees a fiftieth of 535 nm: its floor is a fraction of a count.
    floors = [each / top for each, top in zip(found.floor, peaks, strict=True)][1:]
    assert all(0.01 < each < 0.02 for each in floors)
    dimmer = calibrated(taken, {0.01: 0.5}, stray="floor")
    assert dimmer.stray == pytest.approx(found.floor)
    assert dimmer.floor == pytest.approx((0, 0, 0), abs=1e-4 * float(found.psf.max()))


def test_dark_frames_with_the_room_take_stray_light_away() -> None:
    """The room stays as it was, and the point is covered: what is left is the point's."""
    taken = shot(OPEN, veil=veil((256, 320), 0.05, 0.02))
    assert taken.veil is not None
    room = Shot(taken.camera, taken.veil.clone()).frames(8, 0.5 * float(taken.veil.max()))
    found = point_psf({0.01: taken.frames(8, 0.5, 0.01)}, {0.01: room}, pixel_um=3.1)
    assert decibels(found.psf, taken.truth) > 52
    assert decibels(calibrated(taken, {0.01: 0.5}).psf, taken.truth) < 40


def test_no_point_of_light_is_refused() -> None:
    taken = shot(OPEN)
    with pytest.raises(DataError, match="nothing above its noise"):
        point_psf({1.0: taken.darks(8)}, {}, pixel_um=3.1)
    with pytest.raises(DataError, match="nothing above its noise"):
        point_psf({1.0: taken.darks(8)}, {1.0: taken.darks(8)}, pixel_um=3.1)
    rows, columns = (torch.linspace(-1, 1, n) for n in (256, 320))
    scene = torch.exp(-(rows[:, None].square() + columns.square()) / 0.3)
    with pytest.raises(DataError, match="shows no point source"):
        point_psf({1.0: Shot(taken.camera, scene).frames(8, 0.9)}, {}, pixel_um=3.1)


def test_dark_frames_brighter_than_the_frames_are_refused() -> None:
    taken = shot(SMALL)
    with pytest.raises(DataError, match="brighter than"):
        point_psf({1.0: taken.darks(2)}, {1.0: taken.frames(2, 0.9)}, pixel_um=3.1)


def test_grey_frames_and_frames_in_colour() -> None:
    """Cells of 2×2 pixels where there is a mosaic, pixels where there is none."""
    generator = torch.Generator().manual_seed(0)
    truth = shot(SMALL).truth
    counts = 100 + 1000 * truth / truth.max() + torch.randn(truth.shape, generator=generator)
    green = slice(1, 2)
    for part, names in ((slice(3), ("R", "G", "B")), (green, ("grey",))):
        frame = Frame(counts[part].round(), names, None, (100.0,), 4095.0, "uint16", "a.tif")
        found = point_psf({1.0: FrameMean(frame)}, {}, pixel_um=3.1, stray="none")
        assert found.psf.shape == counts[part].shape
        assert decibels(found.psf, truth[part]) > 46
