"""Photographs that judge priors: none of them is used for training.

Some come with packages that nolens installs anyway, the others in packages of Debian, which
`fetch` downloads and unpacks without installing them.
"""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
import skimage
import torch
from PIL import Image, ImageOps
from torch import Tensor

from nolens.camera import linear_from_srgb

LONGER_SIDE = 1000
"""Pixels that a photograph has at most, along its longer side."""
INSTALLED = {
    "scikit-image": Path(skimage.__file__).parent / "data",
    "matplotlib": Path(matplotlib.get_data_path()) / "sample_data",
}
_LOMIRI_16, _LOMIRI_20 = "lomiri-wallpapers-16.04", "lomiri-wallpapers-20.04"
_MATE, _PLASMA = "mate-backgrounds", "plasma-workspace-wallpapers"
_NATURE = "usr/share/backgrounds/mate/nature"


@dataclass(frozen=True)
class Photograph:
    """A photograph, the package that it is in, and its licence there.

    Parameters
    ----------
    name
        In tables and files.
    package
        Of `INSTALLED`, or of Debian.
    file
        In the package.
    licence
        As the package states it.
    shown
        Whether results may be shown: it is in the public domain.
    """

    name: str
    package: str
    file: str
    licence: str
    shown: bool = False

    def path(self, folder: Path) -> Path:
        """Its file; `folder` holds the packages of Debian."""
        return INSTALLED.get(self.package, folder / self.package) / self.file

    def radiance(self, folder: Path) -> Tensor:
        """Linear, (3, height, width), made smaller by means over areas."""
        path = self.path(folder)
        if not path.is_file():
            raise SystemExit(
                f"{path} is not there: --fetch downloads {self.package} of Debian (apt-get "
                "download) and unpacks it there; nothing is installed"
            )
        with Image.open(path) as picture:
            pixels = np.asarray(ImageOps.exif_transpose(picture).convert("RGB"))
        linear = linear_from_srgb(torch.from_numpy(pixels.copy()).permute(2, 0, 1).float() / 255)
        height, width = linear.shape[-2:]
        smaller = LONGER_SIDE / max(height, width)
        if smaller >= 1:
            return linear
        size = (round(height * smaller), round(width * smaller))
        return torch.nn.functional.interpolate(linear[None], size, mode="area")[0]


def _lomiri(name: str, file: str, licence: str, package: str = _LOMIRI_16) -> Photograph:
    return Photograph(name, package, f"usr/share/backgrounds/{file}.jpg", licence)


def _plasma(name: str, folder: str) -> Photograph:
    file = f"usr/share/wallpapers/{folder}/contents/images/2560x1600.jpg"
    return Photograph(name, _PLASMA, file, "GPL-2+")


PHOTOGRAPHS = (
    Photograph("astronaut", "scikit-image", "astronaut.png", "public domain", shown=True),
    _lomiri("fig", "Picture_0B_by_freespace", "CC-BY-4.0"),
    _plasma("cups", "ColorfulCups"),
    Photograph("coffee", "scikit-image", "coffee.png", "CC0", shown=True),
    _lomiri("mountain", "aitzgorri_by_Aitzol_Berasategi", "CC-BY-4.0"),
    Photograph("ladybird", _MATE, f"{_NATURE}/LadyBird.jpg", "GPL-2+"),
    Photograph("chelsea", "scikit-image", "chelsea.png", "CC0", shown=True),
    _lomiri("brushes", "Picture_1A_by_freespace", "CC-BY-4.0"),
    _plasma("boats", "EveningGlow"),
    Photograph("rocket", "scikit-image", "rocket.jpg", "public domain", shown=True),
    _lomiri("dogs", "friends_by_Aitzol_Berasategi", "CC-BY-4.0"),
    Photograph("motorcycle", "scikit-image", "motorcycle_left.png", "none named (Middlebury)"),
    _lomiri("stream", "life_by_Aitzol_Berasategi", "CC-BY-4.0"),
    _lomiri("peaks", "picosdeeuropa_by_Aitzol_Berasategi", "CC-BY-4.0"),
    _plasma("moss", "OneStandsOut"),
    _lomiri("dandelion", "seeding_by_Clements_Engelhardt", "CC0"),
    Photograph("dune", _MATE, f"{_NATURE}/Dune.jpg", "GPL-2+"),
    _lomiri("drum", "Wine_by_Jakkub_Mede", "CC-BY-4.0"),
    _lomiri("nuthatch", "Kleiber_by_Lukas_Baubkus", "CC-BY-SA-3.0", _LOMIRI_20),
    _plasma("forest", "Path"),
)


def fetch(folder: Path) -> None:
    """Download the packages of Debian that are not in the folder yet, and unpack them there."""
    for package in sorted({each.package for each in PHOTOGRAPHS} - set(INSTALLED)):
        if (folder / package).is_dir():
            continue
        folder.mkdir(parents=True, exist_ok=True)
        print(f"downloads {package} of Debian into {folder}", flush=True)
        subprocess.run(["apt-get", "download", "-q", package], cwd=folder, check=True)
        archive = next(folder.glob(f"{package}_*.deb"))
        unpacked = folder / f"{package}.part"
        subprocess.run(["dpkg-deb", "-x", str(archive), str(unpacked)], check=True)
        unpacked.rename(folder / package)
        archive.unlink()
