"""Materials by name, or from a TOML file of a person's own."""

from pathlib import Path

from nolens.camera import MATERIALS, Material, material, material_from_toml
from nolens.errors import FileError


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
    try:
        text = path.expanduser().read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise FileError(f"{path} is no TOML file: {error}") from error
    except (OSError, ValueError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FileError(
            f"cannot read the material {path}: {reason}. Give a .toml file, or one of the names "
            f"{', '.join(MATERIALS)}"
        ) from error
    return material_from_toml(text, str(path))
