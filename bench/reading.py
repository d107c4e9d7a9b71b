"""Memory and time of reading files of the largest size that one read may decode.

Each file is read in a process of its own. What its peak of memory has beyond the libraries and
the array that is given is to be at most 2 GiB.

    python bench/reading.py
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import tifffile
from PIL import Image

from nolens.files import write_dng
from nolens.files.input import READ_LIMIT

_MOST = 2 * 2**30
_SIDE = 10_900
"""Three channels of this size, as float32, are just below the limit."""
_SMALL_SIDE = 7_700
"""The same for three channels of float64."""

_CHILD = """
import json, sys, time
from pathlib import Path
import imagecodecs, rawpy, nolens.files.frames, nolens.files.pictures, nolens.files.height_maps
from nolens import files
imagecodecs.png_decode, imagecodecs.zlib_decode
def peak():
    # Not what getrusage says: a process takes that over from the one that started it.
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) * 1024
before, start, cpu = peak(), time.perf_counter(), time.process_time()
found = getattr(files, sys.argv[1])(Path(sys.argv[2]))
seconds, cpu = time.perf_counter() - start, time.process_time() - cpu
array = next(getattr(found, n) for n in ("counts", "radiance", "heights_um") if hasattr(found, n))
print(json.dumps([peak() - before, array.nbytes, seconds, cpu, list(array.shape)]))
"""


def picture(height: int, width: int, channels: int, kind: type) -> np.ndarray:
    """Rows of noise that are all alike, so that files of any coding are written soon."""
    row = np.random.default_rng(0).integers(0, 2**12, (1, width, channels))
    return np.broadcast_to((row * (16 if kind == np.uint16 else 1)).astype(kind),
                           (height, width, channels))  # fmt: skip


def save_png(path: Path, array: np.ndarray) -> None:
    path.write_bytes(imagecodecs.png_encode(np.ascontiguousarray(array), level=1))


def save_tiff(path: Path, array: np.ndarray, **way: Any) -> None:
    tifffile.imwrite(path, array, photometric="rgb", metadata=None, **way)


def save_text(path: Path, side: int) -> None:
    """As Gwyddion writes it."""
    line = "\t".join(f"{value:.3f}" for value in np.random.default_rng(0).random(side))
    head = "# Channel: Height\n# Width: 1 mm\n# Height: 1 mm\n# Value units: um\n"
    path.write_text(f"{head}{f'{line}{chr(10)}' * side}")


_CODED = {"compression": "deflate", "predictor": True}
_CASES: dict[str, tuple[str, Callable[[Path], object]]] = {
    "12 megapixels, 16-bit colour.png": (
        "read_frame", lambda p: save_png(p, noise(3000, 4000)),
    ),
    "16-bit colour.png": (
        "read_frame", lambda p: save_png(p, picture(_SIDE, _SIDE, 3, np.uint16)),
    ),
    "16-bit colour scene.png": (
        "read_picture", lambda p: save_png(p, picture(_SIDE, _SIDE, 3, np.uint16)),
    ),
    "8-bit colour scene.jpg": (
        "read_picture", lambda p: Image.fromarray(picture(_SIDE, _SIDE, 3, np.uint8)).save(p),
    ),
    "float32.tif": ("read_frame", lambda p: save_tiff(p, picture(_SIDE, _SIDE, 3, np.float32))),
    "16-bit LZW.tif": (
        "read_frame",
        lambda p: save_tiff(p, picture(_SIDE, _SIDE, 3, np.uint16), compression="lzw",
                            rowsperstrip=64),
    ),
    "16-bit deflate in one strip.tif": (
        "read_frame", lambda p: save_tiff(p, picture(_SIDE, _SIDE, 3, np.uint16),
                                         rowsperstrip=_SIDE, **_CODED),
    ),
    "float32 deflate in two strips.tif": (
        "read_frame", lambda p: save_tiff(p, picture(_SIDE, _SIDE, 3, np.float32),
                                         rowsperstrip=_SIDE // 2, **_CODED),
    ),
    "float64.npy": (
        "read_frame", lambda p: np.save(p, picture(_SMALL_SIDE, _SMALL_SIDE, 3, np.float64)),
    ),
    "mosaic.dng": (
        "read_frame",
        lambda p: write_dng(p, picture(18_000, 18_000, 1, np.uint16)[..., 0], pattern="RGGB",
                            black=0, white=65535),
    ),
    "table of heights.txt": ("read_height_map", lambda p: save_text(p, 4900)),
}  # fmt: skip


def noise(height: int, width: int) -> np.ndarray:
    """A picture of 16 bits as a camera takes it: a slope with noise."""
    slope = np.add.outer(np.arange(height) * 7.0, np.arange(width) * 5.0)[..., None]
    grain = np.random.default_rng(0).normal(0, 200, (height, width, 3))
    return (slope + grain).clip(0, 65535).astype(np.uint16)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="a part of the names of the files")
    only = parser.parse_args().only
    print(f"one read may decode {READ_LIMIT / 1e9} GB")
    print("| File | MB | Array, GB | Beyond it, GB | Seconds | of the processor |")
    print("| --- | ---: | ---: | ---: | ---: | ---: |")
    failed = []
    for name, (reader, make) in _CASES.items():
        if only not in name:
            continue
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / name
            make(path)
            asked = [sys.executable, "-c", _CHILD, reader, str(path)]
            done = subprocess.run(asked, capture_output=True, text=True, check=False)
            size = path.stat().st_size
        if done.returncode:
            sys.exit(f"{name}: {done.stderr[-2000:]}")
        grown, held, seconds, cpu, _ = json.loads(done.stdout)
        beyond = grown - held
        print(f"| {name} | {size / 1e6:.0f} | {held / 1e9:.2f} | {beyond / 1e9:.2f} | "
              f"{seconds:.2f} | {cpu:.2f} |", flush=True)  # fmt: skip
        if beyond > _MOST:
            failed.append(name)
    if failed:
        sys.exit(f"more than 2 GiB beyond the array: {', '.join(failed)}")


if __name__ == "__main__":
    main()
