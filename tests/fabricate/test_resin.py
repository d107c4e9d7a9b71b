"""How much to pour and to mix."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from workpieces import PAPER, frame, resin_of

from nolens.camera import material
from nolens.errors import OptionError
from nolens.fabricate import FrameGeometry, MouldAmount, ResinAmount, Wetting
from nolens.fabricate.resin import meniscus_mm3

PUA = material("pua311")


def test_papers_resin() -> None:
    """Cavity 10.98 × 9.15 × 3 − 10.78 × 8.95 × 1.94 mm³; all of it in mg at 1.1 g/cm³."""
    amount = ResinAmount.of(PAPER, FrameGeometry.of(PAPER))
    cavity = 10.98 * 9.15 * 3 - 10.78 * 8.95 * 1.94
    assert amount.cavity_mm3 == pytest.approx(cavity)
    assert PUA.density_g_cm3 is not None and PUA.cure_shrinkage is not None
    assert amount.cavity_mg == pytest.approx(cavity * PUA.density_g_cm3)
    cured = cavity + amount.overflow_mm3
    assert amount.pour_mm3 == pytest.approx(cured / (1 - PUA.cure_shrinkage) + amount.meniscus_mm3)
    assert amount.mass_mg is not None
    assert amount.mass_mg == pytest.approx(
        (cured + amount.meniscus_mm3 * (1 - PUA.cure_shrinkage)) * PUA.density_g_cm3
    )


@given(st.floats(0.1, 3))
def test_cavity_times_density_is_the_mass(thickness: float) -> None:
    """Without rim, vents and crown nothing else is poured, and curing takes no mass away."""
    camera = resin_of(f"{thickness} mm", material="noa61")
    made = FrameGeometry.of(camera, rim_mm=0.0, vents=0)
    amount = ResinAmount.of(camera, made, crown_mm=0.0)
    density = material("noa61").density_g_cm3
    assert density is not None and amount.mass_mg is not None
    height = 1.94 + thickness
    cavity = 10.98 * 9.15 * height - 10.78 * 8.95 * 1.94
    assert amount.mass_mg == pytest.approx(cavity * density, rel=1e-9)
    assert amount.pour_mm3 > cavity


def test_resin_that_little_is_known_of() -> None:
    camera = resin_of("1 mm", index=1.5)
    amount = ResinAmount.of(camera, FrameGeometry.of(camera), crown_mm=0)
    assert amount.mass_mg is None and amount.cavity_mg is None and amount.density_g_cm3 is None
    assert amount.shrinkage == 0
    assert amount.pour_mm3 == pytest.approx(amount.cavity_mm3 + amount.overflow_mm3)
    assert len(amount.notes) == 2 and "density" in amount.notes[0]


def liquid_surface(width: float, height: float, length: float, points: int = 61) -> float:
    """Mean over middle of ℓ²Δz = z − z₀ in a rectangle with z = 0 at its edges, by differences."""
    steps = width / (points - 1), height / (points - 1)
    z = np.zeros((points, points))
    weights = (length / steps[1]) ** 2, (length / steps[0]) ** 2
    odd = np.indices(z.shape).sum(0) % 2
    for _ in range(600):
        for colour in (0, 1):
            around = weights[0] * (z[:-2, 1:-1] + z[2:, 1:-1])
            around += weights[1] * (z[1:-1, :-2] + z[1:-1, 2:])
            better = (1 + around) / (1 + 2 * sum(weights))
            chosen = odd[1:-1, 1:-1] == colour
            inner = z[1:-1, 1:-1]
            inner[chosen] += 1.85 * (better - inner)[chosen]
    middle = z[points // 2, points // 2]
    volume = np.trapezoid(np.trapezoid(z, dx=steps[0]), dx=steps[1])
    return float(volume / (width * height * middle))


@pytest.mark.parametrize(("width", "height"), [(10.0, 8.0), (30.0, 30.0), (3.0, 3.0), (4.0, 12.0)])
def test_crown_is_that_of_the_equation_of_capillarity(width: float, height: float) -> None:
    wetting = Wetting(contact_angle_deg=89)
    made = frame(
        package_width_mm=width, package_height_mm=height, clearance_mm=0, rim_mm=0, vents=0
    )
    length = wetting.capillary_length_mm(1.0)
    assert length == pytest.approx(1.889, abs=1e-3)
    found = meniscus_mm3(made, 0.05, wetting, 1.0) / (0.05 * width * height)
    assert found == pytest.approx(liquid_surface(width, height, length), rel=0.01)


def test_crown_of_a_wide_frame_ends_at_a_wall_of_its_own() -> None:
    """Far from its corners the edge of a liquid lacks h ℓ of each mm of its length."""
    wetting = Wetting(contact_angle_deg=89)
    made = frame(package_width_mm=400, package_height_mm=400, clearance_mm=0, rim_mm=0, vents=0)
    length = wetting.capillary_length_mm(1.0)
    lacking = 0.05 * 400**2 - meniscus_mm3(made, 0.05, wetting, 1.0)
    assert lacking == pytest.approx(0.05 * length * 4 * 400, rel=0.01)


def test_crown_that_runs_over() -> None:
    made = FrameGeometry.of(PAPER)
    with pytest.raises(OptionError, match=r"runs over.*at most") as refused:
        ResinAmount.of(PAPER, made, crown_mm=2.0)
    most = float(str(refused.value).split("at most ")[1].split(" mm")[0])
    ResinAmount.of(PAPER, made, crown_mm=most)
    with pytest.raises(OptionError):
        ResinAmount.of(PAPER, made, crown_mm=most + 0.002)
    # A wide liquid's edge has the slope h/ℓ; this one is not that wide.
    density = 1.1 * 0.95
    slope = most / Wetting().capillary_length_mm(density)
    assert slope == pytest.approx(math.tan(math.radians(30)), rel=0.2)
    with pytest.raises(OptionError, match="0 mm or more"):
        ResinAmount.of(PAPER, made, crown_mm=-0.1)


def test_mould() -> None:
    """30 × 20 × 5 mm of 1.03 g/cm³ is 3.09 g: six parts of seven, and one."""
    made = frame()
    amount = MouldAmount.of(made, dish_mm=(30, 20))
    assert amount.mass_g == pytest.approx(3.09)
    assert amount.base_g == pytest.approx(3.09 * 6 / 7)
    assert amount.base_g / amount.hardener_g == pytest.approx(6)
    assert amount.base_g + amount.hardener_g == pytest.approx(amount.mass_g)
    assert MouldAmount.of(made).dish_mm == pytest.approx((33.5, 31.5))
    assert MouldAmount.of(made, dish_mm=(12, 14)).volume_mm3 == pytest.approx(12 * 14 * 5)
    with pytest.raises(OptionError, match=r"does not cover.*13.5 × 11.5 mm.*--dish"):
        MouldAmount.of(made, dish_mm=(13, 13))
    with pytest.raises(OptionError, match="--mould-thickness"):
        MouldAmount.of(made, thickness_mm=0)
