"""`nolens design tolerance`: its files, its words, Ctrl-C, and what it refuses."""

import csv
import importlib
import json
import math
import os
import pty
import signal
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from running import check_refused, listing, read_terminal, run, start
from torch import Tensor

from nolens.camera import preset, to_toml
from nolens.errors import DataError
from nolens.evaluate import PatternFigures
from patience import PATIENCE_S

QUICK = ("design", "tolerance", "paper", "--model", "rays")
FEW = """\
[[parameter]]
name = "layers.0.thickness"
distribution = "normal"
tolerance = "300 um"

[[parameter]]
name = "relief.gain"
distribution = "uniform"
tolerance = "4 %"
"""


@pytest.fixture
def few(tmp_path: Path) -> Path:
    path = tmp_path / "tolerances.toml"
    path.write_text(FEW)
    return path


def studied(*arguments: object) -> dict[str, Any]:
    done = run(*arguments, "--json")
    assert done.code == 0 and done.err == "", done
    told: dict[str, Any] = json.loads(done.out, parse_constant=pytest.fail)
    return told


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_files_say_what_was_found(tmp_path: Path, few: Path) -> None:
    out = tmp_path / "deep" / "out"
    asked = ("--trials", 400, "--limit", "1.05x", "--yield", "90%", "--solve", "resin.thickness")
    told = studied(*QUICK, few, *asked, "-o", out)
    names = ["tolerance.json", "tolerance.png", "trials.csv"]
    assert sorted(listing(out)) == names
    assert told["outputs"] == [str(out / name) for name in (names[2], names[1], names[0])]
    record = json.loads((out / "tolerance.json").read_text())
    assert record["result"] == told and set(record["inputs"]) == {"tolerances"}
    assert 'name = "resin.thickness"' in record["parameters"]["tolerance_description"]
    assert record["parameters"]["yield"] == "90 %"
    with Image.open(out / "tolerance.png") as picture:
        assert picture.size == (1320, 960)

    trials = rows(out / "trials.csv")
    assert [int(each["trial"]) for each in trials] == list(range(1, 401))
    figures = sorted(float(each["line-width [um]"]) for each in trials)
    assert told["levels"]["90 %"] == figures[359] and told["levels"]["50 %"] == figures[199]
    passed = sum(figure <= told["limit"] for figure in figures)
    assert told["limit"] == pytest.approx(1.05 * told["nominal"])
    assert told["yield"]["passed"] == passed and told["yield"]["fraction"] == passed / 400
    low, high = told["yield"]["interval_95"]
    assert low < passed / 400 < high
    assert told["mean"] == pytest.approx(sum(figures) / 400)
    gains = [float(each["relief.gain [%]"]) for each in trials]
    assert min(gains) >= 96 and max(gains) <= 104
    assert max(gains) - min(gains) > 7.8

    solved = told["solved"]
    assert solved["verdict"] == "found" and solved["parameter"] == "resin.thickness"
    assert solved["reached"]["fraction"] == solved["reached"]["share"] >= 0.9
    assert solved["target_yield"] == solved["wanted_yield"] == 0.9
    # With that tolerance the yield is the one that it was found for.
    few.write_text(FEW.replace("300 um", f"{solved['tolerance']} um"))
    again = studied(*QUICK, few, *asked[:4], "-o", tmp_path / "again")
    assert again["yield"] == solved["reached"]
    few.write_text(FEW.replace("300 um", f"{1.05 * solved['tolerance']} um"))
    assert studied(*QUICK, few, *asked[:4], "-o", out)["yield"]["fraction"] < 0.9


@pytest.mark.usefixtures("undrawn")
def test_more_trials_begin_with_the_same_and_a_seed_changes_them(tmp_path: Path, few: Path) -> None:
    found = []
    for number, more in enumerate(((20,), (50,), (20, "--seed", 1))):
        out = tmp_path / str(number)
        studied(*QUICK, few, "-o", out, "--trials", *more)
        found.append(rows(out / "trials.csv"))
    assert found[1][:20] == found[0] and found[2] != found[0]


@pytest.mark.usefixtures("undrawn")
def test_waves_are_the_default(tmp_path: Path, few: Path) -> None:
    told = studied("design", "tolerance", "paper", few, "--trials", 10, "-o", tmp_path / "a")
    assert told["model"] == "wave" and told["nominal"] == pytest.approx(13.9, abs=0.3)
    assert told["sensitivities"][0]["parameter"] in ("resin.thickness", "relief.gain")
    green = ("--light", "650nm", "--criterion", "contrast", "--limit", "90%")
    told = studied(
        "design", "tolerance", "paper", few, "--trials", 10, *green, "-o", tmp_path / "b"
    )
    assert told["unit"] == "%" and told["limit"] == 90 and 60 < told["nominal"] < 200


@pytest.mark.usefixtures("undrawn")
def test_text_for_people(tmp_path: Path) -> None:
    done = run(*QUICK, "--limit", "1.05x", "-o", tmp_path / "out")
    assert done.code == 0 and done.err == ""
    lines = done.out.splitlines()
    assert lines[0].startswith("line-width 11") and "the worst first" in lines[0]
    assert lines[1].split()[:6] == ["relief.gain", "100", "±", "5", "%", "(2σ)"]
    assert lines[1].endswith("assumed")
    for words in (
        "predicted: mean",
        "1000 cameras drawn",
        "98 % ",
        "95 % interval",
        "meet the limit",
    ):
        assert words in done.out, words


@pytest.mark.usefixtures("undrawn")
def test_shown_tolerances_can_be_given(tmp_path: Path) -> None:
    done = run("design", "tolerance", "paper", "--show")
    assert done.code == 0 and done.err == ""
    path = tmp_path / "shown.toml"
    path.write_text(done.out)
    asked = ("--trials", 10, "-o")
    first = studied(*QUICK, *asked, tmp_path / "a")
    second = studied(*QUICK, path, *asked, tmp_path / "b")
    assert first["nominal"] == second["nominal"] and first["levels"] == second["levels"]
    assert run("design", "tolerance", "paper", path, "--show").out == done.out


@pytest.mark.parametrize(
    ("limit", "verdict", "words"),
    [
        ("1.0000001x", "impossible", "no tolerance of resin.thickness gives a yield of 90 %"),
        ("9x", "any", "any tolerance of resin.thickness up to"),
    ],
)
@pytest.mark.usefixtures("undrawn")
def test_yields_that_no_or_any_tolerance_gives(
    limit: str, verdict: str, words: str, tmp_path: Path, few: Path
) -> None:
    few.write_text(FEW.replace('"4 %"', '"20 %"' if verdict == "impossible" else '"1 %"'))
    asked = ("--limit", limit, "--yield", "90%", "--solve", "resin.thickness", "--trials", 50)
    assert studied(*QUICK, few, *asked, "-o", tmp_path / "o")["solved"]["verdict"] == verdict
    done = run(*QUICK, few, *asked, "-o", tmp_path / "o")
    assert words in done.out


def test_ctrl_c_keeps_the_trials_so_far(tmp_path: Path, few: Path) -> None:
    out = tmp_path / "out"
    ours, theirs = pty.openpty()
    asked = ("design", "tolerance", "paper", few, "--trials", 100_000, "-o", out, "--json")
    with start(*asked, stderr=theirs) as process:
        os.close(theirs)
        shown = read_terminal(ours, r"camera [1-9]\d+/100000")
        assert "sensitivities" in shown and "curves" in shown
        process.send_signal(signal.SIGINT)
        shown = read_terminal(ours, "")
        printed = process.communicate(timeout=PATIENCE_S)[0]
    os.close(ours)
    assert process.returncode == 130
    assert "the trials so far will be written" in shown
    told = json.loads(printed)
    assert told["stop_reason"] == "interrupted" and 10 <= told["trials"] < 100_000
    assert len(rows(out / "trials.csv")) == told["trials"]
    assert len(listing(out)) == 3


def refused(tmp_path: Path, *arguments: object, words: tuple[str, ...]) -> None:
    before = listing(tmp_path)
    check_refused(run("design", "tolerance", *arguments), *words)
    assert listing(tmp_path) == before


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("--trials", 9), ("trials is 9", "10 to 1000000")),
        (("--trials", 10**7), ("trials is 10000000",)),
        (("--limit", "20"), ("--limit", "no unit", "1.2x")),
        (("--limit", "20%"), ("--limit", "um", "1.2x")),
        (("--limit", "0x"), ("--limit 0x",)),
        (("--limit", "-3um"), ("--limit -3um",)),
        (("--limit", "2um"), ("--limit 2um cannot be reached", "nominal")),
        (("--limit", "120um", "--criterion", "contrast"), ("--limit", "%")),
        (("--limit", "9x", "--criterion", "contrast"), ("cannot be reached", "or less")),
        (("--criterion", "sharpness"), ("'sharpness'", "line-width, contrast")),
        (("--criterion", "mtf@4/mm"), ("mtf@4/mm", "15/mm")),
        (("--light", "green"), ("'green'", "white-led")),
        (("--light", "1050nm"), ("1050nm",)),
        (("--seed", -1), ("seed is -1", "0 to 9223372036854775807")),
        (("--solve", "resin.thickness"), ("--yield",)),
        (("--yield", "90%"), ("--solve",)),
        (
            ("--yield", "100%", "--solve", "gap.thickness", "--limit", "2x"),
            ("yield is '100%'", "99.99 %"),
        ),
        (("--yield", "90", "--solve", "gap.thickness", "--limit", "2x"), ("no unit",)),
        (("--yield", "90%", "--solve", "gap.thickness"), ("--limit",)),
        (("--yield", "90%", "--solve", "gap.thicknes", "--limit", "2x"), ("'gap.thickness'",)),
        (("--yield", "90%", "--solve", "air.index", "--limit", "2x"), ("air.index", "gap.index")),
        (("--yield", "90%", "--solve", "gap.index", "--limit", "2x"), ("--solve gap.index",)),
    ],
)
def test_bad_options(given: tuple[object, ...], words: tuple[str, ...], tmp_path: Path) -> None:
    out = tmp_path / "out"
    refused(tmp_path, "paper", "--model", "rays", "-o", out, *given, words=words)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (FEW.replace("300 um", "300"), ("has no unit",)),
        (FEW.replace("300 um", "-300 um"), ("negative",)),
        (FEW.replace("300 um", "3 mm"), ("resin.thickness", "more than 0 um", "largest")),
        (FEW.replace("relief.gain", "relief.gian"), ("did you mean 'relief.gain'",)),
        (FEW.replace("uniform", "unifrom"), ("did you mean 'uniform'",)),
        ("[[parameter", ("no TOML",)),
    ],
)
def test_bad_files(text: str, words: tuple[str, ...], tmp_path: Path, few: Path) -> None:
    few.write_text(text)
    refused(tmp_path, "paper", few, "-o", tmp_path / "out", words=words)


def test_other_refusals(tmp_path: Path, few: Path) -> None:
    out = tmp_path / "out"
    refused(tmp_path, "paper", few, words=("no output is given",))
    refused(tmp_path, "papier", "-o", out, words=("Did you mean the preset 'paper'",))
    refused(tmp_path, "paper", tmp_path / "none.toml", "-o", out, words=("none.toml", "--show"))
    refused(tmp_path, "paper", tmp_path, "-o", out, words=("cannot read",))
    refused(tmp_path, "paper", few, "-o", few, words=("is a file", "folder"))
    refused(tmp_path, "paper", few, few, "-o", out, words=("design tolerance CAMERA",))
    refused(tmp_path, "paper", few, "-o", few / "out", words=("is a file",))
    text = to_toml(preset("paper"))
    flat = tmp_path / "flat.toml"
    flat.write_text(text[: text.index("[mask.relief]")] + '[mask.relief]\nkind = "flat"\n')
    refused(tmp_path, flat, "-o", out, words=("is flat",))
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe")
    refused(tmp_path, "paper", binary, "-o", out, words=("no TOML",))


@pytest.mark.usefixtures("undrawn")
def test_not_measurable_is_said_and_stays_json(
    tmp_path: Path, few: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The last trials' patterns have no lines; then none has."""
    module = importlib.import_module("nolens.design.tolerances.sharpness")
    measure, calls = module.pattern_figures, []

    def measured(pattern: Tensor, cell_um: float) -> PatternFigures:
        calls.append(1)
        if len(calls) > most:
            raise DataError("the PSF is even")
        return measure(pattern, cell_um)

    monkeypatch.setattr(module, "pattern_figures", measured)
    asked = ("design", "tolerance", "paper", few, "--trials", 10, "--limit", "9x", "-o")
    most = 10**6
    studied(*asked, tmp_path / "all")
    most, calls = len(calls) - 3, []
    done = run(*asked, tmp_path / "some")
    assert "3 of them show no lines" in done.out and "98 % none" in done.out
    told = json.loads((tmp_path / "some" / "tolerance.json").read_text())["result"]
    figures = [float(each["line-width [um]"]) for each in rows(tmp_path / "some" / "trials.csv")]
    assert [math.isinf(each) for each in figures] == 7 * [False] + 3 * [True]
    assert told["not_measurable"] == 3 and told["yield"]["passed"] == 7
    assert told["levels"]["98 %"] is None and told["levels"]["50 %"] == sorted(figures)[4]
    assert told["mean"] == pytest.approx(sum(figures[:7]) / 7)
    most, before = 0, listing(tmp_path)
    check_refused(run(*asked, tmp_path / "none"), "no line that could be measured")
    assert listing(tmp_path) == before
