"""Colours of spectra, polarisers and Stokes' parameters against published and known values."""

import numpy as np
import pytest
import torch

from nolens.camera import Polariser
from nolens.camera.spectra import colour_matching, linear_stokes, spectral_srgb
from nolens.quantities import Angle

CIE = {450: (0.3362, 0.0380, 1.7721), 555: (0.5121, 1.0000, 0.0057), 600: (1.0622, 0.6310, 0.0008)}
"""CIE 1931, 2 degrees."""


def test_colour_matching_is_that_of_cie():
    found = colour_matching(np.array(list(CIE), dtype=float))
    assert pytest.approx(np.array(list(CIE.values())), abs=0.03) == found.T


def test_even_spectra_are_grey_and_lines_have_their_colours():
    wavelengths = [450.0, 500.0, 540.0, 580.0, 620.0]
    scene = torch.cat([torch.full((5, 1, 1), 0.4), torch.eye(5)[:, None, [0, 2, 4]]], dim=2)
    rgb = spectral_srgb(scene, wavelengths)[:, 0]
    assert rgb[:, 0].tolist() == pytest.approx([0.4] * 3, rel=2e-3)
    assert rgb[:, 1:].argmax(dim=0).tolist() == [2, 1, 0]


@pytest.mark.parametrize(("light", "passed"), [(None, 0.51), (30, 1.0), (120, 0.02), (75, 0.51)])
def test_a_polariser_follows_malus(light, passed):
    polariser = Polariser(angle="30 deg", extinction=50)
    angle = None if light is None else Angle.of(light, "deg")
    assert polariser.passes(angle) == pytest.approx(passed)


def test_stokes_of_parts_that_are_polarised():
    parts = torch.tensor([1.5, 1.0, 0.5, 0])[:, None, None]
    stokes = linear_stokes(parts, [0.0, 45.0, 90.0, 135.0]).flatten()
    assert stokes.tolist() == pytest.approx([3, 1, 1, 2**0.5 / 3, 22.5], rel=1e-5)
