"""Small good files of every kind that a command or the studio reads: what the fuzzer damages."""

import json
import sys
from pathlib import Path

import av
import h5py
import imagecodecs
import numpy as np
import OpenEXR
import pyarrow as pa
import scipy.io
import tifffile
import torch
import zarr
from PIL import Image
from pyarrow import parquet
from readers import JOB

from nolens.camera import Camera, PsfEntry, from_toml, preset, to_toml
from nolens.files import write_psfs
from nolens.jobs import ReconstructOptions, Reporter, reconstruct
from nolens.quantities import Angle, Length
from nolens.solvers import Progress

sys.path += [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / "cli")]
from little_camera import expose_dng, measured, save, spots
from running import run

SENSOR = (48, 64)
"""Superpixels of the simulated sensor: 96×128 pixels with a mosaic."""


def tiny_camera() -> Camera:
    """The preset `small` with 96×128 pixels and a coarse relief: patterns in milliseconds."""
    text = to_toml(preset("small"))
    for before, after in (
        ('name = "small"', 'name = "tiny"'),
        ("rows = 256", "rows = 96"),
        ("columns = 320", "columns = 128"),
        ('overhang = "0.6 mm"', 'overhang = "0.1 mm"'),
        ('width = "0.25 mm"', 'width = "60 um"'),
        ('height = "0.2 mm"', 'height = "50 um"'),
    ):
        assert before in text, before
        text = text.replace(before, after)
    return from_toml(Camera, text, "tiny")


def make_seeds(folder: Path) -> None:
    """Write all of them below a folder; the same files each time."""
    folder.mkdir(parents=True, exist_ok=True)
    psf, light = spots(), measured(spots())
    counts = (256 + 3500 * light / light.max()).round()
    bright = (256 + 3500 * psf / psf.max()).round()
    for suffix in ("png", "tif", "npy"):
        save(folder / f"raw.{suffix}", counts)
        save(folder / f"psf.{suffix}", bright)
    save(folder / "grey.png", counts[1:2])
    save(folder / "grey.tif", counts[1:2])
    save(folder / "grey-psf.png", bright[1:2])
    save(folder / "dark.tif", torch.full_like(counts, 256))
    tifffile.imwrite(
        folder / "tiled.tif",
        counts[1].numpy().astype(np.uint16),
        tile=(16, 16),
        compression="zlib",
        predictor=True,
    )
    expose_dng(folder / "raw.dng", light, seed=1)
    expose_dng(folder / "psf.dng", psf, seed=2)
    np.save(folder / "frames.npy", np.stack([counts[1].numpy(), counts[1].numpy() + 1]))
    tifffile.imwrite(folder / "frames.tif", np.stack([counts[1].numpy()] * 2).astype(np.uint16))
    _containers(folder, counts.movedim(0, -1).numpy().astype(np.uint16))
    _pictures(folder)
    _tables(folder)
    _camera(folder / "camera")
    _psfs(folder / "set")
    _jobs(folder / "job")
    _state(folder)
    (folder / "tolerances.toml").write_text(run("design", "tolerance", "small", "--show").out)
    (folder / "config.toml").write_text(
        'measurement = "raw.png"\npsf = "psf.png"\noutput = ["out.png"]\niterations = 3\n'
        'tau = 1e-3\nblack = 256.0\nregion = "24x32"\npenalties = [1e-3, 1e-3, 1e-3]\n'
        'prior = "tv"\nchannels = "all"\nflip = "none"\nbin = 1\n'
    )


def _containers(folder: Path, counts: np.ndarray) -> None:
    np.savez_compressed(folder / "raw.npz", frame=counts)
    scipy.io.savemat(folder / "raw.mat", {"frame": counts}, do_compression=True)
    with h5py.File(folder / "raw.h5", "w") as file:
        file.create_dataset("frame", data=counts, compression="gzip", shuffle=True)
    with zarr.storage.ZipStore(folder / "raw.zip", mode="w") as store:
        zarr.create_array(store, data=counts)
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": counts.astype(np.float32)}).write(
        str(folder / "raw.exr")
    )
    png = [{"bytes": imagecodecs.png_encode(np.ascontiguousarray(counts)), "path": "a.png"}]
    parquet.write_table(pa.table({"lensless": png}), folder / "raw.parquet")
    with av.open(str(folder / "raw.mkv"), "w") as container:
        stream = container.add_stream("ffv1", rate=10)
        stream.height, stream.width, stream.pix_fmt = *counts.shape[:2], "gray16le"
        frame = av.VideoFrame.from_ndarray(counts[..., 1], format="gray16le")
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    planes = np.moveaxis(counts, -1, 0)
    axes = {"axes": "CYX"}
    tifffile.imwrite(
        folder / "planes.tif", planes, photometric="minisblack", ome=True, metadata=axes
    )
    counts[..., 1].tofile(folder / "bare.bin")
    (folder / "bare.toml").write_text(
        f'width = {counts.shape[1]}\nheight = {counts.shape[0]}\nformat = "Mono16"\n'
        'black = 256\nexposure = "5 ms"\n'
    )


def _pictures(folder: Path) -> None:
    picture = np.zeros((24, 32, 3), np.uint8)
    picture[4:12, 6:20], picture[14:22, 18:30] = (230, 200, 30), (30, 60, 220)
    Image.fromarray(picture).save(folder / "scene.png")
    Image.fromarray(picture).save(folder / "scene.jpg")
    Image.fromarray(picture).quantize(16).save(folder / "palette.png")
    Image.fromarray(np.dstack([picture, picture[..., :1]])).save(folder / "alpha.png")
    tifffile.imwrite(folder / "scene.tif", (picture / 255).astype(np.float32), photometric="rgb")


class _Stops(Reporter):
    """A person who presses Ctrl-C after three iterations."""

    def progress(self, progress: Progress, limit: int) -> bool:
        """Stop."""
        return progress.iteration >= 3


def _state(folder: Path) -> None:
    options = ReconstructOptions(
        measurement=folder / "raw.tif",
        psf=folder / "psf.tif",
        output=(folder / "stopped.png",),
        iterations=9,
        black=256.0,
    )
    reconstruct(options, _Stops())
    (folder / "stopped.state.npz").replace(folder / "stopped.npz")
    (folder / "stopped.json").replace(folder / "record.json")


def _tables(folder: Path) -> None:
    heights = 0.1 * np.sin(np.arange(40)[:, None] / 3) * np.cos(np.arange(48) / 4)
    np.savetxt(folder / "map.csv", heights, fmt="%.4f", delimiter=",")
    np.savetxt(folder / "map.txt", heights, fmt="%.4f", header="Width: 48 um\nHeight: 40 um")
    np.savetxt(
        folder / "map.xyz",
        [(x, y, heights[y, x]) for y in range(40) for x in range(48)],
        fmt="%.3f",
    )
    tifffile.imwrite(folder / "map.tif", heights.astype(np.float32))
    (folder / "glass.toml").write_text(
        'name = "glass-of-mine"\nsource = "a test"\nformula = "sellmeier"\n'
        "coefficients = [1.0, 0.013]\nrange_nm = [350, 1100]\n"
    )


def _camera(folder: Path) -> None:
    folder.mkdir(exist_ok=True)
    text = to_toml(tiny_camera())
    (folder / "camera.toml").write_text(text)
    start = text.index("[sensor.quantum_efficiency]")
    stop = text.index("[sensor.acceptance]")
    named = text[:start] + '[sensor.quantum_efficiency]\nfile = "curve.csv"\n\n' + text[stop:]
    (folder / "curve.toml").write_text(named)
    (folder / "curve.csv").write_text(
        "wavelength_nm,R,G,B\n400,0.02,0.05,0.3\n500,0.05,0.5,0.4\n600,0.5,0.3,0.05\n"
        "700,0.02,0.01,0.01\n"
    )


def _psfs(folder: Path) -> None:
    folder.mkdir(exist_ok=True)
    psf = spots()
    entries = {
        PsfEntry(
            file=f"psf-{depth}mm-{angle}.tif",
            pixel=Length.parse("3.1 um"),
            channels=("R", "G", "B"),
            distance=Length.parse(f"{depth} mm"),
            frame="sensor" if angle else "chief-ray",
            angle=(Angle.parse(f"{angle} deg"), Angle.parse("0 deg")),
        ): torch.roll(psf, shift, -1)
        for depth, angle, shift in ((80, 0, 0), (300, 0, 1), (80, 5, 4))
    }
    write_psfs(folder, entries)
    (folder / "camera.toml").write_text(to_toml(tiny_camera()))


def _jobs(folder: Path) -> None:
    """A job as the studio stores it."""
    folder.mkdir(exist_ok=True)
    job = {
        "id": JOB,
        "kind": "psf",
        "title": "PSF",
        "status": "done",
        "error": None,
        "outputs": [f"work/jobs/{JOB}/psf.tif"],
        "started": 1.0,
        "ended": 2.0,
        "progress": {"what": "pattern", "share": 1.0},
        "history": [{"objective": 1.0}],
        "notes": ["a note"],
        "warnings": ["a warning"],
        "summary": {"seconds": 1.0},
        "options": {"camera": "small"},
    }
    (folder / "job.json").write_text(json.dumps(job))
