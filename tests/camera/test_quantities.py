"""Numbers with units: exact, and refused without a unit."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, ValidationError

from nolens.errors import OptionError
from nolens.quantities import Angle, Duration, Length, Luminance, Percentage, Quantity

KINDS = (Length, Angle, Duration, Percentage, Luminance)
kinds = st.sampled_from(KINDS)


@st.composite
def numbers(draw) -> str:
    """Texts of numbers in any notation."""
    digits = st.text("0123456789", min_size=1, max_size=8)
    text = draw(st.sampled_from(["", "+", "-"]))
    text += draw(st.one_of(digits, digits.map(lambda d: d + "."), digits.map(lambda d: "." + d)))
    if draw(st.booleans()):
        text += draw(st.sampled_from("eE")) + str(draw(st.integers(-20, 20)))
    return text


def spellings(kind: type[Quantity]) -> list[str]:
    return [*kind.units, *kind.spellings]


@given(st.data(), kinds, numbers(), st.sampled_from(["", " ", "  ", "\u00a0"]))
def test_text_comes_back_as_it_was_written(data, kind, number, space):
    unit = data.draw(st.sampled_from(spellings(kind)))
    quantity = kind.parse(f" {number}{space}{unit}\n")
    assert str(quantity) == f"{number} {kind.spellings.get(unit, unit)}"
    again = kind.parse(str(quantity))
    assert str(again) == str(quantity)
    assert again == quantity and hash(again) == hash(quantity)


@given(st.data(), kinds, st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_come_back(data, kind, number):
    unit = data.draw(st.sampled_from(list(kind.units)))
    if number != 0 and not 1e-30 <= abs(number) <= 1e30:
        with pytest.raises(OptionError, match="beyond any"):
            kind.of(number, unit)
        return
    quantity = kind.of(number, unit)
    assert quantity.to(unit) == number
    assert kind.parse(str(quantity)) == quantity


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (Length.parse("1060 um"), Length.parse("1.06mm")),
        (Length.parse("1.060 mm"), Length.parse("1.06 mm")),
        (Length.parse("0.1 m"), Length.parse("10 cm")),
        (Length.parse("0 m"), Length.parse("-0e999999999 nm")),
        (Length.parse("1.55 \u00b5m"), Length.parse("1550nm")),
        (Length.parse("1.55 \u03bcm"), Length.of(1550, "nm")),
        (Angle.parse("1 rad"), Angle.parse("1000 mrad")),
        (Angle.parse("30°"), Angle.of(30.0, "deg")),
        (Duration.parse("1 s"), Duration.parse("1e6 µs")),
        (Luminance.parse("100 cd/m²"), Luminance.parse("100nit")),
    ],
)
def test_equal_by_value(one, other):
    assert one == other
    assert len({one, other}) == 1


def test_unequal():
    assert Length.parse("1 mm") != Length.parse("1.0000000000000000001 mm")
    assert Length.parse("0 mm") != Angle.parse("0 deg")
    assert Percentage.parse("90 %") != "90 %"


def test_values():
    length = Length.parse("0.3 mm")
    assert (length.nm, length.um, length.mm, length.m) == (300_000, 300, 0.3, 0.0003)
    assert Angle.parse("180 deg").rad == math.pi
    assert Angle.of(1, "rad").rad == 1
    assert Angle.of(1, "rad").deg == math.degrees(1)
    assert (Duration.parse("10 ms").s, Duration.parse("10 us").ms) == (0.01, 0.01)
    assert Percentage.parse("90%").value == 0.9
    assert Luminance.parse("3 nit").cd_m2 == 3
    assert str(Luminance.parse("3 nit")) == "3 cd/m2"
    assert str(Length.of(3.0, "mm")) == "3 mm"


@pytest.mark.parametrize("bare", [1.06, "1.06", " 1.06 "])
def test_a_bare_number_is_told_its_units(bare):
    with pytest.raises(OptionError) as error:
        Length.parse(bare)
    assert str(error.value) == (
        "1.06 has no unit: write a length as 1.06 mm (units: nm, um, mm, cm, m)"
    )


def test_a_bare_share_is_not_taken_for_percent():
    with pytest.raises(
        OptionError, match=r"0.9 has no unit: write a fraction as 90 % \(units: %\)"
    ):
        Percentage.parse(0.9)


@pytest.mark.parametrize(
    "text",
    ["", "mm", "inf", "inf mm", "nan mm", "1,06 mm", "1.0.6 mm", "1e mm", "1 furlong", "1 MM",
     "1 mm 2", "１ mm", "1e31 mm", "1e-31 mm", "1e999999999999 mm", "--1 mm",
     f"1.{5000 * '1'} mm"],
)  # fmt: skip
def test_no_length(text):
    with pytest.raises(OptionError, match="length"):
        Length.parse(text)


@pytest.mark.parametrize(
    "given", [None, [1], math.inf, math.nan, pytest.param(10**5000, id="huge"), Angle.of(1, "deg")]
)
def test_no_text(given):
    with pytest.raises(OptionError, match=r"is not a length: write a length as 1.06 mm"):
        Length.parse(given)


def test_an_unknown_unit_names_those_there_are():
    with pytest.raises(OptionError, match=r"'sec' is unknown.*us, ms, s"):
        Duration.parse("3 sec")


class Model(BaseModel):
    length: Length
    share: Percentage = Percentage.parse("90 %")


def test_pydantic_takes_and_gives_text():
    model = Model.model_validate({"length": "1.060mm"})
    assert model == Model(length=Length.parse("1.06 mm"))
    assert model.model_dump() == {"length": "1.060 mm", "share": "90 %"}
    assert Model.model_validate_json(model.model_dump_json()) == model


@pytest.mark.parametrize("given", [3, "{a} mm", "7 furlong", Angle.parse("1 deg")])
def test_pydantic_gives_the_same_message(given):
    with pytest.raises(OptionError) as plain:
        Length.parse(given)
    with pytest.raises(ValidationError) as wrapped:
        Model.model_validate({"length": given})
    assert [each["msg"] for each in wrapped.value.errors()] == [str(plain.value)]
