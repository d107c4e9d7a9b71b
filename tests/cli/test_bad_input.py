"""Each row of "Bad input": code 2, one clear message, nothing written."""

import ctypes
import subprocess
from pathlib import Path

import pytest
import torch
from little_camera import SENSOR, WHITE, Camera, as_counts, expose_dng, measured, save, spots
from PIL import Image
from running import check_refused, command, listing, run

from nolens.files import read_frame, write_dng


class Bench:
    """A folder with good files, to spoil one of them."""

    def __init__(self, folder: Path, camera: Camera) -> None:
        self.folder = folder
        self.raw, self.psf = folder / "raw.dng", folder / "psf.dng"
        self.raw.write_bytes(camera.raw.read_bytes())
        self.psf.write_bytes(camera.psf.read_bytes())
        self.out = folder / "out.png"

    def refuses(self, *words: str, more: tuple[object, ...] = (), **how: object) -> None:
        """The command says all words, and leaves the folder as it was.

        It runs in a process of its own where that has to be one of a certain kind.
        """
        before = listing(self.folder)
        asked = ("reconstruct", self.raw, "--psf", self.psf, "-o", self.out, "--json", *more)
        done = command(*asked, **how) if how else run(*asked)
        check_refused(done, *words)
        assert listing(self.folder) == before


@pytest.fixture
def bench(tmp_path: Path, camera: Camera) -> Bench:
    return Bench(tmp_path, camera)


def test_one_file_as_both(bench: Bench) -> None:
    bench.psf.write_bytes(bench.raw.read_bytes())
    bench.refuses("raw.dng and the PSF", "psf.dng hold the same values", "of a point source")


def test_missing_file(bench: Bench) -> None:
    bench.raw = bench.folder / "rwa.dng"
    bench.refuses("there is no file", "rwa.dng", f"Did you mean {bench.folder / 'raw.dng'}?")


def obey_permissions() -> None:
    """Root, too, is forbidden what the permissions forbid: drop CAP_DAC_OVERRIDE and the like."""
    for capability in (1, 2):
        ctypes.CDLL(None).prctl(24, capability, 0, 0, 0)


@pytest.fixture
def obedient(bench: Bench) -> dict[str, object]:
    """How to run so that permissions count."""
    how: dict[str, object] = {"preexec_fn": obey_permissions}
    closed = bench.folder / "closed"
    closed.touch(0)
    with subprocess.Popen(["cat", closed], stderr=subprocess.DEVNULL, **how) as reader:  # type: ignore[call-overload]
        pass
    closed.unlink()
    if reader.returncode == 0:
        pytest.skip("nothing is forbidden to root here")
    return how


def test_unreadable_file(bench: Bench, obedient: dict[str, object]) -> None:
    bench.raw.chmod(0)
    bench.refuses("cannot read", "raw.dng", "Permission denied", **obedient)


def test_folder_that_cannot_be_written(bench: Bench, obedient: dict[str, object]) -> None:
    bench.folder.chmod(0o555)
    bench.refuses("cannot write", "out.png", "no permission", **obedient)


def test_not_a_picture(bench: Bench) -> None:
    bench.raw.write_text("these are words, not counts")
    bench.refuses("raw.dng", "camera raw of a known kind: it is damaged or incomplete")


def test_jpeg(bench: Bench) -> None:
    bench.raw = bench.folder / "raw.jpg"
    Image.new("RGB", (64, 48)).save(bench.raw)
    bench.refuses("raw.jpg", "not proportional to light", "Accepted are camera raw")


def test_another_size(bench: Bench) -> None:
    save(bench.folder / "small.npy", spots((40, 60)))
    bench.psf = bench.folder / "small.npy"
    bench.refuses("small.npy has 40×60", "raw.dng has 48×64")


def test_another_mosaic(bench: Bench) -> None:
    frame = read_frame(bench.psf)
    write_dng(bench.psf, frame.counts[0], pattern="BGGR", black=256, white=WHITE)
    bench.refuses("psf.dng has the colour mosaic BGGR", "raw.dng has RGGB", "same readout")


def test_all_zero_data(bench: Bench) -> None:
    bench.raw = save(bench.folder / "zero.tif", torch.zeros(3, *SENSOR))
    bench.refuses("zero.tif", "is 0 everywhere", "Check the exposure")


def test_nan(bench: Bench) -> None:
    values = measured(spots())
    values[1, 5, 6] = float("nan")
    bench.raw = save(bench.folder / "nan.npy", values)
    bench.refuses("nan.npy", "1 values that are NaN or infinite", "repair")


def test_psf_of_noise(bench: Bench) -> None:
    expose_dng(bench.psf, torch.ones(3, *SENSOR), seed=4)
    bench.refuses("psf.dng", "nothing above its background", "point source")


def test_saturated_everywhere(bench: Bench) -> None:
    bench.refuses("raw.dng", "all are saturated", "--white", more=("--white", 1))


def test_negative_tau(bench: Bench) -> None:
    bench.refuses("tau is", "-1", "0 to 1000000", more=("--tau", -1))


def test_unknown_option(bench: Bench) -> None:
    bench.refuses("--iteration", "Did you mean --iterations?", more=("--iteration", 3))


def test_unknown_key(bench: Bench) -> None:
    config = bench.folder / "run.toml"
    config.write_text("iteratoins = 20\n")
    bench.refuses("run.toml", "'iteratoins'", "'iterations'", more=("--config", config))


def test_missing_output_folder(bench: Bench) -> None:
    bench.out = bench.folder / "results" / "out.png"
    bench.refuses("out.png", "there is no folder", "results", "Make it first")


def test_no_cuda(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    words = ("--device cuda", "no CUDA device", "cpu or auto")
    bench.refuses(*words, more=("--device", "cuda"))


def test_output_over_an_input(bench: Bench) -> None:
    bench.raw = save(bench.folder / "raw.png", as_counts(measured(spots()), seed=1))
    bench.out = bench.raw
    bench.refuses("raw.png would overwrite the measurement", "give another name")


def test_truncated_dng(bench: Bench) -> None:
    bench.raw.write_bytes(bench.raw.read_bytes()[:-5000])
    bench.refuses("raw.dng", "incomplete")


def test_truncated_tiff(bench: Bench) -> None:
    bench.psf = save(bench.folder / "psf.tif", as_counts(spots(), seed=1))
    bench.psf.write_bytes(bench.psf.read_bytes()[:-5000])
    bench.refuses("psf.tif", "incomplete")


def test_disk_that_is_full(bench: Bench) -> None:
    """No file can grow beyond 6 kB: the record fits, the float TIFF does not."""
    resource = pytest.importorskip("resource")
    bench.out = bench.folder / "out.tif"
    quick = ("--support", "full", "--prior", "tv", "--tau", 1e-2, "--iterations", 2,
             "--tiff-bits", 32)  # fmt: skip
    # Once without a limit: the first run after an installation stores what it compiles.
    good = run("reconstruct", bench.raw, "--psf", bench.psf, "-o", bench.folder / "x.tif", *quick)
    assert good.code == 0, good
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (6000, hard))
    try:
        bench.refuses(f"cannot write {bench.out}", "has space", more=quick)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
