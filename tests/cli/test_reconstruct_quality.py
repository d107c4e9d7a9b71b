"""Presets of `nolens reconstruct`, and going on with a run."""

import json
import math
import zipfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from little_camera import SUPPORT, Camera, quality, save
from running import check_refused, run

import nolens as nl
from nolens.camera import preset
from nolens.camera.toml import to_toml
from nolens.errors import DataError, FileError, OptionError
from nolens.files import read_camera, read_frame
from nolens.jobs import ReconstructOptions, reconstruct
from nolens.operators import CroppedConvolution
from nolens.quantities import Length
from nolens.solvers import Progress
from nolens.twin import FieldMap, acceptance_support, preview_model


def solved(camera: Camera, out: Path, *asked: object) -> dict[str, object]:
    done = run(
        "reconstruct", camera.raw, "--psf", camera.psf, "--support", SUPPORT, "-o", out, *asked
    )
    assert done.code == 0, done.err
    record: dict[str, object] = json.loads(out.with_suffix(".json").read_text())
    return record


def test_too_little_memory_is_refused_before_the_work(
    camera: Camera, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("psutil.virtual_memory", lambda: SimpleNamespace(total=5e8))
    for preset_name in ("draft", "photo"):
        out = ("-o", tmp_path / "o.png", "--quality", preset_name, "--device", "cpu")
        done = run("reconstruct", camera.raw, "--psf", camera.psf, "--support", SUPPORT, *out)
        check_refused(done, "GB of memory, and the machine has 0.5 GB", "--support", "--bin")
    assert list(tmp_path.iterdir()) == []


def test_presets_cost_more_and_give_more(camera: Camera, tmp_path: Path) -> None:
    out = tmp_path / "o.tif"
    found = {}
    for each in ("draft", "photo", "exact"):
        record = solved(camera, out, "--quality", each, "--tiff-bits", 32)
        result = record["result"]
        assert isinstance(result, dict)
        found[each] = result["iterations"], quality(read_frame(out).counts)
        methods = {"draft": "wiener", "photo": "admm, plug-and-play", "exact": "admm"}
        assert result["method"] == methods[each]
        assert result["stop_reason"] == ("one shot" if each == "draft" else "converged")
    assert found["draft"][0] == 1 < found["photo"][0] < found["exact"][0]
    assert found["photo"][1] - 6 < found["draft"][1] < found["photo"][1]
    assert found["exact"][1] > 40


def test_photo_is_the_default(camera: Camera, tmp_path: Path) -> None:
    parameters = [
        solved(camera, tmp_path / "o.png", *asked)["parameters"]
        for asked in ((), ("--quality", "photo"))
    ]
    for each in parameters:
        assert isinstance(each, dict)
        del each["quality"], each["options_set"]
    assert parameters[0] == parameters[1]


@pytest.mark.parametrize("method", ["fista", "wiener"])
def test_preset_against_method(method: str, camera: Camera, tmp_path: Path) -> None:
    asked = ("-o", tmp_path / "o.png", "--quality", "exact", "--method", method)
    done = run("reconstruct", camera.raw, "--psf", camera.psf, *asked)
    check_refused(done, "--quality exact", f"--method {method}", "leave one out")


def _options(camera: Camera, out: Path, **more: object) -> ReconstructOptions:
    return ReconstructOptions.model_validate(
        {"measurement": camera.raw, "psf": camera.psf, "support": SUPPORT, "output": (out,),
         "iterations": 40, "tolerance": 0.0, "tiff_bits": 32, "psf_flip": "none", **more}
    )  # fmt: skip


class Watcher:
    """Stops a run at an iteration; hears nothing."""

    def __init__(self, until: float) -> None:
        self._until = until

    def note(self, text: str) -> None: ...

    def warn(self, text: str) -> None: ...

    def advance(self, what: str, fraction: float) -> None: ...

    def step(self, what: str, done: int, limit: int, result: str) -> bool:
        return False

    def progress(self, progress: Progress, limit: int) -> bool:
        return progress.iteration >= self._until


BY_DEFAULT = {"iterations": None, "tolerance": None}


@pytest.mark.parametrize("more", [{}, BY_DEFAULT])
def test_interrupted_run_goes_on(more: dict[str, object], camera: Camera, tmp_path: Path) -> None:
    """By total variation, and by the photo that a trained prior starts from."""
    whole, out = tmp_path / "whole.tif", tmp_path / "out.tif"
    reconstruct(_options(camera, whole, **more), Watcher(math.inf))
    outcome = reconstruct(_options(camera, out, **more), Watcher(12))
    assert outcome.summary["iterations"] == 12
    state = tmp_path / "out.state.npz"
    assert str(state) in outcome.summary["outputs"]
    with np.load(state) as stored:
        held = dict(stored)
    before = json.loads(str(held["about"]))  # As the version before called it.
    before |= {"region": before.pop("support"), "psf_wider": before.pop("psf_extent") == "wide"}
    np.savez(state, **held | {"about": _text(before)})
    reconstruct(_options(camera, out, resume=state, **more), Watcher(math.inf))
    a, b = read_frame(whole).counts, read_frame(out).counts
    torch.testing.assert_close(a, b, rtol=1e-3, atol=1e-3 * float(a.max()))


def test_state_of_another_run_is_refused(camera: Camera, tmp_path: Path) -> None:
    out = tmp_path / "out.tif"
    reconstruct(_options(camera, out), Watcher(12))
    state = tmp_path / "out.state.npz"
    asked = ("reconstruct", camera.raw, "--psf", camera.psf, "-o", tmp_path / "x.png",
             "--iterations", 40)  # fmt: skip
    done = run(*asked, "--support", SUPPORT, "--tau", 1e-3, "--resume", state)
    check_refused(done, "another tau", "leave out --resume")
    done = run(*asked, "--resume", state)
    check_refused(done, "another support")
    done = run(*asked, "--support", SUPPORT, "--resume", camera.psf)
    check_refused(done, "is no state file")
    assert not (tmp_path / "x.png").exists()


def _text(about: object) -> np.ndarray:
    return np.array(json.dumps(about))


EDITS: dict[str, Callable[[dict[str, Any], Any], dict[str, Any]]] = {
    "no array": lambda held, about: {"about": held["about"], "scene_0": held["scene_0"]},
    "no about": lambda held, about: held | {"about": None},
    "list as about": lambda held, about: held | {"about": _text([1])},
    "number as about": lambda held, about: held | {"about": np.array(1.0)},
    "texts as about": lambda held, about: held | {"about": np.array(["a", "b"])},
    "broken about": lambda held, about: held | {"about": np.array("{")},
    "deep about": lambda held, about: held | {"about": np.array("[" * 3000)},
    "NaN in about": lambda held, about: held | {"about": _text({**about, "tau": math.nan})},
    "list in about": lambda held, about: held | {"about": _text({**about, "tau": [1, [2]]})},
    "key in about": lambda held, about: held | {"about": _text({**about, "\x1b[31m": 1})},
    "another array": lambda held, about: held | {"extra": np.zeros(3)},
    "objects": lambda held, about: held | {"scene_0": np.array([{}], object)},
    "texts": lambda held, about: held | {"scene_0": np.array(["a"])},
    "doubles": lambda held, about: held | {"scene_0": held["scene_0"].astype(np.float64)},
    "complex": lambda held, about: held | {"scene_0": held["scene_0"].astype(np.complex64)},
    "large": lambda held, about: held | {"scene_0": np.zeros((2000, 2000), np.float32)},
    "small": lambda held, about: held | {"scene_0": held["scene_0"][1:]},
    "not finite": lambda held, about: held | {"rows_0": held["rows_0"] * np.float32(np.inf)},
    "negative penalties": lambda held, about: held | {"penalties": -held["penalties"]},
    "texts as penalties": lambda held, about: held | {"penalties": np.array(["1", "1", "1"])},
    "negative iteration": lambda held, about: held | {"iteration": np.array(-5)},
    "iterations": lambda held, about: held | {"iteration": np.array([1, 2])},
    "sums": lambda held, about: held | {"sums": np.zeros((1, 3))},
    "fills_view": lambda held, about: held | {"fills_view": np.array(7)},
}


def test_edited_state_is_refused(camera: Camera, tmp_path: Path) -> None:
    out, state = tmp_path / "out.tif", tmp_path / "out.state.npz"
    reconstruct(_options(camera, out), Watcher(12))
    with np.load(state) as stored:
        held = dict(stored)
    about = json.loads(str(held["about"]))
    for edit, change in EDITS.items():
        changed = {name: each for name, each in change(held, about).items() if each is not None}
        np.savez(state, **changed)
        with pytest.raises((OptionError, FileError, DataError)) as caught:
            reconstruct(_options(camera, tmp_path / "x.png", resume=state), Watcher(math.inf))
        said = str(caught.value)
        assert str(state) in said and len(said) < 500 and said.isprintable(), (edit, said)
    # A bomb: what is announced is looked at before it is unpacked.
    with zipfile.ZipFile(state, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("about.npy", b"0" * 10**8)
    asked = ("reconstruct", camera.raw, "--psf", camera.psf, "-o", tmp_path / "x.png")
    done = run(*asked, "--support", SUPPORT, "--resume", state)
    check_refused(done, "'about' has 100000000 bytes", "Accepted is a state file")
    assert not (tmp_path / "x.png").exists()


def test_field_is_the_region_that_the_camera_sees(tmp_path: Path) -> None:
    """Of the small preset: the support that its own simulation names for a scene of that angle."""
    generator = torch.Generator().manual_seed(1)
    sensor = preset("small").sensor
    rows, columns = sensor.rows // 2, sensor.columns // 2
    raw = save(tmp_path / "raw.npy", torch.rand(1, rows, columns, generator=generator))
    psf = save(
        tmp_path / "psf.npy", (torch.rand(1, rows, columns, generator=generator) > 0.99).float()
    )
    asked = ("reconstruct", raw, "--psf", psf, "-o", tmp_path / "o.png", "--iterations", 2)
    done = run(*asked, "--field", "30deg", "--camera", "small")
    assert done.code == 0, done.err
    twin = preview_model(read_camera("small"), fresnel=False)
    tangent = math.tan(math.radians(15))
    support = FieldMap.covering(twin, (tangent, tangent)).support
    assert read_frame(tmp_path / "o.png").counts.shape[1:] == (support.height, support.width)
    for more, words in (
        (("--field", "30deg"), "--field needs --camera"),
        (("--field", "30deg", "--camera", "paper"), "the measurement's camera"),
        (("--camera", "paper"), "the measurement's camera"),
        (("--field", "30deg", "--camera", "small", "--support", "9x9"), "leave one out"),
        (("--field", "0deg", "--camera", "small"), "field is '0deg'"),
    ):
        check_refused(run(*asked, *more), words)


def test_light_comes_from_where_the_camera_accepts_it(tmp_path: Path) -> None:
    """In photographs and sequences, by the camera beside the PSF, unless light shows beyond."""
    camera, size = preset("small"), (128, 160)
    thin = tuple(
        layer.model_copy(update={"thickness": Length.parse(f"{0.1 * layer.thickness.um} um")})
        for layer in camera.layers
    )
    camera = camera.model_copy(update={"layers": thin})
    path = tmp_path / "camera.toml"
    path.write_text(to_toml(camera))
    accepted = acceptance_support(preview_model(read_camera(path)))
    assert max(accepted.height, accepted.width) < min(size)
    generator = torch.Generator().manual_seed(3)
    points = (torch.rand(1, *size, generator=generator) > 0.98).float()
    points[:, :24], points[:, -24:], points[..., :32], points[..., -32:] = 0, 0, 0, 0
    psf = save(tmp_path / "psf.npy", points)
    frames = tmp_path / "frames"
    frames.mkdir()
    for name, support in (("in", accepted), ("beyond", None)):
        operator = CroppedConvolution(points, size, support)
        scene = torch.rand(1, *operator.domain_shape[-2:], generator=generator)
        light = operator(scene)
        light += 0.003 * light.mean() * torch.randn(light.shape, generator=generator)
        raw = save(frames / f"{name}.npy", light)
        out = tmp_path / f"{name}.tif"
        done = run("reconstruct", raw, "--psf", psf, "--prior", "tv", "-o", out)
        assert done.code == 0, done.err
        stored = json.loads(out.with_suffix(".json").read_text())["parameters"]["support"]
        within = "all that the camera accepts light from (automatic)" in done.out
        assert (stored, within) == ((accepted.text, True) if name == "in" else ("full", False))
    raw.unlink()
    photograph = nl.reconstruct(frames / "in.npy", psf, prior="tv")
    assert photograph.report.acceptance and photograph.values.shape[-2:] == size
    done = run("reconstruct", frames, "--psf", psf, "--iterations", 2, "-o", tmp_path / "pictures")
    assert done.code == 0, done.err
    record = json.loads((tmp_path / "pictures.json").read_text())
    assert record["parameters"]["support"] == accepted.text
