"""Materials by name, or from a TOML file of a person's own."""

from pathlib import Path

from nolens.camera import MATERIALS, Material, material, material_from_toml
from nolens.files.text_file import read_text


def read_material(given: str | Path) -> Material:
    """Give a material of the package, or read one from a file.

    Parameters
    ----------
    given
        Name of a material, or a path that ends in .toml; such a file holds what
        ``nolens material show`` prints.

    Raises
    ------
    OptionError
        If there is no material of this name; with the nearest one.
    FileError
        If there is no such file, or it cannot be read.
    DataError
        If the file describes no material, or one whose name another one has.
    """
    path = Path(given)
    if str(given) in MATERIALS or path.suffix.lower() != ".toml":
        return material(str(given))
    advice = f"Give a .toml file, or one of the names {', '.join(MATERIALS)}"
    text = read_text(path, advice=advice)
    return material_from_toml(text, str(path))
