"""Trained priors against total variation that is retuned by the truth, on the simulated camera.

`make bench-priors` (`python bench/priors.py --fetch`) takes photographs that no prior was trained
on with three masks at three exposures, reconstructs them by every prior, and compares with total
variation whose weight and kind are the best for the truth. It writes the tables of `docs/priors.md`
and the pictures in `docs/priors`. `--fetch` downloads photographs in packages of Debian (170 MB);
without it nothing is downloaded.

Measurements, PSFs and what was measured are kept in `--folder`, so that it can be interrupted and
continued, and another prior can be measured later. Cases are in an order whose beginnings are
balanced: `--cases 40` measures the first 40. `--unseen` adds masks that no prior was trained with,
`--charts` a Siemens star, two points and text, which show detail that is invented. `--again`
replaces what was measured of the named priors.
"""

from __future__ import annotations

import argparse
import functools
import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

import nolens as nl
from nolens.api.simulate import Psf, SimulatedMeasurement
from nolens.camera import Frame, develop
from nolens.errors import OptionError
from nolens.evaluate import compare_pictures, perceptual_distance
from nolens.operators import PixelRectangle
from priors_photographs import PHOTOGRAPHS, Photograph, fetch

PIXELS = (760, 1014)
"""Rows and columns of the sensor that are read: superpixels are half of them."""
ANGLE, DISTANCE, FIELD_POINTS = "30deg", "300mm", 3
MASKS: dict[str, Callable[[nl.Camera], nl.Camera]] = {
    "paper": lambda camera: camera,
    "contour": lambda camera: nl.design_mask("contour", camera),
    "lenslets": lambda camera: nl.design_mask("random-lenslets", camera, pitch="150um"),
}
EXPOSURES = (0.9, 0.1, 0.02)
UNSEEN: dict[str, Callable[[nl.Camera], nl.Camera]] = {
    "optimised": lambda camera: nl.design_mask("optimised", camera),
}
UNSEEN_EXPOSURES = (0.9, 0.1)
KINDS = ("colour-tv", "isotropic-tv")
"""Total variation; the first is the default."""
TRAINED = ("ridge", "denoiser", "unrolled")
FACTOR, STEPS = 2.0, 5
FIGURES = ("psnr_db", "ssim", "shown_psnr_db", "shown_ssim", "lpips")
"""As `compare_pictures` names them; smaller is better for the last one alone."""

Figures = dict[str, float]


@dataclass(frozen=True)
class Case:
    """A measurement to reconstruct."""

    mask: str
    photograph: Photograph
    exposure: float

    @property
    def name(self) -> str:
        """Of its files."""
        return f"{self.photograph.name}-{self.mask}-{self.exposure:g}"


def cases() -> list[Case]:
    """All of the main table; neighbours differ in mask and exposure."""
    masks, count = list(MASKS), len(EXPOSURES)
    return _spread([
        (masks[number % len(masks)], EXPOSURES[(number // len(masks) + number) % count])
        for number in range(len(masks) * count)
    ])  # fmt: skip


def unseen_cases() -> list[Case]:
    """Those with masks that no prior was trained with."""
    return _spread([(mask, exposure) for mask in UNSEEN for exposure in UNSEEN_EXPOSURES])


def _spread(pairs: list[tuple[str, float]]) -> list[Case]:
    """Each round has every photograph once, with another mask and exposure than those before."""
    return [
        Case(mask, photograph, exposure)
        for turn in range(len(pairs))
        for place, photograph in enumerate(PHOTOGRAPHS)
        for mask, exposure in [pairs[(place + turn) % len(pairs)]]
    ]


@functools.cache
def camera(mask: str) -> nl.Camera:
    """The middle of the paper's camera, with a mask."""
    return {**MASKS, **UNSEEN}[mask](nl.Camera("paper", pixels=PIXELS))


def written(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file under another name first: nobody finds half of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".part-{path.name}")
    write(part)
    part.rename(path)


def simulated(
    path: Path, mask: str, scene: Callable[[], Tensor], fill: float
) -> SimulatedMeasurement:
    """The measurement of a scene: kept in a file, or made."""
    if not path.exists():
        shot = nl.simulate(
            scene(), camera(mask), angle=ANGLE, distance=DISTANCE, fill=fill,
            field_points=FIELD_POINTS,
        )  # fmt: skip
        frame, support = shot.frame, shot.support
        about = {
            "channels": shot.channels, "pixel_rad": shot.pixel_rad, "support": asdict(support),
            "frame": {
                "channels": frame.channels, "mosaic": frame.mosaic, "black": frame.black,
                "white": frame.white, "stored_as": frame.stored_as, "source": frame.source,
                "exposure_s": frame.exposure_s, "black_stated": frame.black_stated,
                "sensor": frame.sensor,
            },
        }  # fmt: skip
        arrays = {"counts": frame.counts, "truth": shot.truth, "response": shot.response}
        named = {name: each.float().numpy() for name, each in arrays.items()}
        written(path, lambda part: np.savez(part, about=json.dumps(about), **named))
    with np.load(path) as kept:
        about = json.loads(str(kept["about"]))
        arrays = {name: torch.from_numpy(kept[name]) for name in ("counts", "truth", "response")}
    told = {key: tuple(each) if isinstance(each, list) else each
            for key, each in about["frame"].items()}  # fmt: skip
    frame = Frame(arrays["counts"], **told)
    return SimulatedMeasurement(
        develop(frame).values,
        tuple(about["channels"]),
        frame,
        arrays["truth"],
        arrays["response"],
        PixelRectangle(**about["support"]),
        about["pixel_rad"],
    )


def psf_for(folder: Path, mask: str, shot: SimulatedMeasurement) -> Psf:
    """One PSF for all of the field: kept in a file, or computed."""
    support = shot.support
    path = folder / "psfs" / f"{mask}-{support.height}x{support.width}.npz"
    if not path.exists():
        psf = nl.psf(camera(mask), DISTANCE, support=support, wavelengths=1)
        written(path, lambda part: np.savez(part, values=psf.values.numpy()))
    with np.load(path) as kept:
        return Psf(torch.from_numpy(kept["values"]), shot.channels)


@functools.cache
def perceptual() -> Callable[[Tensor, Tensor], float] | str:
    """LPIPS, or why there is none."""
    return perceptual_distance()


def figures(picture: Tensor, truth: Tensor) -> tuple[Figures, Tensor]:
    """How near a picture comes to the truth, and it with the one factor that fits best."""
    distance = perceptual()
    compared = compare_pictures(
        picture,
        truth,
        fit="scale",
        white=float(truth.max()),
        perceptual=None if isinstance(distance, str) else distance,
    )
    kept = {name: compared.figures[name] for name in FIGURES if name in compared.figures}
    return kept, compared.picture


def better(name: str, one: Figures, other: Figures) -> bool:
    """Whether one is nearer to the truth than another."""
    return one[name] < other[name] if name == "lpips" else one[name] > other[name]


def measured(
    shot: SimulatedMeasurement, psf: Psf, prior: str
) -> tuple[dict[str, Figures], dict[str, Tensor]]:
    """Figures and pictures by weight: that of the program, ``auto``, and for TV a grid around it.

    The grid goes on by factors of two, to both sides, until PSNR is worse in linear light and as
    shown.
    """
    rows: dict[str, Figures] = {}
    pictures: dict[str, Tensor] = {}

    def solved(name: str, tau: float | None) -> Figures:
        begun = time.perf_counter()
        photo = nl.reconstruct(shot, psf, prior=prior, tau=tau)
        seconds = time.perf_counter() - begun
        found, pictures[name] = figures(photo.values, shot.expected)
        rows[name] = {**found, "tau": photo.tau, "seconds": seconds}
        return rows[name]

    first = solved("auto", None)
    if prior in KINDS:
        for factor in (FACTOR, 1 / FACTOR):
            last = first
            for step in range(1, STEPS + 1):
                weight = factor**step
                row = solved(f"{weight:g}", first["tau"] * weight)
                if not any(better(name, row, last) for name in ("psnr_db", "shown_psnr_db")):
                    break
                last = row
    return rows, pictures


def known(prior: str) -> bool:
    """Whether nolens has a prior of this name."""
    light = torch.rand(3, 64, 64)
    point = torch.zeros(3, 64, 64)
    point[:, 32, 32] = 1.0
    try:
        nl.reconstruct(light, point, prior=prior, tau=1e-5, iterations=1, support="full")
    except OptionError as error:
        return "prior" not in str(error)
    return True


def measure(folder: Path, case: Case, priors: list[str], asked: argparse.Namespace) -> None:
    """Measure what is missing of a case."""
    rows = folder / "rows" / case.name
    missing = [each for each in priors if not (rows / f"{Path(each).stem}.json").exists()]
    again = [each for each in priors if asked.again and each not in KINDS]
    for prior in dict.fromkeys((*missing, *again)):
        shot = simulated(
            folder / "shots" / f"{case.name}.npz",
            case.mask,
            lambda: case.photograph.radiance(asked.photographs),
            case.exposure,
        )
        found, pictures = measured(shot, psf_for(folder, case.mask, shot), prior)
        if case.photograph.shown:
            best = max(found, key=lambda name: found[name]["psnr_db"])
            picture = pictures[best].half().numpy()
            path = rows / f"{Path(prior).stem}.npz"
            written(path, lambda part, each=picture: np.savez_compressed(part, picture=each))
        text = json.dumps(found)
        written(rows / f"{Path(prior).stem}.json", lambda part, each=text: part.write_text(each))
        best_db = max(each["psnr_db"] for each in found.values())
        seconds = sum(each["seconds"] for each in found.values())
        print(
            f"{case.name} {prior} {found['auto']['psnr_db']:.2f} dB, best {best_db:.2f} dB, "
            f"{len(found)} weights, {seconds:.0f} s",
            flush=True,
        )


def main() -> None:
    """Measure what is missing, and write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--folder", type=Path, default=Path("build/priors"))
    parser.add_argument("--photographs", type=Path, default=Path("build/photographs"))
    parser.add_argument("--out", type=Path, default=Path("docs/priors.md"))
    parser.add_argument("--priors", nargs="+", default=[*KINDS, *TRAINED])
    parser.add_argument("--cases", type=int, help="how many of them, from the first on")
    parser.add_argument("--unseen", action="store_true", help="with masks of no training")
    parser.add_argument("--charts", action="store_true", help="Siemens star, two points, text")
    parser.add_argument("--fetch", action="store_true", help="download photographs by apt-get")
    parser.add_argument("--again", action="store_true", help="measure trained priors again")
    asked = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    if asked.fetch:
        fetch(asked.photographs)
    priors = []
    for prior in asked.priors:
        if prior in KINDS or known(prior):
            priors.append(prior)
        else:
            print(f"{prior} is left out: nolens has no prior of this name", flush=True)
    for case in (unseen_cases() if asked.unseen else cases())[: asked.cases]:
        measure(asked.folder, case, priors, asked)


if __name__ == "__main__":
    main()
