"""Cells of a reconstruction: no finer than is worth it through the PSF, unless asked."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from running import Done, run

from nolens.evaluate import psnr, scale_fit
from nolens.files import read_frame

SIZE = (150, 190)
SIGMA = 3.3
SIDE = 3


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return written(tmp_path_factory.mktemp("cells"), SIGMA)


def written(folder: Path, sigma: float) -> dict[str, Path]:
    """A sparse scene of soft spots seen through a PSF of soft spots, some noise."""
    generator = torch.Generator().manual_seed(2)
    down = torch.fft.fftfreq(SIZE[0], dtype=torch.float64)[:, None]
    right = torch.fft.rfftfreq(SIZE[1], dtype=torch.float64)
    soft = torch.exp(-2 * (math.pi * sigma) ** 2 * (down.square() + right.square()))
    points = (torch.rand(SIZE, generator=generator) > 0.998).double()
    spectrum = torch.fft.rfft2(points) * soft
    psf = torch.fft.irfft2(spectrum, s=SIZE).clamp_min(0)
    scene = torch.zeros(SIZE, dtype=torch.float64)
    scene[60:78, 70:100] = 1
    scene[84:90, 96:120] = 0.5
    shifted = torch.fft.ifftshift(psf)
    data = torch.fft.irfft2(torch.fft.rfft2(shifted) * torch.fft.rfft2(scene), s=SIZE)
    data += 1e-3 * data.max() * torch.randn(SIZE, generator=generator, dtype=torch.float64)
    paths = {}
    for name, values in (("psf", psf), ("data", data), ("scene", scene)):
        paths[name] = folder / f"{name}.npy"
        np.save(paths[name], values.float().numpy())
    return paths


def very_soft() -> "np.ndarray[tuple[int, int], np.dtype[np.float32]]":
    """One spot that carries nothing finer than nine cells."""
    row, column = (np.arange(n) - n // 2 for n in SIZE)
    spot = np.exp(-(row[:, None] ** 2 + column**2) / (2 * 9.0**2))
    return spot.astype(np.float32)


def solved(files: dict[str, Path], out: Path, *asked: object) -> Done:
    done = run(
        "reconstruct", files["data"], "--psf", files["psf"], "-o", out, "--tiff-bits", 32, *asked
    )
    assert done.code == 0, done.err
    return done


def binned(picture: torch.Tensor) -> torch.Tensor:
    return torch.nn.functional.avg_pool2d(picture[None], SIDE)[0]


@pytest.mark.parametrize(("noise", "loss_db"), [(0.0, 1.5), (0.01, 1.0)])
def test_draft_loses_little_by_cells_half_as_large_as_carried(
    noise: float, loss_db: float, tmp_path: Path
) -> None:
    files = written(tmp_path, 2 * SIGMA)
    data = np.load(files["data"])
    seen = {**files, "data": tmp_path / "noisy.npy"}
    rng = np.random.default_rng(3)
    np.save(seen["data"], data + noise * data.max() * rng.standard_normal(SIZE).astype("f4"))
    coarse, fine = tmp_path / "coarse.tif", tmp_path / "fine.tif"
    told = solved(seen, coarse, "--quality", "draft")
    assert f"no detail finer than {2 * SIDE} pixels" in told.err
    assert f"{SIDE}×{SIDE} of them are made one (--bin 1" in told.err
    assert json.loads(coarse.with_suffix(".json").read_text())["parameters"]["bin"] == SIDE
    solved(seen, fine, "--quality", "draft", "--bin", 1)
    truth = binned(read_frame(files["scene"]).counts)
    pictures = read_frame(coarse).counts, binned(read_frame(fine).counts)
    assert pictures[0].shape == truth.shape
    # Each has a weight of its own, chosen on its pixels.
    reached = [psnr(scale_fit(each, truth), truth, 1.0) for each in pictures]
    assert reached[0] > max(reached[1] - loss_db, 18.5)


def test_photo_keeps_cells_that_the_prior_can_use(files: dict[str, Path], tmp_path: Path) -> None:
    out = tmp_path / "o.tif"
    told = solved(files, out, "--tau", 6e-4)
    assert f"--bin {SIDE} would be about {SIDE * SIDE} times faster" in told.err
    assert read_frame(out).counts.shape[-2:] == SIZE
    picture, truth = read_frame(out).counts, read_frame(files["scene"]).counts
    fine = psnr(scale_fit(picture, truth), truth, 1.0)
    solved(files, out, "--tau", 6e-4, "--bin", SIDE)
    upright = torch.nn.functional.interpolate(
        read_frame(out).counts[None], scale_factor=SIDE, mode="bicubic"
    )[0]
    part = truth[:, : upright.shape[1], : upright.shape[2]]
    assert fine > psnr(scale_fit(upright, part), part, 1.0) + 1


def test_a_part_of_the_scene_names_cells(files: dict[str, Path], tmp_path: Path) -> None:
    out = tmp_path / "o.tif"
    quick = ("--support", "60x80", "--tau", 6e-4, "--iterations", 4)
    told = solved(files, out, *quick)
    assert f"--bin {SIDE}" in told.err
    assert read_frame(out).counts.shape[-2:] == (60, 80)
    assert "detail" not in solved(files, out, *quick, "--bin", 1).err


def test_frames_of_a_sequence_have_the_cells_of_the_first(
    files: dict[str, Path], tmp_path: Path
) -> None:
    data = np.load(files["data"])
    stack = tmp_path / "stack.npy"
    np.save(stack, np.stack([data, 0.5 * data]))
    soft = tmp_path / "psf.npy"
    np.save(soft, very_soft())
    quick = ("--tau", 6e-4, "--iterations", 4)
    done = run("reconstruct", stack, "--psf", soft, "-o", tmp_path / "pictures", *quick)
    assert done.code == 0, done.err
    shapes = [
        read_frame(path).counts.shape for path in sorted((tmp_path / "pictures").glob("*.png"))
    ]
    assert len(shapes) == 2
    assert all(shape[-2:] == (SIZE[0] // 2, SIZE[1] // 2) for shape in shapes)
