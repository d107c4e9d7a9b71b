"""Options as programs give them, and the notation of windows."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from nolens.errors import OptionError
from nolens.jobs import (
    MeasureFieldOptions,
    ReconstructOptions,
    Reporter,
    SimulateOptions,
)
from nolens.jobs.options import check_apart
from nolens.jobs.reconstruction.options import parse_window
from nolens.operators import PixelRectangle
from nolens.solvers import Method

FILES = {"measurement": Path("raw.dng"), "psf": Path("psf.dng"), "output": (Path("o.png"),)}


@given(st.integers(1, 999), st.integers(1, 999), st.integers(-999, 999), st.integers(-999, 999))
def test_window_with_its_place(height: int, width: int, top: int, left: int) -> None:
    text = f"{height}x{width}{top:+d}{left:+d}"
    assert parse_window(text, (10, 10), "--crop") == PixelRectangle(top, left, height, width)


@given(st.integers(1, 99), st.integers(1, 99), st.integers(1, 99), st.integers(1, 99))
def test_window_around_the_middle(height: int, width: int, rows: int, columns: int) -> None:
    support = parse_window(f" {height}x{width} ", (rows, columns), "--support")
    assert (support.height, support.width) == (height, width)
    for start, length, whole in ((support.top, height, rows), (support.left, width, columns)):
        assert abs((start + length / 2) - whole / 2) <= 0.5


@pytest.mark.parametrize(
    "text", ["", "x", "3", "3x", "x3", "3x3x3", "0x3", "3x0", "3x3+1", "3 x 3", "3.5x2", "-3x2"]
)
def test_no_window(text: str) -> None:
    with pytest.raises(OptionError, match=r"--crop .* HEIGHTxWIDTH"):
        parse_window(text, (10, 10), "--crop")


@pytest.mark.parametrize("value", [True, False])
def test_former_name_of_a_switch(value: bool) -> None:
    notes: list[str] = []
    options = ReconstructOptions.gather({**FILES, "smooth_part": value}, None, notes.append)
    assert options.low_frequency is value
    assert notes == [
        "smooth_part is called low_frequency now; the former name goes with the next version"
    ]


def test_defaults_and_given_values() -> None:
    options = ReconstructOptions.gather({**FILES, "method": "fista", "black": "12.5"}, None)
    assert options.method is Method.FISTA and options.black == 12.5
    assert options.tau == "auto" and options.balance is True
    assert options.record == Path("o.json")
    assert options.inputs == {"measurement": Path("raw.dng"), "psf": Path("psf.dng")}
    assert ReconstructOptions.gather({**FILES, "black": "auto"}, None).black == "auto"
    with pytest.raises(ValidationError):
        options.tau = 1.0  # type: ignore[misc]


def test_one_text_or_path_where_several_are_meant() -> None:
    for output in ("o.png", Path("o.png"), ["o.png"]):
        assert ReconstructOptions(**{**FILES, "output": output}).output == (Path("o.png"),)
    with pytest.raises(ValidationError, match="tuple"):
        ReconstructOptions(**{**FILES, "output": 3})
    options = SimulateOptions.gather({"scenes": "a.png", "output": "r.tif", "distance": "8cm"})
    assert options.scenes == (Path("a.png"),) and str(options.distance[0]) == "8 cm"
    field = MeasureFieldOptions.model_validate({"simulate": "small", "angles": "0deg,5deg"})
    assert len(field.angles) == 2


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("o\0.png", "NUL"),
        ("x" * 221 + ".png", "220 bytes"),
        ("d/" * 2000 + "o.png", "4000"),
        ("o\ud800.png", "half of a character"),
    ],
)
def test_no_path(name: str, words: str) -> None:
    """Refused where options are made: a system would refuse it when all work is done."""
    for option in ("output", "psf"):
        with pytest.raises(OptionError, match=words):
            ReconstructOptions.gather({**FILES, option: name}, None)
    long = Path("x" * 200 + ".png")
    assert ReconstructOptions.gather({**FILES, "output": long}, None).output == (long,)


def test_a_reporter_that_says_nothing() -> None:
    reporter = Reporter()
    reporter.warn("unheard")
    assert not reporter.step("frame", 1, 2, "the pictures")


@pytest.mark.parametrize("missing", FILES)
def test_what_is_needed(missing: str) -> None:
    given = {name: value for name, value in FILES.items() if name != missing}
    with pytest.raises(OptionError, match=f"no {missing} is given"):
        ReconstructOptions.gather(given, None)


def test_files_that_are_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    raw, other = tmp_path / "raw.tif", tmp_path / "other.tif"
    raw.write_bytes(b"counts")
    other.hardlink_to(raw)
    for output in ("raw.tif", "./raw.tif", str(raw), f"{tmp_path}/x/../raw.tif", "other.tif"):
        options = ReconstructOptions(measurement=raw, psf=Path("p.dng"), output=(Path(output),))
        with pytest.raises(OptionError, match="would overwrite the measurement"):
            check_apart(options, options.inputs)
    twice = ReconstructOptions(**{**FILES, "output": (Path("a.png"), Path("b/../a.png"))})
    with pytest.raises(OptionError, match="is given twice"):
        check_apart(twice, twice.inputs)
    apart = ReconstructOptions(**{**FILES, "output": (Path("a.png"), Path("a.tif"))})
    check_apart(apart, apart.inputs)
