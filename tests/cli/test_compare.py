"""`nolens compare`: files and folders of pictures against the truth."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import torch
from running import check_refused, listing, run
from skimage import data
from torch import Tensor

from nolens.evaluate import affine_fit, psnr, ssim
from nolens.files import write_png, write_tiff32
from real_data import real_data

NAMES = ("cat", "cup", "rocket", "man")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A truth and two methods: the second has more noise; all of them linear."""
    made = tmp_path_factory.mktemp("compare")
    scenes = (data.chelsea, data.coffee, data.rocket, data.astronaut)
    for number, (name, scene) in enumerate(zip(NAMES, scenes, strict=True)):
        values = torch.from_numpy(scene()[:192, :256].copy()).permute(2, 0, 1).double() / 255
        truth = torch.nn.functional.avg_pool2d(values[None], 4)[0].float()
        for where, noise in (("truth", 0.0), ("tv", 0.02), ("wiener", 0.05)):
            (made / where).mkdir(exist_ok=True)
            rough = torch.randn(truth.shape, generator=torch.manual_seed(number))
            picture = truth if where == "truth" else 0.4 * truth + 0.1 + noise * rough
            write_tiff32(made / where / f"{name}.tif", picture)
    return made


def read(path: Path) -> Tensor:
    from nolens.files.picture_sets import open_pictures

    found = open_pictures(path)
    return found.read(found.names[0])


def test_one_picture(folder: Path) -> None:
    paths = folder / "tv" / "cat.tif", folder / "truth" / "cat.tif"
    before = listing(folder)
    done = run("compare", *paths, "--json")
    assert done.code == 0 and "LPIPS is left out" in done.err, done
    told = json.loads(done.out)
    picture, truth = map(read, paths)
    fitted = affine_fit(picture, truth).clamp(0, 1)
    figures = told["methods"]["cat"]
    assert figures["psnr_db"]["mean"] == pytest.approx(psnr(fitted, truth, 1.0))
    assert figures["ssim"]["mean"] == pytest.approx(ssim(fitted, truth, 1.0))
    assert figures["ms_ssim"]["mean"] is None and figures["register"] == "none"
    both = run(
        "compare", paths[0], folder / "tv" / "man.tif", paths[1], "--register", "none", "--json"
    )
    methods = json.loads(both.out)["methods"]
    assert methods["cat"] == figures
    assert methods["man"]["psnr_db"]["mean"] < figures["psnr_db"]["mean"]
    same = run("compare", paths[1], paths[1])
    assert "∞    1.000" in same.out and listing(folder) == before


def test_methods_side_by_side(folder: Path, tmp_path: Path) -> None:
    done = run(
        "compare", f"tv={folder / 'tv'}", f"wiener={folder / 'wiener'}", "--truth",
        folder / "truth", "-o", tmp_path / "report", "--worst", 1, "--json",
    )  # fmt: skip
    assert done.code == 0, done.err
    told = json.loads(done.out)
    assert sorted(each.name for each in (tmp_path / "report").iterdir()) == [
        "compare.csv", "compare.json", "compare.png", "worst-tv.png", "worst-wiener.png",
    ]  # fmt: skip
    with (tmp_path / "report" / "compare.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["method"], row["picture"]) for row in rows[:4]] == [
        ("tv", name) for name in sorted(NAMES)
    ]
    by = {
        name: np.array([float(row["psnr_db"]) for row in rows if row["method"] == name])
        for name in ("tv", "wiener")
    }
    first = told["differences"][0]
    assert (first["method"], first["minus"], first["figure"]) == ("tv", "wiener", "psnr_db")
    assert first["mean"] == pytest.approx((by["tv"] - by["wiener"]).mean(), abs=1e-3)
    assert 0 < first["low"] < first["mean"] < first["high"]
    text = run("compare", folder / "tv", folder / "wiener", folder / "truth").out
    assert "tv − wiener: PSNR, dB +" in text and "95 %: +" in text


def test_registration_and_missing_pictures(folder: Path, tmp_path: Path) -> None:
    """Pictures that lie beside their truth are laid on it; what has no partner is said."""
    (tmp_path / "moved").mkdir()
    for name in NAMES[:2]:
        picture = read(folder / "truth" / f"{name}.tif")
        write_tiff32(tmp_path / "moved" / f"{name}.tif", picture.roll((2, -1), (-2, -1)))
    write_tiff32(tmp_path / "moved" / "other.tif", picture)
    arguments = ("compare", tmp_path / "moved", folder / "truth", "--json")
    report = ("-o", tmp_path / "report", "--worst", 0)
    laid, left = (run(*arguments, *more) for more in (report, ("--register", "none")))
    assert "1 of 3 pictures" in laid.err and "left out" in laid.err and "other" in laid.err
    assert "lie beside their truth" in laid.err and "lie beside" not in left.err
    better, worse = (json.loads(each.out)["methods"]["moved"] for each in (laid, left))
    with (tmp_path / "report" / "compare.csv").open(newline="") as file:
        row = next(csv.DictReader(file))
    assert row["register"] == "similarity" and float(row["turn_deg"]) == pytest.approx(0, abs=0.3)
    middle = [float(row[name]) for name in ("row_in_truth", "column_in_truth")]
    assert middle == pytest.approx([23.5 - 2, 31.5 + 1], abs=0.2)
    assert better["register"] == "similarity" and better["error_px"] < 0.2
    assert better["psnr_db"]["mean"] > worse["psnr_db"]["mean"] + 8
    upside_down = tmp_path / "cat.png"
    write_png(upside_down, read(folder / "truth" / "cat.tif").flip(-2), 1.0)
    done = run("compare", upside_down, folder / "truth" / "cat.tif")
    assert "much better turned over: --flip vertical" in done.err
    done = run("compare", upside_down, folder / "truth" / "cat.tif", "--flip", "vertical", "--json")
    assert json.loads(done.out)["methods"]["cat"]["psnr_db"]["mean"] > 40


def test_pairs_of_diffusercam_as_published(tmp_path: Path) -> None:
    """B, G, R, upside down, and the screen in a part of the frame, as docs/results takes them."""
    pairs = real_data("diffusercam-pairs")
    stored = np.load(pairs / "lensed" / "im43.npy")[:, 60:470, ::-1]
    truth = torch.from_numpy(stored.copy()).permute(2, 0, 1).flip(-2)
    picture = torch.nn.functional.avg_pool2d(truth[None], 5, 1, 2)[0]
    write_tiff32(tmp_path / "im43.tif", 0.5 * picture + 0.1)
    done = run("compare", tmp_path, pairs, "--crop", "270x410+0+60", "--flip", "vertical", "--json")
    assert done.code == 0, done.err
    fitted = affine_fit(0.5 * picture + 0.1, truth).clamp(0, 1)
    figures = json.loads(done.out)["methods"][tmp_path.name]
    assert figures["psnr_db"]["mean"] == pytest.approx(psnr(fitted, truth, 1.0), abs=1e-4)
    assert figures["ssim"]["mean"] == pytest.approx(ssim(fitted, truth, 1.0), abs=1e-5)


def test_refused(folder: Path, tmp_path: Path) -> None:
    truth, tv = folder / "truth", folder / "tv"
    write_tiff32(tmp_path / "cat.tif", torch.rand(3, 40, 90))
    write_tiff32(tmp_path / "dog.tif", torch.rand(3, 48, 64))
    for arguments, words in (
        ([], ["no picture is given", "nolens compare PICTURES TRUTH"]),
        ([truth], ["has nothing to be compared with"]),
        ([tv, tv, truth], ["two methods are called 'tv'"]),
        ([tv / "none.tif", truth], ["there is no file"]),
        ([tmp_path / "dog.tif", truth], ["no picture has the name of its truth"]),
        ([tmp_path / "cat.tif", truth / "cat.tif", "--register", "none"], ["40×90", "--crop"]),
        ([tmp_path / "dog.tif", truth / "cat.tif", "--register", "shift"], ["cannot be laid on"]),
        ([tv, truth, "--crop", "99x99+0+0"], ["not within", "48×64 pixels"]),
    ):
        check_refused(run("compare", *arguments, "-o", tmp_path / "report"), *words)
    assert not (tmp_path / "report").exists()
    check_refused(run("compare", tv, folder / "nowhere"), "nowhere")
