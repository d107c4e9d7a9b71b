"""What the sheet says of light: focus, first tolerances, and the width of the PSF's lines."""

import math
from dataclasses import replace

import pytest
import torch
from sheets import camera_of, changed

from nolens.camera import Flat, LoadedCamera, ReliefFile, preset
from nolens.errors import DataError
from nolens.evaluate import pattern_figures
from nolens.fabricate.focus import expected_lines, focus_of, ray_budget
from nolens.optics import PointSource, Stack, mask_to_sensor
from nolens.quantities import Length
from nolens.twin import Light, Twin, point_spread


def test_focus_is_that_of_the_closed_form():
    """N₁₁ = 0 at t' = R n'/(n' − 1) − n'(t_g/n_g + d_g) (eq. 5)."""
    camera = preset("paper")
    index, glass, _ = camera.indices(550)
    best = 0.67 * index / (index - 1) - index * (0.49 / glass + 0.235)
    focus = focus_of(camera)
    assert focus.length_mm == pytest.approx(0.67 / (index - 1))
    assert focus.aperture == pytest.approx(0.035 / focus.length_mm)
    assert focus.off_mm == pytest.approx((1.06 - best) / index)
    assert focus.depth_mm == pytest.approx(550e-6 / focus.aperture**2)
    assert focus_of(camera_of(thickness_mm=round(best, 6))).off_mm == pytest.approx(0, abs=1e-6)


def test_budget_uses_the_room_that_rays_leave():
    """The root of the sum of squares of what each line does, by matrices, is that room."""
    camera = preset("paper")
    thicknesses = [layer.thickness.um for layer in camera.layers]
    values = dict(zip(("resin", "cover glass", "gap"), range(3), strict=True))

    def off_mm(thicknesses_um, indices) -> float:
        matrix = mask_to_sensor(1.0, Stack(tuple(thicknesses_um), tuple(indices)), 670.0)
        return 0.67 / (indices[0] - 1) * -float(matrix[0, 0])

    moved = []
    budget = ray_budget(camera)
    for line in budget.lines:
        layer, what = line.parameter.split(", ")
        ends = []
        for sign in (-1e-3, 1e-3):
            own, indices = list(thicknesses), list(camera.indices(550))
            if what == "thickness":
                own[values[layer]] += sign * line.allowed * 1e3
                assert line.nominal == pytest.approx(thicknesses[values[layer]] * 1e-3)
            else:
                indices[values[layer]] += sign * line.allowed
                assert line.nominal == indices[values[layer]] - sign * line.allowed
            ends.append(off_mm(own, indices))
        moved.append((ends[1] - ends[0]) / 2e-3)
    assert [line.parameter for line in budget.lines].count("resin, thickness") == 1
    focus = focus_of(camera)
    room = focus.depth_mm / 2 - abs(focus.off_mm)
    assert math.hypot(*moved) == pytest.approx(room, rel=1e-4)
    assert budget.layer_mm == budget.lines[0].allowed
    assert f"leaves {room:.2f} mm" in budget.method


@pytest.mark.parametrize(
    "relief", [Flat(kind="flat"), ReliefFile(kind="file", file="a.tif", grid=Length("1", "um"))]
)
def test_rays_know_nothing_of_other_masks(relief):
    camera = preset("paper")
    mask = camera.mask.model_copy(update={"relief": relief})
    budget = ray_budget(camera.model_copy(update={"mask": mask}))
    assert budget.lines == () and "nolens design tolerance" in budget.method


# --- The check with a pinhole ----------------------------------------------------------------


def test_lines_are_those_of_the_twin():
    """Widths come from the camera's own sensor, mask and distance; thinner than focus: wider."""
    camera = changed(preset("small"), overhang="0.3 mm")
    camera = camera.model_copy(
        update={"mask": camera.mask.model_copy(update={"aperture": None})}
    )  # fmt: skip
    found = expected_lines(LoadedCamera.of(camera), (0.5, 1.06))
    twin = Twin.of(LoadedCamera.of(camera))
    source = PointSource(distance_um=300e3, diameter_um=50.0)
    psf = point_spread(
        twin, source, (128, 160), superpixel=2, light=Light("white-led"), wavelengths=1
    )  # fmt: skip
    width = pattern_figures(psf.mean(dim=0), 3.1).width_um
    assert found[1].width_um == pytest.approx(width, rel=1e-6)
    assert found[1].line_um == pytest.approx(width / math.sqrt(2), rel=1e-6)
    assert [each.layer_mm for each in found] == [0.5, 1.06]
    assert found[0].width_um > 1.1 * found[1].width_um


def test_lines_of_the_papers_camera_are_the_papers():
    """Autocorrelation 20.15 µm wide."""
    camera = changed(preset("paper"), overhang="0.3 mm")
    (found,) = expected_lines(LoadedCamera.of(camera), (1.06,))
    assert found.width_um == pytest.approx(20.15, abs=2)


def test_lines_of_a_relief_from_a_file():
    camera = changed(preset("small"), overhang="0.3 mm")
    relief = Twin.of(LoadedCamera.of(camera)).mask.relief
    file = ReliefFile(kind="file", file="a.tif", grid=Length("1.55", "um"))
    mask = camera.mask.model_copy(update={"relief": file})
    other = camera.model_copy(update={"mask": mask})
    given_file = replace(
        LoadedCamera.of(preset("small")), camera=other, relief_um=relief.height_um.to(torch.float32)
    )
    own = expected_lines(LoadedCamera.of(camera), (1.06,))
    assert expected_lines(given_file, (1.06,))[0].width_um == pytest.approx(own[0].width_um)


def test_a_flat_mask_has_no_lines():
    camera = preset("small")
    mask = camera.mask.model_copy(update={"relief": Flat(kind="flat"), "aperture": None})
    with pytest.raises(DataError, match="flat"):
        expected_lines(LoadedCamera.of(camera.model_copy(update={"mask": mask})), (1.06,))
