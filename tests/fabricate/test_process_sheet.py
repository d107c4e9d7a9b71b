"""What stands on the process sheet is computed from the camera, and agrees with the paper."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sheets import LINES, camera_of, changed, sheet_of, words_of

from nolens.camera import LoadedCamera, preset
from nolens.design.tolerances.study import BudgetLine
from nolens.errors import DataError, OptionError
from nolens.fabricate import FrameGeometry, ToleranceBudget
from nolens.fabricate.focus import ray_budget
from nolens.fabricate.sheet_parts import Steps, Table, millimetres
from nolens.fabricate.sheet_steps import Printing, Process


@pytest.fixture
def quick(monkeypatch):
    """The widths of the lines are given, not simulated."""
    monkeypatch.setattr("nolens.fabricate.sheet.expected_lines", lambda camera, limits: LINES)


def table(sheet, caption: str) -> Table:
    found = [
        block
        for section in sheet.sections
        for block in section.blocks
        if isinstance(block, Table) and block.caption.startswith(caption)
    ]
    return found[0]


# --- The paper's camera ----------------------------------------------------------------------


def test_amounts_of_the_papers_camera(quick):
    """The paper's module is 12.98 × 11.15 × 3 mm; its mould is mixed 6:1."""
    sheet = sheet_of(preset("paper"))
    words = words_of(sheet)
    mould_g = (12.98 + 20) * (11.15 + 20) * 5 * 1.03e-3
    assert mould_g == pytest.approx(5.29, abs=0.005)
    base, hardener = (1.1 * mould_g * share for share in (6 / 7, 1 / 7))
    assert f"{base:.2f} g base + {hardener:.2f} g hardener" in words
    assert "6:1 by mass" in words
    assert f"{mould_g:.2f} g into the dish" in words
    cavity = 10.98 * 9.15 * 3 - 10.78 * 8.95 * 1.94
    assert f"cavity {cavity:.1f} µl" in words
    assert f"the cavity holds {cavity * 1.1:.1f} mg at 1.1 g/cm³" in words
    resin = table(sheet, "Amounts").rows[2]
    volume, mass = (float(each.split()[0]) for each in resin[1].split("="))
    assert (cavity / 0.95) < volume < 1.1 * (cavity / 0.95)
    # Curing keeps the mass: 5 % less volume, 1.1 g/cm³ when hard.
    assert mass == pytest.approx(volume * 0.95 * 1.1, abs=0.6)


def test_process_is_the_papers(quick):
    words = words_of(sheet_of(preset("paper")))
    for text in ("80 °C for 60 min", "5 min", "lamp of 35 W", "pinhole of 50 µm at 300 mm"):
        assert text in words


def test_every_instruction_has_its_origin_and_a_number(quick):
    blocks = [block for section in sheet_of(preset("paper")).sections for block in section.blocks]
    number = 1
    for steps in (block for block in blocks if isinstance(block, Steps)):
        assert steps.first == number
        number += len(steps.steps)
    assert number > 20


def test_placeholders_are_named(quick):
    words = words_of(sheet_of(preset("paper")))
    line = next(line for line in words.splitlines() if line.startswith("Placeholders"))
    for what in ("package of the sensor", "density of pua311", "shrinkage of pua311"):
        assert what in line
    frame = FrameGeometry.of(preset("paper"))
    own = words_of(sheet_of(preset("paper"), package_width_mm=frame.package_width_mm - 0.01))
    assert "package of the sensor" not in own


# --- Every number comes from the camera ------------------------------------------------------


@settings(max_examples=25)
@given(um=st.integers(300, 2500))
def test_heights_follow_the_thickness(um):
    thickness = um / 1000
    camera = camera_of(thickness_mm=thickness)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("nolens.fabricate.sheet.expected_lines", lambda camera, limits: LINES)
        sheet = sheet_of(camera)
    words = words_of(sheet)
    assert f"A mask of pua311, {millimetres(thickness)} mm thick" in words
    assert (
        f"{millimetres(thickness + 1.94)} mm + {millimetres(thickness)} mm − measured t′" in words
    )
    cavity = 10.98 * 9.15 * (thickness + 1.94) - 10.78 * 8.95 * 1.94
    assert f"cavity {cavity:.1f} µl" in words
    budget = ray_budget(camera)
    rows = table(sheet, "Heights").rows
    allowed = "" if budget.layer_mm is None else f" ± {budget.layer_mm:.2f}"
    assert [row[1] for row in rows[:2]] == [
        f"{millimetres(thickness + 1.94)}{allowed} mm", f"{millimetres(thickness)}{allowed} mm"
    ]  # fmt: skip
    assert ("No room" in words) == (budget.layer_mm is None)
    shrunk = thickness * 0.95
    assert f"down to {shrunk:.2f} mm" in words


def test_another_resin_another_curing(quick):
    light = words_of(sheet_of(camera_of(material="noa61")))
    assert "3 J/cm²" in light and "350 to 380 nm" in light and "3000 / irradiance" in light
    assert "norland60" in light and "35 W" not in light
    heat = words_of(sheet_of(camera_of(material="pdms")))
    assert "PDMS sticks" in heat and heat.count("80 °C for 60 min") == 2
    assert "ultraviolet lamp," not in heat
    unknown = words_of(sheet_of(camera_of(material="pmma")))
    assert "nolens knows no figures" in unknown and "35 W" not in unknown
    assert "no public figures are known to nolens for pmma" in unknown


def test_a_resin_of_bare_index_has_no_mass(quick):
    camera = preset("paper")
    resin = camera.layers[0].model_copy(update={"material": None, "index": 1.5})
    camera = camera.model_copy(update={"layers": (resin, *camera.layers[1:])})
    words = words_of(sheet_of(camera))
    assert "a material of index 1.5" in words
    assert "density_g_cm3" in words and "poured µl" in words and "poured mg" not in words


def test_a_given_budget_takes_the_place_of_the_first_one(quick):
    line = BudgetLine("wedge", 0.0, 0.25, "deg", "the corners differ")
    budget = ToleranceBudget((line,), "From 1000 trials.", 0.07)
    sheet = sheet_of(preset("paper"), budget)
    assert table(sheet, "How far off").rows == (
        ("wedge", "0 deg", "± 0.25 deg", "the corners differ"),
    )
    words = words_of(sheet)
    assert "From 1000 trials." in words and "From rays" not in words
    assert "3.00 ± 0.07 mm" in words


def test_the_sheet_says_why_no_width_is_predicted(monkeypatch):
    def fail(camera: LoadedCamera, limits: tuple[float, ...]) -> None:
        raise DataError("the PSF is even")

    monkeypatch.setattr("nolens.fabricate.sheet.expected_lines", fail)
    words = words_of(sheet_of(preset("paper")))
    assert "No width can be predicted for this camera: the PSF is even" in words
    assert "FWHM 2" not in words


@pytest.mark.parametrize(("thickness", "where"), [(0.2, "in front of"), (3.0, "behind")])
def test_a_camera_out_of_focus_has_no_budget(quick, thickness, where):
    camera = changed(camera_of(thickness_mm=thickness), pitch="120 um")
    budget = ray_budget(camera)
    assert budget.lines == () and budget.layer_mm is None
    assert where in budget.method
    words = words_of(sheet_of(camera))
    assert budget.method in words and "±" not in words


# --- Printing --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("height", "details", "layer", "layers"),
    [
        (3.0, (), 0.1, 30),
        (3.0, (0.25,), 0.05, 60),
        (2.34, (), 0.09, 26),
        (1.05, (0.35,), 0.07, 15),
        (2.0, (0.017,), 0.1, 20),
    ],
)
def test_layers_make_whole_heights(height, details, layer, layers):
    printing = Printing.of(height, *details)
    assert (printing.layer_mm, printing.layers) == (layer, layers)
    assert printing.miss_mm == pytest.approx(0, abs=1e-9)


@given(height=st.floats(0.5, 20))
def test_no_layer_of_the_choice_fits_better(height):
    printing = Printing.of(height)
    assert printing.layers * printing.layer_mm - height == pytest.approx(printing.miss_mm)
    for number in range(5, 21):
        layer = number / 200
        other = abs(round(height / layer) * layer - height)
        assert abs(printing.miss_mm) <= other + 1e-6


def test_layers_that_do_not_fit_are_said(quick):
    camera = camera_of(thickness_mm=1.0637)
    words = words_of(sheet_of(camera))
    printing = Printing.of(1.0637 + 1.94, 0.25)
    missed = printing.layers * printing.layer_mm - 3.0037
    assert 5e-4 < abs(missed) < 0.01
    said = f"({abs(missed):.3f} mm too {'high' if missed > 0 else 'low'})"
    assert f"{printing.layers} layers of {printing.layer_mm:.3f} mm {said}" in words


def test_process_of_unknown_resin_claims_nothing():
    cure = Process.of(None).cure
    assert (cure.source, cure.minutes, cure.lamp_w, cure.dose_j_cm2) == (None,) * 4


def test_a_film_at_a_distance_is_refused():
    with pytest.raises(OptionError, match="film with air"):
        sheet_of(preset("paper-film"))
