"""`nolens reconstruct --detail` and `--sweep`: a factor on the automatic weight, and pictures with
other values of one option beside each other.
"""

import json
from pathlib import Path
from typing import Any

import pytest
import torch
from little_camera import SUPPORT, Camera
from PIL import Image
from running import check_refused, listing, reconstruct, run

from nolens.files import read_frame


def record(out: Path) -> dict[str, Any]:
    return dict(json.loads(out.with_suffix(".json").read_text()))


def opened(path: Path) -> Image.Image:
    with Image.open(path) as picture:
        picture.load()
    return picture


def test_detail_divides_the_automatic_weight(camera: Camera, out: Path) -> None:
    asked = (camera.raw, "--psf", camera.psf, "--support", SUPPORT)
    reconstruct(out, *asked)
    usual = record(out)["result"]["tau"]
    reconstruct(out, *asked, "--detail", 4)
    assert record(out)["result"]["tau"] == pytest.approx(usual / 4)
    check_refused(
        run("reconstruct", *asked, "-o", out, "--detail", 2, "--tau", 1e-4), "--detail 2", "--tau"
    )


@pytest.mark.parametrize("more", [(), ("--iterations", 32)])
def test_pictures_of_a_sweep_are_those_of_its_values_alone(
    more: tuple[object, ...], camera: Camera, tmp_path: Path
) -> None:
    """By the trained prior, and by total variation."""
    png, tif = tmp_path / "out.png", tmp_path / "out.tif"
    asked = (
        "reconstruct",
        camera.raw,
        "--psf",
        camera.psf,
        "--support",
        SUPPORT,
        *more,
    )
    done = run(*asked, "-o", png, "-o", tif, "--sweep", "tau")
    assert done.code == 0, done.err
    names = ["out", *(f"out-tau-x{factor}" for factor in ("4", "2", "0.5", "0.25"))]
    files = {f"{name}{suffix}" for name in names for suffix in (".png", ".tif")}
    assert set(listing(tmp_path)) == files | {"out-sweep.png", "out.json"}
    whites = {opened(tmp_path / f"{name}.png").info["Description"] for name in names}
    assert len(whites) == 1
    rows = record(png)["result"]["sweep"]
    assert [row["settings"]["detail"] for row in rows] == [0.25, 0.5, 1, 2, 4]
    for row in rows:
        assert f"{row['file']}: --detail {row['settings']['detail']:g}, tau" in done.out
    alone = tmp_path / "alone.tif"
    assert run(*asked, "-o", alone, "--detail", 2).code == 0
    swept = read_frame(tmp_path / "out-tau-x0.5.tif").counts
    assert torch.equal(swept, read_frame(alone).counts)
    assert not torch.equal(swept, read_frame(tif).counts)
    # Stronger weights leave less variation.
    variation = [
        float(read_frame(tmp_path / row["file"].replace(".png", ".tif")).counts.diff().abs().mean())
        for row in rows
    ]
    assert variation[0] < variation[2] < variation[4]
    assert min(opened(tmp_path / "out-sweep.png").size) > 400


@pytest.mark.parametrize(
    ("sweep", "files"),
    [
        ("method", ["out.png", "out-method-fista.png", "out-method-wiener.png"]),
        (
            "support",
            ["out.png", *(f"out-support-{part}.png" for part in ("full", "x1", "x0.75", "x0.5"))],
        ),
    ],
)
def test_other_options_are_swept(
    sweep: str, files: list[str], camera: Camera, tmp_path: Path
) -> None:
    out = tmp_path / "out.png"
    asked = ("--psf", camera.psf, "--support", SUPPORT, "--iterations", 8)
    assert run("reconstruct", camera.raw, *asked, "-o", out, "--sweep", sweep).code == 0
    rows = record(out)["result"]["sweep"]
    assert [row["file"] for row in rows] == files
    sizes = [opened(tmp_path / name).size for name in files]
    if sweep == "support":
        assert sizes == [(32, 24), (64, 48), (64, 48), (48, 36), (32, 24)]
        assert len({row["tau"] for row in rows}) == 1
    else:
        assert [row["iterations"] for row in rows] == [8, 8, 1]


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (("--sweep", "method", "--tau", 1e-4), ("--sweep method", "--tau")),
        (("--sweep", "method", "--quality", "exact"), ("--sweep method", "--quality")),
        (("--sweep", "prior", "--quality", "draft"), ("--sweep prior", "draft")),
        (("--sweep", "tau", "--tau", 0), ("--sweep tau", "0")),
        (("--sweep", "bin"), ("sweep", "tau")),
    ],
)
def test_contradictions_are_refused(
    more: tuple[object, ...], words: tuple[str, ...], camera: Camera, out: Path
) -> None:
    done = run("reconstruct", camera.raw, "--psf", camera.psf, "-o", out, *more)
    check_refused(done, *words)
    assert not out.exists()
