"""Warnings of a reconstruction on problems with nothing wrong, and on some with one thing wrong.

`python bench/alarms.py --data ../shared/data` photographs four scenes at three exposures through
the paper's camera with four masks and through the small one, adds the five real pairs and the
hand, reconstructs each as `nl.reconstruct` does by default, and prints every warning. The last two
lines count good problems with a warning, and wrong ones without. About 15 minutes on two cores.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from skimage import data as photographs

import nolens as nl
from nolens.errors import NolensError
from nolens.optics.magnification import magnified
from results import PAIRS

PIXELS = (380, 506)
MASKS = ("contour", "diffuser", "lenslet-array")
PHOTOGRAPHS = ("astronaut", "chelsea", "coffee", "rocket")
EXPOSURES = (0.9, 0.1, 0.02)
Problem = tuple[str, nl.SimulatedMeasurement, nl.Psf]


def cameras() -> Iterator[tuple[str, nl.Camera]]:
    """The cameras, by name."""
    yield "small", nl.Camera("small")
    paper = nl.Camera("paper", pixels=PIXELS)
    yield "paper", paper
    for kind in MASKS:
        yield kind, nl.design_mask(kind, paper)


def simulated() -> Iterator[Problem]:
    """Measurements and their PSFs."""
    for name, camera in cameras():
        for photograph in PHOTOGRAPHS:
            picture = getattr(photographs, photograph)()
            for fill in EXPOSURES:
                shot = nl.simulate(picture, camera, angle="30deg", fill=fill, field_points=3)
                psf = nl.psf(camera, "300mm", support=shot.support, wavelengths=1)
                yield f"{name}, {photograph}, {fill:.0%}", shot, psf


def wrong(shot: nl.SimulatedMeasurement, psf: nl.Psf) -> Iterator[tuple[str, tuple[str, ...]]]:
    """What is said where one thing is wrong."""
    rows, columns = shot.size
    top, left = (psf.size[0] - rows) // 2, (psf.size[1] - columns) // 2
    own = psf.values[:, top : top + rows, left : left + columns]
    support = shot.support
    smaller = replace(
        support,
        top=support.top + support.height // 6,
        left=support.left + support.width // 6,
        height=support.height * 2 // 3,
        width=support.width * 2 // 3,
    )
    try:
        yield "swapped", nl.reconstruct(own, shot.values, channels="g").warnings
    except NolensError as error:  # It is refused.
        yield "swapped", (str(error),)
    for what, other in (
        ("1 % larger PSF", magnified(psf.values, 1.01)),
        ("3 % smaller PSF", magnified(psf.values, 0.97)),
        ("10 % larger PSF", magnified(psf.values, 1.1)),
        ("mirrored PSF", psf.values.flip(-1)),
    ):
        yield what, nl.reconstruct(shot, other, channels="g").warnings
    yield "support too small", nl.reconstruct(shot, psf, support=smaller, channels="g").warnings


def real(data: Path) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Warnings of the real measurements."""
    pairs, hand = data / "diffusercam-pairs", data / "diffusercam-hand"
    for name in PAIRS:
        pair = pairs / "diffuser" / f"{name}.npy", pairs / "psf_estimate.npy"
        yield name, nl.reconstruct(*pair, psf_extended=True, channels="g").warnings
    files = hand / "rawdata_hand_sample.tif", hand / "psf_sample.tif"
    yield "hand", nl.reconstruct(*files, black="auto").warnings


def said(what: str, warnings: tuple[str, ...]) -> bool:
    """Print the warnings of a problem; whether there were any."""
    print(f"{what}: {' | '.join(warnings) or 'nothing'}", flush=True)
    return bool(warnings)


def main() -> None:
    """Reconstruct all, and print warnings and counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, help="folder of the real measurements")
    data: Path | None = parser.parse_args().data
    good: list[bool] = []
    bad: list[bool] = []
    if data is not None:
        good += [said(*each) for each in real(data)]
    for what, shot, psf in simulated():
        good.append(said(what, nl.reconstruct(shot, psf, channels="g").warnings))
        if PHOTOGRAPHS[0] in what and f"{EXPOSURES[1]:.0%}" in what:
            bad += [said(f"{what}, {fault}", each) for fault, each in wrong(shot, psf)]
    print(f"good problems with a warning: {sum(good)} of {len(good)}")
    print(f"wrong problems without one: {bad.count(False)} of {len(bad)}")


if __name__ == "__main__":
    main()
