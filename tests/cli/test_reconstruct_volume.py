"""`nolens reconstruct --depths`: planes that are solved together."""

import json
import math
from html import escape
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import psutil
import pytest
import tifffile
import torch
from running import Done, check_refused, listing, run

import nolens as nl
from depth_spots import (
    FAR_UM,
    NEAR_UM,
    SUPPORT,
    noisy,
    objects,
    spots,
    two_objects,
    write_raw,
    write_set,
)
from nolens.camera import develop, preset
from nolens.errors import OptionError
from nolens.evaluate import psnr, scale_fit
from nolens.files import read_frame
from nolens.files.psf_folder import PsfFolder
from nolens.jobs import ReconstructOptions, Reporter
from nolens.jobs import reconstruct as reconstruct_job
from nolens.jobs.reconstruction.stack import fewer_slices
from nolens.refocusing import DepthReconstructor, photon_variance, spacing_warnings
from nolens.twin import expose


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("volume")
    write_set(folder / "camera", (15, 60, 1000))
    write_raw(folder / "raw.tif", noisy(two_objects(), 0.002))
    return folder


def reconstruct(made: Path, out: Path, *more: object) -> Done:
    return run(
        "reconstruct", made / "raw.tif", "--psf", made / "camera", "--support", "30x48", "-o", out,
        "--device", "cpu", *more,
    )  # fmt: skip


def errors_db(pages: list[torch.Tensor]) -> list[float]:
    """PSNR of each object in its plane."""
    pairs = zip(pages, objects(), strict=True)
    return [psnr(scale_fit(page, truth), truth, 1.0) for page, truth in pairs]


def test_two_objects(made: Path, tmp_path: Path) -> None:
    """Each in its plane, without the other, which one by one shows there too."""
    out = tmp_path / "out"
    done = reconstruct(made, out, "--depths", "8cm,2cm", "--tau", 1e-3, "--json")
    assert done.code == 0, done.err
    summary: dict[str, Any] = json.loads(done.out)
    assert {path.name for path in out.iterdir()} == {
        "volume.ome.tif", "volume.html", "volume.json", "sweep.html", "sweep.png",
        "all-in-focus.png", "depth.png", "depth.tif",
    }  # fmt: skip
    assert summary["depths_mm"] == [20, 80] and "not modelled" in summary["occlusion"]
    assert summary["field_points"] == 1
    with tifffile.TiffFile(out / "volume.ome.tif") as stack:
        assert stack.is_ome and stack.series[0].axes == "ZYX"
        pages = [torch.from_numpy(page)[None] for page in stack.asarray()]
        assert stack.ome_metadata is not None and 'PositionZ="80.0"' in stack.ome_metadata
    measured = develop(read_frame(made / "raw.tif"))
    alone = DepthReconstructor(measured, SUPPORT, 1e-3)
    apart = [alone.solve(spots(depth)).photograph for depth in (NEAR_UM, FAR_UM)]
    gains = [a - b for a, b in zip(errors_db(pages), errors_db(apart), strict=True)]
    assert min(errors_db(pages)) > 30 and min(gains) > 10
    millimetres = tifffile.imread(out / "depth.tif")
    for depth, columns in ((NEAR_UM, slice(4, 19)), (FAR_UM, slice(29, 44))):
        window = 1e3 / millimetres[5:25, columns]
        assert np.median(window) == pytest.approx(1e6 / depth, rel=0.02)
    page = (out / "volume.html").read_text()
    assert page.count('<img class="plane"') == 2 and "2 cm, 8 cm" in page

    folder = PsfFolder(made / "camera")
    psfs = {each.distance: folder.frame(each) for each in folder.psfs}
    mine = nl.reconstruct_volume(
        read_frame(made / "raw.tif"), psfs, ["8cm", "2cm"], support=(30, 48), tau=1e-3
    )
    torch.testing.assert_close(torch.stack(pages), mine.values, rtol=1e-4, atol=1e-4)
    assert mine.depths_mm == (20, 80) and mine.figures["tau"] == 1e-3
    near, far = nl.reconstruct_volume(
        *(read_frame(made / "raw.tif"), psfs, ["8cm", "2cm"]),
        support=(30, 48), tau=1e-3, iterations=12, depth_smoothness=30.0, noise="poisson",
    ).values  # fmt: skip
    assert float((near - far).norm() / far.norm()) < 0.2  # Else 1.4: each has its own half.
    assert {*mine.writers, "volume.json"} == {path.name for path in out.iterdir()}
    assert mine._repr_html_().count(escape('<img class="plane"')) == 2


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--depths", "8cm"), ("two depths or more",)),
        (("--depths", "8cm,80mm"), ("each once",)),
        (("--depths", "8cm,fog"), ("'fog'", "infinity")),
        (("--depths", "2cm,8cm", "--sweep", "tau"), ("--sweep", "leave it out")),
        (("--depths", "2cm,8cm", "--prior", "colour-tv"), ("choose auto, tv, isotropic-tv, l1",)),
        (("--noise", "shot"), ("--noise shot is for --depths",)),
        (
            ("--depths", "2cm,8cm", "--prior", "l1", "--depth-smoothness", "1"),
            ("--depth-smoothness 1", "leave one"),
        ),
        (("--depths", "2cm,8cm", "--psf", "psf-60mm.tif"), ("--distance 30cm", "--camera")),
    ],
    ids=lambda each: "-".join(each[:2]).strip("-") if isinstance(each, tuple) else None,
)
def test_refused(
    made: Path, tmp_path: Path, options: tuple[str, ...], words: tuple[str, ...]
) -> None:
    psf = made / "camera" / options[-1] if "--psf" in options else made / "camera"
    kept = options[:2] if "--psf" in options else options
    before = listing(tmp_path)
    done = run("reconstruct", made / "raw.tif", "--psf", psf, "-o", tmp_path / "out", *kept)
    check_refused(done, *words)
    assert listing(tmp_path) == before


def test_more_depths_than_there_is_memory_for(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = ReconstructOptions(
        measurement=made / "raw.tif",
        psf=made / "camera",
        output=(tmp_path / "out",),
        support="30x48",
        depths=",".join(f"{k}mm" for k in range(20, 60)),
        device="cpu",
    )
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(total=5.2e8))
    with pytest.raises(Exception, match=r"[1-9]\d? depths would fit in place of 40") as refused:
        reconstruct_job(options, Reporter())
    assert "--bin" in str(refused.value) and not (tmp_path / "out").exists()
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(total=5.001e8))
    with pytest.raises(OptionError, match=r"not even 2 depths would fit.*; --channels grey"):
        reconstruct_job(options, Reporter())
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(total=5.025e8))
    texts = [fewer_slices("frames", count, 1e6, torch.device("cpu"), "bin") for count in (2, 24)]
    assert texts == ["bin", "2 frames would fit in place of 24; bin"]


def test_planes_that_look_alike_and_gaps() -> None:
    even = [1e6 / each if each else math.inf for each in (20, 10, 0)]
    assert spacing_warnings(even, 10.0) == []
    (close,) = spacing_warnings(even, 25.0)
    assert "nearer to one another" in close and "100 mm and infinity" in close
    (wide,) = spacing_warnings([50e3, 100e3], 5.0)
    assert "gaps" in wide and "50 mm and 100 mm (2.0)" in wide
    (many,) = spacing_warnings([1e6 / each for each in range(600, 0, -1)], 25.0)
    assert many.count(" mm and ") == 3 and "1.675 mm, and 596 more are" in many


def test_variance_is_that_of_a_sensor() -> None:
    """Of counts that the simulated sensor gives for even light, to the sensor's own factor."""
    sensor = preset("paper").sensor
    for electrons in (0.5, 20.0, 2000.0):
        frame = expose(torch.full((200, 200), electrons), sensor, seed=0).double()
        values = (frame - sensor.black_counts)[None]
        known = photon_variance(SimpleNamespace(values=values.float()), sensor)  # type: ignore[arg-type]
        assert float(known.mean()) == pytest.approx(float(values.var()), rel=0.05)
