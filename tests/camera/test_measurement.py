"""Development of frames, against values worked out by hand."""

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from nolens.camera import MOSAICS, Frame, dark_corner, develop
from nolens.errors import DataError, OptionError


def grey(rows, **about) -> Frame:
    counts = torch.as_tensor(rows, dtype=torch.float32)
    if counts.ndim == 2:
        counts = counts[None]
    names = {1: ("grey",), 3: ("R", "G", "B")}[len(counts)]
    known = {"channels": names, "mosaic": None, "black": (0.0,), "white": None}
    return Frame(counts, **(known | {"stored_as": "uint16", "source": "frame.tif"} | about))


def mosaic(rows, pattern="RGGB", **about) -> Frame:
    return grey(rows, channels=("mosaic",), mosaic=pattern, **about)


def test_black_level_is_subtracted_and_noise_below_it_is_kept():
    result = develop(grey([[100, 98], [103, 300]], black=(100.0,)))
    assert result.values.tolist() == [[[0, -2], [3, 200]]]
    assert result.valid.all()


def test_given_black_replaces_the_frames_own():
    result = develop(grey([[100, 98], [103, 300]], black=(100.0,)), black=90)
    assert result.values.tolist() == [[[10, 8], [13, 210]]]


@pytest.mark.parametrize("pattern", MOSAICS)
def test_each_cell_becomes_one_pixel(pattern):
    colours = {"R": iter([11.0]), "G": iter([20.0, 24.0]), "B": iter([37.0])}
    cell = [next(colours[letter]) for letter in pattern]
    blacks = (1.0, 2.0, 3.0, 4.0)
    rows = torch.tensor(cell).reshape(2, 2).repeat(3, 2)
    rows = torch.nn.functional.pad(rows, (0, 1, 0, 1), value=9999)
    result = develop(mosaic(rows, pattern, black=blacks))
    black_of = [[b for b, c in zip(blacks, pattern, strict=True) if c == name] for name in "RGB"]
    expected = [11 - black_of[0][0], 22 - sum(black_of[1]) / 2, 37 - black_of[2][0]]
    assert result.values.shape == (3, 3, 2)
    assert result.channels == ("R", "G", "B")
    for plane, value in zip(result.values, expected, strict=True):
        assert (plane == value).all()


def test_a_saturated_pixel_spoils_only_its_colour_of_its_cell():
    rows = [[1, 2, 3, 4], [5, 6, 7, 255]]
    result = develop(mosaic(rows, white=255.0))
    assert result.valid.tolist() == [[[True, True]], [[True, True]], [[True, False]]]
    rows[0][1] = 255
    assert develop(mosaic(rows, white=255.0)).valid[1].tolist() == [[False, True]]


def test_white_can_be_given():
    assert develop(grey([[1, 2], [3, 4]]), white=3).valid.tolist() == [[[True, True], [False] * 2]]


def test_pixels_that_pile_up_at_the_largest_count_are_saturated():
    counts = torch.poisson(torch.full((60, 80), 200.0)).clamp(max=225)
    piled = develop(grey(counts.tolist()))
    assert torch.equal(piled.valid[0], counts < 225)
    assert develop(grey(counts.tolist()), white=1000).valid.all()
    # Most of a faint frame has one of a few counts.
    faint = (torch.rand(60, 80) < 0.9).float()
    assert develop(grey(faint.tolist())).valid.all()


def test_dark_frame_holds_the_black_level():
    frame = grey([[110, 120], [130, 140]], black=(100.0,))
    dark = grey([[101, 102], [103, 255]], black=(100.0,), white=255.0)
    result = develop(frame, dark=dark)
    assert result.values.tolist() == [[[9, 18], [27, -115]]]
    assert result.valid.tolist() == [[[True, True], [True, False]]]


def test_flat_field_undoes_vignetting():
    scene = torch.tensor([[40.0, 80.0], [120.0, 160.0]])
    gain = torch.tensor([[0.5, 1.0], [1.5, 1.0]])
    frame = grey(scene * gain + 10, black=(10.0,))
    result = develop(frame, flat=grey(gain * 200 + 10, black=(10.0,)))
    torch.testing.assert_close(result.values[0], scene)


def test_flat_field_is_normalised_by_colour():
    # The flat's lamp is red: that is no gain of the sensor.
    flat = torch.tensor([[400.0, 100.0], [100.0, 50.0]]).repeat(2, 2)
    rows = torch.arange(1.0, 17).reshape(4, 4)
    plain, corrected = develop(mosaic(rows)), develop(mosaic(rows), flat=mosaic(flat))
    torch.testing.assert_close(corrected.values, plain.values)


def test_pixels_dark_in_the_flat_are_left_out():
    result = develop(grey([[1, 2], [3, 4]]), flat=grey([[7, 7], [7, 0]]))
    assert result.valid.tolist() == [[[True, True], [True, False]]]
    assert result.values.isfinite().all()
    assert result.values[0, 0].tolist() == [1, 2]


def test_binning_averages_and_drops_the_remainder():
    rows = torch.arange(35.0).reshape(5, 7)
    result = develop(grey(rows, white=34.0), bin_by=2)
    assert result.values.shape == (1, 2, 3)
    assert result.values[0, 0].tolist() == [4, 6, 8]
    assert result.valid.all()
    spoilt = develop(grey(rows, white=25.0), bin_by=2)
    assert spoilt.valid.tolist() == [[[True] * 3, [True, True, False]]]


def test_channels_are_chosen():
    counts = torch.stack([torch.tensor([[1.0, 2.0]]) * k for k in (1, 2, 6)])
    frame = grey(counts, white=12.0)
    assert develop(frame, channels="grey").values.tolist() == [[[3, 6]]]
    assert develop(frame, channels="grey").valid.tolist() == [[[True, False]]]
    green = develop(frame, channels="g")
    assert (green.channels, green.values.tolist()) == (("G",), [[[2, 4]]])
    assert develop(frame, channels="Rg").channels == ("R", "G")
    assert develop(frame).channels == ("R", "G", "B")
    assert develop(grey([[1, 2]]), channels="grey").channels == ("grey",)


@given(bin_by=st.integers(1, 5), height=st.integers(10, 16), width=st.integers(10, 16))
def test_binned_mosaic_keeps_the_mean(bin_by, height, width):
    rows = torch.rand(height, width, generator=torch.manual_seed(height * width)) * 1000
    result = develop(mosaic(rows), bin_by=bin_by)
    rows_used = height // 2 // bin_by * bin_by * 2
    columns_used = width // 2 // bin_by * bin_by * 2
    used = rows[:rows_used, :columns_used]
    torch.testing.assert_close(result.values[0].mean(), used[::2, ::2].mean())
    torch.testing.assert_close(
        result.values[1].mean(), (used[::2, 1::2].mean() + used[1::2, ::2].mean()) / 2
    )


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([[0.0, 0.0]], "is 0 everywhere"),
        ([[7.0, 7.0]], "is 7 everywhere"),
        ([[1.0, math.nan]], "1 values that are NaN or infinite"),
        ([[1.0, math.inf]], "NaN or infinite"),
        ([[1.0, 3e38]], "values up to 3e[+]38, and 1e-15 to 1e[+]15 can be computed with"),
        ([[0.0, 1e-30]], "values up to 1e-30"),
        ([[1.0, 2.0]], "nowhere brighter than its black level 2"),
    ],
)
def test_data_that_are_no_measurement(rows, message):
    with pytest.raises(DataError, match=message):
        develop(grey(rows, black=(2.0,)))


def test_saturated_everywhere():
    with pytest.raises(DataError, match="no pixel of channel G"):
        develop(grey([[[1, 2]], [[9, 8]], [[1, 2]]], white=8.0))


def test_a_channel_without_data():
    frame = grey([[[1, 2]], [[0, 0]], [[1, 2]]])
    with pytest.raises(DataError, match=r"channel G of frame.tif is zero everywhere.*--channels"):
        develop(frame)
    assert develop(frame, channels="rb").channels == ("R", "B")


@pytest.mark.parametrize("choice", ["", "x", "gg", "rgbx", "none"])
def test_unknown_channels(choice):
    with pytest.raises(OptionError, match="R, G, B"):
        develop(grey(torch.rand(3, 4, 4)), channels=choice)
    with pytest.raises(OptionError, match="give all, grey"):
        develop(grey(torch.rand(4, 4)), channels=choice)


@pytest.mark.parametrize("bin_by", [0, -1, 5])
def test_binning_that_does_not_fit(bin_by):
    with pytest.raises(OptionError, match="from 1 to 4"):
        develop(grey(torch.rand(4, 6)), bin_by=bin_by)


def test_dark_and_flat_must_fit():
    frame = mosaic(torch.rand(4, 6))
    with pytest.raises(DataError, match=r"dark frame .*\(1, 6, 4\).*\(1, 4, 6\)"):
        develop(frame, dark=mosaic(torch.rand(6, 4)))
    with pytest.raises(DataError, match=r"flat field .* BGGR, but .* RGGB"):
        develop(frame, flat=mosaic(torch.rand(4, 6), "BGGR"))
    with pytest.raises(DataError, match=r"flat field .* nowhere brighter than black"):
        develop(frame, flat=mosaic(torch.zeros(4, 6)))
    with pytest.raises(DataError, match=r"dark frame .* NaN"):
        develop(frame, dark=mosaic(torch.full((4, 6), math.nan)))
    with pytest.raises(DataError, match="nowhere brighter than its dark frame"):
        develop(frame, dark=frame)
    with pytest.raises(OptionError, match="both a dark frame"):
        develop(frame, dark=mosaic(torch.zeros(4, 6)), black=1)


def test_one_row_has_no_cell():
    with pytest.raises(DataError, match=r"1×4 pixels: no 2×2 superpixel"):
        develop(mosaic([[1, 2, 3, 4]]))


def test_the_frame_is_not_changed():
    frame = mosaic(torch.rand(4, 4) + 1, black=(0.5,))
    before = frame.counts.clone()
    develop(frame, flat=frame, bin_by=2)
    assert torch.equal(frame.counts, before)


def test_dark_corner_is_the_darkest_of_four():
    counts = torch.full((1, 40, 50), 500.0)
    counts[:, 5:15, 5:15] = 90
    counts[:, -15:-5, -15:-5] = 80
    frame = grey(counts)
    assert dark_corner(frame) == 80
    assert dark_corner(replace(frame, counts=counts.flip(2))) == 80
    counts[:, 25:35, 35:45] = 95
    assert dark_corner(frame) == 90
    with pytest.raises(DataError, match="too small"):
        dark_corner(grey(torch.rand(14, 40)))
