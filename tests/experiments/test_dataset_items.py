"""Items of data sets: what is drawn for them, and the noise of their measurements."""

from dataclasses import replace
from itertools import pairwise

import pytest
import torch

from nolens.camera import LoadedCamera, preset
from nolens.experiments.dataset_items import (
    Variation,
    View,
    draw_item,
    simulate_item,
    split_of_scenes,
)
from nolens.experiments.dead_leaves import dead_leaves
from nolens.twin import PlaneView, Twin, irradiate, mosaic, photocurrents

LUMINANCE = 200.0


@pytest.fixture(scope="module")
def view() -> View:
    camera = preset("small")
    sensor = camera.sensor.model_copy(update={"rows": 96, "columns": 128})
    loaded = LoadedCamera.of(camera.model_copy(update={"sensor": sensor}))
    return View(loaded, 300e3, angle_deg=6.0, wavelengths=1)


def test_noise_is_that_of_the_stated_sensor(view: View) -> None:
    twin = Twin.of(view.loaded)
    model = view.model(twin)
    variation = Variation(
        gain=(2, 2), read_noise=(4, 4), black_error_counts=(7, 7), haze=(0.1, 0.1), fill=(0.5, 0.5)
    )
    settings = draw_item(variation, (1, 1, 1), seed=3, index=5, scene=5)
    support = model.field.support
    picture = dead_leaves(support.height, support.width, 1)
    item = simulate_item(settings, model, picture, LUMINANCE)
    sensor = twin.camera.sensor
    plane = PlaneView(item.truth, view.distance_um)
    light = irradiate(
        twin, view.field(twin), (plane,), field_points=1, light=model.illuminant, wavelengths=1
    ).light
    currents = photocurrents(twin, model.illuminant, LUMINANCE)[:, None, None]
    rate = light * mosaic(currents.expand(-1, *light.shape), sensor.mosaic)
    electrons = (rate + 0.1 * rate.mean()) * item.figures["exposure_s"]
    assert float(electrons.max()) == pytest.approx(
        0.5 * (sensor.white_counts - sensor.black_counts) / (2 * sensor.counts_per_electron),
        rel=1e-3,
    )
    per_electron = 2 * sensor.counts_per_electron
    expected = sensor.black_counts + 7 + electrons * per_electron
    deviation = ((electrons + 4**2) * per_electron**2 + 1 / 12).sqrt()
    noise = ((item.frame.counts[0] - expected) / deviation).double()
    assert abs(float(noise.mean())) < 4 / noise.numel() ** 0.5
    assert float(noise.std()) == pytest.approx(1, abs=4 / (2 * noise.numel()) ** 0.5)
    # Alike where there is little light and much.
    bright = electrons > electrons.median()
    assert float(noise[bright].std()) == pytest.approx(float(noise[~bright].std()), abs=0.07)
    banded = simulate_item(replace(settings, banding_counts=9.0), model, picture, LUMINANCE)
    rows = (banded.frame.counts - item.frame.counts)[0].mean(dim=1)
    assert float(rows.std()) == pytest.approx(9, rel=0.25)


def test_another_range_changes_no_other_value_and_no_other_item() -> None:
    def drawn(variation: Variation, index: int) -> object:
        return draw_item(variation, (2, 3, 4), seed=11, index=index, scene=0)

    plain = Variation(fill=(0.2, 0.9), psf_scale=(0.9, 1.1))
    wider = replace(plain, psf_scale=(0.8, 1.2), mirror=True)
    first, other = drawn(plain, 7), drawn(wider, 7)
    scale = 1 + 2 * (first.psf_scale - 1)  # type: ignore[attr-defined]
    assert other.psf_scale == pytest.approx(scale)  # type: ignore[attr-defined]
    same = {"psf_scale": 1.0, "mirrored": False}
    assert replace(first, **same) == replace(other, **same)  # type: ignore[type-var]
    assert drawn(plain, 7) == first and drawn(plain, 8) != first
    views = {drawn(plain, index).view for index in range(300)}  # type: ignore[attr-defined]
    assert views == set(range(24))


def test_scenes_of_equal_content_are_in_one_split() -> None:
    contents = [*range(20), *range(20)]
    split = split_of_scenes(5, contents, 0.1, 0.2)
    assert split[:20] == split[20:]
    assert [split[:20].count(name) for name in ("train", "validation", "test")] == [14, 2, 4]


def test_leaves_look_alike_at_every_size() -> None:
    """Amplitudes of natural pictures fall with the spatial frequency to about the first power."""
    picture = dead_leaves(128, 160, 4)
    assert picture.shape == (3, 128, 160) and float(picture.max()) == 1
    assert torch.equal(picture, dead_leaves(128, 160, 4))
    spectrum = torch.fft.rfft2(
        torch.stack([dead_leaves(128, 128, seed).mean(0) for seed in (1, 2)])
    )
    power = spectrum.abs().square().mean(dim=0)
    frequency = torch.fft.fftfreq(128)[:, None].square() + torch.fft.rfftfreq(128).square()
    octaves = [
        float(power[(frequency > low**2) & (frequency <= 4 * low**2)].mean())
        for low in (1 / 64, 1 / 32, 1 / 16, 1 / 8)
    ]
    falls = [one / other for one, other in pairwise(octaves)]
    assert all(2 < fall < 12 for fall in falls)
