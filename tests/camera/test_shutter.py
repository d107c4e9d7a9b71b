"""Which lines of a rolling shutter are exposed when."""

import pytest
import torch

from nolens.camera import Sensor, Shutter, develop, developed_rows, preset
from nolens.camera.frame import Frame
from nolens.camera.toml import from_mapping
from nolens.errors import DataError


def _sensor(**values: object) -> Sensor:
    sensor = preset("small").sensor.model_dump() | {"rows": 16, "columns": 16} | values
    return from_mapping(Sensor, sensor, "sensor")


@pytest.mark.parametrize(
    ("rolling", "first"),
    [("down", [0]), ("up", [15]), ("out", [7, 8]), ("in", [0, 15])],
)
def test_lines_begin_one_after_another_from_where_the_direction_says(
    rolling: str, first: list[int]
) -> None:
    starts = Shutter.of(_sensor(line_time_us=10, rolling=rolling), 1e-3).starts_s
    assert (starts == 0).nonzero().flatten().tolist() == first
    halves = 1 if len(first) == 1 else 2
    assert float(starts.max()) == pytest.approx((16 // halves - 1) * 1e-5)
    assert starts.diff().abs().sum() == pytest.approx((16 - halves) * 1e-5)


def test_fractions_are_the_time_in_which_line_and_frame_overlap() -> None:
    shutter = Shutter.of(_sensor(line_time_us=10, rolling="up"), 37e-6)
    times = shutter.frames(7)
    fine = torch.linspace(0, shutter.duration_s, 70_001, dtype=torch.float64)
    fine = (fine[1:] + fine[:-1]) / 2
    begun = shutter.starts_s[:, None]
    exposed = ((fine >= begun) & (fine < begun + 37e-6)).float().unflatten(1, (7, -1)).sum(-1)
    expected = (exposed / exposed.sum(-1, keepdim=True)).T
    torch.testing.assert_close(shutter.fractions(times), expected, atol=1e-3, rtol=0)
    together = Shutter.of(_sensor(line_time_us=None, rolling=None), 1e-3)
    torch.testing.assert_close(together.fractions(together.frames(4)), torch.full((4, 16), 0.25))


@pytest.mark.parametrize("bin_by", [1, 2])
def test_rows_of_a_measurement_are_developed_as_its_pixels_are(bin_by: int) -> None:
    lines = torch.rand(1, 16) + 0.5
    frame = Frame(lines.T.expand(16, 16)[None], ("mosaic",), "GRBG", (0.0,), None, "float32", "x")
    measured = develop(frame, bin_by=bin_by)
    rows = developed_rows(lines, "GRBG", measured.channels, measured.size)
    torch.testing.assert_close(rows[0], measured.values)


@pytest.mark.parametrize("given", [{"rolling": None}, {"line_time_us": None}])
def test_a_line_time_without_a_direction_is_refused(given: dict[str, None]) -> None:
    with pytest.raises(DataError, match="is missing: a rolling shutter has both"):
        _sensor(**{"line_time_us": 20.0, "rolling": "down"} | given)
