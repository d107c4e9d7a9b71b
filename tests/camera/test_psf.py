"""PSFs that fit and PSFs that are refused."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import torch.nn.functional as nnf

from nolens.camera import Measurement, PsfGeometry, check_psf, develop, prepare_psf
from nolens.errors import DataError, OptionError
from nolens.files import read_frame
from nolens.operators import CroppedConvolution, PixelRectangle

DATA = Path(__file__).parents[2].parent / "shared" / "data"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"the real data are not in {DATA}")


def measurement(values, channels=("grey",), mosaic=None, source="raw.dng", valid=None):
    valid = torch.ones_like(values, dtype=torch.bool) if valid is None else valid
    return Measurement(values, valid, channels, mosaic, source)


def spot(height, width, planes=1, **about):
    """A Gaussian spot over slightly negative noise."""
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    spot = 100 * torch.exp(-((y - height // 2) ** 2 + (x - width // 2) ** 2) / 8.0)
    noise = torch.randn(planes, height, width, generator=torch.manual_seed(1)) * 0.1
    return measurement(spot + noise, source="psf.tif", **about)


def scene(height, width, planes=1, **about):
    return measurement(torch.rand(planes, height, width), **about)


def smooth(values, width):
    """Blurred by a Gaussian."""
    reach = math.ceil(3 * width)
    line = torch.exp(-(torch.arange(-reach, reach + 1) ** 2) / (2 * width**2))
    padded = nnf.pad(values[None], (reach,) * 4)
    kernel = torch.outer(line, line)[None, None]
    return nnf.conv2d(padded, kernel)[0]


def cloud(height, width):
    """Lines everywhere, up to the edges."""
    light = smooth(torch.rand(1, height, width, generator=torch.manual_seed(2)) ** 4, 1.0)
    return replace(measurement(light, source="psf.tif"), black_stated=True)


RGB = {"channels": ("R", "G", "B")}


def test_same_size_is_kept_with_its_noise():
    """Below zero, too: the mean of the dark stays at zero."""
    psf = spot(24, 30)
    result = prepare_psf(psf, scene(24, 30))
    assert torch.equal(result.values, psf.values)
    assert (psf.values < 0).any()
    assert result.warnings == ()


def test_a_black_level_that_is_too_high_is_made_up_for():
    """By light that is never below zero; so little takes 11 dB through sparse lenslets."""
    generator = torch.manual_seed(2)
    spots = torch.zeros(1, 120, 150)
    spots[:, 5::20, 5::20] = 100.0
    right = spots + (torch.randn(spots.shape, generator=generator) * 0.5).round()
    for wrong in (0.0, 0.1, 0.7):
        result = prepare_psf(measurement(right - wrong, source="psf.tif"), scene(120, 150))
        assert float((result.values - right).mean()) == pytest.approx(0, abs=0.02)
    lit = prepare_psf(measurement(right + 1, source="psf.tif"), scene(120, 150))
    assert torch.equal(lit.values, right + 1)


def test_grey_serves_colour_and_colour_serves_its_own():
    assert prepare_psf(spot(24, 30), scene(24, 30, 3, **RGB)).values.shape == (1, 24, 30)
    assert prepare_psf(spot(24, 30, 3, **RGB), scene(24, 30, 3, **RGB)).values.shape[0] == 3


def test_finer_psf_is_binned():
    psf = spot(48, 60)
    result = prepare_psf(psf, scene(24, 30), PsfGeometry(2))
    blocks = psf.values.reshape(1, 24, 2, 30, 2).mean(dim=(2, 4))
    torch.testing.assert_close(result.values, blocks)
    assert prepare_psf(spot(49, 61), scene(24, 30), PsfGeometry(2)).values.shape == (1, 24, 30)


@pytest.mark.parametrize("size", [(48, 60), (31, 40), (24, 31)])
def test_wider_psf_is_kept(size):
    assert prepare_psf(spot(*size), scene(24, 30), PsfGeometry(extended=True)).values.shape == (
        1,
        *size,
    )


@pytest.mark.parametrize(
    ("size", "options", "error", "words"),
    [
        ((48, 60), {}, DataError, ("48×60", "24×30", "--psf-scale 2", "--psf-extent", "wide")),
        ((50, 60), {}, DataError, ("no N fits", "--psf-extent", "wide")),
        (
            (48, 60),
            {"scale": 3},
            DataError,
            ("16×20", "--psf-scale 2 would fit", "--psf-extent"),
        ),
        ((50, 60), {"scale": 2}, DataError, ("25×30", "no scale would fit")),
        ((24, 30), {"scale": 2}, DataError, ("12×15", "leave it out")),
        ((24, 30), {"extended": True}, DataError, ("not extended", "Leave out --psf-extent wide")),
        ((20, 29), {}, DataError, ("20×29", "24×30", "at least as large")),
        ((20, 60), {"scale": 2}, DataError, ("20×60", "without --psf-scale")),
        ((30, 24), {}, DataError, ("30×24", "turned by 90°")),
        ((48, 60), {"scale": 2, "extended": True}, DataError, ("not extended", "or --psf-scale")),
        ((60, 80), {"scale": 3, "extended": True}, DataError, ("20×26", "not extended")),
        ((48, 60), {"scale": 0}, OptionError, ("from 1 on",)),
    ],
)
def test_sizes_that_do_not_fit(size, options, error, words):
    with pytest.raises(error) as raised:
        prepare_psf(spot(*size), scene(24, 30), PsfGeometry(**options))
    for word in words:
        assert word in str(raised.value)


def test_a_psf_that_is_smaller_in_one_direction_is_dark_there():
    """Around its middle, so that its zero shift stays where it was; what is wider stays so."""
    for size, wanted in (((30, 20), (30, 31)), ((23, 31), (30, 31)), ((40, 21), (40, 31))):
        psf = spot(*size)
        result = prepare_psf(psf, scene(30, 31))
        assert result.values.shape == (1, *wanted)
        peak = np.unravel_index(int(result.values.argmax()), wanted)
        assert peak == (wanted[0] // 2, wanted[1] // 2)
        assert float(result.values.sum()) == pytest.approx(float(psf.values.sum()))
        (note,) = result.notes
        assert f"{size[0]}×{size[1]}" in note and "added around the PSF's middle" in note
        assert result.warnings == ()
    (note,) = prepare_psf(spot(24, 34), scene(24, 30)).notes
    assert "taken as extended" in note
    (warning,) = prepare_psf(cloud(30, 20), scene(30, 31)).warnings
    assert "up to the sensor's edges" in warning


def test_a_psf_that_goes_on_beside_the_sensor():
    lit = cloud(40, 40)
    (warning,) = prepare_psf(lit, scene(40, 40)).warnings
    assert re.search(r"psf\.tif has light up to the sensor's edges.*--psf-extent wide", warning)
    assert prepare_psf(cloud(80, 80), scene(40, 40), PsfGeometry(extended=True)).warnings == ()
    inside = replace(lit, values=nnf.pad(lit.values[:, 8:32, 8:32], (8,) * 4))
    assert prepare_psf(replace(inside, valid=lit.valid), scene(40, 40)).warnings == ()


@pytest.mark.parametrize("blur", [0.8, 2.0])
@pytest.mark.parametrize("grain", [0.0, 0.05])
def test_files_that_are_swapped(blur, grain):
    """Spots as wide as `blur`; a scene of blocks, and one of two points, which blurs nothing."""
    generator = torch.manual_seed(5)
    psf = torch.zeros(1, 120, 140)
    psf[0, torch.randint(20, 100, (60,), generator=generator),
        torch.randint(20, 120, (60,), generator=generator)] = 1  # fmt: skip
    psf = smooth(psf, blur)
    blocks = nnf.interpolate(torch.rand(1, 1, 10, 12, generator=generator), scale_factor=5)[0]
    points = torch.zeros(1, 50, 60)
    points[0, 20, 20] = points[0, 24, 25] = 1
    for view, told in ((blocks, True), (points, False)):
        light = CroppedConvolution(psf, (120, 140), PixelRectangle.centred(50, 60, (120, 140)))(
            view
        )
        pair = [
            measurement(each / each.max() + grain * torch.rand(each.shape), source=name)
            for each, name in ((psf, "psf.tif"), (light, "raw.tif"))
        ]
        pair = [replace(each, black_stated=True) for each in pair]
        assert not any("swapped" in text for text in prepare_psf(*pair).warnings)
        wrong = prepare_psf(*reversed(pair)).warnings
        assert any("psf.tif has finer detail than the PSF raw.tif" in t for t in wrong) == told


def test_colours_that_do_not_fit():
    with pytest.raises(DataError, match=r"R, G, B.*grey.*--channels grey"):
        prepare_psf(spot(24, 30, 3, **RGB), scene(24, 30))
    with pytest.raises(DataError, match=r"R, G, B.*has G: .*--channels"):
        prepare_psf(spot(24, 30, 3, **RGB), scene(24, 30, channels=("G",)))
    with pytest.raises(DataError, match=r"RGGB, but raw.dng has BGGR"):
        prepare_psf(spot(24, 30, 3, mosaic="RGGB", **RGB), scene(24, 30, 3, mosaic="BGGR", **RGB))


def noise(seed, shape=(1, 300, 400)):
    return torch.randn(shape, generator=torch.manual_seed(seed))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    "make",
    [
        noise,
        lambda seed: (noise(seed) * 3 + 100).round(),
        lambda seed: (noise(seed) * 0.3).round(),
        lambda seed: torch.rand(1, 300, 400, generator=torch.manual_seed(seed)),
        lambda seed: -noise(seed).abs(),
        lambda seed: torch.poisson(torch.full((1, 300, 400), 20.0), torch.manual_seed(seed)),
        lambda seed: noise(seed, (3, 300, 400)),
    ],
)
def test_noise_is_no_psf(make, seed):
    values = make(seed)
    names = ("grey",) if len(values) == 1 else ("R", "G", "B")
    with pytest.raises(DataError, match="nothing above its background"):
        prepare_psf(measurement(values, names), measurement(values, names))


@pytest.mark.parametrize("value", [0.0, 5.0, -5.0])
def test_a_constant_is_no_psf(value):
    values = torch.full((1, 40, 50), value)
    with pytest.raises(DataError, match="nothing above its background"):
        prepare_psf(measurement(values), measurement(values))


@pytest.mark.parametrize("kind", ["delta", "coded mask", "speckle", "dim spot"])
def test_unusual_psfs_are_accepted(kind):
    values = noise(0, (1, 64, 80)) * 0.01
    if kind == "delta":
        values = torch.zeros(1, 64, 80)
        values[0, 32, 40] = 1
    elif kind == "coded mask":
        values += (
            (noise(1, (1, 16, 20)) > 0).float().repeat_interleave(4, 1).repeat_interleave(4, 2)
        )
    elif kind == "speckle":
        values += torch.nn.functional.avg_pool2d(noise(1, (1, 66, 82)), 3, 1).square()
    else:
        values[0, 30:33, 30:33] += 0.1
    psf = measurement(values)
    check_psf(psf, values)
    with pytest.raises(DataError, match=r"raw\.dng and the PSF raw\.dng hold the same"):
        prepare_psf(psf, measurement(values.clone()))


def test_saturated_psf_is_doubted():
    psf = spot(40, 50)
    valid = torch.ones(1, 40, 50, dtype=torch.bool)
    valid[0, 20, 25] = False
    few = Measurement(psf.values, valid, psf.channels, None, "psf.tif")
    assert prepare_psf(few, scene(40, 50)).warnings == ()
    valid[0, 20, 24:28] = False
    (warning,) = prepare_psf(few, scene(40, 50)).warnings
    assert re.search(r"0\.2 % of the PSF psf\.tif is saturated", warning)


def test_saturated_measurement_is_doubted():
    psf, data = spot(40, 50), scene(40, 50)
    valid = torch.ones(1, 40, 50, dtype=torch.bool)
    valid[0, :2, :10] = False
    few = replace(data, valid=valid)
    assert prepare_psf(psf, few).warnings == ()
    valid[0, :2, :30] = False
    (warning,) = prepare_psf(psf, few).warnings
    assert re.search(r"3 % of raw\.dng cannot be used", warning)


def test_black_level_that_was_not_subtracted_is_doubted():
    psf = spot(60, 80)
    lifted = measurement(psf.values + 2)
    (warning,) = prepare_psf(lifted, scene(60, 80)).warnings
    assert "--black auto" in warning
    stated = replace(lifted, black_stated=True)  # Light may fall everywhere.
    assert not any("--black" in text for text in prepare_psf(stated, scene(60, 80)).warnings)


def test_noisy_psf_is_doubted():
    """The noise of its spot, of deviation 0.1, has this part of the power."""
    faint = measurement(spot(60, 80).values + torch.randn(1, 60, 80), source="psf.tif")
    part = 60 * 80 * 1.01 / float(faint.values.square().sum())
    (warning,) = prepare_psf(faint, scene(60, 80)).warnings
    percent = float(re.match(r"(.*) % of the power of the PSF psf\.tif is noise", warning)[1])
    assert percent == pytest.approx(100 * part, rel=0.1)


@needs_data
def test_real_psfs_are_accepted():
    hand = develop(read_frame(DATA / "diffusercam-hand" / "psf_sample.tif"))
    assert check_psf(hand, hand.values) == []
    raw = develop(read_frame(DATA / "diffusercam-hand" / "rawdata_hand_sample.tif"))
    assert prepare_psf(hand, raw).warnings == ()
    assert any("swapped" in text for text in prepare_psf(raw, hand).warnings)
    pairs = DATA / "diffusercam-pairs"
    wide = develop(read_frame(pairs / "psf_estimate.npy"))
    colour = develop(read_frame(pairs / "diffuser" / "im43.npy", bgr=True))
    prepared = prepare_psf(wide, colour, PsfGeometry(extended=True))
    assert prepared.values.shape[-2] >= 270 and prepared.values.shape[-1] >= 480
    assert "without light are cut off" in prepared.notes[0]
    assert prepared.values.sum() == wide.values.clamp_min(0).sum()
    with pytest.raises(DataError, match=r"--psf-scale 2\).*--psf-extent wide"):
        prepare_psf(wide, colour)
