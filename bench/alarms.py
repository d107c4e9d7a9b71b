"""Warnings of a reconstruction on problems with nothing wrong, and on some with one thing wrong.

`python bench/alarms.py --data ../shared/data` photographs four scenes at three exposures through
the paper's camera with four masks and through the small one, adds the five real pairs and the
hand, reconstructs each as `nl.reconstruct` does by default, and prints every warning. The last two
lines count good problems with a warning, and wrong ones without; `make bench-odd` writes them into
`docs/odd-inputs.md`. About 15 minutes on two cores.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import nolens as nl
from nolens.api.inputs import Raw
from nolens.errors import NolensError
from nolens.optics.magnification import magnified
from results import PAIRS
from shots import EXPOSURES, PHOTOGRAPHS, cameras, taken

Problem = tuple[str, nl.SimulatedMeasurement, nl.Psf]


def simulated() -> Iterator[Problem]:
    """Measurements and their PSFs."""
    for name, camera in cameras():
        for photograph in PHOTOGRAPHS:
            for fill in EXPOSURES:
                shot = taken(camera, photograph, fill)
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
    yield "swapped", words(own, shot.values)
    for what, other in (
        ("1 % larger PSF", magnified(psf.values, 1.01)),
        ("3 % smaller PSF", magnified(psf.values, 0.97)),
        ("10 % larger PSF", magnified(psf.values, 1.1)),
        ("mirrored PSF", psf.values.flip(-1)),
    ):
        yield what, words(shot, other)
    yield "support too small", words(shot, psf, support=smaller)


def words(measurement: Raw, psf: Raw, **options: Any) -> tuple[str, ...]:
    """What is said of a reconstruction: warnings, a refusal, that the PSF is turned over."""
    try:
        photo = nl.reconstruct(measurement, psf, **{"channels": "g", **options})
    except NolensError as error:  # It is refused.
        return (str(error),)
    return photo.warnings + tuple(each for each in photo.notes if "--psf-flip" in each)


def real(data: Path) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Warnings of the real measurements."""
    pairs, hand = data / "diffusercam-pairs", data / "diffusercam-hand"
    for name in PAIRS:
        pair = pairs / "diffuser" / f"{name}.npy", pairs / "psf_estimate.npy"
        yield name, words(*pair, psf_extended=True)
    files = hand / "rawdata_hand_sample.tif", hand / "psf_sample.tif"
    yield "hand", words(*files, black="auto", channels="all")


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
        good.append(said(what, words(shot, psf)))
        if PHOTOGRAPHS[0] in what and f"{EXPOSURES[1]:.0%}" in what:
            bad += [said(f"{what}, {fault}", each) for fault, each in wrong(shot, psf)]
    print(f"good problems with a warning: {sum(good)} of {len(good)}")
    print(f"wrong problems without one: {bad.count(False)} of {len(bad)}")


if __name__ == "__main__":
    main()
