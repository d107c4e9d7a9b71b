"""The caustic behind a mask of lenslets."""

from dataclasses import replace

import pytest
import torch

from nolens.twin import LensletMask, caustic_psf

CELLS = (160, 192)
PIXEL_UM = 1.55
GREEN = (535.0,)


def test_energy_is_conserved() -> None:
    psf = caustic_psf(LensletMask(), CELLS, PIXEL_UM, (600.0, 535.0, 465.0))
    assert psf.shape == (3, *CELLS) and psf.dtype == torch.float32
    assert float(psf.min()) >= 0
    for plane in psf.double():
        assert float(plane.mean()) == pytest.approx(1, abs=1e-4)


def test_seed() -> None:
    first = caustic_psf(LensletMask(), CELLS, PIXEL_UM, GREEN)
    assert torch.equal(caustic_psf(LensletMask(), CELLS, PIXEL_UM, GREEN), first)
    other = caustic_psf(LensletMask(seed=1), CELLS, PIXEL_UM, GREEN)
    assert not torch.allclose(other, first)


def test_flat_resin_throws_no_caustic() -> None:
    even = caustic_psf(LensletMask(index=1.0), CELLS, PIXEL_UM, GREEN)
    assert torch.allclose(even, torch.ones_like(even), atol=1e-4)


def one_lenslet(distance_mm: float, radius_mm: float = 0.12) -> LensletMask:
    """As large as the field, so that it is the only one; thin-lens focal length R / (n − 1)."""
    return LensletMask(
        radius_mm=radius_mm, pitch_um=1000, smoothing_um=1.0, reduced_thickness_mm=distance_mm
    )


def test_lenslet_focuses_at_its_focal_length() -> None:
    """f = R / (n − 1) = 0.255 mm; the brightest point is brightest there."""
    focal_mm = 0.12 / 0.47
    peaks = {
        share: float(caustic_psf(one_lenslet(share * focal_mm), (64, 64), 1.0, GREEN).max())
        for share in (0.5, 0.75, 1.0, 1.5, 2.0)
    }
    assert max(peaks, key=lambda share: peaks[share]) == 1.0
    assert peaks[1.0] > 20 * peaks[0.5]


def test_spot_of_a_lenslet_grows_with_the_wavelength() -> None:
    """The diffraction limit λf/d: the light in the focus is spread over a wider spot."""
    mask = one_lenslet(0.12 / 0.47)
    blue, red = caustic_psf(mask, (64, 64), 1.0, (450.0, 650.0)).flatten(1)
    assert float(red.max()) < float(blue.max())


def test_wider_field_has_more_lenslets_of_the_same_kind() -> None:
    """Contrast does not depend on the field, but on how far the sensor stands."""
    near = replace(LensletMask(), reduced_thickness_mm=0.05)
    spread = [
        float(caustic_psf(mask, CELLS, PIXEL_UM, GREEN).std()) for mask in (near, LensletMask())
    ]
    assert spread[0] < 0.5 * spread[1]
    wider = float(caustic_psf(LensletMask(), (288, 320), PIXEL_UM, GREEN).std())
    assert wider == pytest.approx(spread[1], rel=0.3)
