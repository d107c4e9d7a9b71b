"""Numbers with units as people read them."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nolens.amounts import amount


@pytest.mark.parametrize(
    ("shown", "text"),
    [
        (amount(100.4, "um", digits=2), "100 µm"),
        (amount(-4.2e-05, "um", digits=2), "0 µm"),
        (amount(157.3, "nm", digits=2), "160 nm"),
        (amount(-0.0, "um"), "0 µm"),
        (amount(14.253, "um"), "14.3 µm"),
        (amount(20.0, "um"), "20 µm"),
        (amount(0.999996, "mm"), "1 mm"),
        (amount(99.96, "um"), "100 µm"),
        (amount(123456.0, "um"), "123000 µm"),
        (amount(0.0005), "0.0005"),
        (amount(2.5, "um", sign=True), "+2.5 µm"),
        (amount(-0.25, "%", sign=True), "-0.25 %"),
        (amount(math.inf, "mm"), "inf mm"),
    ],
)
def test_text(shown: str, text: str) -> None:
    assert shown == text


@given(st.floats(1e-3, 1e5), st.integers(2, 6), st.sampled_from(["", "um", "mm", "%"]))
def test_plain_and_near(value: float, digits: int, unit: str) -> None:
    text = amount(-value, unit, digits=digits)
    assert "e" not in text and text[0] == "-"
    assert -float(text.split()[0]) == pytest.approx(value, rel=0.51 * 10 ** (1 - digits))
