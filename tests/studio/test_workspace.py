"""Paths of the page stay below the folders that a person named."""

from pathlib import Path

import pytest
import tifffile
import torch

from nolens.camera import PRESETS
from nolens.errors import FileError, OptionError
from nolens.files import SUFFIXES, write_counts, write_tiff16, write_tiff32
from nolens.studio.workspace import PICTURE_SUFFIXES, RAW_SUFFIXES, Workspace, unused


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A workspace, another folder, and what lies outside both."""
    for name in ("work/shots", "other/deep", "outside"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "work/shots/a b.dng").write_bytes(b"raw")
    (tmp_path / "other/deep/x.png").write_bytes(b"picture")
    (tmp_path / "outside/secret.txt").write_bytes(b"secret")
    (tmp_path / "work/.hidden").write_bytes(b"hidden")
    (tmp_path / "work/out").symlink_to(tmp_path / "outside")
    (tmp_path / "work/in").symlink_to(tmp_path / "work/shots")
    (tmp_path / "work/loop").symlink_to(tmp_path / "work/loop")
    (tmp_path / "work/peek").symlink_to(tmp_path / "work/.hidden")
    return tmp_path


@pytest.fixture
def space(place: Path) -> Workspace:
    return Workspace([place / "work", place / "other"])


def test_paths_in_the_folders_are_found(space: Workspace, place: Path) -> None:
    assert space.resolve("work/shots/a b.dng") == place / "work/shots/a b.dng"
    assert space.resolve("work/in/a b.dng") == place / "work/shots/a b.dng"
    assert space.resolve("other/deep/x.png") == place / "other/deep/x.png"
    assert space.name_of(place / "other/deep/x.png") == "other/deep/x.png"
    assert space.name_of(place / "outside/secret.txt") is None


@pytest.mark.parametrize(
    "path",
    [
        "work/../outside/secret.txt", "work/shots/../../outside/secret.txt", "..", "/etc/passwd",
        "work//etc/passwd", "work/out/secret.txt", "work/out", "work/.hidden", "work/peek",
        "work/loop", "outside/secret.txt", "", "/", "work/", "work\\..\\outside", "work/a\0b",
        "work/" + "x" * 5000, "~/x", "work/./shots", "nowhere", "work/missing.dng",
        "work/%2e%2e/outside/secret.txt",
    ],
)  # fmt: skip
def test_nothing_else_is(space: Workspace, path: str) -> None:
    with pytest.raises((OptionError, FileError)):
        space.resolve(path)


def test_lists_what_can_be_used(space: Workspace) -> None:
    assert [(each.name, each.kind) for each in space.listing("work")] == [
        ("in", "folder"), ("shots", "folder"),
    ]  # fmt: skip
    [raw] = space.listing("work/shots")
    assert (raw.path, raw.kind, raw.bytes) == ("work/shots/a b.dng", "raw", 3)
    assert space.listing("work/cameras") == []
    with pytest.raises(FileError):
        space.listing("work/nowhere")


def test_pictures_of_ours_are_no_raw_frames(space: Workspace, place: Path) -> None:
    picture = torch.rand(3, 8, 8)
    write_tiff16(place / "other/picture.tif", picture)
    write_tiff32(place / "other/radiance.tif", picture)
    write_counts(
        place / "other/raw.tif", (100 * picture[0]).round(), mosaic=None, black=0, white=4095
    )
    tifffile.imwrite(place / "other/theirs.TIF", picture[0].numpy())
    kinds = {each.name: each.kind for each in space.listing("other")}
    assert {name for name, kind in kinds.items() if kind == "raw"} == {"raw.tif", "theirs.TIF"}


def test_first_folder_may_be_missing_and_others_not(tmp_path: Path) -> None:
    space = Workspace([tmp_path / "new"])
    assert space.listing("work") == []
    assert not (tmp_path / "new").exists()
    with pytest.raises(FileError, match="there is no folder"):
        Workspace([tmp_path, tmp_path / "new"])
    (tmp_path / "file").touch()
    with pytest.raises(FileError, match="is a file"):
        Workspace([tmp_path / "file"])


def test_folders_of_one_name_are_told_apart(tmp_path: Path) -> None:
    for name in ("a/data", "b/data", "c/work"):
        (tmp_path / name).mkdir(parents=True)
    space = Workspace([tmp_path, *(tmp_path / each for each in ("a/data", "b/data", "c/work"))])
    assert [each.id for each in space.folders] == ["work", "data", "data-2", "work-2"]


def test_names_are_never_used_twice(tmp_path: Path) -> None:
    (tmp_path / "a.b.dng").touch()
    (tmp_path / "a.b-2.json").touch()
    assert unused(tmp_path, "a.b") == "a.b-3"
    assert unused(tmp_path, "a.bc") == "a.bc"


def test_knows_what_the_package_reads_without_loading_it(space: Workspace) -> None:
    assert set(SUFFIXES) <= {*RAW_SUFFIXES, *PICTURE_SUFFIXES}
    assert set(space.presets()) == set(PRESETS)


def test_cameras_are_found_where_they_are_kept(space: Workspace, place: Path) -> None:
    folder = place / "work/cameras/mine"
    folder.mkdir(parents=True)
    (folder / "psfs.toml").write_text(
        'schema_version = 1\n[[psf]]\nfile = "psf-300mm.tif"\ncell = "3.1 um"\n'
        'channels = ["R", "G", "B"]\ndistance = "300 mm"\n'
    )
    [mine] = [each for each in space.cameras() if each.id not in PRESETS]
    assert mine.id == "work/cameras/mine"
    assert [(psf.path, psf.distance) for psf in mine.psfs] == [
        ("work/cameras/mine/psf-300mm.tif", "300 mm")
    ]
