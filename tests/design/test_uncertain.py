"""Values with ±: as they are read, and what becomes of them, against Monte Carlo."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from nolens.design.replica import Cover, Film, Replica
from nolens.design.uncertain import Uncertain, propagate
from nolens.errors import OptionError

SMALL = st.floats(1e-4, 5e-3)


@pytest.mark.parametrize("text", ["0.4mm±0.2mm", "0.4mm+-0.2mm", "0.4 ± 0.2 mm", "400 um±0.2mm",
                                  "0.4+/-0.2mm", "4e2um ± 200 µm"])  # fmt: skip
def test_lengths(text: str) -> None:
    assert Uncertain.length(text) == Uncertain(400.0, 200.0)


@given(
    st.floats(1e-3, 1e3),
    st.one_of(st.just(0.0), st.floats(1e-9, 1e3)),
    st.sampled_from(["nm", "um", "mm", "m"]),
)
def test_lengths_round_trip(value: float, off: float, unit: str) -> None:
    size = {"nm": 1e-3, "um": 1.0, "mm": 1e3, "m": 1e6}[unit]
    found = Uncertain.length(f"{value!r}±{off!r}{unit}")
    assert found.value == pytest.approx(value * size)
    assert found.plus_minus == pytest.approx(off * size)


def test_plain_values() -> None:
    assert Uncertain.length("1.06mm") == Uncertain(1060.0)
    assert Uncertain.number("1.47") == Uncertain(1.47)
    assert Uncertain.number("1.47 +- 0.005") == Uncertain(1.47, 0.005)


@pytest.mark.parametrize(("text", "words"), [
    ("0.4", "0.4 has no unit"), ("0.4mm±0.2", "0.2 has no unit"), ("0.4±0.2", "0.2 has no unit"),
    ("0.4mm±-0.2mm", "negative ±"), ("0.4mm±0.1mm±0.1mm", "more than once"), ("±0.2mm", "''"),
    ("0.4mm±", "''"), ("1mm±2s", "unit 's' is unknown"), ("", "''")])  # fmt: skip
def test_lengths_that_are_none(text: str, words: str) -> None:
    with pytest.raises(OptionError, match=words):
        Uncertain.length(text)


@pytest.mark.parametrize("text", ["", "n", "1.4mm", "1.4±", "±0.1", "1.4±x", "1e99", "nan", "inf"])
def test_numbers_that_are_none(text: str) -> None:
    with pytest.raises(OptionError, match="is no number"):
        Uncertain.number(text)


def replica(values: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """All figures of a replica, from those of the film."""
    cover = Cover((values["glass"], values["gap"]), (values["glass index"], 1.0))
    film = Film(values["film"], values["film index"], values["distance"], "scene")
    radius = film.over(cover, 1.0, 3e5).focused_radius_um()
    made = Replica(values["index"], radius, cover, 3e5)
    return {"radius": radius, **made.figures(0.55, values["pitch"], 0.15)}


MIDDLE = {"film": 305.0, "film index": 1.59, "distance": 400.0, "glass": 490.0,
          "glass index": 1.52, "gap": 235.0, "index": 1.47, "pitch": 70.0}  # fmt: skip


@settings(max_examples=10)
@given(st.lists(SMALL, min_size=len(MIDDLE), max_size=len(MIDDLE)), st.integers(0, 2**31))
def test_monte_carlo(shares: list[float], seed: int) -> None:
    """± is the standard deviation of what comes out of normal inputs: to 4 % with 20000 of them."""
    inputs = {
        name: Uncertain(value, value * share)
        for (name, value), share in zip(MIDDLE.items(), shares, strict=True)
    }
    found = propagate(inputs, replica)
    random = torch.Generator().manual_seed(seed)
    drawn = {
        name: each.value
        + each.plus_minus * torch.randn(20000, generator=random, dtype=torch.float64)
        for name, each in inputs.items()
    }
    for name, values in replica(drawn).items():
        assert found[name].plus_minus == pytest.approx(float(values.std()), rel=0.04), name
        assert found[name].value == pytest.approx(float(values.median()), rel=0.002), name


def test_parts_are_differences() -> None:
    """What each input does alone, against the difference of two evaluations."""
    inputs = {name: Uncertain(value, 0.01 * value) for name, value in MIDDLE.items()}
    found = propagate(inputs, replica)
    for moved in MIDDLE:
        ends = [
            replica({
                name: torch.tensor(
                    value * (1 + sign * 1e-4 * (name == moved)), dtype=torch.float64
                )
                for name, value in MIDDLE.items()
            })
            for sign in (-1, 1)
        ]  # fmt: skip
        for name, figure in found.items():
            part = float(ends[1][name] - ends[0][name]) / 2 * 100
            assert figure.parts[moved] == pytest.approx(part, rel=1e-4, abs=1e-6 * figure.value)
    for figure in found.values():
        assert sum(figure.fractions.values()) == pytest.approx(1)
        assert figure.plus_minus == pytest.approx(math.hypot(*figure.parts.values()))


def test_inputs_without_plus_minus() -> None:
    found = propagate(
        {"a": Uncertain(2.0, 0.1), "b": Uncertain(3.0)},
        lambda v: {"product": v["a"] * v["b"], "other": v["b"], "fixed": torch.tensor(1.0)},
    )
    assert found["product"].value == 6 and found["product"].parts == pytest.approx({"a": 0.3})
    assert found["other"].parts == {"a": 0} and found["other"].fractions == {}
    assert found["fixed"].plus_minus == 0
