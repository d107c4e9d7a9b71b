"""Paths of the page stay below the folders that a person named."""

import subprocess
import sys
from pathlib import Path

import pytest
import tifffile
import torch

from nolens.camera import PRESETS, Frame
from nolens.errors import FileError, OptionError
from nolens.files import frame_suffixes, write_frame, write_tiff16, write_tiff32
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
    counts = (100 * picture[:1]).round()
    raw = Frame(counts, ("grey",), None, (0.0,), 4095.0, "uint16", "raw")
    write_frame(place / "other/raw.tif", raw)
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
    assert set(frame_suffixes()) <= {*RAW_SUFFIXES, *PICTURE_SUFFIXES}
    assert set(space.presets()) == set(PRESETS)


def test_cameras_are_found_where_they_are_kept(space: Workspace, place: Path) -> None:
    folder = place / "work/cameras/mine"
    folder.mkdir(parents=True)
    (folder / "psfs.toml").write_text(
        'schema_version = 1\n[[psf]]\nfile = "psf-300mm.tif"\npixel = "3.1 um"\n'
        'channels = ["R", "G", "B"]\ndistance = "300 mm"\n'
    )
    [mine] = [each for each in space.cameras() if each.id not in PRESETS]
    assert mine.id == "work/cameras/mine"
    assert [(psf.path, psf.distance) for psf in mine.psfs] == [
        ("work/cameras/mine/psf-300mm.tif", "300 mm")
    ]


@pytest.mark.parametrize(
    ("file", "content", "words"),
    [
        ("camera.toml", b"a = " + b"[" * 3000 + b"]" * 3000, "deep"),
        ("camera.toml", b"a = " + b"9" * 5000, "number or key of 5000 characters"),
        ("camera.toml", b"note = \xff", "is no TOML file"),
        ("psfs.toml", b"psf = 3", "psf: input should be a valid list"),
        ("psfs.toml", b"[[psf]]\nfile = 'x.tif'\nangle = 3", "psf.0.angle"),
        ("psfs.toml", b"[[psf]]\nfile = '../../outside/secret.tif'", "a file in its folder"),
    ],
)
def test_a_bad_description_is_shown_with_its_reason(
    space: Workspace, place: Path, file: str, content: bytes, words: str
) -> None:
    for name in ("bad", "good"):
        (place / "work/cameras" / name).mkdir(parents=True)
    (place / "work/cameras/bad" / file).write_bytes(content)
    (place / "work/cameras/good/camera.toml").write_text('note = "a note"')
    found = {each.id: each for each in space.cameras()}
    trouble = found["work/cameras/bad"].trouble or ""
    assert words in trouble and f"cameras/bad/{file}" in trouble and "\n" not in trouble
    assert (found["work/cameras/good"].note, found["work/cameras/good"].trouble) == ("a note", None)
    (place / "work/cameras/bad" / file).unlink()
    (place / "work/cameras/bad/camera.toml").write_text('note = "mended"')
    assert {each.id: each.note for each in space.cameras()}["work/cameras/bad"] == "mended"


def test_links_are_judged_wherever_a_path_is_made(space: Workspace, place: Path) -> None:
    camera = place / "work/cameras/linked"
    camera.mkdir(parents=True)
    (place / "outside/camera.toml").write_text('note = "secret"')
    (camera / "camera.toml").symlink_to(place / "outside/camera.toml")
    [linked] = [each for each in space.cameras() if each.id not in PRESETS]
    assert linked.note == "" and "is a link out of its folder" in (linked.trouble or "")
    (place / "work/uploads").symlink_to(place / "outside")
    with pytest.raises(OptionError, match="is a link out of its folder"):
        space.make("uploads")
    (place / "work/jobs").symlink_to(place)
    space.remove_job("outside")
    assert (place / "outside/secret.txt").is_file()


def test_a_process_opens_nothing_through_a_link_out(place: Path) -> None:
    """By any function; what it writes and reads without links is left alone."""
    (place / "outside/ours").symlink_to(place / "work/shots/a b.dng")
    code = (
        "import sys, os, shutil\n"
        "from pathlib import Path\n"
        "from nolens.errors import FileError\n"
        "from nolens.studio.workspace import confine\n"
        "place = Path(sys.argv[1])\n"
        "confine([str(place / 'work'), str(place / 'other')])\n"
        "calls = (lambda path: path.read_bytes(), lambda path: os.open(path, os.O_RDONLY),\n"
        "         lambda path: shutil.copyfile(path, place / 'work/copied'),\n"
        "         lambda path: open(os.fsencode(path)).close(),\n"
        "         lambda path: (path.parent / 'new').write_text('x'))\n"
        "for name in ('work/out/secret.txt', 'work/peek', 'work/../outside/secret.txt',\n"
        "             'work/in/a b.dng', 'other/deep/x.png', 'outside/secret.txt'):\n"
        "    for number, call in enumerate(calls):\n"
        "        try:\n"
        "            call(place / name)\n"
        "        except FileError:\n"
        "            print(name, number)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(place)], capture_output=True, text=True, check=True
    )
    refused = [f"work/out/secret.txt {number}" for number in range(5)]
    refused += [f"work/peek {number}" for number in range(4)]  # Beside it can be written.
    refused += [f"work/../outside/secret.txt {number}" for number in range(5)]
    assert done.stdout.splitlines() == refused


def test_a_folder_of_thousands_of_files_is_listed_without_following_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(3000):
        (tmp_path / f"{number}.npy").touch()
    space, count = Workspace([tmp_path]), 0
    resolve = Path.resolve

    def counted(path: Path, strict: bool = False) -> Path:
        nonlocal count
        count += 1
        return resolve(path, strict)

    monkeypatch.setattr(Path, "resolve", counted)
    assert len(space.listing("work")) == 3000
    assert len(space.cameras()) == len(PRESETS)
    assert count < 10
