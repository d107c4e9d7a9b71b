"""Shift and magnification of patterns that are drawn in their places."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from point_light import bench, spots

from nolens.calibrate import registration
from nolens.calibrate.centring import centroid
from nolens.calibrate.distances import Layers
from nolens.calibrate.registration import NEARBY, register
from nolens.optics import PointSource

CELLS = (150, 180)


@settings(max_examples=4)
@given(
    scale=st.floats(0.96, 1.05),
    moved=st.tuples(st.floats(-15, 15), st.floats(-15, 15)),
    known=st.booleans(),
)
def test_spots(scale: float, moved: tuple[float, float], known: bool) -> None:
    generator = torch.Generator().manual_seed(0)
    pattern = 5 + 3 * spots(CELLS, scale, moved)
    pattern = pattern + 0.02 * torch.randn(pattern.shape, generator=generator)
    found = register(pattern, spots(CELLS), magnification=scale * 1.002 if known else NEARBY)
    assert found.shift == pytest.approx(moved, abs=0.02)
    assert found.magnification == pytest.approx(scale, abs=2e-4)
    assert found.correlation > 0.98


def test_progress() -> None:
    shares: list[float] = []
    register(spots(CELLS), spots(CELLS), progress=shares.append)
    assert len(shares) > 10 and shares == sorted(set(shares))
    assert shares[0] == 0 and 0.8 < shares[-1] < 1


def test_unlike_patterns() -> None:
    found = register(spots(CELLS, seed=3), spots(CELLS, seed=4), magnification=1.0)
    assert found.correlation < 0.4


def test_large_patterns_are_averaged() -> None:
    found = register(
        spots((300, 900), 1.01, (3.3, -7.6), width=6.0), spots((300, 900), width=6.0),
        magnification=1.01,
    )  # fmt: skip
    assert found.shift == pytest.approx((3.3, -7.6), abs=0.05)
    assert found.magnification == pytest.approx(1.01, abs=2e-4)


@pytest.mark.parametrize("distance_mm", [80.0, 200.0])
def test_the_twin_magnifies_as_the_layers_say(distance_mm: float) -> None:
    """Of M − 1, the twin's patterns show within 2 % what 1 + D/z says."""
    camera = bench("paper", (512, 640))
    near, far = (camera.psf(PointSource(distance_um=z * 1e3)) for z in (distance_mm, 300.0))
    layers = Layers.of_camera(camera.twin.camera)
    expected = layers.magnification(distance_mm * 1e3) / layers.magnification(300e3)
    found = register(near, far, magnification=1.0)
    assert found.magnification - 1 == pytest.approx(expected - 1, rel=0.02)
    assert found.shift == pytest.approx((0, 0), abs=0.01)


@pytest.mark.parametrize("expected", [1.009517, NEARBY])
def test_structure_as_fine_as_the_widest_blur(
    expected: float | tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the paper's caustic, averaged as much as at its full size, the widest blur leaves nothing
    to lay over."""
    monkeypatch.setattr(registration, "_LONGEST", 267)
    camera = bench("paper", (1200, 1600))
    near, far = (camera.psf(PointSource(distance_um=z * 1e3)) for z in (80.0, 200.0))
    found = register(near, far, magnification=expected)
    assert found.magnification == pytest.approx(1.009517, abs=1e-4)
    assert found.shift == pytest.approx((0, 0), abs=0.02)
    assert found.correlation > 0.99


def test_centroid() -> None:
    psf = torch.zeros(2, 9, 12)
    psf[0, 2, 3], psf[1, 4, 3], psf[0, 8, 11] = 1.0, 3.0, 100.0
    dark = torch.zeros(9, 12, dtype=torch.bool)
    dark[8, 11] = True
    assert centroid(psf, dark) == pytest.approx((3.5 - 4, 3 - 5.5))
