"""The relief as a solid, and solids in files that other programs read back."""

import importlib.util
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import torch
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from workpieces import frame, inside, lopsided, smooth, surface

from nolens.errors import DataError, OptionError
from nolens.fabricate import MadeSurface, Solid, decimated, frame_solid, relief_solid
from nolens.files.workshop import write_3mf, write_step, write_stl
from nolens.optics import Relief


def mesh(solid: Solid) -> trimesh.Trimesh:
    return trimesh.Trimesh(solid.vertices_mm, solid.triangles, process=False)


def volume_mm3(made: MadeSurface, base_mm: float) -> float:
    """Sum of the prisms under the triangles: area times the mean of three heights."""
    z = base_mm + (made.height_um - made.height_um.min()).double().numpy() * 1e-3
    a, b, c, d = z[:-1, :-1], z[:-1, 1:], z[1:, 1:], z[1:, :-1]
    half = (made.pitch_um * 1e-3) ** 2 / 2
    return float(half * ((a + b + c) / 3 + (a + c + d) / 3).sum())


@given(st.integers(2, 30), st.integers(2, 30), st.integers(0, 10**6), st.floats(0.001, 3))
@settings(max_examples=40)
def test_reliefs_are_closed_and_as_large_as_arithmetic_says(
    rows: int, columns: int, seed: int, base: float
) -> None:
    made = surface(smooth(rows, columns, seed))
    found = mesh(relief_solid(made, base))
    assert found.is_volume and found.body_count == 1
    assert found.volume == pytest.approx(volume_mm3(made, base), rel=1e-9)
    assert len(found.faces) == 2 * (rows - 1) * (columns - 1) + 6 * (rows + columns - 2)
    assert found.bounds[0][2] == 0
    size = (*made.size_mm, base + np.ptp(made.height_um.numpy()) * 1e-3)
    assert found.extents == pytest.approx(size, rel=1e-6)


def test_relief_is_not_mirrored() -> None:
    """Seen from above, x goes along the columns and y along the rows."""
    heights = torch.zeros(5, 6)
    heights[4, 0] = 100.0
    solid = relief_solid(surface(Relief(heights, 100.0)), 0.1)
    highest = solid.vertices_mm[solid.vertices_mm[:, 2].argmax()]
    assert highest == pytest.approx([-0.25, 0.2, 0.2])
    assert inside(solid, [[-0.24, 0.19, 0.15], [0.24, 0.19, 0.15], [-0.24, -0.19, 0.15],
                          [0.24, -0.19, 0.05]]) == [True, False, False, True]  # fmt: skip


def test_mould_closes_onto_the_replica() -> None:
    """Turned over about the y axis and laid on the replica, the two make a block."""
    relief = lopsided()
    low, high = (float(each) * 1e-3 for each in (relief.height_um.min(), relief.height_um.max()))
    replica, mould = (
        mesh(relief_solid(surface(relief, name), 1.0)) for name in ("replica", "mould")
    )
    replica.apply_translation([0, 0, low])
    mould.apply_transform(trimesh.transformations.rotation_matrix(np.pi, [0, 1, 0]))
    mould.apply_translation([0, 0, 2 + high])
    for vertices in (replica.vertices, mould.vertices):
        assert vertices[:, 2].min() >= low - 1e-9 and vertices[:, 2].max() <= 2 + high + 1e-9
    block = np.prod(replica.extents[:2]) * (2 + high - low)
    # Their triangles halve the squares along different diagonals, so not exactly.
    assert replica.volume + mould.volume == pytest.approx(block, rel=1e-3)
    tops = {(round(x, 6), round(y, 6)): z for x, y, z in replica.vertices if z > low + 1e-9}
    undersides = [vertex for vertex in mould.vertices if vertex[2] < 2 + high - 1e-9]
    assert len(undersides) == len(tops) == 77
    for x, y, z in undersides:
        assert tops[round(x, 6), round(y, 6)] == pytest.approx(z, abs=1e-6)


@given(st.integers(20, 80), st.integers(20, 80), st.integers(60, 4000))
@settings(max_examples=40)
def test_decimation_keeps_to_the_number(rows: int, columns: int, most: int) -> None:
    made = surface(smooth(rows, columns, 1))
    try:
        kept = decimated(made, most)
    except OptionError as error:
        fewest = int(str(error).split("give ")[1].split()[0])
        assert fewest > most
        assert len(relief_solid(decimated(made, fewest), 1.0).triangles) <= fewest
        return
    triangles = len(relief_solid(kept, 1.0).triangles)
    assert triangles <= most
    if kept is not made and most > 1000:
        assert triangles > 0.75 * most


def test_decimation_that_is_not_needed() -> None:
    made = surface(smooth(10, 12, 1))
    assert decimated(made, 2 * 9 * 11 + 6 * 20) is made
    assert decimated(made, 2 * 9 * 11 + 6 * 20 - 1) is not made
    with pytest.raises(OptionError, match="--triangles"):
        decimated(made, 0)
    with pytest.raises(OptionError, match="--base"):
        relief_solid(made, 0.0)


def test_open_surfaces_are_refused() -> None:
    whole = frame_solid(frame(), "test")
    whole.check_closed()
    with pytest.raises(DataError, match="not closed"):
        Solid(whole.vertices_mm, whole.triangles[1:], "test").check_closed()


def test_a_shrinking_print_is_made_larger() -> None:
    made = frame()
    grown = mesh(frame_solid(made, "test").grown(0.02))
    assert grown.extents * 0.98 == pytest.approx([13.5, 11.5, 3.0])
    assert grown.volume * 0.98**3 == pytest.approx(made.volume_mm3, rel=1e-7)
    for share in (-0.1, 0.5, float("nan")):
        with pytest.raises(OptionError, match="shrinkage"):
            frame_solid(made, "test").grown(share)


SOLIDS = {
    "frame": lambda: frame_solid(frame(), "frame of test, in mm"),
    "relief": lambda: relief_solid(surface(lopsided(), "mould"), 0.01),
}


@pytest.mark.parametrize("what", SOLIDS)
@pytest.mark.parametrize("suffix", [".stl", ".3mf"])
def test_files_read_back_by_another_reader(what: str, suffix: str, tmp_path: Path) -> None:
    solid = SOLIDS[what]()
    path = tmp_path / f"part{suffix}"
    (write_stl if suffix == ".stl" else write_3mf)(path, solid)
    found = trimesh.load_mesh(path)
    if isinstance(found, trimesh.Scene):
        found = found.to_mesh()
    assert found.is_volume
    assert found.volume == pytest.approx(mesh(solid).volume, rel=1e-5)
    assert found.bounds == pytest.approx(mesh(solid).bounds, abs=1e-5)
    assert len(found.faces) == len(solid.triangles)


def test_stl_says_what_it_is(tmp_path: Path) -> None:
    for name in ("master", "mould", "replica"):
        path = tmp_path / f"{name}.stl"
        write_stl(path, relief_solid(surface(lopsided(), name), 1.0))
        header = path.read_bytes()[:80]
        assert header.startswith(name.upper().encode()) and b"relief of test" in header
        assert not header.startswith(b"solid")  # Then readers take it for text.
    long = Solid(np.eye(3), np.array([[0, 1, 2]]), "ü" * 200)
    write_stl(path, long)
    assert len(path.read_bytes()) == 80 + 4 + 50


def test_normals_point_outwards(tmp_path: Path) -> None:
    path = tmp_path / "frame.stl"
    solid = frame_solid(frame(), "test")
    write_stl(path, solid)
    records = np.frombuffer(path.read_bytes()[84:], [("v", "<f4", (4, 3)), ("a", "<u2")])
    assert records["v"][:, 0] == pytest.approx(mesh(solid).face_normals, abs=1e-6)


def test_3mf_has_title_and_unit(tmp_path: Path) -> None:
    solid = frame_solid(frame(), "frame of <a & b>")
    for name in ("a.3mf", "b.3mf"):
        write_3mf(tmp_path / name, solid)
    assert (tmp_path / "a.3mf").read_bytes() == (tmp_path / "b.3mf").read_bytes()
    with zipfile.ZipFile(tmp_path / "a.3mf") as archive:
        assert archive.testzip() is None
        model = ElementTree.fromstring(archive.read("3D/3dmodel.model"))
    space = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
    assert model.tag == f"{space}model" and model.get("unit") == "millimeter"
    titles = [each.text for each in model.iter(f"{space}metadata") if each.get("name") == "Title"]
    assert titles == ["frame of <a & b>"]


STEP = importlib.util.find_spec("build123d") is not None


@pytest.mark.skipif(STEP, reason="build123d is installed")
def test_step_without_its_library(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match=r"nolens\[step\]"):
        write_step(tmp_path / "frame.step", frame(), "test")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not STEP, reason="build123d, which writes STEP, is not installed")
@pytest.mark.parametrize("vents", [0, 1, 4, 7])
def test_step_reads_back(vents: int, tmp_path: Path) -> None:
    import build123d

    made = frame(vents=vents)
    write_step(tmp_path / "frame.step", made, "test", 0.02)
    found = build123d.import_step(tmp_path / "frame.step")
    assert found.volume * 0.98**3 == pytest.approx(made.volume_mm3, rel=1e-6)
    top = found.bounding_box().max.Z * 0.98
    assert top == pytest.approx(made.height_mm, abs=1e-5)
