"""What the paper says and what is computed beside it, against plain arithmetic."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from watching import Watcher

from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.files import read_camera
from nolens.jobs import SimulateOptions, simulate
from nolens.operators import PixelRectangle
from nolens.quantities import Luminance
from nolens.reproduction import depths, photographs, resolution, thickness
from nolens.reproduction.comparison import PAPER, Content, Results, paper_row, section
from nolens.reproduction.setup import FULL, QUICK, ExperimentSetup
from nolens.reproduction.steps import StepResult
from nolens.solvers import Problem
from nolens.twin import Plane


def paper(key: str) -> float:
    value = PAPER[key].value
    assert value is not None
    return value


def test_the_papers_own_values_hang_together() -> None:
    assert paper("line") == pytest.approx(paper("width") / math.sqrt(2), abs=0.005)
    assert paper("pitch") == pytest.approx(45 * 1.55, abs=0.005)
    assert paper("line") / 3.1 == pytest.approx(4.6, abs=0.05)
    assert paper("aperture") == pytest.approx(
        paper("pitch") / 2e3 / paper("focal length"), rel=0.01
    )
    assert paper("depth of focus") == pytest.approx(0.5e-3 / paper("aperture") ** 2, rel=0.01)
    # Both magnifications are those of one, too short, distance of mask and sensor.
    implied = [paper(f"magnification {cm}") / 100 / (1 / (10 * cm) - 1 / 200) for cm in (3, 8)]
    assert implied == pytest.approx([0.47, 0.48], abs=0.01)


def test_the_papers_focal_length_is_the_master_films() -> None:
    """R of 0.67 mm in polycarbonate, n = 1.59, and half of 69.75 µm."""
    found = thickness.master_lenslet(paper("radius"), 1.59, paper("pitch"))
    assert found["focal_length_mm"] == pytest.approx(1.14, abs=0.005)
    assert found["aperture"] == pytest.approx(0.031, abs=0.0005)
    assert found["depth_of_focus_mm"] == pytest.approx(0.53, abs=0.005)


def test_a_row_says_the_ratio_and_its_size() -> None:
    whole, part = (ExperimentSetup(read_camera("paper"), size, 0) for size in (FULL, QUICK))

    @section("fig", "Fig.")
    def made(setup: ExperimentSetup, results: Results) -> Content:
        width = paper_row("width", 40.3, "40.30 µm", "twice as wide", sized=True)
        return Content((width, paper_row("mtf", None, "equal", "")))

    rows = made(part, {}).rows
    assert rows[0].ratio == pytest.approx(2.0) and rows[0].reduced
    assert rows[0].columns == ("20.15 µm", "40.30 µm (reduced size)", "2.00", "twice as wide")
    assert made(whole, {}).rows[0].columns[1] == "40.30 µm"
    assert rows[1] == made(whole, {}).rows[1] and rows[1].columns[1:3] == ("equal", "")


def test_the_overlap_is_that_of_rays_by_snells_law() -> None:
    work = ExperimentSetup(read_camera("paper"), QUICK, 0)
    row = resolution._overlap(work)
    indices = np.array(work.loaded.camera.indices(550.0))
    inside = np.arcsin(math.sin(math.radians(10)) / indices)
    moved = float((np.array([1.06, 0.49, 0.235]) * np.tan(inside)).sum())
    assert row.value == pytest.approx(100 * moved / (4056 * 1.55e-3), rel=1e-6)
    high = float(row.text.split(",")[1].split()[0])
    assert high == pytest.approx(100 * moved / (3040 * 1.55e-3), abs=0.05)
    assert high == pytest.approx(4.75, abs=0.1)


def test_a_film_takes_the_place_of_the_resin_alone() -> None:
    camera = read_camera("paper").camera
    film = thickness.with_film(camera, 1.25)
    assert film.layers[0].thickness.mm == 1.25
    assert film.layers[0].material == "pdms"
    assert film.layers[1:] == camera.layers[1:]
    assert film.mask == camera.mask
    assert film.indices(587.56)[0] == pytest.approx(1.43, abs=1e-3)


def test_the_magnification_is_laid_beside_rays_and_the_papers_own_stack() -> None:
    work = ExperimentSetup(read_camera("paper"), QUICK, 0)
    reduced = 1.06 / 1.4716 + 0.49 / 1.5218 + 0.235
    figures = {"reduced_mm": reduced} | {
        f"{z:g}": {"larger": reduced / z - reduced / 200, "by_rays": 0.0, "correlation": 1.0}
        for z in (30.0, 80.0, 300.0, math.inf)
    }
    found = {"magnification": StepResult(figures, {"overlay": torch.rand(3, 8, 8)})}
    rows = {row.key: row for row in depths.magnification(work, found).rows}
    assert rows["magnification 8"].value == pytest.approx(0.96, abs=0.01)
    assert "D = 0.47 mm" in rows["magnification 3"].why
    assert "D = 0.48 mm" in rows["magnification 8"].why
    assert "0.56 mm" in rows["magnification 3"].why + rows["magnification 8"].why
    far = rows["magnification 30"]
    assert far.value == pytest.approx(100 * reduced / 300, abs=0.01)


def test_a_scene_is_cut_from_what_was_solved_and_zero_beyond() -> None:
    problem = Problem.build(torch.rand(1, 6, 8), torch.rand(1, 6, 8))
    origin = problem.forward.geometry.origin
    rows, columns = problem.forward.geometry.padded
    scene = torch.arange(rows * columns, dtype=torch.float32).reshape(1, rows, columns) + 1
    cut = photographs._cut(scene, problem, PixelRectangle(1, 2, 3, 4))
    top, left = 1 - origin[0], 2 - origin[1]
    assert torch.equal(cut, scene[:, top : top + 3, left : left + 4])
    wide = photographs._cut(
        scene, problem, PixelRectangle(origin[0] - 2, origin[1] - 3, rows + 4, columns + 6)
    )
    assert torch.equal(wide[:, 2:-2, 3:-3], scene)
    assert float(wide.sum()) == float(scene.sum())


def test_the_exposure_is_that_of_a_scene_of_known_luminance(tmp_path: Path) -> None:
    """`nolens simulate` says the exposure time for a luminance; the bench says their product."""
    from PIL import Image

    picture = tmp_path / "grey.png"
    Image.new("RGB", (40, 40), (255, 255, 255)).save(picture)
    options = SimulateOptions.gather(
        {
            "scenes": (picture,), "camera": "small", "angle": ("8deg",), "field_points": 3,
            "wavelengths": 1, "output": tmp_path / "raw.dng", "luminance": "200cd/m2",
            "light": "white-led",
        }
    )  # fmt: skip
    done = simulate(options, Watcher())
    bench = VirtualExperiment.of(read_camera("small"), field_points=3)
    shot = bench.measure((Plane(torch.ones(3, 40, 40), 8.0, 300e3),), fill=0.9)
    wanted = done.summary["exposure_s"] * Luminance.parse("200cd/m2").cd_m2
    assert shot.exposure_cd_s_m2 == pytest.approx(wanted, rel=1e-4)


def test_two_objects_stand_side_by_side_and_the_near_one_hides_nothing_else() -> None:
    near, far = depths._planes(ExperimentSetup(read_camera("small"), QUICK, 0))
    assert near.opacity is not None
    half = near.opacity.shape[-1] // 2
    assert bool((near.opacity[:, :half] == 1).all()) and bool((near.opacity[:, half:] == 0).all())
    assert float(far.radiance[:, :, : far.radiance.shape[-1] // 2].max()) == 0
    assert float(far.radiance.max()) > 0.5
    assert near.tangents == pytest.approx(far.tangents)


def test_quick_is_smaller_in_every_way_and_both_foretell_memory() -> None:
    opened = read_camera("paper")
    quick, full = (ExperimentSetup(opened, size, 0) for size in (QUICK, FULL))
    assert quick.reduced and not full.reduced
    assert full.pixels == (3040, 4056)
    assert quick.bytes < full.bytes and quick.written_bytes < full.written_bytes
    support = PixelRectangle.centred(446, 446, quick.preview.shape)
    assert quick.scene_work() < full.scene_work()
    assert quick.solve_work(support, 100) < full.solve_work(support, 100)
    assert replace(QUICK, pixels=(9000, 9000)) and ExperimentSetup(
        opened, replace(QUICK, pixels=(9000, 9000)), 0
    ).pixels == (3040, 4056)
