"""Refractive indices of the materials that are known."""

import pytest

from nolens.camera import MATERIALS, material
from nolens.errors import OptionError


@pytest.mark.parametrize("known", MATERIALS.values(), ids=lambda each: each.name)
def test_index_and_abbe_number_are_met(known):
    assert material(known.name) is known
    assert known.index(587.56) == pytest.approx(known.index_d, rel=1e-15)
    if known.abbe is not None:
        spread = known.index(486.13) - known.index(656.27)
        assert (known.index_d - 1) / spread == pytest.approx(known.abbe)


def test_air_bends_nothing():
    assert {material("air").index(wavelength) for wavelength in (400, 550, 700)} == {1.0}


def test_glass_is_near_its_tables():
    # Schott's table of N-BK7 at the mercury lines g and e.
    assert material("bk7").index(435.83) == pytest.approx(1.52668, abs=4e-4)
    assert material("bk7").index(546.07) == pytest.approx(1.51872, abs=4e-5)


@pytest.mark.parametrize(
    ("name", "words"), [("PDSM", "did you mean 'pdms'.*polycarbonate"), ("xyz", "Known are air")]
)
def test_unknown_material(name, words):
    with pytest.raises(OptionError, match=words):
        material(name)
