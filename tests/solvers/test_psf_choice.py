"""What a PSF's file shows is chosen by what explains the measurement."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.camera import Frame, PsfGeometry
from nolens.errors import DataError
from nolens.operators import CroppedConvolution, PixelRectangle
from nolens.solvers import Development, PsfSettings, choose_psf

SENSOR = (132, 168)
BLACK, PEAK, NOISE = 200.0, 3000.0, 2.0


def frame(counts: Tensor, name: str, *, stated: bool = True) -> Frame:
    """Without a black level; a TIFF of whole counts says none."""
    kind = "float32" if stated else "uint16"
    return Frame(counts, ("grey",), None, (0.0,), None, kind, name, black_stated=stated)


def spots(size: tuple[int, int], within: float) -> Tensor:
    """A PSF of small spots around the middle, dark beside them, that is no mirror image of itself.

    They lie within a fraction of the size.
    """
    generator = torch.Generator().manual_seed(4)
    rows, columns = (round(within * side) for side in size)
    points = (torch.rand(1, 1, rows, columns, generator=generator) < 0.004).float()
    points = points * torch.rand(points.shape, generator=generator)
    soft = nnf.avg_pool2d(nnf.avg_pool2d(points, 3, 1, 1), 3, 1, 1)[0]
    top, left = size[0] // 2 - rows // 2, size[1] // 2 - columns // 2
    beside = (left, size[1] - columns - left, top, size[0] - rows - top)
    return nnf.pad(soft * PEAK / soft.max(), beside)


def measured(psf: Tensor) -> Tensor:
    """Counts of a scene of rectangles, with noise."""
    generator = torch.Generator().manual_seed(5)
    support = PixelRectangle.centred(88, 112, SENSOR)
    scene = torch.full((1, 88, 112), 0.05)
    for _ in range(30):
        top, left = (int(each) for each in torch.randint(0, 80, (2,), generator=generator))
        tall, wide = (int(each) for each in torch.randint(3, 24, (2,), generator=generator))
        scene[:, top : top + tall, left : left + wide] = float(torch.rand(1, generator=generator))
    light = CroppedConvolution(psf, SENSOR, support)(scene).clamp_min(0)
    noise = NOISE * torch.randn(light.shape, generator=generator)
    return PEAK * light / light.max() + noise


def finer(psf: Tensor, by: int) -> Tensor:
    return psf.repeat_interleave(by, -2).repeat_interleave(by, -1)


@pytest.fixture(scope="module")
def inside() -> Tensor:
    """A PSF that ends before the sensor does."""
    return spots(SENSOR, 0.7)


@pytest.fixture(scope="module")
def raw(inside: Tensor) -> Frame:
    return frame(measured(inside), "raw.tif")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda psf: psf, ()),
        (lambda psf: finer(psf, 4), ("4 times finer (--psf-scale 4): ", "extended")),
        (lambda psf: psf.flip(-1), ("mirrored left to right (--psf-flip horizontal): ", "it is")),
        (lambda psf: psf.flip(-2), ("upside down (--psf-flip vertical): ",)),
        (lambda psf: psf.flip(-2, -1), ("rotated by 180° (--psf-flip both): ",)),
        (lambda psf: finer(psf.flip(-1), 2), ("2 times finer", "--psf-flip horizontal")),
        (lambda psf: psf[:, 16:-16, 20:-20], ("a part, dark around it (--psf-scale 1)",)),
        (lambda psf: nnf.pad(psf, (30, 30, 20, 20)), ("extended (--psf-extent wide)",)),
        (lambda psf: psf[:, :, 18:-18], ()),  # Square: sizes that differ in one direction only.
        (lambda psf: finer(psf[:, :, 18:-18], 2), ("2 times finer (--psf-scale 2), dark beside",)),
    ],
    ids=[
        "same", "finer", "mirrored", "upside down", "rotated", "finer and mirrored", "cropped",
        "padded", "square", "finer and square",
    ],
)  # fmt: skip
def test_the_psf_is_the_right_one_again(
    change: Callable[[Tensor], Tensor], words: tuple[str, ...], inside: Tensor, raw: Frame
) -> None:
    """So pictures are the right PSF's."""
    choice = choose_psf(Development(frame(change(inside), "psf.tif")), raw)
    prepared = choice.development.prepared(choice.development.measurement(raw))
    torch.testing.assert_close(prepared.values, inside)
    assert len(choice.notes) == bool(words)
    assert all(word in choice.notes[0] for word in words)


def test_extended_of_sizes_that_finer_would_have_too() -> None:
    wide = spots((2 * SENSOR[0], 2 * SENSOR[1]), 0.8)
    raw = frame(measured(wide), "raw.tif")
    choice = choose_psf(Development(frame(wide, "psf.tif")), raw)
    assert choice.development.psf_geometry.extended
    assert "extended (--psf-extent wide): " in choice.notes[0] and "2 times" in choice.notes[0]
    both = choose_psf(Development(frame(finer(wide, 2), "psf.tif")), raw).development
    assert both.psf_geometry.extended and both.psf_geometry.scale == 2
    # Where noise hides what the PSF explains, it is not said to be finer.
    noise = 40 * NOISE * torch.randn(raw.counts.shape, generator=torch.Generator().manual_seed(6))
    odd = frame(nnf.pad(wide, (9, 9, 9, 9)), "psf.tif")
    buried = choose_psf(Development(odd), replace(raw, counts=raw.counts / 9 + noise))
    assert buried.development.psf_geometry == PsfGeometry(extended=True)


@pytest.mark.parametrize("of_both", [True, False])
def test_black_level_that_nobody_states(inside: Tensor, raw: Frame, of_both: bool) -> None:
    """Of the PSF alone where the measurement is darker than that."""
    psf = frame((inside + BLACK).round(), "psf.tif", stated=False)
    counts = raw.counts.clamp_min(0) + (BLACK if of_both else 0.0)
    choice = choose_psf(Development(psf), frame(counts, "raw.tif", stated=False))
    development = choice.development
    assert (development.black == BLACK) is of_both
    assert f"{BLACK:g} counts, read off" in choice.notes[0] and "--black 0" in choice.notes[0]
    measurement = development.measurement(frame(counts, "raw.tif", stated=False))
    prepared = development.prepared(measurement)
    torch.testing.assert_close(prepared.values, inside.round(), atol=0.5, rtol=0)
    torch.testing.assert_close(measurement.values, raw.counts.clamp_min(0))
    assert prepared.warnings == ()


def test_light_in_the_corners_is_no_black_level() -> None:
    """Some pixels are dark all the same; with a black level, those say it."""
    light = spots(SENSOR, 1.0)
    light[:, ::3] += 0.05 * PEAK
    raw = frame(measured(light), "raw.tif")
    psf = frame(light.round(), "psf.tif", stated=False)
    choice = choose_psf(Development(psf), replace(raw, black_stated=False))
    assert choice.development.black is None and choice.development.psf is psf
    lifted = frame((light + BLACK).round(), "psf.tif", stated=False)
    assert choose_psf(Development(lifted), raw).development.psf.black == (BLACK,)


def test_what_a_person_says_rules(inside: Tensor, raw: Frame) -> None:
    mirrored = Development(frame(inside.flip(-1), "psf.tif"))
    choice = choose_psf(mirrored, raw, PsfSettings(flip="none"))
    assert choice.development.psf_geometry.flip == "none" and choice.trials == ()
    fine = Development(frame(finer(inside, 2), "psf.tif"))
    choice = choose_psf(fine, raw, PsfSettings(scale=2, flip="none"))
    assert choice.notes == () and choice.trials == ()


def test_two_geometries_that_explain_alike_are_an_error() -> None:
    """A pinhole is one at any size."""
    hole = torch.zeros(1, *SENSOR)
    hole[:, SENSOR[0] // 2, SENSOR[1] // 2] = PEAK
    raw = frame(measured(hole), "raw.tif")
    large = nnf.pad(hole, (84, 84, 66, 66))
    with pytest.raises(DataError, match="too close to tell") as raised:
        choose_psf(Development(frame(large, "psf.tif")), raw)
    assert "--psf-extent wide" in str(raised.value) and "--psf-scale 2" in str(raised.value)


def test_a_psf_of_other_pixels_is_no_part(inside: Tensor, raw: Frame) -> None:
    coarse = Development(frame(nnf.avg_pool2d(inside[None], 2)[0], "psf.tif"))
    with pytest.raises(DataError, match=r"it was binned, or is another camera's"):
        choose_psf(coarse, raw)


def test_file_that_says_its_sensor(inside: Tensor, raw: Frame) -> None:
    """Half as large, the measurement is of merged pixels, or of the sensor's middle."""
    rows, columns = SENSOR
    point = replace(frame(finer(inside, 2), "psf.tif"), sensor=(2 * rows, 2 * columns))
    choice = choose_psf(Development(point), raw)
    assert choice.development.psf_geometry == PsfGeometry(2)
    assert choice.notes[0].endswith("as its file says")
    whole = spots((2 * rows, 2 * columns), 0.8)
    middle = frame(measured(whole), "raw.tif")
    point = replace(frame(whole, "psf.tif"), sensor=(2 * rows, 2 * columns))
    for extent in ("auto", "wide"):
        choice = choose_psf(Development(point), middle, PsfSettings(extent=extent))
        assert choice.development.psf_geometry == PsfGeometry(extended=True)


def test_finished_psf_has_no_black_level(inside: Tensor, raw: Frame) -> None:
    lifted = replace(raw, counts=raw.counts + BLACK)
    dark = frame(torch.full((1, *SENSOR), BLACK), "dark.tif")
    for levels in (Development(frame(inside, "psf.tif"), black=BLACK),
                   Development(frame(inside, "psf.tif"), dark=dark)):  # fmt: skip
        measurement = levels.measurement(lifted)
        torch.testing.assert_close(measurement.values, raw.counts, atol=1e-3, rtol=0)
        assert torch.equal(levels.prepared(measurement).values, inside)
