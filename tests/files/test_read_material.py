"""Materials by name and from files."""

import pytest

from nolens.camera import MATERIALS, to_toml
from nolens.errors import DataError, FileError, NolensError, OptionError
from nolens.files import read_material

RESIN = """name = "my-resin"
source = "a refractometer"
formula = "cauchy"
coefficients = [1.5, 0.004]
range_nm = [400, 900]
"""


@pytest.mark.parametrize("name", MATERIALS)
def test_by_name_and_as_a_copy(name, tmp_path):
    assert read_material(name) is MATERIALS[name]
    path = tmp_path / "copy.toml"
    path.write_text(to_toml(MATERIALS[name]), encoding="utf-8")
    assert read_material(path) == read_material(str(path)) == MATERIALS[name]


def test_a_persons_own(tmp_path, monkeypatch):
    (tmp_path / "pdms.TOML").write_text(RESIN)
    monkeypatch.chdir(tmp_path)
    assert read_material("pdms.TOML").index(500) == pytest.approx(1.516)
    assert read_material("pdms") is MATERIALS["pdms"]


@pytest.mark.parametrize(
    ("given", "kind", "words"),
    [
        ("n-bk7", OptionError, "there is no material 'n-bk7'; did you mean 'bk7'"),
        ("", OptionError, "there is no material ''"),
        ("none.toml", FileError, "cannot read none.toml: No such file.*one of the"),
        ("folder.toml", FileError, "cannot read folder.toml: Is a directory"),
        ("a\0b.toml", FileError, "cannot read"),
        ("~nobody-at-all/a.toml", FileError, "cannot read"),
        ("bytes.toml", FileError, "is no TOML file"),
        ("broken.toml", DataError, "broken.toml is no TOML file: Invalid value"),
        ("empty.toml", DataError, "empty.toml: name, source, .* are missing"),
        ("other.toml", DataError, "other.toml: the key 'thickness' is unknown"),
        ("below.toml", DataError, "below.toml: the refractive index is 0.5"),
        ("hides.toml", DataError, "hides.toml: a material 'pua311' comes with nolens"),
    ],
)
def test_refused(given, kind, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.toml").mkdir()
    (tmp_path / "bytes.toml").write_bytes(b"name = \xff")
    (tmp_path / "broken.toml").write_text("name = ")
    (tmp_path / "empty.toml").write_text("")
    (tmp_path / "other.toml").write_text(RESIN + 'thickness = "1 mm"\n')
    (tmp_path / "below.toml").write_text(RESIN.replace("[1.5, 0.004]", "[0.5]"))
    (tmp_path / "hides.toml").write_text(RESIN.replace("my-resin", "pua311"))
    with pytest.raises(NolensError, match=words) as error:
        read_material(given)
    assert isinstance(error.value, kind) and "\n" not in str(error.value)
