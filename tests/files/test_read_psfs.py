"""Sets of PSFs: written and read again, added to, and refused where they do not fit."""

from pathlib import Path

import pytest
import torch

from nolens.camera import PsfEntry, PsfSet, from_mapping, from_toml, to_toml
from nolens.errors import DataError, FileError
from nolens.files import read_psf, read_psf_set, write_psfs
from nolens.quantities import Length


def entry(name: str, distance: str = "300 mm", **more: object) -> PsfEntry:
    given = {"file": name, "cell": "3.1 um", "channels": ("R", "G", "B"), "distance": distance}
    return PsfEntry.model_validate({**given, **more})


def test_added_read_and_replaced(tmp_path: Path) -> None:
    folder = tmp_path / "made" / "camera"
    near, far = entry("near.tif", "8 cm", angle=("20 deg", "0 deg")), entry("far.tif", "infinity")
    first = torch.rand(3, 4, 5)
    write_psfs(folder, {near: first})
    write_psfs(folder, {far: 2 * first})
    listed = read_psf_set(folder)
    assert listed.psf == (near, far)
    assert listed.psf[0].distance == Length("80", "mm")
    assert torch.equal(read_psf(folder, far), 2 * first)
    again = entry("again.tif", "80 mm", angle=("20 deg", "0 deg"))
    write_psfs(folder, {again: 3 * first})
    assert read_psf_set(folder).psf == (far, again)


def test_those_straight_ahead_by_distance(tmp_path: Path) -> None:
    psfs = [
        entry("far.tif", "infinity"),
        entry("near.tif", "8 cm"),
        entry("wide.tif", "8 cm", kind="stitched"),
        entry("side.tif", "2 cm", angle=("20 deg", "0 deg")),
    ]
    write_psfs(tmp_path, {each: torch.ones(3, 4, 5) for each in psfs})
    listed = read_psf_set(tmp_path)
    found = listed.by_distance(("stitched", "captured"))
    assert [each.file for each in found] == ["wide.tif", "far.tif"]
    assert [each.file for each in listed.by_distance(("captured",))] == ["near.tif", "far.tif"]


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"cell": "1.55 um"}, r"psfs.toml: two\.tif has pixels of 1.55 um"),
        ({"channels": ("grey",)}, r"psfs.toml: two\.tif has pixels of 3.1 um and channels grey"),
    ],
)
def test_psfs_of_another_camera_are_refused(
    tmp_path: Path, more: dict[str, object], words: str
) -> None:
    write_psfs(tmp_path, {entry("one.tif"): torch.ones(3, 4, 5)})
    before = sorted(tmp_path.iterdir())
    with pytest.raises(DataError, match=words):
        write_psfs(tmp_path, {entry("two.tif", "8 cm", **more): torch.ones(1, 4, 5)})
    assert sorted(tmp_path.iterdir()) == before


def test_folder_without_list(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="nolens calibrate"):
        read_psf_set(tmp_path)


def test_list_with_an_unknown_key(tmp_path: Path) -> None:
    (tmp_path / "psfs.toml").write_text('[[psf]]\nfile = "a.tif"\ndepth = "8 cm"\n')
    with pytest.raises(DataError, match="'depth' is unknown"):
        read_psf_set(tmp_path)


def test_lists_with_the_former_name_of_the_pixels_are_read() -> None:
    """A list of the first releases says `cell`; written anew, it says `pixel`."""
    entry = {"file": "psf.tif", "channels": ["grey"], "distance": "infinity"}
    former = from_mapping(PsfSet, {"psf": [entry | {"cell": "3.1 um"}]}, "psfs.toml")
    assert former == from_mapping(PsfSet, {"psf": [entry | {"pixel": "3.1 um"}]}, "psfs.toml")
    assert 'pixel = "3.1 um"' in to_toml(former) and "cell" not in to_toml(former)


def test_the_documented_list_is_one() -> None:
    """docs/camera-folder.md shows a list that is read, and names every key."""
    page = (Path(__file__).parents[2] / "docs" / "camera-folder.md").read_text()
    example = page.partition("```toml\n")[2].partition("```")[0]
    psfs = from_toml(PsfSet, example, "docs/camera-folder.md").psf
    assert [each.kind for each in psfs] == ["captured", "captured", "stitched"]
    for key in PsfEntry.model_fields:
        assert f"| `{key}` |" in page
