"""Cases that judge priors: photographs, masks, exposures, and measurements kept in files."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

import nolens as nl
from nolens.api.simulate import Psf, SimulatedMeasurement
from nolens.camera import Frame, develop
from nolens.evaluate import compare_pictures, perceptual_distance
from nolens.operators import PixelRectangle
from priors_photographs import PHOTOGRAPHS, Photograph

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
