"""`nolens design thickness`: the paper's figures, other sensors, what it writes and refuses."""

import json
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from running import check_refused, listing, run

from nolens.camera import MATERIALS, to_toml
from nolens.files import read_camera


def designed(*arguments: object) -> dict[str, Any]:
    done = run("design", "thickness", *arguments, "--json")
    assert done.code == 0 and done.err == "", done
    told: dict[str, Any] = json.loads(done.out)
    return told


def value(told: dict[str, Any], name: str, of: int = 0) -> float:
    return float(told["materials"][of][name]["value"])


def off(told: dict[str, Any], name: str, of: int = 0) -> float:
    return float(told["materials"][of][name]["plus_minus"])


def test_paper() -> None:
    """Without a word of its own."""
    done = run("design", "thickness", "--json")
    assert done.code == 0 and done.err == ""
    told = json.loads(done.out)
    assert round(told["radius_mm"]["value"], 3) == 0.678
    assert round(told["radius_mm"]["plus_minus"], 3) == 0.118
    assert round(told["printed_radius_mm"], 3) == 0.670
    pdms, pua = told["materials"]
    assert (pdms["material"], pua["material"]) == ("pdms", "pua311")
    assert (round(pdms["index"]["value"], 4), round(pua["index"]["value"], 4)) == (1.43, 1.47)
    assert [round(value(told, "thickness_mm", n), 2) for n in (0, 1)] == [1.46, 1.30]
    assert [round(off(told, "thickness_mm", n), 2) for n in (0, 1)] == [0.39, 0.37]
    assert [round(each["printed_thickness_mm"], 2) for each in (pdms, pua)] == [1.43, 1.28]
    assert pua["thickness_mm"]["fractions"] == {"film distance": 1.0}
    focal = told["radius_mm"]["value"] / 0.47
    assert value(told, "focal_length_mm", 1) == pytest.approx(focal)
    assert value(told, "focal_length_in_material_mm", 1) == pytest.approx(1.47 * focal)
    aperture = 0.070 / 2 / focal
    assert value(told, "aperture", 1) == pytest.approx(aperture)
    assert value(told, "depth_of_focus_mm", 1) == pytest.approx(587.56e-6 / aperture**2)
    width = 0.58756 / (2 * aperture) * (1 + 1.5 * 11 / 70)
    assert value(told, "line_width_um", 1) == pytest.approx(width)
    low, high = pua["sharp_mm"]
    assert (low + high) / 2 == pytest.approx(value(told, "thickness_mm", 1))
    assert (high - low) / 2 == pytest.approx(value(told, "room_mm", 1))


def test_text_for_people() -> None:
    done = run("design", "thickness")
    assert done.code == 0 and done.err == ""
    for words in (
        "radius of curvature of 0.678 mm ± 0.118 mm", "eq. 3 as the paper prints it gives 0.670 mm",
        "pua311 (n 1.47): pour 1.30 mm ± 0.37 mm; it may be off by ± 0.52 mm (0.78 to 1.82 mm)",
        "pdms (n 1.43): pour 1.46 mm ± 0.39 mm", "from eq. 3 as printed: 1.28 mm",
        "film distance 0.37 mm (100 %)", "the paper's film", "  450 nm     1.417 mm  12.2 µm",
    ):  # fmt: skip
        assert words in done.out, words
    own = run("design", "thickness", "--radius", "0.67mm", "--index", "1.47", "--no-glass")
    assert "over the sensor: nothing" in own.out and "printed" not in own.out
    assert "n 1.47: pour 2.10 mm; it may" in own.out and "±" in own.out
    near = run("design", "thickness", "--distance", "50mm")
    assert "from 50 mm" in near.out and "edge of a lenslet" not in near.out


@pytest.mark.parametrize("plus_minus", ["±", "+-"])
def test_plus_minus_of_every_input(plus_minus: str) -> None:
    """Each against the difference of two runs."""
    inputs = {
        "film": (0.305, 0.01, "mm"), "film-index": (1.59, 0.01, ""),
        "film-distance": (0.4, 0.02, "mm"), "glass": (0.49, 0.02, "mm"),
        "glass-index": (1.52, 0.01, ""), "gap": (0.235, 0.02, "mm"), "index": (1.47, 0.005, ""),
        "pitch": (70, 1, "um"),
    }  # fmt: skip

    def told(**changes: float) -> dict[str, Any]:
        arguments = [
            f"--{name}={middle + changes.get(name, 0):.9g}{unit}"
            for name, (middle, _, unit) in inputs.items()
        ]
        return designed(*arguments)

    full = designed(
        *(f"--{n}={m}{u}{plus_minus}{spread}{u}" for n, (m, spread, u) in inputs.items())
    )
    names = {"film-index": "film index", "film-distance": "film distance",
             "glass-index": "glass index", "index": "replica index"}  # fmt: skip
    total = 0.0
    for name, (_, spread, _) in inputs.items():
        step = 0.01 * spread
        ends = [told(**{name: sign * step}) for sign in (-1, 1)]
        for figure in ("thickness_mm", "line_width_um", "depth_of_focus_mm", "aperture"):
            part = (value(ends[1], figure) - value(ends[0], figure)) / 0.02
            found = full["materials"][0][figure]["parts"][names.get(name, name)]
            assert found == pytest.approx(part, rel=1e-3, abs=1e-7), (name, figure)
        total += full["materials"][0]["thickness_mm"]["parts"][names.get(name, name)] ** 2
    assert off(full, "thickness_mm") == pytest.approx(total**0.5)


def test_radius_in_place_of_a_film() -> None:
    told = designed("--radius", "0.67mm±0.1mm", "--material", "pua311")
    assert told["film"] is None and told["printed_radius_mm"] is None
    index = told["materials"][0]["index"]["value"]
    expected = index * (0.67 / (index - 1) - 0.49 / 1.52 - 0.235)
    assert value(told, "thickness_mm") == pytest.approx(expected)
    assert off(told, "thickness_mm") == pytest.approx(index / (index - 1) * 0.1)


def test_other_sensors() -> None:
    """Bare, with a gap alone, with another glass; and the camera's own layers."""
    fixed = ("--radius", "0.67mm", "--index", "1.47")
    focal = 0.67 / 0.47
    assert value(designed(*fixed, "--no-glass"), "thickness_mm") == pytest.approx(1.47 * focal)
    gap = designed(*fixed, "--no-glass", "--gap", "0.2mm")
    assert value(gap, "thickness_mm") == pytest.approx(1.47 * (focal - 0.2))
    glass = ("--glass", "0.3mm", "--glass-material", "d263")
    other = designed(*fixed, *glass, "--gap", "0mm", "--wavelength", "550nm")
    reduced = 0.3 / MATERIALS["d263"].index(550)
    assert value(other, "thickness_mm") == pytest.approx(1.47 * (focal - reduced))
    layers = [designed("--camera", name)["cover"] for name in ("paper", "paper-film")]
    assert layers[0] == layers[1] and [each["name"] for each in layers[0]] == ["glass", "gap"]


def test_film_turned_over() -> None:
    told = designed("--film-side", "sensor", "--film-distance", "0.4mm")
    assert told["radius_mm"]["value"] == pytest.approx(0.59 * (0.4 + 0.49 / 1.52 + 0.235))
    assert told["printed_radius_mm"] is None


def test_near_light() -> None:
    """1/D = 1/f − 1/z, for the film and the replica."""
    told = designed("--distance", "20mm", "--index", "1.47", "--film-distance", "0.4mm")
    reduced = 0.49 / 1.52 + 0.235
    radius = 0.59 / (1 / (0.305 / 1.59 + 0.4 + reduced) + 1 / 20)
    assert told["radius_mm"]["value"] == pytest.approx(radius)
    behind = 1 / (0.47 / radius - 1 / 20)
    assert value(told, "thickness_mm") == pytest.approx(1.47 * (behind - reduced))
    assert value(told, "aperture") == pytest.approx(0.035 / behind)
    assert "spherical_mm" not in told["materials"][0]


def test_colours() -> None:
    """Blue bends more, so it is in focus nearer; an index without material has no colours."""
    told = designed("--radius", "0.67mm", "--material", "noa61", "--glass-material", "bk7")
    rows = {row["light"]: row for row in told["materials"][0]["colours"]}
    assert [*rows] == ["450 nm", "500 nm", "550 nm", "600 nm", "650 nm", "R", "G", "B"]
    for row in rows.values():
        index, glass = (MATERIALS[name].index(row["wavelength_nm"]) for name in ("noa61", "bk7"))
        expected = index * (0.67 / (index - 1) - 0.49 / glass - 0.235)
        assert row["thickness_mm"] == pytest.approx(expected)
    assert rows["450 nm"]["line_width_um"] < rows["550 nm"]["line_width_um"]
    assert rows["B"]["wavelength_nm"] < rows["G"]["wavelength_nm"] < rows["R"]["wavelength_nm"]
    even = designed("--radius", "0.67mm", "--index", "1.5", "--glass-index", "1.5")
    assert len({round(row["thickness_mm"], 9) for row in even["materials"][0]["colours"]}) == 1


def test_camera_to_go_on_with(tmp_path: Path) -> None:
    """The camera that is written has this focus, and can be simulated."""
    own = MATERIALS["pua311"].model_copy(update={"name": "my-resin", "coefficients": (1.5, 45.0)})
    resin, folder = tmp_path / "resin.toml", tmp_path / "made"
    resin.write_text(to_toml(own))
    asked = ("--camera", "small", "--material", resin, "--radius", "0.5mm", "-o", folder)
    told = designed(*asked, "--plot", tmp_path / "plot.png")
    outputs = [tmp_path / "plot.png", folder / "camera.toml", folder / "thickness.json"]
    assert told["outputs"] == [str(path) for path in outputs]
    camera = read_camera(folder).camera
    assert camera.layers[0].thickness.mm == pytest.approx(value(told, "thickness_mm"), abs=1e-4)
    assert camera.material_of(camera.layers[0]) == own and camera.mask.surface == 0
    assert [layer.thickness for layer in camera.layers[1:]] == [
        layer.thickness for layer in read_camera("small").camera.layers[1:]
    ]
    assert getattr(camera.mask.relief, "radius").mm == 0.5  # noqa: B009 (one kind of three)
    record = json.loads((folder / "thickness.json").read_text())
    assert record["result"] == told and record["inputs"][f"material {resin}"]["size"] > 0
    with Image.open(tmp_path / "plot.png") as picture:
        assert min(picture.size) > 300 and len(picture.convert("RGB").getcolors(10**6) or ()) > 50
    psf = run("psf", "--camera", folder, "--light", "535nm", "-o", tmp_path / "psf.tif", "--json")
    assert psf.code == 0 and json.loads(psf.out)["peak_over_mean"] > 5


REFUSED = {
    "no unit": (("--film", "0.3"), ("0.3 has no unit", "0.3 mm")),
    "no unit of ±": (("--gap", "0.2mm±0.1"), ("0.1 has no unit",)),
    "index below 1": (("--film-index", "0.9"), ("'0.9'", "1 to 4")),
    "index of air": (("--index", "1"), ("the index of the air", "higher")),
    "film of air": (("--film-index", "1"), ("bends no light",)),
    "index that is none": (("--glass-index", "1.5mm"), ("is no number",)),
    "negative": (("--gap", "-1mm"), ("gap is", "0 mm to 10 m")),
    "material": (("--material", "pua31"), ("did you mean 'pua311'?",)),
    "camera": (("--camera", "papr"), ("Did you mean the preset 'paper'?",)),
    "cannot focus": (
        ("--radius", "0.3mm", "--material", "polycarbonate"),
        ("polycarbonate (n 1.59) cannot focus", "0.508 mm", "0.557 mm",
         "more than 0.329 mm", "n below 1.538 (pua311, pdms,"),
    ),
    "too near": (("--distance", "1mm", "--radius", "0.67mm"), ("never comes to focus", "1.56 mm")),
    "distance": (("--distance", "0mm"), ("or 'infinity'",)),
    "film and radius": (("--radius", "1mm", "--film", "1mm"), ("leave one out",)),
    "glass and none": (("--no-glass", "--glass", "1mm"), ("contradict",)),
    "index and material": (("--index", "1.4", "--material", "pdms"), ("leave one out",)),
    "relief on the sensor": (
        ("--no-glass", "--film-side", "sensor", "--film-distance", "0mm"), ("--film-distance",)),
    "wavelength": (("--wavelength", "200nm"), ("known from 350 to 1100 nm",)),
    "wavelength below zero": (("--wavelength", "-5nm"), ("wavelength is", "1 nm to 1 mm")),
    "side": (("--film-side", "up"), ("scene",)),
    "word": (("more",), ("'more' is more than design thickness takes",)),
    "camera of two": (("-o", "made"), ("give one --material or --index",)),
    "plot": (("--plot", "plot.jpg"), (".png",)),
    "a file as folder": (("--index", "1.4", "-o", "file"), ("is a file",)),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("mine")
    before = listing(tmp_path)
    arguments, words = REFUSED[name]
    output = () if "-o" in arguments or "--plot" in arguments else ("--plot", "made.png")
    check_refused(run("design", "thickness", *arguments, *output), *words)
    assert listing(tmp_path) == before


def test_not_over_its_own_camera(tmp_path: Path) -> None:
    folder = tmp_path / "made"
    designed("--camera", "small", "--index", "1.47", "--radius", "0.5mm", "-o", folder)
    before = listing(tmp_path)
    done = run("design", "thickness", "--camera", folder, "--index", "1.47", "-o", folder)
    check_refused(done, "would overwrite the camera")
    assert listing(tmp_path) == before
