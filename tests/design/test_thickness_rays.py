"""Thickness and radius in focus: closed form = matrix = Snell's law, over random stacks."""

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import assume, given
from hypothesis import strategies as st
from snell import behind_sphere, crossing_thickness

from nolens.design.focus import LensletStack
from nolens.design.replica import (
    Cover,
    Film,
    Replica,
    master_radius_um,
    printed_radius_um,
    replica_thickness_um,
)
from nolens.errors import OptionError

INDEX = st.floats(1.0, 2.0)
THICKNESS = st.floats(1.0, 2000.0)
FAR = st.just(math.inf)
SOURCE = st.one_of(FAR, st.floats(2e4, 1e6))


@st.composite
def stacks(draw: st.DrawFn, source: st.SearchStrategy[float] = SOURCE) -> tuple[LensletStack, int]:
    """A stack in focus, and the layer that was solved for."""
    count = draw(st.integers(1, 5))
    indices = tuple(draw(st.lists(INDEX, min_size=count, max_size=count)))
    thicknesses = tuple(draw(st.lists(THICKNESS, min_size=count, max_size=count)))
    surface = draw(st.integers(0, count - 1))
    radius = draw(st.floats(300.0, 2000.0))
    stack = LensletStack(thicknesses, indices, surface, radius, draw(source))
    assume(abs(indices[surface] - float(stack.before)) > 0.15)
    layer = draw(st.integers(surface, count - 1))
    found = float(stack.focused_thickness_um(layer))
    # A thickness below zero is as good for mathematics, and needs as little approximation.
    solved = tuple(found if n == layer else t for n, t in enumerate(thicknesses))
    return replace(stack, thicknesses_um=solved), layer


@given(stacks())
def test_focus_condition(made):
    """N₁₁ = 0, or N₁₂ = 0 of a near source; and the radius comes back."""
    stack, _ = made
    matrix = stack.matrix()
    column = 0 if math.isinf(stack.source_um) else 1
    scale = 1.0 if column == 0 else stack.source_um
    assert abs(float(matrix[0, column])) < 1e-9 * scale
    assert abs(float(stack.blur)) < 1e-9
    if float(stack.behind_um) > 1:
        again = replace(stack, radius_um=1.0).focused_radius_um()
        assert float(again) == pytest.approx(float(stack.radius_um), rel=1e-8)


@given(stacks())
def test_lens_equation(made):
    """The reduced lengths in front of and behind the lenslets meet 1/D = 1/f − 1/L."""
    stack, _ = made
    front = stack.source_um + sum(
        t / n
        for t, n in zip(
            stack.thicknesses_um[: stack.surface], stack.indices[: stack.surface], strict=True
        )
    )
    focal = stack.radius_um / abs(stack.indices[stack.surface] - float(stack.before))
    assert float(stack.focal_length_um) == pytest.approx(focal)
    assert 1 / float(stack.behind_um) == pytest.approx(1 / focal - 1 / front, rel=1e-9)


@given(stacks())
def test_snell_near_the_axis(made):
    """A real ray a ten-thousandth of the radius off the axis: to 1e-6 of the focal length."""
    stack, layer = made
    path = behind_sphere(
        stack.thicknesses_um, stack.indices, stack.surface, float(stack.signed_radius_um),
        1e-4 * stack.radius_um, stack.source_um,
    )  # fmt: skip
    traced = crossing_thickness(stack.thicknesses_um, stack.indices, stack.surface, layer, path)
    scale = 2 * float(stack.focal_length_um) + sum(map(abs, stack.thicknesses_um))
    assert abs(traced - stack.thicknesses_um[layer]) < 1e-6 * scale


@given(stacks(FAR), st.floats(0.01, 0.04))
def test_spherical_aberration(made, share):
    """What rays off the axis differ by is what the third order says, to the fifth."""
    stack, layer = made
    height = share * stack.radius_um
    path = behind_sphere(
        stack.thicknesses_um, stack.indices, stack.surface, float(stack.signed_radius_um), height
    )
    traced = crossing_thickness(stack.thicknesses_um, stack.indices, stack.surface, layer, path)
    stated = float(stack.spherical_um(layer, height))
    scale = 2 * float(stack.focal_length_um) + sum(map(abs, stack.thicknesses_um))
    assert abs(stack.thicknesses_um[layer] - traced - stated) < 5 * share**4 * scale


def test_spherical_aberration_is_seen():
    """So that the bound above is not met by zero: the paper's lenslets, at half their pitch."""
    replica = Replica(1.47, 678.0, Cover((490.0, 235.0), (1.52, 1.0)))
    stack = replica.stack(float(replica.thickness_um))
    path = behind_sphere(stack.thicknesses_um, stack.indices, 0, 678.0, 35.0)
    traced = crossing_thickness(stack.thicknesses_um, stack.indices, 0, 0, path)
    stated = float(stack.spherical_um(0, 35.0))
    assert stack.thicknesses_um[0] - traced == pytest.approx(stated, rel=0.01)
    assert stated == pytest.approx(1.37, abs=0.02)


FILM = {"film_um": THICKNESS, "film_index": st.floats(1.2, 2.0), "distance_um": THICKNESS}
GLASS = {"glass_um": THICKNESS, "glass_index": st.floats(1.0, 2.0), "gap_um": THICKNESS}


@given(st.fixed_dictionaries(FILM), st.fixed_dictionaries(GLASS), st.floats(1.2, 2.0))
def test_closed_forms_are_the_matrices(film, glass, index):
    cover = Cover((glass["glass_um"], glass["gap_um"]), (glass["glass_index"], 1.0))
    master = Film(film["film_um"], film["film_index"], film["distance_um"], "scene")
    radius = float(master.over(cover, 1.0, math.inf).focused_radius_um())
    assert radius == pytest.approx(master_radius_um(**film, **glass), rel=1e-12)
    replica = Replica(index, radius, cover)
    closed = replica_thickness_um(radius, index, **glass)
    assert float(replica.thickness_um) == pytest.approx(closed, rel=1e-9, abs=1e-6)
    # As printed, eq. 3 is right for a glass with the film's own index.
    alike = {**glass, "glass_index": film["film_index"]}
    printed = {key: value for key, value in {**film, **glass}.items() if key != "glass_index"}
    assert printed_radius_um(**printed) == pytest.approx(master_radius_um(**film, **alike))


@given(st.fixed_dictionaries(FILM), st.fixed_dictionaries(GLASS))
def test_flipped_film(film, glass):
    """Its own thickness is in front of the relief, and so does not count."""
    cover = Cover((glass["glass_um"], glass["gap_um"]), (glass["glass_index"], 1.0))
    master = Film(film["film_um"], film["film_index"], film["distance_um"], "sensor")
    reduced = film["distance_um"] + glass["glass_um"] / glass["glass_index"] + glass["gap_um"]
    radius = float(master.over(cover, 1.0, math.inf).focused_radius_um())
    assert radius == pytest.approx((film["film_index"] - 1) * reduced, rel=1e-12)


def test_paper_figures():
    """Golden: 0.678 and 0.670 mm, 1.46 and 1.30 mm, as printed 1.43 and 1.28 mm."""
    exact = master_radius_um(305, 1.59, 400, 490, 1.52, 235)
    printed = printed_radius_um(305, 1.59, 400, 490, 235)
    assert [round(exact, 0), round(printed, 0)] == [678, 670]
    glass = (490.0, 1.52, 235.0)
    for index, right, as_printed in ((1.43, 1.46, 1.43), (1.47, 1.30, 1.28)):
        assert replica_thickness_um(exact, index, *glass) == pytest.approx(1e3 * right, abs=5)
        assert replica_thickness_um(printed, index, *glass) == pytest.approx(
            1e3 * as_printed, abs=5
        )


def test_layer_in_front_of_the_lenslets():
    """It moves the focus of a near source alone."""
    flipped = LensletStack((305.0, 400.0, 235.0), (1.59, 1.0, 1.0), 1, 400.0, 3e3)
    found = float(flipped.focused_thickness_um(0))
    solved = replace(flipped, thicknesses_um=(found, 400.0, 235.0))
    assert abs(float(solved.blur)) < 1e-12
    with pytest.raises(OptionError, match="does not move the focus"):
        replace(flipped, source_um=math.inf).focused_thickness_um(0)


def test_many_at_once():
    """Tensors of values give what each gives alone."""
    radius = torch.tensor([500.0, 678.0, 900.0], dtype=torch.float64)
    index = torch.tensor([1.40, 1.47, 1.55], dtype=torch.float64)
    cover = Cover((490.0, 235.0), (1.52, 1.0))
    together = Replica(index, radius, cover, 3e5).thickness_um
    alone = [
        float(Replica(float(n), float(r), cover, 3e5).thickness_um)
        for n, r in zip(index, radius, strict=True)
    ]
    assert together.tolist() == pytest.approx(alone, rel=1e-12)


def test_what_would_focus_does():
    """The remedies of a replica that cannot focus: at their limits the thickness is zero."""
    cover = Cover((490.0, 235.0), (1.52, 1.0))
    for source in (math.inf, 2e4):
        with pytest.raises(OptionError, match="cannot focus") as refused:
            Replica(1.7, 350.0, cover, source).check("thick", 550.0)
        text = str(refused.value)
        least = float(text.split("more than ")[1].split(" mm")[0]) * 1e3
        most = float(text.split("n below ")[1].split(" ")[0])
        for replica in (Replica(1.7, least, cover, source), Replica(most, 350.0, cover, source)):
            assert abs(float(replica.thickness_um)) < 5
        assert "air" not in text.split("(")[2] and "pdms" in text
