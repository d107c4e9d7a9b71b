"""From raw frames of point sources to a photograph, by the commands that a person types."""

import contextlib
import io
import json
from pathlib import Path
from typing import Any

import pytest
import torch
from captured_at_angles import lights
from PIL import Image
from point_light import Shot
from skimage.data import astronaut

from nolens.cli.main import main
from nolens.evaluate import affine_fit, psnr
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.files import read_camera, read_frame

PIXELS = (320, 400)
SCENE_DEG = 8.3


def nolens(*arguments: object) -> dict[str, Any]:
    """What a command tells; it must end well."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out), pytest.raises(SystemExit) as left:
        main([*map(str, arguments), "--json"])
    assert left.value.code == 0, (arguments, out.getvalue())
    told: dict[str, Any] = json.loads(out.getvalue())
    return told


def camera(folder: Path) -> Path:
    """The paper's camera with a smaller sensor."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out), pytest.raises(SystemExit):
        main(["camera", "show", "paper"])
    text = out.getvalue()
    for name, whole, part in (("rows", 3040, PIXELS[0]), ("columns", 4056, PIXELS[1])):
        assert f"{name} = {whole}" in text
        text = text.replace(f"{name} = {whole}", f"{name} = {part}")
    path = folder / "camera.toml"
    path.write_text(text)
    return path


def test_stitched_from_noisy_frames(tmp_path: Path) -> None:
    """Nine places of the light, half a degree off what is written down."""
    described = camera(tmp_path)
    bench = VirtualExperiment.of(read_camera(described))
    mine = tmp_path / "mine"
    for number, light in enumerate(lights(SCENE_DEG / 2 + 1, 0.5)):
        shot = Shot(bench, bench.light_of(light.source))
        frames = shot.write(tmp_path, 2, 0.8, 10.0, f"light{number}")
        right, up = light.stated_deg
        ahead = right == up == 0
        nolens(
            "calibrate", *frames, "--distance", "300mm", "-o", mine,
            *(() if ahead else ("--angle", f"{right:g}deg,{up:g}deg")),
            *(("--camera", described) if number == 0 else ()),
        )  # fmt: skip
    stitched = nolens("calibrate", "stitch", mine)
    assert stitched["residual_pixels"] < 0.1

    Image.fromarray(astronaut()[:256, 100:356]).save(tmp_path / "scene.png")
    taken = nolens(
        "simulate", tmp_path / "scene.png", "--camera", mine, "--distance", "300mm",
        "--angle", f"{SCENE_DEG}deg", "--field-points", 3, "-o", tmp_path / "raw.dng",
        "--truth", tmp_path / "truth.tif",
    )  # fmt: skip
    truth = read_frame(tmp_path / "truth.tif").counts
    quality = {}
    for name in ("stitched", "psf"):
        wider = ("--psf-extent", "wide") if name == "stitched" else ()
        picture = tmp_path / f"{name}.tif"
        nolens(
            "reconstruct", tmp_path / "raw.dng", "--psf", mine / f"{name}-300mm.tif", *wider,
            "--support", taken["support"], "--tau", 1e-5, "--tiff-bits", 32, "-o", picture,
        )  # fmt: skip
        seen = read_frame(picture).counts
        quality[name] = psnr(affine_fit(seen, truth), truth, float(torch.quantile(truth, 0.999)))
    assert quality["stitched"] > quality["psf"] + 10, quality
