"""Values of pixels that the page reads out, against the files and the camera that they are of."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from nolens.camera import Frame
from nolens.errors import NolensError
from nolens.files import (
    RunRecord,
    read_camera,
    write_frame,
    write_png,
    write_record,
    write_tiff16,
    write_tiff32,
)
from nolens.files.ome import write_ome_tiff
from nolens.operators import PixelRectangle
from nolens.studio.pixel_values import pixel_values
from nolens.twin import FieldMap, preview_model


def unpacked(message: bytes) -> tuple[dict[str, Any], NDArray[np.float64]]:
    """Header, and values (height, width, channels) in the unit that it names."""
    length = int.from_bytes(message[:4], "little")
    header = json.loads(message[4 : 4 + length])
    numbers = np.frombuffer(message[4 + length :], "<u2").astype(float)
    shape = header["height"], header["width"], len(header["channels"])
    return header, header["offset"] + header["step"] * numbers.reshape(shape)


def test_radiance_is_that_of_the_reconstruction(tmp_path: Path) -> None:
    radiance = torch.rand((3, 31, 47)) * 1e-4
    write_tiff16(tmp_path / "out.tif", radiance)
    header, values = unpacked(pixel_values(tmp_path / "out.tif", None))
    true = radiance.permute(1, 2, 0).numpy()
    white = values.max()
    assert header["unit"] == "radiance" and header["clipped"]
    np.testing.assert_allclose(values, np.minimum(true, white), atol=white / 65535)
    write_tiff32(tmp_path / "floats.tif", radiance)
    header, values = unpacked(pixel_values(tmp_path / "floats.tif", None))
    assert header["unit"] == "radiance" and not header["clipped"]
    np.testing.assert_allclose(values, true, atol=1e-4 / 65535)


def test_bands_have_their_names(tmp_path: Path) -> None:
    """Also where three would be colours; each has steps of its own, which noughts need not."""
    for count in (3, 5):
        bands = torch.rand((count, 6, 8)) * torch.logspace(-4, 3, count)[:, None, None]
        bands[1] = 0
        names = [f"{450 + 30 * number} nm" for number in range(count)]
        path = tmp_path / f"{count}.ome.tif"
        write_ome_tiff(path, bands[None], "T", names, {})
        header, values = unpacked(pixel_values(path, None))
        assert (header["unit"], header["channels"]) == ("radiance", names)
        np.testing.assert_allclose(values, bands.permute(1, 2, 0).numpy(), rtol=0.01, atol=1e-7)


def test_counts_are_those_of_the_measurement(tmp_path: Path) -> None:
    counts = torch.randint(0, 4096, (1, 30, 40)).float()
    frame = Frame(counts, ("mosaic",), "BGGR", (256.0,), 4095.0, "uint16", "test")
    write_frame(tmp_path / "raw.dng", frame)
    header, values = unpacked(pixel_values(tmp_path / "raw.dng", None))
    assert (header["unit"], header["mosaic"], header["step"]) == ("counts", "BGGR", [1.0])
    np.testing.assert_array_equal(values[..., 0], counts[0].numpy())


def test_picture_for_a_screen_is_read_as_light(tmp_path: Path) -> None:
    radiance = torch.rand((1, 20, 30))
    write_png(tmp_path / "out.png", radiance, white=1.0)
    header, values = unpacked(pixel_values(tmp_path / "out.png", None))
    assert header["unit"] == "of white"
    np.testing.assert_allclose(values[..., 1], radiance[0].numpy(), atol=0.005)


@pytest.mark.parametrize("flip", ["none", "horizontal", "vertical"])
def test_angles_are_those_of_the_cameras_layers(tmp_path: Path, flip: str) -> None:
    twin = preview_model(read_camera("small"))
    region = PixelRectangle(-6, 11, 60, 70)
    write_tiff16(tmp_path / "out.tif", torch.rand((1, 60, 70)))
    stated = {"sensor": list(twin.shape), "window": [-6, 11, 60, 70], "bin": 1, "flip": flip}
    write_record(
        tmp_path / "out.json",
        RunRecord(
            started="",
            inputs={},
            versions={},
            parameters=stated,
            result={},
            history=[],
            warnings=[],
        ),
    )
    header, _ = unpacked(pixel_values(tmp_path / "out.tif", "small"))
    angles = header["angles"]
    downs, rights = FieldMap(twin, region).tangents()
    for row, column in ((0, 0), (20, 65), (59, 30)):
        picture = (
            69 - column if flip == "horizontal" else column,
            (59 - row if flip == "vertical" else row),
        )
        across, down = (each - at for each, at in zip(picture, angles["axis"], strict=True))
        at = math.hypot(across, down)
        tangent = np.interp(at / angles["step"], range(256), angles["tangents"])
        signs = (-1 if flip == "horizontal" else 1), (-1 if flip == "vertical" else 1)
        assert tangent * across / at == pytest.approx(
            signs[0] * float(rights[row, column]), abs=1e-4
        )
        assert tangent * down / at == pytest.approx(signs[1] * float(downs[row, column]), abs=1e-4)


@pytest.mark.parametrize("window", [None, "all", [1, 2, 3], [0, 0, "a", 4]])
def test_records_that_say_no_angles_give_none(tmp_path: Path, window: object) -> None:
    write_tiff16(tmp_path / "out.tif", torch.rand((1, 6, 7)))
    (tmp_path / "out.json").write_text(
        json.dumps(
            {"started": "", "inputs": {}, "versions": {}, "result": {}, "history": [],
             "warnings": [], "parameters": {"window": window, "bin": 1, "sensor": [6, 7]}}
        )
    )  # fmt: skip
    header, _ = unpacked(pixel_values(tmp_path / "out.tif", "small"))
    assert header["angles"] is None


def test_what_is_no_picture_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out.tif").write_bytes(b"none")
    with pytest.raises(NolensError, match=r"out\.tif"):
        pixel_values(tmp_path / "out.tif", None)
