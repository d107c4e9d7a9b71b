"""`nolens material`, and cameras with materials of their own."""

import json
import tomllib
from pathlib import Path

import pytest
from running import check_refused, run

from nolens.camera import MATERIALS, preset_text
from nolens.files import read_camera, read_material


def test_list() -> None:
    done = run("material", "list")
    assert done.code == 0 and done.err == ""
    lines = done.out.splitlines()
    assert [line.split()[0] for line in lines[1:]] == list(MATERIALS)
    assert lines[2].split()[:4] == ["pua311", "1.4700", "50.0", "1.1"]
    found = json.loads(run("material", "list", "--json").out)["materials"]
    assert [each["material"]["name"] for each in found] == list(MATERIALS)
    bk7 = next(each for each in found if each["material"]["name"] == "bk7")
    # Schott's data sheet of N-BK7.
    assert bk7["index_at_lines"] == pytest.approx(
        {"F": 1.52238, "d": 1.5168, "C": 1.51432}, abs=5e-6
    )
    assert bk7["abbe"] == pytest.approx(64.17, abs=0.005)
    assert bk7["placeholders"] == []


@pytest.mark.parametrize("name", MATERIALS)
def test_what_is_shown_is_a_material(name: str, tmp_path: Path) -> None:
    done = run("material", "show", name)
    assert done.code == 0
    path = tmp_path / "copy.toml"
    path.write_text(done.out, encoding="utf-8")
    assert read_material(path) == MATERIALS[name]
    assert run("material", "show", path) == done


def test_facts_are_beside_it() -> None:
    done = run("material", "show", "noa61")
    assert done.code == 0 and tomllib.loads(done.out)["name"] == "noa61"
    for words in ("n = A + B/λ²", "n_d 1.55974", "V_d 42.44", "535 nm 1.5639",
                  "4.5 % of the volume", "fill 1.047 times",
                  "placeholders, not measured: density, cure"):  # fmt: skip
        assert words in done.err, words


def test_json_of_one(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(
        'name = "infrared"\nsource = "made up"\nformula = "constant"\ncoefficients = [1.6]\n'
        "range_nm = [600, 1200]\n"
    )
    done = run("material", "show", path, "--json")
    assert done.code == 0 and done.err == "" and done.out.count("\n") == 1
    found = json.loads(done.out)
    assert found["material"]["formula"] == "constant" and found["abbe"] is None
    assert found["index_at_lines"] == {"C": 1.6}
    assert set(found["index_at_nm"]) == {"600", "620", "650", "700", "850"}
    assert run("material", "show", path).code == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["show", "N-BK7"], ["there is no material 'N-BK7'", "did you mean 'bk7'", "fused-silica"]),
        (["show"], ["no NAME is given", "nolens material show NAME"]),
        (["show", "mine.toml"], ["cannot read mine.toml"]),
        (["list", "air"], ["'air' is more than material list takes"]),
    ],
)
def test_refused(
    arguments: list[str], words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    check_refused(run("material", *arguments), *words)


OWN = """
[[materials]]
name = "my-resin"
source = "a refractometer"
formula = "cauchy"
coefficients = [1.5, 0.004]
range_nm = [400, 800]
"""


def own_camera(folder: Path, own: str = OWN) -> Path:
    text = preset_text("small").replace('"pua311"', '"my-resin"') + own
    (folder / "camera.toml").write_text(text)
    return folder


def test_a_camera_with_a_material_of_its_own(tmp_path: Path) -> None:
    given = own_camera(tmp_path)
    assert read_camera(given).camera.indices(500)[0] == pytest.approx(1.516)
    shown = run("camera", "show", given)
    assert shown.code == 0 and '[[materials]]\nname = "my-resin"' in shown.out
    thinner = json.loads(run("camera", "show", given, "--json").out)["reduced_thickness_mm"]
    expected = 1.06 / (1.5 + 0.004 / 0.55**2) + 0.49 / 1.5214 + 0.235
    assert thinner == pytest.approx(expected, abs=2e-4)
    done = run("psf", "--camera", given, "--light", "535nm", "-o", tmp_path / "psf.tif")
    assert done.code == 0, done.err


@pytest.mark.parametrize(
    ("own", "light", "words"),
    [
        (OWN.replace("800", "600"), "650nm", ["my-resin", "from 400 to 600 nm, not at 650 nm"]),
        ("", "535nm", ["layers[0].material is 'my-resin'", "there is no material 'my-resin'"]),
        (OWN.replace("1.5, 0.004", "0.99"), "535nm", ["materials[0]", "index is 0.99 at 400 nm"]),
        (OWN.replace("my-resin", "bk7"), "535nm", ["materials[0].name is 'bk7'", "my-bk7"]),
        (OWN + "thickness = 1\n", "535nm", ["materials[0]", "the key 'thickness' is unknown"]),
    ],
)  # fmt: skip
def test_a_bad_material_of_its_own(own: str, light: str, words: list[str], tmp_path: Path) -> None:
    given = own_camera(tmp_path, own)
    done = run("psf", "--camera", given, "--light", light, "-o", tmp_path / "psf.tif")
    check_refused(done, *words)
    assert [path.name for path in tmp_path.iterdir()] == ["camera.toml"]
