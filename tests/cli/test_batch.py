"""`nolens batch`: every frame once and on its own, whatever becomes of the commands."""

import json
import shutil
import signal
import socketserver
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch
import zarr
from distributed import LocalCluster
from little_camera import SUPPORT, measured, quality, save, spots, truth
from running import check_refused, listing, run, start

from nolens.files import read_frame
from patience import PATIENCE_S

FRAMES = 5
QUICK = ("--tau", 8e-3, "--support", SUPPORT, "--iterations", 24)
ODD = "take 2"
"""A frame of another size."""


@dataclass(frozen=True)
class Batch:
    """A set of frames, and what one worker makes of it in one go."""

    frames: Path
    psf: Path
    folder: Path
    store: Path
    error: str

    def arguments(self, folder: Path, *more: object) -> tuple[object, ...]:
        """Of the command that writes into a folder."""
        given = (self.frames, "--psf", self.psf, "-o", folder, *QUICK)
        return ("batch", "reconstruct", *given, "--formats", "png", "--formats", "tif", *more)

    def check_same(self, folder: Path) -> None:
        """All pictures are there, and equal."""
        pictures = {
            name: content
            for name, content in listing(folder).items()
            if name.endswith((".png", ".tif"))
        }
        assert len(pictures) == 2 * (FRAMES - 1)
        assert pictures.items() <= listing(self.folder).items()


def scene(number: int) -> torch.Tensor:
    return torch.roll(truth(), number, -1)


@pytest.fixture(scope="module")
def batch(tmp_path_factory: pytest.TempPathFactory) -> Batch:
    folder = tmp_path_factory.mktemp("batch")
    frames = folder / "frames"
    frames.mkdir()
    for number in range(FRAMES):
        values = measured(spots(), scene(number))
        path = frames / f"take {number}.npy"
        save(path, values[:, 1:] if path.stem == ODD else values)
    psf, store = save(folder / "psf.npy", spots()), folder / "all.zarr"
    made = Batch(frames, psf, folder / "out", store, "")
    done = run(*made.arguments(made.folder, "--workers", 1, "--store", store, "--json"))
    assert done.code == 3, done
    assert json.loads(done.out)["done"] == FRAMES - 1
    return Batch(frames, psf, folder / "out", store, done.err)


def test_pictures_are_right_and_the_odd_frame_is_named(batch: Batch) -> None:
    assert f"{ODD} failed: the measurement is (3, 47, 64), and those before it" in batch.error
    stored = zarr.open_group(batch.store, mode="r")
    assert stored.metadata.consolidated_metadata is not None
    assert [each["name"] for each in stored.attrs["ome"]["multiscales"][0]["axes"]] == [*"tcyx"]
    for number in range(FRAMES):
        name = f"take {number}"
        if name == ODD:
            assert not (batch.folder / f"{name}.png").exists()
            continue
        picture = read_frame(batch.folder / f"{name}.tif").counts
        assert quality(picture, scene(number)) > 20
        light = torch.from_numpy(np.asarray(stored["0"][number]))
        assert quality(picture, light / light.max()) > 60
    record = json.loads((batch.folder / "batch.json").read_text())
    rows = {each["item"]: each for each in record["parameters"]["rows"]}
    assert rows[ODD]["attempts"] == 3
    assert all(rows[name]["iterations"] == 24 for name in rows if name != ODD)


def test_killed_and_run_again(batch: Batch, tmp_path: Path) -> None:
    """With more workers; what is there is not made again."""
    folder = tmp_path / "out"
    first = folder / "take 0.tif"
    with start(*batch.arguments(folder, "--workers", 1)) as process:
        end = time.monotonic() + PATIENCE_S
        while not first.exists() and process.poll() is None and time.monotonic() < end:
            time.sleep(0.005)
        process.send_signal(signal.SIGKILL)
    before = {path: path.stat().st_mtime_ns for path in folder.glob("take*")}
    assert first in before
    done = run(*batch.arguments(folder, "--workers", 2))
    assert done.code == 3, done
    batch.check_same(folder)
    assert {path: path.stat().st_mtime_ns for path in before} == before


@pytest.fixture(scope="module")
def scheduler(cluster: LocalCluster) -> str:
    """Its address."""
    address: str = cluster.scheduler_address
    return address


def test_cluster(batch: Batch, tmp_path: Path, scheduler: str) -> None:
    """The same pictures, from workers that get all they need by the network."""
    done = run(*batch.arguments(tmp_path / "out", "--scheduler", scheduler))
    assert done.code == 3, done
    batch.check_same(tmp_path / "out")


class Dashboard(socketserver.BaseRequestHandler):
    """A server of something else, which answers whatever it is asked."""

    def handle(self) -> None:
        self.request.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")


def test_refusals(batch: Batch, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    shutil.copytree(batch.folder, folder)
    other = run(*batch.arguments(folder, "--store", batch.store, "--bin", 2))
    check_refused(other, "another --bin: None there, 2 now", "another folder (-o)")
    store = shutil.copytree(batch.store, tmp_path / "older.zarr") / "zarr.json"
    store.write_text(store.read_text().replace('"0.5"', '"0.4"'))
    (folder / "manifest.sqlite").unlink()
    older = run(*batch.arguments(folder, "--store", store.parent))
    check_refused(older, "by this version of nolens", "another name (--store)")
    with socketserver.TCPServer(("127.0.0.1", 0), Dashboard) as other_server:
        threading.Thread(target=other_server.handle_request, daemon=True).start()
        address = f"tcp://127.0.0.1:{other_server.server_address[1]}"
        nobody = run(*batch.arguments(tmp_path / "new", "--scheduler", address))
    check_refused(nobody, f"no Dask scheduler answers at {address}", "not that of its dashboard")
    assert not (tmp_path / "new").exists()


def test_any_job_of_an_item(batch: Batch, tmp_path: Path) -> None:
    """The figures are those of the job alone; a damaged file is named."""
    psfs = tmp_path / "psfs"
    psfs.mkdir()
    shutil.copy(batch.psf, psfs / "good.npy")
    (psfs / "torn.npy").write_bytes(batch.psf.read_bytes()[:99])
    out = tmp_path / "out"
    given = ("--pixel", "30um", "--channels", "g")
    done = run("batch", "measure", "psf", psfs, "-o", out, *given, "--workers", 1, "--json")
    assert done.code == 3, done
    [(name, reason)] = json.loads(done.out)["failed"].items()
    assert name == "torn" and reason.startswith("torn.npy ")
    alone = json.loads(run("measure", "psf", batch.psf, *given, "--json").out)
    rows = json.loads((out / "batch.json").read_text())["parameters"]["rows"]
    assert rows[0]["item"] == "good"
    assert rows[0]["fwhm_um"] == pytest.approx(alone["fwhm_um"], rel=1e-4)
