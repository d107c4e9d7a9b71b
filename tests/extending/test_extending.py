"""A package of one's own adds formats, cameras and masks, without a change here."""

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
from plugin_process import Command


def broken_package(folder: Path, code: str, *groups: str) -> Path:
    """A package that adds ``odd`` to groups, by its module of that name."""
    about = folder / "nolens_odd-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: nolens-odd\nVersion: 1.0\n")
    points = "".join(f"[{group}]\nodd = nolens_odd:Odd\n" for group in groups)
    (about / "entry_points.txt").write_text(points)
    (folder / "nolens_odd.py").write_text(code)
    return folder


@pytest.fixture
def graymap(tmp_path: Path) -> Path:
    """Two rows of three counts of 16 bits."""
    path = tmp_path / "a.pgm"
    counts = np.array([[0, 100, 200], [300, 400, 1000]], dtype=">u2")
    path.write_bytes(b"P5\n3 2\n1000\n" + counts.tobytes())
    return path


def test_a_format(nolens: Command, graymap: Path) -> None:
    found = json.loads(nolens("info", graymap, "--json").printed)
    assert (found["format"], found["height"], found["width"]) == ("pgm", 2, 3)
    assert (found["channels"], found["stored_as"], found["white"]) == (["grey"], "uint16", 1000)
    about = found["counts"]["grey"]
    assert (about["min"], about["max"]) == (0, 1000)
    assert about["mean"] == pytest.approx(2000 / 6)
    assert found["saturated_percent"] == pytest.approx(100 / 6)


@pytest.mark.parametrize("damage", [b"P6\n3 2\n1000\n", b"P5\n3 2\n1000\n\0", b""])
def test_a_damaged_file_of_that_format(damage: bytes, nolens: Command, graymap: Path) -> None:
    graymap.write_bytes(damage)
    assert str(graymap) in nolens("info", graymap).refusal


def test_a_format_without_its_package(nolens: Command, alone: Command, graymap: Path) -> None:
    said = alone("info", graymap).refusal
    assert "the suffix .pgm is not known" in said and ", .pgm" not in said
    other = graymap.rename(graymap.with_suffix(".pgx"))
    assert ", .pgm" in nolens("info", other).refusal


def test_a_source(nolens: Command, tmp_path: Path) -> None:
    path = tmp_path / "x.tif"
    told = nolens("capture", "--source", "step-wedge:6", "--exposure", "30ms", "-o", path)
    assert "step wedge: 1 frame" in told.printed
    counts = tifffile.imread(path)
    assert counts.shape == (64, 48) and counts.dtype == np.uint16
    steps = np.repeat(np.linspace(0.1, 1.0, 6), 8)
    np.testing.assert_array_equal(counts, np.tile(np.round(3000 * steps), (64, 1)))


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("step-wedge:many", "give 2 to 64 steps, such as step-wedge:8"),
        ("wedge", ", or step-wedge"),
    ],
)
def test_a_bad_source(source: str, words: str, nolens: Command, tmp_path: Path) -> None:
    said = nolens("capture", "--source", source, "-o", tmp_path / "x.tif").refusal
    assert words in said and not (tmp_path / "x.tif").exists()


def test_a_mask(nolens: Command, alone: Command, tmp_path: Path) -> None:
    folder = tmp_path / "ringed"
    asked = ("--camera", "small", "--light", "535nm", "--overhang", "0.2mm", "--height", "1.5um")
    told = json.loads(nolens("design", "mask", "rings", *asked, "-o", folder, "--json").printed)
    assert told["kind"] == "rings" and told["figures"]["height_um"] == pytest.approx(1.5, rel=0.01)

    heights = tifffile.imread(folder / "relief.tif")
    assert heights.shape == (516, 580)  # 256 × 320 pixels of 1.55 µm, and 0.2 mm on every side.
    rows, columns = (1.55 * (np.arange(count) - (count - 1) / 2) for count in heights.shape)
    radius = np.hypot(rows[:, None], columns)
    np.testing.assert_allclose(heights, 0.75 * (1 + np.cos(2 * np.pi * radius / 80)), atol=1e-4)

    record = json.loads((folder / "mask.json").read_text())
    own = {key: record["parameters"][key] for key in ("kind", "spacing", "height", "camera")}
    assert own == {"kind": "rings", "spacing": "80 um", "height": "1.5 um", "camera": "small"}

    shown = json.loads(alone("camera", "show", folder, "--json").printed)
    assert shown["camera"]["name"] == "small, rings mask"
    assert shown["camera"]["mask"]["relief"] == {
        "kind": "file",
        "file": "relief.tif",
        "grid": "1.55 um",
    }


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--spacing", "3um"), "give a larger --spacing or a smaller --height"),
        (("--overhang", "1m"), "a smaller --overhang needs less"),
        (("--pitch", "3um"), "Unknown option: --pitch"),
        (("--spacing", "3"), "3 has no unit"),
    ],
)
def test_a_mask_that_cannot_be(
    arguments: tuple[str, ...], words: str, nolens: Command, tmp_path: Path
) -> None:
    asked = ("rings", "--camera", "small", "-o", tmp_path / "m")
    assert words in nolens("design", "mask", *asked, *arguments).refusal
    assert not (tmp_path / "m").exists()


def test_a_mask_is_listed_with_the_others(nolens: Command, alone: Command, tmp_path: Path) -> None:
    listed = nolens("design", "mask", "--help").printed
    assert "rings            Concentric rings, round like waves." in listed
    assert "lenslet-array    Lenslets in regular places." in listed
    shown = nolens("design", "mask", "rings", "--help").printed
    assert "--spacing" in shown and "--overhang" not in shown
    shown = nolens("design", "mask", "rings", "--help-all").printed
    assert "--spacing" in shown and "--overhang" in shown and "--pitch" not in shown
    assert "optimised, rings:" in nolens("design", "mask").refusal
    said = alone("design", "mask", "rings", "-o", tmp_path / "m").refusal
    assert "no kind of mask 'rings'" in said


def test_a_package_that_cannot_be_imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.odd").touch()
    groups = ("nolens.readers", "nolens.sources", "nolens.masks")
    packages = broken_package(tmp_path, "import nowhere_to_be_found", *groups)
    with Command(packages) as nolens:
        for group, arguments in (
            ("nolens.readers", ("info", "a.odd")),
            ("nolens.sources", ("capture", "--source", "odd", "-o", "x.tif")),
            ("nolens.masks", ("design", "mask", "odd", "--camera", "small", "-o", "m")),
            ("nolens.masks", ("design", "mask", "odd", "--help")),
        ):
            said = nolens(*arguments).refusal
            assert f"nolens-odd adds 'odd' to {group}, and cannot be loaded" in said
            assert "No module named 'nowhere_to_be_found'" in said


def test_a_broken_mask_leaves_the_others(tmp_path: Path) -> None:
    packages = broken_package(tmp_path, "raise RuntimeError('half installed')", "nolens.masks")
    asked = ("lenslet-array", "--camera", "small", "--overhang", "0.2mm", "-o", tmp_path / "m")
    with Command(packages) as nolens:
        listed = " ".join(nolens("design", "mask", "--help").printed.split())
        assert "Lenslets in regular places." in listed and "nolens-odd adds 'odd'" in listed
        assert nolens("design", "mask", *asked).returncode == 0
    assert (tmp_path / "m" / "relief.tif").exists()


def test_a_mask_must_be_of_its_class(tmp_path: Path) -> None:
    with Command(broken_package(tmp_path, "Odd = dict", "nolens.masks")) as nolens:
        said = nolens("design", "mask", "odd", "-o", tmp_path / "m").refusal
    assert "leads to no class of MaskOptions" in said


def test_a_prior(nolens: Command, alone: Command, tmp_path: Path) -> None:
    """It brings back a hill that total variation makes steps of."""
    rng = np.random.default_rng(5)
    psf, scene = np.zeros((48, 64)), np.zeros((48, 64))
    psf[rng.integers(14, 34, 30), rng.integers(20, 44, 30)] = 1
    truth = np.outer(*(np.sin(np.pi * (np.arange(side) + 0.5) / side) for side in (20, 30)))
    scene[14:34, 17:47] = truth
    light = np.fft.irfft2(np.fft.rfft2(scene) * np.fft.rfft2(np.roll(psf, (24, 32), (0, 1))))
    counts = 30000 * light / light.max() + rng.normal(0, 1500, light.shape) + 9000
    for name, values in (("psf", 50000 * psf + 9000), ("raw", counts)):
        tifffile.imwrite(tmp_path / f"{name}.tif", values.round().astype(np.uint16))
    asked = (tmp_path / "raw.tif", "--psf", tmp_path / "psf.tif", "--support", "20x30")
    asked = ("reconstruct", *asked, "--black", 9000, "--bin", 1, "--tau", 1e-2)
    errors = {}
    for prior in ("tv", "smooth"):
        path = tmp_path / f"{prior}.tif"
        assert nolens(*asked, "--prior", prior, "-o", path).returncode == 0
        found = tifffile.imread(path).astype(float).reshape(20, 30, -1)[..., 0]
        factor = (found * truth).sum() / (found**2).sum()
        errors[prior] = np.sqrt(((factor * found - truth) ** 2).mean())
        record = json.loads((tmp_path / f"{prior}.json").read_text())
        assert record["parameters"]["prior"] == prior
    assert errors["smooth"] < 0.8 * errors["tv"] and errors["smooth"] < 0.1, errors
    assert "smooth" in alone(*asked, "--prior", "smooth", "-o", tmp_path / "x.tif").refusal
    assert "smooth" in nolens("reconstruct", "--help-all").printed
