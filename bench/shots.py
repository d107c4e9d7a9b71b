"""Simulated cameras and measurements of photographs, for benchmarks of what is said of files."""

from __future__ import annotations

from collections.abc import Iterator

from skimage import data as photographs

import nolens as nl

PIXELS = (380, 506)
"""Rows and columns of the paper's sensor that are read: superpixels are half of them."""
MASKS = ("contour", "diffuser", "lenslet-array")
PHOTOGRAPHS = ("astronaut", "chelsea", "coffee", "rocket")
EXPOSURES = (0.9, 0.1, 0.02)


def cameras() -> Iterator[tuple[str, nl.Camera]]:
    """The small camera and the paper's, with its mask and with others, by name."""
    yield "small", nl.Camera("small")
    paper = nl.Camera("paper", pixels=PIXELS)
    yield "paper", paper
    for kind in MASKS:
        yield kind, nl.design_mask(kind, paper)


def taken(
    camera: nl.Camera, photograph: str, fill: float = 0.9, angle: str = "30deg"
) -> nl.SimulatedMeasurement:
    """A measurement of a photograph of scikit-image, with the PSF as it varies over the field."""
    picture = getattr(photographs, photograph)()
    return nl.simulate(picture, camera, angle=angle, fill=fill, field_points=3)
