"""`nolens camera show`."""

import json
from pathlib import Path

import pytest
from running import check_refused, run

from nolens.camera import PRESETS, Camera, from_toml, preset, preset_text


@pytest.mark.parametrize("name", PRESETS)
def test_text_is_the_cameras_file(name: str, tmp_path: Path) -> None:
    done = run("camera", "show", name)
    assert done.code == 0 and done.out == preset_text(name)
    (tmp_path / "camera.toml").write_text(done.out)
    for given in (tmp_path, tmp_path / "camera.toml"):
        again = run("camera", "show", given)
        assert again == done


def test_facts_are_beside_it() -> None:
    done = run("camera", "show", "paper")
    assert done.code == 0
    assert from_toml(Camera, done.out, "output") == preset("paper")
    for words in ("4.712 × 6.287 mm", "1520×2028 pixels", "1.277 mm of air", "1.0160 times",
                  "10° 224 µm, 30° 689 µm, 50° 1211 µm", "saturate at 8168 electrons",
                  "placeholders, not measured: acceptance"):  # fmt: skip
        assert words in done.err, words


def test_json() -> None:
    done = run("camera", "show", "paper", "--json")
    assert done.code == 0 and done.err == "" and done.out.count("\n") == 1
    found = json.loads(done.out)
    assert found["camera"]["layers"][0] == {
        "name": "resin", "thickness": "1.06 mm", "material": "pua311", "index": None,
    }  # fmt: skip
    assert found["sensor_mm"] == [4.712, 6.2868] and found["pixels"] == [1520, 2028]
    assert found["chief_ray_um"]["50"] == pytest.approx(1211, abs=1)
    # The paper's own figure is a magnification of 1.016 at 80 mm.
    assert found["magnification_at_80mm"] == pytest.approx(1.016, abs=5e-4)
    assert found["placeholders"] == ["acceptance"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["papr"], ["no camera 'papr'", "Did you mean the preset 'paper'", "paper, paper-film"]),
        ([], ["no NAME is given", "nolens camera show NAME"]),
        (["paper", "small"], ["'small' is more than camera show takes"]),
        (["."], ["holds no camera.toml"]),
    ],
)
def test_refused(
    arguments: list[str], words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    check_refused(run("camera", "show", *arguments), *words)


def test_unknown_command() -> None:
    check_refused(run("camera", "sho", "paper"), "sho", 'Did you mean "show"')
